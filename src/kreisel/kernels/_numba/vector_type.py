"""A vector of doubles as a type of compiled code: straight-line text for a number runs on several lanes at once.

Each operation is that of a number in each place, rounded alike, so a lane of a vector has the bits of a number.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

DOUBLES = {"avx512f": 8, "avx": 4}  # in a register, of processors with these features; 2 on others
INDEX, INTEGER = ir.IntType(32), ir.IntType(64)

Emit = Callable[..., Any]


def register_width() -> int:
    """How many doubles a vector register of the processor holds that Numba compiles for."""
    features = cpu_target.target_context.codegen().magic_tuple()[2].split(",")
    return next((width for feature, width in DOUBLES.items() if f"+{feature}" in features), 2)


class VectorType(types.Type):
    """`width` doubles."""

    def __init__(self, width: int):
        self.width = width
        super().__init__(name=f"Vector({width})")

    @property
    def llvm(self) -> ir.VectorType:
        return ir.VectorType(ir.DoubleType(), self.width)


@register_model(VectorType)
class VectorModel(models.PrimitiveModel):
    """A value of LLVM, kept in registers."""

    def __init__(self, manager: Any, kind: VectorType):
        super().__init__(manager, kind, kind.llvm)


def broadcast(context: Any, builder: ir.IRBuilder, number: Any, kind: VectorType, value: Any) -> Any:
    """The same number in all places."""
    if isinstance(value, ir.Constant):
        return everywhere(kind.llvm, value.constant)
    return spread(builder, value, kind.llvm)


def spread(builder: ir.IRBuilder, value: Any, kind: ir.VectorType) -> Any:
    """The same, as LLVM's operations."""
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, INDEX(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(INDEX, kind.count), [0] * kind.count))


def everywhere(kind: ir.Type, number: float) -> ir.Constant:
    """A constant of a number's or a vector's type."""
    return ir.Constant(kind, [number] * kind.count if isinstance(kind, ir.VectorType) else number)


lower_cast(types.Float, VectorType)(broadcast)


def common(kinds: Sequence[Any]) -> Any:
    """The vector type among those of numbers and of one vector type; None without a vector or of others."""
    vectors = {kind for kind in kinds if isinstance(kind, VectorType)}
    known = len(vectors) == 1 and all(isinstance(kind, VectorType | types.Float) for kind in kinds)
    return vectors.pop() if known else None


def _vector_operation(function: Callable[..., Any], count: int, emit: Emit) -> None:
    """Let compiled code take vectors for `function`, which has `count` arguments."""

    class Template(AbstractTemplate):
        def generic(self, kinds: Sequence[Any], keywords: Any) -> Any:
            kind = common(kinds) if len(kinds) == count else None
            return None if kind is None else signature(kind, *[kind] * count)

    infer_global(function)(Template)
    lower_builtin(function, *[VectorType] * count)(lambda context, builder, kinds, values: emit(builder, *values))


def llvm_intrinsic(name: str) -> Emit:
    """A call of LLVM's own function of that name, for numbers and for vectors."""

    def emit(builder: ir.IRBuilder, *values: Any) -> Any:
        kind = values[0].type
        mark = f"v{kind.count}f64" if isinstance(kind, ir.VectorType) else "f64"
        form = ir.FunctionType(kind, [kind] * len(values))
        return builder.call(cgutils.get_or_insert_function(builder.module, form, f"llvm.{name}.{mark}"), values)

    return emit


def larger(builder: ir.IRBuilder, x: Any, y: Any) -> Any:
    """Python's max: x unless y > x."""
    return builder.select(builder.fcmp_ordered(">", y, x), y, x)


for _function, _count, _emit in (
    (operator.add, 2, ir.IRBuilder.fadd),
    (operator.sub, 2, ir.IRBuilder.fsub),
    (operator.mul, 2, ir.IRBuilder.fmul),
    (operator.truediv, 2, ir.IRBuilder.fdiv),
    (operator.neg, 1, ir.IRBuilder.fneg),
    (math.sqrt, 1, llvm_intrinsic("sqrt")),
    (math.sin, 1, llvm_intrinsic("sin")),
    (math.cos, 1, llvm_intrinsic("cos")),
    (math.exp, 1, llvm_intrinsic("exp")),
    (math.log, 1, llvm_intrinsic("log")),
    (max, 2, larger),
):
    _vector_operation(_function, _count, _emit)


def _places(builder: ir.IRBuilder, width: int, first: Any, end: Any) -> list[Any]:
    """The indices first, first + 1, ..., those from `end` on as the one before it."""
    last = builder.sub(end, end.type(1))
    each = [builder.add(first, first.type(i)) for i in range(width)]
    return [builder.select(builder.icmp_signed("<", at, last), at, last) for at in each]


def _element(context: Any, builder: ir.IRBuilder, kind: Any, array: Any, indices: Sequence[Any]) -> Any:
    made = context.make_array(kind)(context, builder, array)
    return cgutils.get_item_pointer(context, builder, kind, made, indices)


def _row_pointer(context: Any, builder: ir.IRBuilder, kind: Any, array: Any, row: Any, of: Any) -> Any:
    """A pointer to a row of a scratch array, as a vector or a number."""
    start = _element(context, builder, kind, array, [row, row.type(0)])
    return builder.bitcast(start, of.llvm.as_pointer()) if isinstance(of, VectorType) else start


def _places_of(kind: Any) -> Any:
    """The type of indices, each a whole number."""
    return types.UniTuple(types.intp, len(kind))


def _numbers(width: int) -> Any:
    """The type of so many numbers: of one, a double."""
    return VectorType(width) if width > 1 else types.float64


def _along(context: Any, builder: ir.IRBuilder, kind: Any, array: Any, count: int, lead: Any, tail: Any) -> list[Any]:
    """Pointers to array[lead, 0, tail], array[lead, 1, tail], ...; the numbers of a row lie side by side."""
    first = _element(context, builder, kind, array, [*lead, INTEGER(0), *tail])
    made = context.make_array(kind)(context, builder, array)
    apart = [builder.extract_value(made.shape, kind.ndim - len(tail) + i) for i in range(len(tail))]
    places = [reduce(builder.mul, apart, INTEGER(j)) for j in range(count)]
    return [builder.gep(first, [place]) for place in places]


@intrinsic(prefer_literal=True)
def numbers(typing_context: Any, array: Any, lead: Any, count: Any, tail: Any) -> Any:
    """The numbers 0, 1, ... of array[lead, :, tail], as many as `count`, which is written out."""
    out, leads, tails = types.UniTuple(types.float64, count.literal_value), _places_of(lead), _places_of(tail)

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        at = [cgutils.unpack_tuple(builder, values[i], len(form.args[i])) for i in (1, 3)]
        places = _along(context, builder, form.args[0], values[0], out.count, *at)
        return context.make_tuple(builder, out, [builder.load(place) for place in places])

    return signature(out, array, leads, count, tails), emit


@intrinsic
def put_numbers(typing_context: Any, array: Any, lead: Any, given: Any, tail: Any) -> Any:
    """Put numbers into array[lead, :, tail]."""

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        at = [cgutils.unpack_tuple(builder, values[i], len(form.args[i])) for i in (1, 3)]
        places = _along(context, builder, form.args[0], values[0], len(given), *at)
        for number, place in zip(cgutils.unpack_tuple(builder, values[2], len(given)), places, strict=True):
            builder.store(number, place)
        return context.get_dummy_value()

    leads, tails = _places_of(lead), _places_of(tail)
    return signature(types.void, array, leads, types.UniTuple(types.float64, len(given)), tails), emit


@intrinsic(prefer_literal=True)
def gather(typing_context: Any, array: Any, columns: Any, first: Any, end: Any, width: Any) -> Any:
    """The columns 0, 1, ... of the rows first, first + 1, ... of `array`: `columns` vectors of `width` numbers.

    In place of rows from `end` on stands the one before it.  `columns` and `width` are written out; vectors of one are
    numbers.
    """
    kind = _numbers(width.literal_value)
    out = types.UniTuple(kind, columns.literal_value)

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        def row(at: Any) -> list[Any]:
            places = _along(context, builder, form.args[0], values[0], out.count, [at], ())
            return [builder.load(place) for place in places]

        if not isinstance(kind, VectorType):
            return context.make_tuple(builder, out, row(values[2]))
        builder.function.attributes.add("nounwind")  # llvmlite prints the other one only beside it
        builder.function.attributes.alignstack = 8 * kind.width  # or what is spilled lies across cache lines
        vectors = [ir.Constant(kind.llvm, ir.Undefined)] * out.count
        for i, at in enumerate(_places(builder, kind.width, *values[2:4])):
            vectors = [builder.insert_element(v, x, INDEX(i)) for v, x in zip(vectors, row(at), strict=True)]
        return context.make_tuple(builder, out, vectors)

    return signature(out, array, columns, types.intp, types.intp, width), emit


@intrinsic
def scatter(typing_context: Any, array: Any, lead: Any, first: Any, end: Any, vectors: Any) -> Any:
    """Put vectors into the columns 0, 1, ... of the rows that `gather` takes, of array[lead].

    In places beyond `end` stand the numbers of the row before it, if they come from there.
    """

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        before = cgutils.unpack_tuple(builder, values[1], len(form.args[1]))
        columns = cgutils.unpack_tuple(builder, values[4], len(vectors))

        def put(at: Any, given: list[Any]) -> None:
            places = _along(context, builder, form.args[0], values[0], len(given), [*before, at], ())
            for number, place in zip(given, places, strict=True):
                builder.store(number, place)

        if not isinstance(vectors.dtype, VectorType):
            put(values[2], columns)
            return context.get_dummy_value()
        for i, at in enumerate(_places(builder, vectors.dtype.width, *values[2:4])):
            put(at, [builder.extract_element(column, INDEX(i)) for column in columns])
        return context.get_dummy_value()

    lead = _places_of(lead)
    return signature(types.void, array, lead, types.intp, types.intp, vectors), emit


@intrinsic(prefer_literal=True)
def load(typing_context: Any, array: Any, row: Any, rows: Any, width: Any) -> Any:
    """`rows` rows of `array` from `row` on, as vectors of `width` numbers; both are written out."""
    kind = _numbers(width.literal_value)
    out = types.UniTuple(kind, rows.literal_value)

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        each = [builder.add(values[1], values[1].type(j)) for j in range(out.count)]
        places = [_row_pointer(context, builder, form.args[0], values[0], at, kind) for at in each]
        return context.make_tuple(builder, out, [builder.load(place, align=8) for place in places])

    return signature(out, array, types.intp, rows, width), emit


@intrinsic
def store(typing_context: Any, array: Any, row: Any, vectors: Any) -> Any:
    """Put vectors into rows of `array`, from `row` on."""

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        for j, vector in enumerate(cgutils.unpack_tuple(builder, values[2], len(vectors))):
            at = builder.add(values[1], values[1].type(j))
            builder.store(vector, _row_pointer(context, builder, form.args[0], values[0], at, vectors.dtype), align=8)
        return context.get_dummy_value()

    return signature(types.void, array, types.intp, vectors), emit


@intrinsic(prefer_literal=True)
def vector_at(typing_context: Any, address: Any, row: Any, width: Any) -> Any:
    """Vector `row` of those at an address; `width` is written out."""
    kind = VectorType(width.literal_value)

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        place = builder.gep(builder.inttoptr(values[0], kind.llvm.as_pointer()), [values[1]])
        return builder.load(place, align=8)

    return signature(kind, types.int64, types.int64, width), emit


@intrinsic
def put_vector(typing_context: Any, address: Any, row: Any, vector: Any) -> Any:
    """Vector `row` at an address becomes `vector`."""

    def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
        place = builder.gep(builder.inttoptr(values[0], vector.llvm.as_pointer()), [values[1]])
        builder.store(values[2], place, align=8)
        return context.get_dummy_value()

    return signature(types.void, types.int64, types.int64, vector), emit
