"""Steklov's and Lyapunov's cases of a rigid body in a fluid, in n dimensions.  State (M, P), body frame, both skew.

On so(n) <x so(n); for n = 3 these are cases of Kirchhoff's equations with mixed terms, P and M standing for vectors.
H = s H_S + l H_L is integrable for any s and l (s = 1, l = 0: Steklov; s = 0, l = 1: Lyapunov).  With B = diag(b),

    H_L = (1/2) sum_(i<j) [M_ij^2 + (b_i + b_j) M_ij P_ij + (b_i - b_j)^2 P_ij^2/4],
    H_S = (1/2) sum_(i<j) [(b_i + b_j) M_ij^2 + (b_i^2 + b_j^2) M_ij P_ij + (b_i + b_j)(b_i - b_j)^2 P_ij^2/4].

Plus bracket, F' = {H, F}.  [Steklov 1893; Lyapunov 1893; n dimensions: Bolsinov, Fedorov 1992; named in Suris 2001,
Conclusions.  The Lax pair was found from the requirement of involution; it was not compared with theirs]

Conjugate pairs of Bäcklund maps: X(s) = M0 + s P with M0 = M - (BP + PB)/2, and X q = mu C q with C = s - B.  For a
point s = z + ix and its conjugate, q = u + iw, the matrix V(s), which has V^T C V = C and poles at the two points,
makes X' = V^T X V a polynomial again:

    P' = R^T P R,   M0' = R^T (M0 + Z^T P + P Z) R,   R = cay(X),  X = (2x/g) u ^ w,  g = z r - <q, Bq>,  r = |q|^2,
    Z = (4x/D) Re[x conj(q.q) q y^T - (x r - ig) q y^+],  y = C(s) q,  D = g^2 + x^2 (r^2 - |q.q|^2):

the identity for x = 0.  Near there the body rotates with Omega = 2i (Pi - Pi^T), Pi = q p^T, p the left eigenvector
with <p, Cq> = 1, and M0' = [M0, Omega] + P Omega C - C Omega P.  lam is i s here, so that its real part is -x.
With a rotor h, n = 3, X(s) has (s - B)^-1 h in addition, which all of this leaves unchanged.
[The pair is the product of two half-turns V = 1 - 2 q q^T C/(q.q (s - s_1))]
"""

from dataclasses import replace
from functools import reduce

import numpy as np

from kreisel.algebra import (
    KINDS,
    axial,
    bracket,
    dot,
    hat,
    identity,
    mat,
    pairing,
    parts,
    sqrt,
    together,
    vec,
    wedge,
    where_less,
)
from kreisel.algebra.invariants import adjugate, diagonal, stack, trace
from kreisel.baecklund.conjugate import eigenvector, heights, largest, norm, projector_of, under
from kreisel.record.contract import ADJOINT_PAIR_SPACE, ConjugatePairs, Parameter, System, named

NOISE = 1e-8  # relative: an M0 that is left by rounding, at whose scale s - b would be lost


def coefficients(*, b, s, l):
    """The entries of H = (1/2) sum_(i<j) [x_ij M_ij^2 + 2 y_ij M_ij P_ij + z_ij P_ij^2]."""
    plus, minus = b[..., :, None] + b[..., None, :], b[..., :, None] - b[..., None, :]
    squares = (b * b)[..., :, None] + (b * b)[..., None, :]
    s, l = mat(s), mat(l)
    return {"x": s * plus + l, "y": (s * squares + l * plus) / 2, "z": (s * plus + l) * minus * minus / 4}


def velocity(M, P, *, x, y):  # Omega = dH/dM
    return x * M + y * P


def force(M, P, *, y, z):  # dH/dP
    return y * M + z * P


def flow(M, P, *, x, y, z):  # M' = [M, Omega] + [P, dH/dP],   P' = [P, Omega]
    Omega = velocity(M, P, x=x, y=y)
    return bracket(M, Omega) + bracket(P, force(M, P, y=y, z=z)), bracket(P, Omega)


def energy(M, P, *, x, y, z):
    return (pairing(M, velocity(M, P, x=x, y=y)) + pairing(P, force(M, P, y=y, z=z))) / 2


def halves(b):
    return (b[..., :, None] + b[..., None, :]) / 2


def pencil(M, P, b, lam):  # X = M - (BP + PB)/2 + lambda P
    return M + (lam - halves(b)) * P


def constants(*, b, s, l):
    beyond = abs(b).sum(-1, keepdims=True)[..., 0]  # an array of exact values too
    return coefficients(b=b, s=s, l=l) | {"beyond": beyond}


def traces(M, P, *, b, beyond):
    """Tr (X(lambda) (lambda - B)^-1)^k, k = 2, 4, ..., at n values of lambda beyond the sum of all |b|."""
    n, out = M.shape[-1], []
    for j in range(n):
        lam = beyond + (j + 1)
        L = pencil(M, P, b, mat(lam)) / (vec(lam) - b)[..., None, :]
        square, power = L @ L, identity(n)
        for _ in range(2, n + 1, 2):
            power = power @ square
            out.append(trace(power))
    return stack(out)


def lax(M, P, *, b, s, l, x, y, lam):
    """The pair L = X C, U = K C with C = (lambda - B)^-1.

    K = lambda Omega less s (BMB + (B^2 P B + B P B^2)/2) + l BPB.
    """
    C, Bi, Bj = diagonal(1 / (lam - b)), b[..., :, None], b[..., None, :]
    K = lam * velocity(M, P, x=x, y=y) - Bi * Bj * (mat(s) * (M + (Bi + Bj) / 2 * P) + mat(l) * P)
    return pencil(M, P, b, lam) @ C, K @ C


# -- conjugate pairs of Bäcklund maps -----------------------------------------------------------------


def spectral(lam):
    """s (..., 1)."""
    x, y = parts(np.asarray(lam)[..., None])
    return together(0 * x if y is None else y, -x)


def matrix(M, P, *, b, lam, h=None):
    s = spectral(lam)
    X = pencil(M, P, b, s[..., None])
    return (X if h is None else X + hat(h / (s - b))) / (s - b)[..., None]


def points(M, P, *, b, h=None):
    """s beyond the largest and below the least b, where C is definite and mu imaginary."""
    size, large, low = norm(P), reduce(largest, b), -reduce(largest, -b)
    sizes = norm(M - halves(b) * P) / size, sqrt(0.0 if h is None else norm(h) / size)
    noise = NOISE * reduce(largest, abs(b))
    scales = large - low, *(where_less(noise, scale, scale, 0) for scale in sizes)
    return [*heights(*scales, origin=large), *heights(*scales, origin=low, side=-1)]


def projector(M, P, *, b, lam, mu, h=None):
    c = spectral(lam) - b
    return projector_of(adjugate(c[..., None] * matrix(M, P, b=b, lam=lam, h=h) - mu * diagonal(c)) * c)


def rates(M, P, *, b, lam, Pi):
    C = diagonal(spectral(lam) - b)
    Pi = Pi / (spectral(lam) - b)[..., None, :]
    re, im = parts(Pi - Pi.mT)
    Omega = together(2 * im, -2 * re)
    turned, M0 = bracket(P, Omega), M - halves(b) * P
    return (bracket(M0, Omega) + P @ Omega @ C - C @ Omega @ P + halves(b) * turned, turned), Omega


def pair(M, P, *, b, lam, mu, h=None):
    (x, z), (m, k) = parts(lam), parts(mu)
    x, c, M0 = -x, vec(z) - b, M - halves(b) * P
    re = M0 + mat(z) * P - diagonal(vec(m) * c - vec(k * x))
    im = mat(x) * P - diagonal(vec(m * x) + vec(k) * c)
    if h is not None:  # h/(c + ix)
        ratio = h / (c * c + vec(x * x))
        re, im = re + hat(ratio * c), im - hat(vec(x) * ratio)
    u, w = eigenvector(re, im, c, x)
    uu, ww, uw, g = dot(u, u), dot(w, w), dot(u, w), dot(u, c * u) + dot(w, c * w)
    y, v = c * u - vec(x) * w, c * w + vec(x) * u
    factor = 4 * x / (g * g + 4 * x * x * (uu * ww - uw * uw))
    first = vec(-2 * x * ww) * y + vec(2 * x * uw + g) * v
    second = vec(-2 * x * uu) * v + vec(2 * x * uw - g) * y
    Z = mat(factor) * (u[..., :, None] * first[..., None, :] + w[..., :, None] * second[..., None, :])
    X, K = mat(2 * x / g) * wedge(u, w), P @ Z
    turned = KINDS["skew"].turned
    moved = turned(-X, P)  # M itself where x = 0: not M0 + BP, which is rounded
    return (M + ((turned(-X, M0 + K - K.mT) - M0) + halves(b) * (moved - P)), moved), (X,)


PAIRS = ConjugatePairs(matrix=matrix, heights=points, projector=projector, rates=rates, pair=pair)

RUBANOVSKII = replace(PAIRS, dimensions=(3,))  # whose h the functions name


def axial_pairs(matrix_b):
    """The pairs of a system with n = 3 that has P as an axial vector, and B = matrix_b(b, nu)."""
    return under(
        PAIRS,
        ("b", "nu"),
        lambda b, nu: {"b": matrix_b(b, nu)},
        lambda M, P: (M, hat(P)),
        lambda z: (z[0], axial(z[1])),
        (3,),
    )


SYSTEM = System(
    name="steklov-lyapunov",
    title="Steklov's and Lyapunov's cases of a body in a fluid",
    equations="M' = [M, Omega] + [P, dH/dP],  P' = [P, Omega],  Omega = dH/dM",
    source="Steklov 1893, Lyapunov 1893, Bolsinov, Fedorov 1992; Suris 2001, Conclusions",
    space=replace(ADJOINT_PAIR_SPACE, unlike=True),  # else a projection moves P = 0
    parameters=(
        Parameter("b", "vector", "diagonal of B", diagonal=True),
        Parameter("s", "scalar", "how much of Steklov's H"),
        Parameter("l", "scalar", "how much of Lyapunov's H"),
    ),
    **named(flow, energy, velocity, lax),
    derive=constants,
    integrals={"traces": traces},
    commuting=("traces",),
    pairs=replace(PAIRS, between=8),
    notes="No explicit map is known; method='exact' for n = 3 to 5.",
)
