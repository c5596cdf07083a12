"""Controllers of bodies: a law that is compiled with the steps, reaction wheels, laws that are known.

The laws are B-dot, damping by magnets, pointing by wheels and at the Sun, hysteresis rods and eddy currents.  Vectors
are along the body axes, B is the field, b = B/|B|, w the angular velocity of the body, h the momentum of its wheels.  A
dipole m = B x T/|B|^2 exerts T - b (b.T), the part of a torque T that magnets can exert.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import exp, traced
from kreisel.algebra.random import GENERATOR, streams
from kreisel.bodies.orbit import arcsine
from kreisel.errors import InputError, doubt, explained, hint, shown
from kreisel.forces import control as sampling
from kreisel.forces.control import BIAS, COMMANDS, DEVIATION, LIMIT, QUEUE, SENSORS, WHEEL_LIMIT
from kreisel.forces.kicks import BODY_AXES, HELD, WHEEL_AXES, WHEEL_TORQUE, WHEELS, perturbation_of
from kreisel.method.scheme import BALANCE, ORIENTATION, WORK
from kreisel.physical.measures import (
    attitude_quaternion,
    convert_fields,
    direction,
    finite_floats,
    si_number,
    si_numbers,
)
from kreisel.record.calling import arguments_of
from kreisel.record.contract import Parameter
from kreisel.record.model import Model
from kreisel.record.perturbation import FIELDS, TIME, Controller
from kreisel.record.values import CLOSE, is_vector, shape_of
from kreisel.runs.in_si import ADDED, MEANINGS

OF_RUNS = {*"agmMP", *MEANINGS, *ADDED, "energy", WORK, BALANCE, QUEUE, GENERATOR}  # variables, and letters of states
NOISY = {"rates": "rad/s", "attitude": "rad", **{name: field.unit for name, field in FIELDS.items() if field.shape}}
ORBIT = "orbit"
OPPOSITE = 1e-24  # |axis + sun|^2 below which the sum is rounding
MU_0 = 1.25663706127e-6  # N/A^2, CODATA 2022


@explained
@dataclass(frozen=True, eq=False)
class Wheels:
    """Reaction wheels, which with the body are a gyrostat, in closed form.

    axes      (k, 3), of length 1, along the body axes
    momenta   (k,) or one, N m s, of the wheels about their axes at t = 0
    torque    (k,) or one, N m, of the motors: steady, on the wheels, in addition to the torques of a controller
    limit     (k,) or one, N m s: the largest momentum, beyond which motors do not go if a law commands wheel_torque
    """

    axes: Any
    momenta: Any = 0.0
    torque: Any = 0.0
    limit: Any = None

    def __post_init__(self) -> None:
        axes = algebra.floats(self.axes)
        if axes.ndim != 2 or axes.shape[1:] != (3,) or not (abs((axes * axes).sum(-1) - 1) < 1e-9).all():
            raise InputError(
                f"axes: expected rows of 3 values and length 1, one for each wheel, got {shown(self.axes)}."
            )
        object.__setattr__(self, "axes", axes)
        for name, unit in {"momenta": "N m s", "torque": "N m", "limit": "N m s"}.items():
            value = getattr(self, name)
            if value is not None:
                entries = si_numbers(value, unit, name, ((), (len(axes),)))
                object.__setattr__(self, name, np.broadcast_to(entries, (len(axes),)))
        if self.limit is not None and not (self.limit >= abs(self.momenta)).all():
            raise InputError(f"limit: expected at least |momenta|, got {shown(self.limit.tolist())}.")


@explained
@dataclass(frozen=True, eq=False)
class Control:
    """A law in the steps of a body: called at samples, its commands held from one to the next.

        def law(field, before, *, gain):
            return {"dipole": -gain * (field - before), "before": field}

        kr.Control(law, every="1 s", memory={"before": (0, 0, 0)}, parameters={"gain": 4e3})

    law        a function of sensors, memory and parameters by name, which returns a dict of commands and new memory.
               Sensors, along the body axes: rates, attitude (w, x, y, z), field (T), sun (of length 1), light (0 in the
               shadow), density (of the air), time, wheels (their momenta), position, velocity.  Commands: dipole (A
               m^2), torque (N m), wheel_torque (N m, of the motor on each wheel), impulse (N m s, at once)
    every      s between two samples: a multiple of dt
    memory     memory of the law, with the values at the start: scalars, or arrays (k,)
    parameters its further arguments: scalars, vectors (3,), or either with an axis of lanes in front
    noise      of sensors: the standard deviation of each entry in SI, or {"std": ..., "bias": ...}
    seed       of the noise: every lane has a separate stream, the same for all blocks and workers
    delay      samples until a command is applied
    limits     the largest size of each entry of a command, in SI

    The law is run once, on values that record the operations, and has no other effects.  A run has memory and commands
    as variables: those just before the sample of the row.  Raises `InputError` for anything but such a law.
    """

    law: Callable[..., Any]
    every: Any = 1.0
    memory: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    delay: int = 0
    limits: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not callable(self.law):
            raise InputError(f"law: expected a function of sensors and memory, got {shown(self.law)}.")
        convert_fields(self, positive=True, every="s")
        for name, allowed in (("memory", None), ("parameters", None), ("noise", NOISY), ("limits", COMMANDS)):
            values = getattr(self, name)
            good = isinstance(values, Mapping) and all(isinstance(key, str) and key.isidentifier() for key in values)
            wrong = [key for key in values if allowed is not None and key not in allowed] if good else []
            if not good or wrong:
                names = "user-defined names" if allowed is None else ", ".join(allowed)
                near = hint(wrong[0], allowed) if wrong and allowed else ""
                raise InputError(
                    f"{name}: expected a dict with {names}, got {shown(wrong[0] if wrong else values)}.{near}"
                )
        if taken := [name for name in self.memory if name in OF_RUNS or name.startswith(("_", HELD))]:
            raise InputError(f"memory: expected names that no variable of a run has, got {shown(taken[0])}. Rename it.")
        memory = {name: finite_floats(value, "1", name) for name, value in self.memory.items()}
        if any(value.ndim > 1 or not value.size for value in memory.values()):
            raise InputError(f"memory: expected values or arrays (k,), got {shown(dict(self.memory))}.")
        noise = {name: _noise(name, value) for name, value in self.noise.items()}
        limits = {name: finite_floats(value, COMMANDS[name], f"limit of {name}") for name, value in self.limits.items()}
        if any((value < 0).any() for value in limits.values()):
            raise InputError(f"limits: expected sizes >= 0, got {shown(dict(self.limits))}.")
        vars(self).update(memory=memory, noise=noise, limits=limits)
        for name in ("seed", "delay"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
                raise InputError(f"{name}: expected an integer >= 0, got {shown(value)}.")

    def on(self, model: Model, wheels: Wheels | None, of_wheels: Mapping[str, Any]) -> Model:
        """The model with this controller, in the units of its body.  Raises `InputError`."""
        count = 0 if wheels is None else len(wheels.axes)
        parameters = [_parameter(name, value, "of the law") for name, value in self.parameters.items()]
        used = {*model.constants, *model.system.space.letters, *SENSORS, ORIENTATION, TIME}
        taken = (used | {*self.memory}) & {*self.parameters} | used & {*self.memory}
        if taken:
            raise InputError(f"Control: expected names that neither sensors nor the body have, got {', '.join(taken)}.")
        record = model.system.perturbation
        placed = record is not None and record.environment is not None  # a body on an orbit, in a field
        arguments = self._arguments(count, placed)
        shapes = {**SENSORS, WHEELS: (count,), **{name: value.shape for name, value in self.memory.items()}}
        shapes |= {p.letter: (3,) if p.kind == "vector" else () for p in parameters}
        lengths = {name: count if name == WHEEL_TORQUE else 3 for name in COMMANDS}
        commands = self._tried(arguments, shapes, {k: v for k, v in lengths.items() if v and (placed or k != "dipole")})
        for name, values in self.noise.items():
            if name not in arguments:
                raise InputError(f"noise: expected sensors of the law, {', '.join(arguments)}, got {shown(name)}.")
            for word, letter, meaning in (("std", DEVIATION, "standard deviation"), ("bias", BIAS, "bias")):
                about = f"{meaning} of the sensor {name}, {NOISY[name]}"
                parameters.append(_parameter(letter + name, values[word], about))
        for name, value in self.limits.items():
            if name not in commands or value.shape not in ((), (commands[name],)):
                raise InputError(
                    f"limits: expected a number or one for each entry of {', '.join(commands) or 'a command'}, got "
                    f"{name}: {shown(value.tolist())}."
                )
            most = np.broadcast_to(value, commands[name])
            parameters.append(Parameter(LIMIT + name, "array", f"largest {name}", None, most, rank=1))
        control = Controller(
            law=self.law,
            arguments=arguments,
            every=self.every / model.body_frame.time_unit,
            memory={name: shapes[name] for name in self.memory},
            commands=commands,
            wheels=count,
            delay=int(self.delay),
            noise=tuple(self.noise),
            limits=tuple(self.limits),
        )
        return sampling.controlled(model, control, parameters, of_wheels)

    def _arguments(self, wheels: int, placed: bool) -> tuple[str, ...]:
        """The arguments of the law by name.  Raises `InputError` for others than it may have."""
        sensors = [name for name in SENSORS if (wheels or name != WHEELS) and (placed or name not in FIELDS)]
        remedy = "Memory of the law is in memory={...}, other values are in parameters={...}."
        return arguments_of(self.law, [*sensors, *self.memory, *self.parameters], "law", remedy)

    def _called(self, recorded: Mapping[str, Any], lengths: dict[str, int], memory: Mapping[str, Any]) -> Any:
        try:
            return sampling.called(self.law, recorded, lengths, memory)
        except InputError as error:
            tables = [name for name, value in self.parameters.items() if len(shape_of(value)) == 2]
            if not tables:
                raise
            lanes = f"The parameter {tables[0]} {shape_of(self.parameters[tables[0]])} has a vector for each lane"
            raise InputError(
                f"{error} {lanes}: write a matrix into the law, or give its rows as parameters."
            ) from error

    def _tried(self, arguments: Sequence[str], shapes: Mapping[str, Any], lengths: dict[str, int]) -> dict[str, int]:
        """The lengths of the commands that the law returns, run twice on random values.  Raises `InputError`."""
        rng, runs = np.random.default_rng(0), []
        values = {name: np.asarray(rng.normal(size=shapes[name])) for name in arguments}
        for _ in range(2):
            tape: list[Any] = []
            recorded = {name: traced(tape, value, value.ndim) for name, value in values.items()}
            with np.errstate(all="ignore"):
                result = self._called(recorded, lengths, {name: shapes[name] for name in self.memory})
            runs.append({k: [float(getattr(v, "value", v)) for v in value.flat] for k, value in result.items()})
        if any(runs[0][name] != value for name, value in runs[1].items()):
            raise InputError(
                "law: expected the same result from the same values, got two. Usual cause: random values, or a list "
                "or a global that the law changes. Noise is noise={...}, values kept between samples are memory={...}."
            )
        return {name: lengths[name] for name in COMMANDS if name in runs[0]}


def controlled_by(model: Model, control: Control | None, wheels: Wheels | None) -> Model:
    """The model with wheels and a controller.  Raises `InputError`."""
    of_wheels = {BODY_AXES: model.body_frame.quaternion}
    if wheels is not None:
        of_wheels |= {WHEEL_AXES: wheels.axes, WHEEL_TORQUE: wheels.torque}
        of_wheels |= {} if wheels.limit is None else {WHEEL_LIMIT: wheels.limit}
    model = sampling.with_wheels(model, of_wheels) if control is None else control.on(model, wheels, of_wheels)
    commands = cast("Controller", perturbation_of(model.system).control).commands
    if wheels is not None and wheels.limit is not None and wheels.torque.any() and WHEEL_TORQUE not in commands:
        with np.errstate(divide="ignore"):
            passed = ((wheels.limit - np.sign(wheels.torque) * wheels.momenta) / abs(wheels.torque)).min()
        doubt(
            f"wheels: the steady torque accelerates a wheel beyond its limit after {passed:.4g} s: motors stop at it "
            "only if a law commands wheel_torque. Give such a law; its command may be 0."
        )
    return model


def at_the_start(model: Model, control: Control | None, wheels: Wheels | None, lanes: int) -> dict[str, Array]:
    """The components of a state in addition to the body's: 0, the momenta of the wheels, the memory of the law."""
    components = (
        sampling.components(cast("Controller", perturbation_of(model.system).control)) if control or wheels else {}
    )
    out = {letter: np.zeros(() if kind == "scalar" else int(kind[2:])) for letter, (kind, _) in components.items()}
    if control is not None and GENERATOR in out:
        out[GENERATOR] = streams(int(control.seed), lanes) if lanes > 1 else streams(int(control.seed), 1)[0]
    return out | ({} if wheels is None else {WHEELS: wheels.momenta}) | ({} if control is None else {**control.memory})


def _parameter(name: str, value: Any, meaning: str) -> Parameter:
    kind = "vector" if is_vector(value, 3) and len(shape_of(value)) < 3 else "scalar"
    return Parameter(name, kind, meaning, None, value)


def _noise(name: str, value: Any) -> dict[str, Array]:
    """The standard deviation and the bias of a sensor.  Raises `InputError`."""
    parts = {"std": value, "bias": 0.0} if not isinstance(value, Mapping) else {"std": 0.0, "bias": 0.0, **value}
    if set(parts) != {"std", "bias"}:
        raise InputError(f"noise: expected a standard deviation or {{'std': ..., 'bias': ...}}, got {shown(value)}.")
    std, bias = (finite_floats(parts[word], NOISY[name], f"{word} of {name}") for word in ("std", "bias"))
    if (std < 0).any():
        raise InputError(f"noise: expected a standard deviation >= 0 for {name}, got {shown(std.tolist())}.")
    return {"std": std, "bias": bias}


# -- laws that are known ---------------------------------------------------------------------------


def _along_rate(field: Array, before: Array, begun: Array, *, gain: Any, every: Any) -> dict[str, Array]:
    square = algebra.dot(field, field)
    return {"dipole": -gain * begun / every * (field - before) / square, "before": field, "begun": begun * 0 + 1.0}


@explained
def bdot(gain: Any, every: Any = 1.0, **options: Any) -> Control:
    """B-dot: the dipole -gain (dB/dt)/|B|^2, which brakes a tumbling satellite; only a magnetometer is needed.

    gain     N m s: the torque is about -gain (w - b (b.w)).  Advised: 2 n (1 + sin i) I, n the mean motion, i the
             inclination of the orbit to the magnetic equator, I the least moment of inertia
    every    s, between two samples, whose difference is dB/dt; the satellite rotates by less than pi in between
    options  arguments of `kr.Control`: limits={"dipole": 0.2}, noise={"field": 1e-7}

    [Stickler, Alfriend, J. Spacecraft Rockets 13 (1976) 282; gain: Avanzini, Giulietti, J. Guid. Control Dyn. 35
    (2012) 1326; Markley, Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, 2014, section 7.5]
    """
    parameters = _numbers(gain=(gain, "N m s"), every=(every, "s"))
    return Control(_along_rate, parameters["every"], {"before": np.zeros(3), "begun": 0.0}, parameters, **options)


def _against_rates(field: Array, rates: Array, *, gain: Any) -> dict[str, Array]:
    return {"dipole": gain * algebra.cross(rates, field) / algebra.dot(field, field)}


@explained
def magnetic_damping(gain: Any, every: Any = 1.0, **options: Any) -> Control:
    """The dipole gain w x B/|B|^2, from measured rates: the torque -gain (w - b (b.w)); gain and options as for `bdot`.

    [Avanzini, Giulietti 2012]
    """
    return Control(_against_rates, every, {}, {"gain": si_number(gain, "N m s", "gain")}, **options)


@explained
def pointing(
    wheels: Wheels,
    stiffness: Any,
    damping: Any,
    *,
    target: Any = ORBIT,
    unloading: Any = 0.0,
    every: Any = 1.0,
    **options: Any,
) -> Control:
    """Wheels that hold an attitude: the torque -stiffness a - damping (w - w_0), with a the rotation from the target.

    The vector a is along the axis of the rotation, by the shorter way; for an angle A its length is 2 sin(A/2).

    wheels     `Wheels` of the satellite, at least three; each has its share of the torque by the pseudoinverse
    stiffness, damping   N m/rad and N m s: I f^2 and 2 z I f for a frequency f and a damping ratio z
    target     "orbit": the body axes x ahead, y against the normal of the orbit, z down; or an attitude in space,
               (w, x, y, z)
    unloading  1/s: the rate at which magnets remove momentum from the wheels, the dipole unloading h x B/|B|^2
    options    arguments of `kr.Control`

    [Wie, Weiss, Arapostathis, J. Guid. Control Dyn. 12 (1989) 375; Markley, Crassidis 2014, sections 7.2 and 7.5]
    """
    if not isinstance(wheels, Wheels) or np.linalg.matrix_rank(wheels.axes) < 3:
        raise InputError(f"wheels: expected Wheels with axes in all directions of space, got {shown(wheels)}.")
    if isinstance(target, str) and target != ORBIT:
        raise InputError(f"target: expected 'orbit' or an attitude (w, x, y, z), got {shown(target)}.")
    aim = None if isinstance(target, str) else attitude_quaternion(target, "target")
    parameters = _numbers(stiffness=(stiffness, "N m/rad"), damping=(damping, "N m s"), unloading=(unloading, "1/s"))
    return Control(_Pointing(wheels.axes, aim), every, {}, parameters, **options)


def _numbers(**values: tuple[Any, str]) -> dict[str, float]:
    return {name: si_number(value, unit, name) for name, (value, unit) in values.items()}


@dataclass(frozen=True, eq=False)
class _Pointing:
    """axes of the wheels (k, 3); aim: an attitude in space, None for the frame of the orbit."""

    axes: Array
    aim: Array | None

    def __call__(
        self,
        rates: Any,
        attitude: Any,
        position: Any,
        velocity: Any,
        wheels: Any,
        field: Any,
        *,
        stiffness: Any,
        damping: Any,
        unloading: Any,
    ) -> dict[str, Array]:
        if self.aim is None:
            turn, off = _from_orbit(position, velocity)
        else:
            turn, off = 0 * rates, algebra.quaternion_product(algebra.inverse_turn(self.aim), attitude)
        error = algebra.where_less(off[0], 0, -2.0, 2.0) * off[1:]
        torque = -stiffness * error - damping * (rates - turn)
        h = wheels @ self.axes
        dipole = unloading * algebra.cross(h, field) / algebra.dot(field, field)
        return {"wheel_torque": -np.linalg.pinv(self.axes.T) @ torque, "dipole": dipole}


def _from_orbit(r: Array, v: Array) -> tuple[Array, Array]:
    """The angular velocity of the frame of the orbit, and the quaternion q of the body from it, along the body axes.

    q is the longest row of 4 q q^T, which is linear in the matrix: not small for any angle.  [Shepperd 1978]
    """
    w = algebra.cross(r, v) / algebra.dot(r, r)
    down, across = -algebra.unit(r), -algebra.unit(w)
    axes, units = np.stack([algebra.cross(across, down), across, down]), np.eye(3)
    trace = axes[0, 0] + axes[1, 1] + axes[2, 2]
    d = sum(algebra.cross(to, axis) for to, axis in zip(axes, units, strict=True))
    K = axes + axes.T + (1 - trace) * units
    rows = [algebra.quaternion(1 + trace, d), *(algebra.quaternion(d[i], K[i]) for i in range(3))]
    return w, algebra.unit(reduce(lambda p, q: np.where((p * p).sum() < (q * q).sum(), q, p), rows))


def _towards_sun(
    rates: Array, sun: Array, light: Any, *, axis: Array, across: Array, stiffness: Any, damping: Any
) -> dict[str, Array]:
    between = axis + sun  # zero, or rounding, if they are opposite
    between = algebra.unit(np.where((between * between).sum() < OPPOSITE, across, between))
    return {"torque": light * 2 * stiffness * algebra.cross(axis, between) - damping * rates}


@explained
def sun_pointing(axis: Any, stiffness: Any, damping: Any, every: Any = 1.0, **options: Any) -> Control:
    """The torque stiffness a - damping w: a body axis points at the Sun; in the shadow it keeps its direction.

    The vector a is along axis x sun; for an angle A between them its length is 2 sin(A/2).  If they are opposite, a is
    along an axis perpendicular to them.

    stiffness, damping   N m/rad and N m s.  [Markley, Crassidis 2014, section 7.2]
    """
    parameters: dict[str, Any] = _numbers(stiffness=(stiffness, "N m/rad"), damping=(damping, "N m s"))
    parameters["axis"] = unit = direction(axis, "axis")
    parameters["across"] = np.cross(unit, np.eye(3)[abs(unit).argmin()])
    return Control(_towards_sun, every, {}, parameters, **options)


@explained
def hysteresis_rods(
    axes: Any, volume: Any, coercivity: Any, remanence: Any, saturation: Any, every: Any = 1.0
) -> Control:
    """Rods of soft magnetic material, which damp a satellite passively: dipoles V B/mu_0 along their axes.

        dB/dH = (2 k B_s/pi) cos^2(pi B/(2 B_s)) u^2,  u = (H - y + H_c)/(2 H_c),  k H_c = tan(pi B_r/(2 B_s))

    if H rises, with y = tan(pi B/(2 B_s))/k; if it falls, H and y have the other sign.  u is the place between the
    sides of the loop, y = H + H_c and H - H_c.  Between two samples u = tanh(H/(2 H_c) + constant), exactly.

    axes       (k, 3), directions along the body axes
    volume     V, m^3;  coercivity H_c, A/m;  remanence B_r < saturation B_s, T, of the rods, not of their material:
               each one value or (k,)
    every      s, between two samples, in which H changes monotonically; the rods begin in the middle of their loops

    The field of other magnets at the rods is left out.  A run has y as `inner`.  [Flatley, Henretty, Flight Mechanics
    Estimation Theory Symposium, NASA CP-3299, 1995, 405]
    """
    directions = si_numbers(axes, "1", "axes")
    directions = np.atleast_2d(directions) / np.linalg.norm(np.atleast_2d(directions), axis=-1, keepdims=True)
    count = len(directions)
    names = ("volume", "m^3"), ("coercivity", "A/m"), ("remanence", "T"), ("saturation", "T")
    pairs = zip((volume, coercivity, remanence, saturation), names, strict=True)
    sizes = {k: si_numbers(value, unit, k, ((), (count,))) + np.zeros(count) for value, (k, unit) in pairs}
    for name, value in {**sizes, "saturation - remanence": sizes["saturation"] - sizes["remanence"]}.items():
        if not (value > 0).all() or not np.isfinite(directions).all():
            raise InputError(f"hysteresis_rods: expected {name} > 0 and axes with directions, got {shown(value)}.")
    memory = {"inner": np.zeros(count), "before": np.zeros(count), "begun": 0.0}
    return Control(_Rods(directions, *sizes.values()), every, memory)


@dataclass(frozen=True, eq=False)
class _Rods:
    """Rods: axes (k, 3), and (k,) of each quantity."""

    axes: Array
    volume: Array
    coercivity: Array
    remanence: Array
    saturation: Array

    def __call__(self, field: Array, inner: Array, before: Array, begun: Any) -> dict[str, Any]:
        H, Hc, Bs = self.axes @ field / MU_0, self.coercivity, self.saturation
        before, y = (begun * value + (1 - begun) * H for value in (before, inner))
        s = algebra.where_less(H - before, 0 * H, -1.0 + 0 * H, 1.0 + 0 * H)
        u = (s * (before - y) + Hc) / (2 * Hc)
        E = exp(-s * (H - before) / Hc)
        T = (1 - E) / (1 + E)
        y = H - s * Hc * (2 * (u + T) / (1 + u * T) - 1)
        x = np.tan(np.pi * self.remanence / (2 * Bs)) / Hc * y
        r = algebra.sqrt(1 + x * x)
        B = 2 * Bs / np.pi * arcsine(x / r, 1 / r)
        return {"dipole": (self.volume * B / MU_0) @ self.axes, "inner": y, "before": H, "begun": begun * 0 + 1.0}


@explained
@dataclass(frozen=True, eq=False)
class EddyCurrents:
    """The torque of eddy currents in a conducting body, `torque=` of a `Satellite`: (T (Omega x B - B_rate)) x B.

    tensor     T, S m^4, (3, 3) along the body axes, its diagonal, or one value; B_rate is the rate of the field along
               the orbit, in space

    [N. Ortiz Gomez, S. J. I. Walker, Acta Astronautica 114 (2015) 34; L. B. M. Sagnieres, thesis, McGill University,
    2018, equation 2.20]
    """

    tensor: Any

    def __post_init__(self) -> None:
        value = si_numbers(self.tensor, "S m^4", "tensor", ((), (3,), (3, 3)))
        tensor = value * np.eye(3) if value.ndim < 2 else value
        if abs(tensor - tensor.T).max() > CLOSE * abs(tensor).max() or np.linalg.eigvalsh(tensor)[0] < 0:
            raise InputError(f"tensor: expected a symmetric matrix with eigenvalues >= 0, got {shown(self.tensor)}.")
        object.__setattr__(self, "tensor", tensor)

    def __call__(self, Omega: Any, B: Any, B_rate: Any) -> Any:
        """The torque (3,), N m."""
        return algebra.cross(self.tensor @ (algebra.cross(Omega, B) - B_rate), B)
