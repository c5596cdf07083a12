"""kr.analysis.megno: 2 for regular motions, lambda t/2 for chaotic ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.record.model import Model

TOP = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5)
UNLIKE = kr.perturbed(TOP, inertia=(1, 1.4, 0.5), potential=lambda P: 0.8 * P[0])
START = {"M": (0.3, 0.2, 1.1), "P": (0.6, 0, 0.8)}


@pytest.mark.parametrize("orientation", [None, (1, 0, 0, 0)])
def test_regular(orientation: tuple[float, ...] | None) -> None:
    found = kr.analysis.megno(TOP, START, dt=0.1, steps=5_000, orientation=orientation)
    assert found["mean"].dims == ("time",)
    assert abs(float(found["mean"][-1]) - 2) < 0.1


def test_chaotic() -> None:
    """Y is 116 after a time of 500, lambda 0.21: an orbit of another rounding has some tens of percent less or more."""
    found = kr.analysis.megno(UNLIKE, START, dt=0.1, steps=5_000)
    end, rate = float(found.time[-1]), float(found.lyapunov[-1])
    assert rate > 10 * np.log(end) / end
    assert 20 < float(found.megno[-1]) < 500


def test_lanes_and_forces_of_time() -> None:
    """Lanes as single motions, with parameters of their own, an orientation and forces that take it and the time."""

    def body(k: float | list[float]) -> Model:
        push = {"potential": lambda g, t, *, k: k * g[2, 2] ** 2 * np.cos(t), "params": {"k": k}}
        return kr.perturbed(kr.EulerTop(J=(1.0, 0.6, 0.3)), **push)

    asked = {"dt": 0.1, "steps": 300, "orientation": (1, 0, 0, 0)}
    together = kr.analysis.megno(body([0.1, 0.3]), {"M": (0.2, 0.1, 1.0)}, **asked)
    alone = kr.analysis.megno(body(0.1), {"M": (0.2, 0.1, 1.0)}, **asked)
    assert together.megno.dims == ("time", "lane")
    assert abs(together.megno.values[:50, 0] - alone.megno.values[:50]).max() < 1e-3


BAD = {
    "particle": (
        lambda: kr.analysis.megno(kr.Neumann(b=(1, 2, 3)), {"x": (1, 0, 0), "q": (0, 1, 0)}, dt=1, steps=1),
        "momentum",
    ),
    "steps": (lambda: kr.analysis.megno(TOP, START, dt=0.1, steps=0), "steps"),
    "state": (lambda: kr.analysis.megno(TOP, (1, 2, 3), dt=0.1, steps=1), "initial state"),
    "dimension": (
        lambda: kr.analysis.megno(kr.EulerTop(J=(1, 2, 3, 4)), {"M": np.zeros((4, 4))}, dt=0.1, steps=1),
        "n = 3",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str) -> None:
    call, words = BAD[name]
    with pytest.raises(kr.InputError, match=words):
        call()


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, 0.0, -1.0)])
def test_body_at_rest(up: tuple[float, ...]) -> None:
    """From equations of Euler and Poisson and their variational equations, by DOP853: upright, falling, hanging."""
    moments, arm, end = np.array([1.0, 1.5, 2.0]), np.array([0.0, 0.0, 1.0]), 20.0
    top = kr.HeavyTop(J=np.diag(moments.sum() / 2 - moments), A=arm)
    found = kr.analysis.megno(top, top.state(M=(0, 0, 0), P=up), dt=0.01, steps=2_000)
    column = np.random.default_rng(0).normal(size=3)  # the direction of the neighbour

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        (M, P, m, p), out = z.reshape(4, 3), np.empty((4, 3))
        out[0], out[1] = np.cross(M, M / moments) + np.cross(P, arm), np.cross(P, M / moments)
        out[2] = np.cross(m, M / moments) + np.cross(M, m / moments) + np.cross(p, arm)
        out[3] = np.cross(p, M / moments) + np.cross(P, m / moments)
        return out.ravel()

    begin = [0, 0, 0, *up, *column, 0, 0, 0]
    last = solve_ivp(rates, (0, end), begin, method="DOP853", rtol=1e-11, atol=1e-12).y[6:, -1]
    expected = np.log(np.linalg.norm(last) / np.linalg.norm(column)) / end
    # lengths of m are counted in units other than those of p: ln 10 between them
    assert abs(float(found.lyapunov[-1]) - expected) < np.log(10) / end
    assert np.isfinite(found.megno.values).all()
