"""Figures: angles, rates, events, sections, return maps, spectra, comparisons of `kr.analysis`, check cases.

Each function draws a matplotlib figure in the style "house", theme "light" or "dark", which a notebook displays, with
or without pyplot, and which is saved in its style.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from kreisel.analysis.quantities import Quantity, label, series
from kreisel.errors import InputError, counted
from kreisel.viewer.frames import extremes
from kreisel.viewer.style import WIDTHS, Theme, theme_of

if TYPE_CHECKING:
    from kreisel.analysis.comparison import Comparison
    from kreisel.analysis.frequencies import Lines
    from kreisel.analysis.method_comparison import MethodComparison
    from kreisel.checkcases.catalogue import Case

FILES = ("savefig.", "pdf.", "ps.", "svg.")
MOST_POINTS = 20_000  # of a series; extremes are kept
ROWS_OF_CASE = 1201
STILL = 1e-3  # an axis that moves less shows nothing


class ShownFigure(Figure):
    """A figure of matplotlib with a picture for notebooks; settings of files are fixed at its creation."""

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        self._for_files = {key: value for key, value in mpl.rcParams.items() if key.startswith(FILES)}

    def savefig(self, fname: Any, **options: Any) -> None:
        """Save as matplotlib does."""
        with mpl.rc_context(self._for_files):
            super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", dpi=self.dpi)
        return out.getvalue()

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        """The picture only: if pyplot is loaded, IPython would add another one."""
        return {"image/png": self._repr_png_(), "text/plain": repr(self)}


@contextmanager
def figure(
    theme: str, width: float = 7.0, height: float = 4.0, style: str | None = None
) -> Iterator[tuple[ShownFigure, Theme]]:
    """A figure and its theme, inches wide and high; with a style in widths of it.  Raises `InputError`."""
    colours, unit = theme_of(theme, style or "house"), 1.0 if style is None else WIDTHS[style]
    with mpl.rc_context(cast("Any", colours.rc)):
        yield ShownFigure(figsize=(width * unit, height * unit), layout="constrained"), colours


# -- analyses --------------------------------------------------------------------------------------


def _draw_series(axes: Any, run: xr.Dataset, values: Any, colour: str) -> None:
    values = np.asarray(values).reshape(run.sizes["time"], -1)
    rows = extremes(values, MOST_POINTS)
    axes.plot(run["time"].values[rows], values[rows], color=colour, linewidth=0.8)


def _time(data: xr.Dataset) -> str:
    unit = data["time"].attrs.get("units", "1")
    return f"time ({unit})" if unit != "1" else "time"


def plot_series(data: xr.Dataset, *, theme: str = "light") -> Figure:
    """Every variable along time, a panel each, all lanes: a result of `euler_angles` or `rates`."""
    names = [name for name, v in data.data_vars.items() if "time" in v.dims]
    if not names:
        raise InputError(f"Nothing here is along time: {', '.join(map(str, data.data_vars)) or 'no variables'}.")
    with figure(theme, 7.0, 1.2 + 1.2 * len(names)) as (picture, colours):
        panels = picture.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for number, (name, axes) in enumerate(zip(names, panels, strict=True)):
            _draw_series(axes, data, data[name], colours.colour(number))
            units = data[name].attrs.get("units", "")
            axes.set_ylabel(f"{name}\n({units})" if units not in ("", "1") else str(name))
        panels[-1].set_xlabel(_time(data))
        picture.suptitle(str(data.attrs.get("title", "")), fontsize=10)
    return picture


def plot_events(run: xr.Dataset, crossings: xr.Dataset, quantity: Quantity, *, theme: str = "light") -> Figure:
    """A quantity along a run, the value, and the events on it."""
    with figure(theme, 7.0, 3.2) as (picture, colours):
        axes = picture.subplots()
        _draw_series(axes, run, series(run, quantity), colours.colours[0])
        axes.axhline(crossings.attrs["value"], color=colours.faint, linewidth=0.8)
        for number, (way, marker) in enumerate((("rising", "^"), ("falling", "v")), 1):
            times = crossings["time"].values[crossings["rising"].values == (way == "rising")]
            style: dict[str, Any] = {"color": colours.colours[number], "markersize": 4, "label": way}
            axes.plot(times, np.full(len(times), crossings.attrs["value"]), marker, **style)
        axes.set(xlabel=_time(run), ylabel=label(quantity))
        axes.legend(loc="upper right", ncols=2)
    return picture


def plot_section(cut: xr.Dataset, x: Quantity, y: Quantity, *, theme: str = "light") -> Figure:
    """A Poincare section: two quantities of the states on it, a colour for each lane."""
    plain = cut.reset_coords("lane", drop=True) if "lane" in cut.coords else cut
    lanes = cut["lane"].values if "lane" in cut.coords else np.zeros(cut.sizes["event"], dtype=int)
    across, up = series(plain, x), series(plain, y)
    with figure(theme, 5.0, 4.6) as (picture, colours):
        axes = picture.subplots()
        for number, lane in enumerate(np.unique(lanes)):
            style: dict[str, Any] = {"color": colours.colour(number), "markersize": 2.0, "markeredgewidth": 0}
            axes.plot(across[lanes == lane], up[lanes == lane], ".", **style)
        title = f"section {cut.attrs['quantity']} = {cut.attrs['value']:g}, {counted(cut.sizes['event'], 'point')}"
        axes.set(xlabel=label(x), ylabel=label(y), title=title)
    return picture


def plot_return_map(returns: xr.Dataset, *, theme: str = "light") -> Figure:
    """The return map: the quantity at a crossing, and at the next crossing."""
    with figure(theme, 4.6, 4.4) as (picture, colours):
        axes = picture.subplots()
        values = np.concatenate([returns["here"].values, returns["after"].values])
        ends = [values.min(initial=np.inf), values.max(initial=-np.inf)] if values.size else [0, 1]
        axes.plot(ends, ends, color=colours.faint, linewidth=0.8, label="fixed points")
        axes.plot(returns["here"], returns["after"], ".", color=colours.colours[0], markersize=2.5)
        seen, count = returns.attrs["seen"], returns.attrs["returns"]
        axes.set(xlabel=seen, ylabel=f"{seen}, {counted(count, 'return')} later", aspect="equal")
        axes.legend(loc="upper left")
    return picture


def plot_lines(lines: Lines, *, theme: str = "light") -> Figure:
    """The windowed spectrum of a signal, and its lines."""
    time, values = lines.time, lines.values
    step = time[1] - time[0]
    window = np.hanning(len(time))
    omega = 2 * np.pi * np.fft.fftfreq(len(time), step)
    halves = 1 if np.iscomplexobj(values) else np.where(omega == 0, 1, 2)  # a real line is at omega and -omega
    spectrum = np.abs(np.fft.fft(window * values)) / window.sum() * halves
    order = np.argsort(omega)
    use = order if np.iscomplexobj(values) else order[omega[order] >= 0]
    with figure(theme, 7.0, 3.6) as (picture, colours):
        axes = picture.subplots()
        axes.semilogy(omega[use], spectrum[use] + 1e-300, color=colours.faint, linewidth=0.8, label="window of Hann")
        size, most = np.abs(lines.amplitude), spectrum[use].max() or 1.0
        axes.vlines(lines.frequency, lines.remainder or 1e-17 * most, size, color=colours.colours[1], linewidth=1.0)
        axes.plot(lines.frequency, size, "o", color=colours.colours[1], markersize=4, label="lines")
        reach = 1.5 * np.abs(lines.frequency).max(initial=4 * np.pi / (time[-1] - time[0]))
        axes.set(xlabel="angular frequency", ylabel=f"amplitude of {lines.quantity}")
        axes.set_xlim(-reach if np.iscomplexobj(values) else 0, reach)
        axes.set_ylim(1e-16 * most, 3 * most)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return picture


def plot_comparison(comparison: Comparison, *, theme: str = "light") -> Figure:
    """Distances of two runs against time, and the largest change of each integral in both."""
    with figure(theme, 9.0, 3.8) as (picture, colours):
        left, right = picture.subplots(1, 2, width_ratios=[1.3, 1])
        data = comparison.distance
        for number, (name, values) in enumerate(data.data_vars.items()):
            worst = np.maximum(values.values.reshape(data.sizes["time"], -1).max(-1), 1e-17)
            left.plot(data["time"][1:], worst[1:], color=colours.colour(number), label=str(name))
        left.set(xscale="log", yscale="log", xlabel=_time(data), title="distance, relative")
        left.legend(loc="upper left")
        table = comparison.drift
        place, changes = np.arange(len(table)), table[["first", "second"]].to_numpy()
        least = changes.min(initial=1.0, where=changes > 0) / 10  # no change at all: left of the others
        for number, marker in enumerate("os"):
            style = {"color": colours.colours[number], "label": comparison.names[number], "markersize": 4}
            right.plot(np.maximum(changes[:, number], least), place, marker, **style)
        right.set(xscale="log", xlabel="largest |change|", title="integrals")
        right.set_yticks(place, [str(name) for name in table.index])
        right.invert_yaxis()
        right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16))
    return picture


def plot_methods(comparison: MethodComparison, *, theme: str = "light") -> Figure:
    """Errors of methods against the step, with their slopes, and the drift of the integrals against time."""
    with figure(theme, 9.0, 3.8) as (picture, colours):
        left, right = picture.subplots(1, 2)
        errors, drifts, table = comparison.errors, comparison.drifts, comparison.table
        for number, name in enumerate(table.index):
            style = {"color": colours.colour(number), "label": f"{name}: order {table.order[name]:.1f}"}
            left.plot(errors["dt"], np.maximum(errors[number], 1e-17), "o-", markersize=3.5, **style)
            right.plot(drifts["time"][1:], np.maximum(drifts[number][1:], 1e-17), color=colours.colour(number))
        title = f"error after {8 * float(errors['dt'][0]):.3g}, relative"
        left.set(xscale="log", yscale="log", xlabel="step", title=title)
        left.set_xticks(errors["dt"], [f"{step:.3g}" for step in errors["dt"].values])
        left.minorticks_off()
        right.set(yscale="log", xlabel="time", title="largest change of an integral so far, relative")
        picture.legend(loc="outside lower center", ncols=min(len(table), 3))
    return picture


# -- check cases -----------------------------------------------------------------------------------


def plot_case(case: Case, *, theme: str = "light") -> Figure:
    """Angular velocity along the body axes; in space, the body axis nearest to the momentum, or one that moves."""
    from kreisel.checkcases.laws import arrays, rotation

    truth = case.reference(case.times(ROWS_OF_CASE))
    time, w = truth.time.values, truth.angular_velocity.values
    momentum = truth.momentum.values[0]
    R = np.array(rotation(arrays(truth.attitude.values)))  # (3, 3, rows)
    axis = int(np.argmax(abs(R[:, :, 0].T @ momentum)))
    if np.ptp(R[:, axis], axis=1).max() < STILL:
        axis = (axis + 1) % 3
    path = R[:, axis].T
    with figure(theme, 7.4, 3.2) as (picture, colours):
        rates = picture.add_subplot(1, 2, 1)
        for k in range(3):
            rates.plot(time, w[:, k], color=colours.colour(k), linewidth=1.0, label=f"$\\omega_{k + 1}$")
        rates.set(xlabel="time (s)", ylabel="angular velocity, body axes (rad/s)", xlim=(0, time[-1]))
        rates.grid(True)
        rates.legend(loc="upper center", bbox_to_anchor=(0.5, 1.13), ncols=3, frameon=False)
        ball = picture.add_subplot(1, 2, 2, projection="3d")
        u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
        globe = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
        ball.plot_wireframe(*globe, rstride=4, cstride=4, color=colours.faint, linewidth=0.3, alpha=0.6)
        ball.plot(*path.T, color=colours.colour(0), linewidth=0.8)
        ball.plot(*path[:1].T, "o", color=colours.ink, markerfacecolor=colours.colour(1), markersize=4, label="start")
        ball.plot(*path[-1:].T, "s", color=colours.ink, markerfacecolor=colours.colour(2), markersize=4, label="end")
        ball.set_box_aspect((1, 1, 1), zoom=1.25)
        ball.set_axis_off()
        ball.view_init(elev=22, azim=-55)
        ball.set_title(f"body axis {axis + 1} in space", y=0.98)
        ball.legend(loc="lower center", bbox_to_anchor=(0.5, -0.06), ncols=2, frameon=False)
        picture.suptitle(case.name, fontsize=10)
    return picture
