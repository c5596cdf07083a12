"""Vectors and skew matrices: pairing, wedge, bracket, coordinates, and axial vectors for n = 3."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from kreisel.algebra.backend import Array, mat, vec

SECOND, THIRD = np.array([1, 2, 0]), np.array([2, 0, 1])  # the axes after the first, second and third of space


def dot(x: Array, y: Array) -> Array:
    """<x, y> on R^n."""
    return (x * y).sum(-1)


def pairing(X: Array, Y: Array) -> Array:
    """<X, Y> = -tr(XY)/2 on so(n): the sum over i < j of X_ij Y_ij."""
    if hasattr(X, "record_pairing"):
        return X.record_pairing(Y)
    # one axis after the other: the order of the sum must not depend on the batch
    return (X * Y).sum(-1).sum(-1) / 2


def wedge(x: Array, y: Array) -> Array:
    """The wedge product x ^ y = x y^T - y x^T; then (x ^ y) v = x <y, v> - y <x, v>."""
    if hasattr(x, "record_wedge"):
        return x.record_wedge(y)
    return x[..., :, None] * y[..., None, :] - y[..., :, None] * x[..., None, :]


def act(X: Array, v: Array) -> Array:
    """The product X v for a batch of matrices and vectors."""
    return (X @ v[..., None])[..., 0]


def bracket(X: Array, Y: Array) -> Array:
    """[X, Y] = XY - YX."""
    return X @ Y - Y @ X


def project_out(m: Array, p: Array) -> Array:
    """|p|^2 pi m pi with pi = I - p p^T / |p|^2: the part of m that does not act on p; hat(p <p, m>) for n = 3."""
    if hasattr(m, "record_project_out"):
        return m.record_project_out(p)
    if m.shape[-1] == 3:
        return hat(p * vec(dot(p, axial(m))))
    return mat(dot(p, p)) * m - wedge(act(m, p), p)


@cache
def triangle(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the independent components of so(n), i < j, row by row."""
    return np.triu_indices(n, 1)


@cache
def _unfolding(n: int) -> np.ndarray:
    count = n * (n - 1) // 2
    place = np.full((n, n), 2 * count)
    place[triangle(n)] = np.arange(count)
    place.T[triangle(n)] = np.arange(count) + count
    return place


def coordinates(X: Array) -> Array:
    """The n(n-1)/2 independent components X_ij, i < j, of a skew matrix."""
    rows, columns = triangle(X.shape[-1])
    return X[..., rows, columns]


def skew(x: Array, n: int) -> Array:
    """The skew matrix (..., n, n) with the given independent components (..., n(n-1)/2)."""
    concatenate = np.concatenate if isinstance(x, np.ndarray) else x.__array_namespace__().concatenate
    return concatenate([x, -x, 0 * x[..., :1]], -1)[..., _unfolding(n)]


@cache
def triangle_with_diagonal(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the independent components of a symmetric matrix, i <= j, row by row."""
    return np.triu_indices(n)


@cache
def _symmetric_unfolding(n: int) -> np.ndarray:
    place = np.zeros((n, n), dtype=int)
    place[triangle_with_diagonal(n)] = np.arange(n * (n + 1) // 2)
    return np.maximum(place, place.T)


def symmetric(x: Array, n: int) -> Array:
    """The symmetric matrix (..., n, n) with the given components (..., n(n+1)/2), i <= j."""
    return x[..., _symmetric_unfolding(n)]


# Entries of the skew matrix of an axial vector and of the axial vector of a skew matrix, with their signs: a single
# product of NumPy's doubles, which has the bits of the definitions; the zeros of the diagonal have a sign too.
_OF_AXIAL = np.array([[2, 2, 1], [2, 2, 0], [1, 0, 2]])
_SIGNS_OF_AXIAL = np.array([[-0.0, -1.0, 1.0], [1.0, -0.0, -1.0], [-1.0, 1.0, -0.0]])
_REVERSED, _SIGNS = np.array([2, 1, 0]), np.array([-1, 1, -1], dtype=np.int8)
_ROWS, _COLUMNS = np.array([1, 0, 0]), np.array([2, 2, 1])


def reversed_axial(x: Array) -> Array:
    """The coordinates of a skew 3 x 3 matrix from its axial vector, and the reverse: both reverse the order."""
    return x[..., _REVERSED] * _SIGNS


def hat(v: Array) -> Array:
    """The skew matrix X of an axial vector v, X x = v x x (cross product), n = 3.  Inverse: `axial`."""
    if type(v) is np.ndarray and v.dtype == np.float64:
        return v[..., _OF_AXIAL] * _SIGNS_OF_AXIAL
    return skew(reversed_axial(v), 3)


def axial(X: Array) -> Array:
    """The axial vector of a skew 3 x 3 matrix.  Inverse: `hat`."""
    return X[..., _ROWS, _COLUMNS] * _SIGNS


def cross(x: Array, y: Array) -> Array:
    """The cross product x x y, n = 3."""
    return act(hat(x), y)


def pfaffians(X: Array, *vectors: Array) -> dict[tuple[int, ...], tuple[Any, ...]]:
    """Pfaffians of principal parts of skew X (..., n, n) by their indices, of odd parts with a border v (..., n) each.

    det(diag(d) + X) is the sum of Pf^2 prod d_i, i not in the part, over even parts, and v^T adj(diag(d) + X) w the sum
    of Pf_v Pf_w prod d_i over odd ones, up to terms that are odd in X.  No terms cancel for v = w, d > 0.
    """
    out: dict[tuple[int, ...], tuple[Any, ...]] = {(): (1,)}
    for count in range(1, X.shape[-1] + 1):
        for indices in combinations(range(X.shape[-1]), count):
            columns, members = (vectors, indices) if count % 2 else ((X[..., indices[-1]],), indices[:-1])
            minors = [out[tuple(k for k in members if k != i)][0] for i in members]
            terms = [[(-1) ** j * y[..., i][()] * minors[j] for j, i in enumerate(members)] for y in columns]
            out[indices] = tuple(sum(term[1:], term[0]) for term in terms)
    return out
