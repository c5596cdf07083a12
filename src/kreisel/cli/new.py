"""The command new: a commented TOML file of any system or body, and the Python file that belongs to it."""

from __future__ import annotations

import inspect
import sys
import tempfile
import textwrap
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kreisel.cli.checkcases import files_of
from kreisel.cli.output import OverwriteFile, a_path, app, arg, opt, say, system_names
from kreisel.errors import InputError
from kreisel.record.contract import System
from kreisel.system import NAMED, find

if TYPE_CHECKING:
    from kreisel.runs.examples import Example

HEAD = "# Written by `kreisel new`"  # the mark by which --overwrite recognises a file of Kreisel
STEPS, EVERY = 10_000, 5
SWEEP_STEPS, SWEEP_EVERY = 2048, 4
VARIED = 10  # values of a varied quantity
WIDTH = 118
GYROSTATS = ("zhukovsky-volterra", "kovalevskaya-gyrostat")


# -- bodies in SI units -------------------------------------------------------------------------------


@cache
def samples() -> dict[str, dict[str, str]]:
    """The bodies of bodies.toml: a sentence about each, and the lines of [body], [state] and [run]."""
    from importlib import resources

    return tomllib.loads(resources.files("kreisel.cli").joinpath("bodies.toml").read_text(encoding="utf-8"))


def text_of_body(name: str, target: Path) -> str:
    """The TOML file of a body, ready to run."""
    from kreisel.cli.configuration import kinds
    from kreisel.physical import FreeBody, Satellite

    sample, kind = samples()[name], kinds()[name]
    keys = (
        f"Keys of [body] and [state] are arguments of kr.physical.{kind.__name__} and of its state; values without a "
        "unit are in SI, vectors along the body axes."
    )
    stated = tomllib.loads(f"[body]\n{sample['body']}")["body"]
    refused = () if issubclass(kind, (FreeBody, Satellite)) else ("wheels",)
    optional = ", ".join(k for k in inspect.signature(kind).parameters if k not in (*stated, *refused, "self"))
    sections = {key: sample[key].split("\n") for key in ("body", "state", "run")}
    sections["body"] = [f'kind = "{name}"', *comments(f"more: {optional}"), *sections["body"]]
    return _file(name, [sample["about"], keys], sections, target)


def _file(name: str, about: Iterable[str], sections: dict[str, list[str]], target: Path, verb: str = "run") -> str:
    """A TOML file of sections of lines, with comments in front and the section [output]."""
    lines = [f"{HEAD} {name}; run it by: kreisel {verb} {target}", *comments(*about)]
    figure = [f'# figure = "{target.stem}.png"   # or .pdf, .svg'] * (verb == "run")
    for section, settings in (*sections.items(), ("output", [f'path = "{target.stem}.zarr"', *figure])):
        lines += ["", f"[{section}]", *settings]
    return "\n".join(lines) + "\n"


def commented(setting: str, meaning: str | None) -> list[str]:
    """A setting and its meaning, after it or above."""
    line = setting if meaning is None else f"{setting:<27}  # {' '.join(meaning.split())}"
    return [line] if meaning is None or len(line) <= WIDTH else [*comments(meaning), setting]


def comments(*paragraphs: str) -> list[str]:
    """Lines of comment."""
    return [f"# {line}" for text in paragraphs for line in textwrap.wrap(" ".join(text.split()), WIDTH - 2)]


# -- the command ----------------------------------------------------------------------------------------


@app.command()
def new(
    name: str | None = arg(
        "A body: gyroscope, satellite, ...; a system (kreisel systems); with --lagrangian any name.",
        lambda: (*samples(), *system_names()),
    ),
    case: str | None = arg("A check case, after the name checkcase."),
    out: Path | None = a_path("The file to write, by default NAME.toml.", "--out", "-o"),
    n: int | None = opt("The dimension, or the sites of a chain."),
    perturbed: bool = opt("Under user-defined forces, in a Python file.", "--perturbed", default=False),
    swept: bool = opt("Many lanes, for `kreisel sweep`.", "--sweep", default=False),
    lagrangian: bool = opt("A user-defined body by its Lagrangian, in a Python file.", "--lagrangian", default=False),
    overwrite: OverwriteFile = False,
) -> None:
    """Write a commented TOML file, ready to run: kreisel new lagrange-top, then kreisel run lagrange-top.toml."""
    from kreisel.bodies import KNOWN
    from kreisel.files import require_file, written
    from kreisel.runs.examples import example

    if perturbed + lagrangian + swept > 1:
        raise InputError("kreisel new: expected one of --perturbed, --lagrangian, --sweep, got several.")
    if (name == "checkcase") != (case is not None):
        raise InputError("kreisel new: expected a system, or checkcase NAME; `kreisel checkcase` lists the cases.")
    if name is None:
        raise InputError(
            f"kreisel new: expected a body, {', '.join(samples())}, or a system, such as lagrange-top; "
            "`kreisel systems` lists them."
        )
    if lagrangian and (name in KNOWN or not name.replace("-", "").replace("_", "").isalnum()):
        raise InputError(f"--lagrangian: expected a new name, such as my-top, got {name!r}.")
    target = out or Path(f"{'my-' * perturbed}{case or name}{'-sweep' * swept}.toml")
    if target.suffix != ".toml":
        raise InputError(f"--out: expected a file that ends in .toml, got {str(target)!r}.")
    code = target.with_name(target.stem.replace("-", "_") + ".py")
    if case is not None:
        files = files_of(case, target, code, HEAD)
    elif lagrangian:
        files = {code: LAGRANGIAN.format(head=HEAD, name=name), target: _of_lagrangian(name, target, code)}
    elif perturbed:
        files = forced(example(system_named(name), n), f"my-{name}", target, code)
    elif name in samples() and not swept and n is None:
        files = {target: text_of_body(name, target)}
    elif name in samples() and name not in KNOWN:
        raise InputError(
            f"kreisel new: expected a system for --sweep and --n, got the body {name}. Lanes of a body are a section "
            f"[sweep.grid] in the file of `kreisel new {name}`, with lists for keys of [body] or [state], such as "
            "body.mass = ['1 kg', '2 kg'], for `kreisel sweep`."
        )
    else:
        files = {target: text_of(example(system_named(name), n), target, swept)}
    for path in files:
        require_file(path, overwrite)
    for path, text in files.items():
        with written(path, overwrite) as scratch:
            scratch.write_text(text, encoding="utf-8")
    done = f"{' and '.join(map(str, files))} written; next: kreisel {'sweep' if swept else 'run'} {target}"
    say(done, sys.stderr)  # not a line of TOML, in `kreisel new NAME > FILE`


def system_named(name: str) -> System:
    """The system of that name.  Raises `InputError`, which names bodies of `kr.physical` too."""
    from kreisel.bodies import KNOWN

    if name in samples() and name not in KNOWN:
        raise InputError(
            f"expected a system, got {name}, a body of kr.physical. `kreisel new {name}` writes a TOML file of its run."
            " User-defined forces are its arguments torque and potential, in Python."
        )
    return find(name, KNOWN, samples())


def text_of(sample: Example, target: Path, swept: bool = False) -> str:
    """The TOML file of a run or a sweep."""
    system = sample.model.system
    words = f"{system.title}: {system.equations}.  {system.frame.value.capitalize()} frame.  [{system.source}]"
    sections = {"system": [f'name = "{system.name}"', *_parameters(system, sample.parameters)], "state": _state(sample)}
    sections["run"] = _run(sample, _methods(sample), *((SWEEP_STEPS, SWEEP_EVERY) if swept else (STEPS, EVERY)))
    if swept:
        sections["sweep"] = _sweep(sample)
    about = [words, f"Units: {system.scaling}", *([system.notes] if system.notes else [])]
    return _file(system.name, about, sections, target, "sweep" if swept else "run")


def _run(sample: Example, method: list[str], steps: int = STEPS, every: int = EVERY) -> list[str]:
    return [
        *commented(f"dt = {sample.dt!r}", "step, in the unit of time"),
        *commented(f"steps = {steps:_}", f"or t_end = {steps * sample.dt:g}"),
        *commented(f"every = {every}", f"save every {every}th state"),
        *method,
        *commented('# observe = ["energy"]', "which Casimirs and integrals to save; default: all"),
    ]


def _parameters(system: System, values: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for p in system.parameters:
        meaning, usual = f"{p.kind}: {p.meaning}", p.default.tolist() if hasattr(p.default, "tolist") else p.default
        if p.letter in values:
            lines += commented(f"{p.letter} = {_toml(values[p.letter])}", meaning)
        elif usual is not None and not (isinstance(usual, list) and p.kind == "array"):
            lines += commented(f"# {p.letter} = {_toml(usual)}", f"{meaning}; this is the default")
    return lines


def _state(sample: Example) -> list[str]:
    system = sample.model.system
    kinds, n = dict(system.space.components), sample.model.n
    words = {"skew": "axial vector" if n == 3 else f"skew matrix {n} x {n}", "symmetric": f"symmetric matrix {n} x {n}"}
    lines: list[str] = []
    for letter, value in sample.state.items():
        meaning = words.get(kinds[letter], f"{len(value)} values")
        if letter in ("m", "M"):
            parts = ", of body and wheel" if system.name in GYROSTATS else ""
            meaning = f"angular momentum{parts}, {system.frame.value} frame: {meaning}, in the units named above"
        lines += commented(f"{letter} = {_toml(value)}", sample.meanings.get(letter, meaning))
    if sample.orientation is not None:
        lines += commented(f"orientation = {_toml(sample.orientation)}", "g, body to space: w, x, y, z; carried along")
    return lines


def _methods(sample: Example) -> list[str]:
    from kreisel.method import METHODS

    others = [m.name for m in METHODS.values() if m.applies(sample.model) and m.name != sample.method]
    method = METHODS[sample.method]
    also = f"; also {', '.join(others)}: `kreisel methods`" if others else ""
    lines = commented(f'# method = "{sample.method}"', f"the default here{also}")
    if method.default is not None:
        lines += commented(f"# order = {_toml(method.default)}", f"the default; {method.name} has {method.order_text}")
    return lines


def _sweep(sample: Example) -> list[str]:
    """[sweep]: a parameter, or the momentum, from 0.8 to 1.2 of the example's value."""
    quantity, value = _varied(sample)
    low, high = _ends(value)
    return [
        *commented('save = ["drift", "extremes", "frequencies"]', 'of each lane; also "trajectories"'),
        "# rng = 1                      # the seed of the draws in [sweep.random]",
        "# draws = 50",
        "",
        "[sweep.grid]                   # every combination of these; a list of values, or a range",
        f'{quantity} = {{ from = {low!r}, to = {high!r}, count = {VARIED} }}   # spacing = "log"',
        "",
        "# [sweep.random]               # uniform, loguniform = [a, b], normal = [mean, deviation], sphere = radius",
        f"# {quantity} = {{ uniform = [{low!r}, {high!r}] }}",
    ]


def _varied(sample: Example) -> tuple[str, float]:
    """A quantity of the example that may be 0.8 to 1.2 of its value, and the value."""
    system = sample.model.system

    def allowed(letter: str, *values: Any) -> bool:
        try:
            return all(system(**{**sample.parameters, letter: value}) is not None for value in values)
        except InputError:
            return False

    free = not system.space.constraints and system.perturbation is None
    for letter, kind in system.space.components:
        if free and kind == "skew" and sample.model.n == 3:
            place = max(range(3), key=lambda k: abs(sample.state[letter][k]))
            return f'state."{letter}[{place}]"', sample.state[letter][place]
    for letter, value in sample.parameters.items():
        if isinstance(value, float) and allowed(letter, *_ends(value)):
            return f"system.{letter}", value
    for letter, value in sample.parameters.items():
        *others, last = value if isinstance(value, list) else [None]
        if isinstance(last, float) and last and allowed(letter, *([*others, end] for end in _ends(last))):
            return f'system."{letter}[{len(others)}]"', last
    return "run.dt", sample.dt


def _ends(value: float) -> list[float]:
    return sorted((round(0.8 * value, 12), round(1.2 * value, 12)))


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        rows = [_toml(v) for v in value]
        if value and isinstance(value[0], list):
            return "[\n" + "".join(f"    {row},\n" for row in rows) + "]"
        return f"[{', '.join(rows)}]"
    return repr(value) if isinstance(value, int) else repr(float(value)) if not isinstance(value, str) else f'"{value}"'


FORCES = """{head} --perturbed: {title} under user-defined forces.
# The potential's force is derived.  Functions use NumPy's operations, np.where for `if`; see `help(kr.perturbed)`.

import numpy as np

import kreisel as kr

BODY = kr.perturbed(
    kr.{sample},
{forces}
    params={{"strength": {strength!r}}},  # the arguments after *; the TOML file may override them
    name="{name}",
)
"""
POTENTIAL = "    potential=lambda {0}, t, *, strength: strength * {0}[0] * np.cos(t),  # V, of {0}, g, the time t"
DAMPING = "\n    damping={0!r},  # M' = ... - damping M"
TORQUE = "    torque=lambda M, *, strength: -strength * M * np.sqrt(M @ M),  # added to M': quadratic friction"


def forced(sample: Example, name: str, target: Path, code: Path) -> dict[Path, str]:
    """The two files of a system under forces, tried.  Raises `InputError` for a system that accepts none."""
    from kreisel.cli.configuration import read
    from kreisel.runs.planning import make_plan

    system, why = sample.model.system, ""
    called = next((title for title, record in NAMED.items() if record is system), None)
    if called is None or sample.model.n != 3:
        raise InputError(f"--perturbed: expected a system of `kreisel systems` with n = 3, got {system.name}.")
    parameters = ", ".join(f"{k}={v!r}" for k, v in sample.parameters.items())
    carried = [system.space.components[place] for place in system.space.carried]
    letters = [letter for letter, kind in carried if kind == "vector"]
    size = round(0.0005 / sample.dt, 6)  # a hundredth of the rate of the motion
    forces = POTENTIAL.format(letters[0]) if letters else TORQUE
    forces += DAMPING.format(size) if letters and system.space.of_body else ""
    words = {"head": HEAD, "title": system.title, "sample": f"{called}({parameters})", "name": name}
    strength = commented(f"# strength = {size!r}", "the forces' own parameter")
    sections = {"system": [f'file = "{code.name}"', f'name = "{name}"', *strength], "state": _state(sample)}
    about = [f"{system.title} under the forces of {code.name}, which is run, because this file names it."]
    for method in ("splitting", "dop853"):
        chosen = commented(f'method = "{method}"', "the forces and the integrable motion alternate; or dop853")
        text = _file(f"{system.name} --perturbed", about, {**sections, "run": _run(sample, chosen)}, target)
        files = {code: FORCES.format(forces=forces, strength=size, **words), target: text}
        with tempfile.TemporaryDirectory() as folder:
            for path, text in files.items():
                Path(folder, path.name).write_text(text, encoding="utf-8")
            try:
                asked = read(Path(folder, target.name))
                settings = {"dt": asked.run.dt, "steps": 1, "method": method, "orientation": asked.orientation}
                make_plan(asked.model, asked.state, **settings)
            except InputError as error:
                why = why or str(error).replace(f"{folder}/", "")
            else:
                return files
    raise InputError(f"--perturbed: no forces of this kind for {system.name}: {why}")


LAGRANGIAN = """{head} --lagrangian: a user-defined body by its Lagrangian; it needs the extra reduction (JAX).
# Kreisel derives the equations of motion, a symmetric discretization of order 2 and its implicit map, which is Poisson.

import jax.numpy as jnp

from kreisel import reduction as red

J = (0.5, 0.5, 1.5)  # mass tensor: the moment about axis 1 is J2 + J3


def lagrangian(Omega, P, *, c=1.0):  # T - V; Omega a skew matrix, P the vertical seen from the body
    return -jnp.trace(Omega @ (jnp.array(J)[:, None] * Omega)) / 2 - c * P[2]


TOP = red.system("{name}", group=red.SO(3), lagrangian=lagrangian, title="{name}")
"""


def _of_lagrangian(name: str, target: Path, code: Path) -> str:
    about = f"The Lagrangian is in {code.name}, which is run, because this file names it; it needs the extra reduction."
    parameter = commented("c = 1.0", "the Lagrangian's own parameter")
    momentum = commented("M = [0.1, 0.2, 1.5]", "axial vector: the angular momentum, in the body")
    vertical = commented("P = [0.6, 0.0, 0.8]", "3 values: the vertical, seen from the body")
    sections = {"system": [f'file = "{code.name}"', f'name = "{name}"', *parameter], "state": momentum + vertical}
    return _file(
        f"{name} --lagrangian", [about], sections | {"run": ["dt = 0.05", "steps = 2_000", "every = 2"]}, target
    )
