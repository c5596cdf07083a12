"""Integrals of a map, found unaided: polynomials and quotients of them that are constant along orbits.

Combinations of monomials that are constant along orbits over F_p are a null space, lifted to the rationals and checked
modulo another prime.  P(x') Q(x) - P(x) Q(x') = 0 is linear in the bivector P ^ Q; its null space contains I ^ J for
all polynomial integrals I, J.  Dependent integrals are left out.  In floats the null space are singular vectors whose
singular values are at round-off, with a gap to the others.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.errors import InputError, RunError, explained
from kreisel.lab import dynamics, modular
from kreisel.lab.exact import Pole, fraction, rationals, ring
from kreisel.lab.modular import PRIMES, Mod, random_residues, residue, without_poles
from kreisel.lab.subject import Subject, float_start
from kreisel.runs.settings import within

STEPS = 6  # of each orbit: few, over many orbits, so that no integral is a constant by chance
SPARE = 30  # rows more than monomials: a false integral passes with probability p^-SPARE
MOST_MONOMIALS = 4000
Exponents = tuple[int, ...]


class TooLarge(InputError):
    """Coefficients of a result are beyond those that two primes determine."""


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

    def __str__(self) -> str:
        return str(polynomial(self.terms, self.names)).replace("*", " ")


@dataclass(frozen=True)
class Product:
    """A product of powers of polynomials."""

    factors: tuple[tuple[Polynomial, int], ...]

    @property
    def degree(self) -> int:
        """The larger of the degrees of numerator and denominator."""
        return max(sum(P.degree * k for P, k in self.factors if k * s > 0) * s for s in (1, -1))

    def __call__(self, x: Array) -> Any:
        """The value at coordinates x (d,) of any field."""
        values = [(P(x), k) for P, k in self.factors]
        over, under = (math.prod(v for v, k in values for _ in range(k * sign)) for sign in (1, -1))
        return over / under

    def __str__(self) -> str:
        def shown(sign: int) -> str:
            powers = [(P, abs(k)) for P, k in self.factors if k * sign > 0]
            return " ".join(f"({P})" + (f"^{k}" if k > 1 else "") for P, k in powers) or "1"

        return shown(1) if all(k > 0 for _, k in self.factors) else f"{shown(1)} / {shown(-1)}"


def require_few_monomials(subject: Subject, degree: int, most: int) -> None:
    """Raises `InputError` for a degree that is no integer from 0 on, or has more than `most` monomials."""
    within(degree, "degree", 0, 10_000)
    count = math.comb(subject.dim + degree, degree)
    if count > most:
        raise InputError(
            f"Degree {degree} in {subject.dim} coordinates has {count} monomials; at most {most} are tried. "
            "Use a lower degree."
        )


@explained
def integrals(
    subject: Subject, degree: int = 2, *, quotients: bool = False, seed: int = 0
) -> list[Polynomial | Product]:
    """Functionally independent polynomial integrals up to that degree; with `quotients`, also P/Q of that degree.

    They hold for the constants of the subject.  Raises `InputError` for maps that are not rational, and for degrees
    with more than MOST_MONOMIALS monomials.
    """
    require_few_monomials(subject, degree, MOST_MONOMIALS)

    def sought(attempt: int) -> list[Polynomial | Product]:
        polynomials: list[Polynomial] = []
        for d in range(1, degree + 1):  # modulo the products of those of lower degrees
            # leading monomials first
            exponents = sorted(list(monomials(subject.dim, d))[1:], key=lambda e: (sum(e), e), reverse=True)
            earlier = [expanded([polynomials[i] for i in c]) for c in products([f.degree for f in polynomials], d)]

            def rows(p: int, exponents: list[Exponents] = exponents) -> Array:
                values = _along_orbits(subject, exponents, [seed, attempt], p, len(exponents) + SPARE)
                return (values[1:] - values[:1]).reshape(-1, len(exponents)) % p

            new = [Polynomial(terms, subject.names) for terms in rational_kernel(rows, exponents, earlier)]
            by_length = sorted(new, key=lambda f: len(f.terms))
            polynomials += _independent(subject, by_length, [seed, attempt], polynomials)
        return [*polynomials, *(_quotients(subject, degree, polynomials, [seed, attempt]) if quotients else [])]

    return without_poles(subject.name, sought)


def monomials(dim: int, degree: int) -> Iterable[Exponents]:
    """Exponents with total at most `degree`, the constant first, then by degree."""
    for total in range(degree + 1):
        for places in itertools.combinations_with_replacement(range(dim), total):
            yield tuple(places.count(i) for i in range(dim))


def monomial_values(points: Array, exponents: list[Exponents], p: int | None) -> Array:
    """Monomials (..., count) at points (..., d): of integers modulo p, or of any field without p."""
    zero = (0,) * points.shape[-1]
    values: dict[Exponents, Array] = {zero: np.ones(points.shape[:-1], dtype=np.int64)}
    for e in sorted(exponents, key=sum):
        if e != zero:
            first = next(i for i, k in enumerate(e) if k)
            value = values[(*e[:first], e[first] - 1, *e[first + 1 :])] * points[..., first]
            values[e] = value if p is None else value % p
    return np.stack([np.asarray(values[e], dtype=None if p else object) for e in exponents], -1)


def rational_kernel(
    rows: Callable[[int], Array], labels: list[Any], modulo: list[dict[Any, Fraction]] | None = None
) -> list[dict[Any, Fraction]]:
    """A basis of the rational null space of a matrix that is known modulo primes, `modulo` vectors of it known before.

    rows(p) may belong to other points for each prime.  From two primes; the third must confirm it.
    """
    bases = []
    for p in PRIMES[:2]:
        space = modular.kernel(rows(p), p)
        if modulo:
            vectors = [[residue(vector.get(label, Fraction(0)), p) for label in labels] for vector in modulo]
            spanned, leads = modular.reduced(np.array(vectors, dtype=np.int64), p)
            space = (space - modular.product(space[:, leads], spanned, p)) % p
        bases.append(modular.reduced(space, p)[0])
    if len(bases[0]) != len(bases[1]):
        raise Pole("two primes find null spaces of different size")
    basis, p = [], PRIMES[2]
    third = rows(p) if len(bases[0]) else None
    for pair in zip(*bases, strict=True):
        terms = lift({label: (int(a), int(b)) for label, a, b in zip(labels, *pair, strict=True) if a or b})
        vector = np.array([residue(terms.get(label, Fraction(0)), p) for label in labels]) if terms else None
        if vector is None or ((third * vector % p).sum(1) % p).any():
            raise TooLarge(
                "A result has coefficients too large to be found from two primes. Usual cause: constants that are "
                "floats such as 0.1, or fractions of many digits; give integers or short fractions."
            )
        basis.append(terms)
    return basis


def products(degrees: Sequence[int], most: int) -> Iterator[tuple[int, ...]]:
    """The places of the factors, of these degrees, of all products of total degree at most `most`."""
    for count in range(1, most + 1):
        for chosen in itertools.combinations_with_replacement(range(len(degrees)), count):
            if sum(degrees[i] for i in chosen) <= most:
                yield chosen


def expanded(factors: list[Polynomial]) -> dict[Exponents, Fraction]:
    """A product as terms."""
    return terms_of(math.prod(polynomial(f.terms, f.names) for f in factors))


def polynomial(terms: Mapping[Exponents, Fraction], names: tuple[str, ...]) -> Any:
    """A polynomial of python-flint."""
    return ring(names).from_dict({e: rationals(c) for e, c in terms.items()})


def terms_of(f: Any) -> dict[Exponents, Fraction]:
    """The terms of a polynomial of python-flint."""
    return {tuple(e): fraction(c) for e, c in f.to_dict().items()}


def lift(terms: dict[Any, tuple[int, int]]) -> dict[Any, Fraction]:
    """Integers without a common factor from residues modulo two primes; {} if they are too large."""
    p, q = PRIMES[:2]
    out = {}
    for label, (a, b) in terms.items():
        c = modular.reconstructed((a + p * ((b - a) * pow(p, -1, q) % q)) % (p * q), p * q)
        if c is None:
            return {}
        out[label] = c
    return _primitive(out)


def _primitive(terms: dict[Any, Fraction]) -> dict[Any, Fraction]:
    """Scaled so that the coefficients are integers without a common factor, the largest label's positive."""
    scale = Fraction(math.lcm(*(c.denominator for c in terms.values())), 1)
    scale /= math.gcd(*(int(c * scale) for c in terms.values()))
    leading = max(terms, key=lambda e: (sum(e), e) if isinstance(e[0], int) else e)
    return {e: c * scale * (1 if terms[leading] > 0 else -1) for e, c in terms.items()}


def _along_orbits(subject: Subject, exponents: list[Exponents], seed: list[int], p: int, rows: int) -> Array:
    lanes = -(-rows // STEPS)
    points = np.moveaxis(subject.orbits(p, seed[0] * 1000 + seed[1], lanes, STEPS), 1, -1)
    return monomial_values(points, exponents, p)


def _independent(subject: Subject, functions: list[Any], seed: list[int], earlier: Sequence[Any] = ()) -> list[Any]:
    """Functions whose gradients raise the rank at a random point, modulo a prime."""
    p = PRIMES[2]
    x = subject.point(random_residues(np.random.default_rng([seed[0] * 1000 + seed[1] + 500, p]), p, 1))
    rows = modular.gradients([*earlier, *functions], x, p)
    ranks = [modular.rank(rows[:k], p) if k else 0 for k in range(len(earlier), len(rows) + 1)]
    return [f for f, before, after in zip(functions, ranks, ranks[1:], strict=False) if after > before]


def without_dependent(subject: Subject, functions: list[Any], seed: int = 0) -> list[Any]:
    """Functions that are conserved, without those that depend on functions before them."""
    return without_poles(subject.name, lambda attempt: _independent(subject, functions, [seed, attempt]))


# -- quotients --------------------------------------------------------------------------------------


def _quotients(subject: Subject, degree: int, polynomials: list[Polynomial], seed: list[int]) -> list[Product]:
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

    decomposed = (_decomposed(terms, exponents, subject.names) for terms in rational_kernel(rows, pairs))
    quotients = [q for q in decomposed if q is not None]
    quotients.sort(key=lambda f: (f.degree, sum(len(P.terms) for P, _ in f.factors)))
    return _independent(subject, quotients, seed, [*polynomials])


def _decomposed(
    entries: dict[tuple[int, int], Fraction], exponents: list[Exponents], names: tuple[str, ...]
) -> Product | None:
    """P/Q of a bivector P ^ Q, or None if it is a sum of several: two of its rows span P and Q."""
    A = np.zeros((len(exponents), len(exponents)), dtype=object)
    for (a, b), c in entries.items():
        A[a, b], A[b, a] = c, -c
    i, j = next(iter(entries))
    wedge = np.multiply.outer(A[i], A[j]) - np.multiply.outer(A[j], A[i])
    if (wedge != wedge[i, j] / A[i, j] * A).any():
        return None
    P, Q = (polynomial({e: c for e, c in zip(exponents, A[k], strict=True) if c}, names) for k in (i, j))
    common = P.gcd(Q)
    parts = [Polynomial(_primitive(terms_of(f // common)), names) for f in (P, Q)]
    over, under = sorted(parts, key=lambda f: -len(f.terms))
    return Product(((over, 1), (under, -1)))


# -- integrals that a record states ----------------------------------------------------------------------

LANES = 8  # random points modulo each of two primes: a false integral passes with probability p^-16


@dataclass(frozen=True)
class Stated:
    """One of the functions `Subject.integrals`."""

    subject: Subject
    place: int

    def __call__(self, x: Array) -> Any:
        """The value at coordinates x (d,) of any field."""
        return self.subject.stated(x)[self.place]

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
            old, new = (subject.stated(objects(Mod(v, p) for v in z)) for z in points)
        except (Pole, TypeError):
            return []
        holds = np.array([isinstance(d, Mod) and not np.any(d.v % p) for d in old - new]) & holds
    return [Stated(subject, int(i)) for i in np.flatnonzero(holds)]


# -- integrals in floats ---------------------------------------------------------------------------------

FLOAT_STEPS = 40  # of each orbit
SIZES = (4.0, 2.0, 1.0)  # of the starts, in turn: a quantity that short steps conserve nearly changes on larger orbits
MOTION = 0.03  # least root mean square of the changes of monomials, relative to their size: too little tells nothing
ROUND_OFF = 1e-13  # singular values below it, relative to the largest, are 0
GAP = 1e8  # by which the next one must be larger, so that the vectors of both do not mix beyond RANK
RANK = 1e-7  # singular values below it, relative, do not count in ranks
MOST_IN_FLOATS = 300  # monomials


def fill_leaf(leaf: int, on_leaf: int, involution: bool, tangent: int) -> bool:
    """Whether integrals fill a leaf: half its dimension in involution (Liouville), or by the rank and the tori.

    tangent   rank of the integrals and dimension of the tori that they leave, together
    """
    return leaf > 0 and ((involution and 2 * on_leaf == leaf) or tangent == leaf)


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
    def clear(self) -> bool:
        """Whether a gap separates what is conserved from what is not."""
        return self.next > GAP * self.largest

    @property
    def enough(self) -> bool:
        """Whether they fill a leaf, with a clear gap."""
        return self.clear and fill_leaf(self.leaf, self.on_leaf, self.involution < RANK, self.on_leaf + self.torus)

    def __str__(self) -> str:
        return (
            f"{self.count} independent polynomials of degree {self.degree} or less are conserved in floats, "
            f"{self.on_leaf} on leaves of dimension {self.leaf}; singular values {self.largest:.0e}, then "
            f"{self.next:.0e}{'' if self.clear else ', not a clear gap: use a larger eps'}"
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
            start = float_start(subject, seed + 100 + k, SIZES[k % len(SIZES)])
            orbit = dynamics.points(subject, start, FLOAT_STEPS)
        except RunError as error:
            trouble = str(error)
            continue
        values = np.prod(orbit[:, None, :] ** exponents[None], axis=-1)  # monomials
        rows.append(values[1:] - values[:1])
        scale = np.maximum(scale, np.abs(values).max(0))
    table = np.concatenate(rows)
    if len(table) < wanted:
        raise RunError(trouble or "the orbits are too short")
    if (moved := math.sqrt(np.mean((table / scale) ** 2))) < MOTION:
        raise RunError(
            f"The orbits of {subject.name} move too little in {FLOAT_STEPS} steps to reveal integrals: "
            f"monomials change by {moved:.1g}. Use a larger eps."
        )
    _, sizes, V = np.linalg.svd(table / scale)
    sizes = sizes / sizes[0]
    still, x = int((sizes < ROUND_OFF).sum()), float_start(subject, seed + 7)
    lower = np.maximum(exponents - np.eye(subject.dim, dtype=int)[:, None], 0)  # in each coordinate (d, monomials, d)
    G = V[len(sizes) - still :] / scale @ (exponents * np.prod(x**lower, axis=-1).T)
    pi = np.zeros((subject.dim, subject.dim)) if subject.tensor is None else np.asarray(subject.tensor(x), dtype=float)
    fields, lengths = G @ pi, np.linalg.norm(G, axis=1)
    pairings, size, turn = fields @ G.T, float(np.linalg.norm(G)), float(np.linalg.norm(pi))
    count, on_leaf, leaf, not_commuting = (
        int(np.linalg.matrix_rank(A, tol=RANK * scale))
        for A, scale in ((G, size), (fields, size * turn), (pi, turn), (pairings, size**2 * turn))
    )
    return Numerical(
        degree=degree,
        count=count,
        on_leaf=on_leaf,
        leaf=leaf,
        torus=on_leaf - not_commuting,
        largest=float(sizes[len(sizes) - still]) if still else 0.0,
        next=float(sizes[len(sizes) - still - 1]),
        involution=float((np.abs(pairings) / np.outer(lengths, lengths)).max(initial=0.0)),
    )
