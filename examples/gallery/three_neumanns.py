"""Neumann's system with two maps, and Rosochatius's with its walls.

Left: the energy along Adler's map in the paper's variables swings by O(step), that along Veselov's stands still; both
keep their own integrals to round-off.  Right: Rosochatius's particle, which the walls x_i = 0 keep in one octant.

Source: Suris 2001, section 7; A. P. Veselov, Integrable discrete-time systems and difference operators, 1988.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
b, x, q = (0.0, 0.8, 2.1), (0.6, 0, 0.8), (0.4, 0.9, -0.3)
adler = kr.simulate(kr.Neumann(b=b), {"x": x, "q": q}, dt=0.1, steps=600, method="suris", order=1)
veselov = kr.simulate(kr.NeumannVeselov(b=b), {"x": x, "q": q}, dt=0.1, steps=600)
swing, rest = (float(abs(run.energy - run.energy[0]).max()) for run in (adler, veselov))
print(f"energy: {swing:.1e} with Adler's map, {rest:.1e} with Veselov's")
assert rest < 1e-13 < 1e-3 < swing

walls = kr.Rosochatius(b=b, mu=(0.1, 0.15, 0.2))
start = np.array([0.48, 0.6, 0.64])
run = kr.simulate(walls, {"x": start, "q": (1.0, -0.8, 0.0)}, dt=0.01, steps=20_000 if SMALL else 80_000, every=2)
table = kr.drift(run)
print(f"Rosochatius: integrals change by up to {table.max_change.max():.1e}, least x_i {float(run.x.min()):.3f}")
assert table.max_change.max() < 1e-11 and run.x.min() > 0

with figure("light", 9.0, 4.2) as (made, theme):
    left = made.add_subplot(1, 2, 1)
    for number, (one, name) in enumerate(((adler, "Adler's map"), (veselov, "Veselov's map"))):
        change = np.maximum(abs(one.energy.values - one.energy.values[0]), 1e-17)
        left.semilogy(one.time, change, color=theme.colours[number], linewidth=0.8, label=name)
    left.set(xlabel="time", ylabel="|change of the energy|", title="Neumann, steps of 0.1")
    left.legend(loc="center right")
    axes = made.add_subplot(1, 2, 2, projection="3d")
    axes.plot(*run.x.values[:10_000].T, color=theme.colours[2], linewidth=0.4)
    axes.set_box_aspect((1, 1, 1), zoom=1.1)
    axes.set(xlim=(0, 1), ylim=(0, 1), zlim=(0, 1), title="Rosochatius: one octant")
    axes.view_init(elev=25, azim=40)
    made.savefig("three_neumanns.png")
