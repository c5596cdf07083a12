"""Section 7 (and its display in section 1): Kirchhoff's equations, Clebsch's case, its discretization, Neumann."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kreisel.algebra import Array, act, bracket, cayley, dot, identity, log, pairing, wedge
from kreisel.algebra.matrices import diagonal
from kreisel.lab import laws
from kreisel.lab.jets import coefficient, generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.rows import Setting, by_law, gradient, law_row, printed, rank, right_derivative, row
from kreisel.lab.paper.tops import HALF_LEAF, half, leaf_rank, outer, trace_log_of
from kreisel.system import clebsch, clebsch_general, kirchhoff, neumann

KIRCHHOFF, GENERAL, CLEBSCH, NEUMANN = (s.SYSTEM for s in (kirchhoff, clebsch_general, clebsch, neumann))

law_row(
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

law_row(
    "kirchhoff-equations",
    "Section 7, (Kirch) and its Hamilton function",
    "M' = [M, Omega] + P ^ BP, P' = -Omega P, Omega_jk = c_jk M_jk is z' = {H, z}",
    KIRCHHOFF,
    "hamiltonian-flow",
)


@row(
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


@row(
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


law_row(
    "clebsch-lax",
    "Section 7, Lax representation of Clebsch's case",
    "L' = [L, U], L = lambda A + M + P P^T/lambda, U = lambda B + Omega; the spectrum is in involution",
    GENERAL,
    "lax-equation",
    "involution",
)


@row(
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


law_row(
    "clebsch-special",
    "Section 7, (Clebsch spec), its Hamilton function, L' = [L, U+]",
    "c = 1, a = b: M = Omega, M' = P ^ BP, P' = -MP is z' = {H, z}, H = <M, M>/2 - <P, BP>/2; L' = [L, lambda B + M]",
    CLEBSCH,
    "hamiltonian-flow",
    "lax-equation",
)


@row(
    "clebsch-two-lax-forms", "Section 7, Lax representation of (Clebsch spec)", "[L, lambda B + M] = [P P^T/lambda, L]"
)
def two_lax_forms(s: Setting) -> Sides:
    M, P, b = s.skew(), s.vector(), s.vector()
    L = s.lam * diagonal(b) + M + outer(P) / s.lam
    yield bracket(L, s.lam * diagonal(b) + M), bracket(outer(P) / s.lam, L)


# -- the map --------------------------------------------------------------------------------------------


@row(
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


@row(
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


law_row(
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


law_row(
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


law_row(
    "clebsch-limit",
    "Section 7, the discretization",
    "(step - 1)/eps -> (Clebsch spec); the error of the map is O(dt), of its conjugate O(dt^2)",
    CLEBSCH,
    "continuous-limit",
    "order",
    in_rationals=False,
)
law_row(
    "clebsch-integrals",
    'Section 7, Theorem 7.1, "completely integrable"',
    "the coefficients of det(L_k(lambda) - mu) are integrals of the map in involution",
    CLEBSCH,
    "integrals-of-the-map",
    "involution",
)


@row(
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


@row("clebsch-completeness-3", "Section 7, Theorem 7.1, n = 3", "the spectrum has rank 2 on the leaf", dimensions=(3,))
def clebsch_completeness_3(s: Setting) -> Sides:
    case = laws.make_case(CLEBSCH, s.n, "exact", 0)
    yield np.asarray(leaf_rank(case, ("spectrum",))), np.asarray(HALF_LEAF[s.n])


class Step:
    """A step of the map and the matrices of the proof, P = P_k, |P| = 1 unless `unit` is False."""

    def __init__(self, s: Setting, unit: bool = True):
        self.e, self.b = s.eps, s.diagonal()
        self.M, self.P = s.skew(), s.unit() if unit else s.vector()
        self.M1, self.P1 = clebsch.step(self.M, self.P, b=self.b, eps=self.e)
        one = identity(s.n)
        den = clebsch.denominator(self.P, b=self.b, eps=self.e)
        S = one + self.e**2 / 4 * diagonal(self.b)
        self.Q, self.R = outer(self.P) @ S / den, S @ outer(self.P) / den
        self.script = self._script(self.M, self.P, one)
        self.script1 = self._script(self.M1, self.P1, one)
        self.dM, self.one = self.M1 - self.M, one

    def _script(self, M: Array, P: Array, one: Array) -> Array:  # (dClebsch spec P)
        return (one + self.e / 2 * M) @ outer(P) @ (one - self.e / 2 * M)


@row(
    "clebsch-aux1",
    "Section 7, (dClebsch spec aux1)",
    "(I - eps/(2 lambda) R)(lambda B + M_(k+1) + P_(k+1)/lambda)(I + eps/(2 lambda) Q) = the same with signs turned, M_k, P_k; |P| = 1",
)
def aux1(s: Setting) -> Sides:
    k = Step(s)
    B, turn = s.lam * diagonal(k.b), k.e / (2 * s.lam)
    new, old = B + k.M1 + k.script1 / s.lam, B + k.M + k.script / s.lam
    yield (k.one - turn * k.R) @ new @ (k.one + turn * k.Q), (k.one + turn * k.R) @ old @ (k.one - turn * k.Q)


@row("clebsch-aux3", "Section 7, (dClebsch spec aux3)", "lambda^0: M_(k+1) - M_k = eps (R_k B - B Q_k)")
def aux3(s: Setting) -> Sides:
    k = Step(s)
    yield k.dM, k.e * (k.R * k.b - k.b[:, None] * k.Q)


@row(
    "clebsch-aux4",
    "Section 7, (dClebsch spec aux4)",
    "lambda^-1: P_(k+1) - P_k = (eps/2) R_k (M_(k+1) + M_k) - (eps/2)(M_(k+1) + M_k) Q_k, script P",
)
def aux4(s: Setting) -> Sides:
    k = Step(s)
    yield k.script1 - k.script, k.e / 2 * (k.R @ (k.M1 + k.M) - (k.M1 + k.M) @ k.Q)


@row(
    "clebsch-aux5",
    "Section 7, (dClebsch spec aux5)",
    "lambda^-2: (P_(k+1) + P_k) Q_k - R_k (P_(k+1) + P_k) = (eps/2) R_k dM Q_k = 0",
)
def aux5(s: Setting) -> Sides:
    k = Step(s)
    left = (k.script1 + k.script) @ k.Q - k.R @ (k.script1 + k.script)
    yield left, k.e / 2 * k.R @ k.dM @ k.Q
    yield left, 0 * left


@row(
    "clebsch-aux6",
    "Section 7, (dClebsch spec aux6)",
    "R_k (P_(k+1) - P_k) Q_k = 0; it stands at lambda^-3 of (aux1), aux3 to aux5 at 0, -1, -2 (printed lambda^-2, E5)",
    "E5",
)
def aux6(s: Setting) -> Sides:
    k = Step(s)
    value = k.R @ (k.script1 - k.script) @ k.Q
    yield value, 0 * value
    yield from _expansion(s, 3)


def _expansion(s: Setting, order: int) -> Sides:
    """(aux1) for any matrices in the powers of lambda, with R (P_(k+1) - P_k) Q at lambda^-order."""
    B, R, Q, M, M1, P, P1 = (s.draw((s.n, s.n)) for _ in range(7))
    one, t, lam = identity(s.n), s.eps / 2, s.lam
    new = (one - t / lam * R) @ (lam * B + M1 + P1 / lam) @ (one + t / lam * Q)
    old = (one + t / lam * R) @ (lam * B + M + P / lam) @ (one - t / lam * Q)
    at_0 = M1 - M - 2 * t * (R @ B - B @ Q)
    at_1 = P1 - P - t * (R @ (M1 + M) - (M1 + M) @ Q)
    at_2 = t * ((P1 + P) @ Q - R @ (P1 + P)) - t**2 * R @ (M1 - M) @ Q
    yield new - old, at_0 + at_1 / lam + at_2 / lam**2 - t**2 * R @ (P1 - P) @ Q / lam**order


@printed("clebsch-aux6")
def aux6_printed(s: Setting) -> Sides:
    yield from _expansion(s, 2)


@row(
    "clebsch-aux8",
    "Section 7, (dClebsch spec aux8)",
    "Q_k = P P^T (I + eps/4 dM), R_k = (I - eps/4 dM) P P^T, Q_k^2 = Q_k; |P| = 1 (E10)",
    "E10",
)
def aux8(s: Setting) -> Sides:
    yield from _aux8(Step(s))


def _aux8(k: Step) -> Sides:
    yield k.Q, outer(k.P) @ (k.one + k.e / 4 * k.dM)
    yield k.R, (k.one - k.e / 4 * k.dM) @ outer(k.P)
    yield k.Q @ k.Q, k.Q


@printed("clebsch-aux8")
def aux8_printed(s: Setting) -> Sides:
    yield from _aux8(Step(s, unit=False))


@row(
    "clebsch-aux9",
    "Section 7, (dClebsch spec aux9)",
    "P_(k+1) = (I - eps/2 M_(k+1)) P_k P_k^T (I + eps/2 M_(k+1)), script P on the left",
)
def aux9(s: Setting) -> Sides:
    k = Step(s)
    yield k.script1, (k.one - k.e / 2 * k.M1) @ outer(k.P) @ (k.one + k.e / 2 * k.M1)


@row(
    "clebsch-last-display",
    "Section 7, last display of the proof",
    "(P_(k+1) + P_k) Q_k = R_k (P_(k+1) + P_k) = 2 (I - eps/4 dM) P P^T (I + eps/4 dM) (E3: the 2)",
    "E3",
)
def last_display(s: Setting) -> Sides:
    yield from _last_display(Step(s), 2)


def _last_display(k: Step, factor: int) -> Sides:
    right = factor * (k.one - k.e / 4 * k.dM) @ outer(k.P) @ (k.one + k.e / 4 * k.dM)
    yield (k.script1 + k.script) @ k.Q, right
    yield k.R @ (k.script1 + k.script), right


@printed("clebsch-last-display")
def last_display_printed(s: Setting) -> Sides:
    yield from _last_display(Step(s), 1)


# -- the smallest leaf ------------------------------------------------------------------------------------


def _leaf_point(s: Setting) -> tuple[Array, Array]:
    x = s.unit()
    q = s.vector()
    return x, q - x * dot(x, q)


@row(
    "neumann-leaf",
    "Section 7, end, the smallest leaf",
    "at M = x ^ q, P = x the bracket has rank 2(n - 1) (printed 2n, E6)",
    "E6",
)
def neumann_leaf(s: Setting) -> Sides:
    yield np.asarray(_leaf_rank(s)), np.asarray(2 * (s.n - 1))


def _leaf_rank(s: Setting) -> int:
    exact_setting = Setting(s.n, "exact")
    x, q = _leaf_point(exact_setting)
    return rank(CLEBSCH.space.tensor(wedge(x, q), x))


@printed("neumann-leaf")
def neumann_leaf_printed(s: Setting) -> Sides:
    yield np.asarray(_leaf_rank(s)), np.asarray(2 * s.n)


@row(
    "neumann-flow",
    "Section 7, end, Neumann's system",
    "P = x, M = x ^ q: x' = q, q' = Bx - (...)x, that is the potential energy -<x, Bx>/2 (printed +, E7)",
    "E7",
)
def neumann_flow(s: Setting) -> Sides:
    yield from _neumann_flow(s, 1)


def _neumann_flow(s: Setting, sign: int) -> Sides:
    x, q = _leaf_point(s)
    b = s.diagonal()
    force = sign * b * x  # minus the gradient of -sign <x, Bx>/2
    x_rate, q_rate = q, force - (dot(x, force) + dot(q, q)) * x
    M_rate, P_rate = clebsch.flow(wedge(x, q), x, b=b)
    yield P_rate, x_rate
    yield M_rate, wedge(x_rate, q) + wedge(x, q_rate)


@printed("neumann-flow")
def neumann_flow_printed(s: Setting) -> Sides:
    yield from _neumann_flow(s, -1)


law_row(
    "neumann-map",
    "Section 7, end, Adler's discretization",
    "the map on the leaf in (x, q), in second-order form, and as a Poisson map of T*S^(n-1) with a Lax pair",
    NEUMANN,
    "relations",
    "second-order-form",
    "poisson",
    "integrals-of-the-map",
    "discrete-lax-equation",
    "involution",
)
