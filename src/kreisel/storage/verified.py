"""A Zarr store that gives only files that are as they were written, and changes of metadata that survive a kill."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import os
import stat
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec
from zarr.core.buffer import Buffer, BufferPrototype, cpu, default_buffer_prototype
from zarr.storage import LocalStore, MemoryStore

from kreisel.errors import InputError
from kreisel.files import digest, replace_file
from kreisel.storage import manifest

REMEDY = "`kreisel check` says what else is; --recover saves the rows that are whole."


class Damaged(InputError):
    """A file of an archive that is not as it was written; `why` in a clause."""

    why = ""


def damaged(root: Path, why: str) -> Damaged:
    """The error for it."""
    error = Damaged(f"{root} is damaged: {why}. {REMEDY}")
    error.why = why
    return error


class Verified(LocalStore):
    """A store that is read only as it was written: a file that is changed, missing or added raises `InputError`."""

    def __init__(self, root: Path | str, known: manifest.Listed, partial: bool = False):
        """`partial`: chunks that are not listed are not read, since their blocks are still to do, or being written."""
        super().__init__(root, read_only=True)
        self._known, self._partial = known, partial
        self._seen: dict[str, tuple[int, ...]] = {}

    def with_read_only(self, read_only: bool = False) -> Verified:
        """The store itself: it is never written to."""
        return self

    def _to_do(self, key: str) -> bool:
        """Whether a file is a chunk of a block that is not done."""
        return self._partial and key not in self._known and manifest.is_chunk(key)

    def verify(self, key: str) -> None:
        """Compare a file with the manifest, once for as long as it stays as it is."""
        path, digests = self.root / key, self._known.get(key)
        try:
            here = os.lstat(path)
            if digests is None:
                raise damaged(self.root, f"{key} was added after the run")
            if not stat.S_ISREG(here.st_mode):
                raise damaged(self.root, f"{key} is no plain file")
            mark = (here.st_ino, here.st_size, here.st_mtime_ns)
            if self._seen.get(key) == mark:
                return
            if digest(path) not in digests:
                raise damaged(self.root, f"{key} was changed after the run")
            self._seen[key] = mark
        except (FileNotFoundError, NotADirectoryError):
            if digests is not None or manifest.is_chunk(key):
                raise damaged(self.root, f"{key} is missing") from None
        except OSError as error:
            raise InputError(f"{self.root} cannot be read: {key}: {error.strerror}.") from error

    def get_sync(self, key: str, *, prototype: BufferPrototype | None = None, byte_range: Any = None) -> Buffer | None:
        """As Zarr's store does, for a file that is as it was written.  Raises `InputError`."""
        if self._to_do(key):
            return None
        self.verify(key)
        return super().get_sync(key, prototype=prototype, byte_range=byte_range)

    async def get(self, key: str, prototype: BufferPrototype | None = None, byte_range: Any = None) -> Buffer | None:
        """The same."""
        if self._to_do(key):
            return None
        await asyncio.to_thread(self.verify, key)
        return await super().get(key, prototype or default_buffer_prototype(), byte_range)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, Any]]
    ) -> list[Buffer | None]:
        """The same of several."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]


def verified(store: Path, known: manifest.Listed, every_array: bool, partial: bool = False) -> Verified:
    """A store to be read, its metadata compared; with `every_array` those that are listed must be there."""
    found = Verified(store, known, partial=partial)
    for name in manifest.metadata_files(store) + [n for n in known if every_array and n.endswith("zarr.json")]:
        found.verify(name)
    return found


def made_array(group: zarr.Group, name: str, **layout: Any) -> None:
    """Create an array, compressed as those of runs and sweeps are."""
    group.create_array(name, compressors=[ZstdCodec(level=1), Crc32cCodec()], **layout)


def note_versions(group: zarr.Group, versions: Mapping[str, str]) -> None:
    """Note in `resumed` what goes on with a store, where it is other than what began it."""
    now = json.dumps(versions)
    if group.attrs["versions"] != now:
        group.attrs["resumed"] = now


@contextlib.contextmanager
def edited(store: Path) -> Iterator[Any]:
    """A group in memory with the metadata of a store; what is changed in it is listed first, and then written."""
    before = {name: (store / name).read_bytes() for name in manifest.metadata_files(store)}
    memory = MemoryStore({name: cpu.Buffer.from_bytes(data) for name, data in before.items()})
    yield zarr.open_group(memory, mode="r+", zarr_format=3, use_consolidated=False)
    after = {name: data.to_bytes() for name, data in memory._store_dict.items()}
    changed = {name: data for name, data in after.items() if before.get(name) != data}
    both = [(name, hashlib.sha256(data).hexdigest()) for files in (before, changed) for name, data in files.items()]
    replace_file(store / manifest.METADATA, manifest.manifest_text(both))
    for name, data in changed.items():
        replace_file(store / name, data)


def consolidated(store: Path, of_variables: Mapping[str, Mapping[str, Any]] | None = None, **attributes: Any) -> None:
    """Set attributes of a store and its variables, and list all its metadata in the first, so that it opens at once."""
    with edited(store) as group, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Zarr calls this list not yet a standard
        group.attrs.update(attributes)
        for name, attrs in (of_variables or {}).items():
            group[name].attrs.update(attrs)
        zarr.consolidate_metadata(group.store)
