"""Linear algebra of small matrices, unrolled: LAPACK's calls and their pivots cost more than the arithmetic."""

from __future__ import annotations

from kreisel.algebra import Array
from kreisel.reduction.double import jax

jnp = jax.numpy


def solve(A: Array, B: Array) -> Array:
    """A^-1 B for (N, N) and (N, k) by Gauss and Jordan without pivoting, for A near the identity.

    Safe for A = I - X with X skew, and for A = I + W with W orthogonal: their symmetric parts are positive.
    """
    n = A.shape[-1]
    for k in range(n):
        here = jnp.arange(n)[:, None] == k
        row, right = A[k] / A[k, k], B[k] / A[k, k]
        A, B = jnp.where(here, row, A - A[:, k : k + 1] * row), jnp.where(here, right, B - A[:, k : k + 1] * right)
    return B
