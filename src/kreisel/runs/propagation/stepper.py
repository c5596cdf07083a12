"""Rows of states, stepped by reusable engines to any times and to changes of a sign."""

from __future__ import annotations

import math
import sys
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, RunError, shown
from kreisel.graph.machine import Chain, Link
from kreisel.graph.project import FAR
from kreisel.graph.recording import fill
from kreisel.kernels.cpu import CpuEngine, RowFunction, frame_of, point_links, points
from kreisel.kernels.engines import Engine, corrections
from kreisel.kernels.exact.jumps import TOLERANCE, Jumps
from kreisel.kernels.layout import Floats, threads_for
from kreisel.method import scheme as scheme_of
from kreisel.method.scheme import COUNT, ORIENTATION, Flow, Jump, Orbits, Scheme, Steps
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME
from kreisel.record.table import require_within, tables_of_time
from kreisel.record.values import in_lane
from kreisel.runs.plan import faults, is_finite, planned
from kreisel.runs.propagation.forms import StateForms, require_finite
from kreisel.runs.settings import LARGE, MOST_STEPS, SHORTEST_STEP, WHOLE, Settings, finite_number, of_forces

if TYPE_CHECKING:
    from kreisel.graph.project import CompiledProjection
    from kreisel.kernels.exact.engine import ClosedForm

NONE: Mapping[str, Array] = MappingProxyType({})
NEAR_STEP = 1e-6  # of a step: times that a loop adds up, of samples of a controller
NOT_FOLDED = 0.5  # neither 0 nor 1
MANY = 1000  # steps of a call during which other threads run
SET_UP = 150_000  # operations on lanes in the time that the pairs of maps of a lane need
FEWEST = 25  # operations of a step, before it is compiled
AT_REST = 16  # engines kept for the next call, for each number of lanes
EXACT = 4 * float(np.finfo(float).eps)  # relative, of the time within a step; the least that SciPy accepts
AT_ZERO = 1e-10  # of the largest value within a step: then the start is the end of the last search


class Stepper:
    """Rows z (lanes, d) of the variables of a scheme, stepped by engines or given at times by its closed form.

    forms  the states in the user's form, rows x (lanes, size)
    timed  whether forces depend on the time
    given  the parameters that every call has, by name
    """

    def __init__(self, model: Model, scheme: Scheme, settings: Settings, parameters: tuple[str, ...] = ()):
        scheme = _unfolded(scheme, parameters)
        self.model, self.scheme, self.settings, self.dt = model, scheme, settings, settings.dt
        self.forms = StateForms(model, scheme, settings)
        record = model.system.perturbation
        self.timed = record is not None and record.names(TIME)
        self._sampled = record is not None and record.sampled
        self.least = 2 * NEAR_STEP * self.dt if self._sampled else 0.0
        self._tabled = any(tables_of_time(model))
        self.is_flow = isinstance(scheme.motion, Orbits)
        self._set_up = isinstance(scheme.motion, Flow | Orbits)  # by the state
        self._back, self._out = corrections(scheme)
        self._at_rest = defaultdict[int, deque[Engine]](lambda: deque(maxlen=AT_REST))
        fixed = scheme.trajectory is None or scheme.point is not None or scheme.links is not None
        plain = isinstance(scheme.motion, Steps) and fixed and model.n < LARGE
        several = defaultdict[int, deque[Course]](lambda: deque(maxlen=AT_REST))
        self._courses = several if plain and not model.batch else None  # by lanes
        self._work_of_step = FEWEST
        jump = None if scheme.orbits is None else scheme.orbits.jump
        self._jumping, self._of_top = jump is not None, isinstance(jump, Jump)
        self._jumps = cache(partial(Jumps, scheme))  # by lanes
        self._rooms = list[Room]() if self._jumping and not model.batch else None
        self._orbits: tuple[tuple[bytes, float], ClosedForm] | None = None

    # -- steps -----------------------------------------------------------------------------------------

    def steps(
        self, x: Floats, count: int, every: int | None, time: float | None, parameters: Mapping[str, Array] = NONE
    ) -> Floats:
        """The states (lanes, entries) after `count` steps from x; with `every`, rows of the steps 0, every, ..."""
        if self._set_up:
            self.forms.require_on_phase_space(x)
        if self._tabled and time is not None:
            require_within(self.model, finite_number(time, "time"), time + count * self.dt)
        z = self.forms.prepared(x)
        if self.timed or time is not None:
            z = self._at_time(z, time)
        back, ahead = self._back, self._out
        if parameters and self.scheme.corrector is not None:
            back, ahead = corrections(replace(self.scheme, constants={**self.scheme.constants, **parameters}))
        jumped = None if every else self._jumped(z, np.array([count], np.float64), self.dt)
        if jumped is not None and is_finite(jumped):
            return self.forms.observed(jumped)[0]
        rows = self._rows(back(z[None])[0], count, every or count, self.scheme, parameters)
        return self.forms.observed(ahead(rows)) if every else self.forms.observed(ahead(rows[1:]))[0]

    def steps_at_once(
        self, x: Floats, count: int, time: float | None, parameters: Mapping[str, Array]
    ) -> Floats | None:
        """The states after `count` steps from x (size,) or (lanes, size), by one call.

        None if only `steps` can tell them, and for work of several threads.
        """
        lanes = len(x) if x.ndim > 1 else 1
        if self._rooms is not None and lanes == 1 and time is None:
            y = self.at_once(x, count, self.dt)
            return y if y is None or x.ndim == 1 else y[None]
        work = lanes * (count * self._work_of_step + SET_UP * (self.scheme.links is not None))
        if self._courses is None or self.timed != (time is not None) or (lanes > 1 and threads_for(work) > 1):
            return None
        if self._tabled and time is not None:
            require_within(self.model, finite_number(time, "time"), time + count * self.dt)
        try:
            course = self._courses[lanes].pop()
        except IndexError:
            x = np.atleast_2d(x)
            require_finite(x)
            new = self._course(x, count)
            if new is None:
                self._courses = None
                return None
            course = new
        for engine in course.engines if parameters else ():
            fill(engine.constants, engine.columns, parameters, self.scheme.axes)
        sound = course.run(x, count, None if time is None else self._steps_at(time))
        if sound and course.doubtful:
            self._require_sound(course.engine, course.row)
        y = course.y.copy() if sound else None
        if sound or self.scheme.links is None:  # else another number of stages may be needed
            self._courses[lanes].append(course)
        return y

    def _course(self, x: Floats, count: int) -> Course | None:
        """A new course; None without straight-line code, or if constants of the trajectory are not compiled."""
        z, scheme = self.forms.prepared(x), self.scheme
        rows, engine = self.forms.compiled(len(x)), self._begun(z, count, count, scheme)
        engines = [engine]
        if scheme.corrector is not None:
            back, ahead = (CpuEngine(scheme.by(which), z) for which in (scheme.corrector.back, scheme.corrector.out))
            engines = [back, engine, ahead]
        if rows is None or not all(isinstance(e, CpuEngine) and e.code.steps is not None for e in engines):
            return None
        straight = cast("list[CpuEngine]", engines)
        points = ([], []) if scheme.trajectory is None else point_links(scheme, cast("CpuEngine", engine), self.dt)
        if points is None or (engine.projection is not None and not cast("CpuEngine", engine).code.programs):
            return None
        course = Course(straight, *rows, self.forms.size, points, self.scheme.column_of(COUNT) if self.timed else None)
        self._work_of_step = course.engine.work_of_step
        if scheme.guard and scheme.guard.component:
            course.guard = self.scheme.column_of(scheme.guard.component), scheme.guard.limit
        return course

    def by_a_plan(self, x: Floats, count: int, every: int | None) -> Floats:
        """The states of `steps` by an engine like that of a run, for dimensions whose kernels depend on the state."""
        plan = planned(self.model, self.scheme, self.settings, self.forms.components(x), None)
        rows = self._advanced(plan.engine, plan.first, count, every or count)
        out = self.forms.of_plan(plan.observe(rows))
        out = out if plan.batched else out[:, None]
        return out if every is not None else out[-1]

    def stepped(
        self, z: Floats, time: float, h: float, count: int, every: int, parameters: Mapping[str, Array] = NONE
    ) -> Floats:
        """Rows 0, every, ... of `count` steps of length h from z at a time, (rows, lanes, d)."""
        if self.is_flow:
            return self.states(z, h * np.arange(0, count + 1, every, dtype=np.float64))
        scheme = self.scheme
        if h != self.dt:
            order = scheme.options.get("order")
            scheme = scheme_of(self.model, scheme.name, h, order, self.forms.oriented, kept=False)
            scheme = _unfolded(scheme, (*parameters,))
        elif self._sampled:
            time = self._steps_at(time) * h
        return self._rows(self.at_time(z, time, h), count, every, scheme, parameters)

    def _rows(
        self, z: Floats, count: int, every: int, scheme: Scheme, parameters: Mapping[str, Array] = NONE
    ) -> Floats:
        engine = self._begun(z, count, every, scheme, parameters)
        rows = self._advanced(engine, z, count, every)
        self._at_rest[len(z)].append(engine)
        return rows

    def _advanced(self, engine: Engine, z: Floats, count: int, every: int) -> Floats:
        rows, remainder = divmod(count, every)
        out = np.empty((1 + rows + (remainder > 0), *z.shape))
        out[0] = z
        engine.advance(out[1 : 1 + rows], every)
        if remainder:
            engine.advance(out[1 + rows :], remainder)
        self._require_sound(engine, out)
        return out

    def _begun(
        self, z: Floats, steps: int, every: int, scheme: Scheme, parameters: Mapping[str, Array] = NONE
    ) -> Engine:
        """An engine at the start z with the given parameters: an idle one, or a new one."""
        if scheme.trajectory is not None:
            x0 = algebra.restore(z, scheme.kinds, scheme.n)[: len(self.forms.letters)]
            if scheme.components[0][0] not in self.forms.letters:  # other variables than those of the state
                x0 = self.forms.components(self.forms.observed(z[None])[0, :, : self.forms.size])
            scheme = scheme.on(x0, points)
        try:
            engine = self._at_rest[len(z)].pop()
        except IndexError:
            engine = None
        if engine is None or not engine.begin(z, scheme, steps):
            engine = self.forms.plan(scheme, z, steps, every).engine
        if parameters:
            stepped = cast("CpuEngine", engine)
            fill(stepped.constants, stepped.columns, parameters, scheme.axes)
        return engine

    def _require_sound(self, engine: Engine, rows: Floats) -> None:
        """Raises `RunError` if rows are not finite or violate a promise of the method."""
        for fault in faults(self.scheme, engine, rows, self.dt):
            cause = fault.cause or (
                f"{of_forces(self.model)}a step far too long, or a state so large that its square overflows. Use a "
                "smaller dt."
            )
            where = in_lane(~fault.good[int(np.argmin(fault.good.all(1)))])
            raise RunError(f"{fault.text}{where}. Usual cause: {cause}")

    # -- the time of forces ----------------------------------------------------------------------------

    def at_time(self, z: Floats, time: float, h: float) -> Floats:
        """The rows with the time as a number of steps h, if forces depend on it."""
        if not self.timed:
            return np.ascontiguousarray(z)
        out = np.array(z, order="C")
        out[:, self.scheme.column_of(COUNT)] = time / h
        return out

    def _at_time(self, z: Floats, time: float | None) -> Floats:
        """The start with its time.  Raises `InputError` if forces depend on it and none is given, or the reverse."""
        if self.timed != (time is not None):
            raise InputError(
                f"time: expected {'the time at the start' if self.timed else 'none'}, since the forces of "
                f"{self.model.system.name} {'' if self.timed else 'do not '}depend on it, got {shown(time)}."
            )
        flow = isinstance(self.scheme.motion, Flow)
        z[:, self.scheme.column_of(TIME if flow else COUNT)] = (
            finite_number(time, "time") if flow else self._steps_at(time)
        )
        return z

    def _steps_at(self, time: Any) -> float:
        """A time in steps of dt.  Raises `InputError` if samples of a controller would not be at complete steps."""
        finite = type(time) is float and math.isfinite(time)
        steps: float = (time if finite else finite_number(time, "time")) / self.dt
        if not self._sampled:
            return steps
        if abs(steps - round(steps)) > NEAR_STEP:
            raise InputError(
                f"time: expected a multiple of dt = {self.dt:g}, at which the controller is sampled, got {time:.15g}."
            )
        return float(round(steps))

    def on_grid(self, time: float) -> float:
        """The time, at a sample of a controller without its rounding."""
        steps = time / self.dt if self._sampled else 0.5
        return round(steps) * self.dt if abs(steps - round(steps)) <= NEAR_STEP else time

    def to_sample(self, time: float) -> float:
        """The time from between two steps to the next, at which a controller may be sampled; 0 at one, or without."""
        ahead = math.ceil(time / self.dt - NEAR_STEP) * self.dt - time if self._sampled else 0.0
        return ahead if ahead > self.least / 2 else 0.0

    # -- the closed form -------------------------------------------------------------------------------

    def at(self, x: Floats, times: Floats) -> Floats:
        """The states (times, lanes, entries) from x at time 0.  Raises `RunError` if values overflow."""
        rows = self.states(self.forms.prepared(x), times)
        if not is_finite(rows):
            where = in_lane(~np.isfinite(rows).all((0, 2)))
            raise RunError(f"The state is not finite{where}: its powers leave the range of doubles. Use other units.")
        return self.forms.observed(rows)

    def at_once(self, x: Floats, time: float, unit: float = 1.0) -> Floats | None:
        """The state (entries,) at a time from x (size,) at time 0, by one call; None if only `at` can tell it."""
        if self._rooms is None:
            return None
        try:
            room = self._rooms.pop()
        except IndexError:
            rows = self.forms.compiled(1)
            if rows is None:
                self._rooms = None
                return None
            leap = self._jumps(1).single(algebra.coordinate_count(self.scheme.kinds, self.model.n))
            x0, y0 = np.empty((1, 1, self.forms.size)), np.empty((1, 1, rows[1].count))
            chain = Chain([rows[0].link(x0, leap.z[None]), leap.link, rows[1].link(leap.row, y0)], [x0, leap.row])
            room = Room(chain, x0.ravel(), leap.time, y0.ravel(), leap.error)
        chain, entries, when, y, error = room
        entries[...], when[...] = x, (unit, time)
        chain.call()
        right = math.isfinite(chain.total.value) and error[0] <= TOLERANCE
        out = y.copy() if right else None
        self._rooms.append(room)
        return out

    def _jumped(self, z: Floats, times: Floats, unit: float = 1.0) -> Floats | None:
        """Rows (times, lanes, d) by compiled jumps, at times in a unit; None if not all are accurate."""
        if not self._jumping:
            return None
        out, right = self._jumps(len(z)).at(z, times, unit)
        return out if right.all() else None

    def states(self, z: Floats, times: Floats) -> Floats:
        """Rows (times, lanes, d): by compiled jumps if all are accurate, else by orbits set up for this state."""
        out = self._jumped(z, times)
        if out is None:
            from kreisel.kernels.exact.engine import ClosedForm

            with np.errstate(over="ignore"):
                reach = min(2.0 ** np.ceil(np.log2(max(float(abs(times).max()), self.dt))), sys.float_info.max)
            orbits = self._orbits
            if orbits is None or orbits[0] != (z.tobytes(), reach):
                self.forms.require_on_phase_space(self.forms.observed(z[None])[0, :, : self.forms.size])
                orbits = (z.tobytes(), reach), ClosedForm(self.scheme, z, self.dt, reach)
            with np.errstate(all="ignore"):
                out = orbits[1].at(times)
            self._orbits = orbits  # the last motion, for further times of it
        if self.forms.oriented and len(times) > 1 and self._of_top:  # quaternions keep their sign in the order of time
            place = self.scheme.column_of(ORIENTATION)
            out[..., place : place + 4] = algebra.continued(out[..., place : place + 4], times)
        return out

    # -- any times -------------------------------------------------------------------------------------

    def step(self, z: Floats, time: float, h: float) -> Floats:
        """The state after a single step of length h from z at a time."""
        return self.stepped(z, time, h, 1, 1)[-1] if h > SHORTEST_STEP else z

    def walked(self, z: Floats, time: float, end: float, parameters: Mapping[str, Array] = NONE) -> Floats:
        """The state at a later time, in equal steps of at most dt; with a controller in steps between its samples."""
        self.require_reach(time, end)
        time = self.on_grid(time)
        for h, count in self._pieces(time, end):
            z = self.stepped(z, time, h, count, count, parameters)[-1]
            time = self.on_grid(time + count * h)
        return z

    def _pieces(self, time: float, end: float) -> list[tuple[float, int]]:
        """The lengths and numbers of steps between two times."""
        gap, count = end - time, self.whole_steps(time, end)
        if gap <= SHORTEST_STEP:
            return []
        if count is not None:
            return [(self.dt, count)]
        if not self._sampled:
            count = math.ceil(gap / self.dt)
            return [(gap / count, count)]
        ahead = min(self.to_sample(time), gap)
        count = math.floor((gap - ahead) / self.dt + NEAR_STEP)
        pieces = [(ahead, 1), (self.dt, count), (gap - ahead - count * self.dt, 1)]
        return [(h, count) for h, count in pieces if count * h > self.least / 2]

    def whole_steps(self, time: float, end: float) -> int | None:
        """The number of steps of dt between two times, up to their rounding; None if it is not an integer."""
        if self._sampled and self.to_sample(time):
            return None
        steps = (end - time) / self.dt
        rounding = WHOLE * steps + EXACT * (abs(time) + abs(end)) / self.dt
        return round(steps) if 0.5 <= steps <= MOST_STEPS and abs(steps - round(steps)) <= rounding else None

    def require_reach(self, time: float, end: float) -> None:
        """Raises `InputError` for an end that steps of dt do not reach."""
        if not (end - time) / self.dt <= MOST_STEPS or (end > time and not end - self.dt < end):
            raise InputError(
                f"times: expected at most {MOST_STEPS:,} steps of dt = {self.dt:g}, which are not lost in the time, "
                f"got {end:g} from {time:g} on."
            )
        if self._tabled:
            require_within(self.model, time, end)

    def returned(self, z: Floats, time: float) -> Floats:
        """Rows of the stepped variables at a time as states (lanes, entries), followed by the observed quantities."""
        return self.forms.observed(self.at_time(z, time, self.dt)[None])[0]


def _unfolded(scheme: Scheme, parameters: tuple[str, ...]) -> Scheme:
    """The scheme with values for some constants that are not folded into its code."""
    if not parameters:
        return scheme
    constants = {name: np.full(np.shape(scheme.constants[name]), NOT_FOLDED) for name in parameters}
    return replace(scheme, constants={**scheme.constants, **constants})


class Room(NamedTuple):
    """A compiled jump of one state, by `chain`, from the entries x to y; right if the error is small.

    time  its unit, and in that unit
    """

    chain: Chain
    x: Floats
    time: Floats
    y: Floats
    error: Floats


class Course:
    """Memory of steps of lanes by engines with straight-line code, and their compiled calls from x to y.

    engines   the engine of the steps; with a corrector between the engines of its inverse and of itself
    points    the links that compute the constants of the trajectory, and where they put them
    time      column of the time among the variables; None if forces do not depend on it
    guard     column of the guard's component, and its limit
    doubtful  whether a correction by the projection is larger than roundings of slow motions
    """

    guard: tuple[int, float] | None = None

    def __init__(
        self,
        engines: list[CpuEngine],
        into: RowFunction,
        out: RowFunction,
        size: int,
        points: tuple[list[Link], list[Floats]],
        time: int | None,
    ):
        self.engines, self.engine, self._time, self.doubtful = engines, engines[len(engines) // 2], time, False
        self._projection = cast("CompiledProjection | None", self.engine.projection)
        lanes = len(self.engine.z)
        self.row, x, y = (np.empty((1, lanes, count)) for count in (self.engine.z.shape[1], size, out.count))
        rows, self._held, steps = [*(engine.z for engine in engines[1:]), self.row], list[Any](), list[Link]()
        for engine, row in zip(engines, rows, strict=True):
            projection = self._projection if engine is self.engine else None
            frame, held = frame_of(engine.code, engine.z, engine.constants, engine.stages, projection, 0)
            self._held.append(held)
            steps.append((cast("Any", engine.code.steps).kernel, (frame, row, 1, 1, 0, 0, lanes)))
        ahead = len(engines) // 2
        self._summed, self._main = [x, self.row, *points[1]], steps[ahead]
        self._links = (
            [into.link(x, engines[0].z[None])],
            [*steps[:ahead], *points[0]],
            [*steps[ahead:], out.link(self.row, y)],
        )
        self.x, self.y = (x[0], y[0]) if lanes > 1 else (x[0, 0], y[0, 0])

    def _chain(self, links: list[Link]) -> tuple[Chain, Any]:
        chain = Chain(links, self._summed)
        return chain, chain.argument(links.index(self._main), 3)

    @cached_property
    def _joined(self) -> tuple[Chain, Any]:
        return self._chain([link for links in self._links for link in links])

    @cached_property
    def _apart(self) -> tuple[Chain, Chain, Chain, Any]:
        enter, before, after = self._links
        return Chain(enter, []), Chain(before, []), *self._chain(after)

    def run(self, x: Floats, count: int, time: float | None) -> bool:
        """Make `count` steps from states x at a time, in steps; whether the states are finite and guarded."""
        self.x[...] = x
        projection = None if self._projection is None or count < self._projection.every else self._projection
        if projection is not None or self._time is not None:
            enter, before, chain, counted = self._apart
            enter.call()
            if self._time is not None:
                self.engines[0].z[:, self._time] = time
            before.call()
        else:
            chain, counted = self._joined
        if projection is not None:
            projection.begin(count)
        counted[0], self.doubtful = count, False
        sound = math.isfinite(chain(count * self.row.shape[1] > MANY))
        if projection is not None:
            self.doubtful = not projection.worst.max() <= FAR * math.sqrt(projection.every)
        return sound and (self.guard is None or bool(self.row[..., self.guard[0]].max() <= self.guard[1]))


class Signs:
    """Signs of quantities of a state along its steps, and the times of their changes.

    values  (z, time) -> the quantities (count,)
    step    (z, time, h) -> z, a single step
    rising  of each quantity: True, False for changes only upward, downward; None: both
    least   the shortest time to a change, and from one within a step to its end: no sample of a controller is repeated
    """

    def __init__(
        self,
        values: Callable[[Floats, float], Floats],
        step: Callable[[Floats, float, float], Floats],
        rising: Sequence[bool | None],
        least: float = 0.0,
    ):
        self.values, self._step, self._rising, self._least = values, step, rising, least
        self.sides = np.zeros(len(rising))

    def begin(self, z: Floats, time: float) -> Floats:
        """Set the sides at a state.  Returns the quantities there."""
        values = self.values(z, time)
        self.sides = np.sign(values)
        return values

    def changed(self, values: Floats) -> list[int]:
        """The indices of the quantities whose sign has changed; else the sides become the signs of the values."""
        signs = np.sign(values)
        result = [
            i for i in np.flatnonzero(self.sides * signs < 0).tolist() if self._rising[i] in (None, bool(signs[i] > 0))
        ]
        if not result:
            self.sides = np.where(signs == 0, self.sides, signs)
        return result

    def place(self, i: int, z: Floats, time: float, h: float) -> float:
        """The time after z at which a quantity leaves its side, within a step of length h: by Brent's method."""
        from scipy.optimize import brentq

        def value(s: float) -> float:
            return float(self.values(self._step(z, time, s), time + s)[i])

        side = self.sides[i]
        if value(0.0) * side <= 0:
            return 0.0
        if value(h) * side >= 0:
            return h
        after = float(brentq(value, 0.0, h, xtol=EXACT * h, rtol=EXACT))
        return h if after > h - self._least else max(self._least, after)


def number_of(quantity: Any, state: Any, name: str) -> float:
    """The value of a user's function of a state.  Raises `InputError` if it is not a finite number."""
    try:
        value = np.asarray(quantity(state))
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        raise InputError(
            f"{name}: expected a function of the state, such as lambda x: x['a'][2], got one that raises "
            f"{type(error).__name__}: {error}."
        ) from error
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected a quantity with one value, got {shown(value)}.")
    return finite_number(value.item(), f"{name}: the quantity")
