"""Forces on satellites, judged by packages that have them and by facts that anyone can check."""

from __future__ import annotations

import functools
from datetime import datetime
from typing import Any

import numpy as np
import ppigrf
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.bodies import BODIES
from kreisel.physical import EARTH, SATURN, SOLAR_PRESSURE, Orbit, Plate, Primary, Satellite, Wheels
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


def test_the_field_of_saturn_points_south() -> None:
    """Pioneer 11: 0.20 +- 0.01 gauss R^3 for R = 60,000 km, not as the Earth's.  [Acuna, Ness 1980]"""
    assert felt(Orbit(6.1e7, primary=SATURN._replace(radius=6e7)), 0.0)[2] < 0
    assert SATURN.field / 6e7**3 == pytest.approx(0.20e-4, abs=0.015e-4)


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


# -- gravity, air, sunlight ---------------------------------------------------------------------------

ROUND = Orbit.circular("500 km")  # at t = 0 up is x, ahead is y, the normal z
NEEDLE = (1e-4, 1.0, 1.0)  # kg m^2: long along its first axis


def turned(angle: float) -> np.ndarray:
    """About z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_gravity_turns_the_long_axis_to_the_vertical() -> None:
    """As the Moon's long axis points to the Earth; by Newton's attraction of the two ends of a rod, 1 kg m^2 each."""
    body = Satellite(NEEDLE, ROUND)
    for angle in (0.3, -0.3, 2.0):
        g = turned(angle)
        torque = g @ torque_on(body, g, 0.0)
        ends = [sign * np.array([0.5**0.5 * np.cos(angle), 0.5**0.5 * np.sin(angle), 0]) for sign in (1, -1)]
        place = ROUND.at(0.0)[0]
        pulls = [-EARTH.mu * (place + x) / np.linalg.norm(place + x) ** 3 for x in ends]
        want = sum(np.cross(x, pull) for x, pull in zip(ends, pulls, strict=True))
        assert torque == pytest.approx(want, rel=1e-3, abs=1e-3 * np.linalg.norm(want))
    assert torque_on(body, turned(0.3), 0.0)[2] < 0 < torque_on(body, turned(-0.3), 0.0)[2]


def pushed(normal: Any, **loads: Any) -> np.ndarray:
    """The force F on a plate of 1 m^2 facing `normal`, by its torques e x F at three arms e."""
    bodies = [Satellite(BALL, ROUND, plates=(Plate(normal, e, 1.0),), **loads) for e in np.eye(3)]
    torques = [torque_on(body, np.eye(3), 0.0) for body in bodies]
    return np.asarray(np.cross(torques, np.eye(3)).sum(0) / 2)


def test_air_slows() -> None:
    """(1/2) rho C A v^2 against the velocity: 64 uN on a square metre at 500 km and 1e-12 kg/m^3; none behind it."""
    v = ROUND.at(0.0)[1]
    force = pushed((0, 1, 0), density=1e-12, drag=2.2)
    assert force @ v < 0
    assert force == pytest.approx((0, -0.5 * 1e-12 * 2.2 * 7612.6**2, 0), rel=1e-4, abs=1e-12)
    assert abs(pushed((0, -1, 0), density=1e-12)).max() < 1e-12
    assert abs(pushed((1, 0, 0), density=1e-12)).max() < 1e-8


def test_a_shuttlecock_flies_nose_first() -> None:
    """Sails behind the centre of mass turn the nose back into the wind, sails ahead of it turn it away."""
    for place, sign in ((-1.0, -1), (1.0, 1)):
        sails = tuple(Plate(n, (0.0, place, 0.0), 0.1) for n in ((1, 0, 0), (-1, 0, 0)))
        body = Satellite(BALL, ROUND, plates=sails, density=1e-11)
        for angle in (0.2, -0.2):
            assert sign * angle * torque_on(body, turned(angle), 0.0)[2] > 0


@pytest.mark.parametrize(
    ("mirror", "diffuse", "times"), [(0.0, 0.0, 1.0), (1.0, 0.0, 2.0), (0.0, 1.0, 5 / 3), (0.5, 0.0, 1.5)]
)
def test_sunlight_pushes_away_from_the_sun(mirror: float, diffuse: float, times: float) -> None:
    """Face on the pressure is that of the light on black, twice on a mirror, 5/3 on white paper (Lambert's law)."""
    light = {"light": SOLAR_PRESSURE, "sun": (0, 1, 0), "mirror": mirror, "diffuse": diffuse}
    force = pushed((0, 1, 0), **light)
    assert force == pytest.approx((0, -times * 4.54e-6, 0), rel=1e-3, abs=1e-12)
    assert abs(pushed((0, -1, 0), **light)).max() < 1e-12


def test_a_mirror_is_pushed_along_its_normal_and_black_along_the_light() -> None:
    sun = np.array([0.6, 0.8, 0.0])
    of_mirror, of_black = (pushed((0, 1, 0), light=1e-3, sun=sun, mirror=mirror) for mirror in (1.0, 0.0))
    assert abs(np.cross(of_mirror, (0, 1, 0))).max() < 1e-9 < -of_mirror[1]
    assert abs(np.cross(of_black, sun)).max() < 1e-9 < -of_black @ sun


def test_a_motor_turns_the_body_against_the_wheel() -> None:
    """Newton's third law; a thruster's steady torque turns the body with it."""
    body = Satellite(BALL, ROUND, wheels=Wheels([[0, 0, 1]], torque=1e-3))
    assert torque_on(body, np.eye(3), 0.0) == pytest.approx((0, 0, -1e-3))
    assert torque_on(Satellite(BALL, ROUND, torque=(0, 0, 1e-3)), np.eye(3), 0.0) == pytest.approx((0, 0, 1e-3))


def test_a_wheel_makes_the_body_a_gyroscope() -> None:
    """The momentum of body and wheel is fixed in space: L' = -Omega x L along the body axes."""
    h, spin = np.array([0.0, 0.0, 2.0]), np.array([0.1, 0.0, 0.0])
    want = -np.cross(spin, np.multiply(BALL, spin) + h)
    assert torque_on(Satellite(BALL, ROUND, wheels=Wheels(np.eye(3), h)), np.eye(3), 0.0, spin) == pytest.approx(want)


@pytest.mark.parametrize(
    ("law", "seen_by"),
    [
        ("potential", test_gravity_turns_the_long_axis_to_the_vertical),
        ("potential", test_the_field_points_north_over_the_equator),
        ("torque", test_air_slows),
        ("torque", test_a_shuttlecock_flies_nose_first),
        ("torque", lambda: test_sunlight_pushes_away_from_the_sun(0.0, 0.0, 1.0)),
        ("torque", test_a_mirror_is_pushed_along_its_normal_and_black_along_the_light),
    ],
)
def test_a_law_with_the_other_sign_is_seen(law: str, seen_by: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutants."""
    force = getattr(BODIES["satellite"].perturbation, law)
    right = force.function

    @functools.wraps(right)
    def wrong(*letters: Any, **known: Any) -> Any:
        return -right(*letters, **known)

    monkeypatch.setitem(force.__dict__, "function", wrong)
    with pytest.raises(AssertionError):
        seen_by()
