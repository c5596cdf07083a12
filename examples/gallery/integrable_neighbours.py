"""Integrable bodies beside neighbours that have lost their integrals.

Manakov's top in four dimensions, Steklov and Lyapunov's body in a fluid in four dimensions, and Kovalevskaya's gyrostat
in two fields.  In the lower row one coefficient of the Hamiltonian is changed: the integrals, which were conserved to
the digits of the solver, change by 0.01 and more.  The path of the gyrostat then fills the sphere; Manakov's top finds
another torus.  so(4) falls into two spheres, on one of which M or P is shown.  Right: the Lagrange top on SU(2) by the
map of 1999; the integrals of the flow swing with the step, those of the map do not change.

Source: Suris 2001, Introduction and Conclusions; S. V. Manakov 1976; A. Bolsinov, Y. Fedorov 1992; A. I. Bobenko,
A. G. Reyman, M. A. Semenov-Tian-Shansky 1989; A. I. Bobenko, Y. B. Suris 1999.
"""

import os

import numpy as np
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.record.calling import call
from kreisel.system import ratiu_bitop
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
T = 8.0 if SMALL else 240.0
skew = lambda *x: algebra.skew(np.array(x), 4)  # noqa: E731
half = lambda X: ratiu_bitop.halves(X)[0]  # noqa: E731
rolled = lambda x: x  # noqa: E731
CASES = {  # the model, a state, the constant that is changed and by what, what is drawn, an integral
    "Manakov's top": (
        kr.ManakovTop(a=(1.0, 2.0, 3.5, 5.0), b=(0.2, 1.5, 1.9, 4.0)),
        {"M": skew(1.0, -0.6, 0.4, 0.8, -0.5, 0.9)},
        ("c", (0, 1), 1.6),
        ("M", half),
        "spectrum",
    ),
    "Steklov and Lyapunov": (
        kr.SteklovLyapunov(b=(0.4, 1.0, 1.7, 2.5), s=0.5, l=0.5),
        {"M": skew(0.6, -0.3, 0.5, 0.2, -0.4, 0.8), "P": skew(0.3, 0.8, -0.2, 0.4, 0.5, 0.1)},
        ("x", (0, 1), 4.0),
        ("P", half),
        "traces",
    ),
    "gyrostat in two fields": (
        kr.KovalevskayaGyrostat(n=3, gamma=0.6),
        {
            "M": algebra.hat(np.array([0.5, 0.9, 0.4])),
            "P": np.array([0.48, 0.6, 0.64]),
            "Q": np.array([0.3, -0.5, 0.2]),
        },
        ("c", (0, 1), 0.7),
        ("P", rolled),
        "spectrum",
    ),
}


def motion(model, state, times, spoiled=None):
    """The motion by DOP853, with one constant of the flow changed if asked for; the states by letter."""
    letters, constants = tuple(state), dict(model.constants)
    if spoiled is not None:
        name, (i, j), factor = spoiled
        changed = np.array(constants[name], dtype=float)
        changed[i, j] = changed[j, i] = factor * changed[i, j]
        constants[name] = changed
    shapes = [np.shape(v) for v in state.values()]
    edges = np.cumsum([0, *(int(np.prod(s)) for s in shapes)])
    parts = lambda y: [y[a:b].reshape(s) for a, b, s in zip(edges[:-1], edges[1:], shapes, strict=True)]  # noqa: E731

    def rate(_, y):
        return np.concatenate([np.ravel(v) for v in call(model.system.flow, parts(y), constants)])

    start = np.concatenate([np.ravel(v) for v in state.values()])
    path = solve_ivp(rate, (0, times[-1]), start, t_eval=times, method="DOP853", rtol=1e-11, atol=1e-12).y.T
    return {k: np.stack(v) for k, v in zip(letters, zip(*map(parts, path), strict=True), strict=True)}


times = np.arange(0, T, 0.02)
with figure("light", 9.6, 4.8) as (made, theme):
    for column, (name, (model, state, spoiled, (letter, drawn), integral)) in enumerate(CASES.items()):
        moves = []
        for row, fault in enumerate((None, spoiled)):
            path = motion(model, state, times, fault)
            values = np.array(
                [model.call(model.system.integrals[integral], *x) for x in zip(*path.values(), strict=True)][::100]
            )
            moves.append(float((abs(values - values[0]) / (1 + abs(values[0]))).max()))
            axes = made.add_subplot(2, 4, 4 * row + column + 1, projection="3d")
            axes.plot(*drawn(path[letter]).T, color=theme.colours[column], linewidth=0.25)
            radius = np.linalg.norm(drawn(path[letter])[0])
            axes.set(xlim=(-radius, radius), ylim=(-radius, radius), zlim=(-radius, radius))
            axes.set_box_aspect((1, 1, 1), zoom=1.4)
            axes.set_axis_off()
            axes.set_title(name if row == 0 else "its neighbour", y=1.0)
        print(f"{name:24s} the integrals change by {moves[0]:.1e}, those of its neighbour by {moves[1]:.1e}")
        assert moves[0] < 1e-7 and moves[1] > 1e-2

    top = kr.LagrangeTopSU2(p=(0.0, 0.0, 1.0))
    x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0.0, 0.8))
    for row, dt in enumerate((0.1, 0.4)):
        run = kr.simulate(top, x0, dt=dt, steps=int(60 / dt), method="suris")
        axes = made.add_subplot(2, 4, 4 * row + 4)
        for number, (family, label) in enumerate((("squares", "of the flow"), ("squares_eps", "of the map"))):
            moved = abs(run[family].values - run[family].values[0]).max(-1)
            assert moved.max() < 1e-13 if family == "squares_eps" else moved.max() > 0.1 * dt**2
            axes.semilogy(
                run.time[1:], np.maximum(moved[1:], 1e-17), color=theme.colours[number], linewidth=0.7, label=label
            )
        axes.set(
            ylim=(1e-17, 10),
            title=f"top on SU(2), step {dt}",
            xlabel="time" if row else "",
            ylabel="change of the integrals",
        )
        axes.legend(loc="center right")
    made.savefig("integrable_neighbours.png")
