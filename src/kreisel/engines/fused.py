"""fma(x, y, z) = x y + z, rounded once, as an intrinsic of compiled kernels."""

from __future__ import annotations

from typing import Any

from numba import njit, types
from numba.extending import intrinsic


@intrinsic
def fma(typing_context: Any, x: Any, y: Any, z: Any) -> Any:
    """LLVM's fused multiply-add of doubles."""
    signature = types.float64(types.float64, types.float64, types.float64)
    return signature, lambda context, builder, kinds, arguments: builder.fma(*arguments)


# Compiled without fast-math flags, so that no product is fused into these sums.


@njit(cache=True)
def plain_sum(x: float, y: float) -> float:
    """X + y, rounded."""
    return x + y


@njit(cache=True)
def sum_error(x: float, y: float) -> float:
    """X + y less their rounded sum, exactly (Knuth's two-sum)."""
    total = x + y
    part = total - x
    return (x - (total - part)) + (y - part)
