"""A bicycle wheel with friction in its bearings: it slows down, precesses faster and sinks.

The wheel hangs by one end of its axle, which is horizontal at first, in steady precession.  The bearings take
M3' = -c M3, so M3 = M3(0) exp(-c t) whatever the axle does.  The slow precession W grows as m g l/M3, and the axle
sinks, since the kinetic energy of the precession must come from gravity:

    theta' = c (I1 m g l/M3^2) sin(theta),   tan(theta/2) = tan(theta(0)/2) exp((I1 m g l/2) (1/M3^2 - 1/M3(0)^2)),

to leading order in I1 m g l/M3^2; from the vertical part of the momentum, of which the bearings take c M3 cos(theta).
The energy changes by the work of the friction alone.

Source: H. Goldstein, Classical Mechanics, 3rd ed., section 5.7, for the precession; the friction by hand.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.physical import Gyroscope
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
SPIN, LIFE, DURATION = 400 * 2 * np.pi / 60, 60.0, 80.0  # rad/s, s: 1/c, s
wheel = Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15, damping=(0, 0, 1 / LIFE))
slow, fast = wheel.steady_precession(np.pi / 2, SPIN)
x0 = wheel.state(np.pi / 2, SPIN, precession=slow)
run = kr.simulate(wheel, x0, dt="36 ms" if SMALL else "18 ms", t_end=DURATION, order=(4, 2))

time, motion = run.time.values, wheel.motion(run.momentum, run.axis)
tilt, spin, precession = motion.tilt, motion.spin, motion.precession
M3 = wheel.axial_moment * spin
decay = abs(M3 / (M3[0] * np.exp(-time / LIFE)) - 1).max()
print(f"M3 against exp(-c t): off by {decay:.1e} over {time[-1]:.0f} s, in which it falls to {M3[-1] / M3[0]:.2f}")
assert decay < 1e-11  # the rounding of exp(-c h), the same in every step

steady, _ = wheel.steady_precession(tilt, spin)
textbook = wheel.weight_torque / M3
off, beside = abs(precession / steady - 1).max(), abs(precession / textbook - 1)
rpm = precession * 60 / (2 * np.pi)
print(f"precession {rpm[0]:.2f} to {rpm[-1]:.2f} rpm; off the steady one "
      f"of that tilt and spin by {off:.1e}, off m g l/M3 by up to {beside.max():.1e}")  # fmt: skip
growth = np.polyfit(np.log(M3), np.log(precession), 1)[0]
print(f"precession ~ M3^{growth:.3f}")
assert off < 1e-3 and 1e-2 < beside.max() < 2e-2  # m g l/M3 is the limit of a fast wheel
assert abs(growth + 1) < 0.02

size = wheel.transverse_moment * wheel.weight_torque
sunk = 2 * np.arctan(np.exp(size * (1 / M3**2 - 1 / M3[0] ** 2) / 2)) - np.pi / 2
print(f"sunk by {np.degrees(tilt[-1] - np.pi / 2):.2f} degrees, to leading order {np.degrees(sunk[-1]):.2f}")
assert abs((tilt[-1] - np.pi / 2) / sunk[-1] - 1) < 0.05 and abs(tilt[len(tilt) // 2] - tilt[-1]) > 0.05

energy = run.energy.values
balance = abs(run.balance.values / run.balance.values[0] - 1).max()
print(f"the wheel loses {energy[0] - energy[-1]:.1f} of {energy[0]:.1f} J; energy - work is off by {balance:.1e}")
assert balance < 1e-12 and energy[-1] < 0.1 * energy[0]

with figure("light", 11.0, 3.4) as (made, theme):
    left, centre, right = made.subplots(1, 3)
    left.semilogy(time, spin * 60 / (2 * np.pi), color=theme.colours[0], label="run")
    left.semilogy(time[::400], spin[0] * 60 / (2 * np.pi) * np.exp(-time[::400] / LIFE), "o", markersize=4,
                  color=theme.colours[1], label="exp(-c t)")  # fmt: skip
    left.set_yticks((100, 200, 400), ("100", "200", "400"))
    left.minorticks_off()
    left.set(xlabel="time, s", ylabel="spin, rpm", title="the wheel slows down")
    left.legend()
    centre.plot(time, rpm, color=theme.colours[0], label="run")
    centre.plot(time, textbook * 60 / (2 * np.pi), "--", color=theme.colours[1], label="m g l/M₃")
    centre.set(xlabel="time, s", ylabel="precession, rpm", title="precesses faster")
    centre.legend()
    right.plot(time, np.degrees(tilt) - 90, color=theme.colours[0], label="run")
    right.plot(time, np.degrees(sunk), "--", color=theme.colours[1], label="to leading order")
    right.set(xlabel="time, s", ylabel="axle below the horizontal, degrees", title="and sinks")
    right.legend()
    made.savefig("bearing_friction.png")
