"""What lets a run go on after a kill: a checkpoint beside the data, one writer at a time, signals that wait.

The checkpoint is one file of plain arrays (.npz without pickle; zip keeps a CRC-32 of each), replaced atomically.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import json
import math
import os
import signal
import socket
import stat
import threading
import tokenize
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from kreisel.errors import InputError, disk_trouble
from kreisel.kernels.layout import Floats

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]
from kreisel.runs.integration import Snapshot
from kreisel.storage.manifest import replace_file
from kreisel.storage.reading import parsed

ABOUT = "about"  # JSON: dimensions and attributes of what is shown
NAME = "engine/checkpoint.npz"  # in a group of its own, where Zarr does not look for arrays


def hash_of_start(start: Mapping[str, Floats]) -> str:
    """SHA-256 of the initial state, which binds a checkpoint to the attributes of its run."""
    digest = hashlib.sha256()
    for name, value in sorted(start.items()):
        array = np.ascontiguousarray(value, dtype="<f8")
        digest.update(f"{name} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()


def write(store: Path, snapshot: Snapshot, start: Mapping[str, Floats]) -> None:
    """Replace the checkpoint of a store by this snapshot and the start of the run, atomically and durably."""
    arrays = {
        "flushed": np.asarray(snapshot.flushed),
        "into": np.asarray(snapshot.into),
        "rows": snapshot.rows,
        **{f"engine/{name}": value for name, value in snapshot.engine.items()},
        **{f"start/{name}": value for name, value in start.items()},
        **{f"shown/{name}": value for name, (_, value, _) in snapshot.shown.items()},
    }
    if snapshot.shown:
        about = {name: (dims, attrs) for name, (dims, _, attrs) in snapshot.shown.items()}
        arrays[ABOUT] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    data = io.BytesIO()
    np.savez(data, allow_pickle=False, **arrays)
    replace_file(store / NAME, data.getvalue(), durable=True)


def read(store: Path) -> tuple[Snapshot, dict[str, Floats]]:
    """The snapshot and the start.  Raises `InputError` where there is none, or it is damaged."""
    path = store / NAME
    if not path.exists():
        raise InputError(f"{store} has no checkpoint to go on from. Run it again from its TOML file.")
    try:
        arrays = _arrays(path)
        engine, start = (
            {k.split("/", 1)[1]: v for k, v in arrays.items() if k.startswith(p)} for p in ("engine/", "start/")
        )
        about = parsed(arrays[ABOUT].tobytes().decode(), str(path)) if ABOUT in arrays else {}
        shown = {name: (tuple(dims), arrays[f"shown/{name}"], attrs) for name, (dims, attrs) in about.items()}
        return Snapshot(int(arrays["flushed"]), int(arrays["into"]), arrays["rows"], engine, shown), start
    except DAMAGE as error:
        raise InputError(f"The checkpoint {path} is damaged: {error}. Run it again from its TOML file.") from error


# What a damaged .npz makes zipfile and NumPy raise: NotImplementedError where a kind of compression or encryption is
# not known, the last three where the header of an array, a Python literal, is never closed or nested too deep.
DAMAGE = (
    OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError, NotImplementedError, tokenize.TokenError,
    RecursionError, MemoryError,
)  # fmt: skip


def _arrays(path: Path) -> dict[str, Any]:
    """The arrays of an .npz file, each as long as the file has bytes for it.  Raises `ValueError` for others."""
    out = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.compress_type != zipfile.ZIP_STORED or member.file_size > path.stat().st_size:
                raise ValueError(f"{member.filename} claims {member.file_size:,} bytes")
            data = io.BytesIO(archive.read(member))  # this verifies the CRC
            version = np.lib.format.read_magic(data)
            if version != (1, 0):
                raise ValueError(f"{member.filename} is no array")
            shape, _, dtype = np.lib.format.read_array_header_1_0(data)
            if dtype.kind not in "iuf" or math.prod(shape) * dtype.itemsize != member.file_size - data.tell():
                raise ValueError(f"{member.filename} claims to hold {shape} of {dtype}")
            data.seek(0)
            out[member.filename.removesuffix(".npy")] = np.lib.format.read_array(data, allow_pickle=False)
    return out


class Lock:
    """One writer: NAME.lock, held by the operating system for as long as the writer lives.

    A lock file that nobody holds is stale, and is taken over.  Raises `InputError` with the other writer's host and
    process id, and `RunError` where no file can be made.
    """

    def __init__(self, path: Path):
        self.archive, self.path = path, path.with_name(f"{path.name}.lock")

    def __enter__(self) -> Lock:
        if fcntl is None:
            raise InputError(NO_LOCKS.format(path=self.archive))
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise InputError(f"{self.path} is a link and is left as it is. {LOCK_REMEDY}") from None
            raise disk_trouble(error, self.archive, "be created", "") from error
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            text = _lock_text(self._handle)
            os.close(self._handle)
            raise InputError(
                f"{self.archive} is being written by {_owner(text)}. Wait for it, stop it, or choose another path."
            ) from None
        if not self._is_ours():  # unlinked by the writer before, between our open and our lock
            os.close(self._handle)
            return self.__enter__()
        if not stat.S_ISREG(os.fstat(self._handle).st_mode) or not _is_lock(_lock_text(self._handle)):
            os.close(self._handle)
            raise InputError(f"{self.path} is no lock of Kreisel and is left as it is. {LOCK_REMEDY}")
        os.ftruncate(self._handle, 0)
        os.pwrite(self._handle, json.dumps({"host": socket.gethostname(), "pid": os.getpid()}).encode(), 0)
        return self

    def _is_ours(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._handle), os.stat(self.path))
        except OSError:
            return False

    def __exit__(self, *raised: object) -> None:
        with contextlib.suppress(OSError):
            os.unlink(self.path)
        os.close(self._handle)


NO_LOCKS = (
    "{path}: expected a system with the locks of POSIX, by which one process at a time writes an archive; got one "
    "without (Windows). Keep the run in memory (without path=) and save it by kr.export(run, 'run.nc'), or use Linux, "
    "macOS or WSL."
)
LOCK_REMEDY = "A lock stands there while an archive is written: move it away, or choose another path."


def _lock_text(handle: int) -> str:
    """What a file says, as far as it can be read."""
    try:
        return os.pread(handle, 4096, 0).decode(errors="replace")
    except OSError:  # a pipe or a device
        return ""


def _is_lock(text: str) -> bool:
    """Whether a file that no process holds is a lock left by a kill, and not a file of somebody else."""
    try:
        return not text or set(json.loads(text)) == {"host", "pid"}
    except (ValueError, TypeError, RecursionError):
        return False


def _owner(text: str) -> str:
    try:
        data = parsed(text, "The lock")
        return f"process {data['pid']} on host {data['host']}"
    except (ValueError, KeyError, TypeError):
        return "another process"


class Stop:
    """Whether Ctrl-C or SIGTERM was received; `signal` is its number."""

    signal: int | None = None


@contextlib.contextmanager
def signals_to(handler: Callable[[int, FrameType | None], None]) -> Iterator[dict[int, Any]]:
    """Inside, Ctrl-C and SIGTERM go to a handler; gives those from before.  Main thread only."""
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
    """Inside, the first Ctrl-C or SIGTERM only sets a flag; a second one acts as usual.  Main thread only."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def note(number: int, frame: FrameType | None) -> None:
        stop.signal = number
        signal.signal(number, before[number])

    with signals_to(note) as before:
        yield stop
