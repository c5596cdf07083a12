"""method="veselov": symmetric maps of order 2 that keep the integrals of the flow as they are, and compositions.

Maps of Veselov, of Moser and Veselov, and of Suris (2000).  They commute with the flow and with each other at other
steps, so that symmetric compositions of order 4, 6, 8 keep the same integrals.
"""

from __future__ import annotations

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.method.composition import COMPOSED, ORDERS, symmetric_composition
from kreisel.method.observing import observer, turned, turned_by_map, with_orientation
from kreisel.method.record import Method
from kreisel.method.scheme import Guard, Scheme, Steps
from kreisel.method.variational import DEFECT
from kreisel.record.contract import call, keywords
from kreisel.record.model import Model

LIMIT = 1e-13  # of the error of X

State = tuple[Array, ...]


def veselov(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The system's symmetric map with step dt, of order 2, or composed to order 4, 6 or 8.

    Of an implicit map the largest error that its solution has left, as estimated, an angle squared, is carried along as
    the component "defect" and guarded.  Raises `InputError` for steps at which the map does not exist.
    """
    phi, space = model.map, model.system.space
    gamma = symmetric_composition(order)
    observe, outcomes = observer(model, dt, None, oriented=oriented)
    count, implicit = len(space.letters), phi.turn is not None
    extra = ((DEFECT, "scalar"),) if implicit else ()

    def step(*z: Array, **consts: Array) -> State:
        own = z[:count]
        if implicit:
            X, defect = call(phi.turn, own, consts)
            along = (turned(model.system.frame, X, g) for g in z[count:-1])
            return (*call(phi.move, (*own, X), consts), *along, algebra.maximum(z[-1], defect))
        new = call(phi.step, own, consts)
        return (*new, *(turned_by_map(phi, model.system.frame, own, new, consts, g) for g in z[count:]))

    def reopen(x: State) -> State:
        return (*x, 0 * algebra.coordinates_of(space.kinds[0], x[0])[..., 0]) if implicit else x

    def trajectory(x0: State) -> tuple[dict[str, Array], dict[str, Array]]:
        with np.errstate(all="ignore"):  # beyond the domain, which `prepare` tells
            each = [model.call(phi.trajectory, *x0[:count], eps=eps) for eps in gamma * dt]
        return {}, {name: np.stack([known[name] for known in each], -1) for name in each[0]}

    def prepare(x0: State) -> State:
        _check_domain(model, x0[:count], dt * float(abs(gamma).max()), order)
        return reopen(x0)

    return Scheme(
        name="veselov",
        components=(*with_orientation(model, oriented), *extra),
        constants=dict(model.constants),
        axes={**model.axes, **dict.fromkeys(keywords(phi.turn or phi.step) - {*model.axes}, 0)},
        stages={"eps": gamma * dt},
        n=model.n,
        prepare=prepare,
        motion=Steps(step),
        observe=(lambda z, /, **constants: observe(z[:-1], **constants)) if implicit else observe,
        reopen=reopen,
        outcomes=outcomes,
        options={"order": order},
        trajectory=None if phi.trajectory is None else trajectory,
        guard=Guard(
            DEFECT,
            LIMIT**2,
            "The implicit equation of the map was not solved to round-off",
            "a step close to the largest at which the map exists. Use a smaller dt.",
        )
        if implicit
        else None,
    )


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


METHOD = Method(
    name="veselov",
    title="symmetric maps of Veselov, of Moser and Veselov, and of Suris (2000), and compositions of them",
    needs="a system with a symmetric map",
    applies=lambda model: model.system.map is not None and model.system.map.symmetric,
    orders=ORDERS,
    default=2,
    poisson="yes",
    conserves="all integrals of the flow",
    sources=("moser1991", "suris2000"),
    make=veselov,
    rank=2,
    composed=COMPOSED,
)
