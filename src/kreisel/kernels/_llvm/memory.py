"""Rows of arrays, and numbers at addresses, in compiled code: what Python text has these names for.

gather(array, count, first, end, width)  columns 0, 1, ... of the rows first, first + 1, ...: `count` vectors of `width`
                                         numbers; in place of rows from `end` on stands the one before it
scatter(array, lead, first, end, columns, width)  the same into array[lead]
numbers(array, lead, count, tail)        the numbers 0, 1, ... of array[lead, :, tail]
put_numbers(array, lead, given, tail)    and into it
load(array, row, rows, width)            rows of an array, as vectors; store(array, row, vectors, width) puts them there
double_at(address, i), whole_at, long_at the number i of doubles, of whole numbers of 32 and of 64 bits at an address
put_double(address, i, x), put_whole     into doubles, into whole numbers of 32 bits
vector_at(address, i, width)             the same for vectors, and put_vector(address, i, x)
call_at_address(address, arguments)      call a function that takes whole numbers and returns nothing

`count`, `rows` and `width` are written out in the text; vectors of one are numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any, NamedTuple

from llvmlite import ir

from kreisel.kernels._llvm.numbers import DOUBLE, INDEX, INTEGER, everywhere


class Array(NamedTuple):
    """A pointer to the first number, how many there are along each axis, and how far apart they lie."""

    data: Any
    shape: tuple[Any, ...]
    strides: tuple[Any, ...]


def contiguous(builder: ir.IRBuilder, data: Any, shape: Sequence[Any]) -> Array:
    """An array whose last numbers lie side by side."""
    strides: list[Any] = [1]
    for length in reversed(shape[1:]):
        strides.insert(0, times(builder, strides[0], length))
    return Array(data, tuple(shape), tuple(strides))


def times(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """Of whole numbers of Python and of LLVM."""
    if isinstance(x, int) and isinstance(y, int):
        return x * y
    if 1 in (x, y):
        return y if x == 1 else x
    return builder.mul(whole(x), whole(y))


def plus(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """The same for sums."""
    if isinstance(x, int) and isinstance(y, int):
        return x + y
    if 0 in (x, y):
        return y if x == 0 else x
    return builder.add(whole(x), whole(y))


def whole(x: Any) -> Any:
    """A whole number of LLVM."""
    return INTEGER(x) if isinstance(x, int) else x


def place(builder: ir.IRBuilder, array: Array, at: Sequence[Any]) -> Any:
    """A pointer to array[at]."""
    apart = [times(builder, i, stride) for i, stride in zip(at, array.strides, strict=True)]
    total: Any = reduce(lambda x, y: plus(builder, x, y), apart, 0)
    return builder.gep(array.data, [whole(total)])


def part(builder: ir.IRBuilder, array: Array, at: Sequence[Any]) -> Array:
    """array[at], where None stands for a whole axis."""
    at = [*at, *[None] * (len(array.shape) - len(at))]
    kept = [k for k, i in enumerate(at) if i is None]
    data = place(builder, array, [0 if i is None else i for i in at])
    return Array(data, tuple(array.shape[k] for k in kept), tuple(array.strides[k] for k in kept))


def _along(builder: ir.IRBuilder, array: Array, count: int, lead: Sequence[Any], tail: Sequence[Any]) -> list[Any]:
    """Pointers to array[lead, 0, tail], array[lead, 1, tail], ..."""
    first, apart = place(builder, array, [*lead, 0, *tail]), array.strides[len(lead)]
    return [builder.gep(first, [whole(times(builder, j, apart))]) for j in range(count)]


def _kind(width: int) -> ir.Type:
    return ir.VectorType(DOUBLE, width) if width > 1 else DOUBLE


def _of(kind: ir.Type, number: Any) -> Any:
    return everywhere(kind, float(number)) if isinstance(number, int | float) else number


def _lanes(builder: ir.IRBuilder, width: int, first: Any, end: Any) -> list[Any]:
    """The indices first, first + 1, ..., those from `end` on as the one before it."""
    if width == 1:
        return [first]
    last = builder.sub(whole(end), INTEGER(1))
    each = [builder.add(whole(first), INTEGER(i)) for i in range(width)]
    return [builder.select(builder.icmp_signed("<", at, last), at, last) for at in each]


def gather(builder: ir.IRBuilder, array: Array, count: int, first: Any, end: Any, width: int) -> tuple[Any, ...]:
    rows = [
        [builder.load(pointer) for pointer in _along(builder, array, count, [at], ())]
        for at in _lanes(builder, width, first, end)
    ]
    if width == 1:
        return tuple(rows[0])
    builder.function.attributes.add("nounwind")  # llvmlite prints the other one only beside it
    builder.function.attributes.alignstack = 8 * width  # or what is spilled lies across cache lines
    vectors = [ir.Constant(_kind(width), ir.Undefined)] * count
    for i, row in enumerate(rows):
        vectors = [builder.insert_element(v, x, INDEX(i)) for v, x in zip(vectors, row, strict=True)]
    return tuple(vectors)


def scatter(
    builder: ir.IRBuilder, array: Array, lead: Sequence[Any], first: Any, end: Any, columns: Any, width: int
) -> None:
    vectors = [_of(_kind(width), column) for column in columns]
    for i, at in enumerate(_lanes(builder, width, first, end)):
        given = [builder.extract_element(column, INDEX(i)) for column in vectors] if width > 1 else vectors
        put_numbers(builder, array, [*lead, at], given, ())


def numbers(builder: ir.IRBuilder, array: Array, lead: Sequence[Any], count: int, tail: Sequence[Any]) -> Any:
    return tuple(builder.load(pointer) for pointer in _along(builder, array, count, lead, tail))


def put_numbers(builder: ir.IRBuilder, array: Array, lead: Sequence[Any], given: Any, tail: Sequence[Any]) -> None:
    for number, pointer in zip(given, _along(builder, array, len(given), lead, tail), strict=True):
        builder.store(_of(DOUBLE, number), pointer)


def _row(builder: ir.IRBuilder, array: Array, row: Any, kind: ir.Type) -> Any:
    return builder.bitcast(place(builder, array, [row, 0]), kind.as_pointer())


def load(builder: ir.IRBuilder, array: Array, row: Any, rows: int, width: int) -> tuple[Any, ...]:
    each = [plus(builder, row, j) for j in range(rows)]
    return tuple(builder.load(_row(builder, array, at, _kind(width)), align=8) for at in each)


def store(builder: ir.IRBuilder, array: Array, row: Any, vectors: Any, width: int) -> None:
    for j, vector in enumerate(vectors):
        pointer = _row(builder, array, plus(builder, row, j), _kind(width))
        builder.store(_of(_kind(width), vector), pointer, align=8)


def _at(builder: ir.IRBuilder, kind: ir.Type, address: Any, i: Any) -> Any:
    return builder.gep(builder.inttoptr(address, kind.as_pointer()), [whole(i)])


def double_at(builder: ir.IRBuilder, address: Any, i: Any) -> Any:
    return builder.load(_at(builder, DOUBLE, address, i))


def whole_at(builder: ir.IRBuilder, address: Any, i: Any) -> Any:
    return builder.sext(builder.load(_at(builder, INDEX, address, i)), INTEGER)


def long_at(builder: ir.IRBuilder, address: Any, i: Any) -> Any:
    return builder.load(_at(builder, INTEGER, address, i))


def put_double(builder: ir.IRBuilder, address: Any, i: Any, x: Any) -> None:
    builder.store(x, _at(builder, DOUBLE, address, i))


def put_whole(builder: ir.IRBuilder, address: Any, i: Any, x: Any) -> None:
    builder.store(builder.trunc(whole(x), INDEX), _at(builder, INDEX, address, i))


def vector_at(builder: ir.IRBuilder, address: Any, i: Any, width: int) -> Any:
    return builder.load(_at(builder, _kind(width), address, i), align=8)


def put_vector(builder: ir.IRBuilder, address: Any, i: Any, x: Any) -> None:
    builder.store(x, _at(builder, x.type, address, i), align=8)


def call_at_address(builder: ir.IRBuilder, address: Any, arguments: Sequence[Any]) -> None:
    kind = ir.FunctionType(ir.VoidType(), [INTEGER] * len(arguments))
    builder.call(builder.inttoptr(address, kind.as_pointer()), [whole(given) for given in arguments])
