"""A simulation and its bodies in one file: NumPy's archive of plain arrays, one of them the bytes of REBOUND's."""

from __future__ import annotations

import os
import warnings
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np

from kreisel.errors import InputError, RunError, on_disk, shown
from kreisel.files import place
from kreisel.process import scratch
from kreisel.rebound.compiled import COLUMNS
from kreisel.rebound.library import rebound

FORMAT = 1
NEEDED = "The simulation and its bodies need a file name such as spins.npz"
FILES = "simulation", "whole.npz"
SHAPES = {"z": 7, "c": COLUMNS}


def write(path: str | os.PathLike[str], sim: Any, parts: Mapping[str, Any]) -> None:
    """Write `path` whole or not at all.  Raises `RunError` where the disk does not let it."""
    target = place(path, NEEDED)
    with on_disk(path, "be written"), scratch(target.parent, ".kreisel-", files=FILES) as folder:
        part, whole = (folder / name for name in FILES)
        sim.save_to_file(str(part))
        data = np.frombuffer(part.read_bytes(), dtype=np.uint8)
        with whole.open("wb") as file:
            np.savez(file, format=np.array(FORMAT), simulation=data, **parts)
            file.flush()
            os.fsync(file.fileno())
        whole.replace(target)


def read(path: str | os.PathLike[str]) -> tuple[Any, dict[str, np.ndarray]]:
    """The simulation and the arrays beside it.

    Raises `InputError` for a file that is no such file, `RunError` where it cannot be read.
    """
    source = place(path, NEEDED)
    try:
        with on_disk(path, "be read"), source.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            found = {name: file[name] for name in ("format", "simulation", "z", "c", "names", "dt", "seen")}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: expected a file that spins.save wrote, got {shown(error)}.") from error
    names = found["names"] if found["names"].ndim == 1 and found["names"].dtype.kind == "U" else np.empty(0, str)
    fits = [found[name].shape == (len(names), width) for name, width in SHAPES.items()]
    fits += [name.startswith("#") or name.isdecimal() for name in names.tolist()]
    fits += [found[name].shape == () and found[name].dtype.kind in "if" for name in ("format", "dt")]
    fits += [found["seen"].dtype == np.float64, found["simulation"].dtype == np.uint8]
    if not all(fits) or found["format"] != FORMAT:
        raise InputError(f"{path}: expected format {FORMAT} of kreisel.rebound, got {shown(found['format'])}.")
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            sim = rebound().Simulation(found["simulation"].tobytes())
    except RuntimeError as error:
        raise RunError(
            f"{path}: REBOUND could not read its part: {error}. Usual cause: another version of it."
        ) from error
    for each in said:
        if "corrupted" in str(each.message):
            raise RunError(f"{path}: REBOUND could not read its part: {each.message}")
        warnings.warn(str(each.message), RuntimeWarning, stacklevel=2)
    return sim, found
