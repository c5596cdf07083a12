"""Valid ranges of parameters, shared by the records."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from kreisel.algebra import dot, identity, magnitude
from kreisel.errors import InputError


def refused(bad, valid, message):
    """A check of a value: `InputError` with the message if some entry is `bad`; `valid` is the range in words."""

    def check(value, letter):
        if np.asarray(bad(value)).any():
            raise InputError(message.format(letter=letter, value=np.asarray(value).tolist()))

    check.__doc__ = valid
    return check


positive = refused(lambda a: a <= 0, "Positive.", "{letter} must be positive, got {value}.")
nonzero_alpha = refused(
    lambda alpha: alpha == 0,
    "Not 0.",
    "{letter} = I_axial / I_transverse must not be 0: the Legendre transform is singular there, so the orientation is "
    "undefined. A thin rod has a small {letter} > 0, a flat disc {letter} = 2.",
)
off_diagonal = refused(
    lambda C: magnitude(C * (1 - identity(C.shape[-1]))) == 0,
    "Not diagonal.",
    "{letter} must be an n x n matrix with {letter}_jk the inverse moment of the plane (j, k), got a diagonal, which "
    "is not used. For n = 3 and inverse moments c1, c2, c3 about the axes give "
    "{letter} = [[0, c3, c2], [c3, 0, c1], [c2, c1, 0]].",
)


def nonzero_vector(A, letter):
    """Not the zero vector."""
    if A.ndim == 1 and A.dtype == np.float64:
        zero = not any(v * v for v in A.tolist())  # a quarter of the time
    else:
        zero = bool(np.asarray(dot(A, A) == 0).any())
    if zero:
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


CLOSE = 1e-12  # of the trace: rounding of the computed moments of a flat body
ROUNDED = 0.02  # of the largest moment: rounding to two or more typed digits


OTHER_POINTS = "moments about different points, or a mass tensor for an inertia tensor"
OF_J = "classical moments I for the mass tensor {J} = sum m x x^T, for n = 3 {J} = tr(I)/2 - I"


def require_body(J: Any, name: str, cause: str = OTHER_POINTS, *, close: float = CLOSE, rod: bool = False) -> None:
    """Raises `InputError` unless J_j >= 0, but for `close`, and J_j + J_k > 0, with `rod` >= 0.

    J (..., n) are the principal values of a mass tensor sum m x x^T: for n = 3 then none of the principal moments
    I_i = J_j + J_k exceeds the sum of the other two.
    """
    values = np.sort(np.asarray(J), -1).reshape(-1, np.shape(J)[-1])
    total, least = values.sum(-1), values[:, 0] + values[:, 1]
    bad = (values[:, 0] < -close * total) | ((total <= 0) if rod else (least <= 0))
    if not bad.any():
        return
    row, size = values[bad][0], total[bad][0]
    if len(row) > 3:
        raise InputError(
            f"{name}: expected a mass tensor sum m x x^T, whose principal values are > 0 but for one that may be 0, "
            f"got {row.tolist()}."
        )
    moments = (size - row)[::-1].tolist()  # increasing
    largest, excess = moments[2], -2 * row[0]
    words = f"No body has the principal moments {', '.join(f'{float(x):.6g}' for x in moments)} ({name}): "
    if moments[0] <= 0:
        raise InputError(f"{words}expected all > 0. Usual cause: {cause}.")
    words += f"the largest exceeds the sum of the other two by {float(excess):.3g}. Usual cause: "
    if excess <= ROUNDED * largest:
        raise InputError(
            f"{words}a flat body whose moments were rounded. Write the largest as the sum of the others, "
            f"{float(largest - excess):.12g}, for which the mass tensor has an entry 0, or type more digits."
        )
    raise InputError(f"{words}{cause}.")


def check_diagonal(J, letter):
    """The diagonal of the mass tensor of a body, which may be flat."""
    require_body(J, letter, OF_J.format(J=letter), close=0)


def check_positive_diagonal(J, letter):
    """The diagonal of the mass tensor of a body that is not flat."""
    check_diagonal(J, letter)
    positive(J, letter)


def check_mass_tensor(J, letter):
    """The mass tensor of a body, (..., n, n), so that the kinetic energy -tr(Omega J Omega)/2 is positive."""
    d = np.diagonal(J, axis1=-2, axis2=-1) if J.dtype == object else np.linalg.eigvalsh(J)
    require_body(d, letter, OF_J.format(J=letter), close=0 if J.dtype == object else CLOSE)


def doubtful_angle(value: Any, name: str) -> Iterator[str]:
    """Sentences on angles, rad, that are beyond their range: pi for those between two axes, 2 pi for others."""
    range_, words = (math.pi, "pi") if name in ("inclination", "tilt") else (2 * math.pi, "2 pi")
    largest = float(np.max(np.abs(value), initial=0.0))
    if largest > 1.001 * range_:
        yield (
            f"{name} = {largest:g} rad is beyond {words}. Usual cause: degrees for radians. "
            f"'{largest:g} deg', where units are read, is {math.radians(largest):.6g}."
        )
