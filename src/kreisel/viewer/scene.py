"""The data of a page: frames, bodies, path, drifts, sections, events, as plain values and text.

The record and the phase space decide the body, the tip of the axis and the rotations of a trajectory:

| run                                          | shown                                                             |
|----------------------------------------------|-------------------------------------------------------------------|
| n = 3, a body, with its orientation          | the body in space, the trace of its axis                          |
| as above, a body that moves through space    | the body on its path, not to scale                                |
| as above, a satellite                        | the body with arrows; Earth, orbit, and angles against time       |
| n = 3, rest frame, without                   | the body along its axis; its rotation about the axis is unknown   |
| n = 3, moving frame, without                 | the carried vector as the body sees it                            |
| n = 3, position and momentum                 | the particle                                                      |
| n > 3, or other components                   | the vector in three coordinates, to be chosen                     |
"""

from __future__ import annotations

import base64
import itertools
import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies.orbit import EARTH
from kreisel.errors import InputError, counted, printable, shown
from kreisel.files import parsed
from kreisel.kernels.layout import MACHINE_EPSILON
from kreisel.method.scheme import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.record.perturbation import pairs_of
from kreisel.runs import geometry
from kreisel.runs.drift import all_series
from kreisel.runs.geometry import (
    Surroundings,
    attitude_of,
    continued,
    fixed_in,
    model_for,
    require_unchanged,
    surroundings,
)
from kreisel.runs.in_si import frame_in_si, in_state_form
from kreisel.runs.run_record import RunRecord, frame_of, lane_names
from kreisel.runs.settings import within
from kreisel.viewer import bodies
from kreisel.viewer.bodies import Body
from kreisel.viewer.frames import (
    clock_of,
    coordinates_of,
    evenly,
    extremes,
    frames,
    is_pointed,
    mixed,
    name_of_target,
    panels_of,
    shadows_of,
    stretches,
    windows,
)
from kreisel.viewer.style import THEMES

MOST_PLACED = 20_000  # rows of which the path is computed
ON_ITS_PATH = 0.16  # half the length of a body, to the largest distance
SPIN = "The run carries no orientation: give kr.simulate orientation=(1, 0, 0, 0) to see the body spin."
ARROWS = {"nadir": 2, "velocity": 0, "sun": 4, "field": 3, "target": 6}  # places of their colours
LEAST_GLOBE = 0.05  # the Sun from an asteroid is a hundredth of this
MOST_READ = 200_000  # rows of which the charts of the motion are computed


class Shown:
    """Tip, rotations, body and arrow of one trajectory, in the coordinates of the picture: the vertical points up.

    turn     unit quaternions (frame, 4) of the picture, or (1, 4) if the body is at rest; None without a body
    axis     the tip of an axis fixed in the body, if `tip` is its place; None if `tip` is another vector
    triad    a unit quaternion, the axes of the body that are drawn: of a top, the third along its axis
    arrows   directions (frame, 3) of a satellite, by name; place, its position in units of the largest distance
    up       the meaning of the vertical: "gravity", "momentum" or ""
    """

    def __init__(self, run: xr.Dataset, record: RunRecord, joined: bool, body: Any, axis: Any, target: Any):
        self.run, self.record, self.joined, self._asked = run, record, joined, body
        self.model = None if record.is_own else model_for(run, None)
        self.letter, self.kinds = record.carried, record.kinds
        self.word = record.body_frame.names.get(self.letter, self.letter).replace("_", " ")  # of a run in SI
        self.space = run.attrs.get("frame") == Frame.REST.value
        self.carried = np.asarray(run[self.letter].values, dtype=np.float64).reshape(run.sizes["time"], -1)
        self.axes = frame_of(run).axes  # everything here is along the user's axes of the body
        if not self.space and self.carried.shape[1] == 3:
            self.carried = self.carried @ self.axes.T
        self.subject = "the ellipsoid of inertia"
        self.turn = self.axis = self.nose = self.frame = self.triad = cast("Array | None", None)
        self.body: Body | None = None
        self.arrows: dict[str, Array] = {}
        self.around: Surroundings | None = None
        self.up, self.callout = "", ""
        self.legend: dict[str, str] = {}
        self.coordinates, self.names = [0, 1, 2], ["1", "2", "3"]
        pointed = is_pointed(run, axis, target)
        plain = self.carried.shape[1] == 3 and self.record.n == 3
        if plain and "skew" not in self.kinds.values():
            self.kind, self.tip, self.frame = "particle", self.carried, np.eye(3)
            length = np.linalg.norm(self.carried, axis=-1)
            place = "sphere" if np.ptp(length) <= 1e-6 * length.max() else "path"
            self.note, self.legend = f"The particle on its {place}.", {"tip": self.word}
        elif plain and ORIENTATION in self.run:
            x = self._path()
            if pointed:
                self._on_its_orbit(axis, target)
            else:
                self._in_space() if x is None else self._on_its_path(x)
        elif plain:
            self._along_the_axis() if self.space else self._from_the_body()
        else:
            self._projected()
        if body is not None and self.body is None:
            raise InputError(f"body, mesh: expected a run drawn with a body, got a {self.kind}. Leave them out.")
        self.radius = float(np.linalg.norm(self.tip, axis=-1).max(initial=0.0)) or 1.0

    def _fixed(self, where: str) -> Array | None:
        v = fixed_in(self.run, where)
        if v is None or not v.any():
            return None
        return v @ self.axes.T if where == "body" and len(v) == 3 else v

    def _inertia(self) -> Array | None:
        if self.model is None or self.space:
            return None
        tensor = bodies.gyration(self.model, self.carried[0] @ self.axes)
        return None if tensor is None else self.axes @ tensor @ self.axes.T

    def _drawn_body(self, usual: str, axis: Array, tensor: Array | None, size: float) -> Body:
        body, frame = self._asked, self.record.body_frame
        if body is None and usual != "top" and frame.shape:
            kind, *half = frame.shape
            body = bodies.of_shape(kind, np.array(half)) if half else kind if kind in bodies.SHAPES else None
            self.subject = f"the {kind}" if body is not None else self.subject
            size *= 0.7 if usual == "satellite" else 1.0  # without panels, and between arrows
        return body.scaled(size) if isinstance(body, Body) else bodies.SHAPES[body or usual](axis, tensor, size)

    def _marked(self, tensor: Array | None) -> tuple[Array, str]:
        """The axis of the body whose tip is drawn, and its name; the axis of its known shape, if that is drawn."""
        shape = self.record.body_frame.shape if self._asked is None else ()
        if tensor is None and not shape:  # of a user-defined system, as a perturbed body
            self.subject = "the body"
            return np.eye(3)[2], "third axis"
        return bodies.marked_axis(tensor, np.array(shape[1:]) if shape[1:] else None)

    def _path(self) -> Array | None:
        """The places of the body, if it moves through space and its rows follow each other closely enough."""
        from kreisel.analysis.angles import path

        moves = self.model is not None and self.model.system.translation is not None
        if not moves or self.run.sizes["time"] > MOST_PLACED or not self.joined:
            return None
        try:
            return np.asarray(path(self.run).values)
        except InputError:
            return None

    def _on_its_path(self, x: Array) -> None:
        self.tip = x - (x.max(0) + x.min(0)) / 2
        size = ON_ITS_PATH * (float(np.linalg.norm(self.tip, axis=-1).max()) or 1.0)
        tensor = self._inertia()
        axis, word = self._marked(tensor)
        self.body = self._drawn_body("ellipsoid", axis, tensor, size)
        self.kind, self.nose, self.frame = "path", 1.4 * size * axis, np.eye(3)
        self.turn = attitude_of(self.run)
        self.legend["tip"] = f"{word} of {self.subject}"
        self.note = "The body on its path against the fluid, not to scale; the third axis of space points up."

    def _on_its_orbit(self, axis: Any, target: Any) -> None:
        around, q = surroundings(self.run), attitude_of(self.run)
        axis = geometry.axis_of_pointing(self.run, axis)
        self.kind, self.frame, self.around, self.turn, self.axis = "satellite", np.eye(3), around, q, axis
        self.model = geometry.satellite_model(
            self.run
        )  # also of a satellite with a controller, whose own model has code
        self.body = self._drawn_body("satellite", axis, self._inertia(), 0.82)
        self.tip = algebra.rotation_matrix(q) @ axis
        self.arrows = geometry.directions(around)
        if not isinstance(target, str) or target not in self.arrows:
            self.arrows["target"] = geometry.target_of(around, target)
        aim = self.name_of(target) if isinstance(target, str) else "the target"
        self.legend["tip"] = f"axis of the body that is compared with {aim}"
        self.note = "The body, larger than it is, about its centre; space has its third axis up."

    def name_of(self, target: str) -> str:
        """A target of a satellite in words."""
        return name_of_target(cast("Model", self.model), target)

    def _in_space(self) -> None:
        q = attitude_of(self.run)
        g = algebra.rotation_matrix(q[0])
        self.kind = "body"
        if self.space:
            up, axis = self._fixed("space"), g.T @ self.carried[0]
        else:
            up, axis = g @ self.carried[0], self._fixed("body")
        inertia = self._inertia()
        size = float(np.linalg.norm(self.carried[0]) if self.space else 1.0) or 1.0
        if axis is None or not axis.any():
            axis, word = self._marked(inertia)
            axis = 0.98 * size * axis
            self.body = self._drawn_body("ellipsoid", axis, inertia, 0.9 * size)
            self.legend["tip"] = f"{word} of {self.subject}"
            ball = inertia is None and self._asked is None and not self.record.body_frame.shape
            subject = (
                "The body as a ball, since a run states no moments of it"
                if ball
                else f"T{self.subject[1:]} of the body"
            )
            self.note = f"{subject}, rotating about its centre, and the trace of its {word}."
        else:
            axis = size * axis / np.linalg.norm(axis)
            self.body = self._drawn_body("top", axis, inertia, 0.94 * size)
            self.legend["tip"] = self._axis_along() if self.space else "axis of the body, in space"
            self.note = "The body rotating about its point, and the trace of its axis."
            if self.space:
                self.triad = algebra.unit_quaternion(geometry.to_third_axis(axis / size).T)
        upright = self.space or self._fixed("body") is not None
        S = self._point_up(up, "gravity" if upright else "momentum", self.word)
        self.axis, self.tip = axis, algebra.rotation_matrix(q) @ axis @ S.T
        self.turn = algebra.quaternion_product(algebra.unit_quaternion(S), q)

    def _along_the_axis(self) -> None:
        size = float(np.linalg.norm(self.carried[0])) or 1.0
        S = self._point_up(self._fixed("space"), "gravity", self.word)
        self.kind, self.tip = "body", self.carried @ S.T
        self.legend["tip"] = self._axis_along()
        self.axis = np.array([0.0, 0.0, size])
        self.body = self._drawn_body("top", self.axis, None, 0.94 * size).plain()
        x, y, z = (self.tip / size).T  # the least rotation from (0, 0, 1): axis (-y, x, 0), w^2 = (1 + z)/2
        q = np.stack([1 + z, -y, x, 0 * z], -1)
        q[(1 + z) < 1e-12] = (0.0, 1.0, 0.0, 0.0)
        self.turn = q / np.linalg.norm(q, axis=-1, keepdims=True)
        self.note = "The body along its axis; its rotation about the axis is not shown."
        self.callout = SPIN

    def _axis_along(self) -> str:
        return f"axis, along {self.word}" if self.word == self.letter else f"{self.word} of the body"

    def _from_the_body(self) -> None:
        self.kind, self.tip = "seen", self.carried
        axis, size = self._fixed("body"), float(np.linalg.norm(self.carried[0])) or 1.0
        inertia = self._inertia()
        S = np.eye(3) if axis is None else geometry.to_third_axis(axis / np.linalg.norm(axis))
        usual, shown_axis = ("ellipsoid", self._marked(inertia)[0]) if axis is None else ("top", axis)
        self.body = self._drawn_body(usual, shown_axis, inertia, 0.8 * size)
        self.tip = self.carried @ S.T
        self.turn = algebra.unit_quaternion(S)[None]
        self.legend["tip"] = f"{self.word}, seen from the body"
        self.note = f"{self.word} as the body sees it; the body is at rest here."
        self.callout = SPIN

    def _projected(self) -> None:
        self.kind = "projection"
        self.tip, self.names = coordinates_of(np.asarray(self.run[self.letter].values, dtype=np.float64))
        up = self._fixed("space") if self.space else self._fixed("body")
        n = self.tip.shape[1]
        if n < 3:
            self.tip = np.concatenate([self.tip, np.zeros((len(self.tip), 3 - n))], 1)
            self.names = ["1", "2", "3"]
        elif up is not None and len(up) == n:
            third = int(np.abs(up).argmax())
            self.coordinates = [*[i for i in range(n) if i != third][:2], third]
        self.legend["tip"] = self.word
        self.note = f"{self.word} in three of its {n} coordinates, which can be chosen."

    def _point_up(self, up: Array | None, meaning: str, letter: str) -> Array:
        S = np.eye(3) if up is None or not up.any() else geometry.to_third_axis(up / np.linalg.norm(up))
        self.frame = S
        if up is not None and up.any():
            self.up = meaning
            self.legend["arrow"] = "gravity" if meaning == "gravity" else f"{letter} in space, at rest"
        return S


# -- the scene -------------------------------------------------------------------------------------


MOST_LANES = 9
MOST_PATH = 4_000  # points of the complete trace
MOST_STRETCHES = 1_200  # of a drift
MOST_SERIES = 24
MOST_POINTS = 5_000  # of a section
MOST_EVENTS = 500
LONGEST_TEXT = 300
STEADY = 2.0  # radians per second, the rotation of the fastest body at speed 1
TURNS = 3.0  # revolutions of the fastest body in the trail
SHORT = 32767  # the integer for 1
COLOURS = ("ink", "paper", "grid", "faint", "colours")  # of a theme


def scene(
    run: xr.Dataset,
    lane: Any = None,
    *,
    body: str | Body | None = None,
    section: xr.Dataset | None = None,
    axis: Any = None,
    target: Any = "nadir",
) -> dict[str, Any]:
    """The data of the page.  Raises `InputError` for anything but a run with its state and this lane."""
    record, measured, run = RunRecord.of(run, "system"), run, in_state_form(run)
    if "time" not in run.dims or run.sizes["time"] < 1:
        raise InputError("A run of kr.simulate or kr.open_run was expected, with at least one saved state.")
    if missing := record.missing_from(run):
        raise InputError(f"The run lacks {', '.join(missing)} of its state, which the page needs.")
    require_unchanged(run)
    chosen, lanes = _lanes(run, lane)
    model = None if record.is_own else model_for(chosen, None)
    shown_frames = frames(chosen, record, model if model is None or pairs_of(model) is None else None)
    every, joined = shown_frames.run, bool(shown_frames.joined.all())
    alone = [every.isel(lane=i) for i in range(len(lanes))] if "lane" in every.dims else [every]
    bodies = [Shown(trajectory, record, joined, body, axis, target) for trajectory in alone]
    first, radius = bodies[0], max(shown.radius for shown in bodies)
    if not all(np.isfinite(shown.tip).all() for shown in bodies):
        raise InputError(f"{record.carried} is not finite at every saved time; `kreisel check` reports where.")
    time = np.asarray(shown_frames.run["time"].values, dtype=np.float64)
    rate = shown_frames.rate if shown_frames.rate > 0 else 2 * math.pi / (float(time[-1] - time[0]) or 1.0)
    meshes, places = _meshes(bodies)
    clock = clock_of(chosen)
    return {
        "title": _text(run.attrs.get("title", "")),
        "facts": [_text(v) for v in _facts(run, record, lanes)],
        "kind": first.kind,
        "note": " ".join(filter(None, (first.note, shown_frames.note))),
        "callout": first.callout,
        "legend": {k: _text(v) for k, v in first.legend.items()},
        "coordinates": first.coordinates,
        "names": first.names,
        "letter": _text(record.carried),
        "radius": radius,
        "up": first.up,
        "spins": first.turn is not None and not first.callout,
        "frame": None if first.frame is None else first.frame.T.tolist(),
        "lowest": min(float(shown.tip[:, 2].min()) for shown in bodies) if first.tip.shape[1] == 3 else -radius,
        "meshes": meshes,
        "bodies": [_packed_body(shown, name, place) for shown, name, place in zip(bodies, lanes, places, strict=True)],
        "globe": _globe(first),
        "charts": _charts(chosen, axis, target),
        "clock": {"label": clock.label, "unit": clock.unit, "size": clock.size},
        "time": packed(time, "f8"),
        "windows": windows(shown_frames.joined),
        "pace": STEADY / rate,
        "trail": TURNS * 2 * math.pi / rate,
        "path": packed(mixed(np.concatenate([shown.tip for shown in bodies], 1), MOST_PATH // len(bodies)), "i4"),
        **_drift_series(_lanes(measured, lane)[0]),
        "events": _events(chosen, record),
        "section": None if section is None else _section(section, lanes),
        "complete": bool(run.attrs.get("complete", True)),
        "themes": {name: {k: getattr(theme, k) for k in COLOURS} for name, theme in THEMES.items()},
    }


def _lanes(run: xr.Dataset, lane: Any) -> tuple[xr.Dataset, list[str]]:
    """The shown lanes, with a dimension even for a single lane, and their names."""
    if "lane" not in run.dims:
        if lane is not None:
            within(lane, "lane", 0, 0)
        return run, [""]
    count, several = run.sizes["lane"], isinstance(lane, Sequence | np.ndarray) and not isinstance(lane, str)
    asked = evenly(count, MOST_LANES).tolist() if lane is None else lane if several else [lane]
    chosen = [within(number, "lane", 0, count - 1) for number in asked]
    if not 1 <= len(chosen) <= MOST_LANES or len(set(chosen)) < len(chosen):
        raise InputError(f"lane: expected one lane, or up to {MOST_LANES} different ones, got {shown(lane)}.")
    names = lane_names(run)
    return run.isel(lane=chosen if len(chosen) > 1 else chosen[0]), [names[i] for i in chosen]


def _meshes(bodies: list[Shown]) -> tuple[list[dict[str, Any]], list[int | None]]:
    """The different bodies, as base64, and the index of the body of each lane."""
    meshes: list[dict[str, Any]] = []
    places: list[int | None] = []
    for body in (drawn.body for drawn in bodies):
        mesh: dict[str, Any] | None = None
        if body is not None:
            wide = len(body.points) > 65_535
            mesh = {"points": packed(body.points, "f4"), "faces": packed(body.faces, "u4" if wide else "u2")}
            mesh |= {"wide": wide, "colour": packed(body.colour, "u1")}
            meshes += [mesh] if mesh not in meshes else []
        places.append(None if mesh is None else meshes.index(mesh))
    return meshes, places


def _packed_body(shown: Shown, name: str, mesh: int | None) -> dict[str, Any]:
    """Rotations as integers in units of 1/32767, far below a pixel; the tip only if no rotation gives it."""
    vectors = {"axis": shown.axis, "nose": shown.nose, "triad": shown.triad}
    arrows = {shown.name_of(k): (ARROWS[k], v) for k, v in shown.arrows.items()}  # one to the Sun, nadir or not
    return {
        "name": _text(name),
        "mesh": mesh,
        "turn": None if shown.turn is None else packed(np.round(SHORT * continued(shown.turn)), "i2"),
        "tip": None if shown.axis is not None else packed(shown.tip, "f4"),
        **{k: None if v is None else v.tolist() for k, v in vectors.items()},
        "arrows": [
            {"name": name, "colour": colour, "to": packed(np.round(SHORT * v), "i2")}
            for name, (colour, v) in arrows.items()
        ],
        "place": None if shown.around is None else packed(shown.around["position"] / _reach(shown.around), "f4"),
    }


def _reach(around: Surroundings) -> float:
    return float(np.linalg.norm(around["position"], axis=-1).max())


def _globe(first: Shown) -> dict[str, Any] | None:
    """The primary of a satellite: its radius in units of the largest distance, at least `LEAST_GLOBE`, and the Sun."""
    if first.around is None or first.model is None:
        return None
    params, sun = first.model.params, first.around.get("sun")
    return {
        "size": max(float(np.max(params["radius"])) / _reach(first.around), LEAST_GLOBE),
        "earth": bool(np.all(abs(params["mu"] / EARTH - 1) < 1e-2)),
        "sun": None if sun is None else packed(np.round(SHORT * sun), "i2"),
    }


def _charts(run: xr.Dataset, axis: Any, target: Any) -> dict[str, Any] | None:
    """Angles, rates and shadows of a satellite; for several lanes only the pointing error."""
    if not is_pointed(run):
        return None
    run = run.isel(time=evenly(run.sizes["time"], MOST_READ))
    panels = panels_of(run, axis, target)
    if "lane" in run.dims:
        panels = [panels[0]._replace(names=tuple(_lanes(run, None)[1]), values=panels[0].values[..., 0])]
    rows = extremes(np.concatenate([panel.values for panel in panels], -1), 2 * MOST_STRETCHES)
    return {
        "time": packed(np.asarray(run["time"].values, dtype=np.float64)[rows], "f8"),
        "shadows": shadows_of(run)[:MOST_EVENTS],
        "panels": [panel._asdict() | {"values": [packed(v, "f4") for v in panel.values[rows].T]} for panel in panels],
    }


def _events(run: xr.Dataset, record: RunRecord) -> list[list[Any]]:
    if run.attrs.get("events") is None or run.attrs.get("event_times") is None:
        return []
    names, times = (parsed(run.attrs[k], f"The attribute {k}") for k in ("events", "event_times"))
    return [[float(time), _text(names[int(number)])] for time, number in times[:MOST_EVENTS]]


def _section(section: xr.Dataset, lanes: list[str]) -> dict[str, Any]:
    """Points of `kr.analysis.section` in two of its quantities, for the shown lanes."""
    missing = [k for k in ("quantity", "value") if k not in getattr(section, "attrs", {})]
    if missing or "event" not in section.dims:
        raise InputError(f"section: expected what kr.analysis.section returns, got {shown(section)}.")
    if "lane" in section.coords:
        chosen = [int(name.split()[1]) for name in lanes if name]
        section = section.isel(event=np.isin(section["lane"].values, chosen))
    series: dict[str, Array] = {}
    for letter in section.drop_vars("rising", errors="ignore").data_vars:
        values = np.asarray(section[letter].values, dtype=np.float64).reshape(section.sizes["event"], -1)
        series |= {f"{letter}[{i}]": column for i, column in enumerate(values.T) if np.isfinite(column).all()}
    series.pop(str(section.attrs["quantity"]), None)
    names = list(series)[:MOST_SERIES]
    if len(names) < 2:
        raise InputError("section: expected at least two finite values at each point.")
    table = np.stack([series[name] for name in names], -1)[:MOST_POINTS]
    lane = section["lane"].values if "lane" in section.coords else np.zeros(section.sizes["event"], dtype=int)
    order = {name: i for i, name in enumerate(np.unique(lane).tolist())}
    return {
        "title": _text(f"section {section.attrs['quantity']} = {float(section.attrs['value']):g}"),
        "names": [_text(name) for name in names],
        "points": packed(table, "f4"),
        "time": packed(np.asarray(section["time"].values, dtype=np.float64)[:MOST_POINTS], "f8"),
        "lane": packed(np.array([order[name] for name in lane.tolist()][:MOST_POINTS]) % 256, "u1"),
    }


def _text(value: Any) -> str:
    text = printable(value)
    return text if len(text) <= LONGEST_TEXT else text[: LONGEST_TEXT - 1] + "\u2026"


def packed(values: Array, kind: str) -> str:
    """An array as little-endian base64.  Raises `InputError` if it leaves the range of that kind."""
    with np.errstate(over="ignore"):
        kept = np.ascontiguousarray(values, dtype=f"<{kind}")
    if kept.dtype.kind == "f" and (np.isinf(kept) & np.isfinite(values)).any():
        raise InputError("expected a run whose values a page can show, below 3e38, got larger ones. Use other units.")
    return base64.b64encode(kept.tobytes()).decode("ascii")


def _facts(run: xr.Dataset, record: RunRecord, lanes: list[str]) -> list[str]:
    method = [f"{record.method}, n = {record.n}, {record.pace}"] * record.stepped
    out = [str(run.attrs.get("equations", "")), *method, counted(run.sizes["time"], "saved state")]
    return [*out, *([f"{len(lanes)} of {run.sizes['lane']:,} lanes"] if len(lanes) > 1 else [n for n in lanes if n])]


def _drift_series(run: xr.Dataset) -> dict[str, Any]:
    """The largest change of each Casimir and integral in even stretches of time, relative to its scale.

    Of a run in SI the values are in SI, the times in the unit of the state, as everywhere else on the page.
    """
    edges = stretches(run.sizes["time"], MOST_STRETCHES)
    time = np.asarray(run["time"].values, dtype=np.float64) / frame_in_si(run).time_unit
    series = []
    units = {str(k): u for k, v in run.variables.items() if (u := v.attrs.get("units", "1")) != "1"}
    for quantity in itertools.islice(all_series(run), MOST_SERIES):
        change = quantity.values - quantity.values[0]
        high, low = np.maximum.reduceat(change, edges), np.minimum.reduceat(change, edges)
        scale = quantity.step_scale + quantity.value_scale or 1.0
        words = {
            "name": _text(quantity.name),
            "unit": _text(units.get(quantity.family, "")),
            "conserved": quantity.conserved,
        }
        sizes = {
            "start": quantity.values[0],
            "scale": scale if math.isfinite(scale) else 1.0,
            "most": abs(change).max(),
        }
        sizes = {k: float(v) if math.isfinite(v) else None for k, v in sizes.items()}
        series.append({**words, **sizes, "change": packed(np.where(high >= -low, high, low), "f4")})
    record = RunRecord.from_attrs(run.attrs)
    steps = float(time[-1] - time[0]) / record.dt if record.stepped else 0.0
    return {"series": series, "edges": packed(time[edges], "f8"), "band": MACHINE_EPSILON, "steps": steps}
