"""Cost of saving: kr.simulate with every = 1, 10, 100, 1000, all integrals computed, against kr.propagator's steps.

Single trajectories, n = 3; ratios of the thread's processor time of a step in one run, medians and quartiles over the
rounds. Memory: the peak of a run to disk over ten times more rows, as a ratio.  Writes results/saving.json.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from cases import cases, machine, parser, write

from kreisel.bench import saving_ratios

TURNS = 7

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


def measure(turns: int = TURNS, share: int = 1) -> dict[str, Any]:
    """Everything, as written to results/saving.json; one in `share` of the steps for a quick look."""
    rows = {}
    for case in cases():
        for method in ("suris", "baecklund"):
            if method == "baecklund" and case.model.system.baecklund is None:
                continue
            rows[f"{case.name}, {method}"] = row = saving_ratios(case, method, turns, share)
            cells = [f"{k}: {v['ratio']:.2f}" for k, v in row.items() if k.startswith("every")]
            print(f"{case.name:<21}{method:<11}" + "   ".join(cells), flush=True)
    peak = memory(30_000 // share)
    print(f"peak memory, MiB: {peak}")
    return {
        "machine": machine(),
        "turns": turns,
        "share": share,
        "load_average_after": round(os.getloadavg()[0], 1),
        "runs": rows,
        "peak_memory_MiB": peak,
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write the JSON."""
    options = parser(__doc__, "saving")
    options.add_argument("--turns", type=int, default=TURNS)
    options.add_argument("--share", type=int, default=1, help="one in so many of the steps, for a quick look")
    asked = options.parse_args(arguments)
    write(measure(asked.turns, asked.share), asked.output)


if __name__ == "__main__":
    main()
