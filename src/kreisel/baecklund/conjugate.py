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
from functools import cache, reduce
from itertools import combinations
from typing import Any

import numpy as np

from kreisel.algebra import KINDS, act, bracket, dot, identity, mat, parts, sign, sqrt, together, vec, where_less
from kreisel.algebra.invariants import adjugate, diagonal
from kreisel.record.calling import call
from kreisel.record.contract import ConjugatePairs

SPREAD, HEIGHTS = 6.0, 14  # of |lam| tried: between the scales of the state, and this factor beyond them
LARGE, ROUNDING, LAGUERRE = 1e300, 1e-15, 20  # of scales; of a squared step; most steps
FAR = 1e6  # times the largest of these, beyond which levels are rounding
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
        excess = square[..., j : j + 1] - size
        longer = (1 + sign(excess)) / 2  # or 0
        u, w, size = u + longer * (re[..., j] - u), w + longer * (im[..., j] - w), size + longer * excess
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
    (x, y), (s, t), unit = parts(lam), parts(mu), identity(M.shape[-1])
    square, D = x * x + y * y, diagonal(a)
    return eigenvector(
        mat(x) * D + M + mat(x / square) * F - mat(s) * unit, mat(y) * D - mat(y / square) * F - mat(t) * unit
    )


def kick_and_turn(u, w, lam):
    """B and the generator X of the body's rotation."""
    x, y = parts(lam)
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    r, p, size = uu + ww, uu - ww, x * x + y * y  # p + 2i uw = <q, q>
    factor = x / (r * r - x * x * (p * p + 4 * uw * uw) / size)
    c, d = p * x + 2 * uw * y, p * y - 2 * uw * x  # of lam conj <q, q>
    c, d = x * c / size, x * d / size
    U, W = u[..., :, None] * u[..., None, :], w[..., :, None] * w[..., None, :]
    factor, S = 4 * factor, u[..., :, None] * w[..., None, :]
    B = mat(factor * (r - c)) * U + mat(factor * (r + c)) * W + mat(factor * d) * (S + S.mT)
    return B, mat(2 * x / (y * r)) * (S - S.mT)


def kicked(M, B, a):  # M - [B, A]
    return M + B * (a[..., :, None] - a[..., None, :])


def turned(X, z, kind):  # by V(0) = cay(-X)
    return KINDS[kind].turned(-X, z)


def heights(*scales, origin=0.0, side=1):
    """Rows (origin, side, low, high): points iy with y = origin + side e, e from low to high; low = 0 for none.

    One row from the least to the largest scale, or one for each if they are far apart.
    """
    sizes = [where_less(0, s, where_less(s, LARGE, s, 0), 0) for s in scales]
    low, high = LARGE, 0
    for s in sizes:
        low, high = where_less(0, s, where_less(s, low, s, low), low), where_less(high, s, s, high)
    apart, some = (lambda yes, no: where_less(APART * high, low, no, yes)), (lambda s: where_less(0, high, s, 1))
    rows = [(apart(sizes[0], some(low)), apart(sizes[0], some(high)))]
    rows += [(apart(s, 0), s) for s in sizes[1:]]
    return [(origin, side, low / SPREAD, high * SPREAD) for low, high in rows]


def norm(x):
    return sqrt((x * x).sum())


def spread(x):
    """The difference of the largest and the least entry."""
    return reduce(largest, x) + reduce(largest, -x)


def largest(x, y):
    return where_less(x, y, y, x)


def scales(M, F, a):
    """Rows of |lam| at which two of the terms of L are of one size; beyond, up to |M_ij/(a_i - a_j)|.

    For moments from 1 to 1000, maps of the first rows rotate by hundreds of radians for a radian of the motion.
    """
    A, size, field = spread(a) / 2, norm(M), norm(F - np.trace(F) / len(F) * identity(len(F)))
    rows = heights(size / A, field / size, sqrt(field / A))
    low = reduce(largest, [row[3] for row in rows])
    ratios = [abs(M[i, j] / (a[i] - a[j])) for i, j in combinations(range(len(a)), 2)]
    high, most = SPREAD * reduce(largest, [where_less(x, LARGE, x, 0) for x in ratios]), FAR * low
    some = where_less(low, high, 1, 0)
    return [*rows, (0.0, 1, some * low, some * where_less(high, most, high, most))]


def levels(H):
    """The real eigenvalues of a matrix (n, n) of recorded complex values, a Hermitian one up to a change of basis.

    Laguerre's method from above for the largest one, again and again, and a quadratic equation for the last two.
    """
    n = len(H)
    middle = parts(np.trace(H))[0] / n
    H = H - middle * identity(n)
    sums, power = [0.0], H
    for k in range(2, n + 1):
        sums.append(parts((power * H.T).sum())[0])
        power = power @ H if k < n else power
    e = [1.0]  # elementary symmetric functions
    for k in range(1, n + 1):
        e.append(sum((-1) ** (i - 1) * e[k - i] * sums[i - 1] for i in range(1, k + 1)) / k)
    p, roots, square = [(-1) ** k * v for k, v in enumerate(e)], [], sums[1]
    for degree in range(n, 2, -1):

        def nearer(x, p=p, degree=degree):
            value, slope, bend = p[0], 0.0, 0.0
            for c in p[1:]:
                value, slope, bend = value * x[0] + c, slope * x[0] + value, bend * x[0] + slope
            m = degree - 1
            size = m * m * slope * slope - 2 * degree * m * value * bend
            step = degree * value / (slope + sqrt(where_less(0, size, size, 0)))
            return [where_less(0, step * step, x[0] - step, x[0])], step * step / square

        start = -p[1] / degree + sqrt(square)
        (root,), _ = start.graph.loop(lambda x, f=nearer: f(x), [start], ROUNDING, LAGUERRE)
        roots.append(root)
        shorter = [p[0]]
        for c in p[1:-1]:
            shorter.append(shorter[-1] * root + c)
        p = shorter
    half = -p[1] / 2
    size = half * half - p[2]
    wide = sqrt(where_less(0, size, size, 0))
    return [middle + x for x in (*roots, half + wide, half - wide)]


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
    "spectrum": ("y",),
}


def under(record, letters, constants, enter=lambda *z: z, leave=lambda z: z, dimensions=(3, 4, 5)):
    """The pairs of a system with parameters of these letters, whose state and parameters are others of a record.

    constants(**parameters) of the record; enter(*state) its state; leave(state or rates) back
    """

    def adapted(name, arguments):
        def function(*state, **keywords):
            values = {**constants(**{letter: keywords.pop(letter) for letter in letters}), **keywords}
            result = call(getattr(record, name), enter(*state), values)
            return (leave(result[0]), result[1]) if name in ("rates", "pair") else result

        names = [inspect.Parameter(k, inspect.Parameter.KEYWORD_ONLY) for k in (*letters, *arguments)]
        function.__dict__["__signature__"] = inspect.Signature(names)
        return function

    functions = {
        name: adapted(name, arguments) for name, arguments in FUNCTIONS.items() if getattr(record, name) is not None
    }
    return replace(record, **functions, dimensions=dimensions)


def in_letter(record, letter, diagonal_of=lambda x: x, **options):
    """The pairs of a system with a = `diagonal_of` of the parameter of that letter, such as J^2."""
    return under(record, (letter,), lambda **constants: {"a": diagonal_of(constants[letter])}, **options)


def of_body(record):
    """The pairs of a body with the mass tensor J."""
    return in_letter(record, "J", lambda J: J * J)
