"""Time of many clones of Apophis through the approach of April 2029.

    python benchmarks/flyby.py [--clones 1000000] [--figure docs/guide-apophis-million.png]

Writes results/flyby.json: the wall clock and the processor time of the run of docs/guide-apophis.md, whose code this
executes up to the run with more clones; percentiles of both periods after it, with steps of 10 and of 5 minutes; and
the figure of the guide with all clones.
"""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine, parser, write

import kreisel as kr

GUIDE = Path(__file__).parent.parent / "docs" / "guide-apophis.md"


def drawn(names: dict[str, Any], run: Any, after: Any, path: Path) -> None:
    """Density of the periods of the clones, and of the rotation of their momentum."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    edges = np.linspace(15, 50, 141), np.geomspace(100, 1500, 141)
    for chosen, colors, label in (
        (after.short_axis, "Blues", "short axis"),
        (~after.short_axis, "Oranges", "long axis"),
    ):
        count = np.histogram2d(after.precession[chosen] / 3600, after.rotation[chosen] / 3600, edges)[0].T
        left.pcolormesh(*edges, np.ma.masked_less(count, 1), cmap=colors, norm="log", vmin=0.3)
        left.plot([], [], "s", color={"Blues": "tab:blue", "Oranges": "tab:orange"}[colors], label=label)
    left.plot(27.38, 263, "k+", markersize=10, label="before")
    left.set(xlabel="precession (h)", ylabel="rotation (h)", yscale="log", xlim=edges[0][[0, -1]])
    left.set_yticks([100, 200, 500, 1000], ["100", "200", "500", "1000"])
    left.minorticks_off()
    left.legend(loc="lower right")
    g = kr.algebra.rotation_matrix(run.attitude.values[-1])
    momentum = (g @ run.momentum.values[-1][..., None])[..., 0]
    cosine = momentum @ names["pole"] / np.linalg.norm(momentum, axis=-1)
    right.hist(np.degrees(np.arccos(cosine)), bins=200)
    right.set(xlabel="rotation of the angular momentum (degrees)", ylabel="clones")
    figure.savefig(path, dpi=110)


def main() -> None:
    options = parser(__doc__, "flyby")
    options.add_argument("--clones", type=int, default=1_000_000)
    options.add_argument("--figure", type=Path, default=GUIDE.with_name("guide-apophis-million.png"))
    args = options.parse_args()
    code = "\n".join(re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL))
    names: dict[str, Any] = {"__name__": "guide"}
    exec(code[: code.index("run = kr.simulate")].replace("5000)", f"{args.clones})"), names)
    rows = []
    for dt in ("10 min", "5 min"):
        begin = time.perf_counter(), time.process_time()
        run = kr.simulate(names["apophis"], names["start"], dt=dt, t_end="24 h", every="24 h")
        seconds, processor = time.perf_counter() - begin[0], time.process_time() - begin[1]
        after = names["apophis"].periods(run.angular_velocity.values[-1])
        hours = {k: np.percentile(getattr(after, k) / 3600, (5, 50, 95)).round(4) for k in ("precession", "rotation")}
        rows.append({"dt": dt, "clones": args.clones, "seconds": round(seconds, 1), "processor": round(processor, 1)})
        rows[-1] |= {name: value.tolist() for name, value in hours.items()}
        rows[-1] |= {"short axis": round(float(after.short_axis.mean()), 4)}
        print(rows[-1], flush=True)
        if dt == "10 min":
            drawn(names, run, after, args.figure)
    write({"machine": machine(), "rows": rows}, args.output)


if __name__ == "__main__":
    main()
