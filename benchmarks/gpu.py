"""The GPU: steps a second for 10^4 ... 10^7 trajectories, the part of the instruction bound, equality with the CPU.

n = 3, rest-frame Lagrange top, the paper's map, float64 and float32, parameters and states of each lane its own. The
bound counts the arithmetic instructions of a step in the machine code (gpu_code.py) against the rate at which the
multiprocessors of an H100 or H200 issue them, at the largest clock that the driver names. Needs an NVIDIA GPU and
`pip install 'kreisel[cuda]'`; writes benchmarks/results/gpu.json.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import gpu_code
import numpy as np
from cases import RESULTS, machine

import kreisel as kr
from kreisel.kernels.gpu import device
from kreisel.runs.planning import make_plan

COUNTS = (10**4, 10**5, 10**6, 10**7)
CHECKED = 100


def plan_of(engine: str, lanes: int) -> Any:
    draw = np.random.default_rng(1)
    top = kr.LagrangeTop(p=draw.normal(size=(lanes, 3)))
    state = top.state(m=draw.normal(size=(lanes, 3)), a=draw.normal(size=(lanes, 3)))
    return make_plan(top, state, dt=0.05, steps=1, every=1, method="suris", order=1, orientation=None, engine=engine)


def speed(engine: str, lanes: int, turns: int) -> dict[str, float]:
    """Steps a second by the clock of the device, the kernel alone and with the copy to the host."""
    import cupy

    work = plan_of(engine, lanes).engine
    steps = max(100, 2 * 10**10 // lanes // 10)
    rows = cupy.empty((1, *work.z.shape[::-1]), dtype=work._real)

    def launch(steps: int) -> None:
        arrays = work._state, work._constants, work._stages, rows
        work._device.launch(work._kernel, lanes, *arrays, 1, steps, work._stage_count)

    launch(10)
    alone, whole = [], []
    out = np.empty((1, *work.z.shape))
    for _ in range(turns):
        before, after = cupy.cuda.Event(), cupy.cuda.Event()
        before.record()
        launch(steps)
        after.record()
        after.synchronize()
        alone.append(steps * lanes / (cupy.cuda.get_elapsed_time(before, after) * 1e-3))
        begun = time.perf_counter()
        work.advance(out, steps)
        whole.append(steps * lanes / (time.perf_counter() - begun))
    low, middle, high = np.percentile(alone, [25, 50, 75])
    return {"steps": steps, "per_second": float(middle), "quartiles": [float(low), float(high)],
            "with_copy": float(np.median(whole))}  # fmt: skip


def apart(engine: str, lanes: int = 1000) -> float:
    """The largest difference from the CPU after some steps."""
    here, there = plan_of("cpu", lanes).engine, plan_of(engine, lanes).engine
    out, other = np.empty((1, *here.z.shape)), np.empty((1, *here.z.shape))
    here.advance(out, CHECKED)
    there.advance(other, CHECKED)
    return float(abs(out - other).max())


def bound(engine: str) -> dict[str, Any]:
    """Steps a second that the arithmetic instructions allow."""
    device()  # refused where there is none
    import cupy

    gpu = cupy.cuda.Device()
    count = gpu_code.counted(plan_of(engine, 1).scheme, engine, gpu.compute_capability)
    processors, hertz = gpu.attributes["MultiProcessorCount"], 1e3 * gpu.attributes["ClockRate"]
    most = gpu_code.bound(count, engine, processors, hertz)
    return count | {"multiprocessors": processors, "clock_hz": hertz, "steps_per_second": most}


def driver() -> str:
    asked = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--output", type=Path, default=RESULTS / "gpu.json")
    options = parser.parse_args(arguments)
    found: dict[str, Any] = {}
    for engine in gpu_code.RATES:
        try:
            limit = bound(engine)
        except kr.InputError as error:
            sys.exit(str(error))
        rows = {str(count): speed(engine, count, options.turns) for count in COUNTS}
        best = max(row["per_second"] for row in rows.values())
        found[engine] = {"bound": limit, "fraction": best / limit["steps_per_second"], "lanes": rows,
                         f"apart_after_{CHECKED}": apart(engine)}  # fmt: skip
        print(f"{engine}: {best:.3g} steps/s, {found[engine]['fraction']:.2f} of the bound, {apart(engine):.1e} apart")
    result = {"machine": machine(), "gpu": driver(), "turns": options.turns, "engines": found}
    options.output.write_text(json.dumps(result, indent=1) + "\n")
    print(f"Written: {options.output}")


if __name__ == "__main__":
    main()
