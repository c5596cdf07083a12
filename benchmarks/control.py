"""Cost of controllers: B-dot at 1 Hz in an ensemble, and a control step in a loop of one's own.

    python benchmarks/control.py [--lanes 1000]

Times of the processor for the ensemble, which is the time of one core; the least of many calls for the loop.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import kreisel as kr
from kreisel.physical import Orbit, Satellite, bdot

SECONDS, DAY, SATELLITES = 2000, 86_400, 10_000


def ensemble(lanes: int, dated: bool, noise: bool) -> float:
    """Seconds of a core for a day of 10,000 satellites, from some lanes for some time."""
    orbit = Orbit.circular("500 km", inclination="97.4 deg", epoch="2026-03-20T14:46:00" if dated else None)
    control = bdot(3e-5, limits={"dipole": 0.2}, noise={"field": 1e-7} if noise else {})
    body = Satellite.cubesat(orbit, 3, control=control)
    start = body.state(spin=np.random.default_rng(0).normal(size=(lanes, 3)) * 0.1)
    settings = {"dt": "1 s", "order": (2, 2), "observe": (), "progress": False}
    kr.simulate(body, start, steps=10, every=10, **settings)  # compiles
    begun = time.process_time()
    kr.simulate(body, start, steps=SECONDS, every=SECONDS, **settings)
    return (time.process_time() - begun) * DAY * SATELLITES / (SECONDS * lanes)


def errors() -> dict[object, float]:
    """The largest error of an entry of the attitude in two hours of detumbling at dt = 1 s, by order."""
    orbit = Orbit.circular("500 km", inclination="97.4 deg", epoch="2026-03-20T14:46:00")
    body = Satellite.cubesat(orbit, 3, control=bdot(3e-5, limits={"dipole": 0.2}))
    settings = {"t_end": "2 h", "every": "10 min", "observe": (), "progress": False}

    def attitude(order: object, dt: str) -> np.ndarray:
        start = body.state(spin=("6 deg/s", "6 deg/s", "-5.3 deg/s"))
        return kr.simulate(body, start, dt=dt, order=order, **settings).attitude.values

    truth = attitude((8, 6, 4), "0.5 s")
    return {order: abs(attitude(order, "1 s") - truth).max() for order in ((2, 2), (4, 2), 4, (8, 6, 4))}


def call(parameters: dict[str, tuple[float, float, float]]) -> float:
    """Seconds of a control step of a propagator, from a state as one array."""
    body = Satellite.cubesat(Orbit.circular("500 km", inclination="97.4 deg"), 3)
    step = kr.propagator(body, dt="1 s")
    found = step.to(body.state(), 1.0)
    state = np.concatenate([found[name] for name in step.names])
    best = np.inf
    for _ in range(100):
        begun = time.perf_counter()
        for second in range(100):
            step.to(state, second + 1.0, time=float(second), **parameters)
        best = min(best, (time.perf_counter() - begun) / 100)
    return best


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lanes", type=int, default=1000)
    lanes = parser.parse_args().lanes
    for dated in (False, True):
        for noise in (False, True):
            found = ensemble(lanes, dated, noise)
            what = f"{'IGRF-14' if dated else 'dipole'}{', noise' * noise}"
            print(f"{what}: a day of 10,000 satellites {found:.0f} s of a core")
    print("errors of the attitude:", {order: f"{error:.0e}" for order, error in errors().items()})
    print(f"a step in a loop: {1e6 * call({}):.1f} us, with a dipole {1e6 * call({'dipole': (0.1, 0.0, 0.0)}):.1f} us")
