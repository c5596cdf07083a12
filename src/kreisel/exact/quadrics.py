"""An addition theorem on the curve in which a sphere and a quadric meet: the flow of a gyrostat, n = 3, in closed form.

M' = M x (w M - b), axial vectors, w diagonal, keeps |M|^2 = L^2 and e = M.w M - 2 b.M.  With X = (M/L, 1) and time in
units of 1/L they are two quadrics, X^T C X = X^T C K X = 0,

    C = diag(1, 1, 1, -1),   K = ((w, -b/L), (b^T/L, e/L^2)) less a quarter of its trace,
    det(lambda - K) = lambda^4 + s2 lambda^2 - s3 lambda + s4.

The state after the time t is a quotient of quadratic forms in X, with coefficients from p = wp(t) and p' = wp'(t):

    X(t) ~ (E - p'/2 O) e_4,   P_jk = sum_lm eps_jklm (C X)_l (C K X)_m, the tangent X' X^T - X X'^T,
    E_jk = A(rho_jk) X_j X_k,  j != k;   E_jj = D (wp_f - K_j^2/2 - s2/12) X_j^2 + D N/4 C_jj,   N = X^T C K^2 X,
    O_jk = F(rho_jk) P_jk,     F(rho) = q^2 + g2/4 - 2 q rho - 2 rho^2

in a basis where K is diagonal.  Here q = -p, g2 and g3 are the invariants of the quartic, g3 with the opposite sign,
D = 4 q^3 - g2 q + g3 = -p'^2, wp_f = wp at the time 2t of the quartic, rho_jk = -(K_j + K_k)^2/4 - s2/6 the roots of
its cubic, and A(rho) is the product of F at the other two.  In powers of K, as here, nothing is divided by a difference
of eigenvalues: spheres, axes, equilibria, separatrices and b = 0 are no special cases.  It follows from
X_j^2 C_jj = N (K_j - mu)/f'(K_j), f the quartic, mu'^2 = -4 f(mu), and the addition theorems of theta functions.
Integrals are conserved for any p, exactly (tested over Q).  [docs/exact.md; DLMF 20.7, 23.10, 23.20]

A step of moderate length, `step`, whose integrals may change from one to the next, needs no matrix of forms:

    X(t) ~ sum_k even_k E_k - N gamma(K) K e_4 - N' gamma(K) e_4 - D/4 N e_4 - (p'/2) sum_k odd_k O_k,
    E_k = sum_a (2k over a) K^a X (K^(2k-a) X)_4,     O_k = sum_a (2k over a) K^a P (K^(2k-a))^T e_4,
    N = X^T C K^2 X,  N' = X^T C K^3 X,

where only the weights depend on the time, by p and p', which follow from Laurent's series at t/2.  Its orientation is

    g(t) = g z(psi) p,   p M(t) = M,   psi' = L Omega(t).(M + M(t))/(L^2 + M.M(t)),   Omega = w M - b,

p the shortest such rotation, z(psi) the rotation about M by psi, which is integrated by Gauss's rule.  To rounding
(2e-14) for nutations and rotations by up to 3 radians, in which M rotates by less than a quarter in the body; at the
limits of `reach` off by 1e-8 at most in the orientation and by 1e-10 in M.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.exact.rotor_step import laurent, restored

METRIC = np.diag([1, 1, 1, -1])
ORDERS = 16  # of Laurent's series of wp: its terms fall by 9 or more; of a step, at half the time
NEAR, WIDE = 0.8, 2.0  # of one map: t sqrt(max |e_i|) and the size of t K
FORMS = {"squares": 2, "products": 2, "linear": 2, "fixed": 1}  # of the state, and the axes of each
NODES = 12  # of Gauss's rule, of a step
LONGEST, MOST_TURN = 1.75, 6.0  # of a step: t sqrt(max |e_i|), 0.41 of the angle of a nutation; radians of a rotation
TINY = 1e-140  # M = 0, where the body rotates against its wheel: no 0/0
BELOW = {"below_squares": 1, "below_products": 1, "below_linear": 1}  # of the denominator

Four = tuple[Array, Array]  # a vector (..., 3) and a last component


LEVI_CIVITA = np.rint(np.linalg.det(np.eye(4)[np.moveaxis(np.indices((4,) * 4), 0, -1)])).astype(np.int64)


def quartic(K: Array) -> tuple[Array, Array, Array]:
    """s2, s3, s4 of K (..., 4, 4) without trace."""
    K2 = K @ K
    second, third, fourth = ((X * Y.mT).sum((-2, -1)) for X, Y in ((K, K), (K2, K), (K2, K2)))
    s2 = -second / 2
    return s2, third / 3, (2 * s2 * s2 - fourth) / 4


def invariants(s2: Array, s3: Array, s4: Array) -> tuple[Array, Array]:
    """g2 and g3 in real time: those of the quartic belong to imaginary time, which changes the sign of g3."""
    return s4 + s2 * s2 / 12, s3 * s3 / 16 + s2 * s2 * s2 / 216 - s2 * s4 / 6


def addition(K: Array, p: Array) -> tuple[Array, Array]:
    """E and O (..., 4, 4, 4), one form for each component of X; K (..., 4, 4), p (...)."""
    powers = [np.eye(4, dtype=np.int64) + 0 * K, K]
    for _ in range(3):
        powers.append(powers[-1] @ K)
    even, odd, c, last = weights(p, *quartic(K))
    E, O = 0 * K[..., None, :, :], 0 * K[..., None, :, :]  # noqa: E741
    pairs = LEVI_CIVITA * np.diag(METRIC)[:, None]  # P_ij = pairs_ijkl X_k (C K X)_l
    for order in (0, 1, 2):
        for a in range(2 * order + 1):
            times, row = math.comb(2 * order, a), powers[2 * order - a][..., 3, :]
            E = E + _cube(times * even[order]) * powers[a][..., :, :, None] * row[..., None, None, :]
            bivector = (pairs * row[..., None, :, None, None]).sum(-3) @ (METRIC @ K)[..., None, :, :]
            rotated = (powers[a][..., :, :, None, None] * bivector[..., None, :, :, :]).sum(-3)
            O = O + _cube(times * odd[order]) * rotated  # noqa: E741
    gamma = sum(algebra.mat(c[k]) * powers[k] for k in range(4))
    N, third = METRIC @ powers[2], METRIC @ powers[3]
    E = (
        E
        - (gamma @ K)[..., :, 3, None, None] * N[..., None, :, :]
        - gamma[..., :, 3, None, None] * third[..., None, :, :]
    )
    return E - _cube(last) * np.array([0, 0, 0, 1])[:, None, None] * N[..., None, :, :], O


def weights(
    p: Array, s2: Array, s3: Array, s4: Array
) -> tuple[tuple[Array, ...], tuple[Array, ...], tuple[Array, ...], Array]:
    """Weights of the powers of K in E and O: of m^0, m^2 and m^4 in both, of K^0 to K^3 in gamma, and D/4."""
    g2, g3 = invariants(s2, s3, s4)
    q = -p
    D, middle = 4 * q**3 - g2 * q + g3, q * q + g2 / 4
    A = ((q * q - 3 * g2 / 2) * q * q + g3 * q + g2 * g2 / 16, (4 * q * q + g2) * q / 2 - g3, 6 * q * q - g2 / 2)
    gamma = (
        s3 * (12 * q + s2) / 64,
        (36 * s4 - 576 * q * q - 84 * q * s2 - 7 * s2 * s2) / 288,
        -s3 / 32,
        -(6 * q + s2) / 24,
    )
    return _in_powers(A, s2), _in_powers((middle, -2 * q, -2 + 0 * q), s2), gamma, D / 4


def _cube(x: Array) -> Array:
    return np.asarray(x)[..., None, None, None]


def _in_powers(c: tuple[Array, ...], s2: Array) -> tuple[Array, Array, Array]:
    """c0 + c1 rho + c2 rho^2, rho = -m^2/4 - s2/6, in powers of m^2."""
    return c[0] - c[1] * s2 / 6 + c[2] * s2 * s2 / 36, c[2] * s2 / 12 - c[1] / 4, c[2] / 16


def weierstrass(g2: Array, g3: Array) -> tuple[Array, Array]:
    """wp(1) and -wp'(1) by Laurent's series, for max |e_i| <= NEAR^2."""
    c = laurent(g2 / 20, g3 / 28, ORDERS)
    return 1 + sum(reversed(c)), 2 - sum((2 * k + 2) * c[k] for k in reversed(range(len(c))))


def curve(M: Array, w: Array, b: Array) -> tuple[Array, Array]:
    """L and L K, which is K in the unit of time, for M (..., 3); 0 where M = 0, which stays."""
    square = algebra.dot(M, M)
    L = algebra.sqrt(square)
    energy = (algebra.dot(M, w * M) - 2 * algebra.dot(b, M)) / (L + (L == 0))
    K = np.zeros((*L.shape, 4, 4), dtype=M.dtype)
    for i in range(3):
        K[..., i, i], K[..., i, 3], K[..., 3, i] = L * w[..., i], -b[..., i], b[..., i]
    K[..., 3, 3] = energy
    trace = (L * w.sum(-1) + energy) / 4
    for i in range(4):
        K[..., i, i] = K[..., i, i] - trace
    return L, K * algebra.mat(L != 0)


def length(K: Array) -> Array:
    """How many maps a unit of time needs, as a real number: t sqrt(max |e_i|)/NEAR or the size of t K over WIDE."""
    g2, g3 = invariants(*quartic(K))
    fastest = np.maximum(abs(g2 / 3) ** 0.25, abs(g3) ** (1 / 6))
    return np.maximum(fastest / NEAR, np.sqrt((K * K).sum((-2, -1))) / WIDE)


def moved(K: Array) -> tuple[Array, Array]:
    """Forms (..., 4, 4, 4) of the state after the unit of time, the even part of the last of them 1 at (0, 1)."""
    p, slope = weierstrass(*invariants(*quartic(K)))
    even, odd = addition(K, p)
    Q = even + _cube(slope / 2) * odd
    scale = even[..., 3, 3, 3]
    return (Q + Q.mT) / _cube(2 * scale), even[..., 3, :, :] / algebra.mat(scale)


def coefficients(Q: Array) -> dict[str, Array]:
    """Coefficients of the squares, products, x and 1 in forms (..., 4, 4) of (x, 1)."""
    return {
        "squares": Q[..., range(3), range(3)],
        "products": 2 * Q[..., algebra.SECOND, algebra.THIRD],
        "linear": 2 * Q[..., :3, 3],
        "fixed": Q[..., 3, 3],
    }


def forms(K: Array) -> dict[str, Array]:
    """M/L after the unit of time is (x + n(x))/(1 + d(x)): coefficients of n, by FORMS, and of d, by BELOW."""
    Q, _ = moved(K)
    Q[..., range(3), range(3), 3] -= 0.5
    result = coefficients(Q)
    below = {f"below_{k}": v[..., 3, :] for k, v in result.items() if k != "fixed"}
    return {k: v[..., :3, :] for k, v in result.items() if k != "fixed"} | below | {"fixed": result["fixed"][..., :3]}


def change(x: Array, constants: Mapping[str, Array], which: str = "") -> Array:
    """By how much a map changes x = M/L."""
    squares, products = x * x, x[..., algebra.SECOND] * x[..., algebra.THIRD]
    above = algebra.act(constants["squares" + which], squares) + algebra.act(constants["products" + which], products)
    above = above + (algebra.act(constants["linear" + which], x) + constants["fixed" + which])
    below = algebra.dot(constants["below_squares" + which], squares) + algebra.dot(
        constants["below_products" + which], products
    )
    below = algebra.vec(below + algebra.dot(constants["below_linear" + which], x))
    return (above - x * below) / (1 + below)


# -- a step ---------------------------------------------------------------------------------------------


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
        psi = psi + share * rate(x, at(node), L, w, b)
    N = restored(L * at(1.0), L * x, w, b)
    z = algebra.turn(algebra.vec(psi * h) * x)
    return N, algebra.quaternion_product(g, algebra.unit(algebra.quaternion_product(z, lift(x, N / L))))


def rate(e: Array, x: Array, size: Array, w: Array, b: Array) -> Array:
    """psi' at M = size x, counted from the unit vector e."""
    return algebra.dot(w * size * x - b, e + x) / (1 + algebra.dot(e, x))


def lift(x: Array, y: Array) -> Array:
    """The shortest rotation q that carries y to x, q y q^-1 = x, of unit vectors; not of unit length."""
    return algebra.quaternion(1 + algebra.dot(x, y), algebra.cross(y, x))


def reach(M: Array, h: Array, *, w: Array, b: Array) -> Array:
    """A measure of the length of a step, at most 1 up to t sqrt(max |e_i|) = 1.75, rotations by 6 radians, and a
    quarter of a revolution of M in the body.
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
    """The curve of M = L x and the step h, with Laurent's series to `orders` orders."""
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
    g2, g3 = invariants(*quartic)
    return Curve(L, x, diagonal, b, last, quartic, laurent(g2 / 20, g3 / 28, orders))


def motion(curve: Curve) -> Any:
    """M/L at a time in units of the step."""
    x, K = curve.x, curve.times
    unit = 1 + 0 * curve.last
    X, column = [(x, unit)], [(0 * x, unit)]  # K^a X and K^a e_4
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
    (factor, (x, last)), *following = parts
    out = algebra.vec(factor) * x, factor * last
    for factor, (x, last) in following:
        out = out[0] + algebra.vec(factor) * x, out[1] + factor * last
    return out


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
