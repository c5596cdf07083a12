"""A day of satellites at default settings against textbook equations, by DOP853 in plain Python.

    python benchmarks/satellite_day.py [NAME ...]

The largest angle to the equations at 24 rows, rad, and the error that the run expects, into
benchmarks/results/satellite_day.json; a quarter of an hour.  The equations: those of
Euler in the body axes with a quaternion, Kepler's by Newton's method; Kreisel's are only inertia tensors and plates.
"""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

import numpy as np
from cases import RESULTS, machine
from scipy.integrate import DOP853

import kreisel as kr
from kreisel.physical import Orbit, Satellite

MU, RADIUS, FIELD = 3.986004418e14, 6378137.0, -29350e-9 * 6371200.0**3  # WGS 84, IGRF-14
DAY, LIGHT = 86_400.0, 4.54e-6
SUN = np.array([1, 2, -0.5]) / np.linalg.norm([1, 2, -0.5])
LOW, INCLINATION, NODE, PERIGEE = RADIUS + 500e3, np.radians(97.4), 0.3, 0.5
TENSOR = np.array([[0.03, 0.002, -0.001], [0.002, 0.028, 0.0015], [-0.001, 0.0015, 0.012]])
START = np.array([0.5, 0.5, -0.5, 0.5])
SLOW, FAST = np.radians([0.9, 1, 0.6]), np.radians([5, 6, 4])


def orbit(a: float = LOW, e: float = 0.0, anomaly: float = 0.0) -> Orbit:
    """An orbit with the angles above."""
    return Orbit(a, e, INCLINATION, NODE, PERIGEE, mean_anomaly=anomaly)


def cubesat(**cause: Any) -> Satellite:
    """Three units with their centre of mass outside the centre of the box."""
    return Satellite.cubesat(orbit(), 3, center_of_mass=(0.03, 0.01, -0.01), **cause)


CASES = {
    "gravity": (lambda: Satellite(TENSOR, orbit()), SLOW),
    "fast": (lambda: Satellite(TENSOR, orbit()), FAST),
    "eccentric": (lambda: Satellite(TENSOR, orbit(2.5e7, 0.7, 2.5)), SLOW),
    "dipole": (lambda: Satellite(TENSOR, orbit(e=0.02), magnetic_moment=(0.001, 0.002, -0.004)), SLOW),
    "light": (lambda: cubesat(light=LIGHT, sun=SUN), SLOW),
    "air": (lambda: cubesat(density=5e-13), SLOW),
}


def cross(a: Any, b: Any) -> tuple[float, float, float]:
    """The vector product, in Python's floats."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def times(A: Any, v: Any) -> list[float]:
    """A v."""
    return [row[0] * v[0] + row[1] * v[1] + row[2] * v[2] for row in A]


def place(t: float, o: Orbit) -> tuple[list[float], list[float]]:
    """Position and velocity on the ellipse."""
    (cn, sn), (cp, sp), (ci, si) = ((math.cos(x), math.sin(x)) for x in (NODE, PERIGEE, INCLINATION))
    a, e = o.semi_major_axis, o.eccentricity
    n, E = math.sqrt(MU / a**3), o.mean_anomaly + math.sqrt(MU / a**3) * t
    M = E
    for _ in range(50):
        E -= (E - e * math.sin(E) - M) / (1 - e * math.cos(E))
    c, s, b, f = math.cos(E), math.sin(E), a * math.sqrt(1 - e * e), n / (1 - e * math.cos(E))
    P = [cn * cp - sn * sp * ci, sn * cp + cn * sp * ci, sp * si]
    Q = [-cn * sp - sn * cp * ci, -sn * sp + cn * cp * ci, cp * si]
    r = [a * (c - e) * p + b * s * q for p, q in zip(P, Q, strict=True)]
    return r, [f * (b * c * q - a * s * p) for p, q in zip(P, Q, strict=True)]


def by_equations(body: Satellite, spin: Any, rows: Any) -> Any:
    """Attitudes (rows, 4) by DOP853."""
    tensor, inverse = body.inertia.tolist(), np.linalg.inv(body.inertia).tolist()
    plates = [(*p.normal.tolist(), *p.centre.tolist(), p.area) for p in body.plates if body.light or body.density]

    def rate(t: float, y: Any) -> list[float]:
        w, (a, b, c, d) = y[:3].tolist(), (y[3:] / math.sqrt(y[3:] @ y[3:])).tolist()
        back = [  # space to body
            [1 - 2 * (c * c + d * d), 2 * (b * c + a * d), 2 * (b * d - a * c)],
            [2 * (b * c - a * d), 1 - 2 * (b * b + d * d), 2 * (c * d + a * b)],
            [2 * (b * d + a * c), 2 * (c * d - a * b), 1 - 2 * (b * b + c * c)],
        ]
        r, v = place(t, body.orbit)
        size = math.sqrt(r[0] ** 2 + r[1] ** 2 + r[2] ** 2)
        u = times(back, [x / size for x in r])
        torques = [[3 * MU / size**3 * x for x in cross(u, times(tensor, u))], [-x for x in cross(w, times(tensor, w))]]
        z = r[2] / size
        B = times(back, [FIELD / size**3 * (3 * z * x / size - k) for x, k in zip(r, (0, 0, 1), strict=True)])
        torques.append(cross(body.magnetic_moment, B))
        stream, sun = times(back, v), times(back, SUN)
        for nx, ny, nz, cx, cy, cz, area in plates:
            wind = max(0.0, nx * stream[0] + ny * stream[1] + nz * stream[2]) * area * body.density * body.drag / 2
            lit = max(0.0, nx * sun[0] + ny * sun[1] + nz * sun[2]) * area * body.light
            torques.append(cross((cx, cy, cz), [-wind * x - lit * s for x, s in zip(stream, sun, strict=True)]))
        x, y_, z_ = w
        turning = [-b * x - c * y_ - d * z_, a * x + c * z_ - d * y_, a * y_ + d * x - b * z_, a * z_ + b * y_ - c * x]
        return [*times(inverse, [sum(k) for k in zip(*torques, strict=True)]), *(k / 2 for k in turning)]

    solver = DOP853(rate, 0.0, np.array([*spin, *START]), rows[-1], rtol=3e-14, atol=1e-16, max_step=4.0)
    out = [START]
    while solver.status == "running":
        solver.step()
        while len(out) < len(rows) and rows[len(out)] <= solver.t:
            out.append(solver.dense_output()(rows[len(out)])[3:])
    return np.array(out) / np.linalg.norm(out, axis=1, keepdims=True)


def main() -> None:
    """Print and write a row for each case."""
    file = RESULTS / "satellite_day.json"
    rows = json.loads(file.read_text())["cases"] if file.exists() else {}
    for name in sys.argv[1:] or CASES:
        make, spin = CASES[name]
        body, begun = make(), time.process_time()
        run = kr.simulate(body, body.state(spin, attitude=START), t_end=DAY, every="1 h", progress=False)
        seconds = time.process_time() - begun
        truth, q = by_equations(body, spin, run.time.values), run.attitude.values
        off = np.minimum(*(np.linalg.norm(q - s * truth, axis=1) for s in (1, -1)))
        expected = json.loads(run.attrs["options"])["expected_error"]
        angle, dt = float(4 * np.arcsin(off.max() / 2)), float(run.attrs["dt"])
        rows[name] = {"dt": dt, "off": angle, "expected": expected, "seconds": seconds}
        print(f"{name:10s} dt {dt:.3g} s, off {angle:.1e} rad, expected {expected:.1e}, {seconds:.1f} s CPU")
        file.write_text(json.dumps({"machine": machine(), "cases": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
