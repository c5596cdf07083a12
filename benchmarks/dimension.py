"""Time of a step against n, single trajectories without saving, with fitted exponents.

Up to n = 8 the step is straight-line code, beyond array code with a dense solve; the exponent is that of the least
squares line through the logarithms from n = 16 on.  The thread's processor time, least of some turns.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from cases import RESULTS, machine

import kreisel as kr
from kreisel.runs.plan import make_plan

SIZES = (3, 4, 5, 6, 8, 10, 16, 32, 64, 128)
SECONDS, TURNS = 0.1, 5


def models(n: int) -> dict[str, tuple[Any, dict[str, Any]]]:
    draw = np.random.default_rng(n)
    X, v, b = draw.normal(size=(n, n)) / np.sqrt(n), draw.normal(size=n), draw.uniform(0.1, 2, n)
    v /= np.sqrt(v @ v)
    q = draw.normal(size=n)
    return {
        "lagrange-top": (kr.LagrangeTop(p=np.eye(n)[-1]), {"m": X - X.T, "a": v}),
        "clebsch": (kr.Clebsch(b=b), {"M": X - X.T, "P": v}),
        "neumann": (kr.Neumann(b=b), {"x": v, "q": q - v * (v @ q)}),
    }


def nanoseconds(model: Any, state: dict[str, Any]) -> float:
    plan = make_plan(model, model.state(**state), dt=0.01, steps=1, every=1, method="suris", order=1, orientation=None)
    out, steps = np.empty((1, *plan.engine.z.shape)), 1
    plan.engine.advance(out, 1)
    took = 0.0
    while took < SECONDS:
        begun = time.thread_time()
        plan.engine.advance(out, steps)
        took = time.thread_time() - begun
        steps = steps if took >= SECONDS else 2 * steps
    best = took
    for _ in range(TURNS - 1):
        begun = time.thread_time()
        plan.engine.advance(out, steps)
        best = min(best, time.thread_time() - begun)
    return best / steps * 1e9


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--largest", type=int, default=SIZES[-1])
    parser.add_argument("--output", type=Path, default=RESULTS / "dimension.json")
    options = parser.parse_args(arguments)
    sizes = [n for n in SIZES if n <= options.largest]
    found: dict[str, dict[str, float]] = {}
    for n in sizes:
        for name, (model, state) in models(n).items():
            found.setdefault(name, {})[str(n)] = round(nanoseconds(model, state), 1)
        print(f"n = {n:<4}" + "   ".join(f"{name} {row[str(n)]:.0f} ns" for name, row in found.items()), flush=True)
    fitted = {}
    for name, row in found.items():
        far = [n for n in sizes if n >= 16]
        if len(far) > 1:
            fitted[name] = round(float(np.polyfit(np.log(far), np.log([row[str(n)] for n in far]), 1)[0]), 2)
    print(f"exponents from n = 16 on: {fitted}")
    told = {"machine": machine(), "load_average_after": round(os.getloadavg()[0], 1), "ns": found, "exponents": fitted}
    options.output.write_text(json.dumps(told, indent=1) + "\n")
    print(f"Written: {options.output}")


if __name__ == "__main__":
    main()
