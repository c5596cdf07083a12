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
from kreisel.physical import EARTH, FreeBody, Gyroscope, HeavyBody, Orbit, Satellite, SubmergedBody

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
        turning = np.cross(R, w)  # rows: R hat(w) has the rows r x w
        return np.append(turning, np.linalg.solve(inertia, np.cross(inertia @ w, w) + torque(R, w, t)))

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
        return np.cross(arm, -1.5 * body.gravity * R[2]) + own_torque(R, w, t)

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
        weight = np.cross([0, 0, wheel.lever], -wheel.mass * wheel.gravity * R[2])
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
        gravity = 3 * EARTH.mu / distance**3 * np.cross(u, TENSOR @ u)
        own = control(B, w, np.array(SAIL["sun"]) @ R, r, v, 1.0, SAIL["density"], gain=1e7)
        return gravity + np.cross(SAIL["magnetic_moment"], B) + own

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
    assert abs(whole.momentum[-1, 0] - whole.momentum[-1, 1]).max() > 1e-4
    assert abs(body.angles(whole).pitch).max() > 0.01
    other = Satellite(TENSOR, ORBIT, torque=lambda Omega: -Omega, params={"gain": [1e6, 1e7]}, **SAIL)
    with pytest.raises(kr.InputError, match="changed since"):
        kr.resume(tmp_path / "a.zarr", system=other.in_si(), extend=20, progress=False)


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
