"""method="baecklund": round-off over 1e6 steps for n = 3 ... 6, and time of a step for n = 3.

Worst change of an integral in bands of `kr.drift`, over four initial states and dt = 0.05, 0.33, 1, and the root
mean square of z (see roundoff.py) of the first Casimir and the energy: about 1 for a random walk.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from cases import Case, cases, unit
from roundoff import SAVED, STEPS_OF_TIME, runs_of

import kreisel as kr
from kreisel.runs.plan import make_plan

ORDERS = (2, 4, 8)
TIMED = (2, 4, 8, 12, 16)
TRENDS = ("casimir[0]", "energy")


def bodies(n: int) -> list[Case]:
    """The systems of `cases`, n = 3, or random states of the same systems."""
    if n == 3:
        return [case for case in cases(3) if case.name != "symmetric-top"]
    axis, b = np.eye(n)[-1], np.array([0.3, 0.7, 1.9, 1.1, -0.4, 0.2])[:n]
    models = [kr.LagrangeTop(p=axis), kr.LagrangeTopMoving(A=axis, alpha=0.7), kr.Clebsch(b=b)]
    return [Case(model.system.name, model, _states(model, n)) for model in models]


def _states(model: Any, n: int) -> dict[str, dict[str, Any]]:
    skew, vector = model.system.space.letters
    out = {}
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        X = rng.standard_normal((n, n))
        out[f"seed {seed}"] = {skew: X - X.T, vector: unit(rng.standard_normal(n))}
    return out


def stillness(n: int, steps: int) -> None:
    """A line for each system and order."""
    for case in bodies(n):
        for order in ORDERS:
            worst, where, z = 0.0, "", {name: [] for name in TRENDS}
            for label, state in case.states.items():
                for dt in STEPS_OF_TIME:
                    try:
                        (rows,) = runs_of(case, {label: state}, dt, steps, method="baecklund", order=order)
                    except kr.InputError:
                        continue  # beyond the domain of the real map
                    name = max(rows, key=lambda name: rows[name]["ulps"])
                    if rows[name]["ulps"] > worst:
                        worst, where = rows[name]["ulps"], f"{name}, {label}, dt = {dt:g}"
                    for trend in TRENDS:
                        z[trend].append(rows[trend]["z"])
            told = ", ".join(f"{np.sqrt(np.mean(np.square(v))):.2f}" for v in z.values())
            print(f"{case.name:<21}n = {n}  order {order}  {worst:6.2f} bands ({where}); rms z {told}", flush=True)


def speed(steps: int = 200_000, turns: int = 7) -> None:
    """Nanoseconds a step, the least of some turns."""
    for case in cases(3, generic=True):
        if case.name == "symmetric-top":
            continue
        state, told = next(iter(case.states.values())), []
        for order in TIMED:
            plan = make_plan(
                case.model,
                case.model.state(**state),
                dt=0.05,
                steps=1,
                every=1,
                method="baecklund",
                order=order,
                orientation=None,
            )
            out, best = np.empty((1, *plan.engine.z.shape)), np.inf
            for _ in range(turns):
                begun = time.perf_counter()
                plan.engine.advance(out, steps)
                best = min(best, time.perf_counter() - begun)
            told.append(f"{order}: {best / steps * 1e9:.0f}")
        print(f"{case.name:<21}ns a step by order  {'  '.join(told)}", flush=True)


def main() -> None:
    """Speed, then stillness."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=10**6)
    options = parser.parse_args()
    speed()
    for n in (3, 4, 5, 6):
        stillness(n, max(options.steps, SAVED))


if __name__ == "__main__":
    main()
