"""Satellites and moons on a Kepler orbit, in SI units, and the environment of the Earth at a date.

The environment is IGRF-14, the rotation of the Earth, the Sun, tables of the air.  Dates are days of UTC after
2000-01-01 12:00; UTC is used for UT1 and TT, which differ from it by less than 1 s and by 69 s.  Space is the frame of
the mean equator and the mean equinox at the epoch.  The results are parameters of `kreisel.bodies.satellite`.
"""

from __future__ import annotations

import datetime as dt
import inspect
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field as stored, replace
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.bodies import BODIES, satellite
from kreisel.errors import InputError, doubt, explained, require_one_of, shown
from kreisel.forces.body import MOTION, PLACE, RATE
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
DAY = 86_400.0  # s
CENTURY = 36_525.0  # days
DEGREE = 13  # of IGRF
TURNS_A_DAY = 1.00273781191135448  # of the Earth against the stars, IERS Conventions (2010), equation 5.15
ROTATION = 2 * np.pi * TURNS_A_DAY / DAY  # rad/s
PRECESSION = 5028.796195 / 3600  # degrees a century along the ecliptic, IAU 2006
FIELDS = ("igrf", "dipole", "tilted-dipole")
SHADED = 200.0  # radii of the primary: light is then off by 0.02 in the penumbra, and by 0.8 on the axis beyond 217
SAME_SUN = 1e-3  # relative: mu of the Sun in tables


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
                   orbit of the Earth has an epoch, the primary if that is the Sun, else the first axis of space.  In a
                   direction it is at 1 au
    eclipse        whether the primary, if it is not the Sun, shades the light; default: if the Sun moves
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
    degree: int = DEGREE
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
        if isinstance(self.plates, Plate) or not isinstance(self.plates, list | tuple):
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
            **surroundings_of(self),
            **({} if self.harmonics is None else _moments(self.harmonics, along)),
        }
        model = BODIES["satellite"](**parameters)
        date = self.orbit.epoch
        epoch = "" if date is None else date.replace(tzinfo=None).isoformat()
        frame = BodyFrame.in_units(1.0, 1.0, along, work=("J", 1.0), balance=("J", 1.0))
        model = self.forced(model.of_body(replace(frame, epoch=epoch)), (*MOTION, *PLACE))
        if not np.any(model.params["field"]) and not np.any(model.params["gauss"]) and self._magnetic(model):
            doubt(
                "control, torque: expected a magnetic field, in which dipoles of a law and torques of B act, got none: "
                "they do not rotate the satellite. Give the primary its field: Primary(..., field=...), in T m^3."
            )
        return model

    def _magnetic(self, model: Model) -> bool:
        """Whether a law commands dipoles (to unload wheels, at a rate), or a function reads the field."""
        functions = filter(callable, (*np.atleast_1d(self.torque), self.potential))
        read = {name for function in functions for name in inspect.signature(function).parameters}
        control = model.system.perturbation and model.system.perturbation.control
        commands = control.commands if control and np.any(model.params.get("unloading", 1)) else {}
        return bool(read & {"B", RATE} or "dipole" in commands)

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
        require_of_body(run, {**self.orbit.elements, "moments": self.body.principal.moments})
        return np.asarray(g @ (self.body.principal.axes.T @ self._axes_of_orbit[:, which]))

    def obliquity(self, run: xr.Dataset) -> Array:
        """The angle of the axis of the largest moment to the normal of the orbit, rad, at each row of a run."""
        axis = self._axis(run, 2)
        normal = self.orbit.frame(_times(run, axis.ndim - 1))[..., 2]
        return np.asarray(np.arctan2(np.linalg.norm(np.cross(axis, normal), axis=-1), algebra.dot(axis, normal)))

    def resonant_angle(self, run: xr.Dataset, ratio: float) -> Array:
        """Theta - ratio M, from -pi to pi, for theta the angle of the axis of the least moment from the pericentre.

        In the plane of the orbit; M its mean anomaly, ratio of spin to orbit: 1.5 for Mercury.  It librates in the
        resonance and circulates outside.  An axis has no front, so for half-integers 0 and pi are alike.
        """
        axis, ratio = self._axis(run, 0), si_number(ratio, "1", "ratio")
        time = _times(run, axis.ndim - 1)
        along, across = np.moveaxis(self.orbit.axes_at(time)[..., :2], -1, 0)
        turned = in_range("ratio M", lambda: ratio * (self.orbit.mean_anomaly + self.orbit.rates.mean_anomaly * time))
        angle = np.arctan2(algebra.dot(axis, across), algebra.dot(axis, along)) - turned
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

    _shape: tuple[Any, ...] = ("ellipsoid",)

    @classmethod
    def ellipsoid(cls, mass: Any, diameters: Any, orbit: Orbit, **options: Any) -> Asteroid:
        """The asteroid with these principal diameters, m; `options`: arguments of `Satellite`."""
        lengths = si_numbers(diameters, "m", "diameters", ((3,),))
        return cls(FreeBody.ellipsoid(mass, lengths).inertia, orbit, **options).shaped("ellipsoid", lengths / 2)

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


# -- magnetic field --------------------------------------------------------------------------------


@cache
def _igrf() -> tuple[Array, Array]:
    """The first days of its epochs, and the coefficients (195, epochs) in T, g_10, g_11, h_11, g_20, ..."""
    lines = resources.files("kreisel.physical").joinpath("igrf14.txt").read_text("ascii").splitlines()
    years, *rows = (line.split() for line in lines if line[0] != "#")
    days = [dt.date(int(year), 1, 1).toordinal() - dt.date(2000, 1, 1).toordinal() - 0.5 for year in years]
    return np.array(days), np.array([[float(x) for x in row[2:]] for row in rows]) * 1e-9


def igrf(days: float, degree: int = DEGREE) -> Array:
    """Coefficients of IGRF-14 at a date and their rates, (degree (degree + 2), 2), T and T/s.

    Linear between the epochs, five years apart; after 2025 with the secular variation.  Raises `InputError` for a date
    outside 1900 to 2030 and for a degree other than 1 to 13.  [P. Alken et al., Earth, Planets and Space 73 (2021) 49;
    IAGA, 2024, doi 10.5281/zenodo.14012302]
    """
    if isinstance(degree, bool) or degree not in range(1, DEGREE + 1):
        raise InputError(f"degree: expected an integer from 1 to {DEGREE}, got {shown(degree)}.")
    epochs, values = _igrf()
    if not epochs[0] <= days <= epochs[-1]:
        date = dt.datetime(2000, 1, 1, 12) + dt.timedelta(days=days)
        raise InputError(
            f"epoch: IGRF-14 holds from 1900-01-01 to 2030-01-01, got {date:%Y-%m-%d}. For other dates use "
            "magnetic_field='dipole'."
        )
    at = min(int(np.searchsorted(epochs, days, side="right")), len(epochs) - 1)
    low, high = values[: degree * (degree + 2), at - 1 : at + 1].T
    rate = (high - low) / (epochs[at] - epochs[at - 1])
    return np.stack([low + (days - epochs[at - 1]) * rate, rate / DAY], -1)


def meridian(days: float) -> Array:
    """Greenwich mean sidereal time, rad, and the rate of the Earth's rotation against the stars, rad/s.

    Without nutation and polar motion, up to 17" together and 20" a year of precession of the pole from the epoch on.
    [IERS Conventions (2010), equations 5.14, 5.15 and 5.32]
    """
    T = days / CENTURY
    seconds = 0.014506 + (4612.156534 + (1.3915817 - 0.00000044 * T) * T) * T
    turns = 0.7790572732640 + (TURNS_A_DAY - 1) * days + days % 1.0
    return np.array([2 * np.pi * (turns % 1.0) + np.radians(seconds / 3600), ROTATION])


# -- Sun -------------------------------------------------------------------------------------------


def motion_of_sun(days: float) -> dict[str, Array]:
    """Motion of the Sun seen from the Earth, with aberration, to 0.01 degrees.

    [Meeus, Astronomical Algorithms, 2nd ed., 1998, chapter 25, low accuracy, without the term in 3M; equation 22.2]

    Its longitudes count from the equinox of the date; here from the equinox of the epoch.
    """
    T = days / CENTURY
    L, n = 280.46646 + (36000.76983 + 0.0003032 * T) * T, 36000.76983 - PRECESSION
    M, m = 357.52911 + (35999.05029 - 0.0001537 * T) * T, 35999.05029
    e = 0.016708634 - (0.000042037 + 0.0000001267 * T) * T
    C = [1.914602 - (0.004817 + 0.000014 * T) * T, 0.019993 - 0.000101 * T]
    tilt, perihelion = np.radians(23.439291 - 0.0130042 * T), np.radians(L - M)
    angles = np.radians([(L - 0.00569) % 360, n / CENTURY / DAY, M % 360, m / CENTURY / DAY, *C])
    ellipse = [e * np.cos(perihelion), e * np.sin(perihelion), 1 - 1.000001018 * (1 - e * e)]
    return {
        "sun": np.array([1.0, 0.0, 0.0]),
        "sun_ahead": np.array([0.0, np.cos(tilt), np.sin(tilt)]),
        "solar": np.array([*angles, *ellipse]),
    }


# -- air -------------------------------------------------------------------------------------------


@cache
def tables() -> dict[str, Array]:
    """The tables of air.toml: rows of height, density by night and in the bulge, in SI."""
    data = tomllib.loads(resources.files("kreisel.physical").joinpath("air.toml").read_text("utf-8"))
    return {name: np.array([[1e3 * row[0], row[1], row[-1]] for row in rows]) for name, rows in data.items()}


def rows_between(table: Array, low: float, high: float) -> Array:
    """The rows of a table of the air for heights from low to high, m, and one beyond at each end.

    The last slope extends above the table.  Raises `InputError` for an orbit whose lowest height is outside the table.
    """
    heights = table[:, 0]
    if not heights[0] <= low <= heights[-1]:
        raise InputError(
            f"air: the table holds from {heights[0] / 1e3:g} to {heights[-1] / 1e3:g} km, the lowest height of the "
            f"orbit is {low / 1e3:.6g} km. For another height give its density=..., in kg/m^3, without air=..."
        )
    first = min(int(np.searchsorted(heights, low, side="right")) - 1, len(heights) - 2)
    last = max(int(np.searchsorted(heights, high)), first + 1)
    return table[first : last + 1]


# -- the environment of a satellite ----------------------------------------------------------------


def surroundings_of(body: Satellite) -> dict[str, Any]:
    """Parameters of `kreisel.bodies.orbit` for a satellite, or for all lanes.  Raises `InputError`."""
    orbit, sun, eclipse = body.orbit, body.sun, body.eclipse
    dated = orbit.epoch is not None and orbit.primary.earthly
    magnetic_field = body.magnetic_field or ("igrf" if dated else "dipole")
    require_one_of(FIELDS, magnetic_field, "magnetic_field")
    out: dict[str, Any] = {"field": orbit.primary.field}
    if magnetic_field != "dipole":
        _require_date(orbit, f"magnetic_field={magnetic_field!r}")
        gauss = igrf(orbit.days, body.degree if magnetic_field == "igrf" else 1)
        out = {"field": 0.0, "gauss": gauss, "meridian": meridian(orbit.days)}
    if eclipse is not None and not isinstance(eclipse, bool):
        raise InputError(f"eclipse: expected True or False, got {shown(eclipse)}.")
    if abs(orbit.primary.mu / SUN.mu - 1) < SAME_SUN:
        if eclipse:
            raise InputError("eclipse=True: expected another primary than the Sun, which does not shade its light.")
        out["heliocentric"] = float(sun is None)
    moves = dated if sun is None else isinstance(sun, str)
    out["eclipse"] = float(moves if eclipse is None else eclipse)
    if out["eclipse"] and orbit.distances[1] > SHADED * orbit.primary.radius:
        doubt(
            f"eclipse: expected an orbit within {SHADED:g} radii of the {orbit.primary.name}, beyond which its disc is "
            "smaller than the Sun's and light in its shadow is wrong. Give eclipse=False if it does not enter it."
        )
    if moves:
        if sun not in (None, "ephemeris"):
            raise InputError(f"sun: expected 'ephemeris' or a direction in space, got {shown(sun)}.")
        _require_date(orbit, "sun='ephemeris'")
        out |= motion_of_sun(orbit.days)
    elif sun is not None:
        out["sun"] = direction(sun, "sun")
    elif orbit.epoch is not None and np.any(body.light) and "heliocentric" not in out:
        doubt(
            f"sun: expected a direction in space for light on an orbit of {orbit.primary.name}, got none, and an epoch "
            "that determines it only for the Earth. The Sun is on the first axis of space, and nothing shades its "
            "light. Give sun=(x, y, z), and eclipse=True."
        )
    return out | ({"density": body.density} if body.air is None else _air(body))


def _require_date(orbit: Orbit, wish: str) -> None:
    if not orbit.primary.earthly:
        raise InputError(f"{wish}: expected an orbit of the Earth, got one of the primary {orbit.primary.name}.")
    if orbit.epoch is None:
        raise InputError(f"{wish}: expected a date, Orbit(..., epoch='2026-03-20T14:46:00') in UTC, got none.")


def _air(body: Satellite) -> dict[str, Any]:
    orbit = body.orbit
    if not orbit.primary.earthly:
        raise InputError(f"air: expected an orbit of the Earth, got one of the primary {orbit.primary.name}.")
    require_one_of(tables(), body.air, "air")
    if body.density:
        raise InputError("air: expected no density with it, got both. Give one of the two.")
    if body.air == "harris-priester" and body.sun is None:
        _require_date(orbit, "air='harris-priester'")  # the Sun by its date
    R, f = orbit.primary.radius, orbit.primary.flattening
    orbits = [lane.orbit for lane in body._lanes] or [orbit]
    low = min(path.distances[0] for path in orbits) - R
    high = max(path.distances[1] for path in orbits) - R * (1 - f)
    return {
        "density": 1.0,
        "air": rows_between(tables()[cast("str", body.air)], low, high),
        "bulge": 2 + 4 * np.sin(orbit.inclination) ** 2,
        "flattening": f,
        "air_rate": ROTATION,
    }
