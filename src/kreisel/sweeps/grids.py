"""A sweep with an axis for each quantity of its grid, instead of the lanes; still read lazily."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from kreisel.algebra import Array
from kreisel.errors import explained
from kreisel.files import parsed
from kreisel.storage.archive import target
from kreisel.storage.opening import open_archive
from kreisel.sweeps.design import SECTIONS, Lanes

LANE = "lane"


def gridded(run: xr.Dataset) -> xr.Dataset:
    """A sweep by lane as a sweep by grid: dimensions of the quantities' names, then list and draw if present.

    The values of the grid are coordinates; `lane` is the index of each lane.  Without a grid: the sweep itself.
    """
    description = parsed(run.attrs["sweep"], "The attribute sweep")
    lanes = Lanes({section: description[section] for section in SECTIONS}, description["sweep"])
    if all(axis in ("list", "draw") for axis, _, _ in lanes.folded):
        return run
    names, sizes, coords = [], [], {}
    for axis, size, tables in lanes.folded:
        names.append(axis)
        sizes.append(size)
        for quantity, values in tables.items():
            old = run.variables[quantity.name]
            attrs = {k: v for k, v in old.attrs.items() if not k.startswith("flag_")}
            coords[quantity.name] = xr.Variable((axis, *old.dims[1:]), values, attrs)
    numbers = np.arange(math.prod(sizes)).reshape(sizes)
    coords[LANE] = xr.Variable(tuple(names), numbers, {"long_name": "number of the lane"})
    folded = {}
    for name, variable in run.variables.items():
        if name in coords:
            continue
        if LANE in variable.dims:
            place = variable.dims.index(LANE)
            dims = (*variable.dims[:place], *names, *variable.dims[place + 1 :])
            data = indexing.LazilyIndexedArray(_Folded(variable, tuple(sizes)))
            variable = xr.Variable(dims, data, variable.attrs)
        folded[name] = variable
    return xr.Dataset({k: v for k, v in folded.items() if k not in run.coords}, {
        **coords, **{k: v for k, v in folded.items() if k in run.coords}}, run.attrs)  # fmt: skip


def by_lane(run: xr.Dataset) -> xr.Dataset:
    """Varied quantities and failures of a sweep, by lane again."""
    if LANE in run.dims:
        return run
    names = ["failed", "message", *(k for k, v in run.variables.items() if v.attrs.get("kind") == "input")]
    flat = run[names].drop_vars(LANE, errors="ignore").stack({LANE: run["failed"].dims}, create_index=False)
    return flat.transpose(LANE, ...)


@explained
def open_run(path: str | os.PathLike[str], *, grid: bool = False) -> xr.Dataset:
    """Open a run on disk lazily, as `kr.simulate` returns it, or a sweep; if it was interrupted, its finished part.

    A sweep has the dimension `lane`, with `grid` the dimensions of its grid, as `kr.sweep` returns it.

    Every file is compared with its SHA-256 when it is read.  Raises `InputError` for anything but an archive of
    Kreisel, and for a damaged one, on opening or later on reading (`kreisel check` reports the damage).
    """
    run = open_archive(target(path))
    return gridded(run) if grid and "kreisel_sweep" in run.attrs else run


class _Folded(BackendArray):
    """A variable whose axis of lanes is the product of several."""

    def __init__(self, flat: xr.Variable, sizes: tuple[int, ...]):
        self.flat, self.sizes, self.place = flat, sizes, flat.dims.index(LANE)
        self.dtype = flat.dtype
        self.shape = (*flat.shape[: self.place], *sizes, *flat.shape[self.place + 1 :])

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._values)

    def _values(self, key: tuple[Any, ...]) -> Array:
        before, after = key[: self.place], key[self.place + len(self.sizes) :]
        grid = key[self.place : self.place + len(self.sizes)]
        index = [np.atleast_1d(np.arange(size)[k]) for k, size in zip(grid, self.sizes, strict=True)]
        lanes, back = np.unique(np.ravel_multi_index(np.ix_(*index), self.sizes).ravel(), return_inverse=True)
        together = len(lanes) > 0 and lanes[-1] - lanes[0] == len(lanes) - 1
        chosen: Any = slice(int(lanes[0]), int(lanes[-1]) + 1) if together else lanes
        values = np.asarray(self.flat[(*before, chosen, *after)].values)
        axis = sum(np.ndim(k) > 0 or isinstance(k, slice) for k in before)
        shape = tuple(len(i) for i, k in zip(index, grid, strict=True) if np.ndim(k) > 0 or isinstance(k, slice))
        result = values.take(back, axis)
        return result.reshape(*result.shape[:axis], *shape, *result.shape[axis + 1 :])
