"""A million turns: the exact flow, a map that keeps every integral, and RK4.

A Lagrange top spins 10^6 times about its axis.  Left: how far the axis is from where it should be, by the closed form
at each time (`kr.at`).  At equal order 4 and equal step the error of RK4 grows faster than the time, in the end like
its square, because its energy (right) drifts; that of the map grows linearly, and its energy stays.  Of order 8 the map
is still right at the end.  The exact flow has no error that grows.

Source: docs/exact.md and docs/baecklund.md of this project; RK4 with the same step, compiled as every scheme is.
"""

import math
import os
from dataclasses import replace

import numpy as np

import kreisel as kr
from kreisel import algebra
from kreisel.kernels.cpu import CpuEngine
from kreisel.method import scheme
from kreisel.method.scheme import Steps
from kreisel.record.calling import call
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
SPIN, DT = 1.5, 0.1
TURNS = 20_000 if SMALL else 1_000_000
ROWS = 400
EVERY = int(TURNS * 2 * math.pi / SPIN / DT / ROWS)
top = kr.LagrangeTop(p=(0, 0, 1))
x0 = top.state(m=(0.9 + 0.1, 0.2, 1.2), a=(0.6, 0, 0.8))


def rk4(z0, dt, rows, every):
    """States (rows, 6) by the classical Runge-Kutta method."""

    def step(m, a, *, dt, **constants):
        def rate(k, share):
            return call(top.system.flow, (m + share * dt * k[0], a + share * dt * k[1]), constants)

        k1 = rate((0 * m, 0 * a), 0)
        k2 = rate(k1, 1 / 2)
        k3 = rate(k2, 1 / 2)
        k4 = rate(k3, 1)
        slopes = zip(k1, k2, k3, k4, strict=True)
        return tuple(z + dt / 6 * (p + 2 * q + 2 * r + s) for z, (p, q, r, s) in zip((m, a), slopes, strict=True))

    flow = scheme(top, "dop853", dt, None, False)
    plan = replace(flow, motion=Steps(step), constants={**flow.constants, "dt": dt}, axes={**flow.axes, "dt": 0})
    kinds = plan.kinds
    start = algebra.flatten(tuple(z0.values()), kinds)
    out = np.empty((rows + 1, 1, 6))
    out[0] = start
    CpuEngine(plan, start[None]).advance(out[1:], every)
    return algebra.restore(out[:, 0], kinds, 3)


# densely at first, then to the end: (time, distance, |energy change|) of each method
exact = {every: kr.at(top, x0, np.arange(ROWS + 1) * every * DT) for every in (10, EVERY)}
found = {}
for name, order in (("baecklund, order 4", 4), ("baecklund, order 8", 8)):
    pieces = []
    for every, truth in exact.items():
        run = kr.simulate(top, x0, dt=DT, steps=ROWS * every, every=every, order=order)
        gap = np.linalg.norm(run.a.values - truth.a.values, axis=-1)
        pieces.append((run.time.values[1:], gap[1:], abs(run.energy.values - run.energy.values[0])[1:]))
    found[name] = [np.concatenate(p) for p in zip(*pieces, strict=True)]
pieces = []
for every, truth in exact.items():
    m, a = rk4(x0, DT, ROWS, every)
    energy = top.call(top.system.energy, m, a)
    gap = np.linalg.norm(a - truth.a.values, axis=-1)
    pieces.append((truth.time.values[1:], gap[1:], abs(energy - energy[0])[1:]))
found["RK4"] = [np.concatenate(p) for p in zip(*pieces, strict=True)]
# the closed form, once more but from the middle of the run: what its own rounding does
middle = {letter: exact[EVERY][letter].values[ROWS // 2] for letter in ("m", "a")}
later = kr.at(top, middle, exact[EVERY].time.values[ROWS // 2 :] - exact[EVERY].time.values[ROWS // 2])
start = exact[EVERY].energy.values
gap = np.linalg.norm(later.a.values - exact[EVERY].a.values[ROWS // 2 :], axis=-1)

for name, (time, distance, change) in found.items():
    print(
        f"{name}: distance {distance[-1]:.1e}, energy off by {change.max():.1e} "
        f"after {time[-1] * SPIN / 2 / math.pi:.0f} turns"
    )
print(f"exact: energy off by {abs(start - start[0]).max():.1e}; begun again in the middle {gap.max():.1e} apart")
low, high = found["baecklund, order 4"], found["baecklund, order 8"]
assert max(low[2].max(), high[2].max()) < 1e-10 and abs(start - start[0]).max() < 1e-13
assert found["RK4"][2].max() > (1e-3 if SMALL else 1e-2)
growth = {name: np.polyfit(np.log(d[0][:ROWS]), np.log(d[1][:ROWS]), 1)[0] for name, d in found.items()}
print("distance ~ time^k in the first turns, k =", {name: round(float(k), 2) for name, k in growth.items()})
assert growth["RK4"] > 1.5 and max(growth["baecklund, order 4"], growth["baecklund, order 8"]) < 1.3
assert high[1].max() < 1e-2 * found["RK4"][1].max()

with figure("light", 9.2, 3.8) as (made, theme):
    left, right = made.subplots(1, 2)
    for (name, (time, distance, change)), colour in zip(found.items(), theme.colours, strict=False):
        turns = time * SPIN / (2 * math.pi)
        left.loglog(turns, np.maximum(distance, 1e-17), ".", markersize=2, color=colour)
        right.loglog(turns, np.maximum(change, 1e-17), ".", markersize=2, color=colour, label=name)
    turns = exact[EVERY].time.values * SPIN / (2 * math.pi)
    exactly = np.maximum(abs(start - start[0])[1:], 1e-17)
    right.loglog(turns[1:], exactly, ".", markersize=2, color=theme.faint, label="exact (kr.at)")
    left.set(xlabel="turns", title="distance of the axis from the exact flow", ylim=(1e-17, 10))
    right.set(xlabel="turns", title="|change| of the energy", ylim=(1e-17, 10))
    right.legend(markerscale=5, loc="center right")
    made.savefig("million_turns.png")
