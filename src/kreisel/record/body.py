"""A body in SI units: the interface by which runs accept it in place of a system."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from kreisel import algebra
from kreisel.algebra.random import GENERATOR, streams_from
from kreisel.errors import InputError, explained
from kreisel.record.calling import call
from kreisel.record.model import Model, State
from kreisel.record.units import Scales

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@explained
class Body:
    """A body of `kr.physical`, in SI units.

    `kr.simulate(body, body.state(...), dt="1 ms", t_end="60 s")` returns a run in SI, with vectors along the axes in
    which the body was given.  `model()` is the scaled system with which kernels compute it.
    """

    vectors: ClassVar[tuple[str, ...]] = ()  # parameters of the model along the axes of the body

    _shape: tuple[Any, ...] = ()
    _time: float | None = None  # the unit of time of an ensemble, s
    _lanes: tuple[Any, ...] = ()  # the bodies of an ensemble whose lanes differ in axes, units or forms of their system

    def _as_lane(self, lanes: tuple[Any, ...], differs: bool) -> Self:
        """The body as one of the lanes, in the first one's unit of time; `differs`: in axes, units or systems."""
        natural = getattr(self, "time_unit", None)
        time = getattr(lanes[0], "time_unit", natural)
        if time == natural and not differs:
            return self
        out, declared = object.__new__(type(self)), {field.name for field in fields(self)}  # type: ignore[arg-type]
        out.__dict__.update({k: v for k, v in self.__dict__.items() if k in declared or k == "_shape"})
        out.__dict__.update(
            {"time_unit" if "time_unit" in declared else "_time": time, "_lanes": lanes if differs else ()}
        )
        return out

    def shaped(self, kind: str, half: Any) -> Self:
        """The body itself, with a shape that figures draw: `BodyFrame.shape`."""
        object.__setattr__(self, "_shape", (kind, *(float(v) for v in half)))
        return self

    def _varied(self, changes: Sequence[Mapping[str, Any]]) -> Body:
        """The bodies with values changed by functions of them, such as of "orbit.inclination", as lanes."""
        raise InputError(f"expected a body whose values can vary, got {type(self).__name__}.")

    def _doubts(self, seconds: float) -> Sequence[str]:
        """Sentences on models of the body that do not hold for so long."""
        return doubts_of_end(self.model(), seconds)

    @staticmethod
    def _doubts_of(bodies: Sequence[Any], run: Any) -> Sequence[str]:
        """Sentences on rows of a run of these bodies, its lanes, for which their model does not hold."""
        return ()

    def model(self) -> Model:
        """The scaled system, with the axes and units of the body."""
        raise NotImplementedError

    def state(self, *args: Any, **kwargs: Any) -> State:
        """The initial state from quantities in SI."""
        raise NotImplementedError

    def dt(self, duration: Any) -> float:
        """A duration, s, in the unit of time of the scaled system."""
        raise NotImplementedError

    def scales(self) -> Scales:
        """The units of the variables of the scaled system."""
        raise NotImplementedError

    @property
    def words(self) -> dict[str, str]:
        """The names of the variables of a run in SI, by the letters of the state."""
        fluid = "P" in self.model().system.space.letters and self.model().system.translation is not None
        momentum = "angular_momentum" if fluid else "momentum"
        return {"M": momentum, "m": momentum, "a": "axis", "P": "linear_momentum" if fluid else "up", "g": "attitude"}

    @property
    def parameters_in_si(self) -> dict[str, Any]:
        """Values of parameters of `in_si()` that its model does not have, by name."""
        return {}

    def _scaled(self, parameters: dict[str, Any]) -> dict[str, Any]:
        """Parameters of `in_si()` for parameters in SI."""
        return parameters

    def in_si(self) -> Model:
        """The model whose runs are in SI."""
        model = self.model()
        frame = model.body_frame
        letters = (*model.system.space.letters, "g")
        return model.of_body(
            replace(
                frame, names={k: v for k, v in self.words.items() if k in letters}, title=self.title, shape=self._shape
            )
        )

    @property
    def title(self) -> str:
        """The name of the body in the title of its runs."""
        first, *others = re.findall("[A-Z][a-z]*", type(self).__name__)
        return " ".join([first, *(word.lower() for word in others)])


def doubts_of_end(model: Model, seconds: float) -> Sequence[str]:
    """Sentences on models of a body that do not hold until the end of a run."""
    lasting, end = model.system.checks.lasting, {"epoch": model.body_frame.epoch, "seconds": seconds}
    return () if lasting is None else tuple(call(lasting, (), {**model.params, **end}))


def started(model: Model, orientation: Any, /, **components: Any) -> State:
    """The state of a body with these components and the orientation with which its run begins, or None."""
    first = None if orientation is None else algebra.floats(orientation)
    return model.state(**components).started(first, model.body_frame)


def joined(model: Model, states: Sequence[State]) -> State:
    """The states of bodies as lanes; equal generators of noise get streams of their own."""
    parts = {letter: np.stack([state[letter] for state in states]) for letter in states[0]}
    if GENERATOR in parts and (parts[GENERATOR] == parts[GENERATOR][0]).all():
        parts[GENERATOR] = streams_from([int(v) for v in parts[GENERATOR][0]], len(states), 0)
    starts = [state.orientation for state in states if state.orientation is not None]
    return started(model, np.stack(starts) if starts else None, **parts)


def as_body(subject: Any) -> Body | None:
    """The body, or None for anything else.  Raises `InputError` for a class of bodies."""
    if isinstance(subject, type) and issubclass(subject, Body):
        raise InputError(f"expected a body with its data, got the class {subject.__name__}: {subject.__name__}(...).")
    return subject if isinstance(subject, Body) else None


def model_of(subject: Any) -> Any:
    """The model of a body, whose runs are in SI; anything else is returned unchanged."""
    body = as_body(subject)
    return subject if body is None else body.in_si()
