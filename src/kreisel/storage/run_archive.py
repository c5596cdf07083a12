"""The archive of a run: rows written block by block, with a checkpoint from which an interrupted run resumes."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, Stopped, on_disk, shown
from kreisel.files import parsed, stands
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import ORIENTATION
from kreisel.record.model import Model
from kreisel.runs import describing
from kreisel.runs.describing import CORRECTION, body_of, saved_times
from kreisel.runs.in_si import in_cf
from kreisel.runs.integration import Integration, Snapshot, block_rows, chunk_rows
from kreisel.runs.operations import require_events, require_operations
from kreisel.runs.plan import TIMES, Plan
from kreisel.runs.planning import broken_by, plan_of
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import Settings, check_model, checked_events
from kreisel.storage import archive, opening
from kreisel.storage.archive import CHECKPOINT, LARGEST_CHUNK, part_of
from kreisel.storage.opening import Checkpoint


class RunArchive:
    """The archive of a plan, which grows block by block under NAME.part and gets its name when it is complete.

    resumed        the archive exists, with the rows up to its checkpoint
    rows_in_block  rows in a block of a resumed archive
    """

    def __init__(
        self, path: Path, plan: Plan, overwrite: bool = False, resumed: bool = False, rows_in_block: int | None = None
    ):
        self.path, self.part, self.plan = path, part_of(path), plan
        self._overwrite, self._resumed, self._worth_keeping = overwrite, resumed, resumed
        self._start: dict[str, Floats] = dict(plan.start)
        self._rows_in_block = rows_in_block or block_rows(plan)
        self._last: Snapshot | None = None
        self._described = resumed

    def __enter__(self) -> RunArchive:
        with _disk(self.path, "be opened again" if self._resumed else "be created"):
            if not self._resumed:
                for path in (self.path, self.part):
                    archive.require_replaceable(path)
                if stands(self.path) and not self._overwrite:
                    raise InputError(
                        f"{self.path} exists already and is unchanged. Choose another path, or replace it with "
                        "--overwrite (overwrite=True)."
                    )
                if not self._overwrite and (self.part / CHECKPOINT).exists():
                    raise InputError(
                        f"{self.part} was left by a run that was interrupted. `kreisel resume {self.path}` resumes it, "
                        f"`kreisel plot {self.part}` shows it; or start over with --overwrite (overwrite=True)."
                    )
                lanes = {"lane": np.arange(self.plan.lanes)} if self.plan.batched else {}
                attrs = replace(describing.describe(self.plan), complete=0).to_attrs()
                archive.create(self.path, attrs, layouts(self.plan, self._rows_in_block), lanes, self._overwrite)
            self._arrays = archive.opened_arrays(self.part)
        return self

    def append(self, block: Mapping[str, Array], start: int) -> None:
        """Write a block of rows that begins at row `start`."""
        values = {"time": saved_times(self.plan, start, start + len(next(iter(block.values())))), **block}
        with _disk(self.path, "be written"):
            if start == 0:
                self._describe(block)
            archive.write_block(self.part, self._arrays, "time", start // self._rows_in_block, start, values)
        self._worth_keeping = True

    def _describe(self, rows: Mapping[str, Array]) -> None:
        archive.require_there(self.part)
        with archive.edited(self.part) as root:
            for name, attrs in describing.attributes(self.plan, rows).items():
                archive.arrays_of(root)[name]["attributes"] = attrs | in_cf(self.plan.model, name)
        self._described = True

    def checkpoint(self, snapshot: Snapshot) -> None:
        """Save the position of the run; everything before it is safe from a kill."""
        with _disk(self.path, "be written"):
            archive.require_there(self.part)
            outputs = observed(self.plan, snapshot)
            if not self._described and outputs:
                self._describe(outputs)
            opening.write_checkpoint(self.part, Checkpoint(snapshot, self._start, outputs))
        self._last = snapshot

    def finish(self) -> None:
        """Mark the archive as complete and give it its name; with its last checkpoint it can be extended."""
        with _disk(self.path, "be finished"):
            archive.require_there(self.part)
            with archive.edited(self.part) as root:  # all rows exist
                _fit(root, self.plan, describing.at_the_end(self.plan))
                for name, value in describing.largest_corrections(self.plan).items():
                    archive.arrays_of(root)[name]["attributes"][CORRECTION] = value
            if self._last is not None:
                opening.write_checkpoint(self.part, Checkpoint(self._last, self._start, {}))
            archive.seal(self.part)
            archive.take_name(self.path)

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        stopped = isinstance(error, Stopped | KeyboardInterrupt | SystemExit)
        stopped |= self._last is not None and isinstance(getattr(error, "__cause__", None), OSError)  # a full disk
        if error is not None and not (stopped or self._worth_keeping):
            with contextlib.suppress(OSError, InputError):
                archive.remove(self.part)


def observed(plan: Plan, snapshot: Snapshot) -> dict[str, Array]:
    """The outputs and times of the rows of a snapshot that are not yet in a block."""
    if not len(snapshot.rows):
        return {}
    times = saved_times(plan, snapshot.flushed, snapshot.flushed + len(snapshot.rows))
    with np.errstate(all="ignore"):
        return {"time": times, **plan.observe(snapshot.rows)}


def layouts(plan: Plan, block: int) -> dict[str, dict[str, Any]]:
    """The layout of every array for Zarr: at full length, a block in a shard of eight chunks or in one chunk."""
    chunk = chunk_rows(block)
    out: dict[str, dict[str, Any]] = {}
    if plan.batched:
        shape = (plan.lanes,)
        out["lane"] = {"shape": shape, "chunks": shape, "dtype": np.dtype("i8"), "dimension_names": ("lane",)}
        out["lane"]["attributes"] = {"long_name": "lane"}
    for name, value in {"time": np.zeros(1), **plan.example}.items():
        out[name] = {
            "shape": (plan.rows, *value.shape[1:]),
            "chunks": (chunk, *value.shape[1:]),
            "shards": (block, *value.shape[1:]) if chunk < block else None,
            "dtype": value.dtype,
            "dimension_names": ("time",) if name == "time" else describing.dimensions(plan, name, value.shape),
            "attributes": describing.time_attributes(plan) | in_cf(plan.model, name) if name == "time" else {},
            "fill_value": np.nan,
        }
    return out


def _fit(root: dict[str, Any], plan: Plan, attrs: Mapping[str, Any]) -> None:
    """Set attributes, and resize every array along the time to the rows of the plan."""
    root["attributes"].update(attrs)
    for node in archive.arrays_of(root).values():
        if node["dimension_names"][0] == "time":
            node["shape"][0] = plan.rows


def reopen(
    path: Path, extend: int | None, system: Model | None = None, events: Any = None
) -> tuple[RunArchive, Integration]:
    """An interrupted archive, or a finished one to be extended, and the run at its last checkpoint."""
    part = part_of(path)
    store = part if stands(part) else path
    record = opening.run_record(store)
    archive.require_plain(store)
    if store == part and stands(path) and not archive.agreed(path):
        raise InputError(f"{path} is where {part} is to go, and was not to be replaced. Move one of them away.")
    why = "with rows at given times" if record.stopped is None else f"that an event stopped at {record.stopped:g}"
    if store == path and extend is None:
        longer = f"its {record.steps:,} steps are done. --extend STEPS lengthens it"
        last = f"it is a run {why}. Begin another run at its last row, x0=row"
        raise InputError(f"{path} is finished: {longer if record.rows is None else last}.")
    steps = record.steps if extend is None else extend
    if extend is not None and extend < record.steps:
        raise InputError(f"{path} has {record.steps:,} steps: expected more for --extend, got {extend:,}.")
    if extend is not None and record.rows is not None:
        raise InputError(f"{path}: expected a run with rows at every dt for --extend, got one {why}.")
    point = opening.checked_checkpoint(store, record, archive.listed(store))
    same = {name: getattr(record, name) for name in ("dt", "every", "method", "order", "engine", "t_start")}
    same |= {"tol": record.tolerance, "project": record.projection > 0, "observe": record.observed}
    asked = Settings.checked(steps=steps, times=point.start.get(TIMES), impulses=record.struck, **same)
    state = {letter: value for letter, value in point.start.items() if letter not in (ORIENTATION, TIMES)}
    model = record.model if system is None else _same(system, record)
    plan = broken_by(plan_of(model, state, asked, point.start.get(ORIENTATION)), checked_events(events))
    require_events(plan, record.events)
    flushed = point.snapshot.flushed
    block = record.rows_in_block if flushed else block_rows(plan)
    if block * plan.first.nbytes > LARGEST_CHUNK:
        raise InputError(f"The attribute rows_in_block = {block:,} is damaged: no run has such blocks.")
    integration = Integration(plan, rows_in_block=block)
    integration.restore(point.snapshot)
    root = archive.metadata(store)
    fresh = archive.new_metadata(root["attributes"], layouts(plan, block))
    saved = archive.arrays_of(root)
    for name, node in archive.arrays_of(fresh).items():
        keys = [k for k in node if k not in ("shape", "attributes")]
        if flushed and (name not in saved or any(saved[name].get(k) != node[k] for k in keys)):
            raise InputError(f"{store} is damaged: {name} is not as the run made it. `kreisel check {store}`.")
        node["attributes"] = saved.get(name, node)["attributes"]
    with _disk(path, "be opened again"):
        if store == path:
            if not all(os.access(folder, os.W_OK) for folder in (path, (path / CHECKPOINT).parent)):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))  # before it loses its name
            os.replace(path, part)
        archive.unseal(part)  # no longer complete, and as long as the plan
        opening.write_checkpoint(part, point._replace(outputs=observed(plan, point.snapshot)))  # rows in no block
        _fit(fresh, plan, {"complete": 0, "steps": plan.steps, "rows_in_block": block})
        archive.note_versions(fresh["attributes"], describing.versions())
        archive.write_metadata(part, fresh)
        archive.drop_blocks(part, flushed // block)
    return RunArchive(path, plan, resumed=True, rows_in_block=block), integration


def _same(model: Model, record: RunRecord) -> Model:
    check_model(model)
    if model.system.name != record.system:
        raise InputError(f"system: expected {record.system}, the system of the run, got {model.system.name}.")
    if (mine := describing.parameters_of(model)) != record.parameters:
        now, then = json.loads(mine), parsed(record.parameters, "The attribute parameters")
        then = then if isinstance(then, dict) else {}
        name = next((key for key in {**then, **now} if now.get(key) != then.get(key)), "")
        raise InputError(
            f"system: expected {record.system} with the parameters of the run, {name} = {shown(then.get(name))}, got "
            f"{name} = {shown(now.get(name))}."
        )
    if body_of(model) != record.body:
        raise InputError(
            f"system: expected the body of the run, with the axes and units {record.body}, got {body_of(model)}. Usual "
            "cause: a model of another body, or one that has only the parameters."
        )
    require_operations(model, record.system_sha256)
    return model


def _disk(path: Path, action: str) -> AbstractContextManager[None]:
    def kept() -> str:
        present = (part_of(path) / CHECKPOINT).exists()
        return f" All rows until the last checkpoint are kept: `kreisel resume {path}` resumes it." if present else ""

    return on_disk(path, action, kept)
