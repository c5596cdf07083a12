"""A Zarr store that returns only files unchanged since they were written."""

from __future__ import annotations

import asyncio
import os
import stat
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.storage import LocalStore, MemoryStore

from kreisel.errors import InputError
from kreisel.files import digest
from kreisel.storage import archive
from kreisel.storage.archive import Listed

if TYPE_CHECKING:
    import xarray as xr

REMEDY = "`kreisel check` reports the other damage; --recover saves the intact rows."


class Damaged(InputError):
    """A file of an archive that has changed since it was written; `why` is a clause."""

    why = ""


class Verified(LocalStore):
    """A store for reading: a file that is changed, missing or added raises `InputError`.

    partial   chunks that are not listed are not read: their blocks are missing, or being written
    files     files that need precedence: the rows of an interrupted run after its last block
    """

    def __init__(self, root: Path | str, known: Listed, partial: bool = False, files: dict[str, Buffer] | None = None):
        super().__init__(root, read_only=True)
        self._known, self._partial, self._files = known, partial, files or {}
        self._seen: dict[str, tuple[int, ...]] = {}

    def with_read_only(self, read_only: bool = False) -> Verified:
        """The store itself, which is never written to."""
        return self

    def _damaged(self, why: str) -> Damaged:
        error = Damaged(f"{self.root} is damaged: {why}. {REMEDY}")
        error.why = why
        return error

    def verify(self, key: str) -> None:
        """Compare a file with its checksum, again only if it changes."""
        path, digests = self.root / key, self._known.get(key)
        try:
            here = os.lstat(path)
            if digests is None:
                raise self._damaged(f"{key} was added after the run")
            if not stat.S_ISREG(here.st_mode):
                raise self._damaged(f"{key} is not a plain file")
            mark = (here.st_ino, here.st_size, here.st_mtime_ns)
            if self._seen.get(key) == mark:
                return
            if digest(path) not in digests:
                raise self._damaged(f"{key} was changed after the run")
            self._seen[key] = mark
        except (FileNotFoundError, NotADirectoryError):
            if digests is not None or archive.is_chunk(key):
                raise self._damaged(f"{key} is missing") from None
        except OSError as error:
            raise InputError(f"{self.root} cannot be read: {key}: {error.strerror}.") from error

    def get_sync(self, key: str, *, prototype: BufferPrototype | None = None, byte_range: Any = None) -> Buffer | None:
        """The file from Zarr's store, if it has not changed.  Raises `InputError`."""
        if key in self._files:
            return MemoryStore(self._files).get_sync(key, prototype=prototype, byte_range=byte_range)
        if self._partial and key not in self._known and archive.is_chunk(key):
            return None
        self.verify(key)
        return super().get_sync(key, prototype=prototype, byte_range=byte_range)

    async def get(self, key: str, prototype: BufferPrototype | None = None, byte_range: Any = None) -> Buffer | None:
        """The file of that key, as `get_sync`."""
        prototype = prototype or default_buffer_prototype()
        return await asyncio.to_thread(self.get_sync, key, prototype=prototype, byte_range=byte_range)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, Any]]
    ) -> list[Buffer | None]:
        """Several files, as `get_sync`."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]


def dataset(path: Path, store: Any, **options: Any) -> xr.Dataset:
    """The arrays of a store of that path, read on access.  Raises `InputError` for damaged ones."""
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return xr.open_dataset(
                store, engine="zarr", consolidated=True, cache=False, mask_and_scale=False, zarr_format=3, **options
            )
    except InputError:
        raise
    except Exception as error:  # any exception of the libraries for a damaged store
        raise InputError(f"{path} cannot be read as a Zarr archive: {error}") from error


def opened(path: Path, known: Listed | None, files: dict[str, Buffer] | None = None) -> xr.Dataset:
    """The unchanged arrays of an archive, without indexes; compared with its checksums if these are known."""
    store: Any = path if known is None else Verified(path, known, files=files)
    return dataset(path, store, create_default_indexes=False)
