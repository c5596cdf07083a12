"""What straight-line text may call: operations on numbers, vectors and double-doubles, and those on memory."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from kreisel.kernels._llvm import memory
from kreisel.kernels._llvm.numbers import (
    Emit,
    below,
    floor_divided,
    larger,
    largest_of,
    lesser_chosen,
    llvm_intrinsic,
    remainder,
    sign_of,
    smaller,
)


@dataclass(frozen=True, eq=False)
class Operation:
    """A name of the text.

    emit        makes it of LLVM's values, of doubles and vectors where it is of numbers
    of_numbers  whether these are to be of one kind: numbers, vectors or double-doubles, those of the widest of them
    of_wholes   the same for whole numbers
    of_python   for numbers of Python, which are known; double-doubles have `OPERATIONS` by it
    """

    name: str
    emit: Emit | None
    of_numbers: bool = False
    of_wholes: Emit | None = None
    of_python: Callable[..., Any] | None = None


def _elementwise(name: str, emit: Emit | None, of_python: Any = None, of_wholes: Any = None) -> Operation:
    return Operation(name, emit, True, of_wholes, of_python)


OPERATORS: dict[type, Operation] = {
    ast.Add: _elementwise("+", ir.IRBuilder.fadd, operator.add, ir.IRBuilder.add),
    ast.Sub: _elementwise("-", ir.IRBuilder.fsub, operator.sub, ir.IRBuilder.sub),
    ast.Mult: _elementwise("*", ir.IRBuilder.fmul, operator.mul, ir.IRBuilder.mul),
    ast.Div: _elementwise("/", ir.IRBuilder.fdiv, operator.truediv),
    ast.FloorDiv: _elementwise("//", None, operator.floordiv, floor_divided),
    ast.Mod: _elementwise("%", None, operator.mod, remainder),
    ast.USub: _elementwise("-", ir.IRBuilder.fneg, operator.neg, ir.IRBuilder.neg),
}

CALLABLE: dict[Any, Operation] = {
    math.sqrt: _elementwise("sqrt", llvm_intrinsic("sqrt"), math.sqrt),
    **{getattr(math, name): _elementwise(name, llvm_intrinsic(name)) for name in ("sin", "cos", "exp", "log")},
    max: _elementwise("max", larger, max, larger),
    min: _elementwise("min", smaller, min, smaller),
}

# `Any`: to who reads the text they are functions.
fma: Any = _elementwise("fma", llvm_intrinsic("fma"))  # x y + z, rounded once
nearest: Any = _elementwise("nearest", llvm_intrinsic("rint"))  # the whole number next to x; of two the even one
size: Any = _elementwise("size", llvm_intrinsic("fabs"))
sign: Any = _elementwise("sign", sign_of)
where_less: Any = _elementwise("where_less", lesser_chosen)
largest: Any = _elementwise("largest", largest_of)
pair: Any = Operation("pair", None)  # the double-double of its two numbers
upper: Any = Operation("upper", None)  # the double next to a double-double

# Of whole numbers of 64 places: shifts that bring zeros in, and 1 where x < y of those without a sign.
shifted_left: Any = _elementwise("shifted_left", None, of_wholes=ir.IRBuilder.shl)
shifted_right: Any = _elementwise("shifted_right", None, of_wholes=ir.IRBuilder.lshr)
carry: Any = _elementwise("carry", None, of_wholes=below)

(
    gather, scatter, numbers, put_numbers, load, store, double_at, whole_at, long_at, put_double, put_whole,
    vector_at, put_vector, call_at_address,
) = (
    Operation(emit.__name__, emit)
    for emit in (
        memory.gather, memory.scatter, memory.numbers, memory.put_numbers, memory.load, memory.store, memory.double_at,
        memory.whole_at, memory.long_at, memory.put_double, memory.put_whole, memory.vector_at, memory.put_vector,
        memory.call_at_address,
    )
)  # fmt: skip
