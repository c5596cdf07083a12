"""Shared: a top, a state, a folder of one's own, one cache of kernels for the session."""

from __future__ import annotations

import ctypes
import functools
import gc
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

os.environ.setdefault(
    "KREISEL_CACHE", str(Path(tempfile.gettempdir()) / f"kreisel-tests-{getattr(os, 'getuid', str)()}")
)

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(os.environ["KREISEL_CACHE"]) / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

import kreisel as kr
from kreisel.algebra.reuse import forget
from kreisel.system import REGISTRY
from skips import pytest_sessionfinish, pytest_terminal_summary  # noqa: F401  - hooks

Path(os.environ["KREISEL_CACHE"]).mkdir(mode=0o700, parents=True, exist_ok=True)  # code: nobody else's


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of every system in every dimension: those of the systems that have one dimension, in that one."""
    items[:] = [item for item in items if _exists(getattr(item, "callspec", None))]


def _exists(callspec: object) -> bool:
    params = getattr(callspec, "params", {})
    name, n = params.get("name"), params.get("n")
    return name not in REGISTRY or not isinstance(n, int) or REGISTRY[name].n in (None, n)


def _forgetting(method: Callable[..., Any]) -> Callable[..., Any]:
    """What is patched may change what is recorded: nothing that was made before, or with it, is used again."""

    @functools.wraps(method)
    def forgotten(*args: Any, **options: Any) -> Any:
        forget()
        return method(*args, **options)

    return forgotten


pytest.MonkeyPatch.setattr = _forgetting(pytest.MonkeyPatch.setattr)  # type: ignore[method-assign]
pytest.MonkeyPatch.undo = _forgetting(pytest.MonkeyPatch.undo)  # type: ignore[method-assign]


PROCESS, MOST_BYTES = psutil.Process(), 1 << 30
KEPT = [MOST_BYTES]  # bytes of memory after it was freed; once they have grown by half of MOST_BYTES it is freed again


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
def nothing_is_reused() -> Iterator[None]:
    """Each test records its steps itself."""
    forget()
    yield
    if PROCESS.memory_info().rss > KEPT[0] + MOST_BYTES // 2:  # collecting garbage of a gigabyte takes a second
        _free()


@pytest.fixture(autouse=True, scope="module")
def kernels_are_freed() -> Iterator[None]:
    """A file of tests leaves no memory to the next ones."""
    yield
    _free()


@pytest.fixture
def top() -> object:
    return kr.LagrangeTop(p=(0, 0, 1))


@pytest.fixture
def x0(top: object) -> object:
    return top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
