"""Systems and runs as HTML, for notebooks: plain tables that take the colours of the page around them."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.record.contract import System
from kreisel.record.model import Model, State
from kreisel.viewer.record import parameter_text, summary

if TYPE_CHECKING:
    import xarray as xr

MOST_NUMBERS = 24  # of a parameter or a component that are shown
CONSERVED = {  # the cell of an integral that is (conserved, broken)
    (True, True): "<td style='color:#c00;font-weight:bold'>BROKEN</td>",
    (True, False): "<td>yes</td>",
    (False, False): "<td>no</td>",
}


def system_html(system: System) -> str:
    """The record of a system."""
    facts = summary(system)
    state = ", ".join(f"{letter} ({kind})" for letter, kind in facts["state"].items())
    where = f"{facts['phase_space']}, {facts['frame']} frame, {facts['bracket']} bracket, F' = {{H, F}}"
    rows = [
        ("equations", system.equations),
        ("state", f"{state}; {where}"),
        *((f"parameter {p.letter}", parameter_text(p)) for p in system.parameters),
        ("integrals", ", ".join(["Casimirs", *facts["integrals"]])),
        ("Lax pair", "yes" if facts["lax"] else "none known"),
        ("map", "none known" if facts["map"] is None else facts["map"]["source"]),
        ("scaling", system.scaling),
        ("source", system.source),
        *([("note", system.notes)] if system.notes else []),
    ]
    return _block(f"{escape(system.title)} <code>{escape(system.name)}</code>", _html_table(rows))


def model_html(model: Model) -> str:
    """A system with its parameters."""
    system = model.system
    rows = [
        ("equations", system.equations),
        ("dimension", f"n = {model.n}" + (f", {model.batch[0]:,} lanes" if len(model.batch) == 1 else "")),
        *((letter, _numbers_html(value)) for letter, value in model.params.items()),
        ("state", ", ".join(f"{letter} ({kind})" for letter, kind in system.space.components)),
    ]
    return _block(f"{escape(system.title)} <code>{escape(system.name)}</code>", _html_table(rows))


def state_html(state: State) -> str:
    """A state, with axial vectors for n = 3."""
    return _block("State", _html_table((letter, _numbers_html(value)) for letter, value in state.axial.items()))


def run_html(run: xr.Dataset) -> str:
    """What a run is, and how far its Casimirs and integrals drift."""
    from kreisel.runs.drift import broken, table_of
    from kreisel.runs.run_record import RunRecord

    needed = ("title", "equations", "parameters", "n", "steps", "method", "options")
    record, found = RunRecord.of(run, *needed, rows=False), table_of(run)
    lanes = f", {run.sizes['lane']:,} lanes" if "lane" in run.sizes else ""
    steps = f"{record.pace}, " if record.stepped else ""
    rows = f"{run.sizes.get('time', 1):,} saved states"
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
        for name, row in found.iterrows()
    )
    table = f"<table><tr>{''.join(f'<th>{title}</th>' for title in titles)}</tr>{body}</table>"
    warnings = "".join(f"<p style='color:#c00'>{escape(sentence)}</p>" for sentence in broken(found))
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
