"""Variables that are computed from others when they are read: archives may be longer than memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from xarray.backends import BackendArray
from xarray.core import indexing

from kreisel.algebra import Array

if TYPE_CHECKING:
    import xarray as xr

LEAD = ("time", "lane", "event")  # axes of rows: other axes of a variable are read complete


class _Computed(BackendArray):
    """Rows computed from the rows of other variables; axes of components are read complete."""

    def __init__(
        self, shape: tuple[int, ...], lead: int, sources: Sequence[xr.Variable], function: Callable[..., Array]
    ):
        self.shape, self.dtype = shape, np.dtype(np.float64)
        self._lead, self._sources, self._function = lead, sources, function

    def __reduce__(self) -> Any:  # a pickled run has its values
        return indexing.NumpyIndexingAdapter, (self._values((slice(None),) * len(self.shape)),)

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._values)

    def _values(self, key: tuple[Any, ...]) -> Array:
        lead, inner = key[: self._lead], key[self._lead :]
        rows = tuple(np.atleast_1d(np.arange(size)[k]) for k, size in zip(lead, self.shape, strict=False))
        with np.errstate(all="ignore"):
            values = self._function(*(np.asarray(v[rows].values) for v in self._sources))
        return values[tuple(0 if np.ndim(k) == 0 and not isinstance(k, slice) else slice(None) for k in lead) + inner]


def lazy(
    dims: Sequence[Any],
    shape: tuple[int, ...],
    sources: Sequence[xr.Variable],
    function: Callable[..., Array],
    attrs: dict[str, Any] | None = None,
    by_lane: bool = False,
) -> xr.Variable:
    """A variable whose rows are `function` of the rows of `sources`, when they are read.

    The axes of rows are time, lane and event; `by_lane`: the function differs from lane to lane, and receives all.
    """
    import xarray as xr

    lead = dims.index("lane") if by_lane and "lane" in dims else sum(d in LEAD for d in dims)
    return xr.Variable(dims, indexing.LazilyIndexedArray(_Computed(shape, lead, sources, function)), attrs)
