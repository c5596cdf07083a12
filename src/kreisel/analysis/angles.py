"""kr.analysis: Euler's angles, angular velocity, rates, measured and in closed form; paths in space; pointing."""

from __future__ import annotations

import contextlib
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array, act, axial, dot
from kreisel.analysis.events import Carrier, after_samples, events, parts_of
from kreisel.analysis.quantities import rows_of
from kreisel.errors import InputError, explained, shown
from kreisel.method.scheme import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.runs import geometry
from kreisel.runs.geometry import (
    FRAMES,
    angles_of,
    attitude_of,
    components,
    fixed_vector,
    model_for,
    orientation_of,
    pointing_error,
    velocity_of,
)
from kreisel.runs.in_si import frame_in_si, in_state_form, is_in_si
from kreisel.runs.run_record import RunRecord, a_run, frame_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from scipy.spatial.transform import Rotation


VERTICAL = 1e-9  # sin(theta) below which precession and spin cannot be separated


@explained
def rotations(run: xr.Dataset) -> Rotation:
    """The orientations g (body to space) as one `scipy.spatial.transform.Rotation`, n = 3; for an ensemble row by row.

    For a body of `kr.physical` g is the attitude of the user's axes, as in `quaternions`.  Raises `InputError` for a
    run without an orientation.
    """
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(attitude_of(run).reshape(-1, 4), scalar_first=True)


@explained
def quaternions(run: xr.Dataset) -> Array:
    """The unit quaternions (w, x, y, z) of the orientation, (time, 4) or (time, lane, 4), without jumps of sign.

    Consecutive g lie in the same half of the sphere, so the four components are smooth in time.  For a body of
    `kr.physical` g is the attitude of the user's axes of the body, not of the axes of the state: do not pass it to
    `body.attitude`.  Raises `InputError` for a run without an orientation.
    """
    return algebra.continued(attitude_of(a_run(run)))


@explained
def euler_angles(run: xr.Dataset, system: Model | None = None) -> xr.Dataset:
    """Euler's angles phi, theta, psi of the body against time: g = R_3(phi) R_1(theta) R_3(psi), n = 3, in rad.

    For a top the third axis of space is the vertical (against gravity), and the third axis of the body is its axis; if
    needed, the least rotation maps them there.  theta is the tilt, phi the precession, psi the proper rotation of the
    body.  For other bodies the axes are the state's, for bodies of `kr.physical` the user's axes.  phi and psi
    are continued without jumps, which is correct if they change by less than pi between two saved rows.  On the
    vertical only phi +- psi has a meaning, and psi = 0.

    Returns a Dataset (time) or (time, lane).  Raises `InputError` for a run without an orientation or with n > 3.
    [Goldstein, Classical Mechanics, 3rd ed., section 4.4]
    """
    from scipy.spatial.transform import Rotation

    lead = attitude_of(a_run(run)).shape[:-1]
    S, B = (Rotation.from_matrix(np.broadcast_to(v, (*lead, 3, 3)).reshape(-1, 3, 3)) for v in _alignment(run, system))
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # on the vertical
        angles = (S * rotations(run) * B.inv()).as_euler("ZXZ").reshape((*lead, 3))
    data, (dims, coords) = {}, rows_of(run)
    for k, (name, meaning) in enumerate({"phi": "precession", "theta": "tilt", "psi": "own turn"}.items()):
        value = angles[..., k] if name == "theta" else np.unwrap(angles[..., k], axis=0)
        data[name] = (dims, value, {"long_name": meaning, "units": "rad"})
    return xr.Dataset(data, coords, _described(run))


def _alignment(run: xr.Dataset, system: Model | None) -> tuple[Array, Array]:
    """Rotations of space and body that map the vertical and the axis, if any, to the third axes, ([lane,] 3, 3)."""
    if system is None and (RunRecord.of(run, "system").is_own or not geometry.is_upright(model_for(run, None))):
        return np.eye(3), np.eye(3)
    model = model_for(run, system)
    g = algebra.rotation_matrix(orientation_of(run)[0])
    up, axis = geometry.vertical_and_axis(model, components(run, model)[model.system.space.leading][0])
    if model.system.frame is Frame.REST:
        axis = act(g.mT, axis)
    else:
        up = act(g, up)
    up, axis = (
        np.reshape([geometry.to_third_axis(_snapped(v)) for v in vectors.reshape(-1, 3)], (*vectors.shape, 3))
        for vectors in (up, act(frame_of(run).axes, axis))
    )
    return up, axis


def _snapped(v: Array) -> Array:
    """A coordinate axis if v equals one up to rounding, else v."""
    near = np.round(v)
    return near if np.abs(v - near).max() < 1e-12 and abs(near).sum() == 1 else v


@explained
def rates(run: xr.Dataset, system: Model | None = None) -> xr.Dataset:
    """Tilt and the rates of Euler's angles at every row, from the state only: no orientation, no differences.

    With the angular velocity omega, the vertical e and the axis k (unit vectors in one frame), cos(theta) = <e, k>:

        phi' = (<omega, e> - cos(theta) <omega, k>)/sin(theta)^2      precession
        psi' = (<omega, k> - cos(theta) <omega, e>)/sin(theta)^2      proper rotation
        theta' = <omega, e x k>/sin(theta)                            nutation
        spin = <omega, k>                                             total angular velocity about the axis

    Returns a Dataset with tilt, precession, own_turn, nutation and spin, (time) or (time, lane); NaN on the vertical.
    Rates are in rad/s for a body of `kr.physical`, whose units the run has, else in the inverse unit of time of the
    run: see the attribute `units` of each.  Raises `InputError` for systems without a vertical and an axis, or n > 3.
    """
    model = model_for(run, system)
    values, frame = _rates(model, components(run, model)), frame_of(run)
    unit, size = "rad/s" if frame else "1", frame.time_unit
    dims, coords = rows_of(run)
    data = {k: (dims, v / size, {"units": unit}) for k, v in values.items()}
    data["tilt"] = dims, values["tilt"], {"units": "rad"}
    return xr.Dataset(data, coords, _described(run))


def _rates(model: Model, state: tuple[Array, ...]) -> dict[str, Array]:
    e, k = geometry.vertical_and_axis(model, state[model.system.space.leading])
    cosine, node = dot(e, k), np.cross(e, k)
    sine = np.sqrt(dot(node, node))
    upright = np.where(sine > VERTICAL, sine, np.nan)
    with np.errstate(all="ignore"):
        omega = axial(model.call(model.system.velocity, *state))
        up, along = dot(omega, e), dot(omega, k)
        rates = {
            "tilt": np.arctan2(sine, cosine),
            "precession": (up - cosine * along) / upright**2,
            "own_turn": (along - cosine * up) / upright**2,
            "nutation": dot(omega, node) / upright,
            "spin": along,
        }
    if not all(np.isfinite(v[sine > VERTICAL]).all() for v in rates.values()):
        raise InputError("expected a run whose angular velocity a double can hold, got a larger one. Use other units.")
    return rates


@explained
def mean_rates(run: xr.Dataset, system: Model | None = None) -> pd.DataFrame:
    """Nutation and precession measured in a run, next to the closed form if one is known (`kr.nutation`).

    The run is cut at the times at which the axis is highest, located to round-off (`events`).  Rows: nutation_period,
    nutation_frequency (angular), precession_per_period, mean_precession (angular velocity of the axis about the
    vertical, with multiples of 2 pi), lowest and highest <e, k> = cos(tilt), spin.  Columns: measured, closed_form,
    difference; NaN if a closed form is not known, and for the precession of a moving frame without an orientation.

    Raises `InputError` for ensembles, for fewer than two nutations, for rows too far apart, and for other systems.
    """
    unit, run = frame_in_si(a_run(run)).time_unit, in_state_form(a_run(run, "system"))
    if "lane" in run.dims:
        raise InputError("mean_rates needs one trajectory: choose a lane, run.isel(lane=0).")
    model = model_for(run, system)
    space = model.system.space

    def climb(*values: Array) -> Array:
        """The derivative of cos(tilt), of the stored components."""
        state = tuple(algebra.KINDS[k].from_user(v, model.n) for k, v in zip(space.kinds, values, strict=True))
        e, k = geometry.vertical_and_axis(model, state[space.leading])
        return dot(e, np.cross(axial(model.call(model.system.velocity, *state)), k))

    peaks = events(run, climb, rising=False, system=model)
    if peaks.sizes["event"] < 2:
        raise InputError("Fewer than two nutations are in the run: the motion is steady, or the run too short.")
    lows = events(run, climb, rising=True, system=model)
    carried = (at[space.letters[space.leading]].values for at in (lows, peaks))
    low, high = (float(dot(*geometry.vertical_and_axis(model, v)).mean()) for v in carried)
    spin = _rates(model, components(run.isel(time=slice(0, 1)), model))["spin"]
    nutations, time = peaks.sizes["event"] - 1, peaks["time"].values
    advance = _advance(run, model, peaks) / nutations
    measured = _nutation(float(time[-1] - time[0]) / nutations, advance, low, high, float(spin[0]))
    closed_form = _nutation_rates(run, model)
    table = pd.DataFrame({"measured": measured, "closed_form": {k: closed_form.get(k, np.nan) for k in measured}})
    for name, power in POWERS_OF_TIME.items():
        table.loc[name] *= unit**power
    table["difference"] = table.measured - table.closed_form
    return table


POWERS_OF_TIME = {"nutation_period": 1, "nutation_frequency": -1, "mean_precession": -1, "spin": -1}


def _nutation(period: float, advance: float, lowest: float, highest: float, spin: float) -> dict[str, float]:
    return {
        "nutation_period": period,
        "nutation_frequency": 2 * np.pi / period,
        "precession_per_period": advance,
        "mean_precession": advance / period,
        "lowest": lowest,
        "highest": highest,
        "spin": spin,
    }


def _advance(run: xr.Dataset, model: Model, peaks: xr.Dataset) -> float:
    """The angle by which the axis goes about the vertical from the first peak to the last, with multiples of 2 pi."""
    rate = _rates(model, components(run, model))["precession"]
    gap = np.diff(run["time"].values).max()
    if np.nanmax(np.abs(rate)) * gap > np.pi / 2:
        raise InputError("The axis moves too far between two saved rows to count revolutions: save more often (every).")
    rows, cut = _azimuth(run, model), _azimuth(peaks, model)
    if rows is None or cut is None:
        return float("nan")
    ends = peaks["time"].values[[0, -1]]
    inside = (run["time"].values > ends[0]) & (run["time"].values < ends[1])
    joined = np.unwrap(np.concatenate([cut[:1], rows[inside], cut[-1:]]))
    return float(joined[-1] - joined[0])


def _azimuth(run: xr.Dataset, model: Model) -> Array | None:
    """The azimuth of the axis about the vertical in space; None if the state does not determine it."""
    from scipy.spatial.transform import Rotation

    carried = np.asarray(run[model.system.space.letters[model.system.space.leading]].values)
    if model.system.frame is Frame.REST:
        up: Any = fixed_vector(model, "space")  # one exists, or `vertical_and_axis` would have raised
        axis = carried
    else:
        if ORIENTATION not in run:
            return None
        g = Rotation.from_quat(orientation_of(run), scalar_first=True)
        lever: Any = fixed_vector(model, "body")
        up, axis = g[0].apply(carried[0]), g.apply(lever)
    seen = act(geometry.to_third_axis(_snapped(up / np.linalg.norm(up))), axis)
    return np.arctan2(seen[..., 1], seen[..., 0])


def _nutation_rates(run: xr.Dataset, model: Model) -> dict[str, float]:
    from kreisel.runs.closed_form import nutation

    start = {letter: run[letter].values[0] for letter in model.system.space.letters}
    try:
        motion = nutation(model, start)
    except InputError:
        return {}
    fixed = fixed_vector(model, "space" if model.system.frame is Frame.REST else "body")
    carried = np.asarray(start[model.system.space.letters[model.system.space.leading]])
    size = float(np.linalg.norm(carried) * np.linalg.norm(fixed if fixed is not None else 1.0))
    return _nutation(motion.period, motion.precession, motion.lowest / size, motion.highest / size, motion.spin)


def _described(run: xr.Dataset) -> dict[str, Any]:
    return {k: run.attrs[k] for k in ("title", "system", "method") if k in run.attrs}


# -- angular velocity, and the path of a body that moves through space -----------------------------


BODY, SPACE = "body", "space"
ROWS_AT_ONCE = 20_000


@explained
def angular_velocity(run: xr.Dataset, system: Model | None = None, *, frame: str = BODY) -> xr.DataArray:
    """The angular velocity of every row, (time, axis) or (time, lane, axis) for n = 3, else skew (..., n, n).

    system   the model, for a user-defined system
    frame    "body": Omega, along the axes of the body, g' = g Omega;  "space": omega = g Omega g^T

    For a body of `kr.physical` in rad/s along the user's axes of the body; for other systems in the inverse unit of
    time of the run: see the attribute `units` of the result.  A frame other than the state's requires a run
    with an orientation.  Raises `InputError` if it has none, and for systems without a rotating body.
    """
    run = in_state_form(run_of_user := a_run(run))
    model = model_for(run, system)
    if frame not in (BODY, SPACE):
        raise InputError(f"frame: expected 'body' or 'space', got {shown(frame)}.")
    if model.system.velocity is None:
        raise InputError(f"{model.system.name}: expected a system of a body that rotates, got one without.")
    omega, body_frame = velocity_of(run, model), model.body_frame or frame_of(run)
    if (model.system.frame is Frame.REST) == (frame == BODY):
        g = _matrices(run, model)
        omega = g.mT @ omega @ g if frame == BODY else g @ omega @ g.mT
    values, axes = (algebra.axial(omega), ("axis",)) if model.n == 3 else (omega, ("row", "column"))
    values = (body_frame.vectors(values) if frame == BODY else values) / body_frame.time_unit
    lead, coords = rows_of(run_of_user)
    unit = "rad/s" if body_frame else "1"
    meaning = "Omega, along the axes of the body" if frame == BODY else "omega, in space"
    return xr.DataArray(values, coords, (*lead, *axes), "angular_velocity", {"long_name": meaning, "units": unit})


@explained
def path(run: xr.Dataset, system: Model | None = None, *, start: ArrayLike | None = None) -> xr.DataArray:
    """The position x of a body in space at every row, (time, axis) or (time, lane, axis): x' = g U, U = dH/dP.

    system   the model, for a user-defined system
    start    x at the first row, (n,) or (lane, n); default: 0

    For bodies in a fluid (Kirchhoff's equations), whose P is their momentum, in the frame of the fluid; the run
    requires an orientation.  From row to row the flow itself carries x with the state, to round-off, by extrapolation
    of order 16 in steps that suit each row; the final state is compared with the next row.  Without other forces the
    momenta in space
    p = g P and g M g^T - x ^ p are constant: they give the part of x across p without a summation.
    In the unit of length of P U = energy.  Raises `InputError` for other systems, without an orientation, and if the
    flow does not lead from a row to the next.
    """
    run = in_state_form(run_of_user := a_run(run))
    model = model_for(run, system)
    if model.system.translation is None:
        raise InputError(
            f"{model.system.name}: expected a body that moves through space, such as kr.Kirchhoff or kr.Clebsch, got "
            "one that only rotates."
        )
    rows = parts_of(run, model, _matrices(run, model))
    count, lanes = rows[0].shape[:2]
    h, x = np.repeat(np.diff(run["time"].values), lanes), np.zeros((count * lanes, model.n))
    begin, following = ([v[cut].reshape(-1, *v.shape[2:]) for v in rows] for cut in (slice(-1), slice(1, None)))
    for first in range(0, len(h), ROWS_AT_ONCE):
        piece = slice(first, min(first + ROWS_AT_ONCE, len(h)))
        carry = Carrier(model, np.arange(len(h))[piece] % lanes, oriented=True, moving=True)
        left, right = (tuple(v[piece] for v in ends) for ends in (begin, following))
        state = (np.zeros((len(h[piece]), model.n)), *after_samples(model, left, right))
        x[lanes:][piece] = carry(state, h[piece], right)[0]
    x = np.cumsum(x.reshape(count, lanes, model.n), 0)
    if model.system.perturbation is None:
        x = _by_momenta(rows[:3], x)
    x = x + (0 if start is None else _start(start, x.shape[1:]))
    lead, coords = rows_of(run_of_user)
    attrs = {"long_name": "position in space"} | ({"units": "m"} if is_in_si(run_of_user) else {})
    return xr.DataArray(x if "lane" in run.dims else x[:, 0], coords, (*lead, "axis"), "x", attrs)


def _by_momenta(rows: tuple[Array, ...], x: Array) -> Array:
    """x with the part across p = g P from m - x ^ p = const, m = g M g^T: x |p|^2 = (m - m_0) p + p <x, p>."""
    M, P, g = rows
    m, p = g @ M @ g.mT, algebra.act(g[0], P[0])
    square = algebra.dot(p, p)[..., None]
    with np.errstate(all="ignore"):
        position = (algebra.act(m - m[0], p + 0 * x) + p * algebra.dot(x, p + 0 * x)[..., None]) / square
    return np.where(square > 0, position, x)


def _matrices(run: xr.Dataset, model: Model) -> Array:
    """The orientations as matrices (time, [lane], n, n).  Raises `InputError` if there are none."""
    if model.n == 3 or ORIENTATION not in run:
        return np.asarray(algebra.rotation_matrix(orientation_of(run)))
    return np.asarray(run[ORIENTATION].values, dtype=np.float64)


def _start(value: Any, shape: tuple[int, ...]) -> Array:
    with contextlib.suppress(ValueError):
        start = np.broadcast_to(algebra.floats(value), shape)
        if np.isfinite(start).all():
            return start
    raise InputError(f"start: expected {shape[-1]} values, finite, got {shown(value)}.")


@explained
def pointing(run: xr.Dataset, *, frame: str = "orbit", axis: Any = None, target: Any = "nadir") -> xr.Dataset:
    """Pitch, roll and yaw of a satellite, and the angle between an axis of the body and its target, in rad.

    frame    "orbit": against up, ahead and the normal of the orbit, the angles of `Satellite.angles`, 0 in the stable
             attitude under gravity;  "lvlh", "inertial" or "ground": of the axes in which the body was given,
             R_3(yaw) R_2(pitch) R_1(roll) against ahead, right and down, against space, or against north, east and down
             at the point below
    axis     (3,) along the axes of the body; by default the axis that points down at zero angles of "orbit"
    target   "nadir", "velocity", "sun", or a direction (3,) in space

    Returns a Dataset (time) or (time, lane).  Raises `InputError` for any other run than of a satellite with its
    orientation, and for the Sun if the satellite has no sunlight.
    """
    angles = angles_of(a_run(run, "system"), frame)
    values = {name: (value, f"{name} against {FRAMES[frame]}") for name, value in angles._asdict().items()}
    aim = target if isinstance(target, str) else shown(target)
    values["error"] = pointing_error(run, axis, target), f"angle of the axis to {aim}"
    dims, coords = rows_of(run)
    data = {name: (dims, value, {"long_name": text, "units": "rad"}) for name, (value, text) in values.items()}
    return xr.Dataset(data, coords, {"title": run.attrs.get("title", "")})
