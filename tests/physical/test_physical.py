"""SI data to scaled systems: textbook limits, printed tables, simulated steady motions, numbers in the examples."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest
from scipy.integrate import quad

import kreisel as kr
from kreisel import algebra
from kreisel.cli.configuration import read
from kreisel.physical import Ellipsoid, Gyroscope, HeavyBody
from support import ROOT

EXAMPLES = ROOT / "examples"
WHEEL = Gyroscope(mass=2.0, axial_moment=0.11, transverse_moment=0.16, lever=0.2, gravity=9.8)
FAST = 20.0  # rad/s


def test_lists_are_lanes_of_a_state() -> None:
    fan = WHEEL.state(tilt="60 deg", spin=["400 rpm", "200 rpm"], precession=[0.5, 0.0])
    run = kr.simulate(WHEEL, fan, dt=0.01, steps=20, progress=False)
    for lane, (spin, precession) in enumerate((("400 rpm", 0.5), ("200 rpm", 0.0))):
        alone = kr.simulate(WHEEL, WHEEL.state("60 deg", spin, precession), dt=0.01, steps=20, progress=False)
        for name in ("axis", "attitude"):
            assert (run[name].sel(lane=lane).values == alone[name].values).all()
    with pytest.raises(kr.InputError, match=r"lanes that fit, got \(3,\), \(2,\)"):
        WHEEL.state(tilt=[1.0, 1.1, 1.2], spin=[1.0, 2.0])


def azimuth(wheel: Gyroscope, run: object) -> np.ndarray:
    return np.unwrap(wheel.motion(run.m, run.a).azimuth)


def slope(seconds: np.ndarray, angle: np.ndarray) -> float:
    return float(np.polyfit(seconds, angle, 1)[0])


# ------------------------------------------------------------------------------------------------ gyroscope


@pytest.mark.parametrize("spin", [FAST, -FAST])
@pytest.mark.parametrize("root", [0, 1])
@pytest.mark.parametrize("tilt", [0.5, 1.2, 2.0, 3.0])
def test_steady_precession_is_steady(tilt: float, root: int, spin: float) -> None:
    rate = WHEEL.steady_precession(tilt, spin)[root]
    state = WHEEL.state(tilt, spin, precession=rate)
    dt = 1e-3 * min(1, 10 / abs(rate))
    run = kr.simulate(WHEEL.model(), state, dt=dt, steps=20_000, every=20, order=2)
    seconds = run.time.values * WHEEL.time_unit
    motion = WHEEL.motion(run.m, run.a)
    assert abs(motion.tilt - tilt).max() < 1e-6
    assert slope(seconds, azimuth(WHEEL, run)) == pytest.approx(rate, rel=1e-5)
    off = kr.simulate(WHEEL.model(), WHEEL.state(tilt, spin, precession=1.01 * rate), dt=dt, steps=20_000, every=20)
    assert abs(WHEEL.motion(off.m, off.a).tilt - tilt).max() > 1e-4


def test_steady_roots_solve_the_quadratic_without_cancellation() -> None:
    for spin in (FAST, 1e4, 1e8, -1e8):
        slow, fast = WHEEL.steady_precession(1.0, spin)
        momentum, rise = WHEEL.axial_moment * spin, WHEEL.transverse_moment * math.cos(1.0)
        assert slow + fast == pytest.approx(momentum / rise, rel=1e-14)
        assert slow * fast == pytest.approx(WHEEL.weight_torque / rise, rel=1e-14)
    assert WHEEL.steady_precession(1.0, 1e8)[0] == pytest.approx(WHEEL.slow_precession(1e8), rel=1e-12)


def test_hanging_without_spin_is_the_conical_pendulum() -> None:
    """W^2 = g/(L |cos(theta)|), with L = I1/(m l) the length of the equivalent simple pendulum."""
    length = WHEEL.transverse_moment / (WHEEL.mass * WHEEL.lever)
    rate = math.sqrt(WHEEL.gravity / (length * -math.cos(2.5)))
    assert WHEEL.steady_precession(2.5, 0.0) == pytest.approx((rate, -rate))


def test_roots_of_lanes_are_those_of_each() -> None:
    tilts, spins = [0.5, 2.5, math.pi / 2], [FAST, 0.0, -FAST]
    roots = np.array(WHEEL.steady_precession(tilts, spins))
    each = np.array([WHEEL.steady_precession(*values) for values in zip(tilts, spins, strict=True)])
    assert (roots == each.T).all()
    assert (WHEEL.slow_precession(spins[::2]) == [WHEEL.slow_precession(spin) for spin in spins[::2]]).all()
    with pytest.raises(kr.InputError, match=r"No steady precession at tilt = 0.3 rad with spin = 1 rad/s"):
        WHEEL.steady_precession([2.5, 0.3], 1.0)
    with pytest.raises(kr.InputError, match="expected lanes that fit"):
        WHEEL.steady_precession(tilts, [FAST, FAST])


def test_small_swings_have_the_period_of_the_physical_pendulum() -> None:
    run = kr.simulate(WHEEL.model(), WHEEL.state(math.pi - 1e-3, 0.0), dt=1e-3, steps=30_000, every=1)
    seconds, x = run.time.values * WHEEL.time_unit, run.a.values[:, 0]
    falls = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
    period = np.diff(seconds[falls] + (seconds[1] - seconds[0]) * x[falls] / (x[falls] - x[falls + 1])).mean()
    assert period == pytest.approx(2 * math.pi * math.sqrt(WHEEL.transverse_moment / WHEEL.weight_torque), rel=1e-6)


@pytest.mark.parametrize(("factor", "sleeps"), [(1.01, True), (0.99, False)])
def test_sleeping_threshold(factor: float, sleeps: bool) -> None:
    run = kr.simulate(WHEEL.model(), WHEEL.state(1e-6, factor * WHEEL.sleeping_spin), dt=0.01, steps=30_000, every=10)
    assert (WHEEL.motion(run.m, run.a).tilt.max() < 1e-4) == sleeps


def test_nutation_rate_of_a_fast_top() -> None:
    spin = 2000.0
    run = kr.simulate(WHEEL.model(), WHEEL.state(1.2, spin), dt=1e-4, steps=40_000, every=1)
    tilt = WHEEL.motion(run.m, run.a).tilt
    tilt = tilt - tilt.mean()
    ups = np.flatnonzero((tilt[:-1] < 0) & (tilt[1:] >= 0))
    crossing = ups + tilt[ups] / (tilt[ups] - tilt[ups + 1])
    rate = 2 * math.pi / (np.diff(crossing).mean() * 1e-4 * WHEEL.time_unit)
    assert rate == pytest.approx(WHEEL.nutation_rate(spin), rel=1e-3)


def test_release_from_rest_follows_the_quadrature() -> None:
    """Mean precession of a horizontal axis released from rest, by the classical quadrature for u = cos(theta).

    u'^2 = u f(u), f(u) = -2 k (1 - u^2) - w^2 u, k = m g l/I1, w = I3 w3/I1; phi' = -w u/(1 - u^2).
    """
    w, k = WHEEL.nutation_rate(FAST), WHEEL.weight_torque / WHEEL.transverse_moment
    low, other = np.sort(np.roots([2 * k, -(w**2), -2 * k]))

    def weight(s: float) -> tuple[float, float]:  # u = low sin^2(s): du/u' without its square-root singularities
        u = low * math.sin(s) ** 2
        return u, 2 / math.sqrt(2 * k * (other - u))

    half_period = quad(lambda s: weight(s)[1], 0, math.pi / 2)[0]
    half_turn = quad(lambda s: -w * weight(s)[0] / (1 - weight(s)[0] ** 2) * weight(s)[1], 0, math.pi / 2)[0]
    mean = half_turn / half_period
    period = 2 * half_period
    dt, rounds = 1e-3, 30
    steps = round(rounds * period / (WHEEL.time_unit * dt))
    run = kr.simulate(WHEEL.model(), WHEEL.state(math.pi / 2, FAST), dt=dt, steps=steps, every=1)
    phi = azimuth(WHEEL, run)
    assert phi[-1] == pytest.approx(mean * rounds * period, rel=1e-5)
    assert run.a.values[:, 2].min() == pytest.approx(low, rel=1e-5)
    assert abs(mean / WHEEL.slow_precession(FAST) - 1) > 1e-3  # the textbook rate would not pass


def test_motion_is_the_inverse_of_state() -> None:
    wanted = (1.1, 0.0, 7.0, -2.0, 0.4)
    tilt, _, spin, precession, nutation = wanted
    x = WHEEL.state(tilt, spin, precession, nutation).axial
    assert np.allclose(WHEEL.motion(x.m, x.a), wanted, rtol=1e-14, atol=1e-15)
    upright = WHEEL.state(0.0, spin).axial
    assert np.isnan(WHEEL.motion(upright.m, upright.a).precession)


def test_rates_are_derivatives_of_the_angles() -> None:
    run = kr.simulate(WHEEL.model(), WHEEL.state(1.1, 7.0, -2.0, 0.4), dt=1e-4, steps=2000)
    motion, step = WHEEL.motion(run.m, run.a), 1e-4 * WHEEL.time_unit
    assert np.allclose(np.gradient(motion.tilt, step)[1:-1], motion.nutation[1:-1], atol=1e-5)
    assert np.allclose(np.gradient(np.unwrap(motion.azimuth), step)[1:-1], motion.precession[1:-1], atol=1e-5)
    assert np.allclose(motion.spin, 7.0, rtol=1e-12)


def test_energy_in_joules() -> None:
    """I1 (theta'^2 + phi'^2 sin^2)/2 + m g l cos(theta), and the axial part I3 w3^2/2 with alpha for 1."""
    tilt, spin, precession, nutation = 1.1, 7.0, -2.0, 0.4
    x = WHEEL.state(tilt, spin, precession, nutation)
    I1, I3 = WHEEL.transverse_moment, WHEEL.axial_moment
    swing = I1 * (nutation**2 + (precession * math.sin(tilt)) ** 2) / 2 + WHEEL.weight_torque * math.cos(tilt)
    energy = WHEEL.weight_torque * float(WHEEL.model().call(WHEEL.model().system.energy, x.m, x.a))
    assert energy == pytest.approx(swing + (I3 * spin) ** 2 / (2 * I1), rel=1e-14)
    assert np.linalg.norm(x.axial.m) * WHEEL.momentum_unit == pytest.approx(
        math.hypot(I3 * spin, I1 * nutation, I1 * precession * math.sin(tilt)), rel=1e-14
    )


def test_orientation_takes_the_third_axis_to_a_and_turns_at_the_body_rate() -> None:
    """The body turns by w3 - phi' cos(theta) = psi' about its axis, relative to the line of nodes."""
    tilt, spin = 1.2, FAST
    rate = WHEEL.steady_precession(tilt, spin)[0]
    g0 = WHEEL.orientation(tilt)
    state = WHEEL.state(tilt, spin, rate)
    run = kr.simulate(WHEEL.model(), state, dt=1e-3, steps=3000, order=2, orientation=g0)
    g = algebra.rotation_matrix(run.g.values)
    assert np.allclose(g @ [0, 0, 1], run.a.values, atol=1e-12)
    psi = np.unwrap(np.arctan2(g[:, 2, 1], -g[:, 2, 0]))  # g = Rz(phi) Ry(theta) Rz(psi)
    assert slope(run.time.values * WHEEL.time_unit, psi) == pytest.approx(spin - rate * math.cos(tilt), rel=1e-5)


def test_flat_wheel_meets_the_bound_on_its_moments() -> None:
    wheel = Gyroscope.flat(mass=1.7, axial_moment=0.3, lever=0.07)
    assert wheel.transverse_moment == pytest.approx(0.15 + 1.7 * 0.07**2)
    with pytest.raises(kr.InputError, match="moments were rounded"):
        Gyroscope(1.7, 0.3, wheel.transverse_moment * (1 - 1e-9), 0.07)


@pytest.mark.parametrize("field", ["mass", "axial_moment", "transverse_moment", "lever", "gravity"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "1", None])
def test_unphysical_gyroscope(field: str, value: object) -> None:
    data = {"mass": 2.0, "axial_moment": 0.11, "transverse_moment": 0.16, "lever": 0.2, "gravity": 9.8}
    with pytest.raises(kr.InputError, match=field):
        Gyroscope(**{**data, field: value})


def test_unphysical_motion() -> None:
    with pytest.raises(kr.InputError, match="tilt"):
        WHEEL.state(math.nan, 1.0)
    with pytest.raises(kr.InputError, match="spin"):
        WHEEL.slow_precession(0.0)
    with pytest.raises(kr.InputError, match="No steady precession"):
        WHEEL.steady_precession(math.pi / 2, 0.0)
    least = WHEEL.sleeping_spin * math.sqrt(math.cos(0.3))
    assert WHEEL.steady_precession(0.3, least * (1 + 1e-9))
    with pytest.raises(kr.InputError, match=f"at least {least:.6g}"):
        WHEEL.steady_precession(0.3, least * (1 - 1e-9))


# ------------------------------------------------------------------------------------------------ ellipsoid

# c/a, k1, k2, k' of a prolate ellipsoid, printed to 0.001: H. Lamb, The inertia-coefficients of
# an ellipsoid moving in fluid, Reports and Memoranda 623, October 1918.
LAMB_1918 = [
    (1.50, 0.305, 0.621, 0.094),
    (2.00, 0.209, 0.702, 0.240),
    (2.51, 0.156, 0.763, 0.367),
    (2.99, 0.122, 0.803, 0.465),
    (3.99, 0.082, 0.860, 0.608),
    (4.99, 0.059, 0.895, 0.701),
    (6.01, 0.045, 0.918, 0.764),
    (6.97, 0.036, 0.933, 0.805),
    (8.01, 0.029, 0.945, 0.840),
    (9.02, 0.024, 0.954, 0.865),
    (9.97, 0.021, 0.960, 0.883),
]


def neutral(*axes: float) -> Ellipsoid:
    return Ellipsoid.of_density(axes, 1000.0, 1000.0)


@pytest.mark.parametrize("row", LAMB_1918)
def test_table_of_lamb(row: tuple[float, ...]) -> None:
    """To 0.0025: the largest departure is 0.0022, at c/a = 2.00, from hand computation at a rounded c/a."""
    body = neutral(row[0], 1.0, 1.0)
    found = [*(body.added_masses / body.mass)[:2], (body.added_moments / body.moments)[2]]
    assert found == pytest.approx(row[1:], abs=0.0025)


def test_sphere() -> None:
    body = neutral(0.2, 0.2, 0.2)
    assert body.displaced_mass == pytest.approx(1000 * 4 / 3 * math.pi * 0.008)
    assert np.allclose(body.added_masses, body.displaced_mass / 2, rtol=1e-14)
    assert (body.added_moments == 0).all()
    assert np.allclose(body.moments, 0.4 * body.mass * 0.04, rtol=1e-14)


def test_body_of_revolution() -> None:
    """The system with maps has the energy and the motion of Kirchhoff's equations, orientation and all."""
    body = neutral(0.1, 0.1, 0.3)
    model, x0 = body.model(), body.state((0.5, 0.1, 1.0), (2.0, 1.0, 8.0))
    x, y, z = 1 / (body.moments + body.added_moments)
    whole = kr.Kirchhoff(C=[[0, z, y], [z, 0, x], [y, x, 0]], B=-1 / (body.mass + body.added_masses))
    asked = {"dt": 0.01, "steps": 100, "every": 100, "orientation": (1, 0, 0, 0), "progress": False}
    runs = [kr.simulate(model, x0, method="exact", **asked), kr.simulate(whole, x0, method="dop853", **asked)]
    assert model.system.name == "kirchhoff-revolution"
    assert float(abs(runs[0].energy - runs[1].energy).max()) < 1e-8 * float(runs[0].energy[0])
    for name in ("M", "P", "g"):
        assert float(abs(runs[0][name] - runs[1][name]).max()) < 1e-7 * float(abs(runs[1][name]).max())


def test_thin_disc() -> None:
    """Added mass (8/3) rho a^3 broadside, added moment (16/45) rho a^5 about a diameter.  [Lamb, art. 102, 114]"""
    body = neutral(0.3, 0.3, 1e-9)
    assert body.added_masses[2] == pytest.approx(1000 * 8 / 3 * 0.3**3, rel=1e-7)
    assert np.allclose(body.added_moments, [1000 * 16 / 45 * 0.3**5] * 2 + [0], rtol=1e-7)
    assert abs(body.added_masses[:2]).max() < 1e-6


def test_long_cylinder() -> None:
    """Across the axis the added mass is the mass displaced; an elliptic cylinder (b, c) has pi rho c^2 a length."""
    body = neutral(1e5, 0.3, 0.1)
    length = body.displaced_mass / (1000 * math.pi * 0.3 * 0.1)
    assert body.added_masses[0] / body.mass < 1e-9
    assert np.allclose(body.added_masses[1:], 1000 * math.pi * length * np.array([0.1**2, 0.3**2]), rtol=1e-8)
    spin = 1000 * math.pi / 8 * (0.3**2 - 0.1**2) ** 2  # a length, about the axis of an elliptic cylinder
    section = 2e5 * quad(lambda s: spin * (1 - s**2) ** 2, 0, 1)[0]  # of a slowly tapering body: strip theory
    assert body.added_moments[0] == pytest.approx(section, rel=1e-8)


@pytest.mark.parametrize("axes", [(3, 2, 1), (1, 5, 5), (1e-6, 1, 1), (1e6, 1, 2), (1, 1, 1), (0.1, 7, 40)])
def test_shape_integrals(axes: tuple[float, float, float]) -> None:
    body = neutral(*axes)
    assert sum(body.shape_integrals) == pytest.approx(2, abs=1e-14)
    assert (body.added_masses > 0).all() and (body.added_moments >= 0).all()
    for turned in ((1, 2, 0), (1, 0, 2)):  # the axes have no order of their own
        other = neutral(*np.take(axes, turned))
        assert np.allclose(other.added_masses, body.added_masses[list(turned)], rtol=1e-13)
        assert np.allclose(other.added_moments, body.added_moments[list(turned)], rtol=1e-8)


def test_shape_integral_by_quadrature() -> None:
    a, b, c = 3.0, 2.0, 1.0
    delta = quad(lambda t: 1 / ((a * a + t) * math.sqrt((a * a + t) * (b * b + t) * (c * c + t))), 0, math.inf)[0]
    assert neutral(a, b, c).shape_integrals[0] == pytest.approx(a * b * c * delta, rel=1e-9)


@pytest.mark.parametrize("apart", [1e-2, 1e-5, 1e-8, 1e-11, 1e-14, 2.3e-16])
def test_added_moment_of_nearly_equal_axes(apart: float) -> None:
    """Near b = c it is (M/5) (b^2 - c^2)^2 s/(2 - (b^2 + c^2) s), s = a b c int dt/((b^2 + t)^2 D), D^2 the cubic."""
    a, b, c = 2.0, 1.0, 1.0 + apart
    integral = quad(lambda t: ((b * b + t) * (c * c + t)) ** -1.5 * (a * a + t) ** -0.5, 0, math.inf)[0]
    body, s = neutral(a, b, c), a * b * c * integral
    wanted = body.mass / 5 * (b * b - c * c) ** 2 * s / (2 - (b * b + c * c) * s)
    assert body.added_moments[0] == pytest.approx(wanted, rel=1e-8, abs=1e-15 * body.mass * apart)


def test_added_moment_of_axes_one_rounding_apart() -> None:
    """There 2 - (b^2 + c^2) s comes out as -4e-16 where it is at least alpha0 = 0.27."""
    body = neutral(4.99, 2.0, np.nextafter(2.0, 3.0))
    assert 0 <= body.added_moments[0] < 1e-30 * body.mass


def test_kirchhoff_parameters_give_velocity_and_energy_back() -> None:
    body, U, Omega = neutral(0.3, 0.2, 0.1), np.array([0.3, -0.2, 0.5]), np.array([0.7, 0.2, -0.4])
    joules = ((body.mass + body.added_masses) @ U**2 + (body.moments + body.added_moments) @ Omega**2) / 2
    model, x = body.model(), body.state(U, Omega)
    assert np.allclose(-model.params["B"] @ x.P, U, rtol=1e-14)
    assert np.allclose(algebra.axial(model.call(model.system.velocity, x.M, x.P)), Omega, rtol=1e-14)
    assert float(model.call(model.system.energy, x.M, x.P)) == pytest.approx(joules, rel=1e-14)


def test_in_a_vacuum_the_body_is_free() -> None:
    body = Ellipsoid((0.3, 0.2, 0.1), 5.0, 0.0)
    assert (body.added_masses == 0).all() and (body.added_moments == 0).all()
    assert np.allclose(body.model().params["B"], -np.eye(3) / 5)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (((1, 2), 1, 1), "semi_axes"),
        (((1, 2, 0), 1, 1), "c must"),
        (((1, 2, math.nan), 1, 1), "must be finite"),
        (((1, 2, 3), -1, 1), "mass"),
        (((1, 2, 3), 1, -1), "fluid_density"),
        (((1, 2, 3), 1, math.inf), "fluid_density"),
    ],
)
def test_unphysical_ellipsoid(data: tuple, said: str) -> None:
    with pytest.raises(kr.InputError, match=said):
        Ellipsoid(*data)


# ------------------------------------------------------------------------------------------------- examples


def example(name: str) -> dict:
    return tomllib.loads((EXAMPLES / name).read_text(encoding="utf-8"))


def test_the_gyroscope_example() -> None:
    """A wheel of 29.5 N and 0.17 kg m^2, 0.15 m from the string, at three turns a second, held horizontally."""
    asked = read(EXAMPLES / "gyroscope.toml")
    transverse, torque = 0.17 / 2 + 29.5 / 9.80665 * 0.15**2, 29.5 * 0.15
    momentum = 0.17 * 2 * math.pi * 3 / math.sqrt(transverse * torque)
    assert asked.model.params["alpha"] == pytest.approx(0.17 / transverse, rel=1e-14)
    assert asked.state.a == pytest.approx([1, 0, 0], abs=1e-15)
    assert asked.state.axial["m"] == pytest.approx([momentum, 0, 0], rel=1e-14, abs=1e-15)
    assert asked.orientation == pytest.approx([math.sqrt(0.5), 0, math.sqrt(0.5), 0], rel=1e-14)
    assert asked.run.dt * math.sqrt(transverse / torque) == pytest.approx(4e-4, rel=1e-12)


def test_numbers_of_the_kirchhoff_example() -> None:
    data = example("kirchhoff.toml")
    body = Ellipsoid.of_density((0.15, 0.10, 0.05), 998.2, 998.2)
    mass, length = body.mass, 0.1  # the units of the example, with s
    model, state = body.model(), body.state((0.1, 0.001, 0.0), (0.0, 0.02, 0.01)).axial
    assert np.allclose(data["system"]["C"], mass * length**2 * model.params["C"], rtol=1e-14)
    assert np.allclose(np.diag(data["system"]["B"]), mass * model.params["B"], rtol=1e-14)
    assert np.allclose(data["state"]["M"], state.M / (mass * length**2), rtol=1e-14)
    assert np.allclose(data["state"]["P"], state.P / (mass * length), rtol=1e-14)


HUGE = 10**5000


@pytest.mark.parametrize(
    "call",
    [
        lambda: Ellipsoid(1e300, 1.0, 1.0),
        lambda: Ellipsoid((1.0, 2.0, HUGE), 1.0, 1.0),
        lambda: Ellipsoid((1e-160, 1.0, 1.0), 1.0, 500.0),
        lambda: Ellipsoid.of_density((1.0, 2.0, 3.0), [], 500.0),
        lambda: Ellipsoid.of_density(7, 500.0, 1000.0),
        lambda: Ellipsoid((1, 2, 3), 1, 1).state({"x": 1}, (0, 0, 1)),
        lambda: Ellipsoid((1, 2, 3), 1, 1).state((0, 0, 1), (0, 0, HUGE)),
        lambda: Gyroscope.flat(1.0, 0.17, 1e300),
        lambda: Gyroscope.flat(HUGE, 0.17, 0.1),
        lambda: Gyroscope(1.0, 1e-320, 1e300, 1e-100),
        lambda: WHEEL.motion((1.0, 2.0, 3.0), 7),
        lambda: WHEEL.motion(np.ones((2, 3)), np.ones((5, 3))),
        lambda: WHEEL.dt({"s": 1}),
        lambda: WHEEL.dt(1.7e308),
        lambda: WHEEL.steady_precession(0.5, 1.7e308),
        lambda: WHEEL.slow_precession(5e-324),
        lambda: WHEEL.nutation_rate([]),
        lambda: Gyroscope(1.0, 1.5, 1.0, 1e-3).nutation_rate(1.7e308),
        lambda: HeavyBody(5e-324, (1.0, 1.2, 1.5), (1.0, 1.0, 1.0)),
        lambda: HeavyBody(1.0, (1.0, 1.2, 1.5), (1e300, 1e300, 1e300)),
        lambda: HeavyBody.about_centre(1.0, (1.0, 1.2, 1.5), (1e200, 0.0, 0.0)),
        lambda: HeavyBody(1.0, (1.0, 1.2, 1.5), (0.0, 0.1, 0.2)).angular_velocity([[[1.0]]]),
        lambda: HeavyBody(1.0, (0.0, 1.0, 1.0), (0.1, 0.0, 0.0)).angular_velocity((1.0, 0.0, 0.0)),
    ],
)
@pytest.mark.filterwarnings("error")
def test_numbers_of_no_body_are_refused(call: object) -> None:
    """What is no number, or leads out of the range of doubles: one error, no warning, nothing infinite."""
    with pytest.raises(kr.InputError, match=r"must|leaves the range|fit|not determined|moments > 0"):
        call()
