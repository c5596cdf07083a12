"""Forces of a perturbed system: their potential, the rates of the state, and their separate flows.

The flow of the perturbation for a time h, with g and the state of the integrable motion held fixed:

    damping   M -> exp(-damping h) M                                      exact
    kick      M -> M + h (force of the potential + torque)                exact unless the torque depends on M
    inertia, coupling   rotations about fixed body axes                                             exact one by one
    wheels    M -> M - h W^T wheel_torque; their momenta are constant in the integrable motion      exact

The rotations are the flows of the parts of H that are quadratic in the momenta, n = 3, moving frame:

    inertia     (1/I_i - 1/I_i of the integrable motion) M_i^2/2: a rotation about e_i
    coupling    M.KP, K symmetric: the sum of k (v.M)(v.P) over v = e_i and e_i + e_j.  For each, v.M and v.P are
                constant; with w = k (v.P) v and u = k (v.M) v the body rotates by R = exp(h hat(w)), and

                    P(h) = R^T P,   M(h) = R^T (M + h P x u)

`work` is the gain of energy by torques, damping, and forces that depend on time: W' = Omega.tau + dV/dt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import ChosenNumber, cos, sin, traced, value_and_gradient
from kreisel.algebra.recorded import run
from kreisel.errors import InputError
from kreisel.record.calling import call
from kreisel.record.contract import Frame, System
from kreisel.record.model import Model
from kreisel.record.perturbation import FIELDS, FIRST, SECOND, TIME, Force, Perturbation

ORIENTATION = "g"
DAMPING, INERTIA, COUPLING = "damping", "inertia", "coupling"
WHEELS, WHEEL_AXES, WHEEL_TORQUE = "wheels", "wheel_axes", "wheel_torque"
BODY_AXES, HELD = "body_axes", "commanded_"  # of a body with control
DIAGONAL = 1e-12  # relative: off-diagonal entries of an inverse inertia
DOUBLINGS, TERMS = 8, 8  # of expm1: to rounding for x from -200 to 8
SAME = 4e-16  # relative: inverse moments that differ by rounding
PAIRS = ((0, 1), (1, 2), (2, 0))

Constants = Mapping[str, Any]
State = tuple[Array, ...]
Turn = Callable[[State, State, Any, Constants], tuple[State, State]]


class Body(NamedTuple):
    """A perturbed body: its system, the components of its state, constants and axes of each without axes of lanes.

    g  the orientation, a matrix, or None;  t  the time or None;  field  in space, if it is known
    """

    system: System
    state: State
    constants: Constants
    axes: Mapping[str, int]
    g: Array | None = None
    t: Any = None
    field: Array | None = None

    @property
    def record(self) -> Perturbation:
        """The perturbation of its system."""
        return perturbation_of(self.system)


def perturbation_of(system: System) -> Perturbation:
    """The perturbation of a system.  Raises `TypeError` for a system without one."""
    if system.perturbation is None:
        raise TypeError(f"{system.name} has no perturbation")
    return system.perturbation


# -- values ------------------------------------------------------------------------------------------


def potential(body: Body) -> tuple[Any, dict[str, Array]]:
    """V, and its derivatives with respect to its letters, g and t."""
    force = body.record.potential
    if force is None:
        return 0, {}
    value, slopes = _value_and_slopes(force, "potential", seen(body), body)
    return value, {name: _back(name, slope, body) for name, slope in slopes.items()}


def potential_of_pair(pair: tuple[Body, Body]) -> tuple[Any, tuple[dict[str, Array], dict[str, Array]], Any]:
    """V of two bodies, its derivatives with respect to the letters and g of each, and t; constants are of the pair."""
    force = pair[0].record.pair
    if force is None:
        raise TypeError(f"{pair[0].system.name} has no pair potential")
    value, slopes = _value_and_slopes(force, "pair_potential", seen_by_pair(pair), pair[0])
    first, second = (
        {name[:-1]: _back(name[:-1], slope, body) for name, slope in slopes.items() if name[-1] == mark}
        for body, mark in zip(pair, (FIRST, SECOND), strict=True)
    )
    return value, (first, second), slopes.get(TIME, 0)


def pulls(pair: tuple[Body, Body]) -> tuple[State, State, Any]:
    """The rates of the states of two bodies by their interaction, and of the work."""
    _, slopes, power = potential_of_pair(pair)
    first, second = (force_of_potential(body, by) for body, by in zip(pair, slopes, strict=True))
    return first, second, power


def _value_and_slopes(
    force: Force, kind: str, arguments: Mapping[str, tuple[Any, int]], body: Body
) -> tuple[Any, dict[str, Any]]:
    """The value of a potential and its derivatives with respect to its arguments; `arguments`: (value, axes)."""
    values = _values(force, arguments, body)
    try:
        value, slopes = value_and_gradient(lambda *numbers: _called(force, numbers), values)
    except InputError as error:
        raise InputError(f"{kind}: {error}") from None
    return value, dict(zip(force.arguments, slopes, strict=False))


def torque(body: Body) -> Array | None:
    """tau as a skew matrix (..., n, n); None without a torque."""
    n = body.state[0].shape[-1]
    result = _load("torque", ((3,), (n, n))[n != 3 :], body)
    if result is None:
        return None
    tau, shape = result
    return algebra.hat(tau) if shape == (3,) else tau


def force(body: Body) -> Array | None:
    """F (..., n); None without a force."""
    result = _load("force", ((body.state[0].shape[-1],),), body)
    return None if result is None else result[0]


def _load(kind: str, shapes: Sequence[tuple[int, ...]], body: Body) -> tuple[Array, tuple[int, ...]] | None:
    """The values of a load, and its shape without lanes, one of `shapes`."""
    function = body.record.functions.get(kind)
    if function is None:
        return None
    result = np.asarray(_recorded(function, seen(body), body)[0], dtype=object)
    if result.shape not in shapes:
        n = shapes[0][0]
        wanted = (
            f"{n} values, a{'n axial' * (kind == 'torque')} vector"
            if len(shapes[0]) == 1
            else f"a skew {n} x {n} matrix"
        )
        raise InputError(f"{kind}: expected {wanted}, got shape {result.shape}.")
    return values_of(result, body), result.shape


def loads(body: Body) -> tuple[tuple[Any, ...], Any]:
    """The rates of the state by torque, force and motors of wheels, and of their work, Omega.tau + U.F."""
    rates: list[Any] = [0 * z for z in body.state]
    tau, F, power = torque(body), force(body), 0
    if body.record.control is not None:
        rates = actuated(body)
        tau = rates[0] if tau is None else tau + rates[0]
    if tau is not None:
        rates[0] = tau
        power = power + algebra.pairing(velocity(body), tau)
    if F is not None:
        rates[1] = F
        power = power + algebra.dot(translation(body), F)
    return tuple(rates), power


def seen(body: Body) -> dict[str, tuple[Any, int]]:
    """The possible arguments of a force, by name: (value, its axes)."""
    arguments: dict[str, tuple[Any, int]] = {}
    for (letter, kind), z in zip(body.system.space.components, body.state, strict=True):
        shown = algebra.KINDS[kind].shown(body.state[0].shape[-1])
        arguments[letter] = algebra.KINDS[kind].for_user(z), shown.axes
    return arguments | {ORIENTATION: (body.g, 2), TIME: (body.t, 0)}


def seen_by_pair(pair: tuple[Body, Body]) -> dict[str, tuple[Any, int]]:
    """The possible arguments of a pair potential, by name: (value, its axes)."""
    arguments = {TIME: (pair[0].t, 0)}
    for body, mark in zip(pair, (FIRST, SECOND), strict=True):
        arguments |= {name + mark: value for name, value in seen(body).items() if name != TIME}
    return arguments


def chooses(force: Force, arguments: Mapping[str, tuple[Any, int]], body: Body) -> bool:
    """Whether a force chooses values by comparisons; `arguments` has (value, axes) of its arguments."""
    return any(isinstance(x, ChosenNumber) for x in _recorded(force, arguments, body)[1])


def _recorded(force: Force, arguments: Mapping[str, tuple[Any, int]], body: Body) -> tuple[Any, list[Any]]:
    """The result of a force of values that record the operations, and their tape."""
    tape: list[Any] = []
    return _called(force, [traced(tape, *entry) for entry in _values(force, arguments, body)]), tape


def _values(force: Force, arguments: Mapping[str, tuple[Any, int]], body: Body) -> list[tuple[Any, int]]:
    """The values of the arguments and parameters of a force, each with its axes."""
    parameters = [(body.constants[name], body.axes[name]) for name in force.parameters]
    return [*(arguments[name] for name in force.arguments), *parameters]


def _called(force: Force, numbers: Sequence[Any]) -> Any:
    arguments, parameters = numbers[: len(force.arguments)], numbers[len(force.arguments) :]
    return run(force.function, *arguments, **force.named(parameters))


def _back(name: str, slope: Array, body: Body) -> Array:
    """A derivative with respect to the axial vector of a skew matrix, as a skew matrix: <X, Y> = x.y."""
    kind = dict(body.system.space.components).get(name)
    return slope if kind is None else algebra.KINDS[kind].from_user(slope, body.state[0].shape[-1])


def values_of(result: Array, body: Body) -> Array:
    """Traced values, as the kind of number of the state."""
    flat = [getattr(v, "value", v) for v in result.flat]
    if algebra.holds_objects(body.state[0]):
        return algebra.objects(flat, result.shape)
    columns = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in flat))
    return np.stack(columns, -1).reshape((*columns[0].shape, *result.shape))


# -- rates -------------------------------------------------------------------------------------------


def force_of_potential(body: Body, slopes: Mapping[str, Array]) -> State:
    """The rates of the state by V: {x, V} from the letters, and the torque from g."""
    space, state = body.system.space, body.state
    rates: list[Array] = [0 * z for z in state]
    if any(letter in slopes for letter in space.letters):
        by = [slopes.get(letter, 0 * z) for letter, z in zip(space.letters, state, strict=True)]
        flat = algebra.flatten(by, space.kinds)
        tensor = call(space.tensor, state, body.constants)
        rates = list(algebra.restore(algebra.act(tensor.mT, flat), space.kinds, state[0].shape[-1]))
    if ORIENTATION in slopes:
        G, g = slopes[ORIENTATION], body.g
        turned = G @ g.mT if body.system.frame is Frame.REST else g.mT @ G  # type: ignore[union-attr]
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


def velocity(body: Body) -> Array:
    """The angular velocity, with the moments of the perturbed body."""
    state, constants, record = body.state, body.constants, body.record
    out = call(record.base.velocity, state[: len(record.base.space.letters)], constants)
    if record.inertia:
        out = out + algebra.hat(inverse_moments(body.system, constants) * algebra.axial(state[0]))
    return out + algebra.hat(algebra.act(constants[COUPLING], state[1])) if record.coupling else out


def momentum_of_wheels(body: Body) -> Array | None:
    """h (..., 3) along the axes of the state; None without wheels."""
    control = body.record.control
    if control is None or not control.wheels:
        return None
    return along_state(body.state[body.system.space.letters.index(WHEELS)], body.constants) / control.momentum


def to_body(constants: Constants) -> Array:
    """R (..., 3, 3) of a body with control: v_body = R v_state."""
    return algebra.rotation_matrix(constants[BODY_AXES])


def from_body(body: Body) -> Array:
    """The matrix (..., 3, 3) that maps vectors along the body axes to those along the axes of the state."""
    back = to_body(body.constants).mT
    return back if body.system.frame is Frame.MOVING or body.g is None else body.g @ back


def along_state(wheels: Array, constants: Constants) -> Array:
    """The sum (..., 3) of values of wheels (..., k) times their axes, along the axes of the state."""
    return algebra.act(to_body(constants).mT, (wheels[..., None, :] @ constants[WHEEL_AXES])[..., 0, :])


def surroundings(body: Body) -> dict[str, Array]:
    """The fields at the place of the body, in space, by name.  Raises `InputError` for a body without a place."""
    force = body.record.environment
    if force is None:
        raise InputError(
            f"{body.system.name}: expected a law of rates, attitude, time, wheels, that commands torques, got one of "
            f"{', '.join(FIELDS)}, or a dipole. Only a body on an orbit has them: kr.physical.Satellite."
        )
    result, _ = _recorded(force, {TIME: (body.t, 0)}, body)
    return {name: values_of(np.asarray(value, dtype=object), body)[()] for name, value in result.items()}


def field_of(body: Body) -> Array:
    """The magnetic field at the place of the body, in space.  Raises `InputError` for a body without a place."""
    return surroundings(body)["field"] if body.field is None else body.field


def actuated(body: Body) -> list[Any]:
    """The rates of the state by the commands that are held."""
    control, letters = body.record.control, body.system.space.letters
    held, back = dict(zip(letters, body.state, strict=True)), from_body(body)
    rates: list[Any] = [0 * z for z in body.state]
    tau: Any = 0 * algebra.axial(body.state[0])
    if HELD + "dipole" in held:
        B = algebra.act(body.g.mT, field_of(body))  # type: ignore[union-attr]
        tau = tau + algebra.cross(algebra.act(back, held[HELD + "dipole"]), B)
    if HELD + "torque" in held:
        tau = tau + algebra.act(back, held[HELD + "torque"])
    if WHEELS in held:
        motors = held.get(HELD + WHEEL_TORQUE, 0 * held[WHEELS]) + body.constants[WHEEL_TORQUE]
        tau = tau - along_state(motors, body.constants)
        rates[letters.index(WHEELS)] = motors * control.time  # type: ignore[union-attr]
    rates[0] = algebra.hat(tau * (control.time / control.momentum))  # type: ignore[union-attr]
    return rates


def translation(body: Body) -> Array:
    """U = dH/dP, including a potential of P and a coupling."""
    record = body.record
    out = call(record.base.translation, body.state[: len(record.base.space.letters)], body.constants)
    if record.coupling:
        out = out + algebra.act(body.constants[COUPLING], algebra.axial(body.state[0]))
    return out + potential(body)[1].get(body.system.space.letters[1], 0)


def damped(body: Body, factors: Array) -> Array:
    """The momentum with each part multiplied: by one factor, or one for each axis (..., 3), n = 3.

    In the rest frame the last axis is along the carried vector a, and the first two are equivalent.
    """
    system, state, M = body.system, body.state, body.state[0]
    if not body.axes[DAMPING]:
        return algebra.mat(factors) * M
    m = algebra.axial(M)
    if system.frame is Frame.MOVING:
        return algebra.hat(factors * m)
    a = state[system.space.carried[0]]
    along = algebra.vec(algebra.dot(m, a) / algebra.dot(a, a)) * a
    return algebra.hat(factors[..., :1] * (m - along) + factors[..., 2:] * along)


def rates(body: Body) -> tuple[State, Any]:
    """The rates of the state by the perturbation only, and of the work."""
    record, constants, (_, slopes) = body.record, body.constants, potential(body)
    out = list(force_of_potential(body, slopes))
    work = slopes.get(TIME, 0)
    if record.loaded:
        by_loads, power = loads(body)
        out, work = [x + y for x, y in zip(out, by_loads, strict=True)], work + power
    if record.damping:
        lost = damped(body, constants[DAMPING])
        out[0] = out[0] - lost
        work = work - algebra.pairing(velocity(body), lost)
    if record.friction is not None:
        slow, power = call(record.friction, body.state, constants)
        out, work = [x + y for x, y in zip(out, slow, strict=True)], work + power
    if record.inertia:
        X = algebra.hat(inverse_moments(body.system, constants) * algebra.axial(body.state[0]))
        for i, kind in enumerate(body.system.space.kinds):
            out[i] = out[i] - algebra.KINDS[kind].rate(X, body.state[i])
    h = momentum_of_wheels(body)
    if h is not None:
        out[0] = out[0] + algebra.hat(algebra.cross(h, algebra.axial(velocity(body))))
    if record.coupling:
        M, P = algebra.axial(body.state[0]), body.state[1]
        KM, KP = (algebra.act(constants[COUPLING], v) for v in (M, P))
        out[0] = out[0] + algebra.hat(algebra.cross(M, KP) + algebra.cross(P, KM))
        out[1] = out[1] + algebra.cross(P, KP)
    return tuple(out), work


# -- flows -------------------------------------------------------------------------------------------


def kicked(
    body: Body,
    h: Any,
    others: Callable[[State], tuple[tuple[Any, ...], Any]] | None = None,
) -> tuple[State, Any]:
    """The state after the kick for the time h, and the work.

    `others`: further actions, state -> the rates of the state and of the work.
    """

    def without_loads(state: State) -> tuple[tuple[Any, ...], Any]:
        moved = body._replace(state=state)
        _, slopes = potential(moved)
        rates, power = force_of_potential(moved, slopes), slopes.get(TIME, 0)
        return _sum((rates, power), others(state)) if others is not None else (rates, power)

    def by_loads(state: State) -> tuple[tuple[Any, ...], Any]:
        return loads(body._replace(state=state))

    if not body.record.loaded:
        rates, power = without_loads(body.state)
        return _after(body, h, rates), h * power
    if changes_its_loads(body.system):
        return _by_runge_kutta(body, h, lambda state: _sum(without_loads(state), by_loads(state)))
    still = without_loads(body.state)
    new = _after(body, h, _sum(still, by_loads(body.state))[0])
    middle = tuple((x + y) / 2 for x, y in zip(body.state, new, strict=True))  # Omega is linear in the momentum
    return new, h * (still[1] + by_loads(middle)[1])


def _sum(first: tuple[tuple[Any, ...], Any], second: tuple[tuple[Any, ...], Any]) -> tuple[tuple[Any, ...], Any]:
    return tuple(x + y for x, y in zip(first[0], second[0], strict=True)), first[1] + second[1]


def changes_its_loads(system: System) -> bool:
    """Whether a kick changes its loads: a torque that depends on the momentum, or any force, which changes P."""
    record = perturbation_of(system)
    by_torque = record.torque is not None and record.torque.names(system.space.letters[0])
    return by_torque or record.force is not None


def _after(body: Body, h: Any, rates: tuple[Any, ...]) -> State:
    """state + h rates."""
    scale = [algebra.mat(h) if algebra.KINDS[k].axes == 2 else algebra.vec(h) for k in body.system.space.kinds]
    return tuple(z + s * r for z, s, r in zip(body.state, scale, rates, strict=True))


def _by_runge_kutta(body: Body, h: Any, rates: Callable[..., tuple[tuple[Any, ...], Any]]) -> tuple[State, Any]:
    """The state after the time h, and the work, by the classical method of order 4."""
    total, gain, point = [0 * z for z in body.state], 0, body.state
    for weight, ahead in ((1 / 6, 0.5), (1 / 3, 0.5), (1 / 3, 1.0), (1 / 6, 0.0)):
        slopes, power = rates(point)
        total = [z + weight * s for z, s in zip(total, slopes, strict=True)]
        point, gain = _after(body, ahead * h, slopes), gain + weight * power
    return _after(body, h, tuple(total)), h * gain


def decayed(body: Body, h: Any) -> tuple[State, Any]:
    """The state after linear damping for the time h, exactly, and the work."""
    lost = expm1(-(algebra.vec(h) if body.axes[DAMPING] else h) * body.constants[DAMPING])
    new = (body.state[0] + damped(body, lost), *body.state[1:])
    return new, kinetic(body._replace(state=new)) - kinetic(body)


def rubbed(body: Body, h: Any) -> tuple[State, Any]:
    """The state after friction for the time h, and the work."""
    function = body.record.friction
    return _by_runge_kutta(body, h, lambda z: call(function, z, body.constants))


def expm1(x: Any) -> Any:
    """exp(x) - 1, with a relatively small error: a factor exp(x) would have the same error in every step."""
    y: Any = x / 2**DOUBLINGS
    out: Any = 0
    for k in range(TERMS, 0, -1):
        out = (out + 1) * y / k
    for _ in range(DOUBLINGS):
        out = out * (2 + out)
    return out


def kinetic(body: Body) -> Any:
    """The part of H that depends on M: <M, Omega>/2 with the moments of the perturbed body, and half of a coupling."""
    M, *others = body.state
    out = algebra.pairing(M, velocity(body)) / 2
    if body.record.coupling:
        out = out + algebra.dot(algebra.axial(M), algebra.act(body.constants[COUPLING], others[0])) / 2
    return out


def energy_of_spin(body: Body) -> Any:
    """The energy of the spin, which the Hamiltonian of the rest frame omits as a function of Casimirs."""
    base, constants = body.record.base, body.constants
    state = body.state[: len(base.space.letters)]
    at_rest = (0 * state[0], *state[1:])
    in_hamiltonian = call(base.energy, state, constants) - call(base.energy, at_rest, constants)
    return algebra.pairing(state[0], call(base.velocity, state, constants)) / 2 - in_hamiltonian


# -- rotations about fixed body axes -----------------------------------------------------------------


def turns_of(model: Model, with_zeros: bool = False) -> dict[tuple[str, int], Turn]:
    """The rotations of a perturbed body by kind and place, if they have an effect in some lane.

    With `with_zeros` all are returned, since parameters may change.
    """
    system, record = model.system, perturbation_of(model.system)
    out: dict[tuple[str, int], Turn] = {}
    if record.inertia:
        change = abs(inverse_moments(system, model.constants)).reshape(-1, 3).max(0)
        axes = np.flatnonzero(with_zeros | (change > SAME * (1 / model.constants[INERTIA]).max())).tolist()
        out |= {(INERTIA, axis): about_axis(system, axis) for axis in axes}
    if record.coupling:
        result = [np.asarray(weight(model.constants[COUPLING], term)) for term in range(6)]
        terms = [term for term in range(6) if with_zeros or result[term].any()]
        out |= {(COUPLING, term): along_coupling(system, term) for term in terms}
    return out


def about_axis(system: System, axis: int) -> Turn:
    """The change of one principal moment."""

    def turn(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        rate = inverse_moments(system, constants)[..., axis] * algebra.axial(state[0])[..., axis]
        return after_turn(system, state, g, rate * h, np.eye(3)[axis])

    return turn


def along_coupling(system: System, term: int) -> Turn:
    """One k (v.M)(v.P)."""
    v, length = direction(term), float(np.linalg.norm(direction(term)))

    def turn(state: State, g: State, h: Any, constants: Constants) -> tuple[State, State]:
        M, P, *remainder = state
        k, m = weight(constants[COUPLING], term), algebra.axial(M)
        u = algebra.vec(h * k * algebra.dot(m, v + 0 * m)) * (v + 0 * m)
        state = (M + algebra.hat(algebra.cross(P, u)), P, *remainder)
        return after_turn(system, state, g, h * k * algebra.dot(P, v + 0 * P) * length, v / length)

    return turn


def direction(term: int) -> Array:
    """e_1, e_2, e_3, e_1 + e_2, e_2 + e_3, e_3 + e_1."""
    unit = np.eye(3)
    return unit[term] if term < 3 else unit[PAIRS[term - 3][0]] + unit[PAIRS[term - 3][1]]


def weight(K: Array, term: int) -> Array:
    """k of that direction v: K is the sum of k v v^T."""
    if term < 3:
        return 2 * K[..., term, term] - K[..., term, 0] - K[..., term, 1] - K[..., term, 2]
    i, j = PAIRS[term - 3]
    return K[..., i, j]


def after_turn(system: System, state: State, g: State, angle: Any, axis: Array) -> tuple[State, State]:
    """The state and the unit quaternion g after a rotation of the body by that angle about a unit vector."""
    s, c = sin(angle / 2), cos(angle / 2)
    q = algebra.vec(c) * algebra.identity(4)[0] + algebra.vec(s) * np.append(0.0, axis)
    W = algebra.rotation_matrix(q)
    new = tuple(algebra.KINDS[kind].rotated(W.mT, z) for kind, z in zip(system.space.kinds, state, strict=True))
    return new, tuple(algebra.quaternion_product(x, q) for x in g)
