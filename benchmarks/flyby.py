"""Time of many clones of Apophis through the approach of April 2029.

    python benchmarks/flyby.py [--clones 1000000]

Writes results/flyby.json: the wall clock and the processor time of the run of docs/guide-apophis.md, whose code this
executes up to the run with more clones; percentiles of both periods after it, with steps of 10 and of 5 minutes.
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


def main() -> None:
    options = parser(__doc__, "flyby")
    options.add_argument("--clones", type=int, default=1_000_000)
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
        print(rows[-1], flush=True)
    write({"machine": machine(), "rows": rows}, args.output)


if __name__ == "__main__":
    main()
