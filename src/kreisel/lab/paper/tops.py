"""Sections 1, 4, 5 and 6: the heavy top, the Lagrange top, and the discrete one in both frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array, act, bracket, cayley, cayley_act, dot, identity, log, moebius, pairing, solve, wedge
from kreisel.algebra.invariants import border, diagonal
from kreisel.algebra.rotations import triangle
from kreisel.lab.exact import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper import setting, statements
from kreisel.lab.paper.setting import Curve, Diagonal, Eps, Lam, Rotation, Scalar, Setting, Skew, Unit, Vector
from kreisel.lab.paper.statements import (
    gradient,
    half,
    left_derivative,
    printed_law,
    right_derivative,
    series,
    stated,
    stated_laws,
    trace_log_of,
)
from kreisel.system import lagrange_top, lagrange_top_moving, symmetric_top
from kreisel.system.clebsch_body import outer

TOP, MOVING = lagrange_top.SYSTEM, lagrange_top_moving.SYSTEM
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
        ("introduction-frames", "Section 1, first display"): (
            "(m, a, p) = (-M, P, A) carries flow and map to those of the rest frame",
            "relations",
        ),
    },
    "heavy-top": {
        ("heavy-top-hamiltonian", "Section 4, Hamilton function and brackets"): (
            "(mLT left) is z' = {H, z} with H = <M, Omega>/2 + <P, A>; the bracket satisfies Jacobi's identity",
            "hamiltonian-flow jacobi-identity casimirs",
        )
    },
    "lagrange-top": {
        ("introduction-any-top", "Section 1, first display"): (
            "in the rest frame (g M g^T)' = a ^ p, (gA)' = ma for the top of any alpha; its map is the adjoint of the moving frame's",
            "relations",
        ),
        ("rest-frame-hamiltonian", "Section 5, (mLT right), (en LP r br 1, 2), Hamilton function"): (
            "m' = a ^ p, a' = ma is z' = {H, z} with H = <m, m>/2 + <a, p> and the minus bracket",
            "hamiltonian-flow jacobi-identity casimirs",
        ),
        ("theorem-6.1", "Section 6.1, Theorem 6.1, (dLT rest frame), (dLT rest H)"): (
            "the discrete Euler-Lagrange equations of (dmLT Lagr 1) are the map; it is Poisson and conserves H_eps, any |a|",
            "discrete-euler-lagrange poisson integrals-of-the-map",
        ),
        ("theorem-6.2", "Section 6.1, Theorem 6.2, (dmLT rest Lax), (bk)"): (
            "l_(k+1) v_k = v_k l_(k+1) ... : v_k l_(k+1) = l_k v_k with b_k = (I - eps/2 m_k) a_k + (eps^2/4)|a|^2 p (E11)",
            "discrete-lax-equation",
        ),
        ("length-of-a", "Section 6.1, (dmLT Lagr 1) for |a| not 1"): (
            "with |A|^2 + <a_k, a_(k+1)> for 1 + <a_k, a_(k+1)> the discrete Lagrangian holds for any |a|, alpha not 1 (E11)",
            "discrete-euler-lagrange",
        ),
        ("rest-limit", "Section 6.1, continuous limit"): (
            "(step - 1)/eps -> (mLT right), deformed integrals -> integrals; the error of the map is O(dt), of its conjugate O(dt^2)",
            "continuous-limit order",
        ),
        ("rest-involution", "Section 6.1, after Theorem 6.2"): (
            "the coefficients of det(l_k(lambda) - mu) are integrals in involution",
            "integrals-of-the-map involution",
        ),
    },
    "lagrange-top-moving": {
        ("theorem-6.3", "Section 6.2, Theorem 6.3, (dmLT body), Hbar_eps"): (
            "the discrete Euler-Lagrange equations of (dmLT Lagr body) are the map; it is Poisson and conserves Hbar_eps",
            "discrete-euler-lagrange poisson integrals-of-the-map involution",
        ),
        ("theorem-6.4", "Section 6.2, Theorem 6.4"): (
            "V_k L_(k+1) = L_k V_k with U = [[0, lambda A], [+lambda A^T, 0]] (E2)",
            "discrete-lax-equation",
        ),
        ("moving-limit", "Section 6.2, proof of Theorem 6.3"): (
            "(dmLT body) approximates (mLT left); the error of the map is O(dt), of its conjugate O(dt^2)",
            "continuous-limit order",
        ),
    },
}
stated_laws(LAWS)


# -- section 1 ----------------------------------------------------------------------------------------


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
def heavy_lagrangian(J: setting.Symmetric, Omega: Skew, g: Rotation, p: Vector, A: Vector) -> Sides:
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


def momentum(w: Array, a: Array, alpha: Any, eps: Any) -> Array:
    """(dLT m expr), and with W, A (dmLT W thru M), |a| = 1."""
    wa = act(w, a)
    return 2 * alpha / eps * half(w) - 2 * (1 - alpha) / eps * wedge(a, wa) / (1 + dot(a, wa))


def kinetic(w: Array, a: Array, alpha: Any) -> Any:
    """eps times the kinetic part of (dmLT Lagr 1) and (dmLT Lagr body), |a| = 1."""
    return -alpha * trace_log_of(w) - 2 * (1 - alpha) * log(1 + dot(a, act(w, a)))


def turned(w: Array, a: Array, alpha: Any, eps: Any) -> Sides:
    """(eps/2) m wa and (eps/2) m a, and their sum wa - a."""
    m, wa, h = momentum(w, a, alpha, eps), act(w, a), half(w)
    c = dot(a, wa)
    yield eps / 2 * act(m, wa), alpha * act(h, wa) - (1 - alpha) * (a - wa * c) / (1 + c)
    yield eps / 2 * act(m, a), alpha * act(h, a) - (1 - alpha) * (a * c - wa) / (1 + c)
    yield eps / 2 * act(m, wa + a), wa - a


# -- section 6, the Lemma -----------------------------------------------------------------------------


@stated("lemma-6.1", "Section 6.1, Lemma 6.1, (tr as)")
def lemma_trace(curve: Curve) -> Sides:
    """tr log(2I + w + w^-1) = const - (eps^2/2) <omega, omega> + O(eps^3) for w = I + eps omega + O(eps^2)"""
    w, omega, _ = curve
    yield series(trace_log_of(w))[1:], [0, -pairing(omega, omega) / 2]


@stated("lemma-6.1-product", "Section 6.1, Lemma 6.1, (scalpr as)")
def lemma_product(curve: Curve, a: Vector) -> Sides:
    """<a, wa> = <a, a> - (eps^2/2) |omega a|^2 + O(eps^3)"""
    w, omega, _ = curve
    yield series(dot(a, act(w, a))), [dot(a, a), 0, -dot(act(omega, a), act(omega, a)) / 2]


@stated("lemma-6.1-proof", "Section 6.1, (lemma aux)")
def lemma_proof(s: Setting, curve: Curve) -> Sides:
    """w = I + eps omega + eps^2 v: v + v^T + omega omega^T = 0; 2I + w + w^T = 4I + eps^2 omega^2 + O(eps^3)"""
    w, omega, _ = curve
    v = series(w)[2]
    yield v + v.T + omega @ omega.T, 0 * omega
    even = series(2 * identity(s.n) + w + w.T)
    yield even, np.array([4 * identity(s.n) + 0 * omega, 0 * omega, omega @ omega])


# -- section 6.1 --------------------------------------------------------------------------------------


@stated("continuous-limit", "Section 3, end, and section 6.1, (dmLT Lagr 1)", printed={"constant": False})
def expanded_lagrangian(
    curve: Curve, a: Unit, p: Vector, alpha: Scalar, constant: bool = True, moving: bool = False
) -> Sides:
    """eps (discrete Lagrangian - constant) = eps^2 (mLT Lagr 4) + O(eps^3), |a| = 1 (E15: the constant is not 0)"""
    w, omega, e = curve
    start = kinetic(identity(len(a)) + 0 * omega + 0 * omega * e, a, alpha) if constant else 0
    times_eps = kinetic(w, a, alpha) - e * e * dot(p, act(w, a) if moving else a) - start
    limit = alpha * pairing(omega, omega) / 2 + (1 - alpha) * dot(act(omega, a), act(omega, a)) / 2 - dot(p, a)
    yield series(times_eps), [0, 0, limit]


@stated("deriv-aux1", "Section 6.1, (deriv aux1)", printed={"inverse": False})
def deriv_aux1(s: Setting, w: Rotation, eta: Skew, inverse: bool = True) -> Sides:
    """d_w tr log(2I + w + w^-1) = -2 (w - I)/(w + I); the middle of its proof with (2I + w + w^-1)^-1 (E4)"""
    yield left_derivative(trace_log_of, w), -2 * half(w)
    yield right_derivative(trace_log_of, w), -2 * half(w)
    even = 2 * identity(s.n) + w + w.T
    inner = solve(even, w - w.T) if inverse else even @ (w - w.T)
    yield np.trace(inner @ eta), -2 * pairing(half(w), eta)


@stated("deriv-aux2", "Section 6.1, (deriv aux2)")
def deriv_aux2(w: Rotation, a: Vector) -> Sides:
    """d_w <a, wa> = a ^ (wa); grad_a <a, wa> = wa + w^T a"""
    yield left_derivative(lambda x: dot(a, act(x, a + 0 * x[0])), w), wedge(a, act(w, a))
    yield gradient(lambda v: dot(v, act(w + 0 * v, v)), a), act(w, a) + act(w.T, a)


@stated("dlt-momentum", "Section 6.1, (dLT m expr)")
def dlt_momentum(w: Rotation, a: Unit, alpha: Scalar, e: Eps) -> Sides:
    """m_(k+1) = d_w Lambda = (2 alpha/eps)(w - I)/(w + I) - (2(1 - alpha)/eps) a_k ^ a_(k+1)/(1 + <a_k, a_(k+1)>)"""
    yield left_derivative(lambda x: kinetic(x, a + 0 * x[0], alpha) / e, w), momentum(w, a, alpha, e)


@stated("dlt-kick", "Section 6.1, after (dLT m expr)")
def dlt_kick(w: Rotation, a: Unit, p: Vector, alpha: Scalar, e: Eps) -> Sides:
    """w^-1 m_(k+1) w + a_k ^ grad_a Lambda = m_(k+1) - eps a_k ^ p, so m_(k+1) = m_k + eps a_k ^ p"""
    a1, m1 = act(w, a), momentum(w, a, alpha, e)
    force = -2 * (1 - alpha) / e * (a1 + act(w.T, a)) / (1 + dot(a, a1)) - e * p
    yield gradient(lambda v: kinetic(w + 0 * v, v, alpha) / e - e * dot(p, v), a), force
    yield w.T @ m1 @ w + wedge(a, force), m1 - e * wedge(a, p)


@stated("dlt-turn", "Section 6.1, proof of the second equation")
def dlt_turn(w: Rotation, a: Unit, alpha: Scalar, e: Eps) -> Sides:
    """the two displays for (eps/2) m_(k+1) a_(k+1), (eps/2) m_(k+1) a_k, and their sum a_(k+1) - a_k"""
    yield from turned(w, a, alpha, e)


def unnormalised(g: Array, h: Array, A: Array, *, p: Array, alpha: Any, eps: Any) -> Any:
    """(dmLT Lagr 1) as printed."""
    a = act(g, A)
    return kinetic(h @ g.T, a, alpha) / eps - eps * dot(p, a)


printed_law("length-of-a", TOP, "discrete-euler-lagrange", lagrangian=unnormalised)


@stated("pairing-identity", "Section 6.1, proof of (dLT rest H)")
def pairing_identity(m: Skew, a: Vector, p: Vector) -> Sides:
    """<ma, p> = <m, p ^ a>"""
    yield dot(act(m, a), p), pairing(m, wedge(p, a))


@stated("rest-energy-chain", "Section 6.1, last display of the proof")
def rest_energy_chain(m: Skew, a: Vector, p: Vector, e: Eps) -> Sides:
    """H_eps(m_(k+1), a_(k+1)) through its five forms to H_eps(m_k, a_k)"""
    m1, a1 = lagrange_top.MAP.step(m, a, p=p, eps=e)
    last = lagrange_top.energy(m, a, p=p, eps=e)
    yield lagrange_top.energy(m1, a1, p=p, eps=e), pairing(m1, m1) / 2 + dot(a1 - e / 2 * act(m1, a1), p)
    yield pairing(m1, m1) / 2 + dot(a + e / 2 * act(m1, a), p), last
    yield pairing(m1, m1 + e * wedge(p, a)) / 2 + dot(a, p), last
    yield pairing(m - e * wedge(p, a), m) / 2 + dot(a, p), last


def printed_b(m: Array, a: Array, *, p: Array, eps: Any = 0) -> Array:
    """(bk) as printed: (eps^2/4) p whatever |a|."""
    return a - eps * act(m, a) / 2 + eps * eps * p / 4


def printed_lax(m: Array, a: Array, *, p: Array, lam: Any, eps: Any) -> Array:
    """The Lax matrix with (bk) as printed."""
    return border(m, lam * printed_b(m, a, p=p, eps=eps) - p / lam)


printed_law("theorem-6.2", TOP, "discrete-lax-equation", lax=printed_lax)


@stated("rest-lax-polynomial", "Section 6.1, proof of Theorem 6.2")
def rest_lax_polynomial(m: Skew, a: Unit, p: Vector, e: Eps, lam: Lam) -> Sides:
    """(I + eps/2 u) l_(k+1) (I - eps/2 u) = (I - eps/2 u) l_k (I + eps/2 u); with |a| = 1 as printed"""
    m1, a1 = lagrange_top.MAP.step(m, a, p=p, eps=e)
    u, unit = border(0 * m, lam * a), identity(len(a) + 1)
    old, new = (printed_lax(*z, p=p, lam=lam, eps=e) for z in ((m, a), (m1, a1)))
    yield (unit + e / 2 * u) @ new @ (unit - e / 2 * u), (unit - e / 2 * u) @ old @ (unit + e / 2 * u)


@stated("integrals-differ", "Section 6.1, after Theorem 6.2", ranks=True)
def integrals_differ(s: Setting, m: Skew, a: Vector, p: Vector, e: Eps) -> Sides:
    """the integrals are those of the flow with b for a, and do not coincide with them: the rank of both is 3, 5, 6, 8 on the leaf, of each 2, 3, 4, 5"""
    b = lagrange_top.shifted(m, a, p=p, eps=e)
    yield lagrange_top.spectrum(m, a, p=p, eps=e), lagrange_top.spectrum(m, b, p=p)
    sets = [lambda m, a, eps=eps: lagrange_top.spectrum(m, a, p=p, eps=eps) for eps in (0 * e, e)]
    ranks = [statements.rank_on_leaf(TOP, (m, a), chosen) for chosen in ([sets[0]], [sets[1]], sets)]
    yield ranks, [statements.SPECTRAL_RANK[s.n]] * 2 + [{3: 3, 4: 5, 5: 6, 6: 8}[s.n]]


@stated(
    "rest-completeness",
    "Section 6.1, after Theorem 6.2",
    printed={"ranks": statements.HALF_LEAF},
    ranks=True,
    misprinted=(4, 5, 6),
)
def rest_completeness(s: Setting, ranks: dict[int, int] = statements.SPECTRAL_RANK) -> Sides:
    """the spectrum has rank 2, 3, 4, 5 on the leaf for n = 3...6, with pi m pi 2, 5, 8, 13: complete only with it if n > 3 (E12)"""
    case = s.case(TOP)
    yield statements.leaf_rank(case, ("spectrum",)), ranks[s.n]
    yield statements.leaf_rank(case, ("spectrum", "noether")), 2 * statements.HALF_LEAF[s.n] - (s.n - 1)


# -- section 6.2, the moving frame -----------------------------------------------------------------


@stated("moving-lagrangian", "Section 6.2, (dmLT Lagr body)")
def moving_lagrangian(s: Setting, A: Unit, p: Vector, alpha: Scalar, e: Eps) -> Sides:
    """<p, a_(k+1)> for <p, a_k> leaves the variation of the sum over k unchanged; in P_k, W_k it is (dmLT Lagr body)"""
    g0, g1, g2 = (s.rotation() for _ in range(3))

    def varied(action: Any) -> Array:
        return right_derivative(lambda g: action(g0 + 0 * g, g) + action(g, g2 + 0 * g), g1)

    body = varied(lambda g, h: lagrange_top_moving.lagrangian(g, h, p, A=A, alpha=alpha, eps=e))
    yield varied(lambda g, h: lagrange_top.lagrangian(g, h, A, p=p, alpha=alpha, eps=e)), body
    yield varied(lambda g, h: kinetic(g.T @ h, A, alpha) / e - e * dot(act(g.T, p), act(g.T @ h, A))), body


@stated("moving-discrete-limit", "Section 6.2, after (dmLT Lagr body)", printed={"constant": False})
def moving_discrete_limit(curve: Curve, a: Unit, p: Vector, alpha: Scalar, constant: bool = True) -> Sides:
    """eps (Lambda(P, W) - constant) = eps^2 L(P, Omega) + O(eps^3), W = I + eps Omega + ..., |A| = 1 (E15: the constant is not 0)"""
    yield from expanded_lagrangian(curve, a, p, alpha, constant, moving=True)


@stated("moving-backwards", "Section 6.2, the modified Lagrange function")
def moving_backwards(A: Unit, p: Vector, alpha: Scalar, e: Eps, g: Rotation, h: Rotation) -> Sides:
    """it is minus (dmLT Lagr 1) with w^-1, a_(k+1), -eps for w, a_k, eps, any alpha, so that its map is the inverse of the rest frame's with -eps (introduction-any-top)"""

    def modified(x: Array, y: Array) -> Any:
        return lagrange_top_moving.lagrangian(x, y, p, A=A, alpha=alpha, eps=e)

    def backwards(x: Array, y: Array) -> Any:
        return -lagrange_top.lagrangian(y, x, A, p=p, alpha=alpha, eps=-e)

    for move in (lambda f: lambda x: f(x, h + 0 * x), lambda f: lambda x: f(h + 0 * x, x)):
        yield right_derivative(move(modified), g), right_derivative(move(backwards), g)


@stated("moving-legendre", "Section 6.2, (dmLT W thru M)")
def moving_legendre(W: Rotation, A: Unit, P: Vector, alpha: Scalar, e: Eps) -> Sides:
    """M_k = -d'_1 of the discrete Lagrangian; its inverse W = cay(X), X = eps M/(2 alpha) + ((1 - alpha)/alpha) A ^ y/<A, y>, y = (I - eps/2 M)^-1 A"""

    def lagrangian(g: Array) -> Any:  # L(g_k, g_(k+1)) with g_(k+1) = W fixed and g_k near 1
        return lagrange_top_moving.lagrangian(g, W + 0 * g, P, A=A, alpha=alpha, eps=e)

    M = momentum(W, A, alpha, e)
    yield -right_derivative(lagrangian, identity(len(A)) + 0 * W), M
    yield cayley(lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=e)), W


@stated("moving-legendre-isotropic", "Section 6.2, alpha = 1")
def moving_legendre_isotropic(W: Rotation) -> Sides:
    """M_k = (2/eps)(W - I)/(W + I) => W = cay(eps/2 M_k)"""
    yield cayley(half(W)), W


@stated("moving-turn", "Section 6.2, (dmTL Legendre inv interm)")
def moving_turn(W: Rotation, A: Unit, alpha: Scalar, e: Eps) -> Sides:
    """W_k A = cay(eps/2 M_k) A, by the two displays for (eps/2) M_k A and (eps/2) M_k W_k A"""
    yield from turned(W, A, alpha, e)
    yield cayley_act(e / 2 * momentum(W, A, alpha, e), A), act(W, A)


@stated("moving-energy-chain", "Section 6.2, last display of the proof")
def moving_energy_chain(W: Rotation, A: Unit, P: Vector, alpha: Scalar, e: Eps) -> Sides:
    """Hbar_eps(M_(k+1), P_(k+1)) through its six forms to Hbar_eps(M_k, P_k), |A| = 1"""
    M, P1 = momentum(W, A, alpha, e), act(W.T, P)
    N = W.T @ M @ W
    M1 = N + e * wedge(A, P1)
    last = pairing(M, M) / 2 + dot(P, A + e / 2 * act(M, A))
    yield pairing(M1, M1) / 2 + dot(P1, A) + e / 2 * pairing(M1, wedge(P1, A)), last
    yield pairing(M1, M1 + e * wedge(P1, A)) / 2 + dot(P1, A), last
    yield pairing(N - e * wedge(P1, A), N) / 2 + dot(P1, A), last
    yield pairing(M, M) / 2 + dot(P1, A - e / 2 * act(N, A)), last
    yield pairing(M, M) / 2 + dot(P, act(W, A) - e / 2 * act(M, act(W, A))), last


@stated("moving-energy-limit", "Section 6.2, Theorem 6.3, Hbar_eps", printed={"spins": 0})
def moving_energy_limit(M: Skew, P: Vector, A: Unit, alpha: Scalar, spins: int = 1) -> Sides:
    """Hbar_0 + (1/alpha - 1)<M_perp, M_perp>/2 = H of the alpha top, |A| = 1 (E16: only Hbar_0 is H at alpha = 1)"""
    Omega = lagrange_top_moving.inverse_inertia(M, A=A, alpha=alpha)
    Pi = identity(len(A)) - outer(A)
    across = Pi @ M @ Pi
    H = pairing(M, Omega) / 2 + dot(P, A)
    yield pairing(M, M) / 2 + dot(P, A) + spins * (1 / alpha - 1) * pairing(across, across) / 2, H
    yield lagrange_top_moving.energy(M, P, A=A, alpha=alpha), H


def printed_conjugator(M: Array, P: Array, *, A: Array, alpha: Any, lam: Any, eps: Any) -> Array:
    """V_k with -lambda A^T in U, as printed."""
    W = cayley(lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=eps))
    turn = border(W, 0 * P)
    turn[..., -1, -1] = 1
    return turn @ moebius(eps / 2 * border(0 * M, lam * A, -lam * A))


printed_law("theorem-6.4", MOVING, "discrete-lax-equation", conjugator=printed_conjugator)


@stated("moving-completeness", 'Section 6.2, Theorem 6.3, "complete"', ranks=True)
def moving_completeness(s: Setting) -> Sides:
    """rank on the leaf as in the rest frame: complete only with Pi M Pi for n > 3 (E12)"""
    case = s.case(MOVING)
    yield statements.leaf_rank(case, ("spectrum",)), statements.SPECTRAL_RANK[s.n]
    yield statements.leaf_rank(case, ("spectrum", "noether")), 2 * statements.HALF_LEAF[s.n] - s.n + 1


@stated(
    "cartan-twist",
    "Sections 5 and 6, the loop algebra twisted by the Cartan automorphism",
    printed={"conjugator": printed_conjugator},
)
def cartan_twist(s: Setting, conjugator: Any = lagrange_top_moving.conjugator) -> Sides:
    """-L(lambda)^T = L(-lambda), and so for U, l, u, l_k, L_k; V_k(-lambda) V_k(lambda)^T = 1 in both frames (with the printed U it fails, E2)"""
    for system, V in ((TOP, lagrange_top.conjugator), (MOVING, conjugator)):
        case = s.case(system)
        for function in (system.lax, case.map.lax):
            positive, negative = (np.array(case.call(function, lam=sign * case.lam)) for sign in (1, -1))
            yield -positive.mT, negative
        product = case.call(V, lam=-case.lam) @ case.call(V).T
        yield product, identity(len(product)) + 0 * product
