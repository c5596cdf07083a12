"""Sections 1, 4 and 5: the heavy top and the Lagrange top."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array, act, bracket, dot, identity, pairing, triangle, wedge
from kreisel.lab.jets import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.shared import outer
from kreisel.lab.paper.statements import Setting, gradient, printed, stated, stated_law
from kreisel.system import heavy_top, lagrange_top, lagrange_top_moving, symmetric_top

HEAVY, TOP, MOVING = heavy_top.SYSTEM, lagrange_top.SYSTEM, lagrange_top_moving.SYSTEM
SYMMETRIC = symmetric_top.SYSTEM

# -- section 1 ----------------------------------------------------------------------------------------

stated_law(
    "introduction-top-flow",
    "Section 1, first display, left",
    "M' = A ^ P, P' = -MP is Hamiltonian on e*(n)",
    SYMMETRIC,
    "hamiltonian-flow",
)
stated_law(
    "introduction-top-map",
    "Section 1, first display, right",
    "M_(k+1) = M_k + eps A ^ P_k, P_(k+1) = cay(-eps/2 M_(k+1)) P_k is Poisson, keeps its energy and has a Lax pair",
    SYMMETRIC,
    "poisson",
    "integrals-of-the-map",
    "discrete-lax-equation",
)


@stated(
    "introduction-adjoint",
    "Sections 1 and 6.2",
    "the Introduction's map is the adjoint of section 6.2's at alpha = 1, not the same (E13)",
    "E13",
)
def introduction_adjoint(s: Setting) -> Sides:
    M, P, A = s.skew(), s.vector(), s.vector()
    mine = symmetric_top.step(M, P, A=A, eps=s.eps)
    theirs = lagrange_top_moving.adjoint(M, P, A=A, alpha=1 + 0 * A[0], eps=s.eps)
    yield from zip(mine, theirs, strict=True)


@printed("introduction-adjoint")
def introduction_same(s: Setting) -> Sides:
    M, P, A = s.skew(), s.vector(), s.vector()
    mine = symmetric_top.step(M, P, A=A, eps=s.eps)
    yield from zip(mine, lagrange_top_moving.step(M, P, A=A, alpha=1 + 0 * A[0], eps=s.eps), strict=True)


# -- section 4 ----------------------------------------------------------------------------------------


def _kinetic_energy(s: Setting, turn: Any) -> Sides:
    """Point masses x = turn(g) X against -tr(Omega J Omega)/2 with J = sum m X X^T, Omega = g^T g'."""
    one = 1 + 0 * s.scalar()
    g, Omega = s.rotation(), s.skew()
    masses, places = [abs(s.scalar()) for _ in range(s.n + 1)], [s.vector() for _ in range(s.n + 1)]
    moving = g @ (identity(s.n) + Omega * generator(0, one))
    energy = 0
    for mass, X in zip(masses, places, strict=True):
        speed = coefficient(act(turn(moving), X), 1)
        energy = energy + mass * dot(speed, speed) / 2
    J = sum(mass * outer(X) for mass, X in zip(masses, places, strict=True))
    yield np.asarray(energy), -np.trace(Omega @ J @ Omega) / 2


@stated(
    "body-frame",
    "Section 4, the body frame and (mLT Lagr 1)",
    "e_k(t) = g(t) e_k(0): the kinetic energy of point masses is -tr(Omega J Omega)/2, J = sum m x x^T (E8)",
    "E8",
)
def body_frame(s: Setting) -> Sides:
    yield from _kinetic_energy(s, lambda g: g)


@printed("body-frame")
def body_frame_printed(s: Setting) -> Sides:
    yield from _kinetic_energy(s, lambda g: g.T)


@stated(
    "heavy-top-lagrangian",
    "Section 4, (mLT Lagr 2)",
    "-tr(Omega J Omega) = <Omega, J Omega + Omega J>; <p, a> = <P, A>",
)
def heavy_lagrangian(s: Setting) -> Sides:
    J, Omega, g, p, A = s.symmetric(), s.skew(), s.rotation(), s.vector(), s.vector()
    yield -np.trace(Omega @ J @ Omega), pairing(Omega, J @ Omega + Omega @ J)
    yield dot(p, act(g, A)), dot(act(g.T, p), A)


@stated(
    "heavy-top-momentum",
    "Section 4, the momentum",
    "M = grad_Omega L = J Omega + Omega J <=> M_jk = (J_j + J_k) Omega_jk",
)
def heavy_momentum(s: Setting) -> Sides:
    J, Omega = s.diagonal(), s.skew()
    D = J[:, None] * identity(s.n)
    M = gradient(lambda x: pairing(x, D @ x + x @ D) / 2, Omega)
    yield M, D @ Omega + Omega @ D
    yield M, (J[:, None] + J[None, :]) * Omega


@stated(
    "heavy-top-equations",
    "Section 4, (mLT left)",
    "ad*_Omega M + grad_P L <> P = [M, Omega] + A ^ P for L = ... - <P, A>",
)
def heavy_equations(s: Setting) -> Sides:
    M, Omega, P, A = s.skew(), s.skew(), s.vector(), s.vector()
    force = gradient(lambda x: -dot(x, A), P)
    yield bracket(M, Omega) + wedge(P, force), bracket(M, Omega) + wedge(A, P)


stated_law(
    "heavy-top-hamiltonian",
    "Section 4, Hamilton function and brackets",
    "(mLT left) is z' = {H, z} with H = <M, Omega>/2 + <P, A>; the bracket satisfies Jacobi's identity",
    HEAVY,
    "hamiltonian-flow",
    "jacobi-identity",
    "casimirs",
)


@stated("heavy-top-energy", "Section 4, Hamilton function", "<M, Omega>/2 = (1/2) sum_(j<k) M_jk^2/(J_j + J_k)")
def heavy_energy(s: Setting) -> Sides:
    J, Omega = s.diagonal(), s.skew()
    M = (J[:, None] + J[None, :]) * Omega
    j, k = triangle(s.n)
    yield pairing(M, Omega) / 2, (M[j, k] ** 2 / (J[j] + J[k])).sum() / 2


# -- section 5 ----------------------------------------------------------------------------------------


def _inertia(Omega: Array, A: Array, alpha: Any) -> Array:  # (mLT operator inv1), |A| = 1
    return alpha * Omega + (1 - alpha) * (Omega @ outer(A) + outer(A) @ Omega)


@stated(
    "inertia-operator",
    "Section 5, action of J",
    "J_1 = ... = alpha/2, J_n = 1 - alpha/2: M_ij = alpha Omega_ij, M_in = Omega_in",
)
def inertia_operator(s: Setting) -> Sides:
    alpha, Omega = s.scalar(), s.skew()
    J = np.array([alpha / 2] * (s.n - 1) + [1 - alpha / 2])
    expected = alpha * Omega
    expected[-1], expected[:, -1] = Omega[-1], Omega[:, -1]
    yield J[:, None] * Omega + Omega * J, expected
    e = np.eye(s.n, dtype=np.int8)[-1] + 0 * s.vector()
    yield _inertia(Omega, e, alpha), expected


@stated(
    "inertia-invariant",
    "Section 5, (mLT operator inv1, inv2)",
    "alpha Omega + (1 - alpha)(Omega AA^T + AA^T Omega) = alpha Omega - (1 - alpha) A ^ (Omega A)",
)
def inertia_invariant(s: Setting) -> Sides:
    Omega, A, alpha = s.skew(), s.vector(), s.scalar()
    yield _inertia(Omega, A, alpha), alpha * Omega - (1 - alpha) * wedge(A, act(Omega, A))


@stated(
    "lagrange-top-lagrangian",
    "Section 5, (mLT Lagr 3) and (mLT Lagr 4)",
    "<Omega, J(Omega)> = alpha <Omega, Omega> + (1 - alpha)|Omega A|^2, and the same with omega, a",
)
def lagrange_lagrangian(s: Setting) -> Sides:
    Omega, A, alpha, g = s.skew(), s.unit(), s.scalar(), s.rotation()
    twice = alpha * pairing(Omega, Omega) + (1 - alpha) * dot(act(Omega, A), act(Omega, A))
    yield pairing(Omega, _inertia(Omega, A, alpha)), twice
    omega, a = g @ Omega @ g.T, act(g, A)
    yield twice, alpha * pairing(omega, omega) + (1 - alpha) * dot(act(omega, a), act(omega, a))


@stated(
    "inertia-inverse",
    "Section 5, (mTL Legendre inv interm) and the inverse",
    "MA = Omega A; Omega = M/alpha + ((1 - alpha)/alpha) A ^ (MA), |A| = 1",
)
def inertia_inverse(s: Setting) -> Sides:
    Omega, A, alpha = s.skew(), s.unit(), s.scalar()
    M = _inertia(Omega, A, alpha)
    yield act(M, A), act(Omega, A)
    yield Omega, M / alpha + (1 - alpha) / alpha * wedge(A, act(M, A))


stated_law(
    "proposition-5.1",
    "Section 5, Proposition 5.1",
    "L' = [L, U] along (mLT left), moving frame",
    MOVING,
    "lax-equation",
)


@stated(
    "rest-frame-equations",
    "Section 5, (mLT right Ham red) to (mLT right)",
    "grad_a L = -(1 - alpha) omega^2 a - p; m; ma = omega a; [omega, m] - (1 - alpha)(omega^2 a) ^ a = 0: m' = a ^ p for every alpha",
)
def rest_frame_equations(s: Setting) -> Sides:
    omega, a, p, alpha = s.skew(), s.unit(), s.vector(), s.scalar()

    def lagrangian(x: Array, v: Array) -> Any:
        xv = act(x, v)
        return alpha * pairing(x, x) / 2 + (1 - alpha) * dot(xv, xv) / 2 - dot(p, v)

    force = gradient(lambda v: lagrangian(omega + 0 * v[0], v), a)
    turned = act(omega, act(omega, a))
    yield force, -(1 - alpha) * turned - p
    m = gradient(lambda x: lagrangian(x, a + 0 * x[0, 0]), omega)
    yield m, _inertia(omega, a, alpha)
    yield act(m, a), act(omega, a)
    yield bracket(omega, m), (1 - alpha) * wedge(turned, a)
    yield bracket(omega, m) + wedge(force, a), wedge(a, p)


@stated(
    "rest-frame-momentum", "Section 5, after (mLT right)", "m = g M g^-1 for M = J(Omega), omega = g Omega g^-1, a = gA"
)
def rest_frame_momentum(s: Setting) -> Sides:
    Omega, A, g, alpha = s.skew(), s.unit(), s.rotation(), s.scalar()
    yield g @ _inertia(Omega, A, alpha) @ g.T, _inertia(g @ Omega @ g.T, act(g, A), alpha)


stated_law(
    "rest-frame-hamiltonian",
    "Section 5, (mLT right), (en LP r br 1, 2), Hamilton function",
    "m' = a ^ p, a' = ma is z' = {H, z} with H = <m, m>/2 + <a, p> and the minus bracket",
    TOP,
    "hamiltonian-flow",
    "jacobi-identity",
    "casimirs",
)
stated_law(
    "proposition-5.2", "Section 5, Proposition 5.2", "l' = [l, u] along (mLT right), rest frame", TOP, "lax-equation"
)
