"""The records against the paper: the systems that it only names, and functions against the printed formulas."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import system as systems
from kreisel.algebra import Array, act, axial, bracket, cayley, dot, hat, identity, log, mat, solve
from kreisel.algebra.invariants import characteristic, diagonal, su2, trace
from kreisel.lab.exact import generator
from kreisel.lab.law import Sides
from kreisel.lab.paper.fields import FAMILY, FIELDS
from kreisel.lab.paper.setting import Diagonal, Eps, Lam, Rotation, Scalar, Setting, Skew, Unit, Vector
from kreisel.lab.paper.statements import half, series, stated, stated_laws, trace_log_of
from kreisel.lab.paper.tops import momentum
from kreisel.system import clebsch, clebsch_general, heavy_top, kirchhoff, lagrange_top, lagrange_top_moving, neumann
from kreisel.system.clebsch_body import outer

EARLIER = "Introduction, the map of Bobenko and Suris 1999"
ONE = identity(2)

# -- SU(2) -----------------------------------------------------------------------------------------------


@stated("su2-rest-frame", EARLIER, dimensions=(3,))
def su2_rest(m: Skew, a: Vector, p: Vector, e: Eps) -> Sides:
    """in 2 x 2 matrices m1 = m + eps [p, a], a1 (1 + eps m1) = (1 + eps m1) a is the case n = 3 of (dLT rest frame)"""
    m1, a1 = lagrange_top.MAP.step(m, a, p=p, eps=e)
    yield su2(axial(m1)), su2(axial(m)) + e * bracket(su2(p), su2(a))
    turn = ONE + su2(e * axial(m1))
    yield su2(a1) @ turn, turn @ su2(a)


@stated("su2-moving-frame", EARLIER, dimensions=(3,))
def su2_moving(s: Setting, M: Skew, P: Vector, A: Vector, e: Eps) -> Sides:
    """M = (alpha/eps) (W - W^-1)/tr W + (2(1 - alpha)/eps) [A, A1]/(|A|^2 + <A, A1>), A1 = W A W^-1; P1 = W^-1 P W, M1 = W^-1 M W + eps [P1, A] is the case n = 3 of (dmLT body)"""
    alpha = -s.sign * abs(s.scalar())
    M1, P1 = lagrange_top_moving.step(M, P, A=A, alpha=alpha, eps=e)
    X = lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=e)
    w = su2(2 * axial(X))
    W, A1 = ONE + w, act(cayley(X), A)  # up to a factor
    yield W @ su2(A), su2(A1) @ W
    force = bracket(su2(A), su2(A1)) * mat(2 * (1 - alpha) / (dot(A, A) + dot(A, A1)))
    yield e * su2(axial(M)), alpha * w + force  # (W - W^-1)/tr W = w
    yield W @ su2(P1), su2(P) @ W
    yield W @ (su2(axial(M1)) - e * bracket(su2(P1), su2(A))), su2(axial(M)) @ W


@stated("su2-trace", EARLIER, dimensions=(3,))
def su2_trace(v: Vector) -> Sides:
    """for the rotation R that w in SU(2) covers, det(2 + R + R^T) = 4 (tr w)^4 and 1 + tr R = (tr w)^2"""
    R, square = cayley(hat(v)), 4 / (1 + dot(v, v))  # w = (1 + 2v)/sqrt(1 + |v|^2) in su(2)
    yield 1 + trace(R), square
    yield -characteristic(2 * identity(3) + R + R.mT)[3], 4 * square * square


# -- further systems -------------------------------------------------------------------------------------

FLOW = "hamiltonian-flow integrals-of-the-flow"
COMPLETE = f"{FLOW} involution lax-equation"
FLOWS = {
    "euler-top": ("Introduction, the Euler top in n dimensions", COMPLETE),
    "manakov-top": ("Introduction, the Euler top in n dimensions", COMPLETE),
    "quadratic-potential": ("Introduction, the rigid body in a quadratic potential", COMPLETE),
    "clebsch-body": ("Section 7, the other flow of Clebsch's case", COMPLETE),
    "kovalevskaya-top": ("Introduction, Kovalevskaya's top", COMPLETE),
    "kovalevskaya-gyrostat": ("Introduction, Kovalevskaya's top", COMPLETE),
    "goryachev-chaplygin": ("Introduction, Goryachev and Chaplygin", f"{FLOW} involution"),
    "hess-appelrot": ("Introduction, Hess and Appelrot", f"{FLOW} invariant-relations"),
    "kirchhoff-case": ("Introduction, Kirchhoff's case", f"{FLOW} involution"),
    "kirchhoff-revolution": ("Introduction, Kirchhoff's case", COMPLETE),
    "steklov": ("Conclusions, Steklov's case", f"{COMPLETE} relations"),
    "lyapunov": ("Conclusions, Lyapunov's case", f"{COMPLETE} relations"),
    "steklov-lyapunov": ("Conclusions, Steklov's and Lyapunov's cases", COMPLETE),
    "ratiu-top": ("Conclusions, Ratiu's Lagrange top", COMPLETE),
    "ratiu-bitop": ("Conclusions, Ratiu's Lagrange top", COMPLETE),
    "rosochatius": ("Section 7, end, next to Neumann's system", COMPLETE),
    "komarov": (FAMILY, f"jacobi-identity casimirs {COMPLETE}"),
    "rubanovskii": ("Beyond the paper, Steklov's and Lyapunov's cases with a rotor", COMPLETE),
}
MAP = "poisson integrals-of-the-map discrete-lax-equation"
PENCIL = "poisson integrals-of-the-map involution discrete-lax-pencil"
MAPS = {
    "lagrange-top-su2": (EARLIER, f"{MAP} discrete-euler-lagrange relations"),
    "lagrange-top-su2-moving": (EARLIER, f"{MAP} discrete-euler-lagrange relations"),
    "euler-top": ("Introduction, the discrete Euler top of Veselov, Moser and Veselov", f"{MAP} commuting-maps"),
    "quadratic-potential": ("Introduction, the earlier paper's discretization", f"{MAP} commuting-maps"),
    "clebsch-body": ("Conclusions, the other discretization of Clebsch's case", f"{MAP} commuting-maps"),
    "neumann-veselov": ("Introduction, Veselov's discretization of Neumann's system", f"{MAP} commuting-maps"),
    "rosochatius": ("Section 7, end, next to Neumann's system", f"{MAP} commuting-maps"),
    "ratiu-bitop": ("Conclusions, a map for n = 4", MAP),
    "kirchhoff-revolution": ("Introduction, Kirchhoff's case", MAP),
    **dict.fromkeys(("quadratic-field", "kovalevskaya-top", "kovalevskaya-gyrostat"), (FIELDS, PENCIL)),
    **dict.fromkeys((f"kovalevskaya-top-{name}" for name in ("e3", "so3", "sp4")), (FIELDS, PENCIL)),
    **dict.fromkeys(("symmetric-top-logarithmic", "ratiu-top"), (FIELDS, PENCIL)),
}
CLAIMS = {  # of the laws, in words
    "hamiltonian-flow": "Hamiltonian",
    "integrals-of-the-flow": "integrals",
    "involution": "in involution",
    "lax-equation": "Lax pair",
    "poisson": "Poisson",
    "integrals-of-the-map": "conserves its integrals",
    "discrete-lax-equation": "has a Lax pair",
    "discrete-lax-pencil": "has a pencil as Lax pair: U L' = L V",
    "discrete-euler-lagrange": "comes from its Lagrangian",
    "commuting-maps": "commutes with the flow and with itself at other steps",
    "invariant-relations": "an invariant relation",
    "relations": "equals its related systems",
}
for kind, table in {"flow": FLOWS, "map": MAPS}.items():
    for system, (place, listed) in table.items():
        subject = systems.REGISTRY[system].equations if kind == "flow" else "the map"
        text = f"{subject}: {', '.join(CLAIMS[law] for law in listed.split() if law in CLAIMS)}"
        stated_laws({system: {(f"{system}-{kind}", place): (text, listed)}}, (3, 4))


# -- the printed formulas, written out in matrices and entries -------------------------------------


def _wedge(x: Array, y: Array) -> Array:  # x ^ y = x y^T - y x^T
    return x[:, None] * y - y[:, None] * x


def _pairs(M: Array, N: Array) -> Any:  # <M, N> = sum over j < k of M_jk N_jk
    return (M * N)[np.triu_indices(len(M), 1)].sum()


def _block(M: Array, v: Array) -> Array:
    return np.block([[M, v[:, None]], [v[None], 0 * v[:1, None]]])


def _cayley_of(X: Array, V: Array) -> Sides:
    """V = (I + X)/(I - X)."""
    unit = identity(len(X))
    yield V @ (unit - X), unit + X


@stated("record-heavy-top", "Section 4, (mLT left), its Hamilton function")
def record_heavy_top(M: Skew, P: Vector, A: Vector, J: Diagonal) -> Sides:
    """flow, energy and velocity of the record: H = sum of M_jk^2/(J_j + J_k)/2 over j < k + sum P_k A_k"""
    J = abs(J) + 1
    constants, Omega = heavy_top.principal(J=diagonal(J)), M / (J[:, None] + J)
    yield heavy_top.inverse_inertia(M, **constants), Omega
    rates = M @ Omega - Omega @ M + _wedge(A, P), -(Omega @ P)
    yield from zip(heavy_top.flow(M, P, A=A, **constants), rates, strict=True)
    yield heavy_top.energy(M, P, A=A, **constants), _pairs(M, Omega) / 2 + (P * A).sum()


@stated(
    "record-lagrange-top",
    "Sections 5 and 6.1: (mLT right), its H, l and u; (dLT rest frame), (dLT rest H), l_k, v_k, b_k",
)
def record_lagrange_top(m: Skew, a: Unit, p: Vector, e: Eps, lam: Lam) -> Sides:
    """flow, energy, step, deformed energy and both Lax pairs of the record, |a| = 1"""
    yield from zip(lagrange_top.flow(m, a, p=p), (_wedge(a, p), m @ a), strict=True)
    H = _pairs(m, m) / 2 + (a * p).sum()
    yield lagrange_top.energy(m, a, p=p), H
    yield lagrange_top.energy(m, a, p=p, eps=e), H - e / 2 * _pairs(m, _wedge(p, a))
    u = _block(0 * m, lam * a)
    yield from zip(lagrange_top.lax(m, a, p=p, lam=lam), (_block(m, lam * a - p / lam), u), strict=True)
    m1, a1 = lagrange_top.MAP.step(m, a, p=p, eps=e)
    yield m1, m + e * _wedge(a, p)
    yield a1 - e / 2 * (m1 @ a1), a + e / 2 * (m1 @ a)
    b = a - e / 2 * (m @ a) + e * e / 4 * p
    yield lagrange_top.lax_matrix(m, a, p=p, lam=lam, eps=e), _block(m, lam * b - p / lam)
    yield from _cayley_of(e / 2 * u, lagrange_top.conjugator(m, a, p=p, lam=lam, eps=e))


@stated(
    "record-lagrange-top-moving",
    "Sections 5 and 6.2: (mLT left), (mLT operator inv1), L and U; (dmLT body), (dmLT W thru M), Hbar_eps, L_k, V_k, B_k",
)
def record_lagrange_top_moving(W: Rotation, P: Vector, A: Unit, alpha: Scalar, e: Eps, lam: Lam) -> Sides:
    """velocity, flow, energy, step, deformed energy less the energy of the spin (E16) and both Lax pairs of the record, with +lambda A^T in U (E2), |A| = 1"""
    M, constants = momentum(W, A, alpha, e), {"A": A, "alpha": alpha}
    Omega = lagrange_top_moving.inverse_inertia(M, **constants)
    yield alpha * Omega + (1 - alpha) * (Omega @ outer(A) + outer(A) @ Omega), M
    rates = M @ Omega - Omega @ M + _wedge(A, P), -(Omega @ P)
    yield from zip(lagrange_top_moving.flow(M, P, **constants), rates, strict=True)
    H, across = _pairs(M, Omega) / 2 + (P * A).sum(), identity(len(A)) - outer(A)
    yield lagrange_top_moving.energy(M, P, **constants), H
    N = across @ M @ across
    spin, Hbar = (1 / alpha - 1) * _pairs(N, N) / 2, _pairs(M, M) / 2 + (P * A).sum() + e / 2 * _pairs(M, _wedge(P, A))
    yield lagrange_top_moving.energy(M, P, eps=e, **constants) - spin, Hbar
    pair = _block(M, lam * A - P / lam), _block(Omega, lam * A)
    yield from zip(lagrange_top_moving.lax(M, P, lam=lam, **constants), pair, strict=True)
    M1, P1 = lagrange_top_moving.step(M, P, eps=e, **constants)
    yield P1, W.T @ P
    yield M1, W.T @ M @ W + e * _wedge(A, P1)
    B = A + e / 2 * (M @ A) + e * e / 4 * P
    yield lagrange_top_moving.lax_matrix(M, P, A=A, lam=lam, eps=e), _block(M, lam * B - P / lam)
    back = _block(W.T, 0 * A)
    back[-1, -1] = 1 + 0 * A[0]
    V = lagrange_top_moving.conjugator(M, P, lam=lam, eps=e, **constants)
    yield from _cayley_of(e / 2 * _block(0 * M, lam * A), back @ V)


@stated("record-kirchhoff", "Section 7, (Kirch), its Hamilton function; Clebsch's L and U")
def record_kirchhoff(M: Skew, P: Vector, a: Diagonal, b: Vector, lam: Lam) -> Sides:
    """flow and energy of both records, L = lambda A + M + P P^T/lambda, U = lambda B + Omega with c_jk = (b_j - b_k)/(a_j - a_k)"""
    unit = identity(len(a))
    c = (b[:, None] - b + unit) / (a[:, None] - a + unit)
    Omega, H = c * M, _pairs(c * M, M) / 2 - (b * P * P).sum() / 2
    rates = M @ Omega - Omega @ M + _wedge(P, b * P), -(Omega @ P)
    general = {"b": b, "c": clebsch_general.quotients(a=a, b=b)["c"]}
    for record, constants in ((kirchhoff, {"C": c, "B": diagonal(b)}), (clebsch_general, general)):
        yield from zip(record.flow(M, P, **constants), rates, strict=True)
        yield record.energy(M, P, **constants), H
    pair = lam * diagonal(a) + M + outer(P) / lam, lam * diagonal(b) + Omega
    yield from zip(clebsch_general.lax(M, P, a=a, lam=lam, **general), pair, strict=True)


@stated("record-clebsch", "Section 7: (Clebsch spec), its H, L and U+; (dClebsch spec), L_k, V_k")
def record_clebsch(M: Skew, P: Unit, b: Diagonal, e: Eps, lam: Lam) -> Sides:
    """flow, energy, step and both Lax pairs of the record, |P| = 1"""
    unit, B = identity(len(b)), diagonal(b)
    yield from zip(clebsch.flow(M, P, b=b), (_wedge(P, b * P), -(M @ P)), strict=True)
    yield clebsch.energy(M, P, b=b), _pairs(M, M) / 2 - (b * P * P).sum() / 2
    yield from zip(clebsch.lax(M, P, b=b, lam=lam), (lam * B + M + outer(P) / lam, lam * B + M), strict=True)
    M1, P1 = clebsch.MAP.step(M, P, b=b, eps=e)
    S, divisor = unit + e * e / 4 * B, 1 + e * e / 4 * (b * P * P).sum()
    yield M1, M + e / divisor * _wedge(P, b * P)
    yield P1 + e / 2 * (M1 @ P1), P - e / 2 * (M1 @ P)
    script = (unit + e / 2 * M) @ outer(P) @ (unit - e / 2 * M)
    yield S @ clebsch.lax_matrix(M, P, b=b, lam=lam, eps=e), lam * B + M + script / lam
    V = clebsch.conjugator(M, P, b=b, lam=lam, eps=e)
    yield from _cayley_of(-e / (2 * lam * divisor) * outer(P) @ S, V)  # of V_k^-1


@stated("record-clebsch-energy", "Section 7, Theorem 7.1, det(L_k(lambda) - mu)")
def record_clebsch_energy(s: Setting, M: Skew, P: Unit, b: Diagonal, e: Eps) -> Sides:
    """the deformed energy of the record is -(1/2) sum b_i F_i with det(L_k(lambda) - lambda nu) = lambda^n det(S^-1 D) (1 + sum F_i/D_i/lambda^2 + ...), D = B - nu S, S = I + (eps^2/4) B, |P| = 1"""
    S, eye, unit = 1 + e * e / 4 * b, identity(s.n), 1 + 0 * e
    script, t = (eye + e / 2 * M) @ outer(P) @ (eye - e / 2 * M), generator(0, unit) + generator(1, unit)  # 1/lambda
    rows, values = [], []
    for k in range(s.n):
        nu = s.lam + k
        X = (diagonal(b) + M * t + script * (t * t)) / S[:, None] - nu * eye
        rows.append(1 / (b - nu * S))
        values.append((-1) ** s.n * series(characteristic(X)[-1])[2] * np.prod(S) * np.prod(rows[-1]))
    F = solve(np.array(rows), np.array(values)[:, None])[:, 0]
    yield clebsch.energy(M, P, b=b, eps=e), -(b * F).sum() / 2
    q = P @ M  # M of the leaf: P ^ q with <P, q> = 0
    q = q - P * (P * q).sum()
    yield neumann.energy(P, q, b=b, eps=e), clebsch.energy(_wedge(P, q), P, b=b, eps=e)


@stated("record-spectra", "Sections 5, 6.1, 6.2 and 7: det(l_k(lambda) - mu), det(L_k(lambda) - mu)")
def record_spectra(s: Setting, m: Skew, a: Unit, p: Vector, d: Diagonal, mu: Scalar) -> Sides:
    """the integrals `spectrum` of the records are coefficients in lambda and mu of the characteristic polynomials of the printed matrices"""
    d, lam = d / 4, abs(s.lam) + 1
    for e in (0 * s.eps, s.eps):
        turned, pull = e / 2 * (m @ a), e * e / 4 * p
        yield from _bordered(m, a - turned + pull, p, lam, lagrange_top.spectrum(m, a, p=p, eps=e), True)
        yield from _bordered(m, a + turned + pull, p, lam, lagrange_top_moving.spectrum(m, p, A=a, eps=e), False)
        for spectrum, kappa, Q in (
            (clebsch.spectrum(m, a, b=d, eps=e), e * e / 4, a + turned),
            (clebsch_general.spectrum(m, a, a=d), 0 * e, a),
        ):
            nu, S = lam - kappa * mu, 1 + kappa * d
            L = (lam * diagonal(d) + m + outer(Q) / lam) / S[:, None]
            value = lam * np.prod(S) * np.polyval(characteristic(L), mu) - lam * np.prod(mu - nu * d)
            places = [(k, i) for k in range(1, s.n + 1) for i in range(k - 1, -1, -2)]
            yield value, sum(v * mu ** (s.n - k) * nu**i for v, (k, i) in zip(spectrum, places, strict=True))


def _bordered(m: Array, b: Array, p: Array, lam: Any, spectrum: Array, with_casimirs: bool) -> Sides:
    """Coefficients of mu^(n-1-k): -lambda^2 x + y - z/lambda^2, of which some records leave out the Casimirs z."""
    terms, at = iter(spectrum), (lam, lam + 1)
    polynomials = [characteristic(_block(m, v * b - p / v)) for v in at]
    for k in range(0, len(b), 2):
        x, y = next(terms), next(terms)
        f, g = (v * v * c[k + 2] for v, c in zip(at, polynomials, strict=True))
        yield f - g, -(at[0] ** 4 - at[1] ** 4) * x + (at[0] ** 2 - at[1] ** 2) * y
        if with_casimirs and k:
            yield f, -(lam**4) * x + lam**2 * y - next(terms)


@stated(
    "record-lagrangians",
    "Sections 6.1, 6.2 and 7: (dmLT Lagr 1), (dmLT Lagr body), (dClebsch spec Lagr)",
    numbers=("float",),
)
def record_lagrangians(s: Setting, g: Rotation, h: Rotation, A: Unit, p: Vector, b: Vector) -> Sides:
    """the discrete Lagrangians of the records, |A| = 1, with 2/eps for Clebsch's (E1)"""
    e, alpha, b = abs(s.eps), abs(s.scalar()) + 1 / 2, abs(b)
    W = cayley(half(h) / 4)  # by less than half a revolution
    h, P, WA = g @ W, g.T @ p, W @ A
    body = -alpha / e * trace_log_of(W) - 2 * (1 - alpha) / e * log(1 + dot(A, WA)) - e * dot(P, WA)
    yield lagrange_top_moving.lagrangian(g, h, p, A=A, alpha=alpha, eps=e), body
    yield lagrange_top.lagrangian(g, h, A, p=p, alpha=alpha, eps=e), body + e * dot(P, WA - A)
    fluid = -trace_log_of(W) / e + 2 / e * log(1 + e * e / 4 * (b * P * P).sum())
    yield clebsch.lagrangian(g, h, p, b=b, eps=e), fluid
