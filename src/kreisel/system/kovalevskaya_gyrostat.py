"""Kovalevskaya gyrostat in two fields, in n dimensions, with an explicit map.  State (M, P, Q), body frame.

M (..., n, n) skew, P and Q (..., n): two constant fields in the body frame, F = (P, Q).  With M_11 the upper left 2 x 2
block and E = (e_1, e_2), H = <M, M>/2 + <M_11, M_11>/2 - gamma M_12 + P_1 + Q_2.  Q = 0 is Kovalevskaya's top in the
field P; for n = 3 it has the moments of inertia (1, 1, 1/2).  Plus bracket, F' = {H, F}.

The map is that of `quadratic_field` on so(n) x so(2), M (+) N with N = gamma e_1 ^ e_2 - M_11, B = [[0, E], [E^T, 0]]
and the field -[[0, F], [F^T, 0]], which SO(2) rotates so that E stays: with k = eps/2 and F~ = F (1 - k^2 F_11)^-1

    M~ = M + eps (E F~^T - F~ E^T),   M_(k+1) = R M~ R^T,   F_(k+1) = R cay(-k M~) F,   R = cay(k N~) on the plane of E.

[Reyman, Semenov-Tian-Shansky 1987; Bobenko, Reyman, Semenov-Tian-Shansky, Comm. Math. Phys. 122 (1989); named in
Suris 2001, Introduction; the map was found by `kreisel.lab.search`]

Conjugate pairs of Bäcklund maps, n = 3: L(l) = [[M, G], [G^T, N]], G = l E - F/l, N = Gamma - M_11, of size 5, is a Lax
matrix of `kreisel.baecklund.conjugate` with A = [[0, E], [E^T, 0]], and L(-l) = J L(l) J, J = diag(1, 1, 1, -1, -1):
with q = (a; b) at l goes J q at -l.  The matrix K of the four vectors is then known in closed form.  With
r = |a|^2 + |b|^2, t = |a|^2 - |b|^2,

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
    axial,
    cayley,
    cayley_columns,
    dot,
    hat,
    identity,
    mat,
    pairing,
    parts,
    shifted_resolvent,
    solve,
    sqrt,
    together,
    vec,
    wedge,
    where_less,
)
from kreisel.algebra.backend import Complex
from kreisel.algebra.invariants import MOST, adjugate, blocks, stack
from kreisel.baecklund.conjugate import longest, norm, projector_of, under
from kreisel.record.contract import TWO_FIELDS_SPACE, ConjugatePairs, Map, Parameter, System, named
from kreisel.system import quadratic_field as general

LOW, HIGH, CLEAR = 0.3, 12.0, 1.05  # |l| that are tried, in units of the largest |M|; |mu| is larger than |M| by CLEAR
TWO = identity(2)


def shape(*, n):
    """e = e_1, h = e_2, and c_jk = 1, but 2 in their plane."""
    lanes = (0 * np.asarray(n)).astype(np.int8)
    unit = identity(int(np.asarray(n).flat[0])) + mat(lanes)
    corner = 1 * (np.arange(unit.shape[-1]) < 2)
    return {"c": 1 + unit * 0 + corner[:, None] * corner, "e": unit[..., 0], "h": unit[..., 1]}


def velocity(M, P, Q, *, gamma, c, e, h):  # Omega = dH/dM
    return c * M - mat(gamma) * wedge(e, h)


def torque(P, Q, e, h):  # E F^T - F E^T
    return wedge(e, P) + wedge(h, Q)


def flow(M, P, Q, *, gamma, c, e, h):  # M' = [M, Omega] + E F^T - F E^T,   F' = -Omega F
    Omega = velocity(M, P, Q, gamma=gamma, c=c, e=e, h=h)
    return M @ Omega - Omega @ M + torque(P, Q, e, h), -act(Omega, P), -act(Omega, Q)


def noether(M, P, Q):  # M_22, for the rotations of the other directions
    ends = np.diag([0, 0] + [1] * (M.shape[-1] - 2))
    return ends @ M @ ends


# -- the map -----------------------------------------------------------------------------------------------


def kicked(M, P, Q, e, h, eps, share=1):
    """M + (eps/share) (e_1 ^ P~ + e_2 ^ Q~), (P~, Q~) = r (P, Q) (r - F_11)^-1, r = 4/eps^2; its corner P_2 - Q_1."""
    r, p, q = 4 / (eps * eps), (1 - e - h) * P, (1 - e - h) * Q
    a, b, c, d = r - P[..., 0], Q[..., 0], P[..., 1], r - Q[..., 1]
    K = wedge(e, vec(d) * p + vec(c) * q) + wedge(h, vec(b) * p + vec(a) * q)
    return M + mat(r * eps / share / (a * d - b * c)) * (K + mat(r * (P[..., 1] - Q[..., 0])) * wedge(e, h))


def rotor(M, gamma):  # N = gamma e_1 ^ e_2 - M_11, as a matrix of n rows
    flat = 1 * (np.arange(M.shape[-1]) < 2)
    return mat(gamma) * wedge(*identity(M.shape[-1])[:2]) - M * (flat[:, None] * flat)


def turned(Y, V):  # cay(Y) V = V + 2 (Y + Y^2) V/(1 + |Y|^2), Y in one plane
    W = Y @ V
    return V + mat(2 / (1 + pairing(Y, Y))) * (W + Y @ W)


def turn(M, P, Q, gamma, eps):
    """R M R^T and R cay(-k M) F; for n = 3 the second one is F + (2/(t^2 + |x|^2)) q (q - t) F with q = hat(x).

    The quaternion (t, -x) is the product of (1, -y e_3), of R, and (2/eps, -w), of cay(-k M).
    """
    if M.shape[-1] != 3:
        Y, F = eps / 2 * rotor(M, gamma), np.stack([P, Q], -1)
        F = turned(Y, cayley_columns(-eps / 2 * M, F))
        return turned(Y, turned(Y, M).mT).mT, F[..., 0], F[..., 1]
    w, z = axial(M), gamma + axial(M)[..., 2]
    y, across = eps / 2 * z, 4 / (eps * eps) + dot(w, w)
    scale = 2 / ((1 + y * y) * across)
    x, t = stack([w[..., 0] + y * w[..., 1], w[..., 1] - y * w[..., 0], w[..., 2] + z]), 2 / eps - y * w[..., 2]
    s, q = scale * (across * y), hat(x)
    P, Q = (v + vec(scale) * act(q, act(q, v) - vec(t) * v) for v in (P, Q))
    return hat(stack([w[..., 0] + s * x[..., 1], w[..., 1] - s * x[..., 0], w[..., 2]])), P, Q


def step(M, P, Q, *, gamma, e, h, eps):
    return turn(kicked(M, P, Q, e, h, eps), P, Q, gamma, eps)


def inverse(M, P, Q, *, gamma, e, h, eps):
    M, P, Q = turn(M, P, Q, gamma, -eps)
    return kicked(M, P, Q, e, h, -eps), P, Q


def involution(M, P, Q, *, e, h, eps):  # -S M~ S, S F S with S = diag(1, -1, 1, ..): N stays
    signs = 1 - 2 * (np.arange(M.shape[-1]) == 1)
    return -signs[:, None] * kicked(M, P, Q, e, h, eps) * signs, signs * P, -signs * Q


def half_kick(M, P, Q, *, e, h, eps):
    return kicked(M, P, Q, e, h, eps, share=2), P, Q


def composed(M, N, eps):  # X with cay(X) = cay((eps/2) M) cay(-(eps/2) N)
    W, unit = cayley(eps / 2 * M) @ cayley(-eps / 2 * N), identity(M.shape[-1])
    return solve(unit + W, W - unit)


def generator(M, P, Q, M1, P1, Q1, *, gamma, e, h, eps):
    M = kicked(M, P, Q, e, h, eps)
    return composed(M, rotor(M, gamma), eps)


def largest_step(M, P, Q):
    """det(1 - (eps^2/4) F_11) stays positive for smaller |eps|, by the largest singular value of F."""
    p, q, product = dot(P, P), dot(Q, Q), dot(P, Q)
    square = (p + q) / 2 + np.sqrt((p - q) * (p - q) / 4 + product * product)
    return 2 / np.sqrt(np.sqrt(square))


# -- integrals and Lax pairs -------------------------------------------------------------------------------


def shifted(M, P, eps):  # V = (1 + (eps/2) M) P
    return P + eps * act(M, P) / 2


def energy(M, P, Q, *, gamma, c, eps=0):
    """H with tr V_11 (1 - k N) for tr F_11, less (k^2/2) |V_21|^2 and k^4 N_12 <P, M Q>; V = (1 + k M) F."""
    p, q, w = shifted(M, P, eps), shifted(M, Q, eps), gamma - M[..., 0, 1]
    ends, square = 1 * (np.arange(M.shape[-1]) > 1), eps * eps
    across = (dot(ends * p, p) + dot(ends * q, q)) / 8 + square * w * dot(P, act(M, Q)) / 16
    H = pairing(M, c * M) / 2 - gamma * M[..., 0, 1] + p[..., 0] + q[..., 1]
    return H - eps * w * (p[..., 1] - q[..., 0]) / 2 - square * across


def bordered(X, F, Y):  # of size n + 2
    return blocks([[X, F], [F.mT, Y]])


def enlarged(M, F, gamma):
    """M (+) N, the field -[[0, F], [F^T, 0]] and B = [[0, E], [E^T, 0]]."""
    zero, N = 0 * F, rotor(M, gamma)[..., :2, :2]
    rows = identity(M.shape[-1])[:, :2] + zero
    return bordered(M, zero, N), bordered(0 * M, -F, 0 * N), bordered(0 * M, rows, 0 * N)


def spectrum(M, P, Q, *, gamma, eps=0):
    """det L(lambda, mu) at 2 n - 4 points (lambda, mu): complete with the energy and a chain of the block M_22."""
    M, F, B = enlarged(M, np.stack([P, Q], -1), gamma)
    points = [(1 + j % 3, 1 + j // 3) for j in range(2 * min(M.shape[-1], MOST) - 8)]
    return general.values_of(M, F, general.potential(F, eps * eps * B / 4), B, eps=eps, points=points)


def lax(M, P, Q, *, gamma, c, e, h, lam):
    """L = lambda B + M (+) N + F/lambda of size n + 2, U = lambda B + Omega (+) 0."""
    big, F, B = enlarged(M, np.stack([P, Q], -1), gamma)
    Omega, zero = velocity(M, P, Q, gamma=gamma, c=c, e=e, h=h), 0 * M[..., :, :2]
    return lam * B + big + F / lam, lam * B + bordered(Omega, zero, zero[..., :2, :])


def ranks(F, columns):
    """P = [[F, 0], [0, 1]] and R = -[[0, F], [1, 0]] of the first columns of F: P R^T is the field."""
    F, low = F[..., :columns], identity(2)[:, :columns] + 0 * F[..., :2, :columns]
    return blocks([[F, 0 * F], [0 * low, low]]), -blocks([[0 * F, F], [low, 0 * low]])


def pencil(M, P, Q, *, gamma, lam, mu, eps, columns=2):  # of size n + 6, n + 4 in one field
    F = np.stack([P, Q], -1)
    (M, _, B), (left, right) = enlarged(M, F, gamma), ranks(F, columns)
    return general.pencil_of(M, left, right, B, lam=lam, mu=mu, eps=eps)


def factors(M, P, Q, *, gamma, e, h, lam, eps, columns=2):
    F = np.stack([P, Q], -1)
    B, (left, right) = enlarged(M, F, gamma)[2], ranks(F, columns)
    Y = eps / 2 * rotor(kicked(M, P, Q, e, h, eps), gamma)
    back = turned(-Y, identity(M.shape[-1]) + 0 * Y)
    turns = bordered(back, 0 * F, back[..., :2, :2]), identity(2 * columns) + 0 * Y[..., :1, :1]
    return general.turned(general.factors_of(left, right, B, lam=lam, eps=eps), *turns)


MAP = Map(
    **named(step, inverse, involution, generator, pencil, factors, largest_step),
    to_symmetric=half_kick,
    source="Kreisel",
)

# -- conjugate pairs of Bäcklund maps, n = 3 ----------------------------------------------------------


def columns(P, Q, lam):
    """G = l E - F/l."""
    unit = identity(3)
    return np.stack([lam * unit[0] - P / lam, lam * unit[1] - Q / lam], -1)


def rotor_block(M, gamma):
    """N = Gamma - M_11."""
    return mat(gamma - M[..., 0, 1]) * wedge(TWO[0], TWO[1])


def matrix(M, P, Q, *, lam, gamma=0):
    G = columns(P, Q, np.asarray(lam)[..., None])
    return bordered(M + 0 * G[..., :1], G, rotor_block(M, gamma) + 0 * G[..., :2, :])


def largest(M, P, Q, gamma):
    """A bound of |M| on the orbit, from the energy."""
    energy = pairing(M, M) / 2 + M[0, 1] * M[0, 1] / 2 - gamma * M[0, 1] + P[0] + Q[1]
    square = 2 * (energy + norm(P) + norm(Q)) + gamma * gamma
    return sqrt(where_less(0, square, square, 1))


def heights(M, P, Q, *, gamma=0):
    unit = largest(M, P, Q, gamma)
    return [(0.0, 1, LOW * unit, HIGH * unit)]


def eigenvalues(M, P, Q, *, y, gamma=0):
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
    S, slope = mat(mu) * TWO - rotor_block(M, gamma) - G.mT @ Y, TWO + G.mT @ Z
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
    return projector_of(right @ adjugate(mu * TWO - rotor_block(M, gamma) - G.mT @ right[:3]) @ left.mT)


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


TWO_FIELDS = ConjugatePairs(matrix, heights, projector, rates, pair, spectrum=eigenvalues, dimensions=(3,))
ONE_FIELD = under(TWO_FIELDS, (), dict, lambda M, P: (M, P, 0 * P), lambda z: z[:2], (3,))

SYSTEM = System(
    name="kovalevskaya-gyrostat",
    title="Kovalevskaya gyrostat in two fields",
    equations="M' = [M, Omega] + e_1 ^ P + e_2 ^ Q,  P' = -Omega P,  Q' = -Omega Q",
    source="Reyman, Semenov-Tian-Shansky 1987; Suris 2001, Introduction",
    space=TWO_FIELDS_SPACE,
    parameters=(
        Parameter("n", "dimension", "the dimension of the space"),
        Parameter("gamma", "scalar", "the momentum of the rotor, in the plane of e_1 and e_2"),
    ),
    **named(flow, energy, velocity, lax),
    derive=shape,
    scaling="The moments of inertia of all planes are 1, except for 1/2 in the plane (1, 2).",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    map=MAP,
    pairs=TWO_FIELDS,
    notes="Q = 0 is the gyrostat in one field.",
)
