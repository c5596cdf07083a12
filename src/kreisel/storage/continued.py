"""A variable on disk and the rows in memory that follow it, joined into one lazy variable."""

from __future__ import annotations

from typing import Any

import numpy as np
from xarray import Variable
from xarray.backends import BackendArray
from xarray.core import indexing  # where the guide of xarray for new backends finds these functions

from kreisel.algebra import Array


class _Continued(BackendArray):
    """The rows of one variable, then those of another, along their first axis."""

    def __init__(self, before: Variable, after: Variable):
        self.before, self.after = before, after
        self.dtype = before.dtype
        self.shape = (len(before) + len(after), *before.shape[1:])

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._rows)

    def _rows(self, key: tuple[Any, ...]) -> Array:
        """Ask each part for its own rows only: a damaged chunk does not affect the other part."""
        first, *rest = key
        border = len(self.before)
        if isinstance(first, slice):
            rows = range(*first.indices(self.shape[0]))  # the adapter asks for them in ascending order
            split = len(range(rows.start, min(rows.stop, border), rows.step))
            low, high = rows[:split], rows[split:]
            mine = slice(low.start, low.stop, low.step), slice(high.start - border, high.stop - border, high.step)
            pieces = [(rows[:split], self.before, mine[0]), (rows[split:], self.after, mine[1])]
            return np.concatenate(
                [_read_rows(part, at, rest) for some, part, at in pieces if some] or [self._none(rest)]
            )
        places = np.atleast_1d(first)
        late = places >= border
        out = np.empty((len(places), *self._none(rest).shape[1:]), dtype=self.dtype)
        for which, part, start in ((~late, self.before, 0), (late, self.after, border)):
            if which.any():
                out[which] = _read_rows(part, places[which] - start, rest)
        return out if np.ndim(first) else out[0]

    def _none(self, rest: list[Any]) -> Array:
        return _read_rows(self.after, slice(0, 0), rest)


def _read_rows(part: Variable, rows: Any, rest: list[Any]) -> Array:
    return np.asarray(part[(rows, *rest)].values)


def continued(before: Variable, after: Variable) -> Variable:
    """Both as one lazy variable with the attributes and the encoding of the first."""
    data = indexing.LazilyIndexedArray(_Continued(before, after))
    return Variable(before.dims, data, before.attrs, before.encoding)
