"""Steps by flows that are far faster than the motion, judged by DOP853 on the equations of motion."""

import re
import warnings
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.runs import planning

J = np.array([1.0, 1.98, 32700.0, 1.27])
MOMENTA = np.array([-0.26, -0.89, 0.28, 0.08, 0.76, -1.46])
P = np.array([1.32, -2.33, 0.03, 0.49])


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
    """Moments spread by 32,700 and |M|/|P| of 700; a step is 0.3 rad of the motion."""
    wrong, words = error(J, MOMENTA, P / 1e3, 1.0, method="baecklund", order=12, dt=1.0)
    assert wrong > 1e-2
    assert "rad of the flows of clebsch-body that method='baecklund' combines" in words
    dt = float(words.split("Use a dt of ")[1].split()[0])
    right, silence = error(J, MOMENTA, P / 1e3, 1.0, method="baecklund", order=12, dt=dt)
    assert right < 1e-10
    assert not silence
    assert error(J, MOMENTA, P / 1e3, 1.0, method="exact", dt=1.0)[0] < 1e-10


@pytest.mark.parametrize("lane", [7, 18])
def test_a_lane_of_a_large_ensemble_is_warned_of(lane: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "MOST_NUMBERS", 100)
    monkeypatch.setattr(planning, "SAMPLE", 3)
    Js, Ps = np.tile([1.0, 1.5, 2.0, 2.7], (20, 1)), np.tile(P, (20, 1))
    Js[lane], Ps[lane] = J, P / 1e3
    body = kr.ClebschBody(J=Js)
    with pytest.warns(kr.AccuracyWarning, match="rad of the flows of clebsch-body"):
        kr.simulate(body, body.state(M=skew(MOMENTA), P=Ps), dt=1.0, steps=1, method="baecklund", order=12)


def test_rounding_of_exact_by_many_flows_is_warned_of() -> None:
    m = np.array([0.96, 0.23, 0.68, -0.67, -0.85, -2.36])
    J = np.array([1.0, 1.25, 3.11, 3e6])
    p = np.array([0.48, -1.34, -0.58, -0.85]) * 1e-4
    wrong, words = error(J, m, p, 0.7, method="exact", dt=0.7)
    assert 1e-11 < wrong < 1e-6
    assert "method='exact' combines flows that rotate by" in words


@pytest.mark.parametrize("method", [{"method": "exact"}, {"method": "baecklund", "order": 2}])
def test_ordinary_bodies_are_silent(method: dict[str, Any]) -> None:
    assert not error(np.array([1.0, 1.5, 2.0, 2.7]), MOMENTA, P, 0.1, dt=0.1, **method)[1]


STEKLOV = {"b": (-3, -1, 1, 5), "s": 1.0, "M": (2, 1, -2, 1, 2, -2), "P": (-1, -1, 2, 1, -1, 2), "dt": 0.003}
LYAPUNOV = {"b": (-3, -2, 2, 3), "s": 0.0, "M": (1, -1, 2, 1, -1, -2), "P": (1, 2, -1, -1, 2, -1), "dt": 0.03}


@pytest.mark.parametrize(
    ("case", "order", "steps", "warned"),
    [
        (STEKLOV, 2, 128, True),  # a step is 0.09 rad of the motion, which looks short, and 0.34 rad of the flows
        (STEKLOV, 2, 8, False),
        (STEKLOV, 4, 128, False),
        (LYAPUNOV, 2, 10, True),  # 0.3 and 0.74 rad
        (LYAPUNOV, 4, 10, False),
    ],
)
def test_errors_of_fast_flows_that_accumulate_are_warned_of(
    case: dict[str, Any], order: int, steps: int, warned: bool
) -> None:
    b, M, P = np.array(case["b"], float), skew(np.array(case["M"])), skew(np.array(case["P"]))
    s, dt = case["s"], case["dt"]
    plus, product = b[:, None] + b, (b * b)[:, None] + b * b
    x, y = s * plus + 1 - s, s * product + (1 - s) * plus

    def flow(_: float, z: np.ndarray) -> np.ndarray:
        M, P = z.reshape(2, 4, 4)
        W, F = x * M + y * P / 2, y * M / 2 + x * np.subtract.outer(b, b) ** 2 * P / 4
        return np.concatenate([M @ W - W @ M + P @ F - F @ P, P @ W - W @ P]).ravel()

    body = kr.SteklovLyapunov(b=b, s=s, l=1 - s)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        run = kr.simulate(body, body.state(M=M, P=P), dt=dt, steps=steps, method="baecklund", order=order)
    end = solve_ivp(flow, (0, steps * dt), np.stack([M, P]).ravel(), method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
    off = abs(np.stack([run.M.values[-1], run.P.values[-1]]).ravel() - end).max()
    assert (off > 0.1) == warned
    assert bool(seen) == warned
    if warned:
        assert re.search(f"{steps} steps of order {order} lose about 0.[34] rad", str(seen[0].message))


@pytest.mark.parametrize(
    ("J", "method", "most"),
    [
        ((1.0, 30, 200, 1000, 5), {"method": "baecklund", "order": 8}, 1e-5),
        ((1e-3, 900, 0.862, 10.7, 2.3e-3), {"method": "exact"}, 1e-10),
    ],
)
def test_moments_of_very_different_sizes(J: tuple[float, ...], method: dict[str, Any], most: float) -> None:
    """Order 8 was off by 0.2, with a warning; `exact` ended with "casimir[0] is not conserved"."""
    J, M = np.array(J), np.triu(np.array([[1.0, 2, 3, 5, 8]]) - 4.5 * np.eye(5)[::-1], 1)
    units, M = 1 / (J[:, None] + J), M - M.T

    def flow(_: float, y: np.ndarray) -> np.ndarray:
        M = y.reshape(5, 5)
        return (M @ (units * M) - (units * M) @ M).ravel()

    dt = 0.3 / abs(units * M).max()
    end = solve_ivp(flow, (0, 10 * dt), M.ravel(), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    run = kr.simulate(kr.EulerTop(J=J), {"M": M}, dt=dt, steps=10, **method)
    assert abs(run.M.values[-1].ravel() - end).max() < most * abs(M).max()
