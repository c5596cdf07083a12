"""The one door to the array libraries: only this module distinguishes kinds of number."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import timedelta
from itertools import permutations
from typing import Any

import numpy as np

from kreisel.algebra import recorded
from kreisel.algebra.recorded import Recorded

DIAGONAL = 1e-12  # relative: entries off the diagonal
Array = Any  # an array of any library, or a NumPy object array of any field
LINEAR_ALGEBRA: dict[str, Any] = {}  # name of an array library -> replacements of its solve and slogdet


class Ring:
    """A commutative ring by `__add__`, `__neg__` and `__mul__`; for arrays on the other side it acts entry by entry."""

    __slots__ = ()
    __add__: Any
    __neg__: Any
    __mul__: Any

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __sub__(self, other: Any) -> Any:
        return NotImplemented if is_array(other) else self + (-other)

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __pow__(self, exponent: int) -> Any:
        if exponent < 0:
            return 1 / self**-exponent
        power: Any = 1
        for _ in range(exponent):
            power = power * self
        return power


def is_array(x: Any) -> bool:
    """Whether the value is an array, not a number."""
    return isinstance(x, np.ndarray) or bool(getattr(x, "shape", ()))


class Complex(Ring):
    """re + i im over any kind of real number without a complex type (recorded, rational, dual)."""

    __slots__ = ("im", "re")

    def __init__(self, re: Any, im: Any = 0):
        self.re, self.im = re, im

    def __add__(self, other: Any) -> Complex:
        if is_array(other):
            return NotImplemented
        other = as_complex(other)
        return Complex(self.re + other.re, self.im + other.im)

    def __neg__(self) -> Complex:
        return Complex(-self.re, -self.im)

    def __mul__(self, other: Any) -> Complex:
        if is_array(other):
            return NotImplemented
        other = as_complex(other)
        return Complex(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    def __truediv__(self, other: Any) -> Complex:
        if is_array(other):
            return NotImplemented
        if not isinstance(other, Complex):  # in the field of the parts: 1/2 of integers would be a float
            return Complex(self.re / other, self.im / other)
        return self * (1 / other)

    def __rtruediv__(self, other: Any) -> Complex:
        scale = 1 / (self.re * self.re + self.im * self.im)
        return other * Complex(self.re * scale, -self.im * scale)


def as_complex(x: Any) -> Complex:
    """A real number as a complex one."""
    return x if isinstance(x, Complex) else Complex(x)


def holds_objects(x: Array) -> bool:
    """True for a NumPy object array."""
    return hasattr(x, "dtype") and x.dtype.kind == "O"


def objects(numbers: Iterable[Any], shape: tuple[int, ...] | None = None) -> Array:
    """Numbers of any kind as an array of objects, in this shape."""
    entries = list(numbers)
    out = np.empty(len(entries), dtype=object)
    out[:] = entries
    return out if shape is None else out.reshape(shape)


def is_known_zero(x: Array) -> bool:
    """True if every entry is certainly 0; never for tracers of JAX and recorded values."""
    return isinstance(x, np.ndarray) and all(not isinstance(v, Recorded) and v == 0 for v in x.flat)


def identity(n: int) -> Array:
    """The identity as small integers, which promote to every other kind of number."""
    return np.eye(n, dtype=np.int8)


def vec(s: Array) -> Array:
    """A batch of scalars (...), shaped to multiply vectors (..., n)."""
    return s[..., None] if hasattr(s, "ndim") else s


def mat(s: Array) -> Array:
    """A batch of scalars (...), shaped to multiply matrices (..., n, n)."""
    return s[..., None, None] if hasattr(s, "ndim") else s


def solve(A: Array, B: Array) -> Array:
    """A^-1 B for A (..., n, n) and columns B (..., n, k).

    Arrays of a library go to its LAPACK; others, including extended floats, to elimination without pivoting,
    which is safe for A = I - X with X skew, whose symmetric part is I, and whenever the Hermitian part is positive.
    """
    if hasattr(A, "record_solve"):
        return A.record_solve(B)
    if holds_objects(A) or holds_objects(B) or A.dtype.itemsize > (16 if A.dtype.kind == "c" else 8):
        return _eliminate(A, B)[1]
    return _linear_algebra(A).solve(A, B)


def _linear_algebra(A: Array) -> Any:
    space = A.__array_namespace__()
    return LINEAR_ALGEBRA.get(space.__name__, space.linalg)


def _eliminate(A: Array, B: Array) -> tuple[list[Array], Array]:
    """Gaussian elimination without pivoting; the pivots and the solution.  Batch axes allowed."""
    kind = np.result_type(A, B) if A.dtype.kind in "fc" else object
    if A.shape[:-2] != B.shape[:-2]:
        lead = np.broadcast_shapes(A.shape[:-2], B.shape[:-2])
        A, B = (np.broadcast_to(x, (*lead, *x.shape[-2:])) for x in (A, B))
    A, B = A.astype(kind), B.astype(kind)
    n, pivots = A.shape[-1], []
    for k in range(n):
        pivots.append(A[..., k, k : k + 1].copy())
        if k + 1 < n:
            factor = A[..., k + 1 :, k : k + 1] * (1 / A[..., k : k + 1, k : k + 1])
            A[..., k + 1 :, k + 1 :] = A[..., k + 1 :, k + 1 :] - factor * A[..., k : k + 1, k + 1 :]
            B[..., k + 1 :, :] = B[..., k + 1 :, :] - factor * B[..., k : k + 1, :]
    for k in reversed(range(n)):
        tail = A[..., k : k + 1, k + 1 :] @ B[..., k + 1 :, :] if k + 1 < n else 0
        B[..., k : k + 1, :] = (B[..., k : k + 1, :] - tail) * (1 / A[..., k : k + 1, k : k + 1])
    return pivots, B


def principal_axes(A: Array) -> tuple[Array, Array]:
    """The principal values of a symmetric A (3, 3) and axes as columns, right-handed, nearest to the axes of A.

    For JAX's arrays the derivative of the axes of two equal values is 0; off the diagonal it does not exist.
    """
    return _linear_algebra(A).principal_axes(A) if not isinstance(A, np.ndarray) else nearest_axes(A)


def nearest_axes(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`principal_axes` of an array of NumPy."""
    if abs(A - np.diag(np.diag(A))).max() <= DIAGONAL * abs(A).max():
        return np.diag(A), np.eye(3)
    values, axes = np.linalg.eigh(A)
    order = max(permutations(range(3)), key=lambda order: abs(np.diag(axes[:, order])).sum())
    turn = axes[:, order] * np.where(np.diag(axes[:, order]) < 0, -1, 1)
    turn[:, abs(np.diag(turn)).argmin()] *= np.sign(np.linalg.det(turn))
    return values[list(order)], turn


def complex_number(re: Array, im: Array) -> Array:
    """The scalar re + i im, of a complex type of NumPy or of a recorder if there is one."""
    if isinstance(re, np.ndarray | np.floating | float) and not holds_objects(re):
        return re + 1j * im
    return Complex(re, im)


def parts(z: Array) -> tuple[Array, Array]:
    """Real and imaginary part of an array or a scalar; z and None for real z."""
    if isinstance(z, Complex):
        return z.re, z.im
    if holds_objects(z):
        if not any(isinstance(v, Complex) for v in z.flat):
            return z, None
        pairs = [as_complex(v) for v in z.flat]
        return objects((v.re for v in pairs), z.shape), objects((v.im for v in pairs), z.shape)
    if hasattr(z, "record_parts"):
        return z.record_parts()
    return (np.real(z), np.imag(z)) if np.iscomplexobj(z) else (z, None)


def rounded(x: Any) -> Any:
    """Values of more digits as doubles: of NumPy's extended types, of double-doubles."""
    if isinstance(x, Complex):
        return Complex(rounded(x.re), rounded(x.im))
    if isinstance(x, np.ndarray | np.generic):
        if holds_objects(x):
            return objects(map(rounded, x.flat), x.shape)
        return x.astype(complex if x.dtype.kind == "c" else float)
    return getattr(x, "upper", x)


def conjugate(z: Any) -> Any:
    """The conjugate of a complex scalar."""
    return Complex(z.re, -z.im) if isinstance(z, Complex) else np.conj(z)


def together(re: Array, im: Array) -> Array:
    """The complex vectors re + i im; re and im may be complex too."""
    if holds_objects(re) or holds_objects(im):

        def pair(x: Any, y: Any) -> Any:
            return x + Complex(0, 1) * y if isinstance(x, Complex) or isinstance(y, Complex) else Complex(x, y)

        return objects(map(pair, re.flat, im.flat), re.shape)
    return complex_number(re, im)


def joined(*parts: Array) -> Array:
    """The parts along the last axis, in the library of the parts that are not NumPy's."""
    foreign = next((x for x in parts if not isinstance(x, np.ndarray) and hasattr(x, "__array_namespace__")), None)
    return np.concatenate(parts, -1) if foreign is None else foreign.__array_namespace__().concatenate(parts, -1)


def log(x: Array) -> Array:
    """Natural logarithm of a scalar or a batch; dual values define it themselves.

    An exact number has no logarithm in its field: 0 replaces it, so derivatives can be exact.
    """
    if hasattr(x, "log"):
        return x.log()
    if holds_objects(x):
        return objects(map(log, x.flat), x.shape)[()]
    if isinstance(x, float | np.floating | np.ndarray):
        return np.log(x)
    return x.__array_namespace__().log(x) if hasattr(x, "__array_namespace__") else 0 * x


def where_less(x: Array, y: Array, yes: Array, no: Array) -> Array:
    """`yes` if x < y, else `no`, of real x and y; recorded values define it themselves."""
    if isinstance(yes, Complex):
        return Complex(*(where_less(x, y, a, b) for a, b in zip(parts(yes), parts(no), strict=True)))
    return recorded.where_less(x, y, yes, no)


def nearest(x: Array) -> Array:
    """The integer next to x, of two the even one; recorded values define it themselves."""
    return x.nearest() if hasattr(x, "nearest") else np.rint(x)


def if_positive(test: Array, body: Callable[[], Array], values: Array) -> Array:
    """body() (..., d) where a number is positive, else `values`; recorded, a body that is run only there."""
    if hasattr(test, "record_branch"):
        return objects(test.record_branch(lambda: list(body()), list(values)))
    return where_less(0, vec(test), body(), values)


def sqrt(x: Array) -> Array:
    """Square root of a scalar or a batch, Re >= 0; recording scalars define it themselves."""
    if isinstance(x, Complex):
        size = where_less(x.re, 0, -x.re, x.re) + sqrt(x.re * x.re + x.im * x.im)
        larger = sqrt(size / 2)
        smaller = x.im / (2 * larger)
        upright = where_less(x.im, 0, Complex(-smaller, -larger), Complex(smaller, larger))
        return where_less(x.re, 0, upright, Complex(larger, smaller))
    if holds_objects(x):  # plain values may be among others
        return objects((v.sqrt() if hasattr(v, "sqrt") else np.sqrt(v) for v in x.flat), x.shape)
    if hasattr(x, "sqrt"):
        return x.sqrt()
    return x.__array_namespace__().sqrt(x) if hasattr(x, "__array_namespace__") else np.sqrt(x)


def maximum(x: Array, y: Array) -> Array:
    """The larger of two scalars or of each entry of a batch; recorded values define it themselves."""
    return x.maximum(y) if hasattr(x, "maximum") else np.maximum(x, y)


def sign(x: Array) -> Array:
    """-1 for negative entries, else 1; recorded values define it themselves."""
    if hasattr(x, "sign"):
        return x.sign()
    if holds_objects(x):
        return np.array([v.sign() for v in x.flat], dtype=object).reshape(x.shape)
    return np.where(x < 0, -1, 1)


def magnitude(x: Array) -> float:
    """The largest |entry| as a float, 0 for an empty array; for messages and tolerances."""
    x = np.asarray(x)
    if x.dtype.kind == "f":
        return float(abs(x).max(initial=0.0))
    fractions = (int(v.p) / int(v.q) if hasattr(v, "q") and not hasattr(v, "__float__") else v for v in x.flat)
    return max((abs(float(v)) for v in fractions), default=0.0)


def trace_log(A: Array) -> Array:
    """Tr log A = log det A for A (..., n, n) with positive leading minors."""
    if not holds_objects(A):
        return _linear_algebra(A).slogdet(A)[1]
    return sum(log(pivot[..., 0]) for pivot in _eliminate(A, A[..., :1])[0])


# -- real values of any origin as doubles -------------------------------------------------------------


def floats(value: Any) -> Array:
    """Doubles (...) of real values: lists, arrays of NumPy, xarray or JAX, fractions; a copy unless they are doubles.

    NaN, without axes, for everything else: text, dates, complex and truth values, ragged lists, values beyond the range
    of doubles, and values whose meaning would be lost: masked entries, quantities with units.
    """
    if loses(value):
        return np.asarray(np.nan)
    try:
        array = np.asarray(lanes_in_front(value))
        real = array.dtype.kind in "iuf" or (
            array.dtype == object and all(is_number(v) and hasattr(v, "__float__") for v in array.flat)
        )
        if real:
            return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    return np.asarray(np.nan)


def first_not_finite(array: Array) -> str:
    """The first entry of an array that is not finite, with its index and the usual cause; "" for a scalar."""
    place = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
    index = ", ".join(map(str, place))
    return f"{array[place]:g} at index {index}. Usual cause: a missing value; leave its row out" if place else ""


def lanes_in_front(value: Any) -> Any:
    """Array of xarray at one time with its axis `lane` in front: products of arrays may have it elsewhere.

    Any other value is unchanged.
    """
    dims = tuple(getattr(value, "dims", ()))
    return value.transpose("lane", ...) if "lane" in dims[1:] and "time" not in dims else value


def is_number(value: Any) -> bool:
    """Whether one value is a number of any kind that may be real: a fraction, a symbol, a number that records."""
    if isinstance(value, type | timedelta | complex | str | np.generic):
        return isinstance(value, np.generic) and value.dtype.kind in "iuf"
    return hasattr(value, "__mul__") and hasattr(value, "__truediv__")


def loses(value: Any) -> bool:
    """True if an array of the value would lose its masks or its units; lists are searched one level deep."""
    if isinstance(value, list | tuple):
        return any(loses(v) for v in value if not isinstance(v, list | tuple | float | int))
    if isinstance(value, np.ma.MaskedArray):
        return bool(np.ma.is_masked(value))
    return hasattr(value, "magnitude") or (isinstance(value, np.ndarray) and hasattr(value, "unit"))
