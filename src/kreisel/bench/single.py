"""Time of one n = 3 trajectory without saving: kr.propagator's `steps` against C++ by hand, in one run.

Each map is timed in turn as a user calls it, projections and the call included ("kernel"), and as C++ of the same
formula without them, many times over; ratios are medians over the turns.  Parameters are known to neither side before
the run.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import kreisel as kr
from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bench.cases import BenchCase, cases, machine
from kreisel.bench.compiled import FLAGS, build, version
from kreisel.kernels import layout

DT, STEPS, TURNS = 0.05, 2_000_000, 9
CHECKED, TOLERANCE, GOAL = 1000, 1e-12, 1.05

Stepper = Callable[[Array, int], Array]


def contenders(case: BenchCase, library: ctypes.CDLL | None) -> tuple[Array, dict[str, Stepper]]:
    """The start as a row, and ways to step from a row, without a library one: `advance(row, steps) -> row`.

    A row is a state of the propagator; that of C++ has the entries of skew matrices above the diagonal.
    """
    p = kr.propagator(case.model, method="suris", order=1, dt=DT)
    start = row_of(case)
    constants = np.concatenate([np.ravel(v) for v in (*case.model.params.values(), DT)])
    turned = entries(case)

    def by_hand(function: Any) -> Stepper:
        function.restype = None
        function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]

        def advance(row: Array, steps: int) -> Array:
            out = row @ turned
            function(out.ctypes.data, constants.ctypes.data, steps)
            return np.asarray(out @ turned.T)

        return advance

    steppers: dict[str, Stepper] = {"kernel": p.steps}
    if library is not None:
        symbol = case.name.replace("-", "_")
        steppers["cpp"] = by_hand(library[symbol])
    return start, steppers


def row_of(case: BenchCase) -> Array:
    """The standard start as `kr.propagator` takes it."""
    state = case.model.state(**case.states["standard"]).axial
    return np.concatenate([state[letter] for letter in case.model.system.space.letters])


def entries(case: BenchCase) -> Array:
    """The matrix Q with row Q the row in entries (0, 1), (0, 2), (1, 2) of skew matrices, n = 3."""
    kinds = ["vector" if kind == "skew" else kind for kind in case.model.system.space.kinds]
    rows = layout.restore(np.eye(sum(layout.coordinate_count(kind, 3) for kind in kinds)), kinds, 3)
    own = [algebra.hat(v) if k == "skew" else v for k, v in zip(case.model.system.space.kinds, rows, strict=True)]
    return np.asarray(layout.flatten(own, case.model.system.space.kinds))


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
