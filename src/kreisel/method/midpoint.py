"""method="midpoint": the spherical midpoint method on products of spheres, and symmetric compositions of it.

For w_i' = X_i(w) with <X_i, w_i> = 0, spins or the momentum of a free body, r_i = |w_i|, the step is

    (w' - w)_i/dt = X_i(c),   c_i = r_i (w + w')_i/|w + w'|_i:

symmetric, of order 2, symplectic on the product of the spheres.  It conserves each |w_i| and linear integrals, and is
equivariant under rotations.  With Omega = c x X/r^2 it states that w rotates about Omega by 2 arctan(dt r |Omega|/|w +
w'|): so it is repeated until it has settled, and every iterate is on the spheres.  The orientation of a body rotates
by the Cayley transform of dt/2 Omega(c).

With w = s c - dt/2 X(c), w' = s c + dt/2 X(c) a quadratic form A on one sphere changes by 2 s dt <Ac, X(c)>: so the
energy of the Euler top, and with it every integral, is conserved.  [McLachlan, Modin, Verdier 2014]
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.invariants import Spins, cross, inner
from kreisel.algebra.iteration import repeat
from kreisel.errors import InputError
from kreisel.method.composition import DEFECT, composed
from kreisel.method.kahan import is_euler_top, linear_integrals
from kreisel.method.scheme import Guard, Scheme, State, observer, turned_by_velocity
from kreisel.record.calling import call
from kreisel.record.contract import PhaseSpace
from kreisel.record.model import Model

SMALL, LIMIT = 5e-16, 1e-12  # of the last change of a direction, rms over the sites
MOST = 100  # iterations; a step in which they do not settle is refused


def midpoint(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The step with dt, of order 2, or composed to order 4, 6 or 8.

    The largest square of the last change of a direction is carried along as the component "defect" and guarded.
    """
    conserved = ["casimir", *linear_integrals(model)]
    meanings = {"energy": f"Hamiltonian H, not conserved: it oscillates by O(dt^{order}), without a trend"}
    if is_euler_top(model):
        conserved, meanings = [*conserved, "energy"], {}
    watched = observer(model, oriented, conserved=conserved, meanings=meanings)

    def stage(old: State, turned: State, eps: Array, constants: Mapping[str, Array]) -> tuple[Any, Any, Any]:
        new, centre, defect = advance(model, old, eps, constants)
        return new, (turned_by_velocity(model, centre, g, eps, constants) for g in turned), [defect]

    guard = Guard(
        "The implicit equation of the midpoint step was not solved to round-off",
        "a step in which a spin rotates too far: dt times the field must be below about 1. Use a smaller dt.",
        DEFECT,
        LIMIT**2,
    )
    scheme = composed("midpoint", model, dt, order, oriented, stage, watched, guard, bound=False)

    def prepare(x: State) -> State:
        floats = isinstance(x[0], np.ndarray) and x[0].dtype != object
        w = _spins(model.system.space, x)[:3] if floats else ()
        if floats and not inner(w, w).all():
            vector, cause = "spin", "an empty site. Leave the site out, or use method='kahan' or 'dop853'"
            if not model.system.space.sites:
                vector, cause = "momentum", "a body at rest, which stays at rest. Use another method, such as 'dop853'"
            raise InputError(
                f"method='midpoint' divides by the length of each {vector}: expected none that is 0, got a {vector} 0. "
                f"Usual cause: {cause}."
            )
        return scheme.prepare(x)

    return replace(scheme, prepare=prepare)


def advance(model: Model, state: State, eps: Array, constants: Mapping[str, Array]) -> tuple[State, State, Array]:
    """The step of order 2: the new state, the point c, and the square of the last change of a direction."""
    space = model.system.space
    w = _spins(space, state)
    square = inner(w, w)
    inverse, sites = 1 / square, w[0].shape[-1]

    def improved(*new: Array) -> tuple[Spins, Array]:
        total = tuple(x + y for x, y in zip(w, new, strict=True))
        length = algebra.sqrt(square / inner(total, total))  # r/|w + w'|
        c = tuple(length * x for x in total)
        X = _spins(space, tuple(call(model.system.flow, _state(space, c), constants)))
        a = tuple(algebra.vec(eps) * length * inverse * x for x in cross(c, X))
        aw = cross(a, w)
        half = 2 / (1 + inner(a, a))
        result = tuple(x + half * (y + v) for x, y, v in zip(w, aw, cross(a, aw), strict=True))
        change = tuple(x - y for x, y in zip(result, new, strict=True))
        return result, (inverse * inner(change, change)).sum(-1) / sites

    new, defect = repeat(improved, w, SMALL**2, MOST, ("vector",) * 3)
    total = tuple(x + y for x, y in zip(w, new, strict=True))
    length = algebra.sqrt(square / inner(total, total))
    return _state(space, new), _state(space, tuple(length * x for x in total)), defect


def _spins(space: PhaseSpace, state: State) -> Spins:
    """x, y, z of the spins (..., n); of a free body, of its momentum (..., 1)."""
    if space.kinds != ("skew",):
        return state
    M = algebra.axial(state[0])
    return tuple(M[..., k : k + 1] for k in range(3))


def _state(space: PhaseSpace, spins: Spins) -> State:
    return spins if space.kinds != ("skew",) else (algebra.hat(np.concatenate(spins, -1)),)
