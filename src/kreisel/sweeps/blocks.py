"""A block of lanes of a sweep: simulated, summed up, and written to its region of the store.

A block is idempotent: what it writes depends on the description in the store's attributes and on its number alone.  It
writes whole chunks, each atomically, and last their checksums: where that file of the manifest is, the block is done.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, on_disk
from kreisel.kernels.layout import Floats
from kreisel.method.auto import Choice
from kreisel.record.body_frame import BodyFrame
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.runs.config import load_system
from kreisel.runs.integration import Integration
from kreisel.runs.plan import Plan
from kreisel.runs.planning import choices, plan_of, with_choice
from kreisel.runs.settings import Settings
from kreisel.storage import manifest
from kreisel.sweeps.design import Lanes, Varied
from kreisel.sweeps.summaries import SUMMARIES, Summary
from kreisel.sweeps.sweep_record import SweepRecord

TRAJECTORIES = "trajectories"
COMPUTED, FAILED, MISSING = 0, 1, 255  # values of the variable `failed`
MESSAGE_BYTES = 400
CHOSEN = {"chosen_order": "order chosen for the tolerance", "chosen_dt": "step chosen for the tolerance"}
TROUBLES = (InputError, RunError, ArithmeticError, np.linalg.LinAlgError)  # of single lanes


class Sweep:
    """A sweep from its description: sections system, state, run and sweep, as plain data.

    file    the Python file of a system of the user's own
    """

    def __init__(self, description: Mapping[str, Any], file: Path | None = None):
        self.description, spec = description, description["sweep"]
        base = dict(description["system"])
        self.system: System = load_system(base.pop("name"), file)
        if self.system.perturbation is not None and self.system.perturbation.pair is not None:
            raise InputError(
                f"{self.system.name}: expected a system whose lanes are independent, got bodies that act on each other "
                "in pairs, which are the lanes of one run. Call kr.simulate for each set of parameters."
            )
        self.lanes = Lanes({**description, "system": base}, spec)
        self.save: tuple[str, ...] = tuple(spec["save"])
        self.kinds = {p.letter: p.kind for p in self.system.parameters}
        self._kinds_of_state = dict(self.system.space.components)
        body = description.get("body")
        self._body_frame = None if body is None else BodyFrame.from_table(body)

    def plan(
        self,
        sections: Mapping[str, Mapping[str, Any]],
        ids: Array,
        varied: set[tuple[str, str]],
        choice: Choice | None = None,
    ) -> Plan:
        """The ensemble of the lanes `ids` of what `Lanes.filled` gave, with what was chosen for order="auto".

        Raises `InputError`.
        """
        model, start, orientation, settings = self._asked(sections, ids, varied)
        if choice is not None:
            settings = with_choice(choice, settings)
        plan = plan_of(model, model.state(**start), settings, orientation)
        if plan.lanes != len(ids):
            raise InputError(
                "expected one lane in [system] and [state], got a batch axis; what varies stands in [sweep.list]."
            )
        return plan

    def alike(
        self, sections: Mapping[str, Mapping[str, Any]], ids: Array, varied: set[tuple[str, str]]
    ) -> list[tuple[Array, Choice | None]]:
        """The lanes in groups that are stepped together: with order="auto", those with the same choice.

        Each lane has its own, that of a single run: it depends on no other lane and on no block.
        """
        model, start, orientation, settings = self._asked(sections, ids, varied)
        if settings.order != "auto":
            return [(ids, None)]
        found: dict[tuple[int, int], tuple[list[int], Choice]] = {}
        each = choices(model, model.state(**start), settings, orientation)
        if len(each) != len(ids):
            return [(ids, None)]  # `plan` says what is wrong
        for lane, choice in zip(ids.tolist(), each, strict=True):
            found.setdefault((choice.order, choice.steps), ([], choice))[0].append(lane)
        return [(np.array(lanes), choice) for lanes, choice in found.values()]

    def _asked(
        self, sections: Mapping[str, Mapping[str, Any]], ids: Array, varied: set[tuple[str, str]]
    ) -> tuple[Model, dict[str, Any], Any, Settings]:
        """Model, start, orientation and settings of an ensemble.  Raises `InputError`."""

        def chosen(section: str, letter: str) -> Any:
            value = sections[section][letter]
            if (section, letter) not in varied:
                return value
            if section == "run" and np.ndim(value[ids[0]]):
                raise InputError(f"run.{letter}: expected a number or a name for each lane, got lists.")
            return value[ids[0]].item() if section == "run" else value[ids]

        params = {
            k: _ready(chosen("system", k), self.kinds.get(k), ("system", k) in varied) for k in sections["system"]
        }
        for letter, kind in self.kinds.items():
            if kind == "array" and ("system", letter) in varied:
                params[letter] = params[letter][0]
        state = {k: chosen("state", k) for k in sections["state"]}
        orientation = state.pop("orientation", None)
        model = Model(self.system, params, self._body_frame)
        start = {k: _ready(v, self._kinds_of_state.get(k), ("state", k) in varied, len(ids)) for k, v in state.items()}
        run = {k: chosen("run", k) for k in sections["run"]}
        if run.get("times") is not None:
            raise InputError("[run] of a sweep: expected rows at each `every`-th dt, got times. Leave them out.")
        missing = [k for k in ("dt", "steps") if run.get(k) is None]
        if missing:
            raise InputError(f"[run] needs {' and '.join(missing)}, or vary it in [sweep.grid] or [sweep.list].")
        return model, start, orientation, Settings.checked(**run)

    @property
    def automatic(self) -> bool:
        """Whether order="auto" occurs."""
        orders = [np.atleast_1d(v) for q, v in self.lanes.tables.items() if q.name == "run.order"]
        return "auto" in (np.concatenate(orders) if orders else [self.lanes.base["run"].get("order")])

    def groups(self, values: Mapping[Varied, Array], count: int) -> list[Array]:
        """Lanes that can be stepped together: those whose run settings are the same."""
        apart = [
            v
            for q, v in values.items()
            if q.section == "run" or (q.section == "system" and self.kinds.get(q.letter) == "array")
        ]
        if not apart:
            return [np.arange(count)]
        keys: dict[tuple[bytes, ...], list[int]] = {}
        for lane in range(count):
            keys.setdefault(tuple(np.asarray(v[lane]).tobytes() for v in apart), []).append(lane)
        return [np.array(ids) for ids in keys.values()]

    def results(
        self, first: int, stop: int, known: Mapping[str, tuple[tuple[int, ...], int]]
    ) -> tuple[dict[str, Array], dict[int, str]]:
        """Every variable in `known`, name -> (shape, axis of lanes), of lanes first to stop - 1; which failed, and why.

        Summaries of lanes that failed are NaN, and so are their trajectories from the failure on.
        """
        values = self.lanes.values(first, stop)
        sections, varied = self.lanes.filled(values), {(q.section, q.letter) for q in values}
        out = {name: np.full(shape, np.nan) for name, (shape, _) in known.items()}
        faults: dict[int, str] = {}
        pending: list[tuple[Array, Choice | None, bool]]  # lanes, what was chosen for them, and whether that is done
        pending = [(ids, None, False) for ids in reversed(self.groups(values, stop - first))]
        while pending:
            ids, choice, chosen = pending.pop()
            try:
                if not chosen:
                    pending += [(lanes, one, True) for lanes, one in reversed(self.alike(sections, ids, varied))]
                    continue
                part, failed = self._simulated(self.plan(sections, ids, varied, choice))
            except TROUBLES as error:
                if len(ids) == 1:
                    faults[int(ids[0])] = str(error)
                else:  # one of them is at fault: the halves are tried
                    half = len(ids) // 2
                    pending += [(ids[half:], choice, chosen), (ids[:half], choice, chosen)]
                continue
            for name in out.keys() & part.keys():
                out[name][(*(slice(None),) * known[name][1], ids)] = part[name]
            faults |= {int(ids[lane]): why for lane, why in failed.items()}
        return out, faults

    def _simulated(self, plan: Plan) -> tuple[dict[str, Array], dict[int, str]]:
        """Summaries (lanes, ...) and, if asked for, trajectories (time, lanes, ...) of an ensemble; its faults."""
        failed: dict[int, str] = {}
        regular = plan.steps // plan.every + 1
        summaries: list[Summary] = [
            SUMMARIES[kind](plan.outcomes, regular, plan.dt * plan.every) for kind in self.save if kind in SUMMARIES
        ]
        whole: dict[str, list[Array]] = {}
        for block in Integration(plan, faults=failed).blocks():
            for summary in summaries:
                summary.add(block)
            if TRAJECTORIES in self.save:
                for name, value in block.items():
                    whole.setdefault(name, []).append(value)
        out: dict[str, Array] = {}
        for summary in summaries:
            out |= summary.result()
        options = plan.scheme.options
        if isinstance(options.get("order"), int):
            chosen = (options["order"], plan.dt)
            out |= {name: np.full(plan.lanes, float(value)) for name, value in zip(CHOSEN, chosen, strict=True)}
        for value in out.values():
            value[list(failed)] = np.nan
        return out | {name: np.concatenate(values) for name, values in whole.items()}, failed


def _ready(value: Any, kind: str | None, varied: bool, lanes: int | None = None) -> Any:
    """A value in a form whose axis of lanes cannot be mistaken; `lanes` says whether it has one."""
    if kind is None:
        return value
    try:
        array = np.asarray(value)
    except ValueError:
        return value  # the model says what is wrong with it
    if array.dtype.kind not in "iuf":
        return value
    axes = array.ndim - varied
    if kind == "skew" and axes == 1 and array.shape[-1] == 3:
        array, axes = algebra.hat(array), 2
    if kind == "symmetric" and axes == 1:
        array, axes = array[..., None] * np.eye(array.shape[-1], dtype=np.int8), 2
    if lanes is not None and not varied:
        array = np.broadcast_to(array, (lanes, *array.shape))
    return array


def compute(part: str, block: int, file: str | None = None, digest: str = "") -> dict[str, Any]:
    """Compute a block and write it.  Returns what it took.  Raises `RunError` where the store cannot be written.

    `digest` is the hash of the description: a worker keeps what it has read.
    """
    import psutil

    begun = time.perf_counter()
    store = Path(part)
    with on_disk(store, "be written", lambda: " The blocks that were done are kept: the same command goes on."):
        sweep, group, width = _opened_sweep(part, file, digest)
        first, stop = block * width, min((block + 1) * width, sweep.lanes.total)
        lane_axis = {name: a.metadata.dimension_names.index("lane") for name, a in group.items()}
        out = results_of(sweep, group, lane_axis, first, stop)
        _require_there(store)
        for name, value in out.items():
            _write_slice(group[name], value, lane_axis[name], first, stop)
        names = [_chunk(name, array, lane_axis[name], block) for name, array in group.items()]
        _sync(store, names)
        _require_there(store)
        manifest.add_block(store, block, names, durable=True)
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
    """Every variable of lanes first to stop - 1, as it is written to `arrays`, whose axes of lanes are given."""
    known = {
        name: (tuple(stop - first if i == lane_axis[name] else k for i, k in enumerate(array.shape)), lane_axis[name])
        for name, array in arrays.items()
        if array.attrs.get("kind") != "input" and name not in ("failed", "message")
    }
    out, faults = sweep.results(first, stop, known)
    out |= {q.name: _numbered(v, arrays[q.name]) for q, v in sweep.lanes.values(first, stop).items()}
    state = np.full(stop - first, COMPUTED, dtype=np.uint8)
    state[list(faults)] = FAILED
    return out | {"message": _messages(faults, stop - first), "failed": state}


@lru_cache(4)
def _opened_sweep(part: str, file: str | None, digest: str) -> tuple[Sweep, dict[str, Any], int]:
    """The sweep of a store, its arrays of lanes, and how many lanes a block has."""
    import zarr

    with zarr.config.set({"array.write_empty_chunks": True}):  # so that every chunk is there, and has its checksum
        group = zarr.open_group(part, mode="r+", zarr_format=3, use_consolidated=False)
        found: dict[str, Any] = dict(group.arrays())
    record = SweepRecord.from_attrs(group.attrs, part)
    if hashlib.sha256(record.sweep.encode()).hexdigest() != digest:
        raise RunError(f"{part} is no longer the store of this sweep: another one was written there.")
    arrays = {name: array for name, array in found.items() if "lane" in (array.metadata.dimension_names or ())}
    return Sweep(record.description, Path(file) if file else None), arrays, record.block_lanes


def _numbered(value: Array, array: Any) -> Array:
    """Words as their numbers in the attribute flag_meanings."""
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


def _write_slice(array: Any, value: Array | Floats, axis: int, first: int, stop: int) -> None:
    array[(*(slice(None),) * axis, slice(first, stop))] = value


def _require_there(store: Path) -> None:
    """Raises `RunError` where a store has vanished: Zarr would make new folders for its chunks."""
    if not (store / manifest.METADATA).exists():
        raise RunError(f"{store} vanished during the sweep: {manifest.METADATA} is gone. Run the same command again.")


def _chunk(name: str, array: Any, axis: int, block: int) -> str:
    """The file of a block of an array."""
    places = ["0"] * array.ndim
    places[axis] = str(block)
    return f"{name}/c/{'/'.join(places)}"


def _sync(store: Path, names: list[str]) -> None:
    """Make the chunks of a block durable."""
    for name in names:
        with (store / name).open("rb+") as file:  # Windows makes durable only what may be written
            os.fsync(file.fileno())


def failed_lanes(run: Any) -> Iterator[tuple[int, str]]:
    """Lane and message of each lane that failed."""
    for lane in np.flatnonzero(run["failed"].values == FAILED).tolist():
        message = bytes(run["message"][lane].values.tolist()).rstrip(b"\0")
        yield lane, message.decode(errors="replace")
