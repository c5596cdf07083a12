"""Lagrange tops in four and five dimensions.

The same map, in so(4) and so(5): two planes of the vector a each, and every integral at round-off: energy, Casimirs,
the spectrum of the Lax matrix, and pi m pi, without which the spectrum would not be complete.

Source: Suris 2001, sections 5 and 6.1; errata E11 and E12.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
STEPS = 20_000 if SMALL else 200_000
with figure("light", 9.6, 5.4) as (made, theme):
    panels = made.subplots(2, 3, width_ratios=[1, 1, 1.5])
    for n, row in zip((4, 5), panels, strict=True):
        draw = np.random.default_rng(n)
        m, a = draw.normal(size=(n, n)), draw.normal(size=n)
        top = kr.LagrangeTop(p=np.eye(n)[-1])
        x0 = top.state(m=(m - m.T) / 2, a=a / np.linalg.norm(a))
        run = kr.simulate(top, x0, dt=0.05, steps=STEPS, every=STEPS // 2000)
        table = kr.drift(run)
        worst = table.ulps[table.conserved].max()
        print(f"n = {n}: {len(table)} integrals, the worst off by {worst:.0f} units in the last place")
        assert table.conserved.all() and table.ulps.max() < 400
        path = kr.simulate(top, x0, dt=0.02, steps=4000).a.values
        for axes, (i, j) in zip(row[:2], ((0, 1), (2, n - 1)), strict=True):
            axes.plot(path[:, i], path[:, j], color=theme.colours[n - 4], linewidth=0.6)
            axes.set(xlabel=f"a{i + 1}", ylabel=f"a{j + 1}", aspect="equal", title=f"n = {n}")
        for number, family in enumerate(("casimir", "energy", "spectrum", "noether")):
            change = abs(run[family].values - run[family].values[0]).reshape(len(run.time), -1).max(-1)
            row[2].semilogy(
                run.time[1:], np.maximum(change[1:], 2e-17), color=theme.colours[number], linewidth=0.8, label=family
            )
        row[2].set(xlabel="time", title="largest change of each family", ylim=(1e-17, 1e-10))
        row[2].legend(ncols=2, loc="upper left")
    made.savefig("higher_dimensions.png")
