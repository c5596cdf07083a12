"""States carried a little further by the flow itself, many at once, each by a time of its own.

Gragg's extrapolation of the modified midpoint rule, of order 16: the even powers of the step in its error are removed
one after the other by Aitken and Neville's scheme.  [Hairer, Norsett, Wanner, Solving ODEs I, sections II.8, II.9]
"""

from __future__ import annotations

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.forces.kicks import ORIENTATION
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME

COLUMNS = (2, 4, 6, 8, 10, 12, 14, 16)  # midpoint steps; order twice their number
ACCURATE = 1e-14  # relative: difference of the last two entries of the last row, orders 14 and 16
CONVERGED = 1e-15  # then no higher order is needed
MOST_PIECES = 512


class Carrier:
    """The flow of a model on states (lanes, ...), with the orientation as a matrix behind them if there is one.

    The time (lanes,) stands at the end where a force depends on it, `timed`.
    """

    def __init__(self, model: Model, constants: dict[str, Array] | None = None):
        if model.system.perturbation is not None and model.system.perturbation.pair is not None:
            raise InputError(
                f"{model.system.name}: expected a body that moves by itself, got bodies in pairs. "
                "kr.propagator(...).until finds events of such bodies as they are stepped."
            )
        self.model, self.constants = model, dict(constants or {})
        self.known = self.constants  # of the lanes that are carried now
        self.timed = depends_on_time(model)
        self.count = len(model.system.space.letters)
        self.pieces = 1

    def __call__(self, z: tuple[Array, ...], h: Array) -> tuple[Array, ...]:
        """The states `h` (lanes,) later.  Raises `InputError` where the rows are too far apart."""
        out, pieces = tuple(np.empty_like(v) for v in z), self.pieces
        left = np.arange(len(h))
        while len(left):
            if pieces > MOST_PIECES:
                raise InputError(
                    "The saved states are too far apart to be joined by the flow: save more often (every)."
                )
            self.known = {k: v[left] for k, v in self.constants.items()}
            with np.errstate(all="ignore"):  # what overflows is never accurate
                found, error = self._march(tuple(v[left] for v in z), h[left], pieces)
            good = error <= self.enough(pieces)
            for v, new in zip(out, found, strict=True):
                v[left[good]] = new[good]
            if not good.any():
                self.pieces = 2 * pieces
            left, pieces = left[~good], 2 * pieces
        return out

    def enough(self, pieces: int) -> float:
        """The relative error that will do, in so many pieces."""
        return ACCURATE

    def _march(self, z: tuple[Array, ...], h: Array, pieces: int) -> tuple[tuple[Array, ...], Array]:
        worst = np.zeros(len(h))
        for _ in range(pieces):
            z, error = self._extrapolated(z, h / pieces)
            worst = np.maximum(worst, error)
        return z, worst

    def _extrapolated(self, z: tuple[Array, ...], h: Array) -> tuple[tuple[Array, ...], Array]:
        row: list[tuple[Array, ...]] = []
        for j, steps in enumerate(COLUMNS):
            new = [self._midpoint(z, h, steps)]
            for k in range(j):
                factor = (steps / COLUMNS[j - k - 1]) ** 2 - 1
                new.append(tuple(a + (a - b) / factor for a, b in zip(new[k], row[k], strict=True)))
            error = _gap(new[-1], new[-2]) if row else np.full(len(h), np.inf)
            row = new
            if (error <= CONVERGED).all():
                break
        return row[-1], error

    def _midpoint(self, z: tuple[Array, ...], h: Array, steps: int) -> tuple[Array, ...]:
        before, here = z, self._moved(z, z, h / steps)
        for _ in range(steps - 1):
            before, here = here, self._moved(before, here, 2 * h / steps)
        return here

    def _moved(self, z: tuple[Array, ...], at: tuple[Array, ...], h: Array) -> tuple[Array, ...]:
        return tuple(v + h.reshape(-1, *[1] * (v.ndim - 1)) * r for v, r in zip(z, self._rate(at), strict=True))

    def _rate(self, z: tuple[Array, ...]) -> tuple[Array, ...]:
        model, state = self.model, z[: self.count]
        known, g = dict(self.known), z[self.count : len(z) - self.timed]
        if self.timed:
            known[TIME] = z[-1]
        if g:
            known[ORIENTATION] = g[0]
        rate = tuple(model.call(model.system.flow, *state, **known))
        if g:
            omega = model.call(model.system.velocity, *state, **known)
            rate += (omega @ g[0] if model.system.frame is Frame.REST else g[0] @ omega,)
        return (*rate, np.ones_like(z[-1])) if self.timed else rate


def depends_on_time(model: Model) -> bool:
    """Whether a force of a perturbed body does."""
    record = model.system.perturbation
    return record is not None and record.names(TIME)


def _gap(new: tuple[Array, ...], old: tuple[Array, ...]) -> Array:
    """The largest difference of each lane, relative to the largest entry of its component; infinite if not finite."""
    worst = np.zeros(len(new[0]))
    for a, b in zip(new, old, strict=True):
        gap = np.abs(a - b).reshape(len(a), -1).max(-1) / np.abs(a).max(initial=1e-300)
        worst = np.maximum(worst, np.where(np.isfinite(gap), gap, np.inf))
    return worst
