"""Poisson brackets and volumes that a rational map preserves, and Lax pairs put to the test, by exact linear algebra.

J Pi(x) J^T = Pi(f(x)) with the Jacobian J of f, and rho(f(x)) det J = rho(x), are linear in the coefficients of Pi and
rho.  Of a Lax pair L(x, lambda), V(x, lambda) the residual V L(x') - L(x) V and the spectrum of L are tested, and the
differentials of tr L^k, d tr L^k = k tr(L^(k-1) dL), at as many lambda as L can tell apart, which span those of the
coefficients of det(L - mu).  A rank at a random point is a lower bound that fails with probability 1/p.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, objects
from kreisel.algebra.backend import Complex
from kreisel.errors import InputError, explained
from kreisel.lab import integrals, modular
from kreisel.lab.exact import Pole, independent, slopes
from kreisel.lab.integrals import MOST_MONOMIALS, SPARE, Polynomial, monomial_values, monomials, rational_kernel
from kreisel.lab.modular import PRIMES, Mod, random_residues, residues_at, without_poles
from kreisel.lab.subject import Subject, difference, differential
from kreisel.runs.settings import within


@dataclass(frozen=True)
class Bivector:
    """{x_i, x_j} for i < j, polynomials; `poisson` states whether Jacobi's identity holds."""

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


def jacobians(subject: Subject, p: int, seed: list[int], points: int) -> tuple[Array, Array, Array]:
    """x and f(x) (points, d) and df_i/dx_j (points, d, d), modulo p at random points."""
    x = subject.point(random_residues(np.random.default_rng([*seed, p]), p, points))
    new, J = differential(subject.over(p), x)
    return residues_at(x, points, p), residues_at(new, points, p), residues_at(J, points, p)


def require_invertible(subject: Subject, seed: int = 0) -> None:
    """Raises `InputError` for a rational map of free coordinates whose Jacobian determinant vanishes."""
    if subject.implicit or subject.start is not None:
        return
    p = PRIMES[0]
    _, _, (J,) = without_poles(subject.name, lambda attempt: jacobians(subject, p, [seed, attempt], 1))
    if modular.rank(J, p) < subject.dim:
        raise InputError(f"The Jacobian determinant of {subject.name} vanishes: the map is not invertible.")


def defect(subject: Subject, tensor: Callable[[Array], Array], seed: int = 0) -> float:
    """The `difference` of J Pi(x) J^T and Pi(f(x)), for tensor(x) -> Pi (d, d), at 20 points."""

    def sides(x: Array, step: Callable[[Array], Array], _: Any) -> tuple[Array, Array]:
        new, J = differential(step, x)
        return J @ np.asarray(tensor(x)) @ J.T, np.asarray(tensor(new))

    return difference(subject, sides, seed, points=20)


@explained
def brackets(subject: Subject, degree: int = 1, seed: int = 0) -> list[Bivector]:
    """A basis of the bivectors of that degree that the map preserves."""
    pairs = list(itertools.combinations(range(subject.dim), 2))
    count = _checked_count(len(pairs), subject.dim, degree)
    exponents = list(monomials(subject.dim, degree))

    def rows(p: int, seeds: list[int]) -> Array:
        x, new, J = jacobians(subject, p, seeds, -(-(count + SPARE) // len(pairs)))
        before, after = (monomial_values(v, exponents, p) for v in (x, new))
        out = np.zeros((len(x), len(pairs), len(pairs), len(exponents)), dtype=np.int64)
        for a, (i, j) in enumerate(pairs):
            for b, (k, m) in enumerate(pairs):
                minor = (J[:, i, k] * J[:, j, m] - J[:, i, m] * J[:, j, k] % p) % p
                out[:, a, b] = minor[:, None] * before % p
            out[:, a, a] = (out[:, a, a] - after) % p
        return out.reshape(-1, count)

    bivectors, p = [], PRIMES[2]
    at = random_residues(np.random.default_rng(subject.dim), p, 1)((subject.dim,))
    for terms in _lifted_kernel(subject, rows, seed, [(pair, e) for pair in pairs for e in exponents]):
        entries = {
            pair: Polynomial({e: c for (q, e), c in terms.items() if q == pair}, subject.names) for pair in pairs
        }
        bivectors.append(Bivector(entries, subject.names, is_poisson(partial(tensor_of, entries), at)))
    return bivectors


def is_poisson(tensor: Callable[[Array], Array], x: Array) -> bool:
    """Whether Pi + Pi^T = 0 and sum over the cyclic (i, j, k) of Pi_il d_l Pi_jk = 0 at a point x of residues."""
    p = x[0].p
    value, moving = (np.asarray(tensor(z), dtype=object) for z in (x, independent(x)))
    value = residues_at(value, 1, p)[0].astype(object)
    slope = residues_at(slopes(moving, len(x)), 1, p)[0].astype(object)
    total = np.einsum("il,jkl->ijk", value, slope)
    cyclic = total + total.transpose(1, 2, 0) + total.transpose(2, 0, 1)
    return not (cyclic % p).any() and not ((value + value.T) % p).any()


def obeys_jacobi(subject: Subject, tensor: Callable[[Array], Array], seed: int = 0) -> bool:
    """Whether tensor(x) is antisymmetric and obeys Jacobi's identity, at a random point modulo a prime."""

    def at(attempt: int) -> bool:
        return is_poisson(tensor, subject.point(random_residues(np.random.default_rng([seed, attempt]), PRIMES[0], 1)))

    return without_poles(f"The bracket of {subject.name}", at)


@explained
def volumes(subject: Subject, degree: int = 2, seed: int = 0) -> list[Volume]:
    """Bases of the densities rho, and of the inverse densities, of that degree that the map preserves."""
    count = _checked_count(1, subject.dim, degree)
    exponents = list(monomials(subject.dim, degree))
    densities: list[Volume] = []
    for inverse in (False, True):

        def rows(p: int, seeds: list[int], inverse: bool = inverse) -> Array:
            x, new, J = jacobians(subject, p, seeds, count + SPARE)
            before, after = (monomial_values(v, exponents, p) for v in (x, new))
            dets = np.array([int(modular.matrix(m, p).det()) for m in J])[:, None]
            return (after - before * dets) % p if inverse else (after * dets - before) % p

        for terms in _lifted_kernel(subject, rows, seed, exponents):
            rho = Polynomial(terms, subject.names)
            if rho.degree or not inverse:  # the constant is its inverse
                densities.append(Volume(rho, inverse))
    return densities


def _checked_count(pairs: int, dim: int, degree: int) -> int:
    count = pairs * math.comb(dim + within(degree, "degree", 0, 10_000), degree)
    if count > MOST_MONOMIALS:
        raise InputError(f"Degree {degree} has {count} unknowns; at most {MOST_MONOMIALS} are tried. Use a lower one.")
    return count


def _lifted_kernel(
    subject: Subject, rows: Callable[[int, list[int]], Array], seed: int, labels: list[Any]
) -> list[dict[Any, Any]]:
    return without_poles(subject.name, lambda attempt: rational_kernel(lambda p: rows(p, [seed, attempt]), labels))


def tensor_of(entries: dict[tuple[int, int], Polynomial], x: Array) -> Array:
    """{x_i, x_j} (d, d) at x (d,) of any field."""
    out = np.zeros((len(x), len(x)), dtype=object)
    for (i, j), f in entries.items():
        out[i, j] = f(x)
        out[j, i] = -out[i, j]
    return out


# -- Lax pairs ----------------------------------------------------------------------------------------

POINTS = 6
LAMBDAS = 8  # more values of lambda than the matrix has rows


@dataclass(frozen=True)
class Lax:
    """Ranks, brackets and residuals of a Lax pair.

    equation     whether V L(x') = L(x) V, exactly; None without V, or for a map that is not rational
    isospectral  whether the spectrum of L is conserved; None for a map that is not rational
    involution   whether the brackets of the coefficients vanish; None without a bracket
    rank         independent coefficients, Casimirs among them
    on_leaf      those on a generic leaf
    with_more    the same with the further integrals
    torus        dimension of the tori that the integrals in `with_more` leave
    leaf         dimension of the leaf
    """

    name: str
    dimension: int
    leaf: int
    rank: int
    on_leaf: int
    with_more: int
    torus: int
    equation: bool | None
    isospectral: bool | None
    involution: bool | None

    @property
    def needed(self) -> int:
        """Half the dimension of a leaf."""
        return self.leaf // 2

    @property
    def conserved(self) -> bool:
        """Whether the coefficients are integrals, as far as that is known."""
        return self.isospectral is not False and self.equation is not False and None in (self.involution, True)

    @property
    def enough(self) -> bool:
        """Whether integrals of these counts fill a leaf."""
        return integrals.fill_leaf(self.leaf, self.on_leaf, bool(self.involution), self.with_more + self.torus)

    @property
    def complete(self) -> bool:
        """Whether the spectrum is enough to make the map integrable in Liouville's sense."""
        return self.isospectral is True and self.involution is True and self.on_leaf == self.needed

    @property
    def superintegrable(self) -> bool:
        """Whether the orbits lie on tori that all the integrals, not in involution, leave: rank + torus = leaf."""
        commuting = self.isospectral is True and self.involution is True
        return commuting and self.torus < self.needed and self.with_more + self.torus == self.leaf

    def __str__(self) -> str:
        words = {True: "yes", False: "no", None: "unknown"}
        text = (
            f"V L' = L V: {words[self.equation]}; spectrum conserved: {words[self.isospectral]}; in involution: "
            f"{words[self.involution]}; {self.on_leaf} independent on leaves of dimension {self.leaf}, needed "
            f"{self.needed}"
        )
        if self.with_more > self.on_leaf:
            text += f"; with further integrals {self.with_more}, tori of dimension {self.torus}"
        return text


@explained
def lax(
    subject: Subject,
    L: Callable[..., Array] | None = None,
    V: Callable[..., Array] | None = None,
    more: Callable[..., Array] | None = None,
    seed: int = 0,
) -> Lax:
    """Test the Lax pair of a record, or a user-defined L(x, lam) and V(x, lam), with further integrals more(x).

    They accept the coordinates x (d,) and lam as values of any field, and by keyword the constants of the subject.
    Raises `InputError` if there is no L, where its functions are not rational, and for shapes that do not fit.
    """
    subject = replace(
        subject,
        lax=L or subject.lax,
        conjugator=V if L is not None else V or subject.conjugator,
        integrals=more or subject.integrals,
    )
    if subject.lax is None:
        raise InputError(f"{subject.name} has no Lax matrix: give L(x, lam), and V(x, lam) if it is known.")

    def at(function: Any, x: Array, old: Array, constants: dict[str, Any]) -> Array:
        lam = Mod(np.random.default_rng([seed, old[0].p]).integers(1, old[0].p, POINTS), old[0].p)
        return _matrix(subject, function, x, lam, constants)

    def conjugated(x: Array, step: Any, constants: dict[str, Any]) -> tuple[Array, Array]:
        pairs = (subject.conjugator, x), (subject.lax, x), (subject.lax, step(x))
        V, L, L1 = (at(function, z, x, constants) for function, z in pairs)
        if V.shape != L.shape:
            raise InputError(f"L and V of {subject.name} must have one shape, got {L.shape} and {V.shape}.")
        return V @ L1, L @ V

    def spectra(x: Array, step: Any, constants: dict[str, Any]) -> list[Array]:
        matrices = (residues_at(at(subject.lax, z, x, constants), POINTS, x[0].p) for z in (x, step(x)))
        polynomials = ([modular.matrix(L, x[0].p).charpoly() for L in L_of_z] for L_of_z in matrices)
        return [np.array([[*map(int, f.coeffs())] for f in several], object) for several in polynomials]

    equation = isospectral = None
    if not subject.implicit:
        isospectral = difference(subject, spectra, seed, POINTS) == 0
        equation = None if subject.conjugator is None else difference(subject, conjugated, seed, POINTS) == 0

    def ranks(attempt: int) -> Lax:
        p = PRIMES[0]
        x = subject.point(random_residues(np.random.default_rng([seed, attempt, p]), p, 1))
        G = _spectral_gradients(subject, x, p, [seed, attempt])
        further = [] if subject.integrals is None else [modular.gradients([subject.stated], x, p).astype(object)]
        return counted(subject, x, G, np.concatenate([G, *further]), p, equation, isospectral)

    return without_poles(f"The Lax pair of {subject.name}", ranks, (Pole, ZeroDivisionError))


def counted(
    subject: Subject,
    x: Array,
    G: Array,
    H: Array,
    p: int,
    equation: bool | None = None,
    isospectral: bool | None = None,
) -> Lax:
    """Ranks and brackets of the gradients G (rows, d) at x modulo p, and of H, which has further ones."""
    poisson = subject.tensor is not None
    tensor = np.eye(subject.dim, dtype=object)
    if subject.tensor is not None:
        tensor = residues_at(np.asarray(subject.tensor(x), dtype=object), 1, p)[0].astype(object)
    fields, further_fields = G @ tensor % p, H @ tensor % p
    with_more = modular.rank(further_fields, p)
    return Lax(
        name=subject.name,
        dimension=subject.dim,
        leaf=modular.rank(tensor, p),
        rank=modular.rank(G, p),
        on_leaf=modular.rank(fields, p),
        with_more=with_more,
        torus=with_more - modular.rank(further_fields @ H.T % p, p) if poisson else 0,
        equation=equation,
        isospectral=isospectral,
        involution=not (fields @ G.T % p).any() if poisson else None,
    )


def _matrix(subject: Subject, function: Any, x: Array, lam: Mod, constants: dict[str, Any]) -> Array:
    try:
        out = np.asarray(function(x, lam, **constants), dtype=object)
    except (TypeError, AttributeError) as error:
        raise InputError(
            f"The Lax pair of {subject.name} failed in exact arithmetic: {error}. It must be rational in the "
            "coordinates and in lam, and accept the constants of the map by keyword."
        ) from error
    p = lam.p  # complex entries re + i im as re + r im with r^2 = -1 modulo p (1 modulo 4), which keeps all identities
    root = pow(modular.ROOT, (p - 1) // 4, p)
    out = objects((v.re + root * v.im if isinstance(v, Complex) else v for v in out.flat), out.shape)
    if out.ndim != 2 or out.shape[0] != out.shape[1]:
        raise InputError(f"The Lax pair of {subject.name} must be square matrices, got shape {out.shape}.")
    return out


def _spectral_gradients(subject: Subject, x: Array, p: int, seed: list[int]) -> Array:
    """The gradients (rows, d) of tr L^k at many lambda."""
    constants, unit = subject.modulo(p), np.ones(1, dtype=np.int64)
    size = _matrix(subject, subject.lax, x, Mod(unit, p), constants).shape[0]
    lanes = size + LAMBDAS
    lam = Mod(np.random.default_rng([*seed, p, 1]).integers(1, p, lanes), p)
    wide = objects(Mod(np.broadcast_to(v.v, lanes), p) for v in x)
    L = _matrix(subject, subject.lax, independent(wide), lam, constants)
    values = objects((getattr(v, "value", v) for v in L.flat), L.shape)
    at, along = (residues_at(v, lanes, p).astype(object) for v in (values, slopes(L, subject.dim)))
    power, rows = np.broadcast_to(algebra.identity(size).astype(object), at.shape), []
    for _ in range(size):
        rows.append(np.einsum("lij,ljik->lk", power, along) % p)
        power = np.einsum("lij,ljk->lik", power, at) % p
    return np.concatenate(rows)
