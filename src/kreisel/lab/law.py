"""What a law is, and the case that it is tested on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.lab import exact
from kreisel.lab.exact import jacobian
from kreisel.record.contract import Map, System
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

    def jacobian(self, function: Callable[..., Any] | None, **extra: Any) -> tuple[Any, Array]:
        return jacobian(lambda *z: self.call(function, *z, **extra), self.state, self.kinds, self.model.n)


@dataclass(frozen=True)
class Law:
    """A statement and the sides that it says are equal.  `needs` says to which records it applies."""

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
    """The outcome of one law for one system, n, kind of numbers and seed."""

    system: str
    law: str
    n: int
    numbers: str
    seed: int
    residual: float
    holds: bool


LAWS: dict[str, Law] = {}


def _law(
    statement: str, needs: Callable[[System], bool] = lambda system: True, exact: bool = True
) -> Callable[..., Any]:
    def register(sides: Callable[[Case], Sides]) -> Callable[[Case], Sides]:
        name = sides.__name__.replace("_", "-")
        LAWS[name] = Law(name, statement, sides, needs, exact)
        return sides

    return register


def _has_map(system: System) -> bool:
    return system.map is not None


def _has_flow(system: System) -> bool:
    return system.flow is not None and system.energy is not None


def _has_map_with(*claims: str) -> Callable[[System], bool]:
    """Whether a record has a map and these entries of it."""
    return lambda s: s.map is not None and all(getattr(s.map, claim) is not None for claim in claims)


def _functions(system: System) -> dict[str, Callable[..., Any]]:
    """The energy, where it is known, and the integrals."""
    energy = {} if system.energy is None else {"energy": system.energy}
    return {**energy, **system.integrals}


def _conserved_functions(system: System) -> list[Callable[..., Any]]:
    """What the map keeps."""
    keeps = None if system.map is None else system.map.conserves
    return [f for name, f in _functions(system).items() if keeps is None or name in keeps]


def _integral_gradients(case: Case, eps: Any) -> Iterator[tuple[str, Array]]:
    """Name and gradient (count, d) of the energy and the commuting integrals at a step eps."""
    for name in ("energy", *case.system.commuting):
        function = _functions(case.system)[name]
        yield name, np.atleast_2d(case.jacobian(function, eps=eps)[1])
