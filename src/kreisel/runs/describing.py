"""Runs as datasets: dimensions, attributes, times, and the model that the attributes describe."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.kernels import layout
from kreisel.kernels.layout import MACHINE_EPSILON, Floats
from kreisel.record.model import Model
from kreisel.runs.drift import KINDS
from kreisel.runs.integration import block_rows
from kreisel.runs.plan import Plan
from kreisel.runs.run_record import RunRecord
from kreisel.storage import checkpoint

if TYPE_CHECKING:
    import xarray as xr

MOST_EVENTS = 10_000  # in an attribute
MOST_SCALES = 4096  # numbers in an attribute
MANY_SAMPLES_N = 16  # beyond, there are fewer
MANY_LANES = 4096  # beyond, there are fewer: the largest over the lanes counts
SAMPLES = 16  # perturbations of a state that measure how an integral feels them
NUDGE, HAIR = 1e-6, 1e-12  # relative: far above round-off, and so small that only noise is left


def dimensions(plan: Plan, name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Dimension names of an output of that shape."""
    lead = ("time", "lane") if plan.batched else ("time",)
    outcome = plan.outcomes[name]
    rest = len(shape) - len(lead)
    if outcome.axes == "quaternion":
        return (*lead, "quaternion")
    if outcome.axes.startswith("R^"):
        return (*lead, f"{name}_axis")
    if outcome.axes:
        return (*lead, *(("axis",) if rest == 1 else ("row", "column")))
    return (*lead, *((f"{name}_part",) if rest else ()))


@cache
def versions() -> dict[str, str]:
    """Versions of what computed a run, and the kind of processor that kernels are compiled for."""
    import platform

    import llvmlite.binding as llvm
    from numba import config

    packages = ("kreisel", "numpy", "numba", "scipy", "mpmath", "xarray", "zarr")
    out = {
        "python": platform.python_version(),
        "processor": getattr(config, "CPU_NAME", None) or llvm.get_host_cpu_name(),
    }
    return out | {p: importlib.metadata.version(p) for p in packages}


def describe(plan: Plan) -> RunRecord:
    """What a run is: everything needed to know it and to repeat it."""
    model, system, observe = plan.model, plan.model.system, plan.settings.observe
    return RunRecord(
        title=f"{system.title}: {plan.scheme.name}",
        source=f"kreisel {versions()['kreisel']}",
        references=system.source + (f"; {system.map.source}" if system.map else ""),
        system=system.name,
        equations=system.equations,
        components=json.dumps(dict(system.space.components)),
        frame=system.frame.value,
        bracket="plus" if system.space.sign > 0 else "minus",
        n=model.n,
        parameters=parameters_of(model),
        start_sha256=checkpoint.hash_of_start(plan.start),
        method=plan.scheme.name,
        options=json.dumps(dict(plan.scheme.options)),
        observe=None if observe is None else json.dumps(observe),
        engine=plan.where,
        projection=plan.engine.projection.every if plan.engine.projection else 0,
        dt=plan.dt,
        steps=plan.steps,
        every=plan.every,
        rows=None if plan.settings.times is None and plan.timetable.end is None else plan.rows,
        stopped=None if plan.timetable.end is None else plan.timetable.end[1],
        impulses=json.dumps(plan.settings.impulses) if plan.settings.impulses else None,
        events=json.dumps([event.name for event in plan.events]) if plan.events else None,
        event_times=_event_times(plan),
        rows_in_block=block_rows(plan),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=json.dumps(versions()),
    )


def _event_times(plan: Plan) -> str | None:
    """When which events happened, the first ones, or None without events."""
    return json.dumps(plan.fired[:MOST_EVENTS]) if plan.events else None


def at_the_end(plan: Plan) -> dict[str, Any]:
    """The attributes of an archive that are known at the end of its run."""
    made = {"rows": plan.rows, "stopped": plan.timetable.end[1]} if plan.timetable.end else {}
    return {"complete": True, **made, **({"event_times": _event_times(plan)} if plan.events else {})}


def parameters_of(model: Model) -> str:
    """The parameters of a model as a run has them."""
    return json.dumps({k: v.tolist() for k, v in model.params.items()})


def roundoff_scales(plan: Plan, first: Mapping[str, Array]) -> dict[str, dict[str, list[float]]]:
    """How much rounding errors change each Casimir and integral, in units of eps_machine.

    roundoff_scale    in one step.  Every coordinate of a component is moved by the component's largest one, with random
                      signs; the scale is the root mean square of the change, over up to 32 states of a lane in the
                      first block
    evaluation_scale  in one evaluation from a state: the size of the value, or its noise if that is larger
    """
    z = _sampled_rows(plan, first)
    n = plan.model.n
    samples = SAMPLES if n <= MANY_SAMPLES_N else max(2, 16 * SAMPLES // n)  # every coordinate counts
    samples = max(1, min(samples, SAMPLES * MANY_LANES // plan.lanes))
    directions = _signs(samples, z.shape) * _largest(plan, z)
    by = np.concatenate([factor * directions for factor in (NUDGE, -NUDGE, HAIR, -HAIR)] + [0 * directions[:1]])
    every = plan.observe((z + by).reshape(-1, *z.shape[1:]))
    out = {}
    for name, outcome in plan.outcomes.items():
        if outcome.kind in KINDS:
            values = every[name].reshape((*by.shape[:2], *every[name].shape[1:]))
            up, down, a_bit_up, a_bit_down = values[:-1].reshape(4, samples, *values.shape[1:])
            here = values[-1]
            felt = np.sqrt((((up - down) / (2 * NUDGE)) ** 2).mean((0, 1)))
            noise = abs(a_bit_up + a_bit_down - 2 * here) / (2 * MACHINE_EPSILON)
            if n > MANY_SAMPLES_N and noise.shape[-1] == layout.coordinate_count("skew", n):
                noise = np.broadcast_to(noise.max(-1, keepdims=True), noise.shape)  # entries of one matrix
            computed = np.maximum(noise.max((0, 1)), abs(here).max(0))
            out[name] = {"roundoff_scale": _listed(felt, plan), "evaluation_scale": _listed(computed, plan)}
    return out


@lru_cache(4)
def _signs(samples: int, shape: tuple[int, ...]) -> Floats:
    """Random signs, the same in every run."""
    return np.random.default_rng(0).choice([-1.0, 1.0], (samples, *shape))


def _listed(scale: Array, plan: Plan) -> list[float]:
    """A scale for each part of an integral, lane after lane; the largest over the lanes if those are too many."""
    if plan.batched and scale.size > MOST_SCALES:
        scale = scale.max(0)
    return [float(v) for v in np.ravel(scale)]


def _largest(plan: Plan, z: Floats) -> Floats:
    """For each coordinate the largest of its component, in the shape of z."""
    parts = zip(layout.restore(z, plan.kinds, plan.model.n), plan.kinds, strict=True)
    flat = [abs(layout.flatten((part,), (kind,))) for part, kind in parts]
    return np.concatenate([f.max(-1, keepdims=True).repeat(f.shape[-1], -1) for f in flat], -1)


def _sampled_rows(plan: Plan, first: Mapping[str, Array]) -> Floats:
    """Up to 32 rows of the first block, evenly spread, in the method's own variables (rows, lanes, d).

    Of more than 64 lanes, and for n > 16, fewer rows, down to one: some thousand numbers are enough.
    """
    count = min(32, max(1, 2048 // plan.lanes), max(1, 512 // plan.model.n))
    rows = np.unique(np.linspace(0, len(next(iter(first.values()))) - 1, count).astype(int))
    parts = []
    for letter, outcome in plan.outcomes.items():
        if outcome.kind not in ("state", "orientation"):
            continue
        value = np.asarray(first[letter])[rows].astype(np.float64)
        value = value.reshape((len(rows), plan.lanes, *value.shape[1 + plan.batched :]))
        axial = outcome.axes == "skew" and plan.model.n == 3
        parts.append(algebra.hat(value) if axial else value)
    return np.asarray(layout.flatten(plan.scheme.reopen(tuple(parts)), plan.kinds))


def attributes(plan: Plan, first: Mapping[str, Array]) -> dict[str, dict[str, Any]]:
    """Attributes of every variable, from the plan and the first block of a run."""
    scales = roundoff_scales(plan, first)
    out: dict[str, dict[str, Any]] = {}
    for name, outcome in plan.outcomes.items():
        out[name] = {"long_name": outcome.meaning, "kind": outcome.kind, "units": "1"}
        if name in scales:
            out[name] |= {"conserved": int(outcome.conserved), **scales[name]}
    return out


def saved_times(plan: Plan, first: int = 0, stop: int | None = None) -> Floats:
    """Times of the saved rows first to stop - 1."""
    rows = np.arange(first, plan.rows if stop is None else stop, dtype=np.float64)
    return plan.timetable.times_of(rows)


TIME = {"long_name": "time", "units": "1", "axis": "T"}


def in_memory(plan: Plan, blocks: list[dict[str, Array]], times: Floats | None = None) -> xr.Dataset:
    """Blocks of outputs as a Dataset, at the times of the saved steps, or at others, or at one, without an axis."""
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel

    attrs = attributes(plan, blocks[0])
    for name, largest in _corrections(plan).items():
        attrs[name][CORRECTION] = largest
    when = saved_times(plan) if times is None else times
    data = {}
    for name in plan.outcomes:
        value = np.concatenate([block.pop(name) for block in blocks])
        names = dimensions(plan, name, value.shape)
        data[name] = (names, value, attrs[name]) if when.ndim else (names[1:], value[0], attrs[name])
    coords: dict[str, Any] = {"time": (("time",)[: when.ndim], when, TIME)}
    if plan.batched:
        coords["lane"] = ("lane", np.arange(plan.lanes))
    return xr.Dataset(data, coords, describe(plan).to_attrs())


CORRECTION = "largest_correction"  # of the state, by the projection, in units of eps_machine |state|


def _corrections(plan: Plan) -> dict[str, float]:
    found = plan.engine.projection.largest(plan.engine.z) if plan.engine.projection else {}
    return {name: largest for name, largest in found.items() if name in plan.outcomes}
