"""Totally symmetric Lagrange top, moving frame: the map of the paper's Introduction.

State (M, P) in e(n)*: M (..., n, n) skew, P (..., n).  Plus bracket, F' = {H, F}.  The same equations
as the rest frame under (m, a, p) = (-M, P, A); any |A| and |P|.  The map is the body form of the unmodified
Lagrangian, hence the adjoint of the map of section 6.2 at alpha = 1 (erratum E13).  [Suris 2001, section 1]
"""

from dataclasses import replace

from kreisel.algebra import (
    act,
    cayley_act,
    dot,
    identity,
    moebius,
    pairing,
    project_out,
    trace_log,
    vec,
    wedge,
)
from kreisel.algebra.invariants import bordered_spectrum
from kreisel.algebra.matrices import border
from kreisel.baecklund import lagrange_top, lagrange_top_moving
from kreisel.record.checks import nonzero_vector
from kreisel.record.contract import MOVING_SPACE, ClosedForm, Map, Parameter, Relation, System, named


def flow(M, P, *, A):  # M' = A ^ P,   P' = -M P
    return wedge(A, P), -act(M, P)


def step(M, P, *, A, eps):
    M = M - eps * wedge(P, A)
    return M, cayley_act(-eps / 2 * M, P)


def inverse(M, P, *, A, eps):
    P = cayley_act(eps / 2 * M, P)
    return M + eps * wedge(P, A), P


def involution(M, P, *, A, eps):
    return -(M - eps * wedge(P, A)), P


def half_kick(M, P, *, A, eps):
    return M - eps / 2 * wedge(P, A), P


def shifted(M, P, *, A, eps):
    return P + eps * act(M, P) / 2 + eps * eps * vec(dot(P, P)) * A / 4


def darboux_variables(M, P, *, A, eps):
    return M, shifted(M, P, A=A, eps=eps), eps * eps * dot(P, P) / 4


def energy(M, P, *, A, eps=0):
    return pairing(M, M) / 2 + dot(P, A) + eps * pairing(M, wedge(A, P)) / 2


def spectrum(M, P, *, A, eps=0):
    return bordered_spectrum(-M, shifted(M, P, A=A, eps=eps), A)


def noether(M, P, *, A):
    return project_out(M, A)


def lax_matrix(M, P, *, A, lam, eps=0):
    return border(-M, lam * shifted(M, P, A=A, eps=eps) - A / lam)


def lax(M, P, *, A, lam):
    return lax_matrix(M, P, A=A, lam=lam), border(0 * M, lam * P)


def conjugator(M, P, *, A, lam, eps):
    return moebius(eps / 2 * border(0 * M, lam * P))


def inverse_inertia(M):  # Omega = M
    return M


def velocity(M, P):
    return inverse_inertia(M)


def generator(M, P, M1, P1, *, eps):  # g_(k+1) = g_k cay(eps/2 M_(k+1))
    return eps / 2 * M1


def lagrangian(g, h, p, *, A, eps):
    W = g.mT @ h
    return -trace_log(2 * identity(W.shape[-1]) + W + W.mT) / eps - eps * dot(p, act(g, A))


def rational_case(n, draw):
    state, params, e, mu, rho = lagrange_top_moving.rational_case(n, draw)
    return state, {"A": params["A"]}, e, mu, rho


def gaussian_case(n, draw):
    state, params, e, mu, rho = lagrange_top_moving.gaussian_case(n, draw)
    return state, {"A": params["A"]}, e, mu, rho


def one(A):
    return 1 + 0 * A[..., 0]


MAP = Map(
    **named(step, inverse, involution, generator, lagrangian, conjugator),
    to_symmetric=half_kick,
    lax=lax_matrix,
    darboux=darboux_variables,
    source="Suris 2001, section 1 (Introduction)",
)

SYSTEM = System(
    name="symmetric-top",
    title="Totally symmetric Lagrange top, moving frame",
    equations="M' = A ^ P,  P' = -M P",
    source="Suris 2001, section 1",
    space=MOVING_SPACE,
    parameters=(
        Parameter(
            "A", "vector", "from the fixed point to the centre of mass, in the body", nonzero_vector, fixed="body"
        ),
    ),
    **named(flow, energy, velocity, inverse_inertia, lax),
    scaling="The one moment of inertia is 1; |A| |P| is M g l in that unit.",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    map=MAP,
    baecklund=replace(
        lagrange_top_moving.BAECKLUND,
        spin=None,
        darboux=lambda M, P, e, *, rho, lam: lagrange_top.darboux(M, P, e, rho=rho, lam=lam),
        case=rational_case,
        pair_case=gaussian_case,
    ),
    closed_form=ClosedForm(top=lambda M, P, *, A: (M, A, P)),
    relations=(
        Relation(
            "lagrange-top-moving", lambda M, P, g, *, A: ((M, P), {"A": A, "alpha": one(A)}), "adjoint", "alpha = 1"
        ),
        Relation(
            "lagrange-top", lambda M, P, g, *, A: ((-M, P), {"p": A, "alpha": one(A)}), "step", "(m, a, p) = (-M, P, A)"
        ),
    ),
    notes="For n >= 4 the spectrum is not complete: noether is needed too.",
)
