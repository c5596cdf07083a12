"""Folders in which a writer makes something whole.  What a killed writer left is removed by the next one.

A folder is locked by its writer (flock), as long as the process lives: one that nobody locks is stale.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
import time
from collections.abc import Collection, Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows, where nothing is swept
    fcntl = None  # type: ignore[assignment]

YOUNG = 1.0  # seconds, in which a new folder may not be locked yet


@contextlib.contextmanager
def scratch(parent: Path, prefix: str, family: str = "", files: Collection[str] | None = None) -> Iterator[Path]:
    """A new folder in `parent`, removed at the end; stale ones of the same family of prefixes are removed before.

    family  a regular expression of prefixes; default: the prefix
    files   the names of all that a writer makes there; a folder with anything else stays
    """
    with contextlib.suppress(OSError):
        _sweep(parent, re.compile(rf"({family or re.escape(prefix)})\w{{8}}"), files)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    handle = _locked(folder)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if handle is not None:
            os.close(handle)


def _locked(folder: Path) -> int | None:
    """A handle that locks a folder; None if a living process has locked it."""
    if fcntl is None:
        return None
    handle = None
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # locked, gone, or a file system without locks
        if handle is not None:
            os.close(handle)
        return None
    return handle


def _sweep(parent: Path, names: re.Pattern[str], files: Collection[str] | None) -> None:
    with os.scandir(parent) as entries:
        found = [entry for entry in entries if names.fullmatch(entry.name)]
    for entry in found:
        status = entry.stat(follow_symlinks=False)
        if not entry.is_dir(follow_symlinks=False) or time.time() - status.st_mtime < YOUNG:
            continue
        if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
            continue
        handle = _locked(Path(entry))
        if handle is None:
            continue
        try:
            if files is None or set(os.listdir(entry)) <= set(files):
                shutil.rmtree(entry, ignore_errors=True)
        finally:
            os.close(handle)
