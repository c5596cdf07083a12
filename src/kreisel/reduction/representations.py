"""Representations Phi of a matrix group on V, and what comes with them: phi, phi*, diamond, Poisson tensor, Casimirs.

| thing     | convention                                                                                   |
|-----------|----------------------------------------------------------------------------------------------|
| phi       | phi(xi) v = d/ds Phi(exp(s xi)) v at 0; phi (d, q, q) holds the matrices phi(E_i)              |
| phi*      | <phi*(xi) y, v> = <y, phi(xi) v>                                                              |
| diamond   | <y <> v, xi> = -<y, phi(xi) v>;   on so(n), R^n: y <> v = v ^ y                               |
| bracket   | {M_i, M_j} = sum_k c_ij^k M_k, {M_i, P_a} = -(phi(E_i) P)_a, {P_a, P_b} = 0: plus, moving frame |

The rest frame has the opposite sign.  [Suris 2001, section 2, (PB left red)]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.record.calling import Portable
from kreisel.reduction.double import double, jax
from kreisel.reduction.groups import Group, Space, numbers, random_element

jnp = jax.numpy
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Representation:
    """Phi(g) on V = R^q: `act(g, v)` with v in coordinates, `space` as the user sees V, `phi` (d, q, q)."""

    name: str
    group: Group
    space: Space
    act: Callable[[Array, Array], Array]
    phi: Array

    def __reduce__(self) -> Any:
        return _again, (self.name, self.group, self.space, Portable(self.act), self.phi)

    @property
    def dim(self) -> int:
        """The dimension q of V."""
        return self.space.dim

    def rate(self, x: Array, v: Array) -> Array:
        """phi(xi) v."""
        return ((x[:, None, None] * self.phi).sum(0) * v).sum(-1)

    def rate_star(self, x: Array, y: Array) -> Array:
        """phi*(xi) y."""
        return jnp.einsum("i,iab,a->b", x, self.phi, y)

    def diamond(self, y: Array, v: Array) -> Array:
        """y <> v in g*, from <y <> v, xi> = -<y, phi(xi) v>."""
        return -jnp.einsum("a,iab,b->i", y, self.phi, v)

    def tensor(self, M: Array, P: Array) -> Array:
        """The plus Lie-Poisson tensor at coordinates M (..., d), P (..., q), for any kind of number."""
        T = self._linear()
        z = np.concatenate([M, P], -1) if isinstance(M, np.ndarray) else jnp.concatenate([M, P], -1)
        size = len(T)
        return (z @ T.reshape(size, size * size)).reshape((*z.shape[:-1], size, size))

    def _linear(self) -> np.ndarray:
        """T[k, a, b] with {z_a, z_b} = sum_k z_k T[k, a, b], z = (M, P)."""
        d, q = self.group.dim, self.dim
        T = np.zeros((d + q, d + q, d + q))
        T[:d, :d, :d] = self.group.structure.transpose(2, 0, 1)
        mixed = -self.phi.transpose(2, 0, 1)  # [b, i, a]: {M_i, P_a} = -sum_b phi_i[a, b] P_b
        T[d:, :d, d:] = mixed
        T[d:, d:, :d] = -mixed.transpose(0, 2, 1)
        return T

    def isotropy(self, p: Array) -> np.ndarray:
        """A basis (k, d), in coordinates, of the isotropy algebra {xi: phi(xi) p = 0}."""
        return _null_space(np.einsum("iab,b->ai", self.phi, p))


def _again(name: str, group: Group, space: Space, act: Portable, phi: Array) -> Representation:
    return Representation(name, group, space, act.function, phi)


def _null_space(A: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
    _, s, vt = np.linalg.svd(A)
    rank = int((s > tolerance * max(s.max(initial=0.0), 1e-300)).sum())
    return vt[rank:]


def standard(group: Group) -> Representation:
    """Phi(g) v = g v on R^N; on C^N, as 2N real numbers (real parts, then imaginary parts), for complex matrices."""
    N, E = group.size, group.basis
    if not np.iscomplexobj(E):
        return Representation("standard", group, numbers(N, group.n), lambda g, v: g @ v, E)
    phi = np.block([[E.real, -E.imag], [E.imag, E.real]])

    def act(g: Array, v: Array) -> Array:
        w = g @ (v[:N] + 1j * v[N:])
        return jnp.concatenate([w.real, w.imag])

    return Representation("standard", group, numbers(2 * N, group.n), act, phi)


def adjoint(group: Group) -> Representation:
    """Phi(g) X = g X g^-1 on V = g: so(n) <x so(n) of the second multidimensional Lagrange top [Ratiu 1982]."""
    space = Space("skew", group.dim, group.n) if group.skew else numbers(group.dim, group.n)
    phi = group.structure.transpose(0, 2, 1)  # phi_i[k, j]: [E_i, E_j] = sum_k c_ij^k E_k
    return Representation("adjoint", group, space, lambda g, v: group.Ad(g) @ v, phi)


def trivial(group: Group) -> Representation:
    """On V = 0: Lagrangians of Omega or W alone, such as the Euler top, on g*."""
    return Representation("trivial", group, numbers(0, group.n), lambda g, v: v, np.zeros((group.dim, 0, 0)))


def representation(
    group: Group,
    Phi: Callable[[Array, Array], Array],
    dim: int,
    name: str = "Phi",
) -> Representation:
    """A representation of one's own: Phi(g, v) for g (N, N) and v (dim,), in JAX.

    Raises `InputError` unless Phi is linear in v and Phi(g h) = Phi(g) Phi(h) at random elements.
    """
    with double():
        rng = np.random.default_rng(1)
        g, h = random_element(group, rng), random_element(group, rng)
        u, v = rng.uniform(-1, 1, (2, dim))
        try:
            out = [np.asarray(Phi(jnp.asarray(x), jnp.asarray(y))) for x, y in ((g, u), (h, u), (g, v), (g, u - 2 * v))]
        except (TypeError, ValueError) as error:
            raise InputError(f"Phi(g, v) failed for g {g.shape} and v ({dim},): {error}") from error
        if any(y.shape != (dim,) or np.iscomplexobj(y) for y in out):
            raise InputError(f"Phi(g, v) must give {dim} real numbers for v ({dim},), got shape {out[0].shape}.")
        if abs(out[0] - 2 * out[2] - out[3]).max() > SAME:
            raise InputError("Phi(g, v) must be linear in v; at a random g it is not.")
        off = abs(np.asarray(Phi(jnp.asarray(g @ h), jnp.asarray(u))) - np.asarray(Phi(jnp.asarray(g), out[1]))).max()
        if off > SAME:
            raise InputError(
                f"Phi must be a representation, Phi(g h) = Phi(g) Phi(h); at random g, h it is off by {off:.3g}. "
                "Usual cause: g where g^-1 belongs, or an anti-representation."
            )

        def matrix(x: Array) -> Array:
            return jax.vmap(lambda v: Phi(group.retract(x), v))(jnp.eye(dim)).T

        phi = np.asarray(jax.jacfwd(matrix)(jnp.zeros(group.dim))).transpose(2, 0, 1)
    return Representation(name, group, numbers(dim, group.n), Phi, phi)


def casimir_count(rep: Representation, points: int = 3) -> int:
    """The number of independent Casimirs: the smallest corank of the tensor over random points."""
    rng = np.random.default_rng(2)
    size = rep.group.dim + rep.dim
    z = rng.uniform(-1, 1, (points, size))
    tensors = rep.tensor(z[:, : rep.group.dim], z[:, rep.group.dim :])
    return min(len(_null_space(T)) for T in tensors)


def casimir_gradients(rep: Representation, M: Array, P: Array) -> np.ndarray:
    """An orthonormal basis (k, d + q) of the kernel of the tensor at coordinates (M, P): gradients of Casimirs."""
    return _null_space(rep.tensor(np.asarray(M), np.asarray(P)))


def quadratic_casimirs(rep: Representation) -> np.ndarray:
    """A basis of the quadratic Casimirs z^T Q z, symmetric Q (k, d + q, d + q), in echelon form.

    The kernel of the linear equations grad C . tensor = 0 at random points z = (M, P).  These are all independent
    Casimirs of so(3)*, e(3)*, se(3)* and so(3) <x so(3), and some of them on larger algebras (`casimir_count`).
    """
    d, size = rep.group.dim, rep.group.dim + rep.dim
    i, j = np.triu_indices(size)
    z = np.random.default_rng(4).uniform(-1, 1, (len(i) + 4, size))
    gradients = np.zeros((len(z), len(i), size))  # of z_i z_j
    places = np.arange(len(i))
    gradients[:, places, i] += z[:, j]
    gradients[:, places, j] += z[:, i]
    equations = gradients @ rep.tensor(z[:, :d], z[:, d:])
    found = _echelon(_null_space(equations.transpose(0, 2, 1).reshape(-1, len(i))))
    Q = np.zeros((len(found), size, size))
    Q[:, i, j] = found / 2
    return Q + Q.transpose(0, 2, 1)


def _echelon(rows: np.ndarray) -> np.ndarray:
    """The reduced row echelon form of independent rows, rid of noise."""
    A, row = rows.copy(), 0
    for column in range(A.shape[1]):
        if row == len(A):
            break
        pivot = row + int(abs(A[row:, column]).argmax())
        if abs(A[pivot, column]) < SAME:
            continue
        A[[row, pivot]] = A[[pivot, row]]
        A[row] /= A[row, column]
        others = np.arange(len(A)) != row
        A[others] -= A[others, column, None] * A[row]
        row += 1
    whole = np.round(A)
    return np.where(abs(A - whole) < SAME, whole, A)
