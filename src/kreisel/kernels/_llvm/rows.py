"""Blocks of rows, LANES at once, in compiled code: one array in numbers first, the other in rows.

polynomials(table, where, x, w, i, terms, count, width)
    w[d * width + i + r] = sum over k < terms of table[where[i + r], k, d] x[i + r]^k for d < count and r < LANES, by
    Horner's rule with fused products; `table` has whole multiples of LANES numbers in a row
store_rows(out, row, lane, w, i, begin, count, width)
    out[row + r, lane, d] = w[begin + d * width + i + r] for d < count and r < LANES
expect_rows(out, row, lane, count)
    fetch out[row : row + LANES, lane], of `count` numbers, into the cache, to be written

`terms`, `begin`, `count` and `width` are written out in the text.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from kreisel.kernels._llvm.memory import Array
from kreisel.kernels._llvm.numbers import DOUBLE, INDEX, INTEGER, llvm_intrinsic
from kreisel.kernels.layout import LANES

LINE = 8  # numbers in a line of the cache
VECTOR = ir.VectorType(DOUBLE, LANES)


def polynomials(
    builder: Any, table: Array, where: Array, x: Array, w: Array, i: Any, terms: int, count: int, width: int
) -> None:
    _horner(builder, [array.data for array in (table, where, x, w)], i, terms, count, width)


def store_rows(
    builder: Any, out: Array, row: Any, lane: Any, w: Array, i: Any, begin: int, count: int, width: int
) -> None:
    starts = _row_starts(builder, out, row, lane, count)
    _store(builder, out.data, starts, w.data, builder.add(i, INTEGER(begin)), count, width)


def expect_rows(builder: Any, out: Array, row: Any, lane: Any, count: int) -> None:
    kind, name = ir.FunctionType(ir.VoidType(), [out.data.type, INDEX, INDEX, INDEX]), "llvm.prefetch.p0"
    fetch = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
    for start in _row_starts(builder, out, row, lane, count):
        for place in range(0, count + LINE - 1, LINE):
            at = _vector_pointer(builder, out.data, start, min(place, count - 1))
            builder.call(fetch, [at, INDEX(1), INDEX(3), INDEX(1)])


def _row_starts(builder: Any, out: Array, row: Any, lane: Any, count: int) -> list[Any]:
    lanes = out.shape[1]
    rows = (builder.mul(builder.add(row, INTEGER(r)), lanes) for r in range(LANES))
    return [builder.mul(builder.add(first, lane), INTEGER(count)) for first in rows]


def _vector_pointer(builder: Any, data: Any, offset: Any, more: int) -> Any:
    return builder.gep(data, [builder.add(offset, INTEGER(more))])


def _vector(builder: Any, place: Any) -> Any:
    return builder.load(builder.bitcast(place, VECTOR.as_pointer()), align=8)


def _shuffled(builder: Any, a: Any, b: Any, *places: int) -> Any:
    return builder.shuffle_vector(a, b, ir.VectorType(INDEX, len(places))(list(places)))


def _transposed(builder: Any, four: list[Any]) -> list[Any]:
    """Four vectors of four: the others of the same matrix."""
    pairs = [
        [_shuffled(builder, v, w, 0, 4, 2, 6), _shuffled(builder, v, w, 1, 5, 3, 7)] for v, w in (four[:2], four[2:])
    ]
    halves = (0, 1, 4, 5), (2, 3, 6, 7)
    return [_shuffled(builder, v, w, *half) for half in halves for v, w in zip(*pairs, strict=True)]


def _horner(builder: Any, data: list[Any], first: Any, terms: int, count: int, width: int) -> None:
    table, where, x, w = data
    groups = -(-count // LANES)
    fma = llvm_intrinsic("fma")
    starts, arguments = [], []
    for row in range(LANES):
        part = builder.load(_vector_pointer(builder, where, first, row))
        starts.append(builder.mul(part, INTEGER(terms * groups * LANES)))
        at = builder.load(_vector_pointer(builder, x, first, row))
        alone = builder.insert_element(VECTOR(ir.Undefined), at, INDEX(0))
        arguments.append(_shuffled(builder, alone, alone, *[0] * LANES))

    def numbers(row: int, k: int, group: int) -> Any:
        return _vector(builder, _vector_pointer(builder, table, starts[row], (k * groups + group) * LANES))

    sums = [[numbers(row, terms - 1, group) for row in range(LANES)] for group in range(groups)]
    for k in reversed(range(terms - 1)):
        sums = [
            [fma(builder, s, arguments[row], numbers(row, k, group)) for row, s in enumerate(four)]
            for group, four in enumerate(sums)
        ]
    for group, four in enumerate(sums):
        for d, column in enumerate(_transposed(builder, four)[: count - group * LANES]):
            target = _vector_pointer(builder, w, first, (group * LANES + d) * width)
            builder.store(column, builder.bitcast(target, VECTOR.as_pointer()), align=8)


def _store(builder: Any, out: Any, starts: list[Any], w: Any, first: Any, count: int, width: int) -> None:
    for group in range(0, count, LANES):
        many = min(LANES, count - group)
        columns = [_vector(builder, _vector_pointer(builder, w, first, (group + d) * width)) for d in range(many)]
        columns += [VECTOR(ir.Undefined)] * (LANES - many)
        for start, numbers in zip(starts, _transposed(builder, columns), strict=True):
            kept = _shuffled(builder, numbers, numbers, *range(many))
            builder.store(
                kept, builder.bitcast(_vector_pointer(builder, out, start, group), kept.type.as_pointer()), align=8
            )
