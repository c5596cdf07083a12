"""The manifest of an archive: the SHA-256 of every file in it, so that each chunk is bound to its place.

A whole archive has engine/checksums.sha256, which `sha256sum -c` reads too.  While an archive is being made, each
finished block of rows or lanes has a file engine/blocks/K.sha256 instead.  One more file lists the metadata as they are
and as they are about to become.  So a kill at any moment leaves only files that are listed.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from kreisel.errors import InputError
from kreisel.files import digest, replace_file

NAME = "engine/checksums.sha256"
BLOCKS = "engine/blocks"
METADATA, BEFORE = f"{BLOCKS}/metadata.sha256", f"{BLOCKS}/before.sha256"
REPLACES = "engine/replaces"  # of a store that is being made: what it may replace
LINE = re.compile(r"([0-9a-f]{64})  ([^\0\n]+)")
LARGEST = 1 << 30  # bytes of a manifest

Listed = dict[str, frozenset[str]]  # the files of a store, and what the SHA-256 of each may be


def is_chunk(name: str) -> bool:
    """Whether a file of a store holds numbers, not metadata."""
    return name.split("/")[1:2] == ["c"]


def is_scratch(name: str) -> bool:
    """Whether a kill left it, of a file that was being written."""
    return name.endswith(".partial") or name.split("/")[-1].startswith(".new-")


def manifest_text(pairs: Iterable[tuple[str, str]]) -> bytes:
    """The lines of files and their SHA-256."""
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(pairs)).encode()


def _read_lines(path: Path) -> Iterator[tuple[str, str]]:
    """Name and SHA-256 of each line.  Raises `InputError` for what is no manifest."""
    try:
        if not stat.S_ISREG(os.lstat(path).st_mode) or path.stat().st_size > LARGEST:
            raise InputError(f"{path} is damaged: expected a text file of checksums, got something else.")
        lines = path.read_bytes().decode().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read: {error}. `kreisel check` says what is whole.") from error
    for line in lines:
        found = LINE.fullmatch(line)
        if found is None:
            raise InputError(f"{path} is damaged: expected lines of a SHA-256 and a name, got {line[:80]!r}.")
        yield found[2], found[1]


def listed(store: Path) -> Listed:
    """The manifest of a store, as far as it can be read; of an unfinished one, the files of all blocks together."""
    found: dict[str, set[str]] = {}
    for path in files(store):
        with contextlib.suppress(InputError):
            for name, digest in _read_lines(path):
                found.setdefault(name, set()).add(digest)
    return {name: frozenset(digests) for name, digests in found.items()}


def read(store: Path) -> Listed:
    """The manifest of a store.  Raises `InputError` where there is none, or it is damaged."""
    there = files(store)
    if not there:
        raise InputError(
            f"{store} is damaged: {NAME} is missing. Usual cause: a copy of a run by its to_zarr, which is a plain "
            "Dataset without checksums: xr.open_zarr opens it. kr.simulate(..., path=...) makes an archive."
        )
    for path in there:
        for _ in _read_lines(path):
            pass
    return listed(store)


def files(store: Path) -> list[Path]:
    """The files of the manifest: one, or those of the blocks."""
    if whole(store):
        return [store / NAME]
    try:
        return sorted(store / BLOCKS / name for name in os.listdir(store / BLOCKS) if name.endswith(".sha256"))
    except OSError:
        return []


def blocks_done(store: Path) -> set[int]:
    """The numbers of the blocks that are written."""
    return {int(path.stem) for path in files(store) if path.stem.isdigit()}


def begin(store: Path) -> None:
    """List the metadata of a store as they are now."""
    (store / BLOCKS).mkdir(parents=True, exist_ok=True)
    replace_file(store / METADATA, manifest_text((name, digest(store / name)) for name in metadata_files(store)))


def begun(store: Path) -> bool:
    """Whether a store is being made and its metadata are listed, or is whole."""
    return whole(store) or os.path.lexists(store / METADATA)


def add_block(store: Path, block: int | str, names: Iterable[str], durable: bool = False) -> None:
    """Say that these files of a block are written."""
    lines = manifest_text((name, digest(store / name)) for name in names)
    replace_file(store / BLOCKS / f"{block}.sha256", lines, durable)


def metadata_files(store: Path) -> list[str]:
    """The names of every zarr.json."""
    return sorted(path.relative_to(store).as_posix() for path in store.rglob("zarr.json"))


def seal(store: Path, others: Iterable[str]) -> None:
    """Make the manifest of a whole archive from the files of its blocks.

    The metadata and `others` are listed as they are now.  Raises `FileNotFoundError` where a chunk that was written is
    gone.
    """
    chunks = [(name, known) for name, (known, *_) in listed(store).items() if is_chunk(name)]
    for name, _ in chunks:
        os.stat(store / name)
    rest = [(name, digest(store / name)) for name in (*metadata_files(store), *others)]
    replace_file(store / NAME, manifest_text((*chunks, *rest)))
    clear(store)


def remove_scratch(store: Path, unlisted: bool = False) -> None:
    """Remove what a kill left half written, and with `unlisted` chunks that are not listed yet."""
    known = listed(store) if unlisted else {}
    for path in [path for path in store.rglob("*") if not path.is_dir()]:
        name = path.relative_to(store).as_posix()
        if is_scratch(name) or (unlisted and is_chunk(name) and name not in known):
            path.unlink(missing_ok=True)


def whole(store: Path) -> bool:
    """Whether a store has the manifest of a whole archive."""
    return os.path.lexists(store / NAME)


def clear(store: Path) -> None:
    """Remove the files of the blocks, beside the manifest of a whole archive."""
    with contextlib.suppress(FileNotFoundError):
        for path in (store / BLOCKS).iterdir():
            path.unlink()
        (store / BLOCKS).rmdir()


def unseal(store: Path, keep: int) -> None:
    """Go back to one file for each block: the store goes on after its first `keep` blocks; later ones are dropped."""
    known = listed(store)
    kept = [(n, t) for n, digests in known.items() for t in digests if is_chunk(n) and _block_of(n) < keep]
    metadata = [(n, t) for n, digests in known.items() for t in digests if n.endswith("zarr.json")]
    (store / BLOCKS).mkdir(exist_ok=True)
    replace_file(store / BEFORE, manifest_text(kept))
    replace_file(store / METADATA, manifest_text(metadata))
    with contextlib.suppress(FileNotFoundError):
        (store / NAME).unlink()
    for path in files(store):
        if path.stem.isdigit():
            path.unlink()


def _block_of(name: str) -> int:
    """The number of a chunk's block of rows: the first index in its name.  `lane` is made with the first block."""
    places = name.split("/")[2:]
    return int(places[0]) if places else 0


def of_all(store: Path) -> None:
    """Write the manifest of a store that is whole, of all that is in it."""
    names = [Path(folder, name).relative_to(store).as_posix() for folder, _, some in os.walk(store) for name in some]
    (store / NAME).parent.mkdir(exist_ok=True)
    replace_file(store / NAME, manifest_text((name, digest(store / name)) for name in names))


def faults(store: Path, known: Listed) -> list[tuple[str, str]]:
    """The faults of all files but listed chunks, each with its sentence.  Chunks are compared when arrays are read."""
    found = []
    names = {Path(folder, name).relative_to(store).as_posix() for folder, _, some in os.walk(store) for name in some}
    for name in sorted(names | set(known)):
        if name == REPLACES and store.name.endswith(".part"):
            continue
        if name == NAME or name.startswith(f"{BLOCKS}/") or (is_chunk(name) and name in known):
            continue
        array = name.removesuffix("/zarr.json")
        if name not in known:
            found.append((name, f"{array} was added after the run"))
        elif name not in names:
            found.append((name, f"{array} is missing"))
        else:
            try:
                changed = digest(store / name) not in known[name]
            except OSError as error:
                found.append((name, f"{name} cannot be read: {error.strerror}"))
                continue
            found += [(name, f"{name} was changed after the run")] * changed
    return found
