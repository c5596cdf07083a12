"""Sections 1, 4 and 5: the heavy top and the Lagrange top."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array, act, bracket, dot, identity, pairing, triangle, wedge
from kreisel.algebra.matrices import border
from kreisel.lab.exact import coefficient, generator
from kreisel.lab.law import Case, Sides
from kreisel.lab.paper.statements import Setting, gradient, outer, printed, stated, stated_law
from kreisel.system import heavy_top, lagrange_top, lagrange_top_moving, symmetric_top

HEAVY, TOP, MOVING = heavy_top.SYSTEM, lagrange_top.SYSTEM, lagrange_top_moving.SYSTEM
SYMMETRIC = symmetric_top.SYSTEM

# -- section 1 ----------------------------------------------------------------------------------------

stated_law(
    "introduction-top-flow",
    "Section 1, first display, left",
    "M' = A ^ P, P' = -MP is Hamiltonian on e*(n)",
    SYMMETRIC,
    ("hamiltonian-flow",),
)
stated_law(
    "introduction-top-map",
    "Section 1, first display, right",
    "M_(k+1) = M_k + eps A ^ P_k, P_(k+1) = cay(-eps/2 M_(k+1)) P_k is Poisson, conserves its energy and has a Lax pair",
    SYMMETRIC,
    ("poisson", "integrals-of-the-map", "discrete-lax-equation"),
)


@stated("introduction-frames", "Section 1, first display")
def introduction_frames(s: Setting) -> Sides:
    """(m, a, p) = (-M, P, A) carries flow and map to those of the rest frame; there (g M g^T)' = a ^ p, (gA)' = ma for the top of any alpha"""
    M, P, A, g, alpha = s.skew(), s.vector(), s.unit(), s.rotation(), s.scalar()
    for mine, theirs in (
        (symmetric_top.flow(M, P, A=A), lagrange_top.flow(-M, P, p=A)),
        (symmetric_top.step(M, P, A=A, eps=s.eps), lagrange_top.step(-M, P, p=A, eps=s.eps)),
    ):
        yield from zip((-mine[0], mine[1]), theirs, strict=True)
    Omega, (dM, dP) = (f(M, P, A=A, alpha=alpha) for f in (lagrange_top_moving.velocity, lagrange_top_moving.flow))
    m, a, p = g @ M @ g.T, act(g, A), act(g, P)
    rates = g @ (dM + bracket(Omega, M)) @ g.T, act(g @ Omega, A)
    yield from zip(rates, lagrange_top.flow(m, a, p=p), strict=True)
    yield dP, -act(Omega, P)


@stated("introduction-adjoint", "Sections 1 and 6.2", "E13", printed={"step": lagrange_top_moving.step})
def introduction_adjoint(s: Setting, step: Any = lagrange_top_moving.MAP.adjoint) -> Sides:
    """the Introduction's map is the adjoint of section 6.2's at alpha = 1, not the same (E13)"""
    M, P, A = s.skew(), s.vector(), s.vector()
    mine = symmetric_top.step(M, P, A=A, eps=s.eps)
    yield from zip(mine, step(M, P, A=A, alpha=1 + 0 * A[0], eps=s.eps), strict=True)


# -- section 4 ----------------------------------------------------------------------------------------


@stated("body-frame", "Section 4, the body frame and (mLT Lagr 1)", "E8", printed={"turned": True})
def body_frame(s: Setting, turned: bool = False) -> Sides:
    """e_k(t) = g(t) e_k(0): the kinetic energy of point masses is -tr(Omega J Omega)/2, J = sum m x x^T (E8)"""
    one = 1 + 0 * s.scalar()
    g, Omega = s.rotation(), s.skew()
    masses, places = [abs(s.scalar()) for _ in range(s.n + 1)], [s.vector() for _ in range(s.n + 1)]
    moving = g @ (identity(s.n) + Omega * generator(0, one))
    energy = 0
    for mass, X in zip(masses, places, strict=True):
        speed = coefficient(act(moving.T if turned else moving, X), 1)
        energy = energy + mass * dot(speed, speed) / 2
    J = sum(mass * outer(X) for mass, X in zip(masses, places, strict=True))
    yield np.asarray(energy), -np.trace(Omega @ J @ Omega) / 2


@stated("heavy-top-lagrangian", "Section 4, (mLT Lagr 2)")
def heavy_lagrangian(s: Setting) -> Sides:
    """-tr(Omega J Omega) = <Omega, J Omega + Omega J>; <p, a> = <P, A>"""
    J, Omega, g, p, A = s.symmetric(), s.skew(), s.rotation(), s.vector(), s.vector()
    yield -np.trace(Omega @ J @ Omega), pairing(Omega, J @ Omega + Omega @ J)
    yield dot(p, act(g, A)), dot(act(g.T, p), A)


@stated("heavy-top-momentum", "Section 4, the momentum")
def heavy_momentum(s: Setting) -> Sides:
    """M = grad_Omega L = J Omega + Omega J <=> M_jk = (J_j + J_k) Omega_jk"""
    J, Omega = s.diagonal(), s.skew()
    D = J[:, None] * identity(s.n)
    M = gradient(lambda x: pairing(x, D @ x + x @ D) / 2, Omega)
    yield M, D @ Omega + Omega @ D
    yield M, (J[:, None] + J[None, :]) * Omega


@stated("heavy-top-equations", "Section 4, (mLT left)")
def heavy_equations(s: Setting) -> Sides:
    """ad*_Omega M + grad_P L <> P = [M, Omega] + A ^ P for L = ... - <P, A>"""
    M, Omega, P, A = s.skew(), s.skew(), s.vector(), s.vector()
    force = gradient(lambda x: -dot(x, A), P)
    yield bracket(M, Omega) + wedge(P, force), bracket(M, Omega) + wedge(A, P)


stated_law(
    "heavy-top-hamiltonian",
    "Section 4, Hamilton function and brackets",
    "(mLT left) is z' = {H, z} with H = <M, Omega>/2 + <P, A>; the bracket satisfies Jacobi's identity",
    HEAVY,
    ("hamiltonian-flow", "jacobi-identity", "casimirs"),
)


@stated("heavy-top-energy", "Section 4, Hamilton function")
def heavy_energy(s: Setting) -> Sides:
    """<M, Omega>/2 = (1/2) sum_(j<k) M_jk^2/(J_j + J_k)"""
    J, Omega = s.diagonal(), s.skew()
    M = (J[:, None] + J[None, :]) * Omega
    j, k = triangle(s.n)
    yield pairing(M, Omega) / 2, (M[j, k] ** 2 / (J[j] + J[k])).sum() / 2


# -- section 5 ----------------------------------------------------------------------------------------


def _inertia(Omega: Array, A: Array, alpha: Any) -> Array:  # (mLT operator inv1), |A| = 1
    return alpha * Omega + (1 - alpha) * (Omega @ outer(A) + outer(A) @ Omega)


@stated("inertia-operator", "Section 5, action of J")
def inertia_operator(s: Setting) -> Sides:
    """J_1 = ... = alpha/2, J_n = 1 - alpha/2: M_ij = alpha Omega_ij, M_in = Omega_in"""
    alpha, Omega = s.scalar(), s.skew()
    J = np.array([alpha / 2] * (s.n - 1) + [1 - alpha / 2])
    expected = alpha * Omega
    expected[-1], expected[:, -1] = Omega[-1], Omega[:, -1]
    yield J[:, None] * Omega + Omega * J, expected
    e = np.eye(s.n, dtype=np.int8)[-1] + 0 * s.vector()
    yield _inertia(Omega, e, alpha), expected


@stated("inertia-invariant", "Section 5, (mLT operator inv1, inv2)")
def inertia_invariant(s: Setting) -> Sides:
    """alpha Omega + (1 - alpha)(Omega AA^T + AA^T Omega) = alpha Omega - (1 - alpha) A ^ (Omega A)"""
    Omega, A, alpha = s.skew(), s.vector(), s.scalar()
    yield _inertia(Omega, A, alpha), alpha * Omega - (1 - alpha) * wedge(A, act(Omega, A))


@stated("lagrange-top-lagrangian", "Section 5, (mLT Lagr 3) and (mLT Lagr 4)")
def lagrange_lagrangian(s: Setting) -> Sides:
    """<Omega, J(Omega)> = alpha <Omega, Omega> + (1 - alpha)|Omega A|^2, and the same with omega, a"""
    Omega, A, alpha, g = s.skew(), s.unit(), s.scalar(), s.rotation()
    twice = alpha * pairing(Omega, Omega) + (1 - alpha) * dot(act(Omega, A), act(Omega, A))
    yield pairing(Omega, _inertia(Omega, A, alpha)), twice
    omega, a = g @ Omega @ g.T, act(g, A)
    yield twice, alpha * pairing(omega, omega) + (1 - alpha) * dot(act(omega, a), act(omega, a))


@stated("inertia-inverse", "Section 5, (mTL Legendre inv interm) and the inverse")
def inertia_inverse(s: Setting) -> Sides:
    """MA = Omega A; Omega = M/alpha + ((1 - alpha)/alpha) A ^ (MA), |A| = 1"""
    Omega, A, alpha = s.skew(), s.unit(), s.scalar()
    M = _inertia(Omega, A, alpha)
    yield act(M, A), act(Omega, A)
    yield Omega, M / alpha + (1 - alpha) / alpha * wedge(A, act(M, A))


@stated("proposition-5.1", "Section 5, Proposition 5.1")
def proposition_5_1(s: Setting) -> Sides:
    """for any rates (M', P'), L' - [L, U] has the entries of (M', P') less (mLT left), so that it vanishes if and only if they hold"""
    M, P, A, alpha, dM, dP = s.skew(), s.vector(), s.unit(), s.scalar(), s.skew(), s.vector()
    Omega = lagrange_top_moving.velocity(M, P, A=A, alpha=alpha)
    L, U = border(M, s.lam * A - P / s.lam), border(Omega, s.lam * A)
    off = dM - bracket(M, Omega) - wedge(A, P), dP + act(Omega, P)
    yield border(dM, -dP / s.lam) - bracket(L, U), border(off[0], -off[1] / s.lam)


@stated("rest-frame-equations", "Section 5, (mLT right Ham red) to (mLT right)")
def rest_frame_equations(s: Setting) -> Sides:
    """grad_a L = -(1 - alpha) omega^2 a - p; m; ma = omega a; [omega, m] - (1 - alpha)(omega^2 a) ^ a = 0: m' = a ^ p for every alpha"""
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


@stated("rest-frame-momentum", "Section 5, after (mLT right)")
def rest_frame_momentum(s: Setting) -> Sides:
    """m = g M g^-1 for M = J(Omega), omega = g Omega g^-1, a = gA"""
    Omega, A, g, alpha = s.skew(), s.unit(), s.rotation(), s.scalar()
    yield g @ _inertia(Omega, A, alpha) @ g.T, _inertia(g @ Omega @ g.T, act(g, A), alpha)


stated_law(
    "rest-frame-hamiltonian",
    "Section 5, (mLT right), (en LP r br 1, 2), Hamilton function",
    "m' = a ^ p, a' = ma is z' = {H, z} with H = <m, m>/2 + <a, p> and the minus bracket",
    TOP,
    ("hamiltonian-flow", "jacobi-identity", "casimirs"),
)


@stated("proposition-5.2", "Section 5, Proposition 5.2")
def proposition_5_2(s: Setting) -> Sides:
    """for any rates (m', a'), l' - [l, u] has the entries of (m', a') less (mLT right), so that it vanishes if and only if they hold"""
    m, a, p, dm, da = s.skew(), s.vector(), s.vector(), s.skew(), s.vector()
    l, u = border(m, s.lam * a - p / s.lam), border(0 * m, s.lam * a)  # noqa: E741 - the paper's letter
    yield border(dm, s.lam * da) - bracket(l, u), border(dm - wedge(a, p), s.lam * (da - act(m, a)))


@stated("cartan-twist", "Sections 5 and 6, the loop algebra twisted by the Cartan automorphism", "E2")
def cartan_twist(s: Setting) -> Sides:
    """-L(lambda)^T = L(-lambda), and so for U, l, u, l_k, L_k; V_k(-lambda) V_k(lambda)^T = 1 in both frames (with the printed U it fails, E2)"""
    for system in (TOP, MOVING):
        assert system.map is not None
        case = s.case(system)
        for function in (system.lax, system.map.lax):
            here, there = case.call(function), case.call(function, lam=-case.lam)
            for X, Y in zip(*((z if isinstance(z, tuple) else (z,)) for z in (here, there)), strict=True):
                yield -X.T, Y
        yield from _twisted(case, system.map.conjugator)


def _twisted(case: Case, conjugator: Any) -> Sides:
    V, turned = case.call(conjugator), case.call(conjugator, lam=-case.lam)
    yield turned @ V.T, identity(len(V)) + 0 * V


@printed("cartan-twist")
def cartan_twist_printed(s: Setting) -> Sides:
    from kreisel.lab.paper.discrete_top import printed_conjugator

    yield from _twisted(s.case(MOVING), printed_conjugator)
