"""Functions of a record, called by the names of their arguments; user-defined functions for pickle."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from kreisel.algebra import Array
from kreisel.algebra.recorded import run
from kreisel.errors import InputError, hint, shown

Function = Callable[..., Any]


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
