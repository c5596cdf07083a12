"""Section 7 (and its display in section 1): Kirchhoff's equations, Clebsch's case and its discretization."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from kreisel.algebra import Array, act, bracket, cayley, dot, identity, log, pairing, wedge
from kreisel.algebra.invariants import characteristic
from kreisel.algebra.matrices import diagonal
from kreisel.lab.jets import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.shared import HALF_LEAF, half, outer, rank_on_leaf, trace_log_of
from kreisel.lab.paper.statements import Setting, gradient, printed, printed_law, right_derivative, stated, stated_law
from kreisel.system import clebsch, clebsch_body, clebsch_general, kirchhoff, quadratic_potential

KIRCHHOFF, GENERAL, CLEBSCH = kirchhoff.SYSTEM, clebsch_general.SYSTEM, clebsch.SYSTEM

stated_law(
    "introduction-clebsch",
    "Section 1, second display",
    "M' = P ^ BP, P' = -MP is Hamiltonian; its map is Poisson, conserves its energy and has a Lax pair",
    CLEBSCH,
    "hamiltonian-flow",
    "poisson",
    "integrals-of-the-map",
    "discrete-lax-equation",
)

# -- the continuous system ------------------------------------------------------------------------------

stated_law(
    "kirchhoff-equations",
    "Section 7, (Kirch) and its Hamilton function",
    "M' = [M, Omega] + P ^ BP, P' = -Omega P, Omega_jk = c_jk M_jk is z' = {H, z}",
    KIRCHHOFF,
    "hamiltonian-flow",
)


@stated(
    "kirchhoff-lagrangian",
    "Section 7, (Kirch Lagr)",
    "L = <Omega, J(Omega)>/2 + <P, BP>/2, J(Omega)_jk = Omega_jk/c_jk, reduces to (Kirch)",
)
def kirchhoff_lagrangian(s: Setting) -> Sides:
    C, B, Omega, P = s.symmetric(), s.symmetric(), s.skew(), s.vector()
    C = C + 3 + 0 * C  # away from 0 off the diagonal
    M = gradient(lambda x: pairing(x, x / C) / 2, Omega)
    yield C * M, Omega
    yield wedge(P, gradient(lambda v: dot(v, act(B, v)) / 2, P)), wedge(P, act(B, P))


def _clebsch_relations(b: Array, c: Array) -> Sides:
    """(b_i - b_j)/c_ij + (b_j - b_k)/c_jk + (b_k - b_i)/c_ki = 0 for all i < j < k."""
    for i, j, k in itertools.combinations(range(len(b)), 3):
        terms = [(b[x] - b[y]) / c[x, y] for x, y in ((i, j), (j, k), (k, i))]
        yield terms[0] + terms[1], -terms[2]


@stated(
    "clebsch-condition",
    "Section 7, Clebsch's relations",
    "(b_i - b_j)/c_ij + (b_j - b_k)/c_jk + (b_k - b_i)/c_ki = 0 for i, j = 1, 2, all k implies c_jk = (b_j - b_k)/(a_j - a_k) for some a, "
    "and those c fulfil the relations for all i, j, k",
)
def clebsch_condition(s: Setting) -> Sides:
    b, c = s.diagonal(), 1 + 0 * s.symmetric()
    c[0, 1:] = c[1:, 0] = s.vector()[1:] + 5  # the others by the relations of 1, j, k
    for j, k in itertools.combinations(range(1, s.n), 2):
        c[j, k] = c[k, j] = -(b[j] - b[k]) / ((b[0] - b[j]) / c[0, j] + (b[k] - b[0]) / c[k, 0])
    a = (b - b[0]) / c[0]
    for j, k in itertools.combinations(range(s.n), 2):
        yield c[j, k] * (a[j] - a[k]), b[j] - b[k]
    a = s.diagonal()
    yield from _clebsch_relations(b, (b[:, None] - b + identity(s.n)) / (a[:, None] - a + identity(s.n)))


stated_law(
    "clebsch-lax",
    "Section 7, Lax representation of Clebsch's case",
    "L' = [L, U], L = lambda A + M + P P^T/lambda, U = lambda B + Omega; the spectrum is in involution",
    GENERAL,
    "lax-equation",
    "involution",
)


@stated(
    "clebsch-quadratic",
    "Section 7, the flow of the earlier paper",
    "c_jk = 1/(J_j + J_k), b = J fulfil Clebsch's relations with a = J^2; the flow is that of a body, J(Omega) = J Omega + Omega J, "
    "in a quadratic potential, with P P^T for its P",
)
def clebsch_quadratic(s: Setting) -> Sides:
    J, M, P = s.diagonal(), s.skew(), s.vector()
    c = 1 / (J[:, None] + J)
    yield from _clebsch_relations(J, c)
    a, off = J * J, 1 - identity(s.n)
    general = clebsch_general.quotients(a=a, b=J)["c"]
    yield off * general, off * c
    Omega = gradient(lambda x: pairing(x, c * x) / 2, M)
    yield J[:, None] * Omega + Omega * J, M
    rate = clebsch_general.flow(M, P, b=J, c=general)
    body = quadratic_potential.flow(M, outer(P), J=J, c=c)
    yield rate[0], body[0]
    yield outer(rate[1] + P) - outer(rate[1]) - outer(P), body[1]


stated_law(
    "clebsch-special",
    "Section 7, (Clebsch spec), its Hamilton function, L' = [L, U+]",
    "c = 1, a = b: M = Omega, M' = P ^ BP, P' = -MP is z' = {H, z}, H = <M, M>/2 - <P, BP>/2; L' = [L, lambda B + M]",
    CLEBSCH,
    "hamiltonian-flow",
    "lax-equation",
)


@stated(
    "clebsch-two-lax-forms", "Section 7, Lax representation of (Clebsch spec)", "[L, lambda B + M] = [P P^T/lambda, L]"
)
def two_lax_forms(s: Setting) -> Sides:
    M, P, b = s.skew(), s.vector(), s.vector()
    L = s.lam * diagonal(b) + M + outer(P) / s.lam
    yield bracket(L, s.lam * diagonal(b) + M), bracket(outer(P) / s.lam, L)


# -- the map --------------------------------------------------------------------------------------------


@stated(
    "clebsch-discrete-limit",
    "Section 7, (dClebsch spec Lagr)",
    "eps (discrete Lagrangian - constant) = eps^2 (Clebsch spec Lagr) + O(eps^3), with 2/eps before the logarithm (E1, E15)",
    "E1, E15",
)
def discrete_limit(s: Setting) -> Sides:
    yield from _discrete_limit(s, 2)


def _discrete_limit(s: Setting, factor: int) -> Sides:
    one = 1 + 0 * s.scalar()
    e = generator(0, one) + generator(1, one)
    Omega, P, b = s.skew(), s.vector(), s.vector()
    W = cayley(0 * Omega + Omega * (e / 2))
    potential = log(1 + e * e / 4 * dot(P, b * P) + 0 * one)
    start = trace_log_of(identity(s.n) + 0 * Omega + 0 * Omega * e)
    value = -(trace_log_of(W) - start) + factor * potential
    yield np.asarray(coefficient(value, 0b11) / 2), pairing(Omega, Omega) / 2 + dot(P, b * P) / 2


@printed("clebsch-discrete-limit")
def discrete_limit_printed(s: Setting) -> Sides:
    yield from _discrete_limit(s, 4)


@stated(
    "clebsch-momentum",
    "Section 7, proof of Theorem 7.1",
    "M_(k+1) = d'_W Lambda = (2/eps)(W - I)/(W + I), W = cay(eps/2 M_(k+1)); grad_P Lambda = eps BP/(1 + eps^2/4 <P, BP>)",
)
def clebsch_momentum(s: Setting) -> Sides:
    W, P, b, e = s.rotation(), s.vector(), s.diagonal(), s.eps
    M1 = 2 / e * half(W)
    yield right_derivative(lambda x: -trace_log_of(x) / e, W), M1
    yield cayley(e / 2 * M1), W
    force = gradient(lambda v: 2 / e * log(1 + e * e / 4 * dot(v, b * v)), P)
    yield force, e * b * P / (1 + e * e / 4 * dot(P, b * P))


stated_law(
    "theorem-7.1",
    "Section 7, Theorem 7.1, (dClebsch spec)",
    "the discrete Euler-Lagrange equations of (dClebsch spec Lagr), with 2/eps (E1), are the map; it is Poisson, any |P|",
    CLEBSCH,
    "discrete-euler-lagrange",
    "poisson",
    erratum="E1",
)


def printed_lagrangian(g: Array, h: Array, p: Array, *, b: Array, eps: Any) -> Any:
    """(dClebsch spec Lagr) with 4/eps, as printed."""
    P = act(g.T, p)
    return -trace_log_of(g.T @ h) / eps + 4 / eps * log(clebsch.denominator(P, b=b, eps=eps))


printed_law("theorem-7.1", CLEBSCH, "discrete-euler-lagrange", lagrangian=printed_lagrangian)
stated_law(
    "theorem-7.1-lax",
    "Section 7, Theorem 7.1, Lax representation",
    "L_(k+1) = V_k L_k V_k^-1 with S = I + (eps^2 |P|^2/4) B for I + (eps^2/4) B, any |P| (E10)",
    CLEBSCH,
    "discrete-lax-equation",
    erratum="E10",
)


def printed_pencil(M: Array, P: Array, *, b: Array, lam: Any, eps: Any) -> Array:
    """The Lax matrix with S = I + (eps^2/4) B whatever |P|, as printed."""
    S = 1 + eps * eps / 4 * b
    return clebsch.pencil(M, clebsch.shifted(M, P, eps=eps), b, lam) / S[..., :, None]


printed_law("theorem-7.1-lax", CLEBSCH, "discrete-lax-equation", lax=printed_pencil)
stated_law(
    "clebsch-limit",
    "Section 7, the discretization",
    "(step - 1)/eps -> (Clebsch spec); the error of the map is O(dt), of its conjugate O(dt^2)",
    CLEBSCH,
    "continuous-limit",
    "order",
    numbers=("float",),
)
stated_law(
    "clebsch-integrals",
    'Section 7, Theorem 7.1, "completely integrable"',
    "the coefficients of det(L_k(lambda) - mu) are integrals of the map in involution",
    CLEBSCH,
    "integrals-of-the-map",
    "involution",
)


def _lax_rank(s: Setting, b: Array) -> int:
    """The rank on the leaf of the coefficients of det(L_k(lambda) - mu), L_k as printed, at a point with |P| = 1."""
    M, P, e = s.skew(), s.unit(), s.eps
    draws = [s.lam + k for k in range(s.n + 2)]  # of degrees -1 ... n in lambda

    def coefficients(*z: Array) -> Array:
        rows = [characteristic(printed_pencil(*z, b=b, lam=lam, eps=e))[1:] for lam in draws]
        return np.concatenate([np.asarray(row, dtype=object) for row in rows])

    return rank_on_leaf(CLEBSCH, (M, P), [coefficients])


@stated(
    "clebsch-completeness",
    'Section 7, Theorem 7.1, "completely integrable"',
    "det(L_k(lambda) - mu) has half the dimension of the leaf, 2, 4, 6, 9 for n = 3...6, for distinct b; not if three coincide (E17)",
    "E17",
    numbers=("exact",),
)
def clebsch_completeness(s: Setting) -> Sides:
    yield np.asarray(_lax_rank(s, s.diagonal())), np.asarray(HALF_LEAF[s.n])


@printed("clebsch-completeness")
def clebsch_completeness_printed(s: Setting) -> Sides:
    b = s.diagonal()
    b[1] = b[2] = b[0]
    yield np.asarray(_lax_rank(s, b)), np.asarray(HALF_LEAF[s.n])


@stated(
    "clebsch-two-maps",
    "Conclusion, last remark",
    "both discretized flows have the Lax matrix with A = J^2, but the maps have different integrals: the rank of both is the dimension "
    "of the leaf, 4, 8, 12, 18, of each half of it",
    numbers=("exact",),
)
def clebsch_two_maps(s: Setting) -> Sides:
    M, P, J, e = s.skew(), s.vector(), s.diagonal(), s.eps
    yield (
        clebsch.lax(M, P, b=J * J, lam=s.lam)[0],
        clebsch_body.lax(M, P, J=J, c=1 / (J[:, None] + J), lam=s.lam)[0],
    )
    sets = [
        lambda M, P: clebsch_body.spectrum(M, P, J=J),  # conserved by the earlier map
        lambda M, P: clebsch.spectrum(M, P, b=J * J, eps=e),
    ]
    ranks = [rank_on_leaf(CLEBSCH, (M, P), chosen) for chosen in ([sets[0]], [sets[1]], sets)]
    yield np.asarray(ranks), HALF_LEAF[s.n] * np.asarray([1, 1, 2])
