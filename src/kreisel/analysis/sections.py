"""kr.analysis: Poincare sections and the return maps on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kreisel.analysis.events import events
from kreisel.analysis.quantities import Quantity, label, series
from kreisel.errors import explained
from kreisel.runs.settings import whole_number

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.record.model import Model


@explained
def section(
    run: xr.Dataset, quantity: Quantity, value: float = 0.0, *, rising: bool | None = True, system: Model | None = None
) -> xr.Dataset:
    """Poincare's section: the states at which f = value is crossed in one direction, located to round-off (`events`).

    Of an ensemble the points of all lanes, with the coordinate lane.  Returns and raises as `events`.
    """
    return events(run, quantity, value, rising=rising, system=system)


@explained
def return_map(
    run: xr.Dataset,
    quantity: Quantity,
    seen: Quantity,
    value: float = 0.0,
    *,
    rising: bool | None = True,
    returns: int = 1,
    system: Model | None = None,
) -> xr.Dataset:
    """The return map on the section f = value: `seen` at a crossing, and at the `returns`-th one after it.

    `seen` is a component such as "a[0]" or a function of the components of the state, as f is.  Crossings of different
    lanes are not mixed.  Returns a Dataset along `event` with here, after, the time of return elapsed, and the
    coordinate lane of an ensemble.  Raises `InputError` as `events` does, and for returns < 1.
    """
    import xarray as xr

    returns = whole_number(returns, "returns")
    cut = section(run, quantity, value, rising=rising, system=system)
    lanes = cut["lane"].values if "lane" in cut.coords else np.zeros(cut.sizes["event"], dtype=int)
    found = _values_at_crossings(cut, seen)
    first, last = [], []
    for lane in np.unique(lanes):
        places = np.nonzero(lanes == lane)[0]
        first.append(places[:-returns])
        last.append(places[returns:])
    i, j = (np.concatenate(p) if p else np.zeros(0, dtype=int) for p in (first, last))
    coords = {"time": ("event", cut["time"].values[i])}
    if "lane" in cut.coords:
        coords["lane"] = ("event", lanes[i])
    elapsed = cut["time"].values[j] - cut["time"].values[i]
    data = {"here": ("event", found[i]), "after": ("event", found[j]), "elapsed": ("event", elapsed)}
    return xr.Dataset(data, coords, {**cut.attrs, "seen": label(seen), "returns": returns})


def _values_at_crossings(cut: xr.Dataset, seen: Quantity) -> np.ndarray:
    """`seen` at each crossing; the events stand where a run has its times."""
    return np.asarray(series(cut.reset_coords("lane", drop=True) if "lane" in cut.coords else cut, seen))
