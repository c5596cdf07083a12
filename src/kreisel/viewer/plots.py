"""kr.plot: the trajectory beside the drift of every integral."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel.errors import InputError, brief, explained
from kreisel.kernels.layout import MACHINE_EPSILON
from kreisel.method.driven import BALANCE
from kreisel.runs.drift import all_series, read_values
from kreisel.runs.geometry import model_for
from kreisel.runs.run_record import RunRecord
from kreisel.viewer.style import Theme, theme_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

ARC_SHOWN = 45  # radii of path drawn on the sphere, so that the pattern stays readable
SAME_LENGTH = 1e-3  # relative: a vector whose length changes by more is on no sphere
MOST_GAP = 0.3  # radii between saved states beyond which a line would be a guess: dots then
MOST_DOTS = 4000
STATES_SHOWN = 120
STRETCHES = 1200
MOST_TITLE = 120
MOST_ROWS = 200_000  # read for the picture of the path
LARGEST = 1e100  # of numbers that are drawn: their squares do not overflow


@explained
def plot(run: xr.Dataset, *, compare: xr.Dataset | None = None, theme: str = "light") -> Figure:
    """A figure of a run: the tip of the axis on its sphere (n = 3) or the components, and every drift.

    The change of each family of Casimirs and integrals that the method conserves is drawn on a logarithmic scale,
    relative to the integral's scale (`kr.drift`), with the width eps_machine * sqrt(steps) of a random walk of
    rounding errors.  `compare` is a second run of the same system, drawn in grey by its worst integral.
    `theme` is "light" or "dark".  Raises `InputError` if it is of another system, if the run lacks the vector that is
    drawn, and for states at given times (`kr.at`), which are no run.
    """
    runs = [run] if compare is None else [run, compare]
    records = [RunRecord.of(each, "system", "title", "method", "n", "steps") for each in runs]
    if not all(record.stepped for record in records):
        raise InputError("A run of kr.simulate was expected, got states at given times, of kr.at.")
    if records[-1].system != records[0].system:
        raise InputError(f"Runs of one system can be compared, got {records[0].system} and {records[1].system}.")
    import matplotlib as mpl
    from matplotlib.figure import Figure

    colours = theme_of(theme)
    with mpl.rc_context(cast("Any", colours.rc)), np.errstate(all="ignore"):
        figure = Figure(figsize=(9.2, 4.4), layout="constrained")
        left, right = cast("Any", figure.subfigures(1, 2, width_ratios=[1, 1.25]))
        vector = _vector_letter(run, records[0])
        one = run.isel(lane=0) if "lane" in run.dims else run
        if one[vector].shape[1:] == (3,) and _keeps_its_length(one[vector]):
            _sphere(left.add_subplot(projection="3d"), one, vector, colours)
        else:
            _components(left.add_subplot(), one, vector, colours)
        _draw_drifts(right.add_subplot(), runs, records, colours)
        figure.suptitle(_title(*records), fontsize=10)
    return figure


def _title(run: RunRecord, *others: RunRecord) -> str:
    beside = "".join(f" beside {brief(other.method, MOST_TITLE)}" for other in others)
    return f"{brief(run.title, MOST_TITLE)}{beside}, n = {run.n}, {run.steps:,} steps of {run.dt:g}"


def _vector_letter(run: xr.Dataset, record: RunRecord) -> str:
    """The component that is drawn: the vector one of a pair (m, a), the position of (x, q)."""
    missing = record.missing_from(run)
    if missing:
        raise InputError(f"The run lacks {', '.join(missing)} of its state, which the figure needs.")
    return record.carried


def _keeps_its_length(vector: xr.DataArray) -> bool:
    lengths = np.linalg.norm(read_values(vector[:MOST_ROWS]), axis=-1)
    return not float(np.ptp(lengths)) > SAME_LENGTH * float(lengths.max())


def _drawable(values: np.ndarray, letter: str) -> np.ndarray:
    if not (abs(values) < LARGEST).all():
        raise InputError(f"expected a run whose {letter} is finite and below {LARGEST:g}, got one beyond.")
    return values


def _sphere(axes: Any, run: xr.Dataset, letter: str, theme: Theme) -> None:
    xyz = _drawable(read_values(run[letter][:MOST_ROWS]), letter)
    radius = float(np.linalg.norm(xyz[:1], axis=-1).max()) or 1.0
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = radius * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    axes.plot_wireframe(*ball, rstride=4, cstride=4, color=theme.faint, linewidth=0.3, alpha=0.7)
    arc = np.linalg.norm(np.diff(xyz, axis=0), axis=-1)
    if _advance_per_row(run, letter) < MOST_GAP * radius:
        shown = int(np.searchsorted(np.cumsum(arc), ARC_SHOWN * radius)) + 1
        axes.plot(*_on_sphere(xyz[:shown], radius).T, color=theme.colours[0], linewidth=0.8)
        span = f"to time {float(run['time'][shown - 1]):.4g}"
    else:
        axes.plot(*xyz[:MOST_DOTS].T, ".", color=theme.colours[0], markersize=1.0)
        span = "saved states"
    axes.plot(*xyz[:1].T, "o", color=theme.colours[1], markersize=4)
    axes.set_box_aspect((1, 1, 1), zoom=1.25)
    axes.set(xlim=(-radius, radius), ylim=(-radius, radius), zlim=(-radius, radius))
    axes.set_axis_off()
    axes.view_init(elev=22, azim=-55)
    axes.set_title(f"tip of ${letter}$ on its sphere, {span}", y=0.97)


def _advance_per_row(run: xr.Dataset, letter: str) -> float:
    """How far the tip moves between two saved rows by its speed at the start: distances of rows may deceive."""
    record = RunRecord.from_attrs(run.attrs)
    model = None if record.is_own else model_for(run, None)
    if model is None or model.system.perturbation is not None:  # no flow of the state alone is at hand
        return float(np.linalg.norm(np.diff(read_values(run[letter][:2]), axis=0)))
    kinds = dict(model.system.space.components)
    start = {k: read_values(run[k][0]) for k in kinds}
    speed = np.linalg.norm(model.flow(*model.state(**start).values())[list(kinds).index(letter)])
    return float(speed * record.dt * record.every)


def _on_sphere(xyz: np.ndarray, radius: float, pieces: int = 6) -> np.ndarray:
    """Points joined by arcs instead of chords."""
    rows = np.linspace(0, len(xyz) - 1, pieces * (len(xyz) - 1) + 1)
    chords = np.stack([np.interp(rows, np.arange(len(xyz)), column) for column in xyz.T], -1)
    return radius * chords / np.linalg.norm(chords, axis=-1, keepdims=True)


def _components(axes: Any, run: xr.Dataset, letter: str, theme: Theme) -> None:
    time, values = read_values(run["time"][:STATES_SHOWN]), _drawable(read_values(run[letter][:STATES_SHOWN]), letter)
    labels = [str(i + 1) for i in range(values.shape[1])]
    if values.ndim == 3:  # a matrix, skew or symmetric
        j, k = np.triu_indices(values.shape[1], k=int(not values[:, 0, 0].any()))
        values, labels = values[:, j, k], [f"{a + 1}{b + 1}" for a, b in zip(j, k, strict=True)]
    for i, (label, series) in enumerate(zip(labels, values.T, strict=True)):
        axes.plot(time, series, color=theme.colours[i % len(theme.colours)], label=f"${letter}_{{{label}}}$")
    axes.set(xlabel="time", title=f"components of ${letter}$, first {len(time)} saved states")
    axes.legend(ncols=min(values.shape[1], 6), loc="upper center", bbox_to_anchor=(0.5, -0.14))


def _draw_drifts(axes: Any, runs: list[xr.Dataset], records: list[RunRecord], theme: Theme) -> None:
    run, record, reference = runs[0], records[0], records[0].method == "dop853"
    for compare, other in zip(runs[1:], records[1:], strict=True):
        changes = list(_envelopes(compare, everything=True).values())
        worst = np.fmax.reduce(changes) if changes else np.full(len(_thinned_time(compare)), np.nan)
        label = f"worst integral by {brief(other.method, MOST_TITLE)}"
        axes.plot(_thinned_time(compare), worst, color=theme.faint, label=label)
    envelopes = _envelopes(run, everything=reference)
    of_balance = not envelopes and BALANCE in run
    envelopes |= _envelopes(run, everything=True, only=BALANCE) if of_balance else {}
    for number, (family, change) in enumerate(envelopes.items()):
        colour = theme.colours[number % len(theme.colours)]
        label = family.replace("_eps", " of the map")
        axes.plot(_thinned_time(run), change, color=colour, linewidth=0.7, label=label)
    ends = [0.0, *read_values(run["time"][[0, -1]]).tolist()]
    first, last = min(ends), max(ends) if max(ends) > min(ends) else record.dt
    time = np.linspace(0, last, 400)[1:]
    width = MACHINE_EPSILON * np.sqrt(time / record.dt)
    axes.plot(time, width, color=theme.ink, linestyle="--", linewidth=0.9, label=r"$2^{-52}\,\sqrt{\mathrm{steps}}$")
    axes.set(yscale="log", xlabel="time", ylabel="change since the start, relative", xlim=(first, last))
    axes.set_ylim(bottom=1e-17)
    title = "integrals of the flow" if reference else "what the method conserves"
    axes.set_title("balance: the energy less the work done" if of_balance else title)
    axes.legend(loc="upper left", ncols=2, bbox_to_anchor=(0, -0.14))


def _envelopes(run: xr.Dataset, everything: bool, only: str = "") -> dict[str, np.ndarray]:
    """For each family of integrals the largest |change|, thinned, relative to the integral's scale."""
    edges = _edges(run.sizes["time"])
    out: dict[str, np.ndarray] = {}
    for series in all_series(run):
        if (series.conserved or everything) and only in ("", series.family):
            scale = series.step_scale + series.value_scale
            change = np.maximum.reduceat(abs(series.values - series.values[0]), edges) / (scale or 1.0)
            out[series.family] = np.maximum(out[series.family], change) if series.family in out else change
    return {k: np.where(v > 0, v, np.nan) for k, v in out.items() if v.any()}


def _edges(rows: int) -> np.ndarray:
    """Starts of at most 1200 stretches; the largest change in each is drawn, so that no extreme is lost."""
    return np.unique(np.linspace(0, rows, min(rows, STRETCHES) + 1).astype(int)[:-1])


def _thinned_time(run: xr.Dataset) -> np.ndarray:
    return np.asarray(read_values(run["time"])[_edges(run.sizes["time"])])
