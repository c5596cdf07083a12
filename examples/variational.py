"""A heavy top that is not integrable, for a million steps: the energy by the variational integrator and by RK4.

Usage: python variational.py [FOLDER]; the figure goes to FOLDER, else to the current folder.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import kreisel as kr
from kreisel import algebra
from kreisel.kernels.cpu import CpuEngine
from kreisel.method import scheme
from kreisel.method.scheme import Steps
from kreisel.record.calling import call

DT, STEPS, EVERY = 0.05, 1_000_000, 250
TOP = kr.HeavyTop(J=(0.6, 0.9, 1.4), A=(0.3, -0.2, 0.9))
START = {"M": (0.5, 1.0, 2.0), "P": (0.6, 0.0, 0.8)}


def rk4() -> tuple[np.ndarray, np.ndarray]:
    """Energy and |P|^2 by the classical Runge-Kutta method with the same step, compiled like every scheme."""

    def step(M, P, *, dt, **constants):
        def rate(k, share):
            return call(TOP.system.flow, (M + share * dt * k[0], P + share * dt * k[1]), constants)

        k1 = rate((0 * M, 0 * P), 0)
        k2 = rate(k1, 1 / 2)
        k3 = rate(k2, 1 / 2)
        k4 = rate(k3, 1)
        slopes = zip(k1, k2, k3, k4, strict=True)
        return tuple(z + dt / 6 * (a + 2 * b + 2 * c + d) for z, (a, b, c, d) in zip((M, P), slopes, strict=True))

    flow = scheme(TOP, "dop853", DT, None, False)
    plan = replace(flow, motion=Steps(step), constants={**flow.constants, "dt": DT}, axes={**flow.axes, "dt": 0})
    kinds = plan.kinds
    start = algebra.flatten(tuple(TOP.state(**START).values()), kinds)
    rows = np.empty((STEPS // EVERY + 1, 1, 6))
    rows[0] = start
    CpuEngine(plan, start[None]).advance(rows[1:], EVERY)
    M, P = algebra.restore(rows[:, 0], kinds, 3)
    return TOP.call(TOP.system.energy, M, P), (P * P).sum(-1)


def main() -> None:
    import matplotlib.pyplot as plt

    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path()
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained", sharex=True)
    changes = {}
    for order in (2, 4):
        begun = time.perf_counter()
        run = kr.simulate(
            TOP, START, dt=DT, steps=STEPS, every=EVERY, method="variational", order=order, progress=False
        )
        energy = run.energy.values
        changes[f"variational, order {order}"] = energy - energy[0], run.casimir.values[:, 0] - run.casimir.values[0, 0]
        print(f"variational, order {order}: {STEPS:,} steps of {DT} in {time.perf_counter() - begun:.2f} s")
    energy, square = rk4()
    changes["RK4"] = energy - energy[0], square - square[0]
    times = run.time.values
    for (name, (dE, dC)), colour in zip(changes.items(), ("C0", "C2", "C3"), strict=True):
        half = len(dE) // 2
        trend = abs(dE[half:].mean() - dE[:half].mean())
        print(f"{name}: energy changes by up to {abs(dE).max():.1e}, its mean from half to half by {trend:.1e}; "
              f"|P|^2 by up to {abs(dC).max():.1e}")  # fmt: skip
        for axis, change in zip(axes, (dE, dC), strict=True):
            axis.semilogy(times[1:], np.maximum(abs(change[1:]), 1e-17), ".", ms=1.5, color=colour, label=name)
    for axis, title in zip(axes, ("energy", "Casimir $|P|^2$"), strict=True):
        axis.set(title=f"|change| of the {title}", xlabel="time", ylim=(1e-17, 10))
    axes[0].legend(markerscale=6, loc="lower right")
    path = folder / "variational.png"
    figure.savefig(path, dpi=150)
    print(f"figure: {path}")


if __name__ == "__main__":
    main()
