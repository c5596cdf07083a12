"""How long a run will take and how much disk it needs, from its plan and a pilot; and whether the disk has room."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kreisel.errors import InputError
from kreisel.runs.plan import Plan

# Of the bytes of a Lagrange top's rows that an archive holds: the state 0.96, Casimirs and integrals 0.06.  A run
# whose states take half of their bytes is refused for a disk without room for that.
OF_STATES, OF_INTEGRALS, LEAST = 0.96, 0.06, 0.5
SECONDS_A_BYTE = 13e-9  # to compress and write; 75 MB a second, a core of a busy machine
PILOT_SECONDS = 0.05
PILOT_ROWS = 256


@dataclass(frozen=True)
class Estimate:
    """Seconds, bytes on disk, and the bytes that are free there."""

    seconds: float
    bytes: float
    free: int

    @property
    def text(self) -> str:
        """In words."""
        return f"about {_duration(self.seconds)}, {size_text(self.bytes)} on disk ({size_text(self.free)} free)"


def bytes_of(plan: Plan) -> tuple[float, float]:
    """The bytes of an archive, as likely and at least."""
    row = {name: value[0].nbytes for name, value in plan.example.items()}
    states = sum(size for name, size in row.items() if plan.outcomes[name].kind in ("state", "orientation"))
    likely = OF_STATES * states + OF_INTEGRALS * (sum(row.values()) - states)
    return plan.rows * likely, plan.rows * LEAST * states


def require_room(path: Path, least: float, instead: str) -> None:
    """Raises `InputError` where the disk of `path` has less than the bytes that are needed at least."""
    free = free_at(path)
    if least > free:
        raise InputError(
            f"{path}: expected a disk with at least {size_text(least)} free, got {size_text(free)}. {instead}"
        )


def free_at(path: Path) -> int:
    """The bytes that are free where a path is, or will be."""
    folder = path.absolute()
    while not folder.is_dir() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free


def estimate(plan: Plan, path: Path) -> Estimate:
    """From a pilot of some milliseconds, whose kernels the run then has."""
    engine, steps, spent = plan.engine_at(plan.first), 1, 0.0
    engine.advance(np.empty((1, *engine.z.shape)), 1)
    while spent < PILOT_SECONDS / 2 and steps < plan.steps:
        begun = time.perf_counter()
        engine.advance(np.empty((1, *engine.z.shape)), steps)
        spent, steps = time.perf_counter() - begun, 2 * steps
    a_step = 2 * spent / steps
    rows = np.repeat(plan.first[None], min(PILOT_ROWS, plan.rows), 0)
    with np.errstate(all="ignore"):
        plan.observe(rows[:1])  # its kernel
        begun = time.perf_counter()
        row = plan.observe(rows)
    a_row = (time.perf_counter() - begun) / len(rows)
    a_row += SECONDS_A_BYTE * sum(value.nbytes for value in row.values()) / len(rows)
    return Estimate(plan.steps * a_step + plan.rows * a_row, bytes_of(plan)[0], free_at(path))


def size_text(size: float) -> str:
    """Bytes with a unit."""
    for unit in ("bytes", "KB", "MB", "GB", "TB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} PB"


def _duration(seconds: float) -> str:
    for unit, size, most in (("s", 1, 90), ("min", 60, 90), ("hours", 3600, 48), ("days", 86400, 700)):
        if seconds < size * most:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 31557600:.2g} years"
