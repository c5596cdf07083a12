"""What may be replaced on disk, and how: only what Kreisel made, and only by something that is whole.

A new archive is made as NAME.part.  To take the name of an old one it goes through two renames: NAME becomes
.NAME.replaced, NAME.part becomes NAME, and the old one is removed.  A kill in between leaves one of these states;
`settle` ends it.  NAME.part says which archive it may replace, so that a run that is resumed may do so too.

A folder is removed file by file, only files that Kreisel or Zarr makes: what somebody else has put there stays, and so
does the folder around it.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from kreisel.errors import InputError, RunError
from kreisel.files import CHECKSUMS, digest, is_plain, replace_file, require_outside, stands
from kreisel.process import Lock
from kreisel.storage.manifest import REPLACES, listed

LARGEST_METADATA = 64 << 20  # bytes of a zarr.json: the parameters of an ensemble may be long
PARTIAL = r"(\.[0-9a-f]{32}\.partial)?"  # what a kill leaves of a file that Zarr was writing
CHUNK = re.compile(rf"[^/]+/c(/\d+)*{PARTIAL}")
MADE = re.compile(
    rf"([^/]+/)?zarr(\.json|\.[0-9a-f]{{32}}\.partial)|{CHUNK.pattern}"
    r"|engine/(checkpoint\.npz|checksums\.sha256|replaces|blocks/(\.new-[0-9a-f]{16}|\w+\.sha256))|([^/]+/)?\.new-[0-9a-f]{16}"
)
CHECKPOINT = "engine/checkpoint.npz"


def part_of(path: Path) -> Path:
    """Where an archive is made.  Raises `InputError` for the name of one that is being made."""
    if path.suffix == ".part":
        raise InputError(f"{path}: expected a name that does not end in .part, as that of an unfinished archive does.")
    return path.with_name(f"{path.name}.part")


def replaced(path: Path) -> Path:
    """Where the old archive of that name waits for the new one to be there."""
    return path.with_name(f".{path.name}.replaced")


def why_not(path: Path) -> str | None:
    """Why a folder must not be replaced, in a clause; None for an archive or a store of Kreisel, whole or partial."""
    kind = os.lstat(path).st_mode
    if stat.S_ISLNK(kind):
        return "is a link"
    if not stat.S_ISDIR(kind):
        return "is no folder"
    here, inner = Path.cwd().resolve(), path.resolve()
    if inner == here or inner in here.parents:
        return "is the working folder, or one around it"
    foreign = next(_foreign(path), None)
    if foreign is not None:
        return f"holds {foreign}, which Kreisel did not write"
    if not _says_so(path) and any(not CHUNK.fullmatch(name) for name in _files(path)):
        return "does not say that it is an archive of Kreisel"
    return None


def require_replaceable(path: Path) -> None:
    """Raises `InputError` where something stands that is no archive of Kreisel, and within another archive."""
    require_outside(path)
    why = why_not(path) if stands(path) else None
    if why is not None:
        raise InputError(
            f"{path} is left as it is: expected nothing there or an archive of Kreisel, but it {why}. Choose another "
            "path, or move it away."
        )


def _says_so(store: Path) -> bool:
    """Whether a folder calls itself a run or a sweep, or holds nothing: what a kill leaves of one just begun."""
    try:
        if (store / "zarr.json").stat().st_size > LARGEST_METADATA:
            return False
        attrs = json.loads((store / "zarr.json").read_bytes())["attributes"]
    except FileNotFoundError:
        return all(".partial" in name for name in _files(store))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False
    return "kreisel_format" in attrs or "kreisel_sweep" in attrs


def _files(store: Path) -> Iterator[str]:
    """The names in a folder of all that is no folder, relative to it."""
    for folder, folders, files in os.walk(store):
        links = [name for name in folders if os.path.islink(os.path.join(folder, name))]
        for name in (*files, *links):
            yield Path(folder, name).relative_to(store).as_posix()


def _foreign(store: Path) -> Iterator[str]:
    """Those among them that neither Kreisel nor Zarr makes, that are no plain files, or that belong to other arrays."""
    arrays = {name.removesuffix("/zarr.json") for name in listed(store) if name.endswith("/zarr.json")} - {"engine"}
    for name in _files(store):
        first = name.split("/")[0]
        added = arrays and "/" in name and first not in ("engine", *arrays)
        if added or not MADE.fullmatch(name) or not stat.S_ISREG(os.lstat(store / name).st_mode):
            yield name


def remove(store: Path) -> None:
    """Remove an archive or a store.  Raises `InputError` where there is something else, and removes no file of that."""
    require_replaceable(store)
    made = [name for name in _files(store) if MADE.fullmatch(name)]
    for name in sorted(
        made, key=lambda name: (name != CHECKPOINT, not name.startswith("engine/"), name == "zarr.json")
    ):
        os.unlink(store / name)  # what is left by a kill cannot go on, and says to the end what it was
    for folder, folders, _ in os.walk(store, topdown=False):
        for name in folders:
            os.rmdir(os.path.join(folder, name))
    os.rmdir(store)


def agree(path: Path) -> None:
    """Write down in NAME.part that it may replace what has its name now, with --overwrite."""
    replace_file(part_of(path) / REPLACES, _mark(path).encode())


def agreed(path: Path) -> bool:
    """Whether NAME.part may replace what has its name."""
    try:
        consent = part_of(path) / REPLACES
        return is_plain(consent) and consent.read_text() == _mark(path)
    except (OSError, UnicodeDecodeError):
        return False


def _mark(path: Path) -> str:
    """What tells one archive from another: the SHA-256 of its manifest, or of its attributes where it has none."""
    for name in (CHECKSUMS, "zarr.json"):
        if is_plain(path / name):
            return digest(path / name)
    return "something" if stands(path) else "nothing"


def take_name(path: Path) -> None:
    """Give NAME.part its name; an archive that has it is replaced where that was agreed.

    Raises `RunError` where something else has come to stand there: what is done stays in NAME.part.
    """
    part, old = part_of(path), replaced(path)
    if stands(path):
        why = why_not(path) if agreed(path) else "was made there by somebody else during the run"
        if why is not None:
            raise RunError(
                f"{path} is left as it is: it {why}. The run is whole and kept in {part}. Move {path} away, then "
                f"`kreisel resume {path}` gives the run its name."
            )
        if stands(old):
            remove(old)
        os.replace(path, old)
    (part / REPLACES).unlink(missing_ok=True)
    os.replace(part, path)
    if stands(old):
        remove(old)


def settle(path: Path) -> bool:
    """Finish what a kill left of `take_name`; whether a whole NAME.part got its name.  The caller is the one writer."""
    part, old = part_of(path), replaced(path)
    if not stands(old) or why_not(old) is not None:
        return False
    if not stands(path):
        if _complete(part):
            take_name(path)
            return True
        os.replace(old, path)
    if stands(old):
        remove(old)
    return False


def _complete(part: Path) -> bool:
    try:
        return (
            is_plain(part / "zarr.json")
            and json.loads((part / "zarr.json").read_bytes())["attributes"]["complete"] == 1
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def settled(path: Path) -> Path:
    """The path itself, after `settle` where that is needed and nobody is writing.  A lock left by a kill is removed."""
    if path.name and (stands(replaced(path)) or stands(Lock(path).path)):
        with contextlib.suppress(InputError, RunError, OSError), Lock(path):
            settle(path)
    return path
