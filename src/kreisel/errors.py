"""The one exception for bad input: what was expected, what came, and the fix."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Input that cannot be used.  The message says what was expected, what came, and how to mend it."""


class RunError(RuntimeError):
    """A run that had to stop: a state that is no longer finite, a disk that is full."""


def nearest(word: str, known: Iterable[str]) -> str:
    """' Did you mean 'x'?' for the known word most like `word`, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f" Did you mean {close[0]!r}?" if close else ""
