"""Double-doubles as LLVM's operations: unevaluated sums of two doubles, about 31 digits, for numbers and vectors.

The operations are those of Dekker and Knuth with fused products.  The last one or two of 106 bits may be wrong, in a
sum those of the larger term: half the operations of one that is as exact where terms cancel.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import ir

from kreisel.kernels._llvm.numbers import llvm_intrinsic

Two = tuple[Any, Any]  # the upper and the lower double


class DoubleDouble(NamedTuple):
    """Its two numbers, or vectors."""

    upper: Any
    lower: Any


fused = llvm_intrinsic("fma")


def _two_sum(builder: ir.IRBuilder, x: Any, y: Any) -> Two:
    total = builder.fadd(x, y)
    part = builder.fsub(total, x)
    return total, builder.fadd(builder.fsub(x, builder.fsub(total, part)), builder.fsub(y, part))


def _ordered(builder: ir.IRBuilder, x: Any, y: Any) -> Two:
    """The sum of a large and a small number and its error."""
    total = builder.fadd(x, y)
    return total, builder.fsub(y, builder.fsub(total, x))


def _add(builder: ir.IRBuilder, x: Two, y: Two) -> Two:
    upper, error = _two_sum(builder, x[0], y[0])
    return _ordered(builder, upper, builder.fadd(error, builder.fadd(x[1], y[1])))


def _negative(builder: ir.IRBuilder, x: Two) -> Two:
    return builder.fneg(x[0]), builder.fneg(x[1])


def _multiply(builder: ir.IRBuilder, x: Two, y: Two) -> Two:
    product = builder.fmul(x[0], y[0])
    error = fused(builder, x[0], y[0], builder.fneg(product))
    return _ordered(builder, product, fused(builder, x[0], y[1], fused(builder, x[1], y[0], error)))


def _divide(builder: ir.IRBuilder, x: Two, y: Two) -> Two:
    quotient = builder.fdiv(x[0], y[0])
    back = builder.fneg(quotient)
    rest = fused(builder, back, y[1], builder.fadd(fused(builder, back, y[0], x[0]), x[1]))
    return _ordered(builder, quotient, builder.fdiv(rest, y[0]))


def _pair_sqrt(builder: ir.IRBuilder, x: Two) -> Two:
    root = llvm_intrinsic("sqrt")(builder, x[0])
    rest = builder.fadd(fused(builder, builder.fneg(root), root, x[0]), x[1])
    return _ordered(builder, root, builder.fdiv(rest, builder.fadd(root, root)))


OPERATIONS: dict[Callable[..., Any], Callable[..., Two]] = {
    operator.add: _add,
    operator.sub: lambda builder, x, y: _add(builder, x, _negative(builder, y)),
    operator.mul: _multiply,
    operator.truediv: _divide,
    operator.neg: _negative,
    math.sqrt: _pair_sqrt,
}
