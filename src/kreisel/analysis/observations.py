"""Input of kr.fit: unknowns by name, and observations with their times, errors and gaps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.analysis.quantities import parse_quantity
from kreisel.errors import InputError, hint, shown
from kreisel.method.scheme import ORIENTATION, as_matrix, functions, with_orientation
from kreisel.record.calling import call, keywords
from kreisel.record.contract import Frame
from kreisel.record.model import Model, State
from kreisel.record.perturbation import TIME
from kreisel.record.units import AXES, BODY, OF_SYSTEM, STATE, si, stated_unit

SIGMA = "sigma_"
VELOCITY = "Omega"
ATTITUDE = "orientation"
ON_STEP = 1e-9  # of a step: a time this close to a step counts as the step
NORMALIZED = 0.1  # of the residuals: deviations of lengths from 1 that are rounding
ROTATION = 1e-6  # deviations of g g^T from 1 that are rounding, without errors
MOST_NUMBERS = 10**8  # of rows and their derivatives
Show = Callable[[Any, Mapping[str, Any], Any, Mapping[str, Any], Mapping[str, Any]], Any]


# -- unknowns --------------------------------------------------------------------------------------


class Unknown(NamedTuple):
    """One entry: its place in the array of its letter (1, or -1 opposite in a skew matrix), and its bounds."""

    name: str
    letter: str
    place: Array
    start: float
    low: float
    high: float


def unknowns(
    model: Model,
    state: State,
    attitude: Array | None,
    free: Any,
    bounds: Any,
    observables: Mapping[str, Any],
    in_si: Mapping[str, Array],
) -> tuple[list[Unknown], dict[str, Array]]:
    """The unknowns, entry by entry, and arrays of parameters, components, the attitude and the instrument.

    in_si: parameters of a body that its model does not have, in SI.  Raises `InputError`.
    """
    names: Any = free if isinstance(free, Mapping | Sequence) and not isinstance(free, str) else [None]
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"free: expected a list of names such as ['p', 'm[2]'], or a dict, got {shown(free)}.")
    asked: dict[str, Any] = dict(free) if isinstance(free, Mapping) else dict.fromkeys(names)
    parameters = {p.letter: p.kind for p in model.system.parameters if p.kind not in ("dimension", "table")}
    kinds = {**dict.fromkeys(in_si, "array"), **parameters, **dict(model.system.space.components)}
    starts: dict[str, Array] = {**in_si, **model.params, **state.axial}
    if attitude is not None:
        kinds[ATTITUDE] = "array"
        starts |= {ATTITUDE: np.zeros(model.n * (model.n - 1) // 2), ORIENTATION: attitude}
    elif ATTITUDE in asked:
        raise InputError("free: expected orientation=..., where the search for the orientation begins, got none.")
    for name in dict.fromkeys(n for f in observables.values() if callable(f) for n in sorted(keywords(f))):
        if name in (*in_si, *model.params, ORIENTATION, TIME):
            continue  # the others are parameters of the instrument
        if asked.get(name) is None:
            raise InputError(f"free: expected a start of {name}, which observables accept, such as {{{name!r}: 0.0}}.")
        kinds[name], starts[name] = "array", _array(asked[name], name)
    out: dict[str, Unknown] = {}
    for name, start in asked.items():
        letter, index = parse_quantity(name)
        if letter not in kinds:
            words = {k: f"{k} ({word})" for k, word in model.body_frame.names.items()}  # of a body
            raise InputError(
                f"free: expected parameters or components of {model.system.name}, "
                f"{', '.join(words.get(k, k) for k in kinds)}, got {shown(name)}.{hint(letter, kinds)}"
            )
        if letter in model.system.space.letters and model.system.space.constraints:
            raise InputError(
                f"free: {letter} lies on {model.system.space.name}, where its coordinates cannot change separately. "
                "Fit parameters, from a state that is known."
            )
        array = np.asarray(starts[letter], dtype=np.float64)
        entries = _entries(kinds[letter], array, index)
        if not entries:
            numbers = ", ".join(_named(letter, i) for i, _ in _entries(kinds[letter], array, None))
            raise InputError(f"free: {letter} has the entries {numbers}, got {shown(name)}.")
        begin = _spread(start, array.shape, name) if start is not None else array
        for place, pattern in entries:
            entry = _named(letter, place)
            if entry in out:
                raise InputError(f"free: expected each number once, got {entry} twice.")
            at = float(begin if np.ndim(begin) == 0 else begin[place])
            out[entry] = Unknown(entry, letter, pattern, at, -np.inf, np.inf)
    if not out:
        raise InputError("free: expected names of unknown quantities, such as ['p', 'm[2]'], got none.")
    return [_bounded(u, bounds, out) for u in out.values()], starts


def _entries(kind: str, array: Array, index: Any) -> list[tuple[tuple[int, ...], Array]]:
    """Indices of the independent entries, and the array that is 1 there (and at the dependent entries).

    All, or the diagonal of a diagonal matrix; or the entry of that index, if an index is given.
    """
    square = array.ndim == 2 and array.shape[0] == array.shape[1]
    odd = square and kind == "skew"
    even = square and (kind == "symmetric" or (kind == "array" and (array == array.T).all()))
    diagonal = even and not index and not (array - np.diag(np.diag(array))).any()
    out = []
    for place in np.ndindex(array.shape):
        if index and place != index:
            continue
        pattern = np.zeros(array.shape)
        if even or odd:
            i, j = place
            if i > j or (odd and i == j) or (diagonal and i != j):
                continue
            pattern[j, i] = -1 if odd else 1
        pattern[place] = 1
        out.append((place, pattern))
    return out


def turn_coordinates(model: Model, x: Any) -> Any:
    """The entries i < j of a skew matrix, for n = 3 from its axial vector."""
    return algebra.coordinates(algebra.hat(x)) if model.n == 3 else x


def _named(letter: str, index: tuple[int, ...]) -> str:
    return f"{letter}[{', '.join(map(str, index))}]" if index else letter


def _array(value: Any, name: str) -> Array:
    array = algebra.floats(value)
    if not np.isfinite(array).all():
        raise InputError(f"free: expected finite values to begin {name} with, got {shown(value)}.")
    return array


def _spread(value: Any, shape: tuple[int, ...], name: str) -> Array:
    array = _array(value, name)
    if len(shape) == 2 and array.shape == shape[:1] and shape[0] == shape[1]:
        array = np.diag(array)
    if array.shape not in ((), shape):
        raise InputError(f"free: expected values of shape {shape} to begin {name} with, got {shown(value)}.")
    return array


def _bounded(u: Unknown, bounds: Any, free: Mapping[str, Any]) -> Unknown:
    letters = {v.letter for v in free.values()}
    unmatched = [name for name in bounds if name not in free and name not in letters]
    if unmatched:
        raise InputError(f"bounds: expected names of free values, {', '.join(free)}, got {shown(unmatched[0])}.")
    limits = bounds.get(u.name, bounds.get(u.letter))
    if limits is None:
        return u
    try:
        low, high = (float(v) for v in limits)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low < high or not low <= u.start <= high:
        raise InputError(f"bounds: expected (low, high) around the start {u.start:g} of {u.name}, got {shown(limits)}.")
    return u._replace(low=low, high=high)


# -- observations ----------------------------------------------------------------------------------


class Variable(NamedTuple):
    """A variable (time, ...), its errors, the mask of observed entries, and a function of a state that predicts it."""

    name: str
    value: Array
    sigma: Array
    mask: Array
    show: Show
    dims: tuple[str, ...]

    def difference(self, prediction: Array) -> Array:
        """Observed - predicted; for a quaternion with q or -q, the nearer."""
        value = self.value
        if self.name == ORIENTATION and value.ndim == 2:
            value = np.where((np.nan_to_num(value) * prediction).sum(-1, keepdims=True) < 0, -value, value)
        return value - prediction

    def count(self, prediction: Array) -> int:
        """The count of independent values: a direction or a quaternion of length 1 has one less than its entries."""
        complete = self.mask.reshape(len(self.mask), -1).all(-1)
        total, X = int(self.mask.sum()), self.value[complete]
        if not len(X) or X.ndim not in (2, 3):
            return total
        noise = np.sqrt((self.difference(prediction)[complete] ** 2).mean())
        X = X.reshape(len(X), -1, X.shape[-1])
        off = np.sqrt(((X @ X.mT - np.eye(X.shape[1])) ** 2).mean(0))  # 2 noise for values that are not normalized
        return total - len(X) * int(np.triu(off < NORMALIZED * noise).sum())


class Observations(NamedTuple):
    """Variables at times.

    Rows at every `every`-th of `steps` steps of dt; observation i is row rows[i], and for i in `between` a shorter
    step remainder[i] after it.
    """

    variables: list[Variable]
    weighted: bool
    time: Array
    dt: float
    steps: int
    every: int
    rows: Array
    remainder: Array
    between: Array

    @property
    def size(self) -> int:
        """The count of observed entries."""
        return int(sum(variable.mask.sum() for variable in self.variables))

    def count(self, predicted: list[Array]) -> int:
        """The count of independent observed values."""
        return sum(variable.count(values) for variable, values in zip(self.variables, predicted, strict=True))

    def flat(self, arrays: list[Array]) -> Array:
        """The observed values of arrays like the variables, over sigma, (size, ...)."""
        pieces = ((a, v.sigma, v.mask) for a, v in zip(arrays, self.variables, strict=True))
        return np.concatenate([a[m] / s[m].reshape(-1, *(1,) * (a.ndim - m.ndim)) for a, s, m in pieces])

    def differences(self, predicted: list[Array]) -> list[Array]:
        """Observed - predicted."""
        return [variable.difference(values) for variable, values in zip(self.variables, predicted, strict=True)]

    def residuals(self, predicted: list[Array]) -> xr.Dataset:
        """Observed - predicted."""
        pieces = zip(self.variables, self.differences(predicted), strict=True)
        return xr.Dataset({v.name: (v.dims, np.where(v.mask, off, np.nan)) for v, off in pieces}, {"time": self.time})


def observed(model: Model, data: Any, dt: float, observables: Any, starts: Mapping[str, Array]) -> Observations:
    """The observations.  Raises `InputError` for names, shapes and times that do not fit."""
    if not isinstance(data, xr.Dataset) or "time" not in data.coords or data["time"].dims != ("time",):
        raise InputError(
            f"observations: expected an xarray.Dataset with the coordinate time, or a run, got "
            f"{shown(type(data).__name__)}{' without it' if isinstance(data, xr.Dataset) else ''}."
        )
    oriented = ORIENTATION in starts
    names = [str(n) for n in data.data_vars if not str(n).startswith(SIGMA)]
    if "kreisel_format" in data.attrs:
        usual = (*model.system.space.letters, *(ORIENTATION,) * oriented, *observables)
        names = [n for n in names if n in usual]
    stray = [str(n) for n in data.data_vars if str(n).startswith(SIGMA) and str(n).removeprefix(SIGMA) not in names]
    if stray or not names:
        raise InputError(
            f"observations: expected variables, and sigma_NAME for some NAME of them, got {shown(stray or names)}."
        )
    variables = []
    for name in names:
        show = _show(model, name, observables, data[name].attrs.get(AXES), oriented)
        value, sigma = _values(model, data, name)
        if name == ORIENTATION and value.ndim == 3:
            sigma = sigma * _of_angles(value, sigma if SIGMA + name in data else None)[:, None, None]
        mask = np.isfinite(value) if name in (ORIENTATION, *observables) else _independent(value)
        variables.append(Variable(name, value, sigma, mask, show, tuple(map(str, data[name].dims))))
    time = data["time"].values
    if time.dtype.kind not in "iuf" or not len(time) or not np.isfinite(time.astype(np.float64)).all():
        raise InputError(
            f"observations: expected times as finite values in the unit of the system, got {time.dtype} "
            f"{shown(time[:3])}. For dates use (time - time[0]) / np.timedelta64(1, 's')."
        )
    if time.min() < 0:
        raise InputError(
            f"observations: expected times from 0 on, when the state is x0, got {float(time.min()):g} before the "
            "start. Use data.assign_coords(time=data.time - data.time[0]), and for a body on an orbit the anomaly and "
            "the epoch of that time."
        )
    time = np.asarray(time, dtype=np.float64) / _size_of_unit(model, data["time"], "time")
    _check_shapes(model, variables, starts)
    weighted = [name for name in names if SIGMA + name in data]
    if weighted and weighted != names:
        raise InputError(
            f"observations: expected sigma_NAME for each of {', '.join(names)} or for none, got it for "
            f"{', '.join(weighted)} alone."
        )
    return Observations(variables, bool(weighted), time, dt, *_grid(time, dt))


def _size_of_unit(model: Model, variable: Any, name: str) -> float:
    """The system's unit in units of a variable with the attribute `units`, for bodies of `kr.physical`."""
    frame, letter = model.body_frame, parse_quantity(name)[0]
    if not frame or letter not in (VELOCITY, *frame.units):
        return 1.0
    unit, size = ("rad/s", 1 / frame.time_unit) if letter == VELOCITY else frame.units[letter]
    stated = stated_unit(variable)
    ratio: float = size / si((1.0, stated), unit, name) if stated else 1.0
    return ratio


def _values(model: Model, data: Any, name: str) -> tuple[Array, Array]:
    """The values of a variable, and their errors, 1 if it has none.  Raises `InputError`.

    Errors without the attribute `units` have the units of the variable.
    """
    variable = data[name]
    size = _size_of_unit(model, variable, name)
    if not variable.dims or variable.dims[0] != "time" or "lane" in variable.dims or variable.dtype.kind not in "iuf":
        raise InputError(
            f"observations: expected values {name} (time, ...) of one body, got the dimensions {variable.dims} of "
            f"{variable.dtype}. Use .isel(lane=0) for a lane."
        )
    values = variable.values.astype(np.float64)
    if np.isinf(values).any():
        raise InputError(f"observations: expected finite values, or NaN for missing ones, got infinity in {name}.")
    if SIGMA + name not in data:
        return values / size, np.ones(values.shape)
    errors = data[SIGMA + name]
    try:
        sigma = errors.broadcast_like(variable).transpose(*variable.dims).values.astype(np.float64)
    except (ValueError, TypeError):
        sigma = np.zeros(0)
    finite = np.isfinite(values)
    if sigma.shape != values.shape or not ((sigma > 0) & (sigma < np.inf))[finite].all():
        raise InputError(
            f"observations: expected {SIGMA}{name} > 0 and finite, of the shape of {name}, {values.shape}, or spread "
            f"over it, got {shown(errors.values)} of the shape {errors.shape}. Values of no weight are NaN in {name}."
        )
    unit = _size_of_unit(model, errors, name) if stated_unit(errors) else size
    return values / size, np.where(finite, sigma, 1) / unit


def _of_angles(value: Array, sigma: Array | None) -> Array:
    """Changes (time,) of matrices by an angle of 1: sqrt 2 of rotations, each of whose angles changes two entries."""
    X = np.nan_to_num(value)
    off = np.sqrt(((X @ X.mT - np.eye(X.shape[-1])) ** 2).mean((1, 2)))
    least = ROTATION if sigma is None else NORMALIZED * sigma.min((1, 2))
    return np.where(off < least, math.sqrt(2), 1.0)


def _independent(value: Array) -> Array:
    """The finite entries; of skew or symmetric matrices (time, n, n) each once: below the diagonal if missing above."""
    finite = np.isfinite(value)
    if value.ndim != 3 or value.shape[1] != value.shape[2]:
        return finite
    pairs = np.where(finite & finite.mT, value, 0.0)
    for sign in (-1, 1):
        if np.array_equal(pairs, sign * pairs.mT):
            upper = np.triu(np.ones(value.shape[1:], bool), int(sign < 0))
            return np.asarray(finite & (upper | ~finite.mT))
    return finite


def _grid(time: Array, dt: float) -> tuple[int, int, Array, Array, Array]:
    """steps, every, rows, remainder, between."""
    if time.max() / dt > MOST_NUMBERS:
        raise InputError(f"dt: expected at most {MOST_NUMBERS:,} steps to the time {time.max():g}, got dt = {dt:g}.")
    number = np.floor(time / dt + ON_STEP).astype(np.int64)
    remainder = time - number * dt
    remainder = np.where(remainder > ON_STEP * dt, remainder, 0.0)
    every = int(np.gcd.reduce(number)) or 1
    steps = max(int(number.max()), 1)
    if steps // every > MOST_NUMBERS // 100:
        raise InputError(
            f"dt: expected times at multiples of a number of steps, got {steps // every:,} states to keep. Choose a dt "
            "so that times are multiples of many steps, or observe a shorter time."
        )
    return steps, every, number // every, remainder, np.nonzero(remainder)[0]


def _check_shapes(model: Model, variables: list[Variable], starts: Mapping[str, Array]) -> None:
    """Raises `InputError` for variables whose shapes differ from the model, and for observables that fail."""
    from kreisel.kernels import jax_numbers as by
    from kreisel.reduction.numerics import double, jax
    from kreisel.runs.differentiable import constants_of

    components = with_orientation(model, ORIENTATION in starts)

    def row(*state: Any) -> list[Any]:
        constants = constants_of(by, model, {})
        components_of_state = dict(zip((letter for letter, _ in components), state, strict=True))
        return [variable.show(by, components_of_state, 0.0, constants, starts) for variable in variables]

    sizes = [algebra.KINDS[kind].shown(model.n).shape(model.n) for _, kind in components]
    with double():
        shapes = jax.eval_shape(row, *(np.empty(s) for s in sizes))
    for variable, shape in zip(variables, shapes, strict=True):
        wanted, value = (len(variable.value), *shape.shape), variable.value
        if value.shape != wanted:
            raise InputError(f"observations: expected {variable.name} of the shape {wanted}, got {value.shape}.")


def _show(model: Model, name: str, observables: dict[str, Any], axes: str | None, oriented: bool) -> Show:
    """A variable as a function of the state; `axes`: the attribute of the variable about the axes of its components.

    By default M and P are along the axes of the state, Omega and g along the user's axes of the body.  Raises
    `InputError` for unknown names.
    """
    space = model.system.space
    if name in observables:
        return _of_user(name, observables[name], model, oriented)
    letter, index = parse_quantity(name)
    table = {k: f for k, (_, f, _) in functions(model, None).items()}
    if model.system.velocity is not None:
        frame = model.body_frame
        turned = frame.turned and model.system.frame is Frame.MOVING

        def velocity(*state: Any, **constants: Any) -> Any:  # of a body along the user's axes
            omega = call(model.system.velocity, state, constants)
            return algebra.act(frame.axes, algebra.axial(omega)) if turned else omega

        table[VELOCITY] = velocity
    if letter in space.letters or (letter == ORIENTATION and oriented):
        along = axes == BODY if letter in space.letters else axes != STATE
        body = model.body_frame if along else OF_SYSTEM
        turn = body.attitude(np.eye(4)).T if letter == ORIENTATION else body.axes
        return lambda by, state_of, *_: _item(turn @ state_of[letter] if body.turned else state_of[letter], index, name)
    if letter not in table:
        known_names = [*space.letters, *(ORIENTATION,) * oriented, *table, *observables]
        raise InputError(
            f"observations: expected variables among {', '.join(known_names)}, got {shown(name)}."
            f"{hint(letter, known_names)} For another quantity give observables={{'NAME': function}}."
        )

    def show(by: Any, state_of: Mapping[str, Any], t: Any, constants: Mapping[str, Any], values: Any) -> Any:
        state = [  # JAX sorts the keys of a dict
            algebra.KINDS[kind].from_user(by.numbers(state_of[k]), model.n) for k, kind in space.components
        ]
        where = {ORIENTATION: as_matrix(model, by.numbers(state_of[ORIENTATION]))} if oriented else {}
        value: Any = table[letter](*state, **constants, **where, **{TIME: by.mixed(by.jnp.asarray(t, dtype=float))})
        value = algebra.axial(value) if np.shape(value) == (3, 3) else value
        return _item(by.values(value), index, name)

    return show


def _item(value: Any, index: tuple[int, ...], name: str) -> Any:
    """An entry, or all of them without indices.  Raises `InputError` beyond the shape, where JAX has the last entry."""
    if len(index) > value.ndim or any(i >= size for i, size in zip(index, value.shape, strict=False)):
        raise InputError(f"observations: {name}: expected indices, counted from 0, within the shape {value.shape}.")
    return value[index]


def _of_user(name: str, function: Any, model: Model, oriented: bool) -> Show:
    if not callable(function):
        raise InputError(f"observables: expected a function for {name}, got {shown(function)}.")
    if ORIENTATION in keywords(function) and not oriented:
        raise InputError(f"observables: {name} needs the orientation g: expected orientation=..., got none.")

    def show(by: Any, state_of: Mapping[str, Any], t: Any, constants: Mapping[str, Any], values: Any) -> Any:
        where = {ORIENTATION: as_matrix(model, state_of[ORIENTATION])} if oriented else {}
        state = tuple(state_of[k] for k in model.system.space.letters)
        try:
            return by.jnp.asarray(call(function, state, {**values, **where, TIME: t}))
        except (TypeError, AttributeError, IndexError, ValueError) as error:
            raise InputError(
                f"observables: {name} cannot be computed and differentiated by JAX: {str(error).splitlines()[0]} Write "
                "it with jax.numpy in place of numpy and math, of the components of one state, in order, and "
                "parameters by name."
            ) from error

    return show
