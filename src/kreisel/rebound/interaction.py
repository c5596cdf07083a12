"""An extended body and a point mass: the potential to second order, tides of constant time lag, the free body.

r goes from the body to the mass m; L is the spin angular momentum of the body and g its orientation, both in the frame
of the simulation; I are its principal moments, D = I - tr I/3, Omega its angular velocity.  The mass has the energy
m U,

    U = -(G/2) (tr I - 3 u.I u)/r^3 = (3 G/2) u.D u/r^3      u = r/|r|, I and D as tensors   [MacCullagh]
        + fluid (3 (Omega.u)^2 - Omega^2)/(6 r^3)                 a fluid ball flattened by its rotation
        - G m tide/(2 r^6)                                       the tide that m raises on the body

with tide = fluid = k_2 R^5.  m a = -m grad U acts on the mass, -m a on the body, and -r x m a is the torque on its
spin: both sums are conserved.  A tide that lags by the time tau behind m adds the force [Hut 1981]

    -3 G m^2 tide tau/r^8 (3 v_r + v_t - Omega x r)              v_r, v_t: along and across r

on the mass.  [Murray Dermott 1999, chapters 4 and 5; Eggleton 1998]
"""

from __future__ import annotations

from typing import Any

from kreisel import algebra
from kreisel.algebra import Array, cross, dot
from kreisel.algebra.gradient import value_and_gradient
from kreisel.exact import rotor_step


def potential(b: Array, W: Array, *, D: Array, tide: Any, fluid: Any, G: Any, m: Any) -> Any:
    """U at b (3,), along the principal axes as the angular velocity W (3,)."""
    square = dot(b, b)
    cube = square * algebra.sqrt(square)
    flattening = 3 * dot(W, b) * dot(W, b) / square - dot(W, W)
    return (
        1.5 * G * dot(b * b, D) / (square * cube) + fluid * flattening / (6 * cube) - G * m * tide / (2 * cube * cube)
    )


def kick(r: Array, L: Array, g: Array, h: Any, m: Any, G: Any, *, I: Array, D: Array, tide: Any, fluid: Any) -> Array:
    """a h (3,): the change of the velocity of the mass in the time h, while positions and orientation stay.

    The spin of a fluid ball meanwhile rotates about r by 2 arctan |y|: midpoint rule.
    """
    R = algebra.rotation_matrix(g)
    b, W = r @ R, 3 * (L @ R) / I.sum()
    square = dot(b, b)
    y = h * m * fluid * 3 / (2 * I.sum()) * dot(W, b) / (square * square * algebra.sqrt(square)) * b
    across = cross(y, W)
    W = W + (across + cross(y, across)) / (1 + dot(y, y))
    slope = value_and_gradient(lambda x: potential(x, W, D=D, tide=tide, fluid=fluid, G=G, m=m), [(b, 1)])[1][0]
    return R @ (-h * slope)


def friction(
    r: Array, v: Array, L: Array, g: Array, h: Any, m: Any, own: Any, G: Any, *, I: Array, tide: Any, lag: Any
) -> Array:
    """The change of the velocity of the mass by the lag of the tide in the time h: midpoint rule.

    v (3,) is its velocity relative to the body, whose mass is `own`.  The mean s of the slip v_t - Omega x r solves

        (1 + q (1 + m/own)) s - q m r x (I^-1 (r x s)) = slip      q = 3 G m tide tau h/(2 r^8)

    which is, along the principal axes, a diagonal system and a term of rank 1 for y = r x s.
    """
    R = algebra.rotation_matrix(g)
    b, square = r @ R, dot(r, r)
    rate = 3 * G * m * tide * lag * h / (square * square) ** 2
    along = dot(v, r) / square * r
    ratio = 1 + m / own
    slip = (v - along) @ R - cross((L @ R) / I, b)
    loss, weight = 1 + rate / 2 * ratio, rate / 2 * m / I
    divisor = loss + weight * square
    y = cross(b, slip) / divisor
    y = y + dot(weight * b, y) * square / (loss * dot(b, b / divisor)) * b / divisor
    return -rate * (3 / (1 + 1.5 * rate * ratio) * along + R @ cross(y, b) / square)


def turn(L: Array, g: Array, h: Any, **constants: Array) -> Array:
    """The orientation after the free motion over the time h, exactly; `constants`: of `rotor_step.constants`."""
    return rotor_step.step(L @ algebra.rotation_matrix(g), g, h=h, **constants)[1]


def turn_of_ball(L: Array, g: Array, h: Any, *, I: Array) -> Array:
    """The orientation after the free motion of a ball over the time h, for rotations up to 8 radians."""
    return algebra.quaternion_product(algebra.turn(3 * h / I.sum() * L), g)


def reach(L: Array, g: Array, h: Any, **constants: Array) -> list[Any]:
    """A measure of the length of that step, as in `rotor_step`."""
    return [rotor_step.reach(L @ algebra.rotation_matrix(g), h, **constants)]
