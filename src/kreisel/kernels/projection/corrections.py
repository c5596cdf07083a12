"""The data of a projection in a run, for every kind of projection, and how often it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from kreisel.algebra import Array
from kreisel.kernels.layout import Floats

EPS = float(np.finfo(np.float64).eps)
TAU = 1e-6  # of a row of length 1: a row that depends less on the others is left unchanged
GAIN = 0.0625  # of the measured mean of an invariant's drift from one projection to the next
GAIN_STRAIGHT = 0.015625  # the same where projections are written out, and K is 5 to 8 times shorter
FAR = 1e3  # times the random walk of rounding errors of a state that rotates by a radian in a step
# K: parts of 10^k, from 10 on.  With SHARE projections of vectors of lanes need 2 to 4 % of the time, n = 3 to 5; those
# of a single trajectory, whose steps wait for each other, 1 %.
INTERVALS = tuple(
    m * 10**e // 100 for e in range(1, 12) for m in (100, 125, 200, 250, 400, 500, 800) if e > 1 or m != 125
)
SHARE = 0.011  # operations of a projection that an operation of a step may cost
ALONE = 3  # times as many where a lane is as slow as a single trajectory


def interval(cost: float, work: float, most: int = 0) -> int:
    """K: the first of 10, 20, 25, ... steps between two projections that makes them a small share of the time.

    `most`: at most so many, whatever they cost; 0 for no such bound.
    """
    return min(next(k for k in INTERVALS if k * SHARE * work >= cost), most or INTERVALS[-1])


class Corrections:
    """The data of a projection in a run: the values of the invariants at the start, and the size of its corrections.

    labels   of the invariants
    every    steps between two projections; `done` of them were made since the last one
    targets  the values at the start, in two doubles each, the size of their terms, and by how much a projection goes
             beyond them (lanes, invariants, 4)
    worst    the largest correction of each yet, as a distance in state space in units of eps_machine |z|
    bound    as `targets`, of the constraints between an orientation and the state
    """

    def __init__(self, labels: tuple[str, ...], every: int, lanes: int, bonds: int = 0):
        self.labels, self.every, self.done = labels, every, 0
        self.targets, self.worst = np.zeros((lanes, len(labels), 4)), np.zeros((lanes, len(labels)))
        self.bound = np.zeros((lanes, bonds, 4))

    def peek(self, z: Floats) -> Floats:
        """`worst` with the corrections of the state z (lanes, invariants), NaN where unknown; nothing changes."""
        raise NotImplementedError

    def apply(self) -> None:
        """Project the state, in place."""
        raise NotImplementedError

    def count(self, steps: int) -> None:
        """So many steps were made."""
        self.done = (self.done + steps) % self.every

    def in_parts(
        self, out: Floats, every: int, advance: Callable[[Floats, int], None], project: Callable[[], Floats]
    ) -> None:
        """`every` steps for each row of `out`, by calls of `advance(rows, steps)`, and a projection if it is due.

        `project` returns the state, which a row that ends there has.
        """
        row = into = 0
        while row < len(out):
            left = self.every - self.done
            rows = 0 if into else min(left // every, len(out) - row)
            steps = rows * every or min(left, every - into)
            advance(out[row : row + max(rows, 1)], every if rows else steps)
            into = (into + steps) % every
            row += rows or into == 0
            self.count(steps)
            if self.done == 0:
                state = project()
                if into == 0:
                    out[row - 1] = state

    def beyond(self, angle: Array) -> Array:
        """Which corrections (lanes, invariants) roundings of `every` steps, each a rotation by `angle`, cannot
        explain.
        """
        return self.worst > FAR * np.sqrt(self.every) * (1 + angle[:, None] ** 2)

    def largest(self, z: Floats) -> dict[str, float]:
        """The largest correction of each variable, at the end of a run in the state z."""
        out: dict[str, float] = {}
        for label, value in zip(self.labels, np.fmax.reduce(self.peek(z)), strict=True):
            if value == value:
                name = label.partition("[")[0]
                out[name] = max(out.get(name, 0.0), float(value))
        return out

    def snapshot(self) -> dict[str, Floats]:
        """All that the next steps depend on."""
        done = np.array(float(self.done))
        return {"targets": self.targets, "bound": self.bound, "worst": self.worst, "done": done}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        """Go on from a snapshot."""
        for name in ("targets", "bound", "worst"):
            getattr(self, name)[:] = snapshot[name]
        self.done = int(snapshot["done"])
