"""Paths, texts and external files: checked on reading, replaced only if Kreisel wrote them.

Parsers, printers and copies recurse once per level: a few kilobytes of brackets would end in a `RecursionError`
somewhere.  Therefore every text is read here, and data nested deeper than Kreisel's data is refused.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.errors import InputError, on_disk, shown

if TYPE_CHECKING:
    import xarray as xr

DEEPEST = 32  # levels; a sweep's description needs six
MOST_BITS = 4096  # of an integer: longer ones can neither be printed nor used
NESTING = (dict, list, tuple)
CHECKSUMS, BLOCKS = "engine/checksums.sha256", "engine/blocks"  # in a complete archive, and in an unfinished one
NPZ_ATTRIBUTES = "kreisel_attributes"
FILE_MARKS = (  # the beginning of a kind of file, and the mark in it if Kreisel wrote it
    (b"\x89PNG\r\n\x1a\n", b"Software\0Kreisel"),
    (b"GIF89a", b"Film by Kreisel"),
    (b"\0\0\0", b"freeFilm by Kreisel"),  # MP4
    (b"%PDF-", b"/Creator (Kreisel"),
    (b"<?xml", b"<dc:title>Kreisel"),
    (b"<!doctype html>", b'<meta name="generator" content="Kreisel">'),
    (b"\x89HDF\r\n\x1a\n", b"kreisel_"),
    (b"PAR1", b"kreisel"),
    (b"PK\x03\x04", NPZ_ATTRIBUTES.encode() + b".npy"),
    (b"CCSDS_AEM_VERS", b"COMMENT Kreisel"),
    (b"CCSDS_OEM_VERS", b"COMMENT Kreisel"),
    (b"DAF/CK", b"Kreisel"),
    (b"KPL/SCLK", b"Kreisel"),
    (b"# Written by `kreisel new`", b"`kreisel new`"),
    (b"time_s,angular_velocity_x_rad_s", b",attitude_w,"),
)
HEAD = 1 << 20  # bytes at either end of a file that are searched for its mark


def parsed(text: str | bytes, label: str) -> Any:
    """The data in a JSON text; `label` names it in the message.  Raises `InputError`."""
    if not isinstance(text, str | bytes):
        raise InputError(f"{label}: expected text, got {shown(text)}.")
    try:
        value = json.loads(text)
    except RecursionError:
        raise InputError(_too_deep(label)) from None
    except ValueError as error:
        raise InputError(f"{label} is damaged, it is not valid JSON: {error}.") from error
    return shallow(value, label)


def shallow(value: Any, label: str) -> Any:
    """The value itself.  Raises `InputError` if lists and tables are nested too deeply."""
    level = [value]
    for _ in range(DEEPEST):
        for number in level:
            if isinstance(number, int) and number.bit_length() > MOST_BITS:
                raise InputError(
                    f"{label}: expected integers of at most {MOST_BITS:,} bits, got one of {number.bit_length():,}."
                )
        nested = [value.values() if isinstance(value, dict) else value for value in level if isinstance(value, NESTING)]
        level = [inner for values in nested for inner in values]
    if any(isinstance(remainder, NESTING) for remainder in level):
        raise InputError(_too_deep(label))
    return value


def _too_deep(label: str) -> str:
    return (
        f"{label} is nested too deep: at most {DEEPEST} lists or tables inside one another were expected. "
        "It is damaged, or was not made by Kreisel."
    )


def read_values(variable: xr.DataArray | xr.Variable, name: object = None) -> np.ndarray:
    """The values of a variable.  Raises `InputError` if they cannot be read from its archive."""
    try:
        return np.asarray(variable.values)
    except InputError:
        raise
    except Exception as error:  # any exception of the libraries for a damaged chunk
        name, why = name or getattr(variable, "name", "time"), error or type(error).__name__
        raise InputError(f"{name} cannot be read: {why}. `kreisel check` lists the damage.") from error


def place(path: Any, needed: str) -> Path:
    """A path that names a file or folder to create, with ~ expanded.  Raises `InputError`, `needed` in front.

    A single ~ is refused: it is the home folder itself.
    """
    try:
        written = Path(path) if isinstance(path, str | os.PathLike) else Path()
        where = Path() if len(written.parts) == 1 and written.name.startswith("~") else written.expanduser()
        os.fsencode(where)
    except (TypeError, RuntimeError, UnicodeEncodeError):  # of bytes; ~name of an unknown user; half a character
        where = Path()
    if not where.name or "\0" in str(where) or where.name == "..":
        raise InputError(f"{needed}, got {shown(str(path) if isinstance(path, os.PathLike) else path)}.")
    return where


def stands(path: Path) -> bool:
    """Whether anything has that name, including a link without a target."""
    return os.path.lexists(path)


def is_plain(path: Path) -> bool:
    """Whether it is a file that can be read to its end, not a pipe, device, link or folder."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except OSError:
        return False


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def _renamed(scratch: Path, path: Path) -> Iterator[Path]:
    """A context in which a scratch file is written; at its end the file is renamed to `path`, or removed."""
    try:
        yield scratch
        os.replace(scratch, path)
    except BaseException:
        with contextlib.suppress(OSError):
            scratch.unlink()
        raise


def replace_file(path: Path, data: bytes, durable: bool = False) -> None:
    """Write a file next to its name, then rename it."""
    with _renamed(path.with_name(f".new-{secrets.token_hex(8)}"), path) as scratch, scratch.open("xb") as file:
        file.write(data)
        if durable:
            file.flush()
            os.fsync(file.fileno())


def require_outside(path: Path) -> None:
    """Raises `InputError` for a path within an archive, which holds only one run."""
    for folder in Path(os.path.abspath(path)).parents:
        if stands(folder / CHECKSUMS) or stands(folder / BLOCKS):
            raise InputError(f"{path} is within the archive {folder}, which holds one run. Choose a path next to it.")


def place_of_page(path: Any) -> Path:
    """The path of a page to write.  Raises `InputError` for other names than .html and .htm."""
    target = place(path, "The page needs a name such as top.html")
    if target.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"The page needs a name that ends in .html, got {target.name!r}.")
    return target


def require_file(path: Path, overwrite: bool = True) -> None:
    """Raises `InputError` if a file must not be written: the path exists and Kreisel did not write it.

    Without `overwrite` the path must not exist.
    """
    if not path.name or path.name == "..":
        raise InputError(f"A name for the file was expected, such as top.png; got {str(path)!r}.")
    require_outside(path)
    if not stands(path):
        return
    if not _wrote(path):
        cause = " Tables in CSV have no mark." * (path.suffix.lower() == ".csv")
        raise InputError(
            f"{path} is unchanged: expected nothing there or a file that Kreisel wrote and marked, got something else."
            f"{cause} Choose another name, or move it away."
        )
    if not overwrite:
        raise InputError(
            f"{path} exists already and is unchanged. Choose another name, or overwrite=True (--overwrite)."
        )


def _wrote(path: Path) -> bool:
    """Whether a file has the mark of Kreisel in its metadata."""
    if not is_plain(path):
        return False
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
            file.seek(max(0, os.fstat(file.fileno()).st_size - HEAD))
            tail = file.read(HEAD)
    except OSError:
        return False
    return any(
        head[: len(begin)].lower() == begin.lower() and (mark in head or mark in tail) for begin, mark in FILE_MARKS
    )


@contextlib.contextmanager
def written(path: Path, overwrite: bool = True) -> Iterator[Path]:
    """A scratch file next to `path`, renamed to `path` when it is complete.

    Raises `InputError` if the path exists and must stay, and `RunError` if the disk refuses.
    """
    with on_disk(path, "be written"):
        require_file(path, overwrite)
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = path.with_name(f".{path.stem[:40]}-{secrets.token_hex(8)}{path.suffix}")
        scratch.open("x").close()
        with _renamed(scratch, path):
            yield scratch
            require_file(path, overwrite)
