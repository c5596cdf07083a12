"""Compiled functions that are called by their address: a kernel that does so is compiled without them."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from kreisel.kernels._llvm import memory


@intrinsic
def call_at_address(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call the function at `address`, which takes a tuple of whole numbers and returns nothing."""

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        given = [builder.extract_value(values[1], i) for i in range(len(arguments))]
        memory.call_at_address(builder, values[0], given)
        return context.get_dummy_value()

    return signature(types.void, types.int64, types.UniTuple(types.int64, len(arguments))), emit
