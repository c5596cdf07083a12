"""What `kreisel check` does: is an archive whole, and do its integrals belong to its states."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.methods import scheme
from kreisel.runs.archive import model_of, open_archive
from kreisel.runs.drift import KINDS

if TYPE_CHECKING:
    import xarray as xr

RELATIVE = 1e-12


def check_archive(path: Path) -> tuple[xr.Dataset | None, list[str]]:
    """The run in memory and what is wrong with it, each fault in one sentence.

    Every chunk is read, which verifies its checksum; the Casimirs and the integrals that are functions of
    the saved state alone are computed again from it.  Raises `InputError` if there is no archive at all.
    """
    run = open_archive(path)
    faults = []
    if not run.attrs.get("complete", False):
        faults.append("the run was interrupted before its end (complete = false)")
    expected = 1 + run.attrs["steps"] // run.attrs["every"] + (run.attrs["steps"] % run.attrs["every"] > 0)
    if run.attrs.get("complete", False) and run.sizes.get("time") != expected:
        faults.append(f"{expected} rows were expected, {run.sizes.get('time')} are there")
    for name in list(run.variables):
        try:
            run[name].load()
        except Exception as error:  # whatever a damaged chunk makes the libraries raise
            faults.append(f"{name} cannot be read: {error}")
            run = run.drop_vars([name])
    faults += [
        f"{name} is not finite at row {int(np.argmin(np.isfinite(v.values.reshape(len(v), -1)).all(1)))}"
        for name, v in run.data_vars.items()
        if not np.isfinite(v.values).all()
    ]
    if "time" in run.coords and not (np.diff(run["time"].values) > 0).all():
        faults.append("time does not increase")
    faults += [] if faults else _recomputed(run)
    return (run if "time" in run.coords else None), faults


def _recomputed(run: xr.Dataset) -> list[str]:
    """Integrals of the saved states against the saved integrals."""
    model = model_of(run)
    options = json.loads(run.attrs["options"])
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
            scale = np.asarray(run[name].attrs["evaluation_scale"]) + abs(value)
            worst = float((off / np.maximum(scale, 1e-300)).max())
            if worst > RELATIVE:
                faults.append(f"{name} does not belong to the saved states: it is off by {worst:.2g} relative")
    return faults
