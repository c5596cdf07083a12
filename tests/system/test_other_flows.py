"""What is known of the flows that have Veselov's maps only: their relation to others, exactly or to round-off."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np

import kreisel as kr
from kreisel.lab import exact
from kreisel.system import clebsch_general


def test_clebschs_body_is_a_combination_of_two_commuting_flows() -> None:
    """n = 3: With a = J^2, H of b = J combines those of b = 1, a, a^2, with c_jk = 0, 1, a_j + a_k; exactly, n = 3."""
    a = np.array([F(1), F(4), F(25)], dtype=object)
    J = np.array([F(1), F(2), F(5)], dtype=object)
    powers = np.array([[1, s, s * s] for s in a], dtype=object)  # J = f_0 + f_1 a + f_2 a^2
    f = _solved(powers, J)
    draw = exact.rational_random(np.random.default_rng(1))
    M, P = clebsch_general.SYSTEM.space.point(3, draw)
    M, P = (np.vectorize(lambda v: F(int(v.p), int(v.q)), otypes=[object])(z) for z in (M, P))

    def energy(b: np.ndarray, c: np.ndarray) -> F:
        return clebsch_general.energy(M, P, b=b, c=c)

    def sums(b: np.ndarray) -> np.ndarray:
        return np.array([[(b[i] - b[j]) / (a[i] - a[j]) if i != j else F(0) for j in range(3)] for i in range(3)])

    body = energy(J, sums(J))
    parts = [energy(a**k, sums(a**k)) for k in range(3)]
    assert body == sum(w * h for w, h in zip(f, parts, strict=True))
    assert parts[0] == -(P * P).sum() / 2  # a Casimir
    assert body != f[1] * parts[1] + f[0] * parts[0]  # Clebsch's flow alone is not enough
    assert all(sums(J)[i, j] == 1 / (J[i] + J[j]) for i in range(3) for j in range(i))


def _solved(A: np.ndarray, b: np.ndarray) -> list[F]:
    """By Cramer's rule, 3 x 3."""
    det = lambda m: sum(  # noqa: E731
        m[0][i] * (m[1][(i + 1) % 3] * m[2][(i + 2) % 3] - m[1][(i + 2) % 3] * m[2][(i + 1) % 3]) for i in range(3)
    )
    out = []
    for k in range(3):
        rows = A.copy()
        rows[:, k] = b
        out.append(det(rows) / det(A))
    return out


def test_rosochatius_by_neumann_in_twice_the_dimension() -> None:
    """Order 12 of the lift is the motion; with other walls it is not."""
    b, mu = np.array((0.0, -0.8, -2.1)), np.array((0.1, 0.2, 0.3))
    x, q = np.array((0.6, 0.48, 0.64)), np.array((0.4, 0.9, -0.3))
    q = q - x * (x @ q)
    walls = kr.Rosochatius(b=b, mu=mu)
    direct = kr.simulate(walls, walls.state(x=x, q=q), dt=0.02, steps=50, method="veselov", order=8).x.values[-1]
    free = kr.Neumann(b=np.repeat(b, 2))
    for strength, same in ((mu, True), (2 * mu, False)):
        X, Q = np.stack([x, 0 * x], -1).ravel(), np.stack([q, strength / x], -1).ravel()
        run = kr.simulate(free, free.state(x=X, q=Q), dt=0.1, steps=10, method="baecklund", order=12)
        lifted = np.hypot(*run.x.values[-1].reshape(3, 2).T)
        assert (abs(lifted - direct).max() < 1e-11) == same
