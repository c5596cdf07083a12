"""kr.analysis.events: crossings of a value by a quantity, to round-off; Poincare sections and their return maps."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.analysis.carrying import Carrier, depends_on_time
from kreisel.analysis.quantities import Quantity, label, of_state, series
from kreisel.errors import InputError, explained
from kreisel.method.observing import ORIENTATION
from kreisel.record.model import Model
from kreisel.runs.geometry import components, model_for, orientation_of
from kreisel.runs.in_si import in_si, in_state_form, is_in_si, state_quantity
from kreisel.runs.settings import finite_number, flag, within

NODES = 12  # of the polynomial that finds a crossing
NUDGE = 1e-5  # of an interval, for its slope
NEAR = 1e-11  # after the first correction, to the size of the values: the second then reaches round-off


@explained
def events(
    run: xr.Dataset, quantity: Quantity, value: float = 0.0, *, rising: bool | None = None, system: Model | None = None
) -> xr.Dataset:
    """The times and states at which a quantity f(state) crosses a value, f = value, located to round-off.

    quantity   a component of the state such as "a[2]", counted from 0, or a function of the components as the run
               stores them (n = 3: axial vectors), batch in front: `lambda m, a: (m * a).sum(-1)`
    rising     True, False: only crossings upward, downward; None: both
    system     the model, for a user-defined system

    A crossing lies between two saved rows with f on different sides.  Two crossings between the same rows are missed,
    so save often enough.  The flow itself carries the state there from the row before, by extrapolation of order 16, to
    round-off: for method="exact" as exactly as the rows.  The time is found by Chandrupatla's method
    (`scipy.optimize.elementwise.find_root`) on a polynomial, and corrected with the flow.  A row exactly at the value
    counts if f continues to the other side.

    Returns a Dataset along `event`, in the order of time: time, rising, lane (for an ensemble), the components of the
    state, and the orientation if the run has one.  Raises `InputError` for unknown quantities, and if the flow does not
    lead from a row to the next.  [T. R. Chandrupatla, Adv. Eng. Softw. 28 (1997) 145]
    """
    run_of_user, quantity, run = run, state_quantity(run, quantity), in_state_form(run)
    model, value = model_for(run, system), finite_number(value, "value")
    if rising is not None:
        flag(rising, "rising")
    of_components, letters = of_state(quantity, model), model.system.space.letters

    def measure(parts: tuple[Array, ...]) -> Array:
        return np.asarray(of_components(parts[: len(letters)]) - value)

    oriented = ORIENTATION in run and model.n == 3
    rows = parts_of(run, model, algebra.rotation_matrix(orientation_of(run)) if oriented else None)
    time = np.asarray(run["time"].values)
    f = measure(tuple(v.reshape(-1, *v.shape[2:]) for v in rows)).reshape(rows[0].shape[:2])
    if f.dtype.kind == "c" or not np.isfinite(f).all():
        raise InputError("expected a quantity that is a finite real number at every row, got others.")
    side = np.sign(f)
    for row in range(1, len(side)):  # a row at the value belongs to the side of the row before
        np.copyto(side[row], side[row - 1], where=side[row] == 0)
    way = {None: (-1, 1), True: (1,), False: (-1,)}[rising]
    place, lane = np.nonzero((side[1:] * side[:-1] < 0) & np.isin(side[1:], way))
    upward = f[place + 1, lane] > f[place, lane]
    h, state = np.zeros(len(place)), tuple(v[place, lane] for v in rows)
    if len(place):
        h, state = _located(model, rows, oriented, measure, time, f, place, lane)
    order = np.argsort(time[place] + h, kind="stable")
    data: dict[str, Any] = {"rising": ("event", upward[order])}
    for (letter, kind), v in zip(model.system.space.components, state, strict=False):
        values = algebra.KINDS[kind].for_user(v)
        data[letter] = (("event", *run[letter].dims[run[letter].ndim - values.ndim + 1 :]), values[order])
    if oriented:
        q = algebra.unit_quaternion(state[len(letters)])
        for of_lane in (lane == k for k in np.unique(lane)):
            q[of_lane] = algebra.continued(q[of_lane], (time[place] + h)[of_lane])
        data[ORIENTATION] = (("event", "quaternion"), q[order])
    coords = {"time": ("event", (time[place] + h)[order])}
    if "lane" in run.dims:
        coords["lane"] = ("event", run["lane"].values[lane][order])
    attrs = {k: run.attrs[k] for k in ("title", "system", "n", "components", "frame", "body") if k in run.attrs}
    cut = xr.Dataset(data, coords, {**attrs, "quantity": label(quantity), "value": float(value)})
    return in_si(cut, model) if is_in_si(run_of_user) else cut


def parts_of(run: xr.Dataset, model: Model, g: Array | None) -> tuple[Array, ...]:
    """Components, orientation matrices, and the time if a force depends on it, (time, lane, ...)."""
    parts = components(run, model)
    parts += () if g is None else (g,)
    parts = parts if "lane" in run.dims else tuple(v[:, None] for v in parts)
    if depends_on_time(model):
        parts += (np.broadcast_to(np.asarray(run["time"].values, dtype=np.float64)[:, None], parts[0].shape[:2]),)
    return parts


def _located(
    model: Model,
    rows: tuple[Array, ...],
    oriented: bool,
    measure: Any,
    time: Array,
    f: Array,
    place: Array,
    lane: Array,
) -> tuple[Array, tuple[Array, ...]]:
    """Times after the rows `place` at which `measure` is 0, 0 at a row where it is, and the states there."""

    def carry(h: Array, at: Any, to_next: bool = False) -> tuple[Array, ...]:
        start, following = (tuple(v[row[at], lane[at]] for v in rows) for row in (place, place + 1))
        return Carrier(model, lane[at], oriented=oriented)(start, np.asarray(h), following if to_next else None)

    def off(h: Array, at: Any) -> Array:
        return np.asarray(measure(carry(h, at)))

    number, before, after = np.arange(len(place)), f[place, lane], f[place + 1, lane]
    # by a method that is not exact, the flow from one row need not end exactly at the next: search slightly beyond it
    right = time[place + 1] - time[place]
    ends = measure(carry(right, number, to_next=True))
    for _ in range(4):
        outside = np.sign(ends) == np.sign(np.where(before == 0, -after, before))
        if not outside.any():
            break
        right = np.where(outside, 1.25 * right, right)
        ends = off(right, number)
    roots = _roots_within(off, right, number)
    if not (np.isfinite(roots) | (before == 0)).all():
        raise InputError("A crossing between two rows could not be found again by the flow: save more often (every).")
    h = np.where(before == 0, 0.0, roots)
    return h, carry(h, slice(None))


def _roots_within(off: Any, right: Array, number: Array) -> Array:
    """The roots in [0, right] of off(h, number), NaN if there is none.

    On the polynomial through NODES points, then by Newton's method with its slope; if that is not enough, on `off`.
    """
    from scipy.optimize import elementwise

    share = (1 - np.cos(np.pi * np.arange(NODES) / (NODES - 1))) / 2
    values = off((share[:, None] * right).ravel(), np.tile(number, NODES)).reshape(NODES, -1)
    weight = (-1.0) ** np.arange(NODES)[:, None]
    weight[[0, -1]] /= 2

    def polynomial(s: Array, at: Array) -> Array:
        gap = s - share[:, None]
        hit = gap == 0
        ratio = weight / np.where(hit, 1.0, gap)
        ratio = np.where(hit.any(0), hit, ratio)
        return (ratio * values[:, at]).sum(0) / ratio.sum(0)

    guess = elementwise.find_root(polynomial, (0.0 * right, 0.0 * right + 1), args=(number,))
    s = np.where(guess.success, guess.x, np.nan)
    slope = (polynomial(s + NUDGE, number) - polynomial(s - NUDGE, number)) / (2 * NUDGE)
    guessed = np.nonzero(np.isfinite(s) & (slope != 0))[0]
    left = np.full(len(s), np.inf)
    for _ in range(2):
        residuals = off(s[guessed] * right[guessed], guessed)
        left[guessed] = np.abs(residuals)
        s[guessed] = np.clip(s[guessed] - residuals / slope[guessed], 0, 1)
    poor = np.nonzero(~(left <= NEAR * np.abs(values).max(0)))[0]
    if len(poor):
        again = elementwise.find_root(off, (0.0 * right[poor], right[poor]), args=(poor,))
        s[poor] = np.where(again.success, again.x / right[poor], np.nan)
    return s * right


# -- sections --------------------------------------------------------------------------------------


@explained
def section(
    run: xr.Dataset, quantity: Quantity, value: float = 0.0, *, rising: bool | None = True, system: Model | None = None
) -> xr.Dataset:
    """Poincare's section: the states at which f = value is crossed in one direction, located to round-off (`events`).

    For an ensemble, the points of all lanes, with the coordinate lane.  Returns and raises as `events`.
    """
    return events(run, quantity, value, rising=rising, system=system)


@explained
def return_map(
    run: xr.Dataset,
    quantity: Quantity,
    seen: Quantity,
    value: float = 0.0,
    *,
    rising: bool | None = True,
    returns: int = 1,
    system: Model | None = None,
) -> xr.Dataset:
    """The return map on the section f = value: `seen` at a crossing, and at the `returns`-th crossing after it.

    `seen` is a component such as "a[0]" or a function of the components of the state, like f.  Crossings of different
    lanes are not mixed.  Returns a Dataset along `event` with here, after, the time of return elapsed, and the
    coordinate lane of an ensemble.  Raises `InputError` as `events` does, and for returns < 1.
    """
    returns = within(returns, "returns")
    cut = section(run, quantity, value, rising=rising, system=system)
    lanes = cut["lane"].values if "lane" in cut.coords else np.zeros(cut.sizes["event"], dtype=int)
    # `event` replaces the axis time of a run
    values = np.asarray(series(cut.reset_coords("lane", drop=True) if "lane" in cut.coords else cut, seen))
    places = [np.nonzero(lanes == lane)[0] for lane in np.unique(lanes)]
    i, j = (
        np.concatenate([np.zeros(0, dtype=int), *(of_lane[rows] for of_lane in places)])
        for rows in (slice(-returns), slice(returns, None))
    )
    coords = {"time": ("event", cut["time"].values[i])}
    if "lane" in cut.coords:
        coords["lane"] = ("event", lanes[i])
    elapsed = cut["time"].values[j] - cut["time"].values[i]
    data = {"here": ("event", values[i]), "after": ("event", values[j]), "elapsed": ("event", elapsed)}
    return xr.Dataset(data, coords, {**cut.attrs, "seen": label(seen), "returns": returns})
