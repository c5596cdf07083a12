"""Schemes, which methods hand to the engines: pure functions, and the layout of their arguments.

Their variables are derived from the record: state, orientation, Casimirs, integrals.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.record.calling import call, keywords
from kreisel.record.contract import Frame, Map, Orbit, States
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME

State = tuple[Array, ...]
ORIENTATION = "g"
COUNT, WORK, BALANCE = "_count", "work", "balance"  # of driven bodies; _count: of complete steps
SPINS = ("spin0", "spin1")
KINDS = ("casimir", "integral", "relation")
Points = Callable[..., Array | None]
Components = tuple[tuple[str, str], ...]  # (letter, kind): "skew", "vector", "matrix", "quaternion"


@dataclass(frozen=True)
class Outcome:
    """One variable that `observe` returns: its kind and its meaning.

    kind: "state", "orientation", "casimir", "integral" or "relation"; `conserved` states of the last three that this
    method keeps them constant up to round-off.
    """

    kind: str
    meaning: str
    axes: str = ""  # the kind of component ("skew", ...) of a state; "" for a scalar or a family
    conserved: bool = False


@dataclass(frozen=True)
class Jump:
    """A flow of the form of a Lagrange top, n = 3, at rest: m' = p x b, b' = m x b, with axial vectors.

    begin(*z, **constants) -> m, b, p, and two alphas: the state rotates about p by (1/alpha - 1) (m.p)/|p| in a unit of
                              time as well, the body about b by (1/other - 1) (m.b)/|b|
    orientation(g)         -> q, the rotation of the body: q' = m q/2 but for what alpha adds
    finish(m, b, q)        -> z; without q if there is no orientation

    Recorded and compiled by an engine.
    """

    begin: Callable[..., tuple[Array, Array, Array, Any, Any]]
    orientation: Callable[[Array], Array]
    finish: Callable[..., tuple[Array, ...]]


@dataclass(frozen=True)
class Spin:
    """A flow of the form of a free body, n = 3: M' = M x Omega, Omega_i = M_i/I_i, g' = g hat(Omega); g may be absent.

    begin(*z)            -> M, an axial vector, and g, if it is known, a unit quaternion
    moments(**constants) -> I (3,), recorded for double-doubles
    finish(M, g)         -> z

    Recorded and compiled by an engine.
    """

    begin: Callable[..., tuple[Array, ...]]
    moments: Callable[..., Array]
    finish: Callable[..., tuple[Array, ...]]


@dataclass(frozen=True)
class Guard:
    """The reason why a run ends: its fault, the usual cause and the fix.

    component, limit       a component that is carried along, and its bound; without one the step gives NaN
    instead(z, constants)  the reason why the step from z fails, if more is known of it; or None
    """

    fault: str
    cause: str
    component: str = ""
    limit: float = np.inf
    instead: Callable[[tuple[Array, ...], Mapping[str, Array]], Guard | None] | None = None

    def text(self, z: tuple[Array, ...], constants: Mapping[str, Array]) -> str:
        """The reason why the step from z fails, in words."""
        guard = (self.instead(z, constants) if self.instead is not None else None) or self
        return f"{guard.fault}. Usual cause: {guard.cause}"


COUPLED_N = 10  # up to which steps of lanes in pairs are straight-line code, if they are short enough


def too_large_to_couple(name: str, n: int) -> InputError:
    """The error of a method whose step is not straight-line code."""
    return InputError(
        f"{name}: expected bodies whose step is short enough for straight-line code, such as those with n = 3, to act "
        f"on each other, got n = {n}."
    )


@dataclass(frozen=True)
class Coupling:
    """Lanes that act on each other in pairs: the sum of `pull` over pairs acts on each lane.

    A flow adds it to its rates: to the first values, in order.  `CoupledSteps` hand it to their `kick`.

    pairs      (count, 2), lanes
    constants  of the pairs (count, ...), and `axes` of each without that of pairs
    forces     the kinds of the forces on a lane
    pull(*z1, *z2, **known)  -> forces on the first, forces on the second; known: those of the pair, and scalars
    together(outputs, z)     -> outputs of rows (rows, lanes, ...), with sums over all lanes
    """

    pairs: Array
    constants: Mapping[str, Array]
    axes: Mapping[str, int]
    forces: tuple[str, ...]
    pull: Callable[..., tuple[Array, ...]]
    together: Callable[[Mapping[str, Array], tuple[Array, ...]], dict[str, Array]]


class Numbers(NamedTuple):
    """Other constants of a step and of its stages."""

    constants: Mapping[str, Array]
    stages: Mapping[str, Array]


class Corrector(NamedTuple):
    """C, from the variables of a method to the variables of the body, and its inverse: steps with other values."""

    out: Numbers
    back: Numbers


class Part(NamedTuple):
    """A function that kernels call in order: its name there, and the kinds of its arguments after the state.

    `staged`: whether it is called in every stage, with the constants of the stage.
    """

    name: str
    function: Callable[..., tuple[Array, ...]]
    arguments: tuple[str, ...] = ()
    staged: bool = True

    @property
    def letters(self) -> str:
        """Its constants: c of the scheme, s of the stage."""
        return "cs" if self.staged else "c"


@dataclass(frozen=True)
class Orbits:
    """A flow in closed form, or the iterates of a map.

    orbit(z0, consts, reach) -> the states at any |time| <= reach, for one lane; of a map at integer times, in steps
    jump                     the same of a top or a free body, which an engine knows at any time; or None
    """

    orbit: Callable[[tuple[Array, ...], Mapping[str, Array], float], Orbit | States]
    jump: Jump | Spin | None = None


@dataclass(frozen=True)
class Steps:
    """A map.

    step(*z, **constants)  -> z  every stage once, in order, with the constants of the stage
    close(*z, **constants) -> z  ends a step that has stages, once; None for nothing more to do
    iterates               many steps at once, if they are known
    """

    step: Callable[..., tuple[Array, ...]]
    close: Callable[..., tuple[Array, ...]] | None = None
    iterates: Orbits | None = None


@dataclass(frozen=True)
class JaxSteps:
    """A map of JAX arrays, in one stage."""

    step: Callable[..., tuple[Array, ...]]


@dataclass(frozen=True)
class CoupledSteps:
    """A map of lanes that act on each other: a stage is `drift` of each lane, the sum over pairs, `kick` of each lane.

    drift(*z, **constants)         -> z
    kick(*z, *forces, **constants) -> z  forces on the lane, of these kinds
    close(*z, **constants)         -> z  as that of `Steps`
    """

    drift: Callable[..., tuple[Array, ...]]
    kick: Callable[..., tuple[Array, ...]]
    forces: tuple[str, ...]
    close: Callable[..., tuple[Array, ...]] | None = None


@dataclass(frozen=True)
class Flow:
    """A right-hand side, for integrators of a library: rate(*z, **constants) -> z'."""

    rate: Callable[..., tuple[Array, ...]]


Motion = Steps | CoupledSteps | JaxSteps | Flow | Orbits


@dataclass(frozen=True)
class Scheme:
    """A method for one model: values, functions around its motion, and the motion, which states its kind.

    prepare(x0)             -> z0        once
    observe(z, **constants) -> outputs   at saved steps; batch axes (time, lane) in front; also needs `basis`;
                               names behind z: only these of the variables beyond the state
    reopen(x)               -> z         from an observed state back to the method's own variables
    trajectory(x0)          -> constants of the trajectory and of its stages, in addition to `constants` and `stages`;
                               their axes stand in `axes`.  `on(x0)` puts them in
    point(*z0, mu=...)      -> rho, a constant of the trajectory, which engines compile, if it is `wide` for
                               double-doubles: then it is trajectory(x0, points) with points(x0, mus) -> rho
                               (..., points), or None
    spin(*z0, mu=dt)        -> the constants `SPINS` of the trajectory (2, n, n), compiled too: points(x0, [dt], "spin")
    links(z, stages)        -> the calls of kernels that write the constants of the stages (lanes, stages, ...) of the
                               trajectories from rows z, not finite if there are none; in place of `point`
    inner_angle(model, x0)  -> rad by which the flows that make a step from x0 rotate, the most of all lanes, if a
                               method combines flows that commute with the motion: they may be far faster
    conserved(z, **consts)  -> outputs   as `observe`, in the form of an engine, for quantities that it lets drift
    held(z)                 -> arrays    constant along a trajectory, which bind an orientation to the state; or None
    unlike                               whether a projection changes each component in proportion to its size
    between                              the most steps between two projections; 0: what their cost allows
    coupling                             interactions of the lanes; None for separate lanes
    guard                                why steps may fail; None if nothing is known of it
    corrector                            between `prepare` and the steps, and between these and `observe`; None without
    """

    name: str
    components: Components
    constants: Mapping[str, Array]  # keyword arguments of the motion: ([lane,] ...)
    axes: Mapping[str, int]  # of each constant, without the axes of lane and stage
    n: int
    prepare: Callable[[tuple[Array, ...]], tuple[Array, ...]]
    observe: Callable[..., dict[str, Array]]
    outcomes: Mapping[str, Outcome]
    reopen: Callable[[tuple[Array, ...]], tuple[Array, ...]]
    motion: Motion
    stages: Mapping[str, Array] = field(default_factory=dict)  # constants ([lane,] stage, ...)
    options: Mapping[str, Any] = field(default_factory=dict)
    guard: Guard | None = None
    trajectory: Callable[..., tuple[Mapping[str, Array], Mapping[str, Array]]] | None = None
    point: Callable[..., Array] | None = None
    wide: bool = True
    spin: Callable[..., Array] | None = None
    links: Callable[[Array, Array], list[Any]] | None = None
    inner_angle: Callable[[Model, State], float] | None = None
    recordable: bool = True  # whether motion and `observe` can be recorded, and so compiled
    basis: Mapping[str, Array] = field(default_factory=dict)  # of the trajectory, for `observe` only
    conserved: Callable[..., dict[str, Array]] | None = None
    held: Callable[[tuple[Array, ...]], list[Array]] | None = None
    unlike: bool = False
    between: int = 0
    coupling: Coupling | None = None
    corrector: Corrector | None = None
    dt_in_constants: bool = False  # whether dt enters only `constants`, `stages`, and observed variables
    order_in_motion: Any = None  # all that the motion depends on of the order, if the rest is in `stages`
    # Decisions by parameters on which the code of motion and observed variables depends; None if unknown.
    parameters_in_motion: tuple[Any, ...] | None = ()
    # Compiled code is kept by these; None for code that is not kept.  Schemes with the same
    definition_key: tuple[Any, ...] | None = None  # differ only in constants of the trajectory
    kernel_key: tuple[Any, ...] | None = None  # differ only in constants, dt and stages, and have one kernel
    # Replaces the model, first in these keys, for code whose inputs are the values of all parameters; or None.
    structure: tuple[Any, ...] | None = None
    compiled: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)  # of one lane

    @property
    def kinds(self) -> list[str]:
        """The kinds of the components."""
        return [kind for _, kind in self.components]

    def column_of(self, component: str) -> int:
        """The first coordinate of a component."""
        place = [name for name, _ in self.components].index(component)
        return algebra.coordinate_count(self.kinds[:place], self.n)

    def set_clock(self, z: Array, time: Any, dt: float) -> None:
        """Set the clock of rows z (..., d) to these times, if forces depend on them."""
        for name, _ in self.components:
            if name in (COUNT, TIME):
                z[..., self.column_of(name)] = time / dt if name == COUNT else time

    def guarded(self, z: tuple[Array, ...]) -> Array:
        """Whether states are within the guard; if it carries no component along, all of them are."""
        if self.guard is None or not self.guard.component:
            return np.array(True)
        return z[[name for name, _ in self.components].index(self.guard.component)] <= self.guard.limit

    @property
    def deformed(self) -> list[str]:
        """The integrals that a map conserves instead of integrals of the flow: they depend on the step."""
        return [name for name, outcome in self.outcomes.items() if outcome.conserved and name.endswith("_eps")]

    @property
    def keywords(self) -> dict[str, Array]:
        """All that `observe` needs by keyword."""
        return {**self.constants, **self.basis}

    @property
    def parts(self) -> list[Part]:
        """The functions of the motion that kernels call in order."""
        match self.motion:
            case Steps(step, close):
                parts = [Part("step", step)]
            case JaxSteps(step):
                parts, close = [Part("step", step)], None
            case CoupledSteps(drift, kick, forces, close):
                parts = [Part("drift", drift), Part("kick", kick, forces)]
            case Flow(rate):
                parts, close = [Part("rate", rate)], None
            case Orbits():
                parts, close = [], None
        return parts if close is None else [*parts, Part("close", close, staged=False)]

    @property
    def orbits(self) -> Orbits | None:
        """The states in closed form, of a flow or of the iterates of a map; None if it is not known."""
        if isinstance(self.motion, Orbits):
            return self.motion
        return self.motion.iterates if isinstance(self.motion, Steps) else None

    @property
    def stage_count(self) -> int:
        """How many stages a step of the method has."""
        return self._count(self.stages)

    def _count(self, stages: Mapping[str, Array]) -> int:
        counts = {np.shape(v)[np.ndim(v) - self.axes[k] - 1] for k, v in stages.items()}
        if len(counts) > 1:
            raise ValueError(f"all constants of the stages of {self.name} need the same number of stages: {counts}")
        return counts.pop() if counts else 1

    def on(self, x0: tuple[Array, ...], points: Callable[..., Array | None] | None = None) -> Scheme:
        """The scheme with the constants of the trajectories from x0 and orientations.

        points(scheme, x0, mus): those that an engine compiles; without, by NumPy.
        """
        if self.trajectory is None:
            return self
        compiled = () if points is None or self.point is None else (partial(points, self),)
        constants, stages = self.trajectory(x0, *compiled)
        stages = {**self.stages, **stages}
        # How many stages there are may depend on the state.
        key = self.kernel_key and (*self.kernel_key, self._count(stages))
        return replace(self, constants={**self.constants, **constants}, stages=stages, trajectory=None, kernel_key=key)

    def by(self, numbers: Numbers) -> Scheme:
        """The scheme with other values, without a corrector."""
        constants = {**self.constants, **numbers.constants}
        return replace(self, constants=constants, stages=numbers.stages, corrector=None)

    def of_structure(self, key: tuple[Any, ...] | None) -> tuple[Any, ...] | None:
        """A key of code whose inputs are the constants, from `definition_key` or `kernel_key`."""
        return key if key is None or self.structure is None else (self.structure, *key[1:])

    def advance(self, *z: Array) -> tuple[Array, ...]:
        """A complete step by the definition: every stage once, then `close`.  Engines compile the same."""
        if not isinstance(self.motion, Steps | JaxSteps):
            raise TypeError(f"the scheme {self.name} states no step")
        for stage in range(self.stage_count):
            varying = {k: np.take(v, stage, np.ndim(v) - self.axes[k] - 1) for k, v in self.stages.items()}
            z = self.motion.step(*z, **self.constants, **varying)
        close = self.motion.close if isinstance(self.motion, Steps) else None
        return z if close is None else close(*z, **self.constants)


# -- variables of a run, derived from the record ------------------------------------------------------------

Observed = tuple[Callable[..., dict[str, Array]], dict[str, Outcome]]  # `observe`, and its variables
Only = Collection[str] | None


def orientation_component(n: int) -> tuple[str, str]:
    """The orientation g as a unit quaternion for n = 3, as an orthogonal matrix otherwise."""
    return (ORIENTATION, "quaternion" if n == 3 else "matrix")


def scheme_of(
    name: str, model: Model, motion: Motion, observed: Observed, oriented: bool = False, **fields: Any
) -> Scheme:
    """The scheme of a method that steps the variables of the system; `fields`: those of a `Scheme` that differ."""
    observe, outcomes = observed
    usual: dict[str, Any] = {
        "components": with_orientation(model, oriented),
        "constants": dict(model.constants),
        "axes": model.axes,
        "n": model.n,
        "prepare": tuple,
        "observe": observe,
        "reopen": tuple,
        "outcomes": outcomes,
        "unlike": model.system.space.unlike,
    }
    return Scheme(name, motion=motion, **(usual | fields))


def with_orientation(model: Model, oriented: bool) -> Components:
    """The components of the state, and the orientation."""
    return model.system.space.components + ((orientation_component(model.n),) if oriented else ())


def with_lanes(model: Model, state: State, least: tuple[int, ...] = ()) -> tuple[tuple[int, ...], State]:
    """The batch of a model and a state, of the axes `least` at least, and the components with its axes."""
    axes = [algebra.KINDS[kind].axes for kind in model.system.space.kinds]
    batch = np.broadcast_shapes(least, model.batch, *(z.shape[: z.ndim - k] for z, k in zip(state, axes, strict=True)))
    return batch, tuple(np.broadcast_to(z, batch + z.shape[z.ndim - k :]) for z, k in zip(state, axes, strict=True))


def turned(frame: Frame, X: Array, g: Array) -> Array:
    """The orientation turned by cay(X): from the left in the rest frame, from the right in the moving one."""
    return algebra.turn_left(X, g) if frame is Frame.REST else algebra.turn_right(g, X)


def turned_by_map(
    phi: Map, frame: Frame, old: tuple[Array, ...], new: tuple[Array, ...], constants: Mapping[str, Array], g: Array
) -> Array:
    """The orientation turned along with a step of a map, by its generator."""
    return turned(frame, call(phi.generator, (*old, *new), constants), g)


def turned_by_velocity(model: Model, middle: State, g: Array, eps: Array, constants: Mapping[str, Array]) -> Array:
    """The orientation turned along with a step eps, by the angular velocity at a state in its middle."""
    X = algebra.mat(eps) / 2 * call(model.system.velocity, middle, constants)
    return turned(model.system.frame, X, g)


def as_matrix(model: Model, g: Array) -> Array:
    """The orientation, as `orientation_component` has it, as an orthogonal matrix."""
    return algebra.rotation_matrix(g) if model.n == 3 else g


def functions(
    model: Model,
    eps: float | None = None,
    order: int = 1,
    conserved: Collection[str] = (),
    meanings: Mapping[str, str] | None = None,
) -> dict[str, tuple[Outcome, Callable[..., Array], bool]]:
    """Name -> (outcome, function, whether it needs the variables of the map).

    With `eps`, a step of the map, the integrals that its record names (`Map.conserves`) are conserved; those that need
    `eps` deformed, under names ending in `_eps`, while the undeformed ones change by O(dt^order).
    Without `eps` the names in `conserved` are.  `meanings` replaces the meaning of some names.
    """
    system = model.system
    by_map = eps is not None
    named_by_map = system.map.conserves if by_map and system.map is not None else ()
    out: dict[str, tuple[Outcome, Callable[..., Array], bool]] = {}

    def add(
        name: str, kind: str, meaning: str, function: Any, stays: bool = False, of_map: bool = False, **extra: Any
    ) -> None:
        def value(*state: Array, **constants: Any) -> Array:
            return model.call(function, *state, **extra, **constants)

        out[name] = Outcome(kind, meaning, conserved=stays), value, of_map

    if system.space.casimirs is not None:
        by_this_map = by_map and (system.map is None or system.map.poisson or "casimir" in (named_by_map or ()))
        stays = by_this_map or "casimir" in conserved
        add("casimir", "casimir", f"Casimirs of {system.space.name}", system.space.casimirs, stays)
    named = {"energy": system.energy} if system.energy is not None else {}
    for name, function in {**named, **system.integrals}.items():
        by_this_map = named_by_map is None or name in named_by_map
        meaning = "Hamiltonian H" if name == "energy" else f"{name} of the flow"
        if by_map and "eps" in keywords(function):
            bound = f"O(dt{'' if order == 1 else f'^{order}'})"
            add(name, "integral", f"{meaning}, not conserved by the map: it oscillates by {bound}", function)
            if by_this_map:
                deformed = f"deformed {name}, conserved exactly by the map"
                add(f"{name}_eps", "integral", deformed, function, True, True, eps=eps)
        else:
            stays = by_this_map or name in conserved
            add(name, "integral", (meanings or {}).get(name, meaning), function, stays, True)
    for name, (function, _) in system.invariant.items():
        add(name, "relation", f"{name}: f with f' = k f, so that f = 0 stays; no integral", function)
    return out


def observer(
    model: Model,
    oriented: bool = False,
    eps: float | None = None,
    to_user: Callable[..., State] | None = None,
    conserved: Collection[str] = (),
    meanings: Mapping[str, str] | None = None,
) -> Observed:
    """`observe` and its outcomes, as `functions` has them; `to_user` maps the variables of the map to the user's.

    `observe(z, only)`: if `only` is given, the state and the variables that it names.
    """
    space = model.system.space
    table = functions(model, eps, 1 if to_user is None else 2, conserved, meanings)
    outcomes = {k: Outcome("state", f"{k} ({model.system.frame.value} frame)", kind) for k, kind in space.components}
    carried = "a = g A" if model.system.frame is Frame.REST else "P = g^T p"
    form = "unit quaternion (w, x, y, z), continuous in time" if model.n == 3 else "orthogonal matrix"
    turning = f"orientation g, body to space, {carried}; {form}"
    outcomes |= {name: outcome for name, (outcome, _, _) in table.items()}
    outcomes |= {ORIENTATION: Outcome("orientation", turning, orientation_component(model.n)[1])} if oriented else {}

    def observe(z: tuple[Array, ...], only: Only = None, /, **constants: Array) -> dict[str, Array]:
        state, count = z[: len(space.letters)], len(space.letters)
        batch = np.ndim(state[0]) - algebra.KINDS[space.kinds[0]].axes
        arguments = {k: v for k, v in constants.items() if k in model.constants or k in (ORIENTATION, TIME)}
        user = to_user(*state, **arguments) if to_user is not None else state
        out = dict(zip(space.letters, user, strict=True))
        for name in table if only is None else table.keys() & set(only):
            _, function, takes_own = table[name]
            value = function(*(state if takes_own else user), **arguments)
            if np.ndim(value) == batch + 2:  # a skew block: as an axial vector for n = 3, else by its entries
                value = algebra.axial(value) if value.shape[-1] == 3 else algebra.coordinates(value)
            out[name] = value
        if len(z) > count:
            out[ORIENTATION] = z[count]  # of q and -q a method carries the one that is continuous in time
        return out

    return observe, outcomes


def held_by_orientation(
    model: Model, components: Components, bound: bool = True
) -> Callable[[tuple[Array, ...]], list[Array]] | None:
    """Functions that an orientation g leaves constant: its orthogonality, and carried vectors in the other frame.

    g^T a in the rest frame, g P in the moving frame; g M g^T where nothing is carried but the momentum.  None if the
    method steps other variables than those of the system.  `bound`: whether the method turns g by the rotation of
    the carried vectors; else only its orthogonality stays.
    """
    space = model.system.space
    count, remainder = len(space.letters), model.system.frame is Frame.REST
    if components[:count] != space.components or len(components) == count or components[count][0] != ORIENTATION:
        return None

    def held(z: tuple[Array, ...]) -> list[Array]:
        g = z[count]
        out = [algebra.dot(g, g)] if g.ndim == 1 else [algebra.KINDS["symmetric"].pack(g.mT @ g)]
        if not bound:
            return out
        turn = algebra.rotation_matrix(g) if g.ndim == 1 else g
        turn = turn.mT if remainder else turn
        for i in space.carried or (0,) * (model.system.perturbation is None):
            kind = algebra.KINDS[space.kinds[i]]
            out.append(kind.pack(kind.rotated(turn, z[i])))
        return out

    return held
