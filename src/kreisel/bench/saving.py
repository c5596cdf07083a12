"""What saving costs: kr.simulate with every = 1, 10, 100, 1000, all integrals computed, against kr.propagator's steps.

Single trajectories, n = 3; ratios of the thread's processor time of a step in one run, medians and quartiles over the
turns. Memory: the peak of a run to disk over ten times more rows, as a ratio.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import kreisel as kr
from kreisel.bench.cases import BenchCase, cases, machine

STEPS = {1: 500_000, 10: 3_000_000, 100: 10_000_000, 1000: 10_000_000}
TURNS, DT = 7, 0.05


def without(case: BenchCase, method: str, steps: int) -> float:
    """Seconds a step of a propagator."""
    p = kr.propagator(case.model, method=method, order=2, dt=DT)
    start = case.states["standard"]
    p.steps(start, 10)  # compiled and loaded
    begun = time.thread_time()
    p.steps(start, steps)
    return (time.thread_time() - begun) / steps


def saving(case: BenchCase, method: str, every: int, steps: int) -> float:
    """Seconds a step of a run in memory, rows and integrals with them."""
    asked: dict[str, Any] = {"dt": DT, "method": method, "order": 2, "progress": False}
    kr.simulate(case.model, case.states["standard"], steps=10, **asked)
    begun = time.thread_time()
    kr.simulate(case.model, case.states["standard"], steps=steps, every=every, **asked)
    return (time.thread_time() - begun) / steps


def ratios(
    case: BenchCase, method: str, turns: int, part: int, everies: Sequence[int] = tuple(STEPS)
) -> dict[str, Any]:
    """Time of a step with saving over that without, for each `every`; a part of the steps."""
    found: dict[int, list[float]] = {every: [] for every in everies}
    base = []
    for _ in range(turns):
        for every in everies:
            steps = STEPS[every]
            alone = without(case, method, STEPS[100] // part)
            base.append(alone)
            found[every].append(saving(case, method, every, steps // part) / alone)
    out: dict[str, Any] = {"ns a step without saving": round(float(np.median(base)) * 1e9, 2)}
    for every, values in found.items():
        low, middle, high = np.percentile(values, [25, 50, 75])
        out[f"every {every}"] = {"ratio": round(middle, 3), "quartiles": [round(low, 3), round(high, 3)]}
    return out


PEAK = """
import kreisel as kr, sys
top = kr.LagrangeTop(p=(0, 0, 1))
rows, path = int(sys.argv[1]), sys.argv[2]
kr.simulate(top, top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), dt=0.05, steps=100 * rows, every=100, path=path)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # getrusage's is the parent's too
print(int(peak.split()[1]) // 1024)
"""


def memory(rows: int) -> dict[str, Any]:
    """Peak MiB of a run to disk."""
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        for count in (rows, 10 * rows):
            command = [sys.executable, "-c", PEAK, str(count), str(Path(folder) / f"{count}.zarr")]
            out[f"{count} rows"] = int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return out


def measure(turns: int = TURNS, part: int = 1) -> dict[str, Any]:
    """Everything, as written to results/saving.json; a part of the steps for a quick look."""
    rows = {}
    for case in cases():
        for method in ("suris", "baecklund"):
            if method == "baecklund" and case.model.system.baecklund is None:
                continue
            rows[f"{case.name}, {method}"] = row = ratios(case, method, turns, part)
            cells = [f"{k}: {v['ratio']:.2f}" for k, v in row.items() if k.startswith("every")]
            print(f"{case.name:<21}{method:<11}" + "   ".join(cells), flush=True)
    peak = memory(30_000 // part)
    print(f"peak memory, MiB: {peak}")
    return {
        "machine": machine(),
        "turns": turns,
        "part": part,
        "load_average_after": round(os.getloadavg()[0], 1),
        "runs": rows,
        "peak_memory_MiB": peak,
    }
