"""Multilinear jets: numbers a + sum a_S x_S over sets S of generators with x_i^2 = 0, in any field.

They give mixed derivatives exactly: f(z + s x + t y) has d/dx d/dy f as the coefficient of st.  With k generators,
e = x1 + ... + xk is a step with e^k = k! x1...xk and e^(k+1) = 0, so that they also expand in powers of a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.algebra.ring import Ring


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
            for more, factor in theirs.items():
                if not mask & more:
                    product = term * factor
                    out[mask | more] = out[mask | more] + product if mask | more in out else product
        return Jet(out)

    def __truediv__(self, other: Any) -> Jet:
        if isinstance(other, np.ndarray):
            return NotImplemented
        return (
            self * (1 / other) if isinstance(other, Jet) else Jet({m: term / other for m, term in self.terms.items()})
        )

    def __rtruediv__(self, other: Any) -> Jet:
        inverse = self._inverse()
        return self._series(inverse, lambda k: inverse * (-1) ** k) * other

    def __pow__(self, exponent: int) -> Jet:
        out = Jet({0: 1})
        for _ in range(exponent):
            out = out * self
        return out

    def log(self) -> Jet:
        """log; of an exact number the value is not in its field, and 0 stands for it."""
        value = math.log(self.value) if self.inexact else 0 * self.value
        one = self.value * self._inverse()
        return self._series(self._inverse(), lambda k: value if k == 0 else one * (-1) ** (k + 1) / k)

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
    return {} if isinstance(x, int) and x == 0 else {0: x}  # the integer 0 is no number of the field


def generator(i: int, one: Any) -> Jet:
    """The i-th generator; `one` is the 1 of the field."""
    return Jet({1 << i: one})


def coefficient(x: Array, mask: int) -> Array:
    """The coefficient of a set of generators in a number or an array."""
    if isinstance(x, np.ndarray):
        return objects((_terms(v).get(mask, 0) for v in x.flat), x.shape)
    return _terms(x).get(mask, 0)
