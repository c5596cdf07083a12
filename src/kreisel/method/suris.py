"""method="suris": the paper's maps, and their half-kick conjugates of order 2."""

from __future__ import annotations

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.method.exact import iterates
from kreisel.method.observing import observer, turned_by_map, with_orientation
from kreisel.method.scheme import Scheme, Steps
from kreisel.record.calling import call
from kreisel.record.model import Model


def suris(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The system's map phi with step eps = dt; with order = 2 chi phi chi^-1, chi half a kick.

    Both are Poisson and conserve the deformed integrals.  The conjugate runs phi and changes variables once
    at the start and at every saved state.  Raises `InputError` for steps at which the map may be singular.
    """
    phi = model.map
    eps = {"eps": dt}
    observe, outcomes = observer(
        model,
        dt,
        (lambda *z, **known: model.call(phi.to_symmetric, *z, **eps, **known)) if order == 2 else None,
        oriented=oriented,
    )
    components = with_orientation(model, oriented)
    letters = model.system.space.letters

    def reopen(x: tuple[Array, ...]) -> tuple[Array, ...]:
        own = x[: len(letters)]
        return (*(model.call(phi.from_symmetric, *own, **eps) if order == 2 else own), *x[len(letters) :])

    def prepare(x0: tuple[Array, ...]) -> tuple[Array, ...]:
        _check_domain(model, x0[: len(letters)], dt)
        return reopen(x0)

    def step(*z: Array, **consts: Array) -> tuple[Array, ...]:
        own = z[: len(letters)]
        new = call(phi.step, own, consts)
        return (*new, *(turned_by_map(phi, model.system.frame, own, new, consts, g) for g in z[len(letters) :]))

    return Scheme(
        name="suris",
        components=components,
        constants={**model.constants, **eps},
        axes={**model.axes, "eps": 0},
        n=model.n,
        prepare=prepare,
        motion=Steps(step, iterates=None if oriented else iterates(model)),
        observe=observe,
        reopen=reopen,
        outcomes=outcomes,
        options={"order": order},
    )


def _check_domain(model: Model, state: tuple[Array, ...], dt: float) -> None:
    if model.map.largest_step is None:
        return
    largest = model.largest_step(*state)
    if dt >= largest:
        shift = ", or add a constant to b so that no entry is negative (the flow stays as it is)"
        raise InputError(
            f"The map of {model.system.name} has a denominator that may vanish on this orbit: "
            f"expected dt < {largest:.6g}, got {dt:g}. Use a smaller dt{shift if 'b' in model.params else ''}."
        )
