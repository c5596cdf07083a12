"""Checks of what comes from outside: paths, runs, and JSON and TOML of a bounded depth.

Parsers, printers and copies recurse once a level: a few kilobytes of brackets would end in a `RecursionError`
somewhere.  So every text is read here, and data nested deeper than Kreisel's own is refused.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.errors import InputError, shown

if TYPE_CHECKING:
    import xarray as xr

DEEPEST = 32  # levels; a sweep's description needs six
MOST_BITS = 4096  # of a whole number: longer ones can neither be printed nor used
NESTING = (dict, list, tuple)
OF_A_RUN: dict[str, Any] = {  # attributes and their types
    **dict.fromkeys(("title", "references", "source", "system", "equations", "components", "frame", "parameters"), str),
    **dict.fromkeys(("method", "options"), str),
    **dict.fromkeys(("n", "steps", "every", "rows_in_block"), Integral),
    "dt": Real,
}


def parsed(text: str | bytes, what: str) -> Any:
    """The data in a JSON text; `what` names it in the message.  Raises `InputError`."""
    if not isinstance(text, str | bytes):
        raise InputError(f"{what}: expected text, got {shown(text)}.")
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
        for number in level:
            if isinstance(number, int) and number.bit_length() > MOST_BITS:
                raise InputError(
                    f"{what}: expected whole numbers of at most {MOST_BITS:,} bits, got one of {number.bit_length():,}."
                )
        level = [inner for outer in level for inner in _inside(outer)]
    if any(isinstance(rest, NESTING) for rest in level):
        raise InputError(_too_deep(what))
    return value


def place(path: Any, needed: str) -> Path:
    """A path that names a file or folder to make, with ~ expanded.  Raises `InputError`, `needed` in front.

    ~ alone is refused: it is the home folder itself.
    """
    try:
        given = Path(path) if isinstance(path, str | os.PathLike) else Path()
        where = Path() if len(given.parts) == 1 and given.name.startswith("~") else given.expanduser()
        os.fsencode(where)
    except (TypeError, RuntimeError, UnicodeEncodeError):  # of bytes; ~name of nobody; half a character
        where = Path()
    if not where.name or "\0" in str(where) or where.name == "..":
        raise InputError(f"{needed}, got {shown(str(path) if isinstance(path, os.PathLike) else path)}.")
    return where


def as_made(attrs: Mapping[str, Any]) -> Mapping[str, Any]:
    """The attributes of a run themselves.  Raises `InputError` where one is not of the type that a run has."""
    wrong = [name for name, kind in OF_A_RUN.items() if name in attrs and not isinstance(attrs[name], kind)]
    if wrong or not 0 < attrs.get("dt", 1.0) < math.inf:
        name = wrong[0] if wrong else "dt"
        raise InputError(
            f"expected the attributes of a run as Kreisel made them, got {name} = {shown(attrs[name])}. Usual cause: "
            "it was set by hand. Give the run as kr.simulate or kr.open_run returned it."
        )
    return attrs


def a_run(run: Any, *attributes: str, rows: bool = True) -> Any:
    """The Dataset of a run itself, with these attributes and, unless `rows` is false, its rows along time in front.

    Raises `InputError` for anything else.
    """
    if not hasattr(run, "data_vars") or not hasattr(run, "attrs"):
        raise InputError(
            f"expected a run, the Dataset of kr.simulate or kr.open_run, got {shown(type(run).__name__)}. "
            "An archive is opened by kr.open_run(path)."
        )
    missing = [name for name in attributes if name not in run.attrs]
    missing += ["time"] if "time" not in run.variables else []
    if missing:
        raise InputError(
            f"expected a run with its times and attributes, got a Dataset without {', '.join(missing)}. Usual cause: "
            "an operation of xarray, which drops attributes; xarray.set_options(keep_attrs=True) keeps them."
        )
    as_made(run.attrs)
    last = [str(name) for name, v in run.variables.items() if "time" in v.dims[1:] or "lane" in v.dims[2:]]
    last = [] if "kreisel_sweep" in run.attrs else last
    if last or (rows and (run["time"].dims != ("time",) or not run.sizes["time"])):
        raise InputError(
            f"expected a run with at least one row, and time, then lane as the first axes, got one with the times "
            f"{run['time'].shape}{' and ' + shown(last) if last else ''}. run.isel(time=[-1]) keeps the axis."
        )
    if rows and not all(math.isfinite(t) for t in run["time"][[0, -1]].values):
        raise InputError("expected a run with finite times, got others.")
    return run


def _inside(value: Any) -> Any:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, NESTING) else ()


def _too_deep(what: str) -> str:
    return (
        f"{what} is nested too deep: at most {DEEPEST} lists or tables inside one another were expected. "
        "It is damaged, or was not made by Kreisel."
    )


def read_values(variable: xr.DataArray | xr.Variable, name: object = None) -> np.ndarray:
    """The values of a variable.  Raises `InputError` where they cannot be read from its archive."""
    try:
        return np.asarray(variable.values)
    except InputError:
        raise
    except Exception as error:  # whatever a damaged chunk makes the libraries raise
        what, why = name or getattr(variable, "name", "time"), error or type(error).__name__
        raise InputError(f"{what} cannot be read: {why}. `kreisel check` says what is damaged.") from error
