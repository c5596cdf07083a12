"""Clebsch's case of Kirchhoff's equations, any flow of the hierarchy.  State (M, P) in e(n)*.

M (..., n, n) skew, P (..., n), body frame.  c_jk = (b_j - b_k)/(a_j - a_k); plus bracket, F' = {H, F}.
[Suris 2001, section 7]
"""

from kreisel.algebra import act, dot, identity, pairing, wedge
from kreisel.algebra.invariants import diagonal, pencil_spectrum
from kreisel.baecklund.conjugate import CLEBSCH
from kreisel.record.contract import MOVING_SPACE, Parameter, Relation, System, named
from kreisel.record.values import distinct


def quotients(*, a, b):
    """c_jk = (b_j - b_k)/(a_j - a_k), 0 on the diagonal."""
    unit = identity(a.shape[-1])
    return {"c": (b[..., :, None] - b[..., None, :]) / (a[..., :, None] - a[..., None, :] + unit)}


def inverse_inertia(M, *, c):  # Omega_jk = c_jk M_jk
    return c * M


def flow(M, P, *, b, c):  # M' = [M, Omega] + P ^ BP,   P' = -Omega P
    Omega = inverse_inertia(M, c=c)
    return M @ Omega - Omega @ M + wedge(P, b * P), -act(Omega, P)


def energy(M, P, *, b, c):
    return pairing(M, inverse_inertia(M, c=c)) / 2 - dot(P, b * P) / 2


def translation(M, P, *, b):  # U = dH/dP
    return -b * P


def spectrum(M, P, *, a):  # coefficients of det(L(lambda) - mu)
    return pencil_spectrum(M, diagonal(a), P, 0)


def lax(M, P, *, a, b, c, lam):  # L = lambda A + M + P P^T / lambda,   U = lambda B + Omega
    return lam * diagonal(a) + M + P[..., :, None] * P[..., None, :] / lam, lam * diagonal(b) + inverse_inertia(M, c=c)


SYSTEM = System(
    name="clebsch-general",
    title="Clebsch's case of Kirchhoff's equations",
    equations="M' = [M, Omega] + P ^ BP,  P' = -Omega P,  Omega_jk = (b_j - b_k)/(a_j - a_k) M_jk",
    source="Suris 2001, section 7",
    space=MOVING_SPACE,
    parameters=(
        Parameter("a", "vector", "diagonal of A, distinct entries", distinct, distinct=True, diagonal=True),
        Parameter("b", "vector", "diagonal of B: H has -<P, BP>/2", diagonal=True),
    ),
    **named(flow, energy, translation, inverse_inertia, lax),
    derive=quotients,
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    pairs=CLEBSCH,
    relations=(
        Relation("kirchhoff", lambda M, P, g, *, b, c: ((M, P), {"C": c, "B": diagonal(b)}), meaning="a special case"),
    ),
    notes="Only the flow a = b has an explicit map here: clebsch. Every flow has method='exact', n = 3 to 5.",
)
