"""Compiled functions that are called by their address: a kernel that does so is compiled without them."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

INTEGER = ir.IntType(64)


@intrinsic
def call(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call the function at `address`, made by `numba.cfunc`, which takes a tuple of integers and returns nothing."""

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [INTEGER] * len(arguments))
        given = [builder.extract_value(values[1], i) for i in range(len(arguments))]
        builder.call(builder.inttoptr(values[0], kind.as_pointer()), given)
        return context.get_dummy_value()

    return signature(types.void, types.int64, types.UniTuple(types.int64, len(arguments))), emit


def _pointer(kind: Any) -> Any:
    @intrinsic
    def pointer(typing_context: Any, address: Any) -> Any:
        def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
            return builder.inttoptr(values[0], context.get_value_type(types.CPointer(kind)))

        return signature(types.CPointer(kind), types.int64), emit

    return pointer


doubles, integers, longs = map(_pointer, (types.float64, types.int32, types.int64))
