"""Degree growth of a rational map: the degrees of its iterates, and how fast they grow.

On a line x = a + t b over F_p each coordinate of the k-th iterate is a rational function of t.  Its values at 2^e
points c w^j, w a root of 1, give its interpolating polynomial; the division with the largest quotient in Euclid's
algorithm for it and t^N - c^N gives numerator and denominator.  A random linear combination of the coordinates has the
degree of the map on projective space.  Degrees that grow like a power mean integrability, algebraic entropy
lim log(d_k)/k > 0 the lack of it.  [Bellon, Viallet, Algebraic entropy, Comm. Math. Phys. 204 (1999); maximal quotient:
Monagan, ISSAC 2004]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.errors import InputError
from kreisel.lab.fields import PRIMES, ROOT, Mod, Pole, require_flint
from kreisel.lab.subject import Subject

FEWEST, MOST = 64, 1 << 13  # points
CERTAIN = 6  # the degree of the largest quotient; by chance it is this large with probability about p^-6 times N
ATTEMPTS = 5
ENTROPY = 0.1  # the least estimate without a recurrence that counts


@dataclass(frozen=True)
class Growth:
    """Degrees of the iterates 0, 1, 2, ... and what they say.

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
    def verdict(self) -> str:
        """One line."""
        shown = ", ".join(map(str, self.degrees))
        if self.recurrence is None:
            estimate = f"entropy {self.entropy:.3g} +- {self.uncertainty:.2g} (no recurrence found)"
            return f"degrees {shown}: {estimate if self.exponential else 'no exponential growth seen, too few to tell'}"
        if self.power is not None:
            return f"degrees {shown}: growth like k^{self.power}, entropy 0"
        return f"degrees {shown}: exponential growth, entropy {self.entropy:.9g}"


def growth(what: Subject, iterates: int = 20, seed: int = 0) -> Growth:
    """Degrees of that many iterates of a map, and their growth.  Raises `InputError` for maps that are not rational."""
    return fitted_growth(degrees(what, iterates, seed))


def degrees(what: Subject, iterates: int = 20, seed: int = 0) -> tuple[int, ...]:
    """d_0, d_1, ...; fewer than asked for where a degree is beyond MOST/2.  On two primes, which must agree."""
    found = [_with_other_seeds(what, iterates, seed, p) for p in PRIMES[:2]]
    if found[0] != found[1]:  # a prime that divides a leading coefficient gives too small a degree
        found.append(_with_other_seeds(what, iterates, seed, PRIMES[2]))
        return tuple(max(d) for d in zip(*found, strict=False))
    return found[0]


def _with_other_seeds(what: Subject, iterates: int, seed: int, p: int) -> tuple[int, ...]:
    for attempt in range(ATTEMPTS):
        try:
            return _degrees(what, iterates, [seed, attempt], p)
        except Pole as error:
            trouble = error
    raise InputError(
        f"{what.name} divides by 0 from {ATTEMPTS} random starts modulo {p} ({trouble}). Usual cause: a denominator "
        "that vanishes identically, or constants whose denominators the prime divides."
    )


def _degrees(what: Subject, iterates: int, seed: list[int], p: int) -> tuple[int, ...]:
    flint, points = require_flint(), FEWEST
    while True:
        rng = np.random.default_rng([*seed, p])  # the same line for any number of points
        coset, weights = int(rng.integers(2, p)), rng.integers(1, p, what.dim)
        t = coset * _powers(pow(ROOT, (p - 1) // points, p), points, p) % p

        def draw(shape: tuple[int, ...], rng: Any = rng, t: Array = t) -> Array:
            lines = (rng.integers(1, p, 2).tolist() for _ in range(math.prod(shape)))
            return objects((Mod((a + b * t) % p, p) for a, b in lines), shape)

        x, step, found = what.point(draw), what.over(p), list[int]()
        for k in range(iterates + 1):
            x = step(x) if k else x
            values = sum(int(w) * np.broadcast_to(v.v, points) % p for w, v in zip(weights, x, strict=True)) % p
            degree = _degree(flint, values, coset, p)
            if degree is None:
                break
            found.append(degree)
        if len(found) > iterates or points == MOST:
            return tuple(found)
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
    """The degree of the rational function with these values at coset w^j; None where they are too few."""
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


# -- what the degrees say ---------------------------------------------------------------------------


def fitted_growth(d: tuple[int, ...]) -> Growth:
    """The growth of a sequence of degrees: by a linear recurrence that further terms confirm, else by estimates."""
    for after in range(max(1, len(d) // 3)):
        found = _polynomial(d[after:]) or _recurrence(d[after:])
        if found is not None:
            power, entropy = _roots(found)
            return Growth(d, found, after, power, entropy, 0.0)
    late = [math.log(b / a) for a, b in zip(d[len(d) // 2 :], d[len(d) // 2 + 1 :], strict=False) if a > 0 and b > 0]
    if not late:
        return Growth(d, None, 0, None, math.nan, math.inf)
    return Growth(d, None, 0, None, late[-1], max(late) - min(late) + abs(late[-1] - late[0]))


def _polynomial(d: tuple[int, ...]) -> tuple[int, ...] | None:
    """The recurrence of a polynomial in k, (x - 1)^order, if three terms more than its coefficients confirm it.

    Six degrees tell that they are 2k^2 + 1, where a recurrence of unknown coefficients takes nine.
    """
    for order in range(1, len(d) - 2):
        if not np.diff(np.array(d, dtype=object), order).any():
            return tuple((-1) ** (order - j) * math.comb(order, j) for j in range(order + 1))
    return None


def _recurrence(d: tuple[int, ...]) -> tuple[int, ...] | None:
    """The shortest recurrence over the integers, if at least three terms more than it needs confirm it."""
    flint = require_flint()
    for order in range(1, (len(d) - 3) // 2 + 1):
        rows = [list(d[k : k + order + 1]) for k in range(len(d) - order)]
        kernel, nullity = flint.fmpz_mat(rows).nullspace()
        if nullity == 1:
            column = [int(kernel[i, 0]) for i in range(order + 1)]
            scale = math.gcd(*column) * (1 if column[-1] > 0 else -1)
            if column[-1]:
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
