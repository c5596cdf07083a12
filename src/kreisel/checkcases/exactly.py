"""Rational values from printed quantities: "0.00189422 slug ft^2" to SI without rounding; pi to 100 digits."""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath

DIGITS = 110
NUMBER = re.compile(r"-?[\d.]+(e-?\d+|/\d+)?")
POUND, FOOT, GRAVITY = Fraction("0.45359237"), Fraction("0.3048"), Fraction("9.80665")  # by definition, kg, m, m/s^2
SLUG = POUND * GRAVITY / FOOT


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


def inverse(matrix: list[list[Fraction]]) -> list[list[Fraction]]:
    """The inverse of a 3 x 3 matrix, by cofactors."""
    a, b, c = matrix
    rows = [_cross(b, c), _cross(c, a), _cross(a, b)]
    determinant = sum(x * y for x, y in zip(a, rows[0], strict=True))
    return [[rows[j][i] / determinant for j in range(3)] for i in range(3)]


def _cross(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def rotated(axis: int, angle: Fraction) -> list[Fraction]:
    """The quaternion of a rotation about a coordinate axis."""
    q = [real(mpmath.cos, angle / 2), Fraction(0), Fraction(0), Fraction(0)]
    q[1 + axis] = real(mpmath.sin, angle / 2)
    return q
