"""A body in a quadratic field, by Suris's map of 2000.

The field is fixed in space, P = g^T A g in the body.  Left: the three axes of the field as the body sees them.  Right:
the largest change of an integral of motion, relative to its size.  The map keeps all of them as they are, with no
correction for the step, and steps of different lengths commute; a good solver of order 8 loses digits all the time.

Source: Suris 2000, Intern. Math. Res. Notices 12; O. I. Bogoyavlensky 1985; named in Suris 2001, Introduction.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
A = np.diag([0.8, -0.3, -0.9])
body = kr.QuadraticPotential(J=(0.5, 0.9, 1.6))
x0 = body.state(M=(0.9, 0.6, 0.5), P=A)


def change(run):
    families = [run[k].values.reshape(len(run.time), -1) for k in ("energy", "spectrum")]
    values = np.concatenate(families, -1)
    return (abs(values - values[0]) / (abs(values[0]) + 1)).max(-1)


def axes_of(P):
    """The eigenvectors of a path of matrices, without jumps of sign; for the eigenvalues from the greatest."""
    vectors = np.linalg.eigh(P)[1][..., ::-1]
    turns = np.sign((vectors[1:] * vectors[:-1]).sum(-2))
    vectors[1:] *= np.cumprod(turns, 0)[:, None]
    return np.moveaxis(vectors, -1, 0)


axes_seen = axes_of(kr.simulate(body, x0, dt=0.02, steps=3_000, method="veselov", order=4).P.values)
steps = 20_000 if SMALL else 200_000
lines = {
    "map, dt = 0.1": kr.simulate(body, x0, dt=0.1, steps=steps, every=steps // 400, method="veselov"),
    "map, dt = 0.4": kr.simulate(body, x0, dt=0.4, steps=steps // 4, every=steps // 1600, method="veselov"),
    "DOP853": kr.simulate(body, x0, dt=0.1, steps=2_000 if SMALL else 20_000, every=20, method="dop853"),
}
worst = {name: float(change(line).max()) for name, line in lines.items()}
print(*(f"{name}: {value:.1e}" for name, value in worst.items()), sep="\n")
assert max(worst["map, dt = 0.1"], worst["map, dt = 0.4"]) < 1e-12 < 10 * worst["DOP853"]

M, P = (x0[k] for k in ("M", "P"))
ab, ba = (body.step(*body.step(M, P, eps=a), eps=b) for a, b in ((0.1, 0.4), (0.4, 0.1)))
apart = max(abs(x - y).max() for x, y in zip(ab, ba, strict=True))
print(f"steps of 0.1 and 0.4 in either order: {apart:.1e} apart")
assert apart < 1e-14

with figure("light", 9.6, 3.2) as (made, theme):
    for place, (path, strength) in enumerate(zip(axes_seen, np.diag(A), strict=True)):
        axes = made.add_subplot(1, 5, place + 1, projection="3d")
        axes.plot(*path.T, color=theme.colours[place], linewidth=0.4)
        axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
        axes.set_box_aspect((1, 1, 1), zoom=1.5)
        axes.set_axis_off()
        axes.set_title(f"axis of {strength:+g}", y=1.02)
    right = made.add_subplot(1, 5, (4, 5))
    for number, (name, line) in enumerate(lines.items()):
        right.loglog(line.time[1:], np.maximum(change(line)[1:], 1e-17), color=theme.colours[number], label=name)
    right.set(xlabel="time", title="largest relative change of an integral")
    right.legend(loc="center right")
    made.savefig("quadratic_field.png")
