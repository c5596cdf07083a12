"""A sweep from its description: its lanes, planned and simulated in groups.

Summaries of each lane are computed block by block of its rows, without its trajectory:

    drift        NAME_start and NAME_drift: first value and largest |change| of each Casimir and integral
    extremes     NAME_min and NAME_max of each component of the state, over the saved rows
    frequencies  NAME_frequency: angular frequency of the largest harmonic of each component of the state

The frequency is computed by `harmonics` under Hann's window, for a quasi-periodic motion with an error O(1/T^4), T the
length of the run.

Sweeps over values of a body in SI have each lane as parameters and a state of the system that kernels step.  Quantities
are `body.mass` and `body.orbit.altitude`; `state.spin`, an argument of `body.state`; `state.momentum[0]`, a variable of
its runs, along the axes in which the body was given; and `run.dt`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.random import GENERATOR
from kreisel.bodies import KNOWN
from kreisel.errors import InputError, RunError, doubt, hint, shown
from kreisel.kernels.layout import Floats
from kreisel.method import Outcome
from kreisel.method.auto import Choice
from kreisel.method.scheme import KINDS, ORIENTATION
from kreisel.record.body import Body, joined
from kreisel.record.contract import System
from kreisel.record.model import Model, State
from kreisel.record.perturbation import WITH_WHEELS
from kreisel.record.units import OF_SYSTEM, BodyFrame, base_unit, in_base_units, units_requested
from kreisel.record.values import axes_of
from kreisel.runs import harmonics
from kreisel.runs.in_si import scaled, scaled_settings, unit_of_times
from kreisel.runs.integration import Integration
from kreisel.runs.operations import load_system, operations_of
from kreisel.runs.plan import Plan
from kreisel.runs.planning import choices, plan_of, with_choice
from kreisel.runs.settings import Settings, with_steps
from kreisel.sweeps.design import GRIDS, Lanes, Varied

TRAJECTORIES = "trajectories"
CHOSEN = {"chosen_order": "order chosen for the tolerance", "chosen_dt": "step chosen for the tolerance"}
CODE = ("file", "operations")  # sections with the SHA-256 of a user-defined system, or of its file
TROUBLES = (InputError, RunError, ArithmeticError, np.linalg.LinAlgError)  # of single lanes
FEWEST_ROWS = 32  # for a frequency
AT_ONCE = 1 << 18  # samples in a slab of the frequency analysis
ROUND_OFF = 1e-12  # relative: a component that changes less is constant


class Summary(NamedTuple):
    """A kind of summary of a variable.

    kinds   of the variables that have it;  meanings   of its values, by the end of their names
    fold    (values of the blocks so far or None, a block (rows, lanes, ...), number of regular rows) -> values
    """

    kinds: tuple[str, ...]
    meanings: dict[str, str]
    fold: Callable[[Any, Array, int], tuple[Any, ...]]


def _drift(values: Any, block: Array, rows: int) -> tuple[Any, ...]:
    start, change = values or (block[0].copy(), 0.0)
    return start, np.maximum(change, abs(block - start).max(0))


def _extremes(values: Any, block: Array, rows: int) -> tuple[Any, ...]:
    least, greatest = values or (np.inf, -np.inf)
    return np.minimum(least, block.min(0)), np.maximum(greatest, block.max(0))


def _samples(values: Any, block: Array, rows: int) -> tuple[Any, ...]:
    samples, filled = values or (np.empty((rows, *block.shape[1:])), 0)
    block = block[: rows - filled]  # the last row may be closer than the others
    samples[filled : filled + len(block)] = block
    return samples, filled + len(block)


STATES = ("state", "orientation")
SUMMARIES = {
    "drift": Summary(KINDS, {"start": "at time 0", "drift": "largest |change|"}, _drift),
    "extremes": Summary(STATES, {"min": "least", "max": "greatest"}, _extremes),
    "frequencies": Summary(STATES, {"frequency": "angular frequency of the largest harmonic; 0: constant"}, _samples),
}


def summarized(kind: str, outcomes: Mapping[str, Outcome]) -> list[str]:
    """The variables that a kind of summary covers."""
    return [name for name, outcome in outcomes.items() if outcome.kind in SUMMARIES[kind].kinds]


def angular_frequency(samples: Floats, spacing: float) -> Floats:
    """The frequency of the largest harmonic of each column of samples (rows, columns) minus its mean; 0 if constant."""
    t = spacing * (np.arange(len(samples)) - (len(samples) - 1) / 2)
    weights = harmonics.window(t, 1)
    swing = samples - (weights[:, None] * samples).sum(0)
    constant = ~(abs(swing).max(0) > ROUND_OFF * abs(samples).max(0))
    omega = harmonics.strongest(t, weights[:, None] * np.where(constant, 0.0, swing), still=False)
    return np.where(constant, np.where(np.isfinite(samples).all(0), 0.0, np.nan), omega)


class Sweep:
    """A sweep from its description: sections system, state, run and sweep, as plain data.

    source    a user-defined system, or its Python file
    """

    def __init__(self, description: Mapping[str, Any], source: Path | System | None = None):
        self.description, spec = description, description["sweep"]
        base = dict(description["system"])
        body = description.get("body")
        self._body_frame = OF_SYSTEM if body is None else BodyFrame.from_table(body).of_lanes(0)
        name = base.pop("name")
        self.system: System = (
            source if isinstance(source, System) else load_system(name, source, base, self._body_frame)
        )
        if self.system.perturbation is not None and self.system.perturbation.pair is not None:
            raise InputError(
                f"{self.system.name}: expected a system whose lanes are independent, got bodies that act on each other "
                "in pairs, which are the lanes of one run. Call kr.simulate for each set of parameters."
            )
        self._kinds_of_state = dict(self.system.space.components)
        self.lanes = Lanes({**description, "system": base}, spec, GENERATOR in self._kinds_of_state)
        self.save: tuple[str, ...] = tuple(spec["save"])
        self.kinds = {p.letter: p.kind for p in self.system.parameters}
        self.shared = {p.letter for p in self.system.parameters if p.axes is None}  # by all lanes of a run

    def plan(
        self,
        sections: Mapping[str, Mapping[str, Any]],
        ids: Array,
        varied: set[tuple[str, str]],
        choice: Choice | None = None,
    ) -> Plan:
        """The ensemble of the lanes `ids` of a result of `Lanes.filled`, with the choices for order="auto".

        Raises `InputError`.
        """
        model, start, orientation, settings = self._asked(sections, ids, varied)
        if choice is not None:
            settings = with_choice(choice, settings)
        plan = plan_of(model, model.state(**start), settings, orientation)
        if plan.lanes != len(ids):
            raise InputError(
                "expected one lane in [system] and [state], got a batch axis; what varies belongs in [sweep.list]."
            )
        return plan

    def plan_of_lane(self, lane: int) -> Plan:
        """The ensemble of one lane.  Raises `InputError`."""
        values = self.lanes.values(lane, lane + 1)
        sections, varied = self.lanes.filled(values), {(q.section, q.letter) for q in values}
        ((ids, choice),) = self.alike(sections, np.arange(1), varied)
        return self.plan(sections, ids, varied, choice)

    def alike(
        self, sections: Mapping[str, Mapping[str, Any]], ids: Array, varied: set[tuple[str, str]]
    ) -> list[tuple[Array, Choice | None]]:
        """The lanes in groups that are stepped together: with order="auto", lanes with equal choices.

        The choice of a lane equals the choice of a single run: it does not depend on other lanes or on blocks.
        """
        model, start, orientation, settings = self._asked(sections, ids, varied)
        if settings.order != "auto":
            return [(ids, None)]
        result: dict[tuple[int, int], tuple[list[int], Choice]] = {}
        chosen = choices(model, model.state(**start), settings, orientation)
        if len(chosen) != len(ids):
            return [(ids, None)]  # `plan` reports the fault
        for lane, choice in zip(ids.tolist(), chosen, strict=True):
            result.setdefault((choice.order, choice.steps), ([], choice))[0].append(lane)
        return [(np.array(lanes), choice) for lanes, choice in result.values()]

    def _asked(
        self, sections: Mapping[str, Mapping[str, Any]], ids: Array, varied: set[tuple[str, str]]
    ) -> tuple[Model, dict[str, Any], Any, Settings]:
        """Model, start, orientation and settings of an ensemble.  Raises `InputError`."""

        def chosen(section: str, letter: str) -> Any:
            value = sections[section][letter]
            if (section, letter) not in varied:
                return value
            if section == "run" and np.ndim(value[ids[0]]):
                raise InputError(f"run.{letter}: expected a number or a name for each lane, got lists.")
            return value[ids[0]].item() if section == "run" else value[ids]

        params = {
            k: _ready(chosen("system", k), self.kinds.get(k), ("system", k) in varied) for k in sections["system"]
        }
        for letter in self.shared:
            if ("system", letter) in varied:
                params[letter] = params[letter][0]
        state = {k: chosen("state", k) for k in sections["state"]}
        orientation = state.pop("orientation", None)
        model = Model(self.system, params, self._body_frame)
        start = {k: _ready(v, self._kinds_of_state.get(k), ("state", k) in varied, len(ids)) for k, v in state.items()}
        run = {k: chosen("run", k) for k in sections["run"]}
        if run.get("times") is not None:
            raise InputError("[run] of a sweep: expected rows at each `every`-th dt, got times. Leave them out.")
        missing = [k for k in ("dt", "steps") if run.get(k) is None]
        if missing:
            raise InputError(f"[run] needs {' and '.join(missing)}, or vary it in [sweep.grid] or [sweep.list].")
        return model, start, orientation, Settings.checked(**run)

    @property
    def automatic(self) -> bool:
        """Whether order="auto" occurs."""
        orders = [np.atleast_1d(v) for q, v in self.lanes.tables.items() if q.name == "run.order"]
        return "auto" in (np.concatenate(orders) if orders else [self.lanes.base["run"].get("order")])

    def groups(self, values: Mapping[Varied, Array], count: int) -> list[Array]:
        """Lanes that can be stepped together: lanes with equal run settings."""
        shared = {("system", letter) for letter in self.shared}
        apart = [v for q, v in values.items() if q.section == "run" or (q.section, q.letter) in shared]
        keys: dict[tuple[bytes, ...], list[int]] = {}
        for lane in range(count) if apart else ():
            keys.setdefault(tuple(np.asarray(v[lane]).tobytes() for v in apart), []).append(lane)
        return [np.array(ids) for ids in keys.values()] or [np.arange(count)]

    def results(
        self, first: int, stop: int, layouts: Mapping[str, tuple[tuple[int, ...], int]]
    ) -> tuple[dict[str, Array], dict[int, str]]:
        """Every variable in `layouts`, name -> (shape, axis of lanes), of lanes first to stop - 1; failures by lane.

        Summaries of lanes that failed are NaN, and so are their trajectories from the failure on.
        """
        values = self.lanes.values(first, stop)
        sections, varied = self.lanes.filled(values), {(q.section, q.letter) for q in values}
        out = {name: np.full(shape, np.nan) for name, (shape, _) in layouts.items()}
        faults: dict[int, str] = {}
        pending: list[tuple[Array, Choice | None, bool]]  # lanes, their choices, and whether these are final
        pending = [(ids, None, False) for ids in reversed(self.groups(values, stop - first))]
        while pending:
            ids, choice, chosen = pending.pop()
            try:
                if not chosen:
                    pending += [
                        (lanes, decision, True) for lanes, decision in reversed(self.alike(sections, ids, varied))
                    ]
                    continue
                results, failed = self._simulated(self.plan(sections, ids, varied, choice))
            except TROUBLES as error:
                if len(ids) == 1:
                    faults[int(ids[0])] = str(error)
                else:  # one of them is at fault: each half is tried
                    half = len(ids) // 2
                    pending += [(ids[half:], choice, chosen), (ids[:half], choice, chosen)]
                continue
            for name in out.keys() & results.keys():
                out[name][(*(slice(None),) * layouts[name][1], ids)] = results[name]
            faults |= {int(ids[lane]): why for lane, why in failed.items()}
        return out, faults

    def _simulated(self, plan: Plan) -> tuple[dict[str, Array], dict[int, str]]:
        """Summaries (lanes, ...) and, if requested, trajectories (time, lanes, ...) of an ensemble; its faults."""
        failed: dict[int, str] = {}
        folded: dict[tuple[str, str], Any] = {}
        covered = [(kind, k) for kind in self.save if kind in SUMMARIES for k in summarized(kind, plan.outcomes)]
        saved: dict[str, list[Array]] = {}
        for block in Integration(plan, faults=failed).blocks():
            for kind, name in covered:
                values = folded.get((kind, name))
                folded[kind, name] = SUMMARIES[kind].fold(values, block[name], plan.steps // plan.every + 1)
            if TRAJECTORIES in self.save:
                for name, value in block.items():
                    saved.setdefault(name, []).append(value)
        out: dict[str, Array] = {}
        for (kind, name), values in folded.items():
            if kind == "frequencies":
                samples = values[0].reshape(len(values[0]), -1)
                at = range(0, samples.shape[1], max(1, AT_ONCE // len(samples)))
                slabs = [angular_frequency(samples[:, i : i + at.step], plan.dt * plan.every) for i in at]
                values = (np.concatenate(slabs).reshape(values[0].shape[1:]),)
            ends = SUMMARIES[kind].meanings
            out |= {f"{name}_{end}": value for end, value in zip(ends, values, strict=True)}
        options = plan.scheme.options
        if isinstance(options.get("order"), int):
            chosen = (options["order"], plan.dt)
            out |= {name: np.full(plan.lanes, float(value)) for name, value in zip(CHOSEN, chosen, strict=True)}
        for value in out.values():
            value[list(failed)] = np.nan
        return out | {name: np.concatenate(values) for name, values in saved.items()}, failed


def _ready(value: Any, kind: str | None, varied: bool, lanes: int | None = None) -> Any:
    """A value in a form with an unambiguous axis of lanes; `lanes` is whether it has one."""
    if kind is None:
        return value
    try:
        array = np.asarray(value)
    except ValueError:
        return value  # the model reports the fault
    if array.dtype.kind not in "iuf":
        return value
    axes = array.ndim - varied
    if kind == "skew" and axes == 1 and array.shape[-1] == 3:
        array, axes = algebra.hat(array), 2
    if kind == "symmetric" and axes == 1:
        array, axes = array[..., None] * np.eye(array.shape[-1], dtype=np.int8), 2
    if lanes is not None and not varied:
        array = np.broadcast_to(array, (lanes, *array.shape))
    return array


# -- values of a body ----------------------------------------------------------------------------------------


def user_defined(model: Model, sections: dict[str, Any]) -> System | None:
    """The system of a model that is none of Kreisel's; the sections of its sweep get the SHA-256 of its functions."""
    if model.system.name.removesuffix(WITH_WHEELS) in KNOWN:
        return None
    sections["operations"] = operations_of(model)
    return model.system


Changes = Mapping[Varied, Any]
Bodies = Callable[[list[dict[str, Any]]], Body]  # the bodies with changed values: functions of the values by name


def of_scaled_system(model: Model, spec: Mapping[str, Any]) -> bool:
    """Whether a section [sweep] names parameters and letters of the system of a body only."""
    letters, quantities = (*model.system.space.letters, "orientation"), Lanes({}, spec, words=True).quantities
    return all(q.section == "system" or (q.section == "state" and q.letter in letters) for q in quantities)


def of_body_in_si(
    body: Body, x0: Any, run: Mapping[str, Any], spec: Mapping[str, Any], bodies: Bodies
) -> tuple[dict[str, Any], Model]:
    """The sections of a sweep from a body and the arguments of `body.state`, or a state; the model of all lanes."""
    run, lanes = dict(run), Lanes({}, spec, words=True)
    if run.pop("orientation", None) is not None:
        raise InputError("orientation: expected none with values of a body in SI; give the attitude to its state.")
    values = lanes.values(0, lanes.total)
    if system := next((q.name for q in values if q.section == "system"), None):
        raise InputError(f"{system}: expected body.NAME, state.NAME or run.NAME next to values of a body in SI.")
    values_by_lane = [{q: v[lane].tolist() for q, v in values.items()} for lane in range(lanes.total)]
    of_bodies = [{q: v for q, v in lane.items() if q.section == "body"} for lane in values_by_lane]
    distinct = dict[str, dict[str, Any]]()
    changes = [distinct.setdefault(repr(lane), _of_body(lane)) for lane in of_bodies]  # equal bodies are created once
    with units_requested() as of_body:
        many = bodies(changes) if any(changes) else body
    if any(changes) and isinstance(x0, State):
        raise InputError(
            f"x0: expected the arguments of body.state as a dict, such as {{'spin': (0, 0, 1)}}, since each body has "
            f"its own state, got {shown(x0)}."
        )
    model = many.in_si()
    members = getattr(many, "members", [body] * lanes.total)
    with units_requested() as of_state:
        state = joined(model, [_state_of_lane(k, members[k], x0, lane) for k, lane in enumerate(values_by_lane)])
    parameters: dict[str, Any] = {}
    listed: dict[str, Any] = {}
    for p in model.system.parameters:
        value = model.params[p.letter]
        many_values = value.ndim > axes_of(p, value)
        parameters[p.letter] = value[0] if many_values else value
        listed |= {f"system.{p.letter}": value} if many_values else {}
    start = {**state.axial, **({} if state.orientation is None else {"orientation": state.orientation})}
    settings, varied = _settings(
        model, run, [{q.letter: v for q, v in lane.items() if q.section == "run"} for lane in values_by_lane]
    )
    _warn_of_end(many, settings | varied)
    listed |= {f"state.{letter}": value for letter, value in start.items()}
    listed |= {f"run.{name}": value for name, value in varied.items()}
    axes = [[axis, size, {q.name: in_base_units(v) for q, v in tables.items()}] for axis, size, tables in lanes.folded]
    sections = {
        **({"body": replace(model.body_frame, title=body.title).table} if model.body_frame else {}),
        "system": {"name": model.system.name, **parameters},
        "state": {letter: value[0] for letter, value in start.items()},
        "run": settings,
        "sweep": {
            **{name: value for name, value in spec.items() if name not in GRIDS},
            "list": listed,
            "shown": {q.name: in_base_units(v) for q, v in values.items()},
            "axes": axes,
            "units": {
                q.name: unit
                for q, v in values.items()
                if (unit := base_unit(v) or _unit(q, model.body_frame, of_body if q.section == "body" else of_state))
            },
        },
    }
    return sections, model


def _unit(q: Varied, frame: BodyFrame, requested: Mapping[str, set[str]]) -> str:
    """Unit of a time, of a variable of the runs, or of an argument, whose values are floats; "" if it is ambiguous."""
    if q.section == "run":
        return "s" if q.letter in ("dt", "t_end", "t_start") else ""
    if q.section == "state" and (letter := frame.letters.get(q.letter, "")) in frame.units:
        return str(frame.units[letter][0])
    units = requested.get(q.letter.rpartition(".")[2], set())
    return "".join(units) if len(units) == 1 else ""


OF_STEPS = ("asked_dt", "t_end")  # settings that dt and steps replace


def _settings(
    model: Model, run: Mapping[str, Any], changes: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """The settings of the first run in the units of the state, and lists of settings that vary."""
    fixed, several = {name: value for name, value in run.items() if value is not None}, bool(changes[0])
    with unit_of_times(model):
        scaled = [with_steps(scaled_settings(model, {**fixed, **c})) for c in (changes if several else changes[:1])]
    implied = ("dt", "steps", "every") if {"dt", "t_start", "t_end"} & changes[0].keys() else ()
    names = [k for k in scaled[0] if k not in OF_STEPS and (k in changes[0] or k in implied)]
    varied = {name: [settings[name] for settings in scaled] for name in names}
    varied = {k: values for k, values in varied.items() if k in changes[0] or any(v != values[0] for v in values)}
    return {name: value for name, value in scaled[0].items() if name not in OF_STEPS}, varied


def _warn_of_end(body: Body, settings: Mapping[str, Any]) -> None:
    """Warns of models of the body that do not hold until the end of the lanes."""
    with suppress(TypeError, ValueError):  # of settings that the sweep refuses
        ends = np.multiply(settings.get("dt", 0.0), settings.get("steps", 0)) + (settings.get("t_start") or 0.0)
        for sentence in body._doubts(float(ends.max()) * body.in_si().body_frame.time_unit):
            doubt(sentence)


def _state_of_lane(lane: int, body: Body, x0: Any, values: Changes) -> State:
    try:
        return _started(body, x0, {q: v for q, v in values.items() if q.section == "state"})
    except InputError as error:
        raise InputError(f"Lane {lane}: {error}") from error


def _started(body: Body, x0: Any, changes: Changes) -> State:
    """The state of a body with changed arguments of `body.state` and variables of its runs."""
    arguments = {} if isinstance(x0, State) or x0 is None else dict(x0)
    letters = () if isinstance(x0, State) else tuple(inspect.signature(body.state).parameters)
    for q, value in changes.items():
        if q.letter in letters:
            arguments[q.letter] = _with_entry(arguments.get(q.letter), q, value)
    state = x0 if isinstance(x0, State) else body.state(**arguments)
    words = {q: value for q, value in changes.items() if q.letter not in letters}
    if not words:
        return state
    model = body.in_si()
    frame, parts = model.body_frame, dict(state.axial)
    orientation: Any = state.orientation
    for q, value in words.items():
        letter = frame.letters.get(q.letter)
        if letter is None or (letter == ORIENTATION and orientation is None):
            names = dict.fromkeys((*letters, *frame.letters))  # each once
            cause = "" if letters else " Of arguments of body.state give x0 as a dict, such as {'spin': (0, 0, 1)}."
            raise InputError(
                f"{q.name}: expected {', '.join(names)}, got {shown(q.letter)}.{hint(q.letter, names)}{cause}"
            )
        old = np.asarray(orientation if letter == ORIENTATION else parts[letter])
        entries = _with_entry(frame.change(letter, True)(old).tolist(), q, value)
        if letter == ORIENTATION:
            orientation = scaled(body, state, entries, {"dt": 1.0})[2]
        else:
            parts[letter] = frame.change(letter, False)(np.asarray(entries, dtype=np.float64))
    return model.state(**parts).started(orientation, state.frame)


def _of_body(changes: Changes) -> dict[str, Any]:
    """Functions that change values of a body, by their names."""
    names = {
        q.letter: [(quantity, v) for quantity, v in changes.items() if quantity.letter == q.letter] for q in changes
    }
    return {
        name: lambda value, of=of: functools.reduce(lambda old, change: _with_entry(old, *change), of, value)
        for name, of in names.items()
    }


def _with_entry(entries: Any, q: Varied, value: Any) -> Any:
    """A value, or a vector or matrix with this value at the index of a quantity.  Raises `InputError`."""
    if not q.index:
        return value
    out: Any = entries.tolist() if isinstance(entries, np.ndarray) else entries
    first, *others = q.index
    if not isinstance(out, list | tuple) or first >= len(out) or len(others) > 1:
        cause = f" Usual cause: {q.letter} is not an argument." if entries is None else ""
        raise InputError(f"{q.name}: expected an entry of {shown(entries)}, which has none at {list(q.index)}.{cause}")
    inner = _with_entry(out[first], Varied(q.section, q.letter, tuple(others)), value)
    return [inner if place == first else entry for place, entry in enumerate(out)]
