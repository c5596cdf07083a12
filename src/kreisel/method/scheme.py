"""What a method hands to the engines: pure functions, and the layout of what they work on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kreisel.algebra import Array

Components = tuple[tuple[str, str], ...]  # (letter, kind): "skew", "vector", "matrix", "quaternion"


@dataclass(frozen=True)
class Outcome:
    """One variable that `observe` returns: its kind and what it means.

    kind: "state", "orientation", "casimir", "integral" or "relation"; `conserved` says of the last three that this
    method keeps them constant up to round-off.
    """

    kind: str
    meaning: str
    axes: str = ""  # the kind of component ("skew", ...) of a state; "" for a scalar or a family
    conserved: bool = False


@dataclass(frozen=True)
class Orbit:
    """One trajectory in closed form: three phases say where it is, 64-bit fractions of a turn.

    phases(M, e)  -> (times, 3) unsigned integers, at times M 2^e: Python integers in an object array, small integers
    rates         of the phases where they grow like the time, turns in a unit of time as integers of `bits` binary
                  places; None otherwise
    place(j)      -> (terms, numbers), for part j of the 2^places parts of the first phase: numbers that are polynomials
                  in x, from -1 at the start of the part to 1 at its end; the lowest power first
    row(place, left, right, **constants) -> z, from these numbers at one x; `left` and `right` are half the turns of the
                  other phases, as (cos, sin, rest of the angle, at most pi/512).  Compiled by an engine.
    """

    phases: Callable[[Array, Array], Array]
    rates: tuple[int, int, int] | None
    bits: int
    places: int
    place: Callable[[int], Array]
    row: Callable[..., tuple[Array, ...]]
    constants: Mapping[str, Array]


States = Callable[[Array, Array], tuple[Array, ...]]  # (M, e) -> z at the times M 2^e: an orbit as a function


@dataclass(frozen=True)
class Jump:
    """A flow as that of a Lagrange top, n = 3, at rest: m' = p x b, b' = m x b, with axial vectors.

    begin(*z, **constants) -> m, b, p, and two alphas: the state turns about p by (1/alpha - 1) (m.p)/|p| in a unit of
                              time beside, the body about b by (1/other - 1) (m.b)/|b|
    orientation(g)         -> q, the turn of the body: q' = m q/2 but for what alpha adds
    finish(m, b, q)        -> z; without q where there is no orientation

    Recorded and compiled by an engine.
    """

    begin: Callable[..., tuple[Array, Array, Array, Any, Any]]
    orientation: Callable[[Array], Array]
    finish: Callable[..., tuple[Array, ...]]


@dataclass(frozen=True)
class Spin:
    """A flow as that of a free body, n = 3: M' = M x Omega, Omega_i = M_i/I_i, g' = g hat(Omega); g may be absent.

    begin(*z)            -> M, an axial vector, and g where there is one, a unit quaternion
    moments(**constants) -> I (3,), recorded for double-doubles
    finish(M, g)         -> z

    Recorded and compiled by an engine.
    """

    begin: Callable[..., tuple[Array, ...]]
    moments: Callable[..., Array]
    finish: Callable[..., tuple[Array, ...]]


@dataclass(frozen=True)
class Guard:
    """A component that must stay at most `limit`; else the run ends with `fault`, its usual `cause` and the fix."""

    component: str
    limit: float
    fault: str
    cause: str


@dataclass(frozen=True)
class Coupling:
    """Lanes that act on each other in pairs: a stage is `drift` of each lane, the sum of `pull` over pairs, `kick`.

    pairs      (count, 2), lanes
    constants  of the pairs (count, ...), and `axes` of each without that of pairs
    forces     the components of what acts on a lane
    pull(*z1, *z2, **known)    -> forces on the first, forces on the second; known: those of the pair, and scalars
    drift(*z, **known)         -> z; None for a flow, to whose `rate` forces add: to its first numbers, in order
    kick(*z, *forces, **known) -> z
    together(outputs, z)       -> outputs of rows (rows, lanes, ...), with what is of all lanes together
    """

    pairs: Array
    constants: Mapping[str, Array]
    axes: Mapping[str, int]
    forces: tuple[str, ...]
    pull: Callable[..., tuple[Array, ...]]
    together: Callable[[Mapping[str, Array], tuple[Array, ...]], dict[str, Array]]
    drift: Callable[..., tuple[Array, ...]] | None = None
    kick: Callable[..., tuple[Array, ...]] | None = None


@dataclass(frozen=True)
class Scheme:
    """A method for one model.

    prepare(x0)            -> z0        once
    step(*z, **constants)  -> z         the map, compiled by an engine; None for a flow
    close(*z, **constants) -> z         ends a step that has stages, once; None for nothing more to do
    trajectory(x0)         -> constants of the trajectory, and those of its stages, beside `constants` and `stages`;
                              their axes stand in `axes`.  `on(x0)` puts them in
    rate(*z, **constants)  -> z'        the right-hand side, for methods of a library; None for a map
    orbit(z0, consts, reach) -> Orbit or States: the states at any |time| <= reach in closed form, for one lane; a map,
                                        which also states its step, has whole times and counts steps
    jump                                the same as the flow of a top or a free body, which an engine knows at any time;
                                        or None
    observe(z, **constants) -> outputs  at saved steps; batch axes (time, lane) in front; also takes `basis`
    conserved(z, **consts) -> outputs   as `observe`, in the form of an engine, of what the form does not keep by itself
    reopen(x)              -> z         from an observed state back to the method's own variables
    held(z)                -> arrays    constant along a trajectory, which bind an orientation to the state; or None
    explain(z, constants)  -> text      why the step from z gave NaN, for implicit maps
    coupling                            what lanes do to each other, in place of `step`; None for lanes on their own

    A method that composes a step of several stages calls `step` once for each, in order: `stages` holds the
    constants that vary with the stage, along an axis of their own.
    """

    name: str
    components: Components
    constants: Mapping[str, Array]  # what step or rate takes by keyword: ([lane,] ...)
    axes: Mapping[str, int]  # of each constant, without the axes of lane and stage
    n: int
    prepare: Callable[[tuple[Array, ...]], tuple[Array, ...]]
    observe: Callable[..., dict[str, Array]]
    outcomes: Mapping[str, Outcome]
    reopen: Callable[[tuple[Array, ...]], tuple[Array, ...]]
    step: Callable[..., tuple[Array, ...]] | None = None
    rate: Callable[..., tuple[Array, ...]] | None = None
    orbit: Callable[[tuple[Array, ...], Mapping[str, Array], float], Orbit | States] | None = None
    jump: Jump | Spin | None = None
    stages: Mapping[str, Array] = field(default_factory=dict)  # constants ([lane,] stage, ...)
    close: Callable[..., tuple[Array, ...]] | None = None
    options: Mapping[str, Any] | None = None
    guard: Guard | None = None
    trajectory: Callable[[tuple[Array, ...]], tuple[Mapping[str, Array], Mapping[str, Array]]] | None = None
    numbers: str = "any"  # as in the record: what step and rate work on
    basis: Mapping[str, Array] = field(default_factory=dict)  # of the trajectory, for `observe` alone
    conserved: Callable[..., dict[str, Array]] | None = None
    explain: Callable[[tuple[Array, ...], Mapping[str, Array]], str] | None = None
    held: Callable[[tuple[Array, ...]], list[Array]] | None = None
    coupling: Coupling | None = None
    step_in_constants: bool = False  # whether dt enters `constants` and `stages` alone, beside what is observed
    key: tuple[Any, ...] | None = None  # schemes with the same one differ in constants of the trajectory alone
    code: tuple[Any, ...] | None = None  # those with the same one in constants alone, so they have the same kernel

    @property
    def stage_count(self) -> int:
        """How often `step` is called in a step of the method."""
        counts = {np.shape(v)[np.ndim(v) - self.axes[k] - 1] for k, v in self.stages.items()}
        if len(counts) > 1:
            raise ValueError(f"all constants of the stages of {self.name} need the same number of stages: {counts}")
        return counts.pop() if counts else 1

    def on(self, x0: tuple[Array, ...]) -> Scheme:
        """The scheme with the constants of the trajectories from x0 and orientations."""
        if self.trajectory is None:
            return self
        constants, stages = self.trajectory(x0)
        return replace(
            self, constants={**self.constants, **constants}, stages={**self.stages, **stages}, trajectory=None
        )

    def advance(self, *z: Array) -> tuple[Array, ...]:
        """A whole step by the definition: every stage once, then `close`.  Engines compile the same."""
        if self.step is None:
            raise TypeError(f"the scheme {self.name} states no step")
        for stage in range(self.stage_count):
            varying = {k: np.take(v, stage, np.ndim(v) - self.axes[k] - 1) for k, v in self.stages.items()}
            z = self.step(*z, **self.constants, **varying)
        return z if self.close is None else self.close(*z, **self.constants)
