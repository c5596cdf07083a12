"""A step of two point masses: against mpmath and SciPy, on every conic section, forwards and backwards."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from kreisel.exact import kepler


def places(e: float, count: int) -> Any:
    """Random places on conic sections of this eccentricity, in random directions: (r, v, mu), pericentre 1."""
    draw = np.random.default_rng(int(1000 * e))
    mu, p = draw.uniform(0.5, 2, count), 1 + e
    most = np.pi if e < 1 else 0.9 * np.arccos(-1 / e)
    nu, zero = draw.uniform(-most, most, count), np.zeros(count)
    axes = np.linalg.qr(draw.normal(size=(count, 3, 3)))[0]
    r = (p / (1 + e * np.cos(nu)))[:, None] * np.stack([np.cos(nu), np.sin(nu), zero], -1)
    v = np.sqrt(mu / p)[:, None] * np.stack([-np.sin(nu), e + np.cos(nu), zero], -1)
    return *((axes @ x[..., None])[..., 0] for x in (r, v)), mu, draw


def by_anomalies(r: Any, v: Any, mu: float, h: float) -> list[float]:
    """Position and velocity by Kepler's equation of an ellipse or a hyperbola, bisected in 40 digits."""
    with mpmath.workdps(40):
        r, v, mu, h = [mpmath.mpf(x) for x in r], [mpmath.mpf(x) for x in v], mpmath.mpf(mu), mpmath.mpf(h)
        distance, radial = mpmath.sqrt(mpmath.fdot(r, r)), mpmath.fdot(r, v)
        a = 1 / (2 / distance - mpmath.fdot(v, v) / mu)
        s, c, size = (mpmath.sin, mpmath.cos, a) if a > 0 else (mpmath.sinh, mpmath.cosh, -a)
        sign, n = mpmath.sign(a), mpmath.sqrt(mu / size**3)
        along, across = 1 - distance / a, radial / mpmath.sqrt(mu * size)  # e cos E, e sin E, or cosh and sinh
        e = mpmath.sqrt(along**2 + sign * across**2)
        first = mpmath.atan2(across, along) if a > 0 else mpmath.asinh(across / e)
        mean = sign * (first - across) + n * h
        low, high = mpmath.mpf(-50), mpmath.mpf(50)
        for _ in range(170):
            E = (low + high) / 2
            low, high = (E, high) if sign * (E - e * s(E)) < mean else (low, E)
        turn = E - first
        f, g = 1 - size / distance * abs(1 - c(turn)), h - sign * (turn - s(turn)) / n
        new = size * abs(1 - e * c(E))
        fast, slow = -mpmath.sqrt(mu * size) / (new * distance) * s(turn), 1 - size / new * abs(1 - c(turn))
        out = (
            [f * x + g * y for x, y in zip(r, v, strict=True)],
            [fast * x + slow * y for x, y in zip(r, v, strict=True)],
        )
        return [[float(x) for x in part] for part in out]


@pytest.mark.parametrize("e", [0.0, 0.01, 0.5, 0.9, 0.99, 1.00001, 1.5, 5.0])
def test_the_step_is_that_of_the_anomalies(e: float) -> None:
    """To some rounding errors, times the turns that the motion makes in the step and 1/(1 - e)."""
    r, v, mu, draw = places(e, 12)
    h = draw.uniform(-1, 1, 12) * 10.0 ** draw.uniform(-2, 1.5, 12)
    found = kepler.step(r, v, mu=mu, h=h)
    grown = 1 + abs(h) / (abs(1 - e) if e < 1 else 1)
    for i in range(12):
        for x, true in zip(found, by_anomalies(r[i], v[i], mu[i], h[i]), strict=True):
            assert np.linalg.norm(x[i] - true) < 3e-15 * grown[i] * np.linalg.norm(true), (i, h[i])


def test_the_parabola_is_that_of_scipy() -> None:
    r, v, mu, _ = places(1.0, 4)
    found = kepler.step(r, v, mu=mu, h=np.full(4, 7.0))
    for i in range(4):
        path = solve_ivp(
            lambda t, x, mu=mu[i]: [*x[3:], *(-mu * x[:3] / np.linalg.norm(x[:3]) ** 3)],
            (0, 7.0), [*r[i], *v[i]], "DOP853", rtol=1e-13, atol=1e-13,
        )  # fmt: skip
        assert abs(np.array([*found[0][i], *found[1][i]]) - path.y[:, -1]).max() < 1e-10


def test_it_never_fails_to_settle() -> None:
    """Steps of any length from any place, up to e = 0.9999 and 30: energy and angular momentum stay."""
    for e in (0.0, 0.3, 0.9, 0.99, 0.9999, 1.0001, 1.1, 3.0, 30.0):
        r, v, mu, draw = places(e, 4000)
        h = draw.uniform(-1, 1, 4000) * 10.0 ** draw.uniform(-6, 2.3, 4000)
        R, V = kepler.step(r, v, mu=mu, h=h)
        turned = np.linalg.norm(np.cross(R, V) - np.cross(r, v), axis=-1) / np.linalg.norm(np.cross(r, v), axis=-1)
        energy = [(b * b).sum(-1) / 2 - mu / np.linalg.norm(a, axis=-1) for a, b in ((r, v), (R, V))]
        scale = (v * v).sum(-1) + (V * V).sum(-1)
        assert turned.max() < 1e-9
        assert (abs(energy[1] - energy[0]) / scale).max() < 1e-11, e
        back = kepler.step(R, V, mu=mu, h=-h)[0]
        short = abs(h) < 1
        assert (np.linalg.norm(back - r, axis=-1)[short] < 1e-9).all()
