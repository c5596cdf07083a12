"""The field along an orbit, interpolated in time, for steps much shorter than those in which it changes.

A window of the length `span` has six equidistant nodes, t = (w - 1/2 + i/5) span, i = 0 .. 5, with w the integer next
to t/span.  The polynomial through the fields at the nodes is the field of the window: a function of time only, whatever
was computed before.  The state carries w + 1/2 and the coefficients, which are computed when w changes.

With a hundred windows in a revolution, IGRF-14 of degree 13 at 500 km is off by less than 1e-4 nT.  A window is not
longer than two steps of a table of positions, whose polynomials continue beyond its ends: then positions rounded to
100 m, 10 s apart, make it off by less than 0.04 nT, in longer windows by up to 200 nT.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import joined
from kreisel.algebra.invariants import stack
from kreisel.algebra.iteration import repeat
from kreisel.forces import kicks
from kreisel.forces.kicks import Body, Constants, perturbation_of
from kreisel.record.calling import call
from kreisel.record.model import Model

WINDOW, SPAN = "_window", "_span"
NODES, ALWAYS = 6, -1.0
SIZE = 1 + 3 * NODES
KIND = f"R^{SIZE}"
PLACES = np.arange(NODES) / (NODES - 1) - 0.5
POWERS = np.linalg.inv(np.vander(PLACES, increasing=True))  # coefficients of the values at the nodes
LONGEST_SAMPLE, SAMPLES = 10.0, 4  # s between two samples; of them in a window
STEPS_OF_TABLE = 2  # in a window at most


def span_of(model: Model) -> Any:
    """Length of a window, in the unit of time of the model; None if the field is not needed, or seldom sampled."""
    record = perturbation_of(model.system)
    control = record.control
    if control is None or record.smooth is None or record.environment is None:
        return None
    if "field" not in control.arguments and "dipole" not in control.commands:
        return None
    span, least = call(record.smooth, (), model.constants), SAMPLES * control.every
    for name in record.environment.tables:
        rate = model.constants[name][..., 3]  # of a handle, 1/step; 0 without a table
        span = np.minimum(span, STEPS_OF_TABLE / np.where(rate > 0, rate, STEPS_OF_TABLE / span))
        if (STEPS_OF_TABLE < least * rate).any():
            return None
    return None if control.every * control.time > LONGEST_SAMPLE else np.maximum(span, least)


def renewed(window: Array, body: Body, model: Model, constants: Constants) -> Array:
    """The window (..., SIZE) of the time of a body."""
    span = constants[SPAN]
    w = algebra.nearest(body.t / span)
    moved = window[..., 0] - w - 0.5

    def computed() -> Array:
        def shifted(x: Array) -> tuple[tuple[Array], Any]:
            place = x[..., 0]
            at_node = body._replace(t=(w + place) * span)
            B = kicks.field_of(model.system, at_node, constants, model.axes)
            return (joined(stack([place + 1 / (NODES - 1)]), x[..., 4:], B),), place * place

        start = joined(stack([0 * window[..., 0] - 0.5]), window[..., 1:])  # all of which leaves
        (x,), _ = repeat(shifted, (start,), ALWAYS, NODES, (KIND,))
        values = [x[..., 1 + 3 * i : 4 + 3 * i] for i in range(NODES)]
        powers = [sum(row[i] * values[i] for i in range(NODES)) for row in POWERS]
        return joined(stack([w + 0.5]), *powers)

    return algebra.if_positive(moved * moved - 0.1, computed, window)


def field(window: Array, t: Any, constants: Constants) -> Array:
    """The field (..., 3) in space at the time t."""
    s: Any = algebra.vec(t / constants[SPAN] - (window[..., 0] - 0.5))
    out = window[..., 1 + 3 * (NODES - 1) :]
    for k in range(NODES - 2, -1, -1):
        out = window[..., 1 + 3 * k : 4 + 3 * k] + s * out
    return out
