"""method="variational": what it claims of itself, over the registry; a spoiled step is caught."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.engines import layout
from kreisel.engines.cpu import Kernel
from kreisel.lab import exact
from kreisel.lab.orders import scheme_orders
from kreisel.methods import composition, scheme
from kreisel.model import Model
from kreisel.systems import REGISTRY

variational = sys.modules["kreisel.methods.variational"]
ROUNDOFF = 2.0**12 * float(np.finfo(float).eps)


def random_start(name: str, n: int, seed: int = 0) -> tuple[Model, tuple[np.ndarray, ...]]:
    draw = exact.float_random(np.random.default_rng([seed, n]))
    model = exact.random_model(REGISTRY[name], n, draw)
    return model, exact.random_state(REGISTRY[name].space, n, draw)


def whole_step(model: Model, dt: float, order: int = 2) -> Callable[..., tuple[np.ndarray, ...]]:
    """A step of the user's state, without orientation and defect."""
    plan = scheme(model, "variational", dt, order, False)
    return lambda *z: plan.advance(*z, 0.0)[:-1]


def off_poisson(name: str, n: int, order: int = 2) -> float:
    """Largest entry of J Pi(z) J^T - Pi(step(z)), from dual numbers."""
    model, z = random_start(name, n)
    space = model.system.space
    step = replace_scheme_step(model, 0.2, order)
    new, J = exact.jacobian(step, z, space.kinds, n)
    J = J.astype(float)
    images = layout.restore(np.array([v.value for v in new]), space.kinds, n)
    return float(abs(J @ space.tensor(*z) @ J.T - space.tensor(*images)).max())


def replace_scheme_step(model: Model, dt: float, order: int) -> Callable[..., tuple[np.ndarray, ...]]:
    """The stages one after the other, without the defect, which dual numbers cannot compare."""
    fractions = composition.symmetric_composition(order, "test")

    def step(*z: np.ndarray) -> tuple[np.ndarray, ...]:
        for eps in fractions * dt:
            z = variational.stage(model.system, z, eps, model.constants)[0]
        return z

    return step


def off_symmetry(name: str, n: int, order: int = 2) -> float:
    model, z = random_start(name, n)
    there = replace_scheme_step(model, 0.2, order)(*z)
    back = replace_scheme_step(model, -0.2, order)(*there)
    return max(float(abs(a - b).max()) for a, b in zip(back, z, strict=True))


def off_casimirs(name: str, n: int) -> float:
    model, z = random_start(name, n)
    casimirs = model.system.space.casimirs
    return float(abs(casimirs(*whole_step(model, 0.2)(*z)) - casimirs(*z)).max())


@pytest.mark.parametrize("n", [3, 4])
@pytest.mark.parametrize("name", list(REGISTRY))
def test_poisson_symmetric_casimirs(name: str, n: int) -> None:
    assert off_poisson(name, n) < ROUNDOFF
    assert off_symmetry(name, n) < ROUNDOFF
    assert off_casimirs(name, n) < ROUNDOFF


@pytest.mark.parametrize("order", [4, 6, 8])
def test_compositions_are_poisson_and_symmetric(order: int) -> None:
    assert off_poisson("heavy-top", 3, order) < ROUNDOFF
    assert off_symmetry("heavy-top", 3, order) < ROUNDOFF
