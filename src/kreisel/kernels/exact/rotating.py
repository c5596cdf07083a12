"""One motion of the free body, n = 3, over a time, by operations to be recorded; in mpmath: `kreisel.exact.rotor`.

Double-doubles carry the quantities that the number of rotations multiplies.  The
moments enter by rho = (I_3 - I_2)/(I_3 - I_1) and 1 - rho, so that none of the quotients is 0/0 for a ball, and
D, E and L^2 - 2T I_2 by D/(I_3 - I_1) = f_1 + rho f_2, f_i = M_i^2/I_i, and the like.
"""

from __future__ import annotations

from typing import Any

from kreisel.algebra import sqrt
from kreisel.graph.double import DoubleDouble, two_sum, upper
from kreisel.graph.graph import fma, if_positive, maximum, nearest, sign, where_less
from kreisel.kernels.exact.elliptic import (
    BEYOND,
    PI,
    TURN,
    arctan_ratio,
    complete_beyond,
    cs_beyond,
    either,
    of_turns,
    third_kind,
)

PLACE = 2.0**-102  # a rounding of double-doubles, some together
SMALLEST, LARGEST = 1e-60, 1e60  # of momenta and moments: outside, products of them leave the range
LEAST_PART = 1e-100  # of a rotation, in place of 0
SMALL_MODULUS = 1e-3  # k' below which means, Landen's transformations and duplications need more steps
LEAST_MODULUS = 1e-23  # and below which a motion is one on the separatrix, for so many e-foldings from both ends:
FOLDINGS, LEAST_START = 18.0, 1e-7  # k'^2 e^(2 u) is at most 1e-14 of cn and dn
CLOSE = 1e-3  # of L^2 - 2T I_2 to its terms: nearer, it is a sum of triples of doubles
TRIPLE = 2.0**-155  # a rounding of these, some together


def in_order(test: Any, x: Any, y: Any) -> Any:
    """(y, x) where test < 0, else (x, y): scalars."""
    return where_less(test, 0.0, y, x), where_less(test, 0.0, x, y)


def _sorted(test: Any, I: Any, J: Any, M: Any, N: Any) -> Any:  # noqa: E741
    return either(test, J, I), either(test, I, J), *in_order(test, M, N)


def _two_product(x: Any, y: Any) -> Any:
    product = x * y
    return product, fma(x, y, -product)


def _halves(x: Any) -> Any:
    """The two scalars of a double-double."""
    first = upper(x)
    return first, upper(x - first)


def _apart(x: Any, y: Any) -> Any:
    """x - y, double-doubles whose difference is one, exactly: two scalars."""
    (x0, x1), (y0, y1) = _halves(x), _halves(y)
    s, r = two_sum(x0, -y0)
    s1, r1 = two_sum(x1, -y1)
    a, b = two_sum(r, s1)
    c, d = two_sum(s, a)
    return two_sum(c, d + (b + r1))


def _triple(x: Any, y: Any) -> Any:
    """The product of three and of two scalars that represent their sums, as three: 159 bits but for some."""
    (x0, x1, x2), (y0, y1) = x, y
    p0, e0 = _two_product(x0, y0)
    p1, e1 = _two_product(x0, y1)
    p2, e2 = _two_product(x1, y0)
    s1, t1 = two_sum(p1, p2)
    s2, t2 = two_sum(e0, s1)
    a, b = two_sum(p0, s2)
    b, c = two_sum(b, (t1 + t2) + ((e1 + e2) + (x1 * y1 + x2 * y0)))
    return a, b, c


def _gap(I1: Any, I2: Any, I3: Any, N1: Any, N3: Any) -> Any:
    """I_1 I_3 (L^2 - 2T I_2) = N_3^2 I_1 (I_3 - I_2) - N_1^2 I_3 (I_2 - I_1), where its terms nearly cancel."""
    x0, x1, x2 = _triple(_triple((*_halves(I1), 0.0), _apart(I3, I2)), _two_product(N3, N3))
    y0, y1, y2 = _triple(_triple((*_halves(I3), 0.0), _apart(I2, I1)), _two_product(N1, N1))
    s0, r0 = two_sum(x0, -y0)
    s1, r1 = two_sum(x1, -y1)
    a, b = two_sum(r0, s1)
    c, d = two_sum(s0, a)
    first, second = two_sum(c, d + (b + (r1 + (x2 - y2))))
    return DoubleDouble(first, second)


def rotated(moments: Any, momentum: Any, t: Any) -> Any:
    """The momentum after t, the rotation g(0)^-1 g(t) as a quaternion, and the possible error of the phases.

    `moments`: three double-doubles; `momentum`: three scalars; t: a double-double.  The error is in revolutions.
    """
    I, N, swaps = list(moments), list(momentum), list[Any]()  # noqa: E741
    for i in (0, 1, 0):
        test = upper(I[i + 1] - I[i])
        swaps.append((i, i + 1, test))
        I[i], I[i + 1], N[i], N[i + 1] = _sorted(test, I[i], I[i + 1], N[i], N[i + 1])
    (I1, I2, I3), (N1, N2, N3) = I, N
    flips = sign(swaps[0][2]) * sign(swaps[1][2]) * sign(swaps[2][2])

    width = I3 - I1
    ball = where_less(0.0, upper(width), 0.0, 1.0)
    rho, kappa = (I3 - I2 + 0.5 * ball) / (width + ball), (I2 - I1 + 0.5 * ball) / (width + ball)
    f1, f2, f3 = (DoubleDouble(N) * DoubleDouble(N) / I for N, I in ((N1, I1), (N2, I2), (N3, I3)))  # noqa: E741
    gap, terms = rho * f3 - kappa * f1, rho * f3 + kappa * f1
    close = where_less(abs(upper(gap)), CLOSE * upper(terms), 1.0 - ball, 0.0)
    gap = either(-close, _gap(I1, I2, I3, N1, N3) / (I1 * I3 * width + ball), gap)
    last = upper(gap)
    still = where_less(0.0, abs(N1) + abs(N3), 0.0, 1.0)  # a rotation about the second axis
    middle = t * (DoubleDouble(N2) / I2) * (0.5 * DoubleDouble(TURN[0], TURN[1]))
    swaps.append((0, 2, last))
    I1, I3, N1, N3 = _sorted(last, I1, I3, N1, N3)
    f1, f3, rho, kappa = either(last, f3, f1), either(last, f1, f3), either(last, kappa, rho), either(last, rho, kappa)
    s, side = sign(last), sign(N3)
    chi = s * flips * side
    gap = either(last, -gap, gap)

    constants = I1, I2, I3, N1, N2, side * N3, f1, f2, f3, rho, kappa, gap, terms, width * s
    n1, n2, n3, w, x, y, z, off = about_the_third_kind(constants, chi, t)
    cos, sin = of_turns(upper(middle - nearest(upper(middle))))
    moving = [n1, n2, side * n3, w, chi * x, chi * y, chi * side * z, off]
    resting = [0.0, N2, 0.0, cos, 0.0, sin, 0.0, PLACE * (1.0 + abs(upper(middle)))]
    result = [where_less(0.0, still, u, v) for u, v in zip(resting, moving, strict=True)]
    for i, j, test in reversed(swaps):
        for k in (0, 4):  # of the momentum and of the rotation's vector
            result[i + k], result[j + k] = in_order(test, result[i + k], result[j + k])
    return tuple(result)


def about_the_third_kind(constants: Any, chi: Any, t: Any) -> Any:
    """The rotation for axes in the order of `kreisel.exact.rotor`, M_3 >= 0, whose formulas these are."""
    I1, I2, I3, N1, N2, N3, f1, f2, f3, rho, kappa, gap, terms, width = constants
    d, e, volume = f1 + rho * f2, kappa * f2 + f3, I1 * I2 * I3  # D and E over I_3 - I_1
    squares = I1 * d, I2 * d / rho, I3 * e
    L = sqrt(I1 * f1 + I2 * f2 + I3 * f3)
    a3 = sqrt(squares[2])
    total = L + a3
    least = rho * e * (LEAST_MODULUS * LEAST_MODULUS)
    lost = where_less(upper(gap), upper(least), 1.0, 0.0)
    gap = either(-lost, least, gap)
    A, G = sqrt(rho * e / volume), sqrt(gap / volume)  # lambda and lambda k' over |I_3 - I_1|
    beyond = where_less(upper(G), SMALL_MODULUS * upper(A), 1.0, 0.0)
    a, g = (A + G) / 2, sqrt(A * G)
    k1 = kappa * d / (volume * (4 * a * a))
    beta_plus_1 = 1 + k1 * squares[0] / (total * total)  # 1 + beta
    mean, sum_, last = complete_beyond(a, g, a * sqrt(beta_plus_1), beyond)
    inverse_turn = DoubleDouble(TURN[0], TURN[1])
    breadth = width * sign(upper(width))
    halves = t * breadth * mean * (2 * inverse_turn)  # of lambda t, in 2 K
    count = nearest(upper(halves))
    fraction = upper(halves - count)
    left = upper(halves - count - fraction)  # 30 roundings of u next to the separatrix
    slope = width * d / (I3 * total) * (1 + a3 * k1 * sum_ / (total * beta_plus_1))
    turns = t * (L / I3 + slope) * (0.5 * inverse_turn)  # of a quarter of psi
    turns = upper(turns - nearest(upper(turns)))

    a1, a2 = _root(squares[0]), _root(squares[1])
    amplitudes = upper(a1), upper(a2), upper(a3)
    doubles = amplitudes, upper(L), upper(a), upper(g), upper(G), upper(k1), upper(beta_plus_1)
    ratio = upper(A) / upper(a)  # 1 + k_1
    strength = upper(d) * ratio * 2.0 * upper(a3 * k1) / (upper(I3 * A) * upper(total) * upper(total))
    late = PI[0] * upper(a) * ratio / upper(mean) * left
    third = 0.25 * PI[0] * upper(a) / upper(mean) * upper(sum_) / upper(beta_plus_1)  # Q at K of k_1
    direction = chi * sign(upper(width))
    first = N1, N2, N3
    cn, sn, dn, ripple = moved(doubles, first, (fraction * direction, late * direction), third, strength, beyond)
    odd = count - 2.0 * nearest(0.5 * count)
    back = where_less(0.5, odd * odd, -1.0, 1.0)
    N1, N2, N3 = _times(a1, cn * back), _times(a2, sn * back), _times(a3, dn)
    rotation = chi * turns + 0.5 * TURN[0] * ripple
    cos, sin = of_turns(rotation - nearest(rotation))
    w, x, y, z = between(first, (N1, N2, N3), upper(L), cos, sin)

    periods = abs(upper(halves))
    close = upper(terms) / upper(gap)
    rough = where_less(close, 1.0 / CLOSE, close, 1.0)
    off = (1.0 + periods + abs(upper(t * L / I3))) * (PLACE * (1.0 + rough) + last)
    off = off + (1.0 + periods) * TRIPLE * close * (1.0 - lost)
    foldings = abs(upper(t * breadth * A))
    remainder = where_less(abs(first[0]), LEAST_START * amplitudes[0], 1.0, where_less(FOLDINGS, foldings, 1.0, 0.0))
    largest = maximum(upper(L), maximum(upper(I1), upper(I3)))
    least = 1.0 / maximum(1.0 / upper(L), maximum(1.0 / upper(I1), 1.0 / upper(I3)))
    far = where_less(LARGEST, largest, 1.0, where_less(least, SMALLEST, 1.0, 0.0))
    return N1, N2, N3, w, x, y, z, off + far + lost * remainder


def moved(constants: Any, N: Any, time: Any, count: Any, strength: Any, beyond: Any) -> Any:
    """(cn, sn, dn) at u_0 + 2 K fraction + late, and psi there minus psi at u_0 and the mean, in doubles.

    Up to the sign of cn and sn that u_0 has: N tells u_0.  By the addition theorems.  `time`: fraction (<= 1/2), late.
    """
    amplitudes, L, a, g, G, k1, beta_plus_1 = constants
    fraction, late = time
    flat = where_less(0.0, amplitudes[0], 0.0, 1.0)  # a rotation about the axis: cn = 1
    cn0, sn0, dn0 = (N[0] + flat) / (amplitudes[0] + flat), N[1] / (amplitudes[1] + flat), N[2] / amplitudes[2]
    k2, remainder = 4.0 * k1 / ((1.0 + k1) * (1.0 + k1)), G / a

    least = maximum(abs(fraction), LEAST_PART)
    cos, sin = of_turns(0.5 * least)
    ratio = cs_beyond(a, g, cos, sin, beyond) / a
    s2 = 1.0 / (1.0 + ratio * ratio)
    s = sqrt(s2)
    c = ratio * s
    k1_prime = g / a
    dv = sqrt(c * c + k1_prime * k1_prime * s2)
    under = 1.0 + k1 * s2
    sn1 = (1.0 + k1) * s / under * sign(fraction)
    cn1, dn1 = c * dv / under, (c * c + s2 * remainder) / under

    below = 1.0 / (cn1 * cn1 + sn1 * sn1 * dn0 * dn0)
    cn = (cn0 * cn1 - sn0 * sn1 * dn0 * dn1) * below
    sn = (sn0 * cn1 * dn1 + sn1 * cn0 * dn0) * below
    k_prime = remainder / (1.0 + k1)
    dn = sqrt(k_prime * k_prime + k2 * (cn * cn))
    cn, sn = _on_circle(cn - late * dn * sn, sn + late * dn * cn)
    dn = sqrt(k_prime * k_prime + k2 * (cn * cn))

    side = sign(cn0)
    crossing = sign(cn * side)  # -1 in the cell next to
    cell = 0.5 * (1.0 - crossing) * sign(fraction)
    before, after = (sn0 * side, cn0 * side, dn0), (sn * side * crossing, cn * side * crossing, dn)
    beta = beta_plus_1 - 1.0
    change = _third_kind(after, k1, remainder, beta) - _third_kind(before, k1, remainder, beta)
    near = strength * (change + 2.0 * count * (cell - fraction))

    def far() -> list[Any]:
        shape = amplitudes, L, k_prime * k_prime
        change = _behind(before, shape) - _behind(after, shape)
        ripple = change - 2.0 * _behind((1.0, 0.0, k_prime), shape) * (cell - fraction)
        return [where_less(0.0, beyond, ripple, near)]

    return cn, sn, dn, if_positive(beyond, far, [near])[0]


def _root(x: Any) -> Any:
    """The square root of a double-double, 0 too."""
    flat = where_less(0.0, upper(x), 0.0, 1.0)
    return sqrt(x + flat) - flat


def _times(x: Any, y: Any) -> Any:
    """The double-double x times the number y, as a number."""
    first = upper(x)
    return fma(first, y, upper(x - first) * y)


def _on_circle(cn: Any, sn: Any) -> Any:
    """(cn, sn) corrected to cn^2 + sn^2 = 1, so that energy and |M| stay."""
    c2, s2 = cn * cn, sn * sn
    left = 0.5 * (((1.0 - c2) - s2) - (fma(cn, cn, -c2) + fma(sn, sn, -s2)))
    return fma(left, cn, cn), fma(left, sn, sn)


def _third_kind(functions: Any, k1: Any, remainder: Any, beta: Any) -> Any:
    """Q of (v, k_1), from the functions at u = (1 + k_1) v; `remainder`: 1 - k_1."""
    sn, cn, dn = functions
    above = 1.0 + dn
    s = 2.0 * sn / ((1.0 + k1) * above)
    s2 = s * s
    d2 = (remainder + dn * (1.0 + k1)) / above
    delta = s2 * s2 * s2 * beta * (1.0 + beta) * (k1 * k1 + beta)
    c2 = 4.0 * cn * cn / (above * above * d2)
    return s * s2 * third_kind(c2, d2, 1.0, 1.0 + beta * s2, delta) / 3.0


def _behind(functions: Any, shape: Any) -> Any:
    """2T t/L - psi from u = 0, cn >= 0, where k' is small: it stays below pi, and small errors of u are small in it."""
    (sn, cn, dn), ((a1, a2, a3), L, remainder) = functions, shape
    M1, M2, M3 = a1 * cn, a2 * sn, a3 * dn
    x = M1 * M2 * (M1 * M1 + M2 * M2) / ((L + M3) * (L * M1 * M1 + M2 * M2 * M3))
    first, third = a1 / L, a3 / L
    c2, s2, d2 = cn * cn, sn * sn, dn * dn
    small = remainder * s2
    p = c2 + small * (third * third)
    delta = small * small * (first * first) * (third * third) * (1.0 - p)
    area = first * (a2 / L) * third * small * sn * third_kind(c2, d2, 1.0, p, delta, BEYOND) / 3.0
    return x * arctan_ratio(x * x) + area


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
