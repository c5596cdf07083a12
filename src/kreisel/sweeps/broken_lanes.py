"""Lanes of a sweep in which something that the method conserves is not conserved.

A sweep saves how far each integral has changed, and no scale.  Lanes with large changes are begun again for some steps,
which measures their scales.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kreisel.errors import ConservationWarning, InputError
from kreisel.files import read_values
from kreisel.kernels.layout import MACHINE_EPSILON, Floats
from kreisel.runs.drift import FAR_RELATIVE, GROWN, LOOKED_AT, far, lane_scales
from kreisel.runs.integration import Integration
from kreisel.sweeps.blocks import COMPUTED, TROUBLES, Sweep
from kreisel.sweeps.sweep_record import SweepRecord

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.runs.plan import Plan

BEGUN, ROWS = 4096, 64  # steps of a lane that are made again, and the rows of them
SMALL, NOTHING = 1e-3, 1e-13  # a change of a part by so much of itself counts, unless it is nothing beside the others


def broken_lanes(result: xr.Dataset, file: Path | None = None) -> list[str]:
    """A sentence for each lane that lost what the method conserves, among the sixteen with the largest changes.

    `file` defines a system of the user's own; without it the lanes of such a system are not judged.
    """
    changes = _changes(result)
    if not changes:
        return []
    try:
        sweep = Sweep(SweepRecord.from_attrs(result.attrs, "The sweep").description, file)
    except (InputError, KeyError):
        return []
    score = np.where(
        read_values(result["failed"]) == COMPUTED, np.max([_score(*pair) for pair in changes.values()], 0), 0.0
    )
    lanes = np.argsort(-score)[:LOOKED_AT]
    sentences = []
    for lane in lanes[score[lanes] > FAR_RELATIVE].tolist():
        here = {name: (start[lane], drift[lane]) for name, (start, drift) in changes.items()}
        sentences += [f"lane {lane}: {name}" for name in _broken(result, sweep, lane, here)[:1]]
    return [
        f"{where} is not conserved, although the method conserves it. Usual cause: a step far too long for this state, "
        "or a map or an integral that is not what its record says. Use a smaller dt."
        for where in sentences
    ]


def watched_lanes(result: xr.Dataset) -> xr.Dataset:
    """The sweep itself.  Warns with `ConservationWarning` where lanes are broken, as `broken_lanes` says."""
    sentences = broken_lanes(result)
    if sentences:
        warnings.warn(" ".join(sentences), ConservationWarning, stacklevel=4)
    return result


def _changes(result: xr.Dataset) -> dict[str, tuple[Floats, Floats]]:
    """Start and largest change (lanes, parts) of what is conserved."""
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


def _score(start: Floats, drift: Floats) -> Floats:
    """How much of its family's size a part has changed, at most, in each lane; 1 for a small part that is lost."""
    size = abs(start).max(1, keepdims=True)
    lost = (drift > SMALL * abs(start)) & (drift > NOTHING * size)
    relative = np.divide(drift, size, out=np.where(drift > 0, 1.0, 0.0), where=size > 0)
    return np.asarray(np.where(lost, np.maximum(relative, SMALL), relative).max(1))


def _broken(result: xr.Dataset, sweep: Sweep, lane: int, changes: dict[str, tuple[Floats, Floats]]) -> list[str]:
    from kreisel.runs.describing import in_memory

    try:
        plan = _begun(sweep, lane)
        steps, few = plan.steps, min(plan.steps, BEGUN)
        plan.settings = plan.settings.but(steps=few, every=max(1, few // ROWS))
        run = in_memory(plan, list(Integration(plan).blocks()))
    except TROUBLES:
        return []
    largest = 0.0
    for name, variable in run.data_vars.items():
        if variable.attrs["kind"] == "state":
            begun, whole = float(abs(variable).max()), _extreme(result, str(name), lane)
            if whole > GROWN * begun:
                return []  # its scales are not those of the beginning
            largest = max(largest, begun, whole)
    out = []
    for name, (start, drift) in changes.items():
        if name not in run or not run[name].attrs.get("conserved"):
            continue
        step, value = (lane_scales(run[name], key)[0] for key in ("roundoff_scale", "evaluation_scale"))
        width = MACHINE_EPSILON * (step * np.sqrt(steps) + value)
        bad = np.flatnonzero(far(drift, width, step + abs(start), plan.dt * largest))
        out += [f"{name}[{part}]" if len(start) > 1 else name for part in bad]
    return out


def _begun(sweep: Sweep, lane: int) -> Plan:
    values = sweep.lanes.values(lane, lane + 1)
    sections, varied = sweep.lanes.filled(values), {(q.section, q.letter) for q in values}
    ids, choice = sweep.alike(sections, np.arange(1), varied)[0]
    return sweep.plan(sections, ids, varied, choice)


def _extreme(result: xr.Dataset, name: str, lane: int) -> float:
    """The largest entry of a component of the state over the whole run, where it was saved."""
    saved = [f"{name}_{end}" for end in ("min", "max") if f"{name}_{end}" in result]
    return max((float(abs(read_values(result[k].isel(lane=lane))).max()) for k in saved), default=0.0)
