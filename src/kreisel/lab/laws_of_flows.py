"""Laws of the continuous system."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.lab.exact import along, jacobian, slopes
from kreisel.lab.law import Case, Sides, _functions, _has_flow, _has_map, _integral_gradients, _law
from kreisel.record.contract import System


@_law("z' = {H, z}: the flow is the Hamiltonian field of the energy", _has_flow)
def hamiltonian_flow(case: Case) -> Sides:
    gradient = case.jacobian(case.system.energy, eps=0)[1]
    yield case.flat(case.model.flow(*case.state)), gradient @ case.tensor(case.state)


@_law("{f, g} = -{g, f} and {f, {g, h}} + cyclic = 0")
def jacobi_identity(case: Case) -> Sides:
    tensor = case.tensor(case.state)
    derivative = jacobian(lambda *z: case.tensor(z), case.state, case.kinds, case.model.n)[1]
    triple = np.tensordot(tensor, derivative, (1, 2))
    yield tensor, -tensor.T
    yield triple + triple.transpose(1, 2, 0), -triple.transpose(2, 0, 1)


@_law("{C, z} = 0 for every Casimir C", lambda s: s.space.casimirs is not None)
def casimirs(case: Case) -> Sides:
    gradients = jacobian(lambda *z: case.call(case.system.space.casimirs, *z), case.state, case.kinds, case.model.n)[1]
    bracket = gradients @ case.tensor(case.state)
    yield bracket, 0 * bracket


@_law("d/dt I = 0 along the flow, for the energy and every integral at eps = 0", lambda s: s.flow is not None)
def integrals_of_the_flow(case: Case) -> Sides:
    rate = case.flat(case.model.flow(*case.state))
    for function in _functions(case.system).values():
        change = case.jacobian(function, eps=0)[1] @ rate
        yield change, 0 * change


@_law("{I, K} = 0 for the energy and the commuting integrals, at eps = 0 and deformed", lambda s: bool(s.commuting))
def involution(case: Case) -> Sides:
    for eps in (0, case.eps) if _has_map(case.system) else (0,):
        all_integral_gradients = np.concatenate([g for _, g in _integral_gradients(case, eps)])
        half = (
            all_integral_gradients @ np.triu(case.tensor(case.state)) @ all_integral_gradients.T
        )  # {I_i, I_k} = half_ik - half_ki
        yield half, half.T


@_law("L' = [L, U] along the flow", lambda s: s.lax is not None)
def lax_equation(case: Case) -> Sides:
    L, U = case.call(case.system.lax)
    rate = case.model.flow(*case.state)
    moving = tuple(along(z, r) for z, r in zip(case.state, rate, strict=True))
    yield slopes(case.call(case.system.lax, *moving)[0], 1)[..., 0], algebra.bracket(L, U)


@_law(
    "a' = omega a (rest frame), P' = -Omega P or [P, Omega] (moving frame): the velocity turns what is carried",
    lambda s: s.velocity is not None and _has_turning_components(s),
)
def velocity(case: Case) -> Sides:
    turn, rate = -case.system.space.sign * case.call(case.system.velocity), case.model.flow(*case.state)
    for i in case.system.space.carried:
        yield rate[i], algebra.rate(case.kinds[i], turn, case.state[i])


@_law(
    "M' = [M, Omega] + U ^ P, P' = -Omega P, U = dH/dP: with x' = g U, g P and g M g^T - x ^ g P are constant",
    lambda s: s.translation is not None,
)
def translation(case: Case) -> Sides:
    M, P = case.state
    Omega, U = case.call(case.system.velocity), case.call(case.system.translation)
    yield case.jacobian(case.system.energy, eps=0)[1][..., -len(P) :].reshape(-1), U
    yield case.flat(case.model.flow(M, P)), case.flat((algebra.bracket(M, Omega) + algebra.wedge(U, P), -Omega @ P))


@_law(
    "z' = kick + turn: dT/dM is linear, the kick depends on what is carried alone",
    lambda s: s.inverse_inertia is not None,
)
def separable(case: Case) -> Sides:
    space, carried = case.system.space, case.system.space.carried
    momentum: Any = space.momentum
    turn = case.call(case.system.inverse_inertia, momentum(*case.state))
    still = tuple(z if i in carried else 0 * z for i, z in enumerate(case.state))
    parts = zip(space.kinds, case.state, case.model.flow(*still), strict=True)
    yield (
        case.flat(case.model.flow(*case.state)),
        case.flat(tuple(algebra.rate(k, -space.sign * turn, z) + kick for k, z, kick in parts)),
    )
    M, N = (algebra.skew(case.draw((case.model.n * (case.model.n - 1) // 2,)), case.model.n) for _ in range(2))
    linear = [case.call(case.system.inverse_inertia, K) for K in (2 * M - N, M, N)]
    yield linear[0], 2 * linear[1] - linear[2]
    if case.system.spin is not None:
        spin = case.call(case.system.spin)
        yield case.call(case.system.velocity), turn + spin
        for i in carried:
            turning = algebra.rate(space.kinds[i], spin, case.state[i])
            yield turning, 0 * turning


def _has_turning_components(system: System) -> bool:
    """Whether there are components that turn with the body, of kinds that this module knows."""
    kinds = [system.space.kinds[i] for i in system.space.carried if i < len(system.space.kinds)]
    return bool(kinds) and all(kind in ("vector", "skew", "symmetric") for kind in kinds)


def _carried(case: Case, state: tuple[Array, ...]) -> Array:
    """The component that turns with the body: a, P or x."""
    return state[case.system.space.carried[0]]


@_law("f' = k f along the flow for every invariant relation f = 0", lambda s: bool(s.invariant))
def invariant_relations(case: Case) -> Sides:
    rate = case.model.flow(*case.state)
    moving = tuple(along(z, r) for z, r in zip(case.state, rate, strict=True))
    for f, k in case.system.invariant.values():
        yield slopes(case.call(f, *moving), 1)[..., 0], case.call(k) * case.call(f)
