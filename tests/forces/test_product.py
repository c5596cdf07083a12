"""Bodies of different systems under one potential."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.forces.records import conserved
from support import cross

TOP = kr.LagrangeTop(p=(0, 0, 1), alpha=0.5)
HEAVY = kr.HeavyTop(J=(1, 2, 2.5), A=(0.1, 0.2, 0.3))
START = {"m1": (0.1, 0.2, 1.5), "a1": (0.6, 0, 0.8), "m2": (0.3, -0.2, 1.1), "a2": (0, 0.6, 0.8)}


def magnets(a1: Any, a2: Any, *, k: Any) -> Any:
    return -k * (a1 @ a2)


def test_two_tops_are_those_of_a_pair() -> None:
    both = kr.perturbed([TOP, kr.LagrangeTop(p=(0, 0, 1), alpha=0.7)], potential=magnets, params={"k": 0.1})
    run = kr.simulate(both, both.state(**START), dt=0.1, steps=300, every=10)
    tops = kr.LagrangeTop(p=(0, 0, 1), alpha=[0.5, 0.7])
    pair = kr.perturbed(tops, pair_potential=magnets, pairs=[(0, 1)], params={"k": 0.1})
    x0 = pair.state(m=[START["m1"], START["m2"]], a=[START["a1"], START["a2"]])
    same = kr.simulate(pair, x0, dt=0.1, steps=300, every=10)
    for body in (0, 1):
        np.testing.assert_allclose(run[f"a{body + 1}"], same.a[:, body], rtol=0, atol=1e-11)
    np.testing.assert_allclose(run.energy, same.total_energy[:, 0], rtol=1e-11)
    np.testing.assert_allclose(run.total_noether, same.total_noether[:, 0], rtol=0, atol=1e-11)
    table = kr.drift(run)
    assert table.conserved["total_noether[2]"] and table.max_change["total_noether[2]"] < 1e-14
    assert not table.conserved["noether1[2]"] and table.max_change["noether1[2]"] > 0.01


def by_vectors(time: float) -> np.ndarray:
    """A top in space and a heavy body in its frame, V = k a_3 P_1 cos t, by vectors and another integrator."""
    k, moments, A = 0.05, np.array([4.5, 3.5, 3.0]), np.array([0.1, 0.2, 0.3])

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        m, a, M, P = y.reshape(4, 3)
        by_a, by_P = k * P[0] * np.cos(t) * np.array([0, 0, 1]), k * a[2] * np.cos(t) * np.array([1, 0, 0])
        Omega = M / moments
        top = cross((0, 0, 1), a) - cross(a, by_a), cross(m, a)
        return np.concatenate([*top, cross(M, Omega) + cross(P, A + by_P), cross(P, Omega)])

    start = np.concatenate([START["m1"], START["a1"], (0.3, 0.2, 0.1), (0, 0.6, 0.8)])
    return np.asarray(solve_ivp(rates, (0, time), start, method="DOP853", rtol=1e-12, atol=1e-11).y[:, -1])


def test_a_top_and_a_heavy_body_move_as_by_vectors() -> None:
    both = kr.perturbed(
        [TOP, HEAVY], potential=lambda a1, P2, t, *, k: k * np.cos(t) * a1[2] * P2[0], params={"k": 0.05}
    )
    x0 = both.state(m1=START["m1"], a1=START["a1"], M2=(0.3, 0.2, 0.1), P2=(0, 0.6, 0.8))
    run = kr.simulate(both, x0, dt=0.1, steps=100, every=10)
    found = np.concatenate([run[letter][-1] for letter in ("m1", "a1", "M2", "P2")])
    np.testing.assert_allclose(found, by_vectors(10.0), rtol=0, atol=1e-8)
    assert abs(run.balance - run.balance[0]).max() < 1e-9 < 1e-3 < abs(run.work).max()
    assert kr.drift(run).conserved[[f"casimir[{i}]" for i in range(4)]].all()
    assert {"noether1", "casimir"} <= {*conserved(both)} and "spectrum1" not in conserved(both)  # a pull along p
    by_flow = kr.simulate(both, x0, dt=10.0, steps=1, method="dop853", tol=1e-11)
    np.testing.assert_allclose(by_flow.P2[-1], run.P2[-1], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("systems", "forces", "message"),
    [
        ([TOP], {"potential": lambda a1: a1[0]}, "expected 2 to 8 systems"),
        ([TOP, 3], {"potential": lambda a1: a1[0]}, "expected 2 to 8 systems"),
        ([TOP, kr.LagrangeTop(p=(0, 0, 0, 1))], {"potential": lambda a1: a1[0]}, "one dimension n, got 3, 4"),
        ([TOP, kr.perturbed(TOP, damping=0.1)], {"potential": lambda a1: a1[0]}, "expected an integrable system"),
        ([TOP, TOP], {}, "expected several bodies with one potential, of a1, a2, t"),
        ([TOP, TOP], {"damping": 0.1}, "expected several bodies with one potential"),
        ([TOP, TOP], {"potential": lambda a1: a1[0], "damping": 0.1}, "got none, or other forces"),
        ([TOP, TOP], {"potential": lambda a1, g: a1[0]}, "Forces that depend on g"),
        ([TOP, TOP], {"potential": lambda a: a[0]}, "potential: expected arguments among m1, a1, m2, a2"),
        ([TOP, TOP], {"potential": lambda m1: m1[0]}, "got one of the momentum m1, m2"),
        ([TOP, TOP], {"potential": magnets, "params": {"k": 1.0, "p1": 2.0}}, "params: expected names"),
    ],
)
def test_what_does_not_fit_is_refused(systems: Any, forces: Any, message: str) -> None:
    with pytest.raises(kr.InputError, match=message):
        kr.perturbed(systems, **forces)
