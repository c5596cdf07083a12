"""Methods by name: `records` has the claims of each; its file is imported when it is first used."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kreisel.algebra.reuse import Identity, reused
from kreisel.errors import InputError, hint, shown
from kreisel.method.records import METHODS, Method
from kreisel.method.scheme import Outcome, Scheme, held_by_orientation
from kreisel.record.model import Model

__all__ = ["METHODS", "Method", "Outcome", "Scheme", "default_method", "find", "scheme"]


def default_method(model: Model, stepped: bool = False) -> str:
    """The name of the first of the methods that suit a model; `stepped`: of those that make steps."""
    fitting = (m.name for m in METHODS.values() if m.may_be_default(model) and (m.steps or not stepped))
    return next(fitting, "dop853")  # which then states the data that it lacks


def find(name: Any) -> Method:
    """The method of that name.  Raises `InputError` with the nearest name."""
    if not isinstance(name, str):
        raise InputError(f"method: expected a name, one of {', '.join(METHODS)}, got {shown(name)}.")
    if name not in METHODS:
        raise InputError(
            f"method: expected one of {', '.join(METHODS)}, got {shown(name)}.{hint(name, METHODS)} "
            "kr.methods() states the use of each."
        )
    return METHODS[name]


def scheme(model: Model, method: str | None, dt: float, order: Any, oriented: bool, kept: bool = True) -> Scheme:
    """The scheme of that name, kept for the next time.

    Raises `InputError` for a wrong name or order, and where the method does not apply.
    """
    record = find(default_method(model, stepped=order is not None) if method is None else method)
    record.check(model)
    system, forces = model.system, model.system.perturbation
    if oriented and system.velocity is None and (system.map is None or system.map.generator is None):
        raise InputError(
            f"orientation: expected a body that rotates, got {system.name}, which has no orientation. Leave it out."
        )
    order = record.order(order)
    if forces is not None and forces.sampled and record.name != "splitting":
        raise InputError(
            f"method: expected 'splitting', which calls the controller of {system.name}, got {shown(record.name)}."
        )
    if forces is not None and forces.sampled and kept:
        from kreisel.forces.control import require_whole_samples

        require_whole_samples(model, dt)
    key = model.key, Scheme, record.name, dt, order, oriented

    def make() -> Scheme:
        scheme = record.make(model, dt, order, oriented)
        shared = scheme.dt_in_constants and not scheme.deformed  # the projection needs conserved variables
        in_motion = order if scheme.order_in_motion is None else (scheme.order_in_motion, scheme.stage_count > 1)
        return replace(
            scheme,
            held=scheme.held or held_by_orientation(model, scheme.components),
            definition_key=key,
            kernel_key=(model.key, record.name, in_motion, oriented) if shared else key,
            structure=_structure(model, scheme),
        )

    return reused(key if kept else None, make)


def _structure(model: Model, scheme: Scheme) -> tuple[Any, ...] | None:
    """`Scheme.structure`; None if values of parameters may be in the code of the scheme."""
    by_values = scheme.parameters_in_motion is None or scheme.coupling is not None
    if by_values or not model.constants.keys() <= scheme.constants.keys():
        return None
    numbers = {**scheme.constants, **scheme.stages}
    shapes = tuple((name, np.shape(value)[np.ndim(value) - scheme.axes[name] :]) for name, value in numbers.items())
    outcomes = tuple((name, outcome.conserved) for name, outcome in scheme.outcomes.items())
    return Identity(model.system), model.n, scheme.components, shapes, outcomes, scheme.parameters_in_motion
