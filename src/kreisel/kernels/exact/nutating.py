"""One motion of the Lagrange top, n = 3, over a time, in compiled code: what `kreisel.exact.motion` does in mpmath.

For numbers and vectors of them, without branches.  Double-doubles carry what the number of periods multiplies.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from kreisel.kernels.exact.elliptic import (
    PI,
    TURN,
    arctan_ratio,
    complete,
    cs,
    inlined,
    largest_root,
    nearest,
    of_turns,
    pair,
    size,
    third_kind,
    upper,
    where_less,
)

PLACE = 2.0**-102  # a rounding of double-doubles, some together
SMALLEST, LARGEST = 1e-60, 1e60  # of the energies: outside, products of them leave the range
LEAST_SQUARE = 1e-200  # of |p|^2 and |b|^2 other than 0: the lower half of smaller ones loses places
LEAST_ANGLE = 1e-100  # of the nutation within its period, in place of 0
STEEP = 200.0  # energy/(x3 - x2): beyond, doubles lose more than a digit and a half near the steady motion
LEAN = 0.25  # (eps |m|/2)^2 is at most 1/LEAN: D_eps then turns by no more than it can without loss


@inlined
def leap(known: Any, alpha: Any, t: Any, turning: Any, length: Any) -> Any:
    """The flow over t as `count` times D_eps with the constant r, then a turn about p; and what it may be off.

    t and `known`, which is A, P2, J, c, E, K, u, v, are double-doubles (`kreisel.exact.nutation.Integrals`); of that
    module also the functions.  The frame turns about p by (1/alpha - 1) c/|p| in a unit of time beside.  Returns count,
    eps, r, the cos and sin of the angle, 1/|p| or 0, and the error, in turns and periods.
    """
    A, P2, J, c, E, K, u, v = known
    inverse_turn = pair(TURN[0], TURN[1])
    zero = 0.0 * upper(A)
    one = zero + 1.0
    heavy = where_less(zero, upper(P2), one, zero)  # 0 where p = 0: then K = c = 0, and no turn about p counts
    lower = upper(K - upper(K))
    K = pair(where_less(zero, heavy, upper(K), zero), where_less(zero, heavy, lower, zero))
    p = sqrt(P2 + (1.0 - heavy))
    scale = size(upper(E)) + sqrt(upper(A) * upper(P2)) + sqrt(size(upper(J) * upper(c)))

    y, change = largest_root(u, v)
    x3 = y - 4 * E / 3
    square = 3 * y * y + u
    mean, period, n, last = period_of(p, c, K, y, x3, square, scale, turning)
    phase = t * mean * inverse_turn
    periods = nearest(upper(phase))
    phase = phase - periods
    part = upper(phase)
    turned = periods * period * inverse_turn
    own = (1 / (alpha + 0 * A) - 1) * c / p * t * inverse_turn
    turned = turned - nearest(upper(turned)) + (own - nearest(upper(own)))

    h = upper(phase * (2 * pair(PI[0], PI[1]) / mean))
    doubles = upper(A), upper(J), upper(c), upper(E), upper(K), upper(p)
    count, eps, r, theta, steep = remainder(doubles, u, y, x3, square, part, h, scale, turning, length)
    left = (upper(turned) - count * theta * TURN[0]) * heavy
    cos, sin = of_turns(left - nearest(left))

    # what a rounding of double-doubles does to the period and to its turn; `energy` is its effect on close roots
    energy = scale * scale / upper(square)
    lean, kappa = upper(c / p), upper(K / p)
    blur = size(2.0 * upper(J) * upper(p)) + size(2.0 * upper(E) * lean) + size(lean * lean * lean)
    blur = blur + size(kappa) * (1.0 + scale * (1.0 + energy) / n)
    turns = heavy * (size(lean) + blur / n) / upper(mean)
    root = last + change * change * (energy / scale) * (energy / scale)  # what the iterations leave
    lost = (1.0 + size(periods)) * (PLACE * (1.0 + turns + energy * energy) + root)
    far = where_less(scale, SMALLEST, one, where_less(LARGEST, scale, one, zero))
    least = where_less(zero, upper(A), where_less(upper(A), LEAST_SQUARE, one, zero), zero)
    far = far + where_less(upper(P2), LEAST_SQUARE, heavy, zero) + least
    return count, eps, r, cos, sin, heavy / upper(p), lost + PLACE * size(upper(own)) * heavy + far + steep


@inlined
def period_of(p: Any, c: Any, K: Any, y: Any, x3: Any, square: Any, scale: Any, turning: Any) -> Any:
    """The mean M with omega_1 = pi/M, theta_P, x3 + c^2/P2 and the error of M: `square` = (x3 - x1)(x3 - x2).

    The first step of the mean is made by hand: it needs no difference of x1 and x2.
    """
    zero = 0.0 * scale
    w = sqrt(square)
    n = x3 + c * c / (p * p)  # in [0, x3 - x2]
    flat = where_less(zero, size(upper(K)), zero, zero + 1.0)
    over = where_less(size(upper(n)), 1e-20 * scale, flat, zero)  # -c^2/P2 = x3, K = 0: a pendulum that turns over
    n = n + over * scale
    mean, total, last = complete(sqrt(3 * y + 2 * w) / 2, sqrt(w), (n + w) / (2 * sqrt(n)))
    total = 1 + (n - w) / (n + w) / 2 * total
    pi = pair(PI[0], PI[1])
    third = 3 * pi * total / (4 * mean * n)
    return mean, pi * (1.0 - over) - 2 * turning(p, c, K, pi / mean, third), upper(n), last


@inlined
def remainder(
    known: Any, u: Any, y: Any, x3: Any, square: Any, part: Any, h: Any, scale: Any, turning: Any, length: Any
) -> Any:
    """In doubles, the count, eps, r and theta of the maps for the rest h of the time, `part` of a period.

    Last, 1 where doubles do not do: near the steady motion to which the separatrix tends.
    """
    A, J, c, E, K, p = known
    one = 0.0 * A + 1.0
    apart = sqrt(max(upper(-u - 0.75 * y * y), 0.0 * A))  # (x2 - x1)/2
    d1 = 1.5 * upper(y) + apart
    d2 = upper(square) / d1
    bottom = upper(x3)
    least = max(bottom + max(sqrt(upper(square)), LEAN * d1), LEAN * (d1 - bottom))  # of 4/eps^2
    count = max(nearest(0.5 + 0.5 * size(h) * sqrt(least + 4.0 / 3.0 * E)), one)
    angle = max(size(part) * PI[0] / count, LEAST_ANGLE)
    cotangent = cs(sqrt(d1), sqrt(d2), angle)
    gap = cotangent * cotangent
    x0 = bottom + gap
    s = 1.0 / x0
    root = sqrt((gap + d1) * s * ((gap + d2) * s) * (gap * s))
    direction = where_less(part, 0.0, -one, where_less(0.0, part, one, 0.0))
    lean, kappa, half = c / p, K / p, sqrt(s)
    third = third_kind(gap + d1, gap + d2, gap, x0 + lean * lean, kappa * kappa)
    slope = lean * half
    theta = turning(p, c, K, size(h) / count, third) + slope * arctan_ratio(slope * slope)
    steep = where_less(STEEP * d2, scale, one, 0.0)
    return count, 2.0 * direction * half, length(s, root, A, J, c, E), direction * theta, steep
