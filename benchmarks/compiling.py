"""Time to compile the first run of a kind: seconds of processor time, each in a new process with an empty cache.

    python benchmarks/compiling.py

Writes results/compiling.json.  The time is the first call minus a second, equal one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine

RESULT = Path(__file__).parent / "results" / "compiling.json"
LANES = 64


def calls() -> dict[str, Callable[[], Any]]:
    """Calls, by the kernels that they compile."""
    import kreisel as kr

    def run(model: Any, method: str, order: int | tuple[int, ...], lanes: int = 1) -> Callable[[], Any]:
        rng = np.random.default_rng(1)
        shapes = {letter: (model.n, model.n) if kind == "skew" else (model.n,) for letter, kind in kinds(model)}
        drawn = {letter: rng.normal(size=(lanes, *shape)) for letter, shape in shapes.items()}
        state = {k: v - v.mT if v.ndim == 3 else v / np.linalg.norm(v, axis=-1)[:, None] for k, v in drawn.items()}
        x0 = model.state(**{k: v[0] if lanes == 1 else v for k, v in state.items()})
        return lambda: kr.simulate(model, x0, dt=0.05, steps=10, method=method, order=order)

    def kinds(model: Any) -> list[tuple[str, str]]:
        return list(zip(model.system.space.letters, model.system.space.kinds, strict=True))

    top, free = kr.LagrangeTop(p=(0, 0, 1)), kr.EulerTop(J=(1, 2, 3))
    body = kr.perturbed(top, potential=lambda a, *, k: k * a[0] ** 2, params={"k": 0.01})
    start = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    five = kr.Clebsch(b=(1.0, 1.3, 1.7, 2.1, 2.6))
    return {
        "a top, suris": run(kr.LagrangeTop(p=(0, 0, 1)), "suris", 1),
        "a top, 64 lanes": run(top, "suris", 1, LANES),
        "Clebsch, n = 5, suris": run(five, "suris", 1),
        "Clebsch, n = 5, 64 lanes": run(five, "suris", 1, LANES),
        "a free body, variational 4": lambda: kr.simulate(
            free, free.state(M=(0.1, 1, 0.2)), dt=0.05, steps=10, method="variational", order=4
        ),
        "a perturbed top, splitting (8, 2)": lambda: kr.simulate(
            body, start, dt=0.05, steps=10, method="splitting", order=(8, 2)
        ),
        "kr.at of a top": lambda: kr.at(top, start, [1.0, 2.0]),
        "kr.at of a free body": lambda: kr.at(free, free.state(M=(0.1, 1, 0.2)), [1.0, 2.0]),
    }


def seconds(call: Callable[[], Any]) -> float:
    """Processor time of a call."""
    start = time.process_time()
    call()
    return time.process_time() - start


def main() -> None:
    if len(sys.argv) > 1:
        call = calls()[sys.argv[1]]
        first = seconds(call)
        print(first - seconds(call))
        return
    found = {}
    for name in calls():
        with tempfile.TemporaryDirectory() as folder:
            asked = [sys.executable, __file__, name]
            done = subprocess.run(asked, env={**os.environ, "KREISEL_CACHE": folder}, capture_output=True, check=True)
        found[name] = round(float(done.stdout.split()[-1]), 2)
        print(f"{found[name]:8.2f} s  {name}", flush=True)
    RESULT.write_text(json.dumps({"machine": machine(), "seconds": found}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
