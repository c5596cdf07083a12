"""What satellites cost: a year on one core, and 1,000 CubeSats in a sweep on two.

    python benchmarks/satellites.py

Writes results/satellites.json.  Year: seconds of `kr.simulate` on one core for a CubeSat of three units at 500 km with
a magnetic moment and sunlight on its six sides, as CPU time, which other work beside hardly changes, the least of three
calls; and how far the libration of such a satellite under gravity alone is off in a day, in degrees, against steps of a
quarter with order (8, 6, 4).  Sweep: 1,000 of them at inclinations of their own for 60 days; the part of its processor
time that is the kernel's, by that of `kr.propagator` on one core for as many lanes and steps; and the kernel's part of
two cores while it lasts, which says something about Kreisel where `load_average_before` is below 0.5.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
from cases import machine, parser, write

import kreisel as kr
from kreisel.algebra import axial
from kreisel.bodies import BODIES
from kreisel.physical import SOLAR_PRESSURE, Orbit, Satellite

YEAR, DAY, STEP, EVERY = 365.25 * 86_400.0, 86_400.0, 60.0, 240
SWEEPS = 2
LANES, DAYS, CORES, REPETITIONS = 1_000, 60, 2, 3
ORDERS: tuple[tuple[Any, float], ...] = (((2, 2), 30.0), ((8, 6, 4), 60.0), ((8, 6, 4), 120.0))
ORBIT = Orbit.circular("500 km", "97 deg")
PLAIN = Satellite.cubesat(ORBIT, units=3)
CUBESAT = Satellite.cubesat(
    ORBIT, units=3, center_of_mass=(0, 0.01, 0), magnetic_moment=(0, 0, 2e-4), light=SOLAR_PRESSURE
)
ATTITUDE = CUBESAT.orientation(CUBESAT.pointing(pitch="10 deg"))


def run(order: Any, dt: float, end: float, every: int, body: Satellite = CUBESAT) -> Any:
    model, state = body.model(), body.state()
    steps = round(end / dt)
    return kr.simulate(model, state, dt=dt, steps=steps, every=every, order=order, orientation=ATTITUDE, progress=False)


def year() -> list[dict[str, Any]]:
    rows = []
    for order, dt in ORDERS:
        run(order, dt, DAY, 10)
        took = []
        for _ in range(REPETITIONS):
            begun = time.process_time()
            run(order, dt, YEAR, 100)
            took.append(time.process_time() - begun)
        coarse = run(order, dt, DAY, round(3600 / dt), PLAIN)
        fine = run((8, 6, 4), dt / 4, DAY, round(4 * 3600 / dt), PLAIN)
        off = abs(PLAIN.angles(coarse).pitch - PLAIN.angles(fine).pitch).max()
        rows.append(
            {"order": str(order), "dt": dt, "cpu_s": round(min(took), 3), "off_degrees": short(np.degrees(off))}
        )
        print(rows[-1], flush=True)
    return rows


def sweep() -> dict[str, Any]:
    model, state = CUBESAT.model(), CUBESAT.state()
    inclinations, steps = np.linspace(0.1, 1.7, LANES), round(DAYS * DAY / STEP)
    lanes = BODIES[model.system.name](**{**model.params, "inclination": inclinations})
    p = kr.propagator(lanes, dt=STEP, orientation=True)
    x = np.tile(np.concatenate([axial(state["M"]), ATTITUDE]), (LANES, 1))
    kernel = []
    for _ in range(REPETITIONS):
        begun = time.process_time()
        p.steps(x, EVERY, time=0.0)
        kernel.append((time.process_time() - begun) / EVERY / LANES)
    took, busy = [], []
    design = kr.Design(grid={"system.inclination": inclinations})
    options: dict[str, Any] = {"steps": steps, "every": EVERY, "save": ("extremes",), "orientation": ATTITUDE}
    for _ in range(SWEEPS):
        with tempfile.TemporaryDirectory() as folder:
            path, before, begun = Path(folder) / "sweep.zarr", processor(), time.perf_counter()
            kr.sweep(model, state, design, dt=STEP, path=path, workers=CORES, progress=False, **options)
            took.append(time.perf_counter() - begun)
            busy.append(processor() - before)
        print(took[-1], busy[-1], flush=True)
    all_, wall = LANES * steps * min(kernel), min(took)
    return {
        "lanes": LANES,
        "steps": steps,
        "kernel_us": short(1e6 * min(kernel)),
        "wall_s": short(wall),
        "cpu_s": short(min(busy)),
        "kernel_of_cpu": short(all_ / min(busy)),
        "of_two_cores": short(all_ / (CORES * wall)),
    }


def processor() -> float:
    """Seconds of this process and of its children that have ended."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def short(x: Any) -> float:
    return float(f"{float(x):.3g}")


def main(arguments: list[str] | None = None) -> None:
    asked = parser(__doc__, "satellites").parse_args(arguments)
    load = os.getloadavg()[0]
    write({"machine": machine(), "load_average_before": round(load, 2), "year": year(), "sweep": sweep()}, asked.output)


if __name__ == "__main__":
    main()
