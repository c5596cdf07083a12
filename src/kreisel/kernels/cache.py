"""Compiled kernels on disk: each in a folder of its own, whole by its seal or made again.

A kernel's folder holds its source, so that it can be read, what Numba keeps of it, and the SHA-256 of all these files;
it gets its name when it is whole.  Nothing of it is used before the hashes were compared: half a file of machine code
would be run.  The folders are in KREISEL_CACHE, else in kreisel/ in the cache folder of the platform.  What cannot be
kept there is compiled in memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import linecache
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from platformdirs import user_cache_path

SEAL = "seal.json"
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


@cache
def _operations() -> bytes:
    """The text of what kernels import, which Numba compiles into them: its own cache does not see it change."""
    folder = Path(__file__).with_name("_numba")
    return b"".join(
        (folder / f"{name}.py").read_bytes()
        for name in ("double_double", "fused", "straight", "vector_type", "vectors", "pointers", "projecting")
    )


@cache
def _machine() -> bytes:
    """What the same source is compiled for, and by what."""
    import numba
    from numba.core.registry import cpu_target

    return repr((sys.version, numba.__version__, cpu_target.target_context.codegen().magic_tuple())).encode()


def load_kernel(source: str) -> ModuleType:
    """Generated source as a module, compiled once for this machine."""
    what = hashlib.sha256(_operations() + _machine() + source.encode()).hexdigest()[:20]
    return module(f"kreisel_kernel_{what}", source)


def module(name: str, source: str) -> ModuleType:
    """The module of a source: from its folder, or compiled and kept there, or compiled in memory."""
    if name in sys.modules:
        return sys.modules[name]
    folder = cache_folder()
    if folder is not None:
        for get in (_cached_module, _made):
            with contextlib.suppress(Exception):  # a full disk, or whatever a file that is not Numba's makes it raise
                found = get(folder / name, source)
                if found is not None:
                    return found
    return _executed(name, f"<{name}>", source.replace("cache=True", "cache=False"))


def _cached_module(folder: Path, source: str) -> ModuleType | None:
    """What is kept, if it is whole."""
    return _executed(folder.name, str(_file(folder, folder.name)), source) if _whole(folder, source) else None


def _made(folder: Path, source: str) -> ModuleType:
    """Compiled in a folder beside, which takes the name when all is there: another process may do the same."""
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        file = _file(scratch, folder.name)
        file.write_text(source, encoding="utf-8")
        made = _executed(folder.name, str(file), source)
        with contextlib.suppress(OSError):
            (scratch / SEAL).write_text(json.dumps(_hashes(scratch)), encoding="utf-8")
            if not _whole(folder, source):
                _remove(folder)
                scratch.rename(folder)
        return made
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _file(folder: Path, name: str) -> Path:
    return folder / f"{name}.py"


def _whole(folder: Path, source: str) -> bool:
    """Whether a folder has a seal, and every file in it has the hash that stands there."""
    try:
        if not (folder / SEAL).is_file() or (folder / SEAL).is_symlink():
            return False
        sealed, found = json.loads((folder / SEAL).read_bytes()), _hashes(folder)
    except (OSError, ValueError, RecursionError):
        return False
    return bool(sealed == found and found.get(f"{folder.name}.py") == hashlib.sha256(source.encode()).hexdigest())


def _hashes(folder: Path) -> dict[str, str]:
    """The SHA-256 of every file but the seal.  Raises `ValueError` for what is neither a file nor a folder."""
    out: dict[str, str] = {}
    with os.scandir(folder) as entries:
        found = list(entries)
    for entry in found:
        if entry.is_dir(follow_symlinks=False):
            out |= {f"{entry.name}/{name}": value for name, value in _hashes(Path(entry)).items()}
        elif not entry.is_file(follow_symlinks=False):
            raise ValueError(entry.name)
        elif entry.name != SEAL:
            out[entry.name] = hashlib.sha256(Path(entry).read_bytes()).hexdigest()
    return out


def _remove(entry: Path) -> None:
    """Take away what stands in the place of a kernel."""
    if entry.is_symlink() or not entry.is_dir():
        entry.unlink(missing_ok=True)
        return
    for folder in (entry, entry / "__pycache__"):
        if not folder.is_symlink():
            with contextlib.suppress(OSError):
                folder.chmod(0o700)
    shutil.rmtree(entry)


def _executed(name: str, file: str, source: str) -> ModuleType:
    """The module of a text.  Numba keeps what it compiles beside `file`, wherever else NUMBA_CACHE_DIR sends it."""
    made = ModuleType(name)
    made.__file__ = file
    sys.modules[name] = made
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)  # for who reads the code
    try:
        with _kept_beside():
            exec(compile(source, file, "exec"), made.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return made


@contextlib.contextmanager
def _kept_beside() -> Iterator[None]:
    from numba.core import config as settings

    config: Any = settings
    asked = config.CACHE_DIR
    config.CACHE_DIR = ""
    try:
        yield
    finally:
        config.CACHE_DIR = asked
