"""Tides of REBOUND's bodies against `tides_spin` of REBOUNDx: forces, and the cases of its own test of conservation."""

from __future__ import annotations

from ctypes import byref
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
import rebound

from kreisel.rebound import Body, Spins, attach

pytestmark = [
    pytest.mark.skipif(find_spec("reboundx") is None, reason="REBOUNDx was not built: no C compiler"),
    pytest.mark.filterwarnings("ignore:tides_spin was updated"),
]
SPIN = (0.4, -0.3, 1.9)


def tides(sim: Any, which: int, acting: bool, **parameters: Any) -> Any:
    """REBOUNDx on a simulation, its force added or only its parameters."""
    import reboundx

    extras = reboundx.Extras(sim)
    force = extras.load_force("tides_spin")
    if acting:
        extras.add_force(force)
    for name, value in parameters.items():
        sim.particles[which].params[name] = value
    if acting:
        extras.initialize_spin_ode(force)
    return extras


def accelerations(tau: float) -> tuple[np.ndarray, Any]:
    """Of two particles by tides of the first, and the simulation."""
    total = []
    for acting in (True, False):
        sim = rebound.Simulation()
        sim.add(m=1.0, r=0.3)
        sim.add(m=0.2, a=1.0, e=0.3, f=1.1, inc=0.4)
        extras = tides(sim, 0, acting, k2=0.3, I=0.03, Omega=list(SPIN), tau=tau)
        rebound.clibrebound.reb_simulation_update_acceleration(byref(sim))
        total.append(np.array([[p.ax, p.ay, p.az] for p in sim.particles]))
        del extras
    return total[0] - total[1], sim


def by_kicks(lag: float, h: float = 1e-5) -> np.ndarray:
    """Those accelerations in a short step."""
    _, sim = accelerations(0.0)
    sim.integrator, sim.dt, sim.gravity = "leapfrog", h, "none"
    before = np.array([p.vxyz for p in sim.particles])
    attach(sim, {0: Body(0.03, spin=SPIN, love=0.3, lag=lag)}).steps(1)
    return (np.array([p.vxyz for p in sim.particles]) - before) / h


def test_forces_are_those_of_tides_spin() -> None:
    """REBOUNDx 5.1 has twice the friction of a tide that lags by tau: its energy has the tide G m^2 k R^5/(2 r^6)."""
    prompt, late = (accelerations(tau)[0] for tau in (0.0, 0.05))
    still, lagging = by_kicks(0.0), by_kicks(2 * 0.05)
    for wanted, found in ((prompt, still), (late - prompt, lagging - still)):
        assert np.linalg.norm(found - wanted) < 1e-4 * np.linalg.norm(wanted)
    assert np.linalg.norm(prompt[1]) > 1e-3 and np.linalg.norm(late - prompt) > 1e-5


def of_harmonics(J2: float, J4: float, by_rebound: bool, h: float = 1e-4) -> np.ndarray:
    """Accelerations of a body with J_2 and J_4 and of a mass, at rest, by its figure."""
    import reboundx

    sim, R, m = rebound.Simulation(), 0.3, 1.2
    sim.add(m=m)
    sim.add(m=0.2, x=0.7, y=-0.5, z=0.9)
    sim.integrator, sim.dt, sim.gravity = "leapfrog", h, "none"
    if by_rebound:
        extras = reboundx.Extras(sim)
        extras.add_force(extras.load_force("gravitational_harmonics"))
        for name, value in {"J2": J2, "J4": J4, "R_eq": R}.items():
            sim.particles[0].params[name] = value
        sim.steps(1)
    else:
        moments = m * R**2 * np.array([0.4 - J2, 0.4 - J2, 0.4])
        attach(sim, {0: Body(moments, degree_4=[-J4 * m * R**4, *np.zeros(8)])}).steps(1)
    return np.array([p.vxyz for p in sim.particles]) / h


@pytest.mark.parametrize(("J2", "J4"), [(0.02, 0.0), (0.02, 0.03)])
def test_figures_are_those_of_gravitational_harmonics(J2: float, J4: float) -> None:
    wanted, found = (of_harmonics(J2, J4, by_rebound) for by_rebound in (True, False))
    assert np.linalg.norm(found - wanted) < 1e-6 * np.linalg.norm(wanted) and np.linalg.norm(wanted) > 1e-5
    mutant = of_harmonics(J2, -J4, False) if J4 else of_harmonics(-J2, J4, False)
    assert np.linalg.norm(mutant - wanted) > 0.01 * np.linalg.norm(wanted)


CASES: dict[str, tuple[dict[str, float], dict[str, float], int, float, Any, int]] = {  # of its test_tides_spin.py
    "star": ({"r": 0.005}, {"m": 1e-3, "a": 0.05, "e": 0.1, "r": 5e-4}, 0, 0.04, (1e-2, 0, 0), 100),
    "planet": ({"r": 0.005}, {"m": 1e-3, "a": 0.05, "e": 0.1, "r": 5e-4}, 1, 0.4, (1e-10, 0, 0), 800),
    "star of two": ({"r": 0.005}, {"m": 1.0, "a": 0.2, "e": 0.1, "r": 0.005}, 0, 0.04, "fast", 300),
    "planet of two": ({"r": 0.005}, {"m": 1.0, "a": 0.2, "e": 0.1, "r": 0.005}, 1, 0.04, "fast", 300),
}


def case(name: str, per: int) -> tuple[Spins, Any, int, float]:
    """Spins, REBOUNDx's parameters of the same body, which body it is, and the period."""
    star, other, which, love, spin, _ = CASES[name]
    sim = rebound.Simulation()
    sim.add(m=1.0, **star)
    sim.add(**other)
    sim.move_to_com()
    sim.integrator = "whfast"
    period = sim.particles[1].P
    sim.dt = period / per
    if spin == "fast":
        spin = [*rebound.spherical_to_xyz(magnitude=2 * np.pi / (3 / 365), theta=0.0, phi=np.radians(30))]
    extras = tides(sim, which, False, k2=love, I=0.4, Omega=list(spin))
    return attach(sim, {which: Body(0.4, spin=spin, love=love)}), extras, which, period


def its_energy(spins: Spins, extras: Any, which: int) -> float:
    spins.sim.particles[which].params["Omega"] = list(spins.spin(which))
    return float(spins.sim.energy() + extras.tides_spin_energy())


def worst_changes(spins: Spins, extras: Any, which: int, steps: int) -> tuple[float, float]:
    """Of its energy, relative; and of what is not rotation, in parts of the energy of the orbit."""

    def energies() -> tuple[float, float]:
        whole = its_energy(spins, extras, which)
        return whole, whole - 0.2 * float(np.square(spins.spin(which)).sum())

    start, orbit = energies(), abs(spins.sim.energy())
    worst = [0.0, 0.0]
    for _ in range(10):
        spins.steps(int(0.10037 * steps))  # at all phases
        now = energies()
        worst = [max(worst[0], abs(now[0] / start[0] - 1)), max(worst[1], abs(now[1] - start[1]) / orbit)]
    return worst[0], worst[1]


@pytest.mark.parametrize("name", CASES)
def test_its_cases_of_conservation_in_its_own_energy(name: str) -> None:
    """1000 orbits, to 1e-12 as there.  Most of its energy of two stars is rotation, which does not change."""
    per = CASES[name][-1]
    spins, extras, which, period = case(name, per)
    start = its_energy(spins, extras, which)
    assert abs(start - spins.energy()) < 1e-14 * abs(start)
    whole, orbit = worst_changes(spins, extras, which, 1000 * per)
    assert whole < 1e-12 and orbit < 5e-11
    assert spins.sim.t > 999 * period and abs(spins.sim.particles[1].pomega) > 1e-6


def test_another_tide_does_not_conserve_its_energy() -> None:
    """The mutant: k_2 is a tenth larger."""
    spins, extras, which, _ = case("planet", 40)
    spins.sim.particles[which].params["k2"] = 0.36
    assert worst_changes(spins, extras, which, 410)[0] > 1e-10
