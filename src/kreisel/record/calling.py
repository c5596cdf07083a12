"""Functions of a record, called by the names of their arguments; user-defined ones tried at a point, and for pickle."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from kreisel.algebra import Array, flatten, restore
from kreisel.algebra.recorded import run
from kreisel.algebra.reuse import Identity, reused
from kreisel.errors import InputError, doubt, hint, shown

if TYPE_CHECKING:
    from kreisel.record.model import Model

Function = Callable[..., Any]
FIT = 1e-4  # of the largest entry: differences have errors of 1e-9
STEP = 0.01


def require_names(unnamed: tuple[Any, ...], label: str, letters: Sequence[str]) -> None:
    """Raises `InputError` if keyword arguments come without names."""
    if unnamed:
        if not letters:
            raise InputError(f"{label}: expected no arguments, got {shown(unnamed[0])}.")
        raise InputError(
            f"{label}: expected arguments by name, {', '.join(f'{k}=...' for k in letters)}; got {shown(unnamed[0])} "
            "without a name."
        )


_keywords: WeakKeyDictionary[Function, frozenset[str]] = WeakKeyDictionary()


def keywords(function: Function) -> frozenset[str]:
    """The keyword-only arguments that a function names."""
    function = getattr(function, "__func__", function)  # a method is a new object each time
    result = _keywords.get(function)
    if result is None:
        signature = inspect.signature(function)
        result = frozenset(p.name for p in signature.parameters.values() if p.kind is p.KEYWORD_ONLY)
        _keywords[function] = result
    return result


def arguments_of(function: Any, names: Sequence[str], name: str, remedy: str) -> tuple[str, ...]:
    """The arguments of a user-defined function, which are among `names`.  Raises `InputError` for others."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        raise InputError(
            f"{name}: expected a function that names its arguments, such as lambda {names[0]}: ..., got "
            f"{shown(function)}."
        ) from None
    for p in parameters:
        if p.kind not in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY) or p.name not in names:
            raise InputError(
                f"{name}: expected arguments among {', '.join(names)}, got {p.name}.{hint(p.name, names)} {remedy}"
            )
    return tuple(p.name for p in parameters)


def naming(function: Function, *sources: Function | Iterable[str]) -> Function:
    """The function, to which `call` passes the keywords of other functions, or those named."""
    names = {name: None for source in sources for name in (keywords(source) if callable(source) else source)}
    parameters = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY) for name in sorted(names)]
    state = inspect.Parameter("state", inspect.Parameter.VAR_POSITIONAL)
    function.__dict__["__signature__"] = inspect.Signature([state, *parameters])
    return function


def call(function: Function | None, state: tuple[Array, ...], available: Mapping[str, Any]) -> Any:
    """`function(*state, ...)` with just the keywords it names.

    Raises `InputError` if the record lacks the function, and if an operation of a user-defined function fails.
    """
    if function is None:
        raise InputError("The record of this system lacks a function that is needed here; see `kreisel systems NAME`.")
    names = keywords(function)
    return run(function, *state, **{k: v for k, v in available.items() if k in names})


@dataclass(frozen=True)
class Portable:
    """A user-defined function for pickle: by its name, or, if it cannot be imported by name, by cloudpickle."""

    function: Any

    def __deepcopy__(self, memo: dict[int, Any]) -> Portable:
        return self

    def __reduce__(self) -> Any:
        if "<" not in getattr(self.function, "__qualname__", ""):
            return Portable, (self.function,)
        try:
            import cloudpickle
        except ImportError:
            raise InputError(
                f"pickle: expected a function at the top level of a module, got {shown(self.function)}. Usual cause: a "
                "lambda. Name it there, or install cloudpickle."
            ) from None
        return _loaded, (cloudpickle.dumps(self.function),)


def _loaded(function: bytes) -> Portable:
    import cloudpickle

    return Portable(cloudpickle.loads(function))


# -- functions of a user-defined record, tried at a point ------------------------------------------------


def require_functions(model: Model) -> None:
    """Raises `InputError` for functions of a user-defined record that lack arguments or return other shapes.

    `InputWarning` if flow, energy and inverse_inertia do not fit.  Once for each record and n; the laws test more.
    """
    system = model.system
    if "_origin" in vars(system) or system.perturbation is not None or system.product or system.numbers == "jax":
        return
    if 0 not in model.batch:
        reused((__name__, Identity(system), model.n), partial(_try, model))


def _try(model: Model) -> bool:
    system, n = model.system, model.n
    constants = {k: v[(0,) * (v.ndim - model.axes[k])] for k, v in model.constants.items()}
    state, kinds = system.space.point(n, np.random.default_rng(1).standard_normal), dict(system.space.components)
    for name, function, returned in _functions(model):
        available = {**constants, "eps": STEP} if name == "map.step" else constants
        _require_arguments(model, name, function, [*available])
        with np.errstate(all="ignore"):
            out = call(function, state, available)
        if returned == "scalar":
            if np.shape(out) != ():
                raise InputError(f"{system.name}: {name}: expected one value, got the shape {np.shape(out)}.")
            continue
        parts = out if isinstance(out, tuple | list) else (out,)
        if len(parts) != len(kinds):
            got = f"{len(parts)} components" if isinstance(out, tuple | list) else f"the shape {np.shape(out)}"
            names = ", ".join(f"{k}'" for k in kinds) if name == "flow" else ", ".join(kinds)
            cause = "" if isinstance(out, tuple | list) else " Usual cause: no comma after a single component."
            raise InputError(f"{system.name}: {name}: expected a tuple ({names},) of {len(kinds)}, got {got}.{cause}")
        for (letter, kind), value, component in zip(kinds.items(), parts, state, strict=True):
            _require_kind(f"{system.name}: {name}: {letter}", kind, np.asarray(value), component.shape)
    if system.flow is not None and system.energy is not None:
        _require_fit(model, state, constants)
    return True


def _functions(model: Model) -> Iterator[tuple[str, Function, str]]:
    system = model.system
    if system.flow is not None:
        yield "flow", system.flow, "state"
    if system.energy is not None:
        yield "energy", system.energy, "scalar"
    if system.map is not None and system.map.rational:
        yield "map.step", system.map.step, "state"


def _require_arguments(model: Model, name: str, function: Function, constants: list[str]) -> None:
    system, letters = model.system, model.system.space.letters
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return
    write = f"Write def {name.split('.')[-1]}({', '.join([*letters, '*', *constants])})."
    if unknown := sorted(
        p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.default is p.empty and p.name not in constants
    ):
        raise InputError(
            f"{system.name}: {name}: expected keywords among the parameters, {', '.join(constants) or 'none'}, got "
            f"{', '.join(unknown)}. {write}"
        )
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    free = any(p.kind is p.VAR_POSITIONAL for p in parameters)
    if not free and (len(names) != len(letters) or (sorted(names) == sorted(letters) and names != list(letters))):
        raise InputError(
            f"{system.name}: {name}: expected the components of the state, {', '.join(letters)}, in order, and "
            f"parameters by keyword, got {', '.join(names) or 'none'}. {write}"
        )


def _require_kind(label: str, kind: str, value: Array, shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise InputError(f"{label} ({kind}): expected the shape {shape}, got {value.shape}.")
    sign = {"skew": 1, "symmetric": -1}.get(kind, 0)
    if sign and np.isfinite(value).all() and abs(value + sign * value.T).max() > FIT * abs(value).max():
        raise InputError(
            f"{label}: expected a {kind} matrix, of which only the entries i < j are used, got another. Usual cause: a "
            f"product of matrices; its {kind} part is (X {'-' if sign > 0 else '+'} X.mT) / 2."
        )


def _require_fit(model: Model, state: tuple[Array, ...], constants: Mapping[str, Any]) -> None:
    """Warns unless F' = {H, F} for the coordinates F, and inverse_inertia(M) = dH/dM, at one point."""
    space, n = model.system.space, model.n
    z = flatten(state, space.kinds)

    def energy(z: Array) -> float:
        return float(call(model.system.energy, restore(z, space.kinds, n), constants))

    h = 1e-5
    with np.errstate(all="ignore"):
        slope = np.array([(energy(z + h * e) - energy(z - h * e)) / (2 * h) for e in np.eye(len(z))])
        rate = flatten(call(model.system.flow, state, constants), space.kinds)
        bracket = slope @ np.asarray(call(space.tensor, state, constants), dtype=np.float64)
        off = abs(rate - bracket).max()
    if off > FIT * max(abs(rate).max(), abs(bracket).max()):
        places = [
            k
            for k, x, y in zip(space.letters, *(restore(v, space.kinds, n) for v in (rate, bracket)), strict=True)
            if abs(x - y).max() > FIT * abs(y).max()
        ]
        doubt(
            f"{model.system.name}: expected a flow F' = {{H, F}} of the energy H in the bracket of {space.name}, got "
            f"another {', '.join(f'{k}{chr(39)}' for k in places)}. Usual cause: a sign, a factor, or the other frame. "
            "Methods use one or the other; kreisel.lab.laws.check(system) tests all claims."
        )
    system = model.system
    if system.inverse_inertia is not None and system.spin is None and space.of_body:
        Omega = flatten((call(system.inverse_inertia, state[:1], constants),), ("skew",))
        if abs(Omega - slope[: len(Omega)]).max() > FIT * abs(slope).max():
            doubt(
                f"{system.name}: expected inverse_inertia(M) = dH/dM of the energy H, got another matrix. Usual "
                "cause: a factor, moments for their inverses, or an energy that is not T(M) + V. "
                "method='variational' uses it; kreisel.lab.laws.check(system) tests all claims."
            )
