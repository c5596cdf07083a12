"""One motion, n = 3, over a time, by a fixed number of operations to be recorded: free bodies and Lagrange tops.

In mpmath: `kreisel.exact.rotor`, `kreisel.exact.motion`.  Elliptic integrals and functions come first, on scalars of
any kind.  Arguments that need more iterations than there are give a result with its error, or no number.
Double-doubles carry the quantities that the number of rotations or of periods multiplies.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from kreisel.algebra import sqrt
from kreisel.exact.nutation import Integrals, squared_length, turning
from kreisel.graph.arranging import Formula
from kreisel.graph.double import DoubleDouble, two_sum, upper
from kreisel.graph.graph import fma, if_positive, maximum, nearest, repeated, sign, where_less

PI = 3.141592653589793, 1.2246467991473532e-16  # and its remainder
MEANS = 5  # enough for a/g = 100, if the first step of the mean was made
DUPLICATIONS = 6  # of the arguments of R_J, whose ratios are at most 1e4
LEVELS = 6  # of Landen's transformation
BEYOND = DUPLICATIONS + 7  # for ratios up to 1e46
TURN = 0.15915494309189535, -9.839338337591867e-18  # 1/(2 pi)
PLACE = 2.0**-102  # a rounding of double-doubles, some together
SMALLEST, LARGEST = 1e-60, 1e60  # of momenta, moments and energies: outside, products of them leave the range


# -- elliptic integrals and functions --------------------------------------------------------------------


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


# -- the free body ---------------------------------------------------------------------------------------

# The moments enter by rho = (I_3 - I_2)/(I_3 - I_1) and 1 - rho, so that none of the quotients is 0/0 for a ball, and
# D, E and L^2 - 2T I_2 by D/(I_3 - I_1) = f_1 + rho f_2, f_i = M_i^2/I_i, and the like.
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


# -- the Lagrange top ------------------------------------------------------------------------------------

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
    turned = turned - 2.0 * nearest(0.5 * upper(turned)) + (excess - 2.0 * nearest(0.5 * upper(excess)))
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

    Last, 1 where doubles do not do: near the steady motion to which the separatrix tends, and after tiny times.
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
    small = where_less(0.0, abs(fraction), where_less(angle, 2.0 * LEAST_ANGLE, 1.0, 0.0), 0.0)
    return count, (gap, d1, d2, bottom + gap), small + where_less(STEEP * d2, scale, 1.0, 0.0)
