"""Sections 4, 5 and 6: the heavy top, the Lagrange top and its discrete time analog."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import (
    Array,
    act,
    bracket,
    cayley,
    cayley_act,
    dot,
    identity,
    log,
    moebius,
    pairing,
    trace_log,
    triangle,
    wedge,
)
from kreisel.algebra.matrices import border
from kreisel.lab import laws
from kreisel.lab.jets import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.rows import (
    Setting,
    by_law,
    gradient,
    law_row,
    left_derivative,
    printed,
    rank,
    right_derivative,
    row,
)
from kreisel.system import heavy_top, lagrange_top, lagrange_top_moving, symmetric_top

HEAVY, TOP, MOVING = heavy_top.SYSTEM, lagrange_top.SYSTEM, lagrange_top_moving.SYSTEM
SYMMETRIC = symmetric_top.SYSTEM


def outer(x: Array) -> Array:
    """x x^T."""
    return x[..., :, None] * x[..., None, :]


def half(w: Array) -> Array:
    """(w - I)/(w + I), written as in the paper."""
    n = w.shape[-1]
    return algebra.solve((w + identity(n)).T, (w - identity(n)).T).T


def trace_log_of(w: Array) -> Any:
    """Tr log(2I + w + w^-1)."""
    return trace_log(2 * identity(w.shape[-1]) + w + w.T)


# -- section 1 ----------------------------------------------------------------------------------------

law_row(
    "introduction-top-flow",
    "Section 1, first display, left",
    "M' = A ^ P, P' = -MP is Hamiltonian on e*(n)",
    SYMMETRIC,
    "hamiltonian-flow",
)
law_row(
    "introduction-top-map",
    "Section 1, first display, right",
    "M_(k+1) = M_k + eps A ^ P_k, P_(k+1) = cay(-eps/2 M_(k+1)) P_k is Poisson, keeps its energy and has a Lax pair",
    SYMMETRIC,
    "poisson",
    "integrals-of-the-map",
    "discrete-lax-equation",
)


@row(
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


@row(
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


@row(
    "heavy-top-lagrangian",
    "Section 4, (mLT Lagr 2)",
    "-tr(Omega J Omega) = <Omega, J Omega + Omega J>; <p, a> = <P, A>",
)
def heavy_lagrangian(s: Setting) -> Sides:
    J, Omega, g, p, A = s.symmetric(), s.skew(), s.rotation(), s.vector(), s.vector()
    yield -np.trace(Omega @ J @ Omega), pairing(Omega, J @ Omega + Omega @ J)
    yield dot(p, act(g, A)), dot(act(g.T, p), A)


@row(
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


@row(
    "heavy-top-equations",
    "Section 4, (mLT left)",
    "ad*_Omega M + grad_P L <> P = [M, Omega] + A ^ P for L = ... - <P, A>",
)
def heavy_equations(s: Setting) -> Sides:
    M, Omega, P, A = s.skew(), s.skew(), s.vector(), s.vector()
    force = gradient(lambda x: -dot(x, A), P)
    yield bracket(M, Omega) + wedge(P, force), bracket(M, Omega) + wedge(A, P)


law_row(
    "heavy-top-hamiltonian",
    "Section 4, Hamilton function and brackets",
    "(mLT left) is z' = {H, z} with H = <M, Omega>/2 + <P, A>; the bracket satisfies Jacobi's identity",
    HEAVY,
    "hamiltonian-flow",
    "jacobi-identity",
    "casimirs",
)


@row("heavy-top-energy", "Section 4, Hamilton function", "<M, Omega>/2 = (1/2) sum_(j<k) M_jk^2/(J_j + J_k)")
def heavy_energy(s: Setting) -> Sides:
    J, Omega = s.diagonal(), s.skew()
    M = (J[:, None] + J[None, :]) * Omega
    j, k = triangle(s.n)
    yield pairing(M, Omega) / 2, (M[j, k] ** 2 / (J[j] + J[k])).sum() / 2


# -- section 5 ----------------------------------------------------------------------------------------


def _inertia(Omega: Array, A: Array, alpha: Any) -> Array:  # (mLT operator inv1), |A| = 1
    return alpha * Omega + (1 - alpha) * (Omega @ outer(A) + outer(A) @ Omega)


@row(
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


@row(
    "inertia-invariant",
    "Section 5, (mLT operator inv1, inv2)",
    "alpha Omega + (1 - alpha)(Omega AA^T + AA^T Omega) = alpha Omega - (1 - alpha) A ^ (Omega A)",
)
def inertia_invariant(s: Setting) -> Sides:
    Omega, A, alpha = s.skew(), s.vector(), s.scalar()
    yield _inertia(Omega, A, alpha), alpha * Omega - (1 - alpha) * wedge(A, act(Omega, A))


@row(
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


@row(
    "inertia-inverse",
    "Section 5, (mTL Legendre inv interm) and the inverse",
    "MA = Omega A; Omega = M/alpha + ((1 - alpha)/alpha) A ^ (MA), |A| = 1",
)
def inertia_inverse(s: Setting) -> Sides:
    Omega, A, alpha = s.skew(), s.unit(), s.scalar()
    M = _inertia(Omega, A, alpha)
    yield act(M, A), act(Omega, A)
    yield Omega, M / alpha + (1 - alpha) / alpha * wedge(A, act(M, A))


law_row(
    "proposition-5.1",
    "Section 5, Proposition 5.1",
    "L' = [L, U] along (mLT left), moving frame",
    MOVING,
    "lax-equation",
)


@row(
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


@row(
    "rest-frame-momentum", "Section 5, after (mLT right)", "m = g M g^-1 for M = J(Omega), omega = g Omega g^-1, a = gA"
)
def rest_frame_momentum(s: Setting) -> Sides:
    Omega, A, g, alpha = s.skew(), s.unit(), s.rotation(), s.scalar()
    yield g @ _inertia(Omega, A, alpha) @ g.T, _inertia(g @ Omega @ g.T, act(g, A), alpha)


law_row(
    "rest-frame-hamiltonian",
    "Section 5, (mLT right), (en LP r br 1, 2), Hamilton function",
    "m' = a ^ p, a' = ma is z' = {H, z} with H = <m, m>/2 + <a, p> and the minus bracket",
    TOP,
    "hamiltonian-flow",
    "jacobi-identity",
    "casimirs",
)
law_row(
    "proposition-5.2", "Section 5, Proposition 5.2", "l' = [l, u] along (mLT right), rest frame", TOP, "lax-equation"
)

# -- section 6, the Lemma -----------------------------------------------------------------------------


def _curve(s: Setting, order: int) -> tuple[Array, Array, Any]:
    """A curve w(e) = cay(e omega/2 + e^2 u/2) in SO(n), its omega, and e, a step with e^(order + 1) = 0."""
    one = 1 + 0 * s.scalar()
    e = sum(generator(i, one) for i in range(order))
    omega, u = s.skew(), s.skew()
    return cayley(0 * omega + omega * (e / 2) + u * (e * e / 2)), omega, e


def _power(x: Any, k: int) -> Any:
    """The coefficient of e^k, e = x1 + x2 + ...: e^k = k! x1...xk + ..."""
    factorial = int(np.prod(range(1, k + 1)))
    return coefficient(x, (1 << k) - 1) / factorial if k else coefficient(x, 0)


@row(
    "lemma-6.1",
    "Section 6.1, Lemma 6.1, (tr as)",
    "tr log(2I + w + w^-1) = const - (eps^2/2) <omega, omega> + O(eps^3) for w = I + eps omega + O(eps^2)",
)
def lemma_trace(s: Setting) -> Sides:
    w, omega, _ = _curve(s, 2)
    value = trace_log_of(w)
    yield np.asarray(_power(value, 1)), np.asarray(0 * s.scalar())
    yield np.asarray(_power(value, 2)), np.asarray(-pairing(omega, omega) / 2)


@row("lemma-6.1-product", "Section 6.1, Lemma 6.1, (scalpr as)", "<a, wa> = <a, a> - (eps^2/2) |omega a|^2 + O(eps^3)")
def lemma_product(s: Setting) -> Sides:
    w, omega, _ = _curve(s, 2)
    a = s.vector()
    value = dot(a, act(w, a))
    yield np.asarray(_power(value, 0)), dot(a, a)
    yield np.asarray(_power(value, 1)), np.asarray(0 * s.scalar())
    yield np.asarray(_power(value, 2)), -dot(act(omega, a), act(omega, a)) / 2


@row(
    "lemma-6.1-proof",
    "Section 6.1, (lemma aux)",
    "w = I + eps omega + eps^2 v: v + v^T + omega omega^T = 0; 2I + w + w^T = 4I + eps^2 omega^2 + O(eps^3)",
)
def lemma_proof(s: Setting) -> Sides:
    w, omega, _ = _curve(s, 2)
    v = _power(w, 2)
    yield v + v.T + omega @ omega.T, 0 * omega
    even = 2 * identity(s.n) + w + w.T
    yield _power(even, 0), 4 * identity(s.n) + 0 * omega
    yield _power(even, 1), 0 * omega
    yield _power(even, 2), omega @ omega


# -- section 6.1 --------------------------------------------------------------------------------------


def _rest_data(s: Setting) -> tuple[Any, ...]:
    """w, a_k, a_(k+1) = w a_k with |a| = 1, p, alpha, and m_(k+1) of (dLT m expr)."""
    w, a, p, alpha = s.rotation(), s.unit(), s.vector(), abs(s.scalar())
    a1 = act(w, a)
    m1 = 2 * alpha / s.eps * half(w) - 2 * (1 - alpha) / s.eps * wedge(a, a1) / (1 + dot(a, a1))
    return w, a, a1, p, alpha, m1


def _continuous_limit(s: Setting, constant: bool) -> Sides:
    w, omega, e = _curve(s, 2)
    a, p, alpha = s.unit(), s.vector(), abs(s.scalar())

    def kinetic_of(w: Array) -> Any:
        return -alpha * trace_log_of(w) - 2 * (1 - alpha) * log(1 + dot(a, act(w, a)))

    kinetic, start = kinetic_of(w), kinetic_of(identity(s.n) + 0 * omega + 0 * omega * e)
    times_eps = kinetic - e * e * dot(p, a) - (start if constant else 0)
    limit = alpha * pairing(omega, omega) / 2 + (1 - alpha) * dot(act(omega, a), act(omega, a)) / 2 - dot(p, a)
    yield np.asarray(_power(times_eps, 0)), np.asarray(0 * s.scalar())
    yield np.asarray(_power(times_eps, 1)), np.asarray(0 * s.scalar())
    yield np.asarray(_power(times_eps, 2)), np.asarray(limit)


@row(
    "continuous-limit",
    "Section 3, end, and section 6.1, (dmLT Lagr 1)",
    "eps (discrete Lagrangian - constant) = eps^2 (mLT Lagr 4) + O(eps^3), |a| = 1 (E15: the constant is not 0)",
    "E15",
)
def continuous_limit(s: Setting) -> Sides:
    yield from _continuous_limit(s, constant=True)


@printed("continuous-limit")
def continuous_limit_printed(s: Setting) -> Sides:
    yield from _continuous_limit(s, constant=False)


@row(
    "deriv-aux1",
    "Section 6.1, (deriv aux1)",
    "d_w tr log(2I + w + w^-1) = -2 (w - I)/(w + I); the middle of its proof with (2I + w + w^-1)^-1 (E4)",
    "E4",
)
def deriv_aux1(s: Setting) -> Sides:
    w, eta = s.rotation(), s.skew()
    yield left_derivative(trace_log_of, w), -2 * half(w)
    yield right_derivative(trace_log_of, w), -2 * half(w)
    inner = algebra.solve(2 * identity(s.n) + w + w.T, w - w.T)
    yield np.trace(inner @ eta), -2 * pairing(half(w), eta)


@printed("deriv-aux1")
def deriv_aux1_printed(s: Setting) -> Sides:
    w, eta = s.rotation(), s.skew()
    inner = (2 * identity(s.n) + w + w.T) @ (w - w.T)
    yield np.trace(inner @ eta), -2 * pairing(half(w), eta)


@row("deriv-aux2", "Section 6.1, (deriv aux2)", "d_w <a, wa> = a ^ (wa); grad_a <a, wa> = wa + w^T a")
def deriv_aux2(s: Setting) -> Sides:
    w, a = s.rotation(), s.vector()
    yield left_derivative(lambda x: dot(a, act(x, a + 0 * x[0])), w), wedge(a, act(w, a))
    yield gradient(lambda v: dot(v, act(w + 0 * v, v)), a), act(w, a) + act(w.T, a)


@row(
    "dlt-momentum",
    "Section 6.1, (dLT m expr)",
    "m_(k+1) = d_w Lambda = (2 alpha/eps)(w - I)/(w + I) - (2(1 - alpha)/eps) a_k ^ a_(k+1)/(1 + <a_k, a_(k+1)>)",
)
def dlt_momentum(s: Setting) -> Sides:
    w, a, _, p, alpha, m1 = _rest_data(s)
    yield left_derivative(lambda x: _discrete_rest(x, a + 0 * x[0], p, alpha, s.eps), w), m1


def _discrete_rest(w: Array, a: Array, p: Array, alpha: Any, eps: Any) -> Any:  # (dmLT Lagr 1), |a| = 1
    kinetic = -alpha / eps * trace_log_of(w) - 2 * (1 - alpha) / eps * log(1 + dot(a, act(w, a)))
    return kinetic - eps * dot(p, a)


@row(
    "dlt-kick",
    "Section 6.1, after (dLT m expr)",
    "w^-1 m_(k+1) w + a_k ^ grad_a Lambda = m_(k+1) - eps a_k ^ p, so m_(k+1) = m_k + eps a_k ^ p",
)
def dlt_kick(s: Setting) -> Sides:
    w, a, a1, p, alpha, m1 = _rest_data(s)
    force = -2 * (1 - alpha) / s.eps * (a1 + act(w.T, a)) / (1 + dot(a, a1)) - s.eps * p
    yield gradient(lambda v: _discrete_rest(w + 0 * v, v, p, alpha, s.eps), a), force
    yield w.T @ m1 @ w + wedge(a, force), m1 - s.eps * wedge(a, p)


@row(
    "dlt-turn",
    "Section 6.1, proof of the second equation",
    "the two displays for (eps/2) m_(k+1) a_(k+1), (eps/2) m_(k+1) a_k, and their sum a_(k+1) - a_k",
)
def dlt_turn(s: Setting) -> Sides:
    w, a, a1, _, alpha, m1 = _rest_data(s)
    c, h = dot(a, a1), half(w)
    yield s.eps / 2 * act(m1, a1), alpha * act(h, a1) - (1 - alpha) * (a - a1 * c) / (1 + c)
    yield s.eps / 2 * act(m1, a), alpha * act(h, a) - (1 - alpha) * (a * c - a1) / (1 + c)
    yield s.eps / 2 * act(m1, a1 + a), a1 - a


law_row(
    "theorem-6.1",
    "Section 6.1, Theorem 6.1, (dLT rest frame), (dLT rest H)",
    "the discrete Euler-Lagrange equations of (dmLT Lagr 1) are the map; it is Poisson and keeps H_eps, any |a|",
    TOP,
    "discrete-euler-lagrange",
    "poisson",
    "integrals-of-the-map",
)


@row(
    "length-of-a",
    "Section 6.1, (dmLT Lagr 1) for |a| not 1",
    "with |A|^2 + <a_k, a_(k+1)> for 1 + <a_k, a_(k+1)> the discrete Lagrangian holds for any |a|, alpha not 1 (E11)",
    "E11",
)
def length_of_a(s: Setting) -> Sides:
    yield from by_law(TOP, "discrete-euler-lagrange")(s)


def unnormalised(g: Array, h: Array, A: Array, *, p: Array, alpha: Any, eps: Any) -> Any:
    """(dmLT Lagr 1) as printed."""
    a, a1 = act(g, A), act(h, A)
    kinetic = alpha / eps * trace_log_of(h @ g.T)
    return -kinetic - 2 * (1 - alpha) / eps * log(1 + dot(a, a1)) - eps * dot(p, a)


@printed("length-of-a")
def length_of_a_printed(s: Setting) -> Sides:
    assert TOP.map is not None
    yield from by_law(replace(TOP, map=replace(TOP.map, lagrangian=unnormalised)), "discrete-euler-lagrange")(s)


@row("pairing-identity", "Section 6.1, proof of (dLT rest H)", "<ma, p> = <m, p ^ a>")
def pairing_identity(s: Setting) -> Sides:
    m, a, p = s.skew(), s.vector(), s.vector()
    yield dot(act(m, a), p), pairing(m, wedge(p, a))


@row(
    "rest-energy-chain",
    "Section 6.1, last display of the proof",
    "H_eps(m_(k+1), a_(k+1)) through its five forms to H_eps(m_k, a_k)",
)
def rest_energy_chain(s: Setting) -> Sides:
    m, a, p, e = s.skew(), s.vector(), s.vector(), s.eps
    m1, a1 = lagrange_top.step(m, a, p=p, eps=e)
    last = lagrange_top.energy(m, a, p=p, eps=e)
    yield lagrange_top.energy(m1, a1, p=p, eps=e), pairing(m1, m1) / 2 + dot(a1 - e / 2 * act(m1, a1), p)
    yield pairing(m1, m1) / 2 + dot(a + e / 2 * act(m1, a), p), last
    yield pairing(m1, m1 + e * wedge(p, a)) / 2 + dot(a, p), last
    yield pairing(m - e * wedge(p, a), m) / 2 + dot(a, p), last


law_row(
    "theorem-6.2",
    "Section 6.1, Theorem 6.2, (dmLT rest Lax), (bk)",
    "l_(k+1) v_k = v_k l_(k+1) ... : v_k l_(k+1) = l_k v_k with b_k = (I - eps/2 m_k) a_k + (eps^2/4)|a|^2 p (E11)",
    TOP,
    "discrete-lax-equation",
    erratum="E11",
)


def printed_b(m: Array, a: Array, *, p: Array, eps: Any = 0) -> Array:
    """(bk) as printed: (eps^2/4) p whatever |a|."""
    return a - eps * act(m, a) / 2 + eps * eps * p / 4


def printed_lax(m: Array, a: Array, *, p: Array, lam: Any, eps: Any) -> Array:
    """The Lax matrix with (bk) as printed."""
    return border(m, lam * printed_b(m, a, p=p, eps=eps) - p / lam)


@printed("theorem-6.2")
def theorem_6_2_printed(s: Setting) -> Sides:
    assert TOP.map is not None
    yield from by_law(replace(TOP, map=replace(TOP.map, lax=printed_lax)), "discrete-lax-equation")(s)


@row(
    "rest-lax-polynomial",
    "Section 6.1, proof of Theorem 6.2",
    "(I + eps/2 u) l_(k+1) (I - eps/2 u) = (I - eps/2 u) l_k (I + eps/2 u); with |a| = 1 as printed",
)
def rest_lax_polynomial(s: Setting) -> Sides:
    m, a, p, e = s.skew(), s.unit(), s.vector(), s.eps
    m1, a1 = lagrange_top.step(m, a, p=p, eps=e)
    u, one = border(0 * m, s.lam * a), identity(s.n + 1)
    old, new = (printed_lax(*z, p=p, lam=s.lam, eps=e) for z in ((m, a), (m1, a1)))
    yield (one + e / 2 * u) @ new @ (one - e / 2 * u), (one - e / 2 * u) @ old @ (one + e / 2 * u)


law_row(
    "rest-limit",
    "Section 6.1, continuous limit",
    "(step - 1)/eps -> (mLT right), deformed integrals -> integrals; the error of the map is O(dt), of its conjugate O(dt^2)",
    TOP,
    "continuous-limit",
    "order",
    in_rationals=False,
)
law_row(
    "rest-involution",
    "Section 6.1, after Theorem 6.2",
    "the coefficients of det(l_k(lambda) - mu) are integrals in involution",
    TOP,
    "integrals-of-the-map",
    "involution",
)

HALF_LEAF = {3: 2, 4: 4, 5: 6, 6: 9}
SPECTRAL_RANK = {3: 2, 4: 3, 5: 4, 6: 5}


def leaf_rank(case: laws.Case, names: tuple[str, ...]) -> int:
    """The rank on the leaf of the differentials of the energy and the named integrals, at a random rational point."""
    gradients = [case.jacobian(case.system.space.casimirs)[1]]
    casimirs = rank(np.concatenate(gradients))
    for name in ("energy", *names):
        function = case.system.energy if name == "energy" else case.system.integrals[name]
        gradients.append(np.atleast_2d(case.jacobian(function)[1]).reshape(-1, gradients[0].shape[-1]))
    return rank(np.concatenate(gradients)) - casimirs


@row(
    "rest-completeness",
    "Section 6.1, after Theorem 6.2",
    "the spectrum has rank 2, 3, 4, 5 on the leaf for n = 3...6, with pi m pi 2, 5, 8, 13: complete only with it (E12)",
    "E12",
)
def rest_completeness(s: Setting) -> Sides:
    case = laws.make_case(TOP, s.n, "exact", 0)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(SPECTRAL_RANK[s.n])
    dimension, torus = 2 * HALF_LEAF[s.n], s.n - 1
    yield np.asarray(leaf_rank(case, ("spectrum", "noether"))), np.asarray(dimension - torus)


@printed("rest-completeness")
def rest_completeness_printed(s: Setting) -> Sides:
    case = laws.make_case(TOP, s.n, "exact", 0)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(HALF_LEAF[s.n] + (0 if s.n > 3 else 1))


# -- section 6.2 --------------------------------------------------------------------------------------


@row(
    "moving-lagrangian",
    "Section 6.2, (dmLT Lagr body)",
    "<p, a_(k+1)> for <p, a_k> leaves the variation of the sum over k as it is; in P_k, W_k it is (dmLT Lagr body)",
)
def moving_lagrangian(s: Setting) -> Sides:
    A, p, alpha, e = s.unit(), s.vector(), abs(s.scalar()), s.eps
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


def _moving_data(s: Setting) -> tuple[Any, ...]:
    """W, A with |A| = 1, P, alpha, and M_k of (dmLT W thru M)."""
    W, A, P, alpha = s.rotation(), s.unit(), s.vector(), abs(s.scalar())
    WA = act(W, A)
    M = 2 * alpha / s.eps * half(W) - 2 * (1 - alpha) / s.eps * wedge(A, WA) / (1 + dot(A, WA))
    return W, A, P, alpha, M


@row(
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


@row("moving-legendre-isotropic", "Section 6.2, alpha = 1", "M_k = (2/eps)(W - I)/(W + I) => W = cay(eps/2 M_k)")
def moving_legendre_isotropic(s: Setting) -> Sides:
    W = s.rotation()
    yield cayley(half(W)), W


@row(
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


law_row(
    "theorem-6.3",
    "Section 6.2, Theorem 6.3, (dmLT body), Hbar_eps",
    "the discrete Euler-Lagrange equations of (dmLT Lagr body) are the map; it is Poisson and keeps Hbar_eps",
    MOVING,
    "discrete-euler-lagrange",
    "poisson",
    "integrals-of-the-map",
    "involution",
)


@row(
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


@row(
    "moving-energy-limit",
    "Section 6.2, Theorem 6.3, Hbar_eps",
    "Hbar_0 + (1/alpha - 1)<M_perp, M_perp>/2 = H of the alpha top, |A| = 1 (E16: Hbar_0 alone is H at alpha = 1)",
    "E16",
)
def moving_energy_limit(s: Setting) -> Sides:
    M, P, A, alpha = s.skew(), s.vector(), s.unit(), abs(s.scalar())
    Omega = lagrange_top_moving.velocity(M, P, A=A, alpha=alpha)
    Pi = identity(s.n) - outer(A)
    across = Pi @ M @ Pi
    H = pairing(M, Omega) / 2 + dot(P, A)
    yield pairing(M, M) / 2 + dot(P, A) + (1 / alpha - 1) * pairing(across, across) / 2, H
    yield lagrange_top_moving.energy(M, P, A=A, alpha=alpha), H


@printed("moving-energy-limit")
def moving_energy_limit_printed(s: Setting) -> Sides:
    M, P, A, alpha = s.skew(), s.vector(), s.unit(), abs(s.scalar())
    Omega = lagrange_top_moving.velocity(M, P, A=A, alpha=alpha)
    yield pairing(M, M) / 2 + dot(P, A), pairing(M, Omega) / 2 + dot(P, A)


law_row(
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


@printed("theorem-6.4")
def theorem_6_4_printed(s: Setting) -> Sides:
    assert MOVING.map is not None
    spoiled = replace(MOVING, map=replace(MOVING.map, conjugator=printed_conjugator))
    yield from by_law(spoiled, "discrete-lax-equation")(s)


law_row(
    "moving-limit",
    "Section 6.2, proof of Theorem 6.3",
    "(dmLT body) approximates (mLT left); the error of the map is O(dt), of its conjugate O(dt^2)",
    MOVING,
    "continuous-limit",
    "order",
    in_rationals=False,
)


@row(
    "moving-completeness",
    'Section 6.2, Theorem 6.3, "complete"',
    "rank on the leaf as in the rest frame: complete only with Pi M Pi for n > 3 (E12)",
)
def moving_completeness(s: Setting) -> Sides:
    case = laws.make_case(MOVING, s.n, "exact", 0)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(SPECTRAL_RANK[s.n])
    yield np.asarray(leaf_rank(case, ("spectrum", "noether"))), np.asarray(2 * HALF_LEAF[s.n] - s.n + 1)
