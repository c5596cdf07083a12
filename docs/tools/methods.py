"""The table of all methods, from their records, for the site."""

from __future__ import annotations

from pathlib import Path

import kreisel as kr


def table() -> str:
    """A row for each method."""
    lines = ["| method | for | orders | Poisson | conserves |", "|---|---|---|---|---|"]
    for m in kr.methods():
        lines.append(f"| `{m.name}`: {m.title} | {m.needs} | {m.order_text} | {m.poisson} | {m.conserves} |")
    return "\n".join(lines) + "\n"


def write(docs: Path) -> None:
    """generated/methods-table.md."""
    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    (folder / "methods-table.md").write_text(table(), encoding="utf-8")
