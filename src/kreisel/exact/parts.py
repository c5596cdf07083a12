"""A period in parts, each with polynomials in the time: what the exact flows, n = 3, have in common."""

from __future__ import annotations

from functools import cache
from operator import mul

import numpy as np

from kreisel.algebra import Array

TERMS = 18  # of the polynomials: with 14, twice as many parts do not stay in the first cache
ORDERS = 28  # of the Taylor series that they come from
TAIL = 2e-17  # what they leave out, relative to m, b and q
BINARY = 100  # places of the numbers in which the series are made
SETTLED = 50  # e-foldings after which a separatrix motion is taken for the steady one that it tends to
PHASE_BITS = 64
LEAST_PLACES = 3  # as a power of two


@cache
def economised() -> tuple[Array, Array]:
    """The powers 0, ..., ORDERS - 1 on [-1, 1] as polynomials of TERMS terms, and what that costs.

    By cutting off their Chebyshev series.
    """
    chebyshev, out, cost = np.polynomial.chebyshev, np.zeros((TERMS, ORDERS)), np.zeros(ORDERS)
    for k in range(ORDERS):
        series = chebyshev.poly2cheb(np.eye(ORDERS)[k, : k + 1])
        kept = chebyshev.cheb2poly(series[:TERMS])
        out[: len(kept), k], cost[k] = kept, abs(series[TERMS:]).sum()
    cost[1:] += abs(out[0, 1:])
    out[0, 1:] = 0  # what is known in the middle stays
    cost[-1] = 1.0  # and what the Taylor series leaves out
    return out, cost


def left_out(bounds: Array, h: float) -> float:
    """What the polynomials leave out at most where half a part lasts h."""
    return float((bounds * economised()[1]) @ h ** np.arange(ORDERS))


def convolved(f: list[int], g: list[int]) -> int:
    """The last coefficient of the product of two power series of equal length."""
    return sum(map(mul, f, reversed(g)))


def cos_sin(half: Array) -> tuple[Array, Array]:
    """Of an angle in parts, the rest of it at most pi/512; as small changes of the first part, so rounded once."""
    cos, sin, x = half[..., 0], half[..., 1], half[..., 2]
    y = x * x
    less, s = y * (0.5 - y * (1 / 24 - y * (1 / 720))), x * (1 - y * (1 / 6 - y * (1 / 120)))
    return cos - (cos * less + sin * s), sin - (sin * less - cos * s)


def turns_of(scaled: list[Array], bits: int) -> Array:
    """Integers of `bits` binary places, mod 1, as 64-bit fractions (times, count)."""
    return np.stack([((v >> (bits - 64)) & (2**64 - 1)).astype(np.uint64) for v in scaled], -1)
