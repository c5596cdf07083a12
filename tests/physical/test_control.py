"""Controllers in the kernel against an independent loop, their wheels, noise, memory; mistakes."""

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.algebra.random import normals, streams, streams_from, uniform
from kreisel.physical import Orbit, Satellite, Wheels
from kreisel.storage.checking import check_archive
from sizes import FULL
from support import cross, rotation_matrix

TENSOR = np.array([[0.03, 0.002, -0.001], [0.002, 0.028, 0.0015], [-0.001, 0.0015, 0.012]])
AXES = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
MU, RADIUS, FIELD = 3.986004418e14, 6378137.0, 29.8e-6 * 6.4e6**3  # WGS 84; a field to one digit
LOW, INCLINATION = 500e3, 1.7
MOMENTA = [1e-3, 0, -2e-3, 1e-3]
STEADY = np.array([3e-6, -2e-6, 1e-6, 2e-6])  # N m, of the motors
RANGES = np.array([1.01e-3, 1.0, 1.0, 1.0])  # N m s: the first wheel comes to its limit
SPIN = np.array([0.1, 0.2, -0.15])


def orbit(**more):
    from kreisel.physical import EARTH

    return Orbit.circular(LOW, INCLINATION, primary=EARTH._replace(field=-FIELD), **more)


# -- against an independent loop: Euler's equations in the body axes, by DOP853 between samples ------------------


def busy(rates, field, sun, attitude, time, wheels, position, before, count, *, gain, unload):
    """Every sensor and every command at once."""
    return {
        "dipole": -gain * (field - before) + 1e-3 * sun,
        "torque": 1e-6 * position / 7e6,
        "wheel_torque": unload * wheels + np.array([1e-5, 0, -1e-5, 2e-5]) * np.cos(time) + 1e-5 * attitude,
        "impulse": -1e-4 * rates * count,
        "before": field,
        "count": count + 1.0,
    }


def place(t):
    a = RADIUS + LOW
    angle, ci, si = np.sqrt(MU / a**3) * t, np.cos(INCLINATION), np.sin(INCLINATION)
    return a * np.array([np.cos(angle), np.sin(angle) * ci, np.sin(angle) * si])


def field_at(t):
    """Of a dipole that points to the south of the third axis, so that B points north over the equator."""
    r = np.linalg.norm(place(t))
    u, m = place(t) / r, np.array([0, 0, -FIELD])
    return (3 * (m @ u) * u - m) / r**3


def by_scipy(law, samples, every, delay, limit):
    """The rates, attitude, wheels and commands after each sample's interval."""
    q, h, L, before, count = np.array([1.0, 0, 0, 0]), np.array(MOMENTA), TENSOR @ SPIN, np.zeros(3), 0.0
    none = {"dipole": np.zeros(3), "torque": np.zeros(3), "wheel_torque": np.zeros(4), "impulse": np.zeros(3)}
    queue = [none] * delay
    for k in range(samples):
        t, C = k * every, rotation_matrix(q)
        seen = {"field": C.T @ field_at(t), "sun": C.T @ np.array([1.0, 0, 0]), "position": C.T @ place(t)}
        seen |= {"rates": np.linalg.solve(TENSOR, L), "attitude": q, "time": t, "wheels": h}
        out = law(**seen, before=before, count=count, gain=3e3, unload=-0.01)
        before, count = out["before"], out["count"]
        queue.append(out | {"dipole": np.clip(out["dipole"], -limit, limit)})
        held = queue.pop(0)
        motors = np.clip(STEADY + held["wheel_torque"], (-RANGES - h) / every, (RANGES - h) / every)
        held = held | {"wheel_torque": motors - STEADY}

        def rate(t, y, held=held, motors=motors):
            L, q, h = y[:3], y[3:7], y[7:]
            C, W = rotation_matrix(q), np.linalg.solve(TENSOR, L)
            r = np.linalg.norm(place(t))
            u = C.T @ place(t) / r
            tau = 3 * MU / r**3 * cross(u, TENSOR @ u) + cross(held["dipole"], C.T @ field_at(t))
            tau = tau + held["torque"] - AXES.T @ motors
            turn = [-q[1:] @ W / 2, *((q[0] * W + cross(q[1:], W)) / 2)]
            return np.concatenate([cross(L + AXES.T @ h, W) + tau, turn, motors])

        start = np.concatenate([L + held["impulse"], q, h])
        y = solve_ivp(rate, (t, t + every), start, method="DOP853", rtol=1e-13, atol=1e-16).y[:, -1]
        L, q, h = y[:3], y[3:7] / np.linalg.norm(y[3:7]), y[7:]
        yield np.linalg.solve(TENSOR, L), q, h, before, held


@pytest.mark.parametrize(("delay", "limit"), [(0, np.inf), (2, 5e-3)])
def test_a_controller_is_that_of_an_independent_loop(delay, limit):
    control = kr.Control(
        busy,
        every="2 s",
        memory={"before": np.zeros(3), "count": 0.0},
        parameters={"gain": 3e3, "unload": -0.01},
        delay=delay,
        limits={} if np.isinf(limit) else {"dipole": limit},
    )
    body = Satellite(TENSOR, orbit(), wheels=Wheels(AXES, MOMENTA, STEADY, RANGES), control=control)
    start = body.state(spin=SPIN)
    settings = {"orientation": body.orientation(), "dt": 0.25, "steps": 32, "every": 8, "order": (8, 6, 4)}
    run = kr.simulate(body.model(), start, **settings)
    rates, attitude = body.angular_velocity(run.M), body.attitude(run.g)
    for k, (W, q, h, before, held) in enumerate(by_scipy(busy, 4, 2.0, delay, limit), 1):
        assert rates[k] == pytest.approx(W, abs=1e-12)
        assert attitude[k] * np.sign(attitude[k] @ q) == pytest.approx(q, abs=1e-12)
        assert run.wheels.values[k] == pytest.approx(h, abs=1e-14)
        assert run.before.values[k] == pytest.approx(before, abs=1e-16)
        for name in ("dipole", "torque", "wheel_torque", "impulse"):
            assert run[f"commanded_{name}"].values[k] == pytest.approx(held[name], abs=1e-12), name
    assert abs(run.balance - run.balance[0]).max() < 1e-14  # work of magnets, motors and thrusters
    assert run["count"].values.tolist() == [*range(5)]
    assert run.wheels[:, 0].max() == pytest.approx(RANGES[0], rel=1e-12)


# -- noise -------------------------------------------------------------------------------------------------------


def test_the_generator_draws_published_numbers():
    """The output of the authors' program, from the seed 12345, 12345, ...: streams, and the state after 35 numbers."""
    states = streams_from([12345] * 6, 3)
    assert states[1].tolist() == [3692455944, 1366884236, 2968912127, 335948734, 4161675175, 475798818]
    assert states[2].tolist() == [1015873554, 1310354410, 2249465273, 994084013, 2912484720, 3876682925]
    state, drawn = states[2], []
    for _ in range(5):
        u, state = uniform(state)
        drawn.append(float(u))
    published = [0.7285097861965, 0.9655872822837, 0.9961841304801, 0.1149884161813, 0.9731454191297]
    assert drawn == pytest.approx(published, abs=1e-13)
    state = states[0]
    for _ in range(35):
        _, state = uniform(state)
    assert state.tolist() == [1040577685, 3747037609, 277208355, 1712706441, 627445683, 2408037141]
    assert float(uniform(state)[0]) == pytest.approx(0.07941673614985, abs=1e-14)


def test_lanes_of_a_sweep_have_streams_of_their_own_in_any_blocks():
    from kreisel.sweeps.design import NOISE, Lanes

    base = {"system": {"gain": 1.0}, "state": {"generator": [12345] * 6}}
    lanes = Lanes(base, {"grid": {"system": {"gain": [1.0, 2.0, 3.0]}}}, noisy=True)
    assert lanes.values(2, 3)[NOISE].tolist() == [
        [1015873554, 1310354410, 2249465273, 994084013, 2912484720, 3876682925]
    ]
    assert lanes.values(0, 3)[NOISE][2:].tolist() == lanes.values(2, 3)[NOISE].tolist()
    assert NOISE not in Lanes(base, {"grid": {"system": {"gain": [1.0]}}}).values(0, 1)


def test_normal_numbers_are_normal_and_those_of_lanes_independent():
    from scipy.stats import kstest

    found, _ = normals(streams(3, 4000), 4)
    assert kstest(found.ravel(), "norm").pvalue > 1e-6
    assert abs(np.corrcoef(found[:-1].ravel(), found[1:].ravel())[0, 1]) < 6 / np.sqrt(found.size)


def bdot(field, rates, before, *, gain):
    return {
        "dipole": -gain * (field - before) + 0 * rates,
        "before": field,
    }


def noisy(**more):
    given = {"memory": {"before": (0, 0, 0)}, "parameters": {"gain": 3e3}, "limits": {"dipole": 0.2}}
    given |= {"noise": {"rates": 1e-4, "field": {"std": 1e-7, "bias": (1e-8, 0, 0)}}, "seed": 7}
    return Satellite(TENSOR, orbit(), control=kr.Control(bdot, every=2.0, **(given | more)))


@pytest.mark.parametrize("dt", [2.0, 0.5])  # a sample in each step, and in every fourth
def test_lanes_are_runs_of_their_own_and_a_resumed_run_has_the_same_bits(dt, tmp_path):
    body = noisy()
    start = body.state(spin=np.random.default_rng(0).normal(size=(5, 3)) / 10)
    settings = {"orientation": body.orientation(), "dt": dt, "every": 10, "observe": ()}
    lanes = kr.simulate(body.model(), start, steps=60, path=tmp_path / "lanes", **settings)
    for lane in (0, 3):
        alone = {k: v[lane] if k in ("M", "generator") else v for k, v in start.items()}
        run = kr.simulate(body.model(), alone, steps=60, **settings)
        for name in run:
            assert run[name].values.tobytes() == lanes[name].isel(lane=lane).values.tobytes(), name
    kr.simulate(body.model(), start, steps=30, path=tmp_path / "half", **settings)
    resumed = kr.resume(tmp_path / "half", extend=60, system=noisy().model())
    for name in resumed:
        assert resumed[name].values.tobytes() == lanes[name].values.tobytes(), name
    assert np.ptp(lanes.before.values[-1], axis=0).min() > 0
    other = kr.simulate(noisy(seed=8).model(), noisy(seed=8).state(spin=SPIN), steps=2, **settings | {"every": 1})
    same = kr.simulate(body.model(), body.state(spin=SPIN), steps=2, **settings | {"every": 1})
    assert (other.before.values[1] != same.before.values[1]).all()


def test_impulses_between_samples_are_those_of_shorter_steps():
    body = noisy()
    settings = {"order": (8, 6, 4), "times": [0, 2, 3.5, 8], "impulses": {"time": 3.3, "momentum": (0, 0, 1e-3)}}
    long, short = (kr.simulate(body, body.state(spin=SPIN), dt=dt, observe=(), **settings) for dt in (0.5, 0.1))
    for name in ("momentum", "before", "commanded_dipole", "generator"):
        assert long[name].values == pytest.approx(short[name].values, rel=1e-9, abs=1e-12), name


def test_a_run_is_not_resumed_with_another_law(tmp_path):
    body = noisy(noise={})
    settings = {"orientation": body.orientation(), "dt": 2.0, "every": 10, "observe": ()}
    kr.simulate(body.model(), body.state(spin=SPIN), steps=10, path=tmp_path / "run", **settings)
    other = Satellite(
        TENSOR,
        orbit(),
        control=kr.Control(
            lambda field, before, *, gain: {"dipole": gain * (field - before), "before": field},
            every=2.0,
            memory={"before": (0, 0, 0)},
            parameters={"gain": 3e3},
            limits={"dipole": 0.2},
        ),
    )
    with pytest.raises(kr.InputError, match="got other functions"):
        kr.resume(tmp_path / "run", extend=20, system=other.model())


def test_a_row_of_another_controller_is_refused_with_a_way_out():
    plain = Satellite(TENSOR, orbit())
    run = kr.simulate(plain, plain.state(spin=SPIN), dt="1 s", t_end="2 s", progress=False)
    with pytest.raises(kr.InputError, match=r"lacks .*another controller.*body\.state\(spin=row"):
        kr.simulate(noisy(), run.isel(time=-1), dt="1 s", t_end="2 s", progress=False)


def test_a_propagator_goes_on_where_it_was():
    body = noisy()
    state = {**body.state(spin=SPIN), "g": body.orientation()}
    step = kr.propagator(body.model(), dt=0.5, orientation=True)
    whole = step.steps(state, 24, time=0.0)
    parts = step.steps(step.steps(state, 10, time=0.0), 14, time=5.0)
    for name in whole:
        assert parts[name] == pytest.approx(whole[name], rel=1e-10, abs=1e-18), name


# -- wheels ------------------------------------------------------------------------------------------------------


def test_wheels_alone_are_a_gyrostat_whose_momentum_is_constant_in_space():
    far = Orbit(1e12, primary=kr.physical.SUN)
    body = Satellite(TENSOR, far, wheels=Wheels(AXES, MOMENTA))
    settings = {"orientation": body.orientation(), "dt": 0.5, "steps": 40, "observe": ()}
    run = kr.simulate(body.model(), body.state(spin=SPIN), **settings)
    W = body.angular_velocity(run.M)
    C = Rotation.from_quat(body.attitude(run.g), scalar_first=True)
    total = C.apply(W @ TENSOR + np.array(MOMENTA) @ AXES)
    assert total == pytest.approx(np.tile(TENSOR @ SPIN + AXES.T @ MOMENTA, (41, 1)), abs=1e-15)


# -- mistakes ----------------------------------------------------------------------------------------------------

CALLS: list[int] = []


def forgetful(field, before):
    CALLS.append(1)
    return {"dipole": field * len(CALLS), "before": before}


MISTAKES = {
    "no function": (lambda: kr.Control(3), "expected a function of sensors"),
    "an unknown sensor": (lambda: noisy_law(lambda rate: {"torque": rate}), r"got rate. Did you mean 'rates'"),
    "no wheels": (lambda: noisy_law(lambda wheels: {}), "expected arguments among"),
    "an unknown command": (lambda: noisy_law(lambda rates: {"moment": rates}), r"expected a dict of commands \(dipole"),
    "lost memory": (lambda: noisy_law(lambda field, b: {"dipole": b}, memory={"b": (0, 0, 0)}), "without b"),
    "another shape": (lambda: noisy_law(lambda rates, b: {"b": rates}, memory={"b": 0}), r"expected b of shape \(\)"),
    "a side effect": (lambda: noisy_law(forgetful, memory={"before": (0, 0, 0)}), "got two. Usual cause: random"),
    "noise of no sensor": (lambda: kr.Control(bdot, noise={"rate": 1}), "expected a dict with rates"),
    "a negative limit": (lambda: kr.Control(bdot, limits={"dipole": -1}), "sizes >= 0"),
    "a limit of no command": (lambda: noisy(limits={"torque": 1}), "limits: expected a number"),
    "noise of a sensor that the law lacks": (lambda: noisy(noise={"sun": 1e-3}), "expected sensors of the law, field"),
    "a name of the body": (lambda: noisy(parameters={"gain": 1, "drag": 1}), "neither sensors nor the body"),
    "a name of a constant of the body": (lambda: noisy(parameters={"gain": 1, "c": 1}), "neither sensors nor the body"),
    "the name of the time": (lambda: noisy(parameters={"gain": 1, "t": 1}), "neither sensors nor the body"),
    "a matrix": (
        lambda: noisy_law(lambda rates, *, K: {"torque": K @ rates}, parameters={"K": np.eye(3)}),
        r"got \(\)\. .* K \(3, 3\) has a vector for each lane",
    ),
    "memory with the name of a variable": (lambda: kr.Control(bdot, memory={"work": 0.0}), "no variable of a run has"),
    "memory with the name of a velocity": (lambda: kr.Control(bdot, memory={"angular_velocity": 0.0}), "no variable"),
    "a delay": (lambda: noisy(delay=-1), "delay: expected an integer"),
    "axes of wheels": (lambda: Wheels([[1, 1, 0]]), "rows of 3 values and length 1"),
    "a step that does not divide": (lambda: stepped(noisy(), 0.3), "a step that divides the time"),
    "a time between samples": (lambda: stepped(noisy(), 2.0).steps(started(noisy()), 1, time=0.5), "a multiple of dt"),
    "a method without samples": (lambda: stepped(noisy(), 2.0, method="dop853"), "expected 'splitting'"),
    "a chosen order": (
        lambda: kr.simulate(noisy(), noisy().state(), dt=2.0, t_end=8.0, order="auto", tol=1e-6),
        "expected a body without control",
    ),
    "code": (
        lambda: kr.code(noisy().model(), noisy().state(), dt=2.0, language="c", orientation=(1, 0, 0, 0)),
        "expected a body without control",
    ),
    "code without a state": (lambda: kr.code(noisy()), "expected a body without control"),
    "an order with a corrector": (lambda: stepped(noisy(), 1.0, order=(10, 2)), "without a corrector"),
}


def noisy_law(law, **more):
    return Satellite(TENSOR, orbit(), control=kr.Control(law, **more))


def started(body):
    return {**body.state(spin=SPIN), "g": body.orientation()}


def stepped(body, dt, **more):
    return kr.propagator(body.model(), dt=dt, orientation=True, **more)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake):
    call, message = MISTAKES[mistake]
    with pytest.raises(kr.InputError, match=message):
        call()


# -- derivatives -------------------------------------------------------------------------------------------------


def by_density(density):
    return {"torque": 1e-9 * np.array([1.0, 0, 0]) / density}


@pytest.mark.filterwarnings("ignore:control, torque. expected a magnetic field")
@pytest.mark.parametrize(
    ("control", "primary", "name"),
    [
        (kr.physical.bdot(1e-4), kr.physical.Primary("Moon", 4.9028e12, 1.7374e6), "the field"),
        (kr.physical.magnetic_damping(1e-4), kr.physical.EARTH._replace(field=0.0), "the field"),
        (kr.physical.Control(by_density), kr.physical.EARTH, "the density"),
    ],
)
def test_a_law_that_divides_by_a_missing_field_is_named(control, primary, name):
    """The message blamed the step."""
    body = Satellite(TENSOR, Orbit.circular(LOW, 1.0, primary=primary), control=control)
    with pytest.raises(kr.RunError, match=f"a law that divides by {name}, which is 0 there") as error:
        kr.simulate(body, body.state(spin=SPIN), dt=1.0, steps=20, every=10)
    assert "smaller dt" not in str(error.value)


@pytest.mark.skipif(not FULL, reason="`make test-full` runs it")
def test_derivatives_go_through_samples():
    """By a gain that is a sample late, against a difference; the motion is that of a run.

    Samples 12 s apart: the field of a run is interpolated in time for those at most 10 s apart, and here it is not.
    """
    import jax

    from kreisel.reduction import double

    law = kr.Control(bdot, every=12.0, memory={"before": (0, 0, 0)}, parameters={"gain": 3e3}, delay=1)
    body = Satellite(TENSOR, orbit(), control=law)
    model, start = body.model(), body.state(spin=SPIN)
    motion = kr.differentiable(model, order=(2, 2), orientation=True)
    first = {**start.axial, "g": body.orientation()}

    def energy(gain):
        return (motion(first, dt=6.0, steps=10, gain=gain)["M"] ** 2).sum()

    with double():
        end = motion(first, dt=6.0, steps=10)
        run = kr.simulate(model, start, orientation=body.orientation(), dt=6.0, steps=10, order=(2, 2), observe=())
        for name in ("M", "before", "commanded_dipole"):
            assert np.asarray(end[name]) == pytest.approx(run[name].values[-1], rel=1e-13, abs=1e-18), name
        slope, h = jax.grad(energy)(3e3), 3.0
        assert float(slope) == pytest.approx(float(energy(3e3 + h) - energy(3e3 - h)) / (2 * h), rel=1e-6)
        with pytest.raises(kr.InputError, match="a step that divides the time"):
            motion(first, dt=5.0, steps=3)  # past the sample at 12 s


def test_a_motion_in_jax_is_sampled_once_in_each_interval() -> None:
    """A brake held for a second, by the steps of seven stages of the default order; a missed sample is an error."""
    import jax

    from kreisel.physical import FreeBody
    from kreisel.reduction import double

    moments, L = np.array([0.03, 0.05, 0.07]), np.array([0.03, 0.1, 0.007])
    control = kr.Control(lambda rates, *, gain: {"torque": -gain * rates}, every=1.0, parameters={"gain": 0.02})
    motion = kr.differentiable(body := FreeBody(moments, control=control))
    start = body.state(L / moments)
    for _ in range(2):
        torque = -0.02 * L / moments
        rate = lambda t, L, torque=torque: cross(L, L / moments) + torque  # noqa: E731
        L = solve_ivp(rate, (0, 1), L, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    assert np.asarray(motion(start, dt=0.25, steps=8)["momentum"]) == pytest.approx(L, abs=3e-8)
    with pytest.raises(kr.InputError, match="a multiple of dt"):
        motion(start, dt=0.25, steps=8, time=0.1)
    with double():
        at = jax.jit(lambda dt, time: motion(start, dt=dt, steps=8, time=time)["momentum"])
        assert np.asarray(at(0.25, 0.0)) == pytest.approx(L, abs=3e-8)
        assert np.isnan(at(0.3, 0.0)).all() and np.isnan(at(0.25, 0.1)).all()
        with pytest.raises(kr.InputError, match="float32"):
            motion({"momentum": np.float32(L), "attitude": np.eye(4)[0]}, dt=0.25, steps=8)
    with pytest.raises(kr.InputError, match="float32"):
        at(0.25, 0.0)


def test_the_field_at_the_end_of_a_table_of_positions() -> None:
    """Positions of a high orbit to 100 m, 10 s apart, which windows of 600 s miss by 40 nT or more at their ends."""
    high = Orbit.circular("36000 km", epoch="2026-03-20T14:46:00")
    times = np.arange(-1100.0, 101.0, 10.0)
    table = Orbit.from_table(times, np.round(high.at(times)[0], -2), epoch=high.epoch)
    control = kr.Control(lambda field, seen: {"seen": field}, every=1.0, memory={"seen": (0, 0, 0)})
    body = Satellite((1.0, 1.1, 1.2), table, magnetic_field="tilted-dipole", control=control)
    run = kr.simulate(body, body.state((0.0, 0.0, 0.0)), dt=1.0, t_end=100.0, order=(2, 2), progress=False)
    along = np.einsum(
        "tji,tj->ti",
        Rotation.from_quat(run.attitude.values[:-1], scalar_first=True).as_matrix(),
        body.field(run).values[:-1],
    )
    assert abs(run.seen.values[1:] - along).max() < 0.1e-9


def test_a_run_continues_where_another_ended(tmp_path) -> None:
    """From its last row: memory, delayed commands, noise and the field are those of one long run."""
    law = {"memory": {"before": (0, 0, 0)}, "noise": {"field": 1e-8}, "delay": 1, "every": 2.0}
    control = kr.Control(lambda field, before, time: {"dipole": 1e5 * (before - field), "before": field}, **law)
    body = Satellite(TENSOR, orbit(), torque=lambda t: np.array([1e-6, 0, 0]) * np.sin(0.02 * t), control=control)
    usual = {"dt": 1.0, "every": 20, "order": 4, "progress": False}
    long = kr.simulate(body, body.state(SPIN), t_end=200.0, **usual)
    row = kr.simulate(body, body.state(SPIN), t_end=120.0, **usual).isel(time=-1)
    rest = kr.simulate(body, row, t_start=row.time, t_end="200 s", path=tmp_path / "rest.zarr", **usual)
    rest = rest.load()
    assert rest.time.values.tolist() == [120.0, 140.0, 160.0, 180.0, 200.0]
    for name in ("attitude", "momentum", "before", "queue", "commanded_dipole"):
        np.testing.assert_allclose(rest[name], long[name][6:], rtol=1e-9, atol=1e-12 * abs(long[name]).max().item())
    with pytest.warns(kr.InputWarning, match=r"at time 120, .* which begins at 0 here"):
        again = kr.simulate(body, row, t_end=80.0, **usual)
    assert abs(again.attitude - long.attitude).values[-1].max() > 1e-6
    longer = kr.resume(tmp_path / "rest.zarr", extend="240 s", system=body)
    np.testing.assert_array_equal(longer.attitude[:5], rest.attitude)
    assert longer.time.values[-1] == 240.0
    still = Satellite(TENSOR, orbit(), control=kr.Control(lambda time, seen: {"seen": time}, memory={"seen": 0.0}))
    then = {"spin": row.angular_velocity, "attitude": row.attitude}  # with another controller
    seen = kr.simulate(still, still.state(**then), dt=1.0, t_start="2 min", steps=10, progress=False).seen
    assert seen.values[1:].tolist() == [*range(120, 130)]


def test_counts_of_samples_continue_too() -> None:
    """Memory named as counters of the steps: the value is the number of samples, of one each second."""
    names = ("count", "reach", "field_window")
    law = kr.Control(
        lambda rates, count, reach, field_window: {
            "torque": -1e-4 * rates,
            **{k: v + 1 for k, v in zip(names, (count, reach, field_window), strict=True)},
        },
        memory=dict.fromkeys(names, 0.0),
    )
    body = Satellite(TENSOR, orbit(), torque=lambda t: np.array([1e-6, 0, 0]) * np.sin(0.02 * t), control=law)
    first = kr.simulate(body, body.state(SPIN), dt=0.25, t_end=10.0, every=4, progress=False)
    later = kr.simulate(body, first.isel(time=-1), dt=0.25, t_start=10.0, t_end=20.0, every=4, progress=False)
    for name in names:
        assert first[name].values.tolist() == [*range(11)] and later[name].values.tolist() == [*range(10, 21)]


def test_three_lanes_of_a_parameter_are_named() -> None:
    """A steady torque k of a sphere at rest for the time t: k t."""
    law = kr.Control(
        lambda *, k: {"torque": k * np.array([1, 0, 0])}, parameters={"k": xr.DataArray([1, 2, 4], dims="lane")}
    )
    body = kr.physical.FreeBody((1, 1, 1), control=law)
    run = kr.simulate(body, body.state((0, 0, 0)), dt=0.5, t_end=3.0, progress=False)
    assert np.allclose(run.momentum[-1], [(3, 0, 0), (6, 0, 0), (12, 0, 0)], rtol=1e-14)


def test_an_archive_that_begins_later_is_checked(tmp_path) -> None:
    body = Satellite(TENSOR, orbit())
    kr.simulate(body, body.state(SPIN), dt=1.0, t_start=3000.0, steps=20, path=tmp_path / "later.zarr", progress=False)
    assert check_archive(tmp_path / "later.zarr")[1] == []
    assert check_archive(tmp_path / "later.zarr")[0].attrs["t_start"] == 3000.0


def test_a_start_between_samples_has_the_name_of_the_argument() -> None:
    """t_start in `kr.simulate`, time in `kr.differentiable` and in the steps of a propagator."""
    body = noisy(noise={}, limits={})
    motion = kr.differentiable(body, order=(2, 2), orientation=True)
    with pytest.raises(kr.InputError, match=r"^time: expected a multiple of dt = 1 s, .* got 0\.5"):
        motion(body.state(SPIN), dt=1.0, steps=2, time=0.5)


@pytest.mark.parametrize(
    ("when", "said"),
    [
        ({"t_start": 0.5, "steps": 4}, "t_start: expected a multiple of dt = 1 s"),
        ({"t_start": 10, "t_end": 5}, "t_end: expected after t_start = 10"),
        ({"t_start": 10, "times": [11, 12]}, "t_start: expected 0"),
        ({"t_start": "1 m", "steps": 4}, "t_start"),
    ],
)
def test_starts_that_are_not(when, said) -> None:
    body = Satellite(TENSOR, orbit(), control=kr.Control(lambda rates: {"torque": -rates}))
    with pytest.raises(kr.InputError, match=said):
        kr.simulate(body, body.state(SPIN), dt=1.0, progress=False, **when)
