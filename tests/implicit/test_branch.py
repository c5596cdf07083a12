"""The implicit maps: solved up to the longest step on the branch that tends to 1, and a message where they are not."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Any

import mpmath
import numpy as np
import pytest
import xarray as xr

import kreisel as kr
import walks
from kreisel import algebra, implicit
from kreisel.kernels.cpu import points
from kreisel.lab import exact
from kreisel.method import scheme
from kreisel.method.maps import LIMIT
from kreisel.system import REGISTRY
from sizes import FULL

BODIES = 40 if FULL else 12
SYSTEMS = ["euler-top", "quadratic-potential", "clebsch-body"]


def bodies(name: str, n: int) -> Iterator[tuple[Any, tuple[np.ndarray, ...], float]]:
    for seed in range(BODIES):
        draw = exact.float_random(np.random.default_rng([seed, n]))
        model, state = exact.random_model(REGISTRY[name], n, draw), REGISTRY[name].space.point(n, draw)
        yield model, state, model.largest_step(*state)


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


def test_the_root_of_the_trajectory_serves_all_its_steps() -> None:
    """The quartic's root, found once, gives the turn that is found anew, at states far along the orbit."""
    for model, (M,), largest in bodies("euler-top", 3):
        for share in (0.01, 0.5, 0.9, 0.99):
            eps = share * largest
            sigma = model.call(model.map.trajectory, M, eps=eps)
            state = M
            for _ in range(5):
                X, _ = model.call(model.map.turn, state, eps=eps)
                again, left = model.call(model.map.turn, state, eps=eps, sigma=sigma)
                assert left < LIMIT**2
                assert abs(again - X).max() < 1e-13 / (1 - share) * (1 + abs(X).max()), share
                (state,) = model.call(model.map.move, state, again)


@pytest.mark.parametrize("off", [1e-9, 1e-2])
def test_a_root_that_is_off_belongs_to_a_body_with_other_moments(off: float) -> None:
    """I + delta with delta = h <x, mu> - sigma; the defect tells a delta that counts."""
    for model, (M,), largest in bodies("euler-top", 3):
        eps = 0.5 * largest
        sigma = model.call(model.map.trajectory, M, eps=eps) * (1 + off)
        X, defect = model.call(model.map.turn, M, eps=eps, sigma=sigma)
        delta = eps / 2 * algebra.pairing(X, M) - sigma
        other = kr.EulerTop(J=model.params["J"] + delta / 2)
        again, _ = other.call(other.map.turn, M, eps=eps)
        assert abs(again - X).max() < 1e-13 * (1 + abs(X).max())
        assert (defect > LIMIT**2) is np.bool_(off > 1e-3)


def test_beyond_the_longest_step_the_defect_tells() -> None:
    for model, state, largest in bodies("euler-top", 4):
        X, defect = model.call(model.map.turn, *state, eps=1.02 * largest)
        assert not defect < LIMIT**2
        assert np.isnan(X).all() or abs(X + X.T).max() < 1e-9


def test_one_doubling_less_is_seen_in_the_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    (model, state, largest), *_ = bodies("euler-top", 5)
    monkeypatch.setattr(implicit, "SMALL", implicit.SMALL**0.25)
    _, defect = model.call(model.map.turn, *state, eps=0.9 * largest)
    assert defect > LIMIT**2


# The mean rounding error of a step, in eps times the sensitivity of the integral, depends on the constants of the body.
# Measured: n = 3, of forty bodies at 0.95 of the longest step 0.0022 at most; n = 4, of six bodies 0.02 at 0.99, 0.006
# at 0.9.  What these bounds let pass is five times as much.
MEAN = {3: 0.01, 4: 0.1}


def close_to_the_longest_step(n: int, share: float, steps: int) -> xr.Dataset:
    (model, state, largest), *_ = bodies("euler-top", n)
    options = {"dt": share * largest, "steps": steps, "every": steps // 400}
    return kr.simulate(model, {"M": state[0]}, method="veselov", progress=False, **options)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
@pytest.mark.parametrize(("n", "steps"), [(3, 1_000_000), (4, 20_000)])
def test_integrals_stand_still_close_to_the_longest_step(n: int, steps: int, share: float) -> None:
    run = close_to_the_longest_step(n, share, steps)
    assert kr.drift(run).conserved.all()
    walks.assert_still(run, mean=MEAN[n])


def many_close_to_the_longest_step() -> xr.Dataset:
    """All bodies at once: momenta so large that the same step is the same share of the longest for each."""
    each = list(bodies("euler-top", 3))
    momenta = np.stack([0.95 * largest / 0.1 * M for _, (M,), largest in each])
    top = kr.EulerTop(J=np.stack([model.params["J"] for model, *_ in each]))
    return kr.simulate(top, {"M": momenta}, dt=0.1, steps=250_000, every=625, method="veselov", progress=False)


def test_many_bodies_stand_still() -> None:
    walks.assert_still(many_close_to_the_longest_step(), mean=MEAN[3])


def test_an_equation_solved_to_fifty_ulps_lets_the_integrals_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    """For n = 4: what the bound with a mean still tells."""
    system = import_module("kreisel.system.euler_top")
    right = system.turn_by_doubling

    def wrong(*given: Any) -> Any:
        X, defect = right(*given)
        return X * (1 + 1e-14), defect

    monkeypatch.setattr(system, "turn_by_doubling", wrong)
    assert walks.troubles(close_to_the_longest_step(4, 0.9, 20_000), mean=MEAN[4])


@pytest.mark.parametrize("share", [0.01, 0.5, 0.9])
def test_the_root_is_that_of_the_solution_in_extended_digits_for_every_number_of_lanes(share: float) -> None:
    """sigma = h <x, mu> with X from Moser and Veselov's matrix equation by Newton's method with 40 digits."""
    for model, (M,), largest in bodies("euler-top", 3):
        made = scheme(model, "veselov", share * largest, 2, False)
        (sigma,) = made.on((M,), points).stages["sigma"]
        J, eps = mpmath.diag(model.params["J"].tolist()), mpmath.mpf(share * largest)
        with mpmath.workdps(40):
            m = mpmath.matrix(M.tolist())

            def skew(x: Any, y: Any, z: Any) -> Any:
                return mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])

            def residual(*x: Any, J: Any = J, m: Any = m, eps: Any = eps) -> list[Any]:
                X = skew(*x)
                left = 2 * (X * J + J * X) - eps * (mpmath.eye(3) - X) * m * (mpmath.eye(3) + X)
                return [left[2, 1], left[0, 2], left[1, 0]]

            start = algebra.axial(model.call(model.map.turn, M, eps=share * largest)[0])
            x = mpmath.findroot(residual, start.tolist())
            exact = eps / 2 * sum(a * b for a, b in zip(x, (m[2, 1], m[0, 2], m[1, 0]), strict=True))
            assert abs(exact - sigma) < 2e-15 / (1 - share) * 2 * sum(model.params["J"])
        for lanes in (2, 9, 64):
            many = made.on((np.stack([M * (1 - 0.01 * k) for k in range(lanes)]),), points)
            assert many.stages["sigma"][0] == sigma
