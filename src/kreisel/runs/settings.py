"""The checks of the settings, states and orientations that a user requests for a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec
import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies import BODIES
from kreisel.errors import InputError, doubt, explained, hint, shown
from kreisel.kernels.engines import ENGINES
from kreisel.method.scheme import Scheme
from kreisel.record.body import as_body
from kreisel.record.calling import Portable, require_functions
from kreisel.record.contract import System
from kreisel.record.model import Model, State
from kreisel.record.perturbation import TIME
from kreisel.record.units import AXES, BODY, OF_SYSTEM
from kreisel.record.values import by_lane

ORTHOGONAL_TOLERANCE = 1e-9
SHORTEST_STEP = 1e-100  # its square must not underflow
WHOLE = 1e-12  # in steps: a time of n (1 + WHOLE) steps needs n
# n from which engine="large" is chosen: at 8 ensembles are as fast, at 4 their vector code is 4 times as fast
LARGE = 9  # from here on the structured kernel, if there is one of O(n)
MOST_STEPS = 10**15  # a year at 30 million a second; and k dt stays exact to round-off


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a run: the section [run] of a TOML file, and the keywords of `kr.simulate` of the same names."""

    dt: float
    steps: int
    every: int = 1
    method: str | None = None
    order: int | str | tuple[int, ...] | None = None
    tol: float | None = None
    engine: str | None = None
    project: bool = True
    observe: tuple[str, ...] | None = None
    times: tuple[float, ...] | None = None
    impulses: tuple[dict[str, Any], ...] = ()
    asked_dt: float | None = None  # t_end is not a multiple of it; then dt is a little less
    t_end: float | None = None  # with asked_dt
    t_start: float = 0.0

    @classmethod
    def checked(cls, **asked: Any) -> Settings:
        """The requested settings, with types and combinations checked.  Raises `InputError`."""
        wanted = {"every": 1, "project": True, **with_steps({k: v for k, v in asked.items() if v is not None})}
        dt, method = positive_number(wanted.get("dt"), "dt"), named(wanted.get("method"), "method")
        steps, every = (within(wanted.get(name), name) for name in ("steps", "every"))
        flag(wanted["project"], "project")
        order, tol = whole_order(wanted.get("order"), auto=True), wanted.get("tol")
        if not math.isfinite(dt * steps):
            raise InputError(f"{steps:,} steps of {dt:g} are out of reach: a finite time was expected.")
        if every > steps:
            raise InputError(
                f"every = {every} is more than steps = {steps}: nothing would be saved. Use every <= steps."
            )
        if tol is not None and order != "auto" and method != "dop853":
            raise InputError(
                "tol goes with order='auto', which chooses order and step for it, or with method='dop853', got "
                f"method={shown(method)}, order={shown(order)}."
            )
        if order == "auto" and wanted.get("times") is not None:
            raise InputError("times: expected an order that is given, got order='auto', whose rows are dt apart.")
        if order == "auto" and steps % every:
            raise InputError(
                f"order='auto' needs steps to be a multiple of every, got steps = {steps}, every = {every}."
            )
        if wanted.get("engine") is not None:
            _require_engine(wanted["engine"])
        checked = {
            "observe": _observed_names(wanted.get("observe")),
            "project": bool(wanted["project"]),
            "t_start": _checked_start(wanted),
            "impulses": _checked_impulses(wanted.get("impulses", ()), steps * dt),
        }
        return cls(**wanted | checked | {"dt": dt, "steps": steps, "every": every, "method": method, "order": order})

    @property
    def time(self) -> float:
        """The duration of the run."""
        return self.steps * self.dt

    def keywords(self) -> dict[str, Any]:
        """The keywords of `kr.simulate` that give these settings."""
        out = msgspec.structs.asdict(self)
        dt = out.pop("asked_dt")
        return out if dt is None else {**out, "dt": dt, "steps": None}

    def but(self, **changes: Any) -> Settings:
        """The settings with changes, which are not checked."""
        return msgspec.structs.replace(self, **changes)


def with_steps(asked: Mapping[str, Any]) -> dict[str, Any]:
    """The requested settings, with steps of dt or a little less in place of `t_end`.  Raises `InputError`."""
    out = dict(asked)
    end = out.pop("t_end", None)
    if out.get("times") is not None:
        times, dt = in_order(out["times"]), positive_number(out.get("dt"), "dt")
        if not times[-1] / dt <= MOST_STEPS:
            last = f"times to {times[-1]:g}"
            raise InputError(f"times: expected at most {MOST_STEPS:,} steps of dt = {dt:g}, got {last}.")
        count = max(1, math.ceil(times[-1] / dt * (1 - WHOLE)))
        if end is not None or out.get("steps", count) != count or out.get("every", 1) != 1:
            raise InputError("times: expected only rows at these times, got steps, t_end or every too. Leave them out.")
        return {**out, "times": times, "steps": count, "every": 1}
    if end is None:
        if "steps" not in out:
            raise InputError("expected steps=..., an integer of them, t_end=..., a time, or times=..., got none.")
        return out
    if "steps" in out:
        raise InputError(f"expected steps or t_end, got both: steps = {shown(out['steps'])}, t_end = {shown(end)}.")
    start, dt = finite_number(out.get("t_start", 0.0), "t_start"), positive_number(out.get("dt"), "dt")
    end = positive_number(end, "t_end") if start == 0 else finite_number(end, "t_end")
    if end <= start or (end - start) / dt > MOST_STEPS:
        after = f"after t_start = {start:g}, and " * (start != 0)
        raise InputError(f"t_end: expected {after}at most {MOST_STEPS:,} steps of dt = {dt:g}, got t_end = {end:g}.")
    out["steps"] = max(1, math.ceil((end - start) / dt * (1 - WHOLE)))
    shorter = (end - start) / out["steps"]
    asked = {"asked_dt": dt, "t_end": end} if shorter < dt * (1 - WHOLE) else {}
    return {**out, "dt": shorter, **asked}


def _checked_start(asked: Mapping[str, Any]) -> float:
    """The time at the start.  Raises `InputError`."""
    start = finite_number(asked.get("t_start", 0.0), "t_start")
    if start and (asked.get("times") is not None or asked.get("impulses")):
        raise InputError(f"t_start: expected 0 for a run with times or impulses, which count from 0, got {start:g}.")
    return start


def in_order(times: Any) -> tuple[float, ...]:
    """Times of rows.  Raises `InputError` if they do not increase from 0 on."""
    result = algebra.floats(times)
    increasing = result.ndim == 1 and result.size and result[0] >= 0 and (np.diff(result) > 0).all()
    if not increasing or result[-1] == np.inf:
        raise InputError(f"times: expected a list of times from 0 on, each after the one before, got {shown(times)}.")
    if result[-1] == 0:
        raise InputError("times: expected a time after 0, got only 0.")
    return tuple(result.tolist())


def _checked_impulses(impulses: Any, end: float) -> tuple[dict[str, Any], ...]:
    """The impulses, each with its time, up to the end, and values for letters, as lists.  Raises `InputError`."""
    listed = isinstance(impulses, Sequence) and not isinstance(impulses, str | bytes)
    out = []
    for impulse in impulses if listed else [impulses]:
        if not isinstance(impulse, Mapping) or "time" not in impulse or not all(isinstance(k, str) for k in impulse):
            raise InputError(
                f"impulses: expected a dict such as {{'time': 2.0, 'm': (0, 0, 0.1)}}, or a list of them, got "
                f"{shown(impulse)}."
            )
        numbers = {}
        for letter, value in impulse.items():
            array = algebra.floats(value)
            if not np.isfinite(array).all():
                raise InputError(f"impulses: expected finite values for {letter}, got {shown(value)}.")
            numbers[letter] = array.tolist()
        time = finite_number(impulse["time"], "impulses: the time")
        if not 0 < time <= end * (1 + WHOLE):
            raise InputError(
                f"impulses: expected times after 0 and up to the end of the run, {end:g}, got {time:g}. Change the "
                "initial state for an impulse at time 0."
            )
        out.append({**numbers, "time": time})
    return tuple(sorted(out, key=lambda impulse: impulse["time"]))


def check_model(model: Any) -> None:
    """Raises `InputError` for anything but a system with its parameters."""
    if not isinstance(model, Model):
        needs = ", ".join(f"{p.letter}=..." for p in model.parameters) if isinstance(model, System) else ""
        raise InputError(
            f"A system with its parameters was expected, such as kr.LagrangeTop(p=(0, 0, 1)), got {shown(model)}."
            f"{f' Give it {needs} first.' if needs else ''}"
            f"{' This call needs the scaled system of the body: body.model().' if as_body(model) else ''}"
        )
    require_functions(model)
    if BODIES.get(model.system.name, model.system) is not model.system:
        raise InputError(
            f"name: expected one that no body of Kreisel has, got {shown(model.system.name)}. Give another to "
            "kr.perturbed(..., name=...)."
        )


def _observed_names(value: Any) -> tuple[str, ...] | None:
    if value is None:
        return None
    if isinstance(value, str) or not isinstance(value, Sequence) or not all(isinstance(v, str) for v in value):
        raise InputError(f"observe: expected a list of names of Casimirs and integrals, got {shown(value)}.")
    return tuple(value)


def observed(value: Any, scheme: Scheme) -> tuple[str, ...] | None:
    """The names of observed quantities, checked against this method.  Raises `InputError`."""
    names = _observed_names(value)
    observable = [k for k, outcome in scheme.outcomes.items() if outcome.kind not in ("state", "orientation")]
    for name in names or ():
        if name not in observable:
            raise InputError(
                f"observe: expected some of {', '.join(observable)}, got {shown(name)}.{hint(name, observable)} The "
                "state is always there."
            )
    return names


def checked_state(model: Model, x0: Any, time: float = 0.0) -> State:
    """The state of this system from the user's value, for a run that begins at that time.  Raises `InputError`."""
    frame, expected = x0.frame if isinstance(x0, State) else OF_SYSTEM, model.body_frame
    if frame and expected and frame is not expected and not frame.is_like(expected):
        raise InputError(
            "x0: expected a state of this body, got one of a body with other axes or units. Usual cause: a state that "
            "was made before the body was changed; make it again by body.state(...)."
        )
    if type(x0) is State and (state := model.again(x0)) is not None:
        return state
    if not isinstance(x0, Mapping):  # a State is accepted, and may belong to another system
        letters = ", ".join(f"{k}=..." for k in model.system.space.letters)
        several = ""
        if isinstance(x0, list | tuple) and x0 and all(isinstance(x, Mapping) for x in x0):
            several = " Pass several states as lanes: body.state(spin=[...]), or components of shape (lanes, ...)."
        raise InputError(
            f"The initial state must come from system.state({letters}), or be a dict or a row of a run, got "
            f"{shown(x0)}.{several}"
        )
    if hasattr(x0, "data_vars"):  # a row of a run, which has more variables than the state
        missing = [letter for letter in model.system.space.letters if letter not in x0]
        if missing and "kreisel_measured" in getattr(x0, "attrs", {}):
            raise InputError(
                "x0: expected a row of the run itself, got a result of units.measured, a plain Dataset in other units. "
                "Give x0=run.isel(time=-1)."
            )
        if missing:
            begin = "body.state(spin=row.angular_velocity, attitude=row.attitude)"
            fix = f" To begin there with another controller or other wheels: {begin}."
            controlled = model.system.perturbation is not None and model.system.perturbation.control is not None
            lacking = f"The Dataset lacks {', '.join(missing)} of a state of {model.system.name}."
            raise InputError(lacking + fix * controlled)
        row, x0 = x0, {letter: x0[letter] for letter in model.system.space.letters}
        _require_units_of_state(model, x0)
        _warn_of_clock(model, row, time)
    if isinstance(x0, State):  # its 3 x 3 matrix belongs to one state, for any number of lanes in the parameters
        x0 = {letter: v if x0.axial[letter].ndim > 1 else x0.axial[letter] for letter, v in x0.items()}
    return model.checked({str(letter): value for letter, value in x0.items()})


def _require_engine(name: Any) -> None:
    if not isinstance(name, str) or name not in ENGINES:
        near = "" if "gpu" in str(name).lower() else hint(name, ENGINES)  # which is like cpu
        raise InputError(
            f"engine: expected one of {', '.join(ENGINES)}, got {shown(name)}.{near} An NVIDIA GPU is 'cuda' (float64) "
            "or 'cuda-float32'; without one leave engine out, or say 'cpu'."
        )


def _warn_of_clock(model: Model, row: Any, begin: float) -> None:
    """Warns with `InputWarning` of a row of a run at another time than the start, if a force depends on the time."""
    record, time = model.system.perturbation, np.asarray(row.coords.get("time", 0.0))
    if record is not None and record.names(TIME) and time.shape == () and time != 0 and begin == 0:
        unit = model.body_frame.time_unit
        doubt(
            f"x0 is the row of a run at time {float(time * unit):g}, and a force of {model.system.name} depends on the "
            "time, which begins at 0 here. To continue from there, give t_start=row.time, or lengthen the run by "
            "kr.resume(path, extend=steps)."
        )


def _require_units_of_state(model: Model, x0: Mapping[str, Any]) -> None:
    """Raises `InputError` for a row of `units.measured`, whose axes or units are not the state's."""
    frame = model.body_frame
    for letter, value in x0.items():
        unit, turned = value.attrs.get("units", "1"), frame.turned and value.attrs.get(AXES) == BODY
        if turned or (frame.units and unit not in ("1", frame.attributes(letter)["units"])):
            raise InputError(
                f"x0: expected {letter} in the units and along the axes of the state, got others. Usual cause: a row "
                "of units.measured. Give a row of the run itself."
            )


def positive_number(value: Any, name: str) -> float:
    """A positive number.  Raises `InputError`."""
    if value is None:
        raise InputError(f"expected {name}, got none. Give {name}=..., a positive number.")
    array = algebra.floats(value)
    if array.ndim or not SHORTEST_STEP <= array < np.inf:
        negative = not array.ndim and array < 0 and name in ("dt", "t_end")
        back = (
            " To go back in time, reverse the momenta, and rotors and magnetic fields with them; if H has products of "
            "M and P, as in Steklov's case, the complete state and the parameters of terms of odd degree."
        )
        raise InputError(
            f"{name} must be a positive number, finite and at least {SHORTEST_STEP:g}, got {shown(value)}."
            f"{back if negative else ''}"
        )
    return float(array)


def named(value: Any, label: str) -> str | None:
    """A string, or None for the default.  Raises `InputError`."""
    if value is not None and (not isinstance(value, str) or not value):
        raise InputError(f"{label}: expected a name, got {shown(value)}. Leave {label} out for the default.")
    return value


def whole_order(value: Any, auto: bool = False) -> Any:
    """An order, a tuple of orders, or None for the default; integers of NumPy too; "auto" if allowed.

    Raises `InputError`.
    """
    if value is None or (auto and isinstance(value, str) and value == "auto"):
        return value
    if isinstance(value, str):
        raise InputError(f"order must be an integer, or 'auto' with method='baecklund', got {shown(value)}.")
    orders = [as_integer(v) for v in value] if isinstance(value, tuple | list) else [as_integer(value)]
    if not orders or not all(type(order) is int for order in orders):
        raise InputError(
            "order: expected an integer, or 'auto' with method='baecklund', or some with method='splitting', got "
            f"{shown(value)}."
        )
    return tuple(orders) if isinstance(value, tuple | list) else orders[0]


def as_integer(value: Any) -> Any:
    """An int if the value is an integer of any type, for example 1e6 or a NumPy integer; else the value itself."""
    number = value.item() if isinstance(value, np.generic | np.ndarray) and not value.ndim else value
    return int(number) if isinstance(number, float) and number.is_integer() else number


def within(value: Any, name: str, least: int = 1, most: int = MOST_STEPS) -> int:
    """An integer from `least` to `most`.  Raises `InputError`."""
    if type(value) is int and least <= value <= most:
        return value
    value = as_integer(value)
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise InputError(f"{name} must be an integer from {least:,} to {most:,}, got {shown(value)}.")
    return int(value)


def finite_number(value: Any, name: str) -> float:
    """A finite float.  Raises `InputError`."""
    if type(value) is float and math.isfinite(value):
        return value
    result = algebra.floats(value)
    if result.ndim or not np.isfinite(result):
        raise InputError(f"{name}: expected a finite number, got {shown(value)}.")
    return float(result)


def of_forces(model: Model) -> str:
    """Further causes of values that are not finite, if the model has forces."""
    if model.system.perturbation is None:
        return ""
    return "a force that is not a number there (a root of a negative number, a division by 0), "


def flag(value: Any, name: str) -> None:
    """Raises `InputError` for anything but true and false."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name}: expected True or False, got {shown(value)}.")


def initial_orientation(value: Any, model: Model) -> Array:
    """A rotation matrix (..., n, n), for n = 3 a unit quaternion (..., 4) or a Rotation, in the form to step."""
    if hasattr(value, "as_quat"):  # scipy.spatial.transform.Rotation
        value = value.as_quat(scalar_first=True)
    n = model.n
    return by_lane(partial(_orientation, n), value, single=lambda g: 2 if g.shape[-2:] == (n, n) else 1)


def _orientation(n: int, value: Any) -> Array:
    g = algebra.floats(value)
    if n == 3 and g.ndim >= 1 and g.shape[-1] == 4:
        length = np.sqrt((g * g).sum(-1, keepdims=True))
        if not (abs(length - 1) < ORTHOGONAL_TOLERANCE).all():
            raise InputError(f"The orientation quaternion (w, x, y, z) must have length 1, got {length.ravel()}.")
        return g / length
    quaternion = " or, for n = 3, a unit quaternion (w, x, y, z)" if n == 3 else ""
    if g.ndim < 2 or g.shape[-2:] != (n, n):
        start = "(1, 0, 0, 0)" if n == 3 else f"np.eye({n})"
        fix = "Leave it out" if value is False else f"Write orientation={start} to begin along the axes of space"
        raise InputError(
            f"The orientation must be a rotation matrix (..., {n}, {n}){quaternion}, got {shown(value)}. {fix}."
        )
    off = float(abs(g @ g.mT - np.eye(n)).max())
    if not off < ORTHOGONAL_TOLERANCE:
        raise InputError(f"The orientation must be orthogonal; g g^T - I is up to {off:.3g}.")
    if (np.linalg.det(g) < 0).any():
        raise InputError("The orientation must have determinant +1, got a reflection. Swap two columns.")
    return algebra.unit_quaternion(g) if n == 3 else g


def wanted_times(times: Any) -> np.ndarray:
    """A time, or times (times,), that a user requests.  Raises `InputError`."""
    if type(times) is float and math.isfinite(times):
        return np.array(times)
    wanted = np.array(algebra.floats(times))  # a copy: kernels do not accept read-only arrays
    if wanted.ndim > 1 or wanted.size == 0 or not np.isfinite(wanted).all():
        raise InputError(f"times must be a finite number or a list of them, at least one, got {shown(times)}.")
    return wanted


def count_of_rows(steps: int, every: int) -> int:
    """The number of rows of the steps 0, every, 2 every, ... and the last."""
    return 1 + steps // every + (steps % every > 0)


class NamedComponents(dict[str, Any]):
    """A state by name for functions of the user: a missing name is reported with the names."""

    def __missing__(self, name: Any) -> Any:
        raise LookupError(f"the state has {', '.join(self)}, not {shown(name)}")


@explained
@dataclass(frozen=True)
class Event:
    """A change of sign of a quantity of the state, at which the run stops or an action changes the state.

    quantity  a function of the state, `lambda x: x["a"][2]`; x has the letters of the system (axial vectors for n = 3),
              and g with an orientation
    action    a function of the state -> the state with which the run continues, as a dict of the same letters; None:
              the run stops there
    rising    True, False: only a change upward, downward; None: both

    The quantity is checked after each step, so two changes within a step are missed; the time is found to rounding.
    Raises `InputError` for anything but functions.
    """

    quantity: Callable[[Any], Any]
    action: Callable[[Any], Any] | None = None
    rising: bool | None = None

    def __post_init__(self) -> None:
        if not callable(self.quantity) or not (self.action is None or callable(self.action)):
            wrong = self.action if callable(self.quantity) else self.quantity
            raise InputError(f"kr.Event: expected functions of the state, got {shown(wrong)}.")
        if self.rising is not None:
            flag(self.rising, "rising")

    def __reduce__(self) -> Any:
        return _event, (Portable(self.quantity), Portable(self.action), self.rising)

    def acted(self, state: Mapping[str, Any]) -> Mapping[str, Any]:
        """The state after the action.  Raises `InputError` for a result with other names or shapes."""
        new = state if self.action is None else self.action(NamedComponents(state))
        expected = {letter: np.shape(value) for letter, value in state.items()}
        if not isinstance(new, Mapping) or {letter: np.shape(value) for letter, value in new.items()} != expected:
            shapes = ", ".join(f"{letter} {shape}" for letter, shape in expected.items())
            raise InputError(
                f"kr.Event: expected an action that returns the state, a dict of {shapes}, got {shown(new)}."
            )
        return new

    @property
    def name(self) -> str:
        """The names of its functions."""
        return " -> ".join(getattr(f, "__name__", "function") for f in (self.quantity, self.action) if f is not None)


def _event(quantity: Portable, action: Portable, rising: bool | None) -> Event:
    return Event(quantity.function, action.function, rising)


def checked_events(events: Any) -> tuple[Event, ...]:
    """One event or several.  Raises `InputError`."""
    result = (events,) if isinstance(events, Event) else () if events is None else events
    if not isinstance(result, Sequence) or not all(isinstance(event, Event) for event in result):
        raise InputError(f"events: expected kr.Event(quantity), or a list of them, got {shown(events)}.")
    return tuple(result)
