"""Conventions of engines: directions of the axes, the order of a quaternion, the unit of length.

The equations of a rotating body have the same components in a left-handed frame, if angular velocity, momentum, torque
and quaternion follow its left-hand rule; so a step is the same in every engine, and only data are converted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.languages.parts import Body, Field

WORDS = {"F": "forward", "B": "back", "L": "left", "R": "right", "U": "up", "D": "down"}
QUATERNIONS = ("s.g", "q", "axes")
LAST, FIRST = [1, 2, 3, 0], [3, 0, 1, 2]  # the places of w, x, y, z if w comes last, and first


@dataclass(frozen=True)
class Convention:
    """The frame of an engine.

    axes    directions of its axes x, y, z: Forward, Back, Left, Right, Up, Down
    source  a document that states them
    length  m in a unit of its lengths

    In Kreisel the axes are forward, left and up, as in ROS, lengths are in m, and a quaternion is (w, x, y, z); engines
    begin with x.  A vector of an engine is S v, S the matrix; an axial vector, such as an angular velocity, det(S) S v.
    """

    axes: str
    source: str
    length: float = 1.0

    @property
    def matrix(self) -> Array:
        """S (3, 3)."""
        return np.concatenate([np.eye(3), -np.eye(3)])[["FLUBRD".find(axis) for axis in self.axes]]

    @property
    def handed(self) -> int:
        """1 if the axes are right-handed, -1 if they are left-handed."""
        return round(float(np.linalg.det(self.matrix)))

    def tensor(self, inertia: Array) -> Array:
        """An inertia tensor, kg m^2, along the axes and in the units of the engine."""
        return self.matrix @ inertia @ self.matrix.T / self.length**2

    def body(self, body: Body) -> Body:
        """A file whose quaternions are (x, y, z, w)."""

        def reordered(apply: Callable[..., Any]) -> Callable[..., Any]:
            def applied(**given: Any) -> Any:
                given = {k: v[FIRST] if k in QUATERNIONS else v for k, v in given.items()}
                if "s" in given:
                    given["s"] = {**given["s"], "g": given["s"]["g"][FIRST]}
                out = apply(**given)
                return {k: v[LAST] if k in QUATERNIONS else v for k, v in out.items()} if isinstance(out, dict) else out

            return applied

        words = ", ".join(f"{letter} {WORDS[axis]}" for letter, axis in zip("xyz", self.axes, strict=True))
        unit = "SI" if self.length == 1 else f"kg, s, lengths of {self.length:g} m"
        axes = f"Axes: {words}, {'right' if self.handed > 0 else 'left'}-handed.  Units: {unit}."
        return replace(
            body,
            head=[*(line for line in body.head if not line.startswith("Units: ")), f"{axes}  [{self.source}]"],
            state={**body.state, "g": Field(4, "orientation, body to space: unit quaternion (x, y, z, w)")},
            start={**body.start, "g": np.asarray(body.start["g"])[LAST]},
            functions=[replace(each, apply=reordered(each.apply)) for each in body.functions],
        )


CONVENTIONS = {
    "ros": Convention("FLU", "REP 103; geometry_msgs/Quaternion"),
    "unity": Convention("RUF", "Unity ROS-TCP-Connector, ROSGeometry.md"),
    "unreal": Convention("FRU", "MathWorks, Coordinate Systems for Unreal Engine Simulation", 0.01),
    "godot": Convention("RUB", "Godot manual, Model export considerations"),
    "bevy": Convention("RUB", "Bevy, GltfConvertCoordinates"),
    "three": Convention("RUB", "three.js manual, Object3D and Camera"),
}
