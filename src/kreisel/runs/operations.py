"""User-defined systems: their files, and SHA-256 of their operations, to which an archive, without code, is bound.

A function is run once on recorded values.  The digest covers the operations on which its values depend: values in
closures and globals, but neither comments nor names nor dead code.  A function that cannot be recorded has the digest
of its code, with the plain values, arrays and functions that it refers to.  So has an action of an event, which may
have side effects; lists and dicts, to which it may append, are left out.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import inspect
import itertools
import math
import runpy
import traceback
import types
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra.reuse import Identity, reused
from kreisel.errors import InputError, hint, shown
from kreisel.files import parsed
from kreisel.graph.graph import Graph, Number, array_of
from kreisel.method.scheme import ORIENTATION
from kreisel.record.calling import call, keywords
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.record.perturbation import FIRST, SECOND, TIME, Controller, Force
from kreisel.record.units import OF_SYSTEM, BodyFrame

if TYPE_CHECKING:
    from kreisel.runs.plan import Plan
    from kreisel.runs.settings import Event

MOST_NODES = 5_000  # of a graph; a longer function has the digest of its code
NOT_RUN = {"lax", "relations", "conjugator", "lagrangian", "involution", "regularity", "darboux", "case", "pair_case"}
NOT_RUN |= {"draw", "tensor", "momentum", "state", "body_frame", "parameters", "perturbation", "product", "defect"}
NOT_RUN |= {"pencil", "factors", "notes"}  # "state": the check of states


def operations_of(model: Model) -> str | None:
    """SHA-256 of the operations of a user-defined system; None for a system of Kreisel."""
    from kreisel.bodies import KNOWN

    if KNOWN.get(model.system.name) is model.system:
        return None
    return reused((__name__, Identity(model.system), model.n), lambda: _sha(_of_system(model.system, model)))


def require_operations(model: Model, expected: str | None) -> None:
    """Raises `InputError` if the functions of a user-defined system differ from the functions of a run."""
    if operations_of(model) != expected:
        raise InputError(
            f"system: expected {model.system.name} with the functions of the run, got other functions under this name. "
            "Usual cause: a sign, a component or a value in a force was changed since; of a function with branches, "
            "another version of Python. Give the system as it was, or begin a new run from the last row of this one."
        )


def events_of(plan: Plan) -> list[dict[str, Any]]:
    """The events of a plan: names, directions, whether they act, the operations of both functions."""
    shapes = {name: plan.example[name].shape[1:] for name in (*plan.start, ORIENTATION) if name in plan.example}

    def state(graph: Graph) -> tuple[tuple[Any, ...], dict[str, Any]]:
        numbers = _numbers(graph)
        return ({name: _filled(numbers, shape) for name, shape in shapes.items()},), {}

    def description(event: Event) -> dict[str, Any]:
        parts = [_recorded(event.quantity, state), None if event.action is None else _code(event.action)]
        return {"name": event.name, "rising": event.rising, "acts": event.action is not None, "sha256": _sha(parts)}

    return [description(event) for event in plan.events]


def require_events(plan: Plan, expected: str | None) -> None:
    """Raises `InputError` if the events of a plan differ from the attribute `events` of a run."""
    result, wanted = events_of(plan), [] if expected is None else parsed(expected, "The attribute events")
    if result == wanted:
        return
    names = [", ".join(f"{e['name']} (rising={e['rising']})" for e in listed) or "none" for listed in (wanted, result)]
    got = names[1] if names[0] != names[1] else "other functions under these names"
    raise InputError(
        f"events: expected the events of the run, {shown(names[0])}, which an archive does not hold, got "
        f"{shown(got)}. Give "
        "them as they were: kr.resume(path, events=...)."
    )


def _sha(parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()


# -- of a system ---------------------------------------------------------------------------------------


def _of_system(system: System, model: Model) -> Any:
    """The functions that decide the motion and the outputs; for a perturbed system, of its parts and forces."""
    from kreisel.bodies import KNOWN

    if KNOWN.get(system.name) is system:
        return system.name
    if system.product:
        factors = [
            (factor.system, type(model)(factor.system, factor.constants(model.params))) for factor in system.product
        ]
        return [_of_system(*factor) for factor in factors]
    record = system.perturbation
    if record is None:
        about = system.frame.value, system.space.components, system.space.sign, system.n, system.numbers
        return about, sorted(_of_record(system, model))
    forces = {**record.functions, **({} if record.pair is None else {"pair": record.pair})}
    flags = record.damping, record.inertia, record.coupling, record.inner
    law = () if record.control is None else (_of_law(record.control, model),)
    return _of_system(record.base, model), flags, sorted((k, _of_force(f, model)) for k, f in forces.items()), *law


def _of_record(record: Any, model: Model) -> Iterator[tuple[str, Any]]:
    """The functions of a record and of the records in it, by name."""
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if field.name in NOT_RUN or value is None:
            continue
        if dataclasses.is_dataclass(value):
            yield from ((f"{field.name}.{name}", result) for name, result in _of_record(value, model))
        elif isinstance(value, Mapping):
            for name, function in value.items():
                for i, member in enumerate(function if isinstance(function, tuple) else (function,)):
                    yield f"{field.name}.{name}.{i}", _recorded(member, _state_of(model))
        elif callable(value):
            yield field.name, _recorded(value, _state_of(model))


def _state_of(model: Model) -> Callable[[Graph], Any]:
    """The arguments of a function of a record: the state, and its keyword arguments."""

    def arguments(graph: Graph) -> Any:
        numbers = _numbers(graph)
        state = tuple(_component(kind, model.n, numbers, axial=False) for kind in model.system.space.kinds)
        constants = {name: _filled(numbers, _shape(model, name)) for name in sorted(model.constants)}
        return state, constants | {name: graph.input(name, 0) for name in ("eps", "lam", "mu", "rho", TIME)}

    return arguments


def _of_force(force: Force, model: Model) -> Any:
    kinds = dict(model.system.space.components)

    def arguments(graph: Graph) -> Any:
        numbers = _numbers(graph)

        def of(letter: str) -> Any:
            name = letter if letter in (*kinds, ORIENTATION, TIME) else letter.removesuffix(FIRST).removesuffix(SECOND)
            kind = "matrix" if name == ORIENTATION else "scalar" if name == TIME else kinds[name]
            return _component(kind, model.n, numbers, axial=True)

        values = tuple(of(letter) for letter in force.arguments)
        return values, force.named(_filled(numbers, _shape(model, name)) for name in force.parameters)

    return force.arguments, force.parameters, _recorded(force.function, arguments)


def _of_law(control: Controller, model: Model) -> Any:
    """The law of a controller, and all that is stated about it."""
    from kreisel.forces.control import SENSORS
    from kreisel.forces.kicks import WHEELS

    shapes = {**SENSORS, WHEELS: (control.wheels,), **control.memory}

    def arguments(graph: Graph) -> Any:
        numbers = _numbers(graph)
        values = [_filled(numbers, shapes[k] if k in shapes else _shape(model, k)) for k in control.arguments]
        named = dict(zip(control.arguments, values, strict=True))
        later = keywords(control.law) if control.law else ()
        return tuple(value for name, value in named.items() if name not in later), named

    about = {field.name: getattr(control, field.name) for field in dataclasses.fields(control) if field.name != "law"}
    return repr(about), None if control.law is None else _recorded(control.law, arguments)


def _shape(model: Model, name: str) -> tuple[int, ...]:
    shape = np.shape(model.constants[name])
    return shape[len(shape) - model.axes[name] :]


def _component(kind: str, n: int, numbers: Iterator[Number], axial: bool) -> Any:
    form = algebra.KINDS[kind].shown(n) if axial else algebra.KINDS[kind]
    return form.unpack(_filled(numbers, (form.count(n),)), n)


def _numbers(graph: Graph) -> Iterator[Number]:
    return (graph.input("z", i) for i in itertools.count())


def _filled(numbers: Iterator[Number], shape: tuple[int, ...]) -> Any:
    return array_of([*itertools.islice(numbers, math.prod(shape))]).reshape(shape)[()]


# -- of a function -------------------------------------------------------------------------------------


def _recorded(function: Callable[..., Any], arguments: Callable[[Graph], Any]) -> Any:
    """The digest of the operations of a function of recorded values, or else of its code."""
    graph = Graph(most=MOST_NODES)
    try:
        values, constants = arguments(graph)
        return graph.digest(list(_numbers_in(call(function, values, constants))))
    except Exception:  # any exception of a function that does not accept recorded values
        return _code(function)


def _numbers_in(value: Any) -> Iterator[Any]:
    if isinstance(value, Mapping):
        for name in sorted(value):
            yield name
            yield from _numbers_in(value[name])
    elif isinstance(value, tuple | list):
        for entry in value:
            yield from _numbers_in(entry)
    elif isinstance(value, Number | str):
        yield value
    else:
        array = np.asarray(value)
        yield str(array.shape)
        yield from (v if isinstance(v, Number) else float(v) for v in array.flat)


def _code(x: Any, seen: frozenset[int] = frozenset()) -> Any:
    """The content of a value; for a function, its code and everything that it refers to."""
    if x is None or isinstance(x, bool | int | float | complex | str | bytes | types.EllipsisType):
        return repr(x)
    if id(x) in seen:
        return "again"
    seen |= {id(x)}
    if isinstance(x, np.ndarray | np.generic) and x.dtype != object:
        return x.dtype.str, x.shape, x.tobytes()
    if isinstance(x, tuple):
        return [_code(entry, seen) for entry in x]
    if isinstance(x, frozenset):
        return sorted(repr(_code(entry, seen)) for entry in x)
    if isinstance(x, functools.partial):
        return _code((x.func, x.args, tuple(sorted(x.keywords.items()))), seen)
    if isinstance(x, types.MethodType):
        return _code((x.__func__, x.__self__), seen)
    if isinstance(x, types.CodeType):
        constants = [_code(c, seen) for c in x.co_consts]
        return x.co_code, constants, x.co_argcount, x.co_kwonlyargcount, x.co_flags
    function = inspect.unwrap(x) if callable(x) and not isinstance(x, type) else x
    if isinstance(function, types.FunctionType):
        return _function(function, seen)
    if isinstance(x, type | types.ModuleType | types.BuiltinFunctionType):
        return getattr(x, "__qualname__", x.__name__)
    if dataclasses.is_dataclass(x) or callable(x):
        parts = getattr(x, "__dict__", {})
        return type(x).__qualname__, [(name, _code(entry, seen)) for name, entry in sorted(parts.items())]
    return type(x).__qualname__


def _function(f: types.FunctionType, seen: frozenset[int]) -> Any:
    """Code, defaults, closure and globals; functions of libraries, Kreisel's too, by their names and closures."""
    defaults = _code((f.__defaults__, tuple(sorted((f.__kwdefaults__ or {}).items()))), seen)
    contents = []
    for cell in f.__closure__ or ():
        with contextlib.suppress(ValueError):  # an empty cell
            contents.append(cell.cell_contents)
    cells = [_code(value, seen) for value in contents]
    module = f.__module__ or ""  # of functions that exec created: none
    if module.partition(".")[0] == "kreisel" or "site-packages" in f.__code__.co_filename:
        return module, f.__qualname__, defaults, cells
    globals_used = [
        _code(f.__globals__[name], seen) if name in f.__globals__ else name for name in _names_in(f.__code__)
    ]
    code = f.__code__
    if f.__doc__ is not None and code.co_consts[:1] == (f.__doc__,):
        code = code.replace(co_consts=(None, *code.co_consts[1:]))
    return _code(code, seen), defaults, cells, globals_used


def _names_in(code: types.CodeType) -> list[str]:
    inner = [
        name for constant in code.co_consts if isinstance(constant, types.CodeType) for name in _names_in(constant)
    ]
    return [*code.co_names, *inner]


# -- of a file ------------------------------------------------------------------------------------


def load_system(
    name: str, file: Path | None, values: Mapping[str, Any] | None = None, frame: BodyFrame = OF_SYSTEM
) -> System:
    """The system of that name: a known one, with these parameters, or from `file`.  Raises `InputError`."""
    from kreisel.bodies import KNOWN, known_system

    if file is None:
        return known_system(name, values or {}, frame)
    if not file.is_file():
        raise InputError(f"No file {file}, which [system] names; it is looked for next to the TOML file.")
    systems = own_systems(executed(file))
    if name in systems:
        if systems[name].name in KNOWN:
            raise InputError(
                f"{file} calls its system {shown(systems[name].name)}, as one of Kreisel's is called. Choose "
                "another name."
            )
        return systems[name]
    raise InputError(
        f"{file} defines no system called {shown(name)} at its top level.{hint(name, systems)} "
        f"There are: {', '.join(systems) or 'none'}; make one with kreisel.reduction.system(name, ...) or "
        "kr.perturbed(...)."
    )


def executed(file: Path) -> dict[str, Any]:
    """The names that a Python file defines at its top level.  Raises `InputError` with the line of any exception."""
    try:
        return runpy.run_path(str(file))
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except (Exception, SystemExit) as error:  # any exception of a user's code
        where = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == str(file)]
        line = f", line {where[-1].lineno}" if where else f", line {getattr(error, 'lineno', '?')}"
        guard = ". Call sys.exit only below `if __name__ == '__main__':`." * isinstance(error, SystemExit)
        raise InputError(f"{file}{line}: {type(error).__name__}: {error}{guard}") from error


def own_systems(defined: dict[str, Any]) -> dict[str, System]:
    """The user-defined systems among them; perturbed systems also by the name of the variable."""
    from kreisel.bodies import KNOWN

    systems = {value.name: value for value in defined.values() if isinstance(value, System)}
    perturbed = {
        name: value.system
        for variable, value in defined.items()
        if isinstance(value, Model) and value.system.perturbation is not None
        for name in (variable, value.system.name)
    }
    return {k: v for k, v in (systems | perturbed).items() if KNOWN.get(k) is not v}
