"""Bounds on walks of rounding errors, each with a stated probability of failing on a right program.

The one assumption: what rounding adds to an integral between two saved rows, d_1 ... d_R, has a symmetric distribution,
independent from row to row; nothing is said of its size, which depends on the formula and on the processor.  Given the
sizes |d_k|, the sum S = d_1 + ... + d_R is then one of random signs, and with V^2 = d_1^2 + ... + d_R^2

    P(|S| > x V) <= 2 exp(-x^2/2)                                     (Hoeffding 1963)
    P(max_k |d_1 + ... + d_k| > x V) <= 4 exp(-x^2/2)                 (Lévy's inequality)
    E exp(s S^2/V^2) <= (1 - 2s)^(-1/2), E (S/V)^4 <= 3               (as for the square of a normal number)

A drift m a row makes S/V about m R/sqrt(R (m^2 + sigma^2)), at most sqrt(R): 100 rows can tell it, a few cannot.
How large the errors are is bounded separately, by V against the width of `kr.drift`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from kreisel.kernels.layout import MACHINE_EPSILON
from kreisel.runs.drift import all_series

SUITE = 1e-6  # the probability that any comparison of the suite fails on a right program
COMPARISONS = 20_000  # that the suite makes at most
EACH = SUITE / COMPARISONS

REACH = math.sqrt(2 * math.log(4 / EACH))  # of |S|/V, its largest over the rows too: 7.09
# Of V in widths: 285 runs of every map and method had 1.25 at most; 100 normal d_k have V > 1.6 rms once in 1e13.
SIZE = 3.0


def spread(lanes: int) -> tuple[float, float]:
    """Between which the root mean square of S/V over independent lanes lies; 1 is its expectation.

    Above by Chernoff's bound, exp(-lanes/2 (t - log(1 + t))) at a mean square of 1 + t, below by Bernstein's for
    positive numbers, exp(-lanes t^2/6) at 1 - t.
    """
    need = math.log(2 / EACH) / lanes
    below, above = 0.0, 1.0
    while (above - math.log1p(above)) / 2 < need:
        above *= 2
    for _ in range(60):
        middle = (below + above) / 2
        below, above = (middle, above) if (middle - math.log1p(middle)) / 2 < need else (below, middle)
    return math.sqrt(max(0.0, 1 - math.sqrt(6 * need))), math.sqrt(1 + above)


def normalised(moves: np.ndarray) -> np.ndarray:
    """|S|/V of moves along the first axis; 0 where nothing moves."""
    size = np.sqrt((moves**2).sum(0))
    return np.divide(abs(moves.sum(0)), size, out=np.zeros_like(size), where=size > 0)


class Walk(NamedTuple):
    """What rounding does to one integral: max |S_k|/V, V over its width, and max |S_k| per step, in eps sensitivity.

    The width is eps (sensitivity sqrt(steps) + size sqrt(2 rows)): of the steps, and of computing the integral in rows.
    """

    name: str
    turn: float
    size: float
    mean: float


def walks(run: xr.Dataset) -> Iterator[Walk]:
    """Of every integral that is conserved."""
    steps = float(run.time[-1] - run.time[0]) / run.attrs["dt"]
    for series in all_series(run):
        if not series.conserved:
            continue
        moves = np.diff(series.values)
        size = math.sqrt(float(moves @ moves))
        width = MACHINE_EPSILON * (series.step_scale * steps**0.5 + series.value_scale * (2 * len(moves)) ** 0.5)
        most = float(abs(series.values - series.values[0]).max())
        if size == 0:
            yield Walk(series.name, 0.0, 0.0, 0.0)
        else:
            mean = most / (MACHINE_EPSILON * series.step_scale * steps) if series.step_scale else math.inf
            yield Walk(series.name, most / size, size / width, mean)


def troubles(run: xr.Dataset, size: float = SIZE, mean: float = 0.0) -> list[str]:
    """What does not walk as rounding errors do: a trend of more than `mean` a step, or more than `size` widths."""
    found = list(walks(run))
    assert found
    return [
        f"{w.name}: |S|/V = {w.turn:.3g} of {REACH:.3g}, V = {w.size:.3g} widths of {size:.3g}, {w.mean:.3g} eps a step"
        for w in found
        if not ((w.turn < REACH or w.mean < mean) and w.size < size)
    ]


def assert_still(run: xr.Dataset, size: float = SIZE, mean: float = 0.0) -> None:
    """Every integral that is conserved walks as rounding errors do."""
    assert not (bad := troubles(run, size, mean)), "\n".join(bad)
