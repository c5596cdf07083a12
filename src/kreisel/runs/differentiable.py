"""kr.differentiable: a motion as a function of JAX, with derivatives by the state, the parameters and the step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, hint, shown
from kreisel.kernels import layout
from kreisel.method import find, scheme
from kreisel.method.baecklund import SPINS, Product
from kreisel.method.driven import zero
from kreisel.method.integrable import closed_form
from kreisel.method.scheme import Guard, JaxSteps, Scheme, Steps
from kreisel.method.splitting import REACH
from kreisel.record.calling import call
from kreisel.record.model import Model
from kreisel.runs.settings import MOST_STEPS, check_model, named, whole_order, within

SPIN = "spin"
MOST_N = 10  # beyond, a step has too many numbers for straight-line code
Known = dict[str, Any]
State = tuple[Array, ...]


class Step(NamedTuple):
    """A step, and what JAX must know of it.

    kinds            of the components of z
    begin, end       the method's own variables from the state and back: (*state, **constants) -> state
    take             (*z, **constants) -> z, once for each stage; close(*z, **constants) after them, or None
    constants(own, known, dt)  -> those of the trajectory, and of the stages (stage, ...)
    guard            what z must not exceed
    arrays           whether it takes arrays of JAX, not numbers
    """

    kinds: list[str]
    begin: Callable[..., State]
    end: Callable[..., State]
    take: Callable[..., State]
    close: Callable[..., State] | None
    constants: Callable[[State, Known, Any], tuple[Known, Known]]
    guard: Guard | None
    arrays: bool = False


@explained
def differentiable(
    system: Model, *, method: str | None = None, order: int | tuple[int, ...] | None = None
) -> Callable[..., dict[str, Array]]:
    """The motion as a function of JAX: f(state, dt=, steps=, every=None, **parameters) -> state.

    state       mapping of the components: m (3,), an axial vector, for n = 3, else (n, n) skew; a (n,); `x0.axial` of a
                state is one
    dt          the step, a number or traced by JAX
    steps       how many, a whole number; every: rows (steps/every + 1, ...) at the steps 0, every, 2 every, ...
    parameters  other values of parameters of the system, by letter; those left out are the system's

    It is the definition from which kernels are compiled, without projections.  It can go through jit, vmap, grad,
    jacfwd and scan, in float64, inside `kreisel.reduction.double()`.  grad keeps about 2 sqrt(steps) states and
    computes the others again.  What ends a run by a `RunError` in `kr.simulate` does so here too, but is NaN where JAX
    traces.  Needs the extra `reduction` (JAX).  Raises `InputError` for methods and systems without such a step, for
    arrays in float32, and for what JAX traces where a number is needed.
    """
    check_model(system)
    if system.batch:
        raise InputError(f"differentiable: expected parameters of one body, got a batch {system.batch}. Use jax.vmap.")
    step = _step_of(system, named(method, "method"), whole_order(order))

    @explained
    def motion(
        state: Mapping[str, Any], *, dt: Any, steps: int, every: int | None = None, **parameters: Any
    ) -> dict[str, Array]:
        from kreisel.kernels import jax_numbers as by
        from kreisel.reduction.double import double, require_double

        count = _whole(by, steps, "steps", MOST_STEPS)
        between = count if every is None else _whole(by, every, "every", count)
        if count % between:
            raise InputError(f"steps: expected a multiple of every = {between}, got {count}.")
        with double():
            require_double(dt, *state.values(), *parameters.values())
            rows = _rows(by, system, step, state, dt, count // between, between, parameters)
            out = {k: v if every is not None else v[-1] for k, v in rows.items()}
            if not any(by.is_traced(v) for v in out.values()) and not all(np.isfinite(v).all() for v in out.values()):
                raise RunError(_fault(system, step))
        return out

    return motion


def _whole(by: Any, value: Any, name: str, most: int) -> int:
    if by.is_traced(value):
        raise InputError(
            f"{name}: expected a whole number that is known when JAX traces, got {shown(value)}. Use "
            f"jax.jit(..., static_argnames={name!r}), or close over it."
        )
    return within(value, name, 1, most)


def _fault(system: Model, step: Step) -> str:
    guard = step.guard
    why = f"{guard.fault}. Usual cause: {guard.cause}" if guard else "Usual cause: dt too long for this state."
    return f"{system.system.name}: the state is no longer finite. {why} kr.simulate names the step."


# -- the step of a method --------------------------------------------------------------------------


def _step_of(model: Model, method: str | None, order: Any) -> Step:
    """Raises `InputError` where the method has no step that JAX can take."""
    made = scheme(model, method, 1.0, order, False)
    if isinstance(made.motion, JaxSteps):
        return Step(made.kinds, _same, _same, made.motion.step, None, _linear(model, made), None, arrays=True)
    if made.name == "exact":
        return _closed(model, made)
    if model.n > MOST_N or not isinstance(made.motion, Steps) or made.coupling is not None:
        raise InputError(
            f"differentiable: expected a method that makes steps and n of at most {MOST_N}, of a body on its own, got "
            f"method={made.name!r}, {model.system.name}, n = {model.n}."
        )
    if made.corrector is not None:
        raise InputError(
            f"differentiable: expected a method that steps the state itself, got order={made.options['order']}, whose "
            "corrector comes before the steps and behind them. Use order=(8, 2) or (8, 6, 4)."
        )
    begin, end = _same, _same
    if made.name == "suris" and made.options["order"] == 2:
        begin, end = (_of(f) for f in (model.map.from_symmetric, model.map.to_symmetric))
    take, close = made.motion.step, made.motion.close
    if made.name != "baecklund":
        return Step(made.kinds, begin, end, take, close, _linear(model, made), made.guard)
    constants = _of_baecklund(model, made.options["order"])
    return Step(made.kinds, begin, end, _spun(model, take), close and _spun(model, close), constants, made.guard)


def _spun(model: Model, function: Callable[..., State]) -> Callable[..., State]:
    """With the matrices of the turns from their coordinates, of which there are fewer."""

    def spun(*z: Array, **known: Any) -> State:
        if SPIN in known:
            known |= dict.fromkeys(SPINS, algebra.skew(known.pop(SPIN), model.n))
        return function(*z, **known)

    return spun


def _same(*z: Array, **known: Any) -> State:
    return z


def _of(function: Any) -> Callable[..., State]:
    return lambda *z, **known: tuple(call(function, z, known))


def _linear(model: Model, made: Scheme) -> Callable[[State, Known, Any], tuple[Known, Known]]:
    """Constants and those of stages are linear in dt, or without it: from their values at dt = 1 and 2."""
    twice = find(made.name).make(model, 2.0, made.options.get("order"), False)

    def at(own: State, known: Known, dt: Any) -> tuple[Known, Known]:
        def value(x: Any, y: Any) -> Any:
            rate = np.asarray(y, dtype=np.float64) - x
            return x if not rate.any() else x - rate + rate * dt

        mine = {k: value(v, twice.constants[k]) for k, v in made.constants.items() if k not in model.constants}
        return mine, {k: value(v, twice.stages[k]) for k, v in made.stages.items()}

    return at


def _closed(model: Model, made: Scheme) -> Step:
    """The closed form as one short step; `reach`, at most 1, says how long."""
    part = closed_form(model.system, model.n)
    if part is None or part.reach is None:
        raise InputError(
            "differentiable: expected the closed form of a free body or a Lagrange top, n = 3, with method='exact', "
            f"got {model.system.name}. Use method='baecklund' of a high order."
        )
    reach = part.reach

    def take(*z: Array, eps: Any, **known: Any) -> State:
        own, _ = part.move(z[:-1], (), eps, known)
        return (*own, algebra.maximum(z[-1], reach(z[:-1], eps, known)))

    def begin(*x: Array, **known: Any) -> State:
        return (*x, zero(model.system, x))

    guard = Guard(REACH, 1.0, f"A step is longer than {part.name} is precise for", "more than some radians a step.")
    kinds = [*model.system.space.kinds, "scalar"]
    return Step(kinds, begin, _same, take, None, lambda own, known, dt: ({"eps": dt}, {}), guard)


def _of_baecklund(model: Model, order: int) -> Callable[[State, Known, Any], tuple[Known, Known]]:
    """mu = zeta/dt, rho, and the turns of the body.

    rho goes without a derivative: the step improves it by a step of Newton's method, so that only its square counts,
    and the derivatives of the step are those with the rho of the very state.
    """
    unit = Product(model, 1.0, order, False)
    pairs, points = len(unit.pairs), len(unit.points)

    def host(dt: Array, own: list[Array], given: Known) -> Array:
        lane = copy(model)
        lane.constants = {**model.constants, **{k: np.asarray(v) for k, v in given.items()}}
        try:
            constants, stages = Product(lane, float(dt), order, False).trajectory(tuple(map(np.asarray, own)))
        except InputError:
            return np.full(2 * points, np.nan)
        rho = np.append(stages["rho_re"] + 1j * stages["rho_im"] if pairs else (), constants.get("rho", ()))
        return np.concatenate([rho.real, rho.imag])

    def at(own: State, known: Known, dt: Any) -> tuple[Known, Known]:
        from kreisel.kernels import jax_numbers as by

        given = {k: by.values(v) for k, v in known.items()}
        rho = by.from_host(host, 2 * points, dt, [by.values(x) for x in own], given)
        constants: Known = {}
        stages: Known = {}
        if pairs:
            mu = np.array(unit.pairs)
            stages = {"mu_re": mu.real / dt, "mu_im": mu.imag / dt, "rho_re": rho[:pairs]}
            stages["rho_im"] = rho[points : points + pairs]
        if unit.single:
            constants = {"mu": unit.single[0] / dt, "rho": rho[pairs]}
        if unit.spins:
            turn = by.half_turn(call(unit.record.spin, own, known), dt)
            constants[SPIN] = algebra.coordinates(turn)
        return constants, stages

    return at


# -- constants and states --------------------------------------------------------------------------


def constants_of(by: Any, model: Model, parameters: Mapping[str, Any]) -> Known:
    """The constants of the model, with other parameters.  Raises `InputError` for unknown ones and wrong shapes."""
    known = dict(model.constants)
    if not parameters:
        return known
    stated = {p.letter: p for p in model.system.parameters}
    for letter, value in parameters.items():
        if letter not in stated or stated[letter].kind == "dimension":
            raise InputError(
                f"{model.system.name} has the parameters {', '.join(stated)}, got {shown(letter)}, or one that is no "
                f"real number.{hint(letter, stated)}"
            )
        array = by.array(value, letter)
        if stated[letter].kind == "symmetric" and array.ndim == 1:
            array = array[..., None] * np.eye(model.n)
        if array.shape != known[letter].shape:
            raise InputError(
                f"{letter}: expected the shape {known[letter].shape}, got {array.shape}. For a batch use jax.vmap."
            )
        known[letter] = array
    if model.system.derive is not None:
        given = {p: known[p] for p in stated}
        known |= by.first_of(
            (lambda: dict(call(model.system.derive, (), given))),
            (lambda: dict(call(model.system.derive, (), {k: by.mixed(v) for k, v in given.items()}))),
            f"the parameters of {model.system.name}, {', '.join(parameters)},",
        )
    return {k: by.mixed(v) for k, v in known.items()}


def _own(by: Any, model: Model, state: Mapping[str, Any]) -> State:
    """The components as arrays of numbers.  Raises `InputError`."""
    space, out = model.system.space, []
    if {*state} != {*space.letters}:
        raise InputError(f"state: expected the components {', '.join(space.letters)}, got {shown(list(state))}.")
    for letter, kind in space.components:
        x = by.array(state[letter], letter)
        axial = kind == "skew" and model.n == 3
        n = model.n
        wanted = (n, n) if kind in ("skew", "symmetric") and not axial else (layout.coordinate_count(kind, n),)
        if x.shape != wanted:
            fix = " Use x0.axial for an axial vector." if axial and x.shape == (3, 3) else " For a batch use jax.vmap."
            raise InputError(f"{letter}: expected the shape {wanted}, got {x.shape}.{fix}")
        out.append(algebra.hat(by.numbers(x)) if axial else by.numbers(x))
    return tuple(out)


def _rows(
    by: Any, model: Model, step: Step, state: Mapping[str, Any], dt: Any, rows: int, every: int, parameters: Known
) -> dict[str, Array]:
    """The components at the saved steps."""
    space, known = model.system.space, constants_of(by, model, parameters)
    own = _own(by, model, state)
    more, stages = step.constants(own, known, dt)
    known |= {k: by.mixed(v) for k, v in more.items()}
    z = step.begin(*own, **known)
    extra = len(step.kinds) - len(z)
    z = (*z, *(zero(model.system, own) for _ in range(extra)))
    start = by.values(layout.flatten(z, step.kinds))
    if step.arrays:
        flat = by.orbit_of_arrays(step.take, step.kinds, model.n, start, known, rows, every)
    else:
        flat = by.orbit(step.take, step.close, step.kinds, model.n, start, known, stages, rows, every)

    def shown_row(row: Array) -> dict[str, Array]:
        parts = layout.restore(by.numbers(row), step.kinds, model.n)
        x = step.end(*parts[: len(space.letters)], **known)
        pieces = [algebra.axial(v) if k == "skew" and model.n == 3 else v for k, v in zip(space.kinds, x, strict=True)]
        out = {k: by.values(v) for k, v in zip(space.letters, pieces, strict=True)}
        if step.guard is None:
            return out
        return {k: by.jnp.where(row[-1] <= step.guard.limit, v, by.jnp.nan) for k, v in out.items()}

    out = by.jax.vmap(shown_row)(flat)
    return {letter: out[letter] for letter in space.letters}
