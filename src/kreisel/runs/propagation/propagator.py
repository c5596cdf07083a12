"""kr.propagator: a motion checked and compiled once, then called with NumPy arrays, for loops that call it often."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.kernels.engines import Engine
from kreisel.kernels.exact.jumps import FEW, Jumps
from kreisel.kernels.layout import Floats
from kreisel.method import scheme
from kreisel.method.driven import COUNT
from kreisel.method.observing import ORIENTATION
from kreisel.method.scheme import Flow, Jump, Orbits, Scheme
from kreisel.record.lanes import in_lane
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME
from kreisel.runs.plan import planned
from kreisel.runs.propagation.forms import StateForms
from kreisel.runs.propagation.walks import Crossing, Walk, first_crossing, number_of
from kreisel.runs.settings import (
    LARGE,
    MOST_STEPS,
    Settings,
    check_model,
    finite_number,
    flag,
    named,
    observed,
    of_forces,
    positive_number,
    wanted_times,
    whole_order,
    within,
)

if TYPE_CHECKING:
    from kreisel.kernels.exact.engine import ClosedForm

FEW_NUMBERS = 64
AT_REST = 16  # engines that are kept for the next call, for each number of lanes


@explained
def propagator(
    system: Model,
    *,
    method: str | None = None,
    order: int | tuple[int, ...] | None = None,
    dt: float | None = None,
    orientation: bool = False,
    observe: Sequence[str] = (),
    project: bool = True,
) -> Propagator:
    """The motion of a system by one method, checked and compiled once, for loops that call it often.

    system       a system with parameters, as for `kr.simulate`; method and order too
    dt           the step; a flow in closed form (method="exact") needs none
    orientation  whether the orientation g is part of the state
    observe      Casimirs and integrals to compute beside the state, by name
    project      as for `kr.simulate`

    Raises `InputError` for bad input.
    """
    check_model(system)
    flag(orientation, "orientation")
    flag(project, "project")
    step = 1.0 if dt is None else positive_number(dt, "dt")
    made = scheme(system, named(method, "method"), step, whole_order(order), bool(orientation))
    if made.coupling is not None and len(observe):
        raise InputError(
            f"{system.system.name}: expected observe=() for bodies that act on each other in pairs, got "
            f"{shown(observe)}. kr.simulate observes them."
        )
    if dt is None and not isinstance(made.motion, Orbits):
        raise InputError(f"method={made.name!r} needs a step dt, got none.")
    settings = Settings(dt=step, steps=1, method=method, order=order, project=bool(project))
    return Propagator(system, made, settings.but(observe=observed(observe, made)), dt is not None)


def _propagator_again(system: Model, settings: Settings, oriented: bool, paced: bool) -> Propagator:
    made = scheme(system, named(settings.method, "method"), settings.dt, whole_order(settings.order), oriented)
    return Propagator(system, made, settings, paced)


class Propagator(StateForms):
    """Made by `kr.propagator`: the state `at` any times, or after `steps`.

    A state is a mapping of its components, or one array of `size` numbers, (size,) or (lanes, size): the components in
    the order of `letters`; axial vectors for n = 3, else the entries of a skew matrix above the diagonal, row by row;
    the orientation as a unit quaternion (w, x, y, z) for n = 3, else as a matrix, row by row.  What comes back has the
    same form; what is observed stands behind the state.  Of an array only shape and finiteness are checked.  Threads
    may share a propagator.
    """

    def __init__(self, model: Model, made: Scheme, settings: Settings, paced: bool = True):
        super().__init__(model, made, settings)
        self._paced = paced  # whether a dt was asked for
        self._at_rest: dict[int, deque[Engine]] = {}
        self._jumps: dict[int, Jumps] = {}
        self._jumping = made.orbits is not None and made.orbits.jump is not None
        self._of_top = made.orbits is not None and isinstance(made.orbits.jump, Jump)
        self._orbits: tuple[tuple[bytes, float], ClosedForm] | None = None

    def __reduce__(self) -> Any:  # kernels stay where they are
        return _propagator_again, (self.model, self.settings, self._oriented, self._paced)

    def __repr__(self) -> str:
        return f"<kreisel propagator of {self.model!r}: {self._scheme.name}>"

    @explained
    def steps(self, state: Any, n: int, every: int | None = None, time: float | None = None) -> Any:
        """The state after n steps of dt; with `every`, rows along a first axis: the steps 0, every, 2 every, ... and n.

        `time` at the start, of bodies with forces that depend on it (`kr.perturbed`); `work` counts from the start.

        Raises `InputError` for what is no state or no number of steps, `RunError` where the state is no longer finite
        or something that the method conserves is lost.
        """
        count = within(n, "n", 1, MOST_STEPS)
        between = count if every is None else within(every, "every", 1, count)
        x, batch = self._given(state)
        if self.model.n >= LARGE:
            found = self._by_a_plan(x, count, between)
        else:
            if isinstance(self._scheme.motion, Flow | Orbits):  # their set-up depends on the state
                self._require_state(x)
            into, out_of = self._conversions(len(x))
            z = self._back(self._at_time(into(x[None])[0], time)[None])[0]
            try:
                engine = self._begun(z, count, between)
            except InputError:  # of constants of the trajectory, which are not finite if the state is not
                _require_finite(x)
                raise
            found = out_of(self._out(self._rows(engine, x, z, count, between)))
            self._at_rest.setdefault(len(z), deque(maxlen=AT_REST)).append(engine)
        return self._returned(found if every is not None else found[-1], state, batch)

    @explained
    def to(self, state: Any, times: Any, time: float = 0.0) -> Any:
        """The state at a time, or at times (times,) along a first axis, in order, from the state at `time`.

        By steps of dt or a little shorter, equal ones from one time to the next: for rows at any times, and for
        impulses, which change the state between two calls.  `work` counts from the start.  Raises as `steps`.
        """
        wanted, begun = wanted_times(times), finite_number(time, "time")
        when = np.atleast_1d(wanted)
        if (np.diff(when, prepend=begun) < 0).any():
            raise InputError(f"times: expected times in order, from time = {begun:g} on, got {shown(times)}.")
        x, batch = self._given(state)
        if self._is_flow:
            return self.at(state, wanted - begun)
        self._require_steps("to")
        walk, out = Walk(self, x, begun), []
        for t in when.tolist():
            walk.to(t)
            out.append(self.returned(walk.z, t))
        return self._returned(np.array(out) if wanted.ndim else out[0], state, batch)

    @explained
    def until(
        self, state: Any, quantity: Callable[[Any], Any], end: float, *, time: float = 0.0, rising: bool | None = None
    ) -> Crossing:
        """The state where a quantity first changes its sign, its time, and whether it did before the time `end`.

        quantity  a function of one state in the form that is given, `lambda x: x["a"][2]`
        rising    True, False: only a change upward, downward; None: both

        The quantity is looked at after each step, so two changes within a step are missed; the place is found to
        rounding by shorter steps from the one before.  A start at 0 is on the side to which the first step goes.
        Change the state and call again for an event that acts: a bounce, a thruster.  Raises as `steps`.
        """
        begun, last = finite_number(time, "time"), finite_number(end, "end")
        if rising is not None:
            flag(rising, "rising")
        if not callable(quantity) or last < begun:
            raise InputError(
                f"until: expected a function of the state and an end from time = {begun:g} on, got {shown(quantity)}, "
                f"{shown(end)}."
            )
        x, batch = self._given(state)
        if batch and self._scheme.coupling is None:
            raise InputError(f"until: expected one state, got {len(x)} lanes. Call it for each.")
        if not self._is_flow:
            self._require_steps("until")
        elif not self._paced:
            raise InputError(
                "until: expected kr.propagator(..., dt=...), which says how often the quantity is looked at, got none."
            )

        def of_rows(rows: Floats) -> float:
            return number_of(quantity, self._returned(rows, state, batch))

        rows, t, crossed = first_crossing(self, x, of_rows, rising, begun, last)
        return Crossing(self._returned(rows, state, batch), t, crossed)

    @property
    def dt(self) -> float:
        """The step."""
        return self.settings.dt

    @property
    def by_trajectory(self) -> bool:
        """Whether the constants of the method depend on the start."""
        return self._scheme.trajectory is not None

    @property
    def _is_flow(self) -> bool:
        return isinstance(self._scheme.motion, Orbits)

    def _require_steps(self, what: str) -> None:
        made, order = self._scheme, self._scheme.options.get("order")
        if made.corrector is not None or (made.name == "suris" and order == 2):
            use = "order=(8, 2) or (8, 6, 4)" if made.corrector else "method='baecklund', or order=1"
            raise InputError(
                f"{what}: expected a method whose steps may differ, got method={made.name!r} of order {order}, whose "
                f"variables depend on dt. Use {use}."
            )
        if self.model.n >= LARGE or isinstance(self._scheme.motion, Flow):
            raise InputError(
                f"{what}: expected a method that makes steps, or a closed form, and n < {LARGE}, got "
                f"method={self._scheme.name!r}, n = {self.model.n}. Use kr.simulate."
            )

    def prepared(self, x: Floats) -> Floats:
        """States (lanes, size) in the method's own variables (lanes, d)."""
        return np.array(self._conversions(len(x))[0](x[None])[0])

    def returned(self, z: Floats, time: float) -> Floats:
        """The method's own variables at a time as states (lanes, size), with what is observed."""
        return self._conversions(len(z))[1](self._timed(z, time, self.dt)[None])[0]

    def stepped(self, x: Floats, z: Floats, time: float, h: float, count: int, every: int) -> Floats:
        """Rows 0, every, ... of so many steps of length h from z, (rows, lanes, d); x: where the walk began."""
        if self._is_flow:
            return self._states(x, z, h * np.arange(0, count + 1, every, dtype=np.float64))
        made = self._scheme
        if h != self.dt:
            order = made.options.get("order")
            made = scheme(self.model, made.name, h, order, self._oriented, kept=False)
        start = self._timed(z, time, h)
        engine = self._begun(start, count, every, made)
        out = self._rows(engine, x, start, count, every)
        self._at_rest.setdefault(len(z), deque(maxlen=AT_REST)).append(engine)
        return out

    def _timed(self, z: Floats, time: float, h: float) -> Floats:
        """The same with the time as a number of steps h, where forces depend on it."""
        record = self.model.system.perturbation
        if record is None or not record.names(TIME):
            return np.ascontiguousarray(z)
        out = np.array(z, order="C")
        out[:, self._column_of(COUNT)] = time / h
        return out

    def _column_of(self, component: str) -> int:
        place = [letter for letter, _ in self._scheme.components].index(component)
        return algebra.coordinate_count(self._own_kinds[:place], self.model.n)

    def _at_time(self, z: Floats, time: float | None) -> Floats:
        """The start with its time.  Raises `InputError` where forces depend on it and none is given, or the reverse."""
        record = self.model.system.perturbation
        timed = record is not None and record.names(TIME)
        if timed != (time is not None):
            raise InputError(
                f"time: expected {'the time at the start' if timed else 'none'}, since the forces of "
                f"{self.model.system.name} {'' if timed else 'do not '}depend on it, got {shown(time)}."
            )
        if not timed:
            return z
        flow = isinstance(self._scheme.motion, Flow)
        z[:, self._column_of(TIME if flow else COUNT)] = finite_number(time, "time") / (1 if flow else self.dt)
        return z

    def _require_state(self, x: Floats) -> None:
        """Raises `InputError` for states that are not finite or off the phase space: arrays are checked only here."""
        _require_finite(x)
        self.model.state(**dict(zip(self.model.system.space.letters, self._system(x), strict=False)))

    def _states(self, x: Floats, z: Floats, when: Floats) -> Floats:
        """By compiled jumps where all of them are right, else by orbits that are set up for this state."""
        if self._jumping and len(when) <= FEW:
            jumps = self._jumps.get(len(z))
            if jumps is None:
                jumps = self._jumps[len(z)] = Jumps(self._scheme, len(z))
            out, right = jumps.at(z, when)
            if right.item() if right.size == 1 else right.all():
                return self._in_one_sheet(out, when)
        from kreisel.kernels.exact.engine import ClosedForm

        with np.errstate(over="ignore"):
            reach = min(2.0 ** np.ceil(np.log2(max(float(abs(when).max()), self.settings.dt))), sys.float_info.max)
        known = self._orbits
        if known is None or known[0] != (z.tobytes(), reach):
            self._require_state(x)
            known = (z.tobytes(), reach), ClosedForm(self._scheme, z, self.settings.dt, reach)
        with np.errstate(all="ignore"):
            out = known[1].at(when)
        self._orbits = known  # the last motion, for further times of it
        return self._in_one_sheet(out, when)

    def _in_one_sheet(self, out: Floats, when: Floats) -> Floats:
        """The states (times, lanes, d) with quaternions that keep their sign in the order of time: jumps do not."""
        if self._oriented and len(when) > 1 and self._of_top:
            place = self._column_of(ORIENTATION)
            out[..., place : place + 4] = algebra.continued(out[..., place : place + 4], when)
        return out

    def _rows(self, engine: Engine, x: Floats, z: Floats, count: int, every: int) -> Floats:
        rows, rest = divmod(count, every)
        out = np.empty((1 + rows + (rest > 0), *z.shape))
        out[0] = z
        engine.advance(out[1 : 1 + rows], every)
        if rest:
            engine.advance(out[1 + rows :], rest)
        self._require_sound(engine, x, out)
        return out

    def _by_a_plan(self, x: Floats, count: int, every: int) -> Floats:
        """As a run of that many dimensions is made, whose kernels depend on the state."""
        plan = planned(self.model, self._scheme, self.settings, self._system(x), None)
        out = self._rows(plan.engine, x, plan.first, count, every)
        found = np.concatenate(list(self._lines(plan.observe(out)).values()), -1)
        return found if plan.batched else found[:, None]

    def _system(self, x: Array) -> tuple[Array, ...]:
        """The components of states as the system has them."""
        with np.errstate(invalid="ignore"):
            parts = algebra.restore(x, self._kinds, self.model.n)
        return tuple(algebra.hat(p) if k in self._axial else p for k, p in zip(self.letters, parts, strict=True))

    @explained
    def at(self, state: Any, times: Any) -> Any:
        """The state at a time, or at times (times,) along a first axis, negative ones too; of a map, so many steps on.

        Raises `InputError` for bad input and where no closed form is known, `RunError` where numbers overflow.
        """
        if self._scheme.orbits is None:
            raise InputError(
                f"No closed form of method={self._scheme.name!r} for {self.model.system.name} is known here. "
                "Use .steps(state, n), or kr.simulate."
            )
        wanted = wanted_times(times)
        when = wanted if wanted.ndim else wanted[None]
        x, batch = self._given(state)
        into, out_of = self._conversions(len(x))
        out = self._states(x, into(x[None])[0], when)
        if not _finite(out):
            _require_finite(x)
            where = in_lane(~np.isfinite(out).all((0, 2)))
            raise RunError(f"The state is not finite{where}: its powers leave the range of doubles. Use other units.")
        found = out_of(out)
        return self._returned(found if wanted.ndim else found[0], state, batch)

    def _begun(self, z: Floats, steps: int, every: int, made: Scheme | None = None) -> Engine:
        """An engine at the start z: one that is at rest, or a new one; `made`: the scheme with another step."""
        made = self._scheme if made is None else made
        if made.trajectory is not None:
            made = made.on(algebra.restore(z, made.kinds, made.n))
        try:
            engine = self._at_rest[len(z)].pop()
        except (KeyError, IndexError):
            return self._plan(made, z, steps, every).engine
        return engine if engine.begin(z, made, steps) else self._plan(made, z, steps, every).engine

    def _require_sound(self, engine: Engine, x: Floats, out: Floats) -> None:
        if not _finite(out):
            _require_finite(x)
            where = in_lane(~np.isfinite(out).all((0, 2)))
            raise RunError(
                f"The state is no longer finite{where}. Usual cause: {of_forces(self.model)}a step far too long, or a "
                "state so large that its square overflows. Use a smaller dt."
            )
        guard, projection = self._scheme.guard, engine.projection
        if guard is not None:
            z = algebra.restore(out, self._own_kinds, self.model.n)
            beyond = self._scheme.component(z, guard.component) > guard.limit
            if beyond.any():
                where = in_lane(beyond.reshape(*out.shape[:2], -1).any((0, 2)))
                raise RunError(f"{guard.fault}{where}. Usual cause: {guard.cause}")
        if projection is not None and projection.worst.any():
            beyond = projection.beyond(self.settings.dt * abs(engine.z).max(-1))
            if beyond.any():
                name = projection.labels[int(np.where(beyond, projection.worst, 0).max(0).argmax())]
                raise RunError(
                    f"{name} is not conserved{in_lane(beyond.any(-1))}, although the method conserves it. Usual cause: "
                    "a step far too long for this state. Use a smaller dt; project=False shows the map as it is."
                )


def _finite(x: Floats) -> bool:
    if x.size < FEW_NUMBERS and math.isfinite(sum(x.ravel().tolist())):  # a tenth of the time of NumPy's sum
        return True
    return math.isfinite(np.add.reduce(x, None)) or bool(np.isfinite(x).all())  # the sum alone may overflow


def _require_finite(x: Floats) -> None:
    good = np.isfinite(x).all(-1)
    if not good.all():
        raise InputError(f"The state: expected finite numbers, got NaN or infinity{in_lane(~good)}.")
