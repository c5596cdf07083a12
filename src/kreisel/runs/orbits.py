"""Runs as their user receives them: of a body in SI, of a satellite with its orbit, its surroundings and its angles.

Space is the frame of the elements of the orbit, whose third axis is the pole of the primary.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies import find
from kreisel.errors import InputError, hint, require_one_of, shown
from kreisel.files import parsed
from kreisel.method.observing import ORIENTATION
from kreisel.record.model import Model
from kreisel.record.perturbation import FIELDS
from kreisel.runs.geometry import attitude_of
from kreisel.runs.in_si import COMPONENT, in_si
from kreisel.runs.run_record import RunRecord, frame_of, lanes_of

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.record.perturbation import Force, Perturbation


Surroundings = dict[str, Array]  # `FIELDS` of rows: vectors (time, [lane,] 3) in space, scalars (time, [lane])


class Angles(NamedTuple):
    """Rotations about the axes of a frame, rad, (time, [lane])."""

    pitch: Array
    roll: Array
    yaw: Array


def parameters_of(run: xr.Dataset) -> dict[str, Any]:
    """Parameters of the satellite of a run, with or without a controller; empty for another run."""
    if "parameters" not in run.attrs:
        return {}
    parameters = parsed(run.attrs["parameters"], "The attribute parameters")
    return parameters if isinstance(parameters, dict) and {"semi_major_axis", "moments"} <= parameters.keys() else {}


def of_satellite(run: xr.Dataset) -> bool:
    """Whether a Dataset is a run of a satellite, whose record has its orbit."""
    return bool(parameters_of(run))


def satellite_model(run: xr.Dataset) -> Model:
    """The system "satellite" with the parameters of a run, for its lanes: without wheels and controllers.

    Raises `InputError` for any other run than of a satellite.
    """
    record, parameters = RunRecord.of(run, "system"), parameters_of(run)
    if not parameters:
        raise InputError(f"expected the run of a satellite, kr.physical.Satellite, got one of {shown(record.system)}.")
    system = find("satellite")
    letters = [p.letter for p in system.parameters]
    model = Model(system, {k: v for k, v in parameters.items() if k in letters}, record.body_frame)
    return model.lanes(lanes_of(run, record.body_frame)) if model.batch and "lane" in run.coords else model


def surroundings(run: xr.Dataset) -> Surroundings:
    """Orbit and environment at each row, without `sun` and `light` if the run does not state a Sun.

    Raises `InputError` for any other run than of a satellite.
    """
    model = satellite_model(run)
    force = cast("Force", cast("Perturbation", model.system.perturbation).environment)
    parameters = {name: np.asarray(model.constants[name]) for name in force.parameters}
    time, rows = np.asarray(run["time"].values, dtype=np.float64), []
    for lane in range(model.batch[0] if model.batch else 1):
        values = [value[lane] if value.ndim > model.axes[name] else value for name, value in parameters.items()]
        rows.append(force.function(time, **force.named(values)))
    rows = rows if model.batch else rows * run.sizes.get("lane", 1)  # lanes on one orbit
    result = {
        name: np.stack([np.broadcast_to(row[name], (*field.shape, len(time))).T for row in rows], 1)
        for name, field in FIELDS.items()
    }
    sunny = np.any(model.constants["pressure"]) or np.any(parameters["solar"])
    result = result if sunny else {k: v for k, v in result.items() if k not in ("sun", "light")}
    return result if "lane" in run.dims else {name: value[:, 0] for name, value in result.items()}


def environment_of(run: xr.Dataset) -> xr.Dataset:
    """`surroundings` as variables with units and names, along the times and lanes of the run."""
    import xarray as xr

    out = xr.Dataset(coords={name: run[name] for name in ("time", "lane") if name in run.coords})
    for name, value in surroundings(run).items():
        _, unit, shape, meaning = FIELDS[name]
        dims = (*("time", "lane")[: value.ndim - len(shape)], *(COMPONENT,) * len(shape))
        out[name] = dims, value, {"units": unit, "long_name": meaning}
    return out


# -- frames, as columns in space -------------------------------------------------------------------


def orbit_frame(r: Array, v: Array) -> Array:
    """The axes of the orbit (..., 3, 3): up, ahead, and the normal of the orbit."""
    up = r / np.linalg.norm(r, axis=-1, keepdims=True)
    normal = np.cross(r, v)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([up, np.cross(normal, up), normal], -1)


def ground_frame(r: Array) -> Array:
    """North, east and down (..., 3, 3) at the point below the satellite, on a sphere; NaN above a pole."""
    down = -r / np.linalg.norm(r, axis=-1, keepdims=True)
    east = np.cross(np.array([0.0, 0.0, 1.0]), r)
    with np.errstate(invalid="ignore"):
        east = east / np.linalg.norm(east, axis=-1, keepdims=True)
    return np.stack([np.cross(east, down), east, down], -1)


def axes_of_angles(moments: Array) -> Array:
    """Up, ahead and the normal of the orbit at zero angles along the principal axes, as columns: right-handed.

    They are the axes of the least of the moments (..., 3), the middle and the largest.
    """
    axes = np.eye(3)[np.argsort(moments, axis=-1, kind="stable")].swapaxes(-1, -2)
    axes[..., 1] *= np.linalg.det(axes)[..., None]
    return axes


def axis_of_pointing(run: xr.Dataset, axis: Any = None) -> Array:
    """A unit vector ([lane,] 3) along the axes of the body; by default the axis that points down at zero angles.

    Raises `InputError` for anything but three finite entries that are not all 0.
    """
    if axis is None:
        return -np.asarray(
            frame_of(run).axes @ axes_of_angles(satellite_model(run).params["moments"])[..., 0][..., None]
        )[..., 0]
    return _direction(axis, "axis")


def _direction(value: Any, name: str) -> Array:
    vector = algebra.floats(value)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"{name}: expected a vector (3,) other than 0, got {shown(value)}.")
    return np.asarray(vector / np.linalg.norm(vector))


TARGETS = ("nadir", "velocity", "sun")


def directions(around: Surroundings) -> dict[str, Array]:
    """Unit vectors (time, [lane,] 3) in space to the targets that are known at each row."""
    result = {"nadir": -around["position"]} | {k: around[k] for k in ("velocity", "sun", "field") if k in around}
    return {k: v / np.linalg.norm(v, axis=-1, keepdims=True) for k, v in result.items() if v.any()}


def target_of(around: Surroundings, target: Any) -> Array:
    """Unit vectors (time, [lane,] 3) in space to a target: one of `TARGETS`, or a direction at rest.

    Raises `InputError` for another target, and for the Sun if the run does not state its direction.
    """
    if not isinstance(target, str):
        return np.broadcast_to(_direction(target, "target"), around["position"].shape)
    if target not in TARGETS:
        raise InputError(
            f"target: expected {', '.join(TARGETS)} or a direction in space, got {shown(target)}."
            f"{hint(target, TARGETS)}"
        )
    if target == "sun" and "sun" not in around:
        raise InputError("target='sun': expected a satellite in sunlight, Satellite(light=..., sun=...), got none.")
    return directions(around)[target]


def pointing_error(
    run: xr.Dataset, axis: Any = None, target: Any = "nadir", around: Surroundings | None = None
) -> Array:
    """The angle between an axis of the body and its target at each row, rad, (time, [lane])."""
    around, g = around or surroundings(run), algebra.rotation_matrix(attitude_of(run))
    pointed, wanted = algebra.act(g, axis_of_pointing(run, axis)), _by_lane(target_of(around, target), g.ndim - 1)
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(pointed, wanted), axis=-1), algebra.dot(pointed, wanted)))


FRAMES = {
    "orbit": "up, ahead and normal of the orbit",
    "lvlh": "ahead, right and down of the orbit",
    "inertial": "space",
    "ground": "north, east and down at the point below",
}


def angles_of(run: xr.Dataset, frame: str = "orbit", around: Surroundings | None = None) -> Angles:
    """Pitch, roll and yaw of a satellite at each row, from -pi to pi.

    frame   "orbit": R_3(pitch) R_2(roll) R_1(yaw) of the principal axes against up, ahead and normal, as
            `Satellite.angles`; "lvlh", "inertial" or "ground": R_3(yaw) R_2(pitch) R_1(roll) of the axes in which the
            body was given, against ahead, right and down, against space, or against north, east and down

    Raises `InputError` for another frame, and for any other run than of a satellite with its orientation.
    """
    require_one_of(FRAMES, frame, "angles")
    model, g = satellite_model(run), algebra.rotation_matrix(attitude_of(run))
    around = around or surroundings(run)
    place = around["position"], around["velocity"]
    if frame == "orbit":
        body = frame_of(run).axes @ axes_of_angles(model.params["moments"])
        return Angles(*tait_bryan(_by_lane(orbit_frame(*place), g.ndim).mT @ g @ body))
    if frame == "ground":
        g = _by_lane(ground_frame(place[0]), g.ndim).mT @ g
    elif frame == "lvlh":
        up, ahead, normal = np.moveaxis(orbit_frame(*place), -1, 0)
        g = _by_lane(np.stack([ahead, -normal, -up], -1), g.ndim).mT @ g
    yaw, pitch, roll = tait_bryan(g)
    return Angles(pitch, roll, yaw)


def _by_lane(values: Array, ndim: int) -> Array:
    """Values (time, ...) of one orbit with an axis of lanes, if others have one."""
    return values if values.ndim == ndim else values[:, None]


def tait_bryan(R: Array) -> tuple[Array, Array, Array]:
    """The angles about the third, second and first axis: R = R_3 R_2 R_1."""
    middle = np.arcsin(np.clip(-R[..., 2, 0], -1, 1))
    return np.arctan2(R[..., 1, 0], R[..., 0, 0]), middle, np.arctan2(R[..., 2, 1], R[..., 2, 2])


# -- runs as their user receives them --------------------------------------------------------------

ANGLES = {
    "pitch": "pitch against the orbit: rotation about its normal",
    "roll": "roll against the orbit: rotation about the direction ahead",
    "yaw": "yaw against the orbit: rotation about the direction up",
    "pointing": "angle of the axis that points down at zero angles to the nadir",
}


def presented(run: xr.Dataset, model: Model | None = None) -> xr.Dataset:
    """A run as its user receives it: in SI if its subject was a body, else unchanged."""
    frame = model.body_frame if model is not None else RunRecord.from_attrs(run.attrs).body_frame
    if not frame.names:
        return run
    if frame.differs and "lane" not in run.coords:  # of a sweep
        run = run.assign_coords(lane=np.arange(run.sizes["lane"]))
    out = in_si(run, model)
    parameters = of_satellite(run) and "kreisel_sweep" not in run.attrs and "time" in run.dims and ORIENTATION in run
    return out.assign(_of_satellite(run)) if parameters else out


def _of_satellite(run: xr.Dataset) -> dict[str, xr.Variable]:
    """Orbit, surroundings and angles at each row, computed when they are read: a field has 195 terms a row."""
    import xarray as xr

    from kreisel.runs.lazy import lazy

    g, time, attrs, out = run.variables[ORIENTATION], run.variables["time"], dict(run.attrs), dict[str, xr.Variable]()
    lanes = {"lane": ("lane", np.asarray(run["lane"].values))} if "lane" in run.coords else {}

    def rows(time: Array, **data: Any) -> xr.Dataset:
        return xr.Dataset(data, {"time": ("time", time), **lanes}, attrs)

    def around(name: str, time: Array) -> Array:
        return surroundings(rows(time))[name]

    def angle(name: str, g: Array, time: Array) -> Array:
        turned = rows(time, **{ORIENTATION: (run[ORIENTATION].dims, g)})
        return pointing_error(turned) if name == "pointing" else getattr(angles_of(turned), name)

    for name, value in environment_of(rows(np.asarray(time[:1].values))).data_vars.items():
        shape = len(time), *value.shape[1:]
        out[str(name)] = lazy(value.dims, shape, [time], partial(around, str(name)), dict(value.attrs), True)
    for name, meaning in ANGLES.items():
        units = {"units": "rad", "long_name": meaning}
        out[name] = lazy(g.dims[:-1], g.shape[:-1], [g, time], partial(angle, name), units, True)
    return out
