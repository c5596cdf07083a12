"""Estimates of the time and disk that a run needs, and a progress bar while it runs."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.errors import InputError, shown
from kreisel.kernels.engines import Engine
from kreisel.method.scheme import Orbits
from kreisel.runs.plan import Plan

SHOW_AFTER_SECONDS = 0.5


class Progress:
    """Counts steps, or lanes; a bar on stderr appears after half a second."""

    def __init__(self, total: int, show: bool | None, done: int = 0, unit: str = "steps"):
        if show is not None and not isinstance(show, bool):
            raise InputError(f"progress: expected True, False or None for the default, got {shown(show)}.")
        self._unit = unit
        self.total, self.done, self._before = total, done, done
        self._show = (sys.stderr.isatty() or "ipykernel" in sys.modules) if show is None else show
        self._begun, self._bar, self._task = time.perf_counter(), None, None

    def __enter__(self) -> Progress:
        return self

    def advance(self, steps: int) -> None:
        """Count finished steps or lanes."""
        self.done += steps
        if self._bar is None and self._show and time.perf_counter() - self._begun > SHOW_AFTER_SECONDS:
            self._bar, self._task = _bar(self.total)
        if self._bar is not None:
            rate = (self.done - self._before) / (time.perf_counter() - self._begun)
            self._bar.update(
                self._task, completed=self.done, rate=f"{_in_thousands(rate, ('', 'k', 'M', 'G', 'T'))} {self._unit}/s"
            )

    def __exit__(self, *raised: object) -> None:
        if self._bar is not None:
            self._bar.stop()


def _bar(total: int) -> tuple[Any, Any]:
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[rate]}"), TimeElapsedColumn())
    # rich asks for ipywidgets in a notebook, whose stderr needs a line of text as well
    plain = {"force_jupyter": False, "force_terminal": True, "width": 100} if "ipykernel" in sys.modules else {}
    console = Console(stderr=True, **plain)  # type: ignore[arg-type]
    bar = Bar(*columns, TextColumn("left"), TimeRemainingColumn(), console=console, transient=True)
    bar.start()
    return bar, bar.add_task("steps", total=total, rate="")


def _in_thousands(x: float, units: Sequence[str]) -> str:
    power = min(len(units) - 1, next((k for k in range(len(units)) if x < 1000 ** (k + 1)), len(units)))
    return f"{x / 1000**power:.3g} {units[power]}".rstrip()


# Compressed size of a Lagrange top's rows: the state 0.96, Casimirs and integrals 0.06.  A run is refused if the disk
# has no room for half of the bytes of its states.
OF_STATES, OF_INTEGRALS, LEAST = 0.96, 0.06, 0.5
SECONDS_A_BYTE = 13e-9  # to compress and write; 75 MB a second, a core of a busy machine
PILOT_SECONDS = 0.05
PILOT_ROWS = 256


@dataclass(frozen=True)
class Estimate:
    """Seconds, bytes on disk, and free bytes on that disk."""

    seconds: float
    bytes: float
    free: float

    @property
    def text(self) -> str:
        """The estimate in words."""
        return f"about {duration_text(self.seconds)}, {size_text(self.bytes)} on disk ({size_text(self.free)} free)"


def bytes_of(plan: Plan) -> tuple[float, float]:
    """The bytes of an archive, likely and least."""
    row = {name: value[0].nbytes for name, value in plan.example.items()}
    states = sum(size for name, size in row.items() if plan.outcomes[name].kind in ("state", "orientation"))
    likely = OF_STATES * states + OF_INTEGRALS * (sum(row.values()) - states)
    return plan.rows * likely, plan.rows * LEAST * states


def require_room(path: Path, least: float, instead: str) -> None:
    """Raises `InputError` if the disk of `path` has fewer bytes than `least`."""
    free = free_at(path)
    if least > free:
        raise InputError(
            f"{path}: expected a disk with at least {size_text(least)} free, got {size_text(free)}. {instead}"
        )


def free_at(path: Path) -> float:
    """The free bytes on the disk of a path, present or future; infinite if unknown."""
    try:
        folder = path.absolute()
        while not folder.is_dir() and folder != folder.parent:
            folder = folder.parent
        return shutil.disk_usage(folder).free
    except OSError:  # a name that is too long, a folder without access: writing reports this
        return math.inf


def estimate(plan: Plan, path: Path) -> Estimate:
    """The estimate from a pilot of some milliseconds, whose kernels the run reuses."""
    engine, count = plan.engine_at(plan.first), 1
    if isinstance(plan.scheme.motion, Orbits):  # by rows, and the set-up of each call
        count = max(1, min(PILOT_ROWS, plan.rows // 8))
        once, twice = (_spent(engine, rows, plan.every) for rows in (count, 2 * count))
        of_steps = once + max(0.0, twice - once) / count * plan.rows
    else:
        while (spent := _spent(engine, 1, count)) < PILOT_SECONDS / 2 and 8 * count < plan.steps:
            count *= 2
        of_steps = spent / count * plan.steps
    rows = np.repeat(plan.first[None], min(PILOT_ROWS, plan.rows), 0)
    with np.errstate(all="ignore"):
        plan.observe(rows[:1])  # its kernel
        begun = time.perf_counter()
        row = plan.observe(rows)
    a_row = (time.perf_counter() - begun) / len(rows)
    a_row += SECONDS_A_BYTE * sum(value.nbytes for value in row.values()) / len(rows)
    return Estimate(of_steps + plan.rows * a_row, bytes_of(plan)[0], free_at(path))


def _spent(engine: Engine, rows: int, every: int) -> float:
    """Seconds of a call, the better of two: the first may set something up."""
    out, spent = np.empty((rows, *engine.z.shape)), []
    for _ in range(2):
        begun = time.perf_counter()
        engine.advance(out, every)
        spent.append(time.perf_counter() - begun)
    return min(spent)


def size_text(size: float) -> str:
    """Bytes with a unit."""
    return _in_thousands(size, ("bytes", "KB", "MB", "GB", "TB", "PB")) if math.isfinite(size) else "unknown"


def duration_text(seconds: float) -> str:
    """Seconds with a unit."""
    for unit, size, most in (("s", 1, 90), ("min", 60, 90), ("hours", 3600, 48), ("days", 86400, 700)):
        if seconds < size * most:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 31557600:.2g} years"
