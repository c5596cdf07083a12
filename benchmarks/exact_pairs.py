"""The exact flow by pairs of Bäcklund maps, and of Goryachev-Chaplygin's top by one: errors, integrals, time.

error     of the state at T = 50, relative to its largest coordinate, in 160 steps, against Taylor series in 24 digits
ulps      the largest change of an integral at 20 rows of 10^6 steps of 1/4
a step    of the error between steps of 1/4 and 5/16 after that time, relative
set_up    processor time of the points of a trajectory, in ms
ns, lane  processor time of a step of a single trajectory, and of one of 64: the least of several runs
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine, parser, write

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import kreisel as kr
from kreisel import algebra
from kreisel.runs.planning import make_plan
from taylor import flow_of

LONG, TURNS, LANES = 1_000_000, 9, 64
M, P = (0.3, 0.5, 1.1), (0.6, 0.0, 0.8)
F = ((1.0, 0.3, -0.2), (0.3, -0.5, 0.4), (-0.2, 0.4, 0.9))
FOUR = ((0, 0.3, -0.5, 0.7), (-0.3, 0, 1.1, 0.2), (0.5, -1.1, 0, -0.4), (-0.7, -0.2, 0.4, 0))
CASES = (
    (kr.ClebschGeneral(a=(1, 2, -0.7), b=(1, 4, 0.49)), {"M": M, "P": P}),
    (kr.ManakovTop(a=(1, 2.5, 5, 8), b=(1.4, 1.9, 2.4, 3)), {"M": FOUR}),
    (kr.QuadraticPotential(J=(1, 1.6, 2.3)), {"M": M, "P": F}),
    (kr.KovalevskayaTopE3(), {"M": M, "P": P}),
    (kr.KovalevskayaGyrostat(n=3, gamma=0.7), {"M": M, "P": P, "Q": (0.2, 0.7, -0.3)}),
    (kr.Komarov(kappa=-0.4, beta=0.6, gamma=0.3), {"M": M, "P": P}),
    (kr.Rubanovskii(b=(0.3, 0.7, 1.9), s=0.4, l=0.7, h=(0.4, -0.3, 0.5)), {"M": M, "P": P}),
    (kr.SteklovLyapunov(b=(0.3, 0.7, 1.9), s=0.4, l=0.7), {"M": M, "P": P}),
    (kr.GoryachevChaplygin(gamma=0.3), {"M": (0.8, 0.5, -0.6), "P": P}),
)


def end(model: Any, run: Any) -> np.ndarray:
    """The coordinates of the last row."""
    kinds = model.system.space.components
    parts = [algebra.KINDS[kind].from_user(run[k].values[-1], model.n) for k, kind in kinds]
    return algebra.flatten(parts, [kind for _, kind in kinds])


def measured(model: Any, state: dict[str, Any]) -> dict[str, Any]:
    z = model.state(**state)
    options = {"method": "exact", "progress": False}
    run = kr.simulate(model, state, dt=0.3125, steps=160, every=160, **options)
    want = flow_of(model, tuple(z[k] for k in model.system.space.letters), 50.0)
    error = max(abs(float(x - y)) for x, y in zip(want, end(model, run), strict=True)) / max(map(abs, map(float, want)))
    runs = [
        kr.simulate(model, state, dt=dt, steps=n, every=n // 20, **options)
        for dt, n in ((0.25, LONG), (0.3125, LONG * 4 // 5))
    ]
    ends = [end(model, run) for run in runs]
    several = {k: np.stack([np.asarray(z[k])] * LANES) for k in z}
    begun = time.process_time()
    plan = make_plan(model, several, dt=0.1, steps=1, every=1, method="exact", order=None, orientation=None)
    set_up = (time.process_time() - begun) / LANES * 1e3
    return {
        "system": model.system.name,
        "pairs": plan.scheme.stage_count,
        "error": short(error),
        "ulps": short(float(kr.drift(runs[0]).ulps.max())),
        "a step": short(float(abs(ends[0] - ends[1]).max() / abs(ends[0]).max()) / LONG),
        "set_up": short(set_up),
        "ns": timed(model, state),
        "lane": round(timed(model, several) / LANES, 1),
    }


def timed(model: Any, state: dict[str, Any]) -> float:
    """Nanoseconds of a step of all lanes."""
    plan = make_plan(model, state, dt=0.1, steps=1, every=1, method="exact", order=None, orientation=None)
    engine, steps, best = plan.engine, 20_000, np.inf
    out = np.empty((1, *engine.z.shape))
    for _ in range(TURNS):
        begun = time.process_time()
        engine.advance(out, steps)
        best = min(best, time.process_time() - begun)
    return round(best / steps * 1e9)


def short(value: float) -> float:
    return float(f"{value:.2g}")


def main() -> None:
    options = parser(__doc__, "exact_pairs").parse_args()
    rows = []
    for model, state in CASES:
        rows.append(measured(model, state))
        print(rows[-1], flush=True)
    write({"machine": machine(), "rows": rows}, options.output)


if __name__ == "__main__":
    main()
