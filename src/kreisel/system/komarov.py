"""Kovalevskaya's top on e(3), so(4) and so(3,1), and Sokolov's case, with a rotor.  State (M, P), axial vectors.

The brackets of e(3)*, but P_i and P_j have -kappa times the bracket of M_i and M_j: kappa < 0 gives so(4), kappa > 0
so(3,1).  With n = M_3 + gamma,

    H = (M_1^2 + M_2^2)/2 + M_3^2 + gamma M_3 + c P_1 + beta n P_2 - beta^2 P_3^2/2,
    K = |n M + a x P|^2 - kappa <a, M>^2 + 2 <M, P> (c M_1 + beta n M_2 - beta^2 n P_3),   a = (beta n, -c, 0).

beta = 0: Kovalevskaya's top and gyrostat on e(3), Komarov's on the others; c = 0: Sokolov's case.  The Lax matrix has
size 7: b nu + m - mu S with S = diag(1, 1, 1, 1, 1, -kappa, -beta^2), and with lambda = mu/nu

    L = m (b - lambda S)^-1,   L' = [L, U],   U = -(A^T + L B^T),   m' = A^T m + m A.

For gamma = 0, with C = |P|^2 - kappa |M|^2, D = <M, P>, w = kappa beta^2, z = M_1 + i M_2, y = P_1 + i P_2 and
k = c + i beta M_3, Kovalevskaya's integral |(1 - w) z^2 - beta^2 y^2 - 2 k y - kappa k^2|^2/4 is

    (H + (kappa c^2 + beta^2 C)/2)^2 + (1 - w) (c^2 C - beta^2 D^2 - K).

Plus bracket, F' = {H, F}.  [Kovalevskaya 1889; Komarov 1981; Sokolov 2001; Borisov, Mamaev, Sokolov 2001; Komarov,
Sokolov, Tsiganov 2003.  The Lax pair was derived here; it was not compared with theirs]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import axial, cross, dot, hat, identity, mat, vec
from kreisel.algebra.invariants import blocks, lie_poisson, stack
from kreisel.baecklund.komarov import pairs_of
from kreisel.record.contract import MOVING_SPACE, Parameter, PhaseSpace, System, named


def tensor(M, P, *, kappa):
    """The tensor of e(3)*, with {P_i, P_j} = kappa M_ij added."""
    low = blocks([[0 * M, 0 * M], [0 * M, M]])
    return lie_poisson(("skew", "vector"), M, P) + mat(kappa) * low


def casimirs(M, P, *, kappa):  # |P|^2 - kappa |M|^2,   <M, P>
    u = axial(M)
    return stack([dot(P, P) - kappa * dot(u, u), dot(u, P)])


def lever(M, *, beta, c, gamma):  # (c, beta n, 0): dH/dP at P_3 = 0
    n = axial(M)[..., 2][()] + gamma
    return stack([c + 0 * n, beta * n, 0 * n])


def gradients(M, P, *, beta, c, gamma):
    """dH/dM = (M_1, M_2, M_3 + n + beta P_2), dH/dP = (c, beta n, -beta^2 P_3)."""
    u, (first, second, third), beta = axial(M), identity(3), vec(beta)
    Omega = u + (u + vec(gamma) + beta * P[..., [0, 2, 1]]) * third
    return Omega, vec(c) * first + beta * (u[..., [0, 2, 1]] + vec(gamma)) * second - beta * beta * P * third


def flow(M, P, *, kappa, beta, c, gamma):  # M' = M x dH/dM + P x dH/dP,   P' = P x dH/dM - kappa M x dH/dP
    (Omega, U), u = gradients(M, P, beta=beta, c=c, gamma=gamma), axial(M)
    return hat(cross(u, Omega) + cross(P, U)), cross(P, Omega) - vec(kappa) * cross(u, U)


def energy(M, P, *, beta, c, gamma):
    x, y, z = (axial(M)[..., i] for i in range(3))
    p, q, r = (P[..., i] for i in range(3))
    return (x * x + y * y) / 2 + z * (z + gamma) + c * p + beta * (z + gamma) * q - beta * beta * r * r / 2


def komarov(M, P, *, kappa, beta, c, gamma):  # K
    u, e = axial(M), lever(M, beta=beta, c=c, gamma=gamma)
    a, n = stack([e[..., 1], -e[..., 0], e[..., 2]]), u[..., 2] + gamma
    V, along = vec(n) * u + cross(a, P), dot(a, u)
    return dot(V, V) - kappa * along * along + 2 * dot(u, P) * (dot(e, u) - beta * beta * n * P[..., 2])


# -- the Lax pair: sizes 3, 2, 1, 1 -------------------------------------------------------------------

PLANE = np.array([[0, 1], [-1, 0]], dtype=np.int8)


def skew_of(M, P, *, beta, c, gamma):  # m
    e = lever(M, beta=beta, c=c, gamma=gamma)[..., :2, None]
    n, P = axial(M)[..., 2] + gamma, P[..., None]
    zero, none = 0 * M[..., :2], 0 * P[..., :1, :]
    return blocks(
        [
            [M, zero, P, 0 * P],
            [zero.mT, mat(n) * PLANE, 0 * e, e],
            [-P.mT, 0 * e.mT, none, none],
            [0 * P.mT, -e.mT, none, none],
        ]
    )


def inverse(kappa, beta, lam):
    """(b - lambda S)^-1."""
    square, w = lam * lam, kappa * beta * beta
    ones, zero = 1 + 0 * kappa * lam, 0 * kappa * lam
    x, y, z = -lam / (square - 1) * ones, -ones / (square - 1), -ones / lam
    scale = 1 / (w * square - 1)
    p, q, r = lam * beta * beta * scale, scale, lam * kappa * scale
    rows = np.stack([x, x, z, x, x, p, r], -1)[..., None] * identity(7)
    for i, j, value in ((0, 3, y), (1, 4, y), (5, 6, q)):
        unit = np.zeros((7, 7), dtype=np.int8)
        unit[i, j] = unit[j, i] = 1
        rows = rows + mat(value + zero) * unit
    return rows


def lax(M, P, *, kappa, beta, c, gamma, lam):
    Omega, U = gradients(M, P, beta=beta, c=c, gamma=gamma)
    square, p, U = beta * beta, P[..., None], U[..., None]
    zero, none, plane = 0 * M[..., :2], 0 * p[..., :1, :], p[..., :2, :]
    A = blocks(
        [
            [hat(Omega), zero, mat(-kappa) * U, 0 * p],
            [zero.mT, mat(-beta * P[..., 1]) * PLANE, 0 * plane, mat(-square) * plane],
            [-U.mT, 0 * plane.mT, none, none],
            [0 * p.mT, -plane.mT, none, none],
        ]
    )
    first = np.zeros((7, 7), dtype=np.int8)
    first[0, 3] = first[3, 0] = first[1, 4] = first[4, 1] = 1
    up, down = np.zeros((2, 7, 7), dtype=np.int8)
    up[5, 6] = down[6, 5] = 1
    B = first + mat(square) * up + mat(kappa) * down
    L = skew_of(M, P, beta=beta, c=c, gamma=gamma) @ inverse(kappa, beta, lam)
    return L, -(A.mT + L @ B.mT)


def curve(M, P, *, kappa, beta, c, gamma):
    """r, e_0 to e_4, w, with u = nu^2 and v = mu^2.

    det(nu b + m - mu S)/mu = (u-v)^2 (u - w v) + (r - e_1 - e_2) u^2 + e_0 u + e_1 uv + e_2 v^2 + e_3 v + e_4.
    """
    first, along = (casimirs(M, P, kappa=kappa)[..., i][()] for i in (0, 1))
    constants, square = {"beta": beta, "c": c, "gamma": gamma}, beta * beta
    second, w = square * first + kappa * c * c, kappa * square
    rotor = gamma * gamma * (1 - w)
    mixed = 2 * energy(M, P, **constants) - second + rotor
    along, K = along * along, komarov(M, P, kappa=kappa, **constants)
    return rotor, K, mixed, second, square * along - c * c * first, -c * c * along, w


SYSTEM = System(
    name="komarov",
    title="Kovalevskaya's top on e(3), so(4) and so(3,1), with Sokolov's terms and a rotor",
    equations="M' = M x dH/dM + P x dH/dP,  P' = P x dH/dM - kappa M x dH/dP",
    source="Komarov 1981, Sokolov 2001, Komarov, Sokolov, Tsiganov 2003",
    space=PhaseSpace(
        name="e*(3), so*(4), so*(3,1)",
        components=MOVING_SPACE.components,
        tensor=tensor,
        casimirs=casimirs,
        momentum=MOVING_SPACE.momentum,
        sign=+1,
        carried=(),
    ),
    parameters=(
        Parameter(
            "kappa", "scalar", "curvature of the phase space: zero is e(3), negative so(4), positive so(3,1)", None, 0.0
        ),
        Parameter("beta", "scalar", "strength of Sokolov's terms", None, 0.0),
        Parameter("c", "scalar", "strength of the linear potential", None, 1.0),
        Parameter("gamma", "scalar", "the momentum of a rotor along the third axis", None, 0.0),
    ),
    **named(flow, energy, lax),
    integrals={"komarov": komarov},
    commuting=("komarov",),
    pairs=replace(pairs_of(curve, energy, skew_of), between=4),
    n=3,
    notes="Without Sokolov's terms it is Kovalevskaya's top on e(3), Komarov's on so(4) and so(3,1); without the "
    "linear potential Sokolov's case. No explicit map is known; method='exact'.",
)
