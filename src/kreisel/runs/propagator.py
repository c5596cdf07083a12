"""kr.propagator: a motion checked and compiled once, then called with NumPy arrays, for loops that call it often."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, shown
from kreisel.forces.pairs import require_bodies
from kreisel.kernels import layout
from kreisel.kernels.cpu import compiled_rows
from kreisel.kernels.engines import Engine
from kreisel.kernels.exact.jumps import FEW, Jumps
from kreisel.kernels.layout import Floats
from kreisel.method import scheme
from kreisel.method.driven import COUNT
from kreisel.method.observing import ORIENTATION, held_by_orientation, with_orientation
from kreisel.method.scheme import Scheme
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME
from kreisel.runs.at import wanted_times
from kreisel.runs.plan import LARGE, Plan, planned
from kreisel.runs.settings import (
    MOST_STEPS,
    Settings,
    _orientation,
    check_model,
    finite_number,
    flag,
    named,
    observed,
    positive_number,
    whole_order,
    within,
)

if TYPE_CHECKING:
    from kreisel.kernels.exact.engine import ClosedForm

Rows = Callable[[Floats], Floats]
AT_REST = 16  # engines that are kept for the next call, for each number of lanes


def propagator(
    system: Any,
    *,
    method: str | None = None,
    order: int | None = None,
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
    if dt is None and (made.step is not None or made.orbit is None):
        raise InputError(f"method={made.name!r} needs a step dt, got none.")
    made = replace(made, held=held_by_orientation(system, made.components))
    settings = Settings(dt=step, steps=1, method=method, order=order, project=bool(project))
    return Propagator(system, made, settings.but(observe=observed(observe, made)))


class Propagator:
    """Made by `kr.propagator`: the state `at` any times, or after `steps`.

    A state is a mapping of its components, or one array of `size` numbers, (size,) or (lanes, size): the components in
    the order of `letters`; axial vectors for n = 3, else the entries of a skew matrix above the diagonal, row by row;
    the orientation as a unit quaternion (w, x, y, z) for n = 3, else as a matrix, row by row.  What comes back has the
    same form; what is observed stands behind the state.  Of an array only shape and finiteness are checked.  Threads
    may share a propagator.
    """

    def __init__(self, model: Model, made: Scheme, settings: Settings):
        self.model, self.settings, self._scheme = model, settings, made
        self._oriented = ORIENTATION in made.outcomes
        components = with_orientation(model, self._oriented)
        self.letters = tuple(letter for letter, _ in components)
        self._kinds = ["vector" if kind == "skew" and model.n == 3 else kind for _, kind in components]
        self._own_kinds = [kind for _, kind in made.components]
        self._places = dict(zip(self.letters, _slices(self._kinds, model.n), strict=True))
        self.size = sum(layout.coordinate_count(kind, model.n) for kind in self._kinds)
        self._axial = [letter for letter, kind in components if kind == "skew" and model.n == 3]
        self._converters: dict[int, tuple[Rows, Rows]] = {}
        self._at_rest: dict[int, deque[Engine]] = {}
        self._jumps: dict[int, Jumps] = {}
        self._orbits: tuple[tuple[bytes, float], ClosedForm] | None = None

    def __repr__(self) -> str:
        return f"<kreisel propagator of {self.model!r}: {self._scheme.name}>"

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
            into, out_of = self._conversions(len(x))
            z = self._at_time(into(x[None])[0], time)
            engine = self._begun(z, count, between)
            found = out_of(self._rows(engine, x, z, count, between))
            self._at_rest.setdefault(len(z), deque(maxlen=AT_REST)).append(engine)
        return self._returned(found if every is not None else found[-1], state, batch)

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
        flow = self._scheme.rate is not None
        place = [letter for letter, _ in self._scheme.components].index(TIME if flow else COUNT)
        column = sum(layout.coordinate_count(kind, self.model.n) for kind in self._own_kinds[:place])
        z[:, column] = finite_number(time, "time") / (1 if flow else self.settings.dt)
        return z

    def _states(self, z: Floats, when: Floats) -> Floats:
        """By compiled jumps where all of them are right, else by orbits that are set up for this state."""
        if self._scheme.jump is not None and len(when) <= FEW:
            jumps = self._jumps.get(len(z))
            if jumps is None:
                jumps = self._jumps[len(z)] = Jumps(self._scheme, len(z))
            out, right = jumps.at(z, when)
            if right.all():
                return out
        from kreisel.kernels.exact.engine import ClosedForm

        reach = 2.0 ** np.ceil(np.log2(max(float(abs(when).max()), self.settings.dt)))
        known = self._orbits
        if known is None or known[0] != (z.tobytes(), reach):
            known = (z.tobytes(), reach), ClosedForm(self._scheme, z, self.settings.dt, reach)
        with np.errstate(all="ignore"):
            out = known[1].at(when)
        self._orbits = known  # the last motion, for further times of it
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
        parts = layout.restore(x, self._kinds, self.model.n)
        return tuple(algebra.hat(p) if k in self._axial else p for k, p in zip(self.letters, parts, strict=True))

    def at(self, state: Any, times: Any) -> Any:
        """The state at a time, or at times (times,) along a first axis, negative ones too; of a map, so many steps on.

        Raises `InputError` for bad input and where no closed form is known, `RunError` where numbers overflow.
        """
        if self._scheme.orbit is None:
            raise InputError(
                f"No closed form of method={self._scheme.name!r} for {self.model.system.name} is known here. "
                "Use .steps(state, n), or kr.simulate."
            )
        wanted = wanted_times(times)
        when = np.atleast_1d(wanted)
        x, batch = self._given(state)
        into, out_of = self._conversions(len(x))
        out = self._states(into(x[None])[0], when)
        if not _finite(out):
            _require_finite(x)
            raise RunError("The state is not finite: its powers leave the range of doubles. Use other units.")
        found = out_of(out)
        return self._returned(found if wanted.ndim else found[0], state, batch)

    def _given(self, state: Any) -> tuple[Floats, bool]:
        """A state as rows (lanes, size), and whether it has lanes.  Raises `InputError`."""
        plain = type(state) is np.ndarray and state.dtype == np.float64
        if not plain or state.ndim > 2 or state.shape[-1:] != (self.size,):
            state = _numbers(self._flat(state) if isinstance(state, Mapping) else state, self)
        x = state if state.ndim > 1 else state[None]
        if self.model.batch and len(x) != self.model.batch[0]:
            x = np.broadcast_to(x, (self.model.batch[0], self.size))
        batched = state.ndim > 1 or bool(self.model.batch)
        require_bodies(self.model, (len(x),) if batched else ())
        return np.ascontiguousarray(x), batched

    def _flat(self, state: Mapping[str, Any]) -> Floats:
        """A mapping as one array, checked as the start of a run is."""
        given = dict(state)
        g = given.pop(ORIENTATION, None)
        if (g is not None) != self._oriented:
            had = "none" if g is None else "one"
            raise InputError(
                f"g: expected {'an' if self._oriented else 'no'} orientation in the state, got {had}. "
                "kr.propagator(..., orientation=True) carries one along."
            )
        own = self.model.state(**given)
        parts = [own[letter] for letter in self.model.system.space.letters]
        parts += [] if g is None else [_orientation(g, self.model)]
        natural = [algebra.axial(p) if k in self._axial else p for k, p in zip(self.letters, parts, strict=True)]
        return np.asarray(layout.flatten(natural, self._kinds))

    def _conversions(self, lanes: int) -> tuple[Rows, Rows]:
        """From rows (rows, lanes, size) of states to those of the method's own variables, and back to what is returned.

        Compiled where the functions can be recorded, else the definitions on arrays.
        """
        if lanes in self._converters:
            return self._converters[lanes]
        n, made, plan = self.model.n, self._scheme, self._plan(self._scheme, np.zeros((lanes, 0)))
        natural = tuple(zip(self.letters, self._kinds, strict=True))

        def prepared(parts: tuple[Array, ...], /, **_: Array) -> dict[str, Array]:
            own = [algebra.hat(p) if k in self._axial else p for k, p in zip(self.letters, parts, strict=True)]
            return {"z": layout.flatten(made.prepare(tuple(own)), self._own_kinds)}

        def returned(parts: tuple[Array, ...], /, **known: Array) -> dict[str, Array]:
            return self._lines(plan.variables(parts, **known))

        given = replace(made, components=natural)
        into = None if self.model.batch else compiled_rows(given, prepared, lanes, ("prepare",))
        out_of = compiled_rows(made, returned, lanes, ("return", self.settings.observe))
        found = (
            into[0] if into else lambda x: np.ascontiguousarray(prepared(layout.restore(x, self._kinds, n))["z"]),
            out_of[0]
            if out_of
            else lambda z: np.concatenate(
                [
                    np.broadcast_to(v, (*z.shape[:2], v.shape[-1]))
                    for v in returned(layout.restore(z, self._own_kinds, n), **made.constants).values()
                ],
                -1,
            ),
        )
        self._converters[lanes] = found
        return found

    def _lines(self, outputs: Mapping[str, Array]) -> dict[str, Array]:
        """The state, the orientation, and what is observed beside, each as numbers along the last axis."""
        names = (*self.letters, *(name for name in outputs if name not in self.letters))
        return {name: self._line(name, outputs[name]) for name in names}

    def _line(self, name: str, value: Array) -> Array:
        """A variable as numbers along the last axis."""
        kind = self._scheme.outcomes[name].axes
        if kind in ("skew", "symmetric", "matrix") and name not in self._axial:
            return layout.flatten([value], [kind])
        return value if kind or np.ndim(value) > 2 else value[..., None]

    def _begun(self, z: Floats, steps: int, every: int) -> Engine:
        """An engine at the start z: one that is at rest, or a new one."""
        made = self._scheme
        if made.trajectory is not None:
            made = made.on(layout.restore(z, [kind for _, kind in made.components], made.n))
        try:
            engine = self._at_rest[len(z)].pop()
        except (KeyError, IndexError):
            return self._plan(made, z, steps, every).engine
        return engine if engine.begin(z, made, steps) else self._plan(made, z, steps, every).engine

    def _plan(self, made: Scheme, z: Floats, steps: int = 1, every: int = 1) -> Plan:
        return Plan(self.model, made, self.settings.but(steps=steps, every=every), z, True, {})

    def _require_sound(self, engine: Engine, x: Floats, out: Floats) -> None:
        if not _finite(out):
            _require_finite(x)
            raise RunError(
                "The state is no longer finite. Usual cause: a step far too long, or a state so large that its square "
                "overflows. Use a smaller dt."
            )
        guard, projection = self._scheme.guard, engine.projection
        if guard is not None:
            place = [letter for letter, _ in self._scheme.components].index(guard.component)
            if (layout.restore(out, self._own_kinds, self.model.n)[place] > guard.limit).any():
                raise RunError(f"{guard.fault}. Usual cause: {guard.cause}")
        if projection is not None and projection.worst.any():
            beyond = projection.beyond(self.settings.dt * abs(engine.z).max(-1))
            if beyond.any():
                name = projection.labels[int(np.where(beyond, projection.worst, 0).max(0).argmax())]
                raise RunError(
                    f"{name} is not conserved, although the method conserves it. Usual cause: a step far too long for "
                    "this state. Use a smaller dt; project=False shows the map as it is."
                )

    def _returned(self, x: Floats, state: Any, batch: bool) -> Any:
        """Rows ([rows,] lanes, numbers) in the form that was given."""
        x = x if batch else x[..., 0, :]
        if type(state) is np.ndarray or not isinstance(state, Mapping):
            return x
        out = {}
        for letter, kind in zip(self.letters, self._kinds, strict=True):
            out[letter] = layout.restore(x[..., self._places[letter]], [kind], self.model.n)[0]
        return out | {name: x[..., place] for name, place in self._beside.items()}

    @cached_property
    def _beside(self) -> dict[str, Any]:
        """Where what is observed beside the state stands."""
        if not self.settings.observe:
            return {}
        x = np.ones((*(self.model.batch or (1,)), self.size))
        if self._oriented:
            x[:, self._places[ORIENTATION]] = (1, 0, 0, 0) if self.model.n == 3 else np.eye(self.model.n).ravel()
        plan = self._plan(self._scheme, self._conversions(len(x))[0](x[None])[0])
        out, start = {}, self.size
        for name, value in plan.example.items():
            if name not in self.letters:
                width = self._line(name, value).shape[-1]
                out[name] = slice(start, start + width) if value.ndim > 2 else start
                start += width
        return out


def _slices(kinds: Sequence[str], n: int) -> list[slice]:
    ends = np.cumsum([layout.coordinate_count(kind, n) for kind in kinds]).tolist()
    return [slice(end - layout.coordinate_count(kind, n), end) for end, kind in zip(ends, kinds, strict=True)]


def _finite(x: Floats) -> bool:
    return math.isfinite(x.sum()) or bool(np.isfinite(x).all())  # the sum alone may overflow


def _require_finite(x: Floats) -> None:
    if not np.isfinite(x).all():
        raise InputError("The state: expected finite numbers, got NaN or infinity.")


def _numbers(state: Any, of: Propagator) -> Floats:
    try:
        x = np.asarray(state, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        x = np.full(0, np.nan)
    if not 1 <= x.ndim <= 2 or x.shape[-1] != of.size or not x.size:
        raise InputError(
            f"The state of {of.model.system.name}: expected a mapping of {', '.join(of.letters)}, or an array of these "
            f"{of.size} numbers, ({of.size},) or (lanes, {of.size}), got {shown(state)}."
        )
    return x
