"""One motion of the free body, n = 3, over a time, in compiled code: what `kreisel.exact.rotor` does in mpmath.

For numbers and vectors of them, without branches.  Double-doubles carry what the number of turns multiplies.  The
moments enter by rho = (I_3 - I_2)/(I_3 - I_1) and 1 - rho, so that none of the quotients is 0/0 for a ball, and
D, E and L^2 - 2T I_2 by D/(I_3 - I_1) = f_1 + rho f_2, f_i = M_i^2/I_i, and the like.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from kreisel.kernels.exact.elliptic import (
    PI,
    TURN,
    complete,
    cs_of,
    fma,
    inlined,
    nearest,
    of_turns,
    pair,
    size,
    third_kind,
    upper,
    where_less,
)

PLACE = 2.0**-102  # a rounding of double-doubles, some together
SMALLEST, LARGEST = 1e-60, 1e60  # of momenta and moments: outside, products of them leave the range
LEAST_PART = 1e-100  # of a turn, in place of 0
LEAST_MODULUS = 1e-3  # of k': below, doubles lose more than a digit


@inlined
def either(test: Any, x: Any, y: Any) -> Any:
    """The double-double x where test < 0, else y."""
    first, second = upper(x), upper(y)
    return pair(where_less(test, 0.0, first, second), where_less(test, 0.0, upper(x - first), upper(y - second)))


@inlined
def in_order(test: Any, x: Any, y: Any) -> Any:
    """(y, x) where test < 0, else (x, y): numbers."""
    return where_less(test, 0.0, y, x), where_less(test, 0.0, x, y)


@inlined
def _sorted(test: Any, I: Any, J: Any, M: Any, N: Any) -> Any:  # noqa: E741
    return either(test, J, I), either(test, I, J), where_less(test, 0.0, N, M), where_less(test, 0.0, M, N)


@inlined
def _double_double_square(x: Any) -> Any:
    wide = pair(x, 0.0 * x)
    return wide * wide


@inlined
def rotated(moments: Any, momentum: Any, t: Any) -> Any:
    """The momentum after t, the turn g(0)^-1 g(t) as a quaternion, and what the phases may be off, in turns.

    `moments`: three double-doubles; `momentum`: three numbers; t: a double-double.
    """
    (I1, I2, I3), (N1, N2, N3) = moments, momentum  # sorted from here on
    one = 0.0 * N1 + 1.0
    first = upper(I2 - I1)
    I1, I2, N1, N2 = _sorted(first, I1, I2, N1, N2)
    second = upper(I3 - I2)
    I2, I3, N2, N3 = _sorted(second, I2, I3, N2, N3)
    third = upper(I2 - I1)
    I1, I2, N1, N2 = _sorted(third, I1, I2, N1, N2)

    width = I3 - I1
    ball = where_less(0.0, upper(width), 0.0, one)
    rho, kappa = (I3 - I2 + 0.5 * ball) / (width + ball), (I2 - I1 + 0.5 * ball) / (width + ball)
    f1, f2, f3 = _double_double_square(N1) / I1, _double_double_square(N2) / I2, _double_double_square(N3) / I3
    gap = rho * f3 - kappa * f1
    last = upper(gap)
    I1, I3, N1, N3 = _sorted(last, I1, I3, N1, N3)
    f1, f3, rho, kappa = either(last, f3, f1), either(last, f1, f3), either(last, kappa, rho), either(last, rho, kappa)
    s, side = where_less(last, 0.0, -one, one), where_less(N3, 0.0, -one, one)
    flips = where_less(first, 0.0, -one, one) * where_less(second, 0.0, -one, one) * where_less(third, 0.0, -one, one)
    chi = s * flips * side
    gap = either(last, -gap, gap)

    known = I1, I2, I3, N1, N2, side * N3, f1, f2, f3, rho, kappa, gap, width * s
    N1, N2, N3, w, x, y, z, off = about_the_third(known, chi, t)
    x, y, N3, z = chi * x, chi * y, side * N3, chi * side * z
    N1, N3 = in_order(last, N1, N3)
    x, z = in_order(last, x, z)
    N1, N2 = in_order(third, N1, N2)
    x, y = in_order(third, x, y)
    N2, N3 = in_order(second, N2, N3)
    y, z = in_order(second, y, z)
    N1, N2 = in_order(first, N1, N2)
    x, y = in_order(first, x, y)
    return N1, N2, N3, w, x, y, z, off


@inlined
def about_the_third(known: Any, chi: Any, t: Any) -> Any:
    """The same for axes in the order of `kreisel.exact.rotor`, M_3 >= 0, whose formulas these are."""
    I1, I2, I3, N1, N2, N3, f1, f2, f3, rho, kappa, gap, width = known
    zero = 0.0 * N1
    one = zero + 1.0
    d, e, volume = f1 + rho * f2, kappa * f2 + f3, I1 * I2 * I3  # D and E over I_3 - I_1
    squares = I1 * d, I2 * d / rho, I3 * e
    L = sqrt(I1 * f1 + I2 * f2 + I3 * f3)
    a3 = sqrt(squares[2])
    total = L + a3
    A, G = sqrt(rho * e / volume), sqrt(gap / volume)  # lambda and lambda k' over |I_3 - I_1|
    a, g = (A + G) / 2, sqrt(A * G)
    k1 = kappa * d / (volume * (4 * a * a))
    both = 1 + k1 * squares[0] / (total * total)  # 1 + beta
    mean, sum_, last = complete(a, g, a * sqrt(both))
    inverse_turn = pair(TURN[0], TURN[1])
    breadth = width * where_less(upper(width), 0.0, -one, one)
    halves = t * breadth * mean * (2 * inverse_turn)  # of lambda t, in 2 K
    whole = nearest(upper(halves))
    part = upper(halves - whole)
    slope = width * d / (I3 * total) * (1 + a3 * k1 * sum_ / (total * both))
    turns = t * (L / I3 + slope) * (0.5 * inverse_turn)  # of a quarter of psi
    turns = upper(turns - nearest(upper(turns)))

    a1, a2 = _root(squares[0]), _root(squares[1])
    amplitudes = upper(a1), upper(a2), upper(a3)
    doubles = amplitudes, upper(a), upper(g), upper(G), upper(k1), upper(both)
    ratio = upper(A) / upper(a)  # 1 + k_1
    strength = upper(d) * ratio * 2.0 * upper(a3 * k1) / (upper(I3 * A) * upper(total) * upper(total))
    third = PI[0] * upper(sum_) * upper(a) / (4.0 * upper(mean) * upper(both))
    direction = chi * where_less(upper(width), 0.0, -one, one)
    first = N1, N2, N3
    cn, sn, dn, ripple = moved(doubles, first, part * direction, third)
    odd = whole - 2.0 * nearest(0.5 * whole)
    back = where_less(0.5, odd * odd, -one, one)
    N1, N2, N3 = _times(a1, cn * back), _times(a2, sn * back), _times(a3, dn)
    cos, sin = of_turns(_within(chi * turns + 0.5 * TURN[0] * strength * ripple))
    w, x, y, z = between(first, (N1, N2, N3), upper(L), cos, sin)

    away = size(upper(halves)) + size(upper(t * L / I3))
    close = upper(rho * f3 + kappa * f1) / upper(gap)
    off = (1.0 + away) * (PLACE * (1.0 + close) + last)
    largest = max(upper(L), max(upper(I1), upper(I3)))
    least = 1.0 / max(1.0 / upper(L), max(1.0 / upper(I1), 1.0 / upper(I3)))
    far = where_less(LARGEST, largest, one, where_less(least, SMALLEST, one, zero))
    near = where_less(LEAST_MODULUS * upper(A), upper(G), zero, one)
    return N1, N2, N3, w, x, y, z, off + far + near


@inlined
def _within(turns: Any) -> Any:
    return turns - nearest(turns)


@inlined
def moved(known: Any, N: Any, part: Any, whole: Any) -> Any:
    """(cn, sn, dn) at u_0 + 2 K part, |part| <= 1/2, and Q there less Q at u_0 and the mean, in doubles.

    Up to the sign of cn and sn that u_0 has: N tells u_0.  By the addition theorems.
    """
    amplitudes, a, g, G, k1, both = known
    zero = 0.0 * part
    one = zero + 1.0
    flat = where_less(zero, amplitudes[0], zero, one)  # a turn about the axis: cn = 1
    cn0, sn0, dn0 = (N[0] + flat) / (amplitudes[0] + flat), N[1] / (amplitudes[1] + flat), N[2] / amplitudes[2]
    k2, rest = 4.0 * k1 / ((1.0 + k1) * (1.0 + k1)), G / a

    least = max(size(part), LEAST_PART)
    cos, sin = of_turns(0.5 * least)
    ratio = cs_of(a, g, cos, sin) / a
    s2 = 1.0 / (1.0 + ratio * ratio)
    s = sqrt(s2)
    c = ratio * s
    k1_prime = g / a
    dv = sqrt(c * c + k1_prime * k1_prime * s2)
    under = 1.0 + k1 * s2
    sn1 = (1.0 + k1) * s / under * where_less(part, 0.0, -one, one)
    cn1, dn1 = c * dv / under, (c * c + s2 * rest) / under

    below = 1.0 / (cn1 * cn1 + sn1 * sn1 * dn0 * dn0)
    cn = (cn0 * cn1 - sn0 * sn1 * dn0 * dn1) * below
    sn = (sn0 * cn1 * dn1 + sn1 * cn0 * dn0) * below
    cn, sn = _on_circle(cn, sn)
    k_prime = rest / (1.0 + k1)
    dn = sqrt(k_prime * k_prime + k2 * (cn * cn))

    here = where_less(cn0, 0.0, -one, one)
    there = where_less(cn * here, 0.0, -one, one)  # -1 in the cell beside
    cell = 0.5 * (1.0 - there) * where_less(part, 0.0, -one, one)
    beta = both - 1.0
    more = _third_kind(sn * here * there, cn, dn, k1, rest, beta) - _third_kind(sn0 * here, cn0, dn0, k1, rest, beta)
    return cn, sn, dn, more + 2.0 * whole * (cell - part)


@inlined
def _root(x: Any) -> Any:
    """Of a double-double, 0 too."""
    flat = where_less(0.0, upper(x), 0.0, 1.0 + 0.0 * upper(x))
    return sqrt(x + flat) - flat


@inlined
def _times(x: Any, y: Any) -> Any:
    """The double-double x times the number y, as a number."""
    first = upper(x)
    return fma(first, y, upper(x - first) * y)


@inlined
def _on_circle(cn: Any, sn: Any) -> Any:
    """The same with cn^2 + sn^2 = 1, so that energy and |M| stay."""
    c2, s2 = cn * cn, sn * sn
    left = 0.5 * (((1.0 - c2) - s2) - (fma(cn, cn, -c2) + fma(sn, sn, -s2)))
    return fma(left, cn, cn), fma(left, sn, sn)


@inlined
def _third_kind(sn: Any, cn: Any, dn: Any, k1: Any, rest: Any, beta: Any) -> Any:
    """Q of (v, k_1) from the functions at u = (1 + k_1) v; `rest`: 1 - k_1."""
    above = 1.0 + dn
    s = 2.0 * sn / ((1.0 + k1) * above)
    s2 = s * s
    d2 = (rest + dn * (1.0 + k1)) / above
    delta = s2 * s2 * s2 * beta * (1.0 + beta) * (k1 * k1 + beta)
    return s * s2 * third_kind(4.0 * cn * cn / (above * above * d2), d2, 1.0 + 0.0 * s2, 1.0 + beta * s2, delta) / 3.0


@inlined
def between(first: Any, N: Any, L: Any, cos: Any, sin: Any) -> Any:
    """The quaternion p(first)^-1 z p(N), z = (cos, 0, 0, sin)."""
    A0, A = L + first[2], L + N[2]
    a0, b0, a, b = first[0], first[1], N[0], N[1]
    unit = 0.5 / (L * sqrt(A0 * A))
    w, x, y, z = cos * A, cos * b + sin * a, sin * b - cos * a, sin * A
    return (
        (A0 * w + b0 * x - a0 * y) * unit,
        (A0 * x - b0 * w + a0 * z) * unit,
        (A0 * y + a0 * w + b0 * z) * unit,
        (A0 * z - b0 * y - a0 * x) * unit,
    )
