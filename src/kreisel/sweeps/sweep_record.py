"""What a sweep is, typed: the one place where the attributes of its store are written and read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec

from kreisel.errors import InputError
from kreisel.files import parsed
from kreisel.storage.nodes import metadata

FORMAT = 1
Count = Annotated[int, msgspec.Meta(ge=1)]


class SweepRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The attributes of a sweep, under their own names."""

    Conventions: str = "CF-1.11"
    title: str
    source: str
    references: str
    kreisel_sweep: int = FORMAT
    system: str
    equations: str
    body: str | None = None  # JSON, as of a run
    frame: str
    n: int
    sweep: str  # JSON
    lanes: Count
    block_lanes: Count
    complete: int = 0  # a number: NetCDF has no truth values
    created: str
    versions: str  # JSON
    failed_lanes: int | None = None  # of one that is complete
    resumed: str | None = None  # JSON: the versions that went on with it, where they are others

    @classmethod
    def from_attrs(cls, attrs: Mapping[str, Any], where: str) -> SweepRecord:
        """What attributes say, checked.  Raises `InputError` for those of no sweep, and for damaged ones."""
        if attrs.get("kreisel_sweep") != FORMAT:
            raise InputError(f"{where} is no sweep of Kreisel (no kreisel_sweep = {FORMAT} among its attributes).")
        try:
            record = msgspec.convert(dict(attrs), cls)
        except msgspec.ValidationError as error:
            raise InputError(f"{where} is damaged: in its attributes, {error}.") from None
        if record.complete and record.failed_lanes is None:
            raise InputError(f"{where} is damaged: it is complete, but its attributes lack failed_lanes.")
        return record

    @classmethod
    def of_store(cls, store: Path) -> SweepRecord:
        """That of a store on disk.  Raises `InputError`."""
        return cls.from_attrs(metadata(store), str(store))

    def to_attrs(self) -> dict[str, Any]:
        """The attributes."""
        return {name: value for name, value in msgspec.structs.asdict(self).items() if value is not None}

    @property
    def description(self) -> Any:
        """The sections system, state, run and sweep.  Raises `InputError` for damaged text."""
        return parsed(self.sweep, "The attribute sweep")

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return -(-self.lanes // self.block_lanes)
