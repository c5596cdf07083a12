"""The Lagrange top, n = 3, by Taylor series of its equations in many digits: an independent reference.

m' = p x b, b' = m x b, q' = omega q / 2 with omega = m + (1/alpha - 1) (m.b) b/|b|^2; nothing of a method's formulas
enters.  Needs python-flint.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError

Terms = list[list[Any]]  # of each component, the coefficients


def taylor(m: Array, b: Array, p: Array, time: Any, *, alpha: float = 1.0, digits: int = 30) -> tuple[Array, ...]:
    """(m, b, q) at `time` to about `digits` digits: axial vectors and a quaternion, q = 1 at time 0, of flint.arb.

    Doubles are taken as exact; `time` may be a number of flint.  Each step is as long as the last two terms of its
    series allow, 10^-digits; rounding is 15 digits below.  Raises `InputError` without python-flint.
    """
    try:
        import flint
    except ImportError as error:
        raise InputError("The reference in many digits needs python-flint: pip install 'kreisel[exact]'.") from error
    before = flint.ctx.prec
    flint.ctx.prec = int((digits + 15) * 3.33)
    try:
        return _march(flint.arb, m, b, p, time, Fraction(alpha), digits)
    finally:
        flint.ctx.prec = before


def _march(arb: Any, m: Array, b: Array, p: Array, time: Any, alpha: Fraction, digits: int) -> tuple[Array, ...]:
    z = [arb(float(v)) for v in (*m, *b, 1, 0, 0, 0)]
    gravity = [arb(float(v)) for v in p]
    momentum, axis = z[:3], z[3:6]
    extra = arb(alpha.denominator - alpha.numerator) / alpha.numerator
    extra *= sum(x * y for x, y in zip(momentum, axis, strict=True)) / sum(y * y for y in axis)
    order, time, done = int(1.3 * digits) + 6, arb(time).mid(), arb(0)
    while not done == time:
        terms = [[v] for v in z]
        for k in range(order):
            for term, slope in zip(terms, _slopes(terms, gravity, extra, k), strict=True):
                term.append(slope / (k + 1))
        h, left = _length(terms, order, digits), time - done
        last = bool(abs(left) <= h)
        h = left if last else (arb(h) if left > 0 else -arb(h))
        z = [_sum(term, h).mid() for term in terms]
        done = time if last else (done + h).mid()
    return tuple(np.array(part, dtype=object) for part in (z[:3], z[3:6], z[6:]))


def _slopes(terms: Terms, p: list[Any], extra: Any, k: int) -> list[Any]:
    """Coefficient k of the right-hand sides."""
    m, b, (w, *v) = terms[:3], terms[3:6], terms[6:]
    omega = [[x + extra * y for x, y in zip(mi, bi, strict=True)] for mi, bi in zip(m, b, strict=True)]

    def times(f: list[Any], g: list[Any]) -> Any:
        return sum((f[i] * g[k - i] for i in range(1, k + 1)), f[0] * g[k])

    def cross(f: Terms, g: Terms) -> list[Any]:
        return [times(f[i - 2], g[i - 1]) - times(f[i - 1], g[i - 2]) for i in range(3)]

    down = [p[i - 2] * b[i - 1][k] - p[i - 1] * b[i - 2][k] for i in range(3)]
    turned = [x + times(o, w) for x, o in zip(cross(omega, v), omega, strict=True)]
    scalar = -sum(times(o, x) for o, x in zip(omega, v, strict=True))
    return [*down, *cross(m, b), scalar / 2, *(x / 2 for x in turned)]


def _length(terms: Terms, order: int, digits: int) -> float:
    """The h with |last two terms| h^order <= 10^-digits."""
    lengths = [1.0]
    for k in (order - 1, order):
        largest = max(float(abs(term[k]).mid()) for term in terms)
        if largest > 0:
            lengths.append(float((10.0**-digits / largest) ** (1 / k)))
    return min(lengths)


def _sum(term: list[Any], h: Any) -> Any:
    out = term[-1]
    for coefficient in reversed(term[:-1]):
        out = out * h + coefficient
    return out
