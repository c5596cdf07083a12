"""Samples of a run and of a sweep, computed again for `kreisel check`: whether the saved numbers follow each other."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.method.observing import COUNT, ORIENTATION
from kreisel.record.perturbation import TIME
from kreisel.runs.describing import versions
from kreisel.runs.integration import Integration
from kreisel.runs.plan import Plan
from kreisel.runs.planning import plan_of
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import Settings
from kreisel.sweeps.blocks import TROUBLES, Sweep, results_of
from kreisel.sweeps.sweep_record import SweepRecord

if TYPE_CHECKING:
    import xarray as xr

SAMPLES = 8
MOST_STEPS = 200_000  # lane-steps in all samples together; below a second for most maps
NUDGE = 1e-10  # relative change of a start, which measures how sensitive a row is to the one before
CLOSE, LOOSE = 1e-7, 1e-4  # relative: of maps, and of dop853, which chooses its own steps (at least)


def steps_again(run: xr.Dataset) -> list[str]:
    """Compute the row after each of some rows, state and orientation, and compare it with the saved one.

    A row may differ by `CLOSE` (dop853: `LOOSE`, or 100 times its tolerance), and by a hundredth of the effect of a
    relative change of the start by 1e-10.  Nothing is compared where a row takes too long.
    """
    record, rows = RunRecord.from_attrs(run.attrs), run.sizes["time"]
    each = record.every * run.sizes.get("lane", 1)
    count = min(SAMPLES, rows - 1, MOST_STEPS // each)
    if record.is_own or count < 1 or record.recovered is not None or record.rows is not None or record.broken:
        return []
    names = [str(k) for k, v in run.data_vars.items() if v.attrs.get("kind") in ("state", "orientation")]
    tol = record.tolerance
    close = CLOSE if tol is None else max(LOOSE, 100 * tol)
    for row in np.unique(np.linspace(0, rows - 2, count).astype(int)).tolist():
        steps = min((row + 1) * record.every, record.steps) - row * record.every
        saved = run[names].isel(time=slice(row, row + 2)).load()
        try:
            here, nudged = (_next(record, saved, steps, row * record.every, nudge) for nudge in (0.0, NUDGE))
        except (InputError, RunError):
            continue  # a state at the edge of what the method takes
        for name in names:
            value = saved[name].values[1]
            off = _difference_of_rows(here[name], value, name)
            feels = _difference_of_rows(here[name], nudged[name], name)
            size = abs(value).max()
            if off > close * size + feels / 100:
                return [f"{name} of row {row + 1} does not follow from row {row}: it is off by {off:.2g}"]
    return []


def _next(record: RunRecord, saved: xr.Dataset, steps: int, before: int, nudge: float) -> dict[str, Array]:
    """The row after the first of `saved`, `before` steps on, from a start that is changed by `nudge`, relative."""
    plan = _plan_from_row(record, saved, steps)
    back, out = plan.corrections
    plan.engine.z[:] = out(plan.engine.z[None])[0]
    plan.engine.z *= 1 + nudge * np.random.default_rng(0).choice([-1.0, 1.0], plan.engine.z.shape)
    letters = [letter for letter, _ in plan.scheme.components]
    for clock, now in ((COUNT, float(before)), (TIME, before * record.dt)):  # of forces that depend on time
        if clock in letters:
            kinds = plan.kinds[: letters.index(clock)]
            plan.engine.z[:, algebra.coordinate_count(kinds, plan.model.n)] = now
    plan.engine.z[:] = back(plan.engine.z[None])[0]
    *_, last = Integration(plan).blocks()
    return {name: value[-1] for name, value in last.items()}


def _plan_from_row(record: RunRecord, saved: xr.Dataset, steps: int) -> Plan:
    start = saved.isel(time=0)
    model = record.model
    asked = Settings(
        dt=record.dt,
        steps=steps,
        every=steps,
        method=record.method,
        order=record.order,
        tol=record.tolerance,
        engine="cpu",
        project=False,
    )
    state = {letter: start[letter].values for letter in model.system.space.letters}
    return plan_of(model, state, asked, start[ORIENTATION].values if ORIENTATION in saved else None)


def _difference_of_rows(one: Array, two: Array, name: str) -> float:
    """The largest difference; q and -q are the same orientation."""
    apart = abs(one - two)
    if name == ORIENTATION and one.shape[-1] == 4:
        apart = np.minimum(apart.max(-1), abs(one + two).max(-1))
    return float(apart.max())


def lanes_again(run: xr.Dataset) -> list[str]:
    """Compute some lanes of a sweep again and compare them bit for bit with what is saved.

    Only where versions and processor are those of the sweep.  Nothing is compared for a system of the user's own, whose
    file an archive does not hold, and for lanes that take too long.
    """
    record = SweepRecord.from_attrs(run.attrs, "The sweep")
    spec = record.description
    if "file" in spec or json.loads(record.versions) != versions() or record.resumed is not None:
        return []
    sweep = Sweep(spec)
    arrays = {str(name): v for name, v in run.variables.items() if "lane" in v.dims}
    for lane in np.unique(np.linspace(0, record.lanes - 1, SAMPLES).astype(int)).tolist():
        values = sweep.lanes.values(lane, lane + 1)
        settings = sweep.lanes.filled(values)["run"]
        if np.max(settings["steps"]) > MOST_STEPS // SAMPLES:
            continue
        try:
            here = results_of(sweep, arrays, {k: v.dims.index("lane") for k, v in arrays.items()}, lane, lane + 1)
        except TROUBLES as error:
            return [f"lane {lane} cannot be computed again: {error}"]
        for name, value in here.items():
            variable = run[name]
            saved = variable.isel(lane=slice(lane, lane + 1)).values
            if not np.array_equal(saved, value, equal_nan=value.dtype.kind == "f"):
                return [f"{name} of lane {lane} is not what the lane gives when it is computed again"]
    return []
