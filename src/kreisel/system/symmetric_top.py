"""Totally symmetric Lagrange top, moving frame: the map of the paper's Introduction.

State (M, P) in e(n)*: M (..., n, n) skew, P (..., n).  Plus bracket, F' = {H, F}.  The same equations
as the rest frame under (m, a, p) = (-M, P, A); any |A| and |P|.  The map is the body form of the unmodified
Lagrangian, hence the adjoint of the map of section 6.2 at alpha = 1 (erratum E13).  [Suris 2001, section 1]
"""

from dataclasses import replace

from kreisel.algebra import act, cayley_act, dot, identity, project_out, trace_log, wedge
from kreisel.baecklund import lagrange_top as maps
from kreisel.record.contract import MOVING_SPACE, ClosedForm, Parameter, Relation, System, kicked_map, named, pullback
from kreisel.record.values import nonzero_vector
from kreisel.system import lagrange_top


def flow(M, P, *, A):  # M' = A ^ P,   P' = -M P
    return wedge(A, P), -act(M, P)


def kick(P, *, A, eps):
    return -eps * wedge(P, A)


def turn(M, P, *, eps):
    return M, cayley_act(-eps / 2 * M, P)


def to_rest_frame(M, P, g, *, A):
    return (-M, P), {"p": A, "alpha": 1 + dot(A, 0 * A)}  # not by an entry: vectors of large n have none


of_rest_frame = pullback(lagrange_top.SYSTEM, to_rest_frame)
shifted = of_rest_frame(lagrange_top.shifted)


def darboux_variables(M, P, *, A, eps):
    return M, shifted(M, P, A=A, eps=eps), eps * eps * dot(P, P) / 4


def noether(M, P, *, A):
    return project_out(M, A)


def generator(M, P, M1, P1, *, eps):  # g_(k+1) = g_k cay(eps/2 M_(k+1))
    return eps / 2 * M1


def lagrangian(g, h, p, *, A, eps):
    W = g.mT @ h
    return -trace_log(2 * identity(W.shape[-1]) + W + W.mT) / eps - eps * dot(p, act(g, A))


def case_of(case):
    def drawn(n, draw):
        state, params, e, mu, rho = case(n, draw)
        return state, {"A": params["A"]}, e, mu, rho

    return drawn


MAP = kicked_map(
    kick,
    turn,
    **named(generator, lagrangian),
    conjugator=of_rest_frame(lagrange_top.conjugator),
    lax=of_rest_frame(lagrange_top.lax_matrix),
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
    flow=flow,
    inverse_inertia=lambda M: M,
    energy=of_rest_frame(lagrange_top.energy),
    lax=of_rest_frame(lagrange_top.lax),
    scaling="The one moment of inertia is 1; |A| |P| is M g l in that unit.",
    integrals={"spectrum": of_rest_frame(lagrange_top.spectrum), "noether": noether},
    commuting=("spectrum",),
    map=MAP,
    baecklund=replace(
        maps.MOVING,
        spin=None,
        darboux=lambda M, P, e, *, rho, lam: maps.darboux(M, P, e, rho=rho, lam=lam),
        case=case_of(maps.MOVING.case),
        pair_case=case_of(maps.MOVING.pair_case),
    ),
    closed_form=ClosedForm(top=lambda M, P, *, A: (M, A, P)),
    relations=(
        Relation(
            "lagrange-top-moving",
            lambda M, P, g, *, A: ((M, P), {"A": A, "alpha": 1 + 0 * A[..., 0]}),
            "adjoint",
            "alpha = 1",
        ),
        Relation("lagrange-top", to_rest_frame, "step", "(m, a, p) = (-M, P, A)"),
    ),
    notes="For n >= 4 the spectrum is not complete: noether is needed too.",
)
