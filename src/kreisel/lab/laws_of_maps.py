"""Laws of the map."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.lab import exact
from kreisel.lab.exact import along, random_rotation, slopes
from kreisel.lab.law import (
    ORDER_TOLERANCE,
    Case,
    Sides,
    _conserved_functions,
    _functions,
    _has_flow,
    _has_map,
    _has_map_with,
    _law,
)
from kreisel.lab.laws_of_flows import _carried, _has_turning_components
from kreisel.lab.orders import flowed, measured_orders
from kreisel.record.calling import call, keywords
from kreisel.record.contract import Frame


@_law("I(step(z)) = I(z) for the Casimirs, the deformed energy and every deformed integral", _has_map)
def integrals_of_the_map(case: Case) -> Sides:
    new = case.call(case.map.step)
    space = case.system.space
    if space.casimirs is not None:
        yield space.casimirs(*new), space.casimirs(*case.state)
    for function in _conserved_functions(case.system):
        yield np.asarray(case.call(function, *new)), np.asarray(case.call(function))


@_law(
    "I -> its continuous form: I(eps) - I(0) = O(eps) for deformed integrals",
    lambda s: s.map is not None and s.flow is not None and s.numbers != "jax",
    exact=False,
)
def continuous_limit(case: Case) -> Sides:
    for function in _functions(case.system).values():
        if "eps" in keywords(function):
            tiny = case.call(function, eps=1e-12)
            yield np.asarray(tiny), np.asarray(case.call(function, eps=0))
    tiny_step = case.flat(case.call(case.map.step, eps=1e-9))
    yield (tiny_step - case.flat(case.state)) * 1e9 * 1e-6, case.flat(case.model.flow(*case.state)) * 1e-6


@_law("V_k L_(k+1) = L_k V_k at random lambda", _has_map_with("lax", "conjugator"))
def discrete_lax_equation(case: Case) -> Sides:
    V, L = case.call(case.map.conjugator), case.call(case.map.lax)
    yield V @ case.call(case.map.lax, *case.call(case.map.step)), L @ V


@_law("J Pi(z) J^T = Pi(step(z)): the map is Poisson", _has_map)
def poisson(case: Case) -> Sides:
    J = case.jacobian(case.map.step)[1]
    yield J @ case.tensor(case.state) @ J.T, case.tensor(case.call(case.map.step))


@_law("inverse(step(z)) = z = step(inverse(z))", _has_map_with("inverse"))
def inverse(case: Case) -> Sides:
    start = case.flat(case.state)
    yield case.flat(case.call(case.map.inverse, *case.call(case.map.step))), start
    yield case.flat(case.call(case.map.step, *case.call(case.map.inverse))), start


@_law("adjoint(eps) is the inverse of step(-eps)", _has_map_with("adjoint"))
def adjoint(case: Case) -> Sides:
    yield case.flat(case.call(case.map.adjoint, *case.call(case.map.step, eps=-case.eps))), case.flat(case.state)


@_law("R R = 1, R step R = inverse, and R is anti-Poisson", _has_map_with("involution"))
def reversing_involution(case: Case) -> Sides:
    R, step, start = case.map.involution, case.map.step, case.flat(case.state)
    turned = case.call(R)
    yield case.flat(case.call(R, *turned)), start
    yield case.flat(case.call(R, *case.call(step, *case.call(R, *case.call(step))))), start
    J = case.jacobian(R)[1]
    yield J @ case.tensor(case.state) @ J.T, -case.tensor(turned)


@_law("S(eps) S(-eps) = 1 for S = chi step chi^-1, chi half a kick", _has_map_with("to_symmetric", "from_symmetric"))
def symmetric_conjugate(case: Case) -> Sides:
    def symmetric(state: tuple[Array, ...], eps: Any) -> tuple[Array, ...]:
        inner = case.call(case.map.from_symmetric, *state, eps=eps)
        return tuple(case.call(case.map.to_symmetric, *case.call(case.map.step, *inner, eps=eps), eps=eps))

    back = case.call(case.map.from_symmetric, *case.call(case.map.to_symmetric))
    yield case.flat(back), case.flat(case.state)
    yield case.flat(symmetric(symmetric(case.state, -case.eps), case.eps)), case.flat(case.state)


@_law(
    "w = cay(X) is orthogonal and turns what is carried: a_(k+1) = w a_k, P_(k+1) = W^T P_k", _has_map_with("generator")
)
def reconstruction(case: Case) -> Sides:
    new = case.call(case.map.step)
    X = case.call(case.map.generator, *case.state, *new)
    yield X, -X.mT
    sign = 1 if case.system.frame is Frame.REST else -1
    for i in case.system.space.carried if _has_turning_components(case.system) else ():
        yield algebra.turned(case.kinds[i], sign * X, case.state[i]), new[i]


@_law(
    "D1 L(q_k, q_(k+1)) + D2 L(q_(k-1), q_k) = 0 and the momentum is D2 L(q_(k-1), q_k)",
    _has_map_with("generator", "lagrangian"),
)
def discrete_euler_lagrange(case: Case) -> Sides:
    n, rest = case.model.n, case.system.frame is Frame.REST
    g0 = random_rotation(n, case.draw)
    first, second = case.state, case.call(case.map.step)
    third = case.call(case.map.step, *second)
    g1 = _turned_by_generator(case, g0, first, second)
    g2 = _turned_by_generator(case, g1, second, third)
    if case.system.space.constraints:  # the particle: q is its position
        q0, q1, q2, x = (_carried(case, z) for z in (first, second, third, first))
        carried: tuple[Array, ...] = (x,)
        momentum = algebra.wedge(*second)
    else:
        q0, q1, q2 = g0, g1, g2
        g = g0.mT if rest else g0
        places = case.system.space.carried
        carried = tuple(g @ first[i] if case.kinds[i] == "vector" else g @ first[i] @ g.mT for i in places)
        momentum = second[0]

    def action(function_of: Callable[[Array], tuple[Array, Array]]) -> Array:
        varied = function_of(_perturbed_orientation(q1, rest, n))
        return slopes(case.call(case.map.lagrangian, *varied, *carried), n * (n - 1) // 2)

    before, after = action(lambda q: (q0, q)), action(lambda q: (q, q2))
    yield before + after, 0 * before
    yield before, algebra.coordinates(momentum)


def _turned_by_generator(case: Case, g: Array, old: tuple[Array, ...], new: tuple[Array, ...]) -> Array:
    X = case.call(case.map.generator, *old, *new)
    return algebra.turn_left(X, g) if case.system.frame is Frame.REST else algebra.turn_right(g, X)


def _perturbed_orientation(q: Array, rest: bool, n: int) -> Array:
    """exp(eta) g (rest frame), g exp(eta) (moving frame) or exp(-eta) x, to first order in eta's coordinates."""
    zero = 0 * algebra.coordinates(q if q.ndim == 2 else algebra.wedge(q, q))
    eta = algebra.skew(exact.independent(zero), n)
    if q.ndim == 1:
        return q - algebra.act(eta, q)
    return q + (eta @ q if rest else q @ eta)


@_law("the same motion in the related system: flows, and maps where the record says so", lambda s: bool(s.relations))
def relations(case: Case) -> Sides:
    from kreisel.system import find

    g = random_rotation(case.model.n, case.draw)
    for relation in case.system.relations:
        if case.numbers == "exact" and not relation.exact:
            continue

        def carry(state: tuple[Array, ...], g: Array, relation: Any = relation) -> tuple[tuple[Array, ...], Any]:
            return call(relation.carry, (*state, g), case.model.constants)

        target = find(relation.target)
        there, params = carry(case.state, g)
        model = target(**params)
        kinds = target.space.kinds
        rate, omega = case.model.flow(*case.state), case.call(case.system.velocity)
        g_rate = omega @ g if case.system.frame is Frame.REST else g @ omega
        moving = tuple(along(z, r) for z, r in zip(case.state, rate, strict=True))
        carried = slopes(algebra.flatten(carry(moving, along(g, g_rate))[0], kinds), 1)[..., 0]
        yield carried, algebra.flatten(model.flow(*there), kinds)
        if relation.map is not None and (case.numbers == "float" or case.map.rational):
            new = case.call(case.map.step)
            moved = carry(new, _turned_by_generator(case, g, case.state, new))[0]
            expected = model.call(getattr(model.map, relation.map), *there, eps=case.eps)
            yield algebra.flatten(moved, kinds), algebra.flatten(expected, kinds)


@_law(
    "x_(k+1) from (x_(k-1), x_k) is the same as from (x_k, q_k)",
    lambda s: s.map is not None and s.map.second_order is not None,
)
def second_order_form(case: Case) -> Sides:
    second = case.call(case.map.step)
    third = case.call(case.map.step, *second)
    yield case.call(case.map.second_order, case.state[0], second[0]), third[0]


@_law(
    "step(eps) step(delta) = step(delta) step(eps), and step(eps) commutes with the flow",
    lambda s: s.map is not None and s.map.commutes,
)
def commuting_maps(case: Case) -> Sides:
    def step(eps: Any) -> Callable[..., tuple[Array, ...]]:
        return lambda *z: tuple(case.call(case.map.step, *z, eps=eps))

    first, second = step(case.eps), step(-case.eps / 2)
    yield case.flat(first(*second(*case.state))), case.flat(second(*first(*case.state)))
    time = float(case.eps)
    yield (
        case.flat(flowed(case.model, first(*case.state), time)),
        case.flat(first(*flowed(case.model, case.state, time))),
    )


@_law(
    "the error at a fixed time is O(dt^order), and O(dt^2) after half a kick, in the state and in g",
    lambda s: _has_flow(s) and _has_map_with("generator")(s),
    exact=False,
)
def order(case: Case) -> Sides:
    conjugates = [(True, 2)] if case.map.to_symmetric is not None else []
    for conjugate, claimed in [(False, case.map.order), *conjugates]:
        for slope in measured_orders(case.model, case.state, conjugate):
            off = abs(slope - claimed)
            yield np.asarray(0.0 if off < ORDER_TOLERANCE else off), np.asarray(0.0)
