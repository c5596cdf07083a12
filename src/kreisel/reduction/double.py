"""The one door to JAX: float64 while Kreisel computes, the user's own settings outside.

JAX computes in float32 unless set otherwise, for the whole process.  Kreisel leaves that switch alone: all that it
does itself runs inside `double()`.  Whoever differentiates or vectorises these functions opens the same door:

    with kreisel.reduction.double():
        jax.grad(f)(x)

Arrays that leave it stay float64.  Numbers of single precision that come in are refused, not silently used.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any

from kreisel.errors import InputError

try:
    import jax
except ImportError as error:
    raise InputError(
        f"kreisel.reduction needs JAX, and {error.name} is missing. Install it with: pip install 'kreisel[reduction]'"
    ) from error

__all__ = ["double", "is_jax", "jax", "require_double"]


def double() -> AbstractContextManager[Any]:
    """A context in which JAX computes in float64."""
    return jax.enable_x64(True)


def is_jax(*values: Any) -> bool:
    """True if any value is a JAX array or tracer."""
    return any(isinstance(v, jax.Array) for v in values)


def require_double(*values: Any) -> None:
    """Raise `InputError` if a value is a JAX array of single precision."""
    for v in values:
        if isinstance(v, jax.Array) and v.dtype in (jax.numpy.float32, jax.numpy.complex64):
            raise InputError(
                "expected float64, got a JAX array in float32. "
                "Usual cause: jax.grad, jax.vmap or jax.numpy used outside; write `with kreisel.reduction.double():`."
            )
