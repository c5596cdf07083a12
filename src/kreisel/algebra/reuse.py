"""What was recorded and compiled for a scheme, kept for the next run of the same kind.

A run of a few steps takes microseconds, and to record its step again takes milliseconds.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

Made = TypeVar("Made")


class Identity:
    """An object as a part of a key: itself, whatever is equal to it."""

    def __init__(self, what: Any):
        self._what = what

    def __hash__(self) -> int:
        return id(self._what)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Identity) and self._what is other._what


MOST = 1024  # kept; those of a scheme have 0.05 to 1 megabyte together
_cache: OrderedDict[Hashable, Any] = OrderedDict()
_one_at_a_time = Lock()


def forget() -> None:
    """Keep nothing of what was made until now."""
    with _one_at_a_time:
        _cache.clear()


def reused(key: Hashable | None, make: Callable[[], Made]) -> Made:
    """What `make` gave when it was last asked for by this key; None as a key, or as what it gives, keeps nothing."""
    if key is None:
        return make()
    with _one_at_a_time:
        if key in _cache:
            _cache.move_to_end(key)
            found: Made = _cache[key]
            return found
    made = make()  # not under the lock: two threads may both make it
    if made is not None:
        with _one_at_a_time:
            _cache[key] = made
            while len(_cache) > MOST:
                _cache.popitem(last=False)
    return made
