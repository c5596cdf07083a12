"""kr.analysis.compare and error: the distance of two runs of one system, and of a run from one with half the step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from kreisel.analysis.quantities import rows_of
from kreisel.errors import InputError, explained
from kreisel.method import find
from kreisel.method.scheme import ORIENTATION
from kreisel.record.body import model_of
from kreisel.runs.drift import table_of
from kreisel.runs.in_si import in_state_form, is_in_si, names_of_state
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import finite_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kreisel.record.body import Body
    from kreisel.record.model import Model


@explained
@dataclass(frozen=True)
class Comparison:
    """Distance and drift of two runs; `compare` returns it.

    distance   Dataset along the common times (and lane): for each component of the state the Euclidean distance over
               the largest length of that component in the first run; for the orientation the angle between them, in rad
    drift      for each Casimir and integral that both runs have, max |change| in each: columns first, second, ratio
    names      of the two runs in figures
    """

    distance: xr.Dataset
    drift: pd.DataFrame
    names: tuple[str, str]

    def apart(self, tolerance: float) -> float:
        """The first common time at which a component is farther apart than the tolerance; infinite if there is none."""
        tolerance = finite_number(tolerance, "tolerance")
        beyond = np.zeros(self.distance.sizes["time"], dtype=bool)
        for name in self.distance.data_vars:
            beyond |= (self.distance[name].values.reshape(len(beyond), -1) > tolerance).any(-1)
        return float(self.distance["time"].values[beyond.argmax()]) if beyond.any() else float("inf")

    def growth(self) -> float:
        """The exponent k of distance ~ time^k, by least squares in logarithms over times with a distance > 0."""
        worst = np.max([v.values.reshape(len(v), -1).max(-1) for v in self.distance.data_vars.values()], axis=0)
        time = self.distance["time"].values
        use = (worst > 0) & (time > time[0])
        if use.sum() < 2:
            return float("nan")
        return float(np.polyfit(np.log(time[use] - time[0]), np.log(worst[use]), 1)[0])

    def plot(self, theme: str = "light") -> Figure:
        """Distances against time, and the drift of each integral in both runs."""
        from kreisel.viewer.charts import plot_comparison

        return plot_comparison(self, theme=theme)


@explained
def compare(run: xr.Dataset, second_run: xr.Dataset) -> Comparison:
    """Two runs of the same system at their common times.

    Times are the same if they agree to 1e-9 of the shortest distance between rows.  Raises `InputError` for different
    systems, dimensions or lanes, and if fewer than two times are common.
    """
    records = [RunRecord.of(dataset, "system", "n", "method") for dataset in (run, second_run)]
    for key in ("system", "n"):
        first, second = (getattr(record, key) for record in records)
        if first != second:
            raise InputError(f"Runs of one system can be compared; {key} is {first} and {second}.")
    if run.sizes.get("lane") != second_run.sizes.get("lane"):
        raise InputError("Both runs must have the same lanes; select one lane of each with isel(lane=...).")
    times, second_times = (np.asarray(dataset["time"].values) for dataset in (run, second_run))
    if min(len(times), len(second_times)) < 2:
        raise InputError("Each run needs two saved times or more.")
    tolerance = 1e-9 * min(np.diff(times).min(), np.diff(second_times).min())
    near = np.clip(np.searchsorted(second_times, times - tolerance), 0, len(second_times) - 1)
    same = np.abs(second_times[near] - times) <= np.maximum(tolerance, 4 * np.finfo(float).eps * np.abs(times))
    if same.sum() < 2:
        raise InputError("The runs have fewer than two saved times in common. Choose other steps or `every`.")
    tables = [table_of(dataset).max_change for dataset in (run, second_run)]
    common = tables[0].index.intersection(tables[1].index, sort=False)
    table = pd.DataFrame({"first": tables[0][common], "second": tables[1][common]})
    with np.errstate(all="ignore"):
        table["ratio"] = table["second"] / table["first"]
    first, second = (f"{r.method}, dt = {r.step_text(r.dt)}" if r.stepped else "exact" for r in records)
    return Comparison(_distances(run.isel(time=same), second_run.isel(time=near[same])), table, (first, second))


@explained
def error(run: xr.Dataset, system: Model | Body | None = None) -> xr.Dataset:
    """Estimate of the error of a run at each row: its `Comparison.distance` from a run with half the step.

    It costs twice as much as the run.  Nothing is extrapolated, so growing errors and chaos are included; the errors of
    a method of order p and the estimate differ by the factor 1 - 2^-p.

    system    the body or the model of the run, if it has user-defined forces or a controller, which no run holds

    Raises `InputError` for closed forms, adaptive steps, and runs without their first row or that events break.
    """
    from kreisel.storage.simulate import simulate

    rows = in_state_form(run)
    record = RunRecord.of(rows, "system", "method")
    stepped = record.stepped and find(record.method).steps and record.tolerance is None
    if not stepped or record.events is not None or rows["time"].values[0] != (record.t_start or 0):
        raise InputError(
            "error: expected a run in equal steps from its start without events, got another. A closed form has only "
            "rounding errors; the method 'dop853' has a tolerance; keep the first row."
        )
    if missing := [letter for letter in record.kinds if letter not in rows]:
        raise InputError(f"error: expected a run with the state, got no {', '.join(missing)}.")
    model = record.model if system is None else model_of(system)
    x0, times = rows.isel(time=0), rows["time"].values
    settings: dict[str, Any] = {"steps": 2 * record.steps, "every": 2 * record.every}
    if record.rows or len(times) != record.row_count:
        settings = {"times": times}
    settings |= {"method": record.method, "order": record.order, "project": bool(record.projection)}
    settings |= {"impulses": record.struck, "t_start": record.t_start}
    settings |= {"orientation": x0[ORIENTATION].values if ORIENTATION in x0 else None}
    state = {letter: x0[letter].values for letter in record.kinds}
    fine = simulate(model, state, dt=record.dt / 2, observe=(), progress=False, **settings)
    return compare(run, fine).distance


def _distances(run: xr.Dataset, second_run: xr.Dataset) -> xr.Dataset:
    """Two runs in SI are compared in SI: their bodies may differ in the units and axes of the state."""
    (dims, coords), kinds = rows_of(run), RunRecord.from_attrs(run.attrs).kinds
    shown = dict(zip(kinds, names_of_state(run), strict=True)) | {ORIENTATION: "attitude" if is_in_si(run) else "g"}
    names = shown
    if not (is_in_si(run) and is_in_si(second_run)):
        names, run, second_run = {name: name for name in shown}, in_state_form(run), in_state_form(second_run)
    data: dict[str, Any] = {}
    lead = len(dims)
    for letter in kinds:
        name = names[letter]
        if name not in run or name not in second_run:
            raise InputError(f"expected two runs with {letter} of their state, got one without.")
        first, two = (np.asarray(r[name].values).reshape((*r[name].shape[:lead], -1)) for r in (run, second_run))
        with np.errstate(all="ignore"):
            size = np.linalg.norm(first, axis=-1).max() or 1.0
            apart = np.linalg.norm(first - two, axis=-1) / size
        if not np.isfinite(apart).all():
            raise InputError(f"expected {letter} with finite squares in both runs, got larger values.")
        data[shown[letter]] = (dims, apart, {"long_name": f"distance of {letter}"})
    name = names[ORIENTATION]
    if all(name in dataset and dataset[name].shape[-1] == 4 for dataset in (run, second_run)):
        q, r = run[name].values, second_run[name].values
        nearest = np.minimum(np.linalg.norm(q - r, axis=-1), np.linalg.norm(q + r, axis=-1))
        angle = 4 * np.arcsin(np.clip(nearest / 2, 0, 1))
        data[shown[ORIENTATION]] = (dims, angle, {"long_name": "angle between the orientations", "units": "rad"})
    return xr.Dataset(data, coords)
