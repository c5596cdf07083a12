"""Section 6: the discrete time Lagrange top, rest frame (6.1, with its Lemma) and moving frame (6.2)."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, act, cayley, cayley_act, dot, identity, log, moebius, pairing, wedge
from kreisel.algebra.matrices import border
from kreisel.lab.exact import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.statements import (
    HALF_LEAF,
    SPECTRAL_RANK,
    Setting,
    by_law,
    gradient,
    half,
    leaf_rank,
    left_derivative,
    outer,
    printed_law,
    rank_on_leaf,
    right_derivative,
    stated,
    stated_law,
    trace_log_of,
)
from kreisel.system import lagrange_top, lagrange_top_moving

TOP = lagrange_top.SYSTEM

# -- section 6, the Lemma -----------------------------------------------------------------------------


def _curve_of_rotations(s: Setting, order: int) -> tuple[Array, Array, Any]:
    """A curve w(e) = cay(e omega/2 + e^2 u/2) in SO(n), its omega, and e, a step with e^(order + 1) = 0."""
    one = 1 + 0 * s.scalar()
    e = sum(generator(i, one) for i in range(order))
    omega, u = s.skew(), s.skew()
    return cayley(0 * omega + omega * (e / 2) + u * (e * e / 2)), omega, e


def _coefficient(x: Any, k: int) -> Any:
    """The coefficient of e^k, e = x1 + x2 + ...: e^k = k! x1...xk + ..."""
    factorial = int(np.prod(range(1, k + 1)))
    return coefficient(x, (1 << k) - 1) / factorial if k else coefficient(x, 0)


@stated("lemma-6.1", "Section 6.1, Lemma 6.1, (tr as)")
def lemma_trace(s: Setting) -> Sides:
    """tr log(2I + w + w^-1) = const - (eps^2/2) <omega, omega> + O(eps^3) for w = I + eps omega + O(eps^2)"""
    w, omega, _ = _curve_of_rotations(s, 2)
    value = trace_log_of(w)
    yield np.asarray(_coefficient(value, 1)), np.asarray(0 * s.scalar())
    yield np.asarray(_coefficient(value, 2)), np.asarray(-pairing(omega, omega) / 2)


@stated("lemma-6.1-product", "Section 6.1, Lemma 6.1, (scalpr as)")
def lemma_product(s: Setting) -> Sides:
    """<a, wa> = <a, a> - (eps^2/2) |omega a|^2 + O(eps^3)"""
    w, omega, _ = _curve_of_rotations(s, 2)
    a = s.vector()
    value = dot(a, act(w, a))
    yield np.asarray(_coefficient(value, 0)), dot(a, a)
    yield np.asarray(_coefficient(value, 1)), np.asarray(0 * s.scalar())
    yield np.asarray(_coefficient(value, 2)), -dot(act(omega, a), act(omega, a)) / 2


@stated("lemma-6.1-proof", "Section 6.1, (lemma aux)")
def lemma_proof(s: Setting) -> Sides:
    """w = I + eps omega + eps^2 v: v + v^T + omega omega^T = 0; 2I + w + w^T = 4I + eps^2 omega^2 + O(eps^3)"""
    w, omega, _ = _curve_of_rotations(s, 2)
    v = _coefficient(w, 2)
    yield v + v.T + omega @ omega.T, 0 * omega
    even = 2 * identity(s.n) + w + w.T
    yield _coefficient(even, 0), 4 * identity(s.n) + 0 * omega
    yield _coefficient(even, 1), 0 * omega
    yield _coefficient(even, 2), omega @ omega


# -- section 6.1 --------------------------------------------------------------------------------------


def _rest_data(s: Setting) -> tuple[Any, ...]:
    """w, a_k, a_(k+1) = w a_k with |a| = 1, p, alpha, and m_(k+1) of (dLT m expr)."""
    w, a, p, alpha = s.rotation(), s.unit(), s.vector(), s.scalar()
    a1 = act(w, a)
    m1 = 2 * alpha / s.eps * half(w) - 2 * (1 - alpha) / s.eps * wedge(a, a1) / (1 + dot(a, a1))
    return w, a, a1, p, alpha, m1


@stated("continuous-limit", "Section 3, end, and section 6.1, (dmLT Lagr 1)", "E15", printed={"constant": False})
def expanded_lagrangian(s: Setting, constant: bool = True, moving: bool = False) -> Sides:
    """eps (discrete Lagrangian - constant) = eps^2 (mLT Lagr 4) + O(eps^3), |a| = 1 (E15: the constant is not 0)"""
    w, omega, e = _curve_of_rotations(s, 2)
    a, p, alpha = s.unit(), s.vector(), s.scalar()

    def kinetic_of(w: Array) -> Any:
        return -alpha * trace_log_of(w) - 2 * (1 - alpha) * log(1 + dot(a, act(w, a)))

    kinetic, start = kinetic_of(w), kinetic_of(identity(s.n) + 0 * omega + 0 * omega * e)
    times_eps = kinetic - e * e * dot(p, act(w, a) if moving else a) - (start if constant else 0)
    limit = alpha * pairing(omega, omega) / 2 + (1 - alpha) * dot(act(omega, a), act(omega, a)) / 2 - dot(p, a)
    yield np.asarray(_coefficient(times_eps, 0)), np.asarray(0 * s.scalar())
    yield np.asarray(_coefficient(times_eps, 1)), np.asarray(0 * s.scalar())
    yield np.asarray(_coefficient(times_eps, 2)), np.asarray(limit)


@stated("deriv-aux1", "Section 6.1, (deriv aux1)", "E4", printed={"inverse": False})
def deriv_aux1(s: Setting, inverse: bool = True) -> Sides:
    """d_w tr log(2I + w + w^-1) = -2 (w - I)/(w + I); the middle of its proof with (2I + w + w^-1)^-1 (E4)"""
    w, eta = s.rotation(), s.skew()
    yield left_derivative(trace_log_of, w), -2 * half(w)
    yield right_derivative(trace_log_of, w), -2 * half(w)
    even = 2 * identity(s.n) + w + w.T
    inner = algebra.solve(even, w - w.T) if inverse else even @ (w - w.T)
    yield np.trace(inner @ eta), -2 * pairing(half(w), eta)


@stated("deriv-aux2", "Section 6.1, (deriv aux2)")
def deriv_aux2(s: Setting) -> Sides:
    """d_w <a, wa> = a ^ (wa); grad_a <a, wa> = wa + w^T a"""
    w, a = s.rotation(), s.vector()
    yield left_derivative(lambda x: dot(a, act(x, a + 0 * x[0])), w), wedge(a, act(w, a))
    yield gradient(lambda v: dot(v, act(w + 0 * v, v)), a), act(w, a) + act(w.T, a)


@stated("dlt-momentum", "Section 6.1, (dLT m expr)")
def dlt_momentum(s: Setting) -> Sides:
    """m_(k+1) = d_w Lambda = (2 alpha/eps)(w - I)/(w + I) - (2(1 - alpha)/eps) a_k ^ a_(k+1)/(1 + <a_k, a_(k+1)>)"""
    w, a, _, p, alpha, m1 = _rest_data(s)
    yield left_derivative(lambda x: _discrete_rest(x, a + 0 * x[0], p, alpha, s.eps), w), m1


def _discrete_rest(w: Array, a: Array, p: Array, alpha: Any, eps: Any) -> Any:  # (dmLT Lagr 1), |a| = 1
    kinetic = -alpha / eps * trace_log_of(w) - 2 * (1 - alpha) / eps * log(1 + dot(a, act(w, a)))
    return kinetic - eps * dot(p, a)


@stated("dlt-kick", "Section 6.1, after (dLT m expr)")
def dlt_kick(s: Setting) -> Sides:
    """w^-1 m_(k+1) w + a_k ^ grad_a Lambda = m_(k+1) - eps a_k ^ p, so m_(k+1) = m_k + eps a_k ^ p"""
    w, a, a1, p, alpha, m1 = _rest_data(s)
    force = -2 * (1 - alpha) / s.eps * (a1 + act(w.T, a)) / (1 + dot(a, a1)) - s.eps * p
    yield gradient(lambda v: _discrete_rest(w + 0 * v, v, p, alpha, s.eps), a), force
    yield w.T @ m1 @ w + wedge(a, force), m1 - s.eps * wedge(a, p)


@stated("dlt-turn", "Section 6.1, proof of the second equation")
def dlt_turn(s: Setting) -> Sides:
    """the two displays for (eps/2) m_(k+1) a_(k+1), (eps/2) m_(k+1) a_k, and their sum a_(k+1) - a_k"""
    w, a, a1, _, alpha, m1 = _rest_data(s)
    c, h = dot(a, a1), half(w)
    yield s.eps / 2 * act(m1, a1), alpha * act(h, a1) - (1 - alpha) * (a - a1 * c) / (1 + c)
    yield s.eps / 2 * act(m1, a), alpha * act(h, a) - (1 - alpha) * (a * c - a1) / (1 + c)
    yield s.eps / 2 * act(m1, a1 + a), a1 - a


stated_law(
    "theorem-6.1",
    "Section 6.1, Theorem 6.1, (dLT rest frame), (dLT rest H)",
    "the discrete Euler-Lagrange equations of (dmLT Lagr 1) are the map; it is Poisson and conserves H_eps, any |a|",
    TOP,
    ("discrete-euler-lagrange", "poisson", "integrals-of-the-map"),
)


@stated("length-of-a", "Section 6.1, (dmLT Lagr 1) for |a| not 1", "E11")
def length_of_a(s: Setting) -> Sides:
    """with |A|^2 + <a_k, a_(k+1)> for 1 + <a_k, a_(k+1)> the discrete Lagrangian holds for any |a|, alpha not 1 (E11)"""
    yield from by_law(TOP, "discrete-euler-lagrange")(s)


def unnormalised(g: Array, h: Array, A: Array, *, p: Array, alpha: Any, eps: Any) -> Any:
    """(dmLT Lagr 1) as printed."""
    a, a1 = act(g, A), act(h, A)
    kinetic = alpha / eps * trace_log_of(h @ g.T)
    return -kinetic - 2 * (1 - alpha) / eps * log(1 + dot(a, a1)) - eps * dot(p, a)


printed_law("length-of-a", TOP, "discrete-euler-lagrange", lagrangian=unnormalised)


@stated("pairing-identity", "Section 6.1, proof of (dLT rest H)")
def pairing_identity(s: Setting) -> Sides:
    """<ma, p> = <m, p ^ a>"""
    m, a, p = s.skew(), s.vector(), s.vector()
    yield dot(act(m, a), p), pairing(m, wedge(p, a))


@stated("rest-energy-chain", "Section 6.1, last display of the proof")
def rest_energy_chain(s: Setting) -> Sides:
    """H_eps(m_(k+1), a_(k+1)) through its five forms to H_eps(m_k, a_k)"""
    m, a, p, e = s.skew(), s.vector(), s.vector(), s.eps
    m1, a1 = lagrange_top.step(m, a, p=p, eps=e)
    last = lagrange_top.energy(m, a, p=p, eps=e)
    yield lagrange_top.energy(m1, a1, p=p, eps=e), pairing(m1, m1) / 2 + dot(a1 - e / 2 * act(m1, a1), p)
    yield pairing(m1, m1) / 2 + dot(a + e / 2 * act(m1, a), p), last
    yield pairing(m1, m1 + e * wedge(p, a)) / 2 + dot(a, p), last
    yield pairing(m - e * wedge(p, a), m) / 2 + dot(a, p), last


stated_law(
    "theorem-6.2",
    "Section 6.1, Theorem 6.2, (dmLT rest Lax), (bk)",
    "l_(k+1) v_k = v_k l_(k+1) ... : v_k l_(k+1) = l_k v_k with b_k = (I - eps/2 m_k) a_k + (eps^2/4)|a|^2 p (E11)",
    TOP,
    ("discrete-lax-equation",),
    erratum="E11",
)


def printed_b(m: Array, a: Array, *, p: Array, eps: Any = 0) -> Array:
    """(bk) as printed: (eps^2/4) p whatever |a|."""
    return a - eps * act(m, a) / 2 + eps * eps * p / 4


def printed_lax(m: Array, a: Array, *, p: Array, lam: Any, eps: Any) -> Array:
    """The Lax matrix with (bk) as printed."""
    return border(m, lam * printed_b(m, a, p=p, eps=eps) - p / lam)


printed_law("theorem-6.2", TOP, "discrete-lax-equation", lax=printed_lax)


@stated("rest-lax-polynomial", "Section 6.1, proof of Theorem 6.2")
def rest_lax_polynomial(s: Setting) -> Sides:
    """(I + eps/2 u) l_(k+1) (I - eps/2 u) = (I - eps/2 u) l_k (I + eps/2 u); with |a| = 1 as printed"""
    m, a, p, e = s.skew(), s.unit(), s.vector(), s.eps
    m1, a1 = lagrange_top.step(m, a, p=p, eps=e)
    u, one = border(0 * m, s.lam * a), identity(s.n + 1)
    old, new = (printed_lax(*z, p=p, lam=s.lam, eps=e) for z in ((m, a), (m1, a1)))
    yield (one + e / 2 * u) @ new @ (one - e / 2 * u), (one - e / 2 * u) @ old @ (one + e / 2 * u)


stated_law(
    "rest-limit",
    "Section 6.1, continuous limit",
    "(step - 1)/eps -> (mLT right), deformed integrals -> integrals; the error of the map is O(dt), of its conjugate O(dt^2)",
    TOP,
    ("continuous-limit", "order"),
    numbers=("float",),
)
stated_law(
    "rest-involution",
    "Section 6.1, after Theorem 6.2",
    "the coefficients of det(l_k(lambda) - mu) are integrals in involution",
    TOP,
    ("integrals-of-the-map", "involution"),
)


@stated("integrals-differ", "Section 6.1, after Theorem 6.2", numbers=("exact",))
def integrals_differ(s: Setting) -> Sides:
    """the integrals are those of the flow with b for a, and do not coincide with them: the rank of both is 3, 5, 6, 8 on the leaf, of each 2, 3, 4, 5"""
    m, a, p, e = s.skew(), s.vector(), s.vector(), s.eps
    b = lagrange_top.shifted(m, a, p=p, eps=e)
    yield lagrange_top.spectrum(m, a, p=p, eps=e), lagrange_top.spectrum(m, b, p=p)
    sets = [lambda m, a, eps=eps: lagrange_top.spectrum(m, a, p=p, eps=eps) for eps in (0 * e, e)]
    ranks = [rank_on_leaf(TOP, (m, a), chosen) for chosen in ([sets[0]], [sets[1]], sets)]
    yield np.asarray(ranks), np.asarray([SPECTRAL_RANK[s.n]] * 2 + [{3: 3, 4: 5, 5: 6, 6: 8}[s.n]])


@stated(
    "rest-completeness",
    "Section 6.1, after Theorem 6.2",
    "E12",
    printed={"ranks": HALF_LEAF},
    numbers=("exact",),
    misprinted=(4, 5, 6),
)
def rest_completeness(s: Setting, ranks: dict[int, int] = SPECTRAL_RANK) -> Sides:
    """the spectrum has rank 2, 3, 4, 5 on the leaf for n = 3...6, with pi m pi 2, 5, 8, 13: complete only with it if n > 3 (E12)"""
    case = s.case(TOP)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(ranks[s.n])
    dimension, torus = 2 * HALF_LEAF[s.n], s.n - 1
    yield np.asarray(leaf_rank(case, ("spectrum", "noether"))), np.asarray(dimension - torus)


# -- section 6.2, the moving frame -----------------------------------------------------------------


MOVING = lagrange_top_moving.SYSTEM


@stated("moving-lagrangian", "Section 6.2, (dmLT Lagr body)")
def moving_lagrangian(s: Setting) -> Sides:
    """<p, a_(k+1)> for <p, a_k> leaves the variation of the sum over k unchanged; in P_k, W_k it is (dmLT Lagr body)"""
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


@stated("moving-discrete-limit", "Section 6.2, after (dmLT Lagr body)", "E15", printed={"constant": False})
def moving_discrete_limit(s: Setting, constant: bool = True) -> Sides:
    """eps (Lambda(P, W) - constant) = eps^2 L(P, Omega) + O(eps^3), W = I + eps Omega + ..., |A| = 1 (E15: the constant is not 0)"""
    yield from expanded_lagrangian(s, constant, moving=True)


@stated("moving-backwards", "Section 6.2, the modified Lagrange function")
def moving_backwards(s: Setting) -> Sides:
    """it is minus (dmLT Lagr 1) with w^-1, a_(k+1), -eps for w, a_k, eps, any alpha: (g M g^T, gA) moves by the inverse of the rest frame's map with -eps"""
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


@stated("moving-legendre", "Section 6.2, (dmLT W thru M)")
def moving_legendre(s: Setting) -> Sides:
    """M_k = -d'_1 of the discrete Lagrangian; its inverse W = cay(X), X = eps M/(2 alpha) + ((1 - alpha)/alpha) A ^ y/<A, y>, y = (I - eps/2 M)^-1 A"""
    W, A, P, alpha, M = _moving_data(s)

    def whole(g: Array) -> Any:  # L(g_k, g_(k+1)) with g_(k+1) = W fixed and g_k near 1
        return lagrange_top_moving.lagrangian(g, W + 0 * g, P, A=A, alpha=alpha, eps=s.eps)

    yield -right_derivative(whole, identity(s.n) + 0 * W), M
    yield cayley(lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=s.eps)), W


@stated("moving-legendre-isotropic", "Section 6.2, alpha = 1")
def moving_legendre_isotropic(s: Setting) -> Sides:
    """M_k = (2/eps)(W - I)/(W + I) => W = cay(eps/2 M_k)"""
    W = s.rotation()
    yield cayley(half(W)), W


@stated("moving-turn", "Section 6.2, (dmTL Legendre inv interm)")
def moving_turn(s: Setting) -> Sides:
    """W_k A = cay(eps/2 M_k) A, by the two displays for (eps/2) M_k A and (eps/2) M_k W_k A"""
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
    ("discrete-euler-lagrange", "poisson", "integrals-of-the-map", "involution"),
)


@stated("moving-energy-chain", "Section 6.2, last display of the proof")
def moving_energy_chain(s: Setting) -> Sides:
    """Hbar_eps(M_(k+1), P_(k+1)) through its six forms to Hbar_eps(M_k, P_k), |A| = 1"""
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


@stated("moving-energy-limit", "Section 6.2, Theorem 6.3, Hbar_eps", "E16", printed={"spins": 0})
def moving_energy_limit(s: Setting, spins: int = 1) -> Sides:
    """Hbar_0 + (1/alpha - 1)<M_perp, M_perp>/2 = H of the alpha top, |A| = 1 (E16: only Hbar_0 is H at alpha = 1)"""
    M, P, A, alpha = s.skew(), s.vector(), s.unit(), s.scalar()
    Omega = lagrange_top_moving.velocity(M, P, A=A, alpha=alpha)
    Pi = identity(s.n) - outer(A)
    across = Pi @ M @ Pi
    H = pairing(M, Omega) / 2 + dot(P, A)
    yield pairing(M, M) / 2 + dot(P, A) + spins * (1 / alpha - 1) * pairing(across, across) / 2, H
    yield lagrange_top_moving.energy(M, P, A=A, alpha=alpha), H


stated_law(
    "theorem-6.4",
    "Section 6.2, Theorem 6.4",
    "V_k L_(k+1) = L_k V_k with U = [[0, lambda A], [+lambda A^T, 0]] (E2)",
    MOVING,
    ("discrete-lax-equation",),
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
    ("continuous-limit", "order"),
    numbers=("float",),
)


@stated("moving-completeness", 'Section 6.2, Theorem 6.3, "complete"', numbers=("exact",))
def moving_completeness(s: Setting) -> Sides:
    """rank on the leaf as in the rest frame: complete only with Pi M Pi for n > 3 (E12)"""
    case = s.case(MOVING)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(SPECTRAL_RANK[s.n])
    yield np.asarray(leaf_rank(case, ("spectrum", "noether"))), np.asarray(2 * HALF_LEAF[s.n] - s.n + 1)
