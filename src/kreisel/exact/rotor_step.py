"""A step of the free body, n = 3, of moderate length in closed form: its integrals may change from step to step.

M' = M x Omega, Omega_i = M_i/I_i, g' = g hat(Omega).  With Weierstrass' function wp of the integrals, wp - e_i = P_i^2,

    e_k - e_j = (I_k - I_j)(L^2 - 2T I_i)/(I_1 I_2 I_3),   i, j, k cyclic,
    M_i(t) = (M_i P_j P_k + M_i' P_i)/(P_i^2 + M_i^2 (I_j - I_i)(I_k - I_i)/(I_1 I_2 I_3 I_i)),   P at t,

the addition theorems of sn, cn and dn in one form for all axes (P_i is lambda ds, ns or cs), so that nothing is sorted
and no case is set apart.  t P_i is regular at t = 0; P_i(t) follows from P_i(t/2) and Laurent's series of wp.  And

    g(t) = g z(psi) p,   p M(t) = M,   psi' = L (2T + Omega.M(t))/(L^2 + M.M(t)),

p the shortest such rotation, z(psi) the rotation about M by psi, which is integrated by Gauss's rule.  M and g on the
right are those in the middle of the step: P is odd, so times t and -t from the middle share it.  [DLMF 22.8, 23.9,
23.10]
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.iteration import by_rows

# Largest error of M/L and of g over 24 random bodies, lambda h = 1.5: 7e-16, 9e-16; 2: 6e-16, 2e-15; 2.5: 8e-15, 4e-14.
# With six nodes 1e-14 at 1, with eight orders 6e-14 at 2.
NODES, ORDERS = 8, 10  # of Gauss's rule; of Laurent's series
LONGEST, MOST_TURN = 2.5, 8.0  # lambda h; and |Omega| h
NEAR = 1e-2  # of an axis, sin^2 of the angle from M to Omega: there the energy adds nothing to |M|
TINY = 1e-140  # a body at rest: no 0/0
SECOND, THIRD = [1, 2, 0], [2, 0, 1]


def constants(I: Array) -> dict[str, Array]:  # noqa: E741
    """Values that the moments (..., 3) determine."""
    second, third = I[..., SECOND], I[..., THIRD]
    product = algebra.vec(I[..., 0] * I[..., 1] * I[..., 2])
    return {
        "inverse": 1 / I,
        "rates": (second - third) / (second * third),
        "curvatures": (second - I) * (third - I) / (product * I),
    }


def step(
    M: Array,
    g: Array,
    *,
    h: Array,
    nodes: int = NODES,
    orders: int = ORDERS,
    restore: bool = True,
    tiny: float = TINY,
    **constants: Array,
) -> tuple[Array, Array]:
    """(M, g) after the time h, M (..., 3) axial, g (..., 4) a unit quaternion, by `constants`.

    For lambda h up to 2.5, lambda the rate of the elliptic functions, at most the difference of two rates L/I_i, and
    turns up to 8 radians.
    """
    L2, energy, curve = algebra.dot(M, M), (constants["inverse"] * (M * M)).sum(-1), _curve(M, h, orders, **constants)
    share = 1 / (L2 + tiny)
    half, square = _ratios((1.0, 1.0, 1.0), curve)
    root = algebra.sqrt(square)
    middle = _moved(M, half, square, root, 0.5, h, curve.bend, **constants)
    full, square2 = _doubled(half * half)
    root2 = half[..., 0] * half[..., 1] * half[..., 2] * root
    end = _moved(M, full, square2 * square, root2, 1.0, h, curve.bend, **constants)
    end = restored(end, M, constants["inverse"]) if restore else end
    psi = 0.5 * h * _angle(middle, h, (L2, share, energy), curve, nodes, **constants)
    return end, algebra.quaternion_product(g, _turn(M, middle, end, psi, share, algebra.dot(g, g)))


def _turn(M: Array, middle: Array, end: Array, psi: Array, share: Array, square: Array) -> Array:
    """The rotation of a step, divided by the root of `square`; `psi` is L psi, `share` 1/L^2.

    Of unit vectors, p_(M middle) z p_(middle end) = (C (1 + M.end), C end x M + S (M + end)) up to a factor, and

        C + i S = exp(i psi/2) (1 + M.middle + middle.end + end.M + i M.(end x middle)):

    the area between the three is one more angle.
    """
    sum_, apart, L2 = M + end, M - end, algebra.dot(M, M)
    scalar, vector = 2 - (0.5 * share) * algebra.dot(apart, apart), algebra.vec(share) * algebra.cross(end, M)
    real, area = scalar + share * algebra.dot(sum_, middle), share * algebra.dot(vector, middle)
    size = (real * real + area * (area * L2)) * (2 * scalar)
    unit = 1 / algebra.sqrt(size * square)  # before psi is known: processors need not wait
    real, area = unit * real, unit * area
    cos, ratio = algebra.half_turn(psi * (psi * share))
    sine = (psi * share) * ratio
    C, S = real * cos + (area * L2) * sine, real * sine - area * cos
    return algebra.quaternion(C * scalar, algebra.vec(C) * vector + algebra.vec(S) * sum_)


def _angle(
    middle: Array, h: Array, integrals: tuple[Array, Array, Array], curve: Curve, nodes: int, **constants: Array
) -> Array:
    """The mean of L psi'; `integrals`: L^2, 1/L^2, 2T."""
    (L2, share, energy), inverse, rates = integrals, constants["inverse"], constants["rates"]
    h = algebra.vec(h)
    squares = middle * middle
    bend, odd = algebra.dot(squares, 0.25 * h * h * constants["curvatures"]), h * rates
    along, Omega = algebra.vec(3 * share) * squares, (3 * inverse) * squares
    cubic = (1 / 12 * L2) * (along[..., 0] * along[..., 1] * along[..., 2])
    power = cubic * L2

    def mean(weight: Array, *powers: Array) -> Array:
        """L psi', the mean of the times -t and t from the middle, times a weight; `powers` of (2t/h)^2."""
        y, product = _ratios(powers, curve)
        root2 = product * powers[0]
        below, pairs = _below(y, bend * root2), y[..., SECOND] * y[..., THIRD]
        p, u = energy * below + algebra.dot(Omega, pairs), below + algebra.dot(along, pairs)
        v = algebra.dot(odd, y)
        t = v * root2
        return (p * (weight * u) - power * (weight * t * algebra.dot(odd * inverse, y))) / (u * u - cubic * (t * v))

    places, weights = (values[nodes // 2 :] for values in np.polynomial.legendre.leggauss(nodes))
    return _total(by_rows(mean, [(w, x**2, x**4, x**6) for x, w in zip(places, weights, strict=True)], middle))


def _below(y: Array, bend: Array) -> Array:
    """The denominator of a motion, in halves."""
    return (y[..., 0] * y[..., 0] + bend) + (y[..., 1] * y[..., 1] + y[..., 2] * y[..., 2])


def _total(terms: list[Array]) -> Array:
    """A sum by halves, which processors add at once."""
    half = len(terms) // 2
    return _total(terms[:half]) + _total(terms[half:]) if half else terms[0]


def reach(M: Array, h: Array, *, inverse: Array, curvatures: Array, **_: Array) -> Array:
    """A measure of the length of a step, at most 1 up to lambda h = 2.5 and rotates by 8 radians."""
    e = _curve(M, h, ORDERS, curvatures=curvatures).roots  # 512 e.e >= (lambda h)^4
    angle = algebra.dot(M, M) * algebra.dot(inverse, inverse) * (h * h)
    return algebra.maximum(512 / LONGEST**4 * algebra.dot(e, e), angle / MOST_TURN**2)


class Curve(NamedTuple):
    """The elliptic functions of a trajectory, times in units of h/4.

    roots     e_i
    g2, g3    a quarter of the invariants of wp
    bend      a third of the sum of the curvatures times M_i^2
    orders    of the series
    """

    roots: Array
    g2: Array
    g3: Array
    bend: Array
    orders: int


def _curve(M: Array, h: Array, orders: int, *, curvatures: Array, **_: Array) -> Curve:
    """wp(t) - e_i plus the curvature times M_i^2 is one number for all i, and the sum of the e_i is 0."""
    bends = M * M * (algebra.vec((1 / 48) * h * h) * curvatures)
    apart = bends[..., SECOND] - bends[..., THIRD]
    e = apart[..., THIRD] - apart[..., SECOND]
    product = e[..., 0] * e[..., 1]
    return Curve(e, e[..., 2] * e[..., 2] - product, product * e[..., 2], bends.sum(-1), orders)


def restored(N: Array, M: Array, inverse: Array, b: Any = 0) -> Array:
    """N with the integrals of M, |M| and M.(inverse M/2 - b): else rounding, alike in all steps, lets them drift.

    A correction below half a unit in the last place is lost, so 1e-17 of them a step is left.
    """
    apart, share = M - N, 1 / (algebra.dot(M, M) + TINY)
    squares = apart * (M + N)
    P = M if isinstance(b, int) else N  # without b the energy is known before N: processors need not wait
    energy = (inverse * (P * P) - b * P).sum(-1)
    missing = ((inverse - algebra.vec(energy * share)) * squares - 2 * b * apart).sum(-1)
    return corrected(N, share, energy, squares.sum(-1), missing, inverse, b)


def corrected(
    N: Array,
    share: Array,
    energy: Array,
    square: Array,
    missing: Array,
    inverse: Array,
    b: Any = 0,
    near: float = NEAR,
    tiny: float = TINY,
) -> Array:
    """N with |N|^2 larger by `square`, and N.((inverse - rate) N - 2 b) by `missing`, to first order.

    share  1/|N|^2;  energy  N.(inverse N - b);  rate  energy/|N|^2
    """
    rate = energy * share
    across = (inverse - algebra.vec(rate)) * N - b
    sine = algebra.dot(across, across)  # |Omega|^2 sin^2 of the angle from M to Omega
    along = near * rate * energy
    shift = (0.5 * missing * sine) / (sine * sine + (along * along + tiny))
    return N + algebra.vec(0.5 * square * share) * N + algebra.vec(shift) * across


def _ratios(powers: Sequence[Any], curve: Curve) -> tuple[Array, Array]:
    """The t P_i(t) times a root, and its square; the powers 2, 4, 6 of x = t/2."""
    square, fourth, sixth = powers
    total = series(curve.g2 * fourth, curve.g3 * sixth, curve.orders)
    return _doubled(algebra.vec(total) - square * curve.roots)  # (x P_i)^2


def _doubled(squares: Array) -> tuple[Array, Array]:
    """2x P_i(2x) times a root and its square, from the (x P_i(x))^2 times any number."""
    a = squares * squares[..., SECOND]
    b = a[..., THIRD]
    return (a + b) - a[..., SECOND], squares[..., 0] * a[..., 1]


def _rate(M: Array, rates: Array) -> Array:
    """M', or what is proportional to it."""
    return rates * M[..., SECOND] * M[..., THIRD]


def _moved(
    M: Array, y: Array, root2: Array, root: Array, time: float, h: Array, bend: Array, *, rates: Array, **_: Array
) -> Array:
    """M after the time `time` h."""
    below = _below(y, bend * (root2 * (48 * time**2)))
    turned = M * y[..., SECOND] * y[..., THIRD] + algebra.vec(time * root) * (_rate(M, algebra.vec(h) * rates) * y)
    return turned * algebra.vec(3 / below)


# -- Laurent's series of Weierstrass' function wp(t; g2, g3), for any kind of number [DLMF 23.9] ------


def laurent(first: Array, second: Array, orders: int) -> list[Array]:
    """Coefficients c_2, c_3, ... of t^4, t^6, ... in t^2 wp(t) - 1, the last c_orders; c_2 = g2/20, c_3 = g3/28.

    c_k = 3/((2k+1)(k-3)) sum_m c_m c_(k-m)
    """
    c, unit = [first, second], 0 * first + 1  # a unit of the same kind, so that the factors have its digits
    for k in range(4, orders + 1):
        half, odd = divmod(k - 4, 2)
        total = 0 if odd else 0.5 * unit * (c[half] * c[half])
        for i in reversed(range(half + odd)):  # the newest last: processors need not wait
            total = total + c[i] * c[k - 4 - i]
        c.append(6 * unit / ((2 * k + 1) * (k - 3)) * total)
    return c


@cache
def coefficients(orders: int) -> list[list[float]]:
    """K[a][b] in x^2 wp(x) = sum K[a][b] A^a B^b, A = g2 x^4/4, B = g3 x^6/4, up to x^(2 orders)."""
    c: dict[int, dict[tuple[int, int], Fraction]] = {2: {(1, 0): Fraction(1, 5)}, 3: {(0, 1): Fraction(1, 7)}}
    for k in range(4, orders + 1):
        c[k] = {}
        for m in range(2, k - 1):
            for (a, b), x in c[m].items():
                for (i, j), y in c[k - m].items():
                    old = c[k].get((a + i, b + j), Fraction(0))
                    c[k][a + i, b + j] = old + Fraction(3, (2 * k + 1) * (k - 3)) * x * y
    table = {(0, 0): Fraction(1)} | {place: x for terms in c.values() for place, x in terms.items()}
    rows = [[table[place] for place in sorted(table) if place[0] == a] for a in range(orders // 2 + 1)]
    return [[float(x) for x in row] for row in rows]


def series(A: Array, B: Array, orders: int) -> Array:
    """The polynomial of `coefficients`."""
    return algebra.polynomial([algebra.polynomial(row, B) for row in coefficients(orders)], A)
