"""User-defined forces on bodies: an independent integration in the axes in which the body was given."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.physical import EARTH, EddyCurrents, FreeBody, Gyroscope, HeavyBody, Orbit, Satellite, SubmergedBody
from support import cross

TENSOR = np.array([[2.0, 0.3, 0.1], [0.3, 3.0, 0.4], [0.1, 0.4, 4.0]])
SPIN = np.array([0.5, 0.2, 0.7])
START = Rotation.from_rotvec((0.3, -0.5, 0.2))
Torque = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def reference(
    inertia: np.ndarray, torque: Torque, time: float, start: Rotation = START, spin: Any = SPIN
) -> tuple[Any, Any]:
    """The attitude matrix and the angular velocity at the end: I w' = I w x w + torque, R' = R [w]."""

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        R, w = z[:9].reshape(3, 3), z[9:]
        turning = [cross(r, w) for r in R]  # R hat(w) has the rows r x w
        return np.append(turning, np.linalg.solve(inertia, cross(inertia @ w, w) + torque(R, w, t)))

    z = solve_ivp(rate, (0, time), np.append(start.as_matrix(), spin), "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return z[:9].reshape(3, 3), z[9:]


def by_differences(V: Callable[[np.ndarray], float], R: np.ndarray) -> np.ndarray:
    """The torque of a potential: minus its change by small rotations about the body axes."""
    small = [Rotation.from_rotvec(1e-5 * axis).as_matrix() for axis in np.eye(3)]
    return -np.array([V(R @ S) - V(R @ S.T) for S in small]) / 2e-5


def quaternion(start: Rotation) -> np.ndarray:
    return start.as_quat(scalar_first=True)


def end_of(body: Any, state: Any, time: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """The attitude of the axes given, and the angular velocity along them."""
    run = kr.simulate(body, state, dt=f"{dt} s", t_end=f"{time} s", every=f"{time} s", progress=False)
    q = Rotation.from_quat(run.attitude[-1].values, scalar_first=True)
    return q.as_matrix(), run.angular_velocity[-1].values


def rub(Omega: Any, M: Any, t: Any, *, k: Any) -> Any:
    return -k * Omega + np.stack([0.1 * np.sin(t), 0.02 * M[2], 0.0 * t])


def well(g: Any, t: Any, k: Any) -> Any:
    return k * g[0, 1] * (1 + t) + g[2, 0] ** 2


def own_torque(R: np.ndarray, w: np.ndarray, t: float, k: float = 0.2) -> np.ndarray:
    return -k * w + [0.1 * np.sin(t), 0.02 * (TENSOR @ w)[2], 0] + by_differences(lambda R: well(R, t, k), R)


FORCES: dict[str, Any] = {"torque": rub, "potential": well, "params": {"k": 0.2}}


def test_a_free_body() -> None:
    body = FreeBody(TENSOR, time_unit=0.7, **FORCES)
    R, w = end_of(body, body.state(SPIN, attitude=quaternion(START)), 3.0, 0.05)
    expected = reference(TENSOR, own_torque, 3.0)
    assert abs(R - expected[0]).max() < 1e-7 and abs(w - expected[1]).max() < 1e-7  # 3e-9
    other = reference(TENSOR, lambda R, w, t: own_torque(R, w, t, 0.21), 3.0)  # the comparison sees a rate of 5 %
    assert abs(w - other[1]).max() > 1e-3


def test_a_heavy_body() -> None:
    arm = np.array([0.05, -0.1, 0.3])
    body = HeavyBody(1.5, TENSOR, arm, **FORCES)

    def torque(R: np.ndarray, w: np.ndarray, t: float) -> np.ndarray:
        return cross(arm, -1.5 * body.gravity * R[2]) + own_torque(R, w, t)

    R, w = end_of(body, body.state(SPIN, attitude=quaternion(START)), 2.0, 0.05)
    expected = reference(TENSOR, torque, 2.0)
    assert abs(R - expected[0]).max() < 1e-6 and abs(w - expected[1]).max() < 1e-6  # 2e-8


def test_a_gyroscope() -> None:
    """Friction of the bearing about the third axis, and a potential of the orientation."""
    wheel = Gyroscope(
        3.0,
        0.17,
        0.1525,
        0.15,
        torque=lambda Omega, k: -k * Omega * np.array([0, 0, 1]),
        potential=well,
        params={"k": 0.2},
    )
    inertia = np.diag([wheel.transverse_moment] * 2 + [wheel.axial_moment])

    def torque(R: np.ndarray, w: np.ndarray, t: float) -> np.ndarray:
        weight = cross([0, 0, wheel.lever], -wheel.mass * wheel.gravity * R[2])
        return weight - [0, 0, 0.2 * w[2]] + by_differences(lambda R: well(R, t, 0.2), R)

    start = Rotation.from_quat(wheel.orientation(1.2), scalar_first=True)
    expected = reference(inertia, torque, 0.5, start, [0, 0, 20.0])
    R, w = end_of(wheel, wheel.state(tilt=1.2, spin=20.0), 0.5, 0.005)
    assert abs(R - expected[0]).max() < 1e-6 and abs(w - expected[0] @ expected[1]).max() < 1e-5  # w in space
    assert w @ R[:, 2] < 0.8 * 20  # friction slowed the wheel


def test_a_submerged_body() -> None:
    """Without added mass and weight it rotates like a free body."""
    body = SubmergedBody(5.0, TENSOR, gravity=0.0, torque=lambda Omega: -0.2 * Omega, potential=lambda g: 0.3 * g[0, 1])
    start = body.state(angular_velocity=SPIN, attitude=quaternion(START))
    R, w = end_of(body, start, 3.0, 0.05)
    expected = reference(TENSOR, lambda R, w, t: -0.2 * w + by_differences(lambda R: 0.3 * R[0, 1], R), 3.0)
    assert abs(R - expected[0]).max() < 1e-7 and abs(w - expected[1]).max() < 1e-7


def control(B: Any, Omega: Any, sun: Any, r: Any, v: Any, light: Any, density: Any, *, gain: Any) -> Any:
    """Eddy currents, a sail, and an arm in the air."""
    dipole = -gain * np.cross(Omega, B)
    return np.cross(dipole, B) + 1e-6 * light * sun + density * 1e-4 * np.cross(v, r / np.sqrt(r @ r))


ORBIT = Orbit(6.9e6, 0.01, 1.2, 0.3, 0.4)
SAIL: dict[str, Any] = {"magnetic_moment": (0.1, -0.2, 0.3), "density": 1e-3, "sun": (0.6, 0.0, 0.8)}


def test_a_satellite() -> None:
    body = Satellite(TENSOR, ORBIT, torque=control, params={"gain": 1e7}, **SAIL)
    R, w = end_of(body, body.state(0.1 * SPIN, attitude=quaternion(START)), 60.0, 2.0)

    def torque(R: np.ndarray, w: np.ndarray, t: float) -> np.ndarray:
        r, v = (x @ R for x in ORBIT.at(t))
        distance = np.linalg.norm(r)
        u, z = r / distance, R[2]
        B = -EARTH.field / distance**3 * (z - 3 * (z @ u) * u)
        gravity = 3 * EARTH.mu / distance**3 * cross(u, TENSOR @ u)
        own = control(B, w, np.array(SAIL["sun"]) @ R, r, v, 1.0, SAIL["density"], gain=1e7)
        return gravity + cross(SAIL["magnetic_moment"], B) + own

    expected = reference(TENSOR, torque, 60.0, spin=0.1 * SPIN)
    assert abs(R - expected[0]).max() < 1e-6 and abs(w - expected[1]).max() < 1e-7
    without = reference(TENSOR, lambda R, w, t: np.zeros(3), 60.0, spin=0.1 * SPIN)
    assert abs(w - without[1]).max() > 1e-3


def test_forces_are_carried_by_archives_pickles_and_lanes(tmp_path: Path) -> None:
    body = Satellite(TENSOR, ORBIT, torque=control, params={"gain": [1e6, 1e7]}, **SAIL)
    settings: dict[str, Any] = {"dt": "2 s", "every": "20 s", "progress": False}
    whole = kr.simulate(body, body.state(0.1 * SPIN), t_end="60 s", **settings)
    kr.simulate(body, body.state(0.1 * SPIN), t_end="20 s", path=tmp_path / "a.zarr", **settings)
    model = pickle.loads(pickle.dumps(body.in_si()))
    again = kr.resume(tmp_path / "a.zarr", system=model, extend=20, progress=False)
    assert again.momentum.equals(whole.momentum[:3])
    longer = kr.resume(tmp_path / "a.zarr", system=body, extend=30, progress=False)
    assert longer.momentum.equals(whole.momentum)
    assert kr.analysis.angular_velocity(longer, system=body).shape == longer.momentum.shape
    assert abs(whole.momentum[-1, 0] - whole.momentum[-1, 1]).max() > 1e-4
    assert abs(body.angles(whole).pitch).max() > 0.01
    other = Satellite(TENSOR, ORBIT, torque=lambda Omega: -Omega, params={"gain": [1e6, 1e7]}, **SAIL)
    with pytest.raises(kr.InputError, match="changed since"):
        kr.resume(tmp_path / "a.zarr", system=other.in_si(), extend=40, progress=False)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown quantity": ({"torque": lambda Omegas: 0}, "got Omegas. Did you mean 'Omega'"),
    "a quantity of satellites": ({"torque": lambda B: B}, "expected arguments among M, Omega, g, t, got B"),
    "a potential of the momentum": ({"potential": lambda Omega: Omega[0]}, "among g, t, got Omega"),
    "a number": ({"torque": 0.3}, "torque: expected a function"),
    "a scalar torque": ({"torque": lambda t: t}, r"expected a vector \(3,\)"),
    "an if": ({"torque": lambda Omega: Omega if Omega[0] > 0 else -Omega}, r"test_forced.py, line \d+: .*np\.where"),
    "a parameter of that name": ({"torque": lambda t: [t, t, t], "params": {"t": 1.0}}, "got 't'"),
    "damping of other axes": ({"damping": (0.1, 0.2, 0.3)}, "expected one rate"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_forces(case: str) -> None:
    forces, message = REFUSED[case]
    with pytest.raises(kr.InputError, match=message):
        FreeBody(TENSOR, **forces).model()


# -- eddy currents -----------------------------------------------------------------------------------

ENVISAT = np.array([[17023.3, 397.1, -2171.4], [397.1, 124825.7, 344.2], [-2171.4, 344.2, 129112.2]])
SHEETS = (931500.0, 1059000.0, 1059000.0)  # S m^4
# D-SPOSE 1.0.0, McGill University, expected output of its example, Envisat on 2013-05-07: state at t = 0 s (TEME),
# angular velocity and attitude at 10 s; and the torque of eddy currents at the end of the steps to 0.1, 5.1 and 10.1 s,
# with the field of IGRF-12.
PLACE_OF_ENVISAT = (-6.8513213592900028e6, -2.03608125318e6, 51.209100002888590)
VELOCITY = (-303.42360099999678, 1051.5137020000006, 7388.9006430000009)
AT_FIRST = (0.63385515879563592, 0.34429412470306686, 0.55596281630038358, -0.41303091924752378)
AT_LAST = (0.71594026177812464, 0.47380278817532273, 0.45246184760099001, -0.24128559001287089)
RATE_AT_LAST = (4.7707658898355507e-4, 5.5383522698853780e-4, 5.0624151370082866e-2)
PRINTED = {
    1: (-8.3148e-6, -1.5316e-6, -3.3007e-5),
    51: (-8.5078e-6, 2.9235e-7, -3.3091e-5),
    101: (-8.1539e-6, 1.9964e-6, -3.2623e-5),
}


def test_envisat_is_that_of_another_program() -> None:
    """Its air, light and damper, which are left out here, change the rate by 1e-8 rad/s in ten seconds."""
    orbit = Orbit.from_state(PLACE_OF_ENVISAT, VELOCITY, epoch="2013-05-07T10:57:14.506")
    body = Satellite(ENVISAT, orbit, torque=EddyCurrents(SHEETS), degree=6)
    start = body.state((0, 0, 5.0614548307835558e-2), attitude=AT_FIRST)
    run = kr.simulate(body, start, dt="0.1 s", t_end="10.1 s", every="0.1 s", order=(2, 2), progress=False)
    assert abs(run.angular_velocity[100].values - RATE_AT_LAST).max() < 4e-8  # 2e-8; without gravity 1e-5
    assert abs(run.attitude[100].values - AT_LAST).max() < 1e-7
    model, bare = body.model(), Satellite(ENVISAT, orbit, degree=6).model()
    axes = model.body_frame.axes
    for row, printed in PRINTED.items():
        M = kr.algebra.hat(run.momentum[row].values @ axes)
        g = kr.algebra.rotation_matrix(run.attitude[row].values) @ axes
        (rate,), (other,) = (m.call(m.system.flow, M, g=g, t=np.float64(0.1 * row)) for m in (model, bare))
        torque = axes @ kr.algebra.axial(rate - other)
        assert abs(torque - printed).max() < 1e-7  # 5e-8; 2e-6 without the rate of the field


def test_tensors_that_no_body_has_are_refused() -> None:
    for tensor in ([[1, 2, 0], [0, 1, 0], [0, 0, 1]], (1, -1, 1), "3 N m"):
        with pytest.raises(kr.InputError, match="tensor"):
            EddyCurrents(tensor)


def test_a_table_that_ends_too_soon_is_told_in_seconds() -> None:
    """The unit of time of a heavy body is not 1 s: nothing may say that these times are multiples of it."""
    short = kr.Table([0.0, 3.0], np.zeros((2, 3)))
    body = HeavyBody(1.0, TENSOR, (0.0, 0.0, 0.1), torque=lambda t, motor: motor(t), params={"motor": short})
    with pytest.raises(kr.InputError, match=r"motor: .* 0 to 4, got one from 0 to 3\.") as caught:
        kr.simulate(body, body.state(SPIN), dt="5 ms", t_end="4 s")
    assert "multiples" not in str(caught.value)
    with pytest.raises(kr.InputError, match=r"t_start: .* multiples of 1\.749"):
        kr.simulate(body, body.state(SPIN), dt="5 ms", t_start="1 s", times=[2.0])


def test_parameters_with_names_of_quantities_are_refused() -> None:
    """They were ignored: the momentum is not the state's letter of a gyroscope."""
    with pytest.raises(kr.InputError, match=r"^params: expected names other than M, Omega, g, t, got 'M'"):
        Gyroscope(1.0, 0.1, 0.2, 0.1, torque=lambda Omega, M: -M * Omega, params={"M": 0.01}).model()


def test_functions_of_exec_have_no_module() -> None:
    """In a state of its names; the motion is the exponential of -k t/I."""
    names: dict[str, Any] = {}
    exec("def brake(Omega): return -0.1 * Omega", names)
    body = FreeBody((1.0, 2.0, 2.5), torque=names["brake"])
    run = kr.simulate(body, body.state((0, 0, 1.0)), dt="0.5 s", t_end="10 s")
    assert run.angular_velocity.values[-1, 2] == pytest.approx(np.exp(-0.1 / 2.5 * 10), rel=1e-9)
