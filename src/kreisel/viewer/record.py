"""Records as text, the output of `kreisel systems`; systems and runs as HTML for notebooks, in the page's colours."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import KINDS
from kreisel.errors import counted
from kreisel.method import Method
from kreisel.record.calling import keywords
from kreisel.record.contract import Parameter, System
from kreisel.record.model import Model, State

if TYPE_CHECKING:
    import xarray as xr


MAP_CLAIMS = {
    "inverse": "inverse",
    "adjoint": "adjoint",
    "involution": "reversing involution",
    "lagrangian": "discrete Lagrangian",
    "lax": "discrete Lax pair",
    "pencil": "discrete Lax pair of a pencil",
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
        "map": None
        if (phi := system.map) is None
        else {
            "source": phi.source,
            "order": phi.order,
            "order_after_half_kick": None if phi.to_symmetric is None else 2,
            "known": [words for claim, words in MAP_CLAIMS.items() if getattr(phi, claim) is not None],
        },
        "related": [relation.target for relation in system.relations],
        "scaling": system.scaling,
        "notes": system.notes,
        "source": system.source,
    }


def record(system: System) -> str:
    """The record of a system, a line for each claim."""
    return f"{system.name}: {system.title}\n  {system.equations}\n\n{_listing(_claims(system))}"


def _claims(system: System) -> list[tuple[str, str]]:
    facts = summary(system)
    state = ", ".join(f"{letter} in {KINDS[kind].space}" for letter, kind in system.space.components)
    frame = f"{facts['phase_space']}, {facts['frame']} frame, {facts['bracket']} bracket"
    plan = "no integrable discretization known here"
    if system.map is not None:
        after = ", 2 after half a kick" if system.map.to_symmetric is not None else ""
        named = [f for f in (system.energy, *system.integrals.values()) if f is not None]
        deformed = "; deformed integrals" if any("eps" in keywords(f) for f in named) else ""
        plan = f"{facts['map']['source']}; order {system.map.order}{after}"
        plan += f"\nwith {', '.join(facts['map']['known'])}{deformed}"
    return [
        ("state", f"{state}; {frame}, F' = {{H, F}}"),
        *(("parameter", f"{p.letter}: {parameter_text(p)}") for p in system.parameters),
        ("integrals", f"{', '.join(facts['integrals'])}; Casimirs"),
        *(("relation", f"{name} = 0 is invariant") for name in system.invariant),
        ("Lax pair", "yes" if system.lax else "none known"),
        ("map", plan),
        *(("related", f"{relation.target}: {relation.meaning}") for relation in system.relations),
        ("scaling", system.scaling),
        ("source", system.source),
        *([("note", system.notes)] if system.notes else []),
    ]


def _listing(rows: Iterable[tuple[str, str]]) -> str:
    indent = "\n" + 14 * " "
    return "\n".join(f"  {label:<11} {text.replace(chr(10), indent)}" for label, text in rows)


def table(systems: Iterable[System]) -> str:
    """One line for each system."""
    rows: list[tuple[str, ...]] = [("name", "state", "frame", "bracket", "map", "title")]
    for s in systems:
        bracket = "plus" if s.space.sign > 0 else "minus"
        rows.append((s.name, ", ".join(s.space.letters), s.frame.value, bracket, "yes" if s.map else "-", s.title))
    return _aligned(rows)


def method_table(methods: Iterable[Method]) -> str:
    """One line for each method."""
    rows = [(m.name, m.order_text, m.poisson, m.conserves, m.title) for m in methods]
    return _aligned([("name", "orders", "Poisson", "conserves", "title"), *rows])


def method_record(method: Method) -> str:
    """The record of a method, a line for each claim."""
    default = "" if method.default is None else f" (default {method.default})"
    rows = [
        ("for", method.needs),
        ("orders", method.order_text + default),
        ("Poisson", method.poisson),
        ("conserves", method.conserves),
        ("sources", ", ".join(method.sources)),
    ]
    return f"{method.name}: {method.title}\n\n{_listing(rows)}"


def _aligned(rows: list[tuple[str, ...]]) -> str:
    widths = [max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1]]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, [*widths, 0], strict=True)) for row in rows)


def parameter_text(p: Parameter) -> str:
    """The meaning of a parameter, and its default."""
    value = f"{p.default:g}" if p.default is not None and np.ndim(p.default) == 0 else np.asarray(p.default).tolist()
    return p.meaning if p.default is None else f"{p.meaning} (default {value})"


# -- HTML ------------------------------------------------------------------------------------------


MOST_NUMBERS = 24  # of a parameter or a component that are shown
CONSERVED = {  # the cell of an integral that is (conserved, broken)
    (True, True): "<td style='color:#c00;font-weight:bold'>BROKEN</td>",
    (True, False): "<td>yes</td>",
    (False, False): "<td>no</td>",
}


def system_html(system: System) -> str:
    """The record of a system."""
    rows = [("equations", system.equations), *_claims(system)]
    return _block(f"{escape(system.title)} <code>{escape(system.name)}</code>", _html_table(rows))


def model_html(model: Model) -> str:
    """A system with its parameters."""
    system, lanes = model.system, f", {counted(model.batch[0], 'lane')}" if len(model.batch) == 1 else ""
    rows = [("equations", system.equations), ("dimension", f"n = {model.n}{lanes}")]
    rows += [(letter, _numbers_html(value)) for letter, value in model.params.items()]
    rows += [("state", ", ".join(f"{letter} ({kind})" for letter, kind in system.space.components))]
    return _block(f"{escape(system.title)} <code>{escape(system.name)}</code>", _html_table(rows))


def state_html(state: State) -> str:
    """A state, with axial vectors for n = 3."""
    return _block("State", _html_table((letter, _numbers_html(value)) for letter, value in state.axial.items()))


def run_html(run: xr.Dataset) -> str:
    """A run, and the drift of its Casimirs and integrals."""
    from kreisel.runs.drift import broken, table_of
    from kreisel.runs.run_record import RunRecord

    needed = ("title", "equations", "parameters", "n", "steps", "method", "options")
    record, drifts = RunRecord.of(run, *needed, rows=False), table_of(run)
    lanes = f", {counted(run.sizes['lane'], 'lane')}" if "lane" in run.sizes else ""
    steps = f"{record.pace}, " if record.stepped else ""
    rows = counted(run.sizes.get("time", 1), "saved state")
    head = [
        ("equations", record.equations),
        ("parameters", record.parameters if len(record.parameters) < 200 else "…"),
        ("run", f"n = {record.n}{lanes}; {steps}{rows}"),
        ("method", f"{record.method} {record.options}"),
    ]
    titles = ("integral", "conserved", "start", "max |change|", "ulps")
    body = "".join(
        f"<tr style='opacity:{1 if row.conserved else 0.6}'><th style='text-align:left'>{escape(str(name))}</th>"
        f"{CONSERVED[bool(row.conserved), bool(row.broken)]}<td>{row.start:.6g}</td><td>{row.max_change:.1e}</td>"
        f"<td>{row.ulps:.2g}</td></tr>"
        for name, row in drifts.iterrows()
    )
    table = f"<table><tr>{''.join(f'<th>{title}</th>' for title in titles)}</tr>{body}</table>"
    warnings = "".join(f"<p style='color:#c00'>{escape(sentence)}</p>" for sentence in broken(drifts))
    return _block(escape(record.title), _html_table(head) + table + warnings)


def _numbers_html(value: Any) -> str:
    array = np.asarray(value)
    if array.size > MOST_NUMBERS:
        return f"array of shape {array.shape}"
    return np.array2string(array, separator=", ", precision=6) if array.dtype != object else str(array.tolist())


def _html_table(rows: Iterable[tuple[str, str]]) -> str:
    cells = "".join(
        f"<tr><th style='text-align:left;vertical-align:top'>{escape(name)}</th>"
        f"<td style='text-align:left;white-space:pre-wrap'>{escape(text)}</td></tr>"
        for name, text in rows
    )
    return f"<table>{cells}</table>"


def _block(title: str, body: str) -> str:
    return f"<div><strong>{title}</strong>{body}</div>"
