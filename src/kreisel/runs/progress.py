"""A progress bar with rate and time left on a terminal; silent when piped."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any

from kreisel.errors import InputError, shown

SHOW_AFTER_SECONDS = 0.5


class Progress:
    """Counts steps, or lanes; a bar on stderr appears once the run has taken half a second."""

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
        """Count what is done."""
        self.done += steps
        if self._bar is None and self._show and time.perf_counter() - self._begun > SHOW_AFTER_SECONDS:
            self._bar, self._task = _bar(self.total)
        if self._bar is not None:
            rate = (self.done - self._before) / (time.perf_counter() - self._begun)
            self._bar.update(self._task, completed=self.done, rate=f"{_with_prefix(rate)} {self._unit}/s")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def _bar(total: int) -> tuple[Any, Any]:
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[rate]}"), TimeElapsedColumn())
    # rich asks for ipywidgets in a notebook, whose stderr takes a line of text as well
    plain = {"force_jupyter": False, "force_terminal": True, "width": 100} if "ipykernel" in sys.modules else {}
    console = Console(stderr=True, **plain)  # type: ignore[arg-type]
    bar = Bar(*columns, TextColumn("left"), TimeRemainingColumn(), console=console, transient=True)
    bar.start()
    return bar, bar.add_task("steps", total=total, rate="")


def _with_prefix(x: float) -> str:
    for unit in ("", "k", "M", "G"):
        if x < 1000:
            return f"{x:.3g} {unit}".rstrip()
        x /= 1000
    return f"{x:.3g} T"
