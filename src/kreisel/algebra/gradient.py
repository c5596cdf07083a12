"""Values and gradients of scalar functions, by a reverse sweep, over any kind of number.

The function is run once on values that record their operations; the values may be floats, arrays of lanes, fractions or
recorded values, so a gradient can be compiled like any other formula.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from kreisel.algebra.backend import Array, holds_objects, objects, sqrt
from kreisel.algebra.recorded import Recorded, sign, where_less
from kreisel.errors import InputError


def _function(name: str) -> Callable[[Any], Any]:
    """sin, cos, exp or log, defined by the number itself or by NumPy."""

    def apply(x: Any) -> Any:
        if hasattr(x, name):
            return getattr(x, name)()
        return objects(map(apply, x.flat), x.shape)[()] if holds_objects(x) else getattr(np, name)(x)

    return apply


LEAST = 5e-324  # the least double that is not 0
sin, cos, exp, log = (_function(name) for name in ("sin", "cos", "exp", "log"))
UNARY = {"sqrt": sqrt, "sin": sin, "cos": cos, "exp": exp, "log": log}
# Derivatives of an operation with respect to its operands: slopes(value, *operands).
SLOPES: dict[str, Callable[..., tuple[Any, ...]]] = {
    "+": lambda value, x, y: (1, 1),
    "-": lambda value, x, y: (1, -1),
    "*": lambda value, x, y: (y, x),
    "/": lambda value, x, y: (1 / y, -value / y),
    "sqrt": lambda value, x: (1 / (2 * value),),
    "sin": lambda value, x: (cos(x),),
    "cos": lambda value, x: (-sin(x),),
    "exp": lambda value, x: (value,),
    "log": lambda value, x: (1 / x,),
}


def _binary(operation: str, apply: Callable[[Any, Any], Any]) -> Callable[[TracedNumber, Any], Any]:
    def operate(self: TracedNumber, operand: Any) -> Any:
        if _is_array(operand):
            return NotImplemented
        operand = operand[()] if isinstance(operand, np.ndarray) else operand  # x[..., 1] of an array of objects
        return self._by(operation, apply(self.value, _value(operand)), self, operand)

    return operate


def _unary(operation: str) -> Callable[[TracedNumber], TracedNumber]:
    return lambda self: self._by(operation, UNARY[operation](self.value), self)


class TracedNumber(Recorded):
    """A number that stores its operands, and its derivatives with respect to them."""

    __slots__ = ("parents", "place", "tape", "value")
    traces: ClassVar[bool] = True  # its value is a number of another kind

    def __init__(self, tape: list[TracedNumber], value: Any, parents: tuple[tuple[TracedNumber, Any], ...] = ()):
        self.tape, self.value, self.parents, self.place = tape, value, parents, len(tape)
        tape.append(self)

    def _of(self, value: Any, *parents: tuple[Any, Any]) -> TracedNumber:
        return TracedNumber(self.tape, value, tuple((x, slope) for x, slope in parents if isinstance(x, TracedNumber)))

    def _by(self, operation: str, value: Any, *operands: Any) -> TracedNumber:
        slopes = SLOPES[operation](value, *map(_value, operands))
        return self._of(value, *zip(operands, slopes, strict=True))

    def __neg__(self) -> TracedNumber:
        return self._of(-self.value, (self, -1))

    def __pos__(self) -> TracedNumber:
        return self

    __add__ = __radd__ = _binary("+", operator.add)
    __sub__ = _binary("-", operator.sub)
    __mul__ = __rmul__ = _binary("*", operator.mul)
    __truediv__ = _binary("/", operator.truediv)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __rtruediv__(self, other: Any) -> Any:
        if _is_array(other):
            return NotImplemented
        out = other / self.value
        return self._of(out, (self, -out / self.value))

    def __pow__(self, exponent: Any) -> Any:
        if isinstance(exponent, TracedNumber) or not _is_whole(2 * exponent):
            return (exponent * self.log()).exp()
        if not _is_whole(exponent):  # so that x^1.5 has a derivative at 0
            count = round(exponent - 0.5)
            if count < 1:
                return self.sqrt() * self**count
            low = sqrt(self.value) if count == 1 else sqrt(self.value) * _power(self.value, count - 1)
            return self._of(low * self.value, (self, exponent * low))
        count = int(exponent)
        if count < 0:
            return 1 / self**-count
        return _power(self, count) if count else self * 0 + 1

    def __rpow__(self, base: Any) -> Any:
        return (self * np.log(base)).exp()

    sqrt, sin, cos, exp, log = (_unary(name) for name in ("sqrt", "sin", "cos", "exp", "log"))

    def tan(self) -> TracedNumber:
        return self.sin() / self.cos()

    def sinh(self) -> TracedNumber:
        return (self.exp() - (-self).exp()) / 2

    def cosh(self) -> TracedNumber:
        return (self.exp() + (-self).exp()) / 2

    def tanh(self) -> TracedNumber:
        return 1 - 2 / ((2 * self).exp() + 1)

    def conjugate(self) -> TracedNumber:
        return self

    def square(self) -> TracedNumber:
        return self * self

    def __abs__(self) -> Any:
        return ChosenNumber(self.tape, abs(self.value), ((self, sign(self.value)),))

    @staticmethod
    def where_less(x: Any, y: Any, yes: Any, no: Any) -> Any:
        """`yes` if x < y, else `no`."""
        tape = next(v.tape for v in (x, y, yes, no) if isinstance(v, TracedNumber))
        a, b, *values = (_value(v) for v in (x, y, yes, no))
        shares = where_less(a, b, 1, 0), where_less(a, b, 0, 1)
        parents = [(v, s) for v, s in zip((yes, no), shares, strict=True) if isinstance(v, TracedNumber)]
        return ChosenNumber(tape, where_less(a, b, *values), tuple(parents))


class ChosenNumber(TracedNumber):
    """A number that a comparison chose; the derivative of the other value does not count, even if it is not finite."""

    __slots__ = ()


def _power(x: Any, count: int) -> Any:
    half = x if count == 1 else _power(x, count // 2)
    return half if count == 1 else half * half * x if count % 2 else half * half


def _is_array(x: Any) -> bool:
    return isinstance(x, np.ndarray) and x.ndim > 0


def _is_whole(x: Any) -> bool:
    return isinstance(x, int | np.integer) or (isinstance(x, float) and x.is_integer())


def _value(x: Any) -> Any:
    if isinstance(x, complex | np.complexfloating):
        raise InputError(f"expected real values, got {x}")
    return x.value if isinstance(x, TracedNumber) else x


def with_slope(function: Callable[[Any], Any], x: Any, slope: Any) -> Any:
    """function(x) of one number, with a known derivative."""
    return x._of(function(x.value), (x, slope)) if isinstance(x, TracedNumber) else function(x)


def traced(tape: list[TracedNumber], x: Array, axes: int) -> Any:
    """x (..., *shape), with `axes` axes after its batch, as an array of this shape, or a number, with batches."""
    if axes == 0:
        return TracedNumber(tape, x)
    shape = np.shape(x)[np.ndim(x) - axes :]
    return objects((TracedNumber(tape, _entry(x, place)) for place in np.ndindex(*shape)), shape)


def _entry(x: Array, place: tuple[int, ...]) -> Any:
    """The entry of each lane; of an array of objects without lanes a number, not an array without axes."""
    entry = x[(..., *place)]
    return entry[()] if holds_objects(entry) else entry


def value_and_gradient(function: Callable[..., Any], arguments: Sequence[tuple[Array, int]]) -> tuple[Any, list[Any]]:
    """The value of a scalar function and its derivatives with respect to each argument (x, axes), in the shape of x.

    Raises `InputError` for anything but a scalar.
    """
    tape: list[TracedNumber] = []
    values = [traced(tape, x, axes) for x, axes in arguments]
    out = function(*values)
    out = out.item() if isinstance(out, np.ndarray) and out.size == 1 else out
    if not isinstance(out, TracedNumber | Real):
        raise InputError(f"expected one number, got {type(out).__name__} of shape {np.shape(out)}")
    if not isinstance(out, TracedNumber):
        return out, [0 * x for x, _ in arguments]
    slopes = _swept(tape, out)
    return out.value, [_assembled(x, node, slopes, axes) for (x, axes), node in zip(arguments, values, strict=True)]


def _assembled(x: Array, nodes: Any, slopes: list[Any], axes: int) -> Any:
    """The slopes of the entries of an argument, as an array of its shape."""
    result = [slopes[v.place] if v.place < len(slopes) else 0 for v in np.ravel(np.array(nodes, dtype=object))]
    if axes == 0:
        return result[0]
    shape = np.shape(x)[np.ndim(x) - axes :]
    if holds_objects(x):
        return objects(result, shape)
    batch = np.shape(x)[: np.ndim(x) - axes]
    kind = np.result_type(x.dtype, *(np.asarray(v).dtype for v in result))
    columns = [np.broadcast_to(np.asarray(v, dtype=kind), np.broadcast_shapes(batch, np.shape(v))) for v in result]
    spread = np.broadcast_arrays(*columns)
    return np.stack(spread, -1).reshape((*spread[0].shape, *shape))


def value_and_jacobian(
    function: Callable[..., Sequence[Any]], x: Sequence[Any], constants: Sequence[tuple[Array, int]] = ()
) -> tuple[list[Any], list[list[Any]]]:
    """f_i and d f_i/d x_j of a function of the scalars x, each with its batch, and of constants (value, axes)."""
    tape: list[TracedNumber] = []
    variables = [TracedNumber(tape, v) for v in x]
    traced_constants = [traced(tape, v, axes) for v, axes in constants]
    values = function(variables, *traced_constants)
    moves = [place < len(variables) for place in range(len(tape))]  # values that change with x
    for node in tape:
        moves[node.place] = moves[node.place] or any(moves[parent.place] for parent, _ in node.parents)
    rows = [_swept(tape, v, moves) if isinstance(v, TracedNumber) else [] for v in values]
    return [_value(v) for v in values], [(row + [0] * len(variables))[: len(variables)] for row in rows]


def _swept(tape: list[TracedNumber], out: TracedNumber, moves: Sequence[bool] | None = None) -> list[Any]:
    """The derivatives of a number with respect to all before it, by a reverse sweep; `moves`: those that matter."""
    slopes: list[Any] = [0] * (out.place + 1)
    slopes[out.place] = 1
    plain = {out.place}  # places of values that do not only go into choices
    for node in reversed(tape[: out.place + 1]):
        adjoint = slopes[node.place]
        if isinstance(adjoint, int) and adjoint == 0:
            continue
        free = node.place in plain
        for parent, slope in node.parents:
            if moves is None or moves[parent.place]:
                gain = adjoint * slope if free else where_less(abs(adjoint), LEAST, 0, adjoint * slope)
                slopes[parent.place] = slopes[parent.place] + gain
                if free and not isinstance(node, ChosenNumber):
                    plain.add(parent.place)
    return slopes
