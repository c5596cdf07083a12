"""Conjugate pairs of Bäcklund maps of Steklov's and Lyapunov's cases, state (M, P), both in so(n).

X(s) = M0 + s P with M0 = M - (BP + PB)/2, and X q = mu C q with C = s - B.  For a point s = z + ix and its conjugate,
q = u + iw, the matrix V(s), which has V^T C V = C and poles at the two points, makes X' = V^T X V a polynomial again:

    P' = R^T P R,   M0' = R^T (M0 + Z^T P + P Z) R,   R = cay(X),  X = (2x/g) u ^ w,  g = z r - <q, Bq>,  r = |q|^2,
    Z = (4x/D) Re[x conj(q.q) q y^T - (x r - ig) q y^+],  y = C(s) q,  D = g^2 + x^2 (r^2 - |q.q|^2):

the identity for x = 0.  Near there the body rotates with Omega = 2i (Pi - Pi^T), Pi = q p^T, p the left eigenvector
with <p, Cq> = 1, and M0' = [M0, Omega] + P Omega C - C Omega P.  lam is i s here, so that its real part is -x.
With a rotor h, n = 3, X(s) has (s - B)^-1 h in addition, which all of this leaves unchanged.
[Lax matrix as in `steklov_lyapunov`; the pair is the product of two half-turns V = 1 - 2 q q^T C/(q.q (s - s_1))]
"""

from dataclasses import replace
from functools import reduce

import numpy as np

from kreisel.algebra import KINDS, axial, bracket, dot, hat, mat, parts, sqrt, together, vec, wedge, where_less
from kreisel.algebra.invariants import adjugate, diagonal
from kreisel.baecklund.conjugate import eigenvector, heights, largest, norm, projector_of, under
from kreisel.record.contract import ConjugatePairs

NOISE = 1e-8  # relative: an M0 that is left by rounding, at whose scale s - b would be lost


def halves(b):
    return (b[..., :, None] + b[..., None, :]) / 2


def spectral(lam):
    """s (..., 1)."""
    x, y = parts(np.asarray(lam)[..., None])
    return together(0 * x if y is None else y, -x)


def matrix(M, P, *, b, lam, h=None):
    s = spectral(lam)
    X = M + (s[..., None] - halves(b)) * P
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


STEKLOV_LYAPUNOV = ConjugatePairs(matrix=matrix, heights=points, projector=projector, rates=rates, pair=pair)

RUBANOVSKII = replace(STEKLOV_LYAPUNOV, dimensions=(3,))  # whose h the functions name


def axial_pairs(matrix_b):
    """The pairs of a system with n = 3 that has P as an axial vector, and B = matrix_b(b, nu)."""
    return under(
        STEKLOV_LYAPUNOV,
        ("b", "nu"),
        lambda b, nu: {"b": matrix_b(b, nu)},
        lambda M, P: (M, hat(P)),
        lambda z: (z[0], axial(z[1])),
        (3,),
    )
