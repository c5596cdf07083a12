"""The one exception for bad input: what was expected, what was given, and the fix."""

from __future__ import annotations

import contextlib
import difflib
import errno
import signal
from collections.abc import Callable, Iterable, Iterator

LONGEST = 1500  # characters of a message: what was expected stands at its head, the fix at its end
SHOWN = 100  # characters of a value in it


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
    """' Did you mean 'x'?' for the known word most like `word`, or nothing."""
    if not isinstance(word, str):
        return ""
    close = difflib.get_close_matches(word[:SHOWN], list(known), n=1, cutoff=0.5)
    return f" Did you mean {close[0]!r}?" if close else ""
