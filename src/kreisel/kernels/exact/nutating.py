"""One motion of the Lagrange top, n = 3, over a time, by operations to be recorded; in mpmath: `kreisel.exact.motion`.

Double-doubles carry the quantities that the number of periods multiplies.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from kreisel.algebra import sqrt
from kreisel.exact.nutation import Integrals, squared_length, turning
from kreisel.graph.arranging import Formula
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.graph import maximum, nearest, where_less
from kreisel.kernels.exact.elliptic import (
    PI,
    TURN,
    arctan_ratio,
    complete,
    cos_sin,
    cs,
    largest_root,
    third_kind,
)

PLACE = 2.0**-102  # a rounding of double-doubles, some together
SMALLEST, LARGEST = 1e-60, 1e60  # of the energies: outside, products of them leave the range
LEAST_SQUARE = 1e-200  # of |p|^2 and |b|^2 other than 0: the lower half of smaller ones loses places
LEAST_ANGLE = 1e-100  # of the nutation within its period, in place of 0
STEEP = 200.0  # energy/(x3 - x2): beyond, doubles lose more than a digit and a half near the steady motion
LEAN = 0.25  # (eps |m|/2)^2 is at most 1/LEAN: D_eps then rotates by no more than it can without loss


def leap(integrals: Integrals, alphas: Any, t: Any) -> Any:
    """The flow over t as `count` times D_eps with the constant r, then a rotation about p; and its possible error.

    t and the integrals are double-doubles.  Returns count, eps, r, 1/|p| or 0, the
    turn about p, and two errors: of the state, and of the orientation too.  Between the rotation about p and one
    about b before, which come last, the maps carry the orientation.  The rotations are angles in revolutions; with
    `alphas`, they grow by (1/alpha - 1) c/|p| and (1/alpha - 1) J/|b| in a unit of time as well.
    """
    A, P2, J, c, E = integrals.A, integrals.P2, integrals.J, integrals.c, integrals.E
    u, v = integrals.depressed
    y, change = largest_root(u, v)
    square = 3 * y * y + u
    scale = abs(upper(E)) + sqrt(upper(A) * upper(P2)) + sqrt(abs(upper(J) * upper(c)))
    shape = y, y - 4 * E / 3, square, scale
    above = axis_of(P2, c, integrals.K, shape)
    phase = t * above[4] * DoubleDouble(TURN[0], TURN[1])
    periods = nearest(upper(phase))
    phase = phase - periods
    fraction = upper(phase)
    h = upper(phase * (2 * DoubleDouble(PI[0], PI[1]) / above[4]))
    count, gaps, steep = remainder(upper(E), u, shape, fraction, h)
    x0 = gaps[3]
    s = 1.0 / x0
    root = sqrt((gaps[0] + gaps[1]) * s * ((gaps[0] + gaps[2]) * s) * (gaps[0] * s))
    (r,) = _length()(s, root, upper(A), upper(J), upper(c), upper(E))
    direction = where_less(fraction, 0.0, -1.0, where_less(0.0, fraction, 1.0, 0.0))
    eps = 2.0 * direction * sqrt(s)

    maps = periods, count, direction, abs(h), gaps
    left, excess = turned_by(above, maps, alphas[0], t)
    body = axis_of(A, -J, integrals.dual.K, shape)
    right, spun = turned_by(body, maps, alphas[1], t)
    lean = upper(J / body[1]) * sqrt(s)
    right = count * direction * lean * arctan_ratio(lean * lean) * (2.0 * TURN[0]) - right

    # `energy` is the effect of a rounding of double-doubles on close roots
    energy = scale * scale / upper(square)
    root = change * change * (energy / scale) * (energy / scale)  # the error left by the iterations
    lost, last = (1.0 + abs(periods)) * PLACE, (1.0 + abs(periods)) * root
    far = where_less(scale, SMALLEST, 1.0, where_less(LARGEST, scale, 1.0, 0.0)) + steep + last
    far = far + where_less(0.0, upper(P2), where_less(upper(P2), LEAST_SQUARE, 1.0, 0.0), 0.0)
    least = where_less(upper(A), LEAST_SQUARE, 1.0, 0.0)
    off = lost * (1.0 + blurred(above, E, J, P2, shape, energy) + energy * energy) + (1.0 + abs(periods)) * above[7]
    off = off + PLACE * excess + far
    off_body = lost * blurred(body, E, c, A, shape, energy) + (1.0 + abs(periods)) * body[7] + PLACE * spun
    still = where_less(0.0, upper(A), least, 0.0)
    return count, eps, r, above[0] / upper(above[1]), left, right, off + still, off + least + off_body


@cache
def _length() -> Formula:
    return Formula(squared_length, *[()] * 6)


def axis_of(P2: Any, c: Any, K: Any, shape: Any) -> Any:
    """Arguments of rotations about p: 1, or 0 for p = 0, where they do not count; |p|, c, K, results of `period_of`."""
    heavy = where_less(0.0, upper(P2), 1.0, 0.0)  # 0 where p = 0: then K = c = 0, and no rotation about p counts
    lower = upper(K - upper(K))
    K = DoubleDouble(where_less(0.0, heavy, upper(K), 0.0), where_less(0.0, heavy, lower, 0.0))
    p = sqrt(P2 + (1.0 - heavy))
    mean, period, n, last = period_of(p, c, K, shape)
    return heavy, p, c, K, mean, period, n, last


def turned_by(axis: Any, maps: Any, alpha: Any, t: Any) -> Any:
    """The rotation about an axis in revolutions, and the size of that by `alpha`."""
    heavy, p, c, K, _, period, _, _ = axis
    periods, count, direction, h, (gap, d1, d2, x0) = maps
    inverse_turn = DoubleDouble(TURN[0], TURN[1])
    turned = periods * period * inverse_turn
    excess = (1 / (alpha + 0 * p) - 1) * c / p * t * inverse_turn
    turned = turned - nearest(upper(turned)) + (excess - nearest(upper(excess)))
    P, lean, kappa = upper(p), upper(c) / upper(p), upper(K) / upper(p)
    third = third_kind(gap + d1, gap + d2, gap, x0 + lean * lean, kappa * kappa)
    slope = lean / sqrt(x0)
    theta = turning(P, upper(c), upper(K), h / count, third) + slope * arctan_ratio(slope * slope)
    return (upper(turned) - count * direction * theta * TURN[0]) * heavy, abs(upper(excess)) * heavy


def blurred(axis: Any, E: Any, J: Any, P2: Any, shape: Any, energy: Any) -> Any:
    """The effect of rounding double-doubles on the rotation of a period."""
    heavy, p, c, K, mean, _, n, _ = axis
    lean, kappa, scale = upper(c / p), upper(K / p), shape[3]
    blur = abs(2.0 * upper(J) * upper(p)) + abs(2.0 * upper(E) * lean) + abs(lean * lean * lean)
    blur = blur + abs(kappa) * (1.0 + scale * (1.0 + energy) / n)
    return heavy * (abs(lean) + blur / n) / upper(mean)


def period_of(p: Any, c: Any, K: Any, shape: Any) -> Any:
    """The mean M with omega_1 = pi/M, theta_P, x3 + c^2/P2 and the error of M: `square` = (x3 - x1)(x3 - x2).

    The first step of the mean is made by hand: it needs no difference of x1 and x2.
    """
    y, x3, square, scale = shape
    w = sqrt(square)
    n = x3 + c * c / (p * p)  # in [0, x3 - x2]
    flat = where_less(0.0, abs(upper(K)), 0.0, 1.0)
    over = where_less(abs(upper(n)), 1e-20 * scale, flat, 0.0)  # -c^2/P2 = x3, K = 0: a pendulum that goes over the top
    n = n + over * scale
    mean, total, last = complete(sqrt(3 * y + 2 * w) / 2, sqrt(w), (n + w) / (2 * sqrt(n)))
    total = 1 + (n - w) / (n + w) / 2 * total
    pi = DoubleDouble(PI[0], PI[1])
    third = 3 * pi * total / (4 * mean * n)
    return mean, pi * (1.0 - over) - 2 * turning(p, c, K, pi / mean, third), upper(n), last


def remainder(E: Any, u: Any, shape: Any, fraction: Any, h: Any) -> Any:
    """In doubles, the count of the maps for the remaining time h, `fraction` of a period, and x0 - x3 and the like.

    Last, 1 where doubles do not do: near the steady motion to which the separatrix tends.
    """
    y, x3, square, scale = shape
    apart = sqrt(maximum(upper(-u - 0.75 * y * y), 0.0))  # (x2 - x1)/2
    d1 = 1.5 * upper(y) + apart
    d2 = upper(square) / d1
    bottom = upper(x3)
    least = maximum(bottom + maximum(sqrt(upper(square)), LEAN * d1), LEAN * (d1 - bottom))  # of 4/eps^2
    count = maximum(nearest(0.5 + 0.5 * abs(h) * sqrt(least + 4.0 / 3.0 * E)), 1.0)
    angle = maximum(abs(fraction) * PI[0] / count, LEAST_ANGLE)
    cotangent = cs(sqrt(d1), sqrt(d2), *cos_sin(angle))
    gap = cotangent * cotangent
    return count, (gap, d1, d2, bottom + gap), where_less(STEEP * d2, scale, 1.0, 0.0)
