"""Datasets in memory and Zarr archives on disk, both described from the record.

An archive is written beside its final name, as NAME.part, block by block; it takes its name only when it is
whole.  Every chunk carries a CRC-32C.  Archives are data: arrays and JSON attributes, nothing that runs.
"""

from __future__ import annotations

import contextlib
import errno
import importlib.metadata
import json
import os
import shutil
import warnings
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.engines import layout
from kreisel.engines.layout import Floats
from kreisel.errors import InputError, RunError
from kreisel.model import Model
from kreisel.runs.drift import KINDS
from kreisel.runs.plan import Plan
from kreisel.runs.simulate import block_rows

if TYPE_CHECKING:
    import xarray as xr

FORMAT = 1
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
    if outcome.axes:
        return (*lead, *(("axis",) if rest == 1 else ("row", "column")))
    return (*lead, *((f"{name}_part",) if rest else ()))


def versions() -> dict[str, str]:
    """Versions of what computed a run."""
    import platform

    packages = ("kreisel", "numpy", "numba", "scipy", "xarray", "zarr")
    return {"python": platform.python_version()} | {p: importlib.metadata.version(p) for p in packages}


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
        "frame": system.frame.value,
        "bracket": "plus" if system.space.sign > 0 else "minus",
        "n": model.n,
        "parameters": json.dumps({k: v.tolist() for k, v in model.params.items()}),
        "method": plan.scheme.name,
        "options": json.dumps(dict(plan.scheme.options or {})),
        "dt": plan.dt,
        "steps": plan.steps,
        "every": plan.every,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": json.dumps(versions()),
    }


def roundoff_scales(plan: Plan, first: Mapping[str, Array]) -> dict[str, dict[str, list[float]]]:
    """What rounding does to each Casimir and integral, in units of eps_machine.

    roundoff_scale    in a step: the root mean square, over up to 32 states of the first block, of the change
                      when every coordinate of a component moves by the component's largest, signs at random
    evaluation_scale  in computing it once from a state: its size, or the noise of its values if larger
    """
    z = _spread(plan, first)
    directions = np.random.default_rng(0).choice([-1.0, 1.0], (SAMPLES, *z.shape)) * _largest(plan, z)
    here = plan.observe(z)
    up, down = _moved(plan, z, NUDGE * directions), _moved(plan, z, -NUDGE * directions)
    a_bit_up, a_bit_down = _moved(plan, z, HAIR * directions), _moved(plan, z, -HAIR * directions)
    out = {}
    for name, outcome in plan.scheme.outcomes.items():
        if outcome.kind in KINDS:
            felt = np.sqrt((((up[name] - down[name]) / (2 * NUDGE)) ** 2).mean((0, 1)))
            noise = abs(a_bit_up[name] + a_bit_down[name] - 2 * here[name]) / (2 * MACHINE_EPSILON)
            computed = np.maximum(noise.max((0, 1)), abs(here[name]).max(0))
            out[name] = {"roundoff_scale": _listed(felt, plan), "evaluation_scale": _listed(computed, plan)}
    return out


def _moved(plan: Plan, z: Floats, by: Floats) -> dict[str, Array]:
    """Outputs at z + by for `by` (samples, rows, lanes, d); samples and rows in front."""
    outputs = plan.observe((z + by).reshape(-1, *z.shape[1:]))
    return {name: value.reshape((*by.shape[:2], *value.shape[1:])) for name, value in outputs.items()}


def _listed(scale: Array, plan: Plan) -> list[float]:
    """A scale for each part of an integral, the largest over the lanes."""
    return [float(v) for v in np.atleast_1d(scale.max(0) if plan.batched else scale)]


def _largest(plan: Plan, z: Floats) -> Floats:
    """For each coordinate the largest of its component, in the shape of z."""
    parts = zip(layout.restore(z, plan.kinds, plan.model.n), plan.kinds, strict=True)
    flat = [abs(layout.flatten((part,), (kind,))) for part, kind in parts]
    return np.concatenate([np.broadcast_to(f.max(-1, keepdims=True), f.shape) for f in flat], -1)


def _spread(plan: Plan, first: Mapping[str, Array]) -> Floats:
    """Up to 32 rows of the first block, evenly spread, in the method's own variables (rows, lanes, d)."""
    rows = np.unique(np.linspace(0, len(first["casimir"]) - 1, 32).astype(int))
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
            out[name] |= {"kept": int(outcome.kept), **scales[name]}
    return out


def saved_times(plan: Plan) -> Floats:
    """Times of the saved rows, k dt."""
    rows = np.arange(plan.rows, dtype=np.float64)
    steps = np.minimum(rows * plan.every, plan.steps)
    return np.asarray(steps * plan.dt)


TIME = {"long_name": "time", "units": "1", "axis": "T"}


def in_memory(plan: Plan, blocks: list[dict[str, Array]]) -> xr.Dataset:
    """Blocks of outputs as a Dataset."""
    import xarray as xr

    attrs = attributes(plan, blocks[0])
    data = {}
    for name in plan.scheme.outcomes:
        value = np.concatenate([block.pop(name) for block in blocks])
        data[name] = (dimensions(plan, name, value.shape), value, attrs[name])
    coords: dict[str, Any] = {"time": ("time", saved_times(plan), TIME)}
    if plan.batched:
        coords["lane"] = ("lane", np.arange(plan.lanes))
    return xr.Dataset(data, coords, describe(plan))


def target(path: str | os.PathLike[str]) -> Path:
    """A path that can name an archive.  Raises `InputError`."""
    where = Path(path)
    if not where.name or "\0" in str(where) or where.name == "..":
        raise InputError(f"The archive needs a name such as run.zarr; {str(path)!r} came.")
    return where


class Archive:
    """A Zarr store that grows block by block under NAME.part and gets its name when it is whole."""

    def __init__(self, path: Path, plan: Plan, overwrite: bool):
        self.path, self.part, self.plan = path, path.with_name(path.name + ".part"), plan
        self._overwrite, self._rows = overwrite, 0
        self._times = saved_times(plan)

    def __enter__(self) -> Archive:
        import zarr

        with self._disk("be created"):
            self._make_room()
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._group = zarr.open_group(str(self.part), mode="w-", zarr_format=3)
            self._group.attrs.update({**describe(self.plan), "complete": False})
            if self.plan.batched:
                self._create("lane", np.arange(self.plan.lanes), ("lane",), {}, grows=False)
        return self

    def _make_room(self) -> None:
        if self.path.exists() and not self._overwrite:
            raise InputError(
                f"{self.path} exists already and is left as it is. Choose another path, or replace it with --overwrite "
                "(overwrite=True)."
            )
        if self.part.exists():
            if not self._overwrite:
                raise InputError(
                    f"{self.part} was left by a run that was interrupted. Look at it with `kreisel plot {self.part}`; "
                    "then remove it, or start over with --overwrite (overwrite=True)."
                )
            shutil.rmtree(self.part)

    def _disk(self, what: str) -> _DiskTrouble:
        return _DiskTrouble(self, what)

    def append(self, block: Mapping[str, Array]) -> None:
        """Write a block of rows at the end."""
        count = len(next(iter(block.values())))
        start, stop = self._rows, self._rows + count
        values = {"time": self._times[start:stop], **block}
        attrs = {"time": TIME, **attributes(self.plan, block)} if start == 0 else {}
        with self._disk("be written"):
            for name, value in values.items():
                if start == 0:
                    dims = ("time",) if name == "time" else dimensions(self.plan, name, value.shape)
                    self._create(name, value, dims, attrs[name])
                else:
                    array: Any = self._group[name]
                    array.resize((stop, *array.shape[1:]))
                    array[start:stop] = value
        self._rows = stop

    def _create(
        self, name: str, value: Array, dims: tuple[str, ...], attrs: Mapping[str, Any], grows: bool = True
    ) -> None:
        from zarr.codecs import Crc32cCodec, ZstdCodec

        chunk = (block_rows(self.plan), *value.shape[1:]) if grows else value.shape
        array = self._group.create_array(
            name,
            shape=value.shape,
            chunks=chunk,
            dtype=value.dtype,
            dimension_names=dims,
            compressors=[ZstdCodec(level=1), Crc32cCodec()],
            attributes=dict(attrs),
            fill_value=np.nan if value.dtype.kind == "f" else 0,
        )
        array[...] = value

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            import zarr

            with self._disk("be finished"):
                self._group.attrs["complete"] = True
                with warnings.catch_warnings():  # Zarr calls the one file that lists all others not yet a standard
                    warnings.simplefilter("ignore")
                    zarr.consolidate_metadata(str(self.part))
                self._take_name()
        elif self._rows == 0:
            shutil.rmtree(self.part, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):  # a full disk may refuse even this; check then names the damage
                self._cut_back()

    def _cut_back(self) -> None:
        """Take back a block that was written in part, so that all variables have the same rows."""
        for name in self._group.array_keys():
            array: Any = self._group[name]
            if name != "lane" and array.shape[0] > self._rows:
                array.resize((self._rows, *array.shape[1:]))

    def _take_name(self) -> None:
        old = None
        if self.path.exists():
            old = self.path.with_name(f"{self.path.name}.old-{os.getpid()}")
            os.replace(self.path, old)
        os.replace(self.part, self.path)
        if old is not None:
            shutil.rmtree(old) if old.is_dir() else old.unlink()


class _DiskTrouble:
    """Turns what the file system says into one message with the fix."""

    def __init__(self, archive: Archive, what: str):
        self._archive, self._what = archive, what

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not isinstance(error, OSError):
            return
        archive = self._archive
        kept = f" The {archive._rows:,} rows before are kept in {archive.part}." if archive._rows else ""
        fix = {
            errno.ENOSPC: "The disk is full: free some space, save less often (every), or choose another disk.",
            errno.EDQUOT: "The disk quota is used up: free some space or choose another disk.",
            errno.EACCES: "Choose a folder that you may write to.",
            errno.EROFS: "The file system is read-only: choose another folder.",
            errno.ENOTDIR: "A part of the path is a file: choose another folder.",
            errno.ENAMETOOLONG: "Choose a shorter name.",
        }.get(error.errno or 0, "Check the path and the disk.")
        raise RunError(f"{archive.path} could not {self._what}: {error.strerror or error}. {fix}{kept}") from error


def open_archive(path: Path) -> xr.Dataset:
    """A run on disk, opened lazily.  Raises `InputError` for what is not a Kreisel archive."""
    import xarray as xr

    if not path.exists():
        raise InputError(f"There is no archive {path}. Run `kreisel run` first, or check the name.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = xr.open_dataset(path, engine="zarr", consolidated=False, cache=False, mask_and_scale=False)
    except Exception as error:  # whatever a damaged store makes the libraries raise
        raise InputError(f"{path} cannot be read as a Zarr archive: {error}") from error
    if run.attrs.get("kreisel_format") != FORMAT:
        raise InputError(f"{path} is not an archive of Kreisel (no kreisel_format = {FORMAT} among its attributes).")
    order = ("state", "orientation", *KINDS)
    return run[sorted(run.data_vars, key=lambda name: (order.index(run[name].attrs["kind"]), str(name)))]


def model_of(run: xr.Dataset) -> Model:
    """The model that a run was made from."""
    from kreisel.systems import find

    return find(run.attrs["system"])(**json.loads(run.attrs["parameters"]))
