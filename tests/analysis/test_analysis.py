"""kr.analysis against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel import analysis, physical
from kreisel.analysis.frequencies import lines_of

P, M0, A0 = (0, 0, 1), (0.1, 0.2, 1.5), (0.6, 0, 0.8)
IDENTITY = (1.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def exact():
    top = kr.LagrangeTop(p=P, alpha=0.7)
    x0 = top.state(m=M0, a=A0)
    return kr.simulate(top, x0, dt=0.1, steps=4000, method="exact", orientation=IDENTITY, progress=False)


@pytest.fixture(scope="module")
def mapped():
    top = kr.LagrangeTop(p=P)
    return kr.simulate(top, top.state(m=M0, a=A0), dt=0.05, steps=4000, order=8, progress=False)


# -- angles and rates ---------------------------------------------------------------------------------------------


def test_euler_angles_rebuild_the_orientation(exact):
    angles = analysis.euler_angles(exact)
    again = Rotation.from_euler("ZXZ", np.stack([angles.phi, angles.theta, angles.psi], -1))
    g, axis = analysis.rotations(exact), exact.a.values
    assert np.allclose(np.cos(angles.theta), axis[:, 2] / np.linalg.norm(axis, axis=-1), atol=1e-13)
    # the body's axis is not its third one here: both differ by one constant turn of the body
    constant = (g.inv() * again).as_matrix()
    assert abs(constant - constant[0]).max() < 1e-11
    assert abs(np.diff(angles.psi)).max() < np.pi


def test_quaternions_are_continuous_and_scipy_s(exact):
    q = analysis.quaternions(exact)
    assert abs(np.diff(q, axis=0)).max() < 0.2
    assert np.allclose(Rotation.from_quat(q, scalar_first=True).as_matrix(), analysis.rotations(exact).as_matrix())


def test_rates_are_the_derivatives_of_the_angles(exact):
    """Differences of order 8 of the angles against the rates from the state."""
    angles, rates = analysis.euler_angles(exact), analysis.rates(exact)
    weights = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]) / 0.1
    for angle, rate in (("phi", "precession"), ("theta", "nutation"), ("psi", "own_turn")):
        slope = np.convolve(angles[angle].values, weights[::-1], "valid")[:200]
        assert abs(slope - rates[rate].values[4:204]).max() < 2e-6 * abs(slope).max(), angle
    assert np.allclose(rates.spin, rates.spin[0], atol=1e-12)
    assert np.allclose(rates.tilt, angles.theta, atol=1e-12)


def test_the_moving_frame_gives_the_same_angles_and_rates(exact):
    """The same motion in the moving frame; M and P by the orientation."""
    g = analysis.rotations(exact)
    axis = g[0].inv().apply(A0)
    body = kr.LagrangeTopMoving(A=axis, alpha=0.7)
    y0 = body.state(M=g[0].inv().apply(exact.m[0]), P=g[0].inv().apply(P))
    other = kr.simulate(body, y0, dt=0.1, steps=500, method="exact", orientation=IDENTITY, progress=False)
    for table in (analysis.rates, analysis.euler_angles):
        one, two = table(exact.isel(time=slice(0, 501))), table(other)
        for name in one:
            assert np.allclose(one[name], two[name], atol=1e-10), name
    assert np.allclose(analysis.mean_rates(other).difference, 0, atol=1e-10)


def test_mean_rates_meet_the_closed_form(exact, mapped):
    table = analysis.mean_rates(exact)
    assert abs(table.difference).max() < 1e-12
    assert abs(analysis.mean_rates(mapped).difference).max() < 1e-8  # order 8, dt = 0.05
    assert np.isfinite(table.closed_form).all()


def test_a_fast_top_precesses_as_the_textbook_says():
    """W = m g l/(I3 w3) up to the square of the nutation's share: [Goldstein, section 5.7]."""
    wheel = physical.Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15)
    spin = 60.0
    slow, _ = wheel.steady_precession(1.2, spin)
    run = kr.simulate(wheel.model(), wheel.state(1.2, spin), dt=0.02, steps=4000, method="exact", progress=False)
    found = analysis.mean_rates(run).measured
    assert abs(found.mean_precession / wheel.time_unit / slow - 1) < 1e-2
    assert abs(found.nutation_frequency / wheel.time_unit / wheel.nutation_rate(spin) - 1) < 2e-2


def test_every_lane_has_its_own_axes_and_parameters():
    tops = kr.LagrangeTop(p=[P, (0.5, 0, 1)], alpha=[0.7, 1.1])
    x0 = tops.state(m=M0, a=[A0, (0, 0.6, 0.8)])
    run = kr.simulate(tops, x0, dt=0.1, steps=300, orientation=(1, 0, 0, 0), progress=False)
    angles, rates, cut = analysis.euler_angles(run), analysis.rates(run), analysis.events(run, "a[2]", 0.5)
    assert np.allclose(angles.theta, rates.tilt, atol=1e-12)
    for lane in (0, 1):
        one = run.isel(lane=lane)
        assert np.allclose(analysis.euler_angles(one).phi, angles.phi[:, lane], atol=1e-12)
        assert np.allclose(analysis.rates(one).precession, rates.precession[:, lane], atol=1e-12)
        times = cut["time"].values[cut["lane"].values == lane]
        assert np.allclose(analysis.events(one, "a[2]", 0.5)["time"], times, atol=1e-11)
        assert np.allclose(analysis.events(run.isel(lane=[lane]), "a[2]", 0.5)["time"], times, atol=1e-11)
        assert np.isfinite(analysis.mean_rates(one).measured).all()
    with pytest.raises(kr.InputError, match="expected a run of some lanes of its system, which has 2"):
        analysis.rates(run.isel(lane=0).drop_vars("lane"))


def test_angles_complain():
    body = kr.Clebsch(b=(1, 2, 3))
    run = kr.simulate(body, body.state(M=(1, 0, 0.3), P=(0, 0.6, 0.8)), dt=0.1, steps=50, progress=False)
    with pytest.raises(kr.InputError, match="no orientation"):
        analysis.euler_angles(run)
    with pytest.raises(kr.InputError, match="no vertical and axis"):
        analysis.rates(run)
    top = kr.LagrangeTop(p=P)
    steady = kr.simulate(top, top.state(m=(0, 0, 3), a=(0, 0, 1)), dt=0.1, steps=50, progress=False)
    assert np.isnan(analysis.rates(steady).precession).all()
    with pytest.raises(kr.InputError, match="steady"):
        analysis.mean_rates(steady)
    free = kr.physical.FreeBody((1, 2, 2.5))
    with pytest.raises(kr.InputError, match=r"^euler-top with n = 3 has no vertical and axis; .*SymmetricTop, .*\)\.$"):
        analysis.mean_rates(kr.simulate(free, free.state((0.1, 0.2, 0.3)), dt=0.1, steps=20))
    sparse = kr.simulate(top, top.state(m=M0, a=A0), dt=3.0, steps=200, method="exact", progress=False)
    with pytest.raises(kr.InputError, match="save more often"):
        analysis.mean_rates(sparse)


# -- events, sections, return maps --------------------------------------------------------------------------------


def test_events_are_located_to_round_off(exact, mapped):
    for run in (exact, mapped):
        found = analysis.events(run, "a[2]", 0.5)
        assert found.sizes["event"] > 20
        assert abs(found.a[:, 2] - 0.5).max() < 1e-13
        assert (np.diff(found.time) > 0).all()
        assert (found.rising.values[1:] != found.rising.values[:-1]).all()


def test_events_come_once_a_period(exact):
    """a.p = 1/2, rising, once a nutation: the times differ by the closed form's period."""
    period = kr.nutation(kr.LagrangeTop(p=P, alpha=0.7), {"m": M0, "a": A0}).period
    found = analysis.events(exact, lambda m, a: a[..., 2], 0.5, rising=True)
    assert np.allclose(np.diff(found.time), period, rtol=0, atol=2e-12)
    assert found.rising.all()


def test_the_flow_joins_rows_of_any_map_and_lane():
    """Ensemble with a parameter a lane: as single runs; and as the exact flow says."""
    top = kr.LagrangeTop(p=[(0, 0, 1.0), (0, 0, 0.7)])
    x0 = {"m": M0, "a": A0}
    both = kr.simulate(top, x0, dt=0.05, steps=1000, order=8, progress=False)
    found = analysis.events(both, "a[0]", 0.1, rising=False)
    for lane, size in enumerate((1.0, 0.7)):
        single = kr.LagrangeTop(p=(0, 0, size))
        alone = analysis.events(
            kr.simulate(single, x0, dt=0.05, steps=1000, order=8, progress=False), "a[0]", 0.1, rising=False
        )
        own = found.time[found.lane == lane]
        assert len(own) > 5 and np.allclose(own, alone.time, atol=1e-11)
        there = kr.at(single, x0, own.values)
        assert abs(there.a[:, 0] - 0.1).max() < 1e-8  # the error of the map, order 8


def test_events_of_a_free_body_are_those_of_scipy():
    """Of a state of one component, M' = M x Omega."""
    moments = np.array([0.9, 1.3, 1.6])
    solution = solve_ivp(
        lambda t, M: np.cross(M, M / moments),
        (0, 200),
        (0.1, 1.0, 0.2),
        "DOP853",
        rtol=1e-12,
        atol=1e-13,
        events=lambda t, M: M[1],
    )
    top = kr.EulerTop(J=(1.0, 0.6, 0.3))
    run = kr.simulate(top, top.state(M=(0.1, 1.0, 0.2)), dt=0.1, steps=2000)
    assert len(solution.t_events[0]) > 5
    assert np.allclose(analysis.events(run, "M[1]").time, solution.t_events[0], atol=1e-8)


def test_a_section_carries_the_orientation(exact):
    cut = analysis.section(exact, "a[1]")
    g = Rotation.from_quat(cut.g.values, scalar_first=True)
    body = analysis.rotations(exact)[0].inv().apply(A0)
    assert abs(g.apply(body) - cut.a.values).max() < 1e-11


def test_the_return_map_of_an_integrable_top_is_a_turn(exact):
    """On the section through the lowest points the azimuth advances by kr.nutation's precession."""
    top = kr.LagrangeTop(p=P, alpha=0.7)
    motion = kr.nutation(top, {"m": M0, "a": A0})
    climb = lambda m, a: m[..., 0] * a[..., 1] - m[..., 1] * a[..., 0]  # noqa: E731
    returns = analysis.return_map(exact, climb, lambda m, a: np.arctan2(a[..., 1], a[..., 0]))
    turn = (returns.after - returns.here - motion.precession) / (2 * np.pi)
    assert abs(turn - np.round(turn)).max() < 1e-12
    assert np.allclose(returns.elapsed, motion.period, atol=1e-12)
    twice = analysis.return_map(exact, climb, "a[0]", returns=2)
    assert np.allclose(twice.elapsed, 2 * motion.period, atol=1e-12)


def test_events_of_a_free_particle_on_the_sphere():
    """Neumann with b = 0: great circles, x3 = 0 every pi/|q|."""
    model = kr.Neumann(b=(0, 0, 0))
    q = np.array((0.0, 1.2, 0.9))
    run = kr.simulate(model, model.state(x=(1, 0, 0), q=q), dt=0.1, steps=500, progress=False, method="dop853")
    found = analysis.events(run, "x[2]")
    assert np.allclose(found.time, np.pi / 1.5 * np.arange(1, 1 + len(found.time)), atol=1e-6)
    fine = analysis.events(run.isel(time=slice(0, 40)), "x[2]")
    assert abs(fine.time[0] - np.pi / 1.5) < 1e-9


def test_events_complain(mapped):
    for bad, message in (
        ("b[0]", "not a component"),
        ("a", "one number"),
        ("a[7]", "one number"),
        ("a[", "name such as"),
    ):
        with pytest.raises(kr.InputError, match=message):
            analysis.events(mapped, bad)
    with pytest.raises(kr.InputError, match="one value for each state"):
        analysis.events(mapped, lambda m, a: a)
    with pytest.raises(kr.InputError, match="returns"):
        analysis.return_map(mapped, "a[0]", "a[1]", returns=0)
    backwards = mapped.isel(time=slice(None, None, -1))
    with pytest.raises(kr.InputError, match="order of time"):
        analysis.events(backwards, "a[2]", 0.5)
    assert analysis.events(backwards.sortby("time"), "a[2]", 0.5).equals(analysis.events(mapped, "a[2]", 0.5))
    assert analysis.events(mapped, "a[2]", 7.0).sizes["event"] == 0
    assert analysis.return_map(mapped, "a[2]", "a[1]", 7.0).sizes["event"] == 0


# -- frequencies --------------------------------------------------------------------------------------------------


def test_lines_of_a_sum_are_found_to_1e_12():
    rng = np.random.default_rng(1)
    t = np.arange(4096) * 0.1 + 3.0
    omega = np.array([0.731, -1.2771, 2.902, 0.119, 5.5])
    c = np.array([1.0, 0.3, 0.02, 1e-3, 1e-5]) * np.exp(1j * rng.uniform(0, 6, 5))
    found = lines_of(t, np.exp(1j * np.outer(t, omega)) @ c, 5)
    assert abs(found.frequency[:4] - omega[:4]).max() < 1e-12
    assert abs(found.frequency - omega).max() < 1e-11 and abs(found.amplitude - c).max() < 1e-12
    real = lines_of(t, 0.4 + (np.exp(1j * np.outer(t, np.abs(omega))) @ c).real, 6)
    order = [1.0, 0.4, 0.3, 0.02, 1e-3, 1e-5]
    assert np.allclose(abs(real.amplitude), order, atol=1e-11)
    assert np.allclose(np.delete(real.frequency, 1), abs(omega), atol=1e-11)


def test_few_samples_of_one_line_are_enough():
    t = np.arange(64) * 0.25
    found = lines_of(t, np.cos(1.37 * t + 0.4), 3)
    assert abs(found.frequency[0] - 1.37) < 1e-12 and found.remainder < 1e-14
    assert abs(found.amplitude[0] - np.exp(0.4j)) < 1e-12


def test_frequencies_of_the_top_are_those_of_the_closed_form(exact):
    """a_x + i a_y has the lines precession + k nutation, a_z those of nutation: to 1e-11."""
    motion = kr.nutation(kr.LagrangeTop(p=P, alpha=0.7), {"m": M0, "a": A0})
    nutation, precession = 2 * np.pi / motion.period, motion.mean_precession
    plane = analysis.frequencies(exact, lambda m, a: a[..., 0] + 1j * a[..., 1], 6)
    k = (plane.frequency - precession) / nutation
    assert abs(k - np.round(k)).max() < 1e-10
    height = analysis.frequencies(exact, "a[2]", 4)
    k = height.frequency / nutation
    assert abs(k[:3] - np.round(k[:3])).max() < 1e-11


def test_the_power_spectrum_has_the_right_integral(exact):
    spectrum = analysis.power_spectrum(exact, "a[2]")
    step = float(spectrum.frequency[1] - spectrum.frequency[0])
    assert float(spectrum.power.sum()) * step == pytest.approx(float(exact.a[:, 2].var()), rel=2e-2)
    both = analysis.power_spectrum(exact, lambda m, a: a[..., 0] + 1j * a[..., 1])
    assert (np.diff(both.frequency) > 0).all() and float(both.frequency[0]) < 0


def test_frequencies_complain(exact):
    for times in (np.arange(32.0) ** 2, -np.arange(32.0)):
        with pytest.raises(kr.InputError, match=r"evenly spaced, rising times, .* kr\.at at other times"):
            lines_of(times, np.ones(32))
    with pytest.raises(kr.InputError, match="At least 16"):
        analysis.frequencies(exact.isel(time=slice(0, 5)), "a[0]")
    with pytest.raises(kr.InputError, match="lines must"):
        analysis.frequencies(exact, "a[0]", 0)


# -- comparison ---------------------------------------------------------------------------------------------------


def test_comparison_measures_the_error_of_a_map():
    top, x0 = kr.LagrangeTop(p=P), {"m": M0, "a": A0}
    far = {
        dt: analysis.compare(
            kr.simulate(top, x0, dt=dt, steps=round(40 / dt), every=round(0.4 / dt), progress=False, method="exact"),
            kr.simulate(top, x0, dt=dt, steps=round(40 / dt), every=round(0.4 / dt), progress=False, order=4),
        )
        for dt in (0.4, 0.2, 0.1)
    }
    worst = [float(c.distance.a.max()) for c in far.values()]
    orders = np.diff(np.log2(worst)) * -1
    assert np.allclose(orders, 4, atol=0.3)
    assert abs(far[0.1].growth() - 1) < 0.3  # the phase drifts linearly
    assert far[0.1].apart(1e9) == np.inf
    middle = float(np.median(far[0.4].distance.a))
    time = far[0.4].apart(middle)
    assert 0 < time < 40 and float(far[0.4].distance[["m", "a"]].sel(time=time).to_array().max()) > middle
    assert {"casimir[0]", "energy"} <= set(far[0.1].drift.index)


def test_comparison_of_orientations_is_an_angle():
    top, x0 = kr.LagrangeTop(p=P), {"m": M0, "a": A0}
    angle = 0.3
    turned = (np.cos(angle / 2), 0, 0, np.sin(angle / 2))
    runs = [
        kr.simulate(top, x0, dt=0.1, steps=100, orientation=g, progress=False) for g in (IDENTITY, turned)
    ]  # g h: the turn h of the body stays
    gap = analysis.compare(*runs).distance
    assert np.allclose(gap.g, angle, atol=1e-12) and float(gap.a.max()) == 0


def test_comparison_complains(mapped):
    body = kr.Clebsch(b=(1, 2, 3))
    other = kr.simulate(body, body.state(M=(1, 0, 0.3), P=(0, 0.6, 0.8)), dt=0.1, steps=50, progress=False)
    with pytest.raises(kr.InputError, match="one system"):
        analysis.compare(mapped, other)
    with pytest.raises(kr.InputError, match="in common"):
        analysis.compare(mapped.isel(time=slice(0, 10)), mapped.isel(time=slice(20, 30)))


@pytest.fixture(scope="module")
def short() -> Any:
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    return kr.simulate(top, x0, dt=0.1, steps=40, orientation=(1, 0, 0, 0))


def without(run: Any, name: str) -> Any:
    return run.drop_attrs().assign_attrs({k: v for k, v in run.attrs.items() if k != name})


@pytest.mark.parametrize(
    "call",
    [
        lambda run: analysis.rates(run.isel(time=-1)),
        lambda run: analysis.quaternions(run.isel(time=-1)),
        lambda run: analysis.compare(run.isel(time=-1), run),
        lambda run: analysis.compare(run.rename(m="other"), run),
        lambda run: analysis.compare(run * 1e200, run),
        lambda run: analysis.rates(run.transpose("axis", ...)),
        lambda run: analysis.power_spectrum(run.isel(time=slice(0, 0)), "a[0]"),
        lambda run: analysis.frequencies(run.map(lambda v: v * 1e200, keep_attrs=True), "a[0]"),
        lambda run: analysis.rotations(run.assign(g=0 * run.g)),
        lambda run: analysis.euler_angles(run.assign_coords(time=run.time * np.inf)),
        lambda run: analysis.events(run, lambda m, a: a[..., 0] + 1j * a[..., 1]),
        lambda run: analysis.events(run.assign_attrs(kreisel_sweep=1).drop_attrs(), "a[0]"),
        lambda run: analysis.section(xr.Dataset(attrs={"system": "lagrange-top"}, coords={"time": [0.0, 1.0]}), "a[0]"),
        lambda run: kr.drift(run.isel(time=slice(0, 0))),
        lambda run: kr.drift(1.5),
        lambda run: analysis.power_spectrum(run.rename(a="other"), lambda m, a: a[..., 0]),
        lambda run: analysis.rates(run.assign_attrs(system={1, 2})),
        lambda run: analysis.rates(run.map(lambda v: v * (1.7e308 if v.name == "m" else 1), keep_attrs=True)),
        lambda run: analysis.events(run, "a[0]", system=kr.LagrangeTop(p=(0, 0, 1, 0))),
        lambda run: analysis.section(run, "a[0]", system=kr.LagrangeTop(p=(0, 0, 1, 0))),
        lambda run: analysis.euler_angles(run, system=kr.LagrangeTop(p=(0, 0, 1, 0))),
        lambda run: analysis.mean_rates(run, system=kr.LagrangeTop(p=(0, 0, 1, 0))),
        lambda run: analysis.rates(without(run, "n"), system=kr.LagrangeTop(p=(0, 0, 1, 0))),
        lambda run: analysis.rates(run.assign_attrs(parameters='{"p": [0, 0, 1, 0]}')),
        lambda run: analysis.euler_angles(run.drop_attrs()),
        lambda run: analysis.euler_angles(run.assign_attrs(parameters='"x"')),
        lambda run: analysis.euler_angles(run.assign_attrs(parameters=[1])),
        *(
            lambda run, factor=factor, act=act: act(run.assign(a=run.a * factor))
            for factor in (0.0, 1e-200, 1e160, 1e300)
            for act in (analysis.euler_angles, analysis.rates, analysis.mean_rates)
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_rows_that_are_no_rows_of_a_run(call: Any, short: Any) -> None:
    with xr.set_options(keep_attrs=True), np.errstate(all="ignore"), pytest.raises(kr.InputError, match="xpected"):
        call(short)


def test_runs_of_two_bodies_are_compared_in_si() -> None:
    """The momentum I w and the attitude, which are given, of bodies whose states have other units and axes."""
    turn = Rotation.from_rotvec([0.3, 0.2, -0.4]).as_matrix()
    bodies = [kr.physical.FreeBody((1.05, 2.0, 2.5)), kr.physical.FreeBody(turn @ np.diag((1.0, 2.0, 2.6)) @ turn.T)]
    w, attitude = np.array([0.3, 1.0, 0.2]), (0.8, 0.0, 0.6, 0.0)
    runs = [kr.simulate(body, body.state(w, attitude=attitude), dt=0.05, steps=20, progress=False) for body in bodies]
    first, second = (body.inertia @ w for body in bodies)
    start = analysis.compare(*runs).distance.isel(time=0)
    assert float(start.momentum) == pytest.approx(np.linalg.norm(first - second) / np.linalg.norm(first), rel=1e-12)
    assert float(start.attitude) < 1e-12
