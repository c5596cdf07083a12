"""Recordings and kernels of a scheme, kept for the next run of the same kind.

A run of a few steps lasts microseconds, but recording its step again lasts milliseconds.  Values that belong to an
object, such as a user-defined system, are stored in the object and vanish with it.
"""

from __future__ import annotations

import gc
import os
from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from types import FunctionType
from typing import Any, Generic, TypeVar, overload
from weakref import WeakValueDictionary

Made = TypeVar("Made")
Value = TypeVar("Value")


class Identity:
    """An object as a part of a key, compared by identity."""

    def __init__(self, subject: Any):
        self._subject = subject

    def __hash__(self) -> int:
        return id(self._subject)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Identity) and self._subject is other._subject

    @property
    def place(self) -> dict[str, Any] | None:
        """The dictionary for values of the object; None for a function, which cloudpickle would send with it."""
        result = None if isinstance(self._subject, FunctionType) else getattr(self._subject, "__dict__", None)
        return result if isinstance(result, dict) else None


class Table(OrderedDict[Hashable, Any]):
    """Values by key, the least recently used first."""


MOST = 1024  # entries for one system, or for no system; all entries of a scheme need 0.05 to 1 megabyte
KEPT = "_kept"  # the attribute in which an object stores its table
_tables: WeakValueDictionary[int, Table] = WeakValueDictionary()
_of_none = _tables[0] = Table()
_one_at_a_time = Lock()
_without_garbage: set[object] = set()  # the calls during which Python collects none


def _after_fork() -> None:
    """Another thread of the process from which this one was forked may have held the lock, or stopped collections."""
    global _one_at_a_time
    _one_at_a_time = Lock()
    if _without_garbage:
        _without_garbage.clear()
        gc.enable()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def forget() -> None:
    """Discard everything stored until now."""
    with _one_at_a_time:
        for table in list(_tables.values()):
            table.clear()


def _place(key: Hashable) -> dict[str, Any] | None:
    """The dictionary of the first object in a key that has one."""
    for entry in key if type(key) is tuple else ():
        place = entry.place if type(entry) is Identity else _place(entry)
        if place is not None:
            return place
    return None


def _table(key: Hashable) -> Table:
    """The table of the first object in a key, or the common table."""
    place = _place(key)
    if place is None:
        return _of_none
    if KEPT not in place:
        place[KEPT] = _tables[id(place)] = Table()
    table: Table = place[KEPT]
    return table


def _uncollected(make: Callable[[], Made]) -> Made:
    """The result of `make`, without collections of garbage, a third of the time of writing a graph of 10^5 objects."""
    if not gc.isenabled():
        return make()
    call = object()
    _without_garbage.add(call)
    gc.disable()
    try:
        return make()
    finally:
        gc.enable()
        _without_garbage.discard(call)


def reused(key: Hashable | None, make: Callable[[], Made]) -> Made:
    """The result of `make` for this key, from the last call if stored; a key or a result None is not stored."""
    if key is None:
        return _uncollected(make)
    with _one_at_a_time:
        table = _table(key)
        if key in table:
            table.move_to_end(key)
            result: Made = table[key]
            return result
    value = _uncollected(make)  # outside the lock: two threads may both compute it
    if value is not None:
        with _one_at_a_time:
            table[key] = value
            while len(table) > MOST:
                table.popitem(last=False)
    return value


class cached_property(Generic[Value]):
    """A property that is computed on first access and stored in the object's `__dict__`, without a lock.

    Two threads at once may both compute it; both get the value of one of them.  `functools.cached_property` of Python
    3.11 has a lock for all objects of a class: a process forked while another thread computes such a property waits for
    it forever.
    """

    def __init__(self, function: Callable[[Any], Value]):
        self.func, self.__doc__ = function, function.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> cached_property[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...
    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            return self
        return instance.__dict__.setdefault(self._name, self.func(instance))
