"""The kernels on disk: whatever stands there is made again, and code of others is not run."""

from __future__ import annotations

import errno
import gc
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import warnings
import weakref
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import reuse
from kreisel.algebra.reuse import cached_property
from kreisel.graph import machine
from kreisel.graph.llvm import DOUBLE, Function, constant

SOURCE = Path(kr.__file__).parent
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="no fork and no flock")

NAME = "of_a_test" + machine.SUFFIX


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    where = tmp_path / "cache"
    monkeypatch.setenv("KREISEL_CACHE", str(where))
    return where


def code_of(factor: float) -> bytes:
    """Machine code of x -> factor x + 1."""

    def write(f: Function) -> None:
        x = f.doubles(f.arguments[0])
        x[0] = f.builder.fadd(f.builder.fmul(constant(DOUBLE, factor), x[0]), constant(DOUBLE, 1.0))

    return machine.object_code(1, write)


def value(factor: float = 2.0, compiled: list[str] | None = None) -> float:
    """What the kernel of that name makes of 3, as a process of its own would find it."""

    def make() -> bytes:
        if compiled is not None:
            compiled.append(NAME)
        return code_of(factor)

    x = np.array([3.0])
    machine.Kernel(machine.kept(NAME.removesuffix(machine.SUFFIX), make), 1)(x.ctypes.data)
    return float(x[0])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def flip(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[2 * len(data) // 3] ^= 4
    file.write_bytes(bytes(data))


def garbage(file: Path) -> None:
    file.write_bytes(np.random.default_rng(0).bytes(4000))


def gone(file: Path) -> None:
    file.unlink()


def a_folder(file: Path) -> None:
    file.unlink()
    (file / "deep").mkdir(parents=True)
    (file / "deep" / "file").write_text("x")


def a_pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


def a_link(file: Path) -> None:
    shutil.move(file, file.parents[1] / "elsewhere")
    file.symlink_to(file.parents[1] / "elsewhere")


DAMAGES = [empty, cut, flip, garbage, gone, a_folder, a_pipe, a_link]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_a_bad_entry_is_made_again(damage: Any, folder: Path) -> None:
    assert value() == 7.0
    damage(folder / NAME)
    compiled: list[str] = []
    assert [value(compiled=compiled), value(compiled=compiled)] == [7.0, 7.0]
    assert compiled == [NAME]  # once: the second finds it whole
    assert os.listdir(folder) == [NAME]


def test_nothing_outside_is_touched(folder: Path) -> None:
    outside = folder.parent / "outside"
    outside.mkdir()
    (outside / "thesis.tex").write_text("x")
    folder.mkdir(mode=0o700)
    for target in (outside, outside / "thesis.tex", Path("nowhere")):
        (folder / NAME).unlink(missing_ok=True)
        (folder / NAME).symlink_to(target)
        compiled: list[str] = []
        assert [value(compiled=compiled), value(compiled=compiled)] == [7.0, 7.0]
        assert compiled == [NAME]
    assert (outside / "thesis.tex").read_text() == "x"


def test_a_file_of_another_name_is_not_believed(folder: Path) -> None:
    """The code is whole, but it is another kernel's: what was asked for is compiled."""
    machine.kept("another", lambda: code_of(5.0))
    (folder / f"another{machine.SUFFIX}").rename(folder / NAME)
    compiled: list[str] = []
    assert value(compiled=compiled) == 7.0
    assert compiled == [NAME]


def test_a_full_disk_falls_back_to_memory(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*args: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", full)
        assert value() == 7.0
    assert os.listdir(folder) == []  # nothing half made is left
    assert value() == 7.0
    assert os.listdir(folder) == [NAME]


def test_a_folder_that_cannot_be_is_no_obstacle(folder: Path) -> None:
    folder.write_text("not a folder")
    assert machine.cache_folder() is None
    assert value() == 7.0
    assert folder.read_text() == "not a folder"


def test_the_folder_of_the_platform(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where KREISEL_CACHE names none; without a home there is no cache, and none in the working folder."""
    monkeypatch.delenv("KREISEL_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    made = machine.cache_folder()
    assert made is not None and made.is_dir() and made.name == "kreisel" and made.is_relative_to(tmp_path / "home")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as where the user has no entry
    assert machine.cache_folder() is None
    assert [p.name for p in tmp_path.iterdir()] == ["home"]


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702, 0o1777])
def test_a_folder_that_others_may_write_to_is_refused(mode: int, folder: Path) -> None:
    folder.mkdir()
    folder.chmod(mode)
    machine._refused.cache_clear()
    with pytest.warns(RuntimeWarning, match=r"expected a folder of user .* got owner .* KREISEL_CACHE") as caught:
        assert value() == value() == 7.0
    assert len(caught) == 1
    assert os.listdir(folder) == []
    folder.chmod(0o755)
    assert value() == 7.0
    assert os.listdir(folder) == [NAME]


def test_a_folder_of_somebody_else_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine._refused.cache_clear()
    folder.mkdir(mode=0o700)
    user = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: user)
    with pytest.warns(RuntimeWarning, match=rf"a folder of user {user} .* got owner {user - 1}, mode 700"):
        assert value() == 7.0
    assert os.listdir(folder) == []


def test_the_folder_is_made_for_its_user_alone(folder: Path) -> None:
    before = os.umask(0)
    try:
        assert value() == 7.0
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o777 == 0o700


def test_two_processes_at_once(folder: Path) -> None:
    """A run, as it is made in fresh processes with one cache; each ends, and one entry of each kernel is there."""
    code = """
import kreisel as kr
top = kr.LagrangeTop(p=(0, 0, 1))
run = kr.simulate(top, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.05, steps=9)
print(run.a.values.tobytes().hex())
"""
    command = [sys.executable, "-W", "error", "-c", code]
    children = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    printed = [child.communicate(timeout=120)[0] for child in children]
    assert [child.returncode for child in children] == [0, 0]
    assert printed[0] == printed[1] != ""
    entries = list(folder.iterdir())
    assert entries
    assert all(entry.name.endswith(machine.SUFFIX) and entry.is_file() for entry in entries)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert machine.cache_folder() == folder


def test_what_killed_writers_left_is_removed(folder: Path) -> None:
    """But not what another process writes now, nor files of somebody else."""
    folder.mkdir(mode=0o700)
    stale, young, other = (folder / name for name in (".kernel-abcd", ".kernel-efgh", ".mine"))
    for file in (stale, young, other):
        file.write_bytes(b"half")
    for file in (stale, other):
        os.utime(file, (1e9, 1e9))
    assert value() == 7.0
    assert not stale.exists()
    assert young.exists()
    assert other.exists()


def test_features_that_would_end_the_process_are_refused(folder: Path) -> None:
    code = """
import kreisel as kr
try:
    kr.propagator(kr.LagrangeTop(p=(0, 0, 1)), dt=0.1).steps([0.1, 0.2, 1.5, 0.6, 0.0, 0.8], 3)
except kr.InputError as error:
    print(error)
"""
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "KREISEL_CPU_FEATURES": "+avx2,garbage"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert found.returncode == 0
    assert found.stdout.startswith("KREISEL_CPU_FEATURES: expected features") and "got 'garbage'" in found.stdout


def test_kernels_of_a_body_go_with_it() -> None:
    """The body of a force, what was recorded and compiled for it, and its machine code."""

    def made(k: float) -> weakref.ref[Any]:
        body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), torque=lambda m: k * m * (1, 1, 0), name="of a test")
        kr.propagator(body, dt=0.05).steps([0.1, 0.2, 1.5, 0.6, 0.0, 0.8], 3)
        assert len(machine._loaded) > before
        return weakref.ref(body.system)

    gc.collect()
    before = len(machine._loaded)
    known = made(0.0123)
    gc.collect()
    assert known() is None and len(machine._loaded) == before


@POSIX
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning", "ignore:.*fork.*:RuntimeWarning")
def test_a_fork_while_another_thread_computes() -> None:
    """A lock of a property or of the table of kernels that a thread holds would be held in the child without end."""
    begun, end = threading.Event(), threading.Event()

    class Slow:
        def __init__(self, waits: bool):
            self.waits = waits

        @cached_property
        def value(self) -> int:
            if self.waits:
                begun.set()
                end.wait(60)
            return 1

    slow = Slow(True)
    thread = threading.Thread(target=lambda: slow.value)
    with reuse._one_at_a_time:
        thread.start()
        assert begun.wait(60)
        child = os.fork()
        if child == 0:
            signal.alarm(20)  # which ends the child
            os._exit(Slow(False).value + reuse.reused(("number", "of a child"), lambda: 2))
    end.set()
    thread.join(60)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3 and slow.value == 1
    used = [path for path in SOURCE.rglob("*.py") if re.search(r"functools.*cached_property$", path.read_text(), re.M)]
    assert used == []


def test_all_that_writes_functions_is_a_part_of_their_keys() -> None:
    writes = [file for file in SOURCE.glob("**/*.py") if ".llvm import" in file.read_text("utf-8")]
    rooms = {file.relative_to(SOURCE).parts[0] for file in writes}
    assert {"graph", "kernels", "rebound"} <= rooms <= {*machine.WRITERS}


FROM_A_ZIP = """
import kreisel
from kreisel.graph import machine
from kreisel.languages import source

print("zip" in kreisel.__file__, machine._writers().hex(), len(source._filled("fmu.c", {})))
"""


def test_keys_of_a_package_in_a_zip_know_all_that_writes_them(tmp_path: Path) -> None:
    """Its files are no files of a folder: keys that read none of them are equal for all versions."""
    archive = tmp_path / "kreisel.zip"
    with zipfile.ZipFile(archive, "w") as whole:
        for file in SOURCE.rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                whole.write(file, file.relative_to(SOURCE.parent))
    done = subprocess.run(
        [sys.executable, "-c", FROM_A_ZIP],
        env={**os.environ, "PYTHONPATH": str(archive)},
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    )
    zipped, key, templates = done.stdout.split()
    assert zipped == "True"
    assert key == machine._writers().hex() != hashlib.sha256(b"").hexdigest()
    assert int(templates) > 1000
