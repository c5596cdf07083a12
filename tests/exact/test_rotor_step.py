"""A step of the free body in closed form, as pure functions: against many digits, and where cases meet."""

from __future__ import annotations

import numpy as np
import pytest

from kreisel import algebra
from kreisel.exact import rotor_step
from kreisel.exact.rotor_step import constants, step
from rotors import by_taylor, closed_form

ULP = 2.0**-52
START = np.array([1.0, 0.0, 0.0, 0.0])
CASES = {  # moments, M
    "a ball": ((2.0, 2.0, 2.0), (0.3, -0.5, 0.7)),
    "prolate": ((2.0, 2.0, 1.0), (0.3, -0.5, 0.7)),
    "flat": ((1.0, 2.0, 3.0), (0.3, -0.5, 0.7)),
    "about an axis": ((3.0, 1.0, 2.0), (0.0, 0.0, -1.0)),
    "on the separatrix": ((3.0, 4.0, 6.0), (0.5, 0.25, 0.5)),
    "almost a ball": ((2.0, 2.0 + 1e-12, 2.0 - 1e-12), (0.3, -0.5, 0.7)),
}


def rate(moments: np.ndarray, M: np.ndarray) -> float:
    """Of the elliptic functions: lambda."""
    low, middle, high = np.sort(moments)
    L2, T2 = M @ M, M @ (M / moments)
    pairs = ((high - middle) * (L2 - T2 * low), (middle - low) * (T2 * high - L2))
    return float(np.sqrt(max(pairs) / (low * middle * high)))


def off(moments: np.ndarray, M: np.ndarray, h: float, reference: object = closed_form) -> tuple[float, float]:
    N, q = step(M, START, h=np.float64(h), **constants(moments))
    want, turn = reference(moments, M, START, h, 40)  # type: ignore[operator]
    state = max(abs(float(x - y)) for x, y in zip(want, N, strict=True)) / np.linalg.norm(M)
    return state, min(max(abs(float(x - s * y)) for x, y in zip(turn, q, strict=True)) for s in (1, -1))


@pytest.mark.parametrize(("length", "state", "turn"), [(0.25, 8, 16), (0.5, 8, 16), (1.0, 8, 60)])
def test_random_bodies(length: float, state: float, turn: float) -> None:
    draw = np.random.default_rng(0)
    for _ in range(6):
        moments, M = draw.uniform(0.5, 1, 3), draw.normal(size=3)
        h = min(length / rate(moments, M), 8 * moments.min() / np.linalg.norm(M))
        for sign in (1, -1):
            errors = off(moments, M, sign * h)
            assert errors[0] < state * ULP and errors[1] < turn * ULP, (moments, M, h)


@pytest.mark.parametrize("name", CASES)
def test_no_case_is_set_apart(name: str) -> None:
    moments, M = (np.array(v) for v in CASES[name])
    state, turn = off(moments, M, 0.7, by_taylor)
    assert state < 8 * ULP and turn < 16 * ULP


def test_no_time_and_no_momentum() -> None:
    moments = np.array([1.0, 2.0, 2.5])
    M, g = step(np.array([0.3, -0.5, 0.7]), START, h=np.float64(0), **constants(moments))
    assert abs(M - (0.3, -0.5, 0.7)).max() < 2 * ULP and abs(g - START).max() < ULP
    M, g = step(np.zeros(3), START, h=np.float64(0.3), **constants(moments))
    assert (M == 0).all() and (g == START).all()


def test_many_steps_are_one() -> None:
    """And what is fixed in space stays; in a batch of steps of several bodies."""
    moments, M0 = np.array([[1.0, 2.0, 2.5], [2.0, 1.0, 2.5]]), np.array([[0.3, -0.5, 0.7], [0.7, 0.1, 0.2]])
    h, known = np.full(2, 0.2), constants(moments)
    M, g = M0, np.broadcast_to(START, (2, 4))
    for _ in range(500):
        M, g = step(M, g, h=h, **known)
    for k in range(2):
        want, turn = closed_form(moments[k], M0[k], START, 100.0, 40)  # 500 doubles of 0.2 are 100 + 5.6e-15
        assert abs(M[k] - np.array(want, dtype=float)).max() < 3e-12  # 2.6e-13: the integrals walk, then the phase
        assert abs(abs(g[k] @ np.array(turn, dtype=float)) - 1) < 3e-12
    turned = algebra.act(algebra.rotation_matrix(g), M)
    assert abs(turned - M0).max() < 1e-13


def test_the_integrals_do_not_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 64 bodies with nearly the same motion, 1.3e-17 a step; 2e-16 where nothing is restored."""
    moments, draw = np.array([1.0, 1.6, 2.0]), np.random.default_rng(0)
    start = np.array([0.4, 0.3, 1.5]) * (1 + 1e-3 * draw.normal(size=(64, 1)))

    def drift(steps: int = 400) -> float:
        M, g = start, np.tile(START, (64, 1))
        for _ in range(steps):
            M, g = step(M, g, h=np.full(64, 0.058), **constants(moments))
        wide = [z.astype(np.longdouble) for z in (start, M)]
        both = [np.stack([(z * z).sum(-1), (z * z / moments).sum(-1)]) for z in wide]
        return float(abs(both[1] / both[0] - 1).mean() / steps)

    assert drift() < 5e-17
    monkeypatch.setattr(rotor_step, "restored", lambda N, *_: N)
    assert drift() > 5e-17


@pytest.mark.parametrize("size", [1e-60, 1e-30, 1e60])
def test_bodies_of_any_size(size: float) -> None:
    moments, M = np.array([1.0, 2.0, 2.5]), np.array([0.3, -0.5, 0.7])
    found, _ = step(size * M, START, h=np.float64(0.3) / size, **constants(moments))
    want, _ = step(M, START, h=np.float64(0.3), **constants(moments))
    assert abs(found / size - want).max() < 1e-14


@pytest.mark.parametrize("letter", ["inverse", "rates", "curvatures"])
def test_a_wrong_constant_shows(letter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    moments, M = np.array([1.0, 2.0, 2.5]), np.array([0.3, -0.5, 0.7])

    right = constants(moments)
    monkeypatch.setattr(rotor_step, "restored", lambda N, *_: N)  # which undoes an error of |N|
    monkeypatch.setitem(globals(), "constants", lambda _: {**right, letter: right[letter] * (1 + 1e-9)})
    assert max(off(moments, M, 0.7)) > 1e-12


def test_the_nodes_are_enough() -> None:
    """Two more change psi by less than its bound."""
    moments, M = np.array([0.5, 0.7, 0.9]), np.array([0.3, -0.5, 0.9])
    g = [step(M, START, h=np.float64(0.5 / rate(moments, M)), **constants(moments))[1]]
    before = rotor_step.NODES
    try:
        rotor_step.NODES = before + 2
        g.append(step(M, START, h=np.float64(0.5 / rate(moments, M)), **constants(moments))[1])
    finally:
        rotor_step.NODES = before
    assert abs(g[1] - g[0]).max() < 8 * ULP
