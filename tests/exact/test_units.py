"""Closed forms in other units: a run scales as the dimensions of state and parameters say."""

from typing import Any

import numpy as np
import pytest

import kreisel as kr

M = np.array([0.7, -0.4, 1.1])
P = np.array([0.48, 0.64, 0.6])
Q = np.random.default_rng(5).normal(size=(2, 4, 4))
CASES = {  # parameters and state; their dimensions and the dimension of time
    "clebsch": (kr.Clebsch, {"b": [0.3, -0.9, 1.4]}, {"M": M, "P": P}, {"P": 1, "b": -2}, 0),
    "kirchhoff": (
        kr.KirchhoffRevolution,
        {"a1": 0.5, "a3": 0.8, "c1": 0.6, "c3": 0.9},
        {"M": M, "P": P},
        {"M": 1, "a1": -1, "a3": -1, "c1": 1, "c3": 1},
        0,
    ),
    "goryachev": (
        kr.GoryachevChaplygin,
        {"gamma": 0.3},
        {"M": np.cross(P, M), "P": P},
        {"M": 1, "P": 2, "gamma": 1},
        -1,
    ),
    "quadratic": (
        kr.QuadraticField,
        {"b": [0.3, -0.9, 1.4, 0.5]},
        {"M": Q[0] - Q[0].T, "F": Q[1] + Q[1].T},
        {"F": 1, "b": -1},
        0,
    ),
}


def run_in(unit: float, of: Any, params: Any, state: Any, powers: dict[str, int], time: int) -> dict[str, np.ndarray]:
    scaled = [{k: np.asarray(v) * unit ** powers.get(k, 0) for k, v in x.items()} for x in (params, state)]
    system = of(**{k: v if v.ndim else float(v) for k, v in scaled[0].items()})
    run = kr.simulate(system, system.state(**scaled[1]), dt=0.125 * unit**time, steps=20, every=10, method="exact")
    return {k: run[k].values / unit ** powers.get(k, 0) for k in state}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("exponent", [100, -100])
def test_a_run_scales_as_dimensions_say(name: str, exponent: int) -> None:
    """Units of 1e30 and 1e-30."""
    usual, scaled = run_in(1.0, *CASES[name]), run_in(2.0**exponent, *CASES[name])
    for letter, value in usual.items():
        assert abs(scaled[letter] - value).max() < 1e-12 * abs(value).max()
