"""Singularity confinement of a map of the plane, with the orbit of each singularity.

A curve on which det f' vanishes, or has a pole, may be contracted to a point.  From a point of it, moved away by s,
the iterates are Laurent series in s over F_p; their limits for s -> 0, at two points of the curve, tell whether the
position on the curve is lost, and whether a later iterate has it again: then the singularity is confined.
[Grammaticos, Ramani, Papageorgiou, Phys. Rev. Lett. 67 (1991)]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.algebra.ring import Ring
from kreisel.errors import InputError
from kreisel.lab.darboux import jacobian_factors
from kreisel.lab.fields import PRIMES, fraction, reconstructed, require_flint, residue
from kreisel.lab.integrals import Polynomial
from kreisel.lab.subject import Subject

TERMS = 40  # of a series; cancellations use them up
LARGEST = 1000  # numerator and denominator of a limit that is shown
INFINITY, FREE, OTHER = "oo", "*", "c"


class Series(Ring):
    """s^v (c_0 + c_1 s + ...) modulo p, c_0 not 0 unless it is 0 as far as it is known."""

    __slots__ = ("c", "p", "v")

    def __init__(self, v: int, c: list[int], p: int):
        lead = next((i for i, a in enumerate(c) if a), len(c))
        self.v, self.c, self.p = v + lead, c[lead:], p

    def _other(self, other: Any) -> Series:
        if isinstance(other, Series):
            return other
        return Series(0, [residue(fraction(other), self.p), *[0] * (TERMS - 1)], self.p)

    def __add__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented
        a, b = self, self._other(other)
        end, v = min(a.v + len(a.c), b.v + len(b.c)), min(a.v, b.v)
        total = [0] * max(0, end - v)
        for part in (a, b):
            for i, x in enumerate(part.c[: max(0, end - part.v)]):
                total[part.v - v + i] = (total[part.v - v + i] + x) % self.p
        return Series(v, total, self.p)

    def __neg__(self) -> Series:
        return Series(self.v, [-x % self.p for x in self.c], self.p)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented
        b = self._other(other)
        count = min(len(self.c), len(b.c))
        flint = require_flint()
        product = flint.nmod_poly(self.c[:count], self.p) * flint.nmod_poly(b.c[:count], self.p)
        return Series(self.v + b.v, [int(product[i]) for i in range(count)], self.p)

    def __truediv__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else self * self._other(other)._inverse()

    def __rtruediv__(self, other: Any) -> Any:
        return self._other(other) * self._inverse()

    def _inverse(self) -> Series:
        if not self.c:
            raise ZeroDivisionError("no terms of a series are left")
        out = [pow(self.c[0], -1, self.p)]
        for k in range(1, len(self.c)):
            out.append(-out[0] * sum(self.c[i] * out[k - i] for i in range(1, k + 1)) % self.p)
        return Series(-self.v, out, self.p)

    def __pow__(self, exponent: int) -> Any:
        out = self._other(1)
        for _ in range(exponent):
            out = out * self
        return out

    @property
    def limit(self) -> int | None:
        """The value at s = 0, None at infinity."""
        if not self.c and self.v <= 0:
            raise ZeroDivisionError("no terms of a series are left")
        return 0 if self.v > 0 else None if self.v < 0 else self.c[0]


@dataclass(frozen=True)
class Singularity:
    """A contracted curve, the limits of its iterates, and after how many it is a curve again (0: not in those).

    pattern    the limits of x, x', x'', ...: a number, oo, c for an algebraic one, * where it depends on the point
    """

    curve: Polynomial
    pattern: tuple[tuple[str, ...], ...]
    confined: int

    def __str__(self) -> str:
        orbit = " -> ".join(f"({', '.join(point)})" for point in self.pattern)
        return f"{self.curve} = 0: {orbit}" + ("" if self.confined else " -> ..., not confined")


def singularities(what: Subject, steps: int = 12, seed: int = 0) -> list[Singularity]:
    """The curves that a map of the plane contracts, with their orbits.  Raises `InputError` for other maps."""
    if what.dim != 2:
        raise InputError(f"Singularities are followed in the plane, got {what.dim} coordinates.")
    return [s for f in jacobian_factors(what) for s in [_followed(what, f, steps, seed)] if s is not None]


def _followed(what: Subject, curve: Polynomial, steps: int, seed: int) -> Singularity | None:
    p = PRIMES[0]
    rng = np.random.default_rng([seed, 29])
    starts = [_on_curve(curve, p, rng) for _ in range(2)]
    if None in starts:
        return None
    orbits = []
    for start in starts:
        assert start is not None
        slope = [int(v) for v in rng.integers(1, p, 2)]
        x = np.array(
            [Series(0, [a, b, *[0] * (TERMS - 2)], p) for a, b in zip(start, slope, strict=True)], dtype=object
        )
        orbits.append([[s.limit for s in x]])
        try:
            for _ in range(steps):
                x = what.over(p)(x)
                orbits[-1].append([s.limit for s in x])
        except ZeroDivisionError:
            pass
    points = [_shown(*pair) for pair in zip(*orbits, strict=False)]
    free = [FREE in point for point in points]
    if all(free[:2]):
        return None  # not contracted
    again = next((k for k in range(2, len(free)) if free[k] and not free[k - 1]), 0)
    return Singularity(curve, tuple(points[: (again or 6) + 1]), again)


def _on_curve(curve: Polynomial, p: int, rng: np.random.Generator) -> list[int] | None:
    """A point of it modulo p."""
    flint = require_flint()
    for _ in range(60):
        known, place = int(rng.integers(1, p)), int(any(e[1] for e in curve.terms))
        coefficients: dict[int, int] = {}
        for e, c in curve.terms.items():
            term = residue(c, p) * pow(known, e[1 - place], p)
            coefficients[e[place]] = (coefficients.get(e[place], 0) + term) % p
        polynomial = flint.nmod_poly([coefficients.get(k, 0) for k in range(max(coefficients) + 1)], p)
        roots = [f for f, _ in polynomial.factor()[1] if f.degree() == 1]
        if roots:
            root = -int(roots[0][0]) % p
            return [known, root] if place else [root, known]
    return None


def _shown(a: list[int | None], b: list[int | None]) -> tuple[str, ...]:
    return tuple(_limit(x, y) for x, y in zip(a, b, strict=True))


def _limit(x: int | None, y: int | None) -> str:
    if x != y:
        return FREE
    if x is None:
        return INFINITY
    q = reconstructed(x, PRIMES[0])
    return str(q) if q is not None and max(abs(q.numerator), q.denominator) < LARGEST else OTHER


__all__ = ["Series", "Singularity", "singularities"]
