"""Bodies on a fixed point in gravity, in SI units: the heavy symmetric top, any rigid body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained
from kreisel.physical.body import Forced
from kreisel.physical.measures import (
    STANDARD_GRAVITY,
    attitude_quaternion,
    convert_fields,
    finite_floats,
    in_range,
    inertia_tensor,
    mass_tensor,
    momentum_in_body,
    require_range,
    require_thickness,
    si_number,
    si_numbers,
    steiner,
)
from kreisel.record.model import Model, State
from kreisel.record.units import BodyFrame, stated_unit
from kreisel.record.values import CLOSE, require_body
from kreisel.system import REGISTRY

LEAST = 1e-12  # of the quaternion of the least rotation
NOT_ABOUT_PIVOT = "transverse_moment not about the pivot: add mass lever^2"
NO_STEINER = "inertia not about the pivot: HeavyBody.about_centre adds m l^2"


class Motion(NamedTuple):
    """Motion of a gyroscope in Euler's angles: angles in rad, rates in rad/s, each of shape (...)."""

    tilt: Array  # theta, from the upward vertical
    azimuth: Array  # phi, in [-pi, pi]
    spin: Array  # w3 = psi' + phi' cos(theta), the total axial angular velocity
    precession: Array  # phi'
    nutation: Array  # theta'


@explained
@dataclass(frozen=True, repr=False)
class Gyroscope(Forced):
    """Heavy symmetric top on a fixed point, in SI units.

    mass m, kg;  lever l, from the pivot to the centre of mass, m;  gravity g, m/s^2
    axial_moment        I3, about the axis of symmetry, kg m^2
    transverse_moment   I1, about a transverse axis through the ABOUT_PIVOT, kg m^2 (Steiner: I1 = I_c + m l^2)

    torque, potential, damping, params, control   user-defined forces (`Forced`); the third body axis is the axis of
                symmetry

    Scaled as `LagrangeTop`: time in sqrt(I1/(m g l)), momentum in sqrt(I1 m g l), |a| = |p| = 1, alpha = I3/I1.
    Raises `InputError` unless all are > 0 and I3 <= 2 I_c.  [Goldstein, Classical Mechanics, 3rd ed., section 5.7]
    """

    mass: float
    axial_moment: float
    transverse_moment: float
    lever: float
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        convert_fields(self, positive=True, mass="kg", lever="m", gravity="m/s^2")
        convert_fields(self, positive=True, axial_moment="kg m^2", transverse_moment="kg m^2")
        central = in_range("mass lever^2", lambda: self.transverse_moment - self.mass * self.lever**2)
        half = self.axial_moment / 2
        rounding = CLOSE * self.transverse_moment  # central is a difference
        require_body((half, half, central - half + rounding), "about its centre of mass", NOT_ABOUT_PIVOT)
        require_range(self, "alpha", "weight_torque", "time_unit", "momentum_unit", "sleeping_spin")

    @classmethod
    def flat(
        cls, mass: float, axial_moment: float, lever: float, gravity: float = STANDARD_GRAVITY, **forces: Any
    ) -> Gyroscope:
        """A flat wheel on a light axle: I1 = I3/2 + m l^2 (perpendicular axes, Steiner).  Raises `InputError`."""
        mass, lever = si_number(mass, "kg", "mass", positive=True), si_number(lever, "m", "lever", positive=True)
        axial_moment = si_number(axial_moment, "kg m^2", "axial_moment", positive=True)
        transverse = in_range("mass lever^2", lambda: axial_moment / 2 + mass * lever**2)
        return cls(mass, axial_moment, transverse, lever, gravity, **forces)

    @property
    def alpha(self) -> float:
        """I3/I1, the parameter of `LagrangeTop`."""
        return self.axial_moment / self.transverse_moment

    @property
    def weight_torque(self) -> float:
        """m g l, the largest torque of gravity, N m."""
        return self.mass * self.gravity * self.lever

    @property
    def time_unit(self) -> float:
        """sqrt(I1/(m g l)), s; in an ensemble the value of lane 0."""
        return self._time or math.sqrt(self.transverse_moment / self.weight_torque)

    @property
    def momentum_unit(self) -> float:
        """sqrt(I1 m g l), kg m^2/s; in an ensemble I1 over the unit of time."""
        return self.transverse_moment / self.time_unit

    def model(self) -> Model:
        """The scaled system: `LagrangeTop(p=(0, 0, 1), alpha=I3/I1)`."""
        weight = self.weight_torque * self._time**2 / self.transverse_moment if self._time else 1.0
        frame = BodyFrame.in_units(self.time_unit, self.momentum_unit, letter="m")
        return self.forced(REGISTRY["lagrange-top"](p=(0.0, 0.0, weight), alpha=self.alpha).of_body(frame))

    def state(self, tilt: Any, spin: Any, precession: Any = 0.0, nutation: Any = 0.0) -> State:
        """The scaled state at azimuth 0: a = (sin theta, 0, cos theta), m = I1 a x a' + I3 w3 a.

        Tilt theta in rad from the upward vertical; spin w3 (the total axial angular velocity), precession
        phi' and nutation theta' in rad/s: with neither, the axis is released from rest.  A list has a value for each
        lane of an ensemble.  Raises `InputError`.
        """
        rates = {"spin": (spin, "rad/s"), "precession": (precession, "rad/s"), "nutation": (nutation, "rad/s")}
        theta, w, turn, nod = _lanes(tilt=(tilt, "rad"), **rates)
        sin, cos = np.sin(theta), np.cos(theta)
        a, swing = np.stack([sin, 0 * sin, cos], -1), np.stack([-turn * sin * cos, nod, turn * sin**2], -1)
        m = in_range("The momentum", lambda: self.time_unit * (swing + self.alpha * w[..., None] * a))
        return self._started(_tilted(theta), M=m, a=a)

    @staticmethod
    def orientation(tilt: Any) -> Array:  # type: ignore[override]  # by its tilt
        """The unit quaternion (w, x, y, z) that maps the third body axis to the `a` of `state(tilt, ...)`."""
        return _tilted(_lanes(tilt=(tilt, "rad"))[0])

    def motion(self, m: Any, a: Any) -> Motion:
        """The inverse of `state`, from m (..., 3) axial and a (..., 3); precession of a vertical axis is NaN.

        An array is read as m of a state; a variable states its units.
        """
        m = si_numbers(m, "kg m^2/s", "m") / (self.momentum_unit if stated_unit(m) else 1.0)
        a = si_numbers(a, "1", "a")
        try:
            m, a = np.broadcast_arrays(m, a)
        except ValueError:
            raise InputError(f"m and a: expected shapes that fit, got {m.shape} and {a.shape}.") from None
        with np.errstate(all="ignore"):
            x, y, z = np.moveaxis(a, -1, 0)
            dx, dy, dz = np.moveaxis(np.cross(m, a), -1, 0) / self.time_unit  # a' = m x a
            rho = np.where((x == 0) & (y == 0), np.nan, np.hypot(x, y))
            spin = np.sum(m * a, axis=-1) / (self.alpha * self.time_unit)
            turn, nod = (x * dy - y * dx) / rho**2, -dz / rho
            return Motion(np.arctan2(np.hypot(x, y), z), np.arctan2(y, x), spin, turn, nod)

    def slow_precession(self, spin: Any) -> Any:
        """The textbook rate of a fast top, m g l/(I3 w3), rad/s, of each lane.  Raises `InputError` for no spin."""
        (spin,) = _lanes(spin=(spin, "rad/s"))
        si_number(abs(spin).min(), "rad/s", "|spin|", positive=True)
        return _plain(in_range("The precession", lambda: self.weight_torque / (self.axial_moment * spin)))

    def steady_precession(self, tilt: Any, spin: Any) -> tuple[Any, Any]:
        """The slow and the fast root W of I1 cos(theta) W^2 - I3 w3 W + m g l = 0, rad/s, of each lane.

        Free of cancellation: W = 2 m g l/q and q/(2 I1 cos(theta)), where q = I3 w3 +- sqrt(discriminant) with
        the sign of w3; the fast root of a horizontal axis is at infinity.  Raises `InputError` for no real root.
        """
        tilt, spin = _lanes(tilt=(tilt, "rad"), spin=(spin, "rad/s"))
        momentum, rise = self.axial_moment * spin, self.transverse_moment * np.cos(tilt)
        discriminant = in_range("(I3 w3)^2", lambda: momentum**2 - 4 * rise * self.weight_torque)
        q = momentum + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), momentum)
        if (wrong := (discriminant < 0) | (q == 0)).any():
            theta, w, up = (np.extract(wrong, x)[0] for x in (tilt, spin, np.maximum(rise, 0)))
            raise InputError(
                f"No steady precession at tilt = {theta:.6g} rad with spin = {w:.6g} rad/s: |spin| must be at least "
                f"{2 * math.sqrt(up * self.weight_torque) / self.axial_moment:.6g} rad/s, and not 0."
            )
        with np.errstate(divide="ignore"):
            fast = np.where(rise == 0, np.copysign(np.inf, q), q / (2 * rise))
        return _plain(2 * self.weight_torque / q), _plain(fast)

    def nutation_rate(self, spin: Any) -> Any:
        """The nutation frequency of a fast top, I3 w3/I1, rad/s, of each lane."""
        (spin,) = _lanes(spin=(spin, "rad/s"))
        return _plain(in_range("The nutation", lambda: self.alpha * spin))

    @property
    def sleeping_spin(self) -> float:
        """The upright top is stable (it sleeps) above this spin, 2 sqrt(I1 m g l)/I3, rad/s."""
        return 2 * math.sqrt(self.transverse_moment * self.weight_torque) / self.axial_moment


@explained
@dataclass(frozen=True, eq=False, repr=False)
class HeavyBody(Forced):
    """Any rigid body on a fixed point in gravity, in SI units.

    mass, kg;  arm (3,), from the pivot to the centre of mass in the body, m;  gravity g, m/s^2
    inertia     classical inertia tensor I about the PIVOT, (3, 3), or its diagonal (3,), kg m^2

    torque, potential, damping, params, control   user-defined forces (`Forced`); a run then has M and P along principal
                axes

    Scaled as `HeavyTop`: J = (tr(I)/2 - I)/I0 with I0 = tr(I)/3, A = arm/|arm|, |P| = 1, time in sqrt(I0/(m g l)),
    momentum in sqrt(I0 m g l), l = |arm|; without torque (arm = 0 or g = 0) time in s and A = 0.  For a symmetric body
    `Gyroscope` is the better choice: its default method conserves every integral.  Raises `InputError` for moments that
    are impossible for a body.  [Goldstein, Classical Mechanics, 3rd ed., chapter 5]
    """

    mass: float
    inertia: Any
    arm: Any
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        convert_fields(self, positive=True, mass="kg")
        convert_fields(self, gravity="m/s^2")
        if self.gravity < 0:
            raise InputError(f"gravity must not be negative: it points down, along -e3, got {self.gravity!r}.")
        object.__setattr__(self, "inertia", inertia_tensor(self.inertia))
        convert_fields(self, shapes=((3,),), arm="m")
        central = np.linalg.eigvalsh(mass_tensor(self.inertia - steiner(self.mass, self.arm)))
        rounding = CLOSE * np.trace(self.inertia)  # of a difference, 0 for a point on a light rod
        require_body(central + rounding, "about its centre of mass", NO_STEINER, rod=True)
        require_thickness(self.inertia)
        require_range(self, "weight_torque", "time_unit", "momentum_unit")

    @classmethod
    def about_centre(
        cls, mass: float, inertia: Any, arm: Any, gravity: float = STANDARD_GRAVITY, **forces: Any
    ) -> HeavyBody:
        """The body from the inertia tensor about the centre of mass: I + m (|l|^2 - l l^T) (Steiner)."""
        mass, arm = si_number(mass, "kg", "mass", positive=True), si_numbers(arm, "m", "arm", ((3,),))
        return cls(mass, inertia_tensor(inertia) + steiner(mass, arm), arm, gravity, **forces)

    @property
    def mass_tensor(self) -> Array:
        """J = sum m x x^T = tr(I)/2 - I, (3, 3), kg m^2."""
        return mass_tensor(self.inertia)

    @property
    def unit_moment(self) -> float:
        """I0 = tr(I)/3, kg m^2."""
        return float(np.trace(self.inertia)) / 3

    @property
    def weight_torque(self) -> float:
        """m g l, the largest torque of gravity, N m."""
        return float(self.mass * self.gravity * np.linalg.norm(self.arm))

    @property
    def time_unit(self) -> float:
        """sqrt(I0/(m g l)), or 1, s; in an ensemble the value of lane 0."""
        if self._time:
            return self._time
        return math.sqrt(self.unit_moment / self.weight_torque) if self.weight_torque else 1.0

    @property
    def momentum_unit(self) -> float:
        """sqrt(I0 m g l), or I0/s, kg m^2/s."""
        return self.unit_moment / self.time_unit

    def model(self) -> Model:
        """The scaled system: `HeavyTop(J, A)`."""
        turn, J = self._turn, self.mass_tensor / self.unit_moment
        A = self.arm / np.linalg.norm(self.arm) if self.weight_torque else np.zeros(3)
        A = A * self.weight_torque * self._time**2 / self.unit_moment if self._time else A
        frame = BodyFrame.in_units(self.time_unit, self.momentum_unit, turn)
        return self.forced(REGISTRY["heavy-top"](J=turn.T @ J @ turn, A=A @ turn).of_body(frame))

    @property
    def _turn(self) -> Array:
        """The axes of the state as columns: the principal axes if there are user-defined forces."""
        return algebra.principal_axes(self.inertia)[1] if self.forced_by else np.eye(3)

    def state(self, angular_velocity: Any, up: Any = None, attitude: Any = None) -> State:
        """The scaled state M = I Omega, P = up/|up|.

        Omega (..., 3) in rad/s and the upward vertical `up` (..., 3), both along the body axes: for a body rotated by
        the matrix g (body to space), up = g[2].  Instead of `up` the attitude g, a unit quaternion (..., 4) = (w, x, y,
        z); with neither the third axis is up.  A run begins with this attitude, or with the least rotation for `up`.
        Raises `InputError`.
        """
        if up is not None and attitude is not None:
            raise InputError("up: expected up or attitude, got both; the attitude determines the upward vertical.")
        if attitude is not None:
            attitude = attitude_quaternion(attitude, "attitude")
            up = algebra.rotation_matrix(attitude)[..., 2, :]
        up = (0.0, 0.0, 1.0) if up is None else up
        Omega = si_numbers(angular_velocity, "rad/s", "angular_velocity")
        up = si_numbers(up, "1", "up")
        length = in_range("The length of up", lambda: np.linalg.norm(up, axis=-1, keepdims=True))
        if (length == 0).any():
            raise InputError("up must not be the zero vector: it is the upward vertical along the body axes.")
        M = in_range("The momentum", lambda: Omega @ self.inertia @ self._turn / self.momentum_unit)
        up = up / length
        q, turn = _least(up) if attitude is None else attitude, algebra.unit_quaternion(self._turn)
        return self._started(algebra.quaternion_product(q, turn), M=M, P=up @ self._turn)

    def angular_velocity(self, M: Any) -> Array:
        """The inverse of `state`: Omega (..., 3) in rad/s along the body axes, from M (..., 3) axial.

        An array is read as M of a state of this body; the variable M of a run states its units.  Raises `InputError`,
        also if a moment of inertia is 0.
        """
        momentum = momentum_in_body(M, BodyFrame.in_units(self.time_unit, self.momentum_unit, self._turn))[..., None]
        try:
            return in_range("Omega", lambda: np.linalg.solve(self.inertia, momentum)[..., 0])
        except np.linalg.LinAlgError:
            raise InputError(
                "The angular velocity is not determined by the momentum: expected three moments > 0, got one of 0."
            ) from None


def _least(up: Array) -> Array:
    """The least rotations (..., 4) that map unit vectors in the body to (0, 0, 1); about the first axis from below."""
    x, y, z = np.moveaxis(up, -1, 0)
    q = np.stack([1 + z, y, -x, 0 * z], -1)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(length > LEAST, q / np.maximum(length, LEAST), (0.0, 1.0, 0.0, 0.0))


def _lanes(**values: tuple[Any, str]) -> tuple[Array, ...]:
    """Finite values in SI, or values for each lane (lanes,), of one shape.  Raises `InputError`."""
    arrays = [finite_floats(value, unit, name) for name, (value, unit) in values.items()]
    for i, (name, (value, unit)) in enumerate(values.items()):
        if arrays[i].ndim != 1 or not arrays[i].size:
            arrays[i] = np.array(si_number(value, unit, name))
    try:
        return np.broadcast_arrays(*arrays)
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise InputError(f"{', '.join(values)}: expected lanes that fit, got {shapes}.") from None


def _tilted(theta: Array) -> Array:
    """Quaternions of the rotation by theta, rad, about the second axis."""
    half = theta / 2
    return np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], -1)


def _plain(x: Any) -> Any:
    return x if np.ndim(x) else float(x)
