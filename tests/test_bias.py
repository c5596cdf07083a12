"""Rounding errors of a step have no mean, at steps that are short decimals too: seen over many trajectories at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra

LANES, STEPS = 512, 20_000
TOPS = {
    "lagrange-top": (lambda: kr.LagrangeTop(p=(0, 0, 1)), ("m", "a")),
    "lagrange-top-moving": (lambda: kr.LagrangeTopMoving(A=(0, 0, 1), alpha=1.0), ("M", "P")),
    "symmetric-top": (lambda: kr.SymmetricTop(A=(0, 0, 1)), ("M", "P")),
}


def mean_change(name: str, dt: float) -> float:
    """The mean change of the energy over the lanes, in standard errors."""
    make, letters = TOPS[name]
    draw, model = np.random.default_rng(4), make()
    momenta = 0.01 * draw.standard_normal((LANES, 3)) + np.array([0.3, 0.1, 1.9])
    vectors = 0.01 * draw.standard_normal((LANES, 3)) + np.array([-0.5, 0.8, -0.3])
    start: dict[str, Any] = dict(zip(letters, (momenta, vectors), strict=True))
    run = kr.simulate(model, model.state(**start), dt=dt, steps=STEPS, every=STEPS, method="suris", progress=False)
    change = np.ravel(run.energy_eps.isel(time=-1) - run.energy_eps.isel(time=0))
    return float(change.mean() / change.std() * LANES**0.5)


@pytest.mark.parametrize("dt", [0.1, 0.2])
@pytest.mark.parametrize("name", TOPS)
def test_the_energy_has_no_trend_at_decimal_steps(name: str, dt: float) -> None:
    assert abs(mean_change(name, dt)) < 4.5


@pytest.mark.parametrize("name", TOPS)
def test_a_plain_product_lets_the_energy_drift(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(algebra, "GENERIC", 1.0)
    assert abs(mean_change(name, 0.2)) > 8
