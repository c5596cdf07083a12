"""The one exception for bad input: what was expected, what was given, and the fix."""

from __future__ import annotations

import contextlib
import difflib
import errno
import functools
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

LONGEST = 1500  # characters of a message: what was expected stands at its head, the fix at its end
SHOWN = 100  # characters of a value in it
MEANT = 4  # names that a part of a name may mean
BRIEF = 40  # of one in a call
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
    """Printable text, its middle left out where it is longer."""
    readable, end = printable(text), most // 3
    return readable if len(readable) <= most else f"{readable[: most - end - 5]} ... {readable[-end:]}"


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
    names = list(known)
    close = sorted((name for name in names if word.lower() in name.split("-")), key=lambda name: name.count("-"))[
        :MEANT
    ]
    close = close or difflib.get_close_matches(word[:SHOWN], names, n=1, cutoff=0.5)
    return f" Did you mean {' or '.join(map(repr, close))}?" if close else ""


def explained(call: F) -> F:
    """The same function or class, whose misfitting arguments are an `InputError` that says how to call it.

    An error that is raised inside of it stays as it is.
    """
    if isinstance(call, type):
        made = "__new__" if issubclass(call, tuple) else "__init__"
        setattr(call, made, explained(getattr(call, made)))
        for name, value in list(vars(call).items()):
            if isinstance(value, classmethod) and not name.startswith("_"):
                setattr(call, name, classmethod(explained(value.__func__)))
        return call

    @functools.wraps(call)
    def checked(*given: Any, **named: Any) -> Any:
        try:
            return call(*given, **named)
        except TypeError as error:
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise
            raise InputError(_misfit(call, given, named)) from None

    return checked  # type: ignore[return-value]


def _misfit(call: Callable[..., Any], given: tuple[Any, ...], named: Mapping[str, Any]) -> str:
    """Why these arguments do not fit, and the call that would."""
    import inspect

    known = list(inspect.signature(call).parameters.values())
    if known and known[0].name in ("self", "cls", "_cls"):
        known, given = known[1:], given[1:]
    what = call.__qualname__.removesuffix(".__init__").removesuffix(".__new__").split("<locals>.")[-1]
    names, first = [p.name for p in known], [p.name for p in known if p.kind is p.POSITIONAL_OR_KEYWORD]
    needed = [p.name for p in known if p.default is p.empty and p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    filled = dict(zip(names, given, strict=False))
    if unknown := next((name for name in named if name not in names), None):
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
