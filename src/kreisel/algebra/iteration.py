"""An improvement repeated until it has settled, for any kind of number."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from kreisel.algebra import Array, coordinates_of, holds_objects, skew, symmetric

State = tuple[Array, ...]


def repeat(
    improve: Callable[..., tuple[State, Array]], start: State, small: float, most: int, kinds: tuple[str, ...]
) -> tuple[State, Array]:
    """X, defect = improve(*X) from matrices X of the given kinds until defect <= small, at most `most` times.

    Recorded numbers make a loop of it.  Dual numbers go on, for their slopes, twice as long as their values need.
    Numbers without an order go all the way.
    """
    X, first = start, start[0]
    if hasattr(first, "record_loop"):
        return first.record_loop(improve, X, small, most)
    objects = any(map(holds_objects, X))
    recorded = [v for part in X for v in part.flat if hasattr(v, "record_loop")] if objects else []
    if recorded:
        n = first.shape[-1]
        edges = np.cumsum([0, *(coordinates_of(kind, part).size for kind, part in zip(kinds, X, strict=True))])

        def joined(X: State) -> Array:
            return np.concatenate([coordinates_of(kind, part).ravel() for kind, part in zip(kinds, X, strict=True)])

        def parted(x: Array) -> State:
            pieces = (x[a:b] for a, b in itertools.pairwise(edges))
            return tuple(_matrix_of(kind, piece, n) for kind, piece in zip(kinds, pieces, strict=True))

        def on_coordinates(x: Array) -> tuple[Array, Array]:
            Y, defect = improve(*parted(x))
            return joined(Y), defect

        x, defect = recorded[0].record_loop(on_coordinates, joined(X), small, most)
        return parted(x), defect
    last = most
    for k in range(most):
        X, defect = improve(*X)
        if not objects and (defect <= small).all():
            break
        if last == most and objects and getattr(defect, "value", 1) <= small:
            last = 2 * k + 2
        if k == last:
            break
    return X, defect


def _matrix_of(kind: str, x: Array, n: int) -> Array:
    if kind == "matrix":
        return x.reshape((n, n))
    if kind == "vector":
        return x
    return skew(x, n) if kind == "skew" else symmetric(x, n)
