"""Equations of motion of the check cases, on values of any kind: one line of torque each.

    I w' = torque - w x (I w),   q' = q (0, w)/2

w (3,), rad/s, is the angular velocity along the body axes, q the attitude as a unit quaternion (w, x, y, z), body to
space, x the further variables of a law, p its parameters.  `up` is the third axis of space along the body axes.

Values of printed quantities, "0.00189422 slug ft^2", are rational, in SI without rounding; pi has 100 digits.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import mpmath
import numpy as np

# -- rational values of printed quantities ---------------------------------------------------------

DIGITS = 110
NUMBER = re.compile(r"-?[\d.]+(e-?\d+|/\d+)?")
POUND, FOOT, GRAVITY = Fraction("0.45359237"), Fraction("0.3048"), Fraction("9.80665")  # by definition, kg, m, m/s^2
SLUG = POUND * GRAVITY / FOOT
QUANTITIES = {  # of a motion: unit, meaning, components
    "angular_velocity": ("rad/s", "angular velocity along the body axes", 3),
    "angular_velocity_space": ("rad/s", "angular velocity along the axes of space", 3),
    "attitude": ("1", "attitude, a unit quaternion (w, x, y, z), body to space", 4),
    "momentum": ("kg m^2/s", "angular momentum along the axes of space", 3),
    "position": ("m", "position in space", 3),
    "velocity": ("m/s", "velocity along the body axes", 3),
    "energy": ("J", "energy", 0),
}


def real(function: Callable[..., Any], *arguments: Fraction) -> Fraction:
    """A function of mpmath to 110 digits."""
    with mpmath.workdps(DIGITS):
        value = function(*(mpmath.mpf(a.numerator) / a.denominator for a in arguments))
        return Fraction(mpmath.nstr(value, DIGITS))


PI = real(lambda: +mpmath.pi)
UNITS = {
    "": Fraction(1),
    **dict.fromkeys(
        ("kg", "m", "s", "m/s", "m/s^2", "kg m^2", "kg m^2/s", "rad", "rad/s", "N m", "1/s", "T"), Fraction(1)
    ),
    "rad/(s T)": Fraction(1),
    "deg": PI / 180,
    "deg/s": PI / 180,
    "rpm": PI / 30,
    "ft": FOOT,
    "ft^2": FOOT**2,
    "slug ft^2": SLUG * FOOT**2,
}


def exact(text: str) -> Any:
    """The value in SI of "3 kg", or the list of the values of "10 20 30 deg/s"."""
    unit = unit_of(text)
    values = [Fraction(word) * UNITS[unit] for word in text.removesuffix(unit).split()]
    return values if len(values) > 1 else values[0]


def unit_of(text: str) -> str:
    """The unit behind the values, "" if there is none."""
    words = text.split()
    return " ".join(words[next((k for k, word in enumerate(words) if not NUMBER.fullmatch(word)), len(words)) :])


# -- vectors and rotations -------------------------------------------------------------------------

Vector = Any  # three components, or a quaternion's four: values, recorded values, or arrays (...)


def cross(a: Vector, b: Vector) -> list[Any]:
    """The vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a: Vector, b: Vector) -> Any:
    """The scalar product."""
    return sum(x * y for x, y in zip(a, b, strict=True))


def times(A: Any, v: Vector) -> list[Any]:
    """A v."""
    return [dot(row, v) for row in A]


def rotation(q: Vector) -> list[list[Any]]:
    """The rotation matrix of a unit quaternion, body to space."""
    w, x, y, z = q
    return [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]


def to_body(q: Vector, v: Vector) -> list[Any]:
    """A vector of space along the body axes: R^T v."""
    R = rotation(q)
    return [sum(R[k][i] * v[k] for k in range(3)) for i in range(3)]


def quaternion_rate(q: Vector, w: Vector) -> list[Any]:
    """q' = q (0, w)/2."""
    s, v = q[0], q[1:]
    turned = cross(v, w)
    return [-0.5 * dot(v, w), *(0.5 * (s * w[i] + turned[i]) for i in range(3))]


def inverse(matrix: list[list[Fraction]]) -> list[list[Fraction]]:
    """The inverse of a 3 x 3 matrix, by cofactors."""
    a, b, c = matrix
    rows = [cross(b, c), cross(c, a), cross(a, b)]
    determinant = sum(x * y for x, y in zip(a, rows[0], strict=True))
    return [[rows[j][i] / determinant for j in range(3)] for i in range(3)]


def rotated(axis: int, angle: Fraction) -> list[Fraction]:
    """The quaternion of a rotation about a coordinate axis."""
    q = [real(mpmath.cos, angle / 2), Fraction(0), Fraction(0), Fraction(0)]
    q[1 + axis] = real(mpmath.sin, angle / 2)
    return q


# -- laws ------------------------------------------------------------------------------------------


class Law(NamedTuple):
    """A torque, further variables, and the conserved quantities.

    torque     N m, along the body axes
    further    names and sizes of further variables x, with `rates` x'
    potential  J, a function of the complete state; NaN-free only where `conserved` names the energy
    stored     angular momentum in addition to I w, along the body axes
    scaled     parameters to which the torque is proportional
    conserved  of "energy", "momentum" (a vector in space), "vertical momentum", "impulse"
    """

    torque: Callable[[Vector, Vector, Vector, Any], Any]
    conserved: tuple[str, ...]
    further: tuple[tuple[str, int], ...] = ()
    rates: Callable[[Vector, Vector, Vector, Any], list[Any]] = lambda w, q, x, p: []
    potential: Callable[[Vector, Vector, Vector, Any], Any] = lambda w, q, x, p: 0.0
    stored: Callable[[Any], Any] = lambda p: [0.0, 0.0, 0.0]
    scaled: tuple[str, ...] = ()

    def flow(
        self,
        w: Vector,
        q: Vector,
        x: Vector,
        p: Any,
        *,
        gyroscopic: float = 1,
        damping: float = 0,
        torque: Any = None,
        rate: Callable[[Vector, Vector], list[Any]] = quaternion_rate,
    ) -> list[Any]:
        """The rates of w, q, x: I w' = torque - gyroscopic w x I w - damping I w, q' = rate(q, w)."""
        m = times(p["I"], w)
        terms = zip((torque or self.torque)(w, q, x, p), cross(w, m), m, strict=True)
        push = [t - gyroscopic * g - damping * v for t, g, v in terms]
        return [*times(p["inverse"], push), *rate(q, w), *self.rates(w, q, x, p)]


def _gravity_gradient(w: Vector, q: Vector, x: Vector, p: Any) -> list[Any]:
    r = to_body(q, [x[0], x[1], 0.0])
    return [3 * p["n"] * p["n"] * t for t in cross(r, times(p["I"], r))]


def _gravity_gradient_energy(w: Vector, q: Vector, x: Vector, p: Any) -> Any:
    """Jacobi's integral less the kinetic energy: V - n L3."""
    r = to_body(q, [x[0], x[1], 0.0])
    L3 = dot(rotation(q)[2], times(p["I"], w))
    return 1.5 * p["n"] ** 2 * dot(r, times(p["I"], r)) - p["n"] * L3


def _circle(w: Vector, q: Vector, x: Vector, p: Any) -> list[Any]:
    return [-p["n"] * x[1], p["n"] * x[0]]


def _gyromagnetic(w: Vector, q: Vector, x: Vector, p: Any) -> list[Any]:
    B = to_body(q, [p["b"] * x[0], p["b"] * x[1], p["B"]])
    return [p["gamma"] * t for t in cross(times(p["I"], w), B)]


def _fluid_rates(w: Vector, q: Vector, x: Vector, p: Any) -> list[Any]:
    v = x[:3]
    return [*times(p["A inverse"], cross(times(p["A"], v), w)), *times(rotation(q), v)]


def _air(w: Vector, q: Vector, x: Vector, p: Any) -> list[Any]:
    """rho V S l_i^2 C w_i/4, V = -v: the coefficient C of the torque by w_i l_i/(2 V)."""
    v, density = x[1], x[4]
    return [-density * v * p["S"] * p["l"][i] * p["l"][i] * p["C"][i] * w[i] * 0.25 for i in range(3)]


def _fall(w: Vector, q: Vector, x: Vector, p: Any) -> list[Any]:
    """u = R0/r, v = r', G = r0/(r0 + h), theta = T0/T, the density rho of the air.

    v' = A u^3 - B u^2 - C u^4 (centrifugal, gravity, J2 above the equator); h' = v; the geopotential altitude has
    H' = G^2 v, the temperature T' = -L H', the density rho'/rho = (g M/(R L) - 1) T'/T.
    """
    u, v, G, theta, rho = x
    fall = G * G * v * theta * p["lapse"]
    return [
        -u * u * v * p["1/R0"],
        u * u * (p["centrifugal"] * u - p["gravity"] - p["oblateness"] * u * u),
        -G * G * v * p["1/r0"],
        theta * fall,
        -p["exponent"] * rho * fall,
    ]


FREE = Law(lambda w, q, x, p: [0.0, 0.0, 0.0], ("energy", "momentum"))
FIELD = Law(
    lambda w, q, x, p: cross(p["k"], rotation(q)[2]),
    ("energy", "vertical momentum"),
    potential=lambda w, q, x, p: -dot(p["k"], rotation(q)[2]),
    scaled=("k",),
)
GYROSTAT = Law(lambda w, q, x, p: cross(p["h"], w), ("energy", "momentum"), stored=lambda p: p["h"], scaled=("h",))
DAMPED = Law(lambda w, q, x, p: [-p["c"] * m for m in times(p["I"], w)], ())
ORBIT = Law(_gravity_gradient, ("energy",), (("radius", 2),), _circle, _gravity_gradient_energy)
GYROMAGNETIC = Law(_gyromagnetic, (), (("field", 2),), _circle)
FLUID = Law(
    lambda w, q, x, p: cross(times(p["A"], x[:3]), x[:3]),
    ("energy", "impulse"),
    (("velocity", 3), ("position", 3)),
    _fluid_rates,
    lambda w, q, x, p: 0.5 * dot(x[:3], times(p["A"], x[:3])),
    scaled=("A",),
)
AIR = Law(_air, (), (("u", 1), ("v", 1), ("G", 1), ("theta", 1), ("density", 1)), _fall, scaled=("S",))


def arrays(columns: Any) -> Any:
    """Components first, (k, ...), from (..., k)."""
    return np.moveaxis(np.asarray(columns), -1, 0)
