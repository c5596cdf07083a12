"""What a Lagrangian must be, found out before the first step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.reduction.double import double, jax

jnp = jax.numpy
SAMPLE_STEP = 0.01
SINGULAR = 1e-12
TRACING = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerIntegerConversionError,
)


def check_lagrangian(record: Any, known: Mapping[str, Any]) -> None:
    """Real, scalar, differentiable and with an invertible Legendre transform at a random point; else `InputError`."""
    rng = np.random.default_rng(3)
    with double():
        P = jnp.asarray(rng.uniform(0.2, 1, record.rep.dim))
        zero = jnp.zeros(record.group.dim)
        if record.own is not None:
            inner = record.continuous(known)
            _check(inner.value, inner.momentum, zero, P, "L(Omega, P)", "Omega = 0")
        if record.own_discrete is not None:
            inner = record.discrete({**known, "eps": SAMPLE_STEP})

            def value(x: Array, P: Array) -> Array:
                return inner.value(record.group.retract(x), P)

            def before(x: Array, P: Array) -> Array:
                return inner.before(record.group.retract(x), P)

            _check(value, before, zero, P, "Lambda(W, P)", "W = I")


def _check(value: Callable[..., Any], momentum: Callable[..., Any], x: Array, P: Array, name: str, where: str) -> None:
    out = _tried(lambda: jax.eval_shape(value, x, P), name)
    shape = getattr(out, "shape", None)
    if shape != () or not jnp.issubdtype(out.dtype, jnp.floating):
        got = f"shape {shape}, {out.dtype}" if shape is not None else repr(out)
        raise InputError(
            f"The Lagrangian {name} must give one real number, got {got}. Usual cause: a missing sum, trace or .real."
        )
    M, slope = _tried(jax.jit(lambda: (momentum(x, P), jax.jacfwd(momentum)(x, P))), name)
    if not (np.isfinite(M).all() and np.isfinite(slope).all()):
        raise InputError(
            f"The Lagrangian {name} must be twice differentiable; its derivatives are not finite at {where}. "
            "Usual cause: a norm or a square root at 0, a logarithm of 0, or 1/eps without eps."
        )
    values = np.linalg.svd(np.asarray(slope), compute_uv=False)
    if not values[-1] > SINGULAR * max(values[0], 1e-300):
        raise InputError(
            f"The Legendre transform of {name} is singular at {where}: the second derivatives have the singular values "
            f"{np.array2string(values, precision=3)}. Usual cause: a direction without kinetic energy (a moment of "
            "inertia that is 0), or numbers that JAX does not see (plain NumPy, round, sign)."
        )


def _tried(function: Callable[[], Any], name: str) -> Any:
    try:
        return function()
    except TRACING as error:
        raise InputError(
            f"The Lagrangian {name} cannot be differentiated: {str(error).splitlines()[0]} "
            "Usual cause: numpy for jax.numpy, float(...), or an `if` on a value; use jax.numpy and jnp.where."
        ) from error
    except (TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError) as error:
        raise InputError(
            f"The Lagrangian {name} failed: {error} "
            "Usual cause: shapes that do not fit, or a wrong number of arguments; constants are keyword-only."
        ) from error
