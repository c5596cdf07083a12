"""Forces of a perturbed system: their potential, the rates of the state, and their separate flows.

The flow of the perturbation for a time h, with g and the state of the integrable motion held fixed:

    damping   M -> exp(-damping h) M                                      exact
    kick      M -> M + h (force of the potential + torque)                exact unless the torque depends on M
    inertia, coupling   rotations (`kreisel.forces.turns`)                                        exact one by one
    wheels    M -> M - h W^T wheel_torque; their momenta are constant in the integrable motion      exact

`work` is the gain of energy by torques, damping, and forces that depend on time: W' = Omega.tau + dV/dt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import ChosenNumber, traced, value_and_gradient
from kreisel.algebra.recorded import run
from kreisel.errors import InputError
from kreisel.record.calling import call
from kreisel.record.contract import Frame, System
from kreisel.record.perturbation import FIELDS, FIRST, SECOND, TIME, Force, Perturbation

ORIENTATION = "g"
DAMPING, INERTIA, COUPLING = "damping", "inertia", "coupling"
WHEELS, WHEEL_AXES, WHEEL_TORQUE = "wheels", "wheel_axes", "wheel_torque"
BODY_AXES, HELD = "body_axes", "commanded_"  # of a body with control
DIAGONAL = 1e-12  # relative: off-diagonal entries of an inverse inertia
DOUBLINGS, TERMS = 8, 8  # of expm1: to rounding for x from -200 to 8

Constants = Mapping[str, Any]


class Body(NamedTuple):
    """Configuration of a body: the components of the state, the orientation (a matrix) or None, the time or None; the
    field in space, if it is known.
    """

    state: tuple[Array, ...]
    g: Array | None = None
    t: Any = None
    field: Array | None = None


def perturbation_of(system: System) -> Perturbation:
    """The perturbation of a system.  Raises `TypeError` for a system without one."""
    if system.perturbation is None:
        raise TypeError(f"{system.name} has no perturbation")
    return system.perturbation


# -- values ------------------------------------------------------------------------------------------


def potential(
    system: System, body: Body, constants: Constants, axes: Mapping[str, int]
) -> tuple[Any, dict[str, Array]]:
    """V, and its derivatives with respect to its letters, g and t."""
    force = perturbation_of(system).potential
    if force is None:
        return 0, {}
    value, slopes = _value_and_slopes(force, "potential", seen(system, body), constants, axes)
    return value, {name: _back(system, name, slope, body) for name, slope in slopes.items()}


def potential_of_pair(
    system: System, pair: tuple[Body, Body], constants: Constants, axes: Mapping[str, int]
) -> tuple[Any, tuple[dict[str, Array], dict[str, Array]], Any]:
    """V of two bodies, its derivatives with respect to the letters and g of each, and t."""
    force = perturbation_of(system).pair
    if force is None:
        raise TypeError(f"{system.name} has no pair potential")
    value, slopes = _value_and_slopes(force, "pair_potential", seen_by_pair(system, pair), constants, axes)
    first, second = (
        {name[:-1]: _back(system, name[:-1], slope, body) for name, slope in slopes.items() if name[-1] == mark}
        for body, mark in zip(pair, (FIRST, SECOND), strict=True)
    )
    return value, (first, second), slopes.get(TIME, 0)


def pulls(
    system: System, pair: tuple[Body, Body], constants: Constants, axes: Mapping[str, int]
) -> tuple[tuple[Array, ...], tuple[Array, ...], Any]:
    """The rates of the states of two bodies by their interaction, and of the work."""
    _, slopes, power = potential_of_pair(system, pair, constants, axes)
    first, second = (force_of_potential(system, body, by, constants) for body, by in zip(pair, slopes, strict=True))
    return first, second, power


def _value_and_slopes(
    force: Force, kind: str, arguments: Mapping[str, tuple[Any, int]], constants: Constants, axes: Mapping[str, int]
) -> tuple[Any, dict[str, Any]]:
    """The value of a potential and its derivatives with respect to its arguments; `arguments`: (value, axes)."""
    parameters = [(constants[name], axes[name]) for name in force.parameters]

    def of_numbers(*numbers: Any) -> Any:
        return _called(force, numbers)

    try:
        value, slopes = value_and_gradient(of_numbers, [*(arguments[name] for name in force.arguments), *parameters])
    except InputError as error:
        raise InputError(f"{kind}: {error}") from None
    return value, dict(zip(force.arguments, slopes, strict=False))


def torque(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> Array | None:
    """tau as a skew matrix (..., n, n); None without a torque."""
    n = body.state[0].shape[-1]
    result = _load(system, "torque", ((3,), (n, n))[n != 3 :], body, constants, axes)
    if result is None:
        return None
    tau, shape = result
    return algebra.hat(tau) if shape == (3,) else tau


def force(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> Array | None:
    """F (..., n); None without a force."""
    result = _load(system, "force", ((body.state[0].shape[-1],),), body, constants, axes)
    return None if result is None else result[0]


def _load(
    system: System,
    kind: str,
    shapes: Sequence[tuple[int, ...]],
    body: Body,
    constants: Constants,
    axes: Mapping[str, int],
) -> tuple[Array, tuple[int, ...]] | None:
    """The values of a load, and its shape without lanes, one of `shapes`."""
    function = perturbation_of(system).functions.get(kind)
    if function is None:
        return None
    result = np.asarray(_recorded(function, seen(system, body), constants, axes)[0], dtype=object)
    if result.shape not in shapes:
        n = shapes[0][0]
        wanted = (
            f"{n} values, a{'n axial' * (kind == 'torque')} vector"
            if len(shapes[0]) == 1
            else f"a skew {n} x {n} matrix"
        )
        raise InputError(f"{kind}: expected {wanted}, got shape {result.shape}.")
    return values_of(result, body), result.shape


def loads(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> tuple[tuple[Any, ...], Any]:
    """The rates of the state by torque, force and motors of wheels, and of their work, Omega.tau + U.F."""
    record, rates = perturbation_of(system), [0 * z for z in body.state]
    tau, F, power = torque(system, body, constants, axes), force(system, body, constants, axes), 0
    if record.control is not None:
        rates = actuated(system, body, constants, axes)
        tau = rates[0] if tau is None else tau + rates[0]
    if tau is not None:
        rates[0] = tau
        power = power + algebra.pairing(velocity(system, body.state, constants), tau)
    if F is not None:
        rates[1] = F
        power = power + algebra.dot(translation(system, body, constants, axes), F)
    return tuple(rates), power


def seen(system: System, body: Body) -> dict[str, tuple[Any, int]]:
    """The possible arguments of a force, by name: (value, its axes)."""
    constants: dict[str, tuple[Any, int]] = {}
    for (letter, kind), z in zip(system.space.components, body.state, strict=True):
        shown = algebra.KINDS[kind].shown(body.state[0].shape[-1])
        constants[letter] = algebra.KINDS[kind].for_user(z), shown.axes
    return constants | {ORIENTATION: (body.g, 2), TIME: (body.t, 0)}


def seen_by_pair(system: System, pair: tuple[Body, Body]) -> dict[str, tuple[Any, int]]:
    """The possible arguments of a pair potential, by name: (value, its axes)."""
    arguments = {TIME: (pair[0].t, 0)}
    for body, mark in zip(pair, (FIRST, SECOND), strict=True):
        arguments |= {name + mark: value for name, value in seen(system, body).items() if name != TIME}
    return arguments


def chooses(
    force: Force, arguments: Mapping[str, tuple[Any, int]], constants: Constants, axes: Mapping[str, int]
) -> bool:
    """Whether a force chooses values by comparisons; `arguments` has (value, axes) of its arguments."""
    return any(isinstance(x, ChosenNumber) for x in _recorded(force, arguments, constants, axes)[1])


def _recorded(
    force: Force, arguments: Mapping[str, tuple[Any, int]], constants: Constants, axes: Mapping[str, int]
) -> tuple[Any, list[Any]]:
    """The result of a force of values that record the operations, and their tape."""
    tape: list[Any] = []
    parameters = [(constants[name], axes[name]) for name in force.parameters]
    values = [traced(tape, *entry) for entry in (*(arguments[name] for name in force.arguments), *parameters)]
    return _called(force, values), tape


def _called(force: Force, numbers: Sequence[Any]) -> Any:
    arguments, parameters = numbers[: len(force.arguments)], numbers[len(force.arguments) :]
    return run(force.function, *arguments, **force.named(parameters))


def _back(system: System, name: str, slope: Array, body: Body) -> Array:
    """A derivative with respect to the axial vector of a skew matrix, as a skew matrix: <X, Y> = x.y."""
    kind = dict(system.space.components).get(name)
    return slope if kind is None else algebra.KINDS[kind].from_user(slope, body.state[0].shape[-1])


def values_of(result: Array, body: Body) -> Array:
    """Traced values, as the kind of number of the state."""
    flat = [getattr(v, "value", v) for v in result.flat]
    if algebra.holds_objects(body.state[0]):
        return algebra.objects(flat, result.shape)
    columns = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in flat))
    return np.stack(columns, -1).reshape((*columns[0].shape, *result.shape))


# -- rates -------------------------------------------------------------------------------------------


def force_of_potential(
    system: System, body: Body, slopes: Mapping[str, Array], constants: Constants
) -> tuple[Array, ...]:
    """The rates of the state by V: {x, V} from the letters, and the torque from g."""
    space, state = system.space, body.state
    rates: list[Array] = [0 * z for z in state]
    if any(letter in slopes for letter in space.letters):
        by = [slopes.get(letter, 0 * z) for letter, z in zip(space.letters, state, strict=True)]
        flat = algebra.flatten(by, space.kinds)
        tensor = call(space.tensor, state, constants)
        rates = list(algebra.restore(algebra.act(tensor.mT, flat), space.kinds, state[0].shape[-1]))
    if ORIENTATION in slopes:
        G, g = slopes[ORIENTATION], body.g
        turned = G @ g.mT if system.frame is Frame.REST else g.mT @ G  # type: ignore[union-attr]
        rates[0] = rates[0] - (turned - turned.mT)
    return tuple(rates)


def inverse_inertia_columns(base: System, constants: Constants, like: Any = 0) -> list[Array]:
    """The columns (..., 3) of Omega as a function of M, n = 3; `like`: vectors with the axes of lanes."""
    unit = algebra.identity(3)
    return [algebra.axial(call(base.inverse_inertia, (algebra.hat(unit[i] + 0 * like),), constants)) for i in range(3)]


def require_principal(base: System, constants: Constants) -> None:
    """Raises `InputError` if the axes of coordinates are not principal axes, n = 3."""
    inverse = np.stack(inverse_inertia_columns(base, constants), -1)
    off = abs(inverse * (1 - np.eye(3))).max()
    if off > DIAGONAL * abs(inverse).max():
        raise InputError(
            f"{base.name}: expected principal axes along the axes of coordinates, got others. Turn the body frame; the "
            "axis of a symmetric body is then (0, 0, 1)."
        )


def inverse_moments(system: System, constants: Constants) -> Array:
    """1/I_i - 1/I_i of the integrable motion, n = 3 (..., 3): the change by the perturbation."""
    columns = inverse_inertia_columns(perturbation_of(system).base, constants, constants[INERTIA])
    return 1 / constants[INERTIA] - np.stack([column[..., i] for i, column in enumerate(columns)], -1)


def velocity(system: System, state: tuple[Array, ...], constants: Constants) -> Array:
    """The angular velocity, with the moments of the perturbed body."""
    record = perturbation_of(system)
    out = call(record.base.velocity, state[: len(record.base.space.letters)], constants)
    if record.inertia:
        out = out + algebra.hat(inverse_moments(system, constants) * algebra.axial(state[0]))
    return out + algebra.hat(algebra.act(constants[COUPLING], state[1])) if record.coupling else out


def momentum_of_wheels(system: System, state: tuple[Array, ...], constants: Constants) -> Array | None:
    """h (..., 3) along the axes of the state; None without wheels."""
    control = perturbation_of(system).control
    if control is None or not control.wheels:
        return None
    return along_state(state[system.space.letters.index(WHEELS)], constants) / control.momentum


def to_body(constants: Constants) -> Array:
    """R (..., 3, 3) of a body with control: v_body = R v_state."""
    return algebra.rotation_matrix(constants[BODY_AXES])


def from_body(system: System, body: Body, constants: Constants) -> Array:
    """The matrix (..., 3, 3) that maps vectors along the body axes to those along the axes of the state."""
    back = to_body(constants).mT
    return back if system.frame is Frame.MOVING or body.g is None else body.g @ back


def along_state(wheels: Array, constants: Constants) -> Array:
    """The sum (..., 3) of values of wheels (..., k) times their axes, along the axes of the state."""
    return algebra.act(to_body(constants).mT, (wheels[..., None, :] @ constants[WHEEL_AXES])[..., 0, :])


def surroundings(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> dict[str, Array]:
    """The fields at the place of the body, in space, by name.  Raises `InputError` for a body without a place."""
    force = perturbation_of(system).environment
    if force is None:
        raise InputError(
            f"{system.name}: expected a law of rates, attitude, time, wheels, that commands torques, got one of "
            f"{', '.join(FIELDS)}, or a dipole. Only a body on an orbit has them: kr.physical.Satellite."
        )
    result, _ = _recorded(force, {TIME: (body.t, 0)}, constants, axes)
    return {name: values_of(np.asarray(value, dtype=object), body) for name, value in result.items()}


def field_of(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> Array:
    """The magnetic field at the place of the body, in space.  Raises `InputError` for a body without a place."""
    return surroundings(system, body, constants, axes)["field"] if body.field is None else body.field


def actuated(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> list[Any]:
    """The rates of the state by the commands that are held."""
    control = perturbation_of(system).control
    held, back = dict(zip(system.space.letters, body.state, strict=True)), from_body(system, body, constants)
    rates: list[Any] = [0 * z for z in body.state]
    tau: Any = 0 * algebra.axial(body.state[0])
    if HELD + "dipole" in held:
        B = algebra.act(body.g.mT, field_of(system, body, constants, axes))  # type: ignore[union-attr]
        tau = tau + algebra.cross(algebra.act(back, held[HELD + "dipole"]), B)
    if HELD + "torque" in held:
        tau = tau + algebra.act(back, held[HELD + "torque"])
    if WHEELS in held:
        motors = held.get(HELD + WHEEL_TORQUE, 0 * held[WHEELS]) + constants[WHEEL_TORQUE]
        tau = tau - along_state(motors, constants)
        rates[system.space.letters.index(WHEELS)] = motors * control.time  # type: ignore[union-attr]
    rates[0] = algebra.hat(tau * (control.time / control.momentum))  # type: ignore[union-attr]
    return rates


def translation(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> Array:
    """U = dH/dP, including a potential of P and a coupling."""
    record = perturbation_of(system)
    out = call(record.base.translation, body.state[: len(record.base.space.letters)], constants)
    if record.coupling:
        out = out + algebra.act(constants[COUPLING], algebra.axial(body.state[0]))
    return out + potential(system, body, constants, axes)[1].get(system.space.letters[1], 0)


def damped(system: System, state: tuple[Array, ...], factors: Array, by_axis: bool) -> Array:
    """The momentum with each part multiplied: by one factor, or one for each axis (..., 3), n = 3.

    In the rest frame the last axis is along the carried vector a, and the first two are equivalent.
    """
    M = state[0]
    if not by_axis:
        return algebra.mat(factors) * M
    m = algebra.axial(M)
    if system.frame is Frame.MOVING:
        return algebra.hat(factors * m)
    a = state[system.space.carried[0]]
    along = algebra.vec(algebra.dot(m, a) / algebra.dot(a, a)) * a
    return algebra.hat(factors[..., :1] * (m - along) + factors[..., 2:] * along)


def rates(system: System, body: Body, constants: Constants, axes: Mapping[str, int]) -> tuple[tuple[Array, ...], Any]:
    """The rates of the state by the perturbation only, and of the work."""
    record = perturbation_of(system)
    _, slopes = potential(system, body, constants, axes)
    out = list(force_of_potential(system, body, slopes, constants))
    work = slopes.get(TIME, 0)
    if record.loaded:
        by_loads, power = loads(system, body, constants, axes)
        out, work = [x + y for x, y in zip(out, by_loads, strict=True)], work + power
    if record.damping:
        lost = damped(system, body.state, constants[DAMPING], axes[DAMPING] > 0)
        out[0] = out[0] - lost
        work = work - algebra.pairing(velocity(system, body.state, constants), lost)
    if record.friction is not None:
        slow, power = call(record.friction, body.state, constants)
        out, work = [x + y for x, y in zip(out, slow, strict=True)], work + power
    if record.inertia:
        X = algebra.hat(inverse_moments(system, constants) * algebra.axial(body.state[0]))
        for i, kind in enumerate(system.space.kinds):
            out[i] = out[i] - algebra.KINDS[kind].rate(X, body.state[i])
    h = momentum_of_wheels(system, body.state, constants)
    if h is not None:
        out[0] = out[0] + algebra.hat(algebra.cross(h, algebra.axial(velocity(system, body.state, constants))))
    if record.coupling:
        M, P = algebra.axial(body.state[0]), body.state[1]
        KM, KP = (algebra.act(constants[COUPLING], v) for v in (M, P))
        out[0] = out[0] + algebra.hat(algebra.cross(M, KP) + algebra.cross(P, KM))
        out[1] = out[1] + algebra.cross(P, KP)
    return tuple(out), work


# -- flows -------------------------------------------------------------------------------------------


def kicked(
    system: System,
    body: Body,
    h: Any,
    constants: Constants,
    axes: Mapping[str, int],
    others: Callable[[tuple[Array, ...]], tuple[tuple[Any, ...], Any]] | None = None,
) -> tuple[tuple[Array, ...], Any]:
    """The state after the kick for the time h, and the work.

    `others`: further actions, state -> the rates of the state and of the work.
    """

    def without_loads(state: tuple[Array, ...]) -> tuple[tuple[Any, ...], Any]:
        moved = body._replace(state=state)
        _, slopes = potential(system, moved, constants, axes)
        rates, power = force_of_potential(system, moved, slopes, constants), slopes.get(TIME, 0)
        return _sum((rates, power), others(state)) if others is not None else (rates, power)

    def by_loads(state: tuple[Array, ...]) -> tuple[tuple[Any, ...], Any]:
        return loads(system, body._replace(state=state), constants, axes)

    if not perturbation_of(system).loaded:
        rates, power = without_loads(body.state)
        return _after(system, body.state, h, rates), h * power
    if changes_its_loads(system):
        return _by_runge_kutta(system, body.state, h, lambda state: _sum(without_loads(state), by_loads(state)))
    still = without_loads(body.state)
    new = _after(system, body.state, h, _sum(still, by_loads(body.state))[0])
    middle = tuple((x + y) / 2 for x, y in zip(body.state, new, strict=True))  # Omega is linear in the momentum
    return new, h * (still[1] + by_loads(middle)[1])


def _sum(first: tuple[tuple[Any, ...], Any], second: tuple[tuple[Any, ...], Any]) -> tuple[tuple[Any, ...], Any]:
    return tuple(x + y for x, y in zip(first[0], second[0], strict=True)), first[1] + second[1]


def changes_its_loads(system: System) -> bool:
    """Whether a kick changes its loads: a torque that depends on the momentum, or any force, which changes P."""
    record = perturbation_of(system)
    by_torque = record.torque is not None and record.torque.names(system.space.letters[0])
    return by_torque or record.force is not None


def _after(system: System, state: tuple[Array, ...], h: Any, rates: tuple[Any, ...]) -> tuple[Array, ...]:
    """state + h rates."""
    scale = [algebra.mat(h) if algebra.KINDS[k].axes == 2 else algebra.vec(h) for k in system.space.kinds]
    return tuple(z + s * r for z, s, r in zip(state, scale, rates, strict=True))


def _by_runge_kutta(
    system: System, state: tuple[Array, ...], h: Any, rates: Callable[..., tuple[tuple[Any, ...], Any]]
) -> tuple[tuple[Array, ...], Any]:
    """The state after the time h, and the work, by the classical method of order 4."""
    total, gain, point = [0 * z for z in state], 0, state
    for weight, ahead in ((1 / 6, 0.5), (1 / 3, 0.5), (1 / 3, 1.0), (1 / 6, 0.0)):
        slopes, power = rates(point)
        total = [z + weight * s for z, s in zip(total, slopes, strict=True)]
        point, gain = _after(system, state, ahead * h, slopes), gain + weight * power
    return _after(system, state, h, tuple(total)), h * gain


def decayed(
    system: System, state: tuple[Array, ...], h: Any, constants: Constants, axes: Mapping[str, int]
) -> tuple[tuple[Array, ...], Any]:
    """The state after linear damping for the time h, exactly, and the work."""
    by_axis = axes[DAMPING] > 0
    lost = expm1(-(algebra.vec(h) if by_axis else h) * constants[DAMPING])
    new = (state[0] + damped(system, state, lost, by_axis), *state[1:])
    return new, kinetic(system, new, constants) - kinetic(system, state, constants)


def rubbed(system: System, state: tuple[Array, ...], h: Any, constants: Constants) -> tuple[tuple[Array, ...], Any]:
    """The state after friction for the time h, and the work."""
    function = perturbation_of(system).friction
    return _by_runge_kutta(system, state, h, lambda z: call(function, z, constants))


def expm1(x: Any) -> Any:
    """exp(x) - 1, with a relatively small error: a factor exp(x) would have the same error in every step."""
    y: Any = x / 2**DOUBLINGS
    out: Any = 0
    for k in range(TERMS, 0, -1):
        out = (out + 1) * y / k
    for _ in range(DOUBLINGS):
        out = out * (2 + out)
    return out


def kinetic(system: System, state: tuple[Array, ...], constants: Constants) -> Any:
    """The part of H that depends on M: <M, Omega>/2 with the moments of the perturbed body, and half of a coupling."""
    out = algebra.pairing(state[0], velocity(system, state, constants)) / 2
    if perturbation_of(system).coupling:
        out = out + algebra.dot(algebra.axial(state[0]), algebra.act(constants[COUPLING], state[1])) / 2
    return out


def energy_of_spin(system: System, state: tuple[Array, ...], constants: Constants) -> Any:
    """The energy of the spin, which the Hamiltonian of the rest frame omits as a function of Casimirs."""
    base = perturbation_of(system).base
    state = state[: len(base.space.letters)]
    at_rest = (0 * state[0], *state[1:])
    in_hamiltonian = call(base.energy, state, constants) - call(base.energy, at_rest, constants)
    return algebra.pairing(state[0], call(base.velocity, state, constants)) / 2 - in_hamiltonian
