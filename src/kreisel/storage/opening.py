"""Archives opened: their whole part, as a dataset that is read lazily."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.errors import InputError, explained
from kreisel.files import read_values
from kreisel.kernels.layout import Floats
from kreisel.method.observing import ORIENTATION
from kreisel.method.scheme import KINDS
from kreisel.record.model import Model
from kreisel.runs.describing import body_of, hash_of_start, in_memory, parameters_of, saved_times
from kreisel.runs.integration import Integration, Snapshot
from kreisel.runs.operations import require_operations
from kreisel.runs.plan import TIMES, Plan
from kreisel.runs.planning import plan_of
from kreisel.runs.run_record import FORMAT, RunRecord
from kreisel.runs.settings import Settings, check_model
from kreisel.storage import checkpoint, manifest
from kreisel.storage.nodes import (
    LARGEST_CHUNK,
    array_lengths,
    dataset,
    is_sweep,
    metadata,
    require_sound,
    target,
    too_large,
)
from kreisel.storage.replacing import settled

if TYPE_CHECKING:
    import xarray as xr

NEEDED = {  # attributes and their types
    **dict.fromkeys(("title", "system", "parameters", "start_sha256", "method", "options"), str),
    **dict.fromkeys(("n", "steps", "every", "rows_in_block", "projection"), int),
    **{"dt": float, "complete": int},
}
MOST_INDEXED = 10**7  # times that are held in memory


@explained
def open_run(path: str | os.PathLike[str], *, grid: bool = False) -> xr.Dataset:
    """Open a run on disk lazily, as `kr.simulate` returns it, or a sweep; of an interrupted one the part that is done.

    A sweep has the dimension `lane`, with `grid` those of its grid, as `kr.sweep` returns it.

    Every file is compared with its SHA-256 when it is read.  Raises `InputError` for what is not an archive of
    Kreisel, and for a damaged one, as it is opened or later as it is read (`kreisel check` says what is damaged).
    """
    where = settled(target(path))
    if is_sweep(where):
        from kreisel.sweeps.sweep import open_sweep

        if grid:
            from kreisel.sweeps.grids import gridded

            return gridded(open_sweep(where))
        return open_sweep(where)
    return open_archive(where)


def archive_record(store: Path) -> RunRecord:
    """What an archive says that its run is, checked.  Raises `InputError` for what is not one."""
    attrs = metadata(store)
    if "kreisel_sweep" in attrs:
        raise InputError(f"{store} is a sweep: `kreisel check` reads it, and kr.open_run opens it by lane.")
    if attrs.get("kreisel_format") != FORMAT:
        raise InputError(f"{store} is not an archive of Kreisel (no kreisel_format = {FORMAT} among its attributes).")
    missing = [key for key in NEEDED if key not in attrs]
    wrong = [key for key, kind in NEEDED.items() if key not in missing and not isinstance(attrs[key], kind)]
    wrong += [key for key in ("steps", "every", "n", "rows_in_block") if key not in missing + wrong and attrs[key] < 1]
    if missing or wrong:
        fault = f"lack {', '.join(missing)}" if missing else f"are wrong in {', '.join(wrong)}"
        raise InputError(f"{store} is damaged: its attributes {fault}. Make it again from its TOML file.")
    return RunRecord.from_attrs(attrs)


def open_archive(path: Path, indexed: bool = True) -> xr.Dataset:
    """Open a run on disk lazily; of an interrupted one all rows until its last checkpoint.

    With `indexed` the times are read, if there are less than ten million, so that rows can be chosen by time.  Raises
    `InputError` for what is not a Kreisel archive, and for a damaged one, here or when the damage is read.
    """
    record = archive_record(path)
    require_sound(path)
    run = _until_checkpoint(path, record) if is_cut(path, record) else opened(path, manifest.read(path), True)
    for name, variable in run.data_vars.items():
        if variable.attrs.get("kind") in KINDS and variable.dims[:1] != ("time",):
            raise InputError(f"{path} is damaged: {name} has no axis of time. `kreisel check {path}`.")
    if indexed and too_large(run):
        raise InputError(f"{path} is damaged: {'; '.join(too_large(run))}.")
    for name in ("time", "lane"):
        known_place = name in run.dims and name in run.variables and run.sizes[name] <= MOST_INDEXED
        if indexed and known_place and name not in run.xindexes:
            try:
                run = _indexed(run, name)
            except Exception as error:  # whatever a damaged chunk makes the libraries raise
                raise InputError(f"{path} is damaged, {name} cannot be read: {error}") from error
    return ordered(run)


def _indexed(run: xr.Dataset, name: str) -> xr.Dataset:
    """The same as `set_xindex`, which asks of each coordinate whether it is Dask's or Pint's: that imports both."""
    import pandas as pd
    import xarray as xr

    variable = run.variables[name]
    index = xr.indexes.PandasIndex(pd.Index(read_values(variable), name=name), name)
    made = index.create_variables({name: variable})
    return run.assign_coords(xr.Coordinates(made, {name: index}))


def ordered(run: xr.Dataset) -> xr.Dataset:
    """States first, then the orientation, Casimirs and integrals."""
    return run[sorted(run.data_vars, key=lambda name: (_place_in_run(run[name]), str(name)))]


def is_cut(store: Path, record: RunRecord) -> bool:
    """Whether a run was interrupted, by its record and its manifest; a recovered archive counts as whole."""
    unsealed = manifest.begun(store) and not manifest.whole(store)
    return record.recovered is None and (unsealed or not record.complete)


def opened(path: Path, known: manifest.Listed | None, every_array: bool = False) -> xr.Dataset:
    """The arrays of a store as they are, each file compared with the manifest when it is read, if there is one.

    With `every_array` those that are listed must be there.  Raises `InputError`.
    """
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel
    from kreisel.storage.verified import verified

    store: Any = path if known is None else verified(path, known, every_array)
    lengths, options = array_lengths(path), {"create_default_indexes": False}
    if len(set(lengths.values())) < 2:
        return dataset(path, store, **options)
    parts = [dataset(path, store, drop_variables=set(lengths) - {name}, **options) for name in lengths]
    return xr.merge([part.isel(time=slice(0, min(lengths.values()))) for part in parts], combine_attrs="override")


def _until_checkpoint(path: Path, record: RunRecord) -> xr.Dataset:
    """The finished blocks of an interrupted run, and the rows after them, which only its checkpoint has."""
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel
    from kreisel.storage.continued import continued

    attrs = {**metadata(path), "complete": 0}
    snapshot, start, known = _checkpoint(path, record)
    first = snapshot.flushed
    whole = opened(path, known, True).isel(time=slice(0, first)) if first else xr.Dataset(attrs=attrs)
    if len(snapshot.rows) == 0:
        return whole.assign_attrs(attrs)
    plan = None if record.is_own else _plan_of_run(record, start, record.steps)
    rest = _shown(path, snapshot) if plan is None else _observed(plan, record, snapshot)
    if not first:
        return rest.assign_attrs(attrs)
    if plan is not None:
        _require_arrays(path, plan, record, known)
    joined = {
        name: continued(variable, rest[name].variable) if "time" in variable.dims else variable
        for name, variable in whole.variables.items()
        if name in rest.variables
    }
    coords = {name: joined.pop(name) for name in whole.coords if name in joined}
    return xr.Dataset(joined, xr.Coordinates(coords, indexes={}), attrs)


def _observed(plan: Plan, record: RunRecord, snapshot: Snapshot) -> xr.Dataset:
    """The rows of a snapshot, of a system that Kreisel has."""
    _integration(plan, record.rows_in_block).restore(snapshot)  # which looks at it
    times = saved_times(plan, snapshot.flushed, snapshot.flushed + len(snapshot.rows))
    return in_memory(plan, [plan.observe(snapshot.rows)], times)


def _shown(path: Path, snapshot: Snapshot) -> xr.Dataset:
    """The rows of a snapshot, of a system that an archive does not hold.  Raises `InputError`."""
    import xarray as xr

    try:
        return xr.Dataset(snapshot.shown).set_coords(["time", *({"lane"} & snapshot.shown.keys())])
    except (ValueError, TypeError) as error:
        raise InputError(f"The checkpoint of {path} is damaged: {error}.") from error


def _place_in_run(variable: xr.DataArray) -> int:
    """States first, then the orientation, Casimirs, integrals, and what a user has added."""
    order, kind = ("state", "orientation", *KINDS), variable.attrs.get("kind")
    return order.index(kind) if kind in order else len(order)


def _checkpoint(store: Path, record: RunRecord) -> tuple[Snapshot, dict[str, Floats], manifest.Listed]:
    """The checkpoint of a store, and its manifest.  Raises `InputError` where one is damaged, or of another run."""
    from kreisel.storage.verified import Verified

    snapshot, start = checkpoint.read(store)
    known = manifest.read(store)
    for name in ("zarr.json", *({checkpoint.NAME} & known.keys())):
        Verified(store, known).verify(name)
    if hash_of_start(start) != record.start_sha256 or snapshot.flushed % record.rows_in_block:
        raise InputError(f"The checkpoint of {store} is not that of its run. Run it again from its TOML file.")
    return snapshot, start, known


def _integration(plan: Plan, rows_in_block: int) -> Integration:
    if rows_in_block * plan.first.nbytes > LARGEST_CHUNK:
        raise InputError(f"The attribute rows_in_block = {rows_in_block:,} is damaged: no run has such blocks.")
    return Integration(plan, rows_in_block=rows_in_block)


def _require_arrays(store: Path, plan: Plan, record: RunRecord, known: manifest.Listed) -> None:
    """Raises `InputError` where a store that is to be written to has not the arrays of its run."""
    run = opened(store, known)
    outputs = {"time": np.zeros(1), **plan.example}
    for name, value in outputs.items():
        variable = run.variables.get(name)
        good = variable is not None and variable.dtype == np.float64 and variable.shape[1:] == value.shape[1:]
        whole = None if variable is None else variable.encoding.get("shards") or variable.encoding["chunks"]
        if not good or whole != (record.rows_in_block, *value.shape[1:]):
            raise InputError(f"{store} is damaged: {name} is not as the run made it. `kreisel check {store}`.")


def _plan_of_run(record: RunRecord, start: Mapping[str, Floats], steps: int, system: Model | None = None) -> Plan:
    """The plan of a run from its record and its start; `system`: of a system of the user's own."""
    asked = Settings.checked(
        dt=record.dt,
        steps=steps,
        every=record.every,
        method=record.method,
        order=record.order,
        tol=record.tolerance,
        engine=record.engine,
        project=record.projection > 0,
        observe=record.observed,
        times=None if TIMES not in start else start[TIMES],
        impulses=record.struck,
    )
    state = {letter: value for letter, value in start.items() if letter not in (ORIENTATION, TIMES)}
    model = record.model if system is None else _same(system, record)
    return plan_of(model, state, asked, start.get(ORIENTATION))


def _same(model: Model, record: RunRecord) -> Model:
    """The model, if a run was made from one of its name and parameters.  Raises `InputError`."""
    check_model(model)
    if model.system.name != record.system or parameters_of(model) != record.parameters:
        raise InputError(
            f"system: expected {record.system} with the parameters {record.parameters} of the run, got {model!r}."
        )
    if body_of(model) != record.body:
        raise InputError(
            f"system: expected the body of the run, with the axes and units {record.body}, got {body_of(model)}. Usual "
            "cause: a model of another body, or one by its parameters alone."
        )
    require_operations(model, record.system_sha256)
    return model
