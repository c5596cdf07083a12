"""Interaction of two particles in a short time, as changes of momentum and spin: figures, tides, their lag.

r and v go from body 1 to body 2; L is the spin angular momentum of a body and q its orientation, both in the frame of
the simulation.  The mutual potential to the fourth degree and the force of tides that lag are taken from
`kreisel.bodies.binary`, with masses 1 and with factors that have time, masses and constant of gravity.  A fluid ball
flattened by its rotation Omega adds for the mass m of the other body

    m k_2 R^5 (3 (Omega.u)^2 - Omega^2)/(6 r^3)                u = r/|r|   [Eggleton 1998]

The changes are p, which body 2 receives and body 1 loses, and the torques T1, T2 with T1 + T2 + r x p = 0.
"""

from __future__ import annotations

from typing import Any, cast

from kreisel import algebra
from kreisel.algebra import Array, cross, dot
from kreisel.algebra.gradient import value_and_gradient
from kreisel.bodies import binary
from kreisel.exact import rotor_step

formulas = cast("Any", binary)  # of a page, without types
Changes = tuple[Array, Array, Array]
LEAST = {"D": 2, "degree_3_": 4, "degree_4_": 4}  # degree of the figures that have it; all over the mass of the body
FIGURES = {f"{name}{i}": (count,) for name, count in zip(LEAST, (3, 7, 9), strict=True) for i in (1, 2)}
BODIES = {"inverse1": (3,), "inverse2": (3,), "on1": (), "on2": ()}
FLUID = {"fluid1": (), "fluid2": (), **BODIES}
LAG = {"lag1": (), "lag2": (), "into1": (), "into2": (), **BODIES}


def potential(r: Array, q1: Array, q2: Array, *, raised: Any, **figures: Array) -> Any:
    """V_12 of masses 1, in SI; `raised`: (m2 tide1/m1 + m1 tide2/m2)."""
    return formulas.potential(r, q1, q2, m1=1.0, m2=1.0, tide1=raised, tide2=0.0, **figures)


def flattening(r: Array, W: Array) -> Any:
    """The energy of a fluid ball with the angular velocity W for m k_2 R^5 = 1."""
    square = dot(r, r)
    return (3 * dot(W, r) * dot(W, r) / square - dot(W, W)) / (6 * square * algebra.sqrt(square))


def kick(r: Array, q1: Array, q2: Array, *, strength: Any, raised: Any, **figures: Array) -> Changes:
    """Changes by the mutual potential while positions and orientations stay; `strength`: of V_12."""

    def energy(r: Array, turn: Array) -> Any:
        turned = algebra.quaternion_product(algebra.quaternion(1 + 0 * turn[0], 0.5 * turn), q2)
        return potential(r, q1, turned, raised=raised, **figures)

    _, (slope, torque) = value_and_gradient(energy, [(r, 1), (0 * r, 1)])
    p, T2 = -strength * slope, -strength * torque
    return p, -cross(r, p) - T2, T2


def flatten(
    r: Array, L1: Array, L2: Array, *, fluid1: Any, fluid2: Any, inverse1: Array, inverse2: Array, on1: Any, on2: Any
) -> Changes:
    """Changes by two fluid balls; `fluid`: m k_2 R^5 times the time.

    Each spin meanwhile rotates about r by 2 arctan |y|: midpoint rule.
    """
    square, changes = dot(r, r), []
    for L, fluid, inverse, on in ((L1, fluid1, inverse1, on1), (L2, fluid2, inverse2, on2)):
        W = L * inverse
        y = 0.5 * on * fluid * inverse[0] * dot(W, r) / (square * square * algebra.sqrt(square)) * r
        across = cross(y, W)
        W = W + (across + cross(y, across)) / (1 + dot(y, y))
        changes.append(-fluid * value_and_gradient(lambda x, W=W: flattening(x, W), [(r, 1)])[1][0])
    p1, p2 = changes
    return p1 + p2, -cross(r, p1), -cross(r, p2)


def energy(r: Array, state1: Array, state2: Array, *, strength: Any, raised: Any, **factors: Any) -> Any:
    """The energy of a kick of the time 1, `state`: L and q."""
    figures = {name: factors[name] for name in FIGURES}
    total = strength * potential(r, state1[3:], state2[3:], raised=raised, **figures)
    for n, state in ((1, state1), (2, state2)):
        total = total + factors[f"fluid{n}"] * flattening(r, state[:3] * factors[f"inverse{n}"])
    return total


def friction(
    r: Array, v: Array, L1: Array, q1: Array, L2: Array, q2: Array, *, inverse1: Array, inverse2: Array, into1: Any,
    into2: Any, on1: Any, on2: Any, **lags: Any,
) -> Changes:  # fmt: skip
    """Changes by tides that lag, by the midpoint rule; `lag`: m^2 k_2 R^5 times the lag and the time.

    into   the change of the velocity of a body by p: 1/m; on   1, or 0 for a body that does not react
    """
    constants = {
        "m1": 1.0,
        "m2": 1.0,
        "reduced": 1.0,
        "rotor1": inverse1,
        "rotor2": inverse2,
        "tide1": 1.0,
        "tide2": 1.0,
    }

    def changes(v: Array, L1: Array, L2: Array) -> Changes:
        _, p, T1, _, T2, _ = formulas.friction(r, v, L1, q1, L2, q2, **constants, **lags)[0]
        return p, T1, T2

    p, T1, T2 = changes(v, L1, L2)
    return changes(v + 0.5 * (into1 + into2) * p, L1 + 0.5 * on1 * T1, L2 + 0.5 * on2 * T2)


def turn(L: Array, q: Array, h: Any, **constants: Array) -> Array:
    """The orientation after the free motion over the time h, exactly; `constants`: of `rotor_step.constants`."""
    return rotor_step.step(L @ algebra.rotation_matrix(q), q, h=h, **constants)[1]


def turn_of_ball(L: Array, q: Array, h: Any, *, inverse: Array, **_: Array) -> Array:
    """The orientation after the free motion of a ball over the time h, for rotations up to 8 radians."""
    return algebra.quaternion_product(algebra.turn(h * inverse[0] * L), q)


def reach(L: Array, q: Array, h: Any, **constants: Array) -> list[Any]:
    """A measure of the length of that step, as in `rotor_step`."""
    return [rotor_step.reach(L @ algebra.rotation_matrix(q), h, **constants)]


def reach_of_ball(L: Array, q: Array, h: Any, *, inverse: Array, **_: Array) -> list[Any]:
    """`reach` of a ball."""
    return [rotor_step.reach(L, h, inverse=inverse, curvatures=0 * q[:3])]
