"""Section 7, end: Neumann's system on the smallest leaf."""

from __future__ import annotations

import numpy as np

from kreisel.algebra import Array, act, dot, wedge
from kreisel.lab.law import Sides
from kreisel.lab.paper.statements import Setting, printed, rank, stated, stated_law
from kreisel.system import clebsch, neumann

CLEBSCH, NEUMANN = clebsch.SYSTEM, neumann.SYSTEM


def _leaf_point(s: Setting) -> tuple[Array, Array]:
    x = s.unit()
    q = s.vector()
    return x, q - x * dot(x, q)


@stated(
    "neumann-leaf",
    "Section 7, end, the smallest leaf",
    "at M = x ^ q, P = x the bracket has rank 2(n - 1) (printed 2n, E6)",
    "E6",
    numbers=("exact",),
)
def neumann_leaf(s: Setting) -> Sides:
    yield np.asarray(_leaf_rank(s)), np.asarray(2 * (s.n - 1))


def _leaf_rank(s: Setting) -> int:
    x, q = _leaf_point(s)
    return rank(CLEBSCH.space.tensor(wedge(x, q), x))


@printed("neumann-leaf")
def neumann_leaf_printed(s: Setting) -> Sides:
    yield np.asarray(_leaf_rank(s)), np.asarray(2 * s.n)


@stated(
    "neumann-flow",
    "Section 7, end, Neumann's system",
    "P = x, M = x ^ q: x' = q, q' = Bx - (...)x, that is the potential energy -<x, Bx>/2 (printed +, E7)",
    "E7",
)
def neumann_flow(s: Setting) -> Sides:
    yield from _neumann_flow(s, 1)


def _neumann_flow(s: Setting, sign: int) -> Sides:
    x, q = _leaf_point(s)
    b = s.diagonal()
    force = sign * b * x  # minus the gradient of -sign <x, Bx>/2
    x_rate, q_rate = q, force - (dot(x, force) + dot(q, q)) * x
    M, (M_rate, P_rate) = wedge(x, q), clebsch.flow(wedge(x, q), x, b=b)
    yield P_rate, x_rate
    yield M_rate, wedge(x_rate, q) + wedge(x, q_rate)
    yield -act(M_rate, x) - act(M, P_rate), q_rate  # q = -M x; wedged with x alone the multiplier is free
    if sign > 0:
        yield from zip(neumann.flow(x, q, b=b), (x_rate, q_rate), strict=True)


@printed("neumann-flow")
def neumann_flow_printed(s: Setting) -> Sides:
    yield from _neumann_flow(s, -1)


stated_law(
    "neumann-map",
    "Section 7, end, Adler's discretization",
    "the map on the leaf in (x, q), in second-order form, and as a Poisson map of T*S^(n-1) with a Lax pair",
    NEUMANN,
    "relations",
    "second-order-form",
    "poisson",
    "integrals-of-the-map",
    "discrete-lax-equation",
    "involution",
)
