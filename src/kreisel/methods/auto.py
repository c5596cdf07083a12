"""order="auto": the order and the step that reach a tolerance at the least cost, chosen before the run.

The maps of `method="baecklund"` keep the invariant tori, so the error of a state is one of phase and grows like the
time.  A pilot from the initial state, some turns long, measures the error of each order at one step; since it goes
like h^order, that tells the step for which the error at the end of the run is the tolerance.  The cost of a step is
its number of stages.  Nothing is adapted on the way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.methods.baecklund import baecklund
from kreisel.model import Model

ORDERS = (4, 8, 12, 16, 20, 24)  # an even number of stages: they take any step
TURNS = 6.0  # radians that the pilot takes at the fastest rate
FINEST = 12  # steps of the highest order in the reference of the pilot: half a radian each
SMALL = 1e-4  # an error of a pilot that goes like h^order
MOST_HALVINGS = 12
ROUND_OFF = 1e-15
LEAST_TOLERANCE = 1e-14
SAFETY = 4.0  # the error may grow a little faster elsewhere on the torus


@dataclass(frozen=True)
class Choice:
    """The order, the steps between two saved states, and the error that is expected at the end of the run."""

    order: int
    steps: int
    expected: float


def choose(model: Model, state: tuple[Array, ...], spacing: float, time: float, tol: Any) -> Choice:
    """For states saved every `spacing` until `time`; the error counts relative to the largest entry of the state.

    Of an ensemble the worst lane counts.  Raises `InputError` for a tolerance that doubles cannot hold.
    """
    tolerance = _checked(tol)
    rate = _fastest(model, state)
    span = min(time, TURNS / rate) if rate > 0 else time
    truth = _march(model, state, ORDERS[-1], span, FINEST)
    best: tuple[float, Choice] | None = None
    for order in ORDERS:
        h, error = _pilot(model, state, order, span, truth)
        growth = max(error, ROUND_OFF) * SAFETY * max(time / span, 1.0)
        step = h * (tolerance / growth) ** (1 / order)
        steps = max(1, math.ceil(spacing / step))
        expected = growth * (spacing / steps / h) ** order
        cost = order * steps
        if best is None or cost < best[0]:
            best = cost, Choice(order, steps, expected)
    assert best is not None
    return best[1]


def _checked(tol: Any) -> float:
    try:
        tolerance = float(tol)
    except (TypeError, ValueError):
        tolerance = math.nan
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise InputError(
            f"order='auto' needs tol, the largest error of the state at the end of the run relative to its largest "
            f"entry, from {LEAST_TOLERANCE:g} to 1; tol={tol!r} came. Long runs add round-off of their own."
        )
    return tolerance


def _fastest(model: Model, state: tuple[Array, ...]) -> float:
    """The largest of |omega| and sqrt(|momentum'|), over the lanes: the rate that a step has to resolve."""
    turning = algebra.magnitude(model.call(model.system.velocity, *state))
    pull = max(algebra.magnitude(part) for part in model.flow(*state))
    return max(turning, math.sqrt(pull))


def _march(model: Model, state: tuple[Array, ...], order: int, span: float, count: int) -> tuple[Array, ...]:
    plan = baecklund(model, span / count, order, oriented=False).on(state)
    z = plan.prepare(state)
    for _ in range(count):
        z = plan.advance(*z)
    return z


def _apart(one: tuple[Array, ...], other: tuple[Array, ...]) -> float:
    return max(algebra.magnitude(a - b) / algebra.magnitude(b) for a, b in zip(one, other, strict=True) if abs(b).max())


def _pilot(
    model: Model, state: tuple[Array, ...], order: int, span: float, truth: tuple[Array, ...]
) -> tuple[float, float]:
    """The longest step, of span, span/2, span/4, ..., whose error over the pilot is small, and that error."""
    for halvings in range(MOST_HALVINGS):
        count = 1 << halvings
        error = _apart(_march(model, state, order, span, count), truth)
        if error < SMALL:
            break
    return span / count, error
