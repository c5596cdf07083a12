"""Section 7 (and its display in section 1): Kirchhoff's equations, Clebsch's case and its discretization."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kreisel.algebra import Array, act, bracket, cayley, dot, identity, log, pairing, wedge
from kreisel.algebra.matrices import diagonal
from kreisel.lab import laws
from kreisel.lab.jets import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.shared import HALF_LEAF, half, leaf_rank, outer, trace_log_of
from kreisel.lab.paper.statements import Setting, by_law, gradient, printed, right_derivative, stated, stated_law
from kreisel.system import clebsch, clebsch_general, kirchhoff

KIRCHHOFF, GENERAL, CLEBSCH = kirchhoff.SYSTEM, clebsch_general.SYSTEM, clebsch.SYSTEM

stated_law(
    "introduction-clebsch",
    "Section 1, second display",
    "M' = P ^ BP, P' = -MP is Hamiltonian; its map is Poisson, keeps its energy and has a Lax pair",
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


@stated(
    "clebsch-condition",
    "Section 7, Clebsch's relations",
    "(b_i - b_j)/c_ij + (b_j - b_k)/c_jk + (b_k - b_i)/c_ki = 0 for c_jk = (b_j - b_k)/(a_j - a_k)",
)
def clebsch_condition(s: Setting) -> Sides:
    a, b = s.diagonal(), s.diagonal() ** 2
    i, j, k = 0, 1, s.n - 1

    def quotient(x: int, y: int) -> Any:
        return (b[x] - b[y]) / ((b[x] - b[y]) / (a[x] - a[y]))

    yield quotient(i, j) + quotient(j, k) + quotient(k, i), 0 * a[0]


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
    "c_jk = 1/(J_j + J_k), b_k = J_k has a_k = J_k^2, and <Omega, J(Omega)> = <Omega, J Omega + Omega J>",
)
def clebsch_quadratic(s: Setting) -> Sides:
    J, Omega = s.diagonal(), s.skew()
    sums = J[:, None] + J[None, :]
    apart = J[:, None] ** 2 - J[None, :] ** 2
    yield apart, (J[:, None] - J[None, :]) * sums
    yield sums * Omega, J[:, None] * Omega + Omega * J[None, :]


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


@printed("theorem-7.1")
def theorem_7_1_printed(s: Setting) -> Sides:
    assert CLEBSCH.map is not None
    spoiled = replace(CLEBSCH, map=replace(CLEBSCH.map, lagrangian=printed_lagrangian))
    yield from by_law(spoiled, "discrete-euler-lagrange")(s)


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


@printed("theorem-7.1-lax")
def theorem_7_1_lax_printed(s: Setting) -> Sides:
    assert CLEBSCH.map is not None
    spoiled = replace(CLEBSCH, map=replace(CLEBSCH.map, lax=printed_pencil))
    yield from by_law(spoiled, "discrete-lax-equation")(s)


stated_law(
    "clebsch-limit",
    "Section 7, the discretization",
    "(step - 1)/eps -> (Clebsch spec); the error of the map is O(dt), of its conjugate O(dt^2)",
    CLEBSCH,
    "continuous-limit",
    "order",
    in_rationals=False,
)
stated_law(
    "clebsch-integrals",
    'Section 7, Theorem 7.1, "completely integrable"',
    "the coefficients of det(L_k(lambda) - mu) are integrals of the map in involution",
    CLEBSCH,
    "integrals-of-the-map",
    "involution",
)


@stated(
    "clebsch-completeness",
    'Section 7, Theorem 7.1, "completely integrable"',
    "the spectrum has half the dimension of the leaf, 2, 4, 6, 9 for n = 3...6, for distinct b; not if three coincide and n > 3 (E17)",
    "E17",
    dimensions=(4, 5, 6),
)
def clebsch_completeness(s: Setting) -> Sides:
    case = laws.make_case(CLEBSCH, s.n, "exact", 0)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(HALF_LEAF[s.n])


@printed("clebsch-completeness")
def clebsch_completeness_printed(s: Setting) -> Sides:
    case = laws.make_case(CLEBSCH, s.n, "exact", 0)
    b = case.model.params["b"].copy()
    b[1] = b[2] = b[0]
    case = replace(case, model=CLEBSCH(b=b))
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(HALF_LEAF[s.n])


@stated(
    "clebsch-completeness-3", "Section 7, Theorem 7.1, n = 3", "the spectrum has rank 2 on the leaf", dimensions=(3,)
)
def clebsch_completeness_3(s: Setting) -> Sides:
    case = laws.make_case(CLEBSCH, s.n, "exact", 0)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(HALF_LEAF[s.n])
