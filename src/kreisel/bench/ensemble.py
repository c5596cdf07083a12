"""Ensembles of n = 3 trajectories without saving: kr.propagator's `steps` against C++ by hand, all cores against one.

Each map is timed in turn as a user calls it, on one core ("kernel"), as C++ with one to four chains of vectors (the
fastest counts), as C++ of the paper's formula without correction, and so called on all cores; ratios are medians over
the turns.  One core is timed by the processor time of the thread, all cores against one by the clock, which says
something on an idle machine only: the load average is written beside it.  Where llvm-mca works, the kernel's loop is
set against the cycles that its instructions need at least.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import kreisel as kr
from kreisel.algebra import Array
from kreisel.bench.cases import BenchCase, cases, machine
from kreisel.bench.compiled import FLAGS, build
from kreisel.bench.single import entries, row_of
from kreisel.kernels.cache import assembly_of
from kreisel.runs.planning import make_plan

DT, LANES, STEPS, TURNS = 0.05, 64 * 96, 5_000, 9  # lanes: whole blocks for every number of chains
LONGER = 8  # times as many steps where the clock counts, against the start of the threads
BY_THE_CLOCK = " by the clock"
CHECKED, TOLERANCE = 100, 1e-12
CHAINS = (1, 2, 3, 4)
VECTOR = re.compile(r"[yz]mm")
ANALYSER_SECONDS = 60  # llvm-mca takes less than one

InPlaceStepper = Callable[[int], None]


def gigahertz(library: ctypes.CDLL) -> float:
    """Cycles a nanosecond, from additions that wait for each other; the best of many short looks."""
    best = 0.0
    for _ in range(200):
        begun = time.perf_counter()
        library.dependent_additions(ctypes.c_long(1000))
        best = max(best, 1e5 / (time.perf_counter() - begun) * 1e-9)
    return best


class Contest:
    """The contenders for one map, each on rows of its own from the same start."""

    def __init__(self, case: BenchCase, library: ctypes.CDLL | None):
        self._propagator = kr.propagator(case.model, method="suris", order=1, dt=DT)
        self.start, self._entries = np.tile(row_of(case), (LANES, 1)), entries(case)
        one = np.concatenate([np.ravel(v) for v in (*case.model.params.values(), DT)])
        self._constants = np.tile(one, (LANES, 1))
        self.end, self.rows = self.start, self.start @ self._entries
        symbol = case.name.replace("-", "_")
        self.steppers: dict[str, InPlaceStepper] = {"kernel": self._on_one_core, "all cores": self._on_all_cores}
        if library is None:
            return
        self.steppers |= {f"cpp {k}": self._by_hand(library[f"{symbol}_{k}"]) for k in CHAINS}
        self.steppers["all cores, cpp"] = self._by_hand_on_all_cores(library[f"{symbol}_2"])

    def _on_one_core(self, steps: int) -> None:
        before = os.environ.get("NUMBA_NUM_THREADS")
        os.environ["NUMBA_NUM_THREADS"] = "1"
        try:
            self._on_all_cores(steps)
        finally:
            del os.environ["NUMBA_NUM_THREADS"]
            os.environ.update({} if before is None else {"NUMBA_NUM_THREADS": before})

    def _on_all_cores(self, steps: int) -> None:
        self.end = self._propagator.steps(self.start, steps)

    def _by_hand_on_all_cores(self, function: Any) -> InPlaceStepper:
        """What the machine gives: C++ on so many threads, each with its share of the lanes."""
        function.restype, function.argtypes = None, [ctypes.c_void_p] * 2 + [ctypes.c_long] * 2
        shares = np.array_split(np.arange(LANES), os.cpu_count() or 1)

        def advance(steps: int) -> None:
            with ThreadPoolExecutor(len(shares)) as pool:
                work = [
                    pool.submit(function, self.rows[a:].ctypes.data, self._constants[a:].ctypes.data, len(share), steps)
                    for share in shares
                    for a in share[:1]
                ]
            for done in work:
                done.result()

        return advance

    def _by_hand(self, function: Any) -> InPlaceStepper:
        function.restype, function.argtypes = None, [ctypes.c_void_p] * 2 + [ctypes.c_long] * 2
        return lambda steps: function(self.rows.ctypes.data, self._constants.ctypes.data, LANES, steps)

    def agreement(self) -> float:
        """Largest difference of any contender from the kernel after some steps; raises if they are different maps."""
        self._on_one_core(CHECKED)
        end, apart = self.end, {}
        for name, advance in self.steppers.items():
            self.rows[:] = self.start @ self._entries
            advance(CHECKED)
            found = self.end if name in ("kernel", "all cores") else self.rows @ self._entries.T
            apart[name] = float(abs(found - end).max())
        del apart["kernel"]
        if apart["all cores"] != 0 or not max(apart.values()) < TOLERANCE:
            raise AssertionError(f"after {CHECKED} steps the contenders are {apart} from the kernel")
        return max(apart.values())

    def timed(self, turns: int, steps: int) -> dict[str, Array]:
        """Nanoseconds a lane-step, one number for each turn: of the thread's processor time, and by the clock."""
        out: dict[str, list[float]] = {
            name: []
            for name in (
                *self.steppers,
                *(name + BY_THE_CLOCK for name in ("kernel", "cpp 2") if name in self.steppers),
            )
        }
        for turn in range(turns):
            names = [*out][turn % 3 :] + [*out][: turn % 3]
            for name in names:
                alone = name.removesuffix(BY_THE_CLOCK)
                clock = time.perf_counter if alone != name or "all cores" in name else time.thread_time
                count = steps * (LONGER if clock is time.perf_counter else 1)
                begun = clock()
                self.steppers[alone](count)
                out[name].append((clock() - begun) / count / LANES * 1e9)
        return {name: np.array(values) for name, values in out.items()}


def source_of(case: BenchCase) -> str:
    """The kernel of such an ensemble as text, for its machine code."""
    state = {k: np.tile(np.asarray(v, dtype=float), (LANES, 1)) for k, v in case.states["standard"].items()}
    asked: dict[str, Any] = {"dt": DT, "steps": 1, "every": 1, "method": "suris", "order": 1}
    engine: Any = make_plan(case.model, case.model.state(**state), **asked).engine
    return str(engine.source)


def bound(source: str) -> dict[str, Any] | None:
    """Cycles that the instructions of the loop over steps need a lane, by llvm-mca; None where it is missing or fails.

    The longest loop of vectors is that of the steps if it has each quotient of the step, once for each vector.
    """
    analyser = shutil.which("llvm-mca")
    loop = _longest_loop(assembly_of(source)) if analyser else []
    if not analyser or not loop:
        return None
    (lanes,) = map(int, re.findall(r"^LANES = (\d+)", source, re.MULTILINE))
    width = 8 if any("zmm" in line for line in loop) else 4
    step = source.partition("\ndef step(")[2].partition("\n@")[0]
    quotients = len(re.findall(r" / [a-z]", step))
    divisions = sum("vdivpd" in line for line in loop)
    if divisions != quotients * lanes // width:
        raise AssertionError(f"{divisions} divisions in the loop, {quotients} in the step on {lanes // width} vectors")
    cycles = _throughput(analyser, "\n".join(loop))
    if cycles is None:
        return None
    return {"instructions": len(loop), "vectors": lanes // width, "cycles_a_lane_step": cycles / lanes}


def _throughput(analyser: str, assembly: str) -> float | None:
    """Cycles of a block; None where the tool does not read it: one older than our LLVM does not know its syntax."""
    command = [analyser, "-mcpu=native", "-iterations=100"]
    try:
        done = subprocess.run(command, input=assembly, text=True, capture_output=True, check=False,
                              timeout=ANALYSER_SECONDS)  # fmt: skip
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    cycles = re.findall(r"Block RThroughput:\s+(\d+(?:\.\d+)?)\s", done.stdout)
    return float(cycles[0]) if done.returncode == 0 and len(cycles) == 1 else None


def _longest_loop(assembly: str) -> list[str]:
    best: list[str] = []
    label = ""
    block: list[str] = []
    for line in assembly.splitlines():
        found = re.match(r"(\.LBB\S+):", line)
        if found:
            label, block = found[1], []
        elif re.match(r"\s+\w", line):
            block.append(line)
            jump = re.match(r"\s+j\w+\s+(\S+)", line)
            if jump and jump[1] == label and sum(map(bool, map(VECTOR.search, block))) > len(best) / 2:
                best = list(block) if len(block) > len(best) else best
    return best


def ensemble_summary(ns: dict[str, Array]) -> dict[str, Any]:
    """Medians, quartiles and ratios; of C++ the number of chains that is fastest."""
    row: dict[str, Any] = {}
    by_hand = [n for n in ns if n.startswith("cpp") and not n.endswith(BY_THE_CLOCK)]
    best = min(by_hand, key=lambda n: np.median(ns[n]), default="")
    names = {"kernel": "kernel", "cpp": best, "all_cores": "all cores"}
    for label, name in ((label, name) for label, name in names.items() if name):
        low, middle, high = np.percentile(ns[name], [25, 50, 75])
        row[label] = {
            "ns": round(middle, 2),
            "quartiles": [round(low, 2), round(high, 2)],
            "least": round(min(ns[name]), 2),
        }
    if best:
        row["chains"] = int(best[-1])
    for label, over, under in (
        ("kernel/cpp", "kernel", best),
        ("one/all_cores", "kernel" + BY_THE_CLOCK, "all cores"),
        ("one/all_cores, cpp", "cpp 2" + BY_THE_CLOCK, "all cores, cpp"),
    ):
        if over not in ns or under not in ns:
            continue
        quartiles = np.percentile(ns[over] / ns[under], [25, 50, 75])
        row[label] = round(float(quartiles[1]), 3)
        row[f"{label} quartiles"] = [round(float(q), 3) for q in quartiles[::2]]
    return row


def measure(turns: int = TURNS, steps: int = STEPS) -> dict[str, Any]:
    """Everything, as written to results/ensemble.json."""
    rows, load = {}, round(os.getloadavg()[0], 1)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["KREISEL_CACHE"] = str(Path(folder) / "kernels")  # compiled anew: the assembly is asked for
        library = build("ensemble", Path(folder))
        print(f"{'map, n = 3':<21}{'kernel':>10}{'C++':>8}{'all cores':>10}{'kernel/C++':>12}{'cores':>7}")
        for case in cases(generic=True):
            contest = Contest(case, library)
            apart, least = contest.agreement(), bound(source_of(case))
            cycles = gigahertz(library)
            row = {**ensemble_summary(contest.timed(turns, steps)), "apart": apart, "gigahertz": round(cycles, 2)}
            if least:
                part = least["cycles_a_lane_step"] / cycles / row["kernel"]["least"]
                row["bound"] = {**least, "fraction_reached": round(part, 2)}
            rows[case.name] = row
            times = [row[k]["ns"] for k in ("kernel", "cpp", "all_cores")]
            print(f"{case.name:<21}{times[0]:>10.2f}{times[1]:>8.2f}{times[2]:>10.2f}"
                  f"{row['kernel/cpp']:>12.2f}{row['one/all_cores']:>7.2f}", flush=True)  # fmt: skip
    return {"machine": machine(), "flags": FLAGS, "lanes": LANES, "steps": steps, "turns": turns, "dt": DT,
            "load_average_before": load, "maps": rows}  # fmt: skip
