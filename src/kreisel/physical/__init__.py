"""Conversion of SI data to Kreisel's scaled systems, and back.

    wheel = Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15)
    run = kr.simulate(wheel.model(), wheel.state(tilt=1.2, spin=20.0), dt=0.01, steps=1000)
    seconds, motion = run.time * wheel.time_unit, wheel.motion(run.m, run.a)

`Gyroscope` is the heavy symmetric top on a fixed point, `HeavyBody` any body on a fixed point, `FreeBody` any body
without torque, `Satellite` one on an orbit, `Ellipsoid` a body in an ideal fluid,
`SubmergedBody` any body deep in water.  The third axis of the rest frame
points up, gravity along -p = (0, 0, -1); hat(v) x = v x x.  `read_mesh` and `read_robot` read mass, centre of mass and
inertia from a mesh and from a URDF or SDF file.

Arguments are floats in SI units, or quantities: mass="3 kg", spin="180 rpm" (`kreisel.units`, extra `units`).
"""

from __future__ import annotations

from kreisel.physical.control import Control, Wheels
from kreisel.physical.ellipsoid import Ellipsoid
from kreisel.physical.ensemble import Ensemble
from kreisel.physical.forced import EddyCurrents
from kreisel.physical.free_body import AxisStability, FreeBody
from kreisel.physical.free_rotation import FreeRotation
from kreisel.physical.gyroscope import Gyroscope, Motion
from kreisel.physical.heavy_body import HeavyBody
from kreisel.physical.laws import bdot, hysteresis_rods, magnetic_damping, pointing, sun_pointing
from kreisel.physical.measures import SI, STANDARD_GRAVITY, Units
from kreisel.physical.orbit import EARTH, SATURN, SUN, Orbit, Primary
from kreisel.physical.satellite import SOLAR_PRESSURE, Asteroid, Harmonics, Plate, Satellite
from kreisel.physical.shapes import Part, read_mesh, read_robot
from kreisel.physical.submerged import Course, SubmergedBody, read_added_mass

__all__ = [
    "EARTH",
    "SATURN",
    "SI",
    "SOLAR_PRESSURE",
    "STANDARD_GRAVITY",
    "SUN",
    "Asteroid",
    "AxisStability",
    "Control",
    "Course",
    "EddyCurrents",
    "Ellipsoid",
    "Ensemble",
    "FreeBody",
    "FreeRotation",
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
    "Units",
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
