"""kr.fit: values, errors and what is undetermined, against data made by an integrator of its own."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.stats import chi2

import kreisel as kr
from kreisel import algebra
from kreisel.analysis import fit as fits

TOP = kr.LagrangeTop(p=(0, 0, 1.3))
X0 = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
BODY = kr.EulerTop(J=(1.0, 2.0, 3.0))
M0 = np.array([1.0, 2.0, 0.3])
NOISE = 0.01


def spinning(time: np.ndarray, moments: Any = (5.0, 4.0, 3.0)) -> np.ndarray:
    """Omega by Euler's equations."""
    I = np.asarray(moments)  # noqa: E741
    made = solve_ivp(lambda t, M: np.cross(M, M / I), (0, time[-1]), M0, "DOP853", time, rtol=1e-11, atol=1e-12)
    return made.y.T / I


def seen(time: Any, **variables: Any) -> xr.Dataset:
    dims = {0: (), 1: ("time",), 2: ("time", "axis"), 3: ("time", "i", "j")}
    return xr.Dataset({k: (dims[np.ndim(v)], v) for k, v in variables.items()}, {"time": np.asarray(time)})


def test_values_lie_within_their_errors_as_often_as_they_should() -> None:
    """12 fits of 5 unknowns: the sum of d^T C^-1 d is chi^2 of 60 degrees, outside these bounds once in 10^6."""
    time, rng = np.arange(60) * 0.1, np.random.default_rng(5)
    clean, truth = spinning(time), np.array([1.0, 2.0, *M0])
    total, count = 0.0, 12
    for _ in range(count):
        data = seen(time, Omega=clean + NOISE * rng.normal(size=clean.shape), sigma_Omega=NOISE)
        found = kr.fit(BODY, data, free={"J[0]": 1.1, "J[1]": 2.1, "M": M0 * 1.02}, x0={"M": M0}, dt=0.05)
        assert found.converged and found.sigma is None and found.dof == 175
        off = found.table["value"].to_numpy() - truth
        total += off @ np.linalg.solve(found.covariance.to_numpy(), off)
    low, high = chi2.ppf([0.5e-6, 1 - 0.5e-6], 5 * count)
    assert low < total < high
    assert not low < total / 4 < high  # errors twice as large would be seen


def test_gaps_and_times_between_steps() -> None:
    """Exact data: the values come back to the accuracy of the method, whichever numbers are missing."""
    time = np.array([0.013, 0.4, 0.77, 1.31, 2.0, 2.9, 3.333])
    Omega = spinning(np.concatenate([[0], time]))[1:]
    Omega[2, 1] = Omega[4] = np.nan
    data = seen(time[::-1], Omega=Omega[::-1])
    found = kr.fit(BODY, data, free={"J[0]": 1.2, "M": M0 * 1.1}, x0={"M": M0}, dt=0.1)
    assert found.dof == 17 - 4
    assert abs(found.table["value"].to_numpy() - [1, *M0]).max() < 1e-8
    assert found.sigma < 1e-8 and np.isnan(found.residuals.Omega.values).sum() == 4
    assert found.run.time.size == 7 and abs(found.run.M.values[-1] - Omega[-1] * [5, 4, 3]).max() < 1e-7


def test_the_error_of_an_observation_comes_from_the_residuals() -> None:
    time = np.arange(200) * 0.05
    clean = spinning(time)
    data = seen(time, Omega=clean + NOISE * np.random.default_rng(1).normal(size=clean.shape))
    found = kr.fit(BODY, data, free=["M"], x0={"M": M0}, dt=0.05)
    given = kr.fit(BODY, data.assign(sigma_Omega=found.sigma), free=["M"], x0={"M": M0}, dt=0.05)
    assert 0.8 < found.sigma / NOISE < 1.2  # 597 degrees of freedom: 7 standard deviations
    assert np.allclose(list(found.errors.values()), list(given.errors.values()), rtol=1e-6)
    assert abs(np.diag(found.correlation) - 1).max() < 1e-12


def test_a_run_is_an_observation_and_every_kind_of_number_can_be_free() -> None:
    run = kr.simulate(TOP, X0, dt=0.05, steps=80, every=8, project=False)
    near = kr.LagrangeTop(p=(0, 0.1, 1.2), alpha=1.0)
    found = kr.fit(near, run, free=["p", "m[0]"], x0={"m": (0.2, 0.2, 1.5), "a": X0.a})
    assert list(found.values) == ["p[0]", "p[1]", "p[2]", "m[0]"]
    assert abs(found.table["value"].to_numpy() - [0, 0, 1.3, 0.1]).max() < 1e-9
    assert "Fit of lagrange-top: chi^2" in repr(found) and "<table" in found._repr_html_()


def test_skew_matrices() -> None:
    n = 4
    rng = np.random.default_rng(n)
    top = kr.LagrangeTop(p=np.eye(n)[-1])
    m, a = algebra.skew(rng.normal(size=n * (n - 1) // 2), n), np.eye(n)[0]
    how: dict[str, Any] = {"method": "suris", "order": 1}
    run = kr.simulate(top, top.state(m=m, a=a), dt=0.05, steps=20, every=5, project=False, **how)
    data = seen(run.time.values, a=run.a.values, **{"m[0, 1]": run.m.values[:, 0, 1]})
    found = kr.fit(top, data, free={"m": m * 1.05}, x0={"m": m, "a": a}, dt=0.05, **how)
    assert len(found.values) == n * (n - 1) // 2 and list(found.values)[1] == "m[0, 2]"
    assert abs(found.state.m - m).max() < 1e-9


def test_observables_and_numbers_of_the_instrument() -> None:
    time = np.arange(80) * 0.1
    off = np.array([0.1, -0.2, 0.05])

    def gyroscope(M: Any, *, J: Any, bias: Any) -> Any:
        return M / (J.sum() - J) * jnp.array([1, 1, -1]) + bias

    data = seen(time, gyro=spinning(time)[:, :] * [1, 1, -1] + 1.25 - (1.25 - off))
    asked = {"M": M0 * 1.02, "J[0]": None, "bias": np.zeros(3)}
    more = {"x0": {"M": M0}, "dt": 0.05, "observables": {"gyro": gyroscope}}
    found = kr.fit(kr.EulerTop(J=(1.1, 2, 3)), data, free=asked, bounds={"bias": (-1, 1)}, **more)
    assert abs(found.table["value"].to_numpy() - [*M0, 1, *off]).max() < 1e-8


def test_integrals_are_observed_and_bounds_are_named() -> None:
    run = kr.simulate(TOP, X0, dt=0.1, steps=10)
    work = (run.m.values * run.a.values * [1, 2, 3]).sum(-1)
    data = seen(run.time.values, energy=run.energy.values, a=run.a.values, work=work)
    own = {"observables": {"work": lambda m, a: m @ (a * jnp.array([1.0, 2, 3]))}}
    found = kr.fit(TOP, data, free={"m[2]": 1.2}, x0=X0, dt=0.1, **own)
    assert abs(found.values["m[2]"] - 1.5) < 1e-9
    found = kr.fit(TOP, data, free={"m[2]": 1.2}, x0=X0, dt=0.1, bounds={"m[2]": (0, 1.4)}, **own)
    assert "at a bound: m[2]" in repr(found)


def test_an_undetermined_combination_is_named() -> None:
    """Omega does not tell a common factor of the moments and the momentum."""
    data = seen(np.arange(30) * 0.1, Omega=spinning(np.arange(30) * 0.1))
    with pytest.raises(kr.InputError, match=r"J\[0\] by 0.333, J\[1\] by 0.667, J\[2\] by 1, M\[0\] by 0.33") as raised:
        kr.fit(BODY, data, free=["J", "M"], x0={"M": M0}, dt=0.05)
    assert "singular Jacobian" in str(raised.value)
    J = np.random.default_rng(0).normal(size=(9, 3))
    assert np.allclose(fits.covariance_of(J, "xyz"), np.linalg.inv(J.T @ J))
    J[:, 1] = 0
    with pytest.raises(kr.InputError, match="do not change with y "):
        fits.covariance_of(J, "xyz")


def test_a_search_that_ends_early_warns() -> None:
    data = seen(np.arange(30) * 0.1, Omega=spinning(np.arange(30) * 0.1))
    with pytest.warns(kr.AccuracyWarning, match="did not converge"):
        found = kr.fit(BODY, data, free={"M": M0 * 1.3}, x0={"M": M0}, dt=0.05, evaluations=1)
    assert "NOT CONVERGED" in repr(found)


TIME = np.arange(5) * 0.1
DATA = seen(TIME, a=np.zeros((5, 3)))
SPHERE = {"x": (1.0, 0, 0), "q": (0, 0.3, 0.1)}
BAD: list[tuple[dict[str, Any], str]] = [
    ({"observations": 3}, "expected an xarray.Dataset"),
    ({"observations": seen(TIME, b=TIME)}, "got 'b'"),
    ({"observations": seen(TIME, a=TIME)}, r"expected a of the shape \(5, 3\), got \(5,\)"),
    ({"observations": seen(TIME - 1, a=np.zeros((5, 3)))}, "before the start"),
    ({"observations": seen(TIME.astype("M8[s]"), a=np.zeros((5, 3)))}, "timedelta64"),
    ({"observations": seen(TIME, a=np.zeros((5, 3)), sigma_a=0.0)}, "expected sigma_a > 0"),
    ({"observations": seen(TIME, a=np.zeros((5, 3)), sigma_b=0.1)}, "sigma_NAME for some NAME"),
    ({"observations": seen(TIME, a=np.zeros((5, 3)), m=np.zeros((5, 3)), sigma_a=0.1)}, "for each of a, m or for none"),
    ({"observations": seen(TIME, a=np.full((5, 3), np.inf))}, "got infinity in a"),
    ({"observations": seen(TIME, a=np.full((5, 3), np.nan))}, "as many numbers as unknowns, got 0"),
    ({"free": []}, "expected names"),
    ({"free": "p"}, "expected a list of names"),
    ({"free": ["q"]}, "expected parameters or components of lagrange-top, p, alpha, m, a, got 'q'"),
    ({"free": ["p[3]"]}, r"p has the numbers p\[0\], p\[1\], p\[2\], got 'p\[3\]'"),
    ({"free": ["p", "p[0]"]}, r"got p\[0\] twice"),
    ({"free": {"p": (1, 2)}}, r"expected numbers of shape \(3,\)"),
    ({"free": {"p[2]": "x"}}, "expected finite numbers"),
    ({"bounds": {"m": (0, 1)}}, "expected names of free numbers"),
    ({"bounds": {"p[2]": (2, 3)}}, "around the start 1.3"),
    ({"dt": None}, "expected the step"),
    ({"dt": -1.0}, "dt must be positive"),
    ({"x0": None}, "expected the state at time 0"),
    ({"evaluations": 0}, "evaluations"),
    ({"observations": seen(TIME, h=TIME), "observables": {"h": 3}}, "expected a function for h"),
    ({"observations": seen(TIME, h=TIME), "observables": {"h": lambda m, a: float(a[0])}}, "jax.numpy in place of"),
    ({"observations": seen(TIME, h=TIME), "observables": {"h": lambda m, a, *, k: k}}, "expected a start of k"),
    ({"observations": seen(TIME * 1e9, a=np.zeros((5, 3)))}, "at most 100,000,000 steps"),
    ({"system": kr.Neumann(b=(1, 2, 3)), "x0": SPHERE, "free": ["x"]}, "lies on"),
]


@pytest.mark.parametrize(("change", "message"), BAD, ids=[m[:40] for _, m in BAD])
def test_bad_input_is_named(change: dict[str, Any], message: str) -> None:
    asked: dict[str, Any] = {"system": TOP, "observations": DATA, "free": ["p[2]"], "x0": X0, "dt": 0.1, **change}
    with pytest.raises(kr.InputError, match=message):
        kr.fit(asked.pop("system"), asked.pop("observations"), **asked)
