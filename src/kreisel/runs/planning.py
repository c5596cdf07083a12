"""A plan from settings, a model and a state: checks, order="auto", warnings of doubtful input, the cost of its run."""

from __future__ import annotations

import math
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.errors import AccuracyWarning, InputError, InputWarning, doubt, shown
from kreisel.graph.recording import STRAIGHT_LINE_N, STRAIGHT_LINES
from kreisel.kernels.cpu import CpuEngine
from kreisel.kernels.engines import Engine
from kreisel.method import find, scheme
from kreisel.method.scheme import ORIENTATION, Orbits, with_lanes, with_orientation
from kreisel.process import duration_text, size_text
from kreisel.record.calling import call
from kreisel.record.model import Model, State
from kreisel.record.table import require_within
from kreisel.runs.plan import Plan, default, initial_parts, planned
from kreisel.runs.settings import (
    Event,
    Settings,
    check_model,
    checked_state,
    finite_number,
    initial_orientation,
    observed,
    of_forces,
    whole_order,
)

if TYPE_CHECKING:
    from kreisel.method.auto import Choice, Pilot
    from kreisel.record.model import OrientationLike, StateLike

PLAIN, LISTS = (int, float, str, bool, type(None), np.float64), (tuple, list)  # of settings that an idle plan has
LEAST_TOLERANCE = 1e-13  # of DOP853 in doubles
IDLE = 4  # plans kept for each choice of settings
# Compressed size of a Lagrange top's rows: the state 0.96, Casimirs and integrals 0.06.  A run is refused if the disk
# has no room for half of the bytes of its states.
OF_STATES, OF_INTEGRALS, LEAST = 0.96, 0.06, 0.5
SECONDS_A_BYTE = 13e-9  # to compress and write; 75 MB a second, a core of a busy machine
PILOT_SECONDS = 0.05
PILOT_ROWS = 256


def make_plan(
    model: Model,
    x0: StateLike,
    *,
    orientation: OrientationLike | None = None,
    events: tuple[Event, ...] = (),
    **asked: Any,
) -> Plan:
    """The plan of a run with these settings and events.  Raises `InputError`."""
    check_model(model)
    plan = plan_of(model, x0, Settings.checked(**asked), orientation)
    return broken_by(plan, events) if events else plan


def _idle_plans(model: Any, oriented: bool, asked: Mapping[str, Any]) -> deque[Plan]:
    """Plans of earlier runs in memory, which a run with these settings may begin again; new and empty if none may."""
    values = [v for value in asked.values() for v in (value if type(value) in LISTS else (value,))]
    plain = all(type(v) in PLAIN and (type(v) is not int or v.bit_length() < 64) for v in values)
    if not isinstance(model, Model) or not plain or asked["order"] == "auto":
        return deque()
    return reused((Plan, model.key, oriented, repr(asked)), lambda: deque[Plan](maxlen=IDLE))


def idle_or_new(
    new: Callable[..., Plan], model: Model, x0: StateLike, orientation: Any, asked: Mapping[str, Any], kept: bool = True
) -> tuple[Plan, deque[Plan]]:
    """A plan with these settings, idle or new, and the idle ones, if plans are kept, to which it may be added later."""
    idle = _idle_plans(model, orientation is not None, asked) if kept else deque[Plan]()
    try:
        plan = idle.pop()
    except IndexError:
        return new(model, x0, orientation=orientation, **asked), idle
    parts = initial_parts(model, checked_state(model, x0, plan.settings.t_start), orientation)
    return plan if plan.begin(model, parts) else new(model, x0, orientation=orientation, **asked), idle


def plan_of(model: Model, x0: StateLike, settings: Settings, orientation: OrientationLike | None = None) -> Plan:
    """Check everything that can be checked before the first step.  Raises `InputError`."""
    state = checked_state(model, x0, settings.t_start)
    require_within(model, settings.t_start, settings.t_start + settings.time)
    if settings.order == "auto":
        return _chosen(model, state, settings, orientation)
    if model.system.perturbation is not None and model.system.perturbation.sampled:
        from kreisel.forces.control import whole_samples

        settings = settings.but(dt=whole_samples(model, settings.dt))
    method = settings.method or default(model, settings)
    chosen = scheme(model, method, settings.dt, whole_order(settings.order), orientation is not None)
    if settings.tol is not None:
        from kreisel.method.reference import with_tolerance

        tol = finite_number(settings.tol, "tol")
        if not LEAST_TOLERANCE <= tol <= 1:
            raise InputError(f"tol: expected a relative tolerance from {LEAST_TOLERANCE:g} to 1, got {shown(tol)}.")
        chosen = with_tolerance(chosen, tol)
    observed(settings.observe, chosen)
    return broken_by(planned(model, chosen, settings, initial_parts(model, state, orientation), settings.engine))


def broken_by(plan: Plan, events: tuple[Event, ...] = ()) -> Plan:
    """The plan with these events in addition to its impulses.  Raises `InputError` if its steps cannot be broken."""
    if not events and not plan.broken:
        return plan
    if plan.settings.t_start:
        raise InputError(f"t_start: expected 0 for a run with events, got {plan.settings.t_start:g}.")
    plan = replace(plan, events=events)
    from kreisel.runs.propagation.breaks import not_conserved

    return replace(plan, lost=not_conserved(plan))


def _chosen(model: Model, state: State, settings: Settings, orientation: OrientationLike | None) -> Plan:
    """order="auto": the plan with the order and the step that reach `tol`; rows are saved at the same times."""
    from kreisel.method.auto import USUAL_TOLERANCE

    (choice,) = choices(model, state, settings, orientation, every_lane=False)
    plan = plan_of(model, state, with_choice(choice, settings), orientation)
    chosen = {"tol": settings.tol or USUAL_TOLERANCE, "expected_error": choice.expected}
    return replace(plan, scheme=replace(plan.scheme, options={**plan.scheme.options, **chosen}))


MOST_CHOSEN = 10**6  # steps in a requested dt
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
    model: Model, x0: StateLike, settings: Settings, orientation: OrientationLike | None = None, every_lane: bool = True
) -> list[Choice]:
    """The choice of order="auto" for each lane separately; without `every_lane`, one choice for all lanes.

    Raises `InputError`, and warns with `AccuracyWarning` if the motion looks chaotic.
    """
    from kreisel.method import auto

    method, state = settings.method or default(model, settings), checked_state(model, x0)
    parts = initial_parts(model, state, None)
    if method not in ("baecklund", "splitting"):
        raise InputError(
            "order='auto' chooses among the orders of method='baecklund' or 'splitting', which this run does not use."
        )
    find(method).check(model)
    record = model.system.perturbation
    if record is not None and record.sampled:
        raise InputError(
            f"order='auto': expected a body without control, got {model.system.name}. Say order and dt: "
            "(2, 2) or (8, 6, 4), with a dt that divides the time between two samples."
        )
    if method == "baecklund":
        if model.system.baecklund is None:
            raise InputError(
                f"order='auto': expected a system whose maps have no constants to solve for, got {model.system.name}. "
                "Use method='exact', the flow itself, or an order from 2 to 24."
            )
        return auto.choose(model, parts, settings.every * settings.dt, settings.time, settings.tol, every_lane)
    _, lanes = with_lanes(model, parts, (1,))
    if every_lane and len(lanes[0]) > 1:
        out = []
        for i in range(len(lanes[0])):
            start = {letter: z[i : i + 1] for letter, z in zip(model.system.space.letters, lanes, strict=True)}
            g = None if orientation is None else initial_orientation(orientation, model)
            g = g if g is None or g.ndim == (1 if model.n == 3 else 2) else g[i]
            out += choices(model.lanes(np.array([i])), model.state(**start), settings, g, every_lane=False)
        return out
    return [_of_splitting(model, initial_parts(model, state, orientation), settings, len(lanes[0]))]


def _of_splitting(model: Model, parts: tuple[Array, ...], settings: Settings, lanes: int) -> Choice:
    """One order and step of splittings for all lanes, by pilots from the components of their start."""
    from kreisel.method import auto

    record, when = model.system.perturbation, (settings.every * settings.dt, settings.time, settings.tol)
    rate, tol = auto.rate_of(model, parts[: len(model.system.space.letters)]), settings.tol
    corners = record is not None and record.has_corners(model.constants)
    usual = tol is None and record is not None and record.environment is not None
    steps = _pilot(model, parts, settings)
    if corners or usual:
        tol = auto.USUAL_TOLERANCE if usual else auto.checked_tolerance(tol)
        choice, reached = auto.halved(steps, rate, *when[:2], tol, 2 if corners else 4, lanes, not usual)
        fault = "" if reached else MISSED
    else:
        choice = auto.choose_splitting(steps, rate, *when)
        choice = auto.witnessed(steps, choice, rate, *when)
        neighbour = _pilot(model, (parts[0] * (1 + auto.NUDGE), *parts[1:]), settings)
        chaotic = auto.separates(steps, neighbour, choice, rate, *when[:2])
        if chaotic and auto.within_reach(rate, settings.time):
            choice, chaotic = auto.witnessed(steps, choice, rate, *when, chaotic=True), False
        fault = CHAOTIC if chaotic else MISSED if choice.expected > (tol or 0) else ""
    if fault:
        doubt(fault.format(tol=tol, expected=choice.expected), AccuracyWarning)
    return choice


def _pilot(model: Model, parts: tuple[Array, ...], settings: Settings) -> Callable[..., Pilot | None]:
    """Steps of splittings from the components of a start: (order, h, count) -> `Pilot`.

    They are projected as the run is, so that they and the run have one kernel.
    """
    from kreisel.method.auto import Pilot

    def steps(order: Any, h: float, count: int) -> Pilot | None:
        try:
            chosen = scheme(model, "splitting", h, order, len(parts) > len(model.system.space.letters))
        except InputError:  # an order that a force does not have
            return None
        asked = settings.but(dt=h, steps=count, every=count, order=order, tol=None, engine=None, times=None)
        plan = planned(model, chosen, asked, parts, None)
        out = np.empty((1, *plan.first.shape))
        plan.engine.advance(out, count)
        z = algebra.restore(plan.corrections[1](out)[0], plan.kinds, model.n)
        if not chosen.guarded(z).all():
            return None
        end = tuple(algebra.flatten((z[i],), plan.kinds[i : i + 1]) for i in range(len(parts)))
        if not all(np.isfinite(component).all() for component in end):
            return None
        row = 0 if chosen.corrector is None else chosen.by(chosen.corrector.out).stage_count
        work = getattr(plan.engine, "work", 1.0)
        return Pilot(end, chosen.stage_count * work, row * work)

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


CLOSED = ("exact", "dop853", "splitting")  # their steps may be long: the fast motion is solved within a step
GOOD = 0.1  # rad a step
PATIENCE = 10.0  # seconds of a run on arrays, beyond which it is announced
MOST_REPEATED = 2000  # steps of a run that has failed
TRIED, APART, HALVINGS = 4, 0.01, 12  # steps from the start; how far they may be from half steps; tries
LOOKED = 60  # steps before a failure
MOST_NUMBERS, SAMPLE = 10**5, 32  # entries of a state that is judged as such; lanes of a larger ensemble
LONG_KICK = (
    "a step too long for its kicks, in which a torque, a force or a potential changes the motion by much (with dt = "
    "{h:.2g} it continues). Use that or order='auto' with tol=..., which chooses the step."
)


def warn_of(plan: Plan) -> None:
    """Warns of steps too long for the motion or its forces, of impossible moments of inertia, and of doubtful input."""
    for sentence, kind in doubts_of(plan):
        doubt(sentence, kind)


def doubts_of(plan: Plan) -> Iterator[tuple[str, type[Warning]]]:
    """The sentences of `warn_of` and their kinds."""
    sentences, said = [], plan.model.body_frame.time_text
    if plan.scheme.name not in CLOSED and "expected_error" not in plan.scheme.options:  # order="auto" has measured it
        turn = plan.dt * rate(plan)
        if turn > math.pi:
            sentences.append(
                f"dt = {said(plan.dt)} is {turn:.3g} rad of this motion in a step, more than half a revolution: the "
                "rows are states of the map, and show little of the motion between them. "
                f"Use a dt of {said(GOOD * plan.dt / turn, '.1g')} or so."
            )
    sample = _sample(plan)
    if sample is not None:
        sentences += _long_kick(sample)
        sentences += _fast_flows(sample)
    alpha = plan.model.params.get("alpha") if plan.model.n == 3 else None
    record = plan.model.system.perturbation
    if alpha is not None and not (record and record.inertia) and not ((alpha > 0) & (alpha <= 2)).all():
        sentences.append(
            f"alpha = {float(np.max(alpha) if np.min(alpha) > 0 else np.min(alpha)):g}: a body has 0 < alpha = "
            "I_axial/I_transverse <= 2, since no moment is more than the sum of the other two. The equations are "
            "solved all the same."
        )
    yield from ((sentence, AccuracyWarning) for sentence in sentences)
    checks = plan.model.system.checks
    for function in (checks.doubts, checks.idle):
        for sentence in call(function, (), plan.model.params) if function is not None else ():
            yield sentence, InputWarning


def warn_of_arrays(plan: Plan) -> None:
    """Warns with `InputWarning`, with the cost, of a long run whose step is not compiled."""
    engine = plan.engine
    step = engine.seconds_by_definition() if isinstance(engine, CpuEngine) else None
    seconds = (step or 0.0) * plan.steps * plan.lanes
    if step is not None and seconds > PATIENCE:
        doubt(
            f"A run of about {duration_text(seconds)}: method={plan.scheme.name!r} of {plan.model.system.name}, n = "
            f"{plan.model.n}, has no compiled step, and runs by its definition on arrays of NumPy, {1e3 * step:.2g} ms "
            f"a step of a lane. Compiled are steps of at most {STRAIGHT_LINES:,} operations for n <= "
            f"{STRAIGHT_LINE_N}, and beyond those with a form for engine='large'. Usual cause: a method or a "
            "user-defined system without that form. Choose another method (kr.methods()), a smaller n, or fewer steps."
        )


def rate(plan: Plan) -> float:
    """Radians per unit of time at the start: the largest |Omega| of the lanes, or |z'|/|z| if that is larger."""
    model, system, result = plan.model, plan.model.system, [0.0]
    state = tuple(plan.start[letter] for letter in system.space.letters)

    def largest(component: Array) -> float:
        return float(np.maximum.reduce(abs(component).ravel(), initial=0.0))

    with np.errstate(all="ignore"):
        if system.velocity is not None:
            result.append(largest(model.call(system.velocity, *state)))
        if system.perturbation is None and system.flow is not None:
            size = max(map(largest, state))
            result += [largest(component) / size for component in model.flow(*state)] if size else []
    return max(value for value in result if math.isfinite(value))


def _sample(plan: Plan) -> Plan | None:
    """The plan, or for large ensembles a plan of some lanes, among them the extremes of parameters, state and rates.

    None for a single large body, and for bodies that act on each other.
    """
    lanes, model = plan.lanes, plan.model
    if plan.first.size <= MOST_NUMBERS:
        return plan
    if lanes == 1 or plan.scheme.coupling is not None:
        return None
    arrays = [*model.params.values(), *plan.start.values()]
    if model.system.velocity is not None:
        with np.errstate(all="ignore"):
            arrays.append(model.call(model.system.velocity, *(plan.start[k] for k in model.system.space.letters)))
    sizes = [abs(z).reshape(lanes, -1).max(-1) for z in arrays if z.shape[:1] == (lanes,)]
    ids = np.unique([*np.linspace(0, lanes - 1, SAMPLE, dtype=int), *map(np.argmax, sizes), *map(np.argmin, sizes)])
    axes = {letter: algebra.KINDS[kind].axes for letter, kind in with_orientation(model, True)}
    start = {k: z[ids] if z.ndim > axes.get(k, z.ndim) else z for k, z in plan.start.items()}
    return replace(plan, model=model.lanes(ids), first=plan.first[ids], start=start)


def _long_kick(plan: Plan) -> Iterator[str]:
    """Comparison of a few steps of a splitting from the start with half steps, which shows steps that are too long."""
    if plan.scheme.name != "splitting" or "expected_error" in plan.scheme.options:
        return
    steps, count = _steps(plan), min(TRIED, plan.steps)
    said = plan.model.body_frame.time_text

    def apart(h: float, count: int) -> float:
        """The largest difference of a component, relative to its largest entry in all lanes and at the start."""
        coarse, fine, worst = steps(h, count), steps(h / 2, 2 * count), 0.0
        if coarse is None or fine is None:
            return math.inf
        with np.errstate(all="ignore"):
            for x, y, start in zip(coarse, fine, plan.start.values(), strict=False):
                off, size = np.max(abs(x - y)), max(np.max(abs(y)), np.max(abs(start)))
                relative = float(off / size) if off else 0.0
                worst = max(worst, relative if math.isfinite(relative) else math.inf)
        return worst

    result = apart(plan.dt, count)
    if result <= APART:
        return
    tried = f"step{'s' * (count > 1)} from the start"
    fault = f"{count} {tried} and {2 * count} of half the length differ by {result:.2g} of the state"
    for halving in range(1, HALVINGS + 1):
        h = plan.dt / 2**halving
        if apart(h, count * 2**halving) <= APART / 10:
            yield (
                f"dt = {said(plan.dt)} is too long for the forces or for this motion: "
                f"{fault if math.isfinite(result) else f'{count} {tried} fail'}. Usual cause: a torque, a force or a "
                "potential that changes the motion by much within a step, or a body that rotates by radians in it. "
                f"Use a dt of {said(h, '.2g')} or so, or order='auto' with tol=..., which chooses it."
            )
            return


# rad for one of the motion, by which a user who looks at it cannot judge dt.  Measured against DOP853, order 2: up to
# 1.5 errors are 1.4 times those expected of the motion, or less; 4 times at 2 to 2.5; 11 times at 3 to 4 (medians)
HIDDEN = 2.0
LOST, ALL = 0.1, 1.0  # rad at the end of a run; from ALL of the motion on, order and dt lose any motion
FASTER = 3e4  # from which `exact` has errors of 1e-11 to 1e-7 a radian, n = 4


def _fast_flows(plan: Plan) -> Iterator[str]:
    """Steps by flows that are far faster than the motion: too long for an order, or too many for `exact`."""
    if plan.scheme.inner_angle is None:
        return
    name, said = plan.model.system.name, plan.model.body_frame.time_text
    inner = plan.scheme.inner_angle(plan.model, tuple(plan.start[k] for k in plan.model.system.space.letters))
    turn, order = plan.dt * rate(plan), plan.scheme.options.get("order")
    cause = "Usual cause: moments, or components of the state, of very different sizes. "
    if order is None:
        if inner > FASTER * turn > 0:
            yield (
                f"method='exact' combines flows that rotate by {inner / turn:.2g} rad for each of this motion of "
                f"{name}: their rounding errors may reach 1e-8 a radian. {cause}Compare with method='dop853'."
            )
        return
    error, expected = (plan.steps * _pade_error(order, angle) for angle in (inner, turn))
    if turn > math.pi or inner <= min(math.pi, HIDDEN * turn):
        return
    if error > APART * plan.steps or (error > LOST and expected < ALL):
        h = plan.dt * min(1 / inner, (APART / error) ** (1 / order))
        yield (
            f"dt = {said(plan.dt)} is {turn:.2g} rad of this motion in a step, but {inner:.3g} rad of the flows of "
            f"{name} that method='baecklund' combines for it: {plan.steps:,} steps of order {order} lose about "
            f"{min(error, math.tau):.1g} rad of these, and the rows are states of another motion with the same "
            f"integrals. {cause}Use a dt of {said(h, '.1g')} or so, a higher order, or method='exact'."
        )


def _pade_error(order: int, angle: float) -> float:
    """The error of the diagonal Padé approximant of e^(i angle) of an even order, to the first term."""
    k = order // 2
    factorials = 2 * math.lgamma(k + 1) - math.lgamma(order + 1) - math.lgamma(order + 2)
    return math.exp(min(99.0, factorials + (order + 1) * math.log(angle))) if angle else 0.0


def _sensors_at_zero(plan: Plan, step: int, lane: int) -> list[str]:
    """Fields that a law reads and that vanish between the row before a step and this step."""
    record = plan.model.system.perturbation
    if record is None or record.control is None or record.environment is None:
        return []
    from kreisel.runs.geometry import surroundings_at

    steps = np.unique(np.linspace(max(0, step - plan.every), step, LOOKED, dtype=int))
    fields = surroundings_at(plan.model.lanes(np.array([lane])), plan.settings.t_start + plan.dt * steps)
    zero = {k: (field.reshape(len(steps), -1) == 0).all(-1).any() for k, field in fields.items()}
    return [name for name in record.control.arguments if zero.get(name)]


def cause_of_no_numbers(plan: Plan, step: int, lane: int) -> str:
    """The usual cause of a lane that is not finite at a step; for a splitting, whether shorter steps succeed."""
    if plan.scheme.name == "splitting" and step <= MOST_REPEATED:
        steps = _steps(plan)
        for halving in (3, 6):
            if steps(plan.dt / 2**halving, step * 2**halving) is not None:
                return LONG_KICK.format(h=plan.dt / 2**halving)
    if zeros := _sensors_at_zero(plan, step, lane):
        return (
            f"a law that divides by the {' or '.join(zeros)}, which is 0 there. Give the body this field (the "
            "magnetic field of its primary in T m^3, or the Earth; a density of the air), or use another law."
        )
    return (
        f"{of_forces(plan.model)}a step far too long, or a state so large that its square overflows. Use a smaller dt."
    )


def _steps(plan: Plan) -> Callable[[float, int], tuple[Array, ...] | None]:
    """(h, count) -> the components after some steps of the length h from the start; None if they are not finite."""
    letters = (*plan.model.system.space.letters, ORIENTATION)
    run = _pilot(plan.model, tuple(plan.start[k] for k in letters if k in plan.start), plan.settings)

    def steps(h: float, count: int) -> tuple[Array, ...] | None:
        with np.errstate(all="ignore"):
            result = run(plan.scheme.options["order"], h, count)
        return None if result is None else result.state

    return steps


# -- estimates ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Estimate:
    """Seconds, bytes on disk, and free bytes on that disk."""

    seconds: float
    bytes: float
    free: float

    @property
    def text(self) -> str:
        """The estimate in words."""
        return f"about {duration_text(self.seconds)}, {size_text(self.bytes)} on disk ({size_text(self.free)} free)"


def bytes_of(plan: Plan) -> tuple[float, float]:
    """The bytes of an archive, likely and least."""
    row = {name: value[0].nbytes for name, value in plan.example.items()}
    states = sum(size for name, size in row.items() if plan.outcomes[name].kind in ("state", "orientation"))
    likely = OF_STATES * states + OF_INTEGRALS * (sum(row.values()) - states)
    return plan.rows * likely, plan.rows * LEAST * states


def require_room(path: Path, least: float, instead: str) -> None:
    """Raises `InputError` if the disk of `path` has fewer bytes than `least`."""
    free = free_at(path)
    if least > free:
        raise InputError(
            f"{path}: expected a disk with at least {size_text(least)} free, got {size_text(free)}. {instead}"
        )


def free_at(path: Path) -> float:
    """The free bytes on the disk of a path, present or future; infinite if unknown."""
    try:
        folder = path.absolute()
        while not folder.is_dir() and folder != folder.parent:
            folder = folder.parent
        return shutil.disk_usage(folder).free
    except OSError:  # a name that is too long, a folder without access: writing reports this
        return math.inf


def estimate(plan: Plan, path: Path) -> Estimate:
    """The estimate from a pilot of some milliseconds, whose kernels the run reuses."""
    engine, count = plan.engine_at(plan.first), 1
    if isinstance(plan.scheme.motion, Orbits):  # by rows, and the set-up of each call
        count = max(1, min(PILOT_ROWS, plan.rows // 8))
        once, twice = (_spent(engine, rows, plan.every) for rows in (count, 2 * count))
        of_steps = once + max(0.0, twice - once) / count * plan.rows
    else:
        while (spent := _spent(engine, 1, count)) < PILOT_SECONDS / 2 and 8 * count < plan.steps:
            count *= 2
        of_steps = spent / count * plan.steps
    rows = np.repeat(plan.first[None], min(PILOT_ROWS, plan.rows), 0)
    with np.errstate(all="ignore"):
        plan.observe(rows[:1])  # its kernel
        begun = time.perf_counter()
        row = plan.observe(rows)
    a_row = (time.perf_counter() - begun) / len(rows)
    a_row += SECONDS_A_BYTE * sum(value.nbytes for value in row.values()) / len(rows)
    return Estimate(of_steps + plan.rows * a_row, bytes_of(plan)[0], free_at(path))


def _spent(engine: Engine, rows: int, every: int) -> float:
    """Seconds of a call, the better of two: the first may set something up."""
    out, spent = np.empty((rows, *engine.z.shape)), []
    for _ in range(2):
        begun = time.perf_counter()
        engine.advance(out, every)
        spent.append(time.perf_counter() - begun)
    return min(spent)
