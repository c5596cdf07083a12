"""REBOUND, loaded when it is needed: its simulation in memory and in files."""

from __future__ import annotations

import ctypes
import os
import warnings
import zipfile
from collections.abc import Iterable, Mapping
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, hint, on_disk, shown
from kreisel.files import place
from kreisel.process import scratch
from kreisel.rebound.body import ENDS

OFFSETS = {"x": 0, "y": 8, "z": 16, "vx": 24, "vy": 32, "vz": 40, "m": 72}  # bytes, of a particle


@cache
def rebound() -> ModuleType:
    """The module.  Raises `InputError` if it is not installed or stores its particles in another way."""
    try:
        import rebound as library
    except ImportError as error:
        raise InputError("expected REBOUND, got none. Install it: pip install 'kreisel[rebound]'.") from error
    offsets = {name: getattr(library.Particle, name).offset for name in OFFSETS}
    if offsets != OFFSETS:
        raise InputError(
            f"expected REBOUND 5, whose particles begin with x, v, a, m, got {library.__version__}. Usual cause: "
            "another version than the one that kreisel[rebound] asks for."
        )
    return library


SPECIAL = "coordinates", "kernel", "corrector", "corrector2"  # of WHFast: 0 for one kick in Jacobi's coordinates
MODIFYING = "_heartbeat", "_pre_timestep_modifications", "_post_timestep_modifications"


@cache
def offset(integrator: str, name: str) -> int:
    """Where an option is in the state of an integrator, whose attributes look for it anew each time, in 70 us."""
    sim = rebound().Simulation()
    sim.integrator = integrator
    return int(sim.integrator.callbacks.field_descriptor_list.field_descriptor_for_name(name).offset)


def option(sim: Any, name: str) -> Array:
    """An option of the integrator, in its memory."""
    where = sim.integrator.state + offset(str(sim.integrator), name)
    return np.ctypeslib.as_array((ctypes.c_uint32 * 1).from_address(where))


def is_plain(sim: Any) -> bool:
    """Whether a kick of WHFast can have spins: one kick a step, and nothing that needs synchronized particles."""
    if str(sim.integrator) != "whfast" or sim.gravity == "custom":
        return False
    alone = str(sim.boundary) == str(sim.collision) == "none" and not (sim.exit_max_distance or sim.exit_min_distance)
    return alone and not any(getattr(sim, name) for name in MODIFYING) and not any(option(sim, x)[0] for x in SPECIAL)


def check_simulation(sim: Any) -> None:
    """Raises `InputError` for simulations unsuitable for the splitting."""
    if not isinstance(sim, rebound().Simulation):
        raise InputError(f"sim: expected a rebound.Simulation, got {shown(sim)}.")
    if not (np.isfinite(sim.G) and sim.G > 0):
        raise InputError(f"sim.G: expected a number > 0, got {sim.G}. Usual cause: units; say sim.units = (...).")
    if sim.N_var:
        raise InputError(
            f"expected no variational particles, got {sim.N_var}. Usual cause: MEGNO. They do not know of the bodies; "
            "compare two simulations that begin close to each other."
        )
    if str(sim.boundary) not in ("none", "open"):
        raise InputError(f"sim.boundary: expected 'none' or 'open', got {sim.boundary!r}.")
    if str(sim.integrator) in ("whfast", "saba") and option(sim, "keep_unsynchronized")[0]:
        raise InputError(
            "sim.integrator.keep_unsynchronized: expected 0, got 1. The bodies act on synchronized particles."
        )
    if sim.simulationarchive_filename:
        raise InputError(
            f"expected no archive that REBOUND writes, got {sim.simulationarchive_filename!r}. It has no "
            "spins, and is written in the middle of a step. Use spins.save(path)."
        )


def index_of(sim: Any, name: int | str) -> int:
    """The index of a particle.  Raises `InputError`."""
    names = [p.name for p in sim.particles]
    if isinstance(name, str) and name in names:
        return names.index(name)
    if isinstance(name, int | np.integer) and not isinstance(name, bool) and 0 <= name < sim.N:
        return int(name)
    named = [n for n in names if n]
    raise InputError(
        f"expected an index below {sim.N} or the name of a particle, one of {named}, got {shown(name)}."
        + hint(name, named)
    )


# -- files: NumPy's archive of plain arrays, one of them the bytes of REBOUND's simulation ---------


FORMAT = 3
NEEDED = "The simulation and its bodies need a file name such as spins.npz"
FILES = "simulation", "whole.npz"
SHAPES = {"z": 7, "c": int(ENDS[-1])}


def particle_names(sim: Any) -> list[str]:
    """The names of all particles, "" for none."""
    return [p.name or "" for p in sim.particles]


def restored(data: bytes, names: Iterable[str]) -> Any:
    """The simulation of REBOUND's bytes, with these names of its particles.

    REBOUND 5.2 replaces the addresses of names one after the other: a name at the former address of another becomes
    that one, in 4 of 5 simulations that are read after the end of the first (1000 tries).
    """
    sim = rebound().Simulation(data)
    for particle, name in zip(sim.particles, names, strict=True):
        if name and particle.name != name:
            particle.name = name
    return sim


def write_file(path: str | os.PathLike[str], sim: Any, parts: Mapping[str, Any]) -> None:
    """Write `path` completely or not at all.  Raises `RunError` if the disk refuses."""
    target = place(path, NEEDED)
    with on_disk(path, "be written"), scratch(target.parent, ".kreisel-", files=FILES) as folder:
        simulation_file, whole = (folder / name for name in FILES)
        sim.save_to_file(str(simulation_file))
        data = np.frombuffer(simulation_file.read_bytes(), dtype=np.uint8)
        with whole.open("wb") as file:
            known = np.array(particle_names(sim), dtype=np.str_)
            np.savez(file, format=np.array(FORMAT), simulation=data, particles=known, **parts)
            file.flush()
            os.fsync(file.fileno())
        whole.replace(target)


def read_file(path: str | os.PathLike[str]) -> tuple[Any, dict[str, np.ndarray]]:
    """The simulation and the arrays of the file.

    Raises `InputError` for any other file, `RunError` if it cannot be read.
    """
    source = place(path, NEEDED)
    try:
        with on_disk(path, "be read"), source.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("format", "simulation", "particles", "z", "c", "names", "dt")}
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: expected a file that spins.save wrote, got {shown(error)}.") from error
    names = arrays["names"] if arrays["names"].ndim == 1 and arrays["names"].dtype.kind == "U" else np.empty(0, str)
    fits = [arrays[name].shape == (len(names), width) for name, width in SHAPES.items()]
    fits += [name.startswith("#") or name.isdecimal() for name in names.tolist()]
    fits += [arrays[name].shape == () and arrays[name].dtype.kind in "if" for name in ("format", "dt")]
    fits += [arrays["simulation"].dtype == np.uint8]
    if not all(fits) or arrays["format"] != FORMAT:
        raise InputError(f"{path}: expected format {FORMAT} of kreisel.rebound, got {shown(arrays['format'])}.")
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            sim = restored(arrays["simulation"].tobytes(), arrays["particles"].tolist())
    except (RuntimeError, ValueError) as error:
        raise RunError(
            f"{path}: REBOUND could not read its part: {error}. Usual cause: another version of it."
        ) from error
    for each in said:
        if "corrupted" in str(each.message):
            raise RunError(f"{path}: REBOUND could not read its part: {each.message}")
        warnings.warn(str(each.message), RuntimeWarning, stacklevel=2)
    return sim, arrays
