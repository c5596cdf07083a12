"""The store under archives and sweeps: NAME.part, made by one writer, which takes its name when it is whole."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kreisel.files import stands
from kreisel.process import Lock
from kreisel.storage import checkpoint, manifest
from kreisel.storage.replacing import agree, part_of, remove, require_replaceable, settle, take_name

if TYPE_CHECKING:
    import zarr


@contextlib.contextmanager
def one_writer(path: Path) -> Iterator[bool]:
    """The lock of an archive or a sweep.  Gives whether what a kill left there is whole now, and has its name."""
    with Lock(path):
        yield settle(path)


class Part:
    """NAME.part, and NAME."""

    def __init__(self, path: Path):
        self.path, self.part = path, part_of(path)

    def require_room(self) -> None:
        """Raises `InputError` where something stands that is no archive of Kreisel."""
        require_replaceable(self.path)
        require_replaceable(self.part)

    def create(self, attributes: Mapping[str, Any], overwrite: bool) -> zarr.Group:
        """A new store, in the place of an unfinished one; with `overwrite` it may replace what has its name."""
        import zarr

        if stands(self.part):
            remove(self.part)
        self.part.parent.mkdir(parents=True, exist_ok=True)
        group = zarr.create_group(str(self.part), zarr_format=3, attributes={**attributes})
        group.create_group(checkpoint.NAME.split("/")[0])
        if overwrite:
            agree(self.path)
        return group

    def seal(
        self, others: Iterable[str] = (), of_variables: Mapping[str, Mapping[str, Any]] | None = None, **attrs: Any
    ) -> None:
        """Set the last attributes, of variables too, and list every file; the metadata and `others` as they are now."""
        from kreisel.storage.verified import consolidated

        consolidated(self.part, of_variables, **attrs)
        manifest.seal(self.part, others)

    def take_name(self) -> None:
        """Give the store its name."""
        take_name(self.path)
