"""A magnetic top in a rotating field: Rabi's formula for a gyroscope.

A top with axial momentum s has a magnet along its axis a, V = P(t).a in a field of strength p along the vertical and
of strength b that turns about it at the rate w.  When it spins fast, s a' = P x a: it precesses at p/s about the
vertical, and in the frame that turns with the field about a field at rest.  A top that begins upright turns by

    a_3 = 1 - 2 (R^2/W^2) sin^2(W t/2),   R = b/s, W^2 = R^2 + (w - p/s)^2,

as a spin 1/2 does: at resonance it is upside down after the time pi/R, however weak the field is.  The next term of the
precession is p^2 cos(tilt)/s^3.  Left: runs and the formula (dashed).  Right: how far the top tips against w.

Source: I. I. Rabi, N. F. Ramsey, J. Schwinger, Use of rotating coordinates in magnetic resonance problems, Reviews of
Modern Physics 26 (1954) 167.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
SPIN, WEAK, DT = 60.0, 0.1, 0.06  # a step of 3.6 radians has four kicks
RABI = WEAK / SPIN


def turning_field(a, t, *, b, w):
    return b * (a[0] * np.cos(w * t) + a[1] * np.sin(w * t))


def formula(detuning, t):
    W2 = RABI**2 + detuning**2
    return 1 - 2 * RABI**2 / W2 * np.sin(np.sqrt(W2) * t / 2) ** 2


detuning = RABI * np.linspace(-4, 4, 9 if SMALL else 33)
top = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=turning_field, params={"b": WEAK, "w": 1 / SPIN + detuning})
upright = top.state(m=np.tile((RABI, 0, SPIN), (len(detuning), 1)), a=(0, 0, 1))  # begins without nutation
run = kr.simulate(top, upright, dt=DT, t_end=2.2 * np.pi / RABI, every=500, order=(8, 2))
height, expected = run.a[..., 2].values, formula(detuning, run.time.values[:, None])

off = abs(height - expected).max()
middle = len(detuning) // 2
overturned = float(run.time[height[:, middle].argmin()])
deepest, predicted = height.min(0), expected.min(0)
print(f"heights of {len(detuning)} tops are within {off:.3f} of Rabi's formula")
print(f"at resonance upside down, a_3 = {deepest[middle]:.4f}, after {overturned:.0f}; pi/R = {np.pi / RABI:.0f}")
assert off < 0.02 and deepest[middle] < -0.999 and abs(overturned * RABI / np.pi - 1) < 0.02
assert abs(deepest - predicted).max() < 0.02 < np.ptp(predicted)
balance, change = (abs(x - x[0]).max().item() for x in (run.balance, run.energy))
print(f"energy - work is conserved to {balance:.1e}, while the energy changes by up to {change:.2f}")
assert balance < 1e-6 < change

with figure("light", 10.0, 4.0) as (made, theme):
    left, right = made.subplots(1, 2)
    for lane, colour in zip((middle, middle + 1, middle + len(detuning) // 4), theme.colours, strict=False):
        label = f"w - p/s = {detuning[lane] / RABI:.3g} R"
        left.plot(RABI * run.time, height[:, lane], color=colour, linewidth=1.2, label=label)
        left.plot(RABI * run.time, expected[:, lane], "--", color=theme.ink, linewidth=0.7)
    left.set(xlabel="R t", ylabel="height of the axis, $a_3$", title="begun upright")
    left.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14), columnspacing=1, handlelength=1.2)
    fine = np.linspace(-4, 4, 400)
    right.plot(fine, 1 / (1 + fine**2), color=theme.ink, linewidth=0.7, label="R²/W²")
    right.plot(detuning / RABI, (1 - deepest) / 2, "o", markersize=3.5, color=theme.colours[0], label="runs")
    right.set(xlabel="(w - p/s)/R", ylabel="largest $(1 - a_3)/2$", title="resonance")
    right.legend(ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    made.savefig("rotating_field.png")
