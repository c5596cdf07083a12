"""Numbers in SI units, checked, and the units of scaled systems."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.units import Scale, Scales, si

STANDARD_GRAVITY = 9.80665  # m/s^2, the conventional value (CGPM 1901)


def check(*, positive: bool = False, **values: Any) -> None:
    """Raises `InputError` for what is not a finite number, positive if asked."""
    for name, value in values.items():
        try:
            number = isinstance(value, int | float | np.floating | np.integer) and math.isfinite(value)
        except OverflowError:  # a whole number beyond the doubles
            number = False
        if not number or (positive and value <= 0):
            raise InputError(f"{name} must be a finite number{' > 0' * positive} in SI units; {shown(value)} came.")


def to_si(body: Any, **units: str) -> None:
    """Fields of a frozen record, from quantities to numbers in SI."""
    for name, unit in units.items():
        object.__setattr__(body, name, si(getattr(body, name), unit, name))


@dataclass(frozen=True)
class Units:
    """Units of a scaled system: mass in kg, length in m, time in s.  Raises `InputError` unless all are > 0."""

    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0

    def __post_init__(self) -> None:
        to_si(self, mass="kg", length="m", time="s")
        check(positive=True, **asdict(self))


SI = Units()
MOMENT, RATE = "kg m^2", "rad/s"


def scales_of(time: float, **others: tuple[str, float]) -> Scales:
    """Scales of the time and of other variables, each (SI unit, size)."""
    return {"time": Scale("s", time), **{name: Scale(unit, size) for name, (unit, size) in others.items()}}


def numbers(value: Any, name: str, shapes: tuple[tuple[int, ...], ...] = ()) -> Array:
    """Finite floats of one of the shapes, or (..., 3).  Raises `InputError`."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.full(0, np.nan)
    fits = array.shape in shapes if shapes else array.shape[-1:] == (3,)
    if not fits or not np.isfinite(array).all():
        told = " or ".join(map(str, shapes)) or "(..., 3)"
        raise InputError(f"{name} must be finite numbers of shape {told}; {shown(value)} came.")
    return array
