"""Kepler orbits, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np

from kreisel.algebra import Array
from kreisel.bodies import satellite
from kreisel.errors import InputError, doubt, explained, shown
from kreisel.physical.measures import convert_fields, finite_floats, in_range, si_number


@explained
class Primary(NamedTuple):
    """The central body: gravitational parameter mu, m^3/s^2; radius R, m; magnetic field R^3 g_1^0, T m^3.

    B = -grad V,  V = R (R/r)^2 g_1^0 cos(theta) of the dipole along the axis: g_1^0 < 0 for the Earth, whose field
    points north over its equator.
    """

    name: str
    mu: float
    radius: float
    field: float = 0.0


# mu, radius: WGS 84 for the Earth, JPL's planetary satellite ephemerides (SAT441) for Saturn, IAU 2015 B3 for the Sun.
# The field of the Earth: g_1^0 = -29350.0 nT of IGRF-14 (2025) for a radius of 6371.2 km.  Of Saturn: 21136 nT for
# 60268 km, Burton et al., Geophysical Research Letters 37 (2010) L24105.
EARTH = Primary("Earth", satellite.EARTH, 6_378_137.0, -29_350.0e-9 * 6_371_200.0**3)
SATURN = Primary("Saturn", 3.7931206e16, 6.0268e7, 21_136.0e-9 * 60_268_000.0**3)
SUN = Primary("Sun", 1.3271244e20, 6.957e8)


def _checked(primary: Any) -> Primary:
    """The primary in SI.  Raises `InputError`."""
    if not isinstance(primary, Primary):
        raise InputError(f"primary: expected kr.physical.EARTH or another Primary, got {shown(primary)}.")
    mu, radius = si_number(primary.mu, "m^3/s^2", "mu", positive=True), si_number(primary.radius, "m", "radius")
    if radius < 0:
        raise InputError(f"radius of the primary: expected a number >= 0, got {radius:g}.")
    return Primary(primary.name, mu, radius, si_number(primary.field, "T m^3", "field"))


@explained
@dataclass(frozen=True, eq=False)
class Orbit:
    """A Kepler orbit, at its pericentre at t = 0, in SI units.

    semi_major_axis   m;  eccentricity, 0 <= e < 1
    inclination, node, perigee   rad: to the equator of the primary; of the ascending node; from it to the pericentre
    primary           `kr.physical.EARTH`, `SATURN`, `SUN`, or a user-defined `Primary`

    Space is the frame of these angles; its third axis is the primary's.  Raises `InputError` unless the orbit is
    an ellipse outside the primary.  Warns with `InputWarning` of plain angles beyond 2 pi and of orbits in the air.
    """

    semi_major_axis: float
    eccentricity: float = 0.0
    inclination: float = 0.0
    node: float = 0.0
    perigee: float = 0.0
    primary: Primary = EARTH

    def __post_init__(self) -> None:
        convert_fields(self, positive=True, semi_major_axis="m")
        convert_fields(self, inclination="rad", node="rad", perigee="rad")
        object.__setattr__(self, "primary", _checked(self.primary))
        e = si_number(self.eccentricity, "1", "eccentricity")
        if not 0 <= e < 1:
            raise InputError(f"eccentricity: expected an ellipse, 0 <= e < 1, got {e:g}.")
        object.__setattr__(self, "eccentricity", e)
        pericentre, formulas = np.asarray(self.pericentre), cast("Any", satellite)  # of a page, without types
        formulas.check_pericentre(pericentre, self.primary.radius, self.primary.name)
        for sentence in formulas.doubtful_orbit(pericentre=pericentre, **self.primary._asdict()):
            doubt(sentence)
        in_range("The orbit", lambda: self.period)

    @classmethod
    def circular(cls, altitude: Any, inclination: Any = 0.0, node: Any = 0.0, primary: Primary = EARTH) -> Orbit:
        """A circular orbit at this altitude above the surface, m."""
        primary = _checked(primary)
        return cls(si_number(altitude, "m", "altitude") + primary.radius, 0.0, inclination, node, 0.0, primary)

    @property
    def mean_motion(self) -> float:
        """sqrt(mu/a^3), rad/s."""
        return math.sqrt(self.primary.mu / self.semi_major_axis) / self.semi_major_axis

    @property
    def period(self) -> float:
        """2 pi/mean_motion, s."""
        return 2 * math.pi / self.mean_motion

    @property
    def pericentre(self) -> float:
        """The least distance from the centre of the primary, m."""
        return self.semi_major_axis * (1 - self.eccentricity)

    @property
    def elements(self) -> dict[str, float]:
        """The orbit's parameters of `kreisel.bodies.satellite`."""
        names = ("semi_major_axis", "eccentricity", "inclination", "node", "perigee")
        return {name: getattr(self, name) for name in names} | {"mu": self.primary.mu}

    def at(self, time: Any) -> tuple[Array, Array]:
        """Position, m, and velocity, m/s, at times in s (...): each (..., 3), in space."""
        t = finite_floats(time, "s", "time")[..., None]
        known = {name: np.asarray(value) for name, value in self.elements.items()}
        formulas = cast("Any", satellite)  # of a page, without types
        r, v = formulas.place(t, **formulas.half_axes(**known), eccentricity=self.eccentricity)
        return r, v

    def frame(self, time: Any) -> Array:
        """The axes of the orbit at times (...), as columns (..., 3, 3): up, ahead, and the normal of the orbit."""
        r, v = self.at(time)
        up = r / np.linalg.norm(r, axis=-1, keepdims=True)
        normal = np.cross(r, v)
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        return np.stack([up, np.cross(normal, up), normal], -1)

    def rate(self, time: Any = 0.0) -> Any:
        """The rate at which that frame rotates about the normal, |r x v|/r^2, rad/s."""
        r, v = self.at(time)
        return np.linalg.norm(np.cross(r, v), axis=-1) / (r * r).sum(-1)
