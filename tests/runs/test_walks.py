"""`to` and `until` of a propagator: any times, impulses, events."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import kreisel as kr

BODY = kr.perturbed(
    kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
    potential=lambda P, t, *, k: k * np.sin(t) * P[0],
    torque=lambda M: -0.01 * M,
    params={"k": 0.1},
)
START = {"M": np.array([0.3, 0.2, 1.1]), "P": np.array([0.6, 0, 0.8])}
TOP = kr.LagrangeTop(p=(0, 0, 1))
AXIS = {"m": np.array([0.1, 0.2, 0.5]), "a": np.array([0.6, 0.0, 0.8])}


def test_times_are_reached_by_shorter_steps() -> None:
    """Between two times a run of equal steps, whatever was before."""
    p = kr.propagator(BODY, dt=0.25)
    times = [0.7, 0.7, 2.0, 3.1, 9.0]
    rows = p.to(START, times)
    x, t = START, 0.0
    for k, end in enumerate(times):
        if end > t:
            count = math.ceil((end - t) / 0.25 - 1e-9)
            x = kr.propagator(BODY, dt=(end - t) / count).steps(x, count, time=t)
        for letter, value in x.items():
            np.testing.assert_allclose(rows[letter][k], value, rtol=0, atol=1e-14)
        t = end
    exact = kr.simulate(BODY, START, dt=9.0, steps=1, method="dop853", tol=1e-12)
    assert abs(rows["M"][-1] - exact.M[-1]).max() < 1e-7


def test_the_steps_of_a_whole_number_are_those_of_steps() -> None:
    p = kr.propagator(TOP, method="baecklund", dt=0.1)
    np.testing.assert_array_equal(p.to(AXIS, 2.0)["a"], p.steps(AXIS, 20)["a"])
    later = p.to(AXIS, [1.0, 2.0], time=-1.0)
    np.testing.assert_allclose(later["a"], p.steps(AXIS, 30, every=10)["a"][2:], atol=1e-13)


def test_work_is_that_of_the_whole_walk() -> None:
    p = kr.propagator(BODY, dt=0.1, observe=["energy", "work", "balance"])
    rows = p.to(START, [0.0, 1.05, 4.0])
    assert rows["work"][0] == 0 and abs(rows["work"][2]) > 0.01
    np.testing.assert_allclose(rows["balance"], rows["energy"] - rows["work"], rtol=1e-13)
    assert abs(rows["balance"] - rows["balance"][0]).max() < 1e-8


def test_a_state_that_came_back_goes_in_again() -> None:
    p = kr.propagator(TOP, method="baecklund", dt=0.1, observe=["energy"])
    once, twice = p.to(AXIS, 1.0), p.to(p.to(AXIS, 0.5), 1.0, time=0.5)
    np.testing.assert_allclose(twice["a"], once["a"], atol=1e-14)
    assert abs(twice["energy"] - once["energy"]) < 1e-14


def test_an_impulse_between_two_times() -> None:
    """A kick along p changes m.p by its size, and by nothing else afterwards."""
    p = kr.propagator(TOP, method="baecklund", order=8, dt=0.2)
    x = p.to(AXIS, 3.3)
    x = p.to({**x, "m": x["m"] + np.array([0, 0, 0.25])}, 7.7, time=3.3)
    assert abs(x["m"][2] - 0.75) < 1e-13


@pytest.mark.parametrize("method", ["baecklund", "exact", "splitting"])
def test_where_the_axis_is_level(method: str) -> None:
    """a_3 of a Lagrange top obeys a cubic: the time of a_3 = 0.7 by quadrature of dt = da/sqrt(...)."""
    from scipy.integrate import quad
    from scipy.optimize import brentq

    system = kr.perturbed(TOP, potential=lambda a: 0 * a[0]) if method == "splitting" else TOP
    p = kr.propagator(system, method=method, dt=0.1, order={"baecklund": 8, "splitting": 8}.get(method))
    x = {"m": np.array([0.0, 0.0, 0.5]), "a": np.array([0.6, 0.0, 0.8])}
    spin, h = float(x["m"] @ x["a"]), float(x["m"] @ x["m"] / 2 + x["a"][2])

    def square(a: float) -> float:  # a_3'^2 = (1 - a^2)(2 (h - a) - m.a^2) - (m_3 - (m.a) a)^2
        return (1 - a * a) * (2 * (h - a) - spin**2) - (0.5 - spin * a) ** 2

    start = brentq(lambda a: square(a), 0.79, 0.81) if abs(square(0.8)) > 1e-14 else 0.8
    expected = quad(lambda s: 2 * s / np.sqrt(square(start - s * s)), 0, math.sqrt(start - 0.7), epsabs=1e-13)[0]
    found = p.until(x, lambda x: x["a"][2] - 0.7, 10.0)
    assert found.crossed and abs(found.time - expected) < 2e-8 * (1 if method != "exact" else 1e-4)
    assert abs(found.state["a"][2] - 0.7) < 1e-14


def test_the_next_one_and_the_direction() -> None:
    p = kr.propagator(TOP, method="baecklund", order=8, dt=0.05)

    def height(x: Any) -> float:
        return float(x["a"][2] - 0.2)

    first = p.until(AXIS, height, 50.0)
    second = p.until(first.state, height, 50.0, time=first.time)
    up = p.until(AXIS, height, 50.0, rising=True)
    assert first.crossed and second.crossed and second.time > first.time + 0.1
    assert abs(up.time - second.time) < 1e-9
    dense = kr.simulate(TOP, AXIS, dt=0.001, steps=10000, method="baecklund", order=8).a[:, 2].values - 0.2
    crossings = 0.001 * np.flatnonzero(np.diff(np.sign(dense)) != 0)
    assert abs(crossings[:2] - (first.time, second.time)).max() < 0.002


def test_a_bounce_goes_back() -> None:
    """Momentum reversed where the axis is level: the motion runs back, in the same time."""
    p = kr.propagator(TOP, method="baecklund", order=8, dt=0.05)
    hit = p.until(AXIS, lambda x: x["a"][2], 50.0)
    back = p.to({"m": -hit.state["m"], "a": hit.state["a"]}, 2 * hit.time, time=hit.time)
    still = {
        k: v
        for k, v in kr.propagator(TOP, method="exact").at({"m": -hit.state["m"], "a": hit.state["a"]}, hit.time).items()
    }
    np.testing.assert_allclose(back["a"], still["a"], atol=1e-9)
    again = p.until({"m": -hit.state["m"], "a": hit.state["a"]}, lambda x: x["a"][2], hit.time + 0.5, time=hit.time)
    assert not again.crossed and again.time == hit.time + 0.5  # its start is not an event


def test_none_before_the_end() -> None:
    p = kr.propagator(TOP, method="baecklund", dt=0.1)
    found = p.until(AXIS, lambda x: x["a"][2] + 5, 3.33)
    assert found.time == 3.33 and not found.crossed
    np.testing.assert_array_equal(found.state["a"], p.to(p.steps(AXIS, 33), 3.33, time=33 * 0.1)["a"])


def test_arrays_and_lanes() -> None:
    p = kr.propagator(TOP, method="baecklund", dt=0.1)
    x = np.concatenate([AXIS["m"], AXIS["a"]])
    np.testing.assert_array_equal(p.to(np.tile(x, (3, 1)), [0.5, 1.23])[:, 1], p.to(x, [0.5, 1.23]))
    assert p.until(x, lambda x: x[5] - 0.79, 20.0).crossed


@pytest.mark.parametrize(
    ("method", "order"), [("suris", 1), ("baecklund", 2), ("baecklund", 8), ("variational", 2), ("splitting", (8, 2))]
)
def test_shorter_steps_are_those_of_a_propagator_with_them(method: str, order: Any) -> None:
    system = TOP if method != "splitting" else kr.perturbed(TOP, potential=lambda a: 0.1 * a[0])
    p, shorter = (kr.propagator(system, method=method, order=order, dt=dt) for dt in (0.13, 0.1))
    np.testing.assert_allclose(p.to(AXIS, [0.1, 0.2, 0.3])["a"][-1], shorter.steps(AXIS, 3)["a"], atol=1e-13)
    before = p.steps(AXIS, 7)["a"]
    p.to(AXIS, 0.4)
    np.testing.assert_array_equal(p.steps(AXIS, 7)["a"], before)


def test_a_search_that_ends_where_the_last_one_did() -> None:
    p = kr.propagator(TOP, method="baecklund", order=8, dt=0.05)
    hit = p.until(AXIS, lambda x: x["a"][2], 50.0)
    for window in (1e-3, 1e-6, 1e-8, 1e-12):
        for sign in (1, -1):
            start = {"m": hit.state["m"] * (sign, sign, 1), "a": hit.state["a"]}
            assert not p.until(start, lambda x: x["a"][2], hit.time + window, time=hit.time).crossed


def test_what_comes_after_an_event_is_not_looked_at() -> None:
    p = kr.propagator(TOP, method="baecklund", order=8, dt=0.01)

    def root(x: Any) -> float:
        return float(np.sqrt(x["a"][2]) - 0.4)

    with np.errstate(invalid="raise"):
        assert p.until(AXIS, root, 50.0).crossed


def test_events_of_bodies_in_pairs() -> None:
    pair = kr.perturbed(TOP, pair_potential=lambda a1, a2: -0.5 * (a1 @ a2), pairs=[(0, 1)])
    p = kr.propagator(pair, dt=0.1, order=8)
    start = {"m": np.array([AXIS["m"], (0.2, 0.1, 1.0)]), "a": np.array([AXIS["a"], (0.0, 0.6, 0.8)])}
    found = p.until(start, lambda x: x["a"][0, 2] - 0.5, 20.0)
    assert found.crossed and abs(found.state["a"][0, 2] - 0.5) < 1e-14 and found.state["a"].shape == (2, 3)
    fine = kr.simulate(pair, pair.state(**start), dt=found.time / 500, steps=500, order=8)
    assert abs(fine.a[-1, 0, 2] - 0.5) < 1e-8
    with pytest.raises(kr.InputError, match="a single body"):
        kr.analysis.events(fine, "a[2]", 0.6, system=pair)
    with pytest.raises(kr.InputError, match="depend on"):
        pair.flow(*start.values())


def test_what_is_wrong_is_said() -> None:
    p = kr.propagator(TOP, method="baecklund", dt=0.1)
    x = np.concatenate([AXIS["m"], AXIS["a"]])
    for call, said in (
        (lambda: p.to(x, [2.0, 1.0]), "in order"),
        (lambda: p.to(x, -1.0), "in order"),
        (lambda: p.to(x, 1.0, time=2.0), "in order"),
        (lambda: p.to(x, np.nan), "finite"),
        (lambda: p.until(x, 3, 1.0), "function"),
        (lambda: p.until(x, lambda x: x, 1.0), "one value"),
        (lambda: p.until(x, lambda x: np.nan, 1.0), "finite"),
        (lambda: p.until(x, lambda x: 1.0, -1.0), "end"),
        (lambda: p.until(np.tile(x, (2, 1)), lambda x: 1.0, 1.0), "one state"),
        (lambda: p.until(x, lambda x: 1.0, 1.0, rising="up"), "rising"),
        (lambda: kr.propagator(TOP, method="dop853", dt=0.1).to(x, 1.0), "makes steps"),
        (lambda: kr.propagator(TOP, method="suris", order=2, dt=0.1).to(x, 1.0), "depend on dt"),
        (lambda: kr.propagator(TOP, method="exact").until(x, lambda x: x[5], 1.0), "how often"),
        (lambda: p.to(x, 1e308), "at most"),
        (lambda: p.until(x, lambda x: x[5], 1e308), "at most"),
        (lambda: p.until(x, lambda x: x[5], 1e18 + 1000, time=1e18), "lost"),
    ):
        with pytest.raises(kr.InputError, match=said):
            call()
