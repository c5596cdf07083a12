"""Quantities along a run: "a[2]", "energy", or a function of the components of the state."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, hint, shown
from kreisel.record.model import Model
from kreisel.runs.in_si import names_of_state
from kreisel.runs.run_record import RunRecord, a_run

Quantity = str | Callable[..., Any]
NAME = re.compile(r"\s*(\w+)\s*(?:\[\s*(\d+(?:\s*,\s*\d+)*)\s*\])?\s*")


def parse_quantity(quantity: str) -> tuple[str, tuple[int, ...]]:
    """A name and its indices, counted from 0.  Raises `InputError`."""
    match = NAME.fullmatch(quantity)
    if match is None:
        raise InputError(f'A quantity is a name such as "a[2]" or "m[0, 1]", or a function, got {shown(quantity)}.')
    return match[1], tuple(int(i) for i in match[2].split(",")) if match[2] else ()


def pick(value: Array, index: tuple[int, ...], name: str, lead: int) -> Array:
    """A scalar of a variable with `lead` axes of times and lanes in front.  Raises `InputError`."""
    shape = value.shape[lead:]
    if len(index) != len(shape) or any(i >= size for i, size in zip(index, shape, strict=True)):
        example = f"{name}[{', '.join(['0'] * len(shape))}]" if shape else name
        raise InputError(
            f"{name} has the shape {shape}: one number of it is {shown(example)}, got the indices {index}."
        )
    return value[(..., *index)]


def label(quantity: Quantity) -> str:
    """A quantity for a figure."""
    return quantity if isinstance(quantity, str) else getattr(quantity, "__name__", "quantity").replace("<lambda>", "f")


def rows_of(run: xr.Dataset) -> tuple[tuple[str, ...], dict[str, xr.DataArray]]:
    """The axes of the rows of a run, time and lane, and their coordinates."""
    dims = ("time", "lane")[: 1 + ("lane" in run.dims)]
    return dims, {name: run[name] for name in dims if name in run.coords}


def series(run: xr.Dataset, quantity: Quantity) -> Array:
    """The quantity at every row, (time,) or (time, lane); functions receive the variables of the state as stored."""
    a_run(run, rows=False)  # results of events have `event` instead of time
    lead = 1 + ("lane" in run.dims)
    if isinstance(quantity, str):
        name, index = parse_quantity(quantity)
        if name not in run:
            names = [*map(str, run)]
            raise InputError(f"The run has no {shown(name)}.{hint(name, names)} It has {', '.join(names)}.")
        return np.asarray(pick(run[name], index, name, lead).values)
    RunRecord.of(run, "system", rows=False)
    letters = names_of_state(run)
    missing = [name for name in letters if name not in run]
    if missing:
        raise InputError(f"expected a run with its state, got one without {', '.join(missing)}.")
    values = [np.asarray(run[letter].values) for letter in letters]
    return _function_values(quantity, values, values[0].shape[:lead])


def of_state(quantity: Quantity, model: Model) -> Callable[[tuple[Array, ...]], Array]:
    """The quantity as a function of the components (lanes, ...) of a record.  Raises `InputError`."""
    kinds: Mapping[str, str] = dict(model.system.space.components)

    def stored(state: tuple[Array, ...]) -> list[Array]:
        return [algebra.KINDS[kind].for_user(v) for kind, v in zip(kinds.values(), state, strict=True)]

    if isinstance(quantity, str):
        name, index = parse_quantity(quantity)
        if name not in kinds:
            raise InputError(
                f"{shown(name)} is not a component of the state, {', '.join(kinds)}; a function may combine them."
            )
        place = list(kinds).index(name)
        return lambda state: pick(stored(state)[place], index, name, 1)
    return lambda state: _function_values(quantity, stored(state), state[0].shape[:1])


def _function_values(function: Callable[..., Any], values: list[Array], shape: tuple[int, ...]) -> Array:
    try:
        out = np.asarray(function(*values))
    except InputError:  # states its cause
        raise
    except (TypeError, IndexError, ValueError) as error:
        raise InputError(
            f"The quantity could not be computed: {error}. A function gets the components of the state in order, as "
            "arrays with the batch in front, e.g. lambda m, a: a[..., 2]."
        ) from error
    if out.shape != shape or out.dtype.kind not in "iufc":
        raise InputError(
            f"A quantity has one value for each state, here {shape}, got {out.shape}. Index from the right: a[..., 2]."
        )
    return out
