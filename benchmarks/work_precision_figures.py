"""Figures of the work-precision benchmark, docs/work-precision-*.png, from the committed results."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib
from cases import RESULTS

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DOCS = Path(__file__).parents[1] / "docs"
SHOWN = {  # method: colour, line
    "baecklund 24": ("#0b559f", "-"),
    "baecklund 16": ("#2b7bba", "-"),
    "baecklund 8": ("#6aaed6", "-"),
    "baecklund 4": ("#a8cee4", "-"),
    "exact": ("#111111", "-"),
    "exact jump": ("#111111", "--"),
    "suris 2": ("#74a572", "--"),
    "variational 4": ("#b58900", "--"),
    "variational 8": ("#e0b84a", "--"),
    "heyoka": ("#c23b22", "-"),
    "scipy DOP853": ("#8e6bbf", ":"),
    "diffrax Dopri8": ("#d66ba0", ":"),
    "diffrax Tsit5": ("#e8a6c6", ":"),
    "mujoco RK4": ("#777777", ":"),
}


def figure(result: dict[str, Any], kind: str) -> None:
    """One row for T = 100, one for 1000; a column for each n."""
    keys = [k for k in result["runs"] if k.startswith(kind)]
    columns = sorted({int(k.split("n = ")[1].split(",")[0]) for k in keys})
    fig, axes = plt.subplots(2, len(columns), figsize=(4 * len(columns), 6.6), sharex=True, squeeze=False)
    for row, end in enumerate((100, 1000)):
        for column, n in enumerate(columns):
            axis, lines = axes[row][column], defaultdict(list)
            for run in result["runs"][f"{kind}, n = {n}, T = {end}"]:
                lines[run["method"]].append((max(run["error"], 1e-16), run["us"]))
            for method, (colour, style) in SHOWN.items():
                if method in lines:
                    points = sorted(lines[method])
                    axis.loglog(*zip(*points, strict=True), style, color=colour, marker=".", ms=4, lw=1.3, label=method)
            axis.set_title(f"n = {n}, T = {end}", fontsize=9)
            axis.set_xlim(1e-1, 3e-16)
            axis.grid(alpha=0.25)
    for axis in axes[-1]:
        axis.set_xlabel("error at T, relative")
    for row in axes:
        row[0].set_ylabel("µs per unit of time")
    handles: dict[str, Any] = {}
    for axis in axes.flat:
        handles |= dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    fig.legend(handles.values(), handles.keys(), loc="outside lower center", ncol=6, fontsize=8, frameon=False)
    title = {"lagrange-top": "Lagrange top", "clebsch": "Clebsch's case"}[kind]
    fig.suptitle(f"{title}: one trajectory on one core", fontsize=10)
    fig.tight_layout(rect=(0, 0.09, 1, 0.98))
    fig.savefig(DOCS / f"work-precision-{kind}.png", dpi=110)
    plt.close(fig)


def main() -> None:
    """Both figures."""
    result = json.loads((RESULTS / "work_precision.json").read_text())
    for kind in ("lagrange-top", "clebsch"):
        figure(result, kind)


if __name__ == "__main__":
    main()
