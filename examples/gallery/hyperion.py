"""A moon like Hyperion on an elliptic orbit: its slow rotation is chaotic.

A body with moments A < B < C on a Kepler orbit of eccentricity e feels V = (3/2) (GM/r^5) r.I r, with r = g^T r(t) the
direction of Saturn in the body.  Time is in units of the orbit's inverse mean motion: one orbit is 2 pi.

Left: rotation about the axis C, normal to the orbit, seen at every periapsis: the rate against the angle of the long
axis.  One chaotic zone goes from the 1/2 to the 2 state; there is no 3/2 state.  Top right: the axis C tilted by 0.001
rad.  In the states 2 and 5/2 it stays there, in the states 1/2 and 1 and in the chaotic zone it turns over.  Bottom:
neighbouring motions separate by a factor e in one to three orbits of 21.28 days.

That Hyperion itself tumbles so is contested.  Voyager 2 and Cassini saw it turn 4.2 to 4.5 times as fast as it goes
round, about an axis up to 30 degrees off its longest; Goldberg and Batygin conclude for a symmetric body that it
rotates regularly, or with a chaos orders of magnitude weaker.  benchmarks/hyperion.py integrates the whole motion from
these states for 10,000 orbits, with moments 0.314, 0.474 and 0.542 M R^2.  From slow states neighbours separate by a
factor e in 37 days (the median), from those of the four flybys in 75 to 130 days; from those of 2005 with corrected
principal axes in 600 to 1630 days, and 3 of 30 motions are regular.  So the chaos is weaker by a factor of 2 to 4 or of
16 to 44, as the principal axes are those of the shape or of the correction.

The planar motion agrees with C theta'' = -(3/2) (B - A) sin(2 (theta - f))/r^3, integrated by SciPy.

Source: J. Wisdom, S. J. Peale, F. Mignard, Icarus 58 (1984) 137: e = 0.1, half axes 190, 145, 114 km, (B - A)/C =
0.264; states and their stability in its abstract.  M. Goldberg, K. Batygin, Astron. Astrophys. 692 (2024) A9.  R. A.
Harbison, P. C. Thomas, P. C. Nicholson, Rotational modeling of Hyperion, Celest. Mech. Dyn. Astron. 110 (2011) 1.
"""

import os

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import kreisel as kr
from kreisel.algebra import rotation_matrix
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
ORBITS, LANES, STEPS = (60, 12, 48) if SMALL else (300, 36, 48)  # steps: of an orbit
ECCENTRICITY, ORBIT, DAYS = 0.1, 2 * np.pi, 21.28
a, b, c = 190.0, 145.0, 114.0
I = np.array((b * b + c * c, a * a + c * c, a * a + b * b)) / (a * a + b * b)


def anomaly(t, e):
    """The eccentric anomaly: Newton's method for E - e sin(E) = t, a fixed number of steps."""
    E = t + e * np.sin(t)
    for _ in range(3):
        E = E - (E - e * np.sin(E) - t) / (1 - e * np.cos(E))
    return E


def potential(g, t, *, moments, e):
    E = anomaly(t, e)
    r = (np.cos(E) - e) * g[0] + np.sqrt(1 - e * e) * np.sin(E) * g[1]
    return 1.5 * (moments @ (r * r)) / (1 - e * np.cos(E)) ** 5


moon = kr.perturbed(kr.EulerTop(J=I.sum() / 2 - I), potential=potential, params={"moments": I, "e": ECCENTRICITY})


def moved(M, g, orbits, every=STEPS):
    """Runs from periapsis."""
    choices = {"method": "splitting", "order": (8, 6, 4), "observe": ()}
    return kr.simulate(
        moon, moon.state(M=M), dt=ORBIT / STEPS, steps=orbits * STEPS, every=every, orientation=g, **choices
    )


def simulated(theta, rate, orbits, tilt=0.0, every=STEPS):
    """Runs from angle and rate at periapsis, with the axis C tilted about the axis A."""
    theta, rate = np.broadcast_arrays(np.asarray(theta, float), rate)
    ct, st, cz, sz = np.cos(tilt / 2), np.sin(tilt / 2), np.cos(theta / 2), np.sin(theta / 2)
    g = np.stack((cz * ct, cz * st, sz * st, sz * ct), -1)  # about the normal of the orbit, then about A
    return moved(np.stack((0 * rate, 0 * rate, I[2] * rate), -1), g, orbits, every)


def pendulum(t, y):
    """theta'' of a planar rotation."""
    E = anomaly(t, ECCENTRICITY)
    f = np.arctan2(np.sqrt(1 - ECCENTRICITY**2) * np.sin(E), np.cos(E) - ECCENTRICITY)
    return y[1], -1.5 * (I[1] - I[0]) / I[2] * np.sin(2 * (y[0] - f)) / (1 - ECCENTRICITY * np.cos(E)) ** 3


def planar(theta, rate, end):
    return solve_ivp(pendulum, (0, end), (theta, rate), rtol=1e-12, atol=1e-12, method="DOP853").y[:, -1]


def angle(run):
    return 2 * np.arctan2(run.g.values[..., 3], run.g.values[..., 0])


print(f"(B - A)/C = {(I[1] - I[0]) / I[2]:.3f}")
assert abs((I[1] - I[0]) / I[2] - 0.264) < 5e-4


def state(p, theta):
    """The rate at periapsis of the state p: the planar motion that turns by p pi from periapsis to apoapsis."""
    return brentq(lambda rate: planar(theta, rate, np.pi)[0] - theta - p * np.pi, max(p - 0.5, 0.2), p + 0.5)


states = {"1/2": (0.5, np.pi / 2), "1": (1.0, 0.0), "2": (2.0, 0.0), "5/2": (2.5, 0.0)}

# -- the section
near = [(theta, state(p, theta) + 0.03) for p, theta in states.values()]
start = np.concatenate(([rate for _, rate in near], np.linspace(0.15, 2.95, LANES)))
phases = np.concatenate(([theta for theta, _ in near], np.where(np.arange(LANES) % 2, np.pi / 2, 0.0)))
cut = simulated(phases, start, ORBITS)
theta, rates = np.mod(angle(cut) + np.pi / 2, np.pi) - np.pi / 2, cut.M.values[..., 2] / I[2]
own, reference = cut.isel(time=20), planar(phases[-1], start[-1], 20 * ORBIT)
off = max(abs(np.sin(angle(own)[-1] - reference[0])), abs(rates[20, -1] - reference[1]))
print(f"after 20 orbits off the equation of planar rotation by {off:.1e}")
assert off < 1e-6
widths = np.ptp(rates, axis=0)
assert widths[:4].max() < 0.4  # motions near the states stay near
chaotic = widths > 1
low, high = rates[:, chaotic].min(), rates[:, chaotic].max()
print(f"{chaotic.sum()} of {len(start)} motions are in the chaotic zone, rates {low:.2f} to {high:.2f}")
assert low < 0.5 and high > 2  # around the states 1/2 and 2
half = simulated((0.0, np.pi / 2), (1.5, 1.5), ORBITS)
print(f"from the 3/2 state: rates range over {np.ptp(half.M.values[..., 2] / I[2], axis=0).round(2)}")
assert (np.ptp(half.M.values[..., 2] / I[2], axis=0) > 1).all()  # no such state
assert widths[abs(start - 2.7) < 0.1].max() < 0.5  # beside it, regular motion

# -- the axis leaves the normal of the orbit
begin = [(theta, state(p, theta)) for p, theta in states.values()] + [(0.0, 1.5)]
names = [*states, "chaotic zone"]
tilted = simulated(*np.array(begin).T, orbits=60, tilt=1e-3, every=STEPS // 8)
normal = rotation_matrix(tilted.g.values)[..., 2]  # the axis C in space
tilt = np.arctan2(np.hypot(normal[..., 0], normal[..., 1]), normal[..., 2])
largest = dict(zip(names, np.degrees(tilt.max(0)), strict=True))
print("largest tilt in 60 orbits, degrees:", ", ".join(f"{name}: {v:.2f}" for name, v in largest.items()))
assert max(largest["2"], largest["5/2"]) < 1 and min(largest[name] for name in ("1/2", "1", "chaotic zone")) > 60

# -- neighbouring motions, from tumbling ones
PAIRS, APART = (8, 1e-9) if SMALL else (32, 1e-9)
begin = simulated(0.0, np.linspace(0.6, 1.6, PAIRS), 50, tilt=0.5).isel(time=-1)
shift = np.tile((0.0, APART), PAIRS)[:, None] * np.array((1.0, 0.0, 0.0))
pairs = moved(np.repeat(begin.M.values, 2, 0) + shift, np.repeat(begin.g.values, 2, 0), 40, STEPS // 8)
turns = rotation_matrix(pairs.g.values)
gap = np.sqrt(
    ((turns[:, ::2] - turns[:, 1::2]) ** 2).sum((-1, -2))
    + ((pairs.M[:, ::2].values - pairs.M[:, 1::2].values) ** 2).sum(-1)
)
orbit, mean = pairs.time.values / ORBIT, np.exp(np.log(gap).mean(1))
grown = (orbit > 2) & (orbit < orbit[np.argmax(mean > 1e-2)])
growth, offset = np.polyfit(orbit[grown], np.log(mean[grown]), 1)
print(f"neighbours separate by e in {1 / growth:.2f} orbits, {DAYS / growth:.0f} days; {orbit[grown][-1]:.0f} orbits")
assert 0.5 < 1 / growth < 3

with figure("light", 10.0, 6.4) as (made, theme):
    panels = made.subplot_mosaic([["cut", "tilt"], ["cut", "gap"]], width_ratios=[1.25, 1])
    for lane in range(len(start)):
        colour = theme.ink if chaotic[lane] else theme.colours[lane % 7]
        size = 1.6 if chaotic[lane] else 2.0
        panels["cut"].plot(np.degrees(theta[:, lane]), rates[:, lane], ".", markersize=size, markeredgewidth=0,
                           color=colour)  # fmt: skip
    for name, (p, at) in states.items():
        where = -90 if at else 0
        panels["cut"].annotate(
            name, (where, state(p, at)), xytext=(where + (26 if p == 2.5 else 4), state(p, at) - 0.02), weight="bold"
        )
    panels["cut"].set(
        xlabel="angle of the long axis to Saturn at periapsis, degrees", ylabel="rate over mean motion",
        xlim=(-90, 90), ylim=(0, 3.2), xticks=(-90, -45, 0, 45, 90), title="planar rotation: section at periapsis",
    )  # fmt: skip
    time = tilted.time.values / ORBIT
    for name, lane in zip(names, range(len(names)), strict=True):
        panels["tilt"].semilogy(time, np.degrees(tilt[:, lane]), color=theme.colours[lane], linewidth=1, label=name)
    panels["tilt"].set(xlabel="orbits", ylabel="tilt of the axis, degrees", title="does the axis stay upright?")
    panels["tilt"].legend(ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.17), columnspacing=1, handlelength=1)
    for lane in range(PAIRS):
        panels["gap"].semilogy(orbit, gap[:, lane], color=theme.grid, linewidth=0.6)
    panels["gap"].semilogy(orbit, mean, color=theme.colours[0], label="geometric mean")
    line = np.exp(growth * orbit[grown] + offset)
    panels["gap"].semilogy(
        orbit[grown], line, "--", color=theme.colours[1], label=f"e-fold in {DAYS / growth:.0f} days"
    )
    panels["gap"].set(xlabel="orbits", ylabel="distance", title="neighbours among slow tumbling motions")
    panels["gap"].legend(loc="lower right")
    made.savefig("hyperion.png")
