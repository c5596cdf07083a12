"""Formulas of paper/maps.tex: Darboux matrices and single maps, over Q or in 40 digits, each with a mutant."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath
import numpy as np

from article import (
    J,
    det,
    identity,
    komarov_matrix,
    lax_matrix,
    normal,
    null_vector,
    rational,
)
from kreisel import algebra


def _determinant(A: Any) -> Any:
    return mpmath.det(mpmath.matrix(A.tolist()))


def _darboux(M: Any, N: Any, F: Any, lam: Any, mu: Any) -> Any:
    p, q = F.shape
    E = np.array([[mpmath.mpf(i == j) for j in range(q)] for i in range(p)], object)
    v = null_vector(lax_matrix(M, N, F, lam), mu)
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
        M, N, F = algebra.hat(normal(rng, 3)), J * mpmath.mpf("0.3"), normal(rng, 3, 2)
        lam = mpmath.mpf(6)
        mu = _eigenvalues(lax_matrix(M, N, F, lam))[0]
        new = _darboux(M, N, F, lam, mu)[:3]
        square = np.array([[mpmath.mpf(i == j) for j in range(5)] for i in range(5)], object)
        for sign in (1, -1):  # the projector (x; y) (x; y)^T / 2 of the article, and the nilpotent (x; y) (x; -y)^T / 2
            J5, v = np.diag([1, 1, 1, -1, -1]), null_vector(lax_matrix(M, N, F, lam), mu)
            v = v / mpmath.sqrt(sum(v[:3] * v[:3]))
            P = np.outer(v, v if sign == 1 else J5 @ v) / 2
            z, Q = mpmath.mpf("0.7"), J5 @ P @ J5
            V = square - P - Q + (z + lam) / (z - lam) * P + (z - lam) / (z + lam) * Q
            assert (abs(V @ lax_matrix(*new, z) - lax_matrix(M, N, F, z) @ V).max() < 1e-30) == (sign == 1)
        returned = _darboux(*new, -lam, -mu)[:3]  # the inverse
        assert max(abs(a - b).max() for a, b in zip(returned, (M, N, F), strict=True)) < 1e-25
        for point, value in ((2, 3), (mpmath.mpf("0.4"), -1)):
            before, after = (_determinant(lax_matrix(*state, point) - value * square) for state in ((M, N, F), new))
            assert abs(before - after) < abs(before) * mpmath.mpf(10) ** -30
            wrong = _determinant(lax_matrix(new[0], N, new[2], point) - value * square)
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
            mu = min(_eigenvalues(lax_matrix(M, N, F, 1 / x)), key=lambda v, mu=mu: abs(v - mu))
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
        A, M = np.diag(normal(rng, 3)), algebra.hat(normal(rng, 3))
        F = normal(rng, 3, 3)
        F = F + F.T
        lam = mpmath.mpc("0.4", "1.3")
        square = np.array([[mpmath.mpf(i == j) for j in range(3)] for i in range(3)], object)
        mu = mpmath.eig(mpmath.matrix((lam * A + M + F / lam).tolist()), left=False, right=False)[0]
        q = null_vector(lam * A + M + F / lam, mu)
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
        M0, P, b = algebra.hat(normal(rng, 3)), algebra.hat(normal(rng, 3)), normal(rng, 3)
        B = np.diag(b)
        s1 = mpmath.mpc("0.2", "2.5")
        square = np.array([[mpmath.mpf(i == j) for j in range(3)] for i in range(3)], object)

        def X(s: Any, M0: Any = M0, P: Any = P) -> Any:
            return M0 + s * P

        x = algebra.axial(X(s1))
        Q = sum((s1 - b) * x * x)
        mu = mpmath.sqrt(-Q / ((s1 - b[0]) * (s1 - b[1]) * (s1 - b[2])))
        q = null_vector(X(s1) - mu * (s1 * square - B), mpmath.mpf(0))
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
        V = identity(3) - 2 * np.outer(q, q) @ C / (sum(q * q) * (s - point))
        assert (V.T @ C @ V == C).all() and (V @ V == identity(3)).all() and det(V) == -1
    for i, s in enumerate(b):
        V = identity(3) - 2 * np.outer(q, q) @ np.diag(s - b) / (sum(q * q) * (s - point))
        axis = algebra.hat(identity(3)[i])
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


def test_komarov_curve() -> None:
    """Over Q, and not without the rotor's term."""
    rng = np.random.default_rng(37)
    m, P, (kappa, beta, c, gamma) = rational(rng, 3), rational(rng, 3), rational(rng, 4) + Fraction(1, 7)
    big, b, weights = komarov_matrix(m, P, kappa, beta, c, gamma)
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
        m, P = normal(rng, 3), normal(rng, 3)
        kappa, beta, c, gamma = (mpmath.mpf(v) for v in ("-0.4", "0.6", "1.3", "0.7"))
        big, b, weights = komarov_matrix(m, P, kappa, beta, c, gamma)
        lam = mpmath.mpc("0.8", "3.1")
        x, y = lam.real, lam.imag
        ratio = mpmath.inverse(mpmath.matrix(weights.tolist())) * mpmath.matrix((lam * b + big).tolist())
        mu = min(mpmath.eig(ratio, left=False, right=False), key=lambda v: abs(v - lam))
        q = null_vector(np.array(ratio.tolist(), dtype=object), mu)
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
