"""Elliptic integrals and functions by a fixed number of operations, on scalars of any kind: to be recorded.

Those of which a large multiple is taken are in double-doubles.  Arguments that need more iterations than are made
give a result with its error, or no number.
"""

from __future__ import annotations

from typing import Any

from kreisel.algebra import sqrt
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.graph import fma, if_positive, maximum, nearest, repeated, where_less

PI = 3.141592653589793, 1.2246467991473532e-16  # and its remainder
MEANS = 5  # enough for a/g = 100, if the first step of the mean was made
DUPLICATIONS = 6  # of the arguments of R_J, whose ratios are at most 1e4
LEVELS = 6  # of Landen's transformation
BEYOND = DUPLICATIONS + 7  # for ratios up to 1e46
TURN = 0.15915494309189535, -9.839338337591867e-18  # 1/(2 pi)


def largest_root(u: Any, v: Any) -> Any:
    """The largest of three real roots of y^3 + u y + v, by Newton's method; its last change, a double."""
    first, last = upper(u), upper(v)
    unit = 2.0 * sqrt(-first / 3.0)
    q = -4.0 * last / (unit * unit * unit)  # the root is `unit` cos(arccos(q)/3)
    y = 0.5 + 0.5 * sqrt(maximum(0.5 + 0.5 * q, 0.0))
    for _ in range(4):
        y = y - (y * (4.0 * y * y - 3.0) - q) / (12.0 * y * y - 3.0)
    y = y * unit
    root = DoubleDouble(y, 0.0)
    change = y
    for _ in range(2):
        square = root * root
        change = upper((square + u) * root + v) / upper(3 * square + u)
        root = root - change
    return root, abs(change)


def either(test: Any, x: Any, y: Any) -> Any:
    """The double-double x where test < 0, else y."""
    first, second = upper(x), upper(y)
    lower = where_less(test, 0.0, upper(x - first), upper(y - second))
    return DoubleDouble(where_less(test, 0.0, first, second), lower)


def complete_beyond(a: Any, g: Any, p: Any, beyond: Any) -> Any:
    """`complete`; where `beyond` > 0 for a/g up to 6e13."""
    mean, total, error = complete(a, g, p)

    def by_more_means() -> list[Any]:
        finer, sum_, left = complete(a, g, p, MEANS + 3)
        finer, sum_ = either(-beyond, finer, mean), either(-beyond, sum_, total)
        return [finer.upper, finer.lower, sum_.upper, sum_.lower, where_less(0.0, beyond, left, error)]

    values = if_positive(beyond, by_more_means, [mean.upper, mean.lower, total.upper, total.lower, error])
    return DoubleDouble(*values[:2]), DoubleDouble(*values[2:4]), values[4]


def complete(a: Any, g: Any, p: Any, steps: int = MEANS) -> Any:
    """M(a, g), the sum S with R_J(0, a^2, g^2, p^2) = 3 pi S/(4 M p^2), and the relative error: double-doubles.

    By the arithmetic-geometric mean (Carlson); where a = g the rest of the sum is 2 p/(M + p).
    """
    term, total = DoubleDouble(1.0), DoubleDouble(0.0)
    for _ in range(steps):
        product, square = a * g, p * p
        sum_ = square + product
        total = total + term
        term = term * (square - product) / (2 * sum_)
        a, g, p = (a + g) / 2, sqrt(product), sum_ / (2 * p)
    apart = upper((a - g) / a)
    mean = (a + g) / 2
    return mean, total + 2 * term * p / (mean + p), apart * apart


def _descended(level: Any, a: Any, mean: Any, g: Any) -> Any:
    c, d = level
    ratio = c * c / mean
    return c * d, (g + ratio) / (a + ratio)


def cs(a: Any, g: Any, cos: Any, sin: Any, levels: int = LEVELS) -> Any:
    """Jacobi's function of that name, times a, at u = a angle/M(a, g), where k' = g/a; 0 < angle <= pi/2.

    By descending Landen transformations.
    """
    return _level(a, g, cos, sin, levels)[0]


def cs_beyond(a: Any, g: Any, cos: Any, sin: Any, beyond: Any) -> Any:
    """`cs`; where `beyond` > 0 for a/g up to 6e13."""
    near = cs(a, g, cos, sin)

    def far() -> list[Any]:
        return [where_less(0.0, beyond, cs(a, g, cos, sin, LEVELS + 3), near)]

    return if_positive(beyond, far, [near])[0]


def _level(a: Any, g: Any, cos: Any, sin: Any, levels: int) -> Any:
    """cs times a, and dn."""
    mean = 0.5 * (a + g)
    if levels == 1:
        return _descended((mean * cos / sin, 1.0), a, mean, g)
    return _descended(_level(mean, sqrt(a * g), cos, sin, levels - 1), a, mean, g)


def arctan_ratio(e: Any) -> Any:
    """arctan(x)/x, e = x^2: after three bisections of the angle by its series."""
    factor = 1.0
    for _ in range(3):
        denominator = 1.0 + sqrt(1.0 + e)
        factor = factor * 2.0 / denominator
        e = e / (denominator * denominator)
    total = 1.0 / 25.0
    for order in range(23, 1, -2):
        total = 1.0 / order - e * total
    return factor * (1.0 - e * total)


def third_kind(x: Any, y: Any, z: Any, p: Any, delta: Any, steps: int = DUPLICATIONS) -> Any:
    """R_J(x, y, z, p) by duplication (Carlson), delta = (p - x)(p - y)(p - z) >= 0."""
    mean = 0.2 * (x + y + z + 2.0 * p)
    small_x, small_y, small_z = mean - x, mean - y, mean - z

    def duplicated(numbers: list[Any]) -> list[Any]:
        x, y, z, p, mean, power, total = numbers
        rx, ry, rz, rp = sqrt(x), sqrt(y), sqrt(z), sqrt(p)
        step = rx * ry + rx * rz + ry * rz
        d = (rp + rx) * (rp + ry) * (rp + rz)
        total = total + power / d * arctan_ratio(delta * (power * power * power) / (d * d))
        return [*(0.25 * (v + step) for v in (x, y, z, p, mean)), 0.25 * power, total]

    *_, mean, power, total = repeated(duplicated, [x, y, z, p, mean, 1.0, 0.0], steps)
    X, Y, Z = small_x * power / mean, small_y * power / mean, small_z * power / mean
    P = -0.5 * (X + Y + Z)
    E2 = X * Y + X * Z + Y * Z - 3.0 * P * P
    E3 = X * Y * Z + 2.0 * E2 * P + 4.0 * P * P * P
    E4 = (2.0 * X * Y * Z + E2 * P + 3.0 * P * P * P) * P
    E5 = X * Y * Z * P * P
    series = 1.0 - E2 * 3.0 / 14.0 + E3 / 6.0 + E2 * E2 * 9.0 / 88.0 - E4 * 3.0 / 22.0 - E2 * E3 * 9.0 / 52.0
    return power / (mean * sqrt(mean)) * (series + E5 * 3.0 / 26.0) + 6.0 * total


def cos_sin(x: Any) -> Any:
    """Cosine and sine of an angle of at most pi/4, by Taylor's series."""
    e = x * x
    c, s = -1.0 / 87178291200.0 + e / 20922789888000.0, 1.0 / 6227020800.0 - e / 1307674368000.0
    c, s = 1.0 / 479001600.0 + e * c, -1.0 / 39916800.0 + e * s
    c, s = -1.0 / 3628800.0 + e * c, 1.0 / 362880.0 + e * s
    c, s = 1.0 / 40320.0 + e * c, -1.0 / 5040.0 + e * s
    c, s = -1.0 / 720.0 + e * c, 1.0 / 120.0 + e * s
    c, s = 1.0 / 24.0 + e * c, -1.0 / 6.0 + e * s
    return 1.0 - e * (0.5 - e * c), fma(x * e, s, x)


def of_turns(fraction: Any) -> Any:
    """Cos and sin of 2 pi fraction, |fraction| <= 1/2."""
    quarter = nearest(4.0 * fraction)
    c, s = cos_sin((fraction - 0.25 * quarter) * 6.283185307179586)
    some = abs(quarter)
    return (
        where_less(some, 0.5, c, where_less(some, 1.5, -s * quarter, -c)),
        where_less(some, 0.5, s, where_less(some, 1.5, c * quarter, -s)),
    )
