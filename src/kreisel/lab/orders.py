"""Orders of a map, measured."""

from __future__ import annotations

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.contract import Frame
from kreisel.engines import layout
from kreisel.model import Model


def measured_orders(
    model: Model,
    state: tuple[Array, ...],
    conjugate: bool,
    time: float = 0.5,
    counts: tuple[int, ...] = (64, 128, 256, 512),
) -> list[float]:
    """Slopes of log error against log dt for the state and the orientation, over four steps."""
    from scipy.integrate import solve_ivp

    n, system, space = model.n, model.system, model.system.space
    g0 = np.eye(n)
    kinds = (*space.kinds, "matrix")

    def rate(t: float, y: Array) -> Array:
        *own, g = layout.restore(y, kinds, n)
        omega = model.call(system.velocity, *own)
        return layout.flatten((*model.flow(*own), omega @ g if system.frame is Frame.REST else g @ omega), kinds)

    start = layout.flatten((*state, g0), kinds)
    truth = solve_ivp(rate, (0, time), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    count_own = len(start) - n * n
    errors = []
    for count in counts:
        end = layout.flatten(_iterate(model, state, g0, time / count, count, conjugate), kinds)
        errors.append([abs(end - truth)[:count_own].max(), abs(end - truth)[count_own:].max()])
    steps = np.log(time / np.array(counts))
    return [float(np.polyfit(steps, np.log(np.array(errors)[:, i]), 1)[0]) for i in (0, 1)]


def _iterate(
    model: Model, state: tuple[Array, ...], g: Array, dt: float, count: int, conjugate: bool
) -> tuple[Array, ...]:
    state = model.call(model.map.from_symmetric, *state, eps=dt) if conjugate else state
    for _ in range(count):
        new = model.call(model.map.step, *state, eps=dt)
        X = model.call(model.map.generator, *state, *new, eps=dt)
        g = algebra.turn_left(X, g) if model.system.frame is Frame.REST else algebra.turn_right(g, X)
        state = new
    return (*(model.call(model.map.to_symmetric, *state, eps=dt) if conjugate else state), g)
