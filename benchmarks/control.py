"""Cost of controllers: B-dot at 1 Hz in an ensemble, and a control step in a user's loop.

    python benchmarks/control.py [--lanes 256]

Writes results/control.json.  Times are CPU times of one core, the least of several.  Ensemble:
seconds for a day of 10,000 CubeSats of three units at 500 km, extrapolated from 2000 s of some of them.  Errors: of an
entry of the attitude in two hours of detumbling.  Call: microseconds of a step of a second by a propagator.
"""

from __future__ import annotations

import os
import time
from typing import Any

os.environ.setdefault("KREISEL_NUM_THREADS", "1")

import numpy as np
from cases import machine, parser, write

import kreisel as kr
from kreisel.physical import Orbit, Satellite, bdot

SECONDS, DAY, SATELLITES, REPETITIONS = 2000, 86_400, 10_000, 3
ORDERS = ((2, 2), (4, 2), 4, (8, 6, 4))  # the last one is the default


def detumbling(dated: bool = True, noise: bool = False) -> Satellite:
    orbit = Orbit.circular("500 km", inclination="97.4 deg", epoch="2026-03-20T14:46:00" if dated else None)
    return Satellite.cubesat(
        orbit, 3, control=bdot(3e-5, limits={"dipole": 0.2}, noise={"field": 1e-7} if noise else {})
    )


def ensemble(lanes: int, order: Any, body: Satellite) -> float:
    start = body.state(spin=np.random.default_rng(0).normal(size=(lanes, 3)) * 0.1)
    settings = {"dt": "1 s", "order": order, "observe": (), "progress": False}
    kr.simulate(body, start, steps=10, every=10, **settings)  # compiles
    took = []
    for _ in range(REPETITIONS):
        begun = time.process_time()
        kr.simulate(body, start, steps=SECONDS, every=SECONDS, **settings)
        took.append(time.process_time() - begun)
    return min(took) * DAY * SATELLITES / (SECONDS * lanes)


def ensembles(lanes: int) -> list[dict[str, Any]]:
    rows = []
    for order in ORDERS:
        for dated in (False, True):
            for noise in (False, True):
                seconds = ensemble(lanes, order, detumbling(dated, noise))
                rows.append({"order": str(order), "field": "IGRF-14" if dated else "dipole", "noise": noise})
                rows[-1]["cpu_s"] = round(seconds)
                print(rows[-1], flush=True)
    return rows


def errors() -> dict[str, float]:
    """By order, at dt = 1 s."""
    body = detumbling()
    settings = {"t_end": "2 h", "every": "10 min", "observe": (), "progress": False}

    def attitude(order: Any, dt: str) -> np.ndarray:
        start = body.state(spin=("6 deg/s", "6 deg/s", "-5.3 deg/s"))
        return kr.simulate(body, start, dt=dt, order=order, **settings).attitude.values

    truth = attitude((8, 6, 4), "0.5 s")
    return {str(order): float(f"{abs(attitude(order, '1 s') - truth).max():.1e}") for order in ORDERS}


def call(parameters: dict[str, tuple[float, float, float]]) -> float:
    """From a state as one array."""
    body = Satellite.cubesat(Orbit.circular("500 km", inclination="97.4 deg"), 3)
    step = kr.propagator(body, dt="1 s")
    found = step.to(body.state(), 1.0)
    state = np.concatenate([found[name] for name in step.names])
    best = np.inf
    for _ in range(100):
        begun = time.process_time()
        for second in range(100):
            step.to(state, second + 1.0, time=float(second), **parameters)
        best = min(best, (time.process_time() - begun) / 100)
    return round(1e6 * best, 1)


def main() -> None:
    options = parser(__doc__, "control")
    options.add_argument("--lanes", type=int, default=256)
    asked = options.parse_args()
    result = {"machine": machine(), "ensemble": ensembles(asked.lanes), "errors": errors()}
    write(result | {"call_us": call({}), "call_with_dipole_us": call({"dipole": (0.1, 0.0, 0.0)})}, asked.output)


if __name__ == "__main__":
    main()
