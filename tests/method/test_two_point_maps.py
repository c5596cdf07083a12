"""Lagrange's top, n = 3: maps by 2 x 2 matrices with two points of the spectral curve are those of "baecklund"."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kreisel import algebra
from kreisel.baecklund import lagrange_top

PAULI = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]], complex)
PLACES = np.array([0.7, 1.3, 2.1])

Vectors = tuple[np.ndarray, np.ndarray]


def lax(m: np.ndarray, a: np.ndarray, p: np.ndarray, u: complex) -> np.ndarray:  # u p + m + a/u in su(2)
    return np.einsum("i,ijk->jk", u * p + m + a / u, -0.5j * PAULI)


def two_points(m: np.ndarray, a: np.ndarray, p: np.ndarray, points: list[tuple[complex, complex]]) -> Vectors:
    """N L = L_new N, N = u + X, with the eigenvectors of L at two points (u, nu) as kernels of N."""
    vectors = []
    for u, nu in points:
        values, found = np.linalg.eig(lax(m, a, p, u))
        vectors.append(found[:, np.argmin(abs(values - nu))])
    kernels = np.array(vectors).T
    X = -kernels @ np.diag([u for u, _ in points]) @ np.linalg.inv(kernels)
    new = []
    for u in PLACES:
        N = u * np.eye(2) + X
        new.append([1j * np.trace(N @ lax(m, a, p, u) @ np.linalg.inv(N) @ s) for s in PAULI])
    field, *state = np.linalg.solve(np.stack([PLACES, 1 + 0 * PLACES, 1 / PLACES], -1), np.array(new))
    assert np.allclose(field, p, atol=1e-10) and np.allclose(np.imag(state), 0, atol=1e-9)
    return state[0].real, state[1].real


def drawn(seed: int, mu: Any) -> tuple[list[np.ndarray], Any, np.ndarray]:
    m, a, p = np.random.default_rng(seed).normal(size=(3, 3))
    rho = np.ravel(lagrange_top.curve(algebra.hat(m), a, p=p, mu=mu))[0]
    return [m, a, p], rho, lagrange_top.eigenvector(algebra.hat(m), a, p=p, mu=mu, rho=rho)


def halves(m: np.ndarray, a: np.ndarray, p: np.ndarray, u: complex, mu: complex) -> tuple[complex, complex]:
    """nu and nu' with (u, nu) and (-u, nu') on the curve, nu + nu' = mu."""
    pairs = [(x, y) for x in np.linalg.eigvals(lax(m, a, p, u)) for y in np.linalg.eigvals(lax(m, a, p, -u))]
    best = min(pairs, key=lambda pair: abs(sum(pair) - mu))
    assert abs(sum(best) - mu) < 1e-8
    return best


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_real_map_has_the_points_of_two_opposite_imaginary_numbers(seed: int) -> None:
    """D_eps is the map of the points +-i sqrt(rho); with another point it is not."""
    (m, a, p), rho, e = drawn(seed, 2 / 0.2)
    new = lagrange_top.step(algebra.hat(m), a, e, p=p)
    for scale, same in ((1.0, True), (1.1, False)):
        u = 1j * np.sqrt(scale * rho)
        nu = max(np.linalg.eigvals(lax(m, a, p, u)), key=np.real)
        found = two_points(m, a, p, [(u, nu), (-u, np.conj(nu))])
        close = [np.allclose(x, y, atol=1e-8) for x, y in zip(found, (algebra.axial(new[0]), new[1]), strict=True)]
        assert close == [same, same]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_conjugate_pair_is_a_product_of_two(seed: int) -> None:
    """D_eps and its conjugate are the real maps of (u, conj u) and (-u, -conj u), u^2 = -rho; one of them is not."""
    mu = 2 / (0.5 + 0.3j)
    (m, a, p), rho, e = drawn(seed, mu)
    new = lagrange_top.pair(algebra.hat(m), a, e, p=p)
    u = 1j * np.sqrt(rho + 0j)
    nu, other = halves(m, a, p, u, mu)
    once = two_points(m, a, p, [(u, nu), (np.conj(u), np.conj(nu))])
    twice = two_points(*once, p, [(-u, other), (-np.conj(u), np.conj(other))])
    for found, same in ((twice, True), (once, False)):
        assert np.allclose(found[0], algebra.axial(new[0]), atol=1e-8) == same
        assert np.allclose(found[1], new[1], atol=1e-8) == same
