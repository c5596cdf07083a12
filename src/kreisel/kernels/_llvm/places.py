"""What lines of loops and of blocks change, between these."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence
from typing import Any

from llvmlite import ir

from kreisel.kernels._llvm.double_double import DoubleDouble
from kreisel.kernels._llvm.memory import Array
from kreisel.kernels._llvm.numbers import DOUBLE, INTEGER, as_kind

Value = Any  # of numbers of LLVM or of Python, or a tuple of values


class Places:
    """Memory for names of text that lines change: there they are what they are, from wherever one comes.

    known   the values of names now
    names   those that are kept; what is not known yet gets its memory when it is
    """

    def __init__(self, builder: ir.IRBuilder, known: dict[str, Value], names: Sequence[str]):
        self._builder, self._known, self._names = builder, known, names
        self._held: dict[str, tuple[Value, list[Any]]] = {}
        self.write()

    def write(self) -> None:
        builder, known = self._builder, self._known
        for name in self._names:
            if name in known:
                numbers = _flat(known[name], name)
                if name in self._held and _form(known[name]) != _form(self._held[name][0]):
                    raise TypeError(f"expected values of one form in {name!r}, got several")
                if name not in self._held:
                    kinds = [_kind_of(number) for number in numbers]
                    self._held[name] = known[name], [memory_for(builder, kind) for kind in kinds]
                for number, memory in zip(numbers, self._held[name][1], strict=True):
                    builder.store(as_kind(builder, number, memory.type.pointee), memory)

    def read(self) -> None:
        for name, (shape, memory) in self._held.items():
            numbers = iter([self._builder.load(place) for place in memory])
            self._known[name] = _shaped(shape, numbers)

    def leave(self, block: Any) -> None:
        """Go to a block, unless the lines before went elsewhere."""
        if not self._builder.block.is_terminated:
            self.write()
            self._builder.branch(block)


def _form(value: Value) -> Any:
    """How tuples lie in each other."""
    return (type(value), *map(_form, value)) if isinstance(value, tuple) else ()


def _flat(value: Value, name: str) -> list[Any]:
    if isinstance(value, tuple) and not isinstance(value, Array):
        return [number for each in value for number in _flat(each, name)]
    if not isinstance(value, ir.Value | int | float):
        raise TypeError(f"expected numbers in {name!r}, which lines of a loop or a block change, got {value!r}")
    return [value]


def _shaped(shape: Value, numbers: Any) -> Value:
    if isinstance(shape, DoubleDouble):
        return DoubleDouble(next(numbers), next(numbers))
    return tuple(_shaped(each, numbers) for each in shape) if isinstance(shape, tuple) else next(numbers)


def _kind_of(number: Any) -> ir.Type:
    if isinstance(number, ir.Value):
        return number.type
    return INTEGER if isinstance(number, int) else DOUBLE


def memory_for(builder: ir.IRBuilder, kind: ir.Type) -> Any:
    """A pointer to room for a number, made once in a call."""
    with builder.goto_entry_block():
        return builder.alloca(kind)


def awaited(nodes: Iterable[Any]) -> set[str]:
    """The names that lines read before they give them a value."""
    out, given = set[str](), set[str]()
    for node in nodes:
        inner = [*getattr(node, "body", []), *getattr(node, "orelse", [])] if isinstance(node, ast.stmt) else []
        if inner:
            heads = [head for head in (getattr(node, "test", None), getattr(node, "iter", None)) if head is not None]
            found = named(heads, ast.Load)
            for branch in (node.body, node.orelse):
                found |= awaited(branch) - named([getattr(node, "target", ast.Pass())], ast.Store)
        else:
            found = named([node], ast.Load)
            found |= named([node.target], ast.Store) if isinstance(node, ast.AugAssign) else set()
        out |= found - given
        given |= given_by([node])
    return out


def given_by(nodes: Iterable[Any]) -> set[str]:
    """The names that have a value after these lines, wherever one goes."""
    out = set[str]()
    for node in nodes:
        if isinstance(node, ast.If):
            out |= given_by(node.body) & given_by(node.orelse)
        elif not isinstance(node, ast.For | ast.While):
            out |= named([node], ast.Store)
    return out


def named(nodes: Iterable[Any], what: type) -> set[str]:
    """The names that are loaded or stored in them."""
    inside: Iterable[Any] = (one for node in nodes for one in ast.walk(node))
    return {one.id for one in inside if isinstance(one, ast.Name) and isinstance(one.ctx, what)}
