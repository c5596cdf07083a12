"""Integrals of a map, found unaided: polynomials and quotients of them that are constant along orbits.

Polynomials.  Monomials up to a degree, evaluated along orbits over F_p: those combinations whose values do not change
are the null space of a matrix.  Lifted to the rationals, and checked on fresh orbits modulo another prime.

Quotients P/Q.  P(x') Q(x) - P(x) Q(x') = 0 is linear in the bivector P ^ Q.  Its null space contains I ^ J for all
polynomial integrals I, J; further integrals are quotients.

Integrals that are polynomials in others, or functionally dependent on them, are left out.  Integrals that a record
states are tested exactly.

Maps that can only be run in floats.  Combinations of monomials that are conserved along orbits are singular vectors
whose singular values are at round-off; a gap separates them from combinations that only change little.
Functionally independent ones are counted by the rank of their gradients, those on a leaf and their brackets with the
bracket of the map.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.errors import InputError, RunError
from kreisel.lab import dynamics
from kreisel.lab.exact import (
    PRIMES,
    Mod,
    Pole,
    independent,
    modular_matrix,
    rank_modulo,
    reconstructed,
    require_flint,
    residue,
    residues_at,
    slopes,
    without_poles,
)
from kreisel.lab.subject import Subject

STEPS = 6  # of each orbit: few, over many orbits, so that no integral is a constant by chance
SPARE = 30  # rows more than monomials: a false integral passes with probability p^-SPARE
MOST_MONOMIALS = 4000
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
        """The value at coordinates x (d, ...) of any values that multiply with fractions, or floats."""
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
        return sum(residue(c, p) * _monomial(e, point, p) for e, c in self.terms.items()) % p

    def gradient_at(self, point: Array, p: int) -> list[int]:
        """The gradient modulo p at residues (d,)."""
        out = [0] * len(point)
        for e, c in self.terms.items():
            for i, k in enumerate(e):
                if k:
                    lower = (*e[:i], k - 1, *e[i + 1 :])
                    out[i] = (out[i] + residue(c, p) * k * _monomial(lower, point, p)) % p
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


def require_few_monomials(subject: Subject, degree: int, most: int) -> None:
    """Raises `InputError` for a degree with more than `most` monomials."""
    count = math.comb(subject.dim + degree, degree)
    if count > most:
        raise InputError(
            f"Degree {degree} in {subject.dim} coordinates has {count} monomials; at most {most} are tried. "
            "Use a lower degree."
        )


def integrals(subject: Subject, degree: int = 2, *, quotients: bool = False, seed: int = 0) -> list[Integral]:
    """Functionally independent polynomial integrals up to that degree; with `quotients`, also P/Q of that degree.

    They hold for the constants of the subject.  Raises `InputError` for maps that are not rational, and for degrees
    with more than MOST_MONOMIALS monomials.
    """
    require_few_monomials(subject, degree, MOST_MONOMIALS)

    def sought(attempt: int) -> list[Integral]:
        polynomials = _polynomials(subject, degree, [seed, attempt])
        return [*polynomials, *(_quotients(subject, degree, polynomials, [seed, attempt]) if quotients else [])]

    return without_poles(subject.name, sought)


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
    values: dict[Exponents, Array] = {zero: np.ones(points.shape[:-1], dtype=np.int64)}
    for e in sorted(exponents, key=sum):
        if e != zero:
            first = next(i for i, k in enumerate(e) if k)
            smaller = (*e[:first], e[first] - 1, *e[first + 1 :])
            values[e] = values[smaller] * points[..., first] % p
    return np.stack([values[e] for e in exponents], -1)


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


def _polynomials(subject: Subject, degree: int, seed: list[int]) -> list[Polynomial]:
    """Degree by degree, modulo the products of those found before."""
    polynomials: list[Polynomial] = []
    for d in range(1, degree + 1):
        # leading monomials first
        exponents = sorted(list(monomials(subject.dim, d))[1:], key=lambda e: (sum(e), e), reverse=True)
        products = [expanded(f) for f in _products(polynomials, d)]

        def rows(p: int, exponents: list[Exponents] = exponents) -> Array:
            values = _along_orbits(subject, exponents, seed, p, len(exponents) + SPARE)
            return (values[1:] - values[:1]).reshape(-1, len(exponents)) % p

        new = [Polynomial(terms, subject.names) for terms in rational_kernel(rows, exponents, products)]
        polynomials += _independent(subject, sorted(new, key=lambda f: len(f.terms)), seed, polynomials)
    return polynomials


def rational_kernel(
    rows: Callable[[int], Array], labels: list[Any], modulo: list[dict[Any, Fraction]] | None = None
) -> list[dict[Any, Fraction]]:
    """A basis of the rational null space of a matrix that is known modulo primes, `modulo` vectors of it known before.

    rows(p) may belong to other points for each prime.  From two primes; the third must confirm it.
    """
    bases = []
    for p in PRIMES[:2]:
        vectors = [[residue(vector.get(label, Fraction(0)), p) for label in labels] for vector in modulo or []]
        bases.append(_modulo(kernel(rows(p), p), vectors, p))
    if len(bases[0]) != len(bases[1]):
        raise Pole("two primes find null spaces of different size")
    basis, p = [], PRIMES[2]
    third = rows(p) if bases[0] else None
    for pair in zip(*bases, strict=True):
        terms = lift({label: (a, b) for label, a, b in zip(labels, *pair, strict=True) if a or b})
        vector = np.array([residue(terms.get(label, Fraction(0)), p) for label in labels]) if terms else None
        if vector is None or ((third * vector % p).sum(1) % p).any():
            raise InputError(
                "A result has coefficients too large to be found from two primes. Usual cause: constants that are "
                "floats such as 0.1; give integers or fractions."
            )
        basis.append(terms)
    return basis


def _products(polynomials: list[Polynomial], degree: int) -> list[list[Polynomial]]:
    """All products of integrals of total degree at most `degree`."""
    out: list[list[Polynomial]] = []
    for count in range(1, degree + 1):
        chosen = itertools.combinations_with_replacement(polynomials, count)
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


def _modulo(space: list[list[int]], spanned: list[list[int]], p: int) -> list[list[int]]:
    """A reduced basis of `space` modulo the span of `spanned`, which is a part of it."""
    spanned = _reduced(spanned, p)[0]
    leads = [next(j for j, v in enumerate(row) if v) for row in spanned]
    remainders = []
    for vector in space:
        for row, lead in zip(spanned, leads, strict=True):
            factor = vector[lead]
            if factor:
                vector = [(v - factor * w) % p for v, w in zip(vector, row, strict=True)]
        remainders.append(vector)
    return _reduced(remainders, p)[0]


def _reduced(rows: list[list[int]], p: int) -> tuple[list[list[int]], list[int]]:
    """The reduced echelon form without its rows of zeros, and the places of its pivots."""
    if not rows:
        return [], []
    reduced, rank = modular_matrix(np.array(rows), p).rref()
    table = [[int(v) for v in row] for row in reduced.tolist()[:rank]]
    return table, [next(j for j, v in enumerate(row) if v) for row in table]


def lift(terms: dict[Any, tuple[int, int]]) -> dict[Any, Fraction]:
    """Integers without a common factor from residues modulo two primes; {} if they are too large."""
    p, q = PRIMES[:2]
    out = {}
    for label, (a, b) in terms.items():
        c = reconstructed((a + p * ((b - a) * pow(p, -1, q) % q)) % (p * q), p * q)
        if c is None:
            return {}
        out[label] = c
    return _primitive(out)


def _primitive(terms: dict[Any, Fraction]) -> dict[Any, Fraction]:
    """Scaled so that the coefficients are integers without a common factor, the largest label's positive."""
    scale = Fraction(math.lcm(*(c.denominator for c in terms.values())), 1)
    scale /= math.gcd(*(int(c * scale) for c in terms.values()))
    leading = max(terms, key=_label_key)
    return {e: c * scale * (1 if terms[leading] > 0 else -1) for e, c in terms.items()}


def _along_orbits(subject: Subject, exponents: list[Exponents], seed: list[int], p: int, rows: int) -> Array:
    lanes = -(-rows // STEPS)
    points = np.moveaxis(subject.orbits(p, seed[0] * 1000 + seed[1], lanes, STEPS), 1, -1)
    return monomial_values(points, exponents, p)


def _independent(
    subject: Subject, functions: list[Any], seed: list[int], earlier: list[Any] | None = None
) -> list[Any]:
    """Those whose gradients raise the rank at a random point, modulo a prime."""
    p = PRIMES[2]
    point = subject.orbits(p, seed[0] * 1000 + seed[1] + 500, 1, 0)[0, :, 0]
    kept: list[Any] = []
    rows = [f.gradient_at(point, p) for f in earlier or []]
    rank = rank_modulo(np.array(rows), p) if rows else 0
    for f in functions:
        more = [*rows, f.gradient_at(point, p)]
        new = rank_modulo(np.array(more), p)
        if new > rank:
            kept, rows, rank = [*kept, f], more, new
    return kept


def without_dependent(subject: Subject, functions: list[Any], seed: int = 0) -> list[Any]:
    """Functions that are conserved, without those that depend on functions before them."""
    errors = (Pole, ValueError)  # pow() of 0
    return without_poles(subject.name, lambda attempt: _independent(subject, functions, [seed, attempt]), errors)


def _monomial(e: Exponents, point: Array, p: int) -> int:
    out = 1
    for k, v in zip(e, point, strict=True):
        out = out * pow(int(v), k, p) % p
    return out


# -- quotients --------------------------------------------------------------------------------------


def _quotients(subject: Subject, degree: int, polynomials: list[Polynomial], seed: list[int]) -> list[Quotient]:
    count = math.comb(math.comb(subject.dim + degree, degree), 2)
    if count > MOST_MONOMIALS:
        raise InputError(
            f"Quotients of degree {degree} in {subject.dim} coordinates need {count} unknowns; at most "
            f"{MOST_MONOMIALS} are tried. Use a lower degree, or quotients=False."
        )
    exponents = list(monomials(subject.dim, degree))
    pairs = list(itertools.combinations(range(len(exponents)), 2))
    first, second = (np.array([pair[i] for pair in pairs]) for i in (0, 1))

    def rows(p: int) -> Array:
        values = _along_orbits(subject, exponents, seed, p, len(pairs) + SPARE)
        a, b = np.broadcast_to(values[:1], values[1:].shape), values[1:]
        return ((b[..., first] * a[..., second] - a[..., first] * b[..., second] % p) % p).reshape(-1, len(pairs))

    bivectors = rational_kernel(rows, pairs)
    quotients = [q for q in (_decomposed(terms, exponents, subject.names) for terms in bivectors) if q is not None]
    quotients.sort(key=lambda f: (f.degree, len(f.numerator.terms) + len(f.denominator.terms)))
    return _independent(subject, quotients, seed, [*polynomials])


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
    """P and Q of a bivector P ^ Q, or None if it is a sum of several: two of its rows span P and Q."""
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


# -- integrals that a record states ----------------------------------------------------------------------

LANES = 8  # random points modulo each of two primes: a false integral passes with probability p^-16


@dataclass(frozen=True)
class Stated:
    """One of the functions `Subject.integrals`."""

    subject: Subject
    place: int

    def gradient_at(self, point: Array, p: int) -> list[int]:
        """The gradient modulo p at residues (d,)."""
        x = objects(Mod(np.array([int(v)]), p) for v in point)
        value = _stated_values(self.subject, independent(x), p)[self.place]
        return [int(v) for v in residues_at(slopes(objects([value]), self.subject.dim)[0], 1, p)[0]]

    def __str__(self) -> str:
        return f"stated in the record: number {self.place + 1}"


def stated(subject: Subject, seed: int) -> list[Stated]:
    """The integrals of a record that its map conserves, modulo two primes at random points."""
    if subject.integrals is None or subject.implicit:
        return []
    holds: Array | bool = True
    for p in PRIMES[:2]:
        try:
            points = subject.some_orbits(p, seed + 77, LANES, 1)
            old, new = (_stated_values(subject, np.array([Mod(v, p) for v in z], dtype=object), p) for z in points)
        except (Pole, TypeError):
            return []
        apart = [a - b for a, b in zip(old, new, strict=True)]
        holds = np.array([isinstance(d, Mod) and not np.any(d.v % p) for d in apart]) & holds
    return [Stated(subject, int(i)) for i in np.flatnonzero(holds)]


def _stated_values(subject: Subject, x: Array, p: int) -> Array:
    assert subject.integrals is not None
    return np.ravel(np.asarray(subject.integrals(x, **subject.modulo(p)), dtype=object))


# -- integrals in floats ---------------------------------------------------------------------------------

FLOAT_STEPS = 40  # of each orbit
ROUND_OFF = 1e-10  # singular values below it, relative to the largest, are 0
GAP = 1e3  # by which the next one must be larger
MOST_IN_FLOATS = 300  # monomials


@dataclass(frozen=True)
class Numerical:
    """Counts of integrals that are conserved in floats.

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


def integrals_in_floats(subject: Subject, degree: int = 2, seed: int = 0) -> Numerical:
    """Polynomial integrals up to that degree, found from orbits in floats.

    Raises `InputError` for too many monomials, and `RunError` where all orbits escape.
    """
    require_few_monomials(subject, degree, MOST_IN_FLOATS)
    exponents = np.array(list(monomials(subject.dim, degree))[1:])
    rows, scale, k, trouble = [np.empty((0, len(exponents)))], np.zeros(len(exponents)), 0, ""
    wanted = 3 * len(exponents)
    while sum(map(len, rows)) < wanted and k < 3 * wanted // FLOAT_STEPS + 10:
        k += 1
        try:
            orbit = dynamics.points(subject, dynamics.float_start(subject, seed + 100 + k), FLOAT_STEPS)
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
    x = dynamics.float_start(subject, seed + 7)
    G = vectors @ _monomial_gradients(x, exponents)
    rank = _numerical_rank(G)
    pi = (
        np.asarray(subject.tensor(x), dtype=float)
        if subject.tensor is not None
        else np.zeros((subject.dim, subject.dim))
    )
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
