"""What a particle needs to be an extended body, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained, shown
from kreisel.physical.free_body import UPRIGHT, FreeBody
from kreisel.physical.measures import RATE, si_numbers
from kreisel.rebound.compiled import is_ball


@explained
@dataclass(frozen=True, eq=False)
class Body:
    """An extended body, in the units of the simulation.

    inertia      moments of inertia about the centre of mass: one number for a ball, (3,) along the principal axes, or a
                 tensor (3, 3) in any body axes; or a body of `kreisel.physical` where the simulation is in SI units
    spin         angular velocity (3,) in the frame of the simulation
    orientation  unit quaternion (w, x, y, z), body axes to the frame of the simulation
    love         potential Love number k_2 of the tides; a ball is a fluid that its rotation flattens with the same k_2
    radius       R, where there are tides; if not given, that of the particle
    lag          time by which the tides are late

    Other bodies than balls keep their figure, of which the moments tell.  REBOUNDx calls half the lag `tau` in
    `tides_spin`.  Raises `InputError` for moments that no body has.
    """

    inertia: Any
    spin: Any = (0.0, 0.0, 0.0)
    orientation: Any = UPRIGHT
    love: float = 0.0
    radius: float | None = None
    lag: float = 0.0

    def __post_init__(self) -> None:
        self.state()
        for name in ("love", "lag"):
            self._not_negative(name)

    def principal(self) -> tuple[Array, Array]:
        """The moments (3,), and the orientation of the principal axes.  Raises `InputError`."""
        inertia = getattr(self.inertia, "inertia", self.inertia)
        number = isinstance(inertia, int | float | np.number)
        body = FreeBody(np.full(3, inertia) if number else inertia)
        moments = body.principal.moments
        if moments.min() <= 0:
            raise InputError(
                f"inertia: expected three moments > 0, got {shown(moments.tolist())}. Usual cause: a rod without "
                "thickness, or a point. Give it its thickness, or leave it a particle."
            )
        g = body.orientation(self.orientation)
        if g.shape != (4,):
            raise InputError(f"orientation: expected one unit quaternion (w, x, y, z), got {shown(self.orientation)}.")
        return moments, g

    def angular_velocity(self) -> Array:
        """(3,).  Raises `InputError`."""
        return si_numbers(self.spin, RATE, "spin, an angular velocity in the frame of the simulation,", ((3,),))

    def state(self) -> Array:
        """L and g, (7,)."""
        moments, g = self.principal()
        R = algebra.rotation_matrix(g)
        return np.concatenate([R @ (moments * (R.T @ self.angular_velocity())), g])

    def tides(self, radius: float) -> tuple[float, float, float]:
        """k_2 R^5, the same for a fluid ball, else 0, and the lag; `radius`: that of the particle.

        Raises `InputError`.
        """
        love, lag = (self._not_negative(name) for name in ("love", "lag"))
        if lag and not love:
            raise InputError(
                f"lag: expected 0 for a body without tides, got {shown(self.lag)}. Usual cause: no love=, the Love "
                "number k_2 of the tides."
            )
        if not love:
            return 0.0, 0.0, 0.0
        size = radius if self.radius is None else self._not_negative("radius")
        if not size > 0:
            raise InputError(
                f"radius: expected a number > 0 for a body with tides, got {shown(self.radius)} and a particle of "
                f"radius {radius}. Usual cause: sim.add(..., r=...) is missing."
            )
        tide = love * size**5
        return tide, tide if is_ball(self.principal()[0]) else 0.0, lag

    def _not_negative(self, name: str) -> float:
        value = getattr(self, name)
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 <= value < math.inf:
            raise InputError(f"{name}: expected a finite number >= 0, got {shown(value)}.")
        return float(value)
