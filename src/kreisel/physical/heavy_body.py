"""Any rigid body on a fixed point in gravity, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, explained
from kreisel.physical.forced import Forced
from kreisel.physical.inertia import inertia_tensor, mass_tensor, require_thickness, steiner
from kreisel.physical.measures import (
    STANDARD_GRAVITY,
    attitude_quaternion,
    convert_fields,
    in_range,
    momentum_in_body,
    require_range,
    si_number,
    si_numbers,
)
from kreisel.record.model import Model, State
from kreisel.record.units import BodyFrame
from kreisel.record.values import CLOSE, require_body
from kreisel.system import REGISTRY

LEAST = 1e-12  # of the quaternion of the least rotation
PIVOT = "inertia not about the pivot: HeavyBody.about_centre adds m l^2"


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
        require_body(central + rounding, "about its centre of mass", PIVOT, rod=True)
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
