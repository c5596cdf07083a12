"""Vectors of a run: the vertical, the axis, the orientation.  Read from the record, never from a name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.files import read_values
from kreisel.method.observing import ORIENTATION
from kreisel.record.body import Body, model_of
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.runs.in_si import in_state_form
from kreisel.runs.operations import require_operations
from kreisel.runs.run_record import RunRecord, a_run, frame_of

if TYPE_CHECKING:
    import xarray as xr


CASIMIR = 1e-8  # largest relative distance of Casimirs from the Casimirs of the state
SAME = 1e-9  # relative: parameters of one body
UNIT = 1e-6  # largest distance of the length of a quaternion from 1


def fixed_vector(model: Model, where: str) -> Array | None:
    """The parameter that rests in "space" or in the "body" (`Parameter.fixed`), or None."""
    letters = [p.letter for p in model.system.parameters if p.fixed == where]
    return np.asarray(model.params[letters[0]], dtype=np.float64) if letters else None


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
    """Raises `InputError` for a run of a body whose parameters are not `parameters`, or vary in a sweep."""
    record = RunRecord.from_attrs(run.attrs)
    result = {} if "parameters" not in run.attrs or record.is_own else record.model.params
    varied = [k for k in parameters for name in run.coords if f"{name}[".startswith(f"system.{k}[")]

    def alike(x: Array, y: Any) -> bool:
        fits = np.ndim(x) < 1 or np.ndim(y) < 1 or np.shape(x)[-1] == np.shape(y)[-1]
        return fits and np.allclose(x, y, SAME, 0.0)

    others = [k for k in parameters if k in result and not alike(result[k], parameters[k])]
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
