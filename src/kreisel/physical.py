"""From SI data to Kreisel's scaled systems, and back.

    wheel = Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15)
    run = kr.simulate(wheel.model(), wheel.state(tilt=1.2, spin=20.0), dt=0.01, steps=1000)
    seconds, motion = run.time * wheel.time_unit, wheel.motion(run.m, run.a)

`Gyroscope` is the heavy symmetric top on a fixed point, `Ellipsoid` a body in an ideal fluid.  The third
axis of the rest frame points up, gravity along -p = (0, 0, -1); hat(v) x = v x x.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.model import Model, State
from kreisel.systems import Kirchhoff, LagrangeTop

STANDARD_GRAVITY = 9.80665  # m/s^2, the conventional value (CGPM 1901)


def _check(*, positive: bool = False, **values: Any) -> None:
    for name, value in values.items():
        number = isinstance(value, int | float | np.floating | np.integer) and math.isfinite(value)
        if not number or (positive and value <= 0):
            raise InputError(f"{name} must be a finite number{' > 0' * positive} in SI units; {value!r} came.")


@dataclass(frozen=True)
class Units:
    """Units of a scaled system: mass in kg, length in m, time in s.  Raises `InputError` unless all are > 0."""

    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0

    def __post_init__(self) -> None:
        _check(positive=True, **asdict(self))


SI = Units()


class Motion(NamedTuple):
    """Motion of a gyroscope in Euler's angles: angles in rad, rates in rad/s, each of shape (...)."""

    tilt: Array  # theta, from the upward vertical
    azimuth: Array  # phi, in [-pi, pi]
    spin: Array  # w3 = psi' + phi' cos(theta), the total axial angular velocity
    precession: Array  # phi'
    nutation: Array  # theta'


@dataclass(frozen=True)
class Gyroscope:
    """Heavy symmetric top on a fixed point, in SI units.

    mass m, kg;  lever l, from the pivot to the centre of mass, m;  gravity g, m/s^2
    axial_moment        I3, about the axis of symmetry, kg m^2
    transverse_moment   I1, about a transverse axis through the PIVOT, kg m^2 (Steiner: I1 = I_c + m l^2)

    Scaled as `LagrangeTop`: time in sqrt(I1/(m g l)), momentum in sqrt(I1 m g l), |a| = |p| = 1, alpha = I3/I1.
    Raises `InputError` unless all are > 0 and I3 <= 2 I_c.  [Goldstein, Classical Mechanics, 3rd ed., section 5.7]
    """

    mass: float
    axial_moment: float
    transverse_moment: float
    lever: float
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        _check(positive=True, **asdict(self))
        central = self.transverse_moment - self.mass * self.lever**2
        if self.axial_moment > 2 * central + 1e-12 * self.transverse_moment:  # equal for a flat body, but for rounding
            raise InputError(
                f"No body has these moments: axial_moment = {self.axial_moment:.6g} exceeds twice transverse_moment - "
                f"mass lever^2 = {central:.6g}. Usual cause: transverse_moment not about the pivot: add mass lever^2."
            )

    @classmethod
    def flat(cls, mass: float, axial_moment: float, lever: float, gravity: float = STANDARD_GRAVITY) -> Gyroscope:
        """A flat wheel on a light axle: I1 = I3/2 + m l^2 (perpendicular axes, Steiner).  Raises `InputError`."""
        return cls(mass, axial_moment, axial_moment / 2 + mass * lever**2, lever, gravity)

    @property
    def alpha(self) -> float:
        """I3/I1, the parameter of `LagrangeTop`."""
        return self.axial_moment / self.transverse_moment

    @property
    def torque(self) -> float:
        """M g l, the largest torque of gravity, N m; also the unit of energy, J."""
        return self.mass * self.gravity * self.lever

    @property
    def time_unit(self) -> float:
        """sqrt(I1/(m g l)), s."""
        return math.sqrt(self.transverse_moment / self.torque)

    @property
    def momentum_unit(self) -> float:
        """sqrt(I1 m g l), kg m^2/s."""
        return math.sqrt(self.transverse_moment * self.torque)

    def model(self) -> Model:
        """The scaled system: `LagrangeTop(p=(0, 0, 1), alpha=I3/I1)`."""
        return LagrangeTop(p=(0.0, 0.0, 1.0), alpha=self.alpha)

    def state(self, tilt: float, spin: float, precession: float = 0.0, nutation: float = 0.0) -> State:
        """The scaled state at azimuth 0: a = (sin theta, 0, cos theta), m = I1 a x a' + I3 w3 a.

        Tilt theta in rad from the upward vertical; spin w3 (the total axial angular velocity), precession
        phi' and nutation theta' in rad/s: with neither, the axis is released from rest.  Raises `InputError`.
        """
        _check(tilt=tilt, spin=spin, precession=precession, nutation=nutation)
        sin, cos = math.sin(tilt), math.cos(tilt)
        a, swing = np.array([sin, 0.0, cos]), np.array([-precession * sin * cos, nutation, precession * sin**2])
        return self.model().state(m=self.time_unit * (swing + self.alpha * spin * a), a=a)

    @staticmethod
    def orientation(tilt: float) -> Array:
        """The unit quaternion (w, x, y, z) that takes the third body axis to the `a` of `state(tilt, ...)`."""
        _check(tilt=tilt)
        return np.array([math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0])

    def motion(self, m: Any, a: Any) -> Motion:
        """The inverse of `state`, from m (..., 3) axial and a (..., 3); precession of a vertical axis is NaN."""
        m, a = np.asarray(m, dtype=np.float64), np.asarray(a, dtype=np.float64)
        x, y, z = np.moveaxis(a, -1, 0)
        dx, dy, dz = np.moveaxis(np.cross(m, a), -1, 0) / self.time_unit  # a' = m x a
        rho = np.where((x == 0) & (y == 0), np.nan, np.hypot(x, y))
        spin = np.sum(m * a, axis=-1) / (self.alpha * self.time_unit)
        return Motion(np.arctan2(np.hypot(x, y), z), np.arctan2(y, x), spin, (x * dy - y * dx) / rho**2, -dz / rho)

    def slow_precession(self, spin: float) -> float:
        """The textbook rate of a fast top, m g l/(I3 w3), rad/s.  Raises `InputError` for no spin."""
        _check(positive=True, spin=abs(spin))
        return self.torque / (self.axial_moment * spin)

    def steady_precession(self, tilt: float, spin: float) -> tuple[float, float]:
        """The slow and the fast root W of I1 cos(theta) W^2 - I3 w3 W + m g l = 0, rad/s.

        Free of cancellation: W = 2 m g l/q and q/(2 I1 cos(theta)), where q = I3 w3 +- sqrt(discriminant) with
        the sign of w3; the fast root of a horizontal axis is at infinity.  Raises `InputError` for no real root.
        """
        _check(tilt=tilt, spin=spin)
        momentum, rise = self.axial_moment * spin, self.transverse_moment * math.cos(tilt)
        discriminant = momentum**2 - 4 * rise * self.torque
        q = momentum + math.copysign(math.sqrt(max(discriminant, 0.0)), momentum)
        if discriminant < 0 or q == 0:
            raise InputError(
                f"No steady precession at tilt = {tilt:.6g} rad with spin = {spin:.6g} rad/s: |spin| must be at least "
                f"{2 * math.sqrt(max(rise, 0) * self.torque) / self.axial_moment:.6g} rad/s, and not 0."
            )
        return 2 * self.torque / q, q / (2 * rise) if rise else math.copysign(math.inf, q)

    def nutation_rate(self, spin: float) -> float:
        """The nutation frequency of a fast top, I3 w3/I1, rad/s."""
        return self.alpha * spin

    @property
    def sleeping_spin(self) -> float:
        """The upright top is stable (it sleeps) above this spin, 2 sqrt(I1 m g l)/I3, rad/s."""
        return 2 * self.momentum_unit / self.axial_moment


def _cyclic(v: Any) -> tuple[Array, Array, Array]:
    """(v1, v2, v3), (v2, v3, v1) and (v3, v1, v2): a formula for the first axis then holds for all."""
    return np.asarray(v), np.roll(v, -1), np.roll(v, -2)


@dataclass(frozen=True)
class Ellipsoid:
    """Homogeneous ellipsoid in an ideal fluid at rest at infinity, in SI units.

    semi_axes (a, b, c) along the body axes, m;  mass, kg;  fluid_density, kg/m^3 (0 is a vacuum).  No gravity: the
    body is as heavy as the fluid that it displaces.  [Lamb, Hydrodynamics, 6th ed., articles 114, 115; DLMF 19.16.5]
    """

    semi_axes: tuple[float, float, float]
    mass: float
    fluid_density: float

    def __post_init__(self) -> None:
        if len(self.semi_axes) != 3:
            raise InputError(f"semi_axes must be three lengths (a, b, c) in m; {self.semi_axes!r} came.")
        _check(positive=True, mass=self.mass, **dict(zip("abc", self.semi_axes, strict=True)))
        _check(positive=self.fluid_density != 0, fluid_density=self.fluid_density)

    @classmethod
    def of_density(cls, semi_axes: tuple[float, float, float], density: float, fluid_density: float) -> Ellipsoid:
        """The same from the density of the body, kg/m^3.  Raises `InputError`."""
        return cls(semi_axes, density * 4 / 3 * math.pi * math.prod(semi_axes), fluid_density)

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

        M is the displaced mass.  2 - (b^2 + c^2) s > alpha0, also where rounding says otherwise (b nearly c).
        """
        (_, b2, c2), (alpha, beta, gamma) = _cyclic(np.square(self.semi_axes)), _cyclic(self.shape_integrals)
        s = np.divide(gamma - beta, b2 - c2, out=np.zeros(3), where=b2 != c2)
        return self.displaced_mass / 5 * (b2 - c2) ** 2 * s / np.maximum(2 - (b2 + c2) * s, alpha)

    @property
    def moments(self) -> Array:
        """Moments of the body alone, m (b^2 + c^2)/5 and cyclic; (3,), kg m^2."""
        _, b2, c2 = _cyclic(np.square(self.semi_axes))
        return self.mass / 5 * (b2 + c2)

    def model(self, units: Units = SI) -> Model:
        """`Kirchhoff`: c_jk = 1/(I_l + added moment) with l normal to (j, k), B = -diag(1/(mass + added mass))."""
        x, y, z = units.mass * units.length**2 / (self.moments + self.added_moments)
        return Kirchhoff(C=[[0.0, z, y], [z, 0.0, x], [y, x, 0.0]], B=-units.mass / (self.mass + self.added_masses))

    def state(self, velocity: Any, angular_velocity: Any, units: Units = SI) -> State:
        """The impulse of a motion, P = (mass + added mass) U and M = (I + added moment) Omega, in `units`.

        U (..., 3) in m/s and Omega (..., 3) in rad/s along the body axes.  Raises `InputError`.
        """
        momentum = units.mass * units.length / units.time
        P = np.asarray(velocity) * (self.mass + self.added_masses) / momentum
        M = np.asarray(angular_velocity) * (self.moments + self.added_moments) / (momentum * units.length)
        return self.model(units).state(M=M, P=P)
