"""The record of a perturbed system: flow, energy and velocity of the integrable part and of the forces together.

Casimirs and integrals survive if their derivative along the perturbation vanishes: tested at random points, in
rationals if the functions accept them, else in doubles; at the actual parameters, in all lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import value_and_jacobian
from kreisel.algebra.reuse import Identity, reused
from kreisel.errors import InputError
from kreisel.forces import kicks
from kreisel.forces.kicks import COUPLING, ORIENTATION, Body
from kreisel.forces.product import constants_of_pairs
from kreisel.record.calling import Function, call, keywords, naming
from kreisel.record.contract import ClosedForm, Frame, System
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME, Force, Perturbation, pairs_of

POINTS = 3
ZERO = 1e-13  # of the slope times the rate, in doubles
# times of forces tested in doubles: a pulse vanishes except for a short time
TIMES = np.concatenate([np.linspace(-5.0, 200.0, 411), np.logspace(np.log10(200.0), 3, 40)])
# Claims about the integrable part only.
UNKNOWN: dict[str, Any] = {
    "invariant": {},
    "commuting": (),
    "lax": None,
    "inverse_inertia": None,
    "spin": None,
    "map": None,
    "baecklund": None,
    "pairs": None,
    "exact_map": None,
    "relations": (),
    "closed_form": ClosedForm(),
    "body_frame": None,
    "notes": "",
}


def perturbed_record(record: Perturbation, axes: Mapping[str, int], **stated: Any) -> System:
    """The system of these forces; `axes` of each constant, without axes of lanes; `stated`: fields of the record."""
    system = replace(record.base, **{**UNKNOWN, **stated}, perturbation=record)
    names = (*axes, *(letter for letter in (ORIENTATION, TIME) if record.names(letter)))
    named: dict[str, Any] = {kind: naming(f, names) for kind, f in _functions(system, axes).items()}
    return replace(system, **named)


def _functions(system: System, axes: Mapping[str, int]) -> dict[str, Callable[..., Any]]:
    """Flow, energy and velocity of the perturbed system, as far as the integrable system has them."""
    record = kicks.perturbation_of(system)
    base, count = record.base, len(record.base.space.letters)
    turned = base.frame is Frame.REST and (record.loaded or record.damping or record.names(ORIENTATION))

    def body(state: tuple[Array, ...], constants: Mapping[str, Any]) -> Body:
        return Body(system, state, constants, axes, constants.get(ORIENTATION), constants.get(TIME))

    def flow(*state: Array, **constants: Any) -> tuple[Array, ...]:
        rates, _ = kicks.rates(body(state, constants))
        inner = call(base.flow, state[:count], constants)
        return (*(x + y for x, y in zip(inner, rates, strict=False)), *rates[count:])

    def energy(*state: Array, **constants: Any) -> Array:
        V, _ = kicks.potential(body(state, constants))
        out = call(base.energy, state[:count], constants) + V
        if record.inertia:
            M = algebra.axial(state[0])
            out = out + algebra.dot(M * M, kicks.inverse_moments(system, constants)) / 2
        if record.coupling:
            out = out + algebra.dot(algebra.axial(state[0]), algebra.act(constants[COUPLING], state[1]))
        return out + kicks.energy_of_spin(body(state, constants)) if turned else out

    def velocity(*state: Array, **constants: Any) -> Array:
        return kicks.velocity(body(state, constants))

    def translation(*state: Array, **constants: Any) -> Array:
        return kicks.translation(body(state, constants))

    result = {"flow": flow, "energy": energy, "velocity": velocity, "translation": translation}
    return {kind: function for kind, function in result.items() if getattr(base, kind) is not None}


# -- Casimirs and integrals that survive -----------------------------------------------------------


def conserved(model: Model) -> tuple[str, ...]:
    """The names of the Casimirs ("casimir") and integrals that no force of a perturbed system changes."""
    return reused(
        (conserved, model.key),
        lambda: tuple(name for name, function in candidates(model).items() if all(surviving_parts(model, function))),
    )


def conserved_totals(model: Model) -> tuple[str, ...]:
    """The names of integrals of bodies in pairs whose sum is conserved, but not the value of each body."""
    if pairs_of(model) is None:
        return ()
    single = conserved(model)

    def names() -> tuple[str, ...]:
        return tuple(
            name
            for name, function in model.system.integrals.items()
            if name not in single and all(_survives(_representatives(model), function, _in_sum))
        )

    return reused((conserved_totals, model.key), names)


def surviving_parts(model: Model, function: Function) -> list[bool]:
    """The parts of a function of the state that no force changes, in any lane."""
    survival = [_survives([representative], function, list) for representative in _representatives(model)]
    return [all(lanes) for lanes in zip(*survival, strict=True)]


def _representatives(model: Model) -> list[Model]:
    """The model itself; for lanes, the first lane, and a model with a random mean of the parameters over all lanes.

    An identity at that mean holds for all lanes: the derivatives are analytic functions of the parameters.
    """
    model = _with_any_choice(model)
    if not model.batch:
        return [model]
    drawn = np.random.default_rng(2).random(model.batch)
    weights = drawn / drawn.sum()
    varied = {k for k, v in model.params.items() if v.ndim > model.axes[k]}
    means = {k: np.tensordot(weights, v, 1) if k in varied else v for k, v in model.params.items()}
    first = {k: v[0] if k in varied else v for k, v in model.params.items()}
    same = {k for k in varied if (model.params[k] == model.params[k][0]).all()}
    return [Model(model.system, first), Model(model.system, {**means, **{k: first[k] for k in same}})]


def _with_any_choice(model: Model) -> Model:
    """The model with random forces of the same arguments for forces that choose values, which no points exhaust."""
    record = kicks.perturbation_of(model.system)
    forces = {**record.functions, **({"pair": record.pair} if record.pair else {})}
    chosen: dict[str, Any] = {k: _any_force(k, force, model.n) for k, force in forces.items() if force.chooses}
    return Model(replace(model.system, perturbation=replace(record, **chosen)), model.params) if chosen else model


def _any_force(kind: str, force: Force, n: int) -> Force:
    """A constant load, or a potential that is linear in its arguments."""
    weights = np.random.default_rng(3).integers(1, 10**6, 1000).tolist()

    def potential(*arguments: Any) -> Any:
        return sum(
            w * x for w, x in zip(weights, [x for argument in arguments for x in np.ravel(argument)], strict=False)
        )

    def load(*_: Any) -> Any:
        if kind == "force" or n == 3:
            return np.array(weights[:n], dtype=object)
        return algebra.skew(np.array(weights[: n * (n - 1) // 2], dtype=object), n)

    return Force(load if kind in ("torque", "force") else potential, force.arguments, ())


def candidates(model: Model) -> dict[str, Function]:
    """The integrals and Casimirs of the integrable part, except its energy."""
    space = model.system.space
    out = {} if space.casimirs is None else {"casimir": space.casimirs}
    return {**out, **model.system.integrals}


Slopes = list[tuple[Any, Any]]  # (derivative along the perturbation, its scale) of each part, at one or many times


def _in_sum(bodies: list[Slopes]) -> list[Slopes]:
    """The slopes of the sum over two bodies."""
    return [[(x + y, np.maximum(s, t)) for (x, s), (y, t) in zip(*bodies, strict=True)]]


def _survives(models: list[Model], function: Function, of: Callable[[list[Slopes]], list[Slopes]]) -> list[bool]:
    """The surviving parts of a function, in rationals if possible, else in doubles; of one body or of two."""
    try:
        return _all_of_parts(models, function, of, exact=True)
    except (TypeError, AttributeError, ValueError, ZeroDivisionError, InputError):
        return _all_of_parts(models, function, of, exact=False)


def _all_of_parts(
    models: list[Model], function: Function, of: Callable[[list[Slopes]], list[Slopes]], exact: bool
) -> list[bool]:
    result: list[bool] = []
    keys = [model.key for model in models]
    with np.errstate(all="ignore"):
        numbers = [_in_rationals(model) for model in models] if exact else models
        for k in range(POINTS):
            bodies = reused((_point, *keys, exact, k), lambda k=k: _point(numbers, exact, k))  # type: ignore[misc]
            slopes = [
                [
                    (sum((slope * rate).T), max(abs(slope)) * abs(rate).max(-1))
                    for slope in _slopes_at(member, function, z)
                ]
                for member, (z, rate) in zip((numbers[0], numbers[-1]), bodies, strict=False)
            ]
            for body in of(slopes):
                holds = [_is_zero(*slope, exact) for slope in body]
                result = [x and y for x, y in zip(result, holds, strict=True)] if result else holds
            if not any(result):  # decided, as for most forces at the first point
                break
    return result


def _is_zero(slope: Any, scale: Any, exact: bool) -> bool:
    if not exact:
        return bool(np.size(slope) and np.all(abs(slope) <= ZERO * scale))  # not if no rate is finite
    if not isinstance(slope, Fraction | int):
        raise TypeError(f"expected a rational number, got {type(slope).__name__}")
    return slope == 0


def _in_rationals(model: Model) -> Model:
    def rationals(x: Array) -> Array:
        return np.array([Fraction(float(v)) for v in np.ravel(x)], dtype=object).reshape(np.shape(x))

    return Model(model.system, {k: rationals(v) for k, v in model.params.items()})


def _fraction(x: float) -> Fraction:
    return Fraction(round(8 * x), 8)


def _point(models: list[Model], exact: bool, k: int) -> list[tuple[tuple[Array, ...], Array]]:
    """The k-th random state, and the rates there (d,) or (time, d), of one body, or of the two of a pair."""
    rng, number = np.random.default_rng((1, k)), _fraction if exact else float
    model, in_pairs = models[0], pairs_of(models[0]) is not None
    space, n = model.system.space, model.n

    def draw(shape: tuple[int, ...]) -> Array:
        result = np.array([number(v) for v in rng.normal(size=shape).flat])
        return result.reshape(shape)

    times = None if exact or not kicks.perturbation_of(model.system).names(TIME) else TIMES
    t = draw((1,))[0] if times is None else times
    states, bodies, rates = [], [], []
    for member in (models[0], models[-1])[: 1 + in_pairs]:
        states.append(space.point(n, draw))
        turn = algebra.cayley(algebra.skew(draw((n * (n - 1) // 2,)), n))
        state = tuple(_at_times(z, times) for z in states[-1])
        bodies.append(Body(member.system, state, member.constants, member.axes, _at_times(turn, times), t))
        rates.append(kicks.rates(bodies[-1])[0])
    if in_pairs:
        of_pairs, axes = constants_of_pairs(model)
        mean = {k: _mean(v, rng.random(len(v)), number) for k, v in of_pairs.items()}
        first, second = (body._replace(constants=mean, axes=axes) for body in bodies)
        pulled = kicks.pulls((first, second))[:2]
        rates = [tuple(x + y for x, y in zip(*pair, strict=True)) for pair in zip(rates, pulled, strict=True)]
    flat = [algebra.flatten(rate, space.kinds) for rate in rates]
    if times is not None:  # some forces overflow at late times
        finite = np.isfinite(np.concatenate(flat, -1)).all(-1)
        flat = [rate[finite] for rate in flat]
    return list(zip(states, flat, strict=True))


def _at_times(x: Array, times: Array | None) -> Array:
    return x if times is None else np.broadcast_to(x, (len(times), *x.shape))


def _mean(values: Array, weights: Array, number: Callable[[float], Any]) -> Any:
    """A combination of the values of all pairs: an identity for it holds for each, by analyticity."""
    return sum(number(w) * x for w, x in zip(weights, values, strict=True))


def _slopes_at(model: Model, function: Function, state: tuple[Array, ...]) -> list[Array]:
    """The derivative of each part of a function with respect to the independent coordinates of all components.

    It is kept for models that differ in parameters that the function does not name, such as coefficients of a force.
    """
    kinds, n, point = model.system.space.kinds, model.n, algebra.flatten(state, model.system.space.kinds)
    named = [np.asarray(value) for name, value in model.constants.items() if name in keywords(function)]

    def parts_of(numbers: Sequence[Any]) -> list[Any]:
        components = algebra.restore(np.array(numbers, dtype=object), kinds, n)
        values: Any = call(function, components, model.constants)
        return np.asarray(values, dtype=object).ravel().tolist()

    numbers = tuple((x.dtype.str, x.shape, *x.ravel().tolist()) for x in (point, *named))
    key = _slopes_at, Identity(model.system), Identity(function), numbers
    return reused(key, lambda: [np.array(row) for row in value_and_jacobian(parts_of, point.tolist())[1]])
