"""order="auto" of perturbed bodies: the error that was asked for, at no more than it takes."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.bodies import BODIES
from kreisel.method import auto
from kreisel.method.composition import splitting
from kreisel.runs.planning import choices
from kreisel.runs.settings import Settings


def top(d: Any) -> Any:
    return kr.perturbed(
        kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
        potential=lambda P, *, d: d * P[0] + d * P[1] ** 3,
        params={"d": d},
    )


START = {"M": (0.3, 0.2, 1.1), "P": (0.6, 0.0, 0.8)}


def error(run: Any, truth: Any) -> float:
    return max(float(abs(run[k][-1] - truth[k][-1]).max() / abs(truth[k][-1]).max()) for k in ("M", "P"))


@pytest.mark.parametrize("d", [1e-2, 1e-5])
def test_the_error_is_below_the_tolerance(d: float) -> None:
    body = top(d)
    truth = kr.simulate(body, START, dt=50 / 2048, steps=2048, every=2048, order=8)
    taken = []
    for tol in (1e-3, 1e-6, 1e-9):
        run = kr.simulate(body, START, dt=25.0, steps=2, order="auto", tol=tol)
        options = json.loads(run.attrs["options"])
        assert run.attrs["method"] == "splitting" and options["tol"] == tol
        np.testing.assert_array_equal(run.time, [0, 25, 50])
        assert error(run, truth) <= options["expected_error"] <= tol
        assert options["expected_error"] > tol / 1000  # a step that is far too short would pass too
        taken.append(run.attrs["steps"])
    assert taken[0] < taken[2] < 1000


def test_a_small_perturbation_takes_fewer_kicks() -> None:
    kicks = []
    for d in (1e-2, 1e-6):
        run = kr.simulate(top(d), START, dt=50.0, steps=1, order="auto", tol=1e-6)
        order = json.loads(run.attrs["options"])["order"]
        kicks.append(run.attrs["steps"] * len(splitting(tuple(order) if isinstance(order, list) else order).b))
    assert kicks[1] < kicks[0] / 2


def test_time_orientation_and_pairs() -> None:
    driven = kr.perturbed(kr.EulerTop(J=(1, 2, 2.5)), potential=lambda g, t: 0.01 * np.sin(t) * g[0, 1])
    run = kr.simulate(
        driven, {"M": (0.4, 0.3, 1.5)}, t_end=20.0, dt=20.0, order="auto", tol=1e-7, orientation=(1, 0, 0, 0)
    )
    truth = kr.simulate(
        driven, {"M": (0.4, 0.3, 1.5)}, t_end=20.0, dt=0.02, every=1000, order=8, orientation=(1, 0, 0, 0)
    )
    assert abs(run.M[-1] - truth.M[-1]).max() < 1.5e-7
    pair = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), pair_potential=lambda a1, a2: 0.01 * (a1 @ a2), pairs=[(0, 1)])
    x0 = pair.state(m=[(0.1, 0.2, 1.5), (0.3, -0.2, 1.1)], a=[(0.6, 0, 0.8), (0, 0.6, 0.8)])
    run = kr.simulate(pair, x0, dt=20.0, steps=1, order="auto", tol=1e-7)
    truth = kr.simulate(pair, x0, dt=0.02, steps=1000, every=1000, order=8)
    assert abs(run.m[-1] - truth.m[-1]).max() < 2e-7


def test_each_lane_has_its_own_choice() -> None:
    both, asked = top([1e-2, 1e-5]), Settings.checked(dt=20.0, steps=1, order="auto", tol=1e-6)
    found = choices(both, both.state(**START), asked)
    alone = [choices(top(d), both.state(**START), asked)[0] for d in (1e-2, 1e-5)]
    assert found == alone and found[0] != found[1]


def test_one_splitting_is_not_its_own_witness() -> None:
    """A top that falls from the upright: few splittings get through long steps, and one of them is far off."""
    body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a: 0.01 * a[0])
    start = {"m": (0, 0, 0), "a": (0, 0, 1)}
    run = kr.simulate(body, start, dt=40.0, steps=1, order="auto", tol=1e-6)
    truth = kr.simulate(body, start, dt=0.01, steps=4000, every=4000, order=8)
    assert abs(run.m[-1] - truth.m[-1]).max() < 1e-5


@pytest.mark.parametrize("slow", [0.0, 1e-3])
def test_errors_that_grow_faster_than_the_time_take_shorter_steps(slow: float) -> None:
    """The error h^4 (t + slow t^2), of which a pilot sees the first part alone."""

    def steps(order: Any, h: float, count: int) -> auto.Pilot:
        t = h * count
        return auto.Pilot((np.array([[1.0, 3e-9 * h**4 * (t + slow * t * t)]]),), 1.0)

    tol, end = 1e-5, 2000.0
    first = auto.Choice((8, 6, 4), 500, 1e-6, "splitting")
    found = auto.witnessed(steps, first, 1.0, 500.0, end, tol)
    assert (found.steps > first.steps) == (slow > 0)
    for choice, below in ((first, slow == 0), (found, True)):
        off = 3e-9 * (500 / choice.steps) ** 4 * (1280 + slow * 1280**2) * end / 1280
        assert (off <= tol * 1.1) == below
    hopeless = auto.witnessed(steps, first, 1.0, 500.0, end, 1e-10)
    assert hopeless.steps > 7 * first.steps and hopeless.expected > 1e-10


def test_neither_rates_nor_errors_depend_on_units() -> None:
    """A grain and a moon turn alike, and the error of an orientation is seen beside a momentum of 1e20."""
    moments, M = np.array([0.5, 0.9, 1.0]), np.array([[0.1, 0.2, 0.3]])
    rates = [
        auto.rate_of(BODIES["satellite"](moments=size * moments, semi_major_axis=7e6), (algebra.hat(size * M),))
        for size in (1e-20, 1.0, 1e20)
    ]
    assert 0.1 < rates[0] < 1 and np.ptp(rates) < 1e-12
    for size in (1e-20, 1e20):
        one, other = (size * M, np.array([[1.0, 1e-3]])), (size * M, np.array([[1.0, 0.0]]))
        assert auto._apart(one, other) == pytest.approx(1e-3)


def test_orientations_by_lane() -> None:
    body = kr.perturbed(kr.EulerTop(J=(1, 2, 2.5)), potential=lambda g: 0.01 * g[0, 1])
    turns = np.array([(1, 0, 0, 0), (0, 1, 0, 0), (0.6, 0, 0, 0.8)], dtype=float)
    asked, M = Settings.checked(dt=10.0, steps=1, order="auto", tol=1e-6), np.array([(0.4, 0.3, 1.5)] * 3)
    found = choices(body, body.state(M=kr.algebra.hat(M)), asked, turns)
    assert found == [choices(body, body.state(M=M[0]), asked, g)[0] for g in turns]
    assert len(choices(body, body.state(M=kr.algebra.hat(M)), asked, (1, 0, 0, 0))) == 3


def test_orders_that_a_force_does_not_have_are_left_out() -> None:
    body = kr.perturbed(kr.LagrangeTopMoving(A=(0, 0, 1)), torque=lambda M: -0.01 * M)
    run = kr.simulate(body, START, dt=10.0, steps=1, order="auto", tol=1e-6)
    assert json.loads(run.attrs["options"])["order"] not in (6, 8)


def test_the_pilot_is_what_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mutant that takes every error for none chooses the longest steps, and misses the tolerance."""
    monkeypatch.setattr(auto, "_apart", lambda one, other: 0.0)
    body = top(1e-2)
    run = kr.simulate(body, START, dt=50.0, steps=1, order="auto", tol=1e-6)
    truth = kr.simulate(body, START, dt=50 / 2048, steps=2048, every=2048, order=8)
    assert error(run, truth) > 1e-6


def test_what_is_wrong_is_said() -> None:
    body = top(1e-2)
    for more, said in (
        ({"tol": 1e-13}, "Use a larger tol"),
        ({"tol": 0.0}, "needs tol"),
        ({"tol": 1e-6, "method": "variational"}, "'baecklund' or 'splitting'"),
    ):
        with pytest.raises(kr.InputError, match=said):
            kr.simulate(body, START, dt=1000.0, steps=1, order="auto", **more)


@pytest.mark.parametrize(("dt", "t_end", "steps"), [(0.1, 10.0, 100), (0.3, 1.0, 4), (5.0, 1.0, 1), (0.1, 0.3, 3)])
def test_until_a_time(dt: float, t_end: float, steps: int) -> None:
    run = kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": (0, 0, 1), "a": (0.6, 0, 0.8)}, dt=dt, t_end=t_end)
    assert run.attrs["steps"] == steps and abs(run.time[-1] - t_end) < 1e-15 * steps
    shorter = run.attrs["dt"] < dt * (1 - 1e-9)
    assert run.attrs.get("asked_dt") == (dt if shorter else None)
    count = "1 step" if steps == 1 else f"{steps} steps"
    for text in (repr(run.kreisel), run.kreisel._repr_html_()):
        assert ("asked for: dt = " in text) == shorter and f"{count} of {run.attrs['dt']:g}" in text
    with pytest.raises(kr.InputError, match="both"):
        kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": (0, 0, 1), "a": (1, 0, 0)}, dt=dt, t_end=t_end, steps=3)
    with pytest.raises(kr.InputError, match="t_end"):
        kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": (0, 0, 1), "a": (1, 0, 0)}, dt=dt, t_end=-1.0)
