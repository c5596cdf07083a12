"""A step of the Lagrange top, n = 3, of moderate length in closed form: its integrals may change from step to step.

m' = p x a, a' = m x a, axial vectors of the rest frame.  The flow over h is the map D_eps and rotations about p and a:

    (mu - m x) e = 2 (a - rho p),     m1 = m + p x e,     a1 = a + (m + m1) x e/2,     <e, e> = 4 rho,
    (m, a) -> R_p(-theta) (m1, a1),     g -> R_p(-theta) H_e H_a R_a(psi + (1/alpha - 1) J h/A) g,

R_v(x) the rotation about v by x|v|, H_v the half-turn.  With A = |a|^2, P = |p|^2, J = m.a, c = m.p and the energy E,

    k = mu^2 = 4 wp(h) - 4E/3,     g2 = E^2/3 + AP - Jc,     g3 = E^3/27 - E (Jc + 2AP)/6 + (c^2 A + J^2 P)/4,
    rho^2 (kP + c^2) - rho (k^2 + 2Ek + 2Jc) + kA + J^2 = 0,   the smaller root,
    theta' = (J - c rho)/k,     psi' = (J - c rho)/(k rho),

wp Weierstrass' function.  In units of h all is regular at h = 0, and in the integrals, so that no case is set apart:
vertical, asleep, critical, at rest, without weight.  Where k <= 0, for |m|h = pi or so, there is no such map: NaN.
[docs/exact.md; DLMF 23.9, 23.10]

Operations of a compiled step (m, a) and (m, a, g), to rounding up to h max(|m|, sqrt(|a||p|)) = 0.5: 367 and 507 with
ORDERS, NODES = 10, 5.  Taylor series of 28 orders need 3028 and 9216, as four scalar functions times the quaternions
1, m, p a and p m a 2111 and 2130.  With 16, 8 as here, 547 and 696 (131 and 160 ns for 101 and 111), to rounding up to
0.75, and to 5e-15 at 1.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.exact.rotor_step import laurent

NODES = 8  # of Gauss's rule, in the half of its interval
ORDERS = 16  # of Laurent's series
LONGEST = 1.25  # h max(|m|, sqrt(|a||p|)) of a step that is used: there it is off by 5e-11
MOST_SPIN, TINY = 8.0, 1e-140  # radians of the rotation about a in a step; a = 0: no 0/0
LEAN = (0, 5)  # squarings and terms of the rotation about p, which is of third order in h: 0.04 at most


class Known(NamedTuple):
    """Integrals in units of h, and the coefficients of X^2, X^3, ... in X wp - 1, X the square of the time."""

    A: Array
    P: Array
    J: Array
    c: Array
    E: Array
    series: list[Array]


class Level(NamedTuple):
    """At a time, X its square: kappa = kX/4, N = (kA + J^2) X/4, T = N X/(2 rho), lever = 2T (J - c rho)."""

    kappa: Array
    N: Array
    T: Array
    lever: Array


def step(m: Array, a: Array, *g: Array, p: Array, alpha: Array, h: Array) -> tuple[Array, ...]:
    """(m, a) or (m, a, g) after the time h: axial vectors (..., 3), g (..., 4) a unit quaternion.  With g, a != 0."""
    f = algebra.vec(h) * p
    integrals = _integrals(m, a, f, h)
    e, levels = _vector(integrals, m, a, f, h), _levels(integrals)
    kick = algebra.cross(f, e)
    mean = algebra.vec(h) * (m + kick / 2)
    lean = _lean(levels, f, h)
    state = algebra.conjugated(lean, m + kick), algebra.conjugated(lean, a + algebra.cross(mean, e))
    if not g:
        return state
    q = algebra.quaternion_product(lean, _within(integrals, a, e, levels, alpha))
    return *state, algebra.unit(algebra.quaternion_product(q, g[0]))


def step_inside(M: Array, P: Array, *g: Array, A: Array, alpha: Array, h: Array) -> tuple[Array, ...]:
    """(M, P) or (M, P, g) of the moving frame after the time h: M, A, P as m, a, p in the frame where g = 1 before."""
    f = algebra.vec(h) * P
    integrals = _integrals(M, A, f, h)
    e, levels = _vector(integrals, M, A, f, h), _levels(integrals)
    q = _within(integrals, A, e, levels, alpha)
    back = algebra.inverse_turn(q)
    state = algebra.conjugated(back, M + algebra.cross(f, e)), algebra.conjugated(back, P)
    if not g:
        return state
    q = algebra.quaternion_product(_lean(levels, f, h), q)
    return *state, algebra.unit(algebra.quaternion_product(g[0], q))


def reach(m: Array, a: Array, *, p: Array, alpha: Array, h: Array) -> Array:
    """A measure of the length of a step: at most 1 up to h max(|m|, sqrt(|a||p|)) = LONGEST and spins by MOST_SPIN."""
    square, A, J = (h / LONGEST) ** 2, algebra.dot(a, a), algebra.dot(m, a)
    spin = (1 / alpha - 1) * J * h / MOST_SPIN
    length = algebra.maximum(square * algebra.dot(m, m), square * square * A * algebra.dot(p, p))
    return algebra.maximum(length, spin * spin / (A + TINY))


def _integrals(m: Array, a: Array, f: Array, h: Array) -> Known:
    w = algebra.vec(h) * m
    A, P, J, c = algebra.dot(a, a), h * h * algebra.dot(f, f), algebra.dot(w, a), h * algebra.dot(w, f)
    E = algebra.dot(w, w) / 2 + h * algebra.dot(a, f)
    AP, Jc = A * P, J * c
    g2 = E * E / 3 + (AP - Jc)
    g3 = E * (E * E / 27 - (Jc + 2 * AP) / 6) + (c * c * A + J * J * P) / 4
    return Known(A, P, J, c, E, laurent(g2 / 20, g3 / 28, ORDERS))


def _level(constants: Known, X: float) -> Level:
    A, P, J, c, E, series = constants
    wp = series[-1]
    for coefficient in reversed(series[:-1]):
        wp = wp * X + coefficient
    kappa = 1 + X * (X * wp - E / 3)
    B = kappa * (kappa + (X / 2) * E) + (X * X / 8) * (J * c)
    N, product = A * kappa + (X / 4) * (J * J), P * kappa + (X / 4) * (c * c)
    T = B + algebra.sqrt(B * B - (X * X / 4) * N * product)
    return Level(kappa, N, T, (2 * J) * T - (X * c) * N)


def _vector(constants: Known, m: Array, a: Array, f: Array, h: Array) -> Array:
    """e/h, f = h p.  1/mu is rounded and then taken as exact, as is f: no error is the same in all steps."""
    kappa, N, T, _ = _level(constants, 1.0)
    half = 1 / algebra.sqrt(4 * kappa)  # 1/(mu h)
    v, b = algebra.vec(half) * (algebra.vec(h) * m), a - algebra.vec(h * N / (2 * T)) * f
    e = b + algebra.cross(v, b) + algebra.vec(algebra.dot(v, b)) * v
    return e * algebra.vec(2 * half / (1 + algebra.dot(v, v)))


@cache
def _rule(nodes: int) -> list[tuple[float, float]]:
    """Squares of the times and weights of Gauss's rule in (-1, 1), those of positive times."""
    points, weights = np.polynomial.legendre.leggauss(2 * nodes)
    return [(float(x * x), float(w)) for x, w in zip(points, weights, strict=True) if x > 0]


def _levels(constants: Known) -> list[Level]:
    return [_level(constants, X) for X, _ in _rule(NODES)]


def _lean(levels: list[Level], f: Array, h: Array) -> Array:
    """R_p(-theta)."""
    theta = 0 * h
    for (X, weight), (kappa, _, T, lever) in zip(_rule(NODES), levels, strict=True):
        theta = theta + (weight * X / 8) * (lever / (kappa * T))
    return algebra.turn(algebra.vec(-theta * h) * f, *LEAN)


def _within(constants: Known, a: Array, e: Array, levels: list[Level], alpha: Array) -> Array:
    """H_e H_a and the rotation about a before it, not of unit length."""
    psi = (1 / alpha - 1) * constants.J / constants.A
    for (_, weight), (kappa, N, _, lever) in zip(_rule(NODES), levels, strict=True):
        psi = psi + (weight / 4) * (lever / (kappa * N))
    lift = algebra.quaternion(algebra.dot(a, e), algebra.cross(a, e))
    return algebra.quaternion_product(lift, algebra.turn(algebra.vec(psi) * a))
