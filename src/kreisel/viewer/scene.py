"""The data of a page: frames, bodies, path, drifts, sections, events, as plain numbers and text."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, printable, shown
from kreisel.files import parsed
from kreisel.kernels.layout import MACHINE_EPSILON
from kreisel.record.model import Model
from kreisel.record.perturbation import pairs_of
from kreisel.runs.drift import all_series
from kreisel.runs.geometry import continued, model_for, require_unchanged
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import within
from kreisel.viewer.bodies import Body
from kreisel.viewer.frames import Frames, frames, windows
from kreisel.viewer.showing import Shown
from kreisel.viewer.style import THEMES
from kreisel.viewer.thinning import mixed

if TYPE_CHECKING:
    import xarray as xr

MOST_LANES = 9
MOST_PATH = 4_000  # points of the whole trace
MOST_STRETCHES = 1_200  # of a drift
MOST_SERIES = 24
MOST_POINTS = 5_000  # of a section
MOST_EVENTS = 500
LONGEST_TEXT = 300
STEADY = 2.0  # radians a second by which the fastest body turns at speed 1
TURNS = 3.0  # of the fastest body, of the trail
SHORT = 32767  # of a whole number for 1


def scene(
    run: xr.Dataset, lane: Any = None, *, body: str | Body | None = None, section: xr.Dataset | None = None
) -> dict[str, Any]:
    """The data of the page.  Raises `InputError` for what is no run, lacks its state, or has no such lane."""
    record = RunRecord.of(run, "system")
    if "time" not in run.dims or run.sizes["time"] < 1:
        raise InputError("A run of kr.simulate or kr.open_run was expected, with at least one saved state.")
    missing = record.missing_from(run)
    if missing:
        raise InputError(f"The run lacks {', '.join(missing)} of its state, which the page needs.")
    require_unchanged(run)
    part, lanes = _lanes(run, lane)
    model = None if record.is_own else model_for(part, None)
    found = frames(part, record, model if model is None or pairs_of(model) is None else None)
    bodies = [Shown(each, record, one, bool(found.joined.all()), body) for each, one in _each(found, record, lanes)]
    first = bodies[0]
    radius = max(each.radius for each in bodies)
    if not all(np.isfinite(each.tip).all() for each in bodies):
        raise InputError(f"{record.carried} is not finite at every saved time; `kreisel check` says where.")
    time = np.asarray(found.run["time"].values, dtype=np.float64)
    span = float(time[-1] - time[0]) or 1.0
    rate = found.rate if found.rate > 0 else 2 * math.pi / span
    meshes, places = _meshes(bodies)
    return {
        "title": _text(run.attrs.get("title", "")),
        "facts": [_text(v) for v in _facts(run, lanes)],
        "kind": first.kind,
        "note": " ".join(filter(None, (first.note, found.note))),
        "callout": first.callout,
        "legend": {k: _text(v) for k, v in first.legend.items()},
        "n": int(first.tip.shape[1]),
        "coordinates": first.coordinates,
        "letter": _text(record.carried),
        "radius": radius,
        "up": first.up,
        "spins": first.turn is not None and not first.callout,
        "frame": None if first.frame is None else first.frame.T.tolist(),
        "lowest": min(float(each.tip[:, 2].min()) for each in bodies) if first.tip.shape[1] == 3 else -radius,
        "meshes": meshes,
        "bodies": [_packed_body(each, name, place) for each, name, place in zip(bodies, lanes, places, strict=True)],
        "time": packed(time, "f8"),
        "windows": windows(found.joined),
        "pace": STEADY / rate,
        "trail": TURNS * 2 * math.pi / rate,
        "path": packed(mixed(np.concatenate([each.tip for each in bodies], 1), MOST_PATH // len(bodies)), "i4"),
        **_drift_series(part),
        "events": _events(part, record),
        "section": None if section is None else _section(section, lanes),
        "complete": bool(run.attrs.get("complete", True)),
        "themes": {
            name: {"ink": t.ink, "paper": t.paper, "grid": t.grid, "faint": t.faint, "colours": t.colours}
            for name, t in THEMES.items()
        },
    }


def _lanes(run: xr.Dataset, lane: Any) -> tuple[xr.Dataset, list[str]]:
    """The lanes that are shown, with a dimension unless there is one, and their names."""
    if "lane" not in run.dims:
        if lane is not None:
            within(lane, "lane", 0, 0)
        return run, [""]
    count = run.sizes["lane"]
    if lane is None:
        chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_LANES)).astype(int)).tolist()
    elif isinstance(lane, Sequence | np.ndarray) and not isinstance(lane, str):
        chosen = [within(each, "lane", 0, count - 1) for each in lane]
    else:
        chosen = [within(lane, "lane", 0, count - 1)]
    if not 1 <= len(chosen) <= MOST_LANES or len(set(chosen)) < len(chosen):
        raise InputError(f"lane: expected one lane, or up to {MOST_LANES} different ones, got {shown(lane)}.")
    names = [f"lane {int(run['lane'].values[i]) if 'lane' in run.coords else i}" for i in chosen]
    return (run.isel(lane=chosen) if len(chosen) > 1 else run.isel(lane=chosen[0])), names


def _each(found: Frames, record: RunRecord, lanes: list[str]) -> list[tuple[xr.Dataset, Model | None]]:
    """The frames of each lane, and its model."""
    alone = [found.run] if "lane" not in found.run.dims else [found.run.isel(lane=i) for i in range(len(lanes))]
    return [(each, None if record.is_own else model_for(each, None)) for each in alone]


def _meshes(bodies: list[Shown]) -> tuple[list[dict[str, Any]], list[int | None]]:
    """The different bodies, and which each lane has."""
    meshes: list[dict[str, Any]] = []
    places: list[int | None] = []
    for each in bodies:
        made = None if each.body is None else packed_mesh(each.body)
        if made is not None and made not in meshes:
            meshes.append(made)
        places.append(None if made is None else meshes.index(made))
    return meshes, places


def packed_mesh(body: Body) -> dict[str, Any]:
    """A body as base64."""
    wide = "u4" if len(body.points) > 65_535 else "u2"
    return {
        "points": packed(body.points, "f4"),
        "faces": packed(body.faces, wide),
        "wide": wide == "u4",
        "colour": packed(body.colour, "u1"),
    }


def _packed_body(each: Shown, name: str, mesh: int | None) -> dict[str, Any]:
    """Turns in whole numbers of 1/32767, far below a pixel; the tip only where no turn gives it."""
    turn = None if each.turn is None else packed(np.round(SHORT * continued(each.turn)), "i2")
    return {
        "name": _text(name),
        "mesh": mesh,
        "turn": turn,
        "axis": None if each.axis is None else [float(v) for v in each.axis],
        "tip": None if each.axis is not None else packed(each.tip, "f4"),
        "nose": None if each.nose is None else [float(v) for v in each.nose],
    }


def _events(run: xr.Dataset, record: RunRecord) -> list[list[Any]]:
    """Time and name of the events of a run."""
    if run.attrs.get("events") is None or run.attrs.get("event_times") is None:
        return []
    names, times = (parsed(run.attrs[k], f"The attribute {k}") for k in ("events", "event_times"))
    return [[float(time), _text(names[int(number)])] for time, number in times[:MOST_EVENTS]]


def _section(section: xr.Dataset, lanes: list[str]) -> dict[str, Any]:
    """Points of `kr.analysis.section` in two of its numbers, of the lanes that are shown."""
    missing = [k for k in ("quantity", "value") if k not in getattr(section, "attrs", {})]
    if missing or "event" not in section.dims:
        raise InputError(f"section: expected what kr.analysis.section returns, got {shown(section)}.")
    if "lane" in section.coords:
        chosen = [int(name.split()[1]) for name in lanes if name]
        section = section.isel(event=np.isin(section["lane"].values, chosen))
    names, columns = [], []
    for letter in section.data_vars:
        values = np.asarray(section[letter].values, dtype=np.float64).reshape(section.sizes["event"], -1)
        for i in range(values.shape[1]):
            if f"{letter}[{i}]" != str(section.attrs["quantity"]) and np.isfinite(values[:, i]).all():
                names.append(f"{letter}[{i}]")
                columns.append(values[:, i])
    columns, names = columns[:MOST_SERIES], names[:MOST_SERIES]
    if len(columns) < 2:
        raise InputError("section: expected at least two finite numbers at each point.")
    table = np.stack(columns, -1)[:MOST_POINTS]
    lane = section["lane"].values if "lane" in section.coords else np.zeros(section.sizes["event"], dtype=int)
    order = {name: i for i, name in enumerate(np.unique(lane).tolist())}
    return {
        "title": _text(f"section {section.attrs['quantity']} = {float(section.attrs['value']):g}"),
        "names": [_text(name) for name in names],
        "points": packed(table, "f4"),
        "time": packed(np.asarray(section["time"].values, dtype=np.float64)[:MOST_POINTS], "f8"),
        "lane": packed(np.array([order[each] for each in lane.tolist()][:MOST_POINTS]) % 256, "u1"),
    }


def _text(value: Any) -> str:
    text = printable(value)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 1] + "\u2026"


def packed(values: Array, kind: str) -> str:
    """An array as little-endian base64.  Raises `InputError` where it leaves the range of that kind."""
    with np.errstate(over="ignore"):
        kept = np.ascontiguousarray(values, dtype=f"<{kind}")
    if kept.dtype.kind == "f" and (np.isinf(kept) & np.isfinite(values)).any():
        raise InputError("expected a run whose numbers a page can show, below 3e38, got larger ones. Use other units.")
    return base64.b64encode(kept.tobytes()).decode("ascii")


def _facts(run: xr.Dataset, lanes: list[str]) -> list[str]:
    record, rows = RunRecord.from_attrs(run.attrs), run.sizes["time"]
    out = [str(run.attrs.get("equations", ""))]
    if record.stepped:
        out.append(f"{record.method}, n = {record.n}, {record.steps:,} steps of {record.dt:g}")
    out.append(f"{rows:,} saved states")
    return [*out, *([f"{len(lanes)} of {run.sizes['lane']:,} lanes"] if len(lanes) > 1 else [n for n in lanes if n])]


def _drift_series(run: xr.Dataset) -> dict[str, Any]:
    """For each Casimir and integral the change of largest size in even stretches of time, relative to its scale."""
    count = run.sizes["time"]
    edges = np.unique(np.linspace(0, count, min(count, MOST_STRETCHES) + 1).astype(int)[:-1])
    time = np.asarray(run["time"].values, dtype=np.float64)
    series = []
    for number, each in enumerate(all_series(run)):
        if number == MOST_SERIES:
            break
        change = each.values - each.values[0]
        high, low = np.maximum.reduceat(change, edges), np.minimum.reduceat(change, edges)
        scale = each.step_scale + each.value_scale or 1.0
        series.append(
            {
                "name": _text(each.name),
                "conserved": each.conserved,
                "start": _json_float(each.values[0]),
                "scale": _json_float(scale) or 1.0,
                "most": _json_float(abs(change).max()),
                "change": packed(np.where(high >= -low, high, low), "f4"),
            }
        )
    record = RunRecord.from_attrs(run.attrs)
    steps = float(time[-1] - time[0]) / record.dt if record.stepped else 0.0
    return {"series": series, "edges": packed(time[edges], "f8"), "band": MACHINE_EPSILON, "steps": steps}


def _json_float(value: Any) -> float | None:
    """A float for JSON; None for what is not finite."""
    return float(value) if math.isfinite(value) else None
