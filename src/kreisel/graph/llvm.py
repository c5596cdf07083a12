"""Graphs, loops and memory as LLVM's operations, for a number or a vector of lanes.

A `Function` is written by Python code that runs once: `loop` and `where` are its blocks, `Integer` and `Memory` its
values at run time.  Operations on vectors act on each place like operations on scalars, rounded alike, so a lane of a
vector has the bits of a number.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any

from llvmlite import ir

from kreisel.errors import InputError
from kreisel.graph import graph as ops
from kreisel.graph.graph import Graph, Number, Operand

DOUBLE, INTEGER, INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
ARITHMETIC = {ops.PLUS: "fadd", ops.MINUS: "fsub", ops.TIMES: "fmul", ops.OVER: "fdiv"}
INTRINSIC = {
    ops.FMA: "fma",
    ops.SQRT: "sqrt",
    ops.SIZE: "fabs",
    ops.NEAREST: "rint",
    **{name: name for name in ops.TRANSCENDENTAL},
}
Value = Any  # of LLVM
TABLES_OF_CPU = "kr.Table: expected engine='cpu', got a GPU, which does not reach tables in the memory of the computer."


def kind_of(width: int) -> ir.Type:
    """The type of `width` doubles: a vector, of one a number."""
    return ir.VectorType(DOUBLE, width) if width > 1 else DOUBLE


def constant(kind: ir.Type, number: float) -> Value:
    """A number, in every place of a vector."""
    return ir.Constant(kind, [number] * kind.count if isinstance(kind, ir.VectorType) else number)


def _operator(operation: str, unit: int | None = None) -> Callable[[Integer, Any], Integer]:
    """LLVM's operation on two integers; a second one that is `unit` changes nothing."""

    def applied(self: Integer, operand: Any) -> Integer:
        if isinstance(operand, int) and operand == unit:
            return self
        return Integer(self.builder, getattr(self.builder, operation)(self.value, integer_value(operand)))

    return applied


class Integer:
    """An integer of 64 bits at run time, with Python's operators; + - * and comparisons accept Python's integers
    too.
    """

    __slots__ = ("builder", "value")

    def __init__(self, builder: ir.IRBuilder, value: Value):
        self.builder, self.value = builder, value

    __add__ = __radd__ = _operator("add", unit=0)
    __sub__ = _operator("sub")
    __mul__ = __rmul__ = _operator("mul", unit=1)
    __floordiv__, __mod__ = _operator("udiv"), _operator("urem")  # of values that are not negative
    __lshift__, __rshift__ = _operator("shl"), _operator("lshr")  # with zeros from the left

    def __rsub__(self, other: int) -> Integer:
        return Integer(self.builder, INTEGER(other)) - self

    def compared(self, sign: str, operand: Any) -> Value:
        """A bit: whether self < other, or another sign."""
        return self.builder.icmp_signed(sign, self.value, integer_value(operand))

    def below(self, operand: Any) -> Integer:
        """1 where self < other, as integers without a sign, else 0."""
        test = self.builder.icmp_unsigned("<", self.value, integer_value(operand))
        return Integer(self.builder, self.builder.zext(test, INTEGER))

    def least(self, operand: Any) -> Integer:
        """The smaller of two."""
        test = self.compared("<", operand)
        return Integer(self.builder, self.builder.select(test, self.value, integer_value(operand)))

    def double(self) -> Value:
        """The double next to it, a signed integer."""
        return self.builder.sitofp(self.value, DOUBLE)


def integer_value(x: Any) -> Value:
    """An integer of Python or at run time as LLVM's."""
    return x.value if isinstance(x, Integer) else INTEGER(int(x))


class Memory:
    """Numbers of one type at an address."""

    __slots__ = ("builder", "kind", "pointer")

    def __init__(self, builder: ir.IRBuilder, pointer: Value, kind: ir.Type = DOUBLE):
        self.builder, self.pointer, self.kind = builder, pointer, kind

    @property
    def _align(self) -> int:
        return 4 if isinstance(self.kind, ir.FloatType) else 8

    def _at(self, i: Any) -> Value:
        if isinstance(i, int) and i == 0:
            return self.pointer
        return self.builder.gep(self.pointer, [integer_value(i)])

    def __getitem__(self, i: Any) -> Any:
        value = self.builder.load(self._at(i), align=self._align)
        return Integer(self.builder, value) if self.kind == INTEGER else value

    def __setitem__(self, i: Any, x: Any) -> None:
        self.builder.store(self.value_of(x), self._at(i), align=self._align)

    def value_of(self, x: Any) -> Value:
        """A number of this type."""
        if self.kind == INTEGER:
            return integer_value(x)
        return constant(self.kind, float(x)) if isinstance(x, int | float) else x

    def beyond(self, i: Any) -> Memory:
        """The values from i on."""
        return Memory(self.builder, self._at(i), self.kind)

    def of(self, kind: ir.Type) -> Memory:
        """Numbers of another type at this address."""
        return Memory(self.builder, self.builder.bitcast(self.pointer, kind.as_pointer()), kind)

    def get(self, count: int, first: Any = 0) -> list[Any]:
        """Numbers first, first + 1, ..."""
        return [self[first + i] for i in range(count)]

    def put(self, values: Sequence[Any], first: Any = 0) -> None:
        """And back."""
        for i, value in enumerate(values):
            self[first + i] = value


class Variables(list[Memory]):
    """Room for values of a function, each separate."""

    def get(self) -> list[Value]:
        """The values."""
        return [memory[0] for memory in self]

    def put(self, values: Iterable[Any]) -> None:
        """Store as many values."""
        for memory, value in zip(self, values, strict=True):
            memory[0] = value


class Lanes:
    """Columns of an array (lanes, stride) of doubles: of one lane as scalars, of several as vectors."""

    def __init__(self, numbers: Memory, lanes: Sequence[Any], stride: Any):
        self._rows = [numbers.beyond(lane * stride) for lane in lanes]
        self.kind = kind_of(len(self._rows))

    def __getitem__(self, column: Any) -> Value:
        loaded = [row[column] for row in self._rows]
        if len(loaded) == 1:
            return loaded[0]
        vector = ir.Constant(self.kind, ir.Undefined)
        for i, x in enumerate(loaded):
            vector = self._rows[0].builder.insert_element(vector, x, INDEX(i))
        return vector

    def __setitem__(self, column: Any, value: Any) -> None:
        value = constant(self.kind, float(value)) if isinstance(value, int | float) else value
        for i, row in enumerate(self._rows):
            row[column] = row.builder.extract_element(value, INDEX(i)) if len(self._rows) > 1 else value

    def get(self, columns: Collection[int]) -> list[Value]:
        """Several columns."""
        return [self[column] for column in columns]

    def put(self, values: Sequence[Any], first: int = 0) -> None:
        """Columns first, first + 1, ..."""
        for i, value in enumerate(values):
            self[first + i] = value


class Operation:
    """An operation as LLVM's text, as an operand of others: llvmlite's instructions need three times as long."""

    __slots__ = ("_reference", "_text", "type")

    def __init__(self, reference: str, text: str, kind: ir.Type):
        self._reference, self._text, self.type = reference, f"{reference} = {text}", kind

    def get_reference(self) -> str:
        """Its name, as llvmlite asks for it."""
        return self._reference

    def __str__(self) -> str:
        return self._text


class Function:
    """A function of integers of 64 bits, addresses among them, that returns nothing: under construction."""

    on_host = True  # whether it runs where the memory of this process is

    def __init__(self, arguments: int, name: str = "kernel", triple: str = ""):
        self.module = ir.Module()
        self.module.triple = triple
        self.function = ir.Function(self.module, ir.FunctionType(ir.VoidType(), [INTEGER] * arguments), name)
        self.builder = ir.IRBuilder(self.function.append_basic_block("entry"))
        self.arguments = [Integer(self.builder, x) for x in self.function.args]
        self._nothing: Value = None  # the address of a zero
        self._count = 0  # of the operations with a text

    def text(self) -> str:
        """LLVM's text of the module."""
        if not self.builder.block.is_terminated:
            self.builder.ret_void()
        return str(self.module)

    def integer(self, x: Any) -> Integer:
        """An integer at run time."""
        return x if isinstance(x, Integer) else Integer(self.builder, INTEGER(x))

    # -- memory ------------------------------------------------------------------------------------

    def doubles(self, address: Integer) -> Memory:
        """The doubles at an address."""
        return Memory(self.builder, self.builder.inttoptr(address.value, DOUBLE.as_pointer()))

    def integers(self, address: Integer) -> Memory:
        """The integers of 64 bits at an address."""
        return Memory(self.builder, self.builder.inttoptr(address.value, INTEGER.as_pointer()), INTEGER)

    def variables(self, count: int, kind: ir.Type = DOUBLE) -> Variables:
        """Room for values, each separate, in registers if that is possible; made once in a call."""
        with self.builder.goto_entry_block():
            return Variables(Memory(self.builder, self.builder.alloca(kind), kind) for _ in range(count))

    def variable(self, start: Any, kind: ir.Type = INTEGER) -> Memory:
        """A variable and its first value."""
        (memory,) = self.variables(1, kind)
        memory[0] = start
        return memory

    def room(self, count: int, kind: ir.Type = DOUBLE) -> Memory:
        """Memory for `count` values, made once in a call."""
        with self.builder.goto_entry_block():
            return Memory(self.builder, self.builder.alloca(kind, INTEGER(count)), kind)

    def vectors(self, width: int) -> None:
        """To be called by functions that work on vectors: else those that are spilled lie across cache lines."""
        if width > 1:
            self.function.attributes.add("nounwind")  # llvmlite prints the other one only together with it
            self.function.attributes.alignstack = 8 * width

    def lanes(self, first: Any, width: int, end: Any) -> list[Any]:
        """The lanes first, first + 1, ...; in place of those from `end` on is the one before it."""
        if width == 1:
            return [first]
        last = self.integer(end) - 1
        return [self.integer(first + i).least(last) for i in range(width)]

    # -- control -----------------------------------------------------------------------------------

    @contextlib.contextmanager
    def loop(self, first: Any, last: Any, step: int = 1) -> Iterator[Integer]:
        """A block for first, first + step, ... before `last`; step < 0 counts down."""
        builder = self.builder
        count = self.variable(first)
        test, body, done = (builder.append_basic_block(name) for name in ("test", "body", "done"))
        builder.branch(test)
        builder.position_at_end(test)
        now = count[0]
        builder.cbranch(now.compared("<" if step > 0 else ">", last), body, done)
        builder.position_at_end(body)
        yield now
        if not builder.block.is_terminated:
            count[0] = now + step
            builder.branch(test)
        builder.position_at_end(done)

    @contextlib.contextmanager
    def while_(self, test: Callable[[], Value]) -> Iterator[None]:
        """A block that is repeated as long as the bit that `test` writes is set."""
        builder = self.builder
        again, body, done = (builder.append_basic_block(name) for name in ("again", "body", "done"))
        builder.branch(again)
        builder.position_at_end(again)
        builder.cbranch(test(), body, done)
        builder.position_at_end(body)
        yield
        if not builder.block.is_terminated:
            builder.branch(again)
        builder.position_at_end(done)

    @contextlib.contextmanager
    def where(self, test: Value) -> Iterator[None]:
        """A block that is run where a bit is set."""
        with self.builder.if_then(test):
            yield

    def largest(self, x: Value) -> Value:
        """The largest of the places of a vector that are scalars; NaN if none is."""
        if not isinstance(x.type, ir.VectorType):
            return x
        places = [self.builder.extract_element(x, INDEX(k)) for k in range(x.type.count)]

        def larger(a: Value, b: Value) -> Value:
            keep = self.builder.or_(self.builder.fcmp_ordered(">=", a, b), self.builder.fcmp_unordered("uno", b, b))
            return self.builder.select(keep, a, b)

        return reduce(larger, places)

    def spread(self, x: Value, kind: ir.Type) -> Value:
        """A number in all places of a vector."""
        if not isinstance(kind, ir.VectorType):
            return x
        first = self.builder.insert_element(ir.Constant(kind, ir.Undefined), x, INDEX(0))
        places = ir.Constant(ir.VectorType(INDEX, kind.count), [0] * kind.count)
        return self.builder.shuffle_vector(first, first, places)

    def otherwise(self, test: Value) -> Any:
        """Two blocks, of which one is run: with f.otherwise(test) as (yes, no): with yes: ...; with no: ..."""
        return self.builder.if_else(test)

    def call(self, address: Integer, *arguments: Any) -> None:
        """Call a function of integers at an address."""
        kind = ir.FunctionType(ir.VoidType(), [INTEGER] * len(arguments))
        pointer = self.builder.inttoptr(address.value, kind.as_pointer())
        self.builder.call(pointer, [integer_value(x) for x in arguments])

    # -- graphs ------------------------------------------------------------------------------------

    def intrinsic(self, name: str, *values: Value) -> Value:
        """A call of LLVM's own function of that name, for scalars and for vectors."""
        kind = values[0].type
        wide = isinstance(kind, ir.VectorType)
        full = f"llvm.{name}." + (f"v{kind.count}f64" if wide else "f32" if isinstance(kind, ir.FloatType) else "f64")
        if full not in self.module.globals:
            ir.Function(self.module, ir.FunctionType(kind, [kind] * len(values)), full)
        arguments = ", ".join([f"{kind} {x.get_reference()}" for x in values])
        return self._written(f'call {kind} @"{full}"({arguments})', kind)

    def _written(self, text: str, kind: ir.Type) -> Value:
        self._count += 1
        value = Operation(f"%of{self._count}", text, kind)
        self.builder._insert(value)
        return value

    def _arithmetic(self, operation: str, *x: Value) -> Value:
        kind = x[0].type
        return self._written(f"{operation} {kind} {', '.join([operand.get_reference() for operand in x])}", kind)

    def emit(self, graph: Graph, nodes: Sequence[int], values: dict[int, Value], kind: ir.Type) -> None:
        """Compute nodes, in this order, into `values`, which has the inputs among them."""
        for at in nodes:
            operation, *operands = graph.nodes[at]
            if at in values or operation == ops.IN:
                continue
            if operation == ops.LOOP:
                self._loop(graph, at, operands, values, kind)
            elif operation == ops.BRANCH:
                self._branch(graph, at, operands, values, kind)
            elif operation == ops.RESULT:
                values[at] = values[operands[0].at][operands[1]]
            elif operation == ops.ENTRY:
                *numbers, column, stride = operands
                values[at] = self._entry([self.value(x, values, kind) for x in numbers], column, stride)
            else:
                values[at] = self._operation(operation, [self.value(x, values, kind) for x in operands])

    def value(self, x: Operand, values: Mapping[int, Value], kind: ir.Type) -> Value:
        """An operand, or an output, of a graph."""
        if not isinstance(x, Number):
            return constant(kind, float(x))
        value = values[x.at]
        return self._arithmetic("fneg", value) if x.negative else value

    def outputs(
        self, graph: Graph, outputs: Sequence[Operand], inputs: Callable[[str, int], Value], kind: ir.Type = DOUBLE
    ) -> list[Value]:
        """The outputs of a graph, whose inputs are loaded as they are first needed."""
        values = dict[int, Value]()
        self.compute(graph, graph.needed(outputs), values, inputs, kind)
        return [self.value(x, values, kind) for x in outputs]

    def compute(
        self,
        graph: Graph,
        nodes: Sequence[int],
        values: dict[int, Value],
        inputs: Callable[[str, int], Value],
        kind: ir.Type,
    ) -> None:
        """Nodes, in this order, into `values`, after the inputs among them."""
        loaded = [at for at in nodes if graph.nodes[at][0] == ops.IN and at not in values]
        values.update({at: inputs(*graph.nodes[at][1:]) for at in loaded})
        self.emit(graph, nodes, values, kind)

    def _entry(self, numbers: list[Value], column: int, stride: int) -> Value:
        kind, builder = numbers[0].type, self.builder
        if not self.on_host:
            raise InputError(TABLES_OF_CPU)
        if self._nothing is None:
            with builder.goto_entry_block():
                room = builder.alloca(DOUBLE)
                builder.store(DOUBLE(0.0), room)
                self._nothing = builder.ptrtoint(room, INTEGER)
        empty = self._nothing

        def single(address: Value, row: Value, last: Value) -> Value:
            row = builder.select(builder.fcmp_ordered(">", row, DOUBLE(0.0)), row, DOUBLE(0.0))  # of NaN 0
            row = builder.select(builder.fcmp_ordered("<", row, last), row, last)
            place = builder.fptoui(row, INTEGER)
            place = builder.add(builder.mul(place, INTEGER(stride)), INTEGER(column))
            base = builder.fptoui(address, INTEGER)
            location = builder.add(base, builder.mul(place, INTEGER(8)))
            location = builder.select(builder.icmp_signed("==", base, INTEGER(0)), empty, location)
            return builder.load(builder.inttoptr(location, DOUBLE.as_pointer()), align=8)

        if not isinstance(kind, ir.VectorType):
            return single(*numbers)
        out = ir.Constant(kind, ir.Undefined)
        for i in range(kind.count):
            entries = [builder.extract_element(x, INDEX(i)) for x in numbers]
            out = builder.insert_element(out, single(*entries), INDEX(i))
        return out

    def _operation(self, operation: str, x: list[Value]) -> Value:
        builder = self.builder
        if operation in ARITHMETIC:
            return self._arithmetic(ARITHMETIC[operation], *x)
        if operation == ops.MAX:
            return builder.select(builder.fcmp_ordered("<", *x), x[1], x[0])
        if operation == ops.WHERE:
            return builder.select(builder.fcmp_ordered("<", *x[:2]), *x[2:])
        if operation == ops.SIGN:
            zero, minus, plus = (constant(x[0].type, number) for number in (0.0, -1.0, 1.0))
            return builder.select(builder.fcmp_ordered("<", x[0], zero), minus, plus)
        return self.intrinsic(INTRINSIC[operation], *x)

    def _branch(self, graph: Graph, at: int, operands: list[Any], values: dict[int, Value], kind: ir.Type) -> None:
        branch = graph.branches[operands[0]]
        memory = self.variables(len(branch.new), kind)
        memory.put(self.value(x, values, kind) for x in operands[2 : 2 + len(memory)])
        somewhere = self.largest(self.value(operands[1], values, kind))
        with self.where(self.builder.fcmp_ordered(">", somewhere, DOUBLE(0.0))):
            inside = dict(values)
            self.emit(graph, graph.needed_inside(branch), inside, kind)
            memory.put(self.value(x, inside, kind) for x in branch.new)
        values[at] = memory.get()

    def _any(self, bits: Value) -> Value:
        """Whether a bit of a vector is set."""
        count = bits.type.count
        return self.builder.icmp_unsigned("!=", self.builder.bitcast(bits, ir.IntType(count)), ir.IntType(count)(0))

    def _loop(self, graph: Graph, at: int, operands: list[Any], values: dict[int, Value], kind: ir.Type) -> None:
        """Lanes of a vector end at different times: one that has ended keeps its values."""
        loop = graph.loops[operands[0]]
        memory = self.variables(len(loop.variables) + 1, kind)
        memory.put(self.value(x, values, kind) for x in [*operands[1 : len(memory)], math.inf])
        ended, count = self.variable(0), self.variable(0)

        def test() -> Value:
            return self.builder.and_(ended[0].compared("==", 0), count[0].compared("<", loop.most))

        with self.while_(test):
            inside = values | {x.at: room[0] for x, room in zip(loop.variables, memory, strict=False)}
            self.emit(graph, graph.needed_inside(loop), inside, kind)
            new = [self.value(x, inside, kind) for x in loop.new]
            if loop.small != ops.NEVER:
                if isinstance(kind, ir.VectorType):  # `memory` has the last defect, at first infinite
                    active = self.builder.fcmp_unordered(">", memory[-1][0], constant(kind, loop.small))
                    new = [self.builder.select(active, x, room[0]) for x, room in zip(new, memory, strict=True)]
                left = self.builder.fcmp_unordered(">", new[-1], constant(kind, loop.small))
                somewhere = self._any(left) if isinstance(kind, ir.VectorType) else left
                ended[0] = Integer(self.builder, self.builder.zext(self.builder.not_(somewhere), INTEGER))
            memory.put(new)
            count[0] = count[0] + 1
        values[at] = memory.get()
