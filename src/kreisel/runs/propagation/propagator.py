"""kr.propagator: a motion checked and compiled once, then called with NumPy arrays, for loops that call it often.

Of a system, or of a body in SI, along the axes in which it was given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained, hint, shown
from kreisel.forces.control import whole_samples
from kreisel.kernels.layout import Floats
from kreisel.method import scheme as scheme_of
from kreisel.method.scheme import ORIENTATION, Flow, Orbits
from kreisel.record.body import Body, as_body
from kreisel.record.calling import keywords
from kreisel.record.model import Model, State
from kreisel.record.values import common_batch
from kreisel.runs.in_si import duration, matrix_of, times_of
from kreisel.runs.propagation.forms import DOUBLE
from kreisel.runs.propagation.stepper import AT_ZERO, NONE, Signs, Stepper, number_of
from kreisel.runs.settings import (
    LARGE,
    MOST_STEPS,
    WHOLE,
    Settings,
    check_model,
    finite_number,
    flag,
    named,
    observed,
    positive_number,
    wanted_times,
    whole_order,
    within,
)

FEWEST, MOST_ROWS = 8, 256  # steps that are made before the quantity is checked: increasing


class Crossing(NamedTuple):
    """The end of a search: the state, the time, and whether the quantity changed its sign there."""

    state: Any
    time: float
    crossed: bool


@explained
def propagator(
    system: Model | Body,
    *,
    method: str | None = None,
    order: int | tuple[int, ...] | None = None,
    dt: Any = None,
    orientation: bool | None = None,
    observe: Sequence[str] = (),
    project: bool = True,
) -> Any:
    """The motion of a system by one method, checked and compiled once, for loops that call it often.

    system       a system with parameters, as for `kr.simulate`; method and order too.  A body of `kr.physical`: times
                 in s and states in SI, along the axes in which it was given
    dt           the step; a flow in closed form (method="exact") needs none
    orientation  whether the orientation g is part of the state; default: for a body on which forces need it
    observe      Casimirs and integrals to compute in addition to the state, by name
    project      as for `kr.simulate`

    Raises `InputError` for bad input.
    """
    body, model, oriented = as_body(system), cast("Model", system), False if orientation is None else orientation
    if body is not None:
        model = body.in_si()
        forces = model.system.perturbation
        oriented = forces is not None and forces.names(ORIENTATION) if orientation is None else orientation
        dt = None if dt is None else duration(model.body_frame, dt, "dt")
    check_model(model)
    flag(oriented, "orientation")
    flag(project, "project")
    step, order = 1.0 if dt is None else positive_number(dt, "dt"), whole_order(order)
    step = whole_samples(model, step)
    scheme = scheme_of(model, named(method, "method"), step, order, bool(oriented))
    if scheme.coupling is not None and len(observe):
        raise InputError(
            f"{model.system.name}: expected observe=() for bodies that act on each other in pairs, got "
            f"{shown(observe)}. kr.simulate observes them."
        )
    if dt is None and not isinstance(scheme.motion, Orbits):
        raise InputError(f"method={scheme.name!r} needs a step dt, got none.")
    names = observed(observe, scheme)
    settings = Settings(dt=step, steps=1, method=method, order=order, project=bool(project), observe=names)
    motion = Propagator(model, settings, bool(oriented), dt is not None)
    return motion if body is None else BodyPropagator(body, motion)


class Propagator:
    """A result of `kr.propagator`: the state `at` any times, or after `steps`.

    A state is a mapping of its components, or one array of `size` entries, (size,) or (lanes, size): the components in
    the order of `letters`; axial vectors for n = 3, else the entries of a skew matrix above the diagonal, row by row;
    the orientation as a unit quaternion (w, x, y, z) for n = 3, else as a matrix, row by row; the quaternion of a top
    by "exact" may have the other sign than in `kr.at`.  Returned states have the same form, followed by the observed
    quantities.  For arrays only shape and finiteness are checked.  Threads may share a propagator.
    """

    def __init__(self, model: Model, settings: Settings, oriented: bool, paced: bool):
        scheme = scheme_of(model, settings.method, settings.dt, settings.order, oriented)
        self.model, self._paced = model, paced  # whether a dt was given
        self._stepper = Stepper(model, scheme, settings)
        self._forms, self._by_plan = self._stepper.forms, model.n >= LARGE
        self._known_at_times = scheme.orbits is not None
        self._varied: dict[tuple[str, ...], Stepper] = {}  # for calls with parameters of these names
        self._shape = self._forms.single  # of an array that needs no other check than of its dtype
        self.letters, self.size, self.dt = self._forms.letters, self._forms.size, settings.dt
        self.places = self._forms.places  # of the components in a state (size,)

    def __reduce__(self) -> Any:  # kernels keep their addresses
        return Propagator, (self.model, self._stepper.settings, self._forms.oriented, self._paced)

    def __repr__(self) -> str:
        return f"<kreisel propagator of {self.model!r}: {self._stepper.scheme.name}>"

    @property
    def observed_places(self) -> dict[str, Any]:
        """The places of the observed quantities after the state."""
        return self._forms.observed_places

    @explained
    def steps(self, state: Any, n: int, every: int | None = None, time: float | None = None, **parameters: Any) -> Any:
        """The state after n steps of dt; with `every`, rows along a first axis: the steps 0, every, 2 every, ... and n.

        `time` at the start, for bodies with forces that depend on it (`kr.perturbed`); `work` counts from the start.
        `parameters` only of this call, by name, such as the torque of a motor.

        Raises `InputError` for a bad state or number of steps, `RunError` if the state is no longer finite or an
        invariant of the method is lost.
        """
        count = within(n, "n", 1, MOST_STEPS)
        between = None if every is None else within(every, "every", 1, count)
        stepper, changes = self._with(parameters) if parameters else (self._stepper, NONE)
        plain = type(state) is np.ndarray and state.dtype is DOUBLE and self._shape in (state.shape, state.shape[1:])
        x, batched = (state, False) if plain else self._forms.rows_of(state)
        if between is None and len(x):
            y = stepper.steps_at_once(x, count, time, changes)
            if y is not None:
                if plain and y.ndim == x.ndim:
                    return y
                y = y.reshape(-1, y.shape[-1])
                return y if plain else self._forms.returned(y, state, batched)
        x, batched = self._forms.rows_of(state) if plain else (x, batched)
        result = (
            stepper.by_a_plan(x, count, between) if self._by_plan else stepper.steps(x, count, between, time, changes)
        )
        return self._forms.returned(result, state, batched)

    def _with(self, parameters: Mapping[str, Any]) -> tuple[Stepper, Mapping[str, Array]]:
        """The stepper for calls with these parameters, and their values.  Raises `InputError`."""
        names = tuple(parameters)
        stepper = self._varied.get(names)
        if stepper is None:
            system, scheme = self.model.system, self._stepper.scheme
            fixed = {*keywords(system.derive)} if system.derive else set()
            fixed |= {p.letter for p in system.parameters if p.kind == "table"}  # whose constants are addresses
            free = [name for name in self.model.params if name in scheme.constants and name not in fixed]
            plain = scheme.trajectory is None and not self._stepper.is_flow and not self._by_plan
            if not plain or self._stepper.settings.observe or not {*names} <= {*free}:
                wrong = next((name for name in names if name not in free), names[0])
                raise InputError(
                    f"parameters of a call: expected some of {', '.join(free) or 'none'}, of a method that makes steps "
                    f"which do not depend on the start, and observe=(), got {shown(wrong)}.{hint(wrong, free)} For "
                    "others make a propagator of a body with other parameters."
                )
            stepper = Stepper(self.model, self._stepper.scheme, self._stepper.settings, names)
            self._varied[names] = stepper
        return stepper, {name: self._value(name, value) for name, value in parameters.items()}

    def _value(self, name: str, value: Any) -> Array:
        array, like = np.asarray(value, dtype=np.float64), np.shape(self._stepper.scheme.constants[name])
        shape = like[len(like) - self.model.axes[name] :]
        fits = array.shape[array.ndim - len(shape) :] == shape and array.ndim <= len(shape) + 1
        if not fits or not np.isfinite(array).all():
            raise InputError(f"{name}: expected finite values of the shape {shape}, got {shown(value)}.")
        return array

    @explained
    def at(self, state: Any, times: Any) -> Any:
        """The state at a time, or at times (times,) along a first axis, also negative; for a map, times count steps.

        Raises `InputError` for bad input and if no closed form is known, `RunError` if values overflow.
        """
        if not self._known_at_times:
            raise InputError(
                f"No closed form of method={self._stepper.scheme.name!r} for {self.model.system.name} is known here. "
                "Use .steps(state, n), or kr.simulate."
            )
        plain = type(state) is np.ndarray and state.dtype is DOUBLE and state.shape == self._shape
        x, batched = (state, False) if plain else self._forms.rows_of(state)
        if type(times) is float and (plain or len(x) == 1):
            y = self._stepper.at_once(x, times)
            if y is not None:
                return y if plain else self._forms.returned(y[None], state, batched)
        wanted = wanted_times(times)
        x, batched = self._forms.rows_of(state) if plain else (x, batched)
        result = self._stepper.at(x, wanted if wanted.ndim else wanted[None])
        return self._forms.returned(result if wanted.ndim else result[0], state, batched)

    @explained
    def to(self, state: Any, times: Any, time: float = 0.0, **parameters: Any) -> Any:
        """The state at a time, or at times (times,) along a first axis, in order, from the state at `time`.

        Uses steps of dt or a little shorter, equal from one time to the next; with a controller, of dt between the
        multiples of dt.  For rows at any times, and for impulses, which change the state between two calls.  `work`
        counts from the start.  `parameters` as for `steps`.  Raises as `steps`.
        """
        stepper = self._stepper
        if type(times) is float and type(time) is float and math.isfinite(times - time) and not stepper.is_flow:
            self._require_steps("to")
            count = stepper.whole_steps(time, times)
            if count is not None:
                return self.steps(state, count, time=time if stepper.timed else None, **parameters)
        wanted, now = wanted_times(times), finite_number(time, "time")
        when = np.atleast_1d(wanted)
        if (np.diff(when, prepend=now) < 0).any():
            raise InputError(f"times: expected times in order, from time = {now:g} on, got {shown(times)}.")
        x, batched = self._forms.rows_of(state)
        if self._stepper.is_flow:
            return self.at(state, wanted - now)
        self._require_steps("to")
        stepper, changes = self._with(parameters) if parameters else (self._stepper, NONE)
        z, out = self._forms.prepared(x), []
        for t in when.tolist():
            z, now = stepper.walked(z, now, t, changes), t
            out.append(stepper.returned(z, t))
        return self._forms.returned(np.array(out) if wanted.ndim else out[0], state, batched)

    @explained
    def until(
        self, state: Any, quantity: Callable[[Any], Any], end: float, *, time: float = 0.0, rising: bool | None = None
    ) -> Crossing:
        """The state at which a quantity first changes its sign, its time, and whether it did before the time `end`.

        quantity  a function of one state in the form of `state`, `lambda x: x["a"][2]`
        rising    True, False: only a change upward, downward; None: both

        The quantity is checked after each step, so two changes within a step are missed; the time is found to rounding
        by shorter steps from the step before.  A start at 0 is on the side to which the first step goes.  For an event
        that acts (a bounce, a thruster), change the state and call again.  Raises as `steps`.
        """
        begun, last = finite_number(time, "time"), finite_number(end, "end")
        if rising is not None:
            flag(rising, "rising")
        if not callable(quantity) or last < begun:
            raise InputError(
                f"until: expected a function of the state and an end from time = {begun:g} on, got {shown(quantity)}, "
                f"{shown(end)}."
            )
        x, batched = self._forms.rows_of(state)
        if batched and self._stepper.scheme.coupling is None:
            raise InputError(f"until: expected one state, got {len(x)} lanes. Call it for each.")
        if not self._stepper.is_flow:
            self._require_steps("until")
        elif not self._paced:
            raise InputError(
                "until: expected kr.propagator(..., dt=...), which states how often the quantity is evaluated, got "
                "none."
            )

        def form(z: Floats, t: float) -> Any:
            return self._forms.returned(self._stepper.returned(z, t), state, batched)

        def values(z: Floats, t: float) -> Floats:
            return np.array([number_of(quantity, form(z, t), "until")])

        side = None if rising is None else bool(rising)
        signs = Signs(values, self._stepper.step, (side,), self._stepper.least)
        z, t, crossed = _first_crossing(self._stepper, self._forms.prepared(x), signs, begun, last)
        return Crossing(form(z, t), t, crossed)

    def _require_steps(self, call: str) -> None:
        scheme = self._stepper.scheme
        order = scheme.options.get("order")
        if scheme.corrector is not None or (scheme.name == "suris" and order == 2):
            use = "order=(8, 2) or (8, 6, 4)" if scheme.corrector else "method='baecklund', or order=1"
            raise InputError(
                f"{call}: expected a method whose steps may differ, got method={scheme.name!r} of order {order}, whose "
                f"variables depend on dt. Use {use}."
            )
        if self._by_plan or isinstance(scheme.motion, Flow):
            raise InputError(
                f"{call}: expected a method that makes steps, or a closed form, and n < {LARGE}, got "
                f"method={scheme.name!r}, n = {self.model.n}. Use kr.simulate."
            )


def _first_crossing(stepper: Stepper, z: Floats, signs: Signs, time: float, end: float) -> tuple[Floats, float, bool]:
    """The state at which a quantity first changes its sign after `time`, or the state at `end`."""
    stepper.require_reach(time, end)
    time = stepper.on_grid(time)
    h = stepper.to_sample(time) or stepper.dt
    ahead = signs.values(stepper.step(z, time, h), time + h)
    values, block = signs.begin(z, time), FEWEST
    if abs(values[0]) <= AT_ZERO * max(abs(values[0]), abs(ahead[0])):
        signs.sides[0] = 0.0  # the last search ended here, at a value of rounding
    while end - time > stepper.least / 2:
        pace = stepper.to_sample(time) or stepper.dt
        left = (end - time) / pace * (1 - WHOLE)
        most = min(block, math.floor(left)) if pace == stepper.dt else 1
        count, h = (most, pace) if left >= 1 else (1, end - time)
        rows, block = stepper.stepped(z, time, h, count, 1), min(2 * block, MOST_ROWS)
        for k, row in enumerate(rows[1:]):
            begun = time + k * h
            if signs.changed(signs.values(row, time + (k + 1) * h)):
                after = signs.place(0, rows[k], begun, h)
                return stepper.step(rows[k], begun, after), begun + after, True
        z, time = rows[-1], end if left < 1 else stepper.on_grid(time + count * h)
    return z, end, False


class BodyPropagator:
    """The motion of a body at any times, or after `steps`, in SI.

    A state is a mapping of `names`, a state of `body.state(...)`, or one array of `size` entries, (size,) or (lanes,
    size), in the order of `names`: momenta and other vectors along the axes in which the body was given, the attitude
    as a unit quaternion (w, x, y, z).  Returned states have the same form, followed by the observed quantities.  Times
    are in s or with units, "1 ms"; `dt` is in s.  Threads may share a propagator.
    """

    def __init__(self, body: Body, motion: Propagator):
        frame = motion.model.body_frame
        self._body, self._motion, self._frame, self._unit = body, motion, frame, frame.time_unit
        self.model, self.size, self.dt = motion.model, motion.size, motion.dt * self._unit
        self._places = {frame.names.get(k, k): (k, place) for k, place in motion.places.items()}
        self.names = tuple(self._places)
        self._numbers = {letter for letter, kind in motion.model.system.space.components if kind == "scalar"}
        self._into, self._out = (self._map(forward) for forward in (False, True))

    def __repr__(self) -> str:
        return f"<kreisel propagator of {self._frame.title}: {self._motion!r}>"

    def _time(self, value: Any, name: str = "") -> Any:
        """Times in the unit of the model; with a name, one time."""
        if type(value) is float:
            return value / self._unit
        scaled = times_of(self.model, value) if not name else np.array(duration(self._frame, value, name))
        return scaled if scaled.ndim else float(scaled)

    def _map(self, forward: bool) -> Array:
        """The linear map of states ([lanes,] size), from the right, to SI (forward) or back.

        (size,) if it is diagonal; if lanes differ ([lanes,] size, size).
        """
        matrices = {k: matrix_of(self._frame, k, p.stop - p.start, forward) for k, p in self._places.values()}
        out = np.zeros((*next(iter(matrices.values())).shape[:-2], self.size, self.size))
        for letter, place in self._places.values():
            out[..., place, place] = matrices[letter]
        return np.diagonal(out).copy() if out.ndim < 3 and np.array_equal(out, np.diag(np.diagonal(out))) else out

    def _in_model_units(self, state: Any) -> Any:
        """A state in the units and along the axes of the model.  Raises `InputError`."""
        if type(state) is np.ndarray and state.dtype == np.float64:
            return self._changed(state, self._into)
        if not isinstance(state, Mapping):  # a `State` is one
            return self._changed(algebra.floats(state), self._into)
        if isinstance(state, State):
            named: dict[str, Any] = {**state.axial, ORIENTATION: state.orientation}
        elif missing := [name for name in self.names if name not in state]:
            raise InputError(f"The state: expected {', '.join(self.names)}, got none for {', '.join(missing)}.")
        elif further := [name for name in state if name not in (*self.names, *self._motion.observed_places)]:
            close = hint(further[0], self.names)
            raise InputError(
                f"The state: expected {', '.join(self.names)}, got {shown(further[0])} too.{close} The attitude is "
                "carried with orientation=True, wheels and memory if the body has them."
            )
        else:
            named = {letter: state[name] for name, (letter, _) in self._places.items()}
        parts = []
        for name, (letter, place) in self._places.items():
            x = algebra.floats(named[letter])
            parts.append(x[..., None] if letter in self._numbers else x)
            if parts[-1].shape[-1:] != (size := place.stop - place.start,):
                raise InputError(f"The state: expected {size} values of {name}, or (lanes, {size}), got {shown(x)}.")
        batch = common_batch("the state", {name: x.shape[:-1] for name, x in zip(self.names, parts, strict=True)})
        if any(x.shape[:-1] != batch for x in parts):  # the attitude or the momentum may be that of all lanes
            parts = [np.broadcast_to(x, (*batch, *x.shape[-1:])) for x in parts]
        x = np.concatenate(parts, -1)
        return x if isinstance(state, State) else self._changed(x, self._into)  # a `State` is in units of the model

    def _changed(self, x: Array, by: Array) -> Array:
        if x.shape[-1:] != (self.size,):
            raise InputError(
                f"The state: expected a mapping of {', '.join(self.names)}, or an array of these {self.size} values, "
                f"({self.size},) or (lanes, {self.size}), got {shown(x)}."
            )
        return x * by if by.ndim == 1 else x @ by if by.ndim == 2 else (x[..., None, :] @ by)[..., 0, :]

    def _parameters(self, parameters: dict[str, Any]) -> dict[str, Any]:
        """Parameters of a call, with vectors of the body along the axes of the model."""
        for name in parameters.keys() & self._body.vectors:
            try:
                v = np.asarray(parameters[name], dtype=np.float64)
            except (TypeError, ValueError):  # such as "1 A m^2"
                v = np.empty(0)
            if v.shape[-1:] != (3,):
                raise InputError(
                    f"{name}: expected a vector (3,) of values in SI units along the axes of the body, got "
                    f"{shown(parameters[name])}."
                )
            parameters[name] = self._frame.inside(v)
        return parameters

    def _returned(self, x: Array, state: Any) -> Any:
        """Entries of the model (..., size + observed) in the form in which a state was given."""
        out, observed_places = self._changed(x[..., : self.size], self._out), self._motion.observed_places
        if x.shape[-1] > self.size:
            out = np.concatenate([out, x[..., self.size :]], -1)
            for name, place in observed_places.items():
                size = self._frame.size(name)
                out[..., place] *= size[:, None] if np.ndim(size) == 1 and not isinstance(place, int) else size
        if not isinstance(state, Mapping):
            return out
        named = {
            name: out[..., place.start if letter in self._numbers else place]
            for name, (letter, place) in self._places.items()
        }
        return named | {name: out[..., place] for name, place in observed_places.items()}

    @explained
    def steps(self, state: Any, n: int, every: int | None = None, time: Any = None, **parameters: Any) -> Any:
        """The state after n steps of dt, as `Propagator.steps`; `parameters` such as dipole along the axes given."""
        begun, values = None if time is None else self._time(time, "time"), self._parameters(parameters)
        return self._returned(self._motion.steps(self._in_model_units(state), n, every, begun, **values), state)

    @explained
    def at(self, state: Any, times: Any) -> Any:
        """The state at a time, or at times (times,) along a first axis, as `Propagator.at`."""
        return self._returned(self._motion.at(self._in_model_units(state), self._time(times)), state)

    @explained
    def to(self, state: Any, times: Any, time: Any = 0.0, **parameters: Any) -> Any:
        """The state at a time, or at times in order, from the state at `time`, as `Propagator.to`."""
        ends, begun, values = self._time(times), self._time(time, "time"), self._parameters(parameters)
        return self._returned(self._motion.to(self._in_model_units(state), ends, begun, **values), state)

    @explained
    def until(
        self, state: Any, quantity: Callable[[Any], Any], end: Any, *, time: Any = 0.0, rising: bool | None = None
    ) -> Crossing:
        """The state at which a quantity of the state, in SI, first changes its sign, as `Propagator.until`."""

        def measure(x: Array) -> Any:
            return quantity(self._returned(x, state))

        begun, last = self._time(time, "time"), self._time(end, "end")
        result = self._motion.until(self._in_model_units(state), measure, last, time=begun, rising=rising)
        return Crossing(self._returned(result.state, state), result.time * self._frame.time_unit, result.crossed)

    def __reduce__(self) -> Any:  # kernels keep their addresses
        return BodyPropagator, (self._body, self._motion)
