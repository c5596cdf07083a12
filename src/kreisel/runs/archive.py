"""Datasets in memory and Zarr archives on disk, both described from the record.

An archive is written beside its final name, as NAME.part, block by block; it takes its name only when it is
whole.  Every chunk carries a CRC-32C.  Archives are data: arrays and JSON attributes, nothing that runs.
"""

from __future__ import annotations

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

from kreisel.algebra import Array
from kreisel.contract import Model
from kreisel.engines.layout import Floats
from kreisel.errors import InputError, RunError
from kreisel.runs.plan import Plan
from kreisel.runs.simulate import block_rows

if TYPE_CHECKING:
    import xarray as xr

FORMAT = 1
SAMPLES = 64  # perturbed states that measure how an integral feels a relative change of the state
NUDGE = 1e-6


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


def roundoff_scales(plan: Plan) -> dict[str, list[float]]:
    """For each Casimir and integral: sqrt(sum_i (z_i dI/dz_i)^2) at the start, the change of I per relative
    change of the state.  Times the machine epsilon it is the rounding error that one step may make.
    """
    rng = np.random.default_rng(0)
    z = plan.engine.z
    signs = rng.choice([-1.0, 1.0], (SAMPLES, *z.shape))
    size = np.maximum(abs(z), 1e-3 * abs(z).max(-1, keepdims=True))
    up, down = plan.observe(z + NUDGE * signs * size), plan.observe(z - NUDGE * signs * size)
    out = {}
    for name, outcome in plan.scheme.outcomes.items():
        if outcome.kind in ("casimir", "integral", "function"):
            felt = np.sqrt((((up[name] - down[name]) / (2 * NUDGE)) ** 2).mean(0))
            felt = felt.max(0) if plan.batched else felt
            out[name] = [float(v) for v in np.atleast_1d(felt)]
    return out


def attributes(plan: Plan) -> dict[str, dict[str, Any]]:
    """Attributes of every variable."""
    scales = roundoff_scales(plan)
    out: dict[str, dict[str, Any]] = {}
    for name, outcome in plan.scheme.outcomes.items():
        out[name] = {"long_name": outcome.meaning, "kind": outcome.kind, "units": "1"}
        if name in scales:
            out[name]["roundoff_scale"] = scales[name]
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

    attrs = attributes(plan)
    data = {}
    for name in plan.scheme.outcomes:
        value = np.concatenate([block.pop(name) for block in blocks])
        data[name] = (dimensions(plan, name, value.shape), value, attrs[name])
    coords: dict[str, Any] = {"time": ("time", saved_times(plan), TIME)}
    if plan.batched:
        coords["lane"] = ("lane", np.arange(plan.lanes))
    return xr.Dataset(data, coords, describe(plan))


class Archive:
    """A Zarr store that grows block by block under NAME.part and gets its name when it is whole."""

    def __init__(self, path: Path, plan: Plan, attrs: Mapping[str, Any], overwrite: bool):
        self.path, self.part, self.plan = path, path.with_name(path.name + ".part"), plan
        self._attrs, self._overwrite = dict(attrs), overwrite
        self._rows = 0
        self._times = saved_times(plan)

    def __enter__(self) -> Archive:
        import zarr

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
        with self._disk("be created"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._group = zarr.open_group(str(self.part), mode="w-", zarr_format=3)
            self._group.attrs.update({**self._attrs, "complete": False})
            if self.plan.batched:
                self._create("lane", np.arange(self.plan.lanes), ("lane",), {}, grows=False)
        return self

    def _disk(self, what: str) -> _DiskTrouble:
        return _DiskTrouble(self, what)

    def append(self, block: Mapping[str, Array]) -> None:
        """Write a block of rows at the end."""
        count = len(next(iter(block.values())))
        start, stop = self._rows, self._rows + count
        values = {"time": self._times[start:stop], **block}
        with self._disk("be written"):
            for name, value in values.items():
                if start == 0:
                    dims = ("time",) if name == "time" else dimensions(self.plan, name, value.shape)
                    self._create(name, value, dims, TIME if name == "time" else self._variable[name])
                else:
                    array: Any = self._group[name]
                    array.resize((stop, *array.shape[1:]))
                    array[start:stop] = value
        self._rows = stop

    @property
    def _variable(self) -> dict[str, dict[str, Any]]:
        if not hasattr(self, "_variables"):
            self._variables = attributes(self.plan)
        return self._variables

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
            with self._disk("be finished"):
                self._group.attrs["complete"] = True
                self._take_name()
        elif self._rows == 0:
            shutil.rmtree(self.part, ignore_errors=True)

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
            run = xr.open_zarr(path, consolidated=False)
    except Exception as error:  # whatever a damaged store makes the libraries raise
        raise InputError(f"{path} cannot be read as a Zarr archive: {error}") from error
    if run.attrs.get("kreisel_format") != FORMAT:
        raise InputError(f"{path} is not an archive of Kreisel (no kreisel_format = {FORMAT} among its attributes).")
    order = ("state", "orientation", "casimir", "integral", "function")
    return run[sorted(run.data_vars, key=lambda name: (order.index(run[name].attrs["kind"]), str(name)))]


def model_of(run: xr.Dataset) -> Model:
    """The model that a run was made from."""
    from kreisel.systems import find

    return find(run.attrs["system"])(**json.loads(run.attrs["parameters"]))
