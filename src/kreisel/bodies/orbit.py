"""Orbit of a satellite and the environment along it, as functions of time and place, in SI units.

Position and velocity in space:

    r = X P + Y Q + path(t),  X = a (cos E - e),  Y = a sqrt(1 - e^2) sin E,  E - e sin E = M_0 + M' t

P points to the pericentre and Q ahead of it, unit vectors.  With J2, the first coefficient of the oblateness of the
primary, whose equator has the radius R, mean elements change at the secular rates of the first order,

    node'    = -(3/2) n J2 (R/p)^2 cos i                         n = sqrt(mu/a^3),  p = a (1 - e^2)
    perigee' = (3/4) n J2 (R/p)^2 (5 cos^2 i - 1)
    M'       = n (1 + (3/4) J2 (R/p)^2 sqrt(1 - e^2) (3 cos^2 i - 1))

without the oscillations within a revolution, of about J2 R, some km in a low orbit of the Earth.  The table `path` has
the differences of positions, such as an ephemeris has, from the ellipse.  Space is the frame of the elements, whose
third axis is the pole of the primary.  [W. M. Kaula, Theory of Satellite Geodesy, 1966, chapter 3]

Magnetic field, Sun, shadow and air at a place and a time: space is the frame of the mean equator and the mean equinox
at the epoch t = 0; its third axis is the axis of the primary.  Places r and directions are (3,), of any kind of number,
or with further axes behind.

    B = -grad V,   V = R sum over n, m of (R/r)^(n+1) P_nm(sin phi) (g_nm cos m lambda + h_nm sin m lambda)

with g_nm + t g_nm' for g_nm, P_nm normalized after Schmidt, lambda = longitude in the primary, whose meridian rotates
by the angle meridian[0] + meridian[1] t from the equinox.  With (s, t, u) = r/|r|, q = R/|r| and A_nm = d^m P_n/du^m,

    a = sum of q^(n+2) (m A_nm (g c_(m-1) + h s_(m-1)), m A_nm (h c_(m-1) - g s_(m-1)), A_n(m+1) (g c_m + h s_m))
    B = (sum of q^(n+2) A_(n+1)(m+1) (g c_m + h s_m)) r/|r| - a,        c_m + i s_m = (s + i t)^m

which has no angle of the place and is regular at the poles.  [S. Pines, AIAA Journal 11 (1973) 1508]

    Sun      sun cos l + sun_ahead sin l,   l = L + n t + C_1 sin M + C_2 sin 2M,   M = M_0 + m t
             solar = (L, n, M_0, m, C_1, C_2, a, b, k),   1/distance = (1 + a cos l + b sin l)/(1 - k) in au
             [Meeus, Astronomical Algorithms, 1998, chapter 25];  -r/|r| around the Sun, heliocentric = 1
    light    1 - (part of the Sun's disc behind the primary, a sphere): two circles on the sky
    air      between the rows (height, density by night, density in the bulge) of a table the logarithms are linear;
             night + (bulge - night) cos^n(psi/2), psi the angle from the bulge, which follows the Sun 30 degrees later
             [Montenbruck, Gill, Satellite Orbits, 2000, section 3.5]
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from math import isqrt, pi, prod, sqrt as root
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import maximum, sqrt, vec
from kreisel.algebra.gradient import cos, exp, log, sin, with_slope
from kreisel.algebra.invariants import cross, inner
from kreisel.errors import InputError, shown
from kreisel.record.contract import Parameter
from kreisel.record.table import EMPTY, Form, check

# -- Kepler's equation for any eccentricity below 1, without a branch, for any kind of number ------


TINY = 1e-300  # so that |0| has a derivative
SEGMENT = [2 / 3, 1 / 5, 3 / 28, 5 / 72, 35 / 704]  # arcsin w - w sqrt(1 - w^2) = w^3 (2/3 + w^2/5 + ...)
IN_LINE = 1e-18  # the square of an angle, so that a quotient by it has 5 digits
LAG = root(3) / 2, 0.5  # cosine and sine of 30 degrees
HALVINGS = 3
ARCSINE = [1.0]  # the series of arcsin s in powers of s^2, for s up to sin(pi/16)
for k in range(1, 11):
    ARCSINE.append(ARCSINE[-1] * (2 * k - 1) ** 2 / (2 * k * (2 * k + 1)))


def size(x: Any) -> Any:
    """|x|, with the derivative 0 at 0."""
    return sqrt(x * x + TINY)


def ramp(x):
    """x if x > 0, else 0."""
    return (x + size(x)) / 2


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


def axes(t, orbit):
    """To the pericentre, ahead of it and the normal at t (...), as columns (..., 3, 3)."""
    node, perigee = orbit[4] * t, orbit[5] * t
    P, Q = (_in_space(x, y, orbit, node) for x, y in (_turned(1, 0, perigee), _turned(0, 1, perigee)))
    return np.stack([P, Q, np.cross(P, Q)], -1)


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


# -- parameters of the orbit -----------------------------------------------------------------------

LOWEST = 80e3 / 6_378_137.0  # height over radius of the primary: no orbit of the Earth lasts below 80 km


def doubtful_orbit(pericentre, radius, name="primary"):
    """Sentences on orbits that touch the air."""
    heights, most = np.broadcast_arrays(pericentre - radius, LOWEST * radius)
    worst = np.argmin(heights - most)  # of lanes
    height, least = heights.flat[worst], most.flat[worst]
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
ASTRONOMICAL_UNIT = 149_597_870_700.0  # m, IAU 2012
MU_SUN = 1.3271244e20  # m^3/s^2, IAU 2015 B3
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


# -- magnetic field --------------------------------------------------------------------------------


def of_dipole(r, f):
    """B of a dipole along the third axis, f = R^3 g_10."""
    square = inner(r, r)
    z = r[2] / square
    return np.array([3 * z * r[0], 3 * z * r[1], 3 * z * r[2] - 1]) * (f / (square * sqrt(square)))


def degree_of(gauss):
    """The degree N of a field of N (N + 2) coefficients g_10, g_11, h_11, g_20, ..."""
    return isqrt(len(gauss) + 1) - 1


def scale(n, m):
    """The factor from d^m P_n/du^m, over its value at n = m, to Schmidt's normalization."""
    product = 1.0 if m == 0 else 2.0
    for k in range(n - m + 1, n + m + 1):
        product /= k
    return root(product) * float(prod(range(1, 2 * m, 2)))


def field(r, t, *, gauss, reference_radius, meridian):
    """B, T, at the place r, m; gauss: rows (g, g'), T and T/s."""
    angle = meridian[0] + meridian[1] * t
    c, s = cos(angle), sin(angle)
    x, y, z = r
    values = [row[0] + row[1] * t for row in scaled(gauss)]
    X, Y, Z = field_of(np.array([c * x + s * y, c * y - s * x, z]), values, reference_radius)
    return np.array([c * X - s * Y, s * X + c * Y, Z])


def scaled(gauss):
    """The rows in the normalization of `scale`."""
    places = [(n, m) for n in range(1, degree_of(gauss) + 1) for m in range(n + 1) for _ in range(1 + (m > 0))]
    return [scale(n, m) * row for (n, m), row in zip(places, gauss, strict=True)]


def field_of(r, values, R):
    """B in the frame of the primary, of coefficients in the normalization of `scale`."""
    N = degree_of(values)
    length = sqrt(inner(r, r))
    (s, t, u), q = r / length, R / length
    P = legendre(N + 1, u * q, q)
    across, ahead, up, out = 0.0, 0.0, 0.0, 0.0
    before, turned = (0.0, 0.0), (1.0, 0.0)  # (s + i t)^(m-1), (s + i t)^m
    for m in range(N + 1):
        plain, rise, radial = ([0.0, 0.0] for _ in range(3))
        for n in range(max(m, 1), N + 1):
            at = n * n - 1 + (2 * m - 1 if m else 0)
            for k in range(2 if m else 1):  # g, h
                plain[k] = plain[k] + P[n, m] * values[at + k]
                radial[k] = radial[k] + P[n + 1, m + 1] * values[at + k]
                if n > m:
                    rise[k] = rise[k] + P[n, m + 1] * values[at + k]
        across = across + m * (plain[0] * before[0] + plain[1] * before[1])
        ahead = ahead + m * (plain[1] * before[0] - plain[0] * before[1])
        up = up + (2 * m + 1) * (rise[0] * turned[0] + rise[1] * turned[1])
        out = out + (2 * m + 1) * (radial[0] * turned[0] + radial[1] * turned[1])
        before, turned = turned, (turned[0] * s - turned[1] * t, turned[0] * t + turned[1] * s)
    out = out / q
    return out * s - across, out * t - ahead, out * u - up


def legendre(N, uq, q):
    """q^(n+2) A_nm/A_mm for 0 <= m <= n <= N, with u q and q."""
    P = {}
    square = q * q
    power = square
    for m in range(N + 1):
        P[m, m] = power
        power = power * q
        if m < N:
            P[m + 1, m] = (2 * m + 1) * uq * P[m, m]
        for n in range(m + 2, N + 1):
            first, second = (2 * n - 1) / (n - m) * uq, (n + m - 1) / (n - m) * square
            P[n, m] = first * P[n - 1, m] - second * P[n - 2, m]
    return P


# -- Sun and shadow --------------------------------------------------------------------------------


def sunlight(t, *, sun, sun_ahead, solar):
    """The direction of the Sun, and 1 au over its distance."""
    L, n, M, m, C1, C2, a, b, k = solar
    s, c = sin(M + m * t), cos(M + m * t)
    longitude = L + n * t + s * (C1 + 2 * C2 * c)
    x, y = cos(longitude), sin(longitude)
    return np.array([sun[i] * x + sun_ahead[i] * y for i in range(3)]), (1 + a * x + b * y) / (1 - k)


def light(r, s, near, *, eclipse, shadow, disc):
    """The fraction of the Sun's disc that is seen.

    shadow    the radius of the primary, m;  disc: the sine of the angular radius of the Sun at 1 au
    eclipse   1, or 0 for none

    With angular radii a of the Sun, b of the primary and the angle c between them,

        cos alpha = (cos b - cos a cos c)/(sin a sin c),   -1 <= cos alpha <= 1
        hidden part = (alpha - sin alpha cos alpha + (B/A)^2 (arcsin w - w sqrt(1 - w^2)))/pi,   w = (A/B) sin alpha

    with the radii A, B of the circles in the stereographic projection that has the Sun in its centre, where circles
    are circles.  Needs A < B/3: for the Earth, distances up to 70 of its radii.
    """
    length = sqrt(inner(r, r))
    sin_a, sin_b = disc * near, shadow / length
    cos_a, cos_b = sqrt(1 - sin_a * sin_a), sqrt(ramp(1 - sin_b * sin_b) + TINY)
    cos_c = -inner(r, s) / length
    x = cross(r, s)
    sin_c = sqrt(inner(x, x) / (length * length) + IN_LINE)
    between, most = cos_b - cos_a * cos_c, sin_a * sin_c + TINY
    cosine = within((size(between + most) - size(between - most)) / (2 * most))
    sine = sqrt(ramp(1 - cosine * cosine) + TINY)
    w = sine * sin_a * (cos_b + cos_c) / ((1 + cos_a) * sin_b + TINY)  # A/B = sin a (cos b + cos c)/((1 + cos a) sin b)
    alpha = pi / 2 - arcsine(cosine, sine)
    behind = alpha - sine * cosine + sine * sine * w * polynomial(SEGMENT, w * w)
    return ramp(1 - eclipse * behind / pi)


def within(x):
    """x between -1 and 1, else the nearer of them."""
    return (size(x + 1) - size(x - 1)) / 2


# -- air -------------------------------------------------------------------------------------------


def height(r, *, radius, flattening):
    """Height over the ellipsoid along the radius: for the Earth at most 40 m more than along its normal."""
    x, y, z = r
    square = x * x + y * y + z * z
    out = 1 - flattening
    return sqrt(square) - radius * out / sqrt(1 - flattening * (1 + out) * (x * x + y * y) / square)


def density_of_air(r, s, *, density, air, bulge, radius, flattening):
    """Density, kg/m^3: `density` times the values of the table `air`, whose first and last slope extend beyond it.

    s: the direction of the Sun;  bulge: the exponent n
    """
    h = height(r, radius=radius, flattening=flattening)
    rows = [(row[0], log(row[1]), log(row[2])) for row in air]
    slopes = [[(high[k] - low[k]) / (high[0] - low[0]) for k in (1, 2)] for low, high in pairwise(rows)]
    logs = [rows[0][k] + slopes[0][k - 1] * (h - rows[0][0]) for k in (1, 2)]
    for row, before, after in zip(rows[1:], slopes, slopes[1:], strict=False):
        beyond = ramp(h - row[0])
        logs = [logs[k] + (after[k] - before[k]) * beyond for k in (0, 1)]
    night, day = map(exp, logs)
    c, lag = LAG
    apex = [c * s[0] - lag * s[1], lag * s[0] + c * s[1], s[2]]
    toward = inner(r, apex) / sqrt(inner(r, r))
    return density * (night + (day - night) * exp(bulge / 2 * log(ramp((1 + toward) / 2) + TINY)))


def through_air(r, v, *, air_rate):
    """The velocity relative to air that rotates about the third axis at that rate."""
    return np.array([v[0] + air_rate * r[1], v[1] - air_rate * r[0], v[2]])


# -- everything ------------------------------------------------------------------------------------


class Around(NamedTuple):
    """The environment at a place."""

    field: Any  # of the coefficients `gauss`, T
    sun: Any  # direction of the Sun
    near: Any  # 1 au over its distance
    light: Any  # fraction of its disc that is seen
    density: Any  # of the air, kg/m^3
    stream: Any  # velocity in it, m/s


def around(r, v, t, *, radius, gauss, reference_radius, meridian, heliocentric, eclipse, disc, air_rate, **others):
    """The environment at the place r, with the velocity v, at the time t."""
    s, near = sunlight(t, **{name: others.pop(name) for name in ("sun", "sun_ahead", "solar")})
    inward, outside = heliocentric / sqrt(inner(r, r)), 1 - heliocentric
    s, near = outside * s - inward * r, outside * near + ASTRONOMICAL_UNIT * inward
    B = field(r, t, gauss=gauss, reference_radius=reference_radius, meridian=meridian)
    seen = light(r, s, near, eclipse=eclipse, shadow=maximum(radius, 1.0), disc=disc)  # NaN for 0 m
    density = density_of_air(r, s, radius=radius, **others)
    return Around(B, s, near, seen, density, through_air(r, v, air_rate=air_rate))


# -- parameters of the environment -----------------------------------------------------------------


def is_gauss(value):
    return value.ndim == 2 and value.shape[1] == 2 and degree_of(value) * (degree_of(value) + 2) == len(value)


def is_air(value):
    rows = value.ndim == 2 and value.shape[1] == 3 and len(value) > 1
    return rows and (np.diff(value[:, 0]) > 0).all() and (value[:, 1:] > 0).all()


check_direction = expected(lambda v: abs((v * v).sum(-1) - 1) < 1e-9, "a vector of length 1")
check_gauss = expected(is_gauss, "N (N + 2) rows (g, its rate) of g_10, g_11, h_11, g_20, ...")
check_meridian = expected(lambda v: v.shape == (2,), "2 values, angle and rate")
check_solar = expected(lambda v: v.shape == (9,) and abs(v[8]) < 1, "9 values, L, n, M_0, m, C_1, C_2, a, b, k")
check_air = expected(
    is_air, "two or more rows (height, density by night, density in the bulge), rising heights and densities > 0"
)
FIELD = (
    Parameter("gauss", "array", "rows g, g' of g_10, g_11, h_11, ..., T, T/s", check_gauss, np.zeros((3, 2)), rank=2),
    Parameter("reference_radius", "scalar", "of the coefficients gauss, m", default=6_371_200.0),
    Parameter("meridian", "array", "its angle at t = 0, rad, and rate, rad/s", check_meridian, np.zeros(2), rank=1),
)
SUN = (
    Parameter("sun", "vector", "direction of the Sun in space, of length 1", check_direction, np.eye(3)[0]),
    Parameter("sun_ahead", "vector", "direction of the Sun a quarter of its circle after `sun`", default=np.zeros(3)),
    Parameter("solar", "array", "motion of the Sun: L, n, M_0, m, C_1, C_2, a, b, k", check_solar, np.zeros(9), rank=1),
    Parameter("heliocentric", "scalar", "1 if the primary is the Sun, else 0", default=0.0),
    Parameter("eclipse", "scalar", "1 for the shadow of the primary, 0 for none", default=0.0),
    Parameter("disc", "scalar", "sine of the radius of the Sun's disc at 1 au", default=695_700e3 / ASTRONOMICAL_UNIT),
)
NO_AIR = [[0.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
AIR = (
    Parameter("density", "scalar", "of the air, kg/m^3", check_not_negative, 0.0),
    Parameter("air", "array", "rows: height, m; densities by night, in the bulge", check_air, NO_AIR, rank=2),
    Parameter("bulge", "scalar", "exponent of the density's dependence on the angle from the bulge", default=4.0),
    Parameter("flattening", "scalar", "of the primary, for heights", default=0.0),
    Parameter("air_rate", "scalar", "rate at which the air rotates about the third axis, rad/s", default=0.0),
)
ENVIRONMENT = (*FIELD, *SUN, *AIR)
NAMES = ("radius", *(p.letter for p in ENVIRONMENT))
