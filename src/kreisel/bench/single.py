"""Time of one n = 3 trajectory without saving: kreisel's kernels against C++ by hand, in one run.

Each map is timed in turn as kernel, projections included, and as C++ of the same formula without them, many times
over; ratios are medians over the turns.  Parameters are known to neither side before the run.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.bench.cases import BenchCase, cases, machine
from kreisel.bench.compiled import FLAGS, build, version
from kreisel.runs.plan import make_plan

DT, STEPS, TURNS = 0.05, 2_000_000, 9
CHECKED, TOLERANCE, GOAL = 1000, 1e-12, 1.05

Stepper = Callable[[Array, int], Array]


def contenders(case: BenchCase, library: ctypes.CDLL | None) -> tuple[Array, dict[str, Stepper]]:
    """The start as a row, and ways to step from a row, without a library one: `advance(row, steps) -> row`."""
    model = case.model
    plan = make_plan(model, model.state(**case.states["standard"]), dt=DT, steps=1, every=1, method="suris", order=1,
                     orientation=None)  # fmt: skip
    kernel: Any = plan.engine
    start = kernel.z.copy()
    constants = np.concatenate([np.ravel(plan.scheme.constants[k]) for k in (*model.params, "eps")])

    def compiled(row: Array, steps: int) -> Array:
        kernel.z[:] = row
        kernel.advance(np.empty((1, *row.shape)), steps)
        return kernel.z.copy()

    def by_hand(function: Any) -> Stepper:
        function.restype = None
        function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]

        def advance(row: Array, steps: int) -> Array:
            out = row.copy()
            function(out.ctypes.data, constants.ctypes.data, steps)
            return out

        return advance

    steppers: dict[str, Stepper] = {"kernel": compiled}
    if library is not None:
        symbol = case.name.replace("-", "_")
        steppers["cpp"] = by_hand(library[symbol])
    return start, steppers


def agreement(start: Array, steppers: dict[str, Stepper], case: str) -> dict[str, float]:
    """Largest difference of the states after some steps; raises if they are different maps."""
    end = steppers["kernel"](start, CHECKED)
    apart = {name: float(abs(steppers[name](start, CHECKED) - end).max()) for name in steppers if name != "kernel"}
    if apart and not max(apart.values()) < TOLERANCE:
        raise AssertionError(f"{case}: kernel and C++ are {apart} apart after {CHECKED} steps, not within {TOLERANCE}")
    return apart


def timed(start: Array, steppers: dict[str, Stepper], steps: int, turns: int) -> dict[str, Array]:
    """Nanoseconds a step, one number for each turn."""
    out: dict[str, list[float]] = {name: [] for name in steppers}
    for function in steppers.values():
        function(start, steps // 10)
    for turn in range(turns):
        names = [*steppers][turn % len(steppers) :] + [*steppers][: turn % len(steppers)]
        for name in names:
            begun = time.perf_counter()
            steppers[name](start, steps)
            out[name].append((time.perf_counter() - begun) / steps * 1e9)
    return {name: np.array(values) for name, values in out.items()}


def single_summary(ns: dict[str, Array]) -> dict[str, Any]:
    """Medians, quartiles and ratios."""
    row: dict[str, Any] = {}
    for name, values in ns.items():
        low, middle, high = np.percentile(values, [25, 50, 75])
        row[name] = {
            "ns": round(middle, 2),
            "quartiles": [round(low, 2), round(high, 2)],
            "least": round(min(values), 2),
        }
    if "cpp" in ns:
        row["kernel/cpp"] = round(float(np.median(ns["kernel"] / ns["cpp"])), 3)
    return row


def measure(steps: int = STEPS, turns: int = TURNS) -> dict[str, Any]:
    """Everything, as written to results/single.json."""
    setting = {"machine": machine(), "compiler": version(), "flags": FLAGS, "dt": DT, "steps": steps, "turns": turns}
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        print(f"Building single.cpp with {version()} {' '.join(FLAGS[:2])} in a temporary folder.", flush=True)
        library = build("single", Path(folder))
        print(f"{turns} turns of {steps:,} steps each; nanoseconds a step, median [quartiles].\n")
        print(f"{'map, n = 3':<21}{'kernel':>22}{'C++':>22}{'kernel/C++':>12}")
        for case in cases(generic=True):
            start, steppers = contenders(case, library)
            apart = agreement(start, steppers, case.name)
            rows[case.name] = {**single_summary(timed(start, steppers, steps, turns)), "apart_after_1000": apart}
            print(_line(case.name, rows[case.name]), flush=True)
    return {**setting, "maps": rows}


def _line(name: str, row: dict[str, Any]) -> str:
    cells = (f"{row[k]['ns']:.1f} [{row[k]['quartiles'][0]:.1f}, {row[k]['quartiles'][1]:.1f}]" for k in list(row)[:2])
    mark = "" if row["kernel/cpp"] <= GOAL else f"  over the goal of {GOAL}"
    return f"{name:<21}" + "".join(f"{cell:>22}" for cell in cells) + f"{row['kernel/cpp']:>12.2f}{mark}"
