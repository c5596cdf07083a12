"""Valid ranges of parameters, shared by the records."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from kreisel.algebra import dot, identity, magnitude
from kreisel.errors import InputError


def nonzero_alpha(alpha, letter):
    """Not 0."""
    if np.asarray(alpha == 0).any():
        raise InputError(
            f"{letter} = I_axial / I_transverse must not be 0: the Legendre transform is singular there, so the "
            f"orientation is undefined. A thin rod has a small {letter} > 0, a flat disc {letter} = 2."
        )


def nonzero_vector(A, letter):
    """Not the zero vector."""
    if np.asarray(dot(A, A) == 0).any():
        raise InputError(
            f"{letter} must not be the zero vector: it points from the fixed point to the centre of mass. "
            "A body held at its centre of mass is the free top (heavy-top with A = 0)."
        )


def distinct(a, letter):
    """Entries distinct."""
    n = a.shape[-1]
    for j in range(n):
        for k in range(j):
            if np.asarray(a[..., j] == a[..., k]).any():
                raise InputError(
                    f"The entries of {letter} must be distinct, since c_jk = (b_j - b_k)/(a_j - a_k); "
                    f"{letter}_{k + 1} = {letter}_{j + 1} were given. For a = b (c = 1) use the system clebsch."
                )


def positive(J, letter):
    if np.asarray(J <= 0).any():
        raise InputError(
            f"The entries of {letter} must be positive, got {np.asarray(J).tolist()}. {letter} is the diagonal of the "
            f"mass tensor sum m x x^T, not the classical moments I: for n = 3, {letter}_1 = (I_2 + I_3 - I_1)/2, ..."
        )


def check_mass_tensor(J, letter):
    """J_j >= 0 and J_j + J_k > 0: one may be 0, that of a flat body."""
    values = np.sort(np.asarray(J), -1)
    if np.asarray(values[..., 0] < 0).any() or np.asarray(values[..., 0] + values[..., 1] <= 0).any():
        raise InputError(
            f"The entries of {letter} must be positive, or one of them 0 (a flat body), got {np.asarray(J).tolist()}. "
            f"{letter} is the diagonal of the mass tensor sum m x x^T, not the classical moments I: for n = 3, "
            f"{letter}_1 = (I_2 + I_3 - I_1)/2, ..."
        )


def moments(J, letter):
    """J_j + J_k > 0 for principal values, so that the kinetic energy -tr(Omega J Omega)/2 is positive."""
    if J.dtype == object:
        d = np.sort(np.diagonal(J, axis1=-2, axis2=-1), -1)
    else:
        d = np.sort(np.linalg.eigvalsh(J), -1)
    if np.asarray(d[..., 0] + d[..., 1] <= 0).any():
        raise InputError(
            f"The mass tensor {letter} needs J_j + J_k > 0 for all pairs of principal values, got {d.tolist()}. "
            f"{letter} is the sum of mass x x^T over the body, not the classical inertia tensor I: "
            f"for n = 3, {letter} = tr(I)/2 - I."
        )


def doubtful_angle(value: Any, name: str) -> Iterator[str]:
    """Sentences on angles, rad, that are beyond their range: pi for those between two axes, 2 pi for others."""
    range_, words = (math.pi, "pi") if name in ("inclination", "tilt") else (2 * math.pi, "2 pi")
    largest = float(np.max(np.abs(value), initial=0.0))
    if largest > 1.001 * range_:
        yield (
            f"{name} = {largest:g} rad is beyond {words}. Usual cause: degrees for radians. "
            f"'{largest:g} deg', where units are read, is {math.radians(largest):.6g}."
        )


def off_diagonal(C, letter):
    """Not diagonal."""
    if magnitude(C * (1 - identity(C.shape[-1]))) == 0:
        raise InputError(
            f"{letter} must be an n x n matrix with {letter}_jk the inverse moment of the plane (j, k), got a "
            "diagonal, which is not used. For n = 3 and inverse moments c1, c2, c3 about the axes give "
            f"{letter} = [[0, c3, c2], [c3, 0, c1], [c2, c1, 0]]."
        )
