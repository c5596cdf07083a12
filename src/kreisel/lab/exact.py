"""Numbers for the laws: rationals, dual numbers over any field, and random points."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.ring import Ring
from kreisel.errors import InputError
from kreisel.record.contract import Parameter, PhaseSpace, System
from kreisel.record.model import Model

try:
    import flint

    rational: Any = flint.fmpq
except ImportError:  # the extra "exact" is not installed: the same numbers, more slowly
    rational = Fraction

Random = Callable[[tuple[int, ...]], Array]


class Dual(Ring):
    """value + sum_i slope_i d_i with d_i d_j = 0: exact derivatives in any field.

    The logarithm of an exact number is not in its field; its value is then given as 0 and only its
    slope, which is rational, means anything.
    """

    __slots__ = ("slope", "value")

    def __init__(self, value: Any, slope: Array):
        self.value, self.slope = value, slope

    @property
    def inexact(self) -> bool:
        return isinstance(self.value, float)

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, np.ndarray):
            return NotImplemented
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, np.ndarray):
            return NotImplemented
        if isinstance(other, Dual):
            return Dual(self.value * other.value, self.slope * other.value + other.slope * self.value)
        return Dual(self.value * other, self.slope * other)

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, np.ndarray):
            return NotImplemented
        return self * (1 / other) if isinstance(other, Dual) else Dual(self.value / other, self.slope / other)

    def __rtruediv__(self, other: Any) -> Dual:
        inverse = 1 / self.value
        return Dual(other * inverse, self.slope * (-other * inverse * inverse))

    def __pow__(self, exponent: int) -> Dual:
        out: Any = 1
        for _ in range(exponent):
            out = self * out
        return out

    def sqrt(self) -> Dual:
        root = self.value.sqrt() if hasattr(self.value, "sqrt") else math.sqrt(self.value)
        return Dual(root, self.slope / (2 * root))

    def log(self) -> Dual:
        value = math.log(self.value) if self.inexact else 0 * self.value
        return Dual(value, self.slope * (1 / self.value))


def slopes(outputs: Array, count: int) -> Array:
    """The slopes (..., count) of an array of dual numbers, complex ones too; plain entries have slope 0."""
    outputs, imaginary = algebra.parts(np.asarray(outputs, dtype=object))
    if imaginary is not None:
        return algebra.together(slopes(outputs, count), slopes(imaginary, count))
    out = np.zeros((*outputs.shape, count), dtype=object)
    for place in np.ndindex(outputs.shape):
        if isinstance(outputs[place], Dual):
            out[place] = outputs[place].slope
    return out


def along(values: Array, direction: Array) -> Array:
    """values + direction * d with one infinitesimal d."""
    pairs = zip(values.flat, direction.flat, strict=True)
    return algebra.objects((Dual(value, algebra.objects([slope])) for value, slope in pairs), values.shape)


def independent(values: Array) -> Array:
    """A flat array as dual numbers, each with an infinitesimal of its own."""
    units = (algebra.objects(0 * v + (i == j) for j in range(len(values))) for i, v in enumerate(values))
    return algebra.objects(map(Dual, values, units))


def jacobian(
    function: Callable[..., Any], state: tuple[Array, ...], kinds: tuple[str, ...], n: int
) -> tuple[Any, Array]:
    """A function of state components at dual numbers: its output, and d output / d coordinate."""
    flat = algebra.flatten(state, kinds)
    output = function(*algebra.restore(independent(flat), kinds, n))
    if isinstance(output, tuple):
        output = algebra.flatten(output, kinds)
    return output, slopes(output, len(flat))


# -- random points --------------------------------------------------------------------------------


def rational_random(rng: np.random.Generator) -> Random:
    """Random rationals with small numerators and denominators, none of them 0."""

    def draw(shape: tuple[int, ...]) -> Array:
        def number() -> Any:
            sign = 1 if rng.integers(2) else -1
            return rational(sign * int(rng.integers(1, 12)), int(rng.integers(3, 9)))

        return algebra.objects((number() for _ in range(math.prod(shape))), shape)

    return draw


def float_random(rng: np.random.Generator) -> Random:
    """Random floats of size about 1."""
    return lambda shape: rng.uniform(0.2, 1.3, shape) * rng.choice([-1.0, 1.0], shape)


def random_model(system: System, n: int, draw: Random) -> Model:
    """A system with random parameters inside their valid ranges."""
    return system(**{p.letter: _random_parameter(p, n, draw) for p in system.parameters})


def _random_parameter(p: Parameter, n: int, draw: Random) -> Array:
    if p.kind == "array":
        if p.default is None:
            raise InputError(f"The laws need a value of {p.letter}: give a default, or check(model) with parameters.")
        return p.default
    if p.kind == "dimension":
        return n
    if p.kind == "scalar" and p.positive:
        return abs(draw((1,)))[0] + 1
    if p.kind == "scalar":
        value = draw((1,))
        return value[0] if algebra.holds_objects(value) else abs(value)[0]  # floats keep clear of poles
    if p.kind == "vector":
        value = draw((n,))
        if p.positive:
            return abs(value) / 8 + (1 + np.cumsum(0 * value + 1)) / 2
        return value / 4 + 2 * np.cumsum(0 * value + 1) if p.distinct else value
    square = draw((n, n))
    return (square @ square.T) / n + algebra.identity(n)


def random_state(space: PhaseSpace, n: int, draw: Random) -> tuple[Array, ...]:
    """A random point of a phase space."""
    if space.draw is not None:
        return tuple(space.draw(n, draw))
    return algebra.restore(draw((algebra.coordinate_count(space.kinds, n),)), space.kinds, n)


def random_rotation(n: int, draw: Random) -> Array:
    """A random orthogonal matrix of determinant 1, rational when `draw` is."""
    return algebra.cayley(algebra.skew(draw((n * (n - 1) // 2,)), n))
