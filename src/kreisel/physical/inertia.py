"""Inertia tensors, checked, and tensors of homogeneous bodies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.physical.measures import in_range, si_numbers
from kreisel.record.values import CLOSE, require_body


def inertia_tensor(value: Any, name: str = "inertia", *cause: str) -> Array:
    """A classical inertia tensor (3, 3) from itself or its diagonal (3,), in SI or with units.

    Raises `InputError` unless it is symmetric and no principal moment is above the sum of the other two.
    """
    inertia = si_numbers(value, "kg m^2", "inertia", ((3,), (3, 3)))
    inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
    if abs(inertia - inertia.T).max() > CLOSE * abs(inertia).max():
        raise InputError(f"inertia must be symmetric, got {inertia.tolist()}.")
    tensor = in_range("The inertia tensor", lambda: mass_tensor(inertia))
    require_body(np.linalg.eigvalsh(tensor), name, *cause, rod=True)
    return inertia


def require_thickness(inertia: Array) -> None:
    """Raises `InputError` if a principal moment is 0: no momentum determines the spin about its axis."""
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= CLOSE * moments[-1]:
        raise InputError(
            f"inertia: expected three moments > 0, got {', '.join(f'{x:.6g}' for x in moments)} kg m^2. Usual cause: a "
            "rod without thickness. Give it its thickness."
        )


def are_diagonals(value: Any) -> bool:
    """Whether the rows of (3, 3) are moments of three bodies; then it is not a tensor.

    Rows with I_j <= I_jk + I_jl in a symmetric matrix have a trace <= 2 S, S the sum of the products of inertia, and in
    a tensor (1, 1, 1) I (1, 1, 1)^T/3 = (tr I + 2 S)/3 is at most the largest moment, which is at most tr(I)/2.
    """
    try:
        rows = si_numbers(value, "kg m^2", "inertia", ((3, 3),))
    except InputError:
        return False
    return bool((rows >= 0).all() and (2 * rows.max(-1) <= rows.sum(-1) * (1 + CLOSE)).all())


def steiner(mass: float, arm: Array) -> Array:
    """m (|l|^2 - l l^T), (3, 3), kg m^2: the part of an inertia tensor about a point at l from the centre of mass."""
    return np.asarray(in_range("m l^2", lambda: mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))))


def mass_tensor(inertia: Array) -> Array:
    """J = sum m x x^T = tr(I)/2 - I, (3, 3), kg m^2."""
    return np.trace(inertia) / 2 * np.eye(3) - inertia


class Principal(NamedTuple):
    """I = axes diag(moments) axes^T, det(axes) = 1: the axes are the columns."""

    moments: Array
    axes: Array


def principal(inertia: Array) -> Principal:
    """The principal moments and axes of a tensor: in its order if it is diagonal, else in increasing order."""
    if not (inertia - np.diag(np.diag(inertia))).any():
        return Principal(np.diag(inertia).copy(), np.eye(3))
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 1] *= np.sign(np.linalg.det(axes))
    return Principal(np.maximum(moments, 0.0), axes)
