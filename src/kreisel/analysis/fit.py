"""kr.fit: parameters and an initial state from observations, by least squares on the derivatives of the motion.

    minimise  sum ((observed - predicted(x)) / sigma)^2  over x;   covariance (J^T J)^(-1), J by `kr.differentiable`

Without errors sigma all N values have one error s, s^2 = sum (observed - predicted)^2 / (N - unknowns).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from kreisel.algebra import Array
from kreisel.algebra.reuse import Identity, cached_property, reused
from kreisel.analysis.observations import ATTITUDE, Observations, Unknown, observed, turn_coordinates, unknowns
from kreisel.errors import AccuracyWarning, InputError, RunError, doubt, explained
from kreisel.forces.control import whole_samples
from kreisel.method.scheme import ORIENTATION
from kreisel.record.body import Body, as_body
from kreisel.record.calling import keywords
from kreisel.record.model import Model, State
from kreisel.record.units import AXES
from kreisel.runs.differentiable import attitude_near, constants_of, differentiable
from kreisel.runs.in_si import letters_of, observations_of, scaled
from kreisel.runs.settings import check_model, checked_state, initial_orientation, positive_number, within

if TYPE_CHECKING:
    from kreisel.record.model import OrientationLike, StateLike

SINGULAR = 1e-10  # least singular value over the largest, of a Jacobian with columns of length 1
NAMED = 0.05  # share in a combination below which a coordinate is not named
PRECISION = 1e-12
EXACT = 1e-8  # of the observations: residuals below it are of the map itself
OFF = 10  # errors of an observation, root mean square: beyond it the motion is a different one


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters and a state fitted to observations.

    table         value, standard error, start, low and high of each unknown, by name
    covariance    of the values, a table
    model, state  the system and the state at time 0 with these values
    orientation   the attitude at time 0, as for `kr.simulate`; None without one
    residuals     observed - predicted, a Dataset; NaN for missing observations
    chi2, dof     sum ((observed - predicted)/sigma)^2, and the count of observed values minus the count of unknowns;
                  directions and quaternions of length 1 count as one value less than their entries
    sigma         the error of an observation from the residuals, if none was given; else None
    at_bound      names of the unknowns at one of their bounds
    converged     whether the search ended at a minimum; `message` gives the reason, `evaluations` their count
    """

    table: pd.DataFrame
    covariance: pd.DataFrame
    model: Model
    state: State
    orientation: Array | None
    residuals: xr.Dataset
    chi2: float
    dof: int
    sigma: float | None
    at_bound: tuple[str, ...]
    converged: bool
    message: str
    evaluations: int
    settings: Mapping[str, Any]

    @property
    def values(self) -> dict[str, float]:
        """The values by name."""
        return {str(k): float(v) for k, v in self.table["value"].items()}

    @property
    def errors(self) -> dict[str, float]:
        """The standard errors by name."""
        return {str(k): float(v) for k, v in self.table["error"].items()}

    @property
    def correlation(self) -> pd.DataFrame:
        """The covariance over the products of the standard errors."""
        error = self.table["error"].to_numpy()
        return self.covariance.div(error, axis=0).div(error, axis=1)

    @cached_property
    def run(self) -> xr.Dataset:
        """The fitted motion at the times of the observations, by `kr.simulate`."""
        from kreisel.storage.simulate import simulate

        times = np.unique(self.residuals["time"].values.astype(np.float64))
        settings = {**self.settings, "times": [float(t) for t in times], "orientation": self.orientation}
        return simulate(self.model, self.state, **settings)

    @property
    def _summary(self) -> str:
        error = "" if self.sigma is None else f"; sigma = {self.sigma:.4g} from the residuals"
        at = f"; at a bound: {', '.join(self.at_bound)}, whose errors mean little" if self.at_bound else ""
        end = "" if self.converged else f"; NOT CONVERGED: {self.message}"
        axes = "; vectors in the body are along the axes of the state, model.body_frame.vectors(v) along those given"
        turned = axes if self.model.body_frame.turned else ""
        return f"chi^2 = {self.chi2:.6g} for {self.dof} degrees of freedom{error}{at}{turned}{end}"

    def __repr__(self) -> str:
        return f"Fit of {self.model.system.name}: {self._summary}\n{self.table.to_string(float_format='{:.6g}'.format)}"

    def _repr_html_(self) -> str:
        title = f"Fit of {escape(self.model.system.title)}"
        return f"<div><strong>{title}</strong><p>{escape(self._summary)}</p>{self.table.to_html()}</div>"


@explained
def fit(
    system: Model | Body,
    observations: xr.Dataset,
    *,
    free: Sequence[str] | Mapping[str, Any],
    x0: StateLike | None = None,
    orientation: OrientationLike | None = None,
    dt: Any = None,
    observables: Mapping[str, Callable[..., Any]] | None = None,
    bounds: Mapping[str, tuple[Any, Any]] | None = None,
    method: str | None = None,
    order: Any = None,
    evaluations: int = 200,
) -> Fit:
    """Parameters of a system and components of its state at time 0, from observations, with their errors.

    system         with parameters: fixed values, and the start of the search; or a body, with SI and names of its runs
    observations   a Dataset with the coordinate `time`, from 0 on, in any order, and variables (time, ...): components
                   of the state (n = 3: axial vectors), "g" (the orientation), "Omega" (in the frame of the system),
                   "energy" and other integrals, one entry such as "a[2]", names of `observables`; NaN if missing.  For
                   a body of `kr.physical` Omega is along the user's axes of the body and g the attitude of these axes,
                   unless an attribute `axes` is "state", as in a run; units (time in "ms", Omega in "deg/s") are read
                   from attributes `units`.  sigma_NAME, broadcast to NAME, is its standard error.  Or a run: its state
    free           names of unknowns: a parameter or a component, "p", or one entry, "p[2]", along the axes of the
                   state, in its units, or the principal "moments" of a `FreeBody`, kg m^2; a mapping also gives the
                   start of the search, None for the values of the system and x0
    x0             the state at time 0, or the start of its search; default: the first row of `observations`
    orientation    the attitude at time 0, as for `kr.simulate`, or the start of its search: needed by forces that
                   depend on g; False: none.  Free as "orientation": the axial vector of X (the entries i < j) in g =
                   orientation cay(X/2), in the rest frame cay(X/2) orientation: the angles of a small rotation, rad
    dt             the step; times between two steps are reached by a shorter step.  Default for a run: its dt
    observables    name -> f(*components, *, ...) in jax.numpy, of one state, along its axes; after the star
                   parameters by letter, the matrix g, the time t, parameters of the instrument, with a start in `free`
    bounds         name -> (low, high)
    method, order  as for `kr.differentiable`, whose function is fitted: without projections

    Least squares by `scipy.optimize.least_squares` (trust region reflective), which finds the minimum next to the
    start: if phases may be off by pi, fit a short time first.  The covariance is the linear problem's at the
    minimum.  Needs the extra `reduction` (JAX).  Warns if dt is too long for the errors of the observations.  Raises
    `InputError` for bad input, and if the observations leave a combination of the unknowns undetermined, which it
    names; `RunError` if the motion fails at the start.
    """
    model, x0, orientation, dt, observations, free = _scaled(system, x0, orientation, dt, observations, free)
    state = checked_state(model, _first(model, observations) if x0 is None else x0)
    functions, settings = dict(observables or {}), {"method": method, "order": order}
    attitude = _attitude(model, observations, orientation)
    carried = attitude if _depends_on_attitude(model, observations, free, functions) else None
    further = {} if (body := as_body(system)) is None else body.parameters_in_si
    unknown, starts = unknowns(model, state, carried, free, bounds or {}, functions, further)
    parameters = partial(_parameters, body, model, {u.letter for u in unknown})
    seen = observed(model, observations, dt, functions, starts)
    f = differentiable(model, **settings, orientation=carried is not None)
    key = model.key, *_kind(model, observations, functions, further), method, order
    predictions = partial(_predictions, f, model, unknown, starts, key, parameters)
    predicted = predictions(seen)
    solution = _least_squares(predicted, seen, unknown, evaluations, model)
    if not _is_run(observations):  # a run has this error too
        _doubt_dt(solution, unknown, seen, predictions(observed(model, observations, dt / 2, functions, starts), False))
    fitted = _model_at(model, starts, attitude, unknown, solution.x, parameters)
    return _as_fit(solution, unknown, fitted, seen, predicted(solution.x.tobytes())[0], {"dt": dt, **settings})


def _kind(
    model: Model, observations: Any, observables: Mapping[str, Any], in_si: Mapping[str, Array]
) -> tuple[Any, ...]:
    """The values in the functions of a fit that the key of the model does not have."""
    axes = model.body_frame.axes.tobytes() if model.body_frame else b""
    of_variables = tuple((name, variable.attrs.get(AXES)) for name, variable in observations.variables.items())
    of_body = tuple((letter, value.tobytes()) for letter, value in in_si.items())
    return axes, of_variables, tuple((name, Identity(f)) for name, f in observables.items()), of_body


def _parameters(body: Body | None, model: Model, unknown: set[str], values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of the model that change: unknown ones, and those that follow from unknowns of the body in SI."""
    changed = {letter: values[letter] for letter in model.params if letter in unknown}
    in_si = {} if body is None else {letter: values[letter] for letter in body.parameters_in_si if letter in unknown}
    return changed | body._scaled(in_si) if body is not None and in_si else changed


def _scaled(system: Any, x0: Any, orientation: Any, dt: Any, observations: Any, free: Any) -> tuple[Any, ...]:
    """The arguments of a fit in the form of the state; `system` may be a body.  Raises `InputError`."""
    if as_body(system) is None:
        check_model(system)
        dt = _step_of(observations) if dt is None else positive_number(dt, "dt")
        return system, x0, orientation, whole_samples(system, dt), observations, free
    step = _step_of(observations) if dt is None else dt
    model, x0, first, asked, _ = scaled(system, x0, orientation, {"dt": step})
    data = observations_of(model, observations)
    if orientation is False and hasattr(data, "drop_vars"):
        first, data = False, data.drop_vars(ORIENTATION, errors="ignore")
    if x0 is None and not _is_run(data):
        raise InputError("x0: expected body.state(...), the start of the search, got none, and no run of this body.")
    dt = whole_samples(model, positive_number(asked["dt"], "dt"))
    return model, x0, first, dt, data, letters_of(model, free)


def _is_run(data: Any) -> bool:
    return "kreisel_format" in getattr(data, "attrs", {})


def _step_of(observations: Any) -> float:
    attrs = getattr(observations, "attrs", {})
    if "dt" not in attrs:
        raise InputError("dt: expected the step of the motion, such as dt=0.01, got none, and no run that has one.")
    return float(attrs["dt"])


def _first(model: Model, observations: Any) -> dict[str, Any]:
    letters = model.system.space.letters
    missing = [k for k in letters if k not in observations]
    rows = 0 if missing or not observations[letters[0]].ndim else len(observations[letters[0]])
    if not rows or not observations["time"].ndim or float(observations["time"][0]) != 0:
        raise InputError(
            f"x0: expected the state at time 0, where the search begins, got none, and no observation of "
            f"{', '.join(missing or letters)} at time 0. Give x0=system.state(...)."
        )
    return {k: np.asarray(observations[k][0].values) for k in letters}


def _attitude(model: Model, observations: Any, orientation: Any) -> Array | None:
    if orientation is None and _is_run(observations) and ORIENTATION in observations:
        orientation = observations[ORIENTATION].values[0]
    if orientation is None or orientation is False:
        return None
    g = initial_orientation(orientation, model)
    if g.ndim > 1 + (model.n > 3):
        raise InputError(f"orientation: expected one attitude, got the shape {g.shape}.")
    return g


def _depends_on_attitude(model: Model, observations: Any, free: Any, observables: Mapping[str, Any]) -> bool:
    """Whether forces, observations or unknowns depend on the attitude; not every method of a top computes it."""
    forces = model.system.perturbation
    by_forces = forces is not None and forces.names(ORIENTATION)
    by_user = any(ORIENTATION in keywords(f) for f in observables.values() if callable(f))
    names = *getattr(observations, "data_vars", ()), *(free if isinstance(free, Iterable) else ())
    return by_forces or by_user or any(str(name).partition("[")[0] in (ORIENTATION, ATTITUDE) for name in names)


def _predictions(
    f: Any,
    model: Model,
    unknown: list[Unknown],
    starts: Mapping[str, Array],
    key: Any,
    parameters: Callable[[Mapping[str, Any]], dict[str, Any]],
    seen: Observations,
    derivatives: bool = True,
) -> Callable[[bytes], tuple[list[Array], list[Array]]]:
    """The variables of x (k,), and their Jacobians (..., k); compiled once for fits of the same kind, by `key`.

    Without derivatives the variables twice.
    """
    from kreisel.kernels import jax_numbers as by
    from kreisel.reduction.numerics import double, jax

    jnp = jax.numpy
    letters = model.system.space.letters

    def filled(x: Any, starts: Any, letter: str) -> Any:
        out = starts[letter]
        for i, u in enumerate(unknown):
            if u.letter == letter:
                out = jnp.where(u.place != 0, u.place * x[i], out)
        return out

    def predicted(x: Any, starts: Any) -> tuple[Any, Any]:
        values = {k: filled(x, starts, k) for k in starts if k != ORIENTATION}
        state = {k: values.pop(k) for k in letters}
        if ORIENTATION in starts:
            turn = turn_coordinates(model, values.pop(ATTITUDE))
            state[ORIENTATION] = attitude_near(by, model, turn, starts[ORIENTATION])
        moving = parameters(values)
        values |= moving
        rows = _at_times(jax, f, state, seen, moving)
        constants = constants_of(by, model, moving)
        out = [
            jax.vmap(lambda row, t, v=v: v.show(by, row, t, constants, values))(rows, jnp.asarray(seen.time))
            for v in seen.variables
        ]
        return out, out

    names = *(u.name for u in unknown), *(v.name for v in seen.variables)
    key = "fit", derivatives, *key, seen.dt, *names, seen.time.tobytes()
    compiled = reused(key, lambda: jax.jit(jax.jacfwd(predicted, has_aux=True) if derivatives else predicted))
    begin = {k: np.asarray(v, dtype=np.float64) for k, v in starts.items()}

    def at(x: bytes) -> tuple[list[Array], list[Array]]:
        with double():
            slopes, values = compiled(np.frombuffer(x), begin)
            return [np.asarray(v) for v in values], [np.asarray(v) for v in slopes]

    return lru_cache(1)(at)


def _at_times(jax: Any, f: Any, state: Any, seen: Observations, parameters: Any) -> Any:
    rows = f(state, dt=seen.dt, steps=seen.steps, every=seen.every, **parameters)
    at = jax.tree.map(lambda v: v[seen.rows], rows)
    if not len(seen.between):
        return at
    begin = jax.tree.map(lambda v: v[seen.between], at)
    time = seen.time[seen.between] - seen.remainder[seen.between]
    remainder = jax.vmap(lambda row, h, t: f(row, dt=h, steps=1, time=t, **parameters))(
        begin, seen.remainder[seen.between], time
    )
    return jax.tree.map(lambda v, w: v.at[seen.between].set(w), at, remainder)


def _least_squares(
    predicted: Callable[..., Any], seen: Observations, unknown: list[Unknown], evaluations: int, model: Model
) -> Any:
    from scipy.optimize import least_squares

    if seen.size < len(unknown):
        raise InputError(
            f"observations: expected at least as many values as unknowns, got {seen.size} for {len(unknown)}: "
            f"{', '.join(u.name for u in unknown)}."
        )
    start = np.array([u.start for u in unknown])

    def value(x: Array) -> Array:
        return -seen.flat(seen.differences(predicted(x.tobytes())[0]))

    def slope(x: Array) -> Array:
        return seen.flat(predicted(x.tobytes())[1])

    if not np.isfinite(value(start)).all():
        raise RunError(
            f"fit: the motion of {model.system.name} is not finite where the search begins, at "
            f"{', '.join(f'{u.name} = {u.start:g}' for u in unknown)}. Usual cause: dt too long, or an observable that "
            "is not a number there."
        )
    options: dict[str, Any] = dict.fromkeys(("ftol", "xtol", "gtol"), PRECISION)
    bounds = [u.low for u in unknown], [u.high for u in unknown]
    most = within(evaluations, "evaluations", 1, 10**6)
    solution = least_squares(value, start, slope, bounds, x_scale="jac", max_nfev=most, **options)
    if not solution.success:
        text = f"fit: the search did not converge: {solution.message} Begin nearer, or raise evaluations."
        warnings.warn(text, AccuracyWarning, stacklevel=3)
    solution["dof"] = seen.count(predicted(solution.x.tobytes())[0]) - len(unknown)
    return solution


def _doubt_dt(solution: Any, unknown: list[Unknown], seen: Observations, finer: Callable[..., Any]) -> None:
    """Warns if half the step moves an unknown by more than its error: by the linear problem at the minimum."""
    J, names = np.asarray(solution.jac), [u.name for u in unknown]
    covariance, spread = covariance_of(J, names), 1.0
    if not seen.weighted:
        spread = math.sqrt(solution.fun @ solution.fun / max(solution.dof, 1))
        if spread <= EXACT * math.sqrt(np.mean(seen.flat([v.value for v in seen.variables]) ** 2)):
            return  # values of the same map
    moved = covariance @ (J.T @ (seen.flat(seen.differences(finer(solution.x.tobytes())[0])) + solution.fun))
    shares = abs(moved) / (spread * np.sqrt(np.diag(covariance)))
    if shares.max() > 1:
        k = int(shares.argmax())
        text = f"fit: half the step moves {names[k]} by {moved[k]:.2g}, {shares[k]:.2g} times its error. "
        doubt(text + "Usual cause: dt too long for the errors of the observations. Use a shorter dt.", AccuracyWarning)


def covariance_of(J: Array, names: Sequence[str]) -> Array:
    """(J^T J)^(-1) of J (m, k).  Raises `InputError` if J has no full rank, and names the undetermined unknowns."""
    size = np.sqrt((J * J).sum(0))
    scaled = J / np.where(size > 0, size, 1)
    _, s, turned = np.linalg.svd(scaled, full_matrices=False)
    least = s[-1] <= SINGULAR * s[0]
    if size.min() == 0 or least:
        along = (size == 0).astype(float) if size.min() == 0 else turned[-1] / size
        share = abs(along) if size.min() == 0 else abs(turned[-1])
        along = along / along[np.argmax(abs(along))]
        terms = [f"{n} by {v:.3g}" for n, v, w in zip(names, along, share, strict=True) if w > NAMED]
        together = "together " if len(terms) > 1 else ""
        raise InputError(
            f"fit: expected observations that determine {', '.join(names)}, got some that do not change with "
            f"{', '.join(terms)} {together}(singular Jacobian). Usual cause: a scale that nothing observed fixes. "
            "Leave one of them out of free, or observe more."
        )
    back = turned.T / s / size[:, None]
    return back @ back.T


def _as_fit(
    solution: Any,
    unknown: list[Unknown],
    fitted: tuple[Model, State, Array | None],
    seen: Observations,
    predicted: list[Array],
    settings: Mapping[str, Any],
) -> Fit:
    names = [u.name for u in unknown]
    covariance = covariance_of(np.asarray(solution.jac), names)
    chi2, dof = 2 * float(solution.cost), solution.dof
    if seen.weighted and chi2 > OFF**2 * max(dof, 1):
        doubt(
            f"fit: the observations are {np.sqrt(chi2 / max(dof, 1)):.3g} of their errors away from the motion found. "
            "Usual cause: rates or times in other units than the system's (give them the attribute units), "
            "times that do not begin where x0 is, or a search that began too far away."
        )
    sigma = None
    if not seen.weighted:
        sigma = float(np.sqrt(chi2 / dof)) if dof > 0 else np.nan
        covariance = covariance * sigma**2
    model, state, attitude = fitted
    columns = {"value": solution.x, "error": np.sqrt(np.diag(covariance))}
    columns |= {name: np.array([getattr(u, name) for u in unknown]) for name in ("start", "low", "high")}
    return Fit(
        table=pd.DataFrame(columns, index=names),
        covariance=pd.DataFrame(covariance, index=names, columns=names),
        model=model,
        state=state,
        orientation=attitude,
        residuals=seen.residuals(predicted),
        chi2=chi2,
        dof=dof,
        sigma=sigma,
        at_bound=tuple(n for n, active in zip(names, solution.active_mask, strict=True) if active),
        converged=bool(solution.success),
        message=str(solution.message),
        evaluations=int(solution.nfev),
        settings=settings,
    )


def _model_at(
    model: Model,
    starts: Mapping[str, Array],
    attitude: Array | None,
    unknown: list[Unknown],
    x: Array,
    parameters: Callable[[Mapping[str, Any]], dict[str, Any]],
) -> tuple[Model, State, Array | None]:
    """The model with the fitted values.  Raises `RunError` for values that no such system has."""
    values: dict[str, Array] = {ATTITUDE: np.zeros(model.n * (model.n - 1) // 2), **starts}
    for u, value in zip(unknown, x, strict=True):
        values[u.letter] = np.where(u.place != 0, u.place * value, values[u.letter])
    values |= parameters(values)
    try:
        fitted = Model(model.system, {k: values[k] for k in model.params}, model.body_frame)
        fitted_state = fitted.state(**{k: values[k] for k in model.system.space.letters})
    except InputError as error:
        raise RunError(f"fit: the values found are none of {model.system.name}. {error} Use bounds=... .") from error
    if attitude is None:
        return fitted, fitted_state, None
    from kreisel.kernels import jax_numbers as by
    from kreisel.reduction.numerics import double

    with double():
        attitude = np.asarray(attitude_near(by, model, turn_coordinates(model, values[ATTITUDE]), attitude))
    return fitted, fitted_state, attitude
