"""Steps by flows that are far faster than the motion, judged by DOP853 on the equations of motion."""

import warnings
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.runs import planning

J = np.array([1.0, 3.5, 14.0, 2500.0])
MOMENTA = np.array([0.34, 0.61, 0.01, -0.55, -0.27, -0.37])
P = np.array([-0.24, 0.04, -0.96, 0.16])


def skew(m: np.ndarray) -> np.ndarray:
    M = np.zeros((4, 4))
    M[np.triu_indices(4, 1)] = m
    return M - M.T


def truth(J: np.ndarray, m: np.ndarray, p: np.ndarray, time: float) -> np.ndarray:
    """M' = [M, Omega] + P ^ JP,  P' = -Omega P, with each of M and P in its size."""
    sizes, units = (np.linalg.norm(m), np.linalg.norm(p)), 1 / (J[:, None] + J)

    def flow(_: float, y: np.ndarray) -> np.ndarray:
        M, P = y[:16].reshape(4, 4) * sizes[0], y[16:] * sizes[1]
        W = units * M
        rate = M @ W - W @ M + np.outer(P, J * P) - np.outer(J * P, P)
        return np.concatenate([rate.ravel() / sizes[0], -W @ P / sizes[1]])

    start = np.concatenate([skew(m).ravel() / sizes[0], p / sizes[1]])
    return solve_ivp(flow, (0, time), start, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]


def error(J: np.ndarray, m: np.ndarray, p: np.ndarray, time: float, **method: Any) -> tuple[float, str]:
    """The difference from the truth, and the warnings, of a run."""
    body = kr.ClebschBody(J=J)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        run = kr.simulate(body, body.state(M=skew(m), P=p), t_end=time, **method)
    end = np.concatenate([run.M.values[-1].ravel() / np.linalg.norm(m), run.P.values[-1] / np.linalg.norm(p)])
    return float(abs(end - truth(J, m, p, time)).max()), " ".join(str(w.message) for w in seen)


def test_steps_too_long_for_flows_that_are_combined_are_warned_of() -> None:
    """Moments spread by 2,500 and |M|/|P| of 5e4; a step is 0.1 rad of the motion."""
    wrong, words = error(J, MOMENTA, P / 5e4, 1.0, method="baecklund", order=12, dt=1.0)
    assert wrong > 1e-2
    assert "rad of the flows of clebsch-body that method='baecklund' combines" in words
    dt = float(words.split("Use a dt of ")[1].split()[0])
    right, silence = error(J, MOMENTA, P / 5e4, 1.0, method="baecklund", order=12, dt=dt)
    assert right < 1e-10
    assert not silence
    assert error(J, MOMENTA, P / 5e4, 1.0, method="exact", dt=1.0)[0] < 1e-10


@pytest.mark.parametrize("lane", [7, 18])
def test_a_lane_of_a_large_ensemble_is_warned_of(lane: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "MOST_NUMBERS", 100)
    monkeypatch.setattr(planning, "SAMPLE", 3)
    Js, Ps = np.tile([1.0, 1.5, 2.0, 2.7], (20, 1)), np.tile(P, (20, 1))
    Js[lane], Ps[lane] = J, P / 5e4
    body = kr.ClebschBody(J=Js)
    with pytest.warns(kr.AccuracyWarning, match="rad of the flows of clebsch-body"):
        kr.simulate(body, body.state(M=skew(MOMENTA), P=Ps), dt=1.0, steps=1, method="baecklund", order=12)


def test_rounding_of_exact_by_many_flows_is_warned_of() -> None:
    m = np.array([1.4749106, 0.9809461, 1.247057, -1.2702415, 0.06250661, -0.789343069]) / 2.6
    J = np.array([1.4146888, 8268.46211, 1.0, 1.0258129])
    p = np.array([0.7877, -3.1038, 2.3563, 1.91355]) * 1e-6
    wrong, words = error(J, m, p, 0.9877, method="exact", dt=0.9877)
    assert 1e-11 < wrong < 1e-6
    assert "method='exact' combines flows that rotate by" in words


@pytest.mark.parametrize("method", [{"method": "exact"}, {"method": "baecklund", "order": 2}])
def test_ordinary_bodies_are_silent(method: dict[str, Any]) -> None:
    assert not error(np.array([1.0, 1.5, 2.0, 2.7]), MOMENTA, P, 0.1, dt=0.1, **method)[1]


@pytest.mark.parametrize(("order", "steps", "warned"), [(2, 128, True), (2, 8, False), (4, 128, False)])
def test_errors_of_fast_flows_that_accumulate_are_warned_of(order: int, steps: int, warned: bool) -> None:
    """A step is 0.09 rad of the motion, which looks short enough, and 0.34 rad of the flows."""
    b = np.array([-3.0, -1.0, 1.0, 5.0])
    M, P = skew(np.array([2.0, 1, -2, 1, 2, -2])), skew(np.array([-1.0, -1, 2, 1, -1, 2]))
    plus, product = b[:, None] + b, (b * b)[:, None] + b * b

    def flow(_: float, y: np.ndarray) -> np.ndarray:
        M, P = y.reshape(2, 4, 4)
        W, F = plus * M + product * P / 2, product * M / 2 + plus * np.subtract.outer(b, b) ** 2 * P / 4
        return np.concatenate([M @ W - W @ M + P @ F - F @ P, P @ W - W @ P]).ravel()

    body, dt = kr.SteklovLyapunov(b=b, s=1.0, l=0.0), 0.003
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        run = kr.simulate(body, body.state(M=M, P=P), dt=dt, steps=steps, method="baecklund", order=order)
    end = solve_ivp(flow, (0, steps * dt), np.stack([M, P]).ravel(), method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
    off = abs(np.stack([run.M.values[-1], run.P.values[-1]]).ravel() - end).max()
    assert (off > 0.1) == warned
    assert bool(seen) == warned
    if warned:
        assert f"{steps} steps of order {order} lose about 0.4 rad" in str(seen[0].message)
