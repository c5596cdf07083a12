"""Python text as LLVM's operations: the functions of a record, the loops around them, and what is written by hand.

Values are numbers and vectors of them, double-doubles, whole numbers, arrays, and tuples of values.  Text is that of
`kreisel.kernels.printing`, or written in the same words: sums, products and quotients, comparisons, what
`kreisel.kernels._llvm.operations` lists, other such functions, numbers of arrays; `for` over ranges, `while`, `if`.
Functions are written into what calls them.  Any other text raises `TypeError`.  Indices are not negative, slices of
arrays are whole axes, and a loop's variable ends with it.
"""

from __future__ import annotations

import ast
import builtins
import contextlib
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import reduce
from typing import Any

from llvmlite import ir

from kreisel.kernels._llvm.double_double import OPERATIONS, DoubleDouble
from kreisel.kernels._llvm.functions import Straight, definition_of
from kreisel.kernels._llvm.memory import Array, part, place, whole
from kreisel.kernels._llvm.numbers import DOUBLE, INTEGER, as_kind, is_whole
from kreisel.kernels._llvm.operations import CALLABLE, OPERATORS, Operation, pair, upper
from kreisel.kernels._llvm.places import Places, awaited, memory_for, named

Value = Any  # of LLVM or of Python, a double-double, an array, a tuple of values, or a function
COMPARED: dict[type, tuple[str, Callable[[Any, Any], bool]]] = {
    ast.Lt: ("<", operator.lt),
    ast.LtE: ("<=", operator.le),
    ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge),
    ast.Eq: ("==", operator.eq),
    ast.NotEq: ("!=", operator.ne),
}


def written(builder: ir.IRBuilder, function: Any, given: Sequence[Value]) -> Value:
    """What a function returns for these; its operations stand at the end of what `builder` builds."""
    return _Lines(builder, function).run(given)


class _Lines:
    def __init__(self, builder: ir.IRBuilder, function: Any):
        self._builder, self._globals, self._definition = builder, function.__globals__, definition_of(function)
        self._known: dict[str, Value] = {}
        self._exit: Any = None  # the block after the function, if a `return` leads there
        self._both = False  # inside `_both_sides`
        self._loops: list[tuple[Places, Any]] = []  # of the loops that we are in: names, and the block after

    def run(self, given: Sequence[Value]) -> Value:
        names = [argument.arg for argument in self._definition.args.args]
        self._known = dict(zip(names, given, strict=True))
        lines, result = self._definition.body, None
        if isinstance(lines[-1], ast.Return):
            *lines, last = lines
            result = last.value  # type: ignore[attr-defined]
        self._run(lines, set() if result is None else named([result], ast.Load))
        value = None if result is None else self._value(result)
        if self._exit is not None:
            _require(value is None, self._definition)
            self._go(self._exit)
            self._builder.position_at_end(self._exit)
        return value

    # -- lines -------------------------------------------------------------------------------------

    def _run(self, lines: Sequence[ast.stmt], after: set[str]) -> None:
        """These lines; `after`: names that are read behind them."""
        for i, line in enumerate(lines):
            if isinstance(line, ast.Assign) and len(line.targets) == 1:
                self._assign(line.targets[0], self._value(line.value))
            elif isinstance(line, ast.AugAssign):
                before = self._value(line.target)
                self._assign(line.target, self._result(line.op, line, before, self._value(line.value)))
            elif isinstance(line, ast.For | ast.While | ast.If):
                self._branching(line, after | awaited(lines[i + 1 :]))
            else:
                self._short(line)

    def _branching(self, line: ast.For | ast.While | ast.If, after: set[str]) -> None:
        if isinstance(line, ast.For):
            self._for(line, after)
        elif isinstance(line, ast.While):
            self._while(line, after)
        else:
            self._if(line, after)

    def _short(self, line: Any) -> None:
        if isinstance(line, ast.Expr):
            if not isinstance(line.value, ast.Constant):  # what the function says of itself
                self._value(line.value)
        elif isinstance(line, ast.Break):
            places, done = self._loops[-1]
            places.write()
            self._builder.branch(done)
        elif isinstance(line, ast.Return) and line.value is None:
            self._exit = self._exit or self._builder.append_basic_block("exit")
            self._builder.branch(self._exit)
        else:
            _require(isinstance(line, ast.Pass), line)

    def _assign(self, target: Any, value: Value) -> None:
        if isinstance(target, ast.Name):
            self._known[target.id] = value
        elif isinstance(target, ast.Tuple):
            _require(_is_tuple(value) and len(value) == len(target.elts), target)
            for name, own in zip(target.elts, value, strict=True):
                self._assign(name, own)
        else:
            _require(isinstance(target, ast.Subscript), target)
            array = self._value(target.value)
            _require(isinstance(array, Array), target)
            pointer = place(self._builder, array, self._indices(target.slice))
            self._builder.store(as_kind(self._builder, value, array.data.type.pointee), pointer)

    def _places(self, lines: Iterable[ast.stmt], after: set[str]) -> Places:
        """Of the names that lines change and that are read after them."""
        return Places(self._builder, self._known, sorted(named(lines, ast.Store) & after))

    def _go(self, block: Any) -> None:
        if not self._builder.block.is_terminated:
            self._builder.branch(block)

    def _if(self, line: ast.If, after: set[str]) -> None:
        test = self._truth(line.test)
        if isinstance(test, bool):
            self._run(line.body if test else line.orelse, after)
            return
        places = self._places([*line.body, *line.orelse], after)
        before = dict(self._known)
        blocks = [self._builder.append_basic_block(name) for name in ("yes", "no", "then")]
        self._builder.cbranch(test, *blocks[:2])
        for block, lines in zip(blocks, (line.body, line.orelse), strict=False):
            self._known.clear()
            self._known.update(before)
            self._builder.position_at_end(block)
            self._run(lines, after)
            places.leave(blocks[2])
        self._builder.position_at_end(blocks[2])
        places.read()

    def _while(self, line: ast.While, after: set[str]) -> None:
        _require(not line.orelse, line)
        self._repeated(line, after | awaited([line.test]), lambda: self._truth(line.test), lambda: None)

    def _for(self, line: ast.For, after: set[str]) -> None:
        asked: Any = line.iter
        of_range = isinstance(asked, ast.Call) and isinstance(asked.func, ast.Name) and asked.func.id == "range"
        _require(of_range and isinstance(line.target, ast.Name) and not line.orelse, line)
        bounds = [self._value(one) for one in asked.args]
        first, last, step = {1: [0, *bounds, 1], 2: [*bounds, 1], 3: bounds}[len(bounds)]
        builder, name = self._builder, line.target.id  # type: ignore[attr-defined]
        _require(isinstance(step, int) and all(map(is_whole, (first, last))) and name not in after, line)
        count = memory_for(builder, INTEGER)
        builder.store(whole(first), count)

        def test() -> Any:
            self._known[name] = builder.load(count)
            return builder.icmp_signed("<" if step > 0 else ">", self._known[name], whole(last))

        def onwards() -> None:
            builder.store(builder.add(builder.load(count), INTEGER(step)), count)

        self._repeated(line, after, test, onwards)
        self._known.pop(name, None)

    def _repeated(self, line: Any, after: set[str], test: Callable[[], Any], onwards: Callable[[], None]) -> None:
        builder, early = self._builder, awaited(line.body)
        unknown = early & named(line.body, ast.Store) - self._known.keys()
        if unknown:
            raise TypeError(f"expected {', '.join(sorted(unknown))} to be known before the loop whose lines read them")
        after = after | early
        places = self._places(line.body, after)
        again, body, done = (builder.append_basic_block(name) for name in ("again", "body", "done"))
        builder.branch(again)
        builder.position_at_end(again)
        places.read()
        builder.cbranch(test(), body, done)
        builder.position_at_end(body)
        self._loops.append((places, done))
        self._run(line.body, after)
        self._loops.pop()
        if not builder.block.is_terminated:
            onwards()
        places.leave(again)
        builder.position_at_end(done)
        places.read()

    # -- values ------------------------------------------------------------------------------------

    def _value(self, node: Any) -> Value:
        if isinstance(node, ast.Constant):
            return int(node.value) if isinstance(node.value, bool) else node.value
        if isinstance(node, ast.Name):
            return self._named_value(node.id)
        if isinstance(node, ast.Tuple):
            return tuple(one for each in node.elts for one in self._parts(each))
        if isinstance(node, ast.BinOp):
            left, right = self._value(node.left), self._value(node.right)
            if isinstance(node.op, ast.Add) and type(left) is tuple and type(right) is tuple:
                return left + right
            return self._result(node.op, node, left, right)
        if isinstance(node, ast.Subscript):
            return self._entry(node)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self._call(node, [one for each in node.args for one in self._parts(each)])
        if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATORS:
            return self._result(node.op, node, self._value(node.operand))
        if isinstance(node, ast.IfExp):
            return self._either(node)
        if isinstance(node, ast.Attribute) and node.attr == "shape":
            return self._value(node.value).shape
        return self._truth(node)

    def _parts(self, node: Any) -> list[Value]:
        """A value, or those of a tuple with a star."""
        if not isinstance(node, ast.Starred):
            return [self._value(node)]
        values = self._value(node.value)
        _require(_is_tuple(values), node)
        return [*values]

    def _named_value(self, name: str) -> Value:
        if name in self._known:
            return self._known[name]
        return self._globals.get(name, getattr(builtins, name, None))

    def _entry(self, node: ast.Subscript) -> Value:
        value = self._value(node.value)
        if not isinstance(value, Array):
            _require(_is_tuple(value), node)
            if isinstance(node.slice, ast.Slice):
                _require(node.slice.step is None, node)
                return value[
                    slice(*(bound and ast.literal_eval(bound) for bound in (node.slice.lower, node.slice.upper)))
                ]
            return value[ast.literal_eval(node.slice)]
        at = self._indices(node.slice)
        _require(not self._both, node)
        if None in at or len(at) < len(value.shape):
            return part(self._builder, value, at)
        return self._builder.load(place(self._builder, value, at))

    def _indices(self, node: Any) -> list[Any]:
        """Indices, and None for a whole axis."""
        each = node.elts if isinstance(node, ast.Tuple) else [node]
        at = [self._value(one) if not isinstance(one, ast.Slice) else None for one in each]
        whole_axes = [one for one in each if isinstance(one, ast.Slice)]
        _require(all(one.lower is one.upper is one.step is None for one in whole_axes), node)
        _require(all(one is None or is_whole(one) for one in at), node)
        _require(not any(isinstance(one, int) and one < 0 for one in at), node)
        return at

    def _either(self, node: ast.IfExp) -> Value:
        test = self._truth(node.test)
        with self._both_sides():
            values = self._alike(self._value(node.body), self._value(node.orelse))
        if isinstance(test, bool):
            return values[0 if test else 1]
        _require(not isinstance(values[0], DoubleDouble), node)
        if not isinstance(values[0], ir.Value):
            kind = INTEGER if all(isinstance(value, int) for value in values) else DOUBLE
            values = [ir.Constant(kind, value) for value in values]
        return self._builder.select(test, *values)

    @contextlib.contextmanager
    def _both_sides(self) -> Iterator[None]:
        """Inside stands what is computed although it may not be wanted: it may read no array and divide no wholes."""
        before, self._both = self._both, True
        yield
        self._both = before

    def _truth(self, node: Any) -> Any:
        """Whether it is so: a bool, or a bit of LLVM."""
        builder = self._builder
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in COMPARED:
            return self._compared(node)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            test = self._truth(node.operand)
            return not test if isinstance(test, bool) else builder.not_(test)
        if isinstance(node, ast.BoolOp):
            tests = [self._truth(node.values[0])]
            with self._both_sides():
                tests += [self._truth(one) for one in node.values[1:]]
            every = isinstance(node.op, ast.And)
            if any(test is (not every) for test in tests):  # which decides
                return not every
            unknown = [test for test in tests if not isinstance(test, bool)]
            return reduce(builder.and_ if every else builder.or_, unknown) if unknown else every
        _require(isinstance(node, ast.Name | ast.Subscript | ast.BinOp | ast.Constant), node)
        value = self._value(node)
        if isinstance(value, int):
            return bool(value)
        _require(is_whole(value) or _is_bit(value), node)
        return value if _is_bit(value) else builder.icmp_signed("!=", value, INTEGER(0))

    def _compared(self, node: ast.Compare) -> Any:
        sign, of_python = COMPARED[type(node.ops[0])]
        sides = self._alike(self._value(node.left), self._value(node.comparators[0]))
        if not isinstance(sides[0], ir.Value):
            _require(all(isinstance(side, int | float) for side in sides), node)
            return of_python(*sides)
        if is_whole(sides[0]):
            return self._builder.icmp_signed(sign, *sides)
        compare = self._builder.fcmp_unordered if sign == "!=" else self._builder.fcmp_ordered
        return compare(sign, *sides)

    def _call(self, node: ast.Call, values: list[Value]) -> Value:
        name = node.func.id  # type: ignore[attr-defined]
        function = self._named_value(name)
        if isinstance(function, Straight):
            return written(self._builder, function.py_func, values)
        if function is pair:
            return DoubleDouble(*self._alike(*values))
        if function is upper:
            return values[0].upper
        if function is len:
            return values[0].shape[0] if isinstance(values[0], Array) else len(values[0])
        if function is float:
            return as_kind(self._builder, values[0], DOUBLE)
        if function is int:
            return self._builder.fptosi(values[0], INTEGER)
        known = isinstance(function, Operation) or (callable(function) and function in CALLABLE)
        _require(known, node)
        operation = function if isinstance(function, Operation) else CALLABLE[function]
        if operation.of_numbers or operation.emit is None:
            return self._operated(operation, node, values)
        return operation.emit(self._builder, *values)

    def _result(self, sign: Any, node: Any, *values: Value) -> Value:
        _require(type(sign) in OPERATORS, node)
        return self._operated(OPERATORS[type(sign)], node, values)

    def _operated(self, operation: Operation, node: Any, given: Sequence[Value]) -> Value:
        if operation.of_python and all(isinstance(value, int | float) for value in given):
            return operation.of_python(*given)
        values = self._alike(*given)
        _require(all(isinstance(value, ir.Value | DoubleDouble) for value in values), node)
        if isinstance(values[0], DoubleDouble):
            _require(operation.of_python in OPERATIONS, node)
            return DoubleDouble(*OPERATIONS[operation.of_python](self._builder, *values))  # type: ignore[index]
        if is_whole(values[0]):
            _require(operation.of_wholes is not None, node)
            _require(not (self._both and operation.name in ("//", "%")), node)
            return operation.of_wholes(self._builder, *values)  # type: ignore[misc]
        _require(operation.emit is not None, node)
        return operation.emit(self._builder, *values)  # type: ignore[misc]

    def _alike(self, *values: Value) -> list[Value]:
        """All as vectors if one of them is one, all as double-doubles if one of them is one."""
        double = any(isinstance(value, DoubleDouble) for value in values)
        numbers = [value.upper if isinstance(value, DoubleDouble) else value for value in values]
        kinds = [number.type for number in numbers if isinstance(number, ir.Value)]
        if not kinds and not double:
            return list(values)
        wide = next((kind for kind in kinds if isinstance(kind, ir.VectorType)), None)
        if wide is None:
            real = double or DOUBLE in kinds or any(isinstance(number, float) for number in numbers)
            wide = DOUBLE if real else INTEGER
        out = [as_kind(self._builder, number, wide) for number in numbers]
        if not double:
            return out
        lower = [value.lower if isinstance(value, DoubleDouble) else 0.0 for value in values]
        return [DoubleDouble(x, as_kind(self._builder, y, wide)) for x, y in zip(out, lower, strict=True)]


def _is_tuple(value: Value) -> bool:
    """Of values, which is neither a double-double nor an array."""
    return type(value) is tuple


def _is_bit(value: Value) -> bool:
    return isinstance(value, ir.Value) and value.type == ir.IntType(1)


def _require(known: bool, node: Any) -> None:
    if not known:
        raise TypeError(f"expected text that `kreisel.kernels._llvm.text` knows, got {ast.unparse(node)!r}")
