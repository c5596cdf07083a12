"""Tables and figures of the page on performance, from benchmarks/results."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path


def write(docs: Path) -> None:
    """generated/performance.md and the tables of its sections."""
    benchmarks = docs.resolve().parent / "benchmarks"
    sys.path.insert(0, str(benchmarks))
    import history
    import tables

    folder = docs / "generated"
    folder.mkdir(exist_ok=True)
    for table in tables.TABLES[1:]:
        (folder / f"performance-{table.__name__}.md").write_text(table() + "\n", encoding="utf-8")
    parts = [tables.speed_and_stillness()]
    (folder / "figures").mkdir(exist_ok=True)
    history.figure().savefig(folder / "figures" / "history.png", dpi=110)
    for figure in sorted((benchmarks / "results").glob("*.png")):
        shutil.copyfile(figure, folder / "figures" / f"benchmark-{figure.name}")
        title = figure.stem.replace("-", " ").replace("_", " ").capitalize()
        parts.append(f"## {title}\n\n![{title}](figures/benchmark-{figure.name})")
    (folder / "performance.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")
