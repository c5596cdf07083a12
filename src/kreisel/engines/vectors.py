"""Polynomials of many rows at once, as an intrinsic of compiled kernels."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from kreisel.engines.layout import LANES


@intrinsic(prefer_literal=True)
def polynomials(
    typing_context: Any, table: Any, where: Any, x: Any, w: Any, i: Any, terms: Any, count: Any, width: Any
) -> Any:
    """w[d * width + r] = sum over k < terms of table[where[r], k, d] x[r]^k for d < count and r = i, ..., i + LANES - 1.

    By Horner's rule with fused products.  `table` has whole multiples of LANES numbers in a row; `terms`, `count` and
    `width` are literals.
    """
    given = (table, where, x, w, i, terms, count, width)
    if not all(isinstance(v, types.IntegerLiteral) for v in (terms, count, width)):
        return None
    shape = terms.literal_value, count.literal_value, width.literal_value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = [
            make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[:4], arguments[:4], strict=True)
        ]
        _horner(builder, data, arguments[4], *shape)
        return context.get_dummy_value()

    return types.void(*given), generate


def _horner(builder: Any, data: list[Any], first: Any, terms: int, count: int, width: int) -> None:
    table, where, x, w = data
    groups = -(-count // LANES)
    number, vector = ir.IntType(64), ir.VectorType(ir.DoubleType(), LANES)
    fma = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fma.v{LANES}f64"
    )

    def at(array: Any, offset: Any, more: int) -> Any:
        return builder.gep(array, [builder.add(offset, number(more))])

    def numbers(row: int, k: int, group: int) -> Any:
        place = at(table, starts[row], (k * groups + group) * LANES)
        return builder.load(builder.bitcast(place, vector.as_pointer()), align=8)

    def shuffled(a: Any, b: Any, *places: int) -> Any:
        return builder.shuffle_vector(a, b, ir.VectorType(ir.IntType(32), LANES)(list(places)))

    starts, arguments = [], []
    for row in range(LANES):
        part = builder.load(at(where, first, row))
        starts.append(builder.mul(part, number(terms * groups * LANES)))
        alone = builder.insert_element(vector(ir.Undefined), builder.load(at(x, first, row)), ir.IntType(32)(0))
        arguments.append(shuffled(alone, alone, 0, 0, 0, 0))
    sums = [[numbers(row, terms - 1, group) for row in range(LANES)] for group in range(groups)]
    for k in reversed(range(terms - 1)):
        sums = [
            [builder.call(fma, [s, arguments[row], numbers(row, k, group)]) for row, s in enumerate(four)]
            for group, four in enumerate(sums)
        ]
    for group, (a, b, c, d) in enumerate(sums):
        ab, cd = ((shuffled(v, w, 0, 4, 2, 6), shuffled(v, w, 1, 5, 3, 7)) for v, w in ((a, b), (c, d)))
        columns = [shuffled(v, w, *half) for half in ((0, 1, 4, 5), (2, 3, 6, 7)) for v, w in zip(ab, cd, strict=True)]
        for place, column in enumerate(columns[: count - group * LANES]):
            target = builder.bitcast(at(w, first, (group * LANES + place) * width), vector.as_pointer())
            builder.store(column, target, align=8)
