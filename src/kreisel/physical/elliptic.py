"""Elliptic integrals and the amplitude from the complementary modulus k', which keeps its digits beside k = 1.

K and Pi by Carlson's R_F and R_J, for characteristics nu <= 0.  [Carlson, Numerical Algorithms 10 (1995)]
"""

from __future__ import annotations

import math

import numpy as np

from kreisel.algebra import Array

NEAR, LEAST = 1e-8, 1e-150  # k' so small that K = log(4/k'), and the least whose square is a double
STEEP = 1e-4  # k' below which Landen's transformations are ascending: the descending ones lose digits, 1e-13 at 1e-8


def complete(kc: float) -> float:
    """The complete integral K from k'; log(4/k') where the next term is below rounding."""
    from scipy.special import ellipkm1

    if kc == 0:
        return math.inf
    return math.log(4 / kc) if kc < NEAR else float(ellipkm1(kc * kc))


def third_below_first(nu: float, kc: float) -> float:
    """The difference 1 - Pi(nu | k^2)/K, without cancellation: -nu R_J(0, k'^2, 1, 1 - nu)/(3 K)."""
    from scipy.special import elliprj

    return float(-nu * elliprj(0.0, kc * kc, 1.0, 1 - nu) / (3 * complete(kc)))


def third_over_first(nu: float, kc: float) -> float:
    """Pi(nu | k^2)/K as a sum of positive numbers, by the characteristic N = (k^2 - nu)/(1 - nu) > 0."""
    from scipy.special import elliprj

    if nu == 0:
        return 1.0
    kc2 = kc * kc
    k2, N = 1 - kc2, (1 - kc2 - nu) / (1 - nu)
    raised = 1 + N * float(elliprj(0.0, kc2, 1.0, kc2 / (1 - nu))) / (3 * complete(kc))
    return (-nu * kc2 / (1 - nu) * raised + k2) / (k2 - nu)


def _split(phi: Array) -> tuple[Array, Array]:
    """(n, phi - n pi), the latter in [-pi/2, pi/2]."""
    whole = np.round(phi / math.pi)
    return whole, phi - whole * math.pi


def first(phi: Array, kc: float) -> Array:
    """F(phi | k) for |phi| <= pi/2."""
    from scipy.special import elliprf

    cos, sin = np.cos(phi), np.sin(phi)
    return np.asarray(sin * elliprf(cos * cos, cos * cos + (kc * sin) ** 2, 1.0))


def third(phi: Array, nu: float, kc: float) -> Array:
    """Pi(nu; phi | k), continuous in phi."""
    from scipy.special import elliprf, elliprj

    whole, part = _split(phi)
    cos2, sin, kc2 = np.cos(part) ** 2, np.sin(part), kc * kc
    delta = cos2 + kc2 * sin * sin
    rest = sin * elliprf(cos2, delta, 1.0) + nu / 3 * sin**3 * elliprj(cos2, delta, 1.0, 1 - nu * sin * sin)
    if not whole.any():
        return np.asarray(rest)
    k = max(kc, LEAST)
    turn = complete(k) + nu / 3 * elliprj(0.0, k * k, 1.0, 1 - nu) + math.log(k / kc) / (1 - nu)
    return np.asarray(rest + 2 * whole * turn)


def stretched(phi: Array, c: float) -> Array:
    """The angle atan(c tan phi), continuous in phi."""
    whole, part = _split(phi)
    return np.asarray(np.arctan2(c * np.sin(part), np.cos(part)) + whole * math.pi)


def amplitude(u: Array, kc: float, quarter: float) -> Array:
    """The amplitude am u, from that of arguments in [0, K/2]: am(K - v) = pi/2 - atan(k' sn v/cn v)."""
    whole = np.round(u / (2 * quarter)) if kc else 0 * u
    rest = u - 2 * quarter * whole if kc else u
    beyond = abs(rest) > quarter / 2
    v = np.where(beyond, abs(quarter - abs(rest)), abs(rest)) if kc else abs(rest)
    phi = _descending(v, kc) if kc > STEEP else _ascending(v, kc) if kc > NEAR else _beside_one(v, kc)
    phi = np.where(beyond, math.pi / 2 - np.arctan2(kc * np.sin(phi), np.cos(phi)), phi)
    return np.asarray(np.copysign(phi, rest) + math.pi * whole)


def _descending(u: Array, kc: float) -> Array:
    """The amplitude by descending Landen transformations: Abramowitz and Stegun, section 16.4."""
    a, b, ratios = 1.0, kc, [1.0]
    while ratios[-1] > 1e-8:  # what the last one leaves out is of the order of its square
        a, b, c = (a + b) / 2, math.sqrt(a * b), (a - b) / 2
        ratios.append(c / a)
    phi = 2.0 ** (len(ratios) - 1) * a * u
    for ratio in ratios[:0:-1]:
        phi = (phi + np.arcsin(np.clip(ratio * np.sin(phi), -1, 1))) / 2
    return np.asarray(phi)


def _ascending(u: Array, kc: float) -> Array:
    """The amplitude by an ascending Landen transformation, to k' as small as its square: section 16.14 there."""
    less = (kc / (1 + math.sqrt(1 - kc * kc))) ** 2
    phi = _beside_one(u / (1 + less), less)
    dn = np.hypot(np.cos(phi), less * np.sin(phi))
    mu = (1 - less) * (1 + less)
    sn, cn = (1 + less) * np.sin(phi) * np.cos(phi) / dn, (1 + less) / mu * (dn * dn - less) / dn
    return np.asarray(np.arctan2(sn, cn))


def _beside_one(u: Array, kc: float) -> Array:
    """The amplitude for k' < 1e-8, without terms of k'^4: Abramowitz and Stegun, section 16.15."""
    v = np.minimum(u, 700.0)
    return np.asarray(np.arctan(np.sinh(v)) + kc * kc / 4 * (np.sinh(v) - v / np.cosh(v)))
