"""Darboux polynomials of a rational map: P(f(x)) = C(x) P(x), and the integrals and measures that they give; bases.

The cofactors C that are tried are values times powers of the factors of det f' and of the denominators of f; for
each the P of a degree are a null space.  Cofactors multiply as polynomials do: a product of powers of P with cofactor 1
is an integral, one with the cofactor det f' is the inverse of an invariant density.
[Celledoni, Evripidou, McLaren, Owren, Quispel, Tapley, arXiv 1902.04685]

Hirota-Kimura bases: functions f_1, ..., f_l of which some combinations with constant coefficients vanish along every
orbit, sum_i c_i f_i(x_k) = 0 for all k; the coefficients depend on the orbit, so that their ratios are integrals of the
map.  Orbits then lie on the common zeros of the combinations.  The f_i are all monomials up to a degree; the
coefficients are the null space of a matrix of their values along an orbit, exact modulo a prime.  Many integrable maps
of Kahan, Hirota and Kimura's have such bases of degree 2 where their integrals are quotients of a high degree.
[Petrera, Pfadler, Suris 2011]
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.errors import InputError
from kreisel.lab.exact import (
    PRIMES,
    Pole,
    Ratio,
    fraction,
    fractions,
    generators,
    independent,
    modular_matrix,
    random_residues,
    rank_modulo,
    reconstructed,
    require_flint,
    residue,
    residues_at,
    slopes,
    without_poles,
)
from kreisel.lab.integrals import (
    SPARE,
    Exponents,
    Polynomial,
    expanded,
    kernel,
    monomial_values,
    monomials,
    rational_kernel,
    require_few_monomials,
)
from kreisel.lab.subject import Subject, stacked

MOST_COFACTORS = 600
LARGEST = 10_000  # number in a cofactor
Points = tuple[Array, Array, list[Array]]
Powers = tuple[int, ...]
Cofactor = tuple[Fraction, Powers]


@dataclass(frozen=True)
class Product:
    """A product of powers of polynomials."""

    factors: tuple[tuple[Polynomial, int], ...]

    @property
    def degree(self) -> int:
        """The larger of the degrees of numerator and denominator."""
        return max(sum(P.degree * k for P, k in self.factors if k * s > 0) * s for s in (1, -1))

    def gradient_at(self, point: Array, p: int) -> list[int]:
        """The logarithmic gradient modulo p at residues (d,)."""
        rows = [(k * pow(P.at(point, p), -1, p), P.gradient_at(point, p)) for P, k in self.factors]
        return [sum(c * row[i] for c, row in rows) % p for i in range(len(point))]

    def __str__(self) -> str:
        def shown(sign: int) -> str:
            powers = [(P, abs(k)) for P, k in self.factors if k * sign > 0]
            return " ".join(f"({P})" + (f"^{k}" if k > 1 else "") for P, k in powers) or "1"

        return shown(1) if all(k > 0 for _, k in self.factors) else f"{shown(1)} / {shown(-1)}"


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


def darboux(subject: Subject, degree: int = 2, seed: int = 0) -> Darboux:
    """Darboux polynomials up to a degree, with their integrals and measures; for maps of few coordinates.

    Raises `InputError` for maps that are not rational, and if there are too many cofactors to try.
    """
    factors, jacobian, most = _factors(subject)
    polynomials: list[Polynomial] = []
    cofactors: list[Cofactor] = []
    for d in range(1, degree + 1):
        exponents = list(monomials(subject.dim, d))
        data = {p: _points(subject, factors, p, 3 * len(exponents) + SPARE, seed) for p in PRIMES}
        for powers in _candidates(factors, d, most):
            for c in _numbers(data[PRIMES[0]], powers, exponents):
                products = _products(polynomials, cofactors, (c, powers), exponents)
                for terms in _of_cofactor(data, (c, powers), exponents, products):
                    polynomials.append(Polynomial(terms, subject.names))
                    cofactors.append((c, powers))
    integrals, densities = _relations(polynomials, cofactors, jacobian)
    return Darboux(tuple(polynomials), tuple(cofactors), tuple(factors), integrals, densities)


def _factors(subject: Subject) -> tuple[list[Polynomial], Cofactor, int]:
    """Factors of det f' and of the denominators of f, det f' itself, and the degree of the map."""
    if subject.implicit or subject.start is not None:
        raise InputError(f"{subject.name}: Darboux polynomials need a rational map of free coordinates.")
    x = generators(subject.names)
    constants = {k: fractions(v) for k, v in subject.constants.items()}
    new = subject.step(independent(x), **constants)
    J = slopes(new, subject.dim)
    det = _determinant([[v if isinstance(v, Ratio) else x[0] * 0 + int(v) for v in row] for row in J])
    if det.n == 0:
        raise InputError(f"The Jacobian determinant of {subject.name} vanishes: the map is not invertible.")
    values = [v.value for v in new]
    powers_of: dict[Any, tuple[Polynomial, int]] = {}
    c = Fraction(1)
    for polynomial, sign in [(det.n, 1), (det.d, -1), *((v.d, 0) for v in values)]:
        leading, powers = polynomial.factor()
        c *= fraction(leading) ** sign
        for factor, k in powers:
            f = Polynomial({tuple(e): fraction(v) for e, v in factor.to_dict().items()}, subject.names)
            key = tuple(sorted(f.terms.items()))
            powers_of[key] = f, powers_of.get(key, (f, 0))[1] + sign * k
    common: Any = x[0].d  # 1
    for v in values:
        common = common * (v.d // common.gcd(v.d))
    degree = max(common.total_degree(), *((v.n * (common // v.d)).total_degree() for v in values))
    return [f for f, _ in powers_of.values()], (c, tuple(k for _, k in powers_of.values())), degree


def jacobian_factors(subject: Subject) -> list[Polynomial]:
    """The irreducible factors of det f' and of the denominators of a rational map."""
    return _factors(subject)[0]


def _determinant(rows: list[list[Any]]) -> Any:
    """By expansion: there are few rows, and no divisions."""
    if len(rows) == 1:
        return rows[0][0]
    total: Any = 0 * rows[0][0]
    for j, entry in enumerate(rows[0]):
        if entry.n != 0:
            minor = _determinant([row[:j] + row[j + 1 :] for row in rows[1:]])
            total = total + (entry if j % 2 == 0 else -entry) * minor
    return total


def _candidates(factors: list[Polynomial], degree: int, most: int) -> list[Powers]:
    """Powers of the factors, not more than the degrees of both sides allow."""
    ranges = [range(-degree, degree * (most - 1) // max(1, f.degree) + 1) for f in factors]
    limit = degree * (most - 1)
    chosen = [
        C
        for C in itertools.islice(itertools.product(*ranges), 200_000)
        if -degree * most <= sum(f.degree * k for f, k in zip(factors, C, strict=True)) <= limit
    ]
    chosen.sort(key=lambda C: sum(map(abs, C)))
    return chosen[:MOST_COFACTORS]


def _products(
    polynomials: list[Polynomial], cofactors: list[Cofactor], C: Cofactor, exponents: list[Any]
) -> list[dict[Any, Fraction]]:
    """Products of those that are known, with this cofactor, as terms."""
    out: list[dict[Any, Fraction]] = []
    if C[0] == 1 and not any(C[1]):
        out.append({exponents[0]: Fraction(1)})
    degree = sum(exponents[-1])
    for count in range(1, degree + 1):
        for chosen in itertools.combinations_with_replacement(range(len(polynomials)), count):
            if sum(polynomials[i].degree for i in chosen) > degree:
                continue
            number = math.prod((cofactors[i][0] for i in chosen), start=Fraction(1))
            if number == C[0] and all(sum(cofactors[i][1][j] for i in chosen) == k for j, k in enumerate(C[1])):
                out.append(expanded([polynomials[i] for i in chosen]))
    return out


def _rows(data: Points, C: Cofactor, exponents: list[Any], p: int) -> tuple[Array, Array]:
    """The monomials at f(x), and C times those at x, modulo p."""
    new, old, values = data
    cofactor = np.full(len(old), residue(C[0], p), dtype=np.int64)
    for v, k in zip(values, C[1], strict=True):
        for _ in range(abs(k)):
            cofactor = cofactor * v[int(k < 0)] % p
    return monomial_values(new, exponents, p), cofactor[:, None] * monomial_values(old, exponents, p) % p


def _numbers(data: Points, powers: Powers, exponents: list[Any]) -> list[Fraction]:
    """All c for which c times the powers is a cofactor.

    From A P = c B P at two sets of points: (M - M') P = 0, M = B^-1 A, and on this space M has the eigenvalues c.
    """
    p, n = PRIMES[0], len(exponents)
    A, B = _rows(data, (Fraction(1), powers), exponents, p)
    try:
        M, M1 = (modular_matrix(B[k : k + n], PRIMES[0]).solve(modular_matrix(A[k : k + n], PRIMES[0])) for k in (0, n))
    except ZeroDivisionError:
        return []
    basis, nullity = (M - M1).nullspace()
    if not nullity:
        return []
    vectors = np.array([[int(basis[i, j]) for j in range(nullity)] for i in range(n)], dtype=object)
    moved = np.array([[int(v) for v in row] for row in M.tolist()], dtype=object) @ vectors % p
    leads = _leads(vectors)
    roots = (
        modular_matrix(vectors[leads], PRIMES[0]).solve(modular_matrix(moved[leads], PRIMES[0])).charpoly().factor()[1]
    )
    numbers = [reconstructed(-int(f[0]) % p, p) for f, _ in roots if f.degree() == 1]
    return sorted({c for c in numbers if c and max(abs(c.numerator), c.denominator) < LARGEST})


def _leads(vectors: Array) -> list[int]:
    """Rows of a basis of columns that are independent."""
    reduced, rank = modular_matrix(vectors.T, PRIMES[0]).rref()
    return [next(j for j in range(vectors.shape[0]) if int(reduced[i, j])) for i in range(rank)]


def _of_cofactor(
    data: dict[int, Points], C: Cofactor, exponents: list[Any], products: list[dict[Any, Fraction]]
) -> list[dict[Any, Fraction]]:
    def rows(p: int) -> Array:
        A, B = _rows(data[p], C, exponents, p)
        return (A - B) % p

    if len(kernel(rows(PRIMES[0]), PRIMES[0])) <= len(products):
        return []
    return rational_kernel(rows, exponents, products)


def _points(subject: Subject, factors: list[Polynomial], p: int, points: int, seed: int) -> Points:
    """f(x), x (points, d), and the factors with their inverses (2, points) at random x modulo p."""

    def drawn(attempt: int) -> Points:
        x = random_residues(np.random.default_rng([seed, attempt, p]), p, points)((subject.dim,))
        new, old = (stacked(z, points).T for z in (subject.over(p)(x), x))
        values = [np.array([[f.at(row, p)] * 2 for row in old]).T for f in factors]
        if not all(v.all() for v in values):
            raise Pole("a factor vanishes at a random point")
        for v in values:
            v[1] = [pow(int(w), -1, p) for w in v[0]]
        return new, old, values

    return without_poles(subject.name, drawn)


def _relations(
    polynomials: list[Polynomial], cofactors: list[Cofactor], jacobian: Cofactor
) -> tuple[tuple[Product, ...], tuple[Product, ...]]:
    """Products with cofactor 1, and with the cofactor det f'."""
    if not polynomials:
        return (), ()
    numbers = [c for c, _ in (*cofactors, jacobian)]
    primes = sorted({q for c in numbers for whole in (c.numerator, c.denominator) for q in _primes(abs(whole))})

    def row(C: Cofactor) -> list[int]:
        return [*C[1], *(_valuation(C[0], q) for q in primes)]

    def product(powers: list[int]) -> Product:
        negative = sum(k for k, (c, _) in zip(powers, cofactors, strict=True) if c < 0) % 2
        return Product(tuple((P, k * (1 + negative)) for P, k in zip(polynomials, powers, strict=True) if k))

    table = [row(C) for C in cofactors]
    integrals = [product(powers) for powers in _whole_kernel(table)]
    densities = []
    for *powers, last in _whole_kernel([*table, [-k for k in row(jacobian)]]):
        if last and all(k % last == 0 for k in powers):
            chosen = [k // last for k in powers]
            densities.append(Product(tuple((P, k) for P, k in zip(polynomials, chosen, strict=True) if k)))
    return tuple(integrals), tuple(densities)


def _primes(n: int) -> list[int]:
    return [int(q) for q, _ in require_flint().fmpz(n).factor()]


def _valuation(c: Fraction, q: int) -> int:
    k = 0
    while c.numerator % q == 0:
        c, k = c / q, k + 1
    while c.denominator % q == 0:
        c, k = c * q, k - 1
    return k


def _whole_kernel(table: list[list[int]]) -> list[list[int]]:
    """Short integer vectors v with v table = 0."""
    flint = require_flint()
    if not table[0]:
        return np.eye(len(table), dtype=int).tolist()
    matrix = flint.fmpz_mat(table).transpose()
    basis, nullity = matrix.nullspace()
    if not nullity:
        return []
    columns = flint.fmpz_mat([[int(basis[i, j]) for i in range(len(table))] for j in range(nullity)]).lll()
    out = []
    for row in columns.tolist():
        whole = [int(v) for v in row]
        g = math.gcd(*whole)
        out.append([v // g for v in whole])
    return out


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


def bases(subject: Subject, degree: int = 2, seed: int = 0) -> Bases:
    """The combinations of monomials up to a degree that vanish along orbits, and how many integrals they give.

    Raises `InputError` for maps that are not rational, and for degrees with more than MOST_MONOMIALS monomials.
    """
    require_few_monomials(subject, degree, MOST_MONOMIALS)
    exponents = list(monomials(subject.dim, degree))
    counts = {_at_a_point(subject, exponents, p, seed) for p in PRIMES[:2]}
    if len(counts) > 1:
        raise InputError(f"{subject.name}: two primes give different counts, {counts}. Use another seed.")
    combinations, rank = counts.pop()
    return Bases(degree, len(exponents), combinations, rank)


def _at_a_point(subject: Subject, exponents: list[Exponents], p: int, seed: int) -> tuple[int, int]:

    def counted(attempt: int) -> tuple[int, int]:
        x = subject.point(random_residues(np.random.default_rng([seed, attempt, p]), p, 1))
        return _counted(subject, x, exponents, p)

    return without_poles(subject.name, counted, (Pole, ZeroDivisionError))


def _counted(subject: Subject, x: Array, exponents: list[Exponents], p: int) -> tuple[int, int]:
    """The combinations at x, and the rank of the derivatives of their coefficients.

    With the basis in reduced form, a coefficient is a function u of x with A u = -b: A are the columns of the pivots, b
    the others.  A du = -(db + dA u).
    """
    values, derivatives = _along(subject, x, exponents, p)
    null = kernel(values, p)
    if not null:
        return 0, 0
    free = [next(j for j in reversed(range(len(v))) if v[j] and all(w is v or not w[j] for w in null)) for v in null]
    pivots = [j for j in range(len(exponents)) if j not in free]
    A = values[:, pivots]
    moved: list[Array] = []
    for vector in null:
        change = _combined(derivatives, np.array(vector), p)  # (points, dim)
        moved.append(_solved(A, -change % p, p))
    return len(null), rank_modulo(np.concatenate(moved), p)


def _along(subject: Subject, x: Array, exponents: list[Exponents], p: int) -> tuple[Array, Array]:
    """The monomials along the orbit of x (points, l), and their derivatives by x (points, l, dim)."""
    step, moving, rows, slopes_of = subject.over(p), independent(x), [], []
    for _ in range(len(exponents) + SPARE_POINTS):
        point = residues_at(objects(v.value for v in moving), 1, p)
        tangent = residues_at(slopes(moving, subject.dim), 1, p)[0]
        rows.append(monomial_values(point, exponents, p)[0])
        gradients = np.stack([_partial(point, exponents, i, p) for i in range(subject.dim)], -1)
        product = modular_matrix(gradients, p) * modular_matrix(tangent, p)
        slopes_of.append(np.array([[int(v) for v in row] for row in product.tolist()], dtype=np.int64))
        moving = step(moving)
    return np.array(rows), np.array(slopes_of)


def _partial(point: Array, exponents: list[Exponents], i: int, p: int) -> Array:
    lower = [(*e[:i], max(e[i] - 1, 0), *e[i + 1 :]) for e in exponents]
    distinct = sorted(set(lower), key=sum)
    values = dict(zip(distinct, monomial_values(point, distinct, p)[0].tolist(), strict=True))
    return np.array([e[i] * values[low] % p for e, low in zip(exponents, lower, strict=True)], dtype=np.int64)


def _combined(derivatives: Array, vector: Array, p: int) -> Array:
    """sum_j d(f_j) c_j (points, dim)."""
    return sum((derivatives[:, j] * int(c) % p for j, c in enumerate(vector) if c), 0 * derivatives[:, 0]) % p


def _solved(A: Array, right: Array, p: int) -> Array:
    """u (columns, dim) with A u = right, of full rank and consistent."""
    k = A.shape[1]
    table, _ = modular_matrix(np.concatenate([A, right], 1), p).rref()
    return np.array([[int(table[i, k + j]) for j in range(right.shape[1])] for i in range(k)], dtype=np.int64)
