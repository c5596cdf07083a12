"""Clebsch's case, the flow c_jk = 1/(J_j + J_k) of a body, and Suris's map of 2000.  State (M, P) in e(n)*, body frame.

J = diag(J_i) > 0 is the mass tensor; the potential energy is -<P, JP>/2.  It is `quadratic_potential` with P P^T for P
(Brun's remark), where (1 - eps^2 P P^T)^(1/2) = 1 - eps^2 r P P^T, r = 1/(1 + (1 - eps^2 |P|^2)^(1/2)).  The
integrals are conserved exactly; the integrals of the explicit map of `clebsch`, another flow, are deformed.
[Suris 2000; named in Suris 2001, section 7 and Conclusions]
"""

from dataclasses import replace
from math import inf

from kreisel import implicit
from kreisel.algebra import cayley_act, dot, identity, mat, sqrt
from kreisel.baecklund.conjugate import CLEBSCH, of_body
from kreisel.record.contract import MOVING_SPACE, ClosedForm, Relation, implicit_map, named, pullback
from kreisel.system import clebsch_general, euler_top, quadratic_potential


def outer(P):
    return P[..., :, None] * P[..., None, :]


def to_general(M, P, g, *, J):
    return (M, P), {"a": J * J, "b": J}


of_general = pullback(clebsch_general.SYSTEM, to_general)
lax = of_general(clebsch_general.lax)


def deviation(P, eps):  # R = (1 - Q)/eps^2
    return outer(P) / mat(1 + sqrt(1 - eps * eps * dot(P, P)))


def turn(M, P, *, J, c, eps):
    return quadratic_potential.solved(M, outer(P), deviation(P, eps), J=J, c=c, eps=eps)


def move(M, P, X, *, J, eps):
    return quadratic_potential.moved(M, deviation(P, eps), X, J=J, eps=eps), cayley_act(-X, P)


def lagrangian(g, h, p, *, J, eps):  # -(1/eps) tr((1 - eps^2 p p^T)^(1/2) h J g^T)
    root = identity(p.shape[-1]) - eps * eps * deviation(p, eps)
    return quadratic_potential.action(g, h, root, J=J, eps=eps)


def lax_matrix(M, P, *, J, lam, eps):  # (J W^T + l Q)(W J - l Q)
    return quadratic_potential.lax_matrix(M, outer(P), J=J, lam=lam, eps=eps)


def conjugator(M, P, *, J, c, lam, eps):  # J + l Q W
    return quadratic_potential.conjugated(M, outer(P), deviation(P, eps), J=J, c=c, lam=lam, eps=eps)


def largest_step(M, P, *, J, enough=inf):
    return implicit.largest_step(M, J, outer(P), enough)


SYSTEM = replace(
    euler_top.SYSTEM,
    name="clebsch-body",
    title="Clebsch's case, the flow of a body, c = 1/(J_j + J_k)",
    equations="M' = [M, Omega] + P ^ JP,  P' = -Omega P,  M = J Omega + Omega J",
    source="Suris 2001, section 7",
    space=MOVING_SPACE,
    flow=of_general(clebsch_general.flow),
    energy=of_general(clebsch_general.energy),
    translation=of_general(clebsch_general.translation),
    integrals={"spectrum": of_general(clebsch_general.spectrum)},
    lax=lax,
    scaling="Any consistent units: the potential energy is -<P, JP>/2.",
    closed_form=ClosedForm(),
    pairs=of_body(CLEBSCH),
    map=implicit_map(
        turn,
        move,
        **named(lagrangian, conjugator, largest_step),
        involution=quadratic_potential.involution,
        lax=lax_matrix,
        source="Suris 2000",
    ),
    relations=(
        Relation("clebsch-general", to_general, meaning="a = J^2, b = J"),
        Relation("quadratic-potential", lambda M, P, g, *, J: ((M, outer(P)), {"J": J}), "step", "P P^T for P"),
    ),
)
