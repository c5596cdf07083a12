"""Runs in other formats: NetCDF (HDF5), Parquet or CSV, block by block, and arrays; messages and kernels of attitude.

An AEM [CCSDS 504.0-B-1, 2008] has the quaternion (x, y, z, w) of the attitude g of the user's axes of the body: for
ATTITUDE_DIR = A2B its matrix in the sense of the standard is g^T, which maps components in space to components along
these axes.  An OEM [CCSDS 502.0-B-2, 2009] has the position and the velocity of a satellite, km and km/s.  A kernel of
type 3 (CK) has g^T as SPICE's C-matrix, and the angular velocity in space; the text kernel next to it, `.tsc`, has its
clock, which counts microseconds of terrestrial time, and its frame.  [NAIF, CK and SCLK Required Reading, N0067]

Space of an orbit of the Earth with a date is the mean equator and equinox of this date: unless `frame` is given,
vectors are rotated to EME2000 by the precession of IAU 1976, without nutation, 20 arcseconds at most.  [J. H. Lieske,
Astronomy and Astrophysics 73 (1979) 282]
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies.orbit import EARTH
from kreisel.errors import InputError, RunError, explained, hint, shown
from kreisel.files import NPZ_ATTRIBUTES, read_values, require_file, written
from kreisel.method.scheme import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.units import AXES, BODY, unit_and_axes
from kreisel.runs.geometry import (
    FRAMES,
    angles_of,
    attitude_of,
    model_for,
    orientation_of,
    parameters_of,
    surroundings,
    velocity_of,
)
from kreisel.runs.in_si import VELOCITY, is_in_si
from kreisel.runs.planning import require_room
from kreisel.runs.run_record import RunRecord, frame_of
from kreisel.runs.settings import flag, positive_number
from kreisel.storage.archive import EXPORTS, target
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
    from kreisel.storage.opening import open_archive, too_large

    data = open_archive(target(run)) if isinstance(run, str | os.PathLike) else run
    if not hasattr(data, "data_vars") or not data.variables:
        raise InputError(
            "expected the path of an archive or a Dataset such as kr.simulate returns, got "
            f"{shown(type(run).__name__)}."
        )
    if too_large(data):
        raise InputError(f"{run} is damaged: {'; '.join(too_large(data))}.")
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
    require_room(out, run.nbytes, "A full disk ends the process within HDF5; .parquet and .csv report it.")
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


# -- messages and kernels of attitude -------------------------------------------------------------------

LABELS: dict[str, Any] = {  # None: by the run
    **{"name": "BODY", "identifier": "0000-000A", "center": "EARTH", "frame": None},
    **{"time_system": "UTC", "originator": "KREISEL", "time_unit": None, "spacecraft": -999},
}
META = """{kind}
CREATION_DATE = {created}
ORIGINATOR = {originator}

META_START
COMMENT Kreisel: {comment}
OBJECT_NAME = {name}
OBJECT_ID = {identifier}
CENTER_NAME = {center}
{frames}
TIME_SYSTEM = {time_system}
START_TIME = {start}
STOP_TIME = {stop}
{types}META_STOP

"""
LONGEST = 2**53 // 10**6  # seconds, whose microseconds a double counts
LEAPS = (  # of UTC, [IERS Bulletin C]: TAI - UTC is 10 s from the first date on, and a second more from each other date
    "1972-01 1972-07 1973-01 1974-01 1975-01 1976-01 1977-01 1978-01 1979-01 1980-01 1981-07 1982-07 1983-07 1985-07 "
    "1988-01 1990-01 1991-01 1992-07 1993-07 1994-07 1996-01 1997-07 1999-01 2006-01 2009-01 2012-07 2015-07 2017-01"
)
TERRESTRIAL = 32.184  # TT - TAI, s
J2000 = np.datetime64("2000-01-01T12:00:00", "us")
CENTURY = 36_525 * 86_400.0  # s
PRECESSION = (  # zeta, z, theta: arcseconds by powers of the centuries, from the first
    (2306.2181, 0.30188, 0.017998),
    (2306.2181, 1.09468, 0.018203),
    (2004.3109, -0.42665, -0.041833),
)
NEAR = 1e-2  # relative, of mu
TICKS = 1e6  # in a second, of the clock of a kernel
EARLY = 1.0  # s before the first row, when the clock starts: dates are rounded
CLOCK = """KPL/SCLK

Kreisel: a clock that counts microseconds of terrestrial time from 1 s before {date} {time_system},
and the frame of a body, whose attitudes are in {ck}, relative to {frame}.

\\begindata

SCLK_KERNEL_ID = ( @{created} )
SCLK_DATA_TYPE_{clock} = ( 1 )
SCLK01_TIME_SYSTEM_{clock} = ( 2 )
SCLK01_N_FIELDS_{clock} = ( 2 )
SCLK01_MODULI_{clock} = ( 10000000000 1000000 )
SCLK01_OFFSETS_{clock} = ( 0 0 )
SCLK01_OUTPUT_DELIM_{clock} = ( 1 )
SCLK_PARTITION_START_{clock} = ( 0.0 )
SCLK_PARTITION_END_{clock} = ( 1.0E16 )
SCLK01_COEFFICIENTS_{clock} = ( 0.0 {start!r} 1.0 )

NAIF_BODY_NAME += ( '{name}' )
NAIF_BODY_CODE += ( {spacecraft} )
FRAME_{name}_BODY = {instrument}
FRAME_{instrument}_NAME = '{name}_BODY'
FRAME_{instrument}_CLASS = 3
FRAME_{instrument}_CLASS_ID = {instrument}
FRAME_{instrument}_CENTER = {spacecraft}
CK_{instrument}_SCLK = {spacecraft}
CK_{instrument}_SPK = {spacecraft}

\\begintext
"""
SPICE_FRAMES = {"EME2000": "J2000", "ICRF": "J2000", "GCRF": "J2000"}
LONGEST_NAME = 20  # letters of a body, whose frame is a variable of SPICE


@dataclass(frozen=True)
class Rows:
    """A run to be written, with its times."""

    run: xr.Dataset
    out: Path
    start: np.datetime64  # the date of time 0
    seconds: Array  # (time,)
    unit: float  # of the time of the run, s
    labels: dict[str, Any]
    overwrite: bool
    turn: Array  # (3, 3), from space of the run to the frame of the file

    @property
    def dates(self) -> list[str]:
        """The dates of the rows; in UTC a leap second is the second 60."""
        elapsed, second = np.round(self.seconds * 1e6).astype("timedelta64[us]"), np.timedelta64(1, "s")
        leaps = np.array(LEAPS.split() if self.labels["time_system"] == "UTC" else [], dtype="datetime64[us]")
        leaps = leaps[leaps > self.start]
        begins = leaps - self.start + second * np.arange(len(leaps))
        begun, ended = (np.searchsorted(times, elapsed, "right") for times in (begins, begins + second))
        dates = [str(date) for date in self.start + elapsed - second * begun]
        return [f"{d[:17]}60{d[19:]}" if within else d for d, within in zip(dates, begun > ended, strict=True)]


def write_message(run: xr.Dataset, out: Path, epoch: Any, labels: Mapping[str, Any], overwrite: bool) -> None:
    """Write an AEM, an OEM or a CK.  Raises `InputError`."""
    unknown = [key for key in labels if key not in LABELS]
    if unknown:
        raise InputError(f"expected {', '.join(LABELS)}, got {unknown[0]}.{hint(unknown[0], LABELS)}")
    chosen = LABELS | dict(labels)
    for key, usual in LABELS.items():
        value = chosen[key]
        if isinstance(usual, str) and (not isinstance(value, str) or not value.strip() or not value.isprintable()):
            raise InputError(f"{key}: expected a word, got {shown(value)}.")
    if "lane" in run.dims:
        raise InputError("expected the run of one body, got several lanes. Give run.isel(lane=0).")
    body = frame_of(run)
    unit = 1.0 if is_in_si(run) else body.time_unit
    if chosen["time_unit"] is not None:
        unit = positive_number(chosen["time_unit"], "time_unit")
    seconds = np.asarray(run["time"].values, dtype=np.float64) * unit
    if not (np.isfinite(seconds) & (abs(seconds) < LONGEST)).all():
        raise InputError(f"time_unit: expected times below {LONGEST:g} s, got {shown(float(abs(seconds).max()))}.")
    if seconds.ndim != 1 or (np.diff(seconds) <= 0).any():
        raise InputError("time: expected rows with increasing times, got others. A single row is run.isel(time=[0]).")
    dated, turn = body.epoch, np.eye(3)
    start = date_of(dated or epoch, "epoch")
    if dated and epoch is not None and date_of(epoch, "epoch") != start:
        raise InputError(f"epoch: expected {start}, the date of the orbit, or none, got {shown(epoch)}.")
    of_earth = (abs(np.asarray(parameters_of(run).get("mu", EARTH)) / EARTH - 1) < NEAR).all()
    if not of_earth and not {"frame", *("center",) * (out.suffix.lower() == ".oem")} <= labels.keys():
        raise InputError(
            "frame, center: expected the frame of the elements and the primary of an orbit that is not of the Earth, "
            "such as kr.export(run, 'body.oem', frame='EME2000', center='SUN'), got none."
        )
    if chosen["frame"] is None:
        turn = to_j2000(start) if dated else turn
        chosen["frame"] = "EME2000"
    MESSAGES[out.suffix.lower()](Rows(run, out, start, seconds, unit, chosen, overwrite, turn))


def to_j2000(date: np.datetime64) -> Array:
    """The rotation (3, 3) from the mean equator and equinox of a date to J2000."""
    from scipy.spatial.transform import Rotation

    T = float((date - J2000) / np.timedelta64(1, "s")) / CENTURY
    zeta, z, theta = (float(np.radians(np.polyval(c[::-1], T) * T / 3600)) for c in PRECESSION)
    return np.asarray(Rotation.from_euler("ZYZ", (-zeta, theta, -z)).as_matrix())


def _ccsds(rows: Rows) -> None:
    """Write an AEM or an OEM."""
    frame, before, after = rows.labels["frame"], "", ""
    if rows.out.suffix.lower() == ".aem":
        before, after, values = "DATA_START\n", "DATA_STOP\n", _attitudes(rows)[:, [1, 2, 3, 0]]
        texts = {"kind": "CCSDS_AEM_VERS = 1.0", "comment": "the axes in which the body was given are REF_FRAME_B"}
        texts["frames"] = f"REF_FRAME_A = {frame}\nREF_FRAME_B = SC_BODY_1\nATTITUDE_DIR = A2B"
        texts["types"] = "ATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = LAST\n"
    else:
        around = surroundings(rows.run)
        values = np.concatenate([around[k] @ rows.turn.T for k in ("position", "velocity")], -1) / 1000
        texts = {"kind": "CCSDS_OEM_VERS = 2.0", "comment": "space of the run is REF_FRAME", "types": ""}
        texts["frames"] = f"REF_FRAME = {frame}"
    dates = rows.dates
    head = META.format(created=_now(), start=dates[0], stop=dates[-1], **texts, **rows.labels)
    lines = [f"{date} {' '.join(map(repr, row))}\n" for date, row in zip(dates, values.tolist(), strict=True)]
    with written(rows.out, rows.overwrite) as scratch:
        scratch.write_text(f"{head}{before}{''.join(lines)}{after}", encoding="ascii", errors="replace")


def _attitudes(rows: Rows) -> Array:
    return np.asarray(algebra.quaternion_product(algebra.unit_quaternion(rows.turn), attitude_of(rows.run)))


# -- dates -----------------------------------------------------------------------------------------


def date_of(epoch: Any, name: str) -> np.datetime64:
    """The date of time 0.  Raises `InputError`, with the name of the argument or option."""
    try:
        start = np.datetime64("NaT" if isinstance(epoch, int | np.integer) else epoch, "us")  # 5 would be 5 us of 1970
    except (ValueError, TypeError):
        start = np.datetime64("NaT", "us")
    if np.isnat(start):
        raise InputError(
            f'{name}: expected the date of time 0, such as "2026-01-01T00:00:00", got {shown(epoch)}. Pass epoch=... '
            "(--epoch), or give the orbit its epoch."
        )
    return start


def _now() -> str:
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        now = datetime.now(UTC) if epoch is None else datetime.fromtimestamp(int(epoch), UTC)
    except (ValueError, OverflowError, OSError):
        raise InputError(f"SOURCE_DATE_EPOCH: expected seconds since 1970, got {shown(epoch)}.") from None
    return f"{now:%Y-%m-%dT%H:%M:%S}"


def _terrestrial(date: np.datetime64, time_system: str) -> float:
    """Seconds of terrestrial time since 2000-01-01T12:00:00.  Raises `InputError` for other scales."""
    ahead = {"UTC": 9.0, "TAI": 0.0, "TT": -TERRESTRIAL}.get(time_system)
    if ahead is None:
        raise InputError(f"time_system: expected UTC, TAI or TT for a .bc, got {shown(time_system)}.")
    if time_system == "UTC":
        passed = sum(date >= np.datetime64(leap, "us") for leap in LEAPS.split())
        if not passed:
            raise InputError(f"epoch: expected a date from 1972 on, when UTC begins, got {date}.")
        ahead += passed
    return float((date - J2000) / np.timedelta64(1, "s") + ahead + TERRESTRIAL)


# -- SPICE -----------------------------------------------------------------------------------------


def _ck(rows: Rows) -> None:
    try:
        import spiceypy
    except ImportError as error:
        raise InputError(f"SPICE kernels need the extra `spice`: pip install 'kreisel[spice]'. {error}") from error
    text = rows.out.with_suffix(".tsc")
    require_file(text, rows.overwrite)
    labels, seconds, q = rows.labels, rows.seconds, _attitudes(rows)
    craft = labels["spacecraft"]
    if not isinstance(craft, int) or craft >= 0:
        raise InputError(f"spacecraft: expected NAIF's number of a spacecraft, below 0, got {shown(craft)}.")
    frame = SPICE_FRAMES.get(labels["frame"], labels["frame"])
    first = rows.dates[0]
    ticks, omega = (seconds - seconds[0] + EARLY) * TICKS, _rates(rows.run, rows.unit)
    omega = None if omega is None else omega @ rows.turn.T
    gaps = np.zeros(0) if omega is None else np.linalg.norm(omega[:-1], axis=-1) * np.diff(seconds)
    apart = np.concatenate([[True], gaps >= math.pi])  # SPICE interpolates by the shorter rotation
    name = "".join(c if c.isalnum() else "_" for c in labels["name"].upper())[:LONGEST_NAME]
    clock = CLOCK.format(
        date=first,
        created=_now(),
        ck=rows.out.name,
        clock=-craft,
        instrument=1000 * craft,
        start=_terrestrial(rows.start, labels["time_system"]) + round(float(seconds[0]), 6) - EARLY,
        **labels | {"frame": frame, "name": name},
    )
    has_rates, rates = omega is not None, np.zeros((len(q), 3)) if omega is None else omega
    starts = ticks[apart] if has_rates else ticks[:1]
    segment = 1000 * craft, frame, has_rates, f"{name} by Kreisel"
    with written(rows.out, rows.overwrite) as scratch, written(text, rows.overwrite) as scratch_text:
        scratch.unlink()  # SPICE opens new files only
        scratch_text.write_text(clock, encoding="ascii", errors="replace")
        try:
            handle = spiceypy.ckopn(str(scratch), "Kreisel", 0)
            q = q * [1, -1, -1, -1]  # of g^T
            spiceypy.ckw03(handle, ticks[0], ticks[-1], *segment, len(ticks), ticks, q, rates, len(starts), starts)
            spiceypy.ckcls(handle)
        except spiceypy.utils.exceptions.SpiceyError as error:
            message = str(error).strip().splitlines()[-1]
            raise InputError(
                f"SPICE refuses the kernel: {message} Usual cause: frame={frame!r}, which SPICE does not "
                "know; J2000 is EME2000."
            ) from None


def _rates(run: xr.Dataset, unit: float) -> Array | None:
    """The angular velocity in space, rad/s (time, 3); None if the record of the run does not state it."""
    if is_in_si(run) and VELOCITY in run:
        omega, g = np.asarray(run[VELOCITY].values), algebra.rotation_matrix(attitude_of(run))
        return algebra.act(g, omega) if run[VELOCITY].attrs.get(AXES) == BODY else omega
    record = RunRecord.from_attrs(run.attrs)
    if record.is_own or "parameters" not in run.attrs or record.missing_from(run):
        return None
    model = model_for(run, None)
    if model.system.velocity is None:
        return None
    omega = algebra.axial(velocity_of(run, model))
    if model.system.frame is Frame.MOVING:
        omega = algebra.act(algebra.rotation_matrix(orientation_of(run)), omega)
    return np.asarray(omega / unit)


MESSAGES: dict[str, Callable[..., None]] = {".aem": _ccsds, ".oem": _ccsds, ".bc": _ck}
