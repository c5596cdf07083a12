"""Fewer rows for the eye, without losing an extreme."""

from __future__ import annotations

import numpy as np

from kreisel.algebra import Array


def extremes(values: Array, most: int) -> Array:
    """At most about `most` rows of `values` (rows, k), sorted, with the extremes of every column.

    The first row, the last one, and from each of many equal stretches the rows with the least and the greatest value of
    every column.  NaN counts as no extreme.
    """
    values = np.asarray(values).reshape(len(values), -1)
    rows, columns = values.shape
    if rows <= max(most, 2):
        return np.arange(rows)
    stretch = -(-rows // max(1, (most - 2) // (2 * max(columns, 1))))
    kept = {0, rows - 1}
    for start in range(0, rows, stretch * 256):  # many stretches at once, memory flat
        block = values[start : start + stretch * 256]
        whole = len(block) // stretch * stretch
        for piece, offset in (
            (block[:whole].reshape(-1, stretch, columns), start),
            (block[None, whole:], start + whole),
        ):
            if piece.size:
                base = offset + stretch * np.arange(len(piece))[:, None]
                low = np.where(np.isnan(piece), np.inf, piece).argmin(1)
                high = np.where(np.isnan(piece), -np.inf, piece).argmax(1)
                kept.update((base + low).ravel().tolist(), (base + high).ravel().tolist())
    return np.array(sorted(kept))


def mixed(values: Array, most: int) -> Array:
    """At most about `most` rows, sorted: half of them the extremes, half one of each equal stretch, at random.

    The extremes alone would show the ends of a path too often, and even steps could keep time with it.  The choice is
    always the same.
    """
    rows = len(values)
    if rows <= most:
        return np.arange(rows)
    edges = np.linspace(0, rows, most // 2 + 1)
    draws = np.random.default_rng(0).random(most // 2)
    drawn = (edges[:-1] + draws * np.diff(edges)).astype(int)
    return np.union1d(extremes(values, most // 2), drawn)
