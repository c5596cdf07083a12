"""method="baecklund": time of a step for n = 3."""

from __future__ import annotations

import argparse
import time

import numpy as np
from cases import cases, steps_of

TIMED = (2, 4, 8, 12, 16)


def speed(steps: int = 200_000, turns: int = 7) -> None:
    """Nanoseconds a step, the least of several rounds."""
    for case in cases(3, generic=True):
        if case.name == "symmetric-top":
            continue
        state, columns = next(iter(case.states.values())), []
        for order in TIMED:
            after, best = steps_of(case.model, state, dt=0.05, method="baecklund", order=order), np.inf
            for _ in range(turns):
                begun = time.perf_counter()
                after(steps)
                best = min(best, time.perf_counter() - begun)
            columns.append(f"{order}: {best / steps * 1e9:.0f}")
        print(f"{case.name:<21}ns a step by order  {'  '.join(columns)}", flush=True)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    speed()
