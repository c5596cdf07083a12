"""A lane of a sweep made again as a run: a sweep saves summaries, and its description has all that a lane needs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kreisel.errors import InputError
from kreisel.runs.describing import in_memory
from kreisel.runs.integration import Integration
from kreisel.sweeps.blocks import Sweep
from kreisel.sweeps.sweep_record import SweepRecord

if TYPE_CHECKING:
    import xarray as xr

MOST_BYTES = 1 << 30  # of a trajectory


def one_lane(path: Path, lane: int) -> xr.Dataset:
    """The run of a lane, with an axis of this one lane.

    Raises `InputError` for a lane that is not there and a system of the user's own, and `RunError` where the lane
    failed.
    """
    record = SweepRecord.of_store(path)
    if not 0 <= lane < record.lanes:
        raise InputError(f"--lane: expected 0 to {record.lanes - 1} of the sweep {path}, got {lane}.")
    description = record.description
    if description.get("file"):
        raise InputError(
            f"{path} is a sweep of a system of your own, {record.system}, whose Python file no archive holds. Write "
            "the lane as a TOML file, `kreisel run` it, and view that."
        )
    sweep = Sweep(description, None)
    values = sweep.lanes.values(lane, lane + 1)
    sections, varied = sweep.lanes.filled(values), {(q.section, q.letter) for q in values}
    ((ids, choice),) = sweep.alike(sections, np.arange(1), varied)
    plan = sweep.plan(sections, ids, varied, choice)
    if plan.rows * plan.first.nbytes * 4 > MOST_BYTES:
        raise InputError(f"{path}: lane {lane} has {plan.rows:,} rows, too many for memory. `kreisel run` it to disk.")
    return in_memory(plan, list(Integration(plan).blocks()))
