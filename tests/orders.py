"""Orders of methods, measured by their compiled kernels."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.graph.recording import flat_constants, flat_stages
from kreisel.kernels.cpu import CpuEngine
from kreisel.lab.exact import jacobian
from kreisel.lab.law import errors_of, flat_start, solutions
from kreisel.method import scheme
from kreisel.method.scheme import ORIENTATION
from kreisel.record.model import Model
from sizes import FULL

Array = Any
COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)  # steps in a unit of time
TIMES = (1, 2, 4, 8) if FULL else (1, 2, 4)
RATE, LONGEST = 3.0, 8.0  # of a unit of time
WINDOW, LARGEST = 4, 1e-1  # successive steps; beyond such errors there is no order
PLATEAU, FAR = 3e-13, 3  # errors of rounding; how far above the measured ones an error is the method's
NEARBY = (7.5, 7, 6.5, 6, 5.5, 5)  # times the finest count: ends that differ from the method's own by rounding
SOLVER_ERROR = 1e-11


def scheme_orders(model: Model, state: tuple[Array, ...], method: str, order: int) -> list[float]:
    """Slopes for a method with a step, by its compiled kernel, where the error is closest to a power of dt.

    Errors at several times and for many steps are taken against the method's own end with an eighth of the finest
    step, whose distance from the solver's end is added unless the solver may be to blame.  At each time the finest
    WINDOW successive steps are taken whose errors are FAR above rounding, which a motion that is not regular
    amplifies, and below LARGEST; of these the one counts whose first and last ones have the closest slopes, for the
    state and for the orientation each: high orders set in late.
    The unit of time is that of the fastest motion near the start, from the flow's Jacobian, and at most LONGEST.
    """
    tangent = jacobian(model.flow, state, model.system.space.kinds, model.n)[1].astype(float)
    unit = min(LONGEST, RATE / float(abs(np.linalg.eigvals(tangent)).max()))
    slopes: list[list[tuple[float, float]]] = [[], []]  # of state and orientation: how far apart halves are, slope
    end = _Ends(model, state, method, order)
    truths = solutions(model, flat_start(model, state).tobytes(), tuple(factor * unit for factor in TIMES))
    for factor, truth in zip(TIMES, truths, strict=True):
        time, counts = factor * unit, [factor * k for k in COUNTS]
        finest = end(time, 8 * counts[-1])
        apart = errors_of(model, truth, [finest])[0]
        ends = [end(time, count) for count in counts]
        rounding = errors_of(model, finest, [end(time, int(k * counts[-1])) for k in NEARBY]).max(0)
        errors = errors_of(model, finest, ends) + np.where(apart > SOLVER_ERROR, apart, 0)
        logs, steps = np.log(np.maximum(errors, 1e-300)), np.log(time / np.array(counts))
        floors = np.log(np.maximum(PLATEAU, FAR * rounding))
        for fits, e, floor in zip(slopes, logs.T, floors, strict=True):
            for first in reversed(range(len(counts) - WINDOW + 1)):
                x, y = (v[first : first + WINDOW] for v in (steps, e))
                if y.min() > floor and y.max() < np.log(LARGEST):
                    early, late = (np.polyfit(x[i], y[i], 1)[0] for i in (slice(WINDOW - 1), slice(1, None)))
                    fits.append((abs(float(early - late)), float(np.polyfit(x, y, 1)[0])))
                    break
    return [min(fits, default=(0.0, float("nan")))[1] for fits in slopes]


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
        kernel.z[:], kernel.constants[:], kernel.stages[:] = z, flat_constants(plan, 1)[0], flat_stages(plan, 1)[0]
        kernel.advance(np.empty((1, *z.shape)), count)
        end = plan.observe(algebra.restore(kernel.z[0], kinds, model.n))
        g = algebra.rotation_matrix(end[ORIENTATION]) if model.n == 3 else end[ORIENTATION]
        space = model.system.space
        return algebra.flatten((*(end[letter] for letter in space.letters), g), (*space.kinds, "matrix"))
