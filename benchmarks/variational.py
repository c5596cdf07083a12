"""Time of a step of the variational integrator, n = 3, against the map of the Lagrange top, in one run.

The heavy top with three moments is solved by Newton steps; the map is explicit.  Both kernels alternate; ratios are
medians over the rounds.  No parameter is 0 or 1.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from cases import RESULTS, machine, steps_of

import kreisel as kr

DT, STEPS, TURNS = 0.05, 1_000_000, 9
AXIS = (0.3, -0.2, 0.9)
START = {"M": (0.1, 0.2, 1.5), "P": (0.6, 0.0, 0.8)}


def kernels() -> dict[str, Any]:
    """The map first, then the integrator by its orders."""
    lagrange = kr.LagrangeTopMoving(A=AXIS, alpha=0.7)
    heavy = kr.HeavyTop(J=(0.3, 0.5, 0.9), A=AXIS)
    chosen = {"lagrange-top-moving, suris": (lagrange, "suris", 1)}
    chosen |= {f"heavy-top, variational, order {order}": (heavy, "variational", order) for order in (2, 4, 6, 8)}
    return {
        name: steps_of(model, START, dt=DT, method=method, order=order)
        for name, (model, method, order) in chosen.items()
    }


def measure(steps: int = STEPS, turns: int = TURNS) -> dict[str, Any]:
    """Everything, as written to results/variational.json."""
    methods = kernels()
    ns: dict[str, list[float]] = {name: [] for name in methods}
    for turn in range(turns + 1):  # the first is not counted
        for name, after in methods.items():
            begun = time.perf_counter()
            after(steps)
            if turn:
                ns[name].append((time.perf_counter() - begun) / steps * 1e9)
    of_map = np.array(next(iter(ns.values())))
    rows = {}
    for name, values in ns.items():
        low, middle, high = (round(float(v), 1) for v in np.percentile(values, [25, 50, 75]))
        ratio = round(float(np.median(np.array(values) / of_map)), 2)
        rows[name] = {"ns": middle, "quartiles": [low, high], "ratio": ratio}
        print(f"{name:<34}{middle:>9.1f} ns  [{low:.1f}, {high:.1f}]   {ratio:.2f} of the map", flush=True)
    return {"machine": machine(), "dt": DT, "steps": steps, "turns": turns, "methods": rows}


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--output", type=Path, default=RESULTS / "variational.json")
    options = parser.parse_args(arguments)
    result = measure(options.steps, options.turns)
    options.output.parent.mkdir(exist_ok=True)
    options.output.write_text(json.dumps(result, indent=1) + "\n")
    print(f"\nWritten: {options.output}")


if __name__ == "__main__":
    main()
