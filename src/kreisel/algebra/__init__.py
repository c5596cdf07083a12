"""so(n), e*(n) and the Cayley transform, for any kind of number.

| thing      | convention                                                                     |
|------------|--------------------------------------------------------------------------------|
| pairing    | <X, Y> = -tr(XY)/2 on so(n), Euclidean on R^n                                    |
| wedge      | x ^ y = x y^T - y x^T                                                            |
| Cayley     | cay(X) = (I + X)(I - X)^-1                                                       |
| n = 3      | hat(v) x = v x x (cross product), so x ^ y = hat(y x x)                           |
| batch axes | in front: skew matrices are (..., n, n), vectors (..., n), scalars (...)          |

Every function works on NumPy and JAX arrays and on NumPy object arrays of any field (fractions,
python-flint rationals, SymPy expressions, the recording scalars of `kreisel.kernels.tape`).
Only this module knows which kind it has before it.  [Suris 2001, sections 2 and 4]
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from kreisel.algebra.complex import Complex, as_complex

Array = Any  # an array of any library, or a NumPy object array of any field
SECOND, THIRD = np.array([1, 2, 0]), np.array([2, 0, 1])  # the axes after the first, second and third of space


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
    if holds_objects(A) or holds_objects(B) or A.dtype.itemsize > (16 if A.dtype.kind == "c" else 8):
        return _eliminate(A, B)[1]
    return _linear_algebra(A).solve(A, B)


def _linear_algebra(A: Array) -> Any:
    space = A.__array_namespace__()
    return LINEAR_ALGEBRA.get(space.__name__, space.linalg)


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
            re[place], im[place] = as_complex(z[place]).re, as_complex(z[place]).im
        return re, im
    if hasattr(z, "record_parts"):
        return z.record_parts()
    return (np.real(z), np.imag(z)) if np.iscomplexobj(z) else (z, None)


def conjugate(z: Any) -> Any:
    """The conjugate of a complex scalar."""
    return Complex(z.re, -z.im) if isinstance(z, Complex) else np.conj(z)


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


# -- vectors, skew matrices -----------------------------------------------------------------------


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


def hat(v: Array) -> Array:
    """The skew matrix X of an axial vector v, X x = v x x (cross product), n = 3.  Inverse: `axial`."""
    return skew(v[..., np.array([2, 1, 0])] * np.array([-1, 1, -1], dtype=np.int8), 3)


def axial(X: Array) -> Array:
    """The axial vector of a skew 3 x 3 matrix.  Inverse: `hat`."""
    return coordinates(X)[..., np.array([2, 1, 0])] * np.array([-1, 1, -1], dtype=np.int8)


# -- Cayley ---------------------------------------------------------------------------------------


def resolvent(X: Array, V: Array) -> Array:
    """(I - X)^-1 V for X (..., n, n) skew and columns V; for n = 3 (I + X + u u^T) V/(1 + |u|^2), X = hat(u)."""
    one = identity(X.shape[-1])
    if X.shape[-1] != 3:
        return solve(one - X, V)
    u = axial(X)
    return ((one + X) @ V + u[..., :, None] * act(V.mT, u)[..., None, :]) * (1 / mat(1 + dot(u, u)))


def shifted_resolvent(mu: Array, X: Array, v: Array) -> Array:
    """(mu - X)^-1 v for X (..., n, n) skew, v (..., n) and a scalar mu with Re mu != 0; any of them complex."""
    if X.shape[-1] != 3:
        A = X.record_shifted(mu) if hasattr(X, "record_shifted") else mat(mu) * identity(X.shape[-1]) - X
        return solve(A, v[..., None])[..., 0]
    u, square = axial(X), mu * mu
    scale = 1 / (mu * (square + dot(u, u)))
    return vec(scale) * (vec(square) * v + vec(mu) * act(X, v) + u * vec(dot(u, v)))


def diagonal_resolvent(d: Array, X: Array, v: Array) -> Array:
    """(diag(d) + X)^-1 v for X (..., n, n) skew, d and v (..., n) with Re d > 0; any of them complex."""
    if X.shape[-1] != 3:
        return solve(d[..., None] * identity(X.shape[-1]) + X, v[..., None])[..., 0]
    u, (i, j, k) = axial(X), (d[..., 0], d[..., 1], d[..., 2])
    minors = np.stack([j * k, k * i, i * j], -1)
    scale = 1 / (i * minors[..., 0] + dot(u, d * u))
    return vec(scale) * (minors * v + u * vec(dot(u, v)) - cross(d * u, v))


def cayley_columns(X: Array, V: Array) -> Array:
    """cay(X) V = V + (I - X)^-1 2 X V for columns V (..., n, k); n = 3: V + 2 (I + X) X V/(1 + |u|^2), X = hat(u)."""
    W = X @ V
    if X.shape[-1] != 3:
        return V + resolvent(X, 2 * W)
    u = axial(X)[..., :, None]
    W = W + u[..., SECOND, :] * W[..., THIRD, :] - u[..., THIRD, :] * W[..., SECOND, :]  # (I + X) W
    return V + W * (2 / (1 + (u * u).sum(-2)[..., None]))


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
    """cay(x ^ y) v in O(n), for vectors (..., n)."""
    X, Y, c, xv, yv = dot(x, x), dot(y, y), dot(x, y), dot(x, v), dot(y, v)
    scale = 2 / (1 + X * Y - c * c)
    return v + x * vec(((1 + c) * yv - Y * xv) * scale) - y * vec(((1 - c) * xv + X * yv) * scale)


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
