"""kr.analysis.events: crossings of a value by a quantity, to round-off; Poincare sections and their return maps.

Between rows the flow itself carries states a little further, many at once, each by a separate time in separate steps:
Gragg's extrapolation of the modified midpoint rule, of order 16 at most.  The even powers of the step in its error are
removed one after the other by Aitken and Neville's scheme.  [Hairer, Norsett, Wanner, Solving ODEs I, sections II.8,
II.9]
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.analysis.quantities import Quantity, label, of_state, series
from kreisel.errors import InputError, explained
from kreisel.forces.kicks import WHEELS
from kreisel.graph.recording import flat_constants
from kreisel.kernels.cpu import compiled_step
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import ORIENTATION, Scheme, Steps
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME
from kreisel.runs.geometry import components, model_for, orientation_of
from kreisel.runs.in_si import in_si, in_state_form, is_in_si, state_quantity
from kreisel.runs.settings import finite_number, flag, within

NODES = 12  # of the polynomial that finds a crossing
NEAR_SAMPLE = 1e-6  # of the time between two samples
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
    """Components, orientation matrices, and the time if a force depends on it, (time, lane, ...).

    Raises `InputError` for rows that are not in the order of time.
    """
    if (np.diff(run["time"].values) < 0).any():
        raise InputError("expected rows in the order of time, got others. Sort them: run.sortby('time').")
    parts = components(run, model)
    parts += () if g is None else (g,)
    parts = parts if "lane" in run.dims else tuple(v[:, None] for v in parts)
    if depends_on_time(model):
        parts += (np.broadcast_to(np.asarray(run["time"].values, dtype=np.float64)[:, None], parts[0].shape[:2]),)
    return parts


def after_samples(model: Model, start: tuple[Array, ...], following: tuple[Array, ...]) -> tuple[Array, ...]:
    """States of rows, with the commands and the memory of a controller that the next rows show: held until there.

    Raises `InputError` if there are samples between the rows, or impulses.
    """
    record = model.system.perturbation
    control = None if record is None else record.control
    if record is None or control is None or control.law is None:
        return start
    first, last = (times[-1] / control.every for times in (start, following))
    if "impulse" in control.commands or (np.floor(first + NEAR_SAMPLE) + 1 < last - NEAR_SAMPLE).any():
        raise InputError(
            f"{model.system.name}: expected a row at each sample, every {control.every * control.time:g} s, of a "
            "controller without impulses: the flow is known from one to the next only. Save more often (every), or "
            "find events in the run, kr.simulate(..., events=kr.Event(...))."
        )
    moving = {*record.base.space.letters, WHEELS}
    letters = model.system.space.letters
    held = [y if letter not in moving else x for letter, x, y in zip(letters, start, following, strict=False)]
    return (*held, *start[len(letters) :])


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
        start = after_samples(model, start, following)
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


# -- states carried by the flow --------------------------------------------------------------------------

COLUMNS = (2, 4, 6, 8, 10, 12, 14, 16)  # midpoint steps; order twice their number
ACCURATE = 1e-14  # relative to each state: difference of the last two entries of a row of the scheme
CONVERGED = 1e-15  # then no higher order is needed
EASY = 5  # columns; for a state that needs no more, the next step is twice as long
LEAST_SHARE = 2.0**-44  # of the time to go: a shorter step means that no step is short enough
MOST_ROUNDS = 1024
JITTER = 2.0**-50  # relative: the change of a state that shows the accuracy of its rate
MEETS = 0.1  # of a component: the coarsest maps in use are off by half of it from one row to the next
FASTER = 5  # dimensions up to which the steps are compiled
BETWEEN, STEP = "_before", "eps"


class Carrier:
    """The flow of a model on rows (k, ...) of lanes (k,): [x,] the components, [orientation matrix,] [time].

    The position x comes first if the body is `moving`, x' = g U; the time comes last if a force depends on it.  Steps
    are compiled if the rates can be recorded as straight-line code: a disc in water, 100 rows: 40 s on arrays, 0.05 s
    compiled.
    """

    def __init__(self, model: Model, lane: Array, *, oriented: bool, moving: bool = False):
        if model.system.perturbation is not None and model.system.perturbation.pair is not None:
            raise InputError(
                f"{model.system.name}: expected a single body, got bodies in pairs. "
                "kr.propagator(...).until finds events of such bodies as they are stepped."
            )
        self.model, self.moving, self.timed = model, moving, depends_on_time(model)
        ends = (*((ORIENTATION, "matrix"),) * oriented, *((TIME, "scalar"),) * self.timed)
        self.components = (*(("x", "vector"),) * moving, *model.system.space.components, *ends)
        self.kinds = [kind for _, kind in self.components]
        self.starts = [place.start for place in algebra.slices(self.kinds, model.n)]
        varied = {k for k, v in model.constants.items() if model.batch and v.ndim > model.axes[k]}
        self.constants = {k: v[lane] if k in varied else v for k, v in model.constants.items()}
        compiled = model.system.numbers != "jax" and model.n <= FASTER
        self.advance = self._by_kernel(len(lane)) if compiled else self._by_arrays

    def __call__(self, z: tuple[Array, ...], h: Array, following: tuple[Array, ...] | None = None) -> tuple[Array, ...]:
        """The states `h` (k,) later.  Raises `InputError` if no step is short enough: the rows are too far apart.

        `following`: the saved states there, without x.  Raises `InputError` if the flow leads elsewhere by more than
        any useful map does.
        """
        y, share, done = algebra.flatten(z, self.kinds), np.ones(len(h)), np.zeros(len(h))
        size, left = self.size(y), np.nonzero(h)[0]
        with np.errstate(all="ignore"):  # steps whose values overflow are too long
            for _ in range(MOST_ROUNDS):
                if not len(left) or share[left].min() < LEAST_SHARE:
                    break
                new, error, columns = self.step(y[left], share[left] * h[left], size[left], left)
                good = error <= ACCURATE
                passed = left[good]
                y[passed], done[passed] = new[good], done[passed] + share[passed]
                size[passed] = np.maximum(size[passed], self.size(new[good]))
                share[passed] *= np.where(columns[good] <= EASY, 2.0, 1.0)
                share[left[~good]] /= 4
                share[left] = np.minimum(share[left], 1 - done[left])
                left = left[done[left] < 1]
            if len(left):
                raise InputError(
                    "The saved states are too far apart to be joined by the flow: save more often (every)."
                )
            end = algebra.restore(y, self.kinds, self.model.n)
            if following is not None:
                saved = algebra.flatten((*end[: self.moving], *following), self.kinds)
                size = np.maximum(self.size(y), self.size(saved))
                off = (self.size(y - saved) / self._rate_and_scale(y, h, size, np.arange(len(y)))[1]).max(1)
                if not (off <= MEETS).all():
                    raise InputError(
                        "The flow expected to lead from each saved state to the next one, got one that is off by "
                        f"{100 * off[~(off <= MEETS)][0]:.0f} %. Usual cause: an impulse or an action between two "
                        "rows, a step far too long for the method, or chaos between rows that are far apart. Save more "
                        "often (every)."
                    )
        return end

    def rates(self, *z: Array, **constants: Array) -> tuple[Array, ...]:
        """The rates of all components, for any kind of number."""
        model, first, last = self.model, self.moving, self.moving + len(self.model.system.space.letters)
        state: tuple[Array, ...] = z[first:last]
        turn: Any = None
        constants |= dict(zip((name for name, _ in self.components[last:]), z[last:], strict=True))
        rate = [*model.call(model.system.flow, *state, **constants)]
        if len(z) - last > self.timed:
            turn, omega = z[last], model.call(model.system.velocity, *state, **constants)
            rate.append(omega @ turn if model.system.frame is Frame.REST else turn @ omega)
        if self.moving:
            rate.insert(0, algebra.act(turn, model.call(model.system.translation, *state, **constants) + 0 * z[0]))
        return (*rate, *(0 * t + 1 for t in z[len(z) - self.timed :]))

    def _by_kernel(self, lanes: int) -> Callable[..., Floats]:
        """before + eps z'(state) repeatedly, by a kernel."""
        count = len(self.components)

        def step(*z: Array, eps: Array, **constants: Array) -> tuple[Array, ...]:
            before, state = z[:count], z[count:]
            return (*state, *(b + eps * r for b, r in zip(before, self.rates(*state, **constants), strict=True)))

        def unchanged(z: Any) -> Any:
            return z

        scheme = Scheme(
            name=f"the flow of {self.model.system.name}",
            components=(*((letter + BETWEEN, kind) for letter, kind in self.components), *self.components),
            constants={**self.constants, STEP: np.asarray(0.5)},
            axes={**self.model.axes, STEP: 0},
            n=self.model.n,
            prepare=unchanged,
            motion=Steps(step),
            observe=unchanged,
            reopen=unchanged,
            outcomes={},
            kernel_key=None,
        )
        rows, columns = flat_constants(scheme, lanes)
        kernel = compiled_step(scheme, rows, columns)

        def advance(before: Floats, state: Floats, eps: Floats, steps: int, lanes: Array) -> Floats:
            z, c = np.concatenate([before, state], 1), rows[lanes]
            c[:, columns[STEP]] = eps[:, None]
            kernel(z, c, steps)
            return z[:, state.shape[1] :]

        return advance

    def _by_arrays(self, before: Floats, state: Floats, eps: Floats, steps: int, lanes: Array) -> Floats:
        """before + eps z'(state) repeatedly, on arrays."""
        kinds, n = self.kinds, self.model.n
        constants = {k: v[lanes] if v.ndim > self.model.axes[k] else v for k, v in self.constants.items()}
        for _ in range(steps):
            rate = algebra.flatten(self.rates(*algebra.restore(state, kinds, n), **constants), kinds)
            before, state = state, before + eps[:, None] * rate
        return state

    def size(self, y: Floats) -> Floats:
        """The largest entry of each component, (k, components)."""
        return np.maximum.reduceat(np.abs(y), self.starts, axis=1)

    def step(self, y: Floats, h: Floats, size: Floats, lanes: Array) -> tuple[Floats, Floats, Array]:
        """The states h later, their errors relative to each component of each state, and the columns used.

        If a component is 0 up to rounding, such as the momentum of a body that moves along its axis, its error is
        compared with the error of its rate from the rounding of the state.
        """
        rate, size = self._rate_and_scale(y, h, size, lanes)
        row: list[Floats] = []
        end, best, columns = y, np.full(len(h), np.inf), np.zeros(len(h), dtype=int)
        for j, steps in enumerate(COLUMNS):
            h_j = h / steps
            new = [self.advance(y, y + h_j[:, None] * rate, 2 * h_j, steps - 1, lanes)]
            for k in range(j):
                new.append(new[k] + (new[k] - row[k]) / ((steps / COLUMNS[j - k - 1]) ** 2 - 1))
            if j > 1:
                error = (self.size(new[-1] - new[-2]) / np.maximum(size, self.size(new[-1]))).max(1)
                better = error < best
                end = np.where(better[:, None], new[-1], end)
                best, columns = np.where(better, error, best), np.where(best > CONVERGED, j + 1, columns)
            row = new
            if (best <= CONVERGED).all():
                break
        return end, best, columns

    def _rate_and_scale(self, y: Floats, h: Floats, size: Floats, lanes: Array) -> tuple[Floats, Floats]:
        jitter = JITTER * np.where(np.arange(y.shape[1]) % 2, -1, 1)
        near = y + jitter * np.repeat(size, np.diff([*self.starts, y.shape[1]]), 1)
        rate, nearby = (self.advance(np.zeros_like(y), at, np.ones(len(y)), 1, lanes) for at in (y, near))
        unsure = self.size(h[:, None] * (nearby - rate)) / ACCURATE
        return rate, np.maximum(size, self.size(h[:, None] * rate)) + unsure + np.finfo(float).tiny


def depends_on_time(model: Model) -> bool:
    """Whether a force of a perturbed body depends on the time."""
    record = model.system.perturbation
    return record is not None and record.names(TIME)
