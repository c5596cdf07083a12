"""Forces on satellites, judged by packages that have them and by facts that anyone can check."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np
import ppigrf
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.physical import EARTH, Orbit, Primary, Satellite
from torques import torque_on

BALL = (0.01, 0.01, 0.01)  # kg m^2: gravity does not turn it
IGRF = datetime(2025, 1, 1)
TILTED = Orbit("7000 km", 0.02, "51.6 deg", "20 deg", "70 deg")


def felt(orbit: Orbit, t: float) -> np.ndarray:
    """The field B (3,), T, in space: the torques e x B on unit moments e of a ball sum to 2 B = sum (e x B) x e."""
    torques = [torque_on(Satellite(BALL, orbit, magnetic_moment=e), np.eye(3), t) for e in np.eye(3)]
    return np.asarray(np.cross(torques, np.eye(3)).sum(0) / 2)


def igrf(place: np.ndarray) -> np.ndarray:
    """The axial dipole of IGRF-14 in 2025 (3,), T: degree 1 of ppigrf, averaged over the longitude."""
    r = np.linalg.norm(place)
    colatitude, longitude = np.arccos(place[2] / r), np.arctan2(place[1], place[0])
    around = np.array([0.0, 90.0, 180.0, 270.0])
    up, south, _ = (
        1e-9 * np.mean(part) for part in ppigrf.igrf_gc(r / 1e3, np.degrees(colatitude), around, IGRF, max_degree=1)
    )
    s, c = np.sin(colatitude), np.cos(colatitude)
    meridian = np.array([np.cos(longitude), np.sin(longitude), 0.0])
    return np.asarray(up * (s * meridian + c * np.eye(3)[2]) + south * (c * meridian - s * np.eye(3)[2]))


@pytest.mark.parametrize("t", [0.0, 700.0, 1900.0, 3300.0])
def test_the_field_is_the_axial_dipole_of_igrf_14(t: float) -> None:
    want = igrf(TILTED.at(t)[0])
    assert abs(felt(TILTED, t) - want).max() < 1e-9 * abs(want).max()


def test_the_field_points_north_over_the_equator() -> None:
    """About 30 uT at the ground there, downwards at the northern pole and upwards at the southern."""
    earth = EARTH._replace(radius=6.2e6)  # orbits at the ground
    ground = Orbit(6_378_200.0, primary=earth)
    assert felt(ground, 1000.0) == pytest.approx((0, 0, 3e-5), abs=1e-6)
    polar = Orbit(6_378_200.0, inclination="90 deg", primary=earth)
    assert felt(polar, polar.period / 4) == pytest.approx((0, 0, -6e-5), abs=2e-6)
    assert felt(polar, 3 * polar.period / 4) == pytest.approx((0, 0, -6e-5), abs=2e-6)


def swing(primary: Primary, tilt: float = np.radians(5)) -> tuple[np.ndarray, np.ndarray]:
    """Angle from north of a compass needle along z on an equatorial orbit at 500 km, released at rest, and times."""
    needle = Satellite(BALL, Orbit.circular("500 km", primary=primary), magnetic_moment=(0, 0, "0.1 A m^2"))
    attitude = needle.orientation((np.cos(tilt / 2), np.sin(tilt / 2), 0, 0))
    asked: dict[str, Any] = {"dt": 10.0, "steps": 500, "orientation": attitude, "progress": False}
    run = kr.simulate(needle.model(), needle.state(spin=(0, 0, 0)), **asked)
    axis = algebra.rotation_matrix(run.g.values)[..., 2]
    return run.time.values, np.arctan2(-axis[:, 1], axis[:, 2])


def test_a_compass_points_north() -> None:
    """A needle swings about north with the period 2 pi sqrt(I/(m B)) of every magnetometer, B by IGRF-14."""
    time, angle = swing(EARTH)
    assert abs(angle).max() < np.radians(5.01)
    crossings = time[1:][np.diff(np.sign(angle)) != 0]
    B = np.linalg.norm(igrf(np.array([EARTH.radius + 5e5, 0, 0])))
    assert 2 * np.diff(crossings).mean() == pytest.approx(2 * np.pi * np.sqrt(0.01 / (0.1 * B)), rel=0.01)


def test_a_field_of_the_other_sign_turns_the_needle_over() -> None:
    """The mutant, of which the user is warned."""
    with pytest.warns(kr.InputWarning, match="points south over the equator"):
        assert abs(swing(EARTH._replace(field=-EARTH.field))[1]).max() > np.radians(170)
