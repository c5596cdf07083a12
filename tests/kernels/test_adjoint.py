"""Compiled derivatives of a graph: against differences, every operation, with mutants of their slopes."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra, reduction as red
from kreisel.algebra import backend
from kreisel.algebra.gradient import cos, exp, log, sin
from kreisel.graph import arranging
from kreisel.graph.graph import Graph, evaluated, integer_power, where_less
from kreisel.kernels import adjoint
from sizes import FULL

STEPS, PART = 3, 2
Z, C = np.array([0.3, -0.2, 0.7]), np.array([0.4, 1.3])
S = np.array([[0.2, 0.5], [-0.3, 0.9]])


def stage(x: Any, *, c: Any, s: Any) -> tuple[Any]:
    """Every operation of a graph; c, s of two numbers each."""
    y0 = s[1] * x[0] - backend.sqrt(1 + x[1] * x[1]) / (2 + x[2] * x[2]) + 3
    y1 = sin(x[1] * c[0]) + 0.1 * exp(-x[0]) - cos(s[0] * x[2])
    y2 = log(2 + x[0] * x[0]) * x[1] - backend.maximum(x[2] * 0.5, x[0] * c[1]) + 0.3 / (c[1] + x[0] ** 2)
    y2 = y2 + where_less(x[0], c[0], x[1] * x[1], 3 * x[2]) - 0.2 * abs(x[2] - s[0])
    return (np.array([y0 / 3, y1 * 0.5, y2 * 0.5], dtype=object),)


def close(x: Any, *, c: Any) -> tuple[Any]:
    return (np.array([x[0] / (1 + x[1] * x[1]), x[1] - c[0] * x[2], x[2]], dtype=object),)


def code() -> adjoint.Code:
    c, s = (Graph().inputs(letter, 2) for letter in "cs")
    first = adjoint.recorded(stage, ["vector"], 3, {"c": c, "s": s})
    return adjoint.Code([first, adjoint.recorded(close, ["vector"], 3, {"c": c})], 2, 2)


def end(made: adjoint.Code, x: np.ndarray) -> np.ndarray:
    z, c, s = x[:3], x[3:5], x[5:].reshape(2, 2)
    return made.marks(z[None], c[None], s[None], 1, STEPS, STEPS)[0, -1]


LANE = Z[None], C[None], S[None]


def jacobians() -> tuple[np.ndarray, ...]:
    """By differences, forwards and backwards, (3, 9)."""
    made, x, h = code(), np.concatenate([Z, C, S.ravel()]), 1e-3
    units = h * np.eye(9)
    near = [
        (8 * (end(made, x + v) - end(made, x - v)) - end(made, x + 2 * v) + end(made, x - 2 * v)) / (12 * h)
        for v in units
    ]
    one = np.eye(9)[None]
    columns = one[..., :3], one[..., 3:5], one[..., 5:].reshape(1, 9, 2, 2)
    dz, dc, ds = map(np.ascontiguousarray, columns)
    forwards = made.pushed(*LANE, dz, dc, ds, 1, STEPS)[0, :, 0].T
    slopes = made.pulled(*LANE, made.marks(*LANE, 1, STEPS, PART), np.eye(3)[None, :, None], STEPS, PART, True)
    return np.array(near).T, forwards, np.concatenate([v[0].reshape(3, -1) for v in slopes], -1)


def test_both_ways_are_the_derivative() -> None:
    near, forwards, backwards = jacobians()
    assert abs(near).max() > 0.1 and (abs(near).max(0) > 1e-4).all()
    assert abs(forwards - near).max() < 1e-8 and abs(backwards - near).max() < 1e-8
    assert abs(forwards - backwards).max() < 1e-13


def test_slopes_by_the_state_alone_are_some_of_all() -> None:
    _, forwards, backwards = jacobians()
    made = code()
    marks = made.marks(*LANE, 1, STEPS, PART)
    narrow = made.pulled(*LANE, marks, np.eye(3)[None, :, None], STEPS, PART, False)[0][0]
    assert abs(narrow - backwards[:, :3]).max() < 1e-14
    for count in (1, 3):
        dc, ds = np.zeros((1, count, 0)), np.zeros((1, count, 2, 0))
        short = made.pushed(*LANE, np.eye(3)[None, :count], dc, ds, 1, STEPS)[0, :, 0].T
        assert abs(short - forwards[:, :count]).max() < 1e-14


@pytest.mark.parametrize("name", sorted(set(arranging.SLOPES) - {"sign", "nearest", "entry"}))  # slopes 0; of tables
def test_a_wrong_slope_is_seen(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    right = arranging.SLOPES[name]
    monkeypatch.setitem(arranging.SLOPES, name, lambda *x: tuple(2 * slope for slope in right(*x)))
    near, forwards, backwards = jacobians()
    assert name in arranging.CHOICES or abs(forwards - near).max() > 1e-4  # tangents are chosen like values
    assert abs(backwards - near).max() > 1e-4


def test_signs_and_integer_parts_have_the_slope_0() -> None:
    graph = Graph()
    x, y = graph.inputs("z", 2)
    out = [x * x / (y + 3) - 2 * y * x.sign() + x.nearest(), y * y]
    at = {("z", 0): 5 / 3, ("z", 1): -0.5, ("vz", 0): 1, ("vz", 1): 10, ("w", 0): 1, ("w", 1): 100}
    tangents, slopes = arranging.pushed(graph, out), arranging.pulled(graph, out)
    forwards = evaluated(tangents[0], tangents[1][2:], lambda *place: at[place])
    backwards = evaluated(slopes[0], [slopes[1]["z", i] for i in range(2)], lambda *place: at[place])
    assert np.allclose(forwards, [4 / 3 - 20 - 40 / 9, -10], rtol=1e-14, atol=0)
    assert np.allclose(backwards, [4 / 3, -4 / 9 - 2 - 100], rtol=1e-14, atol=0)


# -- by kr.differentiable -------------------------------------------------------------------------

TOP = kr.LagrangeTop(p=(0, 0, 1))
CLEBSCH = kr.Clebsch(b=(1.0, 2.0, 2.5))
START = {"m": np.array([0.1, 0.2, 1.5]), "a": np.array([0.6, 0, 0.8])}


def both(made: Any) -> tuple[Any, Any]:
    """What is computed by kernels, and by XLA."""
    with red.double(), pytest.MonkeyPatch.context() as patch:
        compiled = made()
        patch.setattr(adjoint, "MOST_NODES", 0)
        return np.asarray(compiled), np.asarray(made())


def test_derivatives_are_those_by_xla() -> None:
    f = kr.differentiable(TOP, method="suris", order=1)

    def height(x: Any) -> Any:
        rows = f({"m": x[:3], "a": x[3:]}, dt=0.1, steps=6, every=3)
        return rows["a"][:, 2] @ jnp.array([1.0, 2, 3])

    x = np.concatenate([START["m"], START["a"]])
    found, expected = both(lambda: jax.jit(jax.grad(height))(x))
    assert abs(expected).max() > 0.1 and abs(found - expected).max() < 1e-13


@pytest.mark.parametrize(
    ("model", "method", "dt"), [(TOP, "kahan", 0.7), (TOP, "exact", 0.1), (CLEBSCH, "baecklund", 0.7)]
)
def test_derivatives_of_higher_order_are_those_by_differences(model: Any, method: str, dt: float) -> None:
    """By state, step and a parameter; steps are so long that the points of `baecklund` move by much with the state."""
    f, letters = kr.differentiable(model, method=method), model.system.space.letters

    def height(x: Any) -> Any:
        more = {} if method == "exact" else {model.system.parameters[0].letter: x[7:]}
        rows = f(dict(zip(letters, (x[:3], x[3:6]), strict=True)), dt=x[6], steps=4, every=2, **more)
        return rows[letters[0]][:, 0] @ jnp.array([3.0, 1, 2]) + rows[letters[1]][:, 2] @ jnp.array([1.0, 2, 3])

    x, v = np.array([0.1, 0.2, 1.5, 0.6, 0, 0.8, dt, 0.1, 0.2, 0.9]), np.arange(1.0, 11) / 10
    with red.double():
        made = jax.jit(jax.grad(height))
        second = {
            "forwards": jax.jit(lambda x: jax.jvp(jax.grad(height), (x,), (v,))[1]),
            "backwards": jax.jit(jax.grad(lambda x: jax.grad(height)(x) @ v)),
        }
        if FULL or method == "kahan":  # many columns at once
            second["inner"] = jax.jit(jax.grad(lambda x: jax.jvp(height, (x,), (v,))[1]))
            second["columns"] = jax.jit(lambda x: jax.hessian(height)(x) @ v)
        for function, derivatives in ((made, second.values()), (second["forwards"], [third(height, v)])):
            expected = along(lambda x: np.asarray(function(x)), x, v)  # noqa: B023 - called here
            for derivative in derivatives:
                assert abs(np.asarray(derivative(x)) - expected).max() < 1e-6 * abs(expected).max() > 0


def third(f: Any, v: np.ndarray) -> Any:
    def slope(x: Any) -> Any:
        return jax.grad(lambda x: jax.jvp(f, (x,), (v,))[1])(x) @ v

    return jax.jit(jax.grad(slope))


def test_second_derivatives_of_a_body_at_rest() -> None:
    """M(t) from s v is s v + s^2 t v x v/I + O(s^3), I the moments of inertia."""
    J, v = np.array([1.0, 2.0, 2.5]), np.array([0.3, -1.0, 0.7])
    f = kr.differentiable(kr.EulerTop(J=J), method="exact")
    with red.double():
        second = jax.hessian(lambda s: f({"M": s * v}, dt=0.05, steps=4)["M"])(0.0)
    assert np.asarray(second) == pytest.approx(2 * 0.2 * np.cross(v, v / (J.sum() - J)), rel=1e-12)


def along(f: Any, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The derivative by differences of order 4."""
    h = 1e-4
    return (8 * (f(x + h * v) - f(x - h * v)) - f(x + 2 * h * v) + f(x - 2 * h * v)) / (12 * h)


@pytest.mark.parametrize(("method", "order"), [("baecklund", 2), ("kahan", 2)])
def test_slopes_by_step_and_parameter(method: str, order: int) -> None:
    f = kr.differentiable(TOP, method=method, order=order)

    def height(x: Any) -> Any:
        return f(START, dt=x[0], steps=4, every=2, p=x[1:])["a"][:, 2] @ jnp.array([1.0, 2, 3])

    x, v = np.array([0.1, 0.1, 0.2, 0.9]), np.array([0.3, 1, -1, 2])
    with red.double():
        expected = along(lambda x: np.asarray(jax.jit(height)(x)), x, v)
        back, forth = jax.jit(jax.grad(height))(x) @ v, jax.jit(lambda x: jax.jvp(height, (x,), (v,))[1])(x)
        back, forth = float(back), float(forth)
    assert abs(expected) > 0.1 and abs(back - expected) < 1e-8 and abs(forth - back) < 1e-12


def test_lanes_are_single_gradients_and_scan_goes_through() -> None:
    f = kr.differentiable(TOP, method="suris", order=1)

    def height(m: Any, p: Any) -> Any:
        state, _ = jax.lax.scan(lambda s, _: (f(s, dt=0.1, steps=5, p=p), None), {**START, "m": m}, length=3)
        return state["a"][2]

    with red.double():
        m = jnp.array([START["m"], 2 * START["m"], -START["m"]])
        p = jnp.array([0.0, 0.1, 1])
        made = jax.jit(jax.grad(height, (0, 1)))
        many = jax.jit(jax.vmap(jax.grad(height, (0, 1)), (0, None)))(m, p)
        over_p = jax.jit(jax.vmap(jax.grad(height, (0, 1)), (None, 0)))(m[0], jnp.stack([p, 2 * p]))
        through = jax.jit(jax.grad(lambda p: jax.vmap(height, (0, None))(m, p).sum()))(p)
        for i in range(3):
            assert all(np.allclose(x[i], y, rtol=0, atol=1e-14) for x, y in zip(many, made(m[i], p), strict=True))
        assert all(np.allclose(x[1], y, rtol=0, atol=1e-14) for x, y in zip(over_p, made(m[0], 2 * p), strict=True))
        assert np.allclose(through, many[1].sum(0), rtol=0, atol=1e-14) and abs(through).max() > 0.1


@pytest.mark.parametrize("n", [3, 4, 5])
def test_the_tangent_is_poisson(n: int) -> None:
    rng = np.random.default_rng(n)
    model = kr.LagrangeTop(p=np.eye(n)[-1])
    a = rng.normal(size=n)
    start = {"m": algebra.skew(rng.normal(size=n * (n - 1) // 2), n) / 2, "a": a / np.sqrt(a @ a)}
    run = kr.simulate(model, model.state(**start), dt=0.05, steps=40, every=40, method="suris", order=1)
    J = kr.tangent(run)
    m = run.m.values if n > 3 else algebra.hat(run.m.values)
    T, there = (model.system.space.tensor(m[i], run.a.values[i]) for i in (0, -1))
    size = abs(J).max() ** 2
    assert size > 1.2 and abs(J @ T @ J.T - there).max() < 1e-13 * size
    assert abs(1.001 * J @ T @ J.T - there).max() > 1e-5


@pytest.mark.parametrize("method", ["veselov", "variational"])
def test_the_tangent_of_steps_with_a_loop_is_poisson(method: str) -> None:
    """Of a free body, n = 4: both are Poisson maps, whose implicit equations are solved in loops."""
    body = kr.EulerTop(J=(1, 2, 3, 4))
    M = algebra.skew(np.array([0.3, -0.2, 0.5, 0.7, 0.1, 0.4]), 4)
    run = kr.simulate(body, {"M": M}, dt=0.2, steps=200, every=200, method=method)
    J, (T, there) = kr.tangent(run), (body.system.space.tensor(M) for M in run.M.values)
    size = abs(J).max() ** 2
    assert size > 1.2 and abs(J @ T @ J.T - there).max() < 1e-13 * size
    assert abs(1.001 * J @ T @ J.T - there).max() > 1e-5


def test_many_lanes_and_large_arrays_come_through() -> None:
    f = kr.differentiable(TOP, method="suris", order=1)
    with red.double():
        m = jnp.asarray(np.random.default_rng(1).normal(size=(4000, 3)))
        made = jax.jit(jax.vmap(jax.grad(lambda m: f({**START, "m": m}, dt=0.1, steps=30)["a"][2])))
        assert np.isfinite(made(m)).all() and abs(np.asarray(made(m))).max() > 0.1


@pytest.mark.parametrize("k", [-3, 0, 1, 2, 3, 4, 7, 10])
def test_integer_powers(k: int) -> None:
    assert integer_power(Fraction(-3, 7), k) == Fraction(-3, 7) ** k
    for other in (0.5, "2"):
        with pytest.raises(TypeError, match="integer powers"):
            integer_power(Fraction(1), other)
