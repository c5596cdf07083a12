"""Locks, scratch folders and signals, which a process shares with others; the times of its work, and a progress bar.

A lock is held by the operating system for as long as its process lives: a lock file without a holder is stale.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError, on_disk, shown

if TYPE_CHECKING:
    from filelock import BaseFileLock

SPENT: defaultdict[str, float] = defaultdict(float)  # seconds of this process by their use
SHOW_AFTER_SECONDS = 0.5  # of work, before its progress appears
YOUNG = 1.0  # seconds in which a new folder may not yet be locked
LOCK_REMEDY = "A lock is there while an archive is written: move it away, or choose another path."


class Lock:
    """One writer: NAME.lock.  Raises `InputError` if there is another writer, `RunError` if no file can be created."""

    def __init__(self, path: Path):
        self.archive, self.path = path, path.with_name(f"{path.name}.lock")

    def __enter__(self) -> Lock:
        with on_disk(self.archive, "be created"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if os.path.lexists(self.path) and not (
                os.path.isfile(self.path) and not os.path.islink(self.path) and not os.stat(self.path).st_size
            ):
                raise InputError(f"{self.path} is not a lock of Kreisel and is unchanged. {LOCK_REMEDY}")
            held = _held(self.path)
        if held is None:
            of_worker = "__mp_main__" in sys.modules  # the script, imported by a worker process
            raise InputError(
                f"{self.archive} is being written by another process, which holds {self.path}. "
                "Usual cause: a script that calls this outside of `if __name__ == '__main__':`, which workers import."
                if of_worker
                else "Wait for it, stop it, or choose another path."
            )
        self._held = held
        return self

    def __exit__(self, *raised: object) -> None:
        _given_back(self._held)


def _held(path: Path) -> BaseFileLock | None:
    """A lock on a file, which is created for it; None if another process holds it.  Raises `OSError`."""
    from filelock import FileLock, Timeout  # some 40 modules, not needed by runs in memory

    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return None
    return lock


def _given_back(lock: BaseFileLock) -> None:
    """Release a lock and remove its file, while the lock is held, so no other process locks a removed file."""
    with contextlib.suppress(OSError):  # Windows removes it only after the release
        os.unlink(lock.lock_file)
    lock.release()


@contextlib.contextmanager
def scratch(parent: Path, prefix: str, family: str = "", files: Collection[str] | None = None) -> Iterator[Path]:
    """A new folder in `parent`, removed at the end; stale ones of the same family of prefixes are removed before.

    family  a regular expression of prefixes; default: the prefix
    files   the names of all files that a writer creates there; a folder with anything else stays
    """
    with contextlib.suppress(OSError):
        _sweep(parent, re.compile(rf"({family or re.escape(prefix)})\w{{8}}"), files)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    lock = None
    with contextlib.suppress(OSError):  # a file system without locks
        lock = _held(_lock_of(folder))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            _given_back(lock)


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.lock")


def _sweep(parent: Path, names: re.Pattern[str], files: Collection[str] | None) -> None:
    for name in {name.removesuffix(".lock") for name in os.listdir(parent)}:
        folder = parent / name
        if not names.fullmatch(name) or not _is_stale(folder if os.path.lexists(folder) else _lock_of(folder)):
            continue
        lock = None
        with contextlib.suppress(OSError):
            lock = _held(_lock_of(folder))
        if lock is not None:
            if folder.is_dir() and (files is None or set(os.listdir(folder)) <= set(files)):
                shutil.rmtree(folder, ignore_errors=True)
            _given_back(lock)


def _is_stale(entry: Path) -> bool:
    """Whether a folder, or a lock without its folder, belongs to this user and is old enough to be considered."""
    try:
        status = os.lstat(entry)
    except OSError:
        return False
    mine = not hasattr(os, "geteuid") or status.st_uid == os.geteuid()
    return mine and not entry.is_symlink() and time.time() - status.st_mtime > YOUNG


class Stop:
    """Whether Ctrl-C or SIGTERM was received; `signal` is its number."""

    signal: int | None = None


@contextlib.contextmanager
def signals_to(handler: Callable[[int, FrameType | None], None]) -> Iterator[dict[int, Any]]:
    """A context in which Ctrl-C and SIGTERM go to a handler; yields the previous handlers.  Main thread only."""
    before: dict[int, Any] = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, handler)
    try:
        yield before
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


@contextlib.contextmanager
def signals_wait() -> Iterator[Stop]:
    """A context in which the first Ctrl-C or SIGTERM only sets a flag; a second acts as usual.  Main thread only."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def note(number: int, frame: FrameType | None) -> None:
        stop.signal = number
        signal.signal(number, before[number])

    with signals_to(note) as before:
        yield stop


@contextlib.contextmanager
def spent_on(use: str) -> Iterator[None]:
    """A context whose seconds are counted."""
    begun = time.perf_counter()
    try:
        yield
    finally:
        SPENT[use] += time.perf_counter() - begun


# -- progress ----------------------------------------------------------------------------------------


class Progress:
    """Counts steps, or lanes; a bar on stderr appears after half a second."""

    def __init__(self, total: int, show: bool | None, done: int = 0, unit: str = "steps"):
        if show is not None and not isinstance(show, bool):
            raise InputError(f"progress: expected True, False or None for the default, got {shown(show)}.")
        self._unit = unit
        self.total, self.done, self._before = total, done, done
        self._show = (sys.stderr.isatty() or "ipykernel" in sys.modules) if show is None else show
        self._begun, self._bar, self._task = time.perf_counter(), None, None

    def __enter__(self) -> Progress:
        return self

    def advance(self, steps: int) -> None:
        """Count finished steps or lanes."""
        self.done += steps
        if self._bar is None and self._show and time.perf_counter() - self._begun > SHOW_AFTER_SECONDS:
            self._bar, self._task = _bar(self.total)
        if self._bar is not None:
            rate = (self.done - self._before) / (time.perf_counter() - self._begun)
            self._bar.update(
                self._task, completed=self.done, rate=f"{_in_thousands(rate, ('', 'k', 'M', 'G', 'T'))} {self._unit}/s"
            )

    def __exit__(self, *raised: object) -> None:
        if self._bar is not None:
            self._bar.stop()


def _bar(total: int) -> tuple[Any, Any]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress as Bar,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[rate]}"), TimeElapsedColumn())
    # rich asks for ipywidgets in a notebook, whose stderr needs a line of text as well
    plain = {"force_jupyter": False, "force_terminal": True, "width": 100} if "ipykernel" in sys.modules else {}
    console = Console(stderr=True, **plain)  # type: ignore[arg-type]
    bar = Bar(*columns, TextColumn("left"), TimeRemainingColumn(), console=console, transient=True)
    bar.start()
    return bar, bar.add_task("steps", total=total, rate="")


def _in_thousands(x: float, units: Sequence[str]) -> str:
    power = min(len(units) - 1, next((k for k in range(len(units)) if x < 1000 ** (k + 1)), len(units)))
    return f"{x / 1000**power:.3g} {units[power]}".rstrip()


def size_text(size: float) -> str:
    """Bytes with a unit."""
    return _in_thousands(size, ("bytes", "KB", "MB", "GB", "TB", "PB")) if math.isfinite(size) else "unknown"


def duration_text(seconds: float) -> str:
    """Seconds with a unit."""
    for unit, size, most in (("s", 1, 90), ("min", 60, 90), ("hours", 3600, 48), ("days", 86400, 700)):
        if seconds < size * most:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 31557600:.2g} years"
