"""Time of one n = 3 trajectory without saving: kr.propagator's `steps` against C++ by hand, in one run.

Maps are timed alternately as a user calls them, projections and the call included ("kernel"), and as C++ of the same
formula without them, many times over; ratios are medians over the rounds.  Writes results/single.json.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

from cases import cases, machine, parser, write

from kreisel.bench import DT, FLAGS, Contest, build, compiler, summary

STEPS, TURNS = 2_000_000, 9
CHECKED, GOAL = 1000, 1.05


def version() -> str:
    """The version that g++ reports."""
    text = subprocess.run([compiler() or "g++", "--version"], capture_output=True, text=True, check=True).stdout
    return text.splitlines()[0]


def measure(steps: int = STEPS, turns: int = TURNS) -> dict[str, Any]:
    """Everything, as written to results/single.json."""
    setting = {"machine": machine(), "compiler": version(), "flags": FLAGS, "dt": DT, "steps": steps, "turns": turns}
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        print(f"Building single.cpp with {version()} {' '.join(FLAGS[:2])} in a temporary folder.", flush=True)
        library = build("single", Path(folder))
        print(f"{turns} turns of {steps:,} steps each; nanoseconds a step, median [quartiles].\n")
        print(f"{'map, n = 3':<21}{'kernel':>22}{'C++':>22}{'kernel/C++':>12}")
        for case in cases(generic=True):
            contest = Contest(case, library)
            apart = contest.agreement(CHECKED)
            rows[case.name] = {**summary(contest.timed(turns, steps)), "apart_after_1000": {"cpp": apart}}
            print(_line(case.name, rows[case.name]), flush=True)
    return {**setting, "maps": rows}


def _line(name: str, row: dict[str, Any]) -> str:
    cells = (f"{row[k]['ns']:.1f} [{row[k]['quartiles'][0]:.1f}, {row[k]['quartiles'][1]:.1f}]" for k in list(row)[:2])
    mark = "" if row["kernel/cpp"] <= GOAL else f"  over the goal of {GOAL}"
    return f"{name:<21}" + "".join(f"{cell:>22}" for cell in cells) + f"{row['kernel/cpp']:>12.2f}{mark}"


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write the JSON."""
    options = parser(__doc__, "single")
    options.add_argument("--steps", type=int, default=STEPS)
    options.add_argument("--turns", type=int, default=TURNS)
    asked = options.parse_args(arguments)
    write(measure(asked.steps, asked.turns), asked.output)


if __name__ == "__main__":
    main()
