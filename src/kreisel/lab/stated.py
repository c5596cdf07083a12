"""Integrals that a record states, tested exactly: members of the list that an investigation otherwise finds unaided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kreisel.algebra import Array
from kreisel.lab.exact import independent, slopes
from kreisel.lab.fields import PRIMES, Mod, Pole
from kreisel.lab.subject import Subject

LANES = 8  # random points modulo each of two primes: a false integral passes with probability p^-16


@dataclass(frozen=True)
class Stated:
    """One of the functions `Subject.integrals`."""

    what: Subject
    place: int

    def gradient_at(self, point: Array, p: int) -> list[int]:
        """The gradient modulo p at residues (d,)."""
        x = np.array([Mod(np.array([int(v)]), p) for v in point], dtype=object)
        value = _values(self.what, independent(x), p)[self.place]
        rows = slopes(np.array([value, None], dtype=object)[:-1], self.what.dim)[0]
        return [int(np.ravel(v.v if isinstance(v, Mod) else v)[0]) % p for v in rows]

    def __str__(self) -> str:
        return f"stated in the record: number {self.place + 1}"


def stated(what: Subject, seed: int) -> list[Stated]:
    """The integrals of a record that its map conserves, modulo two primes at random points."""
    if what.integrals is None or what.implicit:
        return []
    holds: Array | bool = True
    for p in PRIMES[:2]:
        try:
            points = what.some_orbits(p, seed + 77, LANES, 1)
            old, new = (_values(what, np.array([Mod(v, p) for v in z], dtype=object), p) for z in points)
        except (Pole, TypeError):
            return []
        apart = [a - b for a, b in zip(old, new, strict=True)]
        holds = np.array([isinstance(d, Mod) and not np.any(d.v % p) for d in apart]) & holds
    return [Stated(what, int(i)) for i in np.flatnonzero(holds)]


def _values(what: Subject, x: Array, p: int) -> Array:
    assert what.integrals is not None
    return np.ravel(np.asarray(what.integrals(x, **what.known(p)), dtype=object))
