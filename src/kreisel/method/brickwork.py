"""method="brickwork": a lattice in discrete time.  A step is the two-site maps of all odd bonds, then of all even ones.

The map is Poisson and conserves the traces of the monodromy matrix in which its step stands.  Its order as a
discretization of the flow is 1.  [Krajnik, Prosen 2020; Krajnik, Ilievski, Prosen, Pasquier 2021]
"""

from __future__ import annotations

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.method.observing import observer
from kreisel.method.scheme import Scheme, Steps
from kreisel.record.calling import call
from kreisel.record.model import Model

State = tuple[Array, ...]


def brickwork(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """The map with step dt.  Raises `InputError` for steps at which it does not exist."""
    phi = model.map
    observe, outcomes = observer(model, dt, None)

    def prepare(x0: State) -> State:
        largest = model.largest_step(*x0)
        if dt >= largest:
            raise InputError(
                f"The map of {model.system.name} takes an angle t with tan t = dt |s| < 1 for an easy plane: "
                f"expected dt < {largest:.6g}, got {dt:g}. Use a smaller dt."
            )
        return x0

    return Scheme(
        name="brickwork",
        components=model.system.space.components,
        constants={**model.constants, "eps": dt},
        axes={**model.axes, "eps": 0},
        n=model.n,
        prepare=prepare,
        motion=Steps(lambda *z, **consts: tuple(call(phi.step, z, consts))),
        observe=observe,
        reopen=tuple,
        outcomes=outcomes,
        options={"order": order},
    )
