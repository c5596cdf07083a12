"""The history of the benchmarks: a line in history.jsonl for each `make bench`, which docs/history.md draws.

python benchmarks/history.py --from-git     # the lines anew, from all committed versions of results/
"""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
HISTORY, RESULTS = Path(__file__).parent / "history.jsonl", Path(__file__).parent / "results"
FILES = {"single": "ns a step", "ensemble": "ns a lane-step"}


def line(date: str, results: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Nanoseconds of each map, n = 3, by measurement; machine and version."""
    machine = next(iter(results.values()))["machine"]
    times = {
        FILES[name]: {each: row["kernel"]["ns"] for each, row in result["maps"].items()}
        for name, result in results.items()
    }
    return {"date": date, "kreisel": machine["kreisel"], "cpu": machine["cpu"], "python": machine["python"], **times}


def lines(file: Path = HISTORY) -> list[dict[str, Any]]:
    """All lines, oldest first."""
    return [json.loads(text) for text in file.read_text(encoding="utf-8").splitlines()]


def append(file: Path = HISTORY, results: Path = RESULTS) -> None:
    """Add the last measurement."""
    found = {name: json.loads((results / f"{name}.json").read_text(encoding="utf-8")) for name in FILES}
    with file.open("a", encoding="utf-8") as out:
        out.write(json.dumps(line(datetime.datetime.now(datetime.UTC).date().isoformat(), found)) + "\n")


def from_git() -> None:
    """One line for each commit that changed a result."""
    paths = {name: f"benchmarks/results/{name}.json" for name in FILES}
    log = _git("log", "--reverse", "--format=%H %cs", "--", *paths.values())
    out = []
    for commit, date in (entry.split() for entry in log.splitlines()):
        changed = _git("show", "--name-only", "--format=", commit).split()
        found = {name: json.loads(_git("show", f"{commit}:{path}")) for name, path in paths.items() if path in changed}
        out.append(json.dumps(line(date, found)))
    HISTORY.write_text("\n".join(out) + "\n", encoding="utf-8")


def _git(*command: str) -> str:
    return subprocess.run(["git", *command], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def figure() -> Any:
    """Nanoseconds of every map against the number of the measurement."""
    from matplotlib.figure import Figure

    found = lines()
    picture = Figure(figsize=(8.5, 3.6), layout="constrained")
    for axes, what in zip(picture.subplots(1, 2), FILES.values(), strict=True):
        rows = [row for row in found if what in row]
        for name in rows[-1][what]:
            axes.plot([row[what].get(name) for row in rows], marker="o", markersize=3, linewidth=1, label=name)
        axes.set_xticks(
            range(len(rows)), [f"{row['date'][5:]}\n{row['kreisel']}" for row in rows], rotation=90, fontsize=7
        )
        axes.set(ylim=(0, None), title=what)
    axes.legend(fontsize=8)
    return picture


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--from-git", action="store_true", required=True, help="make all lines anew")
    parser.parse_args()
    from_git()
