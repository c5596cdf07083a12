"""What newcomers do wrong with public functions and commands: one message that says what fits, never a traceback."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import analysis, cli, physical
from kreisel.runs.operations import executed

TOP, BODY = kr.LagrangeTop(p=(0, 0, 1)), kr.Clebsch(b=(1, 2, 4))
X0 = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
XB = BODY.state(M=(1, 0.2, 0.3), P=(0.6, 0, 0.8))
WHEELED = kr.physical.Satellite((1, 2, 2.5), kr.physical.Orbit.circular("500 km"), wheels=kr.physical.Wheels(np.eye(3)))
GYRO = kr.physical.Gyroscope.flat(3.0, 0.17, 0.15)
DESIGN = kr.Design(grid={"system.alpha": [1, 2]})
GRID: dict[str, Any] = {"dt": 0.1, "steps": 3, "path": "s.zarr", "workers": 0}
# (what is called, words of the message)
CALLS: list[tuple[Callable[[Any], Any], str]] = [
    (lambda run: kr.simulate(TOP, X0, 0.05, 1000), "Write simulate(system, x0, dt=0.05, steps=1000)"),
    (lambda run: kr.simulate(TOP, X0, steps=10), "expected dt, got none"),
    (lambda run: kr.simulate(), "Write simulate(system, x0)"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, step=3), "Did you mean 'steps'"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=3, metod="suris"), "Did you mean 'method'"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1), "steps=..."),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=3, orientation=True), "Write orientation=(1, 0, 0, 0)"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=3, orientation=False), "got False. Leave it out"),
    (lambda run: kr.simulate(TOP, X0, x0=X0, dt=0.1), "expected x0 once"),
    (lambda run: kr.simulate(kr.LagrangeTop, X0, dt=0.1, steps=3), "Give it p=..., alpha=... first"),
    (lambda run: kr.simulate("lagrange-top", X0, dt=0.1, steps=3), "such as kr.LagrangeTop(p=(0, 0, 1))"),
    (lambda run: kr.simulate(X0, TOP, dt=0.1, steps=3), "A system with its parameters was expected"),
    (lambda run: kr.simulate(TOP, ((0.1, 0.2, 1.5), (0.6, 0, 0.8)), dt=0.1, steps=3), "system.state(m=..., a=...)"),
    (lambda run: kr.simulate(TOP, np.ones(6), dt=0.1, steps=3), "system.state(m=..., a=...)"),
    (lambda run: kr.simulate(TOP, [X0, X0], dt=0.1, steps=3), "shape (lanes, ...)"),
    (lambda run: kr.simulate(TOP, None, dt=0.1, steps=3), "got None"),
    (lambda run: kr.simulate(BODY, X0, dt=0.1, steps=3), "components M, P"),
    (lambda run: kr.simulate(TOP, X0, dt="0.05", steps=3), "dt must be a positive number"),
    (lambda run: kr.simulate(TOP, X0, dt=-0.05, steps=3), "products of M and P, as in Steklov's case"),
    (lambda run: kr.simulate(TOP, X0, dt=np.nan, steps=3), "finite and at least 1e-100, got nan."),
    (lambda run: kr.simulate(TOP, X0, dt=0, steps=3), "dt must be a positive"),
    (lambda run: kr.simulate(TOP, X0, dt=np.ones(2), steps=3), "dt must be a positive number"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=0), "an integer from 1"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps="1000"), "an integer"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=10.5), "an integer"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=float("nan")), "an integer"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=[100]), "an integer"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=True), "an integer"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, every=100), "Use every <= steps"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, every=0), "every must be"),
    (lambda run: kr.simulate(WHEELED, WHEELED.state(), dt=0, t_end=9, every="3 s"), "dt must be a positive number"),
    (lambda run: kr.simulate(WHEELED, WHEELED.state(), dt=1e-320, t_end=9, every="3 s"), "at least 1e-100"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, t_end=3), "got both"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, order="4"), "order must be an integer"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, order=3), "one of its orders"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, method="rk4"), "expected one of"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, method=kr.methods()[0]), "expected a name"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, method=""), "method: expected a name"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, engine="gpu"), "An NVIDIA GPU is 'cuda'"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, project="no"), "True or False"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, observe="energy"), "a list of names"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, observe=["enegry"]), "Did you mean 'energy'"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, orientation=(0, 0, 1)), "unit quaternion"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, path=3), "needs a name such as run.zarr"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, path="."), "needs a name such as run.zarr"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, path=Path("x.zarr"), overwrite="yes"), "True or False"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, events=lambda x: x["a"][2]), "kr.Event(quantity)"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=50, impulses=(2.0, (0, 0, 1))), "'time': 2.0"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, times="1,2"), "a list of times"),
    (lambda run: kr.LagrangeTop((0, 0, 1)), "by name, p=..., alpha=..."),
    (lambda run: kr.LagrangeTop(), "give p=..."),
    (lambda run: kr.LagrangeTop(p=(0, 0, 1), beta=2), "parameters p, alpha"),
    (lambda run: kr.LagrangeTop(p="0,0,1"), "real values"),
    (lambda run: kr.LagrangeTop(p=(0, 1)), "n >= 3"),
    (lambda run: TOP.state((0, 0, 1), (0, 0, 1)), "by name, m=..., a=..."),
    (lambda run: TOP.state(m=(0, 0, 1)), "needs a"),
    (lambda run: TOP.state(m=(0, 0, 1), A=(0, 0, 1)), "components m, a"),
    (lambda run: TOP.state(m=(0, 0, 1, 2), a=(0, 0, 1)), "axial vector"),
    (lambda run: TOP.state(m="1,2,3", a=(0, 0, 1)), "real values"),
    (lambda run: kr.at(TOP, X0, 1.0, "exact"), "Write at(system, x0, times, method='exact')"),
    (lambda run: kr.at(TOP, X0), "expected times"),
    (lambda run: kr.at(TOP, X0, "now"), "times must be"),
    (lambda run: kr.at(BODY, XB, 3.0), "method='baecklund' reach the same times"),
    (lambda run: kr.at(TOP, X0, [1.0], method="baecklund", dt=0.1), "method='exact' knows its flow"),
    (lambda run: kr.at(TOP, X0, [1.0], dt=0.1), "leave dt out"),
    (lambda run: kr.drift("run.zarr"), "opened by kr.open_run(path)"),
    (lambda run: kr.drift(run.energy), "expected a run"),
    (lambda run: kr.drift(), "Write drift(run)"),
    (lambda run: kr.plot("run.zarr"), "opened by kr.open_run(path)"),
    (lambda run: kr.plot(run, run), "Write plot(run, compare=...)"),
    (lambda run: kr.plot(run, theme="drak"), "Did you mean 'dark'"),
    (lambda run: kr.view(run, 1), "Write view(run, lane=1)"),
    (lambda run: kr.view(run, "top.html"), "written by kr.view(run).save("),
    (lambda run: kr.view(run, path="top.html"), "written by kr.view(run).save("),
    (lambda run: kr.plot(run, "top.png"), "written by kr.plot(run).savefig("),
    (lambda run: WHEELED.state((0, 0, 1), wheels=(0, 0, 1)), "Satellite(..., wheels=...) has it"),
    (lambda run: kr.physical.Satellite((1, 2, 2.5), wheels=(0, 0, 1), orbit=WHEELED.orbit), "momenta="),
    (lambda run: kr.view("run.zarr"), "opened by kr.open_run(path)"),
    (lambda run: kr.open_run("nope.zarr"), "There is no archive"),
    (lambda run: kr.open_run(["run.zarr"]), "needs a name such as"),
    (lambda run: kr.open_run(), "Write open_run(path)"),
    (lambda run: kr.resume("nope.zarr"), "There is no archive"),
    (lambda run: kr.resume("run.zarr", 1000), "Write resume(path, extend=1000)"),
    (lambda run: kr.resume(run), "needs a name such as"),
    (lambda run: kr.export("out.csv", "run.zarr"), "must end in"),
    (lambda run: kr.export(run, "out.xlsx"), "must end in"),
    (lambda run: kr.export(run), "Write export(run, out)"),
    (lambda run: kr.failures(run), "the result of kr.sweep"),
    (lambda run: kr.sweep(TOP, X0, {"system.alpha": [1, 2]}, **GRID), "expected a kr.Design"),
    (lambda run: kr.sweep(TOP, X0, **GRID), "design: expected a kr.Design"),
    (lambda run: kr.sweep(TOP, X0, DESIGN, dt=0.1, steps=3), "path=..."),
    (lambda run: kr.sweep(TOP, X0, kr.Design(grid={"alpha": [1, 2]}), **GRID), "such as system.alpha"),
    (lambda run: kr.sweep(TOP, X0, kr.Design(grid={"system.alfa": [1, 2]}), **GRID), "Did you mean 'alpha'"),
    (lambda run: kr.sweep(TOP, X0, DESIGN, **{**GRID, "workers": "all"}), "number of processes"),
    (lambda run: kr.sweep(TOP, X0, DESIGN, **GRID, save="drift"), "must list some of"),
    (lambda run: kr.Design(grids={}), "Did you mean 'grid'"),
    (lambda run: kr.Event(), "Write Event(quantity)"),
    (lambda run: kr.Event("a[2]") and kr.simulate(TOP, X0, dt=1, steps=1, events=kr.Event("a[2]")), "functions of the"),
    (lambda run: kr.perturbed(kr.LagrangeTop, damping=0.1), "a system with its parameters"),
    (lambda run: kr.perturbed(TOP, 0.1), "Write perturbed(system, potential=0.1)"),
    (lambda run: kr.perturbed(TOP, potential=3), "expected a function"),
    (lambda run: kr.perturbed(TOP, potential=lambda x: x), "among m, a, g, t"),
    (lambda run: kr.nutation(BODY, XB), "Lagrange tops"),
    (lambda run: kr.nutation(run), "expected x0"),
    (lambda run: kr.cite("lagrange-top"), "kr.cite(run)"),
    (
        lambda run: physical.FreeBody.ellipsoid(semi_axes=(1, 2, 3)),
        "FreeBody.ellipsoid has no argument 'semi_axes'. Its arguments are: mass, diameters,",
    ),
    (
        lambda run: physical.Satellite((1, 2, 2.5), WHEELED.orbit, plates=physical.Plate((1, 0, 0), (0, 0, 1), 1.0)),
        "plates: expected a list of Plate(normal, centre, area), got Plate",
    ),
    (lambda run: kr.simulate(GYRO, GYRO.state(0.1, 9.0), dt="-2 ms", t_end="1 s"), "multiples of 0.1"),
    (lambda run: kr.simulate(GYRO, GYRO.state(0.1, 9.0), dt="2 ms", t_end="-1 s"), "multiples of 0.1"),
    (
        lambda run: kr.sweep(WHEELED, {}, kr.Design(grid={"state.atitude": [1, 2]}), **GRID),
        "expected spin, axis, attitude, momentum, got 'atitude'",
    ),
    (lambda run: kr.code(TOP, X0, dt=0.1, language="fortran"), "expected one of c, cpp, cuda"),
    (lambda run: kr.propagator(TOP), "needs a step dt"),
    (lambda run: kr.propagator(TOP, X0, dt=0.1), "by name"),
    (lambda run: kr.propagator(TOP, dt=0.1).steps(X0), "expected n"),
    (lambda run: kr.propagator(TOP, dt=0.1).steps([0.1, 0.2], 10), "these 6 values"),
    (lambda run: kr.propagator(TOP, dt=0.1).at(X0, 3.0), "Use .steps(state, n)"),
    (lambda run: kr.tangent("run.zarr"), "expected a run"),
    (lambda run: kr.systems("x"), "expected no arguments"),
    (lambda run: kr.methods("x"), "expected no arguments"),
    (lambda run: kr.lab.investigate(), "Write investigate(candidate)"),
    (lambda run: kr.lab.investigate("clebsh"), "Did you mean 'clebsch'"),
    (lambda run: kr.lab.investigate("satellite"), "satellite has no map to investigate"),
    (
        lambda run: kr.lab.investigate(lambda z: (1 - 1.4 * z[0] ** 2, z[0]), names=("x", "y")),
        "fractions.Fraction('1.4')",
    ),
    (lambda run: kr.lab.investigate(lambda x: x), "names=('x', 'y')"),
    (lambda run: analysis.section(run), "Write section(run, quantity)"),
    (lambda run: analysis.section(run, "b[1]"), "not a component of the state"),
    (lambda run: analysis.section(run, "a"), "'a[0]'"),
    (lambda run: analysis.frequencies(run, "a[9]"), "'a[0]'"),
    (lambda run: analysis.frequencies(run), "Write frequencies(run, quantity)"),
    (lambda run: analysis.euler_angles(run), "orientation=(1, 0, 0, 0)"),
    (lambda run: analysis.compare(run), "Write compare(run, second_run)"),
    (lambda run: analysis.megno(TOP), "Write megno(system, x0, dt=..., steps=...)"),
    (lambda run: kr.export(run, "x.aem"), "epoch: expected the date"),
    (lambda run: physical.Gyroscope(), "expected mass"),
    (lambda run: physical.Gyroscope(mas=1), "Did you mean 'mass'"),
    (lambda run: physical.SubmergedBody(volume=1), "Did you mean 'displaced_mass'"),
    (lambda run: physical.SubmergedBody(buoyant=1), "argument 'buoyant'. Its arguments are: mass"),
    (lambda run: physical.Gyroscope.flat(), "Write Gyroscope.flat("),
    (lambda run: physical.Gyroscope.flat(mass=-3, axial_moment=0.17, lever=0.15), "a finite number > 0"),
    (lambda run: physical.FreeBody((1, 1, 9)), "the sum of the other two"),
    (lambda run: physical.Satellite(moments=(1, 2, 3)), "Its arguments are: inertia"),
    (lambda run: physical.Orbit(), "expected semi_major_axis"),
    (lambda run: physical.Plate(), "expected normal"),
    (lambda run: physical.SubmergedBody(), "expected mass"),
    # arguments of another type, by the signature; and what only looks like numbers
    (lambda run: kr.code(TOP, X0, dt=0.1, language={}), "wgsl, got {}"),
    (lambda run: kr.code(TOP, X0, dt=0.1, language=["c"]), "wgsl, got ['c']"),
    (lambda run: kr.fit(TOP, 3, free=["p"], x0=X0, dt=0.1), "expected an xarray.Dataset"),
    (lambda run: kr.fit(TOP, run, free=[["p"]], dt=0.1), "a list of names such as"),
    (lambda run: kr.nutation(TOP, {1: 2}), "components m, a"),
    (lambda run: kr.propagator(TOP, dt=0.1).steps({1: 2}, 1), "components m, a"),
    (lambda run: kr.perturbed(TOP, damping=0.1, inner=run["a"]), "expected inner of the type int"),
    (lambda run: kr.view(run, mesh=3), "mesh: expected the name of a file"),
    (lambda run: kr.view(run, mesh=b"body.stl"), "mesh: expected the name of a file"),
    (lambda run: analysis.megno(TOP, X0, dt=0.1, steps=20, seed="a"), "seed"),
    (lambda run: analysis.megno(TOP, X0, dt=0.1, steps=20, seed=-1), "seed must be an integer"),
    (lambda run: analysis.angular_velocity(run, frame=np.zeros(3)), "expected frame of the type str"),
    (lambda run: kr.units.measured(run, {"m": (0, 0, 1)}), "expected a run and its scales"),
    (lambda run: kr.units.measured(time="ms"), "Write measured(run, time='ms')"),
    (lambda run: physical.read_added_mass(range(3)), "needs the name of a text file"),
    (lambda run: physical.SubmergedBody(1.0, [1e-320] * 3), "Use other units"),
    (lambda run: physical.SubmergedBody(1.0, (1, 2, 2.5), linear_drag=[[1], [1, 2]]), "must be six values"),
    (lambda run: physical.Orbit.circular(5e5, primary="Earth"), "primary: expected"),
    (lambda run: physical.Orbit(7e6, primary=physical.Primary("x", -1.0, 0.0)), "mu must be a finite number > 0"),
    (lambda run: physical.Orbit(7e6).at(np.inf), "time: expected finite values"),
    (lambda run: physical.Satellite((1, 2, 2.5), physical.Orbit(7e6)).angles(3), "expected a run"),
    (lambda run: physical.Satellite((1, 2, 2.5), physical.Orbit(7e6)).angles(run), "expected the run of a satellite"),
    (lambda run: physical.FreeBody((1, 2, 2.5)).rotation((1, 0.1, 0.2)).flips(1e19), "flips"),
    (lambda run: TOP.state(m=np.ma.masked_array([1.0, 2, 3], [1, 0, 0]), a=(0, 0, 1)), "a masked entry"),
    (lambda run: TOP.state(m=[[1, 2, 3], np.ma.masked_array([1, 2, 3], [1, 0, 0])], a=(0, 0, 1)), "a masked entry"),
    (lambda run: TOP.state(m=kr.units.registry().Quantity([0, 0, 1], "kg"), a=(0, 0, 1)), "or a unit"),
    (lambda run: TOP.state(m=np.array([1 + 2j, 2, 3], object), a=(0, 0, 1)), "must be real values"),
    (lambda run: TOP.state(m=[np.datetime64("NaT")] * 3, a=(0, 0, 1)), "must be real values"),
    (lambda run: kr.LagrangeTop(p=[int] * 3), "must be real values"),
    (lambda run: kr.simulate(TOP, X0, dt=np.timedelta64(1, "s"), steps=3), "dt must be a positive number"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, times=[np.datetime64("2020-01-01")]), "a list of times"),
    (lambda run: kr.simulate(TOP, X0, dt=0.1, steps=9, impulses={"time": 0.5, "m": [1j] * 3}), "finite values for m"),
    (lambda run: kr.at(TOP, X0, np.ma.masked_array([1.0, 2.0], [1, 0])), "times must be a finite number"),
]
ATTRIBUTES: list[tuple[Callable[[], Any], type[Exception], str]] = [
    (lambda: X0.M, AttributeError, "components m, a"),
    (lambda: X0["M"], KeyError, "components m, a"),
    (lambda: TOP.p, AttributeError, ".params['p']"),
    (lambda: TOP.simulate(X0), AttributeError, "kr.simulate(system, x0"),
    (lambda: kr.simulte, AttributeError, "Did you mean 'simulate'"),
    (lambda: kr.Lagrangetop, AttributeError, "Did you mean 'LagrangeTop'"),
]
GOOD = """[system]
name = "lagrange-top"
p = [0, 0, 1]
[state]
m = [0.1, 0.2, 1.5]
a = [0.6, 0, 0.8]
[run]
dt = 0.05
steps = 1e2
[output]
path = "run.zarr"
"""
COMMANDS: list[tuple[list[str], str]] = [
    (["run", "nowhere.toml"], "No file nowhere.toml"),
    (["run", "."], "is a folder"),
    (["run", "run.zarr"], "is a folder"),
    (["run", "run.toml", "--set", "run.step=3"], "Did you mean 'steps'"),
    (["run", "run.toml", "--set", "dt=3"], "Did you mean run.dt"),
    (["run", "run.toml", "--set", "run.dt"], "SECTION.KEY=VALUE"),
    (["run", "run.toml", "--set", "run.dt=[1"], "as in TOML"),
    (["run", "run.toml", "--set", "runn.dt=1"], "Did you mean 'run'"),
    (["run", "run.toml", "--set", "sweep.parallel=2"], "is for `kreisel sweep`"),
    (["run", "run.toml", "--set", "system.alfa=1"], "Did you mean 'alpha'"),
    (["run", "run.toml", "--set", "run.steps=many"], "steps must be an integer"),
    (["run", "run.toml", "--set", "run.dt.x=1"], "dt.x"),
    (["run", "run.toml"], "--overwrite"),
    (["sweep", "run.toml"], "needs a section [sweep]"),
    (["resume", "nowhere.zarr"], "There is no archive"),
    (["resume", "run.zarr", "--extend", "10"], "expected more"),
    (["resume", "run.zarr", "--extend", "1e1"], "expected more"),
    (["resume", "run.zarr", "--extend", "2 h"], "extend must be an integer"),
    (["check", "run.toml"], "cannot be read"),
    (["plot", "run.toml"], "cannot be read"),
    (["plot", "run.zarr", "-o", "x.gif"], "ends in .png"),
    (["plot", "run.zarr"], "exists already"),
    (["plot", "run.zarr", "-o", "x.png", "--show", "a_max"], "expected a sweep"),
    (["plot", "~nobody-of-this-name/run.zarr"], "no such user"),
    (["view", "run.zarr", "--lane", "3", "-o", "x.html"], "--lane"),
    (["export", "run.zarr", "x.xlsx"], "must end in"),
    (["systems", "clebsh"], "Did you mean 'clebsch'"),
    (["systems", "gyroscop"], "Did you mean 'gyroscope'"),
    (["investigate", "satellite"], "satellite has no map to investigate"),
    (["investigate", "free-body"], "`kreisel new free-body`"),
    (["code", "freebody"], "Did you mean 'free-body'"),
    (["methods", "sures"], "Did you mean 'suris'"),
    (["investigate", "nowhere.py"], "No file"),
    (["investigate", "empty.py"], "def step(x)"),
    (["code", "euler-topp"], "Did you mean 'euler-top'"),
    (["code", "euler-top", "--set", "J=1,2,3", "--set", "J=2,3,4"], "--set: expected J once"),
    (["code", "run.toml", "--n", "4"], "--n: not for 'run.toml'"),
    (["code", "run.toml", "--no-orientation"], "--no-orientation: not for 'run.toml'"),
    (["code", "free-body", "--n", "4"], "--n: not for 'free-body'"),
    (["verify", "theorm"], "theorm"),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a TOML file, its archive and figure, and an empty Python file."""
    folder = tmp_path_factory.mktemp("mistakes")
    (folder / "run.toml").write_text(GOOD)
    (folder / "empty.py").write_text("x = 1\n")
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit):
        patch.chdir(folder)
        patch.setattr("sys.argv", ["kreisel", "run", "run.toml"])
        cli.main()
    return folder


@pytest.fixture(scope="module")
def run() -> Any:
    return kr.simulate(TOP, X0, dt=0.05, steps=50)


@pytest.mark.parametrize(("call", "words"), CALLS, ids=[f"{k}-{words}" for k, (_, words) in enumerate(CALLS)])
def test_a_call(call: Callable[[Any], Any], words: str, run: Any, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kr.InputError) as error:
        call(run)
    assert words in str(error.value), str(error.value)


@pytest.mark.parametrize(("look", "kind", "words"), ATTRIBUTES, ids=[words for _, _, words in ATTRIBUTES])
def test_an_attribute(look: Callable[[], Any], kind: type[Exception], words: str) -> None:
    with pytest.raises(kind) as error:
        look()
    assert words in str(error.value)


@pytest.mark.parametrize(("arguments", "words"), COMMANDS, ids=[" ".join(a) for a, _ in COMMANDS])
def test_a_command(
    arguments: list[str], words: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setattr("sys.argv", ["kreisel", *arguments])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    message = capsys.readouterr().err
    assert stopped.value.code == 2 and words in message and "Traceback" not in message, message


@pytest.mark.parametrize("steps", [20, 20.0, 2e1, np.float32(20), np.int64(20), np.array(20)])
def test_whole_numbers_of_any_kind(steps: Any) -> None:
    assert kr.simulate(TOP, X0, dt=0.05, steps=steps, every=steps, order=2.0).sizes["time"] == 2


LANES = 300


def lanes_but(good: Any, bad: Any, lane: int) -> Any:
    """An array of lanes that are alike but one."""
    array = np.tile(np.asarray(good, dtype=float), (LANES, *[1] * np.ndim(good)))
    array[lane] = bad
    return array


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: kr.LagrangeTop(p=lanes_but((0, 0, 1), np.nan, 17)), "Lane 17: lagrange-top's parameter p must be fin"),
        (lambda: kr.LagrangeTop(p=(0, 0, 1), alpha=lanes_but(1, 0, 123)), "Lane 123: alpha"),
        (lambda: kr.EulerTop(J=lanes_but((1, 2, 3), (1, -2, 3), 299)), "Lane 299: No body has"),
        (lambda: kr.ClebschGeneral(a=lanes_but((1, 2, 4), (1, 1, 4), 0), b=(1, 2, 3)), "Lane 0: The entries of a"),
        (lambda: TOP.state(m=lanes_but((0, 0, 1), np.inf, 44), a=(0, 0, 1)), "Lane 44: state component m"),
        (lambda: TOP.state(m=(0, 0, 1), a=lanes_but((0, 0, 1), 0, 81)), "Lane 81: a must not be the zero vector"),
        (lambda: kr.Neumann(b=(1, 2, 4)).state(x=lanes_but((0, 0, 1), (0, 0, 2), 55), q=(1, 0, 0)), "Lane 55: The st"),
        (lambda: physical.FreeBody((1, 2, 2.5)).state(lanes_but((0, 0, 1), np.nan, 31)), "Lane 31: spin"),
        (lambda: physical.FreeBody((1, 2, 2.5)).orientation(lanes_but((1, 0, 0, 0), 2, 66)), "Lane 66: attitude"),
        (lambda: kr.propagator(TOP, dt=0.1).steps(lanes_but(np.ones(6), np.nan, 13), 3), "in lane 13"),
        (lambda: TOP.state(m=np.ones((LANES, 4)), a=(0, 0, 1)), "state component m must be a skew"),
        (lambda: kr.HeavyTop(J=[[1, 2, 0], [0, 1, 0], [0, 0, 1]], A=(0, 0, 1)), "heavy-top's parameter J must be symm"),
    ],
)
def test_the_bad_lane_of_an_ensemble_is_named(call: Callable[[], Any], words: str) -> None:
    """A fault that all lanes share, and a matrix that could be read as lanes, are not one lane's."""
    with pytest.raises(kr.InputError) as error:
        call()
    assert words in str(error.value), str(error.value)
    assert words.startswith("Lane") == str(error.value).startswith("Lane")


def test_a_lane_that_is_lost_in_a_run_is_named() -> None:
    state = TOP.state(m=lanes_but((0.1, 0.2, 1.5), 1e200, 12)[:20], a=(0.6, 0, 0.8))
    with pytest.raises(kr.RunError, match="in lane 12"), pytest.warns(kr.AccuracyWarning):
        kr.simulate(TOP, state, dt=0.05, steps=50)


def test_large_ensembles_are_shown_briefly() -> None:
    rng = np.random.default_rng(0)
    tops = kr.LagrangeTop(p=rng.normal(size=(10_000, 3)))
    state = tops.state(m=rng.normal(size=(10_000, 3)), a=rng.normal(size=(10_000, 3)))
    for subject in (tops, state, state.axial, kr.propagator(tops, dt=0.1)):
        assert 20 < len(repr(subject)) < 400 and "10000" in repr(subject)
    assert all(len(subject._repr_html_()) < 2000 for subject in (tops, state))
    assert repr(TOP) == "lagrange-top(p=[0.0, 0.0, 1.0], alpha=1.0)"


def test_numbers_in_messages_are_written_as_numbers() -> None:
    with pytest.raises(kr.InputError, match=r"got -1/3\."):
        kr.KirchhoffRevolution(a1=Fraction(-1, 3), a3=1, c1=1, c3=1)
    with pytest.raises(kr.InputError, match=r"got \(0.5, 3\)"):
        kr.simulate(TOP, X0, dt=0.1, steps=(np.float64(0.5), np.int64(3)))


def test_nonsense_found_by_the_trial() -> None:
    recursive: list[Any] = []
    recursive.append(recursive)
    run = kr.simulate(TOP, X0, dt=0.1, steps=2, orientation=(1, 0, 0, 0))
    for call, words in (
        (lambda: kr.HeisenbergChain(n=recursive), "n"),
        (lambda: kr.Kirchhoff(C=np.ones((3, 3)), B=-np.eye(3)).state(M=(1, 2, 3), P=[[-1], [1, 2]]), "P"),
        (lambda: kr.fit(TOP, run.isel(time=0), free=["a"], dt=0.1), "x0"),
        (lambda: kr.units.si(1.0, np.array(["2020-01-01"], dtype="M8[D]"), "mass"), "unit"),
        (lambda: kr.units.si(np.array([0.1 + 0j]), "kg m^2", "inertia"), "inertia must be real"),
        (lambda: physical.FreeBody((1, 2, 2.5)).rotation(5e-324, axis=(1, 1, 1)), "range of doubles"),
    ):
        with pytest.raises(kr.InputError, match=words):
            call()


def test_no_private_name_and_no_name_itself_is_suggested() -> None:
    assert "Did you mean" not in kr.errors.hint("n", ["n", "_n"])
    with pytest.raises(AttributeError) as error:
        TOP.derived  # noqa: B018
    assert "_derived" not in str(error.value)


@pytest.mark.parametrize("call", [lambda: kr.simulte, lambda: TOP.stat])
def test_python_adds_no_second_suggestion(call: Callable[[], Any], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(AttributeError) as error:
        call()
    sys.__excepthook__(error.type, error.value, None)
    assert capsys.readouterr().err.count("Did you mean") == 1


def test_the_command_warns_without_its_source(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    words = ["run", "run.toml", "--overwrite", "--set", "run.dt=10.0", "--set", "run.steps=3"]
    monkeypatch.setattr("sys.argv", ["kreisel", *words, "--set", "output.path=again.zarr"])
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with pytest.raises(SystemExit):
            cli.main()
    said = capsys.readouterr().err
    assert "kreisel: warning: dt = 10 is" in said and ".py:" not in said, said


def test_an_error_inside_is_not_taken_for_a_wrong_call() -> None:
    def broken(x: Any) -> Any:
        raise TypeError("of the user's own function")

    with pytest.raises(TypeError, match="of the user's own function"):
        kr.errors.explained(broken)(1)


@pytest.mark.parametrize(
    ("model", "options", "said"),
    [
        (TOP, {"dt": 10.0}, "more than half a revolution"),
        (kr.LagrangeTop(p=(0, 0, 1), alpha=3.0), {"dt": 0.05}, "a body has 0 < alpha"),
        (kr.LagrangeTop(p=(0, 0, 1), alpha=-1.0), {"dt": 0.05}, "a body has 0 < alpha"),
        (TOP, {"dt": 2.0, "method": "kahan", "steps": 60}, "oscillates by"),
    ],
)
def test_warnings_of_what_makes_no_sense(model: Any, options: dict[str, Any], said: str) -> None:
    with pytest.warns(kr.AccuracyWarning, match=said) as caught:
        kr.simulate(model, X0, **{"steps": 3, **options})
    assert all(Path(w.filename) == Path(__file__) for w in caught)


def test_no_warning_of_what_makes_sense(recwarn: pytest.WarningsRecorder) -> None:
    for model, options in ((TOP, {"dt": 1.0}), (TOP, {"dt": 50.0, "method": "exact"}), (BODY, {"dt": 0.05})):
        kr.simulate(model, X0 if model is TOP else XB, steps=3, **options)
    kr.simulate(kr.LagrangeTop(p=(0, 0, 1), alpha=2.0), X0, dt=0.05, steps=3)
    chosen = kr.simulate(TOP, X0, dt=100.0, steps=10, order="auto", tol=1e-3)  # its step has been measured
    assert chosen.dt * 1.5 > np.pi
    assert not recwarn.list


def test_results_of_measured_are_named() -> None:
    wheel = kr.physical.Gyroscope.flat(mass=3, axial_moment=0.17, lever=0.15)
    shown = kr.units.measured(kr.simulate(wheel, wheel.state(tilt=0.5, spin=20), dt=1e-3, steps=2), time="ms")
    for call in (kr.cite, lambda it: kr.simulate(wheel, it.isel(time=-1), dt=1e-3, steps=2)):
        with pytest.raises(kr.InputError, match=r"the run itself, got|got a result of units.measured"):
            call(shown)


def test_a_file_of_a_system_that_exits_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import sys\n\nsys.exit(3)\n", encoding="utf-8")
    with pytest.raises(kr.InputError, match=r"mine.py, line 3: SystemExit: 3\. Call sys\.exit only below"):
        executed(tmp_path / "mine.py")


def test_new_names_the_way_to_lanes_of_a_body() -> None:
    with pytest.raises(kr.InputError, match=r"a section \[sweep\.grid\] in the file of `kreisel new gyroscope`"):
        cli.new.new("gyroscope", None, None, None, swept=True, perturbed=False, lagrangian=False)
