"""Lax pairs put to the test: whether the spectrum is conserved, and whether its integrals are enough.

For matrices L(x, lambda), V(x, lambda) of a map x -> x': the residual V L(x') - L(x) V, the coefficients of
det(L(lambda) - mu) at x and x', the rank of their differentials, their brackets, and how many there are on a leaf
against half its dimension.  All modulo primes at random points, the residual also over Q.  A rank at a random point is
a lower bound that fails with probability 1/p.

The differentials are those of tr L^k, d tr L^k = k tr(L^(k-1) dL), at as many lambda as L can tell apart: they span
those of the coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, objects
from kreisel.algebra.complex import Complex
from kreisel.errors import InputError
from kreisel.lab.exact import independent, slopes
from kreisel.lab.fields import PRIMES, ROOT, Mod, Pole, fraction, random_residues, require_flint
from kreisel.lab.subject import Subject

POINTS = 6
ATTEMPTS = 5
LAMBDAS = 8  # more values of lambda than the matrix has rows


@dataclass(frozen=True)
class Lax:
    """What a Lax pair is worth.

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
    def complete(self) -> bool:
        """Whether the spectrum alone makes the map integrable in Liouville's sense."""
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


def lax(
    what: Subject,
    L: Callable[..., Array] | None = None,
    V: Callable[..., Array] | None = None,
    more: Callable[..., Array] | None = None,
    seed: int = 0,
) -> Lax:
    """Test the Lax pair of a record, or your own L(x, lam) and V(x, lam), with further integrals more(x).

    They take the coordinates x (d,) and lam as numbers of any field, and by keyword the constants of the subject.
    Raises `InputError` where there is no L, where its functions are not rational, and for shapes that do not fit.
    """
    what = replace(
        what,
        lax=L or what.lax,
        conjugator=V if L is not None else V or what.conjugator,
        integrals=more or what.integrals,
    )
    if what.lax is None:
        raise InputError(f"{what.name} has no Lax matrix: give L(x, lam), and V(x, lam) if it is known.")
    for attempt in range(ATTEMPTS):
        try:
            return _tested(what, [seed, attempt])
        except (Pole, ZeroDivisionError) as error:
            trouble = error
    raise InputError(f"The Lax pair of {what.name} divides by 0 from {ATTEMPTS} random starts ({trouble}).")


def _tested(what: Subject, seed: list[int]) -> Lax:
    equation = isospectral = None
    if not what.implicit:
        isospectral = all(_isospectral(what, seed, p) for p in PRIMES[:2])
        if what.conjugator is not None:
            equation = all(_residual(what, seed, p) for p in PRIMES[:2]) and _residual_over_q(what, seed)
    p = PRIMES[0]
    x = what.point(random_residues(np.random.default_rng([*seed, p]), p, 1))
    G = _spectral_gradients(what, x, p, seed)
    H = G if what.integrals is None else np.concatenate([G, _gradients_modulo(what, what.integrals, x, p)])
    return counted(what, x, G, H, p, equation, isospectral)


def counted(
    what: Subject, x: Array, G: Array, H: Array, p: int, equation: bool | None = None, isospectral: bool | None = None
) -> Lax:
    """Ranks and brackets of the gradients G (rows, d) at x modulo p, and of H, which has further ones."""
    if what.tensor is None:
        return Lax(
            what.name,
            what.dim,
            what.dim,
            rank_modulo(G, p),
            rank_modulo(G, p),
            rank_modulo(H, p),
            0,
            equation,
            isospectral,
            None,
        )
    tensor = _whole_residues(np.asarray(what.tensor(x), dtype=object), 1, p)[0]
    fields, more = G @ tensor % p, H @ tensor % p
    brackets, with_more = fields @ G.T % p, rank_modulo(more, p)
    return Lax(
        name=what.name,
        dimension=what.dim,
        leaf=rank_modulo(tensor, p),
        rank=rank_modulo(G, p),
        on_leaf=rank_modulo(fields, p),
        with_more=with_more,
        torus=with_more - rank_modulo(more @ H.T % p, p),
        equation=equation,
        isospectral=isospectral,
        involution=not brackets.any(),
    )


def _matrix(what: Subject, function: Any, x: Array, lam: Any, known: dict[str, Any]) -> Array:
    try:
        out = np.asarray(function(x, lam, **known), dtype=object)
    except (TypeError, AttributeError) as error:
        raise InputError(
            f"The Lax pair of {what.name} failed on exact numbers: {error}. It must be rational in the coordinates and "
            "in lam, and take the constants of the map by keyword."
        ) from error
    out = _without_complex(out, lam.p if isinstance(lam, Mod) else 0)
    if out.ndim != 2 or out.shape[0] != out.shape[1]:
        raise InputError(f"The Lax pair of {what.name} must be square matrices, got shape {out.shape}.")
    return out


def _without_complex(out: Array, p: int) -> Array:
    """Complex entries re + i im as re + r im with r^2 = -1 modulo p (1 modulo 4), which keeps all identities."""
    if not p or not any(isinstance(v, Complex) for v in out.flat):
        return out
    root = pow(ROOT, (p - 1) // 4, p)
    return objects((v.re + root * v.im if isinstance(v, Complex) else v for v in out.flat), out.shape)


def _vanishes(v: Any) -> bool:
    return bool(v.re == 0 and v.im == 0) if isinstance(v, Complex) else bool(v == 0)


def _random(what: Subject, seed: list[int], p: int) -> tuple[Array, Mod]:
    rng = np.random.default_rng([*seed, p])
    return what.point(random_residues(rng, p, POINTS)), Mod(rng.integers(1, p, POINTS), p)


def _residual(what: Subject, seed: list[int], p: int) -> bool:
    (x, lam), known = _random(what, seed, p), what.known(p)
    new = what.over(p)(x)
    V, L, L1 = (_matrix(what, f, z, lam, known) for f, z in ((what.conjugator, x), (what.lax, x), (what.lax, new)))
    if V.shape != L.shape:
        raise InputError(f"L and V of {what.name} must have one shape, got {L.shape} and {V.shape}.")
    return not any(np.any(np.asarray(getattr(v, "v", v)) % p) for v in (V @ L1 - L @ V).flat)


def _residual_over_q(what: Subject, seed: list[int]) -> bool:
    rng = np.random.default_rng(seed)

    def draw(shape: tuple[int, ...]) -> Array:
        draws = range(math.prod(shape))
        return objects((Fraction(int(rng.integers(1, 12)), int(rng.integers(1, 9))) for _ in draws), shape)

    x, lam = what.point(draw), Fraction(int(rng.integers(2, 9)), 7)
    known = {k: np.vectorize(fraction, otypes=[object])(v)[()] for k, v in what.constants.items()}
    new = what.step(x, **known)
    V, L, L1 = (_matrix(what, f, z, lam, known) for f, z in ((what.conjugator, x), (what.lax, x), (what.lax, new)))
    return all(_vanishes(v) for v in (V @ L1 - L @ V).flat)


def _isospectral(what: Subject, seed: list[int], p: int) -> bool:
    flint, (x, lam), known = require_flint(), _random(what, seed, p), what.known(p)
    both = [_whole_residues(_matrix(what, what.lax, z, lam, known), POINTS, p) for z in (x, what.over(p)(x))]

    def polynomial(M: Array) -> list[int]:
        return [int(c) for c in flint.nmod_mat(*M.shape, [int(v) for v in M.ravel()], p).charpoly().coeffs()]

    return all(polynomial(old) == polynomial(new) for old, new in zip(*both, strict=True))


def _whole_residues(x: Array, lanes: int, p: int) -> Array:
    """An array of residues at several points as whole numbers (lanes, ...)."""
    out = np.zeros((lanes, *x.shape), dtype=object)
    for place in np.ndindex(x.shape):
        value = x[place]
        out[(slice(None), *place)] = np.broadcast_to(value.v if isinstance(value, Mod) else int(value) % p, lanes)
    return out


def _spectral_gradients(what: Subject, x: Array, p: int, seed: list[int]) -> Array:
    """The gradients (rows, d) of tr L^k at many lambda."""
    known, one = what.known(p), np.ones(1, dtype=np.int64)
    size = _matrix(what, what.lax, x, Mod(one, p), known).shape[0]
    lanes = size + LAMBDAS
    lam = Mod(np.random.default_rng([*seed, p, 1]).integers(1, p, lanes), p)
    wide = objects(Mod(np.broadcast_to(v.v, lanes), p) for v in x)
    L = _matrix(what, what.lax, independent(wide), lam, known)
    values = objects((getattr(v, "value", v) for v in L.flat), L.shape)
    at, along = _whole_residues(values, lanes, p), _whole_residues(slopes(L, what.dim), lanes, p)
    power, rows = np.broadcast_to(algebra.identity(size).astype(object), at.shape), []
    for _ in range(size):
        rows.append(np.einsum("lij,ljik->lk", power, along) % p)
        power = np.einsum("lij,ljk->lik", power, at) % p
    return np.concatenate(rows)


def _gradients_modulo(what: Subject, functions: Any, x: Array, p: int) -> Array:
    out = np.ravel(np.asarray(functions(independent(x), **what.known(p)), dtype=object))
    return _whole_residues(slopes(out, what.dim), 1, p)[0]


def rank_modulo(A: Array, p: int) -> int:
    """The rank modulo p."""
    flint = require_flint()
    return int(flint.nmod_mat(*A.shape, [int(v) for v in A.ravel()], p).rank())


__all__ = ["Lax", "counted", "lax", "rank_modulo"]
