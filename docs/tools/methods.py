"""The table of all methods, from their records."""

from __future__ import annotations

from pathlib import Path

import kreisel as kr


def write(docs: Path) -> None:
    """generated/methods-table.md."""
    lines = ["| method | for | orders | Poisson | conserves |", "|---|---|---|---|---|"]
    for m in kr.methods():
        lines.append(f"| `{m.name}`: {m.title} | {m.needs} | {m.order_text} | {m.poisson} | {m.conserves} |")
    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    (folder / "methods-table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
