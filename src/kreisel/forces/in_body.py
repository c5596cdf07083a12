"""User-defined forces in SI units along the axes in which a body was given, as forces of its model."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.recorded import run
from kreisel.errors import InputError, hint, shown
from kreisel.forces import kicks
from kreisel.forces.kicks import COUPLING, ORIENTATION
from kreisel.record.calling import Portable, call, keywords
from kreisel.record.contract import Frame, System
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME, Force, together

MOTION = ("M", "Omega", "g", "t")  # momentum, angular velocity, orientation (body to space), time
PLACE = {
    "r": "position", "v": "velocity", "B": "field", "B_rate": "field_rate", "sun": "sun",
    "light": "light", "density": "density",
}  # fmt: skip
AXES_OF_LANES = ("body_axis_1", "body_axis_2", "body_axis_3")  # parameters: the columns of `turn`, if lanes differ
UNIT_OF_LANES = "unit_of_momentum"
NEAR = 1.0  # s: a difference over twice this time has the rate of the field to 1e-7
SCALARS = ("light", "density")


@dataclass(frozen=True, eq=False)
class InBody:
    """A torque, N m, or a potential, J, as a user-defined function of quantities of a body in SI.

    names      arguments of the function: quantities and parameters
    turn       (3, 3), v_body = turn v_state; None if it differs from lane to lane, as the unit of momentum then does
    time, momentum   units of the model, s and N m s
    """

    what: str
    function: Portable
    names: tuple[str, ...]
    params: tuple[str, ...]
    turn: Array | None
    time: float
    momentum: float | None

    def of(self, model: Model) -> Force:
        """The force of a model."""
        system, moving = model.system, model.system.frame is Frame.MOVING
        quantities = [name for name in self.names if name not in self.params]
        place = system.perturbation.environment if system.perturbation is not None else None
        by_place = [name for name in quantities if name in PLACE]
        turned = not moving or {"g", *by_place} - {*SCALARS} & {*quantities}
        letters = system.space.letters if {"M", "Omega"} & {*quantities} else ()
        timed = by_place or "t" in quantities
        arguments = (*letters, *(ORIENTATION,) * bool(turned), *(TIME,) * bool(timed))
        constants = place.parameters if place is not None and by_place else ()
        constants = (*constants, *(_of_velocity(system) if "Omega" in quantities else ()))
        constants = (*constants, *((*AXES_OF_LANES, UNIT_OF_LANES) if self.turn is None else ()))

        def force(*values: Any, **known: Any) -> Any:
            there = dict(zip(arguments, values, strict=True))
            turn = np.stack([known[k] for k in AXES_OF_LANES], -1) if self.turn is None else self.turn
            momentum = known[UNIT_OF_LANES] if self.momentum is None else self.momentum
            g = there[ORIENTATION] @ turn.T if turned else None
            state = tuple(_skew(there[letter], kind) for letter, kind in system.space.components if letters)
            body: dict[str, Any] = {"g": g}
            if timed:
                body["t"] = there[TIME] * self.time
            if letters:
                body["M"] = momentum * (turn @ there[letters[0]] if moving else there[letters[0]] @ g)
            if "Omega" in quantities:
                Omega = algebra.axial(_velocity(system, state, known))
                body["Omega"] = (turn @ Omega if moving else Omega @ g) / self.time
            if place is not None and by_place:
                at = partial(run, place.function, **place.named(known[name] for name in place.parameters))
                found = at(body["t"])
                if "B_rate" in by_place:
                    later, earlier = (at(body["t"] + h)["field"] for h in (NEAR, -NEAR))
                    found["field_rate"] = (later - earlier) / (2 * NEAR)
                body |= {name: found[PLACE[name]] if name in SCALARS else found[PLACE[name]] @ g for name in by_place}
            out = run(self.function.function, **{name: {**known, **body}[name] for name in self.names})
            return self._value(out, g, turn if moving else None, momentum)

        return Force(force, arguments, tuple(dict.fromkeys((*constants, *self.params))))

    def _value(self, out: Any, g: Any, turn: Any, momentum: Any) -> Any:
        """The value along the axes of the state, in the unit of energy of the model; turn: None in the rest frame."""
        size = momentum / self.time
        if self.what == "potential":
            return out / size
        tau = np.asarray(out, dtype=object)
        if tau.shape != (3,):
            raise InputError(f"torque: expected a vector (3,) along the body axes, N m, got shape {tau.shape}.")
        return (g @ tau if turn is None else tau @ turn) / size


@dataclass(frozen=True, eq=False)
class Several:
    """The sum of forces."""

    parts: tuple[InBody, ...]

    @property
    def params(self) -> tuple[str, ...]:
        """The parameters of all functions."""
        return tuple(dict.fromkeys(name for part in self.parts for name in part.params))

    @property
    def time(self) -> float:
        """The unit of time of the model, s."""
        return self.parts[0].time

    def of(self, model: Model) -> Force:
        """The force of a model."""
        total = together(*(part.of(model) for part in self.parts))
        assert total is not None
        return total


def in_body(what: str, function: Any, params: Mapping[str, Any], quantities: tuple[str, ...], **frame: Any) -> Any:
    """A force of these quantities and parameters by name; None without a function.  Raises `InputError`.

    A list of functions is their sum.
    """
    if function is None:
        return None
    if isinstance(function, list | tuple) and function:
        return Several(tuple(in_body(what, each, params, quantities, **frame) for each in function))
    try:
        names = tuple(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected a function such as lambda Omega: ..., got {shown(function)}.") from None
    known = (*quantities, *(name for name in params if name not in (*MOTION, *PLACE)))
    wrong = next((name for name in (*names, *params) if name not in known), None)
    if wrong is not None:
        raise InputError(
            f"{what}: expected arguments among {', '.join(known)}, got {wrong}.{hint(wrong, known)} Give other "
            "parameters as params={...}, by names that no quantity has."
        )
    return InBody(what, Portable(function), names, tuple(name for name in names if name in params), **frame)


def _skew(x: Any, kind: str) -> Any:
    return algebra.hat(x) if kind == "skew" else x


def _of_velocity(system: System) -> tuple[str, ...]:
    """The constants that the angular velocity depends on."""
    record = system.perturbation
    base = system if record is None else record.base
    function: Callable[..., Any] = base.velocity  # type: ignore[assignment]
    return (*sorted(keywords(function)), *(COUPLING,) * (record is not None and record.coupling))


def _velocity(system: System, state: tuple[Array, ...], known: Mapping[str, Any]) -> Array:
    if system.perturbation is None:
        found: Array = call(system.velocity, state, known)
        return found
    return kicks.velocity(system, state, known)
