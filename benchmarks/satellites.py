"""Cost of satellites: a year on one core, and 1,000 CubeSats in a sweep.

    python benchmarks/satellites.py

Writes results/satellites.json. Year: seconds of `kr.simulate` on one core for a CubeSat of three units at 500 km with a
magnetic moment and sunlight on its six sides, as CPU time, which other work hardly changes, the least of three
calls; and how far the libration of such a satellite under gravity only is off in a day, in degrees, against steps of a
quarter with order (8, 6, 4). Environment: nanoseconds of CPU time of a step of 30 s of order (2, 2) with the models of
a date, of a single CubeSat on a circular orbit and of each of 256, and the seconds of a single one for ten years. Ten
years: seconds of `kr.simulate` of all models. Sweep: 1,000 of them at different inclinations. The part of its time
that is the kernel's, by that of `kr.propagator` on one core for as many lanes and steps: of the CPU time of a sweep of
16 days in one process, and of two cores during one of 120 days on two workers, by the clock. The latter is meaningful
on an idle machine only, and is left out (null) where the load average was above 0.5 before.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("KREISEL_NUM_THREADS", "1")

import numpy as np
from cases import machine, parser, write

import kreisel as kr
from kreisel.algebra import axial
from kreisel.bodies import BODIES
from kreisel.physical import SOLAR_PRESSURE, Orbit, Satellite

YEAR, DAY, STEP, EVERY = 365.25 * 86_400.0, 86_400.0, 60.0, 240
IDLE = 0.5
INCLINATIONS, CORES, REPETITIONS = np.linspace(0.1, 1.7, 1_000), 2, 3
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


def sweep(idle: bool) -> dict[str, Any]:
    model, state = CUBESAT.model(), CUBESAT.state()
    lanes = BODIES[model.system.name](**{**model.params, "inclination": INCLINATIONS})
    p = kr.propagator(lanes, dt=STEP, orientation=True)
    x = np.tile(np.concatenate([axial(state["M"]), ATTITUDE]), (len(INCLINATIONS), 1))
    kernel = min(clocked(time.process_time, lambda: p.steps(x, EVERY, time=0.0)) for _ in range(REPETITIONS))
    kernel /= EVERY * len(INCLINATIONS)
    clocked(time.process_time, lambda: swept(1, 0))
    alone = min(clocked(time.process_time, lambda: swept(16, 0)) for _ in range(REPETITIONS))
    found = {
        "lanes": len(INCLINATIONS),
        "kernel_us": short(1e6 * kernel),
        "of_one_core": short(kernel * lane_steps(16) / alone),
    }
    if not idle:
        return found | {"of_two_cores": None}
    both = min(clocked(time.perf_counter, lambda: swept(120, CORES)) for _ in range(REPETITIONS))
    return found | {"of_two_cores": short(kernel * lane_steps(120) / (CORES * both))}


def environment() -> list[dict[str, Any]]:
    orbit = Orbit.circular("500 km", "51.6 deg", epoch="2026-03-20T14:46:00")
    plain = {"magnetic_field": "dipole", "plates": ()}
    cases: dict[str, dict[str, Any]] = {
        "dipole": plain,
        "IGRF-14": {**plain, "magnetic_field": "igrf"},
        "dipole, Sun and eclipse": {"magnetic_field": "dipole", "light": SOLAR_PRESSURE},
        "dipole, Harris-Priester air": {"magnetic_field": "dipole", "air": "harris-priester"},
        "all": {"light": SOLAR_PRESSURE, "air": "harris-priester"},
    }
    rows = []
    for name, given in cases.items():
        body = Satellite.cubesat(orbit, magnetic_moment=(0.01, 0.02, 0.03), **given)
        alone, lanes = (short(1e9 * step_of(body, count)) for count in (1, 256))
        rows.append({"models": name, "ns": alone, "ns_of_256": lanes, "ten_years_s": short(alone * 10 * YEAR / 30e9)})
        print(rows[-1], flush=True)
    return rows


def ten_years() -> float:
    orbit = Orbit.circular("500 km", "51.6 deg", epoch="2019-12-31T00:00:00")
    body = Satellite.cubesat(orbit, magnetic_moment=(0.01, 0.02, 0.03), light=SOLAR_PRESSURE, air="harris-priester")
    start, steps = body.state(attitude=body.pointing(pitch="10 deg")), round(10 * YEAR / 30)

    def simulated(steps: int) -> None:
        kr.simulate(body, start, dt=30.0, steps=steps, every=steps // 100, order=(2, 2), observe=(), progress=False)

    simulated(1000)
    return short(min(clocked(time.process_time, lambda: simulated(steps)) for _ in range(2)))


def step_of(body: Satellite, lanes: int) -> float:
    """CPU time of a step of one lane: of long calls less that of short ones."""
    p = kr.propagator(body.model(), dt=30.0, order=(2, 2), orientation=True)
    x = np.tile(np.concatenate([axial(body.state()["M"]), body.orientation(body.pointing(pitch=0.1))]), (lanes, 1))
    x = x if lanes > 1 else x[0]
    short_one, long_one = 100_000 // lanes, 400_000 // lanes
    took = [
        min(clocked(time.process_time, lambda n=n: p.steps(x, n, time=0.0)) for _ in range(REPETITIONS + 2))
        for n in (short_one, long_one)
    ]
    return (took[1] - took[0]) / (long_one - short_one) / lanes


def clocked(clock: Callable[[], float], call: Callable[[], Any]) -> float:
    begun = clock()
    call()
    return clock() - begun


def lane_steps(days: int) -> int:
    return round(days * DAY / STEP) * len(INCLINATIONS)


def swept(days: int, workers: int) -> None:
    design = kr.Design(grid={"system.inclination": INCLINATIONS})
    with tempfile.TemporaryDirectory() as folder:
        kr.sweep(
            CUBESAT.model(),
            CUBESAT.state(),
            design,
            dt=STEP,
            steps=round(days * DAY / STEP),
            every=EVERY,
            orientation=ATTITUDE,
            path=Path(folder) / "sweep.zarr",
            save=("extremes",),
            workers=workers,
            progress=False,
        )


def short(x: Any) -> float:
    return float(f"{float(x):.3g}")


def main(arguments: list[str] | None = None) -> None:
    asked = parser(__doc__, "satellites").parse_args(arguments)
    load = os.getloadavg()[0]
    write(
        {
            "machine": machine(),
            "load_average_before": round(load, 2),
            "year": year(),
            "environment": environment(),
            "ten_years_s": ten_years(),
        }
        | {"sweep": sweep(load < IDLE)},
        asked.output,
    )


if __name__ == "__main__":
    main()
