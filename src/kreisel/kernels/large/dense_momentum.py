"""A recorded momentum of n^2 numbers, and the inverses that a step solves by, which follow its changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.kernels.large.scalars import Number, key_of
from kreisel.kernels.tape import Scalar, Tape

if TYPE_CHECKING:
    from kreisel.kernels.large.structured import StructuredVector


@dataclass(eq=False)
class Dense:
    """The momentum M of a step, recorded, with the inverses of diagonal + turn M that it solves by.

    inverses  (diagonal, turn) of each kept inverse
    checks    of each, by the first solve: |r|^2 and |v|^2, r the residual
    """

    tape: Tape
    name: str
    inverses: list[tuple[Any, Number]] = field(default_factory=list)
    checks: dict[int, tuple[Scalar, Scalar]] = field(default_factory=dict)

    def times(self, v: StructuredVector) -> StructuredVector:
        """M v."""
        return self._applied("product", v)

    def solved(self, k: int, v: StructuredVector) -> StructuredVector:
        """Inverse k times v."""
        return self._applied(f"kept{k}", v)

    def solved_transposed(self, k: int, v: StructuredVector) -> StructuredVector:
        """Inverse k, transposed, times v."""
        return self._applied(f"turned{k}", v)

    def _applied(self, what: str, v: StructuredVector) -> StructuredVector:
        (x,) = v.blocks
        if not isinstance(x, Scalar):
            raise TypeError("products of the dense momentum with complex vectors are not recorded")
        name = self.tape.record(f"{what}({x.name})", (x.name, self.name))
        return replace(v, blocks=(Scalar(self.tape, name, x.negative),))

    def inverse(self, diagonal: Any, turn: Number) -> int:
        """The number of the kept inverse of diagonal + turn M."""
        keys = [(key_of(d), key_of(t)) for d, t in self.inverses]
        wanted = key_of(diagonal), key_of(turn)
        if wanted not in keys:
            self.inverses.append((diagonal, turn))
            return len(keys)
        return keys.index(wanted)


def changed_inverse(
    dense: Dense, k: int, pairs: Sequence[tuple[Number, StructuredVector, StructuredVector]]
) -> list[tuple[StructuredVector, StructuredVector]]:
    """Vectors x, r: the inverse k of M + sum c s ^ t is W - sum x r^T, W that of M, by Woodbury's formula."""
    turn = dense.inverses[k][1]
    changes = [change for c, s, t in pairs for change in ((turn * c, s, t), (-(turn * c), t, s))]  # a x y^T
    left = [dense.solved(k, x) for _, x, _ in changes]
    right = [dense.solved_transposed(k, y) for _, _, y in changes]
    G = np.array([[a * algebra.dot(y, Wx) for Wx in left] for a, _, y in changes], dtype=object)
    weights = algebra.solve(G + algebra.identity(len(G)), np.diag([a for a, _, _ in changes]))
    return [(x, _combined(right, row)) for x, row in zip(left, weights, strict=True)]


def _combined(vectors: Sequence[StructuredVector], weights: Sequence[Number]) -> StructuredVector:
    first, *others = (v * w for v, w in zip(vectors, weights, strict=True))
    for v in others:
        first = first + v
    return first
