"""method="lagrangian": the map of a user's own discrete Lagrangian (`kreisel.reduction`)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.method.observing import observer, turned_by_map, with_orientation
from kreisel.method.scheme import JaxSteps, Scheme
from kreisel.record.calling import Function, call
from kreisel.record.contract import Frame, Map
from kreisel.record.model import Model

SINGULAR = 1e-12


def lagrangian(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The implicit map of a discrete Lagrangian with step eps = dt; the orientation is carried along.

    Poisson, so that Casimirs are conserved; of the integrals, those that the record names.  Raises `InputError` for
    other orders than the map's own, and for an orientation of a group that is not SO(n).
    """
    phi, space = model.map, model.system.space
    if order not in (None, phi.order):
        raise InputError(
            f"The map of {model.system.name} has order {phi.order}, got order={shown(order)}. Leave it out."
        )
    if oriented and phi.generator is None:
        raise InputError(
            f"The orientation is carried along for SO(n) on R^n; {model.system.name} lives on {space.name}. "
            "Leave it out, and use kreisel.reduction's Discrete.reconstruct."
        )
    observe, outcomes = observer(model, dt, None, oriented=oriented)
    count = len(space.letters)

    def explain(z: tuple[Array, ...], consts: Mapping[str, Array]) -> str:
        if float(call(phi.regularity, z[:count], consts)) < SINGULAR:
            return (
                "The Legendre transform of the discrete Lagrangian is singular at this state. "
                "Usual cause: a kinetic energy that vanishes or changes its sign there."
            )
        return (
            "The implicit equation has no solution on the branch with the continuous limit: two solutions have met, or "
            f"Newton's method failed on the way. Usual cause: a step too long for this state. Use dt = {dt / 2:g} or "
            "less."
        )

    return Scheme(
        name="lagrangian",
        components=with_orientation(model, oriented),
        constants={**model.constants, "eps": dt},
        axes={**model.axes, "eps": 0},
        n=model.n,
        prepare=tuple,
        motion=JaxSteps(_stepper(phi, model.system.frame, count), explain),
        observe=observe,
        reopen=tuple,
        outcomes=outcomes,
        options={"order": phi.order},
        recordable=False,
    )


@lru_cache(64)
def _stepper(phi: Map, frame: Frame, count: int) -> Function:
    """The step of state and orientation; the same function for the same record, so that it is compiled once."""

    def both(*z: Array, **consts: Array) -> tuple[Array, ...]:
        own = z[:count]
        new = call(phi.step, own, consts)
        return (*new, *(turned_by_map(phi, frame, own, new, consts, g) for g in z[count:]))

    return both
