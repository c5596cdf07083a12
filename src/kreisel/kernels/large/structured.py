"""Recorded vectors and matrices of O(n) scalars, on which the definition of a step runs as it is written.

A vector is a few blocks of h entries and, about an axis p, a number for its part along p.  A matrix is D + T + sum
c_i s_i ^ t_i with D a number or a diagonal, T skew and the same for the complete step, and few pairs s_i, t_i.  The
entries are recorded scalars that represent the entry at any place k; `total` adds up over k.

About an axis, T turns block x into block y by theta and the axis is (0, 0, |p|): the canonical form of a constant skew
matrix with T p = 0.  A basis of that kind may be chosen only for steps that mean the same in every orthonormal basis.
Those are the steps that can be recorded: products entry by entry are known there only as a part of <x, y>.
An unknown operation raises `TypeError`: the step has no such form.  [Woodbury's formula; real Schur form]

Else T is a multiple of the momentum M as the step found it, `Dense`, of n^2 scalars: products with it and with kept
inverses of D + T are O(n^2).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra.complex import Complex
from kreisel.graph.graph import Number

Entry = Any  # a recorded number, complex of recorded, or plain

# Operations in addition to the operations of scalars: the sum of an entry over all places, (total, x), and entries of
# a product with the momentum, (momentum, M, x), with a kept inverse, (kept, M, k, x), or its transpose.
TOTAL, MOMENTUM, KEPT, TURNED = "total", "momentum", "kept", "turned"


def total(x: Entry) -> Entry:
    """The sum of an entry over all places."""
    if isinstance(x, Complex):
        return Complex(total(x.re), total(x.im))
    if isinstance(x, Number):
        return x.record(TOTAL, x.positive, negative=x.negative)
    if isinstance(x, np.ndarray):  # all entries, one after the other
        return x.sum() if x.dtype.kind == "O" else float(x.sum())
    if x == 0:
        return 0.0
    raise TypeError("the sum of a plain number over all places is not recorded")


def is_number(x: Any) -> bool:
    """Whether it is recorded, complex of recorded, or plain."""
    return isinstance(x, Number | Complex | int | float | np.number)


def key_of(x: Any) -> Any:
    """Equal for what is the same in a graph: scalars and vectors, by their `key`, arrays and tuples of them."""
    if hasattr(x, "key"):
        return x.key
    if isinstance(x, np.ndarray | tuple):
        return tuple(map(key_of, x))
    return (key_of(x.re), key_of(x.im)) if isinstance(x, Complex) else float(x)


def parts(x: Entry) -> tuple[Entry, Entry]:
    """Real and imaginary part."""
    return (x.re, x.im) if isinstance(x, Complex) else (x, 0.0)


class Nothing:
    """The entries of a constant matrix: none that change, and none to compute with."""

    ndim, shape, size = 1, (0,), 0
    __array_ufunc__: ClassVar[None] = None

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.zeros(0)


@dataclass(eq=False)
class Dense:
    """The momentum M of a step, recorded, with the inverses of diagonal + turn M that it solves by.

    inverses  (diagonal, turn) of each kept inverse
    checks    of each, by the first solve: |r|^2 and |v|^2, r the residual
    """

    momentum: Number
    inverses: list[tuple[Any, Entry]] = field(default_factory=list)
    checks: dict[int, tuple[Number, Number]] = field(default_factory=dict)

    def applied(self, v: StructuredVector, operation: str, *numbers: int) -> StructuredVector:
        """M v, or a kept inverse of that number, or its transpose, times v."""
        (x,) = v.entries
        if not isinstance(x, Number):
            raise TypeError("products of the dense momentum with complex vectors are not recorded")
        return v.like([x.record(operation, self.momentum, *numbers, x.positive, negative=x.negative)])

    def inverse(self, diagonal: Any, turn: Entry) -> int:
        """The number of the kept inverse of diagonal + turn M."""
        keys, wanted = [key_of(pair) for pair in self.inverses], key_of((diagonal, turn))
        if wanted not in keys:
            self.inverses.append((diagonal, turn))
        return [*keys, wanted].index(wanted)


def changed_inverse(
    dense: Dense, k: int, pairs: Sequence[tuple[Entry, StructuredVector, StructuredVector]]
) -> list[tuple[StructuredVector, StructuredVector]]:
    """Vectors x, r: the inverse k of M + sum c s ^ t is W - sum x r^T, W that of M, by Woodbury's formula."""
    turn = dense.inverses[k][1]
    changes = [change for c, s, t in pairs for change in ((turn * c, s, t), (-(turn * c), t, s))]  # a x y^T
    left = [dense.applied(x, KEPT, k) for _, x, _ in changes]
    right = [dense.applied(y, TURNED, k) for _, _, y in changes]
    G = np.array([[a * algebra.dot(y, Wx) for Wx in left] for a, _, y in changes], dtype=object)
    weights = algebra.solve(G + algebra.identity(len(G)), np.diag([a for a, _, _ in changes]))
    sums = (reduce(operator.add, map(operator.mul, right, row)) for row in weights)
    return list(zip(left, sums, strict=True))


@dataclass(frozen=True, eq=False)
class StructuredVector:
    """One block of entries; about an axis two, and a number along it.

    axis  whether it is the axis itself
    rows  of any column of an n x n matrix False, of any row True, for what is done to each alike; None for a vector
    """

    n: int
    entries: tuple[Entry, ...]
    axis: bool = False
    rows: bool | None = None

    __array_ufunc__: ClassVar[None] = None  # so that NumPy leaves its operators to us

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("a structured vector has no entries")

    def __pow__(self, exponent: int) -> Any:
        return self * self if exponent == 2 else NotImplemented

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        return (self.n,) * (1 if self.rows is None else 2)

    @property
    def mT(self) -> StructuredVector:
        return replace(self, rows=not self.rows)

    @property
    def canonical(self) -> bool:
        """Whether it is given in the basis about an axis."""
        return len(self.entries) > 1

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for vectors that are the same in a graph."""
        return key_of(self.entries)

    def map(self, function: Callable[..., Entry], *others: StructuredVector) -> StructuredVector:
        """The function on all entries."""
        return self.like(function(*x) for x in zip(self.entries, *(v.entries for v in others), strict=True))

    def like(self, entries: Iterable[Entry]) -> StructuredVector:
        """Other entries of the same kind."""
        return StructuredVector(self.n, tuple(entries), rows=self.rows)

    def across(self) -> StructuredVector:
        """Without the part along the axis."""
        return StructuredVector(self.n, (*self.entries[:2], 0.0))

    def __getitem__(self, index: Any) -> StructuredVector:
        """A vector as a column, and back."""
        if index in ((Ellipsis, None), (Ellipsis, 0)):
            return self
        raise TypeError(f"a structured vector cannot be indexed by {index!r}")

    def __neg__(self) -> StructuredVector:
        return self.map(operator.neg)

    def __add__(self, other: Any) -> Any:
        if isinstance(other, StructuredVector):
            return self.map(operator.add, other)
        if is_number(other) and not self.canonical:
            return self.map(lambda x: x + other)
        return NotImplemented

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + (-other) if isinstance(other, StructuredVector) or is_number(other) else NotImplemented

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, StructuredVector):
            products = self.map(operator.mul, other)
            return Products(products.entries) if self.canonical else products
        if is_number(other):
            return self.map(lambda x: x * other)
        if _is_identity(other) and not self.canonical:
            return StructuredMatrix(self.n, diagonal=self)
        return NotImplemented

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self.map(lambda x: x / other) if is_number(other) else NotImplemented

    def sum(self, axis: int) -> Entry:
        """The sum of all entries, which has a meaning only in its basis."""
        if self.canonical:
            raise TypeError("a sum of entries depends on the basis")
        return total(self.entries[0])

    def record_wedge(self, other: StructuredVector) -> StructuredMatrix:
        return StructuredMatrix(self.n).with_pair(self, other)

    def record_parts(self) -> tuple[StructuredVector, StructuredVector | None]:
        if not any(isinstance(x, Complex) for x in self.entries):
            return self, None
        return self.map(lambda x: parts(x)[0]), self.map(lambda x: parts(x)[1])

    def record_complex(self, im: StructuredVector) -> StructuredVector:
        return self.map(Complex, im)


class Products(NamedTuple):
    """Products entry by entry in a basis about an axis, to be added up."""

    entries: tuple[Entry, ...]

    def sum(self, axis: int) -> Entry:
        """<x, y>."""
        x, y, along = self.entries
        return total(x + y) + along


def _require_columns(v: StructuredVector) -> None:
    if v.rows:
        raise TypeError("a product with a matrix that is known by its rows")


def _is_identity(other: Any) -> bool:
    return isinstance(other, np.ndarray) and other.ndim == 2 and bool((other == np.eye(len(other))).all())


@dataclass(frozen=True, eq=False)
class StructuredMatrix:
    """diagonal + T + sum c s ^ t: `diagonal` a number or a vector; T its entry theta, `turn`, or `turn` times `dense`.

    The pairs have the key of their t.
    """

    n: int
    diagonal: Any = 0.0
    turn: Entry = 0.0
    pairs: dict[Any, tuple[Entry, StructuredVector, StructuredVector]] = field(default_factory=dict)
    dense: Dense | None = None
    kept: bool = False  # T is known to be constant, and its entries are asked for to see what changes

    __array_ufunc__: ClassVar[None] = None

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("a structured matrix has no entries")

    @property
    def ndim(self) -> int:
        return 2

    @property
    def shape(self) -> tuple[int, int]:
        return (self.n, self.n)

    def with_pair(self, s: StructuredVector, t: StructuredVector, c: Entry = 1.0) -> StructuredMatrix:
        """Plus c s ^ t; pairs with the same t are one, and what does not count of s along an axis t goes."""
        if s.canonical and not t.axis and s.axis:
            s, t = -t, s
        before = self.pairs.get(t.key)
        if s.canonical:
            s, c = (s.across() if t.axis else s) * c, 1.0
            s = s if before is None else before[1] + s
        elif before is not None:
            b, r, _ = before
            c, s = (b + c, s) if r.key == s.key else (1.0, r * b + s * c)
        pairs = {**self.pairs, t.key: (c, s, t)}
        if not isinstance(c, Number) and c == 0.0:
            del pairs[t.key]
        return replace(self, pairs=pairs)

    def __neg__(self) -> StructuredMatrix:
        return self * -1.0

    def __add__(self, other: Any) -> Any:
        if _is_identity(other):
            return replace(self, diagonal=self.diagonal + 1.0)
        if isinstance(other, StructuredMatrix):
            out = replace(
                self,
                diagonal=self.diagonal + other.diagonal,
                turn=self.turn + other.turn,
                dense=self.dense or other.dense,
            )
            for c, s, t in other.pairs.values():
                out = out.with_pair(s, t, c)
            return out
        return NotImplemented

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + (-other) if isinstance(other, StructuredMatrix) else NotImplemented

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other

    def __mul__(self, other: Any) -> Any:
        if not is_number(other):
            return NotImplemented
        pairs = {k: (c, s * other, t) if s.canonical else (c * other, s, t) for k, (c, s, t) in self.pairs.items()}
        return replace(self, diagonal=self.diagonal * other, turn=self.turn * other, pairs=pairs)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self * (1 / other) if is_number(other) else NotImplemented

    def __getitem__(self, index: Any) -> Any:
        if self.kept and not self.pairs and key_of(self.diagonal) == 0.0:
            return Nothing()
        raise TypeError(f"a structured matrix has no entries: {index!r}")

    def record_pairing(self, other: StructuredMatrix) -> Entry:
        """<X, Y> = <T, S> + sum <u_i, T v_i> + <s_i, S t_i> + <s_i, u_j> <t_i, v_j> - <s_i, v_j> <t_i, u_j>."""
        if self.dense or other.dense or key_of(self.diagonal) != 0.0 or key_of(other.diagonal) != 0.0:
            raise TypeError("a pairing of other than T + sum c s ^ t")
        out = total(self.turn * other.turn)
        for c, u, v in other.pairs.values():
            out = out + c * algebra.dot(u, self._turned(v))
        for k, s, t in self.pairs.values():
            out = out + k * algebra.dot(s, other._turned(t))
            for c, u, v in other.pairs.values():
                both = algebra.dot(s, u) * algebra.dot(t, v) - algebra.dot(s, v) * algebra.dot(t, u)
                out = out + (k * c) * both
        return out

    def record_characteristic(self, last: int) -> list[Entry]:
        """c_k, k = 0..last, of det(mu - X) for X = T + s ^ p, p the axis, <s, p> = 0.

        det(mu - X) = det(mu - T) (1 + <p, p> <s, (mu - T)^-1 s>/mu).  [matrix determinant lemma]
        """
        if len(self.pairs) != 1:
            raise TypeError("a characteristic polynomial of other than T + s ^ p")
        ((scale, s, p),) = self.pairs.values()
        if not p.axis or self.dense or key_of(self.diagonal) != 0.0:
            raise TypeError("a characteristic polynomial of other than T + s ^ p")
        powers, c = [self.turn * self.turn], [1.0]  # theta^2j; tr T^2j = 2 (-1)^j sum theta^2j
        while 2 * len(powers) < last:
            powers.append(powers[-1] * powers[0])
        traces = [2 * (-1) ** (j + 1) * total(power) for j, power in enumerate(powers)]
        for k in range(1, last + 1):
            odd = k % 2 == 1
            c.append(0.0 if odd else -sum(c[k - 2 * j - 2] * traces[j] for j in range(k // 2)) / k)
        square, v = algebra.dot(p, p) * scale * scale, s
        out = c[:2]
        for k in range(2, last + 1):  # v = B_(k-2) s
            out.append(c[k] + square * algebra.dot(s, v))
            v = self._turned(v) + s * c[k - 1]
        return out

    def record_parts(self) -> tuple[StructuredMatrix, None]:
        return self, None

    def record_shifted(self, mu: Entry) -> StructuredMatrix:
        """mu - X."""
        back = -self
        return replace(back, diagonal=back.diagonal + mu)

    def record_project_out(self, p: StructuredVector) -> StructuredMatrix:
        """|p|^2 pi X pi; for the axis p T alone is left."""
        if not p.axis:
            return self * algebra.dot(p, p) - algebra.wedge(self @ p, p)
        if key_of(self.diagonal) != 0.0:
            raise TypeError("pi X pi of a diagonal")
        return StructuredMatrix(self.n, turn=self.turn * algebra.dot(p, p), kept=self.kept)

    def record_conjugate(self, X: StructuredMatrix) -> StructuredMatrix:
        """cay(X) Y cay(X)^-1 for a rotation X in the planes of T."""
        if X.pairs or key_of(X.diagonal) != 0.0 or self.dense:
            raise TypeError("a rotation that changes the axis")
        pairs = {key: (c, algebra.cayley_act(X, s), t) for key, (c, s, t) in self.pairs.items()}
        return replace(self, pairs=pairs)

    def _own_pairs(self) -> list[tuple[Entry, StructuredVector, StructuredVector]]:
        """The pairs, the scalars in s unless products with s are what costs.

        In a million steps Neumann's |x|^2 drifts by 3.7 widths of a random walk with <s, y> multiplied afterwards, by
        0.2 like this.
        """
        return [(c, s, t) if self.dense else (1.0, s * c, t) for c, s, t in self.pairs.values()]

    def __matmul__(self, v: StructuredVector) -> StructuredVector:
        out = self._turned(v)
        for c, s, t in self._own_pairs():
            out = out + (s * (c * algebra.dot(t, v)) - t * (c * algebra.dot(s, v)))
        return out

    def _turned(self, v: StructuredVector) -> StructuredVector:
        _require_columns(v)
        out = self.diagonal * v
        if isinstance(out, Products):
            raise TypeError("a diagonal about an axis")
        if v.canonical:
            x, y, _ = v.entries
            return out + v.like([-(self.turn * y), self.turn * x, 0.0])
        return out + self.dense.applied(v, MOMENTUM) * self.turn if self.dense else out

    def _unturned(self, v: StructuredVector) -> StructuredVector:
        _require_columns(v)
        c, theta = self.diagonal, self.turn
        if self.dense:
            return self.dense.applied(v, KEPT, self.dense.inverse(c, theta))
        if not v.canonical:
            return v.map(lambda x, d: x / d, c) if isinstance(c, StructuredVector) else v * (1 / c)
        x, y, along = v.entries
        scale = 1 / (c * c + theta * theta)
        return v.like([(c * x + theta * y) * scale, (c * y - theta * x) * scale, along * (1 / c)])

    def record_solve(self, v: StructuredVector) -> StructuredVector:
        """(diagonal + T + c s ^ t)^-1 v; by a kept inverse corrected once, by a residual that is first put to the test.

        A kept inverse is good to 1e-9, relative, or made anew (`kreisel.kernels.large.products.NEAR`).
        """
        y = self._solved(v)
        if not self.dense:
            return y
        r = v - self @ y
        k = self.dense.inverse(self.diagonal, self.turn)
        self.dense.checks.setdefault(k, (algebra.dot(r, r), algebra.dot(v, v)))
        return y + self._solved(r)

    def _solved(self, v: StructuredVector) -> StructuredVector:
        """By Woodbury's formula for the last pair: y = R (v - c s <t, y> + c t <s, y>), R the inverse without it."""
        if not self.pairs:
            return self._unturned(v)
        key, *_ = reversed(self.pairs)
        less = replace(self, pairs={k: pair for k, pair in self.pairs.items() if k != key})
        k, s, t = self._own_pairs()[-1]
        dot, Rv, Rs, Rt = algebra.dot, less._solved(v), less._solved(s), less._solved(t)
        a, b, c, d = 1 + k * dot(t, Rs), -(k * dot(t, Rt)), k * dot(s, Rs), 1 - k * dot(s, Rt)
        scale, tv, sv = 1 / (a * d - b * c), k * dot(t, Rv), k * dot(s, Rv)
        along_s, along_t = (d * tv - b * sv) * scale, (a * sv - c * tv) * scale
        return Rv - Rs * along_s + Rt * along_t
