"""The lane of an ensemble in which a check fails: checks look at all lanes at once, messages name the first bad one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from kreisel.algebra import Array, loses
from kreisel.errors import InputError

MOST_SHOWN = 100  # entries in the text of an array
T = TypeVar("T")
Check = Callable[..., T]


def by_lane(check: Check[T], *values: Any, single: Callable[[Any], int]) -> T:
    """check(*values).  Raises `InputError`, for an ensemble with the number of its first bad lane and only its values.

    single   the number of axes that one of the values has without those of lanes, which are in front
    """
    try:
        return check(*values)
    except InputError as error:
        arrays = [_array(value) for value in values]
        spread = [a if a is not None and a.ndim > single(a) and len(a) > 1 else None for a in arrays]
        counts = {len(a) for a in spread if a is not None}
        if len(counts) != 1:
            raise

        def fault(lanes: slice | int) -> InputError | None:
            try:
                check(*(v if a is None else a[lanes] for a, v in zip(spread, values, strict=True)))
            except InputError as of_lanes:
                return of_lanes
            return None

        count = counts.pop()
        first, last = 0, count
        while last - first > 1:
            middle = (first + last) // 2
            first, last = (first, middle) if fault(slice(first, middle)) else (middle, last)
        of_lane = fault(first)
        common = first == 0 and fault(count // 2) and fault(count - 1)  # a shape, rather than one of the lanes
        if of_lane is None or common:
            raise
        raise InputError(f"Lane {first}: {of_lane}") from error


def _array(value: Any) -> Array | None:
    """An array that can be cut into lanes and keeps its meaning; None of text, units, masked and ragged values."""
    try:
        array = None if loses(value) else np.asarray(value)
    except (TypeError, ValueError):
        return None
    return None if array is None or array.dtype.kind not in "biufO" else array


def in_lane(bad: Array) -> str:
    """The first of the lanes (lanes,) that are bad, as " in lane 3"; "" of one lane."""
    return f" in lane {int(np.argmax(bad))}" if bad.size > 1 else ""


def text_of(value: Array) -> str:
    """All entries, or of many the first and the last with the shape."""
    if value.size <= MOST_SHOWN:
        return str(value.tolist())
    text = np.array2string(value, separator=", ", threshold=MOST_SHOWN, edgeitems=1, max_line_width=10**6)
    return f"{' '.join(text.split())} of shape {value.shape}"
