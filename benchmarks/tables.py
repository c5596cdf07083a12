"""The tables of the README, from the committed results: `python benchmarks/tables.py`."""

from __future__ import annotations

import json
from pathlib import Path

RESULTS = Path(__file__).parent / "results"


def speed_and_stillness() -> str:
    """One line for each map, n = 3: time of a step, ratios to C++ in one run, worst integral after 1e8 steps."""
    single = json.loads((RESULTS / "single.json").read_text())["maps"]
    drift = json.loads((RESULTS / "roundoff.json").read_text())["maps"]
    head = (
        "| map, n = 3 | ns a step | to C++, same formula | to C++, plain formula "
        "| worst integral after 10⁸ steps, bands |\n|---|---|---|---|---|"
    )
    lines = [head]
    for name, row in single.items():
        worst = max(ratios["1e+08"] for ratios in drift[f"{name}, n = 3"]["worst_ratio"].values())
        plain = row["kernel"]["ns"] / row["cpp_plain"]["ns"]
        lines.append(f"| `{name}` | {row['kernel']['ns']:.0f} | {row['kernel/cpp']:.2f} | {plain:.2f} | {worst:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(speed_and_stillness())
