"""Kinds of components: skew matrices, vectors, symmetric matrices, orientations, scalars.

Records name a kind by a word, as in ("m", "skew"), and `KINDS` has it by this name.  Components are (..., n, n),
(..., n) or (...), their coordinates (..., d): entries i < j of a skew matrix, i <= j of a symmetric matrix, else all.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kreisel.algebra.backend import Array
from kreisel.algebra.rotations import (
    act,
    axial,
    bracket,
    cayley_act,
    cayley_columns,
    cayley_conjugate,
    coordinates,
    hat,
    reversed_axial,
    skew,
    symmetric,
    triangle,
    triangle_with_diagonal,
)


@dataclass(frozen=True)
class Kind:
    """Kind of component: its coordinates, and how rotations act on it.

    space                 the space of the components, such as so(n)
    axes                  axes of a component without batch axes
    labels                names of these axes in a Dataset; {} for the letter
    count(n)              number of independent coordinates
    pack(z)               coordinates (..., d) of a component
    unpack(x, n)          component with the coordinates x (..., d)
    rate(X, z)            rate of a component that rotates with the velocity X: X z, or [X, z] for matrices
    rotated(R, z)         component rotated by an orthogonal matrix: R z, or R z R^T
    turned(X, z, axis)    component rotated by cay(X); `axis` as `cayley_conjugate` has it
    """

    name: str
    space: str
    axes: int
    labels: tuple[str, ...]
    count: Callable[[int], int]
    pack: Callable[[Array], Array]
    unpack: Callable[[Array, int], Array]
    rate: Callable[[Array, Array], Array] = bracket
    rotated: Callable[[Array, Array], Array] = lambda R, z: R @ z @ R.mT
    turned: Callable[..., Array] = lambda X, z, axis=None: cayley_columns(X, cayley_columns(X, z).mT).mT

    def shape(self, n: int) -> tuple[int, ...]:
        """Shape of a component without its batch."""
        return (self.count(n),) if self.axes == 1 else (n,) * self.axes

    def names(self, letter: str, n: int) -> list[str]:
        """Names of the coordinates: m1, m2, m3 of an axial or other vector; m12, m13, ... for n > 3; m of a scalar."""
        if not self.axes:
            return [letter]
        if self is SKEW and n > 3:
            return [f"{letter}{i + 1}{j + 1}" for i, j in zip(*triangle(n), strict=True)]
        return [f"{letter}{i + 1}" for i in range(self.count(n))]

    def shown(self, n: int) -> Kind:
        """Kind of the user's form of the component: for n = 3 the axial vector of a skew matrix."""
        return VECTOR if self is SKEW and n == 3 else self

    def for_user(self, z: Array) -> Array:
        """Component in the user's form."""
        return axial(z) if self is SKEW and z.shape[-1] == 3 else z

    def from_user(self, value: Array, n: int) -> Array:
        """Component from the user's form; inverse of `for_user`."""
        return value if self.shown(n) is self else hat(value)

    def packed(self, value: Array, n: int) -> Array:
        """Coordinates (..., d) of a component as a user sees it."""
        return self.pack(value) if self.shown(n) is self else reversed_axial(value)


def _upper(z: Array) -> Array:
    rows, columns = triangle_with_diagonal(z.shape[-1])
    return z[..., rows, columns]


def _row(name: str, space: str, labels: tuple[str, ...], count: Callable[[int], int]) -> Kind:
    return Kind(
        name,
        space,
        axes=1,
        labels=labels,
        count=count,
        pack=lambda z: z,
        unpack=lambda x, n: x,
        rate=act,
        rotated=act,
        turned=lambda X, z, axis=None: cayley_act(X, z),
    )


SQUARE = ("row", "column")
SKEW = Kind("skew", "so(n)", 2, SQUARE, lambda n: n * (n - 1) // 2, coordinates, skew, turned=cayley_conjugate)
SYMMETRIC = Kind("symmetric", "Sym(n)", 2, SQUARE, lambda n: n * (n + 1) // 2, _upper, symmetric)
VECTOR = _row("vector", "R^n", ("axis",), lambda n: n)
QUATERNION = _row("quaternion", "S^3", ("quaternion",), lambda n: 4)  # an orientation for n = 3
MATRIX = Kind(  # an orientation for n > 3
    "matrix",
    "O(n)",
    axes=2,
    labels=SQUARE,
    count=lambda n: n * n,
    pack=lambda z: z.reshape((*z.shape[:-2], z.shape[-2] * z.shape[-1])),
    unpack=lambda x, n: x.reshape((*x.shape[:-1], n, n)),
)
SCALAR = Kind(
    "scalar",
    "R",
    axes=0,
    labels=(),
    count=lambda n: 1,
    pack=lambda z: (z if hasattr(z, "ndim") else np.asarray(z))[..., None],
    unpack=lambda x, n: x[..., 0][()],
)
DIMENSION = replace(SCALAR, name="dimension")  # n as a parameter


class _Kinds(dict[str, Kind]):
    """Kinds by name, including "R^k", k entries independent of n."""

    def __missing__(self, name: str) -> Kind:
        if not name.startswith("R^"):
            raise KeyError(name)
        size = int(name[2:])
        return self.setdefault(name, _row(name, name, ("{}_axis",), lambda n: size))


KINDS = _Kinds({kind.name: kind for kind in (SKEW, SYMMETRIC, VECTOR, QUATERNION, MATRIX, SCALAR, DIMENSION)})


def coordinate_count(kinds: Sequence[str], n: int) -> int:
    """Number of independent coordinates of components of these kinds."""
    return sum(KINDS[kind].count(n) for kind in kinds)


def slices(kinds: Sequence[str], n: int) -> list[slice]:
    """Places of the components of these kinds among their coordinates."""
    ends = itertools.accumulate((KINDS[kind].count(n) for kind in kinds), initial=0)
    return [slice(start, end) for start, end in itertools.pairwise(ends)]


def flatten(parts: Sequence[Array], kinds: Sequence[str]) -> Array:
    """Coordinates (..., d) of components, one after the other, with batch axes that are broadcast."""
    flat = [KINDS[kind].pack(component) for component, kind in zip(parts, kinds, strict=True)]
    if all(type(x) is np.ndarray and x.shape[:-1] == flat[0].shape[:-1] for x in flat):
        return np.ascontiguousarray(np.concatenate(flat, -1))  # of skew matrices the columns would be contiguous
    library = next((x.__array_namespace__() for x in flat if not isinstance(x, np.ndarray)), np)
    batch = np.broadcast_shapes(*(x.shape[:-1] for x in flat))
    return library.concatenate([library.broadcast_to(x, (*batch, x.shape[-1])) for x in flat], -1)


def restore(flat: Array, kinds: Sequence[str], n: int) -> tuple[Array, ...]:
    """Components of these kinds with the coordinates (..., d); inverse of `flatten`."""
    places = slices(kinds, n)
    return tuple(KINDS[kind].unpack(flat[..., place], n) for kind, place in zip(kinds, places, strict=True))
