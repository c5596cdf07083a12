"""kr.analysis.pointing: where a satellite points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kreisel.errors import explained, shown
from kreisel.runs.orbits import FRAMES, angles_of, pointing_error
from kreisel.runs.run_record import a_run

if TYPE_CHECKING:
    import xarray as xr


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
    import xarray as xr

    angles = angles_of(a_run(run, "system"), frame)
    dims = ("time", "lane") if "lane" in run.dims else ("time",)
    aim = target if isinstance(target, str) else shown(target)
    data = {
        name: (dims, value, {"long_name": f"{name} against {FRAMES[frame]}", "units": "rad"})
        for name, value in angles._asdict().items()
    }
    error = pointing_error(run, axis, target)
    data["error"] = (dims, error, {"long_name": f"angle of the axis to {aim}", "units": "rad"})
    return xr.Dataset(data, {k: run[k] for k in dims if k in run.coords}, {"title": run.attrs.get("title", "")})
