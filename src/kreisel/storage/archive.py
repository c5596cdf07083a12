"""Datasets in memory and Zarr archives on disk, both described from the record.

An archive is written beside its final name, as NAME.part, block by block; it takes its name only when it is
whole.  Its arrays have their full length from the beginning, each block is a shard of eight chunks, and a checkpoint
says how far the run is: a process killed at any instant leaves an archive that opens and can go on.  A manifest has the
SHA-256 of every file (`kreisel.storage.manifest`).  Archives are data: arrays and JSON, nothing that runs.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import math
import os
import stat
import warnings
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, Stopped, disk_trouble
from kreisel.kernels import layout
from kreisel.kernels.layout import Floats
from kreisel.method.observing import ORIENTATION
from kreisel.record.model import Model
from kreisel.runs.drift import KINDS
from kreisel.runs.march import March, Snapshot, block_rows, chunk_rows
from kreisel.runs.plan import Plan, make_plan
from kreisel.storage import checkpoint, manifest
from kreisel.storage.reading import an_object, order_of, parsed, place
from kreisel.storage.replacing import (
    LARGEST_METADATA,
    agree,
    agreed,
    part_of,
    remove,
    require_replaceable,
    settled,
    stands,
    take_name,
)

if TYPE_CHECKING:
    import xarray as xr

FORMAT = 1
MOST_SCALES = 4096  # numbers in an attribute
NEEDED = {  # attributes and their types
    **dict.fromkeys(("title", "system", "parameters", "start_sha256", "method", "options"), str),
    **dict.fromkeys(("n", "steps", "every", "rows_in_block", "projection"), int),
    **{"dt": float, "complete": bool},
}
MOST_INDEXED = 10**7  # times that are held in memory
LARGEST_CHUNK = 1 << 30  # bytes: a thousand times what is written
MANY_SAMPLES_N = 16  # beyond, there are fewer
MANY_LANES = 4096  # beyond, there are fewer: the largest over the lanes counts
SAMPLES = 16  # perturbations of a state that measure how an integral feels them
NUDGE, HAIR = 1e-6, 1e-12  # relative: far above round-off, and so small that only noise is left
MACHINE_EPSILON = float(np.finfo(np.float64).eps)


def dimensions(plan: Plan, name: str, shape: tuple[int, ...]) -> tuple[str, ...]:
    """Dimension names of an output of that shape."""
    lead = ("time", "lane") if plan.batched else ("time",)
    outcome = plan.scheme.outcomes[name]
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
    told = {
        "python": platform.python_version(),
        "processor": getattr(config, "CPU_NAME", None) or llvm.get_host_cpu_name(),
    }
    return told | {p: importlib.metadata.version(p) for p in packages}


def describe(plan: Plan) -> dict[str, Any]:
    """Attributes of a run: everything needed to know what it is and to repeat it."""
    model, system = plan.model, plan.model.system
    return {
        "Conventions": "CF-1.11",
        "title": f"{system.title}: {plan.scheme.name}",
        "source": f"kreisel {importlib.metadata.version('kreisel')}",
        "references": system.source + (f"; {system.map.source}" if system.map else ""),
        "kreisel_format": FORMAT,
        "system": system.name,
        "equations": system.equations,
        "components": json.dumps(dict(system.space.components)),
        "frame": system.frame.value,
        "bracket": "plus" if system.space.sign > 0 else "minus",
        "n": model.n,
        "parameters": json.dumps({k: v.tolist() for k, v in model.params.items()}),
        "start_sha256": checkpoint.hash_of_start(plan.start),
        "method": plan.scheme.name,
        "options": json.dumps(dict(plan.scheme.options or {})),
        "engine": plan.where,
        "projection": plan.engine.projection.every if plan.engine.projection else 0,
        "dt": plan.dt,
        "steps": plan.steps,
        "every": plan.every,
        "rows_in_block": block_rows(plan),
        "complete": True,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": json.dumps(versions()),
    }


def roundoff_scales(plan: Plan, first: Mapping[str, Array]) -> dict[str, dict[str, list[float]]]:
    """What rounding does to each Casimir and integral, in units of eps_machine.

    roundoff_scale    in a step: the root mean square, over up to 32 states of a lane in the first block, of the change
                      when every coordinate of a component moves by the component's largest, signs at random
    evaluation_scale  in computing it once from a state: its size, or the noise of its values if larger
    """
    z = _spread(plan, first)
    n = plan.model.n
    samples = SAMPLES if n <= MANY_SAMPLES_N else max(2, 16 * SAMPLES // n)  # every coordinate counts
    samples = max(1, min(samples, SAMPLES * MANY_LANES // plan.lanes))
    directions = np.random.default_rng(0).choice([-1.0, 1.0], (samples, *z.shape)) * _largest(plan, z)
    here = plan.observe(z)
    up, down = _moved(plan, z, NUDGE * directions), _moved(plan, z, -NUDGE * directions)
    a_bit_up, a_bit_down = _moved(plan, z, HAIR * directions), _moved(plan, z, -HAIR * directions)
    out = {}
    for name, outcome in plan.scheme.outcomes.items():
        if outcome.kind in KINDS:
            felt = np.sqrt((((up[name] - down[name]) / (2 * NUDGE)) ** 2).mean((0, 1)))
            noise = abs(a_bit_up[name] + a_bit_down[name] - 2 * here[name]) / (2 * MACHINE_EPSILON)
            if n > MANY_SAMPLES_N and noise.shape[-1] == layout.size("skew", n):
                noise = np.broadcast_to(noise.max(-1, keepdims=True), noise.shape)  # entries of one matrix
            computed = np.maximum(noise.max((0, 1)), abs(here[name]).max(0))
            out[name] = {"roundoff_scale": _listed(felt, plan), "evaluation_scale": _listed(computed, plan)}
    return out


def _moved(plan: Plan, z: Floats, by: Floats) -> dict[str, Array]:
    """Outputs at z + by for `by` (samples, rows, lanes, d); samples and rows in front."""
    outputs = plan.observe((z + by).reshape(-1, *z.shape[1:]))
    return {name: value.reshape((*by.shape[:2], *value.shape[1:])) for name, value in outputs.items()}


def _listed(scale: Array, plan: Plan) -> list[float]:
    """A scale for each part of an integral, lane after lane; the largest over the lanes if those are too many."""
    if plan.batched and scale.size > MOST_SCALES:
        scale = scale.max(0)
    return [float(v) for v in np.ravel(scale)]


def _largest(plan: Plan, z: Floats) -> Floats:
    """For each coordinate the largest of its component, in the shape of z."""
    parts = zip(layout.restore(z, plan.kinds, plan.model.n), plan.kinds, strict=True)
    flat = [abs(layout.flatten((part,), (kind,))) for part, kind in parts]
    return np.concatenate([np.broadcast_to(f.max(-1, keepdims=True), f.shape) for f in flat], -1)


def _spread(plan: Plan, first: Mapping[str, Array]) -> Floats:
    """Up to 32 rows of the first block, evenly spread, in the method's own variables (rows, lanes, d).

    Of more than 64 lanes, and for n > 16, fewer rows, down to one: some thousand numbers are enough.
    """
    count = min(32, max(1, 2048 // plan.lanes), max(1, 512 // plan.model.n))
    rows = np.unique(np.linspace(0, len(next(iter(first.values()))) - 1, count).astype(int))
    parts = []
    for letter, outcome in plan.scheme.outcomes.items():
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
    for name, outcome in plan.scheme.outcomes.items():
        out[name] = {"long_name": outcome.meaning, "kind": outcome.kind, "units": "1"}
        if name in scales:
            out[name] |= {"conserved": int(outcome.conserved), **scales[name]}
    return out


def times_of(rows: Floats, every: int, steps: int, dt: float) -> Floats:
    """Times of saved rows, k dt."""
    return np.asarray(np.minimum(rows * every, steps) * dt)


def saved_times(plan: Plan, first: int = 0, stop: int | None = None) -> Floats:
    """Times of the saved rows first to stop - 1."""
    rows = np.arange(first, plan.rows if stop is None else stop, dtype=np.float64)
    return times_of(rows, plan.every, plan.steps, plan.dt)


TIME = {"long_name": "time", "units": "1", "axis": "T"}


def in_memory(plan: Plan, blocks: list[dict[str, Array]], times: Floats | None = None) -> xr.Dataset:
    """Blocks of outputs as a Dataset, at the times of the saved steps unless others are given."""
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel

    attrs = attributes(plan, blocks[0])
    for name, largest in _corrections(plan).items():
        attrs[name][CORRECTION] = largest
    data = {}
    for name in plan.scheme.outcomes:
        value = np.concatenate([block.pop(name) for block in blocks])
        data[name] = (dimensions(plan, name, value.shape), value, attrs[name])
    coords: dict[str, Any] = {"time": ("time", saved_times(plan) if times is None else times, TIME)}
    if plan.batched:
        coords["lane"] = ("lane", np.arange(plan.lanes))
    return xr.Dataset(data, coords, describe(plan))


CORRECTION = "largest_correction"  # of the state, by the projection, in units of eps_machine |state|


def _corrections(plan: Plan) -> dict[str, float]:
    return plan.engine.projection.largest(plan.engine.z) if plan.engine.projection else {}


def open_run(path: str | os.PathLike[str]) -> xr.Dataset:
    """A run on disk, opened lazily as `kr.simulate` returns it, or a sweep; of an interrupted one what it has done.

    Every file is compared with its SHA-256 when it is read.  Raises `InputError` for what is not an archive of
    Kreisel, and, as it is opened or later as it is read, for one that is damaged (`kreisel check` says how).
    """
    where = settled(target(path))
    if is_sweep(where):
        from kreisel.sweeps.sweep import open_sweep

        return open_sweep(where)
    return open_archive(where)


def target(path: str | os.PathLike[str]) -> Path:
    """A path that can name an archive, with ~ for the user's own folder.  Raises `InputError`."""
    return place(path, "The archive needs a name such as run.zarr")


class Archive:
    """A Zarr store that grows block by block under NAME.part and gets its name when it is whole.

    `begun` continues a store that is there: rows up to the checkpoint are in it.
    """

    def __init__(
        self, path: Path, plan: Plan, overwrite: bool = False, begun: bool = False, rows_in_block: int | None = None
    ):
        self.path, self.part, self.plan = path, part_of(path), plan
        self._overwrite, self._begun, self._worth_keeping = overwrite, begun, begun
        self._start: dict[str, Floats] = dict(plan.start)
        self._rows_in_block = rows_in_block or block_rows(plan)
        self._folder = -1

    def __enter__(self) -> Archive:
        import zarr

        with self._disk("be opened again" if self._begun else "be created"):
            if not self._begun:
                self._make_room()
                told = {**describe(self.plan), "complete": False}
                group = zarr.create_group(str(self.part), zarr_format=3, attributes=told)
                group.create_group(checkpoint.NAME.split("/")[0])
                if self._overwrite:
                    agree(self.path)
                manifest.begin(self.part)
            try:
                self._group = zarr.open_group(str(self.part), mode="r+", zarr_format=3, use_consolidated=False)
            except OSError:
                raise
            except Exception as error:  # whatever a damaged store makes the libraries raise
                raise InputError(f"{self.part} is damaged: {error}. `kreisel check {self.part}`.") from error
            self._folder = os.open(self.part, os.O_RDONLY | os.O_DIRECTORY)
        return self

    def _make_room(self) -> None:
        require_replaceable(self.path)
        if stands(self.path) and not self._overwrite:
            raise InputError(
                f"{self.path} exists already and is left as it is. Choose another path, or replace it with --overwrite "
                "(overwrite=True)."
            )
        require_replaceable(self.part)
        if stands(self.part):
            if not self._overwrite and (self.part / checkpoint.NAME).exists():
                raise InputError(
                    f"{self.part} was left by a run that was interrupted. `kreisel resume {self.path}` goes on, "
                    f"`kreisel plot {self.part}` shows it; or start over with --overwrite (overwrite=True)."
                )
            remove(self.part)

    def _disk(self, what: str) -> _DiskTrouble:
        return _DiskTrouble(self, what)

    def _require_there(self) -> None:
        """Raises `RunError` where the store is no longer the folder that it was: Zarr would make a new one."""
        try:
            there = os.path.samestat(os.fstat(self._folder), os.stat(self.part))
        except OSError:
            there = False
        if not there:
            raise self._vanished()

    def _vanished(self, name: str = "") -> RunError:
        return RunError(
            f"{self.part / name} vanished during the run. Usual cause: somebody else removed it. Run it again."
        )

    def append(self, block: Mapping[str, Array], start: int) -> None:
        """Write a block of rows that begins at row `start`, a chunk or the last rows."""
        stop = start + len(next(iter(block.values())))
        values = {"time": saved_times(self.plan, start, stop), **block}
        number = start // self._rows_in_block
        with self._disk("be written"):
            self._require_there()
            names = [f"{name}/c/{number}{'/0' * (value.ndim - 1)}" for name, value in values.items()]
            if start == 0:
                names += self._create(values, {"time": TIME, **attributes(self.plan, block)})
            for name, value in values.items():
                array: Any = self._group.get(name)
                if array is None:
                    raise self._vanished(name)
                array[start:stop] = value
            manifest.add_block(self.part, number, names)
        self._worth_keeping = True

    def _create(self, values: Mapping[str, Array], attrs: Mapping[str, Mapping[str, Any]]) -> list[str]:
        """Every array at its full length, and the numbers of the lanes; the names of their chunks."""
        from zarr.codecs import Crc32cCodec, ZstdCodec

        block, rows = self._rows_in_block, self.plan.rows
        chunk = chunk_rows(block)
        codecs = [ZstdCodec(level=1), Crc32cCodec()]
        if self.plan.batched:
            lanes = np.arange(self.plan.lanes)
            self._group.create_array(
                "lane",
                data=lanes,
                chunks=lanes.shape,
                dimension_names=("lane",),
                compressors=codecs,
                attributes={"long_name": "lane"},
                config={"write_empty_chunks": True},
                overwrite=True,
            )
        for name, value in values.items():
            self._group.create_array(
                name,
                shape=(rows, *value.shape[1:]),
                chunks=(chunk, *value.shape[1:]),
                shards=(block, *value.shape[1:]) if chunk < block else None,
                dtype=value.dtype,
                dimension_names=("time",) if name == "time" else dimensions(self.plan, name, value.shape),
                compressors=codecs,
                attributes=dict(attrs[name]),
                fill_value=np.nan,
                overwrite=True,
            )
        manifest.begin(self.part)
        return ["lane/c/0"] if self.plan.batched else []

    def checkpoint(self, snapshot: Snapshot) -> None:
        """Write down where the run stands; everything before is kept whatever happens."""
        with self._disk("be written"):
            self._require_there()
            checkpoint.write(self.part, snapshot, self._start)

    def finish(self) -> None:
        """Mark the archive as whole and give it its name; with its last checkpoint it can be lengthened."""
        from kreisel.storage.verified import consolidated

        with self._disk("be finished"):
            self._require_there()
            of_variables = {name: {CORRECTION: value} for name, value in _corrections(self.plan).items()}
            consolidated(self.part, of_variables, complete=True)
            manifest.seal(self.part, [checkpoint.NAME])
            self._require_there()
            take_name(self.path)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._folder >= 0:
            os.close(self._folder)
        stopped = isinstance(error, Stopped | KeyboardInterrupt)
        if error is not None and not (stopped or self._worth_keeping):
            with contextlib.suppress(OSError, InputError):
                remove(self.part)


def reopen(path: Path, extend: int | None) -> tuple[Archive, March]:
    """An interrupted archive, or a finished one to be lengthened, and the run at its last checkpoint."""
    part = part_of(path)
    store = part if stands(part) else path
    attrs = read_attributes(store)
    require_sound(store)
    if store == part and stands(path) and not agreed(path):
        raise InputError(f"{path} stands where {part} is to go, and was not to be replaced. Move one of them away.")
    if store == path and extend is None:
        raise InputError(f"{path} is finished: its {attrs['steps']:,} steps are done. --extend STEPS lengthens it.")
    steps = attrs["steps"] if extend is None else extend
    if extend is not None and extend < attrs["steps"]:
        raise InputError(f"{path} has {attrs['steps']:,} steps: expected more for --extend, got {extend:,}.")
    snapshot, start, known = _checkpoint(store, attrs)
    plan = _plan(attrs, start, steps)
    block = attrs["rows_in_block"] if snapshot.flushed else block_rows(plan)
    march = _march(plan, block)
    march.restore(snapshot)
    if snapshot.flushed:
        _require_arrays(store, plan, attrs, known)
    archive = Archive(path, plan, begun=True, rows_in_block=block)
    with _DiskTrouble(archive, "be opened again"):
        if store == path:
            os.replace(path, part)
        _continue(part, plan, snapshot, block)
    return archive, march


def _checkpoint(store: Path, attrs: Mapping[str, Any]) -> tuple[Snapshot, dict[str, Floats], manifest.Listed]:
    """The checkpoint of a store, and its manifest.  Raises `InputError` where one is damaged, or of another run."""
    from kreisel.storage.verified import Verified

    snapshot, start = checkpoint.read(store)
    known = manifest.read(store)
    for name in ("zarr.json", *({checkpoint.NAME} & known.keys())):
        Verified(store, known).verify(name)
    if checkpoint.hash_of_start(start) != attrs["start_sha256"] or snapshot.flushed % attrs["rows_in_block"]:
        raise InputError(f"The checkpoint of {store} is not that of its run. Run it again from its TOML file.")
    return snapshot, start, known


def _march(plan: Plan, rows_in_block: int) -> March:
    if rows_in_block * plan.engine.z.nbytes > LARGEST_CHUNK:
        raise InputError(f"The attribute rows_in_block = {rows_in_block:,} is damaged: no run has such blocks.")
    return March(plan, rows_in_block=rows_in_block)


def _require_arrays(store: Path, plan: Plan, attrs: Mapping[str, Any], known: manifest.Listed) -> None:
    """Raises `InputError` where a store that is to be written to has not the arrays of its run."""
    run = opened(store, known)
    outputs = {"time": np.zeros(1), **plan.observe(plan.engine.z[None])}
    for name, value in outputs.items():
        variable = run.variables.get(name)
        good = variable is not None and variable.dtype == np.float64 and variable.shape[1:] == value.shape[1:]
        whole = None if variable is None else variable.encoding.get("shards") or variable.encoding["chunks"]
        if not good or whole != (attrs["rows_in_block"], *value.shape[1:]):
            raise InputError(f"{store} is damaged: {name} is not as the run made it. `kreisel check {store}`.")


def _continue(part: Path, plan: Plan, snapshot: Snapshot, block: int) -> None:
    """Make a store ready to go on after its finished blocks: not complete any more, and as long as the plan."""
    from kreisel.storage.verified import edited

    manifest.unseal(part, snapshot.flushed // block)
    known = manifest.listed(part)
    for path in [path for path in part.rglob("*") if not path.is_dir()]:
        name = path.relative_to(part).as_posix()
        if manifest.is_scratch(name) or (manifest.is_chunk(name) and name not in known):
            path.unlink()  # what a kill left, half written or not yet listed
    changed = json.dumps(versions())
    with edited(part) as group:
        resumed = {} if group.attrs["versions"] == changed else {"resumed": changed}
        group.attrs.update({"complete": False, "steps": plan.steps, "rows_in_block": block, **resumed})
        for _, array in group.arrays() if snapshot.flushed else ():
            if array.metadata.dimension_names[0] == "time" and array.shape[0] != plan.rows:
                array.resize((plan.rows, *array.shape[1:]))


class _DiskTrouble:
    """Turns what the file system says into one message with the fix."""

    def __init__(self, archive: Archive, what: str):
        self._archive, self._what = archive, what

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, OSError):
            archive = self._archive
            kept = ""
            if (archive.part / checkpoint.NAME).exists():
                kept = f" What was done until the last checkpoint is kept: `kreisel resume {archive.path}` goes on."
            raise disk_trouble(error, archive.path, self._what, kept) from error


def metadata(store: Path) -> dict[str, Any]:
    """The attributes of a Zarr store, not yet checked.  Raises `InputError` where there is none."""
    if not stands(store):
        there = bool(store.name) and store.suffix != ".part" and stands(part_of(store))
        left = f" {part_of(store)} is there: `kreisel resume {store}` goes on." if there else ""
        raise InputError(f"There is no archive {store}. Run `kreisel run` first, or check the name.{left}")
    attrs = _node(store).get("attributes")
    return attrs if isinstance(attrs, dict) else {}


def _node(folder: Path) -> dict[str, Any]:
    """The zarr.json of a group or an array.  Raises `InputError`."""
    path = folder / "zarr.json"
    try:
        size = path.stat().st_size
        if not manifest.is_plain(path):
            raise InputError(f"{folder} is damaged: its zarr.json is no plain file.")
        if size > LARGEST_METADATA:
            raise InputError(f"{folder} is damaged: its zarr.json has {size:,} bytes.")
        told = parsed(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"{folder} cannot be read as a Zarr archive: {error}") from error
    if not isinstance(told, dict):
        raise InputError(f"{path} is damaged: expected an object, got {str(told)[:80]}.")
    return told


def require_sound(store: Path) -> None:
    """Raises `InputError` where a store holds links, pipes or devices, or metadata that Zarr does not understand.

    What is read and written through links is not in the store.  Each node is opened alone: Zarr opens those of a group
    at the same time, and leaves the others behind, with their tracebacks, when one of them fails.
    """
    import zarr

    for folder, folders, files in os.walk(store):
        for name in (*folders, *files):
            try:
                mode = os.lstat(os.path.join(folder, name)).st_mode
            except OSError as error:
                raise InputError(f"{store} cannot be read: {folder}/{name}: {error.strerror}.") from error
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                what = "a link" if stat.S_ISLNK(mode) else "a pipe, a socket or a device"
                raise InputError(f"{store} holds {what}, {os.path.join(folder, name)}. An archive has no use for one.")
        if "zarr.json" not in files:
            continue
        kind = _node(Path(folder)).get("node_type")
        axes: tuple[str | None, ...] = ()
        if kind not in ("array", "group"):
            raise InputError(f"{folder}/zarr.json is damaged: node_type must be array or group, got {str(kind)[:80]}.")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                if kind == "array":
                    told = zarr.open_array(folder, mode="r", zarr_format=3).metadata
                    axes = getattr(told, "dimension_names", None) or ()
                else:
                    zarr.open_group(folder, mode="r", zarr_format=3, use_consolidated=False)
        except Exception as error:  # whatever damaged metadata make the library raise
            why = str(error) or type(error).__name__
            raise InputError(f"{folder}/zarr.json cannot be read as Zarr's metadata: {why}") from error
        if None in axes:
            raise InputError(f"{folder}/zarr.json is damaged: an axis in dimension_names has no name.")


def too_large(run: xr.Dataset) -> list[str]:
    """The variables whose chunks claim to be too large to be read, each in one sentence."""
    found = []
    for name, variable in run.variables.items():
        shapes = [variable.encoding.get(key) for key in ("shards", "chunks")]
        size = max((math.prod(shape) for shape in shapes if shape), default=0) * variable.dtype.itemsize
        if size > LARGEST_CHUNK:
            found.append(f"{name} claims to have chunks of {size:,} bytes: not read")
    return found


def is_sweep(store: Path) -> bool:
    """Whether a store says of itself that it is a sweep."""
    return "kreisel_sweep" in metadata(store)


def read_attributes(store: Path) -> dict[str, Any]:
    """The attributes of an archive, checked.  Raises `InputError` for what is not one."""
    attrs = metadata(store)
    if "kreisel_sweep" in attrs:
        raise InputError(f"{store} is a sweep: `kreisel check` reads it, and kr.open_run opens it by lane.")
    if attrs.get("kreisel_format") != FORMAT:
        raise InputError(f"{store} is not an archive of Kreisel (no kreisel_format = {FORMAT} among its attributes).")
    missing = [key for key in NEEDED if key not in attrs]
    wrong = [key for key, kind in NEEDED.items() if key not in missing and not isinstance(attrs[key], kind)]
    wrong += [key for key in ("steps", "every", "n", "rows_in_block") if key not in missing + wrong and attrs[key] < 1]
    if missing or wrong:
        told = f"lack {', '.join(missing)}" if missing else f"are wrong in {', '.join(wrong)}"
        raise InputError(f"{store} is damaged: its attributes {told}. Make it again from its TOML file.")
    return attrs


def open_archive(path: Path, indexed: bool = True) -> xr.Dataset:
    """A run on disk, opened lazily; of an interrupted one all rows until its last checkpoint.

    With `indexed` the times are read, if there are less than ten million, so that rows can be chosen by time.  Raises
    `InputError` for what is not a Kreisel archive, and for one that is damaged, here or when the damage is read.
    """
    attrs = read_attributes(path)
    require_sound(path)
    run = _until_checkpoint(path, attrs) if is_cut(path, attrs) else opened(path, manifest.read(path), True)
    for name, variable in run.data_vars.items():
        if variable.attrs.get("kind") in KINDS and variable.dims[:1] != ("time",):
            raise InputError(f"{path} is damaged: {name} has no axis of time. `kreisel check {path}`.")
    if indexed and too_large(run):
        raise InputError(f"{path} is damaged: {'; '.join(too_large(run))}.")
    for name in ("time", "lane"):
        known_place = name in run.dims and name in run.variables and run.sizes[name] <= MOST_INDEXED
        if indexed and known_place and name not in run.xindexes:
            try:
                run = run.set_xindex(name)
            except Exception as error:  # whatever a damaged chunk makes the libraries raise
                raise InputError(f"{path} is damaged, {name} cannot be read: {error}") from error
    return ordered(run)


def ordered(run: xr.Dataset) -> xr.Dataset:
    """States first, then the orientation, Casimirs and integrals."""
    return run[sorted(run.data_vars, key=lambda name: (_place(run[name]), str(name)))]


def is_cut(store: Path, attrs: Mapping[str, Any]) -> bool:
    """Whether a run was interrupted, by its attributes and its manifest; what was recovered is whole by itself."""
    unsealed = manifest.begun(store) and not manifest.whole(store)
    return "recovered" not in attrs and (unsealed or not attrs["complete"])


def opened(path: Path, known: manifest.Listed | None, every_array: bool = False) -> xr.Dataset:
    """The arrays of a store as they are, each file compared with the manifest when it is read, if there is one.

    With `every_array` those that are listed must be there.  Raises `InputError`.
    """
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel
    from kreisel.storage.verified import Verified

    store: Any = path
    if known is not None:
        store = Verified(path, known)
        for name in manifest.metadata_files(path) + [n for n in known if every_array and n.endswith("zarr.json")]:
            store.verify(name)
    lengths = _lengths(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if len(set(lengths.values())) < 2:
                return xr.open_dataset(store, **READING)
            parts = [xr.open_dataset(store, drop_variables=set(lengths) - {name}, **READING) for name in lengths]
    except InputError:
        raise
    except Exception as error:  # whatever a damaged store makes the libraries raise
        raise InputError(f"{path} cannot be read as a Zarr archive: {error}") from error
    return xr.merge([part.isel(time=slice(0, min(lengths.values()))) for part in parts], combine_attrs="override")


READING: dict[str, Any] = {
    "engine": "zarr",
    "consolidated": False,
    "cache": False,
    "mask_and_scale": False,
    "create_default_indexes": False,
}


def _lengths(store: Path) -> dict[str, int]:
    """The rows of each array; a kill may leave a run that is being lengthened with some of the new length."""
    found = {}
    for path in store.glob("*/zarr.json"):
        told = _node(path.parent)
        dims, shape = told.get("dimension_names"), told.get("shape")
        if isinstance(dims, list) and isinstance(shape, list) and dims[:1] == ["time"] and shape:
            found[path.parent.name] = shape[0] if isinstance(shape[0], int) else 0
    return found


def _until_checkpoint(path: Path, attrs: Mapping[str, Any]) -> xr.Dataset:
    """The finished blocks of an interrupted run, and the rows after them, which only its checkpoint has."""
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel
    from kreisel.storage.continued import continued

    attrs = {**attrs, "complete": False}
    snapshot, start, known = _checkpoint(path, attrs)
    first = snapshot.flushed
    whole = opened(path, known, True).isel(time=slice(0, first)) if first else xr.Dataset(attrs=attrs)
    if len(snapshot.rows) == 0 or is_own(attrs):
        return whole.assign_attrs(attrs)
    plan = _plan(attrs, start, attrs["steps"])
    _march(plan, attrs["rows_in_block"]).restore(snapshot)  # which looks at it
    times = saved_times(plan, first, first + len(snapshot.rows))
    rest = in_memory(plan, [plan.observe(snapshot.rows)], times)
    if not first:
        return rest.assign_attrs(attrs)
    _require_arrays(path, plan, attrs, known)
    joined = {
        name: continued(variable, rest[name].variable) if "time" in variable.dims else variable
        for name, variable in whole.variables.items()
        if name in rest.variables
    }
    coords = {name: joined.pop(name) for name in whole.coords if name in joined}
    return xr.Dataset(joined, xr.Coordinates(coords, indexes={}), attrs)


def _place(variable: xr.DataArray) -> int:
    """States first, then the orientation, Casimirs, integrals, and what a user has added."""
    order, kind = ("state", "orientation", *KINDS), variable.attrs.get("kind")
    return order.index(kind) if kind in order else len(order)


def is_own(attrs: Mapping[str, Any]) -> bool:
    """Whether a run is of a system of the user's own: an archive holds no code, so its model is not at hand."""
    from kreisel.system import REGISTRY

    return attrs["system"] not in REGISTRY


def model_of(attrs: Mapping[str, Any]) -> Model:
    """The model that a run was made from, by its attributes.

    Raises `InputError` where they are damaged, and for a system of the user's own.
    """
    from kreisel.system import find

    if is_own(attrs):
        raise InputError(
            f"{attrs['system']} is none of Kreisel's systems, and an archive holds no code. For a system of your own, "
            "run its TOML file or kr.simulate again with more steps."
        )
    return find(attrs["system"])(**an_object(attrs, "parameters"))


def _plan(attrs: Mapping[str, Any], start: Mapping[str, Floats], steps: int) -> Plan:
    """The plan of a run from its attributes and its start."""
    return make_plan(
        model_of(attrs),
        {letter: value for letter, value in start.items() if letter != ORIENTATION},
        dt=attrs["dt"],
        steps=steps,
        every=attrs["every"],
        method=attrs["method"],
        order=order_of(attrs),
        orientation=start.get(ORIENTATION),
        engine=attrs.get("engine", "cpu"),
        project=attrs["projection"] > 0,
    )
