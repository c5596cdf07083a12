"""A Lagrange top by a map of Kreisel and by a general-purpose solver: the drift of every integral.

Usage: python compare.py [FOLDER]; the figure goes to FOLDER, else to the current folder.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import kreisel as kr

DT, STEPS, EVERY = 0.05, 100_000, 2


def timed(method: str, **options: Any) -> Any:
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    begun = time.perf_counter()
    run = kr.simulate(top, x0, dt=DT, steps=STEPS, every=EVERY, method=method, progress=False, **options)
    print(f"{method}: {STEPS:,} steps of {DT} in {time.perf_counter() - begun:.2f} s")
    return run


def worst(run: Any, only_kept: bool = False) -> Any:
    """The row of `kr.drift` that changed most against its round-off, of each family."""
    table = kr.drift(run)
    table = table[table.conserved] if only_kept else table
    families = table.groupby(table.index.str.split("[").str[0], sort=False)
    return table.loc[families.ulps.idxmax().to_numpy(), ["max_change", "ulps", "slope"]]


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    ours, theirs = timed("baecklund"), timed("dop853")
    show = {"float_format": "{:.1e}".format}
    print("\nbaecklund: worst of each family that the map conserves\n" + worst(ours, only_kept=True).to_string(**show))
    print("\ndop853, rtol 1e-9: worst of each family of the flow\n" + worst(theirs).to_string(**show))
    path = folder / "compare.png"
    kr.plot(ours, compare=theirs).savefig(path)
    print(f"\nfigure: {path}")


if __name__ == "__main__":
    main()
