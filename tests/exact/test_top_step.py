"""A step of the Lagrange top in closed form, as pure functions: against many digits, and where cases meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.algebra import act, dot
from kreisel.exact import top_step
from kreisel.exact.top_step import step, step_inside
from kreisel.method import scheme
from kreisel.method.scheme import Steps
from support import cpu_engine
from taylor import taylor
from tops import SPECIAL

ULP = 2.0**-52
START = np.array([1.0, 0.0, 0.0, 0.0])
Top = tuple[np.ndarray, np.ndarray, np.ndarray]


def rate(m: np.ndarray, a: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.maximum(np.sqrt(dot(m, m)), (dot(a, a) * dot(p, p)) ** 0.25)


def off(top: Top, h: float, alpha: float = 1.0) -> tuple[float, float]:
    """The errors of (m, a), in units of the largest rate and of |a|, and of g."""
    m, a, p = top
    got = step(m, a, START, p=p, alpha=np.float64(alpha), h=np.float64(h))
    want = taylor(m, a, p, h, alpha=alpha, digits=24)
    errors = [max(abs(float(x - float(y))) for x, y in zip(w, v, strict=True)) for w, v in zip(want, got, strict=True)]
    return max(errors[0] / (float(rate(m, a, p)) or 1), errors[1] / float(np.sqrt(a @ a))), errors[2]


def tops_of_all_sizes(count: int, seed: int = 0) -> list[Top]:
    draw = np.random.default_rng(seed)
    sizes = 10 ** draw.uniform(-1.5, 1.5, (count, 3, 1))
    return [tuple(three) for three in sizes * draw.normal(size=(count, 3, 3))]


@pytest.mark.parametrize(("length", "bound"), [(0.1, 4), (0.5, 4), (0.75, 4), (1.0, 60)])
def test_random_tops(length: float, bound: float) -> None:
    """1.1 ulp in the first three, and for most tops in the last, where few need 24."""
    for k, top in enumerate(tops_of_all_sizes(16)):
        h = (-1) ** k * length / float(rate(*top))
        assert max(off(top, h, (1, 0.7, 2, 0.3)[k // 2 % 4])) < bound * ULP, top


@pytest.mark.parametrize("name", SPECIAL)
def test_no_case_is_set_apart(name: str) -> None:
    top = tuple(np.array(v, dtype=float) for v in SPECIAL[name])
    for h in (0.5, -0.7):
        assert max(off(top, h / (float(rate(*top)) or 1), 0.7)) < 4 * ULP


def test_no_time() -> None:
    m, a, p = tops_of_all_sizes(1)[0]
    for f, fixed in ((step, {"p": p}), (step_inside, {"A": p})):
        state = f(m, a, START, **fixed, alpha=0.5, h=np.float64(0))
        assert all(abs(x - y).max() <= 2 * ULP * abs(y).max() for x, y in zip(state, (m, a, START), strict=True))


def test_no_weight_and_nothing_but_weight() -> None:
    """p = 0 in both frames, with orientation; a = 0 without."""
    m, a, zero, h = np.array([0.3, -0.5, 0.7]), np.array([0.1, 0.2, 0.9]), np.zeros(3), np.float64(0.5)
    n, b, g = step(m, a, START, p=zero, alpha=1.0, h=h)
    turn = algebra.rotation_matrix(g)
    assert (n == m).all() and abs(turn @ a - b).max() < 4 * ULP and abs(turn @ m - m).max() < 4 * ULP
    inside = step_inside(m, zero, START, A=a, alpha=1.0, h=h)
    assert (inside[1] == 0).all() and abs(inside[0] - m).max() < 4 * ULP and abs(inside[2] - g).max() < 4 * ULP
    n, b = step(m, zero, p=a, alpha=1.0, h=h)
    assert (n == m).all() and (b == 0).all()


def test_many_steps_are_one_jump() -> None:
    m, a, p = tops_of_all_sizes(1, seed=3)[0]
    h, alpha = 0.25 / float(rate(m, a, p)), 0.6
    h = float(np.float32(h))  # 128 of them are exact
    state = m, a, START
    for _ in range(128):
        state = step(*state, p=p, alpha=alpha, h=np.float64(h))
    far = kr.at(kr.LagrangeTop(p=p), {"m": m, "a": a}, [128 * h])
    for got, name in zip(state, ("m", "a"), strict=False):
        want = far[name].values[0]
        assert abs(got - want).max() < 1e-12 * abs(want).max()
    want = np.array([float(v) for v in taylor(m, a, p, 128 * h, alpha=alpha, digits=24)[2]])
    assert abs(state[2] - want).max() < 1e-12


@pytest.mark.parametrize("length", [0.5, -0.5])
def test_the_moving_frame(length: float) -> None:
    """The step in the body is that in space, seen from there; (M, P) does not need g."""
    tops = [*tops_of_all_sizes(200), *(tuple(np.array(v, dtype=float) for v in top) for top in SPECIAL.values())]
    m, a, p = (np.stack(v) for v in zip(*tops, strict=True))
    g = algebra.unit(np.random.default_rng(7).normal(size=(len(m), 4)))
    of = np.where(rate(m, a, p) > 0, rate(m, a, p), 1)
    M, P, q = step_inside(m, p, g, A=a, alpha=0.7, h=length / of)
    assert all((x == y).all() for x, y in zip(step_inside(m, p, A=a, alpha=0.7, h=length / of), (M, P), strict=True))
    R, Q = algebra.rotation_matrix(g), algebra.rotation_matrix(q)
    n, b, r = step(act(R, m), act(R, a), g, p=act(R, p), alpha=0.7, h=length / of)
    size = [np.sqrt(dot(v, v)) for v in (a, np.where(p == 0, 1, p), g)]
    pairs = (act(Q, M), n, of), (act(Q, a), b, size[0]), (act(Q, P), act(R, p), size[1]), (q, r, size[2])
    for x, y, unit in pairs:
        assert (abs(x - y).max(-1) / unit).max() < 16 * ULP


@pytest.mark.parametrize(("frame", "most"), [("rest", (55, 40, 30, 70)), ("moving", (110, 85, 50, 150))])
def test_integrals_walk(frame: str, most: tuple[float, ...]) -> None:
    """E, m.a, m.p and |a|^2 or |P|^2, each in ulps of its scale: root mean squares, half of the bounds.

    With mu^2 rounded to a number of its own, the same in all steps, |a|^2 went to 95 (rest).
    """
    draw, steps = np.random.default_rng(5), 3000
    m, a, p = draw.normal(size=(3, 100, 3))
    of = rate(m, a, p)
    size, weight = np.sqrt(dot(a, a)), np.sqrt(dot(p, p))

    def integrals(m: np.ndarray, a: np.ndarray, p: np.ndarray) -> np.ndarray:
        energy = (dot(m, m) / 2 + dot(a, p)) / of**2
        moved = dot(p, p) / weight**2 + dot(a, a) / size**2
        return np.stack([energy, dot(m, a) / (of * size), dot(m, p) / (of * weight), moved])

    before, h = integrals(m, a, p), 0.5 / of
    for _ in range(steps):
        if frame == "rest":
            m, a = step(m, a, p=p, alpha=0.6, h=h)
        else:
            m, p = step_inside(m, p, A=a, alpha=0.6, h=h)
    walk = np.sqrt(((integrals(m, a, p) - before) ** 2).mean(1)) / ULP
    assert (walk < most).all(), walk


def test_batches() -> None:
    """Lanes with a p, an alpha and a time of their own, in any shape, are single steps."""
    draw = np.random.default_rng(1)
    m, a, p = draw.normal(size=(3, 2, 5, 3))
    g, alpha, h = algebra.unit(draw.normal(size=(2, 5, 4))), draw.uniform(0.3, 2, 5), draw.uniform(-0.3, 0.3, (2, 1))
    for f, letters in ((step, (m, a, p)), (step_inside, (m, p, a))):
        name = "p" if f is step else "A"
        every = f(letters[0], letters[1], g, **{name: letters[2]}, alpha=alpha, h=h + np.zeros((2, 5)))
        one = [v[1, 3] for v in letters]
        lane = f(one[0], one[1], g[1, 3], **{name: one[2]}, alpha=alpha[3], h=h[1, 0])
        assert all(abs(x[1, 3] - y).max() <= ULP for x, y in zip(every, lane, strict=True))


def recorded(frame: str) -> tuple[Any, Callable[..., Any], dict[str, np.ndarray]]:
    """A scheme of which a step is this one, the step, and its constants."""
    fixed = np.array([0.1, 0.2, 0.9])
    model = kr.LagrangeTop(p=fixed, alpha=0.7) if frame == "rest" else kr.LagrangeTopMoving(A=fixed, alpha=0.7)
    name, f = ("p", step) if frame == "rest" else ("A", step_inside)

    def moved(X: Any, v: Any, g: Any, **given: Any) -> tuple[Any, ...]:
        x, v, g = f(algebra.axial(X), v, g, **given)
        return algebra.hat(x), v, g

    known = {name: fixed, "alpha": np.array(0.7), "h": np.array(0.4)}
    plan = scheme(model, "suris", 0.4, None, True)
    same = {"stages": {}, "trajectory": None, "definition_key": None, "kernel_key": None}
    return replace(plan, motion=Steps(moved), constants=known, axes={name: 1, "alpha": 0, "h": 0}, **same), f, known


@pytest.mark.parametrize("frame", ["rest", "moving"])
def test_recorded_it_is_the_same(frame: str) -> None:
    plan, f, known = recorded(frame)
    state = np.array([0.3, -0.5, 0.7]), np.array([0.6, 0.1, 0.8]), START
    first = np.concatenate([algebra.coordinates(algebra.hat(state[0])), *state[1:]])
    kernel = cpu_engine(plan, first[None])
    out = np.empty((3, 1, 10))
    kernel.advance(out, 1)
    for row in out[:, 0]:
        state = f(*state, **known)
        x = algebra.axial(algebra.skew(row[:3], 3))
        assert abs(np.concatenate([x, row[3:]]) - np.concatenate(state)).max() < 8 * ULP


def worst(tops: list[Top]) -> float:
    return max(max(off(top, 0.7 / float(rate(*top)), 0.5)) for top in tops)


@pytest.mark.parametrize("letter", ["A", "P", "J", "c", "E", "series"])
def test_a_wrong_integral_shows(letter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def mutant(*given: Any) -> Any:
        known = right(*given)
        value = getattr(known, letter)
        wrong = [v * (1 + 1e-8) for v in value] if letter == "series" else value * (1 + 1e-8)
        return known._replace(**{letter: wrong})

    right = top_step._integrals
    monkeypatch.setattr(top_step, "_integrals", mutant)
    assert worst(tops_of_all_sizes(4)) > 100 * ULP


@pytest.mark.parametrize(("name", "value"), [("ORDERS", 9), ("NODES", 4)])
def test_fewer_terms_show(name: str, value: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(top_step, name, value)
    assert worst(tops_of_all_sizes(8)) > 30 * ULP


def test_a_turn_left_out_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(top_step, "_lean", lambda levels, f, h: START)
    assert worst(tops_of_all_sizes(4)) > 1e-5
