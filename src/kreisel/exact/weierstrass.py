"""Laurent's series of Weierstrass's function wp(t; g2, g3), for any kind of number.

[DLMF 23.9]
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

from kreisel import algebra
from kreisel.algebra import Array


def laurent(first: Array, second: Array, orders: int) -> list[Array]:
    """Coefficients c_2, c_3, ... of t^4, t^6, ... in t^2 wp(t) - 1, the last c_orders; c_2 = g2/20, c_3 = g3/28.

    c_k = 3/((2k+1)(k-3)) sum_m c_m c_(k-m)
    """
    c, unit = [first, second], 0 * first + 1  # a unit of the same kind, so that the factors have its digits
    for k in range(4, orders + 1):
        half, odd = divmod(k - 4, 2)
        total = 0 if odd else 0.5 * unit * (c[half] * c[half])
        for i in reversed(range(half + odd)):  # the newest last: processors need not wait
            total = total + c[i] * c[k - 4 - i]
        c.append(6 * unit / ((2 * k + 1) * (k - 3)) * total)
    return c


@cache
def coefficients(orders: int) -> list[list[float]]:
    """K[a][b] in x^2 wp(x) = sum K[a][b] A^a B^b, A = g2 x^4/4, B = g3 x^6/4, up to x^(2 orders)."""
    c: dict[int, dict[tuple[int, int], Fraction]] = {2: {(1, 0): Fraction(1, 5)}, 3: {(0, 1): Fraction(1, 7)}}
    for k in range(4, orders + 1):
        c[k] = {}
        for m in range(2, k - 1):
            for (a, b), x in c[m].items():
                for (i, j), y in c[k - m].items():
                    old = c[k].get((a + i, b + j), Fraction(0))
                    c[k][a + i, b + j] = old + Fraction(3, (2 * k + 1) * (k - 3)) * x * y
    table = {(0, 0): Fraction(1)} | {place: x for terms in c.values() for place, x in terms.items()}
    rows = [[table[place] for place in sorted(table) if place[0] == a] for a in range(orders // 2 + 1)]
    return [[float(x) for x in row] for row in rows]


def series(A: Array, B: Array, orders: int) -> Array:
    """The polynomial of `coefficients`."""
    return algebra.polynomial([algebra.polynomial(row, B) for row in coefficients(orders)], A)
