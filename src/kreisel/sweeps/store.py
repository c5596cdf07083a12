"""The archive of a sweep: its arrays, whose blocks are lanes, and the computation of a block.

A block is idempotent: its content depends only on the description in the attributes and on its index.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, counted, on_disk
from kreisel.files import parsed, stands
from kreisel.record.contract import System
from kreisel.runs.describing import body_of, dimensions, saved_times, time_attributes, versions
from kreisel.runs.plan import Plan
from kreisel.runs.planning import LEAST, require_room
from kreisel.storage import archive
from kreisel.storage.opening import COMPUTED, FAILED, MISSING, SweepRecord, Verified, open_lanes
from kreisel.sweeps.design import as_json
from kreisel.sweeps.ensemble import CHOSEN, FEWEST_ROWS, STATES, SUMMARIES, TRAJECTORIES, TROUBLES, Sweep, summarized

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
        self._text, self._plans = as_json(sweep.description), list(_templates(sweep))
        self.digest, self.width = hashlib.sha256(self._text.encode()).hexdigest(), _block_lanes(sweep, self._plans)

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return -(-self.sweep.lanes.total // self.width)

    def missing(self) -> list[int]:
        """The blocks that are not finished."""
        done = archive.blocks_done(self.part, "failed")
        return [k for k in range(self.blocks) if k not in done]

    def lanes_done(self, todo: Sequence[int]) -> int:
        """Lanes of the blocks that are not in `todo`."""
        total, width = self.sweep.lanes.total, self.width
        return total - sum(min(width, total - k * width) for k in todo)

    def open(self, overwrite: bool) -> list[int]:
        """Create the archive or resume it; the blocks to compute.  Raises `InputError` if another is in the way."""
        with on_disk(self.path, "be created"):
            going_on = archive.agreed(self.path)  # begun with --overwrite
            if going_on:
                try:
                    self._same(self.part)
                    going_on = archive.begun(self.part)
                except InputError:
                    going_on = False
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

    def _same(self, where: Path) -> None:
        record, parts = SweepRecord.of_store(where), list[str]()
        archive.require_plain(where)
        if record.sweep == self._text and record.block_lanes == self.width:
            return
        with contextlib.suppress(ValueError, TypeError, KeyError, AttributeError):
            saved, requested = (parsed(text, "The attribute sweep") for text in (record.sweep, self._text))
            parts = [
                f"{s}.{k}"
                for s in requested
                for k in {**requested[s], **saved[s]}
                if requested[s].get(k) != saved[s].get(k)
            ]
        differs = f" (it differs in {', '.join(sorted(parts)[:5])})" if parts else ""
        raise InputError(
            f"{where} holds another sweep{differs} and is unchanged. Choose another path, or replace it with "
            "--overwrite (overwrite=True)."
        )

    def _fit(self) -> None:
        """Compare the metadata with their checksum; note other versions; remove files that a kill left incomplete."""
        if archive.is_complete(self.part):
            return
        Verified(self.part, archive.listed(self.part)).verify("zarr.json")
        archive.remove_scratch(self.part)
        with archive.edited(self.part) as root:
            archive.note_versions(root["attributes"], versions())

    def _layouts(self) -> dict[str, dict[str, Any]]:
        total, width = self.sweep.lanes.total, self.width
        out: dict[str, dict[str, Any]] = {}

        def add(
            name: str, remainder: tuple[int, ...], dims: tuple[str, ...], attrs: Mapping[str, Any], **options: Any
        ) -> None:
            layout = {
                "shape": (total, *remainder),
                "chunks": (width, *remainder),
                "dtype": np.dtype("f8"),
                "fill_value": np.nan,
            }
            out[name] = {**layout, "dimension_names": ("lane", *dims), "attributes": dict(attrs), **options}

        for quantity, example in self.sweep.lanes.inputs(0, 1).items():
            dims = tuple(f"{quantity.name}_{i}" for i in range(example.ndim - 1))
            unit = self.sweep.description["sweep"].get("units", {}).get(quantity.name, "1")
            attrs: dict[str, Any] = {"long_name": f"{quantity.name}, as given", "kind": "input", "units": unit}
            encoding: dict[str, Any] = {"dtype": np.dtype("i8"), "fill_value": 0} if example.dtype.kind in "iu" else {}
            if example.dtype.kind == "U":
                words = sorted({_word(text) for text in self.sweep.lanes.inputs(0, total)[quantity].tolist()})
                attrs |= {"flag_values": list(range(len(words))), "flag_meanings": " ".join(words)}
                encoding = {"dtype": np.min_scalar_type(len(words)), "fill_value": 0}
            add(quantity.name, example.shape[1:], dims, attrs, **encoding)
        for plan in self._plans:
            for kind in (kind for kind in self.sweep.save if kind in SUMMARIES):
                for name in summarized(kind, plan.outcomes):
                    shape, outcome = plan.example[name].shape, plan.outcomes[name]
                    for end, meaning in SUMMARIES[kind].meanings.items():
                        lost = ", not conserved" if end == "drift" and not outcome.conserved else ""
                        attrs = {"long_name": f"{outcome.meaning}: {meaning}{lost}", "kind": kind, "units": "1"}
                        if f"{name}_{end}" not in out:
                            add(f"{name}_{end}", shape[2:], dimensions(plan, name, shape)[2:], attrs)
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
        bodies = {body_of(plan.model) for plan in self._plans}
        varied = any(q.letter in self.sweep.shared for q in self.sweep.lanes.quantities)
        body = None if varied or len(bodies) > 1 else bodies.pop()  # axes and units of the body of all lanes
        if "body" in self.sweep.description:
            body = json.dumps(self.sweep.description["body"])
        record = SweepRecord(
            title=f"{system.title}: sweep of {counted(self.sweep.lanes.total, 'lane')}",
            source=f"kreisel {importlib.metadata.version('kreisel')}",
            references=system.source,
            system=system.name,
            equations=system.equations,
            body=body,
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

    def finish(self) -> None:
        """Mark the store as complete and give it its name."""
        missing = self.missing()
        if missing:
            raise RunError(f"{self.part} lacks {len(missing):,} blocks although they were reported as done. {LOST}")
        with on_disk(self.path, "be finished", lambda: f" {LOST}"):
            if not archive.is_complete(self.part):
                archive.remove_scratch(self.part)
                failed = int((open_lanes(self.part)["failed"].values == FAILED).sum())
                archive.seal(self.part, failed_lanes=failed, complete=1)
            archive.take_name(self.path)


def _templates(sweep: Sweep) -> Iterator[Plan]:
    """A plan for each method and order that occur, since their variables differ.  Raises `InputError`."""
    varied = {q.name for q in sweep.lanes.quantities} & {"run.dt", "run.steps", "run.every"}
    lanes = sweep.lanes
    sizes, choices = [size for _, size in lanes.axes], list[list[int] | None]()
    for quantities, size in lanes.axes:  # the first place of each combination along an axis; None: any place
        telling = [lanes.tables[q] for q in quantities if q.name in ("run.method", "run.order")]
        firsts = {tuple(np.asarray(table[i]).tobytes() for table in telling): i for i in reversed(range(size))}
        choices.append(sorted(firsts.values()) if telling else None)
    free = [size if choice is None else 1 for size, choice in zip(sizes, choices, strict=True)]
    count = math.prod(free)
    tried = np.unravel_index(np.unique(np.linspace(0, count - 1, min(count, TEMPLATES)).astype(int)), free)
    for places in itertools.product(*([0] if choice is None else choice for choice in choices)):
        combination = np.ravel_multi_index(tuple(place + at for place, at in zip(tried, places, strict=True)), sizes)
        last: Exception | None = None
        for lane in combination.tolist():
            try:
                plan = sweep.plan_of_lane(lane)
                break
            except TROUBLES as error:
                last = last or error
        else:
            raise InputError(f"No lane of the sweep can be simulated. The first one: {last}")
        if TRAJECTORIES in sweep.save and varied:
            raise InputError(
                f"Trajectories need the same times in all lanes, but {', '.join(sorted(varied))} varies. Save "
                "summaries, or make a sweep for each."
            )
        rows = plan.steps // plan.every + 1
        if "frequencies" in sweep.save and rows < FEWEST_ROWS:
            raise InputError(f"Frequencies need at least {FEWEST_ROWS} saved states, got {rows}. Use more steps.")
        yield plan


def _block_lanes(sweep: Sweep, plans: Sequence[Plan]) -> int:
    """Lanes in a block: as requested, or as many as memory and running time allow, for any number of workers."""
    spec, bytes_per_lane = sweep.description["sweep"], 0
    for plan in plans:  # bytes that a lane holds at once
        sizes = {name: v[0, 0].size for name, v in plan.example.items()}
        states = sum(size for name, size in sizes.items() if plan.outcomes[name].kind in STATES)
        rows = 3 * plan.rows * (TRAJECTORIES in sweep.save)
        held = (40 + rows) * sum(sizes.values())  # a row, its outputs, temporary arrays for them, the summaries
        held += plan.rows * states * ("frequencies" in sweep.save)
        bytes_per_lane = max(bytes_per_lane, 8 * int(held + MESSAGE_BYTES // 4))
    fitting, asked = (spec["memory"] << 20) // bytes_per_lane, spec.get("block")
    if fitting < (asked or 1):
        raise InputError(
            f"{asked or 1} lanes need about {bytes_per_lane * (asked or 1) / 2**20:.0f} MiB at once, more than "
            f"memory = {spec['memory']} in [sweep]. Save less often "
            "(every), save no trajectories or frequencies, or allow more memory."
        )
    patience = max(1, LONGEST_BLOCK // max(plan.steps for plan in plans))
    usual = min(MOST_IN_BLOCK, fitting, patience, -(-sweep.lanes.total // FEWEST_BLOCKS))
    return int(min(asked, sweep.lanes.total) if asked else usual)


def _trajectories(plan: Plan, total: int, width: int) -> dict[str, dict[str, Any]]:
    """Each variable of a run: a shard for each block, with chunks along time."""
    out = {}
    for name, value in plan.example.items():
        remainder, outcome = value.shape[2:], plan.outcomes[name]
        inner = max(1, min(plan.rows, CHUNK_BYTES // (8 * width * math.prod(remainder))))
        out[name] = {
            "shape": (plan.rows, total, *remainder),
            "chunks": (inner, width, *remainder),
            "shards": (-(-plan.rows // inner) * inner, width, *remainder),
            "dtype": np.dtype("f8"),
            "fill_value": np.nan,
            "dimension_names": dimensions(plan, name, value.shape),
            "attributes": {"long_name": outcome.meaning, "kind": outcome.kind, "units": "1"}
            | {"conserved": int(outcome.conserved)},
        }
    return out


def compute(folder: str, source: Path | System | None, digest: str, block: int) -> dict[str, Any]:
    """Compute a block and write it.  Returns its lanes and memory.  Raises `RunError` if the store cannot be written.

    `digest` is the hash of the description: a worker keeps the sweep that it has read.
    """
    import psutil

    store = Path(folder)
    with on_disk(store, "be written", lambda: f" {LOST}"):
        archive.require_there(store)
        sweep, group, width = _opened_sweep(folder, source, digest)
        first, stop = block * width, min((block + 1) * width, sweep.lanes.total)
        lane_axis = {name: a.metadata.dimension_names.index("lane") for name, a in group.items()}
        out = results_of(sweep, group, lane_axis, first, stop)
        archive.write_block(store, group, "lane", block, first, out, durable=True)
    return {"lanes": stop - first, "memory_MiB": psutil.Process().memory_info().rss / (1 << 20)}


def _word(text: str) -> str:
    """The text as a word of `flag_meanings`, which are separated by spaces."""
    return "_".join(text.split())


def results_of(
    sweep: Sweep, arrays: Mapping[str, Any], lane_axis: Mapping[str, int], first: int, stop: int
) -> dict[str, Array]:
    """Every variable of lanes first to stop - 1, in the form of `arrays`, whose axes of lanes are given."""
    layouts = {
        name: (tuple(stop - first if i == lane_axis[name] else k for i, k in enumerate(array.shape)), lane_axis[name])
        for name, array in arrays.items()
        if array.attrs.get("kind") != "input" and name not in ("failed", "message")
    }
    out, faults = sweep.results(first, stop, layouts)
    for quantity, value in sweep.lanes.inputs(first, stop).items():
        if value.dtype.kind == "U":  # words as their indices
            words = arrays[quantity.name].attrs["flag_meanings"].split()
            places = {word: i for i, word in enumerate(words)}
            value = np.array([places[_word(text)] for text in value], dtype=arrays[quantity.name].dtype)
        out[quantity.name] = value
    state, messages = np.full(stop - first, COMPUTED, np.uint8), np.zeros((stop - first, MESSAGE_BYTES), np.uint8)
    for lane, why in faults.items():
        text = why.encode()[:MESSAGE_BYTES]
        state[lane], messages[lane, : len(text)] = FAILED, np.frombuffer(text, dtype=np.uint8)
    return out | {"message": messages, "failed": state}


Opened = tuple[Sweep, dict[str, Any], int]
_opened: dict[tuple[str, str], Opened] = {}  # the sweep whose blocks this process computes


def _opened_sweep(folder: str, source: Path | System | None, digest: str) -> Opened:
    """The sweep of a store, its arrays of lanes, and the number of lanes in a block.

    A worker gets a copy of a user-defined system with each block, and uses the first one.
    """
    opened = _opened.get((folder, digest)) or _newly_opened(folder, source, digest)
    _opened.clear()
    _opened[folder, digest] = opened
    return opened


def _newly_opened(folder: str, source: Path | System | None, digest: str) -> Opened:
    record = SweepRecord.of_store(Path(folder))
    if hashlib.sha256(record.sweep.encode()).hexdigest() != digest:
        raise RunError(f"{folder} is no longer the store of this sweep: another one was written there.")
    result = archive.opened_arrays(Path(folder))
    arrays = {name: array for name, array in result.items() if "lane" in (array.metadata.dimension_names or ())}
    return Sweep(record.description, source), arrays, record.block_lanes


def failed_lanes(run: Any) -> Iterator[tuple[int, str]]:
    """Lane and message of each lane that failed."""
    for lane in np.flatnonzero(run["failed"].values == FAILED).tolist():
        message = bytes(run["message"][lane].values.tolist()).rstrip(b"\0")
        yield lane, message.decode(errors="replace")
