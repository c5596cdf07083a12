"""The implicit maps: solved up to the longest step, on the branch that tends to 1, and told where they are not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.lab import exact
from kreisel.methods.veselov import LIMIT
from kreisel.systems import REGISTRY, implicit

BODIES = 40
SYSTEMS = ["euler-top", "quadratic-potential", "clebsch-body"]


def bodies(name: str, n: int) -> Iterator[tuple[Any, tuple[np.ndarray, ...], float]]:
    for seed in range(BODIES):
        draw = exact.float_random(np.random.default_rng([seed, n]))
        model, state = exact.random_model(REGISTRY[name], n, draw), exact.random_state(REGISTRY[name].space, n, draw)
        yield model, state, float(model.call(model.map.largest_step, *state))


@pytest.mark.parametrize("n", [3, 4, 5, 6])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_equation_is_solved_on_the_branch(name: str, n: int) -> None:
    """Q W J - J W^T Q = eps M to round-off, with the eigenvalues of Q^-1 W J in the right half-plane."""
    for model, state, largest in bodies(name, n):
        J, M, one = model.params["J"], state[0], np.eye(n)
        P = (
            state[-1]
            if name == "quadratic-potential"
            else np.outer(state[-1], state[-1])
            if len(state) > 1
            else 0 * one
        )
        for share in (0.01, 0.5, 0.9, 0.99):
            eps = share * largest
            w, v = np.linalg.eigh(one - eps * eps * P)
            Q = v * np.sqrt(w) @ v.T
            X, defect = model.call(model.map.turn, *state, eps=eps)
            assert defect < LIMIT**2, (share, float(defect))
            W = algebra.cayley(X)
            left = Q @ W * J
            assert abs(left - left.T - eps * M).max() < 1e-13 * (1 + abs(left).max()), share
            assert np.linalg.eigvals(np.linalg.solve(Q, W * J)).real.min() > 0


def test_beyond_the_longest_step_the_defect_tells() -> None:
    for model, state, largest in bodies("euler-top", 4):
        X, defect = model.call(model.map.turn, *state, eps=1.02 * largest)
        assert not defect < LIMIT**2
        assert np.isnan(X).all() or abs(X + X.T).max() < 1e-9


def test_one_doubling_less_is_told_by_the_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    (model, state, largest), *_ = bodies("euler-top", 5)
    monkeypatch.setattr(implicit, "SMALL", implicit.SMALL**0.25)
    _, defect = model.call(model.map.turn, *state, eps=0.9 * largest)
    assert defect > LIMIT**2


def test_integrals_stand_still_close_to_the_longest_step() -> None:
    (model, state, largest), *_ = bodies("euler-top", 4)
    for share in (0.5, 0.9, 0.99):
        run = kr.simulate(model, {"M": state[0]}, dt=share * largest, steps=20_000, every=200, method="veselov")
        table = kr.drift(run)
        assert table.kept.all() and (table.ratio < 2).all(), table.to_string()
