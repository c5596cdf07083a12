"""States that a page shows: saved rows, and between distant rows the motion computed again from them.

The motion between two rows is interpolated if the fastest body rotates by at most `DENSE` radians from one to the
other.  Elsewhere some rows are starts of a replay with the method of the run.  Of a satellite a page and a figure show
quantities of its motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies.orbit import MU_SUN
from kreisel.errors import InputError, RunError, brief, shown
from kreisel.forces.kicks import WHEELS
from kreisel.method.scheme import ORIENTATION
from kreisel.record.model import Model
from kreisel.record.perturbation import pairs_of
from kreisel.runs.geometry import (
    angles_of,
    components,
    of_satellite,
    pointing_error,
    satellite_model,
    surroundings,
    velocity_of,
)
from kreisel.runs.run_record import RunRecord, frame_of

MOST_FRAMES = 100_001  # values of a page: rows of one body with three coordinates
DENSE = 0.8  # radians: eight states per revolution
FINE = 0.35  # radians between computed states
MOST_WANTED = 1e15  # frames between two rows, beyond which the count is not an exact integer
COMPUTED = 8_000  # states of a replay, of all bodies
WINDOWS = 12  # stretches of a long run
ROUGH = 1e-3  # by which shorter steps may miss the next saved state, relative
APART = 2_000  # saved rows in addition to stretches
BLOCK = 1 << 18  # rows read at once
SAMPLED = 64  # rows at which the speed is measured


@dataclass(frozen=True)
class Frames:
    """States to show in order of time: a run with these rows, flags of joined rows, and a note on the selection.

    run      the state, and the orientation, at times (frame, ...)
    joined   whether the motion from a frame to the next may be interpolated
    rate     the largest angular velocity, radians in the unit of time; 0 without motion
    """

    run: xr.Dataset
    joined: Array
    rate: float
    note: str


def frames(run: xr.Dataset, record: RunRecord, model: Model | None, most: int = MOST_FRAMES) -> Frames:
    """The frames of a run with some of its lanes.  Raises `InputError` for states that are not finite."""
    bare = run[[*record.kinds, *([ORIENTATION] if ORIENTATION in run else [])]]
    count, lanes = run.sizes["time"], run.sizes.get("lane", 1)
    entries = sum(math.prod(bare[name].shape[1:]) for name in record.kinds) // lanes
    most = max(400, most // (lanes * max(1, entries // 6)))
    time = np.asarray(run["time"].values, dtype=np.float64)
    sample = bare.isel(time=evenly(count, SAMPLED))
    _finite(sample, record)
    stated = _rate(sample, record, model)
    rate = _measured_rate(bare.isel(time=slice(0, SAMPLED)), record) if stated is None else stated
    rate = max(rate, _orbital_rate(sample)) if of_satellite(run) else rate  # the page shows its place and directions
    dense = np.diff(time) * rate <= DENSE
    rows = _rows(bare[record.carried], dense, most)
    shown = bare.isel(time=rows)
    _finite(shown, record)
    note = "" if len(rows) == count else f"{len(rows):,} of {count:,} saved states are here"
    if count > 1 and dense.mean() < 0.5 and model is not None and record.stepped and not record.broken and rate > 0:
        shown, note = _replayed(shown, record, model, rate, note)
    joined = np.diff(shown["time"].values) * rate <= DENSE
    if joined.all():
        between = "between states that are shown, the motion is interpolated" if len(joined) else ""
    elif joined.any():
        between = "where states are close it is interpolated between them; elsewhere playing jumps to the next stretch"
    else:
        between = "the saved states are too far apart to know the motion between them: they are shown one by one"
    text = "; ".join(filter(None, (note, between)))
    return Frames(shown, joined, rate, text[:1].upper() + text[1:] + "." if text else "")


def _finite(run: xr.Dataset, record: RunRecord) -> None:
    for letter in record.kinds:
        if not np.isfinite(run[letter].values).all():
            raise InputError(f"expected a run whose state is finite, got one with NaN or infinity in {letter}.")


def _rows(variable: xr.DataArray, dense: Array, most: int) -> Array:
    """All rows; if too many, stretches of consecutive rows if these are dense, and single rows with the extremes."""
    count = variable.sizes["time"]
    if count <= most:
        return np.arange(count)
    if not dense.mean() > 0.5:
        return _apart(variable, most)
    length = (most - min(APART, most // 4)) // WINDOWS
    starts = np.linspace(0, count - length, WINDOWS).astype(int)
    stretches = [np.arange(start, start + length) for start in starts]
    return np.unique(np.concatenate([*stretches, _apart(variable, min(APART, most // 4))]))


def _apart(variable: xr.DataArray, most: int) -> Array:
    """Single rows, the extremes among them, read block by block."""
    count = variable.sizes["time"]
    share = max(8, most * BLOCK // count)
    rows = []
    for first in range(0, count, BLOCK):
        values = np.asarray(variable[first : first + BLOCK].values)
        rows.append(mixed(values.reshape(len(values), -1), share) + first)
    return np.unique(np.concatenate(rows))


def _rate(sample: xr.Dataset, record: RunRecord, model: Model | None) -> float | None:
    """The largest angular velocity at some rows, by the record; None if the record has none."""
    if model is None:
        return None
    try:
        parts = components(sample, model)
        if model.system.velocity is not None:
            Omega = np.asarray(model.call(model.system.velocity, *parts), dtype=np.float64)
            speed = np.linalg.norm(Omega, axis=(-2, -1)) / math.sqrt(2)
        else:
            place = list(record.kinds).index(record.carried)
            change = np.asarray(model.flow(*parts)[place], dtype=np.float64)
            inner = tuple(range(1 + ("lane" in sample.dims), change.ndim))
            size = np.linalg.norm(parts[place], axis=inner)
            speed = np.linalg.norm(change, axis=inner) / np.where(size > 0, size, 1.0)
    except InputError:
        return None
    largest = float(np.max(speed, initial=0.0))
    return largest if math.isfinite(largest) else None


def _orbital_rate(sample: xr.Dataset) -> float:
    """The largest rate of the direction to a satellite, |r x v|/r^2."""
    around = surroundings(sample)
    r = around["position"]
    return float((np.linalg.norm(np.cross(r, around["velocity"]), axis=-1) / (r**2).sum(-1)).max())


def _measured_rate(first: xr.Dataset, record: RunRecord) -> float:
    """Half the largest rotation from row to row over the time, from the rows themselves: for user-defined systems."""
    time = np.asarray(first["time"].values, dtype=np.float64)
    if len(time) < 2:
        return 0.0
    if ORIENTATION in first and first[ORIENTATION].shape[-1:] == (4,):
        q = np.asarray(first[ORIENTATION].values)
        turn = 2 * np.arccos(np.clip(abs((q[1:] * q[:-1]).sum(-1)), 0, 1))
    else:
        v = np.asarray(first[record.carried].values).reshape(len(time), first.sizes.get("lane", 1), -1)
        size = np.linalg.norm(v, axis=-1)[1:]
        turn = np.linalg.norm(np.diff(v, axis=0), axis=-1) / np.where(size > 0, size, 1.0)
    speed = turn.reshape(len(time) - 1, -1).max(-1) / np.diff(time)
    return float(np.max(speed[np.isfinite(speed)], initial=0.0))


# -- computed again ----------------------------------------------------------------------------------------------------


def _replayed(shown: xr.Dataset, record: RunRecord, model: Model, rate: float, note: str) -> tuple[xr.Dataset, str]:
    """Rows, with the motion after some of them by the method of the run."""
    lanes = shown.sizes.get("lane", 1)
    time, rows = np.asarray(shown["time"].values, dtype=np.float64), {k: shown[k].values for k in record.kinds}
    split = max(1, math.ceil(record.dt * rate / DENSE))
    step = record.dt / split
    every, most = 1, max(1, int(FINE / (rate * step)))
    if split == 1:  # the largest divisor up to `most`, unless it is much smaller
        divisor = next(d for d in range(min(most, record.every), 0, -1) if record.every % d == 0)
        every = divisor if 3 * divisor >= most else most
    spacing = every * step
    gaps = np.diff(time)
    wanted = np.ceil(np.minimum(gaps / spacing, MOST_WANTED) - 1e-6).astype(int)
    budget = COMPUTED // lanes
    starts = np.arange(len(gaps)) if wanted.sum() <= budget else evenly(len(gaps), WINDOWS)
    length = int(min(wanted[starts].max(), max(2, budget // len(starts))))
    try:
        states = _carried_on(shown.isel(time=starts), record, model, step, every, length)
    except (InputError, RunError):
        return shown, note
    pieces, worst = [], 0.0
    for number, row in enumerate(starts.tolist()):
        inside = min(length, int(wanted[row]) - 1)
        if length >= wanted[row] and abs(gaps[row] / spacing - wanted[row]) < 1e-6:
            for letter in record.kinds:  # relative to the size of the state
                saved = rows[letter][row + 1]
                replayed = states[letter][int(wanted[row]), number].reshape(saved.shape)
                worst = max(worst, float(abs(replayed - saved).max()) / (float(abs(saved).max()) or 1.0))
        if inside > 0:
            piece = {k: v[1 : inside + 1, number] for k, v in states.items()}
            data = {k: (shown[k].dims, v.reshape(-1, *shown[k].shape[1:])) for k, v in piece.items()}
            pieces.append(xr.Dataset(data, {"time": time[row] + spacing * np.arange(1, inside + 1)}))
    if split > 1 and worst > ROUGH:
        reason = f"the body rotates by up to {record.dt * rate:.2g} rad in a step, and shorter steps lead elsewhere"
        return shown, "; ".join(filter(None, (note, reason)))
    if not pieces:
        return shown, note
    kept = shown.drop_vars([c for c in shown.coords if c not in ("time", "lane")])
    merged = xr.concat([kept, *pieces], "time", coords="minimal", compat="override", join="override").sortby("time")
    every_gap = len(starts) == len(gaps) and length >= wanted.max()
    text = "the motion" if every_gap else f"{len(starts)} stretches of the motion"
    text += " between saved states computed again from them by the method of the run"
    text += f", with steps of {step:.3g}" if split > 1 else ""
    text += f", which gives the next saved state to {worst:.0e}" if worst else ""
    return merged.assign_attrs(shown.attrs), "; ".join(filter(None, (note, text)))


def _carried_on(starts: Any, record: RunRecord, model: Model, step: float, every: int, length: int) -> dict[str, Array]:
    """The states (length + 1, starts, lane, ...) from each of the starts."""
    from kreisel.runs.propagation.propagator import propagator

    names, forced = [*record.kinds, *([ORIENTATION] if ORIENTATION in starts else [])], model.system.perturbation
    moving = propagator(model, method=record.method, order=record.order, dt=step, orientation=ORIENTATION in starts)
    if "lane" not in starts.dims and not model.batch and forced is None and pairs_of(model) is None:  # all at once
        states = moving.steps({k: starts[k].values for k in names}, length * every, every)
        return {k: np.asarray(states[k]) for k in names}
    runs, values = [], {k: starts[k].values for k in names}  # of an archive, each access reads the file
    for row, begun in enumerate(np.asarray(starts["time"].values, dtype=np.float64).tolist()):
        clock = {} if forced is None else {"time": begun}
        runs.append(moving.steps({k: values[k][row] for k in names}, length * every, every, **clock))
    return {k: np.stack([np.asarray(states[k]) for states in runs], 1) for k in names}


def between(values: Array, place: Array, joined: Array) -> Array:
    """Values at integer and fractional places by a cubic through four rows, of which only joined ones count.

    The page does the same (`sample` in drawing.js).
    """
    last = len(values) - 1
    i = np.clip(place.astype(int), 0, max(0, last - 1))
    u = (place - i).reshape(-1, *(1,) * (values.ndim - 1))
    b, c = values[i], values[np.minimum(i + 1, last)]
    open_ = np.append(joined, False)
    before = ((i > 0) & open_[np.maximum(i - 1, 0)]).reshape(u.shape)
    after = ((i + 2 <= last) & open_[np.minimum(i + 1, last)]).reshape(u.shape)
    a = np.where(before, values[np.maximum(i - 1, 0)], 2 * b - c)
    d = np.where(after, values[np.minimum(i + 2, last)], 2 * c - b)
    cubic = b + u / 2 * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))
    apart = ~open_[i].reshape(u.shape)
    return np.where(apart, np.where(u >= 1, c, b), cubic)


def coordinates_of(values: Array) -> tuple[Array, list[str]]:
    """Rows of a vector, or of a skew or symmetric matrix, as coordinates (rows, k), and the indices of each, from 1."""
    if values.ndim != 3:
        values = values.reshape(len(values), -1)
        return values, [str(i + 1) for i in range(values.shape[1])]
    j, k = np.triu_indices(values.shape[1], k=int(not values[:, 0, 0].any()))
    comma = "," if values.shape[1] > 9 else ""
    return values[:, j, k], [f"{a + 1}{comma}{b + 1}" for a, b in zip(j, k, strict=True)]


def as_matrices(q: Array) -> Array:
    """Rotations (..., 3, 3) of quaternions that need not have the length 1."""
    return algebra.rotation_matrix(q / np.linalg.norm(q, axis=-1, keepdims=True))


def windows(flags: Array) -> list[tuple[int, int]]:
    """First place and end of each stretch of flags: first and last frame of joined frames."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


# -- fewer rows for the eye, without losing an extreme ---------------------------------------------


def evenly(count: int, most: int) -> Array:
    """At most `most` rows of `count`, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def stretches(count: int, most: int) -> Array:
    """The starts of at most `most` equal stretches of `count` rows."""
    return np.unique(np.linspace(0, count, min(count, most) + 1).astype(int)[:-1])


def extremes(values: Array, most: int) -> Array:
    """At most about `most` rows of `values` (rows, k), sorted, with the extremes of every column.

    The first row, the last row, and from each of many equal stretches the rows with the least and the greatest value of
    every column.  NaN is not an extreme.
    """
    values = np.asarray(values).reshape(len(values), -1)
    rows, columns = values.shape
    if rows <= max(most, 2):
        return np.arange(rows)
    stretch = -(-rows // max(1, (most - 2) // (2 * max(columns, 1))))
    kept = {0, rows - 1}
    for start in range(0, rows, stretch * 256):  # many stretches at once with constant memory
        block = values[start : start + stretch * 256]
        count = len(block) // stretch * stretch
        for piece, offset in (
            (block[:count].reshape(-1, stretch, columns), start),
            (block[None, count:], start + count),
        ):
            if piece.size:
                base = offset + stretch * np.arange(len(piece))[:, None]
                low = np.where(np.isnan(piece), np.inf, piece).argmin(1)
                high = np.where(np.isnan(piece), -np.inf, piece).argmax(1)
                kept.update((base + low).ravel().tolist(), (base + high).ravel().tolist())
    return np.array(sorted(kept))


def mixed(values: Array, most: int) -> Array:
    """At most about `most` rows, sorted: half of them the extremes, half one row of each equal stretch, at random.

    The extremes only would show the ends of a path too often, and even steps could be in phase with it.  The choice is
    reproducible.
    """
    rows = len(values)
    if rows <= most:
        return np.arange(rows)
    edges = np.linspace(0, rows, most // 2 + 1)
    draws = np.random.default_rng(0).random(most // 2)
    drawn = (edges[:-1] + draws * np.diff(edges)).astype(int)
    return np.union1d(extremes(values, most // 2), drawn)


# -- quantities of the motion of a satellite, and the unit of the axis of time --------------------------


CLOCKS = (("s", 1.0, 600.0), ("min", 60.0, 3 * 3600.0), ("h", 3600.0, 3 * 86400.0), ("d", 86400.0, np.inf))
LONGEST = 60  # letters of a target


class Clock(NamedTuple):
    """The unit in which a figure has the time: "s", "min", "h", "d", or "" for a system without units."""

    unit: str
    size: float  # in units of the run
    second: float = 1.0  # in units of the run

    @property
    def label(self) -> str:
        """The label of the axis."""
        return f"time ({self.unit})" if self.unit else "time"

    def text(self, time: float) -> str:
        """A time in words."""
        return f"{time / self.size:.4g} {self.unit}" if self.unit else f"time {time:.4g}"


def clock_of(run: xr.Dataset) -> Clock:
    """The unit that suits the length of a run of a body: at most 600 s, 180 min, 72 h."""
    frame, in_si = frame_of(run), run["time"].attrs.get("units") == "s"
    if not frame and not in_si:
        return Clock("", 1.0)
    second = 1.0 if in_si else 1 / frame.time_unit
    ends = np.asarray(run["time"][[0, -1]].values, dtype=np.float64)
    span = float(abs(ends[1] - ends[0])) / second
    name, size, _ = next(row for row in CLOCKS if span <= row[2])
    return Clock(name, size * second, second)


class Panel(NamedTuple):
    """Quantities along a run with one axis: values (time, [lane,] k), a name for each of the k."""

    title: str
    unit: str
    names: tuple[str, ...]
    values: Array


def is_pointed(run: xr.Dataset, axis: Any = None, target: Any = "nadir") -> bool:
    """Whether a run has a pointing error.  Raises `InputError` for an axis or a target of a run without it."""
    pointed = of_satellite(run) and ORIENTATION in run
    if not pointed and (axis is not None or not isinstance(target, str) or target != "nadir"):
        got = shown(RunRecord.of(run, "system").system)
        raise InputError(f"axis, target: expected a run of a satellite, got one of {got}. Leave them out.")
    return pointed


def panels_of(run: xr.Dataset, axis: Any = None, target: Any = "nadir") -> list[Panel]:
    """Pointing error, angles against the orbit, rates, and the momenta of wheels."""
    model, around = satellite_model(run), surroundings(run)
    angles = angles_of(run, around=around)
    aim = name_of_target(model, target) if isinstance(target, str) else brief(shown(target), LONGEST)
    subject = "axis" if axis is None else f"axis {brief(shown(axis), LONGEST)}"
    error = np.rad2deg(pointing_error(run, axis, target, around))[..., None]
    omega = frame_of(run).vectors(algebra.axial(velocity_of(run, model)))
    degrees = np.rad2deg(np.stack(angles, -1))
    jumps = np.concatenate([np.zeros_like(degrees[:1]), abs(np.diff(degrees, axis=0))]) > 180
    out = [
        Panel(f"angle of the {subject} to {aim}", "deg", ("",), error),
        # no line is drawn where an angle jumps from 180 to -180
        Panel("angles to the orbit", "deg", angles._fields, np.where(jumps, np.nan, degrees)),
        Panel("angular velocity in the body", "deg/s", ("x", "y", "z"), np.rad2deg(omega)),
    ]
    if WHEELS in run:  # about their axes
        momenta = np.asarray(run[WHEELS].values)
        names = tuple(str(k + 1) for k in range(momenta.shape[-1]))
        out.append(Panel("momenta of the wheels", "N m s", names, momenta))
    return out


def name_of_target(model: Model, target: str) -> str:
    """A target of a satellite in words: the Sun for "sun", and for the nadir of an orbit about the Sun."""
    about_sun = np.all(abs(model.params["mu"] / MU_SUN - 1) < 1e-2)
    return "Sun" if target == "sun" or (target == "nadir" and about_sun) else target


def shadows_of(run: xr.Dataset) -> list[tuple[float, float]]:
    """First and last times of the rows in each shadow, for a single satellite whose Sun is known."""
    light, time = surroundings(run).get("light"), np.asarray(run["time"].values, dtype=np.float64)
    if light is None or light.ndim > 1:
        return []
    return [(float(time[first]), float(time[end - 1])) for first, end in windows(light < 0.5)]
