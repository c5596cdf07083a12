"""Runs in other formats: NetCDF (HDF5), Parquet or CSV, block by block, and arrays."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.files import NPZ_ATTRIBUTES, read_values, require_file, written
from kreisel.method.scheme import ORIENTATION
from kreisel.record.units import unit_and_axes
from kreisel.runs.geometry import FRAMES, angles_of
from kreisel.runs.in_si import is_in_si
from kreisel.runs.planning import require_room
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import flag
from kreisel.storage.archive import EXPORTS, target
from kreisel.storage.messages import MESSAGES, write_message
from kreisel.units import measured

NUMBERS_AT_ONCE = 1 << 20
TEXT = np.dtype("O", metadata={"vlen": str})  # to HDF5
OF_STATE = ("body", "parameters", "components", "start_sha256")  # attributes that a file in SI does not have
ROWS = ("time", "event", "frequency", "lane")  # axes along which Parquet has its rows


@explained
def export(
    run: xr.Dataset | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    epoch: Any = None,
    angles: str | None = None,
    **labels: Any,
) -> None:
    """Write a run or a sweep to a file: NetCDF-4 if `out` ends in .nc or .h5, Parquet, text in .csv, or .npz.

    run    the path of an archive, or a Dataset such as `kr.simulate` returns
    out    the file; it gets its name when it is complete.  With `overwrite` it replaces a file that Kreisel wrote
    angles          of a satellite: pitch, roll and yaw in degrees as further variables, against "orbit", "inertial" or
                    "ground" (`kreisel.analysis.pointing`)
    epoch, labels   for .aem, .oem and .bc, see below

    A run of a body of `kr.physical` is exported unchanged, in SI.  A run of its model is exported as
    `kreisel.units.measured` returns it: in SI units, vectors, the attitude g and the angular velocity Omega along the
    user's axes of the body.  In a sweep of such bodies, trajectories are along these axes, but minima, maxima and
    frequencies along the axes of the state.

    NetCDF has the unchanged variables and attributes (true and false as 1 and 0).  Parquet has a row for each time and
    lane (for results of `kr.analysis`, each event or frequency), a column for each component, such as "m[2]", and the
    attributes as JSON in the metadata under "kreisel".  CSV has these rows and columns, with units in their names, such
    as "energy (J)", and axes of the state; it has no attributes, so Kreisel never replaces it.  NPZ has the arrays of
    `to_numpy`, which must fit into memory, and the attributes as JSON in "kreisel_attributes".  NetCDF and Parquet need
    the extra `export`.

    For the run of one body with its orientation, `.aem` is the attitude ephemeris message of the CCSDS, and `.bc` a
    kernel of attitude for SPICE, with its clock and its frame in a text kernel `.tsc` next to it (extra `spice`).  For
    a satellite, `.oem` is the orbit ephemeris message.  They need `epoch`, the date of time 0: "2026-01-01T00:00:00",
    or any argument of numpy.datetime64, unless the orbit has a date.  Labels, all optional:

    frame        of space; default: "EME2000", to which an orbit of the Earth with a date is rotated; required, as the
                 center of an .oem, for orbits of other primaries
    time_system  of `epoch`: "UTC";  time_unit, s, for other runs than of a body
    name, identifier, center, originator     "BODY", "0000-000A", "EARTH", "KREISEL"
    spacecraft   NAIF's number, -999; the body is its instrument 1000 spacecraft

    The date of creation is the time of the call, or the environment variable SOURCE_DATE_EPOCH, in seconds since 1970,
    for reproducible files.

    Raises `InputError` for a Dataset that cannot be exported, and `RunError` if the file cannot be written.
    """
    flag(overwrite, "overwrite")
    _write(run, target(out), overwrite, epoch, angles, labels)


def _write(run: Any, where: Path, overwrite: bool, epoch: Any, angles: str | None, labels: dict[str, Any]) -> None:
    end = where.suffix.lower()
    if end not in (*WRITERS, *MESSAGES):
        raise InputError(f"The export must end in {', '.join((*WRITERS, *MESSAGES))}, got {str(where)!r}.")
    first = next(iter(labels | ({} if epoch is None else {"epoch": epoch})), "")
    name, others = ("angles", [*WRITERS]) if angles is not None else (first, [*MESSAGES])
    if name and end not in others:
        raise InputError(f"{name}: expected a file that ends in {', '.join(others)}, got {where.name}.")
    require_file(where, overwrite)
    data = _opened(run, angles)
    try:
        if end in MESSAGES:
            write_message(data, where, epoch, labels, overwrite)
            return
        if WRITERS[end] is _netcdf:
            require_room(where, data.nbytes, "A full disk ends the process within HDF5; .parquet and .csv report it.")
        with written(where, overwrite) as scratch:
            WRITERS[end](data, scratch)
    except (InputError, RunError):
        raise
    except ImportError as error:
        raise InputError(f"Exports need the extra `export`: pip install 'kreisel[export]'. {error}") from error
    except Exception as error:  # a damaged chunk, an error of HDF5 on a full disk, or a value that a format cannot hold
        raise RunError(
            f"{where} could not be written: {error}. Usual cause: a damaged archive, a full disk, or a name or a type "
            "that the format cannot hold."
        ) from error


def _opened(run: Any, angles: str | None = None) -> xr.Dataset:
    """The Dataset itself, or of an archive, with the angles of a satellite in degrees.  Raises `InputError`."""
    from kreisel.storage.opening import open_archive

    data = open_archive(target(run)) if isinstance(run, str | os.PathLike) else run
    if not hasattr(data, "data_vars") or not data.variables:
        raise InputError(
            "expected the path of an archive or a Dataset such as kr.simulate returns, got "
            f"{shown(type(run).__name__)}."
        )
    if angles is None:
        return data
    values, attrs = angles_of(data, angles), {"units": "deg", "frame": FRAMES[angles]}
    dims = ("time", "lane")[: values.pitch.ndim]
    return data.assign({name: (dims, np.rad2deg(value), attrs) for name, value in values._asdict().items()})


def _netcdf(run: xr.Dataset, out: Path) -> None:
    import h5netcdf

    example = _presented(run.isel({_lead(run): slice(0, 1)}) if _lead(run) else run)
    types = {k: v.dtype for k, v in example.variables.items()}
    _require_plain(types, "NetCDF")
    with h5netcdf.File(out, "w") as file:
        sizes = {str(k): run.sizes.get(k, size) for k, size in example.sizes.items()}
        file.dimensions = sizes
        file.attrs.update({str(k): _netcdf_value(v) for k, v in example.attrs.items()})
        for name, variable in example.variables.items():
            dims = tuple(map(str, variable.dims))
            shape: Any = tuple(sizes[d] for d in dims)
            layout: dict[str, Any] = {}
            if shape and math.prod(shape):
                rows = min(shape[0], max(1, NUMBERS_AT_ONCE // 8 // math.prod(shape[1:])))
                layout = {"chunks": (rows, *shape[1:]), "compression": "gzip", "shuffle": True}
            kind = {"b": np.dtype("i1"), "U": TEXT}.get(variable.dtype.kind, variable.dtype)
            created = file.create_variable(str(name), dims, kind, **layout)
            created.attrs.update({str(k): _netcdf_value(v) for k, v in variable.attrs.items()})
        lead = _lead(run)
        for first, block in _blocks(run):
            for name, variable in block.variables.items():
                if lead in variable.dims or first == 0:
                    at = slice(first, first + block.sizes.get(lead, 0))
                    values = variable.values.astype(object) if variable.dtype.kind == "U" else variable.values
                    file.variables[str(name)][tuple(at if d == lead else slice(None) for d in variable.dims)] = values


def _require_plain(types: Mapping[Any, np.dtype[Any]], form: str) -> None:
    """Raises `InputError` for variables that a format cannot hold."""
    wrong = [k for k, t in types.items() if t.kind not in "biufcSU" or not str(k).strip(".") or "/" in str(k)]
    if wrong:
        raise InputError(
            f"expected variables of values or text, their names without /, for {form}, got {shown(wrong[0])} of the "
            f"type {types[wrong[0]]}. Leave it out with run.drop_vars."
        )


def _netcdf_value(value: Any) -> Any:
    """A value for NetCDF: text, floats, arrays of these; truth values become 1 and 0, anything else JSON."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode().replace("\0", "\\x00")
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if all(isinstance(v, int | float | np.generic) for v in (value if isinstance(value, list) else [value])):
        numbers = np.asarray(value)
        if numbers.dtype.kind in "biuf":
            return (numbers * 1)[()]
    return _json(value)


def _json(value: Any) -> str:
    try:
        return json.dumps(value, default=lambda v: v.tolist() if hasattr(v, "tolist") else str(v))
    except (TypeError, ValueError, RecursionError):  # keys that are tuples, or lists within themselves
        return json.dumps(shown(value))


def _parquet(run: xr.Dataset, out: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    metadata = {b"kreisel": json.dumps({str(k): json.loads(_json(v)) for k, v in run.attrs.items()}).encode()}
    writer = None
    try:
        for _, block in _blocks(run):
            table = pa.table(dict(_columns(block))).replace_schema_metadata(metadata)
            writer = writer or pq.ParquetWriter(out, table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def _lead(run: xr.Dataset) -> str:
    return next((d for d in ROWS if run.sizes.get(d)), "")


def _blocks(run: xr.Dataset) -> Iterator[tuple[int, xr.Dataset]]:
    """The first row of each block, and the block in the form of the file, of about a million values."""
    lead, before, run = _lead(run), None, run.copy()
    along = [v for v in run.variables.values() if lead in v.dims]
    for variable in run.variables.values():
        if lead not in variable.dims:
            variable.load()  # once, not with each block
    step = max(1, NUMBERS_AT_ONCE // sum(v.size // v.sizes[lead] + 1 for v in along)) if along else 1
    for first in range(0, max(run.sizes.get(lead, 1), 1), step):
        block = _presented((run.isel({lead: slice(first, first + step)}) if lead else run).load())
        if lead == "time" and ORIENTATION in block and _of_body(run):
            q = block[ORIENTATION].values
            if before is not None:  # q or -q, the nearer to the row before
                q = q * np.where((before * q[:1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
            block, before = block.assign({ORIENTATION: block[ORIENTATION].copy(data=q)}), q[-1:]
        yield first, block


def _of_body(run: xr.Dataset) -> bool:
    return not is_in_si(run) and bool(RunRecord.from_attrs(run.attrs).body_frame)


def _presented(run: xr.Dataset) -> xr.Dataset:
    """A Dataset in the form of a file: for a body in SI units, along the user's axes of the body."""
    if not _of_body(run):
        return run
    out = measured(run)
    kept = {name: value for name, value in run.attrs.items() if name not in OF_STATE}
    return out.assign_attrs(kept) if "kreisel_sweep" in run.attrs else out


def _columns(block: xr.Dataset) -> Iterator[tuple[str, Array]]:
    """Columns with a row for each time and lane; variables that vary along neither are repeated in every row."""
    if "lane" in block.coords and "lane" not in block.sizes and (grid := block["lane"]).ndim:
        flat = block.drop_vars("lane").stack(lane=grid.dims, create_index=False).transpose("lane", ...)
        block = flat.assign_coords(lane=grid.values.ravel())
    lead = [d for d in ROWS if d in block.sizes]
    sizes = [block.sizes[d] for d in lead]
    if "lane" in lead and "lane" not in block.variables:
        yield "lane", np.broadcast_to(np.arange(block.sizes["lane"]), sizes).ravel()
    variables: dict[Any, Any] = dict(block.variables)
    for name, variable in variables.items():
        if name == "message" and variable.dims[-1:] == ("character",):
            rows = variable.values.reshape(-1, variable.shape[-1]).tolist()
            texts = [bytes(row).rstrip(b"\0").decode(errors="replace") for row in rows]
            variable = xr.Variable(variable.dims[:-1], np.array(texts, dtype=object).reshape(variable.shape[:-1]))
        remainder = [d for d in variable.dims if d not in lead]
        full = variable.set_dims({**dict(zip(lead, sizes, strict=True)), **{d: variable.sizes[d] for d in remainder}})
        shape = [variable.sizes[d] for d in remainder]
        values = full.transpose(*lead, *remainder).values.reshape(math.prod(sizes), math.prod(shape))
        for place in range(values.shape[1]):
            index = ",".join(str(i) for i in np.unravel_index(place, shape)) if remainder else ""
            yield f"{name}[{index}]" if remainder else str(name), values[:, place]


def _csv(run: xr.Dataset, out: Path) -> None:
    with out.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        for first, block in _blocks(run):
            columns = dict(_columns(block))
            names = sorted(columns, key=lambda name: ROWS.index(name) if name in ROWS else len(ROWS))
            if first == 0:
                labels = {str(name): unit_and_axes(v.attrs) for name, v in block.variables.items()}
                rows.writerow(name + labels.get(name, labels.get(name.rpartition("[")[0], "")) for name in names)
            rows.writerows(zip(*(columns[name].tolist() for name in names), strict=True))


@explained
def to_numpy(run: xr.Dataset | str | os.PathLike[str]) -> dict[str, Array]:
    """A run or a sweep as NumPy arrays, by the names of its variables: `time` (time,), `energy` (time, lane), ...

    run    the path of an archive, or a Dataset such as `kr.simulate` returns

    Axes: time, then lane for an ensemble, then components.  Values of a body of `kr.physical` are in SI units, along
    the axes in which it was given, as in `kr.export`; quaternions are (w, x, y, z).  Arrays are copies in the order of
    C, which PyTorch and JAX accept.  Raises `InputError` for a Dataset that cannot be exported.
    """
    data = _presented(_opened(run))
    return {str(name): np.array(read_values(v, name), order="C") for name, v in data.variables.items()}


def _npz(run: xr.Dataset, out: Path) -> None:
    arrays: dict[str, Any] = dict(to_numpy(run))
    _require_plain({name: values.dtype for name, values in arrays.items()}, ".npz")
    attributes = {str(k): json.loads(_json(v)) for k, v in run.attrs.items()}
    arrays[NPZ_ATTRIBUTES] = np.array(json.dumps(attributes))
    with out.open("wb") as file:
        np.savez_compressed(file, **arrays)


WRITERS: dict[str, Any] = dict(zip(EXPORTS, (_netcdf, _netcdf, _parquet, _csv, _npz), strict=True))
