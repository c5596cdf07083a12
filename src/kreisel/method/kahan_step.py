"""The linear equation of Kahan's step, and its solution in straight-line code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import value_and_jacobian
from kreisel.record.calling import call
from kreisel.record.contract import PhaseSpace
from kreisel.record.model import Model

State = tuple[Array, ...]


def advance(model: Model, state: State, eps: Array, consts: Mapping[str, Array]) -> tuple[State, list[Any]]:
    """The step of order 2, and the pivots of its linear equation."""
    space = model.system.space
    numbers = numbers_of(space, state)
    known = {name: value for name, value in consts.items() if name in model.axes}

    def rates(x: Sequence[Any], *values: Any) -> list[Any]:
        own = state_of(space, x, model.n)
        return numbers_of(space, tuple(call(model.system.flow, own, dict(zip(known, values, strict=True)))))

    f, slopes = value_and_jacobian(rates, numbers, [(value, model.axes[name]) for name, value in known.items()])
    matrix = [[(i == j) - eps / 2 * slope for j, slope in enumerate(row)] for i, row in enumerate(slopes)]
    change, pivots = eliminate(matrix, [eps * v for v in f])
    return state_of(space, [x + y for x, y in zip(numbers, change, strict=True)], model.n), pivots


def eliminate(matrix: list[list[Any]], right: list[Any]) -> tuple[list[Any], list[Any]]:
    """The solution of a linear equation near the identity, and the pivots, none of which is moved."""
    rows = [[*row, b] for row, b in zip(matrix, right, strict=True)]
    pivots = []
    for k, row in enumerate(rows):
        pivots.append(row[k])
        inverse = 1 / row[k]
        row[k + 1 :] = [inverse * v for v in row[k + 1 :]]
        for other in rows[k + 1 :]:
            other[k + 1 :] = [v - other[k] * w for v, w in zip(other[k + 1 :], row[k + 1 :], strict=True)]
    found: list[Any] = []
    for k, row in reversed(list(enumerate(rows))):
        value = row[-1]
        for v, x in zip(row[k + 1 : -1], found, strict=True):
            value = value - v * x
        found.insert(0, value)
    return found, pivots


def numbers_of(space: PhaseSpace, state: State) -> list[Any]:
    """The independent coordinates, each with its batch."""
    flat = [algebra.coordinates_of(kind, z) for kind, z in zip(space.kinds, state, strict=True)]
    return [z[..., i][()] for z in flat for i in range(z.shape[-1])]


def state_of(space: PhaseSpace, numbers: Sequence[Any], n: int) -> State:
    """The state with these coordinates."""
    parts, rest = [], list(numbers)
    for kind in space.kinds:
        count = coordinate_count(kind, n)
        own, rest = rest[:count], rest[count:]
        if all(isinstance(v, float | np.ndarray | np.floating) for v in own):
            x = np.stack(np.broadcast_arrays(*own), -1)
        else:
            x = algebra.objects(own)
        parts.append(algebra.skew(x, n) if kind == "skew" else algebra.symmetric(x, n) if kind == "symmetric" else x)
    return tuple(parts)


def coordinate_count(kind: str, n: int) -> int:
    """How many independent coordinates a component of that kind has."""
    if kind.startswith("R^"):
        return int(kind[2:])
    return {"skew": n * (n - 1) // 2, "symmetric": n * (n + 1) // 2, "vector": n}[kind]
