"""The estimate of a run's error, against the textbook equations of a satellite in the gravity of the Earth."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.physical import FreeBody, Orbit, Satellite
from support import cross, rotation_matrix

MU, RADIUS = 3.986004418e14, 6378137.0 + 500e3  # WGS 84
MOMENTS = np.array([0.01, 0.03, 0.035])


def by_scipy(times, q, rates):
    """Attitudes on the orbit in the plane of the equator."""
    n = np.sqrt(MU / RADIUS**3)

    def slope(t, y):
        q, w = y[:4], y[4:]
        C = rotation_matrix(q)
        u = C.T @ [np.cos(n * t), np.sin(n * t), 0]
        torque = 3 * n**2 * cross(u, MOMENTS * u) - cross(w, MOMENTS * w)
        return [-q[1:] @ w / 2, *((q[0] * w + cross(q[1:], w)) / 2), *(torque / MOMENTS)]

    out = solve_ivp(slope, times[[0, -1]], [*q, *rates], method="DOP853", t_eval=times, rtol=1e-12, atol=1e-15)
    return Rotation.from_quat(out.y[:4].T, scalar_first=True)


@pytest.mark.parametrize(("order", "dt", "least"), [(None, 240.0, 1e-9), ((2, 2), 60.0, 1e-6)])
def test_the_estimate_is_the_error_within_a_factor_of_ten(order, dt, least):
    body = Satellite(MOMENTS, Orbit.circular(500e3))
    spin = np.array([2e-4, 4e-4, 9e-4])
    run = kr.simulate(body, body.state(spin=spin), dt=dt, t_end="4 h", every=f"{4 * dt} s", order=order, observe=())
    truth = by_scipy(run.time.values, run.attitude.values[0], spin)
    off = (Rotation.from_quat(run.attitude.values, scalar_first=True).inv() * truth).magnitude()
    estimate = kr.analysis.error(run).attitude.values
    far = off > least
    assert far.sum() > 5
    assert (estimate[far] / off[far]).min() > 0.1 and (estimate[far] / off[far]).max() < 10


def test_runs_with_forces_and_impulses_have_one_and_closed_forms_none():
    free = FreeBody((1, 2, 3))
    body = FreeBody((1, 2, 3), time_unit=7.0, torque=lambda Omega: -0.3 * Omega)
    start = {"dt": 0.3, "times": [0, 0.9, 1.35, 3], "impulses": {"time": 1.0, "momentum": (0, 0, 1)}}
    run = kr.simulate(body, body.state((1, 2, 3)), **start)
    found = kr.analysis.error(run, body)
    fine = kr.simulate(body, body.state((1, 2, 3)), **start | {"dt": 0.02})
    far = np.linalg.norm(run.momentum - fine.momentum, axis=-1) / np.linalg.norm(run.momentum, axis=-1).max()
    assert found.time.values == pytest.approx(run.time.values)
    assert found.momentum.values == pytest.approx(far, rel=0.3, abs=1e-15) and far[-1] > 1e-9
    with pytest.raises(kr.InputError, match="a run holds no code"):
        kr.analysis.error(run)
    for other in (kr.simulate(free, free.state((1, 2, 3)), dt=0.1, steps=3), run.isel(time=slice(1, None))):
        with pytest.raises(kr.InputError, match="error: expected a run in equal steps"):
            kr.analysis.error(other, body)
