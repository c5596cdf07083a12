"""Residues modulo primes as numbers, the same arithmetic at many points, and linear algebra of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any, ClassVar, TypeVar

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.algebra.backend import Ring
from kreisel.errors import InputError
from kreisel.lab.exact import Pole, Random, fraction, independent, require_flint, slopes

T = TypeVar("T")
# p = k 2^e + 1 below 2^30, with 3 as a primitive root: products of residues fit 64 bits, and 2^e-th roots of 1 exist
PRIMES = (998244353, 469762049, 167772161)
ROOT = 3

_MARKS: list[Any] = []


@contextmanager
def poles_marked(lanes: int) -> Iterator[Any]:
    """Within, a division by 0 marks its lane in the array that this gives, and continues with 1."""
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
        if exponent < 0:
            return self.inverse() ** -exponent
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


def _operand(operand: Any, p: int) -> Any:
    """The residues of a number; NotImplemented for arrays and for values made of residues."""
    if isinstance(operand, Mod):
        return operand.v
    rational_number = isinstance(operand, int | Fraction | np.integer) or (
        hasattr(operand, "q") and hasattr(operand, "p")
    )
    return residue(operand, p) if rational_number else NotImplemented


def _power_modulo(base: Any, exponent: int, p: int) -> Any:
    out = base * 0 + 1
    while exponent:
        if exponent & 1:
            out = out * base % p
        base = base * base % p
        exponent >>= 1
    return out


def residue(x: Any, p: int) -> int:
    """A rational number modulo p.  Raises `Pole` where p divides the denominator."""
    q = fraction(x)
    if q.denominator % p == 0:
        raise Pole(f"{p} divides the denominator of {q}")
    return q.numerator * pow(q.denominator, -1, p) % p


def residues(x: Array, p: int) -> Array:
    """An array of rationals as residues, each one number."""
    return objects((Mod(np.int64(residue(v, p)), p) for v in np.asarray(x).flat), np.shape(x))


def residues_at(x: Array, points: int, p: int) -> Array:
    """An array of values, each of residues at `points` points or a rational, as 64-bit integers (points, ...)."""
    out = np.zeros((points, *x.shape), dtype=np.int64)
    for place in np.ndindex(x.shape):
        v = x[place]
        out[(slice(None), *place)] = v.v if isinstance(v, Mod) else residue(v, p)
    return out


def random_residues(rng: np.random.Generator, p: int, points: int, least: int = 1) -> Random:
    """draw(shape): arrays of values, each at `points` points, from `least` on."""

    def draw(shape: tuple[int, ...]) -> Array:
        return objects((Mod(rng.integers(least, p, points), p) for _ in range(math.prod(shape))), shape)

    return draw


def reconstructed(r: int, p: int) -> Fraction | None:
    """The rational number of least size that is r modulo p, None if none is small (Wang's reconstruction)."""
    bound = int((p // 2) ** 0.5)
    a, b, s, t = p, r % p, 0, 1
    while b > bound:
        a, b, s, t = b, a % b, t, s - a // b * t
    if t == 0 or abs(t) > bound:
        return None
    return Fraction(b, t)


# -- linear algebra modulo a prime, on integer arrays ----------------------------------------------------


def matrix(A: Array, p: int) -> Any:
    """A matrix of python-flint modulo p."""
    return require_flint().nmod_mat(*A.shape, [*map(int, A.ravel().tolist())], p)


def entries(matrix: Any) -> Array:
    """The entries of a matrix of python-flint as 64-bit integers."""
    shape = matrix.nrows(), matrix.ncols()
    return np.array([*map(int, matrix.entries())], dtype=np.int64).reshape(shape)


def rank(A: Array, p: int) -> int:
    """The rank modulo p."""
    return int(matrix(A, p).rank())


def product(A: Array, B: Array, p: int) -> Array:
    """A B modulo p."""
    return entries(matrix(A, p) * matrix(B, p))


def reduced(A: Array, p: int) -> tuple[Array, list[int]]:
    """The reduced echelon form modulo p without its rows of zeros, and the places of its pivots."""
    table, rank = matrix(A, p).rref()
    rows = entries(table)[:rank]
    return rows, [int(np.flatnonzero(row)[0]) for row in rows]


def kernel(A: Array, p: int) -> Array:
    """A basis of the null space modulo p (rows), each vector with a 1 where all others have 0."""
    table, pivots = reduced(A, p)
    free = np.setdiff1d(np.arange(A.shape[1]), pivots)
    basis = np.zeros((len(free), A.shape[1]), dtype=np.int64)
    basis[:, pivots] = -table[:, free].T % p
    basis[np.arange(len(free)), free] = 1
    return basis


def gradients(functions: Iterable[Callable[[Array], Any]], x: Array, p: int) -> Array:
    """The gradients (count, d) modulo p of functions, each of one value or several, at a point x (d,) of residues."""
    moving = independent(x)
    values = objects(v for f in functions for v in np.ravel(np.asarray(f(moving), dtype=object)))
    return residues_at(slopes(values, len(x)), 1, p)[0]


# -- attempts ------------------------------------------------------------------------------------------

ATTEMPTS = 5


def without_poles(name: str, experiment: Callable[[int], T], errors: tuple[type[Exception], ...] = (Pole,)) -> T:
    """experiment(0), or of the first further attempt that meets no pole.  Raises `InputError` if all do."""
    for attempt in range(ATTEMPTS):
        try:
            return experiment(attempt)
        except errors as error:
            trouble = error
    raise InputError(
        f"{name} divides by 0 from {ATTEMPTS} random starts ({trouble}). Usual cause: a denominator that vanishes "
        "identically, or constants whose denominators a prime divides."
    )
