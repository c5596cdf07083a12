"""Is Hyperion's rotation chaotic?  MEGNO and Lyapunov's times of the complete motion over 10,000 orbits, 583 years.

    python benchmarks/hyperion.py

Writes results/hyperion.json.  A rigid body on a fixed Kepler orbit in the field of a point mass: three degrees of
freedom, nothing averaged, no tides, as in the integrations of Goldberg and Batygin (2024).  States at the start:

    flybys      as Voyager 2 saw it in 1981 and Cassini three times in 2005 [Goldberg, Batygin 2024, table 1, from Black
                et al. 1995 and Harbison et al. 2011], for 2005 also corrected for an offset of the principal axes, on
                the orbit of that day; each with 9 neighbours, whose attitude and spin differ by 0.05 rad and 2 %
    any         4.2 to 4.5 times the mean motion about an axis 30 degrees off the longest, in all directions, e = 0.1
    slow        0.6 to 1.6 times the mean motion about the shortest axis, tilted by 0.5 rad, to which tides lead
                [Wisdom, Peale, Mignard 1984], e = 0.1

    moments     0.314, 0.474, 0.542 M R^2, the shape of Cassini with constant density [Harbison et al. 2011]
    Thomas      an ellipsoid with half axes 180.1, 133.0, 102.7 km [Thomas 2010]
    symmetric   the first with the mean of its larger moments for both, as in the theory of Goldberg and Batygin

The table has Euler angles Z, X, Z and axes A, B and C, the longest.  Of eight readings the one is used that links the
flybys: from a neighbour of the state of June a motion leads to that of August, and from August to that of September
("linked": the mismatch of attitude, rad, and of the spin, relative, added up).  The angles rotate space into the body,
the moment about A is the largest, and the pericentre is the first axis of space.  MEGNO is 2 for a quasi-periodic
motion and grows like t for a chaotic one; a motion counts as regular if it is below 3 at the end.  Lyapunov's times are
quartiles of the others.  A motion is compared with SciPy's DOP853.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from cases import machine, parser, write
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.analysis.frequencies import megno
from kreisel.physical import SATURN, Asteroid, Ensemble, FreeBody, Orbit

ORBITS, STEPS, LANES, NEIGHBOURS, APART = 10_000, 64, 32, 9, 0.05
N = 2 * np.pi / (21.28 * 86400)
FLYBYS = {  # e, M, Euler angles Z X Z, direction of the spin along A, B and the longest axis, spin over mean motion
    "1981-08-23": (0.124, 0.349, (5.676, 0.965, 3.448), (0.211, -0.019, 0.977), 4.225),
    "2005-06-10": (0.115, 5.149, (1.713, 1.148, 1.508), (0.067, 0.451, 0.890), 4.433),
    "2005-08-16": (0.115, 5.969, (0.559, 0.661, 0.587), (0.162, 0.389, 0.907), 4.255),
    "2005-09-25": (0.113, 5.288, (5.734, 0.134, 0.705), (0.133, 0.411, 0.902), 4.255),
    "2005-06-10, corrected": (0.115, 5.149, (2.055, 0.963, 2.210), (-0.010, -0.182, 0.983), 4.433),
    "2005-08-16, corrected": (0.115, 5.969, (1.025, 0.819, 1.112), (-0.166, 0.009, 0.986), 4.255),
    "2005-09-25, corrected": (0.113, 5.288, (0.527, 0.393, 0.525), (-0.095, 0.157, 0.983), 4.255),
}
SHAPE = np.array((0.314, 0.474, 0.542))
MOMENTS = {
    "moments": SHAPE,
    "Thomas": FreeBody.ellipsoid(1.0, (3.602, 2.660, 2.054)).principal.moments,
    "symmetric": SHAPE[[0, 1, 1]] + (SHAPE[2] - SHAPE[1]) / 2 * np.array((0, 1, 1)),
}
LARGER = {"A larger": np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]), "B larger": np.eye(3)[[1, 2, 0]]}
READINGS = [(larger, back, into) for larger in LARGER for back in (False, True) for into in (True, False)]


def orbit(e: float = 0.1, M: float = 0.0) -> Orbit:
    return Orbit((SATURN.mu / N**2) ** (1 / 3), e, mean_anomaly=M, primary=SATURN)


def quaternion(turns: Rotation) -> Any:
    return np.roll(turns.as_quat(), 1, -1)


def at_flyby(
    name: str, draw: np.random.Generator, count: int = NEIGHBOURS, larger: str = "A larger", back: bool = False,
    into: bool = True,
) -> tuple[Orbit, Any, Any]:  # fmt: skip
    """The orbit, spins along the principal axes, longest first, and attitudes: as published, then neighbours.

    back    whether the angles are in the opposite order;  into: whether they rotate space into the body
    """
    e, M, angles, direction, rate = FLYBYS[name]
    spread = np.arange(count + 1)[:, None] > 0
    axes = np.array(direction) / np.linalg.norm(direction)  # rows of three digits
    axes = axes + APART * spread * draw.normal(size=(count + 1, 3))
    rates = rate * N * (1 + 0.02 * spread * draw.normal(size=(count + 1, 1)))
    near = Rotation.from_rotvec(APART * spread * draw.normal(size=(count + 1, 3)))
    to_table = LARGER[larger]  # from principal axes to those of the table
    spin = rates * axes / np.linalg.norm(axes, axis=-1, keepdims=True) @ to_table
    turn = Rotation.from_euler("ZXZ", angles[::-1] if back else angles)
    turn = turn.inv() if into else turn
    return orbit(e, M), spin, quaternion(near * turn * Rotation.from_matrix(to_table))


def mismatch(first: str, then: str, orbits: int, reading: tuple[str, bool, bool]) -> float:
    """The least, among neighbours, of the angle between attitudes and the difference of spins, from flyby to flyby."""
    path, spin, q = at_flyby(first, np.random.default_rng(1), 600, *reading)
    _, later, goal = at_flyby(then, np.random.default_rng(1), 0, *reading)
    body, time = Asteroid(SHAPE, path), (FLYBYS[then][1] - FLYBYS[first][1] + 2 * np.pi * orbits) / N
    run = kr.simulate(body, body.state(spin, attitude=q), dt=time / 300, steps=300, every=300, progress=False)
    end, aim = (Rotation.from_quat(np.roll(x, -1, -1)) for x in (run.attitude.values[-1], goal[0]))
    halves = [Rotation.from_rotvec(np.pi * x) for x in (np.zeros(3), *np.eye(3))]  # which the torque does not see
    angle = np.min([(aim.inv() * end * half).magnitude() for half in halves], axis=0)
    spins = end.apply(run.angular_velocity.values[-1]) - aim.apply(later[0])
    return float((angle + np.linalg.norm(spins, axis=-1) / np.linalg.norm(later[0])).min())


def in_general(name: str, draw: np.random.Generator) -> tuple[Orbit, Any, Any]:
    if name == "slow":
        rate = np.linspace(0.6, 1.6, LANES) * N
        return (
            orbit(),
            rate[:, None] * np.array((0.0, 0.0, 1.0)),
            np.tile((np.cos(0.25), np.sin(0.25), 0, 0), (LANES, 1)),
        )
    rate, turn, off = draw.uniform(4.2, 4.5, LANES) * N, draw.uniform(0, 2 * np.pi, LANES), np.radians(30)
    axis = np.stack([np.full(LANES, np.cos(off)), np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn)], -1)
    return orbit(), rate[:, None] * axis, quaternion(Rotation.random(LANES, rng=draw))


def measured(moments: Any, cases: list[tuple[Orbit, Any, Any]], orbits: int) -> list[dict[str, Any]]:
    """A row for each case; all of them are lanes of one run."""
    bodies = [Asteroid(moments, path) for path, spin, _ in cases for _ in spin]
    many, period = Ensemble(bodies), 2 * np.pi / N
    spins, attitudes = (np.concatenate([case[k] for case in cases]) for k in (1, 2))
    settings = {"dt": period / STEPS, "steps": orbits * STEPS, "every": STEPS // 8}
    found = megno(many.model(), bodies[0].state(spins), orientation=bodies[0].orientation(attitudes), **settings)
    last, rows, first = found.isel(time=-1), [], 0
    for _, spin, _ in cases:
        lanes = slice(first, first + len(spin))
        first += len(spin)
        value, exponent = last.megno.values[lanes], last.lyapunov.values[lanes] * period
        chaotic = value >= 3
        row: dict[str, Any] = {"regular": int((~chaotic).sum()), "of": len(spin), "first_is_regular": bool(~chaotic[0])}
        if chaotic.any():
            times = np.percentile(1 / exponent[chaotic], (25, 50, 75))
            row["lyapunov_orbits"] = [float(f"{v:.3g}") for v in times]
            row["lyapunov_days"] = [float(f"{v * period / 86400:.3g}") for v in times]
        rows.append(row)
    return rows


def off_dop853(orbits: int = 5) -> float:
    """The largest difference of an entry of the attitude matrix from Euler's equations by SciPy."""
    path, spin, attitude = at_flyby("2005-06-10", np.random.default_rng(0))
    body, e, M = Asteroid(SHAPE, path), *FLYBYS["2005-06-10"][:2]

    def rates(t: float, y: Any) -> Any:  # in the time 1/N
        E = M + t
        for _ in range(30):
            E = E - (E - e * np.sin(E) - M - t) / (1 - e * np.cos(E))
        r = np.array((np.cos(E) - e, np.sqrt(1 - e * e) * np.sin(E), 0.0))
        g, w = y[:9].reshape(3, 3), y[9:]
        u = g.T @ r
        torque = 3 * np.cross(u, SHAPE * u) / np.linalg.norm(r) ** 5
        hat = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([(g @ hat).ravel(), (torque - np.cross(w, SHAPE * w)) / SHAPE])

    first = np.concatenate([Rotation.from_quat(np.roll(attitude[0], -1)).as_matrix().ravel(), spin[0] / N])
    last = solve_ivp(rates, (0, orbits * 2 * np.pi), first, "DOP853", rtol=1e-12, atol=1e-12).y[:9, -1]
    settings = {"dt": 2 * np.pi / N / STEPS, "steps": orbits * STEPS, "every": STEPS}
    run = kr.simulate(body, body.state(spin[0], attitude=attitude[0]), **settings)
    return float(abs(kr.algebra.rotation_matrix(run.attitude.values[-1]) - last.reshape(3, 3)).max())


def main(arguments: list[str] | None = None) -> None:
    reader = parser(__doc__, "hyperion")
    reader.add_argument("--orbits", type=int, default=ORBITS)
    asked = reader.parse_args(arguments)
    result: dict[str, Any] = {"machine": machine(), "orbits": asked.orbits, "kreisel": kr.__version__}
    result["off_dop853"] = float(f"{off_dop853():.2g}")
    legs = ("2005-06-10", "2005-08-16", 3), ("2005-08-16", "2005-09-25", 2)
    result["linked"] = [[*reading, round(sum(mismatch(*leg, reading) for leg in legs), 2)] for reading in READINGS]
    print(result, flush=True)
    assert min(result["linked"], key=lambda row: row[-1]) == result["linked"][0]
    result |= {"flybys": {}, "rows": {}}
    for title, moments in MOMENTS.items():
        draw = np.random.default_rng(7)
        rows = measured(moments, [at_flyby(name, draw) for name in FLYBYS], asked.orbits)
        for name, row in zip(FLYBYS, rows, strict=True):
            result["flybys"][f"{title}: {name}"] = row
            print(f"{title}: {name}", row, flush=True)
        write(result, asked.output)
    for title, moments in MOMENTS.items():
        draw = np.random.default_rng(7)
        for name, row in zip(("any", "slow"), measured(moments, [in_general("any", draw), in_general("slow", draw)],
                             asked.orbits), strict=True):  # fmt: skip
            result["rows"][f"{title}: {name}"] = row
            print(f"{title}: {name}", row, flush=True)
        write(result, asked.output)


if __name__ == "__main__":
    main()
