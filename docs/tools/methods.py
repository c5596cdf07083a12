"""The table of all methods, from their records, for the site and for the README.

python docs/tools/methods.py        # make stubs: the README's table anew
"""

from __future__ import annotations

from pathlib import Path

import kreisel as kr

BEGIN, END = "<!-- the table of methods: `make stubs` -->\n", "<!-- end of the table -->\n"


def table() -> str:
    """A row for each method."""
    lines = ["| method | for | orders | Poisson | conserves |", "|---|---|---|---|---|"]
    for m in kr.methods():
        lines.append(f"| `{m.name}`: {m.title} | {m.needs} | {m.order_text} | {m.poisson} | {m.conserves} |")
    return "\n".join(lines) + "\n"


def with_table(text: str) -> str:
    """The README with the table of today."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{table()}\n{END}{rest.split(END)[1]}"


def write(docs: Path) -> None:
    """generated/methods-table.md."""
    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    (folder / "methods-table.md").write_text(table(), encoding="utf-8")


if __name__ == "__main__":
    readme = Path(__file__).parents[2] / "README.md"
    readme.write_text(with_table(readme.read_text(encoding="utf-8")), encoding="utf-8")
