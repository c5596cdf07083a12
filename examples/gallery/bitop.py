"""Two Lagrange tops in one: the bitop in four dimensions.

so(4) is su(2) + su(2), and G falls into two vectors, each the axis of a top of its own; the body joins them only by two
constant turns.  The map is explicit and keeps deformed integrals.  Ratiu's top has chi34 = 0.

Source: V. Dragovic, B. Gajic, 2001; named in Suris 2001, Conclusions.
"""

import os

import numpy as np

import kreisel as kr
from kreisel import algebra
from kreisel.system import ratiu_bitop
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
M = algebra.skew(np.array([0.6, -0.3, 0.5, 0.2, -0.4, 0.8]), 4)
G = algebra.skew(np.array([0.3, 0.8, -0.2, 0.4, 0.5, 0.1]), 4)
titles, halves = ("Ratiu's top, G+", "G-", "the bitop, G+", "G-"), []
for chi34 in (0.0, 0.7):
    body = kr.RatiuBitop(a=0.4, b=0.7, chi12=1.0, chi34=chi34)
    run = kr.simulate(body, {"M": M, "G": G}, dt=0.02, steps=5_000 if SMALL else 30_000, every=2, method="suris")
    table = kr.drift(run).query("conserved")
    print(f"chi34 = {chi34}: {len(table)} integrals change by up to {table.max_change.max():.1e}")
    assert len(table) >= 8 and table.max_change.max() < 1e-11
    halves += ratiu_bitop.halves(run.G.values)

with figure("light", 9.6, 3.2) as (made, theme):
    for place, (half, title) in enumerate(zip(halves, titles, strict=True)):
        axes = made.add_subplot(1, 4, place + 1, projection="3d")
        axes.plot(*half.T, color=theme.colours[place // 2], linewidth=0.4)
        radius = np.linalg.norm(half[0])
        axes.set(xlim=(-radius, radius), ylim=(-radius, radius), zlim=(-radius, radius))
        axes.set_box_aspect((1, 1, 1), zoom=1.3)
        axes.set_axis_off()
        axes.set_title(title, y=1.02)
    made.savefig("bitop.png", dpi=110)
