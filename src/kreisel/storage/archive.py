"""An archive on disk: a Zarr store whose arrays have blocks along one axis, the rows of a run or the lanes of a sweep.

    zarr.json                 the attributes, and the metadata of every array, which Zarr calls consolidated
    ARRAY/zarr.json           the metadata of an array once more, for readers that open only it
    ARRAY/c/...               a file for each block, a chunk or a shard of several
    engine/checksums.sha256   SHA-256 of every file, each chunk bound to its place; `sha256sum -c` reads it
    engine/blocks/K.sha256    SHA-256 of the files of block K, during the run

An archive is written as NAME.part and renamed to NAME when it is complete.  Its arrays have their full length from the
beginning.  A file gets its name after it is written, a block counts once its checksums exist, and all metadata change
at once, with zarr.json; the checksums of a file are listed before it changes.  A kill at any moment therefore leaves
listed files and complete blocks.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import stat
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError
from kreisel.files import BLOCKS, CHECKSUMS, digest, is_plain, parsed, place, replace_file, require_outside, stands
from kreisel.process import Lock

REPLACES = "engine/replaces"  # of an unfinished archive: the archive that it may replace
LARGEST_METADATA = 64 << 20  # bytes of a zarr.json: the parameters of an ensemble may be long
PARTIAL = r"(\.[0-9a-f]{32}\.partial)?"  # left by a kill: a file that Zarr was writing
CHUNK = re.compile(rf"[^/]+/c(/\d+)*{PARTIAL}")
MADE = re.compile(
    rf"([^/]+/)?zarr(\.json|\.[0-9a-f]{{32}}\.partial)|{CHUNK.pattern}"
    r"|engine/(checkpoint\.npz|checksums\.sha256|replaces|blocks/(\.new-[0-9a-f]{16}|\w+\.sha256))|([^/]+/)?\.new-[0-9a-f]{16}"
)
CHECKPOINT = "engine/checkpoint.npz"
LINE = re.compile(r"([0-9a-f]{64})  ([^\0\n]+)")
EXPORTS = (".nc", ".h5", ".parquet", ".csv", ".npz")  # endings of tables and arrays that `kr.export` writes
LARGEST_LIST, LARGEST_CHUNK = 1 << 30, 1 << 30  # bytes; chunks have a thousandth

Listed = dict[str, frozenset[str]]  # the files of an archive, and the allowed SHA-256 of each


def target(path: str | os.PathLike[str]) -> Path:
    """A path that can name an archive, with ~ for the home folder.  Raises `InputError`."""
    return place(path, "The archive needs a name such as run.zarr")


def new_target(path: str | os.PathLike[str]) -> Path:
    """A path that can name a new archive.  Raises `InputError`, also for the name of an export."""
    where = target(path)
    if where.suffix.lower() in EXPORTS:
        store = where.with_suffix(".zarr")
        raise InputError(
            f"path: expected the name of a Zarr archive, such as {store}, got {where}. Use path='{store}', then "
            f"kr.export('{store}', '{where}') (kreisel export {store} {where})."
        )
    return where


# -- metadata ----------------------------------------------------------------------------------------


class Node(msgspec.Struct):
    """The metadata of an array or a group, as far as they are read."""

    node_type: str
    attributes: dict[str, Any]
    shape: tuple[int, ...] = ()
    dimension_names: tuple[str, ...] = ()


class Consolidated(msgspec.Struct):
    """The metadata of every array."""

    metadata: dict[str, Node]


class Root(msgspec.Struct):
    """The metadata of an archive."""

    attributes: dict[str, Any]
    consolidated_metadata: Consolidated


def metadata(store: Path) -> dict[str, Any]:
    """The metadata of an archive and all its arrays, as JSON.  Raises `InputError` if there are none, or damaged."""
    if not stands(store):
        unfinished = bool(store.name) and store.suffix != ".part" and stands(part_of(store))
        sweep = unfinished and "kreisel_sweep" in (_attributes(part_of(store)) or ())
        way = "the `kreisel sweep` or kr.sweep that began it" if sweep else f"`kreisel resume {store}`"
        left = f" {part_of(store)} is there: {way} resumes it." if unfinished else ""
        raise InputError(f"There is no archive {store}. Run `kreisel run` first, or check the name.{left}")
    path = store / "zarr.json"
    try:
        size = path.stat().st_size
        if not is_plain(path) or size > LARGEST_METADATA:
            raise InputError(f"{store} is damaged: its zarr.json is not a plain file, or has {size:,} bytes.")
        root = parsed(path.read_bytes(), str(path))
        msgspec.convert(root, Root)
    except OSError as error:
        raise InputError(
            f"{store}: expected an archive, the folder that `kreisel run` writes, such as run.zarr; got a path that "
            f"cannot be read as one: {error}"
        ) from error
    except msgspec.ValidationError as error:
        cause = "another program wrote to the archive, or made it; xr.open_zarr opens it if it is complete"
        raise InputError(f"{path} is damaged: {error}. Usual cause: {cause}.") from None
    return dict(root)


def attributes(store: Path) -> dict[str, Any]:
    """The attributes of an archive, not yet checked.  Raises `InputError`."""
    return dict(metadata(store)["attributes"])


def arrays_of(root: Mapping[str, Any]) -> dict[str, Any]:
    """The metadata of every array."""
    nodes = root["consolidated_metadata"]["metadata"]
    return {name: node for name, node in nodes.items() if node["node_type"] == "array"}


def new_metadata(attrs: Mapping[str, Any], layouts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The metadata of a new archive, in the form of Zarr."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    files: dict[str, Any] = {}
    group = zarr.create_group(zarr.storage.MemoryStore(files), zarr_format=3, attributes=dict(attrs))
    group.create_group(CHECKSUMS.split("/")[0])  # Zarr looks for no arrays there
    for name, layout in layouts.items():
        group.create_array(name, compressors=[ZstdCodec(level=1), Crc32cCodec()], **layout)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Zarr does not yet call consolidated metadata a standard
        zarr.consolidate_metadata(group.store)
    return dict(json.loads(files["zarr.json"].to_bytes()))


def write_metadata(store: Path, root: Mapping[str, Any], fixed: Mapping[str, Array] | None = None) -> None:
    """Replace all metadata: changes are listed first, and zarr.json, which counts, is written last.

    `fixed`: values of the arrays without blocks, written before it.
    """
    nodes = root["consolidated_metadata"]["metadata"]
    files = {f"{name}/zarr.json": node for name, node in nodes.items()} | {"zarr.json": root}
    data = {name: json.dumps(node).encode() for name, node in files.items()}
    changed = {n: text for n, text in data.items() if not is_plain(store / n) or (store / n).read_bytes() != text}
    pairs = _pairs(store / CHECKSUMS) if begun(store) else set()
    _write_list(store, pairs | {(name, hashlib.sha256(text).hexdigest()) for name, text in changed.items()})
    for name, text in changed.items():
        if name == "zarr.json" and fixed:
            _write_fixed(store, fixed)
        (store / name).parent.mkdir(exist_ok=True)
        replace_file(store / name, text)


def _write_fixed(store: Path, fixed: Mapping[str, Array]) -> None:
    import zarr

    for name, values in fixed.items():
        with zarr.config.set({"array.write_empty_chunks": True}):
            zarr.open_array(str(store / name), mode="r+", zarr_format=3)[:] = values
    chunks = [f"{name}/c/0" for name in fixed]
    _write_list(store, _pairs(store / CHECKSUMS) | {(name, digest(store / name)) for name in chunks})


@contextlib.contextmanager
def edited(store: Path) -> Iterator[dict[str, Any]]:
    """The metadata of an archive; changes are written at the end, all at once."""
    root = metadata(store)
    yield root
    write_metadata(store, root)


def note_versions(attrs: dict[str, Any], versions: Mapping[str, str]) -> None:
    """Note in `resumed` the versions that resume an archive, if they differ from those at its start."""
    now = json.dumps(versions)
    if attrs["versions"] != now:
        attrs["resumed"] = now


# -- checksums ---------------------------------------------------------------------------------------


def _pairs(path: Path) -> set[tuple[str, str]]:
    """Name and SHA-256 of each line.  Raises `InputError` for anything but a list of checksums."""
    try:
        if not is_plain(path) or path.stat().st_size > LARGEST_LIST:
            raise InputError(f"{path} is damaged: expected a text file of checksums, got something else.")
        lines = path.read_bytes().decode().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read: {error}. `kreisel check` lists its intact parts.") from error
    result = [LINE.fullmatch(line) for line in lines]
    if None in result:
        line = lines[result.index(None)]
        raise InputError(f"{path} is damaged: expected lines of a SHA-256 and a name, got {line[:80]!r}.")
    return {(match[2], match[1]) for match in result if match is not None}


def _write_list(store: Path, pairs: Iterable[tuple[str, str]], name: str = CHECKSUMS, durable: bool = False) -> None:
    replace_file(store / name, "".join(f"{sha}  {file}\n" for file, sha in sorted(pairs)).encode(), durable)


def listed(store: Path, strict: bool = True) -> Listed:
    """The checksums of an archive.  Raises `InputError` if they are damaged; unless `strict`, reads the valid lines."""
    if strict and not begun(store):
        raise InputError(
            f"{store} is damaged: {CHECKSUMS} is missing. Usual cause: a copy of a run by its to_zarr, a plain "
            "Dataset without checksums: xr.open_zarr opens it. kr.simulate(..., path=...) makes an archive."
        )
    out: dict[str, set[str]] = {}
    for path in (store / CHECKSUMS, *sorted((store / BLOCKS).glob("*.sha256"))):  # one for each block during the run
        with contextlib.suppress(*(() if strict else (InputError,))):
            for name, sha in _pairs(path):
                out.setdefault(name, set()).add(sha)
    return {name: frozenset(digests) for name, digests in out.items()}


def begun(store: Path) -> bool:
    """Whether an archive has its metadata and their checksums, complete or not."""
    return stands(store / CHECKSUMS) and stands(store / "zarr.json")


def is_complete(store: Path) -> bool:
    """Whether an archive is finished: it has its checksums, and no blocks are missing."""
    return begun(store) and not stands(store / BLOCKS)


def blocks_done(store: Path, array: str) -> set[int]:
    """The blocks whose checksums exist, by an array of one axis."""
    return {int(name.split("/")[-1]) for name in listed(store) if name.startswith(f"{array}/c/")}


def is_chunk(name: str) -> bool:
    """Whether a file of an archive holds values, not metadata."""
    return name.split("/")[1:2] == ["c"]


def is_scratch(name: str) -> bool:
    """Whether a file is the remainder of a kill during writing."""
    return name.endswith(".partial") or name.split("/")[-1].startswith(".new-")


def file_names(store: Path) -> set[str]:
    """The names of everything in a folder except folders, relative to it."""
    names = set()
    for folder, folders, files in os.walk(store):
        links = [name for name in folders if os.path.islink(os.path.join(folder, name))]
        names |= {Path(folder, name).relative_to(store).as_posix() for name in (*files, *links)}
    return names


def faults(store: Path, listed: Listed) -> list[tuple[str, str]]:
    """The faults of all files but listed chunks, each with its sentence.  Chunks are compared when arrays are read."""
    faults, names = [], file_names(store)
    for name in sorted(names | set(listed)):
        array = name.removesuffix("/zarr.json")
        if name in (CHECKSUMS, REPLACES) or name.startswith(f"{BLOCKS}/") or (is_chunk(name) and name in listed):
            continue
        if name not in listed:
            faults.append((name, f"{array} was added after the run"))
        elif name not in names:
            faults.append((name, f"{array} is missing"))
        else:
            try:
                if digest(store / name) not in listed[name]:
                    faults.append((name, f"{name} was changed after the run"))
            except OSError as error:
                faults.append((name, f"{name} cannot be read: {error.strerror}"))
    return faults


def list_all(store: Path) -> None:
    """List all files of a complete archive in their present form."""
    (store / CHECKSUMS).parent.mkdir(exist_ok=True)
    _write_list(store, ((name, digest(store / name)) for name in file_names(store) - {CHECKSUMS}))


def require_plain(store: Path) -> None:
    """Raises `InputError` if an archive holds links, pipes or devices: the target of a link is not in the archive."""
    for folder, folders, files in os.walk(store):
        for name in (*folders, *files):
            try:
                mode = os.lstat(os.path.join(folder, name)).st_mode
            except OSError as error:
                raise InputError(f"{store} cannot be read: {folder}/{name}: {error.strerror}.") from error
            if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                kind = "a link" if stat.S_ISLNK(mode) else "a pipe, a socket or a device"
                raise InputError(f"{store} holds {kind}, {os.path.join(folder, name)}. An archive has no use for one.")


# -- writing -----------------------------------------------------------------------------------------


def create(
    path: Path,
    attrs: Mapping[str, Any],
    layouts: Mapping[str, Mapping[str, Any]],
    fixed: Mapping[str, Array],
    overwrite: bool,
) -> None:
    """Create NAME.part, in place of an unfinished one; with `overwrite` it may later replace NAME.

    layouts   arguments of Zarr for each array
    fixed     values of the arrays without blocks, complete from the beginning
    """
    part = part_of(path)
    if stands(part):
        remove(part)
    try:
        (part / BLOCKS).mkdir(parents=True)
        write_metadata(part, new_metadata(attrs, layouts), fixed)
        if overwrite:
            agree(path)
    except Exception:
        if stands(part):  # it is still empty
            remove(part)
        raise


def opened_arrays(store: Path) -> dict[str, Any]:
    """The arrays of an unfinished archive, open for writing; every chunk is written, even if empty."""
    import zarr

    try:
        with zarr.config.set({"array.write_empty_chunks": True}):
            return dict(zarr.open_group(str(store), mode="r+", zarr_format=3, use_consolidated=True).arrays())
    except OSError:
        raise
    except Exception as error:  # any exception of the library for damaged metadata
        raise InputError(f"{store} is damaged: {error}. `kreisel check {store}`.") from error


def write_block(
    store: Path,
    arrays: Mapping[str, Any],
    axis: str,
    number: int,
    first: int,
    values: Mapping[str, Array],
    durable: bool = False,
) -> None:
    """Write a block, whose values begin at `first` along the axis, and then its checksums.

    Raises `RunError` if the archive has vanished: Zarr would make new folders for its chunks.
    """
    names = []
    require_there(store)
    for name, value in values.items():
        place = arrays[name].metadata.dimension_names.index(axis)
        chosen = slice(first, first + value.shape[place])
        arrays[name][(*(slice(None),) * place, chosen)] = value
        names.append(f"{name}/c/" + "/".join(str(number) if k == place else "0" for k in range(value.ndim)))
    for name in names if durable else ():
        with (store / name).open("rb+") as file:  # Windows makes durable only writable files
            os.fsync(file.fileno())
    require_there(store)
    lines = [(name, digest(store / name)) for name in names]
    _write_list(store, lines, f"{BLOCKS}/{number}.sha256", durable)


def require_there(store: Path) -> None:
    """Raises `RunError` if an unfinished archive has vanished."""
    if not begun(store):
        raise RunError(
            f"{store} vanished during the run: {CHECKSUMS} is gone. Usual cause: somebody else removed it. Run it "
            "again."
        )


def seal(store: Path, **attrs: Any) -> None:
    """Set the last attributes, and list every file: the archive is complete.

    Raises `FileNotFoundError` if a written chunk is missing.
    """
    with edited(store) as root:
        root["attributes"].update(attrs)
    chunks = [(name, sha) for name, (sha, *_) in listed(store).items() if is_chunk(name)]
    for name, _ in chunks:
        os.stat(store / name)
    others = [f"{name}/zarr.json" for name in root["consolidated_metadata"]["metadata"]] + ["zarr.json"]
    others += [CHECKPOINT] if stands(store / CHECKPOINT) else []
    _write_list(store, [*chunks, *((name, digest(store / name)) for name in others)])
    clear(store)


def clear(store: Path) -> None:
    """Remove the checksums of the blocks, which the list of the complete archive contains."""
    for path in (store / BLOCKS).iterdir():
        path.unlink()
    (store / BLOCKS).rmdir()


def unseal(store: Path) -> None:
    """Reopen a complete archive, or one that was being sealed: its checkpoint may change, and blocks may follow."""
    (store / BLOCKS).mkdir(exist_ok=True)
    _write_list(store, [pair for pair in _pairs(store / CHECKSUMS) if pair[0] != CHECKPOINT])


def drop_blocks(store: Path, keep: int) -> None:
    """Keep the first `keep` blocks; remove later ones and files that a kill left incomplete."""

    def kept(name: str) -> bool:  # by the first index in the name of a chunk; indices of lanes belong to no block
        return not is_chunk(name) or name.startswith("lane/") or int(name.split("/")[2]) < keep

    _write_list(store, [(name, sha) for name, digests in listed(store).items() if kept(name) for sha in digests])
    for path in (store / BLOCKS).iterdir():
        path.unlink()
    remove_scratch(store, unlisted=True)


def remove_scratch(store: Path, unlisted: bool = False) -> None:
    """Remove files that a kill left incomplete, and with `unlisted` chunks that are not listed."""
    checksums = listed(store) if unlisted else {}
    for name in file_names(store):
        if is_scratch(name) or (unlisted and is_chunk(name) and name not in checksums):
            (store / name).unlink(missing_ok=True)


# -- names -------------------------------------------------------------------------------------------

# An archive is replaced by two renames: NAME becomes .NAME.replaced, NAME.part becomes NAME, and the
# old archive is removed.  A kill in between leaves one of these states; `settle` completes it.  NAME.part records the
# archive that it may replace, so that a resumed run may do so too.  A folder is removed file by file, only files that
# Kreisel or Zarr creates: foreign files remain, and so does the folder around them.


def part_of(path: Path) -> Path:
    """The path of an unfinished archive.  Raises `InputError` for the name of an unfinished archive."""
    if path.suffix == ".part":
        raise InputError(f"{path}: expected a name that does not end in .part, as unfinished archives have.")
    return path.with_name(f"{path.name}.part")


def replaced(path: Path) -> Path:
    """The path of the old archive of that name until the new one is complete."""
    return path.with_name(f".{path.name}.replaced")


def why_not(path: Path) -> str | None:
    """The reason not to replace a folder, a clause; None for an archive or store of Kreisel, complete or partial."""
    kind = os.lstat(path).st_mode
    if stat.S_ISLNK(kind):
        return "is a link"
    if not stat.S_ISDIR(kind):
        return "is not a folder"
    folder, inner = Path.cwd().resolve(), path.resolve()
    if inner == folder or inner in folder.parents:
        return "is the working folder, or one around it"
    lists = [name for name in listed(path, strict=False) if name.endswith("/zarr.json")]
    arrays, names = {name.removesuffix("/zarr.json") for name in lists} - {"engine"}, sorted(file_names(path))
    for name in names:
        foreign = arrays and "/" in name and name.split("/")[0] not in ("engine", *arrays)
        if foreign or not MADE.fullmatch(name) or not stat.S_ISREG(os.lstat(path / name).st_mode):
            return f"holds {name}, which Kreisel did not write"
    if stands(path / "zarr.json"):
        attrs = _attributes(path)
        marked = isinstance(attrs, dict) and not attrs.keys().isdisjoint(("kreisel_format", "kreisel_sweep"))
    else:  # a kill leaves an empty folder of an archive just begun
        marked = stands(path / CHECKSUMS) or all(map(is_scratch, names))
    if not marked and not all(map(CHUNK.fullmatch, names)):
        return "does not say that it is an archive of Kreisel"
    return None


def _attributes(store: Path) -> Any:
    """The attributes of an archive, which may be of any program; None if they cannot be read."""
    try:
        if is_plain(store / "zarr.json") and (store / "zarr.json").stat().st_size <= LARGEST_METADATA:
            return json.loads((store / "zarr.json").read_bytes())["attributes"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    return None


def require_replaceable(path: Path) -> None:
    """Raises `InputError` for an existing path that is not an archive of Kreisel, and within another archive."""
    require_outside(path)
    why = why_not(path) if stands(path) else None
    if why is not None:
        raise InputError(
            f"{path} is unchanged: expected nothing there or an archive of Kreisel, but it {why}. Choose another "
            "path, or move it away."
        )


def remove(store: Path) -> None:
    """Remove an archive or a store.  Raises `InputError` for anything else, and then removes no file."""
    require_replaceable(store)
    names = [name for name in file_names(store) if MADE.fullmatch(name)]
    # the remainder of a kill cannot resume, and keeps its mark to the end
    for name in sorted(names, key=lambda name: (name != CHECKPOINT, name[:7] != "engine/", name == "zarr.json")):
        os.unlink(store / name)
    for folder, folders, _ in os.walk(store, topdown=False):
        for name in folders:
            os.rmdir(os.path.join(folder, name))
    os.rmdir(store)


def agree(path: Path) -> None:
    """Record in NAME.part that it may replace the present NAME, with --overwrite."""
    replace_file(part_of(path) / REPLACES, _mark(path).encode())


def agreed(path: Path) -> bool:
    """Whether NAME.part may replace the present NAME."""
    try:
        consent = part_of(path) / REPLACES
        return is_plain(consent) and consent.read_text() == _mark(path)
    except (OSError, UnicodeDecodeError):
        return False


def _mark(path: Path) -> str:
    """A mark that identifies an archive: the SHA-256 of its manifest, or of its attributes if it has no manifest."""
    for name in (CHECKSUMS, "zarr.json"):
        if is_plain(path / name):
            return digest(path / name)
    return "something" if stands(path) else "nothing"


def take_name(path: Path) -> None:
    """Rename NAME.part to NAME; an existing archive NAME is replaced if this was agreed.

    Raises `RunError` if anything else has appeared there: the results stay in NAME.part.
    """
    part, old = part_of(path), replaced(path)
    if stands(path):
        why = why_not(path) if agreed(path) else "was made there by somebody else during the run"
        if why is not None:
            raise RunError(
                f"{path} is unchanged: it {why}. The run is complete and kept in {part}. Move {path} away, then "
                f"`kreisel resume {path}` gives the run its name."
            )
        if stands(old):
            remove(old)
        os.replace(path, old)
    (part / REPLACES).unlink(missing_ok=True)
    os.replace(part, path)
    if stands(old):
        remove(old)


def settle(path: Path) -> bool:
    """Finish a killed `take_name`; whether a complete NAME.part got its name.  The caller is the one writer."""
    part, old = part_of(path), replaced(path)
    if not stands(old) or why_not(old) is not None:
        return False
    if not stands(path):
        attrs = _attributes(part)
        if isinstance(attrs, dict) and attrs.get("complete") == 1:
            take_name(path)
            return True
        os.replace(old, path)
    if stands(old):
        remove(old)
    return False


def settled(path: Path) -> Path:
    """The path itself, after `settle` if needed and if there is no writer.  A lock left by a kill is removed."""
    if path.name and (stands(replaced(path)) or stands(Lock(path).path)):
        with contextlib.suppress(InputError, RunError, OSError), Lock(path):
            settle(path)
    return path


@contextlib.contextmanager
def one_writer(path: Path) -> Iterator[bool]:
    """The lock of an archive.  Yields whether the remainder of a kill is now complete and has its name."""
    with Lock(path):
        yield settle(path)
