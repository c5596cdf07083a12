"""Sections 1, 4 and 5: the heavy top and the Lagrange top."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array, act, bracket, dot, identity, pairing, triangle, wedge
from kreisel.algebra.matrices import border, diagonal
from kreisel.lab.exact import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.calculus import gradient, outer
from kreisel.lab.paper.setting import Diagonal, Eps, Lam, Rotation, Scalar, Setting, Skew, Symmetric, Unit, Vector
from kreisel.lab.paper.statements import stated, stated_laws
from kreisel.system import lagrange_top, lagrange_top_moving, symmetric_top

LAWS = {
    "symmetric-top": {
        ("introduction-top-flow", "Section 1, first display, left"): (
            "M' = A ^ P, P' = -MP is Hamiltonian on e*(n)",
            "hamiltonian-flow",
        ),
        ("introduction-top-map", "Section 1, first display, right"): (
            "M_(k+1) = M_k + eps A ^ P_k, P_(k+1) = cay(-eps/2 M_(k+1)) P_k is Poisson, conserves its energy and has a Lax pair",
            "poisson integrals-of-the-map discrete-lax-equation",
        ),
    },
    "heavy-top": {
        ("heavy-top-hamiltonian", "Section 4, Hamilton function and brackets"): (
            "(mLT left) is z' = {H, z} with H = <M, Omega>/2 + <P, A>; the bracket satisfies Jacobi's identity",
            "hamiltonian-flow jacobi-identity casimirs",
        ),
    },
    "lagrange-top": {
        ("rest-frame-hamiltonian", "Section 5, (mLT right), (en LP r br 1, 2), Hamilton function"): (
            "m' = a ^ p, a' = ma is z' = {H, z} with H = <m, m>/2 + <a, p> and the minus bracket",
            "hamiltonian-flow jacobi-identity casimirs",
        ),
    },
}
stated_laws(LAWS)

# -- section 1 ----------------------------------------------------------------------------------------


@stated("introduction-frames", "Section 1, first display")
def introduction_frames(e: Eps, M: Skew, P: Vector, A: Unit, g: Rotation, alpha: Scalar) -> Sides:
    """(m, a, p) = (-M, P, A) carries flow and map to those of the rest frame; there (g M g^T)' = a ^ p, (gA)' = ma for the top of any alpha"""
    for mine, theirs in (
        (symmetric_top.flow(M, P, A=A), lagrange_top.flow(-M, P, p=A)),
        (symmetric_top.MAP.step(M, P, A=A, eps=e), lagrange_top.MAP.step(-M, P, p=A, eps=e)),
    ):
        yield from zip((-mine[0], mine[1]), theirs, strict=True)
    Omega = lagrange_top_moving.inverse_inertia(M, A=A, alpha=alpha)
    dM, dP = lagrange_top_moving.flow(M, P, A=A, alpha=alpha)
    m, a, p = g @ M @ g.T, act(g, A), act(g, P)
    rates = g @ (dM + bracket(Omega, M)) @ g.T, act(g @ Omega, A)
    yield from zip(rates, lagrange_top.flow(m, a, p=p), strict=True)
    yield dP, -act(Omega, P)


@stated("introduction-adjoint", "Sections 1 and 6.2", printed={"step": lagrange_top_moving.step})
def introduction_adjoint(M: Skew, P: Vector, A: Vector, e: Eps, step: Any = lagrange_top_moving.MAP.adjoint) -> Sides:
    """the Introduction's map is the adjoint of section 6.2's at alpha = 1, not the same (E13)"""
    yield from zip(symmetric_top.MAP.step(M, P, A=A, eps=e), step(M, P, A=A, alpha=1 + 0 * A[0], eps=e), strict=True)


# -- section 4 ----------------------------------------------------------------------------------------


@stated("body-frame", "Section 4, the body frame and (mLT Lagr 1)", printed={"turned": True})
def body_frame(s: Setting, g: Rotation, Omega: Skew, turned: bool = False) -> Sides:
    """e_k(t) = g(t) e_k(0): the kinetic energy of point masses is -tr(Omega J Omega)/2, J = sum m x x^T (E8)"""
    t = generator(0, 1 + 0 * s.scalar())
    masses, places = [abs(s.scalar()) for _ in range(s.n + 1)], [s.vector() for _ in range(s.n + 1)]
    moving = g @ (identity(s.n) + Omega * t)
    speeds = [coefficient(act(moving.T if turned else moving, X), 1) for X in places]
    energy = sum(mass * dot(v, v) / 2 for mass, v in zip(masses, speeds, strict=True))
    J = sum(mass * outer(X) for mass, X in zip(masses, places, strict=True))
    yield energy, -np.trace(Omega @ J @ Omega) / 2


@stated("heavy-top-lagrangian", "Section 4, (mLT Lagr 2)")
def heavy_lagrangian(J: Symmetric, Omega: Skew, g: Rotation, p: Vector, A: Vector) -> Sides:
    """-tr(Omega J Omega) = <Omega, J Omega + Omega J>; <p, a> = <P, A>"""
    yield -np.trace(Omega @ J @ Omega), pairing(Omega, J @ Omega + Omega @ J)
    yield dot(p, act(g, A)), dot(act(g.T, p), A)


@stated("heavy-top-momentum", "Section 4, the momentum")
def heavy_momentum(J: Diagonal, Omega: Skew) -> Sides:
    """M = grad_Omega L = J Omega + Omega J <=> M_jk = (J_j + J_k) Omega_jk"""
    D = diagonal(J)
    M = gradient(lambda x: pairing(x, D @ x + x @ D) / 2, Omega)
    yield M, D @ Omega + Omega @ D
    yield M, (J[:, None] + J[None, :]) * Omega


@stated("heavy-top-equations", "Section 4, (mLT left)")
def heavy_equations(M: Skew, Omega: Skew, P: Vector, A: Vector) -> Sides:
    """ad*_Omega M + grad_P L <> P = [M, Omega] + A ^ P for L = ... - <P, A>"""
    force = gradient(lambda x: -dot(x, A), P)
    yield bracket(M, Omega) + wedge(P, force), bracket(M, Omega) + wedge(A, P)


@stated("heavy-top-energy", "Section 4, Hamilton function")
def heavy_energy(J: Diagonal, Omega: Skew) -> Sides:
    """<M, Omega>/2 = (1/2) sum_(j<k) M_jk^2/(J_j + J_k)"""
    M = (J[:, None] + J[None, :]) * Omega
    j, k = triangle(len(J))
    yield pairing(M, Omega) / 2, (M[j, k] ** 2 / (J[j] + J[k])).sum() / 2


# -- section 5 ----------------------------------------------------------------------------------------


def _inertia(Omega: Array, A: Array, alpha: Any) -> Array:  # (mLT operator inv1), |A| = 1
    return alpha * Omega + (1 - alpha) * (Omega @ outer(A) + outer(A) @ Omega)


@stated("inertia-operator", "Section 5, action of J")
def inertia_operator(s: Setting, alpha: Scalar, Omega: Skew) -> Sides:
    """J_1 = ... = alpha/2, J_n = 1 - alpha/2: M_ij = alpha Omega_ij, M_in = Omega_in"""
    J = np.array([alpha / 2] * (s.n - 1) + [1 - alpha / 2])
    expected = alpha * Omega
    expected[-1], expected[:, -1] = Omega[-1], Omega[:, -1]
    yield J[:, None] * Omega + Omega * J, expected
    e = identity(s.n)[-1] + 0 * s.vector()
    yield _inertia(Omega, e, alpha), expected


@stated("inertia-invariant", "Section 5, (mLT operator inv1, inv2)")
def inertia_invariant(Omega: Skew, A: Vector, alpha: Scalar) -> Sides:
    """alpha Omega + (1 - alpha)(Omega AA^T + AA^T Omega) = alpha Omega - (1 - alpha) A ^ (Omega A)"""
    yield _inertia(Omega, A, alpha), alpha * Omega - (1 - alpha) * wedge(A, act(Omega, A))


@stated("lagrange-top-lagrangian", "Section 5, (mLT Lagr 3) and (mLT Lagr 4)")
def lagrange_lagrangian(Omega: Skew, A: Unit, alpha: Scalar, g: Rotation) -> Sides:
    """<Omega, J(Omega)> = alpha <Omega, Omega> + (1 - alpha)|Omega A|^2, and the same with omega, a"""
    twice = alpha * pairing(Omega, Omega) + (1 - alpha) * dot(act(Omega, A), act(Omega, A))
    yield pairing(Omega, _inertia(Omega, A, alpha)), twice
    omega, a = g @ Omega @ g.T, act(g, A)
    yield twice, alpha * pairing(omega, omega) + (1 - alpha) * dot(act(omega, a), act(omega, a))


@stated("inertia-inverse", "Section 5, (mTL Legendre inv interm) and the inverse")
def inertia_inverse(Omega: Skew, A: Unit, alpha: Scalar) -> Sides:
    """MA = Omega A; Omega = M/alpha + ((1 - alpha)/alpha) A ^ (MA), |A| = 1"""
    M = _inertia(Omega, A, alpha)
    yield act(M, A), act(Omega, A)
    yield Omega, M / alpha + (1 - alpha) / alpha * wedge(A, act(M, A))


@stated("proposition-5.1", "Section 5, Proposition 5.1")
def proposition_5_1(lam: Lam, M: Skew, P: Vector, A: Unit, alpha: Scalar, dM: Skew, dP: Vector) -> Sides:
    """for any rates (M', P'), L' - [L, U] has the entries of (M', P') less (mLT left), so that it vanishes if and only if they hold"""
    Omega = lagrange_top_moving.inverse_inertia(M, A=A, alpha=alpha)
    L, U = border(M, lam * A - P / lam), border(Omega, lam * A)
    off = dM - bracket(M, Omega) - wedge(A, P), dP + act(Omega, P)
    yield border(dM, -dP / lam) - bracket(L, U), border(off[0], -off[1] / lam)


@stated("rest-frame-equations", "Section 5, (mLT right Ham red) to (mLT right)")
def rest_frame_equations(omega: Skew, a: Unit, p: Vector, alpha: Scalar) -> Sides:
    """grad_a L = -(1 - alpha) omega^2 a - p; m; ma = omega a; [omega, m] - (1 - alpha)(omega^2 a) ^ a = 0: m' = a ^ p for every alpha"""

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
def rest_frame_momentum(Omega: Skew, A: Unit, g: Rotation, alpha: Scalar) -> Sides:
    """m = g M g^-1 for M = J(Omega), omega = g Omega g^-1, a = gA"""
    yield g @ _inertia(Omega, A, alpha) @ g.T, _inertia(g @ Omega @ g.T, act(g, A), alpha)


@stated("proposition-5.2", "Section 5, Proposition 5.2")
def proposition_5_2(lam: Lam, m: Skew, a: Vector, p: Vector, dm: Skew, da: Vector) -> Sides:
    """for any rates (m', a'), l' - [l, u] has the entries of (m', a') less (mLT right), so that it vanishes if and only if they hold"""
    l, u = border(m, lam * a - p / lam), border(0 * m, lam * a)  # noqa: E741 - the paper's letter
    yield border(dm, lam * da) - bracket(l, u), border(dm - wedge(a, p), lam * (da - act(m, a)))
