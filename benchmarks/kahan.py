"""Kahan's map: nanoseconds a step by a public call, and of the other maps of the same system.

One trajectory, n = 3, order 2, `kr.propagator(...).steps`; the best of five calls, alternating methods.
"""

from __future__ import annotations

import json
import time
from typing import Any

from cases import RESULTS

import kreisel as kr
from kreisel.method import METHODS

STEPS, CALLS, DT = 500_000, 5, 0.01
M, P = (0.3, 0.5, 1.1), (0.6, 0.0, 0.8)
BODIES: dict[str, tuple[Any, dict[str, Any]]] = {
    "euler-top": (kr.EulerTop(J=(1.0, 2.0, 3.5)), {"M": M}),
    "zhukovsky-volterra": (kr.ZhukovskyVolterra(J=(1.0, 2.0, 3.5), h=(0.1, 0.2, 0.3)), {"M": M}),
    "lagrange-top": (kr.LagrangeTop(p=(0, 0, 1)), {"m": M, "a": P}),
    "heavy-top": (kr.HeavyTop(J=(1.0, 1.3, 0.6), A=(0.3, 0.2, 0.9)), {"M": M, "P": P}),
    "kovalevskaya-top": (kr.KovalevskayaTop(n=3), {"M": M, "P": P, "Q": (0.0, 1.0, 0.0)}),
    "kovalevskaya-top-e3": (kr.KovalevskayaTopE3(), {"M": M, "P": P}),
    "kovalevskaya-top-so3": (kr.KovalevskayaTopSO3(), {"M": M, "P": P, "Q": (0.0, 1.0, 0.0)}),
    "clebsch": (kr.Clebsch(b=(0.2, 0.5, 1.1)), {"M": M, "P": P}),
    "kirchhoff-case": (kr.KirchhoffCase(a1=1.0, a3=1.4, b1=0.2, b3=0.5, c1=0.3, c3=0.9), {"M": M, "P": P}),
}
COMPARED = ("kahan", "suris", "variational")


def measured() -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = {}
    for name, (model, start) in BODIES.items():
        motions = {m: kr.propagator(model, method=m, order=2, dt=DT) for m in COMPARED if METHODS[m].applies(model)}
        state = model.state(**start)
        best = dict.fromkeys(motions, float("inf"))
        for motion in motions.values():
            motion.steps(state, STEPS)
        for _ in range(CALLS):
            for method, motion in motions.items():
                begin = time.perf_counter()
                motion.steps(state, STEPS)
                best[method] = min(best[method], (time.perf_counter() - begin) / STEPS * 1e9)
        out[name] = {method: round(ns, 1) for method, ns in best.items()}
        print(name, out[name])
    return out


if __name__ == "__main__":
    (RESULTS / "kahan.json").write_text(json.dumps({"ns_a_step": measured()}, indent=1) + "\n")
