"""Kovalevskaya's top of 1889 with a second explicit map.  State (M, P) in e(3)*, body frame.

The flow is that of `kovalevskaya_top_e3`; plus bracket, F' = {H, F}.  The map is that of `quadratic_field` on u(2) in
sp(4, R) = so(3, 2), as real 4 x 4 matrices, which U(1) rotates so that B = diag(-1, 1, 0, 0) stays.  With the axial M,
k = eps/2, s = k^2 and C = Re (1, i, 0)/(1 - (s/2) (P_1 + i P_2)),

    M~ = M + eps P x C,   D = M~_1^2 + M~_2^2,   R = cay of -k M~_3/(1 + s D/4) about e_3,
    M_(k+1) = R M~,   P_(k+1) = R cay(-k M~/(1 - s D/4)) P.

It has no pole for eps^2 |P| < 8, that of `kovalevskaya_top_e3` for eps^2 |P| < 4.  [This map was made here]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import axial, cayley, cross, dot, hat, identity, mat, solve, vec, wedge
from kreisel.algebra.invariants import SU2_IMAGINARY, SU2_REAL, blocks
from kreisel.record.contract import Relation, kicked_map, named
from kreisel.system import kovalevskaya_top_e3 as first, quadratic_field as general

PLANE = np.array([0, 0, 1], dtype=np.int8)
B = np.diag([-1, 1, 0, 0]).astype(np.int8)
TURN, MIRROR, SWAP = np.array([[[0, -1], [1, 0]], [[1, 0], [0, -1]], [[0, 1], [1, 0]]], dtype=np.int8)
SPIN = np.kron(SU2_REAL, identity(2)) + np.kron(SU2_IMAGINARY, TURN)  # sigma_j/i as real matrices
PHASE = -np.kron(identity(2), TURN)  # 1/i
FIELD = np.kron(SU2_REAL @ TURN, SWAP) - np.kron(SU2_IMAGINARY @ TURN, MIRROR)  # v -> -sigma_j (i sigma_2) conj(v)


def kick(P, *, eps):  # eps C ^ P
    u, v = 1 - eps * eps / 8 * P[..., 0], -eps * eps / 8 * P[..., 1]
    scale = vec(eps / (u * u + v * v))
    return wedge(scale * np.stack([u, v, 0 * u], -1), P)


def turned(alpha, u, v):  # cay(hat(u)/alpha) v, alpha = 0 too
    w = cross(u, v)
    return v + vec(2 / (alpha * alpha + dot(u, u))) * (vec(alpha) * w + cross(u, w))


def turn(M, P, *, eps):
    m, k = axial(M), eps / 2
    quarter = k * k / 4 * (m[..., 0] * m[..., 0] + m[..., 1] * m[..., 1])
    P, spin = turned(1 - quarter, -k * m, P), -k * m * PLANE
    return hat(turned(1 + quarter, spin, m)), turned(1 + quarter, spin, P)


def turns(M, eps):
    """W = cay(k M~/(1 - s D/4)) R^T, and R."""
    m, k = axial(M), eps / 2
    quarter = k * k / 4 * (m[..., 0] * m[..., 0] + m[..., 1] * m[..., 1])
    first, R = (
        np.stack([turned(alpha, u, e + 0 * m) for e in identity(3)], -1)
        for alpha, u in ((1 - quarter, k * m), (1 + quarter, -k * m * PLANE))
    )
    return first @ R.mT, R


def generator(M, P, M1, P1, *, eps):
    W = turns(M + kick(P, eps=eps), eps)[0]
    return solve(identity(3) + W, W - identity(3))


def largest_step(M, P):
    """1 - (eps^2/8) (P_1 + i P_2) is not 0 on |P| = const for smaller |eps|."""
    return np.sqrt(8 / np.sqrt(dot(P, P)))


def energy(M, P, *, eps=0):
    """H = |w|^2/2 + (1 + s^2 |P|^2/4) z^2 + P_1 + k (M_2 P_3 - 2 z P_2) + s (Re(w^2 P_-)/4 - z^2 P_1 + M_1 z P_3).

    w = M_1 + i M_2, z = M_3, P_- = P_1 - i P_2.
    """
    M, square = axial(M), eps * eps
    x, y, z, p, q, r = (v[..., i] for v in (M, P) for i in range(3))
    H = (x * x + y * y) / 2 + z * z + square * square * dot(P, P) * z * z / 64 + p + eps * (y * r - 2 * z * q) / 2
    return H + square * (((x * x - y * y) * p + 2 * x * y * q) / 4 - z * z * p + x * z * r) / 4


def kovalevskaya(M, P, *, eps=0):
    """The integral K = |w^2 (1 - (s/2) P_-)/2 + i k w P_3 - P_1 - i P_2|^2."""
    M, square = axial(M), eps * eps
    x, y, p, q, r = M[..., 0], M[..., 1], P[..., 0], P[..., 1], P[..., 2]
    u, v, c, d = (x * x - y * y) / 2, x * y, 1 - square * p / 8, square * q / 8
    re, im = u * c - v * d - eps * y * r / 2 - p, u * d + v * c + eps * x * r / 2 - q
    return re * re + im * im


def matrices(M, P):
    """M (+) M_3 in u(2), and the field in the symmetric complex 2 x 2 matrices, as real 4 x 4 matrices."""
    m = axial(M)
    spins = sum(mat(m[..., j]) * SPIN[j] for j in range(3)) + mat(m[..., 2]) * PHASE
    return spins / 2, sum(mat(P[..., j]) * FIELD[j] for j in range(3)) / 2


def pencil(M, P, *, lam, mu, eps):  # 8 x 8
    M, F = matrices(M, P)
    return general.pencil_of(M, F, identity(4) + 0 * F, B, lam=lam, mu=mu, eps=eps)


def factors(M, P, *, lam, eps):
    N = M + kick(P, eps=eps)
    (big, _), F = matrices(N, P), matrices(M, P)[1]
    unit = identity(4) + 0 * F
    plane = turns(N, eps)[1].mT[..., :2, :2]
    zero = 0 * plane
    back = blocks([[unit[..., :2, :2], zero], [zero, plane]])
    return general.turned(general.factors_of(F, unit, B, lam=lam, eps=eps), back, cayley(eps / 2 * big) @ back)


SYSTEM = replace(
    first.SYSTEM,
    name="kovalevskaya-top-sp4",
    title="Kovalevskaya's top of 1889, with a second map",
    energy=energy,
    integrals={"kovalevskaya": kovalevskaya},
    map=kicked_map(kick, turn, **named(generator, largest_step, pencil, factors), source="Kreisel"),
    relations=(Relation("kovalevskaya-top-e3", lambda M, P, g: ((M, P), {}), meaning="another map"),),
    notes="",
)
