"""Rounding errors of a step have no mean, at steps that are short decimals too: seen over many trajectories at once.

Nor has a trajectory a trend of its own, which constants rounded once for all can give it.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.lab import exact
from kreisel.systems import REGISTRY
from walks import REACH, normalised, spread

LANES, STEPS = 512, 20_000
TOPS = {
    "lagrange-top": (lambda: kr.LagrangeTop(p=(0, 0, 1)), ("m", "a")),
    "lagrange-top-moving": (lambda: kr.LagrangeTopMoving(A=(0, 0, 1), alpha=1.0), ("M", "P")),
    "symmetric-top": (lambda: kr.SymmetricTop(A=(0, 0, 1)), ("M", "P")),
}


def mean_change(name: str, dt: float) -> float:
    """The sum of the changes of the energy over the lanes, which are independent, over the root of that of squares."""
    make, letters = TOPS[name]
    draw, model = np.random.default_rng(4), make()
    momenta = 0.01 * draw.standard_normal((LANES, 3)) + np.array([0.3, 0.1, 1.9])
    vectors = 0.01 * draw.standard_normal((LANES, 3)) + np.array([-0.5, 0.8, -0.3])
    start: dict[str, Any] = dict(zip(letters, (momenta, vectors), strict=True))
    run = kr.simulate(model, model.state(**start), dt=dt, steps=STEPS, every=STEPS, method="suris", progress=False)
    return float(normalised(np.ravel(run.energy_eps.isel(time=-1) - run.energy_eps.isel(time=0))))


@pytest.mark.parametrize("dt", [0.1, 0.2])
@pytest.mark.parametrize("name", TOPS)
def test_the_energy_has_no_trend_at_decimal_steps(name: str, dt: float) -> None:
    assert 0 < mean_change(name, dt) < REACH


@pytest.mark.parametrize("name", TOPS)
def test_a_plain_product_lets_the_energy_drift(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(algebra, "GENERIC", 1.0)
    assert mean_change(name, 0.2) > REACH


ROWS = 16
MAPS = {
    "neumann-veselov": ({"b": (0.3, 0.7, 1.9)}, "veselov", 1024, 20_000),
    "euler-top": ({"J": (0.5, 0.75, 1.2)}, "veselov", 512, 200_000),
    "lagrange-top": ({"p": (0.6, 0, 0.8)}, "baecklund", 1024, 400_000),
}


def trends(name: str) -> tuple[float, list[float]]:
    """Of the integrals but Casimirs: the largest sum of the changes over the lanes, in roots of that of their squares,
    and for each the root mean square over the lanes of S/V, the walk in the size of its increments."""
    params, method, lanes, steps = MAPS[name]
    model = REGISTRY[name](**params)
    draws = (exact.float_random(np.random.default_rng([seed, 3])) for seed in range(lanes))
    states = zip(*(exact.random_state(model.system.space, 3, draw) for draw in draws), strict=True)
    start = {letter: np.stack(v) for letter, v in zip(model.system.space.letters, states, strict=True)}
    options: dict[str, Any] = {"dt": 0.2, "steps": steps, "every": steps // ROWS, "method": method}
    run = kr.simulate(model, model.state(**start), progress=False, **options)
    mean, rms = 0.0, []
    for label in ("energy", *model.system.integrals):
        series = np.asarray(run[label].transpose("time", "lane", ...)).reshape(ROWS + 1, lanes, -1)
        moves = np.diff(series, axis=0)
        walk = np.sqrt((moves**2).sum(0)) > 1e-3 * np.finfo(float).eps * steps**0.5 * abs(series).max(0)
        for part in np.flatnonzero(walk.all(0)):
            mean = max(mean, float(normalised(moves[..., part].sum(0))))
            rms.append(float((normalised(moves[..., part]) ** 2).mean() ** 0.5))
    return mean, rms


@pytest.mark.parametrize("name", MAPS)
def test_no_integral_has_a_trend(name: str) -> None:
    mean, rms = trends(name)
    least, most = spread(MAPS[name][2])
    assert 0 < mean < REACH
    assert least < max(rms) < most


@pytest.mark.parametrize("name", MAPS)
def test_constants_rounded_once_for_all_give_a_trend(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the second double of a constant, or with a plain product."""
    if name == "neumann-veselov":
        system = import_module("kreisel.systems.neumann_veselov")
        factors = system.factors
        monkeypatch.setattr(system, "factors", lambda **known: (*factors(**known)[:2], 0 * known["b"]))
    elif name == "euler-top":
        monkeypatch.setattr(import_module("kreisel.systems.euler_top"), "product_error", lambda x, y, p: 0 * p)
    else:
        monkeypatch.setattr(algebra, "GENERIC", 1.0)
    mean, rms = trends(name)
    assert mean > REACH or max(rms) > spread(MAPS[name][2])[1]
