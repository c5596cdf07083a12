"""method="splitting": perturbed bodies, by flows of the integrable part and of the perturbation one after the other.

A step is A for a_1 h, B for b_1 h, A for a_2 h, ..., symmetric (`composition`).  A is the integrable motion,
in closed form if it is known as one short step, else by a map of high order; B is the flow of the perturbation with
the state of A standing still (`kreisel.forces.kicks`): the flows of its kinds in symmetric order,

    damping, rotations in order | kick | rotations backwards, damping,

which is exact for one kind, else off by O(eps^3 h^3); three times in a row it is off by O(eps^5 h^5), where the order
asks for that.

A step with a corrector is A for h, B: the last A of a step is merged with the first A of the next.  Half of A and the
corrector, a step of the same parts by other values, move rows to their time when they are observed; their inverse
prepares the start.

The momenta of wheels are coordinates that B moves, with the torques of their motors; in A they are constant.

Time is a coordinate that A moves, so forces that depend on time keep the order and the symmetry; it is (k + c_i) dt
with a count k of complete steps, which is exact.  `work` is the energy gained by forces without a potential and by
those that depend on time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.exact import quadrics, rotor_step, top_step
from kreisel.forces import control, kicks
from kreisel.forces.kicks import Body, inverse_inertia_columns, perturbation_of, require_principal, turns_of
from kreisel.forces.product import Factor, of_bodies
from kreisel.forces.records import conserved
from kreisel.method import driven
from kreisel.method.composition import Splitting as Fractions, corrector, inverse, splitting, symmetric_composition
from kreisel.method.scheme import (
    COUNT,
    COUPLED_N,
    ORIENTATION,
    WORK,
    Corrector,
    CoupledSteps,
    Guard,
    Numbers,
    Observed,
    Only,
    Scheme,
    State,
    Steps,
    as_matrix,
    observer,
    scheme_of,
    too_large_to_couple,
    turned_by_map,
    with_orientation,
)
from kreisel.record.calling import call
from kreisel.record.contract import Frame, Map, System
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME, pairs_of

FOURTH = (1 / (2 - 2 ** (1 / 3)), 1 - 2 / (2 - 2 ** (1 / 3)), 1 / (2 - 2 ** (1 / 3)))  # Yoshida 1990
REACH, STORED = "_reach", "_wheels"
NEAR_SAMPLE = 1e-13  # relative, of the time of a sample, or of the time between two
TICKS = 1024  # in dt: a constant of 1 has a separate kernel, and dt = 1 is common

Constants = Mapping[str, Array]
ORDER = 8  # of a map, composed, if none is asked for


class Splitting:
    """The step of a perturbed body, and its observed variables."""

    def __init__(self, model: Model, dt: float, order: Any, oriented: bool, all_turns: bool):
        self.model, self.dt, self.record = model, dt, perturbation_of(model.system)
        self.count = len(model.system.space.letters)
        self.oriented = oriented
        driven.require_orientation(model, oriented)
        self.timed, self.driven = self.record.names(TIME), self.record.driven
        self.fractions = splitting(order)
        self.closes = self.fractions.a[-1] != 0  # else a step begins and ends behind a kick
        self.start = 0.0 if self.closes else -0.5  # of a step before its time, in steps
        self.integrable: Integrable = integrable(model)
        turns = turns_of(model, all_turns)
        self.turns = [*turns.values()]
        if kicks.changes_its_loads(model.system) and order in (6, 8):
            raise InputError(
                f"method='splitting': expected order=4 or a tuple such as (8, 6, 4), since a torque or force of the "
                f"momenta is integrated to order 4, got order={order}. Damping has an exact flow: give it as "
                "damping=..."
            )
        record = self.record
        self.kicked = bool(record.functions) or record.pair is not None or self.integrable.left is not None
        self.kicked = self.kicked or record.control is not None
        kinds = len(self.turns) + self.kicked + record.rubbed
        self.rubs = bool(record.rubbing) and (all_turns or record.rubs(model.constants))
        self.parts = FOURTH if kinds > 1 and isinstance(order, tuple) and order[-1] > 2 else (1.0,)
        self.with_zeros = all_turns
        self.span = None if all_turns else control.span_of(model)  # derivatives are those of the field
        self.by_parameters = *turns, self.rubs, self.span is None
        self.changed: tuple[int, ...] = ()
        if record.sampled:
            self.changed = control.changed_by_samples(model.system)
            if corrector(order) is not None:
                raise InputError(
                    "order: expected one without a corrector for a body with control, such as (2, 2), 4, (8, 2) or "
                    f"(8, 6, 4), got {order}. Samples change the motion at once."
                )
        # rotations change the arguments of a pair potential, so the sum over pairs divides a kick into stages
        self.divided = self.record.pair is not None and bool(self.turns)

    @property
    def extra(self) -> dict[str, str]:
        """The values that are carried with state and orientation, and their kinds."""
        needs = {COUNT: self.timed, WORK: self.driven, REACH: self.integrable.reach is not None}
        names = {name: "scalar" for name, needed in needs.items() if needed}
        return names if self.span is None else {**names, control.WINDOW: control.WINDOW_KIND}

    def apart(self, z: State) -> tuple[State, State, dict[str, Array]]:
        """The state, the orientation, if any, the other values by name."""
        end = self.count + self.oriented
        return z[: self.count], z[self.count : end], dict(zip(self.extra, z[end:], strict=True))

    def step(self, *z: Array, _drift: Array, _kick: Array, _node: Array, **constants: Array) -> State:
        """A, then B."""
        if self.span is not None:
            state, g, carried = self.apart(z)
            body = self.configured(state, constants)._replace(t=self.time(carried, _node, constants))
            carried[control.WINDOW] = control.renewed_window(carried[control.WINDOW], body)
            z = (*state, *g, *carried.values())
        if self.record.sampled:
            z = self.sampled(z, constants)
        return self.kick(
            *self.drift(*z, _drift=_drift, _kick=_kick, **constants), _kick=_kick, _node=_node, **constants
        )

    def body(self, state: State, g: State, carried: Mapping[str, Array], node: Any, constants: Constants) -> Body:
        """The body at a node of the step."""
        t = self.time(carried, node, constants)
        field = None if self.span is None else control.field_in_window(carried[control.WINDOW], t, constants)
        return self.configured(state, constants)._replace(g=self.turn(g), t=t, field=field)

    def configured(self, state: State, constants: Constants) -> Body:
        """The body with this state."""
        return Body(self.model.system, state, constants, self.model.axes)

    def sampled(self, z: State, constants: Constants) -> State:
        """The variables after a sample, if one is due."""
        (state, g, carried), places = self.apart(z), self.changed
        kinds = [self.model.system.space.kinds[i] for i in places]

        def after() -> Array:
            body = self.body(state, g, carried, 0, constants)
            new, work = control.sampled(body, g[0])
            return algebra.flatten((*(new[i] for i in places), carried[WORK] + work), (*kinds, "scalar"))

        ratio = carried[COUNT] * constants["_sample"]
        apart, near = ratio - algebra.nearest(ratio), constants["_first"] * NEAR_SAMPLE
        due = near * near * (1 + ratio * ratio) - apart * apart
        before = algebra.flatten((*(state[i] for i in places), carried[WORK]), (*kinds, "scalar"))
        if self.with_zeros:  # derivatives are those of choices, not of branches
            flat = algebra.where_less(0, due, after(), before)
        else:
            flat = algebra.if_positive(due, after, before)
        *changed, work = algebra.restore(flat, (*kinds, "scalar"), self.model.n)
        new = dict(enumerate(state)) | dict(zip(places, changed, strict=True))
        return (*new.values(), *g, *(carried | {WORK: work}).values())

    def drift(self, *z: Array, _drift: Array, **constants: Array) -> State:
        """A, and the part of B before the sum over pairs, if there is one."""
        state, g, carried = self.moved(*self.apart(z), _drift, constants)
        if self.divided:
            state, g, work = self._before(state, g, constants["_kick"], constants)
            if self.driven:
                carried[WORK] = carried[WORK] + work
        return (*state, *g, *carried.values())

    def kick(self, *z: Array, _kick: Array, _node: Array, **constants: Array) -> State:
        """B, or the rest of it, with the forces of other bodies on this one behind its state."""
        size = self.count + self.oriented + len(self.extra)
        state, g, carried = self.apart(z[:size])
        pulled = (z[size : size + self.count], z[-1] if self.driven else 0) if len(z) > size else None
        body = self.body(state, (), carried, _node, constants)
        flow = self._remainder if self.divided else self.perturbed
        state, g, work = flow(body, g, _kick, constants, pulled)
        if self.driven:
            carried[WORK] = carried[WORK] + work
        if not self.closes:
            self.count_step(carried, constants)
        return (*state, *g, *carried.values())

    def count_step(self, carried: dict[str, Array], constants: Constants) -> None:
        """Count this step, or none if it is a corrector."""
        if self.timed:
            carried[COUNT] = carried[COUNT] + constants["_whole"]

    def where(self, z: State, constants: Constants) -> Body:
        """The body at a node of the step."""
        state, g, carried = self.apart(z)
        time = self.time(carried, constants["_node"], constants)
        return self.configured(state, constants)._replace(g=self.turn(g), t=time)

    def turn(self, g: State) -> Array | None:
        """The orientation as a matrix."""
        return as_matrix(self.model, g[0]) if g else None

    def time(self, carried: Mapping[str, Array], node: Array, constants: Constants) -> Any:
        """The time at a node of the step."""
        return (carried[COUNT] + node) * (constants["_dt"] * TICKS) if self.timed else None

    def close(self, *z: Array, _last: Array, **constants: Array) -> State:
        """The last A."""
        state, g, carried = self.moved(*self.apart(z), _last, constants)
        self.count_step(carried, constants)
        return (*state, *g, *carried.values())

    def moved(
        self, state: State, g: State, carried: dict[str, Array], h: Array, constants: Constants
    ) -> tuple[State, State, dict[str, Array]]:
        """The integrable motion, with the momenta of wheels as the kicks before it left them."""
        h_of_wheels = kicks.momentum_of_wheels(self.configured(state, constants))
        if h_of_wheels is not None:
            constants = {**constants, STORED: h_of_wheels}
        count = len(self.record.base.space.letters)
        if self.integrable.reach is not None:
            carried = {
                **carried,
                REACH: algebra.maximum(carried[REACH], self.integrable.reach(state[:count], h, constants)),
            }
        moved, g = self.integrable.move(state[:count], g, h, constants)
        return (*moved, *state[count:]), g, carried

    def perturbed(
        self, body: Body, g: State, h: Array, constants: Constants, pulled: tuple[State, Any] | None
    ) -> tuple[State, State, Any]:
        """The flow of the perturbation, and its work."""
        state, work = body.state, 0.0
        for fraction in self.parts:
            state, g, before = self._before(state, g, fraction * h, constants)
            state, g, after = self._remainder(body._replace(state=state), g, fraction * h, constants, pulled)
            work = work + (before + after)
        return state, g, work

    def _before(self, state: State, g: State, h: Array, constants: Constants) -> tuple[State, State, Any]:
        state, work = self._damped(state, h / 2, constants)
        for turn in self.turns:
            state, g = turn(state, g, h / 2, constants)
        return state, g, work

    def _remainder(
        self, body: Body, g: State, h: Array, constants: Constants, pulled: tuple[State, Any] | None
    ) -> tuple[State, State, Any]:
        state, gained = body.state, 0.0
        if self.kicked:
            left, inner = self.integrable.left, len(self.record.base.space.letters)
            rates, power = pulled or ((0.0,) * self.count, 0.0)

            def others(state: State) -> tuple[State, Any]:  # rates that other bodies and the integrable part add
                if left is None:
                    return rates, power
                of_part = (*left(state[:inner], constants), *(0 * z for z in state[inner:]))
                return tuple(x + y for x, y in zip(of_part, rates, strict=True)), power

            oriented, additions = body._replace(g=self.turn(g)), None if left is None and pulled is None else others
            state, gained = kicks.kicked(oriented, h, additions)
        for turn in self.turns[::-1]:
            state, g = turn(state, g, h / 2, constants)
        state, after = self._damped(state, h / 2, constants)
        return state, g, gained + after

    def _damped(self, state: State, h: Array, constants: Constants) -> tuple[State, Any]:
        body = self.configured(state, constants)
        if self.rubs:
            return kicks.rubbed(body, h)
        return kicks.decayed(body, h) if self.record.damping else (state, 0)

    def begin(self, x: State) -> State:
        """The state and the orientation with the other values at time 0."""
        nothing = driven.zero(self.model.system, x)
        empty = algebra.vec(nothing) + np.zeros(control.WINDOW_SIZE)
        return (*x, *(empty if name == control.WINDOW else nothing for name in self.extra))


def make(model: Model, dt: float, order: Any, oriented: bool, all_turns: bool = False) -> Scheme:
    """The splitting with step dt of that order; `all_turns`: those too that have no effect with these parameters.

    Raises `InputError` where a force needs an orientation and none is, and for pairs of large bodies.
    """
    if pairs_of(model) is not None and model.n > COUPLED_N:
        raise too_large_to_couple("splitting", model.n)
    body = Splitting(model, dt, order, oriented, all_turns)
    constants, stages = _numbers(body, body.fractions, body.start, 1.0)
    correcting = corrector(order)
    guard = Guard(
        f"A part of the step is longer than {body.integrable.name} is precise for",
        "a step in which the body rotates by more than some radians, or a perturbation that sped the body up. Use a "
        "smaller dt.",
        REACH,
        1.0,
    )
    close = body.close if body.closes else None
    coupling = driven.coupling_of(model, body.where, body.driven, {"_node": np.zeros(()), "_dt": np.array(dt / TICKS)})
    return scheme_of(
        "splitting",
        model,
        Steps(body.step, close) if coupling is None else CoupledSteps(body.drift, body.kick, coupling.forces, close),
        _observer(body, order),
        components=(*with_orientation(model, oriented), *body.extra.items()),
        constants={**of_bodies(model), **constants},
        axes={**model.axes, **dict.fromkeys((*stages, *constants), 0)},
        stages=stages,
        prepare=body.begin,
        reopen=body.begin,
        options={"order": order},
        dt_in_constants=True,
        order_in_motion=(body.parts, body.closes),
        parameters_in_motion=body.by_parameters,
        guard=guard if body.integrable.reach is not None else None,
        coupling=coupling,
        corrector=None
        if correcting is None
        else Corrector(_numbers(body, correcting, body.start, 0.0), _numbers(body, inverse(correcting), 0.0, 0.0)),
    )


def _numbers(body: Splitting, parts: Fractions, start: float, count: float) -> Numbers:
    """The constants of a sequence of these parts from `start`, in steps, that lasts `count` steps."""
    (a, b), dt = map(np.array, parts), body.dt
    if not body.closes and a[-1]:  # the last A of a corrector is that of a stage, with a kick of 0
        a, b = np.append(a, 0.0), np.append(b, 0.0)
    stages = {"_drift": a[:-1] * dt, "_kick": b * dt, "_node": start + np.cumsum(a[:-1])}
    if body.record.sampled:
        stages["_first"] = np.arange(len(b)) == 0.0
    if body.divided:
        first = np.arange(len(body.parts)) == 0
        repeated = {"_drift": first, "_kick": np.array(body.parts), "_node": np.ones(len(first))}
        stages = {name: np.outer(values, repeated[name]).ravel() for name, values in stages.items()}
    constants = {"_last": np.array(a[-1] * dt), "_whole": np.array(count), "_dt": np.array(dt / TICKS)}
    if body.record.sampled and body.record.control is not None:
        constants["_sample"] = np.array(dt / body.record.control.every)
    if body.span is not None:
        constants[control.SPAN] = np.asarray(body.span)
    return Numbers(constants, stages)


def _observer(body: Splitting, order: Any) -> Observed:
    """The variables of the system, and of driven bodies the work and the balance of the energy."""
    model, record = body.model, body.record
    names = conserved(model)
    bound = " + ".join(
        f"O(eps{'' if k == 1 else f'^{k}'} dt^{p})" for k, p in enumerate(np.atleast_1d(order).tolist(), 1)
    )
    if record.has_corners(model.constants):
        bound += ", and O(dt^2) where a force has a corner"
    if any(force.chooses for force in record.functions.values()):
        bound += ", O(dt) where it jumps"
    oscillates = f"not conserved: it oscillates by {bound}, without a trend"
    energy = f"Hamiltonian H of the perturbed body, {'which changes by work' if body.driven else oscillates}"
    plain, outcomes = observer(model, body.oriented, conserved=names, meanings={"energy": energy})
    if body.driven:
        outcomes |= driven.outcomes_of_work(oscillates)
    outcomes |= driven.outcomes_of_totals(model, oscillates)
    if record.control is not None:
        meanings = {k: words for k, (_, words) in control.components(record.control).items()}
        outcomes |= {name: replace(outcomes[name], meaning=meaning) for name, meaning in meanings.items()}

    def observe(z: State, only: Only = None, /, **constants: Array) -> dict[str, Array]:
        state, g, carried = body.apart(z)
        where: dict[str, Any] = {}
        if record.names(TIME):
            where[TIME] = carried[COUNT] * body.dt
        if record.names(ORIENTATION):
            where[ORIENTATION] = body.turn(g)
        out = plain((*state, *g), only, **constants, **where)
        return driven.with_work(out, carried[WORK]) if body.driven else out

    return observe, outcomes


# -- the integrable part: its flow for a short time, with integrals that change from step to step --------------


@dataclass(frozen=True)
class Integrable:
    """name; move(state, orientation, h, constants) -> both after the time h; reach(state, h, constants): at most 1
    where the step is precise to rounding, None if there is no bound; left(state, constants): the rates of the state
    by the forces left to the kicks, None if there are none.
    """

    name: str
    move: Callable[[State, State, Any, Constants], tuple[State, State]]
    reach: Callable[[State, Any, Constants], Any] | None = None
    left: Callable[[State, Constants], State] | None = None


def integrable(model: Model) -> Integrable:
    """The best motion that is known of the base of a perturbed system.  Raises `InputError` if there is none.

    Where H = T(M) + V has neither a map nor a closed form it is the free body, and V is left to the kicks.
    """
    record = perturbation_of(model.system)
    if record.base.product:
        return _side_by_side(
            [
                (factor, _integrable(factor.system, record.inner, model.n, factor.constants(model.constants)))
                for factor in record.base.product
            ]
        )
    if record.control is not None and record.control.wheels:  # a free body: M + h is the momentum of a gyrostat

        def numbers(constants: Constants) -> Constants:
            w = 1 / _moments(record.base, constants)
            return {"w": w, "b": w * constants[STORED]}

        return _rotor("a gyrostat", quadrics, numbers, STORED)
    return _integrable(record.base, record.inner, model.n, model.constants)


def _integrable(base: System, inner: int | None, n: int, constants: Constants) -> Integrable:
    form = base.closed_form
    if form.step is not None:  # with the attitudes among its components

        def move(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
            return tuple(call(form.step, state, {**constants, "h": h})), g

        def reach(state: State, h: Any, constants: Constants) -> Any:
            return call(form.reach, state, {**constants, "h": h})

        return Integrable("the closed form", move, reach)
    closed = closed_form(base, n) if inner is None else None
    if closed is not None:
        return closed
    if base.map is not None:
        return _composed(base, base.map, inner or ORDER)
    if separable(base, n):
        require_principal(base, constants)
        return _carrying_rotor(base)
    raise InputError(
        f"perturbed: no map and no closed form of {base.name}, n = {n}, is known here. Use method='dop853'."
    )


def _side_by_side(parts: list[tuple[Factor, Integrable]]) -> Integrable:
    """The motion of bodies of different systems, side by side."""

    def move(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        return tuple(z for f, motion in parts for z in motion.move(state[f.place], (), h, f.constants(constants))[0]), g

    def reach(state: State, h: Any, constants: Constants) -> Any:
        result = [
            motion.reach(state[f.place], h, f.constants(constants)) for f, motion in parts if motion.reach is not None
        ]
        return reduce(algebra.maximum, result)

    def left(state: State, constants: Constants) -> State:
        return tuple(
            z
            for f, motion in parts
            for z in (
                motion.left(state[f.place], f.constants(constants)) if motion.left else [0 * x for x in state[f.place]]
            )
        )

    return Integrable(
        " and ".join(dict.fromkeys(motion.name for _, motion in parts)),
        move,
        reach if any(motion.reach for _, motion in parts) else None,
        left if any(motion.left for _, motion in parts) else None,
    )


def closed_form(base: System, n: int) -> Integrable | None:
    """The motion of a free body, a gyrostat or a Lagrange top, n = 3; None if no form for a short step is known."""
    form = base.closed_form
    if n != 3:
        return None
    if form.moments is not None:
        return _rotor("a free body", rotor_step, lambda constants: rotor_step.constants(_moments(base, constants)))
    if form.gyrostat is not None and base.space.kinds == ("skew",):
        return _rotor(
            "a gyrostat",
            quadrics,
            lambda constants: dict(zip("wb", call(form.gyrostat, (), constants), strict=True)),
            0,
        )
    return _top(base) if form.top is not None else None


def _moments(base: System, constants: Constants) -> Array:
    return np.asarray(call(base.closed_form.moments, (), constants))


def _turn_of(M: Array, g: State) -> Array:
    """The orientation, or the quaternion 1 without one."""
    return g[0] if g else np.concatenate([1 + 0 * M[..., :1], 0 * M], -1)


def _rotor(body: str, form: Any, numbers: Callable[[Constants], Constants], beside: Any = None) -> Integrable:
    """The momentum by `form.step` and `form.reach`, with their constants by `numbers`.

    beside  0, or the name of a constant: a momentum that is added to M meanwhile
    """

    def added(constants: Constants) -> Any:
        return constants[beside] if beside else 0

    def momentum(state: State, constants: Constants) -> Array:
        M = algebra.axial(state[0])
        return M if beside is None else M + added(constants)

    def move(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        M = momentum(state, constants)
        N, q = form.step(M, _turn_of(M, g), h=h, **numbers(constants))
        return (algebra.hat(N if beside is None else N - added(constants)),), (q,) * len(g)

    def reach(state: State, h: Any, constants: Constants) -> Any:
        return form.reach(momentum(state, constants), h, **numbers(constants))

    return Integrable(f"the closed form of {body}", move, reach)


def _top(base: System) -> Integrable:
    """In the rest frame (m, a, p), in the moving frame (M, A, P) of the record."""
    remainder, unequal = base.frame is Frame.REST, any(p.letter == "alpha" for p in base.parameters)

    def of(state: State, constants: Constants) -> tuple[Array, Array, Array, Array]:
        m, a, p = call(base.closed_form.top, state, constants)
        return algebra.axial(m), a, p, constants["alpha"] if unequal else 1.0

    def move(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        m, a, p, alpha = of(state, constants)
        if remainder:
            m, b, *turned = top_step.step(m, a, *g, p=p, alpha=alpha, h=h)
        else:
            m, b, *turned = top_step.step_inside(m, p, *g, A=a, alpha=alpha, h=h)
        return (algebra.hat(m), b), tuple(turned)

    def reach(state: State, h: Any, constants: Constants) -> Any:
        m, a, p, alpha = of(state, constants)
        return top_step.reach(m, a, p=p, alpha=alpha, h=h)

    return Integrable("the closed form of a Lagrange top", move, reach)


def separable(base: System, n: int) -> bool:
    """Whether H = T(M) + V(vectors), of a body in its frame with n = 3: rotations of a free body, and kicks."""
    turning = base.frame is Frame.MOVING and base.inverse_inertia is not None and base.spin is None
    return n == 3 and turning and set(base.space.kinds) == {"skew", "vector"}


def _carrying_rotor(base: System) -> Integrable:
    """The free body with the vectors that it carries, in closed form; V(vectors) is left to the kicks."""

    def rates(state: State, constants: Constants) -> Constants:
        columns = inverse_inertia_columns(base, constants, state[1])
        return rotor_step.constants(1 / np.stack([column[..., i] for i, column in enumerate(columns)], -1))

    def move(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        M = algebra.axial(state[0])
        N, q = rotor_step.step(M, _turn_of(M, ()), h=h, **rates(state, constants))
        W = algebra.rotation_matrix(q)
        carried = (algebra.act(W.mT, v) for v in state[1:])
        return (algebra.hat(N), *carried), tuple(algebra.quaternion_product(x, q) for x in g)

    def reach(state: State, h: Any, constants: Constants) -> Any:
        return rotor_step.reach(algebra.axial(state[0]), h, **rates(state, constants))

    def left(state: State, constants: Constants) -> State:
        return tuple(call(base.flow, (0 * state[0], *state[1:]), constants))

    return Integrable("the closed form of a free body", move, reach, left)


def _composed(base: System, phi: Map, order: int) -> Integrable:
    """The map of the system, made symmetric, in a composition of that order."""
    fractions = symmetric_composition(order)

    def move(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        for fraction in fractions:
            arguments = {**constants, "eps": float(fraction) * h}
            old = state if phi.symmetric else call(phi.from_symmetric, state, arguments)
            new = call(phi.step, old, arguments)
            g = tuple(turned_by_map(phi, base.frame, old, new, arguments, h) for h in g)
            state = new if phi.symmetric else call(phi.to_symmetric, new, arguments)
        return tuple(state), g

    return Integrable("its map", move)
