"""A map of your own: a function step, and flow, lax and the like, which all take the state as the step does.

In coordinates, `names = ("x", "y")`, x an array (d,):

    step(x), flow(x), involution(x) -> d numbers;  tensor(x) -> (d, d);  lax(x, lam), conjugator(x, lam) -> (k, k);
    start(draw) -> d numbers

On e*(n), `n = 3`, M (n, n) skew, P (n,):

    step(M, P), flow(M, P), involution(M, P) -> (M, P);  lax(M, P, lam), conjugator(M, P, lam) -> (k, k)

Each of them takes, after that, the constants that it names, eps among them: flow(x, *, a).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, shown
from kreisel.lab.fields import Pole, fraction
from kreisel.lab.subject import Subject, subject
from kreisel.record.contract import MOVING_SPACE, REST_SPACE, Map, System

Function = Callable[..., Any]
OF_POINTS = ("flow", "involution")
OF_LAMBDA = ("lax", "conjugator")
BESIDE = (*OF_POINTS, "tensor", *OF_LAMBDA, "start")  # what may be known of a step
EXPECTED: dict[str, tuple[type[Exception], ...]] = {  # errors with which the instruments deal
    "step": (TypeError, AttributeError, ArithmeticError),
    **dict.fromkeys(OF_LAMBDA, (ArithmeticError,)),
}
POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


def in_coordinates(step: Function, names: Sequence[str], eps: Any, known: Mapping[str, Any]) -> Subject:
    """A step(x) as a subject; `known` has constants and the functions of `BESIDE`.  Raises `InputError`."""
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise InputError(f'names: expected those of the coordinates, such as ("x", "y"), got {shown(names)}.')
    functions, constants = _parted(known)
    taken = _parameters(step).get("eps")
    if taken is not None and "eps" not in constants:
        stated = None if taken.default is taken.empty else taken.default
        constants["eps"] = fraction(eps or stated or "1/3")
    beside: dict[str, Any] = {name: _of_coordinates(name, f, constants, len(names)) for name, f in functions.items()}
    of_x = _of_coordinates("step", step, constants, len(names))
    return Subject(getattr(step, "__name__", "step"), of_x, tuple(names), constants, **beside)


def on_group(step: Function, n: int, frame: str, eps: Any, known: Mapping[str, Any]) -> Subject:
    """A step(M, P) on e*(n) as a subject; `known` as in `in_coordinates`.  Raises `InputError`."""
    if frame not in ("moving", "rest"):
        raise InputError(f"frame must be 'moving' or 'rest', got {shown(frame)}.")
    functions, constants = _parted(known)
    if more := {"tensor", "start"} & functions.keys():
        raise InputError(
            f"{', '.join(sorted(more))}: expected none on e*({n}), whose bracket is known and whose coordinates are "
            'free. For another bracket give the coordinates, names=("M1", ...), and step(x).'
        )
    named = {k: np.asarray(v, dtype=object) for k, v in constants.items()}
    of_state: dict[str, Any] = {name: _of_state(name, f, named) for name, f in {"step": step, **functions}.items()}
    system = System(
        name=getattr(step, "__name__", "step"),
        title="a map of your own",
        equations="",
        source="",
        space=MOVING_SPACE if frame == "moving" else REST_SPACE,
        flow=of_state.pop("flow", None),
        scaling="",
        map=Map(**of_state),
        n=n,
    )
    return subject(system(), eps=eps)


def _parted(known: Mapping[str, Any]) -> tuple[dict[str, Function], dict[str, Any]]:
    """The functions and the constants."""
    functions = {name: known[name] for name in BESIDE if known.get(name) is not None}
    for name, f in functions.items():
        if not callable(f):
            raise InputError(f"{name}: expected a function of the state, as step is, got {shown(f)}.")
    return functions, {k: v for k, v in known.items() if k not in BESIDE}


def _parameters(function: Function) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):  # built in: without a signature
        return {}


def _taken(name: str, function: Function, state: Sequence[str], constants: Mapping[str, Any]) -> list[str]:
    """The constants that a function takes after the state.  Raises `InputError` for one that takes no state."""
    parameters = [*_parameters(function).values()]
    places = [p for p in parameters if p.kind in POSITIONAL]
    many = any(p.kind is p.VAR_POSITIONAL for p in parameters)
    after = [*places[len(state) :], *(p for p in parameters if p.kind is p.KEYWORD_ONLY)]
    missing = [p.name for p in after if p.default is p.empty and p.name not in constants]
    if (parameters and len(places) < len(state) and not many) or (missing and missing[0] in ("P", "lam")):
        raise InputError(
            f"{name}: expected {name}({', '.join(state)}), the state as the step takes it, and constants by keyword; "
            f"got {name}{inspect.signature(function)}."
        )
    if missing:
        raise InputError(
            f"{name}{inspect.signature(function)} takes {', '.join(missing)} by keyword: give their values. "
            f"The state is {', '.join(state)}."
        )
    every = any(p.kind is p.VAR_KEYWORD for p in parameters)
    return [*constants] if every else [p.name for p in after if p.name in constants]


def _of_coordinates(name: str, function: Function, constants: Mapping[str, Any], d: int) -> Function:
    """A function of coordinates, called with the constants that it takes and with an array of the right shape."""
    state = ["draw" if name == "start" else "x", *(["lam"] if name in OF_LAMBDA else [])]
    takes = _taken(name, function, state, constants)
    shape = {"flow": (d,), "involution": (d,), "start": (d,), "tensor": (d, d)}.get(name)

    def of_x(x: Any, *lam: Any, **values: Any) -> Any:
        value = _called(name, function, (x, *lam), {k: values.get(k, constants[k]) for k in takes})
        if shape is None:
            return value
        array = np.asarray(value, dtype=getattr(x, "dtype", object))
        if array.shape != shape:
            raise InputError(f"{name}: expected an array of the shape {shape}, got {array.shape}.")
        return array

    return of_x


def _of_state(name: str, function: Function, named: Mapping[str, Any]) -> Function:
    """A function of M, P as a function of a record."""
    more = name in OF_LAMBDA
    takes = _taken(name, function, ["M", "P", *(["lam"] if more else [])], {**named, "eps": None})

    def of_state(*state: Array, eps: Any, lam: Any = None) -> Any:
        values = {k: eps if k == "eps" else named[k] for k in takes}
        new = _called(name, function, (*state, lam) if more else state, values)
        if more:
            return new
        if not isinstance(new, tuple | list) or [np.shape(v) for v in new] != [np.shape(v) for v in state]:
            sizes = ", ".join(map(str, map(np.shape, state)))
            raise InputError(f"{name}: expected M and P, of the shapes {sizes}, got {shown(new)}.")
        return tuple(new)

    return of_state


def _called(name: str, function: Function, state: tuple[Any, ...], values: Mapping[str, Any]) -> Any:
    expected: tuple[type[Exception], ...] = (InputError, RunError, *EXPECTED.get(name, (Pole,)))
    try:
        return function(*state, **values)
    except expected:
        raise
    except Exception as error:  # whatever a user's code raises
        raise InputError(
            f"{name} failed: {type(error).__name__}: {error}. It takes the state as the step does, of numbers of any "
            "kind: + - * / and whole powers."
        ) from error
