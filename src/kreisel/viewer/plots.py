"""kr.plot: the trajectory next to the drift of every integral; figures of sweeps."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator

from kreisel.errors import InputError, brief, counted, explained, hint, shown
from kreisel.files import read_values
from kreisel.kernels.layout import MACHINE_EPSILON
from kreisel.method.scheme import BALANCE
from kreisel.record.contract import Frame
from kreisel.runs.drift import all_series
from kreisel.runs.geometry import fixed_in, model_for, require_unchanged
from kreisel.runs.in_si import in_state_form
from kreisel.runs.run_record import RunRecord, frame_of, lane_names
from kreisel.viewer.charts import figure
from kreisel.viewer.frames import (
    clock_of,
    coordinates_of,
    evenly,
    extremes,
    is_pointed,
    mixed,
    panels_of,
    shadows_of,
    stretches,
)
from kreisel.viewer.style import Theme

ARC_SHOWN = 45  # radii of path drawn on the sphere, so that the pattern stays readable
SAME_LENGTH = 1e-3  # relative: a vector whose length changes by more is not on a sphere
MOST_GAP = 0.3  # radii between saved states beyond which a line would be a guess: then dots
MOST_DOTS = 4000
MOST_LANES = 7
NEAR_AXIS = 0.94  # cosine beyond which the names of an axis of coordinates and of the body's axis would collide
DASHES = ("-", "--", ":", "-.")
STATES_SHOWN = 120
LEAST = 1e-17  # of a relative change, unless the largest change of a family is smaller
STRETCHES = 1200  # of a drift; the largest change in each is drawn, so no extreme is lost
MOST_TITLE = 120
MOST_ROWS = 200_000  # rows read for the picture of the path
LARGEST = 1e100  # of values that are drawn: their squares do not overflow


@explained
def plot(
    run: xr.Dataset,
    *,
    compare: xr.Dataset | None = None,
    theme: str = "light",
    style: str = "house",
    axis: Any = None,
    target: Any = "nadir",
) -> Figure:
    """A figure of a run: the tip of the axis on its sphere (n = 3) or the components, and every drift.

    For a satellite with its orientation: the angle of an axis of the body to its target, pitch, roll and yaw, the
    angular velocity, the momentum of a wheel, shadows shaded if the Sun is known.  `axis` (3,) is along the axes of the
    body, by default the one that points down at zero angles; `target` is "nadir", "velocity", "sun" or a direction in
    space.

    The change of each family of Casimirs and integrals that the method conserves has a separate strip on a logarithmic
    scale, relative to the integral's scale (`kr.drift`), with the width eps_machine * sqrt(steps) of a random walk of
    rounding errors; families that never change are named.  For an ensemble the paths of up to seven lanes are drawn.
    `compare` is a second run with the same variables, also of another system, drawn in grey in the same strips.
    `theme` is "light" or "dark", `style` "house" or "journal": 183 mm wide, 8 points, a serif face, no grid, for .pdf
    and .svg.  A notebook displays the figure; `kr.plot(run).savefig("run.png")` writes it.  Raises `InputError` if
    `compare` has other variables, if the run lacks the vector that is drawn, and for states at given times (`kr.at`),
    which are not a run.
    """
    runs = [run] if compare is None else [run, compare]
    records = [RunRecord.of(dataset, "system", "title", "method", "n", "steps") for dataset in runs]
    if not all(record.stepped for record in records):
        raise InputError("A run of kr.simulate was expected, got states at given times, of kr.at.")
    runs = [in_state_form(dataset) for dataset in runs]
    run, first, last = runs[0], records[0], records[-1]
    for dataset in runs:
        require_unchanged(dataset)
    if (last.kinds, last.n) != (first.kinds, first.n):
        raise InputError(
            f"compare: expected a run with the variables {', '.join(first.kinds)} and n = {first.n}, got "
            f"{', '.join(last.kinds)} and n = {last.n}."
        )
    units = [clock_of(dataset).unit for dataset in runs]
    if not all(units) and any(units):
        raise InputError(
            "compare: expected two runs of bodies in SI, or two runs without units, got one of each. "
            "Usual cause: a run of body.model() for a run of the body."
        )
    with figure(theme, 1.0, 0.53, style) as (picture, colours), np.errstate(all="ignore"):
        flies = is_pointed(run, axis, target)
        left, right = cast("Any", picture.subfigures(1, 2, width_ratios=[1.35, 1] if flies else [1, 1.25]))
        if missing := first.missing_from(run):
            raise InputError(f"The run lacks {', '.join(missing)} of its state, which the figure needs.")
        vector, lanes = first.carried, _lanes(run)
        if flies:
            _motion(left, lanes, axis, target, colours)
        elif lanes[0][1][vector].shape[1:] == (3,) and all(_keeps_its_length(lane[vector]) for _, lane in lanes):
            _sphere(left.add_subplot(projection="3d"), lanes, vector, colours)
        else:
            _components(left, lanes[0], vector, colours)
        _draw_drifts(right, runs, colours)
        if style != "journal":
            picture.suptitle(_title(run, *records), fontsize=10)
    return picture


def _lanes(run: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Up to seven trajectories, evenly chosen, with their names."""
    if "lane" not in run.dims:
        return [("", run)]
    chosen = evenly(run.sizes["lane"], MOST_LANES)
    names = lane_names(run)
    return [(names[i], run.isel(lane=int(i))) for i in chosen]


def _title(run: xr.Dataset, record: RunRecord, *others: RunRecord) -> str:
    compared = "".join(f" and {_named(second_record, record)}" for second_record in others)
    lanes = f", {counted(run.sizes['lane'], 'lane')}" if "lane" in run.dims else ""
    clock = clock_of(run)
    n, step = ("", f"{record.dt / clock.second:g} s") if clock.unit else (f", n = {record.n}", f"{record.dt:g}")
    return f"{brief(record.title, MOST_TITLE)}{compared}{n}{lanes}, {counted(record.steps, 'step')} of {step}"


def _named(record: RunRecord, first: RunRecord) -> str:
    """The method of a run, or its title if another system was run first."""
    return brief(record.method if record.system == first.system else record.title, MOST_TITLE)


def _motion(panel: Any, lanes: list[tuple[str, xr.Dataset]], axis: Any, target: Any, theme: Theme) -> None:
    """A strip for each quantity of the motion of a satellite; for lanes, a colour for each lane."""
    clock, alone = clock_of(lanes[0][1]), len(lanes) == 1
    lanes = [(name, lane.isel(time=evenly(lane.sizes["time"], MOST_ROWS))) for name, lane in lanes]
    panels_of_lanes = [panels_of(lane, axis, target) for _, lane in lanes]
    panels = panel.subplots(len(panels_of_lanes[0]), 1, sharex=True)
    for number, (name, lane) in enumerate(lanes):
        time = read_values(lane["time"]) / clock.size
        for axes, strip in zip(panels, panels_of_lanes[number], strict=True):
            rows = extremes(strip.values, MOST_DOTS)
            for k, label in enumerate(strip.names):
                style = {"color": theme.colour(k if alone else number), "linestyle": "-" if alone else DASHES[k]}
                axes.plot(time[rows], strip.values[rows, k], linewidth=0.8, label=label if alone else name, **style)
            axes.set_title(f"{strip.title} ({strip.unit})", loc="left", fontsize="medium", parse_math=False)
            if alone and any(strip.names):
                axes.legend(loc="lower right", bbox_to_anchor=(1.02, 0.97), ncols=3, handlelength=1.0)
            if strip.unit == "deg" and np.ptp(axes.get_ylim()) > 150:
                axes.yaxis.set_major_locator(MultipleLocator(90))
    shadows = shadows_of(lanes[0][1]) if alone else []
    for axes in panels:
        for begin, end in shadows:
            axes.axvspan(begin / clock.size, end / clock.size, color=theme.faint, alpha=0.18, linewidth=0)
        axes.margins(x=0)
    if not alone:
        panels[0].legend(loc="lower right", bbox_to_anchor=(1.02, 0.97), ncols=7, handlelength=1.0)
    panels[-1].set_xlabel(f"{clock.label}; shaded: in shadow" if shadows else clock.label)


def _keeps_its_length(vector: xr.DataArray) -> bool:
    lengths = np.linalg.norm(read_values(vector[:MOST_ROWS]), axis=-1)
    return not float(np.ptp(lengths)) > SAME_LENGTH * float(lengths.max())


def _seen(run: xr.Dataset, letter: str, rows: int) -> np.ndarray:
    """The first rows of a component; a vector in the body is along the user's axes."""
    values, frame = read_values(run[letter][:rows]), frame_of(run)
    if not (abs(values) < LARGEST).all():
        raise InputError(f"expected a run whose {letter} is finite and below {LARGEST:g}, got one beyond.")
    return (frame.vectors(values) if letter in frame.along else values) * _words(run, letter).size


class Words(NamedTuple):
    """A component of the state in words, of a run of a body in SI; else its letter."""

    name: str
    unit: str = ""
    size: float = 1.0
    coordinates: str = ""  # names of its coordinates

    def coordinate(self, label: str) -> str:
        """The name of a coordinate with its unit."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.coordinates[int(label) - 1]}{unit}" if self.coordinates else f"{self.name[:-1]}_{{{label}}}$"


def _words(run: xr.Dataset, letter: str) -> Words:
    frame = frame_of(run)
    if letter not in frame.names:
        return Words(f"${letter}$")
    unit, size = frame.units.get(letter, ("", 1.0))
    word = frame.names[letter].replace("_", " ")
    return Words(f"the {'upward vertical' if word == 'up' else word}", unit, size, "xyz")


def _sphere(axes: Any, lanes: list[tuple[str, xr.Dataset]], letter: str, theme: Theme) -> None:
    paths, clock = [_seen(lane, letter, MOST_ROWS) for _, lane in lanes], clock_of(lanes[0][1])
    tip = f"tip of {_words(lanes[0][1], letter).name}"
    radius = max(float(np.linalg.norm(xyz[:1], axis=-1).max()) for xyz in paths) or 1.0
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = radius * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    axes.plot_wireframe(*ball, rstride=4, cstride=4, color=theme.faint, linewidth=0.3, alpha=0.6)
    spans = set()
    for number, ((name, lane), xyz) in enumerate(zip(lanes, paths, strict=True)):
        colour = theme.colour(number)
        size = float(np.linalg.norm(xyz[0])) or 1.0
        if _advance_per_row(lane, letter) < MOST_GAP:
            arc = np.cumsum(np.linalg.norm(np.diff(xyz, axis=0), axis=-1))
            shown = int(np.searchsorted(arc, ARC_SHOWN * size / len(lanes))) + 1
            axes.plot(*_on_sphere(xyz[:shown], size).T, color=colour, linewidth=0.8, label=name or tip)
            spans.add(f"to {clock.text(read_values(lane['time'][: min(shown, len(xyz))])[-1])}")
        else:
            dots = xyz[mixed(xyz, MOST_DOTS // len(lanes))]
            axes.plot(*dots.T, ".", color=colour, markersize=1.0, label=name or tip)
            spans.add("saved states")
        label = "start" if number == len(lanes) - 1 else None
        axes.plot(*xyz[:1].T, "o", color=theme.ink, markerfacecolor=theme.colours[1], markersize=4, label=label)
    _draw_axes(axes, [run for _, run in lanes], radius, theme)
    axes.set_box_aspect((1, 1, 1), zoom=1.2)
    axes.set(xlim=(-radius, radius), ylim=(-radius, radius), zlim=(-radius, radius))
    axes.set_axis_off()
    axes.view_init(elev=22, azim=-55)
    span = spans.pop() if len(spans) == 1 else "the first rotations of each lane"
    axes.set_title(f"{tip} on its sphere, {span}", y=1.12)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.04), ncols=4, markerscale=1.0, handlelength=1.4)


def _draw_axes(axes: Any, lanes: list[xr.Dataset], radius: float, theme: Theme) -> None:
    """The axes of the frame of the vector, and the vertical or the body's axis if it is at rest in this frame.

    The vertical or the axis is omitted if lanes differ in it.
    """
    run = lanes[0]
    halo = [withStroke(linewidth=2.5, foreground=theme.paper)]  # of letters in front of a path
    space = run.attrs.get("frame") == Frame.REST.value
    vectors = [fixed_in(lane, "space" if space else "body") for lane in lanes]
    usable = [v / np.linalg.norm(v) for v in vectors if v is not None and v.shape == (3,) and v.any()]
    fixed = usable[0] if len(usable) == len(lanes) and np.allclose(usable, usable[0]) else None
    fixed = fixed if fixed is None or space else frame_of(run).axes @ fixed
    covered = np.zeros(3) if fixed is None or space else fixed
    for number, name in enumerate("123" if run.attrs.get("frame") == Frame.MOVING.value else "xyz"):
        end = np.zeros(3)
        end[number] = 1.2 * radius
        axes.plot(*zip(np.zeros(3), end, strict=True), color=theme.faint, linewidth=0.7)
        if covered[number] < NEAR_AXIS:
            style = {"color": theme.faint, "path_effects": halo, "ha": "center", "va": "center", "zorder": 20}
            axes.text(*(1.1 * end), name, **style)
    if fixed is None:
        return
    colour = theme.colours[2]
    start, way, name = (fixed, -0.5 * fixed, "gravity") if space else (np.zeros(3), 1.3 * fixed, "axis of the body")
    apart = np.array([-0.95, -0.75, 0.0]) if space else np.zeros(3)
    start = start + apart - fixed * (apart @ fixed)
    axes.quiver(*(radius * start), *(radius * way), color=colour, linewidth=1.4, arrow_length_ratio=0.25)
    axes.text(*(radius * (start + (0.12 if space else 1.4) * fixed)), name, color=colour, ha="center")


def _advance_per_row(run: xr.Dataset, letter: str) -> float:
    """The motion of the tip between two saved rows over its length, by its speed: distances of rows may deceive."""
    record = RunRecord.from_attrs(run.attrs)
    model, first = None if record.is_own else model_for(run, None), read_values(run[letter][:2])
    size = float(np.linalg.norm(first[0])) or 1.0
    if model is None or model.system.perturbation is not None:  # no flow of the state is available
        return float(np.linalg.norm(np.diff(first, axis=0))) / size
    kinds = dict(model.system.space.components)
    start = {k: read_values(run[k][:1])[0] for k in kinds}  # a scalar index would import dask
    speed = np.linalg.norm(model.flow(*model.state(**start).values())[list(kinds).index(letter)])
    return float(speed * np.diff(read_values(run["time"][:MOST_ROWS])).max(initial=0.0)) / size


def _on_sphere(xyz: np.ndarray, radius: float, pieces: int = 6) -> np.ndarray:
    """Points joined by arcs instead of chords."""
    rows = np.linspace(0, len(xyz) - 1, pieces * (len(xyz) - 1) + 1)
    chords = np.stack([np.interp(rows, np.arange(len(xyz)), column) for column in xyz.T], -1)
    return radius * chords / np.linalg.norm(chords, axis=-1, keepdims=True)


def _components(panel: Any, lane: tuple[str, xr.Dataset], letter: str, theme: Theme) -> None:
    """The first saved states, and all rows in two of the components that change most."""
    name, run = lane
    clock, words = clock_of(run), _words(run, letter)
    above, below = panel.subplots(2, 1, height_ratios=[1, 1.25])
    time, values = read_values(run["time"][:STATES_SHOWN]), _seen(run, letter, STATES_SHOWN)
    (values, labels), (path, _) = coordinates_of(values), coordinates_of(_seen(run, letter, MOST_ROWS))
    for i, (label, series) in enumerate(zip(labels, values.T, strict=True)):
        style = {"color": theme.colour(i), "linestyle": DASHES[i // len(theme.colours) % len(DASHES)]}
        above.plot(time / clock.size, series, label=words.coordinate(label), **style)
    title = f"components of {words.name}{f' of {name}' if name else ''}, first {len(time)} saved states"
    above.set(xlabel=clock.label, title=title)
    above.legend(ncols=min(values.shape[1], 3), loc="upper left", bbox_to_anchor=(0, -0.3), handlelength=1.4)
    i, *second = sorted(np.argsort(-np.ptp(path, axis=0), kind="stable")[:2].tolist())
    j = second[0] if second else i
    dots = path[mixed(path, MOST_DOTS)]
    below.plot(dots[:, i], dots[:, j], ".", color=theme.colours[0], markersize=1.2, markeredgewidth=0)
    start = {"color": theme.ink, "markerfacecolor": theme.colours[1], "markersize": 4, "label": "start"}
    below.plot(path[:1, i], path[:1, j], "o", **start)
    title = f"saved states to {clock.text(float(read_values(run['time'][: len(path)])[-1]))}"
    below.set(xlabel=words.coordinate(labels[i]), ylabel=words.coordinate(labels[j]), title=title)
    below.set_aspect("equal", "datalim")
    below.legend(loc="upper right")


def _draw_drifts(panel: Any, runs: list[xr.Dataset], theme: Theme) -> None:
    """A strip for each family of integrals, all with one scale."""
    run, record = runs[0], RunRecord.from_attrs(runs[0].attrs)
    reference = record.method == "dop853"
    changes = _envelopes(run, with_unconserved=reference)
    of_balance = not changes and BALANCE in run
    changes |= _envelopes(run, with_unconserved=True, only=BALANCE) if of_balance else {}
    still = [family for family, change in changes.items() if not np.nanmax(change, initial=0.0) > 0]
    families = {k: v for k, v in changes.items() if k not in still} or {"": np.full(len(_thinned_time(run)), np.nan)}
    others = [
        (second_run, _named(RunRecord.from_attrs(second_run.attrs), record), _envelopes(second_run, True))
        for second_run in runs[1:]
    ]
    columns = 1 + (len(families) > 7)
    rows = -(-len(families) // columns)
    panels = panel.subplots(rows, columns, sharex=True, sharey=True, squeeze=False, gridspec_kw={"hspace": 0.06}).T
    clock = clock_of(run)
    ends = [0.0, *read_values(run["time"][[0, -1]]).tolist()]
    first, last = min(ends), max(ends) if max(ends) > min(ends) else record.dt
    time = np.linspace(0, last, 400)[1:]
    width = MACHINE_EPSILON * np.sqrt(time / record.dt)
    drawn = [*families.values(), *(v for *_, envelopes in others for k, v in envelopes.items() if k in families)]
    largest = [float(np.nanmax(v, initial=0.0)) for v in drawn]
    top, low = max([width[-1], *largest]), min([LEAST, *(v / 10 for v in largest if v > 0)])
    for number, (axes, (family, change)) in enumerate(zip(panels.flat, families.items(), strict=False)):
        for second, name, envelopes in others:
            if family in envelopes:
                seconds = _thinned_time(second) / clock_of(second).second
                axes.plot(seconds * clock.second / clock.size, envelopes[family], color=theme.faint, label=name)
        style = {"color": theme.colour(number), "linewidth": 0.7, "label": brief(record.method, MOST_TITLE)}
        (line,) = axes.plot(_thinned_time(run) / clock.size, change, **style)
        changed = np.pad(np.isfinite(change), 1)
        if (single := changed[1:-1] & ~changed[:-2] & ~changed[2:]).any():  # between rows without a change
            line.set(marker=".", markersize=4, markevery=single)
        walk = r"$2^{-52}\,\sqrt{\mathrm{steps}}$"
        axes.plot(time / clock.size, width, color=theme.ink, linestyle="--", linewidth=0.9, label=walk)
        axes.set(yscale="log", xlim=(first / clock.size, last / clock.size), ylim=(low, 30 * top))
        plain = {"fontsize": "small", "parse_math": False}
        axes.text(0.01, 0.96, family.replace("_eps", " of the map"), transform=axes.transAxes, va="top", **plain)
        axes.locator_params(axis="y", numticks=4)
    for axes in panels.flat[len(families) :]:
        axes.set_visible(False)
    for column in panels:
        column[-1].set_xlabel(clock.label)
    panel.supylabel("change since the start, relative", fontsize="medium")
    title = "integrals of the flow" if reference else "integrals that the method conserves"
    panels.flat[0].set_title("balance: energy minus work done" if of_balance else title)
    handles, labels = panels.flat[0].get_legend_handles_labels()
    panel.legend(handles, labels, loc="outside lower left", ncols=3)
    if still:
        style = {"ha": "right", "va": "bottom", "fontsize": "small", "parse_math": False}
        panel.text(0.99, 0.005, f"no change at all: {', '.join(still)}", **style)


def _envelopes(run: xr.Dataset, with_unconserved: bool, only: str = "") -> dict[str, np.ndarray]:
    """The largest |change| of each family of integrals, thinned, relative to the integral's scale."""
    edges = stretches(run.sizes["time"], STRETCHES)
    out: dict[str, np.ndarray] = {}
    for series in all_series(run):
        if (series.conserved or with_unconserved) and only in ("", series.family):
            scale = series.step_scale + series.value_scale
            change = np.maximum.reduceat(abs(series.values - series.values[0]), edges) / (scale or 1.0)
            out[series.family] = np.maximum(out[series.family], change) if series.family in out else change
    return {k: np.where(v > 0, v, np.nan) for k, v in out.items()}


def _thinned_time(run: xr.Dataset) -> np.ndarray:
    return np.asarray(read_values(run["time"])[stretches(run.sizes["time"], STRETCHES)])


# -- sweeps: summaries of lanes over one or two of the quantities that vary ------------------------


MOST_PANELS = 3
MOST_POINTS = 50_000
FEW = 200  # lanes, whose points are larger
DRIFT = "largest drift, relative"


def sweep_figure(run: xr.Dataset, show: str | None = None, theme: str = "light") -> Figure:
    """A panel for each summary, by default the motion of the carried vector, its frequency and the worst drift.

    run    a sweep by lane;  show   a variable of it instead, or one entry, "a_max[2]"

    Over one quantity of the grid each lane is a point; over two the colour is the median of the lanes that share both;
    without a grid the first varying quantity is the axis.  Raises `InputError` if the sweep has no such variable.
    """
    inputs = {
        str(name): np.asarray(v.values, dtype=float)
        for name, v in run.variables.items()
        if v.attrs.get("kind") == "input" and v.ndim == 1 and "flag_meanings" not in v.attrs
    }
    varied = {k: v for k, v in inputs.items() if len(np.unique(v)) > 1}
    grids = {k: v for k, v in varied.items() if len(np.unique(v)) < len(v)}  # whose values occur in several lanes
    chosen = dict(list(grids.items())[:2] or list(varied.items())[:1])
    chosen = {_with_unit(run, k): v for k, v in chosen.items()}
    axes = chosen or {"lane": np.arange(run.sizes["lane"], dtype=float)}
    panels = _panels(run) if show is None else _entry(run, show)
    with figure(theme, 4.1 * len(panels) + 0.6, 3.9) as (picture, colours):
        for place, (label, value) in enumerate(panels.items()):
            _panel(picture, picture.add_subplot(1, len(panels), place + 1), axes, label, value, colours)
        failed = int((run["failed"].values != 0).sum())
        lost = f", {failed:,} failed or missing" if failed else ""
        picture.suptitle(f"{brief(run.attrs.get('title', 'sweep'), 100)}{lost}", fontsize=10)
    return picture


def _panels(run: xr.Dataset) -> dict[str, np.ndarray]:
    out: dict[str, np.ndarray] = {}
    highest = [str(name) for name in run.variables if str(name).endswith("_max") and name != "g_max"]
    for letter in (name.removesuffix("_max") for name in highest[-1:]):
        value = np.asarray(run[f"{letter}_max"].values) - np.asarray(run[f"{letter}_min"].values)
        place = np.unravel_index(np.nan_to_num(value).sum(0).argmax(), value.shape[1:])  # of the entry that varies most
        entry, at = f"{letter}[{', '.join(map(str, place))}]" if place else letter, (slice(None), *place)
        out[_with_unit(run, f"{letter}_max", f"{entry}: max - min")] = value[at]
        if f"{letter}_frequency" in run.variables:
            name = f"{letter}_frequency"
            out[_with_unit(run, name, f"{entry}: frequency")] = np.asarray(run[name].values)[at]
    drifts = {str(k): v for k, v in run.variables.items() if str(k).endswith("_drift")}
    kept = [k.removesuffix("_drift") for k, v in drifts.items() if "not conserved" not in str(v.attrs.get("long_name"))]
    if kept:
        out[DRIFT] = np.max([_relative_drift(run, family) for family in kept], 0)
    if not out:
        raise InputError(
            "The sweep saved neither drift nor extremes: say what to draw, --show NAME, one of "
            f"{', '.join(str(k) for k in run.data_vars)}."
        )
    return dict(list(out.items())[:MOST_PANELS])


def _with_unit(run: xr.Dataset, name: str, label: str = "") -> str:
    """A label, by default the name of a variable, with the unit of the variable."""
    unit = run[name].attrs.get("units", "1")
    return f"{label or name}{f' ({unit})' if unit != '1' else ''}"


def _relative_drift(run: xr.Dataset, family: str) -> np.ndarray:
    """The largest |change| in each lane over the largest value at time 0 of all lanes: families differ in units."""
    scale = np.nanmax(abs(np.asarray(run[f"{family}_start"].values)), initial=0.0) or 1.0
    return np.asarray(run[f"{family}_drift"].values).reshape(run.sizes["lane"], -1).max(1) / scale


def _entry(run: xr.Dataset, show: str) -> dict[str, np.ndarray]:
    name, _, entry = show.removesuffix("]").partition("[")
    names = [str(k) for k, v in run.variables.items() if v.dims[:1] == ("lane",) and v.dtype.kind == "f"]
    if name not in names:
        raise InputError(f"--show: expected one of {', '.join(names)}, got {shown(show)}.{hint(name, names)}")
    value: Any = np.asarray(run[name].values)
    index = [int(i) for i in entry.split(",") if i.strip().isdecimal()]
    if len(index) != value.ndim - 1 or any(i >= k for i, k in zip(index, value.shape[1:], strict=True)):
        entry = ",".join(["0"] * (value.ndim - 1))
        raise InputError(f"--show: {name} has the shape {value.shape[1:]}: one entry is {name}[{entry}], got {show}.")
    return {_with_unit(run, name, show): value[(slice(None), *index)]}


def _panel(picture: Figure, axes: Any, along: Any, label: str, value: np.ndarray, theme: Theme) -> None:
    tiny = label == DRIFT or "_drift" in label
    medians = pd.Series(value).groupby(list(along.values())[::-1]).median()
    logarithmic = tiny and bool((medians > 0).any())
    if len(along) == 2:
        table, norm = medians.unstack(), {"norm": "log"} if logarithmic else {}
        style = {"cmap": "viridis", "shading": "nearest", **norm}
        picture.colorbar(axes.pcolormesh(table.columns, table.index, table.values, **style), ax=axes)
        axes.grid(visible=False)
        axes.set(**dict(zip(("xlabel", "ylabel"), along, strict=True)), title=label)
        return
    ((name, x),) = along.items()
    every, size = max(1, len(x) // MOST_POINTS), 5 if len(x) < FEW else 3
    axes.plot(x[::every], value[::every], ".", color=theme.colours[0], markersize=size, alpha=0.6)
    if len(medians) < len(x):
        axes.plot(medians.index, medians.values, "-", color=theme.colours[1], linewidth=1.2, label="median")
        axes.legend(fontsize=7)
    axes.set(xlabel=name, ylabel=label, yscale="log" if logarithmic else "linear")
