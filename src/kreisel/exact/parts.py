"""A period in parts, each with polynomials in the time: orbits of the exact flows, n = 3.

Phases that grow like the time are integers, mod one rotation: no error grows with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from operator import mul
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.record.contract import Orbit

TERMS = 18  # of the polynomials: with 14, twice as many parts do not stay in the first cache
ORDERS = 28  # of the Taylor series that they come from
TAIL = 2e-17  # their truncation error, relative to m, b and q
BINARY = 100  # places of the values in which the series are made
SETTLED = 50  # e-foldings after which a separatrix motion is taken for the steady one that it tends to
PHASE_BITS = 64
LEAST_PLACES = 3  # as a power of two


@cache
def economised() -> tuple[Array, Array]:
    """The powers 0, ..., ORDERS - 1 on [-1, 1] as polynomials of TERMS terms, and the errors of that.

    By cutting off their Chebyshev series.
    """
    chebyshev, out, cost = np.polynomial.chebyshev, np.zeros((TERMS, ORDERS)), np.zeros(ORDERS)
    for k in range(ORDERS):
        series = chebyshev.poly2cheb(np.eye(ORDERS)[k, : k + 1])
        kept = chebyshev.cheb2poly(series[:TERMS])
        out[: len(kept), k], cost[k] = kept, abs(series[TERMS:]).sum()
    cost[1:] += abs(out[0, 1:])
    out[0, 1:] = 0  # the value in the middle stays
    cost[-1] = 1.0  # and the remainder of the Taylor series
    return out, cost


def left_out(bounds: Array, h: float) -> float:
    """The largest remainder of the polynomials if half a part lasts h."""
    return float((bounds * economised()[1]) @ h ** np.arange(ORDERS))


def convolved(f: list[int], g: list[int]) -> int:
    """The last coefficient of the product of two power series of equal length."""
    return sum(map(mul, f, reversed(g)))


def crossed(x: Sequence[Any], y: Sequence[Any], times: Callable[[Any, Any], int] = mul) -> list[int]:
    """The cross product of two vectors by that product of their entries."""
    return [times(x[i], y[j]) - times(x[j], y[i]) for i, j in ((1, 2), (2, 0), (0, 1))]


def cos_sin(half: Array) -> tuple[Array, Array]:
    """Cosine and sine of an angle in two parts: cos and sin of the first, and the second, at most pi/512."""
    cos, sin, x = half[..., 0], half[..., 1], half[..., 2]
    y = x * x
    versine, s = y * (0.5 - y * (1 / 24 - y * (1 / 720))), x * (1 - y * (1 / 6 - y * (1 / 120)))
    return cos - (cos * versine + sin * s), sin - (sin * versine - cos * s)


def from_middle(j: int, places: int) -> int:
    """The number of a part, those of the second half of a period as negative ones."""
    half = 1 << (places - 1)
    return (j + half) % (2 * half) - half


def doubles(series: Array, binary: int) -> Array:
    """Integers of `binary` places as doubles; the integers may be larger than any double."""
    return np.asarray(series / (1 << binary), dtype=np.float64)


def polynomials(series: Array, binary: int, ctx: Any, units: Array | None = None) -> Array:
    """Polynomials of a part (TERMS, values) from power series (ORDERS, values), integers of `binary` places."""
    units = np.ones(series.shape[1], dtype=object) if units is None else units
    out: Array = economised()[0] @ doubles(series, binary) * units.astype(np.float64)
    out[0] = [float(ctx.ldexp(ctx.mpf(int(v)), -binary) * unit) for v, unit in zip(series[0], units, strict=True)]
    return out


def orbit_in_parts(
    place: Callable[[int], Array],
    row: Callable[..., tuple[Array, ...]],
    constants: Mapping[str, Array],
    *,
    moving: int,
    turns: tuple[int, int],
    places: int,
    bits: int,
    settled: int | None = None,
    asleep: tuple[int, int] = (0, 0),
) -> Orbit:
    """The orbit of 2^places parts, `moving` of which, and `turns` of the other phases, are a unit of time, of `bits`.

    Without a period `settled` is the number of parts after which it is steady, and `asleep` what is then added to the
    rotates in a part.
    """
    rates = (moving >> places, *turns)

    def phases(M: Array, e: Array) -> Array:
        low = int(e.min(initial=0))
        scaled, shift = M << (e - low).astype(object), bits - low
        numbers = [scaled * rate for rate in rates]
        if settled is not None:
            most, at = settled << shift, scaled * moving
            kept = np.minimum(np.maximum(at, -most), most)
            numbers = [
                kept >> places,
                *(v + ((at - kept) * w >> bits) for v, w in zip(numbers[1:], asleep, strict=True)),
            ]
        words = [v >> (shift - 64) for v in numbers] + [numbers[0] >> (shift - 128)]
        return np.stack([(v & (2**64 - 1)).astype(np.uint64) for v in words], -1)

    return Orbit(phases, None if settled is not None else rates, bits, places, cache(place), row, constants)
