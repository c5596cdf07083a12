"""Linear algebra of small JAX matrices without LAPACK; `algebra` uses it for JAX's arrays.

JAX's call of LAPACK for a batch waits inside the pool of threads that is to do the work: two at once on two cores wait
for good (jaxlib 0.10: LU factors of a batch in ParallelBatchMap, both threads in BlockingCounter::Wait).
"""

from __future__ import annotations

import sys

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import nearest_axes
from kreisel.reduction.double import jax, on_host

jnp = jax.numpy
lax = jax.lax


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


algebra.LINEAR_ALGEBRA[jnp.__name__] = sys.modules[__name__]
