"""Compiled kernels on disk: each in a folder of its own, whole by its seal or made again.

A kernel's folder holds its source, so that it can be read, its machine code or what Numba keeps of it, and the SHA-256
of all these files; it gets its name when it is whole.  Nothing of it is used before the hashes were compared: half a
file of machine code would be run.  The folders are in KREISEL_CACHE, else in kreisel/ in the cache folder of the
platform.  What cannot be kept there is compiled in memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import linecache
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakValueDictionary

from kreisel.kernels._llvm.machine import Code, assembly, entries_of, loaded, object_code, version
from kreisel.kernels.cache_folder import cache_folder
from kreisel.process import scratch

SEAL, CODE, FORMS = "seal.json", "code.o", "forms.json"
_loaded: WeakValueDictionary[str, ModuleType] = WeakValueDictionary()  # the machine code of a process


@cache
def _operations() -> bytes:
    """The text of what kernels import and is compiled into them."""
    here = Path(__file__).parent
    return b"".join(text.read_bytes() for door in ("_llvm", "_numba") for text in sorted(here.glob(f"{door}/*.py")))


@cache
def _machine(by_numba: bool) -> bytes:
    """What the same source is compiled for, and by what."""
    by: tuple[str, ...] = ()
    if by_numba:
        import numba

        by = sys.version, numba.__version__
    return repr((by, version())).encode()


def load_kernel(source: str, by_numba: bool = False) -> ModuleType:
    """Generated source as a module, compiled once for this machine: by `kreisel.kernels._llvm`, or by Numba."""
    what = hashlib.sha256(_operations() + _machine(by_numba) + source.encode()).hexdigest()[:20]
    return module(f"kreisel_kernel_{what}", source, by_numba)


def module(name: str, source: str, by_numba: bool = False) -> ModuleType:
    """The module of a source: from its folder, or compiled and kept there, or compiled in memory."""
    known = sys.modules.get(name) or _loaded.get(name)
    if known is not None:
        return known
    folder = cache_folder()
    if folder is not None:
        for get in (_cached_module, _made):
            with contextlib.suppress(Exception):  # a full disk, or whatever a file that is not Numba's makes it raise
                found = get(folder / name, source, by_numba)
                if found is not None:
                    return found
    if by_numba:
        return _executed(name, f"<{name}>", source.replace("cache=True", "cache=False"))
    return _of_code(name, *_compiled(name, f"<{name}>", source))


def _cached_module(folder: Path, source: str, by_numba: bool) -> ModuleType | None:
    """What is kept, if it is whole."""
    if not _whole(folder, source):
        return None
    if by_numba:
        return _executed(folder.name, str(_file(folder, folder.name)), source)
    return _of_code(folder.name, (folder / CODE).read_bytes(), json.loads((folder / FORMS).read_bytes()))


def _made(folder: Path, source: str, by_numba: bool) -> ModuleType:
    """Compiled in a folder beside, which takes the name when all is there: another process may do the same."""
    with scratch(folder.parent, f".{folder.name}-", r"\.kreisel_kernel_\w+-") as making:
        file = _file(making, folder.name)
        if by_numba:
            file.write_bytes(source.encode())
            made, seal = _executed(folder.name, str(file), source), _hashes(making)
        else:
            code, forms = _compiled(folder.name, str(file), source)
            made = _of_code(folder.name, code, forms)
            parts = {file.name: source.encode(), CODE: code, FORMS: json.dumps(forms).encode()}
            seal = {name: hashlib.sha256(part).hexdigest() for name, part in parts.items()}
        with contextlib.suppress(OSError):
            for name, part in {} if by_numba else parts.items():
                (making / name).write_bytes(part)
            (making / SEAL).write_bytes(json.dumps(seal).encode())
            if not _whole(folder, source):
                _remove(folder)
                making.rename(folder)
        return made


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


def _compiled(name: str, file: str, source: str) -> tuple[bytes, dict[str, str]]:
    """Machine code of a text, and how its functions are called."""
    try:
        entries = entries_of(vars(_run(ModuleType(name), file, source)))
        return object_code(entries), {name: entry.form for name, entry in entries.items()}
    finally:
        linecache.cache.pop(file, None)


def assembly_of(source: str) -> str:
    """The machine code of a text, to be read."""
    file = f"<{hash(source)}>"
    try:
        return assembly(entries_of(vars(_run(ModuleType("read"), file, source))))
    finally:
        linecache.cache.pop(file, None)


def _of_code(name: str, code: bytes, forms: Mapping[str, str]) -> ModuleType:
    """The module of these functions, which lives as long as one of them."""
    made = ModuleType(name)
    vars(made).update(loaded(code, forms))
    for function in [*vars(made).values()]:
        if isinstance(function, Code):
            function.module = made
    _loaded[name] = made
    return made


def _run(made: ModuleType, file: str, source: str) -> ModuleType:
    made.__file__ = file
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)  # for who reads the code
    exec(compile(source, file, "exec"), made.__dict__)
    return made


def _executed(name: str, file: str, source: str) -> ModuleType:
    """The module of a text.  Numba keeps what it compiles beside `file`, wherever else NUMBA_CACHE_DIR sends it."""
    made = sys.modules[name] = ModuleType(name)
    try:
        with _kept_beside():
            _run(made, file, source)
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
