"""The folder in which compiled code is kept."""

from __future__ import annotations

import os
import warnings
from functools import cache
from pathlib import Path

from platformdirs import user_cache_path

OTHERS_MAY_WRITE = 0o022


def cache_folder() -> Path | None:
    """Where kernels are kept; None where nothing can be, or should not be, because somebody else may write there.

    It holds code that is run.
    """
    own = os.environ.get("KREISEL_CACHE")
    try:
        folder = Path(own) if own else user_cache_path("kreisel", appauthor=False)
        if not own and not folder.is_absolute():  # no home
            return None
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except (OSError, RuntimeError, ValueError):  # a name that cannot be
        return None
    if not hasattr(os, "geteuid"):  # Windows, where the folder is in the user's own
        return folder
    if status.st_uid != os.geteuid() or status.st_mode & OTHERS_MAY_WRITE:
        _refused(str(folder), status.st_uid, status.st_mode & 0o777)
        return None
    return folder


@cache
def _refused(folder: str, owner: int, mode: int) -> None:
    """Say once that a folder is not used."""
    warnings.warn(
        f"the cache of kernels {folder!r} is not used, and kernels are compiled in memory: expected a folder of user "
        f"{os.geteuid()} that nobody else may write to, because it holds code; got owner {owner}, mode {mode:03o}. "
        "Usual cause: a shared folder, or an umask that lets the group write. Use chmod 700, or name another folder in "
        "KREISEL_CACHE.",
        RuntimeWarning,
        stacklevel=2,
    )
