"""Time of one n = 3 trajectory without saving: kreisel's kernels against C++ by hand, in one run.

Each map is timed in turn as kernel, as C++ of the same formula, and as C++ of the paper's formula as it stands
(without the correction of the Cayley transform that keeps rounding errors from adding up), many times over;
ratios are medians over the turns.  Parameters are known to neither
side before the run.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cases import RESULTS, Case, cases, machine

from kreisel.runs.plan import make_plan

SOURCE = Path(__file__).with_name("single.cpp")
FLAGS = ["-O3", "-march=native", "-std=c++17", "-shared", "-fPIC"]
DT, STEPS, TURNS = 0.05, 2_000_000, 9
CHECKED, TOLERANCE, GOAL = 1000, 1e-12, 1.2

March = Callable[[np.ndarray, int], np.ndarray]


def compiler() -> str:
    """The path of g++; exits with what to do when there is none."""
    found = shutil.which("g++")
    if found is None:
        sys.exit(
            "benchmarks/single.py compares with C++ and needs the compiler g++, which is not on the PATH. "
            "Install it (for example the package g++ of Debian) and run again; roundoff.py runs without it."
        )
    return found


def build(folder: Path) -> ctypes.CDLL:
    """single.cpp as a library in `folder`."""
    target = folder / "single.so"
    subprocess.run([compiler(), *FLAGS, str(SOURCE), "-o", str(target)], check=True)
    return ctypes.CDLL(str(target))


def contenders(case: Case, library: ctypes.CDLL) -> tuple[np.ndarray, dict[str, March]]:
    """The start as a row, and three ways to march from a row: `march(row, steps) -> row`."""
    model = case.model
    plan = make_plan(model, model.state(**case.states["standard"]), dt=DT, steps=1, every=1, method="suris", order=1,
                     orientation=None)  # fmt: skip
    kernel: Any = plan.engine
    start = kernel.z.copy()
    constants = np.concatenate([np.ravel(plan.scheme.constants[k]) for k in (*model.params, "eps")])

    def compiled(row: np.ndarray, steps: int) -> np.ndarray:
        kernel.z[:] = row
        kernel.advance(np.empty((1, *row.shape)), steps)
        return kernel.z.copy()

    def by_hand(name: str) -> March:
        function = library[name]
        function.restype = None
        function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]

        def march(row: np.ndarray, steps: int) -> np.ndarray:
            out = row.copy()
            function(out.ctypes.data, constants.ctypes.data, steps)
            return out

        return march

    symbol = case.name.replace("-", "_")
    return start, {"kernel": compiled, "cpp": by_hand(symbol), "cpp_plain": by_hand(f"{symbol}_plain")}


def agreement(start: np.ndarray, march: dict[str, March], case: str) -> dict[str, float]:
    """Largest difference of the states after some steps; raises if they are different maps."""
    end = march["kernel"](start, CHECKED)
    apart = {name: float(abs(march[name](start, CHECKED) - end).max()) for name in ("cpp", "cpp_plain")}
    if not max(apart.values()) < TOLERANCE:
        raise AssertionError(f"{case}: kernel and C++ are {apart} apart after {CHECKED} steps, not within {TOLERANCE}")
    return apart


def timed(start: np.ndarray, march: dict[str, March], steps: int, turns: int) -> dict[str, np.ndarray]:
    """Nanoseconds a step, one number for each turn."""
    out: dict[str, list[float]] = {name: [] for name in march}
    for function in march.values():
        function(start, steps // 10)
    for turn in range(turns):
        names = list(march)[turn % 3 :] + list(march)[: turn % 3]
        for name in names:
            begun = time.perf_counter()
            march[name](start, steps)
            out[name].append((time.perf_counter() - begun) / steps * 1e9)
    return {name: np.array(values) for name, values in out.items()}


def summary(ns: dict[str, np.ndarray]) -> dict[str, Any]:
    """Medians, quartiles and ratios."""
    row: dict[str, Any] = {}
    for name, values in ns.items():
        low, middle, high = np.percentile(values, [25, 50, 75])
        row[name] = {
            "ns": round(middle, 2),
            "quartiles": [round(low, 2), round(high, 2)],
            "least": round(min(values), 2),
        }
    row["kernel/cpp"] = round(float(np.median(ns["kernel"] / ns["cpp"])), 3)
    row["cpp/cpp_plain"] = round(float(np.median(ns["cpp"] / ns["cpp_plain"])), 3)
    return row


def measure(steps: int = STEPS, turns: int = TURNS) -> dict[str, Any]:
    """Everything, as written to results/single.json."""
    version = subprocess.run([compiler(), "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[
        0
    ]
    told = {"machine": machine(), "compiler": version, "flags": FLAGS, "dt": DT, "steps": steps, "turns": turns}
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        print(f"Building single.cpp with {version} {' '.join(FLAGS[:2])} in a temporary folder.", flush=True)
        library = build(Path(folder))
        print(f"{turns} turns of {steps:,} steps each; nanoseconds a step, median [quartiles].\n")
        print(f"{'map, n = 3':<21}{'kernel':>22}{'C++, same formula':>22}{'C++, plain':>22}{'kernel/C++':>12}")
        for case in cases(generic=True):
            start, march = contenders(case, library)
            apart = agreement(start, march, case.name)
            rows[case.name] = {**summary(timed(start, march, steps, turns)), "apart_after_1000": apart}
            print(_line(case.name, rows[case.name]), flush=True)
    return {**told, "maps": rows}


def _line(name: str, row: dict[str, Any]) -> str:
    cells = (f"{row[k]['ns']:.1f} [{row[k]['quartiles'][0]:.1f}, {row[k]['quartiles'][1]:.1f}]" for k in list(row)[:3])
    mark = "" if row["kernel/cpp"] <= GOAL else f"  over the goal of {GOAL}"
    return f"{name:<21}" + "".join(f"{cell:>22}" for cell in cells) + f"{row['kernel/cpp']:>12.2f}{mark}"


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--output", type=Path, default=RESULTS / "single.json")
    options = parser.parse_args(arguments)
    result = measure(options.steps, options.turns)
    options.output.parent.mkdir(exist_ok=True)
    options.output.write_text(json.dumps(result, indent=1) + "\n")
    print(f"\nWritten: {options.output}")


if __name__ == "__main__":
    main()
