"""Neumann's particle on the sphere, and the caustics that it never crosses.

In ellipsoidal coordinates, the roots u of sum x_i^2/(u - b_i) = 0, the motion separates: each swings between bounds,
which are roots of sum F_i/(u - b_i) = 0 or entries of b, with the integrals F_i of Uhlenbeck.  The curves u = bound,
spherical conics, are the caustics: the path touches them again and again and is never beyond.

Source: J. Moser, Various aspects of integrable Hamiltonian systems, 1980; Suris 2001, section 7.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
b = np.array((0.0, 1.0, 2.5))
model = kr.Neumann(b=b)
run = kr.simulate(
    model, model.state(x=(0.6, 0, 0.8), q=(0.48, 0.9, -0.36)), dt=0.02, steps=20_000 if SMALL else 120_000
)
x, q = run.x.values, run.q.values


def roots(weights):
    """The two roots u of sum w_i/(u - b_i) = 0, ascending."""
    w = np.moveaxis(np.asarray(weights), -1, 0)
    quadratic = [w.sum(0), -sum(w[i] * (b.sum() - b[i]) for i in range(3)), sum(w[i] * b.prod() / b[i] if b[i] else
                 w[i] * np.prod(np.delete(b, i)) for i in range(3))]  # fmt: skip
    half = -quadratic[1] / (2 * quadratic[0])
    gap = np.sqrt(np.maximum(half**2 - quadratic[2] / quadratic[0], 0))
    return np.stack([half - gap, half + gap], -1)


K = x[:, :, None] * q[:, None, :] - x[:, None, :] * q[:, :, None]
gaps = b[:, None] - b[None, :] + np.eye(3)
F = x**2 - (K**2 / gaps).sum(-1)  # potential -<x, Bx>/2
print(f"Uhlenbeck's integrals change by up to {abs(F - F[0]).max():.1e}")
assert abs(F - F[0]).max() < 1e-12
bounds, u = roots(F[0]), roots(x**2)
low, high = u.min(0), u.max(0)
edges = np.sort(np.concatenate([b, bounds]))
print(f"caustics at u = {bounds}, the path between {low} and {high}")
for value in (*low, *high):  # it comes as near as the steps allow to a root or an entry of b
    assert abs(edges - value).min() < 2e-3
inside = [(edges[:-1] - 1e-9 <= lo) & (hi <= edges[1:] + 1e-9) for lo, hi in zip(low, high, strict=True)]
assert all(each.any() for each in inside)  # each coordinate stays between two neighbours

with figure("light", 5.6, 5.0) as (made, theme):
    axes = made.add_subplot(projection="3d")
    axes.plot(*x[:60_000].T, color=theme.colours[5], linewidth=0.35)
    for number, bound in enumerate(bounds):
        for other in (np.linspace(b[0], b[1], 200), np.linspace(b[1], b[2], 200)):
            squares = np.stack([(bound - b[i]) * (other - b[i]) / np.prod(b[i] - np.delete(b, i)) for i in range(3)])
            if squares.min() < -1e-9:
                continue
            curve = np.sqrt(np.maximum(squares, 0))
            for signs in np.ndindex(2, 2, 2):
                axes.plot(*(curve * (1 - 2 * np.array(signs))[:, None]), color=theme.colours[1 + number], linewidth=1.8)
    axes.set_box_aspect((1, 1, 1), zoom=1.35)
    axes.set_axis_off()
    axes.view_init(elev=24, azim=-50)
    axes.set_title("Neumann's particle between its caustics", y=0.98)
    made.savefig("neumann_caustics.png")
