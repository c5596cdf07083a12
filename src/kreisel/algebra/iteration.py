"""Loops, and tables in memory, for any kind of number: recorded numbers may keep them as such.

A table of floats is read at a row that is computed.  It is known by its address, which a double holds exactly: so it is
a parameter like any other, and a kernel that was compiled for one table reads all of its form.  An address is valid as
long as the array is alive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from kreisel.algebra import Array, flatten, holds_objects, restore

State = tuple[Array, ...]
_ARRAYS: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()


def repeat(
    improve: Callable[..., tuple[State, Array]], start: State, small: float, most: int, kinds: tuple[str, ...]
) -> tuple[State, Array]:
    """X, defect = improve(*X) from matrices X of the given kinds until defect <= small, at most `most` times.

    Recorded values give a loop.  Dual values continue, for their slopes, twice as long as their values need.
    Numbers without an order use all `most` iterations.
    """
    X, first = start, start[0]
    if hasattr(first, "record_loop"):
        return first.record_loop(improve, X, small, most)
    objects = any(map(holds_objects, X))
    recorded = [v for matrix in X for v in matrix.flat if hasattr(v, "record_loop")] if objects else []
    if recorded:
        n = first.shape[-1]

        def on_coordinates(x: Array) -> tuple[Array, Array]:
            Y, defect = improve(*restore(x, kinds, n))
            return flatten(Y, kinds), defect

        x, defect = recorded[0].record_loop(on_coordinates, flatten(X, kinds), small, most)
        return restore(x, kinds, n), defect
    last = most
    for k in range(most):
        X, defect = improve(*X)
        if not objects and (defect <= small).all():
            break
        if last == most and objects and getattr(defect, "value", 1) <= small:
            last = 2 * k + 2
        if k == last:
            break
    return X, defect


def by_rows(body: Callable[..., Array], rows: Sequence[Sequence[float]], like: Array) -> list[Array]:
    """body(*row) for rows of constants, one after the other; `like`: an array of the kind of number.

    Recorded numbers may keep the rows as a table, with the same operations.
    """
    first: Any = like.flat[0] if holds_objects(like) else None
    if hasattr(first, "record_rows"):
        return list(first.record_rows(body, rows))
    return [body(*map(float, row)) for row in rows]


def times(body: Callable[[list[Array]], Sequence[Array]], start: Sequence[Array], count: int) -> Sequence[Array]:
    """The result of `count` applications of the body to numbers `start`.

    Recorded numbers may keep them as a loop, with the same operations.
    """
    first: Any = next((x for x in start if hasattr(x, "record_times")), None)
    if first is not None:
        return list(first.record_times(body, start, count))
    for _ in range(count):
        start = body([*start])
    return start


def address_of(table: np.ndarray) -> float:
    """The address of contiguous doubles (rows, stride), by which `entry` finds them."""
    address = table.__array_interface__["data"][0]
    _ARRAYS[address] = table
    return float(address)


def entry(address: Any, row: Any, last: Any, column: int, stride: int) -> Any:
    """The entry [row, column] of the table (last + 1, stride) at an address; rows outside are the first or the last.

    0.0 for the address 0, and row 0 for NaN; any kind of number, batches too.
    """
    recorder = next((x for x in (address, row, last) if hasattr(x, "record_entry")), None)
    if recorder is not None:
        return recorder.record_entry(address, row, last, column, stride)
    if all(isinstance(x, float) for x in (address, row, last)):  # arrays need far longer
        place = (int(min(row, last)) if row > 0 else 0) * stride + column
        return _ARRAYS[int(address)].ravel()[place] if address else np.float64(0)
    addresses, rows, ends = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (address, row, last)))
    places = np.where(rows > 0, np.minimum(rows, ends), 0).astype(np.int64) * stride + column
    out = np.zeros(places.shape)
    for start in np.unique(addresses[addresses != 0]):
        chosen = addresses == start
        out[chosen] = _ARRAYS[int(start)].ravel()[places[chosen]]
    return out[()]
