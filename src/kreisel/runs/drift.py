"""kr.drift: the drift of the integrals, compared with round-off; and the claims that are broken."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import AccuracyWarning, ConservationWarning, InputError, doubt, explained
from kreisel.files import read_values
from kreisel.kernels.layout import MACHINE_EPSILON, Floats
from kreisel.method import scheme
from kreisel.method.scheme import KINDS, ORIENTATION
from kreisel.runs.geometry import require_unchanged
from kreisel.runs.in_si import frame_in_si, in_state_form
from kreisel.runs.plan import NOT_CONSERVED, Plan
from kreisel.runs.run_record import RunRecord, a_run
from kreisel.runs.settings import Settings

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

# An integral that a method conserves is broken if it has changed by more than FAR widths of a random walk of rounding
# errors, times the square of a step's angle in radians, and by more than FAR_RELATIVE of its scale.  Measured over 1000
# steps of the tops' maps and Clebsch's, n = 3, 4, 5, with states that are random, asleep, at rest, nearly so, momenta
# times 1e-8 to 1e8: at most 20 widths for steps up to 3 and momenta up to 1, 4e3 at Clebsch's longest steps.  Rounding
# errors grow about as the angle of a step.  A walk of Gaussian steps gets 40 times as far as its width with a chance
# below 1e-300.
FAR = 1e4
FAR_RELATIVE = 1e-9
LOOSE = 0.2  # of the terms of the energy: an oscillation that shows that a step is too long
COLUMNS = ["kind", "conserved", "start", "max_change", "ulps", "slope", "correction", "broken"]
GROWN = 100  # times the state of the first block
LOOKED_AT = 16  # lanes at most, in which the width of the walk is measured again
NUMBERS_AT_ONCE = 1 << 19  # of a variable, in memory
FEW_ROWS, NARROW = 1024, 16  # values in a row
SCALES = "roundoff_scale", "evaluation_scale"  # attributes


@explained
def drift(run: xr.Dataset) -> pd.DataFrame:
    """One row for each Casimir, integral and invariant relation of a run.

    kind        "casimir", "integral", or "relation": f of an invariant relation f = 0, which stays 0 if it starts so
    conserved   whether the method conserves it; a map conserves its deformed integrals, names ending in _eps
    start       value at the first saved time
    max_change  largest |change| since then; of a run of a body in the units of the run, as start and slope
    ulps        max_change in units of eps_machine times the scale of the integral, which is the size of its terms: the
                largest of its value, of the rounding errors of its formula, and of its change, over eps_machine, if
                every entry of the state changes by eps_machine times the largest one, the root mean square
    slope       least-squares slope of the change against time
    correction  the largest distance by which the projection moved the state for this family of integrals, in units of
                eps_machine |state|; NaN without projection, and for integrals that are not conserved
    broken      it should be conserved and is not: it changed by more than 1e-9 of its scale, and by more than
                1e4 (1 + (dt |z|)^2) times a random walk of rounding errors, |z| the state's largest entry

    In an ensemble each row shows the worst lane, the lane with the largest change relative to its rounding errors.
    Beyond some hundred lanes they share one scale of rounding, the largest.  Variables are read in blocks of rows: an
    archive may be longer than memory.  The table is empty for systems without Casimirs and integrals.  Raises
    `InputError` for anything but a run, and for a run with observe=[].
    """
    table = table_of(run)
    if table.empty and "observe" in run.attrs:
        raise InputError(
            "expected a run with Casimirs or integrals, got one that saved none, observe=[]. Run it again without "
            "observe, or with the names of some."
        )
    if table.empty and not any(v.attrs.get("kind") == "state" for v in run.variables.values()):
        raise InputError(
            "expected a run with Casimirs or integrals, got a Dataset whose variables have no attributes. Usual cause: "
            "an operation of xarray, which drops them; xarray.set_options(keep_attrs=True) keeps them."
        )
    return table


def table_of(run: xr.Dataset) -> pd.DataFrame:
    """The table of `drift`; empty for a run that saved no Casimirs and integrals."""
    import pandas as pd

    if "kreisel_sweep" in getattr(run, "attrs", {}):
        raise InputError("A sweep has the drift of each lane in its variables NAME_drift; kr.drift needs a run.")
    if not a_run(run, "system", rows=False)["time"].size or run["time"].dims not in ((), ("time",)):
        raise InputError(f"expected a run with at least one row along time, got the times {run['time'].shape}.")
    require_unchanged(run)
    rows = _rows(run, _watched(run))
    return pd.DataFrame.from_dict(rows, orient="index", columns=None if rows else COLUMNS)


def _rows(run: xr.Dataset, names: list[str], sloping: bool = True) -> dict[str, dict[str, Any]]:
    run = run if "time" in run.dims else run.expand_dims("time")
    clock, rows = _Clock(run), dict[str, dict[str, Any]]()
    for name in names:
        scan = _Scan(name, run, clock, sloping)
        width, unknown = _widths(run, scan)
        for column, label in enumerate(scan.labels):
            lane = int(_ratio(scan.largest[:, column], width[:, column]).argmax())  # the worst
            change, limit = float(scan.largest[lane, column]), float(width[lane, column])
            scale = scan.step_scale[lane, column]
            off = scan.conserved and change > FAR * limit and lane not in unknown
            if off:  # dt times the largest entry of the state: about the angle of rotation in a step
                states = in_state_form(run)
                turn = max(_sizes(states, lane, slice(None)), default=0.0) * float(states.attrs.get("dt", 0.0))
                off = bool(far(change, limit, scale + abs(scan.start[lane, column]), turn))
            rows[label] = {
                "kind": scan.kind,
                "conserved": scan.conserved,
                "start": float(scan.start[lane, column]) + 0.0,
                "max_change": change,
                "ulps": float(_ratio(change, MACHINE_EPSILON * max(scan.value_scale[lane, column], scale))),
                "slope": float(scan.slope[lane, column]),
                "correction": float(scan.correction),
                "broken": off,
            }
    return rows


def _widths(run: xr.Dataset, scan: _Scan) -> tuple[np.ndarray, set[int]]:
    """The widths of the walks of rounding errors, and lanes of which they are not known.

    The worst suspect lanes are measured again, by states of all blocks: the first may rest.  If this is impossible, as
    for a user-defined system, lanes whose state has grown are unknown.
    """
    width = scan.width()
    ratios = _ratio(scan.largest, width)
    lanes = np.flatnonzero((ratios > FAR).any(1))
    if not scan.conserved or not lanes.size:
        return width, set()
    lanes = lanes[np.argsort(-ratios.max(1)[lanes])][:LOOKED_AT]
    unit, run = frame_in_si(run).size(scan.name), in_state_form(run)
    scales = whole_run(run, scan.name, lanes)
    if scales is not None:
        for mine, new in zip((scan.step_scale, scan.value_scale), scales, strict=True):
            mine[lanes] = np.maximum(mine[lanes], unit * new.reshape(len(lanes), -1))
        return scan.width(), set()
    first = slice(0, max(1, int(run.attrs.get("rows_in_block", 1))))

    def has_grown(lane: int) -> bool:
        sizes = zip(_sizes(run, lane, slice(None)), _sizes(run, lane, first), strict=True)
        return any(size > GROWN * begun for size, begun in sizes)

    return width, {lane for lane in lanes.tolist() if has_grown(lane)}


def _sizes(run: xr.Dataset, lane: int, rows: slice) -> list[float]:
    """The largest entry of each component of the state in a lane, in some rows."""
    some = run.isel(time=rows)
    some = some.isel(lane=lane) if "lane" in some.dims else some
    states = [v for v in some.data_vars.values() if v.attrs.get("kind") == "state" and "time" in v.dims]
    blocks = list(_Clock(some).blocks(max((v[0].size for v in states), default=1)))
    return [max(float(abs(read_values(v[rows])).max()) for rows in blocks) for v in states]


def broken(table: pd.DataFrame) -> list[str]:
    """A sentence for each row of `kr.drift` that should be conserved and is not."""
    return [_sentence(str(name), row) for name, row in table.iterrows() if row["broken"]]


def far(change: Any, width: Any, scale: Any, turn: float) -> Any:
    """Whether a change exceeds rounding errors, which walk by `width`; the body rotates by `turn` in a step."""
    return (change > FAR * width * (1 + turn * turn)) & (change > FAR_RELATIVE * scale)


def _sentence(name: str, row: Any) -> str:
    return (
        f"{name} is not conserved, although the method conserves it: expected a change of some units in the last "
        f"place, got {row['max_change']:.2g} from {row['start']:.6g}. Usual cause: {NOT_CONSERVED}"
    )


def watched(run: xr.Dataset, loaded: bool = False) -> xr.Dataset:
    """The run itself; `loaded`: it is in memory.

    Warns with `ConservationWarning` if an invariant is broken, with `AccuracyWarning` if the energy, minus the work,
    oscillates by a large part of its terms.
    """

    def rests(variable: xr.Variable) -> bool:
        """Whether no value changed by more than the error of an evaluation, at a tenth of the cost of a scan."""
        low, high = _extremes(variable.values)
        least = min(variable.attrs["evaluation_scale"], default=0.0)
        return bool((high - low).max(initial=0.0) <= FAR * MACHINE_EPSILON * least)

    if not loaded or not all(rests(v) for v in run.variables.values() if v.attrs.get("conserved")):
        conserved = [name for name in _watched(run) if run.variables[name].attrs.get("conserved")]
        rows = _rows(run, conserved, sloping=False)
        if sentences := [_sentence(name, row) for name, row in rows.items() if row["broken"]]:
            doubt(" ".join(sentences), ConservationWarning)
    kept = ["balance"] if "work" in run.variables else ["total_energy", "energy"]
    energy = next((name for name in kept if name in run.variables), None)
    changed = run.attrs.get("impulses") or run.attrs.get("events")
    if energy is None or changed or run.variables[energy].attrs.get("conserved"):
        return run
    ((_, row),) = _rows(run, [energy], sloping=False).items()
    if row["max_change"] > LOOSE * lane_scales(run, energy, "evaluation_scale").max():
        later = whole_run(in_state_form(run), energy, _spread(run.sizes.get("lane", 1), LOOKED_AT))  # it may begin at 0
        terms = 0.0 if later is None else max(later[0].max() / 2, later[1].max())  # its degree is 2
        if row["max_change"] <= LOOSE * terms * frame_in_si(run).size(energy):
            return run
        doubt(
            f"{energy} oscillates by {row['max_change']:.2g} about {row['start']:.4g}: the step is too long for this "
            "motion and order, and the state is off. Use a smaller dt or a higher order; baecklund and splitting "
            "choose both for order='auto' with tol=....",
            AccuracyWarning,
        )
    return run


def _watched(run: xr.Dataset) -> list[str]:
    """The Casimirs, integrals and relations; conserved quantities first."""
    result = {str(name): v.attrs for name, v in run.variables.items() if v.attrs.get("kind") in KINDS}
    return sorted(
        result, key=lambda name: (not result[name].get("conserved", False), KINDS.index(result[name]["kind"]))
    )


class _Clock:
    """The times of a run, in blocks of its rows."""

    def __init__(self, run: xr.Dataset):
        self._time, self._asked = run.variables["time"], int(run.attrs.get("rows_in_block", 0))
        self.rows = run.sizes["time"]
        ends = read_values(self._time[[0, -1]])
        # only existing times: a run may be cut short; `kr.at` has no steps
        dt = run.attrs.get("dt")
        self.steps = abs(float(ends[1] - ends[0])) / dt if isinstance(dt, int | float) and dt > 0 else 0.0
        self.first = float(ends[0])

    def blocks(self, width: int) -> Iterator[slice]:
        """Slices of rows for variables of `width` values a row: blocks of the archive, if these are not too large."""
        most = max(1, NUMBERS_AT_ONCE // max(1, width))
        step = min(self._asked, most) if self._asked > 0 else most
        return (slice(row, min(row + step, self.rows)) for row in range(0, self.rows, step))

    def centred(self, rows: slice) -> np.ndarray:
        """Times of some rows, minus their mean over all rows."""
        return np.asarray(read_values(self._time[rows]) - self.first - self._mean)

    @cached_property
    def _mean(self) -> float:
        return sum(float((read_values(self._time[rows]) - self.first).sum()) for rows in self.blocks(1)) / self.rows

    @cached_property
    def spread(self) -> float:
        """The sum of the squares of the centred times."""
        return sum(float(t @ t) for t in map(self.centred, self.blocks(1)))


class _Scan:
    """A variable (time, [lane], [part]) read once, in blocks: arrays (lanes, parts) that describe its change."""

    def __init__(self, name: str, run: xr.Dataset, clock: _Clock, sloping: bool):
        variable = run.variables[name]
        self.name, self.kind = name, str(variable.attrs["kind"])
        self.conserved = bool(variable.attrs.get("conserved", False))
        family = variable.ndim > 1 + ("lane" in variable.dims)
        self.labels = [f"{self.name}[{column}]" for column in range(variable.shape[-1])] if family else [self.name]
        self.shape = (variable.sizes.get("lane", 1), len(self.labels))
        scales = (np.broadcast_to(lane_scales(run, name, key), self.shape) for key in SCALES)
        self.step_scale, self.value_scale = (np.array(scale) for scale in scales)
        self.correction = variable.attrs.get("largest_correction", np.nan)
        self.steps = clock.steps
        self.start, self.largest, total = (np.zeros(self.shape) for _ in range(3))
        for rows in clock.blocks(self.start.size):
            values = read_values(variable[rows], name).astype(np.float64).reshape(-1, *self.shape)
            if rows.start == 0:
                self.start = values[0]
            low, high = _extremes(values)
            self.largest = np.maximum(self.largest, np.maximum(high - self.start, self.start - low))
            if sloping:
                total += np.tensordot(clock.centred(rows), values - self.start, 1)
        self.slope = total / clock.spread if sloping and clock.spread > 0 else total

    def width(self) -> np.ndarray:
        """The width of a random walk of rounding errors, in every lane and part."""
        return MACHINE_EPSILON * (self.step_scale * np.sqrt(self.steps) + self.value_scale)


@dataclass(frozen=True)
class Series:
    """One scalar of a run against time; in an ensemble its worst lane, with the scales of that lane."""

    name: str
    family: str
    kind: str
    conserved: bool
    values: np.ndarray
    step_scale: float
    value_scale: float


def all_series(run: xr.Dataset) -> Iterator[Series]:
    """Every component of every Casimir and integral; conserved quantities first."""
    many = run.sizes.get("lane", 1) > 1
    scanned = run if many else run.isel(time=slice(0, 1))
    clock = _Clock(scanned)
    for name in _watched(run):
        variable, scan = run.variables[name], _Scan(name, scanned, clock, False)
        for column, label in enumerate(scan.labels):
            lane = int(_ratio(scan.largest[:, column], scan.width()[:, column]).argmax()) if many else 0
            series = variable.isel(lane=lane) if "lane" in variable.dims else variable
            # one part at a time: an archive may be longer than memory
            values = read_values(series[..., column] if series.ndim > 1 else series, name)
            at = float(scan.step_scale[lane, column]), float(scan.value_scale[lane, column])
            yield Series(label, name, scan.kind, scan.conserved, values, *at)


def _extremes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest along the first axis; NumPy is slow if the other axes are short."""
    if len(values) > FEW_ROWS and values[0].size < NARROW:
        values = np.asfortranarray(values)
    return np.minimum.reduce(values, 0), np.maximum.reduce(values, 0)


def lane_scales(run: xr.Dataset, name: str, key: str) -> np.ndarray:
    """An attribute of scales (lanes or 1, parts) of a variable, for the lanes that the run still has.

    Raises `InputError` if it does not belong to the variable.
    """
    variable = run.variables[name]
    parts = variable.shape[-1] if variable.ndim > 1 + ("lane" in variable.dims) else 1
    try:
        values = np.atleast_1d(np.asarray(variable.attrs[key], dtype=np.float64)).reshape(-1, parts)
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{name} is damaged: its attribute {key} does not belong to it.") from None
    if len(values) > 1 and "lane" in run.variables:
        lanes = np.atleast_1d(run.variables["lane"].values)
        if lanes.dtype.kind in "iu" and (lanes >= 0).all() and (lanes < len(values)).all():
            return values[lanes]
    return values.max(0, keepdims=True)


def _ratio(change: Any, width: Any) -> Any:
    return np.divide(change, width, out=np.where(change > 0, np.inf, 0.0), where=width > 0)


ROWS = 32


def whole_run(run: xr.Dataset, name: str, lanes: np.ndarray) -> tuple[Floats, Floats] | None:
    """The attributes roundoff_scale and evaluation_scale of a variable for some lanes, from rows of the complete run.

    None if they cannot be measured: for a user-defined system, whose functions an archive lacks, or a run without its
    states or its step.
    """
    record = RunRecord.from_attrs(run.attrs)
    if "system" not in run.attrs or record.is_own or not record.stepped:
        return None
    rows = _spread(run.sizes["time"], ROWS)
    some = run.isel(time=rows, lane=lanes) if "lane" in run.dims else run.isel(time=rows)
    try:
        model = record.model.lanes(some["lane"].values) if "lane" in run.coords else record.model
        chosen = scheme(model, record.method, record.dt, record.order, ORIENTATION in run)
        states = {k: read_values(some[k]) for k, outcome in chosen.outcomes.items() if outcome.kind not in KINDS}
    except (InputError, KeyError):
        return None
    width = algebra.coordinate_count(chosen.kinds, model.n)
    plan = Plan(
        model=model,
        scheme=chosen,
        settings=Settings(dt=record.dt, steps=len(rows)),
        first=np.zeros((len(lanes), width)),
        batched="lane" in run.dims,
        start={},
    )
    with np.errstate(all="ignore"):
        scales = roundoff_scales(plan, states, np.asarray(some["time"].values, dtype=np.float64))[name]
    return np.array(scales[SCALES[0]]), np.array(scales[SCALES[1]])


MOST_SCALES = 4096  # values in an attribute
MANY_SAMPLES_N = 16  # beyond, there are fewer
MANY_LANES = 4096  # beyond, some lanes are measured: the largest over the lanes counts
SOME_LANES, LARGEST = 512, 64  # evenly spread, and those of the largest values
SAMPLES = 16  # perturbations of a state that measure the sensitivity of an integral
ON_ARRAYS = (1024, 8, 64)  # states by lanes, fewest and most of a lane, if integrals are not compiled: some need 0.1 ms
SMALL = 1e-4  # of the state: errors of the other components count next to rounding errors of a smaller component
NUDGE, HAIR = 1e-6, 1e-12  # relative: far above round-off, and small enough that only noise remains


def roundoff_scales(plan: Plan, first: Mapping[str, Array], time: Floats) -> dict[str, dict[str, list[float]]]:
    """Effect of rounding errors on each Casimir and integral, in units of eps_machine.

    roundoff_scale    in one step.  Every coordinate of a component is moved by the component's largest one, of a
                      component of the phase space that is 0 by the phase space's, since maps round both together, and
                      of a small one by the terms that a step adds to it, with random signs; the scale is the root mean
                      square of the change, over up to 32 states of a lane in the first block
    evaluation_scale  in one evaluation from a state: the size of the value, or its noise if that is larger

    Of more than 4096 lanes, 512 are measured and those of the largest states and integrals; of lanes that act on each
    other, and in the form of large n, all are, by fewer samples.
    """
    many = plan.lanes > MANY_LANES and plan.scheme.coupling is None and plan.large is None
    if many:
        values = [first[name] for name, outcome in plan.outcomes.items() if outcome.kind in KINDS]
        sizes = [abs(x).reshape(-1, plan.lanes, x[0, 0].size).max((0, 2)) for x in (plan.first[None], *values)]
        selected = [np.argpartition(size, -LARGEST)[-LARGEST:] for size in sizes]
        lanes = np.unique(np.concatenate([_spread(plan.lanes, SOME_LANES), *selected]))
        model, order = plan.model.lanes(lanes), plan.scheme.options.get("order")
        chosen = scheme(model, plan.scheme.name, plan.dt, order, ORIENTATION in plan.start)
        plan = replace(plan, model=model, scheme=chosen, first=plan.first[lanes])
        first = {name: value[:, lanes] for name, value in first.items()}
    z, n = _sampled_rows(plan, first, time), plan.model.n
    samples = SAMPLES if n <= MANY_SAMPLES_N else max(2, 16 * SAMPLES // n)  # every coordinate counts
    starts, component = _components(tuple(plan.kinds), n)
    samples = samples if many else max(1, min(samples, SAMPLES * MANY_LANES // plan.lanes))
    samples = samples if plan.compiled else min(samples, max(2, _states_on_arrays(plan) // len(z)))
    by = (_nudges if z.size <= MANY_LANES else _nudges.__wrapped__)(samples, z.shape)
    by_component = np.maximum.reduceat(abs(z), starts, -1)[..., component]
    in_space = component < len(plan.model.system.space.kinds)  # work, clock and attitude have other sizes
    size = abs(z[..., in_space]).max(-1, keepdims=True)
    if ((by_component < SMALL * size) & (by_component > 0) & in_space).any():
        by_component = np.maximum(by_component, np.minimum(size, _terms_of_step(plan, z, by[0] / NUDGE * by_component)))
    by = by * np.where((by_component == 0) & in_space, size, by_component)
    values, places = _integrals(plan, (z + by).reshape(-1, *z.shape[1:]))
    if not places:
        return {}
    values = values.reshape(*by.shape[:3], -1)
    up, down, a_bit_up, a_bit_down = values[:-1].reshape(4, samples, *values.shape[1:])
    value, shape = values[-1], (-1, *values.shape[2:])
    squares = np.square((up - down) / (2 * NUDGE)).reshape(shape)
    noise = (abs(a_bit_up + a_bit_down - 2 * value) / (2 * MACHINE_EPSILON)).reshape(shape)
    # `mean` and `max` of arrays are in Python, and need longer than these
    felt, noise = np.sqrt(np.add.reduce(squares, 0) / len(squares)), np.maximum.reduce(noise, 0)
    for place in places.values() if n > MANY_SAMPLES_N else ():
        if place.stop - place.start == n * (n - 1) // 2:  # entries of one matrix
            noise[:, place] = noise[:, place].max(-1, keepdims=True)
    measured, scales = (felt, np.maximum(noise, np.maximum.reduce(abs(value), 0))), dict[str, dict[str, list[float]]]()
    for name, place in places.items():
        result = [scale[:, place] for scale in measured]
        result = [scale.max(0) if plan.batched and (many or scale.size > MOST_SCALES) else scale for scale in result]
        scales[name] = {key: scale.ravel().tolist() for key, scale in zip(SCALES, result, strict=True)}
    return scales


def _terms_of_step(plan: Plan, z: Floats, by: Floats) -> Floats:
    """The size of the terms that a step adds to the component of each coordinate, also where they cancel at rest.

    It is measured at rows z moved `by` their sizes; 0 for methods with other variables, and under forces.
    """
    kinds, n = plan.model.system.space.kinds, plan.model.n
    out, count = np.zeros_like(z), algebra.coordinate_count(kinds, n)
    if tuple(plan.kinds[: len(kinds)]) == tuple(kinds) and plan.model.system.perturbation is None:
        with np.errstate(all="ignore"):
            rates = plan.model.flow(*algebra.restore((z + by)[..., :count], kinds, n))
        starts, component = _components(kinds, n)
        largest = np.maximum.reduceat(abs(algebra.flatten(rates, kinds)), starts, -1)[..., component]
        out[..., :count] = np.nan_to_num(plan.dt * largest)
    return out


def _integrals(plan: Plan, z: Floats) -> tuple[Array, dict[str, slice]]:
    """Casimirs and integrals at rows z as columns (rows, lanes, columns), and the columns of each."""
    names = [name for name, outcome in plan.outcomes.items() if outcome.kind in KINDS]
    if plan.compiled is not None and plan.scheme.coupling is None and names:
        result = {name: plan.compiled.places[name][0] for name in names}
        first, last = min(at.start for at in result.values()), max(at.stop for at in result.values())
        places = {name: slice(at.start - first, at.stop - first) for name, at in result.items()}
        return plan.compiled(plan.corrections[1](z))[..., first:last], places
    outputs = plan.observe(z)
    columns = [np.empty((*z.shape[:2], 0)), *(outputs[name].reshape(*z.shape[:2], -1) for name in names)]
    kinds = [f"R^{column.shape[-1]}" for column in columns[1:]]
    return np.concatenate(columns, -1), dict(zip(names, algebra.slices(kinds, plan.model.n), strict=True))


@lru_cache(4)
def _nudges(samples: int, shape: tuple[int, ...]) -> Floats:
    """Random signs, the same in every run, by which a state is moved up, down, both by a hair, and not."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (samples, *shape))
    return np.concatenate([factor * signs for factor in (NUDGE, -NUDGE, HAIR, -HAIR)] + [0 * signs[:1]])


@lru_cache(16)
def _components(kinds: tuple[str, ...], n: int) -> tuple[np.ndarray, np.ndarray]:
    """The first coordinate of each component, and the component of each coordinate."""
    places = algebra.slices(kinds, n)
    counts = [place.stop - place.start for place in places]
    return np.array([place.start for place in places]), np.repeat(np.arange(len(places)), counts)


@lru_cache(16)
def _spread(length: int, count: int) -> np.ndarray:
    return np.unique(np.linspace(0, length - 1, count).astype(int))


def _states_on_arrays(plan: Plan) -> int:
    """How many states of a lane are perturbed if integrals are not compiled."""
    total, fewest, most = ON_ARRAYS
    return max(fewest, min(most, total // plan.lanes))


def _sampled_rows(plan: Plan, first: Mapping[str, Array], time: Floats) -> Floats:
    """Up to 32 rows of the first block, evenly spread, in the method's variables (rows, lanes, d).

    For more than 64 lanes, and for n > 16, fewer rows, down to one: some thousand values are enough.
    """
    count = min(32, max(1, 2048 // plan.lanes), max(1, 512 // plan.model.n))
    count = count if plan.compiled else min(count, _states_on_arrays(plan) // 2)
    rows = _spread(len(next(iter(first.values()))), count)
    parts, as_observed = [], plan.scheme.reopen is tuple
    for letter, outcome in plan.outcomes.items():
        if outcome.kind not in ("state", "orientation"):
            continue
        value = np.asarray(first[letter], np.float64)
        value = value if len(rows) == len(value) else value[rows]
        value = value.reshape((len(rows), plan.lanes, *value.shape[1 + plan.batched :]))
        kind = algebra.KINDS[outcome.axes]
        parts.append(kind.packed(value, plan.model.n) if as_observed else kind.from_user(value, plan.model.n))
    if as_observed:
        return np.concatenate(parts, -1)
    z = np.array(algebra.flatten(plan.scheme.reopen(tuple(parts)), plan.kinds))
    plan.scheme.set_clock(z, time[rows, None], plan.dt)
    return z
