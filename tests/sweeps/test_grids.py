"""The grid of a sweep as dimensions: every value in its place, lazily, and back to lanes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from xarray.core import indexing

import kreisel as kr
from kreisel import cli
from kreisel.sweeps.grids import _Folded, by_lane

TOP = kr.LagrangeTop(p=(0, 0, 1))
DESIGN = kr.Design(
    grid={"state.m[2]": [1.0, 1.5, 2.0], "system.alpha": [0.5, 0.0]},
    random={"state.a": {"sphere": 1.0}},
    draws=2,
    rng=1,
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, xr.Dataset]:
    path = tmp_path_factory.mktemp("grids") / "s.zarr"
    settings = {"dt": 0.05, "steps": 40, "every": 4, "workers": 0, "save": ["drift", "extremes", "trajectories"]}
    return path, kr.sweep(TOP, TOP.state(m=(0, 0.1, 2), a=(0.6, 0, 0.8)), DESIGN, path=path, **settings)


def test_every_lane_in_its_place(made: tuple[Path, xr.Dataset]) -> None:
    path, grid = made
    lanes = kr.open_run(path)
    assert grid["a_max"].dims == ("state.m[2]", "system.alpha", "draw", "axis")
    assert grid["a"].dims == ("time", "state.m[2]", "system.alpha", "draw", "axis")
    assert grid.sizes["state.m[2]"] == 3 and grid["system.alpha"].values.tolist() == [0.5, 0.0]
    for name in lanes.data_vars:
        if name in grid.data_vars:
            axis = lanes[name].dims.index("lane")
            flat = grid[name].values.reshape(*lanes[name].shape[:axis], 12, *lanes[name].shape[axis + 1 :])
            np.testing.assert_array_equal(flat, lanes[name].values)
    one = grid.sel({"state.m[2]": 1.5, "system.alpha": 0.5}).isel(draw=1)
    assert float(lanes["state.m[2]"][int(one.lane)]) == 1.5
    np.testing.assert_array_equal(one.a.values, lanes.a.values[:, int(one.lane)])
    xr.testing.assert_equal(grid.drop_vars("message"), kr.open_run(path, grid=True).drop_vars("message"))


def test_failures_of_a_grid_are_by_lane(made: tuple[Path, xr.Dataset]) -> None:
    path, grid = made
    found, flat = kr.failures(grid), kr.failures(kr.open_run(path))
    assert found.index.tolist() == flat.index.tolist() == [2, 3, 6, 7, 10, 11]  # alpha = 0 is refused
    assert found["state.m[2]"].tolist() == flat["state.m[2]"].tolist() == [1.0, 1.0, 1.5, 1.5, 2.0, 2.0]
    assert by_lane(kr.open_run(path)).sizes["lane"] == 12


def test_lazy_indices_are_those_of_numpy() -> None:
    values = np.arange(4 * 24 * 2.0).reshape(4, 24, 2)
    folded = _Folded(xr.Variable(("time", "lane", "axis"), values), (2, 3, 4))
    lazy = xr.Variable(("time", "x", "y", "draw", "axis"), indexing.LazilyIndexedArray(folded))
    whole = values.reshape(4, 2, 3, 4, 2)
    rng = np.random.default_rng(1)
    for _ in range(60):
        key = tuple(
            [int(rng.integers(n)), slice(None), slice(None, None, -1), slice(1, n), rng.permutation(n)[: n - 1]][
                rng.integers(5)
            ]
            for n in whole.shape
        )
        expected = whole
        for axis, part in reversed(list(enumerate(key))):
            expected = expected[(slice(None),) * axis + (part,)]
        np.testing.assert_array_equal(lazy[key].values, expected)


def test_figure_and_page_of_a_sweep(
    made: tuple[Path, xr.Dataset], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path, grid = made
    monkeypatch.chdir(path.parent)

    def command(*words: str) -> tuple[int, str]:
        monkeypatch.setattr("sys.argv", ["kreisel", *words])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        printed = capsys.readouterr()
        return int(stopped.value.code or 0), printed.out + printed.err

    assert command("plot", "s.zarr")[0] == 0
    assert (path.parent / "s.png").stat().st_size > 10_000
    assert "--overwrite" in command("plot", "s.zarr")[1]
    assert command("plot", "s.zarr", "--overwrite", "--show", "a_max[2]")[0] == 0
    for words, said in (
        (["plot", "s.zarr", "-o", "x.png", "--show", "a_mx"], "Did you mean 'a_max'"),
        (["plot", "s.zarr", "-o", "x.png", "--show", "a_max"], "a_max[0]"),
        (["view", "s.zarr", "-o", "x.html", "--lane", "12"], "0 to 11"),
        (["view", "s.zarr", "-o", "x.html", "--lane", "2"], "alpha"),
        (["view", "s.zarr", "--serve"], "expected a run"),
    ):
        code, message = command(*words)
        assert code == 2 and said in message and "Traceback" not in message, message
    lane = int(grid.lane.isel(draw=1).sel({"state.m[2]": 1.5, "system.alpha": 0.5}))
    from kreisel.sweeps.sweep import one_lane

    np.testing.assert_array_equal(one_lane(path, lane).a.values[:, 0], kr.open_run(path).a.values[:, lane])
    assert not (path.parent / "x.png").exists() and not (path.parent / "x.html").exists()


def test_a_sweep_of_a_body_as_text(tmp_path: Path) -> None:
    """A row for each time and lane, with the units of the values and the axes of the extremes in the header."""
    body = kr.physical.FreeBody(inertia=((3, 0.2, 0), (0.2, 2, 0), (0, 0, 1.5)))
    over = {"spin[0]": [0.1, 0.2, 0.3], "mass": [1.0, 2.0]}
    settings = {"dt": 0.05, "steps": 4, "every": 2, "workers": 0, "save": ["extremes", "trajectories"]}
    run = kr.sweep(body, {"spin": (0.1, 0.2, 1)}, over=over, path=tmp_path / "s.zarr", **settings)
    assert run["state.spin[0]"].attrs["units"] == "rad/s" and run["body.mass"].attrs["units"] == "kg"
    assert [run[f"momentum_{end}"].attrs["long_name"][-9:] for end in ("max", "min")] == [" greatest", "te: least"]
    kr.export(run, tmp_path / "grid.csv")
    kr.export(tmp_path / "s.zarr", tmp_path / "lanes.csv")
    grid, lanes = (pd.read_csv(tmp_path / f"{name}.csv") for name in ("grid", "lanes"))
    pd.testing.assert_frame_equal(grid[lanes.columns], lanes)
    assert grid["lane"].tolist() == [*range(6)] * 3
    assert {"state.spin[0] (rad/s)", "body.mass (kg)", "momentum[0] (kg m^2/s)", "attitude[0]"} <= {*grid.columns}
    assert "momentum_max[0] (kg m^2/s, axes of the state)" in grid
    np.testing.assert_allclose(grid["momentum[0] (kg m^2/s)"][:6], 3 * grid["state.spin[0] (rad/s)"][:6] + 0.04)


def test_a_lane_of_a_sweep_of_satellites_has_no_orbit(tmp_path: Path) -> None:
    satellite = kr.physical.Satellite(inertia=(10, 8, 5), orbit=kr.physical.Orbit(7e6))
    settings = {"dt": 1.0, "steps": 4, "workers": 0, "save": ["trajectories"]}
    run = kr.sweep(satellite, {"spin": (0, 0, 0.1)}, over={"spin[0]": [0, 0.1]}, path=tmp_path / "s.zarr", **settings)
    with pytest.raises(kr.InputError, match="lanes of a sweep, which lack their orbits"):
        kr.export(run.isel({"state.spin[0]": 1}), tmp_path / "s.oem", epoch="2026-01-01")


def test_a_name_that_is_not_an_argument(tmp_path: Path) -> None:
    body = kr.physical.FreeBody(inertia=(3, 2, 1.5))
    with pytest.raises(kr.InputError, match=r"Usual cause: angular_velocity is not an argument\."):
        kr.sweep(body, {"spin": (0, 0, 1)}, over={"angular_velocity[0]": [0, 1]}, dt=0.1, steps=1, path=tmp_path / "s")


def test_over_accepts_the_names_of_a_design(tmp_path: Path) -> None:
    body, settings = kr.physical.FreeBody(inertia=(3, 2, 1.5)), {"dt": 0.1, "steps": 4, "workers": 0}
    runs = [
        kr.sweep(body, {"spin": (0, 0, 1)}, over={name: [0, 1]}, path=tmp_path / f"{i}.zarr", **settings)
        for i, name in enumerate(("spin[0]", "state.spin[0]"))
    ]
    assert runs[0].momentum_max.equals(runs[1].momentum_max)


@pytest.mark.parametrize("name", ["t_end", "t_start"])
def test_lanes_of_a_body_end_at_their_times(name: str, tmp_path: Path) -> None:
    """Each is a single run; all had the steps of the first."""
    body, start = kr.physical.HeavyBody(1.2, (0.0083, 0.0088, 0.006), (0, 0, 0.06)), {"angular_velocity": (1, 2, 60)}
    settings = {"dt": "2 ms", "t_start": 0.0, "t_end": 2.0, "impulses": {"time": "50 ms", "momentum": (0.01, 0, 0)}}
    if name == "t_start":
        del settings["impulses"]  # which count from 0
    over = {name: ["1 s", "1.5 s"]}
    run = kr.sweep(body, start, over=over, path=tmp_path / "s.zarr", every=10, workers=0, save=["extremes"], **settings)
    for lane, time in enumerate((1.0, 1.5)):
        alone = kr.simulate(body, body.state(**start), every=10, **settings | {name: time})
        assert abs(run.momentum_max.values[lane] - alone.momentum.max("time").values).max() < 1e-15


def test_rows_of_lanes_with_other_steps_are_equally_far_apart(tmp_path: Path) -> None:
    """every=60 ms are 60 steps of 1 ms and 30 of 2 ms; both had 60."""
    body, start = kr.physical.HeavyBody(1.2, (0.0083, 0.0088, 0.006), (0, 0, 0.06)), {"angular_velocity": (1, 2, 60)}
    settings = {"t_end": "0.48 s", "every": "60 ms"}
    over = {"dt": ["1 ms", "2 ms"]}
    run = kr.sweep(body, start, over=over, path=tmp_path / "s.zarr", workers=0, save=["extremes"], **settings)
    for lane, dt in enumerate(over["dt"]):
        alone = kr.simulate(body, body.state(**start), dt=dt, **settings)
        assert abs(run.momentum_max.values[lane] - alone.momentum.max("time").values).max() < 1e-15


def test_a_sweep_over_dates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """140 days, whose fields differ: labels are the dates, lanes are single runs."""
    from kreisel.physical import Orbit, Satellite

    monkeypatch.setattr("kreisel.sweeps.sweep.LOOKED_AT", 2)  # each, and each block, is recorded anew

    def bus(date: str) -> Satellite:
        return Satellite((0.02, 0.03, 0.04), Orbit.circular("500 km", epoch=date), magnetic_moment=(0.1, 0, 0))

    dates = [str(np.datetime64("2025-01-01 12:00:00") + np.timedelta64(k, "D")).replace("T", " ") for k in range(140)]
    settings = {"dt": 10.0, "steps": 3, "every": 3}
    over, path = {"orbit.epoch": dates}, tmp_path / "dates.zarr"
    run = kr.sweep(
        bus(dates[0]),
        {"spin": (0, 0, 0)},
        over=over,
        path=path,
        workers=0,
        block=70,
        save=["trajectories"],
        **settings,
    )
    assert run["body.orbit.epoch"].values.tolist() == dates
    flat = kr.open_run(path)["body.orbit.epoch"]
    words = flat.attrs["flag_meanings"].split()
    assert [words[i] for i in flat.values] == [date.replace(" ", "_") for date in dates]
    for lane in (0, 1, 139):
        body = bus(dates[lane])
        single = kr.simulate(body, body.state((0, 0, 0)), **settings)
        assert np.array_equal(run.momentum.isel({"time": -1, "body.orbit.epoch": lane}), single.momentum[-1])
    assert len(np.unique(run.momentum.isel(time=-1), axis=0)) == 140
