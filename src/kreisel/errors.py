"""The one exception for bad input: what was expected, what was given, and the fix."""

from __future__ import annotations

import builtins
import contextlib
import difflib
import errno
import functools
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import FunctionType
from typing import Any, TypeVar

LONGEST = 1500  # characters of a message: what was expected stands at its head, the fix at its end
SHOWN = 100  # characters of a value in it
MEANT = 4  # names that a part of a name may mean
BRIEF = 40  # of one in a call
FRACTION = re.compile(r"Fraction\((-?\d+), (\d+)\)")
NUMPY = re.compile(r"\bnp\.(?:float|int|uint)\d+\(([^()]*)\)")
UNLOADED = ("Dataset", "DataArray", "Model")  # classes that signatures name and modules import for type checkers only
F = TypeVar("F", bound=Callable[..., Any])


def printable(text: object) -> str:
    """Text on one line whose control characters are written out: those of a file could drive a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in str(text))


def shown(value: object) -> str:
    """A value as it may stand in a message, briefly, whatever it is."""
    try:
        text = repr(value)
    except Exception:  # a whole number of more digits than Python prints, or what a class of the user's raises
        digits = f" of {value.bit_length():,} bits" if isinstance(value, int) else ""
        return f"a value of type {type(value).__name__}{digits}"
    return brief(text, SHOWN)


def brief(text: object, most: int = LONGEST) -> str:
    """Printable text, its middle left out where it is longer; fractions and NumPy's numbers as they are written."""
    readable, end = FRACTION.sub(_written, NUMPY.sub(r"\1", printable(text))), most // 3
    return readable if len(readable) <= most else f"{readable[: most - end - 5]} ... {readable[-end:]}"


def _written(fraction: re.Match[str]) -> str:
    return fraction[1] if fraction[2] == "1" else f"{fraction[1]}/{fraction[2]}"


class InputError(ValueError):
    """Input that cannot be used.  The message says what was expected, what was given, and how to mend it."""

    def __init__(self, message: object):
        ValueError.__init__(self, brief(message))


class RunError(RuntimeError):
    """A run that had to stop: a state that is no longer finite, a disk that is full."""

    def __init__(self, message: object):
        RuntimeError.__init__(self, brief(message))


class ConservationWarning(UserWarning):
    """A run in which something that the method conserves is not conserved, far beyond what rounding explains."""


class AccuracyWarning(UserWarning):
    """A run whose error is probably larger than it should be: a step too long for the forces, a chaotic motion."""


class InputWarning(UserWarning):
    """Input that is possible and seldom meant: degrees for radians, km for m."""


def doubt(sentence: str) -> None:
    """Warns with `InputWarning` at the line that called Kreisel."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "kreisel":
        frame, level = frame.f_back, level + 1
    warnings.warn(sentence, InputWarning, stacklevel=level)


class Stopped(RunError):
    """A run that a signal stopped; what it had done is kept, and it can go on."""

    def __init__(self, number: int, steps: int, part: object):
        self.number = number
        name = str(part).removesuffix(".part")
        RunError.__init__(
            self,
            f"stopped by {signal.Signals(number).name} after {steps:,} steps. All of them are kept in {part}; "
            f"`kreisel resume {name}` goes on.",
        )


class Interrupted(RunError):
    """A sweep that a signal stopped; the blocks that were done are kept."""

    def __init__(self, number: int, done: int, total: int, part: object):
        self.number = number
        RunError.__init__(
            self,
            f"stopped by {signal.Signals(number).name} after {done:,} of {total:,} blocks, which are kept in {part}; "
            "the same command goes on.",
        )


def disk_trouble(error: OSError, path: object, what: str, kept: str) -> RunError:
    """What the file system says, as one message with the fix."""
    fix = {
        errno.ENOSPC: "The disk is full: free some space, save less often (every), or choose another disk.",
        errno.EDQUOT: "The disk quota is used up: free some space or choose another disk.",
        errno.EACCES: "Choose a folder that you may write to.",
        errno.EROFS: "The file system is read-only: choose another folder.",
        errno.ENOTDIR: "A part of the path is a file: choose another folder.",
        errno.ENAMETOOLONG: "Choose a shorter name.",
    }.get(error.errno or 0, "Check the path and the disk.")
    return RunError(f"{path} could not {what}: {error.strerror or error}. {fix}{kept}")


@contextlib.contextmanager
def on_disk(path: object, what: str, kept: Callable[[], str] = str) -> Iterator[None]:
    """Inside, what the file system says becomes a `RunError` with the fix; `kept` says what is not lost."""
    try:
        yield
    except OSError as error:
        raise disk_trouble(error, path, what, kept()) from error


def hint(word: object, known: Iterable[str]) -> str:
    """' Did you mean 'x'?' for the known word most like `word`, or for those of which it is a part; or nothing."""
    if not isinstance(word, str):
        return ""
    names = [name for name in known if name != word and not name.startswith("_")]
    close = sorted((name for name in names if word.lower() in name.split("-")), key=lambda name: name.count("-"))[
        :MEANT
    ]
    close = close or difflib.get_close_matches(word[:SHOWN], names, n=1, cutoff=0.5)
    return f" Did you mean {' or '.join(map(repr, close))}?" if close else ""


def explained(call: F) -> F:
    """The same function or class, whose misfitting arguments are an `InputError` that says how to call it.

    Misfitting are missing, superfluous and unknown arguments; and arguments of another type than in the signature, if
    the call ends in an exception that is not Kreisel's.  Any other exception is unchanged.  For a class: its public
    methods too.
    """
    if isinstance(call, type):
        made = "__new__" if issubclass(call, tuple) else "__init__"
        setattr(call, made, explained(getattr(call, made)))
        for name, value in list(vars(call).items()):
            if isinstance(value, classmethod | staticmethod) and not name.startswith("_"):
                setattr(call, name, type(value)(explained(value.__func__)))
            elif isinstance(value, FunctionType) and not name.startswith("_"):
                setattr(call, name, explained(value))
        return call

    @functools.wraps(call)
    def checked(*given: Any, **named: Any) -> Any:
        try:
            return call(*given, **named)
        except (InputError, RunError):
            raise
        except Exception as error:
            if isinstance(error, TypeError) and error.__traceback__ and error.__traceback__.tb_next is None:
                raise InputError(_misfit(call, given, named)) from None
            if fault := _mistyped(call, given, named):
                raise InputError(fault) from error
            raise

    return checked  # type: ignore[return-value]


def _mistyped(call: Callable[..., Any], given: tuple[Any, ...], named: Mapping[str, Any]) -> str:
    """The first argument of another type than in the signature, as a message; "" if there is none."""
    import inspect

    bound = inspect.signature(call).bind(*given, **named).arguments
    for name, kind in call.__annotations__.items():
        if name in bound and isinstance(kind, str) and not any(_is_of(bound[name], k, call) for k in _union(kind)):
            return f"{_title(call)}: expected {name} of the type {kind}, got {shown(bound[name])}."
    return ""


def _union(kind: str) -> list[str]:
    """The types of a union without their brackets: ["str", "Sequence"] for "str | Sequence[int | str]"."""
    while "[" in kind:
        kind = re.sub(r"\[[^\[\]]*\]", "", kind)
    return kind.split(" | ")


def _is_of(value: Any, kind: str, call: Callable[..., Any]) -> bool:
    """Whether a value is of a type, named as in the module of the function; true for names that are not of a class."""
    if kind in ("int", "float"):
        quantity = isinstance(value, str) or hasattr(value, "magnitude")
        return (hasattr(value, "__float__") and not getattr(value, "ndim", 0)) or (kind == "float" and quantity)
    first, *rest = kind.split(".")
    found = call.__globals__.get(first, getattr(builtins, first, None))
    for part in rest:
        found = getattr(found, part, None)
    if isinstance(found, type) and found is not Any:
        return isinstance(value, (list, tuple) if found is tuple else found)
    if kind.split(".")[-1] in UNLOADED:
        return any(kind.split(".")[-1] == base.__name__ for base in type(value).__mro__)
    return kind != "None" or value is None


def _title(call: Callable[..., Any]) -> str:
    """The name of a function or class as in a message."""
    return call.__qualname__.removesuffix(".__init__").removesuffix(".__new__").split("<locals>.")[-1]


def _misfit(call: Callable[..., Any], given: tuple[Any, ...], named: Mapping[str, Any]) -> str:
    """Why these arguments do not fit, and the call that would."""
    import inspect

    known = list(inspect.signature(call).parameters.values())
    if known and known[0].name in ("self", "cls", "_cls"):
        known, given = known[1:], given[1:]
    what = _title(call)
    names, first = [p.name for p in known], [p.name for p in known if p.kind is p.POSITIONAL_OR_KEYWORD]
    needed = [p.name for p in known if p.default is p.empty and p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    filled = dict(zip(names, given, strict=False))
    any_name = any(p.kind is p.VAR_KEYWORD for p in known)
    if unknown := next((name for name in named if name not in names and not any_name), None):
        there = ", ".join(names) or "none"
        return f"{what} has no argument {shown(unknown)}.{hint(unknown, names)} Its arguments are: {there}."
    if twice := next((name for name in first[: len(given)] if name in named), None):
        return f"{what}: expected {twice} once, got it by position, {shown(filled[twice])}, and by name."
    if len(given) > len(names):
        most = f"at most {_arguments(len(names))}, {', '.join(names)}" if names else "no arguments"
        return f"{what}: expected {most}, got {len(given)}."
    by_name = {name: filled[name] for name in names[len(first) : len(given)]}
    words = [name for name in first if name in needed or name in names[: len(given)]]
    for name, value in (by_name | dict(named)).items():
        text = shown(value)
        words += [f"{name}={text if len(text) < BRIEF else '...'}"] if name not in words else []
    words += [f"{name}=..." for name in needed if name not in words and name not in by_name and name not in named]
    if by_name:
        fault = f"expected {_arguments(len(first))} by position and the others by name, got {len(given)} by position"
    else:
        fault = f"expected {', '.join(n for n in needed if n not in filled and n not in named)}, got none"
    return f"{what}: {fault}. Write {what}({', '.join(words)})."


def _arguments(count: int) -> str:
    return f"{count} argument{'s' * (count != 1)}"
