"""method="midpoint": its equation, orders, symplecticity and integrals; other midpoint rules are caught."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.lab import exact
from kreisel.method import METHODS, composition, default_method, scheme
from kreisel.record.model import Model
from kreisel.system import REGISTRY
from support import cpu_engine

midpoint = importlib.import_module("kreisel.method.midpoint")
CHAINS = ("heisenberg-chain", "spin-chain", "uniaxial-chain")
FREE = ("euler-top", "manakov-top", "zhukovsky-volterra")
H = 0.2

State = tuple[np.ndarray, ...]


def start(name: str, n: int = 3, seed: int = 3) -> tuple[Model, State]:
    draw = exact.float_random(np.random.default_rng([seed, n]))
    return exact.random_model(REGISTRY[name], n, draw), REGISTRY[name].space.point(n, draw)


def step(model: Model, z: State, eps: float = H) -> State:
    return midpoint.advance(model, z, np.float64(eps), model.constants)[0]


def classical(model: Model, z: State, eps: float = H) -> State:
    """The midpoint rule of Euclidean space: w' - w = dt X((w + w')/2)."""
    new = z
    for _ in range(200):
        X = model.flow(*(z_ / 2 + y / 2 for z_, y in zip(z, new, strict=True)))
        new = tuple(x + eps * v for x, v in zip(z, X, strict=True))
    return new


def off_equation(made: State, model: Model, z: State) -> float:
    space = model.system.space
    w, v = (midpoint._spins(space, x) for x in (z, made))
    total = [x + y for x, y in zip(w, v, strict=True)]
    r = np.sqrt(sum(x * x for x in w)) / np.sqrt(sum(x * x for x in total))
    X = midpoint._spins(space, tuple(model.flow(*midpoint._state(space, tuple(r * x for x in total)))))
    return max(float(abs((y - x) / H - rate).max()) for x, y, rate in zip(w, v, X, strict=True))


@pytest.mark.parametrize("name", CHAINS + FREE)
def test_the_step_solves_its_equation_and_is_symmetric(name: str) -> None:
    for n in (3, 6) if name in CHAINS else (3,):
        model, z = start(name, n)
        made = step(model, z)
        assert off_equation(made, model, z) < 1e-13
        assert max(abs(x - y).max() for x, y in zip(step(model, made, -H), z, strict=True)) < 1e-13
        assert off_equation(classical(model, z), model, z) > 1e-8


@pytest.mark.parametrize("name", CHAINS + FREE)
def test_the_step_is_symplectic_on_every_sphere(name: str) -> None:
    model, z = start(name)
    space = model.system.space

    def off(made: Any) -> float:
        new, J = exact.jacobian(lambda *z: made(model, z), z, space.kinds, model.n)
        there = algebra.restore(np.array([v.value for v in new]), space.kinds, model.n)
        J = J.astype(float)
        return float(abs(J @ space.tensor(*z) @ J.T - space.tensor(*there)).max())

    assert off(step) < 1e-12
    assert off(classical) > 1e-8


def test_the_step_commutes_with_turns_of_all_spins() -> None:
    model, z = start("heisenberg-chain", 5)
    R = exact.random_rotation(3, exact.float_random(np.random.default_rng(1)))
    turned = lambda z: tuple(R @ np.stack(z))  # noqa: E731
    assert abs(np.stack(turned(step(model, z))) - np.stack(step(model, turned(z)))).max() < 1e-14


def test_the_energy_of_the_euler_top_over_q() -> None:
    """w' and w are s c + dt X(c)/2 and s c - dt X(c)/2: of equal energy for any s, but not with a rotor."""
    draw = exact.rational_random(np.random.default_rng(0))
    s, eps = draw((2,))
    for name, same in (("euler-top", True), ("zhukovsky-volterra", False)):
        model = exact.random_model(REGISTRY[name], 3, draw)
        c = algebra.hat(draw((3,)))
        X = model.flow(c)[0]
        ends = [model.call(model.system.energy, s * c + sign * eps / 2 * X) for sign in (1, -1)]
        assert (ends[0] == ends[1]) == same


@pytest.mark.parametrize("order", composition.FIRST_HALVES)
@pytest.mark.parametrize("name", ["spin-chain", "zhukovsky-volterra"])
def test_orders(name: str, order: int) -> None:
    model, z = start(name)
    kinds, end = model.system.space.kinds, {"spin-chain": 3.0, "zhukovsky-volterra": 8.0}[name]
    rate = lambda t, y: algebra.flatten(model.flow(*algebra.restore(y, kinds, 3)), kinds)  # noqa: E731
    truth = solve_ivp(rate, (0, end), algebra.flatten(z, kinds), method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    given = dict(zip(model.system.space.letters, z, strict=True))
    errors, counts = [], (12, 14, 16) if order == 8 else (16, 22, 32)
    for count in counts:
        made = model.state(**kr.propagator(model, method="midpoint", order=order, dt=end / count).steps(given, count))
        errors.append(abs(algebra.flatten(tuple(made[k] for k in given), kinds) - truth).max())
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - order) < 0.4


def test_what_is_conserved_does_not_walk() -> None:
    options = {"steps": 100_000, "every": 1000, "method": "midpoint", "progress": False}
    claims = {
        "heisenberg-chain": {"casimir", "total_spin"},
        "uniaxial-chain": {"casimir", "magnetization"},
        "spin-chain": {"casimir"},
        "euler-top": {"casimir", "energy"},
        "zhukovsky-volterra": {"casimir"},
    }
    for name, kept in claims.items():
        model, z = start(name)
        given = dict(zip(model.system.space.letters, z, strict=True))
        for order in (2, 4) if name == "euler-top" else (2,):
            table = kr.drift(kr.simulate(model, given, dt=0.1, order=order, **options))
            assert {name.partition("[")[0] for name in table.index[table.conserved]} >= kept
            assert (table.ulps[table.conserved] < 64).all()
        if "energy" not in kept:
            assert not table.conserved["energy"] and 1e-7 < table.max_change["energy"] < 0.5


def test_a_lane_is_the_run_of_its_own() -> None:
    J = np.array([1.0, 1.5, -0.7])
    draw = exact.float_random(np.random.default_rng(7))
    spins = draw((3, 3, 8))
    options = {"dt": 0.1, "steps": 50, "every": 10, "method": "midpoint", "order": 4, "progress": False}
    run = kr.simulate(kr.HeisenbergChain(n=8, J=J), dict(zip(("Sx", "Sy", "Sz"), spins, strict=True)), **options)
    for lane in range(3):
        own = {k: v[lane] for k, v in zip(("Sx", "Sy", "Sz"), spins, strict=True)}
        alone = kr.simulate(kr.HeisenbergChain(n=8, J=J[lane]), own, **options)
        assert all(np.array_equal(run[k].isel(lane=lane).values, alone[k].values) for k in own)


def test_long_chains_run_in_loops_over_the_sites() -> None:
    for n in (24, 48):
        model, z = start("spin-chain", n)
        plan = scheme(model, "midpoint", 0.1, 2, False)
        engine = cpu_engine(plan, algebra.flatten(plan.prepare(z), plan.kinds)[None])
        out = np.empty((1, 1, engine.z.shape[1]))
        engine.advance(out, 3)
        made = plan.prepare(z)
        for _ in range(3):
            made = plan.advance(*made)
        assert abs(out[0, 0] - algebra.flatten(made, plan.kinds)).max() < 1e-12


def test_the_orientation_turns_with_the_body() -> None:
    top, options = kr.EulerTop(J=(1.0, 2.0, 3.5)), {"orientation": (1, 0, 0, 0), "progress": False}
    x0 = {"M": (0.3, 0.5, 1.1)}
    right = kr.simulate(top, x0, dt=4.0, steps=1, method="exact", **options).g.values[-1]
    for order, counts in {2: (80, 160), 4: (40, 80)}.items():
        off = [
            abs(kr.simulate(top, x0, dt=4 / k, steps=k, method="midpoint", order=order, **options).g.values[-1] - right)
            for k in counts
        ]
        assert abs(np.log2(off[0].max() / off[1].max()) - order) < 0.2


def test_where_it_applies() -> None:
    for name, system in REGISTRY.items():
        model, _ = start(name, system.n or 3)
        assert METHODS["midpoint"].applies(model) == (name in CHAINS + FREE)
        assert (default_method(model) == "midpoint") == (name in CHAINS)
    assert not METHODS["midpoint"].applies(kr.EulerTop(J=(1, 2, 3, 4)))


def test_a_step_that_is_too_long_ends_the_run() -> None:
    model, z = start("heisenberg-chain", 4)
    given = dict(zip(model.system.space.letters, z, strict=True))
    with pytest.raises(kr.RunError, match="not solved to round-off"):
        kr.simulate(model, given, dt=5.0, steps=10, method="midpoint", progress=False)


def test_an_empty_site_is_named() -> None:
    start = {"Sx": (1, 0, 0.6, 0), "Sy": (0, 1, 0, 0), "Sz": (0, 0, 0.8, 0)}
    with pytest.raises(kr.InputError, match="got a spin 0"):
        kr.simulate(kr.SpinChain(n=4), start, dt=0.01, steps=2, method="midpoint")
    run = kr.simulate(kr.SpinChain(n=4), start, dt=0.01, steps=2, method="kahan")
    assert not any(run[name].values[:, 3].any() for name in start)


@pytest.mark.parametrize("M", [np.zeros(3), [(0.1, 0.2, 1.5), (0, 0, 0)]])
def test_a_body_at_rest_is_named(M: Any) -> None:
    with pytest.raises(kr.InputError, match="got a momentum 0"):
        kr.simulate(kr.EulerTop(J=(1, 2, 3)), {"M": M}, dt=0.1, steps=3, method="midpoint", orientation=(1, 0, 0, 0))
