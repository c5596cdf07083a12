"""Exact test vectors (n = 3), computed independently of this code."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.system import lagrange_top_moving


def rationals(*words: str) -> np.ndarray:
    return np.array([Fraction(word) for word in words], dtype=object)


HALF = Fraction(1, 2)
M = algebra.skew(rationals("1", "-2", "3"), 3)
U, P, A, B = (
    rationals("2/3", "-1/3", "2/3"),
    rationals("1", "2", "-1"),
    rationals("0", "0", "1"),
    rationals("1", "2", "-1"),
)
ALPHA = Fraction(7, 10)
VECTORS = {
    "rest": (kr.LagrangeTop(p=P, alpha=ALPHA), U, "11/6 -8/3 5/2", "-518/1767 781/1767 1498/1767", "20/3"),
    "intro": (kr.SymmetricTop(A=P), U, "1/6 -4/3 7/2", "1234/1623 -707/1623 -782/1623", "6"),
    "moving": (
        kr.LagrangeTopMoving(A=A, alpha=ALPHA),
        P,
        "1 -18405/7514 29164/18785",
        "-727/3757 37582/18785 7/5",
        "7",
    ),
    "clebsch": (kr.Clebsch(b=B), U, "65/73 -178/73 243/73", "24408/30037 -2349/30037 -17348/30037", "65/8"),
}


@pytest.mark.parametrize("name", VECTORS)
def test_step_and_energy(name: str) -> None:
    model, vector, momentum, carried, energy = VECTORS[name]
    new = model.step(M, vector, eps=HALF)
    assert list(algebra.coordinates(new[0])) == list(rationals(*momentum.split()))
    assert list(new[1]) == list(rationals(*carried.split()))
    for state in ((M, vector), new):
        value = model.call(model.system.energy, *state, eps=HALF)
        if name == "moving":  # the printed energy leaves out that of the spin, which is conserved by itself
            value -= (1 / ALPHA - 1) * algebra.pairing(N := algebra.project_out(state[0], A), N) / 2
        assert value == Fraction(energy)


def test_inverse_legendre_transform() -> None:
    W = algebra.cayley(lagrange_top_moving.legendre(M, P, A=A, alpha=ALPHA, eps=HALF))
    rows = ("5906/11271 8834/11271 -1/3", "742/11271 19889/56355 14/15", "563/663 -1694/3315 2/15")
    assert [list(row) for row in W] == [list(rationals(*row.split())) for row in rows]


def test_moser_veselov() -> None:
    """Given to 15 digits, from the ordered Schur form of the companion matrix."""
    top = kr.EulerTop(J=(1, 2, 3))
    M = algebra.hat(np.array([1, -0.5, 0.75]))
    expected = [0.996848217545192, -0.509970400987312, 0.747478308242998]
    assert abs(algebra.axial(top.step(M, eps=0.1)[0]) - expected).max() < 1e-14
    W = algebra.cayley(top.call(top.map.turn, M, eps=0.1)[0])
    assert abs(W[0] - [0.999608743625522, -0.0250840563919, -0.012375369987659]).max() < 1e-14
    top = kr.EulerTop(J=(1, 1.5, 2, 3))
    M = algebra.skew(np.array([0.3, -0.2, 0.5, 0.7, -0.4, 0.6]), 4)
    expected = [
        0.298773435194367,
        -0.20089139773977,
        0.503733498131275,
        0.699066643846292,
        -0.40133628939591,
        0.597381497765167,
    ]
    assert abs(algebra.coordinates(top.step(M, eps=0.1)[0]) - expected).max() < 1e-14


def test_quadratic_potential() -> None:
    """Suris's map of 2000, a general P and P = p p^T; the same source."""
    body, M = kr.QuadraticPotential(J=(1, 2, 3)), algebra.hat(np.array([1, -0.5, 0.75]))
    P = np.array([[0.5, 0.1, -0.2], [0.1, -0.3, 0.4], [-0.2, 0.4, 0.9]])
    M1, P1 = body.step(M, P, eps=0.1)
    assert abs(algebra.axial(M1) - [0.955325856866463, -0.548490674487455, 0.738356459938834]).max() < 1e-13
    expected = [0.499421326855566, 0.081934312959024, -0.186301985342634]
    expected += [-0.288306077915057, 0.426906617591963, 0.88888475105949]
    assert abs(P1[np.triu_indices(3)] - expected).max() < 1e-13
    p, p1 = np.array([0.6, 0, 0.8]), np.array([0.60913034164218, 0.000819121635865, 0.79306970433287])
    M1, P1 = body.step(M, np.outer(p, p), eps=0.1)
    assert abs(algebra.axial(M1) - [0.997109270097409, -0.413416754646482, 0.747688538623685]).max() < 1e-13
    assert abs(P1 - np.outer(p1, p1)).max() < 1e-13
    M1, P1 = kr.ClebschBody(J=(1, 2, 3)).step(M, p, eps=0.1)
    assert abs(algebra.axial(M1) - [0.997109270097409, -0.413416754646482, 0.747688538623685]).max() < 1e-13
    assert abs(P1 - p1).max() < 1e-13


def test_veselov_neumann() -> None:
    """The same source."""
    particle = kr.NeumannVeselov(b=(1, 2, -0.5))
    x1, q1 = particle.step(np.array([0.6, 0, 0.8]), np.array([0.4, 1, -0.3]), eps=0.1)
    assert abs(x1 - [0.639024483446423, 0.101015254455221, 0.762524509719773]).max() < 1e-14
    assert abs(q1 - [0.375815703487019, 1.003117392769184, -0.447835564782538]).max() < 1e-14


@pytest.mark.parametrize("n", [3, 4, 5])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_the_branch_is_that_of_a_riccati_equation(n: int, share: float) -> None:
    """Cardoso and Leite: W J = S + (eps/2) M, S the stabilising solution, at a share of the longest step."""
    from scipy.linalg import solve_continuous_are

    from kreisel.lab import exact

    draw = exact.float_random(np.random.default_rng([2, n]))
    top = exact.random_model(kr.EulerTop, n, draw)
    (M,) = kr.EulerTop.space.point(n, draw)
    eps, J = share * float(top.call(top.map.largest_step, M)), top.params["J"]
    A, one = eps / 2 * M, np.eye(n)
    W = (solve_continuous_are(-A, one, np.diag(J * J) + A @ A, one) + A) / J
    assert abs(W @ W.T - one).max() < 1e-10
    assert abs(W - algebra.cayley(top.call(top.map.turn, M, eps=eps)[0])).max() < 1e-10
