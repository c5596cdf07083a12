"""The attitude of a run as an attitude ephemeris message.

[CCSDS 504.0-B-1, Attitude Data Messages, 2008]
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.errors import InputError, explained, shown
from kreisel.files import require_file, written
from kreisel.runs.geometry import attitude_of
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import flag, positive_number
from kreisel.storage.nodes import target
from kreisel.storage.opening import open_run

if TYPE_CHECKING:
    import xarray as xr

MESSAGE = """CCSDS_AEM_VERS = 1.0
CREATION_DATE = {created}
ORIGINATOR = {originator}

META_START
COMMENT Kreisel: space of the run is REF_FRAME_A, the axes in which its body was given REF_FRAME_B
OBJECT_NAME = {name}
OBJECT_ID = {id}
CENTER_NAME = {center}
REF_FRAME_A = {frame}
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = {system}
START_TIME = {start}
STOP_TIME = {stop}
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = LAST
META_STOP

DATA_START
"""
SUFFIX = ".aem"
LONGEST = 2**53 // 10**6  # seconds, whose microseconds a double counts


@explained
def write_aem(
    run: xr.Dataset | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    epoch: Any,
    name: str = "BODY",
    identifier: str = "0000-000A",
    center: str = "EARTH",
    frame: str = "EME2000",
    time_system: str = "UTC",
    originator: str = "KREISEL",
    time_unit: float | None = None,
    overwrite: bool = False,
) -> None:
    """Write the attitude of a run, n = 3, as a CCSDS attitude ephemeris message (AEM), text.

    epoch       of time 0: "2026-01-01T00:00:00", or what numpy.datetime64 takes
    frame       what the frame "space" of the run is called, as REF_FRAME_A
    time_unit   of the run, s; without it that of its body of `kr.physical`, else 1 s
    overwrite   replaces a file that Kreisel wrote

    A row is the time, to a microsecond, and the quaternion (x, y, z, w) of the attitude g of the axes in which the body
    was given, as in `quaternions`: for ATTITUDE_DIR = A2B its matrix in the sense of the standard is g^T, which takes
    components in space to those along these axes.  CREATION_DATE is that of the call, or of the environment variable
    SOURCE_DATE_EPOCH, in seconds since 1970, for files that are the same each time.  Raises `InputError` for a run
    without an orientation, of several lanes, or with times that are no dates.
    """
    where = target(out)
    flag(overwrite, "overwrite")
    if where.suffix.lower() != SUFFIX:
        raise InputError(f"The attitude must go to a file that ends in .aem, got {str(out)!r}.")
    require_file(where, overwrite)
    data = open_run(run) if isinstance(run, str | os.PathLike) else run
    q, body = attitude_of(data), RunRecord.from_attrs(data.attrs).body_frame
    if q.ndim != 2:
        raise InputError("expected the run of one body, got several lanes. Give run.isel(lane=0).")
    named = {"originator": originator, "name": name, "identifier": identifier, "center": center, "frame": frame}
    for key, value in (named | {"time_system": time_system}).items():
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            raise InputError(f"{key}: expected a word, got {shown(value)}.")
    unit = time_unit if time_unit is not None else 1.0 if body is None else body.time_unit
    start = date_of(epoch, "epoch")
    dates = _dates(start, np.asarray(data["time"].values, dtype=np.float64) * positive_number(unit, "time_unit"))
    head = MESSAGE.format(
        created=_now(),
        originator=originator,
        name=name,
        id=identifier,
        center=center,
        frame=frame,
        system=time_system,
        start=dates[0],
        stop=dates[-1],
    )
    rows = [f"{date} {x!r} {y!r} {z!r} {w!r}" for date, (w, x, y, z) in zip(dates, q.tolist(), strict=True)]
    with written(where, overwrite) as scratch:
        scratch.write_text(head + "\n".join(rows) + "\nDATA_STOP\n", encoding="ascii", errors="replace")


def date_of(epoch: Any, name: str) -> np.datetime64:
    """The date of time 0.  Raises `InputError`, with the name of the argument or option."""
    try:
        start = np.datetime64(epoch, "us")
    except (ValueError, TypeError):
        start = np.datetime64("NaT")
    if np.isnat(start):
        raise InputError(f'{name}: expected the date of time 0, such as "2026-01-01T00:00:00", got {shown(epoch)}.')
    return start


def _now() -> str:
    """The time of creation, UTC.  Raises `InputError`."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        now = datetime.now(UTC) if given is None else datetime.fromtimestamp(int(given), UTC)
    except (ValueError, OverflowError, OSError):
        raise InputError(f"SOURCE_DATE_EPOCH: expected seconds since 1970, got {shown(given)}.") from None
    return f"{now:%Y-%m-%dT%H:%M:%S}"


def _dates(start: np.datetime64, seconds: np.ndarray) -> list[str]:
    if not (np.isfinite(seconds) & (abs(seconds) < LONGEST)).all():
        raise InputError(f"time_unit: expected times below {LONGEST:g} s, got {shown(float(abs(seconds).max()))}.")
    return [str(date) for date in start + np.round(seconds * 1e6).astype("timedelta64[us]")]
