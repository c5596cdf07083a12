"""Contents of a file of code: the functions of a plan on recorded numbers, and its constants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.graph.arranging import arranged
from kreisel.graph.graph import Graph, Operand, TooLong
from kreisel.graph.invariants import Program, program_of, program_of_orientation
from kreisel.graph.recording import Outputs, Recording, as_operands, flat_constants, flat_stages, recorded_outputs
from kreisel.kernels.layout import Floats
from kreisel.method import scheme
from kreisel.method.observing import ORIENTATION, turned
from kreisel.method.scheme import Orbits, Scheme, Steps
from kreisel.method.splitting import closed_form
from kreisel.record.calling import call
from kreisel.record.model import Model
from kreisel.runs.plan import Plan

SMALL = 1e-9  # bound on the change by a step and a step back, for a step back to exist
NEGATED = ("mu", "mu_re", "mu_im", "turn0", "turn1", "body0", "body1", "spin0", "spin1")  # of D_(-eps) = D_eps^-1


@dataclass(frozen=True)
class Contents:
    """The parts of a file.

    step, back       recorded; back is None if no step back is known
    constants, stages  of the step, and of the step back
    opened           the method's variables from a user's state
    observed         state, Casimirs and integrals, by name
    names            of the entries of a user's state
    every            steps between two projections, by the programs (of the invariants, of the orientation)
    """

    plan: Plan
    step: Recording
    back: Recording | None
    constants: Floats
    stages: Floats
    constants_back: Floats
    stages_back: Floats
    opened: tuple[Graph, list[Operand]]
    observed: Outputs
    start: Floats
    names: tuple[str, ...]
    programs: tuple[Program, ...]
    every: int


def in_steps(plan: Plan) -> Plan:
    """A plan of closed forms as a plan of steps of the same flow, whose integrals may change from step to step.

    Raises `InputError` if dt is too long for a single step.
    """
    made, model = plan.scheme, plan.model
    closed = closed_form(model.system, model.n) if isinstance(made.motion, Orbits) else None
    if closed is None:
        return plan
    move, count = closed.move, len(model.system.space.letters)

    def step(*z: Array, h: Array, **known: Array) -> tuple[Array, ...]:
        own, g = move(z[:count], z[count:], h, known)
        return (*own, *g)

    reach = closed.reach
    if reach is not None and plan.first.size:
        far = float(np.max(reach(algebra.restore(plan.first, made.kinds, made.n)[:count], plan.dt, made.constants)))
        if not far <= 1:
            raise InputError(
                "code: expected a step within reach of the closed form of a short step, at most some radians, got "
                f"dt = {plan.dt:g}. Usual cause: method='exact', which makes any step elsewhere. Use a smaller dt."
            )
    constants = {**made.constants, "h": np.float64(plan.dt)}
    steps = replace(
        made, motion=Steps(step), constants=constants, axes={**made.axes, "h": 0}, definition_key=None, kernel_key=None
    )
    return replace(plan, scheme=steps)


def contents(plan: Plan) -> Contents:
    """Contents of the file for a plan of one trajectory.  Raises `InputError` if its step is not straight-line."""
    plan = in_steps(plan)
    made = plan.scheme
    if made.corrector is not None:
        raise InputError(
            f"code: expected a method that steps the state itself, got the order {made.options['order']}, whose "
            "corrector comes before the steps and behind them. Use order=(8, 2) or (8, 6, 4)."
        )
    if plan.batched or not isinstance(made.motion, Steps) or plan.large is not None or made.coupling is not None:
        raise InputError(
            f"code: expected one trajectory, a method that makes steps and n <= 10, got {made.name}, n = {plan.model.n}"
            f"{', an ensemble' if plan.batched else ''}. Give method='suris', 'baecklund', 'veselov', 'variational' or "
            "'kahan'."
        )
    step, constants, stages = _recorded(made)
    back, constants_back, stages_back = None, constants, stages
    inverse = step_back(plan)
    if inverse is not None:
        back, constants_back, stages_back = _recorded(inverse)
    programs: tuple[Program, ...] = ()
    projection = plan.engine.projection
    if projection is not None:
        found = [program_of(made, flat_constants(made, 1)[1]), program_of_orientation(made)]
        programs = tuple(program for program in found if program is not None)
    return Contents(
        plan=plan,
        step=step,
        back=back,
        constants=constants,
        stages=stages,
        constants_back=constants_back,
        stages_back=stages_back,
        opened=_opened(made),
        observed=recorded_outputs(made, lambda parts, **known: _flat(plan, parts, known), flat_constants(made, 1)[1]),
        start=np.concatenate([np.ravel(_of_user(plan, name, plan.start[name])) for name in _letters(made)]),
        names=tuple(_names(plan)),
        programs=programs,
        every=0 if projection is None else projection.every,
    )


def _recorded(made: Scheme) -> tuple[Recording, Floats, Floats]:
    constants, columns = flat_constants(made, 1)
    stages, stage_columns = flat_stages(made, 1)
    try:
        record = Recording(made, constants, columns, stage_columns)
    except TooLong:
        raise InputError(
            f"code: expected a step that is a straight line of operations, got {made.name}, n = {made.n}."
        ) from None
    return record, constants[0], stages[0]


def _letters(made: Scheme) -> list[str]:
    return [name for name, outcome in made.outcomes.items() if outcome.kind in ("state", "orientation")]


def _of_user(plan: Plan, name: str, value: Any) -> Any:
    """Independent entries of a component: for skew matrices axial vectors if n = 3, else entries above the diagonal.

    For symmetric matrices the entries on and above the diagonal; all row by row.
    """
    name_of_kind, n = dict(plan.scheme.components).get(name), plan.model.n
    if name_of_kind is None or np.shape(value)[-2:] != (n, n):
        return value
    kind = algebra.KINDS[name_of_kind]
    return kind.shown(n).pack(kind.for_user(value))


def _flat(plan: Plan, parts: tuple[Array, ...], known: Mapping[str, Array]) -> dict[str, Array]:
    """The observed values: the state in the user's form, then Casimirs and integrals."""
    found = {name: np.ravel(_of_user(plan, name, value)) for name, value in plan.variables(parts, **known).items()}
    return {name: found[name] for name in dict.fromkeys([*_letters(plan.scheme), *found])}


def _names(plan: Plan) -> list[str]:
    kinds = dict(plan.scheme.components)
    counts = [(name, algebra.KINDS[kinds[name]].count(plan.model.n)) for name in _letters(plan.scheme)]
    return [f"{name}[{i}]" for name, count in counts for i in range(count)]


def _opened(made: Scheme) -> tuple[Graph, list[Operand]]:
    """The method's variables from a user's state x."""
    graph, kinds, parts, start = Graph(), dict(made.components), [], 0
    for name in _letters(made):
        count = algebra.KINDS[kinds[name]].count(made.n)
        numbers = graph.inputs("x", count, start)
        start += count
        kind = algebra.KINDS[kinds[name]]
        parts.append(kind.from_user(kind.shown(made.n).unpack(numbers, made.n), made.n))
    return arranged(graph, as_operands(list(algebra.flatten(made.reopen(tuple(parts)), made.kinds))))


def step_back(plan: Plan) -> Scheme | None:
    """The inverse of the step, tested at the start; None if it is not known."""
    made, model = plan.scheme, plan.model
    candidates: list[Callable[[], Scheme]] = [
        lambda: _inverse_map(model, made),
        lambda: _negated(made, 1),
        lambda: _negated(made, -1),
        lambda: _backwards(made),
        lambda: scheme(model, made.name, -plan.dt, made.options.get("order"), ORIENTATION in dict(made.components)),
    ]
    z = algebra.restore(plan.first[0], made.kinds, made.n)
    found: list[tuple[float, Scheme]] = []
    for candidate in candidates:
        try:
            back = candidate()
            with np.errstate(all="ignore"):
                again = back.advance(*made.advance(*z))
        except (InputError, TypeError, AttributeError, KeyError, np.linalg.LinAlgError):
            continue
        there = [_apart(a, b) for a, b, kind in zip(z, again, made.kinds, strict=True) if kind != "scalar"]
        found.append((max(there), back))
    near = [(apart, back) for apart, back in found if apart < SMALL * (1 + float(abs(plan.first).max()))]
    return min(near, key=lambda pair: pair[0])[1] if near else None


def _apart(one: Array, two: Array) -> float:
    """The largest difference; q and -q are the same orientation."""
    return float(min(abs(one - two).max(), abs(one + two).max() if one.shape == (4,) else np.inf))


def _inverse_map(model: Model, made: Scheme) -> Scheme:
    """The paper's map backwards, with the orientation."""
    if made.name != "suris":
        raise KeyError(made.name)
    phi, count = model.map, len(model.system.space.letters)

    def step(*z: Array, **known: Array) -> tuple[Array, ...]:
        new, g = z[:count], z[count:]
        old = call(phi.inverse, new, known)
        return (*old, *(turned(model.system.frame, -call(phi.generator, (*old, *new), known), h) for h in g))

    return replace(made, motion=Steps(step))


def _backwards(made: Scheme) -> Scheme:
    """A flow after the time -h."""
    return replace(made, constants={**made.constants, "h": -made.constants["h"]})


def _negated(made: Scheme, sign: int) -> Scheme:
    """Bäcklund transformations at (-mu, `sign` rho) of the spectral curve, and the inverse rotations."""
    if made.name not in ("baecklund", "exact"):
        raise KeyError(made.name)

    def negated(values: Mapping[str, Array]) -> dict[str, Array]:
        signs = {**dict.fromkeys(NEGATED, -1), **dict.fromkeys(("rho", "rho_re", "rho_im"), sign)}
        return {name: signs.get(name, 1) * value for name, value in values.items()}

    return replace(made, constants=negated(made.constants), stages=negated(made.stages))
