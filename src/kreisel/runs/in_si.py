"""Runs of bodies in SI, with names in words, and the form of the state that kernels, archives and laws have.

A body of `kr.physical` is simulated by a scaled system along its principal axes.  `in_si` presents such a run in SI,
along the axes in which the body was given; `in_state_form` is its inverse.  Both read archives lazily.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import wraps
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.random import GENERATOR
from kreisel.bodies import KNOWN
from kreisel.errors import InputError, RunError, doubt, shown
from kreisel.files import parsed
from kreisel.method.scheme import ORIENTATION
from kreisel.record.body import Body, as_body
from kreisel.record.contract import Frame
from kreisel.record.model import Model, State
from kreisel.record.perturbation import FIELDS
from kreisel.record.units import AXES, BODY, OF_SYSTEM, STATE, BodyFrame, Scale, scaling, unchanged
from kreisel.runs.run_record import CLOCKS, FORM, SI, RunRecord, frame_of, lanes_of
from kreisel.runs.settings import Event, NamedComponents, checked_events, initial_orientation, positive_number

if TYPE_CHECKING:
    import xarray as xr

COMPONENT = "xyz"  # the axis of the components of vectors, which a variable may not be named after
VELOCITY = "angular_velocity"
ADDED = (VELOCITY, *FIELDS, "pitch", "roll", "yaw", "pointing")  # variables of a run in SI that follow from others
INTERNAL = (GENERATOR, "begun")  # of controllers: coordinates of a run in SI, since nobody looks at them
SUMMARIES = ("drift", "extremes", "frequencies")  # kinds of variables of a sweep, such as M_max
SAME_ATTITUDE = 1e-6  # entries of a rotation matrix
SIZED = ("roundoff_scale", "evaluation_scale")  # attributes in the unit of their variable
QUANTITY = re.compile(r"\s*(\w+)(.*)", re.DOTALL)
COMPONENT_OF = re.compile(r"\s*(\w+)\s*\[\s*([012])\s*\]\s*")
MEANINGS = {
    "momentum": "angular momentum",
    "angular_momentum": "angular momentum of body and fluid about the reference point",
    "linear_momentum": "linear momentum of body and fluid",
    "axis": "axis of the body",
    "up": "upward vertical",
    "attitude": "attitude of the body, a unit quaternion (w, x, y, z), body to space",
    "position": "position of body 2 relative to body 1",
    "velocity": "velocity of body 2 relative to body 1",
    "third_position": "position of the third body relative to the barycentre of the others",
    "third_velocity": "velocity of the third body relative to the barycentre of the others",
} | {
    f"{name}_{i}": f"{text} of body {i}"
    for i in (1, 2)
    for name, text in (("momentum", "angular momentum"), ("attitude", "unit quaternion (w, x, y, z), body to space,"))
}


def is_in_si(run: Any) -> bool:
    """Whether a Dataset is a run of a body in SI."""
    return bool(getattr(run, "attrs", {}).get(FORM) == SI)


def frame_in_si(run: Any) -> BodyFrame:
    """The axes and units of a run in SI; `OF_SYSTEM` for others."""
    return frame_of(run) if is_in_si(run) else OF_SYSTEM


def names_of_state(run: xr.Dataset) -> list[str]:
    """The names of the components of the state in a run: letters, in SI words."""
    names, kinds = frame_in_si(run).names, RunRecord.from_attrs(run.attrs).kinds
    return [names.get(letter, letter) for letter in kinds]


def in_cf(model: Model, name: str) -> dict[str, Any]:
    """The attributes by which programs that know CF read SI from the values of a kernel: units and scale_factor.

    The energy of a symmetric top has none: a constant is missing in its Hamiltonian.
    """
    frame = model.body_frame
    if not frame.names or name not in frame.units:
        return {}
    if name in ENERGIES and model.system.spin is not None:
        return {}
    unit, size = frame.units[name]
    if np.ndim(size):
        return {}  # CF knows one factor
    return {"units": unit} | ({} if size == 1 else {"scale_factor": size})


def in_si(run: xr.Dataset, model: Model | None = None) -> xr.Dataset:
    """A run of a body in SI; `model`: of a user-defined system, else that of the attributes."""
    frame = frame_of(run)
    if not frame or is_in_si(run):
        return run
    _, _, kind = str(run.attrs.get("title", "")).rpartition(": ")  # the method, or the lanes of a sweep
    title = {"title": f"{frame.title}: {run.attrs.get('method', kind)}"} if frame.title else {}
    out = _converted(run, frame, forward=True).assign_attrs({FORM: SI, **title})
    model = _model_of(run, model)
    if model is None:
        return out
    out = out.assign(_with_spin(out, run, model, frame.size("energy") / 2))
    return out if model.system.velocity is None else out.assign({VELOCITY: _velocity(run, frame, model)})


def in_units(run: xr.Dataset, frame: BodyFrame) -> xr.Dataset:
    """A run of a scaled system in SI along the axes of its body, under its names, with Omega, or omega in space."""
    out = _converted(run, replace(frame, names={}), forward=True)
    model = None if RunRecord.from_attrs(run.attrs).is_own or "event" in run.dims else _model_of(run, None)
    if model is not None and model.system.velocity is not None:
        name = "Omega" if model.system.frame is Frame.MOVING else "omega"
        out = out.assign({name: _velocity(run, frame, model)})
    return out.rename({COMPONENT: "axis"}) if COMPONENT in out.dims else out


def _velocity(run: xr.Dataset, frame: BodyFrame, model: Model) -> xr.Variable:
    body = model.system.frame is Frame.MOVING

    def velocity(state: list[Array]) -> Array:
        omega = algebra.axial(model.call(model.system.velocity, *state))
        return (frame.vectors(omega) if body else omega) / frame.time_unit

    meaning = f"angular velocity, along the axes of {'the body' if body else 'space'}"
    attrs = {"long_name": meaning, "units": "rad/s"} | ({AXES: BODY} if body else {})
    return _of_rows(run, model, velocity, attrs, axes=(COMPONENT,))


def in_state_form(run: Any) -> Any:
    """A run with the letters, units and axes of the state; anything but a run in SI is returned unchanged."""
    if not is_in_si(run):
        return run
    frame = frame_of(run)
    if not frame:
        raise InputError("The run is damaged: it is in SI, and lacks the attribute body that describes its units.")
    out = _converted(run, frame, forward=False).drop_vars(ADDED, errors="ignore")
    out.attrs.pop(FORM)
    model = _model_of(out, None)
    return out if model is None else out.assign(_with_spin(out, out, model, -0.5))


def _converted(run: xr.Dataset, frame: BodyFrame, forward: bool) -> xr.Dataset:
    """The run in SI (forward), or in the form of its state."""
    import xarray as xr

    names = frame.names if forward else frame.letters
    axes = {"axis": COMPONENT} if forward else {COMPONENT: "axis"}
    data: dict[str, xr.Variable] = {}
    coords: dict[str, xr.Variable] = {}
    for name, variable in run.variables.items():
        base, _, suffix = str(name).rpartition("_") if variable.attrs.get("kind") in SUMMARIES else (str(name), "", "")
        letter, new = base if forward else names.get(base, base), names.get(base, base)
        unit, size = frame.units.get(letter, (variable.attrs.get("units", "1"), 1.0))
        unit, size = (unit, size) if suffix != "frequency" else ("rad/s", 1 / frame.time_unit)
        by = scaling(size if forward else 1 / size) if suffix else frame.change(letter, forward)
        out = variable.copy(deep=False) if by is unchanged else _rows(variable.dims, [variable], by, frame.differs)
        out.attrs = _attributes(variable.attrs, frame, letter, new, unit, size if forward else 1 / size, forward)
        if suffix and letter in (*frame.along, ORIENTATION) and frame.turned:
            # minima and maxima along the axes given do not follow from those along others
            meaning = str(out.attrs["long_name"]).replace("axes of the body", "body")
            out.attrs |= {AXES: STATE, "long_name": meaning.replace("the body", "the axes of the state")}
        if suffix and "letter_name" in out.attrs:
            out.attrs["long_name"] += f": {out.attrs['letter_name'].rpartition(': ')[2]}"  # greatest, least
        out.dims = tuple(axes.get(str(d), d) for d in out.dims)
        if name == "lane" and frame.lanes:
            ids = lanes_of(run, frame)
            out = xr.Variable(variable.dims, np.array(frame.lanes)[ids] if forward else ids, out.attrs)
        beside = forward if name in INTERNAL else name in run.coords
        (coords if beside else data)[f"{new}_{suffix}" if suffix else new] = out
    result = xr.Dataset(data, {k: v for k, v in coords.items() if k in run.xindexes}, dict(run.attrs))
    unindexed = {k: v for k, v in coords.items() if k not in run.xindexes}
    result = result.assign_coords(xr.Coordinates(unindexed, indexes={})) if unindexed else result
    factor, attrs = frame.time_unit if forward else 1 / frame.time_unit, run.attrs
    result.attrs |= {k: attrs[k] * factor for k in (*CLOCKS, "stopped") if attrs.get(k) is not None}
    if attrs.get("event_times") is not None:
        events = parsed(attrs["event_times"], "The attribute event_times")
        result.attrs["event_times"] = json.dumps([[time * factor, number] for time, number in events])
    if attrs.get("impulses") is not None:
        impulses = [
            frame.components(impulse, forward) for impulse in parsed(attrs["impulses"], "The attribute impulses")
        ]
        result.attrs["impulses"] = json.dumps(impulses, default=np.ndarray.tolist)
    return result


def _attributes(
    attrs: Mapping[str, Any], frame: BodyFrame, letter: str, name: str, unit: str, factor: Any, forward: bool
) -> dict[str, Any]:
    out = {k: v for k, v in attrs.items() if k not in (AXES, "scale_factor")}
    for key in SIZED:
        if key in out and np.any(factor != 1):
            out[key] = (np.asarray(out[key], dtype=np.float64) * factor).tolist()
    if not forward:
        if "letter_name" in out:
            out["long_name"] = out.pop("letter_name")
        return out | ({"units": "1"} | frame.attributes(letter) if letter in (*frame.units, *frame.along) else {})
    inside = letter in frame.along
    if name in MEANINGS and letter in frame.names:
        where = "" if name.startswith("attitude") else f", along the axes of {'the body' if inside else 'space'}"
        out |= {"letter_name": out.get("long_name", letter), "long_name": MEANINGS[name] + where}
    return out | {"units": unit} | ({AXES: BODY} if inside or letter == ORIENTATION else {})


def _rows(
    dims: Any, sources: list[xr.Variable], function: Callable[..., Array], by_lane: bool, attrs: Any = None
) -> xr.Variable:
    """A variable computed from others: at once if they are in memory, else when it is read."""
    import xarray as xr

    if all(getattr(variable, "_in_memory", True) for variable in sources):
        with np.errstate(all="ignore"):
            return xr.Variable(dims, function(*(np.asarray(variable.values) for variable in sources)), attrs)
    from kreisel.runs.lazy import lazy

    sizes = {**sources[0].sizes, COMPONENT: 3}
    return lazy(dims, tuple(sizes[d] for d in dims), sources, function, attrs, by_lane=by_lane)


def _model_of(run: xr.Dataset, model: Model | None) -> Model | None:
    """The model of the rows of a run, of user-defined forces its integrable part, which has the angular velocity.

    None if an archive does not hold it, if forces change its angular velocity, or if the run lacks a part of its state.
    """
    record = RunRecord.from_attrs(run.attrs)
    if model is None and "parameters" in run.attrs and not record.is_own:
        model = record.model
    elif model is None and "parameters" in run.attrs:
        from kreisel.forces.kicks import COUPLING, INERTIA

        system = KNOWN.get(re.sub("^((perturbed|controlled)-)*", "", record.bare))
        values = parsed(record.parameters, "The attribute parameters")
        if (
            system is None
            or not {*system.space.components} <= {*record.kinds.items()}
            or {INERTIA, COUPLING} & {*values}
        ):
            return None
        model = Model(system, {p.letter: values[p.letter] for p in system.parameters}, record.body_frame)
    if model is None or record.missing_from(run) or "time" not in run.coords:
        return None
    return model.lanes(lanes_of(run, record.body_frame)) if model.batch and "lane" in run.coords else model


def _of_rows(
    run: xr.Dataset, model: Model, function: Callable[..., Array], attrs: Any, variables: Any = (), axes: Any = ()
) -> xr.Variable:
    """A function of the components of the state and of further variables at each row, read when it is needed."""
    letters, kinds = zip(*model.system.space.components, strict=True)

    def values(*parts: Array) -> Array:
        state = [algebra.KINDS[kind].from_user(v, 3) for kind, v in zip(kinds, parts, strict=False)]
        return function(state, *parts[len(kinds) :])

    sources = [*(run.variables[letter] for letter in letters), *variables]
    return _rows((*sources[0].dims[:-1], *axes), sources, values, bool(model.batch), attrs)


ENERGIES = ("energy", "total_energy", "balance")


def _with_spin(out: xr.Dataset, run: xr.Dataset, model: Model, factor: float) -> dict[str, xr.Variable]:
    """Energies with factor <M, spin>, which the Hamiltonian of a symmetric top leaves out: it is constant on orbits."""
    if model.system.spin is None or model.system.name != run.attrs["system"]:  # forces may change the spin
        return {}

    def values(state: list[Array], energy: Array) -> Array:
        spin = algebra.axial(model.call(model.system.spin, *state))
        return energy + factor * algebra.dot(algebra.axial(state[0]), spin)

    energies = {name: out.variables[name] for name in ENERGIES if name in out}
    return {name: _of_rows(run, model, values, energy.attrs, [energy]) for name, energy in energies.items()}


# -- arguments of a body in SI ---------------------------------------------------------------------


def scaled(system: Any, x0: Any, orientation: Any, asked: Mapping[str, Any], events: Any = ()) -> tuple[Any, ...]:
    """Model, start, orientation, settings and events of a run, in the form of the state; `system` may be a body."""
    body = as_body(system)
    if body is None:
        return system, x0, orientation, asked, events
    model = body.in_si()
    frame, (start, first) = model.body_frame, state_of(body, model, x0)
    if orientation is False:
        first = None
    elif orientation is not None:
        before, first = first, oriented(model, orientation)
        _require_attitude_of_state(body, model, start, before, first)
    settings = scaled_settings(model, asked)
    end = settings.get("t_end") or (settings.get("t_start") or 0.0) + settings["dt"] * (settings.get("steps") or 0)
    end = end if settings.get("times") is None else float(np.max(settings["times"], initial=0.0))
    for sentence in body._doubts(end * frame.time_unit) if isinstance(end, float) else ():
        doubt(sentence)
    return model, start, first, settings, scaled_events(frame, events)


TIMES = re.compile(r"\b(dt|time|t_end) (= )?\d|\b(dt|t_end|t_start) must be a|\b(times|t_start): ")


@contextmanager
def unit_of_times(model: Any) -> Iterator[None]:
    """Errors of a run of a body state the unit of their times, which is the model's."""
    frame = model.body_frame if isinstance(model, Model) else OF_SYSTEM
    try:
        yield
    except (InputError, RunError) as error:
        if not frame.names or frame.time_unit == 1 or not TIMES.search(str(error)):
            raise
        raise type(error)(f"{error} (Times in this message are multiples of {frame.time_unit:.6g} s.)") from error


def _require_attitude_of_state(body: Body, model: Model, start: Any, before: Any, g: Array) -> None:
    """Raises `InputError` for an attitude that differs from the state's, if the state depends on it."""
    names = model.body_frame.names
    R, far = algebra.rotation_matrix(g), 0.0
    for letter, row in (("P", R[..., 2, :]), ("a", R[..., :, 2])):
        if names.get(letter) in ("up", "axis") and letter in start:
            far = max(far, float(np.max(abs(row - np.asarray(start[letter])))))
    if before is not None and np.any(getattr(body, "current", 0.0)):
        far = max(far, float(np.max(abs(R - algebra.rotation_matrix(np.asarray(before))))))
    if far > SAME_ATTITUDE:
        raise InputError(
            "orientation: expected an attitude with the vertical and the axis of the state, got another one. Usual "
            "cause: an attitude that the state does not know; give attitude=..., up=... or tilt=... to body.state."
        )


def oriented(model: Model, attitude: Any) -> Array:
    """The orientation of the axes of the state from the attitude of the body's axes.  Raises `InputError`."""
    return model.body_frame.change(ORIENTATION, False)(initial_orientation(attitude, model))


def state_of(body: Body, model: Model, x0: Any) -> tuple[Any, Any]:
    """The start in the form of the state, and its orientation: a state, a row, or the arguments of `body.state`."""
    if hasattr(x0, "data_vars"):
        frame, expected = frame_in_si(x0), model.body_frame
        if frame and expected and not frame.is_like(expected, model.system.space.letters):
            raise InputError(
                "x0: expected a row of a run of this body, got one of a body whose state has other axes or units. "
                "Usual cause: other moments of inertia. Give body.state(...) with the angular velocity and attitude "
                "of the row."
            )
        row = in_state_form(x0)
        return row, row[ORIENTATION].values if ORIENTATION in row else None
    if isinstance(x0, Mapping) and not isinstance(x0, State):
        letters = model.system.space.letters
        if any(k in letters for k in x0):
            raise InputError(
                f"x0: expected body.state(...), its arguments as a dict, or a row of a run, got the components "
                f"{', '.join(map(str, x0))}. Usual cause: a state of the scaled system; body.model() is simulated so."
            )
        x0 = body.state(**x0)
    return x0, getattr(x0, "orientation", None)


def duration(frame: BodyFrame, value: Any, name: str) -> float:
    """A duration in s, or with units, in the unit of time of the state.  Raises `InputError`."""
    scaled = Scale("s", frame.time_unit).scaled(value, name)
    if np.ndim(scaled):
        raise InputError(f"{name}: expected one duration in s, or such as '1 ms', got {shown(value)}.")
    return float(scaled)


def times_of(model: Model, values: Any) -> Array:
    """Times in s, or with units, in the unit of time of the state.  Raises `InputError`."""
    return np.asarray(Scale("s", model.body_frame.time_unit).scaled(values, "times"))


NEAR = 1e-9  # relative: a duration that is a multiple of the step


def steps_in(frame: BodyFrame, value: Any, dt: float, name: str) -> Any:
    """A number of steps: such a number, or a duration with units, a multiple of dt.  Raises `InputError`."""
    if isinstance(value, float) and not value.is_integer():
        raise InputError(f"{name}: expected a number of steps, or a duration with units, '{value:g} s', got {value!r}.")
    if not (isinstance(value, str) or hasattr(value, "units") or hasattr(value, "to_value")):
        return value
    ratio = duration(frame, value, name) / positive_number(dt, "dt")
    count = round(ratio)
    if count < 1 or abs(ratio - count) > NEAR * ratio:
        raise InputError(
            f"{name}: expected a number of steps, or a multiple of dt = {dt * frame.time_unit:g} s, got "
            f"{shown(value)}, which is {ratio:g} dt."
        )
    return count


def scaled_settings(model: Model, asked: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a run in the units of the state, from durations in s or with units.  Raises `InputError`."""
    frame = model.body_frame
    out = {name: value for name, value in asked.items() if value is not None}
    for name in ("t_start", "t_end", "dt"):
        if name in out:
            out[name] = duration(frame, out[name], name)
    if "dt" not in out:
        out |= _usual_step(model, frame, out)
    if "times" in out:
        out["times"] = times_of(model, out["times"])
    if "every" in out:
        out["every"] = steps_in(frame, out["every"], out["dt"], "every")
    if out.get("impulses"):
        several = out["impulses"] if isinstance(out["impulses"], list | tuple) else [out["impulses"]]
        out["impulses"] = [_impulse(frame, impulse) for impulse in several]
    return {**asked, **out}


def _usual_step(model: Model, frame: BodyFrame, asked: Mapping[str, Any]) -> dict[str, Any]:
    """The step of a satellite for which none is given: chosen by the run, or one for each sample of its controller."""
    record, every, end = model.system.perturbation, asked.get("every"), asked.get("t_end")
    placed = record is not None and record.environment is not None
    if placed and record.sampled:  # type: ignore[union-attr]
        return {"dt": record.control.every}  # type: ignore[union-attr]
    if not placed or end is None or {"order", "times"} & asked.keys() or isinstance(every, int | float | np.integer):
        raise InputError(
            "dt: expected the step, a duration such as '1 ms', got none. Without it a satellite needs t_end and no "
            "order, times or number of steps: dt and order are then chosen for an error of 1e-6 rad."
        )
    length = abs(end - asked.get("t_start", 0.0)) / 1000 or 1.0  # rows; an end before the start is refused later
    return {"dt": length if every is None else duration(frame, every, "every"), "every": 1, "order": "auto"}


def _impulse(frame: BodyFrame, impulse: Any) -> Any:
    """An impulse {"time": "2 s", "momentum": (0, 0, 1)} in the units and along the axes of the state."""
    if not isinstance(impulse, Mapping):
        return impulse  # the settings report the fault
    units = {name: frame.units.get(frame.letters.get(str(name), str(name)), ("1", 1.0))[0] for name in impulse}
    measured = {str(k): Scale(units[k], 1.0).scaled(v, f"impulses: {k}") for k, v in impulse.items()}
    return frame.components(measured, False) | (
        {"time": duration(frame, impulse["time"], "impulses: the time")} if "time" in impulse else {}
    )


def scaled_events(frame: BodyFrame, events: Any) -> list[Event]:
    """Events whose functions receive and return a state in SI, by names in words, for a run in units of the state."""

    def of_state(function: Any, event: Event | None = None) -> Any:
        @wraps(function)
        def in_words(state: Mapping[str, Any]) -> Any:
            named = NamedComponents(frame.components(state, True))
            return frame.components(event.acted(named), False) if event else function(named)

        return in_words

    return [Event(of_state(e.quantity), e.action and of_state(e.action, e), e.rising) for e in checked_events(events)]


def letters_of(model: Model, names: Any) -> Any:
    """Names of unknowns, a list or a mapping, such as "momentum[0]", with the letters of the state."""
    frame = model.body_frame
    words = frame.letters

    def letter(name: Any) -> Any:
        match = QUANTITY.fullmatch(name) if isinstance(name, str) else None
        if match is not None and match[2] and frame.turned and words.get(match[1]) in frame.along:
            raise InputError(
                f"free: expected all of {match[1]}, got {name}: the axes of the state are the principal axes, in which "
                f"an entry along your axes is not an unknown. Give free=['{match[1]}'], or a diagonal inertia tensor."
            )
        return name if match is None else words.get(match[1], match[1]) + match[2]

    if isinstance(names, Mapping):
        return {letter(name): value for name, value in names.items()}
    return [letter(name) for name in names] if isinstance(names, Sequence) and not isinstance(names, str) else names


def matrix_of(frame: BodyFrame, letter: str, width: int, forward: bool) -> Array:
    """The matrix A (width, width) with v_SI = v_state A (forward) or back, of a component; of lanes (lanes, ...)."""
    out = np.asarray(frame.change(letter, forward)(np.eye(width)[:, None]))
    return np.moveaxis(out, 1, 0) if frame.differs else out[:, 0]


def observations_of(model: Model, data: Any) -> Any:
    """Observations of a body, with names in words, SI and the axes given by default, with letters and these attributes.

    A run in SI is returned in the form of the state; of a body whose state has other axes or units, as observations.
    """
    if is_in_si(data) and not frame_in_si(data).is_like(model.body_frame, (*model.system.space.letters, "time")):
        data = type(data)({name: data[name] for name in model.body_frame.names.values() if name in data})
    if is_in_si(data) or not hasattr(data, "data_vars"):
        return in_state_form(data)
    frame = model.body_frame
    words = frame.letters | {VELOCITY: "Omega"}
    renamed = {}
    for name, variable in data.variables.items():
        prefix = "sigma_" if str(name).startswith("sigma_") else ""
        word, index = re.fullmatch(r"(\w+)(.*)", str(name)[len(prefix) :], re.DOTALL).groups()  # type: ignore[union-attr]
        letter = words.get(word, word)
        unit = "rad/s" if letter == "Omega" else frame.units.get(letter, ("1", 1.0))[0]
        inside = {AXES: BODY} if letter in (*frame.along, ORIENTATION, "Omega") else {}
        out = variable.copy(deep=False)
        out.attrs = ({} if prefix else {"units": unit}) | inside | variable.attrs
        renamed[prefix + letter + index] = out
    coords = {k: v for k, v in renamed.items() if k in data.coords}
    return type(data)({k: v for k, v in renamed.items() if k not in coords}, coords, dict(data.attrs))


def state_quantity(run: xr.Dataset, quantity: Any) -> Any:
    """A quantity of a run in SI, "momentum[2]" or a function in SI, as a function of the components of its state."""
    frame = frame_in_si(run)
    if not frame or not (isinstance(quantity, str) or callable(quantity)):
        return quantity
    if frame.differs and "lane" in run.dims:
        raise InputError("expected the run of one body, got lanes that differ in axes or units: run.isel(lane=0).")
    letters = list(RunRecord.from_attrs(run.attrs).kinds)
    changes = [frame.change(letter, True) for letter in letters]

    def values(state: Sequence[Array]) -> list[Array]:
        return [f(np.asarray(v)) for f, v in zip(changes, state, strict=False)]

    if callable(quantity):
        return wraps(quantity)(lambda *state: quantity(*values(state)))
    names, match = [frame.names.get(letter, letter) for letter in letters], COMPONENT_OF.fullmatch(quantity)
    if match is None or match[1] not in names:
        raise InputError(
            f"expected a component of {', '.join(names)} such as {names[0]}[2], got {shown(quantity)}. A function of "
            "these may combine them."
        )
    place, index = names.index(match[1]), int(match[2])

    def component(*state: Array) -> Array:
        return np.asarray(values(state)[place][..., index])

    component.__name__ = quantity
    return component
