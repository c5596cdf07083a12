"""Rings, and complex values over any kind of real number without a complex type."""

from __future__ import annotations

from typing import Any

import numpy as np


class Ring:
    """A commutative ring by `__add__`, `__neg__` and `__mul__`; for arrays on the other side it acts entry by entry."""

    __slots__ = ()
    __add__: Any
    __neg__: Any
    __mul__: Any

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __sub__(self, other: Any) -> Any:
        return NotImplemented if is_array(other) else self + (-other)

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __pow__(self, exponent: int) -> Any:
        if exponent < 0:
            return 1 / self**-exponent
        power: Any = 1
        for _ in range(exponent):
            power = power * self
        return power


def is_array(x: Any) -> bool:
    """Whether the value is an array, not a number."""
    return isinstance(x, np.ndarray) or bool(getattr(x, "shape", ()))


class Complex(Ring):
    """re + i im over any kind of real number without a complex type (recorded, rational, dual)."""

    __slots__ = ("im", "re")

    def __init__(self, re: Any, im: Any = 0):
        self.re, self.im = re, im

    def __add__(self, other: Any) -> Complex:
        if is_array(other):
            return NotImplemented
        other = as_complex(other)
        return Complex(self.re + other.re, self.im + other.im)

    def __neg__(self) -> Complex:
        return Complex(-self.re, -self.im)

    def __mul__(self, other: Any) -> Complex:
        if is_array(other):
            return NotImplemented
        other = as_complex(other)
        return Complex(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    def __truediv__(self, other: Any) -> Complex:
        if is_array(other):
            return NotImplemented
        if not isinstance(other, Complex):  # in the field of the parts: 1/2 of integers would be a float
            return Complex(self.re / other, self.im / other)
        return self * (1 / other)

    def __rtruediv__(self, other: Any) -> Complex:
        scale = 1 / (self.re * self.re + self.im * self.im)
        return other * Complex(self.re * scale, -self.im * scale)


def as_complex(x: Any) -> Complex:
    """A real number as a complex one."""
    return x if isinstance(x, Complex) else Complex(x)
