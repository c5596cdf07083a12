"""A slow top that a vibrating pivot holds upright.

The pivot goes up and down, so that gravity is 1 + k cos(w t); p = a = 1, transverse moment 1, axial momentum s.
Without the drive the upright top falls for s < 2.  Small tilts z = a1 + i a2 obey
z'' - i s z' - (1 + k cos(w t)) z = 0, and with z = u exp(i s t/2) this is Mathieu's equation,

    u'' + (s^2/4 - 1 - k cos(w t)) u = 0:   in the mean stable for k^2/(2 w^2) > 1 - s^2/4,

between the characteristic values a_0(q) and b_1(q), q = 2 k/w^2, as it stands.  Kapitza's pendulum is s = 0.  Left:
runs of the whole top that stay upright (dots) or fall (crosses).  Right: tilts below and above the limit.

Source: P. L. Kapitza, Sov. Phys. JETP 21 (1951) 588; L. D. Landau, E. M. Lifshitz, Mechanics, section 30; NIST Digital
Library of Mathematical Functions, 28.2.
"""

import os

import numpy as np
from scipy.optimize import brentq
from scipy.special import mathieu_a, mathieu_b

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
FREQUENCY, TILT, STEPS, PERIODS = 8.0, 1e-4, 24, 130  # steps: of a period of the drive


def weight(a, t, *, k, w):
    return k * np.cos(w * t) * a[2]


def simulated(s, k):
    """The tilts of tops let go almost upright, and what the runs conserve."""
    s, k = (np.ravel(x) for x in np.broadcast_arrays(s, k))
    top = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=weight, params={"k": k, "w": FREQUENCY})
    axis = np.array((np.sin(TILT), 0, np.cos(TILT)))
    x0 = top.state(m=s[:, None] * axis, a=np.tile(axis, (len(s), 1)))
    dt = 2 * np.pi / FREQUENCY / STEPS
    run = kr.simulate(top, x0, dt=dt, steps=PERIODS * STEPS, every=STEPS // 4, method="splitting", order=(8, 6, 4))
    return run, np.arctan2(np.hypot(run.a[..., 0], run.a[..., 1]), run.a[..., 2]).values


def mathieu_limits(s):
    """The least and the largest k of Mathieu's equation, 0 < q < 2."""
    a = 4 * (s * s / 4 - 1) / FREQUENCY**2
    least = brentq(lambda q: mathieu_a(0, q) - a, 0, 2) if a < 0 else 0.0
    return least * FREQUENCY**2 / 2, brentq(lambda q: mathieu_b(1, q) - a, 0, 2) * FREQUENCY**2 / 2


def in_the_mean(s):
    return FREQUENCY * np.sqrt(2 * np.maximum(1 - s * s / 4, 0))


# -- the limit at s = 1
SLOW = 1.0
low, high = mathieu_limits(SLOW)
near = low * np.linspace(0.96, 1.04, 17 if SMALL else 65)
begun, edge = simulated(SLOW, near)
falls = edge.max(0) > 100 * TILT
assert (np.diff(falls.astype(int)) <= 0).all()  # all fall below one k
found = (near[falls].max() + near[~falls].min()) / 2
print(f"s = 1: upright from k = {found:.3f}; Mathieu {low:.3f}, in the mean {in_the_mean(SLOW):.3f}")
assert abs(found / low - 1) < 0.004 and abs(in_the_mean(SLOW) / found - 1) < 0.01

# -- the plane
s, k = np.meshgrid(np.linspace(0, 2.2, 6 if SMALL else 23), np.linspace(1, 40, 8 if SMALL else 27), indexing="ij")
run, tilt = simulated(s, k)
upright = (tilt.max(0) < 100 * TILT).reshape(s.shape)
limits = np.array([mathieu_limits(x) for x in s[:, 0]])
predicted = (k > limits[:, :1]) & (k < limits[:, 1:])
clear = (abs(k - limits[:, :1]) > 0.6) & (abs(k - limits[:, 1:]) > 0.6)
wrong = (upright != predicted) & clear
print(f"{s.size} tops, {clear.sum()} of them clear of the limits: {wrong.sum()} not as Mathieu's equation says")
assert not wrong.any() and upright.any() and not upright.all()
about = abs(run.m[..., 2] - run.m[0, :, 2]).max().item()
balance, change = (abs(x - x[0]).max().item() for x in (run.balance, run.energy))
print(
    f"m.p is conserved to {about:.1e}; energy - work to {balance:.1e}, while the energy changes by up to {change:.0f}"
)
assert about < 1e-12 and balance < 1e-5 and change > 10

with figure("light", 10.0, 4.0) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=[1, 1.15])
    fine = np.linspace(0, 2.3, 200)
    limit = np.array([mathieu_limits(x) for x in fine])
    left.fill_between(fine, *limit.T, color=theme.grid, alpha=0.6, linewidth=0, label="Mathieu's equation")
    left.plot(fine[fine < 2], in_the_mean(fine[fine < 2]), "--", color=theme.ink, linewidth=1, label="in the mean")
    left.plot(s[upright], k[upright], "o", markersize=2.5, color=theme.colours[0], label="upright")
    left.plot(s[~upright], k[~upright], "x", markersize=3, color=theme.colours[1], label="falls")
    left.set(xlabel="axial momentum s", ylabel="drive k, in units of gravity", xlim=(-0.05, 2.25), ylim=(0, 41),
             title=f"upright tops, w = {FREQUENCY:g}")  # fmt: skip
    left.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.14), columnspacing=1, handlelength=1.2)
    for lane, colour in zip((0, abs(near - 0.98 * low).argmin(), abs(near - 1.02 * low).argmin()), theme.colours,
                            strict=False):  # fmt: skip
        right.semilogy(
            begun.time, np.degrees(edge[:, lane]), color=colour, linewidth=0.8, label=f"k = {near[lane]:.2f}"
        )
    right.set(xlabel="time", ylabel="tilt, degrees", title=f"s = 1, limit at k = {low:.3f}")
    right.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    made.savefig("driven_top.png")
