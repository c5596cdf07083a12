"""The command checkcase: exact motions of spinning bodies, and the grade of a simulator's trajectory."""

from __future__ import annotations

import csv
import json
import textwrap
from decimal import Context
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import kreisel
from kreisel.cli.output import AsJson, OverwriteFile, a_path, app, arg, opt, print_json, save_picture, say
from kreisel.errors import InputError
from kreisel.system import NAMED, REGISTRY

if TYPE_CHECKING:
    from kreisel.checkcases import Case

DIGITS = 20  # digits of the printed exact motion
AXES = {3: "xyz", 4: "wxyz"}


@app.command()
def checkcase(
    name: str | None = arg("A check case; none: list them.", lambda: kreisel.checkcases.cases()),
    at: list[float] | None = opt("A time in s at which the state is printed."),
    table: Path | None = a_path("Write the exact motion as CSV; columns are named with units.", "--csv"),
    rows: int = opt("Rows of the CSV.", default=301, min=2, max=1_000_000),
    grade: list[Path] | None = a_path(
        "Grade a trajectory, a CSV or NetCDF file; several with different steps give the order.", "--grade"
    ),
    units: str | None = opt("Of the rates graded: rad/s, deg/s or rpm."),
    quaternion: str | None = opt("wxyz or xyzw."),
    direction: str | None = opt("Of the attitude graded: 'body to space' or 'space to body'."),
    frame: str | None = opt("Of the rates graded: body or space."),
    time: str | None = opt("Unit of the times graded: s, ms or min."),
    step: list[float] | None = opt("Step in s of each file graded, if it is not the distance of its rows."),
    figure: Path | None = a_path("Draw the case into .png, .pdf or .svg.", "--figure"),
    as_json: AsJson = False,
    overwrite: OverwriteFile = False,
) -> None:
    """Print exact motions, or grade a simulator: kreisel checkcase tumbling-brick --grade mine.csv."""
    checkcases = kreisel.checkcases
    if name is None:
        if at or table or grade or figure:
            raise InputError("kreisel checkcase: expected the name of a case; `kreisel checkcase` lists them.")
        cases = [checkcases.case(key) for key in checkcases.cases()]
        if as_json:
            print_json([{**entry.given(), "title": entry.title, "source": entry.source} for entry in cases])
            return
        for entry in cases:
            say(f"{entry.name:22} {entry.title}")
        print("\nkreisel checkcase NAME: the data, the start, the exact answer; --grade FILE: grade a trajectory.")
        return
    case = checkcases.case(name)
    options = {"units": units, "quaternion": quaternion, "direction": direction, "frame": frame, "time": time}
    options = {key: value for key, value in options.items() if value is not None}
    if (options or step) and not grade:
        raise InputError(f"--{next(iter(options), 'step')}: expected a trajectory to grade, --grade FILE, got none.")
    if grade:
        _grade(case, grade, step or [], options, as_json)
    if table is not None:
        _write(case, table, rows, overwrite)
    if figure is not None:
        from kreisel.viewer.charts import plot_case

        save_picture(plot_case(case), figure, overwrite)
    if not (grade or table or figure):
        _print(case, at or [], as_json)


def _print(case: Case, at: list[float], as_json: bool) -> None:
    from kreisel.checkcases.catalogue import CERTAINTY
    from kreisel.checkcases.laws import UNITS, exact, unit_of
    from kreisel.runs.settings import finite_number

    times = [Fraction(finite_number(t, "--at")) for t in at] or [case.duration]
    states = [case.exact(time) for time in times]
    if as_json:
        motion = [
            {"time": float(time), "angular_velocity": _texts(state[:3]), "attitude": _texts(state[3:7])}
            for time, (state, _) in zip(times, states, strict=True)
        ]
        print_json({**case.given(), "title": case.title, "source": case.source, "exact": motion})
        return
    say(f"{case.name}: {case.title}")
    print(textwrap.fill(case.about, 100))
    print(f"Source: {case.source}\n")
    for key, text in case.numbers.items():
        values = np.atleast_1d(exact(text))
        in_si = f"  = {' '.join(f'{float(v):.10g}' for v in values)} in SI" if UNITS[unit_of(text)] != 1 else ""
        say(f"  {key.replace('_', ' '):20} {text}{in_si}")
    say(f"  {'duration':20} {float(case.duration):g} s")
    say("  Angular velocity along the body axes; attitude a unit quaternion (w, x, y, z), body to space.")
    if "gravity" in case.numbers:
        say("  Gravity along -z of space; the pivot is the origin, arm the way from it to the centre of mass.")
    for time, (state, bounds) in zip(times, states, strict=True):
        print(f"\nExact at {float(time):g} s, error at most {max(bounds[:7]):.1e} (rad/s, 1):")
        degrees = [v / exact("1 deg") for v in state[:3]]
        for letter, text, in_degrees in zip("xyz", _texts(state[:3]), _texts(degrees), strict=True):
            say(f"  angular velocity {letter}   {text:>24} rad/s   {in_degrees:>24} deg/s")
        for letter, text in zip("wxyz", _texts(state[3:7]), strict=True):
            say(f"  attitude {letter}           {text:>24}")
    print(f"\n{textwrap.fill(f'{case.digits} digits are certain: {CERTAINTY}.', 100)}")
    for answer in case.answers(case):
        say(f"  {answer.meaning}: {answer.value:.15g} {answer.unit}   ({answer.source})")


def _texts(values: list[Fraction]) -> list[str]:
    context = Context(prec=DIGITS)
    return [str(context.divide(v.numerator, v.denominator)) for v in values]


def _write(case: Case, path: Path, rows: int, overwrite: bool) -> None:
    from kreisel.files import written

    truth = case.reference(case.times(rows))
    columns: dict[str, Any] = {"time_s": truth.time.values}
    for key, variable in truth.data_vars.items():
        unit = variable.attrs["units"]
        ending = "" if unit == "1" else "_" + unit.replace("/", "_").replace("^", "").replace(" ", "_")
        values = variable.values
        if values.ndim == 1:
            columns[f"{key}{ending}"] = values
        else:
            columns.update({f"{key}_{a}{ending}": values[:, k] for k, a in enumerate(AXES[values.shape[1]])})
    with written(path, overwrite) as scratch, scratch.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
    say(f"{path} written: {rows} rows of the exact motion, 0 to {float(case.duration):g} s")


def _grade(case: Case, paths: list[Path], steps: list[float], options: dict[str, Any], as_json: bool) -> None:
    from kreisel.checkcases.reading import read

    if len(steps) > len(paths):
        raise InputError(f"--step: expected at most one for each file of --grade, {len(paths)}, got {len(steps)}.")
    files = zip(paths, [*steps, *[None] * len(paths)], strict=False)
    runs = [read(path, case, step=step, **options) for path, step in files]
    result = case.grade(runs[0].times, step=runs[0].step, runs=runs[1:], **runs[0].quantities)
    if as_json:
        print_json({"reading": [run.reading for run in runs], **result.data()})
        return
    for path, run in zip(paths, runs, strict=True):
        for sentence in (f"{path}:", *(f"  {sentence}" for sentence in run.reading)):
            say(sentence)
    print(f"\n{result}")


SYSTEMS = {"free": "euler-top", "field": "heavy-top", "wheel": "zhukovsky-volterra", "fluid": "kirchhoff-revolution"}
ROWS_OF_A_RUN = 3000
PYTHON = """{head} checkcase {name}: Kreisel's run of the check case, graded.
import numpy as np

import kreisel as kr

case = kr.checkcases.case("{name}")
body = kr.{title}({parameters})
x0 = body.state({state})
run = kr.simulate(body, x0, dt={dt!r}, steps={steps}, {call}orientation={orientation})
momentum = run.M.values{stored}  # I w, kg m^2/s, along the body axes
w = np.linalg.solve(np.array(case.given()["inertia"]), momentum.T).T
print(case.grade(run.time.values, angular_velocity=w, attitude=run.g.values))
"""
TOML = """{head} checkcase {name}; run it by: kreisel run {toml}
# {about}
# SI units: M in kg m^2/s along the body axes, time in s.  {python} grades such a run.

[system]
name = "{system}"
{parameters}

[state]
{state}
orientation = {orientation}  # body to space, as w, x, y, z

[run]
{method}dt = {dt!r}
steps = {steps}

[output]
path = "{stem}.zarr"
"""


def files_of(name: str, toml: Path, python: Path, head: str) -> dict[Path, str]:
    """The TOML and the Python file that run a case.  Raises `InputError` for a law that no system has."""
    from kreisel import checkcases
    from kreisel.checkcases.catalogue import law_of

    case, kind = checkcases.case(name), law_of(name)
    if kind not in SYSTEMS:
        with_run = ", ".join(key for key in checkcases.cases() if law_of(key) in SYSTEMS)
        raise InputError(f"new checkcase: expected a case that is a system of Kreisel, {with_run}; got {name}.")
    system, parameters, state = _as_system(case, kind)
    dt = float(f"{float(case.duration) / ROWS_OF_A_RUN:.3g}")
    method = {"heavy-top": ("variational", 8), "kirchhoff-revolution": ("exact", None)}.get(system, (None, None))
    settings = {key: value for key, value in zip(("method", "order"), method, strict=True) if value is not None}
    words = {
        "method": "".join(f"{key} = {json.dumps(value)}\n" for key, value in settings.items()),
        "call": "".join(f"{key}={value!r}, " for key, value in settings.items()),
        "head": head, "name": name, "dt": dt, "steps": int(float(case.duration) / dt), "about": case.title,
        "orientation": case.given()["attitude"], "toml": toml.name, "python": python.name, "stem": toml.stem,
        "system": system, "title": next(key for key, record in NAMED.items() if record is REGISTRY[system]),
        "stored": f" - np.array({case.numeric()['h']})" if kind == "wheel" else "",
    }  # fmt: skip
    lines = {"parameters": parameters, "state": state}
    texts = {key: "\n".join(f"{k} = {v}" for k, v in values.items()) for key, values in lines.items()}
    calls = {key: ", ".join(f"{k}={v}" for k, v in values.items()) for key, values in lines.items()}
    return {toml: TOML.format(**words, **texts), python: PYTHON.format(**words, **calls)}


def _as_system(case: Case, kind: str) -> tuple[str, dict[str, Any], dict[str, Any]]:
    p, w = case.numeric(), np.array([float(v) for v in case.angular_velocity])
    inertia = np.array(p["I"])
    J, momentum = np.trace(inertia) / 2 * np.eye(3) - inertia, inertia @ w
    straight = bool((J == np.diag(np.diag(J))).all())
    if kind == "fluid":
        names = {"a1": inertia[0, 0], "a3": inertia[2, 2], "c1": p["A"][0][0], "c3": p["A"][2][2]}
        state = {"M": momentum.tolist(), "P": (np.array(p["A"]) @ [float(v) for v in case.further[:3]]).tolist()}
        return SYSTEMS[kind], {key: 1 / float(value) for key, value in names.items()}, state
    if kind == "wheel":
        return SYSTEMS[kind], {"J": np.diag(J).tolist(), "h": p["h"]}, {"M": (momentum + p["h"]).tolist()}
    if kind == "free" and straight:
        return SYSTEMS[kind], {"J": np.diag(J).tolist()}, {"M": momentum.tolist()}
    from kreisel.checkcases.laws import rotation

    up = [float(v) for v in rotation(case.given()["attitude"])[2]]
    A = [-float(k) for k in p.get("k", (0, 0, 0))]
    return "heavy-top", {"J": J.tolist(), "A": A}, {"M": momentum.tolist(), "P": up}
