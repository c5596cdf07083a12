"""Derivatives on the rotations and their algebra, expansions along curves, matrices of the proofs, ranks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, identity
from kreisel.lab import exact
from kreisel.lab.exact import jacobian
from kreisel.lab.law import Case
from kreisel.record.contract import System

HALF_LEAF = {3: 2, 4: 4, 5: 6, 6: 9}
SPECTRAL_RANK = {3: 2, 4: 3, 5: 4, 6: 5}


def gradient(function: Callable[[Array], Any], point: Array) -> Array:
    """The gradient of a scalar function of a vector, or of a skew matrix for the pairing <X, Y> = -tr(XY)/2."""
    kinds = ("vector",) if point.ndim == 1 else ("skew",)
    return algebra.restore(jacobian(function, (point,), kinds, len(point))[1], kinds, len(point))[0]


def left_derivative(function: Callable[[Array], Any], g: Array) -> Array:
    """d f: <d f(g), eta> = d/ds f(exp(s eta) g)."""
    return gradient(lambda eta: function(g + eta @ g), 0 * (g - g.T))


def right_derivative(function: Callable[[Array], Any], g: Array) -> Array:
    """d' f: <d' f(g), eta> = d/ds f(g exp(s eta))."""
    return gradient(lambda eta: function(g + g @ eta), 0 * (g - g.T))


def series(x: Any) -> Array:
    """The coefficients of 1, e and e^2 of a number or an array along a curve: e^2 is twice the product of the generators."""
    return np.array([exact.coefficient(x, 0), exact.coefficient(x, 1), exact.coefficient(x, 3) / 2])


def rank(vectors: Array) -> int:
    """The rank of the rows of a rational matrix, by elimination with pivoting."""
    A, count = np.array(vectors, dtype=object), 0
    for column in range(A.shape[1]):
        pivots = count + np.flatnonzero(A[count:, column] != 0)
        if len(pivots):
            A[[count, pivots[0]]] = A[[pivots[0], count]]
            remainder = pivots[1:]
            A[remainder] = A[remainder] - np.multiply.outer(A[remainder, column] / A[count, column], A[count])
            count += 1
    return count


def outer(x: Array) -> Array:
    """x x^T."""
    return x[..., :, None] * x[..., None, :]


def half(w: Array) -> Array:
    """(w - I)/(w + I), written as in the paper."""
    n = w.shape[-1]
    return algebra.solve((w + identity(n)).T, (w - identity(n)).T).T


def trace_log_of(w: Array) -> Any:
    """Tr log(2I + w + w^-1)."""
    return algebra.trace_log(2 * identity(w.shape[-1]) + w + w.T)


def rank_on_leaf(system: System, state: tuple[Array, ...], functions: Sequence[Callable[..., Any]]) -> int:
    """The rank on the leaf of the differentials of functions of the state, at a rational point."""
    space, n = system.space, state[0].shape[-1]
    assert space.casimirs is not None
    slopes = [jacobian(f, state, space.kinds, n)[1] for f in (space.casimirs, *functions)]
    casimirs, *others = [x.reshape(-1, x.shape[-1]) for x in slopes]
    return rank(np.concatenate([casimirs, *others])) - rank(casimirs)


def leaf_rank(case: Case, names: tuple[str, ...]) -> int:
    """The rank on the leaf of the differentials of the energy and the named integrals of a record."""
    system = case.system
    functions = [partial(case.call, f) for f in (system.energy, *(system.integrals[name] for name in names))]
    return rank_on_leaf(system, case.state, functions)
