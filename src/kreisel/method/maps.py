"""Methods that step the map phi of a system, as its record states it.

method="suris"       the paper's maps, and their half-kick conjugates of order 2
method="veselov"     symmetric maps of Veselov, of Moser and Veselov, and of Suris (2000), of order 2, and compositions:
                     they conserve the integrals of the flow, and commute with the flow and with each other at other
                     steps, so that symmetric compositions of order 4, 6, 8 conserve the same integrals
method="brickwork"   a lattice in discrete time: a step is the two-site maps of all odd bonds, then of all even ones;
                     Poisson, of order 1, and conserves the traces of the monodromy matrix in which its step is
                     [Krajnik, Prosen 2020; Krajnik, Ilievski, Prosen, Pasquier 2021]
method="map"         the map of a user-defined record, which need not be Poisson: a Runge-Kutta step, the midpoint rule
method="lagrangian"  the map of a user-defined discrete Lagrangian (`kreisel.reduction`)
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.method.composition import DEFECT, composed, symmetric_composition
from kreisel.method.scheme import (
    Guard,
    JaxSteps,
    Orbits,
    Points,
    Scheme,
    State,
    Steps,
    observer,
    scheme_of,
    turned,
    turned_by_map,
)
from kreisel.record.calling import Function, call, keywords
from kreisel.record.contract import Frame, Map, Orbit
from kreisel.record.model import Model

LIMIT = 1e-13  # of the error of X
SINGULAR = 1e-12


# Sentences on a step that is not below the largest at which a map is known to exist, by method.
SMALLER = "expected dt < {largest:.6g}, got {dt:g}. Use a smaller dt"
BEYOND = {
    "suris": f"has a denominator that may vanish on this orbit: {SMALLER}{{shift}}.",
    "brickwork": f"needs an angle t with tan t = dt |s| < 1 for an easy plane: {SMALLER}.",
    "map": f"is stated for shorter steps: {SMALLER}.",
    "veselov": "has no solution that tends to 1 with dt for this state: expected a step below {largest:.6g}, got "
    "{dt:.6g}{stages}. Use less than {share:.6g} of this dt, or method='dop853'.",
}
SHIFT = ", or add a constant to b so that no entry is negative (the flow does not change)"


def suris(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The system's map phi with step eps = dt; with order = 2 chi phi chi^-1, chi half a kick.

    Both are Poisson and conserve the deformed integrals.  The conjugate runs phi and changes variables once
    at the start and at every saved state.  Raises `InputError` for steps at which the map may be singular.
    """
    phi, count = model.map, len(model.system.space.letters)

    def to_user(*z: Array, **constants: Array) -> State:
        return model.call(phi.to_symmetric, *z, eps=dt, **constants)

    def reopen(x: State) -> State:
        return x if order == 1 else (*model.call(phi.from_symmetric, *x[:count], eps=dt), *x[count:])

    motion = Steps(_step(phi, model.system.frame, count), iterates=None if oriented else iterates(model))
    observed = observer(model, oriented, dt, to_user if order == 2 else None)
    return _stepped("suris", model, dt, order, oriented, motion=motion, observed=observed, reopen=reopen)


def brickwork(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The map of a lattice with step dt.  Raises `InputError` for steps at which it does not exist."""
    return _stepped("brickwork", model, dt, order, oriented)


def user_map(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The map of a record with step eps = dt.  Raises `InputError` for other orders than the map's."""
    name = model.system.name
    _require(
        model,
        order,
        oriented,
        f"The map of {name} states no generator, which the orientation needs. Leave the orientation out, or give the "
        "Map a generator.",
    )
    return _stepped("map", model, dt, model.map.order, oriented)


def has_a_plain_map(model: Model) -> bool:
    """Whether the map has no special method, unlike the map of a lattice."""
    return model.system.space.name != "(S^2)^(2n)"


def _require(model: Model, order: int | None, oriented: bool, no_generator: str) -> None:
    """Raises `InputError` for other orders than the map's, and for an orientation that it does not rotate."""
    if order not in (None, model.map.order):
        raise InputError(
            f"The map of {model.system.name} has order {model.map.order}, got order={shown(order)}. Leave it out."
        )
    if oriented and model.map.generator is None:
        raise InputError(no_generator)


def lagrangian(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The implicit map of a discrete Lagrangian with step eps = dt; the orientation is carried along.

    Poisson, so that Casimirs are conserved; of the integrals, those that the record names.  Raises `InputError` for
    other orders than the map's, and for an orientation of a group that is not SO(n).
    """
    phi, space = model.map, model.system.space
    _require(
        model,
        order,
        oriented,
        f"The orientation is carried along for SO(n) on R^n; {model.system.name} lives on {space.name}. "
        "Leave it out, and use kreisel.reduction's Discrete.reconstruct.",
    )
    count = len(space.letters)
    singular = Guard(
        "The Legendre transform of the discrete Lagrangian is singular at this state",
        "a kinetic energy that vanishes or changes its sign there.",
    )
    lost = Guard(
        "The implicit equation has no solution on the branch with the continuous limit: two solutions have met, or "
        "Newton's method failed on the way",
        f"a step too long for this state. Use dt = {dt / 2:g} or less.",
        instead=lambda z, constants: singular if float(call(phi.regularity, z[:count], constants)) < SINGULAR else None,
    )
    motion = JaxSteps(_step(phi, model.system.frame, count))
    return _stepped("lagrangian", model, dt, phi.order, oriented, motion=motion, recordable=False, guard=lost)


def veselov(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The system's symmetric map with step dt, of order 2, or composed to order 4, 6 or 8.

    The error that the solution of an implicit map has left, as estimated, an angle squared, is guarded: its largest
    value is carried along as the component "defect".  Raises `InputError` for steps at which the map does not exist.
    """
    phi = model.map
    gamma = symmetric_composition(order)
    count, frame = len(model.system.space.letters), model.system.frame
    longest, constant = dt * float(abs(gamma).max()), phi.trajectory is not None and model.n == 3

    def stage(state: State, gs: State, eps: Array, constants: Mapping[str, Array]) -> tuple[Any, Any, Any]:
        constants = {**constants, "eps": eps}
        if phi.turn is not None:
            X, defect = call(phi.turn, state, constants)
            return call(phi.move, (*state, X), constants), (turned(frame, X, g) for g in gs), [defect]
        new = call(phi.step, state, constants)
        return new, (turned_by_map(phi, frame, state, new, constants, g) for g in gs), ()

    def point(*z: Array, mu: Array, **constants: Array) -> Array:
        return call(phi.trajectory, z[:count], {**constants, "eps": mu})

    def trajectory(x0: State, points: Points | None = None) -> tuple[dict[str, Array], dict[str, Array]]:
        sigma = None if points is None else points(x0, gamma * dt)
        with np.errstate(all="ignore"):  # `prepare` refuses states outside the domain
            if sigma is None:
                sigma = np.stack([point(*x0, mu=eps, **model.constants) for eps in gamma * dt], -1)
        return {}, {"sigma": sigma}

    def prepare(x0: State) -> State:
        stages = "" if order == 2 else f" in its longest stage (order {order})"
        return scheme.reopen(_below("veselov", model, x0, longest, stages=stages, enough=longest))

    guard = Guard(
        "The implicit equation of the map was not solved to round-off",
        "a step close to the largest at which the map exists. Use a smaller dt.",
        DEFECT,
        LIMIT**2,
    )
    scheme = composed(
        "veselov",
        model,
        dt,
        order,
        oriented,
        stage,
        observer(model, oriented, dt),
        None if phi.turn is None else guard,
        axes={**model.axes, **dict.fromkeys(keywords(phi.turn or phi.step) - {*model.axes}, 0)},
        prepare=prepare,
        trajectory=trajectory if constant else None,
        point=point if constant else None,
        wide=False,
    )
    return scheme


def iterates(model: Model) -> Orbits | None:
    """The iterates of a map that is D_eps in other variables, n = 3, in closed form; None if that is not known."""
    if model.n != 3 or model.map.darboux is None:
        return None

    def orbit(z0: State, constants: Mapping[str, Array], reach: float) -> Orbit:
        from kreisel.method.exact import iterated

        return iterated(model, tuple(z0), constants, reach)

    return Orbits(orbit)


def _stepped(name: str, model: Model, dt: float, order: int, oriented: bool, **fields: Any) -> Scheme:
    """The scheme of the map of a record with step eps = dt; `fields`: those that differ."""
    count, reopen = len(model.system.space.letters), fields.get("reopen", tuple)

    def prepare(x0: State) -> State:
        return reopen(_below(name, model, x0, dt))

    usual: dict[str, Any] = {
        "motion": Steps(_step(model.map, model.system.frame, count)),
        "observed": observer(model, oriented, dt),
        "constants": {**model.constants, "eps": dt},
        "axes": {**model.axes, "eps": 0},
        "prepare": prepare,
        "options": {"order": order},
    }
    return scheme_of(name, model, oriented=oriented, **(usual | fields))


@lru_cache(64)
def _step(phi: Map, frame: Frame, count: int) -> Function:
    """The step of state and orientation; the same function for the same record, so that JAX compiles it once."""

    def step(*z: Array, **constants: Array) -> State:
        new = call(phi.step, z[:count], constants)
        _require_components(new, z[:count])
        return (*new, *(turned_by_map(phi, frame, z[:count], new, constants, g) for g in z[count:]))

    return step


def _require_components(new: Any, state: State) -> None:
    """Raises `InputError` for anything but a sequence of components like the state's; lanes may be in front."""
    wanted = [np.shape(x) for x in state]
    got = [np.shape(x) for x in new] if isinstance(new, tuple | list) else new
    if not isinstance(got, list) or [y[-len(x) :] if x else () for x, y in zip(wanted, got, strict=False)] != wanted:
        raise InputError(f"step: expected components of the shapes {wanted}, got {shown(got)}.")
    if len(got) > len(wanted):
        raise InputError(f"step: expected {len(wanted)} components, got {len(got)}.")


def _below(name: str, model: Model, x0: State, step: float, stages: str = "", **options: float) -> State:
    """The state and orientations, if a step is below the largest at which the map is known to exist there.

    Raises `InputError` where it is not; a recorded state is NaN where that is not certain.
    """
    if model.map.largest_step is None:
        return x0
    state = x0[: len(model.system.space.letters)]
    if algebra.holds_objects(x0[0]):
        with np.errstate(all="ignore"):
            largest = model.call(model.map.largest_step, *state, **options)
        return (x0[0] * algebra.where_less(step, largest, 1.0, np.nan), *x0[1:])
    largest = model.largest_step(*state, **options)
    if not step < largest:
        words = {"largest": largest, "share": largest / step, "dt": step, "stages": stages}
        sentence = BEYOND[name].format(**words, shift=SHIFT if "b" in model.params else "")
        raise InputError(f"The map of {model.system.name} {sentence}")
    return x0
