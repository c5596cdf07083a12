"""Beyond the paper: explicit maps of quadratic fields, by one theorem in algebras with an involution, and their cases."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, dot, identity, moebius, solve
from kreisel.algebra.backend import Complex
from kreisel.algebra.invariants import blocks, determinant
from kreisel.lab.exact import jacobian
from kreisel.lab.law import Sides
from kreisel.lab.paper.setting import Diagonal, Eps, Lam, Scalar, Setting, Skew, Vector
from kreisel.lab.paper.statements import leaf_rank, rank, stated
from kreisel.record.calling import call
from kreisel.record.contract import FIELD_SPACE, MOVING_SPACE, TWO_FIELDS_SPACE
from kreisel.system import (
    REGISTRY,
    komarov,
    kovalevskaya_gyrostat as gyrostat,
    kovalevskaya_top_e3,
    kovalevskaya_top_so3,
    quadratic_field,
)

FIELDS = "Beyond the paper, quadratic fields"
FAMILY = "Beyond the paper, Kovalevskaya's top on e(3), so(4) and so(3,1)"
ONE, UNIT, SWAP, MIRROR = (np.array(x) for x in ([[1]], [[0, -1], [1, 0]], [[0, 1], [1, 0]], [[1, 0], [0, -1]]))
COMMUTING = (np.kron(UNIT, identity(2)), np.kron(MIRROR, UNIT), np.kron(SWAP, UNIT))  # with all quaternions
FIRST, LAST = np.diag([1, 0]), np.diag([0, 1])
COMPLEX = (identity(2), UNIT)
QUATERNIONS = (identity(4), np.kron(identity(2), UNIT), np.kron(UNIT, MIRROR), np.kron(UNIT, SWAP))


class Algebra(NamedTuple):
    """Matrices over real d x d matrices `units`, with a matrix of n blocks, the last one with a sign.

    The n x n matrices with X* = J^-1 X^T J, or the odd part of X* = X^T under the automorphism X -> J X J^-1.
    """

    name: str
    units: tuple[Array, ...]
    block: Array
    last: int = 1

    def form(self, n: int) -> Array:
        return np.kron(np.diag([1] * (n - 1) + [self.last]), self.block)


ALGEBRAS = (
    Algebra("so(n)", (ONE,), ONE),
    Algebra("so(n-1, 1)", (ONE,), ONE, -1),
    Algebra("u(n)", COMPLEX, identity(2)),
    Algebra("u(n-1, 1)", COMPLEX, identity(2), -1),
    Algebra("sp(n)", QUATERNIONS, identity(4)),
    Algebra("so*(2n)", QUATERNIONS, QUATERNIONS[2]),
    Algebra("sp(2n, R)", (identity(2), UNIT, SWAP, MIRROR), UNIT),
    Algebra("gl(n)", (FIRST, LAST), SWAP),
)


PAIRS = (
    Algebra("so(p) x so(q)", (ONE,), ONE, -1),
    Algebra("u(p) x u(q)", COMPLEX, identity(2), -1),
    Algebra("sp(p) x sp(q)", QUATERNIONS, identity(4), -1),
    Algebra("so(n) x so(n), Ratiu's", COMPLEX, MIRROR),
    Algebra("u(n) x complex symmetric, in sp(2n, R)", (identity(2), UNIT, SWAP, MIRROR), UNIT),
    Algebra("u(n) x complex skew, in so*(2n)", QUATERNIONS, QUATERNIONS[1]),
)


def element(s: Setting, units: tuple[Array, ...]) -> Array:
    """A random matrix over the units."""
    return sum(np.kron(s.draw((s.n, s.n)), unit) for unit in units)


def moved(M: Array, F: Array, B: Array, eps: Any) -> tuple[Array, Array, Array, Array]:
    """X, M~, c and F' of the step."""
    unit = identity(len(M))
    X = solve(unit + eps * eps / 4 * (F @ B), F)
    M = M + eps * (X @ B - B @ X)
    c = moebius(-eps / 2 * M)
    return X, M, c, c @ F @ moebius(eps / 2 * M)


def block_pencil(M: Array, F: Array, B: Array, eps: Any, nu: Any, mu: Any) -> Array:
    """[[nu B + M - mu, 1 + k M], [-(1 - k M), nu F^-1 + s mu + s M]]."""
    unit, k = identity(len(M)), eps / 2
    return blocks(
        [[nu * B + M - mu * unit, unit + k * M], [k * M - unit, nu * solve(F, unit) + k * k * (mu * unit + M)]]
    )


@stated("field-theorem", FIELDS, dimensions=(3, 4), numbers=("exact",))
def field_theorem(s: Setting, eps: Eps, nu: Lam, mu: Scalar) -> Sides:
    """in any algebra with an involution, M* = -M, F* = F, B* = B: diag(1, -c) (1 + S A/nu) L (1 - A S/nu) diag(1, -1/c) = L' for the 2 x 2 block pencil L(nu, mu), A = (2/k) Z X Z*, Z = (-k, 1), S = diag(1, -s), in so(n), so(n-1, 1), u(n), u(n-1, 1), sp(n), so*(2n), sp(2n, R), gl(n)"""
    for kind in ALGEBRAS:
        J = kind.form(s.n)

        def star(X: Array, J: Array = J) -> Array:
            return J.T @ X.T @ J  # J is orthogonal

        M, F, B = (element(s, kind.units) for _ in range(3))
        M, F, B = M - star(M), F + star(F), B + star(B)
        X, after, c, field = moved(M, F, B, eps)
        yield star(X), X
        yield star(after), -after
        yield star(field), field
        k, unit = eps / 2, identity(len(M))
        Z, row, zero = blocks([[-k * unit], [unit]]), blocks([[-k * unit, unit]]), 0 * unit
        S = blocks([[unit, zero], [zero, -k * k * unit]])
        A = 2 / k * Z @ X @ row
        yield row @ S @ Z, zero + 0 * k
        yield block_pencil(M, F, B, eps, 0 * nu, -1 / k) @ Z, 0 * Z
        U, V = identity(2 * len(M)) + S @ A / nu, identity(2 * len(M)) - A @ S / nu
        left, right = (blocks([[unit, zero], [zero, -x]]) for x in (c, star(c)))
        yield left @ U @ block_pencil(M, F, B, eps, nu, mu) @ V @ right, block_pencil(after, field, B, eps, nu, mu)


@stated("field-pairs", FIELDS, dimensions=(3, 4))
def field_pairs(s: Setting, eps: Eps) -> Sides:
    """an automorphism with M even, F and B odd is kept by the step: so(p) x so(q), u(p) x u(q), sp(p) x sp(q), so(n) x so(n) (Ratiu), u(n) with complex symmetric fields (sp(2n, R)) and with complex skew fields (so*(2n))"""
    for pair in PAIRS:
        g = pair.form(s.n)
        M, F, B = (element(s, pair.units) for _ in range(3))
        M, F, B = M - M.T, F + F.T, B + B.T
        M, F, B = M + g @ M @ g.T, F - g @ F @ g.T, B - g @ B @ g.T
        X, after, _, field = moved(M, F, B, eps)
        yield g @ X @ g.T, -X
        yield g @ after @ g.T, after
        yield g @ field @ g.T, -field


@stated("field-reductions", FIELDS, dimensions=(3,), ranks=True)
def field_reductions(s: Setting, b: Diagonal) -> Sides:
    """with each b_i twice, or four times, the map of quadratic-field keeps complex, or quaternionic, M and F: these are u(n) with Hermitian fields and sp(n) with quaternionic ones; on u(n) energy and spectrum have the rank n (n - 1), half the dimension of a leaf"""
    field = quadratic_field
    for units, others in ((QUATERNIONS, COMMUTING), (COMPLEX, (UNIT,))):
        M, F = (element(s, units) for _ in range(2))
        M, F, wide = M - M.T, F + F.T, np.repeat(b, len(units[0]))
        for X in field.MAP.step(M, F, b=wide, eps=s.eps):
            for unit in others:
                matrix = np.kron(identity(s.n), unit)
                yield X @ matrix, matrix @ X
    constants = {"b": wide, "B": np.diag(wide), "eps": s.eps}  # of the complex ones
    slopes = [
        jacobian(lambda *z, f=f: call(f, z, constants), (M, F), FIELD_SPACE.kinds, len(M))[1].reshape(
            -1, s.n * len(M) * 2
        )
        for f in (field.energy, field.spectrum)
    ]
    yield rank(np.concatenate(slopes) @ FIELD_SPACE.tensor(M, F)), s.n * (s.n - 1)


@stated("field-brackets", FIELDS, dimensions=(3, 4))
def field_brackets(s: Setting) -> Sides:
    """m = [[M, (1 + k M) P], [-P^T (1 - k M), s P^T M P]] is a Poisson map to so(S)*, S = diag(1, -s P^T P): {m_AB, m_CD} = m_AD S_BC - m_CB S_DA - m_AC S_BD + m_DB S_CA; P of one vector or two"""
    k = s.eps / 2

    def m(M: Array, *vectors: Array) -> Array:
        P = np.stack(vectors, -1)
        return blocks([[M, P + k * (M @ P)], [k * (P.T @ M) - P.T, k * k * (P.T @ M @ P)]])

    for space in (MOVING_SPACE, TWO_FIELDS_SPACE):
        state = space.point(s.n, s.draw)
        J, P = jacobian(m, state, space.kinds, s.n)[1], np.stack(state[1:], -1)
        brackets = np.tensordot(np.tensordot(J, space.tensor(*state), 1), J, ([2], [2]))
        N, zero = m(*state), 0 * P
        S = blocks([[identity(s.n) + 0 * state[0], zero], [zero.T, -k * k * (P.T @ P)]])
        terms = np.multiply.outer(N, S)  # m_AB S_CD
        plus = terms.transpose(0, 2, 3, 1) + terms.transpose(2, 1, 3, 0)
        yield brackets, plus - terms.transpose(2, 1, 0, 3) - terms.transpose(0, 2, 1, 3)


@stated("kovalevskaya-curve-one-field", FIELDS, dimensions=(3,))
def curve_of_one_field(s: Setting, M: Skew, P: Vector, mu: Scalar) -> Sides:
    """the 7 x 7 pencil has det L/mu = -(u - v)^2 (u - s^2 a v) + 2 H u^2 - (2 H - 2 s a + s^2 c^2) u v - (2 s a - s^2 c^2) v^2 - (H^2 - K + a - s c^2) u + (a - 2 s c^2) v + c^2 with H and K of the map, u = lambda^2, v = mu^2, a = |P|^2, c = <M, P>"""
    top = kovalevskaya_top_e3
    constants, u, v, t = gyrostat.shape(n=np.asarray(3)), s.lam * s.lam, mu * mu, s.eps * s.eps / 4
    H, K = top.energy(M, P, c=constants["c"], eps=s.eps), top.kovalevskaya(M, P, c=constants["c"], eps=s.eps)
    a, c = dot(P, P), dot(algebra.axial(M), P)
    curve = (u - v) * (u - v) * (u - t * t * a * v) - 2 * H * u * u + (2 * H - 2 * t * a + t * t * c * c) * u * v
    curve = (
        curve + (2 * t * a - t * t * c * c) * v * v + (H * H - K + a - t * c * c) * u - (a - 2 * t * c * c) * v - c * c
    )
    pencil = top.pencil(M, P, lam=s.lam, mu=mu, eps=s.eps)
    yield determinant(pencil), -mu * curve


@stated("kovalevskaya-curve-two-fields", FIELDS, dimensions=(3,))
def curve_of_two_fields(s: Setting, M: Skew, P: Vector, Q: Vector, mu: Scalar) -> Sides:
    """the 9 x 9 pencil has det L/mu = -(u - v)^2 (u^2 - s^2 t u v + s^4 d v^2) + 2 H u^3 + .. with H, K and G of the map, t = |P|^2 + |Q|^2, d = |P x Q|^2"""
    top = kovalevskaya_top_so3
    constants, u, v, e = gyrostat.shape(n=np.asarray(3)), s.lam * s.lam, mu * mu, s.eps * s.eps / 4
    H = gyrostat.energy(M, P, Q, gamma=0, c=constants["c"], eps=s.eps)
    K = top.kovalevskaya(M, P, Q, c=constants["c"], eps=s.eps)
    G, t, d = top.gram(M, P, Q, eps=s.eps), dot(P, P) + dot(Q, Q), dot(algebra.cross(P, Q), algebra.cross(P, Q))
    curve = -(u - v) * (u - v) * (u * u - e * e * t * u * v + e * e * e * e * d * v * v) + 2 * H * u * u * u
    curve = curve + (2 * e * t - 2 * H - e * e * G + e * e * e * d) * u * u * v + 4 * e * e * e * d * v * v * v - d
    curve = curve + (e * e * G - 2 * e * t - 5 * e * e * e * d) * u * v * v + (K - H * H - t) * u * u
    curve = curve + (t - 2 * e * G + 4 * e * e * d) * u * v - 6 * e * e * d * v * v + (G - e * d) * u + 4 * e * d * v
    pencil = gyrostat.pencil(M, P, Q, gamma=0, lam=s.lam, mu=mu, eps=s.eps)
    yield determinant(pencil), mu * curve


@stated("komarov-curve", FAMILY, dimensions=(3,))
def komarov_curve(s: Setting, M: Skew, P: Vector, nu: Lam, mu: Scalar) -> Sides:
    """nu b + m - mu S of size 7 has det/mu = (u - v)^2 (u - w v) - 2 H u^2 + (2 H - beta^2 C - kappa c^2 + gamma^2 (1 - w)) u v + (beta^2 C + kappa c^2) v^2 + K u + (beta^2 D^2 - c^2 C) v - c^2 D^2, u = nu^2, v = mu^2, w = kappa beta^2, C = |P|^2 - kappa |M|^2, D = <M, P>"""
    kappa, beta, c, gamma = (s.scalar() for _ in range(4))
    x = algebra.axial(M)
    u, v, C, D = nu * nu, mu * mu, dot(P, P) - kappa * dot(x, x), dot(x, P)
    t, constants = beta * beta, {"beta": beta, "c": c, "gamma": gamma}
    w, H, K = kappa * t, komarov.energy(M, P, **constants), komarov.komarov(M, P, kappa=kappa, **constants)
    curve = (u - v) * (u - v) * (u - w * v) - 2 * H * u * u + K * u + (t * D * D - c * c * C) * v - c * c * D * D
    curve = curve + (2 * H - t * C - kappa * c * c + gamma * gamma * (1 - w)) * u * v + (t * C + kappa * c * c) * v * v
    pencil = nu * komarov.PENCIL + komarov.skew_of(M, P, **constants) - mu * np.diag([1 + 0 * u] * 5 + [-kappa, -t])
    yield determinant(pencil), mu * curve


@stated("komarov-square", FAMILY, dimensions=(3,))
def komarov_square(M: Skew, P: Vector, kappa: Scalar, beta: Scalar, c: Scalar) -> Sides:
    """gamma = 0: (H + (kappa c^2 + beta^2 C)/2)^2 + (1 - w)(c^2 C - beta^2 D^2 - K) is Kovalevskaya's integral |(1 - w) z^2 - beta^2 y^2 - 2 k y - kappa k^2|^2/4, z = M_1 + i M_2, y = P_1 + i P_2, k = c + i beta M_3"""
    x, constants = algebra.axial(M), {"beta": beta, "c": c, "gamma": 0 * c}
    C, D, t, e = dot(P, P) - kappa * dot(x, x), dot(x, P), beta * beta, kappa * c * c
    w, H, K = kappa * t, komarov.energy(M, P, **constants), komarov.komarov(M, P, kappa=kappa, **constants)
    z, y, k = Complex(x[0], x[1]), Complex(P[0], P[1]), Complex(c, beta * x[2])
    root = (1 - w) * (z * z) - t * (y * y) - 2 * (k * y) - kappa * (k * k)
    shifted = H + (e + t * C) / 2
    square = shifted * shifted + (1 - w) * (c * c * C - t * D * D - K)
    yield (root.re * root.re + root.im * root.im) / 4, square


@stated("field-ranks", FIELDS, dimensions=(3, 4, 5), ranks=True)
def field_ranks(s: Setting) -> Sides:
    """energy and spectrum of the maps have on a leaf the rank n (n - 1)/2 in a quadratic field, half its dimension; 2 n - 3 for Kovalevskaya's tops and gyrostats, half of it for n = 3, 4; n - 1 for Lagrange's and 2, 4, 7 for Ratiu's"""
    ranks = {
        "quadratic-field": s.n * (s.n - 1) // 2,
        "kovalevskaya-top": 2 * s.n - 3,
        "kovalevskaya-gyrostat": 2 * s.n - 3,
        "symmetric-top-logarithmic": s.n - 1,
        "ratiu-top": (2, 4, 7)[s.n - 3],
    }
    for name, expected in ranks.items():
        yield leaf_rank(s.case(REGISTRY[name]), ("spectrum",)), expected
