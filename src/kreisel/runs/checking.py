"""What `kreisel check` does: is an archive whole, and do its integrals belong to its states."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.errors import InputError
from kreisel.methods import scheme
from kreisel.runs.archive import (
    CHECKSUMS,
    is_own,
    is_sweep,
    metadata_hashes,
    model_of,
    open_archive,
    too_large,
    write_checksums,
)
from kreisel.runs.blocks import COMPUTED, MISSING
from kreisel.runs.drift import KINDS, lane_scales
from kreisel.runs.reading import parsed
from kreisel.runs.sweep import open_sweep

if TYPE_CHECKING:
    import xarray as xr

RELATIVE = 1e-12


def check_archive(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """The run in memory, as far as it can be read, and what is wrong with it, each fault in one sentence.

    The metadata are compared with their hashes; every chunk is read, which verifies its checksum; the Casimirs and
    the integrals that are functions of the saved state alone are computed again from it.  Raises `InputError` if
    there is no archive at all.
    """
    if is_sweep(path):
        return check_sweep(path)
    run = open_archive(path, indexed=False)
    faults = _metadata_faults(path, run.attrs["complete"]) + _size_faults(run)
    if faults and (too_large(run) or not _fits(run)):
        return None, faults
    damaged = damaged_rows(run)
    for name, (first, last, why) in damaged:
        where = f" in rows {first} to {last}" if "time" in run[name].dims else ""
        faults.append(f"{name} cannot be read{where}: {why}")
    run = run.drop_vars({name for name, _ in damaged}).load()
    faults += [
        f"{name} is not finite at row {int(np.argmin(np.isfinite(v.values.reshape(len(v), -1)).all(1)))}"
        for name, v in run.data_vars.items()
        if v.dtype.kind == "f" and not np.isfinite(v.values).all()
    ]
    if "time" in run.coords and not (np.diff(run["time"].values) > 0).all():
        faults.append("time does not increase")
    faults += [] if faults else _recomputed(run)
    if not run.attrs["complete"]:
        faults.insert(0, "the run was interrupted before its end: `kreisel resume` goes on with it")
    return (run.set_xindex("time") if "time" in run.coords else None), faults


def check_sweep(path: Path) -> tuple[xr.Dataset, list[str]]:
    """A sweep, not yet read, and what is wrong with it.

    The metadata are compared with their hashes; every chunk is read, which verifies its checksum; lanes that did not
    fail must have finite values.
    """
    run = open_sweep(path)
    attrs = run.attrs
    faults = _metadata_faults(path, attrs["complete"]) + too_large(run)
    if run.sizes.get("lane") != attrs["lanes"] or "failed" not in run:
        faults.append(f"{attrs['lanes']:,} lanes were expected, {run.sizes.get('lane', 0):,} are there")
    if faults:
        return run, faults
    width, missing = attrs["block_lanes"], 0
    for first in range(0, attrs["lanes"], width):
        lanes = run.isel(lane=slice(first, first + width))
        last = first + lanes.sizes["lane"] - 1
        try:
            state = lanes["failed"].values
        except Exception as error:  # whatever a damaged chunk makes the libraries raise
            faults.append(f"failed cannot be read in lanes {first} to {last}: {error or type(error).__name__}")
            continue
        if (state == MISSING).all():
            missing += 1
            continue
        for name, variable in lanes.data_vars.items():
            try:
                values = variable.transpose("lane", ...).values if "lane" in variable.dims else variable.values
            except Exception as error:  # the same
                faults.append(f"{name} cannot be read in lanes {first} to {last}: {error or type(error).__name__}")
                continue
            if values.dtype.kind == "f" and not np.isfinite(values[state == COMPUTED]).all():
                faults.append(f"{name} is not finite in lanes {first} to {last}, although they did not fail")
    blocks = -(-attrs["lanes"] // width)
    if missing and attrs["complete"]:
        faults.append(f"{missing:,} of {blocks:,} blocks are missing")
    elif not attrs["complete"]:
        faults.insert(0, f"the sweep was interrupted: {missing:,} of {blocks:,} blocks are to do")
    return run, faults


def _metadata_faults(path: Path, complete: bool) -> list[str]:
    """Metadata that are not as they were written; of an interrupted run they still change."""
    try:
        written = dict(parsed((path / CHECKSUMS).read_bytes(), CHECKSUMS).items())
        here = metadata_hashes(path)
        faults = [f"{name.removesuffix('/zarr.json')} is missing" for name in written if name not in here]
        changed = [name for name, value in written.items() if here.get(name, value) != value]
    except FileNotFoundError:
        return [f"{CHECKSUMS} is missing"] if complete else []
    except (OSError, ValueError, AttributeError) as error:
        return [f"{CHECKSUMS} cannot be read: {error}"]
    return faults + [f"{name} was changed after the run" for name in changed]


def _size_faults(run: xr.Dataset) -> list[str]:
    attrs = run.attrs
    expected = 1 + attrs["steps"] // attrs["every"] + (attrs["steps"] % attrs["every"] > 0)
    rows = run.sizes.get("time", 0)
    faults = [f"{expected} rows were expected, {rows} are there"] if attrs["complete"] and rows != expected else []
    faults += too_large(run)
    if not _fits(run):
        faults.append(f"it claims to hold {run.nbytes:,} bytes, more than this machine's memory: not read")
    return faults


def _fits(run: xr.Dataset) -> bool:
    return run.nbytes < os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def damaged_rows(run: xr.Dataset) -> list[tuple[str, tuple[int, int, str]]]:
    """The rows of each variable that cannot be read, in whole chunks: its name, first and last row, and why."""
    rows = run.sizes.get("time", 0)
    found: list[tuple[str, tuple[int, int, str]]] = []
    for name, variable in run.variables.items():
        chunk = (variable.encoding.get("chunks") or (run.attrs["rows_in_block"],))[0]
        for first in range(0, rows, chunk) if "time" in variable.dims else [0]:
            last = min(first + chunk, rows) - 1
            why = _trouble(variable[first : last + 1] if "time" in variable.dims else variable)
            if why is None:
                continue
            if found and found[-1][0] == name and found[-1][1][1:] == (first - 1, why):
                first = found.pop()[1][0]  # the same goes on
            found.append((str(name), (first, last, why)))
    return found


def _trouble(part: xr.Variable) -> str | None:
    """Why a part cannot be read, if so."""
    try:
        values = part.values
        lost = values.dtype.kind == "f" and values.size > 0 and bool(np.isnan(values).all())
    except Exception as error:  # whatever a damaged chunk makes the libraries raise
        return str(error) or type(error).__name__
    return "nothing is there" if lost else None


def recover(path: Path, out: Path) -> tuple[int, int]:
    """Write the rows of a damaged archive that are whole in every variable to a new one; how many, and of how many.

    The new archive has the attribute `recovered`, and complete = false where rows are lost.  Raises `InputError` where
    nothing is whole, or `out` exists.
    """
    if out.exists():
        raise InputError(f"{out} exists already and is left as it is. Choose another path for what is recovered.")
    run = open_archive(path, indexed=False)
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
    whole.attrs.update(complete=not lost, recovered=f"{int(keep.sum())} of {rows} rows of {path.name}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        whole.to_zarr(out, zarr_format=3)
    write_checksums(out)
    return int(keep.sum()), rows


def _recomputed(run: xr.Dataset) -> list[str]:
    """Integrals of the saved states against the saved integrals."""
    if is_own(run.attrs):
        return []
    model = model_of(run.attrs)
    options = parsed(run.attrs["options"], "The attribute options")
    plan = scheme(model, run.attrs["method"], run.attrs["dt"], options.get("order"), oriented=False)
    kinds = dict(model.system.space.components)
    missing = [f"{name} is missing" for name in plan.outcomes if name not in run]
    if missing:
        return missing
    state = tuple(algebra.hat(run[k].values) if kinds[k] == "skew" and model.n == 3 else run[k].values for k in kinds)
    outputs = plan.observe(plan.reopen(state))
    faults = []
    for name, value in outputs.items():
        if plan.outcomes[name].kind in KINDS:
            off = abs(value - run[name].values)
            size = lane_scales(run[name], "evaluation_scale")
            scale = size.reshape(np.shape(value)[1:] if len(size) > 1 else (-1,)) + abs(value)
            worst = float((off / np.maximum(scale, 1e-300)).max())
            if worst > RELATIVE:
                faults.append(f"{name} does not belong to the saved states: it is off by {worst:.2g} relative")
    return faults
