"""Laws, the cases that they are tested on, and orders of maps and methods, measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.lab import exact
from kreisel.lab.exact import jacobian
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

    def call(self, function: Any, *state: Array, **extra: Any) -> Any:
        return self.model.call(function, *(state or self.state), **{"eps": self.eps, "lam": self.lam, **extra})

    def flat(self, state: tuple[Array, ...]) -> Array:
        return algebra.flatten(state, self.kinds)

    def tensor(self, state: tuple[Array, ...]) -> Array:
        return self.model.call(self.system.space.tensor, *state)

    def slope(self, function: Callable[..., Any]) -> Array:
        """The rate of a function of the state along the flow."""
        moving = (exact.along(z, r) for z, r in zip(self.state, self.model.flow(*self.state), strict=True))
        return exact.slopes(function(*moving), 1)[..., 0]

    @property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """The energy, if it is known, and the integrals."""
        energy = {} if self.system.energy is None else {"energy": self.system.energy}
        return {**energy, **self.system.integrals}

    def jacobian(self, function: Any, **extra: Any) -> tuple[Any, Array]:
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


def states(system: System, entries: str) -> bool:
    """Whether a record states all of these entries, such as "flow map.lax"."""
    record: Any = system
    paths = [entry.split(".") for entry in entries.split()]
    return all(reduce(lambda record, name: getattr(record, name, None), path, record) for path in paths)


def law(
    statement: str, needs: str = "", exact: bool = True, unless: Callable[[System], bool] = lambda system: False
) -> Callable[..., Any]:
    """Register the sides of a law for records that state what it needs, unless it does not apply to them."""

    def register(sides: Callable[[Case], Sides]) -> Callable[[Case], Sides]:
        name = sides.__name__.replace("_", "-")
        LAWS[name] = Law(name, statement, sides, lambda s: states(s, needs) and not unless(s), exact)
        return sides

    return register


def real(sides: Iterable[tuple[Array, Array]]) -> Sides:
    """Pairs of real sides: complex ones by their real and imaginary parts."""
    for left, right in sides:
        (re, im), (right_re, right_im) = algebra.parts(np.asarray(left)), algebra.parts(np.asarray(right))
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


# -- orders of maps and methods, measured ----------------------------------------------------------------


def measured_orders(
    model: Model, state: tuple[Array, ...], conjugate: bool, counts: tuple[int, ...], time: float = 0.5
) -> list[float]:
    """Slopes of log error against log dt for the state and, if the map has a generator, the orientation."""
    mapped = model.map

    def end(count: int) -> tuple[Array, ...]:
        dt, g = time / count, np.eye(model.n)
        z = model.call(mapped.from_symmetric, *state, eps=dt) if conjugate else state
        for _ in range(count):
            new = model.call(mapped.step, *z, eps=dt)
            if mapped.generator is not None:
                X = model.call(mapped.generator, *z, *new, eps=dt)
                g = algebra.turn_left(X, g) if model.system.frame is Frame.REST else algebra.turn_right(g, X)
            z = new
        return (*(model.call(mapped.to_symmetric, *z, eps=dt) if conjugate else z), g)

    return _orders(model, state, end, counts, time, mapped.generator is not None)


def baecklund_orders(
    model: Model, state: tuple[Array, ...], order: int, counts: tuple[int, ...], time: float = 0.5
) -> list[float]:
    """The slopes of `measured_orders` for method="baecklund" of that order, by its definition."""
    from kreisel.method.baecklund import baecklund

    def end(count: int) -> tuple[Array, ...]:
        z = (*state, np.array([1.0, 0, 0, 0]) if model.n == 3 else np.eye(model.n))
        plan = baecklund(model, time / count, order, oriented=True).on(z)
        for _ in range(count):
            z = plan.advance(*z)
        return (*z[:-1], algebra.rotation_matrix(z[-1])) if model.n == 3 else z

    return _orders(model, state, end, counts, time, True)


def _orders(
    model: Model, state: Any, end: Callable[[int], Any], counts: tuple[int, ...], time: float, oriented: bool
) -> list[float]:
    ends = [algebra.flatten(end(count), (*model.system.space.kinds, "matrix")) for count in counts]
    errors = errors_of(model, _truth(model, state, time), ends)
    return fitted_orders(time / np.array(counts), errors[:, : 1 + oriented])


def flowed(model: Model, state: tuple[Array, ...], time: float) -> tuple[Array, ...]:
    """The state after that time, by DOP853 to round-off."""
    return algebra.restore(_truth(model, state, time), (*model.system.space.kinds, "matrix"), model.n)[:-1]


def _truth(model: Model, state: tuple[Array, ...], time: float) -> Array:
    """The state and the orientation at `time` by a solver with rtol 1e-13."""
    return solutions(model, flat_start(model, state).tobytes(), (time,))[0].copy()


def flat_start(model: Model, state: tuple[Array, ...]) -> Array:
    """A state with the orientation 1, as values."""
    flat = algebra.flatten((*state, np.eye(model.n)), (*model.system.space.kinds, "matrix"))
    return np.asarray(flat, dtype=np.float64)


@lru_cache(4)  # the orders of a method are measured on one motion
def solutions(model: Model, start: bytes, times: tuple[float, ...]) -> list[Array]:
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


def errors_of(model: Model, truth: Array, ends: list[Array]) -> Array:
    """The largest errors (ends, 2) of the states and of the orientations."""
    of_state = len(truth) - model.n * model.n
    return np.array([[abs(end - truth)[:of_state].max(), abs(end - truth)[of_state:].max()] for end in ends])


def fitted_orders(steps: Array, errors: Array) -> list[float]:
    """Slopes of log error against log step."""
    return [float(np.polyfit(np.log(steps), np.log(errors[:, i]), 1)[0]) for i in range(errors.shape[1])]
