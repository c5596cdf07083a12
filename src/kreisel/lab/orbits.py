"""Exact orbits: how their numbers grow over Q, and how long their cycles are over a finite field.

Over Q the height of a point, the digits of its numerators and denominators, grows like the degrees of the iterates:
like a power of the step for an integrable map, exponentially otherwise.  [Abarenkova et al., Physica A 264 (1999)]

Over F_p every orbit of an invertible map is a cycle or runs into a pole.  Where orbits lie on curves of genus 1 a cycle
has at most p + 1 + 2 sqrt(p) points (Hasse, Weil); a map without integrals permutes all p^d points like one at random.
[Roberts, Vivaldi, Phys. Rev. Lett. 90 (2003)]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.errors import InputError
from kreisel.lab.exact import rational
from kreisel.lab.fields import Mod, fraction, poles_marked
from kreisel.lab.subject import Subject

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


def exact_orbit(what: Subject, x: Any, steps: int) -> list[Array]:
    """The orbit over Q from whole numbers and fractions x (d,), each point an object array of Fractions.

    Raises `InputError` at a pole, and where the numbers get too large.
    """
    x = np.asarray(x, dtype=object)
    if x.shape != (what.dim,):
        raise InputError(f"A start is {what.dim} numbers, {', '.join(what.names)}, got shape {x.shape}.")
    if what.implicit:
        raise InputError(f"{what.implicit}: its orbits are not rational. Choose an explicit map.")
    known = {k: _rationals(v) for k, v in what.constants.items()}
    x, out = _rationals(x), []
    for k in range(steps + 1):
        if k:
            try:
                x = np.asarray(what.step(x, **known), dtype=object)
            except ZeroDivisionError:
                raise InputError(f"The orbit of {what.name} meets a pole at step {k}. Choose another start.") from None
        out.append(np.vectorize(fraction, otypes=[object])(x))
        if _bits(out[-1]) > MOST_BITS:
            raise InputError(
                f"The numbers of {what.name} have {_bits(out[-1]):,} bits at step {k}: ask for fewer steps."
            )
    return out


def heights(what: Subject, x: Any, steps: int = 20) -> Heights:
    """The heights along the orbit over Q from x.  Raises `InputError` as `exact_orbit` does."""
    return Heights(tuple(_bits(point) for point in exact_orbit(what, x, steps)))


def _rationals(v: Any) -> Any:
    def one(c: Any) -> Any:
        q = fraction(c)
        return rational(q.numerator, q.denominator)

    return np.vectorize(one, otypes=[object])(v)[()]


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


def cycles(what: Subject, p: int, starts: int = 200, limit: int | None = None, seed: int = 0) -> Cycles:
    """Cycles modulo a prime p from random points, followed for at most `limit` steps, by default 10 p.

    Raises `InputError` for p that is no prime, too small or too large, or divides a denominator of the constants.
    """
    if not (3 <= p <= LARGEST_PRIME and all(p % q for q in range(2, math.isqrt(p) + 1))):
        raise InputError(f"p must be a prime from 3 to {LARGEST_PRIME:,}, got {p}.")
    try:
        step = what.over(p)
    except ArithmeticError as error:
        raise InputError(f"{error}: choose another prime.") from None
    rng = np.random.default_rng([seed, p])
    with poles_marked(starts) as dead:
        first = what.point(lambda shape: _residues(rng, p, starts, shape))
        first = np.stack([np.broadcast_to(v.v, starts) for v in first])
        dead[:] = False
        x, lengths = first.copy(), np.zeros(starts, dtype=int)
        gone = np.zeros(starts, dtype=bool)
        for k in range(1, (limit or 10 * p) + 1):
            new = step(np.array([Mod(row, p) for row in x], dtype=object))
            x = np.stack([np.broadcast_to(v.v, starts) for v in new])
            gone |= dead & (lengths == 0)
            back = (x == first).all(0) & ~gone & (lengths == 0)
            lengths[back] = k
            if (gone | (lengths > 0)).all():
                break
    closed = lengths > 0
    return Cycles(p, tuple(lengths[closed].tolist()), int(gone.sum()), int((~closed & ~gone).sum()))


def _residues(rng: np.random.Generator, p: int, starts: int, shape: tuple[int, ...]) -> Array:
    return objects((Mod(rng.integers(0, p, starts), p) for _ in range(math.prod(shape))), shape)
