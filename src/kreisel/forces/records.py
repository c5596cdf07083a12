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
    made = replace(record.base, **{**UNKNOWN, **stated}, perturbation=record)
    names = (*axes, *(letter for letter in (ORIENTATION, TIME) if record.names(letter)))
    named: dict[str, Any] = {what: naming(f, names) for what, f in _functions(made, axes).items()}
    return replace(made, **named)


def in_words(record: Perturbation) -> str:
    """The forces, for a line of text."""
    parts = [f"a {what} of ({', '.join(force.arguments)})" for what, force in record.functions.items()]
    parts += [f"a pair potential of ({', '.join(record.pair.arguments)})"] if record.pair else []
    parts += ["linear damping"] * record.damping + ["other moments of inertia"] * record.inertia
    parts += ["a coupling of M and P"] * record.coupling
    parts += ["a controller"] * (record.control is not None)
    return ", ".join(parts)


def _functions(system: System, axes: Mapping[str, int]) -> dict[str, Callable[..., Any]]:
    """Flow, energy and velocity of the perturbed system, as far as the integrable system has them."""
    record = kicks.perturbation_of(system)
    base, own = record.base, len(record.base.space.letters)
    turned = base.frame is Frame.REST and (record.loaded or record.damping or record.names(ORIENTATION))

    def flow(*state: Array, **known: Any) -> tuple[Array, ...]:
        rates, _ = kicks.rates(system, _body(state, known), known, axes)
        inner = call(base.flow, state[:own], known)
        return (*(x + y for x, y in zip(inner, rates, strict=False)), *rates[own:])

    def energy(*state: Array, **known: Any) -> Array:
        V, _ = kicks.potential(system, _body(state, known), known, axes)
        out = call(base.energy, state[:own], known) + V
        if record.inertia:
            M = algebra.axial(state[0])
            out = out + algebra.dot(M * M, kicks.inverse_moments(system, known)) / 2
        if record.coupling:
            out = out + algebra.dot(algebra.axial(state[0]), algebra.act(known[COUPLING], state[1]))
        return out + kicks.energy_of_spin(system, state, known) if turned else out

    def velocity(*state: Array, **known: Any) -> Array:
        return kicks.velocity(system, state, known)

    def translation(*state: Array, **known: Any) -> Array:
        return kicks.translation(system, _body(state, known), known, axes)

    found = {"flow": flow, "energy": energy, "velocity": velocity, "translation": translation}
    return {what: function for what, function in found.items() if getattr(base, what) is not None}


def _body(state: tuple[Array, ...], known: Mapping[str, Any]) -> Body:
    return Body(state, known.get(ORIENTATION), known.get(TIME))
