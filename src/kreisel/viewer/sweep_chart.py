"""The figure of a sweep: summaries of its lanes over one or two of the quantities that vary."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel.errors import InputError, brief, hint, shown
from kreisel.viewer.style import Theme, theme_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

MOST_PANELS = 3
MOST_POINTS = 50_000
FEW = 200  # lanes, whose points are larger
ENTRY = re.compile(r"(.+?)(?:\[([0-9]+(?:,[0-9]+)*)\])?")


def sweep_figure(run: xr.Dataset, show: str | None = None, theme: str = "light") -> Figure:
    """A panel for each summary, by default the motion of the carried vector, its frequency and the worst drift.

    run    a sweep by lane;  show   a variable of it instead, or one entry, "a_max[2]"

    Over one quantity of the grid each lane is a point; over two the colour is the median of the lanes that share both;
    without a grid the first number that varies is the axis.  Raises `InputError` for what is no variable of the sweep.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    colours, axes = theme_of(theme), _axes_of(run)
    panels = _panels(run) if show is None else {show: _entry(run, show)}
    with mpl.rc_context(cast("Any", colours.rc)):
        figure = Figure(figsize=(4.1 * len(panels) + 0.6, 3.9), layout="constrained")
        for place, (label, value) in enumerate(panels.items()):
            _panel(figure, figure.add_subplot(1, len(panels), place + 1), axes, label, value, colours)
        failed = int((run["failed"].values != 0).sum())
        lost = f", {failed:,} failed or missing" if failed else ""
        figure.suptitle(f"{brief(run.attrs.get('title', 'sweep'), 100)}{lost}", fontsize=10)
    return figure


def _axes_of(run: xr.Dataset) -> dict[str, np.ndarray]:
    """One or two scalar quantities that vary: a grid, whose values occur in several lanes, comes first."""
    found = {
        str(name): np.asarray(v.values, dtype=float)
        for name, v in run.variables.items()
        if v.attrs.get("kind") == "input" and v.ndim == 1 and "flag_meanings" not in v.attrs
    }
    varied = {k: v for k, v in found.items() if len(np.unique(v)) > 1}
    grids = {k: v for k, v in varied.items() if len(np.unique(v)) < len(v)}
    chosen = list(grids.items())[:2] or list(varied.items())[:1]
    return dict(chosen) or {"lane": np.arange(run.sizes["lane"], dtype=float)}


def _panels(run: xr.Dataset) -> dict[str, np.ndarray]:
    """What is most worth a look."""
    out: dict[str, np.ndarray] = {}
    highest = [str(name) for name in run.variables if str(name).endswith("_max") and name != "g_max"]
    for name in highest[-1:]:
        letter = name.removesuffix("_max")
        value = np.asarray(run[name].values) - np.asarray(run[f"{letter}_min"].values)
        entry = value.reshape(len(value), -1)
        last = f"[{entry.shape[1] - 1}]" if value.ndim == 2 else ""
        out[f"{letter}{last}: largest less least"] = entry[:, -1]
        if f"{letter}_frequency" in run.variables:
            frequency = np.asarray(run[f"{letter}_frequency"].values).reshape(len(value), -1)
            out[f"{letter}{last}: frequency"] = frequency[:, -1]
    drifts = [v for k, v in run.variables.items() if str(k).endswith("_drift") and "not conserved" not in
              str(v.attrs.get("long_name"))]  # fmt: skip
    if drifts:
        worst = [np.asarray(v.values).reshape(run.sizes["lane"], -1).max(1) for v in drifts]
        out["largest change of what is conserved"] = np.max(worst, 0)
    if not out:
        raise InputError(
            "The sweep saved neither drift nor extremes: say what to draw, --show NAME, one of "
            f"{', '.join(str(k) for k in run.data_vars)}."
        )
    return dict(list(out.items())[:MOST_PANELS])


def _entry(run: xr.Dataset, show: str) -> np.ndarray:
    match = ENTRY.fullmatch(show)
    name = match[1] if match else ""
    known = [str(k) for k, v in run.variables.items() if v.dims[:1] == ("lane",) and v.dtype.kind == "f"]
    if match is None or name not in known:
        raise InputError(f"--show: expected one of {', '.join(known)}, got {shown(show)}.{hint(name, known)}")
    value = np.asarray(run[name].values)
    index = tuple(int(i) for i in match[2].split(",")) if match[2] else ()
    if len(index) != value.ndim - 1 or any(i >= k for i, k in zip(index, value.shape[1:], strict=True)):
        entry = ",".join(["0"] * (value.ndim - 1))
        raise InputError(f"--show: {name} has the shape {value.shape[1:]}: one entry is {name}[{entry}], got {show}.")
    return np.asarray(value.reshape(len(value), -1)[:, np.ravel_multi_index(index, value.shape[1:]) if index else 0])


def _panel(
    figure: Figure, axes: Any, along: dict[str, np.ndarray], label: str, value: np.ndarray, theme: Theme
) -> None:
    import pandas as pd

    tiny = label.startswith("largest change") or label.partition("[")[0].endswith("_drift")
    medians = pd.Series(value).groupby(list(along.values())[::-1]).median()
    logarithmic = tiny and bool((medians > 0).any())
    if len(along) == 2:
        (first, _), (second, _) = along.items()
        table = medians.unstack()
        shading: dict[str, Any] = {"norm": "log"} if logarithmic else {}
        colours = axes.pcolormesh(
            table.columns, table.index, table.values, cmap="viridis", shading="nearest", **shading
        )
        figure.colorbar(colours, ax=axes)
        axes.grid(visible=False)
        axes.set(xlabel=first, ylabel=second, title=label)
        return
    ((name, x),) = along.items()
    every = max(1, len(x) // MOST_POINTS)
    size = 5 if len(x) < FEW else 3
    axes.plot(x[::every], value[::every], ".", color=theme.colours[0], markersize=size, alpha=0.6)
    if len(medians) < len(x):
        axes.plot(medians.index, medians.values, "-", color=theme.colours[1], linewidth=1.2, label="median")
        axes.legend(fontsize=7)
    axes.set(xlabel=name, ylabel=label, yscale="log" if logarithmic else "linear")
