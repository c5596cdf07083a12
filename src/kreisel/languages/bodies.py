"""The free body in closed form as the functions of a file: moments, dt, state are arguments; conventions of engines.

The equations of a rotating body have the same components in a left-handed frame, if angular velocity, momentum, torque
and quaternion follow its left-hand rule; so a step is the same in every engine, and only data are converted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import SECOND, THIRD, Array
from kreisel.algebra.iteration import times
from kreisel.exact import rotor_step
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.graph import where_less
from kreisel.languages.writer import CHANGED, HUGE, NEW, READ, Body, Field, Function, Values

NEAR, TINY = 1e-6, 1e-36  # of `rotor_step`, for 32 bits
HELD = {"was": Field(3, "written by step and hold"), "kept": Field(4, "written by step and hold")}
Step = Callable[[Values, Values], dict[str, Any]]
SWEEPS = 6  # of Jacobi: the last does not change a double
CLOSE = 1 + 1e-6  # I_i <= I_j + I_k, up to the rounding of measured moments
MOMENTS = "principal moments of inertia"
MESSAGES = (
    "moments of inertia are positive and finite, and none is larger than the sum of the two others",
    "the time step dt is finite and not 0",
)
WORDS = {"F": "forward", "B": "back", "L": "left", "R": "right", "U": "up", "D": "down"}
HEAD = """The free rigid body in closed form: no time step is too long for its energy, momentum and flips.
prepare: constants from the principal moments of inertia I and the time step dt, after `check` has returned 0.
step: momentum M along the principal axes (M_i = I_i w_i) and orientation g after the time dt; -dt steps back.
You may change M, g and the constants between steps, and M by `kick` with the impulse of a torque K in space.
A step is accurate to rounding if `reach` is at most 1, {reach} radians at the most; else step n times with dt/n.
hold: energy and |M|, which rounding changes by 1e-17 of them a step, as they were after your last change of M.{hold}
principal: moments I and principal axes of an inertia tensor T = (xx, yy, zz, yz, zx, xy) in other axes of the body.
set_motion, get_motion: orientation q of those axes and angular velocity w in space, from and to the state."""


def held(
    M: Array, inverse: Array, first: Any, kept: Sequence[Any], *, near: float, tiny: float
) -> tuple[Array, list[Any]]:
    """M with |M|^2 and M . I^-1 M moved to their kept values, and these: two numbers each, a sum.

    If `first` is negative, they are taken from M.  The corrections are in double-doubles.
    """
    squares = [DoubleDouble(x) * x for x in M]
    now = [squares[0] + squares[1] + squares[2], sum((x * v for x, v in zip(squares, inverse, strict=True)), 0.0)]
    before = [
        DoubleDouble.where_less(first, 0.0, value, DoubleDouble(*pair))
        for value, pair in zip(now, (kept[:2], kept[2:]), strict=True)
    ]
    square, energy = (upper(old - new) for old, new in zip(before, now, strict=True))
    share = 1 / (upper(before[0]) + tiny)
    power = algebra.dot(M, inverse * M)
    M = rotor_step.corrected(M, share, power, square, energy - power * share * square, inverse, near=near, tiny=tiny)
    return M, [x for pair in before for x in (pair.upper, pair.lower)]


def principal_axes(T: Sequence[Any], tiny: float = rotor_step.TINY) -> dict[str, Array]:
    """Moments I (3,) and axes, a unit quaternion (4,), of a tensor (xx, yy, zz, yz, zx, xy); nearest to its own axes.

    Jacobi's rotations in a fixed number, on scalars of any kind.  The rotation about axis r by phi, tan phi = t, is the
    quaternion (1 + cos phi, -sin phi e_r) of any length; `tiny` keeps 0/0 away.
    """

    def swept(x: list[Any]) -> list[Any]:
        d, o, q = x[:3], x[3:6], algebra.objects(x[6:])
        for r, p, s in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            gap = d[s] - d[p]
            size = abs(gap) + (gap * gap + 4 * o[r] * o[r] + tiny).sqrt()
            t = where_less(gap, 0.0, -2.0, 2.0) * o[r] / size
            cos = 1 / (1 + t * t).sqrt()
            sin = t * cos
            d[p], d[s] = d[p] - t * o[r], d[s] + t * o[r]
            o[r], o[s], o[p] = 0.0 * o[r], cos * o[s] - sin * o[p], sin * o[s] + cos * o[p]
            turn = [1 + cos, *(-sin if k == r else 0.0 for k in range(3))]
            q = algebra.quaternion_product(q, algebra.objects(turn)) * 0.5
        return [*d, *o, *q]

    x = times(swept, [*T, 1.0, 0.0, 0.0, 0.0], SWEEPS)
    return {"I": algebra.objects(x[:3]), "axes": algebra.unit(algebra.objects(x[6:]))}


def check(dt: Any, pairs: Iterable[tuple[Any, Any]], huge: float) -> Any:
    """The status: 2 unless dt is allowed, 1 unless each pair ascends, else 0; NaN fails each comparison."""
    status = where_less(0.0, dt * dt, where_less(dt * dt, huge, 0.0, 2.0), 2.0)
    for low, high in pairs:
        status = where_less(low, high, status, 1.0)
    return status


def check_moments(I: Array, dt: Any, most: float = CLOSE, huge: float = HUGE[False]) -> Any:  # noqa: E741
    """The status of moments: 0 < I_i < most (I_j + I_k), and finite."""
    sums = most * (I[SECOND] + I[THIRD])
    return check(dt, [*zip(I, sums, strict=True), *((0.0, x) for x in I), *((x, huge) for x in I)], huge)


def hold(c: Values, s: Values, near: float = rotor_step.NEAR, tiny: float = rotor_step.TINY) -> dict[str, Any]:
    """M with both integrals of the first step since M was changed from outside; was: the M of the last step."""
    inverse = c["inverse"] if "inverse" in c else c["c"][[5, 2, 1]]
    M, kept = held(s["M"], inverse, _noted(s), s["kept"], near=near, tiny=tiny)
    return {"s.M": M, "s.was": M, "s.kept": kept}


def _noted(s: Values) -> Any:
    """The first number kept, or -1 if M was changed since the last step."""
    return where_less(0.0, algebra.dot(abs(s["M"] - s["was"]), np.ones(3)), -1.0, s["kept"][0])


def watched(step: Step, single: bool, c: Values, s: Values) -> dict[str, Any]:
    """A step that notes changes of M for `hold`, and in numbers of 32 bits holds the integrals itself."""
    new = {**step(c, s), "s.kept": [_noted(s), *s["kept"][1:]]}
    new["s.was"] = new["s.M"]
    return new | hold(c, {name[2:]: v for name, v in new.items()}, NEAR, TINY) if single else new


def _step(c: Values, s: Values, **options: Any) -> dict[str, Any]:
    M, g = rotor_step.step(s["M"], s["g"], **c, **options)
    return {"s.M": M, "s.g": g}


def set_motion(c: Values, s: Values, axes: Array, q: Array, w: Array) -> dict[str, Any]:
    """The state from the orientation of other axes of the body and the angular velocity in space."""
    g = algebra.quaternion_product(q, axes)
    M = algebra.conjugated(algebra.inverse_turn(g), w) / c["inverse"]
    return {"s.M": M, "s.g": g, **{f"s.{name}": [0.0] * f.count for name, f in HELD.items()}}


def get_motion(c: Values, s: Values, axes: Array) -> dict[str, Any]:
    """Orientation of those axes, and angular velocity in space."""
    q = algebra.quaternion_product(s["g"], algebra.inverse_turn(axes))
    return {"q": q, "w": algebra.conjugated(s["g"], c["inverse"] * s["M"])}


def free_body(moments: Any, dt: float, M: Any, g: Any, units: str, single: bool = False) -> Body:
    """The contents of its file, with these default values; `units`: "" for any consistent ones."""
    four = ("array", 4)
    few: dict[str, Any] = {"nodes": 6, "orders": 6, "tiny": TINY, "restore": False} if single else {}
    principal = partial(principal_axes, tiny=TINY if single else rotor_step.TINY)
    arguments = {"I": ("array", 3), "dt": ("number", 0)}
    head = HEAD.format(reach=rotor_step.MOST_TURN, hold="  In numbers of 32 bits step does it." if single else "")
    return Body(
        head=[*head.splitlines(), f"Units: {units or 'any consistent ones'}."],
        parameters={"I": Field(3, MOMENTS, np.asarray(moments)), "dt": Field(0, "time step", dt)},
        constants={"inverse": Field(3), "rates": Field(3), "curvatures": Field(3), "h": Field(0)},
        state={
            "M": Field(3, "angular momentum along the principal axes"),
            "g": Field(4, "orientation, body to space: unit quaternion (w, x, y, z)"),
            **HELD,
        },
        start={"M": np.asarray(M), "g": np.array([1.0, 0, 0, 0]) if g is None else np.asarray(g)},
        functions=[
            Function("check", partial(check_moments, huge=HUGE[single]), arguments, "status"),
            Function(
                "prepare",
                lambda dt, **of: {f"c.{k}": v for k, v in (rotor_step.constants(**of) | {"h": dt}).items()},
                {**NEW, **arguments},
            ),
            Function("step", partial(watched, partial(_step, **few), single), CHANGED),
            *([] if single else [Function("hold", hold, CHANGED)]),
            Function("reach", lambda c, s: rotor_step.reach(s["M"], **c), READ, "number"),
            Function("energy", lambda c, s: algebra.dot(s["M"], c["inverse"] * s["M"]) / 2, READ, "number"),
            Function(
                "kick",
                lambda s, K: {"s.M": s["M"] + algebra.conjugated(algebra.inverse_turn(s["g"]), K)},
                {"s": CHANGED["s"], "K": ("array", 3)},
            ),
            Function("principal", principal, {"T": ("array", 6), "I": ("out", 3), "axes": ("out", 4)}),
            Function("set_motion", set_motion, {**CHANGED, "axes": four, "q": four, "w": ("array", 3)}),
            Function("get_motion", get_motion, {**READ, "axes": four, "q": ("out", 4), "w": ("out", 3)}),
        ],
        messages=MESSAGES,
    )


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
        words = ", ".join(f"{letter} {WORDS[axis]}" for letter, axis in zip("xyz", self.axes, strict=True))
        unit = "SI" if self.length == 1 else f"kg, s, lengths of {self.length:g} m"
        axes = f"Axes: {words}, {'right' if self.handed > 0 else 'left'}-handed.  Units: {unit}."
        return replace(
            body,
            head=[*(line for line in body.head if not line.startswith("Units: ")), f"{axes}  [{self.source}]"],
            state={**body.state, "g": Field(4, "orientation, body to space: unit quaternion (x, y, z, w)")},
            start={**body.start, "g": np.roll(body.start["g"], -1)},
            last=("s.g", "q", "axes"),
        )


CONVENTIONS = {
    "ros": Convention("FLU", "REP 103; geometry_msgs/Quaternion"),
    "unity": Convention("RUF", "Unity ROS-TCP-Connector, ROSGeometry.md"),
    "unreal": Convention("FRU", "MathWorks, Coordinate Systems for Unreal Engine Simulation", 0.01),
    "godot": Convention("RUB", "Godot manual, Model export considerations"),
    "bevy": Convention("RUB", "Bevy, GltfConvertCoordinates"),
    "three": Convention("RUB", "three.js manual, Object3D and Camera"),
}
