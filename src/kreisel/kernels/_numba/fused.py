"""Operations whose rounding is given, as intrinsics of code that Numba compiles."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from kreisel.kernels._llvm.numbers import Emit, llvm_intrinsic, sign_of


def _of(count: int, emit: Emit) -> Any:
    """`emit` of so many numbers."""
    form = signature(types.float64, *[types.float64] * count)
    return form, lambda context, builder, form, values: emit(builder, *values)


@intrinsic
def fma(typing_context: Any, x: Any, y: Any, z: Any) -> Any:
    """x y + z, rounded once: LLVM's fused multiply-add."""
    return _of(3, llvm_intrinsic("fma"))


@intrinsic
def sign(typing_context: Any, x: Any) -> Any:
    """-1 where x < 0, else 1."""
    return _of(1, sign_of)
