"""Ensembles of n = 3 trajectories without saving: kr.propagator's `steps` against C++ by hand, all cores against one.

Maps are timed alternately as a user calls them, on one core ("kernel"), as C++ with one to four chains of vectors (the
fastest counts), and so called on all cores; ratios are medians over the rounds.  One core is timed by the processor
time of the thread, all cores against one by the clock, which is meaningful on an idle machine only: the load average is
written with it.  If llvm-mca works, the kernel's loop is set against the cycles that its instructions need at least.
Writes results/ensemble.json.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cases import BenchCase, cases, machine, parser, write

from kreisel.bench import DT, FLAGS, LANES, Contest, build, summary
from kreisel.graph.graph import OVER, Number
from kreisel.graph.machine import assembly, processor
from kreisel.graph.recording import Recording
from kreisel.kernels.steps import Split, written_steps
from kreisel.runs.planning import make_plan

STEPS, TURNS, CHECKED = 5_000, 9, 100
VECTOR = re.compile(r"[yz]mm")
ANALYSER_SECONDS = 60  # llvm-mca needs less than one


def gigahertz(library: ctypes.CDLL) -> float:
    """Cycles a nanosecond, from additions that wait for each other; the best of many short looks."""
    best = 0.0
    for _ in range(200):
        begun = time.perf_counter()
        library.dependent_additions(ctypes.c_long(1000))
        best = max(best, 1e5 / (time.perf_counter() - begun) * 1e-9)
    return best


def add_threads_of_cpp(contest: Contest, function: Any) -> None:
    """The contender "all cores, cpp": C++ on all cores, each with its share of the lanes; a measure of the machine."""
    lanes = contest.lanes or 1
    shares = np.array_split(np.arange(lanes), os.cpu_count() or 1)
    function.restype, function.argtypes = None, [ctypes.c_void_p] * 2 + [ctypes.c_long] * 2

    def advance(steps: int) -> np.ndarray:
        rows, constants = contest.rows(), contest.constants
        with ThreadPoolExecutor(len(shares)) as pool:
            work = [
                pool.submit(function, rows[a:].ctypes.data, constants[a:].ctypes.data, len(share), steps)
                for share in shares
                for a in share[:1]
            ]
        for done in work:
            done.result()
        return contest.states(rows)

    contest.steppers["all cores, cpp"] = advance


class Code(NamedTuple):
    """A kernel's assembly, the lanes of a vector, and the quotients of a step."""

    assembly: str
    lanes: int
    quotients: int


def code_of(case: BenchCase, lanes: int = LANES) -> Code:
    """The kernel of such an ensemble."""
    state = {k: np.tile(np.asarray(v, dtype=float), (lanes, 1)) for k, v in case.states["standard"].items()}
    settings: dict[str, Any] = {"dt": DT, "steps": 1, "every": 1, "method": "suris", "order": 1}
    engine: Any = make_plan(case.model, case.model.state(**state), **settings).engine
    record = Recording(engine.scheme, engine.constants, engine.columns, engine.stage_columns)
    writing = written_steps(record, lanes, bool(engine.code.programs))
    nodes = [piece.graph.nodes[at] for piece in record.pieces for at in Split.of(record, piece).varying]
    quotients = sum(node[0] == OVER and isinstance(node[2], Number) for node in nodes)  # LLVM multiplies by 1/2
    return Code(assembly(7, writing.write), writing.lanes, quotients)


def bound(code: Code) -> dict[str, Any] | None:
    """Cycles that the instructions of the loop over steps need a lane, by llvm-mca; None if it is missing or fails.

    The longest loop of vectors is the loop of the steps if it has each quotient of the step, once for each vector.
    """
    analyser = shutil.which("llvm-mca")
    loop = _longest_loop(code.assembly) if analyser else []
    if not analyser or not loop:
        return None
    lanes, quotients = code.lanes, code.quotients
    width = 8 if any("zmm" in line for line in loop) else 4
    divisions = sum("vdivpd" in line for line in loop)
    if divisions != quotients * lanes // width:
        raise AssertionError(f"{divisions} divisions in the loop, {quotients} in the step on {lanes // width} vectors")
    cycles = _throughput(analyser, "\n".join(loop))
    if cycles is None:
        return None
    return {"instructions": len(loop), "vectors": lanes // width, "cycles_a_lane_step": cycles / lanes}


def _throughput(analyser: str, assembly: str) -> float | None:
    """Cycles of a block; None if the tool, if older than our LLVM, does not know its syntax or this processor."""
    command = [analyser, f"-mcpu={processor()[1]}", "-iterations=100"]
    try:
        done = subprocess.run(command, input=assembly, text=True, capture_output=True, check=False,
                              timeout=ANALYSER_SECONDS)  # fmt: skip
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    if "not a recognized processor" in done.stderr:  # the tool would count the cycles of another one
        return None
    cycles = re.findall(r"Block RThroughput:\s+(\d+(?:\.\d+)?)\s", done.stdout)
    return float(cycles[0]) if done.returncode == 0 and len(cycles) == 1 else None


def _longest_loop(assembly: str) -> list[str]:
    best: list[str] = []
    label = ""
    block: list[str] = []
    for line in assembly.splitlines():
        start = re.match(r"(\.LBB\S+):", line)
        if start:
            label, block = start[1], []
        elif re.match(r"\s+\w", line):
            block.append(line)
            jump = re.match(r"\s+j\w+\s+(\S+)", line)
            if jump and jump[1] == label and sum(map(bool, map(VECTOR.search, block))) > len(best) / 2:
                best = list(block) if len(block) > len(best) else best
    return best


def measure(turns: int = TURNS, steps: int = STEPS) -> dict[str, Any]:
    """Everything, as written to results/ensemble.json."""
    rows, load = {}, round(os.getloadavg()[0], 1)
    with tempfile.TemporaryDirectory() as folder:
        library = build("ensemble", Path(folder))
        print(f"{'map, n = 3':<21}{'kernel':>10}{'C++':>8}{'all cores':>10}{'kernel/C++':>12}{'cores':>7}")
        for case in cases(generic=True):
            contest = Contest(case, library, LANES)
            add_threads_of_cpp(contest, library[f"{case.name.replace('-', '_')}_2"])
            apart, least = contest.agreement(CHECKED), bound(code_of(case))
            cycles = gigahertz(library)
            row = {**summary(contest.timed(turns, steps)), "apart": apart, "gigahertz": round(cycles, 2)}
            if least:
                fraction = least["cycles_a_lane_step"] / cycles / row["kernel"]["least"]
                row["bound"] = {**least, "fraction_reached": round(fraction, 2)}
            rows[case.name] = row
            times = [row[k]["ns"] for k in ("kernel", "cpp", "all_cores")]
            print(f"{case.name:<21}{times[0]:>10.2f}{times[1]:>8.2f}{times[2]:>10.2f}"
                  f"{row['kernel/cpp']:>12.2f}{row['one/all_cores']:>7.2f}", flush=True)  # fmt: skip
    return {"machine": machine(), "flags": FLAGS, "lanes": LANES, "steps": steps, "turns": turns, "dt": DT,
            "load_average_before": load, "maps": rows}  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write the JSON."""
    options = parser(__doc__, "ensemble")
    options.add_argument("--steps", type=int, default=STEPS)
    options.add_argument("--turns", type=int, default=TURNS)
    asked = options.parse_args(arguments)
    write(measure(asked.turns, asked.steps), asked.output)


if __name__ == "__main__":
    main()
