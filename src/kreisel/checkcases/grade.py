"""The grade of a trajectory: its errors against the exact motion, and the drift of what the motion conserves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array, floats
from kreisel.errors import InputError, shown

if TYPE_CHECKING:
    from kreisel.checkcases.motion import Case

WIDTHS = {"angular_velocity": 3, "angular_velocity_space": 3, "attitude": 4, "momentum": 3, "position": 3, "energy": 0}


@dataclass(frozen=True)
class Row:
    """The largest error of a quantity, when it occurs, and the error at the end."""

    quantity: str
    largest: float
    time: float
    last: float
    unit: str


@dataclass(frozen=True)
class Grade:
    """The errors of a trajectory.  `str(grade)` is the table that `kreisel checkcase NAME --grade FILE` prints."""

    case: str
    rows: tuple[Row, ...]


def grade(case: Case, times: Any, quantities: Mapping[str, Any]) -> Grade:
    """The grade of a trajectory; arguments as in `Case.grade`.  Raises `InputError`."""
    rows = floats(times)
    values = {name: _rows(name, value, len(rows)) for name, value in quantities.items()}
    if not values:
        raise InputError(f"grade: expected at least one of {', '.join(WIDTHS)}, got none.")
    reference = case.reference(rows)
    table = []
    for name, value in values.items():
        exact = reference[name].values
        error = (
            angle_between(value, exact) if name == "attitude" else np.linalg.norm(np.atleast_2d(value - exact), axis=-1)
        )
        at = int(np.argmax(error))
        unit = "rad" if name == "attitude" else reference[name].attrs["units"]
        table.append(Row(name, float(error[at]), float(rows[at]), float(error[-1]), unit))
    return Grade(case.name, tuple(table))


def angle_between(q: Array, p: Array) -> Array:
    """The angle of the rotation between attitudes, rad: quaternions of either sign."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    near = np.where((q * p).sum(-1, keepdims=True) < 0, -q, q)
    return np.asarray(4 * np.arcsin(np.minimum(np.linalg.norm(near - p, axis=-1) / 2, 1)))


def _rows(name: str, value: Any, count: int) -> Array:
    if name not in WIDTHS:
        raise InputError(f"grade: expected one of {', '.join(WIDTHS)}, got {shown(name)}.")
    array, shape = floats(value), (count, WIDTHS[name]) if WIDTHS[name] else (count,)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers of shape {shape}, got {shown(value)}.")
    return array
