"""Axes and units of the body from which a model was created, so that a run can be shown in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, shown

ORTHOGONAL = 1e-9
AXES, STATE, BODY = "axes", "state", "body"  # the attribute of variables with components in the body, its values


@dataclass(frozen=True, eq=False)
class BodyFrame:
    """Axes and units of a body.

    axes    (3, 3), v_body = axes v_state: the columns are the axes of the state along the user's axes
    units   name -> (unit, size): the unit of the time and of variables of a run is `size` times this unit of SI
    along   letters of the state whose components are along the axes of the state: axial or polar vectors
    names   of the variables of a run in SI, by the letters of the state; none for a run in units of the state
    title   of the body, for a run in SI
    epoch   the date of time 0 in UTC, ISO text; "" for none
    shape   "box", "ellipsoid" or "cylinder" (along its first axis) and its half lengths, m; () if it is not known
    """

    axes: Array = field(default_factory=lambda: np.eye(3))
    units: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    along: Sequence[str] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    epoch: str = ""
    shape: tuple[Any, ...] = ()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> BodyFrame:
        """The frame that `table` describes.  Raises `InputError` for a damaged description."""
        try:
            axes = np.array(table["axes"], dtype=np.float64)
            units = {str(k): (str(unit), float(size)) for k, (unit, size) in table["units"].items()}
            along = [str(k) for k in table["along"]]
            names = {str(k): str(name) for k, name in table.get("names", {}).items()}
            good = axes.shape == (3, 3) and abs(axes.T @ axes - np.eye(3)).max() < ORTHOGONAL
        except (TypeError, ValueError, KeyError, AttributeError, OverflowError):
            good = False
        if not good or not np.linalg.det(axes) > 0 or not all(0 < size < np.inf for _, size in units.values()):
            raise InputError(f"The attribute body is damaged: expected axes, units and along, got {shown(table)}.")
        title, epoch = (str(table.get(k, "")) for k in ("title", "epoch"))
        return cls(axes, units, along, names, title, epoch, _shape(table.get("shape")))

    @property
    def table(self) -> dict[str, Any]:
        """The frame as plain data."""
        units = {k: [unit, size] for k, (unit, size) in self.units.items()}
        table = {"axes": self.axes.tolist(), "along": [*self.along], "units": units}
        table |= {k: v for k, v in (("epoch", self.epoch), ("shape", list(self.shape))) if v}
        return table | ({"names": dict(self.names), "title": self.title} if self.names else {})

    @property
    def turned(self) -> bool:
        """Whether the axes of the state differ from the user's axes."""
        return not np.array_equal(self.axes, np.eye(3))

    @cached_property
    def quaternion(self) -> Array:
        """The axes as a unit quaternion (4,) = (w, x, y, z)."""
        return algebra.unit_quaternion(self.axes)

    def attributes(self, name: str) -> dict[str, str]:
        """The attributes `units` and `axes` of a variable of a run: the latter if it has components in the body."""
        unit, size = self.units.get(name, ("1", 1.0))
        inside = {AXES: STATE if self.turned else BODY} if name in (*self.along, "g") else {}
        return {"units": unit if size == 1 else "1", **inside}

    @property
    def time_unit(self) -> float:
        """The unit of time of a run, s."""
        return self.units.get("time", ("s", 1.0))[1]

    def time_text(self, time: float, digits: str = "g") -> str:
        """A time of the state in words: in s for a run in SI, else in the unit of the state."""
        return f"{time * self.time_unit:{digits}} s" if self.names else f"{time:{digits}}"

    def vectors(self, v: Array) -> Array:
        """Vectors (..., 3) along the user's axes, from vectors along the axes of the state."""
        return np.asarray(v @ self.axes.T) if self.turned else v

    def attitude(self, g: Array) -> Array:
        """Orientations (..., 4) of the user's axes, from orientations of the axes of the state."""
        return algebra.quaternion_product(g, algebra.inverse_turn(self.quaternion)) if self.turned else g


def _shape(value: Any) -> tuple[Any, ...]:
    """The shape of a table; () for a damaged one."""
    if not isinstance(value, list) or len(value) != 4:
        return ()
    good = all(isinstance(v, float) and 0 <= v < np.inf for v in value[1:])
    return (str(value[0]), *value[1:]) if good else ()
