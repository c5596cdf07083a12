"""method="variational": what it claims of itself, over the registry; a spoiled step is caught."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

import kreisel as kr
import walks
from kreisel import algebra
from kreisel.lab import exact
from kreisel.method import composition, scheme
from kreisel.record.model import Model
from kreisel.system import REGISTRY
from orders import scheme_orders
from sizes import FULL
from support import cpu_engine

SYSTEMS = [name for name, s in REGISTRY.items() if s.inverse_inertia is not None and s.n in (None, 3)]
variational = importlib.import_module("kreisel.method.variational")
ROUNDOFF = 2.0**12 * float(np.finfo(float).eps)


@cache
def random_start(name: str, n: int, seed: int = 0) -> tuple[Model, tuple[np.ndarray, ...]]:
    draw = exact.float_random(np.random.default_rng([seed, n]))
    model = exact.random_model(REGISTRY[name], n, draw)
    return model, REGISTRY[name].space.point(n, draw)


def step(model: Model, z: tuple[np.ndarray, ...], dt: float, order: int = 2) -> tuple[np.ndarray, ...]:
    """The stages one after the other, by the definition, without orientation and defect."""
    for eps in composition.symmetric_composition(order) * dt:
        z = variational.stage(model.system, z, eps, model.constants)[0]
    return z


def off_poisson(name: str, n: int, order: int = 2, dt: float = 0.1) -> float:
    """Largest entry of J Pi(z) J^T - Pi(step(z)), from dual numbers."""
    model, z = random_start(name, n)
    space = model.system.space
    new, J = exact.jacobian(lambda *z: step(model, z, dt, order), z, space.kinds, n)
    J, there = J.astype(float), algebra.restore(np.array([v.value for v in new]), space.kinds, n)
    return float(abs(J @ space.tensor(*z) @ J.T - space.tensor(*there)).max())


def off_symmetry(name: str, n: int, order: int = 2, dt: float = 0.1) -> float:
    model, z = random_start(name, n)
    back = step(model, step(model, z, dt, order), -dt, order)
    return max(float(abs(a - b).max()) for a, b in zip(back, z, strict=True))


def off_casimirs(name: str, n: int, order: int = 2) -> float:
    model, z = random_start(name, n)
    casimirs = model.system.space.casimirs
    return float(abs(casimirs(*step(model, z, 0.1, order)) - casimirs(*z)).max())


def off_order(name: str, n: int, order: int = 2) -> float:
    """Distance of the slope of the error of one step from order + 1."""
    from scipy.integrate import solve_ivp

    model, z = random_start(name, n)
    kinds = model.system.space.kinds
    steps, errors = 0.02 / np.sqrt(2) ** np.arange(4), []
    for dt in steps:
        rate = lambda t, y: algebra.flatten(model.flow(*algebra.restore(y, kinds, n)), kinds)  # noqa: E731
        truth = solve_ivp(rate, (0, dt), algebra.flatten(z, kinds), method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
        errors.append(abs(algebra.flatten(step(model, z, dt, order), kinds) - truth).max())
    return float(abs(np.polyfit(np.log(steps), np.log(errors), 1)[0] - (order + 1)))


@pytest.mark.parametrize("n", [3, 4, 5])
@pytest.mark.parametrize("name", SYSTEMS)
def test_step_by_the_definition(name: str, n: int) -> None:
    assert off_symmetry(name, n) < ROUNDOFF
    assert off_casimirs(name, n) < ROUNDOFF
    assert off_order(name, n) < 0.15
    if n < 5:  # dual numbers are slow
        assert off_poisson(name, n) < ROUNDOFF


@pytest.mark.parametrize("order", [4, 6, 8])
def test_compositions_are_poisson_and_symmetric(order: int) -> None:
    assert off_poisson("heavy-top", 3, order) < ROUNDOFF
    assert off_symmetry("heavy-top", 3, order) < ROUNDOFF


LIE_ALGEBRAS = ("heavy-top", "lagrange-top", "neumann", "euler-top", "rosochatius", "lagrange-top-su2")
ORDERS = [(name, 2) for name in (*LIE_ALGEBRAS, "kovalevskaya-top-sp4")] + [("heavy-top", 4), ("heavy-top", 8)]
ALL_ORDERS = [(name, order) for name in SYSTEMS for order in composition.FIRST_HALVES]


@pytest.mark.parametrize(("name", "order"), ALL_ORDERS if FULL else ORDERS)
def test_order_of_state_and_orientation(name: str, order: int) -> None:
    model, z = random_start(name, 3)
    for slope in scheme_orders(model, z, "variational", order):
        assert abs(slope - order) < 0.15


@pytest.mark.parametrize("order", composition.FIRST_HALVES)
def test_order_conditions(order: int) -> None:
    """sum gamma = 1, sum gamma^k = 0 for odd k < order, and the palindrome."""
    gamma = composition.symmetric_composition(order)
    assert (gamma == gamma[::-1]).all()
    powers = [float((gamma**k).sum()) for k in range(1, order, 2)]
    assert np.allclose(powers, [1] + [0] * (len(powers) - 1), atol=1e-15 * len(gamma))


@pytest.mark.parametrize(
    ("name", "n", "order"),
    [(name, 3, 4) for name in SYSTEMS] + [("heavy-top", 4, 2), *[("heavy-top", 9, 2)] * FULL],
)
def test_kernel_equals_definition(name: str, n: int, order: int) -> None:
    model, x0 = random_start(name, n)
    plan = scheme(model, "variational", 0.1, order, n < 9)
    x0 += {3: (np.array([1.0, 0, 0, 0]),), 4: (np.eye(4),), 9: ()}[n]
    kinds = [kind for _, kind in plan.components]
    z = plan.prepare(x0)
    kernel = cpu_engine(plan, algebra.flatten(z, kinds)[None])
    out = np.empty((3, 1, kernel.z.shape[1]))
    kernel.advance(out, 2)
    for row in out:
        z = plan.advance(*plan.advance(*z))
        flat = algebra.flatten(z, kinds)
        assert abs(row[0] - flat).max() < ROUNDOFF * (1 + abs(flat).max())


@pytest.mark.parametrize("name", SYSTEMS)
def test_casimirs_and_noether_stand_still_and_energy_has_no_trend(name: str) -> None:
    model, z = random_start(name, 3)
    steps = 200_000 if FULL else 60_000
    dt = {"rosochatius": 0.01, "hess-appelrot": 0.01}.get(name, 0.05)  # fast motions
    run = kr.simulate(
        model,
        dict(zip(model.system.space.letters, z, strict=True)),
        dt=dt,
        steps=steps,
        every=100,
        method="variational",
    )
    table = kr.drift(run)
    assert set(table.index[table.conserved].str.split("[").str[0]) == {"casimir", "noether"} & set(run.data_vars)
    walks.assert_still(run)
    energy = table.loc["energy"]
    assert energy.ulps > 100  # it is not kept: the test can fail
    assert abs(energy.slope) * steps * dt < energy.max_change / 5


def test_jacobian_of_the_newton_step_is_the_derivative() -> None:
    """From a guess with error e, one step leaves an error of the order of e^2."""
    model, (M, _) = random_start("kirchhoff", 3)
    turn = lambda N: 0.2 * model.constants["C"] * N  # noqa: E731
    N, _ = variational.newton(turn, M)
    away = algebra.hat(np.array([1.0, -2, 0.5]))
    left = [abs(variational.newton_step(turn, M, N + e * away)[0] - N).max() for e in (1e-2, 1e-3)]
    assert 70 < left[0] / left[1] < 140


def test_an_unsolved_step_ends_the_run_with_the_fix() -> None:
    body = kr.Kirchhoff(C=[[0, 9, 0.2], [9, 0, 1], [0.2, 1, 0]], B=(0.1, 0.5, 0.9))
    x0 = body.state(M=(3, 5, -4), P=(0.6, 0, 0.8))
    with pytest.raises(kr.RunError, match=r"not solved.*at or before step \d+.*smaller dt"):
        kr.simulate(body, x0, dt=1.0, steps=100, method="variational")
    kr.simulate(body, x0, dt=0.001, steps=100, method="variational")


def test_bad_order_and_missing_inertia() -> None:
    model, _ = random_start("heavy-top", 3)
    with pytest.raises(kr.InputError, match=r"orders \(2, 4, 6, 8\)"):
        scheme(model, "variational", 0.1, 3, False)
    incomplete = replace(model.system, inverse_inertia=None)(**model.params)
    with pytest.raises(kr.InputError, match="inverse_inertia"):
        scheme(incomplete, "variational", 0.1, 2, False)


# -- spoiled steps are caught -----------------------------------------------------------------------

RIGHT_KICK, RIGHT_COADJOINT, RIGHT_HALF_TURN = variational.kick, variational.coadjoint, variational.half_turn


def doubled_kick(system, state, time, consts):
    return RIGHT_KICK(system, state, 2 * time, consts)


def kick_before_only(system, state, time, consts):
    kick_before_only.count += 1
    return RIGHT_KICK(system, state, 2 * time, consts) if kick_before_only.count % 2 else state


kick_before_only.count = 0


def still_momentum(system, X, state):
    return (state[0], *RIGHT_COADJOINT(system, X, state)[1:])


def explicit(system, state, eps, consts):
    M = system.space.momentum(*state)
    return eps / 2 * variational.call(system.inverse_inertia, (M,), consts), 0.0


MUTANTS = [
    ("kick", doubled_kick, off_order),
    ("kick", kick_before_only, off_symmetry),
    ("coadjoint", still_momentum, off_casimirs),
    ("half_turn", explicit, off_poisson),
    ("half_turn", explicit, off_symmetry),
    ("NEWTON_STEPS", 1, partial(off_poisson, dt=0.8)),
    ("NEWTON_STEPS", 1, partial(off_symmetry, dt=0.8)),
]


@pytest.mark.parametrize(
    ("part", "mutant", "law"), MUTANTS, ids=[f"{part}-{i}" for i, (part, _, _) in enumerate(MUTANTS)]
)
def test_mutant_is_caught(
    part: str, mutant: object, law: Callable[..., float], monkeypatch: pytest.MonkeyPatch
) -> None:
    bound = 0.15 if law is off_order else ROUNDOFF
    assert law("heavy-top", 3) < bound
    monkeypatch.setattr(variational, part, mutant)
    assert law("heavy-top", 3) > bound
