"""Formulas of paper/maps.tex: maps, curves, Lagrangians over Q, each with a mutant; the table of degrees."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest

from article import (
    EPS,
    K,
    S,
    block,
    det,
    identity,
    rational,
)
from kreisel import algebra
from kreisel.lab import growth
from kreisel.lab.subject import subject
from support import ROOT

TESTED = {  # label of a formula: its test, in one of the files test_article*.py
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


def test_every_label_of_the_article_has_its_test() -> None:
    text = (ROOT / "paper" / "maps.tex").read_text(encoding="utf-8")
    assert set(re.findall(r"\\label\{eq:(\w+)\}", text)) == set(TESTED)
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests" / "lab").glob("test_article*.py"))
    assert all(f"\ndef {name}(" in tests for name in TESTED.values())


def skew(rng: np.random.Generator, n: int) -> Any:
    A = rational(rng, n, n)
    return A - A.T


def symmetric(rng: np.random.Generator, n: int) -> Any:
    A = rational(rng, n, n)
    return A + A.T


def inverse(A: Any) -> Any:
    """By Gauss and Jordan, with rational pivots."""
    n = len(A)
    rows = [[*A[i], *identity(n)[i]] for i in range(n)]
    for i in range(n):
        pivot = next(k for k in range(i, n) if rows[k][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [v / rows[i][i] for v in rows[i]]
        for k in range(n):
            if k != i and rows[k][i] != 0:
                rows[k] = [a - rows[k][i] * b for a, b in zip(rows[k], rows[i], strict=True)]
    return np.array([row[n:] for row in rows], dtype=object)


def cay(X: Any) -> Any:
    return (identity(len(X)) + X) @ inverse(identity(len(X)) - X)


@pytest.mark.parametrize("lost", [0, 1])
def test_theorem(lost: int) -> None:
    """L' = diag(1, -c) U L V diag(1, -c^-1) at random nu, mu; not if the kick is twice as strong."""
    rng = np.random.default_rng(3)
    n = 3
    M, B, F = skew(rng, n), symmetric(rng, n), symmetric(rng, n)
    X = F @ inverse(identity(n) + S * B @ F)
    kicked = M + (1 + lost) * EPS * (X @ B - B @ X)
    c = cay(-K * kicked)
    new = c @ F @ inverse(c)

    def pencil(M: Any, F: Any, nu: Fraction, mu: Fraction) -> Any:
        first = [nu * B + M - mu * identity(n), identity(n) + K * M]
        return block([first, [-(identity(n) - K * M), nu * inverse(F) + S * (mu * identity(n) + M)]])

    nu, mu = Fraction(5, 3), Fraction(-2, 11)
    Z = block([[-K * identity(n)], [identity(n)]])
    weights = block([[identity(n), 0 * M], [0 * M, -S * identity(n)]])
    A = 2 / K * Z @ X @ Z.T
    U, V = identity(2 * n) + weights @ A / nu, identity(2 * n) - A @ weights / nu
    left, right = block([[identity(n), 0 * M], [0 * M, -c]]), block([[identity(n), 0 * M], [0 * M, -inverse(c)]])
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
            gradient[i, j] = -2 / EPS * np.trace(inverse(identity(3) + S * B @ F) @ (S * B @ unit))
    X = F @ inverse(identity(3) + S * B @ F)
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
        X = P @ D @ P.T @ inverse(identity(3) + S * B @ P @ D @ P.T)
        kicked = M + strength * EPS * (X @ B - B @ X)
        return kicked, cay(-K * kicked) @ P

    def value(M: Any, P: Any, nu: Fraction, mu: Fraction) -> Any:
        upper, lower = nu * B + M - mu * identity(3), nu * inverse(D) + S * (mu * P.T @ P + P.T @ M @ P)
        return det(block([[upper, (identity(3) + K * M) @ P], [-P.T @ (identity(3) - K * M), lower]]))

    for point in ((Fraction(5, 3), Fraction(-2, 11)), (Fraction(-1, 2), Fraction(3, 7))):
        assert value(*step(1), *point) == value(M, P, *point)
        assert value(*step(2), *point) != value(M, P, *point)


def test_tops() -> None:
    """p = 4, q = 2: the determinant of the pencil is conserved, and so is N + E^T M E."""
    rng = np.random.default_rng(5)
    p, q = 4, 2
    M, N, F = skew(rng, p), skew(rng, q), rational(rng, p, q)
    E = identity(p)[:, :q]

    def determinant(M: Any, N: Any, F: Any, nu: Fraction, mu: Fraction) -> Fraction:
        zero = 0 * F
        big, B = block([[M, zero], [zero.T, N]]), block([[0 * M, E], [E.T, 0 * N]])
        P = block([[F, zero], [0 * N, identity(q)]])
        D = -block([[0 * N, identity(q)], [identity(q), 0 * N]])
        G, square = P.T @ P, identity(p + q)
        corner = nu * D + S * mu * G + S * P.T @ big @ P
        return det(block([[nu * B + big - mu * square, (square + K * big) @ P], [-P.T @ (square - K * big), corner]]))

    free = F @ inverse(identity(q) - S * E.T @ F)
    kicked, wheel = M + EPS * (E @ free.T - free @ E.T), N + EPS * (E.T @ free - free.T @ E)
    w = cay(K * wheel)
    R = block([[w, np.zeros((q, p - q), object)], [np.zeros((p - q, q), object), identity(p - q)]])
    M1, F1 = R @ kicked @ R.T, R @ cay(-K * kicked) @ F
    for nu, mu in ((Fraction(2), Fraction(1, 3)), (Fraction(-3, 5), Fraction(7))):
        assert determinant(M1, wheel, F1, nu, mu) == determinant(M, N, F, nu, mu)
        assert determinant(kicked, wheel, F, nu, mu) != determinant(M, N, F, nu, mu)
    assert (wheel + E.T @ M1 @ E == N + E.T @ M @ E).all()


def _curve(M: Any, P: Any, nu: Fraction, mu: Fraction) -> Fraction:
    """det L/mu, one field, n = 3, gamma = 0: the pencil of size 7."""
    E = identity(3)[:, :2]
    N, zero = -M[:2, :2], np.zeros((3, 2), object)
    big, B = block([[M, zero], [zero.T, N]]), block([[0 * M, E], [E.T, 0 * N]])
    columns = np.zeros((5, 2), object)
    columns[:3, 0], columns[3, 1] = P, 1
    D = np.array([[0, -1], [-1, 0]], dtype=object)
    corner = nu * D + S * mu * columns.T @ columns + S * columns.T @ big @ columns
    square = identity(5)
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
        e = identity(3)[0]
        wedge = np.outer(e, P) - np.outer(P, e)
        kicked = M + EPS * wedge / (1 - (-S if wrong else S) * P[0])
        new = cay(-K * kicked) @ P

        def integrals(M: Any, P: Any) -> Any:
            axial, shifted = algebra.axial(M), (identity(3) + K * M) @ P
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
        Y = G @ inverse(identity(n) + sign * S * chi @ G)
        kicked = M + EPS * (Y @ chi - chi @ Y)
        c = cay(-K * kicked)
        new = c @ G @ inverse(c)

        def curve(M: Any, G: Any, nu: Fraction, mu: Fraction) -> Fraction:
            square = identity(n)
            first = [nu * chi + M - mu * square, (square + K * M) @ G]
            return det(block([first, [-(square - K * M), nu * square + S * (mu * square + M) @ G]]))

        same = [curve(kicked, new, nu, mu) == curve(M, G, nu, mu) for nu, mu in ((2, 3), (Fraction(1, 5), -7))]
        assert all(same) == (sign == 1)


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
