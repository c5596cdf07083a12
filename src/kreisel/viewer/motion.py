"""Quantities of the motion of a satellite, for its figure and its page, and the unit of the axis of time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import brief, shown
from kreisel.forces.kicks import WHEELS
from kreisel.runs.geometry import velocity_of
from kreisel.runs.orbits import angles_of, pointing_error, satellite_model, surroundings
from kreisel.runs.run_record import frame_of

if TYPE_CHECKING:
    import xarray as xr

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
    frame, unit = frame_of(run), run["time"].attrs.get("units")
    if unit != "s" and frame is None:
        return Clock("", 1.0)
    second = 1.0 if unit == "s" else 1 / frame.time_unit if frame is not None else 1.0
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


def panels_of(run: xr.Dataset, axis: Any = None, target: Any = "nadir") -> list[Panel]:
    """Pointing error, angles against the orbit, rates, and the momenta of wheels."""
    model, around = satellite_model(run), surroundings(run)
    angles = angles_of(run, around=around)
    aim = target if isinstance(target, str) else brief(shown(target), LONGEST)
    subject = "axis" if axis is None else f"axis {brief(shown(axis), LONGEST)}"
    error = np.rad2deg(pointing_error(run, axis, target, around))[..., None]
    omega = algebra.axial(velocity_of(run, model))
    omega = omega if (frame := frame_of(run)) is None else frame.vectors(omega)  # along the user's axes
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


def shadows_of(run: xr.Dataset) -> list[tuple[float, float]]:
    """First and last times of the rows in each shadow, for a single satellite whose Sun is known."""
    light = surroundings(run).light
    if light is None or light.ndim > 1:
        return []
    edges = np.diff(np.concatenate([[0], (light < 0.5).astype(int), [0]]))
    time = np.asarray(run["time"].values, dtype=np.float64)
    begin, end = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [(float(time[a]), float(time[b])) for a, b in zip(begin, end, strict=True)]
