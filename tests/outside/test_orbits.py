"""Orbits: elements to vectors by REBOUND, periods and directions that anyone can check."""

from __future__ import annotations

import numpy as np
import pytest
import rebound

from kreisel.physical import SUN, Orbit

ORBITS = {
    "round": Orbit("7000 km"),
    "sun-synchronous": Orbit("7000 km", 1e-3, "97.9 deg", "35 deg", "270 deg"),
    "Molniya": Orbit("26600 km", 0.72, "63.4 deg", "-120 deg", "280 deg"),
    "retrograde": Orbit("9000 km", 0.2, "150 deg", "300 deg", "10 deg"),
    "asteroid": Orbit("2.5 au", 0.6288, "0.47 deg", "124 deg", "278 deg", SUN),
}


def about(orbit: Orbit) -> rebound.Simulation:
    """The primary alone."""
    sim = rebound.Simulation()
    sim.G = 1.0
    sim.add(m=orbit.primary.mu)
    return sim


@pytest.mark.parametrize("name", ORBITS)
def test_vectors_of_elements(name: str) -> None:
    """Position and velocity by REBOUND's elements, mean anomaly n t, at seven times of two orbits."""
    orbit = ORBITS[name]
    for t in np.linspace(0, 2, 7) * orbit.period:
        sim = about(orbit)
        known = {"a": orbit.semi_major_axis, "e": orbit.eccentricity, "inc": orbit.inclination, "Omega": orbit.node}
        sim.add(m=0.0, **known, omega=orbit.perigee, M=2 * np.pi * t / orbit.period)
        r, v = orbit.at(t)
        assert r == pytest.approx(sim.particles[1].xyz, abs=1e-9 * orbit.semi_major_axis)
        assert v == pytest.approx(sim.particles[1].vxyz, abs=1e-9 * np.linalg.norm(v))


def test_the_frame_turns_as_the_true_anomaly_does() -> None:
    """By differences of REBOUND's true anomaly."""
    orbit = ORBITS["Molniya"]
    for M in (0.0, 0.5, 3.0):
        sim = about(orbit)
        for h in (-1e-4, 1e-4):
            sim.add(a=orbit.semi_major_axis, e=orbit.eccentricity, M=M + h, primary=sim.particles[0])
        before, after = (p.orbit(primary=sim.particles[0]).f for p in sim.particles[1:])
        want = (after - before + np.pi) % (2 * np.pi) - np.pi
        t = M * orbit.period / (2 * np.pi)
        assert orbit.rate(t) == pytest.approx(want / 2e-4 * 2 * np.pi / orbit.period, rel=1e-5)


def test_periods_that_are_known() -> None:
    """The space station's, 92.7 minutes at 415 km; the sidereal day's, 86,164.1 s, at 42,164.2 km; a year at 1 au."""
    assert Orbit.circular("415 km").period / 60 == pytest.approx(92.8, abs=0.2)
    assert Orbit("42164.17 km").period == pytest.approx(86164.1, abs=0.5)
    assert Orbit("1 au", primary=SUN).period / 86400 == pytest.approx(365.2569, abs=1e-3)


def test_satellites_go_east_and_north() -> None:
    """Below 90 degrees they move eastwards, above westwards; at the ascending node northwards; perigee is fastest."""
    for inclination, sign in (("51.6 deg", 1), ("97 deg", -1)):
        r, v = Orbit.circular("500 km", inclination, node="40 deg").at(0.0)
        assert np.degrees(np.arctan2(r[1], r[0])) == pytest.approx(40)
        assert r[2] == pytest.approx(0, abs=1e-6) and v[2] > 0
        assert sign * np.cross(r, v)[2] > 0
    assert abs(Orbit.circular("500 km").frame(0.0) - np.eye(3)).max() < 1e-15  # up, ahead and normal are x, y, z
    fast, slow = (np.linalg.norm(ORBITS["Molniya"].at(k * ORBITS["Molniya"].period / 2)[1]) for k in (0, 1))
    assert fast / slow == pytest.approx(1.72 / 0.28, rel=1e-9)
