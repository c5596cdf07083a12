"""Kovalevskaya's tori: the exact flow and two explicit maps.

Each panel shows 20,000 states of one trajectory, as the angular momentum in the body.  The exact step is a product of
two Darboux maps, so its states lie on the torus of the flow at any step.  The two explicit maps conserve deformed
integrals, O(dt) from Kovalevskaya's: their states lie on tori that are slightly deformed, and do not leave them.  The
frequencies of the third are close to a resonance, so it fills its torus slowly.

Source: S. Kowalevski, Acta Mathematica 12 (1889); the maps: paper/maps.tex.
"""

import os

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
steps, dt = 2_000 if SMALL else 20_000, 0.4
M, P = (0.3, 0.5, 1.1), (0.6, 0.0, 0.8)
panels = (
    ("the exact flow", kr.KovalevskayaTopE3(), "exact"),
    ("the map of so(3, 2)", kr.KovalevskayaTopE3(), "suris"),
    ("the map of sp(4)", kr.KovalevskayaTopSP4(), "suris"),
)
with figure("light", 9.6, 3.3) as (made, theme):
    for place, (title, top, method) in enumerate(panels):
        run = kr.simulate(top, top.state(M=M, P=P), dt=dt, steps=steps, method=method)
        table = kr.drift(run).query("conserved")
        change = float(abs(run.energy - run.energy[0]).max())
        print(
            f"{title}: {len(table)} integrals change by up to {table.max_change.max():.1e}, the energy by {change:.1e}"
        )
        assert table.max_change.max() < 1e-11
        assert (change < 1e-11) == (method == "exact")
        axes = made.add_subplot(1, 3, place + 1, projection="3d")
        axes.plot(*run.M.values.T, ".", color=theme.colours[place], markersize=0.6)
        axes.set_box_aspect((1, 1, 1), zoom=1.35)
        axes.set_axis_off()
        axes.set_title(f"{title}, dt = {dt}", y=1.0)
    made.savefig("kovalevskaya_tori.png", dpi=110)
