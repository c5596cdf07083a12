"""The other integrable bodies that the paper names, each by the path of its vector P in the body.

Kovalevskaya's and Goryachev and Chaplygin's tops; Kirchhoff's, Steklov's and Lyapunov's cases of a body in a fluid; the
flow of a body in Clebsch's case, by Suris's map of 2000.  The exact steps are products of Darboux maps; Kirchhoff's
case has none.  Each path lies on a torus: it fills a band of its sphere or a part of one.

Source: Suris 2001, Introduction and Conclusions.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
P, M = (0.48, 0.6, 0.64), (0.5, 0.9, 0.4)
BODIES = {
    "Kovalevskaya": (kr.KovalevskayaTopE3(), {"M": M, "P": P}, "exact"),
    "Goryachev, Chaplygin": (kr.GoryachevChaplygin(), {"M": np.cross(P, M), "P": P}, "exact"),
    "Kirchhoff's case": (kr.KirchhoffCase(a1=1, a3=0.6, b1=0.3, b3=-0.2, c1=0.5, c3=1.4), {"M": M, "P": P}, "dop853"),
    "Steklov's case": (kr.Steklov(b=(1.0, 1.6, 2.5), nu=0.4), {"M": M, "P": P}, "exact"),
    "Lyapunov's case": (kr.Lyapunov(b=(1.0, 1.6, 2.5), nu=0.4), {"M": M, "P": P}, "exact"),
    "Clebsch, the flow of a body": (kr.ClebschBody(J=(0.4, 0.9, 1.6)), {"M": M, "P": P}, "veselov"),
}
with figure("light", 9.6, 6.6) as (made, theme):
    for place, (name, (body, state, method)) in enumerate(BODIES.items()):
        run = kr.simulate(body, state, dt=0.02, steps=5_000 if SMALL else 25_000, every=2, method=method)
        table = kr.drift(run)
        worst = float((table.max_change / (1 + abs(table.start))).max())
        print(f"{name:28s} {method:8s} integrals change by up to {worst:.1e}")
        assert worst < (1e-5 if method == "dop853" else 1e-12)
        axes = made.add_subplot(2, 3, place + 1, projection="3d")
        axes.plot(*run.P.values.T, color=theme.colours[place % len(theme.colours)], linewidth=0.35)
        axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
        axes.set_box_aspect((1, 1, 1), zoom=1.25)
        axes.set_axis_off()
        axes.set_title(name, y=1.02)
    made.savefig("named_bodies.png", dpi=100)
