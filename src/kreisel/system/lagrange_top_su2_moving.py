"""Lagrange top, moving frame, n = 3, on SU(2): the map of 1999.  State (M, P) as in `lagrange_top_moving`.

Notation and source as in `lagrange_top_su2`.  With W = g_k^-1 g_(k+1) in SU(2) and A1 = W A W^-1,

    M = (alpha/eps) (W - W^-1)/tr W + (2 (1 - alpha)/eps) [A, A1]/(|A|^2 + <A, A1>),
    P_(k+1) = W^-1 P_k W,   M_(k+1) = W^-1 M_k W + eps [P_(k+1), A].
"""

from kreisel.algebra import act, axial, dot, identity, log
from kreisel.algebra.invariants import stack, su2, trace
from kreisel.system import lagrange_top_moving as moving
from kreisel.system.lagrange_top_su2 import of_1999


def squares(M, P, *, A, eps=0):
    """The coefficients of -2 tr L^2 without Casimirs: <B, B>, <M, B>, <M, M> + 2 <B, P>, with B as in `lax_matrix`."""
    B, u = moving.shifted(M, P, A=A, eps=eps), axial(M)
    return stack([dot(B, B), dot(u, B), dot(u, u) + 2 * dot(B, P)])


def lax_matrix(M, P, *, A, lam, eps=0):  # L = lambda B + M + P/lambda,   B = A + (eps/2) [M, A] + (eps^2/4) |A|^2 P
    return su2(lam * moving.shifted(M, P, A=A, eps=eps) + axial(M) + P / lam)


def lax(M, P, *, A, alpha, lam):  # L' = [L, lambda A + Omega]
    Omega = moving.inverse_inertia(M, A=A, alpha=alpha)
    return lax_matrix(M, P, A=A, lam=lam), su2(lam * A + axial(Omega))


def conjugator(M, P, *, A, alpha, lam, eps):  # V = W (1 + eps lambda A)
    W = 2 * axial(moving.legendre(M, P, A=A, alpha=alpha, eps=eps))
    return (identity(2) + su2(W)) @ (identity(2) + su2(eps * lam * A))


def lagrangian(g, h, p, *, A, alpha, eps):  # (tr W)^2 = 1 + tr R for the rotation R that W covers
    R = g.mT @ h
    kinetic = 2 * alpha / eps * log(1 + trace(R))
    return -kinetic - 2 * (1 - alpha) / eps * log(dot(A, A) + dot(A, act(R, A))) - eps * dot(p, act(h, A))


def same(M, P, g, *, A, alpha):
    return (M, P), {"A": A, "alpha": alpha}


SYSTEM = of_1999(moving, same, squares, lax, lax_matrix, conjugator, lagrangian)
