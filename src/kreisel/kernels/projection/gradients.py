"""Gradients of functions of arrays by a reverse sweep, in doubles: for n beyond straight-line code.

A `Traced` array has its value and how slopes go back through the operation that made it.  A definition runs on it as
it is written.  Slopes of k numbers go back at once: they are (k, ...) for an array (...).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count
from typing import Any, ClassVar

import numpy as np

from kreisel.kernels.layout import Floats

Back = Callable[[Floats], Floats]
CALL = 1e4  # operations of a kernel that take as long as NumPy takes to begin one
TOGETHER = 64  # slopes that go back at once

_creation_order = count()


class Namespace:
    """What `kreisel.algebra` and `kreisel.algebra.invariants` need of a library for such arrays."""

    @staticmethod
    def concatenate(parts: Sequence[Any], axis: int = 0) -> Traced:
        """The parts one after the other along an axis."""
        values = [_value(part) for part in parts]
        edges = np.cumsum([value.shape[axis] for value in values])[:-1].tolist()

        def back(i: int) -> Back:
            return lambda g: np.split(g, edges, axis if axis < 0 else axis + 1)[i]

        return Traced(
            np.concatenate(values, axis), *((part, back(i)) for i, part in enumerate(parts) if isinstance(part, Traced))
        )

    @staticmethod
    def stack(parts: Sequence[Any], axis: int = 0) -> Traced:
        """The parts along a new last axis."""
        if axis != -1:
            raise TypeError("traced arrays are stacked along a new last axis")
        return Namespace.concatenate([part[..., None] for part in parts], -1)

    @staticmethod
    def broadcast_to(x: Any, shape: tuple[int, ...]) -> Any:
        """The array with axes repeated."""
        return x + np.zeros(shape) if isinstance(x, Traced) else np.broadcast_to(x, shape)


class Traced:
    """A recorded array of doubles: `value`, and the arrays that it was made of with the way of slopes back to them."""

    __array_ufunc__: ClassVar[None] = None  # so that NumPy arrays leave their operators to us
    dtype: ClassVar[np.dtype[Any]] = np.dtype(np.float64)

    def __init__(self, value: Any, *parents: tuple[Traced, Back], cost: float = 0):
        self.value = np.asarray(value, dtype=np.float64)
        self.parents, self.place, self.cost = parents, next(_creation_order), cost or self.value.size

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    @property
    def ndim(self) -> int:
        return self.value.ndim

    @property
    def mT(self) -> Traced:
        return Traced(self.value.mT, (self, lambda g: g.mT))

    def __array_namespace__(self) -> type[Namespace]:
        return Namespace

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("a traced array is no array of NumPy")

    def __array_function__(self, function: Callable[..., Any], types: Any, args: Any, kwargs: Any) -> Any:
        if function in (np.ndim, np.shape):
            return getattr(args[0], function.__name__)
        own = getattr(Namespace, function.__name__, None)
        if own is None:
            raise TypeError(f"np.{function.__name__} of traced arrays is not known")
        return own(*args, **kwargs)

    def _with(self, value: Floats, other: Any, mine: Back, its: Back) -> Traced:
        """An entrywise result; slopes are added up over axes along which an array was repeated."""
        parents = [(self, lambda g: _unrepeated(mine(g), self.shape))]
        if isinstance(other, Traced):
            parents.append((other, lambda g: _unrepeated(its(g), other.shape)))
        return Traced(value, *parents)

    def __neg__(self) -> Traced:
        return Traced(-self.value, (self, np.negative))

    def __add__(self, other: Any) -> Traced:
        return self._with(self.value + _value(other), other, lambda g: g, lambda g: g)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Traced:
        return self._with(self.value - _value(other), other, lambda g: g, np.negative)

    def __rsub__(self, other: Any) -> Traced:
        return self._with(_value(other) - self.value, other, np.negative, lambda g: g)

    def __mul__(self, other: Any) -> Traced:
        y = _value(other)
        return self._with(self.value * y, other, lambda g: g * y, lambda g: g * self.value)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Traced:
        y = _value(other)
        value = self.value / y
        return self._with(value, other, lambda g: g / y, lambda g: -g * (value / y))

    def __rtruediv__(self, other: Any) -> Traced:
        value = _value(other) / self.value
        return Traced(value, (self, lambda g: _unrepeated(-g * (value / self.value), self.shape)))

    def __pow__(self, exponent: int) -> Traced:
        return Traced(self.value**exponent, (self, lambda g: g * (exponent * self.value ** (exponent - 1))))

    def __matmul__(self, other: Any) -> Traced:
        return _product(self, other)

    def __rmatmul__(self, other: Any) -> Traced:
        return _product(other, self)

    def __getitem__(self, index: Any) -> Traced:
        places = index if isinstance(index, tuple) else (index,)

        def back(g: Floats) -> Floats:
            out = np.zeros((len(g), *self.shape))
            np.add.at(out, (slice(None), *places), g)
            return out

        return Traced(self.value[index], (self, back))

    def sqrt(self) -> Traced:
        value = np.sqrt(self.value)
        return Traced(value, (self, lambda g: g * (0.5 / value)))

    def log(self) -> Traced:
        return Traced(np.log(self.value), (self, lambda g: g / self.value))

    def sum(self, axis: int) -> Traced:
        if axis >= 0:
            raise TypeError("traced arrays are added up along an axis counted from the last one")
        return Traced(
            self.value.sum(axis),
            (self, lambda g: np.broadcast_to(np.expand_dims(g, axis), (len(g), *self.shape))),
            cost=self.value.size,
        )

    def reshape(self, shape: tuple[int, ...]) -> Traced:
        return Traced(self.value.reshape(shape), (self, lambda g: g.reshape((len(g), *self.shape))))


def _value(x: Any) -> Floats:
    return x.value if isinstance(x, Traced) else np.asarray(x)


def _unrepeated(g: Floats, shape: tuple[int, ...]) -> Floats:
    """The slopes (k, ...) of an array that was repeated, added up to (k, *shape)."""
    extra = g.ndim - 1 - len(shape)
    g = g.sum(tuple(range(1, 1 + extra))) if extra > 0 else g
    repeated = tuple(i + 1 for i, size in enumerate(shape) if size == 1 and g.shape[i + 1] > 1)
    return g.sum(repeated, keepdims=True) if repeated else g


def _product(x: Any, y: Any) -> Traced:
    """The product of two matrices."""
    a, b = _value(x), _value(y)
    if a.ndim != 2 or b.ndim != 2:
        raise TypeError(f"products of traced arrays are those of two matrices, not of shapes {a.shape} and {b.shape}")
    ways = ((x, lambda g: g @ b.T), (y, lambda g: a.T @ g))
    return Traced(a @ b, *((z, back) for z, back in ways if isinstance(z, Traced)), cost=a.size * b.shape[1])


def _reached(y: Traced) -> list[Traced]:
    """All arrays that y was made of, y among them, the last one first."""
    found, waiting = {y.place: y}, [y]
    while waiting:
        for parent, _ in waiting.pop().parents:
            if parent.place not in found:
                found[parent.place] = parent
                waiting.append(parent)
    return [found[place] for place in sorted(found, reverse=True)]


def gradient(y: Traced, z: Traced) -> Floats:
    """dy/dz (k, d) for y (k,) and z (d,)."""
    nodes, rows = _reached(y), len(y.value)
    out = np.zeros((rows, len(z.value)))
    for first in range(0, rows, TOGETHER):
        slopes = {y.place: np.eye(rows)[first : first + TOGETHER]}
        for node in nodes:
            g = slopes.pop(node.place, None)
            if g is None:
                continue
            if node is z:
                out[first : first + TOGETHER] = g
            for parent, back in node.parents:
                slope = back(g)
                slopes[parent.place] = slopes[parent.place] + slope if parent.place in slopes else slope
    return out


def cost(y: Traced) -> float:
    """About how many operations of a kernel take as long as y and its gradient."""
    rows = len(y.value)
    calls = 1 + 2 * -(-rows // TOGETHER)
    return sum(CALL * calls + node.cost * (1 + 2 * rows) for node in _reached(y))
