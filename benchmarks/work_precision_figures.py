"""Figures of the work-precision benchmark, docs/work-precision*.png, from the committed results."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib
from cases import RESULTS

from kreisel.viewer.style import theme_of

matplotlib.use("Agg")
import matplotlib.pyplot as plt

TITLES = {"euler-top": "Euler top", "lagrange-top": "Lagrange top", "clebsch": "Clebsch's case"}
METHODS = ("baecklund", "exact", "suris", "variational")
SHADES = matplotlib.colormaps["viridis_r"]
DOCS = Path(__file__).parents[1] / "docs"
SHOWN = {  # method: colour, line
    "baecklund 24": ("#0b559f", "-"),
    "baecklund 16": ("#2b7bba", "-"),
    "baecklund 8": ("#6aaed6", "-"),
    "baecklund 4": ("#a8cee4", "-"),
    "exact": ("#111111", "-"),
    "exact jump": ("#111111", "--"),
    "veselov 2": ("#a8cee4", "-"),
    "veselov 4": ("#6aaed6", "-"),
    "veselov 6": ("#2b7bba", "-"),
    "veselov 8": ("#0b559f", "-"),
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
            for run in result["runs"].get(f"{kind}, n = {n}, T = {end}", []):
                lines[run["method"]].append((max(run["error"], 1e-16), run["us"]))
            for method, (colour, style) in SHOWN.items():
                if method in lines:
                    points = sorted(lines[method])
                    axis.loglog(*zip(*points, strict=True), style, color=colour, marker=".", ms=4, lw=1.3, label=method)
            axis.set_title(f"n = {n}, T = {end}", fontsize=9)
            axis.set_xlim(1e-1, 5e-17)
            axis.grid(alpha=0.25)
    for axis in axes[-1]:
        axis.set_xlabel("error at T, relative")
    for row in axes:
        row[0].set_ylabel("µs per unit of time")
    handles: dict[str, Any] = {}
    for axis in axes.flat:
        handles |= dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    fig.legend(
        handles.values(), handles.keys(), loc="lower center", ncol=min(6, 3 * len(columns)), fontsize=7, frameon=False
    )
    fig.suptitle(f"{TITLES[kind]}: one trajectory on one core", fontsize=10)
    fig.tight_layout(rect=(0, 0.09 if len(columns) > 1 else 0.14, 1, 0.98))
    fig.savefig(DOCS / f"work-precision-{kind}.png", dpi=110)
    plt.close(fig)


def _order(name: str) -> int:
    return int(name.split()[1]) if name.split()[-1].isdigit() else 0


def of_a_method(result: dict[str, Any], method: str) -> None:
    """One method in colour among all others in grey, n = 3, T = 1000: for the page of that method."""
    theme = theme_of("light")
    with plt.rc_context(theme.rc):
        fig, axes = plt.subplots(1, 2, figsize=(7.4, 3.2), sharex=True)
        for axis, kind in zip(axes, ("lagrange-top", "clebsch"), strict=True):
            lines = defaultdict(list)
            for run in result["runs"][f"{kind}, n = 3, T = 1000"]:
                if not run["method"].endswith("batch"):
                    lines[run["method"]].append((max(run["error"], 1e-16), run["us"]))
            mine = sorted((name for name in lines if name.split()[0] == method), key=_order)
            for name in sorted(lines, key=lambda name: name in mine):
                points = zip(*sorted(lines[name]), strict=True)
                if name in mine:
                    shade = SHADES(0.35 + 0.6 * mine.index(name) / max(len(mine) - 1, 1))
                    axis.loglog(*points, color=shade, marker=".", ms=4, lw=1.3, label=name)
                else:
                    peer = {"color": SHOWN["heyoka"][0], "ls": "--", "lw": 1.2, "label": "heyoka"}
                    axis.loglog(
                        *points, **(peer if name == "heyoka" else {"color": theme.faint, "lw": 0.7, "alpha": 0.5})
                    )
            axis.set(title=TITLES[kind] + ", n = 3, T = 1000", xlabel="error at T, relative", xlim=(1e-1, 5e-17))
            axis.legend(fontsize=6.5)
        axes[0].set_ylabel("µs per unit of time")
        fig.tight_layout()
        fig.savefig(DOCS / f"work-precision-of-{method}.png", dpi=110)
        plt.close(fig)


def table(result: dict[str, Any]) -> str:
    """The cheapest run of kreisel and of the peers at or below an error, one trajectory and batches, as Markdown."""
    from work_precision import cheapest

    lines = [
        "| problem | error | kreisel | µs | best peer | µs | kreisel is faster by |",
        "|---|---|---|---|---|---|---|",
    ]
    for key, rows in result["runs"].items():
        for batch in (False, True):
            for error in (1e-6, 1e-9, 1e-12, 1e-13):
                ours, theirs = (cheapest(rows, side, error, batch) for side in (True, False))
                if ours is None and theirs is None:
                    continue
                cells = [f"{key}{', batch' * batch}", f"{error:g}"]
                for run in (ours, theirs):
                    cells += [run["method"], f"{run['us']:.2g}"] if run else ["not reached", ""]
                cells.append(f"{theirs['us'] / ours['us']:.1f}" if ours and theirs else "")
                lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """All figures, and the table of docs/work-precision.md on the screen."""
    result = json.loads((RESULTS / "work_precision.json").read_text())
    print(table(result))
    for kind in TITLES:
        if any(key.startswith(kind) for key in result["runs"]):
            figure(result, kind)
    for method in METHODS:
        of_a_method(result, method)


if __name__ == "__main__":
    main()
