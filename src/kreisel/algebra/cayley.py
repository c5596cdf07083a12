"""The Cayley transform, by its action on vectors and matrices."""

from __future__ import annotations

import numpy as np

from kreisel.algebra.backend import Array, identity, mat, solve, vec
from kreisel.algebra.skew import SECOND, THIRD, act, axial, cross, dot, hat, wedge


def resolvent(X: Array, V: Array) -> Array:
    """(I - X)^-1 V for X (..., n, n) skew and columns V; for n = 3 (I + X + u u^T) V/(1 + |u|^2), X = hat(u)."""
    unit = identity(X.shape[-1])
    if X.shape[-1] != 3:
        return solve(unit - X, V)
    u = axial(X)
    return ((unit + X) @ V + u[..., :, None] * act(V.mT, u)[..., None, :]) * (1 / mat(1 + dot(u, u)))


def shifted_resolvent(mu: Array, X: Array, v: Array) -> Array:
    """(mu - X)^-1 v for X (..., n, n) skew, v (..., n) and a scalar mu with Re mu != 0; any of them complex."""
    if X.shape[-1] != 3:
        A = X.record_shifted(mu) if hasattr(X, "record_shifted") else mat(mu) * identity(X.shape[-1]) - X
        return solve(A, v[..., None])[..., 0]
    u, square = axial(X), mu * mu
    scale = 1 / (mu * (square + dot(u, u)))
    return vec(scale) * (vec(square) * v + vec(mu) * act(X, v) + u * vec(dot(u, v)))


def diagonal_resolvent(d: Array, X: Array, v: Array) -> Array:
    """(diag(d) + X)^-1 v for X (..., n, n) skew, d and v (..., n) with Re d > 0; any of them complex."""
    if X.shape[-1] != 3:
        return solve(d[..., None] * identity(X.shape[-1]) + X, v[..., None])[..., 0]
    u, (i, j, k) = axial(X), (d[..., 0], d[..., 1], d[..., 2])
    minors = np.stack([j * k, k * i, i * j], -1)
    scale = 1 / (i * minors[..., 0] + dot(u, d * u))
    return vec(scale) * (minors * v + u * vec(dot(u, v)) - cross(d * u, v))


def cayley_columns(X: Array, V: Array) -> Array:
    """cay(X) V = V + (I - X)^-1 2 X V for columns V (..., n, k); n = 3: V + 2 (I + X) X V/(1 + |u|^2), X = hat(u)."""
    W = X @ V
    if X.shape[-1] != 3:
        return V + resolvent(X, 2 * W)
    u = axial(X)[..., :, None]
    W = W + u[..., SECOND, :] * W[..., THIRD, :] - u[..., THIRD, :] * W[..., SECOND, :]  # (I + X) W
    return V + W * (2 / (1 + (u * u).sum(-2)[..., None]))


def cayley_act(X: Array, v: Array) -> Array:
    """cay(X) v = (I - X)^-1 (I + X) v for X (..., n, n) skew and v (..., n): never singular for real X."""
    return cayley_columns(X, v[..., None])[..., 0]


def cayley(X: Array) -> Array:
    """cay(X) = (I + X)(I - X)^-1, orthogonal for skew X (..., n, n); cay(-X) is its inverse."""
    return cayley_columns(X, identity(X.shape[-1]) + 0 * X)


def cayley_conjugate(X: Array, M: Array, axis: Array | None = None) -> Array:
    """cay(X) M cay(X)^-1 for skew X and M (..., n, n); for n = 3 the rotated axial vector.

    `axis`: a vector with X axis = 0, if X commutes with the part of M that does not act on it.  Then only M axis is
    rotated: that part is constant, and its rounding errors would be equal in every step.
    """
    if hasattr(M, "record_conjugate"):
        return M.record_conjugate(X)
    if X.shape[-1] == 3:
        return hat(cayley_act(X, axial(M)))
    if axis is not None:
        y = act(M, axis)
        return M + wedge((cayley_act(X, y) - y) / vec(dot(axis, axis)), axis)
    return cayley_columns(X, cayley_columns(X, M).mT).mT


def cayley_plane(x: Array, y: Array, v: Array) -> Array:
    """cay(x ^ y) v in O(n), for vectors (..., n)."""
    X, Y, c, xv, yv = dot(x, x), dot(y, y), dot(x, y), dot(x, v), dot(y, v)
    scale = 2 / (1 + X * Y - c * c)
    return v + x * vec(((1 + c) * yv - Y * xv) * scale) - y * vec(((1 - c) * xv + X * yv) * scale)


def moebius(X: Array) -> Array:
    """(I + X)(I - X)^-1 for any matrix X (..., n, n); for skew X use `cayley`."""
    return solve(identity(X.shape[-1]) - X, identity(X.shape[-1]) + X)
