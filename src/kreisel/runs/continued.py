"""A variable on disk and the rows that follow it in memory as one, which reads only what is asked of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from xarray import Variable
from xarray.backends import BackendArray
from xarray.core import indexing

from kreisel.algebra import Array


class _Continued(BackendArray):
    """The rows of one variable, then those of another, along their first axis."""

    def __init__(self, before: Variable, after: Variable):
        self.before, self.after = before, after
        self.dtype = before.dtype
        self.shape = (len(before) + len(after), *before.shape[1:])

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._rows)

    def _rows(self, key: tuple[int | slice, ...]) -> Array:
        first, *rest = key
        border = len(self.before)
        if not isinstance(first, slice):
            part, at = (self.before, first) if first < border else (self.after, first - border)
            return np.asarray(part[(at, *rest)].values)
        rows = range(*first.indices(self.shape[0]))  # the adapter asks for them in ascending order
        split = len(range(rows.start, min(rows.stop, border), rows.step))
        pieces = [
            part[(slice(piece.start - start, piece.stop - start, piece.step), *rest)].values
            for part, start, piece in ((self.before, 0, rows[:split]), (self.after, border, rows[split:]))
            if len(piece)
        ]
        return np.concatenate(pieces) if pieces else np.asarray(self.before[(slice(0, 0), *rest)].values)


def continued(before: Variable, after: Variable) -> Variable:
    """Both as one lazy variable with the attributes and the encoding of the first."""
    data = indexing.LazilyIndexedArray(_Continued(before, after))
    return Variable(before.dims, data, before.attrs, before.encoding)
