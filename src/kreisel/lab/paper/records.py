"""The records against the paper: the systems that it only names, and functions against the printed formulas."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array, act, axial, bracket, cayley, dot, hat, identity, log, mat, solve
from kreisel.algebra.invariants import characteristic, trace
from kreisel.algebra.matrices import diagonal, su2
from kreisel.lab.law import Sides
from kreisel.lab.paper.clebsch import printed_pencil
from kreisel.lab.paper.statements import Setting, half, outer, stated, stated_law, trace_log_of
from kreisel.record.contract import System
from kreisel.system import (
    REGISTRY,
    clebsch,
    clebsch_general,
    heavy_top,
    kirchhoff,
    lagrange_top,
    lagrange_top_moving,
    lagrange_top_su2,
    lagrange_top_su2_moving,
    neumann,
)

# -- the systems that the Introduction and the Conclusions name ------------------------------------


EARLIER = "Introduction, the map of Bobenko and Suris 1999"
ONE = identity(2)

# -- SU(2) -----------------------------------------------------------------------------------------------


@stated("su2-rest-frame", EARLIER, dimensions=(3,))
def su2_rest(s: Setting) -> Sides:
    """in 2 x 2 matrices m1 = m + eps [p, a], a1 (1 + eps m1) = (1 + eps m1) a is the case n = 3 of (dLT rest frame)"""
    m, a, p = s.skew(), s.vector(), s.vector()
    m1, a1 = lagrange_top.step(m, a, p=p, eps=s.eps)
    yield su2(axial(m1)), su2(axial(m)) + s.eps * bracket(su2(p), su2(a))
    turn = ONE + su2(s.eps * axial(m1))
    yield su2(a1) @ turn, turn @ su2(a)


@stated("su2-moving-frame", EARLIER, dimensions=(3,))
def su2_moving(s: Setting) -> Sides:
    """M = (alpha/eps) (W - W^-1)/tr W + (2(1 - alpha)/eps) [A, A1]/(|A|^2 + <A, A1>), A1 = W A W^-1; P1 = W^-1 P W, M1 = W^-1 M W + eps [P1, A] is the case n = 3 of (dmLT body)"""
    M, P, A, alpha = s.skew(), s.vector(), s.vector(), -s.sign * abs(s.scalar())
    M1, P1 = lagrange_top_moving.step(M, P, A=A, alpha=alpha, eps=s.eps)
    X = lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=s.eps)
    w = su2(2 * axial(X))
    W, A1 = ONE + w, act(cayley(X), A)  # up to a factor
    yield W @ su2(A), su2(A1) @ W
    force = bracket(su2(A), su2(A1)) * mat(2 * (1 - alpha) / (dot(A, A) + dot(A, A1)))
    yield s.eps * su2(axial(M)), alpha * w + force  # (W - W^-1)/tr W = w
    yield W @ su2(P1), su2(P) @ W
    yield W @ (su2(axial(M1)) - s.eps * bracket(su2(P1), su2(A))), su2(axial(M)) @ W


@stated("su2-trace", EARLIER, dimensions=(3,))
def su2_trace(s: Setting) -> Sides:
    """for the rotation R that w in SU(2) covers, det(2 + R + R^T) = 4 (tr w)^4 and 1 + tr R = (tr w)^2"""
    v = s.vector()
    R, square = cayley(hat(v)), 4 / (1 + dot(v, v))  # w = (1 + 2v)/sqrt(1 + |v|^2) in su(2)
    yield 1 + trace(R), square
    yield -characteristic(2 * identity(3) + R + R.mT)[3], 4 * square * square


for name, system in (
    ("su2-rest-frame-laws", lagrange_top_su2.SYSTEM),
    ("su2-moving-frame-laws", lagrange_top_su2_moving.SYSTEM),
):
    stated_law(
        name,
        EARLIER,
        "Poisson, deformed integrals, Lax pair in 2 x 2 matrices, from the Lagrangian with log tr w",
        system,
        ("poisson", "integrals-of-the-map", "discrete-lax-equation", "discrete-euler-lagrange", "relations"),
        dimensions=(3,),
    )

# -- further systems -------------------------------------------------------------------------------------

FLOWS = ("hamiltonian-flow", "integrals-of-the-flow")
COMPLETE = (*FLOWS, "involution", "lax-equation")
CONTINUOUS = {
    "euler-top": ("Introduction, the Euler top in n dimensions", COMPLETE),
    "manakov-top": ("Introduction, the Euler top in n dimensions", COMPLETE),
    "quadratic-potential": ("Introduction, the rigid body in a quadratic potential", COMPLETE),
    "clebsch-body": ("Section 7, the other flow of Clebsch's case", COMPLETE),
    "kovalevskaya-top": ("Introduction, Kovalevskaya's top", COMPLETE),
    "kovalevskaya-gyrostat": ("Introduction, Kovalevskaya's top", COMPLETE),
    "goryachev-chaplygin": ("Introduction, Goryachev and Chaplygin", (*FLOWS, "involution")),
    "hess-appelrot": ("Introduction, Hess and Appelrot", (*FLOWS, "invariant-relations")),
    "kirchhoff-case": ("Introduction, Kirchhoff's case", (*FLOWS, "involution")),
    "kirchhoff-revolution": ("Introduction, Kirchhoff's case", COMPLETE),
    "steklov": ("Conclusions, Steklov's case", (*COMPLETE, "relations")),
    "lyapunov": ("Conclusions, Lyapunov's case", (*COMPLETE, "relations")),
    "steklov-lyapunov": ("Conclusions, Steklov's and Lyapunov's cases", COMPLETE),
    "ratiu-top": ("Conclusions, Ratiu's Lagrange top", COMPLETE),
    "ratiu-bitop": ("Conclusions, Ratiu's Lagrange top", COMPLETE),
    "rosochatius": ("Section 7, end, next to Neumann's system", COMPLETE),
}
MAPS = {
    "euler-top": ("Introduction, the discrete Euler top of Veselov, Moser and Veselov", True),
    "quadratic-potential": ("Introduction, the earlier paper's discretization", True),
    "clebsch-body": ("Conclusions, the other discretization of Clebsch's case", True),
    "neumann-veselov": ("Introduction, Veselov's discretization of Neumann's system", True),
    "rosochatius": ("Section 7, end, next to Neumann's system", True),
    "ratiu-bitop": ("Conclusions, a map for n = 4", False),
    "kirchhoff-revolution": ("Introduction, Kirchhoff's case", False),
}


def sizes(system: System) -> tuple[int, ...]:
    """The dimensions of a statement: two, since the laws of the registry go further."""
    return (3, 4) if system.n is None else (system.n,)


for name, (place, names) in CONTINUOUS.items():
    system = REGISTRY[name]
    claims = "Hamiltonian; integrals" + (" in involution; Lax pair" if "lax-equation" in names else "")
    stated_law(f"{name}-flow", place, f"{system.equations}: {claims}", system, names, dimensions=sizes(system))
for name, (place, commutes) in MAPS.items():
    system = REGISTRY[name]
    stated_law(
        f"{name}-map",
        place,
        "the map is Poisson, conserves its integrals and has a Lax pair"
        + ("; it commutes with the flow and with itself at other steps" if commutes else ""),
        system,
        ("poisson", "integrals-of-the-map", "discrete-lax-equation", *(["commuting-maps"] if commutes else [])),
        numbers=("float",),
        dimensions=sizes(system),
    )


# -- the printed formulas, written out in matrices and entries -------------------------------------


def _wedge(x: Array, y: Array) -> Array:  # x ^ y = x y^T - y x^T
    return x[:, None] * y - y[:, None] * x


def _square(M: Array) -> Any:  # <M, M> = sum over j < k of M_jk^2
    return (M * M)[np.triu_indices(len(M), 1)].sum()


def _pairs(M: Array, N: Array) -> Any:
    return (M * N)[np.triu_indices(len(M), 1)].sum()


def _block(M: Array, column: Array, row: Array) -> Array:
    out = np.zeros((len(M) + 1, len(M) + 1), dtype=M.dtype)
    out[:-1, :-1], out[:-1, -1], out[-1, :-1], out[-1, -1] = M, column, row, 0 * column[0]
    return out


def _cayley_of(X: Array, V: Array) -> Sides:
    """V = (I + X)/(I - X)."""
    one = identity(len(X))
    yield V @ (one - X), one + X


@stated("record-heavy-top", "Section 4, (mLT left), its Hamilton function")
def record_heavy_top(s: Setting) -> Sides:
    """flow, energy and velocity of the record: H = sum of M_jk^2/(J_j + J_k)/2 over j < k + sum P_k A_k"""
    M, P, A, J = s.skew(), s.vector(), s.vector(), abs(s.diagonal()) + 1
    known = heavy_top.principal(J=diagonal(J))
    Omega = M / (J[:, None] + J)
    yield heavy_top.velocity(M, P, **known), Omega
    rate = heavy_top.flow(M, P, A=A, **known)
    yield rate[0], M @ Omega - Omega @ M + _wedge(A, P)
    yield rate[1], -(Omega @ P)
    yield np.asarray(heavy_top.energy(M, P, A=A, **known)), np.asarray(_pairs(M, Omega) / 2 + (P * A).sum())


@stated(
    "record-lagrange-top",
    "Sections 5 and 6.1: (mLT right), its H, l and u; (dLT rest frame), (dLT rest H), l_k, v_k, b_k",
)
def record_lagrange_top(s: Setting) -> Sides:
    """flow, energy, step, deformed energy and both Lax pairs of the record, |a| = 1"""
    m, a, p, e, lam = s.skew(), s.unit(), s.vector(), s.eps, s.lam
    rate = lagrange_top.flow(m, a, p=p)
    yield rate[0], _wedge(a, p)
    yield rate[1], m @ a
    H = _square(m) / 2 + (a * p).sum()
    yield np.asarray(lagrange_top.energy(m, a, p=p)), np.asarray(H)
    yield np.asarray(lagrange_top.energy(m, a, p=p, eps=e)), np.asarray(H - e / 2 * _pairs(m, _wedge(p, a)))
    l, u = lagrange_top.lax(m, a, p=p, lam=lam)  # noqa: E741 - the paper's letter
    yield l, _block(m, lam * a - p / lam, lam * a - p / lam)
    yield u, _block(0 * m, lam * a, lam * a)
    m1, a1 = lagrange_top.step(m, a, p=p, eps=e)
    yield m1, m + e * _wedge(a, p)
    yield a1 - e / 2 * (m1 @ a1), a + e / 2 * (m1 @ a)
    b = a - e / 2 * (m @ a) + e * e / 4 * p
    yield lagrange_top.lax_matrix(m, a, p=p, lam=lam, eps=e), _block(m, lam * b - p / lam, lam * b - p / lam)
    yield from _cayley_of(e / 2 * _block(0 * m, lam * a, lam * a), lagrange_top.conjugator(m, a, p=p, lam=lam, eps=e))


@stated(
    "record-lagrange-top-moving",
    "Sections 5 and 6.2: (mLT left), (mLT operator inv1), L and U; (dmLT body), (dmLT W thru M), Hbar_eps, L_k, V_k, B_k",
)
def record_lagrange_top_moving(s: Setting) -> Sides:
    """velocity, flow, energy, step, deformed energy less the energy of the spin (E16) and both Lax pairs of the record, with +lambda A^T in U (E2), |A| = 1"""
    W, P, A, alpha, e, lam = s.rotation(), s.vector(), s.unit(), s.scalar(), s.eps, s.lam
    one, WA = identity(s.n), W @ A
    M = 2 * alpha / e * half(W) - 2 * (1 - alpha) / e * _wedge(A, WA) / (1 + (A * WA).sum())
    known = {"A": A, "alpha": alpha}
    Omega = lagrange_top_moving.velocity(M, P, **known)
    yield alpha * Omega + (1 - alpha) * (Omega @ outer(A) + outer(A) @ Omega), M
    rate = lagrange_top_moving.flow(M, P, **known)
    yield rate[0], M @ Omega - Omega @ M + _wedge(A, P)
    yield rate[1], -(Omega @ P)
    H, across = _pairs(M, Omega) / 2 + (P * A).sum(), one - outer(A)
    yield np.asarray(lagrange_top_moving.energy(M, P, **known)), np.asarray(H)
    spin = (1 / alpha - 1) * _square(across @ M @ across) / 2
    Hbar = _square(M) / 2 + (P * A).sum() + e / 2 * _pairs(M, _wedge(P, A))
    yield np.asarray(lagrange_top_moving.energy(M, P, eps=e, **known) - spin), np.asarray(Hbar)
    L, U = lagrange_top_moving.lax(M, P, lam=lam, **known)
    yield L, _block(M, lam * A - P / lam, lam * A - P / lam)
    yield U, _block(Omega, lam * A, lam * A)
    M1, P1 = lagrange_top_moving.step(M, P, eps=e, **known)
    yield P1, W.T @ P
    yield M1, W.T @ M @ W + e * _wedge(A, P1)
    B = A + e / 2 * (M @ A) + e * e / 4 * P
    yield lagrange_top_moving.lax_matrix(M, P, A=A, lam=lam, eps=e), _block(M, lam * B - P / lam, lam * B - P / lam)
    back = _block(W.T, 0 * A, 0 * A)
    back[-1, -1] = 1 + 0 * A[0]
    V = lagrange_top_moving.conjugator(M, P, lam=lam, eps=e, **known)
    yield from _cayley_of(e / 2 * _block(0 * M, lam * A, lam * A), back @ V)


@stated("record-kirchhoff", "Section 7, (Kirch), its Hamilton function; Clebsch's L and U")
def record_kirchhoff(s: Setting) -> Sides:
    """flow and energy of both records, L = lambda A + M + P P^T/lambda, U = lambda B + Omega with c_jk = (b_j - b_k)/(a_j - a_k)"""
    M, P, a, b = s.skew(), s.vector(), s.diagonal(), s.vector()
    c = (b[:, None] - b + identity(s.n)) / (a[:, None] - a + identity(s.n))
    Omega = c * M
    H = (c * M * M)[np.triu_indices(s.n, 1)].sum() / 2 - (b * P * P).sum() / 2
    rates = M @ Omega - Omega @ M + _wedge(P, b * P), -(Omega @ P)
    own = {"b": b, "c": clebsch_general.quotients(a=a, b=b)["c"]}
    for record, known in ((kirchhoff, {"C": c, "B": diagonal(b)}), (clebsch_general, own)):
        rate = record.flow(M, P, **known)
        yield rate[0], rates[0]
        yield rate[1], rates[1]
        yield np.asarray(record.energy(M, P, **known)), np.asarray(H)
    L, U = clebsch_general.lax(M, P, a=a, lam=s.lam, **own)
    yield L, s.lam * diagonal(a) + M + outer(P) / s.lam
    yield U, s.lam * diagonal(b) + Omega


@stated("record-clebsch", "Section 7: (Clebsch spec), its H, L and U+; (dClebsch spec), L_k, V_k")
def record_clebsch(s: Setting) -> Sides:
    """flow, energy, step and both Lax pairs of the record, |P| = 1"""
    M, P, b, e, lam = s.skew(), s.unit(), s.diagonal(), s.eps, s.lam
    one, B = identity(s.n), diagonal(b)
    rate = clebsch.flow(M, P, b=b)
    yield rate[0], _wedge(P, b * P)
    yield rate[1], -(M @ P)
    yield np.asarray(clebsch.energy(M, P, b=b)), np.asarray(_square(M) / 2 - (b * P * P).sum() / 2)
    L, U = clebsch.lax(M, P, b=b, lam=lam)
    yield L, lam * B + M + outer(P) / lam
    yield U, lam * B + M
    M1, P1 = clebsch.step(M, P, b=b, eps=e)
    divisor = 1 + e * e / 4 * (b * P * P).sum()
    yield M1, M + e / divisor * _wedge(P, b * P)
    yield P1 + e / 2 * (M1 @ P1), P - e / 2 * (M1 @ P)
    script = (one + e / 2 * M) @ outer(P) @ (one - e / 2 * M)
    Lk = clebsch.lax_matrix(M, P, b=b, lam=lam, eps=e)
    yield (one + e * e / 4 * B) @ Lk, lam * B + M + script / lam
    X = e / (2 * lam * divisor) * outer(P) @ (one + e * e / 4 * B)
    back = clebsch.conjugator(M, P, b=b, lam=lam, eps=e)  # V_k^-1
    yield from _cayley_of(-X, back)


@stated("record-clebsch-energy", "Section 7, Theorem 7.1, det(L_k(lambda) - mu)")
def record_clebsch_energy(s: Setting) -> Sides:
    """the deformed energy of the record is -(1/2) sum b_i F_i with det(L_k(lambda) - lambda nu) = lambda^n det(S^-1 D) (1 + sum F_i/D_i/lambda^2 + ...), D = B - nu S, S = I + (eps^2/4) B, |P| = 1"""
    M, P, b, e = s.skew(), s.unit(), s.diagonal(), s.eps
    S = 1 + e * e / 4 * b
    rows, values = [], []
    for k in range(s.n):
        nu = s.lam + k
        D = b - nu * S
        scaled = [_scaled_determinant(M, P, b, e, nu, t) for t in range(1, s.n // 2 + 3)]
        rows.append(1 / D)
        values.append(_second_coefficient(scaled) * np.prod(S) / np.prod(D))
    F = _solved(np.array(rows), np.array(values))
    yield np.asarray(clebsch.energy(M, P, b=b, eps=e)), np.asarray(-(b * F).sum() / 2)
    x, q = P, P @ M  # M of the leaf: x ^ q with <x, q> = 0
    q = q - x * (x * q).sum()
    leaf = clebsch.energy(_wedge(x, q), x, b=b, eps=e)
    yield np.asarray(neumann.energy(x, q, b=b, eps=e)), np.asarray(leaf)


def _scaled_determinant(M: Array, P: Array, b: Array, eps: Any, nu: Any, t: int) -> Any:
    """det(t L_k(1/t) - nu), a polynomial in t^2 of degree (n + 1)/2 or less."""
    X = t * printed_pencil(M, P, b=b, lam=(1 + 0 * eps) / t, eps=eps) - nu * identity(len(b))
    return (-1) ** len(b) * characteristic(X)[-1]


def _second_coefficient(values: list[Any]) -> Any:
    """That of t^2 in a polynomial in t^2 from its values at t = 1, 2, ...."""
    V = np.array([[(1 + 0 * values[0]) * t ** (2 * j) for j in range(len(values))] for t in range(1, len(values) + 1)])
    return _solved(V, np.array(values))[1]


def _solved(A: Array, y: Array) -> Array:
    return solve(A, y[:, None])[:, 0]


@stated("record-spectra", "Sections 5, 6.1, 6.2 and 7: det(l_k(lambda) - mu), det(L_k(lambda) - mu)")
def record_spectra(s: Setting) -> Sides:
    """the integrals `spectrum` of the records are coefficients in lambda and mu of the characteristic polynomials of the printed matrices"""
    m, a, p, e = s.skew(), s.unit(), s.vector(), s.eps
    for eps in (0 * e, e):
        b = a - eps / 2 * (m @ a) + eps * eps / 4 * p
        yield from _bordered(s, m, b, p, lagrange_top.spectrum(m, a, p=p, eps=eps), True)
        B = a + eps / 2 * (m @ a) + eps * eps / 4 * p
        yield from _bordered(s, m, B, p, lagrange_top_moving.spectrum(m, p, A=a, eps=eps), False)
        kappa, Q, mu = eps * eps / 4, a + eps / 2 * (m @ a), s.scalar()
        d = s.diagonal() / 4
        for spectrum, at in (
            (clebsch.spectrum(m, a, b=d, eps=eps), kappa),
            (clebsch_general.spectrum(m, a, a=d), 0 * e),
        ):
            Q = Q if at is kappa else a
            lam = abs(s.lam) + 1
            nu, S = lam - at * mu, 1 + at * d
            L = (lam * diagonal(d) + m + outer(Q) / lam) / S[:, None]
            whole = lam * np.prod(S) * _at(characteristic(L), mu) - lam * np.prod(mu - nu * d)
            places = [(k, i) for k in range(1, s.n + 1) for i in range(k - 1, -1, -2)]
            terms = [v * mu ** (s.n - k) * nu**i for v, (k, i) in zip(spectrum, places, strict=True)]
            yield np.asarray(whole), np.asarray(sum(terms))


def _at(coefficients: list[Any], mu: Any) -> Any:
    value = coefficients[0]
    for c in coefficients[1:]:
        value = value * mu + c
    return value


def _bordered(s: Setting, m: Array, b: Array, p: Array, spectrum: Array, whole: bool) -> Sides:
    """Coefficients of mu^(n-1-k): -lambda^2 x + y - z/lambda^2, of which some records leave out the Casimirs z."""
    rest, one, two = list(spectrum), abs(s.lam) + 1, abs(s.lam) + 2
    found = [characteristic(_block(m, lam * b - p / lam, lam * b - p / lam)) for lam in (one, two)]
    for k in range(0, s.n, 2):
        x, y = rest.pop(0), rest.pop(0)
        f, g = (np.asarray(lam * lam * c[k + 2]) for lam, c in zip((one, two), found, strict=True))
        yield f - g, np.asarray(-(one**4 - two**4) * x + (one**2 - two**2) * y)
        if whole and k:
            yield f, np.asarray(-(one**4) * x + one**2 * y - rest.pop(0))


@stated(
    "record-lagrangians",
    "Sections 6.1, 6.2 and 7: (dmLT Lagr 1), (dmLT Lagr body), (dClebsch spec Lagr)",
    numbers=("float",),
)
def record_lagrangians(s: Setting) -> Sides:
    """the discrete Lagrangians of the records, |A| = 1, with 2/eps for Clebsch's (E1)"""
    g, h, A, p, b, e = s.rotation(), s.rotation(), s.unit(), s.vector(), abs(s.vector()), abs(s.eps)
    h, alpha = g @ _near(h), abs(s.scalar()) + 1 / 2
    w, W, a, P = h @ g.T, g.T @ h, g @ A, g.T @ p
    top = -alpha / e * trace_log_of(w) - 2 * (1 - alpha) / e * log(1 + dot(a, w @ a)) - e * dot(p, a)
    yield np.asarray(lagrange_top.lagrangian(g, h, A, p=p, alpha=alpha, eps=e)), np.asarray(top)
    body = -alpha / e * trace_log_of(W) - 2 * (1 - alpha) / e * log(1 + dot(A, W @ A)) - e * dot(P, W @ A)
    yield np.asarray(lagrange_top_moving.lagrangian(g, h, p, A=A, alpha=alpha, eps=e)), np.asarray(body)
    fluid = -trace_log_of(W) / e + 2 / e * log(1 + e * e / 4 * (b * P * P).sum())
    yield np.asarray(clebsch.lagrangian(g, h, p, b=b, eps=e)), np.asarray(fluid)


def _near(h: Array) -> Array:
    """A rotation by less than half a revolution."""
    X = half(h) / 4
    one = identity(len(h))
    return np.linalg.solve(one - X, one + X)
