"""What makes a run another motion than the one that was meant, warned of before it begins."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator

import numpy as np

from kreisel.errors import AccuracyWarning, doubt
from kreisel.record.calling import call
from kreisel.runs.plan import Plan

CLOSED = ("exact", "dop853", "splitting")  # their steps may be long: the fast motion is solved within a step
GOOD = 0.1  # rad a step


def warn_of(plan: Plan) -> None:
    """Warns of steps beyond half a turn and of moments that no body has (`AccuracyWarning`), and of doubtful input."""
    for sentence in (*_long_step(plan), *_no_body(plan)):
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


def _no_body(plan: Plan) -> Iterator[str]:
    alpha = plan.model.params.get("alpha") if plan.model.n == 3 else None
    if alpha is not None and plan.model.system.perturbation is None and not ((alpha > 0) & (alpha <= 2)).all():
        yield (
            f"alpha = {float(np.max(alpha) if np.min(alpha) > 0 else np.min(alpha)):g}: a body has 0 < alpha = "
            "I_axial/I_transverse <= 2, since no moment is more than the sum of the other two. The equations are "
            "solved all the same."
        )
