"""Zhukovsky-Volterra's gyrostat: its spectral curve, the body without a wheel, the body of revolution, equilibria."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from support import cross

J, H = np.array((0.7, 1.1, 1.6)), np.array((0.3, -0.5, 0.8))
MOMENTS = J.sum() - J
M0 = np.array((0.9, -0.4, 1.3))
STRICT = 1e-7  # dop853 is off by 3e-9 here


def test_the_spectral_curve_has_both_integrals() -> None:
    """-tr L^2/2 = det S (lambda |M|^2 - 2 H + sum h_i^2/I_i + sum (h_i/I_i)^2/S_i), S = lambda - 1/I."""
    model = kr.ZhukovskyVolterra(J=J, h=H)
    state = model.state(M=M0)
    energy = float(model.call(model.system.energy, state.M))
    for lam in (-0.7, 0.21, 1.9, 3.0):
        L = model.call(model.system.lax, state.M, lam=lam)[0]
        S = lam - 1 / MOMENTS
        wanted = lam * M0 @ M0 - 2 * energy + (H * H / MOMENTS).sum() + (H * H / MOMENTS**2 / S).sum()
        assert -np.trace(L @ L) / 2 == pytest.approx(S.prod() * wanted, rel=1e-13)


def test_without_a_wheel_it_is_the_euler_top() -> None:
    gyrostat = kr.simulate(kr.ZhukovskyVolterra(J=J, h=(0, 0, 0)), {"M": M0}, dt=0.1, steps=60)
    top = kr.simulate(kr.EulerTop(J=J), {"M": M0}, dt=0.1, steps=60, method="exact")
    assert abs(gyrostat.M - top.M).max() < STRICT
    assert abs(gyrostat.energy - top.energy).max() < STRICT


def test_a_body_of_revolution_with_its_wheel_along_the_axis() -> None:
    """(M_1, M_2) turns by ((1/I_1 - 1/I_3) M_3 + h_3/I_3) t."""
    model = kr.ZhukovskyVolterra(J=(1.0, 1.0, 0.4), h=(0, 0, 0.6))
    run = kr.simulate(model, {"M": M0}, dt=0.1, steps=60)
    rate = (1 / 1.4 - 1 / 2.0) * M0[2] + 0.6 / 2.0
    wanted = (M0[0] + 1j * M0[1]) * np.exp(1j * rate * run.time.values)
    found = run.M.values[:, 0] + 1j * run.M.values[:, 1]
    assert abs(found - wanted).max() < STRICT
    assert abs(run.M[:, 2] - M0[2]).max() < STRICT


def test_permanent_rotations() -> None:
    """M parallel to Omega: M = h/(1 - nu I) with any nu stands still, M = h among them."""
    for nu in (-0.8, 0.0, 0.1):
        M = H / (1 - nu * MOMENTS)
        (rate,) = kr.ZhukovskyVolterra(J=J, h=H).flow(kr.algebra.hat(M))
        assert abs(rate).max() < 1e-14 * (1 + M @ M)


def test_back_in_time_momentum_and_wheel_are_reversed() -> None:
    """Euler's equations with a wheel, backwards, by SciPy.  The momentum alone is the mutant."""
    back = solve_ivp(lambda t, M: cross(M, (M - H) / MOMENTS), (0, -2.0), M0, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    for sign, equal in ((-1, True), (1, False)):
        model = kr.ZhukovskyVolterra(J=J, h=sign * H)
        assert np.allclose(-kr.at(model, {"M": -M0}, 2.0).M.values, back, atol=1e-10) is equal


def test_the_momentum_stands_in_space() -> None:
    run = kr.simulate(kr.ZhukovskyVolterra(J=J, h=H), {"M": M0}, dt=0.1, steps=60, orientation=(1, 0, 0, 0))
    assert abs(turned(run.g.values, run.M.values) - M0).max() < STRICT
    assert np.ptp(run.M.values, axis=0).max() > 0.5


def turned(g: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The vectors v (..., 3) turned by the quaternions (w, x, y, z) or rotation matrices g."""
    if g.shape[-2:] == (3, 3):
        return (g @ v[..., None])[..., 0]
    w, q = g[..., :1], g[..., 1:]
    t = 2 * np.cross(q, v)
    return v + w * t + np.cross(q, t)
