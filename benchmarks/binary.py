"""Didymos and Dimorphos: a thousand years with the Sun and tides, and a map of Dimorphos's shapes after the impact.

    python benchmarks/binary.py

Writes results/binary.json.  Times are of the processor: of one core for the thousand years, of all threads for the map.

    millennium   both spins, the Sun, tides of both bodies, order (8, 6, 4), dt = 1 h; and the same without the Sun,
                 where the energy less the work of the tides shows a trend of rounding errors; with the Sun the energy
                 is that of its orbit
    map          a/b and b/c of Dimorphos from 1 to 1.5, a circular orbit from which the impact took 2.7 mm/s along the
                 track [Cheng et al. 2023], its axis tilted by 1 degree; order (4, 2), 8 steps an orbit.  A part of the
                 hundred years is run, the time for all of them is in proportion.  The largest roll, pitch and yaw for
                 each a/b, medians over b/c, and the share of shapes that tumble: roll or yaw go beyond 90 degrees
    century      the same for 100 years with fewer starts, 12 steps an orbit: with 8 the energy of bodies that tumble
                 grows in some decades, and a closed form becomes too short for its step
"""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
from cases import machine, parser, write

import kreisel as kr
from kreisel.physical import Binary, Ensemble
from kreisel.runs.in_si import in_state_form

YEAR, LOSS = 365.25 * 86_400.0, 2.7e-3  # s, m/s
TIDES = {"love": 1e-5, "lag": 100.0}
TILT = (np.cos(np.pi / 360), 0.8 * np.sin(np.pi / 360), 0.6 * np.sin(np.pi / 360), 0.0)
LANES, ORBITS = 500, 740  # of a part of the map, in a year


def millennium(years: float, sun: bool) -> dict[str, Any]:
    pair = Binary.didymos(sun=sun, **TIDES)
    start = pair.state()
    kr.simulate(pair, start, dt="1 h", steps=24)  # compiles
    begun, steps = time.process_time(), round(years * YEAR / 3600)
    run = kr.simulate(pair, start, dt="1 h", steps=steps, every=max(steps // 2000, 1))
    seconds = time.process_time() - begun
    J, balance = run.angular_momentum.values, run.balance.values
    out = {
        "years": years,
        "seconds": round(seconds, 1),
        "microseconds_a_step": round(1e6 * seconds / steps, 2),
        "angular_momentum": float(f"{abs(J - J[0]).max() / np.linalg.norm(J[0]):.2g}"),
    }
    if sun:
        return out
    share = balance / np.abs(pair_energy(pair))
    means = [v.mean() - share[0] for v in np.array_split(share, 4)]
    return out | {
        "energy_by_quarters": [float(f"{v:.2g}") for v in means],  # relative to the mutual orbit
        "energy_spread": float(f"{np.ptp(share):.2g}"),
    }


def pair_energy(pair: Binary) -> float:
    """Of the mutual orbit, J."""
    m1, m2 = pair.primary.mass, pair.secondary.mass
    return pair.mu * m1 * m2 / (m1 + m2) / (2 * 1206.0)


def after_impact(ab: float, bc: float, mean: float = 150.0) -> tuple[Binary, Any]:
    """Dimorphos with these ratios of its axes and this mean diameter, m, after the impact."""
    b = mean * (bc / ab) ** (1 / 3)
    pair = Binary.didymos(diameters=(ab * b, b, b / bc))
    x = pair.state()
    speed = float(np.linalg.norm(x.v))
    rate = (0.0, 0.0, speed / float(np.linalg.norm(x.r)))
    return pair, pair.state(x.r, x.v * (1 - LOSS / speed), spin2=rate, attitude2=TILT)


def mapped(side: int, years: int, steps: int, every: int) -> dict[str, Any]:
    ratios = np.linspace(1.005, 1.5, side)
    grid = [(ab, bc) for ab in ratios for bc in ratios]
    built = stepped = 0.0
    angles = []
    for first in range(0, len(grid), LANES):
        begun = time.process_time()
        pairs, states = zip(*(after_impact(*ratio) for ratio in grid[first : first + LANES]), strict=True)
        many = Ensemble(pairs)
        start = many.model().state(**{k: np.stack([x[k] for x in states]) for k in states[0]})
        middle, largest = time.process_time(), np.zeros((3, len(pairs)))
        for _ in range(years):  # all rows of a century do not fit into memory
            count = {"dt": 11.84 * 3600 / steps, "steps": steps * ORBITS // every * every, "every": every}
            run = kr.simulate(many, start, **count, order=(4, 2), observe=())
            largest = np.maximum(largest, np.max(np.abs(pairs[0].angles(run)), axis=1))
            rows = in_state_form(run)
            start = many.model().state(**{k: rows[k].values[-1] for k in states[0]})
        angles.append(largest)
        built, stepped = built + middle - begun, stepped + time.process_time() - middle
    found = np.degrees(np.concatenate(angles, axis=1)).reshape(3, side, side)  # roll, pitch, yaw
    tumbling = (found[0] > 90) | (found[2] > 90)
    return {
        "starts": len(grid),
        "years": years,
        "steps_an_orbit": steps,
        "seconds_to_build": round(built, 1),
        "seconds_of_steps": round(stepped, 1),
        "minutes_on_two_cores_for_100_years": round((built + stepped * 100 / years) / 2 / 60, 1),
        "minutes_for_10000_starts": round((built + stepped * 100 / years) * 10_000 / len(grid) / 2 / 60, 1),
        "tumbling": float(f"{tumbling.mean():.3g}"),
        "by_a_over_b": {
            f"{r:.3f}": [float(f"{v:.3g}") for v in np.median(found[:, i], axis=-1)] for i, r in enumerate(ratios)
        },
    }


def main(arguments: list[str] | None = None) -> None:
    reader = parser(__doc__, "binary")
    reader.add_argument("--years", type=float, default=1000.0, help="of the millennium; 0 to keep its results")
    reader.add_argument("--side", type=int, default=100, help="of the map")
    reader.add_argument("--part", type=int, default=1, help="years of the map that are run")
    reader.add_argument("--century", type=int, default=0, help="side of a map that is run for a hundred years")
    asked = reader.parse_args(arguments)
    found: dict[str, Any] = json.loads(asked.output.read_text()) if asked.output.exists() else {}
    found |= {"machine": machine(), "kreisel": kr.__version__}
    for name, sun in (("with_sun_and_tides", True), ("with_tides", False)) if asked.years else ():
        found[name] = millennium(asked.years, sun)
        print(name, found[name], flush=True)
    for name, side, years in (("map", asked.side, asked.part), ("century", asked.century, 100)):
        if side:
            found[name] = mapped(side, years, *((8, 5) if name == "map" else (12, 7)))
            print(name, {k: v for k, v in found[name].items() if k != "by_a_over_b"}, flush=True)
    write(found, asked.output)


if __name__ == "__main__":
    main()
