"""A law that is sampled: sensors, commands, actuators, wheels; a body with these as a system; the field in between.

State: the momentum M, then the momenta of the wheels, the memory of the law, the commands that are held, commands that
are delayed, the generator of the noise.  At a sample

    sensors -> law -> commands, limited -> delay -> held;   M <- M + impulse

and between two samples, with B the field and W the axes of the wheels as rows, all along the axes of the state,

    M' = ... + dipole x B + torque - W^T motors + (W^T wheels) x Omega,   wheels' = motors

with motors = wheel_torque, the steady torque of the motors and the one that is commanded.

Sensors and commands are in SI along the body axes, v_body = R v_state, R from the quaternion `body_axes`; of a state
in the rest frame v_body = R g^T v_state.

For steps much shorter than the times in which it changes, the field along an orbit is interpolated in time.  A window
of the length `span` has six equidistant nodes, t = (w - 1/2 + i/5) span, i = 0 .. 5, with w the integer next to
t/span.  The polynomial through the fields at the nodes is the field of the window: a function of time only, whatever
was computed before.  The state carries w + 1/2 and the coefficients, which are computed when w changes.

With a hundred windows in a revolution, IGRF-14 of degree 13 at 500 km is off by less than 1e-4 nT.  A window is not
longer than two steps of a table of positions, whose polynomials continue beyond its ends: then positions rounded to 100
m, 10 s apart, make it off by less than 0.04 nT, in longer windows by up to 200 nT.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import joined
from kreisel.algebra.gradient import traced
from kreisel.algebra.invariants import stack
from kreisel.algebra.iteration import repeat
from kreisel.algebra.random import GENERATOR, normals
from kreisel.algebra.recorded import run
from kreisel.errors import InputError, shown
from kreisel.forces import kicks
from kreisel.forces.kicks import BODY_AXES, HELD, WHEEL_AXES, WHEEL_TORQUE, WHEELS, Body, Constants, perturbation_of
from kreisel.forces.records import perturbed_record
from kreisel.record.calling import Portable, call
from kreisel.record.contract import Parameter, PhaseSpace, System
from kreisel.record.model import Model
from kreisel.record.perturbation import FIELDS, WITH_WHEELS, Controller, Perturbation

QUEUE, WHEEL_LIMIT = "queue", "wheel_limit"
DEVIATION, BIAS, LIMIT = "noise_", "bias_", "limit_"
SENSORS = {"rates": (3,), "attitude": (4,), "time": (), WHEELS: (-1,), **{k: f.shape for k, f in FIELDS.items()}}
COMMANDS = {"dipole": "A m^2", "torque": "N m", WHEEL_TORQUE: "N m", "impulse": "N m s"}

WHOLE_SAMPLES = 1e-9  # relative: steps that are meant to divide the time between samples
ROUNDING = 5e-14  # relative, of times in steps; less than `splitting.NEAR_SAMPLE`

State = tuple[Array, ...]


# -- the state -------------------------------------------------------------------------------------------


def components(control: Controller) -> dict[str, tuple[str, str]]:
    """Kinds and meanings of the state's variables beyond the body's, by letter, in order."""
    out: dict[str, tuple[tuple[int, ...], str]] = {}
    if control.wheels:
        out[WHEELS] = (control.wheels,), "momenta of the wheels"
    out |= {name: (shape, f"memory of the law: {name}") for name, shape in control.memory.items()}
    for name, size in control.commands.items():
        axes = "" if name == WHEEL_TORQUE else ", along the body axes"
        out[HELD + name] = (size,), f"{name.replace('_', ' ')} that is commanded{axes}"
    if control.delay:
        out[QUEUE] = (control.delay * sum(control.commands.values()),), "commands that are delayed"
    if control.noise:
        out[GENERATOR] = (6,), "generator of the noise"
    return {letter: (f"R^{shape[0]}" if shape else "scalar", words) for letter, (shape, words) in out.items()}


def changed_by_samples(system: System) -> tuple[int, ...]:
    """The places of the components that a sample changes."""
    still = {WHEELS} | (set() if "impulse" in _control(system).commands else {system.space.letters[0]})
    return tuple(i for i, letter in enumerate(system.space.letters) if letter not in still)


def _sampler(model: Model) -> Controller | None:
    record = model.system.perturbation
    return record.control if record is not None and record.sampled else None


def whole_samples(model: Model, dt: Any) -> Any:
    """The step dt, rounded to a fraction of the time between samples if it is one to 9 digits: it must not drift.

    dt may be a value of JAX.
    """
    control = _sampler(model)
    if control is None:
        return dt
    count = round(steps := control.every / dt)
    meant = _is_fraction(steps) & (abs(steps - count) <= WHOLE_SAMPLES * count)
    return dt + meant * (control.every / (count + (count == 0)) - dt)  # exact: the two are nearly equal


def require_whole_samples(model: Model, dt: float, start: float = 0.0, name: str = "t_start") -> None:
    """Raises `InputError` for steps that go back, or miss a sample; `name` of the start."""
    control = _sampler(model)
    if control is None:
        return
    every, dt = control.every * control.time, dt * control.time
    if dt < 0:
        raise InputError(f"dt: expected a positive step of a body whose controller acts on the past, got {dt:g} s.")
    steps, count = every / dt, start * control.time / dt
    if _is_fraction(steps):
        raise InputError(
            f"dt: expected a step that divides the time between two samples of the controller, every = {every:g} s, "
            f"got dt = {dt:g} s. Usual cause: a t_end that is not a multiple of dt, for which steps are a little "
            f"shorter. Use dt = {every / max(1, round(steps))!r} s."
        )
    if _is_fraction(count):
        raise InputError(
            f"{name}: expected a multiple of dt = {dt:g} s, at which the controller is sampled, got "
            f"{start * control.time:.15g}."
        )


def samples_missed(model: Model, dt: Any, start: Any, end: Any) -> Any:
    """True for steps of dt that go back, or pass a sample between start and end; values may be arrays of JAX."""
    control = _sampler(model)
    if control is None:
        return False
    then = (start / control.every * (1 + ROUNDING)) // 1 + 1  # the first sample after the start
    passed = then < end / control.every * (1 - ROUNDING)
    return (dt < 0) | passed & (_is_fraction(control.every / dt) | _is_fraction(start / dt))


def _is_fraction(x: Any) -> Any:
    return abs(x - round(x)) > ROUNDING * abs(x)


# -- a sample ----------------------------------------------------------------------------------------------


def sampled(body: Body, q: Array) -> tuple[State, Any]:
    """The state after a sample, and the work of an impulse; q the orientation as a quaternion."""
    system, constants, axes = body.system, body.constants, body.axes
    control, new = _control(system), dict(zip(system.space.letters, body.state, strict=True))
    sensors, generator = _seen(body, q)
    inputs, shapes, tape = (
        {**sensors, **{k: new[k] for k in control.memory}},
        {**SENSORS, **control.memory},
        list[Any](),
    )
    arguments = {
        name: traced(tape, inputs[name], len(shapes[name]))
        if name in inputs
        else traced(tape, constants[name], axes[name])
        for name in control.arguments
    }
    result = called(control.law, arguments, control.commands, control.memory, every=True)
    results = {name: kicks.values_of(value, body) for name, value in result.items()}
    most = {name: constants[LIMIT + name] for name in control.limits}
    commands = [_clipped(results[k], -most[k], most[k]) if k in most else results[k] for k in control.commands]
    new |= {name: results[name] for name in control.memory}
    if control.delay:
        size = sum(control.commands.values())
        queue = joined(new[QUEUE], *(value + 0 * new[QUEUE][..., :1] for value in commands))
        new[QUEUE], first = queue[..., size:], queue[..., :size]
        ends = np.cumsum([*control.commands.values()]).tolist()
        commands = [first[..., end - k : end] for end, k in zip(ends, control.commands.values(), strict=True)]
    applied = dict(zip(control.commands, commands, strict=True))
    if WHEEL_TORQUE in applied and WHEEL_LIMIT in constants:
        h, largest, steady = new[WHEELS], constants[WHEEL_LIMIT], constants[WHEEL_TORQUE]
        seconds = control.every * control.time  # in which the motors do not leave these limits
        bounds = (-largest - h) / seconds - steady, (largest - h) / seconds - steady
        applied[WHEEL_TORQUE] = _clipped(applied[WHEEL_TORQUE], *bounds)
    new |= {HELD + name: value for name, value in applied.items()}
    if generator is not None:
        new[GENERATOR] = generator
    work: Any = 0
    if "impulse" in control.commands:
        J = algebra.act(kicks.from_body(body), new[HELD + "impulse"]) / control.momentum
        M, J = body.state[0], algebra.hat(J)
        new[system.space.letters[0]] = M + J
        work = algebra.pairing(J, kicks.velocity(body._replace(state=(M + J / 2, *body.state[1:]))))
    return tuple(new.values()), work


def _control(system: System) -> Controller:
    control = kicks.perturbation_of(system).control
    if control is None:
        raise TypeError(f"{system.name} has no control")
    return control


def _seen(body: Body, q: Array) -> tuple[dict[str, Any], Array | None]:
    """Values of the sensors by name, and the generator after the draws of the noise."""
    control, constants = _control(body.system), body.constants
    state = dict(zip(body.system.space.letters, body.state, strict=True))
    R, inside = kicks.to_body(constants), kicks.from_body(body).mT
    fields = {} if body.field is None else {"field": body.field}
    if not FIELDS.keys() & control.arguments <= fields.keys():
        fields = kicks.surroundings(body) | fields
    seen: dict[str, Any] = {
        "rates": algebra.act(inside, algebra.axial(kicks.velocity(body))) / control.time,
        "attitude": algebra.quaternion_product(q, algebra.inverse_turn(constants[BODY_AXES])),
        "time": body.t * control.time,
        WHEELS: state.get(WHEELS),
    }
    for name, value in fields.items():  # vectors in space
        seen[name] = algebra.act(R, algebra.act(body.g.mT, value)) if SENSORS[name] else value  # type: ignore[union-attr]
    if not control.noise:
        return seen, None
    drawn, generator = normals(state[GENERATOR], 3 * len(control.noise))
    for i, name in enumerate(control.noise):
        names = [word + name for word in (BIAS, DEVIATION)]
        bias, deviation = (
            constants[letter] if body.axes[letter] else algebra.vec(constants[letter]) for letter in names
        )
        off = bias + deviation * drawn[..., 3 * i : 3 * i + 3]
        turned = name == "attitude"
        seen[name] = algebra.quaternion_product(seen[name], algebra.turn(off)) if turned else seen[name] + off
    return seen, generator


def called(
    law: Any, arguments: Mapping[str, Any], commands: Mapping[str, int], memory: Mapping[str, Any], every: bool = False
) -> dict[str, Array]:
    """Results of the law, as arrays of objects: memory, and some commands, or every one.  Raises `InputError`."""
    result = run(law, **arguments)
    shapes = {**{name: (size,) for name, size in commands.items()}, **memory}
    needed = shapes if every else memory
    if not isinstance(result, Mapping) or not set(needed) <= set(result) <= set(shapes):
        lacking = [name for name in needed if name not in result] if isinstance(result, Mapping) else []
        raise InputError(
            f"law: expected a dict of commands ({', '.join(commands)}) and of the complete memory "
            f"({', '.join(memory) or 'none'}), got {shown([*result] if isinstance(result, Mapping) else result)}"
            f"{f' without {lacking[0]}' if lacking else ''}. Memory that does not change is returned too."
        )
    out = {name: np.asarray(result[name], dtype=object) for name in shapes if name in result}
    for name, value in out.items():
        if value.shape != shapes[name]:
            raise InputError(
                f"law: expected {name} of shape {shapes[name]}, got {value.shape}. Commands have three entries or one "
                "for each wheel, and memory keeps the shape that it has at the start."
            )
    return out


def _clipped(x: Array, least: Array, most: Array) -> Array:
    """The entries of x between the bounds."""
    x = algebra.where_less(x, least, least, x)
    return algebra.where_less(most, x, most, x)


# -- the system ------------------------------------------------------------------------------------------------

OF_WHEELS = (
    Parameter(BODY_AXES, "quaternion", "of the axes of the state along the body axes"),
    Parameter(WHEEL_AXES, "array", "of the wheels, along the body axes, one a row", rank=2),
    Parameter(WHEEL_TORQUE, "array", "steady torque of the motor on each wheel, N m", rank=1),
    Parameter(WHEEL_LIMIT, "array", "largest momentum of each wheel, N m s", rank=1),
)


def with_wheels(model: Model, values: Mapping[str, Any]) -> Model:
    """The model with wheels and no law, with these values of `OF_WHEELS`.  Raises `InputError`."""
    axes = algebra.floats(values.get(WHEEL_AXES, 0.0))
    if axes.ndim < 2 or not {BODY_AXES, WHEEL_TORQUE} <= values.keys():
        raise InputError(f"parameters: expected the axes and torques of wheels, got {shown(sorted(values))}.")
    return controlled(model, Controller(wheels=axes.shape[-2]), [], values)


def controlled(
    model: Model, control: Controller, parameters: Sequence[Parameter], of_wheels: Mapping[str, Any]
) -> Model:
    """The perturbed body with a controller, in the units of the body.

    parameters   that the law adds, with their values;  of_wheels: values of `OF_WHEELS`
    """
    frame = model.body_frame
    parameters = [*parameters, *(replace(p, default=of_wheels[p.letter]) for p in OF_WHEELS if p.letter in of_wheels)]
    if frame:
        control = replace(control, time=frame.time_unit, momentum=frame.size(model.system.space.letters[0]))
        units = {HELD + name: (unit, 1.0) for name, unit in COMMANDS.items() if name in control.commands}
        units |= {WHEELS: ("N m s", 1.0)} if control.wheels else {}
        units |= dict.fromkeys(("work", "balance"), frame.units["energy"]) if "energy" in frame.units else {}
        frame = replace(frame, units={**frame.units, **units})
    return Model(_record(model, Portable(control.law), replace(control, law=None), parameters), {}, frame)


def _record(model: Model, law: Portable, control: Controller, parameters: Sequence[Parameter]) -> System:
    system = model.system
    if control.wheels and (system.perturbation.base if system.perturbation else system).closed_form.moments is None:
        raise InputError(
            f"wheels: expected a free body or a satellite, whose motion with wheels is known, got {system.name}."
        )
    space, kinds = system.space, {letter: kind for letter, (kind, _) in components(control).items()}
    count = algebra.coordinate_count([*kinds.values()], 3)

    def tensor(*state: Array) -> Array:
        inner = space.tensor(*state[: len(space.letters)])
        return np.pad(inner, [(0, 0)] * (inner.ndim - 2) + [(0, count)] * 2)

    wide = PhaseSpace(
        name=f"{space.name} x R^{count}",
        components=(*space.components, *kinds.items()),
        tensor=tensor,
        casimirs=None,
        sign=space.sign,
        carried=space.carried,
    )
    every = f"controlled every {control.every * control.time:g} s"
    kind, how = ("controlled", every) if law.function else ("with wheels", "wheels, whose motors have steady torques")
    kept = ("source", "scaling", "derive", "body_frame", "n")
    reads = {"light", "density"} & {*control.arguments}
    axes = {**model.axes, **{p.letter: np.ndim(p.default) if p.axes is None else p.axes for p in parameters}}
    record = perturbed_record(
        replace(system.perturbation or Perturbation(system), control=replace(control, law=law.function)),
        axes,
        **{name: getattr(system, name) for name in kept},
        checks=replace(system.checks, idle=None) if reads else system.checks,
        name=f"controlled-{system.name}" if law.function else f"{system.name}{WITH_WHEELS}",
        title=f"{system.title}, {kind}",
        equations=f"{system.equations}; {how}",
        space=wide,
        integrals={},
        parameters=(*(replace(p, default=model.params[p.letter]) for p in system.parameters), *parameters),
    )
    return record.remade_by(_record, model, law, control, parameters)


# -- the field between samples ---------------------------------------------------------------------

WINDOW, SPAN = "_window", "_span"
NODES, ALWAYS = 6, -1.0
WINDOW_SIZE = 1 + 3 * NODES
WINDOW_KIND = f"R^{WINDOW_SIZE}"
PLACES = np.arange(NODES) / (NODES - 1) - 0.5
POWERS = np.linalg.inv(np.vander(PLACES, increasing=True))  # coefficients of the values at the nodes
LONGEST_SAMPLE, SAMPLES = 10.0, 4  # s between two samples; of them in a window
STEPS_OF_TABLE = 2  # in a window at most


def span_of(model: Model) -> Any:
    """Length of a window, in the unit of time of the model; None if the field is not needed, or seldom sampled."""
    record = perturbation_of(model.system)
    control = record.control
    if control is None or record.smooth is None or record.environment is None:
        return None
    if "field" not in control.arguments and "dipole" not in control.commands:
        return None
    span, least = call(record.smooth, (), model.constants), SAMPLES * control.every
    for name in record.environment.tables:
        rate = model.constants[name][..., 3]  # of a handle, 1/step; 0 without a table
        span = np.minimum(span, STEPS_OF_TABLE / np.where(rate > 0, rate, STEPS_OF_TABLE / span))
        if (STEPS_OF_TABLE < least * rate).any():
            return None
    return None if control.every * control.time > LONGEST_SAMPLE else np.maximum(span, least)


def renewed_window(window: Array, body: Body) -> Array:
    """The window (..., WINDOW_SIZE) of the time of a body."""
    span = body.constants[SPAN]
    w = algebra.nearest(body.t / span)
    moved = window[..., 0] - w - 0.5

    def computed() -> Array:
        def shifted(x: Array) -> tuple[tuple[Array], Any]:
            place = x[..., 0]
            at_node = body._replace(t=(w + place) * span)
            B = kicks.field_of(at_node)
            return (joined(stack([place + 1 / (NODES - 1)]), x[..., 4:], B),), place * place

        start = joined(stack([0 * window[..., 0] - 0.5]), window[..., 1:])  # all of which leaves
        (x,), _ = repeat(shifted, (start,), ALWAYS, NODES, (WINDOW_KIND,))
        values = [x[..., 1 + 3 * i : 4 + 3 * i] for i in range(NODES)]
        powers = [sum(row[i] * values[i] for i in range(NODES)) for row in POWERS]
        return joined(stack([w + 0.5]), *powers)

    return algebra.if_positive(moved * moved - 0.1, computed, window)


def field_in_window(window: Array, t: Any, constants: Constants) -> Array:
    """The field (..., 3) in space at the time t."""
    s: Any = algebra.vec(t / constants[SPAN] - (window[..., 0] - 0.5))
    out = window[..., 1 + 3 * (NODES - 1) :]
    for k in range(NODES - 2, -1, -1):
        out = window[..., 1 + 3 * k : 4 + 3 * k] + s * out
    return out
