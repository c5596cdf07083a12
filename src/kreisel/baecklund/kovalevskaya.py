"""Conjugate pairs of Bäcklund maps of Kovalevskaya's top and gyrostat in one field or two, n = 3, state (M, P, Q).

L(l) = [[M, G], [G^T, N]], G = l E - F/l, F = (P, Q), E = (e_1, e_2), N = Gamma - M_11, of size 5, is a Lax matrix of
`conjugate` with A = [[0, E], [E^T, 0]], and L(-l) = J L(l) J, J = diag(1, 1, 1, -1, -1): with q = (a; b) at l goes J q
at -l.  The matrix K of the four vectors is then known in closed form.  With r = |a|^2 + |b|^2, t = |a|^2 - |b|^2,

    M' = M - (B E^T - E B^T),   B = (8 x/D) Re[(r - i t x/y) a b^+ - 2 x conj(a.a/l) a b^T],
    F' = V_a F V_b^T,   V_a = cay(-4xy/(r y^2 - t x^2) Re a ^ Im a),   V_b = cay(-4xy/(r y^2 + t x^2) Re b ^ Im b),
    D = r^2 - 4 |x a.a/l|^2 + (t x/y)^2,

and a rotation R = V_b^-1 of the first two axes of the body makes V_a F V_b^T a rotation of only the body.  [the Lax
matrix: Reyman, Semenov-Tian-Shansky 1987, Bobenko, Reyman, Semenov-Tian-Shansky 1989]
"""

import numpy as np

from kreisel.algebra import (
    KINDS,
    act,
    dot,
    identity,
    mat,
    pairing,
    parts,
    shifted_resolvent,
    sqrt,
    together,
    wedge,
    where_less,
)
from kreisel.algebra.backend import Complex
from kreisel.algebra.invariants import adjugate
from kreisel.baecklund.conjugate import longest, norm, projector_of, under
from kreisel.record.contract import ConjugatePairs

LOW, HIGH, CLEAR = 0.3, 12.0, 1.05  # |l| that are tried, in units of the largest |M|; |mu| is larger than |M| by CLEAR
TWO = identity(2)


def columns(P, Q, lam):
    """G = l E - F/l."""
    unit = identity(3)
    return np.stack([lam * unit[0] - P / lam, lam * unit[1] - Q / lam], -1)


def rotor(M, gamma):
    """N = Gamma - M_11."""
    return mat(gamma - M[..., 0, 1]) * wedge(TWO[0], TWO[1])


def matrix(M, P, Q, *, lam, gamma=0):
    G = columns(P, Q, np.asarray(lam)[..., None])
    top = np.concatenate([M + 0 * G[..., :1], G], -1)
    return np.concatenate([top, np.concatenate([G.mT, rotor(M, gamma) + 0 * G[..., :2, :]], -1)], -2)


def largest(M, P, Q, gamma):
    """A bound of |M| on the orbit, from the energy."""
    energy = pairing(M, M) / 2 + M[0, 1] * M[0, 1] / 2 - gamma * M[0, 1] + P[0] + Q[1]
    square = 2 * (energy + norm(P) + norm(Q)) + gamma * gamma
    return sqrt(where_less(0, square, square, 1))


def heights(M, P, Q, *, gamma=0):
    unit = largest(M, P, Q, gamma)
    return [(0.0, 1, LOW * unit, HIGH * unit)]


def spectrum(M, P, Q, *, y, gamma=0):
    """alpha and beta at l = iy, where the eigenvalues are 0, +-i alpha, +-i beta; positive if mu - M is never singular.

    Then |mu| is larger than |M| is anywhere on the orbit.
    """
    L, least = matrix(M, P, Q, gamma=gamma, lam=Complex(0.0, y)), CLEAR * largest(M, P, Q, gamma)
    square = L @ L  # its eigenvalues are 0, two -alpha^2, two -beta^2
    half, fourth = -parts(np.trace(square))[0] / 4, parts((square * square.mT).sum())[0] / 4
    size = fourth - half * half
    root = sqrt(where_less(0, size, size, 0))
    low = half - root
    alpha, beta = sqrt(half + root), sqrt(where_less(0, low, low, 0))
    return (alpha, beta, -alpha, -beta), low - least * least


def rates(M, P, Q, *, lam, Pi):
    E = identity(3)[:, :2]
    S, turn = (Pi + Pi.mT)[..., :3, 3:], -4 / lam[..., None, None] * (Pi - Pi.mT)
    rho = E @ turn[..., 3:, 3:] @ E.T
    Omega = turn[..., :3, :3] - rho
    return (-4 * (S @ E.T - E @ S.mT) + rho @ M - M @ rho, -act(Omega, P), -act(Omega, Q)), Omega


def eigenvector(M, P, Q, *, gamma, lam, mu):
    """(a, b) for the eigenvalue next to mu, by a step of Newton's method for det S = 0, S = mu - N - G^T (mu - M)^-1 G.

    Then S b = 0 and a = (mu - M)^-1 G b.
    """
    G = columns(P, Q, lam)
    Y = np.stack([shifted_resolvent(mu, M, G[..., i]) for i in (0, 1)], -1)
    Z = np.stack([shifted_resolvent(mu, M, Y[..., i]) for i in (0, 1)], -1)
    S, slope = mat(mu) * TWO - rotor(M, gamma) - G.mT @ Y, TWO + G.mT @ Z
    minors = adjugate(S)
    shift = -(S[..., 0, :] * minors[..., :, 0]).sum(-1) / (minors * slope.mT).sum(-1).sum(-1)
    u, w, size = longest(adjugate(S + mat(shift) * slope))
    b = together(u / size, w / size)
    return act(Y - mat(shift) * Z, b), b


def projector(M, P, Q, *, lam, mu, gamma=0):
    G = columns(P, Q, lam)
    right, left = (
        np.stack([*np.stack([shifted_resolvent(mu, s * M, G[..., i]) for i in (0, 1)], -1), *TWO]) for s in (1, -1)
    )
    return projector_of(right @ adjugate(mu * TWO - rotor(M, gamma) - G.mT @ right[:3]) @ left.mT)


def pair(M, P, Q, *, lam, mu, gamma=0):
    a, b = map(parts, eigenvector(M, P, Q, gamma=gamma, lam=lam, mu=mu))
    (u, w), (v, z), (x, y) = a, b, parts(lam)
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    ra, rb, p, size = uu + ww, dot(v, v) + dot(z, z), uu - ww, x * x + y * y
    r, t = ra + rb, ra - rb
    bend = t * x / y
    factor = 8 * x / (r * r - 4 * x * x * (p * p + 4 * uw * uw) / size + bend * bend)
    c, d = 2 * x * (p * x + 2 * uw * y) / size, 2 * x * (p * y - 2 * uw * x) / size
    left, right = mat(r - c) * u[..., None] + mat(d + bend) * w[..., None], mat(d - bend) * u[..., None]
    B = mat(factor) * (left * v[..., None, :] + (right + mat(r + c) * w[..., None]) * z[..., None, :])
    E, plane = identity(3)[:, :2], wedge(identity(3)[0], identity(3)[1])
    X = mat(4 * x * y / (r * y * y - t * x * x)) * wedge(u, w)
    Y = mat(-4 * x * y / (r * y * y + t * x * x) * (v[..., 0] * z[..., 1] - v[..., 1] * z[..., 0])) * plane
    M = KINDS["skew"].turned(-Y, M - B @ E.T + E @ B.mT)
    return (M, *(KINDS["vector"].turned(-Y, KINDS["vector"].turned(-X, V)) for V in (P, Q))), (X, Y)


TWO_FIELDS = ConjugatePairs(matrix, heights, projector, rates, pair, spectrum=spectrum, dimensions=(3,))
ONE_FIELD = under(TWO_FIELDS, (), dict, lambda M, P: (M, P, 0 * P), lambda z: z[:2], (3,))
