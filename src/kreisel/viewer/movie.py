"""A film of the picture of a page, drawn by matplotlib: GIF by Pillow, MP4 by ffmpeg if available."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib import animation
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure

from kreisel.algebra import Array
from kreisel.errors import InputError, explained
from kreisel.files import place, written
from kreisel.runs.settings import positive_number, within
from kreisel.viewer.bodies import DARK, METAL, PANEL
from kreisel.viewer.frames import as_matrices, between
from kreisel.viewer.style import Theme, theme_of

SUFFIXES = (".gif", ".mp4")
MOST_PICTURES = 2_000
PIXELS, DPI = (640, 560), 100
AZIMUTH, ELEVATION = np.radians(-49), np.radians(22)
LIGHT = np.array([0.35, -0.55, 0.76])
MARK = b"Film by Kreisel"
TRAIL = 240  # points
METALS = {METAL: "#9aa3ad", PANEL: "#1e3a8a", DARK: "#3a3f47"}


@explained
def movie(
    data: dict[str, Any],
    path: str | os.PathLike[str],
    *,
    seconds: float = 8.0,
    fps: int = 20,
    speed: float = 1.0,
    theme: str = "light",
) -> Path:
    """The first stretch of a scene that can be played, as a film.  Raises `InputError`."""
    target = place(path, f"The film needs a name that ends in {' or '.join(SUFFIXES)}")
    duration, rate = positive_number(seconds, "seconds"), within(fps, "fps", 1, 60)
    tempo, colours = positive_number(speed, "speed"), theme_of(theme)
    if target.suffix.lower() not in SUFFIXES:
        raise InputError(f"The film needs a name that ends in {' or '.join(SUFFIXES)}, got {target.name!r}.")
    if target.suffix.lower() == ".mp4" and not animation.writers.is_available("ffmpeg"):
        raise InputError("An .mp4 needs ffmpeg, which was not found. Install it, or give a name that ends in .gif.")
    if not data["windows"]:
        raise InputError("The saved states are too far apart for a film. Save more of them: a smaller every.")
    if duration * rate > MOST_PICTURES:
        raise InputError(f"seconds: expected at most {MOST_PICTURES / rate:g} for fps = {rate}, got {duration:g}.")
    pictures = max(2, round(duration * rate))
    film = _Film(data, colours)
    times = film.begin + np.arange(pictures) * data["pace"] * tempo / rate
    times = times[times <= film.end]
    writer: Any = _Gif(fps=rate) if target.suffix.lower() == ".gif" else animation.FFMpegWriter(rate)
    with mpl.rc_context(cast("Any", colours.rc)), written(target) as scratch:
        figure = Figure(figsize=(PIXELS[0] / DPI, PIXELS[1] / DPI), dpi=DPI)
        FigureCanvasAgg(figure)
        with writer.saving(figure, str(scratch), DPI):
            for time in times.tolist():
                film.draw(figure, time)
                writer.grab_frame()
        _mark(scratch)
    return target


class _Gif(animation.PillowWriter):
    @contextmanager
    def saving(self, *args: Any, **named: Any) -> Iterator[Any]:
        """A film that is complete, without `finish` after Ctrl-C or SIGTERM, which would encode it for minutes."""
        self.setup(*args, **named)
        yield self
        self.finish()


def _mark(film: Path) -> None:
    """A mark of Kreisel's films (`FILE_MARKS`): a comment before the trailer of a GIF, a free box at the end of an MP4.

    [ISO/IEC 14496-12, section 8.1.2]
    """
    gif = film.suffix.lower() == ".gif"
    with film.open("r+b") as file:
        file.seek(-1 if gif else 0, os.SEEK_END)
        box = (len(MARK) + 8).to_bytes(4, "big") + b"free" + MARK
        file.write(b"\x21\xfe" + bytes([len(MARK)]) + MARK + b"\0;" if gif else box)


class _Film:
    def __init__(self, data: dict[str, Any], theme: Theme):
        self.data, self.theme, self.radius = data, theme, data["radius"]
        self.time = _numbers(data["time"], "f8")
        first, last = max(data["windows"], key=lambda pair: pair[1] - pair[0])
        self.begin, self.end = float(self.time[first]), float(self.time[last])
        self.joined = np.zeros(len(self.time) - 1, dtype=bool)
        for a, b in data["windows"]:
            self.joined[a:b] = True
        c, s = np.cos(AZIMUTH), np.sin(AZIMUTH)
        up, out = np.sin(ELEVATION), np.cos(ELEVATION)
        self.camera = np.array([[-s, c, 0], [-up * c, -up * s, out], [out * c, out * s, up]])
        self.bodies = [self._body(record) for record in data["bodies"][:1]]

    def _body(self, record: dict[str, Any]) -> dict[str, Any]:
        n = len(self.data["names"])
        body: dict[str, Any] = {"axis": record["axis"], "nose": record["nose"]}
        body["turn"] = None if record["turn"] is None else _numbers(record["turn"], "i2").reshape(-1, 4).astype(float)
        body["tip"] = None if record["tip"] is None else _numbers(record["tip"], "f4").reshape(-1, n).astype(float)
        body["arrows"] = [{**arrow, "to": _numbers(arrow["to"], "i2").reshape(-1, 3)} for arrow in record["arrows"]]
        if record["mesh"] is not None:
            mesh = self.data["meshes"][record["mesh"]]
            faces = _numbers(mesh["faces"], "u4" if mesh["wide"] else "u2").reshape(-1, 3).astype(int)
            body["corners"] = _numbers(mesh["points"], "f4").reshape(-1, 3)[faces].astype(float)
            palette = [self.theme.colours[0], "#f3efe6", *METALS.values(), self.theme.colours[1]]
            body["colour"] = np.array([to_rgb(name) for name in palette])[_numbers(mesh["colour"], "u1")]
        return body

    def _turns(self, body: dict[str, Any], times: Array) -> Array:
        still, places = len(body["turn"]) == 1, self._places(times)
        q = body["turn"].repeat(len(times), 0) if still else between(body["turn"], places, self.joined)
        return as_matrices(q)

    def _places(self, times: Array) -> Array:
        i = np.clip(np.searchsorted(self.time, times, "right") - 1, 0, len(self.time) - 2)
        return i + np.clip((times - self.time[i]) / (self.time[i + 1] - self.time[i]), 0, 1)

    def draw(self, figure: Any, time: float) -> None:
        figure.clear()
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        wide = 1.5 * self.radius
        axes.set(xlim=(-wide, wide), ylim=(-wide * PIXELS[1] / PIXELS[0], wide * PIXELS[1] / PIXELS[0]))
        self._still(axes)
        for body in self.bodies:
            times = np.linspace(max(self.begin, time - self.data["trail"]), time, TRAIL)
            if body["axis"] is not None:
                tips = self._turns(body, times) @ np.array(body["axis"])
            else:
                tips = between(body["tip"], self._places(times), self.joined)[:, self.data["coordinates"]]
            flat = tips @ self.camera.T
            pieces, front = np.stack([flat[:-1, :2], flat[1:, :2]], 1), flat[1:, 2] > 0
            colours = np.tile(to_rgba(self.theme.colours[0]), (len(pieces), 1))
            colours[:, 3] = np.linspace(0.02, 1, len(pieces)) ** 1.4
            for side, order in ((~front, 1), (front, 5)):
                lines = LineCollection(cast("Any", pieces[side]), colors=colours[side], linewidths=2.2, zorder=order)
                axes.add_collection(lines)
            if "corners" in body:
                self._solid(axes, body, self._turns(body, times[-1:])[0], tips[-1])
            end = tips[-1]
            if body["nose"] is not None:
                end = end + self._turns(body, times[-1:])[0] @ np.array(body["nose"])
            for arrow in body["arrows"]:
                way = between(arrow["to"].astype(float), self._places(times[-1:]), self.joined)[0]
                tip = self.camera @ (1.12 * self.radius / np.linalg.norm(way) * way)
                colour, order = self.theme.colour(arrow["colour"]), 6 if tip[2] > 0 else 2
                style = {"arrowstyle": "-|>", "color": colour, "linewidth": 2}
                axes.annotate("", tip[:2], (0, 0), arrowprops=style, zorder=order)
                axes.text(*(1.1 * tip[:2]), arrow["name"], color=colour, ha="center", va="center", zorder=order)
            x, y, depth = self.camera @ end
            axes.plot([x], [y], "o", color=self.theme.colours[1], markersize=6, zorder=6 if depth > 0 else 2)
        clock = self.data["clock"]
        text = f"{self.data['title']}\ntime {time / clock['size']:.4g} {clock['unit']}".rstrip()
        axes.text(-0.95 * wide, 0.78 * wide, text, va="top", parse_math=False)

    def _still(self, axes: Any) -> None:
        r, angle = self.radius, np.linspace(0, 2 * np.pi, 97)
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle])
        low = -1.16 * r
        for size in () if self.data["kind"] == "satellite" else (0.4, 0.8, 1.2):
            x, y, _ = self.camera @ (size * r * ring + np.array([[0], [0], [low]]))
            axes.plot(x, y, color=self.theme.grid, linewidth=0.9, zorder=0)
        if self.data["kind"] != "path":
            for turned in (ring, ring[[0, 2, 1]], ring[[2, 0, 1]]):
                x, y, _ = self.camera @ (r * turned)
                axes.plot(x, y, color=self.theme.faint, linewidth=0.5, alpha=0.6, zorder=0)
        if self.data["up"] == "gravity":
            x, y, _ = self.camera @ np.array([[-0.98 * r] * 2, [-0.42 * r] * 2, [low + 0.75 * r, low + 0.25 * r]])
            arrow = {"arrowstyle": "-|>", "color": self.theme.colours[2], "linewidth": 2}
            axes.annotate("", (x[1], y[1]), (x[0], y[0]), arrowprops=arrow)
            axes.text(x[0], y[0] + 0.03 * r, "gravity", color=self.theme.colours[2], ha="center")

    def _solid(self, axes: Any, body: dict[str, Any], g: Array, tip: Array) -> None:
        corners = body["corners"] @ g.T + (tip if self.data["kind"] == "path" else 0)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
        seen = corners @ self.camera.T
        facing = normal @ self.camera[2]
        outward = np.where(facing[:, None] < 0, -normal, normal)
        shade = 0.42 + 0.58 * np.clip(outward @ LIGHT, 0, 1)
        gloss = 0.35 * np.clip(outward @ (LIGHT + self.camera[2]) / np.linalg.norm(LIGHT + self.camera[2]), 0, 1) ** 30
        colours = np.clip(body["colour"] * shade[:, None] + gloss[:, None], 0, 1)
        volume = np.linalg.det(corners).sum()  # < 0: triangles are clockwise seen from outside
        order = np.lexsort((seen[:, :, 2].mean(1), facing * volume > 0))  # the hidden sides of a solid come first
        style = {"facecolors": colours[order], "edgecolors": colours[order], "linewidths": 0.4, "zorder": 3}
        axes.add_collection(PolyCollection(cast("Any", seen[order, :, :2]), **cast("Any", style)))


def _numbers(text: str, kind: str) -> Array:
    return np.frombuffer(base64.b64decode(text), dtype=f"<{kind}")
