"""Kovalevskaya's top on e(3), so(4) and so(3,1), and Sokolov's case, with a rotor.  State (M, P), axial vectors.

The brackets of e(3)*, but P_i and P_j have -kappa times the bracket of M_i and M_j: kappa < 0 gives so(4), kappa > 0
so(3,1).  With n = M_3 + gamma,

    H = (M_1^2 + M_2^2)/2 + M_3^2 + gamma M_3 + c P_1 + beta n P_2 - beta^2 P_3^2/2,
    K = |n M + a x P|^2 - kappa <a, M>^2 + 2 <M, P> (c M_1 + beta n M_2 - beta^2 n P_3),   a = (beta n, -c, 0).

beta = 0: Kovalevskaya's top and gyrostat on e(3), Komarov's on the others; c = 0: Sokolov's case.  The Lax matrix has
size 7: b nu + m - mu S with S = diag(1, 1, 1, 1, 1, -kappa, -beta^2), and with lambda = mu/nu

    L = m (b - lambda S)^-1,   L' = [L, U],   U = -(A^T + L B^T),   m' = A^T m + m A.

For gamma = 0, with C = |P|^2 - kappa |M|^2, D = <M, P>, w = kappa beta^2, z = M_1 + i M_2, y = P_1 + i P_2 and
k = c + i beta M_3, Kovalevskaya's integral |(1 - w) z^2 - beta^2 y^2 - 2 k y - kappa k^2|^2/4 is

    (H + (kappa c^2 + beta^2 C)/2)^2 + (1 - w) (c^2 C - beta^2 D^2 - K).

Plus bracket, F' = {H, F}.  [Kovalevskaya 1889; Komarov 1981; Sokolov 2001; Borisov, Mamaev, Sokolov 2001; Komarov,
Sokolov, Tsiganov 2003.  The Lax pair was derived here; it was not compared with theirs]

Conjugate pairs of Bäcklund maps: (lam b + m - mu S) q = 0 is the pencil, its rows in two blocks of four and three,
q = (a, q_6; b, q_7); at -lam the vector is J q, J = diag(1, 1, 1, -1, -1, 1, -1).  As for Kovalevskaya's top the matrix
of the four vectors of a point lam = x + iy and its conjugate is known in closed form: with r = q^T S q*, s = q^T S q,
t = q^T S J q*,

    m' = m + b Q S - S Q b,   Q = (8x/D) Re[(r - i t x/y) a b^+ - x conj(s/lam) a b^T] between the blocks,
    D = r^2 - |x s/lam|^2 + (t x/y)^2,   W = cay(4xy/(r y^2 + t x^2) (Re b ^ Im b) S) on the second block,

m' having the second block W^T (m - mu S) W.  Rotations of the axes 1 and 2 act on it, and the maps that keep its last
column (c, beta n) are the ones that keep the direction of f = (1, 0, -beta).  So a rotation follows, that makes the
first two entries of W^T f a multiple of (1, 0): the factor W is a rotation times such a map, as in Iwasawa's
decomposition.  [The pencil and the maps were derived here]
"""

from functools import reduce

import numpy as np

from kreisel.algebra import (
    KINDS,
    axial,
    bracket,
    cross,
    dot,
    hat,
    identity,
    mat,
    parts,
    shifted_resolvent as resolvent,
    sqrt,
    together as complex_of,
    vec,
    where_less,
)
from kreisel.algebra.backend import Complex
from kreisel.algebra.invariants import blocks, lie_poisson, stack
from kreisel.baecklund.conjugate import LARGE, largest, longest, norm
from kreisel.errors import InputError
from kreisel.record.contract import MOVING_SPACE, ConjugatePairs, Parameter, PhaseSpace, System, named

LOW, HIGH, CLEAR = 0.3, 12.0, 1.05  # |lam| tried in units of the sizes; |mu| is larger than |M| by CLEAR
SHIFTS = np.geomspace(1e-3, 1e3, 13).tolist()
NEAR, MOST = 1e-20, 20  # of Newton's method: a squared change, relative, after which the next one is rounding; steps
REAL = 1e-14  # relative: the rounding of a discriminant that is 0
THIRD = np.array([0, 0, 1], dtype=np.int8)
BLOCKS = np.array([0, 1, 2, 5, 3, 4, 6])
UNITS = np.zeros((3, 7, 7), dtype=np.int8)
for k, (i, j) in enumerate(((0, 3), (1, 4), (5, 6))):
    UNITS[k, i, j] = UNITS[k, j, i] = 1
PENCIL = UNITS[0] + UNITS[1] - UNITS[2]  # b


def tensor(M, P, *, kappa):
    """The tensor of e(3)*, with {P_i, P_j} = kappa M_ij added."""
    low = blocks([[0 * M, 0 * M], [0 * M, M]])
    return lie_poisson(("skew", "vector"), M, P) + mat(kappa) * low


def casimirs(M, P, *, kappa):  # |P|^2 - kappa |M|^2,   <M, P>
    u = axial(M)
    return stack([dot(P, P) - kappa * dot(u, u), dot(u, P)])


def lever(M, *, beta, c, gamma):  # (c, beta n, 0): dH/dP at P_3 = 0
    n = axial(M)[..., 2][()] + gamma
    return stack([c + 0 * n, beta * n, 0 * n])


def gradients(M, P, *, beta, c, gamma):
    """dH/dM = (M_1, M_2, M_3 + n + beta P_2), dH/dP = (c, beta n, -beta^2 P_3)."""
    u, (first, second, third), beta = axial(M), identity(3), vec(beta)
    Omega = u + (u + vec(gamma) + beta * P[..., [0, 2, 1]]) * third
    return Omega, vec(c) * first + beta * (u[..., [0, 2, 1]] + vec(gamma)) * second - beta * beta * P * third


def flow(M, P, *, kappa, beta, c, gamma):  # M' = M x dH/dM + P x dH/dP,   P' = P x dH/dM - kappa M x dH/dP
    (Omega, U), u = gradients(M, P, beta=beta, c=c, gamma=gamma), axial(M)
    return hat(cross(u, Omega) + cross(P, U)), cross(P, Omega) - vec(kappa) * cross(u, U)


def energy(M, P, *, beta, c, gamma):
    x, y, z = (axial(M)[..., i] for i in range(3))
    p, q, r = (P[..., i] for i in range(3))
    return (x * x + y * y) / 2 + z * (z + gamma) + c * p + beta * (z + gamma) * q - beta * beta * r * r / 2


def komarov(M, P, *, kappa, beta, c, gamma):  # K
    u, e = axial(M), lever(M, beta=beta, c=c, gamma=gamma)
    a, n = stack([e[..., 1], -e[..., 0], e[..., 2]]), u[..., 2] + gamma
    V, along = vec(n) * u + cross(a, P), dot(a, u)
    return dot(V, V) - kappa * along * along + 2 * dot(u, P) * (dot(e, u) - beta * beta * n * P[..., 2])


# -- the Lax pair: sizes 3, 2, 1, 1 -------------------------------------------------------------------

PLANE = np.array([[0, 1], [-1, 0]], dtype=np.int8)


def skew_of(M, P, *, beta, c, gamma):  # m
    e = lever(M, beta=beta, c=c, gamma=gamma)[..., :2, None]
    n, P = axial(M)[..., 2] + gamma, P[..., None]
    zero, none = 0 * M[..., :2], 0 * P[..., :1, :]
    return blocks(
        [
            [M, zero, P, 0 * P],
            [zero.mT, mat(n) * PLANE, 0 * e, e],
            [-P.mT, 0 * e.mT, none, none],
            [0 * P.mT, -e.mT, none, none],
        ]
    )


def inverse(kappa, beta, lam):
    """(b - lambda S)^-1."""
    square, w = lam * lam, kappa * beta * beta
    ones, zero = 1 + 0 * kappa * lam, 0 * kappa * lam
    x, y, z = -lam / (square - 1) * ones, -ones / (square - 1), -ones / lam
    scale = 1 / (w * square - 1)
    p, q, r = lam * beta * beta * scale, scale, lam * kappa * scale
    rows = np.stack([x, x, z, x, x, p, r], -1)[..., None] * identity(7)
    for unit, value in zip(UNITS, (y, y, q), strict=True):
        rows = rows + mat(value + zero) * unit
    return rows


def lax(M, P, *, kappa, beta, c, gamma, lam):
    Omega, U = gradients(M, P, beta=beta, c=c, gamma=gamma)
    square, p, U = beta * beta, P[..., None], U[..., None]
    zero, none, plane = 0 * M[..., :2], 0 * p[..., :1, :], p[..., :2, :]
    A = blocks(
        [
            [hat(Omega), zero, mat(-kappa) * U, 0 * p],
            [zero.mT, mat(-beta * P[..., 1]) * PLANE, 0 * plane, mat(-square) * plane],
            [-U.mT, 0 * plane.mT, none, none],
            [0 * p.mT, -plane.mT, none, none],
        ]
    )
    B = UNITS[0] + UNITS[1] + mat(square) * np.triu(UNITS[2]) + mat(kappa) * np.tril(UNITS[2])
    L = skew_of(M, P, beta=beta, c=c, gamma=gamma) @ inverse(kappa, beta, lam)
    return L, -(A.mT + L @ B.mT)


def curve(M, P, *, kappa, beta, c, gamma):
    """r, e_0 to e_4, w, with u = nu^2 and v = mu^2.

    det(nu b + m - mu S)/mu = (u-v)^2 (u - w v) + (r - e_1 - e_2) u^2 + e_0 u + e_1 uv + e_2 v^2 + e_3 v + e_4.
    """
    first, along = (casimirs(M, P, kappa=kappa)[..., i][()] for i in (0, 1))
    constants, square = {"beta": beta, "c": c, "gamma": gamma}, beta * beta
    second, w = square * first + kappa * c * c, kappa * square
    rotor = gamma * gamma * (1 - w)
    mixed = 2 * energy(M, P, **constants) - second + rotor
    along, K = along * along, komarov(M, P, kappa=kappa, **constants)
    return rotor, K, mixed, second, square * along - c * c * first, -c * c * along, w


# -- conjugate pairs of Bäcklund maps ------------------------------------------------------------------


def cubic(coefficients, lam):
    """The polynomial for y = mu^2 - lam^2, the highest power first: det L/mu over lam^2."""
    rotor, linear, mixed, square, third, last, w = coefficients
    u = lam * lam
    X = 1 / u
    return -w * X, 1 - w + square * X, mixed + 2 * square + third * X, rotor * u + linear + third + last * X


def newton(p, y):
    """The step -p(y)/p'(y)."""
    a, b, c, d = p
    return -(((a * y + b) * y + c) * y + d) / ((3 * a * y + 2 * b) * y + c)


def lower_roots(p):
    """The two roots next to 0 of a recorded cubic a y^3 + b y^2 + ..., -1 unless they are real and these two.

    Newton's method for the factor y^2 + 2 h y + q, from that for a = 0; a y + r is the third one.
    """
    a, b, c, d = p

    def nearer(x):
        h, q = x
        r = b - 2 * a * h
        f, g, slope = c - a * q - 2 * h * r, d - q * r, r - 2 * a * h
        det, size = slope * r + a * a * q, h * h + abs(q)
        first, second = (f * r - a * g) / (2 * det), (slope * g + a * q * f) / det
        return [h + first, q + second], first * first / size + second * second / (size * size)

    (h, q), change = d.graph.loop(nearer, [c / (2 * b), d / b], NEAR, MOST)
    size, r = h * h - q, b - 2 * a * h
    root = sqrt(where_less(0, size, size, 0))
    roots = root - h, -root - h
    sound = where_less(r * r, a * a * largest(*(y * y for y in roots)), -1, 1)
    return roots, where_less(size, -REAL * (h * h + abs(q)), -1, where_less(NEAR, change, -1, sound))


def eliminated(M, P, n, e, kappa, beta, lam, mu):
    """The matrix for (b_1, b_2) after elimination: its adjugate, and (a, q_6, q_7) for the two unit vectors."""
    unit, square = identity(3), beta * beta * mu
    along = resolvent(mu, M, P)
    scale = 1 / (kappa * square * mu - lam * lam - square * dot(P, along))
    columns, rows = [], []
    for i in (0, 1):
        X = resolvent(mu, M, unit[i])
        sixth = lam * (e[i] + square * dot(P, X)) * scale
        a = vec(lam) * X + vec(sixth) * along
        seventh = (kappa * mu * sixth - dot(P, a)) / lam
        rows.append([lam * a[..., j][()] + e[j] * seventh - mu * (i == j) + n * (i - j) for j in (0, 1)])
        columns.append((a, sixth, seventh))
    (A, C), (B, D) = rows
    return np.stack([np.stack([D, -B], -1), np.stack([-C, A], -1)], -2), columns


def vector(M, P, n, e, kappa, beta, lam, mu):
    """(a, q_6) (..., 4) and (b, q_7) (..., 3) for mu: of the transposed pencil for -M, -P, -n, -e."""
    minors, ((a0, s0, z0), (a1, s1, z1)) = eliminated(M, P, n, e, kappa, beta, lam, mu)
    u, w, size = longest(minors)
    b = complex_of(u / size, w / size)
    p, q = b[..., 0][()], b[..., 1][()]
    a = vec(p) * a0 + vec(q) * a1
    a = np.stack([*(a[..., i][()] for i in range(3)), p * s0 + q * s1], -1)
    return a, np.stack([p, q, p * z0 + q * z1], -1)


def column(M, *, beta, c, gamma):  # n and (c, beta n)
    n = axial(M)[..., 2][()] + gamma
    return n, (c + 0 * n, beta * n)


def forms(kappa, beta):
    """The diagonal of S on the two blocks."""
    unit = 1 + 0 * kappa
    return np.stack([unit, unit, unit, -kappa], -1), np.stack([unit, unit, -beta * beta], -1)


def metric(*, kappa, beta):
    return np.concatenate(forms(kappa, beta), -1)


def moved(Q, kappa):
    """The changes of M and P by Q (..., 4, 3)."""
    E, sides = identity(3)[:, :2], Q[..., :3, :2]
    return E @ sides.mT - sides @ E.T, Q[..., :3, 2] - vec(kappa) * (Q[..., 3, :2] @ E.T)


def projector(M, P, *, kappa, beta, c, gamma, lam, mu):
    (n, e), sides = column(M, beta=beta, c=c, gamma=gamma), []
    for s in (-1, 1):
        minors, columns = eliminated(s * M, s * P, s * n, (s * e[0], s * e[1]), kappa, beta, lam, mu)
        pairs = zip(columns, identity(2), strict=True)
        sides.append(np.stack([np.stack([*a, sixth, *unit, seventh]) for (a, sixth, seventh), unit in pairs], -1))
    Pi, S = sides[1] @ minors @ sides[0].mT, metric(kappa=kappa, beta=beta)
    return Pi / (S * np.diagonal(Pi)).sum()


def rates(M, P, *, kappa, lam, beta, Pi):
    first, second = moved(4 * (Pi + Pi.mT)[..., :4, 4:], kappa)
    N = -4 / mat(lam) * (Pi - Pi.mT)[..., 4:, 4:]
    turn = -(N[..., 0, 1] + beta * N[..., 1, 2])
    spun = mat(turn) * bracket(hat(THIRD), M), vec(turn) * cross(THIRD, P)
    return (first + spun[0], second + spun[1]), 0 * first


def pair(M, P, *, kappa, beta, c, gamma, lam, mu):
    (x, y), (n, e) = parts(lam), column(M, beta=beta, c=c, gamma=gamma)
    p = cubic(curve(M, P, kappa=kappa, beta=beta, c=c, gamma=gamma), lam)
    mu = mu + newton(p, mu * mu - lam * lam) / (2 * mu)
    a, b = vector(M, P, n, e, kappa, beta, lam, mu)
    (u, w), (v, z), (A, B) = parts(a), parts(b), forms(kappa, beta)
    ra, rb = dot(u, A * u) + dot(w, A * w), dot(v, B * v) + dot(z, B * z)
    p, h = dot(u, A * u) - dot(w, A * w) + dot(v, B * v) - dot(z, B * z), dot(u, A * w) + dot(v, B * z)
    r, t, size = ra + rb, ra - rb, x * x + y * y
    bend = t * x / y
    factor = 8 * x / (r * r - x * x * (p * p + 4 * h * h) / size + bend * bend)
    d, f = x * (p * x + 2 * h * y) / size, x * (p * y - 2 * h * x) / size  # x conj(s/lam) = d + i f, s = p + 2i h
    left, right = mat(r - d) * u[..., None] + mat(f + bend) * w[..., None], mat(f - bend) * u[..., None]
    Q = mat(factor) * (left * v[..., None, :] + (right + mat(r + d) * w[..., None]) * z[..., None, :])
    first, second = moved(Q, kappa)
    X = mat(tangent(v, z, B, beta, 4 * x * y / (r * y * y + t * x * x))) * hat(THIRD)
    return (KINDS["skew"].turned(X, M + first), KINDS["vector"].turned(X, P + second)), ()


def tangent(v, z, B, beta, zeta):
    """The tangent of half the angle of the rotation, for W = cay(zeta (v ^ z) B)."""
    vv, zz, vz = dot(v, B * v), dot(z, B * z), dot(v, B * z)
    (v1, v2, v3), (z1, z2, z3) = (tuple(t[..., i][()] for i in range(3)) for t in (v, z))
    vf, zf = v1 - beta * v3, z1 - beta * z3
    scale = 2 * zeta / (1 + zeta * zeta * (vv * zz - vz * vz))
    p, q = ((1 - zeta * vz) * zf + zeta * zz * vf) * scale, ((1 + zeta * vz) * vf - zeta * vv * zf) * scale
    return (v2 * p - z2 * q) / (2 - (v1 * p - z1 * q) - beta * (v3 * p - z3 * q))


def bounded(*, kappa, beta):
    """Raises `InputError` unless kappa beta^2 < 1."""
    most = float(np.max(kappa * beta * beta))
    if most >= 1:
        raise InputError(
            f"maps of komarov: expected kappa beta^2 < 1, got {most:.3g}, for which the motion may be unbounded. Use "
            "method='dop853'."
        )


def bounds(M, P, *, kappa, beta, c, gamma):
    """Bounds of |M| and |P| on the orbit, from H + s (|P|^2 - kappa |M|^2), a positive form for some s."""
    square, u, size, H = beta * beta, axial(M), norm(P), energy(M, P, beta=beta, c=c, gamma=gamma)
    unit, rate = largest(abs(c), square * size), largest(0, 2 * kappa / (1 - kappa * square))  # s - square/2 < 1/rate
    rise, first, second = largest(size / where_less(0, unit, unit, 1), rate), LARGE, LARGE
    rise = where_less(0, rise, rise, 1)
    for shift in SHIFTS:
        above = 1 / (rise / shift + rate)
        s = square / 2 + above
        third = 1 - s * kappa
        det = third * s - square / 4
        m, p = above * gamma / (2 * det), beta * gamma * (third - 1 / 2) / (2 * det)
        room = H + s * (dot(P, P) - kappa * dot(u, u)) + c * c / (4 * s) + gamma * (m + beta * p) / 2
        room = largest(0, room)
        most = sqrt(room * largest(1 / (third - 1 / 2), s / det)) + abs(m)
        far = sqrt(room * reduce(largest, (1 / s, third / det, 1 / above))) + abs(p) + abs(c) / (2 * s)
        first, second = where_less(most, first, most, first), where_less(far, second, far, second)
    return first, where_less(0, abs(kappa), second, size)


def heights(M, P, *, kappa, beta, c, gamma):
    most, far = bounds(M, P, kappa=kappa, beta=beta, c=c, gamma=gamma)
    unit = reduce(largest, (most, abs(beta) * far, sqrt(abs(kappa)) * abs(c)))
    unit = where_less(0, unit, unit, 1)
    return [(0.0, 1, LOW * unit, HIGH * unit)]


def spectrum(M, P, *, kappa, beta, c, gamma, y):
    """mu = i m for the two mu^2 next to -y^2, and a positive number if |mu| is larger than |M| is on the orbit."""
    most, far = bounds(M, P, kappa=kappa, beta=beta, c=c, gamma=gamma)
    p = cubic(curve(M, P, kappa=kappa, beta=beta, c=c, gamma=gamma), Complex(0.0, y))
    roots, use = lower_roots([parts(x)[0] for x in p])
    m = [sqrt(where_less(x, y * y, y * y - x, 0)) for x in roots]
    for x in m:
        gap = y * y - kappa * beta * beta * x * x
        room = where_less(0, gap, x * (1 - beta * beta * far * far / gap) - CLEAR * most, -1)
        use = where_less(use, room, use, room)
    return (*m, *(-x for x in m)), use


def matrix(M, P, *, beta, c, gamma, lam):
    """lam b + m, its rows in the order of the blocks."""
    L = np.asarray(lam)[..., None, None] * PENCIL + skew_of(M, P, beta=beta, c=c, gamma=gamma)
    return L[..., BLOCKS[:, None], BLOCKS]


PAIRS = ConjugatePairs(matrix, heights, projector, rates, pair, spectrum, metric, bounded, between=4, dimensions=(3,))

SYSTEM = System(
    name="komarov",
    title="Kovalevskaya's top on e(3), so(4) and so(3,1), with Sokolov's terms and a rotor",
    equations="M' = M x dH/dM + P x dH/dP,  P' = P x dH/dM - kappa M x dH/dP",
    source="Komarov 1981, Sokolov 2001, Komarov, Sokolov, Tsiganov 2003",
    space=PhaseSpace(
        name="e*(3), so*(4), so*(3,1)",
        components=MOVING_SPACE.components,
        tensor=tensor,
        casimirs=casimirs,
        momentum=MOVING_SPACE.momentum,
        sign=+1,
        carried=(),
    ),
    parameters=(
        Parameter(
            "kappa", "scalar", "curvature of the phase space: zero is e(3), negative so(4), positive so(3,1)", None, 0.0
        ),
        Parameter("beta", "scalar", "strength of Sokolov's terms", None, 0.0),
        Parameter("c", "scalar", "strength of the linear potential", None, 1.0),
        Parameter("gamma", "scalar", "the momentum of a rotor along the third axis", None, 0.0),
    ),
    **named(flow, energy, lax),
    integrals={"komarov": komarov},
    commuting=("komarov",),
    pairs=PAIRS,
    n=3,
    notes="Without Sokolov's terms it is Kovalevskaya's top on e(3), Komarov's on so(4) and so(3,1); without the "
    "linear potential Sokolov's case. No explicit map is known; method='exact'.",
)
