"""A racquet in the air: its moments of inertia from the gyroscope of a telephone.

A telephone tied to the strings of a tennis racquet measured its angular velocity in six tosses. `kr.fit` finds the
moments (as ratios: a gyroscope does not weigh), the drag of the air about each axis and how far the telephone is
turned, to a residual of 0.03 rad/s at rates of 13 rad/s. The moments of the six tosses scatter by more than an error
bar, which knows of noise alone; drag, for one, is not exactly linear. Their mean agrees with the pendulums of the
authors, is ten times as precise, and shows that a racquet is flat: the largest moment is the sum of the others. With
motions made by another integrator, with noise, the true values lie within the error bars as often as they should.

Source: data of Bubbar and Zhu 2025, doi:10.14288/1.0448943, in `data/racquet.csv`; Euler's equations by SciPy.
"""

import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.stats import chi2

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
DATA = np.loadtxt(Path(__file__).parent / "data" / "racquet.csv", delimiter=",")
J = np.array((0.075, 1.0, 0.002))  # the mass tensor: across, along and through the racquet; its length is the scale
PENDULUM, ITS_ERROR = 1.391 / 20.7, 1.391 / 20.7 * np.hypot(0.076 / 1.391, 3.8 / 20.7)  # of I3/I1, by the authors
BODY = kr.perturbed(kr.EulerTop(J=J), damping=(0.2, 0.2, 0.2))
FREE = {"J[0]": None, "J[2]": None, "M": None, "damping": None, "tilt": np.zeros(3)}
TIME = 0.01 * np.arange(79)


def moments(J):
    return J.sum() - J


def gyroscope(M, *, J, tilt):
    """What a telephone shows that is turned by a small angle."""
    Omega = M / moments(J)
    return Omega + jnp.cross(tilt, Omega)


def fitted(rates, **more):
    """The fit of one toss; NaN where there is no observation."""
    data = xr.Dataset({"gyroscope": (("time", "axis"), rates), **more}, {"time": TIME})
    start = {"M": moments(J) * rates[0]}
    return kr.fit(BODY, data, free=FREE, x0=start, dt=0.01, observables={"gyroscope": gyroscope})


def tossed(M, *, J, damping, tilt):
    """The rates by Euler's equations, and another integrator."""
    I = moments(J)

    def flow(t, M):
        return np.cross(M, M / I) - damping * M

    Omega = solve_ivp(flow, (0, TIME[-1]), M, "DOP853", TIME, rtol=1e-10, atol=1e-12).y.T / I
    return Omega + np.cross(tilt, Omega)


tosses = []
for number in range(6):
    rows = DATA[DATA[:, 0] == number, 2:]
    rates = np.full((len(TIME), 3), np.nan)
    rates[: len(rows)] = rows
    tosses.append((rates, fitted(rates)))
ratios, errors, flat = [], [], []
for number, (_, fit) in enumerate(tosses):
    I2, I3, I1 = moments(fit.model.params["J"])
    slope = np.array((1 / I1 - I3 / I1**2, 1 / I1))  # of I3/I1 = (J0 + J2)/(J0 + 1) by J0, J2
    ratios.append(I3 / I1)
    errors.append(np.sqrt(slope @ fit.covariance.loc[["J[0]", "J[2]"], ["J[0]", "J[2]"]].to_numpy() @ slope))
    flat.append(I1 / (I2 + I3))
    print(
        f"toss {number}: I3/I1 = {I3 / I1:.4f} +- {errors[-1]:.4f}, I2/I1 = {I2 / I1:.4f}, rest {fit.sigma:.3f} rad/s"
    )
mean, spread = np.mean(ratios), np.std(ratios, ddof=1) / np.sqrt(6)
print(f"mean of six: I3/I1 = {mean:.4f} +- {spread:.4f}; pendulums: {PENDULUM:.3f} +- {ITS_ERROR:.3f}")
print(f"I1/(I2 + I3) = {np.mean(flat):.4f}")
assert all(fit.converged and fit.sigma < 0.035 for _, fit in tosses)
assert abs(mean - PENDULUM) < ITS_ERROR and spread < ITS_ERROR / 10
assert 0.99 < np.mean(flat) < 1
assert np.std(ratios, ddof=1) > 2 * np.median(errors)  # the error bar of a toss is not the whole error

# as often as they should: d^T C^-1 d of all fits is chi^2, outside these bounds once in 10^6
first, count, noise = tosses[0][1], 3 if SMALL else 20, 0.02
truth = {k: np.array([first.values[f"{k}[{i}]"] for i in range(3)]) for k in ("M", "damping", "tilt")}
clean = tossed(J=first.model.params["J"], **truth)
rng, total = np.random.default_rng(1), 0.0
for _ in range(count):
    fit = fitted(clean + noise * rng.normal(size=clean.shape), sigma_gyroscope=noise)
    off = (fit.table["value"] - first.table["value"]).to_numpy()
    total += off @ np.linalg.solve(fit.covariance.to_numpy(), off)
low, high = chi2.ppf((0.5e-6, 1 - 0.5e-6), 11 * count)
print(f"{count} simulated tosses: chi^2 of the true values {total:.0f}, between {low:.0f} and {high:.0f}")
assert low < total < high

with figure("light", 9.0, 3.6) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=[1.7, 1])
    rates, fit = tosses[0]
    for j, name in enumerate(("across (I₂)", "along (I₃)", "through (I₁)")):
        left.plot(TIME, rates[:, j], ".", color=theme.colours[j], markersize=4)
        left.plot(TIME, (rates - fit.residuals.gyroscope.values)[:, j], color=theme.colours[j], label=name)
    left.set(xlabel="time, s", title="angular velocity of the racquet, rad/s")
    left.legend(fontsize="small")
    right.axhspan(PENDULUM - ITS_ERROR, PENDULUM + ITS_ERROR, color=theme.colours[2], alpha=0.2, label="pendulums")
    right.axhspan(mean - spread, mean + spread, color=theme.colours[1], alpha=0.5, label="mean of six")
    right.errorbar(range(1, 7), ratios, errors, fmt="o", color=theme.colours[0], markersize=4, label="one toss")
    right.set(xlabel="toss", title="I₃/I₁", xticks=range(1, 7))
    right.legend(fontsize="small")
    made.savefig("fit_observations.png")
