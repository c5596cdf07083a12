"""Datasets in memory and Zarr archives on disk, both described from the record.

An archive is written beside its final name, as NAME.part, block by block; it takes its name only when it is
whole.  Its arrays have their full length from the beginning, each block is a shard of eight chunks, and a checkpoint
says how far the run is: a process killed at any instant leaves an archive that opens and can go on.  A manifest has the
SHA-256 of every file (`kreisel.storage.manifest`).  Archives are data: arrays and JSON, nothing that runs.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.bodies import KNOWN
from kreisel.errors import InputError, RunError, Stopped, on_disk
from kreisel.files import stands
from kreisel.kernels.layout import Floats
from kreisel.record.model import Model
from kreisel.runs.describing import (
    CORRECTION,
    _corrections,
    at_the_end,
    attributes,
    describe,
    dimensions,
    in_memory,
    saved_times,
    time_attributes,
    versions,
)
from kreisel.runs.integration import Integration, Snapshot, block_rows, chunk_rows
from kreisel.runs.operations import require_events
from kreisel.runs.plan import Plan
from kreisel.runs.planning import broken_by
from kreisel.runs.settings import checked_events
from kreisel.storage import checkpoint, manifest
from kreisel.storage.nodes import require_sound
from kreisel.storage.opening import _checkpoint, _integration, _plan_of_run, _require_arrays, archive_record
from kreisel.storage.part import Part
from kreisel.storage.replacing import agreed, part_of, remove


class Archive:
    """A Zarr store that grows block by block under NAME.part and gets its name when it is whole.

    `begun` continues a store that is there: rows up to the checkpoint are in it.
    """

    def __init__(
        self, path: Path, plan: Plan, overwrite: bool = False, begun: bool = False, rows_in_block: int | None = None
    ):
        self._store = Part(path)
        self.path, self.part, self.plan = path, self._store.part, plan
        self._overwrite, self._begun, self._worth_keeping = overwrite, begun, begun
        self._start: dict[str, Floats] = dict(plan.start)
        self._rows_in_block = rows_in_block or block_rows(plan)

    def __enter__(self) -> Archive:
        import zarr

        with _disk(self.path, "be opened again" if self._begun else "be created"):
            if not self._begun:
                self._make_room()
                self._store.create(replace(describe(self.plan), complete=0).to_attrs(), self._overwrite)
                manifest.begin(self.part)
            try:
                self._group = zarr.open_group(str(self.part), mode="r+", zarr_format=3, use_consolidated=False)
            except OSError:
                raise
            except Exception as error:  # whatever a damaged store makes the libraries raise
                raise InputError(f"{self.part} is damaged: {error}. `kreisel check {self.part}`.") from error
        return self

    def _make_room(self) -> None:
        self._store.require_room()
        if stands(self.path) and not self._overwrite:
            raise InputError(
                f"{self.path} exists already and is left as it is. Choose another path, or replace it with --overwrite "
                "(overwrite=True)."
            )
        if not self._overwrite and (self.part / checkpoint.NAME).exists():
            raise InputError(
                f"{self.part} was left by a run that was interrupted. `kreisel resume {self.path}` goes on, "
                f"`kreisel plot {self.part}` shows it; or start over with --overwrite (overwrite=True)."
            )

    def _require_there(self) -> None:
        """Raises `RunError` where the store is no longer the folder that it was: Zarr would make a new one."""
        if not manifest.begun(self.part):
            raise self._vanished()

    def _vanished(self, name: str = "") -> RunError:
        return RunError(
            f"{self.part / name} vanished during the run. Usual cause: somebody else removed it. Run it again."
        )

    def append(self, block: Mapping[str, Array], start: int) -> None:
        """Write a block of rows that begins at row `start`, a chunk or the last rows."""
        stop = start + len(next(iter(block.values())))
        values = {"time": saved_times(self.plan, start, stop), **block}
        number = start // self._rows_in_block
        with _disk(self.path, "be written"):
            self._require_there()
            names = [f"{name}/c/{number}{'/0' * (value.ndim - 1)}" for name, value in values.items()]
            if start == 0:
                names += self._create(values, {"time": time_attributes(self.plan), **attributes(self.plan, block)})
            for name, value in values.items():
                array: Any = self._group.get(name)
                if array is None:
                    raise self._vanished(name)
                array[start:stop] = value
            manifest.add_block(self.part, number, names)
        self._worth_keeping = True

    def _create(self, values: Mapping[str, Array], attrs: Mapping[str, Mapping[str, Any]]) -> list[str]:
        """Create every array at its full length and write the numbers of the lanes.  Returns their chunks' names."""
        from kreisel.storage.verified import made_array

        block, rows = self._rows_in_block, self.plan.rows
        chunk = chunk_rows(block)
        if self.plan.batched:
            lanes = np.arange(self.plan.lanes)
            made_array(
                self._group,
                "lane",
                data=lanes,
                chunks=lanes.shape,
                dimension_names=("lane",),
                attributes={"long_name": "lane"},
                config={"write_empty_chunks": True},
                overwrite=True,
            )
        for name, value in values.items():
            made_array(
                self._group,
                name,
                shape=(rows, *value.shape[1:]),
                chunks=(chunk, *value.shape[1:]),
                shards=(block, *value.shape[1:]) if chunk < block else None,
                dtype=value.dtype,
                dimension_names=("time",) if name == "time" else dimensions(self.plan, name, value.shape),
                attributes=dict(attrs[name]),
                fill_value=np.nan,
                overwrite=True,
            )
        manifest.begin(self.part)
        return ["lane/c/0"] if self.plan.batched else []

    def checkpoint(self, snapshot: Snapshot) -> None:
        """Write down where the run stands; everything before is kept whatever happens."""
        with _disk(self.path, "be written"):
            self._require_there()
            checkpoint.write(self.part, replace(snapshot, shown=self._shown(snapshot)), self._start)

    def _shown(self, snapshot: Snapshot) -> dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]]:
        """Outputs of the rows of a snapshot, if nobody who opens the archive can compute them."""
        if self.plan.model.system.name in KNOWN or not len(snapshot.rows):
            return {}
        times = saved_times(self.plan, snapshot.flushed, snapshot.flushed + len(snapshot.rows))
        with np.errstate(all="ignore"):
            rows = in_memory(self.plan, [self.plan.observe(snapshot.rows)], times)
        return {str(name): (tuple(map(str, v.dims)), v.values, dict(v.attrs)) for name, v in rows.variables.items()}

    def finish(self) -> None:
        """Mark the archive as whole and give it its name; with its last checkpoint it can be lengthened."""
        with _disk(self.path, "be finished"):
            self._require_there()
            of_variables = {name: {CORRECTION: value} for name, value in _corrections(self.plan).items()}
            if self.plan.timetable.end is not None:
                _resize(self._group, self.plan.rows)
            self._store.seal([checkpoint.NAME], of_variables, **at_the_end(self.plan))
            self._require_there()
            self._store.take_name()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        stopped = isinstance(error, Stopped | KeyboardInterrupt)
        if error is not None and not (stopped or self._worth_keeping):
            with contextlib.suppress(OSError, InputError):
                remove(self.part)


def reopen(
    path: Path, extend: int | None, system: Model | None = None, events: Any = None
) -> tuple[Archive, Integration]:
    """An interrupted archive, or a finished one to be lengthened, and the run at its last checkpoint."""
    part = part_of(path)
    store = part if stands(part) else path
    record = archive_record(store)
    require_sound(store)
    if store == part and stands(path) and not agreed(path):
        raise InputError(f"{path} stands where {part} is to go, and was not to be replaced. Move one of them away.")
    if store == path and extend is None:
        raise InputError(f"{path} is finished: its {record.steps:,} steps are done. --extend STEPS lengthens it.")
    steps = record.steps if extend is None else extend
    if extend is not None and extend < record.steps:
        raise InputError(f"{path} has {record.steps:,} steps: expected more for --extend, got {extend:,}.")
    if extend is not None and record.rows is not None:
        why = "at given times" if record.stopped is None else f"that an event stopped at {record.stopped:g}"
        raise InputError(f"{path}: expected a run with rows at every dt for --extend, got one {why}.")
    snapshot, start, known = _checkpoint(store, record)
    plan = broken_by(_plan_of_run(record, start, steps, system), checked_events(events))
    require_events(plan, record.events)
    block = record.rows_in_block if snapshot.flushed else block_rows(plan)
    integration = _integration(plan, block)
    integration.restore(snapshot)
    if snapshot.flushed:
        _require_arrays(store, plan, record, known)
    archive = Archive(path, plan, begun=True, rows_in_block=block)
    with _disk(path, "be opened again"):
        if store == path:
            os.replace(path, part)
        _continue(part, plan, snapshot, block)
    return archive, integration


def _continue(part: Path, plan: Plan, snapshot: Snapshot, block: int) -> None:
    """Make a store ready to go on after its finished blocks: not complete any more, and as long as the plan."""
    from kreisel.storage.verified import edited, note_versions

    manifest.unseal(part, snapshot.flushed // block)
    manifest.remove_scratch(part, unlisted=True)
    with edited(part) as group:
        group.attrs.update({"complete": 0, "steps": plan.steps, "rows_in_block": block})
        note_versions(group, versions())
        if snapshot.flushed:
            _resize(group, plan.rows)


def _resize(group: Any, rows: int) -> None:
    """Give every array along the time so many rows."""
    for _, array in group.arrays():
        if array.metadata.dimension_names[0] == "time" and array.shape[0] != rows:
            array.resize((rows, *array.shape[1:]))


def _disk(path: Path, what: str) -> AbstractContextManager[None]:
    def kept() -> str:
        there = (part_of(path) / checkpoint.NAME).exists()
        return f" What was done until the last checkpoint is kept: `kreisel resume {path}` goes on." if there else ""

    return on_disk(path, what, kept)
