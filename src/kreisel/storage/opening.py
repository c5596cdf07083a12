"""Archives opened: their complete part, as a dataset that is read lazily, each file compared with its SHA-256.

The checkpoint of an archive, from which its run resumes after a kill, is one file next to the data: plain arrays (.npz
without pickle; zip keeps a CRC-32 of each), replaced atomically.
"""

from __future__ import annotations

import asyncio
import io
import math
import os
import stat
import tokenize
import warnings
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import msgspec
import numpy as np
from zarr.core.buffer import Buffer, BufferPrototype, cpu, default_buffer_prototype
from zarr.storage import LocalStore, MemoryStore

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.files import digest, parsed, replace_file
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import KINDS
from kreisel.runs.describing import hash_of_start, with_indexes
from kreisel.runs.geometry import presented
from kreisel.runs.integration import Snapshot
from kreisel.runs.run_record import FORMAT, RunRecord
from kreisel.storage import archive
from kreisel.storage.archive import CHECKPOINT, LARGEST_CHUNK, Listed

if TYPE_CHECKING:
    import xarray as xr

NEEDED = {  # attributes of a run and their types
    **dict.fromkeys(("title", "system", "parameters", "start_sha256", "method", "options"), str),
    **dict.fromkeys(("n", "steps", "every", "rows_in_block", "projection"), int),
    **{"dt": float, "complete": int},
}
MOST_INDEXED = 10**7  # times that are held in memory
COMPUTED, FAILED, MISSING = 0, 1, 255  # values of the variable `failed` of a sweep
SWEEP_FORMAT = 1
Count = Annotated[int, msgspec.Meta(ge=1)]
REMEDY = "`kreisel check` reports the other damage; --recover saves the intact rows."
REOPENED = " If it was resumed since you opened it, open it again."

# Exceptions of zipfile and NumPy for a damaged .npz: NotImplementedError for an unknown kind of compression or
# encryption, the last three if the header of an array, a Python literal, is never closed or nested too deeply.
DAMAGE = (
    OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError, NotImplementedError, tokenize.TokenError,
    RecursionError, MemoryError,
)  # fmt: skip


class SweepRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The attributes of a sweep by name."""

    Conventions: str = "CF-1.11"
    title: str
    source: str
    references: str
    kreisel_sweep: int = SWEEP_FORMAT
    system: str
    equations: str
    body: str | None = None  # JSON, as of a run
    frame: str
    n: int
    sweep: str  # JSON
    lanes: Count
    block_lanes: Count
    complete: int = 0  # an integer: NetCDF has no truth values
    created: str
    versions: str  # JSON
    failed_lanes: int | None = None  # of a complete one
    resumed: str | None = None  # JSON: the versions that resumed it, if they differ

    @classmethod
    def from_attrs(cls, attrs: Mapping[str, Any], where: object) -> SweepRecord:
        """The record in attributes, checked.  Raises `InputError` for attributes that are damaged or not of a sweep."""
        if attrs.get("kreisel_sweep") != SWEEP_FORMAT:
            raise InputError(f"{where} is not a sweep of Kreisel (no kreisel_sweep = {SWEEP_FORMAT} as an attribute).")
        try:
            record = msgspec.convert(dict(attrs), cls)
        except msgspec.ValidationError as error:
            raise InputError(f"{where} is damaged: in its attributes, {error}.") from None
        if record.complete and record.failed_lanes is None:
            raise InputError(f"{where} is damaged: it is complete, but its attributes lack failed_lanes.")
        return record

    @classmethod
    def of_store(cls, store: Path) -> SweepRecord:
        """The record of an archive on disk.  Raises `InputError`."""
        return cls.from_attrs(archive.attributes(store), store)

    def to_attrs(self) -> dict[str, Any]:
        """The attributes."""
        return {name: value for name, value in msgspec.structs.asdict(self).items() if value is not None}

    @property
    def description(self) -> Any:
        """The sections system, state, run and sweep.  Raises `InputError` for damaged text."""
        return parsed(self.sweep, "The attribute sweep")

    @property
    def blocks(self) -> int:
        """The number of blocks."""
        return -(-self.lanes // self.block_lanes)


def is_sweep(store: Path) -> bool:
    """Whether an archive is marked as a sweep."""
    return "kreisel_sweep" in archive.attributes(store)


def run_record(store: Path) -> RunRecord:
    """The record of a run in its archive, checked.  Raises `InputError` for anything else."""
    attrs = archive.attributes(store)
    if "kreisel_sweep" in attrs:
        raise InputError(
            f"{store} is a sweep: `kreisel check` reads it, and kr.open_run opens it by lane; the `kreisel sweep` or "
            "kr.sweep that began it resumes it."
        )
    if isinstance(later := attrs.get("kreisel_format"), int) and later > FORMAT:
        raise InputError(
            f"{store} has the format {later} of a later version of Kreisel, expected {FORMAT}. Update Kreisel."
        )
    if attrs.get("kreisel_format") != FORMAT:
        raise InputError(f"{store} is not an archive of Kreisel (no kreisel_format = {FORMAT} among its attributes).")
    missing = [key for key in NEEDED if key not in attrs]
    wrong = [key for key, kind in NEEDED.items() if key not in missing and not isinstance(attrs[key], kind)]
    wrong += [key for key in ("steps", "every", "n", "rows_in_block") if key not in missing + wrong and attrs[key] < 1]
    if missing or wrong:
        fault = f"lack {', '.join(missing)}" if missing else f"are wrong in {', '.join(wrong)}"
        raise InputError(f"{store} is damaged: its attributes {fault}. Run it again.")
    return RunRecord.from_attrs(attrs)


def too_large(run: xr.Dataset) -> list[str]:
    """The variables whose chunks claim to be too large to be read, each in one sentence."""
    faults = []
    for name, variable in run.variables.items():
        shapes = [variable.encoding.get(key) for key in ("shards", "chunks")]
        size = max((math.prod(shape) for shape in shapes if shape), default=0) * variable.dtype.itemsize
        if size > LARGEST_CHUNK:
            faults.append(f"{name} claims to have chunks of {size:,} bytes: not read")
    return faults


def _sound(run: xr.Dataset, path: Path) -> xr.Dataset:
    """The Dataset without the layout of its files, with which no part of it and no other format could be written.

    Raises `InputError` for chunks that are too large to be read.
    """
    if too_large(run):
        raise InputError(f"{path} is damaged: {'; '.join(too_large(run))}.")
    return run.drop_encoding()


def open_archive(path: Path) -> xr.Dataset:
    """Open a run, as `open_rows` does, or a sweep by lane; if it was interrupted, its finished part."""
    path = archive.settled(path)
    return presented(open_lanes(path) if is_sweep(path) else open_rows(path))


def open_lanes(path: Path, checked: bool = True) -> xr.Dataset:
    """The Dataset of a sweep, opened lazily; lanes of missing blocks have failed = 255.  Raises `InputError`."""
    record = SweepRecord.of_store(path)
    archive.require_plain(path)
    run = dataset(path, Verified(path, archive.listed(path), partial=not record.complete))
    return _sound(run, path) if checked else run


def open_rows(path: Path, indexed: bool = True) -> xr.Dataset:
    """Open a run on disk lazily; if it was interrupted, all rows until its last checkpoint.

    With `indexed` the times are read, if there are fewer than ten million, so that rows can be chosen by time.  Raises
    `InputError` for anything but a Kreisel archive, and for a damaged one, here or when the damage is read.
    """
    record = run_record(path)
    archive.require_plain(path)
    listed = archive.listed(path)
    cut = is_cut(path, record)  # an archive with the attribute `complete` has all its rows, and was not sealed
    run = _until_checkpoint(path, record, listed) if cut and not record.complete else opened(path, listed)
    run = run.assign_attrs(complete=0) if cut else run
    for name, variable in run.data_vars.items():
        if variable.attrs.get("kind") in KINDS and variable.dims[:1] != ("time",):
            raise InputError(f"{path} is damaged: {name} has no axis of time. `kreisel check {path}`.")
    run = _sound(run, path) if indexed else run
    for name in ("time", "lane"):
        short = name in run.dims and name in run.variables and run.sizes[name] <= MOST_INDEXED
        if indexed and short and name not in run.xindexes:
            try:
                run = with_indexes(run, run.variables[name])
            except Exception as error:  # any exception of the libraries for a damaged chunk
                raise InputError(f"{path} is damaged, {name} cannot be read: {error}") from error
    return ordered(run)


def ordered(run: xr.Dataset) -> xr.Dataset:
    """The variables in order: states, the orientation, Casimirs, integrals, and additions of the user."""
    order = ("state", "orientation", *KINDS)

    def place(name: Any) -> tuple[int, str]:
        kind = run[name].attrs.get("kind")
        return order.index(kind) if kind in order else len(order), str(name)

    return run[sorted(run.data_vars, key=place)]


def is_cut(store: Path, record: RunRecord) -> bool:
    """Whether a run was interrupted, by its record and its checksums; a recovered archive counts as complete."""
    unsealed = archive.begun(store) and not archive.is_complete(store)
    return record.recovered is None and (unsealed or not record.complete)


def checked_checkpoint(store: Path, record: RunRecord, listed: Listed) -> Checkpoint:
    """The checkpoint of a run.  Raises `InputError` if it is damaged, or belongs to another run."""
    point = read_checkpoint(store)
    for name in ("zarr.json", *({CHECKPOINT} & listed.keys())):
        Verified(store, listed).verify(name)
    flushed, block = point.snapshot.flushed, record.rows_in_block
    if hash_of_start(point.start) != record.start_sha256 or flushed % block:
        raise InputError(f"The checkpoint of {store} does not belong to its run. Run it again.")
    if any(f"time/c/{k}" not in listed for k in range(flushed // block)):
        raise InputError(f"{store} is damaged: blocks before its checkpoint are missing. `kreisel check {store}`.")
    return point


def _until_checkpoint(path: Path, record: RunRecord, listed: Listed) -> xr.Dataset:
    import zarr

    point = checked_checkpoint(path, record, listed)
    files: dict[str, Buffer] = {"zarr.json": cpu.Buffer.from_bytes((path / "zarr.json").read_bytes())}
    first = point.snapshot.flushed
    stop = first + min((len(value) for value in point.outputs.values()), default=0)
    try:
        group = zarr.open_group(MemoryStore(files), mode="r+", zarr_format=3, use_consolidated=True)
        arrays: list[tuple[str, Any]] = list(group.arrays())
        for name, array in arrays:
            if "time" in (array.metadata.dimension_names or ()) and stop > first:
                array[first:stop] = point.outputs[name][: stop - first]
    except Exception as error:  # any exception of the libraries for outputs that fit no array
        raise InputError(f"The checkpoint of {path} is damaged: its rows fit no array, {error}.") from error
    return opened(path, listed, files=files).isel(time=slice(0, stop))


# -- files, each compared with its checksum -------------------------------------------------------------


class Damaged(InputError):
    """A file of an archive that has changed since it was written; `why` is a clause."""

    why = ""


class Verified(LocalStore):
    """A store for reading: a file that is changed, missing or added raises `InputError`.

    partial   chunks that are not listed are not read: their blocks are missing, or being written
    files     files that need precedence: the rows of an interrupted run after its last block
    """

    def __init__(self, root: Path | str, listed: Listed, partial: bool = False, files: dict[str, Buffer] | None = None):
        super().__init__(root, read_only=True)
        self._listed, self._partial, self._files = listed, partial, files or {}
        self._seen: dict[str, tuple[int, ...]] = {}

    def with_read_only(self, read_only: bool = False) -> Verified:
        """The store itself, which is never written to."""
        return self

    def _damaged(self, why: str) -> Damaged:
        error = Damaged(f"{self.root} is damaged: {why}. {REMEDY}{REOPENED}")
        error.why = why
        return error

    def verify(self, key: str) -> None:
        """Compare a file with its checksum, again only if it changes."""
        path, digests = self.root / key, self._listed.get(key)
        try:
            status = os.lstat(path)
            if digests is None:
                raise self._damaged(f"{key} was added after the run")
            if not stat.S_ISREG(status.st_mode):
                raise self._damaged(f"{key} is not a plain file")
            mark = (status.st_ino, status.st_size, status.st_mtime_ns)
            if self._seen.get(key) == mark:
                return
            if digest(path) not in digests:
                raise self._damaged(f"{key} was changed after the run")
            self._seen[key] = mark
        except (FileNotFoundError, NotADirectoryError):
            if digests is not None or archive.is_chunk(key):
                raise self._damaged(f"{key} is missing") from None
        except OSError as error:
            raise InputError(f"{self.root} cannot be read: {key}: {error.strerror}.") from error

    def get_sync(self, key: str, *, prototype: BufferPrototype | None = None, byte_range: Any = None) -> Buffer | None:
        """The file from Zarr's store, if it has not changed.  Raises `InputError`."""
        if key in self._files:
            return MemoryStore(self._files).get_sync(key, prototype=prototype, byte_range=byte_range)
        if self._partial and key not in self._listed and archive.is_chunk(key):
            return None
        self.verify(key)
        return super().get_sync(key, prototype=prototype, byte_range=byte_range)

    async def get(self, key: str, prototype: BufferPrototype | None = None, byte_range: Any = None) -> Buffer | None:
        """The file of that key, as `get_sync`."""
        prototype = prototype or default_buffer_prototype()
        return await asyncio.to_thread(self.get_sync, key, prototype=prototype, byte_range=byte_range)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, Any]]
    ) -> list[Buffer | None]:
        """Several files, as `get_sync`."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]


def dataset(path: Path, store: Any, **options: Any) -> xr.Dataset:
    """The arrays of a store of that path, read on access.  Raises `InputError` for damaged ones."""
    import xarray as xr

    import kreisel.runs.accessor  # noqa: F401 - run.kreisel

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return xr.open_dataset(
                store, engine="zarr", consolidated=True, cache=False, mask_and_scale=False, zarr_format=3, **options
            )
    except InputError:
        raise
    except Exception as error:  # any exception of the libraries for a damaged store
        raise InputError(f"{path} cannot be read as a Zarr archive: {error}") from error


def opened(path: Path, listed: Listed | None, files: dict[str, Buffer] | None = None) -> xr.Dataset:
    """The unchanged arrays of an archive, without indexes; compared with its checksums if these are known."""
    store: Any = path if listed is None else Verified(path, listed, files=files)
    return dataset(path, store, create_default_indexes=False)


# -- checkpoints ------------------------------------------------------------------------------------------


class Checkpoint(NamedTuple):
    """A snapshot, the start of the run, and the outputs of the snapshot's rows, which no block has yet."""

    snapshot: Snapshot
    start: Mapping[str, Floats]
    outputs: Mapping[str, Array]


def write_checkpoint(store: Path, point: Checkpoint) -> None:
    """Replace the checkpoint of an archive, atomically and durably."""
    snapshot, data = point.snapshot, io.BytesIO()
    arrays = {"flushed": np.asarray(snapshot.flushed), "into": np.asarray(snapshot.into), "rows": snapshot.rows}
    for group, values in (("engine", snapshot.engine), ("start", point.start), ("outputs", point.outputs)):
        arrays |= {f"{group}/{name}": value for name, value in values.items()}
    np.savez(data, allow_pickle=False, **arrays)
    replace_file(store / CHECKPOINT, data.getvalue(), durable=True)


def read_checkpoint(store: Path) -> Checkpoint:
    """The checkpoint of an archive.  Raises `InputError` if there is none, or it is damaged."""
    path = store / CHECKPOINT
    if not path.exists():
        raise InputError(f"{store} has no checkpoint to resume from. Run it again.")
    try:
        arrays = _arrays(path)
        engine, start, outputs = (
            {k.split("/", 1)[1]: v for k, v in arrays.items() if k.startswith(f"{group}/")}
            for group in ("engine", "start", "outputs")
        )
        return Checkpoint(Snapshot(int(arrays["flushed"]), int(arrays["into"]), arrays["rows"], engine), start, outputs)
    except DAMAGE as error:
        raise InputError(f"The checkpoint {path} is damaged: {error}. Run it again.") from error


def _arrays(path: Path) -> dict[str, Any]:
    """The arrays of an .npz file, each as long as the file has bytes for it.  Raises `ValueError` for other files."""
    out = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.compress_type != zipfile.ZIP_STORED or member.file_size > path.stat().st_size:
                raise ValueError(f"{member.filename} claims {member.file_size:,} bytes")
            data = io.BytesIO(archive.read(member))  # this verifies the CRC
            version = np.lib.format.read_magic(data)
            if version != (1, 0):
                raise ValueError(f"{member.filename} is not an array")
            shape, _, dtype = np.lib.format.read_array_header_1_0(data)
            if dtype.kind not in "iuf" or math.prod(shape) * dtype.itemsize != member.file_size - data.tell():
                raise ValueError(f"{member.filename} claims to hold {shape} of {dtype}")
            data.seek(0)
            out[member.filename.removesuffix(".npy")] = np.lib.format.read_array(data, allow_pickle=False)
    return out
