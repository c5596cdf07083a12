"""Kovalevskaya's top of 1889.  State (M, P) in e(3)*, body frame: M angular momentum, P the field.

Moments of inertia 1, 1, 1/2, centre of mass along e_1: H = (M_1^2 + M_2^2)/2 + M_3^2 + P_1 and Kovalevskaya's integral
K = |(M_1 + i M_2)^2/2 - P_1 - i P_2|^2.  Plus bracket, F' = {H, F}.  The map is Kreisel's own, found by
`kreisel.lab.search`: a kick by the potential -(4/eps) log(1 - (eps^2/4) P_1), and the rotation
cay((eps/2) M) cay((eps/2) M_11), M_11 the part of M in the plane (1, 2): `kovalevskaya_gyrostat` with Q = 0, gamma = 0.
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import act, axial, cayley_act, dot, vec, wedge
from kreisel.record.contract import MOVING_SPACE, Relation, System, kicked_map, named, pullback
from kreisel.system import kovalevskaya_gyrostat as gyrostat, kovalevskaya_top as top, kovalevskaya_top_so3 as two


def flow(M, P, *, c, e):  # M' = [M, Omega] + e_1 ^ P,   P' = -Omega P
    Omega = c * M
    return M @ Omega - Omega @ M + wedge(e, P), -act(Omega, P)


def kick(P, *, e, eps):
    return wedge(e, vec(eps / (1 - eps * eps * P[..., 0] / 4)) * P)


def turn(M, P, *, eps):
    Y = eps / 2 * gyrostat.rotor(M, 0)
    P = gyrostat.turned(Y, cayley_act(-eps / 2 * M, P)[..., None])[..., 0]
    return gyrostat.turned(Y, gyrostat.turned(Y, M).mT).mT, P


def generator(M, P, M1, P1, *, e, eps):
    M = M + kick(P, e=e, eps=eps)
    return gyrostat.composed(M, gyrostat.rotor(M, 0), eps)


def largest_step(M, P):
    """The denominator 1 - (eps^2/4) P_1 stays positive on |P| = const for smaller |eps|."""
    return 2 / np.sqrt(np.sqrt(dot(P, P)))


of_two_fields = pullback(gyrostat.SYSTEM, lambda M, P, g: ((M, P, 0 * P), {"gamma": 0}))
energy = of_two_fields(gyrostat.energy)


def kovalevskaya(M, P, *, c, eps=0):
    """K = H^2 - J of the deformed H; z = M_3, s = eps^2/4 and S as in the energy.

    J = z^2 (|M|^2 + 2 S_1) + 2 m_1 w + S_1^2 + S_3^2 - |P|^2 + s (w^2 - m_2^2 |P|^2),
    w = <M, P> - z S_3,  m = (1 + (eps/2) M_11) (M_1, M_2).
    """
    H, S, M = energy(M, P, c=c, eps=eps), two.shifted(M, P, eps), axial(M)
    x, y, z = M[..., 0], M[..., 1], M[..., 2]
    m1, m2, w, square = x - eps * z * y / 2, y + eps * z * x / 2, dot(M, P) - z * S[..., 2], dot(P, P)
    J = z * z * (dot(M, M) + 2 * S[..., 0]) + 2 * m1 * w + S[..., 0] * S[..., 0] + S[..., 2] * S[..., 2] - square
    return H * H - J - eps * eps * (w * w - m2 * m2 * square) / 4


def pencil(M, P, *, lam, mu, eps):  # 7 x 7
    return gyrostat.pencil(M, P, 0 * P, gamma=0, lam=lam, mu=mu, eps=eps, columns=1)


def factors(M, P, *, e, h, lam, eps):
    return gyrostat.factors(M, P, 0 * P, gamma=0, e=e, h=h, lam=lam, eps=eps, columns=1)


MAP = kicked_map(kick, turn, **named(generator, largest_step, pencil, factors), source="Kreisel")

SYSTEM = System(
    name="kovalevskaya-top-e3",
    title="Kovalevskaya's top of 1889",
    equations="M' = [M, Omega] + e_1 ^ P,  P' = -Omega P",
    source="Kovalevskaya 1889; Suris 2001, Introduction",
    space=MOVING_SPACE,
    parameters=(),
    flow=flow,
    energy=energy,
    lax=of_two_fields(gyrostat.lax),
    inverse_inertia=top.inverse_inertia,
    derive=lambda: gyrostat.shape(n=np.asarray(3)),
    scaling="Omega = (M_1, M_2, 2 M_3): the moments of inertia are 1, 1, 1/2. With the body values I, I, I/2 and M g l "
    "the unit of time is sqrt(I/(M g l)), and |P| = 1.",
    integrals={"kovalevskaya": kovalevskaya},
    commuting=("kovalevskaya",),
    map=MAP,
    pairs=replace(gyrostat.ONE_FIELD, between=8),
    relations=(
        Relation("kovalevskaya-top", lambda M, P, g: ((M, P, 0 * P), {"n": 3}), meaning="one field of two, Q = 0"),
    ),
    n=3,
    notes="An explicit integrable map that is in no list we know of.",
)
