"""Tops, free bodies and bodies in water, judged by SciPy, published tables and facts that anyone can check."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.constants
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel import algebra
from kreisel.physical import Ellipsoid, FreeBody, Gyroscope, HeavyBody, Plate, Satellite, SubmergedBody
from kreisel.physical.orbit import Orbit

WHEEL = Gyroscope.flat("3 kg", "0.17 kg m^2", "15 cm")


def rates(model: Any, state: Any, **known: Any) -> list[np.ndarray]:
    """The flow, momenta as axial vectors."""
    values = [state[letter] for letter in model.system.space.letters]
    return [algebra.axial(x) if x.ndim == 2 else x for x in model.call(model.system.flow, *values, **known)]


# -- attitudes ----------------------------------------------------------------------------------------


def test_quaternions_are_those_of_scipy_with_the_scalar_first() -> None:
    p, q = np.random.default_rng(1).normal(size=(2, 50, 4))
    p, q = algebra.unit(p), algebra.unit(q)
    theirs = Rotation.from_quat(q, scalar_first=True)
    assert abs(algebra.rotation_matrix(q) - theirs.as_matrix()).max() < 1e-14
    both = Rotation.from_quat(p, scalar_first=True) * theirs
    assert abs(algebra.rotation_matrix(algebra.quaternion_product(p, q)) - both.as_matrix()).max() < 1e-14
    back = algebra.unit_quaternion(theirs.as_matrix())
    assert abs(abs((back * q).sum(-1)) - 1).max() < 1e-14


def test_the_attitude_takes_the_body_to_space() -> None:
    """A quarter turn about z takes the body's x to the space's y; Omega is SciPy's rotation vector, in the body."""
    body = FreeBody((0.3, 0.5, 0.6))
    motion = body.rotation((0.4, 1.0, 0.2))
    h = 1e-5
    for t in (0.0, 3.0, 11.0):
        velocity, attitude = motion.at(np.array([t - h, t, t + h]))
        before, here, after = (Rotation.from_quat(a, scalar_first=True) for a in attitude)
        assert velocity[1] == pytest.approx((before.inv() * after).as_rotvec() / (2 * h), abs=1e-8)
        start = Rotation.from_quat(motion.at(0.0)[1], scalar_first=True).apply((0.3 * 0.4, 0.5 * 1.0, 0.6 * 0.2))
        assert here.apply(body.inertia @ velocity[1]) == pytest.approx(start, abs=1e-12)
    upright = body.rotation((0, 0, np.pi / 2)).at(1.0)[1]
    assert Rotation.from_quat(upright, scalar_first=True).apply((1, 0, 0)) == pytest.approx((0, 1, 0), abs=1e-12)


# -- tops ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spin", [200.0, -200.0])
def test_a_fast_top_precesses_in_the_sense_of_its_spin(spin: float) -> None:
    """Its centre of mass above the pivot, at m g l/(I w), by the azimuth of its axis in a run."""
    run = kr.simulate(
        WHEEL.model(), WHEEL.state("40 deg", spin), dt=WHEEL.dt("1 ms"), steps=2000, every=20, progress=False
    )
    azimuth = np.unwrap(np.arctan2(run.a.values[:, 1], run.a.values[:, 0]))
    rate = np.polyfit(run.time.values * WHEEL.time_unit, azimuth, 1)[0]
    assert rate * spin > 0
    assert rate == pytest.approx(3 * scipy.constants.g * 0.15 / (0.17 * spin), rel=0.01)
    assert WHEEL.slow_precession(spin) == pytest.approx(3 * scipy.constants.g * 0.15 / (0.17 * spin), rel=1e-12)


def test_the_seconds_pendulum() -> None:
    """A point on a rod of 0.9936 m swings in 2 s; a rod of 1 m about its end in 1.638 s, as 2 pi sqrt(2 l/(3 g))."""
    for body, period in (
        (HeavyBody.about_centre(1.0, (1e-9, 1e-9, 1e-9), (0, 0, -0.9936)), 2.000),
        (HeavyBody.about_centre(1.0, (1 / 12, 1 / 12, 1e-9), (0, 0, -0.5)), 1.638),
    ):
        angle = 1e-4  # of the body about x
        up = Rotation.from_rotvec((angle, 0, 0)).as_matrix()[2]
        start = body.state((0, 0, 0), up)
        torque = rates(body.model(), start)[0][0] * body.momentum_unit / body.time_unit
        assert 2 * np.pi / np.sqrt(-torque / body.inertia[0, 0] / angle) == pytest.approx(period, abs=1e-3)


def test_a_weight_falls_and_hangs_down() -> None:
    """Released with its arm horizontal the centre of mass moves down; at rest below the pivot it stays."""
    body = HeavyBody.about_centre(2.0, (0.1, 0.1, 0.1), (0.3, 0, 0))
    M, _ = rates(body.model(), body.state((0, 0, 0)))
    fall = np.cross(np.linalg.solve(body.inertia, M), body.arm)
    assert fall[2] < 0 and abs(fall[:2]).max() == 0
    hanging, standing = (body.state((0, 0, 0), up) for up in ((-1, 0, 0), (1, 0, 0)))
    assert abs(rates(body.model(), hanging)[0]).max() < 1e-15
    height = [body.model().call(body.model().system.energy, s["M"], s["P"]) for s in (hanging, standing)]
    joule = body.scales()["energy"].size
    assert (height[1] - height[0]) * joule == pytest.approx(2 * 2.0 * scipy.constants.g * 0.3)


# -- free bodies --------------------------------------------------------------------------------------


def test_the_thrown_plate_of_feynman() -> None:
    """A flat disc wobbles twice as fast as it spins, for small angles."""
    plate = FreeBody((0.25, 0.25, 0.5))
    motion = plate.rotation((0.01, 0.0, 1.0))
    assert motion.precession == pytest.approx(2.0, rel=1e-3)


def test_the_earth_has_eulers_period() -> None:
    """305 days for A/(C - A) = 304.5: Euler, 1765; Chandler's is longer, since the Earth is not rigid."""
    earth = FreeBody((8.010e37, 8.010e37, 8.0365e37))  # IERS Conventions, C - A = 2.63e35
    motion = earth.rotation(7.292115e-5, (1e-6, 0, 1))
    assert motion.period / 86164.1 == pytest.approx(303, abs=3)


def test_a_racket_turns_over_about_its_middle_axis_only() -> None:
    racket = FreeBody((1.2e-3, 1.6e-2, 1.7e-2))
    assert [axis.kind for axis in racket.stability("60 rpm")] == ["stable", "unstable", "stable"]


def cloud(seed: int, kind: str, sizes: Any) -> np.ndarray:
    """Points of constant density in a box or an ellipsoid of these sides or diameters."""
    points = np.random.default_rng(seed).uniform(-0.5, 0.5, (400_000, 3))
    return (points if kind == "box" else points[(points**2).sum(-1) < 0.25]) * sizes


@pytest.mark.parametrize("kind", ["box", "ellipsoid"])
def test_inertia_of_a_cloud_of_points(kind: str) -> None:
    """Sum of m (r^2 - r r^T) over 400,000 points; about another point too (Steiner)."""
    sizes, arm = (0.3, 0.2, 0.1), np.array([0.1, -0.2, 0.3])
    points = cloud(3, kind, sizes)
    body = getattr(FreeBody, kind)(2.0, sizes)
    for shift, found in ((0, body.inertia), (arm, HeavyBody.about_centre(2.0, body.inertia, arm).inertia)):
        place = points + shift
        want = 2.0 * ((place**2).sum(-1).mean() * np.eye(3) - place.T @ place / len(place))
        assert abs(found - want).max() < 0.01 * want.max()
    cubesat = Satellite.cubesat(Orbit.circular("500 km"), units=3)
    assert cubesat.inertia == pytest.approx(FreeBody.box(3 * 1.33, (0.3, 0.1, 0.1)).inertia)


# -- water --------------------------------------------------------------------------------------------


def test_added_masses_of_the_tables() -> None:
    """Lamb's for a spheroid, computed by hand to 0.0025; a sphere drags along half of the fluid displaced."""
    body = Ellipsoid.of_density((2.0, 1.0, 1.0), 1000.0, 1000.0)
    found = [*(body.added_masses / body.mass)[:2], (body.added_moments / body.moments)[2]]
    assert found == pytest.approx((0.209, 0.702, 0.240), abs=2.5e-3)
    ball = Ellipsoid.of_density((0.1, 0.1, 0.1), 1000.0, 1000.0)
    assert ball.added_masses == pytest.approx(0.5 * ball.displaced_mass)
    assert ball.displaced_mass == pytest.approx(4.18879, rel=1e-5)  # kg of water in a ball of 20 cm


CAN: dict[str, Any] = {"mass": 1.0, "inertia": (0.01, 0.01, 0.01)}


def fluid_rates(body: SubmergedBody, **start: Any) -> list[np.ndarray]:
    """M' and P' at a start, the body's axes in space."""
    return rates(body.model(), body.state(**start), g=np.eye(3))


def test_what_is_lighter_than_water_rises() -> None:
    for displaced, sign in ((1.5, 1), (0.5, -1)):
        force = fluid_rates(SubmergedBody(**CAN, displaced_mass=displaced))[1]
        assert force == pytest.approx((0, 0, sign * 0.5 * scipy.constants.g))


def test_a_keel_rights_the_boat() -> None:
    """The weight below the buoyancy: heeled about x, the torque turns back; above it, over."""
    for height, sign in ((-0.1, -1), (0.1, 1)):
        body = SubmergedBody(**CAN, center_of_mass=(0, 0, height), center_of_buoyancy=(0, 0, 0))
        heel = Rotation.from_rotvec((0.2, 0, 0)).as_matrix()
        torque = rates(body.model(), body.state(), g=heel)[0]
        assert sign * torque[0] > 0
        assert abs(torque[0]) == pytest.approx(scipy.constants.g * 0.1 * np.sin(0.2))


@pytest.mark.parametrize("kind", ["linear_drag", "quadratic_drag"])
def test_drag_slows(kind: str) -> None:
    body = SubmergedBody(**CAN, **{kind: (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)})
    torque, force = fluid_rates(body, velocity=(2, 0, 0), angular_velocity=(0, 0, 0))
    assert force == pytest.approx((-2 if kind == "linear_drag" else -4, 0, 0)) and abs(torque).max() == 0
    torque, force = fluid_rates(body, velocity=(0, 0, 0), angular_velocity=(0, 0, -3))
    assert torque == pytest.approx((0, 0, 0.9 if kind == "linear_drag" else 2.7)) and abs(force).max() == 0


def test_a_long_body_turns_broadside_to_its_motion() -> None:
    """Munk's moment, by which airships and torpedoes need fins: the angle of attack grows."""
    body = SubmergedBody.ellipsoid((0.5, 0.1, 0.1), 20.0, 1000.0)
    attack = 0.1  # the velocity to the left of the nose
    torque = fluid_rates(body, velocity=(np.cos(attack), np.sin(attack), 0))[0]
    assert torque[2] < 0  # the nose turns to the right
    added = body.added_mass.diagonal()
    assert torque[2] == pytest.approx(-0.5 * (added[1] - added[0]) * np.sin(2 * attack), rel=1e-6)


def test_a_river_carries_what_floats_in_it() -> None:
    """At rest in the water nothing acts; at rest on the bank the water pushes downstream."""
    body = SubmergedBody(**CAN, linear_drag=(1, 1, 1, 1, 1, 1), current=(0.7, 0, 0))
    assert abs(fluid_rates(body, velocity=(0.7, 0, 0))[1]).max() < 1e-15
    assert fluid_rates(body)[1] == pytest.approx((0.7, 0, 0))


def test_plates_are_seen_from_their_front() -> None:
    """The normal points outwards: light on the back does nothing."""
    far = Orbit.circular("500 km")
    for side, lit in ((1, True), (-1, False)):
        plate = Plate((side, 0, 0), (0, 0.1, 0), "100 cm^2")
        body = Satellite((1, 1, 1), far, plates=(plate,), light=1.0, sun=(1, 0, 0))
        (rate,) = body.model().call(body.model().system.flow, np.zeros((3, 3)), g=np.eye(3), t=np.float64(0))
        assert algebra.axial(rate) == pytest.approx((0, 0, 1e-3) if lit else (0, 0, 0), abs=1e-9)
