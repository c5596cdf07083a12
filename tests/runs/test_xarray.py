"""A run is an xarray Dataset: what xarray does with it leaves a run, or something that is refused as one."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel.physical import FreeBody
from kreisel.viewer.scene import scene

TOP = kr.LagrangeTop(p=(0, 0, 1), alpha=0.6)
STATE = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
OPTIONS: dict[str, Any] = {"dt": 0.1, "steps": 40, "every": 2}
Change = Callable[[Any], Any]


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    return kr.simulate(TOP, STATE, orientation=(1, 0, 0, 0), **OPTIONS)


@pytest.fixture(scope="module", params=["plain", "lanes", "body", "archive"])
def any_run(request: pytest.FixtureRequest, run: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    if request.param == "lanes":
        return kr.simulate(TOP, {"m": [(0.1, 0.2, 1.5), (0.2, 0, 1)], "a": (0.6, 0, 0.8)}, **OPTIONS)
    if request.param == "body":
        body = FreeBody([[0.5, 0.1, 0.0], [0.1, 0.4, 0.05], [0.0, 0.05, 0.3]])
        return kr.simulate(body.model(), body.state((1, 2, 3)), orientation=(1, 0, 0, 0), **OPTIONS)
    if request.param == "archive":
        return kr.simulate(TOP, STATE, path=tmp_path_factory.mktemp("x") / "run.zarr", **OPTIONS)
    return run


def as_netcdf(folder: Path, engine: str) -> Change:
    def change(run: xr.Dataset) -> xr.Dataset:
        run.to_netcdf(folder / f"{engine}.nc", engine=engine)
        with xr.open_dataset(folder / f"{engine}.nc", engine=engine) as back:
            return back.load()

    return change


def as_zarr(folder: Path, version: Literal[2, 3]) -> Change:
    def change(run: xr.Dataset) -> xr.Dataset:
        run.to_zarr(folder / f"{version}.zarr", mode="w", consolidated=False, zarr_format=version)
        return xr.open_zarr(folder / f"{version}.zarr", consolidated=False)

    return change


WHOLE: dict[str, Change] = {
    "pickle": lambda run: pickle.loads(pickle.dumps(run)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "concat": lambda run: xr.concat([run.isel(time=slice(0, 9)), run.isel(time=slice(9, None))], "time"),
    "combine": lambda run: xr.combine_by_coords([run.isel(time=slice(0, 9)), run.isel(time=slice(9, None))]),
    "merge": lambda run: xr.merge([run, run["energy"].rename("other")]).drop_vars("other"),
    "assign": lambda run: run.assign(twice=2 * run["energy"]).drop_vars("twice"),
    "chunk": lambda run: run.chunk({"time": 7}),
    "where": lambda run: run.where(run["time"] >= 0, drop=True),
    "groupby": lambda run: run.groupby("time").map(lambda row: row),
    "reversed twice": lambda run: run.isel(time=slice(None, None, -1)).isel(time=slice(None, None, -1)),
    "dict": lambda run: xr.Dataset.from_dict(run.to_dict()),
}
PART: dict[str, Change] = {
    "sel": lambda run: run.sel(time=slice(0.5, 3)),
    "isel": lambda run: run.isel(time=slice(3, 15, 2)),
    "thin": lambda run: run.thin(time=3),
    "reversed": lambda run: run.isel(time=slice(None, None, -1)),
}
NONE: dict[str, Change] = {
    "twice": lambda run: 2 * run,
    "sum": lambda run: run + run,
    "minus": lambda run: -run,
    "cumsum": lambda run: run.cumsum("time").assign_coords(time=run["time"]),
    "diff": lambda run: run.diff("time"),
    "derivative": lambda run: run.differentiate("time"),
    "interpolated": lambda run: run.interp(time=[0.13, 0.37]),
    "averaged": lambda run: run.coarsen(time=3, boundary="trim").mean(),
    "mean": lambda run: run.mean("time"),
    "single precision": lambda run: run.astype("f4").assign_coords(time=run["time"]),
    "transposed": lambda run: run.transpose(..., "time"),
    "renamed": lambda run: run.rename(time="t"),
    "stacked": lambda run: run.stack(row=("time", "axis")),
    "broadcast": lambda run: run.broadcast_like(run),
    "lanes in front": lambda run: xr.concat([run, run], "bodies").rename(bodies="lane").transpose("lane", ...),
}


def same_table(one: xr.Dataset, two: xr.Dataset) -> bool:
    tables = [kr.drift(each).sort_index() for each in (one, two)]  # NetCDF-3 has its variables in another order
    return bool(tables[0].equals(tables[1]))


def test_copies_are_the_run(any_run: xr.Dataset, tmp_path: Path) -> None:
    files = {engine: as_netcdf(tmp_path, engine) for engine in ("h5netcdf", "scipy")}
    files |= {f"zarr {version}": as_zarr(tmp_path, version) for version in (2, 3)}
    for name, change in (WHOLE | files).items():
        made = change(any_run)
        for key in any_run.variables:
            assert np.array_equal(made[key].values, any_run[key].values), name
        assert same_table(made, any_run), name
        assert np.array_equal(
            kr.analysis.angular_velocity(made, frame="body" if "M" in made else "space").values,
            kr.analysis.angular_velocity(any_run, frame="body" if "M" in made else "space").values,
        )


def test_parts_are_runs(any_run: xr.Dataset) -> None:
    for name, change in PART.items():
        assert not kr.drift(change(any_run))["broken"].any(), name


@pytest.mark.parametrize("name", NONE)
def test_other_numbers_are_no_run(name: str, run: xr.Dataset) -> None:
    made = NONE[name](run)
    for read in (kr.drift, kr.plot, kr.view, kr.analysis.angular_velocity, kr.tangent):
        with pytest.raises(kr.InputError):
            read(made)


def test_pictures_of_copies(run: xr.Dataset, tmp_path: Path) -> None:
    made = as_netcdf(tmp_path, "h5netcdf")(run)
    assert len(kr.plot(made).axes) == len(kr.plot(run).axes)
    assert scene(made) == scene(run)


def test_variables_are_numbers(run: xr.Dataset) -> None:
    """What the message offers."""
    with pytest.raises(kr.InputError, match=r"2 \* run\.energy"):
        kr.drift(2 * run)
    assert np.array_equal((2 * run.energy).values, 2 * run.energy.values)


def test_a_copy_by_zarr_is_no_archive(run: xr.Dataset, tmp_path: Path) -> None:
    as_zarr(tmp_path, 3)(run)
    with pytest.raises(kr.InputError, match=r"xr\.open_zarr opens it"):
        kr.open_run(tmp_path / "3.zarr")


@pytest.mark.parametrize(
    "change", [lambda run: run.isel(time=3), lambda run: run.isel(time=slice(3, 9)), lambda run: run.chunk({"time": 7})]
)
def test_a_part_of_an_archive_is_written_by_xarray(change: Change, tmp_path: Path) -> None:
    """It had the chunks of the archive."""
    part = change(kr.simulate(TOP, STATE, path=tmp_path / "run.zarr", **OPTIONS))
    assert as_zarr(tmp_path, 3)(part).identical(part)


def test_a_sweep_is_written_by_xarray(tmp_path: Path) -> None:
    design = kr.Design(grid={"state.m[2]": [1.0, 1.5]})
    swept = kr.sweep(TOP, STATE, design, path=tmp_path / "s.zarr", workers=0, dt=0.1, steps=4)
    for change in (as_netcdf(tmp_path, "h5netcdf"), as_zarr(tmp_path, 2)):
        assert np.array_equal(change(swept)["energy_drift"].values, swept["energy_drift"].values)


def of_xarray(run: xr.Dataset) -> xr.Dataset:
    """The Dataset of the same variables by the constructor of xarray."""
    data = {name: (v.dims, v.values, v.attrs) for name, v in run.data_vars.items()}
    coords = {name: (v.dims, v.values, v.attrs) for name, v in run.coords.items()}
    return xr.Dataset(data, coords, run.attrs)


def test_a_run_is_the_dataset_that_xarray_makes(any_run: xr.Dataset) -> None:
    """Kreisel puts it together without the checks of xarray, which cost as much as a hundred steps."""
    moment = kr.at(TOP, STATE, 3.7)
    lanes = kr.at(TOP, {"m": [(0.1, 0.2, 1.5), (0.2, 0, 1)], "a": (0.6, 0, 0.8)}, [1.0, 2.0])
    for made in (any_run, moment, kr.at(TOP, STATE, [1.0, 3.7]), lanes):
        again = of_xarray(made)
        xr.testing.assert_identical(made, again)
        assert [*made.xindexes] == [*again.xindexes] and made.sizes == again.sizes
        assert all(isinstance(v.data, np.ndarray) for v in made.load().variables.values() if v.dims != ("time",))
    moment.energy.values[()] = 2.0
    assert moment.energy == 2.0 and lanes.sel(time=2.0, lane=1).m.shape == (3,)
    first, second = (kr.at(TOP, STATE, [1.0, 3.7]) for _ in range(2))
    first.time.attrs["units"] = "h"
    assert second.time.attrs["units"] == "1"
