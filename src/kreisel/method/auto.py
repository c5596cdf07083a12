"""order="auto": the order and the step that reach a tolerance at the least cost, chosen before the run.

The maps of `method="baecklund"` keep the invariant tori, so the error of a state is one of phase and grows like the
time.  A pilot from the initial state, some turns long, measures the error of each order at one step; since it goes
like h^order, that tells the step for which the error at the end of the run is the tolerance.  The cost of a step is
its number of stages.  Nothing is adapted on the way.  What is measured of a lane does not depend on other lanes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.method.baecklund import baecklund
from kreisel.record.model import Model

ORDERS = (4, 8, 12, 16, 20, 24)  # an even number of stages: they take any step
TURNS = 6.0  # radians that the pilot takes at most at the fastest rate, and more than half as many
FINEST = 12  # steps of the highest order in the reference of the pilot: half a radian each
SMALL = 1e-4  # an error of a pilot that goes like h^order
MOST_HALVINGS = 12
ROUND_OFF = 1e-15
LEAST_TOLERANCE = 1e-14
# The error may grow faster elsewhere on the torus.  At t = 100, tol = 1e-9, of 512 random bodies of Clebsch's case, the
# error was up to 14 times that of the pilot, above 4 times it for 45 of them; at most 0.47 tol with 16, 0.95 tol with
# 8, whose steps are 3 % longer, 1.9 tol with 4.
SAFETY = 16.0


@dataclass(frozen=True)
class Choice:
    """The order, the steps between two saved states, the error expected at the end of the run, and the method."""

    order: Any
    steps: int
    expected: float
    method: str = "baecklund"


def choose(model: Model, state: tuple[Array, ...], spacing: float, time: float, tol: Any) -> Choice:
    """For states saved every `spacing` until `time`; the error counts relative to the largest entry of the state.

    Of an ensemble the worst lane counts.  Raises `InputError` for a tolerance that doubles cannot hold, and where no
    order gets through the pilot.
    """
    tolerance = checked_tolerance(tol)
    return _cheapest(*_pilot_steps(model, state, time), spacing, tolerance)


def choose_each(model: Model, state: tuple[Array, ...], spacing: float, time: float, tol: Any) -> list[Choice]:
    """The same of each lane for itself, whatever the others are."""
    tolerance = checked_tolerance(tol)
    h, error = _pilot_steps(model, state, time)
    return [_cheapest(h[:, i : i + 1], error[:, i : i + 1], spacing, tolerance) for i in range(h.shape[1])]


def _cheapest(h: Array, error: Array, spacing: float, tolerance: float) -> Choice:
    """By the step (orders, lanes) of the pilots and what error that step would make at the end of the run."""
    best: tuple[float, Choice] | None = None
    for order, length, growth in zip(ORDERS, h, error, strict=True):
        step = (length * (tolerance / growth) ** (1 / order)).min()
        if not step > 0:  # NaN
            continue
        steps = max(1, math.ceil(spacing / step))
        expected = float((growth * (spacing / steps / length) ** order).max())
        cost = order * steps
        if best is None or cost < best[0]:
            best = cost, Choice(order, steps, expected)
    if best is None:
        raise InputError(
            "order='auto' finds no step: the state is not finite after a few turns at any order. Usual cause: numbers "
            "that are too large. Check the parameters and the initial state."
        )
    return best[1]


def checked_tolerance(tol: Any) -> float:
    """A tolerance that a run can have.  Raises `InputError`."""
    try:
        tolerance = float(tol)
    except (TypeError, ValueError, OverflowError):
        tolerance = math.nan
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise InputError(
            f"order='auto' needs tol, the largest error of the state at the end of the run relative to its largest "
            f"entry, from {LEAST_TOLERANCE:g} to 1, got tol={shown(tol)}. Long runs add round-off of their own."
        )
    return tolerance


def _pilot_steps(model: Model, state: tuple[Array, ...], time: float) -> tuple[Array, Array]:
    """The step of each order's pilot (orders, lanes), and the error that it would make until `time`.

    The length of a pilot is one of a few; lanes of the same are stepped together.
    """
    state = with_lanes(model, state)
    with np.errstate(all="ignore"):
        rate = fastest(model, state)
        span = np.minimum(time, TURNS / 2.0 ** np.ceil(np.log2(rate)))  # where nothing moves, `time`
        h, error = np.full((2, len(ORDERS), len(span)), np.nan)
        for length in np.unique(span[span > 0]):
            here = np.flatnonzero(span == length)
            few, start = model.lanes(here), tuple(part[here] for part in state)
            truth = _stepped(few, start, ORDERS[-1], length, FINEST)
            for k, order in enumerate(ORDERS):
                h[k, here], error[k, here] = _pilot(few, start, order, length, truth)
        return h, np.maximum(error, ROUND_OFF) * SAFETY * np.maximum(time / span, 1.0)


def with_lanes(model: Model, state: tuple[Array, ...]) -> tuple[Array, ...]:
    """The components with their axis of lanes, of one lane if need be."""
    axes = [algebra.KINDS[kind].axes for kind in model.system.space.kinds]
    batch = np.broadcast_shapes((1,), model.batch, *(p.shape[: p.ndim - k] for p, k in zip(state, axes, strict=True)))
    return tuple(np.broadcast_to(p, batch + p.shape[p.ndim - k :]) for p, k in zip(state, axes, strict=True))


def size(x: Array) -> Array:
    """The largest |entry| of each lane."""
    return np.asarray(abs(x).reshape(len(x), -1).max(-1))


def fastest(model: Model, state: tuple[Array, ...]) -> Array:
    """The largest of |omega| and sqrt(|momentum'|), of each lane: the rate that a step has to resolve."""
    turning = size(model.call(model.system.velocity, *state))
    pull = np.max([size(part) for part in model.flow(*state)], axis=0)
    return np.maximum(turning, np.sqrt(pull))


def _stepped(model: Model, state: tuple[Array, ...], order: int, span: float, count: int) -> tuple[Array, ...]:
    plan = baecklund(model, span / count, order, oriented=False).on(state)
    z = plan.prepare(state)
    for _ in range(count):
        z = plan.advance(*z)
    return z


def _pilot(
    model: Model, state: tuple[Array, ...], order: int, span: float, truth: tuple[Array, ...]
) -> tuple[Array, Array]:
    """Of each lane the longest step, of span, span/2, span/4, ..., whose error over the pilot is small, and that."""
    step, error = np.full((2, len(state[0])), np.nan)
    lost = ~np.isfinite(np.max([size(part) for part in truth], axis=0))
    for halvings in range(MOST_HALVINGS):
        coarse = ~(error < SMALL)
        error[coarse] = _relative_difference(_stepped(model, state, order, span, 1 << halvings), truth)[coarse]
        step[coarse] = span / (1 << halvings)
        if ((error < SMALL) | lost).all():
            break
    return step, error


def _relative_difference(one: tuple[Array, ...], other: tuple[Array, ...]) -> Array:
    """The largest difference of each lane, relative to the largest entry of each component."""
    sizes = [size(part) for part in other]
    apart = [size(a - b) for a, b in zip(one, other, strict=True)]
    return np.asarray(np.max([np.where(s == 0, 0.0, d / s) for d, s in zip(apart, sizes, strict=True)], axis=0))
