"""Axes and units of the body from which a model was created, so that a run can be shown in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, shown

ORTHOGONAL = 1e-9
ORIENTATION = "g"
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
    """The shape of a table; () for a damaged one."""
    if not isinstance(value, list) or len(value) != 4:
        return ()
    good = all(isinstance(v, float) and 0 <= v < np.inf for v in value[1:])
    return (str(value[0]), *value[1:]) if good else ()
