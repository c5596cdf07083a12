"""The page of a run in headless Chromium without a GPU: pictures a second while it plays, and the size of the page.

Pictures are counted by requestAnimationFrame in which the stage was drawn.  Next to the rate by the clock is the
processor time of the complete browser for a picture, which other work on the machine changes less.  Runs of a Lagrange
top with its orientation, 401 and 100,001 saved states; 1280 x 800 pixels.  Needs chromium.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine, parser, write

import kreisel as kr

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import browser

ROWS = (401, 100_001)
SETTLE, SECONDS, TURNS = 5.0, 6.0, 2
COUNT = """new Promise(done => { let n = 0; const stage = kreisel.stage, begun = performance.now();
const before = stage.renderer.render;
stage.renderer.render = function (...all) { n += 1; return before.apply(this, all); };
const look = now => { if (now - begun < %d) requestAnimationFrame(look);
else { stage.renderer.render = before; done([n, (performance.now() - begun) / 1000, stage.coarse]); } };
requestAnimationFrame(look); })"""


def family(pid: int) -> list[int]:
    """A process and its descendants."""
    parents = {}
    for each in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(each.parent.name)] = int(each.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def worked(pid: int) -> float:
    """Processor seconds of a process and its descendants."""
    total = 0
    for one in family(pid):
        try:
            total += sum(map(int, Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()[11:13]))
        except OSError:
            continue
    return total / os.sysconf("SC_CLK_TCK")


def played(page: Path) -> tuple[float, float, float]:
    """Pictures a second, processor seconds a picture, and how coarsely it was drawn (1: every pixel)."""
    window = browser.Browser()
    try:
        window.ask("Emulation.setDeviceMetricsOverride", width=1280, height=800, deviceScaleFactor=1, mobile=False)
        window.open(page.as_uri())
        window.wait("document.body && document.body.dataset.ready")
        window.run("document.getElementById('play').click()")
        time.sleep(SETTLE)
        begun = worked(window.process.pid)
        count, seconds, coarse = window.run(COUNT % (1000 * SECONDS))
        return count / seconds, (worked(window.process.pid) - begun) / count, coarse
    finally:
        window.close()


def main() -> None:
    arguments = parser(__doc__, "viewer").parse_args()
    load = os.getloadavg()[0]
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    cases: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for rows in ROWS:
            run = kr.simulate(top, x0, dt=0.05, steps=rows - 1, orientation=(1, 0, 0, 0), progress=False)
            page = kr.view(run).save(Path(folder) / f"{rows}.html")
            found = np.array([played(page) for _ in range(TURNS)])
            rate, cost, coarse = np.median(found, axis=0)
            cases[str(rows)] = {
                "megabytes": round(page.stat().st_size / 1e6, 2),
                "pictures_a_second": round(float(rate), 1),
                "processor_seconds_a_picture": round(float(cost), 4),
                "scale": round(float(coarse), 2),
            }
            print(rows, cases[str(rows)])
    write(
        {"machine": machine(), "turns": TURNS, "load_average_before": round(load, 1), "pages": cases}, arguments.output
    )


if __name__ == "__main__":
    main()
