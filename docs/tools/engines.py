"""Tables and picture of the page on engines, from benchmarks: results/engines.json and engines/engines.toml."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
CASES = ("tumbling-brick", "boxes", "thin-body", "small-box", "wing-nut", "heavy-top")
SHOWN = (
    "mujoco newton pybullet dart drake exudyn basilisk opensim genesis physx ode rapier jolt havok cannon-es".split()
)
FACES = ("#0072B2", "#E69F00", "#009E73")  # of Okabe and Ito
SIDES = np.array([8.0, 4.0, 2.25]) / 8  # of the brick
VIEW = np.array([1.0, -1.3, 0.8])
FORWARD = VIEW / np.linalg.norm(VIEW)
RIGHT = np.cross([0, 0, 1], FORWARD) / np.linalg.norm(np.cross([0, 0, 1], FORWARD))
PLANE = np.stack([RIGHT, np.cross(FORWARD, RIGHT)])


def read() -> tuple[dict[str, Any], dict[str, Any]]:
    """The catalogue of engines and the result."""
    catalogue = tomllib.loads((BENCHMARKS / "engines" / "engines.toml").read_text(encoding="utf-8"))
    return catalogue, json.loads((BENCHMARKS / "results" / "engines.json").read_text(encoding="utf-8"))


def table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def number(value: float | None) -> str:
    """Two digits; 0.012, 3.4e-9; nothing measured is a dash."""
    if value is None:
        return "-"
    return f"{value:.2g}" if value == 0 or 1e-3 <= abs(value) < 1e4 else f"{value:.1e}".replace("e-0", "e-")


def step(dt: float) -> str:
    """A step, s: 1/60, 0.002."""
    return f"1/{round(1 / dt)}" if abs(1 / dt % 60) < 1e-6 else f"{dt:.4g}"


def error(row: dict[str, Any] | None) -> str:
    """The error of attitude, or why there is none."""
    if row is None:
        return "-"
    if "attitude_error" in row:
        return number(row["attitude_error"])
    if "diverged_s" in row:
        return f"lost at {row['diverged_s']:.2g} s"
    return "too long" if "not done" in row["failed"] else "stops"


def runs(record: dict[str, Any], setting: str, case: str) -> list[dict[str, Any]]:
    """The runs of a setting and a case, the longest step first."""
    found = [row for row in record.get("rows", ()) if row["setting"] == setting and row["case"] == case]
    return sorted(found, key=lambda row: -row["dt"])


def settings(
    catalogue: dict[str, Any], result: dict[str, Any]
) -> list[tuple[dict[str, Any], dict[str, Any], dict[str, Any]]]:
    """(engine, setting, its record in the result) of all that ran."""
    return [
        (engine, setting, result["engines"][name])
        for name, engine in catalogue.items()
        if "rows" in result["engines"].get(name, {})
        for setting in engine["settings"]
    ]


def overview(catalogue: dict[str, Any], result: dict[str, Any]) -> str:
    """Errors of attitude of all cases, with the step of the engine's users and with a tenth of it."""
    rows = []
    for engine, setting, record in settings(catalogue, result):
        cells = []
        for case in CASES:
            found = runs(record, setting["name"], case)
            ends = dict.fromkeys(error(row) for row in (found[:1] + found[-1:] if found else [None]))
            cells.append(" / ".join(ends))
        label = f"**{setting['label']}**" if setting.get("best") else setting["label"]
        order = record["orders"].get(setting["name"])
        rows.append([engine["title"], label, "-" if order is None else f"{order:.1f}", *cells])
    return table(["engine", "setting", "order", *CASES], rows)


def of_case(case: str, catalogue: dict[str, Any], result: dict[str, Any]) -> str:
    """All runs of a case."""
    rows = []
    for engine, setting, record in settings(catalogue, result):
        adaptive = "step" not in engine and "step" not in setting
        for row in runs(record, setting["name"], case):
            keys = ("rates_error", "energy_change", "momentum_change")
            measured = [number(row.get(key)) for key in keys] + [number(row.get("seconds"))]
            dt = "its own" if adaptive else step(row["dt"])
            rows.append([engine["title"], setting["label"], dt, error(row), *measured])
    head = ["engine", "setting", "step, s", "attitude, rad", "rates", "energy", "momentum", "time, s"]
    return table(head, rows)


def catalogued(catalogue: dict[str, Any], result: dict[str, Any]) -> str:
    """The engines, in the words of their packages."""
    rows = []
    for name, engine in catalogue.items():
        record = result["engines"].get(name, {})
        if "rows" not in record:
            continue
        words = (record.get("summary") or "").strip("[]' ").rstrip(".") or "-"
        precision = "single" if engine.get("single") else "double"
        where = "" if engine["index"] == "here" else f", {engine['index']}"
        chosen = engine.get("step_source", "it chooses its steps" if "step" not in engine else "")
        package = f"`{engine['package']}` {record['version']}{where}"
        rows.append([engine["title"], package, record["date"], words, precision, chosen])
    return table(["engine", "package", "run on", "in its own words", "precision", "step of its users"], rows)


def missing(catalogue: dict[str, Any], result: dict[str, Any]) -> str:
    """The engines that were not installed."""
    rows = [
        [
            catalogue[name]["title"],
            f"`{' '.join(record['tried'])}`",
            record["date"],
            record["not_installed"].removeprefix("ERROR: "),
        ]
        for name, record in result["engines"].items()
        if "not_installed" in record and name in catalogue
    ]
    return table(["engine", "tried", "on", "reason"], rows) if rows else ""


def turned(q: Any, v: Any) -> Any:
    """v (..., 3) along the axes of space, from those of a body of attitude q (4,)."""
    w, axis = q[0], np.asarray(q[1:])
    once = 2 * np.cross(axis, v)
    return v + w * once + np.cross(axis, once)


def faces(q: Any, sides: Any = SIDES) -> list[tuple[Any, str, float]]:
    """The faces of a brick that are seen: corners in the picture (4, 2), colour, depth."""
    found, axes = [], turned(q, np.eye(3))
    for axis in range(3):
        for side in (1, -1):
            normal = side * np.eye(3)[axis]
            if normal @ axes @ FORWARD <= 0:
                continue
            u, v = np.roll(np.eye(3), -axis, 0)[1:]
            corners = np.array([normal + a * u + b * v for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]) * sides / 2
            found.append((corners @ axes @ PLANE.T, FACES[axis], side))
    return found


def picture(catalogue: dict[str, Any], result: dict[str, Any], file: Path) -> None:
    """The brick after 30 s, as it is and as each engine's first setting has it, with the step of its users."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Polygon

    import kreisel as kr

    true = kr.checkcases.case("tumbling-brick").reference([0.0, 30.0]).attitude.values[-1]
    bodies: list[tuple[str, str, Any]] = [("the true motion", "", true)]
    for name in SHOWN:
        record = result["engines"].get(name, {})
        row = next(iter(runs(record, catalogue[name]["settings"][0]["name"], "tumbling-brick")), {})
        if "end" in row:
            degrees = math.degrees(row["attitude_error"])
            off = f"{degrees:.0f}°" if degrees >= 9.5 else f"{degrees:.1g}°".replace("e-0", "e-")
            title = (
                catalogue[name]["title"].replace(" (", "\n(")
                if len(catalogue[name]["title"]) > 16
                else catalogue[name]["title"]
            )
            bodies.append((title, f"off by {off}", row["end"]))
    figure, axes = plt.subplots(4, 4, figsize=(9, 9.6))
    for panel in axes.flat:
        panel.set_axis_off()
    for panel, (title, off, q) in zip(axes.flat, bodies, strict=False):
        for corners, colour, side in faces(q):
            panel.add_patch(
                Polygon(corners, facecolor=colour, edgecolor="black", alpha=1.0 if side > 0 else 0.55, lw=0.8)
            )
        for corners, _, _ in faces(true) if off else ():
            panel.add_patch(Polygon(corners, fill=False, edgecolor="black", lw=0.9, ls=(0, (3, 2))))
        panel.set_title(title, fontsize=10, y=0.97, weight="normal" if off else "bold")
        panel.text(0.5, 0.02, off, transform=panel.transAxes, ha="center", fontsize=9)
        panel.set_aspect("equal")
        panel.set_xlim(-0.66, 0.66), panel.set_ylim(-0.66, 0.66)
    figure.tight_layout(h_pad=1.0, w_pad=0.2)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def after_an_hour(file: Path) -> None:
    """The momentum of the wing nut along its middle axis in the last minute of an hour, in engines and exactly."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    import kreisel as kr

    records = json.loads((BENCHMARKS / "results" / "hour.json").read_text(encoding="utf-8"))
    case = kr.checkcases.case("wing-nut").given()
    body = kr.physical.FreeBody(case["inertia"])
    times = np.linspace(3540.0, 3600.0, 1201)
    M = kr.at(body.model(), body.state(case["angular_velocity"]), body.dt(1.0) * times).M.values
    figure, axes = plt.subplots(len(records), 1, figsize=(9, 1.15 * len(records)), sharex=True)
    for panel, record in zip(axes, records.values(), strict=True):
        panel.plot(times, M[:, 1] / np.linalg.norm(M, axis=1), color="black", lw=1.0, ls=(0, (3, 2)))
        rows = np.array(record["middle"], float)
        panel.plot(3600.0 - 0.1 * np.arange(len(rows))[::-1], rows, color="#c0392b", lw=1.6)
        drift = [change(record[name][-1]) for name in ("energy", "momentum")]
        label = f"{record['title']}, {record['setting']}: energy {drift[0]}, momentum {drift[1]}"
        panel.set_title(label, fontsize=9, loc="left", pad=3)
        panel.set_ylim(-1.15, 1.15), panel.set_yticks([-1, 0, 1]), panel.tick_params(labelsize=8)
        panel.set_xlim(3540, 3600)
    axes[-1].set_xlabel("time, s", fontsize=9)
    figure.tight_layout(h_pad=0.3)
    figure.savefig(file, dpi=110)
    plt.close(figure)


PANEL, COLUMNS, LARGER, RATE = (
    (164, 158),
    4,
    2,
    20,
)  # pixels; panels in a row; drawn larger, then reduced; pictures a second
NUT = np.array([1.87, 1.22, 0.71]) * 0.48  # sides of a box with the moments of the wing nut
UPRIGHT = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)  # the axis of rotation at the start is vertical in the picture


def after_an_hour_moving(file: Path) -> None:
    """The last seconds of the hour: the wing nut exactly, by the file and in five engines, as a WebP that repeats."""
    from PIL import Image, ImageColor, ImageDraw

    panels = moving()
    size = PANEL[0] * COLUMNS, PANEL[1] * -(-(len(panels) + 1) // COLUMNS)
    still = Image.new("RGB", (size[0] * LARGER, size[1] * LARGER), "white")
    corners = [np.array([k % COLUMNS * PANEL[0], k // COLUMNS * PANEL[1]]) * LARGER for k in range(len(panels) + 1)]
    write, pictures = labels(ImageDraw.Draw(still)), []
    for corner, (title, note, _) in zip(corners, panels, strict=False):
        write(corner, (PANEL[0] / 2, 11), title, "mm", "-Bold")
        write(corner, (PANEL[0] / 2, PANEL[1] - 10), note, "mm")
    shades = {1: 1.0, -1: 0.55}
    for row in range(len(panels[0][2])):
        picture = still.copy()
        draw = ImageDraw.Draw(picture)
        for corner, (_, _, attitudes) in zip(corners, panels, strict=False):
            for points, colour, side in faces(product(UPRIGHT, attitudes[row]), NUT):
                mixed = 255 + (np.array(ImageColor.getrgb(colour)) - 255) * shades[int(side)]
                places = corner + (np.array(PANEL) / 2 + points * (104, -104)) * LARGER
                draw.polygon([*map(tuple, places)], tuple(mixed.astype(int)), "black", LARGER)
        time = 3600 - (len(panels[0][2]) - 1 - row) / RATE
        labels(draw)(corners[-1], (14, 70), f"{time // 60:.0f} min {time % 60:04.1f} s", "la")
        pictures.append(picture.reduce(LARGER))
    timing = {"duration": round(1000 / RATE), "loop": 0}
    pictures[0].save(file, save_all=True, append_images=pictures[1:], quality=30, method=2, **timing)


def moving() -> list[tuple[str, str, Any]]:
    """Of each panel the title, a note and attitudes."""
    import kreisel as kr

    records = json.loads((BENCHMARKS / "results" / "hour.json").read_text(encoding="utf-8"))
    case = kr.checkcases.case("wing-nut").given()
    body = kr.physical.FreeBody(case["inertia"])
    times = 3600.0 - np.arange(len(records["kreisel"]["attitude"]))[::-1] / RATE
    start = body.state(case["angular_velocity"])
    exact = kr.at(body.model(), start, body.dt(1.0) * times, orientation=body.orientation())
    panels = [("exact", "", [body.attitude(g) for g in exact.g.values])]
    for record in (records["kreisel"], *(r for name, r in records.items() if name != "kreisel")):
        title = "the file" if record["title"] == "Kreisel" else record["title"].split(" (")[0]
        panels.append((title, f"energy {change(record['energy'][-1])}", record["attitude"]))
    return panels


def labels(draw: Any) -> Any:
    """The function that writes a text in a panel."""
    import matplotlib as mpl
    from PIL import ImageFont

    fonts = Path(mpl.get_data_path()) / "fonts" / "ttf"

    def write(corner: Any, place: tuple[float, float], text: str, anchor: str, weight: str = "") -> None:
        font = ImageFont.truetype(fonts / f"DejaVuSans{weight}.ttf", 11 * LARGER)
        draw.text(tuple(corner + np.array(place) * LARGER), text, "black", font, anchor)

    return write


def product(p: Any, q: Any) -> Any:
    """The product of two quaternions w, x, y, z."""
    (a, u), (b, v) = (p[0], np.array(p[1:])), (q[0], np.array(q[1:]))
    return np.array([a * b - u @ v, *(a * v + b * u + np.cross(u, v))])


def change(ratio: float) -> str:
    """The change of a quantity, from its value relative to that at the start."""
    if ratio > 10:
        return f"times {ratio:.0e}".replace("e+", "e").replace("e0", "e")
    size = abs(ratio - 1)
    return (
        f"{100 * (ratio - 1):+.2g} %" if size > 1e-6 else f"kept to {math.floor(-math.log10(max(size, 1e-12)))} digits"
    )


def write(docs: Path) -> None:
    """generated/engines.md, engines-CASE.md, engines-list.md, and the picture."""
    catalogue, result = read()
    folder = docs / "generated"
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    pages = {
        "errors": overview(catalogue, result),
        "list": catalogued(catalogue, result),
        "missing": missing(catalogue, result),
    }
    pages |= {case: of_case(case, catalogue, result) for case in CASES}
    for name, text in pages.items():
        (folder / f"engines-{name}.md").write_text(text, encoding="utf-8")
    picture(catalogue, result, folder / "figures" / "engines.png")
    after_an_hour(folder / "figures" / "hour.png")
    after_an_hour_moving(folder / "figures" / "hour.webp")


if __name__ == "__main__":
    write(Path(__file__).resolve().parent.parent)
