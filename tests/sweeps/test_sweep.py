"""Sweeps: lanes are single runs, the store is the same for any workers and after any fault, bad lanes are named."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.cli.configuration import read_sweep
from kreisel.storage import archive
from kreisel.storage.opening import open_lanes
from kreisel.sweeps import workers
from kreisel.sweeps.design import Lanes
from kreisel.sweeps.ensemble import Sweep, angular_frequency
from kreisel.sweeps.sweep import MOST_STEPS, carry_out, check_archive, lanes_again
from support import ROOT, configuration, contents

DESIGN = """[sweep]
rng = 7
draws = 6
block = 5
save = ["drift", "extremes", "frequencies", "trajectories"]
[sweep.grid]
system.alpha = { from = 0.5, to = 1.5, count = 4 }
[sweep.random]
"state.m[2]" = { uniform = [1.0, 2.0] }
state.a = { sphere = 1.0 }
"""
SWEEP = configuration("dt = 0.05\nsteps = 200\nevery = 2", 'path = "sweep.zarr"', more=DESIGN)
LONG = pytest.mark.skipif("KREISEL_FULL" not in os.environ, reason="`make test-full` and `make soak` run it")
KILLS = int(os.environ.get("KREISEL_KILLS", "3"))  # `make soak` asks for 200
OPTIONS = {"dt": 0.05, "steps": 200, "every": 2}


def carried(folder: Path, text: str = SWEEP, count: int = 0, **more: Any) -> Path:
    """The store of the sweep in `text`, made in `folder`."""
    folder.mkdir(exist_ok=True)
    (folder / "sweep.toml").write_text(text)
    description, file, path = read_sweep(folder / "sweep.toml")
    return carry_out(description, folder / path, source=file, workers=count, progress=False, **more).path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return carried(tmp_path_factory.mktemp("whole"))


def test_every_lane_is_a_single_run(whole: Path) -> None:
    run = kr.open_run(whole).load()
    assert run.sizes["lane"] == 24
    for lane in (0, 7, 23):
        one = run.isel(lane=lane)
        top = kr.LagrangeTop(p=(0, 0, 1), alpha=float(one["system.alpha"]))
        x0 = {"m": (0.1, 0.2, float(one["state.m[2]"])), "a": one["state.a"].values}
        single = kr.simulate(top, x0, **OPTIONS)
        for name in single.data_vars:
            assert (one[name].values == single[name].values).all(), name
            assert run[name].dims[2:] == single[name].dims[1:]
        for name in ("energy", "casimir", "spectrum"):
            change = abs(single[name].values - single[name].values[0]).max(0)
            assert (one[f"{name}_drift"].values == change).all()
        assert (one.a_min.values == single.a.values.min(0)).all()
        assert (one.m_max.values == single.m.values.max(0)).all()
    assert set(np.unique(run["system.alpha"])) == set(np.linspace(0.5, 1.5, 4))


def test_lanes_of_exact_are_compared_in_their_block(tmp_path: Path) -> None:
    """Lanes of Clebsch's `exact` share the number of pairs in a step: another lane may change their last bits."""
    design = kr.Design(grid={"state.M[2]": [0.3, 1.0, 2.0, 3.0, 5.0, 40.0]})
    x0, more = {"M": (0.1, 0.2, 0.3), "P": (0.6, 0, 0.8)}, {"dt": 0.5, "steps": 100, "method": "exact"}
    path = tmp_path / "run"
    kr.sweep(kr.Clebsch(b=(1, 2, 4)), x0, design, path=path, workers=0, save=["trajectories"], block=6, **more)
    assert check_archive(path)[1] == []


def test_a_wrong_lane_is_found_next_to_a_long_one(tmp_path: Path) -> None:
    """The block of the lane is too long to be computed again; the lane is not."""
    design, x0 = kr.Design(together={"run.steps": [100, MOST_STEPS + 1]}), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
    path = tmp_path / "run"
    kr.sweep(kr.LagrangeTop(p=(0, 0, 1)), x0, design, path=path, workers=0, block=2, dt=0.05, method="suris")
    run = open_lanes(path).load()
    assert lanes_again(run) == []
    run["energy_drift"][0] += 1e-10
    assert lanes_again(run) == ["energy_drift of lane 0 differs from the lane computed again"]


def test_impulses_strike_every_lane(tmp_path: Path) -> None:
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
    more: dict[str, Any] = {"dt": 0.1, "steps": 40, "method": "kahan", "order": 4}
    more["impulses"] = {"time": 1.03, "m": (0, 0.2, 0.1)}
    design = kr.Design(grid={"system.alpha": [0.5, 0.7, 1.0]})
    run = kr.sweep(top, x0, design, path=tmp_path / "run", workers=0, save=["drift", "trajectories"], **more)
    single = kr.simulate(kr.LagrangeTop(p=(0, 0, 1), alpha=0.7), x0, **more)
    assert (run.m.isel({"system.alpha": 1}).values == single.m.values).all() and (run.energy_drift > 0.1).all()
    for shown in (kr.plot, kr.view):
        with pytest.raises(kr.InputError, match="got a sweep"):
            shown(run.drop_dims("time"))  # a sweep without trajectories
    late = {**more, "impulses": {**more["impulses"], "time": 9.0}}
    for wrong in (late, {**more, "impulses": 3}):
        with pytest.raises(kr.InputError, match="impulses: expected"):
            kr.sweep(top, x0, design, path=tmp_path / "other", workers=0, **wrong)


def test_lanes_do_not_depend_on_the_blocks(whole: Path, tmp_path: Path) -> None:
    other = kr.open_run(carried(tmp_path / "other", SWEEP.replace("block = 5", "block = 24")))
    same = kr.open_run(whole)
    assert all((other[name].values == same[name].values).all() for name in same.variables)


def test_draws_depend_on_the_seed_and_the_lane_alone() -> None:
    base = {"system": {"p": [0, 0, 1]}, "state": {"m": [0.0, 0, 1], "a": [1.0, 0, 0]}, "run": {"dt": 0.1}}
    one = Lanes(base, {"random": {"state.m[2]": {"normal": [1, 2]}}, "draws": 5000, "rng": 1})
    two = Lanes(base, {"random": {"state.m[2]": {"normal": [1, 2]}, "state.a": {"sphere": 2}}, "draws": 9000, "rng": 1})
    (drawn,) = one.values(0, 5000).values()
    again = {q.name: v for q, v in two.values(0, 5000).items()}
    assert (again["state.m[2]"] == drawn).all()
    (part,) = one.values(1000, 3333).values()
    assert (part == drawn[1000:3333]).all()
    (other,) = (
        Lanes(base, {"random": {"state.m[2]": {"normal": [1, 2]}}, "draws": 5000, "rng": 2}).values(0, 5000).values()
    )
    assert not (other == drawn).any()
    assert abs(drawn.mean() - 1) < 0.15
    assert abs(drawn.std() - 2) < 0.15
    directions = again["state.a"] / 2
    assert np.allclose((directions**2).sum(-1), 1)
    assert abs(directions.mean(0)).max() < 0.05


def test_grid_and_list_and_draws_multiply() -> None:
    base = {"system": {"p": [0, 0, 1]}, "state": {"m": [0.0, 0, 1]}, "run": {"dt": 0.1}}
    spec = {
        "grid": {"system": {"alpha": [1.0, 2.0]}, "run.dt": {"from": 0.1, "to": 10, "count": 3, "spacing": "log"}},
        "list": {"state.m[0]": [5, 6], "state.m[1]": [7, 8]},
        "random": {"state.m[2]": {"uniform": [0, 1]}},
        "draws": 2,
        "rng": 1,
    }
    lanes = Lanes(base, spec)
    assert lanes.total == 24
    values = {q.name: v for q, v in lanes.values(0, 24).items()}
    assert values["system.alpha"].tolist() == [1.0] * 12 + [2.0] * 12
    assert np.allclose(values["run.dt"][:12], np.repeat([0.1, 1, 10], 4))
    assert (values["state.m[1]"] - values["state.m[0]"] == 2).all()
    filled = lanes.filled(lanes.values(3, 7))
    assert filled["state"]["m"].shape == (4, 3)
    assert (filled["state"]["m"][:, 0] == values["state.m[0]"][3:7]).all()


def test_the_page_shows_a_sweep_that_can_be_made(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "sweeps.md").read_text(encoding="utf-8")
    text = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)[0]
    (tmp_path / "sweep.toml").write_text(text, encoding="utf-8")
    description, _, _ = read_sweep(tmp_path / "sweep.toml")
    lanes = Sweep(json.loads(json.dumps({**description, "sweep": {"save": [], **description["sweep"]}}))).lanes
    assert lanes.total == 2000
    assert f"{lanes.total} here" in page


def test_frequencies_of_known_signals() -> None:
    rng = np.random.default_rng(1)
    true = rng.uniform(0.3, 25.0, 50)
    t = 0.1 * np.arange(4096)[:, None]
    signal = 5 + np.cos(true * t + rng.uniform(0, 6, 50)) + 0.4 * np.cos(np.sqrt(2) * true[::-1] * t / 3)
    assert abs(angular_frequency(signal, 0.1) / true - 1).max() < 1e-8
    still = np.column_stack([np.ones(64), np.zeros(64), np.full(64, np.nan)])
    assert angular_frequency(still, 0.1)[:2].tolist() == [0.0, 0.0]
    assert np.isnan(angular_frequency(still, 0.1)[2])


def test_frequency_of_nutation(tmp_path: Path) -> None:
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
    run = kr.sweep(
        top, x0, kr.Design(together={"system.alpha": [0.5, 1.0, 1.5]}), dt=0.05, steps=16384, every=4,
        path=tmp_path / "s.zarr", save=["frequencies"], method="exact", workers=0,
    )  # fmt: skip
    for lane, alpha in enumerate((0.5, 1.0, 1.5)):
        period = kr.nutation(kr.LagrangeTop(p=(0, 0, 1), alpha=alpha), x0).period
        assert abs(run.a_frequency.values[lane, 2] * period / (2 * np.pi) - 1) < 1e-7


@pytest.mark.filterwarnings("ignore:Lane .* more than half a revolution")
def test_bad_lanes_are_named_and_the_others_go_on(tmp_path: Path) -> None:
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
    alphas, spins = [1.0, 0.0, 0.7, 1.2, 1.3], [1.5, 1.5, 1e160, 1.5, 1e308]
    design = kr.Design(together={"system.alpha": alphas, "state.m[2]": spins})
    options = {"save": ["drift", "extremes", "trajectories"], "workers": 0, **OPTIONS}
    run = kr.sweep(top, x0, design, path=tmp_path / "s.zarr", **options).load()
    assert run.failed.values.tolist() == [0, 1, 1, 0, 1]
    table = kr.failures(run)
    assert table.index.tolist() == [1, 2, 4]
    assert "must not be 0" in table.message[1]
    assert "finite" in table.message[2]
    assert table["system.alpha"].tolist() == [0.0, 0.7, 1.3]
    assert run.attrs["failed_lanes"] == 3
    bad = run.failed.values == 1
    for name in ("energy_drift", "a_min", "casimir_start"):
        assert np.isnan(run[name].values[bad]).all()
        assert np.isfinite(run[name].values[~bad]).all()
    assert np.isfinite(run.a.values[:, ~bad]).all()
    good = kr.Design(together={"system.alpha": [1.0, 1.2]})
    alone = kr.sweep(top, x0, good, path=tmp_path / "good.zarr", **options)
    assert (alone.a.values == run.a.values[:, [0, 3]]).all()
    assert check_archive(tmp_path / "s.zarr")[1] == []


def test_long_steps_and_doubts_of_lanes_are_warned_of(tmp_path: Path) -> None:
    """As in a run, once for the lane with the largest values; lanes of a safe step give no warning."""
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
    options: dict[str, Any] = {"steps": 3, "workers": 0, "progress": False}
    grid = {"run.dt": [0.1, 4.0, 3.0], "state.m[2]": [1.5, -2.0]}
    with pytest.warns(kr.AccuracyWarning, match=r"^Lane 3: dt = 4 is 8 rad of this motion in a step") as seen:
        kr.sweep(top, x0, kr.Design(grid=grid), path=tmp_path / "long", **options)
    assert len(seen) == 1 and seen[0].filename == __file__
    kr.sweep(top, x0, kr.Design(grid=grid | {"run.dt": [0.1, 0.2]}), path=tmp_path / "short", **options)
    satellite = kr.physical.Satellite((1, 2, 3), kr.physical.Orbit.circular("500 km"))
    with pytest.warns(kr.AccuracyWarning, match=r"^Lane 1: dt = 100 s is too long for the forces"):
        spins = {"spin": [(0, 0, 0.001), (0, 0.1, 0.3)]}
        kr.sweep(satellite, {}, over=spins, dt="100 s", path=tmp_path / "fast", **options)
    with pytest.warns(kr.AccuracyWarning, match="^Lane 0: dt = 5 is"):  # as `kreisel sweep` does
        carried(tmp_path, SWEEP.replace("dt = 0.05", "dt = 5.0"))


def test_a_lane_that_blows_up_late_keeps_its_rows(tmp_path: Path) -> None:
    body, x0 = kr.HeavyTop(J=(1, 1.2, 1.4), A=(0, 0, 1)), {"M": (0.1, 0.2, 1.5), "P": (0.6, 0.0, 0.8)}
    options = {"save": ["trajectories", "drift"], "method": "variational"}
    design = kr.Design(together={"state.M[0]": [0.1, 40.0]})
    run = kr.sweep(body, x0, design, dt=0.1, steps=50, path=tmp_path / "s.zarr", workers=0, **options).load()
    assert run.failed.values.tolist() == [0, 1]
    assert np.isfinite(run.M.values[:, 0]).all()
    assert np.isnan(run.M.values[-1, 1]).all()
    assert np.isfinite(run.M.values[0, 1]).all()
    assert "solved" in kr.failures(run).message[1]


def test_steps_methods_and_orders_vary(tmp_path: Path) -> None:
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
    pairs = {"run.dt": [0.1, 0.05], "run.steps": [50, 100]}
    design = kr.Design(grid={"run.method": ["suris", "baecklund"]}, together=pairs)
    run = kr.sweep(top, x0, design, dt=1, steps=1, path=tmp_path / "s.zarr", workers=0).load()
    flat = kr.open_run(tmp_path / "s.zarr")["run.method"]
    words = flat.attrs["flag_meanings"].split()
    assert [words[i] for i in flat.values] == ["suris", "suris", "baecklund", "baecklund"]
    assert run["run.steps"].dims == ("list",) and run["run.method"].values.tolist() == ["suris", "baecklund"]
    for method, place, dt, steps in [("suris", 0, 0.1, 50), ("suris", 1, 0.05, 100), ("baecklund", 0, 0.1, 50)]:
        single = kr.simulate(top, x0, dt=dt, steps=steps, method=method)
        found = run.energy_drift.sel({"run.method": method}).isel(list=place)
        assert float(found) == float(abs(single.energy - single.energy[0]).max())
    assert np.isnan(run.energy_eps_drift.values).tolist() == [[False, False], [True, True]]
    assert check_archive(tmp_path / "s.zarr")[1] == []
    with pytest.raises(kr.InputError, match="the same times"):
        kr.sweep(top, x0, design, dt=1, steps=1, path=tmp_path / "t.zarr", workers=0, save=["trajectories"])


def test_each_lane_chooses_its_own_order_and_step(tmp_path: Path) -> None:
    """order="auto": a lane is a single run, whatever the blocks and the other lanes; what it chose is saved."""
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
    auto: dict[str, Any] = {"dt": 2.0, "steps": 30, "every": 10, "order": "auto"}
    spins, alphas = [0.2, 40.0, 1.5, 1.6, 7.0, 1e160], [1.0, 1.0, 1.0, 0.5, 0.0, 1.0]
    options = {"save": ["drift", "trajectories"], "workers": 0}
    design = kr.Design(together={"state.m[2]": spins, "system.alpha": alphas})
    one, two, all_ = (
        kr.sweep(top, x0, design, path=tmp_path / f"{block}.zarr", block=block, tol=1e-8, **auto, **options).load()
        for block in (1, 2, 6)
    )
    for name in one.variables:
        assert all(np.array_equal(one[name].values, other[name].values, equal_nan=True) for other in (two, all_)), name
    assert one.failed.values.tolist() == [0, 0, 0, 0, 1, 1]
    chosen = list(zip(one.chosen_order.values[:4].tolist(), one.chosen_dt.values[:4].tolist(), strict=True))
    assert len(set(chosen)) >= 3
    assert one.chosen_dt.values[1] < one.chosen_dt.values[0]
    assert np.isnan(one.chosen_dt.values[4:]).all()
    for lane in range(4):
        start = {**x0, "m": (0.1, 0.2, spins[lane])}
        single = kr.simulate(kr.LagrangeTop(p=(0, 0, 1), alpha=alphas[lane]), start, tol=1e-8, **auto)
        assert (json.loads(single.attrs["options"])["order"], single.attrs["dt"]) == chosen[lane]
        assert (one.a.values[:, lane] == single.a.values).all()
    design = kr.Design(together={"run.tol": [1e-3, 1e-8]})
    varied = kr.sweep(top, x0, design, path=tmp_path / "tol.zarr", workers=0, save=["drift"], tol=1.0, **auto).load()
    assert varied.chosen_dt.values.tolist()[1] == chosen[2][1]


def test_diagonals_and_three_lanes_are_not_mistaken(tmp_path: Path) -> None:
    """Three lanes of axial vectors or diagonals look like one matrix."""
    J, M = np.array([[1, 1.1, 1.2], [1, 1.3, 1.2], [1.0, 1.2, 1.5]]), np.eye(3)
    body, x0 = kr.HeavyTop(J=(1, 1, 1), A=(0, 0, 1)), {"M": (0, 0, 1), "P": (0.6, 0.0, 0.8)}
    options = {"orientation": (1, 0, 0, 0), "save": ["trajectories"], "workers": 0, **OPTIONS}
    run = kr.sweep(body, x0, kr.Design(together={"system.J": J, "state.M": M}), path=tmp_path / "s.zarr", **options)
    for lane in range(3):
        one = kr.HeavyTop(J=J[lane], A=(0, 0, 1))
        single = kr.simulate(one, {"M": M[lane], "P": (0.6, 0.0, 0.8)}, orientation=(1, 0, 0, 0), **OPTIONS)
        assert (single.M.values == run.M.values[:, lane]).all()
        assert (single.g.values == run.g.values[:, lane]).all()


def test_more_dimensions(tmp_path: Path) -> None:
    body = kr.Clebsch(b=(1, 2, 3, 4.5))
    x0 = body.state(M=np.zeros((4, 4)), P=(0.5, 0.5, 0.5, 0.5))
    M = np.zeros((4, 4))
    M[0, 1], M[1, 0] = 0.3, -0.3
    design = kr.Design(grid={"system.b[0]": [1, 1.5], "state.M": [M, 2 * M]})
    run = kr.sweep(body, x0, design, path=tmp_path / "s.zarr", workers=0, save=["trajectories"], **OPTIONS)
    single = kr.simulate(kr.Clebsch(b=(1.5, 2, 3, 4.5)), {"M": M, "P": x0.P}, **OPTIONS)
    assert run.M.dims == ("time", "system.b[0]", "state.M_index", "row", "column")
    assert (single.M.values == run.M.sel({"system.b[0]": 1.5}).isel({"state.M_index": 0}).values).all()
    assert run["state.M"].dims[0] == "state.M_index" and (run["state.M"].values[1] == 2 * M).all()


class Stopping(workers.Here):
    """Stops by an error after some blocks."""

    def __init__(self, after: int):
        self.after = after

    def map(self, function: Any, items: Any, *more: Any) -> Iterator[tuple[int, Any]]:
        yield from super().map(function, items[: self.after])
        raise KeyboardInterrupt


def test_the_same_call_goes_on(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(workers, "Here", lambda: Stopping(2))
        carried(tmp_path / "s")
    part = tmp_path / "s" / "sweep.zarr.part"
    (part / "a" / f"zarr.{'0' * 32}.partial").write_bytes(b"left by a kill")
    kept = kr.open_run(part)
    assert (kept.failed.values == 255).tolist() == [False] * 10 + [True] * 14
    chunk = next(part.glob("energy_start/c/0"))
    shutil.copy(chunk, chunk.with_name("3"))  # a worker that outlives its client is writing block 3
    assert np.isfinite(kept.load().energy_start.values[:10]).all() and np.isnan(kept.energy_start.values[10:]).all()
    chunk.with_name("3").unlink()
    assert "3 of 5 blocks are to do" in check_archive(part)[1][0]
    with pytest.raises(kr.InputError, match=r"another sweep.*sweep\.rng"):
        carried(tmp_path / "s", SWEEP.replace("rng = 7", "rng = 8"))
    assert contents(carried(tmp_path / "s")) == contents(whole)
    before = contents(whole)
    description, _, _ = read_sweep(tmp_path / "s" / "sweep.toml")
    report = carry_out(description, tmp_path / "s" / "sweep.zarr", workers=0)
    assert (report.before, report.blocks) == (5, 5)
    assert contents(tmp_path / "s" / "sweep.zarr") == before
    carried(tmp_path / "s", SWEEP.replace("rng = 7", "rng = 8"), overwrite=True)
    assert contents(tmp_path / "s" / "sweep.zarr") != before


@contextmanager
def command(folder: Path, *more: str) -> Iterator[subprocess.Popen[str]]:
    """`kreisel sweep`, which ends with the test whatever happens."""
    args = [sys.executable, "-m", "kreisel", "sweep", "sweep.toml", "--json", *more]
    client = subprocess.Popen(args, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield client
    finally:
        client.kill()
        client.communicate(timeout=60)


def blocks_done(folder: Path) -> int:
    try:
        return len(os.listdir(folder / "sweep.zarr.part" / "failed" / "c"))
    except FileNotFoundError:
        return 0


def until_blocks(folder: Path, count: int, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 60
    while blocks_done(folder) < count and process.poll() is None:
        assert time.monotonic() < end, "the sweep does not move"
        time.sleep(0.005)


SLOW = (
    SWEEP.replace("steps = 200", "steps = 20000").replace("every = 2", "every = 100").replace("block = 5", "block = 1")
)


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    return contents(carried(tmp_path_factory.mktemp("slow"), SLOW))


def test_two_workers_one_of_them_killed(slow: dict[str, object], tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(SLOW)
    with command(tmp_path, "--workers", "2") as client:
        until_blocks(tmp_path, 3, client)
        hands = children(client.pid)
        os.kill(hands[0], signal.SIGKILL)
        out, err = client.communicate(timeout=120)
    assert client.returncode == 0, err
    assert json.loads(out)["failed"] == 0
    assert [p.name for p in tmp_path.iterdir() if p.suffix != ".toml"] == ["sweep.zarr"]
    assert contents(tmp_path / "sweep.zarr") == slow


def test_a_killed_client_and_a_signal(slow: dict[str, object], tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(SLOW)
    with command(tmp_path, "--workers", "0") as client:
        until_blocks(tmp_path, 3, client)
    kept = blocks_done(tmp_path)
    assert 3 <= kept < 24
    with command(tmp_path, "--workers", "0") as client:
        until_blocks(tmp_path, kept + 2, client)
        client.terminate()
        _, err = client.communicate(timeout=60)
    assert client.returncode == 128 + signal.SIGTERM
    assert "the same command resumes" in err
    assert blocks_done(tmp_path) >= kept + 2
    assert contents(carried(tmp_path, SLOW)) == slow


@pytest.mark.parametrize("written", [0, 1])
def test_a_sweep_killed_at_its_first_files_is_begun_again(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: int
) -> None:
    """Just before, and just after, the metadata that make it count: its times are there, or it is made anew."""
    original = archive.replace_file

    def killed(path: Path, data: bytes, durable: bool = False) -> None:
        if path.name == "zarr.json" and path.parent.suffix == ".part":
            if written:
                original(path, data, durable)
            raise KeyboardInterrupt
        original(path, data, durable)

    with monkeypatch.context() as patch:
        patch.setattr(archive, "replace_file", killed)
        with pytest.raises(KeyboardInterrupt):
            carried(tmp_path)
    assert contents(carried(tmp_path)) == contents(whole)


def apart(begun: Any, folder: Path) -> None:
    begun.set()
    carried(folder)


def test_killed_at_random_moments(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT)  # where the process to be killed finds this file
    context = multiprocessing.get_context("forkserver")  # this process may hold threads, which no fork survives
    context.set_forkserver_preload(["kreisel.sweeps.sweep", "kreisel.storage.run_archive", "llvmlite"])
    begun = time.monotonic()
    carried(tmp_path / "timed")
    took, expected, moments, killed, trial = time.monotonic() - begun, contents(whole), random.Random(1), 0, 0
    while killed < KILLS:
        folder, trial = tmp_path / str(trial), trial + 1
        assert trial < 10 * KILLS
        for _ in range(3):  # the same sweep up to three times
            event = context.Event()
            child = context.Process(target=apart, args=(event, folder), daemon=True)
            child.start()
            try:
                assert event.wait(60)
                time.sleep(moments.uniform(0, took))
                killed += child.is_alive()
            finally:
                child.kill()
                child.join(60)
            assert not child.is_alive()
            part = folder / "sweep.zarr.part"
            if (part / "failed" / "c").exists():
                kept = kr.open_run(part)
                there = kept.failed.values != 255
                assert np.isfinite(kept.energy_drift.values[there]).all()
        assert contents(carried(folder)) == expected
        assert [p.name for p in folder.iterdir() if p.suffix != ".toml"] == ["sweep.zarr"]
        shutil.rmtree(folder)


def children(process: int) -> list[int]:
    """Worker processes of Dask below a process."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            line = (folder / "cmdline").read_bytes()
        except (OSError, IndexError, ValueError):
            continue
        if parent == process and b"spawn_main" in line:
            found.append(int(folder.name))
    return found


@LONG
def test_a_killed_scheduler(slow: dict[str, object], tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(SLOW)
    start = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    start += ["--no-dashboard", "--scheduler-file", "scheduler.json"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = subprocess.Popen(start, cwd=tmp_path, **quiet)
    file = tmp_path / "scheduler.json"
    end = time.monotonic() + 60
    while not file.exists() or not file.read_text().endswith("}"):
        assert time.monotonic() < end
        time.sleep(0.05)
    address = json.loads(file.read_text())["address"]
    hand = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-dashboard",
        "--no-nanny",
    ]
    worker = subprocess.Popen([*hand, "--death-timeout", "5"], cwd=tmp_path, **quiet)
    try:
        with command(tmp_path, "--scheduler", address) as client:
            until_blocks(tmp_path, 2, client)
            scheduler.kill()
            scheduler.wait(60)
            _, err = client.communicate(timeout=90)
        assert client.returncode == 2, err
        assert "went away" in err
        assert "Traceback" not in err
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait(60)
    assert 2 <= blocks_done(tmp_path) < 24
    assert contents(carried(tmp_path, SLOW)) == slow
    with command(tmp_path, "--overwrite", "--scheduler", address) as nobody:
        assert "No Dask scheduler answers" in nobody.communicate(timeout=60)[1]
    assert nobody.returncode == 2


def test_damage_is_named(whole: Path, tmp_path: Path) -> None:
    path = carried(tmp_path / "s")
    chunk = path / "energy_drift" / "c" / "2"
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(bytes(data))
    (path / "a" / "c" / "0" / "3" / "0").unlink()
    faults = check_archive(path)[1]
    assert sorted(fault.split(":")[0].split(",")[0] for fault in faults) == [
        "a cannot be read in lanes 15 to 19",
        "energy_drift cannot be read in lanes 10 to 14",
    ]
    assert check_archive(whole)[1] == []


BAD = [
    ('name = "lagrange-top"', 'name = "lagrange-tap"', "Did you mean 'lagrange-top'"),
    ("draws = 6", "draws = 0", "draws must be"),
    ("draws = 6", "draws = 10_000_000", "at most 10,000,000"),
    ("draws = 6", "", "draws must be"),
    ("rng = 7", "", "need a seed"),
    ("a = [0.6, 0.0, 0.8]", "a = 2020-01-01", "state.a: expected values, words and lists.*Write dates as text"),
    ("rng = 7", "rng = -1", "need a seed"),
    ("rng = 7", "rng = 1.5", "need a seed"),
    ("block = 5", "block = 0", "block in"),
    ("block = 5", "blok = 5", "Did you mean 'block'"),
    ('save = ["drift", "extremes", "frequencies", "trajectories"]', 'save = ["drft"]', "save in"),
    ('save = ["drift", "extremes", "frequencies", "trajectories"]', 'save = "drift"', "save in"),
    ("{ from = 0.5, to = 1.5, count = 4 }", "{ from = 0.5, to = 1.5 }", "a range needs"),
    ("{ from = 0.5, to = 1.5, count = 4 }", "{ from = 0.5, to = 1.5, count = 1e3 }", "count must be"),
    ("{ from = 0.5, to = 1.5, count = 4 }", "{ from = 0.5, to = [1.5, 2], count = 4 }", "the same shape"),
    ("{ from = 0.5, to = 1.5, count = 4 }", '{ from = -1, to = 1, count = 4, spacing = "log" }', "positive"),
    ("{ from = 0.5, to = 1.5, count = 4 }", "[]", "needs a list or"),
    ("{ from = 0.5, to = 1.5, count = 4 }", "[1, [2]]", "the same shape"),
    ("{ from = 0.5, to = 1.5, count = 4 }", '["a", "b"]', "must be numeric"),
    ("{ from = 0.5, to = 1.5, count = 4 }", "[nan]", "finite"),
    ("{ from = 0.5, to = 1.5, count = 4 }", "[0.0]", "No lane.*must not be 0"),
    ("{ uniform = [1.0, 2.0] }", "{ uniform = [1.0] }", "needs 2 values"),
    ("{ uniform = [1.0, 2.0] }", "{ unifrm = [1.0, 2.0] }", "must be one of"),
    ("{ uniform = [1.0, 2.0] }", "{ loguniform = [-1.0, 2.0] }", "positive"),
    ("{ uniform = [1.0, 2.0] }", "{ sphere = 1.0 }", "draws a vector"),
    ('"state.m[2]"', '"state.m[3]"', "names no entry"),
    ('"state.m[2]"', '"state.m[2,1]"', "names no entry"),
    ('"state.m[2]"', '"state.q[2]"', "has no q"),
    ('"state.m[2]"', '"stat.m[2]"', "Did you mean 'state'"),
    ('"state.m[2]"', '"run.dt"', "cannot be drawn"),
    ('"state.m[2]"', '"system.alpha"', "varies twice"),
    ("steps = 200", "steps = 20", "Frequencies need"),
    ("steps = 200", "steps = 100_000_000", "MiB at once"),
    ("steps = 200", 'steps = "many"', "steps must be an integer from 1 to"),
    ("steps = 200", "steps = 200\nmethod = []", "method: expected a name"),
    ("steps = 200", "steps = 200\nmethod = 'sures'", "Did you mean 'suris'"),
    ("dt = 0.05", "", r"\[run\] needs dt"),
    ('path = "sweep.zarr"', 'path = "sweep.zarr"\nfigure = "a.png"', "no figure"),
    ("m = [0.1, 0.2, 1.5]", "m = [[0.1, 0.2, 1.5], [0.1, 0.2, 1.5]]", "names no entry"),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0.8]", "shapes|n = 3"),
    ("[sweep.grid]", "[sweep.gird]", "Did you mean 'grid'"),
]


@pytest.mark.parametrize(("old", "new", "words"), BAD, ids=[new or f"no {old}" for old, new, _ in BAD])
def test_bad_sweeps(old: str, new: str, words: str, tmp_path: Path) -> None:
    assert old in SWEEP
    with pytest.raises(kr.InputError, match=words):
        carried(tmp_path, SWEEP.replace(old, new))
    assert [p.name for p in tmp_path.iterdir()] == ["sweep.toml"]


def test_bad_calls_of_sweeps(whole: Path, tmp_path: Path) -> None:
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
    alphas = {"system.alpha": [1.0]}
    vary = {"design": kr.Design(together=alphas)}
    options: dict[str, Any] = {"path": tmp_path / "s.zarr", "workers": 0, **vary, **OPTIONS}
    wrongs: list[tuple[dict[str, Any], str]] = [
        ({"design": kr.Design()}, "Nothing varies"),
        ({"design": {"grid": alphas}}, r"expected a kr\.Design"),
        ({"design": None}, r"expected a kr\.Design"),
        ({"workers": -1}, "workers, a number of processes must be"),
        ({"workers": 1, "scheduler": "tcp://127.0.0.1:1"}, "A scheduler has workers"),
        ({"design": kr.Design(together=alphas, rng=1)}, "nothing is drawn"),
        ({"design": kr.Design(together=alphas, draws=1)}, "nothing is drawn"),
        ({"design": kr.Design(together={**alphas, "state.m[0]": [1.0, 2.0]})}, "the same number of values"),
        ({"design": kr.Design(together={"system.alpha": [object()]})}, "system.alpha: expected values, words"),
        ({"memory": 0}, "memory in"),
        ({"method": ["suris"]}, "method: expected a name"),
    ]
    for wrong, words in wrongs:
        with pytest.raises(kr.InputError, match=words):
            kr.sweep(top, x0, **{**options, **wrong})
    with pytest.raises(kr.InputError, match="grid: expected a dict"):
        kr.Design(grid=3)
    with pytest.raises(kr.InputError, match=r"is a sweep.*that began it resumes it"):
        kr.resume(whole, extend=10)
    with pytest.raises(kr.InputError, match="drift of each lane"):
        kr.drift(kr.open_run(whole))
    with pytest.raises(kr.InputError, match=r"the result of kr\.sweep"):
        kr.failures(kr.simulate(top, x0, **OPTIONS))
    assert list(tmp_path.iterdir()) == []
    shutil.copytree(whole, tmp_path / "s.zarr.part")
    with pytest.raises(kr.InputError, match=r"is there: the `kreisel sweep` or kr\.sweep that began it resumes it"):
        kr.open_run(tmp_path / "s.zarr")


@LONG
def test_a_system_of_ones_own(tmp_path: Path) -> None:
    own = ROOT / "examples" / "own_lagrangian.py"
    (tmp_path / "own.py").write_text(own.read_text())
    text = (own.parent / "own-lagrangian.toml").read_text().replace("own_lagrangian.py", "own.py")
    text = text.replace("10_000", "20") + "\n[sweep.list]\nsystem.c = [0.5, 1.0]\n"
    run = kr.open_run(carried(tmp_path, text)).load()
    assert run.failed.values.tolist() == [0, 0]
    assert run.energy_drift.values[0] != run.energy_drift.values[1]
    (tmp_path / "own.py").write_text(own.read_text() + "\n# changed\n")
    with pytest.raises(kr.InputError, match="another sweep"):
        carried(tmp_path, text)


def test_settings_that_are_lists(tmp_path: Path) -> None:
    with pytest.raises(kr.InputError, match="expected a number or a name for each lane"):
        kr.sweep(
            kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)},
            kr.Design(grid={"run.steps": [[1, 2], [3, 4]]}), dt=0.1, steps=4, workers=0, path=tmp_path / "s.zarr",
        )  # fmt: skip


def test_a_spin_that_varies_needs_the_arguments_of_a_state(tmp_path: Path) -> None:
    body, spins = kr.physical.FreeBody((1, 2, 2.5)), [(0, 0, 1), (0, 0.1, 1)]
    with pytest.raises(kr.InputError, match=r"expected momentum, attitude, got 'spin'.* give x0 as a dict"):
        kr.sweep(body, body.state(spins[0]), over={"spin": spins}, t_end=1, workers=0, path=tmp_path / "s.zarr")
