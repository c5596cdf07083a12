"""Controllers of bodies that are not on an orbit, against Euler's equations in the body axes; wheels; mistakes."""

from contextlib import nullcontext

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.physical import FreeBody, Gyroscope, HeavyBody, SubmergedBody, Wheels
from support import cross, rotation_matrix

TENSOR = np.array([[0.03, 0.002, -0.001], [0.002, 0.028, 0.0015], [-0.001, 0.0015, 0.012]])
ARM, MASS = np.array([0.01, 0.02, 0.1]), 0.1
EVERY, GAIN = 0.1, 1e-3


def law(rates, attitude, time, count, *, gain):
    drive = 1e-3 * attitude[1:] * np.cos(time)
    return {"torque": drive - gain * rates * np.array([1, 2, 3]), "count": count + 1.0, "impulse": push(count)}


def push(count):
    return 1e-4 * np.array([1.0, 0.0, -1.0]) * count


def control(**more):
    return kr.Control(law, every=EVERY, memory={"count": 0.0}, parameters={"gain": GAIN}, **more)


def by_scipy(inertia, weight, q, rates, samples):
    """Attitudes at the samples; weight: arm times m g, along the body axes."""
    L, out = inertia @ rates, []
    for k in range(samples):
        held = law(np.linalg.solve(inertia, L), q, k * EVERY, float(k), gain=GAIN)

        def slope(t, y, held=held):
            W, C = np.linalg.solve(inertia, y[:3]), rotation_matrix(y[3:])
            tau = cross(y[:3], W) + held["torque"] + cross(weight, C.T @ [0, 0, -1])
            return [*tau, -y[4:] @ W / 2, *((y[3] * W + cross(y[4:], W)) / 2)]

        start = [*(L + held["impulse"]), *q]
        y = solve_ivp(slope, (0, EVERY), start, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        L, q = y[:3], y[3:] / np.linalg.norm(y[3:])
        out.append(q)
    return np.array(out)


PIVOT = TENSOR + MASS * (ARM @ ARM * np.eye(3) - np.outer(ARM, ARM))
TILTED = tuple(Rotation.from_rotvec([0.3, 0.1, 0]).as_quat(scalar_first=True))
BODIES = {
    "free": (
        FreeBody(TENSOR, time_unit=3.0, control=control()),
        {"spin": (1, 2, -1), "attitude": TILTED},
        TENSOR,
        np.zeros(3),
        (1, 2, -1),
    ),
    "heavy": (
        HeavyBody(MASS, PIVOT, ARM, control=control()),
        {"angular_velocity": (1, 2, -1), "attitude": TILTED},
        PIVOT,
        9.80665 * MASS * ARM,
        (1, 2, -1),
    ),
    "submerged": (
        SubmergedBody(2.0, TENSOR, control=control()),  # without added mass and drag a free body
        {"angular_velocity": (1, 2, -1), "attitude": TILTED},
        TENSOR,
        np.zeros(3),
        (1, 2, -1),
    ),
    "gyroscope": (
        Gyroscope(0.5, 1e-3, 5e-3, 0.05, control=control()),
        {"tilt": "20 deg", "spin": 30.0},
        np.diag([5e-3, 5e-3, 1e-3]),
        np.array([0, 0, 0.5 * 9.80665 * 0.05]),
        (0, 0, 30),
    ),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_controller_is_that_of_an_independent_loop(name):
    body, start, inertia, weight, rates = BODIES[name]
    run = kr.simulate(body, body.state(**start), dt=0.005, every=20, steps=200)
    found, truth = run.attitude.values, by_scipy(inertia, weight, run.attitude.values[0], np.array(rates), 10)
    sign = np.sign((found[1:] * truth).sum(-1, keepdims=True))
    assert found[1:] * sign == pytest.approx(truth, abs=1e-9)
    assert run["count"].values.tolist() == [*range(11)]
    assert run.commanded_impulse.values[5] == pytest.approx(push(4.0), rel=1e-12)
    assert abs(run.balance - run.balance[0]).max() < 1e-8 * abs(run.energy).max()


def test_three_lanes_of_a_law_begin_with_one_state():
    gains = np.array([[0.01], [0.02], [0.05]])
    brake = kr.Control(lambda rates, *, gain: {"torque": -gain * rates}, every=0.1, parameters={"gain": gains})
    body = FreeBody((1, 1, 1), control=brake)
    run = kr.simulate(body, body.state((1, 2, -1)), dt=0.1, t_end=2.0, every=20)
    for lane, gain in enumerate(gains[:, 0]):  # of a ball, the rates at the samples are a geometric sequence
        expected = np.array([1, 2, -1]) * (1 - 0.1 * gain) ** 20
        assert run.angular_velocity.values[-1, lane] == pytest.approx(expected, rel=1e-10)


def test_wheels_of_a_free_body_and_their_motors_keep_the_momentum_in_space():
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    brake = kr.Control(lambda rates: {"wheel_torque": 1e-3 * corners @ rates}, every=0.1)
    body = FreeBody(TENSOR, time_unit=3.0, wheels=Wheels(corners, (1e-3, 0, -2e-3, 1e-3)), control=brake)
    run = kr.simulate(body, body.state((1, 2, -1)), dt=0.1, t_end=10.0, every=10)
    total = (run.momentum + run.wheels.values @ corners).values
    total = Rotation.from_quat(run.attitude.values, scalar_first=True).apply(total)
    assert total == pytest.approx(np.tile(total[0], (11, 1)), abs=1e-14)
    assert total[0] == pytest.approx(TENSOR @ (1, 2, -1) + corners.T @ (1e-3, 0, -2e-3, 1e-3), abs=1e-15)
    rate = np.linalg.norm(run.angular_velocity, axis=-1)
    assert (np.diff(rate) < 0).all() and rate[-1] < 0.7 * rate[0]


@pytest.mark.parametrize("command", [None, "torque", "wheel_torque"])
def test_a_limit_that_no_motor_heeds_is_doubted(command):
    """The first wheel reaches the limit after (3 - 1)/0.01 = 200 s, the second after 100 s, if no law commands them."""
    law = command and kr.Control(lambda time: {command: np.zeros(3) + 0 * time}, every=10.0)
    wheels = Wheels(np.eye(3), (1e-3, -2e-3, 0), torque=(1e-5, -1e-5, 0), limit=3e-3)
    heeds = command == "wheel_torque"
    with nullcontext() if heeds else pytest.warns(kr.InputWarning, match="beyond its limit after 100 s"):
        run = kr.simulate(body := FreeBody(TENSOR, wheels=wheels, control=law), body.state((0, 0, 0)), dt=10, t_end=500)
    ends = (3e-3, -3e-3, 0) if heeds else (6e-3, -7e-3, 0)
    assert run.wheels.values[-1] == pytest.approx(ends, abs=1e-15)


THREE = np.tile((1, 0, 0, 0), (3, 1))


def turned(**state):
    return kr.propagator(FreeBody(TENSOR), dt=0.1, orientation=True).to(state, 1.0)


def test_an_attitude_of_all_lanes():
    momenta = np.eye(3)[:2]
    state, every = (turned(momentum=momenta, attitude=q) for q in (THREE[0], THREE[:2]))
    assert all((state[name] == every[name]).all() for name in every)


def stepped(**further):
    return kr.propagator(FreeBody(TENSOR), dt=0.1).steps({"momentum": (1, 0, 0), **further}, 1)


MISTAKES = {
    "a dipole": (
        lambda: FreeBody(TENSOR, control=kr.Control(lambda rates: {"dipole": rates})),
        r"commands \(torque, i",
    ),
    "a field": (lambda: FreeBody(TENSOR, control=kr.Control(lambda field: {"torque": field})), "among rates, attitude"),
    "wheels": (lambda: HeavyBody(MASS, PIVOT, ARM, wheels=Wheels(np.eye(3))), "wheels: expected a free body or a"),
    "lanes of other units": (
        lambda: FreeBody([TENSOR, 2 * TENSOR], control=control()),
        "Lane 1: expected the functions",
    ),
    "a state with the wheels of another body": (lambda: stepped(wheels=(0, 0, 1)), "momentum, got 'wheels' too"),
    "a state of a momentum and an attitude, swapped": (
        lambda: turned(momentum=(1, 0, 0, 0), attitude=(1, 0, 0)),
        r"3 values of momentum, or \(lanes, 3\), got",
    ),
    "a state of two momenta and three attitudes": (
        lambda: turned(momentum=np.ones((2, 3)), attitude=THREE),
        r"do not fit: momentum \(2,\), attitude \(3,\)",
    ),
    "a run of two momenta and three attitudes": (
        lambda: kr.simulate(FreeBody(TENSOR), FreeBody(TENSOR).state(np.ones((2, 3)), attitude=THREE), dt=1, steps=1),
        r"parameters \(\), M \(2,\), g \(3,\)",
    ),
    "a state with an attitude": (
        lambda: stepped(attitude=(1, 0, 0, 0)),
        r"momentum, got 'attitude' too.*orientation=T",
    ),
    "no controller": (lambda: FreeBody(TENSOR, control=3), "control: expected kr.physical.Control"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake):
    made, message = MISTAKES[mistake]
    with pytest.raises(kr.InputError, match=message):
        made().model()
