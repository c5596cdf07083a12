"""The free body in SI units: its closed form against extended digits, quadratures and runs; data, axes, errors."""

from __future__ import annotations

import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from scipy.integrate import quad

import kreisel as kr
from kreisel import units
from kreisel.algebra import act, rotation_matrix
from kreisel.errors import InputError
from kreisel.exact.rotor import Rotor
from kreisel.physical import FreeBody, HeavyBody, free_body

ROUNDING = 4e-15  # relative: periods were off by 3e-16 at most
MOMENTS = np.array((1.0, 2.1, 2.7))
TENSOR = np.array(((0.11, 0.02, -0.01), (0.02, 0.13, 0.015), (-0.01, 0.015, 0.15)))
SPINS = {"short-axis mode": (0.3, 0.5, 0.9), "long-axis mode": (0.9, 0.5, 0.1)}
BODIES = [
    MOMENTS,
    MOMENTS[::-1],
    MOMENTS[[1, 2, 0]],
    (0.5, 1.0, 1.0),
    (1.0, 1.0, 1.7),
    (1.0, 2.0, 3.0),
    (1e-3, 1.0, 1.0005),
]


def in_extended_digits(moments: object, spin: object) -> tuple[float, float]:
    """The period 4 K/lambda and the mean precession, with K and Pi of mpmath in 700 digits."""
    ctx = mpmath.MPContext()
    ctx.dps = 700
    i = [ctx.mpf(float(v)) for v in moments]
    M = [a * ctx.mpf(float(v)) for a, v in zip(i, spin, strict=True)]
    L2, T2 = sum(m * m for m in M), sum(m * m / a for m, a in zip(M, i, strict=True))
    order = sorted(i, reverse=L2 < T2 * sorted(i)[1])
    a, b, c = order
    E, D = L2 - T2 * a, T2 * c - L2
    k2, nu = (b - a) * D / ((c - b) * E), -c * (b - a) / (a * (c - b))
    K, lam = ctx.ellipk(k2), ctx.sqrt((c - b) * E / (a * b * c))
    return float(4 * K / lam), float(ctx.sqrt(L2) * (1 / c + (1 / a - 1 / c) * ctx.ellippi(nu, k2) / K))


def by_quadrature(body: FreeBody, spin: object) -> float:
    """The mean precession: phi' = (2T - M_3^2/I_3) L/(L^2 - M_3^2) of the axis, over a period of `at`."""
    motion = body.rotation(spin)
    moment = float(motion.axis @ body.inertia @ motion.axis)
    L = float(np.linalg.norm(motion.momentum))

    def rate(t: float) -> float:
        along = float(motion.at(t)[0] @ body.inertia @ motion.axis)
        return L * (2 * motion.energy - along**2 / moment) / (L**2 - along**2)

    return quad(rate, 0, motion.period, epsabs=0, epsrel=1e-11, limit=200)[0] / motion.period


# ------------------------------------------------------------------------------------------------ periods


@pytest.mark.parametrize("kind", SPINS)
@pytest.mark.parametrize("moments", BODIES, ids=str)
def test_periods_in_extended_digits(moments: object, kind: str) -> None:
    motion = FreeBody(moments).rotation(SPINS[kind])
    period, precession = in_extended_digits(moments, SPINS[kind])
    assert motion.period == pytest.approx(period, rel=ROUNDING)
    assert motion.precession == pytest.approx(precession, rel=ROUNDING)
    assert motion.nutation_period == motion.period / 2
    assert motion.precession_period == pytest.approx(2 * math.pi / precession, rel=ROUNDING)


@pytest.mark.parametrize("kind", SPINS)
def test_the_mean_precession_is_a_quadrature(kind: str) -> None:
    for inertia in (MOMENTS, TENSOR):
        body = FreeBody(inertia)
        assert body.rotation(SPINS[kind]).precession == pytest.approx(by_quadrature(body, SPINS[kind]), rel=1e-9)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("e", [1e-2, 1e-5, 1e-8, 1e-11, 1e-15])
def test_beside_the_separatrix_no_digit_is_lost(e: float, side: int) -> None:
    """The modulus k'^2 from its own formula: as 1 - k^2 it would be off by 1e-16/e."""
    a, b, c = MOMENTS
    spin = (0.4, 0.7, 0.4 * math.sqrt(a * (b - a) / (c * (c - b))) * (1 + side * e))
    motion = FreeBody(MOMENTS).rotation(spin)
    assert motion.kind == ("short-axis mode" if side > 0 else "long-axis mode")
    period, precession = in_extended_digits(MOMENTS, spin)
    assert motion.period == pytest.approx(period, rel=ROUNDING)
    assert motion.precession == pytest.approx(precession, rel=ROUNDING)


@pytest.mark.parametrize("e", [1e-3, 1e-9, 1e-30, 1e-150])
def test_beside_the_middle_axis(e: float) -> None:
    spin = (e, 1.0, e / 3)
    motion = FreeBody(MOMENTS).rotation(spin)
    period, precession = in_extended_digits(MOMENTS, spin)
    assert motion.period == pytest.approx(period, rel=ROUNDING)
    assert motion.precession == pytest.approx(precession, rel=ROUNDING)


def test_steady_rotations() -> None:
    body = FreeBody(MOMENTS)
    for i, growth in enumerate((0.0, 1.0, 0.0)):
        motion, stability = body.rotation(3.0, np.eye(3)[i]), body.stability(3.0)[i]
        assert motion.kind == "steady" and motion.flips(100.0).size == 0
        assert motion.period == pytest.approx(stability.period, rel=ROUNDING)
        assert (stability.growth > 0) == bool(growth)
        velocity, _ = motion.at(np.linspace(0, 50, 20))
        assert abs(velocity - 3.0 * np.eye(3)[i]).max() < 1e-14
        assert np.array_equal(motion.polhode(7), np.tile(motion.spin, (7, 1)))
        assert motion.tilts[0] == motion.tilts[1]


def test_a_symmetric_body_precesses_as_in_the_textbook() -> None:
    """Precession L/I_1 and, in the body, (I_3/I_1 - 1) w_3.  [Landau, Lifshitz, Mechanics, sections 33 and 36]"""
    for axial in (0.3, 1.6):
        motion = FreeBody((1.0, 1.0, axial)).rotation((0.4, -0.3, 1.1))
        assert motion.precession == pytest.approx(np.linalg.norm(motion.momentum), rel=ROUNDING)
        assert motion.period == pytest.approx(2 * math.pi / (abs(axial - 1) * 1.1), rel=ROUNDING)
        assert motion.tilts == pytest.approx((math.atan2(0.5, axial * 1.1),) * 2, rel=ROUNDING)
    assert FreeBody((2.0, 2.0, 2.0)).rotation((0.4, -0.3, 1.1)).kind == "steady"
    for moments, third in (((1.0, 2.0, 2.0), 0), ((1.0, 1.0, 1.8), 2)):  # across the axis of symmetry
        motion = FreeBody(moments).rotation(np.roll((0.0, 0.5, 0.7), third))
        assert np.array_equal(motion.axis, np.eye(3)[third]) and motion.tilts == (math.pi / 2,) * 2


# ------------------------------------------------------------------------------------------------ the motion


@pytest.mark.parametrize("kind", SPINS)
@pytest.mark.parametrize("inertia", [MOMENTS, TENSOR], ids=["moments", "tensor"])
def test_the_closed_form_is_the_run(inertia: np.ndarray, kind: str) -> None:
    body, attitude = FreeBody(inertia, time_unit=0.5), np.array((0.5, -0.1, 0.7, 0.5))
    motion = body.rotation(SPINS[kind])
    assert motion.kind in SPINS
    run = kr.simulate(
        body.model(),
        body.state(SPINS[kind]),
        dt=body.dt(motion.period / 1000),
        steps=2500,
        method="veselov",
        order=8,
        orientation=body.orientation(attitude),
    )
    velocity, g = motion.at(run.time * body.time_unit, attitude)
    assert abs(body.angular_velocity(run.M) - velocity).max() < 1e-11  # 4e-14 were found
    assert abs(rotation_matrix(body.attitude(run.g)) - rotation_matrix(g)).max() < 1e-11
    si = units.measured(run, body.scales())
    assert float(si.energy[0]) == pytest.approx(motion.energy, rel=1e-13)
    assert np.linalg.norm(si.M[0]) == pytest.approx(np.linalg.norm(motion.momentum), rel=1e-13)


def test_mutants_of_the_closed_form_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong lambda and a wrong mean rate miss the periods, the other side of u the run; each is seen above."""
    right = Rotor._constants

    def mutant(name: str, wrong: Callable[[Rotor], object]) -> None:
        def constants(rotor: Rotor) -> None:
            right(rotor)
            setattr(rotor, name, wrong(rotor))

        monkeypatch.setattr(Rotor, "_constants", constants)
        free_body._rotor_of.cache_clear()

    for name, wrong in (("lam", lambda r: 2 * r.lam), ("mean", lambda r: r.mean * (1 + 1e-11))):
        mutant(name, wrong)
        with pytest.raises(AssertionError):
            test_periods_in_extended_digits(MOMENTS, "short-axis mode")
    mutant("s", lambda r: -r.s)
    with pytest.raises(AssertionError):
        test_flips_are_seen_in_a_run()
    free_body._rotor_of.cache_clear()


def test_a_motion_goes_on_from_any_state() -> None:
    """Two times after one another are their sum."""
    for kind, spin in SPINS.items():
        for time in (0.1, 7.0):
            velocity, middle = FreeBody(MOMENTS).rotation(spin).at(time)
            later = FreeBody(MOMENTS).rotation(velocity).at(time, middle)
            straight = FreeBody(MOMENTS).rotation(spin).at(2 * time)
            assert abs(straight[0] - later[0]).max() < 1e-13, kind
            assert abs(rotation_matrix(straight[1]) - rotation_matrix(later[1])).max() < 1e-13, kind


@pytest.mark.parametrize("e", [1e-5, 1e-13, 1e-58, 1e-200])
def test_the_motion_beside_the_middle_axis(e: float) -> None:
    """The start is the start, |M|, the energy and M in space stay, at a flip M_2 = 0, after two the state is back."""
    body, spin = FreeBody(MOMENTS), np.array((e, 1.0, -e / 3))
    motion = body.rotation(spin)
    flips = motion.flips(4 * motion.period)
    times = np.array((0.0, *flips, 0.3 * motion.period, motion.period))
    velocity, g = motion.at(times)
    assert abs(velocity[0] - spin).max() < 1e-15 and abs(velocity[1 : len(flips) + 1, 1]).max() < 1e-11
    assert len(flips) == 8 and abs(velocity[-1] - spin).max() < 1e-12
    momentum = act(rotation_matrix(g), velocity * MOMENTS)
    assert abs(momentum - momentum[0]).max() < 1e-14
    assert np.allclose((velocity**2 * MOMENTS).sum(-1), MOMENTS[1], rtol=1e-14)


def test_flips_are_seen_in_a_run() -> None:
    body, spin = FreeBody(MOMENTS), (0.01, 2.0, -0.02)
    motion = body.rotation(spin)
    flips = motion.flips(60.0)
    run = kr.simulate(body.model(), body.state(spin), dt=body.dt(1e-3), steps=60_000, method="veselov", order=8)
    x = body.angular_velocity(run.M)[:, 1]
    i = np.flatnonzero(x[1:] * x[:-1] < 0)
    found = run.time.values[i] + 1e-3 * x[i] / (x[i] - x[i + 1])
    assert len(found) >= 5 and np.allclose(found, flips, rtol=0, atol=1e-6)
    assert np.allclose(np.diff(flips), motion.nutation_period, rtol=1e-13)
    assert abs(motion.at(flips)[0][:, 1]).max() < 1e-12


@pytest.mark.parametrize("kind", SPINS)
def test_polhode_and_herpolhode(kind: str) -> None:
    """Poinsot: both ellipsoids contain the polhode, the herpolhode lies in the invariable plane, they roll."""
    body = FreeBody(TENSOR)
    motion = body.rotation(SPINS[kind])
    curve = motion.polhode(101)
    momenta, L = curve @ TENSOR, np.linalg.norm(motion.momentum)
    assert np.allclose((momenta**2).sum(-1), L**2, rtol=1e-13)
    assert np.allclose((curve * momenta).sum(-1), 2 * motion.energy, rtol=1e-13)
    assert np.allclose(curve[0], curve[-1], atol=1e-14) and np.ptp(curve, axis=0).max() > 0.1
    times = np.linspace(0, 2 * motion.period, 3001)
    path, (velocity, g) = motion.herpolhode(2 * motion.period, 3001), motion.at(times)
    assert np.allclose(path[:, 2], 2 * motion.energy / L, rtol=1e-13)
    assert np.allclose(np.linalg.norm(path, axis=-1), np.linalg.norm(velocity, axis=-1), rtol=1e-13)
    momentum = act(rotation_matrix(g), velocity @ TENSOR)
    assert np.allclose(momentum, motion.momentum, rtol=0, atol=1e-13 * L)
    angles = np.arccos(act(rotation_matrix(g), motion.axis) @ motion.momentum / L)
    assert motion.tilts == pytest.approx((angles.min(), angles.max()), abs=1e-5)


def test_on_the_separatrix() -> None:
    """I_1 (I_2 - I_1) w_1^2 = I_3 (I_3 - I_2) w_3^2 in doubles without rounding: from -e_2 to e_2 in infinite time."""
    body = FreeBody((0.5, 1.0, 1.125))
    motion = body.rotation((0.75, 0.2, 1.0))
    assert motion.kind == "separatrix" and motion.modulus == 1
    assert motion.period == math.inf and motion.flips(50.0).size <= 1
    L = float(np.linalg.norm(motion.momentum))
    assert motion.precession == pytest.approx(L, rel=1e-15)  # L/I_2
    velocity, g = motion.at([-60.0, 0.0, 60.0])
    assert np.allclose(velocity[1], motion.spin, rtol=1e-15)
    assert np.allclose(abs(velocity[[0, 2], 1]), L, rtol=1e-15) and velocity[0, 1] * velocity[2, 1] < 0
    assert np.allclose(act(rotation_matrix(g), velocity @ body.inertia), motion.momentum, atol=1e-14)
    curve = motion.polhode(101)
    assert np.allclose(((curve @ body.inertia) ** 2).sum(-1), L**2, rtol=1e-14)
    one = FreeBody((0.5, 1.0, 1.125)).rotation((0.75, -0.2, 1.0))
    assert motion.flips(50.0).size + one.flips(50.0).size == 1


# ------------------------------------------------------------------------------------------------ bodies and axes


def test_the_state_and_back() -> None:
    spins = np.array(((3.0, -1.0, 4.0), (0.5, 0.2, 0.1)))
    for inertia in (TENSOR, MOMENTS):
        body = FreeBody(inertia, mass="2 kg", time_unit="3 min")
        state = body.state(spins)
        assert np.allclose(body.angular_velocity(state.axial.M), spins, rtol=1e-13)
        moments, axes = body.principal
        assert np.allclose(axes @ np.diag(moments) @ axes.T, body.inertia, rtol=1e-13, atol=1e-16)
        assert np.linalg.det(axes) == pytest.approx(1)
        q = np.array(((1.0, 0, 0, 0), (0.5, -0.1, 0.7, 0.5)))
        assert np.allclose(body.attitude(body.orientation(q)), q)
        turned = rotation_matrix(body.orientation(q))
        assert np.allclose(turned, rotation_matrix(q) @ axes)
    assert np.array_equal(FreeBody(MOMENTS[::-1]).principal.axes, np.eye(3))


def test_a_free_body_is_a_heavy_body_without_weight() -> None:
    spin, body = (3.0, -1.0, 4.0), FreeBody(TENSOR)
    heavy = HeavyBody(1.0, TENSOR, (0, 0, 0))
    run = kr.simulate(heavy.model(), heavy.state(spin), dt=heavy.dt(1e-3), steps=500, order=8)
    assert abs(heavy.angular_velocity(run.M) - body.rotation(spin).at(run.time)[0]).max() < 1e-9


def test_a_spin_is_a_vector_or_a_rate_with_an_axis() -> None:
    body = FreeBody(TENSOR)
    wanted = body.state((0.0, 3.0 * math.pi, 4.0 * math.pi)).M
    assert np.allclose(body.state("150 rpm", (0, 3, 4)).M, wanted, rtol=1e-13)
    assert np.allclose(body.state(("0 rpm", "90 rpm", "120 rpm")).M, wanted, rtol=1e-13)
    assert np.allclose(body.rotation("150 rpm", axis=(0, 3, 4)).spin, (0, 3 * math.pi, 4 * math.pi))


def test_homogeneous_bodies() -> None:
    box = FreeBody.box("12 kg", ("1 m", "2 m", "300 cm"))
    assert np.allclose(np.diag(box.inertia), (4 + 9, 9 + 1, 1 + 4)) and box.mass == 12
    ellipsoid = FreeBody.ellipsoid(5.0, (2.0, 4.0, 6.0))
    assert np.allclose(np.diag(ellipsoid.inertia), (4 + 9, 9 + 1, 1 + 4))
    plate = FreeBody(("40 kg cm^2", "90 kg cm^2", "0.012 kg m^2"))
    assert np.allclose(np.diag(plate.inertia), (0.004, 0.009, 0.012)) and plate.mass is None
    sphere = FreeBody.ellipsoid(5.0, (2.0, 2.0, 2.0), time_unit=7.0)
    assert np.allclose(np.diag(sphere.inertia), 2) and sphere.dt(14.0) == 2.0
    assert np.allclose(np.diag(FreeBody.box(12.0, (1.0, 2.0, 0.0)).inertia), (4, 1, 5))


def test_stability_is_the_growth_in_a_run() -> None:
    """exp(growth t) about the middle axis, the period of small disturbances about the others."""
    body = FreeBody(MOMENTS)
    middle = body.stability(2.0)[1]
    assert (middle.kind, middle.period) == ("unstable", math.inf) and middle.moment == MOMENTS[1]
    assert body.stability(-2.0)[1].growth == middle.growth
    velocity, _ = body.rotation((1e-8, 2.0, 1e-8)).at([6.0, 8.0])
    assert np.log(velocity[1, 2] / velocity[0, 2]) / 2 == pytest.approx(middle.growth, rel=1e-3)
    for i in (0, 2):
        spin = np.full(3, 1e-6)
        spin[i] = 2.0
        assert body.rotation(spin).period == pytest.approx(body.stability(2.0)[i].period, rel=1e-9)
    assert [a.kind for a in FreeBody((1.0, 1.0, 1.5)).stability(1.0)] == ["neutral", "neutral", "stable"]


def test_toutatis() -> None:
    """The long-axis mode of a body of 1.92 x 2.40 x 4.60 km with the periods 5.41 and 7.35 d, taken as an ellipsoid.

    Its density looks homogeneous.  [Hudson, Ostro, Science 270 (1995) 84]  The spin is found by hand from the periods.
    """
    body = FreeBody.ellipsoid(1.0, (4.60e3, 2.40e3, 1.92e3), time_unit="1 d")
    motion = body.rotation((5.82992117e-06, 0.0, 2.13468388e-05)[::-1])
    assert motion.kind == "long-axis mode" and abs(motion.axis[0]) == 1
    assert motion.period / 86400 == pytest.approx(5.41, rel=1e-6)
    assert motion.precession_period / 86400 == pytest.approx(7.35, rel=1e-6)


# ------------------------------------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: FreeBody((1.0, 2.0, 3.5)), "No body has"),
        (lambda: FreeBody((-1.0, 1.0, 1.0)), "No body has"),
        (lambda: FreeBody((0.0, 0.0, 0.0)), "No body has"),
        (lambda: FreeBody([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "symmetric"),
        (lambda: FreeBody(1.0), "inertia must be finite values of shape"),
        (lambda: FreeBody(MOMENTS, mass=0.0), "mass"),
        (lambda: FreeBody(MOMENTS, time_unit="1 kg"), "dimension"),
        (lambda: FreeBody(MOMENTS, time_unit=1e-300), "range of doubles"),
        (lambda: FreeBody((0.0, 1.0, 1.0)), "expected three moments > 0, got 0, 1, 1 kg m.2"),
        (lambda: FreeBody(MOMENTS).state(3.0), "expected three components .*axis=\\(0, 0, 1\\)"),
        (lambda: FreeBody(MOMENTS).state("3 rpm"), "expected three components"),
        (lambda: FreeBody(MOMENTS).state((1.0, 2.0)), "spin must be finite values"),
        (lambda: FreeBody(MOMENTS).state(3.0, (0, 0, 0)), "axis: expected a direction"),
        (lambda: FreeBody(MOMENTS).state((1e308, 1e308, 1e308)), "range of doubles|finite"),
        (lambda: FreeBody(MOMENTS).rotation((0, 0, 0)), "not zero"),
        (lambda: FreeBody(MOMENTS).rotation(np.ones((2, 3))), "one by one"),
        (lambda: FreeBody(MOMENTS).orientation((1, 0, 0)), "attitude: expected unit quaternions"),
        (lambda: FreeBody(MOMENTS).attitude((1, 1, 0, 0)), "g: expected unit quaternions"),
        (lambda: FreeBody(MOMENTS).rotation((1, 2, 3)).at("1 kg"), "dimension"),
        (lambda: FreeBody(MOMENTS).rotation((1, 2, 3)).at([0, math.nan]), "seconds: expected finite"),
        (lambda: FreeBody(MOMENTS).rotation((1, 2, 3)).at(1.0, (1, 1, 1, 1)), "attitude: expected a unit"),
        (lambda: FreeBody(MOMENTS).rotation((1, 2, 3)).polhode(1), "points: expected an integer"),
        (lambda: FreeBody(MOMENTS).rotation((1, 2, 3)).flips(-1.0), "duration"),
        (lambda: FreeBody(MOMENTS).rotation((1, 2, 3)).herpolhode(math.inf), "duration"),
        (lambda: FreeBody.box(1.0, (1.0, -2.0, 3.0)), "at least 0"),
        (lambda: FreeBody.box(1.0, (1.0, 2.0)), r"of shape \(3,\)"),
        (lambda: FreeBody(MOMENTS).dt({"s": 1}), "dt"),
        (lambda: FreeBody((1e-3, 1.0, 1.0)).stability(1e307), "range of doubles"),
        (lambda: FreeBody(MOMENTS).rotation((1e200, 0, 0)).energy, "range of doubles"),
        (lambda: FreeBody(1e-200 * MOMENTS).rotation((1e-200, 0, 0)), "range of doubles"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_is_no_body_and_no_motion(call: object, said: str) -> None:
    with pytest.raises(kr.InputError, match=said):
        call()


def test_a_flat_body_moves_in_closed_form() -> None:
    """A plate: I_3 = I_1 + I_2; against its own closed form in SI units, and refused by the map."""
    plate = FreeBody((1.0, 2.0, 3.0))
    spin = (0.1, 2.0, 0.3)
    run = kr.simulate(
        plate.model(), plate.state(spin), dt=plate.dt(0.01), steps=500, every=50, method="exact", progress=False
    )
    assert kr.drift(run)["ulps"].max() < 64
    there, _ = plate.rotation(spin).at(np.arange(11) * 0.5)
    assert abs(plate.angular_velocity(run.M) - there).max() < 1e-12
    with pytest.raises(kr.InputError, match="got a flat body"):
        kr.simulate(plate.model(), plate.state(spin), dt=0.1, steps=1, method="veselov", progress=False)
    for J in ((0, 0, 1), (-1, 2, 3)):
        with pytest.raises(kr.InputError, match=r"No body has the principal moments"):
            kr.EulerTop(J=J)


def test_a_run_is_not_a_spin() -> None:
    body = FreeBody((1.0, 2.0, 2.5))
    run = kr.simulate(body, body.state((1, 2, 3)), dt=0.1, steps=1, progress=False)
    with pytest.raises(kr.InputError, match="a Dataset"):
        body.state(run)


def test_a_spin_of_many_axes_is_refused() -> None:
    spin: object = [1.0, 2.0, 3.0]
    for _ in range(80):
        spin = [spin]
    with pytest.raises(kr.InputError, match="spin"):
        FreeBody((1.0, 2.0, 2.5)).rotation(spin)


def test_both_periods_of_many_motions_are_those_of_each():
    body = FreeBody([[2.0, 0.1, 0], [0.1, 3, 0.2], [0, 0.2, 2.6]])
    spins = np.random.default_rng(0).normal(size=(20, 3))
    periods = body.periods(spins)
    for k, motion in enumerate(map(body.rotation, spins)):
        assert periods.rotation[k] == pytest.approx(motion.period, rel=1e-11)
        assert periods.precession[k] == pytest.approx(motion.precession_period, rel=1e-11)
        assert periods.short_axis[k] == (motion.kind == "short-axis mode")
    assert 0 < periods.short_axis.sum() < 20 and np.isnan(FreeBody((1, 2, 2.5)).periods((0, 0, 1)).rotation)
    with pytest.raises(InputError, match="three different moments"):
        FreeBody((1, 1, 1.5)).periods(spins)
