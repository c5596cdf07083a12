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

from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.iteration import each
from kreisel.exact.weierstrass import laurent

# Largest error of M/L and of g over twelve random bodies, lambda h = 1.5: 6e-16, 7e-16; 2: 6e-16, 4e-15; 2.5: 7e-15,
# 8e-15.  With six nodes 1e-14 at 1, with eight orders 6e-14 at 2.
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
    **known: Array,
) -> tuple[Array, Array]:
    """(M, g) after the time h, M (..., 3) axial, g (..., 4) a unit quaternion; `known`: of `constants`.

    For lambda h up to 2.5, lambda the rate of the elliptic functions, at most the difference of two rates L/I_i, and
    turns up to 8 radians.
    """
    e, c = _series(M, h, orders, **known)
    half, inverse = (*_ratios(0.25, 0.0625, e, c), 0.5 * h), known["inverse"]
    middle = _moved(M, *half, **known)
    end = _moved(middle, *half, **known)
    end = restored(end, M, inverse) if restore else end
    Omega, rate, share = inverse * middle, _rate(middle, **known), 1 / (algebra.dot(M, M) + tiny)
    energy, bend = algebra.dot(Omega, middle), algebra.dot(middle * middle, known["curvatures"])
    even, odd, along = 3 * middle, 3 * rate, algebra.vec(share) * middle

    def mean(quarter: Array, square: Array, time: Array) -> Array:
        """L psi', the mean of the times -t and t from the middle; `time` and `quarter` t and t/2 in units of h."""
        y, root2, root = _ratios(quarter, square, e, c)
        t = time * h
        below, t = algebra.dot(y, y) + bend * root2 * (t * t), t * root
        U, V = even * y[..., SECOND] * y[..., THIRD], odd * y * algebra.vec(t)
        u, v = below + algebra.dot(along, U), algebra.dot(along, V)
        p, q = energy * below + algebra.dot(Omega, U), algebra.dot(Omega, V)
        return (p * u - q * v) / ((u - v) * (u + v))

    places, weights = (values[nodes // 2 :] for values in np.polynomial.legendre.leggauss(nodes))
    means = each(mean, [(x / 4, (x / 4) ** 2, x / 2) for x in places], M)
    psi = _total([float(w) * x for w, x in zip(weights, means, strict=True)])
    before, after = (_shortest(*pair, share) for pair in ((M, middle), (middle, end)))
    first = algebra.quaternion_product(g, before)
    first = first / algebra.sqrt(algebra.vec(algebra.dot(first, first) * algebra.dot(after, after)))
    z = algebra.turn(algebra.vec(psi * h) * along)
    return end, algebra.quaternion_product(algebra.quaternion_product(first, z), after)


def _total(terms: list[Array]) -> Array:
    """A sum by halves, which processors add at once."""
    half = len(terms) // 2
    return _total(terms[:half]) + _total(terms[half:]) if half else terms[0]


def _shortest(M: Array, N: Array, inverse: Array) -> Array:
    """The quaternion q of the shortest rotation with q N = M, of any length; `inverse`: 1/L^2."""
    return algebra.quaternion(1 + algebra.dot(M, N) * inverse, algebra.vec(inverse) * algebra.cross(N, M))


def reach(M: Array, h: Array, *, inverse: Array, curvatures: Array, **_: Array) -> Array:
    """A measure of the length of a step, at most 1 up to lambda h = 2.5 and rotates by 8 radians."""
    e = _roots(M, h, curvatures)  # 2 e.e >= (lambda h)^4
    angle = algebra.dot(M, M) * algebra.dot(inverse, inverse) * (h * h)
    return algebra.maximum(2 / LONGEST**4 * algebra.dot(e, e), angle / MOST_TURN**2)


def _series(M: Array, h: Array, orders: int, *, curvatures: Array, **_: Array) -> tuple[Array, list[Array]]:
    """The e_i h^2, and the coefficients of x^4, x^6, ... in x^2 wp(x) - 1, x in units of h."""
    e = _roots(M, h, curvatures)
    e1, e2, e3 = e[..., 0], e[..., 1], e[..., 2]
    return e, laurent(-0.2 * (e1 * e2 + e2 * e3 + e3 * e1), (1 / 7) * (e1 * e2 * e3), orders)


def _roots(M: Array, h: Array, curvatures: Array) -> Array:
    """The e_i h^2: wp(t) - e_i plus the curvature times M_i^2 is one number for all i, and their sum is 0."""
    bends = M * M * curvatures
    return (bends - algebra.vec((1 / 3) * bends.sum(-1))) * algebra.vec(h * h)


def restored(N: Array, M: Array, inverse: Array, b: Any = 0) -> Array:
    """N with the integrals of M, |M| and M.(inverse M/2 - b): else rounding, alike in all steps, lets them drift.

    A correction below half a unit in the last place is lost, so 1e-17 of them a step is left.
    """
    apart = M - N
    squares = apart * (M + N)
    energy = (inverse * squares - 2 * b * apart).sum(-1)
    return corrected(N, algebra.dot(M, M), squares.sum(-1), energy, inverse, b)


def corrected(
    N: Array,
    L2: Array,
    square: Array,
    energy: Array,
    inverse: Array,
    b: Any = 0,
    near: float = NEAR,
    tiny: float = TINY,
) -> Array:
    """N with |N|^2 = L2 larger by `square`, and N.(inverse N - 2 b) by `energy`, to first order."""
    share, Omega = 1 / (L2 + tiny), inverse * N - b
    rate, size = algebra.dot(N, Omega) * share, algebra.dot(Omega, Omega)
    across = Omega - algebra.vec(rate) * N
    sine = algebra.dot(across, across)  # |Omega|^2 sin^2 of the angle from M to Omega
    missing = 0.5 * (energy - rate * square)
    shift = missing * sine / (sine * sine + near**2 * (size * size) + tiny)
    return N + algebra.vec(0.5 * square * share) * N + algebra.vec(shift) * across


def _ratios(quarter: Array, square: Array, e: Array, c: list[Array]) -> tuple[Array, Array, Array]:
    """The t P_i(t), t = 2 quarter h, times a root; its square and the root; `square` of `quarter`."""
    even = odd = 0 * c[0]
    square2 = square * square
    for k in reversed(range(0, len(c), 2)):
        even = even * square2 + c[k]
        odd = odd * square2 + c[k + 1] if k + 1 < len(c) else odd
    squares = algebra.vec(1 + square2 * (even + square * odd)) - square * e  # (x P_i)^2, x = t/2
    a, b = squares * squares[..., SECOND], squares * squares[..., THIRD]
    product = squares[..., 0] * squares[..., 1] * squares[..., 2]
    return a + b - a[..., SECOND], product, algebra.sqrt(product)


def _rate(M: Array, *, rates: Array, **_: Array) -> Array:
    """M'."""
    return rates * M[..., SECOND] * M[..., THIRD]


def _moved(M: Array, y: Array, root2: Array, root: Array, t: Array, *, curvatures: Array, **known: Array) -> Array:
    """M after the time t."""
    below = algebra.dot(y, y) + algebra.dot(M * M, curvatures) * (root2 * (t * t))
    turned = M * y[..., SECOND] * y[..., THIRD] + algebra.vec(t * root) * _rate(M, **known) * y
    return turned * algebra.vec(3 / below)
