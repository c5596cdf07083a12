"""Kinds of components: skew matrices, vectors, symmetric matrices, orientations, numbers.

Records name a kind by a word, as in ("m", "skew"), and `KINDS` has it by this name.  Components are (..., n, n),
(..., n) or (...), their coordinates (..., d): the entries i < j of a skew matrix, i <= j of a symmetric one, else all.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kreisel.algebra.backend import Array
from kreisel.algebra.cayley import cayley_act, cayley_columns, cayley_conjugate
from kreisel.algebra.skew import act, bracket, coordinates, skew, symmetric, triangle_with_diagonal


@dataclass(frozen=True)
class Kind:
    """Kind of component: its coordinates, and how rotations act on it.

    axes                  axes of a component without those of its batch
    count(n)              number of independent coordinates
    pack(z)               coordinates (..., d) of a component
    unpack(x, n)          component with the coordinates x (..., d)
    rate(X, z)            rate of a component that rotates with the velocity X: X z, or [X, z] for matrices
    rotated(R, z)         component rotated by an orthogonal matrix: R z, or R z R^T
    turned(X, z, axis)    component rotated by cay(X); `axis` as `cayley_conjugate` has it
    """

    name: str
    axes: int
    count: Callable[[int], int]
    pack: Callable[[Array], Array]
    unpack: Callable[[Array, int], Array]
    rate: Callable[[Array, Array], Array] = bracket
    rotated: Callable[[Array, Array], Array] = lambda R, z: R @ z @ R.mT
    turned: Callable[..., Array] = lambda X, z, axis=None: cayley_columns(X, cayley_columns(X, z).mT).mT


def _upper(z: Array) -> Array:
    rows, columns = triangle_with_diagonal(z.shape[-1])
    return z[..., rows, columns]


def _row(name: str, count: Callable[[int], int]) -> Kind:
    return Kind(
        name,
        axes=1,
        count=count,
        pack=lambda z: z,
        unpack=lambda x, n: x,
        rate=act,
        rotated=act,
        turned=lambda X, z, axis=None: cayley_act(X, z),
    )


SKEW = Kind("skew", 2, lambda n: n * (n - 1) // 2, coordinates, skew, turned=cayley_conjugate)
SYMMETRIC = Kind("symmetric", 2, lambda n: n * (n + 1) // 2, _upper, symmetric)
VECTOR = _row("vector", lambda n: n)
MATRIX = Kind(  # an orientation for n > 3
    "matrix",
    axes=2,
    count=lambda n: n * n,
    pack=lambda z: z.reshape((*z.shape[:-2], z.shape[-2] * z.shape[-1])),
    unpack=lambda x, n: x.reshape((*x.shape[:-1], n, n)),
)
QUATERNION = _row("quaternion", lambda n: 4)  # an orientation for n = 3
SCALAR = Kind(
    "scalar",
    axes=0,
    count=lambda n: 1,
    pack=lambda z: (z if hasattr(z, "ndim") else np.asarray(z))[..., None],
    unpack=lambda x, n: x[..., 0][()],
)


class _Kinds(dict[str, Kind]):
    """Kinds by name, among them "R^k", k numbers whatever n is."""

    def __missing__(self, name: str) -> Kind:
        if not name.startswith("R^"):
            raise KeyError(name)
        size = int(name[2:])
        return self.setdefault(name, _row(name, lambda n: size))


KINDS = _Kinds({kind.name: kind for kind in (SKEW, SYMMETRIC, VECTOR, MATRIX, QUATERNION, SCALAR)})


def coordinate_count(kinds: Sequence[str], n: int) -> int:
    """Number of independent coordinates of components of these kinds."""
    return sum(KINDS[kind].count(n) for kind in kinds)


def slices(kinds: Sequence[str], n: int) -> list[slice]:
    """Places of the components of these kinds among their coordinates."""
    ends = np.cumsum([0, *(KINDS[kind].count(n) for kind in kinds)]).tolist()
    return [slice(start, end) for start, end in itertools.pairwise(ends)]


def flatten(parts: Sequence[Array], kinds: Sequence[str]) -> Array:
    """Coordinates (..., d) of components, one after the other, with batch axes that are broadcast."""
    flat = [KINDS[kind].pack(part) for part, kind in zip(parts, kinds, strict=True)]
    library = next((x.__array_namespace__() for x in flat if not isinstance(x, np.ndarray)), np)
    batch = np.broadcast_shapes(*(x.shape[:-1] for x in flat))
    return library.concatenate([library.broadcast_to(x, (*batch, x.shape[-1])) for x in flat], -1)


def restore(flat: Array, kinds: Sequence[str], n: int) -> tuple[Array, ...]:
    """Components of these kinds with the coordinates (..., d); inverse of `flatten`."""
    places = slices(kinds, n)
    return tuple(KINDS[kind].unpack(flat[..., place], n) for kind, place in zip(kinds, places, strict=True))
