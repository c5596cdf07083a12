"""User-defined forces in SI units along the axes in which a body was given, as forces of its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial, reduce
from operator import add
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.recorded import run
from kreisel.errors import InputError
from kreisel.forces import kicks
from kreisel.forces.kicks import COUPLING, ORIENTATION
from kreisel.record.calling import Portable, arguments_of, call, keywords
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.record.perturbation import FIELDS, TIME, Force

MOTION = ("M", "Omega", "g", "t")  # momentum, angular velocity, orientation (body to space), time
RATE = "B_rate"  # of the field along the orbit
PLACE = (*(field.symbol for field in FIELDS.values()), RATE)
AXES_OF_LANES = ("body_axis_1", "body_axis_2", "body_axis_3")  # parameters: the columns of `axes`, if lanes differ
UNIT_OF_LANES = "unit_of_momentum"
NEAR = 1.0  # s: a difference over twice this time has the rate of the field to 1e-7


@dataclass(frozen=True, eq=False)
class InBody:
    """A torque, N m, or a potential, J: the sum of user-defined functions of quantities of a body in SI.

    functions  with the names of their arguments: quantities, and `params`
    axes       (3, 3), v_body = axes v_state; None if it differs from lane to lane, as the unit of momentum then does
    time, momentum   units of the model, s and N m s
    """

    kind: str
    functions: tuple[tuple[Portable, tuple[str, ...]], ...]
    params: tuple[str, ...]
    axes: Array | None
    time: float
    momentum: float | None

    def of(self, model: Model) -> Force:
        """The force of a model."""
        system, record, moving = model.system, model.system.perturbation, model.system.frame is Frame.MOVING
        names = {name for _, arguments in self.functions for name in arguments} - {*self.params}
        place = record.environment if record is not None and not names.isdisjoint(PLACE) else None
        vectors = {"g", RATE, *(field.symbol for field in FIELDS.values() if field.shape)}
        turned = not moving or bool(vectors & names)
        letters = system.space.letters if {"M", "Omega"} & names else ()
        arguments = (*letters, *(ORIENTATION,) * turned, *(TIME,) * (place is not None or "t" in names))
        constants = [*(place.parameters if place is not None else ())]
        if "Omega" in names:
            base = system if record is None else record.base
            constants += [*sorted(keywords(base.velocity)), *[COUPLING] * (record is not None and record.coupling)]  # type: ignore[arg-type]
        constants += [*AXES_OF_LANES, UNIT_OF_LANES] if self.axes is None else []

        def force(*values: Any, **constants: Any) -> Any:
            by_name = dict(zip(arguments, values, strict=True))
            axes = np.stack([constants[k] for k in AXES_OF_LANES], -1) if self.axes is None else self.axes
            momentum = constants[UNIT_OF_LANES] if self.momentum is None else self.momentum
            body = dict[str, Any]()
            if turned:
                g = body["g"] = by_name[ORIENTATION] @ axes.T
            if TIME in by_name:
                body["t"] = by_name[TIME] * self.time
            if letters:
                body["M"] = momentum * (axes @ by_name[letters[0]] if moving else by_name[letters[0]] @ g)
            if "Omega" in names:
                state = tuple(
                    algebra.hat(by_name[letter]) if kind == "skew" else by_name[letter]
                    for letter, kind in system.space.components
                )
                velocity = (
                    call(system.velocity, state, constants)
                    if record is None
                    else kicks.velocity(system, state, constants)
                )
                Omega = algebra.axial(velocity)
                body["Omega"] = (axes @ Omega if moving else Omega @ g) / self.time
            if place is not None:
                at = partial(run, place.function, **place.named(constants[name] for name in place.parameters))
                result = {FIELDS[name].symbol: value for name, value in at(body["t"]).items()}
                if RATE in names:
                    later, earlier = (at(body["t"] + h)["field"] for h in (NEAR, -NEAR))
                    result[RATE] = (later - earlier) / (2 * NEAR)
                body |= {k: result[k] @ g if k in vectors else result[k] for k in PLACE if k in names}
            parts = []
            for function, wanted in self.functions:
                out = np.asarray(run(function.function, **{k: {**constants, **body}[k] for k in wanted}), dtype=object)
                if self.kind == "torque":
                    if out.shape != (3,):
                        raise InputError(
                            f"torque: expected a vector (3,) along the body axes, N m, got shape {out.shape}."
                        )
                    out = out @ axes if moving else g @ out
                parts.append(out[()] / (momentum / self.time))
            return reduce(add, parts)

        return Force(force, arguments, tuple(dict.fromkeys([*constants, *self.params])))


def in_body(kind: str, function: Any, params: Mapping[str, Any], quantities: tuple[str, ...], **frame: Any) -> Any:
    """A force of these quantities and parameters by name; None without a function.  Raises `InputError`.

    A list of functions is their sum.
    """
    if function is None:
        return None
    several = function if isinstance(function, list | tuple) and function else [function]
    allowed = (*quantities, *(name for name in params if name not in (*MOTION, *PLACE)))
    remedy = "Give other parameters as params={...}, by names that no quantity has."
    functions = [(Portable(function), arguments_of(function, allowed, kind, remedy)) for function in several]
    used = tuple(dict.fromkeys(name for _, names in functions for name in names if name in params))
    return InBody(kind, tuple(functions), used, **frame)
