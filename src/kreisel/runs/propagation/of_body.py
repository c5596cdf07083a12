"""kr.propagator: of a system, or of a body in SI, along the axes in which it was given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained, hint, shown
from kreisel.method.observing import ORIENTATION
from kreisel.record.body import Body, as_body
from kreisel.record.model import Model, State
from kreisel.runs.in_si import duration, matrix_of, times_of
from kreisel.runs.propagation.propagator import Crossing, Propagator, of_model


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
    body = as_body(system)
    if body is None:
        return of_model(system, method, order, dt, False if orientation is None else orientation, observe, project)
    model = body.in_si()
    forces = model.system.perturbation
    oriented = forces is not None and bool(forces.names(ORIENTATION)) if orientation is None else orientation
    step = None if dt is None else duration(model.body_frame, dt, "dt")
    return BodyPropagator(body, of_model(model, method, order, step, oriented, observe, project))


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
        elif further := [name for name in state if name not in self.names and name not in self._motion.beside]:
            close = hint(further[0], self.names)
            raise InputError(
                f"The state: expected {', '.join(self.names)}, got {shown(further[0])} too.{close} The attitude is "
                "carried with orientation=True, wheels and memory if the body has them."
            )
        else:
            named = {letter: state[name] for name, (letter, _) in self._places.items()}
        arrays = {letter: algebra.floats(named[letter]) for letter in self._motion.letters}
        parts = [array[..., None] if letter in self._numbers else array for letter, array in arrays.items()]
        if isinstance(state, State):  # in units of the model; its attitude or its momentum may be that of all lanes
            lanes = np.broadcast_shapes(*(x.shape[:-1] for x in parts))
            return np.concatenate([np.broadcast_to(x, (*lanes, x.shape[-1])) for x in parts], -1)
        return self._changed(np.concatenate(parts, -1), self._into)

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
        out, beside = self._changed(x[..., : self.size], self._out), self._motion.beside
        if x.shape[-1] > self.size:
            out = np.concatenate([out, x[..., self.size :]], -1)
            for name, place in beside.items():
                size = self._frame.size(name)
                out[..., place] *= size[:, None] if np.ndim(size) == 1 and not isinstance(place, int) else size
        if not isinstance(state, Mapping):
            return out
        named = {
            name: out[..., place.start if letter in self._numbers else place]
            for name, (letter, place) in self._places.items()
        }
        return named | {name: out[..., place] for name, place in beside.items()}

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
