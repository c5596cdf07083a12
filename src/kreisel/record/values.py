"""Parameters and components of states from a user's values: arrays of the right shape, or an `InputError`.

The valid ranges of parameters are shared by the records.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from decimal import Decimal
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, dot, identity, magnitude
from kreisel.errors import InputError, shown
from kreisel.record.table import packed_of

if TYPE_CHECKING:
    from kreisel.record.contract import Parameter, PhaseSpace


SKEW_TOLERANCE = 1e-12
NORM_TOLERANCE = 1e-6  # of the square of a quaternion, which a file may hold in single precision
MOST_N = 4096  # a matrix of n x n doubles then needs 128 MiB
MOST_SHOWN = 100  # entries in the text of an array
CLOSE = 1e-12  # of the trace: rounding of the computed moments of a flat body
ROUNDED = 0.02  # of the largest moment: rounding to two or more typed digits

OTHER_POINTS = "moments about different points, or a mass tensor for an inertia tensor"
OF_J = "classical moments I for the mass tensor {J} = sum m x x^T, for n = 3 {J} = tr(I)/2 - I"
T = TypeVar("T")
Check = Callable[..., T]


def whole_dimension(value: Array, letter: str, system: str) -> int:
    """The n of a parameter.  Raises `InputError` for anything but an integer from 3 on."""
    result = np.unique(value)
    n = int(result[0]) if len(result) == 1 else 0
    if n < 3 or n != result[0]:
        raise InputError(f"{system}'s parameter {letter} is the dimension, an integer from 3 on, got {value.tolist()}.")
    check_dimension(n, f"{system}'s parameter {letter}")
    return n


def numbers(value: Any, name: str) -> Array:
    """An array of finite real values, or of others that can be multiplied.  Raises `InputError`."""
    if type(value) is np.ndarray and value.dtype == np.float64 and np.isfinite(value).all():
        return value.copy()
    if algebra.loses(value):
        raise InputError(f"{name} must be plain values, got a masked entry or a unit: {shown(value)}.")
    try:
        array = np.asarray(algebra.lanes_in_front(value))
    except (ValueError, TypeError):
        raise InputError(f"{name} must be an array of values, got a ragged list: {shown(value)}.") from None
    if array.dtype == object and all(isinstance(v, int | float | Decimal) for v in array.flat):  # some beyond 64 bits
        try:
            array = array.astype(np.float64)
        except OverflowError:
            raise InputError(f"{name} must be values that a double can hold, got {shown(value)}.") from None
    if array.dtype == object and all(map(algebra.is_number, array.flat)):
        return array
    if array.dtype.kind not in "iuf":
        hint = " Units are left out here: `kreisel systems NAME` states them." if array.dtype.kind == "U" else ""
        raise InputError(f"{name} must be real values, got {shown(value)}.{hint}")
    array = array.astype(np.promote_types(array.dtype, np.float64))
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite, got {shown(value)}. Look for NaN or infinity in the input.")
    return array


def axes_of(p: Parameter, value: Array) -> int:
    """The axes of a parameter, without axes of lanes."""
    return value.ndim if p.axes is None else p.axes


def says_lanes(value: Any) -> bool:
    """Whether an array of xarray names its axis of lanes."""
    return "lane" in getattr(value, "dims", ())


def is_vector(value: Any, n: int) -> bool:
    """Whether the last axis of a value can have the n entries of a vector, not n lanes with a named dimension."""
    return shape_of(value)[-1:] == (n,) and getattr(value, "dims", ()) != ("lane",)


def require_one_reading(p: Parameter, value: Any, system: str, sites: Any = None) -> None:
    """Raises `InputError` if an axis may or may not mean lanes: k values for k `sites`, a matrix for its diagonal."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return  # reported elsewhere
    n, name = len(array) if array.ndim else 0, f"{system}'s parameter {p.letter}"
    if says_lanes(value):
        return
    if p.kind == "scalar" and isinstance(sites, int | float | np.number) and array.shape == (sites,):
        raise InputError(
            f"{name}: {n} values for {n} sites may be one for each lane, or one for each site. For {n} lanes give the "
            f"shape ({n}, 1). No parameter here differs from site to site: for that write the flow yourself, as "
            "kr.simulate accepts it."
        )
    if p.diagonal and array.shape == (n, n) and n > 2 and (array == array.T).all():
        raise InputError(
            f"{name}: a symmetric array ({n}, {n}) may be a matrix, or the diagonals of {n} lanes. For a matrix rotate "
            f"to its principal axes and give its diagonal, {n} values; for lanes give xarray.DataArray(..., "
            "dims=('lane', 'axis'))."
        )


def parameter(p: Parameter, system: str, value: Any) -> Array:
    """The array of a parameter; one value per lane may be (lanes, 1).

    Raises `InputError` for another shape or kind of number.
    """
    name = f"{system}'s parameter {p.letter}"
    array = numbers(packed_of(value) if p.kind == "table" else value, name)
    if not array.size:
        raise InputError(f"{name}: expected values, got none. Check how a batch was made.")
    axes = axes_of(p, array)
    if p.kind == "scalar" and array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if p.kind in ("vector", "symmetric") and array.ndim:
        check_dimension(array.shape[-1], name)
    if p.kind == "symmetric" and array.ndim == 1:
        array = array[..., None] * np.eye(array.shape[-1], dtype=np.int8)
    if array.ndim < axes or array.ndim > axes + 1:
        shapes = {
            "scalar": "a number",
            "dimension": "an integer",
            "vector": "n values",
            "symmetric": "an n x n matrix or its diagonal",
            "table": "kr.Table(times, values)",
            "array": f"an array with {axes} axes",
        }
        raise InputError(f"{name} must be {shapes[p.kind]} (with batch axes in front), got shape {array.shape}.")
    if p.kind == "symmetric":
        of_lanes = " For diagonals of several lanes give (lanes, n, n), D[..., None] * np.eye(n)."
        _check_symmetric(array, name, of_lanes if array.ndim == 2 else "")
    return array


def _check_symmetric(array: Array, name: str, remedy: str = "") -> None:
    if array.shape[-1] != array.shape[-2]:
        raise InputError(f"{name} must be square, got shape {array.shape}.{remedy}")
    worst = algebra.magnitude(array - array.mT)
    if worst > SKEW_TOLERANCE * algebra.magnitude(array):
        letter = name.split()[-1]
        raise InputError(f"{name} must be symmetric; {letter} - {letter}^T is up to {worst:.3g}.{remedy}")


def component(letter: str, kind: str, value: Any, n: int, of_bodies: bool, three_lanes: bool = False) -> Array:
    """A component of a state; `of_bodies`: with an axis of bodies, so 3 x 3 values are three axial vectors.

    Else they are a skew matrix, or axial vectors with `three_lanes`.
    """
    name = f"state component {letter}"
    array = numbers(value, name)
    if of_bodies and kind == "skew" and array.shape in ((3,), (3, 3)):
        return algebra.hat(np.atleast_2d(array))
    if kind == "skew" and array.shape == (3, 3) == (n, n):
        return _three_by_three(array, letter, says_lanes(value), three_lanes)
    if kind == "symmetric":
        if array.ndim < 2 or array.shape[-2:] != (n, n):
            raise InputError(f"{name} must be a symmetric matrix (..., {n}, {n}), got shape {array.shape}.")
        _check_symmetric(array, name)
        return array / 2 + array.mT / 2
    if kind == "scalar":
        return array
    if kind != "skew":
        count = algebra.KINDS[kind].count(n)
        expected = f"n = {n}" if kind == "vector" else count
        if array.ndim < 1 or array.shape[-1] != count:
            raise InputError(f"{name} must be {expected} values (..., {count}), got shape {array.shape}.")
        if kind == "quaternion" and algebra.magnitude((array * array).sum(-1) - 1) > NORM_TOLERANCE:
            raise InputError(
                f"{name} must be a unit quaternion (w, x, y, z), got {shown(array.tolist())}. Usual cause: a mean of "
                "attitudes, or angles. Divide it by its norm."
            )
        return array
    if array.ndim >= 2 and array.shape[-2:] == (n, n):
        off = algebra.magnitude(array + array.mT)
        if off <= SKEW_TOLERANCE * max(algebra.magnitude(array), 1):
            return array / 2 - array.mT / 2  # halved first: the difference may overflow
        if n != 3:
            raise InputError(
                f"{name} must be skew ({letter}^T = -{letter}); {letter} + {letter}^T is up to {off:.3g}. "
                f"Usual cause: a full matrix where its skew part ({letter} - {letter}^T)/2 was meant."
            )
    if n == 3 and array.ndim >= 1 and array.shape[-1] == 3:
        return of_axial(array)
    axial = ", or an axial vector (..., 3)" if n == 3 else ""
    raise InputError(
        f"{name} must be a skew matrix (..., {n}, {n}){axial}, with n = {n} as in the parameters, "
        f"got shape {array.shape}."
    )


def of_axial(array: Array) -> Array:
    """The skew matrix of an axial vector."""
    X = algebra.hat(array)
    return X / 2 - X.mT / 2  # the same signs of zeros as for a matrix


def _three_by_three(array: Array, letter: str, lanes: bool, three_lanes: bool) -> Array:
    """3 x 3 values: a skew matrix, or three axial vectors, `lanes` by their dimension.  Raises `InputError`."""
    off = algebra.magnitude(array + array.mT)
    skew = off <= SKEW_TOLERANCE * max(algebra.magnitude(array), 1)
    if lanes or (three_lanes and not skew):
        return of_axial(array)
    if skew and not (three_lanes and algebra.magnitude(array)):
        return array / 2 - array.mT / 2
    which = "is skew, and there are three lanes" if skew else f"{letter} + {letter}^T is up to {off:.3g}"
    raise InputError(
        f"state component {letter}: 3 x 3 values may be a skew matrix, or the axial vectors of three lanes; {which}. "
        f"For three lanes give matrices (3, 3, 3), kreisel.algebra.hat({letter}), or xarray.DataArray({letter}, "
        f"dims=('lane', 'axis')); for one state its axial vector (3,), or of a full matrix its skew part "
        f"({letter} - {letter}^T)/2."
    )


def common_batch(subject: str, batches: Mapping[str, tuple[int, ...]]) -> tuple[int, ...]:
    """The batch of values whose batches these are, by name.  Raises `InputError`."""
    if len(set(batches.values())) == 1:
        return next(iter(batches.values()))
    try:
        return np.broadcast_shapes(*batches.values())
    except ValueError:
        shapes = ", ".join(f"{name} {batch}" for name, batch in batches.items())
        raise InputError(
            f"The batch axes of {subject} do not fit: {shapes}. Give each of them the same lanes, or one value for all "
            "lanes, whose batch is ()."
        ) from None


def require_on_phase_space(space: PhaseSpace, parts: Mapping[str, Array], most: float = SKEW_TOLERANCE) -> None:
    """Raises `InputError` for components whose batches do not fit, or a state off the phase space by over `most`."""
    kinds = zip(parts.items(), space.kinds, strict=True)
    common_batch("the components", {letter: v.shape[: v.ndim - algebra.KINDS[k].axes] for (letter, v), k in kinds})
    for formula, constraint in space.constraints.items():
        off = algebra.magnitude(constraint(*parts.values()))
        sizes = [np.zeros_like(v) + algebra.magnitude(v) for v in parts.values()]
        terms = [algebra.magnitude(constraint(*(k * v for v in sizes))) for k in (0, 1)]
        if off > most * max(terms):  # of the size of its terms: 1 of |x|^2 - 1, |M| |P| of <M, P>
            raise InputError(
                f"The state must lie on {space.name}: {formula} = 0, but it is {off:.3g}. "
                "Usual cause: a component that is not normalised, or not projected across another, such as the "
                "result of a solver (dop853) with its errors."
            )


def check_dimension(n: int, name: str) -> None:
    """Raises `InputError` for an n whose matrices do not fit in any memory."""
    if n > MOST_N:
        raise InputError(
            f"{name}: expected n of at most {MOST_N:,}, got {n:,}. Usual cause: a batch of states or parameters "
            "without the axis of the vectors at its end."
        )


def shape_of(value: Any) -> tuple[int, ...]:
    """The shape of a value, () for lists without a shape, which `component` refuses."""
    try:
        return np.shape(algebra.lanes_in_front(value))
    except (TypeError, ValueError):
        return ()


# -- lanes: checks look at all of them at once, messages name the first bad lane ---------------------------------


def by_lane(check: Check[T], *values: Any, single: Callable[[Any], int]) -> T:
    """check(*values).  Raises `InputError`, for an ensemble with the index and the values of its first bad lane.

    single   the number of axes of one of the values without axes of lanes, which are in front
    """
    try:
        return check(*values)
    except InputError as error:
        arrays = [_array(value) for value in values]
        spread = [a if a is not None and a.ndim > single(a) and len(a) > 1 else None for a in arrays]
        counts = {len(a) for a in spread if a is not None}
        if len(counts) != 1:
            raise

        def fault(lanes: slice | int) -> InputError | None:
            try:
                check(*(v if a is None else a[lanes] for a, v in zip(spread, values, strict=True)))
            except InputError as of_lanes:
                return of_lanes
            return None

        count = counts.pop()
        first, last = 0, count
        while last - first > 1:
            middle = (first + last) // 2
            first, last = (first, middle) if fault(slice(first, middle)) else (middle, last)
        of_lane = fault(first)
        common = first == 0 and fault(count // 2) and fault(count - 1)  # a shape, rather than one of the lanes
        if of_lane is None or common:
            raise
        raise InputError(f"Lane {first}: {of_lane}") from error


def _array(value: Any) -> Array | None:
    """An array that can be cut into lanes and keeps its meaning; None for text, units, masked and ragged values."""
    try:
        array = None if algebra.loses(value) else np.asarray(algebra.lanes_in_front(value))
    except (TypeError, ValueError):
        return None
    return None if array is None or array.dtype.kind not in "biufO" else array


def in_lane(bad: Array) -> str:
    """The first of the lanes (lanes,) that are bad, as " in lane 3"; "" for a single lane."""
    return f" in lane {int(np.argmax(bad))}" if bad.size > 1 else ""


def text_of(value: Array) -> str:
    """All entries of a small array; for a large one, the first, the last and the shape."""
    if value.size <= MOST_SHOWN:
        return str(value.tolist())
    text = np.array2string(value, separator=", ", threshold=MOST_SHOWN, edgeitems=1, max_line_width=10**6)
    return f"{' '.join(text.split())} of shape {value.shape}"


# -- valid ranges ------------------------------------------------------------------------------------------


def refused(bad: Callable[[Array], Any], valid: str, message: str) -> Callable[[Array, str], None]:
    """A check of a value: `InputError` with the message if some entry is `bad`; `valid` is the range in words."""

    def check(value: Array, letter: str) -> None:
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


def nonzero_vector(A: Array, letter: str) -> None:
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


def distinct(a: Array, letter: str) -> None:
    """Entries distinct."""
    n = a.shape[-1]
    for j in range(n):
        for k in range(j):
            if np.asarray(a[..., j] == a[..., k]).any():
                raise InputError(
                    f"The entries of {letter} must be distinct, since the system divides by their differences; "
                    f"{letter}_{k + 1} = {letter}_{j + 1} were given."
                )


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


def check_diagonal(J: Array, letter: str) -> None:
    """The diagonal of the mass tensor of a body, which may be flat."""
    require_body(J, letter, OF_J.format(J=letter), close=0)


def check_positive_diagonal(J: Array, letter: str) -> None:
    """The diagonal of the mass tensor of a body that is not flat."""
    check_diagonal(J, letter)
    positive(J, letter)


def check_mass_tensor(J: Array, letter: str) -> None:
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
