"""The free rigid body, in SI units."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array, dot, vec
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, shown
from kreisel.physical.forced import Forced
from kreisel.physical.free_rotation import FreeRotation, Periods, periods_of
from kreisel.physical.inertia import Principal, inertia_tensor, principal, require_thickness
from kreisel.physical.measures import convert_fields, direction, in_range, momentum_in_body, si_number, si_numbers
from kreisel.physical.shapes import read_mesh
from kreisel.record.body import UPRIGHT
from kreisel.record.model import Model, State
from kreisel.record.units import BodyFrame
from kreisel.record.values import CLOSE
from kreisel.system import REGISTRY

NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # arrays, for JAX


class AxisStability(NamedTuple):
    """The effect of a small disturbance on the rotation about a principal axis."""

    axis: Array  # (3,), along the body axes
    moment: float  # kg m^2
    kind: str  # "stable", "unstable", or "neutral": its moment equals another axis's
    growth: float  # rad/s: the disturbance grows as exp(growth t); 0 unless unstable
    period: float  # s, of the disturbance in the body; inf unless stable


@explained
@dataclass(frozen=True, eq=False, repr=False)
class FreeBody(Forced):
    """A rigid body without torque, or under user-defined forces (`Forced`), in SI units.

    inertia     classical inertia tensor I about the centre of mass, (3, 3) in any body axes, or its diagonal, kg m^2
    mass        kg, not needed for the rotation
    time_unit   the unit of time of the scaled system, s

    Scaled as `EulerTop` in the principal axes: J = (I_j + I_k - I_i)/(2 I0) with I0 = tr(I)/3, time in `time_unit`,
    momentum in I0/time_unit.  A spin is a vector along the body axes, or a rate and an axis: ("300 rpm", (0, 0, 1)).
    Raises `InputError` for impossible moments of inertia.  [Landau, Lifshitz, Mechanics, section 37]
    """

    inertia: Any
    mass: float | None = None
    time_unit: float = 1.0

    def __post_init__(self) -> None:
        if self.mass is not None:
            convert_fields(self, positive=True, mass="kg")
        convert_fields(self, positive=True, time_unit="s")
        object.__setattr__(self, "inertia", inertia_tensor(self.inertia))
        require_thickness(self.inertia)
        for name in ("momentum_unit", "energy_unit"):
            si_number(in_range(name, lambda name=name: getattr(self, name)), "J", name, positive=True)  # type: ignore[misc]

    @classmethod
    def box(cls, mass: float, sides: Any, time_unit: float = 1.0, **forces: Any) -> FreeBody:
        """A homogeneous box with these sides, m.  Raises `InputError`."""
        lengths = si_numbers(sides, "m", "sides", ((3,),))
        return cls(*_homogeneous(mass, lengths, 12.0), time_unit, **forces).shaped("box", lengths / 2)

    @classmethod
    def ellipsoid(cls, mass: float, diameters: Any, time_unit: float = 1.0, **forces: Any) -> FreeBody:
        """A homogeneous ellipsoid with these principal diameters, m.  Raises `InputError`."""
        lengths = si_numbers(diameters, "m", "diameters", ((3,),))
        return cls(*_homogeneous(mass, lengths, 20.0), time_unit, **forces).shaped("ellipsoid", lengths / 2)

    @classmethod
    def from_mesh(
        cls,
        mesh: str | os.PathLike[str],
        length: Any = None,
        density: Any = None,
        mass: Any = None,
        time_unit: float = 1.0,
        **forces: Any,
    ) -> FreeBody:
        """The homogeneous body of a mesh file, with coordinates in `length` ("mm"), by its density or mass.

        See `read_mesh`, whose result other bodies accept too.  Raises `InputError`.
        """
        solid = read_mesh(mesh, length, density, mass)
        return cls(solid.inertia, solid.mass, time_unit, **forces)

    @cached_property
    def principal(self) -> Principal:
        """The principal moments, kg m^2, and axes: columns in body axes.  A diagonal tensor keeps its order."""
        return principal(self.inertia)

    @property
    def unit_moment(self) -> float:
        """I0 = tr(I)/3, kg m^2."""
        return float(np.trace(self.inertia)) / 3

    @property
    def momentum_unit(self) -> float:
        """I0/time_unit, kg m^2/s."""
        return self.unit_moment / self.time_unit

    @property
    def energy_unit(self) -> float:
        """I0/time_unit^2, J."""
        return self.momentum_unit / self.time_unit

    def model(self) -> Model:
        """The scaled system `EulerTop(J)`, in principal axes; a flat body, J_i = 0, moves by method="exact"."""
        J = _mass_moments(self.principal.moments, self.unit_moment)
        J[abs(J) < CLOSE] = 0
        frame = BodyFrame.in_units(self.time_unit, self.momentum_unit, self.principal.axes)
        return self.forced(REGISTRY["euler-top"](J=J).of_body(frame))

    @property
    def parameters_in_si(self) -> dict[str, Any]:
        """The principal moments, kg m^2, which determine J."""
        return {"moments": self.principal.moments}

    def _scaled(self, parameters: dict[str, Any]) -> dict[str, Any]:
        """J for the principal moments."""
        if wrong := parameters.keys() & {"J", "inertia"}:
            raise InputError(
                f"{', '.join(sorted(wrong))}: expected moments=..., its principal moments, kg m^2. Usual "
                "cause: J of the scaled system, which is in units of a third of the trace of the inertia tensor."
            )
        moments = parameters.get("moments")
        if moments is None:
            return parameters
        moments = moments if hasattr(moments, "shape") else np.array(moments, dtype=float)
        if moments.shape != (3,):
            raise InputError(f"moments: expected three principal moments, kg m^2, got {moments.shape}.")
        others = {name: value for name, value in parameters.items() if name != "moments"}
        return {**others, "J": _mass_moments(moments, self.unit_moment)}

    def state(self, spin: Any, axis: Any = None, attitude: Any = UPRIGHT) -> State:
        """The scaled state M = I Omega, in principal axes.

        Spin Omega (..., 3) in rad/s along the body axes; or a rate, with `axis` (3,) in the body.  The attitude of the
        body axes is that with which a run of the body begins.  Raises `InputError`.
        """
        Omega = angular_velocity_of(spin, axis)
        M = in_range("The momentum", lambda: Omega @ self.inertia @ self.principal.axes / self.momentum_unit)
        return self._started(self.orientation(attitude), M=M)

    def angular_velocity(self, M: Any) -> Array:
        """The inverse of `state`: Omega (..., 3) in rad/s along the body axes, from M (..., 3) axial.

        An array is read as M of a state of this body; the variable M of a run states its units and axes.  Raises
        `InputError`.
        """
        moments, axes = self.principal
        momentum = momentum_in_body(M, self._body_frame)
        return in_range("Omega", lambda: momentum @ axes / moments @ axes.T)

    def rotation(self, spin: Any, axis: Any = None) -> FreeRotation:
        """The motion that begins with this spin, in closed form: periods, precession, polhode.  Raises `InputError`."""
        Omega = angular_velocity_of(spin, axis)
        if Omega.shape != (3,) or not Omega.any():
            raise InputError(
                f"spin: expected one angular velocity that is not zero, got {shown(spin)}. Usual cause: several at a "
                "time; pass them one by one."
            )
        in_range("The square of the spin", lambda: 1 / (Omega @ Omega))
        motion = FreeRotation(self.inertia, self.principal, Omega)
        in_range("The precession", lambda: motion.precession)
        return motion

    def periods(self, spin: Any, axis: Any = None) -> Periods:
        """Both periods of motions that begin with the spins (..., 3), in doubles, for three different moments.

        NaN for steady rotations; near the separatrix digits are lost, which `rotation` keeps.  Raises `InputError`.
        """
        Omega = angular_velocity_of(spin, axis) @ self.principal.axes
        order = np.argsort(self.principal.moments)
        I = self.principal.moments[order]  # noqa: E741
        if not I[0] < I[1] < I[2]:
            raise InputError(f"periods: expected three different moments, got {I.tolist()}. rotation(spin) has both.")
        with np.errstate(all="ignore"):
            M = Omega[..., order] * I
            L = np.sqrt(dot(M, M))
            N = M / vec(L)
            short = N[..., 2] ** 2 * I[0] * (I[2] - I[1]) > N[..., 0] ** 2 * I[2] * (I[1] - I[0])
            N = np.where(short[..., None], N, N[..., ::-1])
            I = np.where(short[..., None], I, I[::-1])  # noqa: E741
            I1, I2, I3 = (I[..., i] for i in range(3))
            E = (1 - I1 / I2) * N[..., 1] ** 2 + (1 - I1 / I3) * N[..., 2] ** 2
            gap = (1 - I2 / I1) * N[..., 0] ** 2 + (1 - I2 / I3) * N[..., 2] ** 2
            period, rate = periods_of(I, E, (I3 - I1) * gap / ((I3 - I2) * E))
        tumbling = (N[..., :2] ** 2).sum(-1) > 0
        return Periods(
            np.where(tumbling, period / L, np.nan), np.where(tumbling, 2 * np.pi / (rate * L), np.nan), short
        )

    def stability(self, spin: float) -> tuple[AxisStability, ...]:
        """The rotation at this rate, rad/s, about each principal axis, in the order of `principal`.

        About the axis 1 a disturbance goes as exp(s t), s^2 = spin^2 (I1 - I2)(I3 - I1)/(I2 I3).  Raises `InputError`.
        """
        rate = abs(si_number(spin, "rad/s", "spin"))
        moments, axes = self.principal
        in_range("The growth", lambda: rate * moments.max() / moments.min())
        result = []
        for i in range(3):
            a, b, c = moments[[i, (i + 1) % 3, (i + 2) % 3]]
            square = (a / b - 1) * (1 - a / c)
            s = rate * math.sqrt(abs(square))
            kind = "neutral" if square == 0 else "unstable" if square > 0 else "stable"
            period = 2 * math.pi / s if kind == "stable" and s else math.inf
            result.append(AxisStability(axes[:, i].copy(), float(a), kind, s if kind == "unstable" else 0.0, period))
        return tuple(result)


def _mass_moments(moments: Any, unit: float) -> Any:
    """J of `EulerTop` for principal moments (..., 3), in `unit`, kg m^2; of NumPy or JAX."""
    return (moments[..., NEXT] + moments[..., LAST] - moments) / (2 * unit)


def angular_velocity_of(spin: Any, axis: Any) -> Array:
    """(..., 3) in rad/s along the body axes, from a vector, or from a rate and an axis.  Raises `InputError`."""
    if axis is not None:
        return si_number(spin, "rad/s", "spin") * direction(axis, "axis")
    if hasattr(spin, "data_vars"):
        raise InputError(
            "spin: expected an angular velocity, got a Dataset. With row = run.isel(time=-1), pass "
            "spin=row.angular_velocity, attitude=row.attitude, or begin a run of this body at the row."
        )
    if isinstance(spin, str) or (not isinstance(spin, list | tuple) and np.ndim(spin) == 0):
        raise InputError(
            f"spin: expected three components along the body axes, got {shown(spin)}. Usual cause: a rate without its "
            "axis; say axis=(0, 0, 1)."
        )
    return si_numbers(spin, "rad/s", "spin")


def _homogeneous(mass: Any, sizes: Array, divisor: float) -> tuple[Array, float]:
    """Moments I_1 = mass (b^2 + c^2)/divisor, and the mass."""
    mass = si_number(mass, "kg", "mass", positive=True)
    if sizes.min() < 0:
        raise InputError(f"expected lengths of at least 0, got {shown(sizes.tolist())}.")
    squares = in_range("The moments", lambda: mass * sizes**2 / divisor)
    return squares.sum() - squares, mass
