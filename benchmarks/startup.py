"""Start-up: `import kreisel`, and `kreisel run` with a warm cache up to its first step, each in fresh processes.

Wall time from the start of the process, and its processor time (user and system), which other work on the machine
changes less; least, median and quartiles over the rounds.  NumPy is measured next to them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine, parser, write

TURNS = 15
GOALS = {"import kreisel": 0.3, "kreisel run, first step": 1.5}
DONE = "import os, sys, time; print(time.time(), time.process_time(), flush=True); os._exit(0)"
EXAMPLE = Path(__file__).parents[1] / "examples" / "lagrange-top.toml"
FIRST_STEP = """
import os, sys, time
from kreisel.kernels import cpu  # which the run imports anyway

def first(*_):
    print(time.time(), time.process_time(), flush=True)
    os._exit(0)

cpu.CpuEngine.advance = first
from kreisel.cli import main
sys.argv = ["kreisel", "run", {path!r}, "--overwrite"]
main()
"""


def codes() -> dict[str, str]:
    return {
        "import numpy": f"import numpy; {DONE}",
        "import kreisel": f"import kreisel; {DONE}",
        "kreisel run, first step": FIRST_STEP.format(path=str(EXAMPLE)),
    }


def once(code: str, folder: str) -> tuple[float, float]:
    """Seconds by the clock and of the processor, until the process prints its line."""
    begun = time.time()
    out = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True).stdout
    by_clock, worked = map(float, out.split()[-2:])
    return by_clock - begun, worked


def worked(values: list[tuple[float, float]]) -> np.ndarray:
    """The processor times."""
    return np.array(values)[:, 1]


def measure(turns: int) -> dict[str, Any]:
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in codes()}
    load = round(os.getloadavg()[0], 1)
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(-1, turns):  # the first warms the caches
            for name, code in codes().items():
                seconds = once(code, folder)
                if turn >= 0:
                    found[name].append(seconds)
    rows = {}
    for name, values in found.items():
        row: dict[str, Any] = {}
        for clock, seconds in zip(("wall", "processor"), np.array(values).T, strict=True):
            low, middle, high = np.percentile(seconds, [25, 50, 75])
            row[clock] = {"least": round(float(seconds.min()), 3), "median": round(float(middle), 3),
                         "quartiles": [round(float(low), 3), round(float(high), 3)]}  # fmt: skip
        row["to import numpy"] = round(float(np.median(worked(values) / worked(found["import numpy"]))), 2)
        rows[name] = row | ({"goal": GOALS[name]} if name in GOALS else {})
        print(f"{name:<26}" + "   ".join(f"{k}: least {v['least']:.2f}, median {v['median']:.2f} s"
                                          for k, v in row.items() if isinstance(v, dict)), flush=True)  # fmt: skip
    return {"machine": machine(), "turns": turns, "load_average_before": load, "starts": rows}


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write the JSON."""
    options = parser(__doc__, "startup")
    options.add_argument("--turns", type=int, default=TURNS)
    asked = options.parse_args(arguments)
    write(measure(asked.turns), asked.output)


if __name__ == "__main__":
    main()
