"""Hess and Appelrot's top: a relation that stays, but not steadily.

f = x M_1 + z M_3 obeys f' = k x z M_2 f: where it is 0 it stays 0.  Here M_2 is positive on the average, so that
whatever it is off by grows, rounding errors too, all at the same rate until f is large.  Left: the tip of the vertical
in the body while f is 0 within 1e-6.  Right: |f| for starts at 0, 1e-8 and 1e-4.

Source: W. Hess, Mathematische Annalen 37 (1890); named in Suris 2001, Introduction.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
top = kr.HessAppelrot(a=1.0, k=0.8, x=0.6, z=0.8)
steps, shown = 5_000 if SMALL else 6_000, 1_500  # 30 units of time
runs = []
for f in (0.0, 1e-8, 1e-4):
    M = np.array([0.8, 0.7, -0.6]) + f * np.array([0.6, 0, 0.8])  # <A, M> = f, A = (0.6, 0, 0.8)
    runs.append(kr.simulate(top, top.state(M=M, P=(0.6, 0.48, 0.64)), dt=0.01, steps=steps, every=2, method="dop853"))
zero, small, large = (float(run.hess.sel(time=10, method="nearest")) for run in runs)
print(f"f at time 10, started at 0, 1e-8, 1e-4: {zero:.1e}, {small:.4e}, {large:.4e}")
assert abs(zero) < 1e-12 and abs(small / large - 1e-4) < 1e-6  # while f is small its equation is linear
assert abs(runs[0].hess[:shown]).max() < 1e-6  # rounding errors have grown 1e7 times

with figure("light", 9.0, 4.2) as (made, theme):
    axes = made.add_subplot(1, 2, 1, projection="3d")
    axes.plot(*runs[0].P.values[:shown].T, color=theme.colours[0], linewidth=0.9)
    axes.set_box_aspect((1, 1, 1), zoom=1.3)
    axes.set_axis_off()
    axes.set_title("the vertical in the body, f = 0")
    right = made.add_subplot(1, 2, 2)
    for number, (run, name) in enumerate(zip(runs, ("0", "1e-8", "1e-4"), strict=True)):
        values = np.maximum(abs(run.hess.values), 1e-18)
        right.semilogy(run.time, values, color=theme.colours[number], linewidth=0.8, label=f"started at {name}")
    right.set(xlabel="time", ylabel="|f|", ylim=(1e-17, 10))
    right.legend(loc="lower right")
    made.savefig("hess_appelrot.png")
