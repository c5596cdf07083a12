"""An extended body in a REBOUND simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained, shown
from kreisel.physical.free_body import FreeBody
from kreisel.physical.measures import RATE, si_numbers
from kreisel.record.body import UPRIGHT

SAME_MASS = 1e-6  # relative: a particle and its body


@explained
@dataclass(frozen=True, eq=False)
class Body:
    """An extended body, in the units of the simulation.

    inertia      moments of inertia about the centre of mass: one value for a ball, (3,) along the principal axes, or a
                 tensor (3, 3) in any body axes; or a body of `kreisel.physical` if the simulation is in SI units, of a
                 `GravityBody` its tides and integrals of degrees 3 and 4 too; per mass for a particle without mass
    spin         angular velocity (3,) in the frame of the simulation
    orientation  unit quaternion (w, x, y, z), body axes to the frame of the simulation
    love         potential Love number k_2 of the tides; a ball is a fluid that its rotation flattens with the same k_2
    radius       R, for tides; default: the radius of the particle
    lag          time lag of the tides
    degree_3     (7,), m R^3 (C_30, C_31, S_31, ... S_33) along the principal axes, not normalized
    degree_4     (9,), m R^4 (C_40, C_41, S_41, ... S_44)

    Bodies other than balls keep their figure, which the moments determine.  In REBOUNDx, `tau` of `tides_spin` is half
    the lag.  Raises `InputError` for impossible moments of inertia.
    """

    inertia: Any
    spin: Any = (0.0, 0.0, 0.0)
    orientation: Any = UPRIGHT
    love: float = 0.0
    radius: float | None = None
    lag: float = 0.0
    degree_3: Any = None
    degree_4: Any = None

    def __post_init__(self) -> None:
        self.state()
        for name in ("love", "lag"):
            self._not_negative(name)
        self._higher()

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
        """The angular velocity (3,).  Raises `InputError`."""
        return si_numbers(self.spin, RATE, "spin, an angular velocity in the frame of the simulation,", ((3,),))

    def state(self) -> Array:
        """L and g, (7,)."""
        moments, g = self.principal()
        R = algebra.rotation_matrix(g)
        return np.concatenate([R @ (moments * (R.T @ self.angular_velocity())), g])

    def _of_particle(self, particle: Any) -> tuple[Array, Array]:
        """L, g and the constants: moments, integrals of degrees 3 and 4, k_2 R^5, lag.  Raises `InputError`."""
        if not isinstance(self.radius, int | float | np.number | None):
            raise InputError(f"radius: expected a number, got {shown(self.radius)}.")
        love, lag = (self._not_negative(name) or getattr(self.inertia, name, 0.0) for name in ("love", "lag"))
        if lag and not love:
            raise InputError(
                f"lag: expected 0 for a body without tides, got {shown(self.lag)}. Usual cause: no love=, the Love "
                "number k_2 of the tides."
            )
        known = getattr(self.inertia, "size", 0.0) or particle.r
        size = known if self.radius is None else self._not_negative("radius")
        if love and not size > 0:
            raise InputError(
                f"radius: expected a number > 0 for a body with tides, got {shown(self.radius)} and a particle of "
                f"radius {particle.r}. Usual cause: sim.add(..., r=...) is missing."
            )
        mass, scale = getattr(self.inertia, "mass", None), 1.0
        if mass and not particle.m:
            scale = 1 / mass
        elif mass and abs(particle.m / mass - 1) > SAME_MASS:
            raise InputError(
                f"inertia: expected a body with the mass {particle.m} of its particle, got {mass}. Usual cause: a "
                "simulation in other units than SI; set sim.units = ('m', 's', 'kg')."
            )
        state, tide = self.state(), love * size**5 if love else 0.0
        state[:3] *= scale
        return state, np.concatenate([scale * np.concatenate([self.principal()[0], *self._higher()]), [tide, lag]])

    def _higher(self) -> list[Array]:
        """The inertia integrals of degrees 3 and 4.  Raises `InputError` unless they are along the principal axes."""
        out = []
        for name, count in (("degree_3", 7), ("degree_4", 9)):
            value = getattr(self, name)
            value = getattr(self.inertia, name, np.zeros(count)) if value is None else value
            out.append(si_numbers(value, f"kg m^{name[-1]}", name, ((count,),)))
        inertia = np.asarray(getattr(self.inertia, "inertia", self.inertia))
        if any(x.any() for x in out) and inertia.ndim == 2 and (inertia - np.diag(np.diag(inertia))).any():
            raise InputError(
                f"degree_3, degree_4: expected principal axes, got inertia={shown(inertia.tolist())}. Usual cause: a "
                "tensor in other axes; kr.physical.GravityBody.points and mesh compute all of them in principal axes."
            )
        return out

    def _not_negative(self, name: str) -> float:
        value = getattr(self, name)
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 <= value < math.inf:
            raise InputError(f"{name}: expected a finite number >= 0, got {shown(value)}.")
        return float(value)
