"""Goryachev-Chaplygin's top with a rotor, n = 3, on <M, P> = 0.  State (M, P) in e(3)*: axial vectors, body frame.

The moments of inertia are (1, 1, 1/4) and the centre of mass is on the first axis; gamma is the momentum of the rotor.
The second integral is one on <M, P> = 0 only.  Plus bracket, F' = {H, F}.
[Goryachev 1900; Chaplygin 1901; named in Suris 2001, Introduction]
"""

from dataclasses import replace

import numpy as np

from kreisel.algebra import act, axial, cross, dot, hat, identity, vec, wedge
from kreisel.algebra.invariants import stack
from kreisel.baecklund.goryachev_chaplygin import EXACT
from kreisel.record.contract import MOVING_SPACE, Parameter, System, named

INVERSE_MOMENTS = np.array([1, 1, 4], dtype=np.int8)


def velocity(M, P, *, gamma):  # Omega = (M_1, M_2, 4 M_3 + gamma)
    return hat(INVERSE_MOMENTS * axial(M) + vec(gamma) * identity(3)[2])


def flow(M, P, *, gamma):  # M' = [M, Omega] + e_1 ^ P,   P' = -Omega P
    Omega = velocity(M, P, gamma=gamma)
    return M @ Omega - Omega @ M + wedge(identity(3)[0], P), -act(Omega, P)


def energy(M, P, *, gamma):
    u = axial(M)
    return dot(u, INVERSE_MOMENTS * u) / 2 + gamma * u[..., 2] + P[..., 0]


def chaplygin(M, P, *, gamma):  # (M_3 + gamma/2)(M_1^2 + M_2^2) - M_1 P_3
    x, y, z = (axial(M)[..., i] for i in range(3))
    return (z + gamma / 2) * (x * x + y * y) - x * P[..., 2]


def on_leaf(n, draw):
    """M with <M, P> = 0: a cross product with P."""
    P = draw((3,))
    return hat(cross(P, draw((3,)))), P


SYSTEM = System(
    name="goryachev-chaplygin",
    title="Goryachev-Chaplygin top",
    equations="M' = M x Omega + P x e_1,  P' = P x Omega,  Omega = (M_1, M_2, 4 M_3 + gamma)",
    source="Goryachev 1900, Chaplygin 1901; Suris 2001, Introduction",
    space=replace(
        MOVING_SPACE,
        name="e*(3), <M, P> = 0",
        casimirs=lambda M, P: stack([dot(P, P), dot(axial(M), P)]),  # not its square: without a gradient no projection
        constraints={"<M, P>": lambda M, P: dot(axial(M), P)},
        draw=on_leaf,
    ),
    parameters=(Parameter("gamma", "scalar", "the momentum of a rotor along the third axis", None, 0.0),),
    **named(flow, energy, velocity),
    scaling="The transverse moment of inertia and m g l are 1; the axial moment is 1/4.",
    integrals={"chaplygin": chaplygin},
    commuting=("chaplygin",),
    exact_map=EXACT,
    n=3,
    notes="No explicit map is known; method='exact'.",
)
