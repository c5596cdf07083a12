"""Integrals of a rational map, found unaided: polynomials and quotients of them that are constant along orbits.

Polynomials.  Monomials up to a degree, evaluated along orbits over F_p: those combinations whose values do not change
are the null space of a matrix.  Lifted to the rationals, and checked on fresh orbits modulo another prime.

Quotients P/Q.  P(x') Q(x) - P(x) Q(x') = 0 is linear in the bivector P ^ Q.  Its null space contains I ^ J for all
polynomial integrals I, J; what is more are quotients.

Integrals that are polynomials in others, or functionally dependent on them, are left out.
"""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.lab.fields import PRIMES, Pole, reconstructed, require_flint
from kreisel.lab.subject import Subject

STEPS = 6  # of each orbit: few, over many orbits, so that no integral is a constant by chance
SPARE = 30  # rows more than monomials: a false integral passes with probability p^-SPARE
MOST_MONOMIALS = 4000
ATTEMPTS = 5
Exponents = tuple[int, ...]


@dataclass(frozen=True)
class Polynomial:
    """Exponents of the coordinates -> rational coefficient."""

    terms: Mapping[Exponents, Fraction]
    names: tuple[str, ...]

    @property
    def degree(self) -> int:
        """The total degree."""
        return max((sum(e) for e in self.terms), default=0)

    def __call__(self, x: Array) -> Any:
        """The value at coordinates x (d, ...) of any numbers that multiply with fractions, or floats."""
        exact = np.asarray(x).dtype.kind == "O"
        total: Any = 0
        for exponents, c in self.terms.items():
            term: Any = c if exact else float(c)
            for i, e in enumerate(exponents):
                for _ in range(e):
                    term = x[i] * term
            total = total + term
        return total

    def at(self, point: Array, p: int) -> int:
        """The value modulo p at residues (d,)."""
        return sum(_residue(c, p) * _monomial(e, point, p) for e, c in self.terms.items()) % p

    def gradient_at(self, point: Array, p: int) -> list[int]:
        """The gradient modulo p at residues (d,)."""
        out = [0] * len(point)
        for e, c in self.terms.items():
            for i, k in enumerate(e):
                if k:
                    rest = (*e[:i], k - 1, *e[i + 1 :])
                    out[i] = (out[i] + _residue(c, p) * k * _monomial(rest, point, p)) % p
        return out

    def __str__(self) -> str:
        parts: list[str] = []
        for exponents, c in sorted(self.terms.items(), key=lambda t: (-sum(t[0]), tuple(-e for e in t[0]))):
            sign = "-" if c < 0 else "+"
            factors = [f"{n}^{e}" if e > 1 else n for n, e in zip(self.names, exponents, strict=True) if e]
            size = abs(c)
            shown = " ".join(([] if size == 1 and factors else [str(size)]) + factors)
            parts.append(f"{sign} {shown}")
        text = " ".join(parts) or "0"
        return f"-{text[2:]}" if text.startswith("- ") else text.removeprefix("+ ")


@dataclass(frozen=True)
class Quotient:
    """numerator/denominator, both polynomials."""

    numerator: Polynomial
    denominator: Polynomial

    @property
    def degree(self) -> int:
        """The larger of the degrees."""
        return max(self.numerator.degree, self.denominator.degree)

    def __call__(self, x: Array) -> Any:
        """The value at coordinates x (d, ...)."""
        return self.numerator(x) / self.denominator(x)

    def gradient_at(self, point: Array, p: int) -> list[int]:
        """The gradient modulo p at residues (d,), times the square of the denominator."""
        P, Q = (f.at(point, p) for f in (self.numerator, self.denominator))
        dP, dQ = (f.gradient_at(point, p) for f in (self.numerator, self.denominator))
        return [(a * Q - P * b) % p for a, b in zip(dP, dQ, strict=True)]

    def __str__(self) -> str:
        return f"({self.numerator}) / ({self.denominator})"


Integral = Polynomial | Quotient


def integrals(what: Subject, degree: int = 2, *, quotients: bool = False, seed: int = 0) -> list[Integral]:
    """Functionally independent polynomial integrals up to that degree; with `quotients`, also P/Q of that degree.

    They hold for the constants of the subject.  Raises `InputError` for maps that are not rational, and for degrees
    with more than MOST_MONOMIALS monomials.
    """
    count = math.comb(what.dim + degree, degree)
    if count > MOST_MONOMIALS:
        raise InputError(
            f"Degree {degree} in {what.dim} coordinates has {count} monomials; at most {MOST_MONOMIALS} are tried. "
            "Use a lower degree."
        )
    for attempt in range(ATTEMPTS):
        try:
            found = _polynomials(what, degree, [seed, attempt])
            return [*found, *_quotients(what, degree, found, [seed, attempt])] if quotients else [*found]
        except Pole as error:
            trouble = error
    raise InputError(f"{what.name} divides by 0 from {ATTEMPTS} random starts ({trouble}).")


def monomials(dim: int, degree: int) -> Iterable[Exponents]:
    """Exponents with total at most `degree`, the constant first, then by degree."""
    for total in range(degree + 1):
        for places in itertools.combinations_with_replacement(range(dim), total):
            exponents = [0] * dim
            for place in places:
                exponents[place] += 1
            yield tuple(exponents)


def _label_key(label: Any) -> Any:
    return (sum(label), label) if isinstance(label[0], int) else label


def monomial_values(points: Array, exponents: list[Exponents], p: int) -> Array:
    """Monomials (..., count) at points (..., d) modulo p."""
    zero = (0,) * points.shape[-1]
    known: dict[Exponents, Array] = {zero: np.ones(points.shape[:-1], dtype=np.int64)}
    for e in sorted(exponents, key=sum):
        if e != zero:
            first = next(i for i, k in enumerate(e) if k)
            smaller = (*e[:first], e[first] - 1, *e[first + 1 :])
            known[e] = known[smaller] * points[..., first] % p
    return np.stack([known[e] for e in exponents], -1)


def kernel(rows: Array, p: int) -> list[list[int]]:
    """A basis of the null space modulo p, each vector with a 1 where all others have 0."""
    table, pivots = _reduced(rows.tolist(), p)
    basis = []
    for j in sorted(set(range(rows.shape[1])) - set(pivots)):
        vector = [0] * rows.shape[1]
        vector[j] = 1
        for row, pivot in zip(table, pivots, strict=True):
            vector[pivot] = -row[j] % p
        basis.append(vector)
    return basis


def _polynomials(what: Subject, degree: int, seed: list[int]) -> list[Polynomial]:
    """Degree by degree, modulo the products of those found before."""
    found: list[Polynomial] = []
    for d in range(1, degree + 1):
        # leading monomials first
        exponents = sorted(list(monomials(what.dim, d))[1:], key=lambda e: (sum(e), e), reverse=True)
        products = [expanded(f) for f in _products(found, d)]

        def rows(p: int, exponents: list[Exponents] = exponents) -> Array:
            values = _along_orbits(what, exponents, seed, p, len(exponents) + SPARE)
            return (values[1:] - values[:1]).reshape(-1, len(exponents)) % p

        new = [Polynomial(terms, what.names) for terms in rational_kernel(rows, exponents, products)]
        found += _independent(what, sorted(new, key=lambda f: len(f.terms)), seed, found)
    return found


def rational_kernel(
    rows: Callable[[int], Array], labels: list[Any], modulo: list[dict[Any, Fraction]] | None = None
) -> list[dict[Any, Fraction]]:
    """A basis of the rational null space of a matrix that is known modulo primes, `modulo` vectors of it known before.

    rows(p) may belong to other points for each prime.  From two primes; the third must confirm it.
    """
    bases = []
    for p in PRIMES[:2]:
        known = [[_residue(vector.get(label, Fraction(0)), p) for label in labels] for vector in modulo or []]
        bases.append(_modulo(kernel(rows(p), p), known, p))
    if len(bases[0]) != len(bases[1]):
        raise Pole("two primes find null spaces of different size")
    found, p = [], PRIMES[2]
    third = rows(p) if bases[0] else None
    for pair in zip(*bases, strict=True):
        terms = lift({label: (a, b) for label, a, b in zip(labels, *pair, strict=True) if a or b})
        vector = np.array([_residue(terms.get(label, Fraction(0)), p) for label in labels]) if terms else None
        if vector is None or ((third * vector % p).sum(1) % p).any():
            raise InputError(
                "A result has coefficients too large to be found from two primes. Usual cause: constants that are "
                "floats such as 0.1; give whole numbers or fractions."
            )
        found.append(terms)
    return found


def _residue(c: Fraction, p: int) -> int:
    return c.numerator * pow(c.denominator, -1, p) % p


def _products(found: list[Polynomial], degree: int) -> list[list[Polynomial]]:
    """All products of integrals of total degree at most `degree`."""
    out: list[list[Polynomial]] = []
    for count in range(1, degree + 1):
        chosen = itertools.combinations_with_replacement(found, count)
        out += [list(c) for c in chosen if sum(f.degree for f in c) <= degree]
    return out


def expanded(factors: list[Polynomial]) -> dict[Exponents, Fraction]:
    """A product as terms."""
    out: dict[Exponents, Fraction] = {(0,) * len(factors[0].names): Fraction(1)}
    for f in factors:
        new: dict[Exponents, Fraction] = {}
        for (e, c), (g, d) in itertools.product(out.items(), f.terms.items()):
            both = tuple(i + j for i, j in zip(e, g, strict=True))
            new[both] = new.get(both, Fraction(0)) + c * d
        out = new
    return out


def _modulo(space: list[list[int]], known: list[list[int]], p: int) -> list[list[int]]:
    """A reduced basis of `space` modulo the span of `known`, which is a part of it."""
    known = _reduced(known, p)[0]
    leads = [next(j for j, v in enumerate(row) if v) for row in known]
    rest = []
    for vector in space:
        for row, lead in zip(known, leads, strict=True):
            factor = vector[lead]
            if factor:
                vector = [(v - factor * w) % p for v, w in zip(vector, row, strict=True)]
        rest.append(vector)
    return _reduced(rest, p)[0]


def _reduced(rows: list[list[int]], p: int) -> tuple[list[list[int]], list[int]]:
    """The reduced echelon form without its rows of zeros, and where its pivots stand."""
    if not rows:
        return [], []
    flint = require_flint()
    reduced, rank = flint.nmod_mat(len(rows), len(rows[0]), [int(v) for row in rows for v in row], p).rref()
    table = [[int(v) for v in row] for row in reduced.tolist()[:rank]]
    return table, [next(j for j, v in enumerate(row) if v) for row in table]


def lift(terms: dict[Any, tuple[int, int]]) -> dict[Any, Fraction]:
    """Rational numbers from residues modulo two primes, whole without a common factor; {} where they are too large."""
    p, q = PRIMES[:2]
    out = {}
    for label, (a, b) in terms.items():
        c = reconstructed((a + p * ((b - a) * pow(p, -1, q) % q)) % (p * q), p * q)
        if c is None:
            return {}
        out[label] = c
    return _primitive(out)


def _primitive(terms: dict[Any, Fraction]) -> dict[Any, Fraction]:
    """Scaled so that the coefficients are whole without a common factor, the largest label's positive."""
    scale = Fraction(math.lcm(*(c.denominator for c in terms.values())), 1)
    scale /= math.gcd(*(int(c * scale) for c in terms.values()))
    leading = max(terms, key=_label_key)
    return {e: c * scale * (1 if terms[leading] > 0 else -1) for e, c in terms.items()}


def _along_orbits(what: Subject, exponents: list[Exponents], seed: list[int], p: int, rows: int) -> Array:
    lanes = -(-rows // STEPS)
    points = np.moveaxis(what.orbits(p, seed[0] * 1000 + seed[1], lanes, STEPS), 1, -1)
    return monomial_values(points, exponents, p)


def _independent(what: Subject, found: list[Any], seed: list[int], known: list[Any] | None = None) -> list[Any]:
    """Those whose gradients raise the rank at a random point, modulo a prime."""
    flint, p = require_flint(), PRIMES[2]
    point = what.orbits(p, seed[0] * 1000 + seed[1] + 500, 1, 0)[0, :, 0]
    kept: list[Any] = []
    rows = [f.gradient_at(point, p) for f in known or []]
    rank = flint.nmod_mat(len(rows), what.dim, functools.reduce(operator.iadd, rows, []), p).rank() if rows else 0
    for f in found:
        more = [*rows, f.gradient_at(point, p)]
        new = flint.nmod_mat(len(more), what.dim, functools.reduce(operator.iadd, more, []), p).rank()
        if new > rank:
            kept, rows, rank = [*kept, f], more, new
    return kept


def independent(what: Subject, found: list[Any], seed: int = 0) -> list[Any]:
    """The first of functions that are conserved, less those that depend on them."""
    for attempt in range(ATTEMPTS):
        try:
            return _independent(what, found, [seed, attempt])
        except (Pole, ValueError) as error:  # pow() of 0
            trouble = error
    raise InputError(f"{what.name} divides by 0 from {ATTEMPTS} random starts ({trouble}).")


def _monomial(e: Exponents, point: Array, p: int) -> int:
    out = 1
    for k, v in zip(e, point, strict=True):
        out = out * pow(int(v), k, p) % p
    return out


# -- quotients --------------------------------------------------------------------------------------


def _quotients(what: Subject, degree: int, known: list[Polynomial], seed: list[int]) -> list[Quotient]:
    count = math.comb(math.comb(what.dim + degree, degree), 2)
    if count > MOST_MONOMIALS:
        raise InputError(
            f"Quotients of degree {degree} in {what.dim} coordinates need {count} unknowns; at most "
            f"{MOST_MONOMIALS} are tried. Use a lower degree, or quotients=False."
        )
    exponents = list(monomials(what.dim, degree))
    pairs = list(itertools.combinations(range(len(exponents)), 2))
    first, second = (np.array([pair[i] for pair in pairs]) for i in (0, 1))

    def rows(p: int) -> Array:
        values = _along_orbits(what, exponents, seed, p, len(pairs) + SPARE)
        a, b = np.broadcast_to(values[:1], values[1:].shape), values[1:]
        return ((b[..., first] * a[..., second] - a[..., first] * b[..., second] % p) % p).reshape(-1, len(pairs))

    bivectors = rational_kernel(rows, pairs)
    found = [q for q in (_decomposed(terms, exponents, what.names) for terms in bivectors) if q is not None]
    found.sort(key=lambda f: (f.degree, len(f.numerator.terms) + len(f.denominator.terms)))
    return _independent(what, found, seed, [*known])


def _cancelled(rows: list[dict[Exponents, Fraction]], names: tuple[str, ...]) -> list[dict[Exponents, Fraction]]:
    """Two polynomials without their common factor."""
    flint = require_flint()
    ring = flint.fmpq_mpoly_ctx.get(names, flint.Ordering.degrevlex)
    P, Q = (ring.from_dict({e: flint.fmpq(c.numerator, c.denominator) for e, c in row.items()}) for row in rows)
    common = P.gcd(Q)
    return [{tuple(e): Fraction(int(c.p), int(c.q)) for e, c in (f // common).to_dict().items()} for f in (P, Q)]


def _decomposed(
    entries: dict[tuple[int, int], Fraction], exponents: list[Exponents], names: tuple[str, ...]
) -> Quotient | None:
    """P and Q of a bivector P ^ Q, or None where it is a sum of several: two of its rows span P and Q."""
    (i, j), _ = next(iter(entries.items()))
    rows = []
    for k in (i, j):
        row = {b: c for (a, b), c in entries.items() if a == k} | {a: -c for (a, b), c in entries.items() if b == k}
        rows.append({exponents[place]: c for place, c in row.items()})
    P, Q = (Polynomial(_primitive(row), names) for row in _cancelled(rows, names))
    wedge = {
        (a, b): rows[0].get(exponents[a], 0) * rows[1].get(exponents[b], 0)
        - rows[0].get(exponents[b], 0) * rows[1].get(exponents[a], 0)
        for a, b in itertools.combinations(range(len(exponents)), 2)
    }
    scale = wedge[(i, j)] / entries[(i, j)]
    if any(wedge[pair] != scale * entries.get(pair, 0) for pair in wedge):
        return None
    return Quotient(P, Q) if len(P.terms) >= len(Q.terms) else Quotient(Q, P)
