"""Operations whose rounding is given, as intrinsics of compiled kernels, for numbers and for vectors of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from kreisel.kernels._numba.vector_type import common, everywhere, llvm_intrinsic


def _of(kinds: tuple[Any, ...], emit: Callable[..., Any]) -> Any:
    """`emit` of numbers, or of vectors and numbers."""
    kind = common(kinds) or types.float64
    return signature(kind, *[kind] * len(kinds)), lambda context, builder, form, values: emit(builder, *values)


def sign_of(builder: ir.IRBuilder, x: Any) -> Any:
    """-1 where x < 0, else 1, as LLVM's operations."""
    less, more = (everywhere(x.type, number) for number in (-1.0, 1.0))
    return builder.select(builder.fcmp_ordered("<", x, everywhere(x.type, 0.0)), less, more)


@intrinsic
def fma(typing_context: Any, x: Any, y: Any, z: Any) -> Any:
    """x y + z, rounded once: LLVM's fused multiply-add."""
    return _of((x, y, z), llvm_intrinsic("fma"))


@intrinsic
def sign(typing_context: Any, x: Any) -> Any:
    """-1 where x < 0, else 1."""
    return _of((x,), sign_of)


@intrinsic
def nearest(typing_context: Any, x: Any) -> Any:
    """The whole number next to x; of two the even one."""
    return _of((x,), llvm_intrinsic("rint"))


@intrinsic
def size(typing_context: Any, x: Any) -> Any:
    """|x|."""
    return _of((x,), llvm_intrinsic("fabs"))


def lesser_chosen(builder: ir.IRBuilder, x: Any, y: Any, yes: Any, no: Any) -> Any:
    """`yes` where x < y, else `no`, as LLVM's operations."""
    return builder.select(builder.fcmp_ordered("<", x, y), yes, no)


def largest_of(builder: ir.IRBuilder, x: Any) -> Any:
    """The largest of the places of a vector, as LLVM's operations."""
    if not isinstance(x.type, ir.VectorType):
        return x
    places = [builder.extract_element(x, ir.IntType(32)(k)) for k in range(x.type.count)]
    return reduce(lambda a, b: builder.select(builder.fcmp_ordered(">", b, a), b, a), places)


@intrinsic
def where_less(typing_context: Any, x: Any, y: Any, yes: Any, no: Any) -> Any:
    """`yes` where x < y, else `no`."""
    return _of((x, y, yes, no), lesser_chosen)


@intrinsic
def largest(typing_context: Any, x: Any) -> Any:
    """The largest of the places of a vector; no number if one of them is none."""
    return signature(types.float64, x), lambda context, builder, form, values: largest_of(builder, *values)
