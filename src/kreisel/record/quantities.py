"""Quantities with units, by pint: "3 kg", "20 rpm", pint quantities; plain values are in SI and do not need it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import floats
from kreisel.errors import InputError, explained, shown

if TYPE_CHECKING:
    import pint

MOST_AXES = 4  # lists within lists
QUANTITY = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*(?P<unit>[A-Za-zµ°%].*)", re.IGNORECASE)


@explained
@dataclass(frozen=True)
class Scale:
    """The unit of one variable of a scaled system: `size` of the SI unit `unit`."""

    unit: str
    size: float

    def __post_init__(self) -> None:
        size = floats(self.size)
        if size.ndim or np.isnan(size) or not isinstance(self.unit, str):
            raise InputError(
                f"Scale: expected a unit and its size, a number, got {shown(self.unit)}, {shown(self.size)}."
            )

    def scaled(self, value: Any, name: str = "the value") -> Any:
        """A measured value, with units or in SI, in the unit of the scaled system.  Raises `InputError`."""
        array = floats(si(value, self.unit, name))
        if not np.isfinite(array).all():
            raise InputError(f"{name}: expected values in {self.unit}, or a quantity, got {shown(value)}.")
        return array / self.size


Scales = Mapping[str, Scale]


@cache
def registry() -> pint.UnitRegistry[Any]:
    """Pint's registry of the process, so that its quantities mix with yours.  Raises `InputError` without pint."""
    try:
        import pint
    except ImportError:
        raise InputError(
            "Units need pint, which is not installed: pip install 'kreisel[units]'. Plain values are in SI units "
            "and need none."
        ) from None
    return pint.get_application_registry()  # type: ignore[no-untyped-call]


@explained
def si(value: Any, unit: str, name: str) -> Any:
    """A quantity in the named SI unit; plain values are already in SI.

    A string such as "3 kg", a quantity of pint, astropy or unyt, lists of these or of floats, nested like a matrix,
    values with one unit for all, (values, "kg cm^2"), or an array of xarray with the attribute `units`.  Returns a
    float or an array (...).  Raises `InputError` for other dimensions, unknown units, and rates in Hz or 1/s for
    angular velocities.
    """
    for label, text in (("unit", unit), ("name", name)):
        if not isinstance(text, str):
            raise InputError(f"{label}: expected text such as 'kg m^2' or 'inertia', got {shown(text)}.")
    if hasattr(value, "to_value"):
        try:
            return value.to_value(unit)
        except Exception as error:  # of its package
            raise InputError(f"{name} must have the dimension of {unit}, got {shown(value)}: {error}.") from None
    if stated := stated_unit(value):
        value = (algebra.lanes_in_front(value).values, stated)
    value = value.tolist() if isinstance(value, np.ndarray) and value.dtype.kind in "OU" else value
    if isinstance(value, str):
        value = parsed(registry().Quantity, value, f"{name} must be a quantity such as '1 {unit}'")
    elif one_unit(value):
        try:
            entries = np.asarray(value[0], dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            got = shown(value[0])
            raise InputError(f"{name}: expected values and one unit, (values, '{unit}'), got {got}.") from None
        value = entries * (1.0 if value[1] == unit else parsed_unit(value[1], name))
    elif isinstance(value, list | tuple) and _has_units(value):
        parts = [si(v, unit, name) for v in value]
        return np.array(parts) if len({np.shape(entry) for entry in parts}) == 1 else value
    if not _is_quantity(value):
        if algebra.loses(value) or isinstance(value, complex) or getattr(value, "dtype", np.dtype(float)).kind in "cMm":
            raise InputError(f"{name} must be real values in SI units ({unit}), or a quantity, got {shown(value)}.")
        return value
    try:
        return converted(value, unit, name).magnitude * 1.0
    except OverflowError:
        raise InputError(f"{name}: expected a number that a double can hold, got {shown(value)}.") from None


def in_base_units(values: Any) -> Any:
    """Texts of quantities, "3 rpm", as floats in units of SI; other values unchanged."""
    texts = np.asarray(values)
    if texts.dtype.kind != "U" or not all(QUANTITY.fullmatch(text) for text in texts.flat):
        return values
    return np.reshape([registry().Quantity(text).to_base_units().magnitude for text in texts.flat], texts.shape)


def one_unit(value: Any) -> bool:
    """Whether it is (values, unit), such as ([1, 2, 3], "cm") or (3, "cm"); "3 cm" is a single quantity."""
    if not isinstance(value, list | tuple) or len(value) != 2 or not isinstance(value[1], str):
        return False
    if isinstance(value[0], str) or _is_quantity(value[0]):
        return False
    return isinstance(value[0], list | tuple | np.ndarray) or value[1].strip()[:1].isalpha()


def _has_units(value: Any, levels: int = MOST_AXES) -> bool:
    """Whether there is text or a quantity in lists within lists."""
    if isinstance(value, list | tuple) and levels:
        return any(_has_units(v, levels - 1) for v in value)
    return isinstance(value, str) or _is_quantity(value) or hasattr(value, "to_value") or stated_unit(value) != ""


def stated_unit(value: Any) -> str:
    """The attribute `units` of an array of xarray; "" without it, and for "1"."""
    unit = value.attrs.get("units", "1") if hasattr(value, "dims") else "1"
    return unit if isinstance(unit, str) and unit != "1" else ""


def _is_quantity(value: Any) -> bool:
    return hasattr(value, "magnitude") and hasattr(value, "to")


def parsed(kind: Any, text: str, expected: str) -> Any:
    """A quantity or a unit of pint from text.  Raises `InputError`."""
    try:
        return kind(text)
    except Exception as error:  # pint raises tokenize, syntax, attribute and further errors
        raise InputError(f"{expected}, got {shown(text)}: {error}.") from None


def parsed_unit(unit: str, name: str) -> Any:
    """A unit of pint from text.  Raises `InputError`."""
    return parsed(registry().Unit, unit, f"{name} needs a unit that pint knows, such as 'rad/s'")


def converted(value: Any, unit: str, name: str) -> Any:
    """A quantity of pint in another unit.  Raises `InputError`, also for Hz and 1/s, which pint converts to rad/s."""
    import pint

    target = parsed_unit(unit, name)
    counts = ["radian" in dict((1 * quantity).to_root_units().unit_items()) for quantity in (value, target)]
    if str(value.dimensionality) == str(target.dimensionality) == "1 / [time]" and counts[0] != counts[1]:
        raise InputError(
            f"{name} must be in {unit}, got {value:~}, which may count revolutions or radians. Usual cause: a "
            f"frequency for an angular velocity. Three revolutions a second are '3 turn/s' or '180 rpm', 3 * 2 pi = "
            "18.85 rad/s; three radians a second are '3 rad/s'."
        )
    try:
        return value.to(target)
    except pint.DimensionalityError:
        raise InputError(f"{name} must have the dimension of {unit}, got {value}.") from None
