"""The Zarr store of a sweep: its arrays, which have their full length from the beginning, and its blocks."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, on_disk
from kreisel.files import parsed, stands
from kreisel.runs.describing import body_of, dimensions, saved_times, time_attributes, versions
from kreisel.runs.plan import Plan
from kreisel.runs.progress import LEAST, require_room
from kreisel.storage import manifest
from kreisel.storage.nodes import require_sound
from kreisel.storage.part import Part
from kreisel.storage.replacing import agreed
from kreisel.sweeps import blocks
from kreisel.sweeps.blocks import COMPUTED, FAILED, MESSAGE_BYTES, MISSING, TRAJECTORIES, Sweep
from kreisel.sweeps.design import Varied, as_json
from kreisel.sweeps.summaries import FEWEST_ROWS, PARTS
from kreisel.sweeps.sweep_record import SweepRecord
from kreisel.sweeps.workers import LOST

LONGEST_BLOCK = 10**9  # steps: about half a minute for n = 3
MOST_IN_BLOCK = 4096
FEWEST_BLOCKS = 16
TEMPLATES = 64  # lanes that are tried until one can be planned
CHUNK_BYTES = 1 << 20  # of a trajectory: what is read at once


class Store:
    """The Zarr store of a sweep: NAME.part until every block is there, then NAME."""

    def __init__(self, path: Path, sweep: Sweep):
        self._store = Part(path)
        self.path, self.part, self.sweep = path, self._store.part, sweep
        self._text = as_json(sweep.description)
        self.digest = hashlib.sha256(self._text.encode()).hexdigest()
        self._plans = list(_templates(sweep))
        self.width = _block_lanes(sweep, self._plans)

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return -(-self.sweep.lanes.total // self.width)

    def missing(self) -> list[int]:
        """The blocks that are not done."""
        if manifest.whole(self.part):
            return []
        there = manifest.blocks_done(self.part)
        return [k for k in range(self.blocks) if k not in there]

    def lanes_done(self, todo: Sequence[int]) -> int:
        """Lanes of the blocks that are not in `todo`."""
        last = self.sweep.lanes.total - (self.blocks - 1) * self.width
        return self.sweep.lanes.total - sum(last if k == self.blocks - 1 else self.width for k in todo)

    def open(self, overwrite: bool) -> list[int]:
        """Make the store or go on with it; the blocks to do.  Raises `InputError` where another one is in the way."""
        with on_disk(self.path, "be created"):
            going_on = agreed(self.path) and self._is_same(self.part)  # begun with --overwrite
            if stands(self.path) and not (overwrite or going_on):
                self._same(self.path)
                return []
            self._store.require_room()
            if stands(self.part) and (going_on or (not overwrite and manifest.begun(self.part))):
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
        return manifest.begun(where)

    def _same(self, where: Path) -> None:
        record = SweepRecord.of_store(where)
        require_sound(where)
        if record.sweep != self._text or record.block_lanes != self.width:
            raise InputError(
                f"{where} holds another sweep{_difference(record.sweep, self._text)} and is left as it is. Choose "
                "another path, or replace it with --overwrite (overwrite=True)."
            )

    def _fit(self) -> None:
        """Compare the metadata with the manifest; note other versions; remove what a kill left half written."""
        from kreisel.storage.verified import Verified, edited, note_versions

        if manifest.whole(self.part):
            return
        store = Verified(self.part, manifest.read(self.part))
        for name in ("zarr.json", *(f"{name}/zarr.json" for name in self._arrays())):
            store.verify(name)
        manifest.remove_scratch(self.part)
        with edited(self.part) as group:
            note_versions(group, versions())

    def _arrays(self) -> dict[str, dict[str, Any]]:
        """Every array as Zarr makes it."""
        total, width = self.sweep.lanes.total, self.width
        out: dict[str, dict[str, Any]] = {}

        def add(name: str, rest: tuple[int, ...], dims: tuple[str, ...], attrs: Mapping[str, Any], **more: Any) -> None:
            layout = {"shape": (total, *rest), "chunks": (width, *rest), "dtype": np.dtype("f8"), "fill_value": np.nan}
            out[name] = {**layout, "dimension_names": ("lane", *dims), "attributes": dict(attrs), **more}

        example = self.sweep.lanes.values(0, 1)
        for quantity in self.sweep.lanes.quantities:
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
        for name, meaning in blocks.CHOSEN.items() if self.sweep.automatic else ():
            add(name, (), (), {"long_name": meaning, "units": "1"})
        spare = {"dtype": np.dtype("u1"), "fill_value": 0}
        add("message", (MESSAGE_BYTES,), ("character",), {"long_name": "why a lane failed, in UTF-8"}, **spare)
        flags = {"flag_values": [COMPUTED, FAILED, MISSING], "flag_meanings": "computed failed missing"}
        add("failed", (), (), {"long_name": "whether a lane failed", **flags}, dtype=np.dtype("u1"), fill_value=MISSING)
        return out

    def _require_room(self, arrays: Mapping[str, Mapping[str, Any]]) -> None:
        numbers = sum(math.prod(a["shape"]) for a in arrays.values() if a["dtype"] == np.dtype("f8"))
        require_room(self.path, LEAST * 8 * numbers, "Save less (save, every), fewer lanes, or choose another disk.")

    def _create(self, overwrite: bool) -> None:
        from kreisel.storage.verified import made_array

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
        arrays = self._arrays()
        self._require_room(arrays)
        group = self._store.create(record.to_attrs(), overwrite)
        if TRAJECTORIES in self.sweep.save:
            times = saved_times(plan)
            made_array(
                group,
                "time",
                data=times,
                chunks=times.shape,
                dimension_names=("time",),
                attributes=time_attributes(plan),
            )
        for name, layout in arrays.items():
            made_array(group, name, **layout)
        (self.part / manifest.BLOCKS).mkdir()
        if TRAJECTORIES in self.sweep.save:
            manifest.add_block(self.part, "before", ["time/c/0"])
        manifest.begin(self.part)

    def _body(self) -> str | None:
        """Axes and units of the body of all lanes; None if they differ."""
        found = {body_of(plan.model) for plan in self._plans}
        varied = "body" not in self.sweep.description and any(
            self.sweep.kinds.get(q.letter) == "array" for q in self.sweep.lanes.quantities
        )
        return None if varied or len(found) > 1 else found.pop()

    def finish(self) -> None:
        """Mark the store as whole and give it its name."""
        missing = self.missing()
        if missing:
            raise RunError(f"{self.part} lacks {len(missing):,} blocks although they were reported as done. {LOST}")
        with on_disk(self.path, "be finished", lambda: f" {LOST}"):
            if not manifest.whole(self.part):
                manifest.remove_scratch(self.part)
                self._store.seal(failed_lanes=self._failed(), complete=1)
            manifest.clear(self.part)
            self._store.take_name()

    def _failed(self) -> int:
        import zarr

        from kreisel.storage.verified import Verified

        failed: Any = zarr.open_group(Verified(self.part, manifest.read(self.part)), mode="r")["failed"]
        return int((np.asarray(failed[:]) == FAILED).sum())

    def failed_lanes(self) -> int:
        """How many lanes failed, of a store that is whole."""
        return SweepRecord.of_store(self.path).failed_lanes or 0


def _difference(theirs: str, mine: str) -> str:
    """Which part of two descriptions differs."""
    try:
        other = parsed(theirs, "The attribute sweep")
        here = parsed(mine, "The attribute sweep")
        parts = [f"{s}.{k}" for s in here for k in {**here[s], **other[s]} if here[s].get(k) != other[s].get(k)]
    except (ValueError, TypeError, KeyError, AttributeError):
        return ""
    return f" (it differs in {', '.join(sorted(parts)[:5])})" if parts else ""


def _templates(sweep: Sweep) -> Iterator[Plan]:
    """A plan for each method and order that occur; they have different variables.

    Raises `InputError` where no lane of them can be planned.
    """
    lanes = sweep.lanes
    for combination in _combinations(sweep):
        last: Exception | None = None
        for lane in combination:
            values = lanes.values(lane, lane + 1)
            varied = {(q.section, q.letter) for q in values}
            try:
                plan = sweep.plan(lanes.filled(values), np.arange(1), varied)
            except blocks.TROUBLES as error:
                last = last or error
                continue
            _check_rows(sweep, plan)
            yield plan
            break
        else:
            raise InputError(f"No lane of the sweep can be simulated. The first one: {last}")


def _combinations(sweep: Sweep) -> Iterator[list[int]]:
    """For each combination of method and order some lanes that have it."""
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
    """Numbers that a lane holds in memory at once, temporary ones included."""
    outputs = plan.example
    states = sum(v[0, 0].size for name, v in outputs.items() if plan.outcomes[name].kind in ("state", "orientation"))
    everything = sum(v[0, 0].size for v in outputs.values())
    held = 40 * everything  # a row, its outputs, what it takes to make them, the summaries
    if TRAJECTORIES in sweep.save:
        held += 3 * plan.rows * everything
    if "frequencies" in sweep.save:
        held += plan.rows * states
    return int(held + MESSAGE_BYTES // 4)


def _block_lanes(sweep: Sweep, plans: Sequence[Plan]) -> int:
    """Lanes in a block: as asked for, or as many as memory and running time allow, for any number of workers."""
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
    outputs, out = plan.example, {}
    for kind in sweep.save:
        for name, (of, meaning) in PARTS[kind](plan.outcomes).items() if kind in PARTS else ():
            dims = dimensions(plan, of, outputs[of].shape)[2:]
            out[name] = outputs[of].shape[2:], dims, {"long_name": meaning, "kind": kind, "units": "1"}
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
