"""Properties that are computed once, without a lock.

`functools.cached_property` of Python 3.11 has a lock for all objects of a class.  A process that is forked while
another thread computes such a property waits for it without end.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

Value = TypeVar("Value")


class cached_property(Generic[Value]):
    """A property that is computed when it is first asked for, and is kept in the object's `__dict__`.

    Two threads that ask at once may both compute it; both get the value of one of them.
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
