"""Kepler's equation for any eccentricity below 1, without a branch, for any kind of number."""

from __future__ import annotations

from math import pi
from typing import Any

from kreisel.algebra import sqrt
from kreisel.algebra.gradient import cos, exp, log, sin, with_slope

TINY = 1e-300  # so that |0| has a derivative
HALVINGS = 3
ARCSINE = [1.0]  # the series of arcsin s in powers of s^2, for s up to sin(pi/16)
for k in range(1, 11):
    ARCSINE.append(ARCSINE[-1] * (2 * k - 1) ** 2 / (2 * k * (2 * k + 1)))


def size(x: Any) -> Any:
    """|x|, with the derivative 0 at 0."""
    return sqrt(x * x + TINY)


def less_whole_turns(angle: Any) -> Any:
    """The angle between -pi and pi that differs by whole turns."""
    return with_slope(_from_its_half, angle, 1.0)


def _from_its_half(angle: Any) -> Any:
    """By the sine and cosine of its half, which is halved further."""
    s, c = sin(angle / 2), cos(angle / 2)
    s, c = s * (c / size(c)), size(c)
    for _ in range(HALVINGS):
        above = sqrt((1 + c) / 2)
        s, c = s / (2 * above), above
    total, square = ARCSINE[-1], s * s
    for coefficient in reversed(ARCSINE[:-1]):
        total = coefficient + square * total
    return 2 ** (HALVINGS + 1) * s * total


def eccentric_anomaly(mean: Any, e: Any) -> Any:
    """E with E - e sin E = mean, less whole turns: to 4e-16 in position up to e = 0.9, 1e-14 at 0.9999.

    [F. L. Markley, Celest. Mech. Dyn. Astron. 63 (1995) 101: a cubic equation, then one correction of order 5]
    """
    M = less_whole_turns(mean)
    alpha = (3 * pi * pi + 1.6 * pi * (pi - size(M)) / (1 + e)) / (pi * pi - 6)
    d = 3 * (1 - e) + alpha * e
    q = 2 * alpha * d * (1 - e) - M * M
    r = 3 * alpha * d * (d - 1 + e) * M + M * M * M
    w = exp(log(size(r) + sqrt(q * q * q + r * r)) * (2 / 3))
    E = (2 * r * w / (w * w + w * q + q * q) + M) / d
    s, c = e * sin(E), e * cos(E)
    miss, slope = E - s - M, 1 - c
    by = -miss / (slope - 0.5 * miss * s / slope)
    by = -miss / (slope + 0.5 * by * s + by * by * c / 6)
    return E - miss / (slope + 0.5 * by * s + by * by * c / 6 - by * by * by * s / 24)
