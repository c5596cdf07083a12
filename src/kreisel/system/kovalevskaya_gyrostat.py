"""Kovalevskaya gyrostat in two fields, in n dimensions, with an explicit map.  State (M, P, Q), body frame.

M (..., n, n) skew, P and Q (..., n): two constant fields in the body frame, F = (P, Q).  With M_11 the upper left 2 x 2
block and E = (e_1, e_2), H = <M, M>/2 + <M_11, M_11>/2 - gamma M_12 + P_1 + Q_2.  Q = 0 is Kovalevskaya's top in the
field P; for n = 3 it has the moments of inertia (1, 1, 1/2).  Plus bracket, F' = {H, F}.

The map is that of `quadratic_field` on so(n) x so(2), M (+) N with N = gamma e_1 ^ e_2 - M_11, B = [[0, E], [E^T, 0]]
and the field -[[0, F], [F^T, 0]], which SO(2) rotates so that E stays: with k = eps/2 and F~ = F (1 - k^2 F_11)^-1

    M~ = M + eps (E F~^T - F~ E^T),   M_(k+1) = R M~ R^T,   F_(k+1) = R cay(-k M~) F,   R = cay(k N~) on the plane of E.

[Reyman, Semenov-Tian-Shansky 1987; Bobenko, Reyman, Semenov-Tian-Shansky, Comm. Math. Phys. 122 (1989); named in
Suris 2001, Introduction; the map was found by `kreisel.lab.search`]
"""

import numpy as np

from kreisel.algebra import act, axial, cayley, cayley_columns, dot, hat, identity, mat, pairing, solve, vec, wedge
from kreisel.algebra.invariants import blocks, stack
from kreisel.baecklund.kovalevskaya import TWO_FIELDS
from kreisel.record.contract import TWO_FIELDS_SPACE, Map, Parameter, System, named
from kreisel.system import quadratic_field as general


def shape(*, n):
    """e = e_1, h = e_2, and c_jk = 1, but 2 in their plane."""
    lanes = (0 * np.asarray(n)).astype(np.int8)
    unit = identity(int(np.asarray(n).flat[0])) + mat(lanes)
    corner = 1 * (np.arange(unit.shape[-1]) < 2)
    return {"c": 1 + unit * 0 + corner[:, None] * corner, "e": unit[..., 0], "h": unit[..., 1]}


def velocity(M, P, Q, *, gamma, c, e, h):  # Omega = dH/dM
    return c * M - mat(gamma) * wedge(e, h)


def torque(P, Q, e, h):  # E F^T - F E^T
    return wedge(e, P) + wedge(h, Q)


def flow(M, P, Q, *, gamma, c, e, h):  # M' = [M, Omega] + E F^T - F E^T,   F' = -Omega F
    Omega = velocity(M, P, Q, gamma=gamma, c=c, e=e, h=h)
    return M @ Omega - Omega @ M + torque(P, Q, e, h), -act(Omega, P), -act(Omega, Q)


def noether(M, P, Q):  # M_22, for the rotations of the other directions
    ends = np.diag([0, 0] + [1] * (M.shape[-1] - 2))
    return ends @ M @ ends


# -- the map -----------------------------------------------------------------------------------------------


def kicked(M, P, Q, e, h, eps, share=1):
    """M + (eps/share) (e_1 ^ P~ + e_2 ^ Q~), (P~, Q~) = r (P, Q) (r - F_11)^-1, r = 4/eps^2; its corner P_2 - Q_1."""
    r, p, q = 4 / (eps * eps), (1 - e - h) * P, (1 - e - h) * Q
    a, b, c, d = r - P[..., 0], Q[..., 0], P[..., 1], r - Q[..., 1]
    K = wedge(e, vec(d) * p + vec(c) * q) + wedge(h, vec(b) * p + vec(a) * q)
    return M + mat(r * eps / share / (a * d - b * c)) * (K + mat(r * (P[..., 1] - Q[..., 0])) * wedge(e, h))


def rotor(M, gamma):  # N = gamma e_1 ^ e_2 - M_11, as a matrix of n rows
    flat = 1 * (np.arange(M.shape[-1]) < 2)
    return mat(gamma) * wedge(*identity(M.shape[-1])[:2]) - M * (flat[:, None] * flat)


def turned(Y, V):  # cay(Y) V = V + 2 (Y + Y^2) V/(1 + |Y|^2), Y in one plane
    W = Y @ V
    return V + mat(2 / (1 + pairing(Y, Y))) * (W + Y @ W)


def turn(M, P, Q, gamma, eps):
    """R M R^T and R cay(-k M) F; for n = 3 the second one is F + (2/(t^2 + |x|^2)) q (q - t) F with q = hat(x).

    The quaternion (t, -x) is the product of (1, -y e_3), of R, and (2/eps, -w), of cay(-k M).
    """
    if M.shape[-1] != 3:
        Y, F = eps / 2 * rotor(M, gamma), np.stack([P, Q], -1)
        F = turned(Y, cayley_columns(-eps / 2 * M, F))
        return turned(Y, turned(Y, M).mT).mT, F[..., 0], F[..., 1]
    w, z = axial(M), gamma + axial(M)[..., 2]
    y, across = eps / 2 * z, 4 / (eps * eps) + dot(w, w)
    scale = 2 / ((1 + y * y) * across)
    x, t = stack([w[..., 0] + y * w[..., 1], w[..., 1] - y * w[..., 0], w[..., 2] + z]), 2 / eps - y * w[..., 2]
    s, q = scale * (across * y), hat(x)
    P, Q = (v + vec(scale) * act(q, act(q, v) - vec(t) * v) for v in (P, Q))
    return hat(stack([w[..., 0] + s * x[..., 1], w[..., 1] - s * x[..., 0], w[..., 2]])), P, Q


def step(M, P, Q, *, gamma, e, h, eps):
    return turn(kicked(M, P, Q, e, h, eps), P, Q, gamma, eps)


def inverse(M, P, Q, *, gamma, e, h, eps):
    M, P, Q = turn(M, P, Q, gamma, -eps)
    return kicked(M, P, Q, e, h, -eps), P, Q


def involution(M, P, Q, *, e, h, eps):  # -S M~ S, S F S with S = diag(1, -1, 1, ..): N stays
    signs = 1 - 2 * (np.arange(M.shape[-1]) == 1)
    return -signs[:, None] * kicked(M, P, Q, e, h, eps) * signs, signs * P, -signs * Q


def half_kick(M, P, Q, *, e, h, eps):
    return kicked(M, P, Q, e, h, eps, share=2), P, Q


def composed(M, N, eps):  # X with cay(X) = cay((eps/2) M) cay(-(eps/2) N)
    W, unit = cayley(eps / 2 * M) @ cayley(-eps / 2 * N), identity(M.shape[-1])
    return solve(unit + W, W - unit)


def generator(M, P, Q, M1, P1, Q1, *, gamma, e, h, eps):
    M = kicked(M, P, Q, e, h, eps)
    return composed(M, rotor(M, gamma), eps)


def largest_step(M, P, Q):
    """det(1 - (eps^2/4) F_11) stays positive for smaller |eps|, by the largest singular value of F."""
    p, q, product = dot(P, P), dot(Q, Q), dot(P, Q)
    square = (p + q) / 2 + np.sqrt((p - q) * (p - q) / 4 + product * product)
    return 2 / np.sqrt(np.sqrt(square))


# -- integrals and Lax pairs -------------------------------------------------------------------------------


def shifted(M, P, eps):  # V = (1 + (eps/2) M) P
    return P + eps * act(M, P) / 2


def energy(M, P, Q, *, gamma, c, eps=0):
    """H with tr V_11 (1 - k N) for tr F_11, less (k^2/2) |V_21|^2 and k^4 N_12 <P, M Q>; V = (1 + k M) F."""
    p, q, w = shifted(M, P, eps), shifted(M, Q, eps), gamma - M[..., 0, 1]
    ends, square = 1 * (np.arange(M.shape[-1]) > 1), eps * eps
    across = (dot(ends * p, p) + dot(ends * q, q)) / 8 + square * w * dot(P, act(M, Q)) / 16
    H = pairing(M, c * M) / 2 - gamma * M[..., 0, 1] + p[..., 0] + q[..., 1]
    return H - eps * w * (p[..., 1] - q[..., 0]) / 2 - square * across


def bordered(X, F, Y):  # of size n + 2
    return blocks([[X, F], [F.mT, Y]])


def enlarged(M, F, gamma):
    """M (+) N, the field -[[0, F], [F^T, 0]] and B = [[0, E], [E^T, 0]]."""
    zero, N = 0 * F, rotor(M, gamma)[..., :2, :2]
    rows = identity(M.shape[-1])[:, :2] + zero
    return bordered(M, zero, N), bordered(0 * M, -F, 0 * N), bordered(0 * M, rows, 0 * N)


def spectrum(M, P, Q, *, gamma, eps=0):
    """det L(lambda, mu) at 2 n - 4 points (lambda, mu): complete with the energy and a chain of the block M_22."""
    M, F, B = enlarged(M, np.stack([P, Q], -1), gamma)
    points = [(1 + j % 3, 1 + j // 3) for j in range(2 * M.shape[-1] - 8)]
    return general.values_of(M, F, general.potential(F, eps * eps * B / 4), B, eps=eps, points=points)


def lax(M, P, Q, *, gamma, c, e, h, lam):
    """L = lambda B + M (+) N + F/lambda of size n + 2, U = lambda B + Omega (+) 0."""
    big, F, B = enlarged(M, np.stack([P, Q], -1), gamma)
    Omega, zero = velocity(M, P, Q, gamma=gamma, c=c, e=e, h=h), 0 * M[..., :, :2]
    return lam * B + big + F / lam, lam * B + bordered(Omega, zero, zero[..., :2, :])


def ranks(F, columns):
    """P = [[F, 0], [0, 1]] and R = -[[0, F], [1, 0]] of the first columns of F: P R^T is the field."""
    F, low = F[..., :columns], identity(2)[:, :columns] + 0 * F[..., :2, :columns]
    return blocks([[F, 0 * F], [0 * low, low]]), -blocks([[0 * F, F], [low, 0 * low]])


def pencil(M, P, Q, *, gamma, lam, mu, eps, columns=2):  # of size n + 6, n + 4 in one field
    F = np.stack([P, Q], -1)
    (M, _, B), (left, right) = enlarged(M, F, gamma), ranks(F, columns)
    return general.pencil_of(M, left, right, B, lam=lam, mu=mu, eps=eps)


def factors(M, P, Q, *, gamma, e, h, lam, eps, columns=2):
    F = np.stack([P, Q], -1)
    B, (left, right) = enlarged(M, F, gamma)[2], ranks(F, columns)
    Y = eps / 2 * rotor(kicked(M, P, Q, e, h, eps), gamma)
    back = turned(-Y, identity(M.shape[-1]) + 0 * Y)
    turns = bordered(back, 0 * F, back[..., :2, :2]), identity(2 * columns) + 0 * Y[..., :1, :1]
    return general.turned(general.factors_of(left, right, B, lam=lam, eps=eps), *turns)


MAP = Map(
    **named(step, inverse, involution, generator, pencil, factors, largest_step),
    to_symmetric=half_kick,
    source="Kreisel",
)

SYSTEM = System(
    name="kovalevskaya-gyrostat",
    title="Kovalevskaya gyrostat in two fields",
    equations="M' = [M, Omega] + e_1 ^ P + e_2 ^ Q,  P' = -Omega P,  Q' = -Omega Q",
    source="Reyman, Semenov-Tian-Shansky 1987; Suris 2001, Introduction",
    space=TWO_FIELDS_SPACE,
    parameters=(
        Parameter("n", "dimension", "the dimension of the space"),
        Parameter("gamma", "scalar", "the momentum of the rotor, in the plane of e_1 and e_2"),
    ),
    **named(flow, energy, velocity, lax),
    derive=shape,
    scaling="The moments of inertia of all planes are 1, except for 1/2 in the plane (1, 2).",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    map=MAP,
    pairs=TWO_FIELDS,
    notes="Q = 0 is the gyrostat in one field.",
)
