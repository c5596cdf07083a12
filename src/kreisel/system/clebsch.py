"""Clebsch's case, the special flow c_jk = 1, and its discretization.  State (M, P) in e(n)*.

M (..., n, n) skew, P (..., n), body frame; B = diag(b).  Plus bracket, F' = {H, F}.
[Suris 2001, section 7; Lagrangian with 2/eps (erratum E1), Lax pair for any |P| (E10)]
"""

import numpy as np

from kreisel.algebra import act, cayley_act, dot, identity, log, mat, moebius, pairing, trace_log, vec, wedge
from kreisel.algebra.invariants import diagonal, pencil_spectrum
from kreisel.baecklund.clebsch import BAECKLUND, shifted_diagonal
from kreisel.baecklund.conjugate import CLEBSCH, in_letter
from kreisel.record.contract import MOVING_SPACE, Parameter, Relation, System, kicked_map, named


def flow(M, P, *, b):  # (Clebsch spec)   M' = P ^ BP,   P' = -M P
    return wedge(P, b * P), -act(M, P)


def denominator(P, *, b, eps):
    return 1 + eps * eps / 4 * dot(P, b * P)


def kick(P, *, b, eps):  # the change of M in a step
    return eps * wedge(P, b * P) / mat(denominator(P, b=b, eps=eps))


def turn(M, P, *, eps):  # (dClebsch spec)   P_(k+1) = cay(-eps/2 M_(k+1)) P_k
    return M, cayley_act(-eps / 2 * M, P)


def shifted(M, P, *, eps):  # Pt
    return P + eps * act(M, P) / 2


def energy(M, P, *, b, eps=0):  # -(1/2) sum b_i F_i
    Pt = shifted(M, P, eps=eps)
    trace = -(M * M * b[..., None, :]).sum(-1).sum(-1)  # tr(M B M)
    return pairing(M, M) / 2 - eps * eps * dot(P, P) * trace / 8 - dot(Pt, b * Pt) / 2


def translation(M, P, *, b):  # U = dH/dP
    return -b * P


def spectrum(M, P, *, b, eps=0):  # coefficients of det(L(lambda) - mu), up to constants and det S
    return pencil_spectrum(M, diagonal(b), shifted(M, P, eps=eps), eps * eps * dot(P, P) / 4)


def pencil(M, Q, b, lam):
    return lam * diagonal(b) + M + Q[..., :, None] * Q[..., None, :] / lam


def lax(M, P, *, b, lam):  # L' = [L, U+],   U+ = lambda B + M
    return pencil(M, P, b, lam), lam * diagonal(b) + M


def lax_matrix(M, P, *, b, lam, eps):  # S^-1 (lambda B + M + Pt Pt^T / lambda),   S = I + eps^2 |P|^2/4 B
    S = 1 + eps * eps / 4 * vec(dot(P, P)) * b
    return pencil(M, shifted(M, P, eps=eps), b, lam) / S[..., :, None]


def conjugator(M, P, *, b, lam, eps):  # V^-1 = cay(-eps/(2 lambda) Q),   Q = P P^T S / den
    S = 1 + eps * eps / 4 * vec(dot(P, P)) * b
    Q = P[..., :, None] * (P * S)[..., None, :] / mat(denominator(P, b=b, eps=eps))
    return moebius(-eps / (2 * lam) * Q)


def generator(M, P, M1, P1, *, eps):  # g_(k+1) = g_k cay(eps/2 M_(k+1))
    return eps / 2 * M1


def lagrangian(g, h, p, *, b, eps):  # (dClebsch spec Lagr) with 2/eps for 4/eps
    W, P = g.mT @ h, act(g.mT, p)
    kinetic = trace_log(2 * identity(W.shape[-1]) + W + W.mT) / eps
    return -kinetic + 2 / eps * log(denominator(P, b=b, eps=eps))


def largest_step(M, P, *, b):
    """The denominator 1 + eps^2/4 <P, BP> stays positive on |P| = const for smaller |eps|."""
    return 2 / np.sqrt(dot(P, P) * np.maximum(-b.min(-1), 0))


MAP = kicked_map(
    kick,
    turn,
    **named(generator, lagrangian, conjugator, largest_step),
    lax=lax_matrix,
    source="Suris 2001, section 7, (dClebsch spec)",
)

SYSTEM = System(
    name="clebsch",
    title="Clebsch's case, the special flow c = 1",
    equations="M' = P ^ BP,  P' = -M P",
    source="Suris 2001, section 7, (Clebsch spec)",
    space=MOVING_SPACE,
    parameters=(
        Parameter(
            "b",
            "vector",
            "diagonal of B: H has -<P, BP>/2. Adding a constant to b does not change the flow",
            diagonal=True,
        ),
    ),
    **named(flow, energy, translation, lax),
    inverse_inertia=lambda M: M,
    scaling="The one moment of inertia is 1.",
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    map=MAP,
    baecklund=BAECKLUND,
    pairs=in_letter(CLEBSCH, "b", dimensions=(4, 5)),  # n = 3: one pair, `kreisel.method.exact`
    derive=shifted_diagonal,
    relations=(
        Relation("clebsch-general", lambda M, P, g, *, b: ((M, P), {"a": b, "b": b}), meaning="the flow a = b"),
        Relation(
            "quadratic-field",
            lambda M, P, g, *, b: ((M, P[..., :, None] * P[..., None, :]), {"b": b}),
            "step",
            "F = P P^T, a field of rank one",
        ),
    ),
    notes="The spectrum is complete for distinct b (and for n = 4 with one equal pair).",
)
