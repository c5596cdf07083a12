"""Neumann's system with Veselov's discretization, which conserves the flow's integrals.  State (x, q) as in `neumann`.

With J = (1 - eps^2 B)^(1/2), the discrete Lagrangian is -<x_k, J x_(k+1)>/eps: J (x_(k+1) + x_(k-1)) = nu_k x_k.
q_k is the tangential part of J x_(k+1)/eps at x_k.  Of the two maps that are roots of |x_(k+1)| = 1 the one with
x_(k+1) -> x_k is taken.  [Veselov 1988; Moser, Veselov, Comm. Math. Phys. 139 (1991); named in Suris 2001]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import dot, holds_objects, identity, sqrt, vec, wedge
from kreisel.algebra.invariants import diagonal
from kreisel.record.contract import Map, Relation, named
from kreisel.system import neumann


def roots(*, b, eps):  # J
    return sqrt(1 - eps * eps * b)


def stretched(b, eps, *vectors):
    """J^-1 v = v + k v with k = 1/J - 1, small for short steps."""
    J = roots(b=b, eps=eps)
    k = eps * eps * b / (J * (1 + J))
    return [v + k * v for v in vectors]


def root(yy, uy, uu, eps):  # tau > 0 with |eps u + tau y| = 1; under the root is <x1, J^-1 x>^2
    return (sqrt(yy - eps * eps * (yy * uu - uy * uy)) - eps * uy) / yy


def step(x, q, *, b, eps):  # x1 = eps u + tau y,   q1 = tangential part of u/tau + eps By;   y, u = J^-1 x, J^-1 q
    y, u = stretched(b, eps, x, q)
    tau = vec(root(dot(y, y), dot(u, y), dot(u, u), eps))
    x1 = tau * y + eps * u
    return x1, tangential(x1, u / tau + eps * b * y)


def tangential(x, q):
    return q - vec(dot(x, q) / dot(x, x)) * x


def involution(x, q):
    return x, -q


def second_order(x0, x, *, b, eps):  # x_(k+1) = nu J^-1 x_k - x_(k-1),   nu = 2 <y, x_(k-1)>/|y|^2,   y = J^-1 x_k
    y = x / roots(b=b, eps=eps)
    return vec(2 * dot(y, x0) / dot(y, y)) * y - x0


def energy(x, q, *, b):
    return neumann.energy(x, q, b=b)


def spectrum(x, q, *, b):
    return neumann.spectrum(x, q, b=b)


def lagrangian(x, x1, p, *, b, eps):
    return -dot(x, roots(b=b, eps=eps) * x1) / eps


def lax_matrix(x, q, *, b, lam, eps):  # (J + l x x1^T)(J - l x1 x^T) = J^2 + l eps x ^ q - l^2 x x^T
    unit = identity(b.shape[-1])
    return unit - eps * eps * diagonal(b) + lam * eps * wedge(x, q) - lam * lam * x[..., :, None] * x[..., None, :]


def conjugator(x, q, *, b, lam, eps):  # J + l x x1^T
    return diagonal(roots(b=b, eps=eps)) + lam * x[..., :, None] * step(x, q, b=b, eps=eps)[0][..., None, :]


def largest_step(x, q, *, b):
    """The eps at which 1 - eps^2 B or <x1, J^-1 x>^2 vanishes first, eps^2 being 1/u for an eigenvalue u.

    <x1, J^-1 x>^2 = -det [[1 - eps^2 B, x, eps^2 q], [x^T, 0, 0], [q^T, 0, 1]] / det(1 - eps^2 B).  It is at least
    <y, y> - eps^2 <y, y> <u, u> with <u, u> <= <q, q>/(1 - eps^2 max b): for recorded values that bound decides.
    """
    if holds_objects(q):
        return 1 / sqrt(np.maximum(b.max(-1), 0) + dot(q, q))
    x, q, b = (np.asarray(v, dtype=np.float64) for v in (x, q, b))
    n, lead = x.shape[-1], np.broadcast_shapes(x.shape[:-1], b.shape[:-1])
    A, slope = np.zeros((*lead, n + 2, n + 2)), np.zeros((*lead, n + 2, n + 2))
    A[..., :n, :n], A[..., :n, n], A[..., n, :n], A[..., n + 1, :n], A[..., n + 1, n + 1] = identity(n), x, x, q, 1
    slope[..., :n, :n], slope[..., :n, n + 1] = diagonal(b), -q
    u = np.linalg.eigvals(np.linalg.solve(A, slope))
    real = np.where(abs(u.imag) <= 1e-9 * (abs(u).max(-1, keepdims=True) + 1e-300), u.real, 0)
    return 1 / np.sqrt(np.maximum(np.maximum(real.max(-1), b.max(-1)), 0))


SYSTEM = replace(
    neumann.SYSTEM,
    name="neumann-veselov",
    title="Neumann's particle on the sphere, Veselov's map",
    energy=energy,
    integrals={"spectrum": spectrum},
    map=Map(
        **named(step, involution, lagrangian, conjugator, largest_step, second_order),
        symmetric=True,
        generator=neumann.generator,
        lax=lax_matrix,
        rational=False,
        commutes=True,
        order=2,
        source="Veselov 1988; Moser, Veselov 1991",
    ),
    baecklund=None,
    derive=None,
    relations=(
        Relation("neumann", lambda x, q, g, *, b: ((x, q), {"b": b}), meaning="the same flow with Adler's map"),
    ),
    notes="The map commutes with the flow and with itself at other steps. On the sphere the spectrum has rank n - 1, "
    "which is complete. Higher orders and the closed form of the same flow: neumann.",
)
