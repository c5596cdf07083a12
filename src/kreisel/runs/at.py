"""kr.at: the state at arbitrary times, where the flow or the iterates of a map are known in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.method import default_method, find, scheme
from kreisel.method.observing import ORIENTATION
from kreisel.method.scheme import Jump
from kreisel.record.lanes import in_lane
from kreisel.runs.describing import in_memory
from kreisel.runs.plan import Plan, initial_parts, planned
from kreisel.runs.settings import (
    Settings,
    check_model,
    checked_state,
    named,
    observed,
    positive_number,
    wanted_times,
    whole_order,
)

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

    from kreisel.kernels.exact.engine import ClosedForm
    from kreisel.record.model import Model, OrientationLike, StateLike


@explained
def at(
    system: Model,
    x0: StateLike,
    times: ArrayLike,
    *,
    method: str = "exact",
    dt: float | None = None,
    order: int | None = None,
    orientation: OrientationLike | None = None,
    observe: Sequence[str] | None = None,
) -> xr.Dataset:
    """The states at the given times, in any order, negative ones too, each to full double precision.

    system       the Lagrange top, n = 3, `kr.LagrangeTop`, `kr.LagrangeTopMoving` or `kr.SymmetricTop`, or a free body,
                 `kr.EulerTop`, with parameters
    x0           the state at time 0 as for `kr.simulate`; a batch axis in front makes an ensemble
    times        a number, or numbers (times,): doubles are taken as exact, and so are the state and the parameters
    method       "exact": the flow.  "suris": the iterates of the paper's map with step dt and its order, 1 or 2 as in
                 `kr.simulate`, for `kr.LagrangeTop` and `kr.SymmetricTop`; `times` then count steps, whole numbers
    orientation  g at time 0, as for `kr.simulate`, carried along as the variable g; for the flow
    observe      Casimirs and integrals to compute beside the state, by name; default: all

    No step is made and no error grows with time, but that of the orientation of a gyrostat (docs/exact.md): 10^12
    nutation periods on, a state is as exact as after one.  Up to
    10^4 times of the flow are compiled jumps of some microseconds, set-up and all, off by 3e-16, at most 3e-15; so are
    ensembles.  Motions of tops near a separatrix, more times and iterates are set up in many digits, 0.1 to 0.2 s a
    motion, 0.05 s of a free body, beside the critical sleeping top 0.6 s, then a microsecond a time.  Returns the
    `xarray.Dataset` of `kr.simulate`, with the coordinate time as given, or k dt.  Raises `InputError` for other
    systems, n > 3, bad times, and `RunError` where numbers overflow.
    """
    wanted = wanted_times(times)
    flat = np.atleast_1d(wanted)
    if (dt is None) != (named(method, "method") == "exact"):
        raise InputError(
            f"method={shown(method)} {'has no step: leave dt out' if dt is not None else 'needs a step dt'}."
        )
    step = 1.0 if dt is None else positive_number(dt, "dt")
    if dt is not None and not (flat == np.floor(flat)).all():
        raise InputError("The times of a map are its steps, whole numbers k for the time k dt, got others.")
    reach = float(abs(flat).max(initial=0))
    asked: dict[str, Any] = {
        "method": method,
        "dt": step,
        "order": order,
        "orientation": orientation,
        "observe": observe,
    }
    plan, engine = plan_of_times(system, x0, reach=reach, **asked)
    with np.errstate(all="ignore"):
        states = _continued(plan, plan.observe(engine.at(flat)), flat)
    for name, value in states.items():
        if not np.isfinite(value).all():
            lanes = value.shape[1] if plan.batched else 1
            where = in_lane(~np.isfinite(value.reshape(len(value), lanes, -1)).all((0, 2)))
            raise RunError(f"{name} is not finite{where}: its powers leave the range of doubles. Use other units.")
    with np.errstate(all="ignore"):
        run = in_memory(plan, [states], wanted * step)
    for name in ("dt", "every"):  # no steps were made, and the rows need not be evenly spaced
        del run.attrs[name]
    return run


def _continued(plan: Plan, states: dict[str, Array], times: Array) -> dict[str, Array]:
    """The states with quaternions that keep their sign in the order of time, if they are jumps of a top."""
    orbits = plan.scheme.orbits
    if ORIENTATION in states and orbits is not None and isinstance(orbits.jump, Jump):
        states[ORIENTATION] = algebra.continued(states[ORIENTATION], times)
    return states


def plan_of_times(
    model: Model,
    x0: StateLike,
    *,
    reach: float,
    method: str,
    dt: float,
    order: int | None,
    orientation: OrientationLike | None,
    observe: Any = None,
) -> tuple[Plan, ClosedForm]:
    """A plan without steps and its engine, which knows the states up to |time| = reach.  Raises `InputError`."""
    from kreisel.kernels.exact.engine import ClosedForm

    check_model(model)
    state = checked_state(model, x0)
    record, oriented = find(named(method, "method")), orientation is not None
    if not record.applies(model):
        raise InputError(_without(model, record.name, oriented))
    made = scheme(model, record.name, dt, whole_order(order), oriented)
    if made.orbits is None:
        raise InputError(_without(model, record.name, oriented))
    settings = Settings(dt=dt, steps=0, method=method, order=order, observe=observed(observe, made))
    plan = planned(model, made, settings, initial_parts(model, state, orientation), "cpu")
    engine = ClosedForm(plan.scheme, plan.first, dt, reach)
    plan.engine = engine
    return plan, engine


def _without(model: Model, method: str, oriented: bool) -> str:
    """That there is no closed form, and what there is for this system."""
    exact = find("exact")
    known = exact.applies(model) and scheme(model, "exact", 1.0, None, oriented).orbits is not None
    if method != "exact" and known:
        way = "method='exact' knows its flow: kr.at(system, x0, times)."
    else:
        way = (
            f"Steps of method={default_method(model, stepped=True)!r} reach the same times: kr.simulate(system, x0, "
            "dt=..., times=[...]), in order and from 0 on."
        )
    also = " and an orientation" * oriented
    return f"kr.at: no closed form of method={method!r} is known for {model.system.name}, n = {model.n}{also}. {way}"
