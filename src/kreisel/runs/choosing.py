"""order="auto": the order and the step that reach a tolerance, chosen before a run."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.errors import AccuracyWarning, InputError
from kreisel.kernels import layout
from kreisel.method import find, scheme
from kreisel.record.model import Model, State
from kreisel.runs.plan import default, initial_parts, planned
from kreisel.runs.settings import Settings, checked_state, initial_orientation

if TYPE_CHECKING:
    from kreisel.method.auto import Choice
    from kreisel.method.auto_splitting import Pilot
    from kreisel.record.model import OrientationLike, StateLike

MOST_CHOSEN = 10**6  # steps in a dt that was asked for
CHAOTIC = (
    "order='auto': expected an error that grows like the time, got a motion whose neighbours part much faster, as in "
    "chaos: the error at the end may be far larger than tol = {tol:g}. What such a motion does on average is still "
    "right; its state is known for a shorter time."
)
MISSED = (
    "order='auto': expected an error of at most tol = {tol:g}, got {expected:.1g} with the best steps of those tried "
    "in a run longer than the pilots. Use a larger tol, or say order and dt."
)


def choices(
    model: Model, x0: StateLike, settings: Settings, orientation: OrientationLike | None = None
) -> list[Choice]:
    """order="auto" for each lane of an ensemble by itself.  Raises `InputError`."""
    return choice_of(model, checked_state(model, x0), settings, orientation, each=True)


def choice_of(
    model: Model, state: State, settings: Settings, orientation: OrientationLike | None, each: bool
) -> list[Choice]:
    """The same from a checked state; without `each` one for all lanes.

    Raises `InputError`, and warns with `AccuracyWarning` where the motion looks chaotic.
    """
    from kreisel.method import auto, auto_splitting

    method, parts = settings.method or default(model, settings), initial_parts(model, state, None)
    when = settings.every * settings.dt, settings.time, settings.tol
    if method not in ("baecklund", "splitting"):
        raise InputError(
            "order='auto' chooses among the orders of method='baecklund' or 'splitting', which this run does not use."
        )
    find(method).check(model)
    if method == "baecklund":
        return auto.choose_each(model, parts, *when) if each else [auto.choose(model, parts, *when)]
    lanes = auto.with_lanes(model, parts)
    if not each or len(lanes[0]) == 1:
        steps, rate = pilot(model, state, settings, orientation), auto_splitting.rate_of(model, parts)
        choice = auto_splitting.witnessed(steps, auto_splitting.choose(steps, rate, *when), rate, *when)
        beside = pilot(model, state, settings, orientation, auto_splitting.NUDGE)
        chaotic = auto_splitting.separates(steps, beside, choice, rate, *when[:2])
        if chaotic and auto_splitting.within_reach(rate, settings.time):
            choice, chaotic = auto_splitting.witnessed(steps, choice, rate, *when, chaotic=True), False
        if chaotic:
            warnings.warn(CHAOTIC.format(tol=settings.tol), AccuracyWarning, stacklevel=8)
        elif choice.expected > (settings.tol or 0):
            said = MISSED.format(tol=settings.tol, expected=choice.expected)
            warnings.warn(said, AccuracyWarning, stacklevel=8)
        return [choice]
    out = []
    for i in range(len(lanes[0])):
        one = {letter: part[i : i + 1] for letter, part in zip(model.system.space.letters, lanes, strict=True)}
        g = None if orientation is None else initial_orientation(orientation, model)
        g = g if g is None or g.ndim == (1 if model.n == 3 else 2) else g[i]
        out += choice_of(model.lanes(np.array([i])), model.state(**one), settings, g, each=False)
    return out


def pilot(
    model: Model,
    state: State,
    settings: Settings,
    orientation: OrientationLike | None,
    nudge: float = 0.0,
    project: bool = False,
) -> Callable[..., Pilot | None]:
    """Steps of splittings from the start, or from a neighbouring state: (order, h, count) -> `Pilot`.

    Without `project` nothing is projected onto what is conserved.
    """
    from kreisel.method.auto_splitting import Pilot

    momentum, *carried = initial_parts(model, state, orientation)
    parts = (momentum * (1 + nudge), *carried)

    def steps(order: Any, h: float, count: int) -> Pilot | None:
        try:
            made = scheme(model, "splitting", h, order, orientation is not None)
        except InputError:  # an order that a force does not have
            return None
        asked = settings.but(
            dt=h, steps=count, every=count, order=order, tol=None, project=project, engine=None, times=None
        )
        plan = planned(model, made, asked, parts, None)
        out = np.empty((1, *plan.first.shape))
        plan.engine.advance(out, count)
        z = layout.restore(plan.corrections[1](out)[0], plan.kinds, model.n)
        if made.guard is not None and not (made.component(z, made.guard.component) <= made.guard.limit).all():
            return None
        own = tuple(layout.flatten((z[i],), plan.kinds[i : i + 1]) for i in range(len(parts)))
        if not all(np.isfinite(part).all() for part in own):
            return None
        row = 0 if made.corrector is None else made.by(made.corrector.out).stage_count
        work = getattr(plan.engine, "work", 1.0)
        return Pilot(own, made.stage_count * work, row * work)

    return steps


def with_choice(choice: Choice, settings: Settings) -> Settings:
    """The settings of a run with this choice; rows are saved at the same times.  Raises `InputError`."""
    every = settings.every
    if choice.steps > MOST_CHOSEN * every:
        raise InputError(
            f"order='auto': expected a motion that {MOST_CHOSEN:,} steps in a dt resolve, got one that needs "
            f"{choice.steps // every:,}. Usual cause: a state or parameters far larger than meant. If they are right, "
            "use a smaller dt and every=..., or say order and dt."
        )
    return settings.but(
        dt=every * settings.dt / choice.steps,
        steps=settings.steps // every * choice.steps,
        every=choice.steps,
        method=choice.method,
        order=choice.order,
        tol=None,
    )
