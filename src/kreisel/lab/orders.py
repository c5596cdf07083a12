"""Orders of maps and methods, measured."""

from __future__ import annotations

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.kernels.cpu import CpuEngine
from kreisel.kernels.recording import flat_constants, flat_stages
from kreisel.lab.exact import jacobian
from kreisel.method import scheme
from kreisel.method.observing import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.model import Model

COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)  # steps in a unit of time
TIMES = (1, 2, 4, 8)
RATE, LONGEST = 3.0, 8.0  # of a unit of time
WINDOW, LARGEST = 4, 1e-1  # successive steps; beyond such errors there is no order
PLATEAU, FAR = 3e-13, 3  # errors of rounding; how far above those that are measured an error is one of the method
NEARBY = (7.5, 7, 6.5, 6, 5.5, 5)  # times the finest count: ends that differ from the method's own by rounding
SOLVER_ERROR = 1e-11


def measured_orders(
    model: Model,
    state: tuple[Array, ...],
    conjugate: bool,
    time: float = 0.5,
    counts: tuple[int, ...] = (64, 128, 256, 512),
) -> list[float]:
    """Slopes of log error against log dt for the state and the orientation, over four steps."""
    g0, kinds = np.eye(model.n), (*model.system.space.kinds, "matrix")
    ends = [algebra.flatten(_iterate(model, state, g0, time / k, k, conjugate), kinds) for k in counts]
    return fitted_orders(time / np.array(counts), _errors(model, _truth(model, state, time), ends))


def scheme_orders(model: Model, state: tuple[Array, ...], method: str, order: int) -> list[float]:
    """The same of a method with a step, by its compiled kernel, where the error is closest to a power of dt.

    Errors at several times and for many steps are taken against the method's own end with an eighth of the finest
    step, whose distance from the solver's end is added unless the solver may be to blame.  At each time the finest
    WINDOW successive steps are taken whose errors are FAR above those of rounding, which a motion that is not regular
    amplifies, and below LARGEST; of these the one counts whose first and last ones have the closest slopes, for the
    state and for the orientation each: high orders set in late.
    The unit of time is that of the fastest motion near the start, from the flow's Jacobian, and at most LONGEST.
    """
    slope = jacobian(model.flow, state, model.system.space.kinds, model.n)[1].astype(float)
    unit = min(LONGEST, RATE / float(abs(np.linalg.eigvals(slope)).max()))
    found: list[list[tuple[float, float]]] = [[], []]
    end = _Ends(model, state, method, order)
    for factor in TIMES:
        time, counts = factor * unit, [factor * k for k in COUNTS]
        own = end(time, 8 * counts[-1])
        apart = _errors(model, _truth(model, state, time), [own])[0]
        ends = [end(time, count) for count in counts]
        rounding = _errors(model, own, [end(time, int(k * counts[-1])) for k in NEARBY]).max(0)
        errors = _errors(model, own, ends) + np.where(apart > SOLVER_ERROR, apart, 0)
        logs, steps = np.log(np.maximum(errors, 1e-300)), np.log(time / np.array(counts))
        floors = np.log(np.maximum(PLATEAU, FAR * rounding))
        for of_part, e, floor in zip(found, logs.T, floors, strict=True):
            for first in reversed(range(len(counts) - WINDOW + 1)):
                here, half = slice(first, first + WINDOW), WINDOW - 1
                if e[here].min() > floor and e[here].max() < np.log(LARGEST):
                    parts = (slice(half), slice(-half, None))
                    halves = [np.polyfit(steps[here][part], e[here][part], 1)[0] for part in parts]
                    slope = float(np.polyfit(steps[here], e[here], 1)[0])
                    of_part.append((abs(float(halves[0] - halves[1])), slope))
                    break
    return [min(of_part, default=(0.0, float("nan")))[1] for of_part in found]


class _Ends:
    """Ends of runs with different steps, by one compiled kernel whose constants are exchanged."""

    def __init__(self, model: Model, state: tuple[Array, ...], method: str, order: int):
        self._model, self._method, self._order = model, method, order
        self._start = (*state, np.array([1.0, 0, 0, 0]) if model.n == 3 else np.eye(model.n))
        self._kernel: CpuEngine | None = None

    def __call__(self, time: float, count: int) -> Array:
        model = self._model
        plan = scheme(model, self._method, time / count, self._order, oriented=True)
        kinds = [kind for _, kind in plan.components]
        z = np.asarray(algebra.flatten(plan.prepare(self._start), kinds))[None]
        kernel = self._kernel = self._kernel or CpuEngine(plan, z)
        kernel.z, (kernel.constants, _), (kernel.stages, _) = z, flat_constants(plan, 1), flat_stages(plan, 1)
        kernel.advance(np.empty((1, *z.shape)), count)
        end = plan.observe(algebra.restore(kernel.z[0], kinds, model.n))
        g = algebra.rotation_matrix(end[ORIENTATION]) if model.n == 3 else end[ORIENTATION]
        space = model.system.space
        return algebra.flatten((*(end[letter] for letter in space.letters), g), (*space.kinds, "matrix"))


def baecklund_orders(
    model: Model, state: tuple[Array, ...], order: int, counts: tuple[int, ...], time: float = 0.5
) -> list[float]:
    """The slopes of `measured_orders` for method="baecklund" of that order, by its definition."""
    from kreisel.method.baecklund import baecklund

    def end(count: int) -> Array:
        z = (*state, np.array([1.0, 0, 0, 0]) if model.n == 3 else np.eye(model.n))
        plan = baecklund(model, time / count, order, oriented=True).on(z)
        for _ in range(count):
            z = plan.advance(*z)
        z = (*z[:-1], algebra.rotation_matrix(z[-1])) if model.n == 3 else z
        return algebra.flatten(z, (*model.system.space.kinds, "matrix"))

    return fitted_orders(time / np.array(counts), _errors(model, _truth(model, state, time), [end(k) for k in counts]))


def flowed(model: Model, state: tuple[Array, ...], time: float) -> tuple[Array, ...]:
    """The state after that time, by DOP853 to round-off."""
    return algebra.restore(_truth(model, state, time), (*model.system.space.kinds, "matrix"), model.n)[:-1]


def _truth(model: Model, state: tuple[Array, ...], time: float) -> Array:
    """The state and the orientation at `time` by a solver with rtol 1e-13."""
    from scipy.integrate import solve_ivp

    n, system = model.n, model.system
    kinds = (*system.space.kinds, "matrix")

    def rate(t: float, y: Array) -> Array:
        *own, g = algebra.restore(y, kinds, n)
        omega = model.call(system.velocity, *own)
        return algebra.flatten((*model.flow(*own), omega @ g if system.frame is Frame.REST else g @ omega), kinds)

    start = algebra.flatten((*state, np.eye(n)), kinds)
    return solve_ivp(rate, (0, time), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def _errors(model: Model, truth: Array, ends: list[Array]) -> Array:
    """Of the states and of the orientations."""
    own = len(truth) - model.n * model.n
    return np.array([[abs(end - truth)[:own].max(), abs(end - truth)[own:].max()] for end in ends])


def fitted_orders(steps: Array, errors: Array) -> list[float]:
    """Slopes of log error against log step."""
    return [float(np.polyfit(np.log(steps), np.log(errors[:, i]), 1)[0]) for i in range(errors.shape[1])]


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
