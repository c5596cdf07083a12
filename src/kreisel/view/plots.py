"""kr.plot: the trajectory beside the drift of every integral."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.runs.drift import MACHINE_EPSILON, kept_series
from kreisel.view.style import COLOURS, FAINT, STYLE

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

MOST_POINTS = 20_000  # drawn of a trajectory: a contiguous piece from the start, so that the curve is true
SPHERE_STEPS_PER_POINT = 25


def plot(run: xr.Dataset, *, compare: xr.Dataset | None = None) -> Figure:
    """A figure of a run: the tip of the axis on its sphere (n = 3) or the components, and every drift.

    The drift of each Casimir and integral that the method keeps is drawn on a logarithmic scale, with the
    width eps_machine * sensitivity * sqrt(steps) of a random walk of rounding errors.  `compare` is a second
    run of the same system whose integrals are drawn in grey behind.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.2, 4.4), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=[1, 1.25])
        vector = _vector_letter(run)
        one = run.isel(lane=0) if "lane" in run.dims else run
        if one.sizes["axis"] == 3:
            _sphere(left.add_subplot(projection="3d"), one, vector)
        else:
            _components(left.add_subplot(), one, vector)
        _drifts(right.add_subplot(), run, compare)
        figure.suptitle(_title(run), fontsize=10)
    return figure


def _title(run: xr.Dataset) -> str:
    attrs = run.attrs
    return f"{attrs['title']}, n = {attrs['n']}, {attrs['steps']:,} steps of {attrs['dt']:g}"


def _vector_letter(run: xr.Dataset) -> str:
    """The component that is drawn: the vector one of a pair (m, a), the position of (x, q)."""
    names = [str(k) for k, v in run.data_vars.items() if v.attrs.get("kind") == "state"]
    from kreisel.systems import find

    kinds = dict(find(run.attrs["system"]).space.components)
    return next(name for name in kinds if name in names and kinds[name] == "vector")


def _sphere(axes: Any, run: xr.Dataset, letter: str) -> None:
    xyz = np.asarray(run[letter].values[:MOST_POINTS])
    radius = float(np.linalg.norm(xyz, axis=-1).max())
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = radius * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    axes.plot_wireframe(*ball, rstride=4, cstride=4, color=FAINT, linewidth=0.3, alpha=0.6)
    dense = len(xyz) > 2 and np.linalg.norm(np.diff(xyz, axis=0), axis=-1).mean() < 0.4 * radius
    if dense:
        axes.plot(*xyz.T, color=COLOURS[0], linewidth=0.7)
    else:
        axes.plot(*xyz.T, ".", color=COLOURS[0], markersize=1.2)
    axes.plot(*xyz[:1].T, "o", color=COLOURS[1], markersize=4)
    axes.set_box_aspect((1, 1, 1))
    axes.set(xlim=(-radius, radius), ylim=(-radius, radius), zlim=(-radius, radius))
    axes.set_xlabel(f"${letter}_1$", labelpad=-8)
    axes.set_ylabel(f"${letter}_2$", labelpad=-8)
    axes.set_zlabel(f"${letter}_3$", labelpad=-8)
    axes.tick_params(labelbottom=False, labelleft=False, labelright=False, labeltop=False)
    axes.view_init(elev=22, azim=-55)
    axes.set_title(f"tip of ${letter}$ (dot: start)")


def _components(axes: Any, run: xr.Dataset, letter: str) -> None:
    time, values = run["time"].values[:400], run[letter].values[:400]
    for i, series in enumerate(values.T):
        axes.plot(time, series, color=COLOURS[i % len(COLOURS)], label=f"${letter}_{{{i + 1}}}$")
    axes.set(xlabel="time", title=f"components of ${letter}$ (first {len(time)} saved states)")
    axes.legend(ncols=min(values.shape[1], 6), loc="upper center", bbox_to_anchor=(0.5, -0.14))


def _drifts(axes: Any, run: xr.Dataset, compare: xr.Dataset | None) -> None:
    time = np.asarray(run["time"].values)
    if compare is not None:
        _grey(axes, compare)
    colours: dict[str, str] = {}
    band = np.zeros(len(time))
    for name, series, scale in kept_series(run):
        family = name.split("[")[0]
        first = family not in colours
        colours.setdefault(family, COLOURS[len(colours) % len(COLOURS)])
        change = np.maximum(abs(series - series[0]), 1e-18)
        axes.plot(*_thinned(time, change), color=colours[family], linewidth=0.6, label=_label(run, family) if first else None)
        band = np.maximum(band, MACHINE_EPSILON * scale * np.sqrt(time / run.attrs["dt"]))
    if len(colours):
        axes.plot(time, np.maximum(band, 1e-18), color="black", linestyle="--", linewidth=0.9, label=r"round-off, $\propto\sqrt{\mathrm{steps}}$")
    axes.set(yscale="log", xlabel="time", title="change of every integral since the start")
    floor = 1e-17
    axes.set_ylim(bottom=floor)
    axes.set_xlim(time[0], time[-1])
    axes.legend(loc="upper left", ncols=2, bbox_to_anchor=(0, -0.14))


def _grey(axes: Any, run: xr.Dataset) -> None:
    time = np.asarray(run["time"].values)
    for number, (_, series, _) in enumerate(kept_series(run, every_kind=True)):
        change = np.maximum(abs(series - series[0]), 1e-18)
        label = f"the same by {run.attrs['method']}" if number == 0 else None
        axes.plot(*_thinned(time, change), color=FAINT, linewidth=0.6, label=label)


def _thinned(time: np.ndarray, change: np.ndarray, most: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """The largest change in each of at most `most` stretches, so that no extreme is lost."""
    if len(time) <= most:
        return time, change
    edges = np.linspace(0, len(time), most + 1).astype(int)[:-1]
    return time[edges], np.maximum.reduceat(change, edges)


def _label(run: xr.Dataset, family: str) -> str:
    return family.replace("_eps", " (of the map)")
