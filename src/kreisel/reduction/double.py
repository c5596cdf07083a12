"""The one door to JAX: float64 while Kreisel computes, the user's own settings outside.

JAX computes in float32 unless told otherwise, for the whole process.  Kreisel leaves that switch alone: all that it
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
    import optimistix
except ImportError as error:
    raise InputError(
        f"kreisel.reduction needs JAX and Optimistix, and {error.name} is missing. "
        "Install them with: pip install 'kreisel[reduction]'"
    ) from error

# With asynchronous dispatch a Newton step for n = 5 now and then stood still for good on two cores (JAX 0.10); without,
# in none of six runs.  A client that the user's own code has begun keeps what it has.
jax.config.update("jax_cpu_enable_async_dispatch", False)  # type: ignore[no-untyped-call]

__all__ = ["double", "is_jax", "jax", "optimistix", "require_double"]


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
                "A JAX array in float32 came; Kreisel computes in float64. "
                "Usual cause: jax.grad, jax.vmap or jax.numpy used outside; write `with kreisel.reduction.double():`."
            )
