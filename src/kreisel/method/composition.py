"""Symmetric compositions: a symmetric step of order 2, taken in stages, becomes a step of order 4, 6 or 8.

S(gamma_s dt) ... S(gamma_1 dt) with gamma_(s+1-i) = gamma_i; the coefficients as collected in Hairer, Lubich and
Wanner, Geometric Numerical Integration, second edition, section V.3.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.method.observing import Observed, State, held_by_orientation, scheme_of, with_orientation
from kreisel.method.scheme import Guard, Scheme, Steps
from kreisel.record.model import Model

DEFECT = "defect"
SUZUKI = 4 ** (1 / 3)
FIRST_HALVES = {  # gamma_1 ... up to the middle one
    2: (1.0,),
    4: (1 / (4 - SUZUKI), 1 / (4 - SUZUKI), -SUZUKI / (4 - SUZUKI)),  # Suzuki 1990
    6: (  # Kahan and Li 1997, nine stages
        0.39216144400731413927925056,
        0.33259913678935943859974864,
        -0.70624617255763935980996482,
        0.08221359629355080023149045,
        0.79854399093482996339895035,
    ),
    8: (  # Kahan and Li 1997, seventeen stages
        0.13020248308889008087881763,
        0.56116298177510838456196441,
        -0.38947496264484728640807860,
        0.15884190655515560089621075,
        -0.39590389413323757733623154,
        0.18453964097831570709183254,
        0.25837438768632204729397911,
        0.29501172360931029887096624,
        -0.60550853383003451169892108,
    ),
}


def symmetric_composition(order: int) -> Array:
    """The fractions gamma_i of the stages."""
    half = FIRST_HALVES[order]
    return np.array(half + half[-2::-1])


Stage = Callable[[State, State, Array, Mapping[str, Array]], tuple[State, Iterable[Array], Iterable[Array]]]


def composed(
    name: str,
    model: Model,
    dt: float,
    order: int,
    oriented: bool,
    stage: Stage,
    observed: Observed,
    guard: Guard | None,
    bound: bool = True,
    **fields: Any,
) -> Scheme:
    """The scheme of a symmetric step of order 2, composed to the order; `fields` as in `scheme_of`.

    `bound`: whether an orientation rotates as the carried vectors do, as in `held_by_orientation`.

    stage(state, turned, eps, constants) -> state, turned, defects, with the orientations `turned`.  The largest defect
    so far is carried along as the component "defect" for the guard; there is none without a guard.
    """
    space, (observe, _) = model.system.space, observed
    count, last = len(space.letters), None if guard is None else -1

    def step(*z: Array, eps: Array, **constants: Array) -> State:
        state, turned, defects = stage(z[:count], z[count:last], eps, constants)
        return (*state, *turned, *(reduce(algebra.maximum, defects, defect) for defect in z[len(z[:last]) :]))

    def reopen(x: State) -> State:
        return x if guard is None else (*x, 0 * algebra.KINDS[space.kinds[0]].pack(x[0])[..., 0])

    components = with_orientation(model, oriented)
    usual: dict[str, Any] = {
        "held": None if bound else held_by_orientation(model, components, bound=False),
        "components": components + (() if guard is None else ((DEFECT, "scalar"),)),
        "axes": {**model.axes, "eps": 0},
        "stages": {"eps": symmetric_composition(order) * dt},
        "prepare": reopen,
        "reopen": reopen,
        "observe": lambda z, only=None, /, **constants: observe(z[:last], only, **constants),
        "options": {"order": order},
        "guard": guard,
    }
    return scheme_of(name, model, Steps(step), observed, oriented, **(usual | fields))
