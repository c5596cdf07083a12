"""Bäcklund transformations of the Lagrange top: rest frame, state (m, a); moving frame, state (M, P).

On the spectral curve (mu - m) e = 2 (a - rho p), <e, e> = 4 rho, with rho = 1/lambda^2; then

    m_1 = m + e ^ p,   a_1 = a + (m + m_1) e / 2 = 2 e <e, a>/<e, e> - a.

The rho of the start is that of all states, but maps with it fixed are unstable across the level sets: for long steps
rounding errors grow up to three times a step.  So e belongs to the rho of the current state, by a step of Newton's
method from that of the start.
[the Lax matrix of Suris 2001, section 5; derivation in docs/baecklund.md; n = 3 by 2 x 2 matrices: Kuznetsov, Petrera,
Ragnisco 2004]
"""

from functools import reduce

import numpy as np

from kreisel.algebra import (
    act,
    complex_number,
    dot,
    identity,
    mat,
    parts,
    pfaffians,
    project_out,
    shifted_resolvent,
    skew,
    sqrt,
    together,
    vec,
    wedge,
    where_less,
)
from kreisel.algebra.invariants import border
from kreisel.record.contract import Baecklund, named

FEW = 5  # dimensions up to which curves are polynomials, by 2^n Pfaffians, in which no terms cancel


def eigenvector(m, a, *, p, mu, rho):
    e, h = 2 * shifted_resolvent(mu, m, a - vec(rho) * p), 2 * shifted_resolvent(mu, m, p + 0 * a)
    return e - vec((dot(e, e) - 4 * rho) / (4 + 2 * dot(e, h))) * h


def curve(m, a, *, p, mu):  # <e, e> = 4 rho, the root of a quadratic equation with rho mu^2 -> |a|^2
    aa, ap, pp = _products(m, a, p, mu)
    half, product = 1 + 2 * ap, 4 * aa * pp
    root = sqrt(half * half - product)
    near, far = 2 * aa / (half + root), 2 * aa / (half - root)
    (_, i), (_, y) = parts(far), parts(mu)
    if y is None:
        return near
    return where_less(i * y, 0, where_less(0, parts(near)[1] * y, far, near), near)  # as Im mu^-2 the right Im rho


def _products(m, a, p, mu):
    """<a, Ra>, <a, Rp>, <p, Rp> of the resolvent R = (mu^2 - m^2)^-1."""
    n = m.shape[-1]
    if n > FEW:
        u, w = shifted_resolvent(mu, m, a), shifted_resolvent(mu, m, p + 0 * a)
        return dot(u, u), dot(u, w), dot(w, w)
    inverse, above, below = 1 / (mu * mu), [[0] * (n + 1) for _ in range(3)], [0] * (n + 1)
    for indices, values in pfaffians(m, a, p).items():
        k, (x, y) = len(indices), (values[0], values[-1])
        if k % 2 == 0:
            below[k] = below[k] + x * x
        else:
            for row, square in zip(above, (x * x, x * y, y * y), strict=True):
                row[k] = row[k] + square
    scale = inverse / polynomial_value(below[::2], inverse)
    return tuple(polynomial_value(row[1::2], inverse) * scale for row in above)


def polynomial_value(coefficients, x):
    """c_0 + c_1 x + ..."""
    return reduce(lambda total, y: total * x + y, reversed(coefficients))


def step(m, a, e, *, p):
    m1 = m + wedge(e, p)
    return m1, a + act(m + m1, e) / 2


def pair(m, a, e, *, p):  # e = u + i w
    u, w = parts(e)
    g = vec(2 * dot(u, w) / dot(w, w)) * w
    m1 = m + wedge(g, p)
    return m1, a + (act(m + m1, g) + u * vec(dot(g, p)) - g * vec(dot(u, p))) / 2


def arc(m, a, e):
    return a, e


def arc_of_pair(m, a, e):
    u, w = parts(e)
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    return w, vec(4 * uw * uw - (uu - ww) * ww) * w - vec(2 * uw * ww) * u


def darboux(m, a, e, *, rho, lam):  # N l = l_new N
    n, square = m.shape[-1], lam * lam
    corner = mat(1 - square * rho) * identity(n) + square / 2 * e[..., :, None] * e[..., None, :]
    out = border(corner, -lam * e)
    out[..., -1, -1] = 1 + square * rho
    return out


def block(m, a):  # pi m pi,  pi = I - a a^T / |a|^2
    return project_out(m, a) / mat(dot(a, a))


def spin(m, a, *, alpha):  # omega - m = (1/alpha - 1) pi m pi, turning with the body
    return mat((1 - alpha) / alpha) * block(m, a)


def largest_step(m, a, *, p):
    """The eps at which the two roots of the quadratic equation for rho meet; infinite if they never do."""

    def exists(eps):
        return np.isfinite(curve(m, a, p=p, mu=2 / eps))

    with np.errstate(all="ignore"):
        low = 1 / np.sqrt(np.sqrt(dot(a, a) * dot(p, p)))  # always reached
        high = 1e8 * low
        forever = exists(high)
        for _ in range(80):
            middle = np.sqrt(low * high)
            reached = exists(middle)
            low, high = np.where(reached, middle, low), np.where(reached, high, middle)
    return np.where(forever, np.inf, low)


def rational_case(n, draw):
    """m, e, p and mu at random; then rho = <e, e>/4 and a = rho p + (mu - m) e / 2."""
    m, e, p, mu = skew(draw((n * (n - 1) // 2,)), n), draw((n,)), draw((n,)), abs(draw((1,)))[0]
    rho = dot(e, e) / 4
    return (m, rho * p + (mu * e - act(m, e)) / 2), {"p": p, "alpha": abs(draw((1,)))[0]}, e, mu, rho


def gaussian_case(n, draw):
    """m, mu and e = u + iw at random; then rho = <e, e>/4, and (mu - m) e = 2 (a - rho p) tells p and a."""
    m, u, w, (x, y, alpha) = skew(draw((n * (n - 1) // 2,)), n), draw((n,)), draw((n,)), abs(draw((3,)))
    rho = complex_number((dot(u, u) - dot(w, w)) / 4, dot(u, w) / 2)
    p = (act(m, w) - x * w - y * u) / dot(u, w)
    a = parts(rho)[0] * p + (x * u - y * w - act(m, u)) / 2
    return (m, a), {"p": p, "alpha": alpha}, together(u, w), complex_number(x, y), rho


BAECKLUND = Baecklund(
    point=curve,
    vector=eigenvector,
    defect=lambda m, a, e, *, rho: dot(e, e) - 4 * rho,
    **named(step, pair, arc, arc_of_pair, darboux, block, spin, largest_step),
    case=rational_case,
    pair_case=gaussian_case,
    source="the Lax matrix of Suris 2001, section 5; derivation in docs/baecklund.md",
)


# -- moving frame: (m, a, p) = (-M, P, A), L(lambda) = -l(1/lambda) ----------------------------------


def inside(state):
    m, a = state
    return -m, a


def spin_inside(M, P, *, A, alpha):  # Omega - M
    return mat((1 - alpha) / alpha / dot(A, A)) * project_out(M, A)


def case_of(case):
    def drawn(n, draw):
        state, params, e, mu, rho = case(n, draw)
        return inside(state), {"A": params["p"], "alpha": params["alpha"]}, e, mu, rho

    return drawn


MOVING = Baecklund(
    point=lambda M, P, *, A, mu: curve(-M, P, p=A, mu=mu),
    vector=lambda M, P, *, A, mu, rho: eigenvector(-M, P, p=A, mu=mu, rho=rho),
    defect=BAECKLUND.defect,
    step=lambda M, P, e, *, A: inside(step(-M, P, e, p=A)),
    pair=lambda M, P, e, *, A: inside(pair(-M, P, e, p=A)),
    spin=spin_inside,
    arc=arc,
    arc_of_pair=arc_of_pair,
    darboux=lambda M, P, e, *, rho, lam: darboux(M, P, e, rho=rho, lam=1 / lam),
    block=block,
    axis="A",
    largest_step=lambda M, P, *, A: largest_step(-M, P, p=A),
    case=case_of(rational_case),
    pair_case=case_of(gaussian_case),
    source="lagrange-top under (m, a, p) = (-M, P, A)",
)
