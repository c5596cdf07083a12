"""Characteristic polynomials, Casimirs and Poisson tensors on duals of so(n) <x V and T*S^(n-1), for any number.

Batch axes in front; conventions as in `kreisel.algebra`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kreisel.algebra import (
    Array,
    act,
    axial,
    coordinates_of,
    dot,
    holds_objects,
    identity,
    mat,
    rate,
    triangle,
    wedge,
)


def faddeev_leverrier(N: Array, last: int | None = None) -> tuple[list[Array], list[Array]]:
    """c_k (k = 0..n) and B_k (k = 0..n-1): det(mu - N) = sum c_k mu^(n-k), adj(mu - N) = sum B_k mu^(n-1-k).

    With `last` only those up to c_last, in as many products of matrices.
    """
    n = N.shape[-1]
    B = [identity(n) + 0 * N]
    c: list[Array] = [1]
    for k in range(1, n + 1 if last is None else min(n, last) + 1):
        NB = N @ B[-1]
        c.append(-trace(NB) / k)
        if k < n:
            B.append(NB + mat(c[-1]) * identity(n))
    return c, B


def trace(A: Array) -> Array:
    """The trace of A (..., n, n)."""
    return (A * identity(A.shape[-1])).sum(-1).sum(-1)


def faddeev_leverrier_pencil(
    M: Array, B: Array, last: int | None = None
) -> tuple[list[list[Array]], list[list[Array]]]:
    """The same for the pencil N = nu B + M: c[k][i] and B[k][i] are the coefficients of nu^i."""
    n = M.shape[-1]
    adj: list[list[Array]] = [[identity(n) + 0 * M]]
    c: list[list[Array]] = [[1]]
    for k in range(1, n + 1 if last is None else min(n, last) + 1):
        previous = adj[-1]
        product = [(M @ previous[i] if i < k else 0) + (B @ previous[i - 1] if i > 0 else 0) for i in range(k + 1)]
        c.append([-trace(term) / k for term in product])
        if k < n:
            adj.append([term + mat(ck) * identity(n) for term, ck in zip(product, c[-1], strict=True)])
    return c, adj


def form(x: Array, A: Array, y: Array) -> Array:
    """<x, A y>."""
    return dot(x, act(A, y))


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
    B = faddeev_leverrier(M, 2 * most - 2)[1]
    return stack([form(P, B[k], P) for k in range(0, min(n, 2 * most), 2)])


def bordered_spectrum(m: Array, b: Array, p: Array, most: int = 4) -> Array:
    """Coefficients in lambda and mu of det(mu - l), l = [[m, v], [v^T, 0]], v = lambda b - p / lambda.

    For k = 0, 2, 4, ...: <b, B_k b> (lambda^2), c_(k+2) + 2 <b, B_k p> (lambda^0) and, for k > 0,
    <p, B_k p> (lambda^-2), up to sign, with c and B of `faddeev_leverrier(m)`; odd k vanish.
    """
    n = m.shape[-1]
    if n == 3:  # B_2 = u u^T for m = hat(u)
        u = axial(m)
        along_b, along_p = dot(u, b), dot(u, p)
        first = [dot(b, b), dot(u, u) + 2 * dot(b, p)]
        return stack([*first, along_b * along_b, 2 * along_b * along_p, along_p * along_p])
    c, B = faddeev_leverrier(m, 2 * most)
    out = []
    for k in range(0, min(n, 2 * most), 2):
        out += [form(b, B[k], b), (c[k + 2] if k + 2 <= n else 0) + 2 * form(b, B[k], p)]
        out += [form(p, B[k], p)] if k else []
    return stack(out)


def pencil_spectrum(M: Array, B: Array, Q: Array, kappa: Array, plane: bool = False, most: int = 8) -> Array:
    """Coefficients of (nu + kappa mu) det(mu - nu B - M) - <Q, adj(mu - nu B - M) Q> in nu and mu.

    The characteristic polynomial of lambda B + M + Q Q^T / lambda (kappa = 0), and its deformation by
    the discrete Clebsch map.  Coefficients that do not depend on M and Q are left out, and with `plane`, for
    M = x ^ q and Q in the plane of x and q, those of degree 4 and more in M and Q, which vanish there.
    For n > `most` only those of mu^(n-1) ... mu^(n-most).
    """
    n = M.shape[-1]
    c, adj = faddeev_leverrier_pencil(M, B, most + 1)
    out = []
    for k in range(1, min(n, most) + 1):  # mu^(n-k) nu^i; other parities of i vanish, i = k + 1 has B alone
        for i in range(k - 1, k - 2 if plane else -1, -2):
            term = -form(Q, adj[k - 1][i], Q)
            term = term + (c[k][i - 1] if i > 0 else 0) + (kappa * c[k + 1][i] if k < n else 0)
            out.append(term)
    return stack(out)


def casimirs_free(M: Array, most: int = 4) -> Array:
    """Casimirs of so(n): the coefficients c_2, c_4, ... of det(mu - M), the first `most`.  The first is <M, M>."""
    c = faddeev_leverrier(M, 2 * most)[0]
    return stack([c[k] for k in range(2, min(M.shape[-1] + 1, 2 * most + 1), 2)])


def casimirs_adjoint(M: Array, G: Array, most: int = 4) -> Array:
    """Casimirs of so(n) <x so(n): the coefficients of nu^k and nu^(k-1), k even, of mu^(n-k) in det(mu - nu G - M)."""
    c = faddeev_leverrier_pencil(M, G)[0]
    ks = range(2, min(M.shape[-1] + 1, 2 * most + 1), 2)
    return stack([c[k][i] for k in ks for i in (k, k - 1)])


def power_traces(P: Array, most: int = 8) -> Array:
    """Tr P^k, k = 1, 2, ..., n: Casimirs of so(n) <x Sym(n); the first `most`."""
    powers = [P]
    while len(powers) < min(P.shape[-1], most):
        powers.append(powers[-1] @ P)
    return stack([trace(power) for power in powers])


def gram(*vectors: Array) -> Array:
    """<f_i, f_j>, i <= j: Casimirs of so(n) <x q R^n."""
    return stack([dot(f, g) for i, f in enumerate(vectors) for g in vectors[i:]])


def metric_spectrum(M: Array, A: Array) -> Array:
    """Coefficients of nu^i mu^(n-k), i > 0, in det(mu - nu A - M), those that depend on M: k - i = 2, 4, ..."""
    c = faddeev_leverrier_pencil(M, A)[0]
    return stack([c[k][i] for k in range(3, M.shape[-1] + 1) for i in range(k - 2, 0, -2)])


def laurent_spectrum(M: Array, A: Array, P: Array, odd: bool = True, step: int = 2) -> Array:
    """Coefficients of det(mu - L), L = lambda A + M + P/lambda, that depend on M: of lambda^i mu^(n-k), |i| < k.

    For symmetric A and P and skew M those of i - k odd vanish, and with step 2 are left out; for skew A, P and M those
    of odd k do, and without `odd` are left out.  By the method of Faddeev and Leverrier in Laurent polynomials.
    """
    n = M.shape[-1]
    adj, out = {0: identity(n) + 0 * M}, []
    for k in range(1, n + 1):
        product: dict[int, Array] = {}
        for i, B in adj.items():
            for shift, term in ((1, A), (0, M), (-1, P)):
                product[i + shift] = product.get(i + shift, 0) + term @ B
        c = {i: -trace(B) / k for i, B in product.items()}
        out += [c[i] for i in range(k - step, -k, -step)] if odd or k % 2 == 0 else []
        adj = {i: B + mat(c[i]) * identity(n) for i, B in product.items()}
    return stack(out)


def lie_poisson(kinds: Sequence[str], M: Array, *carried: Array) -> Array:
    """The plus Lie-Poisson tensor of so(n) <x V in the coordinates of M (i < j) and of the components of V.

    {M_ij, z} is how z turns with the velocity E_ij = e_i ^ e_j: [z, E_ij] for matrices and M itself, -E_ij z for
    vectors; components of V commute.  F' = {H, F}.  [Suris 2001, sections 2 and 4]
    """
    n = M.shape[-1]
    i, j = triangle(n)
    one = identity(n)
    E = one[i][:, :, None] * one[j][:, None, :] - one[j][:, :, None] * one[i][:, None, :]
    state = [
        z[..., None, :, :] if kind != "vector" else z[..., None, :]
        for kind, z in zip(kinds, (M, *carried), strict=True)
    ]
    moved = [coordinates_of(kind, rate(kind, -E, z)) for kind, z in zip(kinds, state, strict=True)]
    MM = moved[0]
    MV = np.concatenate([MM[..., :0], *moved[1:]], -1)
    VV = 0 * (MV.mT @ MV)
    return np.concatenate([np.concatenate([MM, MV], -1), np.concatenate([-MV.mT, VV], -1)], -2)


def sphere_poisson(x: Array, q: Array) -> Array:
    """The Dirac bracket of T*S^(n-1) in (x, q), in the sign that F' = {H, F} asks for.

    {x_i, q_j} = -(d_ij - x_i x_j/|x|^2), {q_i, q_j} = (x_i q_j - q_i x_j)/|x|^2, {x_i, x_j} = 0.
    """
    r = mat(1 / dot(x, x))
    xq = x[..., :, None] * x[..., None, :] * r - identity(x.shape[-1])
    qq = wedge(x, q) * r
    return np.concatenate([np.concatenate([0 * qq, xq], -1), np.concatenate([-xq.mT, qq], -1)], -2)
