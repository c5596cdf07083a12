"""JSON and TOML that somebody else may have written: data that is nested no deeper than ours ever is.

A parser, a printer or a copy of nested data calls itself once a level, so that a few kilobytes of brackets end in a
`RecursionError` somewhere.  Every text is read here, and nothing deeper gets further.
"""

from __future__ import annotations

import json
from typing import Any

from kreisel.errors import InputError

DEEPEST = 32  # levels; a sweep's description needs six
NESTING = (dict, list, tuple)


def parsed(text: str | bytes, what: str) -> Any:
    """The data in a JSON text; `what` names it in the message.  Raises `InputError`."""
    try:
        value = json.loads(text)
    except RecursionError:
        raise InputError(_too_deep(what)) from None
    except ValueError as error:
        raise InputError(f"{what} is damaged, it is not valid JSON: {error}.") from error
    return shallow(value, what)


def shallow(value: Any, what: str) -> Any:
    """The value itself.  Raises `InputError` where lists and tables are nested too deep."""
    level = [value]
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in _inside(outer)]
    if any(isinstance(rest, NESTING) for rest in level):
        raise InputError(_too_deep(what))
    return value


def _inside(value: Any) -> Any:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, NESTING) else ()


def _too_deep(what: str) -> str:
    return (
        f"{what} is nested too deep: at most {DEEPEST} lists or tables inside one another were expected. "
        "It is damaged, or was not made by Kreisel."
    )
