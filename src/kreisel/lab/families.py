"""Families of maps for `kreisel.lab.search` beyond the paper's: other potentials, spinning bodies, Kahan's maps.

All are rational, so that members are judged exactly.  Those on e*(n) are Poisson for every value of the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, act, cayley, cayley_act, dot, identity, mat, vec, wedge
from kreisel.errors import InputError
from kreisel.lab.fields import fraction
from kreisel.lab.search import exact_constants, explicit, model_of
from kreisel.lab.subject import Subject, coordinate_names, subject
from kreisel.method.kahan_step import advance, eliminate
from kreisel.record.contract import TWO_FIELDS_SPACE, Map
from kreisel.record.model import Model


def shifted_logarithm(gamma: Any = 0, c: Any = 2, b: Sequence[Any] = (1, 2, 4), place: int = -1) -> Model:
    """U = (c/eps) log(1 + (eps^2/4) (<P, BP> + 2 gamma P_i)), i = `place`: gravity in Clebsch's logarithm."""
    B, axis = exact_constants(b), exact_constants(np.eye(len(b), dtype=int)[place])
    gamma, c = exact_constants(gamma), exact_constants(c)

    def gradient(P: Array, eps: Any) -> Array:
        force = B * P + gamma * axis
        den = 1 + eps * eps / 4 * (dot(P, B * P) + 2 * gamma * dot(P, axis + 0 * P))
        return vec(c * eps / 2 / den) * force

    return explicit(gradient, "shifted-logarithm", len(b))


def sum_of_logarithms(c: Any = 2, b: Sequence[Any] = (1, 2, 4), gravity: Any = 0) -> Model:
    """U = (c/eps) sum_i log(1 + (eps^2/4) b_i P_i^2) - eps gravity P_n: one logarithm for each axis."""
    B, axis = exact_constants(b), exact_constants([0] * (len(b) - 1) + [1])
    c, gravity = exact_constants(c), exact_constants(gravity)

    def gradient(P: Array, eps: Any) -> Array:
        return c * eps / 2 * (B * P) / (1 + eps * eps / 4 * (B * P * P)) - gravity * eps * axis

    return explicit(gradient, "sum-of-logarithms", len(b))


def spinning(s: Any = 0, tilt: Sequence[Any] = (1, 0, 0), kappa: Any = 0, b: Any = 0) -> Model:
    """A body of revolution, Omega = M + s pi M pi, pi across e_n, with its centre of mass anywhere.

    A kick by U = -eps <P, tilt> + (2/eps) log(1 + (eps^2/4) b P_n^2), divided by 1 + kappa eps^2 <P, tilt>; the paper's
    drift P -> cay(-(eps/2) M) P; and the turn of M and P by cay((eps s/2) pi M pi).  s = 1 and tilt across the axis:
    Kovalevskaya's moments, integrable for kappa = -1/4; s = 3: Goryachev's and Chaplygin's; tilt = e_n: Lagrange's.
    """
    A, n = exact_constants(tilt), len(tilt)
    s, kappa, b = (exact_constants(v) for v in (s, kappa, b))

    def step(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
        axis = np.arange(n) == n - 1
        pull = vec(-eps / (1 + kappa * (eps * eps) * dot(P, A + 0 * P))) * A
        well = vec(eps * b / (1 + eps * eps / 4 * b * (P[..., -1] * P[..., -1]))) * (P * axis)
        M = M + wedge(P, pull + well)
        P = cayley_act(-eps / 2 * M, P)
        W = cayley(eps * s / 2 * M * (1 - axis[:, None]) * (1 - axis)) if n > 3 else _turn(M, eps * s / 2)
        return W.mT @ M @ W, act(W.mT, P)

    return model_of("spinning", n, Map(step=step))


def _turn(M: Array, t: Any) -> Array:
    """cay(t M) of the block of the plane (1, 2) alone: without a linear solve."""
    n = M.shape[-1]
    flat = np.arange(n) < 2
    q, plane = t * t * (M[..., 0, 1] * M[..., 0, 1]), identity(n) * flat
    return (
        identity(n)
        - plane
        + mat(1 / (1 + q)) * (mat(1 - q) * plane + mat(2 * t + 0 * q) * (M * (flat[:, None] & flat)))
    )


def kovalevskaya(c: Any = 4, coupling: Any = 1, n: int = 3) -> Model:
    """A body with Omega = M, but twice M_12, in two fields, in n dimensions: Kovalevskaya's, for c = 4, coupling = 1.

    The same with U = (c/eps) log(1 - (eps^2/4) (P_1 + Q_2) + coupling (eps^2/4)^2 (P_1 Q_2 - P_2 Q_1)): for c = 4 and
    coupling = 1 it is 4/eps times the logarithm of the determinant of 1 - (eps^2/4) (P, Q) in the plane (1, 2).
    """
    c, coupling = exact_constants(c), exact_constants(coupling)
    first, second = np.eye(2, n, dtype=np.int8)

    def step(M: Array, P: Array, Q: Array, *, eps: Any) -> tuple[Array, ...]:
        k = eps * eps / 4
        (p1, p2), (q1, q2) = ((v[..., 0], v[..., 1]) for v in (P, Q))
        scale = -c * k / eps / (1 - k * (p1 + q2) + coupling * k * k * (p1 * q2 - p2 * q1))
        on_P = vec(scale * (1 - coupling * k * q2)) * first + vec(scale * coupling * k * q1) * second
        on_Q = vec(scale * coupling * k * p2) * first + vec(scale * (1 - coupling * k * p1)) * second
        M = M + wedge(P, on_P + 0 * P) + wedge(Q, on_Q + 0 * Q)
        P, Q = (cayley_act(-eps / 2 * M, v) for v in (P, Q))
        W = _turn(M, eps / 2)
        return W.mT @ M @ W, act(W.mT, P), act(W.mT, Q)

    return model_of("kovalevskaya", n, Map(step=step), TWO_FIELDS_SPACE)


def kahan(flow: Any, names: Sequence[str], eps: Any = Fraction(1, 3), adjustment: Any = None) -> Subject:
    """Kahan's map of a quadratic flow x' = flow(x) on numbers of any field; adjustment(x) adds to eps/2 flow'(x)."""
    eps = fraction(eps)

    def step(x: Array) -> Array:
        from kreisel.algebra.gradient import value_and_jacobian

        rates, slopes = value_and_jacobian(lambda y: list(flow(np.array([*y, None], dtype=object)[:-1])), list(x), [])
        matrix = [[(i == j) - eps / 2 * v for j, v in enumerate(row)] for i, row in enumerate(slopes)]
        if adjustment is not None:
            matrix = [[v - w for v, w in zip(*rows, strict=True)] for rows in zip(matrix, adjustment(x), strict=True)]
        change, _ = eliminate(matrix, [eps * v for v in rates])
        return np.array([*(y + z for y, z in zip(x, change, strict=True)), None], dtype=object)[:-1]

    return subject(step, names=tuple(names))


def kahan_map(model: Model, eps: Any = Fraction(1, 3)) -> Subject:
    """Kahan's map of a model whose flow is quadratic in the state."""
    exactly = np.vectorize(fraction, otypes=[object])
    model = Model(model.system, {k: exactly(v)[()] for k, v in model.params.items()})  # what is derived is exact too
    space, n = model.system.space, model.n
    letters = {f"parameter_{k}": exactly(v)[()] for k, v in model.constants.items()}

    def step(coordinates: Array, /, *, eps: Any, **known: Any) -> Array:
        consts = {k.removeprefix("parameter_"): v for k, v in known.items()}
        new, _ = advance(model, algebra.restore(coordinates, space.kinds, n), eps, consts)
        return algebra.flatten(new, space.kinds)

    return Subject(
        f"Kahan's map of {model.system.name}",
        step,
        coordinate_names(space.components, n),
        {**letters, "eps": fraction(eps)},
    )


def kahan_gyrostat(h: Sequence[Any] = (0, 0, 0), J: Sequence[Any] = (1, 2, 4), eps: Any = Fraction(1, 3)) -> Subject:
    """Kahan's map of M' = (M + h) x Omega, Omega_i = M_i/J_i."""
    wheel, w = exact_constants(h), 1 / exact_constants(J)

    def flow(M: Array) -> Array:
        return _cross(M + wheel, w * M)

    return kahan(flow, ("M1", "M2", "M3"), eps)


def adjusted_gyrostat(
    h: Sequence[Any] = (2, 3, 0), J: Sequence[Any] = (1, 2, 4), eps: Any = Fraction(1, 3), share: Any = 1
) -> Subject:
    """Kahan's map of M' = (M + h) x Omega, Omega_i = M_i/J_i, h_3 = 0, adjusted so that it is integrable.

    With w = 1/J and c = (h_1 w_3/(w_1 - w_3), h_2 w_3/(w_2 - w_3), 0) the third equation has one more term,

        (eps^2/4) (u(M) M3' - u(M') M3),   u(M) = h_1 w_1 (w_2 - w_3) (M - c)_1 + h_2 w_2 (w_1 - w_3) (M - c)_2,

    of the third order in eps, `share` times.  (F(M) - F(c))/(1 - (eps^2/4) (w_1 - w_3) (w_3 - w_2) M_3^2) is conserved
    for F = |M + h|^2 and F = <M, w M>.  Raises `InputError` unless h_3 = 0 and J_3 differs from J_1 and J_2.
    """
    wheel, w = exact_constants(h), 1 / exact_constants(J)
    if wheel[2] != 0 or w[2] in (w[0], w[1]):
        raise InputError(f"Expected h_3 = 0 and J_3 other than J_1 and J_2, got h = {tuple(h)}, J = {tuple(J)}.")
    slope = wheel[:2] * w[:2] * (w[1::-1] - w[2]) * fraction(share) * fraction(eps) ** 2 / 4
    c = wheel[:2] * w[2] / (w[:2] - w[2])

    def adjustment(M: Array) -> list[list[Any]]:
        u = slope[0] * (M[0] - c[0]) + slope[1] * (M[1] - c[1])
        return [[0, 0, 0], [0, 0, 0], [-M[2] * slope[0], -M[2] * slope[1], u]]

    return kahan(lambda M: _cross(M + wheel, w * M), ("M1", "M2", "M3"), eps, adjustment)


def kahan_heavy_top(I3: Any = 1, tilt: Sequence[Any] = (0, 0, 1), I2: Any = 1, eps: Any = Fraction(1, 3)) -> Subject:
    """Kahan's map of M' = M x Omega + P x A, P' = P x Omega, with moments (1, I2, I3)."""
    A, w = exact_constants(tilt), 1 / exact_constants((1, I2, I3))

    def flow(x: Array) -> Array:
        M, P = x[:3], x[3:]
        return np.concatenate([_cross(M, w * M) + _cross(P, A), _cross(P, w * M)])

    return kahan(flow, ("M1", "M2", "M3", "P1", "P2", "P3"), eps)


def _cross(a: Array, b: Array) -> Array:
    return np.array(
        [*(a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)), None], dtype=object
    )[:-1]


__all__ = [
    "adjusted_gyrostat",
    "kahan",
    "kahan_gyrostat",
    "kahan_heavy_top",
    "kahan_map",
    "kovalevskaya",
    "shifted_logarithm",
    "spinning",
    "sum_of_logarithms",
]
