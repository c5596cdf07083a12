"""Hirota-Kimura bases: functions of which some combinations with constant coefficients vanish along every orbit.

With f_1, ..., f_l: sum_i c_i f_i(x_k) = 0 for all k; the coefficients depend on the orbit, so that their
ratios are integrals of the map.
Orbits then lie on the common zeros of the combinations.  The f_i are all monomials up to a degree; the coefficients are
the null space of a matrix of their values along an orbit, exact modulo a prime.  Many maps of Kahan, Hirota and
Kimura's that are integrable have such bases of degree 2 where their integrals are quotients of a high degree.
[Petrera, Pfadler, Suris 2011]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.lab.exact import independent, slopes
from kreisel.lab.fields import PRIMES, Mod, Pole, random_residues, require_flint
from kreisel.lab.integrals import Exponents, kernel, monomial_values, monomials
from kreisel.lab.lax import rank_modulo
from kreisel.lab.subject import Subject

SPARE = 12  # points more than monomials: by chance a combination vanishes on them with probability p^-SPARE
MOST_MONOMIALS = 500
ATTEMPTS = 5


@dataclass(frozen=True)
class Bases:
    """What was found at random points, the same modulo two primes.

    degree        of the monomials
    monomials     how many there are
    combinations  how many independent combinations of them vanish along an orbit
    integrals     how many functionally independent integrals the coefficients are
    """

    degree: int
    monomials: int
    combinations: int
    integrals: int

    def __str__(self) -> str:
        return (
            f"degree {self.degree}: {self.combinations} combinations of {self.monomials} monomials vanish along an "
            f"orbit; their coefficients are {self.integrals} independent integrals"
        )


def bases(what: Subject, degree: int = 2, seed: int = 0) -> Bases:
    """The combinations of monomials up to a degree that vanish along orbits, and how many integrals they give.

    Raises `InputError` for maps that are not rational, and for degrees with more than MOST_MONOMIALS monomials.
    """
    count = math.comb(what.dim + degree, degree)
    if count > MOST_MONOMIALS:
        raise InputError(
            f"Degree {degree} in {what.dim} coordinates has {count} monomials; at most {MOST_MONOMIALS} are tried. "
            "Use a lower degree."
        )
    exponents = list(monomials(what.dim, degree))
    found = {_at_a_point(what, exponents, p, seed) for p in PRIMES[:2]}
    if len(found) > 1:
        raise InputError(f"{what.name}: two primes give different counts, {found}. Use another seed.")
    combinations, rank = found.pop()
    return Bases(degree, len(exponents), combinations, rank)


def _at_a_point(what: Subject, exponents: list[Exponents], p: int, seed: int) -> tuple[int, int]:
    for attempt in range(ATTEMPTS):
        try:
            x = what.point(random_residues(np.random.default_rng([seed, attempt, p]), p, 1))
            return _counted(what, x, exponents, p)
        except (Pole, ZeroDivisionError) as error:
            trouble = error
    raise InputError(f"{what.name} divides by 0 from {ATTEMPTS} random starts ({trouble}).")


def _counted(what: Subject, x: Array, exponents: list[Exponents], p: int) -> tuple[int, int]:
    """The combinations at x, and the rank of the derivatives of their coefficients.

    With the basis in reduced form, a coefficient is a function u of x with A u = -b: A are the columns of the pivots, b
    the others.  A du = -(db + dA u).
    """
    values, derivatives = _along(what, x, exponents, p)
    null = kernel(values, p)
    if not null:
        return 0, 0
    free = [next(j for j in reversed(range(len(v))) if v[j] and all(w is v or not w[j] for w in null)) for v in null]
    pivots = [j for j in range(len(exponents)) if j not in free]
    A = values[:, pivots]
    moved: list[Array] = []
    for vector in null:
        change = _products(derivatives, np.array(vector), p)  # (points, dim)
        moved.append(_solved(A, -change % p, p))
    return len(null), rank_modulo(np.concatenate(moved), p)


def _along(what: Subject, x: Array, exponents: list[Exponents], p: int) -> tuple[Array, Array]:
    """The monomials along the orbit of x (points, l), and their derivatives by x (points, l, dim)."""
    step, moving, rows, slopes_of = what.over(p), independent(x), [], []
    for _ in range(len(exponents) + SPARE):
        here = np.array([[_whole(v.value) for v in moving]], dtype=np.int64)
        turn = np.array([[_whole(s) for s in row] for row in slopes(moving, what.dim)], dtype=np.int64)
        rows.append(monomial_values(here, exponents, p)[0])
        gradients = np.stack([_partial(here, exponents, i, p) for i in range(what.dim)], -1)
        slopes_of.append(_modular_product(gradients, turn, p))
        moving = step(moving)
    return np.array(rows), np.array(slopes_of)


def _whole(v: Any) -> int:
    return int(np.ravel(v.v)[0]) if isinstance(v, Mod) else int(v)


def _partial(point: Array, exponents: list[Exponents], i: int, p: int) -> Array:
    lower = [(*e[:i], max(e[i] - 1, 0), *e[i + 1 :]) for e in exponents]
    distinct = sorted(set(lower), key=sum)
    values = dict(zip(distinct, monomial_values(point, distinct, p)[0].tolist(), strict=True))
    return np.array([e[i] * values[low] % p for e, low in zip(exponents, lower, strict=True)], dtype=np.int64)


def _modular_product(A: Array, B: Array, p: int) -> Array:
    flint = require_flint()
    left = flint.nmod_mat(*A.shape, [int(v) for v in A.ravel()], p)
    right = flint.nmod_mat(*B.shape, [int(v) for v in B.ravel()], p)
    return np.array([[int(v) for v in row] for row in (left * right).tolist()], dtype=np.int64)


def _products(derivatives: Array, vector: Array, p: int) -> Array:
    """sum_j d(f_j) c_j (points, dim)."""
    return sum((derivatives[:, j] * int(c) % p for j, c in enumerate(vector) if c), 0 * derivatives[:, 0]) % p


def _solved(A: Array, right: Array, p: int) -> Array:
    """u (columns, dim) with A u = right, of full rank and consistent."""
    flint = require_flint()
    k, whole = A.shape[1], np.concatenate([A, right], 1)
    table, _ = flint.nmod_mat(*whole.shape, [int(v) for v in whole.ravel()], p).rref()
    return np.array([[int(table[i, k + j]) for j in range(right.shape[1])] for i in range(k)], dtype=np.int64)


__all__ = ["Bases", "bases"]
