"""A body is simulated itself: SI in, SI out, along the axes in which it was given.

The judges are those of `test_given_axes`: Euler's equations with the whole tensor by DOP853 in the axes given; and
textbook facts of a top.
"""

from __future__ import annotations

import json
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.physical import Ellipsoid, Ensemble, FreeBody, Gyroscope, HeavyBody, Orbit, Satellite, SubmergedBody
from kreisel.storage.checking import check_archive

from .test_given_axes import ADDED, CENTRE, LONG, ORBIT, RATE, ROWS, SHORT, TENSOR, TYPED, case, same

WHEEL = Gyroscope.flat(mass="3 kg", axial_moment="0.17 kg m^2", lever="15 cm")
BODIES: dict[str, Any] = {
    "free": FreeBody(TENSOR, time_unit=2.0),
    "satellite": Satellite(TENSOR, ORBIT),
    "heavy": HeavyBody(1.0, TENSOR, CENTRE),
    "submerged": SubmergedBody(1.0, TENSOR, ADDED, center_of_mass=CENTRE),
}
SETTINGS = {"heavy": {"order": 8}, "submerged": {"order": (8, 6, 4)}}


def state(name: str) -> Any:
    body = BODIES[name]
    return (
        body.state(angular_velocity=RATE, attitude=TYPED) if name == "submerged" else body.state(RATE, attitude=TYPED)
    )


@pytest.mark.parametrize("name", BODIES)
def test_a_run_of_a_body_is_in_si_and_in_the_axes_given(name: str) -> None:
    seconds, steps = (LONG, 10) if name in ("free", "satellite") else (SHORT, 20 if name == "submerged" else 10)
    dt = seconds / ROWS / steps
    run = kr.simulate(
        BODIES[name], state(name), dt=f"{dt} s", t_end=f"{seconds} s", every=steps, **SETTINGS.get(name, {})
    )
    truth = case(name)
    assert same(run.time, np.linspace(0, seconds, ROWS + 1), 1e-12) and run.time.attrs["units"] == "s"
    assert same(run.angular_velocity, truth.Omega) and run.angular_velocity.attrs["units"] == "rad/s"
    sign = np.sign((run.attitude.values * truth.attitude).sum(-1, keepdims=True))
    assert same(sign * run.attitude.values, truth.attitude)
    if name != "submerged":
        assert same(run.momentum[0], TENSOR @ RATE, 1e-12) and run.momentum.attrs["units"] == "kg m^2/s"
    energy = float(run.energy[0])
    assert run.energy.attrs["units"] == "J"
    height = Rotation.from_quat(TYPED, scalar_first=True).apply(CENTRE)[2]
    kinetic, weight = RATE @ TENSOR @ RATE / 2, 9.80665 * height * (name == "heavy")
    assert name in ("satellite", "submerged") or abs(energy - kinetic - weight) < 1e-12


def test_a_top_as_its_owner_types_it() -> None:
    """The slow precession m g l/(I3 w3) of a fast top, and its weight's potential energy."""
    run = kr.simulate(WHEEL, WHEEL.state(tilt="30 deg", spin="3000 rpm"), dt="1 ms", t_end="2 s", every="10 ms")
    assert run.sizes["time"] == 201 and abs(float(run.time[1]) - 0.01) < 1e-12
    azimuth = np.unwrap(np.arctan2(run.axis[:, 1], run.axis[:, 0]))
    rate = (azimuth[-1] - azimuth[0]) / 2
    assert abs(rate / (3 * 9.80665 * 0.15 / (0.17 * 2 * np.pi * 50)) - 1) < 0.02
    spinning = 0.17 * (100 * np.pi) ** 2 / 2 + 3 * 9.80665 * 0.15 * np.cos(np.pi / 6)
    assert abs(float(run.energy[0]) / spinning - 1) < 1e-12
    carried = Rotation.from_quat(run.attitude.values, scalar_first=True).apply([0, 0, 1])
    assert same(carried, run.axis, 1e-12)
    table = kr.drift(run)
    milli = kr.units.measured(run, time="ms", momentum="g m^2/s")
    assert milli.time.attrs["units"] == "ms" and same(milli.time, 1000 * run.time.values, 1e-9)
    assert same(milli.momentum.values, 1000 * run.momentum.values, 1e-7)
    assert not table.broken.any() and abs(table.start["energy"] / spinning - 1) < 1e-12
    assert abs(float(kr.analysis.rates(run).spin[5]) - 100 * np.pi) < 1e-9


def test_the_archive_the_row_and_the_resumed_run_say_the_same(tmp_path: Path) -> None:
    body, x0 = BODIES["free"], state("free")
    options = {"dt": "0.1 s", "every": 5}
    whole = kr.simulate(body, x0, t_end="6 s", **options)
    stored = kr.simulate(body, x0, t_end="3 s", path=tmp_path / "run.zarr", **options)
    for name in stored.variables:
        assert np.array_equal(stored[name].values, whole[name].values[: stored.sizes["time"]]), name
        assert stored[name].attrs["units"] == whole[name].attrs["units"], name
    plain = xr.open_zarr(tmp_path / "run.zarr")  # by CF's scale_factor, along the axes of the state
    assert same(plain.time, whole.time[: len(plain.time)], 1e-12) and plain.M.attrs["units"] == "kg m^2/s"
    assert same(plain.energy, whole.energy[: len(plain.time)], 1e-15)
    assert abs(np.linalg.norm(plain.M.values, axis=-1) - np.linalg.norm(TENSOR @ RATE)).max() < 1e-15
    assert check_archive(tmp_path / "run.zarr")[1] == []
    with pytest.raises(kr.InputError, match=r"extend: expected a number of steps, or a multiple of dt = 0\.1 s"):
        kr.resume(tmp_path / "run.zarr", extend="6.05 s")
    longer = kr.resume(tmp_path / "run.zarr", extend="6 s")
    assert np.array_equal(longer.momentum.values, whole.momentum.values)
    assert same(longer.isel(time=[3]).angular_velocity.values, whole.angular_velocity.values[[3]], 0.0 + 1e-15)
    follow = kr.simulate(body, stored.isel(time=-1) if False else whole.isel(time=6), t_end="3 s", **options)
    assert same(follow.momentum, whole.momentum[6:], 1e-12) and same(follow.attitude, whole.attitude[6:], 1e-12)
    assert same(kr.at(body, x0, ["0 s", "3 s"]).momentum, whole.momentum[[0, 6]], 1e-12)


def test_a_run_in_si_has_units_that_are_asked_for() -> None:
    """1 kg m^2/s is 1e7 g cm^2/s."""
    run = kr.simulate(BODIES["free"], state("free"), dt="0.1 s", t_end="1 s")
    cgs = kr.units.measured(run, time="ms", momentum="g cm^2/s")
    assert same(cgs.momentum, 1e7 * run.momentum.values, 1e-12) and cgs.time[-1] == pytest.approx(1000)
    assert same(cgs.energy, run.energy, 1e-15) and "kreisel_form" not in cgs.attrs
    assert kr.units.quantity(cgs.time[-1]).to("s").magnitude == pytest.approx(1)
    with pytest.raises(kr.InputError, match="momentum, energy, time"):
        kr.units.measured(run, M="g cm^2/s")
    with pytest.raises(kr.InputError, match=r"time must have the dimension of s, got 1\.0 meter"):
        kr.units.measured(run, time="m")
    for function in (kr.drift, kr.plot, kr.view):
        with pytest.raises(kr.InputError, match=r"units\.measured.*Give the run itself"):
            function(cgs)


def test_an_unknown_argument_belongs_to_no_lane() -> None:
    for value in (1.0, (1.0, 2.0)):
        with pytest.raises(kr.InputError, match=r"^FreeBody has no argument 'moments'"):
            FreeBody((1, 2, 2.5), moments=value)


def test_a_plain_tilt_in_degrees_is_doubted_once_and_a_tilt_with_units_is_not() -> None:
    wheel = Gyroscope.flat(3.0, 0.17, 0.15)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        wheel.state(tilt="1 turn", spin=1.0)
        assert not caught
        wheel.state(tilt=90, spin=1.0)
    assert len(caught) == 1


def test_light_without_plates_is_named_as_the_argument() -> None:
    dark = Satellite((1, 2, 2.5), Orbit.circular("500 km"), light=1.0)
    with pytest.warns(kr.InputWarning, match=r"light and its pressure: expected plates too"):
        kr.simulate(dark, dark.state((0, 0, 0.1)), dt=1, steps=2)


def test_a_floating_ball_goes_straight_on() -> None:
    ball = SubmergedBody(1.0, (0.1, 0.1, 0.1))
    run = kr.simulate(ball, ball.state(velocity=(0.3, 0.0, 0.1)), dt="0.1 s", t_end="2 s")
    assert same(ball.course(run).position[-1], (0.6, 0.0, 0.2), 1e-12)


def test_every_way_to_give_a_body_accepts_forces() -> None:
    wheel = Gyroscope.flat(3.0, 0.17, 0.15, damping=0.1)
    box, ball = FreeBody.box(1.0, (1.0, 2.0, 3.0), damping=0.1), FreeBody.ellipsoid(1.0, (1.0, 2.0, 2.0), damping=0.1)
    assert {b.damping for b in (wheel, box, ball, HeavyBody.about_centre(1.0, TENSOR, CENTRE, damping=0.1))} == {0.1}
    with pytest.raises(kr.InputError, match="no argument 'friction'"):
        Gyroscope.flat(3.0, 0.17, 0.15, friction=0.1)


def test_what_a_body_refuses() -> None:
    x0 = WHEEL.state(tilt=0.5, spin=200.0)
    with pytest.raises(kr.InputError, match="multiple of dt"):
        kr.simulate(WHEEL, x0, dt="1 ms", t_end="1 s", every="1.5 ms")
    with pytest.raises(kr.InputError, match="a duration with units"):
        kr.simulate(WHEEL, x0, dt="1 ms", t_end="1 s", every=0.5)  # type: ignore[arg-type]
    with pytest.raises(kr.InputError, match="dimension of s"):
        kr.simulate(WHEEL, x0, dt="1 m", steps=10)
    with pytest.raises(kr.InputError, match=r"Gyroscope\(\.\.\.\)"):
        kr.simulate(Gyroscope, x0, dt="1 ms", steps=10)  # type: ignore[arg-type]
    with pytest.raises(kr.InputError, match="arguments as a dict"):
        kr.simulate(WHEEL, {"m": (0, 0, 1), "a": (0, 0, 1)}, dt="1 ms", steps=10)
    with pytest.raises(kr.InputError, match="a state of this body"):
        kr.simulate(Gyroscope.flat(mass=6.0, axial_moment=0.17, lever=0.15), x0, dt="1 ms", steps=10)
    with pytest.warns(kr.AccuracyWarning, match=r"dt = 10 s is .* Use a dt of \S+ s or so"):
        kr.simulate(WHEEL, x0, dt="10 s", steps=1)
    upside_down = (0.0, 1.0, 0.0, 0.0)
    stream = SubmergedBody(1.0, TENSOR, ADDED, current=(0.5, 0.0, 0.0))
    for body, start in ((WHEEL, x0), (BODIES["heavy"], state("heavy")), (stream, stream.state())):
        with pytest.raises(kr.InputError, match="the vertical and the axis of the state"):
            kr.simulate(body, start, dt="1 ms", steps=10, orientation=upside_down)
    rolled = Rotation.from_euler("YZ", [0.5, 1.0])  # the axis of the state, rotated about itself
    assert kr.simulate(WHEEL, x0, dt="1 ms", steps=10, orientation=rolled).sizes["time"] == 11
    again = pickle.loads(pickle.dumps(x0))
    assert np.array_equal(again.orientation, x0.orientation)


def test_impulses_and_events_are_in_si(tmp_path: Path) -> None:
    """A blow of 1 N m s about the vertical adds 1 to the vertical momentum; events are found at the value asked for."""
    body, x0 = BODIES["heavy"], state("heavy")
    options: dict[str, Any] = {"dt": "5 ms", "t_end": "1 s", "every": "20 ms"}

    def vertical(run: xr.Dataset) -> Any:
        return (run.momentum * run.up).sum("xyz").values

    free = kr.simulate(body, x0, **options)
    up, level = np.asarray(free.up[25]), float(free.up[:26, 2].mean())
    run = kr.simulate(body, x0, impulses={"time": "0.5 s", "momentum": up}, **options)
    assert abs(vertical(run)[24] - vertical(run)[0]) < 1e-9 and abs(vertical(run)[-1] - vertical(run)[0] - 1) < 1e-9

    def falls(x: Any) -> Any:
        return x["up"][2] - level

    def stopped(x: Any) -> Any:
        return {**x, "momentum": 0 * x["momentum"]}

    (said,) = json.loads(run.attrs["impulses"])
    assert said["time"] == pytest.approx(0.5) and same(said["momentum"], up, 1e-12)
    assert run.attrs["dt"] == pytest.approx(5e-3) and kr.drift(run).shape == kr.drift(free).shape
    stop = kr.simulate(body, x0, events=kr.Event(falls), **options)
    assert abs(float(stop.up[-1, 2]) - level) < 1e-9 and float(stop.time[-1]) < 0.5
    (fell,) = json.loads(stop.attrs["event_times"])
    assert stop.attrs["stopped"] == fell[0] == float(stop.time[-1])
    kr.simulate(body, x0, events=kr.Event(falls, stopped), path=tmp_path / "run.zarr", **options)
    longer = kr.resume(tmp_path / "run.zarr", extend=400, events=kr.Event(falls, stopped))
    assert float(longer.time[-1]) == pytest.approx(2.0)


def test_a_row_of_another_body_is_no_start() -> None:
    """The numbers of its state are in other units, along other axes; a force alone changes neither."""
    body, x0 = BODIES["free"], state("free")
    options: dict[str, Any] = {"dt": "0.1 s", "t_end": "1 s"}
    row = kr.simulate(body, x0, **options).isel(time=-1)
    with pytest.raises(kr.InputError, match="a row of a run of this body, got one of a body whose state has other"):
        kr.simulate(FreeBody((1.0, 2.0, 2.5)), row, **options)
    damped = kr.simulate(FreeBody(TENSOR, time_unit=2.0, damping=0.1), row, **options)
    assert same(damped.angular_velocity[0].values, row.angular_velocity.values, 1e-12)


def test_analysis_speaks_in_si() -> None:
    run = kr.simulate(WHEEL, WHEEL.state(tilt="30 deg", spin="3000 rpm"), dt="1 ms", t_end="0.4 s")
    cut = kr.analysis.events(run, "axis[2]", value=0.86598, rising=True)
    assert cut.sizes["event"] > 5 and abs(cut.axis[:, 2] - 0.86598).max() < 1e-9 and cut.time.attrs["units"] == "s"
    table = kr.analysis.mean_rates(run)
    assert abs(table.difference / table.closed_form)["nutation_period"] < 0.02  # a map of order 2
    assert abs(table.closed_form["spin"] / (100 * np.pi) - 1) < 1e-12
    period = np.diff(cut.time.values).mean()
    assert abs(table.measured["nutation_period"] / period - 1) < 0.01
    omega = kr.analysis.angular_velocity(run, frame="space")
    assert same(omega, run.angular_velocity, 1e-9) and same(omega.time, run.time, 0.0 + 1e-15)


def test_events_of_functions_are_in_si() -> None:
    run = kr.simulate(BODIES["free"], state("free"), dt="0.1 s", t_end="30 s")
    level = float(run.momentum[:, 0].mean())
    cut = kr.analysis.events(run, lambda momentum: momentum[..., 0], value=level)
    assert cut.sizes["event"] and abs(cut.momentum[:, 0] / level - 1).max() < 1e-12
    assert same(cut.time, kr.analysis.events(run, "momentum[0]", value=level).time, 1e-12)
    with pytest.raises(kr.InputError, match=r"a component of momentum such as momentum\[2\]"):
        kr.analysis.events(run, "angular_velocity[0]")


def test_the_propagator_of_a_body_is_in_si() -> None:
    body, x0 = BODIES["free"], state("free")
    motion = kr.propagator(body, dt="0.1 s", orientation=True)
    rows = kr.at(body, x0, [0.0, 1.0, 30.0])
    found = motion.at(x0, [0.0, 1.0, 30.0])
    assert motion.names == ("momentum", "attitude") and motion.dt == pytest.approx(0.1)
    for name in motion.names:
        assert same(found[name], rows[name], 1e-13)
    row = np.concatenate([rows[name][0] for name in motion.names])
    assert same(motion.at(row, 30.0), np.concatenate([rows[name][2] for name in motion.names]), 1e-12)
    assert same(motion.steps(row, 10)[:3], rows.momentum[1], 1e-13)
    level = float(rows.momentum[1, 0])
    crossing = motion.until(row, lambda x: x[0] - level, "20 s")
    assert crossing.crossed and abs(crossing.state[0] - level) < 1e-12
    turning = kr.propagator(BODIES["satellite"], dt="1 s")
    assert same(turning.steps(state("satellite"), 30, time=0.0)["attitude"], case("satellite").attitude[-1], 1e-6)
    with pytest.raises(kr.InputError, match="momentum, attitude"):
        motion.at({"M": row[:3]}, 1.0)
    for dipole in (("5 A m^2", "0 A m^2", "1 A m^2"), (1.0, 2.0)):
        with pytest.raises(kr.InputError, match=r"dipole: expected a vector \(3,\) of values in SI"):
            turning.steps(state("satellite"), 1, time=0.0, dipole=dipole)


def test_a_sweep_of_a_body_is_in_si(tmp_path: Path) -> None:
    body, x0 = BODIES["free"], state("free")
    begun = TENSOR @ RATE
    found = kr.sweep(
        body,
        x0,
        kr.Design(grid={"state.momentum[0]": begun[0] + np.array([0.001, 0.002])}),
        dt="0.1 s",
        steps=50,
        every="1 s",
        path=tmp_path / "sweep.zarr",
        workers=0,
        save=("trajectories", "extremes"),
    )
    assert found.time.attrs["units"] == "s" and float(found.time[-1]) == pytest.approx(5.0)
    assert found.momentum.attrs["units"] == "kg m^2/s" and found.attrs["kreisel_form"] == "SI"
    assert found.momentum_max.attrs == {**found.momentum_max.attrs, "units": "kg m^2/s", "axes": "state"}
    assert found.attitude_max.attrs["long_name"].startswith("attitude of the axes of the state")
    assert found.attitude_max.attrs["axes"] == "state" and found.attitude.attrs["axes"] == "body"
    g = body.orientation(found.attitude.transpose("time", ...).values)  # of the principal axes
    assert same(found.attitude_max, g.max(0), 1e-12) and same(found.attitude_min, g.min(0), 1e-12)
    size = np.linalg.norm(found.momentum.values, axis=-1)
    assert np.ptp(size, axis=found.momentum.dims.index("time")).max() < 1e-15
    assert same(found.momentum.isel(time=0), begun + np.array([[0.001, 0.0, 0.0], [0.002, 0.0, 0.0]]), 1e-12)


def test_a_sweep_over_values_of_a_body(tmp_path: Path) -> None:
    """Precession of fast tops in a grid of levers and rates, m g l/(I3 w3); a body of another lane is refused."""
    settings: dict[str, Any] = {"dt": "1 ms", "t_end": "0.5 s", "workers": 0, "save": ["trajectories"]}
    path, start = tmp_path / "tops.zarr", {"tilt": "20 deg"}
    over = {"lever": ["10 cm", "20 cm"], "spin": [600.0, 900.0, 1200.0]}
    found = kr.sweep(WHEEL, start, over=over, path=path, **settings)
    azimuth = np.unwrap(np.arctan2(found.axis[..., 1], found.axis[..., 0]), axis=0)
    rates = 3 * 9.80665 * np.array([[0.1], [0.2]]) / (0.17 * np.array([600.0, 900.0, 1200.0]))
    assert np.allclose(azimuth[-1] / 0.5, rates, rtol=0.03)
    assert found["body.lever"].values.tolist() == [0.1, 0.2] and found.axis.sizes["state.spin"] == 3
    one = Gyroscope.flat("3 kg", "0.17 kg m^2", "20 cm")
    alone = kr.simulate(one, one.state("20 deg", 900.0), dt="1 ms", t_end="0.5 s")
    assert np.allclose(found.momentum[:, 1, 1], alone.momentum, atol=1e-9 * float(abs(alone.momentum).max()))
    again = kr.open_run(path).isel(lane=4)
    assert np.array_equal(again.momentum, found.momentum[:, 1, 1]) and float(again["body.lever"]) == 0.2
    changes = {"units": lambda _: 1, "orbit.inclination": lambda _: "90 deg"}
    orbit = Satellite.cubesat(ORBIT)._varied([changes])[0]
    assert orbit.inertia[0, 0] == pytest.approx(1.33 * 0.02 / 12) and orbit.orbit.inclination == np.pi / 2


BAD_SWEEPS: dict[str, tuple[Any, Any, str]] = {
    "a name": ({}, {"masss": [1.0]}, "FreeBody has no argument 'masss'. Did you mean 'mass'"),
    "a body": ({"spin": RATE}, {"mass": [1.0, -1.0]}, "Lane 1: mass"),
    "an entry": ({"spin": RATE}, {"momentum[7]": [1.0]}, "none at"),
    "a state": (state("free"), {"mass": [1.0, 2.0]}, "arguments of body.state"),
    "no dict": ({"spin": RATE}, [1.0], "over: expected"),
}


@pytest.mark.parametrize("case", BAD_SWEEPS)
def test_a_sweep_that_cannot_be(case: str, tmp_path: Path) -> None:
    x0, over, message = BAD_SWEEPS[case]
    with pytest.raises(kr.InputError, match=message):
        kr.sweep(BODIES["free"], x0, over=over, dt=1, steps=1, path=tmp_path / "s.zarr", workers=0)


def test_attitudes_are_drawn_for_bodies_that_are_created_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A spin that decays along a principal axis, from any attitude: L = L_0 e^(-rub t/I); two bodies of 20 lanes."""
    created, original = list[object](), FreeBody._with_functions
    monkeypatch.setattr(FreeBody, "_with_functions", lambda *a: created.append(a) or original(*a))
    body = FreeBody((0.2, 0.3, 0.4), torque=lambda Omega, *, rub: -rub * Omega, params={"rub": 0.1})
    draws = {"random": {"state.attitude": {"sphere": 1.0}, "state.spin": {"sphere": 2.0}}, "draws": 20, "rng": 3}
    settings: dict[str, Any] = {"dt": 0.05, "t_end": 1.0, "workers": 0, "save": ["trajectories"]}
    design = kr.Design(grid={"body.params.rub": [0.1, 0.2]}, **draws)
    found = kr.sweep(body, {"spin": (0, 0, 1)}, design, path=tmp_path / "s.zarr", **settings)
    assert len(created) <= 6
    assert found.attitude.shape[1:] == (2, 20, 4) and not found.failed.any()
    q, spin = (kr.open_run(tmp_path / "s.zarr")[f"state.{name}"].values for name in ("attitude", "spin"))
    assert np.allclose((q**2).sum(-1), 1) and np.allclose((spin**2).sum(-1), 4) and np.ptp(q[:, 0]) > 0.5
    assert np.allclose(found.attitude[0].values.reshape(40, 4), q, atol=1e-14)
    axis = kr.Design(grid={"body.params.rub": [0.1, 0.2]}, random={"state.attitude": {"sphere": 1.0}}, draws=5, rng=3)
    found = kr.sweep(body, {"spin": (0, 0, 1)}, axis, path=tmp_path / "a.zarr", **settings)
    expected = 0.4 * np.exp(-np.array([0.1, 0.2]) / 0.4)
    assert np.allclose(found.momentum[-1, ..., 2], expected[:, None], rtol=1e-9)


def test_a_body_is_fitted_and_differentiated_in_si() -> None:
    """The momentum at the start, from rates in deg/s along the axes given; and the derivative by differences."""
    body, x0 = BODIES["free"], state("free")
    run = kr.simulate(body, x0, dt="0.5 s", t_end="20 s")
    seen = xr.Dataset(
        {"angular_velocity": run.angular_velocity.drop_attrs() * 180 / np.pi}, {"time": run.time.drop_attrs()}
    )
    seen.angular_velocity.attrs["units"] = "deg/s"
    start = body.state(1.1 * RATE, attitude=TYPED)
    fitted = kr.fit(body, seen, free=["momentum"], x0=start, dt="0.1 s", orientation=False)
    assert same(body.angular_velocity(fitted.state.axial["M"]), RATE, 1e-6)
    motion = kr.differentiable(body)
    momentum = TENSOR @ RATE
    end = motion({"momentum": momentum}, dt=0.1, steps=100)["momentum"]
    assert same(end, np.asarray(run.momentum[20]), 1e-4 * np.linalg.norm(momentum))


def test_a_torque_of_a_call_is_along_the_axes_given() -> None:
    """A short steady torque adds its impulse to the momentum, along the axes of the tensor."""
    body = BODIES["satellite"]
    motion = kr.propagator(body, dt="1 ms")
    torque = np.array([0.3, -0.1, 0.2])
    x0 = body.state((0.0, 0.0, 0.0), attitude=TYPED)
    pushed = motion.steps(x0, 10, time=0.0, torque=torque)["momentum"] - motion.steps(x0, 10, time=0.0)["momentum"]
    assert same(pushed, 0.01 * torque, 1e-6)
    function = kr.differentiable(body, order=(2, 2))
    pushed = function(x0, dt=1e-3, steps=10, torque=torque)["momentum"] - function(x0, dt=1e-3, steps=10)["momentum"]
    assert same(pushed, 0.01 * torque, 1e-6)


def test_a_run_of_a_satellite_says_where_it_is_and_where_it_points(tmp_path: Path) -> None:
    """At rest in the frame of a circular orbit every angle stays 0; a rotation in pitch is the pointing error."""
    body = Satellite((0.03, 0.04, 0.05), ORBIT)
    run = kr.simulate(body, body.state(attitude=body.pointing(pitch="5 deg")), dt="20 s", t_end="20 min", every=10)
    assert float(run.pitch[0]) == pytest.approx(np.deg2rad(5)) and float(run.pointing[0]) == pytest.approx(
        np.deg2rad(5)
    )
    assert abs(run["roll"]).max() < 1e-9 and run.pitch.attrs["units"] == "rad"
    assert abs(np.linalg.norm(run.position, axis=-1) / 7.0e6 - 1).max() < 1e-12
    lanes = body.state(attitude=np.stack([body.pointing(pitch=p) for p in (0.0, 0.1, 0.2, 0.3)]))
    several = kr.simulate(body, lanes, dt="20 s", t_end="20 min", every=10, path=tmp_path / "run.zarr")
    assert several.pitch.isel(lane=2).values[0] == pytest.approx(0.2) and several.pointing.dims == ("time", "lane")
    assert abs(several.isel(lane=0).pointing).max() < 1e-9
    again = pickle.loads(pickle.dumps(several))
    assert np.array_equal(again.pitch.values, several.pitch.values)


def test_a_body_in_water_moves_at_its_speed(tmp_path: Path) -> None:
    """An ellipsoid along its longest axis: 1 m/s for 1 s is 1 m.  The run survives NetCDF."""
    body = Ellipsoid((0.3, 0.2, 0.1), 30.0, 1000.0)
    run = kr.simulate(body, body.state((1.0, 0, 0), (0, 0, 0.0)), dt="10 ms", t_end="1 s", every=10)
    x = kr.analysis.path(run)
    assert same(x[-1], [1, 0, 0], 1e-12) and x.attrs["units"] == "m" and float(x.time[-1]) == pytest.approx(1)
    run.to_netcdf(tmp_path / "run.nc")
    again = xr.open_dataset(tmp_path / "run.nc")
    assert same(kr.analysis.path(again)[-1], [1, 0, 0], 1e-12) and not kr.drift(again).broken.any()


def test_the_nutation_and_the_chaos_of_a_body_are_in_si() -> None:
    """A fast top nods at I3 w3/I1 and begins highest; lyapunov is in 1/s, times in s."""
    figures = kr.nutation(WHEEL, {"tilt": "70 deg", "spin": "1800 rpm"})
    assert figures.period == pytest.approx(2 * np.pi / WHEEL.nutation_rate("1800 rpm"), rel=1e-3)
    assert figures.highest == pytest.approx(np.cos(np.radians(70))) and figures.spin == pytest.approx(60 * np.pi)
    body = FreeBody(TENSOR, time_unit=2.0)
    found = kr.analysis.megno(body, body.state(RATE), dt="0.1 s", steps=20, every="0.5 s")
    scaled = kr.analysis.megno(body.model(), body.state(RATE), dt=0.05, steps=20, every=5)
    assert found.time.values.tolist() == [0.5, 1.0, 1.5, 2.0]
    assert np.allclose(found.lyapunov, scaled.lyapunov / 2) and np.allclose(found.megno, scaled.megno)


def test_a_body_with_forces_has_its_angular_velocity_in_an_archive(tmp_path: Path) -> None:
    body = FreeBody(TENSOR, torque=lambda Omega: -1e-3 * Omega)
    kr.simulate(body, body.state(RATE), dt="0.1 s", steps=10, path=tmp_path / "run.zarr", progress=False)
    run = kr.open_run(tmp_path / "run.zarr")
    assert same(run.angular_velocity, np.linalg.solve(TENSOR, run.momentum.values[..., None])[..., 0], 1e-12)


def test_a_sweep_of_satellites_has_the_times_and_the_step_of_a_run(tmp_path: Path) -> None:
    """Without dt the step is chosen; orbit and rows begin at t_start."""
    moments, start = [(0.0, 0.0, 0.1), (0.0, 0.1, 0.0)], {"spin": (0.01, 0.02, 0.0)}
    orbit, when = Orbit.circular("500 km", "97 deg"), {"t_start": "100 s", "t_end": "160 s", "every": "20 s"}
    many = Satellite((0.05, 0.045, 0.02), orbit, magnetic_moment=moments)
    want = kr.simulate(many, many.state(**start), **when)
    asked = {"over": {"magnetic_moment": moments}, "save": ["trajectories"], "workers": 0, "progress": False}
    swept = kr.sweep(many[0], start, path=tmp_path / "s.zarr", **asked, **when)
    assert swept.time.values.tolist() == want.time.values.tolist() == [100.0, 120.0, 140.0, 160.0]
    assert np.array_equal(swept.momentum, want.momentum) and np.ptp(want.momentum.values[-1], axis=0).max() > 0


def test_bodies_show_the_arguments_that_were_given() -> None:
    assert repr(FreeBody((1, 2, 2.5), mass="2 kg")) == (
        "FreeBody(inertia=[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.5]], mass=2.0)"
    )
    assert repr(WHEEL).startswith("Gyroscope(mass=3.0, axial_moment=0.17, ")


def test_a_run_beyond_igrf_warns() -> None:
    body = Satellite((0.05, 0.04, 0.01), Orbit.circular("500 km", epoch="2029-12-31"), degree=1)
    with pytest.warns(kr.InputWarning, match="holds until 2030-01-01, 1 days after the epoch, and the run takes 2"):
        run = kr.simulate(body, body.state(), dt="10 min", t_end="2 day", progress=False)
    assert np.array_equal(body.field(run), run.field) and body.field(run).attrs["units"] == "T"
    many = Ensemble([body, body])
    for asked in ({"t_end": "2 day"}, {"steps": 288}, {"times": ["1 h", "2 day"]}):  # a method that stops the run
        with pytest.warns(kr.InputWarning, match="and the run takes 2"), pytest.raises(kr.InputError, match="method"):
            kr.simulate(many, many.state(), dt="10 min", **asked, method="none")


@pytest.mark.filterwarnings("ignore:Lane 0. dt = 600 s is too long for the forces")
def test_sweeps_and_resumed_runs_beyond_igrf_warn(tmp_path: Path) -> None:
    body = Satellite((0.05, 0.04, 0.01), Orbit.circular("500 km", epoch="2029-12-31"), degree=1)
    asked: dict[str, Any] = {"dt": "10 min", "progress": False}
    over = {"t_end": "1500 min", "over": {"magnetic_moment": [(0.0, 0.0, 0.1), (0.0, 0.1, 0.0)]}, "workers": 0}
    with pytest.warns(kr.InputWarning, match="holds until 2030-01-01, 1 days after the epoch, and the run takes 1"):
        kr.sweep(body, {}, path=tmp_path / "s.zarr", **asked, **over)
    kr.simulate(body, body.state(), path=tmp_path / "r.zarr", steps=1, **asked)
    with pytest.warns(kr.InputWarning, match="holds until 2030-01-01, 1 days after the epoch, and the run takes 2"):
        kr.resume(tmp_path / "r.zarr", extend="2 day", system=body, progress=False)
    with pytest.warns(kr.InputWarning, match="holds until 2030-01-01, 1 days after the epoch, and the run takes 3"):
        kr.resume(tmp_path / "r.zarr", extend="3 day", progress=False)  # what `kreisel resume` calls
