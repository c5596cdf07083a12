"""The kernels on disk: whatever stands there is made again, and code of others is not run."""

from __future__ import annotations

import errno
import gc
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import warnings
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import reuse
from kreisel.algebra.reuse import cached_property
from kreisel.kernels import cache

SOURCE = Path(kr.__file__).parent
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="no fork and no flock")

NAME = "kreisel_kernel_of_a_test"
SOURCES = {
    "LLVM": """
from kreisel.kernels._llvm.machine import compiled

@compiled("f8[::1]")
def kernel(x):
    x[0] = 2.0 * x[0] + 1.0
""",
    "Numba": """
from numba import njit

@njit("void(f8[::1])", cache=True)
def kernel(x):
    x[0] = 2.0 * x[0] + 1.0
""",
}
FILES = {
    "LLVM": [f"{NAME}.py", cache.CODE, cache.FORMS, cache.SEAL],
    "Numba": [f"{NAME}.py", "__pycache__/*.nbi", "__pycache__/*.nbc", cache.SEAL],
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    where = tmp_path / "cache"
    monkeypatch.setenv("KREISEL_CACHE", str(where))
    yield where
    unload()


def unload() -> None:
    sys.modules.pop(NAME, None)
    cache._loaded.pop(NAME, None)


def value(by: str = "LLVM", factor: str = "2.0") -> float:
    """The kernel of the source, as a process of its own would find it."""
    unload()
    x = np.array([3.0])
    cache.module(NAME, SOURCES[by].replace("2.0", factor), by == "Numba").kernel(x)
    return float(x[0])


def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The kernels that are compiled from now on and kept."""
    original, out = cache._made, []
    monkeypatch.setattr(cache, "_made", lambda folder, *given: out.append(folder.name) or original(folder, *given))
    return out


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
    shutil.move(file, file.parents[2] / "elsewhere")
    file.symlink_to(file.parents[2] / "elsewhere")


DAMAGES = [empty, cut, flip, garbage, gone, a_folder, a_pipe, a_link]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
@pytest.mark.parametrize(("by", "pattern"), [(by, file) for by, files in FILES.items() for file in files])
def test_a_bad_entry_is_made_again(
    by: str, pattern: str, damage: object, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert value(by) == 7.0
    (file,) = (folder / NAME).glob(pattern)
    damage(file)
    compiled = made(monkeypatch)
    assert [value(by), value(by)] == [7.0, 7.0]
    assert compiled == [NAME]  # once: the second finds it whole
    assert not list(folder.glob(".*"))


def test_what_stands_in_the_place_of_an_entry_is_replaced(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outside = folder.parent / "outside"
    outside.mkdir()
    (outside / "thesis.tex").write_text("x")
    folder.mkdir(mode=0o700)
    compiled = made(monkeypatch)
    for number, make in enumerate(
        [
            lambda entry: entry.write_text("a file"),
            lambda entry: entry.mkdir(),
            lambda entry: (entry / "__pycache__").write_text("a file") if entry.mkdir() is None else None,
            os.mkfifo,
            lambda entry: entry.symlink_to(outside),
            lambda entry: entry.symlink_to("nowhere"),
        ]
    ):
        cache._remove(folder / NAME)
        make(folder / NAME)
        assert [value(), value()] == [7.0, 7.0]
        assert len(compiled) == number + 1
    assert os.listdir(outside) == ["thesis.tex"]


def test_a_seal_that_belongs_to_other_code_is_not_believed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All hashes fit, but the source is another one's: what was asked for is compiled."""
    assert value(factor="5.0") == 16.0
    compiled = made(monkeypatch)
    assert value() == 7.0
    assert compiled == [NAME]


@pytest.mark.parametrize(
    ("by", "place"),
    [
        ("LLVM", "pathlib.Path.write_bytes"),
        ("Numba", "numba.core.caching.IndexDataCacheFile._save_data"),
    ],
)
def test_a_full_disk_falls_back_to_memory(by: str, place: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*args: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(place, full)
        assert value(by) == 7.0
    assert os.listdir(folder) == []  # nothing half made is left
    assert value(by) == 7.0
    assert os.listdir(folder) == [NAME]


def test_a_folder_that_cannot_be_is_no_obstacle(folder: Path) -> None:
    folder.write_text("not a folder")
    assert cache.cache_folder() is None
    assert value() == 7.0
    assert folder.read_text() == "not a folder"


def test_the_folder_of_the_platform(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where KREISEL_CACHE names none; without a home there is no cache, and none in the working folder."""
    monkeypatch.delenv("KREISEL_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    made = cache.cache_folder()
    assert made is not None and made.is_dir() and made.name == "kreisel" and made.is_relative_to(tmp_path / "home")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as where the user has no entry
    assert cache.cache_folder() is None
    assert [p.name for p in tmp_path.iterdir()] == ["home"]


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702, 0o1777])
def test_a_folder_that_others_may_write_to_is_refused(mode: int, folder: Path) -> None:
    folder.mkdir()
    folder.chmod(mode)
    cache._refused.cache_clear()
    with pytest.warns(RuntimeWarning, match=r"expected a folder of user .* got owner .* KREISEL_CACHE") as caught:
        assert value() == value() == 7.0
    assert len(caught) == 1
    assert os.listdir(folder) == []
    folder.chmod(0o755)
    assert value() == 7.0
    assert os.listdir(folder) == [NAME]


def test_a_folder_of_somebody_else_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache._refused.cache_clear()
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


def test_kernels_lie_in_the_cache_whatever_numba_is_set_to(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from numba.core import config

    monkeypatch.setattr(config, "CACHE_DIR", str(folder.parent / "numba"))
    assert value("Numba") == 7.0
    assert len(list((folder / NAME / "__pycache__").glob("*.nb?"))) == 2
    assert not (folder.parent / "numba").exists()


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
    assert all(entry.name.startswith("kreisel_kernel_") and (entry / cache.SEAL).is_file() for entry in entries)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cache.cache_folder() == folder


@POSIX
def test_what_killed_writers_left_is_removed(folder: Path) -> None:
    """Folders that a living process has locked stay, and so do those of somebody else's files."""
    folder.mkdir(mode=0o700)
    stale = [folder / f".kreisel_kernel_{name}-abcd1234" for name in ("0123456789abcdef0123", "of_a_test")]
    kept = [folder / ".kreisel_kernel_young-abcd1234", folder / ".kreisel-mine"]
    for each in (*stale, *kept):
        each.mkdir()
        (each / "code.o").write_bytes(b"half")
    for each in (*stale, kept[1]):
        os.utime(each, (1e9, 1e9))
    code = "from pathlib import Path\nfrom kreisel.process import scratch\n"
    code += f"with scratch(Path({str(folder)!r}), '.kreisel_kernel_living-') as made:\n"
    code += "    print(made, flush=True)\n    input()\n"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    killed, living = (subprocess.Popen([sys.executable, "-c", code], **pipes) for _ in range(2))  # type: ignore[call-overload]
    try:
        left, locked = (Path(child.stdout.readline().strip()) for child in (killed, living))
        killed.kill()
        killed.wait(60)
        for each in (left, locked):
            os.utime(each, (1e9, 1e9))
        os.utime(kept[0])  # made just now
        assert value() == 7.0
        assert not left.exists() and not any(each.exists() for each in stale)
        assert locked.exists() and all(each.exists() for each in kept)
    finally:
        killed.kill()
        killed.communicate()
        living.communicate("\n", timeout=60)
    assert not locked.exists()


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
        env={**os.environ, "NUMBA_CPU_FEATURES": "+avx2,garbage"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert found.returncode == 0
    assert found.stdout.startswith("NUMBA_CPU_FEATURES: expected features") and "got 'garbage'" in found.stdout


def test_kernels_of_a_body_go_with_it() -> None:
    """The body of a force, what was recorded and compiled for it, and its machine code."""

    def made(k: float) -> weakref.ref[Any]:
        body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), torque=lambda m: k * m * (1, 1, 0), name="of a test")
        kr.propagator(body, dt=0.05).steps([0.1, 0.2, 1.5, 0.6, 0.0, 0.8], 3)
        assert len(cache._loaded) > before
        return weakref.ref(body.system)

    gc.collect()
    before = len(cache._loaded)
    known = made(0.0123)
    gc.collect()
    assert known() is None and len(cache._loaded) == before


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
