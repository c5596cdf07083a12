"""Section 6.2: the discrete time Lagrange top, moving frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array, act, cayley, cayley_act, dot, identity, log, moebius, pairing, wedge
from kreisel.algebra.matrices import border
from kreisel.lab.law import Sides
from kreisel.lab.paper.shared import HALF_LEAF, SPECTRAL_RANK, half, leaf_rank, outer, trace_log_of
from kreisel.lab.paper.statements import Setting, printed, printed_law, right_derivative, stated, stated_law
from kreisel.lab.paper.top_rest_frame import expanded_lagrangian
from kreisel.system import lagrange_top, lagrange_top_moving

MOVING = lagrange_top_moving.SYSTEM


@stated(
    "moving-lagrangian",
    "Section 6.2, (dmLT Lagr body)",
    "<p, a_(k+1)> for <p, a_k> leaves the variation of the sum over k as it is; in P_k, W_k it is (dmLT Lagr body)",
)
def moving_lagrangian(s: Setting) -> Sides:
    A, p, alpha, e = s.unit(), s.vector(), s.scalar(), s.eps
    g0, g1, g2 = (s.rotation() for _ in range(3))

    def varied(action: Any) -> Array:
        return right_derivative(lambda g: action(g0 + 0 * g, g) + action(g, g2 + 0 * g), g1)

    def shown(g: Array, h: Array) -> Any:
        W, P = g.T @ h, act(g.T, p)
        WA = act(W, A)
        return -alpha / e * trace_log_of(W) - 2 * (1 - alpha) / e * log(1 + dot(A, WA)) - e * dot(P, WA)

    body = varied(lambda g, h: lagrange_top_moving.lagrangian(g, h, p, A=A, alpha=alpha, eps=e))
    yield varied(lambda g, h: lagrange_top.lagrangian(g, h, A, p=p, alpha=alpha, eps=e)), body
    yield varied(shown), body


@stated(
    "moving-discrete-limit",
    "Section 6.2, after (dmLT Lagr body)",
    "eps (Lambda(P, W) - constant) = eps^2 L(P, Omega) + O(eps^3), W = I + eps Omega + ..., |A| = 1 (E15: the constant is not 0)",
    "E15",
)
def moving_discrete_limit(s: Setting) -> Sides:
    yield from expanded_lagrangian(s, moving=True)


@printed("moving-discrete-limit")
def moving_discrete_limit_printed(s: Setting) -> Sides:
    yield from expanded_lagrangian(s, moving=True, constant=False)


@stated(
    "moving-backwards",
    "Section 6.2, the modified Lagrange function",
    "it is minus (dmLT Lagr 1) with w^-1, a_(k+1), -eps for w, a_k, eps, any alpha: (g M g^T, gA) moves by the inverse of the rest frame's map with -eps",
)
def moving_backwards(s: Setting) -> Sides:
    A, P, M, alpha, e = s.unit(), s.vector(), s.skew(), s.scalar(), s.eps
    g, h = s.rotation(), s.rotation()
    p = act(g, P)

    def modified(x: Array, y: Array) -> Any:
        return lagrange_top_moving.lagrangian(x, y, p, A=A, alpha=alpha, eps=e)

    def reversed_(x: Array, y: Array) -> Any:
        return -lagrange_top.lagrangian(y, x, A, p=p, alpha=alpha, eps=-e)

    yield right_derivative(lambda x: modified(x, h + 0 * x), g), right_derivative(lambda x: reversed_(x, h + 0 * x), g)
    yield right_derivative(lambda x: modified(g + 0 * x, x), h), right_derivative(lambda x: reversed_(g + 0 * x, x), h)
    g1 = g @ cayley(lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=e))
    M1, P1 = lagrange_top_moving.step(M, P, A=A, alpha=alpha, eps=e)
    back = lagrange_top.step(g1 @ M1 @ g1.T, act(g1, A), p=p, eps=-e)
    yield from zip(back, (g @ M @ g.T, act(g, A)), strict=True)
    yield P1, act(g1.T, p)


def _moving_data(s: Setting) -> tuple[Any, ...]:
    """W, A with |A| = 1, P, alpha, and M_k of (dmLT W thru M)."""
    W, A, P, alpha = s.rotation(), s.unit(), s.vector(), s.scalar()
    WA = act(W, A)
    M = 2 * alpha / s.eps * half(W) - 2 * (1 - alpha) / s.eps * wedge(A, WA) / (1 + dot(A, WA))
    return W, A, P, alpha, M


@stated(
    "moving-legendre",
    "Section 6.2, (dmLT W thru M)",
    "M_k = -d'_1 of the discrete Lagrangian; its inverse W = cay(X), X = eps M/(2 alpha) + ((1 - alpha)/alpha) A ^ y/<A, y>, y = (I - eps/2 M)^-1 A",
)
def moving_legendre(s: Setting) -> Sides:
    W, A, P, alpha, M = _moving_data(s)

    def whole(g: Array) -> Any:  # L(g_k, g_(k+1)) with g_(k+1) = W fixed and g_k near 1
        return lagrange_top_moving.lagrangian(g, W + 0 * g, P, A=A, alpha=alpha, eps=s.eps)

    yield -right_derivative(whole, identity(s.n) + 0 * W), M
    yield cayley(lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=s.eps)), W


@stated("moving-legendre-isotropic", "Section 6.2, alpha = 1", "M_k = (2/eps)(W - I)/(W + I) => W = cay(eps/2 M_k)")
def moving_legendre_isotropic(s: Setting) -> Sides:
    W = s.rotation()
    yield cayley(half(W)), W


@stated(
    "moving-turn",
    "Section 6.2, (dmTL Legendre inv interm)",
    "W_k A = cay(eps/2 M_k) A, by the two displays for (eps/2) M_k A and (eps/2) M_k W_k A",
)
def moving_turn(s: Setting) -> Sides:
    W, A, _, alpha, M = _moving_data(s)
    WA, h = act(W, A), half(W)
    c = dot(A, WA)
    yield s.eps / 2 * act(M, A), alpha * act(h, A) - (1 - alpha) * (A * c - WA) / (1 + c)
    yield s.eps / 2 * act(M, WA), alpha * act(h, WA) - (1 - alpha) * (A - WA * c) / (1 + c)
    yield s.eps / 2 * act(M, A + WA), WA - A
    yield cayley_act(s.eps / 2 * M, A), WA


stated_law(
    "theorem-6.3",
    "Section 6.2, Theorem 6.3, (dmLT body), Hbar_eps",
    "the discrete Euler-Lagrange equations of (dmLT Lagr body) are the map; it is Poisson and conserves Hbar_eps",
    MOVING,
    "discrete-euler-lagrange",
    "poisson",
    "integrals-of-the-map",
    "involution",
)


@stated(
    "moving-energy-chain",
    "Section 6.2, last display of the proof",
    "Hbar_eps(M_(k+1), P_(k+1)) through its six forms to Hbar_eps(M_k, P_k), |A| = 1",
)
def moving_energy_chain(s: Setting) -> Sides:
    W, A, P, _, M = _moving_data(s)
    e = s.eps
    P1, N = act(W.T, P), W.T @ M @ W
    M1 = N + e * wedge(A, P1)
    last = pairing(M, M) / 2 + dot(P, A + e / 2 * act(M, A))
    yield pairing(M1, M1) / 2 + dot(P1, A) + e / 2 * pairing(M1, wedge(P1, A)), last
    yield pairing(M1, M1 + e * wedge(P1, A)) / 2 + dot(P1, A), last
    yield pairing(N - e * wedge(P1, A), N) / 2 + dot(P1, A), last
    yield pairing(M, M) / 2 + dot(P1, A - e / 2 * act(N, A)), last
    yield pairing(M, M) / 2 + dot(P, act(W, A) - e / 2 * act(M, act(W, A))), last


@stated(
    "moving-energy-limit",
    "Section 6.2, Theorem 6.3, Hbar_eps",
    "Hbar_0 + (1/alpha - 1)<M_perp, M_perp>/2 = H of the alpha top, |A| = 1 (E16: Hbar_0 alone is H at alpha = 1)",
    "E16",
)
def moving_energy_limit(s: Setting) -> Sides:
    M, P, A, alpha = s.skew(), s.vector(), s.unit(), s.scalar()
    Omega = lagrange_top_moving.velocity(M, P, A=A, alpha=alpha)
    Pi = identity(s.n) - outer(A)
    across = Pi @ M @ Pi
    H = pairing(M, Omega) / 2 + dot(P, A)
    yield pairing(M, M) / 2 + dot(P, A) + (1 / alpha - 1) * pairing(across, across) / 2, H
    yield lagrange_top_moving.energy(M, P, A=A, alpha=alpha), H


@printed("moving-energy-limit")
def moving_energy_limit_printed(s: Setting) -> Sides:
    M, P, A, alpha = s.skew(), s.vector(), s.unit(), s.scalar()
    Omega = lagrange_top_moving.velocity(M, P, A=A, alpha=alpha)
    yield pairing(M, M) / 2 + dot(P, A), pairing(M, Omega) / 2 + dot(P, A)


stated_law(
    "theorem-6.4",
    "Section 6.2, Theorem 6.4",
    "V_k L_(k+1) = L_k V_k with U = [[0, lambda A], [+lambda A^T, 0]] (E2)",
    MOVING,
    "discrete-lax-equation",
    erratum="E2",
)


def printed_conjugator(M: Array, P: Array, *, A: Array, alpha: Any, lam: Any, eps: Any) -> Array:
    """V_k with -lambda A^T in U, as printed."""
    W = cayley(lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=eps))
    turn = border(W, 0 * P)
    turn[..., -1, -1] = 1
    return turn @ moebius(eps / 2 * border(0 * M, lam * A, -lam * A))


printed_law("theorem-6.4", MOVING, "discrete-lax-equation", conjugator=printed_conjugator)
stated_law(
    "moving-limit",
    "Section 6.2, proof of Theorem 6.3",
    "(dmLT body) approximates (mLT left); the error of the map is O(dt), of its conjugate O(dt^2)",
    MOVING,
    "continuous-limit",
    "order",
    numbers=("float",),
)


@stated(
    "moving-completeness",
    'Section 6.2, Theorem 6.3, "complete"',
    "rank on the leaf as in the rest frame: complete only with Pi M Pi for n > 3 (E12)",
    numbers=("exact",),
)
def moving_completeness(s: Setting) -> Sides:
    case = s.case(MOVING)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(SPECTRAL_RANK[s.n])
    yield np.asarray(leaf_rank(case, ("spectrum", "noether"))), np.asarray(2 * HALF_LEAF[s.n] - s.n + 1)
