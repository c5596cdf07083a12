"""The one door to JAX: float64 while Kreisel computes, the user's settings outside.

JAX computes in float32 unless set otherwise, for the entire process.  Kreisel does not change that setting: its
computations run inside `double()`.  To differentiate or vectorise these functions, open the same door:

    with kreisel.reduction.double():
        jax.grad(f)(x)

Arrays that leave it stay float64.  Input of single precision is refused, not silently used.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from kreisel.errors import InputError

try:
    import jax
except ImportError as error:
    raise InputError(
        f"kreisel.reduction needs JAX, and {error.name} is missing. Install it with: pip install 'kreisel[reduction]'"
    ) from error

__all__ = ["double", "is_jax", "jax", "on_host", "require_double"]
Struct: Any = jax.ShapeDtypeStruct


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


def on_host(function: Callable[..., Any], shapes: Any, *args: Any, **options: Any) -> Any:
    """A function of trees of NumPy arrays in float64, as a function of JAX.

    The bits are passed as integers: a thread of XLA may call it, in which JAX would convert floats to float32.
    """

    def host(*values: Any) -> Any:
        out = function(*jax.tree.map(lambda v: np.array(v, order="C").view(np.float64)[..., 0], values))
        return jax.tree.map(lambda v: np.ascontiguousarray(v, np.float64)[..., None].view(np.uint32), out)

    def halves(v: Any) -> Any:
        return jax.lax.bitcast_convert_type(jax.numpy.asarray(v, dtype=np.float64), np.uint32)

    wanted = jax.tree.map(lambda v: Struct((*v.shape, 2), np.dtype(np.uint32)), shapes)
    bits = jax.pure_callback(host, wanted, *jax.tree.map(halves, args), **options)
    return jax.tree.map(lambda v: jax.lax.bitcast_convert_type(v, np.float64), bits)
