"""Runs as their user receives them: of a body in SI, of a satellite with its orbit, its surroundings and its angles."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from kreisel.algebra import Array
from kreisel.method.observing import ORIENTATION
from kreisel.record.model import Model
from kreisel.runs.in_si import COMPONENT, in_si
from kreisel.runs.orbits import VARIABLES, angles_of, environment_of, of_satellite, pointing_error
from kreisel.runs.run_record import RunRecord

if TYPE_CHECKING:
    import xarray as xr

ANGLES = {
    "pitch": "pitch against the orbit: rotation about its normal",
    "roll": "roll against the orbit: rotation about the direction ahead",
    "yaw": "yaw against the orbit: rotation about the direction up",
}
POINTING = "angle of the axis that points down at zero angles to the nadir"


def presented(run: xr.Dataset, model: Model | None = None) -> xr.Dataset:
    """A run as its user receives it: in SI if its subject was a body, else unchanged."""
    frame = model.body_frame if model is not None else RunRecord.from_attrs(run.attrs).body_frame
    if frame is None or not frame.names:
        return run
    if frame.differs and "lane" not in run.coords:  # of a sweep
        run = run.assign_coords(lane=np.arange(run.sizes["lane"]))
    out = in_si(run, model)
    known = of_satellite(run) and "kreisel_sweep" not in run.attrs and "time" in run.dims and ORIENTATION in run
    return out.assign(_of_satellite(run)) if known else out


def _of_satellite(run: xr.Dataset) -> dict[str, xr.Variable]:
    """Orbit, surroundings and angles at each row, computed when they are read: a field has 195 terms a row."""
    from kreisel.runs.lazy import lazy

    g, time = run.variables[ORIENTATION], run.variables["time"]
    lead, shape = g.dims[:-1], g.shape[:-1]
    lanes = np.asarray(run["lane"].values) if "lane" in run.coords else None
    rows = partial(_rows, dict(run.attrs), lanes)
    first = environment_of(rows(np.asarray(time[:1].values), np.asarray(g[:1].values)))
    out = {}
    for name in map(str, first.data_vars):
        unit, meaning, axes = VARIABLES[name]
        many = "lane" in first[name].dims
        dims = (*(lead if many else lead[:1]), *(COMPONENT for _ in axes))
        found = (*(shape if many else shape[:1]), *axes)
        attrs = {"units": unit, "long_name": meaning}
        out[name] = lazy(dims, found, [time], partial(_surroundings, rows, name, g[:1].values), attrs, 1)
    for name, meaning in ANGLES.items():
        out[name] = lazy(
            lead, shape, [g, time], partial(_angles, rows, name), {"units": "rad", "long_name": meaning}, 1
        )
    out["pointing"] = lazy(lead, shape, [g, time], partial(_pointing, rows), {"units": "rad", "long_name": POINTING}, 1)
    return out


def _rows(attrs: dict[str, object], lanes: Array | None, time: Array, g: Array) -> xr.Dataset:
    """A run with these times and orientations only."""
    import xarray as xr

    dims = ("time", "lane", "quaternion") if g.ndim > 2 else ("time", "quaternion")
    coords = {"time": ("time", time), **({} if lanes is None else {"lane": ("lane", lanes)})}
    return xr.Dataset({ORIENTATION: (dims, g)}, coords, attrs)


def _surroundings(rows: partial[xr.Dataset], name: str, g: Array, time: Array) -> Array:
    return np.asarray(environment_of(rows(time, np.broadcast_to(g, (len(time), *g.shape[1:]))))[name].values)


def _angles(rows: partial[xr.Dataset], name: str, g: Array, time: Array) -> Array:
    return np.asarray(getattr(angles_of(rows(time, g)), name))


def _pointing(rows: partial[xr.Dataset], g: Array, time: Array) -> Array:
    return pointing_error(rows(time, g))
