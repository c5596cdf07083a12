"""Kinds of numbers for exact experiments: rationals, dual numbers, jets, rational functions; random points in them."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import reduce
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, objects
from kreisel.algebra.backend import Complex, Ring
from kreisel.algebra.recorded import Recorded
from kreisel.errors import InputError, shown
from kreisel.record.contract import Parameter, System
from kreisel.record.model import Model

try:
    import flint

    rational: Any = flint.fmpq
except ImportError:  # the extra "exact" is not installed: the same values, more slowly
    rational = Fraction

Random = Callable[[tuple[int, ...]], Array]


_PLACES = itertools.count()  # of dual values, in the order in which they were computed


class Dual(Ring):
    """value + sum_i slope_i d_i with d_i d_j = 0: exact derivatives in any field.

    Results store their operands and the derivatives with respect to them; `slopes` sweeps forward or back over these.
    The logarithm of an exact number is not in its field; its value is then given as 0 and only its
    slope, which is rational, means anything.
    """

    __slots__ = ("_operands", "_place", "_slope", "value")

    def __init__(self, value: Any, slope: Array | None = None, *operands: tuple[Dual, Any]):
        self.value, self._slope, self._operands, self._place = value, slope, operands, next(_PLACES)

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, np.ndarray | Complex):
            return NotImplemented
        if isinstance(other, Dual):
            return Dual(self.value + other.value, None, (self, 1), (other, 1))
        return self if _is(other, 0) else Dual(self.value + other, None, (self, 1))

    def __neg__(self) -> Dual:
        return Dual(-self.value, None, (self, -1))

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray | Complex):
            return NotImplemented
        if isinstance(other, Dual):
            return Dual(self.value * other.value, None, (self, other.value), (other, self.value))
        if _is(other, 0):  # most entries of constant matrices
            return self.value * other
        return self if _is(other, 1) else Dual(self.value * other, None, (self, other))

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, np.ndarray | Complex):
            return NotImplemented
        if isinstance(other, Dual):
            return self * (1 / other)
        return Dual(self.value / other, None, (self, (0 * self.value + 1) / other))

    def __rtruediv__(self, other: Any) -> Dual:
        inverse = 1 / self.value
        return Dual(other * inverse, None, (self, -other * inverse * inverse))

    def sqrt(self) -> Dual:
        root = self.value.sqrt() if hasattr(self.value, "sqrt") else math.sqrt(self.value)
        return Dual(root, None, (self, 1 / (2 * root)))

    def sign(self) -> int:
        return -1 if self.value < 0 else 1

    def log(self) -> Dual:
        value = math.log(self.value) if isinstance(self.value, float) else 0 * self.value
        return Dual(value, None, (self, 1 / self.value))

    @property
    def slope(self) -> Array:
        """All slopes, from the operands on."""
        for x in self._between() if self._slope is None else ():
            x._slope = reduce(operator.add, [_times(y.slope, factor) for y, factor in x._operands])
            x._operands = ()
        return self._slope

    def swept(self) -> Array:
        """All slopes, back from this number: in fewer operations for few numbers with many slopes."""
        factors: dict[Dual, Any] = {self: 1}
        for x in reversed(self._between()):
            factor = factors.pop(x)
            for y, slope in x._operands:
                share = _times(factor, slope)
                factors[y] = factors[y] + share if y in factors else share
        return sum(x._slope * factor for x, factor in factors.items())

    def _between(self) -> list[Dual]:
        """The numbers that this one was computed from, and itself, without those that have a slope, in order."""
        waiting, reached = [self], set[Dual]()
        while waiting:
            x = waiting.pop()
            if x._slope is None and x not in reached:
                reached.add(x)
                waiting += [y for y, _ in x._operands]
        return sorted(reached, key=lambda x: x._place)


def _is(x: Any, value: int) -> bool:
    return not isinstance(x, Recorded) and bool(x == value)


def _times(x: Any, factor: Any) -> Any:
    return x if _is(factor, 1) else x * factor


def slopes(outputs: Array, count: int) -> Array:
    """The slopes (..., count) of an array of dual values, complex ones too; plain entries have slope 0."""
    outputs, imaginary = algebra.parts(np.asarray(outputs, dtype=object))
    if imaginary is not None:
        return algebra.together(slopes(outputs, count), slopes(imaginary, count))
    out = np.zeros((*outputs.shape, count), dtype=object)
    few = outputs.size < count
    for place in np.ndindex(outputs.shape):
        if isinstance(outputs[place], Dual):
            out[place] = outputs[place].swept() if few else outputs[place].slope
    return out


def along(values: Array, direction: Array) -> Array:
    """values + direction * d with one infinitesimal d."""
    pairs = zip(values.flat, direction.flat, strict=True)
    return algebra.objects((Dual(value, algebra.objects([slope])) for value, slope in pairs), values.shape)


def independent(values: Array) -> Array:
    """A flat array as dual values, each with a separate infinitesimal."""
    units = (algebra.objects(0 * v + (i == j) for j in range(len(values))) for i, v in enumerate(values))
    return algebra.objects(map(Dual, values, units))


def jacobian(
    function: Callable[..., Any], state: tuple[Array, ...], kinds: tuple[str, ...], n: int
) -> tuple[Any, Array]:
    """A function of state components at dual values: its output, and d output / d coordinate."""
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

    def value(p: Parameter) -> Array:
        if p.kind == "array":
            if p.default is None:
                cause = f"The laws need a value of {p.letter}"
                raise InputError(f"{cause}: give a default, or check(model) with parameters.")
            return p.default
        if p.kind == "dimension":
            return n
        if p.kind == "symmetric":
            square = draw((n, n))
            return (square @ square.T) / n + algebra.identity(n)
        x = draw((n,) if p.kind == "vector" else (1,))
        if p.kind == "scalar":
            keeps_its_sign = algebra.holds_objects(x) and not p.positive  # floats keep clear of poles
            return x[0] if keeps_its_sign else abs(x)[0] + int(p.positive)
        if p.positive:
            return abs(x) / 8 + (1 + np.cumsum(0 * x + 1)) / 2
        return x / 4 + 2 * np.cumsum(0 * x + 1) if p.distinct else x

    return system(**{p.letter: value(p) for p in system.parameters})


def random_rotation(n: int, draw: Random) -> Array:
    """A random orthogonal matrix of determinant 1, rational when `draw` is."""
    return algebra.cayley(algebra.skew(draw((n * (n - 1) // 2,)), n))


# -- multilinear jets ---------------------------------------------------------------------------------
#
# Numbers a + sum a_S x_S over sets S of generators with x_i^2 = 0, in any field.
#
# They give mixed derivatives exactly: f(z + s x + t y) has d/dx d/dy f as the coefficient of st.  With k generators,
# e = x1 + ... + xk is a step with e^k = k! x1...xk and e^(k+1) = 0, so that they also expand in powers of a step.


class Jet(Ring):
    """The coefficients by sets of generators, written as bit masks."""

    __slots__ = ("terms",)

    def __init__(self, terms: dict[int, Any]):
        self.terms = terms

    @property
    def inexact(self) -> bool:
        return isinstance(self.value, float)

    @property
    def value(self) -> Any:
        """The part without generators."""
        return self.terms.get(0, 0)

    def __add__(self, other: Any) -> Jet:
        if isinstance(other, np.ndarray):
            return NotImplemented
        out = dict(self.terms)
        for mask, term in _terms(other).items():
            out[mask] = out[mask] + term if mask in out else term
        return Jet(out)

    def __neg__(self) -> Jet:
        return Jet({mask: -term for mask, term in self.terms.items()})

    def __mul__(self, other: Any) -> Jet:
        if isinstance(other, np.ndarray):
            return NotImplemented
        out: dict[int, Any] = {}
        theirs = _terms(other)
        for mask, term in self.terms.items():
            for second_mask, factor in theirs.items():
                if not mask & second_mask:
                    product = term * factor
                    out[mask | second_mask] = (
                        out[mask | second_mask] + product if mask | second_mask in out else product
                    )
        return Jet(out)

    def __truediv__(self, other: Any) -> Jet:
        if isinstance(other, np.ndarray):
            return NotImplemented
        if isinstance(other, Jet):
            return self * (1 / other)
        return Jet({mask: term / other for mask, term in self.terms.items()})

    def __rtruediv__(self, other: Any) -> Jet:
        inverse = self._inverse()
        return self._series(inverse, lambda k: inverse * (-1) ** k) * other

    def log(self) -> Jet:
        """log; of an exact number the value is not in its field, and 0 represents it."""
        value = math.log(self.value) if self.inexact else 0 * self.value
        unit = self.value * self._inverse()
        return self._series(self._inverse(), lambda k: value if k == 0 else unit * (-1) ** (k + 1) / k)

    def _inverse(self) -> Any:
        return self.value if self.value in (1, -1) else 1 / self.value  # the integer 1 stays in every field

    def _series(self, inverse: Any, coefficient: Callable[[int], Any]) -> Jet:
        """sum_k coefficient(k) (N / value)^k with N the nilpotent part."""
        small = Jet({mask: term * inverse for mask, term in self.terms.items() if mask})
        out, power, k = Jet({0: coefficient(0)}), Jet({0: 1}), 0
        while power.terms:
            k, power = k + 1, power * small
            out = out + power * coefficient(k)
        return out


def _terms(x: Any) -> dict[int, Any]:
    if isinstance(x, Jet):
        return x.terms
    return {} if isinstance(x, int) and x == 0 else {0: x}  # the integer 0 is not in the field


def generator(i: int, unit: Any) -> Jet:
    """The i-th generator; `unit` is the 1 of the field."""
    return Jet({1 << i: unit})


def coefficient(x: Array, mask: int) -> Array:
    """The coefficient of a set of generators in a number or an array."""
    if isinstance(x, np.ndarray):
        return objects((_terms(v).get(mask, 0) for v in x.flat), x.shape)
    return _terms(x).get(mask, 0)


# -- rational numbers of any library ---------------------------------------------------------------------


class Pole(ArithmeticError):
    """A division by 0 at one of the points: another seed, or another prime, avoids it."""


def fraction(x: Any) -> Fraction:
    """An integer, a fraction of any library or a float, unchanged, as a Fraction.  Raises `InputError` for others."""
    if hasattr(x, "q") and hasattr(x, "p"):  # python-flint
        return Fraction(int(x.p), int(x.q))
    try:
        return Fraction(x.item() if isinstance(x, np.generic) else x)
    except (ValueError, TypeError, ZeroDivisionError, OverflowError):
        raise InputError(f"An integer or a fraction such as 1/3 was expected, got {shown(x)}.") from None


def fractions(v: Any) -> Any:
    """A number or an array of values as `Fraction`; a number as itself, not as an array."""
    return np.vectorize(fraction, otypes=[object])(v)[()]


def rationals(v: Any) -> Any:
    """A number or an array of values as rationals of python-flint, as `Fraction` without it."""
    return np.vectorize(lambda q: rational(q.numerator, q.denominator), otypes=[object])(fractions(v))[()]


def require_flint() -> Any:
    """python-flint.  Raises `InputError` if it is not installed."""
    try:
        import flint
    except ImportError as error:
        raise InputError(
            "This experiment needs python-flint, which is missing. Install it with: pip install 'kreisel[exact]'"
        ) from error
    return flint


# -- rational functions ----------------------------------------------------------------------------------


class Field(Ring):
    """A field by `_of` (a number of it), `_plus`, `_times` and `_inverse`."""

    __slots__ = ()
    _of: Any
    _plus: Any
    _times: Any
    _inverse: Any

    def __add__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray | Dual) else self._plus(self._of(other))

    def __mul__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray | Dual) else self._times(self._of(other))

    def __truediv__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray | Dual) else self._times(self._of(other)._inverse())

    def __rtruediv__(self, other: Any) -> Any:
        return self._of(other)._times(self._inverse())


class Ratio(Field):
    """A quotient of polynomials over Q, without common factors."""

    __slots__ = ("d", "n")

    def __init__(self, n: Any, d: Any, common: Any = None):
        common = n.gcd(d) if common is None or n == 0 else common
        self.n, self.d = n // common, d // common

    def _of(self, operand: Any) -> Ratio:
        return operand if isinstance(operand, Ratio) else Ratio(0 * self.n + rationals(operand), 0 * self.d + 1)

    def _plus(self, operand: Ratio) -> Ratio:
        g = self.d.gcd(operand.d)  # Henrici 1956: gcds of the factors, since that of the products is far slower
        n = self.n * (operand.d // g) + operand.n * (self.d // g)
        return Ratio(n, self.d // g * operand.d, n.gcd(g))

    def __neg__(self) -> Ratio:
        return Ratio(-self.n, self.d)

    def _times(self, operand: Ratio) -> Ratio:
        return Ratio(self.n * operand.n, self.d * operand.d, self.n.gcd(operand.d) * operand.n.gcd(self.d))

    def _inverse(self) -> Ratio:
        if self.n == 0:
            raise Pole("a denominator vanishes identically")
        return Ratio(self.d, self.n)


def ring(names: Sequence[str]) -> Any:
    """The polynomials over Q in these variables, of python-flint."""
    flint = require_flint()
    return flint.fmpq_mpoly_ctx.get(names, flint.Ordering.deglex)


def generators(names: Sequence[str]) -> Array:
    """The variables of these names as rational functions over Q (len(names),)."""
    return objects(Ratio(g, ring(names).constant(1)) for g in ring(names).gens())
