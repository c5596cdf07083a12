"""The exceptions of Kreisel: messages with the expected and the given value, and the fix."""

from __future__ import annotations

import builtins
import contextlib
import difflib
import errno
import functools
import inspect
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from types import FunctionType
from typing import Any, TypeVar

LONGEST = 1500  # characters of a message: the expectation is at its head, the fix at its end
SHOWN = 100  # characters of a value in it
MEANT = 4  # names that a part of a name may match
SYNONYMS = {"volume": "displaced_mass", "moments": "inertia", "love_number": "love"}  # names unlike in letters
BRIEF = 40  # of one in a call
MOST_FAULTS = 20  # of a file in a message
FRACTION = re.compile(r"Fraction\((-?\d+), (\d+)\)")
NUMPY = re.compile(r"(?<!['\"])\bnp\.(?:float|int|uint)\d+\(([^()]*)\)")
UNLOADED = ("Dataset", "DataArray", "Model")  # classes that signatures name but modules import only for type checkers
F = TypeVar("F", bound=Callable[..., Any])


def printable(text: object) -> str:
    """Text on one line with control characters written out: control characters of a file could drive a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in str(text))


def shown(value: object) -> str:
    """A short text of any value for a message."""
    try:
        text = repr(value)
    except Exception:  # an integer with more digits than Python prints, or an exception of a user's class
        digits = f" of {value.bit_length():,} bits" if isinstance(value, int) else ""
        return f"a value of type {type(value).__name__}{digits}"
    return brief(text, SHOWN)


def counted(count: int, noun: str) -> str:
    """A number of things in words: "1 step", "1,000 steps"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def brief(text: object, most: int = LONGEST) -> str:
    """Printable text, shortened in the middle if it is longer; fractions and NumPy's values in their usual form."""
    plain = NUMPY.sub(r"\1", printable(text))
    readable, end = FRACTION.sub(lambda m: m[1] if m[2] == "1" else f"{m[1]}/{m[2]}", plain), most // 3
    return readable if len(readable) <= most else f"{readable[: most - end - 5]} ... {readable[-end:]}"


class InputError(ValueError):
    """Input that cannot be used.  The message states the expected value, the given value, and the fix.

    Several messages, a line each, if a file has several mistakes.
    """

    def __init__(self, *messages: object):
        ValueError.__init__(self, *map(brief, messages))

    def __str__(self) -> str:
        return "\n".join(self.args)


class Faults:
    """Mistakes in a file, noted so that one message has all of them."""

    def __init__(self) -> None:
        self.messages: list[str] = []

    def add(self, message: str) -> None:
        """Note a mistake, once."""
        if message not in self.messages:
            self.messages.append(message)

    @contextlib.contextmanager
    def noted(self, place: str) -> Iterator[None]:
        """A context whose `InputError` is noted, with its place in the file in front."""
        try:
            yield
        except InputError as error:
            for message in error.args:  # a package that is missing is named once
                self.add(message if "pip install" in message else f"{place}: {message}")

    def report(self, source: str) -> None:
        """Raises `InputError` if there are mistakes."""
        if len(self.messages) == 1:
            raise InputError(f"{source}: {self.messages[0]}")
        if self.messages:
            remainder = [f"  and {len(self.messages) - MOST_FAULTS} more"] * (len(self.messages) > MOST_FAULTS)
            count = f"{source}: expected a file without mistakes, got {len(self.messages)}:"
            raise InputError(count, *(f"  {message}" for message in self.messages[:MOST_FAULTS]), *remainder)


class RunError(RuntimeError):
    """A run that had to stop, for example because a state is no longer finite or a disk is full."""

    def __init__(self, message: object):
        RuntimeError.__init__(self, brief(message))


class ConservationWarning(UserWarning):
    """A run with an invariant of the method that is not conserved, far beyond rounding errors."""


class AccuracyWarning(UserWarning):
    """A run whose error is probably larger than it should be: a step too long for the forces, a chaotic motion."""


class InputWarning(UserWarning):
    """Input that is possible but seldom meant: degrees for radians, km for m."""


def doubt(sentence: str, kind: type[Warning] = InputWarning) -> None:
    """Warns at the line that called Kreisel."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "kreisel":
        frame, level = frame.f_back, level + 1
    warnings.warn(sentence, kind, stacklevel=level)


class Stopped(RunError):
    """A run or a sweep that a signal stopped; its results are kept in `part`, from which `remedy` resumes it."""

    def __init__(self, number: int, done: str, archive: object, remedy: str):
        self.number = number
        name = signal.Signals(number).name
        RunError.__init__(self, f"stopped by {name} after {done}, which are kept in {archive}; {remedy} resumes.")


def disk_trouble(error: OSError, path: object, action: str, kept: str) -> RunError:
    """The error of the file system as one message with the fix."""
    fix = {
        errno.ENOSPC: "The disk is full: free some space, save less often (every), or choose another disk.",
        errno.EDQUOT: "The disk quota is used up: free some space or choose another disk.",
        errno.EACCES: "Choose a folder that you may write to.",
        errno.EROFS: "The file system is read-only: choose another folder.",
        errno.ENOTDIR: "A part of the path is a file: choose another folder.",
        errno.ENAMETOOLONG: "Choose a shorter name.",
    }.get(error.errno or 0, "Check the path and the disk.")
    return RunError(f"{path} could not {action}: {error.strerror or error}. {fix}{kept}")


@contextlib.contextmanager
def on_disk(path: object, action: str, kept: Callable[[], str] = str) -> Iterator[None]:
    """A context that reports errors of the file system as `RunError` with the fix; `kept` states the safe data."""
    try:
        yield
    except OSError as error:
        raise disk_trouble(error, path, action, kept()) from error


def hint(word: object, words: Iterable[str]) -> str:
    """' Did you mean 'x'?' for the one of `words` most like `word`, or those that contain it; or nothing."""
    if not isinstance(word, str):
        return ""
    names = [name for name in words if name != word and not name.startswith("_")]
    close = sorted((name for name in names if word.lower() in name.split("-")), key=lambda name: name.count("-"))[
        :MEANT
    ]
    close = close or [name for name in names if name == SYNONYMS.get(word)]
    close = close or difflib.get_close_matches(word[:SHOWN], names, n=1)
    return f" Did you mean {' or '.join(map(repr, close))}?" if close else ""


def require_one_of(names: Collection[str], name: object, argument: str) -> None:
    """Raises `InputError` for another name, with the known name most like it."""
    if not isinstance(name, str) or name not in names:
        raise InputError(f"{argument}: expected one of {', '.join(names)}, got {shown(name)}.{hint(name, names)}")


def explained(call: F) -> F:
    """The function or class with an `InputError` for misfitting arguments, which shows the correct call.

    Misfitting are missing, superfluous and unknown arguments; and arguments of another type than in the signature, if
    the call ends in an exception that is not Kreisel's.  Any other exception is unchanged.  For a class: its public
    methods too.
    """
    if isinstance(call, type):
        maker = "__new__" if issubclass(call, tuple) else "__init__"
        public = {name: value for name, value in vars(call).items() if not name.startswith("_")}
        for name, value in {**public, maker: getattr(call, maker)}.items():
            if isinstance(value, classmethod | staticmethod):
                setattr(call, name, type(value)(explained(value.__func__)))
            elif name == maker or isinstance(value, FunctionType):
                setattr(call, name, explained(value))
        return call

    @functools.wraps(call)
    def checked(*values: Any, **named: Any) -> Any:
        try:
            return call(*values, **named)
        except (InputError, RunError):
            raise
        except Exception as error:
            if isinstance(error, TypeError):
                try:
                    inspect.signature(call).bind(*values, **named)
                except TypeError:
                    raise InputError(_misfit(call, values, named)) from None
            if fault := _mistyped(call, values, named):
                raise InputError(fault) from error
            raise

    return checked  # type: ignore[return-value]


def _mistyped(call: Callable[..., Any], arguments: tuple[Any, ...], named: Mapping[str, Any]) -> str:
    """The first argument whose type differs from the signature, as a message; "" if there is none."""
    bound = inspect.signature(call).bind(*arguments, **named).arguments
    for name, kind in call.__annotations__.items():
        bare = kind if isinstance(kind, str) else ""
        while "[" in bare:  # "str | Sequence" of "str | Sequence[int | str]"
            bare = re.sub(r"\[[^\[\]]*\]", "", bare)
        if name in bound and bare and not any(_is_of(bound[name], k, call) for k in bare.split(" | ")):
            return f"{_title(call)}: expected {name} of the type {kind}, got {shown(bound[name])}."
    return ""


def _is_of(value: Any, kind: str, call: Callable[..., Any]) -> bool:
    """Whether a value is of a type, named as in the module of the function; true for names without a class."""
    if kind in ("int", "float"):
        quantity = isinstance(value, str) or hasattr(value, "magnitude")
        return (hasattr(value, "__float__") and not getattr(value, "ndim", 0)) or (kind == "float" and quantity)
    first, *remainder = kind.split(".")
    result = call.__globals__.get(first, getattr(builtins, first, None))
    for attribute in remainder:
        result = getattr(result, attribute, None)
    if isinstance(result, type) and result is not Any:
        return isinstance(value, (list, tuple) if result is tuple else result)
    if kind.split(".")[-1] in UNLOADED:
        return any(kind.split(".")[-1] == base.__name__ for base in type(value).__mro__)
    return kind != "None" or value is None


def _title(call: Callable[..., Any]) -> str:
    return call.__qualname__.removesuffix(".__init__").removesuffix(".__new__").split("<locals>.")[-1]


def _misfit(call: Callable[..., Any], values: tuple[Any, ...], named: Mapping[str, Any]) -> str:
    """The reason why these arguments do not fit, and the call that would: for the first fault."""
    parameters = list(inspect.signature(call).parameters.values())
    maker: Any = None
    of_class: Any = None  # the parameters of the class to which a class method hands its **others
    if parameters and parameters[0].name == "cls" and values and isinstance(values[0], type):
        of_class = inspect.signature(values[0]).parameters
    if parameters and parameters[0].name in ("self", "cls", "_cls"):
        maker = type(values[0]) if parameters[0].name == "self" and not call.__name__.startswith("__") else None
        parameters, values = parameters[1:], values[1:]
    of_maker = inspect.signature(maker).parameters if maker else {}
    title, names = _title(call), [p.name for p in parameters]
    first = [p.name for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD]
    needed = [
        p.name for p in parameters if p.default is p.empty and p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    ]
    filled, any_name = dict(zip(names, values, strict=False)), any(p.kind is p.VAR_KEYWORD for p in parameters)
    missing = ", ".join(name for name in needed if name not in filled and name not in named)
    write = f"Write {title}({_written_call(names, first, needed, filled, named)})."
    most = f"at most {counted(len(names), 'argument')}, {', '.join(names)}" if names else "no arguments"
    by_position = f"expected {counted(len(first), 'argument')} by position and the others by name"
    unknown = [k for k in named if k not in names and (k not in of_class if of_class and any_name else not any_name)]
    twice = [name for name in first[: len(values)] if name in named]
    if unknown:
        name, listed = unknown[0], ", ".join(names) or "none"
        way = f" {maker.__name__}(..., {name}=...) has it." if name in of_maker else _on_files(call, named.values())
        return f"{title} has no argument {shown(name)}.{hint(name, names)} Its arguments are: {listed}.{way}"
    if twice:
        return f"{title}: expected {twice[0]} once, got it by position, {shown(filled[twice[0]])}, and by name."
    if len(values) > len(names):
        return f"{title}: expected {most}, got {len(values)}."
    if len(values) > len(first):
        return f"{title}: {by_position}, got {len(values)} by position.{_on_files(call, values) or ' ' + write}"
    return f"{title}: expected {missing}, got none. {write}"


def _on_files(call: Callable[..., Any], values: Iterable[Any]) -> str:
    """The call that writes a file, from the docstring of a function that does not, if the name of a file is given."""
    example = re.search(r"`(kr\.\w+\(run\)\.save\w*\([^`]+\))`", call.__doc__ or "")
    files = any(isinstance(value, str | os.PathLike) and os.path.splitext(value)[1] for value in values)
    return f" A file is written by {example[1]}." if example and files else ""


def _written_call(
    names: list[str], first: list[str], needed: list[str], filled: Mapping[str, Any], named: Mapping[str, Any]
) -> str:
    by_name = {name: filled[name] for name in names[len(first) : len(filled)]} | dict(named)
    words = [name for name in first if name in needed or name in names[: len(filled)]]
    texts = {name: shown(value) for name, value in by_name.items() if name not in words}
    words += [f"{name}={text if len(text) < BRIEF else '...'}" for name, text in texts.items()]
    return ", ".join([*words, *(f"{name}=..." for name in needed if name not in words and name not in by_name)])
