"""kr.fit: values, errors and what is undetermined, against data made by an integrator of its own."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import kreisel as kr
from kreisel import algebra
from kreisel.analysis import fit as fits
from sizes import FULL
from support import cross, rotation_matrix

TOP = kr.LagrangeTop(p=(0, 0, 1.3))
X0 = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
BODY = kr.EulerTop(J=(1.0, 2.0, 3.0))
M0 = np.array([1.0, 2.0, 0.3])
NOISE = 0.01


def spinning(time: np.ndarray, moments: Any = (5.0, 4.0, 3.0)) -> np.ndarray:
    """Omega by Euler's equations."""
    I = np.asarray(moments)  # noqa: E741
    made = solve_ivp(lambda t, M: cross(M, M / I), (0, time[-1]), M0, "DOP853", time, rtol=1e-11, atol=1e-12)
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


def test_a_step_that_is_too_long_for_the_errors() -> None:
    """Exact data: at dt = 0.4 gravity is 15 errors off; the warning has 3/4 of this, as of order 2."""
    time = np.arange(61) * 0.2
    rate = lambda t, x: [*cross(np.array([0, 0, 1.3]), x[3:]), *cross(x[:3], x[3:])]  # noqa: E731
    start = [0.1, 0.2, 1.5, 0.6, 0.0, 0.8]
    axis = solve_ivp(rate, (0, time[-1]), start, "DOP853", time, rtol=1e-11, atol=1e-12).y[3:].T
    asked: dict[str, Any] = {"free": ["p[2]", "m"], "x0": X0}
    fine = kr.fit(TOP, seen(time, a=axis, sigma_a=0.02), dt=0.02, **asked)
    assert fine.values["p[2]"] == pytest.approx(1.3, abs=fine.errors["p[2]"] / 10)
    with pytest.warns(kr.AccuracyWarning, match=r"half the step moves .* times its error"):
        kr.fit(TOP, seen(time, a=axis), dt=0.4, **asked)  # the error of a value by the residuals
    with pytest.warns(kr.AccuracyWarning, match=r"half the step moves p\[2\] by -.* times its error") as caught:
        coarse = kr.fit(TOP, seen(time, a=axis, sigma_a=0.02), dt=0.4, **asked)
    off = coarse.values["p[2]"] - 1.3
    assert off > 10 * coarse.errors["p[2]"]
    moved = float(str(caught[0].message).partition(" by ")[2].partition(",")[0])
    assert moved == pytest.approx(-0.75 * off, rel=0.25)


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


def test_a_skew_matrix_has_its_entries_once() -> None:
    """Six values a row for n = 4, as if each was named: M_ij and M_ji are one observation."""
    rng, J = np.random.default_rng(2), (1.0, 2.0, 3.0, 4.0)
    top, M = kr.EulerTop(J=J), algebra.skew(np.array([0.3, -0.2, 0.5, 0.1, 0.4, -0.3]), 4)
    how: dict[str, Any] = {"method": "kahan", "order": 2}
    run = kr.simulate(top, top.state(M=M), dt=0.05, steps=80, every=8, project=False, **how)
    noisy = run.M.values + 1e-3 * algebra.skew(rng.normal(size=(11, 6)), 4)
    entries = {f"M[{i}, {j}]": noisy[:, i, j].copy() for i in range(4) for j in range(i + 1, 4)}
    noisy[3, 2, 1] = noisy[5, 0, 3] = np.nan  # entries without a mirror image
    asked: dict[str, Any] = {"free": ["J[0]", "M"], "x0": {"M": M}, "dt": 0.05, **how}
    for sigma in (*[1e-3] * FULL, None):
        errors = {} if sigma is None else dict.fromkeys([f"sigma_{name}" for name in entries], sigma)
        data = seen(run.time.values, M=noisy, **({} if sigma is None else {"sigma_M": sigma}))
        found, each = kr.fit(top, data, **asked), kr.fit(top, seen(run.time.values, **entries, **errors), **asked)
        assert found.dof == each.dof == 6 * 11 - 7
        assert found.chi2 == pytest.approx(each.chi2, rel=1e-6, abs=0)
        assert list(found.errors.values()) == pytest.approx(list(each.errors.values()), rel=1e-6, abs=0)
    assert 0.5e-3 < found.sigma < 1.6e-3  # by 59 values: beyond five standard deviations


def test_a_direction_has_two_values_and_an_attitude_three() -> None:
    """Their errors from residuals: rotations by angles of NOISE; by the count of entries sigma is 18 or 13 % less."""
    time, rng = np.arange(1, 601) * 0.05, np.random.default_rng(4)
    angles = NOISE * rng.normal(size=(600, 3))
    run = kr.simulate(BODY, {"M": M0}, dt=0.05, times=time, orientation=(1, 0, 0, 0), progress=False)
    turn = Rotation.from_quat(run.g.values, scalar_first=True) * Rotation.from_rotvec(angles)
    asked: dict[str, Any] = {"free": ["M"], "x0": {"M": M0}, "dt": 0.05, "orientation": (1, 0, 0, 0)}
    star = {"observables": {"star": lambda M, *, g: g.T @ jnp.array([0.6, 0.0, 0.8])}}
    direction = turn.inv().apply([0.6, 0.0, 0.8])
    loose = direction + NOISE * rng.normal(size=(600, 3))  # not of length 1
    for data, more, count, sigma in (
        (seen(time, g=turn.as_quat(scalar_first=True)), {}, 3, NOISE / 2),
        (seen(time, star=direction), star, 2, NOISE),
        (seen(time, star=loose), star, 3, NOISE * np.sqrt(5 / 3)),
    ):
        found = kr.fit(BODY, data, **asked, **more)
        assert found.dof == 600 * count - 3
        assert found.sigma == pytest.approx(sigma, rel=0.1)  # five standard deviations of 1,200 values
        assert abs(found.table["value"] - M0).max() < 5 * found.table["error"].max()


def test_errors_of_rotation_matrices_are_of_their_angles() -> None:
    """n = 4, rotated by six angles of size NOISE: chi^2 is 6 a row, was 12; of values that are not rotations 16."""
    rng, top = np.random.default_rng(7), kr.EulerTop(J=(1.0, 2.0, 3.0, 4.0))
    true, half = np.linalg.qr(rng.normal(size=(400, 4, 4))).Q, algebra.skew(NOISE / 2 * rng.normal(size=(400, 6)), 4)
    turned = true @ np.linalg.solve(np.eye(4) - half, np.eye(4) + half)
    loose = true + NOISE * rng.normal(size=(400, 4, 4))
    for g, sigma, values in ((turned, NOISE, 6), (turned, None, 6 * NOISE**2), (loose, NOISE, 16)):
        data = seen(np.arange(400.0), g=g, **({} if sigma is None else {"sigma_g": sigma}))
        observations = fits.observed(top, data, 1.0, {}, {"g": np.eye(4)})
        residuals = observations.flat(observations.differences([true]))
        assert residuals @ residuals / 400 == pytest.approx(values, rel=0.15)  # five standard deviations


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


INERTIA, DIPOLE, RADIUS, TILT = np.array([0.0092, 0.0325, 0.0335]), np.array([0.02, -0.01, 0.015]), 6_878_137.0, 1.7
ATTITUDE, SPIN = np.array([0.8, 0.0, 0.6, 0.0]), np.array([0.012, -0.004, 0.008])


def tumbling(time: np.ndarray) -> np.ndarray:
    """Omega of a satellite by a textbook's equations; the field of the Earth points north over the equator."""
    rate = np.sqrt(3.986004418e14 / RADIUS**3)

    def equations(t: float, y: np.ndarray) -> np.ndarray:
        q, omega = y[:4] / np.linalg.norm(y[:4]), y[4:]
        s, c = np.sin(rate * t), np.cos(rate * t)
        u = np.array([c, np.cos(TILT) * s, np.sin(TILT) * s])
        field = 29.35e-6 * (6_371_200 / RADIUS) ** 3 * (np.array([0, 0, 1]) - 3 * u[2] * u)
        to_body = rotation_matrix(q).T
        up = to_body @ u
        torque = 3 * rate**2 * cross(up, INERTIA * up) + cross(DIPOLE, to_body @ field)
        turn = np.append(-q[1:] @ omega, q[0] * omega + cross(q[1:], omega)) / 2
        return np.append(turn, (torque - cross(omega, INERTIA * omega)) / INERTIA)

    found = solve_ivp(equations, (0, time[-1]), [*ATTITUDE, *SPIN], "DOP853", time, rtol=1e-10, atol=1e-13)
    return np.asarray(found.y[4:].T)


def test_the_dipole_and_the_inertia_of_a_satellite() -> None:
    """From rates with noise: d^T C^-1 d of the true values is chi^2 of 8 degrees; that of a turned field is far off."""
    time, noise = np.arange(0, 901, 10.0), 1e-3 * np.random.default_rng(8).normal(size=(91, 3))
    data = seen(time, Omega=tumbling(time) + noise, sigma_Omega=1e-3)
    orbit = kr.physical.Orbit.circular(RADIUS - 6_378_137.0, inclination=TILT)
    drawing = kr.physical.Satellite((0.0083, 0.0355, 0.0335), orbit)
    free = ["dipole", "moments[0]", "moments[1]", "M"]
    asked: dict[str, Any] = {"x0": drawing.state(spin=data.Omega[0].values), "dt": 10.0, "order": (2, 2)}
    with pytest.raises(kr.InputError, match=r"expected an initial orientation=..., got none"):
        kr.fit(drawing.model(), data, free=free, **asked)
    found = kr.fit(drawing.model(), data, free=free, orientation=drawing.orientation(ATTITUDE), **asked)
    inverse = np.linalg.inv(found.covariance.to_numpy())
    off = found.table["value"].to_numpy() - [*DIPOLE, *INERTIA[:2], *(INERTIA * SPIN)]
    low, high = chi2.ppf([0.5e-6, 1 - 0.5e-6], 8)
    assert found.converged and low < off @ inverse @ off < high and found.chi2 < chi2.ppf(1 - 1e-6, found.dof)
    other = off + np.array([*(2 * DIPOLE), *np.zeros(5)])
    assert other @ inverse @ other > 10 * high
    assert abs(found.run.M.values[-1] / INERTIA - data.Omega.values[-1]).max() < 0.01


def test_an_attitude_is_found_from_quaternions_of_either_sign_and_what_takes_it() -> None:
    """Of a free body; g of SciPy's rotations by the rates of Euler's equations, sign by sign at random."""
    time, first = np.linspace(0, 3, 31), np.array([0.5, -0.5, 0.5, 0.5])

    def equations(t: float, y: np.ndarray) -> np.ndarray:
        omega = y[4:] / (5.0, 4.0, 3.0)
        return np.append(np.append(-y[1:4] @ omega, y[0] * omega + cross(y[1:4], omega)) / 2, cross(y[4:], omega))

    made = solve_ivp(equations, (0, 3), [*first, *M0], "DOP853", time, rtol=1e-12, atol=1e-12).y
    signs = np.random.default_rng(2).choice([-1, 1], size=31)
    sun = np.array([0.6 * np.cos(0.1 * time), 0.6 * np.sin(0.1 * time), 0.8 + 0 * time]).T  # which goes round
    seen_sun = np.stack(
        [Rotation.from_quat(q, scalar_first=True).inv().apply(s) for q, s in zip(made[:4].T, sun, strict=True)]
    )

    def sensor(M: Any, *, g: Any, t: Any) -> Any:
        return g.T @ jnp.array([0.6 * jnp.cos(0.1 * t), 0.6 * jnp.sin(0.1 * t), 0.8])

    near = Rotation.from_quat(first, scalar_first=True) * Rotation.from_rotvec([0.1, -0.05, 0.08])
    asked: dict[str, Any] = {"free": ["orientation", "M"], "x0": {"M": M0 * 1.01}, "dt": 0.1, "orientation": near}
    for data, more in (
        (seen(time, g=(made[:4] * signs).T), {}),
        (seen(time, sun=seen_sun, **{"M[0]": made[4]}), {"observables": {"sun": sensor}}),
    ):
        found = kr.fit(BODY, data, **asked, **more)
        assert list(found.values)[:3] == ["orientation[0]", "orientation[1]", "orientation[2]"]
        assert found.dof > 80 and abs(found.state.axial.M - M0).max() < 1e-7
        assert min(abs(found.orientation - first).max(), abs(found.orientation + first).max()) < 1e-7
    with pytest.raises(kr.InputError, match=r"expected orientation=..., where the search for the orientation begins"):
        kr.fit(BODY, seen(time, M=made[4:].T), free=["orientation"], x0={"M": M0}, dt=0.1)


def test_every_parameter_can_be_free() -> None:
    """A mass tensor with products of inertia, from a diagonal one."""
    J = np.array([[1.0, 0.1, 0.05], [0.1, 1.3, -0.1], [0.05, -0.1, 0.6]])
    top = kr.HeavyTop(J=J, A=(0.1, 0, 1))
    run = kr.simulate(
        top, {"M": (0.1, 0.2, 1.5), "P": (0.6, 0, 0.8)}, dt=0.05, steps=60, every=6, method="kahan", project=False
    )
    free = ["J[0, 0]", "J[1, 1]", "J[2, 2]", "J[0, 1]", "J[0, 2]", "J[1, 2]"]
    found = kr.fit(kr.HeavyTop(J=(1, 1.3, 0.6), A=(0.1, 0, 1)), run, free=free, method="kahan")
    assert abs(found.model.params["J"] - J).max() < 1e-8


TIME = np.arange(5) * 0.1
DATA = seen(TIME, a=np.zeros((5, 3)))
SPHERE = {"x": (1.0, 0, 0), "q": (0, 0.3, 0.1)}
BAD: list[tuple[dict[str, Any], str]] = [
    ({"observations": 3}, "expected an xarray.Dataset"),
    ({"observations": seen(TIME, b=TIME)}, "got 'b'"),
    ({"observations": seen(TIME, a=TIME)}, r"expected a of the shape \(5, 3\), got \(5,\)"),
    ({"observations": seen(TIME, **{"a[3]": TIME})}, r"a\[3\]: expected indices, .* within the shape \(3,"),
    ({"observations": seen(TIME, **{"Omega[0, 1]": TIME})}, r"Omega\[0, 1\]: expected indices"),
    ({"observations": seen(TIME - 1, a=np.zeros((5, 3)))}, "before the start"),
    ({"observations": seen(TIME.astype("M8[s]"), a=np.zeros((5, 3)))}, "timedelta64"),
    ({"observations": seen(TIME, a=np.zeros((5, 3)), sigma_a=0.0)}, "expected sigma_a > 0"),
    ({"observations": seen(TIME, a=np.zeros((5, 3)), sigma_a=np.inf)}, "expected sigma_a > 0 and finite.* NaN in a"),
    ({"observations": seen(TIME, a=np.zeros((5, 3)), sigma_b=0.1)}, "sigma_NAME for some NAME"),
    ({"observations": seen(TIME, a=np.zeros((5, 3)), m=np.zeros((5, 3)), sigma_a=0.1)}, "for each of a, m or for none"),
    ({"observations": seen(TIME, a=np.full((5, 3), np.inf))}, "got infinity in a"),
    ({"observations": seen(TIME, a=np.full((5, 3), np.nan))}, "as many values as unknowns, got 0"),
    ({"free": []}, "expected names"),
    ({"free": "p"}, "expected a list of names"),
    ({"free": ["q"]}, "expected parameters or components of lagrange-top, p, alpha, m, a, got 'q'"),
    ({"free": ["p[3]"]}, r"p has the entries p\[0\], p\[1\], p\[2\], got 'p\[3\]'"),
    ({"free": ["p", "p[0]"]}, r"got p\[0\] twice"),
    ({"free": {"p": (1, 2)}}, r"expected values of shape \(3,\)"),
    ({"free": {"p[2]": "x"}}, "expected finite values"),
    ({"bounds": {"m": (0, 1)}}, "expected names of free values"),
    ({"bounds": {"p[2]": (2, 3)}}, "around the start 1.3"),
    ({"dt": None}, "expected the step"),
    ({"dt": -1.0}, "dt must be a positive"),
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


def test_unknowns_of_a_body_have_the_names_of_its_runs() -> None:
    """Names that the message lists are accepted."""
    body = kr.physical.FreeBody((1.0, 2.0, 2.5))
    run = kr.simulate(body, body.state((1.0, 0.1, 0.2)), dt=0.1, steps=20, progress=False)
    with pytest.raises(kr.InputError, match=r"J, M \(momentum\), orientation, got 'spin'"):
        kr.fit(body, run, free=["spin"])
    assert kr.fit(body, run, free=["momentum[0]"]).table["value"].iloc[0] == pytest.approx(1 / (5.5 / 3))


@pytest.mark.parametrize("turn", [None, (0.3, -0.5, 0.8)], ids=["principal axes", "other axes"])
def test_the_moments_of_a_free_body(turn: Any) -> None:
    """From rates with noise by Euler's equations, in kg m^2: d^T C^-1 d of the true values is chi^2 of 5 degrees."""
    time, true = np.arange(60) * 0.1, 0.01 * np.array([5.0, 4.0, 3.0])
    R = np.eye(3) if turn is None else Rotation.from_rotvec(turn).as_matrix()
    rates = (spinning(time) + NOISE * np.random.default_rng(6).normal(size=(60, 3))) @ R.T
    data = seen(time, angular_velocity=rates)
    data["sigma_angular_velocity"] = xr.DataArray(np.degrees(NOISE), attrs={"units": "deg/s"})  # of rates in rad/s
    body = kr.physical.FreeBody(R @ np.diag([0.051, 0.04, 0.029]) @ R.T)
    order, axes = np.argsort(abs(body.principal.axes.T @ R), axis=1)[:, -1], body.principal.axes
    middle = int(np.flatnonzero(order == 1)[0])  # one moment is fixed: rates do not determine a common factor
    free = [f"moments[{i}]" for i in range(3) if i != middle] + ["momentum"]
    found = kr.fit(body, data, free=free, x0=body.state(rates[0]), dt=0.05)
    M = axes.T @ R @ (true * (spinning(time)[0])) / body.momentum_unit
    off = found.table["value"].to_numpy() - [*(true[order[i]] for i in range(3) if i != middle), *M]
    inverse, (low, high) = np.linalg.inv(found.covariance.to_numpy()), chi2.ppf([0.5e-6, 1 - 0.5e-6], 5)
    assert found.converged and low < off @ inverse @ off < high
    assert (off + 1e-3) @ inverse @ (off + 1e-3) > high  # moments as far away as the guess
    last = found.run.angular_velocity.values[-1] @ R
    assert abs(last - spinning(time)[-1]).max() < NOISE
    with pytest.raises(kr.InputError, match="do not change with moments"):
        kr.fit(body, data, free=["moments", "momentum"], x0=body.state(rates[0]), dt=0.05)


def test_a_run_of_another_body_is_observed_in_si() -> None:
    """Its momentum is in units of its moments; those of the guess differ."""
    true, guess = kr.physical.FreeBody((1.05, 2.0, 2.5)), kr.physical.FreeBody((1.0, 2.0, 2.5))
    run = kr.simulate(true, true.state((0.3, 1.0, 0.2)), dt=0.05, steps=60, every=3, project=False, progress=False)
    found = kr.fit(guess, run, free=["moments[0]", "momentum"], x0=guess.state((0.3, 1.0, 0.2)))
    assert found.values["moments[0]"] == pytest.approx(1.05, abs=1e-12)
    M = np.array([found.values[f"M[{i}]"] for i in range(3)]) * guess.momentum_unit
    assert M == pytest.approx([0.315, 2.0, 0.5], abs=1e-12)  # I w


def test_the_weight_of_a_gyroscope() -> None:
    """Of its axis by L' = r x W, a' = w x a, without an attitude, which the default method of a top does not give."""
    I1, I3, lever, spin, tilt = 1.9e-3, 6e-4, 0.05, 200.0, 0.5  # mass 0.5 kg

    def equations(t: float, y: np.ndarray) -> np.ndarray:
        L, a = y[:3], y[3:]
        weight = np.array([0.0, 0.0, -0.5 * 9.81])
        return np.concatenate([cross(lever * a, weight), cross(L / I1 + (1 / I3 - 1 / I1) * (L @ a) * a, a)])

    axis, time = np.array([np.sin(tilt), 0, np.cos(tilt)]), np.arange(0, 1, 0.01)
    made = solve_ivp(equations, (0, time[-1]), [*(I3 * spin * axis), *axis], "DOP853", time, rtol=1e-11, atol=1e-13)
    guess = kr.physical.Gyroscope(0.5, I3, I1, lever * 1.01, gravity=9.81)
    start = guess.state(tilt=tilt, spin=spin)
    data = seen(time, axis=made.y[3:].T)
    found = kr.fit(guess, data, free=["p[2]"], x0=start, dt="0.1 ms")
    assert found.values["p[2]"] == pytest.approx(1 / 1.01, rel=1e-4) and found.converged
    true = kr.physical.Gyroscope(0.5, I3, I1, lever, gravity=9.81)  # in other units of time and momentum
    rows = kr.simulate(true, true.state(tilt=tilt, spin=spin), dt="0.1 ms", t_end="0.5 s", every=100, progress=False)
    found = kr.fit(guess, rows, free=["p[2]"], x0=start, orientation=False)
    assert found.values["p[2]"] == pytest.approx(1 / 1.01, rel=1e-4)
    with pytest.raises(kr.InputError, match=r"x0: expected body.state\(...\), .* and no run of this body"):
        kr.fit(guess, rows, free=["p[2]"], orientation=False)
    run = kr.simulate(guess, start, dt="1 ms", t_end="0.5 s", every=10, progress=False)  # has an attitude
    assert kr.fit(guess, run, free={"p[2]": 1.01}, orientation=False).values["p[2]"] == pytest.approx(1, abs=1e-9)
    with pytest.raises(kr.InputError, match="or orientation=False"):
        kr.fit(guess, run, free=["p[2]"])
