"""Between named components (..., n, n), (..., n) and the flat rows that kernels work on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array

Floats = np.ndarray[Any, np.dtype[np.float64]]
MACHINE_EPSILON = float(np.finfo(np.float64).eps)
LANES = 4  # doubles that kernels for rows take at once
Look = Callable[[], None]


def no_look() -> None:
    """For kernels at work without anybody who may stop them."""


def coordinate_count(kind: str, n: int) -> int:
    """The number of independent coordinates of a component."""
    if kind.startswith("R^"):
        return int(kind[2:])
    halves = {"skew": n * (n - 1) // 2, "symmetric": n * (n + 1) // 2}
    return {**halves, "vector": n, "matrix": n * n, "quaternion": 4, "scalar": 1}[kind]


def flatten(parts: Sequence[Array], kinds: Sequence[str]) -> Array:
    """Components with any batch axes, which are broadcast, as one array (..., d)."""
    flat = []
    for part, kind in zip(parts, kinds, strict=True):
        if kind in ("skew", "symmetric"):
            flat.append(algebra.coordinates_of(kind, part))
        elif kind == "matrix":
            flat.append(part.reshape((*part.shape[:-2], part.shape[-2] * part.shape[-1])))
        elif kind == "scalar":
            flat.append(np.asarray(part)[..., None])
        else:
            flat.append(part)
    batch = np.broadcast_shapes(*(f.shape[:-1] for f in flat))
    return np.concatenate([np.broadcast_to(f, (*batch, f.shape[-1])) for f in flat], -1)


def restore(flat: Array, kinds: Sequence[str], n: int) -> tuple[Array, ...]:
    """The inverse of `flatten`."""
    parts, start = [], 0
    for kind in kinds:
        piece = flat[..., start : start + coordinate_count(kind, n)]
        start += coordinate_count(kind, n)
        if kind == "skew":
            piece = algebra.skew(piece, n)
        elif kind == "symmetric":
            piece = algebra.symmetric(piece, n)
        elif kind == "matrix":
            piece = piece.reshape((*piece.shape[:-1], n, n))
        elif kind == "scalar":
            piece = piece[..., 0][()]
        parts.append(piece)
    return tuple(parts)
