"""The theorem in every rank, and rational maps, over Q at random points, 20 of them in `make test-full`.

Mutants of the cases: tests/lab/test_mutants.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from kreisel import algebra
from kreisel.algebra.invariants import adjugate, determinant
from kreisel.lab import exact, laws
from kreisel.lab.paper.fields import moved
from kreisel.system import REGISTRY
from kreisel.system.quadratic_field import factors_of, pencil_of, turned
from sizes import FULL, full

POINTS = range(20 if FULL else 2)
CASES = [  # tests/lab/test_laws.py has one or two of these points
    (name, n)
    for name, system in REGISTRY.items()
    if system.map is not None and system.map.rational and system.numbers == "any"
    for n in ((3, 4, 5) if system.n is None else (system.n,))
]
EVERY = ("discrete-lax-equation", "discrete-lax-pencil", "integrals-of-the-map", "involution")


def identity_holds(n: int, rank: int, seed: int, strength: int = 1) -> bool:
    """U L' = L V for F = P D P^T of that rank, with the step of the statement `field-theorem`."""
    draw = exact.rational_random(np.random.default_rng([n, rank, seed]))
    M, P, D, B = draw((n, n)), draw((n, rank)), draw((rank, rank)), draw((n, n))
    M, D, B = M - M.T, D + D.T, B + B.T
    eps, lam, mu = draw((3,))
    after, c = moved(M, P @ D @ P.T, strength * B, eps)[1:3]
    U, V = turned(factors_of(P, P @ D, B, lam=lam, eps=eps), algebra.identity(n), algebra.identity(rank))
    old = pencil_of(M, P, P @ D, B, lam=lam, mu=mu, eps=eps)
    new = pencil_of(after, c @ P, c @ P @ D, B, lam=lam, mu=mu, eps=eps)
    return bool((U @ new == old @ V).all())


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_the_theorem_in_every_rank(n: int) -> None:
    for rank in range(1, n + 1):
        assert all(identity_holds(n, rank, seed) for seed in POINTS)
        assert not identity_holds(n, rank, 0, strength=2)


@pytest.mark.parametrize(("name", "n"), full(*CASES))
def test_pairs_spectra_and_involution(name: str, n: int) -> None:
    chosen = [law for law in map(laws.LAWS.__getitem__, EVERY) if law.needs(REGISTRY[name])]
    assert len(chosen) == 3
    for seed in POINTS:
        case = laws.make_case(REGISTRY[name], n, "exact", seed)
        for law in chosen:
            assert laws.test(law, case, seed).holds, (law.name, seed)


def test_slopes_back_and_forward() -> None:
    """d det A = tr(adj(A) dA), one value of nine entries; A dX + dA X = dB for X = A^-1 B, nine values of three."""
    A, B = (exact.rational_random(np.random.default_rng(seed))((3, 3)) for seed in (1, 2))
    moving = exact.independent(A.ravel()).reshape(3, 3)
    assert (exact.slopes(determinant(moving), 9).reshape(3, 3) == adjugate(A).T).all()
    moved = exact.independent(A[0])
    X = algebra.solve(np.concatenate([moved[None], A[1:]]), B)
    value, along = algebra.objects((x.value for x in X.flat), X.shape), exact.slopes(X, 3)
    assert (A @ value == B).all()
    for j in range(3):
        assert (A @ along[..., j] == -np.outer([1, 0, 0], value[j])).all()
