"""kr.analysis: the angular velocity of a body, and the path of one that moves through space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.analysis.carrying import Carrier
from kreisel.analysis.events import rows_of
from kreisel.errors import InputError, explained, shown
from kreisel.method.observing import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.runs.geometry import model_for, orientation_of, velocity_of
from kreisel.runs.run_record import RunRecord, a_run

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

BODY, SPACE = "body", "space"
ROWS_AT_ONCE = 20_000


@explained
def angular_velocity(run: xr.Dataset, system: Model | None = None, *, frame: str = BODY) -> xr.DataArray:
    """The angular velocity of every row, (time, axis) or (time, lane, axis) for n = 3, else skew (..., n, n).

    system   the model, for a system of your own
    frame    "body": Omega, along the axes of the body, g' = g Omega;  "space": omega = g Omega g^T

    For a body of `kr.physical`, which the run knows, in rad/s along the axes in which the body was given; for other
    systems in the inverse unit of time of the run: the attribute `units` of the result says which.  The frame that the
    state is not in needs a run with an orientation.  Raises `InputError` where it has none, and for systems without a
    body that turns.
    """
    import xarray as xr

    model = model_for(a_run(run), system)
    if frame not in (BODY, SPACE):
        raise InputError(f"frame: expected 'body' or 'space', got {shown(frame)}.")
    if model.system.velocity is None:
        raise InputError(f"{model.system.name}: expected a system of a body that turns, got one without.")
    found, known = velocity_of(run, model), model.body_frame or RunRecord.from_attrs(run.attrs).body_frame
    if (model.system.frame is Frame.REST) == (frame == BODY):
        g = _matrices(run, model)
        found = g.mT @ found @ g if frame == BODY else g @ found @ g.mT
    values, axes = (algebra.axial(found), ("axis",)) if model.n == 3 else (found, ("row", "column"))
    if known is not None:
        values = (known.vectors(values) if frame == BODY else values) / known.time_unit
    lead = ("time", *(("lane",) if "lane" in run.dims else ()))
    coords = {name: run[name] for name in lead if name in run.coords}
    unit = "1" if known is None else "rad/s"
    meaning = "Omega, along the axes of the body" if frame == BODY else "omega, in space"
    return xr.DataArray(values, coords, (*lead, *axes), "angular_velocity", {"long_name": meaning, "units": unit})


@explained
def path(run: xr.Dataset, system: Model | None = None, *, start: ArrayLike | None = None) -> xr.DataArray:
    """The position x of a body in space at every row, (time, axis) or (time, lane, axis): x' = g U, U = dH/dP.

    system   the model, for a system of your own
    start    x at the first row, (n,) or (lane, n); default: 0

    For bodies in a fluid (Kirchhoff's equations), whose P is their momentum; the run needs an orientation.  From row to
    row x is carried with the state by the flow itself, to round-off, by extrapolation of order 16 in steps that suit
    each row; the state that it ends at is compared with the next row.  Without other forces the momenta in space
    p = g P and g M g^T - x ^ p are constant: they give the part of x across p, without a sum.
    In the unit of length of P U = energy.  Raises `InputError` for other systems, without an orientation, and if the
    flow does not lead from a row to the next one.
    """
    import xarray as xr

    model = model_for(a_run(run), system)
    if model.system.translation is None:
        raise InputError(
            f"{model.system.name}: expected a body that moves through space, such as kr.Kirchhoff or kr.Clebsch, got "
            "one that only turns."
        )
    lanes = "lane" in run.dims
    rows = rows_of(run, model, _matrices(run, model))
    time = np.asarray(run["time"].values, dtype=np.float64)
    x = np.zeros((len(time), rows[0].shape[1], model.n))
    x[1:] = np.cumsum(_displacements(model, rows, np.diff(time)), 0)
    if model.system.perturbation is None:
        x = _by_momenta(rows[:3], x)
    x = x + (0 if start is None else _start(start, x.shape[1:]))
    lead = ("time", "lane") if lanes else ("time",)
    coords = {name: run[name] for name in lead if name in run.coords}
    return xr.DataArray(x if lanes else x[:, 0], coords, (*lead, "axis"), "x", {"long_name": "position in space"})


def _displacements(model: Model, rows: tuple[Array, ...], steps: Array) -> Array:
    """x at the next row less x at this one, (time - 1, lane, n)."""
    lanes = rows[0].shape[1]
    h = np.repeat(steps, lanes)
    flat, following = ([v[cut].reshape(-1, *v.shape[2:]) for v in rows] for cut in (slice(-1), slice(1, None)))
    batched = {k: v for k, v in model.constants.items() if model.batch and v.ndim > model.axes[k]}
    out = np.empty((len(h), model.n))
    for first in range(0, len(h), ROWS_AT_ONCE):
        part = slice(first, first + ROWS_AT_ONCE)
        lane = np.arange(len(h))[part] % lanes
        z = (np.zeros((len(lane), model.n)), *(v[part] for v in flat))
        carry = Carrier(model, {k: v[lane] for k, v in batched.items()}, moving=True)
        out[part] = carry(z, h[part], tuple(v[part] for v in following))[0]
    return out.reshape(len(steps), lanes, model.n)


def _by_momenta(rows: tuple[Array, ...], x: Array) -> Array:
    """x with the part across p = g P from m - x ^ p = const, m = g M g^T: x |p|^2 = (m - m_0) p + p <x, p>."""
    M, P, g = rows
    m, p = g @ M @ g.mT, algebra.act(g[0], P[0])
    square = algebra.dot(p, p)[..., None]
    with np.errstate(all="ignore"):
        found = (algebra.act(m - m[0], p + 0 * x) + p * algebra.dot(x, p + 0 * x)[..., None]) / square
    return np.where(square > 0, found, x)


def _matrices(run: xr.Dataset, model: Model) -> Array:
    """The orientations as matrices (time, [lane], n, n).  Raises `InputError` without any."""
    if model.n == 3 or ORIENTATION not in run:
        return np.asarray(algebra.rotation_matrix(orientation_of(run)))
    return np.asarray(run[ORIENTATION].values, dtype=np.float64)


def _start(value: Any, shape: tuple[int, ...]) -> Array:
    try:
        start = np.broadcast_to(algebra.floats(value), shape)
    except ValueError:
        raise InputError(f"start: expected {shape[-1]} numbers, got {shown(value)}.") from None
    if not np.isfinite(start).all():
        raise InputError(f"start: expected finite numbers, got {shown(value)}.")
    return start
