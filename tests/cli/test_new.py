"""kreisel new: what it writes parses, plans and runs as it is, for every system and body."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel import cli
from kreisel.bodies import BODIES, KNOWN
from kreisel.cli.configuration import parse, parse_sweep, read, read_sweep
from kreisel.cli.new import _varied, forced, text_of, text_of_body
from kreisel.runs.examples import Example, example
from kreisel.runs.plan import Plan
from kreisel.runs.planning import make_plan
from kreisel.sweeps.ensemble import Sweep
from kreisel.sweeps.store import Store
from kreisel.sweeps.sweep import _checked_description
from sizes import FULL
from support import EXAMPLES

FREE = [name for name, system in KNOWN.items() if system.n is None]
FORCED = {
    name: "splitting" for name in ("euler-top", "heavy-top", "lagrange-top", "kirchhoff", "hess-appelrot", "neumann")
} | {"lyapunov": "dop853"}


def command(monkeypatch: pytest.MonkeyPatch, folder: Path, *words: str) -> int:
    monkeypatch.chdir(folder)
    monkeypatch.setattr("sys.argv", ["kreisel", *words])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0)


def planned(asked: Any) -> Plan:
    settings = asked.run
    kept = {"dt": settings.dt, "steps": settings.steps, "every": settings.every, "method": settings.method}
    return make_plan(asked.model, asked.state, **kept, orientation=asked.orientation)


@pytest.mark.parametrize("name", KNOWN)
def test_every_system_has_a_file_that_plans(name: str) -> None:
    made = example(KNOWN[name])
    text = text_of(made, Path(f"{name}.toml"))
    assert text.startswith("# Written by `kreisel new`") and max(map(len, text.split("\n"))) <= 200
    plan = planned(parse(tomllib.loads(text)))
    assert plan.rows == 2001
    assert plan.scheme.name == made.method
    for p in KNOWN[name].parameters:  # every parameter is explained, given or with its default
        assert p.default is not None or f"\n{p.letter} = " in text


OTHERS = [name for name in BODIES if name not in ("binary", "binary-with-third-body")]  # terms of the one with a moon


@pytest.mark.parametrize("name", BODIES if FULL else OTHERS)
def test_a_step_is_chosen_for_every_body(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """order="auto" of a body by its name, in a TOML file and in Python: the tolerance is met."""
    asked = 'order = "auto"\ntol = 1e-4\nsteps = 20\nobserve = []\n'
    text = text_of(example(KNOWN[name]), Path("body.toml"))
    (tmp_path / "body.toml").write_text(text.replace("steps = 10_000", asked))
    assert command(monkeypatch, tmp_path, "run", "body.toml") == 0
    saved, given = xr.open_zarr(tmp_path / "body.zarr"), parse(tomllib.loads(text))
    model = given.model
    options = {"orientation": given.orientation, "observe": [], "progress": False}
    run = kr.simulate(model, given.state, dt=given.run.dt, steps=20, every=5, **options, order="auto", tol=1e-4)
    truth = kr.simulate(model, given.state, dt=given.run.dt / 8, steps=160, every=40, **options)
    for letter in model.system.space.letters:
        assert (saved[letter].values == run[letter].values).all()
        assert abs(run[letter] - truth[letter]).max() < 1e-4 * abs(truth[letter]).max()


def angular_velocity(made: Example) -> np.ndarray:
    """(3,) in the body, of a template of a body in SI units, by the moments that its file has."""
    return np.array(made.state["M"]) / made.parameters["moments"]


def test_a_satellite_starts_at_rest_against_its_orbit() -> None:
    made = example(KNOWN["satellite"])
    a, tilt = made.parameters["semi_major_axis"], made.parameters["inclination"]
    rate = 2 * np.pi / 5677.0  # the period of a circle 500 km high, 94.6 minutes
    normal = np.array([0.0, -np.sin(tilt), np.cos(tilt)])  # pericentre and node along x
    assert a == pytest.approx(6_878_137)
    in_space = kr.algebra.rotation_matrix(np.array(made.orientation)) @ angular_velocity(made)
    assert np.linalg.norm(in_space - rate * normal) < 0.01 * rate
    text = " ".join(text_of(made, Path("x.toml")).replace("\n# ", " ").split())
    assert "kg m^2/s" in text and "at rest against the orbit" in text


def off_the_vertical(run: xr.Dataset, tilt: float) -> np.ndarray:
    """The angle of axis 1 to the vertical, degrees, on a circle 500 km high that begins at its node, along x."""
    turn = 2 * np.pi * run.time.values / 5677.0
    up = np.stack([np.cos(turn), np.sin(turn) * np.cos(tilt), np.sin(turn) * np.sin(tilt)], -1)
    axis = kr.algebra.rotation_matrix(run.g.values)[..., 0]
    return np.degrees(np.arccos(np.clip(np.einsum("tk,tk->t", up, axis), -1, 1)))


def test_a_satellite_hangs_down() -> None:
    """Its longest axis points away from the Earth, as one under the gravity gradient does that begins so."""
    made = example(KNOWN["satellite"])
    run = kr.simulate(made.model, made.state, dt=60.0, steps=95, orientation=made.orientation)
    assert off_the_vertical(run, made.parameters["inclination"]).max() < 2
    asked = read(EXAMPLES / "satellite.toml")  # released 15 degrees off: ten orbits
    run = kr.simulate(asked.model, asked.state, dt=60.0, steps=950, orientation=asked.orientation)
    run = run.rename(attitude="g")
    angle = off_the_vertical(run, asked.model.params["inclination"])
    assert angle[0] == pytest.approx(15, abs=0.01) and 14 < angle.max() < 18


def test_templates_offer_wheels_where_a_body_may_have_them() -> None:
    turning, wheels = {"inertia": (1.0, 1.0, 1.5)}, kr.physical.Wheels([[0, 0, 1]])
    bodies: dict[str, Any] = {
        "free-body": lambda: kr.physical.FreeBody(**turning, wheels=wheels),
        "heavy-body": lambda: kr.physical.HeavyBody(1.0, **turning, arm=(0, 0, 0.1), wheels=wheels),
        "gyroscope": lambda: kr.physical.Gyroscope(1.0, 0.1, 0.2, 0.1, wheels=wheels),
    }
    for name, body in bodies.items():
        offered = "wheels" in text_of_body(name, Path("x.toml")).partition("\n[state]")[0]
        if offered:
            body().model()
        else:
            with pytest.raises(kr.InputError, match=r"^wheels: expected a free body"):
                body().model()


@pytest.mark.parametrize("name", KNOWN)
def test_a_template_turns_as_a_person_would_have_it(name: str) -> None:
    """In SI units below 5 degrees a second, else 12 rad in the unit of time and 0.1 rad a step; M is explained."""
    made = example(KNOWN[name])
    state, system = made.model.state(**made.state), KNOWN[name]
    text = text_of(made, Path("x.toml"))
    if system.velocity is not None:
        values = [getattr(state, letter) for letter in system.space.letters]
        Omega = np.linalg.norm(made.model.call(system.velocity, *values)) / np.sqrt(2)
        assert Omega < (np.radians(5) if system in BODIES.values() else 12)
        assert Omega * made.dt < 0.1
    if {"m", "M"} & made.state.keys():
        assert "angular momentum" in text or "I Omega" in text


@pytest.mark.parametrize("name", FREE)
def test_in_four_dimensions_or_sites(name: str) -> None:
    made = example(KNOWN[name], 4)
    assert planned(parse(tomllib.loads(text_of(made, Path("x.toml"))))).model.n == 4


@pytest.mark.parametrize("name", KNOWN)
def test_every_system_has_a_sweep_whose_lanes_plan(name: str, tmp_path: Path) -> None:
    made = example(KNOWN[name])
    description, file, path = parse_sweep(tomllib.loads(text_of(made, Path("x.toml"), swept=True)))
    store = Store(tmp_path / path, Sweep(_checked_description(description, file), file))
    assert store.sweep.lanes.total == 10
    for lane in (0, 9):
        values = store.sweep.lanes.values(lane, lane + 1)
        sections = store.sweep.lanes.filled(values)
        assert store.sweep.plan(sections, np.arange(1), {(q.section, q.letter) for q in values})
    assert _varied(made)[1] != 0


@pytest.mark.parametrize("name", FORCED)
def test_under_forces_of_your_own(name: str, tmp_path: Path) -> None:
    made = example(KNOWN[name])
    code, file = tmp_path / "my.py", tmp_path / "my.toml"
    for path, text in forced(made, "my-body", file, code).items():
        path.write_text(text)
    asked = read(file, ["run.steps=20"])  # `forced` has planned it
    assert (asked.name, asked.run.steps, asked.run.method) == ("my-body", 20, FORCED[name])
    assert asked.model.system.perturbation is not None


def test_commands_write_and_refuse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    assert command(monkeypatch, tmp_path, "new", "lagrange-top") == 0
    printed = capsys.readouterr()
    assert "lagrange-top.toml written" in printed.err and not printed.out
    written = (tmp_path / "lagrange-top.toml").read_text()
    (tmp_path / "lagrange-top.toml").write_text(written.replace("dt = 0.02", "dt = 0.01"))
    assert command(monkeypatch, tmp_path, "new", "lagrange-top") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert "dt = 0.01" in (tmp_path / "lagrange-top.toml").read_text()
    assert command(monkeypatch, tmp_path, "new", "lagrange-top", "--overwrite") == 0
    assert (tmp_path / "lagrange-top.toml").read_text() == written
    (tmp_path / "mine.toml").write_text("a = 1\n")
    assert command(monkeypatch, tmp_path, "new", "lagrange-top", "-o", "mine.toml", "--overwrite") == 2
    assert (tmp_path / "mine.toml").read_text() == "a = 1\n"
    for words, said in (
        (["lagrange-tap"], "Did you mean 'lagrange-top'"),
        (["top"], "Did you mean 'euler-top' or 'heavy-top'"),
        ([], "expected a body, gyroscope"),
        (["lagrange-top", "--lagrangian"], "a new name"),
        (["gyroscope", "--sweep"], "expected a system for --sweep"),
        (["lagrange-top", "-o", "x.txt"], "ends in .toml"),
        (["spin-chain", "--perturbed"], "n = 3"),
        (["lagrange-top", "--perturbed", "--sweep"], "several"),
        (["satellite", "--n", "4"], "satellite: expected n = 3, got n = 4"),
        (["komarov", "--n", "4"], "komarov: expected n = 3, got n = 4"),
    ):
        assert command(monkeypatch, tmp_path, "new", *words) == 2
        message = capsys.readouterr().err
        assert said in message and "Traceback" not in message
    assert sorted(p.name for p in tmp_path.iterdir()) == ["lagrange-top.toml", "mine.toml"]


def test_a_few_really_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    for words in (["lagrange-top"], ["lagrange-top", "--perturbed"]):
        assert command(monkeypatch, tmp_path, "new", *words) == 0
        file = capsys.readouterr().err.split()[-1]
        few = ("--set", "run.steps=1e2", "--set", "run.every=5", "--no-figure")
        assert command(monkeypatch, tmp_path, "run", file, *few) == 0
        assert kr.open_run(tmp_path / file.replace(".toml", ".zarr")).sizes["time"] == 21
    assert command(monkeypatch, tmp_path, "new", "lagrange-top", "--sweep") == 0
    file = capsys.readouterr().err.split()[-1]
    assert command(monkeypatch, tmp_path, "sweep", file, "--workers", "0", "--set", "run.steps=200") == 0
    assert int(kr.open_run(tmp_path / "lagrange-top-sweep.zarr").failed.sum()) == 0
    assert read_sweep(tmp_path / file)[0]["run"]["steps"] == 2048


def test_a_lagrangian_of_your_own_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert command(monkeypatch, tmp_path, "new", "my-top", "--lagrangian") == 0
    assert command(monkeypatch, tmp_path, "run", "my-top.toml", "--set", "run.steps=20", "--no-figure") == 0
    assert kr.open_run(tmp_path / "my-top.zarr").attrs["method"] == "lagrangian"
