"""Archives: whole or under another name, open with xarray, checked, flat in memory."""

from __future__ import annotations

import errno
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

import kreisel as kr
from kreisel.runs import integration as runs
from kreisel.storage import archive, run_archive as archives
from kreisel.sweeps.sweep import check_archive

OPTIONS = {"dt": 0.1, "steps": 100, "every": 3}


def test_archive_is_the_dataset(top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "BLOCK_BYTES", 6 * 8 * 7)  # several chunks
    path = tmp_path / "deep" / "run.zarr"
    written = kr.simulate(top, x0, path=path, orientation=(1, 0, 0, 0), **OPTIONS)
    memory = kr.simulate(top, x0, orientation=(1, 0, 0, 0), **OPTIONS)
    plain = xr.open_zarr(path)  # as it is, without a warning
    for run in (written, plain):
        for name in memory.variables:
            assert (run[name].values == memory[name].values).all()
            assert run[name].dims == memory[name].dims
            assert run[name].attrs == memory[name].attrs
    same = {k: v for k, v in memory.attrs.items() if k != "created"}
    assert {k: v for k, v in plain.attrs.items() if k != "created"} == same
    assert plain.attrs["complete"] == 1
    assert not list(tmp_path.rglob("*.part"))
    assert json.loads(plain.attrs["parameters"])["p"] == [0.0, 0.0, 1.0]
    assert check_archive(path)[1] == []


def test_existing_archive_is_refused_and_kept(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    with pytest.raises(kr.InputError, match=r"exists already.*overwrite"):
        kr.simulate(top, x0, path=path, dt=0.2, steps=10)
    assert xr.open_zarr(path, consolidated=False).attrs["dt"] == 0.1
    kr.simulate(top, x0, path=path, dt=0.2, steps=10, overwrite=True)
    assert xr.open_zarr(path, consolidated=False).attrs["dt"] == 0.2
    assert [p.name for p in tmp_path.iterdir()] == ["run.zarr"]


def test_an_archive_of_a_later_format_is_named(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    file = path / "zarr.json"
    file.write_text(file.read_text().replace('"kreisel_format": 1', '"kreisel_format": 2'))
    for function in (kr.open_run, kr.resume):
        with pytest.raises(kr.InputError, match=r"format 2 of a later version of Kreisel, expected 1\. Update"):
            function(path)


def test_failed_overwrite_keeps_the_old_archive(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    huge = top.state(m=(1e200, 0, 0), a=(0.6, 0, 0.8))
    with np.errstate(all="ignore"), pytest.raises(kr.RunError, match="no longer finite"):
        kr.simulate(top, huge, path=path, overwrite=True, **OPTIONS)
    assert xr.open_zarr(path, consolidated=False).attrs["complete"] == 1
    assert not path.with_name("run.zarr.part").exists()


def fail_after(calls: int, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    original, count = zarr.Array.__setitem__, iter(range(10**6))

    def write(self: object, *args: object) -> None:
        if next(count) >= calls:
            raise OSError(number, "simulated")
        original(self, *args)

    monkeypatch.setattr(zarr.Array, "__setitem__", write)


def test_full_disk(top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "BLOCK_BYTES", 6 * 8 * 5)
    fail_after(40, errno.ENOSPC, monkeypatch)
    path = tmp_path / "run.zarr"
    with pytest.raises(kr.RunError, match="disk is full"):
        kr.simulate(top, x0, path=path, **OPTIONS)
    monkeypatch.undo()
    part = tmp_path / "run.zarr.part"
    assert not path.exists()
    kept = xr.open_zarr(part, consolidated=False)
    assert kept.attrs["complete"] == 0
    with pytest.raises(kr.InputError, match=r"interrupted"):
        kr.simulate(top, x0, path=path, **OPTIONS)
    assert "interrupted" in check_archive(part)[1][0]
    kr.simulate(top, x0, path=path, overwrite=True, **OPTIONS)
    assert not part.exists()


def test_rows_of_a_checkpoint_survive_a_full_disk_before_the_first_block(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kr.simulate(top, x0, path=tmp_path / "whole.zarr", **OPTIONS)
    fail_after(0, errno.ENOSPC, monkeypatch)
    with pytest.raises(kr.RunError, match=r"disk is full.*kreisel resume"):
        kr.simulate(top, x0, path=tmp_path / "run.zarr", **OPTIONS)
    monkeypatch.undo()
    resumed, whole = kr.resume(tmp_path / "run.zarr"), kr.open_run(tmp_path / "whole.zarr")
    assert resumed.a.values.tobytes() == whole.a.values.tobytes()


def test_interrupted_run_keeps_its_rows(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runs, "BLOCK_BYTES", 6 * 8 * 5)
    blocks = iter(range(100))
    original = archives.RunArchive.append

    def append(self: archives.RunArchive, block: object, start: int) -> None:
        if next(blocks) == 3:
            raise KeyboardInterrupt
        original(self, block, start)

    monkeypatch.setattr(archives.RunArchive, "append", append)
    with pytest.raises(KeyboardInterrupt):
        kr.simulate(top, x0, path=tmp_path / "run.zarr", **OPTIONS)
    kept = kr.open_run(tmp_path / "run.zarr.part")
    assert kept.sizes["time"] == 15
    assert np.isfinite(kept.a.values).all()


def test_check_finds_a_flipped_byte(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    chunk = next(p for p in (path / "a" / "c").rglob("*") if p.is_file())
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(bytes(data))
    faults = check_archive(path)[1]
    assert len(faults) == 1
    assert faults[0].startswith("a cannot be read")


def test_check_finds_a_changed_state(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    array = zarr.open_group(path)["a"]
    array[5, 2] = array[5, 2] + 1e-9
    assert check_archive(path)[1] == ["a cannot be read in rows 0 to 34: a/c/0/0 was changed after the run"]
    archive.list_all(path)  # as if the run had written it so
    faults = check_archive(path)[1]
    assert any(fault.startswith("energy does not belong") for fault in faults)


def test_check_finds_missing_rows(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    group = zarr.open_group(path)
    group.attrs["steps"] = 200
    assert check_archive(path)[1] == ["zarr.json was changed after the run"]
    archive.list_all(path)
    assert any("rows were expected" in fault for fault in check_archive(path)[1])


@pytest.mark.parametrize("name", ["nothing", "text", "folder", "foreign"])
def test_what_is_no_archive(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "text":
        path.write_text("not an archive")
    elif name == "folder":
        path.mkdir()
    elif name == "foreign":
        xr.Dataset({"v": ("t", [1.0])}).to_zarr(path, consolidated=False, zarr_format=3)
    with pytest.raises(kr.InputError):
        check_archive(path)


@pytest.mark.parametrize("name", ["a", "casimir"])
def test_check_names_a_missing_variable(name: str, top: object, x0: object, tmp_path: Path) -> None:
    kr.simulate(top, x0, path=tmp_path / "run.zarr", **OPTIONS)
    shutil.rmtree(tmp_path / "run.zarr" / name)
    run, faults = check_archive(tmp_path / "run.zarr")
    assert faults == [f"{name} is missing"]
    if name == "a":
        with pytest.raises(kr.InputError, match="lacks a of its state"):
            kr.plot(run)


def test_lost_attributes_are_named(top: object, x0: object, tmp_path: Path) -> None:
    kr.simulate(top, x0, path=tmp_path / "run.zarr", **OPTIONS)
    group = zarr.open_group(tmp_path / "run.zarr")
    kept = {k: v for k, v in group.attrs.asdict().items() if k not in ("dt", "system")}
    group.attrs.put(kept)
    with pytest.raises(kr.InputError, match="lack system, dt"):
        check_archive(tmp_path / "run.zarr")


def test_what_a_user_adds_is_named_and_kept(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    attrs = kr.simulate(top, x0, path=path, **OPTIONS).attrs
    xr.Dataset({"tilt": ("time", np.zeros(35))}, attrs=attrs).to_zarr(path, mode="a", consolidated=False)
    for read in (check_archive, kr.open_run):
        with pytest.raises(kr.InputError, match=r"zarr\.json is damaged.*another program wrote to the archive"):
            read(path)
    with pytest.raises(kr.InputError, match=r"holds tilt/.*which Kreisel did not write"):
        kr.simulate(top, x0, path=path, overwrite=True, **OPTIONS)
    assert xr.open_zarr(path, consolidated=False).tilt.shape == (35,)


def test_unwritable_places(top: object, x0: object, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(kr.RunError, match="could not be created"):
        kr.simulate(top, x0, path=tmp_path / "file" / "run.zarr", **OPTIONS)
    with pytest.raises(kr.RunError, match="shorter name"):
        kr.simulate(top, x0, path=tmp_path / ("x" * 300), **OPTIONS)


def test_a_block_is_a_shard_of_eight_chunks(top: object, x0: object, tmp_path: Path) -> None:
    run = kr.simulate(top, x0, path=tmp_path / "run.zarr", dt=0.1, steps=1000)
    array = zarr.open_group(tmp_path / "run.zarr")["a"]
    assert (array.shards, array.chunks) == ((1008, 3), (126, 3))
    assert len([p for p in (tmp_path / "run.zarr" / "a" / "c").rglob("*") if p.is_file()]) == 1
    assert (run.a.values == kr.simulate(top, x0, dt=0.1, steps=1000).a.values).all()
    file = next(p for p in (tmp_path / "run.zarr" / "a" / "c").rglob("*") if p.is_file())
    data = bytearray(file.read_bytes())
    data[10] ^= 1  # in the first chunk
    file.write_bytes(bytes(data))
    (fault,) = check_archive(tmp_path / "run.zarr")[1]
    assert fault == "a cannot be read in rows 0 to 1000: a/c/0/0 was changed after the run"


def test_lanes_on_disk(top: object, tmp_path: Path) -> None:
    state = top.state(m=np.full((4, 3), 0.5), a=np.eye(3)[[0, 1, 2, 0]])
    run = kr.simulate(top, state, path=tmp_path / "run.zarr", **OPTIONS)
    assert run.a.dims == ("time", "lane", "axis")
    assert check_archive(tmp_path / "run.zarr")[1] == []


def test_check_of_an_archive_with_nothing_that_can_be_read(
    top: object, x0: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import typer

    from kreisel.cli import runs as commands

    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    for chunk in (p for p in path.rglob("*") if p.is_file() and "c" in p.relative_to(path).parts):
        if not chunk.relative_to(path).parts[0] == "time":
            chunk.write_bytes(b"nothing")
    with pytest.raises(typer.Exit) as exit:
        commands.check(path, out=None)
    assert exit.value.exit_code == 1
    assert "FAULT" in capsys.readouterr().out
