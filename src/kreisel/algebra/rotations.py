"""Vectors, so(n) and SO(n): skew matrices, Cayley transforms by their action, orientations.

An orientation is a matrix in SO(n), or for n = 3 a unit quaternion (w, x, y, z).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from kreisel.algebra.backend import Array, identity, joined, mat, solve, sqrt, vec

SECOND, THIRD = np.array([1, 2, 0]), np.array([2, 0, 1])  # the axes after the first, second and third of space


def dot(x: Array, y: Array) -> Array:
    """<x, y> on R^n."""
    return (x * y).sum(-1)


def pairing(X: Array, Y: Array) -> Array:
    """<X, Y> = -tr(XY)/2 on so(n): the sum over i < j of X_ij Y_ij."""
    if hasattr(X, "record_pairing"):
        return X.record_pairing(Y)
    # one axis after the other: the order of the sum must not depend on the batch
    return (X * Y).sum(-1).sum(-1) / 2


def wedge(x: Array, y: Array) -> Array:
    """The wedge product x ^ y = x y^T - y x^T; then (x ^ y) v = x <y, v> - y <x, v>."""
    if hasattr(x, "record_wedge"):
        return x.record_wedge(y)
    return x[..., :, None] * y[..., None, :] - y[..., :, None] * x[..., None, :]


def act(X: Array, v: Array) -> Array:
    """The product X v for a batch of matrices and vectors."""
    return (X @ v[..., None])[..., 0]


def bracket(X: Array, Y: Array) -> Array:
    """[X, Y] = XY - YX."""
    return X @ Y - Y @ X


def project_out(m: Array, p: Array) -> Array:
    """|p|^2 pi m pi with pi = I - p p^T / |p|^2: the part of m that does not act on p; hat(p <p, m>) for n = 3."""
    if hasattr(m, "record_project_out"):
        return m.record_project_out(p)
    if m.shape[-1] == 3:
        return hat(p * vec(dot(p, axial(m))))
    return mat(dot(p, p)) * m - wedge(act(m, p), p)


@cache
def triangle(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the independent components of so(n), i < j, row by row."""
    return np.triu_indices(n, 1)


@cache
def _unfolding(n: int) -> np.ndarray:
    count = n * (n - 1) // 2
    place = np.full((n, n), 2 * count)
    place[triangle(n)] = np.arange(count)
    place.T[triangle(n)] = np.arange(count) + count
    return place


def coordinates(X: Array) -> Array:
    """The n(n-1)/2 independent components X_ij, i < j, of a skew matrix."""
    rows, columns = triangle(X.shape[-1])
    return X[..., rows, columns]


def skew(x: Array, n: int) -> Array:
    """The skew matrix (..., n, n) with the given independent components (..., n(n-1)/2)."""
    concatenate = np.concatenate if isinstance(x, np.ndarray) else x.__array_namespace__().concatenate
    return concatenate([x, -x, 0 * x[..., :1]], -1)[..., _unfolding(n)]


@cache
def triangle_with_diagonal(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the independent components of a symmetric matrix, i <= j, row by row."""
    return np.triu_indices(n)


@cache
def _symmetric_unfolding(n: int) -> np.ndarray:
    place = np.zeros((n, n), dtype=int)
    place[triangle_with_diagonal(n)] = np.arange(n * (n + 1) // 2)
    return np.maximum(place, place.T)


def symmetric(x: Array, n: int) -> Array:
    """The symmetric matrix (..., n, n) with the given components (..., n(n+1)/2), i <= j."""
    return x[..., _symmetric_unfolding(n)]


# Entries of the skew matrix of an axial vector and of the axial vector of a skew matrix, with their signs: a single
# product of NumPy's doubles, which has the bits of the definitions; the zeros of the diagonal have a sign too.
_OF_AXIAL = np.array([[2, 2, 1], [2, 2, 0], [1, 0, 2]])
_SIGNS_OF_AXIAL = np.array([[-0.0, -1.0, 1.0], [1.0, -0.0, -1.0], [-1.0, 1.0, -0.0]])
_REVERSED, _SIGNS = np.array([2, 1, 0]), np.array([-1, 1, -1], dtype=np.int8)
_ROWS, _COLUMNS = np.array([1, 0, 0]), np.array([2, 2, 1])


def reversed_axial(x: Array) -> Array:
    """The coordinates of a skew 3 x 3 matrix from its axial vector, and the reverse: both reverse the order."""
    return x[..., _REVERSED] * _SIGNS


def hat(v: Array) -> Array:
    """The skew matrix X of an axial vector v, X x = v x x (cross product), n = 3.  Inverse: `axial`."""
    if type(v) is np.ndarray and v.dtype == np.float64:
        return v[..., _OF_AXIAL] * _SIGNS_OF_AXIAL
    return skew(reversed_axial(v), 3)


def axial(X: Array) -> Array:
    """The axial vector of a skew 3 x 3 matrix.  Inverse: `hat`."""
    return X[..., _ROWS, _COLUMNS] * _SIGNS


def cross(x: Array, y: Array) -> Array:
    """The cross product x x y, n = 3."""
    return act(hat(x), y)


def pfaffians(X: Array, *vectors: Array) -> dict[tuple[int, ...], tuple[Any, ...]]:
    """Pfaffians of principal parts of skew X (..., n, n) by their indices, of odd parts with a border v (..., n) each.

    det(diag(d) + X) is the sum of Pf^2 prod d_i, i not in the part, over even parts, and v^T adj(diag(d) + X) w the sum
    of Pf_v Pf_w prod d_i over odd ones, up to terms that are odd in X.  No terms cancel for v = w, d > 0.
    """
    out: dict[tuple[int, ...], tuple[Any, ...]] = {(): (1,)}
    for count in range(1, X.shape[-1] + 1):
        for indices in combinations(range(X.shape[-1]), count):
            columns, members = (vectors, indices) if count % 2 else ((X[..., indices[-1]],), indices[:-1])
            minors = [out[tuple(k for k in members if k != i)][0] for i in members]
            terms = [[(-1) ** j * y[..., i][()] * minors[j] for j, i in enumerate(members)] for y in columns]
            out[indices] = tuple(sum(term[1:], term[0]) for term in terms)
    return out


# -- Cayley transforms, by linear systems ----------------------------------------------------------


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


# -- orientations ----------------------------------------------------------------------------------


def turn_left(X: Array, g: Array) -> Array:
    """cay(X) g, for an orthogonal matrix g (..., n, n) or a unit quaternion g (..., 4) when n = 3."""
    return cayley_columns(X, g) if _is_matrix(X, g) else unit(quaternion_product(_half_turn(X), g))


def turn_right(g: Array, X: Array) -> Array:
    """The rotation g cay(X), for an orthogonal matrix g (..., n, n) or a unit quaternion g (..., 4) when n = 3."""
    return cayley_columns(-X, g.mT).mT if _is_matrix(X, g) else unit(quaternion_product(g, _half_turn(X)))


def _is_matrix(X: Array, g: Array) -> bool:
    return g.ndim >= 2 and g.shape[-2:] == X.shape[-2:]


def _half_turn(X: Array) -> Array:
    """(1, u): cay(hat(u)) is the rotation of the unnormalised quaternion 1 + u."""
    u = axial(X)
    return joined(1 + 0 * u[..., :1], u)


def quaternion(scalar: Array, vector: Array) -> Array:
    """The quaternion (..., 4) of a scalar (...) and a vector (..., 3)."""
    return joined(vec(scalar) + 0 * vector[..., :1], vector)


def quaternion_product(a: Array, b: Array) -> Array:
    """The product of quaternions (..., 4) = (w, x, y, z): the rotation b first, then a."""
    s, u, t, v = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return joined(s * t - vec(dot(u, v)), s * v + t * u + act(hat(u), v))


def inverse_turn(q: Array) -> Array:
    """The inverse (w, -x, -y, -z) of a unit quaternion (..., 4)."""
    return joined(q[..., :1], -q[..., 1:])


def unit(q: Array) -> Array:
    """q/|q| for vectors or quaternions q (..., k)."""
    return q / sqrt(vec(dot(q, q)))


SQUARINGS, TERMS = 2, 9  # rotations by 8 radians to rounding


def polynomial(c: Sequence[Any], x: Array) -> Any:
    """c_0 + c_1 x + c_2 x^2 + ..., in halves (Estrin's rule): processors need not wait."""
    while len(c) > 1:
        c, x = [c[k] + c[k + 1] * x if k + 1 < len(c) else c[k] for k in range(0, len(c), 2)], x * x
    return c[0]


def turn(v: Array, squarings: int = SQUARINGS, terms: int = TERMS) -> Array:
    """The unit quaternion (..., 4) of the rotation about v (..., 3) by |v|, by squarings of that for v/2^squarings.

    For any kind of number, without a branch and without 0/0; to rounding up to |v| = 2^(squarings + 1) with 9 terms, of
    2^(squarings - 2) with 5.
    """
    cos, ratio = half_turn(0.25 * dot(v, v), squarings, terms)
    return quaternion(cos, vec(0.5 * ratio) * v)


def half_turn(square: Array, squarings: int = SQUARINGS, terms: int = TERMS) -> tuple[Array, Array]:
    """cos x and sin x/x from x^2, x half the angle of a rotation, as in `turn`."""
    y = square * 0.25**squarings
    versed = y * polynomial([2 * (-1) ** k / math.factorial(2 * k + 2) for k in range(terms)], y)  # 2 - 2 cos x
    ratio = polynomial([(-1) ** k / math.factorial(2 * k + 1) for k in range(terms + 1)], y)  # sin x/x
    for _ in range(squarings):
        versed, ratio = versed * (4 - versed), ratio * (2 - versed)
    return 1 - 0.5 * versed, ratio * 0.5**squarings


def conjugated(q: Array, v: Array) -> Array:
    """q v q^-1 for vectors v (..., 3) and quaternions q (..., 4) of any length, so no length is rounded before."""
    t = cross(vec(2 / dot(q, q)) * q[..., 1:], v)
    return v + q[..., :1] * t + cross(q[..., 1:], t)


def continued(q: Array, times: Array | None = None) -> Array:
    """Unit quaternions (rows, ..., 4), each with the sign that is nearer to the row before.

    `times` (rows,): in their order.
    """
    if times is not None:
        order = np.argsort(times, kind="stable")
        return continued(q[order])[np.argsort(order, kind="stable")]
    flips = np.where(dot(q[1:], q[:-1]) < 0, -1.0, 1.0)
    signs = np.concatenate([np.ones_like(q[:1, ..., 0]), np.cumprod(flips, axis=0)])
    return np.asarray(q * signs[..., None])


def double_turn(x: Array, y: Array, g: Array, right: bool = False) -> Array:
    """R_y R_x g, or g (R_y R_x)^T with `right`, R_x the half-turn about x: rotation from x to y by twice their angle.

    g is an orthogonal matrix (..., n, n) or a unit quaternion (..., 4) when n = 3.
    """
    if g.ndim == x.ndim + 1:
        h = g.mT if right else g
        for axis in (x, y):
            h = axis[..., :, None] * (2 / mat(dot(axis, axis)) * act(h.mT, axis)[..., None, :]) - h
        return h.mT if right else h
    turn = quaternion(dot(x, y), cross(x, y))
    return unit(quaternion_product(g, inverse_turn(turn)) if right else quaternion_product(turn, g))


def rotation_matrix(q: Array) -> Array:
    """The matrix (..., 3, 3) of a unit quaternion (..., 4) = (w, x, y, z)."""
    H = hat(q[..., 1:])
    return identity(3) + 2 * (mat(q[..., 0]) * H + H @ H)


def unit_quaternion(g: Array) -> Array:
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation matrix (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(np.reshape(g, (-1, 3, 3))).as_quat(canonical=True, scalar_first=True)
    return flat.reshape((*np.shape(g)[:-2], 4))
