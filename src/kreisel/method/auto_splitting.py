"""order="auto" for perturbed bodies: the splitting and the step that reach a tolerance at the least cost.

How an error depends on the step and on the size of the perturbation differs from order to order, so it is measured: a
pilot from the initial state, some turns long, is run by every splitting with a ladder of steps, and compared with a
finer one.  Without friction the error of a state is one of phase and grows like the time; that is what is assumed, and
looked at in a longer run of what was chosen.
Nothing is adapted on the way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.forces.kicks import perturbation_of
from kreisel.method.auto import Choice, checked_tolerance, size, with_lanes
from kreisel.method.records import METHODS
from kreisel.record.calling import call
from kreisel.record.contract import System
from kreisel.record.model import Model

TURNS = 64.0  # radians of a pilot at the fastest rate
LONGEST, RUNGS = 3.0, 15  # radians of the longest step; each of the others is shorter by sqrt(2)
TRUTHS = (8, (10, 6, 4))  # the first of which not every force has
ROUND_OFF = 4e-15
AHEAD = 1e-4  # radians, over which the rate of Omega is taken
NUDGE = 1e-8  # of the momenta: a neighbouring orbit
LONG, EXPONENTIAL = 20, 20.0  # pilots; how much farther apart after twice the time, where in proportion is 2
WITNESS, REFINED, SHORTER = 20, 8, 1.4  # pilots; how often steps are made shorter, and by how much
WHOLE = 1e-6  # of a step: rounding in a count
CHAOTIC, MARGIN = 100, 4.0  # pilots of a motion whose neighbours part fast, which is run to its end if that is nearer
SAFETY = 10.0  # the error may grow faster later, where the motion is near to chaos


class Pilot(NamedTuple):
    """The components at the end of some steps, (lanes, numbers) of each, the cost of a step, and of a saved row."""

    state: tuple[Array, ...]
    cost: float
    row: float = 0.0


Steps = Callable[[Any, float, int], Pilot | None]  # (order, h, count); None where it does not get there


def rate_of(model: Model, state: tuple[Array, ...]) -> float:
    """The fastest rate of the integrable part, of all lanes."""
    base, lanes = perturbation_of(model.system).base, with_lanes(model, state)
    if base.product:
        bodies = [(f.system, f.known(model.constants), lanes[f.place]) for f in base.product]
    else:
        bodies = [(base, model.constants, lanes)]
    with np.errstate(all="ignore"):
        return max(_fastest(*body) for body in bodies)


def _fastest(system: System, constants: Mapping[str, Array], state: tuple[Array, ...]) -> float:
    """max(|Omega|, sqrt(|Omega'|)), in any units; without Omega max |z'|/|z| over the components z."""
    rates = call(system.flow, state, constants)
    if system.velocity is None:
        return float(max(np.nan_to_num(size(rate) / size(part)).max() for rate, part in zip(rates, state, strict=True)))
    Omega = call(system.velocity, state, constants)
    turning = float(size(Omega).max())
    ahead = AHEAD / turning if turning else 1.0
    later = call(system.velocity, tuple(z + ahead * rate for z, rate in zip(state, rates, strict=True)), constants)
    return max(turning, float(np.sqrt(size(later - Omega).max() / ahead)))


def choose(steps: Steps, rate: float, spacing: float, time: float, tol: Any) -> Choice:
    """For states saved every `spacing` until `time`, of the worst lane.

    Raises `InputError` for a tolerance that doubles cannot hold, and where no splitting reaches it.
    """
    tolerance = checked_tolerance(tol)
    span = min(time, TURNS / rate) if 0 < rate < np.inf else time
    longest = min(LONGEST / rate, span) if 0 < rate < np.inf else span
    counts = sorted({max(1, round(span / longest * 2 ** (k / 2))) for k in range(RUNGS)})
    truth, doubt = _truth(steps, span, counts)
    grows = SAFETY * max(time / span, 1.0)
    best: tuple[float, Choice] | None = None
    for order in METHODS["splitting"].orders:
        for count in counts:
            found = steps(order, span / count, count)
            expected = np.inf if found is None else grows * max(_apart(found.state, truth), doubt, ROUND_OFF)
            if found is None or not expected <= tolerance:
                continue
            in_spacing = max(1, int(np.ceil(spacing * count / span * (1 - 1e-12))))
            cost = found.cost * in_spacing + found.row
            if best is None or cost < best[0]:
                best = cost, Choice(order, in_spacing, float(expected), "splitting")
            break
    if best is None:
        raise InputError(
            f"order='auto' finds no splitting that reaches tol = {tolerance:g} with steps of a hundredth of a radian: "
            f"the error of the pilot grows to {grows * doubt:.1g} or more until the end of the run. Use a larger tol."
        )
    return best[1]


def separates(one: Steps, other: Steps, choice: Choice, rate: float, spacing: float, time: float) -> bool:
    """Whether two neighbouring orbits part far faster than in proportion to the time, as in chaos.

    In twice the time regular ones are found 0.4 to 9 times as far apart, chaotic ones 36 to 1e6 times, somewhere.
    """
    h = spacing / choice.steps
    count = int(min(time, LONG * TURNS / rate) / h) if 0 < rate < np.inf else 0
    apart = []
    for part in (32, 16, 8, 4, 2, 1):
        ends = [steps(choice.order, h, count // part) for steps in (one, other)] if count // part else [None]
        if any(end is None for end in ends):
            continue
        apart.append(_apart(*(end.state for end in ends if end is not None)))
    return any(later > EXPONENTIAL * earlier for earlier, later in pairwise(apart))


def witnessed(
    steps: Steps, choice: Choice, rate: float, spacing: float, time: float, tol: Any, chaotic: bool = False
) -> Choice:
    """The choice, with shorter steps where it is off by more than `tol` in a run of some pilots against half the step.

    A chaotic motion is run for longer, and with a margin: what rounding does to it grows too.

    A pilot does not see what is slow, such as the beats of coupled bodies, by which errors grow faster than the time.
    """
    tolerance, tried, best = checked_tolerance(tol), list[Choice](), np.inf
    pilots, margin = (CHAOTIC, MARGIN) if chaotic else (WITNESS, 1.0)
    for _ in range(REFINED):
        h = spacing / choice.steps
        count = int(min(time, pilots * TURNS / rate) / h + WHOLE) if 0 < rate < np.inf else 0
        both = [steps(choice.order, h / k, count * k) for k in (1, 2)] if count else []
        ends = [end.state for end in both if end is not None]
        if len(ends) < 2:
            break
        found = margin * _apart(*ends) * max(time / (h * count), 1.0)
        tried.append(replace(choice, expected=found if tried else max(choice.expected, found)))
        if found <= tolerance or found >= best:  # shorter steps do not help
            break
        best = found
        choice = replace(choice, steps=int(np.ceil(choice.steps * SHORTER)))
    return min(tried, key=lambda one: one.expected, default=choice)


def within_reach(rate: float, time: float) -> bool:
    """Whether a motion ends within the pilots that are run of a chaotic one."""
    return time * rate <= CHAOTIC * TURNS


def _truth(steps: Steps, span: float, counts: list[int]) -> tuple[tuple[Array, ...], float]:
    """The end of the pilot as two splittings agree on it best, and how far they are apart.

    The steps that are short enough are not the shortest: rounding grows with their number.
    """
    best: tuple[float, tuple[Array, ...]] | None = None
    before: tuple[Array, ...] | None = None  # of the only splitting that gets there, with longer steps
    for count in counts[len(counts) // 2 :: 2]:
        both = [steps(order, span / count, count) for order in TRUTHS]
        known = [found.state for found in both if found is not None]
        others = known[:-1] or ([] if before is None else [before])
        before = known[0] if len(known) == 1 else None
        if known and others and (best is None or _apart(others[0], known[-1]) < best[0]):
            best = _apart(others[0], known[-1]), known[-1]
    if best is None:
        raise InputError(
            "order='auto' finds no step: the pilot fails with steps of a hundredth of a radian. Usual cause: a "
            "force that is no number there (log or sqrt of a negative number, a division by 0), numbers that are too "
            "large, or a perturbation that changes within far less than a turn. Say order and dt."
        )
    return best[1], best[0]


def _apart(one: tuple[Array, ...], other: tuple[Array, ...]) -> float:
    """The largest difference of a component of a lane, relative to its largest entry."""
    with np.errstate(all="ignore"):
        apart = [np.where((x == y).all(-1), 0, size(x - y) / size(y)) for x, y in zip(one, other, strict=True)]
    found = float(np.max(apart))
    return found if np.isfinite(found) else np.inf
