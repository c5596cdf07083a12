"""Taylor series and quadrature of the equations of motion, in many digits: independent references.

`taylor_solution` is for the Lagrange top and Clebsch's case of any n, `free_body` for the Euler top, n = 3; the others
for the Lagrange top, n = 3, with orientation: m' = p x b, b' = m x b, q' = omega q / 2 with
omega = m + (1/alpha - 1) (m.b) b/|b|^2; nothing of a method's formulas enters.  Needs python-flint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from operator import mul
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.record.calling import call

Terms = list[list[Any]]  # of each component, the coefficients


@contextmanager
def many_digits(digits: int) -> Iterator[Any]:
    """python-flint, with so many digits and 15 more.  Raises `InputError` where it is not installed."""
    try:
        import flint
    except ImportError as error:
        raise InputError("The reference in many digits needs python-flint: pip install 'kreisel[exact]'.") from error
    before, flint.ctx.prec = flint.ctx.prec, int((digits + 15) * 3.33)
    try:
        yield flint
    finally:
        flint.ctx.prec = before


def taylor(m: Array, b: Array, p: Array, time: Any, *, alpha: float = 1.0, digits: int = 30) -> tuple[Array, ...]:
    """(m, b, q) at `time` to about `digits` digits: axial vectors and a quaternion, q = 1 at time 0, of flint.arb.

    Doubles are taken as exact; `time` may be a number of flint.  Each step is as long as the last two terms of its
    series allow, 10^-digits; rounding is 15 digits below.  Raises `InputError` without python-flint.
    """
    with many_digits(digits) as flint:
        z, gravity = [flint.arb(float(v)) for v in (*m, *b, 1, 0, 0, 0)], [flint.arb(float(v)) for v in p]
        momentum, axis, ratio = z[:3], z[3:6], Fraction(alpha)
        extra = flint.arb(ratio.denominator - ratio.numerator) / ratio.numerator
        extra *= sum(x * y for x, y in zip(momentum, axis, strict=True)) / sum(y * y for y in axis)
        z = _flown(flint, z, lambda terms, k: _right_hand_sides(terms, gravity, extra, k), time, digits)
        return tuple(np.array(part, dtype=object) for part in (z[:3], z[3:6], z[6:]))


def taylor_solution(
    X: Array, v: Array, fixed: Array, time: float, *, clebsch: bool = False, digits: int = 24
) -> tuple[Array, Array]:
    """(X, v) at `time`, of flint.arb: X' = v ^ p, v' = X v, or X' = v ^ Bv, v' = -X v with `clebsch`.

    `fixed` is p, or b with B = diag(b).  Steps and rounding as in `taylor`.  Raises `InputError` without python-flint.
    """
    with many_digits(digits) as flint:
        n, mat, sign = len(v), flint.arb_mat, -1 if clebsch else 1
        B, p = mat(n, n, [float(x) for x in np.diag(fixed).flat]), mat(n, 1, [float(x) for x in fixed])

        def rates(terms: Terms, k: int) -> list[Any]:
            Xs, vs = terms
            outer = _product(vs, [(B * v).transpose() for v in vs], k) if clebsch else vs[k] * p.transpose()
            return [outer - outer.transpose(), sign * _product(Xs, vs, k)]

        z = [mat(n, n, [float(x) for x in X.flat]), mat(n, 1, [float(x) for x in v])]
        X, v = (np.array(x.entries(), dtype=object) for x in _flown(flint, z, rates, time, digits))
        return X.reshape(n, n), v


def flow_of(model: Any, state: tuple[Array, ...], time: float, *, digits: int = 24) -> Array:
    """The coordinates of the state at `time`, of flint.arb, by the flow of a record, a polynomial of the state.

    Steps and rounding as in `taylor`.  Raises `InputError` without python-flint.
    """
    with many_digits(digits) as flint:
        kinds, system = model.system.space.kinds, model.system

        def exactly(x: Array) -> Array:
            return algebra.objects((flint.arb(float(v)) for v in np.ravel(x)), np.shape(x))[()]

        known = {
            p.letter: model.params[p.letter] if p.kind == "dimension" else exactly(model.params[p.letter])
            for p in system.parameters
        }
        known |= call(system.derive, (), known) if system.derive is not None else {}

        def rates(terms: Terms, k: int) -> list[Any]:
            series = algebra.objects(flint.arb_poly(term) for term in terms)
            flow = call(system.flow, algebra.restore(series, kinds, model.n), known)
            return [(x + flint.arb_poly([0]))[k] for x in algebra.flatten(flow, kinds)]

        return np.array(_flown(flint, [*exactly(algebra.flatten(state, kinds))], rates, time, digits), dtype=object)


def free_body(mu: Array, moments: Array, time: float, *, digits: int = 24) -> Array:
    """The axial vector mu (3,) at `time`, of flint.arb: mu' = mu x mu/I, doubles taken as exact.

    Steps and rounding as in `taylor`.  Raises `InputError` without python-flint.
    """
    with many_digits(digits) as flint:
        a, b, c = (1 / flint.arb(float(v)) for v in moments)

        def rates(terms: Terms, k: int) -> list[Any]:
            return [rate * _product(terms[i - 2], terms[i - 1], k) for i, rate in enumerate((c - b, a - c, b - a))]

        return np.array(_flown(flint, [flint.arb(float(v)) for v in mu], rates, time, digits), dtype=object)


def _flown(flint: Any, z: list[Any], rates: Callable[[Terms, int], list[Any]], time: Any, digits: int) -> list[Any]:
    """z at a time, numbers or matrices: rates(terms, k) are the coefficients k of the right-hand sides."""
    order, end, done = int(1.3 * digits) + 7, flint.arb(time).mid(), flint.arb(0)
    while not done == end:
        terms = [[v] for v in z]
        for k in range(order):
            for term, slope in zip(terms, rates(terms, k), strict=True):
                term.append(slope * (flint.arb(1) / (k + 1)))
        h, left = _length(terms, order, digits), end - done
        last = bool(abs(left) <= h)
        step = left if last else flint.arb(h if left > 0 else -h)
        z = [_middle(_sum(term, step)) for term in terms]
        done = end if last else (done + step).mid()
    return z


def _middle(x: Any) -> Any:
    return type(x)(x.nrows(), x.ncols(), [v.mid() for v in x.entries()]) if hasattr(x, "entries") else x.mid()


def _product(f: list[Any], g: list[Any], k: int) -> Any:
    """Coefficient k of a product of series."""
    return sum(map(mul, f[1 : k + 1], reversed(g[:k])), f[0] * g[k])


def _right_hand_sides(terms: Terms, p: list[Any], extra: Any, k: int) -> list[Any]:
    """Coefficient k of the right-hand sides."""
    m, b, (w, *v) = terms[:3], terms[3:6], terms[6:]
    omega = [[x + extra * y for x, y in zip(mi, bi, strict=True)] for mi, bi in zip(m, b, strict=True)]

    def cross(f: Terms, g: Terms) -> list[Any]:
        return [_product(f[i - 2], g[i - 1], k) - _product(f[i - 1], g[i - 2], k) for i in range(3)]

    down = [p[i - 2] * b[i - 1][k] - p[i - 1] * b[i - 2][k] for i in range(3)]
    turned = [x + _product(o, w, k) for x, o in zip(cross(omega, v), omega, strict=True)]
    scalar = -sum(_product(o, x, k) for o, x in zip(omega, v, strict=True))
    return [*down, *cross(m, b), scalar / 2, *(x / 2 for x in turned)]


def _length(terms: Terms, order: int, digits: int) -> float:
    """The h with |last two terms| h^order <= 10^-digits."""
    lengths = [1.0]
    for k in (order - 1, order):
        entries = (x for term in terms for x in (term[k].entries() if hasattr(term[k], "entries") else [term[k]]))
        largest = max(float(abs(x).mid()) for x in entries)
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
