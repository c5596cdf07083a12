"""Splittings with a corrector: orders, C C^-1 = 1, mutants, lanes, archives, what is refused."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra.reuse import forget
from kreisel.bodies import BODIES
from kreisel.method import auto, composition, splitting as method
from kreisel.method.composition import CORRECTED, Splitting, corrector, inverse, joined
from kreisel.runs.planning import make_plan
from kreisel.storage.checking import steps_again
from kreisel.sweeps.sweep import check_archive

I = np.array([1.0, 1.3, 0.5])  # noqa: E741
FREE = kr.EulerTop(J=I.sum() / 2 - I)
Q = np.array([0.1, 0.2, 0.3, 0.4]) / np.sqrt(0.3)
M0, P0 = (0.3, 0.2, 1.1), (0.6, 0.0, 0.8)
START = {"M": M0, "P": P0}


def top(d: Any = 1e-3) -> Any:
    return kr.perturbed(
        kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
        inertia=(1, 1.001, 0.5),
        potential=lambda P, *, d: d * P[0],
        params={"d": d},
    )


def driven(k: Any) -> Any:
    """Everything that a corrector moves: the time, the orientation, the work; turns, a kick and damping."""
    return kr.perturbed(
        FREE,
        potential=lambda g, t, *, k: k * np.sin(1.3 * t) * (g[2] @ np.array([0.3, 0.1, 1.0])),
        inertia=(1.0, 1.31, 0.5),
        damping=(0.01, 0.02, 0.03),
        params={"k": k},
    )


def end(body: Any, order: Any, count: int) -> np.ndarray:
    run = kr.simulate(body, {"M": M0}, dt=4 / count, steps=count, every=count, orientation=Q, order=order)
    return run.M.values[-1]


@cache
def reference(eps: float) -> tuple[Any, np.ndarray]:
    """The body in lanes with eps, -eps and 0, and their ends by a splitting without a corrector."""
    body = kr.perturbed(
        FREE,
        potential=lambda g, *, k: k * g[2] @ np.array([0.3, 0.1, 1.0]),
        params={"k": [[eps], [-eps], [0.0]]},
    )
    return body, end(body, (10, 6, 4), 64)


def errors(order: Any, count: int, eps: float) -> tuple[float, float]:
    """The error of M by the first power of eps and by the second, over the power."""
    body, y = reference(eps)
    x = end(body, order, count)
    odd, even = (x[0] - x[1]) - (y[0] - y[1]), (x[0] + x[1] - 2 * x[2]) - (y[0] + y[1] - 2 * y[2])
    return float(abs(odd).max()) / eps, float(abs(even).max()) / eps**2


@cache
def of_first_power(count: int) -> float:
    return errors((10, 2), count, 1e-5)[0]


def slope(counts: tuple[int, ...], values: list[float]) -> float:
    return float(-np.polyfit(np.log(counts), np.log(values), 1)[0])


def test_the_first_power_is_of_order_ten() -> None:
    counts = (6, 8, 10, 12)
    assert abs(slope(counts, [of_first_power(n) for n in counts]) - 10) < 0.2  # 10.06


@pytest.mark.parametrize("order", CORRECTED)
def test_the_second_power_is_of_order_two(order: Any) -> None:
    counts = (12, 16, 24)
    assert abs(slope(counts, [errors(order, n, 1e-4)[1] for n in counts]) - 2) < 0.15  # 1.98


def test_eight_weights_leave_less_than_four() -> None:
    assert errors((18, 2), 8, 1e-5)[0] < of_first_power(8) / 10  # 33


@pytest.mark.parametrize(("order", "count"), CORRECTED.items())
def test_what_is_left_of_a_harmonic(order: Any, count: int) -> None:
    """sum b exp(i y c) of C^-1, step, C against its integral, with 40 digits: off by y^(2 count + 2)."""
    with mpmath.workdps(40):
        C = composition._correcting(Splitting((mpmath.mpf(1) / 2,) * 2, (mpmath.mpf(1),)), count)
        a, b = joined(inverse(C), composition.BETWEEN, C)
        times, found = np.cumsum(np.array(a[:-1])), []
        for y in (mpmath.mpf("0.2"), mpmath.mpf("0.1")):
            total = mpmath.fsum(w * mpmath.expj(y * t) for t, w in zip(times, b, strict=True))
            found.append(abs(total - (mpmath.expj(y) - 1) / (1j * y)))
        assert abs(mpmath.log(found[0] / found[1], 2) - order[0]) < 0.05


@pytest.mark.parametrize("place", [0, -1])
def test_a_weight_that_is_off_is_found(place: int, monkeypatch: pytest.MonkeyPatch) -> None:
    right = corrector((10, 2))
    assert right is not None
    b = list(right.b)
    at = [i for i, w in enumerate(b) if w][place]
    b[at] += 1e-9
    monkeypatch.setattr(composition, "_correcting", lambda step, count: right._replace(b=tuple(b)))
    with pytest.raises(ArithmeticError, match="condition of eps"):
        corrector.__wrapped__((10, 2))


@pytest.mark.parametrize(
    "mutate",
    [
        inverse,
        lambda C: C._replace(b=tuple(w * 1.01 for w in C.b)),
        lambda C: C._replace(b=tuple(w * (abs(w) > 1e-3) for w in C.b)),
    ],
    ids=["sign", "size", "without the outermost"],
)
def test_mutants_lose_the_order(mutate: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = (10, 12)
    right = [of_first_power(n) for n in counts]
    C = corrector((10, 2))
    assert C is not None
    monkeypatch.setattr(method, "corrector", lambda order: mutate(C))
    forget()
    wrong = [errors((10, 2), n, 1e-5)[0] for n in counts]
    forget()
    assert slope(counts, wrong) < 9 < slope(counts, right)


def test_a_corrector_and_its_inverse() -> None:
    """C C^-1 = 1 to rounding, and neither is 1."""
    asked: dict[str, Any] = {"dt": 0.3, "steps": 1, "order": (18, 2), "orientation": Q}
    plan = make_plan(driven(0.2), {"M": M0}, **asked)
    plain = make_plan(driven(0.2), {"M": M0}, **{**asked, "order": (2, 2)})
    back, out = plan.corrections
    first = {name: value[0] for name, value in plan.observe(plan.first[None]).items()}
    assert abs(first["M"] - M0).max() < 1e-14 and abs(first["g"] - Q).max() < 1e-14 and abs(first["work"]) < 1e-14
    end = plan.first.shape[1] - 1  # the last number is the longest part of a step
    assert abs(plan.first - plain.first)[:, :end].max() > 1e-4
    z = plain.first[None]
    assert abs(out(back(z)) - z)[..., :end].max() < 1e-14 and abs(back(out(z)) - z)[..., :end].max() < 1e-14


def test_without_weights_it_is_the_leapfrog(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last A of a step and the first one of the next are one motion."""
    C = corrector((10, 2))
    assert C is not None
    asked: dict[str, Any] = {"dt": 0.3, "steps": 5, "orientation": Q}
    corrected, plain = (kr.simulate(driven(0.2), {"M": M0}, order=order, **asked) for order in ((10, 2), (2, 2)))
    monkeypatch.setattr(method, "corrector", lambda order: C._replace(b=tuple(0 * w for w in C.b)))
    forget()
    run = kr.simulate(driven(0.2), {"M": M0}, order=(10, 2), **asked)
    forget()
    for name in ("M", "g", "work", "energy"):
        assert abs(run[name] - plain[name]).max() < 1e-13, name
    assert abs(run.M - corrected.M).max() > 1e-5


@pytest.mark.parametrize("order", CORRECTED)
def test_work_time_and_orientation_move_with_it(order: Any) -> None:
    asked: dict[str, Any] = {"dt": 0.1, "steps": 100, "every": 10, "orientation": Q}
    run, truth = (kr.simulate(driven(0.01), {"M": M0}, order=how, **asked) for how in (order, 8))
    for name in ("M", "g", "work", "energy"):
        assert abs(run[name] - truth[name]).max() < 1e-5, name
    leapfrog = kr.simulate(driven(0.01), {"M": M0}, order=(2, 2), **asked)
    assert abs(run.balance - run.balance[0]).max() < abs(leapfrog.balance - leapfrog.balance[0]).max() / 10


def test_lanes_have_the_bits_of_single_runs() -> None:
    k = np.array([0.0, 0.01, 0.1, 0.2, 0.5])
    asked: dict[str, Any] = {"dt": 0.1, "steps": 33, "every": 10, "orientation": Q, "order": (10, 2)}
    run = kr.simulate(driven(k), {"M": M0}, **asked)
    for lane in (0, 3):
        single = kr.simulate(driven(k[lane]), {"M": M0}, **asked)
        for name in ("M", "g", "work", "energy"):
            assert (single[name].values == run[name].values[:, lane]).all(), name


def test_rows_do_not_depend_on_which_are_saved() -> None:
    asked: dict[str, Any] = {"dt": 0.4, "steps": 60, "order": (10, 2)}
    every, few = (kr.simulate(top(), START, every=each, **asked) for each in (1, 20))
    for name in ("M", "P", "energy"):
        assert (every[name].values[::20] == few[name].values).all()


def test_bodies_in_pairs() -> None:
    """Their turns are parts of a kick, so that each kick of the corrector is a stage or three."""
    tops = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=[0.5, 0.7])
    pair = kr.perturbed(
        tops,
        pair_potential=lambda P1, P2: 1e-4 * (P1 @ P2),
        pairs=[(0, 1)],
        inertia=[(1, 1.0001, 0.5), (1, 1.0001, 0.7)],
    )
    start = {"M": np.array([(0.1, 0.2, 1.1), (0.3, -0.2, 1.0)]), "P": np.array([P0, (0, 0.6, 0.8)])}
    ends = [
        kr.simulate(pair, start, dt=10 / n, steps=n, every=n, order=order).M.values[-1]
        for order, n in (((10, 2), 40), ((2, 2), 40), (8, 80))
    ]
    assert abs(ends[0] - ends[2]).max() < 1e-7 < 1e-6 < abs(ends[1] - ends[2]).max()


def test_a_propagator_goes_on_at_the_time_it_is_given() -> None:
    """The state between two calls is that of the body: C C^-1 stands between them."""
    body = kr.perturbed(FREE, potential=lambda g, t: 0.1 * np.sin(t) * g[2, 2])
    p = kr.propagator(body, order=(10, 2), dt=0.1, orientation=True)
    x = {"M": np.array(M0), "g": Q}
    whole, parts = p.steps(x, 30, time=0.0), p.steps(p.steps(x, 10, time=0.0), 20, time=1.0)
    run = kr.simulate(body, {"M": M0}, dt=0.1, steps=30, every=30, order=(10, 2), orientation=Q)
    assert abs(whole["M"] - parts["M"]).max() < 1e-13 and abs(whole["M"] - run.M[-1]).max() < 1e-13
    assert abs(p.steps(p.steps(x, 10, time=0.0), 20, time=0.0)["M"] - whole["M"]).max() > 1e-4


def test_parameters_of_a_call_are_those_of_the_corrector_too() -> None:
    p, strong = kr.propagator(top(1e-3), order=(10, 2), dt=0.4), kr.propagator(top(2e-3), order=(10, 2), dt=0.4)
    x = np.array([*M0, *P0])
    for steps in (lambda p, **d: p.steps(x, 20, **d), lambda p, **d: p.steps(x, 20, every=5, **d)[-1]):
        assert abs(steps(p, d=2e-3) - steps(strong)).max() < 1e-13 < 1e-5 < abs(steps(p) - steps(strong)).max()


def test_a_longer_run_is_one_that_was_not_stopped(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"dt": 0.2, "every": 10, "order": (10, 2), "orientation": Q}
    kr.simulate(driven(0.1), {"M": M0}, steps=50, path=tmp_path / "short.zarr", **asked).close()
    whole = kr.simulate(driven(0.1), {"M": M0}, steps=100, **asked)
    with kr.resume(tmp_path / "short.zarr", extend=100, system=driven(0.1)) as run:
        assert "wisdom1996" in kr.cite(run)
        for name in ("M", "g", "work", "energy"):
            assert (run[name].values == whole[name].values).all(), name


def test_an_archive_follows_from_its_rows(tmp_path: Path) -> None:
    """`kreisel check` steps from rows at times other than 0."""
    model = BODIES["satellite"](moments=(0.0067, 0.033, 0.034), semi_major_axis=6_878_137.0, eccentricity=0.01)
    state = model.state(M=(0.0, 1e-6, 3.7e-5))
    path = tmp_path / "run.zarr"
    run = kr.simulate(model, state, dt=60, steps=200, orientation=(1, 0, 0, 0), order=(10, 2), path=path)
    whole = run.load()
    assert check_archive(path)[1] == [] == steps_again(whole)
    changed = whole.copy(deep=True)
    changed["M"][101:] *= 1 + 1e-5
    assert steps_again(changed)


def test_casimirs_stand_still_and_the_energy_does_not_drift() -> None:
    run = kr.simulate(top(1e-2), START, dt=0.4, steps=100_000, every=500, order=(10, 2))
    table = kr.drift(run)
    assert table.loc[["casimir[0]", "casimir[1]"], "ulps"].max() < 8 and not table.loc["energy", "conserved"]
    off = abs(run.energy - run.energy[0]).values
    assert off.max() < 1e-4 and off[20:].max() < 3 * off[:20].max()


@pytest.mark.parametrize("d", [1e-5, 1e-3])
def test_auto_takes_it_where_it_pays(d: float) -> None:
    truth = kr.simulate(top(d), START, dt=100 / 4096, steps=4096, every=4096, order=8)
    run = kr.simulate(top(d), START, dt=100.0, steps=1, order="auto", tol=1e-5)
    options = json.loads(run.attrs["options"])
    assert tuple(options["order"]) in CORRECTED
    assert max(abs(run[k][-1] - truth[k][-1]).max() for k in ("M", "P")) <= 1e-5


def test_auto_counts_what_a_row_costs() -> None:
    def steps(order: Any, h: float, count: int) -> Any:
        if order not in ((2, 2), (10, 2), 8, (10, 6, 4)):
            return None
        error = {(2, 2): 1e-6 * h**2, (10, 2): 1e-6 * h**10}.get(order, 0.0)
        cost, row = (1.0, 15.0 if order == (10, 2) else 0.0) if error else (10.0, 0.0)
        return auto.Pilot(np.array([[1.0, 1.0 + error]]), cost, row)

    few = auto.choose_splitting(steps, 1.0, 64.0, 64.0, 1e-7)
    many = auto.choose_splitting(steps, 1.0, 1.0, 64.0, 1e-7)
    assert few.order == (10, 2) and many.order != (10, 2)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"times": [0.1, 0.5]}, "times: expected a method whose steps may differ"),
        ({"steps": 4, "impulses": {"time": 0.3, "M": (0, 0, 0.1)}}, "variables that depend on the step"),
        ({"steps": 4, "events": kr.Event(lambda x: x["P"][2])}, "events: expected a method whose steps may differ"),
        ({"steps": 4, "order": (12, 2)}, "one of its orders"),
    ],
)
def test_runs_that_are_refused(more: dict[str, Any], words: str) -> None:
    with pytest.raises(kr.InputError, match=words):
        kr.simulate(top(), START, **{"dt": 0.25, "order": (10, 2), **more})


def test_what_else_is_refused() -> None:
    p = kr.propagator(top(), order=(10, 2), dt=0.25)
    for call in (
        lambda: p.to(START, 1.0),
        lambda: p.until(START, lambda x: x["P"][2], 5.0),
        lambda: kr.differentiable(top(), order=(10, 2)),
        lambda: kr.code(top(), START, dt=0.1, order=(10, 2)),
    ):
        with pytest.raises(kr.InputError, match=r"order.*\(10, 2\).*Use order=\(8, 2\)"):
            call()
