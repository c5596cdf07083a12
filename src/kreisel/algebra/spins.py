"""Spins of a chain as three vectors x, y, z (..., n) of their components, an entry per site; for any kind of number."""

from __future__ import annotations

from kreisel.algebra.backend import Array

Spins = tuple[Array, ...]  # (x, y, z)


def shifted(x: Array, k: int) -> Array:
    """x_(i+k) on the ring of the sites."""
    if hasattr(x, "record_shift"):
        return x.record_shift(k)
    return x.__array_namespace__().concatenate([x[..., k:], x[..., :k]], -1)


def cross(a: Spins, b: Spins) -> Spins:
    """a x b at each site."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def inner(a: Spins, b: Spins) -> Array:
    """<a, b> at each site."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
