"""Nutation three ways: wavy, cuspidal, looping.

The same top with the same tilt and spin is let go with three precession rates W.  At the upper edge the axis moves on
for
W > 0 (waves), stands still for W = 0 (cusps) and moves back for W < 0 (loops); in the mean it goes round the same way.
The numbers come from the state alone (`kr.analysis.rates`) and agree with the closed form (`kr.nutation`).

Source: H. Goldstein, Classical Mechanics, 3rd ed., figure 5.9.
"""

import numpy as np

import kreisel as kr
from kreisel import analysis
from kreisel.viewer.charts import figure

top = kr.LagrangeTop(p=(0, 0, 1))
axis, up = np.array((np.sin(1.0), 0, np.cos(1.0))), np.array((0, 0, 1.0))
SPIN = 3.0
cases = {"waves": 0.17, "cusps": 0.0, "loops": -0.35}

with figure("light", 9.6, 3.5) as (made, theme):
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
    for place, (name, rate) in enumerate(cases.items()):
        m = SPIN * axis + rate * (up - axis * axis[2])  # a x a' = W a x (p x a)
        run = kr.simulate(top, top.state(m=m, a=axis), dt=0.01, steps=6000, order=6)
        turning = analysis.rates(run).precession
        at_top = float(turning[0])
        table = analysis.mean_rates(run)
        print(f"{name}: W = {rate:+.2f}, at the upper edge {at_top:+.4f}, mean {table.measured.mean_precession:+.6f}, "
              f"off the closed form by {abs(table.difference.mean_precession):.1e}")  # fmt: skip
        assert abs(at_top - rate) < 1e-12 and table.measured.mean_precession > 0.2
        assert np.nanmax(abs(table.difference)) < 1e-9
        backwards = float((turning < -1e-6).mean())
        assert (backwards > 0.1) == (name == "loops")
        axes = made.add_subplot(1, 3, place + 1, projection="3d")
        axes.plot_wireframe(*ball, rstride=4, cstride=4, color=theme.grid, linewidth=0.3)
        rows = slice(0, int(2 * np.pi / table.measured.mean_precession / 0.01))
        axes.plot(*run.a[rows].values.T, color=theme.colours[place], linewidth=1.2)
        axes.set_box_aspect((1, 1, 1), zoom=1.25)
        axes.set(xlim=(-0.9, 0.9), ylim=(-0.9, 0.9), zlim=(-0.9, 0.9))
        axes.set_axis_off()
        axes.view_init(elev=38, azim=-60)
        axes.set_title(f"{name}: W = {rate:+.2f}", y=1.0)
    made.savefig("nutation.png")
