"""order="auto": the order and the step for a tolerance."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import kreisel as kr
from kreisel.cli import runs as commands
from kreisel.lab import exact
from kreisel.method.auto import ORDERS, choose
from kreisel.system import REGISTRY
from sizes import FULL
from support import configuration

SYSTEMS = [name for name, system in REGISTRY.items() if system.baecklund is not None]
OPTIONS = {"dt": 1.0, "steps": 100, "every": 50}
TIMED = SYSTEMS if FULL else ("lagrange-top", "clebsch", "neumann")
BEYOND = [("lagrange-top", 4), *([("lagrange-top-moving", 4)] if FULL else [])]  # half a minute of compiling


def start(name: str, n: int) -> tuple[object, object]:
    draw = exact.float_random(np.random.default_rng([3, n]))
    model, parts = exact.random_model(REGISTRY[name], n, draw), REGISTRY[name].space.point(n, draw)
    return model, model.state(**dict(zip(REGISTRY[name].space.letters, parts, strict=True)))


def apart(one: object, other: object, letters: tuple[str, ...]) -> float:
    """The largest difference at the last time, relative to the largest entry of each component."""
    ends = [(one[k].values[-1], other[k].values[-1]) for k in letters]
    return max(abs(a - b).max() / abs(b).max() for a, b in ends)


@pytest.mark.parametrize(("name", "n"), [*((name, 3) for name in TIMED), *BEYOND])
def test_the_tolerance_is_reached_and_not_wasted(name: str, n: int) -> None:
    model, x0 = start(name, n)
    letters = model.system.space.letters
    truth = kr.simulate(model, x0, **{**OPTIONS, "dt": 0.05, "steps": 2000, "every": 1000}, order=12)
    for tol in (1e-3, 1e-7, 1e-10):
        run = kr.simulate(model, x0, **OPTIONS, order="auto", tol=tol)
        assert np.allclose(run.time, truth.time, rtol=1e-14)
        chosen = json.loads(run.attrs["options"])
        assert chosen["tol"] == tol
        assert chosen["expected_error"] <= tol
        assert apart(run, truth, letters) <= tol
        cheaper = kr.simulate(model, x0, dt=2 * run.attrs["dt"], steps=run.attrs["steps"] // 2, order=chosen["order"])
        if 2 * cheaper.sizes["time"] > 40:  # of whole steps
            assert apart(cheaper, truth, letters) > tol


def test_the_choice_costs_least() -> None:
    """No other even number of stages reaches the tolerance with fewer maps, by half."""
    model, x0 = start("lagrange-top", 3)
    parts, time, tol = tuple(x0.values()), 200.0, 1e-8
    (choice,) = choose(model, parts, time, time, tol)
    truth = kr.at(model, x0, [0.0, time])
    for order in ORDERS:
        steps = int(choice.order * choice.steps / 2 / order)
        run = kr.simulate(model, x0, dt=time / steps, steps=steps, every=steps, order=order)
        assert apart(run, truth, ("m", "a")) > tol


def test_the_worst_lane_counts() -> None:
    model, _ = start("lagrange-top", 3)
    a, slow, fast = (0.6, 0, 0.8), (0.1, 0.2, 0.3), (1.0, 2.0, 15.0)
    (one,) = choose(model, tuple(model.state(m=fast, a=a).values()), 10.0, 100.0, 1e-8)
    (both,) = choose(model, tuple(model.state(m=(slow, fast), a=(a, a)).values()), 10.0, 100.0, 1e-8)
    (alone,) = choose(model, tuple(model.state(m=slow, a=a).values()), 10.0, 100.0, 1e-8)
    assert alone.order * alone.steps < one.order * one.steps <= both.order * both.steps


@pytest.mark.parametrize("tol", [None, 0, -1, 1, 1e-20, float("nan"), "small"])
def test_tolerances_that_cannot_be(tol: object, top: object, x0: object) -> None:
    with pytest.raises(kr.InputError, match="order='auto' needs tol"):
        kr.simulate(top, x0, **OPTIONS, order="auto", tol=tol)


def test_what_does_not_go_together(top: object, x0: object) -> None:
    for message, options in {
        "order must be an integer": {"order": "high"},
        "tol goes with order='auto'": {"tol": 1e-6},
        "method='baecklund'": {"order": "auto", "tol": 1e-6, "method": "suris"},
        "a multiple of every": {"order": "auto", "tol": 1e-6, "every": 7},
    }.items():
        with pytest.raises(kr.InputError, match=message):
            kr.simulate(top, x0, **{**OPTIONS, **options})


def test_a_body_at_rest_is_one_step() -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    assert choose(top, tuple(top.state(m=(0, 0, 0), a=(0, 0, -1)).values()), 10.0, 100.0, 1e-8)[0].steps == 1


def test_a_motion_far_faster_than_dt(tmp_path: Path) -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = {"m": (0.1, 0.2, 1.5), "a": (6e19, 0, 8e19)}
    auto = {"dt": 0.05, "steps": 20, "order": "auto", "tol": 1e-6}
    with pytest.raises(kr.InputError, match=r"a motion that 1,000,000 steps in a dt resolve, got one that needs"):
        kr.simulate(top, x0, **auto)
    lanes = {"state.a[2]": [0.8, 8e19], "state.a[0]": [0.6, 0]}
    run = kr.sweep(top, x0, kr.Design(together=lanes), path=tmp_path / "s.zarr", workers=0, **auto)
    assert run.failed.values.tolist() == [0, 1]


def test_from_a_file_and_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("top.toml").write_text(
        configuration('order = "auto"\ntol = 1e-8\ndt = 1.0\nsteps = 100\nevery = 10', 'path = "run.zarr"')
    )
    commands.run(Path("top.toml"), changes=[], figure=True, project=True)
    run = kr.open_run("run.zarr")
    longer = kr.resume(Path("run.zarr"), extend=2 * run.attrs["steps"])
    assert longer.attrs["options"] == run.attrs["options"]
    assert longer.time.values[-1] == pytest.approx(200)


def test_a_system_without_its_maps_is_refused() -> None:
    case = kr.KirchhoffCase(a1=0.6, a3=0.5, b1=0.3, b3=0.8, c1=0.9, c3=0.7)
    x0 = case.state(M=(1, 0.5, 0.5), P=(-0.3, 0.8, -1))
    with pytest.raises(kr.InputError, match="expected a system whose Bäcklund transformations are known"):
        kr.simulate(case, x0, dt=0.02, steps=1, method="baecklund", order="auto", tol=1e-9)
