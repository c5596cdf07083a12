"""Laurent's series of Weierstrass's function wp(t; g2, g3), for any kind of number.

[DLMF 23.9]
"""

from __future__ import annotations

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
