"""Ready laws judged by physics: kinetic energy, time, attitudes and momenta; and through pickle."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.physical import Orbit, Satellite, Wheels, bdot, magnetic_damping, pointing, sun_pointing
from sizes import full

ORBIT = Orbit.circular("500 km", inclination="97.4 deg")
TENSOR = np.diag([0.4, 0.5, 0.3])
STIFF, DAMPING = 1e-3, 2.8e-2
SETTINGS = {"dt": "1 s", "order": (2, 2), "every": "60 s"}
NEAR = 1e-3


def cosines(run):
    """The body axes in space at the end, as columns."""
    return Rotation.from_quat(run.attitude.values[-1], scalar_first=True).as_matrix()


@pytest.fixture(scope="module")
def detumbled():
    out = {}
    for law in (bdot, magnetic_damping):
        cubesat = Satellite.cubesat(ORBIT, 3)
        gain = 2 * ORBIT.mean_motion * (1 + np.sin(np.radians(97.4))) * cubesat.inertia.diagonal().min()
        cubesat = Satellite.cubesat(ORBIT, 3, control=law(gain, limits={"dipole": 0.2}))
        start = cubesat.state(spin=np.radians([6, 6, -5.3]))
        out[law] = kr.simulate(cubesat, start, t_end="5 h", **SETTINGS), gain, cubesat.inertia.diagonal().max()
    return out


@pytest.mark.parametrize("law", [bdot, magnetic_damping])
def test_magnets_brake_a_tumbling_satellite(law, detumbled):
    """Kinetic energy falls in every orbit, down to a rate of about two turns in one, that of the field's direction."""
    run, gain, largest = detumbled[law]
    rates = np.linalg.norm(run.angular_velocity, axis=-1)
    hours = rates[:: round(ORBIT.period / 60)]
    assert hours[0] == pytest.approx(np.radians(10), rel=1e-3)
    assert (np.diff(hours[:3]) < 0).all()
    assert rates[-60:].max() < 3 * ORBIT.mean_motion
    assert abs(run.commanded_dipole).max() <= 0.2
    # the mean torque is -(2/3) gain w where the field has all directions in the body, so a rate falls by e in
    # 3 I/(2 gain); up to three times as long where the axis of the rotation is near the field
    times = run.time.values[rates < rates[0] / np.e]
    assert 0.5 * 1.5 * largest / gain < times[0] < 3 * 1.5 * largest / gain
    assert (run.work.diff("time") < 1e-7).all()


def test_the_sign_of_b_dot_matters():
    cubesat = Satellite.cubesat(ORBIT, 3, control=bdot(-3e-5, limits={"dipole": 0.2}))
    run = kr.simulate(cubesat, cubesat.state(spin=np.radians([6, 6, -5.3])), t_end="1 h", **SETTINGS)
    assert np.linalg.norm(run.angular_velocity.values[-1]) > 1.2 * np.radians(10)


WHEELS = Wheels(np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3))


def held(target, unloading=1e-9):
    control = pointing(WHEELS, STIFF, DAMPING, target=target, unloading=unloading, limits={"wheel_torque": 2e-3})
    body = Satellite(TENSOR, ORBIT, wheels=WHEELS, control=control)
    return kr.simulate(body, body.state(spin=(0.01, 0.02, -0.01), attitude=(1, 0, 0, 0)), t_end="40 min", **SETTINGS)


def test_wheels_hold_the_frame_of_the_orbit():
    run = held("orbit")
    r, v = ORBIT.at(run.time.values[-1])
    down, normal = -r / np.linalg.norm(r), np.cross(r, v) / np.linalg.norm(np.cross(r, v))
    x, y, z = cosines(run).T
    assert z @ down > 1 - NEAR
    assert y @ -normal > 1 - NEAR
    assert x @ v > 0
    assert run.angular_velocity.values[-1] == pytest.approx([0, -ORBIT.mean_motion, 0], abs=1e-6)


SPARED = pointing(WHEELS, STIFF, DAMPING, limits={"wheel_torque": 2e-3})
POINTED = Satellite(TENSOR, ORBIT, wheels=WHEELS, control=SPARED)  # one kernel for every start


UPSIDE_DOWN = [((1, 0, 0), 180.0), ((0, 1, 0), 179.0), ((1, -1, 0.2), 180.0)]
OTHERS = [((1, 0, 0), 179.0), ((0, 1, 0), 180.0), ((0, 0, 1), 179.0), ((0, 0, 1), 180.0), ((1, -1, 0.2), 179.0)]


@pytest.mark.parametrize(("axis", "degrees"), [*UPSIDE_DOWN, *full(*OTHERS)])
def test_an_attitude_upside_down_feels_the_full_torque(axis, degrees):
    """A satellite at rest in the frame of the orbit, half a turn from the target, is there after four minutes."""
    r, v = ORBIT.at(0.0)
    ahead, down, rate = v / np.linalg.norm(v), -r / np.linalg.norm(r), np.cross(r, v) / (r @ r)
    frame = Rotation.from_matrix(np.column_stack([ahead, np.cross(down, ahead), down]))
    start = frame * Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    state = POINTED.state(spin=start.inv().apply(rate), attitude=start.as_quat(scalar_first=True))
    run = kr.simulate(POINTED, state, t_end="4 min", **SETTINGS)
    r, v = ORBIT.at(run.time.values[-1])
    _, y, z = cosines(run).T
    assert z @ -r > (1 - NEAR) * np.linalg.norm(r)
    assert y @ -np.cross(r, v) > (1 - NEAR) * np.linalg.norm(np.cross(r, v))


def test_wheels_hold_an_attitude_and_magnets_take_their_momentum():
    aim = Rotation.from_euler("xyz", [100, -40, 60], degrees=True)
    target = aim.as_quat(scalar_first=True)
    run = held(tuple(-target), unloading=2e-3)  # the same attitude as q
    assert (aim.inv() * Rotation.from_matrix(cosines(run))).magnitude() < NEAR
    loaded = held(tuple(-target))
    momenta = [np.linalg.norm(each.wheels.values[-1] @ WHEELS.axes) for each in (run, loaded)]
    assert momenta[0] < 0.5 * momenta[1]


def test_an_axis_points_at_the_sun():
    body = Satellite(TENSOR, ORBIT, sun=(0, 0.6, 0.8), control=sun_pointing((0, 1, 0), STIFF, DAMPING))
    run = kr.simulate(body, body.state(spin=(0.01, 0.02, -0.01), attitude=(1, 0, 0, 0)), t_end="40 min", **SETTINGS)
    assert cosines(run)[:, 1] @ (0, 0.6, 0.8) > 1 - NEAR


AWAY = [((0, 1, 0), 180.0), ((1, -2, 0.5), 179.0)]
OTHERS = [((0, 1, 0), 179.0), ((1, 0, 0), 179.0), ((1, 0, 0), 180.0), ((1, -2, 0.5), 180.0)]


@pytest.mark.parametrize(("axis", "degrees"), [*AWAY, *full(*OTHERS)])
def test_an_axis_away_from_the_sun_feels_the_full_torque(axis, degrees):
    """A satellite at rest whose axis points away from the Sun: it points there after four minutes."""
    axis, sun = np.array(axis) / np.linalg.norm(axis), np.array([0, 0.6, 0.8])
    start, _ = Rotation.align_vectors([-sun], [axis])
    start = Rotation.from_rotvec(np.radians(180 - degrees) * np.array([1, 0, 0])) * start
    body = Satellite(TENSOR, ORBIT, sun=sun, eclipse=False, control=sun_pointing(axis, STIFF, DAMPING))
    run = kr.simulate(body, body.state(attitude=start.as_quat(scalar_first=True)), t_end="4 min", **SETTINGS)
    assert start.apply(axis) @ sun < np.cos(np.radians(degrees - 0.1))
    assert cosines(run) @ axis @ sun > 1 - NEAR


def test_a_controlled_satellite_is_the_same_through_pickle():
    body = Satellite.cubesat(ORBIT, 3, control=bdot(1e-5, limits={"dipole": 0.2}))
    settings = {"orientation": body.orientation(), "dt": 1.0, "steps": 5, "order": (2, 2)}
    again = pickle.loads(pickle.dumps(body.model()))
    one, two = (kr.simulate(model, body.state(), **settings) for model in (body.model(), again))
    assert one.M.values.tobytes() == two.M.values.tobytes()
    wheeled = Satellite(TENSOR, ORBIT, wheels=WHEELS, control=pointing(WHEELS, STIFF, DAMPING)).model()
    assert pickle.loads(pickle.dumps(wheeled)).system.space.components == wheeled.system.space.components


MISTAKES = {
    "two wheels": (lambda: pointing(Wheels([[1, 0, 0], [0, 1, 0]]), 1, 1), "axes in all directions"),
    "a target": (lambda: pointing(WHEELS, 1, 1, target="earth"), "expected 'orbit' or an attitude"),
    "no direction": (lambda: sun_pointing((0, 0, 0), 1, 1), "got the zero vector"),
    "a unit": (lambda: bdot("1 N m"), "gain"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake):
    call, message = MISTAKES[mistake]
    with pytest.raises(kr.InputError, match=message):
        call()
