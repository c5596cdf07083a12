"""Doubles, and vectors of them, as LLVM's operations: each is that of a number in each place, rounded alike.

So a lane of a vector has the bits of a number.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

from llvmlite import ir

DOUBLE, INTEGER, INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(32)

Emit = Callable[..., Any]


def everywhere(kind: ir.Type, number: float) -> ir.Constant:
    """A constant of a number's or a vector's type."""
    return ir.Constant(kind, [number] * kind.count if isinstance(kind, ir.VectorType) else number)


def spread(builder: ir.IRBuilder, value: Any, kind: ir.VectorType) -> Any:
    """The same number in all places."""
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, INDEX(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(INDEX, kind.count), [0] * kind.count))


def llvm_intrinsic(name: str) -> Emit:
    """A call of LLVM's own function of that name, for numbers and for vectors."""

    def emit(builder: ir.IRBuilder, *values: Any) -> Any:
        kind = values[0].type
        mark = f"v{kind.count}f64" if isinstance(kind, ir.VectorType) else "f64"
        form, full = ir.FunctionType(kind, [kind] * len(values)), f"llvm.{name}.{mark}"
        known = builder.module.globals.get(full)
        return builder.call(known or ir.Function(builder.module, form, full), values)

    return emit


def larger(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """Python's max: x unless y > x."""
    return builder.select(_less(builder, x, y), y, x)


def smaller(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """Python's min: x unless y < x."""
    return builder.select(_less(builder, y, x), y, x)


def _less(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    whole = isinstance(x.type, ir.IntType)
    return builder.icmp_signed("<", x, y) if whole else builder.fcmp_ordered("<", x, y)


def sign_of(builder: ir.IRBuilder, x: Any) -> Any:
    """-1 where x < 0, else 1."""
    less, more = (everywhere(x.type, number) for number in (-1.0, 1.0))
    return builder.select(builder.fcmp_ordered("<", x, everywhere(x.type, 0.0)), less, more)


def lesser_chosen(builder: ir.IRBuilder, x: Any, y: Any, yes: Any, no: Any) -> Any:
    """`yes` where x < y, else `no`."""
    return builder.select(builder.fcmp_ordered("<", x, y), yes, no)


def largest_of(builder: ir.IRBuilder, x: Any) -> Any:
    """The largest of the places of a vector; of those that are numbers, if the first is one."""
    if not isinstance(x.type, ir.VectorType):
        return x
    places = [builder.extract_element(x, INDEX(k)) for k in range(x.type.count)]
    return reduce(lambda a, b: builder.select(builder.fcmp_ordered(">", b, a), b, a), places)


def floor_divided(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """Python's x // y of whole numbers."""
    quotient, rest = builder.sdiv(x, y), builder.srem(x, y)
    return builder.sub(quotient, builder.zext(_other_sign(builder, rest, y), INTEGER))


def remainder(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """Python's x % y of whole numbers."""
    rest = builder.srem(x, y)
    return builder.select(_other_sign(builder, rest, y), builder.add(rest, y), rest)


def below(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """1 where x < y, else 0, of whole numbers without a sign."""
    return builder.zext(builder.icmp_unsigned("<", x, y), INTEGER)


def _other_sign(builder: ir.IRBuilder, rest: Any, y: Any) -> Any:
    apart = builder.icmp_signed("<", builder.xor(rest, y), INTEGER(0))
    return builder.and_(builder.icmp_signed("!=", rest, INTEGER(0)), apart)


def as_kind(builder: ir.IRBuilder, value: Any, kind: ir.Type) -> Any:
    """A number as one of this kind, if nothing of it is lost."""
    if isinstance(value, int | float):
        if kind == INTEGER and isinstance(value, float):
            raise TypeError(f"expected a whole number, got {value!r}")
        return INTEGER(value) if kind == INTEGER else everywhere(kind, float(value))
    if value.type == kind:
        return value
    if isinstance(kind, ir.VectorType) and value.type == DOUBLE:
        return spread(builder, value, kind)
    if kind != DOUBLE or value.type != INTEGER:
        raise TypeError(f"expected {kind}, got {value.type}")
    return builder.sitofp(value, DOUBLE)


def is_whole(value: Any) -> bool:
    """Of LLVM or of Python."""
    return isinstance(value, int) or (isinstance(value, ir.Value) and value.type == INTEGER)
