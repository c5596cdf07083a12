"""Machine code on disk: each kernel a file, complete by the seal at its head or made again.

The files are in KREISEL_CACHE, else in kreisel/ in the cache folder of the platform.  The seal is the SHA-256 of the
name and of all that follows; nothing of a file is used before it was compared: half a file of machine code would be
run.  Code that cannot be kept there is compiled in memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

OTHERS_MAY_WRITE = 0o022


def cache_folder() -> Path | None:
    """Where kernels are kept; None if nothing can be, or should not be, because somebody else may write there.

    It holds code that is run.
    """
    asked = os.environ.get("KREISEL_CACHE")
    try:
        folder = Path(asked) if asked else user_cache_path("kreisel", appauthor=False)
        if not asked and not folder.is_absolute():  # no home
            return None
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except (OSError, RuntimeError, ValueError):  # a name that cannot be
        return None
    if not hasattr(os, "geteuid"):  # Windows, where the folder is the user's
        return folder
    if status.st_uid != os.geteuid() or status.st_mode & OTHERS_MAY_WRITE:
        _refused(str(folder), status.st_uid, status.st_mode & 0o777)
        return None
    return folder


@cache
def _refused(folder: str, owner: int, mode: int) -> None:
    warnings.warn(
        f"the cache of kernels {folder!r} is not used, and kernels are compiled in memory: expected a folder of user "
        f"{os.geteuid()} that nobody else may write to, because it holds code; got owner {owner}, mode {mode:03o}. "
        "Usual cause: a shared folder, or an umask that lets the group write. Use chmod 700, or name another folder in "
        "KREISEL_CACHE.",
        RuntimeWarning,
        stacklevel=2,
    )


SUFFIX, HALF, SEAL = ".kernel", ".kernel-", 32
LONG = 60.0  # seconds; a file is written in less


def kept(name: str, make: Callable[[], bytes]) -> bytes:
    """The code of that name: from its file, or made and kept there if that can be."""
    folder = cache_folder()
    if folder is None:
        return make()
    file = folder / (name + SUFFIX)
    code = _read(file)
    if code is None:
        code = make()
        with contextlib.suppress(OSError):  # a full disk, or a folder that nobody may write to
            _write(file, code)
    return code


def _seal(file: Path, code: bytes) -> bytes:
    return hashlib.sha256(file.name.encode() + code).digest()


def _read(file: Path) -> bytes | None:
    """The code of a complete file; None for all else, of which nothing is waited for or followed."""
    try:
        handle = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0))
        with os.fdopen(handle, "rb") as opened:
            content = opened.read() if stat.S_ISREG(os.fstat(handle).st_mode) else b""
    except OSError:
        return None
    seal, code = content[:SEAL], content[SEAL:]
    return code if seal == _seal(file, code) else None


def _write(file: Path, code: bytes) -> None:
    for half in file.parent.glob(f"{HALF}*"):  # of writers that were killed
        with contextlib.suppress(OSError):
            if half.stat().st_mtime < time.time() - LONG:
                half.unlink()
    handle, name = tempfile.mkstemp(prefix=HALF, dir=file.parent)
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(_seal(file, code) + code)
        if file.is_dir() and not file.is_symlink():
            shutil.rmtree(file)
        os.replace(name, file)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise
