"""How fast a rational map grows: degrees of iterates, heights over Q, cycles over F_p; confinement of singularities.

On a line x = a + t b over F_p each coordinate of an iterate is a rational function of t.  Its values at 2^e points c
w^j, w a root of 1, give its interpolating polynomial; the division with the largest quotient in Euclid's algorithm for
it and t^N - c^N gives numerator and denominator.  A random linear combination has the degree of the map on projective
space. [Bellon, Viallet, Comm. Math. Phys. 204 (1999); maximal quotient: Monagan, ISSAC 2004; heights: Abarenkova et
al., Physica A 264 (1999); cycles: Roberts, Vivaldi, Phys. Rev. Lett. 90 (2003); confinement: Grammaticos, Ramani,
Papageorgiou, Phys. Rev. Lett. 67 (1991)]
"""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.errors import InputError, explained
from kreisel.lab.darboux import jacobian_factors
from kreisel.lab.exact import Field, fractions, rationals, require_flint
from kreisel.lab.integrals import Polynomial
from kreisel.lab.modular import PRIMES, ROOT, Mod, poles_marked, random_residues, reconstructed, residue, without_poles
from kreisel.lab.subject import Subject, stacked
from kreisel.runs.settings import within

FEWEST, MOST = 64, 1 << 13  # points
CERTAIN = 6  # the degree of the largest quotient; by chance it is this large with probability about p^-6 times N
ENTROPY = 0.1  # the least estimate without a recurrence that counts


@dataclass(frozen=True)
class Growth:
    """Degrees of the iterates 0, 1, 2, ... and the verdict on them.

    degrees      d_0 = 1 for a line in the space itself, d_1, ...
    recurrence   integers c with sum_j c_j d_(k+j) = 0 for k >= `after`, found from some and checked on further degrees
    power        the power of k with which they grow, where they grow like one
    entropy      lim log(d_k)/k: log of the largest root of the recurrence, or an estimate
    uncertainty  of the entropy; 0 where a recurrence tells it
    drops        k whose degree is less than d_(k-1) d_1: the iterates have a common factor there
    """

    degrees: tuple[int, ...]
    recurrence: tuple[int, ...] | None
    after: int
    power: int | None
    entropy: float
    uncertainty: float

    @property
    def drops(self) -> tuple[int, ...]:
        """The iterates whose degree is less than the product of the degrees: where singularities confine."""
        d = self.degrees
        return tuple(k for k in range(2, len(d)) if d[k] * d[0] < d[k - 1] * d[1])

    @property
    def exponential(self) -> bool:
        """By the recurrence; without one, by an entropy beyond its uncertainty and a local power that grows."""
        if self.recurrence is not None:
            return self.power is None
        d = self.degrees
        if len(d) < 5 or not self.entropy > max(ENTROPY, 2 * self.uncertainty):
            return False
        powers = [k * math.log(d[k] / d[k - 1]) for k in (len(d) // 2, len(d) - 1)]  # of k, near k
        return powers[1] > 1.1 * powers[0]

    @property
    def estimate(self) -> str:
        """The entropy, with its uncertainty if it has one."""
        return f"{self.entropy:.3g}" if self.recurrence else f"{self.entropy:.2g} ± {self.uncertainty:.1g}"

    @property
    def verdict(self) -> str:
        """One line."""
        shown = ", ".join(map(str, self.degrees))
        if self.recurrence is None:
            estimate = f"entropy {self.entropy:.3g} +- {self.uncertainty:.2g} (no recurrence found)"
            return f"degrees {shown}: {estimate if self.exponential else 'no exponential growth seen, too few to tell'}"
        if self.power is not None:
            return f"degrees {shown}: growth like k^{self.power}, entropy 0"
        return f"degrees {shown}: exponential growth, entropy {self.entropy:.9g}"


@explained
def growth(subject: Subject, iterates: int = 20, seed: int = 0) -> Growth:
    """Degrees of that many iterates of a map, and their growth.  Raises `InputError` for maps that are not rational."""
    return fitted_growth(degrees(subject, iterates, seed))


@explained
def degrees(subject: Subject, iterates: int = 20, seed: int = 0) -> tuple[int, ...]:
    """d_0, d_1, ...; fewer than asked for where a degree is beyond MOST/2.  On two primes, which must agree."""
    within(iterates, "iterates", 0, 10_000)

    def over(p: int) -> tuple[int, ...]:
        return without_poles(subject.name, lambda attempt: _degrees(subject, iterates, [seed, attempt], p))

    sequences = [over(p) for p in PRIMES[:2]]
    if sequences[0] != sequences[1]:  # a prime that divides a leading coefficient gives too small a degree
        sequences.append(over(PRIMES[2]))
    return tuple(max(d) for d in zip(*sequences, strict=len(sequences) == 2))


def _degrees(subject: Subject, iterates: int, seed: list[int], p: int) -> tuple[int, ...]:
    flint, points = require_flint(), FEWEST
    while True:
        rng = np.random.default_rng([*seed, p])  # the same line for any number of points
        coset, weights = int(rng.integers(2, p)), rng.integers(1, p, subject.dim)
        t = coset * _powers(pow(ROOT, (p - 1) // points, p), points, p) % p

        def draw(shape: tuple[int, ...], rng: Any = rng, t: Array = t) -> Array:
            lines = (rng.integers(1, p, 2).tolist() for _ in range(math.prod(shape)))
            return objects((Mod((a + b * t) % p, p) for a, b in lines), shape)

        x, step, sequence = subject.point(draw), subject.over(p), list[int]()
        for k in range(iterates + 1):
            x = step(x) if k else x
            values = sum(int(w) * np.broadcast_to(v.v, points) % p for w, v in zip(weights, x, strict=True)) % p
            degree = _degree(flint, values, coset, p)
            if degree is None:
                break
            sequence.append(degree)
        if len(sequence) > iterates or points == MOST:
            return tuple(sequence)
        points *= 2


def _powers(w: int, count: int, p: int) -> Array:
    out = np.ones(count, dtype=np.int64)
    done = 1
    while done < count:
        out[done : 2 * done] = out[:done] * pow(w, done, p) % p
        done *= 2
    return out


def _transform(values: Array, p: int) -> Array:
    """sum_j values_j w^(-jk), w a root of 1 of the order of their number, a power of 2."""
    n = len(values)
    out = values[:, None]  # row r: the transform of values[r :: rows]
    while len(out) > 1:
        half, length = len(out) // 2, out.shape[1]
        w = pow(ROOT, (p - 1) - (p - 1) // (2 * length), p)
        even, odd = out[:half], out[half:] * _powers(w, length, p) % p
        out = np.concatenate([(even + odd) % p, (even - odd) % p], 1)
    return out.reshape(n)


def _degree(flint: Any, values: Array, coset: int, p: int) -> int | None:
    """The degree of the rational function with these values at coset w^j; None if they are too few."""
    n = len(values)
    scaled = _transform(values, p) * pow(n, -1, p) % p * _powers(pow(coset, -1, p), n, p) % p
    r0 = flint.nmod_poly([-pow(coset, n, p) % p] + [0] * (n - 1) + [1], p)
    r1 = flint.nmod_poly([int(c) for c in scaled], p)
    largest, degree = -1, 0
    while True:
        quotient = r0.degree() - max(r1.degree(), 0)
        if quotient > largest:
            largest, degree = quotient, max(r1.degree(), n - r0.degree(), 0)
        if r1.degree() <= 0:
            break
        r0, r1 = r1, r0 % r1
    return degree if largest >= CERTAIN else None


# -- the verdict on degrees -------------------------------------------------------------------------


def fitted_growth(d: tuple[int, ...]) -> Growth:
    """The growth of a sequence of degrees: by a linear recurrence that further terms confirm, else by estimates."""
    for after in range(max(1, len(d) // 3)):
        if recurrence := _recurrence(d[after:]):
            power, entropy = _roots(recurrence)
            return Growth(d, recurrence, after, power, entropy, 0.0)
    late = [math.log(b / a) for a, b in zip(d[len(d) // 2 :], d[len(d) // 2 + 1 :], strict=False) if a > 0 and b > 0]
    if len(late) < 2:
        return Growth(d, None, 0, None, late[-1] if late else math.nan, math.inf)
    return Growth(d, None, 0, None, late[-1], max(late) - min(late) + abs(late[-1] - late[0]))


def _recurrence(d: tuple[int, ...]) -> tuple[int, ...] | None:
    """The shortest recurrence over the integers, if at least three terms more than it needs confirm it.

    That of a polynomial in k, (x - 1)^order, first: six degrees tell that they are 2k^2 + 1, where one of unknown
    coefficients needs nine.
    """
    for order in range(1, len(d) - 2):
        if not np.diff(np.array(d, dtype=object), order).any():
            return tuple((-1) ** (order - j) * math.comb(order, j) for j in range(order + 1))
    for order in range(1, (len(d) - 3) // 2 + 1):
        rows = [list(d[k : k + order + 1]) for k in range(len(d) - order)]
        kernel, nullity = require_flint().fmpz_mat(rows).nullspace()
        column = [int(kernel[i, 0]) for i in range(order + 1)]
        if nullity == 1 and column[-1]:
            scale = math.gcd(*column) * (1 if column[-1] > 0 else -1)
            return tuple(c // scale for c in column)
    return None


def _roots(recurrence: tuple[int, ...]) -> tuple[int | None, float]:
    """The power of k, or the logarithm of the largest root.  Roots of 1 are found exactly, by cyclotomic factors."""
    flint = require_flint()
    multiplicity, largest = 0, 1.0
    for factor, power in flint.fmpz_poly(list(recurrence)).factor()[1]:
        if factor.degree() == 1 and factor[0] == 0:
            continue
        if factor.is_cyclotomic():
            multiplicity = max(multiplicity, power)
        else:
            largest = max(largest, *(abs(complex(z.real, z.imag)) for z, _ in factor.complex_roots()))
    return (multiplicity - 1, 0.0) if largest <= 1 else (None, math.log(largest))


# -- heights over Q, cycles modulo p ---------------------------------------------------------------------

MOST_BITS = 2_000_000
LARGEST_PRIME = 1 << 20


@dataclass(frozen=True)
class Heights:
    """Bits of the largest numerator or denominator at steps 0, 1, ..., and how they grow.

    power    of the step, over the second half of the orbit;  entropy  log of the last ratio
    """

    bits: tuple[int, ...]

    @property
    def power(self) -> float:
        """The slope of log bits against log step over the second half."""
        half = max(1, len(self.bits) // 2)
        k = np.arange(half, len(self.bits))
        return float(np.polyfit(np.log(k), np.log(np.maximum(self.bits[half:], 1)), 1)[0])

    @property
    def entropy(self) -> float:
        """The logarithm of the growth in the last step."""
        return math.log(self.bits[-1] / max(1, self.bits[-2]))


def exact_orbit(subject: Subject, x: Any, steps: int) -> list[Array]:
    """The orbit over Q from integers and fractions x (d,), each point an object array of Fractions.

    Raises `InputError` at a pole, and if the coordinates get too large.
    """
    x = np.asarray(x, dtype=object)
    subject.require_rational(x)
    constants, x, out = {k: rationals(v) for k, v in subject.constants.items()}, rationals(x), []
    for k in range(steps + 1):
        try:
            try:
                x = np.asarray(subject.step(x, **constants), dtype=object) if k else x
            except TypeError:  # a Fraction of the step does not multiply values of python-flint
                x, constants = fractions(x), dict(subject.constants)
                x = np.asarray(subject.step(x, **constants), dtype=object)
        except ZeroDivisionError:
            raise InputError(f"The orbit of {subject.name} meets a pole at step {k}. Choose another start.") from None
        out.append(fractions(x))
        if _bits(out[-1]) > MOST_BITS:
            raise InputError(
                f"The values of {subject.name} have {_bits(out[-1]):,} bits at step {k}: ask for fewer steps."
            )
    return out


@explained
def heights(subject: Subject, x: Any, steps: int = 20) -> Heights:
    """The heights along the orbit over Q from x.  Raises `InputError` as `exact_orbit` does."""
    return Heights(tuple(_bits(point) for point in exact_orbit(subject, x, within(steps, "steps", 2))))


def _bits(point: Array) -> int:
    return max(max(abs(c.numerator).bit_length(), c.denominator.bit_length()) for c in map(Fraction, point))


@dataclass(frozen=True)
class Cycles:
    """Lengths of the cycles modulo p of random points; `poles` ran into a division by 0, `open` beyond the limit."""

    p: int
    lengths: tuple[int, ...]
    poles: int
    open: int

    @property
    def longest(self) -> int:
        """The longest cycle that was closed."""
        return max(self.lengths, default=0)

    @property
    def hasse_weil(self) -> float:
        """The most points of a curve of genus 1: p + 1 + 2 sqrt(p)."""
        return self.p + 1 + 2 * math.sqrt(self.p)


@explained
def cycles(subject: Subject, p: int, starts: int = 200, limit: int | None = None, seed: int = 0) -> Cycles:
    """Cycles modulo a prime p from random points, followed for at most `limit` steps, by default 10 p.

    Raises `InputError` for p that is not a prime, too small or too large, or divides a denominator of the constants.
    """
    p = within(p, "p", 3, LARGEST_PRIME)
    if not all(p % q for q in range(2, math.isqrt(p) + 1)):
        raise InputError(f"p must be a prime from 3 to {LARGEST_PRIME:,}, got {p}.")
    try:
        step = subject.over(p)
    except ArithmeticError as error:
        raise InputError(f"{error}: choose another prime.") from None
    rng = np.random.default_rng([seed, p])
    with poles_marked(starts) as dead:
        first = stacked(subject.point(random_residues(rng, p, starts, least=0)), starts)
        dead[:] = False
        x, lengths = first.copy(), np.zeros(starts, dtype=int)
        gone = np.zeros(starts, dtype=bool)
        for k in range(1, (limit or 10 * p) + 1):
            x = stacked(step(objects(Mod(row, p) for row in x)), starts)
            gone |= dead & (lengths == 0)
            back = (x == first).all(0) & ~gone & (lengths == 0)
            lengths[back] = k
            if (gone | (lengths > 0)).all():
                break
    closed = lengths > 0
    return Cycles(p, tuple(lengths[closed].tolist()), int(gone.sum()), int((~closed & ~gone).sum()))


# -- confinement of singularities ------------------------------------------------------------------------

TERMS = 40  # of a series; cancellations use them up
LARGEST = 1000  # numerator and denominator of a limit that is shown
INFINITY, FREE, OTHER = "oo", "*", "c"


class Series(Field):
    """s^v (c_0 + c_1 s + ...) modulo p, c_0 not 0 unless it is 0 as far as it is known."""

    __slots__ = ("c", "p", "v")

    def __init__(self, v: int, c: list[int], p: int):
        lead = next((i for i, a in enumerate(c) if a), len(c))
        self.v, self.c, self.p = v + lead, c[lead:], p

    def _of(self, operand: Any) -> Series:
        if isinstance(operand, Series):
            return operand
        first = int(operand.v) if isinstance(operand, Mod) else residue(operand, self.p)
        return Series(0, [first, *[0] * (TERMS - 1)], self.p)

    def _plus(self, operand: Series) -> Series:
        v, end = min(self.v, operand.v), min(self.v + len(self.c), operand.v + len(operand.c))
        total = np.zeros(max(0, end - v), dtype=np.int64)
        for series in (self, operand):
            terms = series.c[: max(0, end - series.v)]
            total[series.v - v : series.v - v + len(terms)] += np.array(terms, dtype=np.int64)
        return Series(v, (total % self.p).tolist(), self.p)

    def __neg__(self) -> Series:
        return Series(self.v, [-x % self.p for x in self.c], self.p)

    def _times(self, operand: Series) -> Series:
        flint, count = require_flint(), min(len(self.c), len(operand.c))
        product = flint.nmod_poly(self.c[:count], self.p) * flint.nmod_poly(operand.c[:count], self.p)
        return Series(self.v + operand.v, [int(product[i]) for i in range(count)], self.p)

    def _inverse(self) -> Series:
        if not self.c:
            raise ZeroDivisionError("no terms of a series are left")
        inverse = require_flint().nmod_poly(self.c, self.p).inverse_series_trunc(len(self.c))
        return Series(-self.v, [int(inverse[i]) for i in range(len(self.c))], self.p)

    @property
    def limit(self) -> int | None:
        """The value at s = 0, None at infinity."""
        if not self.c and self.v <= 0:
            raise ZeroDivisionError("no terms of a series are left")
        return 0 if self.v > 0 else None if self.v < 0 else self.c[0]


@dataclass(frozen=True)
class Singularity:
    """A contracted curve, the limits of its iterates, and after how many it is a curve again (0: not in `steps`).

    pattern    the limits of x, x', x'', ...: a number, oo, c for an algebraic one, * where it depends on the point
    """

    curve: Polynomial
    pattern: tuple[tuple[str, ...], ...]
    confined: int
    steps: int

    def __str__(self) -> str:
        orbit = " -> ".join(f"({', '.join(point)})" for point in self.pattern)
        return f"{self.curve} = 0: {orbit}" + ("" if self.confined else f" -> ..., not confined in {self.steps} steps")


@explained
def singularities(subject: Subject, steps: int = 12, seed: int = 0) -> list[Singularity]:
    """The curves that a map of the plane contracts to a point of P^1 x P^1, with their orbits.

    Raises `InputError` for other maps, and for a curve without points modulo many primes.
    """
    within(steps, "steps")
    if subject.dim != 2:
        raise InputError(f"Singularities are followed in the plane, got {subject.dim} coordinates.")
    followed = (_followed(subject, f, steps, seed) for f in jacobian_factors(subject))
    return [s for s in followed if s is not None]


def _followed(subject: Subject, curve: Polynomial, steps: int, seed: int) -> Singularity | None:
    rng = np.random.default_rng([seed, 29])
    p, starts = _on_curve(curve, rng)
    step, orbits = subject.over(p), []
    for start in starts:
        slope = [int(v) for v in rng.integers(1, p, 2)]
        x = objects(Series(0, [a, b, *[0] * (TERMS - 2)], p) for a, b in zip(start, slope, strict=True))
        orbits.append([[s.limit for s in x]])
        with suppress(ZeroDivisionError):
            for _ in range(steps):
                x = step(x)
                orbits[-1].append([s.limit for s in x])

    def shown(x: int | None, y: int | None) -> str:
        if x != y or x is None:
            return FREE if x != y else INFINITY
        q = reconstructed(x, p)
        return str(q) if q is not None and max(abs(q.numerator), q.denominator) < LARGEST else OTHER

    def compared(pair: tuple[list[list[int | None]], ...]) -> list[tuple[str, ...]]:
        return [tuple(map(shown, *limits)) for limits in zip(*pair, strict=False)]

    # x^2 = 2 y^2 are two lines, each contracted to another point: of more points than lines two are on one
    points = min(map(compared, itertools.combinations(orbits, 2)), key=lambda points: str(points).count(FREE))
    free = [FREE in point for point in points]
    if all(free[:2]):
        return None  # not contracted
    again = next((k for k in range(2, len(free)) if free[k] and not free[k - 1]), 0)
    return Singularity(curve, tuple(points[: (again or 6) + 1]), again, len(points) - 1)


def _on_curve(curve: Polynomial, rng: np.random.Generator) -> tuple[int, list[list[int]]]:
    """A prime and points of the curve modulo it, more than its degree: an irreducible curve may have none for some."""
    flint = require_flint()
    place = int(any(e[1] for e in curve.terms))
    further = (p for p in range(2**29 + 1, 2**29 + 4000, 2) if flint.fmpz(p).is_prime())
    for p in itertools.chain(PRIMES, further):
        points = []
        for _ in range(60):
            drawn = int(rng.integers(1, p))
            coefficients: dict[int, int] = {}
            for e, c in curve.terms.items():
                term = residue(c, p) * pow(drawn, e[1 - place], p)
                coefficients[e[place]] = (coefficients.get(e[place], 0) + term) % p
            polynomial = flint.nmod_poly([coefficients.get(k, 0) for k in range(max(coefficients) + 1)], p)
            if roots := polynomial.roots():
                root = int(roots[0][0])
                points.append([drawn, root] if place else [root, drawn])
            if len(points) > curve.degree:
                return p, points
    raise InputError(f"The curve {curve} = 0 has no points modulo many primes: it was not followed.")
