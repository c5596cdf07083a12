"""Gradients of functions of arrays, by a reverse sweep.

A `Traced` array has its value and how slopes go back through the operation that made it.  A definition runs on it as it
is written: operators, comparisons, which see the values, and the functions of NumPy below.  Slopes of k scalars go back
at once: they are (k, ...) for an array (...).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import count
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from kreisel.algebra.recorded import POWER, NotRecorded, Recorded
from kreisel.kernels.layout import Floats

Back = Callable[[Floats], Floats]
CALL = 1e4  # operations of a kernel that need as long as NumPy needs to begin one
TOGETHER = 64  # slopes that go back at once

# Functions of one number, as slopes go back: (g, x, y) with y the value.
SLOPES: dict[Any, Callable[[Floats, Floats, Floats], Any]] = {
    np.sqrt: lambda g, x, y: g * (0.5 / y),
    np.log: lambda g, x, y: g / x,
    np.exp: lambda g, x, y: g * y,
    np.sin: lambda g, x, y: g * np.cos(x),
    np.cos: lambda g, x, y: g * -np.sin(x),
    np.tan: lambda g, x, y: g * (1 + y * y),
    np.arctan: lambda g, x, y: g / (1 + x * x),
    np.sinh: lambda g, x, y: g * np.cosh(x),
    np.cosh: lambda g, x, y: g * np.sinh(x),
    np.tanh: lambda g, x, y: g * (1 - y * y),
    np.square: lambda g, x, y: g * (2 * x),
    np.absolute: lambda g, x, y: g * np.sign(x),
    np.negative: lambda g, x, y: -g,
    np.positive: lambda g, x, y: g,
}
# Functions of two numbers, as slopes go back to each of them.
SLOPES_OF_TWO: dict[Any, tuple[Callable[..., Any], Callable[..., Any]]] = {
    np.add: (lambda g, x, y, value: g, lambda g, x, y, value: g),
    np.subtract: (lambda g, x, y, value: g, lambda g, x, y, value: -g),
    np.multiply: (lambda g, x, y, value: g * y, lambda g, x, y, value: g * x),
    np.true_divide: (lambda g, x, y, value: g / y, lambda g, x, y, value: -g * (value / y)),
}
COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal)
# Functions of one array whose result has entries of it.
REARRANGING = frozenset(
    "roll transpose flip ravel swapaxes moveaxis diagonal squeeze expand_dims repeat tile take rot90 matrix_transpose "
    "atleast_1d copy".split()
)
USABLE = (
    "Use + - * / @, powers, np.sqrt, np.sin, np.exp and the like, np.sum, np.prod, np.dot, np.trace, np.einsum, "
    "np.linalg.norm, np.roll, np.stack and indices."
)

_creation_order = count()


class Traced(NDArrayOperatorsMixin, Recorded):
    """A recorded array of doubles: `value`, and the arrays that it was made of with the way of slopes back to them.

    Comparisons compare values; a conversion to a float, which would lose the slopes, raises `NotRecorded`.
    """

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
    def size(self) -> int:
        return self.value.size

    def __len__(self) -> int:
        return len(self.value)

    @property
    def mT(self) -> Traced:
        return Traced(self.value.mT, (self, lambda g: g.mT))

    @property
    def T(self) -> Traced:
        return self.gathered(np.transpose)

    def __array_namespace__(self) -> Any:
        return Namespace

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise NotRecorded("a conversion to an array of NumPy", "Use np.stack([x, y], -1) instead of np.array([x, y]).")

    def __array_function__(self, function: Callable[..., Any], types: Any, args: Any, kwargs: Any) -> Any:
        name = function.__name__
        if function in (np.ndim, np.shape, np.size):
            return getattr(args[0], name)
        if name in REARRANGING:
            return _rearranged(name, *args, **kwargs)
        if name[0] == "_" or not hasattr(Namespace, name):
            raise NotRecorded(f"np.{name}", USABLE)
        return getattr(Namespace, name)(*args, **kwargs)

    def __array_ufunc__(self, ufunc: Any, method: Any, *inputs: Any, **kwargs: Any) -> Any:
        if method == "__call__" and not kwargs:
            if ufunc in SLOPES:
                return self.by(ufunc)
            if ufunc in SLOPES_OF_TWO:
                return _entrywise(ufunc, *inputs)
            if ufunc in COMPARISONS:
                return ufunc(*map(_value, inputs))
            if ufunc in (np.matmul, np.power):
                return (_product if ufunc is np.matmul else _power)(*inputs)
        raise NotRecorded(f"np.{ufunc.__name__}", USABLE)

    def by(self, function: Any) -> Traced:
        """A function of `SLOPES` of each entry."""
        x = self.value
        y = function(x)
        return Traced(y, (self, lambda g: SLOPES[function](g, x, y)))

    def gathered(self, rearrange: Callable[[Any], Any]) -> Traced:
        """The entries as a function that only rearranges an array puts them."""
        return self.reshape((-1,))[rearrange(np.arange(self.size).reshape(self.shape))]

    def __bool__(self) -> bool:
        return bool(self.value)

    def __getitem__(self, index: Any) -> Traced:
        places = index if isinstance(index, tuple) else (index,)

        def back(g: Floats) -> Floats:
            out = np.zeros((len(g), *self.shape))
            np.add.at(out, (slice(None), *places), g)
            return out

        return Traced(self.value[index], (self, back))

    def record_determinant(self) -> Traced:
        """det A of a matrix; det A A^-T goes back, NaN if A is singular, which leaves an invariant out."""
        value = np.linalg.det(self.value)
        slope = value * np.linalg.inv(self.value).T if value else np.full(self.shape, np.nan)
        return Traced(value, (self, lambda g: g[:, None, None] * slope), cost=self.size**1.5)

    def sqrt(self) -> Traced:
        return self.by(np.sqrt)

    def log(self) -> Traced:
        return self.by(np.log)

    def sum(self, axis: Any = None, keepdims: bool = False) -> Traced:
        axes = range(self.ndim) if axis is None else np.atleast_1d(axis).tolist()
        places = tuple(sorted(i % self.ndim - self.ndim for i in axes))
        return Traced(
            self.value.sum(places, keepdims=keepdims),
            (self, lambda g: np.broadcast_to(g if keepdims else np.expand_dims(g, places), (len(g), *self.shape))),
            cost=self.value.size,
        )

    def mean(self, axis: Any = None, keepdims: bool = False) -> Traced:
        total = self.sum(axis, keepdims)
        return total * (total.size / self.size)

    def dot(self, operand: Any) -> Traced:
        return Namespace.dot(self, operand)

    def ravel(self) -> Traced:
        return self.reshape((-1,))

    def copy(self) -> Traced:
        return self

    def transpose(self, *axes: Any) -> Traced:
        return self.gathered(lambda places: places.transpose(*axes))

    def reshape(self, *shape: Any) -> Traced:
        return Traced(self.value.reshape(*shape), (self, lambda g: g.reshape((len(g), *self.shape))))


def _concatenate(parts: Sequence[Any], axis: int = 0) -> Traced:
    """The parts one after the other along an axis."""
    values = [_value(array) for array in parts]
    edges = np.cumsum([value.shape[axis] for value in values])[:-1].tolist()

    def back(i: int) -> Back:
        return lambda g: np.split(g, edges, axis if axis < 0 else axis + 1)[i]

    return Traced(
        np.concatenate(values, axis), *((array, back(i)) for i, array in enumerate(parts) if isinstance(array, Traced))
    )


def _stack(parts: Sequence[Any], axis: int = 0) -> Traced:
    """The parts along a new axis, the last one or the first."""
    if axis not in (0, -1):
        raise NotRecorded(f"np.stack along the axis {axis}", "Use the axis 0 or -1.")
    place = (..., None) if axis else (None,)
    return _concatenate([(x if isinstance(x, Traced) else np.asarray(x))[place] for x in parts], axis)


def _prod(x: Traced, axis: int | None = None) -> Traced:
    """The product over an axis, or over all."""
    entries = x.ravel() if axis is None else _rearranged("moveaxis", x, axis, -1)
    return reduce(operator.mul, (entries[..., i] for i in range(entries.shape[-1])))


def _inner(x: Any, y: Any) -> Traced:
    """The product of vectors."""
    if np.ndim(x) != 1 or np.ndim(y) != 1:
        raise NotRecorded(f"np.inner or np.vdot of arrays of the shapes {x.shape} and {y.shape}", USABLE)
    return _product(x, y)


def _norm(x: Traced, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Traced:
    """The Euclidean length of vectors, of a matrix the root of the sum of squares."""
    if ord not in (None, 2, "fro") or (ord == 2 and axis is None and x.ndim > 1):
        raise NotRecorded(f"np.linalg.norm of the order {ord}", "Use the Euclidean norm.")
    return (x * x).sum(axis, keepdims).sqrt()


def _sum_of_products(subscripts: str, *operands: Any, optimize: Any = False) -> Traced:
    """Sums of products by their indices."""
    sources, *out = subscripts.replace(" ", "").split("->")
    letters = sources.split(",")
    if "." in subscripts:
        raise NotRecorded("np.einsum with ...", "Write an index for each axis.")
    for i, names in enumerate(letters):
        if len({*names}) < len(names):  # a diagonal
            letters[i] = "".join(dict.fromkeys(names))
            operands = (
                *operands[:i],
                _traced(operands[i]).gathered(_einsum(names, letters[i])),
                *operands[i + 1 :],
            )
    every = "".join(letters)
    target = out[0] if out else "".join(sorted(c for c in sources if sources.count(c) == 1 and c != ","))
    for i, names in enumerate(letters):  # an index of one factor alone
        alone = tuple(j for j, c in enumerate(names) if every.count(c) == 1 and c not in target)
        if alone:
            letters[i] = "".join(c for j, c in enumerate(names) if j not in alone)
            operands = (*operands[:i], _traced(operands[i]).sum(alone), *operands[i + 1 :])
    values = [_value(x) for x in operands]

    def back(i: int) -> Back:
        others = [j for j in range(len(values)) if j != i]
        terms = ",".join([f"Z{target}", *(letters[j] for j in others)])
        return lambda g: np.einsum(f"{terms}->Z{letters[i]}", g, *(values[j] for j in others))

    return Traced(
        np.einsum(f"{','.join(letters)}->{target}", *values),
        *((x, back(i)) for i, x in enumerate(operands) if isinstance(x, Traced)),
    )


def _solved(A: Any, B: Any) -> Traced:
    """A^-1 B for A (..., n, n) and a vector or columns B (..., n, k); A^-T g goes back to B, less that by B to A."""
    if np.ndim(B) == 1:
        return _solved(A, B[:, None])[:, 0]
    a, b = _value(A), _value(B)
    X = np.linalg.solve(a, b)

    def to_columns(g: Floats) -> Any:
        return np.linalg.solve(a.mT, g)

    ways = (
        (A, lambda g: _unrepeated(-to_columns(g) @ X.mT, a.shape)),
        (B, lambda g: _unrepeated(to_columns(g), b.shape)),
    )
    cost = a.size * (a.shape[-1] + b.shape[-1])
    return Traced(X, *((z, back) for z, back in ways if isinstance(z, Traced)), cost=cost)


def _rearranged(name: str, x: Traced, *arguments: Any, **named: Any) -> Traced:
    return x.gathered(lambda places: getattr(np, name)(places, *arguments, **named))


# Functions of NumPy for such arrays, by name; `kreisel.algebra` accepts it as a library of arrays.
Namespace: Any = SimpleNamespace(
    __name__=__name__,
    concatenate=_concatenate,
    stack=_stack,
    broadcast_to=lambda x, shape: x + np.zeros(shape) if isinstance(x, Traced) else np.broadcast_to(x, shape),
    reshape=lambda x, shape: x.reshape(shape),
    sum=lambda x, axis=None, keepdims=False: x.sum(axis, keepdims),
    mean=lambda x, axis=None, keepdims=False: x.mean(axis, keepdims),
    prod=_prod,
    trace=lambda x, offset=0, axis1=0, axis2=1: _rearranged("diagonal", x, offset, axis1, axis2).sum(-1),
    dot=lambda x, y: x * y if 0 in (np.ndim(x), np.ndim(y)) else _product(x, y),
    inner=_inner,
    vdot=_inner,
    outer=lambda x, y: _traced(x).ravel()[:, None] * _traced(y).ravel(),
    norm=_norm,
    einsum=_sum_of_products,
    linalg=SimpleNamespace(solve=_solved),
    solve=_solved,  # of np.linalg
)


def _value(x: Any) -> Floats:
    return x.value if isinstance(x, Traced) else np.asarray(x)


def _traced(x: Any) -> Traced:
    return x if isinstance(x, Traced) else Traced(x)


def _einsum(names: str, target: str) -> Callable[[Any], Any]:
    return lambda places: np.einsum(f"{names}->{target}", places)


def _entrywise(ufunc: Any, x: Any, y: Any) -> Traced:
    """An entrywise result; slopes are added up over axes along which an array was repeated."""
    a, b = _value(x), _value(y)
    value = ufunc(a, b)

    def way(z: Traced, slope: Callable[..., Any]) -> tuple[Traced, Back]:
        return z, lambda g: _unrepeated(slope(g, a, b, value), z.shape)

    ways = zip((x, y), SLOPES_OF_TWO[ufunc], strict=True)
    return Traced(value, *(way(z, slope) for z, slope in ways if isinstance(z, Traced)))


def _power(base: Any, exponent: Any) -> Traced:
    if not isinstance(base, Traced):
        return (exponent * np.log(base)).by(np.exp)
    if isinstance(exponent, Traced):
        raise NotRecorded("the power x**y", POWER)
    x = base.value
    return Traced(x**exponent, (base, lambda g: g * (exponent * x ** (exponent - 1))))


def _unrepeated(g: Floats, shape: tuple[int, ...]) -> Floats:
    """The slopes (k, ...) of an array that was repeated, added up to (k, *shape)."""
    extra = g.ndim - 1 - len(shape)
    g = g.sum(tuple(range(1, 1 + extra))) if extra > 0 else g
    repeated = tuple(i + 1 for i, size in enumerate(shape) if size == 1 and g.shape[i + 1] > 1)
    return g.sum(repeated, keepdims=True) if repeated else g


def _product(x: Any, y: Any) -> Traced:
    """The product of vectors and matrices."""
    a, b = _value(x), _value(y)
    if a.ndim == 1 or b.ndim == 1:
        lead, end = a.shape[:-1] if a.ndim > 1 else (), b.shape[1:] if b.ndim > 1 else ()
        left = x if a.ndim > 1 else x.reshape((1, -1))
        right = y if b.ndim > 1 else y.reshape((-1, 1))
        return _product(left, right).reshape((*lead, *end))
    if a.ndim != 2 or b.ndim != 2:
        raise NotRecorded(f"a product of arrays of the shapes {a.shape} and {b.shape}", "Use matrices and vectors.")
    ways = ((x, lambda g: g @ b.T), (y, lambda g: a.T @ g))
    return Traced(a @ b, *((z, back) for z, back in ways if isinstance(z, Traced)), cost=a.size * b.shape[1])


def _reached(y: Traced) -> list[Traced]:
    """All arrays that y was made of, y among them, the last one first."""
    result, waiting = {y.place: y}, [y]
    while waiting:
        for parent, _ in waiting.pop().parents:
            if parent.place not in result:
                result[parent.place] = parent
                waiting.append(parent)
    return [result[place] for place in sorted(result, reverse=True)]


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
    """About how many operations of a kernel need as long as y and its gradient."""
    rows = len(y.value)
    calls = 1 + 2 * -(-rows // TOGETHER)
    return sum(CALL * calls + node.cost * (1 + 2 * rows) for node in _reached(y))
