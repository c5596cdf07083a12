"""kr.at and kr.nutation: states at arbitrary times and figures of a top, in closed form, without a simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.exact.motion import TopMotion
from kreisel.exact.nutation import Integrals, MpNumber, Nutation, mp_number
from kreisel.method import default_method, find, scheme
from kreisel.method.conjugate import has_points
from kreisel.method.exact import motion_of_top
from kreisel.record.body import Body, as_body
from kreisel.record.values import in_lane
from kreisel.runs.describing import in_memory
from kreisel.runs.geometry import presented
from kreisel.runs.in_si import scaled, state_of, times_of
from kreisel.runs.plan import Plan, initial_parts, is_finite, planned
from kreisel.runs.planning import idle_or_new
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

    from kreisel.record.model import Model, OrientationLike, StateLike


NO_STEP = 2.0**-60  # of the flow, which makes none: a long step of a fast gyrostat would need too many maps


@explained
def at(
    system: Model | Body,
    x0: StateLike,
    times: Any,
    *,
    method: str = "exact",
    dt: float | None = None,
    order: int | None = None,
    orientation: OrientationLike | None = None,
    observe: Sequence[str] | None = None,
) -> xr.Dataset:
    """The states at the given times, in any order, also negative, each to full double precision.

    system       a Lagrange top, n = 3, `kr.LagrangeTop`, `kr.LagrangeTopMoving`, `kr.SymmetricTop`, a free body or
                 gyrostat, `kr.EulerTop`, `kr.ZhukovskyVolterra`; or a body of `kr.physical`: times in s, result in SI
    x0           the state at time 0 as for `kr.simulate`; a batch axis in front makes an ensemble
    times        one time or several (times,): doubles count as exact, and so do the state and the parameters
    method       "exact": the flow.  "suris": the iterates of the paper's map with step dt and its order, 1 or 2 as in
                 `kr.simulate`, for `kr.LagrangeTop` and `kr.SymmetricTop`; `times` then count steps (integers)
    orientation  g at time 0, as for `kr.simulate`, carried along as the variable g; for the flow
    observe      Casimirs and integrals to compute in addition to the state, by name; default: all

    No steps are made, and no error grows with time except for the orientation of a gyrostat (docs/exact.md): after
    10^12 nutation periods a state is as exact as after one.  The states of tops and free bodies are compiled jumps, of
    less than a microsecond each, with errors of 3e-16, at most 3e-15.  Motions of tops near a separatrix, gyrostats and
    iterates are set up in many digits: 0.1 to 0.2 s per motion, 0.05 s for a free body, 0.6 s near the critical
    sleeping top; then a microsecond per time.  Returns the `xarray.Dataset` of `kr.simulate`,
    with the coordinate time as given, or k dt.  Raises `InputError` for other systems, n > 3, bad times, and `RunError`
    if values overflow.
    """
    model, x0, orientation, when, _ = scaled(system, x0, orientation, {"dt": 1.0 if dt is None else dt})
    if model is not system:  # a body
        times, dt = (times_of(model, times), None) if dt is None else (times, when["dt"])
    wanted = wanted_times(times)
    flat = np.atleast_1d(wanted)
    if (dt is None) != (named(method, "method") == "exact"):
        raise InputError(
            f"method={shown(method)} {'has no step: leave dt out' if dt is not None else 'needs a step dt'}."
        )
    step = 1.0 if dt is None else positive_number(dt, "dt")
    if dt is not None and not (flat == np.floor(flat)).all():
        raise InputError("The times of a map are its steps, integers k for the time k dt, got others.")
    from kreisel.kernels.exact.engine import ClosedForm

    asked: dict[str, Any] = {"method": method, "dt": step if dt else NO_STEP, "order": order, "observe": observe}
    plan, idle = idle_or_new(_plan_of_times, model, x0, orientation, asked)
    plan.engine = ClosedForm(plan.scheme, plan.first, step, float(abs(flat).max()))
    with np.errstate(all="ignore"):
        states = plan.observe(plan.engine.at(flat))
    _require_finite(plan, states)
    with np.errstate(all="ignore"):
        run = in_memory(plan, [states], wanted * step)
    for name in ("dt", "every"):  # no steps were made, and the rows need not be evenly spaced
        del run.attrs[name]
    if plan.repeatable:
        idle.append(plan)
    return presented(run, plan.model)


def _require_finite(plan: Plan, states: dict[str, Array]) -> None:
    for name in [name for name, value in states.items() if not is_finite(value)]:
        bad = ~np.isfinite(states[name].reshape(-1, plan.lanes, states[name][0].size // plan.lanes)).all((0, 2))
        raise RunError(f"{name} is not finite{in_lane(bad)}: its powers leave the range of doubles. Use other units.")


def _plan_of_times(
    model: Model, x0: StateLike, orientation: OrientationLike | None, method: str, dt: float, order: Any, observe: Any
) -> Plan:
    check_model(model)
    state = checked_state(model, x0)
    record, oriented = find(named(method, "method")), orientation is not None
    chosen = scheme(model, record.name, dt, whole_order(order), oriented) if record.applies(model) else None
    if chosen is None or chosen.orbits is None:
        exact = find("exact")
        has_flow = exact.applies(model) and scheme(model, "exact", 1.0, None, oriented).orbits is not None
        if record.name != "exact" and has_flow:
            way = "method='exact' knows its flow: kr.at(system, x0, times)."
        else:
            exactly = has_points(model) and not (oriented and model.system.exact_map is not None)
            steps = "exact" if exactly else default_method(model, stepped=True)
            way = (
                f"Steps of method={steps!r} reach the same times: kr.simulate(system, x0, "
                f"{'method=' + repr(steps) + ', ' if exactly else ''}dt=..., times=[...]), in order and from 0 on."
            )
        raise InputError(
            f"kr.at: no closed form of method={record.name!r} is known for {model.system.name}, n = {model.n}"
            f"{' and an orientation' * oriented}. {way}"
        )
    settings = Settings(dt=dt, steps=0, method=method, order=order, observe=observed(observe, chosen))
    return planned(model, chosen, settings, initial_parts(model, state, orientation), "cpu")


@dataclass(frozen=True)
class Figures:
    """Physical figures of one motion of the Lagrange top, n = 3, in the system's units.

    kind        "nutating": the axis goes up and down, if it does not swing through the vertical;
                "steady": its height is constant, and stable: a small disturbance causes a small nutation;
                "free": without gravity, the axis goes round m in one period;
                "sleeping, critical": upright with just the spin that keeps it there, (alpha spin)^2 = 4 |a||p|;
                "sleeping, unstable": upright with less; "falling asleep": upright after an infinite time
    period      of nutation, 2 omega_1; of the small nutations about a steady motion; infinite for the last three
    lowest      least <a, p> (rest frame) or <P, A> (moving frame): |a||p| times the cosine of the tilt
    highest     greatest; for "falling asleep" never reached
    precession  the angle by which the axis goes round p in one period, right-handed about p, with multiples of 2 pi.
                If the axis goes exactly through +p or -p its azimuth jumps by pi, which is not counted.  NaN if the
                axis stays on the vertical, without gravity, or if the period is infinite
    spin        angular velocity of the body about its axis, constant: <m, a>/(alpha |a|), axial m
    """

    kind: str
    period: float
    lowest: float
    highest: float
    precession: float
    spin: float

    @property
    def mean_precession(self) -> float:
        """The mean angular velocity of the axis about p."""
        return self.precession / self.period


@explained
def nutation(system: Model | Body, x0: StateLike) -> Figures:
    """The figures of the motion through x0, for `kr.LagrangeTop`, `kr.LagrangeTopMoving`, `kr.SymmetricTop`, n = 3.

    For `kr.physical.Gyroscope` the period is in s, the spin in rad/s, lowest and highest are cosines of the tilt.

    From the closed form in extended digits.  The given doubles count as exact: a motion is steady or on a separatrix if
    they make it exactly so.  Raises `InputError` for other systems, n > 3 and ensembles.
    """
    body, unit, model = as_body(system), 1.0, cast("Model", system)
    if body is not None:
        model = body.in_si()
        x0 = state_of(body, model, x0)[0]
        unit = model.body_frame.time_unit
    check_model(model)
    if model.system.closed_form.top is None or model.n != 3:
        raise InputError(f"kr.nutation is for Lagrange tops with n = 3, got {model.system.name}, n = {model.n}.")
    parts = tuple(checked_state(model, x0).values())
    if model.batch or parts[0].ndim > 2 or parts[1].ndim > 1:
        raise InputError("kr.nutation needs one motion, got an ensemble. Pass one lane at a time.")
    try:
        motion = motion_of_top(model, parts, model.constants, reach=0.0)
        kind, integrals, ctx, (x1, x2, _) = _kind(motion), motion.integrals, motion.nutation.ctx, motion.nutation.x
        height, alpha = mp_number(ctx, integrals.E), ctx.convert(float(model.constants.get("alpha", 1.0)))
        return Figures(
            kind=kind,
            period=math.inf if integrals.separatrix else float(2 * motion.nutation.half_period) * unit,
            lowest=float((x2 if kind.startswith("sleeping") else x1) / 2 + height),
            highest=float(x2 / 2 + height),
            precession=float(_precession(ctx, integrals)),
            spin=float(mp_number(ctx, integrals.J) / ctx.sqrt(mp_number(ctx, integrals.A)) / alpha) / unit,
        )
    except ZeroDivisionError:
        raise InputError(
            "expected a motion whose period a double can hold, got a slower one. Use other units."
        ) from None


def _kind(motion: TopMotion) -> str:
    integrals = motion.integrals
    if integrals.P2 == 0:
        return "free"
    if integrals.coincident is None:
        return "nutating"
    x1, x2, x3 = integrals.coincident
    if x2 < x3:
        return "steady"
    if x1 == x3:
        return "sleeping, critical"
    return "falling asleep" if math.isfinite(motion.e_foldings()) else "sleeping, unstable"


def _precession(ctx: Any, integrals: Integrals) -> MpNumber:
    """The integral of |p| (c A - z J)/(A P2 - z^2) over a period, in two complete integrals of the third kind.

    z = z1 + (z2 - z1) sn^2 splits it into 1/(|b||p| - z) and 1/(|b||p| + z); a pole on the orbit has the weight 0.  If
    the orbit passes close to a pole, the distance is computed in more digits.
    """
    if integrals.P2 == 0 or integrals.separatrix:
        return ctx.nan
    vertical = integrals.c**2 * integrals.A == integrals.J**2 * integrals.P2  # the orbit reaches +p, -p, or both
    pole = abs(integrals.c) * ((integrals.J > 0) - (integrals.J < 0))
    signs = [sign for sign in (1, -1) if not vertical or integrals.c * sign != pole]
    digits = ctx.dps
    while True:
        x1, x2, x3 = Nutation(ctx, integrals).x
        A, J, c, E = (mp_number(ctx, v) for v in (integrals.A, integrals.J, integrals.c, integrals.E))
        top_most, low, swing = ctx.sqrt(mp_number(ctx, integrals.A * integrals.P2)), x1 / 2 + E, (x2 - x1) / 2
        closest = min((top_most - sign * (low if sign < 0 else low + swing) for sign in signs), default=top_most)
        if closest > top_most * ctx.mpf(10) ** (-ctx.dps // 2):
            break
        ctx.dps *= 2
    m, weights = (x2 - x1) / (x3 - x1), [(c * A / top_most - sign * J) / 2 for sign in signs]
    gaps = [top_most - sign * low for sign in signs]
    poles = [sign * swing / gap for sign, gap in zip(signs, gaps, strict=True)]
    ctx.dps = digits
    total = sum(w / gap * ctx.ellippi(n, m) for w, gap, n in zip(weights, gaps, poles, strict=True))
    if vertical and x1 == x2:
        return ctx.nan  # asleep or hanging
    return 4 * ctx.sqrt(mp_number(ctx, integrals.P2)) / ctx.sqrt(x3 - x1) * total
