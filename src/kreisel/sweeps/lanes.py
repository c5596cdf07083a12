"""Lanes of a sweep computed again: as a run of one lane, to check an archive, and to find broken invariants.

A sweep saves summaries, and its description suffices to compute a lane.  It saves the change of each integral but no
scale: lanes with large changes are computed again for some steps, which measures their scales.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import xarray as xr

from kreisel.errors import ConservationWarning, InputError
from kreisel.files import read_values
from kreisel.kernels.layout import MACHINE_EPSILON, Floats
from kreisel.record.contract import System
from kreisel.runs.describing import in_memory, versions
from kreisel.runs.drift import FAR_RELATIVE, GROWN, LOOKED_AT, far, lane_scales
from kreisel.runs.integration import Integration
from kreisel.storage import checking
from kreisel.storage.checking import MOST_STEPS, SAMPLES
from kreisel.storage.opening import COMPUTED, SweepRecord
from kreisel.sweeps.ensemble import CODE, TROUBLES, Sweep
from kreisel.sweeps.store import results_of

MOST_BYTES = 1 << 30  # of a trajectory
BEGUN, ROWS = 4096, 64  # steps of a lane that are computed again, and their rows
SMALL, NOTHING = 1e-3, 1e-13  # least changes that count, relative to the part and to the largest part


def broken_lanes(result: xr.Dataset, source: Path | System | None = None) -> list[str]:
    """A sentence for each lane that lost an invariant of the method, among the sixteen with the largest changes.

    `source`: a user-defined system, or its file; without it the lanes of such a system are not judged.
    """
    changes = _changes(result)
    if not changes:
        return []
    try:
        sweep = Sweep(SweepRecord.from_attrs(result.attrs, "The sweep").description, source)
    except (InputError, KeyError):
        return []
    scores = []  # the largest relative change of an entry of a family in each lane; 1 for a small entry that is lost
    for start, drift in changes.values():
        size = abs(start).max(1, keepdims=True)
        lost = (drift > SMALL * abs(start)) & (drift > NOTHING * size)
        relative = np.divide(drift, size, out=np.where(drift > 0, 1.0, 0.0), where=size > 0)
        scores.append(np.where(lost, np.maximum(relative, SMALL), relative).max(1))
    score = np.max(scores, 0)
    score = np.where(read_values(result["failed"]) == COMPUTED, score, 0.0)
    lanes = np.argsort(-score)[:LOOKED_AT]
    sentences = []
    for lane in lanes[score[lanes] > FAR_RELATIVE].tolist():
        of_lane = {name: (first[lane], change[lane]) for name, (first, change) in changes.items()}
        sentences += [f"lane {lane}: {name}" for name in _broken(result, sweep, lane, of_lane)[:1]]
    return [
        f"{where} is not conserved, although the method conserves it. Usual cause: a step far too long for this state, "
        "or a map or an integral that contradicts its record. Use a smaller dt."
        for where in sentences
    ]


def watched_lanes(result: xr.Dataset, source: System | None = None) -> xr.Dataset:
    """The sweep itself.  Warns with `ConservationWarning` if lanes are broken, see `broken_lanes`."""
    sentences = broken_lanes(result, source)
    if sentences:
        warnings.warn(" ".join(sentences), ConservationWarning, stacklevel=4)
    return result


def _changes(result: xr.Dataset) -> dict[str, tuple[Floats, Floats]]:
    """Start and largest change (lanes, parts) of the conserved quantities."""
    out = {}
    for name, variable in sorted(result.data_vars.items(), key=lambda item: str(item[0])):  # folders have no order
        if variable.attrs.get("kind") != "drift" or not str(name).endswith("_drift"):
            continue
        if str(variable.attrs.get("long_name", "")).endswith("not conserved"):
            continue
        family = str(name).removesuffix("_drift")
        start = read_values(result[f"{family}_start"].transpose("lane", ...))
        drift = read_values(variable.transpose("lane", ...))
        out[family] = start.reshape(len(start), -1), drift.reshape(len(drift), -1)
    return out


def _broken(result: xr.Dataset, sweep: Sweep, lane: int, changes: dict[str, tuple[Floats, Floats]]) -> list[str]:
    try:
        plan = sweep.plan_of_lane(lane)
        steps, few = plan.steps, min(plan.steps, BEGUN)
        plan.settings = plan.settings.but(steps=few, every=max(1, few // ROWS))
        run = in_memory(plan, list(Integration(plan).blocks()))
    except TROUBLES:
        return []
    largest = 0.0
    for name, variable in run.data_vars.items():
        if variable.attrs["kind"] == "state":
            saved = [f"{name}_{end}" for end in ("min", "max") if f"{name}_{end}" in result]
            begun = float(abs(variable).max())
            largest_saved = max((float(abs(read_values(result[k].isel(lane=lane))).max()) for k in saved), default=0.0)
            if largest_saved > GROWN * begun:
                return []  # its scales differ from the initial scales
            largest = max(largest, begun, largest_saved)
    out = []
    for name, (start, drift) in changes.items():
        if name not in run or not run[name].attrs.get("conserved"):
            continue
        step, value = (lane_scales(run, name, key)[0] for key in ("roundoff_scale", "evaluation_scale"))
        width = MACHINE_EPSILON * (step * np.sqrt(steps) + value)
        bad = np.flatnonzero(far(drift, width, step + abs(start), plan.dt * largest))
        out += [f"{name}[{index}]" if len(start) > 1 else name for index in bad]
    return out


def one_lane(path: Path, lane: int) -> xr.Dataset:
    """The run of a lane, with an axis of this one lane.

    Raises `InputError` for a missing lane and a user-defined system, and `RunError` if the lane failed.
    """
    record = SweepRecord.of_store(path)
    if not 0 <= lane < record.lanes:
        raise InputError(f"--lane: expected 0 to {record.lanes - 1} of the sweep {path}, got {lane}.")
    description = record.description
    if not description.keys().isdisjoint(CODE):
        raise InputError(
            f"{path} is a sweep of a user-defined system, {record.system}, whose code no archive holds. Simulate the "
            "lane by kr.simulate or `kreisel run`, and view that."
        )
    plan = Sweep(description, None).plan_of_lane(lane)
    if plan.rows * plan.first.nbytes * 4 > MOST_BYTES:
        raise InputError(f"{path}: lane {lane} has {plan.rows:,} rows, too many for memory. `kreisel run` it to disk.")
    return in_memory(plan, list(Integration(plan).blocks()))


def check_archive(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """The run or sweep of an archive and its faults, as in `kreisel.storage.checking`; lanes are computed again."""
    run, faults = checking.check_archive(path)
    return run, faults if faults or run is None or "kreisel_sweep" not in run.attrs else lanes_again(run)


def lanes_again(run: xr.Dataset) -> list[str]:
    """Compute some lanes of a sweep again and compare them bit for bit with the saved lanes.

    Only if versions and processor have not changed.  Nothing is compared for a user-defined system, whose file an
    archive does not hold, and for lanes that would take too long.
    """
    record = SweepRecord.from_attrs(run.attrs, "The sweep")
    spec = record.description
    if not spec.keys().isdisjoint(CODE) or json.loads(record.versions) != versions() or record.resumed is not None:
        return []
    sweep = Sweep(spec)
    arrays = {str(name): v for name, v in run.variables.items() if "lane" in v.dims}
    for lane in np.unique(np.linspace(0, record.lanes - 1, SAMPLES).astype(int)).tolist():
        values = sweep.lanes.values(lane, lane + 1)
        settings = sweep.lanes.filled(values)["run"]
        if np.max(settings["steps"]) > MOST_STEPS // SAMPLES:
            continue
        try:
            computed = results_of(sweep, arrays, {k: v.dims.index("lane") for k, v in arrays.items()}, lane, lane + 1)
        except TROUBLES as error:
            return [f"lane {lane} cannot be computed again: {error}"]
        for name, value in computed.items():
            variable = run[name]
            saved = variable.isel(lane=slice(lane, lane + 1)).values
            if not np.array_equal(saved, value, equal_nan=value.dtype.kind == "f"):
                return [f"{name} of lane {lane} differs from the lane computed again"]
    return []
