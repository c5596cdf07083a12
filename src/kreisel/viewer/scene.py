"""What a page shows of a run, as plain data: frames, path, body, drifts.  Decided by the record and the phase space.

| run                                          | shown                                                             |
|----------------------------------------------|-------------------------------------------------------------------|
| n = 3, a body, with its orientation          | the body in space, the trace of its axis                          |
| the same, of a body that moves through space | the body on its path, not to scale                                |
| n = 3, rest frame, without                   | the body along its axis; its own turn about the axis is not known |
| n = 3, moving frame, without                 | the carried vector as the body sees it                            |
| n = 3, position and momentum                 | the particle                                                      |
| n > 3, or other components                   | the vector in three coordinates, to be chosen                     |
"""

from __future__ import annotations

import base64
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, printable
from kreisel.kernels.layout import MACHINE_EPSILON
from kreisel.method.observing import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.runs.drift import all_series
from kreisel.runs.geometry import fixed_vector, model_for, orientation_of, to_third_axis
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import within
from kreisel.viewer import bodies
from kreisel.viewer.style import THEMES
from kreisel.viewer.thinning import mixed

if TYPE_CHECKING:
    import xarray as xr

MOST_FRAMES = 100_000
MOST_PATH = 4_000  # points of the whole trace
# While it moves: without a GPU 4000 dots took 0.6 of the time of a picture, and so did 2.9 times as long as 400
MOVING_PATH = 400
LARGEST_GAP = 0.3  # radii between points that are joined by a line
MOST_PLACED = 20_000  # rows of which the path is computed
ON_ITS_PATH = 0.16  # half the length of a body, to the largest distance
MOST_STRETCHES = 1_200  # of a drift
MOST_SERIES = 24
BLOCK = 1 << 18  # rows read at once
LONGEST_TEXT = 300


def scene(run: xr.Dataset, lane: int = 0) -> dict[str, Any]:
    """The data of the page.  Raises `InputError` for what is no run, lacks its state, or has no such lane."""
    record = RunRecord.of(run, "system")
    if "time" not in run.dims or run.sizes["time"] < 1:
        raise InputError("A run of kr.simulate or kr.open_run was expected, with at least one saved state.")
    if "lane" in run.dims:
        run = run.isel(lane=within(lane, "lane", 0, run.sizes["lane"] - 1))
    missing = record.missing_from(run)
    if missing:
        raise InputError(f"The run lacks {', '.join(missing)} of its state, which the page needs.")
    letter = record.carried
    rows = _frame_rows(run[letter], MOST_FRAMES)
    frames = run.isel(time=rows)
    if not all(np.isfinite(frames[each].values).all() for each in record.kinds):
        raise InputError("expected a run whose state is finite, got one with NaN or infinity.")
    shown = _Shown(frames, record, None if record.is_own else model_for(frames, None))
    tip = shown.tip
    if not (np.isfinite(tip).all() and np.isfinite(shown.carried).all()):
        raise InputError(f"{letter} is not finite at every saved time; `kreisel check` says where.")
    path, few = mixed(tip, MOST_PATH), mixed(tip, MOVING_PATH)
    time = np.asarray(frames["time"].values, dtype=np.float64)
    return {
        "title": _text(run.attrs.get("title", "")),
        "facts": [_text(v) for v in _facts(run, lane, len(rows))],
        "kind": shown.kind,
        "note": shown.note,
        "legend": {k: _text(v) for k, v in shown.legend.items()},
        "n": int(tip.shape[1]),
        "coordinates": shown.coordinates,
        "letter": _text(letter),
        "radius": shown.radius,
        "arrow": None if shown.arrow is None else [float(v) for v in shown.arrow],
        "body": shown.body,
        "nose": None if shown.nose is None else [float(v) for v in shown.nose],
        "time": packed(time, "f8"),
        "tip": packed(tip, "f4"),
        "turn": None if shown.turn is None else packed(shown.turn, "f4"),
        "path": packed(path, "i4"),
        "few": packed(few, "i4"),
        "joined": _closely_spaced(tip, shown.radius),
        "path_joined": _closely_spaced(tip[path], shown.radius),
        "few_joined": _closely_spaced(tip[few], shown.radius),
        **_drift_series(run),
        "complete": bool(run.attrs.get("complete", True)),
        "themes": {
            name: {"ink": t.ink, "paper": t.paper, "grid": t.grid, "faint": t.faint, "colours": t.colours}
            for name, t in THEMES.items()
        },
    }


def _closely_spaced(points: Array, radius: float) -> bool:
    """Whether the points follow each other so closely that a line between them is no guess."""
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    return len(gaps) == 0 or float(np.median(gaps)) < LARGEST_GAP * radius


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


def _frame_rows(variable: xr.DataArray, most: int) -> Array:
    """Rows shown as frames: all, or some of each block, the extremes among them."""
    count = variable.sizes["time"]
    if count <= most:
        return np.arange(count)
    share = max(8, most * BLOCK // count)
    kept = [
        mixed(np.asarray(variable[start : start + BLOCK].values).reshape(-1, math.prod(variable.shape[1:])), share)
        + start
        for start in range(0, count, BLOCK)
    ]
    return np.unique(np.concatenate(kept))


def _facts(run: xr.Dataset, lane: int, frames: int) -> list[str]:
    record, rows = RunRecord.from_attrs(run.attrs), run.sizes["time"]
    out = [str(run.attrs.get("equations", ""))]
    if record.stepped:
        out.append(f"{record.method}, n = {record.n}, {record.steps:,} steps of {record.dt:g}")
    out.append(f"{rows:,} saved states" + (f", {frames:,} shown, the extremes among them" if frames < rows else ""))
    return [*out, *([f"lane {lane}"] if "lane" in run.coords else [])]


class _Shown:
    """Tip, turns, body and arrow of one trajectory, in the coordinates of the picture: the vertical points up."""

    def __init__(self, run: xr.Dataset, record: RunRecord, model: Model | None):
        self.run, self.record, self.model = run, record, model
        self.letter, self.kinds = record.carried, record.kinds
        self.space = run.attrs.get("frame") == Frame.REST.value
        self.carried = np.asarray(run[self.letter].values, dtype=np.float64).reshape(run.sizes["time"], -1)
        self.turn: Array | None = None
        self.arrow: Array | None = None
        self.body: dict[str, Any] | None = None
        self.nose: Array | None = None
        self.legend: dict[str, str] = {}
        self.coordinates = [0, 1, 2]
        self._choose()
        self.radius = float(np.linalg.norm(self.tip, axis=-1).max(initial=0.0)) or 1.0

    def _choose(self) -> None:
        plain = self.carried.shape[1] == 3 and self.record.n == 3
        if plain and "skew" not in self.kinds.values():
            self._particle()
        elif plain and ORIENTATION in self.run:
            x = self._path()
            self._in_space() if x is None else self._on_its_path(x)
        elif plain and self.space:
            self._along_the_axis()
        elif plain:
            self._from_the_body()
        else:
            self._projected()

    def _fixed(self, where: str) -> Array | None:
        """A parameter fixed in space or body, unless it is 0."""
        v = None if self.model is None else fixed_vector(self.model, where)
        return v if v is not None and v.any() else None

    def _upright(self, S: Array, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            setattr(self, name, None if value is None else value @ S.T)

    def _particle(self) -> None:
        self.kind, self.tip = "particle", self.carried
        self.note = "The particle on its sphere."
        self.legend = {"tip": self.letter}

    def _path(self) -> Array | None:
        """Where the body is, if it moves through space and its rows follow each other closely enough."""
        from kreisel.analysis.moving import path

        known = self.model is not None and self.model.system.translation is not None
        if not known or self.run.sizes["time"] > MOST_PLACED:
            return None
        try:
            return np.asarray(path(self.run).values)
        except InputError:
            return None

    def _on_its_path(self, x: Array) -> None:
        assert self.model is not None
        q = orientation_of(self.run)
        free = self.model.system.perturbation is None
        up = algebra.rotation_matrix(q[0]) @ self.carried[0]  # the momentum
        S = to_third_axis(up / np.linalg.norm(up)) if free and up.any() else np.eye(3)
        x = x @ S.T
        self.tip = x - (x.max(0) + x.min(0)) / 2
        size = ON_ITS_PATH * (float(np.linalg.norm(self.tip, axis=-1).max()) or 1.0)
        self.body, axis = bodies.ellipsoid(bodies.gyration(self.model, self.carried[0]), size)
        self.kind, self.nose, self.turn = (
            "path",
            1.4 * size * axis,
            algebra.quaternion_product(algebra.unit_quaternion(S), q),
        )
        self.legend["tip"] = "long axis of the ellipsoid of inertia"
        self.note = "The body on its path, larger or smaller than it is; "
        self.note += "its momentum points up." if free else "against the fluid, with the third axis of space up."

    def _in_space(self) -> None:
        q = orientation_of(self.run)
        g = algebra.rotation_matrix(q)
        self.kind = "body"
        if self.space:
            up, axis = self._fixed("space"), g[0].T @ self.carried[0]
        else:
            up, axis = g[0] @ self.carried[0], self._fixed("body")
        inertia = None if self.model is None or self.space else bodies.gyration(self.model, self.carried[0])
        size = float(np.linalg.norm(self.carried[0]) if self.space else 1.0) or 1.0
        if axis is None or not axis.any():
            self.body, axis = bodies.ellipsoid(inertia, 0.9 * size)
            self.legend["tip"] = "long axis of the ellipsoid of inertia"
            self.note = "The body's ellipsoid of inertia, turning about its point, and the trace of its long axis."
        else:
            axis = size * axis / np.linalg.norm(axis)
            self.body = bodies.top(axis, inertia, 0.94 * size)
            self.legend["tip"] = f"axis, along {self.letter}" if self.space else "axis of the body, in space"
            self.note = "The body turning about its point, and the trace of its axis."
        self.tip = g @ axis
        S = self._point_up(up, size, "p" if self.space else f"{self.letter} in space, at rest")
        self.tip = self.tip @ S.T
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_matrix(S) * Rotation.from_quat(q, scalar_first=True)
        self.turn = turned.as_quat(scalar_first=True)

    def _along_the_axis(self) -> None:
        size = float(np.linalg.norm(self.carried[0])) or 1.0
        S = self._point_up(self._fixed("space"), size, "p")
        self.kind, self.tip = "body", self.carried @ S.T
        self.legend["tip"] = f"axis, along {self.letter}"
        self.body = bodies.top(np.array([0.0, 0.0, 1.0]), None, 0.94 * size)
        x, y, z = (self.tip / size).T  # the least turn from (0, 0, 1): axis (-y, x, 0), w^2 = (1 + z)/2
        q = np.stack([1 + z, -y, x, 0 * z], -1)
        q[(1 + z) < 1e-12] = (0.0, 1.0, 0.0, 0.0)
        self.turn = q / np.linalg.norm(q, axis=-1, keepdims=True)
        self.note = (
            "The body along its axis. The run carries no orientation, so that its turn about the axis is not shown."
        )

    def _from_the_body(self) -> None:
        self.kind, self.tip = "body", self.carried
        axis, size = self._fixed("body"), float(np.linalg.norm(self.carried[0])) or 1.0
        inertia = None if self.model is None else bodies.gyration(self.model, self.carried[0])
        if axis is None:
            self.body, S = bodies.ellipsoid(inertia, 0.8 * size)[0], np.eye(3)
        else:
            S = to_third_axis(axis / np.linalg.norm(axis))
            self.body = bodies.top(axis, inertia, 0.8 * size)
        self.tip = self.carried @ S.T
        from scipy.spatial.transform import Rotation

        still = Rotation.from_matrix(S).as_quat(scalar_first=True)
        self.turn = np.broadcast_to(still, (1, 4))
        self.legend["tip"] = f"{self.letter}, seen from the body"
        self.note = (
            f"{self.letter} as the body sees it. The run carries no orientation, so that the body stands still here."
        )

    def _projected(self) -> None:
        self.kind, self.tip = "projection", self.carried
        up = self._fixed("space") if self.space else self._fixed("body")
        n = self.tip.shape[1]
        if n < 3:
            self.tip = np.concatenate([self.tip, np.zeros((len(self.tip), 3 - n))], 1)
        elif up is not None and len(up) == n:
            third = int(np.abs(up).argmax())
            self.coordinates = [*[i for i in range(n) if i != third][:2], third]
        self.legend["tip"] = self.letter
        self.note = f"{self.letter} in three of its {n} coordinates, which can be chosen."

    def _point_up(self, up: Array | None, size: float, meaning: str) -> Array:
        if up is None:
            return np.eye(3)
        self.arrow = np.array([0.0, 0.0, 1.25 * size])
        self.legend["arrow"] = meaning
        return to_third_axis(up / np.linalg.norm(up))


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
