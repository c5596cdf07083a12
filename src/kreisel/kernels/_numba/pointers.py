"""Compiled functions that are called by their address: a kernel that does so is compiled without them."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

INTEGER = ir.IntType(64)


@intrinsic
def call_at_address(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call the function at `address`, made by `numba.cfunc`, which takes a tuple of integers and returns nothing."""

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [INTEGER] * len(arguments))
        given = [builder.extract_value(values[1], i) for i in range(len(arguments))]
        builder.call(builder.inttoptr(values[0], kind.as_pointer()), given)
        return context.get_dummy_value()

    return signature(types.void, types.int64, types.UniTuple(types.int64, len(arguments))), emit


def _element_pointer(builder: ir.IRBuilder, kind: ir.Type, address: Any, i: Any) -> Any:
    return builder.gep(builder.inttoptr(address, kind.as_pointer()), [i])


def _reader(kind: ir.Type, out: Any) -> Any:
    @intrinsic
    def read(typing_context: Any, address: Any, i: Any) -> Any:
        def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
            value = builder.load(_element_pointer(builder, kind, *values))
            return builder.sext(value, INTEGER) if kind == ir.IntType(32) else value

        return signature(out, types.int64, types.int64), emit

    return read


# Number i of those at an address; no array, whose strides and signs of indices cost as much as the number.
double_at = _reader(ir.DoubleType(), types.float64)
integer_at = _reader(ir.IntType(32), types.int64)
long_at = _reader(INTEGER, types.int64)


@intrinsic
def put_double(typing_context: Any, address: Any, i: Any, value: Any) -> Any:
    """Double i at an address becomes `value`."""

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        builder.store(values[2], _element_pointer(builder, ir.DoubleType(), *values[:2]))
        return context.get_dummy_value()

    return signature(types.void, types.int64, types.int64, types.float64), emit
