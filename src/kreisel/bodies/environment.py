"""Environment of a satellite as functions of place and time: magnetic field, Sun, shadow, air.  SI units.

Space is the frame of the mean equator and the mean equinox at the epoch t = 0; its third axis is the axis of the
primary.  Places r and directions are (3,), of any kind of number, or with further axes behind.

    B = -grad V,   V = R sum over n, m of (R/r)^(n+1) P_nm(sin phi) (g_nm cos m lambda + h_nm sin m lambda)

with g_nm + t g_nm' for g_nm, P_nm normalized after Schmidt, lambda = longitude in the primary, whose meridian rotates
by the angle meridian[0] + meridian[1] t from the equinox.  With (s, t, u) = r/|r|, q = R/|r| and A_nm = d^m P_n/du^m,

    a = sum of q^(n+2) (m A_nm (g c_(m-1) + h s_(m-1)), m A_nm (h c_(m-1) - g s_(m-1)), A_n(m+1) (g c_m + h s_m))
    B = (sum of q^(n+2) A_(n+1)(m+1) (g c_m + h s_m)) r/|r| - a,        c_m + i s_m = (s + i t)^m

which has no angle of the place and is regular at the poles.  [S. Pines, AIAA Journal 11 (1973) 1508]

    Sun      sun cos l + sun_ahead sin l,   l = L + n t + C_1 sin M + C_2 sin 2M,   M = M_0 + m t
             solar = (L, n, M_0, m, C_1, C_2, a, b, k),   1/distance = (1 + a cos l + b sin l)/(1 - k) in au
             [Meeus, Astronomical Algorithms, 1998, chapter 25]
    light    1 - (part of the Sun's disc behind the primary, a sphere): two circles on the sky
    air      between the rows (height, density by night, density in the bulge) of a table the logarithms are linear;
             night + (bulge - night) cos^n(psi/2), psi the angle from the bulge, which follows the Sun 30 degrees later
             [Montenbruck, Gill, Satellite Orbits, 2000, section 3.5]
"""

from __future__ import annotations

from itertools import pairwise
from math import isqrt, pi, prod
from math import sqrt as root
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import sqrt
from kreisel.algebra.gradient import cos, exp, log, sin
from kreisel.bodies.orbit import TINY, arcsine, check_not_negative, expected, polynomial, size
from kreisel.record.contract import Parameter

SEGMENT = [2 / 3, 1 / 5, 3 / 28, 5 / 72, 35 / 704]  # arcsin w - w sqrt(1 - w^2) = w^3 (2/3 + w^2/5 + ...)
IN_LINE = 1e-18  # the square of an angle, so that a quotient by it has 5 digits
LAG = root(3) / 2, 0.5  # cosine and sine of 30 degrees


def ramp(x):
    """x if x > 0, else 0."""
    return (x + size(x)) / 2


# -- magnetic field --------------------------------------------------------------------------------


def dot(x, y):
    """The scalar product along the first axis."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def of_dipole(r, f):
    """B of a dipole along the third axis, f = R^3 g_10."""
    square = dot(r, r)
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
    length = sqrt(dot(r, r))
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
    length = sqrt(dot(r, r))
    sin_a, sin_b = disc * near, shadow / length
    cos_a, cos_b = sqrt(1 - sin_a * sin_a), sqrt(ramp(1 - sin_b * sin_b) + TINY)
    cos_c = -dot(r, s) / length
    x = [r[1] * s[2] - r[2] * s[1], r[2] * s[0] - r[0] * s[2], r[0] * s[1] - r[1] * s[0]]
    sin_c = sqrt(dot(x, x) / (length * length) + IN_LINE)
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
    toward = dot(r, apex) / sqrt(dot(r, r))
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


def around(
    r, v, t, *, radius, gauss, reference_radius, meridian, sun, sun_ahead, solar, eclipse, disc, air_rate, **air
):
    """The environment at the place r, with the velocity v, at the time t."""
    s, near = sunlight(t, sun=sun, sun_ahead=sun_ahead, solar=solar)
    B = field(r, t, gauss=gauss, reference_radius=reference_radius, meridian=meridian)
    seen = light(r, s, near, eclipse=eclipse, shadow=radius, disc=disc)
    density = density_of_air(r, s, radius=radius, **air)
    return Around(B, s, near, seen, density, through_air(r, v, air_rate=air_rate))


# -- parameters ------------------------------------------------------------------------------------


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
    Parameter("eclipse", "scalar", "1 for the shadow of the primary, 0 for none", default=0.0),
    Parameter("disc", "scalar", "sine of the radius of the Sun's disc at 1 au", default=695_700e3 / 149_597_870_700.0),
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
