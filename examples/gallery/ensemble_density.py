"""A hundred thousand tops as a density on the sphere.

All begin with nearly the same axis, and with spins that differ by a few per cent.  Their precessions differ, and the
spot
is wound up into a ring: the mean axis comes to lie on the vertical, although every single top keeps its energy and its
momentum about the vertical for ever.

Source: phase mixing; e.g. V. I. Arnold, Mathematical Methods of Classical Mechanics, section 51.
"""

import itertools
import os

import numpy as np

import kreisel as kr
from kreisel import algebra
from kreisel.runs.planning import make_plan
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
LANES = 5_000 if SMALL else 100_000
DT, TIMES = 0.05, (0, 30, 300)
draw = np.random.default_rng(7)
top = kr.LagrangeTop(p=(0, 0, 1))
axis = np.array((0.8, 0, 0.6)) + 0.03 * draw.normal(size=(LANES, 3))
axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
spin = 3.0 * (1 + 0.05 * draw.normal(size=(LANES, 1)))
x0 = top.state(m=spin * axis, a=axis)

# the engine alone: `kr.simulate` would also compute all integrals of every top at every time
plan = make_plan(top, x0, dt=DT, steps=1, every=1, method="suris", order=1, orientation=None)
states = [np.array(plan.engine.z)]
for before, after in itertools.pairwise(TIMES):
    rows = np.empty((1, *plan.engine.z.shape))
    plan.engine.advance(rows, round((after - before) / DT))
    states.append(rows[0])
seen = [algebra.restore(z, plan.kinds, 3) for z in states]
eps_energy = [top.call(top.system.energy, m, a, eps=DT) for m, a in seen]  # that of the map
about = [kr.algebra.axial(m)[:, 2] for m, _ in seen]
means = [a.mean(0) for _, a in seen]
kept = max(abs(eps_energy[-1] - eps_energy[0]).max(), abs(about[-1] - about[0]).max())
print(f"{LANES:,} tops; mean axis {means[0].round(3)} -> {means[-1].round(3)}; integrals within {kept:.1e}")
assert kept < 1e-12
assert np.hypot(*means[0][:2]) > 0.75 and np.hypot(*means[-1][:2]) < 0.05
# a ring: the azimuth has become uniform (each of 12 sectors within 15 per cent)
sectors = np.histogram(np.arctan2(seen[-1][1][:, 1], seen[-1][1][:, 0]), 12, (-np.pi, np.pi))[0] / LANES * 12
assert abs(sectors - 1).max() < (0.25 if SMALL else 0.15)

with figure("light", 10.0, 3.3) as (made, theme):
    for place, (time, (_, a)) in enumerate(zip(TIMES, seen, strict=True)):
        axes = made.add_subplot(1, 3, place + 1)
        counts, x, z = np.histogram2d(np.arctan2(a[:, 1], a[:, 0]), a[:, 2], (120, 60), ((-np.pi, np.pi), (-1, 1)))
        image = axes.pcolormesh(x, z, np.log10(1 + counts.T), rasterized=True)  # equal areas: (azimuth, height)
        axes.set(xlabel="azimuth", title=f"time {time}")
        axes.grid(False)
    made.axes[0].set_ylabel("height <a, p>")
    made.colorbar(image, ax=made.axes, label="log₁₀(1 + tops in a cell)", shrink=0.9)
    made.savefig("ensemble_density.png")
