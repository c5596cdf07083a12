"""Bodies on orbits and in water against published values.

    python benchmarks/published.py

Writes results/published.json and its table on docs/satellites.md.  Each row: what, its source, the published number,
the range that agrees with it, and what Kreisel finds.  The range is that of the source where it states one.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cases import machine, parser, write

import kreisel as kr
from kreisel.analysis.frequencies import lines_of
from kreisel.physical import SUN, Asteroid, Orbit, Satellite, SubmergedBody

PAGE = Path(__file__).parents[1] / "docs" / "satellites.md"
BEGIN, END = "<!-- the table of results/published.json -->\n", "\n<!-- end of the table -->"
ARCSECONDS, DAY, YEAR = 180 / np.pi * 3600, 86_400.0, 365.25 * 86_400.0


class Row(NamedTuple):
    """One number; least and most, the range that agrees with the published one (None: no bound)."""

    what: str
    source: str
    published: str
    least: float
    most: float | None
    found: float


def rows() -> Iterator[Row]:
    yield from rod()
    yield from mercury()
    yield from hyperion()
    yield from disc()


def rod() -> Iterator[Row]:
    """A rod with a hundredth of the moment along it, on a circular orbit, released 2e-4 off the vertical."""
    body = Satellite((0.01, 1.0, 1.0), Orbit.circular("500 km"))
    g = body.orientation(body.pointing(pitch=2e-4, roll=2e-4))
    run = kr.simulate(body.model(), body.state(), dt=30.0, steps=8000, every=4, orientation=g, progress=False)
    angles, source = body.angles(run), "Hughes 1986, section 9.2"
    for name, values, want, said in (("pitch", angles.pitch, np.sqrt(3.0), "√3"), ("roll", angles.roll, 2.0, "2")):
        (found,) = lines_of(run.time.values, values, 1).frequency
        yield Row(
            f"rod, {name} over mean motion", source, said, want - 0.01, want + 0.01, found / body.orbit.mean_motion
        )


def librations(asymmetry: float, orbits: int) -> tuple[Any, Any]:
    """Mercury in its resonance with (B - A)/C: the strongest lines of its resonant angle, and its orbit."""
    orbit = Orbit(0.38709893 * 149_597_870_700.0, 0.20563069, primary=SUN)
    body = Asteroid((1 - 2.5 * asymmetry, 1 - 1.5 * asymmetry, 1.0), orbit)
    run = kr.simulate(
        body.model(),
        body.state(1.5 * orbit.mean_motion, axis=(0, 0, 1)),
        dt=orbit.period / 48,
        steps=48 * orbits,
        every=4,
        orientation=body.orientation(body.pointing()),
        progress=False,
    )
    return lines_of(run.time.values, body.resonant_angle(run, 1.5), 6), orbit


def mercury() -> Iterator[Row]:
    lines, orbit = librations(2.03e-4, 400)
    forced = np.argmin(abs(abs(lines.frequency) / orbit.mean_motion - 1))
    amplitude = abs(lines.amplitude[forced]) * ARCSECONDS
    what = "Mercury, libration in 88 days with (B - A)/C = 2.03e-4, arcseconds"
    yield Row(what, "Margot 2007", "35.8 ± 2", 33.8, 37.8, amplitude)
    lines, orbit = librations(4 * 1.0e-5 / 0.34, 400)
    free = 2 * np.pi / abs(lines.frequency[np.argmax(abs(lines.amplitude))]) / YEAR
    what = "Mercury, free libration with C_22 = 1.0e-5, C = 0.34 m R², years"
    yield Row(what, "Rambaux 2004", "15.847", 15.8, 15.9, free)


def hyperion() -> Iterator[Row]:
    body = Asteroid.hyperion()
    A, B, C = body.body.principal.moments
    source = "Wisdom 1984"
    yield Row("Hyperion, (B - A)/C", source, "0.264", 0.2635, 0.2645, (B - A) / C)
    n = body.orbit.mean_motion
    spins = np.linspace(0.6, 1.6, 24)[:, None] * n * np.array((0.0, 0.0, 1.0))
    given = {"dt": body.orbit.period / 48, "orientation": body.orientation(body.pointing())}
    run = kr.simulate(body.model(), body.state(spins), steps=48 * 200, every=48, progress=False, **given)
    rates = run.M.values[..., 2] / C / n
    chaotic = rates[:, np.ptp(rates, axis=0) > 1]
    yield Row("Hyperion, least rate of the chaotic zone over n", source, "below the state 1/2", 0.0, 0.5, chaotic.min())
    yield Row("Hyperion, its largest", source, "above the state 2", 2.0, None, chaotic.max())


def disc() -> Iterator[Row]:
    """A thin disc moved broadside and turned about a diameter: 8/3 and 16/45 of density times radius^3, ^5."""
    added = SubmergedBody.ellipsoid((1.0, 1.0, 1e-4), 1.0, "1 kg/m^3").added_mass
    source = "Lamb 1932, articles 108, 115"
    yield Row("disc, added mass broadside over density and radius³", source, "8/3", 2.665, 2.668, added[2, 2])
    yield Row(
        "disc, added moment about a diameter over density and radius⁵", source, "16/45", 0.355, 0.356, added[3, 3]
    )


def table(found: list[dict[str, Any]]) -> str:
    lines = ["| what | source | published | agrees | found |", "| --- | --- | --- | --- | --- |"]
    for row in found:
        agrees = f"{row['least']:g} to {row['most']:g}" if row["most"] is not None else f"{row['least']:g} or more"
        lines.append(f"| {row['what']} | {row['source']} | {row['published']} | {agrees} | {row['found']:.5g} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    asked = parser(__doc__, "published").parse_args(arguments)
    found = [row._asdict() | {"found": float(f"{row.found:.5g}")} for row in rows()]
    print(table(found))
    write({"machine": machine(), "rows": found}, asked.output)
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    if rest:
        PAGE.write_text(before + BEGIN + "\n" + table(found) + "\n" + END + rest.partition(END)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
