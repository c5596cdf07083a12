"""method="veselov": symmetric maps of order 2 that conserve the integrals of the flow as they are, and compositions.

Maps of Veselov, of Moser and Veselov, and of Suris (2000).  They commute with the flow and with each other at other
steps, so that symmetric compositions of order 4, 6, 8 conserve the same integrals.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.method.composition import DEFECT, composed, symmetric_composition
from kreisel.method.observing import observer, turned, turned_by_map
from kreisel.method.scheme import Guard, Scheme
from kreisel.record.calling import call, keywords
from kreisel.record.model import Model

LIMIT = 1e-13  # of the error of X

State = tuple[Array, ...]


def veselov(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The system's symmetric map with step dt, of order 2, or composed to order 4, 6 or 8.

    Of an implicit map the largest error that its solution has left, as estimated, an angle squared, is carried along as
    the component "defect" and guarded.  Raises `InputError` for steps at which the map does not exist.
    """
    phi = model.map
    gamma = symmetric_composition(order)
    count, frame = len(model.system.space.letters), model.system.frame

    def stage(own: State, gs: State, eps: Array, consts: Mapping[str, Array]) -> tuple[Any, Any, Any]:
        known = {**consts, "eps": eps}
        if phi.turn is not None:
            X, defect = call(phi.turn, own, known)
            return call(phi.move, (*own, X), known), (turned(frame, X, g) for g in gs), [defect]
        new = call(phi.step, own, known)
        return new, (turned_by_map(phi, frame, own, new, known, g) for g in gs), ()

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        with np.errstate(all="ignore"):  # beyond the domain, which `prepare` tells
            each = [model.call(phi.trajectory, *x0[:count], eps=eps) for eps in gamma * dt]
        return {}, {name: np.stack([known[name] for known in each], -1) for name in each[0]}

    def prepare(x0: State) -> State:
        _check_domain(model, x0[:count], dt * float(abs(gamma).max()), order)
        return scheme.reopen(x0)

    guard = Guard(
        DEFECT,
        LIMIT**2,
        "The implicit equation of the map was not solved to round-off",
        "a step close to the largest at which the map exists. Use a smaller dt.",
    )
    scheme = composed(
        "veselov",
        model,
        dt,
        order,
        oriented,
        stage,
        observer(model, dt, None, oriented=oriented),
        None if phi.turn is None else guard,
        axes={**model.axes, **dict.fromkeys(keywords(phi.turn or phi.step) - {*model.axes}, 0)},
        prepare=prepare,
        trajectory=None if phi.trajectory is None else trajectory,
    )
    return scheme


def _check_domain(model: Model, state: State, longest: float, order: int) -> None:
    """Raises `InputError` where a stage is longer than the map allows for one of the states."""
    if model.map.largest_step is None:
        return
    largest = model.largest_step(*state, enough=longest)
    if not longest < largest:
        stages = "" if order == 2 else f" in its longest stage (order {order})"
        raise InputError(
            f"The map of {model.system.name} has no solution that tends to 1 with dt for this state: expected a step "
            f"below {largest:.6g}, got {longest:.6g}{stages}. Use less than {largest / longest:.6g} of this dt, or "
            "method='dop853'."
        )
