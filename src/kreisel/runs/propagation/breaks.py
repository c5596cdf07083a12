"""Impulses and events of a run: steps with a change of the state, or the end of the run, within them.

The engine makes unbroken steps.  A broken step consists of shorter steps, from one break to the next and to its end, so
that the times of rows and further steps do not change.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.errors import InputError, RunError, shown
from kreisel.kernels.layout import Floats
from kreisel.method import scheme as scheme_of
from kreisel.method.scheme import COUNT, ORIENTATION, WORK, CoupledSteps, Flow, Scheme, Steps
from kreisel.runs.plan import BREAKS, Plan
from kreisel.runs.propagation.stepper import AT_ZERO, Signs, Stepper, number_of
from kreisel.runs.settings import LARGE, WHOLE, NamedComponents

MOST_ROWS = 256  # steps that are made before events are checked
MOST_IN_STEP = 1000  # events within one step
SAME = 1e-12  # relative: components that an impulse does not change
POINTS = 3


class Stop(NamedTuple):
    """The state and the time at which an event stops a run."""

    z: Floats
    time: float


class Breaks:
    """The steps of a plan with impulses, events, or rows within them.  Raises `InputError` if they do not suit it.

    `stop`: the state and time at which an event has stopped the run.
    """

    def __init__(self, plan: Plan):
        self.plan, self.events, self.fired = plan, plan.events, plan.fired
        self.stop: Stop | None = None
        self._stepper = _stepper(plan)
        _require_suitable(plan, self._stepper.scheme)
        self._jumps = [_jump(self._stepper, impulse, plan.lanes) for impulse in plan.settings.impulses]
        self._places = list[tuple[int, float]]()  # the step of each impulse, its end included, and the time in the step
        for impulse in plan.settings.impulses:
            step = max(0, int(np.ceil(impulse["time"] / plan.dt * (1 - WHOLE))) - 1)
            within = impulse["time"] - step * plan.dt
            self._places.append((step, plan.dt if within > plan.dt - WHOLE * impulse["time"] else within))
        self._broken = sorted({step for step, _ in self._places})
        self._signs = Signs(self._values, self._step, [event.rising for event in self.events], self._stepper.least)
        if self.events:
            self._signs.begin(plan.first, 0.0)

    def quiet(self, step: int) -> int:
        """The number of steps from here on that an engine may make at once."""
        return 0 if self.events else self._unbroken(step, self.plan.steps)

    def _unbroken(self, step: int, most: int) -> int:
        """The number of steps before the next impulse, at most `most`."""
        at = bisect_left(self._broken, step)
        return min(most, self._broken[at] - step) if at < len(self._broken) else most

    def advance(self, step: int, count: int, look: Callable[[], None]) -> int:
        """Make at most `count` steps from this one on.  Returns their number."""
        quiet, engine = self._unbroken(step, count), self.plan.engine
        if quiet == 0:
            self._break(step)
            return 1
        if not self.events:
            engine.advance(np.empty((1, *engine.z.shape)), quiet, look)
            return quiet
        before = {name: np.array(value) for name, value in engine.snapshot().items()}
        rows = np.empty((min(quiet, MOST_ROWS), *engine.z.shape))
        engine.advance(rows, 1, look)
        for j, row in enumerate(rows):
            if self._signs.changed(self._values(row, (step + j + 1) * self.plan.dt)):
                engine.restore(before)
                if j:
                    engine.advance(np.empty((1, *engine.z.shape)), j, look)
                self._break(step + j, row)
                return j + 1
        return len(rows)

    def row(self, step: int, ahead: float) -> tuple[Floats, Stop | None]:
        """The state within a step, and the stop of the run before it, if any; engine and events do not change."""
        sides, fired = self._signs.sides, len(self.fired)
        z, stop = self._walk(self.plan.engine.z, step, ahead, None)
        if stop is None:
            self._signs.sides = sides
            del self.fired[fired:]
        return z, stop

    def _break(self, step: int, end: Floats | None = None) -> None:
        """The complete step with its breaks; `end`: the state at its end without breaks."""
        plan, engine = self.plan, self.plan.engine
        z, self.stop = self._walk(engine.z, step, plan.dt, end)
        if self.stop is None and not engine.begin(z, plan.scheme, plan.steps + 1):
            plan.engine = plan.engine_at(z)

    def _walk(self, z: Floats, step: int, length: float, end: Floats | None) -> tuple[Floats, Stop | None]:
        """The state at `length` into a step, from its beginning through all breaks on the way."""
        begun, s, count = step * self.plan.dt, 0.0, 0
        inside = sorted((at, i) for i, (k, at) in enumerate(self._places) if k == step and at <= length)
        z = z.copy()
        while True:
            to = inside[0][0] if inside else length
            new = end if end is not None and s == 0 and to == self.plan.dt else self._step(z, begun + s, to - s)
            hits = self._signs.changed(self._values(new, begun + to))
            if hits:
                after, i = min((self._signs.place(i, z, begun + s, to - s), i) for i in hits)
                size = abs(self._values(z, begun + s)[i]) + abs(self._values(new, begun + to)[i])
                z, s, count = self._step(z, begun + s, after), s + after, count + 1
                if self.events[i].action is None:
                    self.fired.append((begun + s, i))
                    return z, Stop(self._counted(z, (begun + s) / self.plan.dt), begun + s)
                z = self._fire(i, z, begun + s, size)
                if count > MOST_IN_STEP:
                    raise RunError(
                        f"More than {MOST_IN_STEP:,} events happen within one step near time {begun + s:.6g}. Usual "
                        "cause: an action after which the event happens again at once, as of a ball that comes to "
                        "rest. Stop the run there."
                    )
                continue
            z, s = new, to
            if not inside:
                return self._counted(z, step + 1 if length == self.plan.dt else step + length / self.plan.dt), None
            _, i = inside.pop(0)
            z = self._changed(z, begun + s, self._stepper.returned(z, begun + s) + self._jumps[i])
            self._signs.begin(z, begun + s)

    def _fire(self, i: int, z: Floats, time: float, size: float) -> Floats:
        """The state after the action of an event whose quantity has this size within the step."""
        self.fired.append((time, i))
        state = {letter: np.array(value) for letter, value in self._state(z, time).items()}
        new = self.events[i].acted(state)
        z = self._changed(z, time, self._stepper.forms.rows_of(new)[0])
        values = self._signs.begin(z, time)
        if abs(values[i]) <= AT_ZERO * size:  # still there: the side to which the motion continues
            self._signs.sides[i] = 0.0
        return z

    def _values(self, z: Floats, time: float) -> Floats:
        state = self._state(z, time) if self.events else {}
        return np.array([number_of(event.quantity, NamedComponents(state), "kr.Event") for event in self.events])

    def _state(self, z: Floats, time: float) -> dict[str, Any]:
        x = self._stepper.returned(z, time)
        return self._stepper.forms.mapping(x if self.plan.batched else x[0])

    def _step(self, z: Floats, time: float, h: float) -> Floats:
        return self._stepper.stepped(z, time, h, 1, 1)[-1] if h > WHOLE * self.plan.dt else z

    def _changed(self, z: Floats, time: float, x: Floats) -> Floats:
        """The method's variables of another state x; only the state changes, and the work includes the change."""
        new = self._stepper.forms.prepared(np.ascontiguousarray(x))
        letters = [letter for letter, _ in self.plan.scheme.components]
        size = len(self.plan.model.system.space.letters) + (ORIENTATION in letters)
        kept = algebra.coordinate_count(self.plan.kinds[:size], self.plan.model.n)
        new[:, kept:] = z[:, kept:]
        if WORK in letters:
            new[:, self._stepper.scheme.column_of(WORK)] += self._energy(new, time) - self._energy(z, time)
        return new

    def _energy(self, z: Floats, time: float) -> Floats:
        return _observed(self.plan, self._stepper.at_time(z, time, self.plan.dt))["energy"][0]

    def _counted(self, z: Floats, count: float) -> Floats:
        """The rows with this count of steps, if forces depend on time."""
        if COUNT in (letter for letter, _ in self.plan.scheme.components):
            z = z.copy()
            z[:, self._stepper.scheme.column_of(COUNT)] = count
        return z

    def snapshot(self) -> dict[str, Floats]:
        """The data on which the next breaks depend."""
        if not self.events:
            return {}
        fired = np.array(self.fired, dtype=np.float64).reshape(-1, 2)
        return {BREAKS + "sides": self._signs.sides.copy(), BREAKS + "fired": fired}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        """Resume from a snapshot.  Raises `InputError` if it belongs to other events."""
        if not self.events:
            return
        sides, fired = snapshot.get(BREAKS + "sides"), snapshot.get(BREAKS + "fired")
        if sides is None or fired is None or sides.shape != self._signs.sides.shape or fired.shape[1:] != (2,):
            raise InputError("events: expected the events of the run, got others, or the checkpoint is damaged.")
        self._signs.sides, self.fired[:] = sides.copy(), [(float(t), int(i)) for t, i in fired]


def _stepper(plan: Plan) -> Stepper:
    oriented = ORIENTATION in (letter for letter, _ in plan.scheme.components)
    scheme = scheme_of(plan.model, plan.scheme.name, plan.dt, plan.scheme.options.get("order"), oriented)
    settings = plan.settings.but(observe=(), project=False, times=None, impulses=(), engine=None)
    return Stepper(plan.model, scheme, settings)


# Reasons why steps of other lengths would be another method.
OF_ONE_LENGTH: tuple[tuple[Callable[[Scheme], Any], str], ...] = (
    (lambda scheme: scheme.corrector, "steps variables that depend on the step for order={order}"),
    (lambda scheme: scheme.deformed, "conserves {deformed[0]}, which depends on the step"),
    (lambda scheme: isinstance(scheme.motion, Flow), "chooses its steps"),
)


# Conditions on plans whose steps are broken, and the message if one does not hold: words of `_require_suitable`.
REQUIREMENTS: tuple[tuple[Callable[[Plan, Scheme], Any], str], ...] = (
    (
        lambda plan, scheme: plan.where in ("cpu", "cuda") and plan.model.n < LARGE,
        "{what}: expected engine='cpu' or 'cuda' and n < {large}, got {engine}, n = {n}. Go on from the last row of "
        "one run with the next, changed in between.",
    ),
    (
        lambda plan, scheme: not any(applies(scheme) for applies, _ in OF_ONE_LENGTH),
        "{what}: expected a method whose steps may differ, such as {ways}, got method={method!r}, which {why}.",
    ),
    (
        lambda plan, scheme: (
            not _changes_the_state(plan)
            or (isinstance(scheme.motion, Steps | CoupledSteps) and scheme.trajectory is None)
        ),
        "{what}: expected a method whose constants do not depend on the start, such as {ways}, where something changes "
        "the state, got method={method!r}. For others call kr.propagator(...).to or .until in a loop.",
    ),
    (
        lambda plan, scheme: not plan.events or not plan.batched or scheme.coupling is not None,
        "events: expected one body, or bodies in pairs, got {lanes} lanes, each of which has them at different times. "
        "Make a run for each lane.",
    ),
)


def _changes_the_state(plan: Plan) -> bool:
    return bool(plan.settings.impulses) or any(event.action for event in plan.events)


def _require_suitable(plan: Plan, scheme: Scheme) -> None:
    """Raises `InputError` for a plan whose steps cannot be broken; `scheme`: without constants of its trajectory."""
    reasons = [reason for applies, reason in OF_ONE_LENGTH if applies(scheme)]
    why = reasons[0].format(order=scheme.options.get("order"), deformed=scheme.deformed) if reasons else ""
    request = "impulses" if plan.settings.impulses else "events" if plan.events else "times"
    changing = "'splitting' (of a perturbed body), 'variational', or 'kahan' of order 4"
    ways = changing if _changes_the_state(plan) else "'baecklund' or 'splitting'"
    words = {"what": request, "why": why, "ways": ways, "method": scheme.name, "engine": plan.where, "n": plan.model.n}
    for holds, message in REQUIREMENTS:
        if not holds(plan, scheme):
            raise InputError(message.format(**words, large=LARGE, lanes=plan.lanes))


def _jump(stepper: Stepper, impulse: Mapping[str, Any], lanes: int) -> Floats:
    """The change of a state (lanes, size) by an impulse.  Raises `InputError`."""
    system, n = stepper.model.system, stepper.model.n
    momenta = [system.space.letters[0]] if system.space.of_body else []
    momenta += [] if system.translation is None else [k for k, kind in system.space.components if kind == "vector"]
    words = getattr(stepper.model.body_frame, "names", {})
    out = np.zeros((lanes, stepper.forms.size))
    letters = [letter for letter in impulse if letter != "time"]
    if not letters or not set(letters) <= set(momenta):
        raise InputError(
            f"impulses: expected an increment of {' or '.join(words.get(k, k) for k in momenta)}, got "
            f"{', '.join(words.get(k, k) for k in letters) or 'none'}."
            if momenta
            else "impulses: expected a system with a momentum."
        )
    for letter in letters:
        value, place = np.asarray(impulse[letter], dtype=np.float64), stepper.forms.places[letter]
        kind = algebra.KINDS[dict(system.space.components)[letter]]
        if kind.axes == 2 and value.shape[-2:] == (n, n):
            value = kind.shown(n).pack(kind.for_user(value))
        width = place.stop - place.start
        if value.shape not in ((width,), (lanes, width)) or not np.isfinite(value).all():
            wanted = f"{width} finite values" if n == 3 or width == n else f"a skew {n} x {n} matrix"
            raise InputError(f"impulses: expected {wanted} for {letter}, got {shown(impulse[letter])}.")
        out[:, place] = value
    return out


def not_conserved(plan: Plan) -> frozenset[str]:
    """Names of conserved quantities of the method that impulses (tested at random states) or events change.

    Raises `InputError` if the steps of the plan cannot be broken.
    """
    held = frozenset(name for name, outcome in plan.scheme.outcomes.items() if outcome.conserved)
    if any(event.action for event in plan.events):
        return held
    stepper, rng, changed = _stepper(plan), np.random.default_rng(1), set()
    _require_suitable(plan, stepper.scheme)
    count = algebra.coordinate_count(plan.model.system.space.kinds, plan.model.n)
    for impulse in plan.settings.impulses:
        jump = _jump(stepper, impulse, plan.lanes)
        for _ in range(POINTS):
            x = stepper.returned(plan.first, 0.0)
            x[:, :count] = rng.normal(size=(len(x), count))
            before, after = (_observed(plan, stepper.forms.prepared(np.ascontiguousarray(y))) for y in (x, x + jump))
            changed |= {name for name in held if not np.allclose(before[name], after[name], rtol=SAME, atol=SAME)}
    return frozenset(changed)


def _observed(plan: Plan, z: Floats) -> dict[str, Floats]:
    parts = algebra.restore(z[None], plan.kinds, plan.model.n)
    result = plan.scheme.observe(parts, **plan.scheme.keywords)
    return result if plan.scheme.coupling is None else plan.scheme.coupling.together(result, parts)
