"""Moser and Veselov's map, n = 3: kreisel's kernel against C++ by Newton's method for quaternions, in one run.

One trajectory, and 1024 lanes on one core; and the Lagrange top's map, as a measure of the machine.  Processor
time, medians over rounds.  Writes results/moser_veselov.json.
"""

from __future__ import annotations

import ctypes
import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

os.environ["KREISEL_NUM_THREADS"] = "1"

import numpy as np
from cases import RESULTS, machine, steps_of

import kreisel as kr
from kreisel.bench import FLAGS, build
from kreisel.runs.planning import make_plan

DT, TURNS = 0.1, 9
J, MU = (1.0, 2.0, 3.0), (1.0, -0.5, 0.75)
SIZES = {"single": (1, 200_000), "lane": (1024, 400)}


def kernel(model: Any, state: Mapping[str, Any], lanes: int, method: str) -> Callable[[int], Any]:
    """The state after a number of steps."""
    start = {k: np.tile(v, (lanes, 1)) for k, v in state.items()} if lanes > 1 else state
    return steps_of(model, start, dt=DT, method=method, order=2)


def by_hand(library: ctypes.CDLL, lanes: int, start: np.ndarray) -> tuple[Callable[[int], None], np.ndarray]:
    function = library.moser_veselov
    function.restype, function.argtypes = None, [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long, ctypes.c_long]
    rows = np.ascontiguousarray(np.tile(start, (lanes, 1)))
    constants = np.array([J[1] + J[2], J[2] + J[0], J[0] + J[1], DT])
    return lambda steps: function(rows.ctypes.data, constants.ctypes.data, lanes, steps), rows


def main() -> None:
    top, other = kr.EulerTop(J=J), kr.LagrangeTop(p=(0.3, -0.2, 0.9))
    result: dict[str, object] = {"machine": machine(), "flags": FLAGS, "dt": DT, "turns": TURNS}
    with tempfile.TemporaryDirectory() as folder:
        library = build(Path(__file__).with_name("moser_veselov.cpp"), Path(folder))
        for name, (lanes, steps) in SIZES.items():
            mine = kernel(top, {"M": MU}, lanes, "veselov")
            engine = make_plan(top, {"M": MU}, dt=DT, steps=1, method="veselov", order=2).engine
            theirs, rows = by_hand(library, lanes, engine.z[0, :3].copy())  # the map's variables, half a kick before M
            beside = kernel(other, {"m": MU, "a": (0.6, 0.0, 0.8)}, lanes, "suris")
            theirs(1000)
            engine.advance(np.empty((1, *engine.z.shape)), 1000)
            apart = float(abs(engine.z[:, :3] - rows).max())
            assert apart < 1e-12, f"kernel and C++ are {apart} apart after 1000 steps"
            ns = np.empty((TURNS, 3))
            for turn in range(TURNS):
                for place, run in enumerate((mine, theirs, beside)):
                    begun = time.process_time()
                    run(steps)
                    ns[turn, place] = (time.process_time() - begun) / steps / lanes * 1e9
            middle = np.median(ns, 0)
            result[name] = {
                "kernel": round(float(middle[0]), 2),
                "cpp_quaternions": round(float(middle[1]), 2),
                "lagrange_top": round(float(middle[2]), 2),
                "kernel/cpp": round(float(np.median(ns[:, 0] / ns[:, 1])), 3),
                "kernel/lagrange_top": round(float(np.median(ns[:, 0] / ns[:, 2])), 3),
                "apart_after_1000": apart,
            }
            print(name, result[name], flush=True)
    RESULTS.joinpath("moser_veselov.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
