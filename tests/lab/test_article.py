"""Every numbered formula of paper/maps.tex: over Q at random points, or in 40 digits; each with a mutant."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import kreisel as kr
from kreisel import algebra
from kreisel.lab import growth
from kreisel.lab.subject import subject
from kreisel.method import conjugate, scheme
from support import ROOT

TESTED = {  # label of a formula: the test below
    **dict.fromkeys(("kick", "turn", "pencil", "lax"), "test_theorem"),
    "rankpencil": "test_pencil_of_a_rank",
    **dict.fromkeys(("pqkick", "pqturn"), "test_tops"),
    "curve": "test_curve",
    "lagrangian": "test_lagrangian",
    "lagrange": "test_second_lagrange_top",
    **dict.fromkeys(("spkick", "spxy", "spturn", "H2", "K2"), "test_second_kovalevskaya_map"),
    **dict.fromkeys(("ratiu", "ratiucurve"), "test_ratiu"),
    "darboux": "test_darboux",
    **dict.fromkeys(("S", "abel"), "test_exact_step"),
    "unequal": "test_unequal_moments",
    "steklov": "test_steklov",
    **dict.fromkeys(("pairflow", "steklovflow"), "test_pairs_are_flows"),
    "conditions": "test_step_condition",
    "rmatrix": "test_r_matrix",
    "gcflow": "test_goryachev_chaplygin_step",
    **dict.fromkeys(("komarov", "komarovcurve"), "test_komarov_curve"),
    "komarovpair": "test_komarov_pair",
    "komarovsingle": "test_a_single_map_is_poisson",
    "bound": "test_branch_points_are_beyond_the_bound",
    "gc": "test_goryachev_chaplygin",
}
EPS = Fraction(2, 7)
K, S = EPS / 2, EPS * EPS / 4
J = np.array([[0, 1], [-1, 0]], dtype=object)


def test_every_label_of_the_article_has_its_test() -> None:
    text = (ROOT / "paper" / "maps.tex").read_text(encoding="utf-8")
    assert set(re.findall(r"\\label\{eq:(\w+)\}", text)) == set(TESTED)
    assert all(name in globals() for name in TESTED.values())


def rational(rng: np.random.Generator, *shape: int) -> Any:
    return np.array([Fraction(int(v), 13) for v in rng.integers(-9, 10, int(np.prod(shape)))], object).reshape(shape)


def skew(rng: np.random.Generator, n: int) -> Any:
    A = rational(rng, n, n)
    return A - A.T


def symmetric(rng: np.random.Generator, n: int) -> Any:
    A = rational(rng, n, n)
    return A + A.T


def one(n: int) -> Any:
    return np.array([[Fraction(i == j) for j in range(n)] for i in range(n)], dtype=object)


def inverse(A: Any) -> Any:
    """By Gauss and Jordan, with rational pivots."""
    n = len(A)
    rows = [[*A[i], *one(n)[i]] for i in range(n)]
    for i in range(n):
        pivot = next(k for k in range(i, n) if rows[k][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [v / rows[i][i] for v in rows[i]]
        for k in range(n):
            if k != i and rows[k][i] != 0:
                rows[k] = [a - rows[k][i] * b for a, b in zip(rows[k], rows[i], strict=True)]
    return np.array([row[n:] for row in rows], dtype=object)


def det(A: Any) -> Any:
    rows, value = [list(row) for row in A], Fraction(1)
    for i in range(len(rows)):
        pivot = next((k for k in range(i, len(rows)) if rows[k][i] != 0), None)
        if pivot is None:
            return Fraction(0)
        if pivot != i:
            rows[i], rows[pivot], value = rows[pivot], rows[i], -value
        value *= rows[i][i]
        for k in range(i + 1, len(rows)):
            factor = rows[k][i] / rows[i][i]
            rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return value


def cay(X: Any) -> Any:
    return (one(len(X)) + X) @ inverse(one(len(X)) - X)


def block(rows: Any) -> Any:
    return np.block([[np.asarray(entry, dtype=object) for entry in row] for row in rows])


@pytest.mark.parametrize("lost", [0, 1])
def test_theorem(lost: int) -> None:
    """L' = diag(1, -c) U L V diag(1, -c^-1) at random nu, mu; not if the kick is twice as strong."""
    rng = np.random.default_rng(3)
    n = 3
    M, B, F = skew(rng, n), symmetric(rng, n), symmetric(rng, n)
    X = F @ inverse(one(n) + S * B @ F)
    kicked = M + (1 + lost) * EPS * (X @ B - B @ X)
    c = cay(-K * kicked)
    new = c @ F @ inverse(c)

    def pencil(M: Any, F: Any, nu: Fraction, mu: Fraction) -> Any:
        first = [nu * B + M - mu * one(n), one(n) + K * M]
        return block([first, [-(one(n) - K * M), nu * inverse(F) + S * (mu * one(n) + M)]])

    nu, mu = Fraction(5, 3), Fraction(-2, 11)
    Z = block([[-K * one(n)], [one(n)]])
    weights = block([[one(n), 0 * M], [0 * M, -S * one(n)]])
    A = 2 / K * Z @ X @ Z.T
    U, V = one(2 * n) + weights @ A / nu, one(2 * n) - A @ weights / nu
    left, right = block([[one(n), 0 * M], [0 * M, -c]]), block([[one(n), 0 * M], [0 * M, -inverse(c)]])
    holds = (pencil(kicked, new, nu, mu) == left @ U @ pencil(M, F, nu, mu) @ V @ right).all()
    assert holds == (lost == 0)
    assert (A @ weights @ A @ weights == 0).all()


def test_the_kick_is_the_flow_of_its_potential() -> None:
    """M~ - M = -2 [F, dU/dF] for U = -(2/eps) tr log(1 + s B F); the other sign is the mutant."""
    rng = np.random.default_rng(4)
    B, F = symmetric(rng, 3), symmetric(rng, 3)
    gradient = 0 * F
    for i in range(3):
        for j in range(3):
            unit = 0 * F
            unit[i, j] += Fraction(1, 2)
            unit[j, i] += Fraction(1, 2)
            gradient[i, j] = -2 / EPS * np.trace(inverse(one(3) + S * B @ F) @ (S * B @ unit))
    X = F @ inverse(one(3) + S * B @ F)
    kick = EPS * (X @ B - B @ X)
    assert (-2 * (F @ gradient - gradient @ F) == kick).all()
    assert (2 * (F @ gradient - gradient @ F) != kick).any()


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_pencil_of_a_rank(rank: int) -> None:
    """The determinant is conserved with D indefinite and P' = c P; not if the kick is twice as strong."""
    rng = np.random.default_rng(5)
    M, B, P = skew(rng, 3), symmetric(rng, 3), rational(rng, 3, rank)
    D = np.diag([Fraction(v) for v in (1, -2, 3)[:rank]])

    def step(strength: int) -> tuple[Any, Any]:
        X = P @ D @ P.T @ inverse(one(3) + S * B @ P @ D @ P.T)
        kicked = M + strength * EPS * (X @ B - B @ X)
        return kicked, cay(-K * kicked) @ P

    def value(M: Any, P: Any, nu: Fraction, mu: Fraction) -> Any:
        upper, lower = nu * B + M - mu * one(3), nu * inverse(D) + S * (mu * P.T @ P + P.T @ M @ P)
        return det(block([[upper, (one(3) + K * M) @ P], [-P.T @ (one(3) - K * M), lower]]))

    for point in ((Fraction(5, 3), Fraction(-2, 11)), (Fraction(-1, 2), Fraction(3, 7))):
        assert value(*step(1), *point) == value(M, P, *point)
        assert value(*step(2), *point) != value(M, P, *point)


def test_tops() -> None:
    """p = 4, q = 2: the determinant of the pencil is conserved, and so is N + E^T M E."""
    rng = np.random.default_rng(5)
    p, q = 4, 2
    M, N, F = skew(rng, p), skew(rng, q), rational(rng, p, q)
    E = one(p)[:, :q]

    def determinant(M: Any, N: Any, F: Any, nu: Fraction, mu: Fraction) -> Fraction:
        zero = 0 * F
        big, B = block([[M, zero], [zero.T, N]]), block([[0 * M, E], [E.T, 0 * N]])
        P = block([[F, zero], [0 * N, one(q)]])
        D = -block([[0 * N, one(q)], [one(q), 0 * N]])
        G, square = P.T @ P, one(p + q)
        corner = nu * D + S * mu * G + S * P.T @ big @ P
        return det(block([[nu * B + big - mu * square, (square + K * big) @ P], [-P.T @ (square - K * big), corner]]))

    free = F @ inverse(one(q) - S * E.T @ F)
    kicked, wheel = M + EPS * (E @ free.T - free @ E.T), N + EPS * (E.T @ free - free.T @ E)
    w = cay(K * wheel)
    R = block([[w, np.zeros((q, p - q), object)], [np.zeros((p - q, q), object), one(p - q)]])
    M1, F1 = R @ kicked @ R.T, R @ cay(-K * kicked) @ F
    for nu, mu in ((Fraction(2), Fraction(1, 3)), (Fraction(-3, 5), Fraction(7))):
        assert determinant(M1, wheel, F1, nu, mu) == determinant(M, N, F, nu, mu)
        assert determinant(kicked, wheel, F, nu, mu) != determinant(M, N, F, nu, mu)
    assert (wheel + E.T @ M1 @ E == N + E.T @ M @ E).all()


def _curve(M: Any, P: Any, nu: Fraction, mu: Fraction) -> Fraction:
    """det L/mu, one field, n = 3, gamma = 0: the pencil of size 7."""
    E = one(3)[:, :2]
    N, zero = -M[:2, :2], np.zeros((3, 2), object)
    big, B = block([[M, zero], [zero.T, N]]), block([[0 * M, E], [E.T, 0 * N]])
    columns = np.zeros((5, 2), object)
    columns[:3, 0], columns[3, 1] = P, 1
    D = np.array([[0, -1], [-1, 0]], dtype=object)
    corner = nu * D + S * mu * columns.T @ columns + S * columns.T @ big @ columns
    square = one(5)
    top = [nu * B + big - mu * square, (square + K * big) @ columns]
    return det(block([top, [-columns.T @ (square - K * big), corner]])) / mu


def test_curve() -> None:
    """Two of its coefficients give H and K; the others are as printed, and H tends to Kovalevskaya's."""
    rng = np.random.default_rng(7)
    m, P = rational(rng, 3), rational(rng, 3)
    M = algebra.hat(m)
    a, c = sum(P * P), sum(m * P)
    points = [
        (Fraction(1, 2), Fraction(2, 3)),
        (Fraction(3), Fraction(-1, 5)),
        (Fraction(5, 7), Fraction(2)),
        (Fraction(1, 9), Fraction(4)),
    ]
    rows, rest = [], []
    for nu, mu in points:
        u, v = nu * nu, mu * mu
        other = (
            (u - v) ** 2 * (u - S * S * a * v)
            + (-2 * S * a + S * S * c * c) * u * v
            + (2 * S * a - S * S * c * c) * v * v
        )
        other += (a - S * c * c) * u - (a - 2 * S * c * c) * v - c * c
        rows.append([2 * (u * v - u * u), u])
        rest.append(_curve(M, P, nu, mu) - other)
    two = np.array(rows[:2], dtype=object)
    H, Q = inverse(two) @ np.array(rest[:2], dtype=object)  # Q = H^2 - K
    for row, value in zip(rows[2:], rest[2:], strict=True):
        assert row[0] * H + row[1] * Q == value
    assert H != sum(m * m) / 2 + m[2] ** 2 / 2 + P[0]
    limit = abs(float(H - (m[0] ** 2 + m[1] ** 2) / 2 - m[2] ** 2 - P[0]))
    assert limit < 2


def test_lagrangian() -> None:
    """Its slopes along W are the momenta at both ends of the rotation; that of its potential is the kick."""
    with mpmath.workdps(40):
        eps, h = mpmath.mpf("0.3"), mpmath.mpf(10) ** -15
        m, P = (
            np.array([mpmath.mpf(v) for v in row], object) for row in (("0.3", "0.5", "1.1"), ("0.4", "0.7", "-0.2"))
        )
        k, e = eps / 2, np.array([1, 0, 0], object)

        def kinetic(q: Any) -> Any:
            return -4 / eps * mpmath.log((q[0] + mpmath.sqrt(q[0] ** 2 + q[3] ** 2)) / 2)

        def product(p: Any, q: Any) -> Any:
            return np.array([p[0] * q[0] - sum(p[1:] * q[1:]), *(np.cross(p[1:], q[1:]) + p[0] * q[1:] + q[0] * p[1:])])

        def unit(*v: Any) -> Any:
            q = np.array([mpmath.mpf(1), *v], object)
            return q / mpmath.sqrt(sum(q * q))

        W = product(unit(*(k * m)), unit(0, 0, k * m[2]))
        ends = unit(0, 0, -k * m[2])
        turned = product(product(ends, np.array([0, *m], object)), ends * [1, -1, -1, -1])[1:]
        for i in range(3):
            turn = [unit(*(sign * h / 2 * np.eye(3)[i])) for sign in (1, -1)]
            first, second = (
                [kinetic(product(*pair)) for pair in pairs]
                for pairs in ([(d, W) for d in turn], [(W, d) for d in turn])
            )
            assert abs((first[0] - first[1]) / (2 * h) - m[i]) < 1e-20
            assert abs((second[0] - second[1]) / (2 * h) - turned[i]) < 1e-20
        slope = -4 / eps * (eps**2 / 4) / (1 - eps**2 / 4 * P[0]) * e  # of (4/eps) log(1 - s P_1) by P
        kick = eps * np.cross(P, e) / (1 - eps**2 / 4 * P[0])  # eps e_1 ^ P/(1 - s P_1)
        assert max(abs(np.cross(slope, P) - kick)) < 1e-30


def test_second_lagrange_top() -> None:
    rng = np.random.default_rng(12)
    m, P = rational(rng, 3), rational(rng, 3)
    M = algebra.hat(m)
    for wrong in (False, True):
        e = one(3)[0]
        wedge = np.outer(e, P) - np.outer(P, e)
        kicked = M + EPS * wedge / (1 - (-S if wrong else S) * P[0])
        new = cay(-K * kicked) @ P

        def integrals(M: Any, P: Any) -> Any:
            axial, shifted = algebra.axial(M), (one(3) + K * M) @ P
            return axial[0], sum(axial * axial) / 2 + shifted[0] - S / 2 * (shifted[1] ** 2 + shifted[2] ** 2)

        assert (integrals(kicked, new) == integrals(M, P)) == (not wrong)


def test_second_kovalevskaya_map() -> None:
    rng = np.random.default_rng(13)
    m, P = rational(rng, 3), rational(rng, 3)

    def integrals(m: Any, P: Any) -> tuple[Fraction, Fraction]:
        w2 = (m[0] ** 2 - m[1] ** 2, 2 * m[0] * m[1])  # w^2
        energy = (m[0] ** 2 + m[1] ** 2) / 2 + (1 + S * S / 4 * sum(P * P)) * m[2] ** 2 + P[0]
        energy += K * (m[1] * P[2] - 2 * m[2] * P[1])
        energy += S * ((w2[0] * P[0] + w2[1] * P[1]) / 4 - m[2] ** 2 * P[0] + m[0] * m[2] * P[2])
        a, b = 1 - S / 2 * P[0], S / 2 * P[1]  # 1 - (s/2) conj P_+
        real = (w2[0] * a - w2[1] * b) / 2 - K * m[1] * P[2] - P[0]
        imaginary = (w2[0] * b + w2[1] * a) / 2 + K * m[0] * P[2] - P[1]
        return energy, real**2 + imaginary**2

    for share in (2, 4):  # s/2 in the kick; s/4 is a mutant
        a, b = 1 - S / share * P[0], S / share * P[1]
        C = np.array([a, -b, 0], dtype=object) / (a * a + b * b)  # Re (1, i, 0)/(a - i b)
        kicked = m + EPS * np.cross(P, C)
        n = kicked[2]
        D = sum(kicked * kicked) - n * n
        x, y = 1 / (1 - S * D / 4), n / (1 + S * D / 4)
        R = cay(algebra.hat(np.array([0, 0, -K * y], dtype=object)))
        new = R @ kicked, R @ cay(-K * x * algebra.hat(kicked)) @ P
        assert (integrals(*new) == integrals(m, P)) == (share == 2)


def test_ratiu() -> None:
    rng = np.random.default_rng(17)
    n = 4
    M, G, chi = skew(rng, n), skew(rng, n), skew(rng, n)
    for sign in (1, -1):
        Y = G @ inverse(one(n) + sign * S * chi @ G)
        kicked = M + EPS * (Y @ chi - chi @ Y)
        c = cay(-K * kicked)
        new = c @ G @ inverse(c)

        def curve(M: Any, G: Any, nu: Fraction, mu: Fraction) -> Fraction:
            square = one(n)
            first = [nu * chi + M - mu * square, (square + K * M) @ G]
            return det(block([first, [-(square - K * M), nu * square + S * (mu * square + M) @ G]]))

        same = [curve(kicked, new, nu, mu) == curve(M, G, nu, mu) for nu, mu in ((2, 3), (Fraction(1, 5), -7))]
        assert all(same) == (sign == 1)


def _floats(rng: np.random.Generator, *shape: int) -> Any:
    return np.array([mpmath.mpf(v) for v in rng.standard_normal(int(np.prod(shape)))], object).reshape(shape)


def _determinant(A: Any) -> Any:
    return mpmath.det(mpmath.matrix(A.tolist()))


def _vector(A: Any, mu: Any) -> Any:
    """A vector of the kernel of A - mu, from a minor."""
    n = len(A)
    B = A - mu * np.array([[mpmath.mpf(i == j) for j in range(n)] for i in range(n)], object)
    rest = mpmath.lu_solve(mpmath.matrix(B[1:, 1:].tolist()), mpmath.matrix((-B[1:, 0]).tolist()))
    return np.array([mpmath.mpf(1), *rest], dtype=object)


def _lax(M: Any, N: Any, F: Any, lam: Any) -> Any:
    E = np.array([[mpmath.mpf(i == j) for j in range(F.shape[1])] for i in range(len(F))], object)
    G = lam * E - F / lam
    return block([[M, G], [G.T, N]])


def _darboux(M: Any, N: Any, F: Any, lam: Any, mu: Any) -> Any:
    p, q = F.shape
    E = np.array([[mpmath.mpf(i == j) for j in range(q)] for i in range(p)], object)
    v = _vector(_lax(M, N, F, lam), mu)
    x, y = v[:p] / mpmath.sqrt(sum(v[:p] * v[:p])), v[p:] / mpmath.sqrt(sum(v[p:] * v[p:]))
    Ey, Ex = E @ y, E.T @ x
    M = M + 2 * lam * (np.outer(Ey, x) - np.outer(x, Ey))
    N = N + 2 * lam * (np.outer(Ex, y) - np.outer(y, Ex))
    one_p, one_q = (np.array([[mpmath.mpf(i == j) for j in range(k)] for i in range(k)], object) for k in (p, q))
    return M, N, (one_p - 2 * np.outer(x, x)) @ F @ (one_q - 2 * np.outer(y, y)), one_q - 2 * np.outer(y, y)


def _eigenvalues(A: Any) -> list[Any]:
    """Real and positive, the largest first."""
    values = mpmath.eig(mpmath.matrix(A.tolist()), left=False, right=False)
    return sorted((v.real for v in values if abs(v.imag) < mpmath.mpf(10) ** -25 and v.real > 1e-9), reverse=True)


def test_darboux() -> None:
    with mpmath.workdps(40):
        rng = np.random.default_rng(19)
        M, N, F = algebra.hat(_floats(rng, 3)), J * mpmath.mpf("0.3"), _floats(rng, 3, 2)
        lam = mpmath.mpf(6)
        mu = _eigenvalues(_lax(M, N, F, lam))[0]
        new = _darboux(M, N, F, lam, mu)[:3]
        square = np.array([[mpmath.mpf(i == j) for j in range(5)] for i in range(5)], object)
        for sign in (1, -1):  # the projector (x; y) (x; y)^T / 2 of the article, and the nilpotent (x; y) (x; -y)^T / 2
            J5, v = np.diag([1, 1, 1, -1, -1]), _vector(_lax(M, N, F, lam), mu)
            v = v / mpmath.sqrt(sum(v[:3] * v[:3]))
            P = np.outer(v, v if sign == 1 else J5 @ v) / 2
            z, Q = mpmath.mpf("0.7"), J5 @ P @ J5
            V = square - P - Q + (z + lam) / (z - lam) * P + (z - lam) / (z + lam) * Q
            assert (abs(V @ _lax(*new, z) - _lax(M, N, F, z) @ V).max() < 1e-30) == (sign == 1)
        returned = _darboux(*new, -lam, -mu)[:3]  # the inverse
        assert max(abs(a - b).max() for a, b in zip(returned, (M, N, F), strict=True)) < 1e-25
        for point, value in ((2, 3), (mpmath.mpf("0.4"), -1)):
            before, after = (_determinant(_lax(*state, point) - value * square) for state in ((M, N, F), new))
            assert abs(before - after) < abs(before) * mpmath.mpf(10) ** -30
            wrong = _determinant(_lax(new[0], N, new[2], point) - value * square)
            assert abs(before - wrong) > 1e-6


def test_exact_step() -> None:
    """One field: constants by (abel), two maps, the rotation in the plane; against Taylor's series of the flow."""
    with mpmath.workdps(25):
        m, P = (np.array([mpmath.mpf(v) for v in row], object) for row in (("0.3", "0.5", "1.1"), ("0.6", "0", "0.8")))
        h = mpmath.mpf("0.2")
        H = (m[0] ** 2 + m[1] ** 2) / 2 + m[2] ** 2 + P[0]
        w2 = (m[0] ** 2 - m[1] ** 2) / 2 - P[0], m[0] * m[1] - P[1]
        Kov, a, c = w2[0] ** 2 + w2[1] ** 2, sum(P * P), sum(m * P)

        def r(x: Any) -> Any:
            return mpmath.sqrt(4 * Kov + 4 * (c * c - a * H) * x**2 + a * a * x**4)

        def T(x: Any, sign: int) -> Any:
            return 1 - H * x**2 + (a * x**4 + sign * r(x) * x**2) / 2

        def conditions(X0: Any, X1: Any) -> tuple[Any, Any]:
            time = mpmath.quad(lambda x: (1 + a * x * x / r(x)) / mpmath.sqrt(T(x, 1)), [0, X0])
            time += mpmath.quad(lambda x: (1 - a * x * x / r(x)) / mpmath.sqrt(T(x, -1)), [0, X1])
            first = mpmath.quad(lambda x: 1 / (r(x) * mpmath.sqrt(T(x, 1))), [0, X0])
            return time - h, first - mpmath.quad(lambda x: 1 / (r(x) * mpmath.sqrt(T(x, -1))), [0, X1])

        x0, x1 = mpmath.findroot(conditions, (h / 2, h / 2), tol=1e-40)
        M, F = algebra.hat(m), np.array([[P[0], 0], [P[1], 0], [P[2], 0]], dtype=object)
        N = -M[:2, :2]
        Y = np.array([[mpmath.mpf(1), 0], [0, mpmath.mpf(1)]], dtype=object)
        for x, place in ((x0, 0), (x1, 1)):
            mu = mpmath.sqrt(T(x, 1 - 2 * place)) / x
            mu = min(_eigenvalues(_lax(M, N, F, 1 / x)), key=lambda v, mu=mu: abs(v - mu))
            M, N, F, reflection = _darboux(M, N, F, 1 / x, mu)
            Y = Y @ reflection
        f = Y.T[:, 0]
        w = np.array([[f[0], f[1]], [-f[1], f[0]]], dtype=object)
        R = np.array([[mpmath.mpf(i == j) for j in range(3)] for i in range(3)], object)
        R[:2, :2] = w
        M, F = R @ M @ R.T, R @ F @ w.T
        exact = _flow(m, P, h)
        assert max(abs(algebra.axial(M) - exact[0])) < mpmath.mpf(10) ** -18
        assert max(abs(F[:, 0] - exact[1])) < mpmath.mpf(10) ** -18


def _flow(m: Any, P: Any, h: Any) -> Any:
    """Kovalevskaya's top by Taylor's series of order 40, four steps."""
    for _ in range(4):
        ms, ps = [m], [P]
        for k in range(40):
            dm = sum(
                (np.cross(ms[j], np.array([1, 1, 2], object) * ms[k - j]) for j in range(k + 1)), np.zeros(3, object)
            )
            dP = sum(
                (np.cross(ps[j], np.array([1, 1, 2], object) * ms[k - j]) for j in range(k + 1)), np.zeros(3, object)
            )
            dm = dm + np.cross(ps[k], np.array([1, 0, 0], object))
            ms.append(dm * h / 4 / (k + 1))
            ps.append(dP * h / 4 / (k + 1))
        m, P = sum(ms[1:], ms[0]), sum(ps[1:], ps[0])
    return m, P


def test_unequal_moments() -> None:
    with mpmath.workdps(40):
        rng = np.random.default_rng(23)
        A, M = np.diag(_floats(rng, 3)), algebra.hat(_floats(rng, 3))
        F = _floats(rng, 3, 3)
        F = F + F.T
        lam = mpmath.mpc("0.4", "1.3")
        square = np.array([[mpmath.mpf(i == j) for j in range(3)] for i in range(3)], object)
        mu = mpmath.eig(mpmath.matrix((lam * A + M + F / lam).tolist()), left=False, right=False)[0]
        q = _vector(lam * A + M + F / lam, mu)
        norm = sum(q * q)
        R, Aq = square - 2 * np.outer(q, q) / norm, A @ q
        new = M - 2 * lam / norm * (np.outer(q, Aq) - np.outer(Aq, q)), R @ F @ R
        for point, value in ((2, 3), (mpmath.mpf("0.4"), -1)):
            before = _determinant(point * A + M + F / point - value * square)
            after = _determinant(point * A + new[0] + new[1] / point - value * square)
            assert abs(before - after) < mpmath.mpf(10) ** -30
            assert abs(before - _determinant(point * A + new[0] + F / point - value * square)) > 1e-6


def test_steklov() -> None:
    """The integrals, n = 3, at a complex point."""
    with mpmath.workdps(40):
        rng = np.random.default_rng(29)
        M0, P, b = algebra.hat(_floats(rng, 3)), algebra.hat(_floats(rng, 3)), _floats(rng, 3)
        B = np.diag(b)
        s1 = mpmath.mpc("0.2", "2.5")
        square = np.array([[mpmath.mpf(i == j) for j in range(3)] for i in range(3)], object)

        def X(s: Any, M0: Any = M0, P: Any = P) -> Any:
            return M0 + s * P

        x = algebra.axial(X(s1))
        Q = sum((s1 - b) * x * x)
        mu = mpmath.sqrt(-Q / ((s1 - b[0]) * (s1 - b[1]) * (s1 - b[2])))
        q = _vector(X(s1) - mu * (s1 * square - B), mpmath.mpf(0))
        norm = sum(q * q)
        R = square - 2 * np.outer(q, q) / norm
        W = -2 * np.outer(q, q) @ (s1 * square - B) / norm
        new = R @ M0 @ R + W.T @ P @ R + R @ P @ W, R @ P @ R
        for s, value in ((2, 3), (mpmath.mpf("0.4"), -1)):
            before, after = (_determinant(X(s, *state) - value * (s * square - B)) for state in ((M0, P), new))
            assert abs(before - after) < mpmath.mpf(10) ** -30
            assert abs(before - _determinant(X(s, new[0], P) - value * (s * square - B))) > 1e-6


def test_a_single_map_of_steklov_changes_the_sign_of_a_rotor() -> None:
    """V^T e V = -e at sigma = b_i, e the matrix of the i-th axis: the residues of (sigma - B)^-1 rho."""
    b, q = (np.array([Fraction(v) for v in row], object) for row in ((1, 3, -2), (2, -1, 5)))
    point = sum(b * q * q) / sum(q * q)  # there <q, C q> = 0
    for s in (Fraction(4, 7), *b):
        C = np.diag(s - b)
        V = one(3) - 2 * np.outer(q, q) @ C / (sum(q * q) * (s - point))
        assert (V.T @ C @ V == C).all() and (V @ V == one(3)).all() and det(V) == -1
    for i, s in enumerate(b):
        V = one(3) - 2 * np.outer(q, q) @ np.diag(s - b) / (sum(q * q) * (s - point))
        axis = algebra.hat(one(3)[i])
        assert (V.T @ axis @ V == -axis).all()


def test_goryachev_chaplygin() -> None:
    rng = np.random.default_rng(32)
    M, P, g = rational(rng, 3), rational(rng, 3), Fraction(3, 5)
    P[2] = -(M[0] * P[0] + M[1] * P[1]) / M[2]
    a = sum(P * P)
    H = (M[0] ** 2 + M[1] ** 2) / 2 + 2 * M[2] ** 2 + g * M[2] + P[0]
    G = (M[2] + g / 2) * (M[0] ** 2 + M[1] ** 2) - M[0] * P[2]
    for u in (Fraction(2), Fraction(-1, 3)):
        corner = u * u - 2 * M[2] * u - (M[0] ** 2 + M[1] ** 2)
        mixed = np.array([u * P[0] - P[2] * M[0], -(u * P[1] - P[2] * M[1])], dtype=object)  # u P_- - P3 M_-
        trace = corner * (u + 2 * M[2] + g) - 2 * mixed[0]  # the imaginary parts of the two products cancel
        assert trace == u**3 + g * u * u - 2 * H * u - 2 * G
        determinant = -(P[2] ** 2) * corner - mixed[0] ** 2 - mixed[1] ** 2
        assert -determinant == a * u * u


def _komarov(m: Any, P: Any, kappa: Any, beta: Any, c: Any, gamma: Any) -> tuple[Any, Any, Any]:
    """m, b and the diagonal of S, of size 7."""
    big, b = np.zeros((2, 7, 7), dtype=object)
    n = m[2] + gamma
    big[:3, :3], big[:3, 5] = algebra.hat(m), P
    big[5, :3] = -P
    for i, j, value in ((3, 4, n), (3, 6, c), (4, 6, beta * n)):
        big[i, j], big[j, i] = value, -value
    for i, j, value in ((0, 3, 1), (1, 4, 1), (5, 6, -1)):
        b[i, j] = b[j, i] = value
    return big, b, np.diag([1, 1, 1, 1, 1, -kappa, -beta * beta])


def test_komarov_curve() -> None:
    """Over Q, and not without the rotor's term."""
    rng = np.random.default_rng(37)
    m, P, (kappa, beta, c, gamma) = rational(rng, 3), rational(rng, 3), rational(rng, 4) + Fraction(1, 7)
    big, b, weights = _komarov(m, P, kappa, beta, c, gamma)
    n, along = m[2] + gamma, sum(m * P)
    a = np.array([beta * n, -c, 0 * c], dtype=object)
    V = n * m + np.cross(a, P)
    H = (m[0] ** 2 + m[1] ** 2) / 2 + m[2] ** 2 + gamma * m[2] + c * P[0] + beta * n * P[1] - beta**2 * P[2] ** 2 / 2
    quartic = sum(V * V) - kappa * sum(a * m) ** 2
    quartic += 2 * along * (c * m[0] + beta * n * m[1] - beta**2 * n * P[2])
    w, casimir = kappa * beta**2, sum(P * P) - kappa * sum(m * m)
    for lost in (0, 1):
        for nu, mu in ((Fraction(2), Fraction(1, 3)), (Fraction(-3, 5), Fraction(7))):
            u, v = nu * nu, mu * mu
            mixed = 2 * H - beta**2 * casimir - kappa * c**2 + (1 - lost) * gamma**2 * (1 - w)
            curve = (u - v) ** 2 * (u - w * v) - 2 * H * u * u + mixed * u * v + quartic * u
            curve += (beta**2 * casimir + kappa * c**2) * v * v
            curve += (beta**2 * along**2 - c**2 * casimir) * v - c**2 * along**2
            assert (det(nu * b + big - mu * weights) == mu * curve) == (lost == 0)


def test_komarov_pair() -> None:
    """The pencil of m' has the determinant of that of m, and the column is (c, beta n) again; not for t = 0."""
    with mpmath.workdps(40):
        rng = np.random.default_rng(41)
        m, P = _floats(rng, 3), _floats(rng, 3)
        kappa, beta, c, gamma = (mpmath.mpf(v) for v in ("-0.4", "0.6", "1.3", "0.7"))
        big, b, weights = _komarov(m, P, kappa, beta, c, gamma)
        lam = mpmath.mpc("0.8", "3.1")
        x, y = lam.real, lam.imag
        ratio = mpmath.inverse(mpmath.matrix(weights.tolist())) * mpmath.matrix((lam * b + big).tolist())
        mu = min(mpmath.eig(ratio, left=False, right=False), key=lambda v: abs(v - lam))
        q = _vector(np.array(ratio.tolist(), dtype=object), mu)
        first, second = (np.array([getattr(v, part) for v in q], dtype=object) for part in ("real", "imag"))
        J7, W = np.diag([1, 1, 1, -1, -1, 1, -1]).astype(object), np.diag(weights)
        r, t = (sum(w * (first**2 + second**2)) for w in (W, W * np.diag(J7)))
        s = sum(W * q * q)
        wedge = np.outer(first, second) - np.outer(second, first)
        for lost in (0, 1):
            bend = (1 - lost) * t * x / y
            Z = r * (np.outer(first, first) + np.outer(second, second))
            Z = Z - x * np.vectorize(lambda v: v.real, otypes=[object])(mpmath.conj(s / lam) * np.outer(q, q))
            Q = Z - J7 @ Z @ J7 + bend * (wedge @ J7 - J7 @ wedge)
            Q = 4 * x * Q / (r**2 - abs(x * s / lam) ** 2 + bend**2)
            new = big + b @ Q @ weights - weights @ Q @ b
            for nu, value in ((2, 3), (mpmath.mpf("0.4"), -1)):
                before, after = (_determinant(nu * b + A - value * weights) for A in (big, new))
                assert (abs(before - after) < abs(before) * mpmath.mpf(10) ** -30) == (lost == 0)
            if not lost:
                kept = new
        places = np.ix_([3, 4, 6], [3, 4, 6])
        N = 4 * x * y / (r * y**2 + t * x**2) * wedge[places] @ weights[places]
        square = np.array([[mpmath.mpf(i == j) for j in range(3)] for i in range(3)], object)
        back = np.array(mpmath.inverse(mpmath.matrix((square - N).tolist())).tolist(), dtype=object)
        f = ((square + N) @ back).T @ np.array([mpmath.mpf(1), mpmath.mpf(0), -beta], dtype=object)
        turn = np.array([[f[0], f[1]], [-f[1], f[0]]], dtype=object) / mpmath.sqrt(f[0] ** 2 + f[1] ** 2)
        column = turn @ kept[3:5, 6] - np.array([c, beta * kept[3, 4]], dtype=object)
        assert max(abs(column)) < mpmath.mpf(10) ** -30
        assert max(abs(kept[3:5, 6] - np.array([c, beta * kept[3, 4]], dtype=object))) > 1e-3


PAIRS = (
    "clebsch-general",
    "quadratic-potential",
    "steklov-lyapunov",
    "rubanovskii",
    "kovalevskaya-gyrostat",
    "komarov",
)


def _body(name: str) -> tuple[Any, Any, Any]:
    """A model, its state, and the factor of the Hamiltonian of `rates`: of alpha/lam, of mu for Steklov's case."""
    rng = np.random.default_rng(43)
    M, P, Q = rng.normal(size=(3, 3))
    b = {"b": (0.3, 0.7, 1.9), "s": 0.4, "l": 0.7}
    model, state, factor = {
        "clebsch-general": (kr.ClebschGeneral(a=(1, 2, -0.7), b=(1, 4, 0.49)), {"M": M, "P": P}, 2),
        "quadratic-potential": (kr.QuadraticPotential(J=(1, 1.6, 2.3)), {"M": M, "P": np.outer(P, P) + np.diag(Q)}, 2),
        "steklov-lyapunov": (kr.SteklovLyapunov(**b), {"M": M, "P": P}, 2j),
        "rubanovskii": (kr.Rubanovskii(h=Q, **b), {"M": M, "P": P}, 2j),
        "komarov": (kr.Komarov(kappa=-0.4, beta=0.6, c=1.3, gamma=0.3), {"M": M, "P": P}, 4),
        "kovalevskaya-gyrostat": (kr.KovalevskayaGyrostat(n=3, gamma=0.7), {"M": M, "P": P, "Q": Q}, 4),
    }[name]
    return model, tuple(model.state(**state)[k] for k in model.system.space.letters), factor


def _levels(model: Any, z: Any, lam: Any) -> tuple[Any, Any, Any]:
    """Eigenvalues but those at infinity, left and right vectors as rows."""
    record, L = model.system.pairs, model.call(model.system.pairs.matrix, *z, lam=np.array([lam], complex))[0]
    S = np.eye(len(L)) if record.metric is None else np.diag(model.call(record.metric))
    values, left, right = scipy.linalg.eig(L.astype(complex), S, left=True)
    left, right, values = (x.T[np.isfinite(values)] for x in (left.conj(), right, values))
    return values, left / np.einsum("ij,jk,ik->i", left, S, right)[:, None], right


def _at(model: Any, z: Any, lam: Any, near: Any) -> tuple[Any, Any]:
    """The eigenvalue next to a value, and the field of the pairs there."""
    values, left, right = _levels(model, z, lam)
    place = abs(values - near).argmin()
    Pi = right[place][None, :, None] * left[place][None, None, :]
    field, _ = model.call(model.system.pairs.rates, *z, lam=np.array([lam]), Pi=Pi)
    return values[place], algebra.flatten(field, model.system.space.kinds)[0]


@pytest.mark.parametrize("name", PAIRS)
def test_pairs_are_flows(name: str) -> None:
    """The Hamiltonian of `rates`, by Poisson's tensor, at the start; and d/dx of a pair is that field at its end."""
    model, z, factor = _body(name)
    kinds, lam, h = model.system.space.kinds, 0.3 + 2.1j, 1e-5
    x, mu = algebra.flatten(z, kinds), _levels(model, z, lam)[0]
    near = mu[mu.imag.argmax()]
    slope = np.array([
        (_at(model, algebra.restore(x + h * e, kinds, 3), lam, near)[0]
         - _at(model, algebra.restore(x - h * e, kinds, 3), lam, near)[0]) / (2 * h)
        for e in np.eye(len(x))
    ])  # fmt: skip
    tensor = -np.asarray(model.call(model.system.space.tensor, *z), float)  # F' = {H, F}
    energy = np.array([
        (model.call(model.system.energy, *algebra.restore(x + h * e, kinds, 3))
         - model.call(model.system.energy, *algebra.restore(x - h * e, kinds, 3))) / (2 * h)
        for e in np.eye(len(x))
    ])  # fmt: skip
    flow = algebra.flatten(model.flow(*z), kinds)
    assert abs(tensor @ energy - flow).max() < 1e-7 * abs(flow).max()  # the sign of the bracket
    field = _at(model, z, lam, near)[1]
    right = tensor @ slope * (factor if factor == 2j else factor / lam)
    assert abs(field - right).max() < 1e-7 * abs(field).max()
    assert abs(field - 1.001 * right).max() > 1e-4 * abs(field).max()

    def moved(step: float) -> Any:
        at = lam + step
        return model.call(model.system.pairs.pair, *z, lam=np.complex128(at), mu=_at(model, z, at, near)[0])[0]

    rate = (algebra.flatten(moved(h), kinds) - algebra.flatten(moved(-h), kinds)) / (2 * h)
    expected = _at(model, moved(0.0), lam, near)[1].real
    assert abs(rate - expected).max() < 1e-7 * abs(expected).max()


@pytest.mark.parametrize("name", PAIRS)
def test_step_condition(name: str) -> None:
    """The points of a step, by 40 nodes of Gauss and Legendre, which the software does not use."""
    model, z, _ = _body(name)
    points, _ = conjugate.constants(model, z, 0.2)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for x, y, real, imaginary in points:
        near = complex(real, imaginary)
        for node, weight in zip(nodes[::-1], weights[::-1], strict=True):  # from the end of the path
            near, field = _at(model, z, 1j * y + x * (node + 1) / 2, near)
            total = total + x * weight / 2 * field.real
    flow = 0.2 * algebra.flatten(model.flow(*z), model.system.space.kinds)
    assert abs(total - flow).max() < 1e-12 * abs(flow).max()


def _images(case: str, rng: np.random.Generator) -> tuple[int, Any, Any]:
    """The dimension, the map (x, lam, near, strength) -> x' and Poisson's tensor; `near` holds the eigenvalue."""

    def level(L: Any, near: list[Any]) -> Any:
        values = mpmath.eig(mpmath.matrix(L.tolist()), left=False, right=False)
        near[:] = [near[0] if near else values[0]]
        return _vector(L, min(values, key=lambda v: abs(v - near[0])))

    if case in ("unequal", "steklov"):
        model: Any = (
            kr.QuadraticPotential(J=(1, 1.6, 2.3))
            if case == "unequal"
            else kr.Rubanovskii(b=(0.3, 0.7, 1.9), s=1, l=1, h=(0, 0, 0))
        )
        kinds, A, square = model.system.space.kinds, np.diag(_floats(rng, 3)), _square(3)

        def image(x: Any, lam: Any, near: list[Any], strength: int) -> Any:
            M, F = algebra.restore(x, kinds, 3)
            C = square if case == "unequal" else lam * square - A
            L = lam * A + M + F / lam if case == "unequal" else M - (A @ F + F @ A) / 2 + lam * F
            q = level(_inverse(C) @ L, near)
            P = np.outer(q, q) / sum(q * q)
            R = square - 2 * P
            if case == "unequal":
                return algebra.flatten((M - 2 * strength * lam * (P @ A - A @ P), R @ F @ R), kinds)
            W, F1 = -2 * strength * P @ C, R @ F @ R
            M0 = R @ (M - (A @ F + F @ A) / 2) @ R + W.T @ F @ R + R @ F @ W
            return algebra.flatten((M0 + (A @ F1 + F1 @ A) / 2, F1), kinds)

        size = 9 if case == "unequal" else 6
        return size, image, lambda x: model.call(model.system.space.tensor, *algebra.restore(x, kinds, 3))

    if case == "top":  # so(3) x so(2) and two fields, N free: Gamma = N + E^T M E is not 0

        def parts(x: Any) -> tuple[Any, Any, Any]:
            return algebra.hat(x[:3]), x[3] * J, x[4:].reshape(3, 2)

        def packed(M: Any, N: Any, F: Any) -> Any:
            return np.array([M[2, 1], M[0, 2], M[1, 0], N[0, 1], *F.ravel()], dtype=object)

        def moved(x: Any, lam: Any, near: list[Any], strength: int) -> Any:
            M, N, F = parts(x)
            v = level(_lax(M, N, F, lam), near)
            x1, y1, E, norm = v[:3], v[3:], _square(3)[:, :2], sum(v[3:] * v[3:])
            left, right = (np.outer(w, z) / norm for w, z in ((E @ y1, x1), (E.T @ x1, y1)))
            M, N = M + 2 * strength * lam * (left - left.T), N + 2 * strength * lam * (right - right.T)
            first, second = (_square(len(w)) - 2 * np.outer(w, w) / norm for w in (x1, y1))
            return packed(M, N, first @ F @ second)

        def bracket(x: Any) -> Any:  # M' = [M, U], N' = [N, V], F' = F V - U F for the linear Hamiltonians of U and V
            M, N, F = parts(x)
            out = np.zeros((10, 10), dtype=object)
            for i, axis in enumerate(_square(10)[:4]):
                U, V, _ = parts(axis)
                out[:, i] = packed(M @ U - U @ M, N @ V - V @ N, F @ V - U @ F)
            out[:4, 4:] = -out[4:, :4].T
            return out

        return 10, moved, bracket

    places = [(0, 1), (0, 2), (1, 2), (0, 5), (1, 5), (2, 5), (3, 4), (3, 6), (4, 6)]  # even under J
    _, weights, S = _komarov(_floats(rng, 3), _floats(rng, 3), mpmath.mpf("-0.4"), mpmath.mpf("0.6"), 1, 1)

    def full(x: Any) -> Any:
        m = np.zeros((7, 7), dtype=object)
        for value, (i, k) in zip(x, places, strict=True):
            m[i, k], m[k, i] = value, -value
        return m

    def single(x: Any, lam: Any, near: list[Any], strength: int) -> Any:
        q = level(_inverse(S) @ (lam * weights + full(x)), near)
        Jq = q * np.array([1, 1, 1, -1, -1, 1, -1])
        T = (np.outer(q, q) - np.outer(Jq, Jq)) @ S / (q @ S @ q)
        new = full(x) + 2 * strength * lam * (weights @ T - T.T @ weights)
        return np.array([new[place] for place in places], dtype=object)

    def manakov(x: Any) -> Any:
        m = full(x)
        return np.array(
            [
                [m[a, d] * S[b, c] - m[c, b] * S[d, a] - m[a, c] * S[b, d] + m[d, b] * S[c, a] for c, d in places]
                for a, b in places
            ],
            dtype=object,
        )

    return 9, single, manakov


def _square(n: int) -> Any:
    return np.array([[mpmath.mpf(i == j) for j in range(n)] for i in range(n)], object)


def _inverse(A: Any) -> Any:
    return np.array(mpmath.inverse(mpmath.matrix(A.tolist())).tolist(), dtype=object)


@pytest.mark.parametrize("case", ["unequal", "steklov", "top", "komarov"])
def test_a_single_map_is_poisson(case: str) -> None:
    """J Pi J^T = Pi for a single complex map, by differences in 40 digits; not for a stronger one."""
    with mpmath.workdps(40):
        size, image, tensor = _images(case, rng := np.random.default_rng(47))
        x, lam, h, near = _floats(rng, size), mpmath.mpc("0.4", "1.3"), mpmath.mpf(10) ** -14, list[Any]()
        for strength in (1, 2):
            new = image(x, lam, near, strength)
            ends = ([image(x + s * e, lam, near, strength) for s in (1, -1)] for e in h * _square(size))
            slope = np.stack([(forward - back) / (2 * h) for forward, back in ends], -1)
            miss = abs(slope @ tensor(x) @ slope.T - tensor(new)).max()
            assert (miss < 1e-20) == (strength == 1)


@pytest.mark.parametrize("field", ["none", "rank one"])
def test_pairs_make_steps_for_n_6(field: str) -> None:
    """Fields of pairs on the axis span half of a leaf, and so many pairs are the flow; not at points 1 + 1e-6 times."""
    n, h, rng = 6, 0.02, np.random.default_rng(3)
    a = np.linspace(0.5, 2, n)
    A, c = np.diag(a), 1 / np.add.outer(np.sqrt(a), np.sqrt(a))  # Omega = c M for B = sqrt(A)
    M, P = algebra.skew(rng.normal(size=15), n), rng.normal(size=n) * (field != "none")
    F, nodes, weights = np.outer(P, P), *np.polynomial.legendre.leggauss(16)

    def level(M: Any, F: Any, lam: Any, near: Any) -> tuple[Any, Any, Any]:
        values, vectors = np.linalg.eig(lam * A + M + F / lam)
        k = abs(values - near).argmin()
        q, p = vectors[:, k], np.linalg.inv(vectors)[k]
        Pi = np.outer(q, p)
        Omega = -2 / lam * (Pi - Pi.T)
        change = (-2 * ((Pi + Pi.T) @ A - A @ (Pi + Pi.T)), F @ Omega - Omega @ F)
        return values[k], np.concatenate([v.ravel() for v in change]), q

    axis = [(y, mu) for y in np.geomspace(0.4, 6, 8) for mu in np.linalg.eigvals(1j * y * A + M + F / (1j * y))]
    fields = np.stack([level(M, F, 1j * y, mu)[1].real for y, mu in axis], -1)
    fields = fields / np.linalg.norm(fields, axis=0)
    count = 6 if field == "none" else 9
    assert np.linalg.matrix_rank(fields, 1e-9) == count
    chosen = scipy.linalg.qr(fields, mode="r", pivoting=True)[1][:count]

    def rate(t: float, z: Any) -> Any:
        M, F = z.reshape(2, n, n)
        B = np.diag(np.sqrt(a))
        return np.concatenate([v.ravel() for v in (M @ (c * M) - c * M @ M + F @ B - B @ F, F @ (c * M) - c * M @ F)])

    start = np.concatenate([M.ravel(), F.ravel()])
    x, ends = np.zeros(count), np.zeros(count, complex)
    for _ in range(8):  # Newton's method for (conditions)
        total, slopes = -h * rate(0.0, start), np.empty((len(start), count))
        for j, (y, near) in enumerate(axis[i] for i in chosen):
            for node, weight in zip(nodes, weights, strict=True):
                near, v, _ = level(M, F, 1j * y + x[j] * (node + 1) / 2, near)
                total = total + weight / 2 * x[j] * v.real
            ends[j], v, _ = level(M, F, 1j * y + x[j], near)
            slopes[:, j] = v.real
        x = x - np.linalg.lstsq(slopes, total, rcond=None)[0]
    truth = scipy.integrate.solve_ivp(rate, (0, h), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    for stretch, holds in ((1.0, True), (1 + 1e-6, False)):
        state = M.astype(complex), F.astype(complex)
        for j, i in enumerate(chosen):
            for sign in (1, -1):
                lam, mu = (v if sign > 0 else v.conjugate() for v in (stretch * x[j] + 1j * axis[i][0], ends[j]))
                q = level(*state, lam, mu)[2]
                Q = np.outer(q, q) / (q @ q)
                R = np.eye(n) - 2 * Q
                state = state[0] - 2 * lam * (Q @ A - A @ Q), R @ state[1] @ R
        miss = abs(np.concatenate([v.ravel() for v in state]) - truth).max()
        assert (miss < 1e-9) == holds


def test_branch_points_are_beyond_the_bound() -> None:
    """Zeros of the discriminant of det(L - mu), n = 3, are beyond (bound); some are not twice as far."""
    rng, near = np.random.default_rng(59), list[float]()
    for _ in range(60):
        M, P, a, y = *rng.normal(size=(3, 3)), 10 ** rng.uniform(-1, 1)
        A, M, F = np.diag(a), algebra.hat(M), np.outer(P, P) + np.diag(rng.normal(size=3))
        # lam^6 times the discriminant is a polynomial of degree 12 in lam: from its values at 13 roots of 1
        circle = np.exp(2j * np.pi * np.arange(13) / 13)
        levels = (np.linalg.eigvals(lam * A + M + F / lam) for lam in circle)
        values = circle**6 * [np.prod(np.subtract.outer(mu, mu)[np.triu_indices(3, 1)] ** 2) for mu in levels]
        branches = np.roots((np.fft.fft(values) / 13)[::-1])
        half = [np.ptp(np.linalg.eigvalsh(X)) / 2 for X in (A, F)]
        gap = (
            np.diff(np.linalg.eigvalsh(y * A - 1j * M - F / y)).min() / 2
        )  # a r + f r/(y (y - r)) = gap: a quadratic equation
        roots = np.roots([-half[0] * y, half[0] * y * y + half[1] + gap * y, -gap * y * y])
        radius = min(r.real for r in roots if 0 < r.real < y)
        near.append(abs(branches - 1j * y).min() / radius)
    assert 1 <= min(near) < 2


def test_r_matrix() -> None:
    """Of both factors, by differences, for <M, P> = 0; not off that leaf, nor with the other sign of {p, b}."""
    permutation = np.zeros((4, 4))
    permutation[[0, 1, 2, 3], [0, 2, 1, 3]] = 1
    rng, h = np.random.default_rng(53), 1e-5
    M, P = rng.normal(size=(2, 3))
    P = P - M * (M @ P) / (M @ M)

    def top(x: Any, u: complex) -> Any:
        plus, minus = (x[0] + s * 1j * x[1] for s in (1, -1))
        corner = u * u - 2 * x[2] * u - plus * minus
        upper, lower = u * (x[3] - 1j * x[4]) - x[5] * minus, u * (x[3] + 1j * x[4]) - x[5] * plus
        return np.array([[corner, upper], [lower, -(x[5] ** 2)]])

    def toda(x: Any, u: complex) -> Any:
        return np.array([[u - x[0], -x[1]], [-1 / x[1], 0]])

    def misses(T: Any, x: Any, bracket: Any, u: complex = 0.7 + 0.2j, v: complex = -1.1 + 0.5j) -> bool:
        slopes = [np.array([(T(x + h * e, w) - T(x - h * e, w)) / (2 * h) for e in np.eye(len(x))]) for w in (u, v)]
        both = np.einsum("iab,ij,jcd->acbd", slopes[0], bracket, slopes[1]).reshape(4, 4)
        product = np.kron(T(x, u), T(x, v))
        want = -2j / (u - v) * (permutation @ product - product @ permutation)
        return bool(abs(both - want).max() > 1e-7 * abs(want).max())

    def bracket(M: Any, P: Any) -> Any:  # {M_1, M_2} = M_3
        return -np.block([[algebra.hat(M), algebra.hat(P)], [algebra.hat(P), np.zeros((3, 3))]])

    assert not misses(top, np.append(M, P).astype(complex), bracket(M, P))
    assert misses(top, np.append(M, P + M).astype(complex), bracket(M, P + M))
    for sign in (1, -1):
        site = np.array([0.3 + 0.1j, 0.8 - 0.4j])
        assert misses(toda, site, sign * 2j * site[1] * np.array([[0, 1], [-1, 0]])) == (sign < 0)


def test_goryachev_chaplygin_step() -> None:
    """The point of a step solves (gcflow), by 60 nodes in 1/u; the point of another does not."""
    model = kr.GoryachevChaplygin(gamma=0.3)
    M, P = (0.8, 0.5, -0.6), (0.6, 0.0, 0.8)
    z = tuple(model.state(M=M, P=P)[k] for k in model.system.space.letters)
    H = (M[0] ** 2 + M[1] ** 2) / 2 + 2 * M[2] ** 2 + 0.3 * M[2] + P[0]
    G = (M[2] + 0.15) * (M[0] ** 2 + M[1] ** 2) - M[0] * P[2]
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for step, holds in ((0.1, True), (0.2, False)):
        stages = scheme(model, "exact", step, None, False).on(z).stages
        X = complex(stages["z_re"][0], stages["z_im"][0])
        x = X * (nodes + 1) / 2
        t = 1 + 0.3 * x - 2 * H * x**2 - 2 * G * x**3  # y u^-3 is the root of t^2 - 4 |P|^2 x^4
        root = np.sqrt(t - 2 * x * x) * np.sqrt(t + 2 * x * x)
        first, second = (-(X / 2 * (weights * f).sum()).imag for f in (2 / root, 2 * x / root))
        assert (abs(first - 0.1) < 1e-14) == holds
        assert abs(second) < 1e-14


# -- the table of degrees: the maps as the article prints them, eps = 2, modulo primes ------------------------


def _plane(y: Any) -> Any:
    return algebra.hat(np.array([0 * y, 0 * y, -y], dtype=object))


def _one_field(c: Fraction) -> Any:  # c = 1; the kick has c times its strength
    def step(x: Any) -> Any:
        m, P = x[:3], x[3:]
        m = m + 2 * c * np.cross(P, np.array([1, 0, 0], dtype=object)) / (1 - P[0])
        R, P = _plane(m[2] + Fraction(3, 7)), algebra.cayley_act(-algebra.hat(m), P)
        return np.concatenate([algebra.cayley_act(R, m), algebra.cayley_act(R, P)])

    return step


def _second(share: Fraction) -> Any:  # 1/2: of s in the kick
    def step(x: Any) -> Any:
        m, P = x[:3], x[3:]
        a, b = 1 - share * P[0], share * P[1]
        m = m + 2 * np.cross(P, np.array([a, -b, 0 * a], dtype=object)) / (a * a + b * b)
        D = m[0] * m[0] + m[1] * m[1]
        P = algebra.cayley_act(-1 / (1 - D / 4) * algebra.hat(m), P)
        R = _plane(m[2] / (1 + D / 4))
        return np.concatenate([algebra.cayley_act(R, m), algebra.cayley_act(R, P)])

    return step


def _lagrange(sign: int) -> Any:
    def step(x: Any) -> Any:
        m, P = x[:3], x[3:]
        m = m + 2 * np.cross(P, np.array([1, 0, 0], dtype=object)) / (1 - sign * P[0])
        return np.concatenate([m, algebra.cayley_act(-algebra.hat(m), P)])

    return step


def _field(c: Fraction, kind: str, n: int, B: Any) -> Any:  # c = 1; F symmetric, or skew: Ratiu's top
    def step(x: Any) -> Any:
        M, F = algebra.restore(x, ("skew", kind), n)
        X = algebra.solve(algebra.identity(n) + F @ B, F)
        M = M + 2 * c * (X @ B - B @ X)
        return algebra.flatten((M, algebra.KINDS[kind].turned(-M, F)), ("skew", kind))

    return step


CHI = np.array([[0, 1, 3, -2], [-1, 0, 5, 1], [-3, -5, 0, 4], [2, -1, -4, 0]], dtype=object)
ROWS: dict[str, tuple[Any, Any, int]] = {  # first words: map, neighbour, coordinates
    "Kovalevskaya, gyrostat": (_one_field(Fraction(1)), _one_field(Fraction(1, 2)), 6),
    "Kovalevskaya, Section": (_second(Fraction(1, 2)), _second(Fraction(1)), 6),
    "Lagrange": (_lagrange(1), _lagrange(-1), 6),
    "$\\so(3)": (*(_field(Fraction(1, j), "symmetric", 3, np.diag([1, 2, 4])) for j in (1, 2)), 9),
    "Ratiu": (_field(Fraction(1), "skew", 4, CHI), None, 12),
}


def _rows_of_the_table() -> Iterator[tuple[str, list[int], list[int] | None, list[int]]]:
    """First words, degrees, coefficients of j^2, j, 1, degrees of the neighbour, as printed."""
    text = (ROOT / "paper" / "maps.tex").read_text(encoding="utf-8")
    table = text[text.index("Degrees of the iterates") :]
    for line in table[table.index("\\midrule") : table.index("\\bottomrule")].replace("\\midrule", "").splitlines():
        if line.count("&") == 2:
            name, degrees, neighbour = line.split("&")
            formula = re.search(r"=(\d+)j\^2(?:\+(\d+)j)?\+1\$", degrees)
            power = None if formula is None else [int(formula[1]), int(formula[2] or 0), 1]
            listed = [
                [int(v) for v in re.findall(r"\d+", re.sub(r"\\dots.*|.*:", "", part))] for part in (degrees, neighbour)
            ]
            yield name.strip(), listed[0], power, listed[1]


def test_the_table_of_degrees() -> None:
    rows = list(_rows_of_the_table())
    assert len(rows) == len(ROWS)
    for name, listed, power, neighbours in rows:
        step, neighbour, size = next(v for k, v in ROWS.items() if name.startswith(k))
        names = tuple(f"x{i}" for i in range(size))
        degrees = growth.degrees(subject(step, names=names), len(listed) - 1)
        assert list(degrees) == listed
        assert power is None or listed == [np.polyval(power, j) for j in range(len(listed))]
        assert (neighbours == []) == (neighbour is None)
        if neighbour is not None:
            assert list(growth.degrees(subject(neighbour, names=names), len(neighbours) - 1)) == neighbours


MEASURED = {  # first words of a row: those of a system in the results of the benchmark
    "Clebsch": "clebsch-general",
    "Manakov": "manakov-top",
    "Brun": "quadratic-potential",
    "Kovalevskaya &": "kovalevskaya-top-e3",
    "Kovalevskaya, two": "kovalevskaya-gyrostat",
    "Komarov": "komarov(kappa=-0.4",
    "Rubanovskii": "rubanovskii",
    "Steklov": "steklov-lyapunov",
    "Goryachev": "goryachev-chaplygin",
}


def test_the_table_of_exact_steps_is_that_of_the_benchmark() -> None:
    text = (ROOT / "paper" / "maps.tex").read_text(encoding="utf-8")
    results = json.loads((ROOT / "benchmarks" / "results" / "exact_pairs.json").read_text(encoding="utf-8"))["rows"]
    table = text[text.index("\\label{tab:exact}") :]
    lines = [line for line in table[: table.index("\\bottomrule")].splitlines() if line.count("&") == 5][1:]
    assert len(lines) == len(MEASURED)
    for line in lines:
        name = next(v for k, v in MEASURED.items() if line.startswith(k))
        row = next(row for row in results if row["system"].startswith(name))
        _, pairs, *values = line.rstrip("\\").split("&")
        printed = [float(v.strip(" $").replace("\\cdot10^{", "e").rstrip("}")) for v in values]
        assert "one map" in pairs or int(pairs) == row["pairs"]
        assert printed == pytest.approx([row[key] for key in ("error", "ulps", "a step", "ns")], rel=0.03, abs=0)
