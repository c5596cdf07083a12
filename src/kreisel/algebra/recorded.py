"""Numbers without values, on which a formula is run once to record its operations; operations that they refuse.

Their comparisons are `Condition`s, by which NumPy's np.where, np.minimum, np.maximum, np.clip, np.sign and
abs choose values: their method `where_less(x, y, yes, no)` records the choice.  The derivative of a choice is the
derivative of the chosen value.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType, TracebackType
from typing import Any

import numpy as np

from kreisel.errors import InputError, brief

BRANCH = (
    "Usual cause: if, max, min, or np.where and the like on an array that np.array made of such symbols. Use "
    "np.where(x > 0, y, z), np.maximum(x, y), np.clip(x, low, high) or np.sign(x), and np.stack([x, y]) for "
    "np.array([x, y])."
)
ROUND = (
    "Usual cause: a function of the module math, float(x), int(x), or an array of floats that is filled with x. Use "
    "np.sin and the like, and np.array([x, y]) of the entries."
)
POWER = "Recorded are integer powers: use np.sqrt(x) for a root, and np.exp(y * np.log(x)) for a power of a positive x."
RECORDED = (
    "Recorded are + - * /, integer powers, np.sqrt, np.sin, np.cos, np.exp, np.log, abs, np.sign, np.minimum, "
    "np.maximum, np.clip, np.where, and sums and products of arrays. Write the formula with these."
)
MISSING = re.compile(r"no callable (\w+) method|'(?:Traced)?Number' object has no attribute '(\w+)'")
LINE = 100  # characters of a user's line that a message shows
LIBRARIES = ("site-packages", "dist-packages")
NO_USER = frozenset(("kreisel", *sys.stdlib_module_names))


class NotRecorded(InputError, TypeError):
    """An operation that cannot be recorded; also a `TypeError`, for callers that try several kinds of number.

    place  of the operation in a user-defined function, as text; "" if it is not known
    """

    def __init__(self, operation: str, fix: str, place: str = ""):
        self.operation, self.fix, self.place = operation, fix, place
        InputError.__init__(
            self,
            f"{place}{': ' if place else ''}expected operations that can be recorded, and no `if`, "
            f"got {operation}. The function is run once, on symbols without values, and its operations are compiled. "
            f"{fix}",
        )


def _refused(operation: str, fix: str) -> Callable[..., Any]:
    def refuse(*_: Any) -> Any:
        raise NotRecorded(operation, fix)

    return refuse


def _compared(sign: str) -> Callable[[Any, Any], Any]:
    def compare(_: Any, operand: Any) -> Any:
        if operand is None or isinstance(operand, str):
            return NotImplemented
        raise NotRecorded(f"the comparison x {sign} y", BRANCH)

    return compare


# -- choices -----------------------------------------------------------------------------------------


def where_less(x: Any, y: Any, yes: Any, no: Any) -> Any:
    """`yes` if x < y, else `no`, of any kind of real value; recorded values define it."""
    numbers = [v for v in (x, y, yes, no) if hasattr(v, "where_less")]
    outer: Any = next((v for v in numbers if getattr(v, "traces", False)), None)
    if outer is None and any(isinstance(v, np.ndarray) and v.dtype == object for v in (x, y, yes, no)):
        return np.frompyfunc(where_less, 4, 1)(*map(_plain, (x, y, yes, no)))
    if numbers:
        return (numbers[0] if outer is None else outer).where_less(x, y, yes, no)
    test = x < y
    return np.where(test, yes, no) if isinstance(test, np.ndarray) else yes if test else no


class Dispatched:
    """A value that NumPy's functions treat as an entry of a `RecordedArray`."""

    __slots__ = ()

    def __array_ufunc__(self, ufunc: Any, method: Any, *inputs: Any, **kwargs: Any) -> Any:
        return _applied(ufunc, method, inputs, kwargs)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return function(*map(_as_array, args), **{name: _as_array(x) for name, x in kwargs.items()})


class Condition(Dispatched):
    """A recorded comparison: `choose(yes, no)` records one of two values; `&`, `|` and `~` join conditions.

    As a factor it is 1 if it holds, else 0; its truth, as in `if x > 0`, raises `NotRecorded`.
    """

    __slots__ = ("choose", "text")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, choose: Callable[[Any, Any], Any], text: str):
        self.choose, self.text = choose, text

    def __bool__(self) -> bool:
        raise NotRecorded(f"the truth of {self.text}", BRANCH)

    def __and__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented
        return Condition(lambda yes, no: self.choose(_chosen(other, yes, no), no), self.text)

    def __or__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented
        return Condition(lambda yes, no: self.choose(yes, _chosen(other, yes, no)), self.text)

    def __invert__(self) -> Condition:
        return Condition(lambda yes, no: self.choose(no, yes), self.text)

    __rand__, __ror__ = __and__, __or__

    def __mul__(self, other: Any) -> Any:
        return self.choose(1, 0) * other

    __rmul__ = __mul__


def _chosen(condition: Any, yes: Any, no: Any) -> Any:
    return condition.choose(yes, no) if isinstance(condition, Condition) else yes if condition else no


def _comparison(x: Any, y: Any) -> Condition:
    return Condition(lambda yes, no: where_less(x, y, yes, no), "a comparison, as in `if x < y`")


def _ordered(condition: Callable[[Any, Any], Condition]) -> Callable[[Any, Any], Any]:
    return lambda x, y: NotImplemented if isinstance(y, np.ndarray) else condition(x, y)


def sign(x: Any) -> Any:
    """-1, 0 or 1."""
    return where_less(x, 0, -1, where_less(0, x, 1, 0))


def _clipped(x: Any, low: Any, high: Any) -> Any:
    x = x if low is None else where_less(x, low, low, x)
    return x if high is None else where_less(high, x, high, x)


def _of_numbers(name: str) -> Callable[[Any], Any]:
    """A function of NumPy of one entry, which may be a float."""
    return lambda x: getattr(x, name)() if hasattr(x, name) else getattr(np, name)(x)


# Functions of NumPy, by name, of the entries of arrays.
ENTRYWISE: dict[str, Callable[..., Any]] = {
    "less": lambda x, y: x < y,
    "less_equal": lambda x, y: x <= y,
    "greater": lambda x, y: x > y,
    "greater_equal": lambda x, y: x >= y,
    "minimum": lambda x, y: where_less(y, x, y, x),
    "maximum": lambda x, y: where_less(x, y, y, x),
    "sign": sign,
    "fabs": abs,
    "clip": _clipped,
    "where": _chosen,
    "logical_and": lambda x, y: x & y,
    "bitwise_and": lambda x, y: x & y,
    "logical_or": lambda x, y: x | y,
    "bitwise_or": lambda x, y: x | y,
    "logical_not": lambda x: ~x if isinstance(x, Condition) else not x,
    "invert": lambda x: ~x if isinstance(x, Condition) else not x,
    **{name: _of_numbers(name) for name in ("sqrt", "sin", "cos", "exp", "log")},
}


class RecordedArray(np.ndarray):
    """An array on which comparisons and choices are recorded; user-defined functions get these."""

    def __array_ufunc__(self, ufunc: Any, method: Any, *inputs: Any, **kwargs: Any) -> Any:
        return _applied(ufunc, method, inputs, kwargs)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.clip or (function is np.where and len(args) == 3):
            low_high = (kwargs.get("a_min", kwargs.get("min")), kwargs.get("a_max", kwargs.get("max")))
            inputs = (*args, *low_high[len(args) - 1 :]) if function is np.clip else args
            return _entrywise(function.__name__, "__call__", [*map(_plain, inputs)], {})
        if not all(issubclass(kind, np.ndarray) for kind in types):
            return function(*map(_as_array, args), **{name: _as_array(x) for name, x in kwargs.items()})
        return _wrapped(super().__array_function__(function, types, args, kwargs))


def _applied(function: Any, method: str, inputs: Any, named: dict[str, Any]) -> Any:
    """The result of a function of NumPy, as a `RecordedArray` if it is an array."""
    values = [*map(_plain, inputs)]
    if "out" in named:
        named["out"] = tuple(map(_plain, named["out"]))
    if function.__name__ in ENTRYWISE:
        return _entrywise(function.__name__, method, values, named)
    return _wrapped(getattr(function, method)(*values, **named))


def _entrywise(name: str, method: str, values: list[Any], named: dict[str, Any]) -> Any:
    count = 2 if method == "reduce" else len(values)
    return _wrapped(getattr(np.frompyfunc(ENTRYWISE[name], count, 1), method)(*values, **named))


def _as_array(x: Any) -> Any:
    """A recorded number as an array without axes; also the entries of a list."""
    if isinstance(x, list | tuple):
        return type(x)(map(_as_array, x)) if type(x) in (list, tuple) else x
    return _wrapped(_plain(x)) if isinstance(x, Dispatched) else x


def _plain(x: Any) -> Any:
    """An array of NumPy that its functions do not hand over."""
    if isinstance(x, RecordedArray):
        return x.view(np.ndarray)
    if isinstance(x, Dispatched):
        out = np.empty((), dtype=object)
        out[()] = x
        return out
    return x


def _wrapped(x: Any) -> Any:
    """A `RecordedArray` of an array of objects; other values unchanged."""
    return x.view(RecordedArray) if isinstance(x, np.ndarray) and x.dtype == object else x


class Recorded(Dispatched):
    """A number without a value: equality, truth and rounding raise `NotRecorded`; < and > are `Condition`s."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]
    __eq__, __ne__ = _compared("=="), _compared("!=")
    __bool__ = _refused("the truth of a number, as in `if x`", BRANCH)
    __float__ = __complex__ = _refused("a conversion to a float, as in math.sin(x)", ROUND)
    __int__ = __index__ = _refused("a conversion to an integer", ROUND)
    __round__ = __trunc__ = __floor__ = __ceil__ = _refused("a rounding to an integer", ROUND)
    __floordiv__ = __mod__ = __divmod__ = _refused("a remainder or an integer quotient", RECORDED)

    __lt__, __gt__ = _ordered(lambda x, y: _comparison(x, y)), _ordered(lambda x, y: _comparison(y, x))
    __le__, __ge__ = _ordered(lambda x, y: ~_comparison(y, x)), _ordered(lambda x, y: ~_comparison(x, y))

    def __abs__(self) -> Any:
        return where_less(self, 0, -self, self)  # type: ignore[operator]


# -- user-defined functions --------------------------------------------------------------------------


def run(function: Callable[..., Any], *values: Any, **named: Any) -> Any:
    """The value of a function of a record.

    User-defined functions get arrays of recorded values as `RecordedArray`.  Raises `NotRecorded`, with the place, for
    a nonarithmetic error in a user-defined function.
    """
    try:
        if not of_user(function):
            return function(*values, **named)
        out = function(*map(_wrapped, values), **{name: _wrapped(x) for name, x in named.items()})
        return tuple(map(_plain_array, out)) if type(out) is tuple else _plain_array(out)
    except (TypeError, AttributeError, ValueError, LookupError, NameError) as error:
        complete = error.place if isinstance(error, NotRecorded) else isinstance(error, InputError)
        place = "" if complete else _place(error.__traceback__) or _name(function)
        if not place:
            raise
        raise _explained(error, place) from error


def of_user(function: Callable[..., Any]) -> bool:
    """Whether a function is user-defined."""
    function = getattr(function, "func", function)  # of a partial
    code = getattr(function, "__code__", None)
    return code is None or _of_user(getattr(function, "__module__", None) or "", code)


def _plain_array(x: Any) -> Any:
    return x.view(np.ndarray) if isinstance(x, RecordedArray) else x


def _explained(error: Exception, place: str) -> NotRecorded:
    if isinstance(error, NotRecorded):
        return NotRecorded(error.operation, error.fix, place)
    missing = MISSING.search(str(error))
    operation = f"np.{missing[1] or missing[2]}" if missing else f"{type(error).__name__}: {error}"
    return NotRecorded(operation, RECORDED, place)


def _place(trace: TracebackType | None) -> str:
    """The innermost line of user code in a traceback, with its function."""
    import traceback

    frames = [at for at in traceback.walk_tb(trace) if _of_user(at[0].f_globals.get("__name__", ""), at[0].f_code)]
    if not frames:
        return ""
    names = [frame.f_code.co_name for frame, _ in frames]
    name = next((name for name in reversed(names) if name[0] != "<"), names[-1])  # not a comprehension
    (last,) = traceback.StackSummary.extract(frames[-1:])
    return f"{name} ({Path(last.filename).name}, line {last.lineno}" + (
        f": {brief(last.line, LINE)})" if last.line else ")"
    )


def _name(function: Callable[..., Any]) -> str:
    """The name of a user-defined function, for errors raised before it begins."""
    code = getattr(function, "__code__", None)
    if code is None or not _of_user(getattr(function, "__module__", None) or "", code):
        return ""
    return str(code.co_name)


def _of_user(module: str, code: CodeType) -> bool:
    package, file = module.split(".")[0], code.co_filename
    return package not in NO_USER and not any(name in file for name in LIBRARIES)
