"""method="exact" and kr.at: the closed form against Taylor series, quadrature, the paper's map, and itself."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import mpmath
import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel import algebra
from kreisel.exact import motion as motions, parts
from kreisel.exact.motion import TopMotion
from kreisel.exact.nutation import Nutation
from kreisel.kernels.exact import engine
from kreisel.kernels.exact.engine import dyadic
from kreisel.runs import integration as runs
from kreisel.runs.planning import make_plan
from kreisel.sweeps.sweep import check_archive
from sizes import full
from taylor import quadrature, taylor
from tops import DOUBLE, SPECIAL, UP, error, off, off_turn, random_tops


@pytest.fixture(autouse=True)
def _in_many_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    """No jumps: they have tests of their own."""
    monkeypatch.setattr(engine.jumps, "ROWS", {})
    monkeypatch.setattr(engine.jumps, "TOLERANCE", -1.0)


ALIKE = (  # they go the way of others
    "fast, hanging",
    "slow",
    "spherical pendulum",
    "pendulum near the separatrix",
    "sleeping, unstable, disturbed",
    "sleeping, stable, disturbed",
    "through the bottom",
)


@pytest.mark.parametrize("name", [*(name for name in SPECIAL if name not in ALIKE), *full(*ALIKE)])
def test_special_motions_against_taylor(name: str) -> None:
    m, b, p = SPECIAL[name]
    unit = 0.1 if name in ("very fast", "falling asleep") else 1.0
    assert error(m, b, p, -6.7 * unit) < DOUBLE


@pytest.mark.parametrize(
    ("m", "a", "time"),
    [
        ((3e-17, 5e-17, 2e-17), (7e-17, -4e-17, -1), 7.3),  # hangs
        ((3e-20, 5e-20, 2e-20), (7e-20, -4e-20, 1), 7.3),  # stands upright
        ((3e-17, 5e-17, 3), (7e-17, -4e-17, 1), 7.3),  # sleeps
        ((3e-13, 5e-13, 2), (7e-13, -4e-13, 1), 0.3),  # sleeps, with the critical spin
        ((3e-20, 5e-20, 2), (7e-20, -4e-20, 1), 7.3),
        ((0, 0, 0), (0.6, -0.4, 0.8), 1e-9),  # begins to fall
        ((3e-60, 5e-60, 2e-60), (0.6, -0.4, 0.8), 1e-60),
        ((1e-160, 0, 2e-160), (1e-160, 0, 0), 1.0),
    ],
)
def test_small_motions_keep_their_digits(m: tuple[float, ...], a: tuple[float, ...], time: float) -> None:
    """Components across gravity, relative to these; rows of `kr.at`, and of runs by equal steps."""
    least = min(abs(v) for v in (*m, *a, time) if v)
    want = taylor(m, a, UP, time, digits=24 + math.ceil(-math.log10(least)))
    there = kr.at(kr.LagrangeTop(p=UP), {"m": m, "a": a}, time, orientation=(1, 0, 0, 0))
    run = kr.simulate(kr.LagrangeTop(p=UP), {"m": m, "a": a}, dt=time / 4, steps=4, method="exact", observe=())
    for got, series in ((there.m, want[0]), (there.a, want[1]), (run.m[-1], want[0]), (run.a[-1], want[1])):
        across, size = series[:2], max(abs(float(v)) for v in series[:2])
        assert max(abs(float(x - float(v))) for x, v in zip(across, got.values[:2], strict=True)) < DOUBLE * size
    assert off_turn(there.g.values, want[2]) < DOUBLE


@pytest.mark.parametrize("number", [*range(5), *full(*range(5, 20))])
def test_random_tops_against_taylor(number: int) -> None:
    draw = np.random.default_rng(number)
    m, b, p = random_tops(20)[number]
    assert error(m, b, p, draw.uniform(-5, 5), alpha=draw.uniform(0.2, 2)) < DOUBLE


@pytest.mark.parametrize(("name", "time"), [("falling asleep", 7.5), ("pendulum on the separatrix", -33.0)])
def test_settling_on_the_separatrix(name: str, time: float) -> None:
    """Against Taylor with digits for e^(70), and asleep ever after."""
    m, b, p = SPECIAL[name]
    assert error(m, b, p, time, digits=60) < DOUBLE
    top = kr.LagrangeTop(p=p)
    run = kr.at(top, {"m": m, "a": b}, [45.0, 1e12], orientation=(1, 0, 0, 0))
    asleep = np.linalg.norm(b) / np.linalg.norm(p) * np.array(p)
    assert abs(run.a.values - asleep).max() < DOUBLE * np.linalg.norm(b)
    spin = np.dot(m, b) / np.linalg.norm(b)
    turned = algebra.rotation_matrix(run.g.values) @ np.array(b)
    assert abs(turned - asleep).max() < 1e-14
    if name == "falling asleep":
        rate = float(spin)  # exactly 3
        later = kr.at(top, {"m": m, "a": b}, [45.0, 45.0 + 2**40], orientation=(1, 0, 0, 0)).g.values
        with mpmath.workdps(40):
            angle = float(mpmath.fmod(mpmath.mpf(2) ** 40 * rate, 2 * mpmath.pi))
        about = np.array([math.cos(angle / 2), 0, 0, math.sin(angle / 2)])
        assert off_turn(algebra.quaternion_product(about, later[0]), later[1]) < 1e-14


@pytest.mark.parametrize("number", [0, 1, *full(2, 3)])
def test_a_million_million_periods_on(number: int) -> None:
    """b turns by the azimuth in each period, g = Rot_p(azimuth) g Rot_b(...); the rest by Taylor."""
    digits = 50
    m, b, p = SPECIAL["generic"] if number == 0 else random_tops(20)[number]
    period, azimuth, turn = quadrature(m, b, p, digits=digits)
    with mpmath.workdps(digits):
        time = float(10**12 * period * (1 + number) * (-1) ** number + 0.12 * period)
        count = int(mpmath.nint(mpmath.mpf(time) / period))
        import flint

        flint.ctx.prec = 180
        rest = flint.arb(mpmath.nstr(mpmath.mpf(time) - count * period, 40))
        flint.ctx.prec = 53
        left, right = (float(mpmath.fmod(count * angle, 4 * mpmath.pi)) for angle in (azimuth, turn))
    m1, b1, q1 = taylor(m, b, p, rest, digits=25)
    run = kr.at(kr.LagrangeTop(p=p), {"m": m, "a": b}, time, orientation=(1, 0, 0, 0))
    about_p, about_b = (turn_about(v, w) for v, w in ((p, left), (b, right)))
    R = algebra.rotation_matrix(about_p)
    want = algebra.quaternion_product(about_p, algebra.quaternion_product(q1.astype(float), about_b))
    assert off(run.m.values, R @ m1.astype(float)) < DOUBLE
    assert off(run.a.values, R @ b1.astype(float)) < DOUBLE
    assert off_turn(run.g.values, want) < DOUBLE


def turn_about(axis: object, angle: float) -> np.ndarray:
    """The unit quaternion of a rotation about an axis of any length."""
    axis = np.array(axis, dtype=float)
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_quat(scalar_first=True)


def nutation_of(m: object, b: object, p: object, digits: int = 30) -> Nutation:
    context = mpmath.MPContext()
    context.dps = digits
    return Nutation(context, motions.Integrals.of(*(motions.rationals(v) for v in (m, b, p))))


@pytest.mark.parametrize("number", [0, 5, *full(1, 2, 3, 4)])
def test_the_papers_map_is_the_flow_after_a_turn(number: int) -> None:
    """D_eps^N = Rot_p(N theta) Phi_(N tau), D_eps the registry's map in the variables (m, b)."""
    m, b, p = random_tops(20)[number]
    nutation = nutation_of(m, b, p)
    context, steps = nutation.ctx, 1000
    eps = float(nutation.epsilon(nutation.half_period * (0.1 + 0.07 * number)))
    r = float(nutation.length(context.mpf(eps)))
    hat = eps / 2 * algebra.hat(m)
    a = algebra.resolvent(hat, (b - eps**2 / 4 * r * p)[:, None])[:, 0]
    assert a @ a == pytest.approx(r, rel=1e-14)
    top = kr.LagrangeTop(p=p)
    run = kr.simulate(top, {"m": m, "a": a}, dt=eps, steps=steps, every=steps, method="suris", order=1)
    m_end, a_end = run.m.values[-1], run.a.values[-1]
    b_end = a_end - eps / 2 * np.cross(m_end, a_end) + eps**2 / 4 * r * p
    time = steps * nutation.tau(context.mpf(eps))
    flown = kr.at(top, {"m": m, "a": b}, float(time))
    angle = float(context.fmod(steps * nutation.theta(context.mpf(eps)), 2 * context.pi))
    R = algebra.rotation_matrix(turn_about(p, angle))
    assert off(m_end, R @ flown.m.values) < 1e-9  # the map's own round-off, a thousand times over
    assert off(b_end, R @ flown.a.values) < 1e-9


@pytest.mark.parametrize("name", [n for n in SPECIAL if not n.startswith("at rest")])
def test_tau_inverts_epsilon(name: str) -> None:
    nutation = nutation_of(*SPECIAL[name], digits=60)
    most = min(nutation.half_period, 2)
    for part in (0.5, -0.3, 1e-3):
        eps = nutation.epsilon(part * most)
        if not mpmath.isnan(eps):
            assert abs(nutation.tau(eps) - part * most) < 1e-25 * most


def wrong_theta(nutation: Nutation, eps: object, dual: bool = False) -> object:
    return -THETA(nutation, eps, dual)


def wrong_dual_theta(nutation: Nutation, eps: object, dual: bool = False) -> object:
    return -THETA(nutation, eps, dual) if dual else THETA(nutation, eps)


def half_a_turn_off(nutation: Nutation, dual: bool = False) -> object:
    return PERIOD_TURN(nutation, dual) - nutation.ctx.pi


def turned_back(nutation: Nutation, dual: bool = False) -> object:
    return -PERIOD_TURN(nutation, dual)


def same_turn_in_the_body(nutation: Nutation, dual: bool = False) -> object:
    return PERIOD_TURN(nutation)


def roots_reversed(nutation: Nutation) -> object:
    return ROOTS(nutation)[::-1]


def upper_roots_exchanged(nutation: Nutation) -> object:
    x1, x2, x3 = ROOTS(nutation)
    return x1, x3, x2


THETA, PERIOD_TURN, ROOTS = Nutation.theta, Nutation.period_turn, Nutation._roots
MUTANTS = [
    (Nutation, "theta", wrong_theta),
    (Nutation, "theta", wrong_dual_theta),
    (Nutation, "period_turn", half_a_turn_off),
    (Nutation, "period_turn", turned_back),
    (Nutation, "period_turn", same_turn_in_the_body),
    (Nutation, "_roots", roots_reversed),
    (Nutation, "_roots", upper_roots_exchanged),
]


@pytest.mark.parametrize(("owner", "name", "mutant"), MUTANTS, ids=[f.__name__ for _, _, f in MUTANTS])
def test_mutants_are_caught(owner: object, name: str, mutant: object, monkeypatch: pytest.MonkeyPatch) -> None:
    generic = SPECIAL["generic"]  # right without the mutant: test_special_motions_against_taylor
    monkeypatch.setattr(owner, name, mutant)
    try:
        assert error(*generic, -6.7) > 10 * DOUBLE
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        pass  # complex or infinite numbers: caught too


def test_digits_follow_the_number_of_periods(monkeypatch: pytest.MonkeyPatch) -> None:
    """In many digits; without more of them for more periods, a million million on, the state would be wrong."""
    m, b, p = SPECIAL["generic"]
    top, state, turn = kr.LagrangeTop(p=p), {"m": m, "a": b}, (1, 0, 0, 0)
    right = kr.at(top, state, 1e13, orientation=turn).a.values
    monkeypatch.setattr(TopMotion, "_digits", lambda self, reach: 60)
    assert (kr.at(top, state, 1e13, orientation=turn).a.values == right).all()
    monkeypatch.setattr(TopMotion, "_digits", lambda self, reach: 18)
    assert abs(kr.at(top, state, 1e13, orientation=turn).a.values - right).max() > 1e-8


# -- the interface ------------------------------------------------------------------------------------


def test_simulate_and_at_are_the_same_numbers(top: object, x0: object, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {
        "dt": 0.375,
        "steps": 403,
        "every": 4,
        "method": "exact",
        "orientation": (1, 0, 0, 0),
    }  # k dt is a double
    run = kr.simulate(top, x0, **options)
    states = kr.at(top, x0, run.time.values, orientation=(1, 0, 0, 0))
    for name in run.data_vars:
        assert (run[name].values == states[name].values).all()
    monkeypatch.setattr(runs, "BLOCK_BYTES", 6 * 8 * 5)
    monkeypatch.setattr(runs, "TICK_SECONDS", 0.0)
    xr.testing.assert_identical(run.drop_attrs(), kr.simulate(top, x0, **options).drop_attrs())


@pytest.mark.parametrize("frame", ["rest", "moving"])
def test_rows_are_those_of_the_definition_in_any_cut_and_on_any_threads(
    frame: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel is the function of the method; threads, calls and a table with few places change no bit."""
    model, state = {
        "rest": (kr.LagrangeTop(p=(0.3, -0.8, 0.5), alpha=0.6), {"m": (0.3, 0.7, -1.1), "a": (0.2, 0.5, -0.4)}),
        "moving": (kr.LagrangeTopMoving(A=(0.3, -0.8, 0.5), alpha=0.6), {"M": (3, 5, 8), "P": (0.2, 0.5, -0.4)}),
    }[frame]
    options = {"dt": 0.37, "steps": 10**9, "every": 1, "method": "exact", "order": None, "orientation": (1, 0, 0, 0)}

    def rows(cuts: tuple[int, ...] = (500,), threads: int = 1) -> tuple[np.ndarray, engine.OrbitRows]:
        monkeypatch.setenv("KREISEL_NUM_THREADS", str(threads))
        engine = make_plan(model, state, **options).engine
        parts = [np.empty((cut, *engine.z.shape)) for cut in cuts]
        for part in parts:
            engine.advance(part, 7)
        return np.concatenate(parts), engine._lanes([0])[0]

    alone, lane = rows()
    monkeypatch.setattr(engine, "ROW_WORK", 10**6)
    assert (rows((1, 63, 64, 372), threads=3)[0] == alone).all()
    monkeypatch.setattr(engine, "MOST_PLACES", 0)
    assert (rows()[0] == alone).all()
    orbit, k = lane.orbit, np.arange(7, 3501, 7).astype(object)
    (M,), e = engine.dyadic(np.array([0.37]))
    phases = orbit.phases(k * M, np.broadcast_to(e, k.shape))
    place = ((phases[:, 0] + np.uint64(1 << (63 - orbit.places))) >> np.uint64(64 - orbit.places)).astype(int)
    x = (phases[:, 0] << np.uint64(orbit.places)).astype(np.int64) * 2.0**-63
    numbers = sum(f * x[:, None] ** k for k, f in enumerate(np.moveaxis([orbit.place(int(j)) for j in place], 1, 0)))
    halves = [np.stack([np.cos(a), np.sin(a), 0 * a], -1) for a in (phases[:, 1:3] * (2 * np.pi * 2.0**-64)).T]
    wanted = orbit.row(numbers, *halves, **orbit.constants)
    wanted = algebra.flatten(wanted, ["skew", "vector", "quaternion"])
    assert off(alone[:, 0], wanted) < DOUBLE


@pytest.mark.parametrize("name", ["generic", "pendulum released", "through the top", "pendulum near the separatrix"])
def test_polynomials_follow_the_motion_to_the_ends_of_the_parts(name: str) -> None:
    """Where two parts meet their polynomials agree, up to the rounding of a sum; with longer parts they do not."""
    m, b, p = SPECIAL[name]

    def gap(here: TopMotion, inside: bool) -> float:
        size = np.repeat([max(1.0, np.linalg.norm(m)), np.linalg.norm(b) + np.linalg.norm(p), 1.0], (3, 3, 4))
        signs, worst = (-1.0) ** np.arange(parts.TERMS), 0.0
        for j in range(min(1 << here.places, 8)):
            end, begin = here.place(j, inside).sum(0), signs @ here.place(j + 1, inside)
            begin[6:] *= np.sign(begin[6:] @ end[6:])  # q and -q are one rotation
            worst = max(worst, (abs(end - begin) / size).max())
        return worst

    for inside in (False, True):
        here = TopMotion(m, b, p, reach=10.0)
        assert gap(here, inside) < 1e-15
        here.places, here.interval = here.places - 2, 4 * here.interval
        here._places, here._leaps = {0: here._places[0]}, {}
        assert gap(here, inside) > 1e-15


def test_words_are_numbers_of_128_places() -> None:
    numbers = [0, 3, -1, (1 << 128) + (5 << 64) + 7]
    assert engine.words(numbers).tolist() == [[0, 0, 2**64 - 1, 5], [0, 3, 2**64 - 1, 7]]


@pytest.mark.parametrize("name", ["generic", "fast, hanging"])
def test_stepping_does_not_wander(name: str) -> None:
    """After 10^5, 10^10 and 10^15 steps, every one of a thousand saved, against kr.at at the same times."""
    m, b, p = SPECIAL[name]
    top, dt = kr.LagrangeTop(p=p), 0.34375
    plan = make_plan(top, {"m": m, "a": b}, dt=dt, steps=10**15, every=1, method="exact", order=None, orientation=None)
    for first in (10**5, 10**10, 10**12):
        plan.engine.restore({"steps": np.asarray(float(first)), "z": plan.engine.z})
        out = np.empty((1000, *plan.engine.z.shape))
        plan.engine.advance(out, 1)
        states = kr.at(top, {"m": m, "a": b}, dt * (first + np.arange(1, 1001.0)))
        found = plan.observe(out)
        for letter in ("m", "a"):
            assert abs(found[letter] - states[letter].values).max() < DOUBLE * max(1, np.linalg.norm(m))


def test_times_in_any_order_and_single(top: object, x0: object) -> None:
    times = np.array([3.0, -2.0, 0.0, 7e5, 3.0])
    run = kr.at(top, x0, times)
    assert (run.time.values == times).all()
    assert (run.a.values[2] == x0.a).all()
    assert (run.m.values[2] == x0.axial.m).all()
    for i, time in enumerate(times):
        alone = kr.at(top, x0, float(time))
        assert alone.a.dims == ("axis",)
        assert abs(alone.a.values - run.a.values[i]).max() < DOUBLE


def test_flow_property(top: object, x0: object) -> None:
    """Phi_t Phi_s = Phi_(s+t) and Phi_-t Phi_t = 1, up to what rounding the state between costs."""
    half = kr.at(top, x0, 1.25)
    for time, want in ((2.5, kr.at(top, x0, 3.75)), (-1.25, kr.at(top, x0, 0.0))):
        there = kr.at(top, {"m": half.m.values, "a": half.a.values}, time)
        assert abs(there.a - want.a).max() < 1e-14


def test_integrals_do_not_move(top: object, x0: object) -> None:
    times = np.random.default_rng(3).uniform(-1e12, 1e12, 2000)
    run = kr.at(top, x0, np.sort(times))
    table = kr.drift(run)
    assert table.conserved.all()
    assert (table.max_change < 2e-14).all(), table.to_string()
    stepped = kr.drift(kr.simulate(top, x0, dt=0.7, steps=10**9, every=10**6, method="exact"))
    assert (stepped.max_change < 2e-14).all()


def test_lanes_equal_single_motions(top: object) -> None:
    m, a = np.array([[0.1, 0.2, 1.5], [0.3, -0.2, 4.0]]), np.array([[0.6, 0, 0.8], [0.6, 0, -0.8]])
    together = kr.at(top, top.state(m=m, a=a), [0.5, 100.0])
    for lane in (0, 1):
        alone = kr.at(top, top.state(m=m[lane], a=a[lane]), [0.5, 100.0])
        for name in ("m", "a", "energy", "spectrum"):
            assert (together[name].isel(lane=lane).values == alone[name].values).all()


def test_symmetric_top_and_moving_frame_agree() -> None:
    A, state = (0.6, 0, 0.8), {"M": (0.1, 0.2, 1.5), "P": (0, 0, 1)}
    one = kr.at(kr.SymmetricTop(A=A), state, [11.0, 1e6])
    two = kr.at(kr.LagrangeTopMoving(A=A, alpha=1), state, [11.0, 1e6])
    assert (one.M.values == two.M.values).all()
    assert (one.P.values == two.P.values).all()


def test_moving_frame_over_many_calls_of_the_engine() -> None:
    body = kr.LagrangeTopMoving(A=(0.6, 0, 0.8), alpha=0.6)
    state = body.state(M=(0.1, 0.2, 1.5), P=(0, 0, 1))
    options = {"dt": 0.05, "steps": 600, "every": 20, "orientation": (0.6, 0, 0.8, 0)}
    ours = kr.simulate(body, state, method="exact", **options)
    theirs = kr.simulate(body, state, method="dop853", **options)
    assert abs(ours.M - theirs.M).max() < 1e-8
    assert abs(algebra.rotation_matrix(ours.g.values) - algebra.rotation_matrix(theirs.g.values)).max() < 1e-8


def test_times_are_exact_binary_numbers() -> None:
    times = np.array([0.1, -3e-300, 2.0**900, 0.0, 5e-324])
    M, e = dyadic(times)
    assert [math.ldexp(m, int(k)) for m, k in zip(M, e, strict=True)] == times.tolist()


@pytest.mark.parametrize("eps", [0.1, 2.0, 30.0, *full(0.7, 5.0)])
@pytest.mark.parametrize("order", [1, 2])
def test_iterates_of_the_papers_map(eps: float, order: int) -> None:
    """Against the map itself; the second top is on the other branch of r from eps = 2 on."""
    steps = [0, 1, 2, 3, 1000]
    for m, a, p in (SPECIAL["generic"], ((0.3, 0.7, -1.1), (0.2, 0.5, -0.4), (0.3, -0.8, 0.5))):
        top = kr.LagrangeTop(p=p)
        run = kr.simulate(top, {"m": m, "a": a}, dt=eps, steps=1000, method="suris", order=order)
        jumped = kr.at(top, {"m": m, "a": a}, steps, method="suris", dt=eps, order=order)
        for k, bound in zip(range(5), (3e-15, 5e-15, 3e-12, 3e-12, 1e-8), strict=True):
            off = max(abs(jumped[name].values[k] - run[name].values[steps[k]]).max() for name in ("m", "a"))
            assert off < bound * max(1, eps) ** 2  # b is (eps/2)^2 times as large as a


def test_iterates_of_the_map_of_the_introduction() -> None:
    """The symmetric top's map is the rest frame's with (m, a, p) = (-M, P, A); its record says so."""
    body, state = kr.SymmetricTop(A=(0.3, -0.8, 0.5)), {"M": (0.3, 0.7, -1.1), "P": (0.2, 0.5, -0.4)}
    for eps in (0.3, 5.0):
        run = kr.simulate(body, state, dt=eps, steps=100, method="suris")
        jumped = kr.at(body, state, np.arange(101), method="suris", dt=eps)
        assert max(abs(jumped[name] - run[name]).max() for name in ("M", "P")) < 1e-11 * max(1, eps) ** 2


def test_a_million_million_iterates_keep_the_deformed_integrals(top: object, x0: object) -> None:
    run = kr.at(top, x0, np.arange(-1e15, 1e15, 3e12), method="suris", dt=0.3)
    table = kr.drift(run)
    assert (table[table.conserved].max_change < 3e-14).all()
    assert table.loc["energy", "max_change"] > 1e-3
    there = {"m": run.m.values[0], "a": run.a.values[0]}
    back = kr.at(top, there, 5.0, method="suris", dt=0.3)
    straight = kr.at(top, x0, -1e15 + 5, method="suris", dt=0.3)
    assert abs(back.a - straight.a).max() < 1e-14


@pytest.mark.parametrize("branch", ["theta", "pi"])
def test_mutants_of_the_iterates_are_caught(branch: str, monkeypatch: pytest.MonkeyPatch) -> None:
    beyond = Nutation.beyond
    spoiled = {
        "theta": lambda self, eps: (beyond(self, eps)[0], -beyond(self, eps)[1]),
        "pi": lambda self, eps: (beyond(self, eps)[0], beyond(self, eps)[1] + self.ctx.pi),
    }
    monkeypatch.setattr(Nutation, "beyond", spoiled[branch])
    top, state = kr.LagrangeTop(p=(0.3, -0.8, 0.5)), {"m": (0.3, 0.7, -1.1), "a": (0.2, 0.5, -0.4)}
    run = kr.simulate(top, state, dt=2.0, steps=1, method="suris", order=1)
    jumped = kr.at(top, state, 1, method="suris", dt=2.0, order=1)
    assert abs(jumped.a - run.a[1]).max() > 1e-3


# -- figures --------------------------------------------------------------------------------------------

KINDS = {
    "generic": "nutating",
    "no gravity": "free",
    "pendulum on the separatrix": "falling asleep",
    "falling asleep": "falling asleep",
    "pendulum off the separatrix by an ulp": "nutating",
    "sleeping, unstable": "sleeping, unstable",
    "at rest, up": "sleeping, unstable",
    "sleeping, critical": "sleeping, critical",
    "sleeping, stable": "steady",
    "at rest, down": "steady",
    "steady precession": "steady",
}


@pytest.mark.parametrize("name", KINDS)
def test_kinds_of_motion(name: str) -> None:
    m, b, p = SPECIAL[name]
    assert kr.nutation(kr.LagrangeTop(p=p), {"m": m, "a": b}).kind == KINDS[name]


@pytest.mark.parametrize("size", [1e-3, 1e-12, 1e-160, *full(1e-6, 1e-20, 1e-60)])
@pytest.mark.parametrize("length", [1.0, 1e-20])
def test_an_axis_that_passes_close_to_the_vertical(size: float, length: float) -> None:
    """It turns by half a turn there, but for an angle of the size of m."""
    p = np.array([0.662416675302187, -1.2184562792983742, -0.5012569866881104])
    m = size * np.array([-0.8135190021022613, -0.37707040028601764, -1.1295822720776918])
    a = np.array([0.6048879358306984, -0.43643615991794527, 0.6244064413481183])
    figures = kr.nutation(kr.LagrangeTop(p=p), {"m": m, "a": length * a})
    assert figures.precession == pytest.approx(-np.pi, abs=3 * size / np.sqrt(length) + 1e-14)


@pytest.mark.parametrize("number", [0, 1, *full(2, 3, 4, 5)])
def test_figures_against_the_motion(number: int) -> None:
    m, b, p = random_tops(20)[number]
    top, alpha = kr.LagrangeTop(p=p, alpha=0.6), 0.6
    figures = kr.nutation(top, {"m": m, "a": b})
    body = kr.nutation(kr.LagrangeTopMoving(A=b, alpha=alpha), {"M": m, "P": p})
    assert body == figures
    run = kr.at(top, {"m": m, "a": b}, np.linspace(0, figures.period, 4001))
    height = run.a.values @ p
    east = np.cross(p, [1.0, 0, 0])
    north = np.cross(east, p) / np.linalg.norm(p)
    azimuth = np.unwrap(np.arctan2(run.a.values @ east, run.a.values @ north))
    assert height.min() == pytest.approx(figures.lowest, abs=1e-4)
    assert height.max() == pytest.approx(figures.highest, abs=1e-4)
    assert height[-1] == pytest.approx(height[0], abs=1e-13)
    assert azimuth[-1] - azimuth[0] == pytest.approx(figures.precession, abs=1e-12)
    omega = algebra.axial(top.call(top.system.velocity, algebra.hat(m), b))
    assert omega @ b / np.linalg.norm(b) == pytest.approx(figures.spin, rel=1e-14)
    turn = float(nutation_of(m, b, p).period_turn())
    assert math.cos(turn) == pytest.approx(math.cos(figures.precession), abs=1e-13)
    assert math.sin(turn) == pytest.approx(math.sin(figures.precession), abs=1e-13)


def test_steady_precession_in_closed_form() -> None:
    """m = Omega p + b/Omega turns about p at the rate Omega."""
    m, b, p = SPECIAL["steady precession"]
    figures = kr.nutation(kr.LagrangeTop(p=p), {"m": m, "a": b})
    assert figures.mean_precession == pytest.approx(0.5, rel=1e-15)
    assert figures.lowest == figures.highest == 0.75


@pytest.mark.parametrize(("spin", "stays"), [(1.9, False), (2.1, True)])
def test_a_sleeping_top_wakes_below_the_critical_spin(spin: float, stays: bool) -> None:
    """Upright, spin^2 < 4 |a||p|: the smallest push tips it far over; above, it stays."""
    top, push = kr.LagrangeTop(p=UP), 1e-5
    assert (kr.nutation(top, {"m": (0, 0, spin), "a": UP}).kind == "steady") is stays
    lowest = kr.nutation(top, {"m": (push, 0, spin), "a": UP}).lowest
    assert (lowest > 1 - 1e-8) is stays


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda top: kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, [0.0, math.nan]), "times must be"),
        (lambda top: kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, []), "times must be"),
        (lambda top: kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, "soon"), "times must be"),
        (
            lambda top: kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, 1, method="dop853", dt=1),
            "no closed form of method='dop853'",
        ),
        (lambda top: kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, 1, dt=0.1), "leave dt out"),
        (lambda top: kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, 1, method="suris"), "needs a step"),
        (lambda top: kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, 1.5, method="suris", dt=1), "integers"),
        (lambda top: kr.nutation(top, {"m": [(0, 0, 1)] * 2, "a": (1, 0, 0)}), "one motion"),
        (lambda top: kr.nutation(kr.Clebsch(b=(1, 2, 3)), {"M": (0, 0, 1), "P": (1, 0, 0)}), "for Lagrange tops"),
        (lambda top: kr.plot(kr.at(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, [0, 1])), "run of kr.simulate"),
        (lambda top: kr.at(top, {"m": (0, 0, 1), "a": (0, 0, 0)}, 1), "zero vector"),
        (lambda top: kr.at(top, {"m": (1e160, 0, 1), "a": (1, 0, 0)}, 1), "at most 1e.150"),
        (lambda top: kr.at("top", {}, 1), "system with its parameters"),
        (
            lambda top: kr.at(kr.Clebsch(b=(1, 2, 3)), {"M": (0, 0, 1), "P": (1, 0, 0)}, 1),
            "no closed form of method=.exact. is known for clebsch",
        ),
        (
            lambda top: kr.at(kr.LagrangeTop(p=(0, 0, 0, 1)), {"m": np.zeros((4, 4)), "a": (1, 0, 0, 0)}, 1),
            "lagrange-top, n = 4",
        ),
        (
            lambda top: kr.simulate(top, {"m": (0, 0, 1), "a": (1, 0, 0)}, dt=1, steps=1, method="exact", order=2),
            "Leave order out",
        ),
    ],
)
def test_errors_say_what_to_do(call: object, words: str, top: object) -> None:
    with pytest.raises(kr.InputError, match=words):
        call(top)


def test_a_run_goes_on_and_is_lengthened(top: object, x0: object, tmp_path: Path) -> None:
    """The same bits as in one go: they do not depend on how far a motion will be followed."""
    options = {"dt": 0.4, "every": 3, "method": "exact", "orientation": (1, 0, 0, 0)}
    kr.simulate(top, x0, steps=9, path=tmp_path / "a.zarr", **options)
    longer = kr.resume(tmp_path / "a.zarr", extend=300)
    whole = kr.simulate(top, x0, steps=300, **options)
    for name in ("m", "a", "g", "energy"):
        assert (longer[name].values == whole[name].values).all()
    assert check_archive(tmp_path / "a.zarr")[1] == []


@pytest.mark.parametrize("e", [1e-3, 1e-9, 1e-14])
def test_beside_the_critical_sleeping_top(e: float) -> None:
    """Full precision of state and orientation from few parts: whole turns are left out."""
    m, b, p = np.array([e, 0.0, 6.0]), np.array([0.0, 0.0, 4.0]), np.array([0.0, 0.0, 2.25])
    assert TopMotion(m, b, p, reach=10.0).places < 8
    top, times = kr.LagrangeTop(p=p, alpha=0.5), (0.37, -1.03, 6.6)
    run = kr.at(top, {"m": m, "a": b}, times, orientation=(1, 0, 0, 0))
    for i, when in enumerate(times):
        m1, b1, q = taylor(m, b, p, when, alpha=0.5, digits=40)
        assert abs(run.m.values[i] - np.array(m1, dtype=float)).max() < 4e-15
        assert abs(run.a.values[i] - np.array(b1, dtype=float)).max() < 4e-15
        turn = np.array(q, dtype=float)
        assert min(abs(run.g.values[i] - s * turn).max() for s in (1, -1)) < 2e-15


@pytest.mark.parametrize("above", [1e-12, 1e-6, 1e-4, 6e-4])
def test_a_top_that_spins_upright_just_above_the_critical_rate(above: float) -> None:
    """m = J e_3 stays, and the body turns by J t about it: nothing else can happen, in both frames and by both ways."""
    J, q = 2 + above, np.array([np.cos(0.5), 0.0, 0.0, np.sin(0.5)])
    rest, inside = kr.LagrangeTop(p=(0, 0, 1)), kr.LagrangeTopMoving(A=(0, 0, 1))
    half = J * 1e4 / 2 + 0.5
    for top, letters in ((rest, "ma"), (inside, "MP")):
        start = dict(zip(letters, ((0, 0, J), (0, 0, 1.0)), strict=True))
        run = kr.at(top, start, [0.0, 1e4], orientation=q)
        assert (run[letters[0]].values[-1] == [0, 0, J]).all() and (run[letters[1]].values[-1] == [0, 0, 1]).all()
        assert abs(abs(run.g.values[-1] @ [np.cos(half), 0, 0, np.sin(half)]) - 1) < 1e-12
        run = kr.simulate(top, start, dt=0.5, steps=4, method="exact", progress=False)
        assert (run[letters[0]].values == [0, 0, J]).all()


@pytest.mark.parametrize(
    "body", [kr.Clebsch(b=(-0.9, -0.6, -0.25)), kr.KirchhoffRevolution(a1=1.3, a3=0.4, c1=0.9, c3=0.25)]
)
def test_a_step_of_too_many_pairs_is_refused_before_anything_is_allocated(body: object) -> None:
    start = {"M": (0.3, -0.4, 1.2), "P": (0.5, 0.2, 0.9)}
    with pytest.raises(kr.InputError, match="dt: expected at most"):
        kr.simulate(body, start, dt=1e12, steps=1, method="exact", progress=False)


def test_a_body_at_rest_without_gravity_stays_without_a_warning_of_numpy() -> None:
    top = kr.LagrangeTopMoving(A=(0, 0, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = kr.simulate(top, {"M": (0, 0, 0), "P": (0, 0, 0)}, dt=0.05, steps=3, method="exact")
    assert not run.M.values.any() and not run.P.values.any()
