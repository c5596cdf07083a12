"""Straight-line text as LLVM's operations: Numba types a call, not its lines, which takes a tenth of the time.

A function of numbers and of tuples of numbers, whose text is that of a record (`kreisel.kernels.printing`): names of
sums, products, quotients and of the functions below, and loops of `kreisel.kernels.tape.Tape.loop`.
"""

from __future__ import annotations

import ast
import inspect
import operator
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from kreisel.kernels._numba.fused import sign_of
from kreisel.kernels._numba.vector_type import INDEX, VectorType, everywhere, larger, llvm_intrinsic

Number = Any  # of LLVM: a double or a vector of them
OPERATIONS: dict[type, Callable[..., Number]] = {
    ast.Add: ir.IRBuilder.fadd,
    ast.Sub: ir.IRBuilder.fsub,
    ast.Mult: ir.IRBuilder.fmul,
    ast.Div: ir.IRBuilder.fdiv,
}
PLAIN = {ast.Add: operator.add, ast.Sub: operator.sub}  # of two numbers that are written out: NaN is inf - inf
FUNCTIONS: dict[str, Callable[..., Number]] = {
    **{name: llvm_intrinsic(name) for name in ("fma", "sqrt", "sin", "cos", "exp", "log")},
    "sign": sign_of,
    "max": larger,
}


def straight(function: Callable[..., Any]) -> Any:
    """The same function for compiled code, of numbers or vectors; it is written into the code that calls it."""
    code: Any = function.__code__
    names = code.co_varnames[: code.co_argcount]

    def typed(typing_context: Any, *given: Any) -> Any:
        number = next((kind for kind in _elements(given) if isinstance(kind, VectorType)), types.float64)
        (definition,) = _parsed(function)
        *lines, last = definition.body
        several = isinstance(last.value, ast.Tuple)
        out = types.UniTuple(number, len(last.value.elts)) if several else number

        def emit(context: Any, builder: ir.IRBuilder, form: Any, values: Any) -> Any:
            written = Lines(builder, context.get_value_type(number), lines)
            for name, kind, value in zip(names, form.args, values, strict=True):
                written.take(name, value, len(kind) if isinstance(kind, types.BaseTuple) else None)
            found = written.run(last.value)
            return context.make_tuple(builder, out, found) if several else found

        return signature(out, *(_as_numbers(kind) for kind in given)), emit

    parameters = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in ("context", *names)]
    typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    made: Any = intrinsic(typed)
    made.py_func = function  # as Numba calls what it compiles
    return made


def _parsed(function: Callable[..., Any]) -> list[Any]:
    return [*ast.parse(textwrap.dedent(inspect.getsource(function))).body]


def _elements(kinds: Iterable[Any]) -> list[Any]:
    return [part for kind in kinds for part in getattr(kind, "types", [kind])]


def _as_numbers(kind: Any) -> Any:
    """The type with doubles in place of whole numbers and of numbers that are written out."""
    if isinstance(kind, types.BaseTuple):
        return types.Tuple([_as_numbers(part) for part in _elements([kind])])
    return kind if isinstance(kind, VectorType) else types.float64


class Lines:
    """The operations of some lines, at the end of what `builder` builds."""

    def __init__(self, builder: ir.IRBuilder, kind: ir.Type, lines: Sequence[Any]):
        self._builder, self._kind, self._lines = builder, kind, lines
        self._known: dict[str, Any] = {}  # numbers of LLVM, or tuples of them, by name

    def take(self, name: str, value: Any, count: int | None) -> None:
        """An argument: a number, or a tuple of so many."""
        self._known[name] = value if count is None else tuple(cgutils.unpack_tuple(self._builder, value, count))

    def run(self, result: Any) -> Any:
        """The numbers that are returned, after all lines."""
        for i, line in enumerate(self._lines):
            if isinstance(line, ast.For):
                self._loop(line, _named([*self._lines[i + 1 :], result], ast.Load))
            else:
                self._assign(line)
        if isinstance(result, ast.Tuple):
            return [self._whole(self._value(part)) for part in result.elts]
        return self._whole(self._value(result))

    def _assign(self, line: Any) -> None:
        if isinstance(line, ast.Pass):
            return
        (target,) = line.targets
        if isinstance(target, ast.Name):
            self._known[target.id] = self._value(line.value)
            return
        several = isinstance(line.value, ast.Tuple)
        values = [self._value(part) for part in line.value.elts] if several else self._value(line.value)
        self._known |= {name.id: value for name, value in zip(target.elts, values, strict=True)}

    def _value(self, node: Any) -> Any:
        """A number of LLVM or of Python, or a tuple."""
        if isinstance(node, ast.Constant):
            return float(ast.literal_eval(node))
        if isinstance(node, ast.Name):
            return self._known[node.id]
        if isinstance(node, ast.Subscript):
            return self._value(node.value)[ast.literal_eval(node.slice)]
        if isinstance(node, ast.UnaryOp):
            value = self._value(node.operand)
            return -value if isinstance(value, float) else self._builder.fneg(value)
        if isinstance(node, ast.BinOp):
            x, y = self._value(node.left), self._value(node.right)
            if isinstance(x, float) and isinstance(y, float):
                return PLAIN[type(node.op)](x, y)
            return OPERATIONS[type(node.op)](self._builder, *self._alike(x, y))
        return FUNCTIONS[node.func.id](self._builder, *self._alike(*map(self._value, node.args)))

    def _alike(self, *values: Any) -> list[Any]:
        """All as vectors, if one of them is one."""
        kinds = [value.type for value in values if not isinstance(value, float)]
        wide = next((kind for kind in kinds if isinstance(kind, ir.VectorType)), ir.DoubleType())
        return [self._broadcast(value, wide) for value in values]

    def _broadcast(self, value: Any, kind: ir.Type) -> Any:
        if isinstance(value, float):
            return everywhere(kind, value)
        if value.type == kind:
            return value
        one = self._builder.insert_element(ir.Constant(kind, ir.Undefined), value, INDEX(0))
        return self._builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(INDEX, kind.count), [0] * kind.count))

    def _whole(self, value: Any) -> Any:
        return self._broadcast(value, self._kind)

    def _loop(self, loop: Any, after: set[str]) -> None:
        """`for _ in range(most)`, whose last line is `if x <= small: break`."""
        builder, most = self._builder, ast.literal_eval(loop.iter.args[0])
        *body, end = loop.body
        made = _named(body, ast.Store)
        kept = {name: cgutils.alloca_once(builder, self._kind) for name in sorted(made & {*self._known, *after})}
        for name, place in kept.items():
            builder.store(self._whole(self._known.get(name, 0.0)), place)
        count = cgutils.alloca_once_value(builder, INDEX(0))
        again, done = builder.append_basic_block("again"), builder.append_basic_block("done")
        builder.branch(again)
        builder.position_at_end(again)
        self._known |= {name: builder.load(place) for name, place in kept.items()}
        for line in body:
            self._assign(line)
        for name, place in kept.items():
            builder.store(self._whole(self._known[name]), place)
        sides = self._value(end.test.left), self._value(end.test.comparators[0])
        small = builder.fcmp_ordered("<=", *self._alike(*sides))
        passed = builder.add(builder.load(count), INDEX(1))
        builder.store(passed, count)
        last = builder.icmp_signed(">=", passed, INDEX(most))
        builder.cbranch(builder.or_(small, last), done, again)
        builder.position_at_end(done)
        self._known |= {name: builder.load(place) for name, place in kept.items()}


def _named(nodes: Iterable[Any], what: type) -> set[str]:
    """The names that are loaded or stored in them."""
    inside: Iterable[Any] = (part for node in nodes for part in ast.walk(node))
    return {part.id for part in inside if isinstance(part, ast.Name) and isinstance(part.ctx, what)}
