"""States carried a little further by the flow itself, many at once, each by a separate time in separate steps.

Gragg's extrapolation of the modified midpoint rule, of order 16 at most: the even powers of the step in its error are
removed one after the other by Aitken and Neville's scheme.  [Hairer, Norsett, Wanner, Solving ODEs I, sections II.8,
II.9]
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.forces.kicks import ORIENTATION
from kreisel.graph.recording import flat_constants
from kreisel.kernels.cpu import compiled_step
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Scheme, Steps
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME

COLUMNS = (2, 4, 6, 8, 10, 12, 14, 16)  # midpoint steps; order twice their number
ACCURATE = 1e-14  # relative to each state: difference of the last two entries of a row of the scheme
CONVERGED = 1e-15  # then no higher order is needed
EASY = 5  # columns; for a state that needs no more, the next step is twice as long
LEAST_SHARE = 2.0**-44  # of the time to go: a shorter step means that no step is short enough
MOST_ROUNDS = 1024
JITTER = 2.0**-50  # relative: the change of a state that shows the accuracy of its rate
MEETS = 0.1  # of a component: the coarsest maps in use are off by half of it from one row to the next
FASTER = 5  # dimensions up to which the steps are compiled
BETWEEN, STEP = "_before", "eps"


class Carrier:
    """The flow of a model on rows (k, ...) of lanes (k,): [x,] the components, [orientation matrix,] [time].

    The position x comes first if the body is `moving`, x' = g U; the time comes last if a force depends on it.  Steps
    are compiled if the rates can be recorded as straight-line code: a disc in water, 100 rows: 40 s on arrays, 0.05 s
    compiled.
    """

    def __init__(self, model: Model, lane: Array, *, oriented: bool, moving: bool = False):
        if model.system.perturbation is not None and model.system.perturbation.pair is not None:
            raise InputError(
                f"{model.system.name}: expected a single body, got bodies in pairs. "
                "kr.propagator(...).until finds events of such bodies as they are stepped."
            )
        self.model, self.moving, self.timed = model, moving, depends_on_time(model)
        ends = (*((ORIENTATION, "matrix"),) * oriented, *((TIME, "scalar"),) * self.timed)
        self.components = (*(("x", "vector"),) * moving, *model.system.space.components, *ends)
        self.kinds = [kind for _, kind in self.components]
        self.starts = [place.start for place in algebra.slices(self.kinds, model.n)]
        varied = {k for k, v in model.constants.items() if model.batch and v.ndim > model.axes[k]}
        self.constants = {k: v[lane] if k in varied else v for k, v in model.constants.items()}
        compiled = model.system.numbers != "jax" and model.n <= FASTER
        self.advance = self._by_kernel(len(lane)) if compiled else self._by_arrays

    def __call__(self, z: tuple[Array, ...], h: Array, following: tuple[Array, ...] | None = None) -> tuple[Array, ...]:
        """The states `h` (k,) later.  Raises `InputError` if no step is short enough: the rows are too far apart.

        `following`: the saved states there, without x.  Raises `InputError` if the flow leads elsewhere by more than
        any useful map does.
        """
        y, share, done = algebra.flatten(z, self.kinds), np.ones(len(h)), np.zeros(len(h))
        size, left = self.size(y), np.nonzero(h)[0]
        with np.errstate(all="ignore"):  # steps whose values overflow are too long
            for _ in range(MOST_ROUNDS):
                if not len(left) or share[left].min() < LEAST_SHARE:
                    break
                new, error, columns = self.step(y[left], share[left] * h[left], size[left], left)
                good = error <= ACCURATE
                passed = left[good]
                y[passed], done[passed] = new[good], done[passed] + share[passed]
                size[passed] = np.maximum(size[passed], self.size(new[good]))
                share[passed] *= np.where(columns[good] <= EASY, 2.0, 1.0)
                share[left[~good]] /= 4
                share[left] = np.minimum(share[left], 1 - done[left])
                left = left[done[left] < 1]
            if len(left):
                raise InputError(
                    "The saved states are too far apart to be joined by the flow: save more often (every)."
                )
            end = algebra.restore(y, self.kinds, self.model.n)
            if following is not None:
                saved = algebra.flatten((*end[: self.moving], *following), self.kinds)
                size = np.maximum(self.size(y), self.size(saved))
                off = (self.size(y - saved) / self._rate_and_scale(y, h, size, np.arange(len(y)))[1]).max(1)
                if not (off <= MEETS).all():
                    raise InputError(
                        "The flow expected to lead from each saved state to the next one, got one that is off by "
                        f"{100 * off[~(off <= MEETS)][0]:.0f} %. Usual cause: an impulse or an action between two "
                        "rows, a step far too long for the method, or chaos between rows that are far apart. Save more "
                        "often (every)."
                    )
        return end

    def rates(self, *z: Array, **constants: Array) -> tuple[Array, ...]:
        """The rates of all components, for any kind of number."""
        model, first, last = self.model, self.moving, self.moving + len(self.model.system.space.letters)
        state: tuple[Array, ...] = z[first:last]
        turn: Any = None
        constants |= dict(zip((name for name, _ in self.components[last:]), z[last:], strict=True))
        rate = [*model.call(model.system.flow, *state, **constants)]
        if len(z) - last > self.timed:
            turn, omega = z[last], model.call(model.system.velocity, *state, **constants)
            rate.append(omega @ turn if model.system.frame is Frame.REST else turn @ omega)
        if self.moving:
            rate.insert(0, algebra.act(turn, model.call(model.system.translation, *state, **constants) + 0 * z[0]))
        return (*rate, *(0 * t + 1 for t in z[len(z) - self.timed :]))

    def _by_kernel(self, lanes: int) -> Callable[..., Floats]:
        """before + eps z'(state) repeatedly, by a kernel."""
        count = len(self.components)

        def step(*z: Array, eps: Array, **constants: Array) -> tuple[Array, ...]:
            before, state = z[:count], z[count:]
            return (*state, *(b + eps * r for b, r in zip(before, self.rates(*state, **constants), strict=True)))

        def unchanged(z: Any) -> Any:
            return z

        scheme = Scheme(
            name=f"the flow of {self.model.system.name}",
            components=(*((letter + BETWEEN, kind) for letter, kind in self.components), *self.components),
            constants={**self.constants, STEP: np.asarray(0.5)},
            axes={**self.model.axes, STEP: 0},
            n=self.model.n,
            prepare=unchanged,
            motion=Steps(step),
            observe=unchanged,
            reopen=unchanged,
            outcomes={},
            kernel_key=None,
        )
        rows, columns = flat_constants(scheme, lanes)
        kernel = compiled_step(scheme, rows, columns)

        def advance(before: Floats, state: Floats, eps: Floats, steps: int, lanes: Array) -> Floats:
            z, c = np.concatenate([before, state], 1), rows[lanes]
            c[:, columns[STEP]] = eps[:, None]
            kernel(z, c, steps)
            return z[:, state.shape[1] :]

        return advance

    def _by_arrays(self, before: Floats, state: Floats, eps: Floats, steps: int, lanes: Array) -> Floats:
        """before + eps z'(state) repeatedly, on arrays."""
        kinds, n = self.kinds, self.model.n
        constants = {k: v[lanes] if v.ndim > self.model.axes[k] else v for k, v in self.constants.items()}
        for _ in range(steps):
            rate = algebra.flatten(self.rates(*algebra.restore(state, kinds, n), **constants), kinds)
            before, state = state, before + eps[:, None] * rate
        return state

    def size(self, y: Floats) -> Floats:
        """The largest entry of each component, (k, components)."""
        return np.maximum.reduceat(np.abs(y), self.starts, axis=1)

    def step(self, y: Floats, h: Floats, size: Floats, lanes: Array) -> tuple[Floats, Floats, Array]:
        """The states h later, their errors relative to each component of each state, and the columns used.

        If a component is 0 up to rounding, such as the momentum of a body that moves along its axis, its error is
        compared with the error of its rate from the rounding of the state.
        """
        rate, size = self._rate_and_scale(y, h, size, lanes)
        row: list[Floats] = []
        end, best, columns = y, np.full(len(h), np.inf), np.zeros(len(h), dtype=int)
        for j, steps in enumerate(COLUMNS):
            h_j = h / steps
            new = [self.advance(y, y + h_j[:, None] * rate, 2 * h_j, steps - 1, lanes)]
            for k in range(j):
                new.append(new[k] + (new[k] - row[k]) / ((steps / COLUMNS[j - k - 1]) ** 2 - 1))
            if j > 1:
                error = (self.size(new[-1] - new[-2]) / np.maximum(size, self.size(new[-1]))).max(1)
                better = error < best
                end = np.where(better[:, None], new[-1], end)
                best, columns = np.where(better, error, best), np.where(best > CONVERGED, j + 1, columns)
            row = new
            if (best <= CONVERGED).all():
                break
        return end, best, columns

    def _rate_and_scale(self, y: Floats, h: Floats, size: Floats, lanes: Array) -> tuple[Floats, Floats]:
        jitter = JITTER * np.where(np.arange(y.shape[1]) % 2, -1, 1)
        near = y + jitter * np.repeat(size, np.diff([*self.starts, y.shape[1]]), 1)
        rate, nearby = (self.advance(np.zeros_like(y), at, np.ones(len(y)), 1, lanes) for at in (y, near))
        unsure = self.size(h[:, None] * (nearby - rate)) / ACCURATE
        return rate, np.maximum(size, self.size(h[:, None] * rate)) + unsure + np.finfo(float).tiny


def depends_on_time(model: Model) -> bool:
    """Whether a force of a perturbed body depends on the time."""
    record = model.system.perturbation
    return record is not None and record.names(TIME)
