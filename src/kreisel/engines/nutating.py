"""One motion of the Lagrange top, n = 3, over a time, in compiled code: what `kreisel.methods.motion` does in mpmath.

For numbers and vectors of them, without branches.  Double-doubles carry what the number of periods multiplies.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from kreisel.engines.elliptic import (
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
LEAST_ANGLE = 1e-100  # of the nutation within its period, in place of 0
LEAN = 0.25  # (eps |m|/2)^2 is at most 1/LEAN: D_eps then turns by no more than it can without loss


@inlined
def leap(known: Any, alpha: Any, t: Any, turning: Any, length: Any) -> Any:
    """The flow over t as `count` times D_eps with the constant r, then a turn about p; and what it may be off.

    `known`: A, P2, J, c, E, K, u, v in double-doubles (`kreisel.methods.nutation.Integrals`).  The frame turns about p
    by (1/alpha - 1) c/|p| in a unit of time beside.  Returns count, eps, r, cos, sin, 1/|p| (or 0), error.
    """
    A, P2, J, c, E, K, u, v = known
    pi, inverse_turn = pair(PI[0], PI[1]), pair(TURN[0], TURN[1])
    zero = 0.0 * upper(A)
    one = zero + 1.0
    heavy = where_less(zero, upper(P2), one, zero)  # 0 where p = 0: then K = c = 0, and no turn about p counts
    P2 = P2 + (1.0 - heavy)
    K = pair(where_less(heavy, 0.5 * one, zero, upper(K)), where_less(heavy, 0.5 * one, zero, upper(K - upper(K))))
    p = sqrt(P2)

    y, change = largest_root(u, v)
    x3 = y - 4 * E / 3
    square = 3 * y * y + u  # (x3 - x1)(x3 - x2)
    w = sqrt(square)
    n = x3 + c * c / P2  # in [0, x3 - x2]
    scale = size(upper(E)) + sqrt(upper(A) * upper(P2) * heavy) + sqrt(size(upper(J) * upper(c)))
    flat = where_less(size(upper(K)), 1e-300 * one, one, zero)
    inside = flat * where_less(size(upper(n)), 1e-20 * scale, one, zero)  # -c^2/P2 = x3: a pendulum turning over
    n = n + inside * scale
    # the first step of the mean of sqrt(x3 - x1) and sqrt(x3 - x2), in which x1 and x2 need not be told apart
    tilt = (n - w) / (n + w) / 2
    mean, total, last = complete(sqrt(3 * y + 2 * w) / 2, sqrt(w), (n + w) / (2 * sqrt(n)))
    total = 1 + tilt * total
    half_period = pi / mean
    third = 3 * pi * total / (4 * mean * n)
    period = pi - 2 * turning(p, c, K, half_period, third) - pi * inside

    phase = t * mean * inverse_turn
    periods = nearest(upper(phase))
    phase = phase - periods
    part = upper(phase)
    turned = periods * period * inverse_turn
    own = (1 / (alpha + 0 * A) - 1) * c / p * t * inverse_turn
    turned = turned - nearest(upper(turned)) + (own - nearest(upper(own)))

    # what is left, in doubles
    h = size(upper(phase * (2 * half_period)))
    half = upper(y) * 1.5
    apart = sqrt(max(upper(-u - 0.75 * y * y), zero))
    d1 = half + apart
    d2 = upper(square) / d1
    least = max(upper(x3) + max(upper(w), LEAN * d1), LEAN * (d1 - upper(x3)))
    count = max(-nearest(-0.5 - 0.5 * h * sqrt(least + 4.0 / 3.0 * upper(E))), one)
    angle = max(size(part) * PI[0] / count, LEAST_ANGLE * one)
    c3 = cs(sqrt(d1), sqrt(d2), angle)
    gap = c3 * c3
    x0 = upper(x3) + gap
    s = 1.0 / x0
    root = sqrt((gap + d1) * s * ((gap + d2) * s) * (gap * s))
    r = length(s, root, upper(A), upper(J), upper(c), upper(E))
    direction = where_less(part, zero, -one, where_less(zero, part, one, zero))
    eps = 2.0 * direction * sqrt(s)
    lean = upper(c / p)
    kappa = upper(K / p)
    small = third_kind(gap + d1, gap + d2, gap, x0 + lean * lean, kappa * kappa)
    slope = 0.5 * lean * sqrt(s) * 2.0
    theta = turning(upper(p), upper(c), upper(K), h / count, small) + slope * arctan_ratio(slope * slope)
    left = upper(turned) - direction * count * theta * TURN[0]
    left = (left - nearest(left)) * heavy
    cos, sin = of_turns(left)

    energy = scale * scale / upper(square)
    blur = size(2.0 * upper(J) * upper(p)) + size(2.0 * upper(E) * lean) + size(lean * lean * lean)
    off = blur + size(kappa) * (1.0 + scale * (1.0 + energy) / upper(n))
    turns = size(lean) + off / upper(n)
    lost = (1.0 + size(periods)) * (turns / upper(mean) + energy * energy + size(last) / PLACE) * heavy
    near = change * change * scale * scale / (upper(square) * upper(square))  # of the root, relative to what it matters
    lost = lost + (1.0 + size(periods)) * near / PLACE
    lost = lost + size(periods) * (energy * energy + 1.0) + size(upper(own) * heavy)
    far = where_less(scale, SMALLEST * one, one, where_less(LARGEST * one, scale, one, zero))
    error = PLACE * lost + far
    return count, eps, r, cos, sin, heavy / upper(p), error
