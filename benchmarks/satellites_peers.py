"""The satellites of the guides by Kreisel, by textbook equations at 1e-12, and by Basilisk.

    python benchmarks/satellites_peers.py [--basilisk PYTHON] [--hours 24] [--only NAME]

Writes results/satellites_peers.json.  Four CubeSats at 500 km, without noise, sunlight and air, in the field of
IGRF-14, with the default order of Kreisel.  The equations are Euler's in the body axes with a quaternion, by DOP853 at
1e-12 from sample to sample; the field is that of ppigrf, the rotation of the Earth that of ERFA, the laws those of
`satellite_laws`: nothing of Kreisel.  Basilisk makes steps of 1 s and 0.1 s, over each of which it holds the field; its
coefficients are those of ppigrf's file at the epoch.

error      the largest angle between an attitude and that of the equations, rad, at rows a minute apart; of the first
           hour (error_1h) and to the end
estimate   of Kreisel: `kr.analysis.error`
seconds    CPU time of the run

Basilisk is installed as for `engines`, in the versions of engines/pins.toml.
"""

from __future__ import annotations

import datetime as dt
import json
import subprocess
import sys
import time
import tomllib
from bisect import bisect
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine, parser, write
from satellite_laws import LAWS
from scipy.integrate import DOP853
from scipy.interpolate import PPoly, make_interp_spline
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.physical import Orbit, Satellite, Wheels, bdot, hysteresis_rods, pointing

sys.path.append(str(Path(__file__).parent / "engines"))
import environments

EPOCH = dt.datetime(2026, 3, 20, 14, 46)  # UTC
MU, RADIUS, HEIGHT = 3.986004418e14, 6378137.0, 500e3  # WGS 84
INCLINATION = np.radians(97.4)
LONG, SHORT = 3.99 / 12 * (0.3**2 + 0.1**2), 3.99 / 12 * (0.1**2 + 0.1**2)  # kg m^2, of a box of three units
MOMENTS = [SHORT, LONG, LONG]
INERTIA = np.diag(MOMENTS)
A = RADIUS + HEIGHT
N = np.sqrt(MU / A**3)
ROW, GRID = 60.0, 5.0  # s: between rows; of the spline of the field
ROUNDING = {"rtol": 1e-12, "atol": 1e-15}


# -- the world, without Kreisel ---------------------------------------------------------------------


def place(t: Any) -> tuple[Any, Any]:
    """Position and velocity on the circular orbit, (..., 3)."""
    c, s, ci, si = np.cos(N * t), np.sin(N * t), np.cos(INCLINATION), np.sin(INCLINATION)
    return A * np.stack([c, s * ci, s * si], -1), A * N * np.stack([-s, c * ci, c * si], -1)


def meridian(t: Any) -> Any:
    """The angle of Greenwich from the equinox of the epoch, rad: sidereal time there, then the Earth's rotation."""
    import erfa

    first, second = erfa.dtf2d("UTC", *EPOCH.timetuple()[:5], 0.0)
    turned = erfa.era00(first, second + np.atleast_1d(t) / 86400) - erfa.era00(first, second)
    return erfa.gmst06(first, second, first, second) + np.unwrap(turned)


def field_of(end: float) -> Callable[[float], Any]:
    """The field (3,) in space, T, as a spline of degree 7 through values of ppigrf."""
    import ppigrf

    t = np.arange(0, end + 3 * GRID, GRID)
    r, _ = place(t)
    angle = meridian(t)
    theta, phi = np.arccos(r[:, 2] / A), np.arctan2(r[:, 1], r[:, 0])
    days = [EPOCH, EPOCH + dt.timedelta(days=10)]  # the model is linear in time between them
    parts = ppigrf.igrf_gc(A / 1e3, np.degrees(theta), np.degrees(phi - angle), days)
    share = t / (10 * 86400)
    Br, Bt, Bp = (1e-9 * (x[0] * (1 - share) + x[1] * share) for x in parts)
    st, ct, sp, cp = np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi)
    B = np.stack([(Br * st + Bt * ct) * cp - Bp * sp, (Br * st + Bt * ct) * sp + Bp * cp, Br * ct - Bt * st], -1)
    parts = [PPoly.from_spline(make_interp_spline(t, x, k=7)) for x in B.T]
    first = parts[0].x.tolist()
    powers = np.array([part.c for part in parts]).transpose(2, 0, 1).tolist()

    def field(time: float) -> list[float]:
        i = min(bisect(first, time), len(powers)) - 1
        s = time - first[i]
        return [reduce(lambda value, c: value * s + c, row) for row in powers[i]]

    return field


def coefficients(year: float) -> str:
    """The coefficients of IGRF-14 at the epoch, from ppigrf's file, as a WMM.COF."""
    from ppigrf.ppigrf import read_shc

    rows = [f"    {year:.8f}            IGRF-14              03/20/2026"]
    g, h = read_shc()
    last, before = g.index[-1], g.index[-2]
    share, span = (EPOCH - before) / (last - before), (last - before).days / 365.25
    for n, m in g.columns:
        values = []
        for table in (g, h):
            a, b = (float(table[(n, m)].loc[date]) for date in (before, last))
            values += [a + share * (b - a), (b - a) / span]
        rows.append(f"{n:3d}{m:3d} {values[0]:.7f} {values[2]:.7f} {values[1]:.7f} {values[3]:.7f}")
    return "\n".join([*rows, "9" * 48, "9" * 48, ""])


def cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """The vector product, in Python's floats."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def turned(a: float, b: float, c: float, d: float) -> list[list[float]]:
    """The matrix, body to space, of a quaternion of length 1."""
    return [
        [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
    ]


def by_equations(case: dict[str, Any], end: float, field: Callable[[float], Any]) -> Any:
    """Attitudes (w, x, y, z) at the rows, from Euler's equations in the body axes."""
    law, moment, every = LAWS[case["law"]](**case["parameters"]), np.array(case["moment"]), case["every"]
    q, w, h = np.array(case["attitude"]), np.array(case["rates"]), np.zeros(3)
    held = {"dipole": moment.tolist(), "motors": [0.0, 0.0, 0.0]}

    def rate(t: float, y: Any) -> list[float]:
        a, b, c, d, *w = y[:7].tolist()
        h, u, B = y[7:].tolist(), [x / A for x in place(t)[0].tolist()], field(t)
        C = turned(a, b, c, d)
        u, B = ([sum(C[i][j] * v[i] for i in range(3)) for j in range(3)] for v in (u, B))
        L = [m * x + y for m, x, y in zip(MOMENTS, w, h, strict=True)]
        pull, magnet = cross(u, [m * x for m, x in zip(MOMENTS, u, strict=True)]), cross(held["dipole"], B)
        gyre, motors = cross(w, L), held["motors"]
        change = [(3 * N**2 * pull[i] + magnet[i] - motors[i] - gyre[i]) / MOMENTS[i] for i in range(3)]
        x, y, z = w
        turn = [-b * x - c * y - d * z, a * x + c * z - d * y, a * y + d * x - b * z, a * z + b * y - c * x]
        return [*(v / 2 for v in turn), *change, *motors]

    rows, size = [q], None
    for k in range(round(end / every)):
        t = k * every
        if case["law"] != "none":
            C = Rotation.from_quat(q, scalar_first=True).as_matrix()
            r, v = place(t)
            dipole, motors = law(B=np.array(field(t)) @ C, w=w, C=C, h=h, r=r, v=v)
            held |= {"dipole": (dipole + moment).tolist(), "motors": motors.tolist()}
        solver = DOP853(rate, t, np.concatenate([q, w, h]), t + every, first_step=size, **ROUNDING)
        while solver.status == "running":
            solver.step()
            size = min(solver.h_abs, every)
        q, w, h = solver.y[:4] / np.linalg.norm(solver.y[:4]), solver.y[4:7], solver.y[7:]
        if abs((t + every) / ROW - round((t + every) / ROW)) < 1e-9:
            rows.append(q)
    return np.array(rows)


# -- the cases ----------------------------------------------------------------------------------------


def cases() -> dict[str, dict[str, Any]]:
    """The satellites of the guides: arguments of `Satellite.cubesat`, the law and the start."""
    gain = 2 * N * (1 + np.sin(INCLINATION)) * SHORT
    rods = {"volume": 6 * np.pi / 4 * 0.001**2 * 0.095, "coercivity": 12.0, "remanence": 4e-3, "saturation": 27e-3}
    across = [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    wheels, hold = Wheels(np.eye(3)), {"stiffness": LONG * 0.01, "damping": 0.14 * LONG, "unloading": 1e-3}
    limits = {"wheel_torque": 2e-4, "dipole": 0.2}
    spin = np.radians([2.0, 1.0, -1.0])
    return {
        "B-dot": {
            "law": "bdot",
            "parameters": {"gain": gain, "every": 1.0, "limit": 0.2},
            "body": {"control": bdot(gain, limits={"dipole": 0.2})},
            "rates": np.radians([6.0, 6.0, -5.3]),
            "dt": 1.0,
        },
        "three wheels": {
            "law": "pointing",
            "parameters": {**hold, "limit": 2e-4, "most": 0.2},
            "body": {"wheels": wheels, "control": pointing(wheels, **hold, limits=limits)},
            "rates": np.radians([1.0, -0.5, 0.8]),
            "moment": [0, 0, 0.01],
            "dt": 1.0,
        },
        "magnet and rods": {
            "law": "rods",
            "parameters": {"axes": across, **rods},
            "body": {"control": hysteresis_rods(across, **rods, every=5.0)},
            "rates": spin,
            "moment": [0.3, 0, 0],
            "dt": 5.0,
            "every": 5.0,
        },
        "nose-down": {
            "law": "none",
            "parameters": {},
            "body": {},
            "moment": [0, 0, 1e-4],
            "dt": 15.0,
            "every": 60.0,
        },
    }


def completed(case: dict[str, Any]) -> tuple[Satellite, Any]:
    """The satellite and its state; the case with its attitude, rates and sampling."""
    case.setdefault("moment", [0, 0, 0])
    case.setdefault("every", 1.0)
    orbit = Orbit.circular(HEIGHT, INCLINATION, epoch=EPOCH.isoformat())
    body = Satellite.cubesat(orbit, 3, plates=(), magnetic_moment=case["moment"], **case["body"])
    assert abs(body.inertia - INERTIA).max() < 1e-12
    attitude = body.pointing(pitch="10 deg")
    rates = case.get("rates")
    if rates is None:
        normal = np.cross(*(x for x in place(0.0)))
        rates = N * Rotation.from_quat(attitude, scalar_first=True).as_matrix().T @ normal / np.linalg.norm(normal)
    case |= {"attitude": attitude.tolist(), "rates": np.asarray(rates).tolist()}
    return body, body.state(spin=case["rates"], attitude=attitude)


def angles(q: Any, truth: Any) -> Any:
    """The angle between attitudes at each row, rad."""
    a, b = (Rotation.from_quat(x, scalar_first=True) for x in (q, truth))
    return (a.inv() * b).magnitude()


def by_kreisel(body: Satellite, start: Any, step: float, end: float) -> tuple[Any, float]:
    settings = {"dt": step, "every": f"{max(ROW, step)} s", "observe": (), "progress": False}
    kr.simulate(body, start, t_end=max(ROW, step), **settings)
    begun = time.process_time()
    run = kr.simulate(body, start, t_end=end, **settings)
    return run, time.process_time() - begun


def by_basilisk(python: Path, case: dict[str, Any], step: float, end: float) -> dict[str, Any]:
    day = EPOCH.timetuple().tm_yday - 1 + (EPOCH.hour + EPOCH.minute / 60) / 24
    r, v = place(0.0)
    angle = meridian(np.array([0.0, 3600.0]))
    job = {key: case[key] for key in ("law", "parameters", "attitude", "rates", "every")}
    job |= {"moment": np.asarray(case["moment"], float).tolist(), "dt": step, "end": end, "row": ROW, "mass": 3.99}
    job |= {"inertia": INERTIA.tolist(), "position": r.tolist(), "velocity": v.tolist(), "mu": MU}
    job |= {"wheels": case["law"] == "pointing", "year": 2026 + day / 365}
    job |= {"meridian": [angle[0], (angle[1] - angle[0]) / 3600], "coefficients": coefficients(2026 + day / 365)}
    script = Path(__file__).with_name("satellites_basilisk.py")
    done = subprocess.run([str(python), str(script)], input=json.dumps(job), capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def measured(case: dict[str, Any], hours: float, python: Path) -> dict[str, Any]:
    body, start = completed(case)
    end = 3600 * hours
    truth = by_equations(case, end, field_of(end))
    run, took = by_kreisel(body, start, case["dt"], end)
    q = run.attitude.values
    row = {"dt": case["dt"], "hours": hours, **errors(q, truth), "seconds": short(took)}
    row["estimate"] = short(kr.analysis.error(run, body).attitude.max())
    peers = [(step, by_basilisk(python, case, step, end)) for step in (1.0, 0.1)]
    row["basilisk"] = [
        {"dt": step, **errors(peer["attitude"], truth), "seconds": short(peer["seconds"])} for step, peer in peers
    ]
    return row


def errors(q: Any, truth: Any) -> dict[str, float]:
    """The largest error in the first hour and to the end."""
    off = angles(q, truth)
    return {"error_1h": short(off[:61].max()), "error": short(off.max())}


def short(x: Any) -> float:
    return float(f"{float(x):.3g}")


def installed() -> Path:
    """The Python of an environment with the Basilisk of engines/pins.toml."""
    catalogue = tomllib.loads((environments.HERE / "engines.toml").read_text(encoding="utf-8"))
    environments.install({"name": "basilisk", **catalogue["basilisk"]})
    return environments.ROOT / "basilisk" / "bin" / "python"


def main(arguments: list[str] | None = None) -> None:
    options = parser(__doc__, "satellites_peers")
    options.add_argument("--basilisk", type=Path, help="a Python that has bsk; default: one is installed")
    options.add_argument("--hours", type=float, default=24.0)
    options.add_argument("--only")
    asked = options.parse_args(arguments)
    python, rows = asked.basilisk or installed(), {}
    for name, case in cases().items():
        if asked.only in (None, name):
            rows[name] = measured(case, asked.hours, python)
            print(name, rows[name], flush=True)
    write({"machine": machine(), "cases": rows}, asked.output)


if __name__ == "__main__":
    main()
