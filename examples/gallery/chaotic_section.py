"""Poincare sections of two heavy tops: an integrable one and a chaotic one.

The section is where the axis is highest.  With equal transverse moments the momentum M3 about the axis is kept, and
each motion stays on a line; with unequal ones and the centre of mass on an axis, no second integral is left, and single
motions fill regions of the same energy and the same M.P.

Source: Suris 2001, section 4, for the system; V. V. Kozlov, Methods of qualitative analysis in the dynamics of a rigid
body, 1980, for the non-integrability.
"""

import os

import numpy as np
from scipy.optimize import brentq

import kreisel as kr
from kreisel import analysis
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
LANES, STEPS = (8, 4000) if SMALL else (20, 20_000)
ENERGY, MOMENT = 2.6, 0.8
moments = {"I = (1, 1, 0.8)": (1.0, 1.0, 0.8), "I = (1, 0.45, 0.8)": (1.0, 0.45, 0.8)}


def start(I, psi, M3):
    """A state on the section with that energy and M.P: Omega across the axis is k times P across the axis."""

    def parts(z):
        across = np.sqrt(1 - z * z) * np.array((np.cos(psi), np.sin(psi)))
        k = (MOMENT - M3 * z) / (across @ (I[:2] * across))
        return np.array((*(I[:2] * k * across), M3)), np.array((*across, z))

    def excess(z):
        M, P = parts(z)
        return (M * M / I).sum() / 2 + P[2] - ENERGY

    z = np.linspace(-0.999, 0.999, 400)
    off = np.array([excess(each) for each in z])
    roots = [brentq(excess, z[i], z[i + 1], xtol=1e-15) for i in np.nonzero(off[1:] * off[:-1] < 0)[0]]
    return [parts(root) for root in roots]


def peak(M, P, I):
    """The derivative of P3: P3' = P1 Omega2 - P2 Omega1."""
    return P[..., 0] * M[..., 1] / I[1] - P[..., 1] * M[..., 0] / I[0]


spread, cuts = {}, {}
for name, I in moments.items():
    I = np.array(I)
    top = kr.HeavyTop(J=I.sum() / 2 - I, A=(0, 0, 1))
    begin = [s for M3 in np.linspace(-1.5, 1.7, 4 * LANES) for s in start(I, 2.4 * M3, M3)]
    begin = [begin[i] for i in np.linspace(0, len(begin) - 1, LANES).astype(int)]
    x0 = top.state(M=[s[0] for s in begin], P=[s[1] for s in begin])
    run = kr.simulate(top, x0, dt=0.05, steps=STEPS, order=2 if SMALL else 4)
    cut = analysis.section(run, lambda M, P, I=I: peak(M, P, I), rising=False)
    at = np.stack([np.arctan2(cut.P[:, 1], cut.P[:, 0]), cut.M[:, 2]], -1)
    lanes = cut.lane.values
    cells = np.floor((at + np.array((np.pi, 3))) / (2 * np.pi / 40, 6 / 120)).astype(int)
    fill = [len(np.unique(cells[lanes == lane], axis=0)) for lane in range(LANES)]
    drop = max(np.ptp(at[lanes == lane, 1]) for lane in range(LANES))
    spread[name], cuts[name] = (max(fill), drop), (at, lanes)
    energy = abs(run.energy - run.energy[0]).max()
    print(f"{name}: {len(at):,} points; the fullest motion visits {max(fill)} cells; M3 ranges over {drop:.1e}; "
          f"energy within {float(energy):.0e}")  # fmt: skip
regular, chaotic = spread.values()
assert regular[1] < 1e-11 and chaotic[1] > 0.5  # M3 is an integral, and is none
assert chaotic[0] > (1.5 if SMALL else 4) * regular[0]

with figure("light", 9.4, 4.2) as (made, theme):
    for axes, (name, (at, lanes)) in zip(made.subplots(1, 2, sharey=True), cuts.items(), strict=True):
        for lane in range(LANES):
            colour = theme.colours[lane % 7]
            axes.plot(*at[lanes == lane].T, ".", markersize=3.0 if SMALL else 1.8, markeredgewidth=0, color=colour)
        axes.set(xlabel="azimuth of P in the body", title=name)
    made.axes[0].set_ylabel("M₃")
    made.savefig("chaotic_section.png")
