"""Numbers without values, on which a formula is run once to record its operations; operations that they refuse."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType, TracebackType
from typing import Any

from kreisel.errors import InputError, brief

BRANCH = (
    "Usual cause: if, max, np.maximum, np.where, np.sign or np.clip. Write one formula without branches, such as "
    "(x + np.sqrt(x * x)) / 2 for the larger of x and 0."
)
ROUND = (
    "Usual cause: a function of the module math, float(x), int(x), or an array of floats that is filled with x. Use "
    "np.sin and the like, and np.array([x, y]) of the entries."
)
POWER = "Recorded are integer powers: use np.sqrt(x) for a root, and np.exp(y * np.log(x)) for a power of a positive x."
RECORDED = (
    "Recorded are + - * /, integer powers, np.sqrt, np.sin, np.cos, np.exp, np.log, and sums and products of arrays. "
    "Write the formula with these."
)
MISSING = re.compile(r"no callable (\w+) method|'(?:Traced)?Number' object has no attribute '(\w+)'")
LINE = 100  # characters of a user's line that a message shows
LIBRARIES = ("site-packages", "dist-packages")


class NotRecorded(InputError, TypeError):
    """An operation that cannot be recorded; also a `TypeError`, for callers that try several kinds of number.

    place  of the operation in a user-defined function, as text; "" if it is not known
    """

    def __init__(self, operation: str, fix: str, place: str = ""):
        self.operation, self.fix, self.place = operation, fix, place
        InputError.__init__(
            self,
            f"{place}{': ' if place else ''}expected a formula without branches, of operations that can be recorded, "
            f"got {operation}. The function is run once, on numbers without values, and its operations are compiled. "
            f"{fix}",
        )


def _refused(operation: str, fix: str) -> Callable[..., Any]:
    def refuse(*_: Any) -> Any:
        raise NotRecorded(operation, fix)

    return refuse


def _compared(sign: str) -> Callable[[Any, Any], Any]:
    def compare(_: Any, other: Any) -> Any:
        if other is None or isinstance(other, str):
            return NotImplemented
        raise NotRecorded(f"the comparison x {sign} y", BRANCH)

    return compare


class Recorded:
    """A number without a value: comparisons, truth and rounding raise `NotRecorded`."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]
    __eq__, __ne__ = _compared("=="), _compared("!=")
    __lt__, __le__, __gt__, __ge__ = map(_compared, ("<", "<=", ">", ">="))
    __bool__ = _refused("the truth of a number, as in `if x`", BRANCH)
    __float__ = __complex__ = _refused("a conversion to a float, as in math.sin(x)", ROUND)
    __int__ = __index__ = _refused("a conversion to an integer", ROUND)
    __round__ = __trunc__ = __floor__ = __ceil__ = _refused("a rounding to an integer", ROUND)
    __floordiv__ = __mod__ = __divmod__ = _refused("a remainder or an integer quotient", RECORDED)


def run(function: Callable[..., Any], *values: Any, **named: Any) -> Any:
    """The value of a function of a record.

    Raises `NotRecorded`, with the place, for a nonarithmetic error in a user-defined function.
    """
    try:
        return function(*values, **named)
    except (TypeError, AttributeError, ValueError, LookupError, NameError) as error:
        complete = error.place if isinstance(error, NotRecorded) else isinstance(error, InputError)
        place = "" if complete else _place(error.__traceback__) or _name(function)
        if not place:
            raise
        raise _explained(error, place) from error


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
    return package not in ("kreisel", *sys.stdlib_module_names) and not any(name in file for name in LIBRARIES)
