"""Bäcklund transformations of Clebsch's case, the special flow, state (M, P), and of two systems that move like it.

On the spectral curve (mu - rho C + M) Q = P, <P, Q> = rho, with C = B - max b and rho = -lambda; then

    M_1 = M + (2 rho/<Q, Q>) Q ^ CQ,   P_1 = P - (M + M_1) Q = 2 Q <Q, P>/<Q, Q> - P.

Q belongs to the rho of the very state, by a step of Newton's method, as in `lagrange_top`.
[the Lax matrix of Suris 2001, section 7; derivation in docs/baecklund.md; others, n = 3, by 2 x 2 matrices: Zullo 2011]
"""

from functools import reduce
from typing import Any

import numpy as np

from kreisel.algebra import (
    act,
    cayley,
    cayley_plane,
    complex_number,
    diagonal_resolvent,
    dot,
    identity,
    mat,
    maximum,
    parts,
    pfaffians,
    project_out,
    rounded,
    skew,
    solve,
    sqrt,
    together,
    vec,
    wedge,
    where_less,
)
from kreisel.algebra.iteration import repeat
from kreisel.baecklund.lagrange_top import FEW, block, polynomial_value
from kreisel.record.contract import Baecklund, named

CLOSE, STILL = 1e-7, 1e-12  # relative change by the last step in doubles, and a change that is not made
MOST = 80  # steps: 2 to 9, in one of 3000 wild cases 79


def shifted_diagonal(*, b):
    """c = b - max b: the same flow and the same maps, labelled so that they exist for every eps."""
    return {"c": b - vec(reduce(maximum, [b[..., i][()] for i in range(b.shape[-1])]))}


def eigenvector(M, P, *, c, mu, rho):
    d = vec(mu) - vec(rho) * c
    Q = diagonal_resolvent(d, M, P)
    H = diagonal_resolvent(d, M, c * Q)
    return Q + vec((dot(P, Q) - rho) / (1 - dot(P, H))) * H


def curve(M, P, *, c, mu):
    """rho = mu r with r = G(r) = <P, Q(r)>/mu: the one root with Re rho > 0, since c <= 0.

    mu r -> mu G maps the half-plane Re > 0 into itself, so iterates tend to the root [Denjoy and Wolff], quickly by
    the geometric mean of mu r and mu G.  Newton's steps replace them if they stay near and in the half-plane.  All are
    in doubles but the last, by the value of G in the digits of the arguments.
    """
    few, real, nu = M.shape[-1] <= FEW, parts(mu)[1] is None, rounded(mu)
    image = _by_pfaffians if few else _by_solving
    digits = _coefficients(M, P, c, mu) if few else [M, P, c, mu]
    doubles = [rounded(x) for x in digits]

    def columns(z):
        return (np.stack([x for x in parts(z) if x is not None], -1),)

    def improve(x):
        r = x[..., 0][()] if real else complex_number(x[..., 0][()], x[..., 1][()])
        G, slope = image(r, *doubles)
        change = (G / r - 1) / (1 - slope())
        size = sum(x * x for x in parts(change) if x is not None)
        new, mean = r + r * change, sqrt(nu * r) * sqrt(nu * G) / nu
        new = where_less(0, where_less(size, 1, parts(nu * new)[0], -1), new, mean)
        return columns(where_less(size, STILL * STILL, r, new)), size  # each lane as if it were a separate run

    start = columns(rounded(dot(P, P)) / (nu * nu))
    x = repeat(improve, start, CLOSE * CLOSE, MOST, (f"R^{start[0].shape[-1]}",))[0][0]
    r = x[..., 0][()] if real else complex_number(x[..., 0][()], x[..., 1][()])
    miss, rho = rounded(image(r, *digits)[0] - r), mu * r
    return rho + rounded(rho) * (miss / r / (1 - image(r, *doubles)[1]()))


def _by_solving(r, M, P, c, mu):
    """G, and its slope, from Q."""
    d = vec(mu) * (1 - vec(r) * c)
    Q = diagonal_resolvent(d, M, P)
    return dot(P, Q) / mu, lambda: dot(diagonal_resolvent(d, -M, P), c * Q)


def _by_pfaffians(r, *coefficients):
    """G, and its slope, from the n coefficients of its numerator and the n of its denominator."""
    n = len(coefficients) // 2
    above, below = coefficients[:n], coefficients[n:]
    G = polynomial_value(above, r) / polynomial_value(below, r)

    def slope():
        up, down = (polynomial_value([k * x for k, x in enumerate(row)][1:], r) for row in (above, below))
        return (up - G * down) / polynomial_value(below, r)

    return G, slope


def _coefficients(M, P, c, mu):
    """P^T adj(A) P/mu and det(A) over mu^n as polynomials in r, A = mu (1 - r C) + M: only mu is not positive."""
    n, inverse = M.shape[-1], 1 / (mu * mu)
    products: dict[tuple[int, ...], list[Any]] = {(): [1]}  # of 1 - c_i r
    sums = [[0] * n for _ in range(n + 1)]  # of powers of r, for each count of indices; r^n has prod c_i = 0
    squares = {indices: value * value for indices, (value,) in pfaffians(M, P).items()}
    for indices in squares:
        if indices:
            lower = products[indices[:-1]]
            products[indices] = [x - c[..., indices[-1]][()] * y for x, y in zip([*lower, 0], [0, *lower], strict=True)]
    for indices, square in squares.items():
        others = tuple(i for i in range(n) if i not in indices)
        sums[len(indices)] = [
            x + square * y for x, y in zip(sums[len(indices)], [*products[others], *[0] * n], strict=False)
        ]
    odd, even = ([polynomial_value(column, inverse) for column in zip(*sums[k::2], strict=True)] for k in (1, 0))
    return [*(inverse * x for x in odd), *even]


def kick(P, Q, *, c):  # the change of M
    return mat(2 * dot(P, Q) / dot(Q, Q)) * wedge(Q, c * Q)


def step(M, P, Q, *, c):
    M1 = M + kick(P, Q, c=c)
    return M1, P - act(M + M1, Q)


def pair(M, P, Q, *, c, mu):
    K, P1 = kick_and_turn(M, P, Q, c=c, mu=mu)
    return M + K, P1


def kick_and_turn(M, P, Q, *, c, mu):
    """M += sum K_ij Q_i ^ CQ_j, K the inverse of <Q_i, Q_j>/(rho_i + rho_j); P rotates in the plane of the Q_i.

    Multiples of the Q_i do as well: mu Q = u + i w has u near P and w = Im (rho C - M) Q small for short steps.
    """
    rho = dot(P, Q)
    (u, _), (r, i) = parts(vec(mu) * Q), parts(rho)
    w = c * parts(vec(rho) * Q)[1] - act(M, parts(Q)[1])
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    total, squares = uu + ww, 2 * r * r + i * i
    scale = 4 * r / (total * total * i * i + 4 * r * r * (uu * ww - uw * uw))
    kuu = scale * (uu * i * i - 2 * uw * i * r + ww * squares)
    kww = scale * (uu * squares + 2 * uw * i * r + ww * i * i)
    kuw = scale * r * ((uu - ww) * i - 2 * uw * r)
    K = wedge(u, c * (vec(kuu) * u + vec(kuw) * w)) + wedge(w, c * (vec(kuw) * u + vec(kww) * w))
    return K, cayley_plane(vec(-2 * r / (i * total)) * u, w, P)


def arc(M, P, Q):
    return P, Q


def arc_of_pair(M, P, Q):
    (u, w), (r, i) = parts(Q), parts(dot(P, Q))
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    return u, vec(i * (uu + ww) - 2 * r * uw) * u + vec(2 * r * uu) * w


def darboux(M, P, Q, *, rho, lam):  # N L = L_new N,  N = lambda' - rho (1 - 2 QQ^T/QQ)
    n = M.shape[-1]
    return mat(lam - rho) * identity(n) + mat(2 * rho / dot(Q, Q)) * Q[..., :, None] * Q[..., None, :]


def any_diagonal(n, draw):
    return draw((n,))


def rational_case(n, draw, diagonal=any_diagonal):
    """b, M, Q and rho at random; then mu rho <Q, Q> = 1 + rho^2 <Q, CQ> and P = rho (mu - rho C + M) Q."""
    b, M, Q, rho = diagonal(n, draw), skew(draw((n * (n - 1) // 2,)), n), draw((n,)), abs(draw((1,)))[0]
    c = shifted_diagonal(b=b)["c"]
    mu = (1 + rho * rho * dot(Q, c * Q)) / (rho * dot(Q, Q))
    return (M, rho * (mu * Q - rho * c * Q + act(M, Q))), {"b": b}, rho * Q, mu, rho


def gaussian_case(n, draw, diagonal=any_diagonal):
    """Q = u + iw, rho and the direction of b at random; then mu and the size of b, P and M from their equations.

    With D = mu - rho C: M skew and (D + M) Q = P/rho, <P, Q> = 1 need <Q, DQ> = 1/rho and <w, Im DQ> = 0.
    """
    b, u, w, (r, i), K = diagonal(n, draw), draw((n,)), draw((n,)), draw((2,)), skew(draw((n * (n - 1) // 2,)), n)
    c, rho = shifted_diagonal(b=b)["c"], complex_number(r, i)
    inverse = parts(1 / rho)

    def conditions(x, y, t):  # of mu = x + iy, tC: linear
        re, im = (x - t * r * c) * u - (y - t * i * c) * w, (x - t * r * c) * w + (y - t * i * c) * u
        return np.array([dot(u, re) - dot(w, im), dot(u, im) + dot(w, re), dot(w, im)])

    units = np.stack([conditions(*e) for e in identity(3).tolist()], -1)
    x, y, t = solve(units, np.array([[inverse[0]], [inverse[1]], [0 * r]]))[:, 0]
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    size = uu * ww - uw * uw
    u1, w1 = (ww * u - uw * w) / size, (uu * w - uw * u) / size  # dual to u, w
    P = u1 + K[0] - u1 * dot(u, K[0]) - w1 * dot(w, K[0])
    alpha = inverse[0] * P - ((x - t * r * c) * u - (y - t * i * c) * w)  # M u and M w
    beta = inverse[1] * P - ((x - t * r * c) * w + (y - t * i * c) * u)
    free = identity(n) - u[:, None] * u1 - w[:, None] * w1
    M = wedge(alpha, u1) + wedge(beta, w1) - dot(beta, u) * wedge(u1, w1) + free.T @ K @ free
    return (M, P), {"b": t * b}, rho * together(u, w), complex_number(x, y) - rho * (t * c).max(), rho


BAECKLUND = Baecklund(
    point=curve,
    vector=eigenvector,
    defect=lambda M, P, Q, *, rho: dot(P, Q) - rho,
    **named(step, pair, arc, arc_of_pair, darboux),
    block=block,
    case=rational_case,
    pair_case=gaussian_case,
    odd=-1,
    source="the Lax matrix of Suris 2001, section 7; derivation in docs/baecklund.md",
)


# -- Neumann's system, state (x, q): the leaf M = x ^ q, P = x ---------------------------------------


def on_sphere(M, x):
    """(x, q) of M = x ^ q, P = x: q = -M x/<x, x>."""
    return x, -act(M, x) / vec(dot(x, x))


def moved(x, q, M, M1, x1):
    """q1 = -M1 x1/<x, x> by its difference to q; <x1, x1> = <x, x>."""
    change = act(M, x1 - x) + act(M1 - M, x1) + vec(dot(x, q)) * x
    return x1, q - change / vec(dot(x, x))


def neumann_step(x, q, Q, *, c):
    M = wedge(x, q)
    return moved(x, q, M, *step(M, x, Q, c=c))


def neumann_pair(x, q, Q, *, c, mu):
    M = wedge(x, q)
    return moved(x, q, M, *pair(M, x, Q, c=c, mu=mu))


def rational_neumann(n, draw):
    """b, x, rho and the direction of Q at random; <x, Q> = 1, then mu and q from rho (mu - rho C + M) Q = x."""
    b, turn, d = draw((n,)), cayley(skew(draw((n * (n - 1) // 2,)), n)), draw((n,))
    c, x, rho = shifted_diagonal(b=b)["c"], turn[:, 0], abs(draw((1,)))[0]
    Q = d / dot(x, d)
    mu = (1 + rho * rho * dot(Q, c * Q)) / (rho * dot(Q, Q))
    D = mu * Q - rho * c * Q
    return (x, D - x * dot(x, D)), {"b": b}, rho * Q, mu, rho


def gaussian_neumann(n, draw):
    """x, rho, Q = u + iw with <x, Q> = 1, and Re mu at random; then b, Im mu and q by linear equations.

    With D = mu - rho C: q = DQ + x (<q, Q> - 1/rho) is real, and <q, x> = 0.
    """
    turn, u, w, (r, i, x0) = cayley(skew(draw((n * (n - 1) // 2,)), n)), draw((n,)), draw((n,)), draw((3,))
    x, rho = turn[:, 0], complex_number(r, i)
    u, w = u + x * (1 - dot(x, u)), w - x * dot(x, w)
    inverse = parts(1 / rho)

    def conditions(c, y, tau, real):  # of C, mu = given + iy and Im DQ = tau x: linear
        re, im = (real - r * c) * u - (y - i * c) * w, (real - r * c) * w + (y - i * c) * u
        return np.append(im - tau * x, [dot(re, u), dot(re, w) + tau]), re

    units = np.stack([conditions(e[:n], e[n], e[n + 1], 0 * r)[0] for e in identity(n + 2) + 0 * r], -1)
    wanted = np.append(0 * x, [inverse[0], inverse[1]]) - conditions(0 * x, 0 * r, 0 * r, x0)[0]
    *c, y, tau = solve(units, wanted[:, None])[:, 0]
    c = np.array(c)
    re = conditions(c, y, tau, x0)[1]
    return (x, re - x * dot(x, re)), {"b": c}, rho * together(u, w), complex_number(x0, y) - rho * c.max(), rho


NEUMANN = Baecklund(
    point=lambda x, q, *, c, mu: curve(wedge(x, q), x, c=c, mu=mu),
    vector=lambda x, q, *, c, mu, rho: eigenvector(wedge(x, q), x, c=c, mu=mu, rho=rho),
    defect=lambda x, q, Q, *, rho: dot(x, Q) - rho,
    step=neumann_step,
    pair=neumann_pair,
    arc=lambda x, q, Q: (x, Q),
    arc_of_pair=lambda x, q, Q: arc_of_pair(q, x, Q),
    darboux=lambda x, q, Q, *, rho, lam: darboux(wedge(x, q), x, Q, rho=rho, lam=lam),
    block=lambda x, q: 0 * wedge(x, q),
    case=rational_neumann,
    pair_case=gaussian_neumann,
    odd=-1,
    source="the smallest leaf of clebsch",
)


# -- a body of revolution in a fluid, state (M, P) ---------------------------------------------------
#
# (a1 M, P) moves as in Clebsch's case with B = diag(0, ..., 0, beta), and rotates about the axis too, by `spin`,
# which commutes with that.  So the maps are the ones of Clebsch's case for (a1 M, P).


def step_of_revolution(M, P, Q, *, c, a1):
    M1 = M + kick(P, Q, c=c) / mat(a1)
    return M1, P - act(mat(a1) * (M + M1), Q)


def pair_of_revolution(M, P, Q, *, c, a1, mu):
    K, P1 = kick_and_turn(mat(a1) * M, P, Q, c=c, mu=mu)
    return M + K / mat(a1), P1


def spin(M, P, *, a1, a3, e):  # Omega - a1 M
    return mat(a3 - a1) * project_out(M, e)


def with_its_parameters(case, draw):
    """A case of Clebsch's system with B = diag(0, ..., 0, beta) as one of this, with a3 = 1 and c1 = 0."""
    (M, P), params, Q, mu, rho = case
    a1 = 1 + abs(draw((1,)))[0]
    parameters = {"a1": a1, "a3": a1 / a1, "c1": 0 * a1, "c3": -params["b"][-1] / a1, "n": len(params["b"])}
    return (M / a1, P), parameters, Q, mu, rho


def along_axis(n, draw):
    return draw((n,)) * ([0] * (n - 1) + [1])


OF_REVOLUTION = Baecklund(
    point=lambda M, P, *, c, a1, mu: curve(mat(a1) * M, P, c=c, mu=mu),
    vector=lambda M, P, *, c, a1, mu, rho: eigenvector(mat(a1) * M, P, c=c, mu=mu, rho=rho),
    defect=BAECKLUND.defect,
    step=step_of_revolution,
    pair=pair_of_revolution,
    spin=spin,
    arc_of_pair=lambda M, P, Q, *, a1: arc_of_pair(mat(a1) * M, P, Q),
    block=lambda M, P, *, a1: block(mat(a1) * M, P),
    arc=arc,
    darboux=darboux,
    axis="e",
    case=lambda n, draw: with_its_parameters(rational_case(n, draw, along_axis), draw),
    pair_case=lambda n, draw: with_its_parameters(gaussian_case(n, draw, along_axis), draw),
    odd=-1,
    source="clebsch, for (a1 M, P)",
)
