"""Tables of floats in memory, read at a row that is computed: a gather, for any kind of number.

A table is known by its address, which a double holds exactly: so it is a parameter like any other, and a kernel that
was compiled for one table reads all of its form.  An address is valid as long as the array is alive.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakValueDictionary

import numpy as np

_ARRAYS: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()


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
    addresses, rows, ends = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (address, row, last)))
    places = np.where(rows > 0, np.minimum(rows, ends), 0).astype(np.int64) * stride + column
    out = np.zeros(places.shape)
    for start in np.unique(addresses[addresses != 0]):
        chosen = addresses == start
        out[chosen] = _ARRAYS[int(start)].ravel()[places[chosen]]
    return out[()]
