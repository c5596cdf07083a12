"""Characteristic polynomials, Casimirs and Poisson tensors on e*(n) and T*S^(n-1), for any kind of number.

Batch axes in front; conventions as in `kreisel.algebra`.
"""

from __future__ import annotations

import numpy as np

from kreisel.algebra import Array, act, dot, holds_objects, identity, mat, triangle, wedge


def faddeev_leverrier(N: Array) -> tuple[list[Array], list[Array]]:
    """c_k (k = 0..n) and B_k (k = 0..n-1): det(mu - N) = sum c_k mu^(n-k), adj(mu - N) = sum B_k mu^(n-1-k)."""
    n = N.shape[-1]
    B = [identity(n) + 0 * N]
    c: list[Array] = [1]
    for k in range(1, n + 1):
        NB = N @ B[-1]
        c.append(-_trace(NB) / k)
        if k < n:
            B.append(NB + mat(c[-1]) * identity(n))
    return c, B


def _trace(A: Array) -> Array:
    return (A * identity(A.shape[-1])).sum(-1).sum(-1)


def faddeev_leverrier_pencil(M: Array, B: Array) -> tuple[list[list[Array]], list[list[Array]]]:
    """The same for the pencil N = nu B + M: c[k][i] and B[k][i] are the coefficients of nu^i."""
    n = M.shape[-1]
    adj: list[list[Array]] = [[identity(n) + 0 * M]]
    c: list[list[Array]] = [[1]]
    for k in range(1, n + 1):
        previous = adj[-1]
        product = [(M @ previous[i] if i < k else 0) + (B @ previous[i - 1] if i > 0 else 0) for i in range(k + 1)]
        c.append([-_trace(term) / k for term in product])
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
    return np.stack([np.broadcast_to(s, shape) for s in scalars], -1)


def casimirs(M: Array, P: Array, most: int = 4) -> Array:
    """Casimirs of e*(n): P^T B_2j P, j = 0, 1, ..., the coefficients of P^T adj(mu - M) P; the first `most`.

    The first two are |P|^2 and |P|^2 <M, M> - |M P|^2; for n = 3 the second is (M . P)^2.
    """
    n, B = M.shape[-1], faddeev_leverrier(M)[1]
    return stack([form(P, B[k], P) for k in range(0, min(n, 2 * most), 2)])


def bordered_spectrum(m: Array, b: Array, p: Array, most: int = 4) -> Array:
    """Coefficients in lambda and mu of det(mu - l), l = [[m, v], [v^T, 0]], v = lambda b - p / lambda.

    For k = 0, 2, 4, ...: <b, B_k b> (lambda^2), c_(k+2) + 2 <b, B_k p> (lambda^0) and, for k > 0,
    <p, B_k p> (lambda^-2), up to sign, with c and B of `faddeev_leverrier(m)`; odd k vanish.
    """
    n = m.shape[-1]
    c, B = faddeev_leverrier(m)
    out = []
    for k in range(0, min(n, 2 * most), 2):
        out += [form(b, B[k], b), (c[k + 2] if k + 2 <= n else 0) + 2 * form(b, B[k], p)]
        out += [form(p, B[k], p)] if k else []
    return stack(out)


def pencil_spectrum(M: Array, B: Array, Q: Array, kappa: Array, plane: bool = False) -> Array:
    """Coefficients of (nu + kappa mu) det(mu - nu B - M) - <Q, adj(mu - nu B - M) Q> in nu and mu.

    The characteristic polynomial of lambda B + M + Q Q^T / lambda (kappa = 0), and its deformation by
    the discrete Clebsch map.  Coefficients that do not depend on M and Q are left out, and with `plane`, for
    M = x ^ q and Q in the plane of x and q, those of degree 4 and more in M and Q, which vanish there.
    """
    n = M.shape[-1]
    c, adj = faddeev_leverrier_pencil(M, B)
    out = []
    for k in range(1, n + 1):  # mu^(n-k) nu^i; other parities of i vanish, i = k + 1 has B alone
        for i in range(k - 1, k - 2 if plane else -1, -2):
            term = -form(Q, adj[k - 1][i], Q)
            term = term + (c[k][i - 1] if i > 0 else 0) + (kappa * c[k + 1][i] if k < n else 0)
            out.append(term)
    return stack(out)


def lie_poisson(M: Array, P: Array) -> Array:
    """The plus Lie-Poisson tensor of e*(n) in the coordinates (M_ij, i < j; P_k).

    {M_ij, M_kl} = M_il d_jk - M_kj d_li - M_ik d_jl + M_lj d_ki,  {M_ij, P_k} = P_i d_jk - P_j d_ik,
    {P_i, P_j} = 0; the field of H is F' = {H, F}.  [Suris 2001, section 4]
    """
    n = M.shape[-1]
    i, j = (index[:, None] for index in triangle(n))
    k, l = (index[None, :] for index in triangle(n))  # noqa: E741 - the formula's own letter
    MM = M[..., i, l] * (j == k) - M[..., k, j] * (l == i) - M[..., i, k] * (j == l) + M[..., l, j] * (k == i)
    k = np.arange(n)[None, :]
    MP = P[..., i + 0 * k] * (j == k) - P[..., j + 0 * k] * (i == k)
    PP = 0 * (P[..., :, None] * P[..., None, :])
    return np.concatenate([np.concatenate([MM, MP], -1), np.concatenate([-MP.mT, PP], -1)], -2)


def sphere_poisson(x: Array, q: Array) -> Array:
    """The Dirac bracket of T*S^(n-1) in (x, q), in the sign that F' = {H, F} asks for.

    {x_i, q_j} = -(d_ij - x_i x_j/|x|^2), {q_i, q_j} = (x_i q_j - q_i x_j)/|x|^2, {x_i, x_j} = 0.
    """
    r = mat(1 / dot(x, x))
    xq = x[..., :, None] * x[..., None, :] * r - identity(x.shape[-1])
    qq = wedge(x, q) * r
    return np.concatenate([np.concatenate([0 * qq, xq], -1), np.concatenate([-xq.mT, qq], -1)], -2)
