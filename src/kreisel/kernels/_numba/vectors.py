"""Blocks of rows, LANES at once, as intrinsics of compiled kernels: one array in numbers first, the other in rows."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from kreisel.kernels.layout import LANES

INDEX, NUMBER = ir.IntType(64), ir.DoubleType()
LINE = 8  # numbers in a line of the cache
VECTOR = ir.VectorType(NUMBER, LANES)


@intrinsic(prefer_literal=True)
def polynomials(
    typing_context: Any, table: Any, where: Any, x: Any, w: Any, i: Any, terms: Any, count: Any, width: Any
) -> Any:
    """w[d * width + i + r] = sum over k < terms of table[where[i + r], k, d] x[i + r]^k for d < count and r < LANES.

    By Horner's rule with fused products.  `table` has whole multiples of LANES numbers in a row; `terms`, `count` and
    `width` are literals.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = [_array_argument(context, builder, signature, arguments, k).data for k in range(4)]
        _horner(builder, data, arguments[4], terms.literal_value, count.literal_value, width.literal_value)
        return context.get_dummy_value()

    return types.void(table, where, x, w, i, terms, count, width), generate


@intrinsic(prefer_literal=True)
def store_rows(
    typing_context: Any, out: Any, row: Any, lane: Any, w: Any, i: Any, begin: Any, count: Any, width: Any
) -> Any:
    """out[row + r, lane, d] = w[begin + d * width + i + r] for d < count and r < LANES; `begin`, ... are literals."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target, source = (_array_argument(context, builder, signature, arguments, k) for k in (0, 3))
        starts = _row_starts(builder, target, arguments[1], arguments[2], count.literal_value)
        first = builder.add(arguments[4], INDEX(begin.literal_value))
        _store(builder, target.data, starts, source.data, first, count.literal_value, width.literal_value)
        return context.get_dummy_value()

    return types.void(out, row, lane, w, i, begin, count, width), generate


@intrinsic(prefer_literal=True)
def expect_rows(typing_context: Any, out: Any, row: Any, lane: Any, count: Any) -> Any:
    """Fetch out[row : row + LANES, lane] into the cache, to be written; `count`, of its numbers, is a literal."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target, size = _array_argument(context, builder, signature, arguments, 0), count.literal_value
        flag, pointer = ir.IntType(32), target.data.type
        kind = ir.FunctionType(ir.VoidType(), [pointer, flag, flag, flag])
        fetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        for start in _row_starts(builder, target, arguments[1], arguments[2], size):
            for place in range(0, size + LINE - 1, LINE):
                at = _vector_pointer(builder, target.data, start, min(place, size - 1))
                builder.call(fetch, [at, flag(1), flag(3), flag(1)])
        return context.get_dummy_value()

    return types.void(out, row, lane, count), generate


def _row_starts(builder: Any, out: Any, row: Any, lane: Any, count: int) -> list[Any]:
    lanes = builder.extract_value(out.shape, 1)
    rows = (builder.mul(builder.add(row, INDEX(r)), lanes) for r in range(LANES))
    return [builder.mul(builder.add(first, lane), INDEX(count)) for first in rows]


def _array_argument(context: Any, builder: Any, signature: Any, arguments: Any, k: int) -> Any:
    return make_array(signature.args[k])(context, builder, arguments[k])


def _vector_pointer(builder: Any, data: Any, offset: Any, more: int) -> Any:
    return builder.gep(data, [builder.add(offset, INDEX(more))])


def _vector(builder: Any, place: Any) -> Any:
    return builder.load(builder.bitcast(place, VECTOR.as_pointer()), align=8)


def _shuffled(builder: Any, a: Any, b: Any, *places: int) -> Any:
    return builder.shuffle_vector(a, b, ir.VectorType(ir.IntType(32), len(places))(list(places)))


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
    kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
    fma = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{LANES}f64")
    starts, arguments = [], []
    for row in range(LANES):
        part = builder.load(_vector_pointer(builder, where, first, row))
        starts.append(builder.mul(part, INDEX(terms * groups * LANES)))
        at = builder.load(_vector_pointer(builder, x, first, row))
        alone = builder.insert_element(VECTOR(ir.Undefined), at, ir.IntType(32)(0))
        arguments.append(_shuffled(builder, alone, alone, *[0] * LANES))

    def numbers(row: int, k: int, group: int) -> Any:
        return _vector(builder, _vector_pointer(builder, table, starts[row], (k * groups + group) * LANES))

    sums = [[numbers(row, terms - 1, group) for row in range(LANES)] for group in range(groups)]
    for k in reversed(range(terms - 1)):
        sums = [
            [builder.call(fma, [s, arguments[row], numbers(row, k, group)]) for row, s in enumerate(four)]
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
