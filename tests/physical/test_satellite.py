"""Satellites on Kepler orbits: the orbit, the torques by other formulas, librations, names, archives, bad input."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import lpmv

import kreisel as kr
from kreisel import algebra
from kreisel.algebra.gradient import value_and_gradient
from kreisel.analysis.frequencies import lines_of
from kreisel.bodies import BODIES, orbit, satellite
from kreisel.physical import (
    EARTH,
    SOLAR_PRESSURE,
    SUN,
    Asteroid,
    Gyroscope,
    Harmonics,
    Orbit,
    Plate,
    Primary,
    Satellite,
    Wheels,
)
from kreisel.storage.checking import steps_again
from kreisel.sweeps.sweep import check_archive
from sizes import FULL
from support import cross
from torques import torque_on

ELLIPSE = Orbit("7000 km", 0.02, "51.6 deg", "20 deg", "70 deg")
LOW = Orbit.circular("500 km", "97 deg")


@pytest.mark.parametrize("e", [0.0, 0.1, 0.7, 0.9, 0.99, 0.999])
def test_kepler(e: float) -> None:
    """The place on the orbit to 1e-14, at the pericentre too, by Newton's method in many digits."""
    draw = np.random.default_rng(int(1000 * e))
    mean = np.concatenate([draw.uniform(-np.pi, np.pi, 60), 10.0 ** draw.uniform(-12, 0, 40)])
    E = orbit.eccentric_anomaly(mean, e)
    with mpmath.workdps(30):
        for M, found in zip(mean.tolist(), E.tolist(), strict=True):
            true = mpmath.findroot(lambda x, M=M: x - e * mpmath.sin(x) - M, found)
            assert abs(mpmath.cos(true) - mpmath.cos(found)) < 1e-14
            assert abs(mpmath.sin(true) - mpmath.sin(found)) < 1e-14


def test_whole_turns_do_not_matter() -> None:
    turns = 2 * np.pi * np.arange(-20, 21)
    assert abs(orbit.eccentric_anomaly(1.3 + turns, 0.3) - orbit.eccentric_anomaly(1.3, 0.3)).max() < 1e-12


def test_the_anomaly_has_a_derivative_everywhere() -> None:
    """dE/dM = 1/(1 - e cos E), by the reverse sweep, at M = 0 and pi too."""
    for mean in (0.0, 0.4, np.pi, -2.0):
        _, (slope,) = value_and_gradient(lambda x: orbit.eccentric_anomaly(x, 0.4), [(np.array(mean), 0)])
        assert slope == pytest.approx(1 / (1 - 0.4 * np.cos(orbit.eccentric_anomaly(mean, 0.4))), rel=1e-12)


def test_orbit() -> None:
    """Energy and angular momentum of the Kepler problem, the period, and the elements."""
    t = np.linspace(0, 3 * ELLIPSE.period, 50)
    r, v = ELLIPSE.at(t)
    mu, a, e = EARTH.mu, ELLIPSE.semi_major_axis, ELLIPSE.eccentricity
    distance = np.linalg.norm(r, axis=-1)
    assert (v * v).sum(-1) / 2 - mu / distance == pytest.approx(-mu / (2 * a), rel=1e-12)
    h = np.cross(r, v)
    assert abs(h - h[0]).max() < 1e-12 * np.sqrt(mu * a)
    assert np.linalg.norm(h[0]) == pytest.approx(np.sqrt(mu * a * (1 - e * e)), rel=1e-12)
    assert h[0, 2] / np.linalg.norm(h[0]) == pytest.approx(np.cos(ELLIPSE.inclination), rel=1e-12)
    assert distance[0] == pytest.approx(ELLIPSE.pericentre, rel=1e-14)
    assert r[-1] == pytest.approx(r[0], abs=1e-5)
    node = np.cross((0, 0, 1.0), h[0])
    assert np.arctan2(node[1], node[0]) == pytest.approx(ELLIPSE.node, abs=1e-12)
    frame = ELLIPSE.frame(t)
    assert abs(frame.mT @ frame - np.eye(3)).max() < 1e-14
    assert (np.linalg.det(frame) > 0).all()


def by_hand(body: Satellite, g: np.ndarray, t: float, spin: np.ndarray) -> np.ndarray:
    """The same by the textbook's formulas, vectors in principal axes."""
    along, orbit = body.body.principal.axes, body.orbit
    r, v = (x @ g for x in orbit.at(t))
    distance = np.linalg.norm(r)
    inertia, up = np.diag(body.body.principal.moments), r / np.linalg.norm(r)
    total = 3 * orbit.primary.mu / distance**3 * cross(up, inertia @ up)
    north = g[2]
    field = -orbit.primary.field / distance**3 * (north - 3 * (north @ up) * up)
    total = total + cross(body.magnetic_moment @ along, field) + body.torque @ along
    sun, speed = body.model().params["sun"] @ g, np.linalg.norm(v)
    for plate in body.plates:
        n, c = plate.normal @ along, plate.centre @ along
        if n @ v > 0:
            total = total + cross(c, -body.density / 2 * body.drag * plate.area * (n @ v / speed) * speed * v)
        if (lit := n @ sun) > 0:
            push = (1 - body.mirror) * sun + 2 * (body.mirror * lit + body.diffuse / 3) * n
            total = total + cross(c, -body.light * plate.area * lit * push)
    if body.wheels is not None:
        total = total + cross(body.wheels.momenta @ body.wheels.axes @ along, spin)
    return total


LOADED = {
    "magnetic_moment": (0.01, -0.02, 0.03),
    "torque": (1e-8, 2e-8, -1e-8),
    "density": 3e-12,
    "light": SOLAR_PRESSURE,
    "sun": (1.0, 2.0, -0.5),
    "mirror": 0.3,
    "diffuse": 0.2,
    "plates": (
        Plate((1, 0, 0), (0.1, 0.05, 0), "300 cm^2"),
        Plate((-1, 2, 0.5), (0.0, 0.1, -0.1), 0.02),
        Plate((0, -1, 0), (0.02, -0.1, 0.0), 0.05),
    ),
}
TENSOR = np.array([[0.03, 0.004, -0.002], [0.004, 0.05, 0.001], [-0.002, 0.001, 0.04]])


SKEW = ((0.6, 0.0, 0.8), (0.0, 1.0, 0.0))  # axes of wheels


@pytest.mark.parametrize("wheels", [None, Wheels(SKEW, (1e-3, -2e-3))], ids=["no wheels", "wheels"])
def test_torques_by_other_formulas(wheels: object) -> None:
    """Each part alone and all together; what is left out would show."""
    draw = np.random.default_rng(3)
    plates = {"plates": LOADED["plates"]}
    parts = [{}, *({k: v} for k, v in LOADED.items() if k in ("magnetic_moment", "torque"))]
    parts += [{**plates, "density": 3e-12}, {**plates, **{k: LOADED[k] for k in ("light", "sun", "mirror", "diffuse")}}]
    for given in (*parts, LOADED):
        body = Satellite(TENSOR, ELLIPSE, wheels=wheels, **given)
        for _ in range(5):
            g = algebra.rotation_matrix(algebra.unit(draw.normal(size=4)))
            t, spin = draw.uniform(0, 2e4), 1e-2 * draw.normal(size=3)
            want = by_hand(body, g, t, spin)
            assert abs(torque_on(body, g, t, spin) - want).max() < 1e-11 * max(abs(want).max(), 1e-9)


def test_a_torque_that_is_wrong_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant: the gradient of gravity by one part in a million too strong."""
    right = satellite.BODIES[0].perturbation.potential.function

    def wrong(*letters: object, mu: float, **known: object) -> object:
        return right(*letters, mu=mu * (1 + 1e-6), **known)

    body, g, spin = Satellite(TENSOR, ELLIPSE), np.eye(3), np.array([0.0, 1e-3, 1e-3])
    monkeypatch.setitem(satellite.BODIES[0].perturbation.potential.__dict__, "function", wrong)
    want = by_hand(body, g, 77.0, spin)
    assert abs(torque_on(body, g, 77.0, spin) - want).max() > 1e-7 * abs(want).max()


ROCK = Orbit(100.0, 0.1, 0.4, 0.3, 0.2, Primary("rock", 1e5, 50.0))


def of_points(masses: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, dict[tuple[int, int], tuple[float, float]]]:
    """Inertia and coefficients C_lm, S_lm for R = 1 of point masses, by associated Legendre functions of SciPy."""
    distance, total = np.linalg.norm(points, axis=-1), masses.sum()
    longitude, sine = np.arctan2(points[:, 1], points[:, 0]), points[:, 2] / distance
    found = {}
    for degree in (3, 4):
        for order in range(degree + 1):
            share = (2 - (order == 0)) * math.factorial(degree - order) / math.factorial(degree + order)
            part = (-1) ** order * share * masses * distance**degree * lpmv(order, degree, sine) / total
            found[degree, order] = (part @ np.cos(order * longitude), part @ np.sin(order * longitude))
    inertia = np.einsum(
        "i,ijk->jk", masses, distance[:, None, None] ** 2 * np.eye(3) - points[:, :, None] * points[:, None]
    )
    return inertia, found


@pytest.mark.parametrize(("keep", "least", "most"), [(4, 0, 3e-5), (3, 1e-4, 1), (2, 1e-3, 1)])
def test_gravity_of_higher_order(keep: int, least: float, most: float) -> None:
    """Against the sum of the forces on point masses 1 m apart, 100 m away; worse where degrees are left out."""
    draw = np.random.default_rng(8)
    masses, points = draw.uniform(1, 3, 6), draw.normal(size=(6, 3))
    points -= masses @ points / masses.sum()
    inertia, coefficients = of_points(masses, points)
    given = {key: value for key, value in coefficients.items() if key[0] <= keep}
    body = Satellite(inertia, ROCK, harmonics=Harmonics(masses.sum(), 1.0, given))
    worst = largest = 0.0
    for _ in range(10):
        attitude, t = algebra.unit(draw.normal(size=4)), draw.uniform(0, 100)
        place = points @ algebra.rotation_matrix(attitude).T
        there = ROCK.at(t)[0] + place
        forces = -ROCK.primary.mu * masses[:, None] * there / np.linalg.norm(there, axis=-1, keepdims=True) ** 3
        want = np.cross(place, forces).sum(0)
        g = algebra.rotation_matrix(body.orientation(attitude))
        got = g @ torque_on(body, g, t, np.array([0.1, 0.2, -0.1]))
        worst, largest = max(worst, abs(got - want).max()), max(largest, abs(want).max())
    assert least * largest <= worst < most * largest


def test_the_momentum_that_wheels_take() -> None:
    """Far from the primary g (M + h) is constant, with h of wheels that motors turn: they take what the body loses."""
    far = Orbit(1e12, primary=SUN)
    body = Satellite(TENSOR, far, wheels=Wheels(SKEW, (1e-3, 2e-3), torque=(2e-5, "-0.03 mN m")))
    run = kr.simulate(
        body.model(),
        body.state((0.02, 0.1, -0.05)),
        dt=2.0,
        steps=200,
        orientation=body.orientation(),
        progress=False,
    )
    g, along = algebra.rotation_matrix(run.g.values), body.body.principal.axes
    momenta = np.array([1e-3, 2e-3]) + run.time.values[:, None] * [2e-5, -3e-5]
    assert run.wheels.values == pytest.approx(momenta, rel=1e-12)
    total = np.einsum("tij,tj->ti", g, run.M.values + momenta @ SKEW @ along)
    assert abs(total - total[0]).max() < 1e-11 * abs(total[0]).max()
    alone = np.einsum("tij,tj->ti", g, run.M.values)
    assert abs(alone - alone[0]).max() > 0.5 * abs(total[0]).max()


def textbook(body: Satellite, spin: object, attitude: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The attitude as a matrix at each time, by DOP853 of Hughes' equations in space: H = R (I w + h), H' = R (torque).

    Body axes, the tensor with its products; the torque of gravity from the inverse square.
    [Hughes 1986, sections 3.5 and 9.1]
    """
    moments, orbit = np.asarray(body.inertia), body.orbit
    wheel, motor = body.wheels.momenta @ body.wheels.axes, body.wheels.torque @ body.wheels.axes

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        q = z[3:] / np.sqrt(z[3:] @ z[3:])
        R = (q[0] ** 2 - q[1:] @ q[1:]) * np.eye(3) + 2 * np.outer(q[1:], q[1:])
        R = R + 2 * q[0] * np.array([[0, -q[3], q[2]], [q[3], 0, -q[1]], [-q[2], q[1], 0]])
        x, y, z_ = np.linalg.solve(moments, R.T @ z[:3] - wheel - motor * t)
        r = R.T @ orbit.at(t)[0]
        gravity = 3 * orbit.primary.mu / np.sqrt(r @ r) ** 5 * cross(r, moments @ r)
        turning = np.array([[0, -x, -y, -z_], [x, 0, z_, -y], [y, -z_, 0, x], [z_, y, -x, 0]])
        return np.concatenate([R @ (gravity + body.torque), turning @ z[3:] / 2])

    R = algebra.rotation_matrix(attitude)
    start = np.concatenate([R @ (moments @ np.asarray(spin) + wheel), attitude])
    size = np.concatenate([np.full(3, np.linalg.norm(start[:3])), np.ones(4)])
    found = solve_ivp(rates, (0, times[-1]), start, method="DOP853", rtol=1e-9, atol=1e-10 * size, t_eval=times).y.T
    return algebra.rotation_matrix(algebra.unit(found[:, 3:]))


MICROSATELLITE = np.array([[8.0, 0.5, -0.3], [0.5, 10.0, 0.2], [-0.3, 0.2, 12.0]])  # 100 kg
HALF_A_MINUTE = {  # inertia, wheel N m s, its torque, the most that an attitude may differ from the textbook
    "3U": ((0.0067, 0.033, 0.034), (0, 1.5e-3, 0), (0, 0, 0), 1e-6),
    "100 kg": (MICROSATELLITE, (0, -1.0, 0), (0, 0, 0), 1e-6),
    "100 kg, a wheel that slows": (MICROSATELLITE, (0.2, -1.0, 0.1), (0, 2e-6, 0), 1e-6),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(k, marks=pytest.mark.skipif(not FULL, reason="`make test-full` runs it")) for k in ("3U", "100 kg")]
    + ["100 kg, a wheel that slows"],
)
def test_half_a_minute_with_a_wheel(name: str) -> None:
    """100 steps by 30 s, in which the body would nutate by 2 to 3 radians, against the textbook's equations."""
    inertia, wheel, motor, most = HALF_A_MINUTE[name]
    body = Satellite(inertia, ELLIPSE, wheels=Wheels(np.eye(3), wheel, motor), torque=(1e-9, 0, 0))
    spin, attitude = (2e-4, -1.1e-3, 1e-4), algebra.unit(np.array([0.9, 0.2, -0.3, 0.1]))
    options = {"orientation": body.orientation(attitude), "progress": False}
    run = kr.simulate(body.model(), body.state(spin), dt=30.0, steps=100, every=50, **options)
    off = algebra.rotation_matrix(body.attitude(run.g.values)) - textbook(body, spin, attitude, run.time.values)
    assert abs(off).max() < most


@pytest.mark.parametrize(("share", "steady"), [(0.8, False), (1.2, True)])
def test_a_wheel_steadies_a_spin_about_the_middle_axis(share: float, steady: bool) -> None:
    """Beyond h = (I_3 - I_2) times the spin, by the criterion of dual spin; without a wheel it tumbles.

    (h + (I_2 - I_1) spin)(h + (I_2 - I_3) spin) > 0.  [Hughes 1986, section 6.3]
    """
    spin = 0.02
    body = Satellite((8, 10, 12), Orbit(1e12, primary=SUN), wheels=Wheels([[0, 1, 0]], share * (12 - 10) * spin))
    state, g = body.state((1e-5, spin, 1e-5)), body.orientation()
    run = kr.simulate(body.model(), state, dt=30.0, steps=300, orientation=g, progress=False)
    tilt = np.arccos(algebra.rotation_matrix(run.g.values)[:, 1, 1])
    assert (tilt.max() < 0.01) == steady and (tilt.max() > 0.5) == (not steady)


def test_a_wheel_that_changes_keeps_the_order() -> None:
    """The torque of the motor is part of the kicks: half of the step divides the error by 2^6 or more."""
    wheels = Wheels(np.eye(3), (0.2, -1.0, 0.1), (1e-4, 2e-4, -1e-4))
    body = Satellite(MICROSATELLITE, LOW, wheels=wheels)
    options = {"orientation": body.orientation(), "progress": False, "observe": []}

    def state(dt: float, order: object = (8, 6, 4)) -> np.ndarray:
        run = kr.simulate(body.model(), body.state(), dt=dt, steps=round(600 / dt), order=order, **options)
        return np.concatenate([run.M.values[-1] / 0.1, run.g.values[-1]])

    truth = state(1.25, 8)
    errors = [abs(state(dt) - truth).max() for dt in (40.0, 20.0, 10.0)]
    assert 2**5 < errors[0] / errors[1] and 2**5 < errors[1] / errors[2]


def test_corners_of_plates_limit_the_order() -> None:
    """Half the step divides the error by some 4 and not by 2^8 where plates leave the light; the balance says so."""
    errors, said = {}, {}
    for light in (0.0, 100 * SOLAR_PRESSURE):
        body = Satellite.cubesat(LOW, center_of_mass=("3 cm", "1 cm", "-1 cm"), light=light, sun=(1, 2, -0.5))
        options = {"orientation": body.orientation(), "progress": False}

        def run(dt: float, body: Satellite = body, options: dict[str, Any] = options) -> Any:
            start, steps = body.state((0.01, 0.02, -0.015)), round(1200 / dt)
            return kr.simulate(body.model(), start, dt=dt, steps=steps, every=steps, **options)

        truth = run(0.25)
        errors[light > 0] = [float(abs(run(dt).g[-1] - truth.g[-1]).max()) for dt in (40.0, 10.0)]
        said[light > 0] = "O(dt^2) where a force has a corner" in truth.balance.attrs["long_name"]
    assert said == {False: False, True: True}
    assert errors[False][0] < 1e-7 and errors[True][0] > 1e-5 and errors[True][1] > 1e-3 * errors[True][0]


@pytest.mark.skipif(not FULL, reason="`make test-full` runs it")
@pytest.mark.parametrize(
    "cause", [{"light": SOLAR_PRESSURE, "sun": (1, 2, -0.5)}, {"density": 5e-13}], ids=["light", "air"]
)
def test_the_step_through_corners_is_found(cause: dict[str, Any]) -> None:
    """An hour of tumbling, against the equations of the textbook by DOP853 at 1e-12; dt = 10 s is off by 4e-6."""
    body = Satellite.cubesat(LOW, center_of_mass=("3 cm", "1 cm", "-1 cm"), **cause)
    along, moments, spin = body.body.principal.axes, body.body.principal.moments, np.array([0.016, 0.017, 0.010])

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        w, q = y[:3], y[3:] / np.sqrt(y[3:] @ y[3:])
        tau = by_hand(body, algebra.rotation_matrix(q), t, w) - cross(w, moments * w)
        turning = np.array([-q[1:] @ w, *(q[0] * w + cross(q[1:], w))]) / 2
        return np.concatenate([tau / moments, turning])

    g = algebra.unit_quaternion(along)  # of the principal axes
    start, times = np.concatenate([spin @ along, g]), [3600.0]
    end = solve_ivp(rates, (0, 3600), start, method="DOP853", rtol=1e-12, atol=1e-15, t_eval=times).y[3:, 0]
    truth = algebra.rotation_matrix(algebra.unit(end)) @ along.T

    def off(**more: Any) -> tuple[float, Any]:
        begun = body.state(spin=spin, attitude=(1.0, 0.0, 0.0, 0.0))
        run = kr.simulate(body, begun, t_end=3600.0, progress=False, **more)
        return abs(algebra.rotation_matrix(run.attitude.values[-1]) - truth).max(), run

    assert off(dt=10.0)[0] > 4e-6
    error, run = off(every="20 min")  # step and order by default
    assert error < 1e-6 and error / 10 < kr.analysis.error(run).attitude.values.max() < 1e-6


def test_step_and_order_by_default() -> None:
    """Chosen for 1e-6 rad, against the equations of the textbook; what is given is not changed."""
    wheels = Wheels([(0.0, 1.0, 0.0)])
    body, spin = Satellite((0.03, 0.025, 0.012), LOW, wheels=wheels), np.array([0.016, 0.017, 0.010])
    start = body.state(spin=spin, attitude=(1.0, 0.0, 0.0, 0.0))
    run = kr.simulate(body, start, t_end="30 min", every="10 min", progress=False)
    truth = textbook(body, spin, np.array([1.0, 0, 0, 0]), run.time.values)
    assert abs(algebra.rotation_matrix(run.attitude.values) - truth).max() < 1e-6 and run.time[1] == 600
    assert run.attrs["dt"] > 10 and 0 < json.loads(run.attrs["options"])["expected_error"] < 2.5e-7
    assert len(kr.simulate(body, start, t_end="30 min", progress=False).time) == 1001
    short = kr.simulate(body, start, dt=5.0, t_end="1 min", progress=False)
    assert short.attrs["dt"] == 5 and "expected_error" not in json.loads(short.attrs["options"])
    sampled = Satellite(body.inertia, LOW, control=kr.Control(lambda rates: {"torque": -1e-5 * rates}, every="2 s"))
    assert kr.simulate(sampled, sampled.state(spin), t_end="1 min", progress=False).attrs["dt"] == 2
    rows = [{"t_end": 60.0, "every": count} for count in (5, np.int64(5))]
    for options in ({"steps": 5}, {"t_end": 60.0, "order": 4}, *rows, {"times": [1.0, 2.0]}):
        with pytest.raises(kr.InputError, match="dt: expected the step"):
            kr.simulate(body, start, progress=False, **options)
    for options in ({"t_end": -60.0}, {"t_end": 0.0}, {"t_end": 60.0, "t_start": 90.0}):
        with pytest.raises(kr.InputError, match=r"^t_end"):
            kr.simulate(body, start, progress=False, **options)
    free = kr.physical.FreeBody(body.inertia)
    with pytest.raises(kr.InputError, match="dt: expected the step"):
        kr.simulate(free, free.state(spin), t_end=1.0, progress=False)


def test_light_turns_a_box_about_another_point_than_its_centre() -> None:
    """All of its force acts at the centre: the torque is -center_of_mass x F, and 0 for a homogeneous box."""
    draw, given = np.random.default_rng(5), {"light": SOLAR_PRESSURE, "sun": (1.0, 2.0, -0.5)}
    far = Orbit(1e12, primary=SUN)
    centred, beside = (
        Satellite.cubesat(far, center_of_mass=c, **given) for c in ((0, 0, 0), ("3 cm", "1 cm", "-2 cm"))
    )
    for _ in range(5):
        g = algebra.rotation_matrix(algebra.unit(draw.normal(size=4)))
        sun = centred.model().params["sun"] @ g
        force = -SOLAR_PRESSURE * np.maximum([p.normal @ sun * p.area for p in centred.plates], 0).sum() * sun
        want = -np.cross((0.03, 0.01, -0.02), force)
        assert abs(torque_on(centred, g, 0.0, np.zeros(3))).max() < 1e-6 * abs(want).max()
        assert abs(torque_on(beside, g, 0.0, np.zeros(3)) - want).max() < 1e-6 * abs(want).max()


def librated(body: Satellite, dt: float, steps: int, every: int, **turned: float) -> object:
    g = body.orientation(body.pointing(**turned))
    return kr.simulate(body.model(), body.state(), dt=dt, steps=steps, every=every, orientation=g, progress=False)


def test_upright_on_a_circular_orbit_stays() -> None:
    """The relative equilibrium, in principal axes that are not those of the body."""
    body = Satellite(TENSOR, LOW)
    angles = body.angles(librated(body, 60.0, 600, 20))
    assert max(abs(a).max() for a in angles) < 1e-7


def test_angles_are_those_of_pointing() -> None:
    body = Satellite(TENSOR, ELLIPSE)
    run = librated(body, 1.0, 1, 1, yaw=0.3, pitch=-0.2, roll=0.1)
    found = [a[0] for a in body.angles(run)]
    assert found == pytest.approx([-0.2, 0.1, 0.3], abs=1e-12)


def test_a_run_on_another_orbit_has_no_angles() -> None:
    run = librated(Satellite(TENSOR, ELLIPSE), 1.0, 1, 1)
    other = Satellite(TENSOR, Orbit("7000 km", 0.02, "51.7 deg", "20 deg", "70 deg"))
    for read in (other.angles, other.obliquity, lambda run: other.resonant_angle(run, 1.0)):
        with pytest.raises(kr.InputError, match="run of this body, got one with another inclination"):
            read(run)


def test_axes_are_those_of_the_body_of_the_run() -> None:
    """`pointing` has the axis of the largest moment along the normal of the orbit of each lane."""
    orbits = (ELLIPSE, Orbit("7500 km", 0.1, "30 deg"))
    many = kr.physical.Ensemble([Satellite(TENSOR, orbit) for orbit in orbits], names=["low", "high"])
    run = kr.simulate(many, many.state(), dt="1 s", steps=1, progress=False)
    for body, name in zip(many, many.names, strict=True):
        assert body.obliquity(run.sel(lane=name))[0] == pytest.approx(0.0, abs=1e-12)
    other = Satellite(np.diag([5.0, 4.0, 3.0]), ELLIPSE)
    for read in (other.obliquity, lambda run: other.resonant_angle(run, 1.0)):
        with pytest.raises(kr.InputError, match="run of this body, got one with another moments"):
            read(run.sel(lane="low"))


def test_rest_against_the_orbit_in_any_attitude() -> None:
    """The angular velocity in space is r x v/r^2."""
    body, (r, v) = Satellite(TENSOR, ELLIPSE), ELLIPSE.at(0.0)
    lanes = np.stack([body.pointing(pitch=0.3), body.pointing(yaw=0.4, roll=0.3)])
    Omega = body.angular_velocity(body.state(attitude=lanes).axial.M)
    for q, rate in zip(lanes, Omega, strict=True):
        assert algebra.rotation_matrix(q) @ rate == pytest.approx(np.cross(r, v) / (r @ r), abs=1e-15)
    assert body.state().axial.M == pytest.approx(body.state(attitude=lanes[0]).axial.M, abs=1e-18)
    start = body.state((0, 0, 1), attitude=lanes[0])
    assert start.orientation == pytest.approx(body.orientation(lanes[0]))


def test_librations_have_the_frequencies_of_linear_theory() -> None:
    body = Satellite((0.4, 0.9, 1.0), LOW)
    run = librated(body, 60.0, 4000, 2, yaw=1e-4, pitch=1e-4, roll=1e-4)
    angles, want = body.angles(run), body.librations
    (pitch,) = lines_of(run.time.values, angles.pitch, 1).frequency
    roll = sorted(lines_of(run.time.values, angles.roll, 2).frequency)
    assert [pitch, *roll] == pytest.approx(list(want), rel=2e-4)


@pytest.mark.parametrize("wheels", [None, Wheels([[0, 0, 1]], 1e-4)], ids=["no wheels", "a wheel"])
def test_against_dop853(wheels: object) -> None:
    body = Satellite.cubesat(ELLIPSE, 3, wheels=wheels, density=1e-13, light=SOLAR_PRESSURE, torque=(0, 0, 1e-9))
    g = body.orientation(body.pointing(pitch=0.2, roll=0.1))
    given = {"steps": 400, "dt": 30.0, "every": 100, "orientation": g, "progress": False}
    run = kr.simulate(body.model(), body.state(), **given)
    ref = kr.simulate(body.model(), body.state(), **given, method="dop853", tol=1e-12)
    assert abs(run.M - ref.M).max() < 1e-6 * abs(ref.M).max()
    assert abs(run.balance - run.balance[0]).max() < 1e-6 * abs(run.energy).max()


def test_hyperion() -> None:
    """(B - A)/C = 0.264.  [Wisdom, Peale, Mignard 1984]"""
    body = Asteroid.hyperion()
    A, B, C = body.body.principal.moments
    assert (B - A) / C == pytest.approx(0.264, abs=5e-4)
    assert body.orbit.period == pytest.approx(21.28 * 86400, rel=1e-12)
    assert np.isfinite(body.model().constants["c"]).all()  # moments of 1e29


def test_moments_of_any_size() -> None:
    model = kr.EulerTop(J=(1e25, 2e25, 3e25))
    assert model.constants["c"][0, 1] == pytest.approx(1 / 3e25, rel=1e-15, abs=0)
    assert not np.diag(model.constants["c"]).any()


TOML = """
[system]
name = "satellite"
moments = [0.0067, 0.033, 0.034]
semi_major_axis = 6_878_137.0
eccentricity = 0.01
field = -7.6e15
dipole = [0.0, 0.0, 1e-4]

[state]
M = [0.0, 1e-6, 3.7e-5]
orientation = [1.0, 0.0, 0.0, 0.0]

[run]
dt = 60
steps = 200

[output]
path = "satellite.zarr"
"""


def test_by_name_on_disk(tmp_path: Path, kreisel: Any) -> None:
    """`kreisel run`, `check`, the same bits from Python; a change in the rows is found, at times other than 0."""
    (tmp_path / "satellite.toml").write_text(TOML, encoding="utf-8")
    assert kreisel("run", "satellite.toml").returncode == 0
    whole = kr.open_run(tmp_path / "satellite.zarr").load()
    assert whole.attrs["system"] == "satellite"
    assert check_archive(tmp_path / "satellite.zarr")[1] == []
    changed = whole.copy(deep=True)
    changed["M"][101:] *= 1 + 1e-5
    assert steps_again(changed)
    model = BODIES["satellite"](
        moments=(0.0067, 0.033, 0.034),
        semi_major_axis=6_878_137.0,
        eccentricity=0.01,
        field=-7.6e15,
        dipole=(0, 0, 1e-4),
    )
    again = kr.simulate(
        model, model.state(M=(0.0, 1e-6, 3.7e-5)), dt=60, steps=200, orientation=(1, 0, 0, 0), progress=False
    )
    for name in ("M", "g", "energy", "balance"):
        assert (again[name].values == whole[name].values).all()


def test_lanes_are_satellites() -> None:
    """An ensemble over the inclination agrees with single runs."""
    inclinations = np.array([0.1, 0.9, 1.7])
    given = {"moments": (0.0067, 0.033, 0.034), "semi_major_axis": 7e6, "field": -7.6e15, "dipole": (0, 0, 1e-4)}
    asked = {"dt": 30.0, "steps": 50, "orientation": (1, 0, 0, 0), "progress": False, "observe": ()}
    model = BODIES["satellite"](**given, inclination=inclinations)
    together = kr.simulate(model, model.state(M=(0, 0, 3e-5)), **asked)
    for lane, inclination in enumerate(inclinations):
        one = BODIES["satellite"](**given, inclination=inclination)
        alone = kr.simulate(one, one.state(M=(0, 0, 3e-5)), **asked)
        assert abs(alone.M - together.M[:, lane]).max() < 1e-12 * abs(alone.M).max()


SMALL = {"moments": (1, 1, 1), "semi_major_axis": 7e6}
BAD = {
    "hits": (lambda: Orbit("500 km"), "hits the Earth"),
    "hyperbola": (lambda: Orbit(7e6, 1.2), "0 <= e < 1"),
    "negative e": (lambda: Orbit(7e6, -0.1), "0 <= e < 1"),
    "units": (lambda: Orbit("3 kg"), "dimension of m"),
    "primary": (lambda: Orbit(7e6, primary="Mars"), "expected kr.physical.EARTH"),
    "triangle": (lambda: Satellite((1, 1, 3), LOW), "sum of the other two"),
    "orbit": (lambda: Satellite((1, 1, 1), 7e6), "expected kr.physical.Orbit"),
    "plate": (lambda: Satellite((1, 1, 1), LOW, plates=((1, 0),)), "expected Plate"),
    "area": (lambda: Satellite((1, 1, 1), LOW, plates=(Plate((1, 0, 0), (0, 0, 0), -1),)), ">= 0"),
    "normal": (lambda: Satellite((1, 1, 1), LOW, plates=(Plate((0, 0, 0), (0, 0, 0), 1),)), "zero vector"),
    "mirror": (lambda: Satellite((1, 1, 1), LOW, mirror=0.8, diffuse=0.4), "at most 1"),
    "density": (lambda: Satellite((1, 1, 1), LOW, density=-1), ">= 0"),
    "moments": (
        lambda: BODIES["satellite"](moments=(1, 1, 3), semi_major_axis=7e6),
        "exceeds the sum of the other two",
    ),
    "ellipse": (lambda: BODIES["satellite"](moments=(1, 1, 1), semi_major_axis=7e6, eccentricity=1.0), "ellipse"),
    "size": (lambda: BODIES["satellite"](moments=(1, 1, 1), semi_major_axis=-7e6), "number > 0"),
    "light": (lambda: BODIES["satellite"](**SMALL, mirror=0.8, diffuse=0.4), "at most 1"),
    "part": (lambda: BODIES["satellite"](**SMALL, mirror=-0.1), "from 0 to 1"),
    "pressure": (lambda: BODIES["satellite"](**SMALL, pressure=-1), ">= 0"),
    "sun": (lambda: BODIES["satellite"](**SMALL, sun=(1, 1, 0)), "length 1"),
    "hits by name": (
        lambda: BODIES["satellite"](**SMALL, eccentricity=0.3),
        "hits the primary: its pericentre is 4.9e",
    ),
    "km": (lambda: BODIES["satellite"](moments=(1, 1, 1), semi_major_axis=7000), "km for m"),
    "motors": (lambda: Wheels(np.eye(3), torque=(1, 0)), "torque must be finite values"),
    "harmonics": (lambda: Satellite((1, 1, 1), LOW, harmonics={(3, 0): (1, 0)}), "expected Harmonics"),
    "degree": (lambda: Satellite((1, 1, 1), LOW, harmonics=Harmonics(1, 1, {(2, 0): (1, 0)})), "l = 3 or 4"),
    "order": (lambda: Satellite((1, 1, 1), LOW, harmonics=Harmonics(1, 1, {(3, 4): (1, 0)})), "0 <= m <= l"),
    "coefficient": (lambda: Satellite((1, 1, 1), LOW, harmonics=Harmonics(1, 1, {(3, 1): 1.0})), "shape"),
    "seven": (lambda: BODIES["satellite"](**SMALL, degree_3=np.zeros(6)), "expected 7 values"),
    "nine": (lambda: BODIES["satellite"](**SMALL, degree_4=np.zeros(6)), "expected 9 values"),
    "rows": (lambda: BODIES["satellite"](moments=(1, 1, 1), semi_major_axis=7e6, plates=[[1.0]]), "rows of 7"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str) -> None:
    make, words = BAD[name]
    with pytest.raises(kr.InputError, match=words):
        make()


def test_a_primary_of_your_own() -> None:
    moon = Primary("Moon", 4.9028e12, 1.7374e6)
    assert Orbit.circular("100 km", primary=moon).period == pytest.approx(7067, abs=10)
    named = Primary("Moon", "4902.8 km^3/s^2", "1737.4 km")
    assert Orbit.circular("100 km", primary=named).period == pytest.approx(7067, abs=10)


WHEEL = Gyroscope.flat(3.0, 0.17, 0.15)
SLIPS: dict[str, tuple[Any, str]] = {
    "altitude": (lambda: Orbit.circular(550), "within 550 m of the surface of the Earth.*'550 km'"),
    "perigee in the air": (lambda: Orbit("7000 km", 0.08), "within 61863 m"),
    "moon": (
        lambda: Orbit.circular(100, primary=Primary("Moon", 4.9028e12, 1.7374e6)),
        "100 m of the surface of the M",
    ),
    "inclination": (lambda: Orbit.circular("550 km", 97.5), "inclination = 97.5 rad is beyond pi.*'97.5 deg'.*1.7017"),
    "text": (lambda: Orbit.circular("550 km", "97.5"), "inclination = 97.5 rad"),
    "few degrees": (lambda: Orbit.circular("550 km", 5), "inclination = 5 rad"),
    "node": (lambda: Orbit.circular("550 km", 1, node=-120), "node = 120 rad is beyond 2 pi"),
    "perigee": (lambda: Orbit("7000 km", 0.01, perigee=70), "perigee = 70 rad"),
    "pitch": (lambda: Satellite(TENSOR, LOW).pointing(pitch=10), "pitch = 10 rad"),
    "tilt": (lambda: WHEEL.state(tilt=30, spin=1), "tilt = 30 rad is beyond pi.*'30 deg'"),
    "tilt of the axis": (lambda: WHEEL.orientation(30), "tilt = 30 rad"),
    "tilt of the precession": (lambda: WHEEL.steady_precession(30, 100), "tilt = 30 rad"),
}


@pytest.mark.parametrize("name", SLIPS)
def test_slips_of_units_are_warned_of(name: str) -> None:
    make, words = SLIPS[name]
    with pytest.warns(kr.InputWarning, match=words) as seen:
        make()
    assert seen[0].filename == __file__


def test_what_is_meant_is_not_warned_of() -> None:
    """Warnings are errors here."""
    far = Orbit("7000 km", 0.01, np.pi, 2 * np.pi, -2 * np.pi)
    assert far.inclination == np.pi
    assert Orbit.circular("550 km", "400 deg").inclination == pytest.approx(np.radians(400))
    assert Orbit.circular("81 km").pericentre == EARTH.radius + 81e3
    assert WHEEL.state(tilt="30 deg", spin=1).a[0] == pytest.approx(0.5)


def test_slips_by_name_are_warned_of_before_the_run() -> None:
    """The constructor is silent: it reads archives too."""
    model = BODIES["satellite"](moments=(1, 1, 1), semi_major_axis=6_378_700.0, inclination=97.5, field=7.6e15)
    with pytest.warns(kr.InputWarning) as seen:
        kr.simulate(model, model.state(M=(0, 0, 3e-5)), dt=30, steps=2, orientation=(1, 0, 0, 0), progress=False)
    words = " ".join(str(w.message) for w in seen)
    assert "inclination = 97.5 rad" in words and "within 563 m" in words and "points south" in words


@pytest.mark.parametrize("cause", [{"dipole": (0, 0, 1)}, {"density": 1e-12}, {"pressure": 4.5e-6}])
def test_causes_without_an_effect_are_doubted(cause: dict[str, Any]) -> None:
    """A dipole without a field, air and light without plates."""
    model = BODIES["satellite"](moments=(0.03, 0.04, 0.05), semi_major_axis=7e6, **cause)
    with pytest.warns(kr.InputWarning, match=f"{next(iter(cause))}: expected (field|plates) too"):
        kr.simulate(model, model.state(M=(0, 0, 3e-5)), dt=30, steps=2, orientation=(1, 0, 0, 0), progress=False)


ODD = {"inclination": 97.5, "field": 7.6e15, "density": 1e-12}
ATTACHED: dict[str, Callable[[Any], Any]] = {
    "damping": lambda body: kr.perturbed(body, damping=0.01),
    "torque": lambda body: kr.perturbed(body, torque=lambda M: -0.01 * M),
    "twice": lambda body: kr.perturbed(kr.perturbed(body, damping=0.01), torque=lambda M: -0.01 * M),
}


@pytest.mark.parametrize("attached", ATTACHED)
def test_forces_drop_no_doubts_about_parameters(attached: str) -> None:
    """Only damping cannot read the density, which a function may."""
    model = ATTACHED[attached](BODIES["satellite"](moments=(1, 1.5, 2), semi_major_axis=7e6, **ODD))
    with pytest.warns(kr.InputWarning) as seen:
        kr.simulate(model, model.state(M=(0, 0, 3e-5)), dt=30, steps=2, orientation=(1, 0, 0, 0), progress=False)
    words = " ".join(str(w.message) for w in seen)
    assert "inclination = 97.5 rad" in words and "points south" in words
    assert ("density: expected plates too" in words) == (attached == "damping")


@pytest.mark.parametrize("sensor", ["density", "rates"])
def test_air_that_a_law_reads_has_an_effect(sensor: str) -> None:
    law = {"density": lambda density: {"torque": (0, 0, 1e3 * density)}, "rates": lambda rates: {"torque": -rates}}
    sat = Satellite(TENSOR, LOW, density=1e-12, control=kr.Control(law[sensor], every=1.0))
    with nullcontext() if sensor == "density" else pytest.warns(kr.InputWarning, match="density: expected plates too"):
        kr.simulate(sat, sat.state((0.01, 0, 0)), dt=1.0, steps=2, progress=False)


MOON = Orbit.circular("100 km", primary=Primary("Moon", 4.9028e12, 1.7374e6))
MAGNETS: dict[str, dict[str, Any]] = {
    "law": {"control": kr.Control(lambda rates: {"dipole": -rates})},
    "rods": {"control": kr.physical.hysteresis_rods((1, 0, 0), 1e-6, 10, 0.1, 0.5)},
    "eddy currents": {"torque": kr.physical.EddyCurrents(1.0)},
    "list": {"torque": [lambda t: (0, 0, 1e-6 + 0 * t), lambda B: B]},
    "potential": {"potential": lambda B: -B[0]},
}


@pytest.mark.parametrize("name", MAGNETS)
def test_magnets_without_a_field_are_doubted(name: str) -> None:
    with pytest.warns(kr.InputWarning, match="expected a magnetic field, in which dipoles of a law and torques of B"):
        Satellite(TENSOR, MOON, **MAGNETS[name])
    assert Satellite(TENSOR, LOW, **MAGNETS[name]).orbit is LOW  # warnings are errors here


def test_wheels_that_magnets_do_not_unload_need_no_field() -> None:
    law = kr.physical.pointing(Wheels(np.eye(3)), 1e-3, 1e-2)
    assert Satellite(TENSOR, MOON, wheels=Wheels(np.eye(3)), control=law).control is law


@pytest.mark.parametrize("forces", [{"damping": 0.1}, {"potential": lambda P: 0.01 * P[0] ** 2}])
def test_forces_leave_the_doubt_about_impossible_moments(forces: dict[str, Any]) -> None:
    top = kr.perturbed(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=3.0), **forces)
    state = top.state(M=(0.1, 0.2, 1), P=(0.6, 0, 0.8))
    with pytest.warns(kr.AccuracyWarning, match="alpha = 3: a body has 0 < alpha"):
        kr.simulate(top, state, dt=0.01, steps=3, progress=False)
    real = kr.perturbed(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=3.0), inertia=(1, 1.2, 1.5), **forces)
    kr.simulate(real, state, dt=0.01, steps=3, progress=False)  # warnings are errors here


def test_toutatis_has_its_published_periods() -> None:
    """A spin in the long-axis mode has both; in a run with the Sun the long axis goes round in 7.35 days."""
    toutatis = kr.physical.Asteroid.toutatis()

    def free(tilt: float, rate: float = 1.0) -> Any:
        return toutatis.body.rotation((rate * np.cos(tilt), rate * np.sin(tilt), 0))

    tilt = brentq(lambda tilt: free(tilt).period / free(tilt).precession_period - 5.41 / 7.35, 0.1, 1.0)
    spin = free(tilt, free(tilt).period / (5.41 * 86400))
    assert spin.kind == "long-axis mode"
    run = kr.simulate(
        toutatis.model(),
        toutatis.state(spin=spin.spin),
        dt=3600,
        t_end=147 * 86400,
        orientation=toutatis.orientation(),
        progress=False,
    )
    g = algebra.rotation_matrix(run.g.values)
    momentum = g[0] @ run.M.values[0] / np.linalg.norm(run.M.values[0])
    across = g[:, :, 0] - np.outer(g[:, :, 0] @ momentum, momentum)
    turned = np.einsum("i,ti->t", momentum, np.cross(across[:-1], across[1:])) / (across[:-1] ** 2).sum(-1)
    assert 2 * np.pi * 147 / turned.sum() == pytest.approx(7.35, rel=2e-3)


def test_resonant_angle_and_obliquity() -> None:
    """The angle of the resonance 3:2 librates with the frequency n sqrt(3 (B - A)/C H), H = 7e/2 - 123 e^3/16."""
    e, ratio = 0.1, 1e-3
    moon = Satellite((1.0, 1.0 + 1.1 * ratio, 1.1), Orbit(1e9, e, primary=Primary("star", 1e18, 1e6)))
    n, spin = moon.orbit.mean_motion, 1.5
    start = moon.state(spin=(0, 0, spin * moon.orbit.mean_motion))
    run = kr.simulate(
        moon.model(),
        start,
        dt=moon.orbit.period / 40,
        t_end=80 * moon.orbit.period,
        every=4,
        orientation=moon.orientation(moon.pointing(pitch=0.1)),
        progress=False,
    )
    angle = moon.resonant_angle(run, 1.5)
    assert moon.obliquity(run).max() < 1e-6
    assert abs(angle).max() < 0.13
    assert angle.min() < -0.08
    theory = n * np.sqrt(3 * ratio * (7 * e / 2 - 123 * e**3 / 16))
    crossings = run.time.values[1:][np.diff(np.sign(angle)) != 0]
    assert np.pi / np.diff(crossings).mean() == pytest.approx(theory, rel=0.03)
    outside = moon.resonant_angle(run, 1.0)
    assert outside.max() - outside.min() > 6


def test_the_resonant_angle_on_an_orbit_that_j2_rotates() -> None:
    """Of an axis that points up it is the equation of the centre, f - M, at most 2 e + 11 e^3/48, in each orbit."""
    orbit = Orbit(8e6, 0.1, 0.5, 0.3, 0.7, mean_anomaly=0.4, J2=True)
    moon = Satellite((1.0, 2.0, 2.5), orbit)
    run = kr.simulate(moon, moon.state(), dt="20 s", t_end="10 d", every=100)
    up = np.array([algebra.unit_quaternion(orbit.frame(t)) for t in run.time.values])
    upright = run.assign(attitude=(run.attitude.dims, up))
    angle = moon.resonant_angle(upright, 1.0)
    assert moon.obliquity(upright).max() < 1e-14
    assert 0.199 < angle.max() < 0.2005 and -0.2005 < angle.min() < -0.199


def test_the_name_of_a_body_is_taken() -> None:
    own = kr.perturbed(kr.EulerTop(J=(1, 2, 3)), torque=lambda M: -0.1 * M, name="satellite")
    with pytest.raises(kr.InputError, match="no body of Kreisel has"):
        kr.simulate(own, own.state(M=(1, 2, 3)), dt=0.1, steps=1, progress=False)
