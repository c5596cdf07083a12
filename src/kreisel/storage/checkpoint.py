"""The checkpoint of an archive, from which its run resumes after a kill: one file next to the data.

The file holds plain arrays (.npz without pickle; zip keeps a CRC-32 of each), replaced atomically.
"""

from __future__ import annotations

import io
import math
import tokenize
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.files import replace_file
from kreisel.kernels.layout import Floats
from kreisel.runs.integration import Snapshot
from kreisel.storage.archive import CHECKPOINT


class Checkpoint(NamedTuple):
    """A snapshot, the start of the run, and the outputs of the snapshot's rows, which no block has yet."""

    snapshot: Snapshot
    start: Mapping[str, Floats]
    outputs: Mapping[str, Array]


def write(store: Path, point: Checkpoint) -> None:
    """Replace the checkpoint of an archive, atomically and durably."""
    arrays = {
        "flushed": np.asarray(point.snapshot.flushed),
        "into": np.asarray(point.snapshot.into),
        "rows": point.snapshot.rows,
    }
    for part, values in (("engine", point.snapshot.engine), ("start", point.start), ("outputs", point.outputs)):
        arrays |= {f"{part}/{name}": value for name, value in values.items()}
    data = io.BytesIO()
    np.savez(data, allow_pickle=False, **arrays)
    replace_file(store / CHECKPOINT, data.getvalue(), durable=True)


def read(store: Path) -> Checkpoint:
    """The checkpoint of an archive.  Raises `InputError` if there is none, or it is damaged."""
    path = store / CHECKPOINT
    if not path.exists():
        raise InputError(f"{store} has no checkpoint to resume from. Run it again from its TOML file.")
    try:
        arrays = _arrays(path)
        engine, start, outputs = (
            {k.split("/", 1)[1]: v for k, v in arrays.items() if k.startswith(f"{part}/")}
            for part in ("engine", "start", "outputs")
        )
        return Checkpoint(Snapshot(int(arrays["flushed"]), int(arrays["into"]), arrays["rows"], engine), start, outputs)
    except DAMAGE as error:
        raise InputError(f"The checkpoint {path} is damaged: {error}. Run it again from its TOML file.") from error


# Exceptions of zipfile and NumPy for a damaged .npz: NotImplementedError for an unknown kind of compression or
# encryption, the last three if the header of an array, a Python literal, is never closed or nested too deeply.
DAMAGE = (
    OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError, NotImplementedError, tokenize.TokenError,
    RecursionError, MemoryError,
)  # fmt: skip


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
