"""Integrals of a map that can only be run in floats: monomials along its orbits, and a singular value decomposition.

Monomials up to a degree change along orbits.  Combinations that are conserved are singular vectors whose singular
values are at round-off.  A gap in the singular values separates them from combinations that only change little.
Functionally independent ones are counted by the rank of their gradients, those on a leaf and their brackets with the
bracket of the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.lab import dynamics
from kreisel.lab.integrals import monomials
from kreisel.lab.subject import Subject

STEPS = 40  # of each orbit
ROUND_OFF = 1e-10  # singular values below it, relative to the largest, are 0
GAP = 1e3  # by which the next one must be larger
MOST = 300  # monomials


@dataclass(frozen=True)
class Numerical:
    """What stands still in floats.

    count      independent integrals of degree at most `degree`; on_leaf of them on a generic leaf of dimension `leaf`
    largest    of the singular values that count as 0;  next the smallest that does not
    involution the largest bracket of two of them, relative
    """

    degree: int
    count: int
    on_leaf: int
    leaf: int
    torus: int
    largest: float
    next: float
    involution: float

    @property
    def enough(self) -> bool:
        """Whether they fill a leaf, in involution or by the dimension of the tori, with a clear gap."""
        clear = self.next > GAP * self.largest and self.leaf > 0
        commuting = self.involution < 1e-7 and 2 * self.on_leaf == self.leaf
        return clear and (commuting or self.on_leaf + self.torus == self.leaf)

    def __str__(self) -> str:
        return (
            f"{self.count} independent polynomials of degree {self.degree} or less are conserved in floats, "
            f"{self.on_leaf} on leaves of dimension {self.leaf}; singular values {self.largest:.0e}, then "
            f"{self.next:.0e}"
        )


def integrals_in_floats(what: Subject, degree: int = 2, seed: int = 0) -> Numerical:
    """Polynomial integrals up to that degree, found from orbits in floats.

    Raises `InputError` for too many monomials, and `RunError` where all orbits escape.
    """
    count = math.comb(what.dim + degree, degree)
    if count > MOST:
        raise InputError(f"Degree {degree} has {count} monomials; at most {MOST} are tried. Use a lower one.")
    exponents = np.array(list(monomials(what.dim, degree))[1:])
    rows, scale, k, trouble = [np.empty((0, len(exponents)))], np.zeros(len(exponents)), 0, ""
    wanted = 3 * len(exponents)
    while sum(map(len, rows)) < wanted and k < 3 * wanted // STEPS + 10:
        k += 1
        try:
            orbit = dynamics.points(what, dynamics.float_start(what, seed + 100 + k), STEPS)
        except RunError as error:
            trouble = str(error)
            continue
        values = np.prod(orbit[:, None, :] ** exponents[None], axis=-1)  # monomials
        rows.append(values[1:] - values[:1])
        scale = np.maximum(scale, np.abs(values).max(0))
    table = np.concatenate(rows)
    if len(table) < wanted:
        raise RunError(trouble or "the orbits are too short")
    _, sizes, V = np.linalg.svd(table / scale)
    sizes = sizes / sizes[0]
    still = int((sizes < ROUND_OFF).sum())
    vectors = V[len(sizes) - still :] / scale
    x = dynamics.float_start(what, seed + 7)
    G = vectors @ _monomial_gradients(x, exponents)
    rank = _numerical_rank(G)
    pi = np.asarray(what.tensor(x), dtype=float) if what.tensor is not None else np.zeros((what.dim, what.dim))
    fields = G @ pi
    both = fields @ G.T
    on_leaf = _numerical_rank(fields, float(np.linalg.norm(G) * np.linalg.norm(pi)))
    sized = np.linalg.norm(G, axis=1)
    return Numerical(
        degree=degree,
        count=rank,
        on_leaf=on_leaf,
        leaf=_numerical_rank(pi),
        torus=on_leaf - _numerical_rank(both, float(np.linalg.norm(G) ** 2 * np.linalg.norm(pi))),
        largest=float(sizes[len(sizes) - still]) if still else 0.0,
        next=float(sizes[len(sizes) - still - 1]),
        involution=float((np.abs(both) / np.outer(sized, sized)).max(initial=0.0)),
    )


def _monomial_gradients(x: Array, exponents: Array) -> Array:
    """d monomial / d x_i at x, (monomials, d)."""
    out = np.empty(exponents.shape)
    for i in range(len(x)):
        lower = exponents.copy()
        lower[:, i] = np.maximum(lower[:, i] - 1, 0)
        out[:, i] = exponents[:, i] * np.prod(x**lower, axis=-1)
    return out


def _numerical_rank(A: Array, scale: float | None = None) -> int:
    if not A.size:
        return 0
    sizes = np.linalg.svd(A, compute_uv=False)
    return int((sizes > 1e-7 * (scale or max(float(sizes[0]), 1e-300))).sum())
