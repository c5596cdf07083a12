"""Spins of a REBOUND simulation: conserved quantities and the cost of a step, next to REBOUNDx; Mercury for 1e5 orbits.

    python benchmarks/spin_orbit.py

Needs REBOUNDx (`pip install reboundx`, a C compiler).  A few minutes.  G = 1, masses in that of the Sun, au.

moon      the case of the thread reboundx 172: Sun, Earth and Moon, whose orbit is inclined by 60 degrees, tides that
          lag.  The thread leaves open, and this script chooses: 32 Earth radii, a day of 5 hours.
cost      a step of WHFast with spins and without, of three particles with late tides, and of Mercury
order     the energy of a star, a planet and a moonless third body against the step
mercury   from its perihelion in the 3:2 resonance
tides     the cases of the test of conservation in REBOUNDx, with its energy, at all phases of the orbit
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import rebound
import reboundx
from cases import machine, parser, write

from kreisel.graph.llvm import Function
from kreisel.graph.machine import Kernel, object_code
from kreisel.rebound import Body, Spins, attach, compiled

DAY, RADIUS, MOON_RADIUS = 2 * np.pi / 365.25, 4.2635e-5, 1.161e-5
EARTH, MOON, TILT, PER = 3.003e-6, 3.694e-8, np.radians(60), 60
MOMENTS = {"Earth": 0.3308 * EARTH * RADIUS**2, "Moon": 0.393 * MOON * MOON_RADIUS**2}
MODES = "alone", "alone without safe mode"
LOVE, LAG = {"Earth": 0.298, "Moon": 0.024}, 600 / 86400 * DAY
E, J2, C22, C = 0.2056, 5.03e-5, 8.09e-6, 0.346
MERCURY = np.array([C - J2 - 2 * C22, C - J2 + 2 * C22, C]) * 1.66e-7 * 1.631e-5**2


def short(x: float) -> float:
    return float(f"{float(x):.3g}")


# -- the Moon --------------------------------------------------------------------------------------------------


def triple(integrator: str) -> tuple[Any, dict[str, np.ndarray], float]:
    """The simulation, the angular velocities, and the angular momentum of Earth and Moon about each other."""
    sim = rebound.Simulation()
    sim.add(m=EARTH, r=RADIUS, name="Earth")  # the inner orbit first: WHFast's is then that of the Moon
    sim.add(m=MOON, a=32 * RADIUS, e=0.01, inc=TILT, r=MOON_RADIUS, name="Moon")
    sim.add(m=1.0, a=1.0, e=0.0167)
    sim.move_to_com()
    sim.integrator = integrator
    earth, moon = sim.particles["Earth"], sim.particles["Moon"]
    n = moon.orbit(primary=earth).n
    sim.dt = 2 * np.pi / n / PER
    spins = {
        "Earth": 2 * np.pi / (5 / 24 * DAY) * np.array([0.0, 0.0, 1.0]),
        "Moon": n * np.array([0.0, -np.sin(TILT), np.cos(TILT)]),
    }
    r, v = (np.subtract(getattr(moon, name), getattr(earth, name)) for name in ("xyz", "vxyz"))
    inner = EARTH * MOON / (EARTH + MOON) * np.cross(r, v) + sum(MOMENTS[name] * spins[name] for name in spins)
    return sim, spins, float(np.linalg.norm(inner))


def own(integrator: str) -> tuple[Any, Callable[[], np.ndarray], Callable[[int], None], float]:
    """The simulation, its angular momentum, a function that steps n times, and the inner angular momentum."""
    sim, spin, inner = triple(integrator)
    bodies = {name: Body(MOMENTS[name], spin=spin[name], love=LOVE[name], lag=LAG) for name in spin}
    spins = attach(sim, bodies, dt=sim.dt if integrator == "ias15" else None)
    return sim, spins.angular_momentum, spins.steps, inner


def peer(integrator: str) -> tuple[Any, Callable[[], np.ndarray], Callable[[int], None], float]:
    """The simulation with `tides_spin`, whose tau is half the lag."""
    sim, spin, inner = triple(integrator)
    extras = reboundx.Extras(sim)
    force = extras.load_force("tides_spin")
    extras.add_force(force)
    for name in spin:
        given = {"k2": LOVE[name], "I": MOMENTS[name], "Omega": list(spin[name]), "tau": LAG / 2}
        for key, value in given.items():
            sim.particles[name].params[key] = value
    extras.initialize_spin_ode(force)
    dt = sim.dt

    def momentum() -> np.ndarray:
        return np.array([*sim.angular_momentum()]) + np.array([*extras.spin_angular_momentum()])

    def go(steps: int) -> None:
        if integrator == "ias15":
            sim.integrate(sim.t + steps * dt)
        else:
            sim.steps(steps)

    return sim, momentum, go, inner


def moon() -> dict[str, Any]:
    found = {}
    for name, make, integrator, orbits in (
        ("kreisel, whfast", own, "whfast", 1_000_000),
        ("kreisel, ias15", own, "ias15", 5_000),
        ("tides_spin, whfast", peer, "whfast", 10_000),
        ("tides_spin, ias15", peer, "ias15", 5_000),
    ):
        sim, momentum, go, inner = make(integrator)
        start, worst, eccentricity = momentum(), 0.0, 0.0
        for _ in range(50):
            go(orbits * PER // 50)
            worst = max(worst, float(np.linalg.norm(momentum() - start)))
            orbit = sim.particles["Moon"].orbit(primary=sim.particles["Earth"])
            eccentricity = max(eccentricity, orbit.e)
        found[name] = {
            "orbits of the Moon": orbits,
            "change of the total": short(worst / np.linalg.norm(start)),
            "change, of the inner value": short(worst / inner),
            "largest eccentricity": round(eccentricity, 2),
        }
        print(name, found[name], flush=True)
    return found


def pair(second: bool) -> Any:
    """A step of an ellipsoid of degree four and a moon, a point or an ellipsoid too."""
    sim = resonance(0.5)[0].sim
    figure = {"degree_3": np.full(7, 1e-20), "degree_4": np.full(9, 1e-24)}
    body = Body(MERCURY, spin=(0, 0, 5.0), **figure)
    return attach(sim, {"Mercury": body, 0: body} if second else {"Mercury": body}).steps


def cost(repetitions: int = 40, steps: int = 5000) -> dict[str, Any]:
    """Nanoseconds of the processor a step of WHFast with spins and without, the least, alternating."""

    def alone(make: Callable[[], Any], safe: bool) -> Any:
        sim = make()
        sim.integrator.safe_mode = int(safe)
        return sim.steps

    makers = {"three, tides": lambda: triple("whfast")[0], "two": lambda: resonance(0.5)[0].sim}
    steppers = {f"{name}, {mode}": alone(make, mode == "alone") for name, make in makers.items() for mode in MODES}
    steppers |= {"three, tides, kreisel": own("whfast")[2], "three, tides, tides_spin": peer("whfast")[2]}
    steppers |= {
        "two, kreisel": resonance(0.5)[0].steps,
        "two, degree 4": pair(False),
        "two, both degree 4": pair(True),
    }
    least = dict.fromkeys(steppers, np.inf)
    for _ in range(repetitions):
        for name, go in steppers.items():
            begin = time.thread_time()
            go(steps)
            least[name] = min(least[name], (time.thread_time() - begin) / steps * 1e9)
    found: dict[str, Any] = {"ns a step": {name: round(value) for name, value in least.items()}}
    for name in makers:
        share = {mode: round(least[f"{name}, kreisel"] / least[f"{name}, {mode}"], 2) for mode in MODES}
        found[f"{name}: kreisel over WHFast"] = share
    found["kreisel over tides_spin"] = short(least["three, tides, kreisel"] / least["three, tides, tides_spin"])
    print("cost", found, flush=True)
    return found


def parts(loops: int = 20_000, repetitions: int = 40) -> dict[str, int]:
    """Nanoseconds of the exact rotation and of the interaction of Mercury, each in a separate loop."""
    spins, found = resonance(0.5)[0], {}
    kinds = spins._prepare(spins.dt, 1, True)
    for name in ("rotation", "interaction"):

        def write(f: Function, name: str = name) -> None:
            code = compiled.Code(f, kinds)
            with f.loop(0, loops):
                code.turn(code.times["dt"][0]) if name == "rotation" else code.act(f.integer(0), inside=True)

        kernel, times = Kernel(object_code(1, write), 1), []
        for _ in range(repetitions):
            begin = time.thread_time()
            kernel(spins._frame.ctypes.data)
            times.append(time.thread_time() - begin)
        found[name] = round(min(times) / loops * 1e9)
    print("parts", found, flush=True)
    return found


# -- the order -------------------------------------------------------------------------------------------------


def order() -> dict[str, Any]:
    found = {}
    for integrator in ("whfast", "leapfrog", "ias15"):
        errors = []
        for per in (40, 80, 160, 320, 640):
            sim = rebound.Simulation()
            sim.add(m=1.0, r=0.05)
            sim.add(m=1e-3, a=1.0, e=0.2, inc=0.3)
            sim.add(m=1e-3, a=3.0, e=0.1)
            sim.move_to_com()
            sim.integrator, sim.dt = integrator, 2 * np.pi / per
            bodies = {
                1: Body(np.array([0.3, 0.35, 0.4]) * 1e-4, spin=(0.1, 0.3, 1.5)),
                0: Body(4e-3, spin=(0, 1, 3), radius=0.2, love=0.5),
            }
            spins = attach(sim, bodies, dt=sim.dt if integrator == "ias15" else None)
            start, worst = spins.energy(), 0.0
            for _ in range(60):
                spins.steps(per // 20)
                worst = max(worst, abs(spins.energy() / start - 1))
            errors.append(worst)
        slopes = np.log2(np.array(errors[:-1]) / errors[1:])
        found[integrator] = {"errors": [short(x) for x in errors], "slopes": [round(float(s), 2) for s in slopes]}
        print(integrator, found[integrator], flush=True)
    return found


# -- Mercury ---------------------------------------------------------------------------------------------------


def resonance(rate: float) -> tuple[Spins, float, float]:
    """`rate`: of the angle against 3:2 resonance at the perihelion, in parts of the half width; n, and that width."""
    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(m=1.66e-7, a=0.387, e=E, name="Mercury")
    sim.move_to_com()
    sim.integrator = "whfast"
    n = sim.particles["Mercury"].n
    sim.dt = 2 * np.pi / n / 50
    width = n * np.sqrt(3 * (MERCURY[1] - MERCURY[0]) / MERCURY[2] * (7 * E / 2 - 123 * E**3 / 16))
    return attach(sim, {"Mercury": Body(MERCURY, spin=(0, 0, 1.5 * n + rate * width))}), n, float(width)


def angle(spins: Spins, n: float) -> float:
    w, _, _, z = spins.orientation("Mercury")
    return float((2 * np.arctan2(z, w) - 1.5 * n * spins.sim.t + np.pi / 2) % np.pi - np.pi / 2)


def mercury(orbits: int = 100_000) -> dict[str, Any]:
    spins, n, width = resonance(0.5)
    momentum, energy = spins.angular_momentum(), spins.energy()
    largest = 0.0
    for _ in range(orbits // 7):  # 7 orbits: the libration takes 75
        spins.steps(7 * 50)
        largest = max(largest, abs(angle(spins, n)))
    change = np.linalg.norm(spins.angular_momentum() - momentum) / np.linalg.norm(momentum)
    found: dict[str, Any] = {
        "orbits": orbits // 7 * 7,
        "largest angle, degrees": round(float(np.degrees(largest)), 2),
        "of a pendulum": round(float(np.degrees(np.arcsin(0.5))), 2),  # sin(angle) = rate
        "change of angular momentum": short(change),
        "change of energy": short(abs(spins.energy() / energy - 1)),
    }
    spins, n, width = resonance(0.02)
    angles = []
    for _ in range(1500):
        spins.steps(50)
        angles.append(angle(spins, n))
    a = np.array(angles)
    up = np.nonzero((a[:-1] < 0) & (a[1:] >= 0))[0]
    times = up - a[up] / (a[up + 1] - a[up])
    found["period of libration, orbits"] = round(float((times[-1] - times[0]) / (len(times) - 1)), 3)
    found["by the formula"] = round(n / width, 3)
    held = []
    for rate in np.arange(0.9, 1.1, 0.01):
        spins, n, _ = resonance(float(rate))
        worst = 0.0
        for _ in range(300):
            spins.steps(50)
            worst = max(worst, abs(angle(spins, n)))
        held.append((float(rate), worst < 1.5))
    found["half width over the formula"] = round(max(rate for rate, kept in held if kept) + 0.005, 3)
    print("mercury", found, flush=True)
    return found


# -- the test of REBOUNDx ---------------------------------------------------------------------------------------


def tides() -> dict[str, Any]:
    """Its largest energy change in 1000 orbits; `orbit`: without the rotation, in parts of the energy of the orbit."""
    fast = [*rebound.spherical_to_xyz(magnitude=2 * np.pi / (3 / 365), theta=0.0, phi=np.radians(30))]
    near, two = {"m": 1e-3, "a": 0.05, "e": 0.1, "r": 5e-4}, {"m": 1.0, "a": 0.2, "e": 0.1, "r": 0.005}
    found = {}
    for name, other, which, love, spin, per in (
        ("star", near, 0, 0.04, [1e-2, 0, 0], 100),
        ("planet", near, 1, 0.4, [1e-10, 0, 0], 800),
        ("star of two", two, 0, 0.04, fast, 300),
        ("planet of two", two, 1, 0.04, fast, 300),
    ):
        sim = rebound.Simulation()
        sim.add(m=1.0, r=0.005)
        sim.add(**other)
        sim.move_to_com()
        sim.integrator, sim.dt = "whfast", sim.particles[1].P / per
        extras = reboundx.Extras(sim)
        extras.load_force("tides_spin")
        body = sim.particles[which]
        body.params["k2"], body.params["I"], body.params["Omega"] = love, 0.4, spin
        spins = attach(sim, {which: Body(0.4, spin=spin, love=love)})
        start, orbit, turning = spins.energy(), abs(sim.energy()), 0.2 * np.dot(spin, spin)
        worst = [0.0, 0.0]
        for _ in range(20):
            spins.steps(int(50.185 * per))
            sim.particles[which].params["Omega"] = list(spins.spin(which))
            energy = sim.energy() + extras.tides_spin_energy()
            rest = energy - 0.2 * np.square(spins.spin(which)).sum()
            worst = [max(worst[0], abs(energy / start - 1)), max(worst[1], abs(rest - start + turning) / orbit)]
        found[name] = {"steps an orbit": per, "its energy": short(worst[0]), "orbit": short(worst[1])}
        print(name, found[name], flush=True)
    return found


def main(arguments: list[str] | None = None) -> None:
    asked = parser(__doc__, "spin_orbit").parse_args(arguments)
    warnings.filterwarnings("ignore", message="tides_spin was updated")
    versions = {"rebound": rebound.__version__, "reboundx": reboundx.__version__}
    warnings.filterwarnings("ignore", message="REBOUNDx: Passing a velocity-dependent")
    results = {
        "moon": moon(),
        "cost": cost(),
        "parts": parts(),
        "order": order(),
        "mercury": mercury(),
        "tides": tides(),
    }
    write({"machine": {**machine(), **versions}, **results}, asked.output)


if __name__ == "__main__":
    main()
