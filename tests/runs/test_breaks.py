"""`times`, `impulses` and `events` of `kr.simulate`: rows and changes within steps, to memory and to disk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.graph.recording import Recording
from kreisel.runs import integration
from kreisel.storage import simulate as simulating
from kreisel.sweeps.sweep import check_archive
from sizes import full
from support import contents

BODY = kr.perturbed(
    kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
    potential=lambda P, t, *, k: k * np.sin(t) * P[0],
    torque=lambda M: -0.001 * M,
    params={"k": 0.1},
)
START = {"M": np.array([0.3, 0.2, 1.1]), "P": np.array([0.6, 0.0, 0.8])}
TOP = kr.LagrangeTop(p=(0, 0, 1))
AXIS = {"m": np.array([0.1, 0.2, 0.5]), "a": np.array([0.6, 0.0, 0.8])}
CLEBSCH = kr.Clebsch(b=(1, 2, 3))
IMPULSES = [{"time": 1.33, "M": (0.1, 0, 0.3)}, {"time": 1.0, "M": (0, 0.2, 0)}]


def height(x: Any) -> Any:
    return x["P"][2]


def back(x: Any) -> Any:
    return {**x, "M": -x["M"]}


STRIKE = kr.Event(height, back)
LOW = kr.Event(lambda x: x["P"][2] + 0.3, rising=False)


def test_rows_at_times_leave_the_steps_as_they_are() -> None:
    times = [0.0, 0.7, 0.71, 1.333, 2.0, 9.0]
    run = kr.simulate(BODY, START, dt=0.05, times=times)
    steps = kr.simulate(BODY, START, dt=0.05, steps=180)
    at = kr.propagator(BODY, dt=0.05).to(START, times)
    np.testing.assert_array_equal(run.time, times)
    assert run.M[-1].values.tobytes() == steps.M[-1].values.tobytes()
    np.testing.assert_allclose(run.M, at["M"], rtol=0, atol=1e-11)
    assert abs(run.balance - run.balance[0]).max() < 1e-10 and abs(run.work[-1]) > 1e-3


@pytest.mark.parametrize(
    ("method", "order", "bound"),
    [("exact", None, 1e-14), ("baecklund", None, 3e-3), ("dop853", None, 1e-7), ("kahan", 4, 1e-4)],
)
def test_times_of_every_kind_of_method(method: str, order: int | None, bound: float) -> None:
    times = np.array([0.3, 1.0, 2.71])
    run = kr.simulate(TOP, AXIS, dt=0.05, times=times, method=method, order=order)
    np.testing.assert_allclose(run.a, kr.at(TOP, AXIS, times).a, rtol=0, atol=bound)
    assert "every" in run.attrs and not kr.drift(run).broken.any()


def test_an_impulse_is_added_at_its_time() -> None:
    """As by the propagator in a loop; a row at its time is after it, and the work counts it."""
    run = kr.simulate(BODY, START, dt=0.05, times=[0.5, 1.0, 1.3, 1.33, 1.34, 9.0], impulses=IMPULSES)
    p, x = kr.propagator(BODY, dt=0.05), START
    rows = [p.to(x, 0.5)["M"]]
    x = p.to(x, 1.0)
    x["M"] = x["M"] + (0, 0.2, 0)
    rows += [x["M"], p.to(x, 1.3, time=1.0)["M"]]
    x = p.to(x, 1.33, time=1.0)
    x["M"] = x["M"] + (0.1, 0, 0.3)
    rows += [x["M"], p.to(x, 1.34, time=1.33)["M"], p.to(x, 9.0, time=1.33)["M"]]
    np.testing.assert_allclose(run.M, rows, rtol=0, atol=1e-11)
    assert abs(run.balance - run.balance[0]).max() < 1e-10 < 0.01 < abs(run.work[3] - run.work[0])
    by_steps = kr.simulate(BODY, START, dt=0.05, steps=180, every=60, impulses=IMPULSES)
    assert by_steps.M[-1].values.tobytes() == run.M[-1].values.tobytes()


@pytest.mark.parametrize("method", ["kahan", "variational"])
def test_impulses_of_bodies_without_forces(method: str) -> None:
    struck = kr.simulate(
        TOP, AXIS, dt=0.01, steps=100, method=method, order=4, impulses={"time": 0.5, "m": (0.2, 0, 1)}
    )
    x = kr.at(TOP, AXIS, 0.5)
    after = kr.at(TOP, {"m": x.m + np.array([0.2, 0, 1]), "a": x.a}, 0.5)
    np.testing.assert_allclose(struck.a[-1], after.a, rtol=0, atol=1e-6)


def test_what_an_impulse_leaves_is_conserved() -> None:
    """Across p the momentum along p stays, along p it does not; of an action nothing is known."""
    top = kr.perturbed(TOP, potential=lambda a, *, k: k * a[2] ** 2, params={"k": 0.01})

    def conserved(**breaks: Any) -> Any:
        table = kr.drift(kr.simulate(top, AXIS, dt=0.1, steps=50, **breaks))
        assert not table.broken.any()
        return table.conserved

    across = conserved(impulses={"time": 2.0, "m": (0.1, 0, 0)})
    along = conserved(impulses={"time": 2.0, "m": (0, 0, 0.1)})
    assert across["noether[2]"] and not along["noether[2]"] and not across["casimir[1]"]
    assert not conserved(events=kr.Event(lambda x: x["a"][2], lambda x: x)).any()
    assert conserved(events=kr.Event(lambda x: x["a"][2]))["casimir[1]"]


def test_an_event_stops_the_run_where_it_happens() -> None:
    exact = kr.propagator(TOP, method="exact", dt=0.05)
    _, time, _ = exact.until(AXIS, lambda x: x["a"][2], 9.0)
    for method, off in (("exact", 1e-13), ("baecklund", 2e-3)):
        run = kr.simulate(TOP, AXIS, dt=0.05, steps=400, every=7, method=method, events=kr.Event(lambda x: x["a"][2]))
        assert abs(run.time[-1] - time) < off and abs(run.a[-1, 2]) < 1e-14 and run.attrs["stopped"] == run.time[-1]
        np.testing.assert_allclose(run.time[:-1], 0.35 * np.arange(len(run.time) - 1))
        assert json.loads(run.attrs["event_times"]) == [[float(run.time[-1]), 0]]
    rising = kr.simulate(TOP, AXIS, dt=0.05, steps=400, events=kr.Event(lambda x: x["a"][2], rising=True))
    assert rising.time[-1] > time + 0.1


def test_events_act_as_in_a_loop_with_the_propagator() -> None:
    run = kr.simulate(BODY, START, dt=0.05, steps=600, events=STRIKE)
    p, x, time, times = kr.propagator(BODY, dt=0.05), START, 0.0, []
    while time < 30.0:
        x, time, crossed = p.until(x, height, 30.0, time=time)
        if crossed:
            times.append(time)
            x["M"] = -x["M"]
    assert len(times) > 5
    np.testing.assert_allclose([t for t, _ in json.loads(run.attrs["event_times"])], times, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.M[-1], x["M"], rtol=0, atol=1e-8)
    assert abs(run.balance - run.balance[0]).max() < 1e-10


def test_bodies_in_pairs() -> None:
    tops = kr.LagrangeTop(p=(0, 0, 1), alpha=[0.5, 0.7])
    pair = kr.perturbed(tops, pair_potential=lambda a1, a2, t: -0.1 * np.cos(t) * (a1 @ a2), pairs=[(0, 1)])
    x0 = pair.state(m=[(0.1, 0.2, 1.5), (0.3, -0.2, 1.1)], a=[(0.6, 0, 0.8), (0, 0.6, 0.8)])
    impulse = {"time": 2.03, "m": [(0, 0, 0.1), (0.1, 0, 0)]}
    event = kr.Event(lambda x: x["a"][0] @ x["a"][1] - 0.5, lambda x: {**x, "m": x["m"] * (1, 1, -1)})
    run = kr.simulate(pair, x0, dt=0.1, steps=100, impulses=impulse, events=event)
    assert json.loads(run.attrs["event_times"]) and abs(run.balance - run.balance[0]).max() < 1e-7
    assert abs(run.work).max() > 0.01


@pytest.mark.parametrize(
    "asked",
    [
        *full({"times": np.linspace(0.3, 30, 50)}, {"steps": 1000, "every": 50, "impulses": IMPULSES}),
        {"steps": 1000, "every": 50, "events": STRIKE},
        {"steps": 1000, "every": 3, "events": [LOW, STRIKE]},
        {"times": np.linspace(0.0, 40, 33), "impulses": IMPULSES, "events": STRIKE},
    ],
)
def test_runs_to_disk_go_on_bit_for_bit(asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, events = kr.simulate(BODY, START, dt=0.05, **asked), asked.get("events", ())
    monkeypatch.setattr(simulating, "CHECKPOINT_SECONDS", 0.0)
    advance, calls = integration.Integration._advance, 0

    def cut(self: integration.Integration) -> None:
        nonlocal calls
        calls += 1
        if calls == 6:
            raise KeyboardInterrupt
        advance(self)

    path = tmp_path / "run.zarr"
    monkeypatch.setattr(integration.Integration, "_advance", cut)
    with pytest.raises(KeyboardInterrupt):
        kr.simulate(BODY, START, dt=0.05, path=path, **asked)
    kept = kr.open_run(path.with_name("run.zarr.part")).load()  # the rows that are in the checkpoint only
    assert kept.time.size and kept.equals(whole.isel(time=slice(kept.time.size)))
    assert all(kept[name].attrs["kind"] == whole[name].attrs["kind"] for name in whole.data_vars)
    if events:
        with pytest.raises(kr.InputError, match=r"events: expected the events of the run.*kr.resume\(path, events="):
            kr.resume(path, system=BODY)
    run = kr.resume(path, system=BODY, events=events).load()
    for name in ("time", *whole.data_vars):
        assert run[name].values.tobytes() == whole[name].values.tobytes(), name
    for name in ("rows", "stopped", "event_times", "impulses", "events"):
        assert run.attrs.get(name) == whole.attrs.get(name)
    assert check_archive(path)[1] == []


def test_runs_that_cannot_be_longer(tmp_path: Path) -> None:
    kr.simulate(BODY, START, dt=0.05, times=[1.0, 2.0], path=tmp_path / "times.zarr")
    with pytest.raises(kr.InputError, match="at given times"):
        kr.resume(tmp_path / "times.zarr", extend=100, system=BODY)
    kr.simulate(BODY, START, dt=0.05, steps=200, events=LOW, path=tmp_path / "stopped.zarr")
    for longer in ({"extend": 300}, {}):
        with pytest.raises(kr.InputError, match="that an event stopped at 3") as error:
            kr.resume(tmp_path / "stopped.zarr", system=BODY, events=LOW, **longer)
        assert "lengthens it" not in str(error.value)


def test_a_stopped_run_continues_from_its_last_row() -> None:
    """At the next two changes of sign, which are those that SciPy finds, of either direction."""
    top, inertia, row, start = kr.HeavyTop(J=(1, 2, 3), A=(0, 0, 1)), np.array([5, 4, 3]), START, 0.0
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "events": lambda t, y, inertia: y[3] - 0.2}
    y0 = np.concatenate([START["M"], START["P"]])
    true = solve_ivp(spinning, (0, 40), y0, args=(inertia,), **options)
    for time, state in zip(true.t_events[0][:3], true.y_events[0][:3], strict=True):
        event = kr.Event(lambda x: x["P"][0] - 0.2)
        run = kr.simulate(top, row, dt=0.02, steps=2000, method="variational", order=8, events=event)
        row, start = run.isel(time=-1), start + float(run.time[-1])
        np.testing.assert_allclose(np.hstack([start, row.M, row.P]), [time, *state], rtol=0, atol=1e-9)


def test_impulses_go_on_in_a_longer_run(tmp_path: Path) -> None:
    longer = kr.simulate(BODY, START, dt=0.05, steps=200, every=10, impulses=IMPULSES)
    kr.simulate(BODY, START, dt=0.05, steps=100, every=10, impulses=IMPULSES, path=tmp_path / "run.zarr")
    run = kr.resume(tmp_path / "run.zarr", extend=200, system=BODY)
    assert run.M.values.tobytes() == longer.M.values.tobytes()


@pytest.mark.parametrize(
    ("every", "more"),
    [
        (7, {"impulses": [*IMPULSES, {"time": 0.97, "M": (0, 0.1, 0)}]}),
        (7, {"events": STRIKE}),
        (3, {"events": STRIKE, "impulses": IMPULSES}),
    ],
)
def test_an_extended_run_is_a_longer_one(
    every: int, more: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether or not its last row is one of the longer run: each byte of the archive."""
    options = {"dt": 0.05, "every": every, "progress": False, **more}
    kr.simulate(BODY, START, steps=140, path=tmp_path / "long.zarr", **options)
    for steps, seconds in ((27, 0.0), (68, 0.0), (70, 0.0), (41, 1e9)):
        monkeypatch.setattr(simulating, "CHECKPOINT_SECONDS", seconds)
        path = tmp_path / f"{steps}.zarr"
        kr.simulate(BODY, START, steps=steps, path=path, **options)
        kr.resume(path, extend=140, system=BODY, events=more.get("events", ()))
        assert contents(path) == contents(tmp_path / "long.zarr"), steps


@pytest.mark.parametrize("asked", [{"times": [0.5, 1.3, 1.33, 7.0]}, {"steps": 211, "every": 10, "events": LOW}])
def test_archives_do_not_depend_on_the_clock(
    asked: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that was killed after the event that ends it, or after its last row, ends there again."""
    kr.simulate(BODY, START, dt=0.05, path=tmp_path / "whole.zarr", **asked)
    expected = contents(tmp_path / "whole.zarr")
    monkeypatch.setattr(simulating, "CHECKPOINT_SECONDS", 0.0)
    kr.simulate(BODY, START, dt=0.05, path=tmp_path / "often.zarr", **asked)
    assert contents(tmp_path / "often.zarr") == expected
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(
            "kreisel.storage.run_archive.RunArchive.finish", lambda _: (_ for _ in ()).throw(KeyboardInterrupt)
        )
        kr.simulate(BODY, START, dt=0.05, path=tmp_path / "run.zarr", **asked)
    whole, kept = (kr.open_run(tmp_path / name).load() for name in ("whole.zarr", "run.zarr.part"))
    assert kept.equals(whole)
    events = asked.get("events", ())
    kr.resume(tmp_path / "run.zarr", system=BODY, events=events)
    assert contents(tmp_path / "run.zarr") == expected


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"times": [1, 0.5]}, "times: expected a list of times from 0 on"),
        ({"times": "soon"}, "times: expected a list"),
        ({"times": [0]}, "times: expected a time after 0"),
        ({"times": [-1, 2]}, "times: expected a list"),
        ({"times": [1], "steps": 3}, "times: expected only rows at these times"),
        ({"times": [1], "order": "auto", "tol": 1e-6}, "times: expected an order that is given"),
        ({"steps": 9, "impulses": {"time": 0, "M": (0, 0, 1)}}, "impulses: expected times after 0"),
        ({"steps": 9, "impulses": {"time": 1.5, "M": (0, 0, 1)}}, "up to the end of the run, 0.9"),
        ({"steps": 9, "impulses": {"M": (0, 0, 1)}}, "impulses: expected a dict such as"),
        ({"steps": 9, "impulses": "kick"}, "impulses: expected a dict such as"),
        ({"steps": 9, "impulses": {"time": 0.5, "P": (0, 0, 1)}}, "impulses: expected an increment of M"),
        ({"steps": 9, "impulses": {"time": 0.5, "M": (0, 0)}}, "impulses: expected 3 finite values"),
        ({"steps": 9, "impulses": {"time": 0.5, "M": "x"}}, "impulses: expected finite values for M"),
        (
            {"steps": 9, "impulses": {"time": 0.5, "M": (0, 0, 1)}, "method": "dop853"},
            "whose steps may differ, such as 'splitting'.*'variational', or 'kahan' of order 4, got",
        ),
        ({"steps": 9, "events": height}, "events: expected kr.Event"),
        ({"steps": 9, "events": kr.Event(lambda x: x["P"])}, "a quantity with one value"),
        ({"steps": 9, "events": kr.Event(lambda x: np.nan)}, "expected a finite number"),
        ({"steps": 99, "events": kr.Event(height, lambda x: 3)}, "expected an action that returns the state"),
        ({"steps": 99, "events": kr.Event(height, lambda x: {**x, "M": x["M"] * np.nan})}, "M must be finite"),
        ({"steps": 9, "events": STRIKE, "method": "dop853"}, "whose steps may differ"),
    ],
)
def test_bad_input_is_refused(asked: dict[str, Any], message: str) -> None:
    with pytest.raises(kr.InputError, match=message):
        kr.simulate(BODY, START, dt=0.1, **asked)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"events": kr.Event(lambda x: x["M"][0])}, "the state has momentum, attitude, not 'M'"),
        (
            {"events": kr.Event(lambda x: x["momentum"][0], lambda x: None)},
            r"momentum \(3,\), attitude \(4,\), got None",
        ),
        ({"events": kr.Event(lambda x: x["momentum"][0], lambda x: {**x, "momentum": (0, 1)})}, r"momentum \(3,\)"),
        ({"impulses": {"time": 1, "angular_velocity": (0, 0, 1)}}, "an increment of momentum, got angular_velocity"),
    ],
)
def test_a_body_in_si_names_its_variables_in_messages(asked: dict[str, Any], message: str) -> None:
    turned = kr.physical.FreeBody([[5, 1, 0], [1, 4, 0.5], [0, 0.5, 3]], torque=lambda Omega: -0.01 * Omega)
    with pytest.raises(kr.InputError, match=message):
        kr.simulate(turned, turned.state((1, -2, 1.5)), dt=0.1, t_end=4.0, **asked)


def test_methods_and_ensembles_that_do_not_suit() -> None:
    kick = {"time": 0.5, "m": (0, 0, 1)}
    for method, message in (
        ("baecklund", "do not depend on the start"),
        ("suris", "energy_eps"),
        ("exact", "depend on"),
    ):
        with pytest.raises(kr.InputError, match=message):
            kr.simulate(TOP, AXIS, dt=0.1, steps=9, method=method, impulses=kick)
    many = TOP.state(m=np.tile(AXIS["m"], (2, 1)), a=AXIS["a"])
    with pytest.raises(kr.InputError, match="got 2 lanes"):
        kr.simulate(TOP, many, dt=0.1, steps=9, events=kr.Event(lambda x: x["a"][0, 2]))
    with pytest.raises(kr.InputError, match="expected functions"):
        kr.Event(3)  # type: ignore[arg-type]
    resting = kr.Event(height, lambda x: {**x, "P": x["P"] * (1, 1, -1) + (0, 0, 1e-300)})
    assert resting.name == "height -> <lambda>"


def test_an_action_that_never_leaves_the_event_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """The action puts the body just above the plane that it falls through, again and again."""
    monkeypatch.setattr("kreisel.runs.propagation.breaks.MOST_IN_STEP", 50)
    again = kr.Event(lambda x: x["a"][2], lambda x: {**x, "a": x["a"] + (0, 0, 1e-9)}, rising=False)
    with pytest.raises(kr.RunError, match="events happen within one step"):
        kr.simulate(TOP, AXIS, dt=0.1, steps=99, method="kahan", order=4, events=again)


def test_times_and_impulses_in_a_file(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from kreisel.cli import app

    (tmp_path / "body.py").write_text(
        "import kreisel as kr\nbody = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), damping=0.01)\n", encoding="utf-8"
    )
    text = """
[system]
file = "body.py"
name = "body"
[state]
m = [0.1, 0.2, 0.5]
a = [0.6, 0.0, 0.8]
[run]
dt = 0.1
times = [0.0, 1.0, 2.5]
[[run.impulses]]
time = 1.0
m = [0.0, 0.0, 0.5]
[output]
path = "OUT"
"""
    place = tmp_path / "run.toml"
    place.write_text(text.replace("OUT", str(tmp_path / "out.zarr")), encoding="utf-8")
    done = CliRunner().invoke(app, ["run", str(place), "--no-figure"])
    assert done.exit_code == 0, done.output
    run = kr.open_run(tmp_path / "out.zarr")
    body = kr.perturbed(TOP, damping=0.01)
    same = kr.simulate(body, AXIS, dt=0.1, times=[0, 1, 2.5], impulses={"time": 1.0, "m": (0, 0, 0.5)})
    assert run.m.values.tobytes() == same.m.values.tobytes() and run.m[1, 2] > 0.9
    for wrong, message in (("times = [2.0, 1.0]", "times: expected"), ("steps = 3\ntimes = [1.0]", "times: expected")):
        place.write_text(text.replace("times = [0.0, 1.0, 2.5]", wrong), encoding="utf-8")
        bad = CliRunner().invoke(app, ["run", str(place)])
        assert bad.exit_code != 0 and message in str(bad.exception or bad.output)


def spinning(t: float, y: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Kirchhoff's equations of a heavy top, M' = M x Omega + P x e_3, P' = P x Omega, Omega = M/I."""
    M, P = y[:3], y[3:]
    return np.concatenate([np.cross(M, M / inertia) + np.cross(P, (0, 0, 1)), np.cross(P, M / inertia)])


@pytest.mark.parametrize("method", ["kahan", "variational"])
def test_steps_of_all_lengths_are_recorded_once(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each row lies within another step; the values are those of SciPy's solution of the equations."""
    recorded, record = list[Any](), Recording.__init__
    monkeypatch.setattr(Recording, "__init__", lambda *args: recorded.append(1) or record(*args))
    times = np.cumsum(np.random.default_rng(1).uniform(0.01, 0.2, 30))
    run = kr.simulate(kr.HeavyTop(J=(1, 2, 3), A=(0, 0, 1)), START, dt=0.02, times=times, method=method, order=6)
    y0, options = np.concatenate([START["M"], START["P"]]), {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
    true = solve_ivp(spinning, (0, times[-1]), y0, t_eval=times, args=(np.array([5, 4, 3]),), **options)
    np.testing.assert_allclose(np.hstack([run.M, run.P]), true.y.T, rtol=0, atol=1e-10)
    assert 1 <= len(recorded) <= 2  # with the projection and without it


@pytest.mark.parametrize(("body", "start"), [(kr.EulerTop(J=(1, 2, 3)), {"M": (1.0, 0.2, 0.3)}), (CLEBSCH, START)])
def test_deformed_integrals_of_two_steps_are_not_mixed(body: Any, start: Any) -> None:
    """Those of Kahan's map depend on dt: code for one step is not that of the next."""
    for dt in (0.02, 0.05, 0.02):
        run = kr.simulate(body, start, dt=dt, steps=2000, every=500, method="kahan", order=2)
        free = kr.simulate(body, start, dt=dt, steps=2000, every=500, method="kahan", order=2, project=False)
        for name in start:
            np.testing.assert_allclose(run[name], free[name], rtol=0, atol=1e-11)
