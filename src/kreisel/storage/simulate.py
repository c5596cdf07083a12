"""kr.simulate: from a system, a state and a step to a trajectory with its integrals."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from kreisel.errors import AccuracyWarning, InputError, Stopped, doubt, explained
from kreisel.files import stands
from kreisel.process import Progress, signals_wait
from kreisel.record.body import Body, doubts_of_end, model_of
from kreisel.runs.drift import watched
from kreisel.runs.geometry import presented
from kreisel.runs.in_si import scaled, scaled_events, steps_in, unit_of_times
from kreisel.runs.integration import Integration
from kreisel.runs.plan import Plan
from kreisel.runs.planning import bytes_of, idle_or_new, make_plan, require_room, warn_of, warn_of_arrays
from kreisel.runs.settings import Event, checked_events, flag, within

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

    from kreisel.record.model import Model, OrientationLike, StateLike
    from kreisel.storage.run_archive import RunArchive

CHECKPOINT_SECONDS = 5.0  # between two checkpoints of a run to disk
ALWAYS_THERE = 1 << 28  # bytes of memory, allowed without confirmation


@explained
def simulate(
    system: Model | Body,
    x0: StateLike,
    *,
    dt: Any = None,
    steps: int | None = None,
    t_end: Any = None,
    t_start: Any = None,
    times: ArrayLike | None = None,
    every: Any = None,
    method: str | None = None,
    order: int | str | tuple[int, ...] | None = None,
    tol: float | None = None,
    orientation: OrientationLike | None = None,
    engine: str | None = None,
    project: bool = True,
    observe: Sequence[str] | None = None,
    impulses: Mapping[str, Any] | Sequence[Mapping[str, Any]] = (),
    events: Event | Sequence[Event] = (),
    path: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
) -> xr.Dataset:
    """Simulate `steps` steps of length `dt`, or until `t_end`; return every `every`-th state with all integrals.

    system       a system with parameters, e.g. `kr.LagrangeTop(p=(0, 0, 1))`, or a body of `kr.physical`: then times
                 are in s, or "1 ms", and the run in SI, along the axes in which the body was given
    x0           `system.state(...)`, a dict of components, or a row of a run; a batch axis in front makes an ensemble
    dt           step in the system's unit of time; default of satellites: chosen for 1e-6 rad, or a controller's
    t_end        the time at the end, in place of `steps`: in equal steps of dt or a little less: attribute asked_dt
    t_start      the time at the start, of forces and samples, default 0: x0=row, t_start=row.time continues a run
    times        of the rows, in order, in place of `steps` and `every`; rows between steps do not change the steps
    method       one of `kr.methods()`; default: the first that applies, "exact" only for free bodies with n = 3
    order        one of the orders of the method; for splittings also a tuple, (8, 2).  "auto" (baecklund, splitting):
                 the order and the step that reach `tol` at the least cost (attributes dt, steps, options)
    tol          error at the end relative to the largest entry (order="auto"); relative tolerance ("dop853")
    orientation  initial g, body to space: a matrix, or for n = 3 a quaternion (w, x, y, z); then it is a variable
    engine       "cpu" (compiled, all cores), "large" (O(n) a step for Lagrange tops and Neumann, O(n^2) for Clebsch;
                 both by n and method unless given), "cuda" (NVIDIA, float64), "cuda-float32": many lanes, n <= 10
    project      project away rounding of invariants every `projection` steps (an attribute; 0: not); False: the map
    observe      Casimirs and integrals to save with the state, by name; default: all, most of the time of a row
    impulses     added to a momentum as the state has it, before the row there: {"time": 2.0, "m": (0, 0, 1)}, or a list
    events       `kr.Event(quantity, action)` or a list, with times in the attribute event_times
    path         write to a Zarr archive during the run, and return it opened; overwrite: in place of an existing one
    progress     show a progress bar on stderr; default: when stderr is a terminal

    Returns an `xarray.Dataset`: time (and lane), the state (axial vectors for n = 3), Casimirs and integrals.  Raises
    `InputError` for bad input, `RunError` when a state is no longer finite, an implicit step is not solved or the
    archive cannot be written; warns of lost invariants and long steps.
    """
    flag(overwrite, "overwrite")
    asked = dict[str, Any](dt=dt, method=method, order=order, tol=tol, engine=engine, project=project, observe=observe)
    asked |= {"steps": steps, "t_end": t_end, "times": times, "every": every, "impulses": impulses, "t_start": t_start}
    model, x0, orientation, asked, events = scaled(system, x0, orientation, asked, events)
    with unit_of_times(model):
        asked |= {"events": checked_events(events)}  # no plan with events is kept
        plan, idle = idle_or_new(make_plan, model, x0, orientation, asked, kept=path is None)
        warn_of(plan)
        result = _in_memory(plan, progress, idle) if path is None else _on_disk(plan, path, overwrite, progress)
    return doubted(system, presented(watched(result, loaded=path is None), plan.model))


def doubted(system: Model | Body | None, run: xr.Dataset) -> xr.Dataset:
    """The run itself.  Warns with `AccuracyWarning` of rows for which the model of its bodies does not hold."""
    bodies: Any = getattr(system, "bodies", (system,))
    for sentence in bodies[0]._doubts_of(bodies, run) if isinstance(system, Body) else ():
        doubt(sentence, AccuracyWarning)
    return run


def _in_memory(plan: Plan, progress: bool | None, idle: deque[Plan]) -> xr.Dataset:
    from kreisel.runs.describing import in_memory

    need = plan.rows * plan.first.size * 8 * 4
    if need >= ALWAYS_THERE:
        import psutil

        if need > 0.7 * psutil.virtual_memory().total:
            raise InputError(
                f"{plan.rows:,} saved rows would need about {need / 2**30:.1f} GiB of memory. "
                "Give path='run.zarr' to write them to disk during the run, or save less often with every=..."
            )
    warn_of_arrays(plan)
    with Progress(plan.steps * plan.lanes, progress) as bar:
        run = in_memory(plan, list(Integration(plan, bar.advance).blocks()))
    if plan.repeatable:
        idle.append(plan)
    return run


def _on_disk(plan: Plan, path: str | os.PathLike[str], overwrite: bool, progress: bool | None) -> xr.Dataset:
    from kreisel.storage.archive import new_target, one_writer
    from kreisel.storage.run_archive import RunArchive

    where = new_target(path)
    require_room(where, bytes_of(plan)[1], "Save less often (every), or choose another disk.")
    integration = Integration(plan)  # compiled before anything is created there
    warn_of_arrays(plan)
    with one_writer(where):
        return _write(RunArchive(where, plan, overwrite), integration, progress)


@explained
def resume(
    path: str | os.PathLike[str],
    *,
    extend: Any = None,
    progress: bool | None = None,
    system: Model | Body | None = None,
    events: Event | Sequence[Event] = (),
) -> xr.Dataset:
    """Resume an interrupted run, bit for bit as if it had not been interrupted; or extend a finished run.

    path      the archive, NAME or NAME.part
    extend    the run's new number of steps, more than before: a finished run continues to it; of a body also the new
              end, "2 h"
    progress  as in `simulate`
    system    a user-defined system (`kr.perturbed`), or a body with user-defined forces or a controller, which no
              archive holds: with the functions of the run
    events    the events of the run, which no archive holds either: with the functions of the run

    The parameters, the start, the method and the state of its engine come from the archive.  The same bits are promised
    for the same versions on the same machine; if versions have changed, the attribute `resumed` states this.  Raises
    `InputError` if there is no checkpoint, and `RunError` as `simulate` does.
    """
    from kreisel.storage.archive import one_writer, part_of, target
    from kreisel.storage.opening import open_rows, run_record
    from kreisel.storage.run_archive import reopen

    model, where = model_of(system), target(path)
    where = where.with_suffix("") if where.suffix == ".part" else where
    with one_writer(where) as settled:
        if settled and extend is None:  # nothing else remained to be done
            return presented(open_rows(where))
        record = run_record(part_of(where) if stands(part_of(where)) and not stands(where) else where)
        frame = record.body_frame
        if frame.names:
            end, events = extend, scaled_events(frame, events)
            extend = steps_in(frame, end, record.dt, "extend")
            if extend is not end:  # a time
                extend -= round((record.t_start or 0.0) / record.dt)
        archive, integration = reopen(where, None if extend is None else within(extend, "extend"), model, events)
        end = ((record.t_start or 0.0) + integration.plan.steps * record.dt) * frame.time_unit
        held = integration.plan.model
        for sentence in system._doubts(end) if isinstance(system, Body) else doubts_of_end(held, end):
            doubt(sentence)
        return doubted(system, presented(watched(_write(archive, integration, progress)), integration.plan.model))


def _write(archive: RunArchive, integration: Integration, progress: bool | None) -> xr.Dataset:
    from kreisel.storage.opening import open_rows

    plan, last, kept = integration.plan, -math.inf, integration.steps

    def between() -> None:
        nonlocal last, kept
        due = time.monotonic() - last > CHECKPOINT_SECONDS or stop.signal is not None
        written = integration.filled == 0  # a block has just been written
        closing = integration.rows == integration.lasting  # the last checkpoint, from which a longer run resumes
        if integration.into == 0 if closing else integration.rows < integration.lasting and (due or written):
            archive.checkpoint(integration.snapshot())
            last, kept = time.monotonic(), integration.steps
        obey()

    def obey() -> None:
        if stop.signal is not None:
            name = str(archive.part).removesuffix(".part")
            raise Stopped(stop.signal, f"{kept:,} steps", archive.part, f"`kreisel resume {name}`")

    with (
        signals_wait() as stop,
        archive,
        Progress(plan.steps * plan.lanes, progress, integration.steps * plan.lanes) as bar,
    ):
        integration.tick, integration.inside = bar.advance, obey
        for block in integration.blocks(between):
            archive.append(block, integration.flushed)
        archive.finish()
    return open_rows(archive.path)
