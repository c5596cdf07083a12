"""kr.at by compiled jumps: against the closed form in many digits, lanes against one top, and where it gives up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.algebra.reuse import forget
from kreisel.exact.motion import periods_of
from kreisel.exact.nutation import Integrals
from kreisel.graph import machine
from kreisel.kernels.exact import engine, jumps
from kreisel.kernels.exact.jumps import Jumps
from kreisel.method import scheme
from kreisel.method.scheme import Jump
from sizes import FULL, full
from tops import DOUBLE, SPECIAL, UP, error, random_tops

TIMES = np.array([0.37, -11.3, 1e3, 2e6])
RIGHT = 3e-15  # relative to the largest entry: 1.8e-15 measured
TURNED = np.array([0.5, -0.7, 0.1, 0.5])  # an orientation, of length 1
BEYOND = ("separatrix", "unstable", "critical", "falling", "at rest, up", "near the top")


def wide_tops(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Momenta over three decades and a half, weights over three."""
    draw = np.random.default_rng(4)
    m, b, p = draw.normal(size=(3, count, 3))
    return m * 10 ** draw.uniform(-1.5, 2, (count, 1)), b, p * 10 ** draw.uniform(-2, 1, (count, 1))


def jumped(top: object, state: object, times: np.ndarray, g: object = None) -> tuple[np.ndarray, np.ndarray]:
    """Rows (times, lanes, 6), or 10 with an orientation, and which are right."""
    letters, plan, given = top.system.space.letters, scheme(top, "exact", 1.0, None, g is not None), top.state(**state)
    kinds = [kind for _, kind in plan.components]
    parts = [given[k] for k in letters]
    if g is not None:
        parts.append(np.broadcast_to(g, (*np.shape(parts[1])[:-1], 4)))
    z = np.atleast_2d(algebra.flatten(plan.prepare(tuple(parts)), kinds))
    rows, right = Jumps(plan, len(z)).at(z, times)
    momentum, *rest = algebra.restore(rows, kinds, 3)
    return np.concatenate([algebra.axial(momentum), *rest], -1), right


def in_digits(
    top: object, state: object, times: np.ndarray, monkeypatch: pytest.MonkeyPatch, g: object = None
) -> np.ndarray:
    """The same rows of one top, without a jump."""
    with monkeypatch.context() as patch:
        patch.setattr(engine.jumps, "TOLERANCE", -1.0)
        run = kr.at(top, state, times, orientation=g)
    return np.concatenate([run[letter].values for letter in (*top.system.space.letters, *["g"][: g is not None])], -1)


def off(got: np.ndarray, want: np.ndarray) -> float:
    """The largest error of momentum or vector, relative to the largest entry of each; of the orientation up to sign."""
    state = max(
        abs(g - w).max() / (abs(w).max() or 1) for g, w in zip(np.split(got[:6], 2), np.split(want[:6], 2), strict=True)
    )
    turn = min(abs(got[6:] - sign * want[6:]).max(initial=0) for sign in (1, -1))
    return max(state, turn)


def worst(count: int, monkeypatch: pytest.MonkeyPatch, g: object = None, alpha: float = 1.0) -> float:
    """The largest error of jumps of `count` tops that are said to be right."""
    m, b, p = wide_tops(count)
    got, right = jumped(kr.LagrangeTop(p=p, alpha=alpha), {"m": m, "a": b}, TIMES, g)
    assert right.mean() > 0.95
    errors = [0.0]
    for lane in range(count):
        top = kr.LagrangeTop(p=p[lane], alpha=alpha)
        want = in_digits(top, {"m": m[lane], "a": b[lane]}, TIMES, monkeypatch, g)
        errors += [off(got[k, lane], want[k]) for k in range(len(TIMES)) if right[k, lane]]
    return max(errors)


def test_states_that_jumps_know_are_not_set_up_in_many_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    made = scheme(top, "exact", 0.1, None, False)
    start = np.array([[0.1, 0.2, 1.5, 0.6, 0.0, 0.8]])
    z = algebra.flatten(made.prepare((algebra.skew(start[:, [2, 1, 0]] * (-1, 1, -1), 3), start[:, 3:])), made.kinds)
    times = np.linspace(0.5, 70.0, 20_001)
    right = engine.ClosedForm(made, z, 1.0, 100.0).at(times)
    without = replace(made, motion=replace(made.motion, orbit=None))
    assert (engine.ClosedForm(without, z, 1.0, 100.0).at(times) == right).all()
    monkeypatch.setattr(jumps, "TOLERANCE", -1.0)
    with pytest.raises(TypeError):
        engine.ClosedForm(without, z, 1.0, 100.0).at(times)


def test_jumps_of_many_tops(monkeypatch: pytest.MonkeyPatch) -> None:
    assert worst(40 if FULL else 20, monkeypatch) < RIGHT


def test_jumps_with_the_orientation_of_many_tops(monkeypatch: pytest.MonkeyPatch) -> None:
    assert worst(40 if FULL else 20, monkeypatch, TURNED, 0.6) < RIGHT


@pytest.mark.parametrize("number", [0, 1, 2, *full(3, 4, 5, 6, 7)])
def test_random_tops_against_taylor(number: int) -> None:
    """In both frames, with the orientation."""
    m, b, p = random_tops(20)[number]
    state, top = {"m": m, "a": b}, kr.LagrangeTop(p=p, alpha=0.7)
    assert jumped(top, state, np.array([-4.6]), TURNED)[1].all()
    assert error(m, b, p, -4.6) < DOUBLE


WITHOUT = SPECIAL if FULL else ("sleeping, stable, disturbed", "pendulum released", "pendulum on the separatrix")


@pytest.mark.parametrize(("name", "g"), [(name, TURNED) for name in SPECIAL] + [(name, None) for name in WITHOUT])
def test_special_motions(name: str, g: object, monkeypatch: pytest.MonkeyPatch) -> None:
    """In both frames; those that tend to a steady motion, or nearly, are said to need more digits, and get them."""
    m, b, p = SPECIAL[name]
    rest, body = kr.LagrangeTop(p=p, alpha=1.3), kr.LagrangeTopMoving(A=b, alpha=0.7)
    for top, state in ((rest, {"m": m, "a": b}), (body, {"M": m, "P": p})):
        got, right = jumped(top, state, TIMES, g)
        weightless = g is not None and top is body and not np.any(p)  # half-turns about P = 0 carry no orientation
        assert right.all() != (weightless or any(word in name for word in BEYOND))
        want = in_digits(top, state, TIMES, monkeypatch, g)
        for k in np.flatnonzero(right[:, 0]):
            assert off(got[k, 0], want[k]) < RIGHT
        run = kr.at(top, state, TIMES, orientation=g)
        asked = np.concatenate([run[letter].values for letter in top.system.space.letters], -1)
        leapt, in_parts = (asked == got[:, 0, :6]).all(1) & right[:, 0], (asked == want[:, :6]).all(1)
        sign_unknown = g is not None and name in ("no gravity", "pendulum going round")
        assert (leapt | in_parts).all() and (sign_unknown or (leapt == right[:, 0]).all())


def test_symmetric_top(monkeypatch: pytest.MonkeyPatch) -> None:
    top, state = kr.SymmetricTop(A=(0.6, 0, 0.8)), {"M": (0.1, 0.2, 1.5), "P": UP}
    got, right = jumped(top, state, TIMES)
    assert right.all()
    assert max(map(off, got[:, 0], in_digits(top, state, TIMES, monkeypatch))) < RIGHT


def test_the_way_to_the_separatrix_is_followed_or_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Upright tops, pushed by less and less: each jump is right or said not to be."""
    given_up = []
    for decade in range(8):
        m, b = (10.0**-decade, 0, 1), (0, 10.0 ** -(decade + 1), 1)
        got, right = jumped(kr.LagrangeTop(p=UP), {"m": m, "a": b}, TIMES)
        want = in_digits(kr.LagrangeTop(p=UP), {"m": m, "a": b}, TIMES, monkeypatch)
        given_up.append(not right.all())
        for k in np.flatnonzero(right[:, 0]):
            assert off(got[k, 0], want[k]) < 2 * RIGHT
    assert not given_up[0]
    assert all(given_up[4:])


def test_the_number_of_periods_is_followed_or_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    m, b, p = SPECIAL["generic"]
    top, state, times = kr.LagrangeTop(p=p), {"m": m, "a": b}, 10.0 ** np.arange(0, 19)
    got, right = jumped(top, state, times)
    assert right[times <= 1e12].all()
    assert not right[times >= 1e17].any()
    want = in_digits(top, state, times, monkeypatch)
    assert max(off(got[k, 0], want[k]) for k in np.flatnonzero(right[:, 0])) < RIGHT


@pytest.mark.parametrize("unit", [1e-20, 1e20, 1e-60, 1e-80, 1e35])
def test_scales(unit: float) -> None:
    """In other units of time the same states; where products leave the range of doubles, by the way of many digits."""
    m, b, p = (np.array(v, dtype=float) for v in SPECIAL["generic"])
    one = kr.at(kr.LagrangeTop(p=p), {"m": m, "a": b}, 77.0)
    two = kr.at(kr.LagrangeTop(p=p * unit**2), {"m": m * unit, "a": b}, 77.0 / unit)
    assert abs(one.m - two.m / unit).max() < 100 * DOUBLE  # of times and weights that are rounded
    assert abs(one.a - two.a).max() < 100 * DOUBLE


@pytest.mark.parametrize("g", [None, (0.5, -0.5, 0.1, 0.7)])
def test_lanes_and_threads_have_the_bits_of_one_top(monkeypatch: pytest.MonkeyPatch, g: object) -> None:
    """Also where the lanes of a vector need different numbers of maps."""
    m, b, p = wide_tops(37)
    g = None if g is None else np.array(g) / np.linalg.norm(g)
    alone = [jumped(kr.LagrangeTop(p=p[i]), {"m": m[i], "a": b[i]}, TIMES[2:3], g)[0][0, 0] for i in range(37)]
    for count in (1, 2, 7, 37):
        got, _ = jumped(kr.LagrangeTop(p=p[:count]), {"m": m[:count], "a": b[:count]}, TIMES, g)
        assert (got[2] == alone[:count]).all()
    monkeypatch.setenv("KREISEL_NUM_THREADS", "3")
    monkeypatch.setattr(jumps, "WORK", 10**6)
    got, _ = jumped(kr.LagrangeTop(p=p), {"m": m, "a": b}, TIMES, g)
    assert (got[2] == alone).all()


def test_time_zero_and_back() -> None:
    m, b, p = wide_tops(50)
    top = kr.LagrangeTop(p=p)
    run = kr.at(top, {"m": m, "a": b}, [0.0, 3.0])
    assert (run.m.values[0] == m).all()
    assert (run.a.values[0] == b).all()
    back = kr.at(top, {"m": run.m.values[1], "a": run.a.values[1]}, -3.0)
    for got, want in ((back.m.values, m), (back.a.values, b)):
        assert (abs(got - want).max(-1) < 1e-12 * abs(want).max(-1)).all()


def other_K(known: Integrals) -> object:
    return -K.fget(known)


def in_19_digits(known: Integrals) -> object:
    u, v = DEPRESSED(known)
    return u + u * 1e-19, v


K, DEPRESSED = Integrals.K, Integrals.depressed.func
MUTANTS = {"theta's sign": ("K", other_K), "roots in 19 digits": ("depressed", in_19_digits)}


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_caught(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    m, b, p = random_tops(1)[0]
    top, state = kr.LagrangeTop(p=p), {"m": m, "a": b}
    want = in_digits(top, state, TIMES, monkeypatch)
    assert max(map(off, jumped(top, state, TIMES)[0][:, 0], want)) < RIGHT
    attribute, mutant = MUTANTS[name]
    monkeypatch.setattr(Integrals, attribute, property(mutant))
    monkeypatch.setattr(machine, "_writers", name.encode)  # no kernel of the formulas as they are
    forget()
    assert max(map(off, jumped(top, state, TIMES)[0][:, 0], want)) > 10 * RIGHT


def rows_of(
    m: np.ndarray, b: np.ndarray, p: np.ndarray, first: int, patch: pytest.MonkeyPatch, oriented: bool, every: int = 1
) -> np.ndarray:
    """The rows of a run of tops of which the first rows are jumps."""
    with patch.context() as few:
        few.setattr(engine.jumps, "ROWS", {Jump: first})
        top, start, g = kr.LagrangeTop(p=p, alpha=0.7), {"m": m, "a": b}, TURNED if oriented else None
        run = kr.simulate(top, start, dt=0.3, steps=40, every=every, method="exact", orientation=g, progress=False)
    return np.concatenate([run[k].values for k in ("m", "a", *["g"] * oriented)], -1)


@pytest.mark.parametrize("oriented", [False, True])
def test_first_rows_of_a_run_are_jumps(oriented: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same numbers as by parts, with the sign of the quaternion, and the same bits for any lanes and rows."""
    m, b, p = (v[:12] for v in wide_tops(12))
    by_jumps, by_parts, both = (rows_of(m, b, p, first, monkeypatch, oriented) for first in (40, 0, 15))
    assert (abs(by_jumps - by_parts) / abs(by_parts).max(0)).max() < 100 * RIGHT and (by_jumps != by_parts).any()
    assert (both[:16] == by_jumps[:16]).all() and (both[16:] == by_parts[16:]).all()
    assert (rows_of(m, b, p, 40, monkeypatch, oriented, every=4) == by_jumps[::4]).all()
    for lane in range(3):
        assert (rows_of(m[lane], b[lane], p[lane], 40, monkeypatch, oriented) == by_jumps[:, lane]).all()


def test_the_sign_of_a_period_is_known() -> None:
    """But for a few slow tops."""
    period, sign = periods_of(*wide_tops(1000))
    assert (period > 0).all() and (abs(sign) == 1).mean() > 0.98 and 0.2 < (sign < 0).mean() < 0.9


def test_kr_at_of_single_times_has_the_sign_of_the_continuous_quaternion() -> None:
    """That of q' = omega q/2 from time 0 on, with m' = p x a, a' = m x a and omega along a by the moments."""
    alpha, times = 0.7, [-21.0, 8.0, 17.0]
    for m, a, p in zip(*wide_tops(4), strict=True):

        def rates(_: float, y: np.ndarray, p: np.ndarray = p) -> np.ndarray:
            m, a, (w, *u) = y[:3], y[3:6], y[6:]
            omega = m + (1 / alpha - 1) * (m @ a) / (a @ a) * a
            q = np.array([-(omega @ u), *(w * omega + np.cross(omega, u))])
            return np.concatenate([np.cross(p, a), np.cross(m, a), q / 2])

        unit = 1 / np.sqrt(np.linalg.norm(m) ** 2 + np.linalg.norm(a) * np.linalg.norm(p))
        for t in times:
            y = solve_ivp(rates, (0, t * unit), [*m, *a, *TURNED], method="DOP853", rtol=1e-8, atol=1e-8).y[6:, -1]
            g = kr.at(kr.LagrangeTop(p=p, alpha=alpha), {"m": m, "a": a}, t * unit, orientation=TURNED, observe=()).g
            assert y @ g.values > 0.999


@pytest.mark.parametrize("frame", ["rest", "moving"])
def test_the_quaternion_of_jumps_goes_on_without_a_change_of_sign(frame: str) -> None:
    """Rows 0.2 rad apart, over many nutations, of slow and fast tops."""
    for m, b, p in zip(*wide_tops(300 if FULL else 60), strict=True):
        rate = np.linalg.norm(m) / 0.7 + np.sqrt(np.linalg.norm(b) * np.linalg.norm(p))
        top = kr.LagrangeTop(p=p, alpha=0.7) if frame == "rest" else kr.LagrangeTopMoving(A=p, alpha=0.7)
        start = dict(zip(top.system.space.letters, (m, b), strict=True))
        g = kr.simulate(top, start, dt=0.2 / rate, steps=2000, method="exact", orientation=TURNED, progress=False).g
        assert ((g.values[1:] * g.values[:-1]).sum(-1) > 0).all()


ALIKE = ("generic", "slow", "c = 0", "spherical pendulum", "through the bottom", "sleeping, unstable, disturbed")
ALIKE += ("pendulum near the separatrix", "pendulum released near the top")  # they go the way of others


@pytest.mark.parametrize("name", [*(name for name in SPECIAL if name not in ALIKE), *full(*ALIKE)])
def test_special_tops_as_by_parts(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hanging, asleep, pendulums, without weight, on the separatrix and near it, with the sign of the quaternion."""
    m, b, p = (np.asarray(v, dtype=float) for v in SPECIAL[name])
    by_jumps, by_parts = (rows_of(m, b, p, first, monkeypatch, True) for first in (40, 0))
    assert abs(by_jumps - by_parts).max() < 1e3 * RIGHT * max(1.0, abs(by_parts).max())
