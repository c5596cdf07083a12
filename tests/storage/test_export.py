"""Exports hold the same numbers, and take their name when they are whole."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import xarray as xr

import kreisel as kr
from kreisel.runs import integration as runs
from kreisel.storage import exporting

OPTIONS = {"dt": 0.1, "steps": 100, "every": 3}


@pytest.fixture
def archive(top: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(runs, "BLOCK_BYTES", 6 * 8 * 14)
    monkeypatch.setattr(exporting, "NUMBERS_AT_ONCE", 100)  # several blocks
    state = top.state(m=[[0.1, 0.2, 1.5], [0.3, 0.2, 1.5]], a=(0.6, 0, 0.8))
    kr.simulate(top, state, orientation=(1, 0, 0, 0), path=tmp_path / "run.zarr", **OPTIONS)
    return tmp_path / "run.zarr"


@pytest.mark.parametrize("name", ["run.nc", "run.h5"])
def test_netcdf_is_the_dataset(name: str, archive: Path, tmp_path: Path) -> None:
    kr.export(archive, tmp_path / name)
    run = kr.open_run(archive)
    with xr.open_dataset(tmp_path / name, engine="h5netcdf") as back:
        assert set(back.variables) == set(run.variables)
        for key in run.variables:
            assert (back[key].values == run[key].values).all()
            assert back[key].dims == run[key].dims
            assert all(np.all(back[key].attrs[k] == v) for k, v in run[key].attrs.items())
        assert all(back.attrs[k] == v for k, v in run.attrs.items())
    assert not list(tmp_path.glob(".*"))


def test_csv_has_the_rows_of_parquet(archive: Path, tmp_path: Path) -> None:
    for kind in ("csv", "parquet"):
        kr.export(archive, tmp_path / f"run.{kind}")
    text, table = (
        pd.read_csv(tmp_path / "run.csv", dtype=str),  # pandas reads the last place as it likes
        pd.read_parquet(tmp_path / "run.parquet"),
    )
    assert next(iter(text.columns)) == "time"
    assert set(text.columns) == set(table.columns)
    for name in table.columns:
        assert [float(value) for value in text[name]] == table[name].tolist()
    with pytest.raises(kr.InputError, match="unchanged"):
        kr.export(archive, tmp_path / "run.csv", overwrite=True)


def test_parquet_has_a_row_for_each_time_and_lane(archive: Path, tmp_path: Path) -> None:
    kr.export(archive, tmp_path / "run.parquet")
    run, table = kr.open_run(archive), pd.read_parquet(tmp_path / "run.parquet")
    assert len(table) == run.sizes["time"] * 2
    assert (table["m[2]"].values.reshape(-1, 2) == run.m.values[..., 2]).all()
    assert (table["time"].values.reshape(-1, 2)[:, 1] == run.time.values).all()
    assert (table["lane"].values.reshape(-1, 2) == [0, 1]).all()
    assert (table["energy"].values.reshape(-1, 2) == run.energy.values).all()
    attrs = json.loads(pq.read_schema(tmp_path / "run.parquet").metadata[b"kreisel"])
    assert attrs["dt"] == 0.1


@pytest.mark.parametrize("save", [["drift", "extremes"], ["drift", "trajectories"]])
def test_a_sweep(save: list[str], top: object, x0: object, tmp_path: Path) -> None:
    design = kr.Design(together={"system.alpha": [1.0, 0.0, 1.2], "state.m[2]": [1.0, 1.5, 2.0]})
    run = kr.sweep(top, x0, design, path=tmp_path / "s.zarr", workers=0, save=save, **OPTIONS)
    kr.export(tmp_path / "s.zarr", tmp_path / "s.nc")
    kr.export(run, tmp_path / "s.parquet")
    with xr.open_dataset(tmp_path / "s.nc", engine="h5netcdf", mask_and_scale=False) as back:
        for key in run.variables:
            assert np.array_equal(back[key].values, run[key].values, equal_nan=True)
    table = pd.read_parquet(tmp_path / "s.parquet")
    first = table[table.lane == 1]
    assert first["message"].str.contains("must not be 0").all()
    assert (first["failed"] == 1).all()
    assert (table[table.lane == 2]["state.m[2]"] == 2.0).all()
    assert (table[table.lane == 2]["energy_drift"] == float(run.energy_drift[2])).all()


def test_one_state_without_lanes(top: object, x0: object, tmp_path: Path) -> None:
    run = kr.simulate(top, x0, **OPTIONS)
    kr.export(run, tmp_path / "run.parquet")
    assert (pd.read_parquet(tmp_path / "run.parquet")["a[0]"].values == run.a.values[:, 0]).all()


def test_states_at_one_time(top: object, tmp_path: Path) -> None:
    run = kr.simulate(top, top.state(m=[[0.1, 0.2, 1.5], [0.3, 0.2, 1.5]], a=(0.6, 0, 0.8)), **OPTIONS)
    for number, one in enumerate((run.isel(time=-1), run.isel(lane=1), run.isel(time=-1, lane=1))):
        kr.export(one, tmp_path / f"{number}.nc")
        with xr.open_dataset(tmp_path / f"{number}.nc", engine="h5netcdf") as back:
            assert all(np.array_equal(back[key].values, one[key].values) for key in one.variables)
        kr.export(one, tmp_path / f"{number}.parquet")
        table = pd.read_parquet(tmp_path / f"{number}.parquet")
        assert np.array_equal(table["a[2]"].values, one.a.values[..., 2].ravel())
        assert np.array_equal(table["time"].values, np.broadcast_to(one.time.values, len(table)))
        assert set(table["lane"]) == set(np.atleast_1d(one.lane.values))
    kr.export(run.isel(time=slice(0, 0)), tmp_path / "none.parquet")
    table = pd.read_parquet(tmp_path / "none.parquet")
    assert (len(table), "a[2]" in table) == (0, True)


def test_one_lane_of_a_sweep(top: object, x0: object, tmp_path: Path) -> None:
    run = kr.sweep(
        top, x0, kr.Design(together={"system.alpha": [1.0, 0.0]}), path=tmp_path / "s.zarr", workers=0, **OPTIONS
    )
    kr.export(run.isel(lane=1), tmp_path / "s.parquet")
    table = pd.read_parquet(tmp_path / "s.parquet")
    assert "must not be 0" in table["message"][0]
    assert len(table) == 1


def test_what_the_analyses_return(top: object, x0: object, tmp_path: Path) -> None:
    run = kr.simulate(top, x0, **OPTIONS)
    events, spectrum = kr.analysis.events(run, "a[0]"), kr.analysis.power_spectrum(run, "a[0]")
    for name, data in (("events", events), ("spectrum", spectrum)):
        for end in ("nc", "parquet"):
            kr.export(data, tmp_path / f"{name}.{end}")
    with xr.open_dataset(tmp_path / "events.nc", engine="h5netcdf") as back:
        assert (back.rising.values == events.rising.values).all()
        assert (back.a.values == events.a.values).all()
    table = pd.read_parquet(tmp_path / "events.parquet")
    assert (table["time"].values == events.time.values).all()
    assert (table["a[1]"].values == events.a.values[:, 1]).all()
    assert (pd.read_parquet(tmp_path / "spectrum.parquet")["frequency"] == spectrum.frequency.values).all()


def test_variables_of_any_kind(tmp_path: Path) -> None:
    run = xr.Dataset({"so": ("lane", [True, False])}, {"lane": ["one", "zwö"]})
    for end in ("nc", "parquet"):
        kr.export(run, tmp_path / f"run.{end}")
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as back:
        assert (back.so.values.tolist(), back.lane.values.tolist()) == ([1, 0], ["one", "zwö"])
    assert pd.read_parquet(tmp_path / "run.parquet")["lane"].tolist() == ["one", "zwö"]
    for values, name in ((np.array(["2020"], dtype="M8[ns]"), "day"), (np.array([{}]), "day"), (np.ones(1), "a/b")):
        with pytest.raises(kr.InputError, match=f"expected variables of values or text.* got '{name}'"):
            kr.export(xr.Dataset({name: ("time", values)}), tmp_path / "no.nc")
    for values in (np.array([1j]), np.array([1, "x"], dtype=object)):
        with pytest.raises(kr.RunError, match="type that the format cannot hold"):
            kr.export(xr.Dataset({"z": ("time", values)}), tmp_path / "no.parquet")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.nc", "run.parquet"]


def test_attributes_of_any_kind(archive: Path, tmp_path: Path) -> None:
    run = kr.open_run(archive)
    run.attrs |= {
        "words": ["a", "b"],
        "table": {"x": 1},
        "nothing": None,
        "large": 10**30,
        "many": [1, 2.5],
        "so": True,
        "exactly": Decimal("0.1"),
        "array": np.array([1.0, 2.0]),
        "matrix": np.eye(2),
        "keys": {(1, 2): {3}},
        "half": "a\ud800\0b",
        5: 6,
    }
    kr.export(run, tmp_path / "run.nc")
    kr.export(run, tmp_path / "run.parquet")
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as back:
        attrs = back.attrs
    assert (attrs["words"], attrs["table"], attrs["nothing"]) == ('["a", "b"]', '{"x": 1}', "null")
    assert (attrs["large"], attrs["many"].tolist(), attrs["so"]) == (str(10**30), [1, 2.5], 1)
    assert (attrs["exactly"], attrs["array"].tolist(), attrs["matrix"]) == ('"0.1"', [1, 2], "[[1.0, 0.0], [0.0, 1.0]]")
    assert (attrs["keys"], attrs["half"], attrs["5"]) == ('"{(1, 2): {3}}"', "a\\ud800\\x00b", 6)
    attrs = json.loads(pq.read_schema(tmp_path / "run.parquet").metadata[b"kreisel"])
    assert (attrs["exactly"], attrs["array"], attrs["keys"]) == ("0.1", [1, 2], "{(1, 2): {3}}")


def test_an_archive_does_not_get_the_name_of_an_export(archive: Path, tmp_path: Path) -> None:
    """A run or a sweep at a path such as run.nc is refused, with a call that writes the file."""
    top, design = kr.LagrangeTop(p=(0, 0, 1)), kr.Design(grid={"state.m[0]": (0.1, 0.2)})
    start = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    for name in ("t.nc", "t.H5", "t.parquet", "t.csv", "t.npz"):
        with pytest.raises(kr.InputError, match="path: expected the name of a Zarr archive"):
            kr.simulate(top, start, dt=0.1, steps=4, path=tmp_path / name)
    with pytest.raises(kr.InputError, match=r"kr\.export\('.*t\.zarr', '.*t\.nc'\)"):
        kr.sweep(top, start, design, dt=0.1, steps=4, path=tmp_path / "t.nc", workers=0)
    assert not [*tmp_path.glob("t.*")]


def test_what_cannot_be_exported(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(kr.InputError, match="must end in"):
        kr.export(archive, tmp_path / "run.txt")
    (tmp_path / "run.nc").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(kr.InputError, match="a file that Kreisel wrote"):
            kr.export(archive, tmp_path / "run.nc", overwrite=overwrite)
    assert (tmp_path / "run.nc").read_text() == "mine"
    for name in ("own.nc", "own.parquet"):
        for overwrite in (False, True):
            kr.export(archive, tmp_path / name, overwrite=overwrite)
        with pytest.raises(kr.InputError, match="exists already"):
            kr.export(archive, tmp_path / name)
    with pytest.raises(kr.InputError, match="no archive"):
        kr.export(tmp_path / "none.zarr", tmp_path / "none.nc")
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(kr.RunError, match="could not be written"):
        kr.export(archive, tmp_path / "file" / "run.nc")
    chunk = next(p for p in (archive / "a" / "c").rglob("*") if p.is_file())
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(bytes(data))
    for name in ("broken.nc", "broken.parquet"):
        with pytest.raises(kr.InputError, match="was changed after the run"):
            kr.export(archive, tmp_path / name)
        assert not (tmp_path / name).exists()
    assert not list(tmp_path.glob(".*"))


def test_arrays_for_learning(archive: Path, tmp_path: Path) -> None:
    """NumPy reads the file without pickle; arrays are copies, of the Dataset and of the archive alike."""
    run = kr.open_run(archive)
    arrays = kr.to_numpy(run)
    assert arrays.keys() == set(map(str, run.variables)) and arrays["m"].shape == (35, 2, 3)
    arrays["m"][0] = 7.0
    assert arrays["m"].flags.c_contiguous and not (run.m[0] == 7.0).any()
    kr.export(archive, tmp_path / "run.npz")
    kr.export(archive, tmp_path / "run.npz", overwrite=True)
    with np.load(tmp_path / "run.npz", allow_pickle=False) as back:
        assert json.loads(str(back["kreisel_attributes"]))["system"] == "lagrange-top"
        assert set(back.files) == {*kr.to_numpy(archive), "kreisel_attributes"}
        for name in arrays:
            assert back[name].tobytes() == np.ascontiguousarray(run[name].values).tobytes()
    np.savez(tmp_path / "mine.npz", a=np.ones(3))
    with pytest.raises(kr.InputError, match="unchanged"):
        kr.export(archive, tmp_path / "mine.npz", overwrite=True)
    with pytest.raises(kr.InputError, match="variables of values or text"):
        kr.export(run.assign(odd=("time", np.array([object()] * 35))), tmp_path / "odd.npz")


def test_arrays_of_a_body_are_in_si() -> None:
    """J of the FreeBody is scaled by its unit of momentum; along the user's axes M = I Omega, in kg m^2/s."""
    body = kr.physical.FreeBody(((0.11, 0.02, -0.01), (0.02, 0.13, 0.015), (-0.01, 0.015, 0.15)), time_unit=3.0)
    run = kr.simulate(
        body.model(), body.state((0.3, 0.5, 0.9)), dt=body.dt(0.1), steps=3, orientation=body.orientation()
    )
    arrays = kr.to_numpy(run)
    np.testing.assert_allclose(arrays["time"], [0, 0.1, 0.2, 0.3], rtol=1e-12)
    np.testing.assert_allclose(arrays["M"][0], body.inertia @ (0.3, 0.5, 0.9), rtol=1e-12)
    np.testing.assert_allclose(arrays["Omega"][0], (0.3, 0.5, 0.9), rtol=1e-12)
    with pytest.raises(kr.InputError, match="path of an archive"):
        kr.to_numpy(3)


@pytest.mark.skipif(sys.platform == "win32", reason="no fork and no flock")
def test_a_terminated_export_leaves_nothing(top: object, x0: object, tmp_path: Path) -> None:
    kr.simulate(top, x0, path=tmp_path / "run.zarr", dt=0.05, steps=200_000)
    command = [sys.executable, "-m", "kreisel", "export", "run.zarr", "run.csv"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    for _ in range(600):
        if list(tmp_path.glob(".run-*.csv")):
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    assert process.returncode == 128 + signal.SIGTERM
    assert [path.name for path in tmp_path.iterdir()] == ["run.zarr"]
