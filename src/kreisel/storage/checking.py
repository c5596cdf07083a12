"""What `kreisel check` does: whether an archive is as it was written, and whether its numbers fit each other."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.files import stands
from kreisel.method import Scheme, scheme
from kreisel.method.scheme import KINDS
from kreisel.runs.drift import lane_scales
from kreisel.runs.run_record import RunRecord
from kreisel.storage import checkpoint, manifest
from kreisel.storage.nodes import is_sweep, require_sound, too_large
from kreisel.storage.opening import MOST_INDEXED, archive_record, is_cut, open_archive, opened, ordered
from kreisel.storage.recomputing import lanes_again, steps_again
from kreisel.storage.replacing import require_replaceable, settled
from kreisel.storage.verified import Damaged
from kreisel.sweeps.blocks import COMPUTED, MISSING
from kreisel.sweeps.sweep import open_sweep
from kreisel.sweeps.sweep_record import SweepRecord

if TYPE_CHECKING:
    import xarray as xr

RELATIVE = 1e-12


def check_archive(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """The run, as far as it can be read, and what is wrong with it, each fault in one sentence.

    Every file is compared with its SHA-256.  The times, the Casimirs and the integrals that are functions of the saved
    state alone are computed again, block by block.  From some rows the next row is computed again, with its state and
    its orientation.  Raises `InputError` if there is no archive at all.
    """
    path = settled(path)
    if is_sweep(path):
        return check_sweep(path)
    record = archive_record(path)
    require_sound(path)
    cut = ["the run was interrupted before its end: `kreisel resume` goes on with it"] if is_cut(path, record) else []
    try:
        known = manifest.read(path)
        changed = _file_faults(path, record, known)
        run = open_archive(path, indexed=False) if cut else ordered(opened(path, known))
    except InputError as error:
        return None, [*cut, *(([] if cut else _unreadable(path)) or [str(error)])]
    faults, sizes = changed, _size_faults(run)
    if sizes or "time" not in run.variables:
        return None, [*cut, *faults, *sizes]
    damaged = damaged_rows(run)
    for name, (first, last, why) in damaged:
        where = f" in rows {first} to {last}" if "time" in run[name].dims else ""
        faults.append(f"{name} cannot be read{where}: {why}")
    run = run.drop_vars({name for name, _ in damaged})
    faults += [] if faults else _number_faults(run)
    few = "time" in run.coords and run.sizes["time"] <= MOST_INDEXED
    return (run.set_xindex("time") if few and "time" not in run.xindexes else run), [*cut, *faults]


def _unreadable(path: Path) -> list[str]:
    """What is wrong with the files of an archive that cannot be opened, apart from the first of them."""
    known = manifest.listed(path)
    return [message for _, message in manifest.faults(path, known)] if known else []


def _file_faults(path: Path, record: RunRecord, known: manifest.Listed) -> list[str]:
    """What is wrong with files that are no chunks; an interrupted run may have some that are not listed yet."""
    found = manifest.faults(path, known)
    if not is_cut(path, record):
        return [message for _, message in found]
    flushed = checkpoint.read(path)[0].flushed
    return [
        message
        for name, message in found
        if not (
            name == checkpoint.NAME
            or manifest.is_scratch(name)
            or manifest.is_chunk(name)
            or (flushed == 0 and name.count("/") == 1 and name.endswith("/zarr.json"))
        )
    ]


def check_sweep(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """A sweep, not yet read, and what is wrong with it.

    Every file is compared with its SHA-256; lanes that did not fail must have finite values; some lanes are computed
    again.
    """
    try:
        run = open_sweep(path)
        record, known = SweepRecord.from_attrs(run.attrs, str(path)), manifest.read(path)
    except InputError as error:
        require_sound(path)
        return None, _unreadable(path) or [str(error)]
    faults = [
        message
        for name, message in manifest.faults(path, known)
        if record.complete or not (manifest.is_chunk(name) or manifest.is_scratch(name))
    ]
    faults += too_large(run)
    if run.sizes.get("lane") != record.lanes or "failed" not in run:
        faults.append(f"{record.lanes:,} lanes were expected, {run.sizes.get('lane', 0):,} are there")
    if faults:
        return run, faults
    if "time" in run.variables and "lane" not in run["time"].dims:
        faults += _unread(run["time"].variable, "time", "")
    width, missing = record.block_lanes, 0
    for first in range(0, record.lanes, width):
        lanes = run.isel(lane=slice(first, first + width))
        where = f" in lanes {first} to {first + lanes.sizes['lane'] - 1}"
        unread = _unread(lanes["failed"].variable, "failed", where)
        state = None if unread else lanes["failed"].values
        faults += unread
        if state is not None and (state == MISSING).all():
            missing += 1
            continue
        for name, variable in lanes.data_vars.items():
            unread = [] if name == "failed" else _unread(variable.variable, str(name), where)
            faults += unread
            if unread or state is None or variable.dtype.kind != "f" or "lane" not in variable.dims:
                continue
            if not np.isfinite(variable.transpose("lane", ...).values[state == COMPUTED]).all():
                faults.append(f"{name} is not finite{where}, although they did not fail")
    blocks = record.blocks
    if missing and record.complete:
        faults.append(f"{missing:,} of {blocks:,} blocks are missing")
    elif not record.complete:
        faults.insert(0, f"the sweep was interrupted: {missing:,} of {blocks:,} blocks are to do")
    return run, faults or lanes_again(run)


def _unread(part: xr.Variable, name: str, where: str) -> list[str]:
    why = _trouble(part)
    return [] if why is None else [f"{name} cannot be read{where}: {why}"]


def _size_faults(run: xr.Dataset) -> list[str]:
    record = RunRecord.from_attrs(run.attrs)
    expected = record.row_count
    rows = run.sizes.get("time", 0)
    faults = [f"{expected} rows were expected, {rows} are there"] if record.complete and rows != expected else []
    return faults + too_large(run)


def damaged_rows(run: xr.Dataset) -> list[tuple[str, tuple[int, int, str]]]:
    """Each variable that cannot be read, with the first and last row and the reason, block by block."""
    found: list[tuple[str, tuple[int, int, str]]] = []
    for name, variable in run.variables.items():
        rows = variable.shape[0] if "time" in variable.dims else 1
        whole = variable.encoding.get("shards") or variable.encoding.get("chunks") or (rows,)
        chunk = max(1, whole[0])
        for first in range(0, rows, chunk) if "time" in variable.dims else [0]:
            last = min(first + chunk, rows) - 1
            why = _trouble(variable[first : last + 1] if "time" in variable.dims else variable)
            if why is not None:
                found.append((str(name), (first, last, why)))
    return found


def _trouble(part: xr.Variable) -> str | None:
    """Why a part cannot be read, if so."""
    try:
        part.values  # noqa: B018 - reading it verifies it
    except Damaged as error:
        return error.why
    except Exception as error:  # whatever a damaged chunk makes the libraries raise
        return str(error) or type(error).__name__
    return None


def recover(path: Path, out: Path) -> tuple[int, int]:
    """Write the rows that are whole in every variable to a new archive.  Returns their number and that of all rows.

    The new archive has the attribute `recovered`, and complete = 0 where rows are lost.  Where the manifest itself
    is lost, `recovered` says that the rows were not compared with it.  Raises `InputError` where nothing is whole, or
    `out` exists.
    """
    if stands(out):
        raise InputError(f"{out} exists already and is left as it is. Choose another path for what is recovered.")
    require_replaceable(out)
    record = archive_record(path)
    require_sound(path)
    known = manifest.read(path) if manifest.begun(path) else None
    run = open_archive(path, indexed=False) if is_cut(path, record) else ordered(opened(path, known))
    rows = run.sizes.get("time", 0)
    keep = np.ones(rows, dtype=bool)
    for name, (first, last, _) in damaged_rows(run):
        if "time" in run[name].dims:
            keep[first : last + 1] = False
        else:
            run = run.drop_vars(name)  # the numbers of the lanes
    if not keep.any():
        raise InputError(f"No row of {path} is whole in every variable. Run it again from its TOML file.")
    whole = run.isel(time=np.flatnonzero(keep)).load().drop_encoding()
    lost = not (run.attrs["complete"] and keep.all())
    note = "" if known else ", not compared with any checksum"
    whole.attrs.update(complete=int(not lost), recovered=f"{int(keep.sum())} of {rows} rows of {path.name}{note}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        whole.to_zarr(out, zarr_format=3)
    manifest.of_all(out)
    return int(keep.sum()), rows


def _number_faults(run: xr.Dataset) -> list[str]:
    """What is wrong with the numbers of a run, read block by block.

    They must be finite, the times those of the steps, the integrals those of the states, and some rows must follow from
    the row before.
    """
    missing: list[str] = []
    record = RunRecord.from_attrs(run.attrs)
    again = None if record.is_own else _definition(record)
    if again is not None:
        wanted = record.observed
        chosen = [k for k, o in again.outcomes.items() if wanted is None or k in wanted or o.kind == "state"]
        missing = [f"{name} is missing" for name in chosen if name not in run]
    faults = dict.fromkeys(missing)
    if "lane" in run.variables and (run["lane"].values != np.arange(run.sizes["lane"])).any():
        faults["lane does not count the lanes"] = None
    step = max(1, record.rows_in_block)
    for first in range(0, run.sizes["time"], step):
        block = run.isel(time=slice(first, first + step)).load()
        faults |= dict.fromkeys(_block_faults(block, first, record, None if missing else again))
    return list(faults) or steps_again(run)


def _definition(record: RunRecord) -> Scheme | None:
    """What computes the integrals from the states, as in the run; None where forces take more than the state."""
    if record.model.system.perturbation is not None:
        return None
    return scheme(record.model, record.method, record.dt, record.order, oriented=False)


def _block_faults(block: xr.Dataset, first: int, record: RunRecord, again: Scheme | None) -> Iterator[str]:
    time = block["time"].values
    rows = np.arange(first, first + len(time), dtype=np.float64)
    of_steps = np.minimum(rows * record.every, record.steps) * record.dt
    of_steps[rows == record.row_count - 1] = of_steps[-1] if record.stopped is None else record.stopped
    if record.recovered is None and not record.at_times and (time != of_steps).any():
        yield "time is not that of the steps"
    if not (np.diff(time) > 0).all():
        yield "time does not increase"
    for name, variable in block.data_vars.items():
        if variable.dtype.kind == "f" and not np.isfinite(variable.values).all():
            row = int(np.argmin(np.isfinite(variable.values.reshape(len(variable), -1)).all(1)))
            yield f"{name} is not finite at row {first + row}"
            return
    if again is not None:
        yield from _recomputed(block, first, again)


def _recomputed(block: xr.Dataset, first: int, again: Scheme) -> Iterator[str]:
    """Integrals of the saved states against the saved integrals."""
    kinds = {name: o.axes for name, o in again.outcomes.items() if o.kind == "state"}
    state = tuple(algebra.KINDS[kind].from_user(block[k].values, again.n) for k, kind in kinds.items())
    outputs: Mapping[str, Array] = again.observe(again.reopen(state))
    for name, value in outputs.items():
        if again.outcomes[name].kind in KINDS and name in block:
            off = abs(value - block[name].values)
            size = lane_scales(block[name], "evaluation_scale")
            scale = size.reshape(np.shape(value)[1:] if len(size) > 1 else (-1,)) + abs(value)
            worst = float((off / np.maximum(scale, 1e-300)).max())
            if worst > RELATIVE:
                rows = f"rows {first} to {first + len(off) - 1}"
                yield f"{name} does not belong to the saved states: it is off by {worst:.2g} relative in {rows}"
