"""kr.compare: order, cost, drift and Poisson defect of several methods at one problem, in one table and one figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.method.scheme import ORIENTATION
from kreisel.process import SPENT
from kreisel.record.body import as_body
from kreisel.record.contract import Map
from kreisel.record.model import Model
from kreisel.record.units import OF_SYSTEM, BodyFrame
from kreisel.runs.drift import all_series
from kreisel.runs.in_si import duration
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import finite_number, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHORT = 8  # longest steps, in the runs whose errors give the order
PLATEAU = 1e-12  # relative errors below this come from rounding
ROWS = 1000  # of the run whose drift is shown
STENCIL = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}  # central differences of order 6
NUDGE = 1e-2  # of the largest entry of the state: errors of truncation and of rounding are both below 1e-13
SAME_FLOW = 1e-9


class Subject(NamedTuple):
    """A system and the options of `kr.simulate` that choose its method; its frame, if it is a body's."""

    model: Model
    options: Mapping[str, Any]
    frame: BodyFrame = OF_SYSTEM


@explained
@dataclass(frozen=True)
class MethodComparison:
    """Measurements of several methods at one problem; `kr.compare` returns it.

    table    a row for each method: order, error, cost, drift, worst, poisson_defect
    errors   relative error after a short time, by method and step
    drifts   the largest relative change of any Casimir or integral of the flow since the start, by method and time
    """

    table: pd.DataFrame
    errors: xr.DataArray
    drifts: xr.DataArray

    def plot(self, theme: str = "light") -> Figure:
        """Errors against steps, and drifts against time."""
        from kreisel.viewer.charts import plot_methods

        return plot_methods(self, theme=theme)

    def _repr_html_(self) -> str:
        return str(self.table.to_html(float_format="{:.3g}".format))

    def __repr__(self) -> str:
        return str(self.table.to_string(float_format="{:.3g}".format))


@explained
def compare(
    subjects: Sequence[Any] | Mapping[str, Any], start: Any, *, dt: Any, t_end: Any, halvings: int = 3
) -> MethodComparison:
    """Several methods at one problem: order, cost, drift of the integrals and Poisson defect.

    subjects  systems with their parameters, or pairs (system, {"method": ..., "order": ...}); a dict names them.  A
              pair (system, step) has your step for the flow of this system, step(*state, eps, **parameters) -> state,
              with matrices for axial vectors; it need not be Poisson.  All have the same variables and the same flow.
              Bodies of `kr.physical` without forces that need the orientation: times are in s
    start     the state, as for `kr.simulate`
    dt        the longest step;  halvings: times that it is halved to measure the order
    t_end     duration of the run whose drift is measured

    Columns of the table:

    order            the slope of the error against the step after 8 steps of dt; NaN if errors of rounding hide it, and
                     for adaptive methods
    error            the relative error there, with the step dt
    cost             nanoseconds a step
    drift, worst     the largest relative change of any Casimir or integral of the flow until t_end, and its name
    poisson_defect   the largest entry of J P J^T - P(step), relative to P, of one step; J is its Jacobian, by
                     differences, so that a Poisson map has about 1e-12; NaN if the state cannot be varied freely

    Raises `InputError` for systems with different variables or flows, and for a system without a flow, and `RunError`
    with the name of a subject whose steps fail.
    """
    listed = [_subject(subject) for subject in (subjects.values() if isinstance(subjects, Mapping) else subjects)]
    if not listed:
        raise InputError("subjects: expected one system or more, got none.")
    frame = listed[0].frame
    if any(bool(subject.frame) != bool(frame) for subject in listed):
        raise InputError("subjects: expected either bodies or systems, got both. Use body.model() and its units.")
    unit, number = (frame.time_unit, partial(duration, frame)) if frame else (1.0, finite_number)
    dt, t_end = number(dt, "dt"), number(t_end, "t_end")
    halvings = within(halvings, "halvings", 1, 10)
    state = _common_state([subject.model for subject in listed], start)
    if not (dt > 0 and t_end >= dt):
        raise InputError(f"expected 0 < dt <= t_end, got dt = {unit * dt:g} and t_end = {unit * t_end:g}.")
    truth = _end(Subject(listed[0].model, {"method": "dop853", "tol": 1e-13}), state, dt=dt, steps=SHORT, every=SHORT)
    steps = [dt / 2**k for k in range(halvings + 1)]
    rows, errors, drifts, names = list[dict[str, Any]](), list[list[float]](), list[Array](), list[str]()
    labels = subjects if isinstance(subjects, Mapping) else [f"subjects[{k}]" for k in range(len(listed))]
    for label, subject in zip(labels, listed, strict=True):
        with _named(label):
            ends, run, cost = _runs(subject, state, steps, t_end)
        errors.append([float(np.linalg.norm(end - truth) / np.linalg.norm(truth)) for end in ends])
        time, drift, worst = _drift(run)
        drifts.append(drift)
        names.append(_name(run, listed))
        order = float("nan") if RunRecord.from_attrs(run.attrs).tolerance is not None else _order(steps, errors[-1])
        measured = {"order": order, "error": errors[-1][0], "cost": cost, "drift": drift[-1], "worst": worst}
        rows.append({**measured, "poisson_defect": _poisson_defect(subject, state, dt)})
    names = list(map(str, subjects)) if isinstance(subjects, Mapping) else names
    return MethodComparison(
        pd.DataFrame(rows, index=pd.Index(names, name="method")),
        xr.DataArray(
            np.array(errors), {"method": names, "dt": [unit * step for step in steps]}, ("method", "dt"), "error"
        ),
        xr.DataArray(np.stack(drifts), {"method": names, "time": unit * time}, ("method", "time"), "drift"),
    )


def _runs(subject: Subject, state: Any, steps: Sequence[float], t_end: float) -> tuple[list[Array], xr.Dataset, float]:
    """The states after 8 of the longest steps, by each step, the run until t_end, and its nanoseconds a step."""
    ends = [_end(subject, state, dt=h, steps=SHORT * 2**k, every=SHORT * 2**k) for k, h in enumerate(steps)]
    count, before = max(1, round(t_end / steps[0])), SPENT["steps"]
    run = _simulated(subject, state, dt=steps[0], steps=count, every=max(1, count // ROWS))
    return ends, run, 1e9 * (SPENT["steps"] - before) / count


@contextmanager
def _named(label: object) -> Iterator[None]:
    """A context in which messages about a subject begin with its name."""
    try:
        yield
    except (InputError, RunError) as error:
        raise type(error)(f"{label}: {error}") from error


def _subject(entry: Any) -> Subject:
    subject, options = entry if isinstance(entry, tuple) and len(entry) == 2 else (entry, {})
    body = as_body(subject)
    model = subject if body is None else body.model()
    if not isinstance(model, Model) or not (isinstance(options, Mapping) or callable(options)):
        raise InputError(
            "subjects: expected a system with its parameters, (system, {'method': ...}), or (system, step) with your "
            f"function step(*state, eps, **parameters), got {shown(entry)}."
        )
    if callable(options):
        step = Map(step=options, poisson=False, conserves=(), rational=False)
        model, options = replace(model.system, map=step)(**model.params), {"method": "map"}
    if model.system.perturbation is not None and model.system.perturbation.names(ORIENTATION):
        raise InputError(
            f"subjects: expected bodies without forces that need the orientation, got {model.system.name}. Compare "
            "runs with kr.analysis.compare(run, second_run)."
        )
    return Subject(model, options, OF_SYSTEM if body is None else model.body_frame)


def _common_state(models: list[Model], start: Any) -> dict[str, Array]:
    """The start as arrays, if all systems have its variables and the same flow there.  Raises `InputError`."""
    first = models[0]
    state = dict(first.state(**start) if isinstance(start, Mapping) else start)
    for model in models[1:]:
        if (model.system.space.components, model.n) != (first.system.space.components, first.n):
            raise InputError(
                f"expected systems with the same variables, got {first.system.name} with "
                f"{dict(first.system.space.components)} and {model.system.name} with "
                f"{dict(model.system.space.components)}."
            )
        reference, rate = (
            algebra.flatten(m.flow(*m.state(**state).values()), m.system.space.kinds) for m in (first, model)
        )
        if not abs(reference - rate).max(initial=0.0) <= SAME_FLOW * abs(reference).max(initial=0.0):
            raise InputError(f"expected systems with one flow; {first.system.name} and {model.system.name} differ.")
    return state


def _simulated(subject: Subject, state: Any, **options: Any) -> xr.Dataset:
    from kreisel.storage.simulate import simulate

    return simulate(subject.model, state, progress=False, **subject.options, **options)


def _end(subject: Subject, state: Any, **options: Any) -> Array:
    """The last state of a run, flat."""
    space = subject.model.system.space
    last = _simulated(subject, state, **options).isel(time=-1)
    end = subject.model.state(**{letter: last[letter].values for letter in space.letters})
    return np.asarray(algebra.flatten(tuple(end.values()), space.kinds), dtype=np.float64)


def _drift(run: xr.Dataset) -> tuple[Array, Array, str]:
    """Times, the largest relative change so far of any Casimir or integral of the flow, and the name of the worst."""
    drift, worst = np.zeros(run.sizes["time"]), ""
    for series in all_series(run):
        if series.family.endswith("_eps") or series.kind == "relation":
            continue
        scale = series.step_scale + series.value_scale or 1.0
        change = np.maximum.accumulate(abs(series.values - series.values[0])) / scale
        worst = series.name if change[-1] > drift[-1] else worst
        drift = np.maximum(drift, change)
    return np.asarray(run["time"].values), drift, worst


def _order(steps: list[float], errors: list[float]) -> float:
    """The slope of log error against log step over the errors above rounding; NaN with fewer than two."""
    use = [(h, e) for h, e in zip(steps, errors, strict=True) if PLATEAU < e < 0.1]
    if len(use) < 2:
        return float("nan")
    lengths, sizes = np.log(np.array(use)).T
    return float(np.polyfit(lengths, sizes, 1)[0])


def _poisson_defect(subject: Subject, state: Mapping[str, Array], dt: float) -> float:
    """The largest entry of J P J^T - P(step), relative to the largest of P; NaN if nearby states are no states."""
    model = subject.model
    kinds, n = model.system.space.kinds, model.n
    middle = np.asarray(algebra.flatten(tuple(model.state(**state).values()), kinds), dtype=np.float64)
    nudge = NUDGE * float(abs(middle).max())
    moves = [(k, s * j, s * weight) for j, weight in STENCIL.items() for s in (1, -1) for k in range(middle.size)]
    starts = np.stack([middle, *(middle + nudge * j * np.eye(middle.size)[k] for k, j, _ in moves)])
    lanes = dict(zip(model.system.space.letters, algebra.restore(starts, kinds, n), strict=True))
    try:
        ends = _end(subject, model.state(**lanes), dt=dt, steps=1)
    except InputError:
        return float("nan")
    J = np.zeros((middle.size, middle.size))
    for end, (k, _, weight) in zip(ends[1:], moves, strict=True):
        J[:, k] += weight / nudge * end
    before, after = (model.call(model.system.space.tensor, *algebra.restore(z, kinds, n)) for z in (middle, ends[0]))
    return float(abs(J @ before @ J.T - after).max() / abs(before).max())


def _name(run: xr.Dataset, listed: list[Subject]) -> str:
    record = RunRecord.from_attrs(run.attrs)
    order = record.order
    name = record.method if order is None else f"{record.method} {order}"
    several = len({subject.model.system.title for subject in listed}) > 1
    return f"{record.title.rpartition(': ')[0]}: {name}" if several else name
