"""`kreisel check`: whether an archive is unchanged since it was written, and whether its values fit each other."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.files import require_file, stands
from kreisel.method import Scheme, scheme
from kreisel.method.scheme import KINDS, ORIENTATION
from kreisel.runs.drift import lane_scales
from kreisel.runs.integration import Integration
from kreisel.runs.planning import plan_of
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import Settings
from kreisel.storage import archive, opening
from kreisel.storage.archive import CHECKPOINT
from kreisel.storage.opening import COMPUTED, MISSING, Damaged, SweepRecord, is_cut, opened, run_record

RELATIVE = 1e-12
SAMPLES = 8
MOST_STEPS = 200_000  # lane-steps in all samples together; below a second for most maps
NUDGE = 1e-10  # relative change of a start, which measures how sensitive a row is to the row before
CLOSE, LOOSE = 1e-7, 1e-4  # relative: of maps, and of dop853, which chooses its steps (at least)


class Unread(NamedTuple):
    """A variable that cannot be read, of the rows or lanes first to last, or complete; the reason."""

    name: str
    first: int
    last: int
    axis: str
    why: str

    @property
    def sentence(self) -> str:
        """The fault in words."""
        where = f" in {self.axis}s {self.first} to {self.last}" if self.axis else ""
        return f"{self.name} cannot be read{where}: {self.why}"


def check_archive(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """The run or sweep, as far as it can be read, and its faults, each in one sentence.

    Every file is compared with its SHA-256.  The times, the Casimirs and the integrals that depend only on the saved
    state are computed again, block by block.  From some rows the next row is computed again, with its state and its
    orientation.  Lanes of a sweep that did not fail must have finite values; `kreisel.sweeps.sweep.check_archive`
    computes some of them again.  Raises `InputError` if there is no archive at all.
    """
    path = archive.settled(path)
    return check_lanes(path) if opening.is_sweep(path) else check_rows(path)


def check_rows(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """The check of a run."""
    record = run_record(path)
    archive.require_plain(path)
    cut = ["the run was interrupted before its end: `kreisel resume` resumes it"] if is_cut(path, record) else []
    try:
        listed = archive.listed(path)
        faults = _file_faults(path, listed, bool(cut))
        run = opening.open_rows(path, indexed=False) if cut else opening.ordered(opened(path, listed))
    except InputError as error:
        return None, [*cut, *(([] if cut else _file_faults(path)) or [str(error)])]
    run, rows, expected = _without_lost(path, run), run.sizes.get("time", 0), record.row_count
    short = run.attrs.get("complete", 1) and rows != expected
    sizes = [f"{expected} rows were expected, {rows} are there"] if short else []
    sizes += opening.too_large(run)
    if sizes or "time" not in run.variables:
        return None, [*cut, *faults, *sizes]
    unread = [gap for _, _, result in blocks(run, "time", record.rows_in_block) for gap in result]
    faults += [gap.sentence for gap in unread]
    run = run.drop_vars({gap.name for gap in unread})
    faults += [] if faults else _number_faults(run)
    few = "time" in run.coords and run.sizes["time"] <= opening.MOST_INDEXED
    return (run.set_xindex("time") if few and "time" not in run.xindexes else run), [*cut, *faults]


def check_lanes(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """The check of a sweep, which is read block by block."""
    try:
        run = opening.open_lanes(path, checked=False)
        record, listed = SweepRecord.from_attrs(run.attrs, path), archive.listed(path)
    except InputError as error:
        archive.require_plain(path)
        return None, _file_faults(path) or [str(error)]
    run = _without_lost(path, run)
    faults = _file_faults(path, listed, not record.complete) + opening.too_large(run)
    if run.sizes.get("lane") != record.lanes or "failed" not in run:
        faults.append(f"{record.lanes:,} lanes were expected, {run.sizes.get('lane', 0):,} are there")
    if faults:
        return run, faults
    missing, mixed = 0, not {"run.method", "run.order"}.isdisjoint(run.variables)  # then lanes have different variables
    for first, values, unread in blocks(run, "lane", record.block_lanes):
        state = values.get("failed")
        if state is not None and (state == MISSING).all():
            missing += 1
            continue
        faults += [gap.sentence for gap in unread]
        for name, value in values.items():
            if state is None or value.dtype.kind != "f" or "lane" not in run[name].dims or name == "failed":
                continue
            lanes = np.moveaxis(value, run[name].dims.index("lane"), 0).reshape(len(state), -1)
            lost = ~np.isfinite(lanes[state == COMPUTED])
            if (lost.any(1) & ~(mixed & lost.all(1))).any():
                where = f"lanes {first} to {first + len(state) - 1}"
                faults.append(f"{name} is not finite in {where}, although they did not fail")
    if missing and record.complete:
        faults.append(f"{missing:,} of {record.blocks:,} blocks are missing")
    elif not record.complete:
        faults.insert(0, f"the sweep was interrupted: {missing:,} of {record.blocks:,} blocks are to do")
    return run, faults


def blocks(run: xr.Dataset, axis: str, width: int) -> Iterator[tuple[int, dict[str, np.ndarray], list[Unread]]]:
    """The first row or lane of each block, its values by variable, and the variables that cannot be read.

    Variables without this axis are read with the first block.
    """
    size = run.sizes.get(axis, 0)
    for first in range(0, max(size, 1), max(1, width)):
        last, values, unread = min(first + width, size) - 1, {}, []
        for name, variable in run.variables.items():
            along = axis in variable.dims
            if not along and first:
                continue
            try:
                values[str(name)] = np.asarray(variable[{axis: slice(first, last + 1)} if along else {}].values)
            except Exception as error:  # any exception of the libraries for a damaged chunk
                why = error.why if isinstance(error, Damaged) else str(error) or type(error).__name__
                unread.append(Unread(str(name), first, last, {"time": "row"}.get(axis, axis) if along else "", why))
        yield first, values, unread


def _without_lost(path: Path, run: xr.Dataset) -> xr.Dataset:
    return run.drop_vars([name for name in run.variables if not stands(path / str(name))])


def _file_faults(path: Path, listed: archive.Listed | None = None, cut: bool = False) -> list[str]:
    """The faults of files other than listed chunks; an interrupted archive may have some that are not listed.

    Without `listed`, by the valid lines of damaged lists; none without any.
    """
    result = archive.faults(path, lines) if (lines := listed or archive.listed(path, strict=False)) else []
    expected = (CHECKPOINT,) if cut else ()
    may_be = (archive.is_scratch, archive.is_chunk) if cut else ()
    return [text for name, text in result if name not in expected and not any(test(name) for test in may_be)]


def recover(path: Path, out: Path) -> tuple[int, int]:
    """Write the rows that are intact in every variable to a new archive.  Returns the counts of these and of all rows.

    The new archive has the attribute `recovered`, and complete = 0 if rows are lost.  If the checksums themselves are
    lost, `recovered` states that the rows were not compared with them.  Raises `InputError` if no row is intact, or
    `out` exists.
    """
    if stands(out):
        raise InputError(f"{out} exists already and is unchanged. Choose another path for the recovered rows.")
    require_file(out)
    record = run_record(path)
    archive.require_plain(path)
    listed = archive.listed(path) if archive.begun(path) else None
    run = opening.open_rows(path, indexed=False) if is_cut(path, record) else opening.ordered(opened(path, listed))
    rows, keep = run.sizes.get("time", 0), np.ones(run.sizes.get("time", 0), dtype=bool)
    for _, _, unread in blocks(run, "time", record.rows_in_block):
        for gap in unread:
            if gap.axis:
                keep[gap.first : gap.last + 1] = False
            else:
                run = run.drop_vars(gap.name)  # the indices of the lanes
    if not keep.any():
        raise InputError(f"No row of {path} is complete in every variable. Run it again.")
    sound = run.isel(time=np.flatnonzero(keep)).load().drop_encoding()
    lost = not (run.attrs["complete"] and keep.all())
    note = "" if listed else ", not compared with any checksum"
    sound.attrs.update(complete=int(not lost), recovered=f"{int(keep.sum())} of {rows} rows of {path.name}{note}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sound.to_zarr(out, zarr_format=3, consolidated=True)
    archive.list_all(out)
    return int(keep.sum()), rows


def _number_faults(run: xr.Dataset) -> list[str]:
    """The faults in the values of a run, read block by block.

    Values must be finite, times must equal the times of the steps, integrals must fit the states, and some rows must
    follow from the row before.
    """
    missing: list[str] = []
    record, again = RunRecord.from_attrs(run.attrs), None
    if not record.is_own and record.model.system.perturbation is None:  # forces depend on more than the saved states
        again = scheme(record.model, record.method, record.dt, record.order, oriented=False)
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


def _block_faults(block: xr.Dataset, first: int, record: RunRecord, again: Scheme | None) -> Iterator[str]:
    time = block["time"].values
    rows = np.arange(first, first + len(time), dtype=np.float64)
    of_steps = np.minimum(rows * record.every, record.steps) * record.dt
    of_steps = of_steps + record.t_start if record.t_start else of_steps
    of_steps[rows == record.row_count - 1] = of_steps[-1] if record.stopped is None else record.stopped
    if record.recovered is None and not record.at_times and (time != of_steps).any():
        yield "time is not the time of the steps"
    if not (np.diff(time) > 0).all():
        yield "time does not increase"
    for name, variable in block.data_vars.items():
        if variable.dtype.kind == "f" and not np.isfinite(variable.values).all():
            row = int(np.argmin(np.isfinite(variable.values.reshape(len(variable), -1)).all(1)))
            yield f"{name} is not finite at row {first + row}"
            return
    if again is None:
        return
    kinds = {name: o.axes for name, o in again.outcomes.items() if o.kind == "state"}
    state = tuple(algebra.KINDS[kind].from_user(block[k].values, again.n) for k, kind in kinds.items())
    for label, value in again.observe(again.reopen(state)).items():
        if again.outcomes[label].kind in KINDS and label in block:
            size = lane_scales(block, label, "evaluation_scale")
            scale = size.reshape(np.shape(value)[1:] if len(size) > 1 else (-1,)) + abs(value)
            worst = float((abs(value - block[label].values) / np.maximum(scale, 1e-300)).max())
            if worst > RELATIVE:
                where = f"rows {first} to {first + len(value) - 1}"
                yield f"{label} does not belong to the saved states: it is off by {worst:.2g} relative in {where}"


def steps_again(run: xr.Dataset) -> list[str]:
    """Compute the row after each of some rows, state and orientation, and compare it with the saved row.

    A row may differ by `CLOSE` (dop853: `LOOSE`, or 100 times its tolerance), and by a hundredth of the effect of a
    relative change of the start by 1e-10.  Nothing is compared if a row would need too long.
    """
    record, rows = RunRecord.from_attrs(run.attrs), run.sizes["time"]
    steps_per_row = record.every * run.sizes.get("lane", 1)
    count = min(SAMPLES, rows - 1, MOST_STEPS // steps_per_row)
    if record.is_own or count < 1 or record.recovered is not None or record.rows is not None or record.broken:
        return []
    names = [str(k) for k, v in run.data_vars.items() if v.attrs.get("kind") in ("state", "orientation")]
    tol = record.tolerance
    close = CLOSE if tol is None else max(LOOSE, 100 * tol)
    for row in np.unique(np.linspace(0, rows - 2, count).astype(int)).tolist():
        steps = min((row + 1) * record.every, record.steps) - row * record.every
        saved = run[names].isel(time=slice(row, row + 2)).load()
        try:
            computed, nudged = (_next(record, saved, steps, row * record.every, nudge) for nudge in (0.0, NUDGE))
        except (InputError, RunError):
            continue  # a state at the edge of the method's domain
        for name in names:
            value = saved[name].values[1]
            off = _difference_of_rows(computed[name], value, name)
            feels = _difference_of_rows(computed[name], nudged[name], name)
            size = abs(value).max()
            if off > close * size + feels / 100:
                return [f"{name} of row {row + 1} does not follow from row {row}: it is off by {off:.2g}"]
    return []


def _next(record: RunRecord, saved: xr.Dataset, steps: int, before: int, nudge: float) -> dict[str, Array]:
    """The row after the first of `saved`, `before` steps on, from a start that is changed by `nudge`, relative."""
    start, model = saved.isel(time=0), record.model
    same: dict[str, Any] = {"dt": record.dt, "method": record.method, "order": record.order, "tol": record.tolerance}
    asked = Settings(steps=steps, every=steps, engine="cpu", project=False, **same)
    state = {letter: start[letter].values for letter in model.system.space.letters}
    plan = plan_of(model, state, asked, start[ORIENTATION].values if ORIENTATION in saved else None)
    back, out = plan.corrections
    plan.engine.z[:] = out(plan.engine.z[None])[0]
    plan.engine.z[:] *= 1 + nudge * np.random.default_rng(0).choice([-1.0, 1.0], plan.engine.z.shape)
    plan.scheme.set_clock(plan.engine.z, (record.t_start or 0.0) + before * record.dt, record.dt)
    plan.engine.z[:] = back(plan.engine.z[None])[0]
    *_, last = Integration(plan).blocks()
    return {name: value[-1] for name, value in last.items()}


def _difference_of_rows(computed: Array, saved: Array, name: str) -> float:
    """The largest difference; q and -q are the same orientation."""
    apart = abs(computed - saved)
    if name == ORIENTATION and computed.shape[-1] == 4:
        apart = np.minimum(apart.max(-1), abs(computed + saved).max(-1))
    return float(apart.max())
