"""What is the same for every kind of number that brings its own +, *, - and 1/x."""

from __future__ import annotations

from typing import Any

import numpy as np


class Ring:
    """A commutative ring by `__add__`, `__neg__` and `__mul__`; arrays on the other side take it entry by entry."""

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
        power: Any = 1
        for _ in range(exponent):
            power = power * self
        return power


def is_array(x: Any) -> bool:
    """Whether it is an array, not a number."""
    return isinstance(x, np.ndarray) or bool(getattr(x, "shape", ()))
