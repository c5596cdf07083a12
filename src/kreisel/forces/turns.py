"""Flows of the parts of H that are quadratic in the momenta, n = 3, moving frame: rotations about fixed body axes.

inertia     (1/I_i - 1/I_i of the integrable motion) M_i^2/2: a rotation about e_i
coupling    M.KP, K symmetric: the sum of k (v.M)(v.P) over v = e_i and e_i + e_j.  For each, v.M and v.P are constant;
            with w = k (v.P) v and u = k (v.M) v the body rotates by R = exp(h hat(w)), and

                P(h) = R^T P,   M(h) = R^T (M + h P x u)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import cos, sin
from kreisel.forces.kicks import COUPLING, INERTIA, Constants, inverse_moments, perturbation_of
from kreisel.record.contract import System
from kreisel.record.model import Model

SAME = 4e-16  # relative: inverse moments that differ by rounding
PAIRS = ((0, 1), (1, 2), (2, 0))

State = tuple[Array, ...]
Turn = Callable[[State, State, Any, Constants], tuple[State, State]]


def turns_of(model: Model, with_zeros: bool = False) -> list[Turn]:
    """The rotations of a perturbed body: (state, orientation, h, constants), if they have an effect in some lane.

    With `with_zeros` all are returned, since parameters may change.
    """
    system, record = model.system, perturbation_of(model.system)
    out: list[Turn] = []
    if record.inertia:
        change = abs(inverse_moments(system, model.constants)).reshape(-1, 3).max(0)
        axes = np.flatnonzero(with_zeros | (change > SAME * (1 / model.constants[INERTIA]).max())).tolist()
        out += [about_axis(system, axis) for axis in axes]
    if record.coupling:
        result = [np.asarray(weight(model.constants[COUPLING], term)) for term in range(6)]
        out += [along_coupling(system, term) for term in range(6) if with_zeros or result[term].any()]
    return out


def about_axis(system: System, axis: int) -> Turn:
    """The change of one principal moment."""

    def turn(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        rate = inverse_moments(system, constants)[..., axis] * algebra.axial(state[0])[..., axis]
        return turned(system, state, g, rate * h, np.eye(3)[axis])

    return turn


def along_coupling(system: System, term: int) -> Turn:
    """One k (v.M)(v.P)."""
    v, length = direction(term), float(np.linalg.norm(direction(term)))

    def turn(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        M, P, *remainder = state
        k, m = weight(constants[COUPLING], term), algebra.axial(M)
        u = algebra.vec(h * k * algebra.dot(m, v + 0 * m)) * (v + 0 * m)
        state = (M + algebra.hat(algebra.cross(P, u)), P, *remainder)
        return turned(system, state, g, h * k * algebra.dot(P, v + 0 * P) * length, v / length)

    return turn


def direction(term: int) -> Array:
    """e_1, e_2, e_3, e_1 + e_2, e_2 + e_3, e_3 + e_1."""
    unit = np.eye(3)
    return unit[term] if term < 3 else unit[PAIRS[term - 3][0]] + unit[PAIRS[term - 3][1]]


def weight(K: Array, term: int) -> Array:
    """k of that direction v: K is the sum of k v v^T."""
    if term < 3:
        return 2 * K[..., term, term] - K[..., term, 0] - K[..., term, 1] - K[..., term, 2]
    i, j = PAIRS[term - 3]
    return K[..., i, j]


def turned(system: System, state: State, g: State, angle: Any, axis: Array) -> tuple[State, State]:
    """The state and the unit quaternion g after a rotation of the body by that angle about a unit vector."""
    s, c = sin(angle / 2), cos(angle / 2)
    q = algebra.vec(c) * algebra.identity(4)[0] + algebra.vec(s) * np.append(0.0, axis)
    W = algebra.rotation_matrix(q)
    new = tuple(algebra.KINDS[kind].rotated(W.mT, z) for kind, z in zip(system.space.kinds, state, strict=True))
    return new, tuple(algebra.quaternion_product(x, q) for x in g)
