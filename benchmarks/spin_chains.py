"""Chains of spins: microseconds a step by a public call, and seconds until the first one with nothing in the caches.

One trajectory, random spins, dt = 0.1, `kr.propagator(...).steps`; the best of five calls.  Processor time: the machine
may be shared.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time

import numpy as np
from cases import RESULTS

CALLS, DT = 5, 0.1
SITES = (8, 32, 128, 512)


def spins(n: int, letters: str) -> dict[str, np.ndarray]:
    found = np.random.default_rng(0).normal(size=(len(letters), 3, n))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return {f"{s}{a}": v for s, spin in zip(letters, found, strict=True) for a, v in zip("xyz", spin, strict=True)}


def one(method: str, sites: int) -> dict[str, float]:
    """The result of a function in a separate process."""
    import kreisel as kr

    first = kr.EulerTop(J=(1.0, 2.0, 3.5))  # what any first run loads
    kr.propagator(first, method="kahan", dt=DT).steps({"M": (0.3, 0.5, 1.1)}, 10)
    lattice = method == "brickwork"
    model = kr.LatticeLandauLifshitz(n=sites // 2, D=0.5) if lattice else kr.HeisenbergChain(n=sites)
    state = spins(sites // 2, "ST") if lattice else spins(sites, "S")
    begin = time.process_time()
    motion = kr.propagator(model, method=method, dt=DT, project=False)
    motion.steps(state, 1)
    seconds, steps, best = time.process_time() - begin, 200_000 // sites, float("inf")
    for _ in range(CALLS):
        begin = time.process_time()
        motion.steps(state, steps)
        best = min(best, (time.process_time() - begin) / steps)
    return {"first_s": round(seconds, 1), "us_a_step": round(best * 1e6, 2), "ns_a_site": round(best / sites * 1e9, 1)}


def measured() -> dict[str, dict[str, dict[str, float]]]:
    out: dict[str, dict[str, dict[str, float]]] = {}
    for method in ("midpoint", "brickwork"):
        out[method] = {}
        for sites in SITES:
            with tempfile.TemporaryDirectory() as folder:
                made = subprocess.run(
                    [sys.executable, __file__, method, str(sites)],
                    env={**os.environ, "KREISEL_CACHE": folder},
                    capture_output=True,
                    text=True,
                    check=True,
                )
            out[method][str(sites)] = json.loads(made.stdout.splitlines()[-1])
            print(method, sites, out[method][str(sites)])
    return out


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print(json.dumps(one(sys.argv[1], int(sys.argv[2]))))
    else:
        (RESULTS / "spin_chains.json").write_text(json.dumps(measured(), indent=1) + "\n")
