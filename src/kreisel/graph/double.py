"""Double-doubles: unevaluated sums of two scalars, recorded ones or floats, about 31 digits.

The operations are Dekker's and Knuth's, with fused products.  The last one or two of 106 bits may be wrong, in a
sum those of the larger term: half the operations of one that is as exact where terms cancel.
"""

from __future__ import annotations

import math
from typing import Any

from kreisel.algebra.backend import Complex, Ring, is_array
from kreisel.graph.graph import Number, fma, integer_power, sign, where_less

Pair = tuple[Any, Any]


class DoubleDouble(Ring):
    """upper + lower; other operands of its operators are exact: lower = 0."""

    __slots__ = ("lower", "upper")

    def __init__(self, upper: Any, lower: Any = 0.0):
        self.upper, self.lower = upper, lower

    def __neg__(self) -> DoubleDouble:
        return DoubleDouble(-self.upper, -self.lower)

    def __add__(self, other: Any) -> DoubleDouble:
        if _foreign(other):
            return NotImplemented
        y = double_double(other)
        upper, error = two_sum(self.upper, y.upper)
        return ordered_sum(upper, error + (self.lower + y.lower))

    def __mul__(self, other: Any) -> DoubleDouble:
        if _foreign(other):
            return NotImplemented
        y = double_double(other)
        product = self.upper * y.upper
        error = fma(self.upper, y.upper, -product)
        return ordered_sum(product, fma(self.upper, y.lower, fma(self.lower, y.upper, error)))

    def __truediv__(self, other: Any) -> DoubleDouble:
        if _foreign(other):
            return NotImplemented
        y = double_double(other)
        quotient = self.upper / y.upper
        remainder = fma(-quotient, y.lower, fma(-quotient, y.upper, self.upper) + self.lower)
        return ordered_sum(quotient, remainder / y.upper)

    def __rtruediv__(self, other: Any) -> DoubleDouble:
        return double_double(other) / self

    def __pow__(self, exponent: Any) -> Any:
        return integer_power(self, exponent)

    def __abs__(self) -> DoubleDouble:
        return self.where_less(self, 0.0, -self, self)

    def maximum(self, operand: Any) -> DoubleDouble:
        return self.where_less(self, operand, operand, self)

    def sign(self) -> Any:
        return sign(self.upper)

    def sqrt(self) -> DoubleDouble:
        r = root(self.upper)
        remainder = fma(-r, r, self.upper) + self.lower
        return ordered_sum(r, remainder / (r + r))

    @staticmethod
    def where_less(x: Any, y: Any, yes: Any, no: Any) -> DoubleDouble:
        """`yes` where x < y, else `no`."""
        comparison, pairs = (upper(x), upper(y)), (double_double(yes), double_double(no))
        return DoubleDouble(
            where_less(*comparison, *map(upper, pairs)), where_less(*comparison, *(v.lower for v in pairs))
        )

    def __repr__(self) -> str:
        return f"({self.upper!r} + {self.lower!r})"


def _foreign(x: Any) -> bool:
    """Whether an operand is an array or a complex value, which then apply the operation."""
    return isinstance(x, Complex) or is_array(x)


def double_double(x: Any) -> DoubleDouble:
    """A number as a double-double."""
    return x if isinstance(x, DoubleDouble) else DoubleDouble(x)


def upper(x: Any) -> Any:
    """The number next to a double-double; other scalars as they are."""
    return x.upper if isinstance(x, DoubleDouble) else x


def two_sum(x: Any, y: Any) -> tuple[Any, Any]:
    """x + y and its error."""
    total = x + y
    share = total - x
    return total, (x - (total - share)) + (y - share)


def ordered_sum(x: Any, y: Any) -> DoubleDouble:
    """x + y with its error, for |x| >= |y|."""
    total = x + y
    return DoubleDouble(total, y - (total - x))


# -- pairs that are not made ordered -------------------------------------------------------------------
# The second number is of the size of the rounding errors of the terms of the first; to make it less would gain nothing
# for a projection.  Quotients and roots also return the values that their derivatives need.


def fused(x: Any, y: Any, z: Any) -> Any:
    """x y + z, rounded once unless x and y are known."""
    return x * y + z if isinstance(x, float) and isinstance(y, float) else fma(x, y, z)


def root(x: Any) -> Any:
    """Square root."""
    return x.sqrt() if isinstance(x, Number) else math.sqrt(x)


def pair_sum(x: Pair, y: Pair) -> Pair:
    """x + y."""
    total, error = two_sum(x[0], y[0])
    return total, error + (x[1] + y[1])


def pair_difference(x: Pair, y: Pair) -> Pair:
    """x - y."""
    return pair_sum(x, (-y[0], -y[1]))


def pair_product(x: Pair, y: Pair) -> Pair:
    """x y; without the error of the upper scalars where one of them is a known power of 2."""
    (a, la), (b, lb) = x, y
    product = a * b
    exact = any(isinstance(v, float) and math.frexp(v)[0] in (0, 0.5, -0.5) for v in (a, b))
    return product, fused(a, lb, fused(la, b, 0.0 if exact else fused(a, b, -product)))


def pair_quotient(x: Pair, y: Pair) -> tuple[Pair, Any]:
    """x/y, and 1/y."""
    (a, la), (b, lb) = x, y
    inverse = 1.0 / b
    quotient = a * inverse
    remainder = fused(-quotient, b, a) + fused(-quotient, lb, la)
    return (quotient, remainder * inverse), inverse


def pair_root(x: Pair) -> tuple[Pair, Any]:
    """Square root, and 1/2 over it."""
    value = root(x[0])
    inverse = 0.5 / value
    return (value, (fused(-value, value, x[0]) + x[1]) * inverse), inverse
