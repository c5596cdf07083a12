"""Bodies of one kind as the lanes of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, shown
from kreisel.physical.forced import Forced, by_functions
from kreisel.record.body import Body, started
from kreisel.record.given import axes_of
from kreisel.record.model import Model, State
from kreisel.runs.operations import operations_of


@explained
class Ensemble(Body):
    """Bodies of one kind, each with numbers, orbit and forces' parameters of its own: the lanes of a run.

        many = Ensemble([Satellite(inertia, orbit, magnetic_moment=m) for m in moments])
        run = kr.simulate(many, many.state(spin), dt="10 s", t_end="1 day")

    `Ensemble.of(Satellite, count, inertia=..., orbit=...)` creates them from arguments, each one value for all or a
    list with a value for each lane.  Raises `InputError` with the lane for a body that cannot be, and for bodies whose
    systems, plates, principal axes or units differ.
    """

    def __init__(self, bodies: Sequence[Any]):
        self.bodies = tuple(bodies)
        if not self.bodies or not all(isinstance(body, Body) for body in self.bodies):
            raise InputError(f"Ensemble: expected a list of bodies of kr.physical, got {shown(bodies)}.")
        self.model()

    @classmethod
    def of(cls, kind: Callable[..., Any], count: int, **arguments: Any) -> Ensemble:
        """The ensemble of kind(**arguments) in `count` lanes; an argument with that many entries has one for each."""
        if not arguments or not any(_by_lane(name, value, count) for name, value in arguments.items()):
            raise InputError(f"Ensemble: expected an argument with {count} entries, got none.")
        return cls(_each(count, lambda **each: kind(**each), arguments))

    def model(self) -> Model:
        """The common system, with the parameters of each lane."""
        return self._model

    @cached_property
    def _model(self) -> Model:
        models = _each(len(self.bodies), lambda body: body.model(), {"body": list(self.bodies)})
        first = models[0]
        for lane, model in enumerate(models):
            if model.system.name != first.system.name:
                raise InputError(f"Lane {lane}: expected the system {first.system.name}, got {model.system.name}.")
            if _frame(model) != _frame(first):
                raise InputError(
                    f"Lane {lane}: expected the principal axes and units of lane 0, {shown(_frame(first))}, got "
                    f"{shown(_frame(model))}. Give diagonal tensors, and bodies in SI, such as Satellite."
                )
            same = _functions(self.bodies[lane]) == _functions(self.bodies[0])
            if not same and operations_of(model) != operations_of(first):
                raise InputError(
                    f"Lane {lane}: expected the functions of lane 0, which act in all lanes, got others. Numbers that "
                    "differ are params={...} of forces, parameters={...} of a Control; its every and delay are common."
                )
        params = {}
        for p in first.system.parameters:
            values = [model.params[p.letter] for model in models]
            same = all(np.array_equal(value, values[0]) for value in values)
            if not same and p.kind == "array":
                lane = next(i for i, value in enumerate(values) if not np.array_equal(value, values[0]))
                raise InputError(f"Lane {lane}: expected the {p.letter} of lane 0, which all lanes share, got others.")
            params[p.letter] = values[0] if same else np.stack(values).reshape(len(values), *np.shape(values[0]))
            if not same and axes_of(p, values[0]) == 0:
                params[p.letter] = np.reshape(values, len(values))
        return Model(first.system, params, first.body_frame)

    def state(self, *args: Any, **kwargs: Any) -> State:
        """The states of the bodies; an argument that has one entry for each lane, with axes of its own, is spread."""
        count = len(self.bodies)
        names = {**{str(i): value for i, value in enumerate(args)}, **kwargs, "body": list(self.bodies)}

        def of_lane(body: Any, **each: Any) -> State:
            places = [each.pop(str(i)) for i in range(len(args))]
            state: State = body.state(*places, **each)
            return state

        states = _each(count, of_lane, names)
        parts = {letter: np.stack([state[letter] for state in states]) for letter in states[0]}
        starts = [state.orientation for state in states]
        return started(self._model, None if starts[0] is None else np.stack(starts), **parts)

    @property
    def words(self) -> dict[str, str]:
        """The names of the variables of a run in SI, by the letters of the state."""
        return self.bodies[0].words

    @property
    def title(self) -> str:
        """The name of the bodies in the title of their runs."""
        return f"{len(self.bodies)} of {self.bodies[0].title}"


def _frame(model: Model) -> dict[str, Any]:
    return {} if model.body_frame is None else model.body_frame.table


def _functions(body: Any) -> tuple[Any, ...]:
    """The functions of a body and what else is said about them: bodies with equal ones share their operations."""
    control = getattr(body, "control", None)
    out = () if control is None else (control.law, control.every, control.delay, *control.noise, *control.limits)
    if isinstance(body, Forced):
        out += (body.torque if by_functions(body.torque) else None, body.potential, body.damping is None)
    return out


def _by_lane(name: str, value: Any, count: int) -> bool:
    """Whether a value has an entry for each lane: a list, unless it is a vector (3,) or an attitude (4,)."""
    if isinstance(value, str | Mapping) or not hasattr(value, "__len__") or len(value) != count:
        return False
    flat = isinstance(value[0], float | int | str | np.generic)
    return not flat or count != (4 if name == "attitude" else 3)


def _each(count: int, made: Callable[..., Any], arguments: Mapping[str, Any]) -> list[Any]:
    """made(**arguments) of each lane.  Raises `InputError` with the lane."""
    out = []
    for lane in range(count):
        try:
            out.append(made(**{k: v[lane] if _by_lane(k, v, count) else v for k, v in arguments.items()}))
        except InputError as error:
            raise InputError(f"Lane {lane}: {error}") from error
    return out
