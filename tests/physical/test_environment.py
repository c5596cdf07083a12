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
from kreisel import algebra
from kreisel.algebra import gradient
from kreisel.bodies import BODIES, orbit as page_of_orbits
from kreisel.physical import (
    EARTH,
    SATURN,
    SOLAR_PRESSURE,
    SUN as STAR,
    Ensemble,
    Orbit,
    Plate,
    Primary,
    Satellite,
    satellite as earth,
)
from kreisel.runs.geometry import environment_of
from sizes import FULL
from torques import torque_on

formulas = cast("Any", page_of_orbits)  # of a page, without types
HARRIS_PRIESTER = earth.tables()["harris-priester"]
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
        got, near = formulas.sunlight(later * 86400, **earth.motion_of_sun(days(date)))
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


FLAT = {"radius": EARTH.radius, "flattening": EARTH.flattening}


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
        one, two = density(np.array([1e3 * low, 1e3 * low + 10]), earth.tables()["exponential"], SUN)
        assert 10 / np.log(one / two) == pytest.approx(1e3 * scale, rel=2e-3)


def test_the_air_bulges_at_two_in_the_afternoon() -> None:
    """The largest and least densities of the table 30 degrees, two hours, east of the Sun, and opposite."""
    noon, heights = np.array([0.6, 0.8, 0.0]), np.array([200e3, 500e3, 840e3])
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    apex = np.array([c * noon[0] - s * noon[1], s * noon[0] + c * noon[1], 0])
    for direction, values in ((apex, (3.162e-10, 2.042e-12, 5.741e-14)), (-apex, (2.557e-10, 3.916e-13, 4.68e-15))):
        assert density(heights, HARRIS_PRIESTER, direction, noon) == pytest.approx(values, rel=1e-6, abs=0)
    night, day = density(heights, HARRIS_PRIESTER, np.array([0, 0, 1.0]), noon), 2.042e-12
    assert night[1] == pytest.approx(3.916e-13 + (day - 3.916e-13) / 8, rel=1e-6, abs=0)  # cos^6 of 45 degrees


def test_rows_of_the_table_that_an_orbit_needs() -> None:
    few = earth.rows_between(HARRIS_PRIESTER, 490e3, 521e3)
    assert few[:, 0].tolist() == [480e3, 500e3, 520e3, 540e3]
    heights = np.linspace(490e3, 521e3, 50)
    assert density(heights, few, SUN) == pytest.approx(density(heights, HARRIS_PRIESTER, SUN), rel=1e-12, abs=0)


def test_air_turns_with_the_earth() -> None:
    """At rest over the ground, as a geostationary satellite is: 3.07 km/s at 42,164 km."""
    r, rate = np.array([42_164e3, 0, 0]), earth.meridian(0.0)[1]
    assert formulas.through_air(r, np.array([0, 3074.7, 10.0]), air_rate=rate) == pytest.approx([0, 0, 10], abs=0.1)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: earth.igrf(days("2030-01-02")), "IGRF-14 holds from 1900-01-01 to 2030-01-01, got 2030-01-02"),
        (lambda: earth.igrf(days("1899-12-31")), "got 1899-12-31. For other dates use magnetic_field='dipole'"),
        (lambda: earth.igrf(0.0, 14), "integer from 1 to 13, got 14"),
        (
            lambda: earth.rows_between(earth.tables()["exponential"], 90e3, 2e5),
            "from 100 to 1000 km, the lowest height of the orbit is 90",
        ),
    ],
)
def test_what_is_outside_of_the_models(call: Any, said: str) -> None:
    with pytest.raises(kr.InputError, match=re.escape(said)):
        call()


MUTANTS: dict[str, tuple[Any, Any]] = {  # a name of the page, a wrong value, and a test that sees it
    "LAG": ((0.75**0.5, -0.5), test_the_air_bulges_at_two_in_the_afternoon),
    "SEGMENT": ([-2 / 3], lambda: test_the_light_is_the_part_of_the_disc_that_is_seen(6.6e6)),
    "scale": (lambda n, m: 1.0, lambda: test_the_field_is_that_of_ppigrf("2012-02-29")),
    "ramp": (lambda x: x, test_rows_of_the_table_that_an_orbit_needs),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_wrong_page_is_seen(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong, test = MUTANTS[name]
    monkeypatch.setattr(page_of_orbits, name, wrong)
    with pytest.raises(AssertionError):
        test()


# -- satellites ------------------------------------------------------------------------------------

DATE = "2026-03-20T14:46:00"  # the equinox, to the minute
DATED = Orbit.circular("500 km", "51.6 deg", "20 deg", epoch=DATE)
MOMENTS = (0.03, 0.04, 0.05)


def test_a_satellite_with_a_date_has_the_field_of_igrf() -> None:
    """The torque of its moment is b x B, B by ppigrf at the place in the Earth that astropy finds, to 10 nT."""
    b, t, then = np.array([0.1, -0.2, 0.3]), 5000.0, Time(DATE, scale="utc") + 5000 * u.s
    g = algebra.rotation_matrix(algebra.unit(np.array([0.3, 0.5, -0.2, 0.7])))
    of_space = TEME(CartesianRepresentation(DATED.at(t)[0][:, None] * u.m), obstime=then)
    inside = of_space.transform_to(ITRS(obstime=then)).cartesian.xyz.to_value("m")
    B = ITRS(CartesianRepresentation(by_ppigrf(inside, "2026-03-20T16:09:20")), obstime=then)
    want = np.cross(b, B.transform_to(TEME(obstime=then)).cartesian.xyz.value[:, 0] @ g)

    def torque(**more: Any) -> np.ndarray:
        loaded, free = Satellite(MOMENTS, DATED, magnetic_moment=b, **more), Satellite(MOMENTS, DATED, **more)
        return torque_on(loaded, g, t) - torque_on(free, g, t)

    assert abs(torque() - want).max() < 4e-9
    for other in ({"degree": 4}, {"magnetic_field": "tilted-dipole"}, {"magnetic_field": "dipole"}):
        assert abs(torque(**other) - want).max() > 4e-9
    assert torque(magnetic_field="tilted-dipole") == pytest.approx(torque(degree=1), abs=0)


def test_a_controller_sees_the_field_of_igrf() -> None:
    """Along an orbit that changes its height by 20,000 km the interpolated field is off by less than 1e-4 nT."""

    def law(field: np.ndarray) -> dict[str, Any]:
        return {"dipole": 0 * field, "seen": field}

    far = Orbit(13_400e3, 0.5, 1.1, mean_anomaly=-0.5, epoch=DATE)
    body = Satellite.cubesat(far, control=kr.Control(law, every="5 s", memory={"seen": np.zeros(3)}))
    run = kr.simulate(body, body.state(), dt="5 s", t_end="1 h", order=(2, 2), progress=False)
    turned = np.einsum("tji,tj->ti", algebra.rotation_matrix(run.attitude.values), run.field.values)
    off = abs(run.seen.values[1:] - turned[:-1]).max()  # the sample at a row is seen in the next
    assert 1e-16 < off < 1e-13  # T; exactly the field would be off by 1e-20


def test_the_environment_along_a_run() -> None:
    """At the equinox the Sun is along the first axis of space, and the field points north over the equator."""
    equator = Orbit.circular("500 km", epoch=DATE)
    body = Satellite.cubesat(equator, light=SOLAR_PRESSURE, air="harris-priester", magnetic_moment=(0, 0, 0.01))
    options = {"orientation": body.orientation(), "progress": False}
    run = kr.simulate(body.model(), body.state((0.01, 0, 0.02)), dt=30.0, steps=190, every=10, order=(2, 2), **options)
    around = body.environment(run)
    assert around.sun.values[0] == pytest.approx([1, 0, 0], abs=2e-4)
    assert around.position.values == pytest.approx(equator.at(run.time.values)[0], rel=1e-12)
    assert around.velocity.values == pytest.approx(equator.at(run.time.values)[1], rel=1e-12)
    assert (around.field.values[:, 2] > 1.5e-5).all() and (abs(around.field.values) < 4e-5).all()
    assert around.light.values[0] == pytest.approx(1, abs=1e-12) and around.light.values[9] == pytest.approx(
        0, abs=1e-12
    )
    assert 3.9e-13 < around.density.values.min() < 6e-13 and 1.5e-12 < around.density.values.max() < 2.1e-12
    units = {"position": "m", "velocity": "m/s", "field": "T", "sun": "1", "light": "1", "density": "kg/m^3"}
    assert {name: around[name].units for name in units} == units
    assert all(around[name].long_name for name in units)


def test_lanes_on_different_orbits() -> None:
    body = Satellite(MOMENTS, DATED)
    params = {**body.model().params, "inclination": [0.0, DATED.inclination]}
    start, options = body.state().axial.M, {"orientation": body.orientation(), "progress": False}
    alone = kr.simulate(body.model(), body.state(), dt=30.0, steps=2, **options)
    model = BODIES["satellite"](**params)
    lanes = environment_of(kr.simulate(model, model.state(M=start), dt=30.0, steps=2, **options))
    assert lanes.field.dims == ("time", "lane", "xyz") and lanes.light.dims == ("time", "lane")
    assert lanes.field.values[:, 1] == pytest.approx(body.environment(alone).field.values, rel=1e-12)
    assert abs(lanes.field.values[1, 1] - lanes.field.values[1, 0]).max() > 1e-7


def sail(**more: Any) -> Satellite:
    """A plate of 1 m^2 towards the first axis, 1 m away from the centre along the second."""
    return Satellite(MOMENTS, more.pop("orbit"), plates=(Plate((1, 0, 0), (0, 1, 0), 1.0),), **more)


def test_there_is_no_light_in_the_shadow() -> None:
    """The torque of light is its pressure, 1361 W/m^2 over c, within 3.4 % of the year, or 0 behind the Earth."""
    orbit = Orbit.circular("500 km", epoch=DATE)
    for t, part in ((0.0, 1.0), (orbit.period / 2, 0.0)):
        lit, dark = (torque_on(sail(orbit=orbit, light=p), np.eye(3), t) for p in (SOLAR_PRESSURE, 0.0))
        assert (lit - dark)[2] == pytest.approx(part * 1361 / 299_792_458, rel=0.034, abs=1e-20)
    unshaded = sail(orbit=orbit, light=SOLAR_PRESSURE, eclipse=False), sail(orbit=orbit)
    lit, dark = (torque_on(body, np.eye(3), orbit.period / 2) for body in unshaded)
    assert (lit - dark)[2] > 4e-6


def test_the_sun_lights_a_body_that_orbits_it() -> None:
    """From the pericentre, 1 au, and from the apocentre, 3 au, where it has a ninth of its pressure."""
    orbit = Orbit("2 au", 0.5, primary=STAR)
    for t, pressure in ((0.0, 0.0), (orbit.period / 2, 1361 / 299_792_458 / 9)):
        lit, dark = (torque_on(sail(orbit=orbit, light=p), np.eye(3), t) for p in (SOLAR_PRESSURE, 0.0))
        assert lit - dark == pytest.approx([0, 0, pressure], rel=1e-9, abs=1e-22)
    fixed, dark = (torque_on(sail(orbit=orbit, light=p, sun=(1, 0, 0)), np.eye(3), 0.0) for p in (SOLAR_PRESSURE, 0.0))
    assert (fixed - dark)[2] == pytest.approx(1361 / 299_792_458)


def test_lanes_around_the_sun_and_the_earth() -> None:
    """Each with its Sun, and without a warning that the orbit of the Earth is too close to the surface of the Sun."""
    plates, orbits = (Plate((1, 0, 0), (0, 1, 0), 1.0),), (Orbit("1 au", primary=STAR), Orbit(7.2e6))
    both = Ensemble([Satellite(MOMENTS, orbit, plates=plates, light=SOLAR_PRESSURE) for orbit in orbits])
    run = kr.simulate(both, both.state([(0, 0, 1e-3)] * 2), dt="30 s", steps=1)
    assert np.allclose(run.sun.values[0], [[-1, 0, 0], [1, 0, 0]]) and (run.light == 1).all()


def test_a_date_of_another_planet_has_no_sun() -> None:
    mars = Orbit.circular("400 km", primary=Primary("Mars", 4.282837e13, 3_396_200.0), epoch="2026-01-01")
    with pytest.warns(kr.InputWarning, match="sun: expected a direction in space for light on an orbit of Mars"):
        Satellite.cubesat(mars, light=SOLAR_PRESSURE)
    Satellite.cubesat(mars, light=SOLAR_PRESSURE, sun=(0, 1, 0), eclipse=True)


def test_the_shadow_beyond_its_tip_is_doubted() -> None:
    """At the second point of Lagrange the Earth hides 0.84 of the Sun's disc: an annular eclipse."""
    far = Orbit(1.5e9, epoch=DATE)
    with pytest.warns(kr.InputWarning, match="eclipse: expected an orbit within 200 radii of the Earth"):
        Satellite(MOMENTS, far)
    assert Satellite(MOMENTS, far, eclipse=False).model().params["eclipse"] == 0
    assert Satellite(MOMENTS, Orbit(3.84e8, epoch=DATE)).model().params["eclipse"] == 1


def test_a_primary_without_a_radius_shades_nothing() -> None:
    around = sail(orbit=Orbit(1e4, primary=Primary("rock", 4.9e3, 0.0)), light=SOLAR_PRESSURE)
    run = kr.simulate(around, around.state((0, 0, 1e-5)), dt="10 s", t_end="2 h", every=90)
    assert (run.light.values == 1).all()


def test_light_is_strongest_in_january() -> None:
    """Of the Sun at perihelion, 0.98329 au away at the longitude 283 degrees, and at aphelion, 1.01671 au."""
    tilt = np.radians(23.44)
    for date, longitude, distance in (("2026-01-03T17:00", 283.2, 0.98329), ("2026-07-06T17:00", 104.5, 1.01671)):
        c, s = np.cos(np.radians(longitude)), np.sin(np.radians(longitude))
        toward, across = (c, s * np.cos(tilt), s * np.sin(tilt)), (-s, c * np.cos(tilt), c * np.sin(tilt))
        plates, orbit = (Plate(toward, across, 1.0),), Orbit.circular("500 km", epoch=date)
        lit, dark = (
            torque_on(Satellite(MOMENTS, orbit, plates=plates, light=p, eclipse=False), np.eye(3), 0.0)
            for p in (1.0, 0.0)
        )
        assert np.linalg.norm(lit - dark) == pytest.approx(1 / distance**2, rel=1e-3)


def test_the_air_is_slower_in_the_direction_of_the_earth() -> None:
    """Over the equator at 500 km the air moves at 501.5 m/s, and the satellite at 7612.6 m/s."""
    torques = []
    for inclination in ("0 deg", "180 deg"):
        orbit = Orbit.circular("500 km", inclination, "-90 deg")  # begins along the first axis, or against it
        body = sail(orbit=orbit, air="exponential")
        g = np.diag([1.0, 1, 1]) if inclination == "0 deg" else np.diag([-1.0, -1, 1])
        free = torque_on(Satellite(MOMENTS, orbit), g, 0.0)
        torques.append((torque_on(body, g, 0.0) - free)[2])
    assert torques[0] == pytest.approx(6.967e-13 / 2 * 2.2 * (7612.6 - 501.5) ** 2, rel=1e-4)
    assert torques[1] == pytest.approx(6.967e-13 / 2 * 2.2 * (7612.6 + 501.5) ** 2, rel=1e-4)


def test_the_table_of_an_eccentric_orbit_reaches_its_apogee() -> None:
    """300 x 850 km: from 2.418e-11 to 1.170e-14 exp(-50/124.64) kg/m^3 (Vallado's table 8-4)."""
    a, e = EARTH.radius + 575e3, 275e3 / (EARTH.radius + 575e3)
    air = sail(orbit=Orbit(a, e), air="exponential").model().params["air"]
    printed = [2.418e-11, 1.170e-14 * np.exp(-50 / 124.64)]
    assert density(np.array([3e5, 8.5e5]), air, SUN) == pytest.approx(printed, rel=2e-3, abs=0)


def spiral(first: float, last: float) -> Orbit:
    """From one height, m, to another in a day, at the rate of the height between them."""
    t = np.linspace(0.0, 86_400.0, 1441)
    n = np.sqrt(EARTH.mu / (EARTH.radius + (first + last) / 2) ** 3)
    r = EARTH.radius + first + (last - first) * t / t[-1]
    return Orbit.from_table(t, (r * [np.cos(n * t), np.sin(n * t), 0 * t]).T)


def test_the_table_of_the_air_reaches_the_ends_of_a_path() -> None:
    """From 600 to 300 km, where Vallado's table 8-4 has 2.418e-11 kg/m^3; the ellipse of the path is at 600 km."""
    air = sail(orbit=spiral(600e3, 300e3), air="exponential").model().params["air"]
    assert density(np.array([3e5, 6e5]), air, SUN) == pytest.approx([2.418e-11, 1.454e-13], rel=2e-3, abs=0)
    with pytest.raises(kr.InputError, match="the lowest height of the orbit is 50 km"):
        sail(orbit=spiral(350e3, 50e3), air="exponential")


def test_without_a_date_the_field_is_the_dipole() -> None:
    model = Satellite(MOMENTS, Orbit.circular("500 km")).model()
    assert model.params["field"] == EARTH.field and not model.params["gauss"].any()
    far = Satellite(MOMENTS, Orbit(1e8, primary=SATURN, epoch=DATE)).model()
    assert far.params["field"] == SATURN.field and far.params["eclipse"] == 0


NAMED = Orbit.circular("500 km", "97 deg")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: Satellite(MOMENTS, NAMED, magnetic_field="igrf"),
            "magnetic_field='igrf': expected a date, Orbit(..., epoch=",
        ),
        (lambda: Satellite(MOMENTS, NAMED, sun="ephemeris"), "sun='ephemeris': expected a date"),
        (lambda: Satellite(MOMENTS, NAMED, air="harris-priester"), "air='harris-priester': expected a date"),
        (
            lambda: Satellite(MOMENTS, DATED, magnetic_field="wmm"),
            "magnetic_field: expected one of igrf, dipole, tilted-dipole, got 'wmm'",
        ),
        (
            lambda: Satellite(MOMENTS, DATED, sun="moon"),
            "sun: expected 'ephemeris' or a direction in space, got 'moon'",
        ),
        (
            lambda: Satellite(MOMENTS, DATED, air="msis"),
            "air: expected one of exponential, harris-priester, got 'msis'",
        ),
        (lambda: Satellite(MOMENTS, DATED, air="exponential", density=1e-12), "no density with it, got both"),
        (lambda: Satellite(MOMENTS, DATED, eclipse=2), "eclipse: expected True or False, got 2"),
        (
            lambda: Satellite(MOMENTS, Orbit(1e12, primary=STAR), eclipse=True),
            "eclipse=True: expected another primary than the Sun",
        ),
        (
            lambda: Satellite(MOMENTS, Orbit(1e8, primary=SATURN, epoch=DATE), magnetic_field="igrf"),
            "magnetic_field='igrf': expected an orbit of the Earth, got one of the primary Saturn",
        ),
        (
            lambda: Satellite(MOMENTS, Orbit.circular("500 km", epoch="2031-05-06")),
            "IGRF-14 holds from 1900-01-01 to 2030-01-01, got 2031-05-06",
        ),
        (
            lambda: Satellite(MOMENTS, Orbit.circular("1200 km"), air="exponential"),
            "from 100 to 1000 km, the lowest height",
        ),
    ],
)
def test_models_that_a_satellite_cannot_have(call: Any, said: str) -> None:
    with pytest.raises(kr.InputError, match=re.escape(said)):
        call()


def test_functions_of_numbers_in_arrays_of_objects() -> None:
    """As the constants of a derivative are."""
    x = np.array([0.5, 2.0], dtype=object)
    for name in ("sin", "cos", "exp", "log"):
        assert getattr(gradient, name)(x).tolist() == getattr(np, name)(x.astype(float)).tolist()
        assert getattr(gradient, name)(np.array(0.5, dtype=object)) == getattr(np, name)(0.5)


@pytest.mark.skipif(not FULL, reason="`make test-full` runs it")
def test_derivatives_through_everything() -> None:
    """By `kr.differentiable` and by differences, with respect to the moment and the pressure of light."""
    import jax
    import jax.numpy as jnp

    import kreisel.reduction as red

    more = {"light": SOLAR_PRESSURE, "air": "harris-priester", "center_of_mass": ("1 cm", 0, 0)}
    body = Satellite.cubesat(DATED, magnetic_moment=(0.001, 0.002, 0.003), **more)
    start, nose = {"M": body.model().params["moments"] * 1e-3}, body.orientation(body.pointing())
    motion = kr.differentiable(body.model(), order=(2, 2), orientation=nose)
    with red.double():

        def turned(moment: Any, pressure: Any) -> Any:
            return abs(motion(start, dt=30.0, steps=40, dipole=moment, pressure=pressure)["g"] @ nose)

        b, p = jnp.array([0.001, 0.002, 0.003]), jnp.array(SOLAR_PRESSURE)
        slopes = jax.jit(jax.grad(turned, (0, 1)))(b, p)
        by_moment = (turned(b.at[0].add(1e-6), p) - turned(b.at[0].add(-1e-6), p)) / 2e-6
        by_pressure = (turned(b, p + 1e-9) - turned(b, p - 1e-9)) / 2e-9
        assert float(slopes[0][0]) == pytest.approx(float(by_moment), rel=1e-5)
        assert float(slopes[1]) == pytest.approx(float(by_pressure), rel=1e-5)
