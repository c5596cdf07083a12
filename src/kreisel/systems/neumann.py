"""Neumann's system, a particle on the sphere in a quadratic potential, and its discretization.

State (x, q): x (..., n) with |x| = 1, q (..., n) with <x, q> = 0, in the frame that turns with the body of
which it is the smallest leaf: M = x ^ q, P = x in `clebsch`.  The potential energy is -<x, Bx>/2, B = diag(b).
Dirac bracket of T*S^(n-1), F' = {H, F}.  [Suris 2001, section 7, end; dimension 2(n-1) and the sign of the
potential by errata E6 and E7; the map is Adler's]
"""

import numpy as np

from kreisel.algebra import (
    act,
    cayley,
    cayley_act,
    complex_number,
    dot,
    dot_less,
    identity,
    increment,
    log,
    mat,
    parts,
    sharp_act,
    skew,
    solve,
    together,
    vec,
    wedge,
)
from kreisel.contract import SPHERE_SPACE, Baecklund, Frame, Map, Parameter, Relation, System
from kreisel.invariants import pencil_spectrum
from kreisel.systems import clebsch
from kreisel.systems.matrices import diagonal


def flow(x, q, *, b):  # x' = q,   q' = Bx - (<x, Bx> + |q|^2) x; divided by |x|^2 = 1 it stays tangential in floats
    return q, b * x - vec((dot(x, b * x) + dot(q, q)) / dot(x, x)) * x


def kick(x, q, h, *, b, eps):
    """The tangential part of q + h Bx / den.

    All of the sum is projected, not the force alone: <x, q> then returns to 0 at every step.  Without, it left 0
    like a walk with a drift, 3.0 bands of round-off after 1e8 steps of 1.
    """
    q = q + vec(h / clebsch.denominator(x, b=b, eps=eps)) * (b * x)
    return q - vec(dot(x, q) / dot(x, x)) * x


def turn(x, q, eps):
    """cay(-(eps/2) x ^ q) on both: a great circle.

    With the matrix, not by <x, v> and <q, v> in O(n): those round |x|^2 = 1 to the same side again and again, and
    the energy drifted steadily (2.2 bands of round-off after 1e8 steps of 1; with the matrix 0.6 and no trend).
    """
    X = increment(-eps / 2, wedge(x, q))
    return cayley_act(X, x), cayley_act(X, q)


def step(x, q, *, b, eps):
    return turn(x, kick(x, q, eps, b=b, eps=eps), eps)


def inverse(x, q, *, b, eps):
    x, q = turn(x, q, -eps)
    return x, kick(x, q, -eps, b=b, eps=eps)


def adjoint(x, q, *, b, eps):
    x, q = turn(x, q, eps)
    return x, kick(x, q, eps, b=b, eps=eps)


def involution(x, q, *, b, eps):
    return x, -kick(x, q, eps, b=b, eps=eps)


def half_kick(x, q, *, b, eps):
    return x, kick(x, q, eps / 2, b=b, eps=eps)


def half_kick_back(x, q, *, b, eps):
    return x, kick(x, q, -eps / 2, b=b, eps=eps)


def second_order(x0, x, *, b, eps):
    """x_(k+1) from x_(k-1), x_k.

    x_(k+1)/(1+<x_k,x_(k+1)>) + x_(k-1)/(1+<x_k,x_(k-1)>) = (eps^2/2) B x_k/den + mu x_k.
    """
    z = vec(eps * eps / 2 / clebsch.denominator(x, b=b, eps=eps)) * (b * x) - x0 / vec(1 + dot(x, x0))
    zx = dot(z, x)
    y = z + vec(((1 - zx) * (1 - zx) - dot(z, z)) / 2) * x
    return y / vec(1 - dot(x, y))


def energy(x, q, *, b, eps=0):
    xBx, qq = dot(x, b * x), dot(q, q)
    return qq / 2 - xBx / 2 + eps * dot(x, b * q) / 2 + eps * eps * qq * xBx / 8


def spectrum(x, q, *, b, eps=0):
    M = wedge(x, q)
    return pencil_spectrum(M, diagonal(b), clebsch.shifted(M, x, eps=eps), eps * eps * dot(x, x) / 4, plane=True)


def lax(x, q, *, b, lam):
    return clebsch.lax(wedge(x, q), x, b=b, lam=lam)


def lax_matrix(x, q, *, b, lam, eps):
    return clebsch.lax_matrix(wedge(x, q), x, b=b, lam=lam, eps=eps)


def conjugator(x, q, *, b, lam, eps):
    return clebsch.conjugator(wedge(x, q), x, b=b, lam=lam, eps=eps)


def on_sphere(M, x):
    """(x, q) of M = x ^ q, P = x: q = -M x/<x, x>, rounded once."""
    stretch = dot_less(x, x, 1)  # <x, x> - 1, which is steady, must not be lost
    return x, sharp_act(-M, x, vec(stretch) * act(M, x))


def eigenvector(x, q, *, c, mu, rho):
    return clebsch.eigenvector(wedge(x, q), x, c=c, mu=mu, rho=rho)


def curve(x, q, *, c, mu):
    return clebsch.curve(wedge(x, q), x, c=c, mu=mu)


def baecklund_step(x, q, Q, dQ, change, *, c, rho):
    return on_sphere(*clebsch.baecklund_step(wedge(x, q), x, Q, dQ, change, c=c, rho=rho))


def baecklund_pair(x, q, Q, dQ, change, *, c, rho):
    return on_sphere(*clebsch.baecklund_pair(wedge(x, q), x, Q, dQ, change, c=c, rho=rho))


def rational_case(n, draw):
    """b, x, rho and the direction of Q at random; <x, Q> = 1, then mu and q from rho (mu - rho C + M) Q = x."""
    b, turn, d = draw((n,)), cayley(skew(draw((n * (n - 1) // 2,)), n)), draw((n,))
    c, x, rho = clebsch.shifted_diagonal(b=b)["c"], turn[:, 0], abs(draw((1,)))[0]
    Q = d / dot(x, d)
    mu = (1 + rho * rho * dot(Q, c * Q)) / (rho * dot(Q, Q))
    D = mu * Q - rho * c * Q
    return (x, D - x * dot(x, D)), {"b": b}, Q, mu, rho


def gaussian_case(n, draw):
    """x, rho, Q = u + iw with <x, Q> = 1, and Re mu at random; then b, Im mu and q by linear equations.

    With D = mu - rho C: q = DQ + x (<q, Q> - 1/rho) is real, and <q, x> = 0.
    """
    turn, u, w, (r, i, x0) = cayley(skew(draw((n * (n - 1) // 2,)), n)), draw((n,)), draw((n,)), draw((3,))
    x, rho = turn[:, 0], complex_number(r, i)
    u, w = u + x * (1 - dot(x, u)), w - x * dot(x, w)
    one = parts(1 / rho)

    def conditions(c, y, tau, given):  # of C, mu = given + iy and Im DQ = tau x: linear
        re, im = (given - r * c) * u - (y - i * c) * w, (given - r * c) * w + (y - i * c) * u
        return np.append(im - tau * x, [dot(re, u), dot(re, w) + tau]), re

    units = np.stack([conditions(e[:n], e[n], e[n + 1], 0 * r)[0] for e in identity(n + 2) + 0 * r], -1)
    wanted = np.append(0 * x, [one[0], one[1]]) - conditions(0 * x, 0 * r, 0 * r, x0)[0]
    *c, y, tau = solve(units, wanted[:, None])[:, 0]
    c = np.array(c)
    re = conditions(c, y, tau, x0)[1]
    return (x, re - x * dot(x, re)), {"b": c}, together(u, w), complex_number(x0, y) - rho * c.max(), rho


def inverse_inertia(M):
    return M


def velocity(x, q):
    return inverse_inertia(wedge(x, q))


def generator(x, q, x1, q1):  # (eps/2) M_(k+1) = x_k ^ x_(k+1) / (1 + <x_k, x_(k+1)>)
    return wedge(x, x1) / mat(1 + dot(x, x1))


def lagrangian(x, x1, p, *, b, eps):
    return 2 / eps * (log(clebsch.denominator(x, b=b, eps=eps)) - log(1 + dot(x, x1)))


def largest_step(x, q, *, b):
    return clebsch.largest_step(q, x, b=b)


SYSTEM = System(
    name="neumann",
    title="Neumann's particle on the sphere",
    equations="x' = q,  q' = Bx - (<x, Bx> + |q|^2) x",
    source="Suris 2001, section 7, end",
    frame=Frame.MOVING,
    space=SPHERE_SPACE,
    parameters=(Parameter("b", "vector", "diagonal of B: the potential energy is -<x, Bx>/2"),),
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    scaling="The mass and the radius of the sphere are 1.",
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    lax=lax,
    map=Map(
        step=step,
        inverse=inverse,
        adjoint=adjoint,
        involution=involution,
        to_symmetric=half_kick,
        from_symmetric=half_kick_back,
        generator=generator,
        lagrangian=lagrangian,
        lax=lax_matrix,
        conjugator=conjugator,
        largest_step=largest_step,
        second_order=second_order,
        source="Suris 2001, section 7, end (Adler's discretization)",
    ),
    baecklund=Baecklund(
        point=curve,
        vector=eigenvector,
        defect=lambda x, q, Q: dot(x, Q) - 1,
        step=baecklund_step,
        pair=baecklund_pair,
        arc=lambda x, q, Q: (x, Q),
        arc_of_pair=lambda x, q, Q, *, rho: clebsch.arc_of_pair(q, x, Q, rho=rho),
        darboux=lambda x, q, Q, *, rho, lam: clebsch.darboux(wedge(x, q), x, Q, rho=rho, lam=lam),
        block=lambda x, q: 0 * wedge(x, q),
        case=rational_case,
        pair_case=gaussian_case,
        odd=-1,
        source="the smallest leaf of clebsch",
    ),
    derive=clebsch.shifted_diagonal,
    relations=(
        Relation(
            "clebsch", lambda x, q, g, *, b: ((wedge(x, q), x), {"b": b}), "step", "M = x ^ q, P = x", back=on_sphere
        ),
    ),
    notes="On the sphere the spectrum has rank n - 1, which is complete.",
)
