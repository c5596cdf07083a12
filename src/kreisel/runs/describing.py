"""Runs as datasets: dimensions, attributes, times, and the model that the attributes describe."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.files import read_values
from kreisel.graph.machine import processor
from kreisel.kernels.layout import Floats
from kreisel.method import find
from kreisel.record.model import Model
from kreisel.record.table import text_of
from kreisel.runs.drift import roundoff_scales
from kreisel.runs.integration import block_rows
from kreisel.runs.operations import events_of, operations_of
from kreisel.runs.plan import Plan
from kreisel.runs.run_record import RunRecord

if TYPE_CHECKING:
    import xarray as xr

MOST_EVENTS = 10_000  # in an attribute
CORRECTION = "largest_correction"  # correction of the state by the projection, in units of eps_machine |state|
FEW_TIMES = 1000  # for a run whose form is kept for the next run


def dimensions(plan: Plan, name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Dimension names of an output of that shape."""
    lead = ("time", "lane") if plan.batched else ("time",)
    outcome = plan.outcomes[name]
    if outcome.axes:
        return (*lead, *(label.format(name) for label in algebra.KINDS[outcome.axes].shown(plan.model.n).labels))
    return (*lead, *((f"{name}_part",) if len(shape) > len(lead) else ()))


@cache
def versions() -> dict[str, str]:
    """Versions of the software that computed a run, and the kind of processor for which kernels are compiled."""
    packages = ("kreisel", "numpy", "llvmlite", "scipy", "mpmath", "xarray", "zarr")
    out = {"python": platform.python_version(), "processor": processor()[1]}
    return out | {p: importlib.metadata.version(p) for p in packages}


def describe(plan: Plan) -> RunRecord:
    """The attributes of a run: everything needed to identify and repeat it."""
    model, settings, end = plan.model, plan.settings, plan.end
    key = __name__, plan.scheme.definition_key or (model.key, plan.scheme.name)
    return RunRecord.of_values(
        **reused(key, lambda: _subject(model, plan.scheme.name)),
        body=body_of(model),
        start_sha256=hash_of_start(plan.start),
        options=json.dumps(dict(plan.scheme.options)),
        observe=None if settings.observe is None else json.dumps(settings.observe),
        engine=plan.where,
        projection=plan.engine.projection.every if plan.engine.projection else 0,
        dt=plan.dt,
        asked_dt=settings.asked_dt,
        t_start=settings.t_start or None,
        steps=plan.steps,
        every=plan.every,
        rows=None if settings.times is None and end is None else plan.rows,
        stopped=None if end is None else end[1],
        impulses=json.dumps(settings.impulses) if settings.impulses else None,
        events=json.dumps(events_of(plan)) if plan.events else None,
        event_times=_event_times(plan),
        rows_in_block=block_rows(plan),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _subject(model: Model, method: str) -> dict[str, Any]:
    """The attributes that depend only on the model and the method."""
    system = model.system
    return {
        "title": f"{system.title}: {method}",
        "source": f"kreisel {versions()['kreisel']}",
        "references": find(method).references(system),
        "system": system.name,
        "system_sha256": operations_of(model),
        "equations": system.equations,
        "components": json.dumps(dict(system.space.components)),
        "frame": system.frame.value,
        "bracket": "plus" if system.space.sign > 0 else "minus",
        "n": model.n,
        "parameters": parameters_of(model),
        "fixed": _fixed_of(model),
        "method": method,
        "versions": json.dumps(versions()),
    }


def _fixed_of(model: Model) -> str | None:
    """Where parameters of a user-defined system are at rest: of Kreisel's systems the record states it."""
    places = {p.letter: p.fixed for p in model.system.parameters if p.fixed}
    return json.dumps(places) if places and operations_of(model) else None


def hash_of_start(start: Mapping[str, Floats]) -> str:
    """SHA-256 of the initial state, which binds a checkpoint to the attributes of its run."""
    digest = hashlib.sha256()
    for name, value in sorted(start.items()):
        array = np.ascontiguousarray(value, dtype="<f8")
        digest.update(f"{name} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()


def _event_times(plan: Plan) -> str | None:
    return json.dumps(plan.fired[:MOST_EVENTS]) if plan.events else None


def at_the_end(plan: Plan) -> dict[str, Any]:
    """The attributes of an archive that are known at the end of its run."""
    ends = {"rows": plan.rows, "stopped": plan.end[1]} if plan.end else {}
    return {"complete": 1, **ends, **({"event_times": _event_times(plan)} if plan.events else {})}


def parameters_of(model: Model) -> str:
    """The parameters of a model in the form that a run stores."""
    kinds = {p.letter: p.kind for p in model.system.parameters}
    return json.dumps({k: text_of(v) if kinds[k] == "table" else v.tolist() for k, v in model.params.items()})


def body_of(model: Model) -> str | None:
    """Axes and units of the body from which a model was created, in the form that a run stores."""
    return json.dumps(model.body_frame.table) if model.body_frame else None


def attributes(plan: Plan, first: Mapping[str, Array]) -> dict[str, dict[str, Any]]:
    """Attributes of every variable, from the plan and the first block of a run."""
    with np.errstate(all="ignore"):  # of integrals near the range of doubles
        rows = np.arange(len(next(iter(first.values()))), dtype=np.float64)
        scales = roundoff_scales(plan, first, plan.times_of(rows))
    frame = plan.model.body_frame
    out: dict[str, dict[str, Any]] = {}
    for name, outcome in plan.outcomes.items():
        out[name] = {"long_name": outcome.meaning, "kind": outcome.kind, "units": "1"}
        out[name] |= frame.attributes(name) if frame else {}
        if name in scales:
            out[name] |= {"conserved": int(outcome.conserved), **scales[name]}
    return out


def saved_times(plan: Plan, first: int = 0, stop: int | None = None) -> Floats:
    """Times of the saved rows first to stop - 1."""
    rows = np.arange(first, plan.rows if stop is None else stop, dtype=np.float64)
    return plan.times_of(rows)


def time_attributes(plan: Plan) -> dict[str, str]:
    """Attributes of the times of a run."""
    return {"long_name": "time", "units": "1", "axis": "T"} | plan.model.body_frame.attributes("time")


def in_memory(plan: Plan, blocks: list[dict[str, Array]], times: Floats | None = None) -> xr.Dataset:
    """Blocks of outputs as a Dataset, at times of saved steps, at other times, or at one time without an axis."""
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel

    attrs = attributes(plan, blocks[0])
    for name, largest in largest_corrections(plan).items():
        attrs[name][CORRECTION] = largest
    when = saved_times(plan) if times is None else times
    variables = {}
    for name in plan.outcomes:
        value = np.concatenate([block.pop(name) for block in blocks]) if blocks[1:] else blocks[0].pop(name)
        if not (value.flags.c_contiguous and value.flags.writeable and value.flags.owndata):
            value = value.copy()
        dims = dimensions(plan, name, value.shape)
        dims, value = (dims, value) if when.ndim else (dims[1:], value[0, ...])
        variables[name] = xr.Variable(dims, value, attrs[name], fastpath=True)
    coordinates = _known_coordinates if when.size <= FEW_TIMES else _known_coordinates.__wrapped__
    coords = coordinates(when.tobytes() if when.ndim else None, plan.lanes if plan.batched else None)
    run = _assembled(variables, None if when.ndim else xr.Variable((), np.asarray(when), fastpath=True), coords)
    run.variables["time"].attrs = time_attributes(plan)
    run.attrs = describe(plan).to_attrs()
    return run


@lru_cache(16)
def _known_coordinates(times: bytes | None, lanes: int | None) -> xr.Dataset:
    """The coordinates of a run, without its time if it has only one."""
    import xarray as xr

    coords: dict[str, Array] = {} if times is None else {"time": np.frombuffer(times).copy()}
    coords |= {} if lanes is None else {"lane": np.arange(lanes)}
    return with_indexes(xr.Dataset(), *(xr.Variable((name,), x, fastpath=True) for name, x in coords.items()))


def with_indexes(run: xr.Dataset, *variables: xr.Variable) -> xr.Dataset:
    """The Dataset with these coordinates, an index of each."""
    import pandas as pd
    import xarray as xr

    for variable in variables:
        (name,) = variable.dims
        index = xr.indexes.PandasIndex(pd.Index(read_values(variable), name=name), name)
        # xarray's own ways would import Dask and Pint, to ask whether coordinates are theirs: 0.7 of 1.8 s of a run
        run = run.assign_coords(xr.Coordinates(index.create_variables({name: variable}), {name: index}))
    return run


def _assembled(variables: dict[str, xr.Variable], time: xr.Variable | None, coords: xr.Dataset) -> xr.Dataset:
    """A Dataset with these variables and coordinates, without copies: xarray's `assign` needs 0.15 ms, this 0.01."""
    import xarray as xr

    coordinates = {str(name): v.copy(deep=False) for name, v in coords.variables.items()}
    coordinates |= {} if time is None else {"time": time}
    every = variables | coordinates
    sizes = {d: size for v in every.values() for d, size in zip(v.dims, v.shape, strict=True)}
    indexes = dict(coords.xindexes)
    return xr.Dataset._construct_direct(
        variables=every, coord_names={*coordinates}, dims=sizes, attrs={}, indexes=indexes
    )


def largest_corrections(plan: Plan) -> dict[str, float]:
    """The largest correction of each variable by the projection so far."""
    result = plan.engine.projection.largest(plan.engine.z) if plan.engine.projection else {}
    return {name: largest for name, largest in result.items() if name in plan.outcomes}
