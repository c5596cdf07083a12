"""Is Hyperion's rotation chaotic?  MEGNO and Lyapunov's times of the whole motion, from slow states and as observed.

    python benchmarks/hyperion.py

Writes results/hyperion.json.  A rigid ellipsoid on a fixed Kepler orbit, e = 0.1, in the field of a point mass: three
degrees of freedom, nothing averaged, no tides.  Two ensembles of initial states, and three bodies:

    slow        0.6 to 1.6 times the mean motion about the shortest axis, tilted by 0.5 rad, to which tides lead
                [Wisdom, Peale, Mignard 1984]
    observed    4.2 to 4.5 times the mean motion about an axis 30 degrees off the longest, as Voyager 2 and Cassini saw
                it [Harbison, Thomas, Nicholson 2011], in all directions of space
    triaxial    half axes 190, 145, 114 km [Wisdom 1984] or 180.1, 133.0, 102.7 km [Thomas 2010]
    symmetric   the first with the mean of its larger moments for both, as in the theory of Goldberg and Batygin (2024)

MEGNO is 2 for a quasi-periodic motion and grows like t for a chaotic one; a motion counts as regular if it is below 3
at the end.  Lyapunov's times are quartiles of the others.  With twice the steps an orbit they change by less than 1 %.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from cases import machine, parser, write

import kreisel as kr
from kreisel.analysis.frequencies import megno
from kreisel.physical import Asteroid, FreeBody

ORBITS, STEPS, LANES = 500, 96, 64
SHAPES = {"Wisdom 1984": (3.80e5, 2.90e5, 2.28e5), "Thomas 2010": (3.602e5, 2.660e5, 2.054e5)}


def bodies() -> dict[str, Asteroid]:
    orbit, mass = Asteroid.hyperion().orbit, 5.62e18
    found = {f"triaxial, {name}": Asteroid.ellipsoid(mass, axes, orbit) for name, axes in SHAPES.items()}
    A, B, C = FreeBody.ellipsoid(mass, SHAPES["Wisdom 1984"]).principal.moments
    found["symmetric"] = Asteroid((A, (B + C) / 2, (B + C) / 2), orbit)
    return found


def directions(count: int, draw: np.random.Generator) -> Any:
    g = draw.normal(size=(count, 4))
    return g / np.linalg.norm(g, axis=-1, keepdims=True)


def starts(name: str, n: float, draw: np.random.Generator) -> tuple[Any, Any]:
    """Angular velocities in the body and orientations."""
    if name == "slow":
        rate = np.linspace(0.6, 1.6, LANES) * n
        g = np.tile((np.cos(0.25), np.sin(0.25), 0.0, 0.0), (LANES, 1))
        return rate[:, None] * np.array((0.0, 0.0, 1.0)), g
    rate, turn = draw.uniform(4.2, 4.5, LANES) * n, draw.uniform(0, 2 * np.pi, LANES)
    off = np.radians(30)
    axis = np.stack([np.full(LANES, np.cos(off)), np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn)], -1)
    return rate[:, None] * axis, directions(LANES, draw)


def measured(body: Asteroid, name: str, orbits: int) -> dict[str, Any]:
    period = body.orbit.period
    spin, g = starts(name, body.orbit.mean_motion, np.random.default_rng(7))
    found = megno(
        body.model(), body.state(spin), dt=period / STEPS, steps=orbits * STEPS, every=STEPS // 8, orientation=g
    )
    last = found.isel(time=-1)
    value, exponent = last.megno.values, last.lyapunov.values * period
    chaotic = value >= 3
    times = 1 / exponent[chaotic]
    out: dict[str, Any] = {"regular": int((~chaotic).sum()), "of": LANES}
    if chaotic.any():
        quartiles = np.percentile(times, (25, 50, 75))
        out["lyapunov_orbits"] = [float(f"{v:.3g}") for v in quartiles]
        out["lyapunov_days"] = [float(f"{v * period / 86400:.3g}") for v in quartiles]
    return out


def main(arguments: list[str] | None = None) -> None:
    reader = parser(__doc__, "hyperion")
    reader.add_argument("--orbits", type=int, default=ORBITS)
    asked = reader.parse_args(arguments)
    found = {}
    for title, body in bodies().items():
        for name in ("slow", "observed"):
            found[f"{title}: {name}"] = measured(body, name, asked.orbits)
            print(f"{title}: {name}", found[f"{title}: {name}"], flush=True)
    write({"machine": machine(), "orbits": asked.orbits, "kreisel": kr.__version__, "rows": found}, asked.output)


if __name__ == "__main__":
    main()
