"""The one exception for bad input: what was expected, what came, and the fix."""

from __future__ import annotations

import difflib
import errno
import signal
from collections.abc import Iterable


class InputError(ValueError):
    """Input that cannot be used.  The message says what was expected, what came, and how to mend it."""


class RunError(RuntimeError):
    """A run that had to stop: a state that is no longer finite, a disk that is full."""


class ConservationWarning(UserWarning):
    """A run in which something that the method conserves is not conserved, far beyond what rounding explains."""


class Stopped(RunError):
    """A run that was told to stop by a signal; what it had done is kept, and it can go on."""

    def __init__(self, number: int, steps: int, part: object):
        self.number = number
        name = str(part).removesuffix(".part")
        super().__init__(
            f"stopped by {signal.Signals(number).name} after {steps:,} steps. All of them are kept in {part}; "
            f"`kreisel resume {name}` goes on."
        )


class Interrupted(RunError):
    """A sweep that was told to stop by a signal; the blocks that were done are kept."""

    def __init__(self, number: int, done: int, total: int, part: object):
        self.number = number
        super().__init__(
            f"stopped by {signal.Signals(number).name} after {done:,} of {total:,} blocks, which are kept in {part}; "
            "the same command goes on."
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


def nearest(word: str, known: Iterable[str]) -> str:
    """' Did you mean 'x'?' for the known word most like `word`, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f" Did you mean {close[0]!r}?" if close else ""
