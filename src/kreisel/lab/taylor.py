"""Taylor series and quadrature of the equations of motion, in many digits: independent references.

`taylor_solution` is for the Lagrange top and Clebsch's case of any n, `free_body` for the Euler top, n = 3; the others
for the Lagrange top, n = 3, with orientation: m' = p x b, b' = m x b, q' = omega q / 2 with
omega = m + (1/alpha - 1) (m.b) b/|b|^2; nothing of a method's formulas enters.  Needs python-flint.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError

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
        return _taylor_steps(flint.arb, m, b, p, time, Fraction(alpha), digits)
    finally:
        flint.ctx.prec = before


def taylor_solution(
    X: Array, v: Array, fixed: Array, time: float, *, clebsch: bool = False, digits: int = 24
) -> tuple[Array, Array]:
    """(X, v) at `time` >= 0, of flint.arb: X' = v ^ p, v' = X v, or X' = v ^ Bv, v' = -X v with `clebsch`.

    `fixed` is p, or b with B = diag(b).  Each step is as long as the last two terms of its series allow, 10^-digits;
    rounding is 14 digits below.  Raises `InputError` without python-flint.
    """
    try:
        import flint
    except ImportError as error:
        raise InputError("The reference in many digits needs python-flint: pip install 'kreisel[exact]'.") from error
    before, flint.ctx.prec = flint.ctx.prec, int((digits + 14) * 3.33)
    try:
        return _march_matrices(flint, X, v, fixed, time, clebsch, digits)
    finally:
        flint.ctx.prec = before


def free_body(mu: Array, moments: Array, time: float, *, digits: int = 24) -> Array:
    """The axial vector mu (3,) at `time` >= 0, of flint.arb: mu' = mu x mu/I, doubles taken as exact.

    Steps and rounding as in `taylor_solution`.  Raises `InputError` without python-flint.
    """
    try:
        import flint
    except ImportError as error:
        raise InputError("The reference in many digits needs python-flint: pip install 'kreisel[exact]'.") from error
    before, flint.ctx.prec = flint.ctx.prec, int((digits + 14) * 3.33)
    try:
        arb, order = flint.arb, int(1.3 * digits) + 7
        z, (a, b, c) = [arb(float(v)) for v in mu], [1 / arb(float(v)) for v in moments]
        rates, done, end = (c - b, a - c, b - a), arb(0), arb(time)
        while not done == end:
            terms = [[v] for v in z]
            for k in range(order):
                new = [rate * _cauchy(terms[i - 2], terms[i - 1], k) / (k + 1) for i, rate in enumerate(rates)]
                for term, value in zip(terms, new, strict=True):
                    term.append(value)
            h, left = arb(_length(terms, order, digits)), end - done
            final = bool(left <= h)
            z = [_sum(term, left if final else h).mid() for term in terms]
            done = end if final else (done + h).mid()
        return np.array(z, dtype=object)
    finally:
        flint.ctx.prec = before


def _march_matrices(
    flint: Any, X: Array, v: Array, fixed: Array, time: float, clebsch: bool, digits: int
) -> tuple[Array, Array]:
    n, mat, arb, order = len(v), flint.arb_mat, flint.arb, int(1.3 * digits) + 7
    X, v = mat(n, n, [float(x) for x in X.flat]), mat(n, 1, [float(x) for x in v])
    B, p = mat(n, n, [float(x) for x in np.diag(fixed).flat]), mat(n, 1, [float(x) for x in fixed])
    done, end, sign = arb(0), arb(time), -1 if clebsch else 1
    while not done == end:
        Xs, vs, ws = [X], [v], [B * v]
        for k in range(order):
            outer = _cauchy(vs, [w.transpose() for w in ws], k) if clebsch else vs[k] * p.transpose()
            move = _cauchy(Xs, vs, k)
            Xs.append((outer - outer.transpose()) * (arb(1) / (k + 1)))
            vs.append(move * (arb(sign) / (k + 1)))
            ws.append(B * vs[-1])
        last = max(float(abs(x).mid()) for terms in (Xs, vs) for term in terms[-2:] for x in term.entries())
        h = arb(min(1.0, (10.0**-digits / last) ** (1 / order)) if last > 0 else 1.0)
        final = bool(end - done <= h)
        h = end - done if final else h
        X, v = (mat(t.nrows(), t.ncols(), [x.mid() for x in t.entries()]) for t in (_sum(Xs, h), _sum(vs, h)))
        done = end if final else (done + h).mid()
    return np.array(X.entries(), dtype=object).reshape(n, n), np.array(v.entries(), dtype=object)


def _cauchy(f: list[Any], g: list[Any], k: int) -> Any:
    return sum((f[i] * g[k - i] for i in range(1, k + 1)), f[0] * g[k])


def _taylor_steps(arb: Any, m: Array, b: Array, p: Array, time: Any, alpha: Fraction, digits: int) -> tuple[Array, ...]:
    z = [arb(float(v)) for v in (*m, *b, 1, 0, 0, 0)]
    gravity = [arb(float(v)) for v in p]
    momentum, axis = z[:3], z[3:6]
    extra = arb(alpha.denominator - alpha.numerator) / alpha.numerator
    extra *= sum(x * y for x, y in zip(momentum, axis, strict=True)) / sum(y * y for y in axis)
    order, time, done = int(1.3 * digits) + 6, arb(time).mid(), arb(0)
    while not done == time:
        terms = [[v] for v in z]
        for k in range(order):
            for term, slope in zip(terms, _right_hand_sides(terms, gravity, extra, k), strict=True):
                term.append(slope / (k + 1))
        h, left = _length(terms, order, digits), time - done
        last = bool(abs(left) <= h)
        h = left if last else (arb(h) if left > 0 else -arb(h))
        z = [_sum(term, h).mid() for term in terms]
        done = time if last else (done + h).mid()
    return tuple(np.array(part, dtype=object) for part in (z[:3], z[3:6], z[6:]))


def _right_hand_sides(terms: Terms, p: list[Any], extra: Any, k: int) -> list[Any]:
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


def quadrature(m: Array, b: Array, p: Array, *, digits: int = 50) -> tuple[Any, ...]:
    """Nutation period, azimuth of b about p, and turn of the body about b in a period for alpha = 1, of mpmath.

    z = b.p swings by z'^2 = (m.(b x p))^2, the Gram determinant of m, b and p; z = middle - half cos(psi) makes the
    integrands periodic, so the midpoint rule converges exponentially: its points are doubled until 10^(12 - digits) is
    reached, which takes long near the vertical.  Over the period (m, b) turns by the azimuth about p, and g becomes
    Rot_p(azimuth) g Rot_b(turn).  Raises `RunError` beyond 10^5 points.
    """
    import mpmath

    with mpmath.workdps(digits):
        m, b, p = (np.array([mpmath.mpf(float(v)) for v in w], dtype=object) for w in (m, b, p))
        A, P2, J, c, E = b @ b, p @ p, m @ b, m @ p, m @ m / 2 + b @ p
        gram = [mpmath.mpf(2), -2 * E, 2 * (J * c - A * P2), 2 * E * A * P2 - A * c * c - P2 * J * J]
        z = sorted(mpmath.re(root) for root in mpmath.polyroots(gram, maxsteps=500, extraprec=400))

        def rule(points: int) -> Array:
            total = np.array([mpmath.mpf(0)] * 3, dtype=object)
            for i in range(points):
                here = (z[0] + z[1]) / 2 - (z[1] - z[0]) / 2 * mpmath.cos(mpmath.pi * (2 * i + 1) / (2 * points))
                rise = A * P2 - here * here
                rates = [1, mpmath.sqrt(P2) * (c * A - here * J) / rise, mpmath.sqrt(A) * (J * P2 - here * c) / rise]
                total = total + np.array(rates, dtype=object) / mpmath.sqrt(2 * (z[2] - here))
            return total * (2 * mpmath.pi / points)

        points = 64
        coarse, fine = rule(points), rule(2 * points)
        while abs(fine - coarse).max() > mpmath.mpf(10) ** (12 - digits):
            points *= 2
            if points > 50_000:
                raise RunError("The midpoint rule does not converge: the motion passes too near the vertical.")
            coarse, fine = fine, rule(2 * points)
        return tuple(fine)
