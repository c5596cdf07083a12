"""Bodies of REBOUND simulations: the interaction, what it conserves, its order, resonance, restart, bad input."""

from __future__ import annotations

import copy
import io
import pickle
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rebound
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from clouds import G as CODATA, cloud, integrated
from kreisel import algebra
from kreisel.kernels.layout import MACHINE_EPSILON as EPS
from kreisel.physical import GravityBody
from kreisel.rebound import Body, Spins, attach, compiled, load
from rotors import closed_form
from support import cross, rotation_matrix

DAY, EARTH_RADIUS = 2 * np.pi / 365.25, 4.2635e-5  # G = 1, masses in that of the Sun, lengths in au
EARTH, MOON = 3.003e-6, 3.694e-8
INTEGRATORS = ("whfast", "leapfrog", "saba", "mercurius", "trace", "ias15", "bs")


def random_turn(draw: np.random.Generator) -> np.ndarray:
    return algebra.unit(draw.normal(size=4))


def triple(integrator: str, per: int = 60) -> Any:
    """A star, a planet near to it and another."""
    sim = rebound.Simulation()
    sim.add(m=1.0, r=0.05, name="star")
    sim.add(m=1e-3, a=1.0, e=0.2, inc=0.3, r=0.01, name="planet")
    sim.add(m=1e-3, a=3.0, e=0.1)
    sim.move_to_com()
    sim.integrator = integrator
    sim.dt = 2 * np.pi / per
    return sim


def attached(integrator: str, per: int = 60, **star: float) -> Spins:
    sim = triple(integrator, per)
    bodies = {
        "planet": Body(inertia=np.array([0.3, 0.35, 0.4]) * 1e-4, spin=(0.1, 0.3, 1.5)),
        0: Body(inertia=4e-3, spin=(0, 1, 3), radius=0.2, **{"love": 0.5, **star}),
    }
    return attach(sim, bodies, dt=sim.dt if integrator in ("ias15", "bs") else None)


def test_orientations_are_of_the_axes_in_which_the_tensor_was_given(tmp_path: Path) -> None:
    """Euler's equations in these axes, by SciPy: 1e-11.  The principal axes, returned before, are 0.2 off."""
    tensor, start = np.array([[3.0, 0.2, 0.1], [0.2, 4.0, -0.3], [0.1, -0.3, 4.5]]), np.array([0.8, 0.2, -0.4, 0.4])
    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(x=1e6)
    sim.integrator, sim.dt = "leapfrog", 0.5
    spins = attach(sim, {0: Body(inertia=tensor, spin=(0.5, 1.0, 3.0), orientation=start)})
    assert np.allclose(spins.orientation(0), start, atol=1e-15)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        q, W = y[:4], y[4:]
        turning = 0.5 * np.array([-q[1:] @ W, *(q[0] * W + cross(q[1:], W))])
        return np.concatenate([turning, np.linalg.solve(tensor, cross(tensor @ W, W))])

    spins.steps(20)
    spin = Rotation.from_quat(start, scalar_first=True).inv().apply((0.5, 1.0, 3.0))
    end = solve_ivp(rates, (0, 10.0), [*start, *spin], method="DOP853", rtol=1e-13, atol=1e-14).y[:4, -1]
    spins.save(tmp_path / "spins.npz")
    for each in (spins, load(tmp_path / "spins.npz"), copy.copy(spins)):
        q = each.orientation(0)
        assert min(abs(q - end).max(), abs(q + end).max()) < 1e-10


# -- the interaction -------------------------------------------------------------------------------------------


def kicked(bodies: dict[int, Body], points: Any, h: float = 1e-6, **fields: Any) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations by bodies alone of particles (m, place, velocity), and torques on the spins."""
    sim = rebound.Simulation()
    for m, x, v in points:
        sim.add(m=m, x=x[0], y=x[1], z=x[2], vx=v[0], vy=v[1], vz=v[2], r=1.0)
    sim.integrator, sim.dt, sim.gravity = "leapfrog", h, "none"
    spins = attach(changed(sim, **fields), bodies)
    v, L = spins._particles()[:, 3:6].copy(), [spins.spin_angular_momentum(i) for i in bodies]
    spins.steps(1)
    return (spins._particles()[:, 3:6] - v) / h, (np.array([spins.spin_angular_momentum(i) for i in bodies]) - L) / h


def of_point_masses(*clouds: Any) -> tuple[np.ndarray, np.ndarray]:
    """Forces and torques between clouds (m, places about the centre, centre), less the force of the two centres."""
    (m, x, a), (n, y, b) = clouds
    d = (b + y)[None] - (a + x)[:, None]
    pull = m[:, None, None] * n[:, None] * d / (d * d).sum(-1, keepdims=True) ** 1.5
    force = pull.sum((0, 1)) - m.sum() * n.sum() * (b - a) / np.linalg.norm(b - a) ** 3
    torques = np.cross(x, pull.sum(1)).sum(0), np.cross(y, -pull.sum(0)).sum(0)
    return np.array([force, -force]), np.array(torques)


CENTRE = np.ones(1), np.zeros((1, 3))


def slope_of(first: Any, second: Any, mutant: str = "", distances: Any = (40.0, 80.0)) -> tuple[float, float]:
    """The power of the distance with which relative errors of forces and torques between clouds fall, and the last."""
    draw = np.random.default_rng(1)
    way, errors = algebra.unit(draw.normal(size=3)), []
    turns = [random_turn(draw) for _ in range(2)]
    for distance in distances:
        bodies, clouds, points = {}, [], []
        for k, ((m, x), g, place) in enumerate(zip((first, second), turns, (np.zeros(3), distance * way), strict=True)):
            clouds.append((m, x @ algebra.rotation_matrix(g).T, place))
            points.append((m.sum(), place, np.zeros(3)))
            if len(m) > 1:
                body = GravityBody.points(m, x)
                if mutant == "strength" and not bodies:
                    body = replace(body, inertia=1.001 * body.inertia)
                bodies[k] = Body(body, orientation=algebra.inverse_turn(g) if mutant == "orientation" else g)
                if mutant == "degree":
                    bodies[k] = replace(bodies[k], degree_4=np.zeros(9))
        forces, torques = of_point_masses(*clouds)
        accelerations, turning = kicked(bodies, points)
        forces, torques = forces / [[m.sum()] for m, *_ in clouds], torques[sorted(bodies)]
        errors.append(
            max(np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in ((accelerations, forces), (turning, torques)))
        )
    return float(np.log2(errors[-2] / errors[-1])), errors[-1]


CLOUDS = cloud(3, 1.0, 1.0), cloud(4, 0.7, 0.8)


@pytest.mark.parametrize("second", [CENTRE, CLOUDS[1]], ids=["a point", "a body"])
def test_forces_and_torques_are_those_of_clouds_of_points_to_degree_four(second: Any) -> None:
    slope, error = slope_of(CLOUDS[0], second)
    assert abs(slope - 3) < 0.2 and error < 1e-4


@pytest.mark.parametrize("mutant", ["orientation", "strength", "degree"])
def test_mutants_of_the_force_are_seen(mutant: str) -> None:
    slope, _ = slope_of(CLOUDS[0], CLOUDS[1], mutant)
    assert slope < 2.3


BY_NEWTON: dict[float, np.ndarray] = {}  # last rows, by the size of the clouds


def on_orbit(size: float, mutant: bool, hours: float = 3.0) -> float:
    """The distance after some hours, m, of the first of two clouds from its place by Newton's law; a third is near."""
    clouds = [cloud(1, 3e11, size), cloud(2, 1e11, 0.8 * size), (np.array([1e11]), np.zeros((1, 3)))]
    speed = 0.9 * np.sqrt(CODATA * 4e11 / 1000.0)
    x = np.array([[0, 0, 0], [1000.0, 0, 0], [2000.0, 5000.0, 1000.0]])
    v = np.array([[0, 0, 0], [0, 0.8, 0.6], [-0.4, 0, 0.1]]) * speed
    sim = rebound.Simulation()
    sim.units = ("m", "s", "kg")
    sim.G, sim.integrator, sim.dt = CODATA, "whfast", 4.0
    for (m, _), place, motion in zip(clouds, x, v, strict=True):
        sim.add(m=m.sum(), **dict(zip(("x", "y", "z", "vx", "vy", "vz"), [*place, *motion], strict=True)))
    turns = np.array([4, 1, -2, 2]) / 5, np.array([1, 5, 3, 1]) / 6
    spins = attach(sim, {
        k: Body(GravityBody.points(*clouds[k]), (1e-4, 2e-4, -3e-4), g, degree_4=np.zeros(9) if mutant else None)
        for k, g in enumerate(turns)
    })  # fmt: skip
    first = np.zeros((3, 13))
    for k, row in enumerate(first):
        row[:6], row[9] = [*x[k], *v[k]], 1.0
        if k < 2:
            row[6:] = spins._state[k]
    spins.steps(round(hours * 900))
    apart = np.subtract(sim.particles[0].xyz, sim.particles[1].xyz)
    rows = BY_NEWTON[size] = BY_NEWTON[size] if size in BY_NEWTON else integrated(first, hours * 3600, clouds)
    return float(np.linalg.norm(apart - rows[0, :3] + rows[1, :3]))


def test_orbits_are_those_of_clouds_of_points_to_degree_four() -> None:
    """Against 63 attractions of points, by DOP853; without the terms of degree four the mutant."""
    assert on_orbit(8.0, mutant=False) < 1e-6
    errors, worse = ([on_orbit(size, mutant) for size in (16.0, 32.0)] for mutant in (False, True))
    assert np.log2(errors[1] / errors[0]) > 4.6 > 4.3 > np.log2(worse[1] / worse[0])


def test_moments_alone_are_the_second_degree() -> None:
    """J_2 and C_22 of six points at +- three arms; what is missing is of degree four."""
    arms = np.array([1.0, 0.6, 0.3])
    x, way = np.array([*np.diag(arms), *np.diag(-arms)]), algebra.unit(np.array([1.0, 2.0, -1.0]))
    errors = []
    for distance in (20, 40):
        force, _ = of_point_masses((np.full(6, 1 / 6), x, np.zeros(3)), (*CENTRE, distance * way))
        points = (1.0, np.zeros(3), np.zeros(3)), (1.0, distance * way, np.zeros(3))
        found, _ = kicked({0: Body((arms @ arms - arms**2) / 3)}, points)
        errors.append(np.linalg.norm(found - force) / np.linalg.norm(force))
    assert abs(np.log2(errors[0] / errors[1]) - 2) < 0.1 and errors[1] < 1e-2


def test_a_late_tide_is_one_raised_at_an_earlier_place() -> None:
    """The bulge that a mass at r' raised, -G m k R^5 (3 (u.u')^2 - 1)/(2 r^3 r'^3), r' = r - lag (v - Omega x r)."""
    draw = np.random.default_rng(2)
    r, v, W = draw.normal(size=3) + 2, draw.normal(size=3), draw.normal(size=3)
    m, tide, lag = 0.3, 0.2, 1e-5

    def pull(at: np.ndarray) -> np.ndarray:  # on a unit mass at r
        d, e, c = np.linalg.norm(r), np.linalg.norm(at), r @ at
        slope = 3 * c / d**5 * at - (15 * c**2 / (2 * d**7) - 1.5 * e**2 / d**5) * r
        return m * tide / e**5 * slope

    back = lag * (v - np.cross(W, r))
    wanted = (pull(r - back) - pull(r + back)) / 2
    points = (1.0, np.zeros(3), np.zeros(3)), (m, r, v)
    late, prompt = (kicked({0: Body(1.0, spin=W, love=tide, lag=1e5 * x)}, points, 1e-5) for x in (lag, 0.0))
    found = (late[0] - prompt[0])[1] / 1e5  # linear in the lag
    assert np.linalg.norm(found - wanted) < 1e-4 * np.linalg.norm(wanted)
    radial = wanted - 2 * (r @ wanted) / (r @ r) * r  # the mutant: another sign along r
    assert np.linalg.norm(found - radial) > 0.1 * np.linalg.norm(wanted)


def test_a_fluid_ball_keeps_the_length_of_its_spin() -> None:
    """The midpoint rule: -r x m a turns L about r."""
    points = (1.0, np.zeros(3), np.zeros(3)), (0.3, np.array([1.5, 2.0, 1.0]), np.zeros(3))
    L, fluid = np.array([0.3, -0.5, 0.4]), {0: Body(0.4, spin=np.array([0.3, -0.5, 0.4]) / 0.4, love=0.2)}
    torque = kicked(fluid, points, 1.0)[1][0]
    assert abs(np.linalg.norm(L + torque) / np.linalg.norm(L) - 1) < 16 * EPS and np.linalg.norm(torque) > 5e-4
    explicit = kicked(fluid, points, 1e-9)[1][0]
    assert np.linalg.norm(L + explicit) / np.linalg.norm(L) - 1 > 1e-7  # the mutant: Euler's rule


def test_kernels_are_the_formulas() -> None:
    spins = attached("leapfrog", lag=0.3)
    p, before, h = spins._particles(), spins._particles().copy(), spins.dt / 2
    states = spins._state.copy()
    pairs = spins._pairs(h)
    for kind, (i, j, *bodies), factors in pairs.rows:
        r, v = (before[j, k] - before[i, k] for k in (slice(3), slice(3, 6)))
        (L1, q1), (L2, q2) = ((states[k, :3], states[k, 3:]) for k in bodies)
        changes = np.reshape(kind.changes(r, v, L1, q1, L2, q2, **factors), (3, 3)).astype(float)
        before[i, 3:6] -= factors["into1"] * changes[0]
        before[j, 3:6] += factors["into2"] * changes[0]
        for k, n, torque in zip(bodies, "12", changes[1:], strict=True):
            states[k, :3] += factors[f"on{n}"] * torque
    start = p[:, 3:6].copy()
    spins._prepare(spins.dt, 1, False)
    compiled.compiled("before", pairs.kinds)(spins._frame.ctypes.data)
    assert np.allclose(p[:, 3:6], before[:, 3:6], rtol=1e-13, atol=1e-15) and abs(p[:, 3:6] - start).max() > 1e-9
    assert np.allclose(spins._state[:, :3], states[:, :3], rtol=1e-13)


@pytest.mark.parametrize("moments", [(0.3, 0.35, 0.4), (0.4, 0.4, 0.4)])
def test_bodies_without_masses_near_turn_freely(moments: tuple[float, ...]) -> None:
    """Of thirteen random bodies 1.4e-13 in the middle, 1.4e-12 at most: rounding, over 270 rad."""
    errors = []
    for spin in ((0.9, 1.1, 4.2), (-0.7, 1.2, 4.1), (3.0, 2.0, 1.5), (4.0, -0.5, 0.8), (-1.0, 3.5, 2.0)):
        sim = rebound.Simulation()
        sim.add(m=1.0)
        sim.add(x=1.0, vy=1.0)  # without a mass
        sim.integrator, sim.dt = "leapfrog", 3.0  # several turns a step
        spins = attach(sim, {0: Body(inertia=moments, spin=spin, orientation=(0.5, 0.5, 0.5, 0.5))})
        start, L = spins.orientation(0), spins.spin_angular_momentum(0)
        M = L @ algebra.rotation_matrix(start)
        spins.steps(20)
        if moments[0] == moments[2]:
            g = algebra.quaternion_product(start, algebra.turn(M / moments * 60.0, 9))
        else:
            _, g = closed_form(np.array(moments), M, start, 60.0, 40)
        pairs = list(zip(g, spins.orientation(0), strict=True))
        errors.append(min(max(abs(float(x - s * y)) for x, y in pairs) for s in (1, -1)))
        assert (spins.spin_angular_momentum(0) == L).all()
    assert np.median(errors) < 1e-12


# -- what is conserved, and to what order ----------------------------------------------------------------------


def momentum(spins: Spins) -> np.ndarray:
    p = spins._particles()
    return p[:, 9] @ p[:, 3:6]


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("lag", [0.0, 1e-3])
def test_momentum_and_angular_momentum(integrator: str, lag: float) -> None:
    spins = attached(integrator, lag=lag)
    L, before, spin = spins.angular_momentum(), momentum(spins), spins.spin_angular_momentum(0)
    spins.steps(600)
    bound = 1e-11 if integrator == "bs" else 1e-12  # its own error
    assert np.linalg.norm(spins.angular_momentum() - L) < bound * np.linalg.norm(L)
    assert abs(momentum(spins) - before).max() < 1e-14
    assert np.linalg.norm(spins.spin_angular_momentum(0) - spin) > 1e-6  # something was exchanged


@pytest.mark.parametrize(("name", "factor"), [("into1", 1.001), ("on1", 0.0), ("on1", -1.0), ("", 1.0)])
def test_each_interaction_has_its_reaction(name: str, factor: float) -> None:
    """Mutants: a reaction that is a thousandth too small, one on the spin that is not there, one with another sign."""
    spins = attached("leapfrog", lag=0.3)
    if name:
        spins._pairs(spins.dt / 2).factors[:, compiled.PLACES[name]] *= factor
    before = np.concatenate([momentum(spins), spins.angular_momentum()])
    spins.steps(1)
    change = abs(np.concatenate([momentum(spins), spins.angular_momentum()]) - before).max()
    assert change > 1e-10 if name else change < 1e-15


@pytest.mark.parametrize("integrator", ["whfast", "leapfrog", "ias15"])
def test_the_energy_is_of_order_two(integrator: str) -> None:
    errors = []
    for per in (40, 80, 160, 320):
        spins = attached(integrator, per)
        energy, worst = spins.energy(), 0.0
        for _ in range(24):
            spins.steps(per // 20)
            worst = max(worst, abs(spins.energy() - energy))
        errors.append(worst)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert abs(slopes[1:] - 2).max() < 0.15, slopes


TIDAL = {"inertia": np.array([0.02, 0.05, 0.06]), "love": 0.5, "lag": 4.0, "radius": 0.4}


def tidal(per: int) -> Spins:
    """A body of unequal moments and a mass near to it, whose tide is late."""
    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(m=0.3, a=1.0, e=0.1, inc=0.4)
    sim.move_to_com()
    sim.integrator, sim.dt = "whfast", 2.0 / per
    return attach(sim, {0: Body(spin=(0.5, 0.9, 1.2), orientation=(0.8, 0.2, 0.4, 0.4), **TIDAL)})


def by_the_published_equations(t_end: float) -> np.ndarray:
    """The spin of that body by an integrator for any equations, from MacCullagh's potential and Hut's forces."""
    spins = tidal(100)
    I, tide, lag = TIDAL["inertia"], TIDAL["love"] * TIDAL["radius"] ** 5, TIDAL["lag"]  # noqa: E741
    body, mass = (p.m for p in spins.sim.particles)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        r, v, W, q = y[:3], y[3:6], y[6:9], y[9:]  # of the mass against the body; W along the principal axes
        R = rotation_matrix(q)
        d, tensor, radial = np.linalg.norm(r), R @ np.diag(I) @ R.T, (v @ r) / (r @ r) * r
        pull = -body / d**3 * r - 1.5 * (np.trace(tensor) * r + 2 * tensor @ r - 5 * (r @ tensor @ r) / d**2 * r) / d**5
        pull -= 3 * mass * tide / d**8 * r
        pull -= 3 * mass * tide * lag / d**8 * (3 * radial + (v - radial) - cross(R @ W, r))
        torque = -cross(r, mass * pull) @ R
        turning = 0.5 * np.array([-q[1:] @ W, *(q[0] * W + cross(q[1:], W))])
        return np.concatenate([v, pull * (1 + mass / body), (torque - cross(W, I * W)) / I, turning])

    p = [np.array([*a.xyz, *a.vxyz]) for a in spins.sim.particles]
    g = spins.orientation(0)
    start = np.concatenate([p[1] - p[0], algebra.rotation_matrix(g).T @ spins.spin(0), g])
    end = solve_ivp(rates, (0, t_end), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return Rotation.from_quat(end[9:], scalar_first=True).apply(end[6:9])


def test_late_tides_on_unequal_moments_are_of_order_two() -> None:
    """The mean of the moments in the midpoint rule is the mutant: order 1."""
    wanted, errors = by_the_published_equations(2.0), []
    for per in (40, 80, 160, 320):
        spins = tidal(per)
        before = spins.spin(0), spins.angular_momentum()
        spins.steps(per)
        errors.append(np.linalg.norm(spins.spin(0) - wanted))
        assert np.linalg.norm(spins.angular_momentum() - before[1]) < 1e-13
    assert np.linalg.norm(wanted - before[0]) > 0.1
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert abs(slopes[1:] - 2).max() < 0.15, (slopes, errors)


def of_a_hierarchy(per: int) -> np.ndarray:
    """Spins of a planet and its moon, both with late tides, near to a star, where Jacobi's coordinates matter."""
    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(m=0.05, a=1.0, e=0.1, r=0.05)
    sim.add(m=0.02, a=0.12, e=0.2, inc=0.3, r=0.04, primary=sim.particles[1])
    sim.integrator, sim.dt = "whfast", 0.5 / per
    turned = {"spin": (0.5, 5, 9), "orientation": (0.8, 0.2, 0.4, 0.4)}
    bodies = {1: Body((2e-5, 5e-5, 6e-5), **turned, love=0.5, lag=0.03), 2: Body(2e-5, (3, -5, 14), love=0.9, lag=0.03)}
    spins = attach(sim, bodies)
    before = spins.angular_momentum()
    spins.steps(per)
    assert np.linalg.norm(spins.angular_momentum() - before) < 1e-14
    return np.concatenate([spins.spin(1), spins.spin(2)])


HIERARCHY: list[np.ndarray] = []  # in small steps


@pytest.mark.parametrize("mutant", ["", "velocities before the kick", "no terms of Jacobi", "one order of pairs"])
def test_late_tides_inside_a_step_are_of_order_two(mutant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three mutants are of order one."""
    if mutant:
        code, velocities, act = compiled.Code, compiled.Code._velocities, compiled.Code.act
        changes = {
            "velocities before the kick": ("_velocities", lambda self, inside: velocities(self, False)),
            "no terms of Jacobi": ("_undo_attraction", lambda *_: None),
            "one order of pairs": ("act", lambda self, backwards, inside: act(self, self.f.integer(0), inside)),
        }
        monkeypatch.setattr(code, *changes[mutant])
        monkeypatch.setattr(compiled, "compiled", lambda name, kinds: compiled.written(name, kinds, mutant))
    HIERARCHY[:] = HIERARCHY or [of_a_hierarchy(5120)]
    errors = [abs(of_a_hierarchy(per) - HIERARCHY[0])[3:].max() for per in (80, 160, 320)]
    slope = np.log2(errors[1] / errors[2])
    assert abs(slope - 2) < 0.1 if not mutant else slope < 1.5


def test_the_moon_recedes_and_the_day_gets_longer() -> None:
    """By 3.8 cm a year (laser ranging) and 2.3 ms a century (its tides), k_2 and lag of the Earth: Q = 12 of M2."""
    sim = rebound.Simulation()
    sim.units = ("m", "s", "kg")
    sim.add(m=5.9722e24, r=6.371e6)
    sim.add(m=7.346e22, a=3.844e8)
    sim.move_to_com()
    sim.integrator, n = "whfast", sim.particles[1].n
    sim.dt = 2 * np.pi / n / 40
    day = 86164.1
    lag = 1 / 12 / (2 * (2 * np.pi / day - n))
    spins = attach(sim, {0: Body(8.0e37, spin=(0, 0, 2 * np.pi / day), love=0.3, lag=lag)})
    total, a, spin = spins.angular_momentum(), sim.particles[1].a, spins.spin(0)[2]
    spins.steps(40 * 2000)
    years = sim.t / 3.156e7
    assert 0.02 < (sim.particles[1].a - a) / years < 0.06
    slower = day * (spin / spins.spin(0)[2] - 1) / years * 100 * 1e3  # ms a century
    assert 1 < slower < 4
    assert np.linalg.norm(spins.angular_momentum() - total) < 1e-12 * np.linalg.norm(total)


def oblate_earth(sim: Any, axis: Any = (0.0, 0.0, 1.0)) -> Spins:
    """The first particle as the Earth, C - A = J_2 m R^2, turning about its axis of the moment C."""
    m, R, J2 = 5.9722e24, 6.378137e6, 1.08263e-3
    A, C = (0.33070 - J2) * m * R**2, 0.33070 * m * R**2
    tilt = np.arctan2(axis[1], axis[2]) / 2
    g = (np.cos(tilt), -np.sin(tilt), 0.0, 0.0)  # the third axis of the body to `axis`, about x
    spin = 2 * np.pi / 86164.1 * np.asarray(axis)
    return attach(sim, {0: Body((A, A, C), spin=spin, orientation=g)})


@pytest.mark.parametrize(("height", "inclination", "rate"), [(700e3, 98.19, 360 / 365.2422), (410e3, 51.64, -5.0)])
def test_nodes_over_an_oblate_earth(height: float, inclination: float, rate: float) -> None:
    """The node of a sun-synchronous orbit goes east with the Sun, that of the space station west by 5 degrees a day."""
    sim = rebound.Simulation()
    sim.units = ("m", "s", "kg")
    sim.add(m=5.9722e24)
    sim.add(m=0.0, a=6.378137e6 + height, inc=np.radians(inclination), Omega=0.1)
    sim.integrator, sim.dt = "whfast", sim.particles[1].P / 40
    spins, nodes = oblate_earth(sim), []
    for _ in range(3):
        spins.integrate(sim.t + 86400.0)
        nodes.append(np.degrees(sim.particles[1].Omega) + 360 * (sim.particles[1].Omega < -1))
    assert np.diff(np.unwrap(nodes, period=360)).mean() == pytest.approx(rate, rel=0.03)


def test_the_sun_turns_the_axis_of_the_earth_westward() -> None:
    """Its part of the precession of the equinoxes: 15.9 seconds of arc a year, against the sense of the orbit."""
    sim = rebound.Simulation()
    sim.units = ("m", "s", "kg")
    sim.add(m=5.9722e24)
    sim.add(m=1.98847e30, a=1.495978707e11)
    sim.move_to_com()
    sim.integrator, sim.dt = "whfast", 3.15576e7 / 60
    tilt = np.radians(23.4393)
    spins = oblate_earth(sim, (0.0, -np.sin(tilt), np.cos(tilt)))
    spins.steps(600)
    x, y, _ = spins.spin_angular_momentum(0)
    years = sim.t / 3.15576e7
    azimuth = np.degrees(np.arctan2(x, -y)) * 3600  # eastward of -y
    assert azimuth / years == pytest.approx(-15.9, rel=0.03)


def test_late_tides_shrink_a_circle() -> None:
    """a'/a = -6 k q (1 + q) (R/a)^8 (G M lag/R^3) (1 - Omega/n) [Hut 1981]."""
    for spin in (0.0, 0.3):
        sim = rebound.Simulation()
        sim.add(m=1.0, r=0.2)
        sim.add(m=0.1, a=1.0)
        sim.move_to_com()
        sim.integrator = "whfast"
        n = sim.particles[1].n
        sim.dt = 2 * np.pi / n / 40
        spins = attach(sim, {0: Body(10.0, spin=(0, 0, spin * n), love=0.3, lag=0.008)})
        energies, sizes = [], []
        for _ in range(11):
            energies.append(spins.energy())
            sizes.append(sim.particles[1].a)
            spins.steps(4000)
        rate = 6 * 0.3 * 0.1 * 1.1 * 0.2**5 * 0.008 * (1 - spin)
        assert (np.diff(energies) < 0).all() and abs(np.log(sizes[0] / sizes[-1]) / (40000 * sim.dt * rate) - 1) < 0.03


def test_the_moon_of_a_tilted_orbit() -> None:
    """Sun, Earth and Moon, its orbit inclined by 60 degrees, tides that lag: case of the thread reboundx 172."""
    for integrator in ("whfast", "ias15"):
        sim = rebound.Simulation()
        sim.add(m=1.0)
        sim.add(m=EARTH, a=1.0, e=0.0167, r=EARTH_RADIUS, name="Earth")
        moon = {"a": 32 * EARTH_RADIUS, "e": 0.01, "inc": np.radians(60), "primary": sim.particles["Earth"]}
        sim.add(m=MOON, r=1.161e-5, name="Moon", **moon)
        sim.move_to_com()
        sim.integrator = integrator
        n = sim.particles["Moon"].orbit(primary=sim.particles["Earth"]).n
        sim.dt = 2 * np.pi / n / 60
        day, lag = 5 / 24 * DAY, 600 / 86400 * DAY
        axis = np.array([0, -np.sin(np.radians(60)), np.cos(np.radians(60))])
        bodies = {
            "Earth": Body(0.3308 * EARTH * EARTH_RADIUS**2, spin=(0, 0, 2 * np.pi / day), love=0.298, lag=lag),
            "Moon": Body(0.393 * MOON * 1.161e-5**2, spin=n * axis, love=0.024, lag=lag),
        }
        spins = attach(sim, bodies, dt=sim.dt if integrator == "ias15" else None)
        L, earth = spins.angular_momentum(), spins.spin_angular_momentum("Earth")
        spins.steps(60 * 100)
        assert np.linalg.norm(spins.angular_momentum() - L) < 1e-12 * np.linalg.norm(L)
        lost = np.linalg.norm(spins.spin_angular_momentum("Earth") - earth) / np.linalg.norm(earth)
        assert 1e-6 < lost < 1e-2  # to the orbit of the Moon


# -- Mercury ---------------------------------------------------------------------------------------------------

E, J2, C22, C = 0.2056, 5.03e-5, 8.09e-6, 0.346  # Smith 2012, Margot 2012
MERCURY = np.array([C - J2 - 2 * C22, C - J2 + 2 * C22, C]) * 1.66e-7 * 1.631e-5**2


def resonance(rate: float) -> tuple[Spins, float, float]:
    """Mercury from its perihelion; `rate`: of the angle against 3:2 resonance there, in parts of the half width."""
    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(m=1.66e-7, a=0.387, e=E, name="Mercury")
    sim.move_to_com()
    sim.integrator = "whfast"
    n = sim.particles["Mercury"].n
    sim.dt = 2 * np.pi / n / 50
    A, B, third = MERCURY
    width = n * np.sqrt(3 * (B - A) / third * (7 * E / 2 - 123 * E**3 / 16))  # Murray Dermott 1999, chapter 5
    return attach(sim, {"Mercury": Body(MERCURY, spin=(0, 0, 1.5 * n + rate * width))}), n, width


def angles(spins: Spins, n: float, orbits: int) -> np.ndarray:
    """The angle of the longest axis less 3/2 of the mean anomaly, at each perihelion."""
    out = []
    for _ in range(orbits):
        spins.steps(50)
        w, _, _, z = spins.orientation("Mercury")
        out.append((2 * np.arctan2(z, w) - 1.5 * n * spins.sim.t + np.pi / 2) % np.pi - np.pi / 2)
    return np.array(out)


def test_mercury_librates_in_its_resonance() -> None:
    spins, n, width = resonance(0.05)
    angle = angles(spins, n, 310)
    rising = np.nonzero((angle[:-1] < 0) & (angle[1:] >= 0))[0]
    crossings = rising - angle[rising] / (angle[rising + 1] - angle[rising])
    period = np.diff(crossings).mean()
    assert len(crossings) == 4 and abs(period * width / n - 1) < 0.01 and abs(angle).max() < 0.06


@pytest.mark.parametrize(("rate", "held"), [(0.95, True), (-0.95, True), (1.05, False), (-1.05, False)])
def test_the_width_of_the_resonance(rate: float, held: bool) -> None:
    spins, n, _ = resonance(rate)
    assert (abs(angles(spins, n, 250)).max() < 1.45) == held


# -- a run as a user has it ------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_saved_and_loaded_bit_for_bit(integrator: str, tmp_path: Path) -> None:
    straight = attached(integrator, lag=1e-3)
    straight.steps(30)
    straight.steps(40)
    begun = attached(integrator, lag=1e-3)
    begun.steps(30)
    begun.save(tmp_path / "run.npz")
    again = load(tmp_path / "run.npz")
    again.steps(40)
    begun.steps(40)
    for other in (again, begun):
        assert other.sim.t == straight.sim.t and other.names == straight.names
        assert (other._particles()[:, :6] == straight._particles()[:, :6]).all()
        assert (other._state == straight._state).all()
    assert [*tmp_path.iterdir()] == [tmp_path / "run.npz"]


def test_times() -> None:
    spins = attached("whfast")
    spins.integrate(10.0)
    assert 10 <= spins.sim.t < 10 + spins.dt
    before = spins.sim.t
    spins.integrate(before)
    assert spins.sim.t == before
    energy = spins.energy()
    spins.sim.dt = -spins.sim.dt
    spins.integrate(0.0)
    start = attached("whfast")
    assert abs(spins.sim.t) < 1e-12 and abs(spins.energy() - start.energy()) < 1e-12 * abs(energy)
    assert np.allclose(spins.spin("planet"), (0.1, 0.3, 1.5), atol=1e-11)


@pytest.mark.parametrize("change", ["place", "mass", "acting"])
def test_what_the_user_changes_between_steps_counts(change: str, tmp_path: Path) -> None:
    """WHFast's own coordinates are made again."""
    runs = []
    for between in (False, True):
        spins = attached("whfast")
        spins.steps(20)
        if between:  # a new simulation of the same state knows nothing of the coordinates
            spins.save(tmp_path / "run.npz")
            spins = load(tmp_path / "run.npz")
        if change == "place":
            spins.sim.particles[2].x += 0.1
        elif change == "mass":
            spins.sim.particles[2].m *= 2
        else:
            spins.sim.N_active, spins.sim.testparticle_hidewarnings = 2, 1
        spins.steps(20)
        runs.append(spins._particles()[:, :6].copy())
    assert (runs[0] == runs[1]).all()


@pytest.mark.parametrize("integrator", ["whfast", "leapfrog"])
def test_functions_of_the_user_are_called_too(integrator: str) -> None:
    """A force on the outer planet; a heartbeat sees particles and spins at the same time."""
    spins, calls, seen = attached(integrator), [], []

    def force(pointer: Any) -> None:
        spins._particles()[2, 8] += 1e-3
        calls.append("force")

    spins.sim.additional_forces = force
    for hook in ("pre_timestep_modifications", "post_timestep_modifications", "heartbeat"):
        before = spins._particles()[2, 5]
        spins.steps(10)
        assert spins._particles()[2, 5] - before == pytest.approx(1e-3 * 10 * spins.dt, rel=0.2)
        if hook == "heartbeat":
            spins.sim.heartbeat = lambda _: seen.append(spins._state.copy())
        else:
            setattr(spins.sim, hook, lambda _, hook=hook: calls.append(hook))
    spins.steps(3)
    assert calls.count("force") == 33 and {*calls} >= {"pre_timestep_modifications", "post_timestep_modifications"}
    assert (seen[-1] == spins._state).all() and not (seen[0] == seen[-1]).all()


def test_without_safe_mode_the_same() -> None:
    one, two = attached("whfast"), attached("whfast")
    two.sim.integrator.safe_mode = 0
    for spins in (one, two):
        spins.steps(50)
    assert np.allclose(one._z, two._z, rtol=1e-12) and one.sim.t == two.sim.t


def test_bodies_of_the_physical_package_and_tensors() -> None:
    tensor = [[0.35, 0.01, 0], [0.01, 0.3, 0], [0, 0, 0.4]]
    sim = triple("whfast")
    spins = attach(
        sim, {1: Body(kr.physical.FreeBody(tensor), spin=(0.2, 0.1, 1)), 2: Body(tensor, spin=(0.2, 0.1, 1))}
    )
    for k in (1, 2):
        assert np.allclose(spins.spin(k), (0.2, 0.1, 1), atol=1e-15)
        assert np.allclose(spins.spin_angular_momentum(k), np.array(tensor) @ (0.2, 0.1, 1), atol=1e-15)


def test_a_test_particle_feels_and_does_not_act() -> None:
    paths = []
    for bodies in ({"star": Body(1e-2)}, {"star": Body((1e-2, 1e-2, 1.8e-2))}):
        sim = triple("leapfrog")
        sim.add(a=0.5)
        spins = attach(sim, bodies)
        spins.steps(100)
        p = spins._particles()
        paths.append((p[3, :3].copy(), spins.angular_momentum()))
    assert np.linalg.norm(paths[0][0] - paths[1][0]) > 1e-4
    assert np.linalg.norm(paths[0][1] - paths[1][1]) < 1e-13


def with_test_body(m: float, figure: Any = (0.3, 0.35, 0.4)) -> Spins:
    """A small body about a star and a planet with tides; its moments are per mass if it has none."""
    sim = triple("whfast")
    sim.add(m=m, a=0.4, e=0.1, inc=0.2)
    body = Body(1e-2 * np.array(figure) * (m or 1.0), spin=(1.0, 2.0, 5.0))
    spins = attach(sim, {3: body, "star": Body((4e-3, 4e-3, 5e-3), spin=(0, 1, 3), radius=0.2, love=0.5)})
    spins.steps(300)
    return spins


def test_a_test_particle_as_a_body_is_the_limit_of_a_small_one() -> None:
    """It moves nothing: to the last bit."""
    none, small, ball = with_test_body(0.0), with_test_body(1e-14), with_test_body(0.0, (0.3, 0.3, 0.3))
    assert np.allclose(none.spin(3), small.spin(3), rtol=0, atol=1e-7)
    assert np.allclose(none._particles()[:, :6], small._particles()[:, :6], rtol=0, atol=1e-9)
    assert np.linalg.norm(none.spin(3) - ball.spin(3)) > 0.1  # torques
    assert np.linalg.norm(none._particles()[3, :3] - ball._particles()[3, :3]) > 1e-3  # forces
    assert (none._particles()[:3, :6] == ball._particles()[:3, :6]).all() and (
        none.spin("star") == ball.spin("star")
    ).all()
    assert none.energy() == ball.energy() and (none.angular_momentum() == ball.angular_momentum()).all()


def test_bodies_of_the_physical_package_bring_their_integrals_tides_and_mass() -> None:
    body = GravityBody.ellipsoid(1e-3, (0.2, 0.16, 0.1), love=0.3, lag=1e-3)
    fields = {"degree_3": body.degree_3, "degree_4": body.degree_4, "love": 0.3, "lag": 1e-3, "radius": 0.1}
    spins = [attach(triple("whfast"), {"planet": x}) for x in (Body(body), Body(body.inertia, **fields))]
    assert (spins[0]._c == spins[1]._c).all() and body.degree_4.any()
    sim = triple("whfast")
    sim.add(a=0.4)
    ellipsoid = GravityBody.ellipsoid(1e-3, (0.2, 0.16, 0.1))
    massless = attach(sim, {3: Body(ellipsoid, spin=(0, 0, 1))})
    assert np.allclose(massless._c[0, :3], body.inertia / 1e-3, rtol=1e-14)
    assert np.allclose(massless.spin(3), (0, 0, 1), atol=1e-14)


def test_a_massless_moon_librates_in_its_resonance() -> None:
    """At n sqrt(3 (B - A)/C) [Murray Dermott 1999, 5.53]."""
    moments = np.array([1.0, 1.01, 1.015])
    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(a=1.0)
    sim.integrator, sim.dt = "whfast", 2 * np.pi / 60
    spins = attach(sim, {1: Body(moments * 1e-6, spin=(0, 0, 1.0 + 1e-3))})
    rate, found = np.sqrt(3 * (moments[1] - moments[0]) / moments[2]), []
    for _ in range(400):
        spins.steps(6)
        w, _, _, z = spins.orientation(1)
        found.append((2 * np.arctan2(z, w) - sim.t + np.pi / 2) % np.pi - np.pi / 2)
    times = 6 * sim.dt * np.arange(1, 401)
    assert np.allclose(found, 1e-3 / rate * np.sin(rate * times), atol=2e-5)


@pytest.mark.parametrize("kind", [0, 1])
def test_particles_that_act_only_on_active_ones(kind: int) -> None:
    """With testparticle_type 1 all momentum is conserved; with 0 the active ones feel nothing of the others."""
    states = []
    for moments in ((1e-5, 2e-5, 2.5e-5), (1e-5, 1e-5, 1e-5)):
        sim = changed(triple("whfast"), N_active=1, testparticle_type=kind, testparticle_hidewarnings=1)
        spins = attach(sim, {i: Body(np.array(moments), spin=(0.2, 0.5, 1), love=0.3, radius=0.05) for i in (1, 2)})
        before = momentum(spins), spins.angular_momentum()
        spins.steps(100)
        states.append(spins._particles()[0, :6].copy())
        change = np.linalg.norm(momentum(spins) - before[0]), np.linalg.norm(spins.angular_momentum() - before[1])
        assert max(change) < 1e-14 if kind else max(change) > 1e-7
    assert (states[0] == states[1]).all() == (kind == 0)


def test_a_flyby_on_a_hyperbola() -> None:
    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(m=1e-3, a=-1.0, e=1.5, f=-2.0, name="guest")
    sim.move_to_com()
    sim.integrator, sim.dt = "whfast", 0.01
    spins = attach(sim, {"guest": Body((3e-6, 4e-6, 5e-6), spin=(0, 0.5, 1))})
    L, energy = spins.angular_momentum(), spins.energy()
    spins.integrate(10)
    assert sim.particles["guest"].orbit().e > 1.4
    assert np.linalg.norm(spins.angular_momentum() - L) < 1e-13 and abs(spins.energy() - energy) < 1e-8


# -- bad input -------------------------------------------------------------------------------------------------


def changed(sim: Any, **fields: Any) -> Any:
    for name, value in fields.items():
        setattr(sim, name, value)
    return sim


def variational(sim: Any) -> Any:
    sim.add_variation()
    return sim


def archived(sim: Any, path: Path) -> Any:
    sim.save_to_file(str(path / "own.bin"), step=5)
    return sim


BALL = Body(inertia=1e-3)
BAD: dict[str, tuple[Callable[[Any, Path], Any], str]] = {
    "no simulation": (lambda sim, path: attach(None, {0: BALL}), "expected a rebound.Simulation, got None"),
    "no bodies": (lambda sim, path: attach(sim, {}), "expected {index or name"),
    "no body": (lambda sim, path: attach(sim, {0: (1, 2, 3)}), "expected {index or name"),
    "twice": (lambda sim, path: attach(sim, {0: BALL, "star": BALL}), "each particle once"),
    "no such name": (lambda sim, path: attach(sim, {"plant": BALL}), "Did you mean 'planet'"),
    "no such index": (lambda sim, path: attach(sim, {7: BALL}), "an index below 3 or the name of a particle"),
    "no mass": (
        lambda sim, path: attach(changed(sim.particles[1], m=0.0) and sim, {1: Body(1, love=0.3)}),
        "a mass > 0 for a body with tides",
    ),
    "other axes": (
        lambda sim, path: attach(sim, {0: Body([[3, 1, 0], [1, 3, 0], [0, 0, 3]], degree_3=np.ones(7))}),
        "degree_3, degree_4: expected principal axes",
    ),
    "other mass": (
        lambda sim, path: attach(sim, {1: Body(GravityBody.ellipsoid(2e-3, (2, 2, 1)))}),
        "expected a body with the mass 0.001 of its particle, got 0.0",
    ),
    "seven values": (lambda sim, path: attach(sim, {0: Body(1, degree_3=[1, 2])}), "degree_3"),
    "triangle": (lambda sim, path: attach(sim, {0: Body((1, 1, 3))}), "No body has the principal moments"),
    "a rod": (lambda sim, path: attach(sim, {0: Body((1, 1, 0))}), "three moments > 0"),
    "a rate": (lambda sim, path: attach(sim, {0: Body(1, spin=3.0)}), "an angular velocity"),
    "words": (lambda sim, path: attach(sim, {0: Body(1, spin="fast")}), "an angular velocity"),
    "no turn": (lambda sim, path: attach(sim, {0: Body(1, orientation=(1, 1, 0, 0))}), "unit quaternions"),
    "love": (lambda sim, path: attach(sim, {0: Body(1, love=-1)}), "love: expected a finite number >= 0"),
    "lag": (lambda sim, path: attach(sim, {0: Body(1, lag=1)}), "lag: expected 0 for a body without tides"),
    "radius": (lambda sim, path: attach(sim, {2: Body(1, love=0.3)}), "radius: expected a number > 0"),
    "G": (lambda sim, path: attach(changed(sim, G=0.0), {0: BALL}), "sim.G: expected a number > 0"),
    "ias15": (lambda sim, path: attach(changed(sim, integrator="ias15"), {0: BALL}), "the time between two kicks"),
    "dt": (lambda sim, path: attach(sim, {0: BALL}, dt=0.1), "else None and sim.dt"),
    "no dt": (lambda sim, path: attach(changed(sim, dt=0.0), {0: BALL}), "a finite number that is not 0"),
    "words for dt": (lambda sim, path: attach(changed(sim, integrator="bs"), {0: BALL}, dt="1 d"), "got '1 d'"),
    "janus": (lambda sim, path: attach(changed(sim, integrator="janus"), {0: BALL}), "sim.integrator: expected one of"),
    "variations": (lambda sim, path: attach(variational(sim), {0: BALL}), "no variational particles"),
    "boundary": (lambda sim, path: attach(changed(sim, boundary="periodic"), {0: BALL}), "sim.boundary: expected"),
    "archive": (lambda sim, path: attach(archived(sim, path), {0: BALL}), "Use spins.save"),
    "backwards": (lambda sim, path: attach(sim, {0: BALL}).integrate(-1.0), "the sign of dt"),
    "no time": (lambda sim, path: attach(sim, {0: BALL}).integrate(np.nan), "expected a time"),
    "words for t": (lambda sim, path: attach(sim, {0: BALL}).integrate("later"), "got 'later'"),
    "half a step": (lambda sim, path: attach(sim, {0: BALL}).steps(0.5), "an integer from"),
    "other body": (lambda sim, path: attach(sim, {"star": BALL}).spin("stat"), "Did you mean 'star'"),
    "no simulation or bodies": (lambda sim, path: attach(), "attach: expected sim, bodies, got none"),
    "a misspelt body": (
        lambda sim, path: Body(1, love_number=0.3),
        "no argument 'love_number'. Did you mean 'love'",
    ),
    "a misspelt step": (
        lambda sim, path: attach(sim, {0: BALL}, dts=0.1),
        "no argument 'dts'. Did you mean 'dt'",
    ),
    "no end": (lambda sim, path: attach(sim, {0: BALL}).integrate(), "expected t, got none"),
    "no path": (lambda sim, path: load(), "load: expected path, got none"),
    "no file": (lambda sim, path: load(__file__), "expected a file that spins.save wrote"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case: str, tmp_path: Path) -> None:
    act, message = BAD[case]
    with pytest.raises(kr.InputError) as caught:
        act(triple("whfast"), tmp_path)
    assert message in str(caught.value)


def test_unsynchronized_particles_are_refused() -> None:
    sim = triple("whfast")
    sim.integrator.safe_mode, sim.integrator.keep_unsynchronized = 0, 1
    with pytest.raises(kr.InputError, match="keep_unsynchronized: expected 0"):
        attach(sim, {0: BALL})


def test_particles_at_other_indices_are_noticed() -> None:
    """A removal and an addition keep the count; the planet's body would act on another particle."""
    sim = triple("whfast")
    spins = attach(sim, {"planet": Body(inertia=1e-4)})
    sim.remove(0)
    sim.add(m=1.0)
    with pytest.raises(kr.RunError, match="expected the particle 'planet' at its index 1"):
        spins.steps(1)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda spins: pickle.loads(pickle.dumps(spins))])
def test_copies_run_alone(copied: Any) -> None:
    spins = attached("whfast")
    spins.steps(3)
    other = copied(spins)
    other.steps(5)
    assert spins.sim.t == pytest.approx(3 * spins.dt)
    spins.steps(5)
    assert (other.spin("planet") == spins.spin("planet")).all()
    assert (other.orientation(0) == spins.orientation(0)).all()


def test_names_that_rebound_exchanges_are_restored(tmp_path: Path) -> None:
    """REBOUND 5.2 does so if names of a new simulation are where names of an old one were; here in its bytes."""
    spins, path = attached("whfast"), tmp_path / "run.npz"
    spins.save(path)
    with np.load(path) as file:
        parts = dict(file)
    for particle, name in zip(spins.sim.particles, ("planet", "planet"), strict=False):
        particle.name = name
    np.savez(path, **{**parts, "simulation": np.frombuffer(spins.sim.__reduce__()[1][0], dtype=np.uint8)})
    again = load(path)
    assert [p.name for p in again.sim.particles] == ["star", "planet", None] and again._index.tolist() == [1, 0]


def test_lost_particles_are_noticed() -> None:
    spins = attached("leapfrog")
    spins.sim.remove(2)
    with pytest.raises(kr.RunError, match="expected the 3 particles that there were, got 2"):
        spins.steps(1)


@pytest.mark.parametrize("integrator", ["leapfrog", "ias15"])
@pytest.mark.parametrize("resolve", ["merge", "halt"])
def test_collisions_end_the_run(integrator: str, resolve: str) -> None:
    sim = rebound.Simulation()
    sim.add(m=1.0, r=0.1)
    sim.add(m=0.1, x=2.0, r=0.1, name="falling")
    sim.integrator, sim.dt = integrator, 0.01
    sim.collision, sim.collision_resolve = "direct", resolve
    spins = attach(sim, {"falling": Body(1e-4)}, dt=0.01 if integrator == "ias15" else None)
    with pytest.raises((kr.RunError, rebound.Collision)):
        spins.integrate(10.0)
    assert 1 < sim.t < 3


def test_states_that_are_no_numbers_end_the_run() -> None:
    spins = attached("leapfrog")
    spins.sim.particles[2].x = np.nan
    with pytest.raises(kr.RunError, match="expected finite positions"):
        spins.steps(10)


def test_turns_in_other_units_end_the_run() -> None:
    sim = triple("leapfrog")
    spins = attach(sim, {0: Body(1e-3, spin=(0, 0, 1e9))})
    with pytest.raises(kr.RunError, match="a spin in other units"):
        spins.steps(1)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    spins = attached("leapfrog")
    with pytest.raises(kr.RunError, match="could not be written"):
        spins.save(tmp_path / "none" / "run.npz")
    with pytest.raises(kr.RunError, match="could not be read"):
        load(tmp_path / "none.npz")


def test_broken_files(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    attached("leapfrog").save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(kr.InputError, match=r"expected a file that spins.save wrote"):
        load(path)
    with np.load(io.BytesIO(whole)) as file:
        parts = dict(file)
    np.savez(path, **{**parts, "z": parts["z"][:, :5]})
    with pytest.raises(kr.InputError, match=r"expected format 4"):
        load(path)
    np.savez(path, **{**parts, "simulation": parts["simulation"][:50]})
    with pytest.raises(kr.RunError, match="REBOUND could not read"):
        load(path)


def test_without_rebound(monkeypatch: pytest.MonkeyPatch) -> None:
    from kreisel.rebound import spins

    spins.rebound.cache_clear()
    monkeypatch.setitem(sys.modules, "rebound", None)
    try:
        with pytest.raises(kr.InputError, match=r"pip install 'kreisel\[rebound\]'"):
            kr.rebound.attach(None, {})
    finally:
        spins.rebound.cache_clear()
