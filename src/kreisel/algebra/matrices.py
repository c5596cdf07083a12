"""Block matrices that several records share."""

import numpy as np

from kreisel.algebra import identity, together


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
