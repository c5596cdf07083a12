"""The fit of a tumbler to synthetic light, of bodies whose periods the exact motion states."""

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel.analysis import fit_light_curve, light_curve, photometry
from kreisel.errors import InputError, InputWarning
from kreisel.physical import Facets, FreeBody
from sizes import FULL

HOUR, DAY = 3600.0, 86400.0
DIAMETERS = (400.0, 260.0, 220.0)


def observations(body, state, days, seed=0):
    """Magnitudes with errors of 2 %, 20 within 10 hours of each day, on paths of the Sun and the Earth that bend."""
    draw = np.random.default_rng(seed)
    t = np.sort(np.asarray(days)[:, None] + draw.uniform(0, 10 / 24, (len(days), 20)), axis=None) * DAY
    a, b = t / DAY / 50, 1 + t / DAY / 20
    sun = np.stack([np.cos(a), np.sin(a), 0.1 + 0 * a], -1)
    observer = np.stack([np.cos(b), np.sin(b), 0.3 * np.sin(a)], -1)
    light = light_curve(kr.at(body, state, t), sun=sun, observer=observer)
    magnitude = 20 + light.magnitude.values + 0.02 * draw.normal(size=len(t))
    ways = {"sun": (("time", "xyz"), sun), "observer": (("time", "xyz"), observer)}
    return xr.Dataset({"magnitude": ("time", magnitude), "sigma_magnitude": 0.02, **ways}, {"time": t})


def tumbler(tilt, rate, long_axis):
    body = FreeBody.ellipsoid(1e9, DIAMETERS)
    x, y, z = np.sin(tilt) * np.cos(0.7), np.sin(tilt) * np.sin(0.7), np.cos(tilt)
    spin = rate * (np.array([z, x, y]) if long_axis else np.array([x, y, z]))
    return body, body.state(spin, attitude=(0.5, 0.1, -0.7, 0.5)), body.rotation(spin)


@pytest.fixture
def small(monkeypatch):
    """A search with fewer starts, for narrow ranges."""
    if not FULL:
        for name, value in (("STARTS", 60), ("POLES", 16), ("FIRST", 12), ("BEST", 2), ("MOST", 6)):
            monkeypatch.setattr(photometry, name, value)


SHORT = pytest.param("short-axis", marks=pytest.mark.skipif(not FULL, reason="`make test-full` runs it"))


@pytest.mark.parametrize("mode", [SHORT, "long-axis"])
def test_both_periods_of_a_tumbler(mode, small):
    body, state, rotation = tumbler(0.4, 2 * np.pi / (9 * HOUR), mode == "long-axis")
    assert rotation.kind == f"{mode} mode"
    data = observations(body, state, np.arange(6))
    truth = {"rotation": rotation.period, "precession": rotation.precession_period}
    ranges = {name: (0.97 * p, 1.03 * p) for name, p in truth.items()}
    fit = fit_light_curve(data, modes=mode, **ranges)
    row = fit.table.iloc[0]
    assert 0.7 < row["chi2"] / fit.dof < 1.4 and str(len(fit.table)) in repr(fit)
    for name, period in truth.items():
        assert abs(row[f"{name}_period"] - period) < 4 * row[f"error_{name}_period"] < 0.04 * period
    moments = np.sort(body.principal.moments)
    assert abs(row["moment_a"] - moments[0] / moments[2]) < 4 * row["error_moment_a"]
    states = kr.at(fit.body(), fit.state(), data.time.values - fit.epoch)
    light = light_curve(states, sun=data.sun.values, observer=data.observer.values)
    off = data.magnitude.values - light.magnitude.values
    assert np.std(off) < 0.024
    if FULL:
        with pytest.warns(InputWarning, match="no motion found fits"):
            wrong = fit_light_curve(data.assign(sun=-data.sun), modes=mode, **ranges)
        assert wrong.table["chi2"].iloc[0] > 10 * row["chi2"]


def test_aliases_are_cycles_miscounted_between_apparitions(small):
    body, state, rotation = tumbler(0.4, 2 * np.pi / (9 * HOUR), False)
    data = observations(body, state, [0, 1, 2, 3, 4, 150])
    truth = {"rotation": rotation.period, "precession": rotation.precession_period}
    ranges = {name: (0.98 * p, 1.02 * p) for name, p in truth.items()}
    fit = fit_light_curve(data, modes="short-axis", **ranges)
    off = [abs(fit.table[f"{k}_period"] - p) / fit.table[f"error_{k}_period"] for k, p in truth.items()]
    assert len(fit.table) > 1 and np.maximum(*off).min() < 4
    for name in truth:  # between the apparitions; half a turn of an ellipsoid looks alike
        halves = 2 * 148 * DAY * (1 / fit.table[f"{name}_period"] - 1 / fit.table[f"{name}_period"][0])
        assert abs(halves - halves.round()).max() < 0.2 and np.ptp(halves) > 0.8


@pytest.mark.parametrize("mode", ["short-axis", "long-axis"])
def test_derivatives_of_the_magnitudes(mode):
    body, state, _ = tumbler(0.4, 2 * np.pi / (9 * HOUR), False)
    data = observations(body, state, [0, 1, 2, 150])
    for shape in (None, Facets.ellipsoid((1, 0.7, 0.6), 60)):
        light = photometry._light(shape, "lommel-seeliger", (0.5, 0.1, -0.5))
        seen, _ = photometry._seen(data, shape, *light)
        x = np.array([[0.3, -0.6, 1.2, 0.7, 9 * HOUR, 31 * HOUR, 0.55, 0.5]])
        r, J = seen.jacobian(x, mode)
        steps = np.array([1, 1, 1, 1, x[0, 4] ** 2 / np.ptp(seen.time), x[0, 5] ** 2 / np.ptp(seen.time), 1, 1])
        for k, h in enumerate(3e-6 * steps):
            change = h * (np.arange(8) == k)
            slope = (seen.residuals(x + change, mode) - seen.residuals(x - change, mode))[:, 0] / (2 * h)
            scale = np.sqrt((slope**2).mean())
            assert np.sqrt(((J[0, :, k] - slope) ** 2).mean()) < (1e-4 if shape is None else 0.05) * scale, (shape, k)
        assert np.allclose(r[0], seen.residuals(x, mode)[:, 0])


def test_errors_of_another_unit_are_doubted():
    """Errors of 20 mmag without a unit: a motion that does not fit has a chi^2 far below 1 per degree of freedom."""
    body, state, _ = tumbler(0.4, 2 * np.pi / (9 * HOUR), False)
    data = observations(body, state, [0, 1, 2]).assign(sigma_magnitude=20.0)
    seen, epoch = photometry._seen(data, None, *photometry._light(None, "lommel-seeliger", None))
    x = np.array([[0.3, -0.6, 1.2, 0.7, 9 * HOUR, 31 * HOUR, 0.55, 0.5]])
    chi2 = (seen.residuals(x, "short-axis") ** 2).sum(0)
    with pytest.warns(InputWarning, match="sigma_magnitude is too large. Usual cause: mmag"):
        photometry._as_fit(seen, [("short-axis", x, chi2)], epoch, None)


@pytest.mark.skipif(not FULL, reason="`make test-full` runs it")
def test_a_small_tilt_and_the_ranges(small):
    body, state, rotation = tumbler(0.12, 2 * np.pi / (9 * HOUR), False)
    data = observations(body, state, np.arange(6))
    fits = []
    for low, high in ((0.97, 1.03), (0.95, 1.02)):
        ranges = {"rotation": rotation.period, "precession": rotation.precession_period}
        ranges = {name: (low * p, high * p) for name, p in ranges.items()}
        fits.append(fit_light_curve(data, modes="short-axis", **ranges).table.iloc[0])
    for name in ("precession_period", "rotation_period", "moment_a", "moment_b"):
        assert abs(fits[0][name] - fits[1][name]) < 0.01 * fits[0][f"error_{name}"]
    off = fits[0]["precession_period"] - rotation.precession_period
    assert abs(off) < 4 * fits[0]["error_precession_period"]


def test_bad_input():
    body, state, _ = tumbler(0.4, 2 * np.pi / (9 * HOUR), False)
    data, good = observations(body, state, [0, 1]), {"rotation": (1e5, 2e5), "precession": (3e4, 4e4)}
    for change, arguments, message in (
        (lambda d: d.drop_vars("sun"), {}, "none of sun"),
        (lambda d: d.isel(time=slice(20)), {}, "at least 32"),
        (lambda d: d.assign(sun=d.sun * 0), {}, "not 0"),
        (lambda d: d.assign(magnitude=d.magnitude * np.nan), {}, "logarithm of a flux"),
        (lambda d: d.assign(sun=d.sun.where(d.time < 9e4)), {}, "sun: expected finite"),
        (lambda d: d.assign_coords(time=2.46e6 + d.time / DAY), {}, "days for seconds"),
        (lambda d: d.assign_coords(time=d.time.assign_attrs(units="d")), {}, "TDB or TT, got d"),
        (lambda d: d.assign_coords(time=d.time.astype("datetime64[s]")), {}, "TDB or TT, got dates"),
        (lambda d: d.assign(sigma_magnitude=((), 20, {"units": "mmag"})), {}, "^sigma_magnitude: .* mag, got mmag"),
        (lambda d: d, {"rotation": (2e5, 1e5)}, "low < high"),
        (lambda d: d, {"rotation": (1.0, 2e5), "precession": (10.0, 4e4)}, "cells"),
        (lambda d: d.assign(apparition=0), {"modes": "middle", "shape": ("4 m", "2.6 m", "2.2 m")}, "^modes"),
    ):
        with pytest.raises(InputError, match=message):
            fit_light_curve(change(data), **good | arguments)
