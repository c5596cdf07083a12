"""A step of the free body, n = 3, of moderate length in closed form: its integrals may change from step to step.

M' = M x Omega, Omega_i = M_i/I_i, g' = g hat(Omega).  With Weierstrass' function wp of the integrals, wp - e_i = P_i^2,

    e_k - e_j = (I_k - I_j)(L^2 - 2T I_i)/(I_1 I_2 I_3),   i, j, k cyclic,
    M_i(t) = (M_i P_j P_k + M_i' P_i)/(P_i^2 + M_i^2 (I_j - I_i)(I_k - I_i)/(I_1 I_2 I_3 I_i)),   P at t,

the addition theorems of sn, cn and dn in one form for all axes (P_i is lambda ds, ns or cs), so that nothing is sorted
and no case is set apart.  t P_i is regular at t = 0; P_i(t) follows from P_i(t/2) and Laurent's series of wp.  And

    g(t) = g z(psi) p,   p M(t) = M,   psi' = L (2T + Omega.M(t))/(L^2 + M.M(t)),

p the shortest such turn, z(psi) the turn about M by psi, which is integrated by Gauss's rule.  [DLMF 22.8, 23.9, 23.10]
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.exact.weierstrass import laurent

NODES = 8  # lambda t = 0.5: psi is off by 2e-16; 1: by 6e-15
ORDERS = 11  # of Laurent's series: full precision up to lambda t = 1
LONGEST, MOST_TURN = 1.25, 8.0  # lambda h: psi is off by 1e-13; and |Omega| h
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
        "gaps": (third - second) / product,
        "curvatures": (second - I) * (third - I) / (product * I),
    }


def step(M: Array, g: Array, *, h: Array, **known: Array) -> tuple[Array, Array]:
    """(M, g) after the time h, M (..., 3) axial, g (..., 4) a unit quaternion; `known`: of `constants`.

    For lambda h up to 1, lambda the rate of the elliptic functions, at most the difference of two rates L/I_i, and
    turns up to 8 radians.
    """
    series = _series(M, h, **known)
    Omega, L2 = known["inverse"] * M, algebra.dot(M, M)
    energy, psi = algebra.dot(Omega, M), 0 * L2  # psi/L
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    for node, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        N = _moved(M, float(node), h, series, **known)
        rate = (energy + algebra.dot(N, Omega)) / (L2 + algebra.dot(N, M) + TINY)
        psi = psi + float(weight) * rate
    N = restored(_moved(M, 1.0, h, series, **known), M, known["inverse"])
    lift = algebra.quaternion(L2 + algebra.dot(N, M) + TINY, algebra.cross(N, M))
    z = algebra.turn(algebra.vec(psi * h) * M)
    return N, algebra.quaternion_product(g, algebra.unit(algebra.quaternion_product(z, lift)))


def reach(M: Array, h: Array, *, inverse: Array, gaps: Array, **_: Array) -> Array:
    """A measure of the length of a step, at most 1 up to lambda h = 1.25 and turns by 8 radians."""
    d = _differences(M, h, inverse=inverse, gaps=gaps)  # their sum is 0: (d.d)/1.5 >= (lambda h)^4
    angle = algebra.dot(M, M) * algebra.dot(inverse, inverse) * (h * h)
    return algebra.maximum(algebra.dot(d, d) / (1.5 * LONGEST**4), angle / MOST_TURN**2)


def _differences(M: Array, h: Array, *, inverse: Array, gaps: Array) -> Array:
    """(e_k - e_j) h^2."""
    squares, unit = M * M * inverse, h * h / (inverse[..., 0] * inverse[..., 1] * inverse[..., 2])
    apart = squares[..., SECOND] * gaps[..., THIRD] - squares[..., THIRD] * gaps[..., SECOND]  # L^2 - 2T I_i
    return gaps * apart * algebra.vec(unit)


def _series(M: Array, h: Array, *, inverse: Array, gaps: Array, **_: Array) -> tuple[Array, list[Array]]:
    """The e_i h^2, and the coefficients of x^4, x^6, ... in x^2 wp(x) - 1, x in units of h."""
    d = _differences(M, h, inverse=inverse, gaps=gaps)
    e = (d[..., SECOND] - d[..., THIRD]) / 3
    e1, e2, e3 = e[..., 0], e[..., 1], e[..., 2]
    return e, laurent(-(e1 * e2 + e2 * e3 + e3 * e1) / 5, e1 * e2 * e3 / 7, ORDERS)


def restored(N: Array, M: Array, inverse: Array, b: Any = 0) -> Array:
    """N with the integrals of M, |M| and M.(inverse M/2 - b): else rounding, alike in all steps, lets them drift."""
    L2 = algebra.dot(M, M)
    N = N + algebra.vec((L2 - algebra.dot(N, N)) / (2 * L2 + TINY)) * N
    Omega = inverse * N - b
    across = Omega - algebra.vec(algebra.dot(N, Omega) / (L2 + TINY)) * N
    size = algebra.dot(Omega, Omega) + TINY
    sine = algebra.dot(across, Omega) / size  # its square
    missing = (algebra.dot(M, inverse * M - 2 * b) - algebra.dot(N, Omega - b)) / (2 * size)
    return N + algebra.vec(missing * sine / (sine * sine + NEAR**2)) * across


def _moved(
    M: Array,
    node: float,
    h: Array,
    series: tuple[Array, list[Array]],
    *,
    rates: Array,
    curvatures: Array,
    **_: Array,
) -> Array:
    """M at the time node h."""
    e, c = series
    X = (node / 2) ** 2
    wp = 0 * c[0]
    for coefficient in reversed(c):
        wp = wp * X + coefficient
    squares = algebra.vec(1 + X * X * wp) - X * e  # (x P_i)^2 at half the time
    a, b = squares * squares[..., SECOND], squares * squares[..., THIRD]
    root = algebra.sqrt(algebra.vec(squares[..., 0] * squares[..., 1] * squares[..., 2]))
    y = (a + b - a[..., SECOND]) / root
    time = node * h
    below = algebra.dot(y, y) + algebra.dot(M * M, curvatures) * (time * time)
    rate = rates * M[..., SECOND] * M[..., THIRD]
    return (M * y[..., SECOND] * y[..., THIRD] + algebra.vec(time) * rate * y) * algebra.vec(3 / below)
