"""Straight-line text as LLVM's operations: Numba types a call, not its lines.

A function of numbers, vectors, double-doubles and tuples of them, whose text is that of a record
(`kreisel.kernels.printing`), or written by hand in the same words: names of sums, products, quotients, of the
functions below and of other such functions, loops of so many times, which a last line may leave
(`if x <= small: break`), and blocks `if x > y:` that change names from before.  Any other text raises `TypeError`.
"""

from __future__ import annotations

import ast
import inspect
import math
import operator
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from kreisel.kernels._numba.double_double import OPERATIONS, Pair, pair_parts, pair_value
from kreisel.kernels._numba.fused import largest_of, lesser_chosen, sign_of
from kreisel.kernels._numba.vector_type import INDEX, VectorType, everywhere, larger, llvm_intrinsic, spread

Number = Any  # of LLVM: a double or a vector of them
Value = Any  # a number of LLVM or of Python, a double-double, a tuple of values, or a function
# By their names in the text: of Python's numbers, and of LLVM's.  Double-doubles have `OPERATIONS` of the first.
FUNCTIONS: dict[str, tuple[Any, Callable[..., Number]]] = {
    "Add": (operator.add, ir.IRBuilder.fadd),
    "Sub": (operator.sub, ir.IRBuilder.fsub),
    "Mult": (operator.mul, ir.IRBuilder.fmul),
    "Div": (operator.truediv, ir.IRBuilder.fdiv),
    "USub": (operator.neg, ir.IRBuilder.fneg),
    "sqrt": (math.sqrt, llvm_intrinsic("sqrt")),
    **{name: (None, llvm_intrinsic(name)) for name in ("fma", "sin", "cos", "exp", "log")},
    "nearest": (None, llvm_intrinsic("rint")),
    "size": (None, llvm_intrinsic("fabs")),
    "sign": (None, sign_of),
    "max": (None, larger),
    "where_less": (None, lesser_chosen),
    "largest": (None, largest_of),
}
ORDERED = {"LtE": "<=", "Gt": ">"}


class DoubleDouble(NamedTuple):
    """Its two numbers, or vectors."""

    upper: Number
    lower: Number


def straight(function: Callable[..., Any]) -> Any:
    """The same function for compiled code; it is written into the code that calls it."""
    code: Any = function.__code__
    names = code.co_varnames[: code.co_argcount]

    def typed(typing_context: Any, *given: Any) -> Any:
        kinds, common = [_as_numbers(kind) for kind in given], _common(_elements(given))
        out = _kind_of(_written(_scratch(), function, [_undefined(kind) for kind in kinds], common))

        def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
            taken = [_taken(context, builder, kind, value) for kind, value in zip(form.args, values, strict=True)]
            return _given_back(context, builder, out, _written(builder, function, taken, common))

        return signature(out, *kinds), emit

    parameters = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in ("context", *names)]
    typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    made: Any = intrinsic(typed)
    made.py_func = function  # as Numba calls what it compiles
    return made


# -- what Numba knows of values --------------------------------------------------------------------


def _elements(kinds: Iterable[Any]) -> list[Any]:
    """The types of all numbers in these."""
    parts = [getattr(kind, "types", None) for kind in kinds]
    return [one for kind, own in zip(kinds, parts, strict=True) for one in ([kind] if own is None else _elements(own))]


def _common(kinds: list[Any]) -> Any:
    """The type of numbers that are written out in a result: of double-doubles or vectors, if an argument is."""
    elements = [kind.element if isinstance(kind, Pair) else kind for kind in kinds]
    number = next((kind for kind in elements if isinstance(kind, VectorType)), types.float64)
    return Pair(number) if any(isinstance(kind, Pair) for kind in kinds) else number


def _as_numbers(kind: Any) -> Any:
    """The type with doubles in place of whole numbers and of numbers that are written out."""
    if isinstance(kind, types.BaseTuple):
        return types.Tuple([_as_numbers(part) for part in getattr(kind, "types", ())])
    return kind if isinstance(kind, VectorType | Pair | types.Callable) else types.float64


def _undefined(kind: Any) -> Value:
    if isinstance(kind, types.BaseTuple):
        return tuple(map(_undefined, getattr(kind, "types", ())))
    if isinstance(kind, Pair):
        return DoubleDouble(_undefined(kind.element), _undefined(kind.element))
    if isinstance(kind, types.Callable):
        return getattr(kind, "typing_key", None)
    return ir.Constant(kind.llvm if isinstance(kind, VectorType) else ir.DoubleType(), ir.Undefined)


def _taken(context: Any, builder: ir.IRBuilder, kind: Any, value: Any) -> Value:
    if isinstance(kind, types.BaseTuple):
        parts = cgutils.unpack_tuple(builder, value, len(kind))
        return tuple(_taken(context, builder, *each) for each in zip(getattr(kind, "types", ()), parts, strict=True))
    if isinstance(kind, Pair):
        return DoubleDouble(*pair_parts(context, builder, kind, value))
    return getattr(kind, "typing_key", None) if isinstance(kind, types.Callable) else value


def _kind_of(value: Value) -> Any:
    if isinstance(value, DoubleDouble):
        return Pair(_kind_of(value.upper))
    if isinstance(value, tuple):
        return types.Tuple([_kind_of(part) for part in value])
    return VectorType(value.type.count) if isinstance(value.type, ir.VectorType) else types.float64


def _given_back(context: Any, builder: ir.IRBuilder, kind: Any, value: Value) -> Any:
    if isinstance(value, DoubleDouble):
        return pair_value(context, builder, kind, value)
    if isinstance(value, tuple):
        kinds = getattr(kind, "types", ())
        parts = [_given_back(context, builder, *each) for each in zip(kinds, value, strict=True)]
        return context.make_tuple(builder, kind, parts)
    return value


def _scratch() -> ir.IRBuilder:
    """A builder of a function that nobody calls, to see what kind of values come out."""
    scratch = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "scratch")
    return ir.IRBuilder(scratch.append_basic_block())


def _written(builder: ir.IRBuilder, function: Any, given: list[Value], common: Any) -> Value:
    """The result of a function, in LLVM's numbers."""
    element = common.element if isinstance(common, Pair) else common
    kind = element.llvm if isinstance(element, VectorType) else ir.DoubleType()

    def whole(value: Value) -> Value:
        if isinstance(value, tuple) and not isinstance(value, DoubleDouble):
            return tuple(map(whole, value))
        return _as(builder, value, kind, isinstance(common, Pair)) if isinstance(value, float) else value

    return whole(Lines(builder, function).run(given))


def _as(builder: ir.IRBuilder, value: Value, kind: ir.Type, double: bool) -> Value:
    """A number or a double-double, of numbers or vectors."""
    if isinstance(value, DoubleDouble):
        return DoubleDouble(*(_broadcast(builder, number, kind) for number in value))
    number = _broadcast(builder, value, kind)
    return DoubleDouble(number, everywhere(kind, 0.0)) if double else number


def _broadcast(builder: ir.IRBuilder, value: Any, kind: ir.Type) -> Number:
    if isinstance(value, float):
        return everywhere(kind, value)
    if value.type == kind:
        return value
    return spread(builder, value, kind)


# -- the text --------------------------------------------------------------------------------------


class Lines:
    """The operations of a function's lines, at the end of what `builder` builds."""

    def __init__(self, builder: ir.IRBuilder, function: Any):
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
        _require(isinstance(definition, ast.FunctionDef), definition)
        self._builder, self._globals, self._definition = builder, function.__globals__, definition
        self._known: dict[str, Value] = {}

    def run(self, given: Sequence[Value]) -> Value:
        """What the function returns for these."""
        definition: Any = self._definition
        self._known = dict(zip((argument.arg for argument in definition.args.args), given, strict=True))
        *lines, last = definition.body
        _require(isinstance(last, ast.Return), last)
        for i, line in enumerate(lines):
            if isinstance(line, ast.For):
                self._loop(line, _named([*lines[i + 1 :], last], ast.Load))
            elif isinstance(line, ast.If):
                self._block(line)
            else:
                self._line(line)
        return self._value(last.value)

    def _line(self, line: Any) -> None:
        if isinstance(line, ast.Expr):  # what the function says of itself
            _require(isinstance(line.value, ast.Constant), line)
        elif not isinstance(line, ast.Pass):
            _require(isinstance(line, ast.Assign) and len(line.targets) == 1, line)
            self._assign(line.targets[0], self._value(line.value))

    def _assign(self, target: Any, value: Value) -> None:
        if isinstance(target, ast.Name):
            self._known[target.id] = value
        else:
            _require(isinstance(target, ast.Tuple), target)
            for part, own in zip(target.elts, value, strict=True):
                self._assign(part, own)

    def _value(self, node: Any) -> Value:
        if isinstance(node, ast.Constant):
            return float(ast.literal_eval(node))
        if isinstance(node, ast.Name):
            return self._named_value(node.id)
        if isinstance(node, ast.Tuple):
            return tuple(part for each in node.elts for part in self._parts(each))
        if isinstance(node, ast.Subscript):
            return self._value(node.value)[ast.literal_eval(node.slice)]
        if isinstance(node, ast.BinOp) and type(node.op).__name__ in FUNCTIONS:
            return self._result(type(node.op).__name__, self._value(node.left), self._value(node.right))
        if isinstance(node, ast.UnaryOp) and type(node.op).__name__ in FUNCTIONS:
            return self._result(type(node.op).__name__, self._value(node.operand))
        _require(isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords, node)
        return self._call(node.func.id, [part for each in node.args for part in self._parts(each)])

    def _parts(self, node: Any) -> list[Value]:
        """A value, or those of a tuple with a star."""
        return [*self._value(node.value)] if isinstance(node, ast.Starred) else [self._value(node)]

    def _named_value(self, name: str) -> Value:
        value = self._known[name] if name in self._known else self._globals.get(name)
        if isinstance(value, int | float):
            return float(value)
        return tuple(map(float, value)) if isinstance(value, tuple) and name not in self._known else value

    def _call(self, name: str, values: list[Value]) -> Value:
        if name == "upper":
            return values[0].upper
        if name == "pair":
            return DoubleDouble(*self._alike(*values))
        if name in FUNCTIONS:
            return self._result(name, *values)
        function = getattr(self._named_value(name), "py_func", None)
        if function is None:
            raise TypeError(f"expected a function that `kreisel.kernels._numba.straight` knows, got {name}")
        return Lines(self._builder, function).run(values)

    def _result(self, name: str, *given: Value) -> Value:
        function, emit = FUNCTIONS[name]
        if function and all(isinstance(value, float) for value in given):
            return function(*given)
        values = self._alike(*given)
        if isinstance(values[0], DoubleDouble):
            return DoubleDouble(*OPERATIONS[function](self._builder, *values))
        return emit(self._builder, *values)

    def _alike(self, *values: Value) -> list[Value]:
        """All as vectors if one of them is one, all as double-doubles if one of them is one."""
        double = any(isinstance(value, DoubleDouble) for value in values)
        numbers = [value.upper if isinstance(value, DoubleDouble) else value for value in values]
        kinds = [number.type for number in numbers if not isinstance(number, float)]
        wide = next((kind for kind in kinds if isinstance(kind, ir.VectorType)), ir.DoubleType())
        return [_as(self._builder, value, wide, double) for value in values]

    def _loop(self, loop: Any, after: set[str]) -> None:
        builder, most = self._builder, self._times(loop)
        leaves = isinstance(loop.body[-1], ast.If)
        _require(not leaves or (isinstance(loop.body[-1].body[0], ast.Break) and not loop.body[-1].orelse), loop)
        lines = loop.body[:-1] if leaves else loop.body
        kept = self._places(_named(lines, ast.Store), after)
        count = cgutils.alloca_once_value(builder, INDEX(0))
        builder.store(INDEX(0), count)
        again, done = builder.append_basic_block("again"), builder.append_basic_block("done")
        builder.branch(again)
        builder.position_at_end(again)
        self._read(kept)
        for line in lines:
            self._line(line)
        self._write(kept)
        passed = builder.add(builder.load(count), INDEX(1))
        builder.store(passed, count)
        last = builder.icmp_signed(">=", passed, INDEX(most))
        leave = builder.or_(self._test(loop.body[-1].test), last) if leaves else last
        builder.cbranch(leave, done, again)
        builder.position_at_end(done)
        self._read(kept)

    def _times(self, loop: Any) -> int:
        """How often the body of a loop is done, at most; none of its lines takes the number."""
        asked: Any = loop.iter
        plain = isinstance(asked, ast.Call) and isinstance(asked.func, ast.Name) and asked.func.id == "range"
        _require(plain and len(asked.args) == 1 and not loop.orelse, loop)
        _require(loop.target.id not in _named(loop.body, ast.Load), loop)
        most = self._value(asked.args[0])
        _require(isinstance(most, float) and most >= 1, loop)
        return int(most)

    def _block(self, block: Any) -> None:
        _require(not block.orelse, block)
        kept = self._places(_named(block.body, ast.Store), set())
        with self._builder.if_then(self._test(block.test)):
            for line in block.body:
                self._line(line)
            self._write(kept)
        self._read(kept)

    def _test(self, test: Any) -> Any:
        known = isinstance(test, ast.Compare) and len(test.ops) == 1 and type(test.ops[0]).__name__ in ORDERED
        _require(known, test)
        sides = self._alike(self._value(test.left), self._value(test.comparators[0]))
        return self._builder.fcmp_ordered(ORDERED[type(test.ops[0]).__name__], *sides)

    def _places(self, names: set[str], after: set[str]) -> dict[str, Any]:
        """Memory for those names that are known, or are read after: with the numbers that they have now."""
        kept = {}
        for name in sorted(names & {*self._known, *after}):
            (value,) = self._alike(self._known.get(name, 0.0))
            kinds = [number.type for number in (value if isinstance(value, DoubleDouble) else [value])]
            kept[name] = [cgutils.alloca_once(self._builder, kind) for kind in kinds]
            self._known[name] = value
        self._write(kept)
        return kept

    def _write(self, kept: dict[str, Any]) -> None:
        for name, places in kept.items():
            (value,) = self._alike(self._known[name])
            for number, place in zip(value if isinstance(value, DoubleDouble) else [value], places, strict=True):
                self._builder.store(number, place)

    def _read(self, kept: dict[str, Any]) -> None:
        for name, places in kept.items():
            numbers = [self._builder.load(place) for place in places]
            self._known[name] = DoubleDouble(*numbers) if len(numbers) == 2 else numbers[0]


def _require(known: bool, node: Any) -> None:
    if not known:
        raise TypeError(f"expected text that `kreisel.kernels._numba.straight` knows, got {ast.unparse(node)!r}")


def _named(nodes: Iterable[Any], what: type) -> set[str]:
    """The names that are loaded or stored in them."""
    inside: Iterable[Any] = (part for node in nodes for part in ast.walk(node))
    return {part.id for part in inside if isinstance(part, ast.Name) and isinstance(part.ctx, what)}
