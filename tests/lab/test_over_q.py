"""The theorem in every rank, and its cases, over Q at 20 random points: Lax pairs, spectra, involution.

Mutants of the cases: tests/lab/test_mutants.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from kreisel import algebra
from kreisel.lab import exact, laws
from kreisel.lab.paper.fields import moved
from kreisel.system import REGISTRY
from kreisel.system.quadratic_field import factors_of, pencil_of, turned

POINTS = range(20)
CASES = {  # n
    "clebsch": (3, 4, 5),
    "quadratic-field": (3, 4, 5),
    "kovalevskaya-top-e3": (3,),
    "kovalevskaya-top-so3": (3,),
    "kovalevskaya-top-sp4": (3,),
    "kovalevskaya-gyrostat": (3, 4, 5),
    "symmetric-top-logarithmic": (3, 4, 5),
    "ratiu-top": (3, 4, 5),
}


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


@pytest.mark.parametrize(("name", "n"), [(name, n) for name, sizes in CASES.items() for n in sizes])
def test_pairs_spectra_and_involution(name: str, n: int) -> None:
    for law in ("discrete-lax-equation", "discrete-lax-pencil", "integrals-of-the-map", "involution"):
        seeds = POINTS[: 20 if n == 3 or law != "involution" else 1]
        for seed in seeds if laws.LAWS[law].needs(REGISTRY[name]) else ():
            assert laws.test(laws.LAWS[law], laws.make_case(REGISTRY[name], n, "exact", seed), seed).holds, law
