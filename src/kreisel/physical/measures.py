"""Values in SI units and inertia tensors, checked."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, floats
from kreisel.errors import InputError, doubt, shown
from kreisel.record.units import AXES, BODY, BodyFrame, si, stated_unit
from kreisel.record.values import CLOSE, by_lane, doubtful_angle, require_body

STANDARD_GRAVITY = 9.80665  # m/s^2, the conventional value (CGPM 1901)


def si_number(value: Any, unit: str, name: str, *, positive: bool = False, least: float = -np.inf) -> float:
    """A finite float in SI, positive or at least `least` if requested, or a quantity with units.

    Raises `InputError`.  Warns with `InputWarning` of plain angles beyond their range.
    """
    array = floats(si(value, unit, name))
    if array.shape != () or not np.isfinite(array) or (positive and array <= 0) or array < least:
        bound = " > 0" if positive else f" >= {least:g}" if np.isfinite(least) else ""
        units = f" in SI units ({unit}), or a quantity such as '1 {unit}'" * (unit != "1")
        raise InputError(f"{name} must be a finite number{bound}{units}, got {shown(value)}.")
    if unit == "rad" and _unitless(value):
        for sentence in doubtful_angle(array, name):
            doubt(sentence)
    return float(array)


def _unitless(value: Any) -> bool:
    """Whether a value is a plain number, or the text of a number."""
    try:
        return not hasattr(value, "units") and not hasattr(value, "to_value") and float(value) is not None
    except (TypeError, ValueError, OverflowError):
        return False


def si_numbers(value: Any, unit: str, name: str, shapes: tuple[tuple[int, ...], ...] = ()) -> Array:
    """Finite floats of one of the shapes, or (..., 3), in SI or with units.  Raises `InputError`."""
    return by_lane(partial(_si_numbers, unit, name, shapes), value, single=lambda a: a.ndim if shapes else 1)


def _si_numbers(unit: str, name: str, shapes: tuple[tuple[int, ...], ...], value: Any) -> Array:
    array = floats(si(value, unit, name))
    fits = array.shape in shapes if shapes else array.shape[-1:] == (3,)
    if not fits or not np.isfinite(array).all():
        expected = " or ".join(map(str, shapes)) or "(..., 3)"
        raise InputError(
            f"{name} must be finite values of shape {expected} in SI units ({unit}), or with units, '1 {unit}' for "
            f"each or (values, '{unit}') for all, got {shown(value)}."
        )
    return array


def direction(value: Any, name: str) -> Array:
    """The unit vector (3,) along a vector.  Raises `InputError` for the zero vector."""
    vector = si_numbers(value, "1", name, ((3,),))
    length = in_range(f"The length of {name}", lambda: np.linalg.norm(vector))
    if not length:
        raise InputError(f"{name}: expected a direction, got the zero vector.")
    return np.asarray(vector / length)


def finite_floats(value: Any, unit: str, name: str) -> Array:
    """Finite floats of any shape, in SI or with units.  Raises `InputError`."""
    array = floats(si(value, unit, name))
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite values, got {algebra.first_not_finite(array) or shown(value)}.")
    return array


def convert_fields(
    body: Any, *, shapes: Any = None, positive: bool = False, least: float = -np.inf, **units: str
) -> None:
    """Fields of a frozen record, converted from quantities to floats in these bounds, or arrays of these shapes, in SI.

    Raises `InputError`.
    """
    for name, unit in units.items():
        value = getattr(body, name)
        number = partial(si_number, positive=positive, least=least)
        object.__setattr__(body, name, si_numbers(value, unit, name, shapes) if shapes else number(value, unit, name))


def require_range(body: Any, *names: str) -> None:
    """Raises `InputError` for attributes that leave the range of doubles."""
    for name in names:
        in_range(name, partial(getattr, body, name))


def in_range(label: str, value: Callable[[], Any]) -> Any:
    """A computed value.  Raises `InputError` if it leaves the range of doubles."""
    try:
        with np.errstate(all="ignore"):
            got = value()
            parts = [np.asarray(entry, dtype=np.float64) for entry in (got if isinstance(got, tuple) else (got,))]
    except (OverflowError, ZeroDivisionError):
        parts = [np.asarray(np.nan)]
    if not all(np.isfinite(entry).all() for entry in parts):
        raise InputError(
            f"{label} leaves the range of doubles: expected data whose products lie between 1e-300 and 1e300 in SI "
            "units, got smaller or larger ones. Usual cause: a wrong unit."
        )
    return got


def momentum_in_body(M: Any, frame: BodyFrame) -> Array:
    """M (..., 3) of a state, or a variable of a run, in kg m^2/s along the axes of the body.

    A variable states its units and axes in its attributes; an array is read as a part of a state.
    """
    unit, size = frame.units["M"]
    momentum = si_numbers(M, unit, "M") * (1.0 if stated_unit(M) else size)
    return momentum if getattr(M, "attrs", {}).get(AXES) == BODY else frame.vectors(momentum)


def attitude_quaternion(value: Any, name: str) -> Array:
    """Unit quaternions (..., 4).  Raises `InputError`."""
    return by_lane(partial(_attitude, name), value, single=lambda a: 1)


def _attitude(name: str, value: Any) -> Array:
    q = floats(value)
    if q.shape[-1:] != (4,) or not (abs((q * q).sum(-1) - 1) < 1e-6).all():
        raise InputError(f"{name}: expected unit quaternions (..., 4) = (w, x, y, z), got {shown(value)}.")
    return algebra.unit(q)


# -- inertia tensors -------------------------------------------------------------------------------


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
