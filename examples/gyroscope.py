"""A bicycle wheel hung by one end of its axle: the textbook precession, and what nutation adds to it.

Usage: python gyroscope.py [FOLDER]; the figure goes to FOLDER, else to the current folder.
The sources of the data, and which are assumed, are in gyroscope.toml next to this file: `kreisel run gyroscope.toml`.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import kreisel as kr
from kreisel.physical import STANDARD_GRAVITY, Gyroscope, Motion
from kreisel.viewer.style import THEMES

WHEEL = Gyroscope.flat(mass=29.5 / STANDARD_GRAVITY, axial_moment=0.17, lever=0.15)
TILT, SPIN = math.pi / 2, 2 * math.pi * 3  # rad, rad/s
SHOWN = 6.0  # s
LOOK = THEMES["light"]


def maxima(seconds: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Times of the maxima, each by the parabola through three samples."""
    at = np.flatnonzero((series[1:-1] > series[:-2]) & (series[1:-1] >= series[2:])) + 1
    left, middle, right = series[at - 1], series[at], series[at + 1]
    return seconds[at] + (seconds[1] - seconds[0]) * (left - right) / (left - 2 * middle + right) / 2


def mean_rates(seconds: np.ndarray, motion: Motion) -> tuple[float, float]:
    """Mean precession and frequency of nutation over whole nutations, rad/s."""
    lowest = maxima(seconds, motion.tilt)
    span = lowest[-1] - lowest[0]
    turned = np.diff(np.interp(lowest[[0, -1]], seconds, np.unwrap(motion.azimuth)))
    return float(turned[0] / span), float(2 * math.pi * (len(lowest) - 1) / span)


def report(seconds: np.ndarray, motion: Motion) -> None:
    mean, nutation = mean_rates(seconds, motion)
    slow, steady = WHEEL.slow_precession(SPIN), WHEEL.steady_precession(float(motion.tilt.mean()), SPIN)[0]
    print(f"mean precession, simulated        {mean:8.4f} rad/s, a turn in {2 * math.pi / mean:.2f} s")
    print(f"  textbook m g l/(I3 w3)          {slow:8.4f} rad/s ({slow / mean - 1:+.2%})")
    print(f"  exact steady root, mean tilt    {steady:8.4f} rad/s ({steady / mean - 1:+.2%})")
    fastest, slowest = motion.precession.max(), abs(motion.precession).min()
    print(f"  within a nutation from {slowest:.4f} (at rest in the cusps) to {fastest:.4f} rad/s")
    rate = WHEEL.nutation_rate(SPIN)
    print(f"nutation, simulated               {nutation:8.4f} rad/s, {nutation / (2 * math.pi):.2f} a second")
    print(f"  fast top I3 w3/I1               {rate:8.4f} rad/s ({rate / nutation - 1:+.2%})")
    dip, textbook_dip = np.ptp(motion.tilt), 2 * (WHEEL.momentum_unit / (WHEEL.axial_moment * SPIN)) ** 2
    print(f"dip below the horizontal          {math.degrees(dip):8.3f} degrees")
    print(
        f"  fast top 2 I1 m g l/(I3 w3)^2   {math.degrees(textbook_dip):8.3f} degrees ({textbook_dip / dip - 1:+.2%})"
    )


def draw(seconds: np.ndarray, motion: Motion) -> Figure:
    mean, _ = mean_rates(seconds, motion)
    tilt = float(motion.tilt.mean())
    slow, steady = WHEEL.slow_precession(SPIN), WHEEL.steady_precession(tilt, SPIN)[0]
    shown = seconds <= SHOWN
    seconds, phi = seconds[shown], np.unwrap(motion.azimuth)[shown]
    with mpl.rc_context(LOOK.rc):
        figure = Figure(figsize=(7.2, 5.4), layout="constrained")
        path, lag = figure.subplots(2, 1)
        path.plot(np.degrees(phi), 90 - np.degrees(motion.tilt[shown]), color=LOOK.colours[0])
        path.plot(0, 0, "o", color=LOOK.colours[1], markersize=4, label="released from rest")
        path.axhline(90 - math.degrees(tilt), color=LOOK.faint, linestyle="--", label="mean inclination")
        path.set(xlabel="azimuth of the axle, degrees", ylabel="above the horizontal, degrees")
        path.set(title="path of the axle: a cusp at every return to the horizontal", ylim=(None, 2.2))
        path.set(xlim=(-5, math.degrees(phi[-1]) + 5))
        path.legend(loc="upper right", ncols=2)
        lag.plot(seconds, np.degrees(phi - slow * seconds), color=LOOK.colours[0], linewidth=0.8, label="simulated")
        for label, rate, colour in (
            (r"textbook rate $m g l/(I_3\omega_3)$", slow, LOOK.colours[1]),
            ("exact steady rate at the mean inclination", steady, LOOK.colours[2]),
            ("mean rate of the simulation", mean, LOOK.colours[6]),
        ):
            lag.plot(seconds, np.degrees((rate - slow) * seconds), color=colour, linestyle="--", label=label)
        lag.set(xlabel="time, s", ylabel="azimuth, degrees", title="azimuth less the textbook precession")
        lag.set(xlim=(0, SHOWN))
        lag.legend(loc="upper left", ncols=2, bbox_to_anchor=(0, -0.2))
        figure.suptitle("Bicycle wheel hung by one end of its axle, 3 turns a second", fontsize=10)
    return figure


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    print(f"wheel   m = {WHEEL.mass:.4f} kg, l = {WHEEL.lever} m, I3 = {WHEEL.axial_moment} kg m^2,")
    print(f"        I1 = {WHEEL.transverse_moment:.5f} kg m^2 about the pivot, w3 = {SPIN:.4f} rad/s")
    run = kr.simulate(WHEEL, WHEEL.state(TILT, SPIN), dt="0.4 ms", t_end="45 s", every="8 ms", progress=False)
    seconds, motion = run.time.values, WHEEL.motion(run.momentum, run.axis)
    report(seconds, motion)
    path = folder / "gyroscope-precession.png"
    draw(seconds, motion).savefig(path)
    print(f"figure: {path}")


if __name__ == "__main__":
    main()
