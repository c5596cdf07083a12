"""Section 7 (and its display in section 1): Kirchhoff's equations, Clebsch's case, its discretization, Neumann's system."""

from __future__ import annotations

import itertools
from typing import Annotated, Any

import numpy as np

from kreisel.algebra import Array, act, bracket, cayley, dot, identity, log, pairing, wedge
from kreisel.algebra.invariants import characteristic, diagonal
from kreisel.lab.law import Sides
from kreisel.lab.paper import statements
from kreisel.lab.paper.setting import Curve, Diagonal, Eps, Lam, Rotation, Setting, Skew, Symmetric, Unit, Vector
from kreisel.lab.paper.statements import (
    gradient,
    half,
    printed_law,
    right_derivative,
    series,
    stated,
    stated_laws,
    trace_log_of,
)
from kreisel.system import clebsch, clebsch_body, neumann
from kreisel.system.clebsch_body import outer

CLEBSCH = clebsch.SYSTEM
LAWS = {
    "clebsch": {
        ("introduction-clebsch", "Section 1, second display"): (
            "M' = P ^ BP, P' = -MP is Hamiltonian; its map is Poisson, conserves its energy and has a Lax pair",
            "hamiltonian-flow poisson integrals-of-the-map discrete-lax-equation",
        ),
        ("clebsch-special", "Section 7, (Clebsch spec), its Hamilton function, L' = [L, U+]"): (
            "c = 1, a = b: M = Omega, M' = P ^ BP, P' = -MP is z' = {H, z}, H = <M, M>/2 - <P, BP>/2; L' = [L, lambda B + M]",
            "hamiltonian-flow lax-equation",
        ),
        ("theorem-7.1", "Section 7, Theorem 7.1, (dClebsch spec)"): (
            "the discrete Euler-Lagrange equations of (dClebsch spec Lagr), with 2/eps (E1), are the map; it is Poisson, any |P|",
            "discrete-euler-lagrange poisson",
        ),
        ("theorem-7.1-lax", "Section 7, Theorem 7.1, Lax representation"): (
            "L_(k+1) = V_k L_k V_k^-1 with S = I + (eps^2 |P|^2/4) B for I + (eps^2/4) B, any |P| (E10)",
            "discrete-lax-equation",
        ),
        ("clebsch-limit", "Section 7, the discretization"): (
            "(step - 1)/eps -> (Clebsch spec); the error of the map is O(dt), of its conjugate O(dt^2)",
            "continuous-limit order",
        ),
        ("clebsch-integrals", 'Section 7, Theorem 7.1, "completely integrable"'): (
            "the coefficients of det(L_k(lambda) - mu) are integrals of the map in involution",
            "integrals-of-the-map involution",
        ),
    },
    "kirchhoff": {
        ("kirchhoff-equations", "Section 7, (Kirch) and its Hamilton function"): (
            "M' = [M, Omega] + P ^ BP, P' = -Omega P, Omega_jk = c_jk M_jk is z' = {H, z}",
            "hamiltonian-flow",
        )
    },
    "clebsch-general": {
        ("clebsch-lax", "Section 7, Lax representation of Clebsch's case"): (
            "L' = [L, U], L = lambda A + M + P P^T/lambda, U = lambda B + Omega; the spectrum is in involution",
            "lax-equation involution",
        )
    },
    "clebsch-body": {
        ("clebsch-quadratic", "Section 7, the flow of the earlier paper"): (
            "c_jk = 1/(J_j + J_k), b = J is Clebsch's case with a = J^2; the flow is that of a body, J(Omega) = J Omega + Omega J, in a quadratic potential, with P P^T for its P",
            "relations",
        )
    },
    "neumann": {
        ("neumann-map", "Section 7, end, Adler's discretization"): (
            "the map on the leaf in (x, q), in second-order form, and as a Poisson map of T*S^(n-1) with a Lax pair",
            "relations second-order-form poisson integrals-of-the-map discrete-lax-equation involution",
        )
    },
}
stated_laws(LAWS)


# -- the continuous system ------------------------------------------------------------------------------


@stated("kirchhoff-lagrangian", "Section 7, (Kirch Lagr)")
def kirchhoff_lagrangian(C: Symmetric, B: Symmetric, Omega: Skew, P: Vector) -> Sides:
    """L = <Omega, J(Omega)>/2 + <P, BP>/2, J(Omega)_jk = Omega_jk/c_jk, reduces to (Kirch)"""
    C = C + 3 + 0 * C  # away from 0 off the diagonal
    M = gradient(lambda x: pairing(x, x / C) / 2, Omega)
    yield C * M, Omega
    yield wedge(P, gradient(lambda v: dot(v, act(B, v)) / 2, P)), wedge(P, act(B, P))


@stated("clebsch-condition", "Section 7, Clebsch's relations")
def clebsch_condition(s: Setting) -> Sides:
    """(b_i - b_j)/c_ij + (b_j - b_k)/c_jk + (b_k - b_i)/c_ki = 0 for i, j = 1, 2, all k implies c_jk = (b_j - b_k)/(a_j - a_k) for some a, and those c fulfil the relations for all i, j, k"""
    b, c = s.diagonal(), 1 + 0 * s.symmetric()
    c[0, 1:] = c[1:, 0] = s.vector()[1:] + 5  # the others by the relations of 1, j, k
    for j, k in itertools.combinations(range(1, s.n), 2):
        c[j, k] = c[k, j] = -(b[j] - b[k]) / ((b[0] - b[j]) / c[0, j] + (b[k] - b[0]) / c[k, 0])
    a = (b - b[0]) / c[0]
    for j, k in itertools.combinations(range(s.n), 2):
        yield c[j, k] * (a[j] - a[k]), b[j] - b[k]
    a = s.diagonal()
    c = (b[:, None] - b + identity(s.n)) / (a[:, None] - a + identity(s.n))
    for i, j, k in itertools.combinations(range(s.n), 3):
        yield (b[i] - b[j]) / c[i, j] + (b[j] - b[k]) / c[j, k], (b[i] - b[k]) / c[k, i]


@stated("clebsch-two-lax-forms", "Section 7, Lax representation of (Clebsch spec)")
def two_lax_forms(lam: Lam, M: Skew, P: Vector, b: Vector) -> Sides:
    """[L, lambda B + M] = [P P^T/lambda, L]"""
    L = lam * diagonal(b) + M + outer(P) / lam
    yield bracket(L, lam * diagonal(b) + M), bracket(outer(P) / lam, L)


# -- the map --------------------------------------------------------------------------------------------


@stated("clebsch-discrete-limit", "Section 7, (dClebsch spec Lagr)", printed={"factor": 4})
def discrete_limit(curve: Curve, P: Vector, b: Vector, factor: int = 2) -> Sides:
    """eps (discrete Lagrangian - constant) = eps^2 (Clebsch spec Lagr) + O(eps^3), with 2/eps before the logarithm (E1, E15)"""
    W, Omega, e = curve
    start = trace_log_of(identity(len(P)) + 0 * Omega + 0 * Omega * e)
    value = start - trace_log_of(W) + factor * log(1 + e * e / 4 * dot(P, b * P) + 0 * P[0])
    yield series(value), [0, 0, pairing(Omega, Omega) / 2 + dot(P, b * P) / 2]


@stated("clebsch-momentum", "Section 7, proof of Theorem 7.1")
def clebsch_momentum(W: Rotation, P: Vector, b: Diagonal, e: Eps) -> Sides:
    """M_(k+1) = d'_W Lambda = (2/eps)(W - I)/(W + I), W = cay(eps/2 M_(k+1)); grad_P Lambda = eps BP/(1 + eps^2/4 <P, BP>)"""
    M1 = 2 / e * half(W)
    yield right_derivative(lambda x: -trace_log_of(x) / e, W), M1
    yield cayley(e / 2 * M1), W
    force = gradient(lambda v: 2 / e * log(1 + e * e / 4 * dot(v, b * v)), P)
    yield force, e * b * P / (1 + e * e / 4 * dot(P, b * P))


def printed_lagrangian(g: Array, h: Array, p: Array, *, b: Array, eps: Any) -> Any:
    """(dClebsch spec Lagr) with 4/eps, as printed."""
    P = act(g.T, p)
    return -trace_log_of(g.T @ h) / eps + 4 / eps * log(clebsch.denominator(P, b=b, eps=eps))


printed_law("theorem-7.1", CLEBSCH, "discrete-euler-lagrange", lagrangian=printed_lagrangian)


def printed_pencil(M: Array, P: Array, *, b: Array, lam: Any, eps: Any) -> Array:
    """The Lax matrix with S = I + (eps^2/4) B whatever |P|, as printed."""
    S = 1 + eps * eps / 4 * b
    return clebsch.pencil(M, clebsch.shifted(M, P, eps=eps), b, lam) / S[..., :, None]


printed_law("theorem-7.1-lax", CLEBSCH, "discrete-lax-equation", lax=printed_pencil)


@stated(
    "clebsch-completeness",
    'Section 7, Theorem 7.1, "completely integrable"',
    printed={"distinct": False},
    ranks=True,
)
def clebsch_completeness(s: Setting, b: Diagonal, M: Skew, P: Unit, distinct: bool = True) -> Sides:
    """det(L_k(lambda) - mu) has half the dimension of the leaf, 2, 4, 6, 9 for n = 3...6, for distinct b; not if three coincide (E17)"""
    if not distinct:
        b[1] = b[2] = b[0]

    def coefficients(*z: Array) -> Array:
        at = (s.lam + k for k in range(s.n + 2))  # of degrees -1 ... n in lambda
        rows = [characteristic(printed_pencil(*z, b=b, lam=lam, eps=s.eps))[1:] for lam in at]
        return np.concatenate([np.asarray(row, dtype=object) for row in rows])

    yield statements.rank_on_leaf(CLEBSCH, (M, P), [coefficients]), statements.HALF_LEAF[s.n]


@stated("clebsch-two-maps", "Conclusion, last remark", ranks=True)
def clebsch_two_maps(s: Setting, M: Skew, P: Vector, J: Diagonal, e: Eps) -> Sides:
    """both discretized flows have the Lax matrix with A = J^2, but the maps have different integrals: the rank of both is the dimension of the leaf, 4, 8, 12, 18, of each half of it"""
    body, c = {"b": J * J}, 1 / (J[:, None] + J)
    yield clebsch.lax(M, P, lam=s.lam, **body)[0], clebsch_body.lax(M, P, J=J, c=c, lam=s.lam)[0]

    def earlier(M: Array, P: Array) -> Array:
        return clebsch_body.SYSTEM.integrals["spectrum"](M, P, J=J)

    def deformed(M: Array, P: Array) -> Array:
        return clebsch.spectrum(M, P, eps=e, **body)

    ranks = [
        statements.rank_on_leaf(CLEBSCH, (M, P), chosen) for chosen in ([earlier], [deformed], [earlier, deformed])
    ]
    yield ranks, statements.HALF_LEAF[s.n] * np.array([1, 1, 2])


# -- proof of Theorem 7.1: the identities (dClebsch spec aux) --------------------------------------


class Step:
    """A step of the map and the matrices of the proof, P = P_k, |P| = 1 unless `unit` is False."""

    def __init__(self, s: Setting, unit: bool = True):
        self.e, self.b, self.identity = s.eps, s.diagonal(), identity(s.n)
        self.M, self.P = s.skew(), s.unit() if unit else s.vector()
        self.M1, P1 = clebsch.MAP.step(self.M, self.P, b=self.b, eps=self.e)
        self.dM, S = self.M1 - self.M, self.identity + self.e**2 / 4 * diagonal(self.b)
        den = clebsch.denominator(self.P, b=self.b, eps=self.e)
        self.Q, self.R = outer(self.P) @ S / den, S @ outer(self.P) / den
        self.script, self.script1 = (
            (self.identity + self.e / 2 * M) @ outer(P) @ (self.identity - self.e / 2 * M)  # (dClebsch spec P)
            for M, P in ((self.M, self.P), (self.M1, P1))
        )


Proof = Annotated[Any, Step]


@stated("clebsch-aux1", "Section 7, (dClebsch spec aux1)")
def aux1(k: Proof, lam: Lam) -> Sides:
    """(I - eps/(2 lambda) R)(lambda B + M_(k+1) + P_(k+1)/lambda)(I + eps/(2 lambda) Q) = the same with signs turned, M_k, P_k; |P| = 1"""
    B, turn = lam * diagonal(k.b), k.e / (2 * lam)
    new, old = B + k.M1 + k.script1 / lam, B + k.M + k.script / lam
    yield (
        (k.identity - turn * k.R) @ new @ (k.identity + turn * k.Q),
        (k.identity + turn * k.R) @ old @ (k.identity - turn * k.Q),
    )


@stated("clebsch-aux3", "Section 7, (dClebsch spec aux3)")
def aux3(k: Proof) -> Sides:
    """lambda^0: M_(k+1) - M_k = eps (R_k B - B Q_k)"""
    yield k.dM, k.e * (k.R * k.b - k.b[:, None] * k.Q)


@stated("clebsch-aux4", "Section 7, (dClebsch spec aux4)")
def aux4(k: Proof) -> Sides:
    """lambda^-1: P_(k+1) - P_k = (eps/2) R_k (M_(k+1) + M_k) - (eps/2)(M_(k+1) + M_k) Q_k, script P"""
    yield k.script1 - k.script, k.e / 2 * (k.R @ (k.M1 + k.M) - (k.M1 + k.M) @ k.Q)


@stated("clebsch-aux5", "Section 7, (dClebsch spec aux5)")
def aux5(k: Proof) -> Sides:
    """lambda^-2: (P_(k+1) + P_k) Q_k - R_k (P_(k+1) + P_k) = (eps/2) R_k dM Q_k = 0"""
    left = (k.script1 + k.script) @ k.Q - k.R @ (k.script1 + k.script)
    yield left, k.e / 2 * k.R @ k.dM @ k.Q
    yield left, 0 * left


@stated("clebsch-aux6", "Section 7, (dClebsch spec aux6)", printed={"order": 2})
def aux6(s: Setting, k: Proof, e: Eps, lam: Lam, order: int = 3) -> Sides:
    """R_k (P_(k+1) - P_k) Q_k = 0; it is at lambda^-3 of (aux1), aux3 to aux5 at 0, -1, -2 (printed lambda^-2, E5)"""
    value = k.R @ (k.script1 - k.script) @ k.Q
    yield value, 0 * value
    B, R, Q, M, M1, P, P1 = (s.draw((s.n, s.n)) for _ in range(7))  # (aux1) for any matrices in the powers of lambda
    unit, t = identity(s.n), e / 2
    new = (unit - t / lam * R) @ (lam * B + M1 + P1 / lam) @ (unit + t / lam * Q)
    old = (unit + t / lam * R) @ (lam * B + M + P / lam) @ (unit - t / lam * Q)
    at_0 = M1 - M - 2 * t * (R @ B - B @ Q)
    at_1 = P1 - P - t * (R @ (M1 + M) - (M1 + M) @ Q)
    at_2 = t * ((P1 + P) @ Q - R @ (P1 + P)) - t**2 * R @ (M1 - M) @ Q
    yield new - old, at_0 + at_1 / lam + at_2 / lam**2 - t**2 * R @ (P1 - P) @ Q / lam**order


@stated("clebsch-aux8", "Section 7, (dClebsch spec aux8)", printed={"unit": False})
def aux8(s: Setting, unit: bool = True) -> Sides:
    """Q_k = P P^T (I + eps/4 dM), R_k = (I - eps/4 dM) P P^T, Q_k^2 = Q_k; |P| = 1 (E10)"""
    k = Step(s, unit)
    yield k.Q, outer(k.P) @ (k.identity + k.e / 4 * k.dM)
    yield k.R, (k.identity - k.e / 4 * k.dM) @ outer(k.P)
    yield k.Q @ k.Q, k.Q


@stated("clebsch-aux9", "Section 7, (dClebsch spec aux9)")
def aux9(k: Proof) -> Sides:
    """P_(k+1) = (I - eps/2 M_(k+1)) P_k P_k^T (I + eps/2 M_(k+1)), script P on the left"""
    yield k.script1, (k.identity - k.e / 2 * k.M1) @ outer(k.P) @ (k.identity + k.e / 2 * k.M1)


@stated("clebsch-last-display", "Section 7, last display of the proof", printed={"factor": 1})
def last_display(k: Proof, factor: int = 2) -> Sides:
    """(P_(k+1) + P_k) Q_k = R_k (P_(k+1) + P_k) = 2 (I - eps/4 dM) P P^T (I + eps/4 dM) (E3: the 2)"""
    right = factor * (k.identity - k.e / 4 * k.dM) @ outer(k.P) @ (k.identity + k.e / 4 * k.dM)
    yield (k.script1 + k.script) @ k.Q, right
    yield k.R @ (k.script1 + k.script), right


# -- end of section 7: Neumann's system on the smallest leaf ---------------------------------------


def leaf_point(s: Setting) -> tuple[Array, Array]:
    """x and q with |x| = 1 and <x, q> = 0."""
    x, q = s.unit(), s.vector()
    return x, q - x * dot(x, q)


Leaf = Annotated[Any, leaf_point]


@stated("neumann-leaf", "Section 7, end, the smallest leaf", printed={"codimension": 0}, ranks=True)
def neumann_leaf(z: Leaf, codimension: int = 2) -> Sides:
    """at M = x ^ q, P = x the bracket has rank 2(n - 1) (printed 2n, E6)"""
    x, q = z
    yield statements.rank(CLEBSCH.space.tensor(wedge(x, q), x)), 2 * len(x) - codimension


@stated("neumann-flow", "Section 7, end, Neumann's system", printed={"sign": -1})
def neumann_flow(z: Leaf, b: Diagonal, sign: int = 1) -> Sides:
    """P = x, M = x ^ q: x' = q, q' = Bx - (...)x, that is the potential energy -<x, Bx>/2 (printed +, E7)"""
    x, q = z
    force = sign * b * x  # minus the gradient of -sign <x, Bx>/2
    x_rate, q_rate = q, force - (dot(x, force) + dot(q, q)) * x
    M, (M_rate, P_rate) = wedge(x, q), clebsch.flow(wedge(x, q), x, b=b)
    yield P_rate, x_rate
    yield M_rate, wedge(x_rate, q) + wedge(x, q_rate)
    yield -act(M_rate, x) - act(M, P_rate), q_rate  # q = -M x; wedged only with x the multiplier is free
    if sign > 0:
        yield from zip(neumann.flow(x, q, b=b), (x_rate, q_rate), strict=True)
