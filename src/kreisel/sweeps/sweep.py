"""kr.sweep: an ensemble over parameters and initial states, on Dask, in blocks that can be lost and computed again."""

from __future__ import annotations

import hashlib
import inspect
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import xarray as xr

from kreisel.errors import InputError, Stopped, explained, shown
from kreisel.files import shallow
from kreisel.process import signals_wait
from kreisel.record.body import Body, as_body
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.runs.in_si import scaled
from kreisel.runs.orbits import presented
from kreisel.runs.progress import Progress
from kreisel.runs.settings import check_model, checked_state, flag, with_steps
from kreisel.storage.archive import one_writer, target
from kreisel.storage.opening import SweepRecord, open_lanes
from kreisel.sweeps.design import Design, Lanes, described
from kreisel.sweeps.ensemble import TRAJECTORIES, Sweep, by_lane, of_scaled_system, user_defined
from kreisel.sweeps.grids import gridded
from kreisel.sweeps.lanes import watched_lanes
from kreisel.sweeps.store import Store, failed_lanes
from kreisel.sweeps.workers import check_workers, computed, pool

if TYPE_CHECKING:
    from kreisel.record.model import OrientationLike, StateLike

SAVED = ("drift", "extremes", "frequencies", TRAJECTORIES)
DEFAULT_SAVE = ("drift", "extremes")
MEMORY_MIB = 256  # MiB of arrays in a worker, in addition to Python and its libraries


@dataclass
class Report:
    """The result of a sweep: the lanes of all blocks, failed lanes, the blocks of this call, and their cost."""

    path: Path
    lanes: int
    blocks: int
    before: int
    failed: int = 0
    seconds: float = 0.0
    memory_MiB: float = 0.0


@explained
def sweep(
    system: Model | Body,
    x0: StateLike | None = None,
    design: Design | None = None,
    *,
    over: Mapping[str, Any] | None = None,
    dt: Any = None,
    steps: int | None = None,
    t_end: Any = None,
    t_start: Any = None,
    path: str | os.PathLike[str],
    every: Any = None,
    method: str | None = None,
    order: int | str | tuple[int, ...] | None = None,
    tol: float | None = None,
    orientation: OrientationLike | None = None,
    project: bool = True,
    impulses: Mapping[str, Any] | Sequence[Mapping[str, Any]] = (),
    save: Sequence[str] = DEFAULT_SAVE,
    block: int | None = None,
    memory: int = MEMORY_MIB,
    workers: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
) -> xr.Dataset:
    """Simulate many lanes that differ in parameters, initial states or settings, and return a Dataset.

    Its dimensions are the quantities of the grid, with their values as coordinates, then `list` and `draw`; `lane` is
    the index of each lane in the store.  Without a grid the dimension is `lane`, as in `kr.open_run(path)`.

    system, x0   common start of all lanes; arguments dt to impulses as for `kr.simulate`, every=1 if there is a dt
    design       the varied quantities, a `kr.Design`
    over         of a body of `kr.physical`: values by name, {"mass": ["1 kg", "2 kg"], "spin": [...]}, whose grid is
                 computed: values of the body, arguments of `body.state`, variables of a run such as "momentum[0]"
    path         the Zarr store; the same call resumes an interrupted sweep
    save         any of "drift", "extremes", "frequencies" and "trajectories"
    block        lanes in a block; by default from the memory, the steps and the lanes
    memory       MiB of arrays in a worker, plus about 300 for Python and its libraries
    workers      processes on this machine, by default one per core; 0: this process, without Dask
    scheduler    the address of a Dask scheduler instead, whose workers see the same files

    A lane that fails has failed = 1, a message, and NaN.  The store is bit for bit the same for any number of workers.
    Raises `InputError` for bad input, `RunError` if the sweep has to stop: finished blocks are kept.
    """
    flag(overwrite, "overwrite")
    body = as_body(system)
    design = _design(body, over, design)
    spec = {**design.table, "save": save, "block": block, "memory": memory}
    run = {"dt": dt, "every": every, "impulses": impulses, "steps": steps, "method": method, "order": order, "tol": tol}
    run |= {"project": project, "t_end": t_end, "t_start": t_start}
    if body is not None and not of_scaled_system(body.model(), spec):
        description, model = by_lane(body, x0, {**run, "orientation": orientation}, spec, body._varied)
    else:
        description, model = _of_system(system, x0, orientation, run, spec)
    source = user_defined(model, description)
    options: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "overwrite": overwrite, "progress": progress}
    report = carry_out(description, target(path), source=source, **options)
    return gridded(presented(watched_lanes(open_lanes(report.path), source)))


def _design(body: Body | None, over: Any, design: Any) -> Design:
    if over is None and isinstance(design, Design):
        return design
    if over is None:
        raise InputError(f"design: expected a kr.Design, such as kr.Design(grid={{...}}), got {shown(design)}.")
    if body is None or design is not None or not isinstance(over, Mapping) or not all(isinstance(k, str) for k in over):
        raise InputError(
            f"over: expected a body of kr.physical, and a dict of names and values without a design, got {shown(over)}."
        )
    sections = {name: "state" for name in (*inspect.signature(body.state).parameters, *body.words.values())}
    sections |= dict.fromkeys(("dt", "steps", "t_end", "method", "order"), "run")
    return Design(grid={f"{sections.get(k.partition('[')[0], 'body')}.{k}": v for k, v in over.items()})


def _of_system(
    system: Any, x0: Any, orientation: Any, run: dict[str, Any], spec: dict[str, Any]
) -> tuple[dict[str, Any], Model]:
    """The sections of a sweep that begins from a model, and the model."""
    from kreisel.bodies import KNOWN

    model, x0, orientation, run, _ = scaled(system, x0, orientation, run)
    check_model(model)
    if KNOWN.get(model.system.name, model.system) != model.system:
        raise InputError(f"{model.system.name} is the name of a system of Kreisel. Choose another name for this one.")
    frame, derived = model.body_frame, Model(model.system, model.params).body_frame
    state = dict(checked_state(model, x0).axial) | ({} if orientation is None else {"orientation": orientation})
    sections = {"system": {"name": model.system.name, **model.params}, "state": state, "run": run, "sweep": spec}
    return ({"body": frame.table, **sections} if frame.table != derived.table else sections), model


def carry_out(
    description: Mapping[str, Any],
    path: Path,
    *,
    source: Path | System | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
) -> Report:
    """Compute a sweep, or resume it, from its description; `source`: a user-defined system, or its file."""
    begun = time.perf_counter()
    plain = _checked_description(described(shallow(description, "The description of the sweep")), source)
    check_workers(workers, scheduler)
    store = Store(path, Sweep(plain, source))
    with one_writer(path):
        todo = store.open(overwrite)
        report = Report(path, store.sweep.lanes.total, store.blocks, store.blocks - len(todo))
        if todo:
            with (
                signals_wait() as stop,
                pool(workers, scheduler, progress) as hands,
                Progress(report.lanes, progress, store.lanes_done(todo), "lanes") as bar,
            ):
                code = source.absolute() if isinstance(source, Path) else source
                for counts in computed(hands, str(store.part.absolute()), code, store.digest, todo, stop):
                    report.memory_MiB = max(report.memory_MiB, counts["memory_MiB"])
                    bar.advance(counts["lanes"])
            if stop.signal is not None:
                kept = store.blocks - len(store.missing())
                done = f"{kept:,} of {store.blocks:,} blocks"
                raise Stopped(stop.signal, done, store.part, "the same command")
        if store.part.exists():
            store.finish()
        report.failed = SweepRecord.of_store(path).failed_lanes or 0
        report.seconds = time.perf_counter() - begun
        return report


def _checked_description(description: dict[str, Any], source: Path | System | None) -> dict[str, Any]:
    spec = {k: v for k, v in description["sweep"].items() if v is not None}
    saved = spec.setdefault("save", [*DEFAULT_SAVE])
    if not isinstance(saved, list) or not saved or any(kind not in SAVED for kind in saved):
        raise InputError(f"save in [sweep] must list some of {', '.join(SAVED)}, got {shown(saved)}.")
    spec["save"] = [kind for kind in SAVED if kind in saved]
    memory = spec.setdefault("memory", MEMORY_MIB)
    for name, value in (("memory", memory), ("block", spec.get("block", 1))):
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 10**7:
            raise InputError(f"{name} in [sweep] must be an integer, 1 or more, got {shown(value)}.")
    run = {k: v for k, v in description["run"].items() if v is not None}
    if "t_end" in run:
        if any(q.name in ("run.dt", "run.steps", "run.t_end") for q in Lanes(description, spec).quantities):
            raise InputError("t_end: expected the same steps in all lanes, got a dt or steps that varies. Give steps.")
        run = {k: v for k, v in with_steps(run).items() if k not in ("asked_dt", "t_end")}
    out = {**description, "run": run, "sweep": spec}
    if isinstance(source, Path):
        out["file"] = hashlib.sha256(source.read_bytes()).hexdigest() if source.is_file() else ""
    return out


@explained
def failures(run: xr.Dataset) -> pd.DataFrame:
    """The failed lanes of a sweep: a row for each, with its message and its values of the varied quantities."""
    if "failed" not in getattr(run, "variables", ()):
        raise InputError("kr.failures needs the result of kr.sweep; these are not lanes of a sweep.")
    from kreisel.sweeps.grids import by_lane

    run = by_lane(run)
    failed = list(failed_lanes(run))
    ids = [lane for lane, _ in failed]
    table = pd.DataFrame({"message": [why for _, why in failed]}, index=pd.Index(ids, name="lane"))
    for name, variable in run.variables.items():
        if variable.attrs.get("kind") == "input" and variable.ndim == 1:
            table[name] = variable.values[ids]
    return table
