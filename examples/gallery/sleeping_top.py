"""The sleeping top, and how it loses its stability.

An upright top with the axial momentum s (p = a = 1, transverse moment 1) sleeps while s >= 2.  Below, a tilt of a
thousandth of a radian grows: the axis falls to cos(tilt) = s^2/2 - 1 and comes back.  Left: tilt against time.  Right:
the largest tilt against s, from runs (dots) and in closed form (line).

Source: H. Goldstein, Classical Mechanics, 3rd ed., section 5.7; in Kreisel's units the condition is I3 w3 >= 2 sqrt(I1
m g l).
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
TILT = 1e-3
top = kr.LagrangeTop(p=(0, 0, 1))
axis = np.array((np.sin(TILT), 0, np.cos(TILT)))
spins = np.linspace(0.4, 2.6, 12 if SMALL else 45)

fall = kr.simulate(top, top.state(m=spins[:, None] * axis, a=np.tile(axis, (len(spins), 1))), dt=0.02, steps=3000)
tilt = np.arctan2(np.hypot(fall.a[..., 0], fall.a[..., 1]), fall.a[..., 2])
largest = tilt.max("time").values
asleep = spins > 2.05

expected = np.arccos(np.clip(spins**2 / 2 - 1, -1, 1))
error = abs(largest - expected)[spins < 1.95].max()
print(f"largest tilt against arccos(s^2/2 - 1), s < 1.95: off by up to {error:.1e} rad")
assert error < 2e-3
assert largest[asleep].max() < 10 * TILT  # it sleeps
figures = kr.nutation(top, top.state(m=1.5 * axis, a=axis))
assert abs(figures.lowest - (1.5**2 / 2 - 1)) < 1e-5

with figure("light", 9.0, 3.6) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=[1.4, 1])
    for spin, colour in zip((1.2, 1.8, 1.95, 2.4), theme.colours, strict=False):
        lane = int(abs(spins - spin).argmin())
        left.plot(fall.time, np.degrees(tilt[:, lane]), color=colour, label=f"s = {spins[lane]:.2f}")
    left.set(xlabel="time", ylabel="tilt, degrees", title="a top stood upright, 0.06 degrees off")
    left.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.18))
    s = np.linspace(0.4, 2.6, 400)
    curve = np.degrees(np.arccos(np.clip(s**2 / 2 - 1, -1, 1)))
    right.plot(s, curve, color=theme.faint, label="arccos(s²/2 - 1)")
    right.plot(spins, np.degrees(largest), "o", markersize=3.5, color=theme.colours[0], label="runs")
    right.axvline(2, color=theme.colours[1], linestyle="--", linewidth=0.8)
    right.set(xlabel="axial momentum s", ylabel="largest tilt, degrees", title="asleep from s = 2")
    right.legend(loc="lower left")
    made.savefig("sleeping_top.png")
