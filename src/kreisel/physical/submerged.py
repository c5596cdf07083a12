"""Bodies in a fluid, in SI units: an ellipsoid in an ideal fluid; any body deep in water, with buoyancy and drag."""

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
from kreisel.errors import InputError, doubt, explained, shown
from kreisel.files import place
from kreisel.physical.body import Forced, Varied
from kreisel.physical.measures import (
    STANDARD_GRAVITY,
    attitude_quaternion,
    convert_fields,
    in_range,
    inertia_tensor,
    require_range,
    si_number,
    si_numbers,
)
from kreisel.record.body import UPRIGHT, started
from kreisel.record.model import Model, State
from kreisel.record.units import BodyFrame
from kreisel.runs.geometry import orientation_of, require_of_body
from kreisel.runs.in_si import in_state_form
from kreisel.system import REGISTRY

if TYPE_CHECKING:
    import xarray as xr

SIX = ((6,), (6, 6))
HALVES = {"added_mass": ("kg", "kg m^2"), "linear_drag": ("N s/m", "N m s"), "quadratic_drag": ("N s^2/m^2", "N m s^2")}
NONE = (0.0, 0.0, 0.0)
GRAMS = 0.7, 1.1  # plain densities of a fluid that are likely to be g/cm^3; air has 1.2 kg/m^3
BUOYANT, FAR = 100, 10  # times the mass, and times the radius of gyration, beyond which a body is doubted
SLENDER = 4  # radii: a spheroid so long moves 0.70 of the displaced mass across (strip theory 1), 0.21 along (0)


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
        if self.displaced_mass > BUOYANT * self.mass:
            doubt(
                f"displaced_mass: expected at most {BUOYANT} times the mass, {self.mass:g} kg, got "
                f"{self.displaced_mass:g} kg: the body shoots up. Usual cause: g for kg, or mm for m."
            )
        apart = np.linalg.norm(self.center_of_mass - self.center_of_buoyancy)
        if apart > FAR * (gyration := math.sqrt(np.trace(self.inertia) / 2 / self.mass)):
            doubt(
                f"center_of_mass, center_of_buoyancy: expected centres at most {FAR} times the radius of gyration, "
                f"{gyration:.3g} m, apart, got {apart:.3g} m. Usual cause: mm for m, or centres from different points."
            )

    @classmethod
    def ellipsoid(cls, semi_axes: Any, mass: Any, fluid_density: Any, **options: Any) -> SubmergedBody:
        """An ellipsoid of constant density in a fluid, with its added masses.

        [Lamb, articles 114, 115]
        """
        rho = _density(fluid_density)
        body = Ellipsoid(si_numbers(semi_axes, "m", "semi_axes", ((3,),)), mass, rho)
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
        m, rho = si_number(mass, "kg", "mass", positive=True), _density(fluid_density)
        if L < SLENDER * r:
            doubt(f"length: expected at least {SLENDER} radii, for strip theory, got {L / r:.3g}. Use `ellipsoid`.")
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
            current=self.current,
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
        require_of_body(run, {"mass_matrix": self.mass_matrix, "current": self.current})
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
    try:
        return si_numbers(value, "1", name, shapes)
    except InputError as error:
        linear, angular = HALVES[name]
        matrix = ", or a 6 x 6 matrix of plain values in SI" * ((6, 6) in shapes)
        raise InputError(
            f"{name} must be six values, three for the velocity ({linear}) and three for the angular velocity "
            f"({angular}){matrix}, got {shown(value)}."
        ) from error


def _density(value: Any) -> float:
    """The density of a fluid, kg/m^3.  Raises `InputError`; warns with `InputWarning` of plain values as in g/cm^3."""
    rho = si_number(value, "kg/m^3", "fluid_density", least=0.0)
    if isinstance(value, int | float) and GRAMS[0] <= rho <= GRAMS[1]:
        doubt(
            f"fluid_density: expected kg/m^3, 1000 for water, got {rho:g}. Usual cause: g/cm^3. For a gas, write "
            f"'{rho:g} kg/m^3'."
        )
    return rho


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


def _cyclic(v: Any) -> tuple[Array, Array, Array]:
    """(v1, v2, v3), (v2, v3, v1) and (v3, v1, v2): a formula for the first axis then holds for all."""
    return np.asarray(v), np.roll(v, -1), np.roll(v, -2)
