"""Vectors of a run: the vertical, the axis, the orientation; of a satellite its orbit, its surroundings and its angles.

All is read from the record, never from a name.  Space of a satellite is the frame of the elements of the orbit, whose
third axis is the pole of the primary.  `presented` is a run as its user receives it: of a body in SI.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies import find
from kreisel.errors import InputError, hint, require_one_of, shown
from kreisel.files import parsed, read_values
from kreisel.method.scheme import ORIENTATION
from kreisel.record.body import Body, model_of
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.record.perturbation import FIELDS
from kreisel.runs.in_si import COMPONENT, in_si, in_state_form
from kreisel.runs.operations import require_operations
from kreisel.runs.run_record import RunRecord, a_run, frame_of, lanes_of

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.record.perturbation import Force, Perturbation


CASIMIR = 1e-8  # largest relative distance of Casimirs from the Casimirs of the state
SAME = 1e-9  # relative: parameters of one body
Surroundings = dict[str, Array]  # `FIELDS` of rows: vectors (time, [lane,] 3) in space, scalars (time, [lane])
UNIT = 1e-6  # largest distance of the length of a quaternion from 1


def fixed_vector(model: Model, where: str) -> Array | None:
    """The parameter that rests in "space" or in the "body" (`Parameter.fixed`), or None."""
    letters = [p.letter for p in model.system.parameters if p.fixed == where]
    return np.asarray(model.params[letters[0]], dtype=np.float64) if letters else None


def fixed_in(run: xr.Dataset, where: str) -> Array | None:
    """The `fixed_vector` of a run of one trajectory; of a user-defined system by its attributes."""
    record = RunRecord.from_attrs(run.attrs)
    if not record.is_own:
        return fixed_vector(model_for(run, None), where)
    places = json.loads(record.fixed or "{}")
    letter = next((letter for letter, place in places.items() if place == where), None)
    if letter is None:
        return None
    value = np.asarray(json.loads(record.parameters)[letter], dtype=np.float64)
    return value[int(run["lane"])] if value.ndim > 1 and "lane" in run.coords else value


def components(run: xr.Dataset, model: Model) -> tuple[Array, ...]:
    """The state of every row in the order of the record; skew matrices (..., n, n), batch axes (time, lane)."""
    out, run = [], in_state_form(run)
    for letter, kind in model.system.space.components:
        if letter not in run:
            raise InputError(f"The run lacks {letter} of its state. Give the run as kr.simulate returned it.")
        value = np.asarray(run[letter].values, dtype=np.float64)
        value = algebra.KINDS[kind].from_user(value, model.n)
        inner = value.shape[1 + ("lane" in run[letter].dims) :]
        expected = algebra.KINDS[kind].shape(model.n)
        if inner != expected:
            raise InputError(
                f"expected a run with n = {model.n}, {letter} of the shape {expected} at each time, got {inner}. Give "
                "the run as kr.simulate returned it, and the system of it."
            )
        out.append(value)
    return tuple(out)


def model_for(run: xr.Dataset, system: Model | Body | None) -> Model:
    """The model of a run, for its lanes; required for a user-defined system.

    Raises `InputError`, also if the Casimirs of the run differ from those of its first or last state.
    """
    run, system = in_state_form(run), model_of(system)
    record = RunRecord.of(run, "system")
    if system is None:
        if record.is_own:
            raise InputError(f"{record.system} is a user-defined system: give it as system=...")
        system = record.model
    if not isinstance(system, Model) or system.system.name != record.system:
        raise InputError(f"The run is of {record.system}, got {shown(system)} as its system.")
    if record.system_sha256 is not None:
        require_operations(system, record.system_sha256)
    n = run.attrs.get("n", system.n)
    if n != system.n:
        raise InputError(f"expected the system of the run, with n = {n}, got {shown(system)}, with n = {system.n}.")
    lanes = np.asarray(run["lane"].values if "lane" in run.coords else 0.5)
    if system.batch and not (lanes.dtype.kind in "iu" and ((lanes >= 0) & (lanes < system.batch[0])).all()):
        raise InputError(
            f"expected a run of some lanes of its system, which has {system.batch[0]}, got {shown(lanes)} as lanes. "
            "Give the run as kr.simulate returned it, and the system of it."
        )
    model = system.lanes(lanes)
    casimirs, name = model.system.space.casimirs, "casimir"
    if casimirs is None or name not in run or run.attrs.get("engine") == "cuda-float32" or "event" in run.dims:
        return model
    ends = run.isel(time=[0, -1])
    stored, attrs = np.asarray(read_values(ends[name])), run[name].attrs
    with np.errstate(all="ignore"):
        values = np.asarray(model.call(casimirs, *components(ends, model)))
        sizes = [abs(values), *(attrs.get(k, 0.0) for k in ("evaluation_scale", "roundoff_scale"))]
        scale = max(float(np.max(size, initial=0.0)) for size in sizes)
        good = stored.size == values.size and (abs(stored.reshape(values.shape) - values) <= CASIMIR * scale).all()
    if not good and np.isfinite(stored).all():
        raise InputError(
            "expected a run whose Casimirs belong to its state, got others. Usual cause: arithmetic on the run, "
            "which changes its values and keeps its attributes; use the variables, such as 2 * run.energy."
        )
    return model


def require_unchanged(run: xr.Dataset) -> None:
    """Raises `InputError` for a changed run, for example 2 * run, whose attributes xarray keeps."""
    run = in_state_form(run)
    record = RunRecord.from_attrs(run.attrs)
    parameters = {"system", "parameters"} <= run.attrs.keys() and not record.is_own
    if parameters and "time" in run.dims and not record.missing_from(run):
        model_for(run, None)


def require_of_body(run: xr.Dataset, parameters: Mapping[str, Any]) -> None:
    """Raises `InputError` for a run of a body whose parameters are not `parameters`, or vary between its lanes."""
    record = RunRecord.from_attrs(run.attrs)
    stored = {} if "parameters" not in run.attrs or record.is_own else record.model.params
    lanes = lanes_of(run, record.body_frame) if "lane" in run.coords else slice(None)
    varied = [k for k in parameters for name in run.coords if f"{name}[".startswith(f"system.{k}[")]

    def alike(x: Array, y: Any) -> bool:
        x = x[lanes] if x.ndim > np.ndim(y) else x
        fits = np.ndim(x) < 1 or np.ndim(y) < 1 or np.shape(x)[-1] == np.shape(y)[-1]
        return fits and np.allclose(x, y, SAME, 0.0)

    others = [k for k in parameters if k in stored and not alike(stored[k], parameters[k])]
    if varied or others:
        raise InputError(
            f"expected a run of this body, got one with another {(varied + others)[0]}. Usual cause: a run of another "
            "body or orbit, or lanes of several: read each with its body."
        )


def is_upright(model: Model) -> bool:
    """Whether the system has a vertical and an axis: a top with n = 3, under gravity."""
    fixed = fixed_vector(model, "space" if model.system.frame is Frame.REST else "body")
    return model.n == 3 and fixed is not None and bool(fixed.any())


def vertical_and_axis(model: Model, carried: Array) -> tuple[Array, Array]:
    """Unit vectors of the vertical and of the axis (..., 3), both in the frame of the state.

    Raises `InputError` if n is not 3 or the system has no vertical and axis: a body in a fluid, a particle.
    """
    space = model.system.frame is Frame.REST
    fixed = fixed_vector(model, "space" if space else "body")
    if model.n != 3 or fixed is None:
        raise InputError(
            f"{model.system.name} with n = {model.n} has no vertical and axis; a top with n = 3 was expected "
            "(kr.LagrangeTop, kr.LagrangeTopMoving, kr.SymmetricTop, kr.HeavyTop)."
        )
    if not fixed.any():
        raise InputError("Without gravity or a lever the vertical or the axis is undefined: a parameter is 0.")
    pair = (fixed, carried) if space else (carried, fixed)
    with np.errstate(all="ignore"):
        up, axis = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in np.broadcast_arrays(*pair))
    if not (up.any(-1) & axis.any(-1) & np.isfinite(up).all(-1) & np.isfinite(axis).all(-1)).all():
        letter = model.system.space.letters[model.system.space.leading]
        raise InputError(
            f"expected {letter} and the parameter that it is compared with of a length that a double can hold, other "
            "than 0, got others. Usual cause: other units, or a run whose values were changed."
        )
    return up, axis


def orientation_of(run: xr.Dataset) -> Array:
    """The unit quaternions (..., 4) of a run, body to space.  Raises `InputError` if it has none, or for n > 3."""
    run = in_state_form(a_run(run, rows=False))
    if "q1" in run:
        raise InputError(
            "expected a run of one body, got one of several. attitude_1, attitude_2 are theirs; their light is "
            "kr.analysis.brightness(shape) of vectors along their axes."
        )
    if ORIENTATION not in run or run[ORIENTATION].shape[-1:] != (4,):
        raise InputError(
            "The run carries no orientation for n = 3. Run it again with orientation=(1, 0, 0, 0), or in the TOML file "
            "orientation = [1, 0, 0, 0] under [state]."
        )
    q = np.asarray(run[ORIENTATION].values, dtype=np.float64)
    with np.errstate(all="ignore"):
        off = abs(np.linalg.norm(q, axis=-1) - 1)
    if not (off < UNIT).all():
        raise InputError("expected unit quaternions (w, x, y, z) as the orientation, got some of other lengths.")
    return q


def attitude_of(run: xr.Dataset) -> Array:
    """The unit quaternions (..., 4) of the user's axes of the body, body to space: `orientation_of`, rotated.

    For a run of a body of `kr.physical`; for other systems, and `kr.units.measured`, the orientation itself.
    """
    run = in_state_form(run)
    q, frame = orientation_of(run), frame_of(run)
    if not frame:
        return q
    q = frame.attitude(q)
    return continued(q if run[ORIENTATION].dims[0] == "time" else q[None]).reshape(q.shape)


def continued(q: Array) -> Array:
    """Unit quaternions (time, ..., 4): q or -q, the nearer to the row before; w >= 0 in the first row."""
    return algebra.continued(q * np.where(q[:1, ..., :1] < 0, -1.0, 1.0))


def velocity_of(run: xr.Dataset, model: Model) -> Array:
    """The angular velocity of every row, skew, in the frame, along the axes and in the unit of time of the state."""
    return np.asarray(model.call(model.system.velocity, *components(run, model)))


def to_third_axis(v: Array) -> Array:
    """The least rotation (3, 3) that maps the unit vector v (3,) to (0, 0, 1)."""
    from scipy.spatial.transform import Rotation

    x, y, z = (float(c) for c in v)
    sine = np.hypot(x, y)
    if sine == 0:
        return np.eye(3) if z > 0 else np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(np.arctan2(sine, z) / sine * np.array([y, -x, 0.0])).as_matrix()


# -- satellites --------------------------------------------------------------------------------------


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
        lane = "lanes of a sweep, which lack their orbits: simulate a lane by kr.simulate"
        got = lane if "kreisel_sweep" in run.attrs else f"one of {shown(record.system)}"
        raise InputError(f"expected the run of a satellite, kr.physical.Satellite, got {got}.")
    system = find("satellite")
    letters = [p.letter for p in system.parameters]
    model = Model(system, {k: v for k, v in parameters.items() if k in letters}, record.body_frame)
    return model.lanes(lanes_of(run, record.body_frame)) if model.batch and "lane" in run.coords else model


def surroundings_at(model: Model, time: Array, lanes: int = 1) -> Surroundings:
    """Orbit and environment of a satellite at times (rows,) in the unit of its model: (rows, lanes, ...) by name."""
    force = cast("Force", cast("Perturbation", model.system.perturbation).environment)
    parameters, rows = {name: np.asarray(model.constants[name]) for name in force.parameters}, []
    for lane in range(model.batch[0] if model.batch else 1):
        values = [value[lane] if value.ndim > model.axes[name] else value for name, value in parameters.items()]
        rows.append(force.function(time, **force.named(values)))
    rows = rows if model.batch else rows * lanes  # lanes on one orbit
    return {
        name: np.stack([np.broadcast_to(row[name], (*field.shape, len(time))).T for row in rows], 1)
        for name, field in FIELDS.items()
    }


def surroundings(run: xr.Dataset) -> Surroundings:
    """Orbit and environment at each row, without `sun` and `light` if the run does not state a Sun.

    Raises `InputError` for any other run than of a satellite.
    """
    model = satellite_model(run)
    result = surroundings_at(model, np.asarray(run["time"].values, dtype=np.float64), run.sizes.get("lane", 1))
    sunny = np.any(model.constants["pressure"]) or np.any(model.constants["solar"])
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
