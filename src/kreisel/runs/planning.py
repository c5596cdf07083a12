"""Settings, a model and a state made a plan: everything that can be checked before the first step is checked here."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from kreisel.method import scheme
from kreisel.method.reference import with_tolerance
from kreisel.record.model import Model, State
from kreisel.runs.breaks import broken_by
from kreisel.runs.choosing import choice_of, with_choice
from kreisel.runs.plan import Plan, default, initial_parts, planned
from kreisel.runs.settings import Settings, check_model, checked_state, observed, whole_order, within_tolerances

if TYPE_CHECKING:
    from kreisel.record.model import OrientationLike, StateLike


def make_plan(model: Model, x0: StateLike, *, orientation: OrientationLike | None = None, **asked: Any) -> Plan:
    """The plan of a run with these settings.  Raises `InputError`."""
    check_model(model)
    return plan_of(model, x0, Settings.checked(**asked), orientation)


def plan_of(model: Model, x0: StateLike, settings: Settings, orientation: OrientationLike | None = None) -> Plan:
    """Check everything that can be checked before the first step.  Raises `InputError`."""
    state = checked_state(model, x0)
    if settings.order == "auto":
        return _chosen(model, state, settings, orientation)
    method = settings.method or default(model, settings)
    made = scheme(model, method, settings.dt, whole_order(settings.order), orientation is not None)
    if settings.tol is not None:
        made = with_tolerance(made, within_tolerances(settings.tol))
    observed(settings.observe, made)
    return broken_by(planned(model, made, settings, initial_parts(model, state, orientation), settings.engine))


def _chosen(model: Model, state: State, settings: Settings, orientation: OrientationLike | None) -> Plan:
    """order="auto": the plan with the order and the step that reach `tol`; rows are saved at the same times."""
    (choice,) = choice_of(model, state, settings, orientation, each=False)
    plan = plan_of(model, state, with_choice(choice, settings), orientation)
    chosen = {"tol": float(settings.tol or 0), "expected_error": choice.expected}
    return replace(plan, scheme=replace(plan.scheme, options={**plan.scheme.options, **chosen}))
