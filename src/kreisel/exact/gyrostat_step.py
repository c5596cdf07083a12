"""A step of the gyrostat, n = 3, of moderate length in closed form: its integrals may change from step to step.

M' = M x Omega, Omega = w M - b, g' = g hat(Omega), axial vectors.  With X = (M/L, 1) and the matrix K of
`kreisel.exact.quadrics` in units of the step, the addition theorem there is

    X(t) ~ sum_k even_k E_k - N gamma(K) K e_4 - N' gamma(K) e_4 - D/4 N e_4 - (p'/2) sum_k odd_k O_k,
    E_k = sum_a (2k over a) K^a X (K^(2k-a) X)_4,     O_k = sum_a (2k over a) K^a P (K^(2k-a))^T e_4,
    N = X^T C K^2 X,  N' = X^T C K^3 X,  P_ij = sum_kl eps_ijkl (C X)_k (C K X)_l,

where only the weights depend on the time, by p = wp(t) and p'.  Both follow from Laurent's series at t/2.  And

    g(t) = g z(psi) p,   p M(t) = M,   psi' = L Omega(t).(M + M(t))/(L^2 + M.M(t)),

p the shortest such turn, z(psi) the turn about M by psi, which is integrated by Gauss's rule.

To rounding (2e-14) for nutations and turns by up to 3 radians, in which M turns by less than a quarter in the body; at
the limits of `reach` off by 1e-8 at most in the orientation and by 1e-10 in M.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.exact.quadrics import invariants, weights
from kreisel.exact.rotor_step import restored

NODES = 12
ORDERS = 16  # of Laurent's series at half the time
LONGEST, MOST_TURN = 1.75, 6.0  # t sqrt(max |e_i|), 0.41 of the angle of a nutation; radians of a turn
TINY = 1e-140  # M = 0, where the body turns against its wheel: no 0/0

Four = tuple[Array, Array]  # a vector (..., 3) and a last component


class Curve(NamedTuple):
    """L, x = M/L, K = ((diagonal, -b), (b^T, last)) in units of the step, and s2, s3, s4 of its quartic.

    Also the coefficients of t^4, t^6, ... in t^2 wp(t) - 1.
    """

    size: Array
    x: Array
    diagonal: Array
    b: Array
    last: Array
    quartic: tuple[Array, Array, Array]
    laurent: list[Array]

    def times(self, X: Four) -> Four:
        """K X."""
        x, last = X
        return self.diagonal * x - algebra.vec(last) * self.b, algebra.dot(self.b, x) + self.last * last


def step(M: Array, g: Array, *, h: Array, w: Array, b: Array) -> tuple[Array, Array]:
    """(M, g) after the time h: M, w, b (..., 3), g (..., 4) a unit quaternion."""
    curve = _curve(M, h, w, b)
    x, at = curve.x, motion(curve)
    L, psi = algebra.vec(curve.size), 0 * curve.size
    for node, share in zip(*_rule(), strict=True):
        y = at(node)
        psi = psi + share * algebra.dot(L * w * y - b, x + y) / (1 + algebra.dot(x, y))
    N = restored(L * at(1.0), L * x, w, b)
    y = N / L
    lift = np.concatenate([algebra.vec(1 + algebra.dot(x, y)) + 0 * x[..., :1], algebra.cross(y, x)], -1)
    z = algebra.turn(algebra.vec(psi * h) * x)
    return N, algebra.quaternion_product(g, algebra.unit(algebra.quaternion_product(z, lift)))


def reach(M: Array, h: Array, *, w: Array, b: Array) -> Array:
    """A measure of the length of a step, at most 1 up to t sqrt(max |e_i|) = 1.75, turns by 6 radians, and a quarter
    turn of M in the body.
    """
    curve = _curve(M, h, w, b)
    at, (g2, g3), Omega = motion(curve), invariants(*curve.quartic), w * M - b
    out = algebra.dot(Omega, Omega) * h * h / MOST_TURN**2
    for measure in (g2 * g2 / (3 * LONGEST**4) ** 2, g3 * g3 / LONGEST**12):
        out = algebra.maximum(out, measure)
    for node in (*_rule()[0], 1.0):
        out = algebra.maximum(out, 1 / (1 + algebra.dot(curve.x, at(node))))
    return out


def _rule() -> tuple[list[float], list[float]]:
    """The nodes and weights of Gauss's rule between 0 and 1."""
    nodes, shares = np.polynomial.legendre.leggauss(NODES)
    return ((1 + nodes) / 2).tolist(), (shares / 2).tolist()


def _curve(M: Array, h: Array, w: Array, b: Array) -> Curve:
    M = M + TINY
    L = algebra.sqrt(algebra.dot(M, M))
    return curve_of(M / algebra.vec(L), L, h, w, b)


def curve_of(x: Array, L: Array, h: Array, w: Array, b: Array, orders: int = ORDERS) -> Curve:
    """That of M = L x and the step h, with Laurent's series to so many orders."""
    energy = L * algebra.dot(x, w * x) - 2 * algebra.dot(b, x)
    trace = (L * (w[..., 0] + w[..., 1] + w[..., 2]) + energy) / 4
    diagonal = algebra.vec(h) * (algebra.vec(L) * w - algebra.vec(trace))
    b, last = algebra.vec(h) * b, h * (energy - trace)
    # K^2 = ((diagonal^2 - b b^T, -u), (u^T, last^2 - b.b))
    squares, u, corner = diagonal * diagonal, (diagonal + algebra.vec(last)) * b, last * last - algebra.dot(b, b)
    bb, bu = algebra.dot(b, b), algebra.dot(b, u)
    ones = 1 + 0 * x
    second = algebra.dot(squares, ones) - 2 * bb + last * last
    third = algebra.dot(squares - b * b, diagonal) - 2 * bu + corner * last
    fourth = algebra.dot(squares, squares) - 2 * algebra.dot(squares, b * b) + bb * bb
    fourth = fourth - 2 * algebra.dot(u, u) + corner * corner
    s2 = -second / 2
    quartic = s2, third / 3, (2 * s2 * s2 - fourth) / 4
    return Curve(L, x, diagonal, b, last, quartic, _laurent(*invariants(*quartic), orders))


def motion(curve: Curve) -> Any:
    """M/L at a time in units of the step."""
    x, K = curve.x, curve.times
    one = 1 + 0 * curve.last
    X, column = [(x, one)], [(0 * x, one)]  # K^a X and K^a e_4
    for _ in range(4):
        X.append(K(X[-1]))
        column.append(K(column[-1]))
    N, third = (algebra.dot(x, X[k][0]) - X[k][1] for k in (2, 3))
    (a, a4), (c, c4) = ((v, -last) for v, last in X[:2])
    inner, outer = algebra.vec(c4) * a - algebra.vec(a4) * c, algebra.cross(a, c)

    def rotated(column: Four) -> Four:
        """P (K^k)^T e_4; the row is -C times the column K^k e_4, since C K is symmetric."""
        row, last = column
        return algebra.vec(last) * outer - algebra.cross(row, inner), algebra.dot(outer, row)

    rows, evens, odds = [rotated(v) for v in column], [], []
    for k in (0, 2, 4):
        evens.append(_sum([(math.comb(k, a) * X[k - a][1], X[a]) for a in range(k + 1)]))
        odd = rows[0]
        for a in reversed(range(k)):
            (x, last), (row, corner), count = K(odd), rows[k - a], math.comb(k, a)
            odd = x + count * row, last + count * corner
        odds.append(odd)
    below = [_sum([(third, column[k]), (N, column[k + 1])]) for k in range(4)]
    vectors = [*evens, *odds, *below, _sum([(N, column[0])])]

    def at(t: Any) -> Array:
        s2, s3, s4 = (s * t**k for s, k in zip(curve.quartic, (2, 3, 4), strict=True))
        p, slope = _doubled(curve.laurent, invariants(s2, s3, s4), t)
        even, odd, gamma, last = weights(p, s2, s3, s4)
        factors = [even[k] * t ** (2 * k) for k in (0, 1, 2)]
        factors += [slope / 2 * odd[k] * t ** (2 * k + 1) for k in (0, 1, 2)]
        factors += [*(-gamma[k] * t ** (3 + k) for k in range(4)), -last * t * t]
        y, below = _sum(list(zip(factors, vectors, strict=True)))
        return y / algebra.vec(below)

    return at


def _sum(parts: list[tuple[Any, Four]]) -> Four:
    (factor, (x, last)), *more = parts
    out = algebra.vec(factor) * x, factor * last
    for factor, (x, last) in more:
        out = out[0] + algebra.vec(factor) * x, out[1] + factor * last
    return out


def _laurent(g2: Array, g3: Array, orders: int) -> list[Array]:
    """The coefficients of t^4, t^6, ... in t^2 wp(t) - 1."""
    c = [g2 / 20, g3 / 28]
    for k in range(4, orders + 1):
        c.append(3 * sum(c[m - 2] * c[k - m - 2] for m in range(2, k - 1)) / ((2 * k + 1) * (k - 3)))
    return c


def _doubled(laurent: list[Array], scaled: tuple[Array, Array], t: float) -> tuple[Array, Array]:
    """t^2 wp(t) and -t^3 wp'(t), from their values at t/2; `scaled`: g2 t^4 and g3 t^6."""
    square = t * t / 4
    p, slope = 0 * laurent[0], 0 * laurent[0]
    for k in reversed(range(len(laurent))):
        term = laurent[k] * square ** (k + 2)
        p, slope = p + term, slope + (2 * k + 2) * term
    p, slope = 1 + p, slope - 2  # of t/2, and wp'
    bend = 6 * p * p - scaled[0] / 32  # wp''
    ratio = bend / slope
    double = ratio * ratio / 4 - 2 * p
    return 4 * double, 8 * (slope - ratio * (p - double))
