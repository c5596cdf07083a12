"""What makes a run another motion than the one that was meant, warned of before it begins."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import AccuracyWarning, doubt
from kreisel.method.observing import ORIENTATION
from kreisel.record.calling import call
from kreisel.record.model import State
from kreisel.runs.choosing import pilot
from kreisel.runs.plan import Plan
from kreisel.runs.settings import of_forces

CLOSED = ("exact", "dop853", "splitting")  # their steps may be long: the fast motion is solved within a step
GOOD = 0.1  # rad a step
MOST_REPEATED = 2000  # steps of a run that has failed
TRIED, APART, HALVINGS = 4, 0.01, 12  # steps from the start; how far they may be from half steps; tries
MOST_NUMBERS = 10**5  # of the state of an ensemble of which steps are tried
LONG_KICK = (
    "a step too long for its kicks, in which a torque, a force or a potential changes the motion by much (with dt = "
    "{h:.2g} it goes on). Use that or order='auto' with tol=..., which chooses the step."
)


def warn_of(plan: Plan) -> None:
    """Warns of steps too long for the motion or its forces, of moments that no body has, and of doubtful input."""
    for sentence in (*_long_step(plan), *_long_kick(plan), *_no_body(plan)):
        warnings.warn(sentence, AccuracyWarning, stacklevel=4)
    if plan.model.system.doubts is not None:
        for sentence in call(plan.model.system.doubts, (), plan.model.params):
            doubt(sentence)


def rate(plan: Plan) -> float:
    """Radians in a unit of time at the start: the largest |Omega| of the lanes, or |z'|/|z| where that is larger."""
    model, found = plan.model, [0.0]
    state = tuple(plan.start[letter] for letter in model.system.space.letters)
    with np.errstate(all="ignore"):
        if model.system.velocity is not None:
            found.append(float(np.max(np.abs(model.call(model.system.velocity, *state)))))
        if model.system.perturbation is None and model.system.flow is not None:
            size = max(float(np.max(np.abs(part), initial=0.0)) for part in state)
            found += [float(np.max(np.abs(part), initial=0.0)) / size for part in model.flow(*state)] if size else []
    return max(value for value in found if math.isfinite(value))


def _long_step(plan: Plan) -> Iterator[str]:
    if plan.scheme.name in CLOSED or "expected_error" in plan.scheme.options:  # order="auto" has measured its step
        return
    turn = plan.dt * rate(plan)
    if turn > math.pi:
        yield (
            f"dt = {plan.dt:g} is {turn:.3g} rad of this motion in a step, more than half a turn: the rows are those "
            f"of the map, and say little of the motion between them. Use a dt of {GOOD * plan.dt / turn:.1g} or so."
        )


def _long_kick(plan: Plan) -> Iterator[str]:
    """Of a splitting a few steps from the start against half steps: whatever it is that they are too long for."""
    if plan.scheme.name != "splitting" or "expected_error" in plan.scheme.options or plan.first.size > MOST_NUMBERS:
        return
    steps, count = _steps(plan), min(TRIED, plan.steps)

    def apart(h: float, count: int) -> float:
        return _apart(plan, steps(h, count), steps(h / 2, 2 * count))

    found = apart(plan.dt, count)
    if found <= APART:
        return
    tried = f"step{'s' * (count > 1)} from the start"
    fault = f"{count} {tried} and {2 * count} of half the length differ by {found:.2g} of the state"
    for halving in range(1, HALVINGS + 1):
        h = plan.dt / 2**halving
        if apart(h, count * 2**halving) <= APART / 10:
            yield (
                f"dt = {plan.dt:g} is too long for the forces or for this motion: "
                f"{fault if math.isfinite(found) else f'{count} {tried} fail'}. Usual cause: a torque, a force or a "
                "potential that changes the motion by much within a step, or a body that rotates by radians in it. "
                f"Use a dt of {h:.2g} or so, or order='auto' with tol=..., which chooses it."
            )
            return


def cause_of_no_numbers(plan: Plan, step: int) -> str:
    """The usual cause of a state that is not finite at a step: of a splitting, whether shorter steps get there."""
    if plan.scheme.name == "splitting" and step <= MOST_REPEATED:
        steps = _steps(plan)
        for halving in (3, 6):
            if steps(plan.dt / 2**halving, step * 2**halving) is not None:
                return LONG_KICK.format(h=plan.dt / 2**halving)
    return (
        f"{of_forces(plan.model)}a step far too long, or a state so large that its square overflows. Use a smaller dt."
    )


def _steps(plan: Plan) -> Callable[[float, int], tuple[Array, ...] | None]:
    """(h, count) -> the components after some steps of the length h from the start; None if they are not finite."""
    space = plan.model.system.space
    state = State({letter: plan.start[letter] for letter in space.letters}, dict(space.components))
    run = pilot(plan.model, state, plan.settings, plan.start.get(ORIENTATION), project=plan.settings.project)

    def steps(h: float, count: int) -> tuple[Array, ...] | None:
        with np.errstate(all="ignore"):
            found = run(plan.scheme.options["order"], h, count)
        return None if found is None else found.state

    return steps


def _apart(plan: Plan, one: tuple[Array, ...] | None, other: tuple[Array, ...] | None) -> float:
    """The largest difference of a component, relative to its largest entry in all lanes and at the start."""
    if one is None or other is None:
        return math.inf
    found, before = [0.0], list(plan.start.values())
    with np.errstate(all="ignore"):
        for x, y, start in zip(one, other, before, strict=False):
            apart, size = np.max(abs(x - y)), max(np.max(abs(y)), np.max(abs(start)))
            found.append(float(apart / size) if apart else 0.0)
    return max(value if math.isfinite(value) else math.inf for value in found)


def _no_body(plan: Plan) -> Iterator[str]:
    alpha = plan.model.params.get("alpha") if plan.model.n == 3 else None
    if alpha is not None and plan.model.system.perturbation is None and not ((alpha > 0) & (alpha <= 2)).all():
        yield (
            f"alpha = {float(np.max(alpha) if np.min(alpha) > 0 else np.min(alpha)):g}: a body has 0 < alpha = "
            "I_axial/I_transverse <= 2, since no moment is more than the sum of the other two. The equations are "
            "solved all the same."
        )
