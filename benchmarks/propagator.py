"""Cost of a call in addition to the steps: kr.propagator, kr.at and kr.simulate, all as a user calls them.

    python benchmarks/propagator.py

Writes results/propagator.json.  Every figure is the least of several repetitions of a loop of calls, warm, on one core.
"above the kernel": the time of a call of one step minus that of a further step in a call of many.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("KREISEL_NUM_THREADS", "1")

import numpy as np

import kreisel as kr
from kreisel.runs.propagation.propagator import Propagator

RESULT = Path(__file__).parent / "results" / "propagator.json"
START = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8])
BODY = np.array([1.0, 0.2, -1.5])
LANES, STEPS, ROWS = 4096, 2000, 10**6
METHODS = (("suris", None), ("baecklund", 2), ("baecklund", 8))


def took(call: Callable[[], Any], repetitions: int = 300, seconds: float = 0.3) -> float:
    """Microseconds of processor time of a call, the least of several loops that last `seconds` together."""
    call()
    begun = time.process_time()
    call()
    count = max(1, int(seconds / repetitions / max(time.process_time() - begun, 1e-7)))
    best = np.inf
    for _ in range(repetitions):
        begun = time.process_time()
        for _ in range(count):
            call()
        best = min(best, (time.process_time() - begun) / count)
    return 1e6 * best


def stepping(p: Propagator, x: np.ndarray) -> dict[str, float]:
    """Microseconds of a call of one step, of a further step, and their difference."""
    one, many = took(lambda: p.steps(x, 1)), took(lambda: p.steps(x, STEPS))
    step = (many - one) / (STEPS - 1)
    return {"one step us": one, "further step us": step, "above the kernel us": one - step}


def forms(model: Any, call: Callable[[Any], Any], x: np.ndarray) -> dict[str, float]:
    """Microseconds of a call with one state as an array, as a dict of axial vectors and vectors, and as a `State`."""
    letters = model.system.space.letters
    components = dict(zip(letters, np.split(x, len(letters)), strict=True))
    states = {"array": x, "dict": components, "State": model.state(**components)}
    return {f"{form} us": took(lambda state=state: call(state)) for form, state in states.items()}


def measure() -> dict[str, Any]:
    """Everything, as written to results/propagator.json."""
    top, euler = kr.LagrangeTop(p=(0, 0, 1)), kr.EulerTop(J=(1, 2, 3))
    state, lanes = {"m": START[:3], "a": START[3:]}, np.tile(START, (LANES, 1))
    found: dict[str, Any] = {}
    for method, order in METHODS:
        p = kr.propagator(top, method=method, order=order, dt=0.05)
        one, all_of_them = stepping(p, START), stepping(p, lanes)
        per_lane = {f"{k} a lane": v / LANES for k, v in all_of_them.items()}
        found[f"LagrangeTop, {method} {order or 1}"] = one | per_lane
    for method in ("suris", "baecklund"):
        p = kr.propagator(top, method=method, dt=0.05)
        found[f"LagrangeTop, {method}, 10 steps"] = forms(top, lambda state, p=p: p.steps(state, 10), START)
    for name, model, x in (("LagrangeTop", top, START), ("EulerTop", euler, BODY)):
        p = kr.propagator(model, method="exact")
        many = np.tile(x, (LANES, 1))
        found[f"{name}, exact"] = {
            "a state at a time us": took(lambda p=p, x=x: p.at(x, 37.7)),
            "its machine code us": took(p._stepper._rooms[-1].chain.call),
            "a state at a time us a lane": took(lambda p=p, many=many: p.at(many, 37.7)) / LANES,
        }
        found[f"{name}, exact, at a time"] = forms(model, lambda state, p=p: p.at(state, 37.7), x)
    found["kr.at, one time"] = {"us": took(lambda: kr.at(top, state, 37.7))}
    found["kr.simulate, 100 steps"] = {"us": took(lambda: kr.simulate(top, state, dt=0.05, steps=100, progress=False))}
    for method in ("exact", "baecklund"):
        options = {"dt": 0.05, "steps": ROWS, "method": method, "progress": False}
        for said, observe in (("all", None), ("the state alone", [])):
            spent = took(lambda o=options, k=observe: kr.simulate(top, state, **o, observe=k), 3, 0.0)
            found.setdefault(f"kr.simulate, {method}, 10^6 rows in memory", {})[f"{said}, ns a row"] = (
                1e3 * spent / ROWS
            )
    return found


def main() -> None:
    """Measure, print and write."""
    from kreisel.bench import machine

    found = measure()
    for name, figures in found.items():
        print(f"{name:<44}" + "  ".join(f"{k} {v:.3g}" for k, v in figures.items()), flush=True)
    RESULT.write_text(json.dumps({"machine": machine(), "figures": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
