"""Environment of the Earth at a date: IGRF-14, the rotation of the Earth, the Sun, tables of the air.

Dates are days of UTC after 2000-01-01 12:00; UTC is used for UT1 and TT, which differ from it by less than 1 s and by
69 s.  Space is the frame of the mean equator and the mean equinox at the epoch.  The results are parameters of
`kreisel.bodies.orbit`.
"""

from __future__ import annotations

import datetime as dt
import tomllib
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, require_one_of, shown
from kreisel.physical.measures import direction

if TYPE_CHECKING:
    from kreisel.physical.orbit import Orbit
    from kreisel.physical.satellite import Satellite

DAY = 86_400.0  # s
CENTURY = 36_525.0  # days
DEGREE = 13  # of IGRF
TURNS_A_DAY = 1.00273781191135448  # of the Earth against the stars, IERS Conventions (2010), equation 5.15
ROTATION = 2 * np.pi * TURNS_A_DAY / DAY  # rad/s


# -- magnetic field --------------------------------------------------------------------------------


@cache
def _igrf() -> tuple[Array, Array]:
    """The first days of its epochs, and the coefficients (195, epochs) in T, g_10, g_11, h_11, g_20, ..."""
    lines = resources.files("kreisel.physical").joinpath("igrf14.txt").read_text("ascii").splitlines()
    years, *rows = (line.split() for line in lines if line[0] != "#")
    days = [dt.date(int(year), 1, 1).toordinal() - dt.date(2000, 1, 1).toordinal() - 0.5 for year in years]
    return np.array(days), np.array([[float(x) for x in row[2:]] for row in rows]) * 1e-9


def igrf(days: float, degree: int = DEGREE) -> Array:
    """Coefficients of IGRF-14 at a date and their rates, (degree (degree + 2), 2), T and T/s.

    Linear between the epochs, five years apart; after 2025 with the secular variation.  Raises `InputError` for a date
    outside 1900 to 2030 and for a degree other than 1 to 13.  [P. Alken et al., Earth, Planets and Space 73 (2021) 49;
    IAGA, 2024, doi 10.5281/zenodo.14012302]
    """
    if isinstance(degree, bool) or degree not in range(1, DEGREE + 1):
        raise InputError(f"degree: expected an integer from 1 to {DEGREE}, got {shown(degree)}.")
    epochs, values = _igrf()
    if not epochs[0] <= days <= epochs[-1]:
        date = dt.datetime(2000, 1, 1, 12) + dt.timedelta(days=days)
        raise InputError(
            f"epoch: IGRF-14 holds from 1900-01-01 to 2030-01-01, got {date:%Y-%m-%d}. For other dates use "
            "magnetic_field='dipole'."
        )
    at = min(int(np.searchsorted(epochs, days, side="right")), len(epochs) - 1)
    low, high = values[: degree * (degree + 2), at - 1 : at + 1].T
    rate = (high - low) / (epochs[at] - epochs[at - 1])
    return np.stack([low + (days - epochs[at - 1]) * rate, rate / DAY], -1)


def igrf_until() -> float:
    """The last day of IGRF-14, after 2000-01-01 12:00."""
    return float(_igrf()[0][-1])


def meridian(days: float) -> Array:
    """Greenwich mean sidereal time, rad, and the rate of the Earth's rotation against the stars, rad/s.

    Without nutation and polar motion, up to 17" together and 20" a year of precession of the pole from the epoch on.
    [IERS Conventions (2010), equations 5.14, 5.15 and 5.32]
    """
    T = days / CENTURY
    seconds = 0.014506 + (4612.156534 + (1.3915817 - 0.00000044 * T) * T) * T
    turns = 0.7790572732640 + (TURNS_A_DAY - 1) * days + days % 1.0
    return np.array([2 * np.pi * (turns % 1.0) + np.radians(seconds / 3600), ROTATION])


# -- Sun -------------------------------------------------------------------------------------------

PRECESSION = 5028.796195 / 3600  # degrees a century along the ecliptic, IAU 2006


def motion_of_sun(days: float) -> dict[str, Array]:
    """Motion of the Sun seen from the Earth, with aberration, to 0.01 degrees.

    [Meeus, Astronomical Algorithms, 2nd ed., 1998, chapter 25, low accuracy, without the term in 3M; equation 22.2]

    Its longitudes count from the equinox of the date; here from the equinox of the epoch.
    """
    T = days / CENTURY
    L, n = 280.46646 + (36000.76983 + 0.0003032 * T) * T, 36000.76983 - PRECESSION
    M, m = 357.52911 + (35999.05029 - 0.0001537 * T) * T, 35999.05029
    e = 0.016708634 - (0.000042037 + 0.0000001267 * T) * T
    C = [1.914602 - (0.004817 + 0.000014 * T) * T, 0.019993 - 0.000101 * T]
    tilt, perihelion = np.radians(23.439291 - 0.0130042 * T), np.radians(L - M)
    angles = np.radians([(L - 0.00569) % 360, n / CENTURY / DAY, M % 360, m / CENTURY / DAY, *C])
    ellipse = [e * np.cos(perihelion), e * np.sin(perihelion), 1 - 1.000001018 * (1 - e * e)]
    return {
        "sun": np.array([1.0, 0.0, 0.0]),
        "sun_ahead": np.array([0.0, np.cos(tilt), np.sin(tilt)]),
        "solar": np.array([*angles, *ellipse]),
    }


# -- air -------------------------------------------------------------------------------------------


@cache
def tables() -> dict[str, Array]:
    """The tables of air.toml: rows of height, density by night and in the bulge, in SI."""
    data = tomllib.loads(resources.files("kreisel.physical").joinpath("air.toml").read_text("utf-8"))
    return {name: np.array([[1e3 * row[0], row[1], row[-1]] for row in rows]) for name, rows in data.items()}


def rows_between(table: Array, low: float, high: float) -> Array:
    """The rows of a table of the air for heights from low to high, m, and one beyond at each end.

    The last slope extends above the table.  Raises `InputError` for an orbit whose lowest height is outside the table.
    """
    heights = table[:, 0]
    if not heights[0] <= low <= heights[-1]:
        raise InputError(
            f"air: the table holds from {heights[0] / 1e3:g} to {heights[-1] / 1e3:g} km, the lowest height of the "
            f"orbit is {low / 1e3:.6g} km. For another height give its density=..., in kg/m^3, without air=..."
        )
    first = min(int(np.searchsorted(heights, low, side="right")) - 1, len(heights) - 2)
    last = max(int(np.searchsorted(heights, high)), first + 1)
    return table[first : last + 1]


# -- a satellite -----------------------------------------------------------------------------------

FIELDS = ("igrf", "dipole", "tilted-dipole")


def environment_of(body: Satellite) -> dict[str, Any]:
    """Parameters of `kreisel.bodies.orbit` for a satellite, or for all lanes.  Raises `InputError`."""
    orbit, sun, eclipse = body.orbit, body.sun, body.eclipse
    dated = orbit.epoch is not None and orbit.primary.earthly
    magnetic_field = body.magnetic_field or ("igrf" if dated else "dipole")
    require_one_of(FIELDS, magnetic_field, "magnetic_field")
    out: dict[str, Any] = {"field": orbit.primary.field}
    if magnetic_field != "dipole":
        _require_date(orbit, f"magnetic_field={magnetic_field!r}")
        gauss = igrf(orbit.days, body.degree if magnetic_field == "igrf" else 1)
        out = {"field": 0.0, "gauss": gauss, "meridian": meridian(orbit.days)}
    if eclipse is not None and not isinstance(eclipse, bool):
        raise InputError(f"eclipse: expected True or False, got {shown(eclipse)}.")
    moves = dated if sun is None else isinstance(sun, str)
    out["eclipse"] = float(moves if eclipse is None else eclipse)
    if moves:
        if sun not in (None, "ephemeris"):
            raise InputError(f"sun: expected 'ephemeris' or a direction in space, got {shown(sun)}.")
        _require_date(orbit, "sun='ephemeris'")
        out |= motion_of_sun(orbit.days)
    elif sun is not None:
        out["sun"] = direction(sun, "sun")
    return out | ({"density": body.density} if body.air is None else _air(body))


def _require_date(orbit: Orbit, wish: str) -> None:
    if not orbit.primary.earthly:
        raise InputError(f"{wish}: expected an orbit of the Earth, got one of the primary {orbit.primary.name}.")
    if orbit.epoch is None:
        raise InputError(f"{wish}: expected a date, Orbit(..., epoch='2026-03-20T14:46:00') in UTC, got none.")


def _air(body: Satellite) -> dict[str, Any]:
    orbit = body.orbit
    if not orbit.primary.earthly:
        raise InputError(f"air: expected an orbit of the Earth, got one of the primary {orbit.primary.name}.")
    require_one_of(tables(), body.air, "air")
    if body.density:
        raise InputError("air: expected no density with it, got both. Give one of the two.")
    if body.air == "harris-priester" and body.sun is None:
        _require_date(orbit, "air='harris-priester'")  # the Sun by its date
    R, f = orbit.primary.radius, orbit.primary.flattening
    orbits = [lane.orbit for lane in body._lanes] or [orbit]
    low = min(path.semi_major_axis * (1 - path.eccentricity) for path in orbits) - R
    high = max(path.semi_major_axis * (1 + path.eccentricity) for path in orbits) - R * (1 - f)
    return {
        "density": 1.0,
        "air": rows_between(tables()[cast("str", body.air)], low, high),
        "bulge": 2 + 4 * np.sin(orbit.inclination) ** 2,
        "flattening": f,
        "air_rate": ROTATION,
    }
