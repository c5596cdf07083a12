"""A Zarr store on disk, a run or a sweep: its attributes, its metadata, its arrays."""

from __future__ import annotations

import math
import os
import stat
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError
from kreisel.files import is_plain, parsed, place, stands
from kreisel.storage.replacing import LARGEST_METADATA, part_of

if TYPE_CHECKING:
    import xarray as xr

LARGEST_CHUNK = 1 << 30  # bytes: a thousand times what is written


def target(path: str | os.PathLike[str]) -> Path:
    """A path that can name an archive, with ~ for the user's own folder.  Raises `InputError`."""
    return place(path, "The archive needs a name such as run.zarr")


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
        if not is_plain(path):
            raise InputError(f"{folder} is damaged: its zarr.json is no plain file.")
        if size > LARGEST_METADATA:
            raise InputError(f"{folder} is damaged: its zarr.json has {size:,} bytes.")
        metadata = parsed(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"{folder} cannot be read as a Zarr archive: {error}") from error
    if not isinstance(metadata, dict):
        raise InputError(f"{path} is damaged: expected an object, got {str(metadata)[:80]}.")
    return metadata


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
                    metadata = zarr.open_array(folder, mode="r", zarr_format=3).metadata
                    axes = getattr(metadata, "dimension_names", None) or ()
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


def dataset(path: Path, store: Any, **options: Any) -> xr.Dataset:
    """The arrays of a store of that path, read when they are asked for.  Raises `InputError` for what is damaged."""
    import xarray as xr

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return xr.open_dataset(
                store, engine="zarr", consolidated=False, cache=False, mask_and_scale=False, **options
            )
    except InputError:
        raise
    except Exception as error:  # whatever a damaged store makes the libraries raise
        raise InputError(f"{path} cannot be read as a Zarr archive: {error}") from error


def array_lengths(store: Path) -> dict[str, int]:
    """The rows of each array.  After a kill while a run is lengthened, some arrays have the new length."""
    found = {}
    for path in store.glob("*/zarr.json"):
        metadata = _node(path.parent)
        dims, shape = metadata.get("dimension_names"), metadata.get("shape")
        if isinstance(dims, list) and isinstance(shape, list) and dims[:1] == ["time"] and shape:
            found[path.parent.name] = shape[0] if isinstance(shape[0], int) else 0
    return found
