"""Axes and units of the body from which a model was created, so that a run can be shown in them; quantities.

Quantities with units are read by pint: "3 kg", "20 rpm", pint quantities; plain values are in SI and do not need it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, floats
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, shown

if TYPE_CHECKING:
    import pint


ORTHOGONAL = 1e-9
ORIENTATION = "g"
MOST_AXES = 4  # lists within lists
QUANTITY = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*(?P<unit>[A-Za-zµ°%].*)", re.IGNORECASE)
SEPARATED = re.compile(r",|\d\s+(?!1/)[\d.]")  # within a number, but not in "3 1/s"
AXES, STATE, BODY = "axes", "state", "body"  # the attribute of variables with components in the body, its values


@dataclass(frozen=True, eq=False)
class BodyFrame:
    """Axes and units of a body, or of a body in each lane; `OF_SYSTEM`, which is false, for a system without a body.

    axes    (3, 3), v_body = axes v_state: the columns are the axes of the state along the user's axes; (lanes, 3, 3)
    units   name -> (unit, size): the unit of the time and of variables of a run is `size` times this unit of SI; the
            size may be (lanes,), of vectors (lanes, 1), except that of the time
    along   letters of the state whose components are along the axes of the state: axial or polar vectors
    names   of the variables of a run in SI, by the letters of the state; none for a run in units of the state
    title   of the body, for a run in SI
    epoch   the date of time 0 in UTC, ISO text; "" for none
    shape   "box", "ellipsoid" or "cylinder" (along its first axis) and its half lengths, m; () if it is not known
    lanes   names of the lanes; () for numbers
    """

    axes: Array = field(default_factory=lambda: np.eye(3))
    units: Mapping[str, tuple[str, Any]] = field(default_factory=dict)
    along: Sequence[str] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    epoch: str = ""
    shape: tuple[Any, ...] = ()
    lanes: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.units)

    @classmethod
    def in_units(cls, time: float, momentum: float, axes: Any = None, letter: str = "M", **sizes: Any) -> Self:
        """The frame of a state with units of time and momentum, s and kg m^2/s; `sizes`: of further units by name."""
        units = {"time": ("s", time), letter: ("kg m^2/s", momentum), **sizes, "energy": ("J", momentum / time)}
        return cls(np.eye(3) if axes is None else axes, units)

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> BodyFrame:
        """The frame that `table` describes.  Raises `InputError` for a damaged description."""
        try:
            axes = np.array(table["axes"], dtype=np.float64)
            units = {str(k): (str(unit), _size(size)) for k, (unit, size) in table["units"].items()}
            along, lanes = ([str(k) for k in table.get(name, ())] for name in ("along", "lanes"))
            names = {str(k): str(name) for k, name in table.get("names", {}).items()}
            good = axes.shape[-2:] == (3, 3) and abs(axes.mT @ axes - np.eye(3)).max() < ORTHOGONAL
            good = good and bool((np.linalg.det(axes) > 0).all()) and "along" in table
            good = good and all(np.all((np.array(s) > 0) & (np.array(s) < np.inf)) for _, s in units.values())
        except (TypeError, ValueError, KeyError, AttributeError, OverflowError):
            good = False
        if not good:
            raise InputError(f"The attribute body is damaged: expected axes, units and along, got {shown(table)}.")
        title, epoch = (str(table.get(k, "")) for k in ("title", "epoch"))
        return cls(axes, units, along, names, title, epoch, _shape(table.get("shape")), tuple(lanes))

    @property
    def table(self) -> dict[str, Any]:
        """The frame as plain data."""
        units = {k: [unit, np.asarray(size).tolist()] for k, (unit, size) in self.units.items()}
        table = {"axes": self.axes.tolist(), "along": [*self.along], "units": units}
        entries = {"epoch": self.epoch, "shape": list(self.shape), "lanes": list(self.lanes)}
        table |= {k: v for k, v in entries.items() if v}
        return table | ({"names": dict(self.names), "title": self.title} if self.names else {})

    @property
    def differs(self) -> bool:
        """Whether lanes have different axes or units."""
        return self.axes.ndim > 2 or any(np.ndim(size) for _, size in self.units.values())

    def of_lanes(self, ids: Any) -> BodyFrame:
        """The frame of some lanes."""
        if not self.differs:
            return self

        def of(size: Any) -> Any:
            size = size[ids] if np.ndim(size) else size
            return size if np.ndim(ids) else float(np.max(size))

        units = {k: (unit, of(size)) for k, (unit, size) in self.units.items()}
        return replace(self, axes=self.axes[ids] if self.axes.ndim > 2 else self.axes, units=units)

    def is_like(self, frame: BodyFrame, names: Iterable[str] | None = None) -> bool:
        """Whether axes and units are equal; `names`: units of these variables only."""
        names = {*self.units, *frame.units} if names is None else names
        same = np.array_equal(self.axes, frame.axes)
        return same and all(np.array_equal(self.size(name), frame.size(name)) for name in names)

    @property
    def letters(self) -> dict[str, str]:
        """The letters of the state by the names of a run in SI."""
        return {name: letter for letter, name in self.names.items()}

    def size(self, name: str) -> Any:
        """The unit of a variable in SI; 1 without a unit."""
        return self.units.get(name, ("1", 1.0))[1]

    @cached_property
    def turned(self) -> bool:
        """Whether the axes of the state differ from the user's axes."""
        return bool((self.axes != np.eye(3)).any())

    @cached_property
    def quaternion(self) -> Array:
        """The axes as a unit quaternion (..., 4) = (w, x, y, z)."""
        return algebra.unit_quaternion(self.axes)

    def attributes(self, name: str) -> dict[str, str]:
        """The attributes `units` and `axes` of a variable of a run: the latter if it has components in the body."""
        unit, size = self.units.get(name, ("1", 1.0))
        inside = {AXES: STATE if self.turned else BODY} if name in (*self.along, ORIENTATION) else {}
        return {"units": unit if np.all(size == 1) else "1", **inside}

    @property
    def time_unit(self) -> float:
        """The unit of time of a run, s."""
        return float(self.size("time"))

    def time_text(self, time: float, digits: str = "g") -> str:
        """A time of the state in words: in s for a run in SI, else in the unit of the state."""
        return f"{time * self.time_unit:{digits}} s" if self.names else f"{time:{digits}}"

    def vectors(self, v: Array) -> Array:
        """Vectors ([lanes,] 3) along the user's axes, from vectors along the axes of the state."""
        return self._along(v, self.axes.mT) if self.turned else v

    def inside(self, v: Array) -> Array:
        """The inverse of `vectors`."""
        return self._along(v, self.axes) if self.turned else v

    def _along(self, v: Array, matrix: Array) -> Array:
        return np.asarray(v @ matrix if matrix.ndim < 3 else (v[..., None, :] @ matrix)[..., 0, :])

    def attitude(self, g: Array) -> Array:
        """Orientations (..., 4) of the user's axes, from orientations of the axes of the state."""
        return algebra.quaternion_product(g, algebra.inverse_turn(self.quaternion)) if self.turned else g

    def change(self, letter: str, forward: bool) -> Callable[[Array], Array]:
        """The change of the values of a variable to SI and the user's axes (forward), or back."""
        if letter == ORIENTATION:
            back = partial(algebra.quaternion_product, b=self.quaternion)
            return (self.attitude if forward else back) if self.turned else unchanged
        size = self.size(letter) if forward else 1 / self.size(letter)
        if letter not in self.along or not self.turned:
            return scaling(size)
        matrix = (self.axes.mT if forward else self.axes) * (size[..., None] if np.ndim(size) else size)
        return partial(self._along, matrix=matrix)

    def components(self, values: Mapping[Any, Any], forward: bool) -> dict[str, Any]:
        """Components by name, changed to SI and words (forward), or to letters, units and axes of the state."""
        out = {}
        for name, value in values.items():
            new = (self.names if forward else self.letters).get(str(name), str(name))
            out[new] = self.change(str(name) if forward else new, forward)(np.asarray(value))
        return out


OF_SYSTEM = BodyFrame()


def unchanged(values: Array) -> Array:
    """The change of values that have the units and axes of the result already."""
    return values


def scaling(factor: Any) -> Callable[[Array], Array]:
    """Multiplication by a factor."""
    return unchanged if np.all(factor == 1) else lambda v: v * factor


def _size(value: Any) -> Any:
    return np.array(value, dtype=np.float64) if isinstance(value, list) else float(value)


def _shape(value: Any) -> tuple[Any, ...]:
    """The shape of a table: a kind, and half lengths unless the inertia decides them; () for a damaged one."""
    if not isinstance(value, list) or len(value) not in (1, 4):
        return ()
    good = all(isinstance(v, float) and 0 <= v < np.inf for v in value[1:])
    return (str(value[0]), *value[1:]) if good else ()


# -- quantities ------------------------------------------------------------------------------------------


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


_REQUESTED: ContextVar[dict[str, set[str]] | None] = ContextVar("_REQUESTED", default=None)


@contextmanager
def units_requested() -> Iterator[dict[str, set[str]]]:
    """Name -> units in which `si` was called for it within the block."""
    units: dict[str, set[str]] = {}
    token = _REQUESTED.set(units)
    try:
        yield units
    finally:
        _REQUESTED.reset(token)


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
    if (requested := _REQUESTED.get()) is not None:
        requested.setdefault(name, set()).add(unit)
    if hasattr(value, "to_value"):
        try:
            return value.to_value(unit)
        except Exception as error:  # of its package
            raise InputError(f"{name} must have the dimension of {unit}, got {shown(value)}: {error}.") from None
    if stated := stated_unit(value):
        value = (algebra.lanes_in_front(value).values, stated)
    value = value.tolist() if isinstance(value, np.ndarray) and value.dtype.kind in "OU" else value
    if isinstance(value, str):
        rates = ", '20 rpm' or '3 turn/s'" if unit == "rad/s" else ""  # pint does not know "3 rev/s"
        wanted = "number" if unit == "1" else f"quantity such as '1 {unit}'"
        expected = f"{name} must be a {wanted}{rates}"
        if SEPARATED.search(value):  # pint reads 15 in "1,5", and 1 times 500 in "1 500"
            raise InputError(f"{expected}, got {shown(value)}: write 1.5 and 1500, without a comma or space in them.")
        value = parsed(registry().Quantity, value, expected)
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


def base_unit(values: Any) -> str:
    """Unit of SI of the values of `in_base_units`, "rad/s" for "3 rpm"; "" without units."""
    if in_base_units(values) is values:
        return ""
    unit = registry().Quantity(np.asarray(values).flat[0]).to_base_units().units
    return f"{unit:~C}".replace("**", "^").replace("*", " ")


def unit_and_axes(attrs: Mapping[str, Any]) -> str:
    """The unit of a variable in parentheses, and its axes if they are not the axes in which the body was given."""
    words = str(attrs.get("units", "1")), "axes of the state" * (attrs.get(AXES) == STATE)
    text = ", ".join(word for word in words if word not in ("", "1"))
    return f" ({text})" if text else ""


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
