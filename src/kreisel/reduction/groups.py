"""Matrix Lie groups by a basis of the Lie algebra.

| thing        | convention                                                                            |
|--------------|---------------------------------------------------------------------------------------|
| algebra      | xi = sum_i x_i E_i; E (d, N, N) real or complex                                         |
| dual         | M_i = <M, E_i>: coordinates in the dual basis                                           |
| ad*          | <ad*_xi M, eta> = <M, [xi, eta]>;   on so(n): ad*_xi M = [M, xi]                        |
| Ad*          | <Ad*_g M, eta> = <M, g eta g^-1>;   on so(n): Ad*_g M = g^T M g                         |
| retraction   | W = retract(x), x in R^d, with derivative sum_i x_i E_i at 0: cay(xi/2) or exp(xi)      |

Pure functions of JAX arrays without batch axes; `jax.vmap` adds them.  [Suris 2001, sections 2 and 3]

Representations Phi on V, and their conventions:

| thing     | convention                                                                                   |
|-----------|----------------------------------------------------------------------------------------------|
| phi       | phi(xi) v = d/ds Phi(exp(s xi)) v at 0; phi (d, q, q) holds the matrices phi(E_i)              |
| phi*      | <phi*(xi) y, v> = <y, phi(xi) v>                                                              |
| diamond   | <y <> v, xi> = -<y, phi(xi) v>;   on so(n), R^n: y <> v = v ^ y                               |
| bracket   | {M_i, M_j} = sum_k c_ij^k M_k, {M_i, P_a} = -(phi(E_i) P)_a, {P_a, P_b} = 0: plus, moving frame |

The rest frame has the opposite sign.  [Suris 2001, section 2, (PB left red)]
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, shown
from kreisel.record.calling import Portable
from kreisel.reduction import numerics
from kreisel.reduction.numerics import double, jax

jnp = jax.numpy
CLOSED, SAME = 1e-10, 1e-9
RETRACTIONS = ("cayley", "exponential")


@dataclass(frozen=True)
class Space:
    """The user's form of a point of R^dim: a skew matrix, a vector, or `dim` values (kind "R^dim")."""

    kind: str
    dim: int
    n: int

    def array(self, x: Array) -> Array:
        """Coordinates (..., dim) in the user's form."""
        return algebra.KINDS[self.kind].unpack(x, self.n)

    def coordinates(self, value: Array) -> Array:
        """The inverse of `array`."""
        return algebra.KINDS[self.kind].pack(value)


def numbers(dim: int, n: int) -> Space:
    """R^dim: a vector if dim = n, else `dim` values."""
    return Space("vector" if dim == n else f"R^{dim}", dim, n)


@dataclass(frozen=True, eq=False)
class Group:
    """A matrix group: its name, basis (d, N, N) of the algebra, and the user's form of momenta.

    retraction   "cayley" if cay maps the algebra into the group (checked at random points), else "exponential"

    Raises `InputError` if the basis is not independent over R or does not close under the bracket, and if the Cayley
    transform is requested and leaves the group.
    """

    name: str
    basis: Array
    retraction: str = ""
    n: int = 0
    skew: bool = False

    def __post_init__(self) -> None:
        try:
            E = np.asarray(self.basis)
            E = E.astype(np.complex128 if np.iscomplexobj(E) else np.float64)
        except (TypeError, ValueError, OverflowError):
            E = np.empty(0)
        if E.ndim != 3 or E.shape[-1] != E.shape[-2] or not E.size or not np.isfinite(E).all():
            shape = np.shape(self.basis)
            raise InputError(f"The basis of {self.name} must be finite matrices (d, N, N), got shape {shape}.")
        if np.linalg.matrix_rank(_real(E)) < len(E):
            raise InputError(
                f"The basis of {self.name} must be linearly independent over the reals; its rank is less than d."
            )
        object.__setattr__(self, "basis", E)
        object.__setattr__(self, "n", self.n or E.shape[-1])
        brackets = E[:, None] @ E[None, :] - E[None, :] @ E[:, None]
        off = abs(_real(brackets) - self.structure @ _real(E))
        if off.max() > CLOSED * max(abs(brackets).max(), 1):
            i, j = np.unravel_index(off.max(-1).argmax(), off.shape[:2])
            raise InputError(
                f"The basis of {self.name} does not close under the bracket: [E_{i}, E_{j}] lies outside its span by "
                f"{off.max():.3g}. Usual cause: a basis element is missing or has a wrong sign."
            )
        if self.retraction not in ("", *RETRACTIONS):
            raise InputError(f"retraction must be one of {', '.join(RETRACTIONS)}, got {shown(self.retraction)}.")
        stays = self.retraction != "exponential" and _cayley_stays(self)
        if self.retraction == "cayley" and not stays:
            raise InputError(
                f"The Cayley transform does not map the algebra of {self.name} into the group: it does so for groups "
                "of matrices with g^T S g = S, and for SE(n). Use retraction='exponential'."
            )
        object.__setattr__(self, "retraction", "cayley" if stays else "exponential")

    def __repr__(self) -> str:
        return f"<{self.name}, dimension {self.dim}, {self.retraction}>"

    def same(self, group: Any) -> bool:
        """Whether this is the group, too: equal basis, retraction and form of the momenta, under any name."""
        if not isinstance(group, Group) or (self.retraction, self.skew) != (group.retraction, group.skew):
            return False
        return np.array_equal(self.basis, group.basis)

    @property
    def dim(self) -> int:
        """The dimension d of the group."""
        return len(self.basis)

    @cached_property
    def _rotations(self) -> bool:
        return self.skew and self.n == 3 and self.retraction == "cayley"

    @cached_property
    def unitary(self) -> bool:
        """Whether all elements are unitary: then g^-1 is the adjoint matrix."""
        return bool(abs(self.basis + self.basis.conj().swapaxes(-1, -2)).max() < CLOSED)

    def inverse(self, g: Array) -> Array:
        """g^-1."""
        return g.conj().T if self.unitary else numerics.inverse(g)

    @property
    def size(self) -> int:
        """N: elements are N x N matrices."""
        return self.basis.shape[-1]

    @cached_property
    def dual(self) -> Space:
        """The user's form of momenta."""
        return Space("skew", self.dim, self.n) if self.skew else numbers(self.dim, self.n)

    @cached_property
    def _dual_basis(self) -> np.ndarray:
        return np.linalg.pinv(_real(self.basis).T)

    @cached_property
    def structure(self) -> np.ndarray:
        """c[i, j, k] with [E_i, E_j] = sum_k c[i, j, k] E_k."""
        E = self.basis
        brackets = E[:, None] @ E[None, :] - E[None, :] @ E[:, None]
        out = _real(brackets) @ self._dual_basis.T
        return np.where(abs(out - np.round(out)) < CLOSED, np.round(out), out)

    def matrix(self, x: Array) -> Array:
        """sum_i x_i E_i, (N, N)."""
        return (x[:, None, None] * self.basis).sum(0)

    def coordinates(self, X: Array) -> Array:
        """X of X = sum_i x_i E_i; the nearest for X outside the algebra."""
        parts = [X.real.ravel(), X.imag.ravel()] if np.iscomplexobj(self.basis) else [X.ravel()]
        return (self._dual_basis * jnp.concatenate(parts)).sum(-1)

    def retract(self, x: Array) -> Array:
        """cay(xi/2) = (I + xi/2)(I - xi/2)^-1 or exp(xi)."""
        xi, unit = self.matrix(x), jnp.eye(self.size)
        if self.retraction == "exponential":
            return jax.scipy.linalg.expm(xi)
        if self._rotations:  # X^3 = -|u|^2 X for X = hat(u)
            return unit + (xi + xi @ xi / 2) / (1 + x @ x / 4)
        return algebra.solve(unit - xi / 2, unit + xi / 2)

    def solved(self, off: Callable[..., Array], *args: Array) -> Array:
        """The W with off(W, *args) = 0 on the branch of W = I; NaN if there is none."""
        return self.retract(numerics.find_root(lambda x, *args: off(self.retract(x), *args), self.dim, *args))

    def unretract(self, W: Array) -> Array:
        """The x with retract(x) = W: the coordinates of 2 (W + I)^-1 (W - I), or of log W by Newton's method."""
        unit = jnp.eye(self.size)
        if self._rotations:
            return self.coordinates(2 * (W - W.T)) / (1 + jnp.trace(W))
        if self.retraction == "cayley":
            return self.coordinates(2 * algebra.solve(W + unit, W - unit))

        def off(x: Array, W: Array) -> Array:
            return self.coordinates(jax.scipy.linalg.expm(-self.matrix(x)) @ W - unit)

        return numerics.find_root(off, self.dim, W)

    def ad_star(self, x: Array, M: Array) -> Array:
        """ad*_xi M in coordinates."""
        return jnp.einsum("i,ijk,k->j", x, self.structure, M)

    def Ad(self, g: Array) -> Array:
        """The matrix (d, d) of eta -> g eta g^-1 in coordinates."""
        turned = g @ self.basis @ self.inverse(g)
        return jax.vmap(self.coordinates)(turned).T

    def Ad_star(self, g: Array, M: Array) -> Array:
        """Ad*_g M in coordinates."""
        return self.Ad(g).T @ M


def _real(E: np.ndarray) -> np.ndarray:
    """Matrices (..., N, N) as rows of real entries."""
    flat = E.reshape((*E.shape[:-2], -1))
    return np.concatenate([flat.real, flat.imag], -1) if np.iscomplexobj(E) else flat


def _cayley_stays(group: Group) -> bool:
    """cay(xi/2)^-1 d cay(xi/2) lies in the algebra at random xi, so the image lies in the group."""
    rng, unit = np.random.default_rng(0), np.eye(group.size)
    xi = np.tensordot(rng.uniform(-1, 1, group.dim), group.basis, 1) / 4
    # d cay(xi/2) eta = (I - xi/2)^-1 eta (I - xi/2)^-1
    left, right = np.linalg.inv(unit + xi), np.linalg.inv(unit - xi)
    tangents = left @ group.basis @ right
    flat = _real(tangents)
    return bool(abs(flat @ group._dual_basis.T @ _real(group.basis) - flat).max() < CLOSED * abs(tangents).max())


# -- ready-made ------------------------------------------------------------------------------------


@explained
def SO(n: int) -> Group:
    """Rotations of R^n, n >= 2, with E_ij, i < j: momenta are skew matrices, <X, Y> = -tr(XY)/2."""
    if not isinstance(n, int) or n < 2:
        raise InputError(f"SO(n) needs an integer n >= 2, got {shown(n)}.")
    return Group(f"SO({n})", algebra.skew(np.eye(n * (n - 1) // 2), n), n=n, skew=True)


def SU2() -> Group:
    """SU(2), complex 2 x 2 matrices, with E_j = -i sigma_j/2: [E_1, E_2] = E_3, so su(2)* = R^3 like so(3)*."""
    sigma = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
    return Group("SU(2)", -0.5j * sigma, n=3)


def SE3() -> Group:
    """SE(3) as 4 x 4 matrices [[R, x], [0, 1]]: three rotations hat(e_j), then three shifts; momenta are in R^6."""
    basis = np.zeros((6, 4, 4))
    basis[:3, :3, :3] = algebra.hat(np.eye(3))
    basis[3:, :3, 3] = np.eye(3)
    return Group("SE(3)", basis)


def unit_sums(count: int) -> Group:
    """N x N matrices with unit column sums: they move the masses of N cells, the transposed inverses act on functions.

    E_ij = e_i e_j^T - e_j e_j^T, i != j, ordered by j and then i: the rate of mass from cell j to cell i.
    [Bauer Gay-Balmaz 2017, section 2, by the transposed inverses]
    """
    if not isinstance(count, int) or count < 2:
        raise InputError(f"unit_sums(N) needs an integer N >= 2, got {shown(count)}.")
    unit = np.eye(count)
    to, out_of = unit[None, :, :, None], unit[:, None, None, :]  # [j, i, a, b]
    basis = (to - unit[:, None, :, None]) * out_of
    return Group(f"unit sums of {count}", basis[unit == 0])


def product(*groups: Group) -> Group:
    """G1 x G2 x ...: block-diagonal matrices; momenta are the momenta of the factors, one after the other."""
    if not groups or not all(isinstance(g, Group) for g in groups):
        raise InputError(f"product: expected groups such as red.SO(3), red.SU2(), got {shown(groups)}.")
    size, first, blocks = sum(g.size for g in groups), 0, []
    for g in groups:
        wide = np.zeros((g.dim, size, size), dtype=g.basis.dtype)
        wide[:, first : first + g.size, first : first + g.size] = g.basis
        blocks.append(wide)
        first += g.size
    cayley = all(g.retraction == "cayley" for g in groups)
    name = " x ".join(g.name for g in groups)
    return Group(name, np.concatenate(blocks), "" if cayley else "exponential")


@explained
def matrix_group(basis: Sequence[Any] | Array, name: str = "G", retraction: str = "") -> Group:
    """A user-defined group by a basis (d, N, N) of its Lie algebra.  Raises `InputError` unless it is closed."""
    return Group(name, np.asarray(basis), retraction)


def random_element(group: Group, rng: np.random.Generator, size: float = 0.5) -> Array:
    """A random element near the identity, for checks."""
    with double():
        return np.asarray(group.retract(jnp.asarray(size * rng.uniform(-1, 1, group.dim))))


# -- representations -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Representation:
    """Phi(g) on V = R^q: `act(g, v)` with v in coordinates, `space`, the user's form of V, `phi` (d, q, q)."""

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
        d, size = self.group.dim, self.group.dim + self.dim
        T = np.zeros((size, size, size))  # {z_a, z_b} = sum_k z_k T[k, a, b], z = (M, P)
        T[:d, :d, :d] = self.group.structure.transpose(2, 0, 1)
        mixed = -self.phi.transpose(2, 0, 1)  # [b, i, a]: {M_i, P_a} = -sum_b phi_i[a, b] P_b
        T[d:, :d, d:] = mixed
        T[d:, d:, :d] = -mixed.transpose(0, 2, 1)
        z = np.concatenate([M, P], -1) if isinstance(M, np.ndarray) else jnp.concatenate([M, P], -1)
        return (z @ T.reshape(size, size * size)).reshape((*z.shape[:-1], size, size))

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
    """Phi(g) v = g v on R^N; on C^N, as 2N real values (real parts, then imaginary parts), for complex matrices."""
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
    """The trivial representation, on V = 0: Lagrangians of only Omega or W, such as the Euler top, on g*."""
    return Representation("trivial", group, numbers(0, group.n), lambda g, v: v, np.zeros((group.dim, 0, 0)))


@explained
def representation(group: Group, Phi: Callable[[Array, Array], Array], dim: int, name: str = "Phi") -> Representation:
    """A user-defined representation: Phi(g, v) for g (N, N) and v (dim,), in JAX.

    Raises `InputError` unless Phi is linear in v and Phi(g h) = Phi(g) Phi(h) at random elements.
    """
    if not isinstance(dim, int) or not 1 <= dim <= 10_000:
        raise InputError(f"dim must be an integer from 1 to 10,000, got {shown(dim)}.")
    with double():
        rng = np.random.default_rng(1)
        g, h = random_element(group, rng), random_element(group, rng)
        u, v = rng.uniform(-1, 1, (2, dim))
        try:
            out = [np.asarray(Phi(jnp.asarray(x), jnp.asarray(y))) for x, y in ((g, u), (h, u), (g, v), (g, u - 2 * v))]
        except Exception as error:  # whatever a user's code raises
            raise InputError(f"Phi(g, v) failed for g {g.shape} and v ({dim},): {error}") from error
        if any(y.shape != (dim,) or np.iscomplexobj(y) for y in out):
            raise InputError(f"Phi(g, v) must give {dim} real values for v ({dim},), got shape {out[0].shape}.")
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
    A, row = _null_space(equations.transpose(0, 2, 1).reshape(-1, len(i))), 0
    for column in range(A.shape[1]):
        pivot = row + int(abs(A[row:, column]).argmax()) if row < len(A) else 0
        if row == len(A) or abs(A[pivot, column]) < SAME:
            continue
        A[[row, pivot]] = A[[pivot, row]]
        A[row] /= A[row, column]
        others = np.arange(len(A)) != row
        A[others] -= A[others, column, None] * A[row]
        row += 1
    rows = np.where(abs(A - np.round(A)) < SAME, np.round(A), A)  # without noise
    Q = np.zeros((len(rows), size, size))
    Q[:, i, j] = rows / 2
    return Q + Q.transpose(0, 2, 1)
