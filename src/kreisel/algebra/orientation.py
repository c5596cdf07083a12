"""Orientations: matrices in SO(n), or for n = 3 unit quaternions (w, x, y, z)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from kreisel.algebra.backend import Array, identity, joined, mat, sqrt, vec
from kreisel.algebra.cayley import cayley_columns
from kreisel.algebra.skew import act, axial, cross, dot, hat


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
