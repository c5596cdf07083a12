"""The implicit equation of Veselov's, Moser and Veselov's and Suris's (2000) maps, and where it can be solved.

    Q W J - J W^T Q = eps M,   W = cay(X) in SO(n),   X -> 0 as eps -> 0,   J = diag(J_i) > 0,   Q = (1 - eps^2 P)^(1/2)

Z = Q^-1 W J solves Q^2 Z^2 - eps M Z - J^2 = 0, and its eigenvalues l are roots of det(J^2 + l eps M - l^2 Q^2), which
are integrals of the maps.  The branch has all of them in Re l > 0.  It exists where no root is imaginary: there the
symmetric part S of W J, or of Q W J, is positive and W has no eigenvalue -1, so that X is finite.  With
l = gamma (1 + z)/(1 - z), U = (Z - gamma)/(Z + gamma), the equation and S become

    A + B U + A^T U^2 = 0,   A = gamma^2 Q^2 - J^2 - gamma eps M,   B = 2 (gamma^2 Q^2 + J^2),
    Y + A^T Y^-1 A = B,      Y = B + A^T U = 2 gamma S + B/2,

and the branch, |z| < 1, is the greatest Y > 0, which exists where A^T z + B + A/z > 0 on the unit circle.
[Moser, Veselov, Comm. Math. Phys. 139 (1991); Cardoso, Leite, Linear Algebra Appl. 360 (2003); Engwerda, Ran,
Rijkeboer, Linear Algebra Appl. 186 (1993); Meini, Math. Comp. 71 (2002)]

For n = 3 and Q = 1 a quartic for one number sigma, an integral of the map, solves it.  With X = hat(x), M = hat(mu),
h = eps/2 and I the moments,

    (I - sigma) x + h x x mu = h mu,   sigma = h <x, mu>.

Hence x as a function of sigma, and h <x, mu> = sigma states

    0 = p(sigma) = sigma det(I - sigma) - m (m + sigma (2 sigma - tr I)) - b,   m = h^2 |mu|^2,

b = h^2 sum I_j I_k mu_i^2, whose coefficients are integrals of the map.
"""

import numpy as np

from kreisel.algebra import (
    SECOND,
    THIRD,
    Array,
    axial,
    diagonal_resolvent,
    dot,
    hat,
    holds_objects,
    identity,
    mat,
    pairing,
    solve,
    sqrt,
    vec,
)
from kreisel.algebra.invariants import blocks, diagonal
from kreisel.algebra.iteration import repeat, times

DOUBLINGS, MOST_DOUBLINGS = 10, 20  # straight-line for n = 3, else at most
SMALL = 1e-18  # of |A|^2 over the 4th power of gamma: the remainder of Y is of the order of A^T Y^-1 A
YS = 48
STEPS, ROOT_STEPS = 4, 12  # for the root of the quartic at each step, and for that of a trajectory


def turn(M, J, Q, square, eps):
    """X on the branch by cyclic reduction, from Q and its square: U -> U^2 in each doubling, A -> 0 and B -> Y.

    The matrices to be divided by stay positive.  gamma^2 = sum J/sum J^-1, which for two moments is their product.
    Sixty random bodies each of n = 3, 4, 6, 8: 5 to 8 doublings up to half of the longest step, 6 to 8 at 0.9 of it,
    7 to 10 at 0.99, and 10 at most at 0.999.
    """
    scale = J.sum(-1) / (1 / J).sum(-1)
    gamma, D = sqrt(scale), diagonal(J)
    D2, first = D * D, mat(scale) * square
    middle, start = first + D2, first - D2 - mat(gamma) * eps * M

    def doubled(A, B, C):
        inner, outer, new = through_inverse(B - C, A)
        size = (new * new).sum(-1).sum(-1) / (scale * scale)
        return (new, B - inner, C + outer), size

    state = start, 2 * middle, 0 * middle
    if M.shape[-1] == 3:
        for _ in range(DOUBLINGS):
            state, _ = doubled(*state)
    else:
        state, _ = repeat(doubled, state, SMALL, MOST_DOUBLINGS, ("matrix", "symmetric", "symmetric"))
    W = (state[1] - middle) / (2 * mat(gamma)) + eps / 2 * M  # Q W J
    QD = Q @ D
    X = D @ solve(W + QD, W - QD) / J[..., None, :]  # (W + 1)^-1 (W - 1)
    return (X - X.mT) / 2


def through_inverse(S: Array, A: Array) -> tuple[Array, Array, Array]:
    """A^T S^-1 A, A S^-1 A^T and A S^-1 A for S (..., n, n) symmetric and positive.

    Numbers without a LAPACK go by S = L D L^T: a record then keeps only the needed half of the symmetric products.
    """
    if not holds_objects(S):
        B = solve(S, A)
        return A.mT @ B, A @ solve(S, A.mT), A @ B
    n = S.shape[-1]
    S, B = S.astype(object), np.concatenate([A, A.mT], -1).astype(object)
    for k in range(n - 1):
        factor = S[..., k, k + 1 :, None] * (1 / S[..., k, k, None, None])
        S[..., k + 1 :, k + 1 :] = S[..., k + 1 :, k + 1 :] - factor * S[..., k : k + 1, k + 1 :]
        B[..., k + 1 :, :] = B[..., k + 1 :, :] - factor * B[..., k : k + 1, :]
    scaled = B / S.diagonal(axis1=-2, axis2=-1)[..., None]
    left, right = B[..., :n].mT, B[..., n:].mT
    return left @ scaled[..., :n], right @ scaled[..., n:], right @ scaled[..., :n]


def corrected(X, residual, c):
    """X - c o residual(X), and the square of the correction, which tells how far X was off.

    For n > 3 it is a loop of one iteration, differentiated as a root; the limit of the doublings is not isolated.
    """

    def improved(X):
        change = c * residual(X)
        return (X - change,), pairing(change, change)

    (X,), size = improved(X) if X.shape[-1] == 3 else repeat(improved, (X,), SMALL, 1, ("skew",))
    return X, size


def largest_step(M, J, P, enough=np.inf):
    """The eps beyond which some root is imaginary, that is, J^2 + y^2 + i eps y M - eps^2 y^2 P singular for some y.

    1/eps is the largest over y of the real eigenvalues u of the pencil u^2 + u B - C, where, with D = J^2 + y^2,
    B = i y D^(-1/2) M D^(-1/2) and C = y^2 D^(-1/2) P D^(-1/2).  Where |B| + |C|^(1/2) <= |M|/(2 min J) + |P|^(1/2)
    states that it is beyond `enough`, that bound does, as for recorded values.
    """
    with np.errstate(divide="ignore"):
        sure = 1 / (sqrt(pairing(M, M)) / (2 * J.min(-1)) + sqrt(sqrt((P * P).sum(-1).sum(-1))))
    if holds_objects(M) or (sure > enough).all():
        return sure
    M, J, P = (np.asarray(v, dtype=np.float64) for v in (M, J, P))
    d, n = J, J.shape[-1]
    lead = np.broadcast_shapes(M.shape[:-2], d.shape[:-1], P.shape[:-2])
    lowest, highest = np.log(d.min()), np.log(d.max())

    def inverse_step(s):  # s = log y, for every lane its own
        y = np.exp(s)[..., None]
        w = y / np.sqrt(d * d + y * y)
        outer = w[..., :, None] * w[..., None, :]
        B, C = 1j * outer * M / y[..., None], outer * P
        unit = np.broadcast_to(identity(n), B.shape)
        C = np.broadcast_to(C, B.shape)
        u = np.linalg.eigvals(blocks([[0 * B, unit], [C, -B]]))
        real = abs(u.imag) <= 1e-6 * (abs(u).max(-1, keepdims=True) + 1e-300)
        return np.where(real, u.real, 0).max(-1)

    grid = np.linspace(lowest - 1, highest + 7, YS)
    values = np.stack([inverse_step(np.full(lead, s)) for s in grid])
    best = values.argmax(0)
    left, right = grid[np.maximum(best - 1, 0)], grid[np.minimum(best + 1, YS - 1)]
    for _ in range(60):  # ternary search
        a, b = left + (right - left) / 3, right - (right - left) / 3
        higher = inverse_step(a) < inverse_step(b)
        left, right = np.where(higher, a, left), np.where(higher, right, b)
    far = np.sqrt(np.maximum(np.linalg.eigvalsh(P).max(-1), 0))
    with np.errstate(divide="ignore"):
        return 1 / np.maximum(np.maximum(inverse_step((left + right) / 2), values.max(0)), far)


def coefficients(M, J, eps):
    """I, m and b."""
    h, u = eps / 2, axial(M)
    moments = J[..., SECOND] + J[..., THIRD]
    square = u * u * vec(h * h)
    return moments, square.sum(-1), dot(moments[..., SECOND] * moments[..., THIRD], square)


def root(M, J, eps, steps=ROOT_STEPS):
    """The least root of p, and the square of the last correction over (tr I)^2.

    Halley's method from h^2 sum mu_i^2/I_i, which is below the root: each correction is of the order of the cube of
    that before.  With the step in percent of the longest that has a solution, forty random bodies: after four the
    square of the last correction is below 1e-30 up to 90, 1e-13 at 99.
    """
    moments, m, b = coefficients(M, J, eps)
    total = moments.sum(-1)

    def improved(x):
        s, _ = x
        d = moments - vec(s)
        minors = d[..., SECOND] * d[..., THIRD]
        second, product = minors.sum(-1), d[..., 0] * minors[..., 0]
        value = s * product - m * (m + s * (2 * s - total)) - b
        slope = product - s * second - m * (4 * s - total)
        curvature = s * d.sum(-1) - second - 2 * m  # p''/2
        change = value * slope / (slope * slope - value * curvature)
        return s - change, change

    s = b / (moments[..., 0] * moments[..., 1] * moments[..., 2])
    s, change = times(improved, (s, 0 * s), steps)
    return s, change * change / (total * total)


def turn_by_quartic(M, J, eps, sigma=None):
    """X from the root, found here or known for the trajectory, and the square of its error, as estimated.

    A known sigma that is off by delta gives the rotation of a body with the moments I + delta, and delta is an
    integral of that map: only its square counts.
    """
    moments, h = J[..., SECOND] + J[..., THIRD], eps / 2
    left = None
    if sigma is None:
        sigma, last = root(M, J, eps, STEPS)
        left = last * last * last
    u = axial(M)
    x = diagonal_resolvent(moments - vec(sigma), -h * M, vec(h) * u)
    delta = (h * dot(x, u) - sigma) / moments.sum(-1)
    return hat(x), (delta * delta) * (delta * delta) if left is None else left
