"""Matrices of several records; characteristic polynomials; Casimirs and Poisson tensors; for any kind of number.

The duals are of so(n) <x V; T*S^(n-1), and the spins of a chain.

Batch axes in front; conventions as in `kreisel.algebra`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from kreisel.algebra import (
    KINDS,
    Array,
    act,
    axial,
    dot,
    holds_objects,
    identity,
    mat,
    sqrt,
    together,
    triangle,
    vec,
    wedge,
)

FEW_MINORS = 5  # rows of a determinant
MOST = 10  # n up to which records have all coefficients, or points, of a spectrum; beyond, as many as there


def border(m: Array, v: Array, w: Array | None = None) -> Array:
    """[[m, v], [w^T, 0]] of size n + 1; w = v if not given."""
    w = v if w is None else w
    return blocks([[m, v[..., :, None]], [w[..., None, :], 0 * v[..., None, :1]]])


def blocks(rows: Sequence[Sequence[Array]]) -> Array:
    """The matrix of blocks, given by rows."""
    return np.concatenate([np.concatenate(row, -1) for row in rows], -2)


def diagonal(b: Array) -> Array:
    """diag(b) for b (..., n)."""
    return b[..., None] * identity(b.shape[-1])


SU2_REAL = np.array([[[0, 0], [0, 0]], [[0, -1], [1, 0]], [[0, 0], [0, 0]]], dtype=np.int8)
SU2_IMAGINARY = np.array([[[0, -1], [-1, 0]], [[0, 0], [0, 0]], [[-1, 0], [0, 1]]], dtype=np.int8)


def su2(x: Array) -> Array:
    """Sum x_i sigma_i/(2i) for vectors x (..., 3): complex matrices (..., 2, 2), whose brackets are cross products."""
    half = x[..., None, None] / 2
    return together((half * SU2_REAL).sum(-3), (half * SU2_IMAGINARY).sum(-3))


def adjugate(X: Array) -> Array:
    """The adjugate of X (..., n, n): X adj(X) = det X, from its minors; for small n."""
    n = X.shape[-1]
    minors: dict[tuple[tuple[int, ...], tuple[int, ...]], Any] = {}

    def minor(rows: tuple[int, ...], columns: tuple[int, ...]) -> Any:
        if not rows:
            return 1
        if (rows, columns) not in minors:
            terms = [
                (-1) ** k * X[..., rows[0], c][()] * minor(rows[1:], columns[:k] + columns[k + 1 :])
                for k, c in enumerate(columns)
            ]
            minors[rows, columns] = sum(terms[1:], terms[0])
        return minors[rows, columns]

    every = [tuple(k for k in range(n) if k != i) for i in range(n)]
    rows = [np.stack([(-1) ** (i + j) * minor(every[j], every[i]) for j in range(n)], -1) for i in range(n)]
    return np.stack(rows, -2)


def characteristic(N: Array, last: int | None = None) -> list[Array]:
    """c_k, k = 0..last or n: det(mu - N) = sum c_k mu^(n-k).

    [Newton's identities for the traces of powers]
    """
    if hasattr(N, "record_characteristic"):
        n = N.shape[-1]
        return N.record_characteristic(n if last is None else min(n, last))
    return [c[0] if k else c for k, c in enumerate(_characteristic([N], last))]


def adjugate_on(N: Array, c: Sequence[Array], v: Array) -> list[Array]:
    """B_k v, adj(mu - N) = sum B_k mu^(n-1-k), for as many k as there are c_k of `characteristic`; k < n."""
    out = [v]
    for k in range(1, min(len(c), N.shape[-1])):
        out.append(act(N, out[-1]) + vec(c[k]) * v)
    return out


def trace(A: Array) -> Array:
    """The trace of A (..., n, n)."""
    return (A * identity(A.shape[-1])).sum(-1).sum(-1)


def _characteristic(N: Sequence[Array], last: int | None) -> list[Any]:
    """The coefficients for N_0 + nu N_1 + ...: c_k as a list of the coefficients of nu^i, c_0 = 1."""
    n = N[0].shape[-1]
    last = n if last is None else min(n, last)
    powers = [N]
    while 2 * len(powers) < last:
        powers.append(_polynomial(powers[-1], N, lambda X, Y: X @ Y))
    c: list[Any] = [1]
    traces: list[list[Array]] = []
    for k in range(1, last + 1):
        half = (k + 1) // 2
        left, right = powers[half - 1], powers[k - half - 1] if k > half else None
        traces.append([trace(X) for X in left] if right is None else _polynomial(left, right, trace_of_product))
        total = traces[-1]
        for i in range(1, k):
            product = _polynomial(c[k - i], traces[i - 1], lambda x, y: x * y)
            total = [x + y for x, y in zip(total, product, strict=True)]
        c.append([-x / k for x in total])
    return c


def _polynomial(x: Sequence[Array], y: Sequence[Array], product: Callable[[Array, Array], Array]) -> list[Array]:
    """The coefficients of a product of polynomials."""
    out: list[Any] = [None] * (len(x) + len(y) - 1)
    for i, a in enumerate(x):
        for j, b in enumerate(y):
            term = product(a, b)
            out[i + j] = term if out[i + j] is None else out[i + j] + term
    return out


def pencil_on(M: Array, B: Array, Q: Array, last: int) -> tuple[list[Any], list[list[Array]]]:
    """c[k][i], and B_k Q as coefficients of nu^i, of the pencil N = nu B + M; see `characteristic`, `adjugate_on`."""
    c = _characteristic([M, B], last)
    out = [[Q]]
    for k in range(1, min(len(c), M.shape[-1])):
        terms = _polynomial([M, B], out[-1], act)
        out.append([term + vec(ck) * Q for term, ck in zip(terms, c[k], strict=True)])
    return c, out


def trace_of_product(A: Array, B: Array) -> Array:
    """The trace of A B."""
    return (A * B.mT).sum(-1).sum(-1)


def stack(scalars: list[Array]) -> Array:
    """A family of scalars (...) as one array (..., k)."""
    shape = np.broadcast_shapes(*(np.shape(s) for s in scalars))
    if any(not hasattr(s, "dtype") or holds_objects(s) for s in scalars):
        out = np.empty((*shape, len(scalars)), dtype=object)
        for i, s in enumerate(scalars):
            out[..., i] = s
        return out
    library: Any = next((s.__array_namespace__() for s in scalars if hasattr(s, "__array_namespace__")), np)
    return library.stack([library.broadcast_to(s, shape) for s in scalars], -1)


def casimirs(M: Array, P: Array, most: int = 4) -> Array:
    """Casimirs of e*(n): P^T B_2j P, j = 0, 1, ..., the coefficients of P^T adj(mu - M) P; the first `most`.

    The first two are |P|^2 and |P|^2 <M, M> - |M P|^2; for n = 3 the second is (M . P)^2.
    """
    n = M.shape[-1]
    if n == 3:
        along = dot(axial(M), P)
        return stack([dot(P, P), along * along])
    BP = adjugate_on(M, characteristic(M, 2 * most - 2), P)
    return stack([dot(P, BP[k]) for k in range(0, min(n, 2 * most), 2)])


def bordered_spectrum(m: Array, b: Array, p: Array, most: int = 4) -> Array:
    """Coefficients in lambda and mu of det(mu - l), l = [[m, v], [v^T, 0]], v = lambda b - p / lambda.

    For k = 0, 2, 4, ...: <b, B_k b> (lambda^2), c_(k+2) + 2 <b, B_k p> (lambda^0) and, for k > 0,
    <p, B_k p> (lambda^-2), up to sign, with c of `characteristic` and B of `adjugate_on`; odd k vanish.
    """
    n = m.shape[-1]
    if n == 3:  # B_2 = u u^T for m = hat(u)
        u = axial(m)
        along_b, along_p = dot(u, b), dot(u, p)
        first = [dot(b, b), dot(u, u) + 2 * dot(b, p)]
        return stack([*first, along_b * along_b, 2 * along_b * along_p, along_p * along_p])
    c = characteristic(m, 2 * most)
    Bb, Bp = adjugate_on(m, c, b), adjugate_on(m, c, p)
    out = []
    for k in range(0, min(n, 2 * most), 2):
        out += [dot(b, Bb[k]), (c[k + 2] if k + 2 <= n else 0) + 2 * dot(b, Bp[k])]
        out += [dot(p, Bp[k])] if k else []
    return stack(out)


def pencil_spectrum(M: Array, B: Array, Q: Array, kappa: Array, most: int = 8) -> Array:
    """Coefficients of (nu + kappa mu) det(mu - nu B - M) - <Q, adj(mu - nu B - M) Q> in nu and mu.

    The characteristic polynomial of lambda B + M + Q Q^T / lambda (kappa = 0), and its deformation by
    the discrete Clebsch map.  Coefficients that do not depend on M and Q are left out.
    For n > `most` only coefficients of mu^(n-1) ... mu^(n-most).
    """
    n = M.shape[-1]
    c, adj = pencil_on(M, B, Q, most + 1)
    out = []
    for k in range(1, min(n, most) + 1):  # mu^(n-k) nu^i; other parities of i vanish, i = k + 1 has only B
        for i in range(k - 1, -1, -2):
            term = -dot(Q, adj[k - 1][i])
            term = term + (c[k][i - 1] if i > 0 else 0) + (kappa * c[k + 1][i] if k < n else 0)
            out.append(term)
    return stack(out)


def plane_spectrum(
    x: Array, q: Array, b: Array, alpha: Array | int, beta: Array | int, kappa: Array | int, most: int = 8
) -> Array:
    """`pencil_spectrum` for B = diag(b), M = x ^ q and Q = alpha x + beta q: the nonzero coefficients, in O(n).

    With R = (mu - nu B)^-1 it is det(mu - nu B) ((nu + kappa mu) (<x, Rx><q, Rq> - <x, Rq>^2) - <Q, RQ>), and of that
    for every k the coefficient of mu^(n-k) nu^(k-1).  [matrix determinant lemma]
    """
    n = b.shape[-1]
    most = min(n, most)
    powers = [(x, q)]
    while len(powers) < most // 2 + 1:
        powers.append((b * powers[-1][0], b * powers[-1][1]))

    def moments(i: int, j: int) -> list[Array]:  # <v_i, B^k v_j>, k < most
        return [dot(powers[(k + 1) // 2][i], powers[k // 2][j]) for k in range(most)]

    xx, xq, qq = moments(0, 0), moments(0, 1), moments(1, 1)
    QQ = [alpha * alpha * xx[k] + 2 * alpha * beta * xq[k] + beta * beta * qq[k] for k in range(most)]
    area = [sum(xx[i] * qq[k - i] - xq[i] * xq[k - i] for i in range(k + 1)) for k in range(most)]
    e: list[Any] = [1]  # det(mu - nu B) = sum e_k mu^(n-k) nu^k  [Newton's identities]
    traces: list[Array] = []
    power = b
    for k in range(1, most):
        traces.append(power.sum(-1))
        e.append(-sum(e[k - i] * traces[i - 1] for i in range(1, k + 1)) / k)
        power = b * power
    out = []
    for k in range(most):  # mu^(n-k-1) nu^k
        terms = [e[k - j] * ((kappa * area[j] if k + 1 < n else 0) - QQ[j]) for j in range(k + 1)]
        out.append(sum(terms) + sum(e[k - 1 - j] * area[j] for j in range(k)))
    return stack(out)


def casimirs_free(M: Array, most: int = 4) -> Array:
    """Casimirs of so(n): the coefficients c_2, c_4, ... of det(mu - M), the first `most`.  The first is <M, M>."""
    c = characteristic(M, 2 * most)
    return stack([c[k] for k in range(2, min(M.shape[-1] + 1, 2 * most + 1), 2)])


def casimirs_adjoint(M: Array, G: Array, most: int = 4) -> Array:
    """Casimirs of so(n) <x so(n): the coefficients of nu^k and nu^(k-1), k even, of mu^(n-k) in det(mu - nu G - M)."""
    ks = range(2, min(M.shape[-1] + 1, 2 * most + 1), 2)
    c = _characteristic([M, G], ks[-1])
    return stack([c[k][i] for k in ks for i in (k, k - 1)])


def power_traces(M: Array, P: Array, most: int = 8) -> Array:
    """Tr P^k, k = 1, 2, ..., n: Casimirs of so(n) <x Sym(n); the first `most`."""
    powers = [P]
    while len(powers) < min(P.shape[-1], most):
        powers.append(powers[-1] @ P)
    return stack([trace(power) for power in powers])


def gram(M: Array, *vectors: Array) -> Array:
    """<f_i, f_j>, i <= j: Casimirs of so(n) <x q R^n."""
    return stack([dot(f, g) for i, f in enumerate(vectors) for g in vectors[i:]])


def metric_spectrum(M: Array, A: Array) -> Array:
    """Coefficients of nu^i mu^(n-k), i > 0, in det(mu - nu A - M), that depend on M: k - i = 2, 4, ..., k <= 10."""
    c = _faddeev_leverrier({0: M, 1: A})
    return stack([c[k][i] for k in range(3, len(c)) for i in range(k - 2, 0, -2)])


def laurent_spectrum(M: Array, A: Array, P: Array, odd: bool = True, step: int = 2) -> Array:
    """Coefficients of det(mu - L), L = lambda A + M + P/lambda, that depend on M: of lambda^i mu^(n-k), |i| < k <= 10.

    For symmetric A and P and skew M coefficients with odd i - k vanish, and are left out with step 2; for skew A, P and
    M coefficients with odd k vanish, and are left out without `odd`.
    """
    c, out = _faddeev_leverrier({1: A, 0: M, -1: P}), []
    for k in range(1, len(c)):
        out += [c[k][i] for i in range(k - step, -k, -step)] if odd or k % 2 == 0 else []
    return stack(out)


def _faddeev_leverrier(N: Mapping[int, Array]) -> list[dict[int, Array]]:
    """c_k as coefficients of lambda^i, for L = sum lambda^i N_i, k <= `MOST`; traces of powers lose digits.

    [Faddeev and Leverrier; B_k = L B_(k-1) + c_k, c_k = -tr(..)/k]
    """
    n = N[0].shape[-1]
    B: dict[int, Array] = {0: identity(n) + 0 * N[0]}
    out: list[dict[int, Array]] = [{}]
    for k in range(1, min(n, MOST) + 1):
        product: dict[int, Array] = {}
        for i, X in B.items():
            for shift, term in N.items():
                product[i + shift] = product.get(i + shift, 0) + term @ X
        out.append({i: -trace(X) / k for i, X in product.items()})
        B = {i: X + mat(out[-1][i]) * identity(n) for i, X in product.items()}
    return out


def determinant(A: Array) -> Array:
    """The determinant of A (..., n, n) by minors, one row after another: n 2^(n-1) multiplications, no division.

    Arrays of doubles go to LAPACK if there would be more than a hundred: with n = 20 there would be 10^7.
    """
    n = A.shape[-1]
    if n > FEW_MINORS and hasattr(A, "record_determinant"):
        return A.record_determinant()
    if n > FEW_MINORS and isinstance(A, np.ndarray) and A.dtype == np.float64:
        return np.linalg.det(A)
    minors: dict[tuple[int, ...], Any] = {(): 1}
    for i in range(n):
        row = [(A[..., i, c], -A[..., i, c]) for c in range(n)]  # by the sign
        minors = {
            columns: sum(row[c][(i + j) % 2] * minors[(*columns[:j], *columns[j + 1 :])] for j, c in enumerate(columns))
            for columns in itertools.combinations(range(n), i + 1)
        }
    return minors[tuple(range(n))]


def lie_poisson(kinds: Sequence[str], M: Array, *carried: Array) -> Array:
    """The plus Lie-Poisson tensor of so(n) <x V in the coordinates of M (i < j) and of the components of V.

    {M_ij, z} is the rate of z that rotates with the velocity E_ij = e_i ^ e_j: [z, E_ij] for matrices and M itself,
    -E_ij z for vectors; components of V commute.  F' = {H, F}.  [Suris 2001, sections 2 and 4]
    """
    n = M.shape[-1]
    i, j = triangle(n)
    unit = identity(n)
    E = unit[i][:, :, None] * unit[j][:, None, :] - unit[j][:, :, None] * unit[i][:, None, :]
    moved = []
    for kind, z in zip(map(KINDS.__getitem__, kinds), (M, *carried), strict=True):
        of_all = z[(..., None, *(slice(None),) * kind.axes)]
        moved.append(kind.pack(kind.rate(-E, of_all)))
    MM = moved[0]
    MV = np.concatenate([MM[..., :0], *moved[1:]], -1)
    VV = 0 * (MV.mT @ MV)
    return blocks([[MM, MV], [-MV.mT, VV]])


# -- spins of a chain --------------------------------------------------------------------------------------

Spins = tuple[Array, ...]  # three vectors x, y, z (..., n) of components, an entry per site


def shifted(x: Array, k: int) -> Array:
    """x_(i+k) on the ring of the sites."""
    if hasattr(x, "record_shift"):
        return x.record_shift(k)
    return x.__array_namespace__().concatenate([x[..., k:], x[..., :k]], -1)


def cross(a: Sequence[Array], b: Sequence[Array]) -> Spins:
    """a x b at each site, by the components along the first axis."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def inner(a: Sequence[Array], b: Sequence[Array]) -> Array:
    """<a, b> at each site."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def squared_lengths(*spins: Array) -> Array:
    """Squared lengths of spins (x, y, z), of one sublattice after the other."""
    groups = [x * x + y * y + z * z for x, y, z in (spins[i : i + 3] for i in range(0, len(spins), 3))]
    return groups[0].__array_namespace__().concatenate(groups, -1)


def spins_poisson(x: Array, y: Array, z: Array, weight: Array | int = 1) -> Array:
    """{x_i, y_i} = weight_i z_i and cyclic, of the n coordinates x, then y, then z."""
    X, Y, Z = (vec(weight * v) * identity(v.shape[-1]) for v in (x, y, z))
    return blocks([[0 * X, Z, -Y], [-Z, 0 * X, X], [Y, -X, 0 * X]])


def lattice_poisson(spins: Sequence[Array], D: Array) -> Array:
    """The bracket of the spins of two sublattices, one after the other, with weights (1 + D z^2)^(1/2)."""
    first, second = (spins_poisson(x, y, z, sqrt(1 + vec(D) * z * z)) for x, y, z in (spins[:3], spins[3:]))
    return blocks([[first, 0 * first], [0 * second, second]])


def sphere_poisson(x: Array, q: Array) -> Array:
    """The Dirac bracket of T*S^(n-1) in (x, q), with the sign of F' = {H, F}.

    {x_i, q_j} = -(d_ij - x_i x_j/|x|^2), {q_i, q_j} = (x_i q_j - q_i x_j)/|x|^2, {x_i, x_j} = 0.
    """
    r = mat(1 / dot(x, x))
    xq = x[..., :, None] * x[..., None, :] * r - identity(x.shape[-1])
    qq = wedge(x, q) * r
    return blocks([[0 * qq, xq], [-xq.mT, qq]])
