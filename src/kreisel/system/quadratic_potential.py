"""Rigid body in a quadratic potential and Suris's map of 2000.  State (M, P) in (so(n) <x Sym(n))*, body frame.

M (..., n, n) skew, P = g^T A_0 g (..., n, n) symmetric with A_0 fixed in space; the potential energy is -tr(J P)/2 and
J = diag(J_i) > 0 the mass tensor.  Plus bracket, F' = {H, F}.  The map, with Q = (1 - eps^2 P)^(1/2) > 0,

    Q W J - J W^T Q = eps M,   P_(k+1) = W^T P W,   M_(k+1) = W^T (M + eps [R, W J + J W^T]) W,   R = (1 - Q)/eps^2,

conserves all integrals of the flow as they are.  For P = p p^T it is the map of `clebsch_body`.
[Suris 2000, "The motion of a rigid body in a quadratic potential: an integrable discretization", Intern. Math. Res.
Notices 2000, no. 12; the flow by Brun, Bogoyavlensky, Reyman; named in Suris 2001, Introduction]
"""

from dataclasses import replace
from math import inf

from kreisel import implicit
from kreisel.algebra import KINDS, bracket, cayley, cayley_conjugate, identity, pairing, resolvent, solve
from kreisel.algebra.invariants import diagonal, laurent_spectrum
from kreisel.baecklund.conjugate import QUADRATIC, of_body
from kreisel.record.contract import QUADRATIC_SPACE, ClosedForm, implicit_map, named
from kreisel.system import euler_top
from kreisel.system.euler_top import inverse_inertia

ROOT_STEPS = 8


def flow(M, P, *, J, c):  # M' = [M, Omega] + [P, J],   P' = [P, Omega]
    Omega = inverse_inertia(M, c=c)
    return bracket(M, Omega) + bracket(P, diagonal(J)), bracket(P, Omega)


def energy(M, P, *, J, c):
    return pairing(M, inverse_inertia(M, c=c)) / 2 - (P * diagonal(J)).sum(-1).sum(-1) / 2


def spectrum(M, P, *, J):  # coefficients of det(L(lambda) - mu)
    return laurent_spectrum(M, diagonal(J * J), P)


def lax(M, P, *, J, c, lam):  # L = lambda J^2 + M + P/lambda,   U = lambda J + Omega
    return lam * diagonal(J * J) + M + P / lam, lam * diagonal(J) + inverse_inertia(M, c=c)


def deviation(P, eps):
    """R = (1 - Q)/eps^2 of Q = (1 - eps^2 P)^(1/2), which solves R = P/2 + eps^2 R^2/2.

    Newton's method for the square root from 1, in the increments of R (Iannazzo 2006): from (Q + Q^-1 (1 - eps^2 P))/2
    rounding grows by half the root of the condition in each step.
    """
    unit, square = identity(P.shape[-1]), eps * eps
    R = change = P / 2
    for _ in range(ROOT_STEPS):
        change = square / 2 * (change @ solve(unit - square * R, change))
        change = (change + change.mT) / 2
        R = R + change
    return R


def solved(M, P, R, *, J, c, eps):
    """X with W = cay(X), and the square of its estimated error; from R."""
    D, unit, square = diagonal(J), identity(M.shape[-1]), eps * eps
    Q = unit - square * R
    tilt = square * bracket(R, D) + eps * M  # Q J - J Q = -eps^2 [R, J]

    def residual(X):  # (Q W J - J W^T Q - eps M)/2 with W = 1 + 2 (1 - X)^-1 X
        A = Q @ resolvent(X, X) @ D
        return A - A.mT - tilt / 2

    return implicit.corrected(implicit.turn(M, J, Q, unit - square * P, eps), residual, c)


def turn(M, P, *, J, c, eps):
    return solved(M, P, deviation(P, eps), J=J, c=c, eps=eps)


def moved(M, R, X, *, J, eps):  # W^T (M + eps [R, W J + J W^T]) W
    A = cayley(X) * J[..., None, :]
    return cayley_conjugate(-X, M + eps * bracket(R, A + A.mT))


def move(M, P, X, *, J, eps):
    return moved(M, deviation(P, eps), X, J=J, eps=eps), KINDS["symmetric"].turned(-X, P)


def involution(M, P):
    return -M, P


def action(g, h, root, *, J, eps):
    return -(root * ((g * J[..., None, :]) @ h.mT)).sum(-1).sum(-1) / eps


def lagrangian(g, h, A, *, J, eps):  # -(1/eps) tr((1 - eps^2 A_0)^(1/2) h J g^T)
    return action(g, h, identity(A.shape[-1]) - eps * eps * deviation(A, eps), J=J, eps=eps)


def lax_matrix(M, P, *, J, lam, eps):  # (J W^T + l Q)(W J - l Q)
    return diagonal(J * J) + lam * eps * M - lam * lam * (identity(M.shape[-1]) - eps * eps * P)


def conjugated(M, P, R, *, J, c, lam, eps):  # J + l Q W
    Q = identity(M.shape[-1]) - eps * eps * R
    return diagonal(J) + lam * Q @ cayley(solved(M, P, R, J=J, c=c, eps=eps)[0])


def conjugator(M, P, *, J, c, lam, eps):
    return conjugated(M, P, deviation(P, eps), J=J, c=c, lam=lam, eps=eps)


def largest_step(M, P, *, J, enough=inf):
    return implicit.largest_step(M, J, P, enough)


SYSTEM = replace(
    euler_top.SYSTEM,
    name="quadratic-potential",
    title="Rigid body in a quadratic potential",
    equations="M' = [M, Omega] + [P, J],  P' = [P, Omega],  M = J Omega + Omega J",
    source="Suris 2001, Introduction; Bogoyavlensky 1985, Reyman 1980",
    space=QUADRATIC_SPACE,
    **named(flow, energy, lax),
    scaling="Any consistent units: the potential energy is -tr(J P)/2; P may have any sign.",
    integrals={"spectrum": spectrum},
    closed_form=ClosedForm(),
    pairs=of_body(QUADRATIC),
    map=implicit_map(
        turn, move, **named(involution, lagrangian, conjugator, largest_step), lax=lax_matrix, source="Suris 2000"
    ),
    relations=(),
)
