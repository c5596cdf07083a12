"""Satellites and moons on a Kepler orbit, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from dataclasses import field as stored
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.bodies import BODIES, satellite
from kreisel.errors import InputError, explained, shown
from kreisel.forces.body import MOTION, PLACE
from kreisel.physical import environment as earth
from kreisel.physical.body import Forced, by_functions
from kreisel.physical.free_body import FreeBody, angular_velocity_of
from kreisel.physical.measures import (
    attitude_quaternion,
    convert_fields,
    direction,
    in_range,
    inertia_tensor,
    si_number,
    si_numbers,
)
from kreisel.physical.orbit import ASTRONOMICAL_UNIT, SATURN, SUN, Orbit
from kreisel.record.model import Model, State
from kreisel.record.units import BodyFrame
from kreisel.runs.geometry import Angles, angles_of, axes_of_angles, environment_of, orientation_of, require_of_body

if TYPE_CHECKING:
    import xarray as xr

SOLAR_PRESSURE = 1361.0 / 299_792_458.0  # N/m^2 on an absorbing surface at 1 au: flux (IAU 2015 B3) over speed of light


@explained
class Plate(NamedTuple):
    """A flat plate: outward normal and centre along the body axes, from the centre of mass, m; area, m^2."""

    normal: Any
    centre: Any
    area: Any


@explained
class Harmonics(NamedTuple):
    """Coefficients of a body's gravity field, degrees 3 and 4, about its centre of mass along the body axes.

    mass, kg;  radius R to which the coefficients belong, m;  coefficients: {(l, m): (C_lm, S_lm)}, not normalized
    """

    mass: Any
    radius: Any
    coefficients: Any


class Frequencies(NamedTuple):
    """Frequencies of small librations on a circular orbit, rad/s; NaN for unstable ones."""

    pitch: float
    roll_yaw_slow: float
    roll_yaw_fast: float


@explained
@dataclass(frozen=True, eq=False, repr=False)
class Satellite(Forced):
    """A rigid satellite on a Kepler orbit, in SI units: a run of it is in SI units too.

    inertia        classical inertia tensor about the centre of mass, (3, 3) in any body axes, or its diagonal, kg m^2
    orbit          an `Orbit`; gravity acts to second order in the size of the satellite, with `harmonics` to the fourth
    magnetic_moment   (3,), A m^2, in the field of the primary
    torque         (3,), N m, steady; or a function of quantities by name, such as lambda Omega, B: ... (`Forced`)
    plates         `Plate` records, for drag and sunlight; each is seen from its front, and none is in a shadow
    density, drag  of the air, kg/m^3, constant on the orbit and at rest in space, and the drag coefficient
    air            instead of a density "exponential" or "harris-priester" air, which rotates with the Earth
    light          the pressure of sunlight at 1 au, N/m^2 (`SOLAR_PRESSURE`)
    sun            "ephemeris", the Sun at its date; or its direction in space.  Default: the Sun at its date if the
                   orbit of the Earth has an epoch, else the first axis of space
    eclipse        whether the primary shades the light; default: if the Sun moves
    magnetic_field   "igrf", IGRF-14 to that `degree`; "tilted-dipole", its first degree; "dipole", of the primary along
                   its axis.  Default: "igrf" if the orbit of the Earth has an epoch, else "dipole"
    mirror, diffuse   fractions of the light that are reflected and scattered
    harmonics      `Harmonics` of the body's gravity field
    wheels, control   reaction wheels and a controller (`Forced`)

    Vectors are along the body axes; a run has the momentum M along the principal axes.  Raises `InputError` for moments
    that are impossible for a body.  The equations: `kreisel.bodies.satellite`.
    """

    vectors: ClassVar[tuple[str, ...]] = ("dipole", "torque")

    inertia: Any
    orbit: Orbit
    magnetic_moment: Any = (0.0, 0.0, 0.0)
    plates: tuple[Plate, ...] = ()
    density: float = 0.0
    drag: float = 2.2
    light: float = 0.0
    sun: Any = None
    mirror: float = 0.0
    diffuse: float = 0.0
    harmonics: Harmonics | None = None
    magnetic_field: str | None = None
    degree: int = earth.DEGREE
    air: str | None = None
    eclipse: bool | None = None
    torque: Any = stored(default=(0.0, 0.0, 0.0), kw_only=True)
    steady: ClassVar[bool] = True
    body: FreeBody = stored(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.orbit, Orbit):
            raise InputError(f"orbit: expected kr.physical.Orbit(...), got {shown(self.orbit)}.")
        inertia = inertia_tensor(self.inertia)
        body = FreeBody(inertia, time_unit=float(np.trace(inertia)) / 3)  # M in kg m^2/s
        vars(self).update(inertia=inertia, body=body)
        convert_fields(self, shapes=((3,),), magnetic_moment="A m^2")
        if not by_functions(self.torque):
            convert_fields(self, shapes=((3,),), torque="N m")
        convert_fields(self, least=0.0, density="kg/m^3", drag="1", light="N/m^2", mirror="1", diffuse="1")
        if not isinstance(self.plates, list | tuple):
            raise InputError(f"plates: expected a list of Plate(normal, centre, area), got {shown(self.plates)}.")
        vars(self).update(plates=tuple(_plate(p) for p in self.plates))
        self.model()

    @classmethod
    def cubesat(
        cls, orbit: Orbit, units: float = 3, mass: Any = None, center_of_mass: Any = (0.0, 0.0, 0.0), **options: Any
    ) -> Satellite:
        """A CubeSat of `units` cubes of 10 cm, stacked along its first axis, 1.33 kg each, with the inertia of a box.

        Its six sides are plates.  Air and light rotate it only if its center_of_mass, (3,), m, is not the centre of the
        box: the specification allows 2 cm, along the first axis 7 cm for three units.  [CubeSat Design Specification,
        rev. 13, 2014]
        """
        long, side = 0.1 * si_number(units, "1", "units", positive=True), 0.1
        weight = 1.33 * long / side if mass is None else si_number(mass, "kg", "mass", positive=True)
        sides, shift = np.array([long, side, side]), si_numbers(center_of_mass, "m", "center_of_mass", ((3,),))
        plates = [
            Plate(sign * axis, sign * axis * sides / 2 - shift, np.prod(sides[axis == 0]))
            for axis in np.eye(3)
            for sign in (1, -1)
        ]
        inertia = FreeBody.box(weight, tuple(sides)).inertia
        return cls(inertia, orbit, **{"plates": tuple(plates), **options}).shaped("box", sides / 2)

    def environment(self, run: xr.Dataset) -> xr.Dataset:
        """Environment of the satellite along a run, in space: vectors (time, [lane,] axis), scalars (time, [lane]).

        position, m; velocity, m/s; field, T; sun, the direction of the Sun; light, the fraction of its disc that is
        seen; density of the air, kg/m^3.
        """
        require_of_body(run, self.orbit.elements)
        return environment_of(run)

    def _doubts(self, seconds: float) -> list[str]:
        until = earth.igrf_until() - self.orbit.days if np.any(self._built.params["gauss"]) else np.inf
        if seconds / earth.DAY <= until:
            return []
        return [
            f"IGRF-14 holds until 2030-01-01, {until:.0f} days after the epoch, and the run takes "
            f"{seconds / earth.DAY:.0f} days: from then on its last rates are continued."
        ]

    def field(self, run: xr.Dataset) -> xr.DataArray:
        """The magnetic field at the satellite along a run, in space, T, (time, [lane,] axis)."""
        return self.environment(run)["field"]

    def model(self) -> Model:
        """The system "satellite" with these parameters, in SI units and principal axes."""
        return self._built

    @cached_property
    def _built(self) -> Model:
        along = self.body.principal.axes
        rows = [[*(p.normal @ along), *(p.centre @ along), p.area] for p in self.plates]
        parameters = {
            "moments": self.body.principal.moments,
            **self.orbit.elements,
            "dipole": self.magnetic_moment @ along,
            "torque": np.zeros(3) if by_functions(self.torque) else self.torque @ along,
            "plates": rows or np.zeros((1, 7)),
            "drag": self.drag,
            "pressure": self.light,
            "mirror": self.mirror,
            "diffuse": self.diffuse,
            **earth.environment_of(self),
            **({} if self.harmonics is None else _moments(self.harmonics, along)),
        }
        model = BODIES["satellite"](**parameters)
        date = self.orbit.epoch
        epoch = "" if date is None else date.replace(tzinfo=None).isoformat()
        frame = BodyFrame.in_units(1.0, 1.0, along, work=("J", 1.0), balance=("J", 1.0))
        return self.forced(model.of_body(replace(frame, epoch=epoch)), (*MOTION, *PLACE))

    def state(self, spin: Any = None, axis: Any = None, attitude: Any = None) -> State:
        """The state M = I Omega, kg m^2/s, along the principal axes, for an angular velocity in the body.

        spin   (..., 3), rad/s along the body axes; or a rate, with `axis`; default: the rate of the frame of the orbit
               at t = 0, for a body at rest in it
        attitude   of the body axes at t = 0, a unit quaternion (..., 4), or the angles of `pointing(...)` as a dict;
                   default: `pointing()`.  A run of the satellite begins with it
        """
        attitude = self.pointing(**attitude) if isinstance(attitude, Mapping) else attitude
        if spin is not None:
            Omega = angular_velocity_of(spin, axis)
        elif attitude is None:
            Omega = self.orbit.rate() * self._axes_of_orbit[:, 2]
        else:
            R = algebra.rotation_matrix(attitude_quaternion(attitude, "attitude"))
            Omega = self.orbit.rate() * self.orbit.first_frame[:, 2] @ R
        M = in_range("The momentum", lambda: Omega @ self.inertia @ self.body.principal.axes)
        return self._started(self.orientation(self.pointing() if attitude is None else attitude), M=M)

    @cached_property
    def _axes_of_orbit(self) -> Array:
        """Up, ahead and the normal along the body axes at zero angles, as columns: right-handed."""
        return self.body.principal.axes @ axes_of_angles(self.body.principal.moments)

    def pointing(self, yaw: Any = 0.0, pitch: Any = 0.0, roll: Any = 0.0) -> Array:
        """The attitude at t = 0 with the axis of the least moment up and the axis of the largest along the normal.

        It is rotated by these angles, rad, first about the normal, then about ahead, then about up: a unit quaternion
        (4,).  Without rotation, the attitude is stable on a circular orbit.
        """
        angles = [si_number(v, "rad", name) for v, name in ((pitch, "pitch"), (roll, "roll"), (yaw, "yaw"))]
        R = self.orbit.first_frame
        for angle, axis in zip(angles, (2, 1, 0), strict=True):
            R = R @ algebra.cayley(np.tan(angle / 2) * algebra.hat(np.eye(3)[axis]))
        return algebra.unit_quaternion(R @ self._axes_of_orbit.T)

    def angular_velocity(self, M: Any) -> Array:
        """The inverse of `state`: Omega (..., 3) in rad/s along the body axes, from M (..., 3) axial, kg m^2/s.

        An array is read as M of a state; the variable M of a run states its axes.  Raises `InputError`.
        """
        return self.body.angular_velocity(M)

    def angles(self, run: xr.Dataset) -> Angles:
        """Pitch, roll and yaw (...) of a run relative to the frame of the orbit, from -pi to pi."""
        angles = angles_of(run)
        require_of_body(run, self.orbit.elements)
        return angles

    def _axis(self, run: xr.Dataset, which: int) -> Array:
        """One of the axes of yaw, roll and pitch in the frame of the orbit's elements, at each row."""
        g = algebra.rotation_matrix(orientation_of(run))
        require_of_body(run, self.orbit.elements)
        return np.asarray(g @ (self.body.principal.axes.T @ self._axes_of_orbit[:, which]))

    def obliquity(self, run: xr.Dataset) -> Array:
        """The angle of the axis of the largest moment to the normal of the orbit, rad, at each row of a run."""
        axis = self._axis(run, 2)
        normal = self.orbit.frame(_times(run, axis.ndim - 1))[..., 2]
        return np.asarray(np.arccos(np.clip((axis * normal).sum(-1), -1, 1)))

    def resonant_angle(self, run: xr.Dataset, ratio: float) -> Array:
        """Theta - ratio M, from -pi to pi, for theta the angle of the axis of the least moment from the pericentre.

        In the plane of the orbit; M its mean anomaly, ratio of spin to orbit: 1.5 for Mercury.  It librates in the
        resonance and circulates outside.  An axis has no front, so for half-integers 0 and pi are alike.
        """
        along, across = self.orbit.axes[:, :2].T
        axis = self._axis(run, 0)
        time, ratio = _times(run, axis.ndim - 1), si_number(ratio, "1", "ratio")
        turned = in_range("ratio M", lambda: ratio * (self.orbit.mean_anomaly + self.orbit.mean_motion * time))
        angle = np.arctan2(axis @ across, axis @ along) - turned
        return np.asarray(np.angle(np.exp(1j * angle)))

    @property
    def librations(self) -> Frequencies:
        """Frequencies of small librations about `pointing()` on a circular orbit, under gravity only.

        [Hughes 1986, section 9.2]

        pitch^2 = 3 n^2 k;  roll and yaw: w^4 - (1 + 3 k1 + k1 k3) n^2 w^2 + 4 k1 k3 n^4 = 0,
        k = (I_r - I_y)/I_p,  k1 = (I_p - I_y)/I_r,  k3 = (I_p - I_r)/I_y.
        """
        y, r, p = np.sort(self.body.principal.moments)
        k, k1, k3 = (r - y) / p, (p - y) / r, (p - r) / y
        middle = 1 + 3 * k1 + k1 * k3
        with np.errstate(invalid="ignore"):
            root = np.sqrt(middle * middle - 16 * k1 * k3)
            frequencies = self.orbit.mean_motion * np.sqrt([3 * k, (middle - root) / 2, (middle + root) / 2])
        return Frequencies(*frequencies.tolist())


@explained
class Asteroid(Satellite):
    """A moon or an asteroid on its orbit: a `Satellite` whose shape is an ellipsoid of constant density."""

    @classmethod
    def ellipsoid(cls, mass: Any, diameters: Any, orbit: Orbit) -> Asteroid:
        """The asteroid with these principal diameters, m."""
        lengths = si_numbers(diameters, "m", "diameters", ((3,),))
        return cls(FreeBody.ellipsoid(mass, lengths).inertia, orbit).shaped("ellipsoid", lengths / 2)

    @classmethod
    def hyperion(cls) -> Asteroid:
        """Saturn's moon VII, with half axes 190, 145, 114 km and e = 0.1.

        [Wisdom, Peale, Mignard, Icarus 58 (1984) 137]

        Mass 5.62e18 kg [Thomas et al., Nature 448 (2007) 50], which does not enter the motion; a period of 21.28 days.
        """
        mean_motion = 2 * np.pi / (21.28 * 86400)
        orbit = Orbit((SATURN.mu / mean_motion**2) ** (1 / 3), 0.1, primary=SATURN)
        return cls.ellipsoid(5.62e18, (3.80e5, 2.90e5, 2.28e5), orbit)

    @classmethod
    def toutatis(cls) -> Asteroid:
        """(4179) Toutatis, rotates in 5.41 days about its long axis, the first, which goes round in 7.35 days.

        Moments as 1 : 3.09 : 3.22 [Hudson, Ostro, Science 270 (1995) 84]; a = 2.5321 au, e = 0.6288 [JPL Small-Body
        Database, epoch 2008].  The unit of its moments, 1e19 kg m^2, is arbitrary.
        """
        return cls((1e19, 3.09e19, 3.22e19), Orbit(2.5321 * ASTRONOMICAL_UNIT, 0.6288, primary=SUN))


def _moments(harmonics: Harmonics, along: Array) -> dict[str, Array]:
    """The parameters degree_3 and degree_4: m R^l (C_l0, C_l1, S_l1, ...), along the columns of `along`."""
    if not isinstance(harmonics, Harmonics) or not isinstance(harmonics.coefficients, Mapping):
        raise InputError(f"harmonics: expected Harmonics(mass, radius, {{(3, 0): (C, S)}}), got {shown(harmonics)}.")
    size = si_number(harmonics.mass, "kg", "mass", positive=True)
    R = si_number(harmonics.radius, "m", "radius", positive=True)
    coefficients = {3: np.zeros((4, 2)), 4: np.zeros((5, 2))}
    for key, value in harmonics.coefficients.items():
        degree, order = key if isinstance(key, tuple) and len(key) == 2 else (None, None)
        if degree not in coefficients or order not in range(degree + 1):
            raise InputError(f"harmonics: expected (l, m) with l = 3 or 4 and 0 <= m <= l, got {shown(key)}.")
        coefficients[degree][order] = size * R**degree * si_numbers(value, "1", f"harmonics {key}", ((2,),))
    formulas = cast("Any", satellite)  # of a page, without types
    w = np.random.default_rng(0).normal(size=(64, 3))
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    out = {}
    for degree, basis in ((3, formulas.harmonics_3), (4, formulas.harmonics_4)):
        values, basis_values = (np.array([basis(v) for v in x]) for x in (w @ along.T, w))
        out[f"degree_{degree}"] = np.linalg.lstsq(basis_values, values @ np.delete(coefficients[degree].ravel(), 1))[0]
    return out


def _times(run: xr.Dataset, ndim: int) -> Array:
    """The times of the rows of a run, with `ndim` axes."""
    return np.asarray(run.time).reshape(-1, *[1] * (ndim - 1))


def _plate(value: Any) -> Plate:
    """A plate with checked values.  Raises `InputError`."""
    if not isinstance(value, tuple | list) or len(value) != 3:
        raise InputError(f"plates: expected Plate(normal, centre, area), got {shown(value)}.")
    normal, centre, area = value
    size = si_number(area, "m^2", "area", least=0.0)
    return Plate(direction(normal, "normal"), si_numbers(centre, "m", "centre", ((3,),)), size)
