"""kr.analysis.megno: 2 for regular motions, lambda t/2 for chaotic ones."""

from __future__ import annotations

import numpy as np
import pytest

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
