"""Recorded numbers that stand for the entry at any place, and their sums over all places."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from kreisel.algebra.complex import Complex
from kreisel.graph import graph
from kreisel.kernels.tape import Scalar

Number = Any  # recorded, complex of recorded, or plain


def total(x: Number) -> Number:
    """The sum of an entry over all places."""
    if isinstance(x, Complex):
        return Complex(total(x.re), total(x.im))
    if isinstance(x, Scalar):
        return Scalar(x.tape, x.tape.record(f"total({x.name})", (x.name,)), x.negative)
    if isinstance(x, np.ndarray):  # all entries, one after the other
        return x.sum() if x.dtype.kind == "O" else float(x.sum())
    if x == 0:
        return 0.0
    raise TypeError("the sum of a plain number over all places is not recorded")


def is_number(x: Any) -> bool:
    """Whether it is recorded, complex of recorded, or plain."""
    return isinstance(x, Scalar | graph.Number | Complex | int | float | np.number)


def key_of(x: Any) -> Any:
    """Equal for what is the same on the tape: numbers, arrays, and vectors, which have a `key`."""
    if hasattr(x, "key"):
        return x.key
    if isinstance(x, Scalar | graph.Number):
        return x if isinstance(x, graph.Number) else x.signed
    if isinstance(x, np.ndarray):
        return tuple(map(key_of, x))
    return (key_of(x.re), key_of(x.im)) if isinstance(x, Complex) else float(x)


def parts(x: Number) -> tuple[Number, Number]:
    """Real and imaginary part."""
    return (x.re, x.im) if isinstance(x, Complex) else (x, 0.0)


class Nothing:
    """The entries of a constant matrix: none that change, and none to be used."""

    ndim, shape, size = 1, (0,), 0
    __array_ufunc__: ClassVar[None] = None

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.zeros(0)
