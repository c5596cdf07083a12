"""order="auto": the order and the step that reach a tolerance at the least cost, chosen before the run.

Nothing is adapted on the way.

The maps of `method="baecklund"` keep the invariant tori, so the error of a state is one of phase and grows like the
time.  A pilot from the initial state, some rotations long, measures the error of each order at one step; since it goes
like h^order, that tells the step for which the error at the end of the run is the tolerance.  The cost of a step is
its number of stages.  Measurements of a lane do not depend on other lanes.

For perturbed bodies the splitting is chosen too.  How an error depends on the step and on the size of the perturbation
differs from order to order, so it is measured: a pilot from the initial state, some rotations long, is run by every
splitting with a ladder of steps, and compared with a finer one.  Without friction the error of a state is one of phase
and grows like the time; that is assumed, and checked in a longer run with the chosen step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.forces.kicks import perturbation_of
from kreisel.method.baecklund import baecklund
from kreisel.method.records import METHODS
from kreisel.method.scheme import State, with_lanes
from kreisel.record.calling import call
from kreisel.record.contract import System
from kreisel.record.model import Model

ORDERS = (4, 8, 12, 16, 20, 24)  # an even number of stages: any step is allowed
TURNS = 6.0  # radians that the pilot needs at most at the fastest rate, and more than half as many
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


def choose(model: Model, state: State, spacing: float, time: float, tol: Any, every_lane: bool = False) -> list[Choice]:
    """For states saved every `spacing` until `time`; the error counts relative to the largest entry of the state.

    The choice for the worst lane of an ensemble, or with `every_lane` those for all lanes.  Raises `InputError` for a
    tolerance that doubles cannot hold, and where no order gets through the pilot.
    """
    tolerance = checked_tolerance(tol)
    h, error = _pilot_steps(model, state, time)
    choices = []
    for lane in [slice(i, i + 1) for i in range(h.shape[1])] if every_lane else [slice(None)]:
        best: tuple[float, Choice] | None = None
        for order, length, growth in zip(ORDERS, h[:, lane], error[:, lane], strict=True):
            step = (length * (tolerance / growth) ** (1 / order)).min()
            if not step > 0:  # NaN
                continue
            steps = max(1, math.ceil(spacing / step))
            expected = float((growth * (spacing / steps / length) ** order).max())
            if best is None or order * steps < best[0]:
                best = order * steps, Choice(order, steps, expected)
        if best is None:
            raise InputError(
                "order='auto' finds no step: the state is not finite after a few revolutions at any order. Usual "
                "cause: numbers that are too large. Check the parameters and the initial state."
            )
        choices.append(best[1])
    return choices


def checked_tolerance(tol: Any) -> float:
    """A tolerance that a run can have.  Raises `InputError`."""
    try:
        tolerance = float(tol)
    except (TypeError, ValueError, OverflowError):
        tolerance = math.nan
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise InputError(
            f"order='auto' needs tol, the largest error of the state at the end of the run relative to its largest "
            f"entry, from {LEAST_TOLERANCE:g} to 1, got tol={shown(tol)}. Long runs add round-off."
        )
    return tolerance


def _pilot_steps(model: Model, state: State, time: float) -> tuple[Array, Array]:
    """The step of each order's pilot (orders, lanes), and the error that it would make until `time`.

    The length of a pilot is one of a few; lanes of the same are stepped together.
    """
    _, state = with_lanes(model, state, (1,))
    with np.errstate(all="ignore"):
        rate = fastest(model, state)
        span = np.minimum(time, TURNS / 2.0 ** np.ceil(np.log2(rate)))  # where nothing moves, `time`
        h, error = np.full((2, len(ORDERS), len(span)), np.nan)
        for length in np.unique(span[span > 0]):
            lanes = np.flatnonzero(span == length)
            few, start = model.lanes(lanes), tuple(component[lanes] for component in state)
            truth = _stepped(few, start, ORDERS[-1], length, FINEST)
            for k, order in enumerate(ORDERS):
                h[k, lanes], error[k, lanes] = _pilot(few, start, order, length, truth)
        return h, np.maximum(error, ROUND_OFF) * SAFETY * np.maximum(time / span, 1.0)


def size(x: Array) -> Array:
    """The largest |entry| of each lane."""
    return np.asarray(abs(x).reshape(len(x), -1).max(-1))


def fastest(model: Model, state: State) -> Array:
    """The largest of |omega| and sqrt(|momentum'|), of each lane: the rate that a step has to resolve."""
    turning = size(model.call(model.system.velocity, *state))
    pull = np.max([size(component) for component in model.flow(*state)], axis=0)
    return np.maximum(turning, np.sqrt(pull))


def _stepped(model: Model, state: State, order: int, span: float, count: int) -> State:
    plan = baecklund(model, span / count, order, oriented=False).on(state)
    z = plan.prepare(state)
    for _ in range(count):
        z = plan.advance(*z)
    return z


def _pilot(model: Model, state: State, order: int, span: float, truth: State) -> tuple[Array, Array]:
    """Longest step of each lane, of span, span/2, ..., whose error over the pilot is small, and this error."""
    step, error = np.full((2, len(state[0])), np.nan)
    sizes = [size(component) for component in truth]
    lost = ~np.isfinite(np.max(sizes, axis=0))
    for halvings in range(MOST_HALVINGS):
        coarse = ~(error < SMALL)
        end = _stepped(model, state, order, span, 1 << halvings)
        apart = [np.where(s == 0, 0.0, size(a - b) / s) for a, b, s in zip(end, truth, sizes, strict=True)]
        error[coarse] = np.max(apart, axis=0)[coarse]
        step[coarse] = span / (1 << halvings)
        if ((error < SMALL) | lost).all():
            break
    return step, error


# -- splittings of perturbed bodies ----------------------------------------------------------------------------

PILOT = 64.0  # radians of a pilot at the fastest rate
LONGEST, RUNGS = 3.0, 15  # radians of the longest step; each of the others is shorter by sqrt(2)
TRUTHS = (8, (10, 6, 4))  # the first of which not every force has
LEAST_ERROR = 4e-15
AHEAD = 1e-4  # radians, over which the rate of Omega is taken
NUDGE = 1e-8  # of the momenta: a neighbouring orbit
LONG, EXPONENTIAL = 20, 20.0  # pilots; how much farther apart after twice the time, where in proportion is 2
WITNESS, REFINED, SHORTER = 20, 8, 1.4  # pilots; how often steps are made shorter, and by how much
USUAL, FIRST, TRIES = (8, 6, 4), 0.5, 12  # the splitting of `halved`, radians of its first step, steps that are tried
SHORTEST = 8.0  # times: a step may be shorter than the one before it
USUAL_TOLERANCE = 2.5e-7  # of an entry of a quaternion, relative to the largest: of the angle 1e-6 rad
MOST_STEPS = 3e7  # of all lanes, of a run of `halved`
WHOLE = 1e-6  # of a step: rounding in a count
CHAOTIC, MARGIN = 100, 4.0  # pilots of a motion whose neighbours part fast, which is run to its end if that is nearer
LATER = 10.0  # the error may grow faster later, where the motion is near to chaos


FAILS = (
    "order='auto' finds no step: the pilot fails with steps of a hundredth of a radian. Usual cause: a force that is "
    "not a number there (log or sqrt of a negative number, a division by 0), numbers that are too large, or a "
    "perturbation that changes within far less than a revolution. Say order and dt."
)


class Pilot(NamedTuple):
    """The components at the end of some steps, (lanes, values) of each, the cost of a step, and of a saved row."""

    state: State
    cost: float
    row: float = 0.0


Steps = Callable[[Any, float, int], Pilot | None]  # (order, h, count); None if it does not get there


def rate_of(model: Model, state: State) -> float:
    """The fastest rate of the integrable part, of all lanes."""
    base, (_, lanes) = perturbation_of(model.system).base, with_lanes(model, state, (1,))
    if base.product:
        bodies = [(f.system, f.constants(model.constants), lanes[f.place]) for f in base.product]
    else:
        bodies = [(base, model.constants, lanes[: len(base.space.letters)])]
    with np.errstate(all="ignore"):
        return max(_fastest(*body) for body in bodies)


def _fastest(system: System, constants: Mapping[str, Array], state: State) -> float:
    """max(|Omega|, sqrt(|Omega'|)), in any units; without Omega max |z'|/|z| over the components z."""
    rates = call(system.flow, state, constants)
    if system.velocity is None:
        return float(
            max(np.nan_to_num(size(rate) / size(component)).max() for rate, component in zip(rates, state, strict=True))
        )
    Omega = call(system.velocity, state, constants)
    turning = float(size(Omega).max())
    ahead = AHEAD / turning if turning else 1.0
    later = call(system.velocity, tuple(z + ahead * rate for z, rate in zip(state, rates, strict=True)), constants)
    return max(turning, float(np.sqrt(size(later - Omega).max() / ahead)))


def choose_splitting(steps: Steps, rate: float, spacing: float, time: float, tol: Any) -> Choice:
    """For states saved every `spacing` until `time`, of the worst lane.

    Raises `InputError` for a tolerance that doubles cannot hold, and where no splitting reaches it.
    """
    tolerance = checked_tolerance(tol)
    span = min(time, PILOT / rate) if 0 < rate < np.inf else time
    longest = min(LONGEST / rate, span) if 0 < rate < np.inf else span
    counts = sorted({max(1, round(span / longest * 2 ** (k / 2))) for k in range(RUNGS)})
    truth, doubt = _truth(steps, span, counts)
    grows = LATER * max(time / span, 1.0)
    best: tuple[float, Choice] | None = None
    for order in METHODS["splitting"].orders:
        for count in counts:
            result = steps(order, span / count, count)
            expected = np.inf if result is None else grows * max(_apart(result.state, truth), doubt, LEAST_ERROR)
            if result is None or not expected <= tolerance:
                continue
            in_spacing = max(1, int(np.ceil(spacing * count / span * (1 - 1e-12))))
            cost = result.cost * in_spacing + result.row
            if best is None or cost < best[0]:
                best = cost, Choice(order, in_spacing, float(expected), "splitting")
            break
    if best is None:
        raise InputError(
            f"order='auto' finds no splitting that reaches tol = {tolerance:g} with steps of {span / counts[-1]:.1g} or"
            f" more: the error of the pilot grows to {grows * doubt:.1g} or more until the end. Use a larger tol."
        )
    return best[1]


def halved(
    steps: Steps, rate: float, spacing: float, time: float, tol: float, order: int, lanes: int, strict: bool
) -> tuple[Choice, bool]:
    """One splitting, with the first step that differs from half of it by less than `tol` in runs to the end.

    Returns it, and whether there is such a step.

    order    2 through corners of the forces, at which no splitting has a higher one
    strict   whether the error counts that the end of a motion longer than the pilots of a chaotic one has, in
             proportion to the time; else the error at the end of these pilots

    Raises `InputError` if no step succeeds.
    """
    span = min(time, CHAOTIC * PILOT / rate) if 0 < rate < np.inf else time
    count, tried = max(1, math.ceil(spacing * rate / FIRST)) if 0 < rate < np.inf else 1, list[Choice]()
    for _ in range(TRIES):
        h = spacing / count
        many = max(1, int(min(span / h, MOST_STEPS / lanes) + WHOLE))
        ends = [end.state for end in (steps(USUAL, h / k, many * k) for k in (1, 2)) if end is not None]
        apart = _apart(*ends) if len(ends) == 2 else np.inf
        tried.append(Choice(USUAL, count, apart * max(time / (h * many), 1.0), "splitting"))
        wrong = (tried[-1].expected if strict else apart * max(span / (h * many), 1.0)) / tol
        if wrong <= 1 or count > MOST_STEPS:
            return tried[-1], wrong <= 1
        count = math.ceil(count * min(max(1.5 * wrong ** (1 / order), SHORTER), SHORTEST))
    best = min(tried, key=lambda choice: choice.expected)
    if not np.isfinite(best.expected):
        raise InputError(FAILS)
    return best, False


def separates(motion: Steps, neighbour: Steps, choice: Choice, rate: float, spacing: float, time: float) -> bool:
    """Whether two neighbouring orbits part far faster than in proportion to the time, as in chaos.

    In twice the time regular ones are found 0.4 to 9 times as far apart, chaotic ones 36 to 1e6 times, somewhere.
    """
    h = spacing / choice.steps
    count = int(min(time, LONG * PILOT / rate) / h) if 0 < rate < np.inf else 0
    apart = []
    for divisor in (32, 16, 8, 4, 2, 1):
        ends = (
            [steps(choice.order, h, count // divisor) for steps in (motion, neighbour)] if count // divisor else [None]
        )
        if any(end is None for end in ends):
            continue
        apart.append(_apart(*(end.state for end in ends if end is not None)))
    return any(later > EXPONENTIAL * earlier for earlier, later in pairwise(apart))


def witnessed(
    steps: Steps, choice: Choice, rate: float, spacing: float, time: float, tol: Any, chaotic: bool = False
) -> Choice:
    """The choice, with shorter steps if it is off by more than `tol` in a run of some pilots against half the step.

    A chaotic motion is run for longer, and with a margin: rounding errors grow, too.

    A pilot does not see slow motions, such as the beats of coupled bodies, by which errors grow faster than the time.
    """
    tolerance, tried, best = checked_tolerance(tol), list[Choice](), np.inf
    pilots, margin = (CHAOTIC, MARGIN) if chaotic else (WITNESS, 1.0)
    for _ in range(REFINED):
        h = spacing / choice.steps
        count = int(min(time, pilots * PILOT / rate) / h + WHOLE) if 0 < rate < np.inf else 0
        results = [steps(choice.order, h / k, count * k) for k in (1, 2)] if count else []
        ends = [end.state for end in results if end is not None]
        if len(ends) < 2:
            break
        result = margin * _apart(*ends) * max(time / (h * count), 1.0)
        tried.append(replace(choice, expected=result if tried else max(choice.expected, result)))
        if result <= tolerance or result >= best:  # shorter steps do not help
            break
        best = min(best, result)
        choice = replace(choice, steps=int(np.ceil(choice.steps * SHORTER)))
    return min(tried, key=lambda choice: choice.expected, default=choice)


def within_reach(rate: float, time: float) -> bool:
    """Whether a motion ends within the pilots that are run of a chaotic one."""
    return time * rate <= CHAOTIC * PILOT


def _truth(steps: Steps, span: float, counts: list[int]) -> tuple[State, float]:
    """The end of the pilot as two splittings agree on it best, and how far they are apart.

    The steps that are short enough are not the shortest: rounding grows with their number.
    """
    best: tuple[float, State] | None = None
    before: State | None = None  # of the only splitting that gets there, with longer steps
    for count in counts[len(counts) // 2 :: 2]:
        results = [steps(order, span / count, count) for order in TRUTHS]
        states = [result.state for result in results if result is not None]
        others = states[:-1] or ([] if before is None else [before])
        before = states[0] if len(states) == 1 else None
        if states and others and (best is None or _apart(others[0], states[-1]) < best[0]):
            best = _apart(others[0], states[-1]), states[-1]
    if best is None:
        raise InputError(FAILS)
    return best[1], best[0]


def _apart(state: State, reference: State) -> float:
    """The largest difference of a component of a lane, relative to its largest entry."""
    with np.errstate(all="ignore"):
        apart = [np.where((x == y).all(-1), 0, size(x - y) / size(y)) for x, y in zip(state, reference, strict=True)]
    result = float(np.max(apart))
    return result if np.isfinite(result) else np.inf
