"""An improvement repeated until it has settled, for any kind of number."""

from __future__ import annotations

from collections.abc import Callable

from kreisel.algebra import Array, flatten, holds_objects, restore

State = tuple[Array, ...]


def repeat(
    improve: Callable[..., tuple[State, Array]], start: State, small: float, most: int, kinds: tuple[str, ...]
) -> tuple[State, Array]:
    """X, defect = improve(*X) from matrices X of the given kinds until defect <= small, at most `most` times.

    Recorded numbers give a loop.  Dual numbers continue, for their slopes, twice as long as their values need.
    Numbers without an order use all `most` iterations.
    """
    X, first = start, start[0]
    if hasattr(first, "record_loop"):
        return first.record_loop(improve, X, small, most)
    objects = any(map(holds_objects, X))
    recorded = [v for part in X for v in part.flat if hasattr(v, "record_loop")] if objects else []
    if recorded:
        n = first.shape[-1]

        def on_coordinates(x: Array) -> tuple[Array, Array]:
            Y, defect = improve(*restore(x, kinds, n))
            return flatten(Y, kinds), defect

        x, defect = recorded[0].record_loop(on_coordinates, flatten(X, kinds), small, most)
        return restore(x, kinds, n), defect
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
