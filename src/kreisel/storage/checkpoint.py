"""What lets a run go on after a kill: a checkpoint beside the data.

It is one file of plain arrays (.npz without pickle; zip keeps a CRC-32 of each), replaced atomically.
"""

from __future__ import annotations

import io
import json
import math
import tokenize
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.errors import InputError
from kreisel.files import parsed, replace_file
from kreisel.kernels.layout import Floats
from kreisel.runs.integration import Snapshot

ABOUT = "about"  # JSON: dimensions and attributes of what is shown
NAME = "engine/checkpoint.npz"  # in a group of its own, where Zarr does not look for arrays


def write(store: Path, snapshot: Snapshot, start: Mapping[str, Floats]) -> None:
    """Replace the checkpoint of a store by this snapshot and the start of the run, atomically and durably."""
    arrays = {
        "flushed": np.asarray(snapshot.flushed),
        "into": np.asarray(snapshot.into),
        "rows": snapshot.rows,
        **{f"engine/{name}": value for name, value in snapshot.engine.items()},
        **{f"start/{name}": value for name, value in start.items()},
        **{f"shown/{name}": value for name, (_, value, _) in snapshot.shown.items()},
    }
    if snapshot.shown:
        about = {name: (dims, attrs) for name, (dims, _, attrs) in snapshot.shown.items()}
        arrays[ABOUT] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    data = io.BytesIO()
    np.savez(data, allow_pickle=False, **arrays)
    replace_file(store / NAME, data.getvalue(), durable=True)


def read(store: Path) -> tuple[Snapshot, dict[str, Floats]]:
    """The snapshot and the start.  Raises `InputError` where there is none, or it is damaged."""
    path = store / NAME
    if not path.exists():
        raise InputError(f"{store} has no checkpoint to go on from. Run it again from its TOML file.")
    try:
        arrays = _arrays(path)
        engine, start = (
            {k.split("/", 1)[1]: v for k, v in arrays.items() if k.startswith(p)} for p in ("engine/", "start/")
        )
        about = parsed(arrays[ABOUT].tobytes().decode(), str(path)) if ABOUT in arrays else {}
        shown = {name: (tuple(dims), arrays[f"shown/{name}"], attrs) for name, (dims, attrs) in about.items()}
        return Snapshot(int(arrays["flushed"]), int(arrays["into"]), arrays["rows"], engine, shown), start
    except DAMAGE as error:
        raise InputError(f"The checkpoint {path} is damaged: {error}. Run it again from its TOML file.") from error


# What a damaged .npz makes zipfile and NumPy raise: NotImplementedError where a kind of compression or encryption is
# not known, the last three where the header of an array, a Python literal, is never closed or nested too deep.
DAMAGE = (
    OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, EOFError, NotImplementedError, tokenize.TokenError,
    RecursionError, MemoryError,
)  # fmt: skip


def _arrays(path: Path) -> dict[str, Any]:
    """The arrays of an .npz file, each as long as the file has bytes for it.  Raises `ValueError` for others."""
    out = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.compress_type != zipfile.ZIP_STORED or member.file_size > path.stat().st_size:
                raise ValueError(f"{member.filename} claims {member.file_size:,} bytes")
            data = io.BytesIO(archive.read(member))  # this verifies the CRC
            version = np.lib.format.read_magic(data)
            if version != (1, 0):
                raise ValueError(f"{member.filename} is no array")
            shape, _, dtype = np.lib.format.read_array_header_1_0(data)
            if dtype.kind not in "iuf" or math.prod(shape) * dtype.itemsize != member.file_size - data.tell():
                raise ValueError(f"{member.filename} claims to hold {shape} of {dtype}")
            data.seek(0)
            out[member.filename.removesuffix(".npy")] = np.lib.format.read_array(data, allow_pickle=False)
    return out
