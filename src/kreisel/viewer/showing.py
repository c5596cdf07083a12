"""What a page shows of a trajectory: body, tip of the axis, turns.  Decided by the record and the phase space.

| run                                          | shown                                                             |
|----------------------------------------------|-------------------------------------------------------------------|
| n = 3, a body, with its orientation          | the body in space, the trace of its axis                          |
| the same, of a body that moves through space | the body on its path, not to scale                                |
| n = 3, rest frame, without                   | the body along its axis; its own turn about the axis is not known |
| n = 3, moving frame, without                 | the carried vector as the body sees it                            |
| n = 3, position and momentum                 | the particle                                                      |
| n > 3, or other components                   | the vector in three coordinates, to be chosen                     |
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.method.observing import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.runs.geometry import attitude_of, axes_of_state, fixed_vector, to_third_axis
from kreisel.runs.run_record import RunRecord
from kreisel.viewer import bodies
from kreisel.viewer.bodies import Body

if TYPE_CHECKING:
    import xarray as xr

MOST_PLACED = 20_000  # rows of which the path is computed
ON_ITS_PATH = 0.16  # half the length of a body, to the largest distance
SPIN = "The run carries no orientation: give kr.simulate orientation=(1, 0, 0, 0) to see the body spin."
SATELLITES = ("satellite", "satellite-with-wheel")


class Shown:
    """Tip, turns, body and arrow of one trajectory, in the coordinates of the picture: the vertical points up.

    turn     unit quaternions (frame, 4) of the picture, or (1, 4) where the body stands still; None without a body
    axis     the tip of an axis fixed in the body, where the tip is its place; None where `tip` is another vector
    up       what the vertical is: "gravity", "momentum" or ""
    """

    def __init__(self, run: xr.Dataset, record: RunRecord, model: Model | None, joined: bool, body: Any = None):
        self.run, self.record, self.model, self.joined, self._wanted = run, record, model, joined, body
        self.letter, self.kinds = record.carried, record.kinds
        self.space = run.attrs.get("frame") == Frame.REST.value
        self.carried = np.asarray(run[self.letter].values, dtype=np.float64).reshape(run.sizes["time"], -1)
        self.axes = axes_of_state(run)  # everything here is along the axes of the body that were given
        if not self.space and self.carried.shape[1] == 3:
            self.carried = self.carried @ self.axes.T
        self.turn: Array | None = None
        self.axis: Array | None = None
        self.body: Body | None = None
        self.nose: Array | None = None
        self.frame: Array | None = None
        self.up, self.callout = "", ""
        self.legend: dict[str, str] = {}
        self.coordinates = [0, 1, 2]
        self._choose()
        self.radius = float(np.linalg.norm(self.tip, axis=-1).max(initial=0.0)) or 1.0

    def _choose(self) -> None:
        plain = self.carried.shape[1] == 3 and self.record.n == 3
        if plain and "skew" not in self.kinds.values():
            self._particle()
        elif plain and ORIENTATION in self.run:
            x = self._path()
            self._in_space() if x is None else self._on_its_path(x)
        elif plain and self.space:
            self._along_the_axis()
        elif plain:
            self._from_the_body()
        else:
            self._projected()

    def _fixed(self, where: str) -> Array | None:
        """A parameter fixed in space or body, unless it is 0."""
        v = None if self.model is None else fixed_vector(self.model, where)
        if v is None or not v.any():
            return None
        return v @ self.axes.T if where == "body" and len(v) == 3 else v

    def _inertia(self) -> Array | None:
        """The gyration tensor along the axes of the body that were given."""
        if self.model is None or self.space:
            return None
        tensor = bodies.gyration(self.model, self.carried[0] @ self.axes)
        return None if tensor is None else self.axes @ tensor @ self.axes.T

    def _made(self, usual: str, axis: Array, tensor: Array | None, size: float) -> Body:
        """The body that was asked for, or the usual one."""
        if isinstance(self._wanted, Body):
            return self._wanted.scaled(size)
        return bodies.body(self._wanted or usual, axis, tensor, size)

    def _particle(self) -> None:
        self.kind, self.tip = "particle", self.carried
        self.note = "The particle on its sphere."
        self.legend = {"tip": self.letter}
        self.frame = np.eye(3)

    def _path(self) -> Array | None:
        """Where the body is, if it moves through space and its rows follow each other closely enough."""
        from kreisel.analysis.moving import path

        known = self.model is not None and self.model.system.translation is not None
        if not known or self.run.sizes["time"] > MOST_PLACED or not self.joined:
            return None
        try:
            return np.asarray(path(self.run).values)
        except InputError:
            return None

    def _on_its_path(self, x: Array) -> None:
        assert self.model is not None
        q = attitude_of(self.run)
        free = self.model.system.perturbation is None
        up = algebra.rotation_matrix(q[0]) @ self.carried[0]  # the momentum
        S = to_third_axis(up / np.linalg.norm(up)) if free and up.any() else np.eye(3)
        x = x @ S.T
        self.tip = x - (x.max(0) + x.min(0)) / 2
        size = ON_ITS_PATH * (float(np.linalg.norm(self.tip, axis=-1).max()) or 1.0)
        tensor = self._inertia()
        axis = bodies.longest(tensor)
        self.body = self._made("ellipsoid", axis, tensor, size)
        self.kind, self.nose, self.frame = "path", 1.4 * size * axis, S
        self.turn = algebra.quaternion_product(algebra.unit_quaternion(S), q)
        self.legend["tip"] = "long axis of the ellipsoid of inertia"
        self.note = "The body on its path, larger or smaller than it is; "
        self.note += "its momentum points up." if free else "against the fluid, with the third axis of space up."

    def _in_space(self) -> None:
        q = attitude_of(self.run)
        g = algebra.rotation_matrix(q[0])
        self.kind = "body"
        orbits = self.record.system in SATELLITES
        if self.space:
            up, axis = self._fixed("space"), g.T @ self.carried[0]
        else:
            up, axis = None if orbits else g @ self.carried[0], self._fixed("body")
        inertia = self._inertia()
        size = float(np.linalg.norm(self.carried[0]) if self.space else 1.0) or 1.0
        if axis is None or not axis.any():
            axis = 0.98 * size * bodies.longest(inertia)
            self.body = self._made("satellite" if orbits else "ellipsoid", axis, inertia, 0.9 * size)
            self.legend["tip"] = "long axis of the body" if orbits else "long axis of the ellipsoid of inertia"
            what = "The satellite" if orbits else "The body's ellipsoid of inertia"
            self.note = f"{what}, turning about its centre, and the trace of its long axis."
        else:
            axis = size * axis / np.linalg.norm(axis)
            self.body = self._made("top", axis, inertia, 0.94 * size)
            self.legend["tip"] = f"axis, along {self.letter}" if self.space else "axis of the body, in space"
            self.note = "The body turning about its point, and the trace of its axis."
        upright = not orbits and (self.space or self._fixed("body") is not None)
        S = self._point_up(up, "gravity" if upright else "momentum", self.letter)
        self.axis, self.tip = axis, algebra.rotation_matrix(q) @ axis @ S.T
        self.turn = algebra.quaternion_product(algebra.unit_quaternion(S), q)

    def _along_the_axis(self) -> None:
        size = float(np.linalg.norm(self.carried[0])) or 1.0
        S = self._point_up(self._fixed("space"), "gravity", self.letter)
        self.kind, self.tip = "body", self.carried @ S.T
        self.legend["tip"] = f"axis, along {self.letter}"
        self.axis = np.array([0.0, 0.0, size])
        self.body = self._made("top", self.axis, None, 0.94 * size).plain()
        x, y, z = (self.tip / size).T  # the least turn from (0, 0, 1): axis (-y, x, 0), w^2 = (1 + z)/2
        q = np.stack([1 + z, -y, x, 0 * z], -1)
        q[(1 + z) < 1e-12] = (0.0, 1.0, 0.0, 0.0)
        self.turn = q / np.linalg.norm(q, axis=-1, keepdims=True)
        self.note = "The body along its axis; its turn about the axis is not shown."
        self.callout = SPIN

    def _from_the_body(self) -> None:
        self.kind, self.tip = "seen", self.carried
        axis, size = self._fixed("body"), float(np.linalg.norm(self.carried[0])) or 1.0
        inertia = self._inertia()
        if axis is None:
            self.body, S = self._made("ellipsoid", bodies.longest(inertia), inertia, 0.8 * size), np.eye(3)
        else:
            S = to_third_axis(axis / np.linalg.norm(axis))
            self.body = self._made("top", axis, inertia, 0.8 * size)
        self.tip = self.carried @ S.T
        self.turn = algebra.unit_quaternion(S)[None]
        self.legend["tip"] = f"{self.letter}, seen from the body"
        self.note = f"{self.letter} as the body sees it; the body stands still here."
        self.callout = SPIN

    def _projected(self) -> None:
        self.kind, self.tip = "projection", self.carried
        up = self._fixed("space") if self.space else self._fixed("body")
        n = self.tip.shape[1]
        if n < 3:
            self.tip = np.concatenate([self.tip, np.zeros((len(self.tip), 3 - n))], 1)
        elif up is not None and len(up) == n:
            third = int(np.abs(up).argmax())
            self.coordinates = [*[i for i in range(n) if i != third][:2], third]
        self.legend["tip"] = self.letter
        self.note = f"{self.letter} in three of its {n} coordinates, which can be chosen."

    def _point_up(self, up: Array | None, meaning: str, letter: str) -> Array:
        S = np.eye(3) if up is None or not up.any() else to_third_axis(up / np.linalg.norm(up))
        self.frame = S
        if up is not None and up.any():
            self.up = meaning
            self.legend["arrow"] = "gravity" if meaning == "gravity" else f"{letter} in space, at rest"
        return S
