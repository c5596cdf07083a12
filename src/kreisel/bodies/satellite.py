"""A rigid satellite on a Kepler orbit, in SI units: gravity, magnetic dipole, air, sunlight, torques.

State M in so(3)*, the momentum in the principal axes (body frame), and the orientation g, body to space:

    M' = M x Omega + (torque of V) + tau
    V = (mu/r^3) (tr J/2 - (3/2) u.J u) - b.B          u = r/|r|,  J = tr(I)/2 - I,  b the dipole of the satellite
    B = -(f/r^3) (z - 3 (z.u) u)                       of the primary, z its axis; f = R^3 g_1^0, -7.59e15 T m^3 for
                                                       the Earth, so that B points north over its equator
    tau = torque + b x B' + sum over plates of c x F   c the centre of a plate, n its normal, A its area
    F = -(1/2) density drag A (n.v)+ v                 in the air; (x)+ is x if x > 0, else 0
        - light A (n.s)+ ((1 - mirror) s + 2 (mirror (n.s) + diffuse/3) n)           in sunlight, s to the Sun

The field B' of the coefficients `gauss`, s, the density, the velocity v in the air, and light = pressure (part of the
Sun's disc that is seen) (1 au/distance)^2 are functions of time of `kreisel.bodies.orbit`.  B' has no potential
here: the derivative in time of a field of degree 13, for the work, would cost three times as much as the field.

At the corner of (x)+ no method has an order above 2.

The first part of V is (mu/r^3) (3 u.I u - tr I)/2, the potential of gravity to second order in the size of the body.
To orders 3 and 4 the term -(mu/r^(l+1)) Y_l(-u) is added, with the harmonics of the body's field,

    Y_l(w) = sum over m of m_body R^l P_lm(sin phi) (C_lm cos m lambda + S_lm sin m lambda)    phi, lambda of w

about its centre of mass, P_lm without the sign (-1)^m and not normalized.  Space is the frame of the elements of the
orbit, with z as third axis.  [P. C. Hughes, Spacecraft Attitude Dynamics, 1986, chapters 8 and 9; W. M. Kaula, Theory
of Satellite Geodesy, 1966, chapter 1]
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel.algebra import cross, sqrt
from kreisel.bodies.orbit import (
    EARTH,
    ENVIRONMENT,
    NAMES,
    ORBIT,
    PATH,
    around,
    check_not_negative,
    check_pericentre,
    doubtful_orbit,
    expected,
    of_dipole,
    of_elements,
    place,
    ramp,
)
from kreisel.errors import InputError, shown
from kreisel.forces.records import perturbed_record
from kreisel.record.calling import naming
from kreisel.record.contract import Checks, Parameter
from kreisel.record.perturbation import Force, Perturbation
from kreisel.record.units import BodyFrame
from kreisel.record.values import doubtful_angle, require_body
from kreisel.system import euler_top

# -- the satellite ---------------------------------------------------------------------------------


def potential(g, t, *, J, orbit, path, mu, field, dipole, degree_3, degree_4):
    r, z = place(t, orbit, path)[0] @ g, g[2]
    square = r @ r
    distance = sqrt(square)
    w = -r / distance
    gravity = mu * (J.sum() / 2 - 1.5 * (J @ (w * w)))
    gravity = gravity - mu / distance * (degree_3 @ harmonics_3(w) + degree_4 @ harmonics_4(w) / distance)
    return (gravity + field * (dipole @ (z - 3 * (z @ w) * w))) / (square * distance)


def harmonics_3(w):
    """P_3m cos m lambda and P_3m sin m lambda, m from 0 to 3, in a direction w."""
    x, y, z = w
    c2, s2, near = x * x - y * y, 2 * x * y, 1.5 * (5 * z * z - 1)
    c3, s3 = x * c2 - y * s2, x * s2 + y * c2
    return np.array([z * (5 * z * z - 3) / 2, near * x, near * y, 15 * z * c2, 15 * z * s2, 15 * c3, 15 * s3])


def harmonics_4(w):
    """P_4m cos m lambda and P_4m sin m lambda, m from 0 to 4, in a direction w."""
    x, y, z = w
    c2, s2, near = x * x - y * y, 2 * x * y, 2.5 * z * (7 * z * z - 3)
    c3, s3, c4, s4 = x * c2 - y * s2, x * s2 + y * c2, c2 * c2 - s2 * s2, 2 * c2 * s2
    zonal, middle = (35 * z * z - 30) * z * z / 8 + 0.375, 7.5 * (7 * z * z - 1)
    far = [105 * z * c3, 105 * z * s3, 105 * c4, 105 * s4]
    return np.array([zonal, near * x, near * y, middle * c2, middle * s2, *far])


def torque(g, t, *, orbit, path, torque, dipole, plates, drag, pressure, mirror, diffuse, **constants):
    r, v = place(t, orbit, path)
    environment = around(r, v, t, **constants)
    v, s = environment.stream @ g, environment.sun @ g
    air, lighting = (
        -environment.density * drag / 2 * v,
        pressure * environment.near * environment.near * environment.light,
    )
    torque = torque + cross(dipole, environment.field @ g)
    for plate in plates:
        normal, centre, area = plate[:3], plate[3:6], plate[6]
        lit = normal @ s
        light = -lighting * ((1 - mirror) * s + 2 * (mirror * lit + diffuse / 3) * normal)
        torque = torque + cross(centre, area * (ramp(normal @ v) * air + ramp(lit) * light))
    return torque


def surroundings(t, *, orbit, path, field, **constants):
    """The environment in space at t, s, by name; of times (...) vectors are (3, ...)."""
    r, v = (x.T for x in place(t, orbit, path))
    environment = around(r, v, t, **constants)
    B = environment.field + of_dipole(r, field)
    return {
        "position": r,
        "velocity": v,
        "field": B,
        "sun": environment.sun,
        "light": environment.light,
        "density": environment.density,
    }


def smooth(*, orbit):
    """A hundredth of a revolution at the rate of the pericentre."""
    rate, e = orbit[..., 0], orbit[..., 2]
    return 2 * np.pi / 100 * (1 - e) ** 2 / (np.sqrt(1 - e * e) * rate)


def corners(*, plates, density, pressure):
    """Whether plates come into the air or the light and leave it."""
    return bool((plates[..., 6] > 0).any() and ((density > 0) | (pressure > 0)).any())


def check_parameters(*, semi_major_axis, eccentricity, radius, mirror, diffuse):
    check_pericentre(semi_major_axis * (1 - eccentricity), radius)
    if (mirror + diffuse > 1).any():
        raise InputError(f"mirror + diffuse: expected at most 1, got {shown((mirror + diffuse).tolist())}.")


def derive(*, moments, semi_major_axis, eccentricity, inclination, node, perigee, mean_anomaly, mu, radius, J2):
    J = moments.sum(-1, keepdims=True) / 2 - moments
    angles = {"inclination": inclination, "node": node, "perigee": perigee, "mean_anomaly": mean_anomaly}
    size = {"semi_major_axis": semi_major_axis, "eccentricity": eccentricity, "mu": mu, "radius": radius, "J2": J2}
    return {"J": J, **euler_top.sums(J=J), "orbit": of_elements(**size, **angles)}


def doubts(**constants):
    """Sentences on angles, orbits in the air, the sign of the Earth's field, and a dipole without a field."""
    for name in ("inclination", "node", "perigee", "mean_anomaly"):
        yield from doubtful_angle(constants[name], name)
    yield from doubtful_orbit(constants["semi_major_axis"] * (1 - constants["eccentricity"]), constants["radius"])
    field = constants["field"]
    if np.all(abs(constants["mu"] / EARTH - 1) < 1e-2) and np.any(field > 0):
        yield (
            f"field = {np.max(field):g} T m^3 points south over the equator; the Earth's points north: expected "
            "R^3 g_1^0, here -7.59e15. Usual cause: the strength of the dipole for its signed coefficient."
        )
    if np.any(constants["dipole"]) and not np.any(field) and not np.any(constants["gauss"]):
        yield "dipole: expected field too, the primary's, -7.59e15 T m^3 for the Earth, got 0: nothing rotates it."


def lasting(*, gauss, epoch, seconds):
    """A sentence on a run in the field of IGRF-14 beyond its last date."""
    days, last = seconds / 86400, (np.datetime64(IGRF_UNTIL) - np.datetime64(epoch or "NaT")) / np.timedelta64(1, "D")
    if np.any(gauss) and days > last:
        yield (
            f"IGRF-14 holds until {IGRF_UNTIL}, {last:.0f} days after the epoch, and the run takes {days:.0f} days: "
            "from then on its last rates are continued."
        )


def idle(**constants):
    """Sentences on air and light without plates."""
    for name, subject in (("density", "density"), ("pressure", "light and its pressure")):
        if np.any(constants[name]) and not np.any(constants["plates"][..., 6]):
            yield f"{subject}: expected plates too, on which it acts, got none: the satellite does not feel it."


def check_moments(value, name):
    require_body(value.sum(-1, keepdims=True) / 2 - value, name)


check_part = expected(lambda x: (x >= 0) & (x <= 1), "a part of the light, from 0 to 1")
check_degree_3 = expected(lambda x: x.shape == (7,), "7 values, C_30, C_31, S_31, ...")
check_degree_4 = expected(lambda x: x.shape == (9,), "9 values, C_40, C_41, S_41, ...")
check_plates = expected(
    lambda x: x.ndim == 2 and x.shape[1] == 7 and (x[:, 6] >= 0).all(),
    "rows of 7 values, the normal (3), the centre (3) and the area >= 0",
)
PARAMETERS = (
    Parameter("moments", "vector", "principal moments of inertia, kg m^2", check_moments, diagonal=True),
    *ORBIT,
    Parameter("degree_3", "array", "body's m R^3 (C_30, C_31, S_31, ...), kg m^3", check_degree_3, np.zeros(7), rank=1),
    Parameter("degree_4", "array", "body's m R^4 (C_40, C_41, S_41, ...), kg m^4", check_degree_4, np.zeros(9), rank=1),
    Parameter("dipole", "vector", "magnetic moment, A m^2, along the principal axes", default=np.zeros(3)),
    Parameter("field", "scalar", "of the primary's dipole, R^3 g_1^0, T m^3; -7.59e15 for the Earth", default=0.0),
    Parameter("torque", "vector", "steady torque, N m, along the principal axes", default=np.zeros(3)),
    Parameter("plates", "array", "rows: normal (3), centre (3), m, area, m^2", check_plates, np.zeros((1, 7)), rank=2),
    Parameter("drag", "scalar", "drag coefficient of the plates", check_not_negative, 2.2),
    Parameter("pressure", "scalar", "of sunlight, N/m^2; 4.54e-6 at the Earth's distance", check_not_negative, 0.0),
    Parameter("mirror", "scalar", "part of the light that plates reflect like a mirror", check_part, 0.0),
    Parameter("diffuse", "scalar", "part of the light that plates scatter", check_part, 0.0),
    *ENVIRONMENT,
)
IGRF_UNTIL = "2030-01-01"
LETTERS = [p.letter for p in PARAMETERS]
OF_POTENTIAL = ("J", "orbit", "path", "mu", "field", "dipole", "degree_3", "degree_4")
LOADS = ("orbit", "path", "torque", "dipole", "plates", "drag", "pressure", "mirror", "diffuse", *NAMES)
DERIVED = {"J": 1, "c": 2, "orbit": 1}  # axes


def body_frame():
    """SI units; the moments are given in principal axes."""
    units = {"time": "s", "M": "kg m^2/s", "energy": "J", "work": "J", "balance": "J"}
    return BodyFrame(units={name: (unit, 1.0) for name, unit in units.items()}, along=("M",))


BODIES = (
    perturbed_record(
        Perturbation(
            base=euler_top.SYSTEM,
            potential=Force(potential, ("g", "t"), OF_POTENTIAL, tables={"path": PATH}),
            torque=Force(torque, ("g", "t"), LOADS, tables={"path": PATH}),
            environment=Force(surroundings, ("t",), ("orbit", "path", "field", *NAMES), tables={"path": PATH}),
            smooth=smooth,
            corners=corners,
        ),
        {p.letter: p.axes or 0 for p in PARAMETERS} | DERIVED,
        name="satellite",
        title="Satellite on a Kepler orbit",
        equations="M' = M x Omega - dV/dg + tau,  V of gravity and a magnetic dipole, tau of plates and torques",
        source="Hughes 1986, chapters 8 and 9",
        space=replace(euler_top.SYSTEM.space, casimirs=None),
        parameters=PARAMETERS,
        integrals={},
        derive=derive,
        body_frame=body_frame,
        checks=Checks(check_parameters, doubts=naming(doubts, LETTERS), idle=naming(idle, LETTERS), lasting=lasting),
        scaling="SI units.",
        n=3,
    ),
)
