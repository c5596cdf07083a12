"""Faults that are really made: a full disk, a read-only and a vanishing one, clocks that jump, links, two writers."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

import kreisel as kr
from kreisel.process import Lock
from kreisel.runs import integration
from kreisel.storage import archive, simulate as runs
from kreisel.sweeps.sweep import check_archive
from support import ROOT

OPTIONS = {"dt": 0.1, "steps": 900, "every": 3}
SWEPT: dict[str, Any] = {
    "design": kr.Design(together={"system.alpha": np.linspace(0.5, 1.5, 12)}),
    "save": ["drift", "trajectories"], "block": 2, "workers": 0, **OPTIONS,
}  # fmt: skip


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integration, "BLOCK_BYTES", 6 * 8 * 50)
    monkeypatch.setattr(runs, "CHECKPOINT_SECONDS", 0.0)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of one MiB, where one may be mounted."""
    where = tmp_path / "disk"
    where.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(where)]
    try:
        done = subprocess.run(mount, capture_output=True, check=False, timeout=20)
    except FileNotFoundError:
        pytest.skip("no file system may be mounted here; there is no mount")
    if done.returncode:
        pytest.skip("no file system may be mounted here; the stand-in tests the same")
    yield where
    subprocess.run(["umount", "-l", str(where)], check=True, timeout=20)


def values(path: Path) -> dict[str, Any]:
    run = kr.open_run(path)
    return {str(name): run[name].values for name in run.variables}


def same(one: dict[str, Any], two: dict[str, Any]) -> bool:
    return one.keys() == two.keys() and all(np.array_equal(one[k], two[k], equal_nan=True) for k in one)


def ballast(disk: Path, leave: int) -> Path:
    """A file that leaves so many bytes free."""
    status = os.statvfs(disk)
    file = disk / "ballast"
    file.write_bytes(bytes(status.f_bavail * status.f_bsize - leave))
    return file


def test_a_full_disk_and_space_freed(top: object, x0: object, disk: Path, tmp_path: Path) -> None:
    kr.simulate(top, x0, path=tmp_path / "whole.zarr", **OPTIONS)
    file = ballast(disk, 150_000)
    with pytest.raises(kr.RunError, match=r"disk is full.*kreisel resume"):
        kr.simulate(top, x0, path=disk / "run.zarr", **OPTIONS)
    kept = kr.open_run(disk / "run.zarr.part")
    assert kept.sizes["time"] >= 50
    with pytest.raises(kr.RunError, match="disk is full"):
        kr.resume(disk / "run.zarr")  # still full
    file.unlink()
    kr.resume(disk / "run.zarr")
    assert same(values(disk / "run.zarr"), values(tmp_path / "whole.zarr"))
    assert check_archive(disk / "run.zarr")[1] == []


def test_a_full_disk_under_a_sweep(top: object, x0: object, disk: Path, tmp_path: Path) -> None:
    options = {**SWEPT, "save": ["drift"], "steps": 30}
    kr.sweep(top, x0, path=tmp_path / "whole.zarr", **options)
    file = ballast(disk, 200_000)
    with pytest.raises(kr.RunError, match=r"disk is full.*the same command resumes"):
        kr.sweep(top, x0, path=disk / "s.zarr", **options)
    file.unlink()
    kr.sweep(top, x0, path=disk / "s.zarr", **options)
    assert same(values(disk / "s.zarr"), values(tmp_path / "whole.zarr"))


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_at_any_write(
    number: int, top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stand-in: writes of Zarr fail after a random number of them, again and again, until the run is done."""
    kr.simulate(top, x0, path=tmp_path / "whole.zarr", **OPTIONS)
    rng, original, path = random.Random(number), zarr.Array.__setitem__, tmp_path / "run.zarr"
    failed = 0
    for _ in range(30):
        left = iter(range(rng.randrange(1, 25)))

        def write(self: object, *args: object, left: Iterator[int] = left) -> None:
            if next(left, None) is None:
                raise OSError(number, os.strerror(number))
            original(self, *args)

        with monkeypatch.context() as patch:
            patch.setattr(zarr.Array, "__setitem__", write)
            try:
                if path.with_name("run.zarr.part").exists():
                    kr.resume(path)
                else:
                    kr.simulate(top, x0, path=path, **OPTIONS)
                break
            except kr.RunError as error:
                failed += 1
                assert "could not" in str(error)
    assert failed >= 2
    if not path.exists():
        kr.resume(path)
    assert same(values(path), values(tmp_path / "whole.zarr"))


def test_netcdf_needs_a_disk_that_holds_it(top: object, x0: object, disk: Path) -> None:
    """HDF5 ends the process on a full disk, so the room is measured before."""
    run = kr.simulate(top, x0, dt=0.1, steps=2000)
    ballast(disk, 100_000)
    with pytest.raises(kr.InputError, match=r"/run\.nc: expected a disk with at least .* free"):
        kr.export(run, disk / "run.nc")
    assert not list(disk.glob("*run*"))


def test_a_read_only_disk(top: object, x0: object, disk: Path) -> None:
    kr.simulate(top, x0, path=disk / "run.zarr", dt=0.1, steps=20)
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True, timeout=20)
    for act in (
        lambda: kr.simulate(top, x0, path=disk / "other.zarr", dt=0.1, steps=20),
        lambda: kr.sweep(top, x0, path=disk / "s.zarr", **SWEPT),
        lambda: kr.resume(disk / "run.zarr", extend=100),
        lambda: kr.export(disk / "run.zarr", disk / "run.nc"),
    ):
        with pytest.raises(kr.RunError, match="read-only"):
            act()
    assert check_archive(disk / "run.zarr")[1] == []  # reading needs no writing
    subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True, timeout=20)
    assert kr.resume(disk / "run.zarr", extend=100).attrs["steps"] == 100


def test_a_directory_that_vanishes(top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original, count = integration.Integration._advance, iter(range(10**9))

    def advance(self: integration.Integration) -> None:
        if next(count) == 5:
            shutil.rmtree(tmp_path / "deep")
        original(self)

    monkeypatch.setattr(integration.Integration, "_advance", advance)
    with pytest.raises(kr.RunError, match="vanished during the run"):
        kr.simulate(top, x0, path=tmp_path / "deep" / "run.zarr", dt=0.1, steps=10**6, every=1)


def test_a_sweep_whose_directory_vanishes(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from kreisel.sweeps import workers

    original, count = workers.compute, iter(range(10**9))

    def compute(*args: Any) -> dict[str, Any]:
        if next(count) == 3:
            shutil.rmtree(tmp_path / "deep")
        return original(*args)

    monkeypatch.setattr(workers, "compute", compute)
    with pytest.raises(kr.RunError, match=r"could not be|no longer|lacks|vanished"):
        kr.sweep(top, x0, path=tmp_path / "deep" / "s.zarr", **SWEPT)
    assert same(
        values_of_sweep(top, x0, tmp_path / "deep" / "s.zarr"), values_of_sweep(top, x0, tmp_path / "again.zarr")
    )


def values_of_sweep(top: object, x0: object, path: Path) -> dict[str, Any]:
    kr.sweep(top, x0, path=path, **{**SWEPT, "steps": 30})
    return values(path)


def test_clocks_that_jump(top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {**OPTIONS, "steps": 200_000, "every": 100}
    kr.simulate(top, x0, path=tmp_path / "whole.zarr", **options)
    rng, kept = random.Random(1), {name: getattr(time, name) for name in ("time", "monotonic", "perf_counter")}
    for name, clock in kept.items():
        monkeypatch.setattr(time, name, lambda clock=clock: clock() + rng.choice([0, 0, 3600, -3600, 1e9, -1e9]))
    begun = kept["monotonic"]()
    kr.simulate(top, x0, path=tmp_path / "run.zarr", **options)
    assert kept["monotonic"]() - begun < 120
    monkeypatch.undo()
    assert same(values(tmp_path / "run.zarr"), values(tmp_path / "whole.zarr"))


def test_a_worker_that_imports_a_script_without_a_guard_is_told(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text("""
import multiprocessing
import kreisel as kr
from kreisel.process import Lock

if multiprocessing.parent_process() is None:
    with Lock(__import__("pathlib").Path("s.zarr")):
        worker = multiprocessing.get_context("spawn").Process(target=print)
        worker.start()
        worker.join()
else:
    kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": (0, 0, 1), "a": (1, 0, 0)}, dt=0.1, steps=1, path="s.zarr")
""")
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "written by another process" in done.stderr and "outside of `if __name__ == '__main__':`" in done.stderr


def test_two_writers_of_a_sweep(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "s.zarr"
    with Lock(path), pytest.raises(kr.InputError, match=r"written by another process, which holds .*s\.zarr\.lock"):
        kr.sweep(top, x0, path=path, **SWEPT)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("place", ["a", "a/c", "a/c/0", "energy/zarr.json", "engine/checkpoint.npz"])
def test_nothing_outside_a_store_is_read_or_written(place: str, top: object, x0: object, tmp_path: Path) -> None:
    path, secret = tmp_path / "run.zarr", tmp_path / "secret"
    kr.simulate(top, x0, path=path, **OPTIONS)
    shutil.move(path / place, secret)
    (path / place).symlink_to(secret)
    before = sorted((p, p.stat().st_mtime_ns) for p in [secret, *secret.rglob("*")])
    for act in (
        lambda: kr.open_run(path),
        lambda: check_archive(path),
        lambda: kr.resume(path, extend=6000),
    ):
        with pytest.raises(kr.InputError, match="holds a link"):
            act()
    assert before == sorted((p, p.stat().st_mtime_ns) for p in [secret, *secret.rglob("*")])


def test_a_checkpoint_that_claims_too_much(top: object, x0: object, tmp_path: Path) -> None:
    """Sizes are compared with the bytes that are there before anything is allocated; nothing is unpickled."""
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    file = path / "engine" / "checkpoint.npz"
    with np.load(file) as saved:
        arrays = dict(saved)

    class Code:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.mkdir, (str(tmp_path / "run by a pickle"),)

    np.savez(file, **{**arrays, "rows": np.zeros((5, 1, 7))})
    with pytest.raises(kr.InputError, match=r"checkpoint\.npz was changed after the run"):
        kr.resume(path, extend=6000)
    (path / "engine" / "checksums.sha256").unlink()  # all that follows was listed, as far as anyone can see
    np.savez(file, **{**arrays, "rows": np.array([Code()], dtype=object)})
    with pytest.raises(kr.InputError, match="damaged"):
        kr.resume(path, extend=6000)
    assert not (tmp_path / "run by a pickle").exists()
    np.savez_compressed(file, **{**arrays, "rows": np.zeros((1 << 19, 1, 6))})  # 25 kB that become 25 MB
    with pytest.raises(kr.InputError, match="claims"):
        kr.resume(path, extend=6000)
    np.savez(file, **{**arrays, "rows": np.zeros((5, 1, 7))})
    archive.list_all(path)
    with pytest.raises(kr.InputError, match="does not belong"):
        kr.resume(path, extend=6000)
    np.savez(file, **{**arrays, "flushed": np.asarray(10**9)})
    archive.list_all(path)
    with pytest.raises(kr.InputError, match="blocks before its checkpoint are missing"):
        kr.resume(path, extend=6000)
    np.savez(file, **arrays)
    archive.list_all(path)
    assert kr.resume(path, extend=6000).attrs["steps"] == 6000


@contextlib.contextmanager
def mode_of(path: Path, mode: int) -> Iterator[None]:
    path.chmod(mode)
    try:
        yield
    finally:
        path.chmod(0o755)


def without_privileges(call: str) -> subprocess.CompletedProcess[str]:
    code = f"""
import sys
sys.path.insert(0, {str(ROOT / "benchmarks" / "trial")!r})
import sandbox, kreisel as kr
sandbox.drop()
try:
    {call}
except (kr.InputError, kr.RunError) as error:
    print("refused", error)
"""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize(
    ("place", "mode"), [("energy/c/0", 0o000), ("energy", 0o400), ("energy/c", 0o000), ("", 0o000)]
)
def test_files_and_folders_that_may_not_be_read(place: str, mode: int, top: object, x0: object, tmp_path: Path) -> None:
    """By somebody without privileges: one message, and the true values once the modes are back."""
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    before = values(path)
    with mode_of(path / place, mode):
        done = without_privileges(f"kr.open_run({str(path)!r}).load()")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("refused") == 1, done.stdout
    assert same(values(path), before)


@pytest.mark.parametrize("place", ["", "engine"])
def test_a_finished_archive_that_may_not_be_written_keeps_its_name(
    place: str, top: object, x0: object, tmp_path: Path
) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    before = values(path)
    with mode_of(path / place, 0o555):
        done = without_privileges(f"kr.resume({str(path)!r}, extend=6000)")
    assert "refused" in done.stdout, done.stderr
    assert "Permission denied" in done.stdout, done.stdout
    assert [file.name for file in tmp_path.iterdir()] == ["run.zarr"]
    assert same(values(path), before)
    assert kr.resume(path, extend=6000).attrs["steps"] == 6000
