"""Choices of values in user-defined forces: recorded as NumPy evaluates them, in runs, lanes and derivatives."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.algebra import recorded
from kreisel.algebra.gradient import value_and_gradient
from kreisel.graph.arranging import pulled, pushed
from kreisel.graph.graph import APPLIED, Graph, evaluated
from support import compiled_outputs, cross

I = np.array([1.0, 1.7, 2.5])  # noqa: E741


def chosen(M: Any, P: Any, t: Any, k: Any) -> Any:
    """One of everything, with parts that do not exist where they are not chosen."""
    x = np.where(M > 0.1, M, -M * M) * (np.clip(P, -0.5, 0.4) + np.maximum(M, P) - np.minimum(M, 0.2))
    y = abs(M[0]) * np.sign(P[1]) + np.where((M[0] > 0) & ~(P[0] <= t), np.sqrt(M[0]), k)
    z = np.clip(np.stack([M[0], t, P[2]]), 0, None).sum() + np.max(M) + (M > 0) @ P + 2 * (t < P[0])
    return x.sum() + y + z + np.where((k < 0) | (t > 9), np.log(-k), 2.0 / k) + np.clip(t, None, k)


def values(count: int, seed: int) -> np.ndarray:
    x = np.random.default_rng(seed).normal(size=(count, 8))
    x[:, 6] = abs(x[:, 6])
    return x


def of(x: Any) -> Any:
    with np.errstate(invalid="ignore"):
        return chosen(x[..., :3], x[..., 3:6], x[..., 6], x[..., 7])


def swept(x: Any) -> tuple[Any, list[Any]]:
    """The value and the slopes, of floats, lanes or recorded numbers."""
    parts = [(x[..., :3], 1), (x[..., 3:6], 1), (x[..., 6], 0), (x[..., 7], 0)]
    with np.errstate(invalid="ignore"):
        value, slopes = value_and_gradient(lambda *a: recorded.run(chosen, *a), parts)
    return value, [*np.moveaxis(slopes[0], -1, 0), *np.moveaxis(slopes[1], -1, 0), *slopes[2:]]


def differences(x: np.ndarray, h: float = 1e-6) -> np.ndarray:
    return np.array([(of(x + e) - of(x - e)) / (2 * h) for e in h * np.eye(8)])


def test_values_are_those_of_numpy_and_slopes_those_of_the_chosen() -> None:
    x = values(40, 0)
    plain = np.array([of(row) for row in x])
    value, slopes = swept(x)
    assert (value == plain).all()
    assert abs(np.array(slopes).T - [differences(row) for row in x]).max() < 1e-7  # 2e-9
    graph = Graph()
    outputs = swept(graph.inputs("z", 8))
    found = compiled_outputs(graph, [v for each in outputs for v in np.ravel(np.array(each, dtype=object))], x, width=4)
    assert np.allclose(found, np.array([value, *slopes]).T, rtol=1e-13, atol=1e-13)


def test_tangents_and_slopes_of_a_graph_are_those_of_the_chosen() -> None:
    graph = Graph()
    (out,) = np.ravel(recorded.run(chosen, *np.split(graph.inputs("z", 6), 2), *graph.inputs("z", 2, 6)))
    tangents, (backwards, by) = pushed(graph, [out]), pulled(graph, [out])
    numpy = APPLIED | {"sqrt": np.sqrt, "log": np.log}  # which give NaN where no number exists
    for row, along in zip(values(8, 1), values(8, 2), strict=True):
        inputs = partial(at, {"z": row, "vz": along, "w": [1.0]})
        expected = differences(row) @ along
        with np.errstate(invalid="ignore"):
            assert evaluated(*tangents, inputs, numpy)[1] == pytest.approx(expected, abs=1e-7)
            slopes = evaluated(backwards, [by.get(("z", i), 0.0) for i in range(8)], inputs, numpy)
        assert slopes @ along == pytest.approx(expected, abs=1e-7)


def at(places: dict[str, Any], letter: str, i: int) -> float:
    return float(places[letter][i])


def test_the_other_branch_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    right = recorded.where_less
    monkeypatch.setattr(recorded, "where_less", lambda x, y, yes, no: right(x, y, no, yes))
    (row,) = values(1, 0)
    assert swept(row)[0] != of(row)


def test_arrays_of_np_array_are_refused_with_the_fix() -> None:
    with pytest.raises(kr.InputError, match=r"np\.stack\(\[x, y\]\)"):
        kr.perturbed(kr.EulerTop(J=(1, 2, 3)), torque=lambda M: np.maximum(np.array([M[0], M[1], 0.0]), 0))


# -- in runs -----------------------------------------------------------------------------------------


def brake(M: Any, *, most: Any) -> Any:
    """A motor that brakes each axis with at most so much torque."""
    return -np.clip(M, -most, most) + 0.1 * np.where(M[2] > 0.8, M, 0.0)


BODY = kr.perturbed(kr.EulerTop(J=I.sum() / 2 - I), torque=brake, params={"most": [[0.05], [0.3], [10.0]]})
START = np.array([0.7, 0.4, 1.2])


def reference(most: float, time: float) -> np.ndarray:
    def rate(_: float, M: np.ndarray) -> np.ndarray:
        return cross(M, M / I) + brake(M, most=most)

    return solve_ivp(rate, (0, time), START, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.05).y[:, -1]


def test_lanes_of_a_run_are_those_of_scipy() -> None:
    run = kr.simulate(BODY, BODY.state(M=START), dt=0.01, steps=500, every=500, progress=False)
    assert "corner" in run.energy.attrs["long_name"] + run.balance.attrs["long_name"]
    expected = [reference(most, 5.0) for most in (0.05, 0.3, 10.0)]
    assert abs(run.M[-1].values - expected).max() < 2e-4  # 2e-5
    assert abs(expected[0] - expected[1]).max() > 0.1


def test_what_a_choice_may_change_is_not_conserved() -> None:
    """The torque vanishes below M = 50, at all points that are tried."""
    top = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5)
    body = kr.perturbed(top, torque=lambda M: np.where(abs(M) > 50, M, 0.0))
    run = kr.simulate(body, body.state(M=(0.3, 0.2, 1.1), P=(0.6, 0, 0.8)), dt=0.1, steps=2, progress=False)
    table = kr.drift(run)
    assert table.conserved.to_dict() == {name: name == "casimir[0]" for name in table.index}


def test_gradients_of_a_run_are_those_of_differences() -> None:
    jax = pytest.importorskip("jax")
    from kreisel.reduction import double

    body = kr.perturbed(kr.EulerTop(J=I.sum() / 2 - I), torque=brake, params={"most": 0.3})
    f = kr.differentiable(body, method="splitting", order=4)

    def end(M: Any) -> Any:
        return f({"M": M}, dt=0.1, steps=3)["M"]

    with double():
        found = np.asarray(jax.jacrev(end)(START))
    columns = [(np.asarray(end(START + e)) - np.asarray(end(START - e))) / 2e-5 for e in 1e-5 * np.eye(3)]
    assert abs(found - np.array(columns).T).max() < 1e-8  # 1e-10
