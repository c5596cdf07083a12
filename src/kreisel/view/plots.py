"""kr.plot: the trajectory beside the drift of every integral."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel.runs.drift import MACHINE_EPSILON, kept_series
from kreisel.view.style import COLOURS, FAINT, STYLE

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

ARC_SHOWN = 45  # radii of path drawn on the sphere, so that the pattern stays readable
MOST_GAP = 0.5  # radii between saved states beyond which a line would cut corners: dots then
MOST_DOTS = 4000
STATES_SHOWN = 120


def plot(run: xr.Dataset, *, compare: xr.Dataset | None = None) -> Figure:
    """A figure of a run: the tip of the axis on its sphere (n = 3) or the components, and every drift.

    The change of each family of Casimirs and integrals that the method keeps is drawn on a logarithmic scale,
    relative to the integral's sensitivity (`kr.drift`), with the width eps_machine * sqrt(steps) of a random
    walk of rounding errors.  `compare` is a second run of the same system, drawn in grey by its worst integral.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(cast("Any", STYLE)):
        figure = Figure(figsize=(9.2, 4.4), layout="constrained")
        left, right = cast("Any", figure.subfigures(1, 2, width_ratios=[1, 1.25]))
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
    xyz = np.asarray(run[letter].values)
    radius = float(np.linalg.norm(xyz[:1], axis=-1).max())
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = radius * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    axes.plot_wireframe(*ball, rstride=4, cstride=4, color=FAINT, linewidth=0.3, alpha=0.7)
    arc = np.linalg.norm(np.diff(xyz, axis=0), axis=-1)
    if len(arc) and arc[:1000].max() < MOST_GAP * radius:
        shown = int(np.searchsorted(np.cumsum(arc), ARC_SHOWN * radius)) + 1
        axes.plot(*xyz[:shown].T, color=COLOURS[0], linewidth=0.8)
        told = f"to time {float(run['time'][shown - 1]):.4g}"
    else:
        axes.plot(*xyz[:MOST_DOTS].T, ".", color=COLOURS[0], markersize=1.0)
        told = "saved states"
    axes.plot(*xyz[:1].T, "o", color=COLOURS[1], markersize=4)
    axes.set_box_aspect((1, 1, 1), zoom=1.25)
    axes.set(xlim=(-radius, radius), ylim=(-radius, radius), zlim=(-radius, radius))
    axes.set_axis_off()
    axes.view_init(elev=22, azim=-55)
    axes.set_title(f"tip of ${letter}$ on its sphere, {told}", y=0.97)


def _components(axes: Any, run: xr.Dataset, letter: str) -> None:
    time, values = run["time"].values[:STATES_SHOWN], run[letter].values[:STATES_SHOWN]
    for i, series in enumerate(values.T):
        axes.plot(time, series, color=COLOURS[i % len(COLOURS)], label=f"${letter}_{{{i + 1}}}$")
    axes.set(xlabel="time", title=f"components of ${letter}$, first {len(time)} saved states")
    axes.legend(ncols=min(values.shape[1], 6), loc="upper center", bbox_to_anchor=(0.5, -0.14))


def _drifts(axes: Any, run: xr.Dataset, compare: xr.Dataset | None) -> None:
    time = np.asarray(run["time"].values)
    if compare is not None:
        name = f"worst integral by {compare.attrs['method']}"
        families = _envelopes(compare, every_kind=True)
        worst = np.fmax.reduce(list(families.values()))
        axes.plot(*_thinned(np.asarray(compare["time"].values), worst), color=FAINT, label=name)
    shown = _envelopes(run, every_kind=run.attrs["method"] == "dop853")
    for number, (family, change) in enumerate(shown.items()):
        label = family.replace("_eps", " of the map")
        axes.plot(*_thinned(time, change), color=COLOURS[number % len(COLOURS)], linewidth=0.7, label=label)
    band = MACHINE_EPSILON * np.sqrt(time / run.attrs["dt"])
    axes.plot(
        time[1:], band[1:], color="black", linestyle="--", linewidth=0.9, label=r"$\varepsilon\sqrt{\mathrm{steps}}$"
    )
    axes.set(yscale="log", xlabel="time", ylabel="change since the start, relative", xlim=(time[0], time[-1]))
    axes.set_ylim(bottom=1e-17)
    axes.set_title("what the method keeps" if not run.attrs["method"] == "dop853" else "integrals of the flow")
    axes.legend(loc="upper left", ncols=2, bbox_to_anchor=(0, -0.14))


def _envelopes(run: xr.Dataset, every_kind: bool) -> dict[str, np.ndarray]:
    """For each family of integrals the largest |change| against time, relative to what a state change of 1 does."""
    out: dict[str, np.ndarray] = {}
    for name, series, scale in kept_series(run, every_kind):
        family, change = name.split("[")[0], abs(series - series[0]) * np.sqrt(run.attrs["steps"]) / (scale or 1.0)
        out[family] = np.fmax(out[family], change) if family in out else change
    return {k: np.where(v > 0, v, np.nan) for k, v in out.items() if v.any()}


def _thinned(time: np.ndarray, change: np.ndarray, most: int = 1200) -> tuple[np.ndarray, np.ndarray]:
    """The largest change in each of at most `most` stretches, so that no extreme is lost."""
    if len(time) <= most:
        return time, change
    edges = np.linspace(0, len(time), most + 1).astype(int)[:-1]
    return time[edges], np.fmax.reduceat(change, edges)
