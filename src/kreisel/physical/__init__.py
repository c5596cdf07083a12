"""Bodies in SI units, which `kr.simulate` and the other functions accept.

    wheel = Gyroscope.flat(mass="3 kg", axial_moment="0.17 kg m^2", lever="15 cm")
    run = kr.simulate(wheel, wheel.state(tilt="70 deg", spin="180 rpm"), dt="2 ms", t_end="10 s")  # in SI
    motion = wheel.motion(run.momentum, run.axis)

`Gyroscope` is the heavy symmetric top on a fixed point, `HeavyBody` any body on a fixed point, `FreeBody` any body
without torque, `Satellite` any body on an orbit, `Ellipsoid` a body in an ideal fluid, `SubmergedBody` any body deep in
water.  The third axis of space points up; for satellites it is the pole of the primary.  A run is along the axes in
which the body was given; `body.model()` is the scaled system that kernels step.  `read_mesh` and `read_robot` read
mass, centre of mass and inertia from a mesh and from a URDF or SDF file.

Arguments are floats in SI units, or quantities: mass="3 kg", spin="180 rpm" (`kreisel.units`, extra `units`).
"""

from __future__ import annotations

from kreisel.physical.binary import Binary, GravityBody, ThirdBody
from kreisel.physical.body import Ensemble
from kreisel.physical.control import (
    Control,
    EddyCurrents,
    Wheels,
    bdot,
    hysteresis_rods,
    magnetic_damping,
    pointing,
    sun_pointing,
)
from kreisel.physical.free_body import AxisStability, FreeBody, FreeRotation
from kreisel.physical.heavy_body import Gyroscope, HeavyBody, Motion
from kreisel.physical.measures import STANDARD_GRAVITY
from kreisel.physical.orbit import EARTH, SATURN, SUN, Orbit, Primary
from kreisel.physical.satellite import SOLAR_PRESSURE, Asteroid, Harmonics, Plate, Satellite
from kreisel.physical.shapes import Facets, Part, read_mesh, read_robot
from kreisel.physical.submerged import Course, Ellipsoid, SubmergedBody, read_added_mass

__all__ = [
    "EARTH",
    "SATURN",
    "SOLAR_PRESSURE",
    "STANDARD_GRAVITY",
    "SUN",
    "Asteroid",
    "AxisStability",
    "Binary",
    "Control",
    "Course",
    "EddyCurrents",
    "Ellipsoid",
    "Ensemble",
    "Facets",
    "FreeBody",
    "FreeRotation",
    "GravityBody",
    "Gyroscope",
    "Harmonics",
    "HeavyBody",
    "Motion",
    "Orbit",
    "Part",
    "Plate",
    "Primary",
    "Satellite",
    "SubmergedBody",
    "ThirdBody",
    "Wheels",
    "bdot",
    "hysteresis_rods",
    "magnetic_damping",
    "pointing",
    "read_added_mass",
    "read_mesh",
    "read_robot",
    "sun_pointing",
]
