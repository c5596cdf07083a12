"""Kirchhoff's case without mixed terms: a body of revolution in a fluid.  State (M, P) in e(n)*, body frame, axis e_n.

H = (a_1 <M, M> + (a_3 - a_1) <N, N> + c_1 <P, P> + (c_3 - c_1) P_n^2)/2,  N = Pi M Pi,  Pi = I - e_n e_n^T; for n = 3
    H = (a_1 (M_1^2 + M_2^2) + a_3 M_3^2 + c_1 (P_1^2 + P_2^2) + c_3 P_3^2)/2.
N is conserved.  (a_1 M, P) moves as in Clebsch's case with B = diag(0, ..., 0, beta), beta = a_1 (c_1 - c_3), and
rotates besides by exp(t (a_3 - a_1) N), which commutes with that.  So the map is that of Clebsch's case for (a_1 M,
P), then the rotation by cay(eps/2 (a_3 - a_1) N).  Plus bracket, F' = {H, F}.
[Kirchhoff 1870; the map: Suris 2001, section 7; another by Bäcklund transformations: Ragnisco, Zullo 2011]
"""

import numpy as np

from kreisel.algebra import act, dot, identity, mat, pairing, project_out, solve, vec, wedge
from kreisel.algebra.rotations import cayley, cayley_act, cayley_conjugate
from kreisel.baecklund.clebsch import OF_REVOLUTION
from kreisel.record.contract import MOVING_SPACE, Parameter, Relation, System, kicked_map, named, pullback
from kreisel.record.values import positive
from kreisel.system import clebsch


def derive(*, a1, c1, c3, n):
    """e = e_n, b = beta e, and c = b - max b, as for Clebsch's case."""
    e, beta = identity(int(np.asarray(n).flat[0]))[-1] + 0 * vec(a1), vec(a1 * (c1 - c3))
    return {"e": e, "b": beta * e, "c": beta * e - (beta + abs(beta)) / 2}


def noether(M, P, *, e):  # N; M_3 for n = 3
    return project_out(M, e)


def inverse_inertia(M, *, a1, a3, e):  # Omega = dH/dM
    return mat(a1) * M + mat(a3 - a1) * project_out(M, e)


def flow(M, P, *, a1, a3, c1, c3, e):  # M' = [M, Omega] + U ^ P,   P' = -Omega P
    Omega, U = inverse_inertia(M, a1=a1, a3=a3, e=e), translation(M, P, c1=c1, c3=c3, e=e)
    return M @ Omega - Omega @ M + wedge(U, P), -act(Omega, P)


def energy(M, P, *, a1, a3, c1, b, e, eps=0):
    N = project_out(M, e)
    return clebsch.energy(mat(a1) * M, P, b=b, eps=eps) / a1 + ((a3 - a1) * pairing(N, N) + c1 * dot(P, P)) / 2


def translation(M, P, *, c1, c3, e):  # U = dH/dP
    return (vec(c1) + vec(c3 - c1) * e) * P


def lax(M, P, *, a1, a3, b, e, lam):  # L' = [L, U],   U = lambda B + Omega
    L, U = clebsch.lax(mat(a1) * M, P, b=b, lam=lam)
    return L, U + mat(a3 - a1) * project_out(M, e)


def half_turn(M, a1, a3, e, eps):
    return mat((a3 - a1) * eps / 2) * project_out(M, e)


def kick(P, *, a1, b, eps):  # the change of M in a step
    return clebsch.kick(P, b=b, eps=eps) / mat(a1)


def turn(M, P, *, a1, a3, e, eps):  # (dClebsch spec) for (a1 M, P), then the rotation
    V, P = half_turn(M, a1, a3, e, eps), cayley_act(mat(-a1 * eps / 2) * M, P)
    return cayley_conjugate(-V, M, e), cayley_act(-V, P)


def conjugator(M, P, *, a1, a3, b, e, lam, eps):
    turn = cayley(half_turn(M, a1, a3, e, eps))
    return clebsch.conjugator(mat(a1) * M, P, b=b, lam=lam, eps=eps) @ turn


def generator(M, P, M1, P1, *, a1, a3, e, eps):  # X with cay(X) = cay(V) cay(U),  U = eps/2 a1 M_(k+1)
    U, V, unit = mat(a1 * eps / 2) * M1, half_turn(M, a1, a3, e, eps), identity(M.shape[-1])
    return solve(unit - V, U + V) @ solve(unit + V @ U, unit - V)


of_clebsch = pullback(clebsch.SYSTEM, lambda M, P, g, *, a1, b: ((mat(a1) * M, P), {"b": b}))


def inverse_planes(a1, a3, e):  # c_jk
    across = 1 - e
    return mat(a1) + mat(a3 - a1) * across[..., :, None] * across[..., None, :]


SYSTEM = System(
    name="kirchhoff-revolution",
    title="Kirchhoff's case of a body of revolution in a fluid, without mixed terms",
    equations="M' = [M, Omega] + U ^ P,  P' = -Omega P,  Omega = a1 M + (a3 - a1) Pi M Pi,  "
    "U = c1 P + (c3 - c1) P_n e_n",
    source="Kirchhoff 1870; Suris 2001, section 7",
    space=MOVING_SPACE,
    parameters=(
        Parameter("a1", "scalar", "inverse moment of inertia across the axis", positive, positive=True),
        Parameter("a3", "scalar", "inverse moment of inertia about the axis", positive, positive=True),
        Parameter("c1", "scalar", "inverse mass across the axis, with the added mass"),
        Parameter("c3", "scalar", "inverse mass along the axis, with the added mass"),
        Parameter("n", "dimension", "the dimension of the space", default=3),
    ),
    **named(derive, flow, energy, translation, inverse_inertia, lax),
    integrals={"spectrum": of_clebsch(clebsch.spectrum), "noether": noether},
    commuting=("spectrum",),
    map=kicked_map(
        kick,
        turn,
        **named(generator, conjugator),
        largest_step=clebsch.largest_step,
        lax=of_clebsch(clebsch.lax_matrix),
        source="Suris 2001, section 7, and a rotation about the axis",
    ),
    baecklund=OF_REVOLUTION,
    relations=(
        Relation(
            "kirchhoff",
            lambda M, P, g, *, a1, a3, c1, c3, e: (
                (M, P),
                {"C": inverse_planes(a1, a3, e), "B": -(vec(c1) + vec(c3 - c1) * e)},
            ),
            meaning="c_jk = a3 across the axis, else a1; B = -diag(c1, ..., c1, c3)",
        ),
    ),
    notes="The spectrum is not complete: noether is needed too.",
)
