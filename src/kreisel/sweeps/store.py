"""The archive of a sweep: its arrays, whose blocks are lanes, and the computation of a block.

A block is idempotent: its content depends only on the description in the attributes and on its index.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, on_disk
from kreisel.files import parsed, stands
from kreisel.runs.describing import body_of, dimensions, saved_times, time_attributes, versions
from kreisel.runs.plan import Plan
from kreisel.runs.progress import LEAST, require_room
from kreisel.storage import archive
from kreisel.storage.opening import COMPUTED, FAILED, MISSING, SweepRecord, open_lanes
from kreisel.sweeps.design import Varied, as_json
from kreisel.sweeps.ensemble import CHOSEN, TRAJECTORIES, TROUBLES, Sweep
from kreisel.sweeps.summaries import FEWEST_ROWS, SUMMARIES, summarized

LOST = "The blocks that were done are kept: the same command resumes."
MESSAGE_BYTES = 400
LONGEST_BLOCK = 10**9  # steps: about half a minute for n = 3
MOST_IN_BLOCK = 4096
FEWEST_BLOCKS = 16
TEMPLATES = 64  # lanes that are tried until one can be planned
CHUNK_BYTES = 1 << 20  # values of a trajectory that are read at once


class Store:
    """The archive of a sweep: NAME.part until all blocks are finished, then NAME."""

    def __init__(self, path: Path, sweep: Sweep):
        self.path, self.part, self.sweep = path, archive.part_of(path), sweep
        self._text = as_json(sweep.description)
        self.digest = hashlib.sha256(self._text.encode()).hexdigest()
        self._plans = list(_templates(sweep))
        self.width = _block_lanes(sweep, self._plans)

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return -(-self.sweep.lanes.total // self.width)

    def missing(self) -> list[int]:
        """The blocks that are not finished."""
        there = archive.blocks_done(self.part, "failed")
        return [k for k in range(self.blocks) if k not in there]

    def lanes_done(self, todo: Sequence[int]) -> int:
        """Lanes of the blocks that are not in `todo`."""
        last = self.sweep.lanes.total - (self.blocks - 1) * self.width
        return self.sweep.lanes.total - sum(last if k == self.blocks - 1 else self.width for k in todo)

    def open(self, overwrite: bool) -> list[int]:
        """Create the archive or resume it; the blocks to compute.  Raises `InputError` if another is in the way."""
        with on_disk(self.path, "be created"):
            going_on = archive.agreed(self.path) and self._is_same(self.part)  # begun with --overwrite
            if stands(self.path) and not (overwrite or going_on):
                self._same(self.path)
                return []
            for path in (self.path, self.part):
                archive.require_replaceable(path)
            if stands(self.part) and (going_on or (not overwrite and archive.begun(self.part))):
                self._same(self.part)
                self._fit()
            else:
                self._create(overwrite)
        return self.missing()

    def _is_same(self, where: Path) -> bool:
        try:
            self._same(where)
        except InputError:
            return False
        return archive.begun(where)

    def _same(self, where: Path) -> None:
        record = SweepRecord.of_store(where)
        archive.require_plain(where)
        if record.sweep != self._text or record.block_lanes != self.width:
            raise InputError(
                f"{where} holds another sweep{_difference(record.sweep, self._text)} and is unchanged. Choose "
                "another path, or replace it with --overwrite (overwrite=True)."
            )

    def _fit(self) -> None:
        """Compare the metadata with their checksum; note other versions; remove files that a kill left incomplete."""
        from kreisel.storage.verified import Verified

        if archive.whole(self.part):
            return
        Verified(self.part, archive.listed(self.part)).verify("zarr.json")
        archive.remove_scratch(self.part)
        with archive.edited(self.part) as root:
            archive.note_versions(root["attributes"], versions())

    def _layouts(self) -> dict[str, dict[str, Any]]:
        """The layout of every array for Zarr."""
        total, width = self.sweep.lanes.total, self.width
        out: dict[str, dict[str, Any]] = {}

        def add(name: str, rest: tuple[int, ...], dims: tuple[str, ...], attrs: Mapping[str, Any], **more: Any) -> None:
            layout = {"shape": (total, *rest), "chunks": (width, *rest), "dtype": np.dtype("f8"), "fill_value": np.nan}
            out[name] = {**layout, "dimension_names": ("lane", *dims), "attributes": dict(attrs), **more}

        example = self.sweep.lanes.inputs(0, 1)
        for quantity in example:
            add(quantity.name, *_input(quantity, example[quantity], self.sweep))
            if example[quantity].dtype.kind in "iuU":
                kind = np.dtype("u1") if example[quantity].dtype.kind == "U" else np.dtype("i8")
                out[quantity.name] |= {"dtype": kind, "fill_value": 0}
        for plan in self._plans:
            for name, (rest, dims, attrs) in _summaries(self.sweep, plan).items():
                if name not in out:
                    add(name, rest, dims, attrs)
            if TRAJECTORIES in self.sweep.save:
                for name, layout in _trajectories(plan, total, width).items():
                    out.setdefault(name, layout)
        for name, meaning in CHOSEN.items() if self.sweep.automatic else ():
            add(name, (), (), {"long_name": meaning, "units": "1"})
        spare = {"dtype": np.dtype("u1"), "fill_value": 0}
        add("message", (MESSAGE_BYTES,), ("character",), {"long_name": "why a lane failed, in UTF-8"}, **spare)
        flags = {"flag_values": [COMPUTED, FAILED, MISSING], "flag_meanings": "computed failed missing"}
        add("failed", (), (), {"long_name": "whether a lane failed", **flags}, dtype=np.dtype("u1"), fill_value=MISSING)
        return out

    def _create(self, overwrite: bool) -> None:
        plan, system = self._plans[0], self.sweep.system
        record = SweepRecord(
            title=f"{system.title}: sweep of {self.sweep.lanes.total:,} lanes",
            source=f"kreisel {importlib.metadata.version('kreisel')}",
            references=system.source,
            system=system.name,
            equations=system.equations,
            body=self._body(),
            frame=system.frame.value,
            n=plan.model.n,
            sweep=self._text,
            lanes=self.sweep.lanes.total,
            block_lanes=self.width,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            versions=json.dumps(versions()),
        )
        layouts, fixed = self._layouts(), {}
        numbers = sum(math.prod(layout["shape"]) for layout in layouts.values() if layout["dtype"] == np.dtype("f8"))
        require_room(self.path, LEAST * 8 * numbers, "Save less (save, every), fewer lanes, or choose another disk.")
        if TRAJECTORIES in self.sweep.save:
            fixed["time"] = times = saved_times(plan)
            layout = {"shape": times.shape, "chunks": times.shape, "dtype": times.dtype, "dimension_names": ("time",)}
            layouts["time"] = layout | {"attributes": time_attributes(plan)}
        archive.create(self.path, record.to_attrs(), layouts, fixed, overwrite)

    def _body(self) -> str | None:
        """Axes and units of the body of all lanes; None if they differ."""
        if "body" in self.sweep.description:
            return json.dumps(self.sweep.description["body"])
        found = {body_of(plan.model) for plan in self._plans}
        varied = any(q.letter in self.sweep.shared for q in self.sweep.lanes.quantities)
        return None if varied or len(found) > 1 else found.pop()

    def finish(self) -> None:
        """Mark the store as complete and give it its name."""
        missing = self.missing()
        if missing:
            raise RunError(f"{self.part} lacks {len(missing):,} blocks although they were reported as done. {LOST}")
        with on_disk(self.path, "be finished", lambda: f" {LOST}"):
            if not archive.whole(self.part):
                archive.remove_scratch(self.part)
                archive.seal(self.part, failed_lanes=self._failed(), complete=1)
            archive.take_name(self.path)

    def _failed(self) -> int:
        return int((open_lanes(self.part)["failed"].values == FAILED).sum())

    def failed_lanes(self) -> int:
        """The number of failed lanes of a complete store."""
        return SweepRecord.of_store(self.path).failed_lanes or 0


def _difference(theirs: str, mine: str) -> str:
    """The part in which two descriptions differ."""
    try:
        other = parsed(theirs, "The attribute sweep")
        here = parsed(mine, "The attribute sweep")
        parts = [f"{s}.{k}" for s in here for k in {**here[s], **other[s]} if here[s].get(k) != other[s].get(k)]
    except (ValueError, TypeError, KeyError, AttributeError):
        return ""
    return f" (it differs in {', '.join(sorted(parts)[:5])})" if parts else ""


def _templates(sweep: Sweep) -> Iterator[Plan]:
    """A plan for each method and order that occur, since their variables differ.

    Raises `InputError` if no lane of a combination can be planned.
    """
    for combination in _combinations(sweep):
        last: Exception | None = None
        for lane in combination:
            try:
                plan = sweep.plan_of_lane(lane)
            except TROUBLES as error:
                last = last or error
                continue
            _check_rows(sweep, plan)
            yield plan
            break
        else:
            raise InputError(f"No lane of the sweep can be simulated. The first one: {last}")


def _combinations(sweep: Sweep) -> Iterator[list[int]]:
    """Some lanes for each combination of method and order."""
    lanes, names = sweep.lanes, ("run.method", "run.order")
    tables = lanes.tables
    sizes = [size for _, size in lanes.axes]
    choices: list[list[int]] = []
    for quantities, size in lanes.axes:
        telling = [tables[q] for q in quantities if q.name in names]
        firsts = (
            {tuple(np.asarray(t[i]).tobytes() for t in telling): i for i in reversed(range(size))}
            if telling
            else {(): 0}
        )
        choices.append(sorted(firsts.values()))
    for places in np.ndindex(*(len(c) for c in choices)):
        start = [c[i] for c, i in zip(choices, places, strict=True)]
        free = [k for k, (quantities, _) in enumerate(lanes.axes) if not any(q.name in names for q in quantities)]
        found = []
        count = math.prod(sizes[k] for k in free)
        for other in np.unique(np.linspace(0, count - 1, min(count, TEMPLATES)).astype(int)):
            place = list(start)
            for k, at in zip(free, np.unravel_index(other, [sizes[k] for k in free]), strict=True):
                place[k] = int(at)
            found.append(int(np.ravel_multi_index(place, sizes)))
        yield found


def _check_rows(sweep: Sweep, plan: Plan) -> None:
    varied = {q.name for q in sweep.lanes.quantities} & {"run.dt", "run.steps", "run.every"}
    if TRAJECTORIES in sweep.save and varied:
        raise InputError(
            f"Trajectories need the same times in all lanes, but {', '.join(sorted(varied))} varies. Save summaries, "
            "or make a sweep for each."
        )
    rows = plan.steps // plan.every + 1
    if "frequencies" in sweep.save and rows < FEWEST_ROWS:
        raise InputError(f"Frequencies need at least {FEWEST_ROWS} saved states, got {rows}. Use more steps.")


def _floats_of_a_lane(sweep: Sweep, plan: Plan) -> int:
    """Floats that a lane holds in memory at once, temporary ones included."""
    outputs = plan.example
    states = sum(v[0, 0].size for name, v in outputs.items() if plan.outcomes[name].kind in ("state", "orientation"))
    everything = sum(v[0, 0].size for v in outputs.values())
    held = 40 * everything  # a row, its outputs, temporary arrays for them, the summaries
    if TRAJECTORIES in sweep.save:
        held += 3 * plan.rows * everything
    if "frequencies" in sweep.save:
        held += plan.rows * states
    return int(held + MESSAGE_BYTES // 4)


def _block_lanes(sweep: Sweep, plans: Sequence[Plan]) -> int:
    """Lanes in a block: as requested, or as many as memory and running time allow, for any number of workers."""
    spec = sweep.description["sweep"]
    each = max(8 * _floats_of_a_lane(sweep, plan) for plan in plans)
    fitting = (spec["memory"] << 20) // each
    asked = spec.get("block")
    if fitting < (asked or 1):
        raise InputError(
            f"{asked or 1} lanes need about {each * (asked or 1) / 2**20:.0f} MiB at once, more than "
            f"memory = {spec['memory']} in [sweep]. Save less often "
            "(every), save no trajectories or frequencies, or allow more memory."
        )
    if asked:
        return int(min(asked, sweep.lanes.total))
    patience = max(1, LONGEST_BLOCK // max(plan.steps for plan in plans))
    return int(min(MOST_IN_BLOCK, fitting, patience, -(-sweep.lanes.total // FEWEST_BLOCKS)))


def _input(quantity: Varied, example: Array, sweep: Sweep) -> tuple[tuple[int, ...], tuple[str, ...], dict[str, Any]]:
    """Shape, dimensions and attributes of the values of a quantity that varies."""
    attrs: dict[str, Any] = {"long_name": f"{quantity.name}, as given", "kind": "input", "units": "1"}
    if example.dtype.kind == "U":
        tables = {**sweep.lanes.grid, **sweep.lanes.listed}
        words = sorted(set(tables[quantity].tolist()))
        attrs |= {"flag_values": list(range(len(words))), "flag_meanings": " ".join(words)}
    rest = example.shape[1:]
    return rest, tuple(f"{quantity.name}_{i}" for i in range(len(rest))), attrs


def _summaries(sweep: Sweep, plan: Plan) -> dict[str, tuple[tuple[int, ...], tuple[str, ...], dict[str, Any]]]:
    out = {}
    for kind in (kind for kind in sweep.save if kind in SUMMARIES):
        for name in summarized(kind, plan.outcomes):
            shape, outcome = plan.example[name].shape, plan.outcomes[name]
            for end, meaning in SUMMARIES[kind].meanings(outcome).items():
                attrs = {"long_name": f"{outcome.meaning}: {meaning}", "kind": kind, "units": "1"}
                out[f"{name}_{end}"] = shape[2:], dimensions(plan, name, shape)[2:], attrs
    return out


def _trajectories(plan: Plan, total: int, width: int) -> dict[str, dict[str, Any]]:
    """Each variable of a run: a shard for each block, with chunks along time."""
    out = {}
    for name, value in plan.example.items():
        rest, outcome = value.shape[2:], plan.outcomes[name]
        inner = max(1, min(plan.rows, CHUNK_BYTES // (8 * width * math.prod(rest))))
        out[name] = {
            "shape": (plan.rows, total, *rest),
            "chunks": (inner, width, *rest),
            "shards": (-(-plan.rows // inner) * inner, width, *rest),
            "dtype": np.dtype("f8"),
            "fill_value": np.nan,
            "dimension_names": dimensions(plan, name, value.shape),
            "attributes": {
                "long_name": outcome.meaning,
                "kind": outcome.kind,
                "units": "1",
                "conserved": int(outcome.conserved),
            },
        }
    return out


def compute(part: str, block: int, file: str | None = None, digest: str = "") -> dict[str, Any]:
    """Compute a block and write it.  Returns its cost.  Raises `RunError` if the store cannot be written.

    `digest` is the hash of the description: a worker keeps the sweep that it has read.
    """
    import psutil

    begun = time.perf_counter()
    store = Path(part)
    with on_disk(store, "be written", lambda: f" {LOST}"):
        archive.require_there(store)
        sweep, group, width = _opened_sweep(part, file, digest)
        first, stop = block * width, min((block + 1) * width, sweep.lanes.total)
        lane_axis = {name: a.metadata.dimension_names.index("lane") for name, a in group.items()}
        out = results_of(sweep, group, lane_axis, first, stop)
        archive.write_block(store, group, "lane", block, first, out, durable=True)
    return {
        "block": block,
        "lanes": stop - first,
        "failed": int((out["failed"] == FAILED).sum()),
        "seconds": time.perf_counter() - begun,
        "memory_MiB": psutil.Process().memory_info().rss / (1 << 20),
        "process": os.getpid(),
    }


def results_of(
    sweep: Sweep, arrays: Mapping[str, Any], lane_axis: Mapping[str, int], first: int, stop: int
) -> dict[str, Array]:
    """Every variable of lanes first to stop - 1, in the form of `arrays`, whose axes of lanes are given."""
    known = {
        name: (tuple(stop - first if i == lane_axis[name] else k for i, k in enumerate(array.shape)), lane_axis[name])
        for name, array in arrays.items()
        if array.attrs.get("kind") != "input" and name not in ("failed", "message")
    }
    out, faults = sweep.results(first, stop, known)
    out |= {q.name: _numbered(v, arrays[q.name]) for q, v in sweep.lanes.inputs(first, stop).items()}
    state = np.full(stop - first, COMPUTED, dtype=np.uint8)
    state[list(faults)] = FAILED
    return out | {"message": _messages(faults, stop - first), "failed": state}


@lru_cache(4)
def _opened_sweep(part: str, file: str | None, digest: str) -> tuple[Sweep, dict[str, Any], int]:
    """The sweep of a store, its arrays of lanes, and the number of lanes in a block."""
    record = SweepRecord.of_store(Path(part))
    if hashlib.sha256(record.sweep.encode()).hexdigest() != digest:
        raise RunError(f"{part} is no longer the store of this sweep: another one was written there.")
    found = archive.opened_arrays(Path(part))
    arrays = {name: array for name, array in found.items() if "lane" in (array.metadata.dimension_names or ())}
    return Sweep(record.description, Path(file) if file else None), arrays, record.block_lanes


def _numbered(value: Array, array: Any) -> Array:
    """Words as their indices in the attribute flag_meanings."""
    if value.dtype.kind != "U":
        return value
    words = array.attrs["flag_meanings"].split()
    return np.array([words.index(word) for word in value], dtype=np.uint8)


def _messages(faults: Mapping[int, str], lanes: int) -> Array:
    out = np.zeros((lanes, MESSAGE_BYTES), dtype=np.uint8)
    for lane, why in faults.items():
        text = why.encode()[:MESSAGE_BYTES]
        out[lane, : len(text)] = np.frombuffer(text, dtype=np.uint8)
    return out


def failed_lanes(run: Any) -> Iterator[tuple[int, str]]:
    """Lane and message of each lane that failed."""
    for lane in np.flatnonzero(run["failed"].values == FAILED).tolist():
        message = bytes(run["message"][lane].values.tolist()).rstrip(b"\0")
        yield lane, message.decode(errors="replace")
