"""method="splitting": perturbed bodies, by flows of the integrable part and of the perturbation in turn.

A step is A for a_1 h, B for b_1 h, A for a_2 h, ..., symmetric (`splitting_coefficients`).  A is the integrable motion,
in closed form where it is known as one short step, else by a map of high order; B is the flow of the perturbation with
the state of A standing still (`kreisel.forces.kicks`): the flows of its kinds in symmetric order,

    damping, turns in order | kick | turns backwards, damping,

which is exact for one kind, else off by O(eps^3 h^3); three times in a row it is off by O(eps^5 h^5), where the order
asks for that.

A corrector is a step of the same parts by other numbers, which ends at the time where it began: its inverse prepares
the start, and rows are taken through it when they are observed.

The momentum of a wheel is a coordinate that B moves, with the torque of its motor; in A it stands still.

Time is a coordinate that A moves, so forces that depend on time keep the order and the symmetry; it is (k + c_i) dt
with a count k of whole steps, which is exact.  `work` is what the energy gains by forces without a potential and by
those that depend on time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.forces import kicks
from kreisel.forces.invariants import conserved
from kreisel.forces.kicks import ORIENTATION, Body, perturbation_of
from kreisel.forces.pairs import of_bodies
from kreisel.forces.turns import Turn, turns_of
from kreisel.method.driven import (
    coupling_of,
    outcomes_of_totals,
    outcomes_of_work,
    require_orientation,
    with_work,
    zero,
)
from kreisel.method.integrable import Integrable, integrable
from kreisel.method.observing import COUNT, WORK, Only, as_matrix, observer, with_orientation
from kreisel.method.scheme import (
    COUPLED_N,
    Corrector,
    CoupledSteps,
    Guard,
    Numbers,
    Outcome,
    Scheme,
    Steps,
    too_large_to_couple,
)
from kreisel.method.splitting_coefficients import Splitting as Fractions
from kreisel.method.splitting_coefficients import corrector, inverse, splitting
from kreisel.record.calling import call
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME, pairs_of

FOURTH = (1 / (2 - 2 ** (1 / 3)), 1 - 2 / (2 - 2 ** (1 / 3)), 1 / (2 - 2 ** (1 / 3)))  # Yoshida 1990
REACH = "reach"
TICKS = 1024  # in dt: a constant of 1 has a kernel of its own, and dt = 1 is common

State = tuple[Array, ...]
Constants = Mapping[str, Array]


class Splitting:
    """The step of a perturbed body, and what is observed of it."""

    def __init__(self, model: Model, dt: float, order: Any, oriented: bool, all_turns: bool):
        self.model, self.dt, self.record = model, dt, perturbation_of(model.system)
        self.count = len(model.system.space.letters)
        self.oriented = oriented
        require_orientation(model, oriented)
        self.timed, self.driven = self.record.names(TIME), self.record.driven
        self.fractions = splitting(order)
        self.part: Integrable = integrable(model)
        self.turns = turns_of(model, all_turns)
        _require_a_symmetric_kick(model, order)
        record = self.record
        self.kicked = bool(record.functions) or record.wheel or record.pair is not None or self.part.left is not None
        kinds = len(self.turns) + self.kicked + record.damping
        self.parts = FOURTH if kinds > 1 and isinstance(order, tuple) and order[-1] > 2 else (1.0,)
        # turns change what a pair potential takes, so each part of a kick is a stage, which the sum over pairs divides
        self.divided = self.record.pair is not None and bool(self.turns)

    @property
    def extra(self) -> tuple[str, ...]:
        """The numbers that are carried beside state and orientation."""
        names = {COUNT: self.timed, WORK: self.driven, REACH: self.part.reach is not None}
        return tuple(name for name, there in names.items() if there)

    def apart(self, z: State) -> tuple[State, State, dict[str, Array]]:
        """The state, the orientation if there is one, the other numbers by name."""
        end = self.count + self.oriented
        return z[: self.count], z[self.count : end], dict(zip(self.extra, z[end:], strict=True))

    def step(self, *z: Array, _drift: Array, _kick: Array, _node: Array, **known: Array) -> State:
        """A, then B."""
        return self.kick(*self.drift(*z, _drift=_drift, _kick=_kick, **known), _kick=_kick, _node=_node, **known)

    def drift(self, *z: Array, _drift: Array, **known: Array) -> State:
        """A; and what comes before the kick where the sum over pairs divides B."""
        own, g, more = self.moved(*self.apart(z), _drift, known)
        if self.divided:
            own, g, work = self._before(own, g, known["_kick"], known)
            if self.driven:
                more[WORK] = more[WORK] + work
        return (*own, *g, *more.values())

    def kick(self, *z: Array, _kick: Array, _node: Array, **known: Array) -> State:
        """B, or the rest of it, with what other bodies do to this one behind its state."""
        size = self.count + self.oriented + len(self.extra)
        own, g, more = self.apart(z[:size])
        pulled = (z[size : size + self.count], z[-1] if self.driven else 0) if len(z) > size else None
        body = Body(own, None, self.time(more, _node, known))
        if self.divided:
            own, g, work = self._rest(body, g, _kick, known, pulled)
        else:
            own, g, work = self.perturbed(body, g, _kick, known, pulled)
        if self.driven:
            more[WORK] = more[WORK] + work
        return (*own, *g, *more.values())

    def where(self, z: State, known: Constants) -> Body:
        """The body at a node of the step."""
        own, g, more = self.apart(z)
        return Body(own, self.turn(g), self.time(more, known["_node"], known) if self.timed else None)

    def turn(self, g: State) -> Array | None:
        """The orientation as a matrix."""
        return as_matrix(self.model, g[0]) if g else None

    def time(self, more: Mapping[str, Array], node: Array, known: Constants) -> Any:
        """The time at a node of the step."""
        return (more[COUNT] + node) * (known["_dt"] * TICKS) if self.timed else None

    def close(self, *z: Array, _last: Array, _whole: Array, **known: Array) -> State:
        """The last A, and the count of steps: 1, 0 of a corrector."""
        own, g, more = self.apart(z)
        own, g, more = self.moved(own, g, more, _last, {**known, "_kicked": _whole})
        if self.timed:
            more[COUNT] = more[COUNT] + _whole
        return (*own, *g, *more.values())

    def moved(
        self, own: State, g: State, more: dict[str, Array], h: Array, known: Constants
    ) -> tuple[State, State, dict[str, Array]]:
        """The integrable motion, with the momentum of a wheel as the kicks before it left it."""
        if self.record.wheel:
            known = {**known, kicks.WHEEL: kicks.momentum_of_wheel(known, self.time(more, known["_kicked"], known))}
        if self.part.reach is not None:
            more = {**more, REACH: algebra.maximum(more[REACH], self.part.reach(own, h, known))}
        own, g = self.part.move(own, g, h, known)
        return own, g, more

    def perturbed(
        self, body: Body, g: State, h: Array, known: Constants, pulled: tuple[State, Any] | None
    ) -> tuple[State, State, Any]:
        """The flow of the perturbation, and its work."""
        own, work = body.state, 0.0
        for fraction in self.parts:
            own, g, gained = self._once(body._replace(state=own), g, fraction * h, known, pulled)
            work = work + gained
        return own, g, work

    def _once(
        self, body: Body, g: State, h: Array, known: Constants, pulled: tuple[State, Any] | None
    ) -> tuple[State, State, Any]:
        """The same to order 2."""
        own, g, before = self._before(body.state, g, h, known)
        own, g, work = self._rest(body._replace(state=own), g, h, known, pulled)
        return own, g, before + work

    def _before(self, own: State, g: State, h: Array, known: Constants) -> tuple[State, State, Any]:
        own, work = self._damped(own, h / 2, known)
        own, g = self._turned(own, g, self.turns, h / 2, known)
        return own, g, work

    def _rest(
        self, body: Body, g: State, h: Array, known: Constants, pulled: tuple[State, Any] | None
    ) -> tuple[State, State, Any]:
        own, gained = body.state, 0.0
        if self.kicked:
            there = Body(own, self.turn(g), body.t)
            others = self._others(known, pulled)
            own, gained = kicks.kicked(self.model.system, there, h, known, self.model.axes, others)
        own, g = self._turned(own, g, self.turns[::-1], h / 2, known)
        own, after = self._damped(own, h / 2, known)
        return own, g, gained + after

    def _others(
        self, known: Constants, pulled: tuple[State, Any] | None
    ) -> Callable[[State], tuple[State, Any]] | None:
        """What other bodies do in a kick, and what the integrable part leaves to it."""
        left = self.part.left
        if left is None:
            return None if pulled is None else lambda own: pulled
        rest, power = pulled or ((0.0,) * self.count, 0.0)
        return lambda own: (tuple(x + y for x, y in zip(left(own, known), rest, strict=True)), power)

    def _turned(self, own: State, g: State, turns: list[Turn], h: Array, known: Constants) -> tuple[State, State]:
        for turn in turns:
            own, g = turn(own, g, h, known)
        return own, g

    def _damped(self, own: State, h: Array, known: Constants) -> tuple[State, Any]:
        return kicks.decayed(self.model.system, own, h, known, self.model.axes) if self.record.damping else (own, 0)

    def begin(self, x: State) -> State:
        """The state and the orientation with the other numbers at time 0."""
        return (*x, *(zero(self.model.system, x) for _ in self.extra))


def _require_a_symmetric_kick(model: Model, order: Any) -> None:
    """Raises `InputError` for orders that the kick by a torque of the momentum, of order 4, does not have."""
    if kicks.changes_its_loads(model.system) and order in (6, 8):
        raise InputError(
            f"method='splitting': expected order=4 or a tuple such as (8, 6, 4), since a torque or force of the "
            f"momenta is integrated to order 4, got order={order}. Damping has an exact flow: give it as damping=..."
        )


def make(model: Model, dt: float, order: Any, oriented: bool, all_turns: bool = False) -> Scheme:
    """The splitting with step dt of that order; `all_turns`: those too that have no effect with these parameters.

    Raises `InputError` where a force takes an orientation and none is, and for pairs of large bodies.
    """
    if pairs_of(model) is not None and model.n > COUPLED_N:
        raise too_large_to_couple("splitting", model.n)
    body = Splitting(model, dt, order, oriented, all_turns)
    observe, outcomes = _observer(body, order)
    constants, stages = _numbers(body, body.fractions, 1.0)
    correcting = corrector(order)
    coupling = coupling_of(model, body.where, body.driven, {"_node": np.zeros(()), "_dt": np.array(dt / TICKS)})
    return Scheme(
        name="splitting",
        components=(*with_orientation(model, oriented), *((name, "scalar") for name in body.extra)),
        constants={**of_bodies(model), **constants},
        axes={**model.axes, **dict.fromkeys((*stages, *constants), 0)},
        stages=stages,
        n=model.n,
        prepare=body.begin,
        motion=Steps(body.step, body.close)
        if coupling is None
        else CoupledSteps(body.drift, body.kick, coupling.forces, body.close),
        observe=observe,
        reopen=body.begin,
        outcomes=outcomes,
        options={"order": order},
        dt_in_constants=True,
        guard=None if body.part.reach is None else _guard(body.part),
        coupling=coupling,
        corrector=None
        if correcting is None
        else Corrector(_numbers(body, correcting, 0.0), _numbers(body, inverse(correcting), 0.0)),
    )


def _numbers(body: Splitting, parts: Fractions, whole: float) -> Numbers:
    """The constants of a sequence of these parts that lasts so many steps."""
    (a, b), dt = map(np.array, parts), body.dt
    stages = {"_drift": a[:-1] * dt, "_kick": b * dt, "_node": np.cumsum(a[:-1])}
    if body.record.wheel:
        stages["_kicked"] = np.cumsum(b) - b
    if body.divided:
        first = np.arange(len(body.parts)) == 0
        each = {"_drift": first, "_kick": np.array(body.parts), "_node": np.ones(len(first))}
        stages = {name: np.outer(values, each[name]).ravel() for name, values in stages.items()}
    return Numbers({"_last": np.array(a[-1] * dt), "_whole": np.array(whole), "_dt": np.array(dt / TICKS)}, stages)


def _guard(part: Integrable) -> Guard:
    return Guard(
        REACH,
        1.0,
        f"A part of the step is longer than {part.name} is precise for",
        "a step in which the body turns by more than some radians, or a perturbation that sped the body up. Use a "
        "smaller dt.",
    )


def _observer(body: Splitting, order: Any) -> tuple[Any, dict[str, Outcome]]:
    """The variables of the system, and of driven bodies the work and the balance of the energy."""
    model, record = body.model, body.record
    names = conserved(model)
    bound = " + ".join(
        f"O(eps{'' if k == 1 else f'^{k}'} dt^{p})" for k, p in enumerate(np.atleast_1d(order).tolist(), 1)
    )
    if record.corners is not None and call(record.corners, (), model.constants):
        bound += ", and O(dt^2) where a force has a corner"
    oscillates = f"not conserved: it oscillates by {bound}, without a trend"
    energy = f"Hamiltonian H of the perturbed body, {'which changes by work' if body.driven else oscillates}"
    plain, outcomes = observer(model, None, None, names, {"energy": energy}, body.oriented)
    if body.driven:
        outcomes |= outcomes_of_work(oscillates)
    outcomes |= outcomes_of_totals(model, oscillates)

    def observe(z: State, only: Only = None, /, **constants: Array) -> dict[str, Array]:
        own, g, more = body.apart(z)
        where: dict[str, Any] = {}
        if record.names(TIME):
            where[TIME] = more[COUNT] * body.dt
        if record.names(ORIENTATION):
            where[ORIENTATION] = body.turn(g)
        out = plain((*own, *g), only, **constants, **where)
        return with_work(out, more[WORK]) if body.driven else out

    return observe, outcomes
