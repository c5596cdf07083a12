"""The Euler top, n = 3, in Jacobi's functions: against a solver, at far times, and along Moser-Veselov's map."""

from __future__ import annotations

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra

CASES = {
    "about the third axis": ((1, 2, 3), (0.3, -0.5, 2.0)),
    "about the first axis": ((1, 2, 3), (2.0, -0.5, 0.3)),
    "axes in another order": ((3, 1, 2), (0.3, -1.5, 0.7)),
    "backwards": ((2, 3, 1), (-0.3, 0.5, -0.7)),
    "a symmetric body": ((1, 1, 3), (0.3, -0.5, 0.7)),
    "a flat symmetric body": ((1, 2, 2), (0.3, -0.5, 0.7)),
    "close to the separatrix": ((1, 2, 3), (1e-4, 1.0, 1e-4)),
    "on the separatrix": ((3.5, 2.5, 0.5), (0.5, 0.25, 0.5)),  # I = (3, 4, 6)
    "steady": ((1, 2, 3), (0.0, 0.0, 1.0)),
    "steady, unstable": ((1, 2, 3), (0.0, 1.0, 0.0)),
    "a ball": ((2, 2, 2), (0.3, -0.5, 0.7)),
}


@pytest.mark.parametrize("case", CASES)
def test_flow(case: str) -> None:
    J, mu = CASES[case]
    top = kr.EulerTop(J=J)
    x0, times = top.state(M=mu), [0.0, 0.7, -1.3, 12.0, 40.0]
    here = kr.at(top, x0, times)
    assert (abs(here.M[0] - mu) < 1e-15).all()
    moments = np.array([J[1] + J[2], J[2] + J[0], J[0] + J[1]], dtype=float)
    rate = lambda t, u: np.cross(u, u / moments)  # noqa: E731
    from scipy.integrate import solve_ivp

    for k, t in enumerate(times[1:], 1):
        truth = solve_ivp(rate, (0, t), mu, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
        assert abs(here.M.values[k] - truth).max() < 1e-10, (case, t)
    told = kr.drift(here)
    assert (told.max_change < 1e-14 * np.maximum(1, abs(told.start))).all()


def test_far_times_in_pieces() -> None:
    """The state at t + s is that at s from the state at t, whole periods on."""
    top = kr.EulerTop(J=(1, 2, 3))
    x0 = top.state(M=(1.0, -0.5, 0.75))
    far = kr.at(top, x0, [1e9, 1e9 + 0.5])
    on = kr.at(top, top.state(M=far.M.values[0]), [0.5])
    assert abs(on.M.values[0] - far.M.values[1]).max() < 1e-14


def test_against_taylor_series() -> None:
    """In 24 digits, from the equations alone."""
    from kreisel.lab.taylor import free_body

    mu, moments = np.array([0.9, 0.4, 0.6]), (2.0, 1.75, 1.25)
    top = kr.EulerTop(J=(0.5, 0.75, 1.25))
    there = kr.at(top, top.state(M=mu), [3.0, 30.0])
    for time, ours in zip((3.0, 30.0), there.M.values, strict=True):
        assert abs(ours - free_body(mu, moments, time).astype(float)).max() < 2e-15


def test_moser_veselov_is_the_flow_over_a_constant_time() -> None:
    """M_k at k s for one s, which is not eps."""
    from scipy.optimize import brentq

    top = kr.EulerTop(J=(1, 2, 3))
    x0 = top.state(M=(1.0, -0.5, 0.75))
    run = kr.simulate(top, x0, dt=0.3, steps=1000, every=1, method="veselov")
    off = lambda t: float(kr.at(top, x0, [t]).M.values[0, 1] - run.M.values[1, 1])  # noqa: E731
    shift = brentq(off, 0.25, 0.35, xtol=1e-15)
    assert abs(shift - 0.3) > 1e-4
    there = kr.at(top, x0, shift * np.arange(1001.0))
    assert abs(there.M.values - run.M.values).max() < 1e-11


def test_it_is_a_method_of_simulate() -> None:
    top = kr.EulerTop(J=(1, 2, 3))
    x0 = top.state(M=(1.0, -0.5, 0.75))
    run = kr.simulate(top, x0, dt=0.5, steps=100, method="exact")
    assert kr.drift(run).conserved.all() and (kr.drift(run).max_change < 1e-14).all()
    with pytest.raises(kr.InputError, match="orientation"):
        kr.simulate(top, x0, dt=0.5, steps=100, method="exact", orientation=(1, 0, 0, 0))
    with pytest.raises(kr.InputError, match="n = 3"):
        kr.simulate(kr.EulerTop(J=(1, 2, 3, 4)), {"M": algebra.skew(np.ones(6), 4)}, dt=0.5, steps=100, method="exact")
