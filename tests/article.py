"""Matrices of the formulas of paper/maps.tex, over Q or in digits of mpmath."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath
import numpy as np

from kreisel import algebra

EPS = Fraction(2, 7)
K, S = EPS / 2, EPS * EPS / 4
J = np.array([[0, 1], [-1, 0]], dtype=object)


def rational(rng: np.random.Generator, *shape: int) -> Any:
    return np.array([Fraction(int(v), 13) for v in rng.integers(-9, 10, int(np.prod(shape)))], object).reshape(shape)


def identity(n: int) -> Any:
    return np.array([[Fraction(i == j) for j in range(n)] for i in range(n)], dtype=object)


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


def block(rows: Any) -> Any:
    return np.block([[np.asarray(entry, dtype=object) for entry in row] for row in rows])


def normal(rng: np.random.Generator, *shape: int) -> Any:
    return np.array([mpmath.mpf(v) for v in rng.standard_normal(int(np.prod(shape)))], object).reshape(shape)


def null_vector(A: Any, mu: Any) -> Any:
    """A vector of the kernel of A - mu, from a minor."""
    n = len(A)
    B = A - mu * np.array([[mpmath.mpf(i == j) for j in range(n)] for i in range(n)], object)
    rest = mpmath.lu_solve(mpmath.matrix(B[1:, 1:].tolist()), mpmath.matrix((-B[1:, 0]).tolist()))
    return np.array([mpmath.mpf(1), *rest], dtype=object)


def lax_matrix(M: Any, N: Any, F: Any, lam: Any) -> Any:
    E = np.array([[mpmath.mpf(i == j) for j in range(F.shape[1])] for i in range(len(F))], object)
    G = lam * E - F / lam
    return block([[M, G], [G.T, N]])


def komarov_matrix(m: Any, P: Any, kappa: Any, beta: Any, c: Any, gamma: Any) -> tuple[Any, Any, Any]:
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
