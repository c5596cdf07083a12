"""Kovalevskaya top, n = 3, in two fields, with its map.  State (M, P, Q) in (so(3) <x 2 R^3)*, body frame.

The map is that of `kovalevskaya_gyrostat` for gamma = 0: a kick by the potential -(4/eps) log det(1 - (eps^2/4) F_11),
F_11 the components of P and Q in the plane (1, 2), and the rotation cay((eps/2) M) cay((eps/2) M_11).

Below M, P, Q are axial, z = M_3, F = (P, Q), N = P x Q, l = F^T M, d = F^T e_3; of 2-vectors a x b = a_1 b_2 - a_2 b_1.
H, K and G of the flow: K = |(M_1 + i M_2)^2/2 - (P_1 - Q_2) - i (P_2 + Q_1)|^2 and
G = |l|^2 + 2 z <M, N> + 2 (P_1 + Q_2) N_3 - 2 <d, N>.
[Kovalevskaya 1889; Bobenko, Reyman, Semenov-Tian-Shansky, Comm. Math. Phys. 122 (1989)]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import act, axial, cross, dot
from kreisel.record.contract import Checks, Relation
from kreisel.record.values import nonzero_vector
from kreisel.system import kovalevskaya_gyrostat as gyrostat, kovalevskaya_top as top


def shifted(M, P, eps):
    """(1 + (eps/2) M_11) (1 + (eps/2) M) P, which rotates into the old P, but for a factor."""
    R = gyrostat.shifted(M, P, eps)
    return R - eps * act(gyrostat.rotor(M, 0), R) / 2


def across(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def lengths(M, P, Q):  # F^T M
    return np.stack([dot(M, P), dot(M, Q)], -1)


def kovalevskaya(M, P, Q, *, c, eps=0):
    """K = H^2 - J + |P|^2 + |Q|^2, all of them deformed; s = eps^2/4, S = (1 + (eps/2) M_11) (1 + (eps/2) M) F.

    J = z^2 (|M|^2 + 2 t) + (t + s^2 z X)^2 + 2 <m, w> + 2 det S_11 + |d|^2 - 4 s z X - 2 s^2 <d, m> X
        + s (|w|^2 - |l|^2 - |v_1 Q - v_2 P|^2 - 2 <Jd, S_11 Jd>),
    m = (1 + (eps/2) M_11) (M_1, M_2), t = tr S_11, X = <M, N>, d = S^T e_3,
    w = l - z d, v = m - s z d, Jd = (-d_2, d_1).
    """
    H = gyrostat.energy(M, P, Q, gamma=0, c=c, eps=eps)
    S, T, M = shifted(M, P, eps), shifted(M, Q, eps), axial(M)
    x, y, z = M[..., 0], M[..., 1], M[..., 2]
    m1, m2, d1, d2 = x - eps * z * y / 2, y + eps * z * x / 2, S[..., 2], T[..., 2]
    l1, l2, t, X = dot(M, P), dot(M, Q), S[..., 0] + T[..., 1], eps * eps * dot(M, cross(P, Q)) / 4  # X: s X
    w1, w2, v1, v2 = l1 - z * d1, l2 - z * d2, m1 - eps * eps * z * d1 / 4, m2 - eps * eps * z * d2 / 4
    cross_term = v1 * v1 * dot(Q, Q) - 2 * v1 * v2 * dot(P, Q) + v2 * v2 * dot(P, P)
    turned = d2 * d2 * S[..., 0] - d1 * d2 * (T[..., 0] + S[..., 1]) + d1 * d1 * T[..., 1]
    remainder = w1 * w1 + w2 * w2 - l1 * l1 - l2 * l2 - cross_term - 2 * turned - 2 * (d1 * m1 + d2 * m2) * X
    trace = t + eps * eps * z * X / 4
    J = z * z * (dot(M, M) + 2 * t) + trace * trace + 2 * (m1 * w1 + m2 * w2 + across(S, T))
    J = J + d1 * d1 + d2 * d2 - 4 * z * X + eps * eps * remainder / 4
    return H * H - J + dot(P, P) + dot(Q, Q)


def gram(M, P, Q, *, eps=0):
    """G, deformed; <M, P>^2 where Q = 0; k = eps/2, X = <M, N>, t = P_1 + Q_2.

    |l|^2 + 2 z X + 2 t N_3 - 2 <d, N> + 2 k ((Q_1 - P_2) (X + z N_3) + z d x N + l x N)
    + k^2 (N_3^2 + 2 z (<l, N> - t X)) + 2 k^3 N_3 d x l
    + k^4 (|M x N|^2 + 4 z N_3 X - 2 |M|^2 N_3^2 + (d x l) (N x M)).
    """
    M, N, square = axial(M), cross(P, Q), eps * eps
    z, n, X, t, l = M[..., 2], N[..., 2], dot(M, N), P[..., 0] + Q[..., 1], lengths(M, P, Q)
    d = np.stack([P[..., 2], Q[..., 2]], -1)
    turned, C = across(d, l), cross(M, N)
    first = (Q[..., 0] - P[..., 1]) * (X + z * n) + z * across(d, N) + across(l, N)
    second = n * n + 2 * z * (dot(l, N[..., :2]) - t * X)
    fourth = dot(C, C) + 4 * z * n * X - 2 * dot(M, M) * n * n + turned * across(N, M)
    out = dot(l, l) + 2 * z * X + 2 * t * n - 2 * dot(d, N[..., :2]) + eps * first
    return out + square * second / 4 + square * eps * n * turned / 4 + square * square * fourth / 16


def second_field(Q, letter):
    """Not the zero vector."""
    nonzero_vector(Q, f"{letter} (one field: kovalevskaya-top-e3)")


SYSTEM = replace(
    top.SYSTEM,
    name="kovalevskaya-top-so3",
    title="Kovalevskaya top, n = 3, in two fields",
    source="Kovalevskaya 1889; Reyman, Semenov-Tian-Shansky 1987",
    parameters=(),
    derive=lambda: top.shape(n=np.asarray(3)),
    scaling="Omega = (M_1, M_2, 2 M_3): the moments of inertia are 1, 1, 1/2.",
    integrals={"kovalevskaya": kovalevskaya, "gram": gram},
    commuting=("kovalevskaya", "gram"),
    checks=Checks(state={"P": nonzero_vector, "Q": second_field}),
    relations=(Relation("kovalevskaya-top", lambda M, P, Q, g: ((M, P, Q), {"n": 3}), "step", "any n"),),
    n=3,
    notes="One field, Q = 0: kovalevskaya-top-e3.",
)
