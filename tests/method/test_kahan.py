"""method="kahan": its equation, its inverse and its integrals over Q, its orders, its errors; spoiled steps are caught."""

from __future__ import annotations

import sys
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.kernels import layout
from kreisel.lab import exact
from kreisel.method import METHODS, composition, default_method, scheme
from kreisel.record.model import Model
from kreisel.system import REGISTRY

kahan = sys.modules["kreisel.method.kahan"]
CUBIC = {"neumann", "neumann-veselov", "rosochatius"}
QUADRATIC = sorted(set(REGISTRY) - CUBIC)
EPS = exact.rational(2, 7)
J = (1.0, 2.0, 3.5)
M = (0.3, 0.5, 1.1)

State = tuple[np.ndarray, ...]


def start(name: str, n: int = 3, numbers: str = "exact") -> tuple[Model, State]:
    rng = np.random.default_rng([3, n])
    draw = exact.rational_random(rng) if numbers == "exact" else exact.float_random(rng)
    model = exact.random_model(REGISTRY[name], n, draw)
    return model, exact.random_state(REGISTRY[name].space, n, draw)


def step(model: Model, z: State, eps: Any) -> State:
    return kahan.advance(model, z, eps, model.constants)[0]


def flat(model: Model, z: State) -> np.ndarray:
    return layout.flatten(z, model.system.space.kinds)


def off_equation(name: str, n: int, share: Any = exact.rational(1, 2)) -> list[Any]:
    """(x' - x)/eps - Q(x, x') - B (x + x')/2 - c, where 2 Q(x, y) = f(x + y) - f(x) - f(y) + f(0)."""
    model, z = start(name, n)
    kinds = model.system.space.kinds
    x, y = flat(model, z), flat(model, step(model, z, EPS))
    f = lambda v: flat(model, tuple(model.flow(*layout.restore(v, kinds, n))))  # noqa: E731
    B = lambda v: (f(v) - f(-v)) / 2  # noqa: E731
    c = f(0 * x)
    Q = share * (f(x + y) - f(x) - f(y) + c)
    return list((y - x) / EPS - Q - B(x + y) / 2 - c)


@pytest.mark.parametrize("name", QUADRATIC)
def test_the_step_solves_its_equation_over_q_and_its_inverse_has_minus_dt(name: str) -> None:
    fixed = REGISTRY[name].n
    for n in (3, 4) if fixed is None else (fixed,):
        assert all(v == 0 for v in off_equation(name, n))
        model, z = start(name, n)
        back = step(model, step(model, z, EPS), -EPS)
        assert all(v == 0 for v in flat(model, back) - flat(model, z))


def test_a_wrong_coefficient_and_a_wrong_inverse_are_seen() -> None:
    assert any(v != 0 for v in off_equation("heavy-top", 3, exact.rational(1, 3)))
    model, z = start("heavy-top")
    assert any(v != 0 for v in flat(model, step(model, step(model, z, EPS), -EPS * 2 / 3)) - flat(model, z))


def change_of_euler(share: int = 12, name: str = "euler-top") -> list[Any]:
    """Of the deformed Casimir and energy in a step over Q; `share` as in dt^2/12."""
    model, z = start(name)

    def seen(z: State) -> list[Any]:
        x = algebra.axial(z[0])
        own = {"M": z[0], "casimir": algebra.dot(x, x), "energy": model.energy(*z)}
        eps2 = EPS * EPS * 12 / share
        a = kahan._alphas(model, model.constants)
        if share == 12:
            out = kahan.euler_integrals(model, own, EPS, model.constants)
            return [out["casimir_eps"], out["energy_eps"]]
        D = 1 - eps2 / 12 * (kahan._others(a) * x * x).sum()
        return [own["casimir"] / D, own["energy"] / D]

    return [x - y for x, y in zip(seen(step(model, z, EPS)), seen(z), strict=True)]


def test_the_integrals_of_the_euler_top_over_q() -> None:
    assert change_of_euler() == [0, 0]
    assert change_of_euler(name="manakov-top") == [0, 0]
    assert all(v != 0 for v in change_of_euler(share=6))
    assert all(v != 0 for v in change_of_euler(share=10**9))  # the integrals of the flow are not conserved


def off_density(share: int = 4) -> Any:
    """det(dx'/dx) - phi(x')/phi(x), phi = product over two i of (1 - dt^2/4 alpha_j alpha_k x_i^2)."""
    model, z = start("euler-top")
    new, slopes = exact.jacobian(lambda *z: step(model, z, EPS), z, ("skew",), 3)
    a = kahan._others(kahan._alphas(model, model.constants))

    def phi(x: np.ndarray) -> Any:
        numbers = 1 - EPS * EPS / share * a * x * x
        return numbers[0] * numbers[1]

    after = algebra.axial(algebra.skew(np.array([v.value for v in new], dtype=object), 3))
    p = slopes
    det = (
        p[0, 0] * (p[1, 1] * p[2, 2] - p[1, 2] * p[2, 1])
        - p[0, 1] * (p[1, 0] * p[2, 2] - p[1, 2] * p[2, 0])
        + p[0, 2] * (p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0])
    )
    return det - phi(after) / phi(algebra.axial(z[0]))


def test_the_density_of_the_euler_top_over_q() -> None:
    assert off_density() == 0
    assert off_density(5) != 0


def linear_integrals(model: Model) -> set[str]:
    outcomes = scheme(model, "kahan", 0.1, None, False).outcomes
    return {name for name, outcome in outcomes.items() if outcome.conserved}


@pytest.mark.parametrize("name", QUADRATIC)
def test_linear_integrals_are_conserved_over_q(name: str) -> None:
    n = REGISTRY[name].n or 3
    model, z = start(name, n)
    linear = linear_integrals(start(name, n, numbers="float")[0]) - {"casimir_eps", "energy_eps"}
    new = step(model, z, EPS)
    for integral in linear:
        function = model.system.integrals[integral]
        assert np.all(model.call(function, *new) - model.call(function, *z) == 0)
    assert ("noether" in linear) == (name in WITH_NOETHER)


WITH_NOETHER = {"kirchhoff-case", "lagrange-top", "lagrange-top-moving"}


@pytest.mark.parametrize(("name", "order"), [(n, o) for n in ("euler-top", "zhukovsky-volterra", "heavy-top") for o in composition.ORDERS])
def test_orders(name: str, order: int) -> None:
    model, z = start(name, numbers="float")
    kinds = model.system.space.kinds
    x = flat(model, z)
    rate = lambda t, y: layout.flatten(model.flow(*layout.restore(y, kinds, 3)), kinds)  # noqa: E731
    truth = solve_ivp(rate, (0, 0.6), x, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    errors, counts = [], {2: (40, 56, 80), 4: (10, 14, 20), 6: (6, 8, 11), 8: (4, 5, 6)}[order]
    for count in counts:
        last = kr.propagator(model, method="kahan", order=order, dt=0.6 / count).steps(dict(zip(model.system.space.letters, z, strict=True)), count)
        errors.append(abs(flat(model, tuple(np.asarray(v) for v in last)) - truth).max())
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - order) < 0.2
