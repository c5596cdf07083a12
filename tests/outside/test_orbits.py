"""Orbits: elements to vectors by REBOUND, periods and directions that anyone can check."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import rebound
from astropy.time import Time, TimeDelta
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from sgp4.api import WGS72, Satrec
from sgp4.conveniences import sat_epoch_datetime

import kreisel as kr
from kreisel.physical import EARTH, SUN, Orbit, Satellite

ORBITS = {
    "round": Orbit("7000 km"),
    "sun-synchronous": Orbit("7000 km", 1e-3, "97.9 deg", "35 deg", "270 deg"),
    "Molniya": Orbit("26600 km", 0.72, "63.4 deg", "-120 deg", "280 deg"),
    "retrograde": Orbit("9000 km", 0.2, "150 deg", "300 deg", "10 deg"),
    "asteroid": Orbit("2.5 au", 0.6288, "0.47 deg", "124 deg", "278 deg", SUN),
    "with a phase": Orbit("12000 km", 0.4, "70 deg", "-50 deg", "130 deg", mean_anomaly="250 deg"),
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
        sim.add(m=0.0, **known, omega=orbit.perigee, M=orbit.mean_anomaly + 2 * np.pi * t / orbit.period)
        r, v = orbit.at(t)
        assert r == pytest.approx(sim.particles[1].xyz, abs=1e-9 * orbit.semi_major_axis)
        assert v == pytest.approx(sim.particles[1].vxyz, abs=1e-9 * np.linalg.norm(v))


@pytest.mark.parametrize("f", ["0 deg", "-100 deg", "179.9 deg", "300 deg"])
def test_a_true_anomaly(f: str) -> None:
    orbit = Orbit("26600 km", 0.72, "63.4 deg", "-120 deg", "280 deg", true_anomaly=f)
    sim = about(orbit)
    known = {"a": orbit.semi_major_axis, "e": 0.72, "inc": orbit.inclination, "Omega": orbit.node}
    sim.add(m=0.0, **known, omega=orbit.perigee, f=np.radians(float(f[:-4])))
    assert orbit.at(0.0)[0] == pytest.approx(sim.particles[1].xyz, abs=1e-3)


# Known degrees a day: the Sun's mean motion at the inclination of Landsat 8, of the space station, of GPS satellites.
NODES = {
    "Landsat 8, 705 km": (Orbit.circular("705 km", "98.2 deg", J2=True), 360 / 365.2422, 0.005),
    "space station, 417 km": (Orbit.circular("417 km", "51.64 deg", J2=True), -4.98, 0.03),
    "GPS, 26560 km": (Orbit("26560 km", 0.0, "55 deg", J2=True), -0.039, 0.001),
}


@pytest.mark.parametrize("name", NODES)
def test_nodes_drift_as_is_known(name: str) -> None:
    orbit, want, margin = NODES[name]
    normals = orbit.frame([0.0, 86400.0])[..., 2]
    before, after = np.degrees(np.arctan2(normals[:, 1], normals[:, 0]))
    assert after - before == pytest.approx(want, abs=margin)


def test_perigee_stays_at_the_critical_inclination() -> None:
    """63.4349 degrees; below it perigee advances, above it recedes."""
    for inclination, sign in (("63.4349 deg", 0), ("50 deg", 1), ("80 deg", -1)):
        orbit = Orbit("26600 km", 0.7, inclination, perigee="270 deg", J2=True)
        drift = orbit.rates.perigee * 86400
        assert (abs(drift) < 1e-7) if sign == 0 else (sign * drift > 1e-3)


@pytest.mark.parametrize("e", [0.001, 0.3, 0.7])
def test_rates_are_near_those_of_sgp4(e: float) -> None:
    """SGP4 has terms in J2^2 and J4 too, of a thousandth, and WGS 72."""
    sat = Satrec()
    i, node, perigee, anomaly = np.radians([40, 30, 20, 10])
    a = 8000e3 / (1 - e)
    n = Orbit(a).mean_motion * 60
    sat.sgp4init(WGS72, "i", 1, 20000.0, 0.0, 0.0, 0.0, e, perigee, i, anomaly, n, node)
    orbit = Orbit(sat.a * 6378.135e3, e, i, node, perigee, mean_anomaly=anomaly, J2=True)
    assert orbit.rates.node * 60 == pytest.approx(sat.nodedot, rel=5e-3)
    assert orbit.rates.perigee * 60 == pytest.approx(sat.argpdot, rel=5e-3)
    assert orbit.rates.mean_anomaly * 60 - n == pytest.approx(sat.mdot - n, abs=5e-2 * abs(orbit.rates.node * 60))


def test_velocity_is_the_derivative_of_position() -> None:
    """With J2 too, by differences."""
    orbit = Orbit(
        "8000 km", 0.1, "50 deg", "20 deg", "70 deg", mean_anomaly=1.0, primary=EARTH._replace(J2=0.3), J2=True
    )
    times = np.linspace(0, orbit.period, 9)
    by_differences = (orbit.at(times + 0.1)[0] - orbit.at(times - 0.1)[0]) / 0.2
    assert abs(by_differences - orbit.at(times)[1]).max() < 1e-3


STATES = {
    "leaning": ((-6045e3, -3490e3, 2500e3), (-3.457e3, 6.618e3, 2.533e3)),
    "circular over the equator": ((7000e3, 0.0, 0.0), (0.0, np.sqrt(EARTH.mu / 7000e3), 0.0)),
    "circular over the poles": ((0.0, 5000e3, 5000e3), (0.0, -5.3e3, 5.3e3)),
    "retrograde over the equator": ((0.0, 7000e3, 0.0), (8e3, 0.0, 0.0)),
}


@pytest.mark.parametrize("name", STATES)
def test_an_orbit_through_a_state(name: str) -> None:
    """A quarter of an hour later by REBOUND's integrator; the first is Curtis's example 4.3, in his digits."""
    r, v = STATES[name]
    orbit = Orbit.from_state(r, v)
    assert orbit.at(0.0)[0] == pytest.approx(r, abs=1e-6) and orbit.at(0.0)[1] == pytest.approx(v, abs=1e-9)
    sim = about(orbit)
    sim.add(x=r[0], y=r[1], z=r[2], vx=v[0], vy=v[1], vz=v[2])
    sim.integrate(900.0)
    assert orbit.at(900.0)[0] == pytest.approx(sim.particles[1].xyz, abs=1e-2)
    if name == "leaning":
        angles = np.degrees([orbit.inclination, orbit.node % (2 * np.pi), orbit.perigee])
        assert angles == pytest.approx((153.2, 255.3, 20.07), abs=0.05)
        assert orbit.eccentricity == pytest.approx(0.1712, abs=1e-4)


def over_an_oblate_earth(t: float, state: Any) -> Any:
    """Vallado, Fundamentals of Astrodynamics, equation 8-30."""
    r = state[:3]
    size = np.linalg.norm(r)
    by_j2 = 1.5 * EARTH.J2 * (EARTH.radius / size) ** 2 * (np.array([1, 1, 3]) - 5 * (r[2] / size) ** 2)
    return [*state[3:], *(-EARTH.mu / size**3 * (1 + by_j2) * r)]


@pytest.mark.parametrize("name", ["sun-synchronous", "Molniya"])
def test_an_orbit_with_j2_through_a_state_is_near_for_a_day(name: str) -> None:
    """Within the oscillations of some km, by SciPy; its energy, and so its period, at any place of the orbit."""
    for anomaly in (0.0, 1.0):
        r, v = replace(ORBITS[name], mean_anomaly=anomaly).at(0.0)
        times = np.linspace(0, 86_400, 25)
        path = solve_ivp(over_an_oblate_earth, (0, 86_400), [*r, *v], "DOP853", times, rtol=1e-9, atol=1e-3).y[:3].T
        with_j2, without = (
            np.linalg.norm(Orbit.from_state(r, v, J2=j).at(times)[0] - path, axis=-1) for j in (True, False)
        )
        assert with_j2[0] < 1e-6 and with_j2.max() < 30e3
    assert without.max() > 40e3  # negative control


TLE = (  # the space station, from the documentation of sgp4
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991",
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482",
)


def test_two_line_elements() -> None:
    """Within the oscillations by J2 of the positions of sgp4 in the first revolutions; the epoch of its record."""
    orbit, sat = Orbit.from_tle(*TLE), Satrec.twoline2rv(*TLE)
    assert abs((orbit.epoch - sat_epoch_datetime(sat)).total_seconds()) < 1e-5
    for t in np.linspace(0, 3 * orbit.period, 7):
        _, r, _ = sat.sgp4(sat.jdsatepoch, sat.jdsatepochF + t / 86400)
        assert np.linalg.norm(orbit.at(t)[0] - 1e3 * np.array(r)) < 15e3
    plain = Orbit(orbit.semi_major_axis, orbit.eccentricity, orbit.inclination, orbit.node, orbit.perigee)
    assert np.linalg.norm(plain.at(0.0)[0] - orbit.at(0.0)[0]) > 1e6  # negative control: without the anomaly


SAT = Satrec.twoline2rv(*TLE)


def by_sgp4(t: np.ndarray, which: int = 1) -> np.ndarray:
    """Positions (..., 3), m, or its velocities, which = 2, m/s, at times after the epoch."""
    return 1e3 * SAT.sgp4_array(np.full(len(t), SAT.jdsatepoch), SAT.jdsatepochF + t / 86400)[which]


def test_tables_of_sgp4() -> None:
    """To a millimetre between its positions, 60 s apart; velocities are the rates of these, to their rounding."""
    orbit, t = Orbit.from_tle(*TLE, span="3 h"), np.random.default_rng(0).uniform(60, 3 * 3600 - 60, 300)
    assert abs(orbit.at(t)[0] - by_sgp4(t)).max() < 2e-3
    rates = (by_sgp4(t + 0.5) - by_sgp4(t - 0.5)) / 1.0
    assert abs(orbit.at(t)[1] - rates).max() < 2e-3
    assert 0.01 < abs(by_sgp4(t, 2) - rates).max() < 0.04  # SGP4's velocities are not the rates of its positions
    assert abs(Orbit.from_tle(*TLE).at(t)[0] - by_sgp4(t)).max() > 1e3  # negative control: mean elements alone


def nudge(r: Any) -> Any:
    return 1e-21 * r


def test_a_satellite_is_where_sgp4_has_it() -> None:
    """A ball that hardly turns, with a torque along r: its momentum is the integral of r, in the kernel."""
    ball = Satellite((1.0, 1.0, 1.0), Orbit.from_tle(*TLE, span="3 h"), torque=nudge)
    start = ball.state(spin=(0.0, 0.0, 0.0), attitude=(1, 0, 0, 0))
    run = kr.simulate(ball, start, dt="25 s", t_end="9000 s", every="1500 s")
    times = np.arange(0.0, 9001.0, 2.5)
    want = CubicSpline(times, by_sgp4(times)).antiderivative()(run.time.values)
    assert abs(run.momentum.values / 1e-21 - want).max() < 1e-7 * abs(want).max()
    assert abs(run.position.values - by_sgp4(run.time.values)).max() < 2e-3


def test_tables_of_an_ephemeris() -> None:
    """Dates at unequal steps; with velocities of a flyby, on no ellipse, by REBOUND's integrator."""
    steps = np.cumsum(np.random.default_rng(1).uniform(40, 80, 100)).round(3)
    epoch = np.datetime64("2026-03-20T14:46:00", "ms")
    dates = epoch + np.rint(1e3 * (steps - steps[0])).astype("timedelta64[ms]")
    orbit = Orbit.from_table(dates, by_sgp4(steps))
    t = np.random.default_rng(2).uniform(300, steps[-1] - steps[0] - 300, 100)
    assert orbit.days == pytest.approx(Time("2026-03-20T14:46:00", scale="utc").jd - 2451545.0, abs=1e-9)
    assert abs(orbit.at(t)[0] - by_sgp4(steps[0] + t)).max() < 0.1
    later = Orbit.from_table(dates, by_sgp4(steps), epoch="2026-03-20T14:50:00")
    assert later.days == pytest.approx(Time("2026-03-20T14:50:00", scale="utc").jd - 2451545.0, abs=1e-9)
    assert abs(later.at(t - 240)[0] - by_sgp4(steps[0] + t)).max() < 0.1
    sim = about(orbit)
    sim.add(x=-5e7, y=2e7, vx=5e3)
    states = []
    for when in np.linspace(0, 12_000, 201):
        sim.integrate(when)
        states.append([*sim.particles[1].xyz, *sim.particles[1].vxyz])
    r, v = np.split(np.array(states), 2, -1)
    flyby = Orbit.from_table(np.linspace(0, 12_000, 101), r[::2], v[::2])
    assert np.linalg.norm(v[0]) > np.sqrt(2 * EARTH.mu / np.linalg.norm(r[0]))
    assert abs(flyby.at(np.linspace(0, 12_000, 201))[0] - r).max() < 1e-2


@pytest.mark.parametrize("inclination", ["0 deg", "97 deg"])
def test_a_path_in_a_frame_of_the_earth_is_doubted(inclination: str) -> None:
    """Positions and velocities of ITRF, which agree with each other; in space, with units, they are not doubted."""
    orbit = Orbit("7000 km", 0.01, inclination)
    t = np.arange(0.0, 6000.0, 60.0)
    r, v = orbit.at(t)
    same = Orbit.from_table((t / 60, "min"), (r / 1e3, "km"), (v / 1e3, "km/s"))
    assert abs(same.at(1234.5)[0] - orbit.at(1234.5)[0]).max() < 1e-2
    to_itrf = Rotation.from_rotvec([[0.0, 0.0, -7.292115e-5 * time] for time in t])
    r = to_itrf.apply(r)
    v = to_itrf.apply(v) - np.cross([0.0, 0.0, 7.292115e-5], r)
    for velocities in (None, v):
        with pytest.warns(kr.InputWarning, match="a frame that rotates with the Earth"):
            Orbit.from_table(t, r, velocities)


def hyperbola(t: Any) -> Any:
    """Position and velocity of a flyby of the Earth, 12,000 km from its centre and at 6 km/s far away, by SciPy."""

    def fall(_: float, y: Any) -> Any:
        return [*y[3:], *(-EARTH.mu * y[:3] / np.linalg.norm(y[:3]) ** 3)]

    start = [12e6, 0, 0, 0, np.sqrt(6e3**2 + 2 * EARTH.mu / 12e6), 0]
    ways = [solve_ivp(fall, (0, side * 8e4), start, "DOP853", rtol=1e-12, dense_output=True).sol for side in (1, -1)]
    return np.split(np.where(t >= 0, ways[0](abs(t)), ways[1](-abs(t))).T, 2, -1)


@pytest.mark.parametrize("velocities", [False, True])
@pytest.mark.parametrize(
    ("place", "span", "few", "many"), [("ellipse", 17_500, 15, 40), ("hyperbola", 144_000, 100, 600)]
)
def test_rows_too_far_apart_are_doubted(place: str, span: float, few: int, many: int, velocities: bool) -> None:
    """The warning has the error to a factor of 3; paths without a warning are exact to 3e-4 of their distance."""
    where = hyperbola if place == "hyperbola" else Orbit("7000 km", 0.01, "51 deg", J2=True).at
    times = np.linspace(-span / 2, span / 2, 1501)
    for count in (few, many):
        t = np.linspace(-span / 2, span / 2, count + 1)
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            path = Orbit.from_table(t, *where(t)[: 1 + velocities])
        error = np.linalg.norm(path.at(times)[0] - where(times)[0], axis=-1)
        if count == few:
            km = float(re.search("off by about (.*) km at", str(heard[0].message))[1])  # type: ignore[index]
            assert error.max() / 3e3 < km < 3e-3 * error.max()
        else:
            assert not heard
            assert (error < 3e-4 * np.linalg.norm(where(times)[0], axis=-1)).all()


def test_dates_of_astropy_are_in_utc() -> None:
    """Terrestrial time is 69.184 s ahead of UTC since 2017 (IERS Bulletin C)."""
    t = np.arange(0.0, 3000.0, 60.0)
    dates = Time("2026-03-20T12:01:09.184", scale="tt") + TimeDelta(t, format="sec")
    path = Orbit.from_table(dates, *ORBITS["round"].at(t))
    assert path.days == Orbit("7000 km", epoch=dates[0]).days == Orbit("7000 km", epoch="2026-03-20T12:00:00").days
    assert abs(path.at(90.0)[0] - ORBITS["round"].at(90.0)[0]).max() < 1e-6


@pytest.mark.parametrize("epoch", [None, "2016-12-31T23:30:00"])
def test_seconds_of_a_table_across_a_leap_second(epoch: str | None) -> None:
    """The last second of 2016 was 23:59:60 (IERS Bulletin C 52): astropy counts it; satellites move 7 km in it."""
    orbit, dates = ORBITS["round"], np.arange("2016-12-31T23:40", "2017-01-01T00:30", 60, dtype="datetime64[s]")
    t = (Time(dates, scale="utc") - Time(epoch or dates[0], scale="utc")).sec
    path = Orbit.from_table(dates, orbit.at(t)[0], epoch=epoch)
    middle = (t[1:] + t[:-1]) / 2
    assert abs(path.at(middle)[0] - orbit.at(middle)[0]).max() < 10
    with pytest.raises(kr.InputError, match="expected times of the path"):
        path.at(t[-1] + 0.5)  # a second less without the leap second
    assert path.at(t[-1])[0] == pytest.approx(orbit.at(t[-1])[0], abs=1e-3)


def test_a_state_needs_a_place_at_its_start() -> None:
    t = np.arange(1000.0, 4000.0, 60.0)
    body = Satellite((1, 2, 2.5), Orbit.from_table(t, *ORBITS["round"].at(t)))
    with pytest.raises(kr.InputError, match=r"times of the path, 1000 to 3940 s .* Give state both attitude and spin"):
        body.state()
    start = body.state(attitude=(1, 0, 0, 0), spin=(0, 0, 0))
    run = kr.simulate(body, start, dt="10 s", t_start=1000, t_end="20 min", progress=False)
    assert abs(run.position.values[-1] - ORBITS["round"].at(1200.0)[0]).max() < 1e-6


def test_days_of_an_epoch() -> None:
    for date in ("1999-12-31T23:00:00", "2000-01-01T12:00:00", "2026-03-20T14:46:05"):
        assert Orbit("7000 km", epoch=date).days == pytest.approx(Time(date, scale="utc").jd - 2451545.0, abs=1e-9)


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
