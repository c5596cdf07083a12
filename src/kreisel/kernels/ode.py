"""The library's integrators, behind the same two names as a compiled kernel: `z` and `advance`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.errors import RunError
from kreisel.graph.recording import flat_constants
from kreisel.kernels.cpu import compiled_rate
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.method.scheme import WORK, Scheme

# all that the next step and the dense output of scipy.integrate.DOP853 depend on
SOLVER = ("t", "y", "t_old", "y_old", "h_abs", "h_previous", "f", "K_extended")
FIRST = ("h_abs", "f")  # of which, with the start, the first step depends: SciPy computes it
# of the solver within one dt: a step of it is 0.4 radians of the fastest rotation and needs 0.1 ms
MOST_STEPS = 10_000
LEAST = 1e-300  # of an absolute tolerance
NO_NUMBER = "a force that is not a number there (log or sqrt of a negative number, a division by 0)"

Rate = Callable[[float, Floats, Floats], Floats]


def _bound(rate: Rate, constants: Floats) -> Callable[[float, Floats], Floats]:
    return lambda t, y: rate(t, y, constants)


def _together(scheme: Scheme, rate: Rate, constants: Floats) -> Callable[[float, Floats], Floats]:
    """The rates of lanes that act on each other, one after the other in one array."""
    from kreisel.kernels.coupled import compiled_pulls

    pulls, lanes = compiled_pulls(scheme, len(constants)), len(constants)

    def rates(t: float, y: Floats) -> Floats:
        z = y.reshape(lanes, -1)
        out = np.array([rate(t, row, entries) for row, entries in zip(z, constants, strict=True)])
        forces = pulls(z)
        of_state = forces.shape[1] - (scheme.components[-1][0] == WORK)
        out[:, :of_state] += forces[:, :of_state]
        out[:, out.shape[1] - (forces.shape[1] - of_state) :] += forces[:, of_state:]
        return out.ravel()

    return rates


def _tolerances(f: Callable[[float, Floats], Floats], y: Floats, scheme: Scheme, dt: float) -> dict[str, Any]:
    """rtol, and atol (d,), at most rtol times the length of a component at y, or of its change within dt if longer.

    The change is also taken at a state of these lengths in general position: near an equilibrium a torque is rounding.
    """
    places = algebra.slices(scheme.kinds, scheme.n)
    lanes, generic = len(y) // places[-1].stop, np.cos(np.arange(1.0, places[-1].stop + 1))

    def lengths(x: Floats) -> Floats:
        rows = x.reshape(lanes, -1)
        return np.concatenate([np.full(row[p].shape, math.hypot(*row[p])) for row in rows for p in places])

    at = lengths(y)
    moved = at * np.tile(generic, lanes) / lengths(np.tile(generic, lanes))
    sizes = np.fmax.reduce([at, dt * lengths(f(0.0, y)), dt * lengths(f(0.0, moved))])
    rtol, atol = scheme.options["rtol"], scheme.options["atol"]
    return {"rtol": rtol, "atol": np.where(sizes > 0, np.clip(rtol * sizes, LEAST, atol), atol)}


def _compiled(scheme: Scheme, lanes: int) -> Rate:
    if scheme.recordable:
        return compiled_rate(scheme, lanes)
    from kreisel.kernels.jax import compiled_rate as by_jax

    return by_jax(scheme)


class ReferenceEngine:
    """SciPy's DOP853, one solver a lane, stopped at each saved time by its dense output.

    Lanes that act on each other have one solver together.
    """

    projection = None

    def __init__(self, scheme: Scheme, z0: Floats, dt: float):
        from scipy.integrate import DOP853

        self.z = np.array(z0, dtype=np.float64)
        self._dt, self._steps = dt, 0
        constants, _ = flat_constants(scheme, len(self.z))
        rate = _compiled(scheme, len(self.z))
        if scheme.coupling is None:
            rates, starts = [_bound(rate, row) for row in constants], self.z.copy()
        else:
            rates, starts = [_together(scheme, rate, constants)], self.z.reshape(1, -1).copy()
        self._counts = [(0.0, 0)] * len(starts)  # for each solver a number of dt and its steps within it
        with np.errstate(all="ignore"):
            self._solvers = [  # each keeps the array that it is given
                DOP853(f, 0.0, start, np.inf, **_tolerances(f, start, scheme, dt))
                for f, start in zip(rates, starts, strict=True)
            ]

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        for row in out:
            self._steps += every
            row[:] = self._at(self._steps * self._dt, look)
            self.z[:] = row

    def between(self, after: float) -> Floats:
        """The state (lanes, d) at a time after the last step of dt."""
        return self._at(self._steps * self._dt + after, no_look)

    def _at(self, t: float, look: Look) -> Floats:
        out = np.empty_like(self.z)
        parts = out.reshape(len(self._solvers), -1)
        with np.errstate(all="ignore"):
            for lane, solver in enumerate(self._solvers):
                parts[lane] = self._to(solver, lane, t, look)
        return out

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        return False

    def snapshot(self) -> dict[str, Floats]:
        out = {"steps": np.asarray(self._steps, dtype=np.float64), "z": self.z}
        for name in SOLVER:
            like = np.full(np.shape(getattr(self._solvers[0], "y" if name == "y_old" else name)), np.nan)
            values = [getattr(solver, name) for solver in self._solvers]
            out[name] = np.array([like if value is None else value for value in values], dtype=np.float64)
        return out

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self._steps, self.z[:] = int(snapshot["steps"]), snapshot["z"]
        for lane, solver in enumerate(self._solvers):
            begun = not np.isnan(snapshot["t_old"][lane])  # before the first step some are not known
            for name in SOLVER if begun else FIRST:
                value = np.array(snapshot[name][lane])
                setattr(solver, name, value if value.ndim else float(value))
            if begun:
                solver.K = solver.K_extended[: len(solver.K)]

    def _to(self, solver: Any, lane: int, t: float, look: Look) -> Floats:
        while solver.t < t:
            look()
            self._require_progress(solver, lane)
            solver.step()
            if solver.status == "failed":
                raise RunError(
                    f"DOP853 expected to continue from time {solver.t:g}{self._of(lane)}, got steps as short as the "
                    f"spacing of doubles. Usual cause: a state so large that its square overflows, {NO_NUMBER}, or a "
                    "time so long that dt is lost in it. Use other units, or a map."
                )
        return solver.y if solver.t == t else solver.dense_output()(t)

    def _require_progress(self, solver: Any, lane: int) -> None:
        if not np.isfinite(solver.h_abs):
            raise RunError(
                f"DOP853 expected a finite step, got {solver.h_abs:g} at time {solver.t:g}{self._of(lane)}: the "
                "right-hand side is not a number, or overflows. Usual cause: a state so large that its square "
                "overflows, "
                f"or {NO_NUMBER}. Use other units."
            )
        before, count = self._counts[lane]
        interval = solver.t // self._dt
        self._counts[lane] = interval, count + 1 if interval == before else 1
        if self._counts[lane][1] > MOST_STEPS:
            raise RunError(
                f"DOP853 expected to cross one dt = {self._dt:g} in {MOST_STEPS:,} internal steps, got no further "
                f"than time {solver.t:g}{self._of(lane)}. Usual cause: frequencies so high that thousands of "
                f"revolutions lie "
                "within dt. Use a smaller dt (with a larger every the same rows are saved), or method='exact' where it "
                "is known."
            )

    def _of(self, lane: int) -> str:
        return f" of lane {lane}" if len(self._solvers) > 1 else ""
