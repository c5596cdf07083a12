"""kr.simulate: from a system, a state and a step to a trajectory with its integrals."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array
from kreisel.engines import layout
from kreisel.engines.layout import Floats
from kreisel.errors import InputError, RunError
from kreisel.runs.plan import Plan, make_plan
from kreisel.runs.progress import Progress

if TYPE_CHECKING:
    import xarray as xr

BLOCK_BYTES = 1 << 20  # of states, held at once
TICK_SECONDS = 0.1  # between two looks at the clock


def simulate(
    system: Any,
    x0: Any,
    *,
    dt: float,
    steps: int,
    every: int = 1,
    method: str | None = None,
    order: int | None = None,
    orientation: Any = None,
    path: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
) -> xr.Dataset:
    """Simulate `steps` steps of length `dt` and return every `every`-th state with all integrals.

    system       a system with parameters, e.g. `kr.LagrangeTop(p=(0, 0, 1))`
    x0           `system.state(...)`, or a dict of its components; a batch axis in front makes an ensemble
    dt           step in the system's unit of time, > 0
    method       "suris" (the paper's map; default where one is known), "variational" (symplectic, any system;
                 default elsewhere) or "dop853" (SciPy, preserves nothing)
    order        "suris": 1 is the paper's map, 2 (default) its half-kick conjugate; "variational": 2 (default), 4, 6, 8
    orientation  initial g, body to space: a rotation matrix, or a unit quaternion (w, x, y, z) for n = 3;
                 it is then carried along as the variable g
    path         write to a Zarr archive while the run goes on, and return it opened; else stay in memory
    overwrite    replace an archive that exists (the old one stays until the new one is whole)
    progress     show a progress bar on stderr; default: when stderr is a terminal

    Returns an `xarray.Dataset`: coordinates time (and lane), the components of the state (axial vectors
    for n = 3), the Casimirs and every integral.  Raises `InputError` for bad input and `RunError` when
    a state is no longer finite, an implicit step is not solved or the archive cannot be written.
    """
    plan = make_plan(system, x0, dt=dt, steps=steps, every=every, method=method, order=order, orientation=orientation)
    from kreisel.runs.archive import Archive, in_memory, open_archive, target

    with Progress(plan.steps * plan.lanes, progress) as bar:
        if path is None:
            _check_memory(plan)
            return in_memory(plan, list(march(plan, bar.advance)))
        with Archive(target(path), plan, overwrite) as archive:
            for block in march(plan, bar.advance):
                archive.append(block)
    return open_archive(Path(path))


def march(plan: Plan, tick: Callable[[int], None] = lambda steps: None) -> Iterator[dict[str, Array]]:
    """Blocks of outputs, time in front, in order; the first holds the initial state."""
    width = plan.engine.z.size
    most = block_rows(plan)
    buffer = np.empty((most, *plan.engine.z.shape))
    buffer[0] = plan.engine.z
    filled, done = 1, 0
    pace = _Pace(plan, tick)
    regular, rest = plan.steps // plan.every, plan.steps % plan.every
    while done < regular or rest:
        if filled == most:
            yield _finished(plan, buffer[:filled], done)
            filled = 0
        every = plan.every if done < regular else rest
        rows = min(most - filled, regular - done) if done < regular else 1
        rows = pace.fill(buffer[filled : filled + rows], every)
        filled, done, rest = filled + rows, done + rows, rest if done < regular else 0
    if filled and width:
        yield _finished(plan, buffer[:filled], done)


def block_rows(plan: Plan) -> int:
    """Rows held at once, and rows in a chunk of an archive."""
    return int(max(1, min(plan.rows, BLOCK_BYTES // (8 * plan.engine.z.size))))


class _Pace:
    """Calls of the engine short enough to show progress and to be interrupted."""

    def __init__(self, plan: Plan, tick: Callable[[int], None]):
        self.engine, self.lanes, self.tick, self.burst = plan.engine, plan.lanes, tick, 256
        self.scratch = np.empty((1, *plan.engine.z.shape))

    def fill(self, out: Floats, every: int) -> int:
        """Fill as many rows of `out` as fit in a tick, at least one."""
        rows = min(len(out), max(1, self.burst // every))
        left = every if rows == 1 else 0
        while left > self.burst:
            burst = self.burst  # the call changes it
            self._call(self.scratch, burst)
            left -= burst
        self._call(out[:rows], left or every)
        return rows

    def _call(self, out: Floats, every: int) -> None:
        begun = time.perf_counter()
        self.engine.advance(out, every)
        seconds = time.perf_counter() - begun
        self.tick(len(out) * every * self.lanes)
        if seconds < TICK_SECONDS:
            self.burst = min(2 * self.burst, 1 << 40)
        elif seconds > 2 * TICK_SECONDS:
            self.burst = max(1, self.burst // 2)


def _finished(plan: Plan, rows: Floats, done: int) -> dict[str, Array]:
    finite = np.isfinite(rows).all(axis=(1, 2))
    if not finite.all():
        step = (done - len(rows) + 1 + int(np.argmin(finite))) * plan.every
        raise RunError(
            f"The state is no longer finite at or before step {step} (time {step * plan.dt:g}). "
            "Usual cause: a step far too long, or a state so large that its square overflows. Use a smaller dt."
        )
    _check_guard(plan, rows, done)
    with np.errstate(all="ignore"):
        block = plan.observe(rows.copy())  # the buffer is filled again
    for name, value in block.items():
        if not np.isfinite(value).all():
            raise RunError(
                f"{name} is not finite, although the state is, in the rows before step {done * plan.every}. "
                "Usual cause: a state so large that its powers overflow. Use smaller units."
            )
    return block


def _check_guard(plan: Plan, rows: Floats, done: int) -> None:
    guard = plan.scheme.guard
    if guard is None:
        return
    letters = [letter for letter, _ in plan.scheme.components]
    values = layout.restore(rows, plan.kinds, plan.model.n)[letters.index(guard.component)]
    if (values > guard.limit).any():
        step = (done - len(rows) + 1 + int(np.argmax((values > guard.limit).any(-1)))) * plan.every
        raise RunError(f"{guard.fault} at or before step {step} (time {step * plan.dt:g}). Usual cause: {guard.cause}")


def _check_memory(plan: Plan) -> None:
    need = plan.rows * plan.engine.z.size * 8 * 4
    have = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if need > 0.7 * have:
        raise InputError(
            f"{plan.rows:,} saved rows would need about {need / 2**30:.1f} GiB of memory. "
            "Give path='run.zarr' to write them to disk as the run goes on, or save less often with every=..."
        )
