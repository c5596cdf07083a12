"""Block matrices that several records share."""

import numpy as np

from kreisel.algebra import identity


def border(m, v, w=None):
    """[[m, v], [w^T, 0]] of size n + 1; w = v if not given."""
    w = v if w is None else w
    top = np.concatenate([m, v[..., :, None]], -1)
    bottom = np.concatenate([w[..., None, :], 0 * v[..., None, :1]], -1)
    return np.concatenate([top, bottom], -2)


def diagonal(b):
    """diag(b) for b (..., n)."""
    return b[..., None] * identity(b.shape[-1])
