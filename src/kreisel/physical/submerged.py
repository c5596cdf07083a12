"""Bodies deep in water, with the mass of body and water, weight, buoyancy and drag, in SI units."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.bodies import BODIES
from kreisel.errors import InputError, explained, shown
from kreisel.files import place
from kreisel.physical.ellipsoid import Ellipsoid
from kreisel.physical.forced import Forced
from kreisel.physical.inertia import inertia_tensor
from kreisel.physical.measures import (
    STANDARD_GRAVITY,
    attitude_quaternion,
    convert_fields,
    in_range,
    si_number,
    si_numbers,
)
from kreisel.record.body import UPRIGHT
from kreisel.record.model import Model, State
from kreisel.runs.geometry import orientation_of, require_of_body
from kreisel.runs.in_si import in_state_form

if TYPE_CHECKING:
    import xarray as xr

SIX = ((6,), (6, 6))
HALVES = {"added_mass": ("kg", "kg m^2"), "linear_drag": ("N s/m", "N m s"), "quadratic_drag": ("N s^2/m^2", "N m s^2")}
NONE = (0.0, 0.0, 0.0)


class Course(NamedTuple):
    """Position of O in space, m; its velocity and the angular velocity along the body axes, SI."""

    position: Array
    velocity: Array
    angular_velocity: Array


@explained
@dataclass(frozen=True, eq=False, repr=False)
class SubmergedBody(Forced):
    """A rigid body deep in a fluid: a run of it is in SI units.

    mass           kg;  inertia about the centre of mass, kg m^2, (3, 3) in any body axes or its diagonal
    added_mass     (6, 6) of the velocity of O and the angular velocity, or its diagonal: kg, kg m, kg m^2
    displaced_mass kg of fluid displaced; default: the mass, so that the body floats
    center_of_mass, center_of_buoyancy   (3,), m, from O along the body axes
    linear_drag    (6,), N s/m and N m s;  quadratic_drag (6,), N s^2/m^2 and N m s^2: -(l + q |v|) v of each
    current        (3,), m/s, the uniform velocity of the fluid in space, whose third axis points up
    gravity        m/s^2
    torque, potential, damping, params, control   user-defined forces of Omega, g, t (`Forced`)

    Nothing bounds the added mass by the mass: the matrices are inverted together.  The equations:
    `kreisel.bodies.submerged`.  Raises `InputError` for impossible matrices.
    """

    mass: float
    inertia: Any
    added_mass: Any = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    displaced_mass: Any = None
    center_of_mass: Any = NONE
    center_of_buoyancy: Any = NONE
    linear_drag: Any = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    quadratic_drag: Any = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    current: Any = NONE
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        convert_fields(self, positive=True, mass="kg")
        if self.displaced_mass is None:
            object.__setattr__(self, "displaced_mass", self.mass)
        convert_fields(self, least=0.0, gravity="m/s^2", displaced_mass="kg")
        object.__setattr__(self, "inertia", inertia_tensor(self.inertia))
        convert_fields(self, shapes=((3,),), center_of_mass="m", center_of_buoyancy="m", current="m/s")
        for name, shapes in (("added_mass", SIX), ("linear_drag", SIX[:1]), ("quadratic_drag", SIX[:1])):
            object.__setattr__(self, name, _six(getattr(self, name), name, shapes))
        if self.added_mass.ndim == 1:
            object.__setattr__(self, "added_mass", np.diag(self.added_mass))
        self.model()

    @classmethod
    def ellipsoid(cls, semi_axes: Any, mass: Any, fluid_density: Any, **options: Any) -> SubmergedBody:
        """An ellipsoid of constant density in a fluid, with its added masses.

        [Lamb, articles 114, 115]
        """
        body = Ellipsoid(si_numbers(semi_axes, "m", "semi_axes", ((3,),)), mass, fluid_density)
        added = (*body.added_masses, *body.added_moments)
        arguments = {"added_mass": added, "displaced_mass": body.displaced_mass, **options}
        return cls(body.mass, body.moments, **arguments).shaped("ellipsoid", body.semi_axes)

    @classmethod
    def cylinder(cls, radius: Any, length: Any, mass: Any, fluid_density: Any, **options: Any) -> SubmergedBody:
        """A slender round cylinder of constant density along the first axis, with the added masses of strip theory.

        pi rho r^2 L across it, its cube of L over 12 about the axes across, none along.  [Newman, Marine Hydrodynamics,
        1977, sections 4.13 and 7.2]
        """
        r, L = (si_number(v, "m", k, positive=True) for v, k in ((radius, "radius"), (length, "length")))
        m, rho = si_number(mass, "kg", "mass", positive=True), si_number(fluid_density, "kg/m^3", "fluid_density")
        fluid = np.pi * rho * r * r * L
        across = m * (3 * r * r + L * L) / 12
        added = (0.0, fluid, fluid, 0.0, fluid * L * L / 12, fluid * L * L / 12)
        arguments = {"added_mass": added, "displaced_mass": fluid, **options}
        return cls(m, (m * r * r / 2, across, across), **arguments).shaped("cylinder", (L / 2, r, r))

    @cached_property
    def mass_matrix(self) -> Array:
        """The 6 x 6 matrix of mass and added mass about O, of (U, Omega), SI."""
        S = algebra.hat(self.center_of_mass)
        rigid = np.block([[self.mass * np.eye(3), -self.mass * S], [self.mass * S, self.inertia - self.mass * S @ S]])
        return np.asarray(rigid + self.added_mass)

    def model(self) -> Model:
        """The system "submerged-body" with these parameters."""
        model = BODIES["submerged-body"](
            mass_matrix=self.mass_matrix,
            weight=self.mass * self.gravity,
            buoyancy=self.displaced_mass * self.gravity,
            center_of_mass=self.center_of_mass,
            center_of_buoyancy=self.center_of_buoyancy,
            linear_drag=self.linear_drag,
            quadratic_drag=self.quadratic_drag,
        )
        return self.forced(model, ("Omega", "g", "t"))

    @cached_property
    def _place(self) -> tuple[Array, Array]:
        """The axes of the state as columns, and its point from O, in the body."""
        constants = self.model().constants
        return constants["turn"], constants["shift"]

    @property
    def reference(self) -> Array:
        """The point of the body to which the angular momentum of a run refers, (3,), m, from O along the body axes.

        There the rates depend on the momenta by a symmetric matrix: `kreisel.bodies.submerged`.
        """
        return self._place[1]

    def state(self, velocity: Any = NONE, angular_velocity: Any = NONE, attitude: Any = UPRIGHT) -> State:
        """The momenta of a motion: the velocity of O, m/s, and the angular velocity, rad/s, (..., 3), in body axes.

        attitude: a unit quaternion (4,), which gives the direction of the current in the body.
        """
        U, Omega = si_numbers(velocity, "m/s", "velocity"), si_numbers(angular_velocity, "rad/s", "angular_velocity")
        current = self.current @ algebra.rotation_matrix(attitude_quaternion(attitude, "attitude"))
        nu = np.concatenate(np.broadcast_arrays(U - current, Omega), -1)
        momenta, (turn, shift) = nu @ self.mass_matrix, self._place
        P, M = momenta[..., :3], momenta[..., 3:]
        return self._started(self.orientation(attitude), M=(M - np.cross(shift, P)) @ turn, P=P @ turn)

    def course(self, run: xr.Dataset, start: Any = NONE) -> Course:
        """The position of O in space at each row of a run, from `start`, and its motion."""
        from kreisel.analysis import path  # xarray and tables, which a run does not need

        run, (turn, shift) = in_state_form(run), self._place
        g = algebra.rotation_matrix(orientation_of(run)) @ turn.T  # of the body axes
        require_of_body(run, {"mass_matrix": self.mass_matrix})
        arm = algebra.act(g, shift)
        time = np.asarray(run.time).reshape(-1, *[1] * (arm.ndim - 1))
        places = path(run, self.model() if self.forced_by else None).values
        x = places - (arm - arm[0]) + self.current * (time - time[0])
        P = np.asarray(run.P) @ turn.T
        M = np.asarray(run.M) @ turn.T + np.cross(shift, P)
        nu = np.linalg.solve(self.mass_matrix, np.concatenate([P, M], -1)[..., None])[..., 0]
        inside = algebra.act(g.mT, self.current + 0 * x)
        return Course(x + si_numbers(start, "m", "start"), nu[..., :3] + inside, nu[..., 3:])


def _six(value: Any, name: str, shapes: tuple[tuple[int, ...], ...]) -> Array:
    """Floats in SI, or three quantities of the velocity and three of the angular velocity.  Raises `InputError`."""
    if isinstance(value, list | tuple) and len(value) == 6 and not any(isinstance(v, list | tuple) for v in value):
        halves = zip((value[:3], value[3:]), HALVES[name], strict=True)
        return np.concatenate([si_numbers(half, unit, name, ((3,),)) for half, unit in halves])
    return si_numbers(value, "1", name, shapes)


def _finite(word: str) -> float:
    """A float in the notation of C or Fortran.  Raises `ValueError`."""
    value = float(word.replace("D", "E"))
    if not math.isfinite(value):
        raise ValueError(f"not a finite number: {word!r}")
    return value


@explained
def read_added_mass(path: str | os.PathLike[str], density: Any = 1.0, length: Any = 1.0, period: float = 0.0) -> Array:
    """A 6 x 6 matrix of added mass from a text file, in SI: six rows of six values, or WAMIT's numeric output.

    density, length   kg/m^3, m: units rho L^k of the dimensionless rows PERIOD I J A of WAMIT (.1), k = 3 for two
                      velocities, 4 for one of each, 5 for two angular velocities; a plain matrix is in SI
    period            of the rows to read: 0 is WAMIT's limit of short waves, a negative value its limit of long waves

    Raises `InputError` for any other file.
    """
    source = place(path, "read_added_mass needs the name of a text file")
    try:
        rows = [line.split() for line in source.read_text(encoding="utf-8").splitlines()]
        rows = [row for row in rows if row and row[0][0] not in "#%!"]
        numbers = [[_finite(v) for v in row] for row in rows]
    except (OSError, ValueError) as error:
        raise InputError(f"{source}: expected a text file of values, got {error}.") from None
    if [len(row) for row in numbers] == [6] * 6:
        return np.array(numbers)
    rho, L = si_number(density, "kg/m^3", "density"), si_number(length, "m", "length", positive=True)
    units = in_range("density x length^k", lambda: tuple(rho * L**k for k in (3, 4, 5)))
    out = np.full((6, 6), np.nan)
    for row in numbers:
        if len(row) < 4 or row[1] not in range(1, 7) or row[2] not in range(1, 7):
            raise InputError(
                f"{source}: expected six rows of six values, or rows PERIOD I J A with I and J from 1 to 6, got "
                f"{shown(row)}."
            )
        if row[0] == period or (period < 0 and row[0] < 0):
            i, j = int(row[1]) - 1, int(row[2]) - 1
            out[i, j] = row[3] * units[(i > 2) + (j > 2)]
    if np.isnan(out).all():
        raise InputError(f"{source}: expected rows of the period {period:g}, got none.")
    return np.nan_to_num(out)  # WAMIT leaves out entries that vanish by symmetry
