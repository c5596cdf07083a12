"""Messages and kernels: attitude as AEM (CCSDS) and CK (SPICE), orbit as OEM.

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

import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import numpy as np
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies.orbit import EARTH
from kreisel.errors import InputError, hint, shown
from kreisel.files import require_file, written
from kreisel.record.contract import Frame
from kreisel.record.units import AXES, BODY
from kreisel.runs.geometry import (
    attitude_of,
    model_for,
    orientation_of,
    parameters_of,
    surroundings,
    velocity_of,
)
from kreisel.runs.in_si import VELOCITY, is_in_si
from kreisel.runs.run_record import RunRecord, frame_of
from kreisel.runs.settings import positive_number

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
WORD = re.compile("[ -~]*[!-~][ -~]*")  # text of ASCII, not blank
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
        if isinstance(usual, str) and not (isinstance(value, str) and WORD.fullmatch(value)):
            raise InputError(f"{key}: expected a word in ASCII, got {shown(value)}.")
    chosen["time_system"] = chosen["time_system"].upper()
    if "lane" in run.dims:
        raise InputError("expected the run of one body, got several lanes. Give run.isel(lane=0).")
    if "kreisel_measured" in run.attrs or "time" not in run:  # without date and primary, and its time may be in minutes
        raise InputError(
            "expected a run with its times, got another Dataset, such as one of units.measured. Export the run itself."
        )
    body = frame_of(run)
    unit = 1.0 if is_in_si(run) else body.time_unit
    if chosen["time_unit"] is not None:
        if body or is_in_si(run):
            raise InputError("time_unit: expected none, since the times of a run of a body are in s, got one.")
        unit = positive_number(chosen["time_unit"], "time_unit")
    seconds = np.asarray(run["time"].values, dtype=np.float64) * unit
    if not (np.isfinite(seconds) & (abs(seconds) < LONGEST)).all():
        raise InputError(f"time_unit: expected times below {LONGEST:g} s, got {shown(float(abs(seconds).max()))}.")
    if seconds.ndim != 1 or not len(seconds) or (np.diff(np.round(seconds * 1e6)) <= 0).any():
        raise InputError(
            "time: expected rows whose times increase by microseconds or more, got others. A single row is "
            "run.isel(time=[0])."
        )
    dated, turn = body.epoch, np.eye(3)
    start = date_of(dated or epoch, "epoch")
    if dated and epoch is not None and date_of(epoch, "epoch") != start:
        raise InputError(f"epoch: expected {start}, the date of the orbit, or none, got {shown(epoch)}.")
    if dated and chosen["time_system"] != "UTC":
        raise InputError(
            f"time_system: expected UTC, in which the orbit has its date, got {shown(chosen['time_system'])}."
        )
    of_earth = (abs(np.asarray(parameters_of(run).get("mu", EARTH)) / EARTH - 1) < NEAR).all()
    if not of_earth and not {"frame", *("center",) * (out.suffix.lower() == ".oem")} <= labels.keys():
        raise InputError(
            "frame, center: expected the frame of the elements and the primary of an orbit that is not of the Earth, "
            "such as kr.export(run, 'body.oem', frame='EME2000', center='SUN') (--frame EME2000 --center SUN), got "
            f"{', '.join(labels) or 'none'}."
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
        scratch.write_text(f"{head}{before}{''.join(lines)}{after}", encoding="ascii")


def _attitudes(rows: Rows) -> Array:
    return np.asarray(algebra.quaternion_product(algebra.unit_quaternion(rows.turn), attitude_of(rows.run)))


# -- dates -----------------------------------------------------------------------------------------


def date_of(epoch: Any, name: str) -> np.datetime64:
    """The date of time 0.  Raises `InputError`, with the name of the argument or option."""
    try:
        with catch_warnings(action="ignore", category=UserWarning):  # of a zone such as Z, which is converted to UTC
            start = np.datetime64("NaT" if isinstance(epoch, int | np.integer) else epoch, "us")  # 5 is 5 us of 1970
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


def leap_seconds(dates: Any) -> Any:
    """TAI - UTC, s, on dates in UTC (...); before 1972, when UTC begins, 9."""
    return 9 + np.searchsorted(np.array(LEAPS.split(), dtype="datetime64[us]"), dates, "right")


def _terrestrial(date: np.datetime64, time_system: str) -> float:
    """Seconds of terrestrial time since 2000-01-01T12:00:00.  Raises `InputError` for other scales."""
    ahead = {"UTC": float(leap_seconds(date)), "TAI": 0.0, "TT": -TERRESTRIAL}.get(time_system)
    if ahead is None:
        raise InputError(f"time_system: expected UTC, TAI or TT for a .bc, got {shown(time_system)}.")
    if time_system == "UTC" and ahead < 10:
        raise InputError(f"epoch: expected a date from 1972 on, when UTC begins, got {date}.")
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
            raise InputError(
                f"SPICE refuses the kernel: {error.long} Usual cause: frame={frame!r}, which SPICE does not "
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
