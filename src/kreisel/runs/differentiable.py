"""kr.differentiable and kr.tangent: a motion as a function of JAX, and the Jacobian of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained, hint, shown
from kreisel.forces.control import require_whole_samples, samples_missed, whole_samples
from kreisel.kernels.cpu import points as points_of
from kreisel.method import find, scheme
from kreisel.method.baecklund import Product
from kreisel.method.conjugate import OF_MAP, fractions
from kreisel.method.driven import zero
from kreisel.method.scheme import (
    COUNT,
    ORIENTATION,
    SPINS,
    Guard,
    JaxSteps,
    Scheme,
    Steps,
    as_matrix,
    turned,
    with_orientation,
)
from kreisel.method.splitting import REACH, closed_form, make as splitting
from kreisel.record.body import Body, as_body
from kreisel.record.calling import call
from kreisel.record.contract import Baecklund, ExactMap, Frame
from kreisel.record.model import Model, State
from kreisel.record.table import require_within, tables_exceeded
from kreisel.record.values import component
from kreisel.runs.geometry import model_for
from kreisel.runs.in_si import duration, in_state_form, matrix_of, oriented
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import (
    MOST_STEPS,
    check_model,
    finite_number,
    initial_orientation,
    named,
    whole_order,
    within,
)

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.record.model import Model, OrientationLike

SPIN = "spin"
TRANSPOSES = {"skew": -1.0, "symmetric": 1.0}  # the transpose over the matrix
OFF = 1e-3  # a start off its phase space by less may be a finite difference, or a long motion without projections
MOST_N = 10  # beyond, a step has too many operations for straight-line code
Known = dict[str, Any]
Parts = tuple[Array, ...]


class Step(NamedTuple):
    """A step in the form that JAX needs.

    scheme      the step, (*z, **constants) -> z for each stage, and its components: state, orientation, further ones
    constants(own, known, dt)  -> constants of the trajectory, and of the stages (stage, ...)
    begin, end  the method's variables from the state, and back: (*state, **constants) -> state; None: the same
    higher      the motion for derivatives of the second order and beyond; None: the same
    """

    scheme: Scheme
    constants: Callable[[Parts, Known, Any], tuple[Known, Known]]
    begin: Callable[..., Parts] | None = None
    end: Callable[..., Parts] | None = None
    higher: Steps | None = None


@explained
def differentiable(
    system: Model | Body,
    *,
    method: str | None = None,
    order: int | tuple[int, ...] | None = None,
    orientation: OrientationLike | bool | None = None,
) -> Callable[..., dict[str, Array]]:
    """The motion as a function of JAX: f(state, dt=, steps=, every=None, time=0, **parameters) -> state.

    orientation the attitude at the start, as for `kr.simulate`; states then have g, and a state with g starts there.
                True: every state has g.  Forces may need it; default: for a body on which forces need it
    state       mapping of the components: m (3,), an axial vector, for n = 3, else (n, n) skew (of a traced matrix its
                skew part); a (n,); `x0.axial` of a state; with an orientation also g, (4,) for n = 3, else (n, n)
    dt          the step, a float or traced by JAX; for a body of `kr.physical` also "1 ms"
    steps       the number of steps; every: rows (steps/every + 1, ...) at 0, every, ...; time: at the start, for forces
    parameters  other values of parameters of the system, by letter; default: the system's values

    The function is the definition from which kernels are compiled, without projections.  It can go through jit, vmap,
    grad, jacfwd, hessian and scan, in float64, inside `kreisel.reduction.double()`; derivatives of "baecklund" and of
    steps with a loop are right to the third order.  grad keeps 2 sqrt(steps) states.  A `RunError` of `kr.simulate` is
    raised here too, or is NaN under tracing.  Needs the extra `reduction` (JAX).  For a body of `kr.physical` states
    are in SI, with the names of its runs, and times in s; a `FreeBody` has the parameter `moments`, its principal
    moments in kg m^2.  Raises `InputError` for methods without such a step, float32, and traced values if a number is
    needed.
    """
    if (body := as_body(system)) is not None:
        return _of_body(body, method, order, orientation)
    model: Any = system
    check_model(model)
    if model.batch:
        raise InputError(f"differentiable: expected parameters of one body, got a batch {model.batch}. Use jax.vmap.")
    oriented = orientation is not None and orientation is not False
    begin = None if isinstance(orientation, bool | None) else initial_orientation(orientation, model)
    if begin is not None and begin.ndim > 1 + (model.n > 3):
        raise InputError(f"orientation: expected one attitude, got the shape {begin.shape}. Use jax.vmap over g.")
    step_with = cache(partial(_step_of, model, named(method, "method"), whole_order(order), oriented))
    step_with(False)  # raises

    @explained
    def motion(
        state: Mapping[str, Any], *, dt: Any, steps: int, every: int | None = None, time: Any = 0.0, **parameters: Any
    ) -> dict[str, Array]:
        from kreisel.kernels import jax_numbers as by
        from kreisel.reduction.numerics import double, require_double

        count = _integer(by, steps, "steps", MOST_STEPS)
        between = count if every is None else _integer(by, every, "every", count)
        if count % between:
            raise InputError(f"steps: expected a multiple of every = {between}, got {count}.")
        step = step_with(bool(parameters))
        with double():
            require_double(dt, time, *state.values(), *parameters.values())
            dt, time = (v if by.is_traced(v) else finite_number(v, k) for k, v in (("dt", dt), ("time", time)))
            dt = _step_time(by, model, dt)
            start = _at_times(by, model, _start_of(by, model, state, oriented, begin), dt, time, count)
            rows = _rows(by, model, step, start, dt, time, count // between, between, parameters)
            return {k: v if every is not None else v[-1] for k, v in rows.items()}

    return motion


def _step_time(by: Any, model: Model, dt: Any) -> Any:
    if by.is_traced(dt):
        return dt + by.lax.stop_gradient(whole_samples(model, dt) - dt)
    if not dt:
        raise InputError("dt: expected a step, which may be negative, got 0.")
    return whole_samples(model, dt)


def _integer(by: Any, value: Any, name: str, most: int) -> int:
    if by.is_traced(value):
        raise InputError(
            f"{name}: expected an integer that is known when JAX traces, got {shown(value)}. Use "
            f"jax.jit(..., static_argnames={name!r}), or close over it."
        )
    return within(value, name, 1, most)


# -- the step of a method --------------------------------------------------------------------------


def _step_of(model: Model, method: str | None, order: Any, oriented: bool, varied: bool) -> Step:
    """The step of a method; with `varied` parameters, terms without effect at the model's values are kept.

    Raises `InputError` if the method has no step for JAX.
    """
    record = model.system.perturbation
    sampled = record is not None and record.control is not None and record.sampled
    chosen = scheme(model, method, record.control.every if sampled else 1.0, order, oriented)  # type: ignore[union-attr]
    if isinstance(chosen.motion, JaxSteps):
        return Step(chosen, _linear(model, chosen, oriented))
    if chosen.name == "exact":
        return _closed(model, chosen, oriented)
    if chosen.name == "baecklund" and model.system.pairs is not None and model.system.baecklund is None:
        raise InputError(
            "differentiable: expected a method whose steps need no search for branches of a spectral curve, got "
            f"method='baecklund' of {model.system.name}. Use another method: kr.methods() lists them."
        )
    if model.n > MOST_N or not isinstance(chosen.motion, Steps) or chosen.coupling is not None:
        raise InputError(
            f"differentiable: expected a method that makes steps and n of at most {MOST_N}, of a single body, got "
            f"method={chosen.name!r}, {model.system.name}, n = {model.n}."
        )
    if chosen.corrector is not None:
        raise InputError(
            f"differentiable: expected a method that steps the state itself, got order={chosen.options['order']}, "
            "whose corrector comes before the steps and behind them. Use order=(8, 2) or (8, 6, 4)."
        )
    if chosen.name == "splitting" and (varied or sampled):
        chosen = splitting(model, 1.0, chosen.options["order"], oriented, all_turns=True)
    if chosen.name != "baecklund":
        ends: tuple[Any, ...] = ()
        if chosen.name == "suris" and chosen.options["order"] == 2:
            ends = model.map.from_symmetric, model.map.to_symmetric
        return Step(chosen, _linear(model, chosen, oriented), *ends)
    if oriented:
        raise InputError(
            "Derivatives of the orientation: expected another method, such as 'exact' or 'suris', got "
            "method='baecklund', whose rotations about the axis are constants of the trajectory. Use such a method, in "
            "kr.simulate for kr.tangent, or orientation=False."
        )
    if model.system.exact_map is not None:
        return Step(chosen, _of_map(model, chosen))

    def spun(function: Callable[..., Parts], *z: Array, **constants: Any) -> Parts:
        """The function with rotation matrices computed from their coordinates, which are fewer."""
        if SPIN in constants:
            constants |= dict.fromkeys(SPINS, algebra.skew(constants.pop(SPIN), model.n))
        return function(*z, **constants)

    motion = cast("Steps", chosen.motion)
    motion = Steps(partial(spun, motion.step), motion.close and partial(spun, motion.close))
    higher = Steps(partial(_on_curve, model, motion.step), motion.close and partial(_on_curve, model, motion.close))
    return Step(replace(chosen, motion=motion), _of_baecklund(model, chosen), higher=higher)


def _linear(model: Model, scheme: Scheme, oriented: bool) -> Callable[[Parts, Known, Any], tuple[Known, Known]]:
    """Constants of the step and of its stages, linear in dt or independent of it: from their values at dt = 1, 2."""
    order = scheme.options.get("order")
    if scheme.name == "splitting":
        twice = splitting(model, 2.0, order, oriented, all_turns=True)
    else:
        twice = find(scheme.name).make(model, 2.0, order, oriented)

    def at(state: Parts, constants: Known, dt: Any) -> tuple[Known, Known]:
        def value(x: Any, y: Any) -> Any:
            rate = np.asarray(y, dtype=np.float64) - x
            return x if not rate.any() else x - rate + rate * dt

        mine = {k: value(v, twice.constants[k]) for k, v in scheme.constants.items() if k not in model.constants}
        return mine, {k: value(v, twice.stages[k]) for k, v in scheme.stages.items()}

    return at


def _closed(model: Model, scheme: Scheme, oriented: bool) -> Step:
    """The closed form as one short step; `reach`, at most 1, is its length."""
    motion = closed_form(model.system, model.n)
    if motion is None or motion.reach is None:
        raise InputError(
            "differentiable: expected the closed form of a free body or a Lagrange top, n = 3, with method='exact', "
            f"got {model.system.name}. Use another method: kr.methods() lists them."
        )
    reach, count = motion.reach, len(model.system.space.letters)

    def take(*z: Array, eps: Any, **constants: Any) -> Parts:
        state, g = motion.move(z[:count], z[count:-1], eps, constants)
        return (*state, *g, algebra.maximum(z[-1], reach(z[:count], eps, constants)))

    guard = Guard(f"A step is longer than {motion.name} is precise for", "more than some radians a step.", REACH, 1.0)
    components = (*with_orientation(model, oriented), (REACH, "scalar"))
    step = replace(scheme, components=components, motion=Steps(take, None), guard=guard)
    return Step(step, lambda state, constants, dt: ({"eps": dt}, {}))


def _of_baecklund(model: Model, scheme: Scheme) -> Callable[[Parts, Known, Any], tuple[Known, Known]]:
    """mu = zeta/dt, rho, and the rotations of the body.

    rho has no derivative: the step improves it by a step of Newton's method, so only its square counts, and first
    derivatives of the step equal those with the rho of this state.  It is compiled, as in a run.
    """
    order = scheme.options["order"]
    unit = Product(model, 1.0, order, False)
    pairs, points = len(unit.pairs), len(unit.points)

    def host(dt: Array, state: list[Array], parameters: Known) -> Array:
        lane, arrays = copy(model), {k: np.asarray(v) for k, v in parameters.items()}
        lane.constants = {**model.constants, **arrays}
        by_kernel = partial(points_of, replace(scheme, constants={**scheme.constants, **arrays}))
        try:
            maps = Product(lane, abs(float(dt)), order, False)
            constants, stages = maps.trajectory(tuple(map(np.asarray, state)), by_kernel)
        except InputError:
            return np.full(2 * points, np.nan)
        rho = np.append(stages["rho_re"] + 1j * stages["rho_im"] if pairs else (), constants.get("rho", ()))
        rho = rho * unit.record.odd if dt < 0 else rho  # at -mu
        return np.concatenate([rho.real, rho.imag])

    def at(state: Parts, parameters: Known, dt: Any) -> tuple[Known, Known]:
        from kreisel.kernels import jax_numbers as by

        arrays = {k: by.values(v) for k, v in parameters.items()}
        rho = by.from_host(host, 2 * points, dt, [by.values(x) for x in state], arrays)
        constants: Known = {}
        stages: Known = {}
        if pairs:
            mu = np.array(unit.pairs)
            stages = {"mu_re": mu.real / dt, "mu_im": mu.imag / dt, "rho_re": rho[:pairs]}
            stages["rho_im"] = rho[points : points + pairs]
        if unit.single:
            constants = {"mu": unit.single[0] / dt, "rho": rho[pairs]}
        if unit.spins:
            turn = by.half_turn(call(unit.record.spin, state, parameters), dt)
            constants[SPIN] = algebra.coordinates(turn)
        return constants, stages

    return at


def _on_curve(model: Model, function: Callable[..., Parts], *z: Array, **constants: Any) -> Parts:
    """The function with the rho for which the defect of its vector, which is affine in rho, vanishes.

    Both are steps of Newton's method: from the rho of the start, derivatives to the third order are right.
    """
    record, state = cast("Baecklund", model.system.baecklund), z[: len(model.system.space.letters)]
    if pair := "rho_re" in constants:
        at = {k: algebra.complex_number(constants[f"{k}_re"], constants[f"{k}_im"]) for k in ("mu", "rho")}
    elif "rho" in constants:
        at = {k: constants[k] for k in ("mu", "rho")}
    else:
        return function(*z, **constants)
    e = call(record.vector, state, constants | at)
    at_0, at_1 = (call(record.defect, (*state, e), constants | at | {"rho": x}) for x in (0.0, 1.0))
    re, im = algebra.parts(at_0 / (at_0 - at_1))
    return function(*z, **constants | ({"rho_re": re, "rho_im": im} if pair else {"rho": re}))


def _of_map(model: Model, scheme: Scheme) -> Callable[[Parts, Known, Any], tuple[Known, Known]]:
    """z = eps/2i and w of `ExactMap`, with derivatives."""
    unit = fractions(1.0, scheme.options["order"]) / 2j

    def at(state: Parts, constants: Known, dt: Any) -> tuple[Known, Known]:
        from kreisel.kernels import jax_numbers as by

        z = unit * by.values(dt)
        arrays = {k: by.values(v) for k, v in constants.items()}
        w = call(cast("ExactMap", model.system.exact_map).level, tuple(map(by.values, state)), {**arrays, "z": z})
        return {}, dict(zip(OF_MAP, (z.real, z.imag, w.real, w.imag), strict=True))

    return at


# -- constants and states --------------------------------------------------------------------------


def constants_of(by: Any, model: Model, parameters: Mapping[str, Any]) -> Known:
    """The constants of the model, with other parameters.  Raises `InputError` for unknown ones and wrong shapes.

    Parameters that JAX does not trace are checked like the parameters of a system.
    """
    if not parameters:
        return dict(model.constants)
    stated = {p.letter: p for p in model.system.parameters if p.kind not in ("dimension", "table")}
    constants = {p.letter: model.constants[p.letter] for p in model.system.parameters}
    for letter, value in parameters.items():
        if letter not in stated:
            raise InputError(
                f"expected parameters of {model.system.name} that are real: {', '.join(stated)}, got "
                f"{shown(letter)}.{hint(letter, stated)}"
            )
        array = by.array(value, letter)
        if stated[letter].kind == "symmetric" and array.ndim == 1:
            array = array[..., None] * np.eye(model.n)
        if array.shape != constants[letter].shape:
            raise InputError(
                f"{letter}: expected the shape {constants[letter].shape}, got {array.shape}. For a batch use jax.vmap."
            )
        constants[letter] = array
    if not any(by.is_traced(v) for v in constants.values()):
        tables = {letter: model.params[letter] for letter, p in stated.items() if p.kind == "table"}
        values = {letter: np.asarray(value) for letter, value in constants.items()}
        return dict(model.system(**{**values, **tables}).constants)
    if model.system.derive is not None:
        underived = dict(constants)
        constants |= by.first_of(
            (lambda: dict(call(model.system.derive, (), underived))),
            (lambda: dict(call(model.system.derive, (), {k: by.mixed(v) for k, v in underived.items()}))),
            f"the parameters of {model.system.name}, {', '.join(parameters)},",
        )
    return {k: by.mixed(v) for k, v in constants.items()}


def _start_of(by: Any, model: Model, state: Mapping[str, Any], oriented: bool, begin: Array | None) -> Parts:
    """The components, and the orientation, if any, as arrays.  Raises `InputError`."""
    space, out = model.system.space, []
    if oriented and ORIENTATION not in state and begin is not None:
        state = {**state, ORIENTATION: begin}
    wanted_letters = (*space.letters, *(ORIENTATION,) * oriented)
    if {*state} != {*wanted_letters}:
        unasked = " orientation=... gives a start to g." if ORIENTATION in {*state} ^ {*wanted_letters} else ""
        expected, names = ([model.body_frame.names.get(k, k) for k in letters] for letters in (wanted_letters, state))
        raise InputError(f"state: expected the components {', '.join(expected)}, got {shown(names)}.{unasked}")
    for letter, kind in with_orientation(model, oriented):
        value = state[letter]
        if letter == ORIENTATION and not by.is_traced(value):
            value = initial_orientation(value, model)
        x = by.array(value, letter)
        if not by.is_traced(x) and not np.isfinite(x).all():
            raise InputError(f"{letter}: expected finite values, got {shown(value)}.")
        form = algebra.KINDS[kind].shown(model.n)
        wanted = form.shape(model.n)
        if x.shape != wanted:
            axial = form.name != kind and x.shape == (3, 3)
            fix = " Use x0.axial for an axial vector." if axial else " For a batch use jax.vmap."
            raise InputError(f"{letter}: expected the shape {wanted}, got {x.shape}.{fix}")
        if form.name in TRANSPOSES:
            if not by.is_traced(x):
                component(letter, kind, np.asarray(x), model.n, of_bodies=False)  # raises
            x = x / 2 + TRANSPOSES[form.name] * (x.mT / 2)
        out.append(algebra.KINDS[kind].from_user(by.numbers(x), model.n))
    if (space.constraints or model.system.checks.state) and not any(map(by.is_traced, state.values())):
        parts = {k: component(k, kind, np.asarray(state[k]), model.n, of_bodies=False) for k, kind in space.components}
        model.require_sound(parts, OFF)
    return tuple(out)


def _at_times(by: Any, model: Model, start: Parts, dt: Any, time: Any, steps: int) -> Parts:
    """The start of steps that tables and controllers allow, else NaN if JAX traces a time, or an `InputError`."""
    end = time + dt * steps
    if by.is_traced(end):
        lost = [exceeded for *_, exceeded in tables_exceeded(model, time, end)]
        valid = by.mixed(by.jnp.where(sum(lost, samples_missed(model, dt, time, end)), by.jnp.nan, 1.0))
        return tuple(valid * x for x in start)
    if samples_missed(model, dt, time, end):
        require_whole_samples(model, float(dt), float(time), "time")
    require_within(model, float(time), float(end))
    return start


def attitude_near(by: Any, model: Model, x: Any, g: Any) -> Any:
    """g cay(X/2) (moving frame) or cay(X/2) g (rest frame), X of the entries x, i < j: a chart around g."""
    X = algebra.skew(by.numbers(x) / 2, model.n)
    return by.values(turned(model.system.frame, X, by.numbers(by.jnp.asarray(g))))


def _rows(
    by: Any, model: Model, step: Step, start: Parts, dt: Any, time: Any, rows: int, every: int, parameters: Known
) -> dict[str, Array]:
    space, constants = model.system.space, constants_of(by, model, parameters)
    state = start[: len(space.letters)]
    of_step, stages = step.constants(state, constants, dt)
    constants |= {k: by.mixed(v) for k, v in of_step.items()}
    scheme, motion, count = step.scheme, step.scheme.motion, len(space.letters)
    shown = scheme.components[: len(start)]
    z = start if step.begin is None else (*call(step.begin, state, constants), *start[count:])
    clock = by.mixed(by.jnp.asarray(time / dt, dtype=float)) + zero(model.system, state)
    z = (*z, *(clock if name == COUNT else zero(model.system, state) for name, _ in scheme.components[len(z) :]))
    flat = by.values(algebra.flatten(z, scheme.kinds))
    if isinstance(motion, JaxSteps):
        flat = by.orbit_of_arrays(motion.step, scheme.kinds, model.n, flat, constants, rows, every)
    else:
        steps = cast("Steps", motion)
        flat = by.orbit(steps, scheme.kinds, model.n, flat, constants, stages, rows, every, step.higher)

    def shown_row(row: Array) -> dict[str, Array]:
        x = algebra.restore(by.numbers(row), scheme.kinds, model.n)[: len(shown)]
        x = x if step.end is None else (*call(step.end, x[:count], constants), *x[count:])
        out = {k: by.values(algebra.KINDS[kind].for_user(v)) for (k, kind), v in zip(shown, x, strict=True)}
        if scheme.guard is None:
            return out
        valid = by.jnp.where(row[-1] <= scheme.guard.limit, 1.0, by.jnp.nan)  # a factor: derivatives are NaN as well
        return {k: valid * v for k, v in out.items()}

    out = by.jax.vmap(shown_row)(flat)
    if not any(by.is_traced(v) for v in out.values()) and not all(np.isfinite(v).all() for v in out.values()):
        guard = scheme.guard
        why = f"{guard.fault}. Usual cause: {guard.cause}" if guard else "Usual cause: dt too long for this state."
        raise RunError(f"{model.system.name}: the state is no longer finite. {why} kr.simulate names the step.")
    return {letter: out[letter] for letter, _ in shown}


def _of_body(body: Body, method: Any, order: Any, orientation: Any) -> Callable[..., dict[str, Array]]:
    model = body.in_si()
    frame, forces = model.body_frame, model.system.perturbation
    if orientation is None:
        orientation = forces is not None and bool(forces.names(ORIENTATION))
    begin = orientation if isinstance(orientation, bool) else oriented(model, orientation)
    along = body.vectors if frame.turned else ()  # parameters along the axes of the body
    scalars = {letter for letter, kind in model.system.space.components if kind == "scalar"}  # memory of a controller
    motion = differentiable(model, method=method, order=order, orientation=begin)

    def changed(state: Mapping[str, Any], forward: bool) -> dict[str, Any]:
        names = frame.names if forward else {name: letter for letter, name in frame.names.items()}
        out = {}
        for name, value in state.items():
            if name in scalars:
                out[name] = value
                continue
            if not np.ndim(value):
                raise InputError(f"{name}: expected a vector, got one value.")
            matrix = matrix_of(frame, name if forward else names.get(name, name), np.shape(value)[-1], forward)
            out[names.get(name, name)] = value if np.array_equal(matrix, np.eye(len(matrix))) else value @ matrix
        return out

    @explained
    def in_si(
        state: Mapping[str, Any], *, dt: Any, steps: int, every: int | None = None, time: Any = 0.0, **others: Any
    ) -> dict[str, Array]:
        from kreisel.kernels import jax_numbers as by
        from kreisel.reduction.numerics import double, require_double

        with double():
            require_double(dt, time)
            if isinstance(state, State):
                start = {**state.axial, **({} if orientation is False else {ORIENTATION: state.orientation})}
            else:
                start = changed({name: by.array(value, name) for name, value in state.items()}, False)
            others = {name: by.array(value, name) for name, value in others.items()}
            others = {name: value @ frame.axes if name in along else value for name, value in others.items()}
            clock = {"dt": dt, "time": time}
            clock = {k: v / frame.time_unit if by.is_traced(v) else duration(frame, v, k) for k, v in clock.items()}
            rows = motion(start, steps=steps, every=every, **clock, **body._scaled(others))
            return changed(rows, True)

    return in_si


ON_STEP = 1e-6  # of a step: an impulse this close to a step happens at the step


@explained
def tangent(run: xr.Dataset, *, system: Model | None = None) -> Array:
    """J (d, d) = d(end state)/d(initial state) of a run of one trajectory, in independent coordinates.

    The coordinates of the Poisson tensor: entries i < j of a skew matrix, then the vectors; J T(start) J^T = T(end) if
    the method is Poisson.  With an orientation, then the entries i < j of the skew X with dg = g X (moving frame) or
    dg = X g (rest frame).  Of a body: in axes and units of its state, `body.in_si().body_frame`.  `system`: the system
    of the run, if it is user-defined.  `kr.differentiable` computes it without projections.  For a part of a run,
    `run.isel(time=slice(...))`, from its first row to its last.  Needs the extra `reduction`.  Raises `InputError` for
    ensembles, runs with impulses, events or given times, one row, and as `differentiable`; `RunError` if J is infinite.
    """
    record, run = RunRecord.of(run), in_state_form(run)
    if "lane" in run.dims or not record.stepped or record.broken or record.at_times:
        raise InputError(
            "tangent: expected a run of one trajectory by equal steps, got an ensemble, or one with impulses, events "
            "or separate times. Use kr.differentiable, with jax.vmap for ensembles."
        )
    model, steps = model_for(run, system), float(run["time"][-1] - run["time"][0]) / record.dt
    if round(steps) < 1 or abs(steps - round(steps)) > ON_STEP:
        raise InputError(f"tangent: expected rows with some steps of {record.dt:g} from first to last, got {steps:g}.")
    f = differentiable(model, method=record.method, order=record.order, orientation=ORIENTATION in run)
    from kreisel.kernels import jax_numbers as by
    from kreisel.reduction.numerics import double, jax

    jnp = jax.numpy

    space, n = model.system.space, model.n
    kinds = [algebra.KINDS[kind] for kind in space.kinds]
    size = algebra.coordinate_count(space.kinds, n)

    def coordinates(state: Mapping[str, Any]) -> Array:
        components = [kind.from_user(state[letter], n) for letter, kind in zip(space.letters, kinds, strict=True)]
        return algebra.flatten(components, space.kinds)

    start = coordinates({letter: np.asarray(run[letter].values[0], dtype=np.float64) for letter in space.letters})
    start = np.append(start, np.zeros(n * (n - 1) // 2 * (ORIENTATION in run)))

    def coordinates_of_turn(g: Array) -> Array:
        """The coordinates of X, which is 0 at the point of differentiation."""
        R = as_matrix(model, g)
        back = jax.lax.stop_gradient(R).mT
        turn = back @ R if model.system.frame is Frame.MOVING else R @ back
        return algebra.coordinates((turn - turn.mT) / 2)

    def end(x: Array) -> Array:
        parts = zip(kinds, algebra.restore(x[:size], space.kinds, n), strict=True)
        state = dict(zip(space.letters, (kind.for_user(z) for kind, z in parts), strict=True))
        if ORIENTATION in run:
            state[ORIENTATION] = attitude_near(by, model, x[size:], run.g.values[0])
        out = f(state, dt=record.dt, steps=round(steps), time=float(run["time"][0]))
        flat = coordinates(out)
        return jnp.append(flat, coordinates_of_turn(out[ORIENTATION])) if ORIENTATION in run else flat

    with double():
        J = np.asarray(jax.jit(jax.jacfwd(end))(jnp.asarray(start)))
    if not np.isfinite(J).all():
        raise RunError(
            "tangent: the Jacobian is not finite. Usual cause: dt too long, of a Binary a large part of its orbit, or "
            "a run too long for doubles."
        )
    return J
