"""Body with equal moments in any quadratic potential, with an explicit map.  State (M, F), body frame.

M (..., n, n) skew, F = g^T A_0 g (..., n, n) symmetric with A_0 fixed in space; B = diag(b) fixed in the body.  Plus
bracket, F' = {H, F}.  With k = eps/2, s = k^2 and X = F (1 + s B F)^-1, which is symmetric, the map is

    M_(k+1) = M + eps (X B - B X),   F_(k+1) = W^T F W,   W = cay(k M_(k+1)).

For F = P R^T, of any rank r, it has the Lax pair `pencil`, `factors` of size n + r; as eps -> 0 the Schur complement of
the r-block is lambda B + M - mu + F/lambda.  Proof, by P = F, R = 1: Z = (-k, 1) is isotropic for S = diag(1, -s), and
L(0, -1/k) Z = 0.  It holds in every associative algebra with an involution *, M* = -M, F* = F, B* = B; of the cases
clebsch has F = P P^T, kovalevskaya-gyrostat the F of fields in so(n) x so(2), ratiu-top F = iG and B = i chi.
[The flow by Brun, Bogoyavlensky, Reyman; Suris 2000 has an implicit map for unequal moments; this map was made here]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import KINDS, bracket, dot, hat, holds_objects, identity, mat, pairing, solve, symmetric, trace_log
from kreisel.algebra.invariants import MOST, blocks, determinant, diagonal, stack
from kreisel.algebra.rotations import SECOND, THIRD, axial, cayley
from kreisel.baecklund.conjugate import QUADRATIC, in_letter
from kreisel.record.contract import FIELD_SPACE, Parameter, System, kicked_map, named

AXES = np.arange(3)


def potential(F, sB):  # X = F (1 + s B F)^-1
    return solve(identity(F.shape[-1]) + F @ sB, F)


def pencil_of(M, P, R, B, *, lam, mu, eps):
    """L = [[lambda B + M - mu, (1 + k M) P], [-R^T (1 - k M), lambda + s R^T (mu + M) P]] for the field P R^T."""
    k, RM, MP = eps / 2, R.mT @ M, M @ P
    corner = lam * identity(P.shape[-1]) + k * k * (mu * (R.mT @ P) + R.mT @ MP)
    return blocks([[lam * B + M - mu * identity(M.shape[-1]), P + k * MP], [k * RM - R.mT, corner]])


def factors_of(P, R, B, *, lam, eps):
    """U, V = 1 - (2/lambda) N with N^2 = 0, of rank r: U L_(k+1) = L_k V but for the rotations of the two blocks."""
    k, unit = eps / 2, identity(P.shape[-1])
    G = k * (R.mT @ P)
    E, minus = unit + k * k * (R.mT @ B @ P), -unit + 0 * G
    left = blocks([[P], [G]]) @ solve(E, blocks([[k * R.mT, minus]]))
    right = blocks([[k * P], [minus]]) @ solve(E, blocks([[R.mT, G]]))
    return tuple(identity(left.shape[-1]) - 2 / lam * N for N in (left, right))


def turned(factors, first, second):
    """The factors times diag(first, -second), the inverse rotations of the two blocks of L."""
    zero = 0 * (first[..., :, :1] * second[..., :1, :])
    rotation = blocks([[first, zero], [zero.mT, -second]])
    return tuple(factor @ rotation for factor in factors)


def values_of(M, F, X, B, *, eps, points):
    """det(L)/lambda^r at points (lambda, mu), by Schur's complement in the mean momentum Mm = M + (eps/2) (X B - B X).

    det(1 + s B F) det(Mm + lambda (B - s B X B) - mu (1 - s (X B + B X)) + (1 - s mu^2) X/lambda).
    """
    XB, BX, square, unit = X @ B, B @ X, eps * eps, identity(M.shape[-1])
    mean, along, across = M + eps * (XB - BX) / 2, B - square * (BX @ B) / 4, unit - square * (XB + BX) / 4
    schur = (mean + lam * along - mu * across + (X - square * mu * mu * X / 4) / lam for lam, mu in points)
    scale = determinant(unit + square * (B @ F) / 4)
    return stack([scale * determinant(A) for A in schur])


def derive(*, b):
    return {"B": diagonal(b)}


def inverse_inertia(M):  # Omega = M
    return M


def flow(M, F, *, B):  # M' = [F, B],   F' = [F, M]
    return bracket(F, B), bracket(F, M)


def impulse(F, b, eps):
    """D = det(1 + s B F) and K = eps D (X B - B X); for n = 3 from the cofactors of A = 1 + s B F, else with D = 1."""
    s = eps * eps / 4 * b
    if F.shape[-1] != 3:
        return 1, eps * bracket(potential(F, diagonal(s)), diagonal(b))
    a, x = 1 + s * F[..., AXES, AXES], F[..., SECOND, THIRD]
    C, S = x * a - s * (x[..., SECOND] * x[..., THIRD]), s[..., SECOND] * s[..., THIRD]
    D = a[..., 0] * (a[..., 1] * a[..., 2] - S[..., 0] * x[..., 0] * x[..., 0])
    D = D - (S[..., 1] * x[..., 1] * C[..., 1] + S[..., 2] * x[..., 2] * C[..., 2])
    return D, hat(eps * (b[..., SECOND] - b[..., THIRD]) * C)


def kick(F, *, b, eps):  # eps (X B - B X), the change of M in a step
    D, K = impulse(F, b, eps)
    return K / mat(D)


def rotated(Y, F, D=1):
    """R F R^T, R = cay(Y/D).

    For n = 3 R = 1 + S, S = 2 (D Y + Y^2)/(D^2 + |Y|^2); S G + (S G)^T + S G S^T, G = F - F_33, is the change of F,
    whose trace stays.
    """
    if F.shape[-1] != 3:
        return KINDS["symmetric"].turned(Y / mat(D), F)
    u = axial(Y)
    scale = 2 / (D * D + dot(u, u))
    S = mat(D) * Y + Y @ Y
    T = S @ (F - mat(F[..., 2, 2]) * identity(3))
    A = F + mat(scale) * ((T + T.mT) + mat(scale) * (T @ S.mT))
    last = F[..., 0, 0] + F[..., 1, 1] + F[..., 2, 2] - A[..., 0, 0] - A[..., 1, 1]
    return symmetric(stack([A[..., 0, 0], A[..., 0, 1], A[..., 0, 2], A[..., 1, 1], A[..., 1, 2], last]), 3)


def step(M, F, *, b, eps):
    D, K = impulse(F, b, eps)
    return M + K / mat(D), rotated(-(mat(D) * M + K), F, 2 / eps * D)


def turn(M, F, *, eps):
    return M, rotated(-eps / 2 * M, F)


def generator(M, F, M1, F1, *, eps):
    return eps / 2 * M1


def energy(M, F, *, b, eps=0):
    """<M, M>/2 - (1/2) sum b_i <v_i, F (1 + s b_i F)^-1 v_i>, v_i row i of 1 + k M; -(1/2) sum b_i times residues."""
    V = identity(M.shape[-1]) + eps * M / 2
    A = identity(M.shape[-1]) + eps * eps * (b[..., :, None, None] * F[..., None, :, :]) / 4
    return pairing(M, M) / 2 - dot(b, dot(V, solve(A, (V @ F)[..., None])[..., 0])) / 2


def spectrum(M, F, *, B, eps=0):
    """det(L)/lambda^n at n (n - 1)/2 - 1 points (lambda, mu): with the energy half the dimension of a leaf.

    For n > 10 at as many points as for n = 10; so in the other records that use `values_of`.
    """
    n = min(M.shape[-1], MOST)
    points = [(i + 1, j) for i in range(n - 1) for j in range(n - 1 - i)][1:]
    return values_of(M, F, potential(F, eps * eps * B / 4), B, eps=eps, points=points)


def lax(M, F, *, B, lam):  # L = lambda B + M + F/lambda,   U = lambda B + M
    return lam * B + M + F / lam, lam * B + M


def pencil(M, F, *, B, lam, mu, eps):
    return pencil_of(M, F, identity(M.shape[-1]) + 0 * F, B, lam=lam, mu=mu, eps=eps)


def factors(M, F, *, b, B, lam, eps):
    unit, W = identity(M.shape[-1]) + 0 * F, cayley(eps / 2 * (M + kick(F, b=b, eps=eps)))
    return turned(factors_of(F, unit, B, lam=lam, eps=eps), unit, W)


def lagrangian(g, h, A, *, B, eps):  # -(1/eps) tr log(2 + W + W^T) + (2/eps) tr log(1 + s B F)
    W, unit = g.mT @ h, identity(B.shape[-1])
    return 2 / eps * trace_log(unit + eps * eps / 4 * (B @ (g.mT @ A @ g))) - trace_log(2 * unit + W + W.mT) / eps


def largest_step(M, F, *, b):
    """det(1 + s B F) stays positive for smaller |eps| as F rotates: s b_i f_j > -1 for all eigenvalues f of F.

    For recorded values, |f| <= (tr F^2)^(1/2).
    """
    if holds_objects(F):
        return 2 / np.sqrt(abs(b).max(-1) * np.sqrt((F * F).sum(-1).sum(-1)))
    f = np.linalg.eigvalsh(F)
    (up, above), (down, below) = ((np.maximum((sign * x).max(-1), 0) for x in (b, f)) for sign in (1, -1))
    mixed = (up * down > 0) & (above * below > 0)
    worst = np.where(mixed, np.maximum(up, down) * np.maximum(above, below), np.maximum(up * below, down * above))
    return 2 / np.sqrt(worst)


MAP = kicked_map(kick, turn, **named(step, generator, lagrangian, pencil, factors, largest_step), source="Kreisel")

SYSTEM = System(
    name="quadratic-field",
    title="Body with equal moments in a quadratic potential",
    equations="M' = [F, B],  F' = [F, M]",
    source="Suris 2001, Introduction; Bogoyavlensky 1985, Reyman 1980",
    space=replace(FIELD_SPACE, unlike=True),
    parameters=(Parameter("b", "vector", "diagonal of B: the potential energy is -tr(B F)/2", diagonal=True),),
    **named(flow, energy, inverse_inertia, derive, lax),
    scaling="The one moment of inertia is 1. Every symmetric B is diagonal along axes of the body.",
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    map=MAP,
    pairs=in_letter(QUADRATIC, "b"),
)
