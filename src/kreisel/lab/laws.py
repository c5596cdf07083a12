"""The laws: the claims of a record, tested at random points, exactly over Q and in floats.

    from kreisel.lab import laws
    laws.check(my_system)              # every law that applies, n = 3 and 4, exact and in floats
    laws.LAWS["poisson"]               # one law: its statement and its test

A law compares pairs of sides that must be equal.  In rational arithmetic they must be equal exactly, a
randomized identity test; in floats up to round-off.  Derivatives come from dual values, so they are exact too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import Complex
from kreisel.errors import InputError, explained, shown
from kreisel.lab import exact, law as orders
from kreisel.lab.exact import along, random_rotation, slopes
from kreisel.lab.law import LAWS, ORDER_TOLERANCE, TOLERANCE, Case, Law, Sides, Verdict, law, residual, states
from kreisel.record.calling import call, keywords
from kreisel.record.contract import Frame, System
from kreisel.record.model import Model
from kreisel.runs.settings import within
from kreisel.system import find

__all__ = ["LAWS", "TOLERANCE", "Case", "Law", "Verdict", "check", "drawn_case", "make_case", "test"]

# -- the continuous system -------------------------------------------------------------------------------


@law("z' = {H, z}: the flow is the Hamiltonian field of the energy", "flow energy")
def hamiltonian_flow(case: Case) -> Sides:
    gradient = case.jacobian(case.system.energy, eps=0)[1]
    yield case.flat(case.model.flow(*case.state)), gradient @ case.tensor(case.state)


@law("{f, g} = -{g, f} and {f, {g, h}} + cyclic = 0")
def jacobi_identity(case: Case) -> Sides:
    tensor = case.tensor(case.state)
    derivative = case.jacobian(case.system.space.tensor)[1]
    triple = np.tensordot(tensor, derivative, (1, 2))
    yield tensor, -tensor.T
    yield triple + triple.transpose(1, 2, 0), -triple.transpose(2, 0, 1)


@law("{C, z} = 0 for every Casimir C", "space.casimirs")
def casimirs(case: Case) -> Sides:
    bracket = case.jacobian(case.system.space.casimirs)[1] @ case.tensor(case.state)
    yield bracket, 0 * bracket


@law("d/dt I = 0 along the flow, for the energy and every integral at eps = 0", "flow")
def integrals_of_the_flow(case: Case) -> Sides:
    rate = case.flat(case.model.flow(*case.state))
    for function in case.functions.values():
        change = case.jacobian(function, eps=0)[1] @ rate
        yield change, 0 * change


@law("{I, K} = 0 for the energy and the commuting integrals, at eps = 0 and deformed", "commuting")
def involution(case: Case) -> Sides:
    for eps in (0, case.eps) if case.system.map is not None else (0,):
        functions = (case.functions[name] for name in ("energy", *case.system.commuting))
        gradients = np.concatenate([np.atleast_2d(case.jacobian(f, eps=eps)[1]) for f in functions])
        half = gradients @ np.triu(case.tensor(case.state)) @ gradients.T  # {I_i, I_k} = half_ik - half_ki
        yield half, half.T


@law("L' = [L, U] along the flow", "lax")
def lax_equation(case: Case) -> Sides:
    L, U = case.call(case.system.lax)
    yield case.slope(lambda *z: case.call(case.system.lax, *z)[0]), algebra.bracket(L, U)


@law(
    "a' = omega a (rest frame), P' = -Omega P or [P, Omega] (moving frame): the velocity rotates the carried vectors",
    "velocity",
    unless=lambda s: not _has_turning_components(s),
)
def velocity(case: Case) -> Sides:
    turn, rate = -case.system.space.sign * case.call(case.system.velocity), case.model.flow(*case.state)
    for i in case.system.space.carried:
        yield rate[i], algebra.KINDS[case.kinds[i]].rate(turn, case.state[i])


@law(
    "M' = [M, Omega] + U ^ P, P' = -Omega P, U = dH/dP: with x' = g U, g P and g M g^T - x ^ g P are constant",
    "translation",
)
def translation(case: Case) -> Sides:
    M, P = case.state
    Omega, U = case.call(case.system.velocity), case.call(case.system.translation)
    yield case.jacobian(case.system.energy, eps=0)[1][..., -len(P) :].reshape(-1), U
    yield case.flat(case.model.flow(M, P)), case.flat((algebra.bracket(M, Omega) + algebra.wedge(U, P), -Omega @ P))


@law("z' = kick + rotation: dT/dM is linear, the kick depends only on the carried vectors", "inverse_inertia")
def separable(case: Case) -> Sides:
    space, carried = case.system.space, case.system.space.carried
    momentum: Any = space.momentum
    turn = case.call(case.system.inverse_inertia, momentum(*case.state))
    still = tuple(z if i in carried else 0 * z for i, z in enumerate(case.state))
    parts = zip(space.kinds, case.state, case.model.flow(*still), strict=True)
    yield (
        case.flat(case.model.flow(*case.state)),
        case.flat(tuple(algebra.KINDS[k].rate(-space.sign * turn, z) + kick for k, z, kick in parts)),
    )
    M, N = (algebra.skew(case.draw((case.model.n * (case.model.n - 1) // 2,)), case.model.n) for _ in range(2))
    linear = [case.call(case.system.inverse_inertia, K) for K in (2 * M - N, M, N)]
    yield linear[0], 2 * linear[1] - linear[2]
    if case.system.spin is not None:
        spin = case.call(case.system.spin)
        yield case.call(case.system.velocity), turn + spin
        for i in carried:
            turning = algebra.KINDS[space.kinds[i]].rate(spin, case.state[i])
            yield turning, 0 * turning


def _has_turning_components(system: System) -> bool:
    """Whether there are components that rotate with the body, of kinds that this module knows."""
    kinds = [system.space.kinds[i] for i in system.space.carried if i < len(system.space.kinds)]
    return bool(kinds) and all(kind in ("vector", "skew", "symmetric") for kind in kinds)


def _carried(case: Case, state: tuple[Array, ...]) -> Array:
    """The component that rotates with the body: a, P or x."""
    return state[case.system.space.carried[0]]


@law("f' = k f along the flow for every invariant relation f = 0", "invariant")
def invariant_relations(case: Case) -> Sides:
    for f, k in case.system.invariant.values():
        yield case.slope(lambda *z, f=f: case.call(f, *z)), case.call(k) * case.call(f)


# -- the map ---------------------------------------------------------------------------------------------


@law("I(step(z)) = I(z) for the Casimirs, the deformed energy and every deformed integral", "map")
def integrals_of_the_map(case: Case) -> Sides:
    new = case.call(case.map.step)
    space = case.system.space
    if space.casimirs is not None and (case.map.poisson or "casimir" in (case.map.conserves or ())):
        yield case.call(space.casimirs, *new), case.call(space.casimirs)
    keeps = case.map.conserves
    for function in [f for name, f in case.functions.items() if keeps is None or name in keeps]:
        yield case.call(function, *new), case.call(function)


@law(
    "I -> its continuous form: I(eps) - I(0) = O(eps) for deformed integrals",
    "map flow",
    exact=False,
    unless=lambda s: s.numbers == "jax",
)
def continuous_limit(case: Case) -> Sides:
    for function in case.functions.values():
        if "eps" in keywords(function):
            tiny = case.call(function, eps=1e-12)
            yield tiny, case.call(function, eps=0)
    tiny_step = case.flat(case.call(case.map.step, eps=1e-9))
    yield (tiny_step - case.flat(case.state)) * 1e9 * 1e-6, case.flat(case.model.flow(*case.state)) * 1e-6


@law("V_k L_(k+1) = L_k V_k at random lambda", "map.lax map.conjugator")
def discrete_lax_equation(case: Case) -> Sides:
    V, L = case.call(case.map.conjugator), case.call(case.map.lax)
    yield V @ case.call(case.map.lax, *case.call(case.map.step)), L @ V


@law("U_k L_(k+1) = L_k V_k at random lambda and mu, of a pencil", "map.pencil map.factors")
def discrete_lax_pencil(case: Case) -> Sides:
    mu = case.lam * case.lam + 3
    (U, V), L = case.call(case.map.factors), case.call(case.map.pencil, mu=mu)
    yield U @ case.call(case.map.pencil, *case.call(case.map.step), mu=mu), L @ V


@law("J Pi(z) J^T = Pi(step(z)): the map is Poisson", "map.poisson")
def poisson(case: Case) -> Sides:
    J = case.jacobian(case.map.step)[1]
    yield J @ case.tensor(case.state) @ J.T, case.tensor(case.call(case.map.step))


@law("inverse(step(z)) = z = step(inverse(z))", "map.inverse")
def inverse(case: Case) -> Sides:
    start = case.flat(case.state)
    yield case.flat(case.call(case.map.inverse, *case.call(case.map.step))), start
    yield case.flat(case.call(case.map.step, *case.call(case.map.inverse))), start


@law("adjoint(eps) is the inverse of step(-eps)", "map.adjoint")
def adjoint(case: Case) -> Sides:
    yield case.flat(case.call(case.map.adjoint, *case.call(case.map.step, eps=-case.eps))), case.flat(case.state)


@law("R R = 1, R step R = inverse, and R is anti-Poisson", "map.involution")
def reversing_involution(case: Case) -> Sides:
    R, step, start = case.map.involution, case.map.step, case.flat(case.state)
    turned = case.call(R)
    yield case.flat(case.call(R, *turned)), start
    yield case.flat(case.call(R, *case.call(step, *case.call(R, *case.call(step))))), start
    J = case.jacobian(R)[1]
    yield J @ case.tensor(case.state) @ J.T, -case.tensor(turned)


@law("S(eps) S(-eps) = 1 for S = chi step chi^-1, chi half a kick", "map.to_symmetric")
def symmetric_conjugate(case: Case) -> Sides:
    def symmetric(state: tuple[Array, ...], eps: Any) -> tuple[Array, ...]:
        inner = case.call(case.map.from_symmetric, *state, eps=eps)
        return tuple(case.call(case.map.to_symmetric, *case.call(case.map.step, *inner, eps=eps), eps=eps))

    back = case.call(case.map.from_symmetric, *case.call(case.map.to_symmetric))
    yield case.flat(back), case.flat(case.state)
    yield case.flat(symmetric(symmetric(case.state, -case.eps), case.eps)), case.flat(case.state)


@law("w = cay(X) is orthogonal and rotates the carried vectors: a_(k+1) = w a_k, P_(k+1) = W^T P_k", "map.generator")
def reconstruction(case: Case) -> Sides:
    new = case.call(case.map.step)
    X = case.call(case.map.generator, *case.state, *new)
    yield X, -X.mT
    sign = 1 if case.system.frame is Frame.REST else -1
    for i in case.system.space.carried if _has_turning_components(case.system) else ():
        yield algebra.KINDS[case.kinds[i]].turned(sign * X, case.state[i]), new[i]


@law(
    "D1 L(q_k, q_(k+1)) + D2 L(q_(k-1), q_k) = 0 and the momentum is D2 L(q_(k-1), q_k)", "map.generator map.lagrangian"
)
def discrete_euler_lagrange(case: Case) -> Sides:
    n, in_rest_frame = case.model.n, case.system.frame is Frame.REST
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
        g = g0.mT if in_rest_frame else g0
        places = case.system.space.carried
        carried = tuple(algebra.KINDS[case.kinds[i]].rotated(g, first[i]) for i in places)
        momentum = second[0]

    # exp(eta) g (rest frame), g exp(eta) (moving frame) or exp(-eta) x, to first order in eta's coordinates
    zero = 0 * algebra.coordinates(q1 if q1.ndim == 2 else algebra.wedge(q1, q1))
    eta = algebra.skew(exact.independent(zero), n)
    q = q1 - algebra.act(eta, q1) if q1.ndim == 1 else q1 + (eta @ q1 if in_rest_frame else q1 @ eta)
    before, after = (
        slopes(case.call(case.map.lagrangian, *pair, *carried), n * (n - 1) // 2) for pair in ((q0, q), (q, q2))
    )
    yield before + after, 0 * before
    yield before, algebra.coordinates(momentum)


def _turned_by_generator(case: Case, g: Array, old: tuple[Array, ...], new: tuple[Array, ...]) -> Array:
    X = case.call(case.map.generator, *old, *new)
    return algebra.turn_left(X, g) if case.system.frame is Frame.REST else algebra.turn_right(g, X)


@law("the same motion in the related system: flows, and maps if the record states it", "relations")
def relations(case: Case) -> Sides:
    g = random_rotation(case.model.n, case.draw)
    for relation in case.system.relations:
        if case.numbers == "exact" and not relation.exact:
            continue

        def carry(state: tuple[Array, ...], g: Array, relation: Any = relation) -> tuple[tuple[Array, ...], Any]:
            return call(relation.carry, (*state, g), case.model.constants)

        target = find(relation.target)
        target_state, params = carry(case.state, g)
        model = target(**params)
        kinds = target.space.kinds
        rate, omega = case.model.flow(*case.state), case.call(case.system.velocity)
        g_rate = omega @ g if case.system.frame is Frame.REST else g @ omega
        moving = tuple(along(z, r) for z, r in zip(case.state, rate, strict=True))
        carried = slopes(algebra.flatten(carry(moving, along(g, g_rate))[0], kinds), 1)[..., 0]
        yield carried, algebra.flatten(model.flow(*target_state), kinds)
        if relation.map is not None and (case.numbers == "float" or case.map.rational):
            new = case.call(case.map.step)
            moved = carry(new, _turned_by_generator(case, g, case.state, new))[0]
            expected = model.call(getattr(model.map, relation.map), *target_state, eps=case.eps)
            yield algebra.flatten(moved, kinds), algebra.flatten(expected, kinds)


@law("x_(k+1) from (x_(k-1), x_k) is the same as from (x_k, q_k)", "map.second_order")
def second_order_form(case: Case) -> Sides:
    second = case.call(case.map.step)
    third = case.call(case.map.step, *second)
    yield case.call(case.map.second_order, case.state[0], second[0]), third[0]


@law("step(eps) step(delta) = step(delta) step(eps), and step(eps) commutes with the flow", "map.commutes")
def commuting_maps(case: Case) -> Sides:
    def step(eps: Any) -> Callable[..., tuple[Array, ...]]:
        return lambda *z: tuple(case.call(case.map.step, *z, eps=eps))

    first, second = step(case.eps), step(-case.eps / 2)
    yield case.flat(first(*second(*case.state))), case.flat(second(*first(*case.state)))
    time = float(case.eps)
    yield (
        case.flat(orders.flowed(case.model, first(*case.state), time)),
        case.flat(first(*orders.flowed(case.model, case.state, time))),
    )


@law(
    "the error at a fixed time is O(dt^order), and O(dt^2) after half a kick, in the state and in g",
    "map flow energy",
    exact=False,  # rates of lattices at random states are unbounded
    unless=lambda s: bool(s.space.sites) or (s.velocity is None and states(s, "map.generator")),
)
def order(case: Case) -> Sides:
    conjugates = [(True, 2)] if case.map.to_symmetric is not None else []
    for conjugate, claimed in [(False, case.map.order), *conjugates]:
        counts, time = ((16, 32, 64, 128), 0.125) if claimed < 3 else ((8, 16, 32, 64), 0.5)  # errors above rounding
        for slope in orders.measured_orders(case.model, case.state, conjugate, counts, time):
            yield _distance(slope, claimed), 0.0


def _distance(slope: float, order: int) -> Array:
    """The distance of a measured order, 0 within the tolerance."""
    off = abs(slope - order)
    return np.asarray(0.0 if off < ORDER_TOLERANCE else off)


# -- Bäcklund transformations ----------------------------------------------------------------------------


@dataclass(frozen=True)
class _Curve:
    """A state with a point (mu, rho) of its spectral curve, and maps from it; `eigenvector`: of a rational case."""

    model: Model
    record: Any
    state: tuple[Array, ...]
    mu: Any
    rho: Any
    eigenvector: Array = None

    def call(self, function: Any, *arguments: Array, **extra: Any) -> Any:
        return self.model.call(function, *arguments, **{"mu": self.mu, "rho": self.rho, **extra})

    def at(self, mu: Any) -> _Curve:
        """The curve at mu of this state, with the rho on the near branch; floats only."""
        return replace(self, mu=mu, rho=self.model.call(self.record.point, *self.state, mu=mu)[()])

    def move(self, *state: Array) -> tuple[Array, ...]:
        """D_eps, or the conjugate pair for a complex mu, from this state or another on the curve."""
        state = state or self.state
        e = self.call(self.record.vector, *state)
        pair = isinstance(self.mu, complex | Complex)
        return tuple(self.call(self.record.pair if pair else self.record.step, *state, e))


def _point_on_curve(case: Case) -> _Curve:
    """In exact values a random rational point; in floats the case's own state with eps = 2/7."""
    if case.numbers == "exact":
        return _rational(case, "case")
    return _Curve(case.model, case.system.baecklund, case.state, 7.0, None).at(7.0)


def _pairs(case: Case) -> list[_Curve]:
    """Complex points: in exact arithmetic a random one over Q(i), in floats two of the case's own state."""
    if case.numbers == "exact":
        return [_rational(case, "pair_case")]
    return [_point_on_curve(case).at(mu) for mu in (7 + 4j, 2 + 1.5j)]


def _rational(case: Case, entry: str) -> _Curve:
    make = getattr(case.system.baecklund, entry)
    if make is None:
        raise InputError(f"{case.system.name} does not state the {entry} of its Bäcklund transformation.")
    state, params, e, mu, rho = make(case.model.n, case.draw)
    return _Curve(case.system(**params), case.system.baecklund, state, mu, rho, e)


@law("(mu, rho) lies on the spectral curve; e is the eigenvector that a rational case is made from", "baecklund")
def spectral_point(case: Case) -> Sides:
    curve = _point_on_curve(case)
    e = curve.call(curve.record.vector, *curve.state)
    value = curve.call(curve.record.defect, *curve.state, e)
    yield value, 0 * value
    if curve.eigenvector is not None:
        yield e, curve.eigenvector


@law("I(D(z)) = I(z) for the Casimirs and every integral of the continuous flow", "baecklund")
def integrals_of_baecklund(case: Case) -> Sides:
    for curve in (_point_on_curve(case), _pairs(case)[0]):
        new = curve.move()
        yield tuple(curve.call(case.system.space.casimirs, *z) for z in (new, curve.state))
        for function in (case.system.energy, *case.system.integrals.values()):
            yield curve.call(function, *new), curve.call(function, *curve.state)


@law("N L = L_new N at random lambda: the Darboux matrix", "baecklund")
def darboux(case: Case) -> Sides:
    curve = _point_on_curve(case)
    e = curve.call(curve.record.vector, *curve.state)
    N = curve.call(curve.record.darboux, *curve.state, e, lam=case.lam)
    old, new = (curve.call(case.system.lax, *z, lam=case.lam)[0] for z in (curve.state, curve.move()))
    yield N @ old, new @ N


@law("J Pi(z) J^T = Pi(D(z)), the derivative of rho included", "baecklund")
def poisson_baecklund(case: Case) -> Sides:
    curve = _point_on_curve(case)
    flat = case.flat(curve.state)
    new = curve.move(*algebra.restore(exact.independent(flat), case.kinds, curve.model.n))  # Newton's step has d rho
    J = slopes(algebra.flatten(new, case.kinds), len(flat))
    yield J @ case.tensor(curve.state) @ J.T, case.tensor(curve.move())


@law("D(-eps) is the inverse of D(eps)", "baecklund")
def symmetric_baecklund(case: Case) -> Sides:
    curve = _point_on_curve(case)
    sign = curve.record.odd
    back = replace(curve, state=curve.move(), mu=-curve.mu, rho=sign * curve.rho)
    yield case.flat(back.move()), case.flat(curve.state)


@law("D(eps) D(delta) = D(delta) D(eps), and D(eps) commutes with the flow", "baecklund", exact=False)
def commuting_baecklund(case: Case) -> Sides:
    curve = _point_on_curve(case)
    first, second = curve, curve.at(5.0)
    yield case.flat(second.move(*first.move())), case.flat(first.move(*second.move()))

    def flow(state: tuple[Array, ...]) -> tuple[Array, ...]:
        return orders.flowed(curve.model, state, 0.3)

    yield case.flat(flow(first.move())), case.flat(first.move(*flow(curve.state)))
    pair = curve.at(7 + 4j)
    yield case.flat(flow(pair.move())), case.flat(pair.move(*flow(curve.state)))


@law("the paper's map is D(eps) in other variables, at its point of the spectral curve", "baecklund map.darboux")
def map_is_baecklund(case: Case) -> Sides:
    *state, rho = case.call(case.map.darboux)
    *after, rho_after = case.call(case.map.darboux, *case.call(case.map.step))
    curve = _Curve(case.model, case.system.baecklund, tuple(state), 2 / case.eps, rho)
    yield case.flat(curve.move()), case.flat(tuple(after))
    yield rho, rho_after


@law("a conjugate pair in real arithmetic is the product of the two complex maps; N2 N1 L = L_new N2 N1", "baecklund")
def conjugate_pair(case: Case) -> Sides:
    for pair in _pairs(case):
        first = pair.call(pair.record.vector, *pair.state)
        between = pair.call(pair.record.step, *pair.state, first)
        conjugate = {"mu": algebra.conjugate(pair.mu), "rho": algebra.conjugate(pair.rho)}
        second = pair.call(pair.record.vector, *between, **conjugate)
        re, im = algebra.parts(case.flat(tuple(pair.call(pair.record.step, *between, second, **conjugate))))
        yield re, case.flat(pair.move())
        yield im, 0 * re
        arc = pair.call(pair.record.arc_of_pair, *pair.state, first)
        carried = _carried(case, pair.state)
        unit = algebra.identity(len(carried)) + 0 * carried[:, None]
        turned = algebra.double_turn(arc[0], arc[1], unit) @ carried
        yield turned, _carried(case, pair.move())
        N1 = pair.call(pair.record.darboux, *pair.state, first, lam=case.lam)
        N2 = pair.call(pair.record.darboux, *between, second, lam=case.lam, **conjugate)
        old, new = (pair.call(case.system.lax, *z, lam=case.lam)[0] for z in (pair.state, pair.move()))
        yield from zip(algebra.parts(N2 @ N1 @ old), algebra.parts(new @ (N2 @ N1)), strict=True)


@law("the error of K maps is O(dt^(2K)) in the state and in g, for K = 1 to 3", "baecklund", exact=False)
def order_baecklund(case: Case) -> Sides:
    for order, counts in ((2, (8, 12, 16, 24)), (4, (6, 8, 12, 16)), (6, (4, 6, 8, 12))):
        for slope in orders.baecklund_orders(case.model, case.state, order, counts):
            yield _distance(slope, order), 0.0


# -- testing ---------------------------------------------------------------------------------------------


def make_case(system: System | Model, n: int, numbers: str, seed: int) -> Case:
    """A random state and step, and random parameters unless a model is given; `numbers` is "exact" or "float"."""
    record = system.system if isinstance(system, Model) else system
    if numbers == "exact" and record.numbers != "any":
        raise InputError(
            f"{record.name} accepts only floats (numbers = {shown(record.numbers)}); use numbers=('float',)."
        )
    if numbers not in ("exact", "float"):
        raise InputError(f"numbers must be 'exact' or 'float', got {shown(numbers)}.")
    rng = np.random.default_rng([within(seed, "seed", 0, 2**63 - 1), n])
    draw = exact.rational_random(rng) if numbers == "exact" else exact.float_random(rng)
    return drawn_case(system, n, numbers, draw)


def drawn_case(system: System | Model, n: int, numbers: str, draw: exact.Random) -> Case:
    """A case with random values from `draw`."""
    record = system.system if isinstance(system, Model) else system
    model = system if isinstance(system, Model) else exact.random_model(system, n, draw)
    if isinstance(system, Model) and numbers == "exact":  # its floats as the rationals that they are
        letters = [p.letter for p in record.parameters if p.kind in algebra.KINDS and p.kind != "dimension"]
        values = {k: exact.rationals(v) for k, v in model.params.items() if k in letters and v.dtype.kind == "f"}
        model = record(**{**model.params, **values}) if values else model
    state = record.space.point(n, draw)
    eps = abs(draw((1,)))[0] / 4  # short enough for the logarithms of Lagrangians in floats
    if record.map is not None and record.map.largest_step is not None and numbers == "float":
        eps = min(eps, model.largest_step(*state) / 4)
    lam = draw((1,))[0] * 97 / 89  # no parameter is drawn with such a denominator: Lax matrices have poles there
    return Case(model, state, eps, lam, draw, numbers)


def test(law: Law, case: Case, seed: int = 0) -> Verdict:
    """One law at one case."""
    off = residual(law.sides(case), case.numbers)
    holds = off == 0 if case.numbers == "exact" else off < TOLERANCE
    return Verdict(case.system.name, law.name, case.model.n, case.numbers, seed, off, holds)


@explained
def check(
    system: System | Model,
    dimensions: Iterable[int] = (3, 4),
    numbers: Iterable[str] = ("exact", "float"),
    seeds: Iterable[int] = (0,),
) -> list[Verdict]:
    """Every law that applies to a system, or to a system with its parameters, for each n, kind of number and seed.

    A record of kreisel.reduction is tested in floats, in the n of the record.
    """
    record = system.system if isinstance(system, Model) else system
    kinds = tuple(kind for kind in numbers if kind == "float" or record.numbers == "any")
    chosen, out = tuple(seeds), []
    fixed = system.n if isinstance(system, Model) else record.n
    for n in dimensions if fixed is None else (fixed,):
        for kind in kinds:
            for seed in chosen:
                case = make_case(system, n, kind, seed)
                laws = [law for law in LAWS.values() if law.needs(record) and kind in law.numbers(record)]
                out += [test(law, case, seed) for law in laws]
    return out
