"""`kreisel bench`: the speed of each map on this machine, in about a minute."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from kreisel.bench import ensemble, saving, single
from kreisel.bench.cases import cases, machine
from kreisel.bench.compiled import MISSING, build, compiler

SINGLE_STEPS, ENSEMBLE_STEPS, TURNS = 300_000, 5_000, 5
EVERY, PART = 100, 10  # saving: steps between two rows, and the part of the steps of `kreisel.bench.saving`


def bench(tell: Callable[[str], None] = lambda name: None) -> dict[str, Any]:
    """The five maps for n = 3, each timed in turns with C++ of the same formula where g++ is installed.

    ns a step of one trajectory, and of a lane of an ensemble, on one core; their ratios to C++; one core over all
    cores; time with a row saved every 100 steps over time without.  `tell` is called with the name of each map.
    """
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        alone, many = (build(name, Path(folder)) if compiler() else None for name in ("single", "ensemble"))
        for case in cases(generic=True):
            tell(case.name)
            start, steppers = single.contenders(case, alone)
            one = single.single_summary(single.timed(start, steppers, SINGLE_STEPS, TURNS))
            lanes = ensemble.ensemble_summary(ensemble.Contest(case, many).timed(TURNS, ENSEMBLE_STEPS))
            saved = saving.ratios(case, "suris", 3, PART, (EVERY,))
            row = {"ns_a_step": one["kernel"]["ns"], "ns_a_lane_step": lanes["kernel"]["ns"]}
            if alone is not None:
                row |= {"step_to_cpp": one["kernel/cpp"], "lane_step_to_cpp": lanes["kernel/cpp"]}
            row |= {"one_core_to_all": lanes["one/all_cores"], "saving": saved[f"every {EVERY}"]["ratio"]}
            rows[case.name] = row
    note = {} if compiler() else {"note": MISSING}
    return {"machine": machine(), "load_average": round(os.getloadavg()[0], 1), **note, "maps": rows}
