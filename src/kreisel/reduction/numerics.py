"""JAX in float64, the one door to it; linear algebra of small matrices, which `algebra` uses too; Newton's method.

JAX computes in float32 unless set otherwise, for the entire process.  Kreisel does not change that setting: its
computations run inside `double()`.  To differentiate or vectorise these functions, open the same door:

    with kreisel.reduction.double():
        jax.grad(f)(x)

Arrays that leave it stay float64.  Input of single precision is refused, not silently used.

Linear algebra is without LAPACK.  JAX's call of LAPACK for a batch waits inside the pool of threads that is to do the
work: two at once on two cores wait for good (jaxlib 0.10: LU factors of a batch in ParallelBatchMap, both threads in
BlockingCounter::Wait).

An implicit map is multivalued: Newton's method follows the branch with the continuous limit, which starts at x = 0,
W = I or Omega = 0.  The root of r(x) = (1 - s) r(0) is followed from x = 0 at s = 0 to s = 1, in one stretch if
possible.  A stretch is accepted if Newton's method converged to the root next to its start: the distance is at most
twice the first step, as in Kantorovich's theorem, and the determinant of the Jacobian has kept its sign.  Otherwise it
is cut.  If the path reaches a fold there is no root on the branch, and x is NaN.  Derivatives of the root, of any
order, come from the implicit function theorem.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import nearest_axes
from kreisel.errors import InputError

try:
    import jax as jax
except ImportError as error:
    raise InputError(
        f"kreisel.reduction needs JAX, and {error.name} is missing. Install it with: pip install 'kreisel[reduction]'"
    ) from error

jnp = jax.numpy
lax = jax.lax

TOLERANCE = 1e-10  # of the last step with the inverse at the end of the path
REFINEMENTS = 2  # such steps, each of which gains six digits
SLACK = 1e-6  # a Newton step as short as this ends a stretch; the error after it is its square
MOST_ITERATIONS = 20
SHORTEST = 1 / 1024  # of the path
Residual = Callable[..., Array]
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


# -- linear algebra ----------------------------------------------------------------------------------


def solve(A: Array, B: Array) -> Array:
    """A^-1 B for A (..., N, N) and B (..., N, k)."""
    return inverse(A) @ B


def inverse(A: Array) -> Array:
    """A^-1 for A (..., N, N); not finite if A is singular."""
    return inverse_and_determinant(A)[0]


def slogdet(A: Array) -> tuple[Array, Array]:
    """The sign of det A and log |det A| for A (..., N, N)."""
    determinant = inverse_and_determinant(A)[1]
    return jnp.sign(determinant), jnp.log(abs(determinant))


@jax.custom_jvp
def inverse_and_determinant(A: Array) -> tuple[Array, Array]:
    """A^-1 and det A for A (..., N, N), by Gauss and Jordan with partial pivoting.

    d(A^-1) = -A^-1 dA A^-1, d det A = det A Tr(A^-1 dA).
    """
    inverse, determinant = jnp.vectorize(_eliminated, signature="(n,n)->(n,n),()")(A)
    return inverse, determinant


@inverse_and_determinant.defjvp
def _jvp(at: tuple[Array], along: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    Y, determinant = inverse_and_determinant(*at)
    return (Y, determinant), (-Y @ along[0] @ Y, determinant * (Y.swapaxes(-1, -2) * along[0]).sum((-2, -1)))


@jax.custom_jvp
def principal_axes(A: Array) -> tuple[Array, Array]:
    """Axes as by `algebra.principal_axes`, from NumPy.  With W = R^T dA R: dR = R F, F_ij = W_ij/(v_j - v_i)."""
    shapes = jnp.zeros(A.shape[:-1]), jnp.zeros(A.shape)
    axes: tuple[Array, Array] = on_host(nearest_axes, shapes, A, vmap_method="sequential")
    return axes


@principal_axes.defjvp
def _jvp_of_axes(at: tuple[Array], along: tuple[Array]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    values, R = principal_axes(*at)
    W, gaps = R.T @ along[0] @ R, values[None, :] - values[:, None]
    F = W * jnp.where(gaps == 0, 0.0, 1 / jnp.where(gaps == 0, 1.0, gaps))
    return (values, R), (jnp.diag(W), R @ F)


def _eliminated(A: Array) -> tuple[Array, Array]:
    n = A.shape[-1]
    rows = jnp.arange(n)

    def eliminate(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        augmented, determinant = carry
        p = jnp.argmax(jnp.where(rows >= k, abs(augmented[:, k]), -1.0))
        augmented = augmented[jnp.where(rows == k, p, jnp.where(rows == p, k, rows))]
        pivot = augmented[k, k]
        row = augmented[k] / pivot
        others = augmented - jnp.where(rows == k, 0.0, augmented[:, k])[:, None] * row
        return jnp.where((rows == k)[:, None], row, others), determinant * jnp.where(p == k, pivot, -pivot)

    start = jnp.concatenate([A, jnp.eye(n, dtype=A.dtype)], axis=1), jnp.ones((), A.dtype)
    augmented, determinant = lax.fori_loop(0, n, eliminate, start)
    return augmented[:, n:], determinant


# -- roots ------------------------------------------------------------------------------------------


def find_root(residual: Residual, dim: int, *args: Any) -> Array:
    """The root x (dim,) of residual(x, *args) on the branch of x = 0; NaN if there is none."""
    start, inverse = _follow(lambda x: residual(x, *lax.stop_gradient(args)), dim)

    def refined(f: Callable[[Array], Array], x: Array) -> Array:
        for _ in range(REFINEMENTS):
            step = inverse @ f(x)
            x = x - step
        return jnp.where(jnp.linalg.norm(step) <= TOLERANCE, x, jnp.nan)

    def tangent(slope: Callable[[Array], Array], y: Array) -> Array:
        return solve(jax.jacfwd(slope)(jnp.zeros(dim)), y[:, None])[:, 0]

    return lax.custom_root(lambda x: residual(x, *args), start, refined, tangent)


def _follow(residual: Callable[[Array], Array], dim: int) -> tuple[Array, Array]:
    """The root up to SLACK and the inverse of the Jacobian there; NaN if the branch ends.

    One loop for the path and Newton's iterations on it, so that the Jacobian is compiled once.
    """
    slope = jax.jacfwd(lambda x: (residual(x),) * 2, has_aux=True)

    def going(c: dict[str, Array]) -> Array:
        return (c["reached"] < 1) & (c["stretch"] >= SHORTEST)

    def onward(c: dict[str, Array]) -> dict[str, Array]:
        J, r = slope(c["x"])
        first = c["iteration"] == 0
        offset = jnp.where(first & (c["reached"] == 0), r, c["offset"])
        inverse, determinant = inverse_and_determinant(J)
        base = jnp.where(first, determinant, c["base"])
        target = jnp.minimum(c["reached"] + c["stretch"], 1.0)
        step = inverse @ (r - (1 - target) * offset)
        reach = jnp.where(first, jnp.linalg.norm(step), c["reach"])
        new = c["x"] - step
        size = jnp.linalg.norm(step)
        arrived = (size <= SLACK) & (base * determinant > 0)
        arrived &= jnp.linalg.norm(new - c["from"]) <= 2 * reach + SLACK
        failed = ~arrived & ((size <= SLACK) | (c["iteration"] >= MOST_ITERATIONS) | ~jnp.isfinite(size))
        over = arrived | failed
        return {
            "reached": jnp.where(arrived, target, c["reached"]),
            "stretch": jnp.where(arrived, 2 * c["stretch"], jnp.where(failed, c["stretch"] / 4, c["stretch"])),
            "from": jnp.where(arrived, new, c["from"]),
            "x": jnp.where(failed, c["from"], new),
            "iteration": jnp.where(over, 0, c["iteration"] + 1),
            "offset": offset,
            "base": base,
            "reach": reach,
            "inverse": inverse,
        }

    zero, square = jnp.zeros(dim), jnp.zeros((dim, dim))
    begin = {"reached": 0.0, "stretch": 1.0, "from": zero, "x": zero, "iteration": 0, "offset": zero, "reach": 0.0}
    begin |= {"base": 0.0, "inverse": square}
    end = lax.while_loop(going, onward, jax.tree.map(jnp.asarray, begin))
    return lax.stop_gradient((jnp.where(end["reached"] >= 1, end["x"], jnp.nan), end["inverse"]))


algebra.LINEAR_ALGEBRA[jnp.__name__] = sys.modules[__name__]
