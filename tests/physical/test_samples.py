"""Samples of a controller are at multiples of its time, once each: a law counts them, each adds k N m s."""

import json

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel.physical import FreeBody
from sizes import FULL

PUSH = 1e-3  # N m s, about the first axis of a sphere
FAR = 31_536_000.0  # s: a year


def pushes(count):
    return {"impulse": PUSH * np.array([1, 0, 0]) + 0 * count, "count": count + 1.0}


def pushed(every="1 s"):
    return FreeBody((1, 1, 1), control=kr.Control(pushes, every=every, memory={"count": 0.0}))


def ran(dt=0.25, **more):
    body = pushed()
    return kr.simulate(body, body.state((0, 0, 0)), dt=dt, progress=False, **more)


def moved(count):
    return pytest.approx(PUSH * count, rel=1e-12)


@pytest.mark.parametrize("dt", [0.333333333, 0.3333333335, 1 / 3])
def test_a_third_of_a_second_to_nine_digits_is_a_third(dt) -> None:
    run = ran(dt, steps=4500, every=4500)
    assert run["count"][-1] == 1500 and run.time[-1] == pytest.approx(1500, rel=1e-14)
    assert run.momentum[-1, 0] == moved(1500)


def test_a_year_later_a_start_between_samples_is_refused() -> None:
    assert ran(0.1, steps=100, every=100, t_start=FAR)["count"][-1] == 10
    assert ran(0.1, t_end=FAR + 10.1, every=100, t_start=FAR + 0.1)["count"][-1] == 10  # whose dt rounds
    with pytest.raises(kr.InputError, match=r"^t_start: expected a multiple of dt = 0\.1 s"):
        ran(0.1, steps=100, t_start=FAR + 0.02)
    with pytest.raises(kr.InputError, match=r"^time: expected a multiple of dt = 0\.1"):
        kr.propagator(pushed(), dt=0.1).steps(pushed().state((0, 0, 0)), 10, time=FAR + 0.02)


@pytest.mark.parametrize("apart", [0, 1e-12, 1e-9, -1e-9, 5e-7, -5e-7, 0.1])
def test_an_impulse_near_a_sample_is_not_a_sample(apart) -> None:
    run = ran(steps=80, impulses={"time": 8 + apart, "momentum": (0, 0.5, 0)})
    assert run["count"].values.tolist() == [np.ceil(t) for t in run.time.values]
    assert run.momentum[-1].values.tolist() == [moved(20), 0.5, 0]


@pytest.mark.parametrize(
    "quantity", [lambda x: x["count"] - 5.5, lambda x: x["momentum"][0] - 5.5 * PUSH], ids=["memory", "momentum"]
)
def test_a_sample_is_an_event(quantity) -> None:
    """The sixth sample, after 5 s, changes the sign; afterwards there are as many as before."""
    run = ran(steps=80, events=kr.Event(quantity, lambda x: {**x, "momentum": x["momentum"] + (0, 0.5, 0)}))
    [[time, _]] = json.loads(run.attrs["event_times"])
    assert time == pytest.approx(5, abs=1e-6) and run["count"][-1] == 20
    assert run.momentum[-1].values.tolist() == [moved(20), 0.5, 0]
    stopped = ran(steps=80, events=kr.Event(quantity))
    assert stopped.time[-1] == pytest.approx(5, abs=1e-6) and stopped["count"][-1] == 6
    motion = kr.propagator(pushed(), dt=0.25)
    state, time, crossed = motion.until(pushed().state((0, 0, 0)), quantity, 20.0)
    assert crossed and time == pytest.approx(5, abs=1e-6) and state["count"] == 6
    end = motion.to(state, 20.0, time=time)
    assert end["count"] == 20 and end["momentum"][0] == moved(20)


@pytest.mark.parametrize("moment", [0.7, 1.0, 77.7])
def test_an_event_at_a_sample_to_rounding_happens_once(moment) -> None:
    """The momentum is 0.01 t to rounding: the crossing may lie 1e-11 s before the sample, or behind it."""
    law = kr.Control(
        lambda count: {"torque": np.array([0.01, 0, 0]) + 0 * count, "count": count + 1.0}, 0.1, {"count": 0.0}
    )
    body = FreeBody((1, 1, 1), control=law)
    event = kr.Event(
        lambda x: x["momentum"][0] - 0.01 * moment, lambda x: {**x, "momentum": x["momentum"] + (0, 0.05, 0)}
    )
    run = kr.simulate(body, body.state((0, 0, 0)), dt=0.1, steps=800, every=800, events=event, progress=False)
    [[time, _]] = json.loads(run.attrs["event_times"])
    assert time == pytest.approx(moment, abs=1e-6) and run["count"][-1] == 800
    assert run.momentum[-1].values == pytest.approx([0.8, 0.05, 0], rel=1e-11)


def test_a_propagator_samples_from_any_time_to_any_time() -> None:
    """A loop that ends between samples, and one that adds up its times."""
    body = FreeBody((1, 1, 1), torque=lambda t: np.array([0, 1.0, 0]) + 0 * t, control=pushed().control)
    motion = kr.propagator(body, dt=0.25)
    state, time = body.state((0, 0, 0)), 0.0
    for end in (0.9, 1.0, 1.1, 4.35, 8.0, 20.6):
        state, time = motion.to(state, end, time=time), end
        assert state["count"] == np.ceil(end) and state["momentum"].tolist() == [
            moved(state["count"]),
            pytest.approx(end),
            0,
        ]
    state, time, crossed = motion.until(body.state((0, 0, 0)), lambda x: x["momentum"][1] - 0.6, 20.0)
    assert crossed and time == pytest.approx(0.6, rel=1e-12) and state["count"] == 1
    state, time, crossed = motion.until(state, lambda x: x["momentum"][1] - 3.1, 20.0, time=time)
    assert crossed and time == pytest.approx(3.1, rel=1e-12) and state["count"] == 4
    quick = kr.propagator(pushed("0.1 s"), dt=0.1)
    assert quick.steps(body.state((0, 0, 0)), 10, time=21000.09999997490)["count"] == 10  # 210001 times 0.1, added up
    with pytest.raises(kr.InputError, match=r"^time: expected a multiple of dt = 0\.1, .* got 27000\.0999998876\.$"):
        quick.steps(body.state((0, 0, 0)), 10, time=27000.09999988759)


def test_derivatives_pass_through_a_memory_of_one_value() -> None:
    """A sphere is at rest and gets k N m s in each second: its momentum after 5 s is 5 k, the derivative 5."""
    import jax

    from kreisel.reduction import double

    law = kr.Control(
        lambda count, *, k: {"impulse": k * np.array([0, 1, 0]), "count": count + 1.0},
        memory={"count": 0.0},
        parameters={"k": PUSH},
    )
    body = FreeBody((1, 1, 1), control=law)
    motion = kr.differentiable(body)
    rows = motion(body.state((0, 0, 0)), dt=0.25, steps=20, every=4)
    assert rows["count"].tolist() == [0, 1, 2, 3, 4, 5]
    later = motion({name: value[2] for name, value in rows.items()}, dt=0.25, steps=12, time=2.0)
    assert float(later["count"]) == 5 and later["momentum"].tolist() == [0, moved(5), 0]
    with double():
        slope = jax.grad(lambda k: motion(body.state((0, 0, 0)), dt=0.25, steps=20, k=k)["momentum"][1])
        assert float(slope(PUSH)) == pytest.approx(5, rel=1e-12)
        back = jax.jit(lambda dt: motion(body.state((0, 0, 0)), dt=dt, steps=4)["momentum"])
        assert np.isfinite(back(0.25)).all()
        assert np.isnan(back(-0.25)).all()
    with pytest.raises(kr.InputError, match=r"^dt: expected a positive step .* acts on the past, got -0\.25 s"):
        motion(body.state((0, 0, 0)), dt=-0.25, steps=4)
    with pytest.raises(kr.InputError, match=r"^momentum: expected a vector, got one value"):
        motion({"momentum": 1.0, "count": 0.0, "commanded_impulse": np.zeros(3)}, dt=0.25, steps=4)


def test_a_fit_has_observations_between_samples() -> None:
    """A sphere whose rate loses k of itself per second, w (1 - k)^m (1 - k (t - m)) after m samples."""
    import jax

    from kreisel.reduction.numerics import double

    law = kr.Control(lambda rates, *, k: {"torque": -k * rates}, every="1 s", parameters={"k": 0.1})
    body, time = FreeBody((1, 1, 1), control=law), np.array([0, 0.53, 1, 2.17, 2.99, 3, 3.33])
    seen = {
        f"angular_velocity[{i}]": ("time", w * 0.8 ** np.floor(time) * (1 - 0.2 * (time % 1)))
        for i, w in ((0, 1), (1, -2))
    }
    found = kr.fit(body, xr.Dataset(seen, {"time": time}), free=["k"], x0=body.state((1, -2, 0)), dt=0.333333333)
    assert found.values["k"] == pytest.approx(0.2, rel=1e-9)
    motion = kr.differentiable(body)
    state = motion(body.state((1, -2, 0)), dt=0.333333333, steps=9)
    assert np.asarray(state["momentum"]).tolist() == pytest.approx([0.9**3, -2 * 0.9**3, 0], rel=1e-12)
    with double():
        # (1 - 3 k dt)^3
        after = jax.jit(jax.value_and_grad(lambda dt: motion(body.state((1, -2, 0)), dt=dt, steps=9)["momentum"][0]))
        assert [*map(float, after(0.333333333))] == pytest.approx([0.9**3, -0.9 * 0.9**2], rel=1e-12)
    later = motion(state, dt=0.07, steps=2, time=3.0)  # of the command that is sampled at 3 s
    assert np.asarray(later["momentum"])[0] == pytest.approx(0.9**3 * (1 - 0.1 * 0.14), rel=1e-12)
    with pytest.raises(kr.InputError, match=r"^dt: expected a step that divides"):
        motion(later, dt=0.07, steps=14, time=3.14)


def test_crossings_between_samples_are_under_the_commands_held_there() -> None:
    """The torque T_k of the sample k is constant until the next: the momentum is a polygon."""
    torques = 0.1 * (1 + 0.05 * np.arange(20))
    sums = np.append(0, np.cumsum(torques))
    law = kr.Control(lambda time: {"torque": np.array([0, 1, 0]) * 0.1 * (1 + 0.05 * time)}, every="1 s")
    body = FreeBody((1, 1, 1), control=law)
    fine, coarse = (
        kr.simulate(body, body.state((0, 0, 0)), dt=0.25, t_end=20.0, every=n, progress=False) for n in (1, 4)
    )
    for value in (0.05, 1.0, 1.7):
        k = np.searchsorted(sums, value) - 1
        for run in (fine, coarse):
            cut = kr.analysis.events(run, lambda momentum, torque, value=value: momentum[..., 1] - value, system=body)
            assert cut.time.values == pytest.approx([k + (value - sums[k]) / torques[k]], rel=1e-11)
            assert cut.commanded_torque.values[0, 1] == pytest.approx(torques[k], rel=1e-14)
    with pytest.raises(kr.InputError, match="expected a row at each sample, every 1 s"):
        kr.analysis.events(
            fine[{"time": slice(None, None, 8)}], lambda momentum, torque: momentum[..., 1] - 1, system=body
        )


def test_the_path_of_a_controlled_body_is_that_under_the_same_torque() -> None:
    from kreisel.physical import SubmergedBody

    push, water = (
        np.array([1e-3, 2e-3, -1e-3]),
        {"mass": 2.0, "inertia": (0.01, 0.02, 0.03), "added_mass": (1, 2, 3, 0, 0, 0)},
    )
    steady = SubmergedBody(**water, torque=lambda t: push + 0 * t)
    held = SubmergedBody(**water, control=kr.Control(lambda time: {"torque": push + 0 * time}, every="1 s"))
    paths = []
    for body in (steady, held):
        start = body.state(velocity=(0.3, 0.1, 0), angular_velocity=(0.1, 0.2, 0.3))
        run = kr.simulate(body, start, dt=0.25, t_end=10.0, every=4, order=4, progress=False)
        paths.append(kr.analysis.path(run, body).values)
    np.testing.assert_allclose(paths[1], paths[0], rtol=0, atol=1e-5)
    assert np.linalg.norm(paths[0][-1]) > 1


def test_a_memory_of_light_and_density() -> None:
    """What the law sees is what the run shows at the row of the sample; in the shadow the light is 0."""
    from kreisel.physical import Orbit, Satellite

    law = kr.Control(
        lambda light, density, bright, thick: {"bright": light, "thick": density},
        every="1 min",
        memory={"bright": 0.0, "thick": 0.0},
    )
    orbit = Orbit.circular("500 km", epoch="2026-03-20T14:46:00")
    for lanes in (*[orbit] * FULL, [orbit, Orbit.circular("600 km", epoch="2026-03-20T14:46:00")]):
        body = Satellite.cubesat(lanes, air="exponential", control=law)
        run = kr.simulate(body, body.state(), dt="1 min", t_end="95 min", progress=False)
        np.testing.assert_allclose(run.bright[1:], run.light[:-1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(run.thick[1:], run.density[:-1], rtol=1e-9)
        assert {0.0, 1.0} <= {*run.bright.values.ravel()[1:].round(9).tolist()}
