"""Constants of nature and units of measure, judged by astropy, SciPy, sgp4 and pint."""

from __future__ import annotations

import astropy.constants
import astropy.coordinates
import numpy as np
import pint
import pytest
import scipy.constants
from astropy import units as u
from sgp4.propagation import getgravconst

from kreisel.physical import EARTH, SATURN, SOLAR_PRESSURE, STANDARD_GRAVITY, SUN
from kreisel.physical.orbit import ASTRONOMICAL_UNIT
from kreisel.units import registry, si


def test_constants_that_are_definitions() -> None:
    assert scipy.constants.g == astropy.constants.g0.si.value == STANDARD_GRAVITY
    assert scipy.constants.au == astropy.constants.au.si.value == ASTRONOMICAL_UNIT
    assert astropy.constants.GM_sun.si.value == SUN.mu
    assert astropy.constants.R_sun.si.value == SUN.radius


def test_the_earth_is_that_of_wgs_84() -> None:
    _, mu, radius, _, J2, *_ = getgravconst("wgs84")  # km^3/s^2 to seven digits, km
    assert J2 == EARTH.J2
    assert pytest.approx(1e9 * mu, rel=2e-7) == EARTH.mu
    assert pytest.approx(1e3 * radius, rel=1e-12) == EARTH.radius
    assert astropy.coordinates.WGS84GeodeticRepresentation._equatorial_radius.si.value == EARTH.radius
    assert pytest.approx(astropy.constants.GM_earth.si.value, rel=1e-6) == EARTH.mu


def test_saturn_holds_titan() -> None:
    """Kepler's third law with Titan's period of 15.945 days at 1,221,870 km, and 60,268 km at the equator (NASA)."""
    assert 4 * np.pi**2 * 1.22187e9**3 / (15.945 * 86400) ** 2 == pytest.approx(SATURN.mu, rel=1e-3)
    assert SATURN.radius == 60_268e3


def test_the_pressure_of_sunlight() -> None:
    """The luminosity of the Sun over the sphere at 1 au and the speed of light, by astropy."""
    flux = astropy.constants.L_sun / (4 * np.pi * (1 * u.au) ** 2)
    assert (flux / astropy.constants.c).to_value("N/m^2") == pytest.approx(SOLAR_PRESSURE, rel=1e-3)


UNITS = {  # text for pint: the SI unit that arguments have, the quantity of astropy
    "3 kg": ("kg", 3 * u.kg),
    "250 g": ("kg", 250 * u.g),
    "15 cm": ("m", 15 * u.cm),
    "550 km": ("m", 550 * u.km),
    "1 au": ("m", 1 * u.au),
    "300 cm^2": ("m^2", 300 * u.cm**2),
    "97.5 deg": ("rad", 97.5 * u.deg),
    "12 arcsec": ("rad", 12 * u.arcsec),
    "0.25 turn": ("rad", 0.25 * u.cycle),
    "180 rpm": ("rad/s", 180 * u.cycle / u.min),
    "3 turn/s": ("rad/s", 3 * u.cycle / u.s),
    "5 deg/s": ("rad/s", 5 * u.deg / u.s),
    "1 ms": ("s", 1 * u.ms),
    "2 h": ("s", 2 * u.h),
    "2 days": ("s", 2 * u.day),
    "40 kg cm^2": ("kg m^2", 40 * u.kg * u.cm**2),
    "5 g cm^3": ("kg m^3", 5 * u.g * u.cm**3),
    "5 g cm^4": ("kg m^4", 5 * u.g * u.cm**4),
    "3 mN m s": ("N m s", 3 * u.mN * u.m * u.s),
    "4 g m^2/s": ("kg m^2/s", 4 * u.g * u.m**2 / u.s),
    "2 N mm": ("N m", 2 * u.N * u.mm),
    "0.1 A m^2": ("A m^2", 0.1 * u.A * u.m**2),
    "30 nT m^3": ("T m^3", 30 * u.nT * u.m**3),
    "398600.4418 km^3/s^2": ("m^3/s^2", 398600.4418 * u.km**3 / u.s**2),
    "998 kg/m^3": ("kg/m^3", 998 * u.kg / u.m**3),
    "1 g/cm^3": ("kg/m^3", 1 * u.g / u.cm**3),
    "36 km/h": ("m/s", 36 * u.km / u.h),
    "981 cm/s^2": ("m/s^2", 981 * u.cm / u.s**2),
    "2 S cm^4": ("S m^4", 2 * u.S * u.cm**4),
    "4.54 uPa": ("N/m^2", 4.54 * u.uPa),
    "7 N s/m": ("N s/m", 7 * u.N * u.s / u.m),
    "7 N s^2/m^2": ("N s^2/m^2", 7 * u.N * u.s**2 / u.m**2),
    "2 mJ": ("J", 2 * u.mJ),
}


@pytest.mark.parametrize("text", UNITS)
def test_units_of_pint_are_those_of_astropy(text: str) -> None:
    unit, quantity = UNITS[text]
    want = quantity.to_value(u.Unit(unit))
    assert si(text, unit, "x") == pytest.approx(want, rel=1e-12)
    assert si(quantity, unit, "x") == pytest.approx(want, rel=1e-12)
    assert si(registry().Quantity(text), unit, "x") == pytest.approx(want, rel=1e-12)


def test_units_by_hand() -> None:
    """Digits that anyone can check."""
    assert si("180 rpm", "rad/s", "x") == pytest.approx(18.849556, abs=1e-6)
    assert si("36 km/h", "m/s", "x") == pytest.approx(10)
    assert si("1 lbf", "N", "x") == pytest.approx(4.4482216, abs=1e-6)
    assert pint.UnitRegistry().Quantity("1 inch").to("m").magnitude == si("1 inch", "m", "x") == 0.0254
