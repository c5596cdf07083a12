"""Ratiu's Lagrange top, on so(n) <x so(n), with an explicit map.  State (M, G), body frame: M, G (..., n, n) skew.

J = diag(a, a, b, ..., b), M = J Omega + Omega J, chi = chi_12 e_1 ^ e_2, H = <M, Omega>/2 + <G, chi>; G rotates with
the body.  For n = 3 it is the Lagrange top.  Plus bracket, F' = {H, F}.  The map, with h = 1/(a + b) and k = h eps/2,

    N = M + eps [Y, chi],   Y = G (1 + (k eps/2) chi G)^-1,   W = cay(k N),   R = cay(eps/2 (u N_12 E_12 + v N_33)),
    M_(k+1) = R^T N R,   G_(k+1) = R^T W^T G W R,   u = 1/(2a) - h,   v = 1/(2b) - h,

with N_33 the block N_ij, i, j >= 3, is that of `quadratic_field` for the field iG and B = i chi and of equal moments;
then the blocks, which are conserved, rotate it about chi.  [Ratiu, Amer. J. Math. 104 (1982); named in Suris 2001,
Conclusions; the map was made here]
"""

import numpy as np

from kreisel.algebra import KINDS, bracket, dot, hat, holds_objects, identity, mat, pairing, skew, solve, vec, wedge
from kreisel.algebra.invariants import MOST, trace_of_product
from kreisel.algebra.rotations import axial, cayley, cayley_conjugate, coordinates, cross
from kreisel.record.contract import ADJOINT_SPACE, Parameter, System, kicked_map, named
from kreisel.record.values import positive
from kreisel.system import quadratic_field as general


def planes(*, n, a, b, chi):
    """c_jk = 1/(J_j + J_k) and the matrix X = chi e_1 ^ e_2."""
    unit = identity(int(np.asarray(n).flat[0]))
    ends, plane = unit[0] + unit[1], wedge(unit[0], unit[1])
    inner, none = ends[:, None] * ends, (1 - ends)[:, None] * (1 - ends)
    mixed = 1 - inner - none
    c = inner * mat(1 / (2 * a)) + none * mat(1 / (2 * b)) + mixed * mat(1 / (a + b))
    spins = inner * mat(1 / (2 * a) - 1 / (a + b)) + none * mat(1 / (2 * b) - 1 / (a + b))
    return {
        "c": (1 - unit) * c,
        "X": mat(chi) * plane,
        "C": mat((a + b) * chi) * plane,
        "h": np.asarray(1 / (a + b)),
        "spins": (1 - unit) * spins,
    }


def inverse_inertia(M, *, c):
    return c * M


def flow(M, G, *, c, X):  # M' = [M, Omega] + [G, chi],   G' = [G, Omega]
    Omega = inverse_inertia(M, c=c)
    return bracket(M, Omega) + bracket(G, X), bracket(G, Omega)


def kick(G, *, X, h, eps):  # eps [Y, chi]; for n = 3 G chi G = -<G, chi> G, so Y = G/(1 - (k eps/2) <G, chi>)
    s = eps * eps * h / 4
    if G.shape[-1] != 3:
        return eps * bracket(general.potential(G, mat(s) * X), X)
    g, x = axial(G), axial(X)
    return hat(vec(eps / (1 - s * dot(g, x))) * cross(g, x))


def turn(M, G, *, h, spins, eps):
    Y = skew(coordinates(eps / 2 * spins * M), M.shape[-1])
    G = KINDS["skew"].turned(-mat(eps * h / 2) * M, G)
    return cayley_conjugate(-Y, M), cayley_conjugate(-Y, G)


def turns(M, G, X, h, spins, eps):
    N = M + kick(G, X=X, h=h, eps=eps)
    return cayley(mat(eps * h / 2) * N), cayley(eps / 2 * spins * N)


def generator(M, G, M1, G1, *, X, h, spins, eps):
    W, R = turns(M, G, X, h, spins, eps)
    unit = identity(M.shape[-1])
    return solve(unit + W @ R, W @ R - unit)


def energy(M, G, *, c, X, C, h, eps=0):
    """Energy with G~ for G: chi G~ = chi V G Z V^T - s chi^2 V G^2 Z V^T, V = 1 + k M, Z = (1 + s^2 beta^2 G^2)^-1.

    k = h eps/2, s = k^2, beta = (a + b) chi_12; by residues at the eigenvalues of chi, as in `quadratic_field`.
    """
    square, V = mat(eps * h * eps * h) / 4, identity(M.shape[-1]) + mat(eps * h) * M / 2
    GZ = solve(identity(M.shape[-1]) + square * square * mat(pairing(C, C)) * (G @ G), G)
    turned = trace_of_product(X @ (V - square * (C @ V @ G)) @ GZ, V.mT)
    return pairing(M, inverse_inertia(M, c=c)) / 2 - turned / 2


def spectrum(M, G, *, C, h, eps=0):
    """det(L)/lambda^n at points (lambda, mu); with `noether` they are complete for n = 3, 4, 5."""
    step, places = mat(eps * h), (1, -1, 2, -2, 3)
    points = [(lam, j) for j in range(1, min(M.shape[-1], MOST) // 2 + 1) for lam in places[: 2 if j == 1 else 5]]
    return general.values_of(M, G, general.potential(G, step * step * C / 4), C, eps=step, points=points)


def noether(M, G):  # the block M_ij, i, j >= 3
    ends = np.diag([0, 0] + [1] * (M.shape[-1] - 2))
    return ends @ M @ ends


def lax(M, G, *, c, X, C, lam):  # L = lambda^2 C + lambda M + G with C = (a + b) chi,   U = lambda chi + Omega
    return lam * lam * C + lam * M + G, lam * X + inverse_inertia(M, c=c)


def pencil(M, G, *, C, h, lam, mu, eps):
    return general.pencil_of(M, G, identity(M.shape[-1]) + 0 * G, C, lam=lam, mu=mu, eps=eps * h)


def factors(M, G, *, X, C, h, spins, lam, eps):
    W, R = turns(M, G, X, h, spins, eps)
    return general.turned(general.factors_of(G, identity(M.shape[-1]) + 0 * G, C, lam=lam, eps=eps * h), R, W @ R)


def largest_step(M, G, *, X, h):
    """det(1 + (k eps/2) chi G) stays positive as G rotates, by its largest singular value, for smaller |eps|.

    For recorded values by <G, G>^(1/2), which is not less.
    """
    size = np.sqrt(pairing(G, G)) if holds_objects(G) else np.linalg.norm(G, 2, axis=(-2, -1))
    return 2 / np.sqrt(h * np.sqrt(pairing(X, X)) * size)


MAP = kicked_map(kick, turn, **named(generator, pencil, factors, largest_step), source="Kreisel")

SYSTEM = System(
    name="ratiu-top",
    title="Ratiu's Lagrange top",
    equations="M' = [M, Omega] + [G, chi],  G' = [G, Omega],  M = J Omega + Omega J,  J = diag(a, a, b, ..., b)",
    source="Ratiu 1982; Suris 2001, Conclusions",
    space=ADJOINT_SPACE,
    parameters=(
        Parameter("n", "dimension", "the dimension of the space"),
        Parameter("a", "scalar", "J_1 = J_2, positive", positive, positive=True),
        Parameter("b", "scalar", "J_3 = ... = J_n, positive", positive, positive=True),
        Parameter("chi", "scalar", "chi_12, the strength of the field"),
    ),
    **named(flow, energy, inverse_inertia, lax),
    derive=planes,
    scaling="Any consistent units: <G, chi> is the potential energy.",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    map=MAP,
    notes="The block M_ij, i, j >= 3, is conserved too.",
)
