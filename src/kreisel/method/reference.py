"""method="dop853": SciPy's Runge-Kutta method of order 8, the reference that preserves nothing."""

from __future__ import annotations

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.method.observing import ORIENTATION, observer, orientation_outcome
from kreisel.method.record import Method
from kreisel.method.scheme import Scheme
from kreisel.record.contract import Frame, call
from kreisel.record.model import Model

RTOL, ATOL = 1e-9, 1e-12


def dop853(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The flow, integrated by SciPy's adaptive DOP853 with rtol 1e-9 and atol 1e-12, reported every dt.

    The orientation is carried as a matrix: g' = omega g in the rest frame, g' = g Omega in the moving frame.
    """
    observe, outcomes = observer(model, None, None)
    space = model.system.space
    count = len(space.letters)

    def prepare(x0: tuple[Array, ...]) -> tuple[Array, ...]:
        return (*x0[:count], *(algebra.rotation_matrix(g) if model.n == 3 else g for g in x0[count:]))

    def rate(*z: Array, **consts: Array) -> tuple[Array, ...]:
        own = z[:count]
        out = tuple(call(model.system.flow, own, consts))
        for g in z[count:]:
            omega = call(model.system.velocity, own, consts)
            out += (omega @ g if model.system.frame is Frame.REST else g @ omega,)
        return out

    def observe_all(z: tuple[Array, ...], /, **constants: Array) -> dict[str, Array]:
        out = observe(z, **constants)
        if len(z) > count and model.n == 3:
            out[ORIENTATION] = algebra.unit_quaternion(z[count])
        return out

    if oriented:
        outcomes[ORIENTATION] = orientation_outcome(model)
    return Scheme(
        name="dop853",
        components=space.components + (((ORIENTATION, "matrix"),) if oriented else ()),
        constants=dict(model.constants),
        axes=model.axes,
        n=model.n,
        prepare=prepare,
        rate=rate,
        observe=observe_all,
        reopen=prepare,
        outcomes=outcomes,
        options={"order": 8, "rtol": RTOL, "atol": ATOL},
        numbers=model.system.numbers,
    )


METHOD = Method(
    name="dop853",
    title="SciPy's adaptive Runge-Kutta method of order 8: the reference",
    needs="a system that states its flow",
    applies=lambda s: s.flow is not None,
    orders=(8,),
    default=8,
    poisson="no",
    conserves="nothing",
    sources=("hairer1993",),
    make=dop853,
    rank=6,
)
