"""The command new: a commented TOML file of any system or body, and the Python file that belongs to it."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kreisel.cli.bodies import SAMPLES, commented, comments, text_of_body
from kreisel.cli.checkcases import files_of
from kreisel.cli.output import OverwriteFile, a_path, app, say, system_names
from kreisel.errors import InputError
from kreisel.record.contract import Parameter, System

if TYPE_CHECKING:
    from kreisel.runs.examples import Example

HEAD = "# Written by `kreisel new`"  # the mark by which --overwrite recognises a file of Kreisel
STEPS, EVERY = 10_000, 5
SWEEP_STEPS, SWEEP_EVERY = 2048, 4
VARIED = 10  # values of a varied quantity
GYROSTATS = ("zhukovsky-volterra", "kovalevskaya-gyrostat")


def subject_names(begun: str) -> list[str]:
    """The bodies and systems whose names begin with `begun`, for the shell."""
    return [*(name for name in SAMPLES if name.startswith(begun)), *system_names(begun)]


@app.command()
def new(
    name: Annotated[
        str | None,
        typer.Argument(
            help="A body: gyroscope, satellite, ...; a system (kreisel systems); with --lagrangian any name.",
            autocompletion=subject_names,
        ),
    ] = None,
    case: Annotated[str | None, typer.Argument(help="A check case, after the name checkcase.")] = None,
    out: Annotated[Path | None, a_path("The file to write, by default NAME.toml.", "--out", "-o")] = None,
    n: Annotated[int | None, typer.Option("--n", help="The dimension, or the sites of a chain.")] = None,
    perturbed: Annotated[
        bool, typer.Option("--perturbed", help="Under user-defined forces, in a Python file.")
    ] = False,
    swept: Annotated[bool, typer.Option("--sweep", help="Many lanes, for `kreisel sweep`.")] = False,
    lagrangian: Annotated[
        bool, typer.Option("--lagrangian", help="A user-defined body by its Lagrangian, in a Python file.")
    ] = False,
    overwrite: OverwriteFile = False,
) -> None:
    """Write a commented TOML file, ready to run: kreisel new lagrange-top, then kreisel run lagrange-top.toml."""
    from kreisel.bodies import KNOWN, find
    from kreisel.runs.examples import example

    if perturbed + lagrangian + swept > 1:
        raise InputError("kreisel new: expected one of --perturbed, --lagrangian, --sweep, got several.")
    if (name == "checkcase") != (case is not None):
        raise InputError("kreisel new: expected a system, or checkcase NAME; `kreisel checkcase` lists the cases.")
    if name is None:
        raise InputError(
            f"kreisel new: expected a body, {', '.join(SAMPLES)}, or a system, such as lagrange-top; `kreisel systems` "
            "lists them."
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
        files = forced(example(find(name), n), f"my-{name}", target, code)
    elif name in SAMPLES and not swept and n is None:
        files = {target: text_of_body(name, target, HEAD)}
    elif name in SAMPLES and name not in KNOWN:
        raise InputError(f"kreisel new: expected a system for --sweep and --n, got the body {name}.")
    else:
        files = {target: text_of(example(find(name), n), target, swept)}
    _write(files, overwrite)
    done = f"{' and '.join(map(str, files))} written; next: kreisel {'sweep' if swept else 'run'} {target}"
    say(done, sys.stderr)  # not a line of TOML, in `kreisel new NAME > FILE`


def _write(files: Mapping[Path, str], overwrite: bool) -> None:
    from kreisel.files import require_file, written

    for path in files:
        require_file(path, overwrite)
    for path, text in files.items():
        with written(path, overwrite) as scratch:
            scratch.write_text(text, encoding="utf-8")


def text_of(sample: Example, target: Path, swept: bool = False) -> str:
    """The TOML file of a run or a sweep."""
    system = sample.model.system
    lines = [f'name = "{system.name}"', *_parameters(system, sample.parameters)]
    return _text(sample, _about(system, target, "sweep" if swept else "run"), lines, target, swept)


def _text(
    sample: Example,
    about: list[str],
    system: list[str],
    target: Path,
    swept: bool = False,
    chosen: list[str] | None = None,
) -> str:
    lines = [*about, "", "[system]", *system, "", "[state]", *_state(sample), "", "[run]"]
    lines += _run(sample, *((SWEEP_STEPS, SWEEP_EVERY) if swept else (STEPS, EVERY)))
    lines += _methods(sample) if chosen is None else chosen
    lines += commented('# observe = ["energy"]', "which Casimirs and integrals to save; default: all")
    if swept:
        lines += ["", *_sweep(sample)]
    stem = Path(target.name).with_suffix("")
    lines += ["", "[output]", f'path = "{stem}.zarr"']
    return "\n".join(lines if swept else [*lines, f'# figure = "{stem}.png"   # or .pdf, .svg']) + "\n"


def _about(system: System, target: Path, command: str) -> list[str]:
    words = f"{system.title}: {system.equations}.  {system.frame.value.capitalize()} frame.  [{system.source}]"
    scaling = [f"Units: {system.scaling}", *([system.notes] if system.notes else [])]
    return [f"{HEAD} {system.name}; run it by: kreisel {command} {target}", *comments(words, *scaling)]


def _parameters(system: System, values: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for p in system.parameters:
        meaning = f"{p.kind}: {p.meaning}"
        if p.letter in values:
            lines += commented(f"{p.letter} = {_toml(values[p.letter])}", meaning)
        elif (value := _default(p)) is not None:
            lines += commented(f"# {p.letter} = {_toml(value)}", f"{meaning}; this is the default")
    return lines


def _default(p: Parameter) -> Any:
    value = p.default.tolist() if hasattr(p.default, "tolist") else p.default
    return None if isinstance(value, list) and p.kind == "array" else value


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


def _run(sample: Example, steps: int, every: int) -> list[str]:
    return [
        *commented(f"dt = {sample.dt!r}", "step, in the unit of time"),
        *commented(f"steps = {steps:_}", f"or t_end = {steps * sample.dt:g}"),
        *commented(f"every = {every}", f"save every {every}th state"),
    ]


def _methods(sample: Example) -> list[str]:
    from kreisel.method import METHODS

    others = [m.name for m in METHODS.values() if m.applies(sample.model) and m.name != sample.method]
    orders, default = METHODS[sample.method].order_text, METHODS[sample.method].default
    beside = f"; also {', '.join(others)}: `kreisel methods`" if others else ""
    return [
        *commented(f'# method = "{sample.method}"', f"the default here{beside}"),
        *(
            []
            if default is None
            else commented(f"# order = {_toml(default)}", f"the default; {sample.method} has {orders}")
        ),
    ]


def _sweep(sample: Example) -> list[str]:
    """[sweep]: a parameter, or the momentum, from 0.8 to 1.2 of the example's value."""
    quantity, value = _varied(sample)
    low, high = _ends(value)
    return [
        "[sweep]",
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
    free = not sample.model.system.space.constraints and sample.model.system.perturbation is None
    for letter, kind in sample.model.system.space.components:
        if free and kind == "skew" and sample.model.n == 3:
            place = max(range(3), key=lambda k: abs(sample.state[letter][k]))
            return f'state."{letter}[{place}]"', sample.state[letter][place]
    numbers = [(k, v) for k, v in sample.parameters.items() if isinstance(v, float)]
    vectors = [(k, v) for k, v in sample.parameters.items() if isinstance(v, list) and isinstance(v[-1], float)]
    for letter, value in numbers:
        if all(_allowed(sample, letter, end) for end in _ends(value)):
            return f"system.{letter}", value
    for letter, vector in vectors:
        if vector[-1] and all(_allowed(sample, letter, [*vector[:-1], end]) for end in _ends(vector[-1])):
            return f'system."{letter}[{len(vector) - 1}]"', vector[-1]
    return "run.dt", sample.dt


def _ends(value: float) -> tuple[float, float]:
    low, high = sorted((round(0.8 * value, 12), round(1.2 * value, 12)))
    return low, high


def _allowed(sample: Example, letter: str, value: Any) -> bool:
    try:
        sample.model.system(**{**sample.parameters, letter: value})
    except InputError:
        return False
    return True


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
TORQUE = (
    "    torque=lambda M, *, strength: -strength * M * np.sqrt(M @ M),  # added to the rate of M: quadratic friction"
)


def forced(sample: Example, name: str, target: Path, code: Path) -> dict[Path, str]:
    """The two files of a system under forces, tried.  Raises `InputError` for a system that accepts none."""
    from kreisel.cli.configuration import read
    from kreisel.runs.planning import make_plan

    why = ""
    for method in ("splitting", "dop853"):
        files = {code: _forces(sample, name), target: _of_forces(sample, name, target, code, method)}
        with tempfile.TemporaryDirectory() as folder:
            for path, text in files.items():
                Path(folder, path.name).write_text(text, encoding="utf-8")
            try:
                asked = read(Path(folder, target.name))
                make_plan(
                    asked.model, asked.state, dt=asked.run.dt, steps=1, method=method, orientation=asked.orientation
                )
            except InputError as error:
                why = why or str(error).replace(f"{folder}/", "")
            else:
                return files
    raise InputError(f"--perturbed: no forces of this kind for {sample.model.system.name}: {why}")


def _size(sample: Example) -> float:
    """A hundredth of the rate of the motion."""
    return round(0.0005 / sample.dt, 6)


def _forces(sample: Example, name: str) -> str:
    from kreisel.system import NAMED

    system = sample.model.system
    called = next((title for title, record in NAMED.items() if record is system), None)
    if called is None or sample.model.n != 3:
        raise InputError(f"--perturbed: expected a system of `kreisel systems` with n = 3, got {system.name}.")
    parameters = ", ".join(f"{k}={v!r}" for k, v in sample.parameters.items())
    carried = [system.space.components[place] for place in system.space.carried]
    letters = [letter for letter, kind in carried if kind == "vector"]
    size = _size(sample)
    forces = POTENTIAL.format(letters[0]) if letters else TORQUE
    if letters and system.space.of_body:
        forces += DAMPING.format(size)
    return FORCES.format(
        head=HEAD, title=system.title, sample=f"{called}({parameters})", forces=forces, strength=size, name=name
    )


def _of_forces(sample: Example, name: str, target: Path, code: Path, method: str) -> str:
    system = sample.model.system
    about = [
        f"{HEAD} {system.name} --perturbed; run it by: kreisel run {target}",
        *comments(f"{system.title} under the forces of {code.name}, which is run, because this file names it."),
    ]
    lines = [
        f'file = "{code.name}"',
        f'name = "{name}"',
        *commented(f"# strength = {_size(sample)!r}", "the forces' own parameter"),
    ]
    chosen = commented(f'method = "{method}"', "the forces and the integrable motion alternate; or dop853")
    return _text(sample, about, lines, target, chosen=chosen)


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
    stem = Path(target.name).with_suffix("")
    return f"""{HEAD} {name} --lagrangian; run it by: kreisel run {target}
# The Lagrangian is in {code.name}, which is run, because this file names it.  It needs the extra reduction (JAX).

[system]
file = "{code.name}"
name = "{name}"
c = 1.0                      # the Lagrangian's own parameter

[state]
M = [0.1, 0.2, 1.5]          # axial vector: the angular momentum, in the body
P = [0.6, 0.0, 0.8]          # 3 values: the vertical, seen from the body

[run]
dt = 0.05
steps = 2_000
every = 2

[output]
path = "{stem}.zarr"
"""
