"""Which rows a run saves: after how many steps, and when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.algebra.computed import cached_property
from kreisel.kernels.layout import Floats
from kreisel.runs.settings import WHOLE, Settings


@dataclass
class Timetable:
    """The rows of the steps 0, every, 2 every, ... and the last, or those at given times.

    end   rows, and the time of the last, of a run that an event stopped
    """

    settings: Settings
    end: tuple[int, float] | None = None

    @cached_property
    def times(self) -> Floats | None:
        """The times of the rows, where they were given."""
        return None if self.settings.times is None else np.array(self.settings.times)

    @property
    def rows(self) -> int:
        """How many rows are saved."""
        if self.end is not None:
            return self.end[0]
        return count_of_rows(self.settings.steps, self.settings.every) if self.times is None else len(self.times)

    @cached_property
    def _places(self) -> tuple[list[int], list[float]]:
        """Of each row at a given time the steps before it, and how long after them it is."""
        times, dt = np.array(self.settings.times), self.settings.dt
        steps = np.floor(times / dt * (1 + WHOLE))
        within = times - steps * dt
        return steps.astype(np.int64).tolist(), np.where(within > WHOLE * dt, within, 0.0).tolist()

    def step_of(self, row: int) -> int:
        """The steps before a row; 0 before the first."""
        if self.times is None:
            return min(row * self.settings.every, self.settings.steps)
        return self._places[0][min(row, len(self.times) - 1)] if row >= 0 else 0

    def within_step(self, row: int) -> float:
        """How long after these steps a row is."""
        return 0.0 if self.times is None else self._places[1][row]

    def times_of(self, rows: Floats) -> Floats:
        """The times of rows."""
        if self.times is None:
            found = np.minimum(rows * self.settings.every, self.settings.steps) * self.settings.dt
        else:
            found = self.times[np.minimum(rows, len(self.times) - 1).astype(int)]
        return found if self.end is None else np.where(rows == self.end[0] - 1, self.end[1], found)


def count_of_rows(steps: int, every: int) -> int:
    """How many rows there are of the steps 0, every, 2 every, ... and the last."""
    return 1 + steps // every + (steps % every > 0)
