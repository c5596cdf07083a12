"""Environment of a satellite, judged by ppigrf, astropy, printed tables and facts of the sky."""

from __future__ import annotations

import datetime as dt
import re
from typing import Any, cast

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import ITRS, TEME, CartesianRepresentation, EarthLocation, PrecessedGeocentric, get_sun
from astropy.time import Time
from astropy.utils import iers
from ppigrf import igrf_gc

import kreisel as kr
from kreisel.bodies import environment
from kreisel.physical import environment as earth

formulas = cast("Any", environment)  # of a page, without types
iers.conf.auto_download, iers.conf.auto_max_age = False, None
iers.conf.iers_degraded_accuracy = "ignore"
R = 6_371_200.0
BALL = 6_378_137.0


def days(date: str) -> float:
    """Days of UTC after 2000-01-01 12:00."""
    return float((dt.datetime.fromisoformat(date) - dt.datetime(2000, 1, 1, 12)) / dt.timedelta(days=1))


def by_ppigrf(r: np.ndarray, date: str) -> np.ndarray:
    """B (3, places), T, along the axes of the Earth, at r (3, places), m."""
    x, y, z = r
    distance, across = np.linalg.norm(r, axis=0), np.hypot(x, y)
    theta, phi = np.arctan2(across, z), np.arctan2(y, x)
    parts = igrf_gc(distance / 1e3, np.degrees(theta), np.degrees(phi), dt.datetime.fromisoformat(date))
    out, south, east = (1e-9 * part.ravel() for part in parts)
    s, c = np.sin(theta), np.cos(theta)
    level = out * s + south * c
    return np.array(
        [level * np.cos(phi) - east * np.sin(phi), level * np.sin(phi) + east * np.cos(phi), out * c - south * s]
    )


def places(seed: int, count: int = 200) -> np.ndarray:
    """Places (3, count), m, the first two next to the poles."""
    draw = np.random.default_rng(seed)
    x = draw.normal(size=(3, count))
    x[:, :2] = [[1e-4, 1e-4], [0, 0], [1, -1]]
    return x / np.linalg.norm(x, axis=0) * draw.uniform(R, 9e6, count)


def field(r: np.ndarray, date: str, degree: int = 13, t: float = 0.0) -> np.ndarray:
    gauss = earth.igrf(days(date), degree)
    return np.asarray(formulas.field(r, t, gauss=gauss, reference_radius=R, meridian=(0.0, 0.0)))


@pytest.mark.parametrize("date", ["1900-01-01", "1913-07-04", "1999-12-31", "2012-02-29", "2026-11-05", "2030-01-01"])
def test_the_field_is_that_of_ppigrf(date: str) -> None:
    r = places(len(date))
    assert abs(field(r, date) - by_ppigrf(r, date)).max() < 1e-12  # 0.001 nT
    assert abs(field(r, date, 12) - by_ppigrf(r, date)).max() > 1e-10 or date < "2000"


def test_the_field_changes_in_time_as_that_of_ppigrf() -> None:
    r = places(3)
    year = 365 * 86400.0
    assert abs(field(r, "2026-01-01", t=year) - by_ppigrf(r, "2027-01-01")).max() < 1e-12
    assert abs(field(r, "2026-01-01") - by_ppigrf(r, "2027-01-01")).max() > 5e-8


def test_the_coefficients_are_those_of_the_table_of_iaga() -> None:
    """Some of 2025 and their rates a year, nT."""
    gauss, year = earth.igrf(days("2025-01-01")) * 1e9, 365.2 * 86400
    for row, g, rate in ((0, -29350.0, 12.6), (1, -1410.3, 10.0), (2, 4545.5, -21.5), (69, 11.5, -0.3), (194, -0.5, 0)):
        assert gauss[row, 0] == pytest.approx(g, abs=1e-9)
        assert gauss[row, 1] * year == pytest.approx(rate, abs=1e-9)


def test_at_the_pole_the_field_is_finite() -> None:
    on_axis, near = np.array([[0.0], [0], [7e6]]), np.array([[1e-3], [0], [7e6]])
    assert abs(field(on_axis, "2026-01-01") - field(near, "2026-01-01")).max() < 1e-13


@pytest.mark.parametrize("date", ["1985-03-01T05:00:00", "2024-09-01T12:34:00"])
def test_the_field_rotates_with_the_earth(date: str) -> None:
    """By ppigrf at the place in the Earth that astropy finds, with nutation, polar motion and UT1: within 10 nT."""
    r = places(5, 40)
    for later in (0.0, 40_000.0, 20 * 86400.0):
        then = Time(date, scale="utc") + later * u.s
        of_space = TEME(CartesianRepresentation(r * u.m), obstime=then)
        inside = of_space.transform_to(ITRS(obstime=then)).cartesian.xyz.to_value("m")
        want = by_ppigrf(inside, (dt.datetime.fromisoformat(date) + dt.timedelta(seconds=later)).isoformat())
        given = {"gauss": earth.igrf(days(date)), "reference_radius": R, "meridian": earth.meridian(days(date))}
        got = formulas.field(r, later, **given)
        back = ITRS(CartesianRepresentation(want), obstime=then).transform_to(TEME(obstime=then)).cartesian.xyz.value
        assert abs(got - back).max() < 1e-8
        wrong = formulas.field(r, later + 60.0, **given)  # a quarter of a degree
        assert abs(wrong - back).max() > 4e-8


@pytest.mark.filterwarnings("ignore:ERFA function")  # leap seconds of the future
@pytest.mark.parametrize("date", ["1950-03-01T00:00:00", "2005-06-01T03:00:00", "2024-09-01T12:34:00"])
def test_the_sun_is_that_of_astropy(date: str) -> None:
    """To 0.01 degrees, over five years, in the frame of the equinox of the first day."""
    first = Time(date, scale="tt")
    for later in (0.0, 3.1, 100.0, 1826.25):
        then = first + later * u.day
        frame = PrecessedGeocentric(equinox=first, obstime=then)
        want = get_sun(then).transform_to(frame).cartesian.xyz.to_value("au")
        got, near = formulas.sunlight(later * 86400, **earth.sun(days(date)))
        distance = np.linalg.norm(want)
        assert np.arccos(got @ want / distance) < np.radians(0.01)
        assert near == pytest.approx(1 / distance, rel=1e-4)


SUN = np.array([0.3, -0.8, 0.2]) / np.linalg.norm([0.3, -0.8, 0.2])
DISC = 695_700e3 / 149_597_870_700


def seen_by_counting(angle: float, b: float) -> float:
    """The part of 100,000 points spread over the Sun's disc that a ball of angular radius b at that angle leaves."""
    k = np.arange(100_000)
    rho, phi = np.arcsin(DISC) * np.sqrt((k + 0.5) / len(k)), k * np.pi * (3 - np.sqrt(5))
    x, z = np.sin(rho) * np.cos(phi), np.cos(rho)
    return float((x * np.sin(angle) + z * np.cos(angle) < np.cos(b)).mean())


def light(r: np.ndarray) -> Any:
    return formulas.light(r, SUN, 1.0, eclipse=1.0, shadow=BALL, disc=DISC)


@pytest.mark.parametrize("distance", [6.6e6, 4.2e7, 3.8e8])
def test_the_light_is_the_part_of_the_disc_that_is_seen(distance: float) -> None:
    b, across = np.arcsin(BALL / distance), np.cross(SUN, [0.0, 0, 1])
    across = across / np.linalg.norm(across)
    for angle in (0.0, 1e-9, b / 2, *(b + DISC * np.linspace(-1.2, 1.2, 13)), np.pi / 2, np.pi - b, 3.1, np.pi):
        r = distance * (np.sin(angle) * across - np.cos(angle) * SUN)
        assert light(r) == pytest.approx(seen_by_counting(angle, b), abs=2e-4)


def test_the_time_in_the_shadow() -> None:
    """A circular orbit at 500 km in the plane of the Sun: 35.7 minutes of 94.6, the half of a disc at each end.

    The limb covers the Sun's 0.53 degrees at the rate of the orbit, in 8 s.
    """
    a = BALL + 500e3
    period = 2 * np.pi * np.sqrt(a**3 / 3.986004418e14)
    across = np.cross(SUN, [0.0, 0, 1])
    angle = np.linspace(0, 2 * np.pi, 400_001)[:-1]
    r = a * (np.cos(angle) * SUN[:, None] + np.sin(angle) * across[:, None] / np.linalg.norm(across))
    part = light(r)
    assert (1 - part).mean() * period == pytest.approx(period * np.arcsin(BALL / a) / np.pi, abs=0.1)
    assert (1 - part).mean() * period / 60 == pytest.approx(35.7, abs=0.1)
    assert ((part > 1e-9) & (part < 1 - 1e-9)).mean() * period / 2 == pytest.approx(0.53 / 360 * period, rel=0.02)


def test_without_an_eclipse_all_is_light() -> None:
    assert formulas.light(-7e6 * SUN, SUN, 1.0, eclipse=0.0, shadow=BALL, disc=DISC) == 1.0


FLAT = {"radius": BALL, "flattening": 1 / 298.257223563}


def test_heights_are_those_over_the_ellipsoid() -> None:
    for latitude, height in ((0, 5e5), (90, 2e5), (-35, 4e5), (60, 1e6), (45, 2e6)):
        r = np.array(EarthLocation.from_geodetic(20.0, latitude, height).value.tolist())
        assert 0 <= formulas.height(r, **FLAT) - height < 40


def density(h: Any, table: np.ndarray, direction: np.ndarray, sun: np.ndarray = SUN) -> Any:
    r = (BALL + np.asarray(h)) * direction[:, None]
    return formulas.density_of_air(r, sun, density=1.0, air=table, bulge=6.0, radius=BALL, flattening=0.0)


def test_the_scale_heights_are_those_that_vallado_prints() -> None:
    """The table of densities is read; its column of scale heights is not."""
    printed = {100: 5.877, 120: 9.473, 180: 29.740, 250: 45.546, 400: 58.515, 500: 63.822, 700: 88.667, 900: 181.05}
    for low, scale in printed.items():
        one, two = density(np.array([1e3 * low, 1e3 * low + 10]), earth.EXPONENTIAL, SUN)
        assert 10 / np.log(one / two) == pytest.approx(1e3 * scale, rel=2e-3)


def test_the_air_bulges_at_two_in_the_afternoon() -> None:
    """The largest and least densities of the table 30 degrees, two hours, east of the Sun, and opposite."""
    noon, heights = np.array([0.6, 0.8, 0.0]), np.array([200e3, 500e3, 840e3])
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    apex = np.array([c * noon[0] - s * noon[1], s * noon[0] + c * noon[1], 0])
    for direction, values in ((apex, (3.162e-10, 2.042e-12, 5.741e-14)), (-apex, (2.557e-10, 3.916e-13, 4.68e-15))):
        assert density(heights, earth.HARRIS_PRIESTER, direction, noon) == pytest.approx(values, rel=1e-6)
    night, day = density(heights, earth.HARRIS_PRIESTER, np.array([0, 0, 1.0]), noon), 2.042e-12
    assert night[1] == pytest.approx(3.916e-13 + (day - 3.916e-13) / 8, rel=1e-6)  # cos^6 of 45 degrees


def test_rows_of_the_table_that_an_orbit_needs() -> None:
    few = earth.rows_between(earth.HARRIS_PRIESTER, 490e3, 521e3)
    assert few[:, 0].tolist() == [480e3, 500e3, 520e3, 540e3]
    heights = np.linspace(490e3, 521e3, 50)
    assert density(heights, few, SUN) == pytest.approx(density(heights, earth.HARRIS_PRIESTER, SUN), rel=1e-12)


def test_air_turns_with_the_earth() -> None:
    """At rest over the ground, as a geostationary satellite is: 3.07 km/s at 42,164 km."""
    r, rate = np.array([42_164e3, 0, 0]), earth.meridian(0.0)[1]
    assert formulas.through_air(r, np.array([0, 3074.7, 10.0]), air_rate=rate) == pytest.approx([0, 0, 10], abs=0.1)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: earth.igrf(days("2030-01-02")), "IGRF-14 holds from 1900-01-01 to 2030-01-01, got 2030-01-02"),
        (lambda: earth.igrf(days("1899-12-31")), "got 1899-12-31. For other dates use field='dipole'"),
        (lambda: earth.igrf(0.0, 14), "integer from 1 to 13, got 14"),
        (
            lambda: earth.rows_between(earth.EXPONENTIAL, 90e3, 2e5),
            "from 100 to 1000 km, the lowest height of the orbit is 90",
        ),
    ],
)
def test_what_is_outside_of_the_models(call: Any, said: str) -> None:
    with pytest.raises(kr.InputError, match=re.escape(said)):
        call()
