"""The record of a perturbed system: flow, energy and velocity of the integrable part and of the forces together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.forces import kicks
from kreisel.forces.kicks import COUPLING, ORIENTATION, Body
from kreisel.record.calling import call, naming
from kreisel.record.contract import ClosedForm, Frame, System
from kreisel.record.perturbation import TIME, Perturbation

# Claims about the integrable part only.
UNKNOWN: dict[str, Any] = {
    "invariant": {},
    "commuting": (),
    "lax": None,
    "inverse_inertia": None,
    "spin": None,
    "map": None,
    "baecklund": None,
    "pairs": None,
    "exact_map": None,
    "relations": (),
    "closed_form": ClosedForm(),
    "body_frame": None,
    "notes": "",
}


def perturbed_record(record: Perturbation, axes: Mapping[str, int], **stated: Any) -> System:
    """The system of these forces; `axes` of each constant, without axes of lanes; `stated`: fields of the record."""
    system = replace(record.base, **{**UNKNOWN, **stated}, perturbation=record)
    names = (*axes, *(letter for letter in (ORIENTATION, TIME) if record.names(letter)))
    named: dict[str, Any] = {kind: naming(f, names) for kind, f in _functions(system, axes).items()}
    return replace(system, **named)


def _functions(system: System, axes: Mapping[str, int]) -> dict[str, Callable[..., Any]]:
    """Flow, energy and velocity of the perturbed system, as far as the integrable system has them."""
    record = kicks.perturbation_of(system)
    base, count = record.base, len(record.base.space.letters)
    turned = base.frame is Frame.REST and (record.loaded or record.damping or record.names(ORIENTATION))

    def body(state: tuple[Array, ...], constants: Mapping[str, Any]) -> Body:
        return Body(system, state, constants, axes, constants.get(ORIENTATION), constants.get(TIME))

    def flow(*state: Array, **constants: Any) -> tuple[Array, ...]:
        rates, _ = kicks.rates(body(state, constants))
        inner = call(base.flow, state[:count], constants)
        return (*(x + y for x, y in zip(inner, rates, strict=False)), *rates[count:])

    def energy(*state: Array, **constants: Any) -> Array:
        V, _ = kicks.potential(body(state, constants))
        out = call(base.energy, state[:count], constants) + V
        if record.inertia:
            M = algebra.axial(state[0])
            out = out + algebra.dot(M * M, kicks.inverse_moments(system, constants)) / 2
        if record.coupling:
            out = out + algebra.dot(algebra.axial(state[0]), algebra.act(constants[COUPLING], state[1]))
        return out + kicks.energy_of_spin(body(state, constants)) if turned else out

    def velocity(*state: Array, **constants: Any) -> Array:
        return kicks.velocity(body(state, constants))

    def translation(*state: Array, **constants: Any) -> Array:
        return kicks.translation(body(state, constants))

    result = {"flow": flow, "energy": energy, "velocity": velocity, "translation": translation}
    return {kind: function for kind, function in result.items() if getattr(base, kind) is not None}
