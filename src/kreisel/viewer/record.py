"""Records as text: what `kreisel systems` prints."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from kreisel.method import Method
from kreisel.record.calling import keywords
from kreisel.record.contract import Map, Parameter, System

SHORT = {"skew": "so(n)", "symmetric": "Sym(n)", "vector": "R^n"}
MAP_CLAIMS = {
    "inverse": "inverse",
    "adjoint": "adjoint",
    "involution": "reversing involution",
    "lagrangian": "discrete Lagrangian",
    "lax": "discrete Lax pair",
    "generator": "reconstruction of g",
    "second_order": "second-order form",
}


def summary(system: System) -> dict[str, Any]:
    """A record as plain data."""
    return {
        "name": system.name,
        "title": system.title,
        "equations": system.equations,
        "state": dict(system.space.components),
        "phase_space": system.space.name,
        "frame": system.frame.value,
        "bracket": "plus" if system.space.sign > 0 else "minus",
        "parameters": {p.letter: p.meaning for p in system.parameters},
        "integrals": [*(["energy"] if system.energy is not None else []), *system.integrals],
        "invariant_relations": [*system.invariant],
        "lax": system.lax is not None,
        "map": None if system.map is None else _map_summary(system.map),
        "related": [relation.target for relation in system.relations],
        "scaling": system.scaling,
        "notes": system.notes,
        "source": system.source,
    }


def _map_summary(phi: Map) -> dict[str, Any]:
    return {
        "source": phi.source,
        "order": phi.order,
        "order_after_half_kick": None if phi.to_symmetric is None else 2,
        "known": [words for claim, words in MAP_CLAIMS.items() if getattr(phi, claim) is not None],
    }


def record(system: System) -> str:
    """The record of a system, a line for each claim."""
    facts = summary(system)
    lines = [f"{system.name}: {system.title}", f"  {system.equations}", ""]
    state = ", ".join(f"{letter} in {SHORT.get(kind, kind)}" for letter, kind in system.space.components)
    frame = f"{facts['phase_space']}, {facts['frame']} frame, {facts['bracket']} bracket"
    lines.append(f"  state       {state}; {frame}, F' = {{H, F}}")
    for p in system.parameters:
        lines.append(f"  parameter   {p.letter}: {parameter_text(p)}")
    lines.append(f"  integrals   {', '.join(facts['integrals'])}; Casimirs")
    for name in system.invariant:
        lines.append(f"  relation    {name} = 0 is invariant")
    lines.append(f"  Lax pair    {'yes' if system.lax else 'none known'}")
    if system.map is None:
        lines.append("  map         no integrable discretization known here")
    else:
        known = facts["map"]
        after = ", 2 after half a kick" if system.map.to_symmetric is not None else ""
        lines.append(f"  map         {known['source']}; order {system.map.order}{after}")
        named = [f for f in (system.energy, *system.integrals.values()) if f is not None]
        deformed = "; deformed integrals" if any("eps" in keywords(f) for f in named) else ""
        lines.append(f"              with {', '.join(known['known'])}{deformed}")
    for relation in system.relations:
        lines.append(f"  related     {relation.target}: {relation.meaning}")
    lines += [f"  scaling     {system.scaling}", f"  source      {system.source}"]
    return "\n".join(lines + ([f"  note        {system.notes}"] if system.notes else []))


def table(systems: Iterable[System]) -> str:
    """One line for each system."""
    rows: list[tuple[str, ...]] = [("name", "state", "frame", "bracket", "map", "title")]
    for s in systems:
        bracket = "plus" if s.space.sign > 0 else "minus"
        rows.append((s.name, ", ".join(s.space.letters), s.frame.value, bracket, "yes" if s.map else "-", s.title))
    return _aligned(rows)


def method_table(methods: Iterable[Method]) -> str:
    """One line for each method."""
    rows: list[tuple[str, ...]] = [("name", "orders", "Poisson", "conserves", "title")]
    return _aligned([*rows, *((m.name, m.order_text, m.poisson, m.conserves, m.title) for m in methods)])


def method_record(method: Method) -> str:
    """The record of a method, a line for each claim."""
    default = "" if method.default is None else f" (default {method.default})"
    lines = {
        "for": method.needs,
        "orders": method.order_text + default,
        "Poisson": method.poisson,
        "conserves": method.conserves,
        "sources": ", ".join(method.sources),
    }
    table = "\n".join(f"  {name:<11} {text}" for name, text in lines.items())
    return f"{method.name}: {method.title}\n\n{table}"


def _aligned(rows: list[tuple[str, ...]]) -> str:
    widths = [max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1]]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, [*widths, 0], strict=True)) for row in rows)


def parameter_text(p: Parameter) -> str:
    """What a parameter means, and its default."""
    if p.default is None:
        return p.meaning
    value = f"{p.default:g}" if np.ndim(p.default) == 0 else str(np.asarray(p.default).tolist())
    return f"{p.meaning} (default {value})"
