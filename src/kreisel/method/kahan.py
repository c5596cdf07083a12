"""method="kahan": Kahan's discretization of flows that are quadratic in the state, and compositions of it.

For x' = f(x) = Q(x, x) + B x + c, Q symmetric and bilinear, the step is

    (x' - x)/dt = Q(x, x') + B (x + x')/2 + c,   so   x' = x + dt (1 - dt/2 f'(x))^-1 f(x):

one linear equation.  It is birational and symmetric (the inverse is the step with -dt), of order 2.  Linear integrals
of the flow are integrals of the map.  For the Euler top, x_i' = alpha_i x_j x_k, the ratios of the numbers
1 - dt^2/4 alpha_j alpha_k x_i^2 are integrals too; `kahan_integrals` has them, and those of Lagrange's top with equal
moments, of Clebsch's case, of the Euler top in so(4) and of gyrostats.  The orientation turns by the Cayley transform
of dt/2 Omega((x + x')/2).
[Kahan, unpublished notes, 1993; Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.errors import InputError
from kreisel.method.composition import DEFECT, composed
from kreisel.method.kahan_integrals import deformed_integrals, one_lane
from kreisel.method.kahan_step import State, advance, coordinate_count, state_of
from kreisel.method.observing import Only, held_by_orientation, observer, turned, with_orientation
from kreisel.method.scheme import Guard, Outcome, Scheme
from kreisel.record.calling import call
from kreisel.record.model import Model

MOST_COORDINATES = 15  # e(5); straight-line code of the elimination grows like their cube
SMALLEST_PIVOT = 0.01
POINTS = 3  # at which third differences are taken


def kahan(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """Kahan's step with dt, of order 2, or composed to order 4, 6 or 8.

    The largest 1 - (a pivot of the linear equation) is carried along as the component "defect" and guarded.
    """
    linear = tuple(name for name, function in model.system.integrals.items() if is_linear(model, function))
    energy = f"Hamiltonian H, not conserved by the map: its error is of order dt^{order}"
    observe_all, outcomes = observer(
        model, None, None, conserved=linear, meanings={"energy": energy}, oriented=oriented
    )
    integrals = deformed_integrals(model) if order == 2 else None

    def stage(old: State, turned: State, eps: Array, consts: Mapping[str, Array]) -> tuple[Any, Any, Any]:
        new, pivots = advance(model, old, eps, consts)
        return new, (_followed(model, old, new, g, eps, consts) for g in turned), (1 - pivot for pivot in pivots)

    def observe(z: State, only: Only = None, /, **constants: Array) -> dict[str, Array]:
        out = observe_all(z, only if integrals is None else None, **constants)
        return out | (integrals.values(model, out, dt, constants) if integrals is not None else {})

    guard = Guard(
        DEFECT,
        1 - SMALLEST_PIVOT,
        "The linear equation of Kahan's step is singular, or close to it",
        "a step in which the state changes by more than itself. Use a smaller dt.",
    )
    held = held_by_orientation(model, with_orientation(model, oriented), bound=False)
    scheme = composed("kahan", model, dt, order, oriented, stage, (observe, outcomes), guard, held=held)
    if integrals is None:
        return scheme

    def prepare(x: State) -> State:
        integrals.check(model, x)
        return scheme.reopen(x)

    deformed = {
        name: Outcome("integral", f"deformed {meaning}, conserved exactly by the map", conserved=True)
        for name, meaning in integrals.meanings.items()
    }
    return replace(scheme, prepare=prepare, outcomes=outcomes | deformed)


def _followed(model: Model, old: State, new: State, g: Array, eps: Array, consts: Mapping[str, Array]) -> Array:
    middle = tuple((x + y) / 2 for x, y in zip(old, new, strict=True))
    X = eps / 2 * call(model.system.velocity, middle, consts)
    return turned(model.system.frame, X, g)


# -- what is known of a flow, over the rational numbers ------------------------------------------------


def is_quadratic(model: Model) -> bool:
    """Whether the flow is quadratic in the state, for these parameters: third differences vanish over Q."""
    return bool(reused((is_quadratic, model.key), lambda: _differences_vanish(model, model.system.flow, 3)))


def is_linear(model: Model, function: Callable[..., Any]) -> bool:
    """Whether a function is linear in the state, for these parameters: second differences vanish over Q."""
    return _differences_vanish(model, function, 2)


def _differences_vanish(model: Model, function: Callable[..., Any] | None, order: int) -> bool:
    """Whether differences of that order vanish at random points, where parameters that vary are mixed at random."""
    rng = np.random.default_rng(1)
    known = {name: one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}
    signs = {2: (1, -2, 1), 3: (-1, 3, -3, 1)}[order]
    for _ in range(POINTS):
        start, along = (_random(model, rng) for _ in range(2))
        total: Any = 0
        for k, sign in enumerate(signs):
            state = state_of(model.system.space, [x + k * y for x, y in zip(start, along, strict=True)], model.n)
            try:
                value = call(function, state, known)
            except (TypeError, AttributeError, ZeroDivisionError, InputError):  # no rational function
                return False
            parts = value if isinstance(value, tuple) else (value,)
            total = total + sign * np.concatenate([np.ravel(np.asarray(v, dtype=object)) for v in parts])
        if any(v != 0 for v in total):
            return False
    return True


def _random(model: Model, rng: np.random.Generator) -> list[Fraction]:
    count = sum(coordinate_count(kind, model.n) for kind in model.system.space.kinds)
    return [
        Fraction(int(a), int(b)) for a, b in zip(rng.integers(-99, 99, count), rng.integers(1, 99, count), strict=True)
    ]


def has_a_small_quadratic_flow(model: Model) -> bool:
    """Whether the flow is quadratic, in few coordinates."""
    count = sum(coordinate_count(kind, model.n) for kind in model.system.space.kinds)
    return count <= MOST_COORDINATES and is_quadratic(model)
