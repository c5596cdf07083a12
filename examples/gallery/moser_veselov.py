"""Moser and Veselov's map of the Euler top walks along the flow, with a clock of its own.

For n = 3 every orbit of the map lies on one motion of the free body, at equal spaces of time: only the space differs
from the step, by O(step^3), and tells how late the map is.  Left: orbits of the map on the sphere |M| = 1, on the
closed curves of the flow in Jacobi's functions.  Right: how the space of time differs from the step.

Source: J. Moser, A. P. Veselov, Discrete versions of some classical integrable systems, 1991.
"""

import os

import numpy as np
from scipy.optimize import brentq

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
top = kr.EulerTop(J=(1.0, 2.0, 4.0))  # moments of inertia 6, 5, 3


def start(angle, height):
    flat = np.sqrt(1 - height**2)
    return top.state(M=(flat * np.cos(angle), flat * np.sin(angle), height))


def space(x0, dt):
    """The time of the flow that a step of the map takes, from the component that changes most."""
    step = kr.simulate(top, x0, dt=dt, steps=1, method="veselov").M.values
    i = int(abs(step[1] - step[0]).argmax())
    return brentq(lambda t: float(kr.at(top, x0, [t]).M.values[0, i] - step[1, i]), 0.9 * dt, 1.2 * dt, xtol=1e-15)


starts = [start(a, h) for a, h in ((0.1, 0.05), (0.35, 0.1), (1.2, 0.35), (0.6, 0.9), (1.2, 0.75))]
dt = 1.5
curves, worst = [], 0.0
for x0 in starts:
    s = space(x0, dt)
    points = kr.simulate(top, x0, dt=dt, steps=60, method="veselov").M.values
    curve = kr.at(top, x0, s * np.linspace(0, 130, 3000)).M.values
    worst = max(worst, abs(kr.at(top, x0, s * np.arange(61.0)).M.values - points).max())
    curves.append((points, curve))
print(f"steps of {dt}: the map is off the flow by {worst:.1e} after 60 steps")
assert worst < 1e-11

steps = np.geomspace(0.1, 2.0, 6 if SMALL else 14)
late = np.array([space(starts[2], h) for h in steps]) - steps
slope = np.polyfit(np.log(steps), np.log(abs(late)), 1)[0]
print(f"the space differs from the step by its power {slope:.3f}")
assert abs(slope - 3) < 0.1

with figure("light", 9.0, 4.2) as (made, theme):
    axes = made.add_subplot(1, 2, 1, projection="3d")
    for number, (points, curve) in enumerate(curves):
        colour = theme.colours[number % len(theme.colours)]
        axes.plot(*curve.T, color=colour, linewidth=0.6)
        axes.scatter(*points.T, color=colour, s=7, depthshade=False)
    axes.set_box_aspect((1, 1, 1), zoom=1.3)
    axes.set_axis_off()
    axes.view_init(elev=20, azim=30)
    axes.set_title("60 steps of the map on the curves of the flow")
    right = made.add_subplot(1, 2, 2)
    right.loglog(steps, abs(late), "o-", color=theme.colours[0], markersize=4)
    right.loglog(steps, abs(late[0]) * (steps / steps[0]) ** 3, ":", color=theme.colours[1], label="step³")
    right.set(xlabel="step", ylabel="|space of time - step|", title="The clock of the map")
    right.legend()
    made.savefig("moser_veselov.png")
