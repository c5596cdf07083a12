"""Recorded vectors and matrices of O(n) scalars, on which the definition of a step runs unchanged.

A vector is one block of h entries or, about an axis p, blocks x and y and a number along p.  A matrix is D + T + sum
c s ^ t: D a number or a diagonal, T skew and constant in the step, few pairs s, t.  A recorded scalar represents the
entry at any place k; `total` adds up over k.  About an axis, T maps (x, y) to (-theta y, theta x): the real Schur form
of a skew matrix with T p = 0.  Else T is 0, or a multiple of the momentum M before the step, n^2 scalars; products with
M and with inverses W of D + T, which are part of the state, are O(n^2).

An operation that is not known here raises `TypeError`: the step has no such form.  About an axis, products entry by
entry are known only as a part of <x, y>, so a step that depends on the basis has none.  [Woodbury's formula]
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import accumulate
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra.backend import Complex
from kreisel.graph.graph import Number

Entry = Any  # a recorded number, complex of recorded, or plain
# Operations on entries: the sum over all places (total, x), and products (momentum, M, x), (kept, M, k, x) and
# (turned, M, k, x) with the inverse k and its transpose.
TOTAL, MOMENTUM, KEPT, TURNED = "total", "momentum", "kept", "turned"


def total(x: Entry) -> Entry:
    """The sum of an entry over all places; of an array the sum of its entries."""
    if isinstance(x, Complex):
        return Complex(total(x.re), total(x.im))
    if isinstance(x, Number):
        return x.record(TOTAL, x.positive, negative=x.negative)
    if isinstance(x, np.ndarray):
        return x.sum() if x.dtype.kind == "O" else float(x.sum())
    if x == 0:
        return 0.0
    raise TypeError("the sum of a plain number over all places is not recorded")


def is_number(x: Any) -> bool:
    """Whether it is recorded, complex of recorded, or plain."""
    return isinstance(x, Number | Complex | int | float | np.number)


def key_of(x: Any) -> Any:
    """Equal for equal values in a graph."""
    if isinstance(x, np.ndarray | tuple):
        return tuple(map(key_of, x))
    if isinstance(x, Vector):
        return key_of(x.entries)
    return x.key if isinstance(x, Number) else (key_of(x.re), key_of(x.im)) if isinstance(x, Complex) else float(x)


def is_identity(x: Any) -> bool:
    """Whether it is the identity matrix as an array."""
    return isinstance(x, np.ndarray) and x.ndim == 2 and bool((x == np.eye(len(x))).all())


class Linear:
    """Operators of a linear space by `+` and products with scalars."""

    n: int
    __array_ufunc__: ClassVar[None] = None  # NumPy leaves the operators to this class
    __add__: Any
    __mul__: Any

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("structured vectors and matrices have no entries")

    def __neg__(self) -> Any:
        return self * -1.0

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __sub__(self, other: Any) -> Any:
        return self + (-other) if isinstance(other, Linear) or is_number(other) else NotImplemented

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __truediv__(self, other: Any) -> Any:
        return self * (1 / other) if is_number(other) else NotImplemented

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.n, self.n)


@dataclass(frozen=True, eq=False)
class Vector(Linear):
    """A vector; `axis`: whether it is the axis.

    rows  whether it represents all rows (True) or all columns (False) of a matrix; None for a vector
    """

    n: int
    entries: tuple[Entry, ...]
    axis: bool = False
    rows: bool | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.n,) * (1 if self.rows is None else 2)

    @property
    def mT(self) -> Vector:
        return replace(self, rows=not self.rows)

    @property
    def about(self) -> bool:
        """Whether its entries are those about an axis."""
        return len(self.entries) > 1

    def map(self, function: Callable[..., Entry], *others: Vector) -> Vector:
        """The function of all entries."""
        entries = zip(self.entries, *(v.entries for v in others), strict=True)
        return Vector(self.n, tuple(function(*x) for x in entries), rows=self.rows)

    def like(self, *entries: Entry) -> Vector:
        """Other entries of the same kind."""
        return Vector(self.n, entries, rows=self.rows)

    def __getitem__(self, index: Any) -> Vector:
        if index in ((Ellipsis, None), (Ellipsis, 0)):  # a vector as a column, and back
            return self
        raise TypeError(f"a structured vector cannot be indexed by {index!r}")

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return self.map(operator.add, other)
        return self.map(lambda x: x + other) if is_number(other) and not self.about else NotImplemented

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Vector):
            products = self.map(operator.mul, other)
            return Products(products.entries) if self.about else products
        if is_identity(other) and not self.about:
            return Matrix(self.n, diagonal=self)
        return self.map(lambda x: x * other) if is_number(other) else NotImplemented

    def sum(self, axis: int) -> Entry:
        if self.about:
            raise TypeError("a sum of entries depends on the basis")
        return total(self.entries[0])

    def record_wedge(self, operand: Vector) -> Matrix:
        return Matrix(self.n).with_pair(1.0, self, operand)

    def record_parts(self) -> tuple[Vector, Vector | None]:
        if not any(isinstance(x, Complex) for x in self.entries):
            return self, None
        re = self.map(lambda x: x.re if isinstance(x, Complex) else x)
        return re, self.map(lambda x: x.im if isinstance(x, Complex) else 0.0)


class Products(NamedTuple):
    """Products of the entries of two vectors about an axis, which can only be added up."""

    entries: tuple[Entry, ...]

    def sum(self, axis: int) -> Entry:
        x, y, along = self.entries
        return total(x + y) + along


class Nothing(Linear):
    """The entries of a constant matrix: none that change, and none to compute with."""

    shape, size = (0,), 0

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.zeros(0)


@dataclass(eq=False)
class Dense:
    """The momentum M before a step, and its inverses: (D, theta) of each, and |r|^2, |v|^2 of its first solve of v."""

    momentum: Number
    inverses: list[tuple[Any, Entry]] = field(default_factory=list)
    checks: dict[int, tuple[Number, Number]] = field(default_factory=dict)

    def applied(self, operation: str, v: Vector, *numbers: int) -> Vector:
        (x,) = v.entries
        if not isinstance(x, Number):
            raise TypeError("products of a dense momentum with complex vectors are not recorded")
        return v.like(x.record(operation, self.momentum, *numbers, x.positive, negative=x.negative))

    def inverse(self, diagonal: Any, turn: Entry) -> int:
        """The number of the inverse of D + theta M."""
        wanted = key_of((diagonal, turn))
        if wanted not in map(key_of, self.inverses):
            self.inverses.append((diagonal, turn))
        return [*map(key_of, self.inverses)].index(wanted)

    def change(self, k: int, pairs: list[tuple[Entry, Vector, Vector]]) -> list[tuple[Vector, Vector]]:
        """Vectors x, r of Woodbury's formula: the inverse k of M + sum c s ^ t is W - sum x r^T."""
        theta = self.inverses[k][1]
        terms = [term for c, s, t in pairs for term in ((theta * c, s, t), (-(theta * c), t, s))]  # a x y^T
        left = [self.applied(KEPT, x, k) for _, x, _ in terms]
        right = [self.applied(TURNED, y, k) for _, _, y in terms]
        G = np.array([[a * algebra.dot(y, Wx) for Wx in left] for a, _, y in terms], dtype=object)
        weights = algebra.solve(G + algebra.identity(len(G)), np.diag([a for a, _, _ in terms]))
        return [(x, reduce(operator.add, map(operator.mul, right, row))) for x, row in zip(left, weights, strict=True)]


@dataclass(frozen=True, eq=False)
class Matrix(Linear):
    """diagonal + T + sum c s ^ t, T by its entry theta, `turn`, or `turn` times the momentum of `dense`.

    pairs  (c, s, t), by the key of t
    kept   whether T is a constant of the trajectory, whose entries are asked for to see what changes
    """

    n: int
    diagonal: Any = 0.0
    turn: Entry = 0.0
    pairs: dict[Any, tuple[Entry, Vector, Vector]] = field(default_factory=dict)
    dense: Dense | None = None
    kept: bool = False

    def with_pair(self, c: Entry, s: Vector, t: Vector) -> Matrix:
        """Plus c s ^ t; pairs with the same t become one."""
        if s.about and s.axis and not t.axis:
            c, s, t = -c, t, s
        if t.axis:
            s = s.like(*s.entries[:2], 0.0)
        before = self.pairs.get(key_of(t))
        if before is not None:
            b, r, _ = before
            c, s = (b + c, s) if key_of(r) == key_of(s) else (1.0, r * b + s * c)
        pairs = {**self.pairs, key_of(t): (c, s, t)}
        if not isinstance(c, Number) and c == 0.0:
            del pairs[key_of(t)]
        return replace(self, pairs=pairs)

    def used(self) -> list[tuple[Entry, Vector, Vector]]:
        """The pairs, c within s unless products with s are what costs.

        In a million steps Neumann's |x|^2 drifts by 3.7 widths of a random walk with c <s, y>, by 0.2 with <c s, y>.
        """
        return [(c, s, t) if self.dense else (1.0, s * c, t) for c, s, t in self.pairs.values()]

    def __add__(self, other: Any) -> Any:
        if is_identity(other):
            return replace(self, diagonal=self.diagonal + 1.0)
        if not isinstance(other, Matrix):
            return NotImplemented
        parts = self.diagonal + other.diagonal, self.turn + other.turn, self.pairs, self.dense or other.dense
        return reduce(lambda X, pair: X.with_pair(*pair), other.pairs.values(), Matrix(self.n, *parts))

    def __mul__(self, other: Any) -> Any:
        if not is_number(other):
            return NotImplemented
        pairs = {key: (c * other, s, t) for key, (c, s, t) in self.pairs.items()}
        return replace(self, diagonal=self.diagonal * other, turn=self.turn * other, pairs=pairs)

    def __getitem__(self, index: Any) -> Any:
        if self.kept and not self.pairs and key_of(self.diagonal) == 0.0:
            return Nothing()
        raise TypeError(f"a structured matrix has no entries: {index!r}")

    def _require_skew(self, purpose: str, pairs: bool = True) -> None:
        """Raises `TypeError` for a diagonal, a dense momentum or, if asked, pairs."""
        if self.dense or key_of(self.diagonal) != 0.0 or (self.pairs and not pairs):
            raise TypeError(f"{purpose} is known for T{' + sum c s ^ t' if pairs else ''} only")

    def record_pairing(self, operand: Matrix) -> Entry:
        """<X, Y> = <T, S> + sum <u, T v> + <s, S t> + <s, u> <t, v> - <s, v> <t, u> over the pairs s, t and u, v."""
        self._require_skew("a pairing")
        operand._require_skew("a pairing")
        out, dot = total(self.turn * operand.turn), algebra.dot
        for _, u, v in operand.used():
            out = out + dot(u, self._turned(v))
        for _, s, t in self.used():
            out = out + dot(s, operand._turned(t))
            for _, u, v in operand.used():
                out = out + (dot(s, u) * dot(t, v) - dot(s, v) * dot(t, u))
        return out

    def record_characteristic(self, last: int) -> list[Entry]:
        """c_k, k = 0..last, of det(mu - X) for X = T + s ^ p, p the axis, <s, p> = 0.

        det(mu - X) = det(mu - T) (1 + <p, p> <s, (mu - T)^-1 s>/mu).  [matrix determinant lemma]
        """
        self._require_skew("a characteristic polynomial")
        ((_, s, p),) = self.used() or [(0.0, Vector(self.n, ()), Vector(self.n, ()))]
        if not p.axis:
            raise TypeError("a characteristic polynomial of other than T + s ^ p")
        squares, of_T = self.turn * self.turn, [1.0]
        powers = [*accumulate([squares] * max(1, last // 2), operator.mul)]  # theta^2j; tr T^2j = 2 (-1)^j sum theta^2j
        for k in range(1, last + 1):
            terms = (2 * (-1) ** j * of_T[k - 2 * j - 2] * total(powers[j]) for j in range(k // 2))
            of_T.append(0.0 if k % 2 else sum(terms) / k)
        out, square, v = of_T[:2], algebra.dot(p, p), s
        for k in range(2, last + 1):  # v = B_(k-2) s, adj(mu - T) = sum B_k mu^(n-1-k)
            out.append(of_T[k] + square * algebra.dot(s, v))
            v = self._turned(v) + s * of_T[k - 1]
        return out

    def record_shifted(self, mu: Entry) -> Matrix:
        """mu - X."""
        return replace(-self, diagonal=mu - self.diagonal)

    def record_project_out(self, p: Vector) -> Matrix:
        """|p|^2 pi X pi; about the axis p only p^2 T is left."""
        if not p.axis:
            return self * algebra.dot(p, p) - algebra.wedge(self @ p, p)
        return replace(self * algebra.dot(p, p), pairs={})

    def record_conjugate(self, X: Matrix) -> Matrix:
        """cay(X) Y cay(X)^-1 for a rotation X in the planes of T."""
        X._require_skew("a rotation about the axis", pairs=False)
        return replace(self, pairs={key: (c, algebra.cayley_act(X, s), t) for key, (c, s, t) in self.pairs.items()})

    def __matmul__(self, v: Vector) -> Vector:
        out = self._turned(v)
        for c, s, t in self.used():
            out = out + (s * (c * algebra.dot(t, v)) - t * (c * algebra.dot(s, v)))
        return out

    def _turned(self, v: Vector) -> Vector:
        """(D + T) v."""
        if v.rows:
            raise TypeError("a product with a matrix that is known by its rows")
        if v.about:
            x, y, _ = v.entries
            return v * self.diagonal + v.like(-(self.turn * y), self.turn * x, 0.0)
        return self.diagonal * v + (self.dense.applied(MOMENTUM, v) * self.turn if self.dense else 0.0)

    def record_solve(self, v: Vector) -> Vector:
        """(D + T + sum c s ^ t)^-1 v; with an inverse that is kept, corrected once by the residual, which is checked.

        Such an inverse is correct to 1e-9, relative, or made anew (`kreisel.kernels.large.kernel.NEAR`).
        """
        y = self._solved(v, self.used())
        if not self.dense:
            return y
        r = v - self @ y
        k = self.dense.inverse(self.diagonal, self.turn)
        self.dense.checks.setdefault(k, (algebra.dot(r, r), algebra.dot(v, v)))
        return y + self._solved(r, self.used())

    def _solved(self, v: Vector, pairs: list[tuple[Entry, Vector, Vector]]) -> Vector:
        """By Woodbury's formula for the last pair: y = R (v - c s <t, y> + c t <s, y>), R the inverse without it."""
        if not pairs:
            return self._unturned(v)
        *previous, (k, s, t) = pairs
        dot, (Rv, Rs, Rt) = algebra.dot, (self._solved(x, previous) for x in (v, s, t))
        a, b, c, d = 1 + k * dot(t, Rs), -(k * dot(t, Rt)), k * dot(s, Rs), 1 - k * dot(s, Rt)
        scale, tv, sv = 1 / (a * d - b * c), k * dot(t, Rv), k * dot(s, Rv)
        return Rv - Rs * ((d * tv - b * sv) * scale) + Rt * ((a * sv - c * tv) * scale)

    def _unturned(self, v: Vector) -> Vector:
        """(D + T)^-1 v."""
        if v.rows:
            raise TypeError("a solve for a matrix that is known by its rows")
        c, theta = self.diagonal, self.turn
        if self.dense:
            return self.dense.applied(KEPT, v, self.dense.inverse(c, theta))
        if not v.about:
            return v.map(operator.truediv, c) if isinstance(c, Vector) else v / c
        x, y, along = v.entries
        scale = 1 / (c * c + theta * theta)
        return v.like((c * x + theta * y) * scale, (c * y - theta * x) * scale, along * (1 / c))
