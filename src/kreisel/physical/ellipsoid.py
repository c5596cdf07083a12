"""The homogeneous ellipsoid in an ideal fluid, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import explained
from kreisel.physical.ensemble import Varied
from kreisel.physical.measures import (
    attitude_quaternion,
    convert_fields,
    in_range,
    require_range,
    si_number,
    si_numbers,
)
from kreisel.record.body import UPRIGHT, started
from kreisel.record.model import Model, State
from kreisel.record.units import BodyFrame
from kreisel.system import REGISTRY


def _cyclic(v: Any) -> tuple[Array, Array, Array]:
    """(v1, v2, v3), (v2, v3, v1) and (v3, v1, v2): a formula for the first axis then holds for all."""
    return np.asarray(v), np.roll(v, -1), np.roll(v, -2)


@explained
@dataclass(frozen=True, repr=False)
class Ellipsoid(Varied):
    """Homogeneous ellipsoid in an ideal fluid at rest at infinity, in SI units.

    semi_axes (a, b, c) along the body axes, m;  mass, kg;  fluid_density, kg/m^3 (0 is a vacuum).  No gravity: the
    body is as heavy as the fluid that it displaces.  [Lamb, Hydrodynamics, 6th ed., articles 114, 115; DLMF 19.16.5]
    """

    semi_axes: tuple[float, float, float]
    mass: float
    fluid_density: float

    def __post_init__(self) -> None:
        axes = si_numbers(self.semi_axes, "m", "semi_axes (a, b, c)", ((3,),))
        lengths = tuple(si_number(a, "m", k, positive=True) for k, a in zip("abc", axes, strict=True))
        object.__setattr__(self, "semi_axes", lengths)
        self.shaped("ellipsoid", lengths)
        convert_fields(self, positive=True, mass="kg")
        convert_fields(self, least=0.0, fluid_density="kg/m^3")
        require_range(self, "displaced_mass", "added_masses", "added_moments", "moments")
        in_range("1/mass and 1/moment", lambda: 1 / np.concatenate([self.mass + self.added_masses, self._inertia]))

    @classmethod
    def of_density(cls, semi_axes: tuple[float, float, float], density: float, fluid_density: float) -> Ellipsoid:
        """The ellipsoid from the density of the body, kg/m^3.  Raises `InputError`."""
        axes = si_numbers(semi_axes, "m", "semi_axes (a, b, c)", ((3,),))
        density = si_number(density, "kg/m^3", "density")
        mass = in_range("The mass", lambda: density * 4 / 3 * math.pi * math.prod(axes))
        return cls(axes, mass, fluid_density)

    @property
    def displaced_mass(self) -> float:
        """(4/3) pi a b c rho, kg."""
        return self.fluid_density * 4 / 3 * math.pi * math.prod(self.semi_axes)

    @property
    def shape_integrals(self) -> Array:
        """Lamb's (alpha0, beta0, gamma0), of sum 2: alpha0 = (2/3) a b c R_D(b^2, c^2, a^2), and cyclic."""
        from scipy.special import elliprd

        a2, b2, c2 = _cyclic(np.square(self.semi_axes))
        return 2 / 3 * math.prod(self.semi_axes) * elliprd(b2, c2, a2)

    @property
    def added_masses(self) -> Array:
        """Displaced mass times alpha0/(2 - alpha0) = alpha0/(beta0 + gamma0), and cyclic; (3,), kg."""
        alpha, beta, gamma = _cyclic(self.shape_integrals)
        return self.displaced_mass * alpha / (beta + gamma)

    @property
    def added_moments(self) -> Array:
        """(M/5) (b^2 - c^2)^2 s/(2 - (b^2 + c^2) s) with s = (gamma0 - beta0)/(b^2 - c^2), and cyclic; (3,), kg m^2.

        M is the displaced mass.  2 - (b^2 + c^2) s > alpha0, also if rounding violates this (b nearly c).
        """
        (_, b2, c2), (alpha, beta, gamma) = _cyclic(np.square(self.semi_axes)), _cyclic(self.shape_integrals)
        s = np.divide(gamma - beta, b2 - c2, out=np.zeros(3), where=b2 != c2)
        return self.displaced_mass / 5 * (b2 - c2) ** 2 * s / np.maximum(2 - (b2 + c2) * s, alpha)

    @property
    def moments(self) -> Array:
        """Moments of the body without the fluid, m (b^2 + c^2)/5 and cyclic; (3,), kg m^2."""
        _, b2, c2 = _cyclic(np.square(self.semi_axes))
        return self.mass / 5 * (b2 + c2)

    @property
    def _inertia(self) -> Array:
        return self.moments + self.added_moments

    def model(self) -> Model:
        """`Kirchhoff`, in SI: c_jk = 1/(I_l + added moment) with l normal to (j, k), B = -diag(1/(mass + added mass)).

        For a = b it is `KirchhoffRevolution`, which moves alike and has maps that conserve all integrals.
        """
        (x, y, z), inverse_masses = 1 / self._inertia, 1 / (self.mass + self.added_masses)
        if self.semi_axes[0] == self.semi_axes[1] and not self._lanes:
            model = REGISTRY["kirchhoff-revolution"](a1=x, a3=z, c1=inverse_masses[0], c3=inverse_masses[2])
        else:
            model = REGISTRY["kirchhoff"](C=[[0.0, z, y], [z, 0.0, x], [y, x, 0.0]], B=-inverse_masses)
        return model.of_body(BodyFrame.in_units(1.0, 1.0, P=("kg m/s", 1.0)))

    def state(self, velocity: Any, angular_velocity: Any, attitude: Any = UPRIGHT) -> State:
        """The impulse of a motion, P = (mass + added mass) U and M = (I + added moment) Omega.

        U (..., 3) in m/s and Omega (..., 3) in rad/s along the body axes.  A run of the body begins with this
        attitude, a unit quaternion (..., 4) = (w, x, y, z).  Raises `InputError`.
        """
        U, Omega = si_numbers(velocity, "m/s", "velocity"), si_numbers(angular_velocity, "rad/s", "angular_velocity")
        P = in_range("The impulse", lambda: U * (self.mass + self.added_masses))
        M = in_range("The impulse", lambda: Omega * self._inertia)
        return started(self.model(), attitude_quaternion(attitude, "attitude"), M=algebra.hat(M), P=P)
