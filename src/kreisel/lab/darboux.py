"""Darboux polynomials of a rational map: P(f(x)) = C(x) P(x), and the integrals and measures that they give; bases.

The cofactors C that are tried are values times powers of the factors of det f' and of the denominators of f; for each
the P of a degree are a null space.  A product of powers of P with cofactor 1 is an integral, one with the cofactor det
f' the inverse of an invariant density.  [Celledoni, Evripidou, McLaren, Owren, Quispel, Tapley, arXiv 1902.04685]

Hirota-Kimura bases: monomials f_i of which some combinations vanish along every orbit, sum_i c_i f_i(x_k) = 0 for all
k; the ratios of the c_i, which depend on the orbit, are integrals.  [Petrera, Pfadler, Suris 2011]
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.algebra.invariants import determinant
from kreisel.errors import InputError, explained
from kreisel.lab import integrals, modular
from kreisel.lab.exact import Pole, Ratio, fraction, fractions, generators, independent, require_flint, slopes
from kreisel.lab.integrals import SPARE, Exponents, Polynomial, Product, expanded, monomial_values, monomials, products
from kreisel.lab.modular import PRIMES, Mod, random_residues, residue, residues_at, without_poles
from kreisel.lab.subject import Subject, stacked
from kreisel.runs.settings import within

MOST_COFACTORS = 600
LARGEST = 10_000  # number in a cofactor
Points = tuple[Array, Array, list[Array]]
Powers = tuple[int, ...]
Cofactor = tuple[Fraction, Powers]


@dataclass(frozen=True)
class Darboux:
    """Darboux polynomials of a map, with the integrals and densities that they give.

    polynomials   P that are no products of others of the list
    cofactors     of each: a number, and powers of `factors`
    integrals     products of powers of P that are conserved
    densities     D with dx / D preserved, up to its sign
    """

    polynomials: tuple[Polynomial, ...]
    cofactors: tuple[Cofactor, ...]
    factors: tuple[Polynomial, ...]
    integrals: tuple[Product, ...]
    densities: tuple[Product, ...]


@explained
def darboux(subject: Subject, degree: int = 2, seed: int = 0) -> Darboux:
    """Darboux polynomials up to a degree, with their integrals and measures; for maps of few coordinates.

    Raises `InputError` for maps that are not rational, and if there are too many cofactors to try.
    """
    within(degree, "degree", 1, 100)
    factors, jacobian, most, poles = _factors(subject)
    polynomials: list[Polynomial] = []
    cofactors: list[Cofactor] = []
    for d in range(1, degree + 1):
        exponents = list(monomials(subject.dim, d))
        data = {p: _points(subject, factors, p, exponents, seed) for p in PRIMES}
        for powers in _powers(factors, poles, most, d, jacobian[1]):
            for c in _numbers(data[PRIMES[0]], powers):
                products = _products(polynomials, cofactors, (c, powers), exponents)
                for terms in _of_cofactor(data, (c, powers), exponents, products):
                    polynomials.append(Polynomial(terms, subject.names))
                    cofactors.append((c, powers))
    conserved, densities = _relations(polynomials, cofactors, jacobian)
    return Darboux(tuple(polynomials), tuple(cofactors), tuple(factors), conserved, densities)


def _powers(factors: list[Polynomial], poles: Powers, most: int, d: int, jacobian: Powers) -> list[Powers]:
    """Powers k of the factors that P(f(x)) / P(x) of degree d may have: of det f', then the smallest first.

    P(f(x)) = N / D^d, D the common denominator, with the factors to the powers `poles`: a factor of N and of P counts.
    """
    sizes = [f.degree for f in factors]
    least = [-d * e - d // size for e, size in zip(poles, sizes, strict=True)]
    ranges = [range(k, d * most // size - d * e + 1) for k, e, size in zip(least, poles, sizes, strict=True)]
    lowest = -d * (1 + sum(e * size for e, size in zip(poles, sizes, strict=True)))
    candidates = (
        powers
        for powers in itertools.islice(itertools.product(*ranges), 200_000)
        if lowest <= sum(size * k for size, k in zip(sizes, powers, strict=True)) <= lowest + d * most
    )
    smallest = sorted(candidates, key=lambda powers: sum(map(abs, powers)))
    return [jacobian, *(powers for powers in smallest if powers != jacobian)][:MOST_COFACTORS]


def _factors(subject: Subject) -> tuple[list[Polynomial], Cofactor, int, Powers]:
    """Factors of det f' and of the denominators of f; det f', the degree of the map, powers in the denominator."""
    if subject.implicit or subject.start is not None:
        raise InputError(f"{subject.name}: Darboux polynomials need a rational map of free coordinates.")
    x = generators(subject.names)
    constants = {k: fractions(v) for k, v in subject.constants.items()}
    new = subject.step(independent(x), **constants)
    J = slopes(new, subject.dim)
    det = determinant(objects((v if isinstance(v, Ratio) else x[0] * 0 + int(v) for v in J.flat), J.shape))
    if det.n == 0:
        raise InputError(f"The Jacobian determinant of {subject.name} vanishes: the map is not invertible.")
    values = [getattr(v, "value", v) for v in new]
    powers_of: dict[str, tuple[Any, int]] = {}
    c = Fraction(1)
    for f, sign in [(det.n, 1), (det.d, -1), *((v.d, 0) for v in values)]:
        leading, powers = f.factor()
        c *= fraction(leading) ** sign
        for factor, k in powers:
            powers_of[str(factor)] = factor, powers_of.get(str(factor), (factor, 0))[1] + sign * int(k)
    common: Any = x[0].d  # 1
    for v in values:
        common = common * (v.d // common.gcd(v.d))
    degree = max(common.total_degree(), *((v.n * (common // v.d)).total_degree() for v in values))
    factors = [Polynomial(integrals.terms_of(f), subject.names) for f, _ in powers_of.values()]
    poles = {str(f): int(k) for f, k in common.factor()[1]}
    powers = tuple(k for _, k in powers_of.values())
    return factors, (c, powers), degree, tuple(poles.get(f, 0) for f in powers_of)


def jacobian_factors(subject: Subject) -> list[Polynomial]:
    """The irreducible factors of det f' and of the denominators of a rational map."""
    return _factors(subject)[0]


def _products(
    polynomials: list[Polynomial], cofactors: list[Cofactor], C: Cofactor, exponents: list[Any]
) -> list[dict[Any, Fraction]]:
    """Products of those that are known, with this cofactor, as terms."""
    out: list[dict[Any, Fraction]] = []
    if C[0] == 1 and not any(C[1]):
        out.append({exponents[0]: Fraction(1)})
    for chosen in products([P.degree for P in polynomials], sum(exponents[-1])):
        powers = all(sum(cofactors[i][1][j] for i in chosen) == k for j, k in enumerate(C[1]))
        if powers and math.prod((cofactors[i][0] for i in chosen), start=Fraction(1)) == C[0]:
            out.append(expanded([polynomials[i] for i in chosen]))
    return out


def _rows(data: Points, C: Cofactor, p: int) -> tuple[Array, Array]:
    """The monomials at f(x), and C times those at x, modulo p."""
    new, old, values = data
    cofactor = np.full(len(old), residue(C[0], p), dtype=np.int64)
    for v, k in zip(values, C[1], strict=True):
        for _ in range(abs(k)):
            cofactor = cofactor * v[int(k < 0)] % p
    return new, cofactor[:, None] * old % p


def _numbers(data: Points, powers: Powers) -> list[Fraction]:
    """All c for which c times the powers is a cofactor.

    From A P = c B P at two sets of points: (M - M') P = 0, M = B^-1 A, and on this space M has the eigenvalues c.
    """
    p, n = PRIMES[0], data[0].shape[1]
    A, B = _rows(data, (Fraction(1), powers), p)
    try:
        M, M1 = (modular.matrix(B[k : k + n], p).solve(modular.matrix(A[k : k + n], p)) for k in (0, n))
    except ZeroDivisionError:
        return []
    if (M - M1).rank() == n:
        return []
    vectors = modular.kernel(modular.entries(M - M1), p).T
    leads = modular.reduced(vectors.T, p)[1]
    moved = modular.product(modular.entries(M), vectors, p)
    matrix = modular.matrix(vectors[leads], p).solve(modular.matrix(moved[leads], p))
    numbers = [modular.reconstructed(int(root), p) for root, _ in matrix.charpoly().roots()]
    return sorted({c for c in numbers if c and max(abs(c.numerator), c.denominator) < LARGEST})


def _of_cofactor(
    data: dict[int, Points], C: Cofactor, exponents: list[Any], earlier: list[dict[Any, Fraction]]
) -> list[dict[Any, Fraction]]:
    def rows(p: int) -> Array:
        A, B = _rows(data[p], C, p)
        return (A - B) % p

    few = len(modular.kernel(rows(PRIMES[0]), PRIMES[0])) <= len(earlier)
    return [] if few else integrals.rational_kernel(rows, exponents, earlier)


def _points(subject: Subject, factors: list[Polynomial], p: int, exponents: list[Exponents], seed: int) -> Points:
    """Monomials (points, count) at f(x) and x, the factors and their inverses (2, points), at random x modulo p."""
    points = 3 * len(exponents) + SPARE

    def drawn(attempt: int) -> Points:
        x = random_residues(np.random.default_rng([seed, attempt, p]), p, points)((subject.dim,))
        new, old = (stacked(z, points).T for z in (subject.over(p)(x), x))
        values = [f(x) for f in factors]
        new, old = (monomial_values(z, exponents, p) for z in (new, old))
        return new, old, [residues_at(objects([v, 1 / v]), points, p).T for v in values]

    return without_poles(subject.name, drawn)


def _relations(
    polynomials: list[Polynomial], cofactors: list[Cofactor], jacobian: Cofactor
) -> tuple[tuple[Product, ...], tuple[Product, ...]]:
    """Products with cofactor 1, and with the cofactor det f'."""
    if not polynomials:
        return (), ()
    flint = require_flint()

    def powers_of_primes(c: Fraction) -> dict[int, int]:
        over, under = (flint.fmpz(v).factor() for v in (abs(c.numerator), c.denominator))
        return {**{int(q): k for q, k in over}, **{int(q): -k for q, k in under}}

    numbers = [powers_of_primes(c) for c, _ in (*cofactors, jacobian)]
    primes = sorted(set().union(*numbers))
    *table, last_row = (
        [*powers, *(number.get(q, 0) for q in primes)]
        for number, (_, powers) in zip(numbers, (*cofactors, jacobian), strict=True)
    )

    def product(powers: list[int]) -> Product:
        return Product(tuple((P, k) for P, k in zip(polynomials, powers, strict=True) if k))

    conserved, densities = [], []
    for powers in _whole_kernel(table):
        negative = sum(k for k, (c, _) in zip(powers, cofactors, strict=True) if c < 0) % 2
        conserved.append(product([k * (1 + negative) for k in powers]))
    for *powers, last in _whole_kernel([*table, [-k for k in last_row]]):
        if last and all(k % last == 0 for k in powers):
            densities.append(product([k // last for k in powers]))
    return tuple(conserved), tuple(densities)


def _whole_kernel(table: list[list[int]]) -> list[list[int]]:
    """Short integer vectors v with v table = 0."""
    flint = require_flint()
    if not table[0]:
        return np.eye(len(table), dtype=int).tolist()
    basis, nullity = flint.fmpz_mat(table).transpose().nullspace()
    if not nullity:
        return []
    columns = flint.fmpz_mat([[int(basis[i, j]) for i in range(len(table))] for j in range(nullity)]).lll()
    rows = ([int(v) for v in row] for row in columns.tolist())
    return [[v // math.gcd(*row) for v in row] for row in rows]


# -- Hirota-Kimura bases ---------------------------------------------------------------------------------

SPARE_POINTS = 12  # more than monomials: a combination vanishes on them by chance with probability p^-SPARE_POINTS
MOST_MONOMIALS = 500


@dataclass(frozen=True)
class Bases:
    """Counts of Hirota-Kimura bases at random points, equal modulo two primes.

    degree        of the monomials
    monomials     how many there are
    combinations  how many independent combinations of them vanish along an orbit
    integrals     how many functionally independent integrals the coefficients are
    point, slopes   residues (d,) modulo PRIMES[0], and the gradients (rows, d) of the coefficients there
    """

    degree: int
    monomials: int
    combinations: int
    integrals: int
    point: Array = field(repr=False, compare=False)
    slopes: Array = field(repr=False, compare=False)

    def __str__(self) -> str:
        return (
            f"degree {self.degree}: {self.combinations} combinations of {self.monomials} monomials vanish along an "
            f"orbit; their coefficients are {self.integrals} independent integrals"
        )


def bases(subject: Subject, degree: int = 2, seed: int = 0) -> Bases:
    """The combinations of monomials up to a degree that vanish along orbits, and how many integrals they give.

    Raises `InputError` for maps that are not rational, and for degrees with more than MOST_MONOMIALS monomials.
    """
    integrals.require_few_monomials(subject, degree, MOST_MONOMIALS)
    exponents = list(monomials(subject.dim, degree))

    def counted(p: int) -> Bases:
        def at(attempt: int) -> Bases:
            x = subject.point(random_residues(np.random.default_rng([seed, attempt, p]), p, 1))
            combinations, rows = _combinations(subject, x, exponents, p)
            return Bases(degree, len(exponents), combinations, modular.rank(rows, p), x, rows)

        return without_poles(subject.name, at, (Pole, ZeroDivisionError))

    first, second = (counted(p) for p in PRIMES[:2])
    if first != second:
        raise InputError(f"{subject.name}: two primes give different counts, {first} and {second}. Use another seed.")
    return first


def _combinations(subject: Subject, x: Array, exponents: list[Exponents], p: int) -> tuple[int, Array]:
    """How many combinations vanish along the orbit of x, and the derivatives of their coefficients (rows, d).

    With the basis in reduced form, a coefficient is a function u of x with A u = -b: A are the columns of the pivots, b
    the others.  A du = -(db + dA u).
    """
    step, orbit = subject.over(p), [independent(x)]
    for _ in range(len(exponents) + SPARE_POINTS - 1):
        orbit.append(step(orbit[-1]))
    points = np.array(orbit)
    at = residues_at(objects((getattr(v, "value", v) for v in points.flat), points.shape), 1, p)[0]
    values = monomial_values(at, exponents, p)  # (points, l)
    null = modular.kernel(values, p)
    if not len(null):
        return 0, np.zeros((0, subject.dim), dtype=np.int64)
    moved_by = residues_at(slopes(points, subject.dim), 1, p)[0]  # derivatives of points by x
    monomials_at = monomial_values(independent(objects(Mod(v, p) for v in at.T)), exponents, None)
    gradients = residues_at(slopes(monomials_at, subject.dim), len(at), p)
    derivatives = sum(gradients[..., k, None] * moved_by[:, None, k] % p for k in range(subject.dim)) % p
    A = np.delete(values, [np.flatnonzero(vector)[-1] for vector in null], 1)
    moved = []
    for vector in null:
        change = (derivatives * vector[:, None] % p).sum(1)  # of sum_j c_j f_j: (points, dim)
        reduced, _ = modular.reduced(np.concatenate([A, -change % p], 1), p)
        moved.append(reduced[: A.shape[1], A.shape[1] :])  # u with A u = -change, of full rank and consistent
    return len(null), np.concatenate(moved)
