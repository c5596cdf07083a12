"""Constructions that several records share: block matrices, su(2), and the spins of a chain."""

import numpy as np

from kreisel.algebra import Array, identity, together

Spins = tuple[Array, ...]  # three vectors x, y, z (..., n) of components, an entry per site


def shifted(x: Array, k: int) -> Array:
    """x_(i+k) on the ring of the sites."""
    if hasattr(x, "record_shift"):
        return x.record_shift(k)
    return x.__array_namespace__().concatenate([x[..., k:], x[..., :k]], -1)


def cross(a: Spins, b: Spins) -> Spins:
    """a x b at each site."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def inner(a: Spins, b: Spins) -> Array:
    """<a, b> at each site."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def border(m, v, w=None):
    """[[m, v], [w^T, 0]] of size n + 1; w = v if not given."""
    w = v if w is None else w
    top = np.concatenate([m, v[..., :, None]], -1)
    bottom = np.concatenate([w[..., None, :], 0 * v[..., None, :1]], -1)
    return np.concatenate([top, bottom], -2)


def blocks(rows):
    """The matrix of blocks, given by rows."""
    return np.concatenate([np.concatenate(row, -1) for row in rows], -2)


def diagonal(b):
    """diag(b) for b (..., n)."""
    return b[..., None] * identity(b.shape[-1])


SU2_REAL = np.array([[[0, 0], [0, 0]], [[0, -1], [1, 0]], [[0, 0], [0, 0]]], dtype=np.int8)
SU2_IMAGINARY = np.array([[[0, -1], [-1, 0]], [[0, 0], [0, 0]], [[-1, 0], [0, 1]]], dtype=np.int8)


def su2(x):
    """Sum x_i sigma_i/(2i) for vectors x (..., 3): complex matrices (..., 2, 2), whose brackets are cross products."""
    half = x[..., None, None] / 2
    return together((half * SU2_REAL).sum(-3), (half * SU2_IMAGINARY).sum(-3))


def adjugate(X):
    """The adjugate of X (..., n, n): X adj(X) = det X, from its minors; for small n."""
    n, minors = X.shape[-1], {}

    def minor(rows, columns):
        if not rows:
            return 1
        if (rows, columns) not in minors:
            terms = [
                (-1) ** k * X[..., rows[0], c][()] * minor(rows[1:], columns[:k] + columns[k + 1 :])
                for k, c in enumerate(columns)
            ]
            minors[rows, columns] = sum(terms[1:], terms[0])
        return minors[rows, columns]

    every = [tuple(k for k in range(n) if k != i) for i in range(n)]
    rows = [np.stack([(-1) ** (i + j) * minor(every[j], every[i]) for j in range(n)], -1) for i in range(n)]
    return np.stack(rows, -2)
