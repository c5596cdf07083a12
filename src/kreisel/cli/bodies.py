"""Files of `kreisel new` for bodies in SI units, with data that a person would begin with."""

from __future__ import annotations

import inspect
import json
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

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


def text_of_body(name: str, target: Path, head: str) -> str:
    """The TOML file of a body, ready to run."""
    from kreisel.physical.tables import kinds

    sample, kind = SAMPLES[name], kinds()[name]
    lines = [f"{head} {name}; run it by: kreisel run {target}", *comments(sample.about)]
    lines += comments(
        f"Keys of [body] and [state] are arguments of kr.physical.{kind.__name__} and of its state; values without a "
        "unit are in SI, vectors along the body axes."
    )
    lines += ["", "[body]", f'kind = "{name}"', *_section(sample.body, "body", sample.comments)]
    used = {*sample.body, "self"}
    more = [k for k in inspect.signature(kind).parameters if k not in used]
    lines[lines.index("[body]") + 2 : lines.index("[body]") + 2] = comments(f"more: {', '.join(more)}")
    lines += ["", "[state]", *_section(sample.state, "state", sample.comments)]
    lines += ["", "[run]", *_section(sample.run, "run", sample.comments)]
    lines += ["", "[output]", f'path = "{target.stem}.zarr"', f'# figure = "{target.stem}.png"   # or .pdf, .svg']
    return "\n".join(lines) + "\n"


def _section(table: Mapping[str, Any], section: str, comments: Mapping[str, str]) -> Iterator[str]:
    """Lines of a section, then of the sections in it."""
    inner = {k: v for k, v in table.items() if isinstance(v, dict)}
    for key, value in table.items():
        if key not in inner:
            yield from commented(f"{key} = {json.dumps(value)}", comments.get(f"{section}.{key}"))
    for key, value in inner.items():
        yield ""
        yield f"[{section}.{key}]"
        yield from _section(value, f"{section}.{key}", comments)


def commented(setting: str, meaning: str | None) -> list[str]:
    """A setting and its meaning, after it or above."""
    line = setting if meaning is None else f"{setting:<27}  # {' '.join(meaning.split())}"
    return [line] if meaning is None or len(line) <= WIDTH else [*comments(meaning), setting]


def comments(*paragraphs: str) -> list[str]:
    """Lines of comment."""
    return [f"# {line}" for text in paragraphs for line in textwrap.wrap(" ".join(text.split()), WIDTH - 2)]
