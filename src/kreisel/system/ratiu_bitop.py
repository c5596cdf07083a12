"""Lagrange bitop, n = 4, with an explicit Poisson map.  State (M, G) on so(4) <x so(4), as in `ratiu_top`.

J = diag(a, a, b, b), chi = chi12 e_1 ^ e_2 + chi34 e_3 ^ e_4; chi34 = 0 is Ratiu's Lagrange top for n = 4.  With the
halves M+, M- of so(4) = su(2) + su(2), h = eps/(a + b), and E_ij = e_i ^ e_j,

    N = M + eps [G, chi],   R = cay(eps/2 (u N_12 E_12 + v N_34 E_34)),   W ~ (1 + h N+)(1 + h N-),
    M_(k+1) = R^T N R,   G_(k+1) = R^T W^T G W R,   u = 1/(2a) - 1/(a + b),   v = 1/(2b) - 1/(a + b);

two maps of the Lagrange top side by side.  `ratiu_top` has another one, for any n.  [Ratiu 1982; Dragovic, Gajic 2001;
named in Suris 2001, Conclusions.  The map was made here; we know of none in the literature]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import bracket, coordinates, dot, hat, identity, mat, pairing, skew, solve, sqrt, vec, wedge
from kreisel.algebra.invariants import stack
from kreisel.algebra.rotations import cayley, cayley_act, cayley_conjugate
from kreisel.record.contract import Parameter, kicked_map, named
from kreisel.system import ratiu_top

DUAL, SIGNS = np.array([5, 4, 3, 2, 1, 0]), np.array([-1, 1, -1, -1, 1, -1], dtype=np.int8)
E12, E34 = wedge(*identity(4)[:2]), wedge(*identity(4)[2:])


def planes(*, a, b, chi12, chi34):
    """c_jk = 1/(J_j + J_k), chi as X and C = (a + b) chi; the coefficients of the map."""
    X, c = mat(chi12) * E12 + mat(chi34) * E34, 1 / (a + b)
    first, last = abs(E12), abs(E34)
    mixed = (1 - identity(4)) - first - last
    inverse = mat(1 / (2 * a)) * first + mat(1 / (2 * b)) * last + mat(c) * mixed
    scalars = {"h": c, "u": 1 / (2 * a) - c, "v": 1 / (2 * b) - c}
    return {"c": inverse, "X": X, "C": mat(a + b) * X, **{k: np.asarray(v) for k, v in scalars.items()}}


def dual(M):
    """The matrix with M+ - M- for M+ + M-."""
    return skew(coordinates(M)[..., DUAL] * SIGNS, 4)


def halves(M):
    """The vectors (..., 3) of M+ and M-."""
    x = coordinates(M)
    v = x[..., np.array([3, 1, 0])] * np.array([-1, 1, -1], dtype=np.int8)
    w = x[..., np.array([2, 4, 5])]
    return (v + w) / 2, (v - w) / 2


def matrix(p, q):
    """The matrix of the vectors of its halves."""
    v, w = p + q, p - q
    x = [-v[..., 2], v[..., 1], w[..., 0], -v[..., 0], w[..., 1], w[..., 2]]
    return skew(np.stack(x, -1), 4)


def kick(G, *, X, eps):
    return eps * bracket(G, X)


def about(M, *, u, v, eps):  # R = cay(Y)
    return eps / 2 * (mat(u * M[..., 0, 1]) * E12 + mat(v * M[..., 2, 3]) * E34)


def turn(M, G, *, h, u, v, eps):
    pairs = zip(halves(M), halves(G), strict=True)
    G = matrix(*(cayley_act(-vec(h * eps) * hat(m), g) for m, g in pairs))
    Y = about(M, u=u, v=v, eps=eps)
    return cayley_conjugate(-Y, M), cayley_conjugate(-Y, G)


def generator(M, G, M1, G1, *, X, h, u, v, eps):  # W R = cay(generator)
    M = M + kick(G, X=X, eps=eps)
    W, k = cayley(about(M, u=u, v=v, eps=eps)), h * eps
    for m, M_half in zip(reversed(halves(M)), ((M - dual(M)) / 2, (M + dual(M)) / 2), strict=True):
        W = (W + mat(k) * (M_half @ W)) / mat(sqrt(1 + k * k * dot(m, m)))
    return solve(identity(4) + W, W - identity(4))


def shifted(M, G, *, C, h, eps):  # G + (h/2) [M, G] + h^2 (|g+|^2 C+ + |g-|^2 C-)
    k = h * eps
    (p, q), Cd = halves(G), dual(C)
    square = mat(dot(p, p)) * (C + Cd) / 2 + mat(dot(q, q)) * (C - Cd) / 2
    return G + mat(k / 2) * bracket(M, G) + mat(k * k) * square


def energy(M, G, *, X, C, h, u, v, eps=0):
    spins = u * M[..., 0, 1] * M[..., 0, 1] + v * M[..., 2, 3] * M[..., 2, 3]
    return (h * pairing(M, M) + spins) / 2 + pairing(X, shifted(M, G, C=C, h=h, eps=eps))


def spectrum(M, G, *, C, h, eps=0):
    """The coefficients of -tr L^2/2 and of the Pfaffian of L that are no constants."""
    Gt, out = shifted(M, G, C=C, h=h, eps=eps), []
    for Z in (lambda Y: Y, dual):
        out += [pairing(C, Z(M)), pairing(M, Z(M)) + 2 * pairing(C, Z(Gt)), pairing(M, Z(Gt)), pairing(Gt, Z(Gt))]
    return stack(out)


def lax_matrix(M, G, *, C, h, lam, eps):  # L = lambda^2 C + lambda M + Gt
    return lam * lam * C + lam * M + shifted(M, G, C=C, h=h, eps=eps)


def conjugator(M, G, *, X, h, u, v, lam, eps):  # (1 - h/lambda G+)(1 - h/lambda G-) R
    k, Gd = mat(h * eps) / lam, dual(G)
    unit = identity(4)
    return (
        (unit - k / 2 * (G + Gd))
        @ (unit - k / 2 * (G - Gd))
        @ cayley(about(M + eps * bracket(G, X), u=u, v=v, eps=eps))
    )


SYSTEM = replace(
    ratiu_top.SYSTEM,
    name="ratiu-bitop",
    title="Lagrange bitop, and Ratiu's Lagrange top for n = 4",
    equations="M' = [M, Omega] + [G, chi],  G' = [G, Omega],  M = J Omega + Omega J,  J = diag(a, a, b, b)",
    source="Ratiu 1982, Dragovic, Gajic 2001; Suris 2001, Conclusions",
    parameters=(
        *(p for p in ratiu_top.SYSTEM.parameters if p.letter in ("a", "b")),
        Parameter("chi12", "scalar", "strength of the field in the plane (1, 2)"),
        Parameter("chi34", "scalar", "strength of the field in the plane (3, 4); 0 for Ratiu's top", None, 0.0),
    ),
    energy=energy,
    derive=planes,
    integrals={"spectrum": spectrum},
    n=4,
    map=kicked_map(
        kick,
        turn,
        **named(generator, conjugator),
        lax=lax_matrix,
        rational=False,
        source="Made here from so(4) = su(2) + su(2) and the map of Suris 2001",
    ),
    notes="No discrete Lagrangian is stated.",
)
