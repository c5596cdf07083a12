"""Orbit of a satellite: position and velocity in space as functions of time, in SI units.

    r = X P + Y Q + path(t),  X = a (cos E - e),  Y = a sqrt(1 - e^2) sin E,  E - e sin E = M_0 + M' t

P points to the pericentre and Q ahead of it, unit vectors.  With J2, the first coefficient of the oblateness of the
primary, whose equator has the radius R, mean elements change at the secular rates of the first order,

    node'    = -(3/2) n J2 (R/p)^2 cos i                         n = sqrt(mu/a^3),  p = a (1 - e^2)
    perigee' = (3/4) n J2 (R/p)^2 (5 cos^2 i - 1)
    M'       = n (1 + (3/4) J2 (R/p)^2 sqrt(1 - e^2) (3 cos^2 i - 1))

without the oscillations within a revolution, of about J2 R, some km in a low orbit of the Earth.  The table `path` has
the differences of positions, such as an ephemeris has, from the ellipse.  Space is the frame of
the elements, whose third axis is the pole of the primary.  [W. M. Kaula, Theory of Satellite Geodesy, 1966, chapter 3]
"""

from __future__ import annotations

from functools import partial
from math import pi
from typing import Any

import numpy as np

from kreisel.algebra import sqrt, vec
from kreisel.algebra.gradient import cos, exp, log, sin, with_slope
from kreisel.errors import InputError, shown
from kreisel.record.contract import Parameter
from kreisel.record.table import EMPTY, Form, check

# -- Kepler's equation for any eccentricity below 1, without a branch, for any kind of number ------


TINY = 1e-300  # so that |0| has a derivative
HALVINGS = 3
ARCSINE = [1.0]  # the series of arcsin s in powers of s^2, for s up to sin(pi/16)
for k in range(1, 11):
    ARCSINE.append(ARCSINE[-1] * (2 * k - 1) ** 2 / (2 * k * (2 * k + 1)))


def size(x: Any) -> Any:
    """|x|, with the derivative 0 at 0."""
    return sqrt(x * x + TINY)


def arcsine(s: Any, c: Any) -> Any:
    """The angle with the sine s and the cosine c >= 0, by halving."""
    for _ in range(HALVINGS):
        above = sqrt((1 + c) / 2)
        s, c = s / (2 * above), above
    return 2**HALVINGS * s * polynomial(ARCSINE, s * s)


def polynomial(coefficients: list[float], x: Any) -> Any:
    """The sum of coefficients[k] x^k."""
    total: Any = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = coefficient + x * total
    return total


def less_whole_turns(angle: Any) -> Any:
    """The angle between -pi and pi, modulo 2 pi."""
    return with_slope(_from_its_half, angle, 1.0)


def _from_its_half(angle: Any) -> Any:
    """Computed from the sine and cosine of its half."""
    s, c = sin(angle / 2), cos(angle / 2)
    return 2 * arcsine(s * (c / size(c)), size(c))


def eccentric_anomaly(mean: Any, e: Any) -> Any:
    """E with E - e sin E = mean, modulo 2 pi: to 4e-16 in position up to e = 0.9, 1e-14 at 0.9999.

    [F. L. Markley, Celest. Mech. Dyn. Astron. 63 (1995) 101: a cubic equation, then one correction of order 5]
    """
    M = less_whole_turns(mean)
    alpha = (3 * pi * pi + 1.6 * pi * (pi - size(M)) / (1 + e)) / (pi * pi - 6)
    d = 3 * (1 - e) + alpha * e
    q = 2 * alpha * d * (1 - e) - M * M
    r = 3 * alpha * d * (d - 1 + e) * M + M * M * M
    w = exp(log(size(r) + sqrt(q * q * q + r * r)) * (2 / 3))
    E = (2 * r * w / (w * w + w * q + q * q) + M) / d
    s, c = e * sin(E), e * cos(E)
    miss, slope = E - s - M, 1 - c
    by = -miss / (slope - 0.5 * miss * s / slope)
    by = -miss / (slope + 0.5 * by * s + by * by * c / 6)
    return E - miss / (slope + 0.5 * by * s + by * by * c / 6 - by * by * by * s / 24)


# -- position and velocity -------------------------------------------------------------------------

TURN = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])  # x @ TURN = z cross x
EQUATOR, POLE = np.array([1, 1, 0]), np.array([0, 0, 1])


PATH = Form(columns=3, degree=5, halvings=0)


def place(t, orbit, path):
    """Position r, m, and velocity v, m/s, (..., 3) in space at t (...), s.

    orbit (12,): entries of `of_elements`; path: a `Reader` of the form `PATH`
    """
    rate, phase, e, a, node, perigee = orbit[:6]
    M = phase + rate * t
    E = M + e * sin(eccentric_anomaly(M, e))  # so that a kernel for e = 0 does not solve the equation
    c, s, b = cos(E), sin(E), a * sqrt(1 - e * e)
    X, Y, fast = a * (c - e), b * s, rate / (1 - e * c)
    X, Y = _turned(X, Y, perigee * t)
    U, V = _turned(-fast * a * s, fast * b * c, perigee * t)
    r = _in_space(X, Y, orbit, node * t)
    v = _in_space(U - perigee * Y, V + perigee * X, orbit, node * t) + vec(node) * (r @ TURN)
    return r + np.asarray(path(t)), v + np.asarray(path(t, 1))


def _turned(x, y, angle):
    c, s = cos(angle), sin(angle)
    return c * x - s * y, s * x + c * y


def _in_space(x, y, orbit, angle):
    """x P + y Q, rotated about the pole."""
    p = vec(x) * orbit[6:9] + vec(y) * orbit[9:12]
    return vec(cos(angle)) * (p * EQUATOR) + vec(sin(angle)) * (p @ TURN) + p * POLE


def of_elements(*, semi_major_axis, eccentricity, inclination, node, perigee, mean_anomaly, mu, radius, J2):
    """The orbit for `place`: M', M_0, e, a, node', perigee', P, Q as one vector (..., 12)."""
    (ci, si), (cn, sn), (cp, sp) = ((np.cos(x), np.sin(x)) for x in (inclination, node, perigee))
    P = [cn * cp - sn * sp * ci, sn * cp + cn * sp * ci, sp * si]
    Q = [-cn * sp - sn * cp * ci, -sn * sp + cn * cp * ci, cp * si]
    a, n = semi_major_axis, np.sqrt(mu / semi_major_axis) / semi_major_axis
    root = np.sqrt(1 - eccentricity**2)
    slow = 0.75 * n * J2 * (radius / (a * root**2)) ** 2
    rates = n + slow * root * (3 * ci * ci - 1), -2 * slow * ci, slow * (5 * ci * ci - 1)
    return np.stack(np.broadcast_arrays(rates[0], mean_anomaly, eccentricity, a, *rates[1:], *P, *Q), -1)


# -- parameters ------------------------------------------------------------------------------------

LOWEST = 80e3 / 6_378_137.0  # height over radius of the primary: no orbit of the Earth lasts below 80 km


def doubtful_orbit(pericentre, radius, name="primary"):
    """Sentences on orbits that touch the air."""
    height, least = np.min(pericentre - radius), LOWEST * np.max(radius)
    if height < least:
        yield (
            f"The orbit comes within {height:g} m of the surface of the {name}: expected {least / 1e3:.3g} km or more. "
            f"Usual cause: km for m. '{height:g} km', where units are read, is {1e3 * height:g}."
        )


def expected(good, text):
    """A check of a parameter: raises `InputError` unless good(value), with a text of the values that are expected."""

    def check(value, name):
        if not np.all(good(value)):
            raise InputError(f"{name}: expected {text}, got {shown(value.tolist())}.")

    return check


def check_pericentre(distance, radius, name="primary"):
    if (distance <= radius).any():
        raise InputError(
            f"The orbit hits the {name}: its pericentre is {np.min(distance):g} m from the centre, the radius is "
            f"{np.max(radius):g} m. Usual cause: an altitude for a semi-major axis, or km for m."
        )


check_positive = expected(lambda x: x > 0, "a number > 0")
check_not_negative = expected(lambda x: x >= 0, "a number >= 0")
check_eccentricity = expected(lambda x: (x >= 0) & (x < 1), "an ellipse, 0 <= e < 1")
EARTH = 3.986004418e14  # mu, m^3/s^2, WGS 84
ORBIT = (
    Parameter("semi_major_axis", "scalar", "of the orbit, m", check_positive),
    Parameter("eccentricity", "scalar", "of the orbit", check_eccentricity, 0.0),
    Parameter("inclination", "scalar", "of the orbit to the equator of the primary, rad", default=0.0),
    Parameter("node", "scalar", "angle of the ascending node, rad", default=0.0),
    Parameter("perigee", "scalar", "angle from the node to the pericentre, rad", default=0.0),
    Parameter("mean_anomaly", "scalar", "at t = 0, rad; 0 at the pericentre", default=0.0),
    Parameter("mu", "scalar", "gravitational parameter of the primary, m^3/s^2", check_positive, EARTH),
    Parameter("radius", "scalar", "of the primary, m: no orbit goes below", check_not_negative, 6_378_137.0),
    Parameter("J2", "scalar", "oblateness of the primary: secular rates of node, perigee, anomaly", default=0.0),
    Parameter("path", "table", "in time, added to the position on the ellipse, m", partial(check, form=PATH), EMPTY),
)
