"""Machine code on disk: each kernel a file, whole by the hash in its head or made again.

The files are in KREISEL_CACHE, else in kreisel/ in the cache folder of the platform.  Nothing of a file is used before
its hash was compared: half a file of machine code would be run.  What cannot be kept there is compiled in memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from kreisel.kernels.cache_folder import cache_folder

SUFFIX = ".kernel"


def kept(name: str, make: Callable[[], bytes]) -> bytes:
    """The code of that name: from its file, or made and kept there if that can be."""
    folder = cache_folder()
    if folder is None:
        return make()
    file = folder / (name + SUFFIX)
    code = _read(file)
    if code is None:
        code = make()
        with contextlib.suppress(OSError):  # a full disk, or something else in its place
            _write(file, code)
    return code


def _read(file: Path) -> bytes | None:
    """What a whole file has."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    seal, code = content[:32], content[32:]
    return code if hashlib.sha256(code).digest() == seal else None


def _write(file: Path, code: bytes) -> None:
    """Into a file beside, which takes the name when all is there: another process may do the same."""
    handle, name = tempfile.mkstemp(prefix=".kernel-", dir=file.parent)
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(hashlib.sha256(code).digest() + code)
        os.replace(name, file)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise
