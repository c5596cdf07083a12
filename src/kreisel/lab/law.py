"""Laws, the cases that they are tested on, and orders of maps and methods, measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.graph.recording import flat_constants, flat_stages
from kreisel.kernels.cpu import CpuEngine
from kreisel.lab import exact
from kreisel.lab.exact import jacobian
from kreisel.method import scheme
from kreisel.method.observing import ORIENTATION
from kreisel.record.contract import Frame, Map, System
from kreisel.record.model import Model

Sides = Iterator[tuple[Array, Array]]
TOLERANCE = 2.0**20 * float(np.finfo(np.float64).eps)
ORDER_TOLERANCE = 0.15


@dataclass(frozen=True)
class Case:
    """A random model, state and step in one kind of number."""

    model: Model
    state: tuple[Array, ...]
    eps: Any
    lam: Any
    draw: exact.Random
    numbers: str

    @property
    def system(self) -> System:
        return self.model.system

    @property
    def map(self) -> Map:
        return self.model.map

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.system.space.kinds

    def call(self, function: Callable[..., Any] | None, *state: Array, **extra: Any) -> Any:
        if function is None:
            raise InputError(f"{self.system.name} does not state what this law needs.")
        return self.model.call(function, *(state or self.state), **{"eps": self.eps, "lam": self.lam, **extra})

    def flat(self, state: tuple[Array, ...]) -> Array:
        return algebra.flatten(state, self.kinds)

    def tensor(self, state: tuple[Array, ...]) -> Array:
        return self.model.call(self.system.space.tensor, *state)

    def moving(self, rate: tuple[Array, ...]) -> tuple[Array, ...]:
        """The state with an infinitesimal step along the rate."""
        return tuple(exact.along(z, r) for z, r in zip(self.state, rate, strict=True))

    def jacobian(self, function: Callable[..., Any] | None, **extra: Any) -> tuple[Any, Array]:
        return jacobian(lambda *z: self.call(function, *z, **extra), self.state, self.kinds, self.model.n)


@dataclass(frozen=True)
class Law:
    """A statement and the sides that it states are equal.  `needs` states to which records it applies."""

    name: str
    statement: str
    sides: Callable[[Case], Sides]
    needs: Callable[[System], bool] = lambda system: True
    exact: bool = True

    def numbers(self, system: System) -> tuple[str, ...]:
        """The kinds of numbers in which it can be tested: a step with roots is not rational."""
        roots = system.map is not None and not system.map.rational
        of_map = roots and not self.needs(replace(system, map=None))
        rational = self.exact and system.numbers == "any" and not of_map
        return ("exact", "float") if rational else ("float",)


@dataclass(frozen=True)
class Verdict:
    """The outcome of one law for one system, n, kind of number and seed."""

    system: str
    law: str
    n: int
    numbers: str
    seed: int
    residual: float
    holds: bool


LAWS: dict[str, Law] = {}


def law(
    statement: str, needs: Callable[[System], bool] = lambda system: True, exact: bool = True
) -> Callable[..., Any]:
    def register(sides: Callable[[Case], Sides]) -> Callable[[Case], Sides]:
        name = sides.__name__.replace("_", "-")
        LAWS[name] = Law(name, statement, sides, needs, exact)
        return sides

    return register


def real(sides: Iterable[tuple[Array, Array]]) -> Sides:
    """Pairs of real sides: complex ones by their real and imaginary parts."""
    for left, right in sides:
        (re, im), (right_re, right_im) = algebra.parts(left), algebra.parts(right)
        yield re, right_re
        if im is not None or right_im is not None:
            yield 0 * re if im is None else im, 0 * right_re if right_im is None else right_im


def residual(sides: Iterable[tuple[Array, Array]], numbers: str) -> float:
    """The largest difference: 0 only if exactly 0 in rationals, relative to the size of the sides in floats."""
    worst = 0.0
    for left, right in real(sides):
        difference = np.asarray(left - right)
        size = 0.0 if numbers == "exact" else max(algebra.magnitude(left), algebra.magnitude(right))
        amount = algebra.magnitude(difference) / (1 + size)
        if numbers == "exact" and amount == 0 and any(v != 0 for v in difference.flat):
            amount = np.finfo(float).tiny
        worst = max(worst, amount if np.isfinite(amount) else np.inf)
    return worst


def has_map(system: System) -> bool:
    return system.map is not None


def has_flow(system: System) -> bool:
    return system.flow is not None and system.energy is not None


def has_map_with(*claims: str) -> Callable[[System], bool]:
    """Whether a record has a map and these entries of it."""
    return lambda s: s.map is not None and all(getattr(s.map, claim) is not None for claim in claims)


def has_order(system: System) -> bool:
    """Whether there are a map and a flow of the state, and of the orientation if the map rotates it."""
    stated = system.map is not None and (system.velocity is not None or system.map.generator is None)
    return stated and has_flow(system)


def functions_of(system: System) -> dict[str, Callable[..., Any]]:
    """The energy, if it is known, and the integrals."""
    energy = {} if system.energy is None else {"energy": system.energy}
    return {**energy, **system.integrals}


def conserved_functions(system: System) -> list[Callable[..., Any]]:
    """The energy and the integrals that the map conserves."""
    keeps = None if system.map is None else system.map.conserves
    return [f for name, f in functions_of(system).items() if keeps is None or name in keeps]


def integral_gradients(case: Case, eps: Any) -> Iterator[tuple[str, Array]]:
    """Name and gradient (count, d) of the energy and the commuting integrals at a step eps."""
    for name in ("energy", *case.system.commuting):
        function = functions_of(case.system)[name]
        yield name, np.atleast_2d(case.jacobian(function, eps=eps)[1])


# -- measured orders -------------------------------------------------------------------------------
# Orders of maps and methods, measured.


COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)  # steps in a unit of time
TIMES = (1, 2, 4, 8)
RATE, LONGEST = 3.0, 8.0  # of a unit of time
WINDOW, LARGEST = 4, 1e-1  # successive steps; beyond such errors there is no order
PLATEAU, FAR = 3e-13, 3  # errors of rounding; how far above the measured ones an error is the method's
NEARBY = (7.5, 7, 6.5, 6, 5.5, 5)  # times the finest count: ends that differ from the method's own by rounding
SOLVER_ERROR = 1e-11


def measured_orders(
    model: Model,
    state: tuple[Array, ...],
    conjugate: bool,
    time: float = 0.5,
    counts: tuple[int, ...] = (64, 128, 256, 512),
) -> list[float]:
    """Slopes of log error against log dt for the state and, if the map has a generator, the orientation."""
    g0, kinds = np.eye(model.n), (*model.system.space.kinds, "matrix")
    ends = [algebra.flatten(_iterate(model, state, g0, time / k, k, conjugate), kinds) for k in counts]
    errors = _errors(model, _truth(model, state, time), ends)
    return fitted_orders(time / np.array(counts), errors if model.map.generator is not None else errors[:, :1])


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
    truths = _truths(model, _start(model, state).tobytes(), tuple(factor * unit for factor in TIMES))
    for factor, truth in zip(TIMES, truths, strict=True):
        time, counts = factor * unit, [factor * k for k in COUNTS]
        finest = end(time, 8 * counts[-1])
        apart = _errors(model, truth, [finest])[0]
        ends = [end(time, count) for count in counts]
        rounding = _errors(model, finest, [end(time, int(k * counts[-1])) for k in NEARBY]).max(0)
        errors = _errors(model, finest, ends) + np.where(apart > SOLVER_ERROR, apart, 0)
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
    return _truths(model, _start(model, state).tobytes(), (time,))[0].copy()


def _start(model: Model, state: tuple[Array, ...]) -> Array:
    """A state with the orientation 1, as values."""
    flat = algebra.flatten((*state, np.eye(model.n)), (*model.system.space.kinds, "matrix"))
    return np.asarray(flat, dtype=np.float64)


@lru_cache(4)  # the orders of a method are measured on one motion
def _truths(model: Model, start: bytes, times: tuple[float, ...]) -> list[Array]:
    """Solutions at times in order, each from the one before."""
    from scipy.integrate import solve_ivp

    n, system = model.n, model.system
    kinds = (*system.space.kinds, "matrix")

    def rate(t: float, y: Array) -> Array:
        *state, g = algebra.restore(y, kinds, n)
        omega = 0 * g if system.velocity is None else model.call(system.velocity, *state)
        return algebra.flatten((*model.flow(*state), omega @ g if system.frame is Frame.REST else g @ omega), kinds)

    ends, y, begun = list[Array](), np.frombuffer(start), 0.0
    for time in times:
        y = solve_ivp(rate, (begun, time), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        begun = time
        ends.append(y)
    return ends


def _errors(model: Model, truth: Array, ends: list[Array]) -> Array:
    """The largest errors (ends, 2) of the states and of the orientations."""
    of_state = len(truth) - model.n * model.n
    return np.array([[abs(end - truth)[:of_state].max(), abs(end - truth)[of_state:].max()] for end in ends])


def fitted_orders(steps: Array, errors: Array) -> list[float]:
    """Slopes of log error against log step."""
    return [float(np.polyfit(np.log(steps), np.log(errors[:, i]), 1)[0]) for i in range(errors.shape[1])]


def _iterate(
    model: Model, state: tuple[Array, ...], g: Array, dt: float, count: int, conjugate: bool
) -> tuple[Array, ...]:
    state = model.call(model.map.from_symmetric, *state, eps=dt) if conjugate else state
    for _ in range(count):
        new = model.call(model.map.step, *state, eps=dt)
        if model.map.generator is not None:
            X = model.call(model.map.generator, *state, *new, eps=dt)
            g = algebra.turn_left(X, g) if model.system.frame is Frame.REST else algebra.turn_right(g, X)
        state = new
    return (*(model.call(model.map.to_symmetric, *state, eps=dt) if conjugate else state), g)
