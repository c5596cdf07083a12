"""A tennis racket and a tumbling asteroid, in SI units.

A racket thrown with 2 turns a second about its middle axis flips over every 2 K/lambda; the flips of the run come when
the closed form says.  The racket is a hoop on a rod, with masses and lengths assumed.

The asteroid (99942) Apophis turns in a short-axis mode with two published periods, 262.2 +- 0.1 h and 27.374 +- 0.001
h, the best of at least three pairs that fit its light curves, and its moments are as 0.64 : 0.97 : 1.  The closed form
gives the spin that has these periods.  The run then shows them: in the first the momentum goes round the short axis in
the body, in the second that axis goes round the momentum.  The energy over the least at that momentum, which does not
enter, comes out as 1.011: within the published 1.024 +- 0.013.

Source: Astron. Astrophys. 709 (2026) A278 (periods); H.-J. Lee et al., Astron. Astrophys. 661 (2022) L3 (moments; its
periods are 264.178 h and 27.38547 h); P. Pravec et al., Icarus 233 (2014) 48 (energy); L. D. Landau, E. M. Lifshitz,
Mechanics, section 37.
"""

import os

import numpy as np
from scipy.optimize import brentq

import kreisel as kr
from kreisel.algebra import act, rotation_matrix
from kreisel.physical import FreeBody
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ


def zeros(time, x):
    """The times at which x changes sign."""
    i = np.nonzero(x[1:] * x[:-1] < 0)[0]
    return time[i] - x[i] * (time[i + 1] - time[i]) / (x[i + 1] - x[i])


def racket():
    """A hoop of 0.15 kg, 27 cm across and 2 cm thick, on a rod of 0.17 kg, 38 cm long and 3 cm thick, along axis 1."""
    hoop, rod = 0.15, 0.17
    r, thick, length, radius = 0.135, 0.01, 0.38, 0.015
    ring = hoop * (np.array((0.5, 0.5, 1.0)) * r**2 + np.array((0.625, 0.625, 0.75)) * thick**2)
    bar = rod * (np.array((0.5, 0.25, 0.25)) * radius**2 + np.array((0.0, 1.0, 1.0)) * length**2 / 12)
    apart = hoop * rod / (hoop + rod) * (r + thick + length / 2) ** 2
    return FreeBody(ring + bar + np.array((0.0, apart, apart)), mass=hoop + rod)


def asteroid(moments, period, precession_period):
    """The short-axis rotation of a body with these moments that has the two periods, s."""
    body, (i1, i2, i3) = FreeBody(moments, time_unit="1 h"), moments

    def rotation(energy, scale=1.0):  # 2T I3/L^2; M in the plane of the axes 1 and 3
        part = (energy - 1) / (i3 / i1 - 1)
        return body.rotation(scale * np.array((np.sqrt(part) / i1, 0.0, np.sqrt(1 - part) / i3)))

    def excess(energy):
        return rotation(energy).period / rotation(energy).precession_period - period / precession_period

    energy = brentq(excess, 1 + 1e-6, i3 / i2 * (1 - 1e-9), xtol=1e-14)
    return body, rotation(energy, rotation(energy).precession_period / precession_period), energy


# -- the racket
body = racket()
spin = (0.02, 2 * 2 * np.pi, 0.05)  # rad/s, along handle, in the face, normal to the face
motion = body.rotation(spin)
duration = 4 if SMALL else 8
run = kr.simulate(body, body.state(spin), dt="0.2 ms", t_end=duration, method="veselov", order=8, every="1 ms")
seconds, Omega = run.time.values, run.angular_velocity.values
flips, predicted = zeros(seconds, Omega[:, 1]), motion.flips(duration)
middle = body.stability(spin[1])[1]
print(f"racket: moments {body.principal.moments.round(5)} kg m^2, middle axis {middle.kind}, {middle.growth:.2f} /s")
print(f"{len(flips)} flips, one every {motion.nutation_period:.4f} s; off by {abs(flips - predicted).max():.1e} s")
assert len(flips) >= 3 and abs(flips - predicted).max() < 1e-6
assert middle.kind == "unstable"

# -- Apophis
HOUR = 3600.0
apophis, tumbling, energy = asteroid((0.64, 0.97, 1.0), 262.2 * HOUR, 27.374 * HOUR)
turns = 1.6 if SMALL else 4.2
start = apophis.state(tumbling.spin)
path = kr.simulate(apophis, start, dt="0.1 h", steps=round(turns * 2622), method="veselov", order=8)
hours = path.time.values / HOUR
crossings = zeros(hours, path.momentum.values[:, 1])
period = 2 * np.diff(crossings).mean()
L = tumbling.momentum / np.linalg.norm(tumbling.momentum)
across = np.cross((0.0, 1.0, 0.0), L)
axis = act(rotation_matrix(path.attitude.values), tumbling.axis)  # in space
azimuth = np.unwrap(np.arctan2(axis[:, 1], axis @ across))
begin, end = np.interp(crossings[[0, 2 * ((len(crossings) - 1) // 2)]], hours, azimuth)
rounds = (len(crossings) - 1) // 2
precession = 2 * np.pi * rounds * period / abs(end - begin)
print(f"Apophis: periods in the run {period:.3f} h and {precession:.5f} h, published 262.2 h and 27.374 h")
print(f"energy over the least {energy:.4f}, published 1.024 +- 0.013; {tumbling.kind}")
print(f"the short axis is {np.degrees(tumbling.tilts).round(1)} degrees from the momentum")
assert abs(period / 262.2 - 1) < 1e-5 and abs(precession / 27.374 - 1) < 1e-5
assert tumbling.kind == "short-axis mode" and abs(energy - 1.024) < 0.013
tilt = np.degrees(np.arctan2(np.linalg.norm(np.cross(axis, L), axis=-1), axis @ L))
assert abs(np.array((tilt.min(), tilt.max())) - np.degrees(tumbling.tilts)).max() < 0.01

with figure("light", 11.5, 3.7) as (made, theme):
    left, centre, right = made.subplots(1, 3, width_ratios=[1.5, 1.3, 1])
    shown = seconds < 4
    for j in range(3):
        left.plot(seconds[shown], Omega[shown, j], color=theme.colours[j], label=f"Ω{'₁₂₃'[j]}", linewidth=1)
    for k, flip in enumerate(predicted[predicted < 4]):
        label = "flips, closed form" if k == 0 else None
        left.axvline(flip, color=theme.faint, linewidth=0.8, linestyle=":", label=label)
    left.set(xlabel="time, s", ylabel="rad/s", title="tennis racket")
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=4, columnspacing=1)
    centre.plot(hours / 24, tilt, color=theme.colours[0], linewidth=1)
    for k in range(1, int(hours[-1] * HOUR / tumbling.period) + 1):
        centre.axvline(k * tumbling.period / HOUR / 24, color=theme.faint, linewidth=0.8, linestyle=":")
    centre.set(
        xlabel="time, days; dotted: periods of 262.2 h", ylabel="degrees", title="Apophis: tilt of the short axis"
    )
    once = hours <= tumbling.period / HOUR
    right.plot(axis[once] @ across, axis[once, 1], color=theme.colours[1], linewidth=0.8)
    right.plot(0, 0, "+", color=theme.faint)
    right.set(aspect="equal", title="its path, seen along M")
    right.set_axis_off()
    made.savefig("free_bodies.png")
