"""Limits of the exact flow, n = 3: larger errors and costs than elsewhere.

beside    the orientation near the critical sleeping top, against Taylor series in 40 digits
cost      processor time of 1000 rows up to T = 100 there, each in a separate process that ends after a minute
pairs     Clebsch's case at steps of 1: the error of the state a step, against Taylor series in 40 digits
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine, parser, write

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import kreisel as kr
from exact import off, off_turn
from kreisel import algebra
from taylor import taylor, taylor_solution

P, ALPHA, A = (0.0, 0.0, 2.25), 0.5, (0.0, 0.0, 4.0)
SPIN = 6.0  # (m.a/|a|)^2 = 4 |a||p|: critical
TIMES = (0.37, -1.03, 6.6)
CLOSE = (1e-1, 1e-3, 1e-6, 1e-9, 1e-12, 1e-14)
COSTLY = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6)
MOST_SECONDS = 60
BODIES, SEEDS, STEPS = 20, (21, 210), (100, 300)
ROWS = """
import resource, time
resource.setrlimit(resource.RLIMIT_CPU, ({most}, {most}))
import kreisel as kr
top = kr.LagrangeTop(p={P}, alpha={ALPHA})
begun = time.process_time()
kr.simulate(top, {{"m": ({e}, 0, {SPIN}), "a": {A}}}, dt=0.1, steps=1000, method="exact", orientation=(1, 0, 0, 0))
print(time.process_time() - begun)
"""


def beside() -> list[dict[str, Any]]:
    rows = []
    for e in CLOSE:
        top, m = kr.LagrangeTop(p=P, alpha=ALPHA), (e, 0.0, SPIN)
        run = kr.at(top, {"m": m, "a": A}, TIMES, orientation=(1, 0, 0, 0))
        state = turn = 0.0
        for i, when in enumerate(TIMES):
            m1, b1, q = taylor(np.array(m), np.array(A), np.array(P), when, alpha=ALPHA, digits=40)
            state = max(state, off(run.m.values[i], m1), off(run.a.values[i], b1))
            turn = max(turn, off_turn(run.g.values[i], q))
        rows.append({"e": e, "state": _short(state), "orientation": _short(turn)})
        print(rows[-1], flush=True)
    return rows


def cost() -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for e in COSTLY:
        code = ROWS.format(most=MOST_SECONDS, P=P, ALPHA=ALPHA, e=e, SPIN=SPIN, A=A)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        rows.append({"e": e, "seconds": _short(float(done.stdout)) if done.returncode == 0 else f"over {MOST_SECONDS}"})
        print(rows[-1], flush=True)
    return rows


def pairs() -> dict[str, Any]:
    errors = []
    for draw in map(np.random.default_rng, SEEDS):
        for _ in range(BODIES):
            b, M, Q = draw.uniform(0.2, 2, 3), draw.normal(size=3), draw.normal(size=3)
            errors.append(_a_step(kr.Clebsch(b=b), {"M": M, "P": Q / np.linalg.norm(Q)}))
    page = _a_step(kr.Clebsch(b=(0.3, 0.7, 1.9)), {"M": np.array([0.1, 0.2, 1.5]), "P": np.array([0.6, 0, 0.8])})
    middle, worst = float(np.median(errors)), max(errors)
    found = {"bodies": len(errors), "median": _short(middle), "worst": _short(worst), "page": _short(page)}
    print(found, flush=True)
    return found


def _a_step(model: Any, state: dict[str, np.ndarray]) -> float:
    """The largest error of the end state over the number of steps of 1, for some counts of steps."""
    worst = 0.0
    for steps in STEPS:
        run = kr.simulate(model, state, dt=1.0, steps=steps, every=steps, method="exact")
        X, v = taylor_solution(
            algebra.hat(state["M"]), state["P"], model.params["b"], float(steps), clebsch=True, digits=40
        )
        error = max(off(run.M.values[-1], algebra.axial(X)), off(run.P.values[-1], v))
        worst = max(worst, error / steps)
    return worst


def _short(value: float) -> float:
    return float(f"{value:.2g}")


def main() -> None:
    options = parser(__doc__, "exact_limits").parse_args()
    write({"machine": machine(), "beside": beside(), "pairs": pairs(), "cost": cost()}, options.output)


if __name__ == "__main__":
    main()
