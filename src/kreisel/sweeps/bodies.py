"""Sweeps over values of a body in SI: each lane as parameters and a state of the system that kernels step.

Quantities are `body.mass` and `body.orbit.altitude`; `state.spin`, an argument of `body.state`; `state.momentum[0]`, a
variable of its runs, along the axes in which the body was given; and `run.dt`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from kreisel.errors import InputError, hint, shown
from kreisel.method.observing import ORIENTATION
from kreisel.record.body import Body, joined
from kreisel.record.body_frame import BodyFrame
from kreisel.record.given import axes_of
from kreisel.record.model import Model, State
from kreisel.record.quantities import in_base_units
from kreisel.runs.in_si import of_body, scaled_settings
from kreisel.runs.settings import with_steps
from kreisel.sweeps.design import GRIDS, Lanes, Varied

Changes = Mapping[Varied, Any]
Bodies = Callable[[list[dict[str, Any]]], Body]  # the bodies with changed values: functions of the values by name


def of_scaled_system(model: Model, spec: Mapping[str, Any]) -> bool:
    """Whether a section [sweep] names parameters and letters of the system of a body only."""
    letters, quantities = (*model.system.space.letters, "orientation"), Lanes({}, spec, words=True).quantities
    return all(q.section == "system" or (q.section == "state" and q.letter in letters) for q in quantities)


def by_lane(body: Body, x0: Any, run: Mapping[str, Any], spec: Mapping[str, Any], bodies: Bodies) -> dict[str, Any]:
    """The sections of a sweep that begins from a body and the arguments of `body.state`, or a state."""
    run, lanes = dict(run), Lanes({}, spec, words=True)
    if run.pop("orientation", None) is not None:
        raise InputError("orientation: expected none with values of a body in SI; give the attitude to its state.")
    values = lanes.values(0, lanes.total)
    if system := next((q.name for q in values if q.section == "system"), None):
        raise InputError(f"{system}: expected body.NAME, state.NAME or run.NAME next to values of a body in SI.")
    each = [{q: v[lane].tolist() for q, v in values.items()} for lane in range(lanes.total)]
    changes = [_of_body({q: v for q, v in lane.items() if q.section == "body"}) for lane in each]
    many = bodies(changes) if any(changes) else body
    if any(changes) and isinstance(x0, State):
        raise InputError(
            f"x0: expected the arguments of body.state as a dict, such as {{'spin': (0, 0, 1)}}, since each body has "
            f"its own state, got {shown(x0)}."
        )
    model = many.in_si()
    states = []
    for lane, member in enumerate(getattr(many, "members", [body] * lanes.total)):
        try:
            states.append(_started(member, x0, {q: v for q, v in each[lane].items() if q.section == "state"}))
        except InputError as error:
            raise InputError(f"Lane {lane}: {error}") from error
    state = joined(model, states)
    parameters: dict[str, Any] = {}
    listed: dict[str, Any] = {}
    for p in model.system.parameters:
        value = model.params[p.letter]
        many_values = value.ndim > axes_of(p, value)
        parameters[p.letter] = value[0] if many_values else value
        listed |= {f"system.{p.letter}": value} if many_values else {}
    start = {**state.axial, **({} if state.orientation is None else {"orientation": state.orientation})}
    settings = _settings(model, run, [{q.letter: v for q, v in lane.items() if q.section == "run"} for lane in each])
    listed |= {f"state.{letter}": value for letter, value in start.items()}
    listed |= {f"run.{name}": value for name, value in settings.items() if isinstance(value, list)}
    axes = [[axis, size, {q.name: in_base_units(v) for q, v in tables.items()}] for axis, size, tables in lanes.folded]
    return {
        **({} if model.body_frame is None else {"body": model.body_frame.table}),
        "system": {"name": model.system.name, **parameters},
        "state": {letter: value[0] for letter, value in start.items()},
        "run": {name: value[0] if isinstance(value, list) else value for name, value in settings.items()},
        "sweep": {
            **{name: value for name, value in spec.items() if name not in GRIDS},
            "list": listed,
            "shown": {q.name: in_base_units(v) for q, v in values.items()},
            "axes": axes,
        },
    }


def _settings(model: Model, run: Mapping[str, Any], changes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The settings of a run in the units of the state: lists of settings that vary."""
    fixed = {name: value for name, value in run.items() if value is not None}
    each = [
        with_steps(scaled_settings(model, {**fixed, **change}))
        for change in changes[: len(changes) if changes[0] else 1]
    ]
    names = {*changes[0], *(("dt", "steps") if "dt" in changes[0] else ())} & each[0].keys()
    out = {**each[0], **{name: [settings[name] for settings in each] for name in names}}
    return {name: value for name, value in out.items() if name not in ("asked_dt", "t_end")}


def _started(body: Body, x0: Any, changes: Changes) -> State:
    """The state of a body with changed arguments of `body.state` and variables of its runs."""
    arguments = {} if isinstance(x0, State) or x0 is None else dict(x0)
    known = () if isinstance(x0, State) else tuple(inspect.signature(body.state).parameters)
    for q, value in changes.items():
        if q.letter in known:
            arguments[q.letter] = _with_entry(arguments.get(q.letter), q, value)
    state = x0 if isinstance(x0, State) else body.state(**arguments)
    words = {q: value for q, value in changes.items() if q.letter not in known}
    if not words:
        return state
    model = body.in_si()
    frame, parts = model.body_frame or BodyFrame(), dict(state.axial)
    orientation: Any = state.orientation
    for q, value in words.items():
        letter = frame.letters.get(q.letter)
        if letter is None or (letter == ORIENTATION and orientation is None):
            names = (*known, *frame.letters)
            raise InputError(f"{q.name}: expected {', '.join(names)}, got {shown(q.letter)}.{hint(q.letter, names)}")
        into, out = (frame.change(letter, forward) or np.asarray for forward in (False, True))
        entries = _with_entry(out(orientation if letter == ORIENTATION else parts[letter]).tolist(), q, value)
        if letter == ORIENTATION:
            orientation = of_body(body, state, entries, {"dt": 1.0})[2]
        else:
            parts[letter] = into(np.asarray(entries, dtype=np.float64))
    return model.state(**parts).started(orientation, state.frame)


def _of_body(changes: Changes) -> dict[str, Any]:
    """Functions that change values of a body, by their names."""
    names = {q.letter: [(each, v) for each, v in changes.items() if each.letter == q.letter] for q in changes}
    return {
        name: lambda value, of=of: functools.reduce(lambda old, change: _with_entry(old, *change), of, value)
        for name, of in names.items()
    }


def _with_entry(whole: Any, q: Varied, value: Any) -> Any:
    """A value, or a vector or matrix with this value at the index of a quantity.  Raises `InputError`."""
    if not q.index:
        return value
    out: Any = whole.tolist() if isinstance(whole, np.ndarray) else whole
    first, *others = q.index
    if not isinstance(out, list | tuple) or first >= len(out) or len(others) > 1:
        raise InputError(f"{q.name}: expected an entry of {shown(whole)}, which has none at {list(q.index)}.")
    inner = _with_entry(out[first], Varied(q.section, q.letter, tuple(others)), value)
    return [inner if place == first else each for place, each in enumerate(out)]
