"""Rosochatius's system: Neumann's particle with walls, potential sum mu_i^2/(2 x_i^2).  State (x, q) as in `neumann`.

It is Neumann's system on S^(2n-1), each b_i twice, modulo the rotations of the planes (y_i, z_i): x_i^2 = y_i^2 +
z_i^2, and mu_i = y_i z_i' - z_i y_i' is conserved.  At z = 0 a state lifts to X = (x, 0), Q = (q, mu/x).  The Lax
pair and the map are those of `neumann_veselov` there; this reduction of Veselov's map was made here.
[Rosochatius 1877; the system is named in Suris 2001 with Neumann's]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import dot, identity, sqrt, vec, wedge
from kreisel.algebra.invariants import blocks, diagonal, stack
from kreisel.record.contract import Checks, Map, Parameter, System, named, pullback
from kreisel.record.spheres import SPHERE_SPACE, random_on_sphere
from kreisel.record.values import distinct, refused
from kreisel.system import neumann, neumann_veselov

nonzero = refused(
    lambda mu: mu == 0, "No entry 0.", "The entries of {letter} must not be 0, got {value}. For mu = 0: neumann."
)
off_the_walls = refused(
    lambda x: x == 0, "No entry 0.", "No entry of {letter} may be 0: the potential mu_i^2/(2 x_i^2) is infinite there."
)


def flow(x, q, *, b, mu):  # x' = q,   q' = f - (<x, f> + |q|^2) x,   f = Bx + mu^2/x^3
    f = b * x + mu * mu / (x * x * x)
    return q, f - vec((dot(x, f) + dot(q, q)) / dot(x, x)) * x


def energy(x, q, *, b, mu):
    return neumann.energy(x, q, b=b) + dot(mu / x, mu / x) / 2


def squares(x, q, *, b, mu):
    """F_i = x_i^2 + sum_j (M_ij^2 + mu_i^2 x_j^2/x_i^2 + mu_j^2 x_i^2/x_j^2)/(b_j - b_i), M = x ^ q."""
    M, ratio = wedge(x, q), (mu / x)[..., :, None] * x[..., None, :]
    unit = identity(x.shape[-1])
    terms = (M * M + ratio * ratio + (ratio * ratio).mT) * (1 - unit)
    F = x * x + (terms / (b[..., None, :] - b[..., :, None] + unit)).sum(-1)
    return stack([F[..., i] for i in range(x.shape[-1])])


def lifted(x, q, mu):
    """x and q in R^2n."""
    return np.concatenate([x, 0 * x], -1), np.concatenate([q, mu / x], -1)


def doubled(b):
    return np.concatenate([b, b], -1)


of_double = pullback(neumann_veselov.SYSTEM, lambda x, q, g, *, b, mu: (lifted(x, q, mu), {"b": doubled(b)}))


def turns(c, s):
    """The rotations of the planes: [[c, -s], [s, c]] of diagonal matrices, of size 2n."""
    c, s = diagonal(c), diagonal(s)
    return blocks([[c, -s], [s, c]])


def lax(x, q, *, b, mu, lam):
    """Neumann's L' = [L, U], from which the rotations of the planes at the rates mu/x^2 are taken."""
    L, U = neumann.lax(*lifted(x, q, mu), b=doubled(b), lam=lam)
    return L, U + turns(0 * x, mu / (x * x))


def moved(x, q, *, b, mu, eps):
    """Veselov's map in R^2n from (x, 0), (q, mu/x): x1 with the signs of x, the new (y, z) and its momentum."""
    y, u, w = neumann_veselov.stretched(b, eps, x, q, mu / x)
    tau = vec(neumann_veselov.root(dot(y, y), dot(u, y), dot(u, u) + dot(w, w), eps))
    y1, z1 = tau * y + eps * u, eps * w
    return x * sqrt((y1 * y1 + z1 * z1) / (x * x)), y1, z1, u / tau + eps * b * y, w / tau


def step(x, q, *, b, mu, eps):
    x1, y, z, v, w = moved(x, q, b=b, mu=mu, eps=eps)
    return x1, neumann_veselov.tangential(x1, (y * v + z * w) / x1)


def conjugator(x, q, *, b, mu, lam, eps):
    x1, y, z, *_ = moved(x, q, b=b, mu=mu, eps=eps)
    return neumann_veselov.conjugator(*lifted(x, q, mu), b=doubled(b), lam=lam, eps=eps) @ turns(y / x1, z / x1)


SYSTEM = System(
    name="rosochatius",
    title="Rosochatius's particle on the sphere",
    equations="x' = q,  q' = f - (<x, f> + |q|^2) x,  f_i = b_i x_i + mu_i^2/x_i^3",
    source="Rosochatius 1877; Moser 1980",
    space=replace(SPHERE_SPACE, draw=lambda n, draw: random_on_sphere(n, draw, least=1)),
    parameters=(
        Parameter(
            "b", "vector", "diagonal of B, distinct entries: H has -<x, Bx>/2", distinct, distinct=True, diagonal=True
        ),
        Parameter("mu", "vector", "strengths of the walls x_i = 0: H has mu_i^2/(2 x_i^2)", nonzero),
    ),
    **named(flow, energy, lax),
    inverse_inertia=lambda M: M,
    scaling="The mass and the radius of the sphere are 1.",
    checks=Checks(state={"x": off_the_walls}),
    integrals={"squares": squares},
    commuting=("squares",),
    map=Map(
        **named(step, conjugator),
        symmetric=True,
        involution=neumann_veselov.involution,
        generator=neumann.generator,
        lax=of_double(neumann_veselov.lax_matrix),
        largest_step=of_double(neumann_veselov.largest_step),
        rational=False,
        commutes=True,
        order=2,
        source="Veselov 1988, on S^(2n-1)",
    ),
    notes="The map commutes with the flow and with itself at other steps. No reduced discrete Lagrangian is stated.",
)
