"""so(n), e*(n) and the Cayley transform, for any kind of number.

| thing      | convention                                                                     |
|------------|--------------------------------------------------------------------------------|
| pairing    | <X, Y> = -tr(XY)/2 on so(n), Euclidean on R^n                                    |
| wedge      | x ^ y = x y^T - y x^T                                                            |
| Cayley     | cay(X) = (I + X)(I - X)^-1                                                       |
| n = 3      | hat(v) x = v x x (cross product), so x ^ y = hat(y x x)                           |
| batch axes | in front: skew matrices are (..., n, n), vectors (..., n), scalars (...)          |

Every function works on NumPy and JAX arrays and on NumPy object arrays of any field (fractions,
python-flint rationals, SymPy expressions, the recording scalars of `kreisel.engines.trace`).
Only this module knows which kind it has before it.  [Suris 2001, sections 2 and 4]
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

Array = Any  # an array of any library, or a NumPy object array of any field


# -- the one door to the array library ------------------------------------------------------------

LINEAR_ALGEBRA: dict[str, Any] = {}  # name of an array library -> solve and slogdet, where its own do not serve


def exact(x: Array) -> bool:
    """True for numbers without round-off (an object array of a field), False for floats and their records.

    One recorded number anywhere makes an array inexact: its zeros, as on the diagonal of a skew matrix, are plain.
    """
    return holds_objects(x) and not any(getattr(entry, "inexact", False) for entry in x.flat)


def holds_objects(x: Array) -> bool:
    """True for a NumPy object array."""
    return hasattr(x, "dtype") and x.dtype.kind == "O"


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

    Numbers of a library go to its LAPACK; others, extended floats among them, to elimination without pivoting,
    which is safe for A = I - X with X skew, whose symmetric part is I, and whenever the Hermitian part is positive.
    """
    if hasattr(A, "record_solve"):
        return A.record_solve(B)
    if holds_objects(A) or holds_objects(B) or A.dtype.itemsize > _double(A).itemsize:
        return _eliminate(A, B)[1]
    return _linear_algebra(A).solve(A, B)


def _linear_algebra(A: Array) -> Any:
    space = A.__array_namespace__()
    return LINEAR_ALGEBRA.get(space.__name__, space.linalg)


def _double(A: Array) -> np.dtype[Any]:
    return np.dtype(np.complex128 if A.dtype.kind == "c" else np.float64)


def _eliminate(A: Array, B: Array) -> tuple[list[Array], Array]:
    """Gaussian elimination without pivoting; the pivots and the solution.  Batch axes allowed."""
    kind = np.result_type(A, B) if A.dtype.kind in "fc" else object
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


def through_inverse(S: Array, A: Array) -> tuple[Array, Array, Array]:
    """A^T S^-1 A, A S^-1 A^T and A S^-1 A for S (..., n, n) symmetric and positive.

    Numbers without a LAPACK go by S = L D L^T: of the symmetric products a record then keeps what is asked for.
    """
    if not holds_objects(S):
        B = solve(S, A)
        return A.mT @ B, A @ solve(S, A.mT), A @ B
    n = S.shape[-1]
    S, B = S.astype(object), np.concatenate([A, A.mT], -1).astype(object)
    for k in range(n - 1):
        factor = S[..., k, k + 1 :, None] * (1 / S[..., k, k, None, None])
        S[..., k + 1 :, k + 1 :] = S[..., k + 1 :, k + 1 :] - factor * S[..., k : k + 1, k + 1 :]
        B[..., k + 1 :, :] = B[..., k + 1 :, :] - factor * B[..., k : k + 1, :]
    scaled = B / S.diagonal(axis1=-2, axis2=-1)[..., None]
    left, right = B[..., :n].mT, B[..., n:].mT
    return left @ scaled[..., :n], right @ scaled[..., n:], right @ scaled[..., :n]


class Complex:
    """re + i im over any kind of real number that brings no complex numbers of its own (recorded, rational, dual)."""

    __slots__ = ("im", "re")

    def __init__(self, re: Any, im: Any = 0):
        self.re, self.im = re, im

    @property
    def inexact(self) -> bool:
        """True for floats and their records."""
        return any(isinstance(v, float) or getattr(v, "inexact", False) for v in (self.re, self.im))

    def __add__(self, other: Any) -> Complex:
        if _is_array(other):
            return NotImplemented
        other = _complex(other)
        return Complex(self.re + other.re, self.im + other.im)

    __radd__ = __add__

    def __neg__(self) -> Complex:
        return Complex(-self.re, -self.im)

    def __sub__(self, other: Any) -> Complex:
        return NotImplemented if _is_array(other) else self + (-_complex(other))

    def __rsub__(self, other: Any) -> Complex:
        return (-self) + other

    def __mul__(self, other: Any) -> Complex:
        if _is_array(other):
            return NotImplemented
        other = _complex(other)
        return Complex(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Complex:
        if _is_array(other):
            return NotImplemented
        if not isinstance(other, Complex):  # in the field of the parts: 1/2 of integers would be a float
            return Complex(self.re / other, self.im / other)
        return self * (1 / other)

    def __rtruediv__(self, other: Any) -> Complex:
        scale = 1 / (self.re * self.re + self.im * self.im)
        return other * Complex(self.re * scale, -self.im * scale)


def _is_array(x: Any) -> bool:
    return isinstance(x, np.ndarray) or bool(getattr(x, "shape", ()))


def _complex(x: Any) -> Complex:
    return x if isinstance(x, Complex) else Complex(x)


def complex_number(re: Array, im: Array) -> Array:
    """The scalar re + i im, of NumPy's or a recorder's own kind where there is one."""
    if hasattr(re, "record_complex"):
        return re.record_complex(im)
    if isinstance(re, np.ndarray | np.floating | float) and not holds_objects(re):
        return re + 1j * im
    return Complex(re, im)


def parts(z: Array) -> tuple[Array, Array]:
    """Real and imaginary part of an array or a scalar; of real numbers z and None."""
    if isinstance(z, Complex):
        return z.re, z.im
    if holds_objects(z):
        if not any(isinstance(v, Complex) for v in z.flat):
            return z, None
        re, im = np.empty(z.shape, dtype=object), np.empty(z.shape, dtype=object)
        for place in np.ndindex(z.shape):
            re[place], im[place] = _complex(z[place]).re, _complex(z[place]).im
        return re, im
    if hasattr(z, "record_parts"):
        return z.record_parts()
    return (np.real(z), np.imag(z)) if np.iscomplexobj(z) else (z, None)


def conjugate(z: Any) -> Any:
    """The conjugate of a complex scalar."""
    return Complex(z.re, -z.im) if isinstance(z, Complex) else np.conj(z)


def log(x: Array) -> Array:
    """Natural logarithm of a scalar or a batch; dual numbers bring their own.

    An exact number has no logarithm in its field: 0 stands for it, so that derivatives can be exact.
    """
    if hasattr(x, "log"):
        return x.log()
    if isinstance(x, float | np.floating | np.ndarray):
        return np.log(x)
    return x.__array_namespace__().log(x) if hasattr(x, "__array_namespace__") else 0 * x


def sqrt(x: Array) -> Array:
    """Square root of a scalar or a batch; recording scalars bring their own."""
    return x.sqrt() if hasattr(x, "sqrt") else np.sqrt(x)


def maximum(x: Array, y: Array) -> Array:
    """The larger of two scalars or of each entry of a batch; recorded numbers bring their own."""
    return x.maximum(y) if hasattr(x, "maximum") else np.maximum(x, y)


def sign(x: Array) -> Array:
    """-1 where an entry is negative, else 1; recorded numbers bring their own."""
    if holds_objects(x):
        return np.array([v.sign() for v in x.flat], dtype=object).reshape(x.shape)
    return np.where(x < 0, -1, 1)


def magnitude(x: Array) -> float:
    """The largest |entry| as a float, 0 for an empty array; for messages and tolerances."""
    x = np.asarray(x)
    if x.dtype.kind == "f":
        return float(abs(x).max(initial=0.0))
    return max((abs(_as_float(v)) for v in x.flat), default=0.0)


def _as_float(v: Any) -> float:
    return int(v.p) / int(v.q) if hasattr(v, "q") and not hasattr(v, "__float__") else float(v)


def trace_log(A: Array) -> Array:
    """Tr log A = log det A for A (..., n, n) with positive leading minors."""
    if not holds_objects(A):
        return _linear_algebra(A).slogdet(A)[1]
    return sum(log(pivot[..., 0]) for pivot in _eliminate(A, A[..., :1])[0])


def product_error(x: Array, y: Array, p: Array) -> Array:
    """x y - p for p = x y rounded, without a rounding error; 0 for exact numbers."""
    if holds_objects(p):
        x, y = np.broadcast_arrays(x, y)
        out = np.empty(p.shape, dtype=object)
        for place in np.ndindex(p.shape):
            out[place] = product_error(x[place], y[place], p[place])
        return out
    if hasattr(x, "record_product_error"):
        return x.record_product_error(y, p)
    if hasattr(y, "record_product_error"):
        return y.record_product_error(x, p)
    if not isinstance(x, float | np.floating | np.ndarray):
        return 0 * p

    def split(v: Array) -> tuple[Array, Array]:
        big = v * 134217729.0  # 2^27 + 1
        high = big - (big - v)
        return high, v - high

    (a, b), (c, d) = split(x), split(y)
    return b * d - (((p - a * c) - b * c) - a * d)


def two_sum(x: Array, y: Array) -> tuple[Array, Array]:
    """x + y rounded, and its rounding error."""
    if holds_objects(x) or holds_objects(y):
        x, y = np.broadcast_arrays(x, y)
        total, error = np.empty(x.shape, dtype=object), np.empty(x.shape, dtype=object)
        for place in np.ndindex(x.shape):
            total[place], error[place] = two_sum(x[place], y[place])
        return total, error
    if hasattr(x, "record_two_sum"):
        return x.record_two_sum(y)
    if hasattr(y, "record_two_sum"):
        return y.record_two_sum(x)
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)


def sharp_dot(x: Array, y: Array, c: Array) -> Array:
    """<x, y> - c for real vectors, rounded once: sums of squares that hardly change else have a steady error."""
    if _plain(x) or _plain(y):
        return dot(x, y) - c
    total, rest = 0 - c, 0.0
    for i in range(x.shape[-1]):
        p = x[..., i] * y[..., i]
        total, error = two_sum(total, p)
        rest = rest + (product_error(x[..., i], y[..., i], p) + error)
    return total + rest


def dot_less(x: Array, y: Array, c: Array) -> Array:
    """<x, y> - c, real or complex, rounded once."""
    (xr, xi), (yr, yi), (re, im) = parts(x), parts(y), parts(c)
    if xi is None and yi is None:
        return sharp_dot(xr, yr, re)
    xi, yi, im = (0 * b if a is None else a for a, b in ((xi, xr), (yi, yr), (im, re)))
    if _plain(xr):
        return complex_number(dot(xr, yr) - dot(xi, yi) - re, dot(xr, yi) + dot(xi, yr) - im)
    both = np.concatenate([xr, xi], -1)
    real = sharp_dot(both, np.concatenate([yr, -yi], -1), re)
    return complex_number(real, sharp_dot(both, np.concatenate([yi, yr], -1), im))


def _plain(x: Array) -> bool:
    """Numbers without round-off, and recorded arrays, whose products are not corrected."""
    return exact(x) or hasattr(x, "record_parts")


def quotient(a: Array, da: Array, b: Array, db: Array) -> tuple[Array, Array]:
    """(a + da)/(b + db) as q and a small rest, for da, db about the rounding errors of a, b."""
    q = a / b
    return q, ((a - q * b) + (da - q * db)) / b


# -- vectors, skew matrices -----------------------------------------------------------------------


def dot(x: Array, y: Array) -> Array:
    """<x, y> on R^n."""
    return (x * y).sum(-1)


def pairing(X: Array, Y: Array) -> Array:
    """<X, Y> = -tr(XY)/2 on so(n): the sum over i < j of X_ij Y_ij."""
    # one axis after the other: the order of the sum must not depend on the batch
    return (X * Y).sum(-1).sum(-1) / 2


def wedge(x: Array, y: Array) -> Array:
    """The wedge product x ^ y = x y^T - y x^T; then (x ^ y) v = x <y, v> - y <x, v>."""
    if hasattr(x, "record_wedge"):
        return x.record_wedge(y)
    return x[..., :, None] * y[..., None, :] - y[..., :, None] * x[..., None, :]


GENERIC = 1 + 2**-20 * (0.5 + 1.25**0.5)  # as no short fraction is


def increment(s: Array, x: Array) -> Array:
    """The product s x, to be added to a momentum: (s/c) (c x), c = GENERIC.

    Rounding errors of m + s x need not cancel where s is a short decimal: for s = 1/10 what falls off the last place is
    a multiple of 1/20 of it, whatever x.  With eps = 0.1 and 0.2 the energy of the symmetric top then changed by
    1.3e-19 and -3.0e-19 a step, alike from 65 536 states, 3 bands of round-off after 1e8 steps.  The rounding error of
    c x spreads s c x evenly over the multiples between; c is close to 1, so that it goes just as far as they are apart.
    """
    return s * x if exact(x) else s / GENERIC * (GENERIC * x)


def increment_rest(s: Array, x: Array) -> Array:
    """The small r with which `increment`(s, x) is (s + r) x, but for rounding errors that go with x."""
    if exact(x):
        return 0 * s
    part = s / GENERIC
    return (part - s) + part * (GENERIC - 1)


def impulse(s: Array, x: Array, y: Array) -> Array:
    """The wedge product s x ^ y of a constant y, to be added to a momentum: (s/c) x ^ (c y), as `increment`."""
    if exact(x):
        return s * wedge(x, y)
    if hasattr(x, "record_wedge"):  # y is known there by its name
        return s / GENERIC * wedge(GENERIC * x, y)
    return s / GENERIC * wedge(x, GENERIC * y)


def act(X: Array, v: Array) -> Array:
    """The product X v for a batch of matrices and vectors."""
    return (X @ v[..., None])[..., 0]


def bracket(X: Array, Y: Array) -> Array:
    """[X, Y] = XY - YX."""
    return X @ Y - Y @ X


def project_out(m: Array, p: Array) -> Array:
    """|p|^2 pi m pi with pi = I - p p^T / |p|^2: the part of m that does not touch p; hat(p <p, m>) for n = 3."""
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


def coordinates_of(kind: str, z: Array) -> Array:
    """The independent coordinates (..., d) of a component of the state."""
    if kind == "skew":
        return coordinates(z)
    if kind == "symmetric":
        rows, columns = triangle_with_diagonal(z.shape[-1])
        return z[..., rows, columns]
    return z


def _matrix_of(kind: str, x: Array, n: int) -> Array:
    if kind == "matrix":
        return x.reshape((n, n))
    return skew(x, n) if kind == "skew" else symmetric(x, n)


def hat(v: Array) -> Array:
    """The skew matrix X of an axial vector v, X x = v x x (cross product), n = 3.  Inverse: `axial`."""
    return skew(v[..., np.array([2, 1, 0])] * np.array([-1, 1, -1], dtype=np.int8), 3)


def axial(X: Array) -> Array:
    """The axial vector of a skew 3 x 3 matrix.  Inverse: `hat`."""
    return coordinates(X)[..., np.array([2, 1, 0])] * np.array([-1, 1, -1], dtype=np.int8)


State = tuple[Array, ...]


def repeat(
    improve: Callable[..., tuple[State, Array]], start: State, small: float, most: int, kinds: tuple[str, ...]
) -> tuple[State, Array]:
    """X, defect = improve(*X) from matrices X of the given kinds until defect <= small, at most `most` times.

    Recorded numbers make a loop of it.  Dual numbers go on, for their slopes, twice as long as their values need.
    Numbers without an order go all the way.
    """
    X, first = start, start[0]
    if hasattr(first, "record_loop"):
        return first.record_loop(improve, X, small, most)
    objects = any(map(holds_objects, X))
    recorded = [v for part in X for v in part.flat if hasattr(v, "record_loop")] if objects else []
    if recorded:
        n = first.shape[-1]
        edges = np.cumsum([0, *(coordinates_of(kind, part).size for kind, part in zip(kinds, X, strict=True))])

        def joined(X: State) -> Array:
            return np.concatenate([coordinates_of(kind, part).ravel() for kind, part in zip(kinds, X, strict=True)])

        def parted(x: Array) -> State:
            pieces = (x[a:b] for a, b in itertools.pairwise(edges))
            return tuple(_matrix_of(kind, piece, n) for kind, piece in zip(kinds, pieces, strict=True))

        def on_coordinates(x: Array) -> tuple[Array, Array]:
            Y, defect = improve(*parted(x))
            return joined(Y), defect

        x, defect = recorded[0].record_loop(on_coordinates, joined(X), small, most)
        return parted(x), defect
    last = most
    for k in range(most):
        X, defect = improve(*X)
        if not objects and (defect <= small).all():
            break
        if last == most and objects and getattr(defect, "value", 1) <= small:
            last = 2 * k + 2
        if k == last:
            break
    return X, defect


# -- Cayley ---------------------------------------------------------------------------------------


def plain_resolvent(X: Array, V: Array) -> Array:
    """(I - X)^-1 V for columns V, once; for n = 3 in closed form (I + X + u u^T)/(1 + |u|^2), X = hat(u)."""
    if X.shape[-1] != 3:
        return solve(identity(X.shape[-1]) - X, V)
    u = axial(X)[..., :, None]
    return (_add_product(V, X, V) + u * (u * V).sum(-2)[..., None, :]) * _scale(X)


def _scale(X: Array) -> Array:
    """1/(1 + |u|^2) for n = 3 and X = hat(u), to multiply columns."""
    u = axial(X)
    return 1 / mat(1 + (u * u).sum(-1))


def _add_product(C: Array, X: Array, V: Array) -> Array:
    """C + X V: object arrays are summed from C on, each product fused into the sum unrounded where they know how."""
    if not holds_objects(C):
        return C + X @ V
    for k in range(X.shape[-1]):
        C = _fused(X[..., :, k : k + 1], V[..., k : k + 1, :], C)
    return C


def _fused_number(x: Any, y: Any, z: Any) -> Any:
    for a, b in ((x, y), (y, x)):
        if hasattr(a, "record_fma"):
            return a.record_fma(b, z)
    return x * y + z


_fused = np.frompyfunc(_fused_number, 3, 1)


def close_sum(V: Array, Y: Array, small: Array) -> Array:
    """V + Y + small, where `small` is about the rounding error of V + Y: that error is added too (two-sum)."""
    if exact(V):
        return V + Y + small
    Z = V + Y
    part = Z - V
    return Z + (((V - (Z - part)) + (Y - part)) + small)


def shifted_resolvent(mu: Array, X: Array, v: Array) -> Array:
    """(mu - X)^-1 v for X (..., n, n) skew, v (..., n) and a scalar mu with Re mu != 0; any of them complex."""
    if X.shape[-1] != 3:
        A = X.record_shifted(mu) if hasattr(X, "record_shifted") else mat(mu) * identity(X.shape[-1]) - X
        return solve(A, v[..., None])[..., 0]
    u, square = axial(X), mu * mu
    scale = 1 / (mu * (square + dot(u, u)))
    return vec(scale) * (vec(square) * v + vec(mu) * act(X, v) + u * vec(dot(u, v)))


def shifted_residual(mu: Array, X: Array, e: Array, *terms: tuple[Array, ...]) -> Array:
    """Sum of s v and s c e over the terms (s, v) and (s, c, e), less (mu - X) e, for real X, v and c; rounded once."""
    er, ei = parts(e)
    if _plain(X):
        out = together(act(X, er), act(X, ei)) if ei is not None else act(X, er)
        return sum((vec(s) * (v * more[0] if more else v) for s, v, *more in terms), out - vec(mu) * e)
    re, im = _scaled(mu, -e)
    for s, v, *more in terms:
        if not more:
            (sr, si), one_re, one_im = parts(s), [], []
            one_re, one_im = [(vec(sr), v)], [] if si is None else [(vec(si), v)]
        else:
            one_re, one_im = _scaled_diagonal(s, v, more[0])
        re, im = re + one_re, im + one_im
    for k in range(X.shape[-1]):
        re = [*re, (X[..., :, k], er[..., k : k + 1])]
        im = im if ei is None else [*im, (X[..., :, k], ei[..., k : k + 1])]
    return sharp_sum(re) if ei is None else together(sharp_sum(re), sharp_sum(im))


def remainder(v: Array, s: Array, x: Array) -> Array:
    """v - s x for a scalar s, rounded once."""
    (vr, vi), (re, im) = parts(v), _scaled(s, -x)
    if _plain(vr):
        return v - vec(s) * x
    one = 1 + 0 * vr
    re, im = [(one, vr), *re], im if vi is None else [(one, vi), *im]
    return together(sharp_sum(re), sharp_sum(im)) if im else sharp_sum(re)


def sharp_act(X: Array, x: Array, small: Array) -> Array:
    """X x + small for `small` about the rounding error of X x, rounded once."""
    if _plain(X):
        return act(X, x) + small
    return sharp_sum([*((X[..., :, k], x[..., k : k + 1]) for k in range(x.shape[-1])), (1 + 0 * small, small)])


def _scaled(s: Array, v: Array) -> tuple[list[tuple[Array, Array]], list[tuple[Array, Array]]]:
    """Products that add up to the real and to the imaginary part of s v."""
    (sr, si), (vr, vi) = parts(s), parts(v)
    re, im = [(vec(sr), vr)], []
    if vi is not None:
        im = [(vec(sr), vi)]
    if si is not None:
        im = [*im, (vec(si), vr)]
    if si is not None and vi is not None:
        re = [*re, (vec(si), -vi)]
    return re, im


def _scaled_diagonal(s: Array, c: Array, v: Array) -> tuple[list[tuple[Array, Array]], list[tuple[Array, Array]]]:
    """The same for s c v with real c, each product s c in two pieces."""
    (sr, si), (vr, vi) = parts(s), parts(v)
    r = vec(sr) * c
    dr = product_error(vec(sr), c, r)
    if vi is None:
        return [(r, vr), (dr, vr)], []
    i = vec(si) * c
    di = product_error(vec(si), c, i)
    return [(r, vr), (i, -vi), (dr, vr), (di, -vi)], [(r, vi), (i, vr), (dr, vi), (di, vr)]


def sharp_sum(products: list[tuple[Array, Array]]) -> Array:
    """The sum of the products, rounded once."""
    if any(exact(x) and exact(y) for x, y in products):
        return sum(x * y for x, y in products)
    total, rest = products[0][0] * products[0][1], 0.0
    rest = product_error(*products[0], total)
    for x, y in products[1:]:
        p = x * y
        total, error = two_sum(total, p)
        rest = rest + (product_error(x, y, p) + error)
    return total + rest


def together(re: Array, im: Array) -> Array:
    """The complex vectors re + i im; re and im may be complex too."""
    if holds_objects(re) or holds_objects(im):
        out = np.empty(re.shape, dtype=object)
        for place in np.ndindex(re.shape):
            x, y = re[place], im[place]
            both = isinstance(x, Complex) or isinstance(y, Complex)
            out[place] = x + Complex(0, 1) * y if both else Complex(x, y)
        return out
    return complex_number(re, im)


def diagonal_resolvent(d: Array, X: Array, v: Array) -> Array:
    """(diag(d) + X)^-1 v for X (..., n, n) skew, d and v (..., n) with Re d > 0; any of them complex."""
    if X.shape[-1] != 3:
        return solve(d[..., None] * identity(X.shape[-1]) + X, v[..., None])[..., 0]
    u, (i, j, k) = axial(X), (d[..., 0], d[..., 1], d[..., 2])
    minors = np.stack([j * k, k * i, i * j], -1)
    scale = 1 / (i * minors[..., 0] + dot(u, d * u))
    return vec(scale) * (minors * v + u * vec(dot(u, v)) - cross(d * u, v))


def resolvent(X: Array, V: Array) -> Array:
    """(I - X)^-1 V for X (..., n, n) skew and columns V (..., n, k), corrected once by its residual."""
    Y = plain_resolvent(X, V)
    return Y if exact(X) else Y + plain_resolvent(X, _add_product(V - Y, X, Y))


def cayley_columns(X: Array, V: Array) -> Array:
    """cay(X) V = V + Y, (I - X) Y = 2 X V, for columns V (..., n, k); Y corrected once by its residual.

    The rounding error of 1/(1 + |u|^2) hardly changes along an orbit: without the correction |a|^2 drifts
    steadily.  Nor may the residual come out as a few units in the last place, or adding it rounds to one side.
    Worst change of |a|^2 in bands sqrt(steps) ulp over 1e7 steps of the Lagrange top, n = 3, four states with
    eps = 0.05 to 1.65: 1287 without; 68 for V + 2 X Y with Y = (I - X)^-1 V corrected; 5.1 here with the residual
    rounded twice; 1.4 with its products fused, as kernels have them; half of that when the last sum is rounded
    once.  For n = 4 the residual as X (2V + Y) - Y still left 2.6 bands after 1e8 steps, by the rounding of
    2V + Y; X 2V - Y + X Y, as here, leaves no trend.
    """
    twice = 2 * X
    W = twice @ V  # for n = 3 orthogonal to u
    Y = _add_product(W, X, W) * _scale(X) if X.shape[-1] == 3 else plain_resolvent(X, W)
    return V + Y if exact(X) else close_sum(V, Y, plain_resolvent(X, _add_product(_add_product(-Y, twice, V), X, Y)))


def cayley_act(X: Array, v: Array) -> Array:
    """cay(X) v = (I - X)^-1 (I + X) v for X (..., n, n) skew and v (..., n): never singular for real X."""
    return cayley_columns(X, v[..., None])[..., 0]


def cayley(X: Array) -> Array:
    """cay(X) = (I + X)(I - X)^-1, orthogonal for skew X (..., n, n); cay(-X) is its inverse."""
    return cayley_columns(X, identity(X.shape[-1]) + 0 * X)


def cayley_conjugate(X: Array, M: Array) -> Array:
    """cay(X) M cay(X)^-1 for skew X and M (..., n, n); for n = 3 the turned axial vector."""
    if hasattr(M, "record_conjugate"):
        return M.record_conjugate(X)
    if X.shape[-1] == 3:
        return hat(cayley_act(X, axial(M)))
    return cayley_columns(X, cayley_columns(X, M).mT).mT


def rate(kind: str, X: Array, z: Array) -> Array:
    """How a component changes that turns with the velocity X: X z for vectors, [X, z] for matrices."""
    return act(X, z) if kind == "vector" else bracket(X, z)


def turned(kind: str, X: Array, z: Array) -> Array:
    """A component turned by cay(X): cay(X) z for vectors, cay(X) z cay(X)^T for matrices."""
    if kind == "vector":
        return cayley_act(X, z)
    return cayley_conjugate(X, z) if kind == "skew" else cayley_columns(X, cayley_columns(X, z).mT).mT


def cayley_plane(x: Array, y: Array, v: Array) -> Array:
    """cay(x ^ y) v in O(n), for vectors (..., n); corrected by the residual like `cayley_columns`."""
    X, Y, c = dot(x, x), dot(y, y), dot(x, y)
    scale = 1 / (1 + X * Y - c * c)

    def once(v: Array) -> Array:
        xv, yv = dot(x, v), dot(y, v)
        along_y, along_x = ((1 + c) * yv - Y * xv) * scale, ((1 - c) * xv + X * yv) * scale
        return v + (x * vec(along_y) - y * vec(along_x))

    def add_turn(w: Array, u: Array) -> Array:  # w + (x ^ y) u
        return (w + x * vec(dot(y, u))) - y * vec(dot(x, u))

    w = once(2 * add_turn(0 * v, v))
    return v + w if exact(v) else close_sum(v, w, once(add_turn(add_turn(-w, 2 * v), w)))


def half_turn(x: Array, dx: Array, v: Array) -> Array:
    """R_(x + dx) v = 2 x <x, v>/<x, x> - v for a small dx; what rounding does to |v| is taken back."""
    square = dot(x, x)
    t = 2 * dot(x, v) / square
    change = remainder(2 * v, t, x)  # v - R_x v, which is orthogonal to x
    along = (dot(x, change) + dot(dx, change) - t * dot(x, dx)) / square
    return close_sum(v, -change, vec(along) * x + vec(t) * dx)


def moebius(X: Array) -> Array:
    """(I + X)(I - X)^-1 for any matrix X (..., n, n); for skew X use `cayley`."""
    return solve(identity(X.shape[-1]) - X, identity(X.shape[-1]) + X)


# -- orientation: matrices in SO(n), or for n = 3 unit quaternions (w, x, y, z) ---------------------


def turn_left(X: Array, g: Array) -> Array:
    """cay(X) g, for an orthogonal matrix g (..., n, n) or a unit quaternion g (..., 4) when n = 3."""
    return cayley_columns(X, g) if _is_matrix(X, g) else unit(quaternion_product(_half_turn(X), g))


def turn_right(g: Array, X: Array) -> Array:
    """The turn g cay(X), for an orthogonal matrix g (..., n, n) or a unit quaternion g (..., 4) when n = 3."""
    return cayley_columns(-X, g.mT).mT if _is_matrix(X, g) else unit(quaternion_product(g, _half_turn(X)))


def _is_matrix(X: Array, g: Array) -> bool:
    return g.ndim >= 2 and g.shape[-2:] == X.shape[-2:]


def _half_turn(X: Array) -> Array:
    """(1, u): cay(hat(u)) is the rotation of the unnormalised quaternion 1 + u."""
    u = axial(X)
    return np.concatenate([1 + 0 * u[..., :1], u], -1)


def quaternion_product(a: Array, b: Array) -> Array:
    """The product of quaternions (..., 4) = (w, x, y, z): the turn b first, then a."""
    s, u, t, v = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    return np.concatenate([s * t - vec(dot(u, v)), s * v + t * u + act(hat(u), v)], -1)


def inverse_turn(q: Array) -> Array:
    """The inverse (w, -x, -y, -z) of a unit quaternion (..., 4)."""
    return np.concatenate([q[..., :1], -q[..., 1:]], -1)


def unit(q: Array) -> Array:
    """q/|q| for vectors or quaternions q (..., k)."""
    return q / sqrt(vec(dot(q, q)))


def double_turn(x: Array, y: Array, g: Array, right: bool = False) -> Array:
    """R_y R_x g, or g (R_y R_x)^T with `right`, R_x the half-turn about x: the turn from x to y by twice their angle.

    g is an orthogonal matrix (..., n, n) or a unit quaternion (..., 4) when n = 3.
    """
    if g.ndim == x.ndim + 1:
        h = g.mT if right else g
        for axis in (x, y):
            h = axis[..., :, None] * (2 / mat(dot(axis, axis)) * act(h.mT, axis)[..., None, :]) - h
        return h.mT if right else h
    turn = np.concatenate([vec(dot(x, y)) + 0 * x[..., :1], cross(x, y)], -1)
    if right:
        return unit(quaternion_product(g, np.concatenate([turn[..., :1], -turn[..., 1:]], -1)))
    return unit(quaternion_product(turn, g))


def cross(x: Array, y: Array) -> Array:
    """The cross product x x y, n = 3."""
    return act(hat(x), y)


def rotation_matrix(q: Array) -> Array:
    """The matrix (..., 3, 3) of a unit quaternion (..., 4) = (w, x, y, z)."""
    H = hat(q[..., 1:])
    return identity(3) + 2 * (mat(q[..., 0]) * H + H @ H)


def unit_quaternion(g: Array) -> Array:
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation matrix (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(np.reshape(g, (-1, 3, 3))).as_quat(canonical=True, scalar_first=True)
    return flat.reshape((*np.shape(g)[:-2], 4))
