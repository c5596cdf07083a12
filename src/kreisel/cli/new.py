"""The command new: a commented TOML file of any system or body, and the Python file that belongs to it."""

from __future__ import annotations

import inspect
import json
import sys
import tempfile
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from kreisel.cli.checkcases import files_of
from kreisel.cli.output import OverwriteFile, a_path, app, arg, opt, say, system_names
from kreisel.errors import InputError
from kreisel.record.contract import System
from kreisel.system import find

if TYPE_CHECKING:
    from kreisel.runs.examples import Example

HEAD = "# Written by `kreisel new`"  # the mark by which --overwrite recognises a file of Kreisel
STEPS, EVERY = 10_000, 5
SWEEP_STEPS, SWEEP_EVERY = 2048, 4
VARIED = 10  # values of a varied quantity
GYROSTATS = ("zhukovsky-volterra", "kovalevskaya-gyrostat")


# -- bodies in SI units, with data that a person would begin with ---------------------------------------


WIDTH = 118


class Sample(NamedTuple):
    """A body to begin with, as sections of a file; comments on their lines, by "section.key"."""

    about: str
    body: dict[str, Any]
    state: dict[str, Any]
    run: dict[str, Any]
    comments: dict[str, str]


ORBIT = {"altitude": "500 km", "inclination": "97.4 deg"}
SAMPLES = {
    "gyroscope": Sample(
        "A spinning top of 100 g on its point, tilted by 30 degrees, at 3000 rpm: it precesses and nods.",
        {"shape": "flat", "mass": "100 g", "axial_moment": "360 g cm^2", "lever": "3 cm"},
        {"tilt": "30 deg", "spin": "3000 rpm"},
        {"dt": "1 ms", "t_end": "10 s", "every": "5 ms"},
        {
            "body.shape": "leave it out for a top that is not flat, and add transverse_moment, about the point",
            "body.axial_moment": "about the axis of symmetry",
            "body.lever": "from the point to the centre of mass",
            "state.tilt": "from the upward vertical",
            "state.spin": "about the axis; precession and nutation are 0: released from rest",
        },
    ),
    "heavy-body": Sample(
        "A plate of 1.2 kg on a pivot 11 cm from its centre of mass, which rotates at 300 rpm about its third axis.",
        {
            "shape": "about_centre",
            "mass": "1.2 kg",
            "inertia": ["40 kg cm^2", "90 kg cm^2", "130 kg cm^2"],
            "arm": ["0 cm", "5 cm", "10 cm"],
        },
        {"angular_velocity": ["0 rpm", "60 rpm", "300 rpm"]},
        {"dt": "1 ms", "t_end": "10 s", "every": "5 ms", "order": 4},
        {
            "body.shape": "the inertia is about the centre of mass; leave it out for one about the pivot",
            "body.inertia": 'or a tensor, [[[40, 0, 0], [0, 90, 0], [0, 0, 130]], "kg cm^2"]',
            "body.arm": "from the pivot to the centre of mass, along the body axes",
            "state.angular_velocity": "along the body axes; the third points up",
        },
    ),
    "free-body": Sample(
        "A book thrown into the air, spinning about its middle axis: it flips again and again.",
        {"mass": "0.9 kg", "sides": ["3 cm", "17 cm", "24 cm"]},
        {"spin": ["0.2 rpm", "120 rpm", "0.1 rpm"]},
        {"dt": "2 ms", "t_end": "20 s", "every": "10 ms"},
        {
            "body.sides": "of a box; or diameters of an ellipsoid; or inertia = [[...]], any tensor",
            "state.spin": "along the body axes",
        },
    ),
    "ellipsoid": Sample(
        "An ellipsoid of 30 x 20 x 10 cm in water, as heavy as that water, moving along its long axis.",
        {"semi_axes": ["15 cm", "10 cm", "5 cm"], "density": "998.2 kg/m^3", "fluid_density": "998.2 kg/m^3"},
        {"velocity": ["10 cm/s", "1 mm/s", "0 m/s"], "angular_velocity": ["0 rpm", "0.2 rpm", "0.1 rpm"]},
        {"dt": "50 ms", "t_end": "100 s", "every": "100 ms"},
        {"state.velocity": "along the body axes; this motion is unstable: the body swings broadside on"},
    ),
    "submerged-body": Sample(
        "A torpedo of 20 kg in water: added masses, drag, its centre of mass 2 cm ahead of buoyancy and 2 cm below.",
        {
            "mass": "20 kg",
            "inertia": ["0.1 kg m^2", "1.6 kg m^2", "1.6 kg m^2"],
            "added_mass": [1.0, 18.0, 18.0, 0.0, 1.6, 1.6],
            "center_of_mass": ["2 cm", "0 cm", "-2 cm"],
            "linear_drag": [2.0, 10.0, 10.0, 0.1, 2.0, 2.0],
            "quadratic_drag": [1.0, 60.0, 60.0, 0.05, 5.0, 5.0],
        },
        {"velocity": ["1.5 m/s", "0 m/s", "0 m/s"], "angular_velocity": ["0 deg/s", "3 deg/s", "3 deg/s"]},
        {"dt": "20 ms", "t_end": "30 s"},
        {
            "body.added_mass": "diagonal of the 6 x 6 matrix: kg and kg m^2",
            "body.linear_drag": "N s/m and N m s",
            "body.quadratic_drag": "N s^2/m^2 and N m s^2",
        },
    ),
    "binary": Sample(
        "Didymos and its moon Dimorphos, on a slightly eccentric orbit: the moon librates.",
        {
            "primary": {"mass": "5.557e11 kg", "diameters": ["849 m", "851 m", "620 m"]},
            "secondary": {"mass": "4.3e9 kg", "diameters": ["177 m", "174 m", "116 m"]},
        },
        {"semi_major_axis": "1206 m", "eccentricity": 0.03, "spin1": ["0 rad/s", "0 rad/s", "7.722e-4 rad/s"]},
        {"dt": "1 hour", "t_end": "30 days"},
        {
            "body.primary.diameters": 'or mesh = "shape.obj", length = "km"; love and lag for tides',
            "state.semi_major_axis": "of the secondary relative to the primary; or separation of a circular orbit",
            "state.spin1": "of the primary, along its axes; without spin2 the secondary rotates with the orbit",
        },
    ),
    "satellite": Sample(
        "A CubeSat of three units at 500 km, tumbling at 5 degrees a second, with a weak magnet.",
        {"units": 3, "magnetic_moment": ["0 A m^2", "0 A m^2", "0.01 A m^2"], "orbit": ORBIT},
        {"spin": ["4 deg/s", "2.5 deg/s", "-1.5 deg/s"]},
        {"dt": "10 s", "t_end": "190 min"},
        {
            "body.units": 'of 10 cm, along axis 1; or inertia = [[...]] of any satellite, or mesh = "bus.stl"',
            "body.orbit.altitude": "or elements: semi_major_axis, eccentricity, inclination, node, perigee",
            "state.spin": "along the body axes; leave it out for a satellite at rest against its orbit",
        },
    ),
    "asteroid": Sample(
        "A moon like Saturn's Hyperion on its eccentric orbit: it tumbles chaotically.",
        {
            "mass": "5.62e18 kg",
            "diameters": ["380 km", "290 km", "228 km"],
            "orbit": {"semi_major_axis": "1.481e6 km", "eccentricity": 0.1, "primary": "saturn"},
        },
        {"spin": ["0 deg/day", "4 deg/day", "35 deg/day"]},
        {"dt": "3 hour", "t_end": "1 year"},
        {
            "body.diameters": "of an ellipsoid of constant density",
            "body.orbit.primary": "or earth, sun, or { name = ..., mu = ..., radius = ... }",
            "state.spin": "along the body axes",
        },
    ),
}


def text_of_body(name: str, target: Path) -> str:
    """The TOML file of a body, ready to run."""
    from kreisel.physical.tables import kinds

    sample, kind = SAMPLES[name], kinds()[name]
    keys = (
        f"Keys of [body] and [state] are arguments of kr.physical.{kind.__name__} and of its state; values without a "
        "unit are in SI, vectors along the body axes."
    )
    optional = ", ".join(k for k in inspect.signature(kind).parameters if k not in (*sample.body, "self"))
    tables = {"body": sample.body, "state": sample.state, "run": sample.run}
    sections = {key: [*_section(table, key, sample.comments)] for key, table in tables.items()}
    sections["body"] = [f'kind = "{name}"', *comments(f"more: {optional}"), *sections["body"]]
    return _file(name, [sample.about, keys], sections, target)


def _file(name: str, about: Iterable[str], sections: dict[str, list[str]], target: Path, verb: str = "run") -> str:
    """A TOML file of sections of lines, with comments in front and the section [output]."""
    lines = [f"{HEAD} {name}; run it by: kreisel {verb} {target}", *comments(*about)]
    figure = [f'# figure = "{target.stem}.png"   # or .pdf, .svg'] * (verb == "run")
    for section, settings in (*sections.items(), ("output", [f'path = "{target.stem}.zarr"', *figure])):
        lines += ["", f"[{section}]", *settings]
    return "\n".join(lines) + "\n"


def _section(table: Mapping[str, Any], section: str, comments: Mapping[str, str]) -> Iterator[str]:
    inner = {k: v for k, v in table.items() if isinstance(v, dict)}
    for key, value in table.items():
        if key not in inner:
            yield from commented(f"{key} = {json.dumps(value)}", comments.get(f"{section}.{key}"))
    for key, value in inner.items():
        yield from ("", f"[{section}.{key}]", *_section(value, f"{section}.{key}", comments))


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
        lambda: (*SAMPLES, *system_names()),
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
        files = forced(example(system_named(name), n), f"my-{name}", target, code)
    elif name in SAMPLES and not swept and n is None:
        files = {target: text_of_body(name, target)}
    elif name in SAMPLES and name not in KNOWN:
        raise InputError(f"kreisel new: expected a system for --sweep and --n, got the body {name}.")
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

    if name in SAMPLES and name not in KNOWN:
        raise InputError(
            f"expected a system, got {name}, a body of kr.physical. `kreisel new {name}` writes a TOML file of its run."
        )
    return find(name, KNOWN, SAMPLES)


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
    from kreisel.system import NAMED

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
