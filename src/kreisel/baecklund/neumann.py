"""Bäcklund transformations of Neumann's system, state (x, q): as in `clebsch`, on the leaf M = x ^ q, P = x."""

import numpy as np

from kreisel.algebra import act, cayley, complex_number, dot, identity, parts, skew, solve, together, vec, wedge
from kreisel.baecklund import clebsch
from kreisel.record.contract import Baecklund


def on_sphere(M, x):
    """(x, q) of M = x ^ q, P = x: q = -M x/<x, x>."""
    return x, -act(M, x) / vec(dot(x, x))


def moved(x, q, M, M1, x1):
    """q1 = -M1 x1/<x, x> by its difference to q; <x1, x1> = <x, x>."""
    change = act(M, x1 - x) + act(M1 - M, x1) + vec(dot(x, q)) * x
    return x1, q - change / vec(dot(x, x))


def step(x, q, Q, *, c):
    M = wedge(x, q)
    return moved(x, q, M, *clebsch.step(M, x, Q, c=c))


def pair(x, q, Q, *, c, mu):
    M = wedge(x, q)
    return moved(x, q, M, *clebsch.pair(M, x, Q, c=c, mu=mu))


def rational_case(n, draw):
    """b, x, rho and the direction of Q at random; <x, Q> = 1, then mu and q from rho (mu - rho C + M) Q = x."""
    b, turn, d = draw((n,)), cayley(skew(draw((n * (n - 1) // 2,)), n)), draw((n,))
    c, x, rho = clebsch.shifted_diagonal(b=b)["c"], turn[:, 0], abs(draw((1,)))[0]
    Q = d / dot(x, d)
    mu = (1 + rho * rho * dot(Q, c * Q)) / (rho * dot(Q, Q))
    D = mu * Q - rho * c * Q
    return (x, D - x * dot(x, D)), {"b": b}, rho * Q, mu, rho


def gaussian_case(n, draw):
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


BAECKLUND = Baecklund(
    point=lambda x, q, *, c, mu: clebsch.curve(wedge(x, q), x, c=c, mu=mu),
    vector=lambda x, q, *, c, mu, rho: clebsch.eigenvector(wedge(x, q), x, c=c, mu=mu, rho=rho),
    defect=lambda x, q, Q, *, rho: dot(x, Q) - rho,
    step=step,
    pair=pair,
    arc=lambda x, q, Q: (x, Q),
    arc_of_pair=lambda x, q, Q: clebsch.arc_of_pair(q, x, Q),
    darboux=lambda x, q, Q, *, rho, lam: clebsch.darboux(wedge(x, q), x, Q, rho=rho, lam=lam),
    block=lambda x, q: 0 * wedge(x, q),
    case=rational_case,
    pair_case=gaussian_case,
    odd=-1,
    source="the smallest leaf of clebsch",
)
