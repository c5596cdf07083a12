"""Two frequencies of a top, from its trajectory to eleven digits.

A quasi-periodic motion has a spectrum of lines.  That of a_1 + i a_2 lies at precession + k nutation; Laskar's
analysis of
the run finds those frequencies far beyond the resolution 2 pi/T of the Fourier transform, and they meet the elliptic
integrals of the closed form.

Source: J. Laskar, Icarus 88 (1990) 266; `kr.analysis.frequencies`, `kr.nutation`.
"""

import numpy as np

import kreisel as kr
from kreisel import analysis
from kreisel.viewer.charts import plot_lines

top = kr.LagrangeTop(p=(0, 0, 1))
x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
run = kr.simulate(top, x0, dt=0.2, steps=4000, method="exact")
lines = analysis.frequencies(run, lambda m, a: a[..., 0] + 1j * a[..., 1], 7)
figures = kr.nutation(top, x0)
nutation = 2 * np.pi / figures.period
k = np.round((lines.frequency - figures.mean_precession) / nutation)
off = lines.frequency - figures.mean_precession - k * nutation
table = lines.table.assign(k=k.astype(int), off=off)
print(table.to_string(index=False, float_format="{:.3g}".format))
print(f"resolution of the Fourier transform: {2 * np.pi / float(run.time[-1]):.1e}")
assert abs(off).max() < 1e-10 and len(set(k)) == 7

made = plot_lines(lines)
made.axes[0].set_title("lines of a₁ + i a₂: precession + k nutation")
for row in table.itertuples():
    made.axes[0].annotate(
        f"k = {row.k}", (row.frequency, row.amplitude), (4, 3), textcoords="offset points", fontsize=7
    )
made.savefig("frequency_map.png", dpi=200)
