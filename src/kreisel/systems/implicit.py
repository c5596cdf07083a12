"""The implicit equation of Veselov's, Moser and Veselov's and Suris's (2000) maps, and where it can be solved.

    Q W J - J W^T Q = eps M,   W = cay(X) in SO(n),   X -> 0 as eps -> 0,   J = diag(J_i) > 0,   Q = (1 - eps^2 P)^(1/2)

The branch exists where det(J^2 + l eps M - l^2 Q^2) has no imaginary root l: there the symmetric part of W J, or of
Q W J, is positive and W has no eigenvalue -1, so that X is finite.  The roots are integrals of the maps.
[Moser, Veselov, Comm. Math. Phys. 139 (1991); Cardoso, Leite, Linear Algebra Appl. 360 (2003)]
"""

import numpy as np

from kreisel.algebra import coordinates, identity, pairing, repeat, skew, solve

NEWTON_STEPS = 5
MOST_SWEEPS = 300
SMALL = 1e-31  # the square of a correction of X that no longer matters
YS = 48


def root(residual, slope, inverse, X):
    """X with residual(X) = 0 and the square of its last correction: Newton's method for n = 3, else sweeps.

    slope(X) gives D -> d residual; inverse(R) is the inverse of the slope at X = 0, approximately.
    """
    n = X.shape[-1]
    if n > 3:
        return repeat(lambda X: _corrected(X, inverse(residual(X))), X, SMALL, MOST_SWEEPS)
    basis, defect = np.eye(3, dtype=np.int8), 0
    for _ in range(NEWTON_STEPS):
        along = slope(X)
        columns = np.stack([coordinates(along(skew(e, n) + 0 * X)) for e in basis], -1)
        X, defect = _corrected(X, skew(solve(columns, coordinates(residual(X))[..., None])[..., 0], n))
    return X, defect


def _corrected(X, change):
    return X - change, pairing(change, change)


def largest_step(M, J, P):
    """The eps beyond which some root is imaginary, that is, J^2 + y^2 + i eps y M - eps^2 y^2 P singular for some y.

    1/eps is the largest over y of the real eigenvalues u of the pencil u^2 + u B - C, where, with D = J^2 + y^2,
    B = i y D^(-1/2) M D^(-1/2) and C = y^2 D^(-1/2) P D^(-1/2).
    """
    M, J, P = (np.asarray(v, dtype=np.float64) for v in (M, J, P))
    d, n = J, J.shape[-1]
    lead = np.broadcast_shapes(M.shape[:-2], d.shape[:-1], P.shape[:-2])
    lowest, highest = np.log(d.min()), np.log(d.max())

    def inverse_step(s):  # s = log y, for every lane its own
        y = np.exp(s)[..., None]
        w = y / np.sqrt(d * d + y * y)
        both = w[..., :, None] * w[..., None, :]
        B, C = 1j * both * M / y[..., None], both * P
        one = np.broadcast_to(identity(n), B.shape)
        C = np.broadcast_to(C, B.shape)
        u = np.linalg.eigvals(np.concatenate([np.concatenate([0 * B, one], -1), np.concatenate([C, -B], -1)], -2))
        real = abs(u.imag) <= 1e-6 * (abs(u).max(-1, keepdims=True) + 1e-300)
        return np.where(real, u.real, 0).max(-1)

    grid = np.linspace(lowest - 1, highest + 7, YS)
    values = np.stack([inverse_step(np.full(lead, s)) for s in grid])
    best = values.argmax(0)
    left, right = grid[np.maximum(best - 1, 0)], grid[np.minimum(best + 1, YS - 1)]
    for _ in range(60):  # ternary search
        a, b = left + (right - left) / 3, right - (right - left) / 3
        higher = inverse_step(a) < inverse_step(b)
        left, right = np.where(higher, a, left), np.where(higher, right, b)
    far = np.sqrt(np.maximum(np.linalg.eigvalsh(P).max(-1), 0))
    with np.errstate(divide="ignore"):
        return 1 / np.maximum(np.maximum(inverse_step((left + right) / 2), values.max(0)), far)
