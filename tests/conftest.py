"""Shared: a top, a state, a folder of one's own, one cache of kernels for the session."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil
import pytest

os.environ.setdefault(
    "KREISEL_CACHE", str(Path(tempfile.gettempdir()) / f"kreisel-tests-{getattr(os, 'getuid', str)()}")
)

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(os.environ["KREISEL_CACHE"]) / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")  # 20 ms an operation, 5 ms from the disk
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")  # half of XLA's time; pages and examples run all of them

with contextlib.suppress(metadata.PackageNotFoundError):
    if metadata.version("jax").startswith("0.10."):  # XLA ends the process for flags that it does not know
        os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")  # half of the rest of its time

import kreisel as kr
from kreisel import cli
from kreisel.algebra.reuse import forget
from kreisel.system import REGISTRY
from skips import pytest_sessionfinish, pytest_terminal_summary  # noqa: F401  - hooks

Path(os.environ["KREISEL_CACHE"]).mkdir(mode=0o700, parents=True, exist_ok=True)  # code: nobody else's


def pytest_configure() -> None:
    """Temporary folders in memory, where programs may run there: a disk takes 2 ms to delete one of 30,000 files."""
    memory = Path("/dev/shm")
    if memory.is_dir() and shutil.disk_usage(memory).free > 1 << 32 and not os.statvfs(memory).f_flag & os.ST_NOEXEC:
        os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(memory))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of every system in every dimension: those of the systems that have one dimension, in that one."""
    items[:] = [item for item in items if _exists(getattr(item, "callspec", None))]


def _exists(callspec: object) -> bool:
    params = getattr(callspec, "params", {})
    name, n = params.get("name"), params.get("n")
    return name not in REGISTRY or not isinstance(n, int) or REGISTRY[name].n in (None, n)


UNRECORDED = tuple(
    f"kreisel.{room}"
    for room in ("storage", "sweeps", "cli", "viewer", "files", "process", "runs.integration", "runs.describing")
)


def _recorded(target: Any) -> bool:
    """Whether a patch of this object, or of this dotted name, may change what is recorded."""
    name = target if isinstance(target, str) else getattr(target, "__module__", None) or getattr(target, "__name__", "")
    return not name.startswith(UNRECORDED) and name.split(".")[0] not in sys.stdlib_module_names


def _forgetting(method: Callable[..., Any], targets: Callable[..., Iterable[Any]]) -> Callable[..., Any]:
    """A method of a patch that discards what was recorded before it, or with it, if that may be different now."""

    @functools.wraps(method)
    def forgotten(patch: Any, *args: Any, **options: Any) -> Any:
        if any(_recorded(target) for target in targets(patch, *args)):
            forget()
        return method(patch, *args, **options)

    return forgotten


def _entry(room: Any, name: Any) -> str:
    """Where an entry of a dictionary belongs, as a dotted name: recordings depend on some variables, and on tables."""
    return "os" if room is os.environ and not name.startswith("KREISEL") else "kreisel"


def _patched(patch: Any) -> list[Any]:
    """Objects and entries that a patch changed."""
    return [target for target, *_ in patch._setattr] + [_entry(room, name) for room, name, _ in patch._setitem]


_patch: Any = pytest.MonkeyPatch
_patch.setattr = _forgetting(_patch.setattr, lambda patch, target, *more: [target])
_patch.setitem = _forgetting(_patch.setitem, lambda patch, room, name, value: [_entry(room, name)])
_patch.delitem = _forgetting(_patch.delitem, lambda patch, room, name, *more: [_entry(room, name)])
_patch.undo = _forgetting(_patch.undo, _patched)
os.fsync = lambda handle: None  # no test cuts the power; the disk takes 10 ms for each of some thousand calls


# Python's arenas stay while an object is in them, so late is little: with 3 << 28 test_conjugate.py and more of
# tests/exact kept 893 MB, and test_differentiable.py with tests/reduction went up to 1,143 MB in place of 843, in the
# same processor time.
PROCESS, MOST_BYTES = psutil.Process(), 1 << 29
KEPT = [MOST_BYTES]  # bytes after memory was freed; it is freed again when they have grown by an eighth of MOST_BYTES


def pytest_collection_finish() -> None:
    """Garbage is collected when memory has grown: Python would look through 10^5 objects after each recording."""
    gc.collect()
    gc.freeze()
    gc.disable()


def _free() -> None:
    """Free kernels and JAX's programs, which are on disk too; the C library keeps what is freed unless it is asked."""
    forget()
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()  # test_differentiable.py alone leaves a gigabyte there
    gc.collect()
    if sys.platform == "linux":
        getattr(ctypes.CDLL(None), "malloc_trim", lambda kept: None)(0)  # of glibc
    KEPT[0] = max(MOST_BYTES, PROCESS.memory_info().rss)


@pytest.fixture(autouse=True)
def memory_is_freed() -> Iterator[None]:
    """Recordings are kept from test to test, until something is patched or memory has grown."""
    yield
    if PROCESS.memory_info().rss > KEPT[0] + MOST_BYTES // 8:
        _free()


@pytest.fixture
def kreisel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., subprocess.CompletedProcess[str]]:
    """The command line in a folder of its own; without a process of its own, which needs a second."""

    def call(*words: str) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["kreisel", *words])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        return subprocess.CompletedProcess(words, int(stopped.value.code or 0), *capsys.readouterr())

    return call


@pytest.fixture
def top() -> object:
    return kr.LagrangeTop(p=(0, 0, 1))


@pytest.fixture
def x0(top: object) -> object:
    return top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
