"""Exact numbers for experiments: residues modulo a prime, many at once, and the rationals behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.algebra.ring import Ring
from kreisel.errors import InputError, shown

# p = k 2^e + 1 below 2^30, with 3 as a primitive root: products of residues fit 64 bits, and 2^e-th roots of 1 exist
PRIMES = (998244353, 469762049, 167772161)
ROOT = 3


class Pole(ArithmeticError):
    """A division by 0 at one of the points: another seed, or another prime, avoids it."""


_MARKS: list[Any] = []


@contextmanager
def poles_marked(lanes: int) -> Iterator[Any]:
    """Within, a division by 0 marks its lane in the array that this gives, and goes on with 1."""
    marks = np.zeros(lanes, dtype=bool)
    _MARKS.append(marks)
    try:
        yield marks
    finally:
        _MARKS.pop()


class Mod(Ring):
    """An array of residues modulo p that behaves as one number: the same arithmetic at many points."""

    __slots__ = ("p", "v")
    ordered: ClassVar[bool] = False

    def __init__(self, v: Any, p: int):
        self.v, self.p = v, p

    def __add__(self, other: Any) -> Any:
        n = _operand(other, self.p)
        return n if n is NotImplemented else Mod((self.v + n) % self.p, self.p)

    def __neg__(self) -> Mod:
        return Mod(-self.v % self.p, self.p)

    def __sub__(self, other: Any) -> Any:
        n = _operand(other, self.p)
        return n if n is NotImplemented else Mod((self.v - n) % self.p, self.p)

    def __mul__(self, other: Any) -> Any:
        n = _operand(other, self.p)
        return n if n is NotImplemented else Mod(self.v * n % self.p, self.p)

    def __pow__(self, exponent: int) -> Mod:
        return Mod(_power_modulo(self.v, exponent, self.p), self.p)

    def inverse(self) -> Mod:
        v = self.v
        if not np.all(v):
            if not _MARKS:
                raise Pole("division by 0 modulo a prime")
            _MARKS[-1][...] |= v == 0
            v = np.where(v == 0, 1, v)
        return Mod(_power_modulo(v, self.p - 2, self.p), self.p)

    def __truediv__(self, other: Any) -> Any:
        n = _operand(other, self.p)
        return n if n is NotImplemented else self * Mod(n, self.p).inverse()

    def __rtruediv__(self, other: Any) -> Mod:
        return self.inverse() * other

    def __bool__(self) -> bool:  # also for <, > and the like
        raise TypeError("a comparison: the step is not a rational function, which exact experiments need")

    def __lt__(self, other: Any) -> bool:
        return bool(self)

    __gt__ = __le__ = __ge__ = __lt__

    def __float__(self) -> float:
        raise TypeError("a conversion to float: the step is not a rational function, which exact experiments need")


def _operand(other: Any, p: int) -> Any:
    """The residues of a number; NotImplemented for arrays and for numbers made of residues, which know what to do."""
    if isinstance(other, Mod):
        return other.v
    known = isinstance(other, int | Fraction | np.integer) or (hasattr(other, "q") and hasattr(other, "p"))
    return residue(other, p) if known else NotImplemented


def _power_modulo(base: Any, exponent: int, p: int) -> Any:
    out = base * 0 + 1
    while exponent:
        if exponent & 1:
            out = out * base % p
        base = base * base % p
        exponent >>= 1
    return out


def fraction(x: Any) -> Fraction:
    """An integer, a fraction of any library or a float, as it is, as a Fraction.  Raises `InputError` for others."""
    if hasattr(x, "q") and hasattr(x, "p"):  # python-flint
        return Fraction(int(x.p), int(x.q))
    try:
        return Fraction(x.item() if isinstance(x, np.generic) else x)
    except (ValueError, TypeError, ZeroDivisionError, OverflowError):
        raise InputError(f"A whole number or a fraction such as 1/3 was expected, got {shown(x)}.") from None


def residue(x: Any, p: int) -> int:
    """A rational number modulo p.  Raises `Pole` where p divides the denominator."""
    q = fraction(x)
    if q.denominator % p == 0:
        raise Pole(f"{p} divides the denominator of {q}")
    return q.numerator * pow(q.denominator, -1, p) % p


def residues(x: Array, p: int) -> Array:
    """An array of rational numbers as residues, each one number."""
    return objects((Mod(np.int64(residue(v, p)), p) for v in np.asarray(x).flat), np.shape(x))


def random_residues(rng: np.random.Generator, p: int, points: int) -> Callable[[tuple[int, ...]], Array]:
    """draw(shape): arrays of numbers, each at `points` points."""

    def draw(shape: tuple[int, ...]) -> Array:
        return objects((Mod(rng.integers(1, p, points), p) for _ in range(math.prod(shape))), shape)

    return draw


def reconstructed(r: int, p: int) -> Fraction | None:
    """The rational number of least size that is r modulo p, None where none is small (Wang's reconstruction)."""
    bound = int((p // 2) ** 0.5)
    a, b, s, t = p, r % p, 0, 1
    while b > bound:
        a, b, s, t = b, a % b, t, s - a // b * t
    if t == 0 or abs(t) > bound:
        return None
    return Fraction(b, t)


def require_flint() -> Any:
    """python-flint.  Raises `InputError` where it is not installed."""
    try:
        import flint
    except ImportError as error:
        raise InputError(
            "This experiment needs python-flint, which is missing. Install it with: pip install 'kreisel[exact]'"
        ) from error
    return flint
