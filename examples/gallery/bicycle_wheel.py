"""Gyroscopic precession with SI numbers: a bicycle wheel hung by one end of its axle.

3 kg, moment about the axle 0.17 kg m^2, 15 cm from the pivot, axle let go horizontal.  The textbook's m g l/(I3 w3) is
the
limit of fast spin; the mean precession of the run follows the closed form for every spin, and its deviation from the
textbook falls with the fourth power of the spin: for a horizontal axle the term of second order vanishes.

Source: H. Goldstein, Classical Mechanics, 3rd ed., section 5.7; `kreisel.physical` for the units.
"""

import math
import os

import numpy as np

import kreisel as kr
from kreisel import analysis
from kreisel.physical import Gyroscope
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
wheel = Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15)
rpm = np.geomspace(120, 1200, 4 if SMALL else 14)
measured, closed, textbook = [], [], []
for each in rpm:
    spin = each * 2 * math.pi / 60
    x0 = wheel.state(tilt=math.pi / 2, spin=spin)
    nutation = 2 * math.pi / wheel.nutation_rate(spin)  # about one period, s
    run = kr.simulate(wheel, x0, dt=nutation / 60, steps=1200, method="exact", orientation=False)
    table = analysis.mean_rates(run)
    measured.append(table.measured.mean_precession)
    closed.append(table.closed_form.mean_precession)
    textbook.append(wheel.slow_precession(spin))
measured, closed, textbook = (np.array(v) * 60 / (2 * math.pi) for v in (measured, closed, textbook))
off = abs(measured / textbook - 1)
slope = np.polyfit(np.log(rpm[-3:]), np.log(off[-3:]), 1)[0]
print(
    f"at {rpm[-1]:.0f} rpm: {measured[-1]:.4f} rpm precession, textbook {textbook[-1]:.4f}; "
    f"deviation ~ spin^{slope:.2f}"
)
assert np.allclose(measured, closed, rtol=1e-11)
assert abs(slope + 4) < 0.1

with figure("light", 9.0, 3.5) as (made, theme):
    left, right = made.subplots(1, 2)
    left.loglog(rpm, textbook, color=theme.faint, label="m g l/(I₃ ω₃)")
    left.loglog(rpm, closed, color=theme.colours[1], label="closed form")
    left.loglog(rpm, measured, "o", markersize=4, color=theme.colours[0], label="runs")
    left.set(xlabel="spin, rpm", ylabel="precession, rpm", title="a bicycle wheel, axle horizontal")
    left.legend()
    right.loglog(rpm, off, "o-", markersize=4, color=theme.colours[0])
    right.loglog(rpm, off[-1] * (rpm / rpm[-1]) ** -4, "--", color=theme.faint, label="spin⁻⁴")
    right.set(xlabel="spin, rpm", title="relative deviation from the textbook")
    right.legend()
    made.savefig("bicycle_wheel.png")
