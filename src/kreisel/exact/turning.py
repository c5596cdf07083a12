"""Turns by any vector as quaternions, without a branch and without 0/0, for any kind of number."""

from __future__ import annotations

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array

SQUARINGS = 5  # turns by 8 radians to rounding


def turn(v: Array, squarings: int = SQUARINGS) -> Array:
    """The unit quaternion (..., 4) of the turn about v (..., 3) by |v|, by squarings of that by v/2^squarings.

    To rounding up to |v| = 2^(squarings - 2); an error there grows like |v|^12.
    """
    y = algebra.dot(v, v) / 4 ** (squarings + 1)  # x^2, x half the angle of the turn that is squared
    versed = y * (0.5 - y * (1 / 24 - y * (1 / 720 - y * (1 / 40320 - y * (1 / 3628800)))))
    ratio = 1 - y * (1 / 6 - y * (1 / 120 - y * (1 / 5040 - y * (1 / 362880 - y * (1 / 39916800)))))  # sin x/x
    for _ in range(squarings):
        versed, ratio, y = 2 * y * ratio * ratio, ratio * (1 - versed), 4 * y
    return np.concatenate([algebra.vec(1 - versed) + 0 * v[..., :1], algebra.vec(ratio / 2) * v], -1)


def turned(q: Array, v: Array) -> Array:
    """q v q^-1 for vectors v (..., 3) and quaternions q (..., 4) of any length, so that no length is rounded before."""
    t = algebra.cross(algebra.vec(2 / algebra.dot(q, q)) * q[..., 1:], v)
    return v + q[..., :1] * t + algebra.cross(q[..., 1:], t)
