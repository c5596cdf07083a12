"""Poisson brackets and volumes that a rational map preserves, found by exact linear algebra.

A bivector Pi with polynomial entries is preserved if J Pi(x) J^T = Pi(f(x)) with the Jacobian J of f; a density rho if
rho(f(x)) det J = rho(x), or 1/rho if rho(f(x)) = rho(x) det J.  All are linear in the unknown coefficients, so a null
space has them all.  Whether a bivector is a Poisson bracket is decided by Jacobi's identity.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.errors import InputError
from kreisel.lab.exact import independent, slopes
from kreisel.lab.fields import PRIMES, Mod, Pole, random_residues, require_flint
from kreisel.lab.integrals import (
    ATTEMPTS,
    MOST_MONOMIALS,
    SPARE,
    Exponents,
    Polynomial,
    monomial_values,
    monomials,
    rational_kernel,
)
from kreisel.lab.subject import Subject


@dataclass(frozen=True)
class Bivector:
    """{x_i, x_j} for i < j, polynomials; `poisson` says whether Jacobi's identity holds."""

    entries: dict[tuple[int, int], Polynomial]
    names: tuple[str, ...]
    poisson: bool

    def __str__(self) -> str:
        shown = [f"{{{self.names[i]}, {self.names[j]}}} = {f}" for (i, j), f in self.entries.items() if f.terms]
        return ", ".join(shown) + ("" if self.poisson else "   (Jacobi's identity fails)")


@dataclass(frozen=True)
class Volume:
    """A density: rho dx, or dx/rho where `inverse`."""

    rho: Polynomial
    inverse: bool

    def __str__(self) -> str:
        return f"dx / ({self.rho})" if self.inverse else f"({self.rho}) dx"


def jacobians(what: Subject, p: int, seed: list[int], points: int) -> tuple[Array, Array, Array]:
    """x and f(x) (points, d) and df_i/dx_j (points, d, d), modulo p at random points."""
    x = what.point(random_residues(np.random.default_rng([*seed, p]), p, points))
    new = what.over(p)(independent(x))
    J = slopes(new, what.dim)
    values = np.array([getattr(v, "value", v) for v in new], dtype=object)
    return _residues_at_points(x, points, p), _residues_at_points(values, points, p), _residues_at_points(J, points, p)


def _residues_at_points(x: Array, points: int, p: int) -> Array:
    out = np.zeros((points, *x.shape), dtype=np.int64)
    for place in np.ndindex(x.shape):
        v = x[place]
        out[(slice(None), *place)] = v.v if isinstance(v, Mod) else int(v) % p
    return out


def preserves(what: Subject, tensor: Callable[[Array], Array], seed: int = 0, points: int = 20) -> bool:
    """Whether J Pi(x) J^T = Pi(f(x)) at random points, for tensor(x) -> Pi (d, d)."""

    def test(p: int, seeds: list[int]) -> bool:
        x, new, J = jacobians(what, p, seeds, points)
        before, after = (_tensor_at(tensor, v, p) for v in (x, new))
        return bool((_product_modulo(_product_modulo(J, before, p), np.swapaxes(J, 1, 2), p) == after).all())

    return _without_poles(what, seed, test)


def _tensor_at(tensor: Callable[[Array], Array], x: Array, p: int) -> Array:
    numbers = objects(Mod(column, p) for column in x.T)
    return _residues_at_points(np.asarray(tensor(numbers), dtype=object), len(x), p)


def _product_modulo(A: Array, B: Array, p: int) -> Array:
    return sum(A[:, :, k, None] * B[:, None, k, :] % p for k in range(A.shape[2])) % p


def _without_poles(what: Subject, seed: int, test: Callable[[int, list[int]], Any]) -> Any:
    for attempt in range(ATTEMPTS):
        try:
            return test(PRIMES[0], [seed, attempt])
        except Pole as error:
            trouble = error
    raise InputError(f"{what.name} divides by 0 from {ATTEMPTS} random starts ({trouble}).")


def brackets(what: Subject, degree: int = 1, seed: int = 0) -> list[Bivector]:
    """A basis of the bivectors of that degree that the map preserves."""
    pairs = list(itertools.combinations(range(what.dim), 2))
    count = _checked_count(len(pairs) * math.comb(what.dim + degree, degree), degree)
    exponents = list(monomials(what.dim, degree))

    def rows(p: int, seeds: list[int]) -> Array:
        x, new, J = jacobians(what, p, seeds, -(-(count + SPARE) // len(pairs)))
        before, after = (monomial_values(v, exponents, p) for v in (x, new))
        out = np.zeros((len(x), len(pairs), len(pairs), len(exponents)), dtype=np.int64)
        for a, (i, j) in enumerate(pairs):
            for b, (k, m) in enumerate(pairs):
                minor = (J[:, i, k] * J[:, j, m] - J[:, i, m] * J[:, j, k] % p) % p
                out[:, a, b] = minor[:, None] * before % p
            out[:, a, a] = (out[:, a, a] - after) % p
        return out.reshape(-1, count)

    found = []
    for terms in _lifted_kernel(what, rows, seed, [(pair, e) for pair in pairs for e in exponents]):
        entries = {pair: Polynomial({e: c for (q, e), c in terms.items() if q == pair}, what.names) for pair in pairs}
        found.append(Bivector(entries, what.names, _jacobi(entries, what.dim)))
    return found


def volumes(what: Subject, degree: int = 2, seed: int = 0) -> list[Volume]:
    """Bases of the densities rho, and of the inverse densities, of that degree that the map preserves."""
    count = _checked_count(math.comb(what.dim + degree, degree), degree)
    exponents = list(monomials(what.dim, degree))
    found: list[Volume] = []
    for inverse in (False, True):

        def rows(p: int, seeds: list[int], inverse: bool = inverse) -> Array:
            flint = require_flint()
            x, new, J = jacobians(what, p, seeds, count + SPARE)
            before, after = (monomial_values(v, exponents, p) for v in (x, new))
            dets = np.array([int(flint.nmod_mat(*m.shape, [int(v) for v in m.ravel()], p).det()) for m in J])[:, None]
            return (after - before * dets) % p if inverse else (after * dets - before) % p

        for terms in _lifted_kernel(what, rows, seed, exponents):
            rho = Polynomial(terms, what.names)
            if rho.degree or not inverse:  # the constant is its own inverse
                found.append(Volume(rho, inverse))
    return found


def _checked_count(count: int, degree: int) -> int:
    if count > MOST_MONOMIALS:
        raise InputError(f"Degree {degree} has {count} unknowns; at most {MOST_MONOMIALS} are tried. Use a lower one.")
    return count


def _lifted_kernel(
    what: Subject, rows: Callable[[int, list[int]], Array], seed: int, labels: list[Any]
) -> list[dict[Any, Any]]:
    for attempt in range(ATTEMPTS):

        def at(p: int, attempt: int = attempt) -> Array:
            return rows(p, [seed, attempt])

        try:
            return rational_kernel(at, labels)
        except Pole as error:
            trouble = error
    raise InputError(f"{what.name} divides by 0 from {ATTEMPTS} random starts ({trouble}).")


def _jacobi(entries: dict[tuple[int, int], Polynomial], dim: int) -> bool:
    """Sum over the cyclic (i, j, k) of Pi_il d_l Pi_jk = 0, at a random point modulo a prime."""
    p = PRIMES[2]
    point = np.random.default_rng(dim).integers(1, p, dim)
    value, slope = np.zeros((dim, dim), dtype=object), np.zeros((dim, dim, dim), dtype=object)
    for (i, j), f in entries.items():
        value[i, j], slope[i, j] = f.at(point, p), np.array(f.gradient_at(point, p), dtype=object)
        value[j, i], slope[j, i] = -value[i, j], -slope[i, j]
    total = np.einsum("il,jkl->ijk", value, slope)
    return not ((total + total.transpose(1, 2, 0) + total.transpose(2, 0, 1)) % p).any()


__all__ = ["Bivector", "Exponents", "Volume", "brackets", "jacobians", "preserves", "volumes"]
