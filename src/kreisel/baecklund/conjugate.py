"""Conjugate pairs of Bäcklund maps of Lax matrices L(lam) = lam A + M + F/lam with A, F symmetric and M skew.

L(-lam) = -L(lam)^T.  With L(lam_i) q_i = mu_i q_i and K the inverse of <q_i, q_j>/(lam_i + lam_j),

    V(z) = 1 - sum_ij q_i K_ij q_j^T/(z + lam_j),   V(z) V(-z)^T = 1,

the matrix L' = V L V^-1 has no poles but those of L: V(lam_i) q_i = 0, and q_i^T L(-lam_i) = -mu_i q_i^T.  At z = oo, 0

    M' = M - [B, A],  B = sum_ij K_ij q_i q_j^T;   F' = V(0) F V(0)^T.

A point lam = x + iy, q = u + iw, and its conjugate have, with r = |u|^2 + |w|^2, s = q^T q, D = r^2 - |x s/lam|^2,

    B = (4 x/D) (r (u u^T + w w^T) - x Re[conj(s/lam) q q^T]),   V(0) = cay(-X),   X = (2 x/(y r)) u ^ w:

the identity for x = 0.  Near there (d/dx) M = -2 [Pi + Pi^T, A] and the body rotates with Omega = -(2/lam)(Pi -
Pi^T), Pi the projector of mu: a pair is the flow of int mu dlam/lam from -x + iy to x + iy (proof: paper/maps.tex), so
the flow of any function of the integrals is a product of pairs.  [the Darboux matrix of a Lax matrix: Suris 2001,
section 7, and docs/baecklund.md]
"""

import inspect
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from kreisel.algebra import KINDS, act, bracket, dot, identity, mat, parts, sign, together, vec
from kreisel.algebra.matrices import adjugate, diagonal
from kreisel.record.calling import call
from kreisel.record.contract import ConjugatePairs

SPREAD, HEIGHTS = 6.0, 14  # of |lam| tried: between the scales of the state, and this factor beyond them
APART = 1e-8  # of two scales, one of which may be rounding of zero: each has HEIGHTS points around it


@cache
def legendre(count):
    """The positive half of an even number of nodes of Gauss and Legendre; weights for an even function from 0 to 1."""
    x: Any = np.polynomial.legendre.leggauss(count)[0][count // 2 :].astype(np.longdouble)
    for _ in range(2):
        before, value = np.ones_like(x), x
        for k in range(2, count + 1):
            before, value = value, ((2 * k - 1) * x * value - (k - 1) * before) / k
        slope = count * (before - x * value) / (1 - x * x)
        x = x - value / slope
    return x, 2 / ((1 - x * x) * slope * slope)


def pencil(M, F, a, lam):
    """L for complex lam (...), one state."""
    x = np.asarray(lam)[..., None, None]
    return x * diagonal(a) + M + F / x


def longest(columns):
    """The longest column u + i w of (..., n, n), complex, up to rounding: u, w, the square of its length (..., 1)."""
    re, im = parts(columns)
    square = (re * re + im * im).sum(-2)
    u, w, size = re[..., 0], im[..., 0], square[..., :1]
    for j in range(1, columns.shape[-1]):
        more = square[..., j : j + 1] - size
        longer = (1 + sign(more)) / 2  # or 0
        u, w, size = u + longer * (re[..., j] - u), w + longer * (im[..., j] - w), size + longer * more
    return u, w, size


def eigenvector(re, im, weights=None, shift=0):
    """(u, w) with (u + i w) the eigenvector for the eigenvalue of re + i im next to 0, for a rounding error there.

    A column of the adjugate, and a step of inverse iteration: its error is the square of the eigenvalue over the gap.
    weights  (..., n): the eigenvalue is one of A q = mu (diag(weights) + i shift) q
    """
    minors = adjugate(together(re, im))
    u, w, size = longest(minors)
    u, w = u / size, w / size
    if weights is not None:
        u, w = weights * u - vec(shift) * w, weights * w + vec(shift) * u
    return parts(act(minors, together(u, w)))


def eigenvector_of_pencil(M, F, a, lam, mu):
    """(u, w) of L(lam) for the eigenvalue next to mu; M, F real."""
    (x, y), (s, t), one = parts(lam), parts(mu), identity(M.shape[-1])
    square, D = x * x + y * y, diagonal(a)
    return eigenvector(
        mat(x) * D + M + mat(x / square) * F - mat(s) * one, mat(y) * D - mat(y / square) * F - mat(t) * one
    )


def kick_and_turn(u, w, lam):
    """B and the generator X of the body's rotation."""
    x, y = parts(lam)
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    r, p, size = uu + ww, uu - ww, x * x + y * y  # p + 2i uw = <q, q>
    both = x / (r * r - x * x * (p * p + 4 * uw * uw) / size)
    c, d = p * x + 2 * uw * y, p * y - 2 * uw * x  # of lam conj <q, q>
    c, d = x * c / size, x * d / size
    U, W = u[..., :, None] * u[..., None, :], w[..., :, None] * w[..., None, :]
    both, S = 4 * both, u[..., :, None] * w[..., None, :]
    B = mat(both * (r - c)) * U + mat(both * (r + c)) * W + mat(both * d) * (S + S.mT)
    return B, mat(2 * x / (y * r)) * (S - S.mT)


def kicked(M, B, a):  # M - [B, A]
    return M + B * (a[..., :, None] - a[..., None, :])


def turned(X, z, kind):  # by V(0) = cay(-X)
    return KINDS[kind].turned(-X, z)


def heights(*scales):
    """Im lam of points to try, between the scales of lam, and their distances from 0."""
    sizes = np.array([s for s in scales if np.isfinite(s) and s > 0] or [1.0], float)
    low, high = (sizes.min(), sizes.max()) if sizes.min() > APART * sizes.max() else (sizes, sizes)
    y = np.geomspace(low / SPREAD, high * SPREAD, HEIGHTS).ravel()
    return y, y


def scales(M, F, a):
    """Values of |lam| at which two of the terms of L are of one size."""
    with np.errstate(all="ignore"):
        A, M, F = np.ptp(a) / 2, np.linalg.norm(M), np.linalg.norm(F - np.trace(F) / len(F) * identity(len(F)))
        return heights(M / A, F / M, np.sqrt(F / A))


def rates(lam, Pi, a):
    """(d/dx) M and Omega."""
    return -2 * bracket(Pi + Pi.mT, diagonal(a)), -2 / lam[..., None, None] * (Pi - Pi.mT)


# -- records ------------------------------------------------------------------------------------------


def projector_of(minors):
    """The projector of a level, from the adjugate (n, n) of recorded numbers."""
    return minors / sum(minors[i, i] for i in range(len(minors)))


def of_pencil(field, spun=None, kind=""):
    """The pairs of a system with F = `field` of the state; `spun`: the rate of P by Omega, a component of that kind."""

    def projector(M, *P, a, lam, mu):
        return projector_of(adjugate(pencil(M, field(M, *P), a, lam) - mu * identity(M.shape[-1])))

    def rates_of(M, *P, a, lam, Pi):
        rate, Omega = rates(lam, Pi, a)
        return (rate, *(spun(Omega, z) for z in P)), Omega

    def pair(M, *P, a, lam, mu):
        u, w = eigenvector_of_pencil(M, field(M, *P), a, lam, mu)
        B, X = kick_and_turn(u, w, lam)
        return (kicked(M, B, a), *(turned(X, z, kind) for z in P)), (X,)

    return ConjugatePairs(
        matrix=lambda M, *P, a, lam: pencil(M, field(M, *P), a, lam),
        heights=lambda M, *P, a: scales(M, field(M, *P), a),
        projector=projector,
        rates=rates_of,
        pair=pair,
    )


CLEBSCH = of_pencil(lambda M, P: P[..., :, None] * P[..., None, :], lambda Omega, P: -act(Omega, P), "vector")
MANAKOV = of_pencil(lambda M: 0 * M)
QUADRATIC = of_pencil(lambda M, P: P, lambda Omega, P: bracket(P, Omega), "symmetric")


FUNCTIONS = {
    "matrix": ("lam",),
    "heights": (),
    "projector": ("lam", "mu"),
    "rates": ("lam", "Pi"),
    "pair": ("lam", "mu"),
}


def under(record, letters, constants, enter=lambda *z: z, leave=lambda z: z, dimensions=(3, 4, 5)):
    """The pairs of a system with parameters of these letters, whose state and parameters are others of a record.

    constants(**parameters) of the record; enter(*state) its state; leave(state or rates) back
    """

    def adapted(name, more):
        def function(*state, **known):
            values = {**constants(**{letter: known.pop(letter) for letter in letters}), **known}
            result = call(getattr(record, name), enter(*state), values)
            return (leave(result[0]), result[1]) if name in ("rates", "pair") else result

        names = [inspect.Parameter(k, inspect.Parameter.KEYWORD_ONLY) for k in (*letters, *more)]
        function.__dict__["__signature__"] = inspect.Signature(names)
        return function

    functions = {name: adapted(name, more) for name, more in FUNCTIONS.items()}
    return replace(record, **functions, dimensions=dimensions)


def in_letter(record, letter, diagonal_of=lambda x: x, **options):
    """The pairs of a system with a = `diagonal_of` of the parameter of that letter, such as J^2."""
    return under(record, (letter,), lambda **known: {"a": diagonal_of(known[letter])}, **options)


def of_body(record):
    """The pairs of a body with the mass tensor J."""
    return in_letter(record, "J", lambda J: J * J)
